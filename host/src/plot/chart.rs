//! Line charts: stacked panels over one horizontal axis.

use super::axis::{Axis, Scale, range_of};
use super::canvas::{Align, Canvas, Text, text_width};
use super::series::{Frame, Series};
use super::{Colour, Figure, PlotError, colour};

/// Size of the title, logical pixels per em.
pub(super) const TITLE: f64 = 17.0;
/// Size of subtitles, panel labels and legends.
pub(super) const LABEL: f64 = 12.5;
/// Size of the ticks' numbers.
pub(super) const TICK: f64 = 11.0;
/// White space around everything.
pub(super) const MARGIN: f64 = 18.0;
/// Room for the numbers left of a panel.
const TICK_COLUMN: f64 = 58.0;
/// Room for a panel's own label and legend above it.
const HEADING: f64 = 26.0;
/// Room for the numbers and the label below the last panel.
const FOOT: f64 = 46.0;

/// One or several panels, one above the other, that share their horizontal axis.
#[derive(Debug, Clone)]
pub struct Chart {
    title: String,
    subtitle: String,
    x_label: String,
    x_range: Option<(f64, f64)>,
    x_scale: Scale,
    panels: Vec<Panel>,
    width: f64,
}

/// One plot of a [`Chart`].
#[derive(Debug, Clone)]
pub struct Panel {
    label: String,
    series: Vec<Series>,
    range: Option<(f64, f64)>,
    scale: Scale,
    height: f64,
    rules: Vec<(f64, String)>,
    spans: Vec<Span>,
}

/// A stretch of the horizontal axis that is shaded and named.
#[derive(Debug, Clone)]
struct Span {
    from: f64,
    to: f64,
    label: String,
    colour: Colour,
}

impl Chart {
    /// An empty chart; `x_label` names the horizontal axis with its unit.
    pub fn new(title: impl Into<String>, x_label: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            x_label: x_label.into(),
            x_range: None,
            x_scale: Scale::Linear,
            panels: Vec::new(),
            width: 1000.0,
        }
    }

    /// A quieter line under the title: what, when, with which settings.
    #[must_use]
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Shows exactly this range instead of all data.
    #[must_use]
    pub fn x_range(mut self, from: f64, to: f64) -> Self {
        self.x_range = Some((from, to));
        self
    }

    /// Spreads the horizontal axis logarithmically.
    #[must_use]
    pub fn x_logarithmic(mut self) -> Self {
        self.x_scale = Scale::Logarithmic;
        self
    }

    /// Makes the figure this wide (logical pixels; 1000 unless told).
    #[must_use]
    pub fn width(mut self, pixels: f64) -> Self {
        self.width = pixels;
        self
    }

    /// Adds a panel below the others.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    fn shown_x_range(&self) -> (f64, f64) {
        let all = self.panels.iter().flat_map(|p| &p.series).flat_map(|s| &s.points).map(|p| p.0);
        let margin = if self.x_scale == Scale::Logarithmic { 0.03 } else { 0.0 };
        self.x_range.or_else(|| range_of(all, self.x_scale, margin)).unwrap_or((0.0, 1.0))
    }
}

impl Panel {
    /// An empty panel; `label` names its vertical axis with the unit.
    pub fn new(label: impl Into<String>) -> Self {
        Self {
            label: label.into(),
            series: Vec::new(),
            range: None,
            scale: Scale::Linear,
            height: 150.0,
            rules: Vec::new(),
            spans: Vec::new(),
        }
    }

    /// Adds a series; later ones lie on top.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Shows exactly this range instead of all data.
    #[must_use]
    pub fn range(mut self, low: f64, high: f64) -> Self {
        self.range = Some((low, high));
        self
    }

    /// Spreads the vertical axis logarithmically.
    #[must_use]
    pub fn logarithmic(mut self) -> Self {
        self.scale = Scale::Logarithmic;
        self
    }

    /// Makes the panel this high (logical pixels; 150 unless told).
    #[must_use]
    pub fn height(mut self, pixels: f64) -> Self {
        self.height = pixels;
        self
    }

    /// A horizontal line at a limit or a target, with its name.
    #[must_use]
    pub fn rule(mut self, at: f64, label: impl Into<String>) -> Self {
        self.rules.push((at, label.into()));
        self
    }

    /// Shades a stretch of the horizontal axis and names it.
    #[must_use]
    pub fn span(mut self, from: f64, to: f64, label: impl Into<String>, colour: Colour) -> Self {
        self.spans.push(Span { from, to, label: label.into(), colour });
        self
    }

    fn shown_range(&self) -> (f64, f64) {
        let values = self.series.iter().flat_map(|s| &s.points).map(|p| p.1);
        self.range
            .or_else(|| range_of(values.chain(self.rules.iter().map(|r| r.0)), self.scale, 0.06))
            .unwrap_or((0.0, 1.0))
    }

    fn draw(&self, canvas: &Canvas<'_>, x: &Axis, frame: Frame) -> Result<(), PlotError> {
        let y = Axis::new(self.shown_range(), self.scale, frame.bottom, frame.top);
        self.draw_spans(canvas, x, frame)?;
        draw_grid(canvas, (x, &y), frame)?;
        for (index, series) in self.series.iter().enumerate() {
            series.draw(canvas, (x, &y), frame, colour_of(series, index), true)?;
        }
        for (at, label) in &self.rules {
            draw_rule(canvas, &y, frame, *at, label)?;
        }
        let heading = frame.top - HEADING / 2.0 - 1.0;
        canvas.text((frame.left, heading), &self.label, label_text(colour::INK, true))?;
        draw_legend(canvas, &self.series, frame.right, heading)
    }

    fn draw_spans(&self, canvas: &Canvas<'_>, x: &Axis, frame: Frame) -> Result<(), PlotError> {
        for span in &self.spans {
            let (Some(from), Some(to)) = (x.pixel(span.from), x.pixel(span.to)) else {
                continue;
            };
            let (from, to) = (from.max(frame.left), to.min(frame.right));
            if from >= to {
                continue;
            }
            canvas.rectangle((from, frame.top), (to, frame.bottom), span.colour, 0.13)?;
            if text_width(&span.label, TICK, false) < to - from {
                let look = Text { align: Align::Centre, ..tick_text(span.colour) };
                canvas.text(((from + to) / 2.0, frame.top + 10.0), &span.label, look)?;
            }
        }
        Ok(())
    }
}

impl Figure for Chart {
    fn size(&self) -> (f64, f64) {
        let panels: f64 = self.panels.iter().map(|p| p.height + HEADING).sum();
        (self.width, title_height(&self.title, &self.subtitle) + panels + FOOT + MARGIN / 2.0)
    }

    fn draw(&self, canvas: &Canvas<'_>) -> Result<(), PlotError> {
        draw_title(canvas, &self.title, &self.subtitle)?;
        let (left, right) = (MARGIN + TICK_COLUMN, self.width - MARGIN - 6.0);
        let x = Axis::new(self.shown_x_range(), self.x_scale, left, right);
        let mut top = title_height(&self.title, &self.subtitle);
        for panel in &self.panels {
            let frame =
                Frame { left, right, top: top + HEADING, bottom: top + HEADING + panel.height };
            panel.draw(canvas, &x, frame)?;
            top = frame.bottom;
        }
        draw_x_ticks(canvas, &x, top, 80.0)?;
        let look = Text { align: Align::Centre, ..label_text(colour::MUTED, false) };
        canvas.text(((left + right) / 2.0, top + 34.0), &self.x_label, look)
    }
}

pub(super) fn title_height(title: &str, subtitle: &str) -> f64 {
    let line = |text: &str, height: f64| if text.is_empty() { 0.0 } else { height };
    MARGIN * 0.7 + line(title, 26.0) + line(subtitle, 20.0)
}

pub(super) fn draw_title(
    canvas: &Canvas<'_>,
    title: &str,
    subtitle: &str,
) -> Result<(), PlotError> {
    let look = Text { size: TITLE, ..label_text(colour::INK, true) };
    canvas.text((MARGIN, MARGIN * 0.7 + 12.0), title, look)?;
    let below = title_height(title, "");
    canvas.text((MARGIN, below + 9.0), subtitle, label_text(colour::MUTED, false))
}

pub(super) fn label_text(colour: Colour, bold: bool) -> Text {
    Text { size: LABEL, colour, bold, align: Align::Left }
}

pub(super) fn tick_text(colour: Colour) -> Text {
    Text { size: TICK, colour, bold: false, align: Align::Left }
}

pub(super) fn colour_of(series: &Series, index: usize) -> Colour {
    series.colour.unwrap_or(colour::CYCLE[index % colour::CYCLE.len()])
}

/// Grid, the numbers of the vertical axis, and the frame.
pub(super) fn draw_grid(
    canvas: &Canvas<'_>,
    (x, y): (&Axis, &Axis),
    frame: Frame,
) -> Result<(), PlotError> {
    for (at, _) in x.ticks(80.0) {
        canvas.line(&[(at, frame.top), (at, frame.bottom)], colour::GRID, 1.0, 1.0)?;
    }
    for (at, text) in y.ticks(34.0) {
        canvas.line(&[(frame.left, at), (frame.right, at)], colour::GRID, 1.0, 1.0)?;
        let look = Text { align: Align::Right, ..tick_text(colour::MUTED) };
        canvas.text((frame.left - 8.0, at), &text, look)?;
    }
    let Frame { left, top, right, bottom } = frame;
    let outline = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
    canvas.line(&outline, colour::FRAME, 1.0, 1.0)
}

/// The numbers of the horizontal axis below `bottom`.
pub(super) fn draw_x_ticks(
    canvas: &Canvas<'_>,
    x: &Axis,
    bottom: f64,
    spacing: f64,
) -> Result<(), PlotError> {
    for (at, text) in x.ticks(spacing) {
        canvas.line(&[(at, bottom), (at, bottom + 4.0)], colour::FRAME, 1.0, 1.0)?;
        let look = Text { align: Align::Centre, ..tick_text(colour::MUTED) };
        canvas.text((at, bottom + 14.0), &text, look)?;
    }
    Ok(())
}

/// Names the series in one row that ends at `right`.
pub(super) fn draw_legend(
    canvas: &Canvas<'_>,
    series: &[Series],
    right: f64,
    y: f64,
) -> Result<(), PlotError> {
    const SAMPLE: f64 = 20.0;
    let mut end = right;
    for (index, one) in series.iter().enumerate().rev().filter(|(_, s)| !s.label.is_empty()) {
        let begin = end - text_width(&one.label, LABEL, false) - SAMPLE - 6.0;
        one.draw_sample(canvas, (begin, y), SAMPLE, colour_of(one, index))?;
        canvas.text((begin + SAMPLE + 6.0, y), &one.label, label_text(colour::INK, false))?;
        end = begin - 16.0;
    }
    Ok(())
}

fn draw_rule(
    canvas: &Canvas<'_>,
    y: &Axis,
    frame: Frame,
    at: f64,
    label: &str,
) -> Result<(), PlotError> {
    let Some(pixel) = y.pixel(at) else {
        return Ok(());
    };
    if pixel < frame.top || pixel > frame.bottom {
        return Ok(());
    }
    canvas.dashed(&[(frame.left, pixel), (frame.right, pixel)], (2.0, 3.0), colour::RED, 1.1)?;
    let above = if pixel - frame.top > 18.0 { -9.0 } else { 10.0 };
    let width = text_width(label, TICK, false);
    canvas.rectangle(
        (frame.right - width - 8.0, pixel + above - 7.0),
        (frame.right - 4.0, pixel + above + 7.0),
        colour::WHITE,
        0.8,
    )?;
    let look = Text { align: Align::Right, ..tick_text(colour::RED) };
    canvas.text((frame.right - 6.0, pixel + above), label, look)
}
