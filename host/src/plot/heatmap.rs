//! Heat maps: one coloured cell for every pair of two axes' values, such as frequency and direction.

use super::canvas::{Align, Canvas, Text};
use super::chart::{MARGIN, TICK, draw_title, label_text, tick_text, title_height};
use super::{Colour, Figure, PlotError, axis::number, colour};

const TICK_COLUMN: f64 = 46.0;
const HEADING: f64 = 28.0;
const FOOT: f64 = 46.0;
const BAR: f64 = 12.0;
const BAR_COLUMN: f64 = 70.0;

/// How values become colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Palette {
    /// Blue below zero, white at zero, red above it; limits are equal on both sides.
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
    limits: Option<(f64, f64)>,
    decimals: usize,
    marks: Vec<(usize, usize, String)>,
    cell: (f64, f64),
}

impl HeatMaps {
    /// An empty figure of maps in rows of `columns`.
    pub fn new(title: impl Into<String>, columns: usize) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            maps: Vec::new(),
            columns: columns.max(1),
        }
    }

    /// A quieter line under the title.
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

    /// Width and height that every map gets.
    fn slot(&self) -> (f64, f64) {
        self.maps.iter().fold((0.0, 0.0), |slot, map| {
            let size = map.size();
            (f64::max(slot.0, size.0), f64::max(slot.1, size.1))
        })
    }
}

impl HeatMap {
    /// A map of `values[row][column]`, one row for every value of `y` (drawn from the bottom), one column for every
    /// value of `x`. Cells that are missing or not finite stay grey.
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
            cell: (46.0, 30.0),
        }
    }

    /// Names the axes with their units.
    #[must_use]
    pub fn labels(mut self, x: impl Into<String>, y: impl Into<String>) -> Self {
        (self.x_label, self.y_label) = (x.into(), y.into());
        self
    }

    /// Colours it another way.
    #[must_use]
    pub fn palette(mut self, palette: Palette) -> Self {
        self.palette = palette;
        self
    }

    /// Colours for exactly this range instead of the values' own.
    #[must_use]
    pub fn limits(mut self, low: f64, high: f64) -> Self {
        self.limits = Some((low, high));
        self
    }

    /// Digits after the point in the cells (2 unless told).
    #[must_use]
    pub fn decimals(mut self, decimals: usize) -> Self {
        self.decimals = decimals;
        self
    }

    /// Puts a ring and a short name on the cell in `column`, `row`.
    #[must_use]
    pub fn mark(mut self, column: usize, row: usize, label: impl Into<String>) -> Self {
        self.marks.push((column, row, label.into()));
        self
    }

    /// Width and height of a cell in logical pixels (46 by 30 unless told; below 30 wide no numbers are written).
    #[must_use]
    pub fn cell(mut self, width: f64, height: f64) -> Self {
        self.cell = (width, height);
        self
    }

    fn value(&self, column: usize, row: usize) -> Option<f64> {
        let value = *self.values.get(row)?.get(column)?;
        value.is_finite().then_some(value)
    }

    fn shown_limits(&self) -> (f64, f64) {
        let values = || self.values.iter().flatten().copied().filter(|v| v.is_finite());
        let (low, high) = self.limits.unwrap_or_else(|| {
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
        });
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        match self.palette {
            Palette::Sequential if low < high => (low, high),
            Palette::Sequential => (low - 0.5, low + 0.5),
            Palette::Diverging => {
                let reach = low.abs().max(high.abs()).max(f64::MIN_POSITIVE);
                (-reach, reach)
            }
        }
    }

    fn size(&self) -> (f64, f64) {
        (
            TICK_COLUMN + self.cell.0 * self.x.len() as f64 + BAR_COLUMN,
            HEADING + 18.0 + self.cell.1 * self.y.len() as f64 + FOOT,
        )
    }

    fn draw(&self, canvas: &Canvas<'_>, (left, top): (f64, f64)) -> Result<(), PlotError> {
        canvas.text(
            (left + TICK_COLUMN, top + 10.0),
            &self.title,
            label_text(colour::INK, true),
        )?;
        canvas.text((left, top + HEADING), &self.y_label, label_text(colour::MUTED, false))?;
        let origin = (left + TICK_COLUMN, top + HEADING + 12.0);
        self.draw_cells(canvas, origin)?;
        self.draw_labels(canvas, origin)?;
        self.draw_bar(canvas, origin)
    }

    /// Upper left corner of a cell.
    fn corner(&self, origin: (f64, f64), column: usize, row: usize) -> (f64, f64) {
        let from_top = self.y.len() - 1 - row;
        (origin.0 + column as f64 * self.cell.0, origin.1 + from_top as f64 * self.cell.1)
    }

    fn draw_cells(&self, canvas: &Canvas<'_>, origin: (f64, f64)) -> Result<(), PlotError> {
        let limits = self.shown_limits();
        for row in 0..self.y.len() {
            for column in 0..self.x.len() {
                let (x, y) = self.corner(origin, column, row);
                let end = (x + self.cell.0 - 1.0, y + self.cell.1 - 1.0);
                let value = self.value(column, row);
                let shade = value.map_or(colour::GRID, |v| self.palette.colour(v, limits));
                canvas.rectangle((x, y), end, shade, 1.0)?;
                if let Some(value) = value.filter(|_| self.cell.0 >= 30.0) {
                    let look =
                        Text { align: Align::Centre, size: TICK - 0.5, ..tick_text(shade.ink()) };
                    let middle = (x + self.cell.0 / 2.0, y + self.cell.1 / 2.0);
                    canvas.text(middle, &number(value, self.decimals), look)?;
                }
            }
        }
        self.draw_marks(canvas, origin)
    }

    fn draw_marks(&self, canvas: &Canvas<'_>, origin: (f64, f64)) -> Result<(), PlotError> {
        for (column, row, label) in &self.marks {
            if *column >= self.x.len() || *row >= self.y.len() {
                continue;
            }
            let (x, y) = self.corner(origin, *column, *row);
            let (w, h) = (self.cell.0 - 1.0, self.cell.1 - 1.0);
            let ring = [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)];
            canvas.line(&ring, colour::INK, 2.0, 1.0)?;
            let look = Text { size: TICK - 1.5, bold: true, ..tick_text(colour::INK) };
            let tag = (x + 3.0, y + 6.5);
            let width = super::canvas::text_width(label, TICK - 1.5, true);
            canvas.rectangle(
                (x + 1.0, y + 1.0),
                (x + width + 5.0, y + 12.0),
                colour::WHITE,
                0.8,
            )?;
            canvas.text(tag, label, look)?;
        }
        Ok(())
    }

    fn draw_labels(&self, canvas: &Canvas<'_>, origin: (f64, f64)) -> Result<(), PlotError> {
        let bottom = origin.1 + self.cell.1 * self.y.len() as f64;
        let centre = |align| Text { align, ..tick_text(colour::MUTED) };
        for (column, value) in self.x.iter().enumerate() {
            let at = (origin.0 + (column as f64 + 0.5) * self.cell.0, bottom + 11.0);
            canvas.text(at, &short(*value), centre(Align::Centre))?;
        }
        for (row, value) in self.y.iter().enumerate() {
            let at = (origin.0 - 7.0, self.corner(origin, 0, row).1 + self.cell.1 / 2.0);
            canvas.text(at, &short(*value), centre(Align::Right))?;
        }
        let middle = origin.0 + self.cell.0 * self.x.len() as f64 / 2.0;
        let look = Text { align: Align::Centre, ..label_text(colour::MUTED, false) };
        canvas.text((middle, bottom + 30.0), &self.x_label, look)
    }

    fn draw_bar(&self, canvas: &Canvas<'_>, origin: (f64, f64)) -> Result<(), PlotError> {
        const SLICES: usize = 64;
        let (low, high) = self.shown_limits();
        let height = self.cell.1 * self.y.len() as f64 - 1.0;
        let left = origin.0 + self.cell.0 * self.x.len() as f64 + 10.0;
        let value_at = |share: f64| high + (low - high) * share;
        for slice in 0..SLICES {
            let share = |i: usize| i as f64 / SLICES as f64;
            let shade = self.palette.colour(value_at(share(slice)), (low, high));
            canvas.rectangle(
                (left, origin.1 + height * share(slice)),
                (left + BAR, origin.1 + height * share(slice + 1) + 0.3),
                shade,
                1.0,
            )?;
        }
        for share in [0.0, 0.5, 1.0] {
            let at = (left + BAR + 5.0, origin.1 + 5.0 + (height - 10.0) * share);
            let text = number(value_at(share), self.decimals);
            canvas.text(at, &text, tick_text(colour::MUTED))?;
        }
        Ok(())
    }
}

impl Figure for HeatMaps {
    fn size(&self) -> (f64, f64) {
        let slot = self.slot();
        let columns = self.columns.min(self.maps.len().max(1));
        let rows = self.maps.len().div_ceil(self.columns);
        (
            slot.0 * columns as f64 + 2.0 * MARGIN,
            title_height(&self.title, &self.subtitle) + slot.1 * rows as f64 + MARGIN,
        )
    }

    fn draw(&self, canvas: &Canvas<'_>) -> Result<(), PlotError> {
        draw_title(canvas, &self.title, &self.subtitle)?;
        let slot = self.slot();
        let top = title_height(&self.title, &self.subtitle) + MARGIN / 2.0;
        for (index, map) in self.maps.iter().enumerate() {
            let (row, column) = (index / self.columns, index % self.columns);
            let corner = (MARGIN + slot.0 * column as f64, top + slot.1 * row as f64);
            map.draw(canvas, corner)?;
        }
        Ok(())
    }
}

impl Palette {
    /// The colour of `value` where `limits` take the palette's two ends.
    #[must_use]
    pub fn colour(self, value: f64, limits: (f64, f64)) -> Colour {
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
        let share = ((value - limits.0) / (limits.1 - limits.0)).clamp(0.0, 1.0);
        let place = share * (stops.len() - 1) as f64;
        let index = (place as usize).min(stops.len() - 2);
        stops[index].towards(stops[index + 1], place - index as f64)
    }
}

/// An axis value without needless digits.
fn short(value: f64) -> String {
    let decimals = (0..4)
        .find(|d| {
            let scaled = value * 10f64.powi(*d);
            (scaled - scaled.round()).abs() < 1e-6
        })
        .unwrap_or(4);
    number(value, decimals as usize)
}
