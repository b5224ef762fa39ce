//! Tracks: paths on the floor, seen from above, with equal scales on both axes.

use super::axis::{Axis, Limits, Scale, range_of};
use super::canvas::{Align, Canvas, Pen, Pixel, Size, Text, text_width};
use super::chart::{
    LABEL, MARGIN, colour_of, draw_grid, draw_legend, draw_title, draw_x_ticks, label_text,
    tick_text, title_height,
};
use super::series::{Frame, Point, Series};
use super::{Colour, Figure, colour};
use flix_host::nav::Position;

const TICK_COLUMN: f64 = 52.0;
const HEADING: f64 = 26.0;
const FOOT: f64 = 48.0;
/// Largest height of a figure, as a share of its width.
const TALLEST: f64 = 1.25;

/// A map of the floor: x to the right, y up, with one scale.
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
    /// Position of the point.
    pub at: Position,
    /// Text beside the point; may be empty.
    pub label: String,
    /// Colour of the point.
    pub colour: Colour,
}

/// A closed shape: the robot's plate, a fence.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Corners in order.
    pub corners: Vec<Position>,
    /// Colour of the edge and the filling.
    pub colour: Colour,
    /// Opacity of the filling, 0 to 1.
    pub filling: f64,
}

impl Track {
    /// Creates an empty map whose axes are labelled x and y in `unit`.
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

    /// Sets the smaller line under the title.
    #[must_use]
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Adds a path on top of the others.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a named point.
    #[must_use]
    pub fn mark(mut self, at: Position, label: impl Into<String>, colour: Colour) -> Self {
        self.marks.push(Mark { at, label: label.into(), colour });
        self
    }

    /// Adds a closed shape under the paths.
    #[must_use]
    pub fn outline(mut self, outline: Outline) -> Self {
        self.outlines.push(outline);
        self
    }

    /// Sets the width of the figure, logical pixels (default 900).
    #[must_use]
    pub fn width(mut self, pixels: f64) -> Self {
        self.width = pixels;
        self
    }

    /// Returns the shown ranges of x and y.
    fn ranges(&self) -> [Limits; 2] {
        let points = || {
            let corners = self.outlines.iter().flat_map(|o| &o.corners).copied();
            let places = corners.chain(self.marks.iter().map(|m| m.at)).map(Point::from);
            self.series.iter().flat_map(|s| &s.points).copied().chain(places)
        };
        let range = |pick: fn(Point) -> f64| {
            range_of(points().map(pick), Scale::Linear, 0.0).unwrap_or(Limits::new(0.0, 1.0))
        };
        let ranges = [range(|p| p.x), range(|p| p.y)];
        // The same margin all around, and never a map thinner than a third of its length.
        let length = ranges[0].span().max(ranges[1].span()).max(1e-9);
        ranges.map(|range| {
            range.widened(0.06 * length + (length / 3.0 - range.span()).max(0.0) / 2.0)
        })
    }

    /// Returns the frame, and the ranges of x and y with one scale.
    fn layout(&self) -> (Frame, [Limits; 2]) {
        let [x, y] = self.ranges();
        let (left, right) = (MARGIN + TICK_COLUMN, self.width - MARGIN - 6.0);
        let height = ((right - left) * y.span() / x.span()).min(self.width * TALLEST);
        let top = title_height(&self.title, &self.subtitle) + HEADING;
        let frame = Frame { left, right, top, bottom: top + height };
        // A tall map was cut to size: show more on both sides instead of compressing it.
        let needed = y.span() * (right - left) / height;
        let middle = (x.low + x.high) / 2.0;
        (frame, [Limits::new(middle, middle).widened(needed / 2.0), y])
    }
}

impl Figure for Track {
    fn size(&self) -> Size {
        Size { width: self.width, height: self.layout().0.bottom + FOOT + MARGIN / 2.0 }
    }

    fn draw(&self, canvas: &mut Canvas) {
        let (frame, [x_range, y_range]) = self.layout();
        let x = Axis::new(x_range, Scale::Linear, frame.left, frame.right);
        let y = Axis::new(y_range, Scale::Linear, frame.bottom, frame.top);
        draw_title(canvas, &self.title, &self.subtitle);
        draw_grid(canvas, (&x, &y), frame);
        draw_x_ticks(canvas, &x, frame.bottom, 80.0);
        for outline in &self.outlines {
            draw_outline(canvas, (&x, &y), outline);
        }
        for (index, series) in self.series.iter().enumerate() {
            series.draw(canvas, (&x, &y), frame, colour_of(series, index), false);
        }
        for mark in &self.marks {
            draw_mark(canvas, (&x, &y), frame, mark);
        }
        let heading = frame.top - HEADING / 2.0 - 1.0;
        let name = |axis: &str| format!("{axis} ({})", self.unit);
        let look = label_text(colour::INK, true);
        canvas.text(Pixel::new(frame.left, heading), &name("y"), look);
        draw_legend(canvas, &self.series, frame.right, heading);
        let middle = Pixel::new((frame.left + frame.right) / 2.0, frame.bottom + 35.0);
        canvas.text(middle, &name("x"), Text { align: Align::Centre, ..look });
    }
}

/// Returns the pixel of a position.
fn pixel((x, y): (&Axis, &Axis), at: Position) -> Option<Pixel> {
    Some(Pixel::new(x.pixel(at.x)?, y.pixel(at.y)?))
}

fn draw_outline(canvas: &mut Canvas, (x, y): (&Axis, &Axis), outline: &Outline) {
    let mut corners: Vec<_> = outline.corners.iter().filter_map(|at| pixel((x, y), *at)).collect();
    canvas.polygon(&corners, outline.colour, outline.filling);
    corners.extend(corners.first().copied());
    canvas.line(&corners, Pen::new(outline.colour, 1.2).opacity(0.8));
}

fn draw_mark(canvas: &mut Canvas, axes: (&Axis, &Axis), frame: Frame, mark: &Mark) {
    let Some(at) = pixel(axes, mark.at) else { return };
    canvas.disc(at, 6.0, colour::WHITE, 1.0);
    canvas.disc(at, 4.5, mark.colour, 1.0);
    if mark.label.is_empty() {
        return;
    }
    let width = text_width(&mark.label, LABEL, false);
    let fits = at.x + 18.0 + width < frame.right;
    let (align, begin, text) =
        if fits { (Align::Left, 8.0, 10.0) } else { (Align::Right, -10.0 - width, -10.0) };
    let middle = at.moved(0.0, -12.0);
    let corners = (middle.moved(begin, -8.0), middle.moved(begin + width + 4.0, 8.0));
    canvas.rectangle(corners.0, corners.1, colour::WHITE, 0.75);
    let look = Text { align, size: LABEL, ..tick_text(colour::INK) };
    canvas.text(middle.moved(text, 0.0), &mark.label, look);
}
