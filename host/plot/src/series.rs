//! One line of data on a plot.

use super::Colour;
use super::axis::Axis;
use super::canvas::{Canvas, Pen, Pixel};
use flix_host::nav::Position;

/// A data point, in the units of the two axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// On the horizontal axis.
    pub x: f64,
    /// On the vertical axis.
    pub y: f64,
}

impl From<(f64, f64)> for Point {
    /// From a value of the horizontal axis, such as a time, and one of the vertical axis.
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y }
    }
}

impl From<Position> for Point {
    fn from(Position { x, y }: Position) -> Self {
        Self { x, y }
    }
}

/// Style of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// A continuous line.
    Solid,
    /// A dashed line: references and commanded values.
    Dashed,
    /// A line that holds each value until the next: commands.
    Step,
    /// A dot for every point, no line.
    Dots,
    /// A line with a dot at every point: a few measured values.
    Marked,
    /// A line, and the area between it and the lower edge of the panel.
    Filled,
}

/// Points with a name and a style.
#[derive(Debug, Clone)]
pub struct Series {
    pub(super) label: String,
    pub(super) points: Vec<Point>,
    pub(super) colour: Option<Colour>,
    pub(super) stroke: Stroke,
    pub(super) width: f64,
}

impl Series {
    /// Creates a continuous line through `points`. With an empty label it is not in the legend.
    pub fn line(
        label: impl Into<String>,
        points: impl IntoIterator<Item = impl Into<Point>>,
    ) -> Self {
        Self {
            label: label.into(),
            points: points.into_iter().map(Into::into).collect(),
            colour: None,
            stroke: Stroke::Solid,
            width: 1.6,
        }
    }

    /// Sets the style.
    #[must_use]
    pub fn stroke(mut self, stroke: Stroke) -> Self {
        self.stroke = stroke;
        self
    }

    /// Sets the colour; by default the next of [`super::colour::CYCLE`].
    #[must_use]
    pub fn colour(mut self, colour: Colour) -> Self {
        self.colour = Some(colour);
        self
    }

    /// Sets the width of the line, logical pixels (the radius of a dot is 1.5 times as much).
    #[must_use]
    pub fn width(mut self, pixels: f64) -> Self {
        self.width = pixels;
        self
    }

    /// Draws the series inside the frame of two axes. `ordered`: x only grows, so that points in one
    /// pixel column can be thinned out without a visible difference.
    pub(super) fn draw(
        &self,
        canvas: &mut Canvas,
        (x, y): (&Axis, &Axis),
        frame: Frame,
        colour: Colour,
        ordered: bool,
    ) {
        let pen = Pen::new(colour, self.width);
        let pen = if self.stroke == Stroke::Dashed { pen.dashed(6.0, 4.0) } else { pen };
        for run in self.runs(x, y, ordered) {
            if self.stroke != Stroke::Dots {
                for piece in frame.clip(&run) {
                    if self.stroke == Stroke::Filled {
                        fill_below(canvas, frame, &piece, colour);
                    }
                    canvas.line(&piece, pen);
                }
            }
            if matches!(self.stroke, Stroke::Dots | Stroke::Marked) {
                for point in run.iter().filter(|p| frame.holds(**p)) {
                    canvas.disc(*point, self.width * 1.5, colour, 0.9);
                }
            }
        }
    }

    /// Draws the sample for the legend, `width` pixels from `at` to the right.
    pub(super) fn draw_sample(&self, canvas: &mut Canvas, at: Pixel, width: f64, colour: Colour) {
        let end = at.moved(width, 0.0);
        let pen = Pen::new(colour, self.width.max(1.6));
        match self.stroke {
            Stroke::Dots => {}
            Stroke::Dashed => canvas.line(&[at, end], pen.dashed(5.0, 3.0)),
            Stroke::Filled => {
                canvas.rectangle(at.moved(0.0, -4.0), end.moved(0.0, 4.0), colour, FILL_OPACITY);
            }
            Stroke::Solid | Stroke::Step | Stroke::Marked => canvas.line(&[at, end], pen),
        }
        if matches!(self.stroke, Stroke::Dots | Stroke::Marked) {
            canvas.disc(at.moved(width / 2.0, 0.0), 3.0, colour, 1.0);
        }
    }

    /// Returns the series in pixels, broken where a point has none.
    fn runs(&self, x: &Axis, y: &Axis, ordered: bool) -> Vec<Vec<Pixel>> {
        let mut runs: Vec<Vec<Pixel>> = vec![Vec::new()];
        for point in &self.points {
            let pixel = x.pixel(point.x).zip(y.pixel(point.y)).map(|(x, y)| Pixel::new(x, y));
            let Some(run) = runs.last_mut() else { break };
            match pixel {
                Some(pixel) => {
                    if self.stroke == Stroke::Step
                        && let Some(previous) = run.last()
                    {
                        let corner = Pixel::new(pixel.x, previous.y);
                        run.push(corner);
                    }
                    run.push(pixel);
                }
                None if run.is_empty() => {}
                None => runs.push(Vec::new()),
            }
        }
        if ordered && !matches!(self.stroke, Stroke::Dots | Stroke::Marked) {
            runs.iter_mut().for_each(|run| *run = thin(run));
        }
        runs
    }
}

/// Fills the area between a line and the lower edge of the frame.
fn fill_below(canvas: &mut Canvas, frame: Frame, line: &[Pixel], colour: Colour) {
    if let [first, .., last] = line {
        let bottom = [last, first].map(|end| Pixel::new(end.x, frame.bottom));
        canvas.polygon(&[line, &bottom].concat(), colour, FILL_OPACITY);
    }
}

const FILL_OPACITY: f64 = 0.22;

/// The rectangle inside which data are drawn, logical pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

impl Frame {
    fn holds(&self, Pixel { x, y }: Pixel) -> bool {
        (self.left - 0.5..=self.right + 0.5).contains(&x)
            && (self.top - 0.5..=self.bottom + 0.5).contains(&y)
    }

    /// Returns the pieces of a polyline that lie inside.
    fn clip(&self, run: &[Pixel]) -> Vec<Vec<Pixel>> {
        let mut pieces: Vec<Vec<Pixel>> = Vec::new();
        for pair in run.windows(2) {
            let Some((a, b)) = self.clip_segment(pair[0], pair[1]) else {
                continue;
            };
            match pieces.last_mut() {
                Some(piece) if piece.last() == Some(&a) => piece.push(b),
                _ => pieces.push(vec![a, b]),
            }
        }
        pieces
    }

    /// Clips one segment (Liang and Barsky).
    fn clip_segment(&self, a: Pixel, b: Pixel) -> Option<(Pixel, Pixel)> {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let edges = [
            (-dx, a.x - self.left),
            (dx, self.right - a.x),
            (-dy, a.y - self.top),
            (dy, self.bottom - a.y),
        ];
        let (mut enter, mut leave) = (0f64, 1f64);
        for (along, room) in edges {
            if along == 0.0 {
                if room < 0.0 {
                    return None;
                }
            } else if along < 0.0 {
                enter = enter.max(room / along);
            } else {
                leave = leave.min(room / along);
            }
        }
        let at = |share: f64| a.moved(dx * share, dy * share);
        (enter <= leave).then(|| {
            (if enter > 0.0 { at(enter) } else { a }, if leave < 1.0 { at(leave) } else { b })
        })
    }
}

/// Keeps the first, lowest, highest and last of the points in each half pixel column.
fn thin(run: &[Pixel]) -> Vec<Pixel> {
    if run.len() < 4000 {
        return run.to_vec();
    }
    let column = |p: &Pixel| (p.x * 2.0).floor();
    let mut thinned = Vec::new();
    for group in run.chunk_by(|a, b| column(a) == column(b)) {
        let indices = 0..group.len();
        let low = indices.clone().min_by(|a, b| group[*a].y.total_cmp(&group[*b].y)).unwrap_or(0);
        let high = indices.max_by(|a, b| group[*a].y.total_cmp(&group[*b].y)).unwrap_or(0);
        let mut kept = [0, low, high, group.len() - 1];
        kept.sort_unstable();
        thinned.extend(kept.iter().map(|i| group[*i]));
    }
    thinned.dedup();
    thinned
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { left: 0.0, top: 0.0, right: 10.0, bottom: 10.0 };

    fn pixels<const COUNT: usize>(points: [(f64, f64); COUNT]) -> [Pixel; COUNT] {
        points.map(|(x, y)| Pixel::new(x, y))
    }

    #[test]
    fn a_line_through_the_frame_is_cut_at_its_edges() {
        let pieces = FRAME.clip(&pixels([(-5.0, 5.0), (15.0, 5.0)]));
        assert_eq!(pieces, [pixels([(0.0, 5.0), (10.0, 5.0)])]);
    }

    #[test]
    fn a_line_that_leaves_and_returns_becomes_two_pieces() {
        let pieces = FRAME.clip(&pixels([(5.0, 5.0), (5.0, 15.0), (8.0, 15.0), (8.0, 5.0)]));
        assert_eq!(pieces.len(), 2);
    }

    #[test]
    fn thinning_keeps_the_peaks() {
        let mut run: Vec<Pixel> =
            (0..100_000).map(|i| Pixel::new(f64::from(i) * 0.005, f64::from(i % 7))).collect();
        run[54_321].y = 1e3;
        let thinned = thin(&run);
        assert!(thinned.len() < 5000 && thinned.iter().any(|p| p.y == 1e3));
    }
}
