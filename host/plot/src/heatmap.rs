//! Heat maps: one coloured cell for each pair of values, such as frequency and direction.

use super::axis::{Limits, Scale, number, range_of};
use super::canvas::{Align, Canvas, Pen, Pixel, Size, Text, text_width};
use super::chart::{MARGIN, TICK, draw_title, label_text, tick_text, title_height};
use super::{Colour, Figure, colour};

const TICK_COLUMN: f64 = 46.0;
const HEADING: f64 = 28.0;
const FOOT: f64 = 46.0;
const BAR: f64 = 12.0;
const BAR_COLUMN: f64 = 70.0;

/// Colours of a heat map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Palette {
    /// Blue below zero, white at zero, red above; the limits are equal on both sides.
    Diverging,
    /// Pale to dark from the lowest to the highest value.
    Sequential,
}

/// One or several heat maps side by side.
#[derive(Debug, Clone)]
pub struct HeatMaps {
    title: String,
    subtitle: String,
    maps: Vec<HeatMap>,
    columns: usize,
}

/// One grid of values.
#[derive(Debug, Clone)]
pub struct HeatMap {
    title: String,
    x_label: String,
    y_label: String,
    x: Vec<f64>,
    y: Vec<f64>,
    values: Vec<Vec<f64>>,
    palette: Palette,
    limits: Option<Limits>,
    decimals: usize,
    marks: Vec<(usize, usize, String)>,
    cell: Size,
}

impl HeatMaps {
    /// Creates an empty figure of maps in rows of `columns`.
    pub fn new(title: impl Into<String>, columns: usize) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            maps: Vec::new(),
            columns: columns.max(1),
        }
    }

    /// Sets the smaller line under the title.
    #[must_use]
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Adds a map after the others.
    #[must_use]
    pub fn map(mut self, map: HeatMap) -> Self {
        self.maps.push(map);
        self
    }

    /// Returns the space of each map.
    fn slot(&self) -> Size {
        let largest = |side: fn(Size) -> f64| {
            self.maps.iter().map(|map| side(map.size())).fold(0.0, f64::max)
        };
        Size { width: largest(|size| size.width), height: largest(|size| size.height) }
    }
}

impl HeatMap {
    /// Creates a map of `values[row][column]`: one row for each value of `y` (drawn from the bottom),
    /// one column for each value of `x`. Cells that are missing or not finite stay grey.
    pub fn new(title: impl Into<String>, x: Vec<f64>, y: Vec<f64>, values: Vec<Vec<f64>>) -> Self {
        Self {
            title: title.into(),
            x_label: String::new(),
            y_label: String::new(),
            x,
            y,
            values,
            palette: Palette::Diverging,
            limits: None,
            decimals: 2,
            marks: Vec::new(),
            cell: Size { width: 46.0, height: 30.0 },
        }
    }

    /// Sets the names of the axes, with their units.
    #[must_use]
    pub fn labels(mut self, x: impl Into<String>, y: impl Into<String>) -> Self {
        (self.x_label, self.y_label) = (x.into(), y.into());
        self
    }

    /// Sets the colours.
    #[must_use]
    pub fn palette(mut self, palette: Palette) -> Self {
        self.palette = palette;
        self
    }

    /// Sets the range of the colours; by default the range of the values.
    #[must_use]
    pub fn limits(mut self, low: f64, high: f64) -> Self {
        self.limits = Some(Limits::new(low, high));
        self
    }

    /// Sets the digits after the point in the cells (default 2).
    #[must_use]
    pub fn decimals(mut self, decimals: usize) -> Self {
        self.decimals = decimals;
        self
    }

    /// Adds a ring and a short name to the cell in `column`, `row`.
    #[must_use]
    pub fn mark(mut self, column: usize, row: usize, label: impl Into<String>) -> Self {
        self.marks.push((column, row, label.into()));
        self
    }

    /// Sets the size of a cell, logical pixels (default 46 by 30; below a width of 30 without numbers).
    #[must_use]
    pub fn cell(mut self, width: f64, height: f64) -> Self {
        self.cell = Size { width, height };
        self
    }

    fn value(&self, column: usize, row: usize) -> Option<f64> {
        let value = *self.values.get(row)?.get(column)?;
        value.is_finite().then_some(value)
    }

    fn shown_limits(&self) -> Limits {
        let values = || self.values.iter().flatten().copied();
        let of_values = range_of(values(), Scale::Linear, 0.0);
        let limits = self.limits.or(of_values).unwrap_or(Limits::new(0.0, 1.0));
        match self.palette {
            Palette::Sequential if limits.span() > 0.0 => limits,
            Palette::Sequential => Limits::new(limits.low, limits.low).widened(0.5),
            Palette::Diverging => {
                let reach = limits.low.abs().max(limits.high.abs()).max(f64::MIN_POSITIVE);
                Limits::new(-reach, reach)
            }
        }
    }

    /// Returns the size of all cells together.
    fn grid(&self) -> Size {
        let (columns, rows) = (self.x.len() as f64, self.y.len() as f64);
        Size { width: self.cell.width * columns, height: self.cell.height * rows }
    }

    fn size(&self) -> Size {
        let Size { width, height } = self.grid();
        Size { width: TICK_COLUMN + width + BAR_COLUMN, height: HEADING + 18.0 + height + FOOT }
    }

    fn draw(&self, canvas: &mut Canvas, corner: Pixel) {
        canvas.text(corner.moved(TICK_COLUMN, 10.0), &self.title, label_text(colour::INK, true));
        canvas.text(corner.moved(0.0, HEADING), &self.y_label, label_text(colour::MUTED, false));
        let origin = corner.moved(TICK_COLUMN, HEADING + 12.0);
        self.draw_cells(canvas, origin);
        self.draw_labels(canvas, origin);
        self.draw_bar(canvas, origin);
    }

    /// Returns the upper left corner of a cell.
    fn corner(&self, origin: Pixel, column: usize, row: usize) -> Pixel {
        let from_top = self.y.len() - 1 - row;
        origin.moved(column as f64 * self.cell.width, from_top as f64 * self.cell.height)
    }

    fn draw_cells(&self, canvas: &mut Canvas, origin: Pixel) {
        let limits = self.shown_limits();
        for row in 0..self.y.len() {
            for column in 0..self.x.len() {
                let Size { width, height } = self.cell;
                let corner = self.corner(origin, column, row);
                let value = self.value(column, row);
                let shade = value.map_or(colour::GRID, |v| self.palette.colour(v, limits));
                canvas.rectangle(corner, corner.moved(width - 1.0, height - 1.0), shade, 1.0);
                if let Some(value) = value.filter(|_| width >= 30.0) {
                    let look =
                        Text { align: Align::Centre, size: TICK - 0.5, ..tick_text(shade.ink()) };
                    let middle =
                        corner.moved(width / 2.0, height * self.number_height(column, row));
                    canvas.text(middle, &number(value, self.decimals), look);
                }
            }
        }
        self.draw_marks(canvas, origin);
    }

    /// Returns where the number of a cell stands, as a share of its height from the top: below the name of a mark.
    fn number_height(&self, column: usize, row: usize) -> f64 {
        let is_marked = self.marks.iter().any(|(c, r, _)| (*c, *r) == (column, row));
        if is_marked { 0.68 } else { 0.5 }
    }

    fn draw_marks(&self, canvas: &mut Canvas, origin: Pixel) {
        for (column, row, label) in &self.marks {
            if *column >= self.x.len() || *row >= self.y.len() {
                continue;
            }
            let corner = self.corner(origin, *column, *row);
            let (w, h) = (self.cell.width - 1.0, self.cell.height - 1.0);
            let ring = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h), (0.0, 0.0)];
            canvas.line(&ring.map(|(x, y)| corner.moved(x, y)), Pen::new(colour::INK, 2.0));
            let look = Text { size: TICK - 1.5, bold: true, ..tick_text(colour::INK) };
            let width = text_width(label, look.size, look.bold);
            let (begin, end) = (corner.moved(1.0, 1.0), corner.moved(width + 5.0, 12.0));
            canvas.rectangle(begin, end, colour::WHITE, 0.8);
            canvas.text(corner.moved(3.0, 6.5), label, look);
        }
    }

    fn draw_labels(&self, canvas: &mut Canvas, origin: Pixel) {
        let (cell, grid) = (self.cell, self.grid());
        let look = |align| Text { align, ..tick_text(colour::MUTED) };
        for (column, value) in self.x.iter().enumerate() {
            let at = origin.moved((column as f64 + 0.5) * cell.width, grid.height + 11.0);
            canvas.text(at, &short(*value), look(Align::Centre));
        }
        for (row, value) in self.y.iter().enumerate() {
            let at = self.corner(origin, 0, row).moved(-7.0, cell.height / 2.0);
            canvas.text(at, &short(*value), look(Align::Right));
        }
        let below = origin.moved(grid.width / 2.0, grid.height + 30.0);
        let look = Text { align: Align::Centre, ..label_text(colour::MUTED, false) };
        canvas.text(below, &self.x_label, look);
    }

    fn draw_bar(&self, canvas: &mut Canvas, origin: Pixel) {
        const SLICES: usize = 64;
        let limits = self.shown_limits();
        let height = self.grid().height - 1.0;
        let corner = origin.moved(self.grid().width + 10.0, 0.0);
        let value_at = |share: f64| limits.high - limits.span() * share;
        for slice in 0..SLICES {
            let share = |i: usize| i as f64 / SLICES as f64;
            let shade = self.palette.colour(value_at(share(slice)), limits);
            let begin = corner.moved(0.0, height * share(slice));
            let end = corner.moved(BAR, height * share(slice + 1) + 0.3);
            canvas.rectangle(begin, end, shade, 1.0);
        }
        for share in [0.0, 0.5, 1.0] {
            let at = corner.moved(BAR + 5.0, 5.0 + (height - 10.0) * share);
            let text = number(value_at(share), self.decimals);
            canvas.text(at, &text, tick_text(colour::MUTED));
        }
    }
}

impl Figure for HeatMaps {
    fn size(&self) -> Size {
        let slot = self.slot();
        let columns = self.columns.min(self.maps.len().max(1)) as f64;
        let rows = self.maps.len().div_ceil(self.columns) as f64;
        let title = title_height(&self.title, &self.subtitle);
        Size {
            width: slot.width * columns + 2.0 * MARGIN,
            height: title + slot.height * rows + MARGIN,
        }
    }

    fn draw(&self, canvas: &mut Canvas) {
        draw_title(canvas, &self.title, &self.subtitle);
        let slot = self.slot();
        let top = title_height(&self.title, &self.subtitle) + MARGIN / 2.0;
        for (index, map) in self.maps.iter().enumerate() {
            let (row, column) = (index / self.columns, index % self.columns);
            let (x, y) = (slot.width * column as f64, slot.height * row as f64);
            map.draw(canvas, Pixel::new(MARGIN + x, top + y));
        }
    }
}

impl Palette {
    /// Returns the colour of `value`; `limits` are the two ends of the palette.
    #[must_use]
    pub fn colour(self, value: f64, limits: Limits) -> Colour {
        let stops: &[Colour] = match self {
            // ColorBrewer RdBu (reversed) and YlGnBu: both safe for colour-blind readers.
            Palette::Diverging => &[
                Colour(0x21, 0x66, 0xac),
                Colour(0x67, 0xa9, 0xcf),
                Colour(0xd1, 0xe5, 0xf0),
                Colour(0xf9, 0xf9, 0xf9),
                Colour(0xfd, 0xdb, 0xc7),
                Colour(0xef, 0x8a, 0x62),
                Colour(0xb2, 0x18, 0x2b),
            ],
            Palette::Sequential => &[
                Colour(0xff, 0xff, 0xe5),
                Colour(0xd4, 0xee, 0xc0),
                Colour(0x7f, 0xcd, 0xbb),
                Colour(0x41, 0xb6, 0xc4),
                Colour(0x22, 0x5e, 0xa8),
                Colour(0x12, 0x2a, 0x6b),
            ],
        };
        let share = ((value - limits.low) / limits.span()).clamp(0.0, 1.0);
        let place = share * (stops.len() - 1) as f64;
        let index = (place as usize).min(stops.len() - 2);
        stops[index].towards(stops[index + 1], place - index as f64)
    }
}

/// Returns a value of an axis without superfluous digits.
fn short(value: f64) -> String {
    let decimals = (0..4)
        .find(|d| {
            let scaled = value * 10f64.powi(*d);
            (scaled - scaled.round()).abs() < 1e-6
        })
        .unwrap_or(4);
    number(value, decimals as usize)
}
