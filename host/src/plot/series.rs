//! One line of data on a plot.

use super::axis::Axis;
use super::canvas::{Canvas, Pixel};
use super::{Colour, PlotError};

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// A continuous line.
    Solid,
    /// A dashed line: references and set values.
    Dashed,
    /// A line that keeps each value until the next: commands.
    Step,
    /// A dot for every point, no line.
    Dots,
    /// A line with a dot at every point: a few measured values.
    Marked,
    /// The surface between the line and the lower edge of the panel.
    Filled,
}

/// Points with a name and a look.
#[derive(Debug, Clone)]
pub struct Series {
    pub(super) label: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) colour: Option<Colour>,
    pub(super) stroke: Stroke,
    pub(super) width: f64,
}

impl Series {
    /// A continuous line through `points` (x, y). An empty label keeps it out of the legend.
    pub fn line(label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self {
            label: label.into(),
            points: points.into_iter().collect(),
            colour: None,
            stroke: Stroke::Solid,
            width: 1.6,
        }
    }

    /// Draws it another way.
    #[must_use]
    pub fn stroke(mut self, stroke: Stroke) -> Self {
        self.stroke = stroke;
        self
    }

    /// In this colour instead of the next of [`super::colour::CYCLE`].
    #[must_use]
    pub fn colour(mut self, colour: Colour) -> Self {
        self.colour = Some(colour);
        self
    }

    /// With a line this many logical pixels wide (a dot's radius is 1.5 times as much).
    #[must_use]
    pub fn width(mut self, pixels: f64) -> Self {
        self.width = pixels;
        self
    }

    /// Draws the series inside the frame spanned by two axes. `ordered`: x only grows, so that points which share a
    /// pixel column may be thinned out without a visible difference.
    pub(super) fn draw(
        &self,
        canvas: &Canvas<'_>,
        (x, y): (&Axis, &Axis),
        frame: Frame,
        colour: Colour,
        ordered: bool,
    ) -> Result<(), PlotError> {
        for run in self.runs(x, y, ordered) {
            match self.stroke {
                Stroke::Dots => self.dots(canvas, frame, &run, colour)?,
                Stroke::Filled => self.surface(canvas, frame, &run, colour)?,
                Stroke::Solid | Stroke::Dashed | Stroke::Step | Stroke::Marked => {
                    for piece in frame.clip(&run) {
                        match self.stroke {
                            Stroke::Dashed => {
                                canvas.dashed(&piece, (6.0, 4.0), colour, self.width)?
                            }
                            _ => canvas.line(&piece, colour, self.width, 1.0)?,
                        }
                    }
                }
            }
            if self.stroke == Stroke::Marked {
                self.dots(canvas, frame, &run, colour)?;
            }
        }
        Ok(())
    }

    /// Draws the sample of the legend, `width` pixels from `at` to the right.
    pub(super) fn draw_sample(
        &self,
        canvas: &Canvas<'_>,
        at: Pixel,
        width: f64,
        colour: Colour,
    ) -> Result<(), PlotError> {
        let line = [at, (at.0 + width, at.1)];
        let middle = (at.0 + width / 2.0, at.1);
        match self.stroke {
            Stroke::Dots => canvas.disc(middle, 3.0, colour, 1.0),
            Stroke::Dashed => canvas.dashed(&line, (5.0, 3.0), colour, self.width.max(1.6)),
            Stroke::Filled => canvas.rectangle(
                (at.0, at.1 - 4.0),
                (at.0 + width, at.1 + 4.0),
                colour,
                FILL_OPACITY,
            ),
            Stroke::Marked => {
                canvas.line(&line, colour, self.width.max(1.6), 1.0)?;
                canvas.disc(middle, 3.0, colour, 1.0)
            }
            Stroke::Solid | Stroke::Step => canvas.line(&line, colour, self.width.max(1.6), 1.0),
        }
    }

    /// The series in pixels, broken where a point has none.
    fn runs(&self, x: &Axis, y: &Axis, ordered: bool) -> Vec<Vec<Pixel>> {
        let mut runs = vec![Vec::new()];
        for (a, b) in &self.points {
            let pixel = x.pixel(*a).zip(y.pixel(*b));
            let Some(run) = runs.last_mut() else { break };
            match pixel {
                Some(pixel) => {
                    if self.stroke == Stroke::Step
                        && let Some(previous) = run.last().copied()
                    {
                        let previous: Pixel = previous;
                        run.push((pixel.0, previous.1));
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

    fn dots(
        &self,
        canvas: &Canvas<'_>,
        frame: Frame,
        run: &[Pixel],
        colour: Colour,
    ) -> Result<(), PlotError> {
        for point in run.iter().filter(|p| frame.holds(**p)) {
            canvas.disc(*point, self.width * 1.5, colour, 0.9)?;
        }
        Ok(())
    }

    fn surface(
        &self,
        canvas: &Canvas<'_>,
        frame: Frame,
        run: &[Pixel],
        colour: Colour,
    ) -> Result<(), PlotError> {
        for piece in frame.clip(run) {
            let (Some(first), Some(last)) = (piece.first(), piece.last()) else {
                continue;
            };
            let mut corners = piece.clone();
            corners.push((last.0, frame.bottom));
            corners.push((first.0, frame.bottom));
            canvas.polygon(&corners, colour, FILL_OPACITY)?;
            canvas.line(&piece, colour, self.width, 1.0)?;
        }
        Ok(())
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
    fn holds(&self, (x, y): Pixel) -> bool {
        (self.left - 0.5..=self.right + 0.5).contains(&x)
            && (self.top - 0.5..=self.bottom + 0.5).contains(&y)
    }

    /// The pieces of a polyline that lie inside.
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

    /// Liang and Barsky's clipping of one segment.
    fn clip_segment(&self, a: Pixel, b: Pixel) -> Option<(Pixel, Pixel)> {
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let edges = [
            (-dx, a.0 - self.left),
            (dx, self.right - a.0),
            (-dy, a.1 - self.top),
            (dy, self.bottom - a.1),
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
        let at = |share: f64| (a.0 + dx * share, a.1 + dy * share);
        (enter <= leave).then(|| {
            (if enter > 0.0 { at(enter) } else { a }, if leave < 1.0 { at(leave) } else { b })
        })
    }
}

/// Keeps first, lowest, highest and last of the points that share half a pixel column.
fn thin(run: &[Pixel]) -> Vec<Pixel> {
    if run.len() < 4000 {
        return run.to_vec();
    }
    let column = |p: &Pixel| (p.0 * 2.0).floor();
    let mut thinned = Vec::new();
    for group in run.chunk_by(|a, b| column(a) == column(b)) {
        let indices = 0..group.len();
        let low = indices.clone().min_by(|a, b| group[*a].1.total_cmp(&group[*b].1)).unwrap_or(0);
        let high = indices.max_by(|a, b| group[*a].1.total_cmp(&group[*b].1)).unwrap_or(0);
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

    #[test]
    fn a_line_through_the_frame_is_cut_at_its_edges() {
        let pieces = FRAME.clip(&[(-5.0, 5.0), (15.0, 5.0)]);
        assert_eq!(pieces, [[(0.0, 5.0), (10.0, 5.0)]]);
    }

    #[test]
    fn a_line_that_leaves_and_returns_becomes_two_pieces() {
        let pieces = FRAME.clip(&[(5.0, 5.0), (5.0, 15.0), (8.0, 15.0), (8.0, 5.0)]);
        assert_eq!(pieces.len(), 2);
    }

    #[test]
    fn thinning_keeps_the_peaks() {
        let mut run: Vec<Pixel> =
            (0..100_000).map(|i| (f64::from(i) * 0.005, f64::from(i % 7))).collect();
        run[54_321].1 = 1e3;
        let thinned = thin(&run);
        assert!(thinned.len() < 5000 && thinned.iter().any(|p| p.1 == 1e3));
    }
}
