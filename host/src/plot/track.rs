//! Tracks: paths on the floor, seen from above, with equal scales on both axes.

use super::axis::{Axis, Scale, range_of};
use super::canvas::{Align, Canvas, Text, text_width};
use super::chart::{
    LABEL, MARGIN, colour_of, draw_grid, draw_legend, draw_title, draw_x_ticks, label_text,
    tick_text, title_height,
};
use super::series::{Frame, Series};
use super::{Colour, Figure, PlotError, colour};

const TICK_COLUMN: f64 = 52.0;
const HEADING: f64 = 26.0;
const FOOT: f64 = 48.0;
/// The highest a track may make its figure, as a share of the width.
const TALLEST: f64 = 1.25;

/// A map of the floor: x to the right, y upwards, one scale for both.
#[derive(Debug, Clone)]
pub struct Track {
    title: String,
    subtitle: String,
    unit: String,
    series: Vec<Series>,
    marks: Vec<Mark>,
    outlines: Vec<Outline>,
    width: f64,
}

/// A named point.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Where.
    pub at: (f64, f64),
    /// What is written beside it; may be empty.
    pub label: String,
    /// Colour of the point.
    pub colour: Colour,
}

/// A closed shape: the robot's plate, a fence.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Corners in order.
    pub corners: Vec<(f64, f64)>,
    /// Colour of the edge and the filling.
    pub colour: Colour,
    /// Opacity of the filling, 0 to 1.
    pub filling: f64,
}

impl Track {
    /// An empty map whose axes are labelled x and y in `unit`.
    pub fn new(title: impl Into<String>, unit: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            unit: unit.into(),
            series: Vec::new(),
            marks: Vec::new(),
            outlines: Vec::new(),
            width: 900.0,
        }
    }

    /// A quieter line under the title.
    #[must_use]
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Adds a path; later ones lie on top.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a named point.
    #[must_use]
    pub fn mark(mut self, at: (f64, f64), label: impl Into<String>, colour: Colour) -> Self {
        self.marks.push(Mark { at, label: label.into(), colour });
        self
    }

    /// Adds a closed shape under the paths.
    #[must_use]
    pub fn outline(mut self, outline: Outline) -> Self {
        self.outlines.push(outline);
        self
    }

    /// Makes the figure this wide (logical pixels; 900 unless told).
    #[must_use]
    pub fn width(mut self, pixels: f64) -> Self {
        self.width = pixels;
        self
    }

    fn ranges(&self) -> ((f64, f64), (f64, f64)) {
        let points = || {
            self.series
                .iter()
                .flat_map(|s| &s.points)
                .chain(self.outlines.iter().flat_map(|o| &o.corners))
                .copied()
                .chain(self.marks.iter().map(|m| m.at))
        };
        let range = |pick: fn((f64, f64)) -> f64| {
            range_of(points().map(pick), Scale::Linear, 0.0).unwrap_or((0.0, 1.0))
        };
        let (x, y) = (range(|p| p.0), range(|p| p.1));
        // The same margin all around, and never a map thinner than a third of its length.
        let length = (x.1 - x.0).max(y.1 - y.0).max(1e-9);
        let widen = |(low, high): (f64, f64)| {
            let margin = 0.06 * length + (length / 3.0 - (high - low)).max(0.0) / 2.0;
            (low - margin, high + margin)
        };
        (widen(x), widen(y))
    }

    /// Frame and ranges with equal scales.
    fn layout(&self) -> (Frame, (f64, f64), (f64, f64)) {
        let (x, y) = self.ranges();
        let (left, right) = (MARGIN + TICK_COLUMN, self.width - MARGIN - 6.0);
        let height = ((right - left) * (y.1 - y.0) / (x.1 - x.0)).min(self.width * TALLEST);
        let top = title_height(&self.title, &self.subtitle) + HEADING;
        let frame = Frame { left, right, top, bottom: top + height };
        // A tall map was cut to size: show more to both sides instead of squeezing it.
        let needed = (y.1 - y.0) * (right - left) / height;
        let middle = (x.0 + x.1) / 2.0;
        (frame, (middle - needed / 2.0, middle + needed / 2.0), y)
    }
}

impl Figure for Track {
    fn size(&self) -> (f64, f64) {
        (self.width, self.layout().0.bottom + FOOT + MARGIN / 2.0)
    }

    fn draw(&self, canvas: &Canvas<'_>) -> Result<(), PlotError> {
        let (frame, x_range, y_range) = self.layout();
        let x = Axis::new(x_range, Scale::Linear, frame.left, frame.right);
        let y = Axis::new(y_range, Scale::Linear, frame.bottom, frame.top);
        draw_title(canvas, &self.title, &self.subtitle)?;
        draw_grid(canvas, (&x, &y), frame)?;
        draw_x_ticks(canvas, &x, frame.bottom, 80.0)?;
        for outline in &self.outlines {
            draw_outline(canvas, (&x, &y), outline)?;
        }
        for (index, series) in self.series.iter().enumerate() {
            series.draw(canvas, (&x, &y), frame, colour_of(series, index), false)?;
        }
        for mark in &self.marks {
            draw_mark(canvas, (&x, &y), frame, mark)?;
        }
        let heading = frame.top - HEADING / 2.0 - 1.0;
        canvas.text(
            (frame.left, heading),
            &format!("y ({})", self.unit),
            label_text(colour::INK, true),
        )?;
        draw_legend(canvas, &self.series, frame.right, heading)?;
        let look = Text { align: Align::Centre, ..label_text(colour::INK, true) };
        let middle = (frame.left + frame.right) / 2.0;
        canvas.text((middle, frame.bottom + 35.0), &format!("x ({})", self.unit), look)
    }
}

fn draw_outline(
    canvas: &Canvas<'_>,
    (x, y): (&Axis, &Axis),
    outline: &Outline,
) -> Result<(), PlotError> {
    let mut corners: Vec<_> =
        outline.corners.iter().filter_map(|(a, b)| x.pixel(*a).zip(y.pixel(*b))).collect();
    canvas.polygon(&corners, outline.colour, outline.filling)?;
    corners.extend(corners.first().copied());
    canvas.line(&corners, outline.colour, 1.2, 0.8)
}

fn draw_mark(
    canvas: &Canvas<'_>,
    (x, y): (&Axis, &Axis),
    frame: Frame,
    mark: &Mark,
) -> Result<(), PlotError> {
    let Some(at) = x.pixel(mark.at.0).zip(y.pixel(mark.at.1)) else {
        return Ok(());
    };
    canvas.disc(at, 6.0, colour::WHITE, 1.0)?;
    canvas.disc(at, 4.5, mark.colour, 1.0)?;
    if mark.label.is_empty() {
        return Ok(());
    }
    let width = text_width(&mark.label, LABEL, false);
    let fits = at.0 + 10.0 + width < frame.right;
    let (align, begin, text_at) = if fits {
        (Align::Left, at.0 + 8.0, at.0 + 10.0)
    } else {
        (Align::Right, at.0 - 10.0 - width, at.0 - 10.0)
    };
    let place = at.1 - 12.0;
    canvas.rectangle(
        (begin, place - 8.0),
        (begin + width + 4.0, place + 8.0),
        colour::WHITE,
        0.75,
    )?;
    let look = Text { align, size: LABEL, ..tick_text(colour::INK) };
    canvas.text((text_at, place), &mark.label, look)
}
