//! Line charts: stacked panels over one horizontal axis.

use super::axis::{Axis, Limits, Scale, ended_at_ticks, range_of};
use super::canvas::{Align, Canvas, Pen, Pixel, Size, Text, text_width};
use super::series::{Frame, Series};
use super::{Colour, Figure, colour};

/// Size of the title, logical pixels per em.
pub(super) const TITLE: f64 = 17.0;
/// Size of subtitles, panel labels and legends.
pub(super) const LABEL: f64 = 12.5;
/// Size of the ticks' numbers.
pub(super) const TICK: f64 = 11.0;
/// White space around everything.
pub(super) const MARGIN: f64 = 18.0;
/// Least distance between two ticks of a vertical axis.
const TICK_SPACING: f64 = 34.0;
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
    x_range: Option<Limits>,
    x_scale: Scale,
    panels: Vec<Panel>,
    width: f64,
}

/// One plot of a [`Chart`].
#[derive(Debug, Clone)]
pub struct Panel {
    label: String,
    series: Vec<Series>,
    range: Option<Limits>,
    scale: Scale,
    height: f64,
    rules: Vec<(f64, String)>,
    spans: Vec<Span>,
}

/// A shaded and named interval of the horizontal axis.
#[derive(Debug, Clone)]
struct Span {
    from: f64,
    to: f64,
    label: String,
    colour: Colour,
}

impl Chart {
    /// Creates an empty chart; `x_label` names the horizontal axis with its unit.
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

    /// Sets the smaller line under the title.
    #[must_use]
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Sets the range of the horizontal axis; by default it shows all data.
    #[must_use]
    pub fn x_range(mut self, from: f64, to: f64) -> Self {
        self.x_range = Some(Limits::new(from, to));
        self
    }

    /// Puts the ticks of the horizontal axis, which is an angle in degrees, at parts of a turn.
    #[must_use]
    pub fn x_degrees(mut self) -> Self {
        self.x_scale = Scale::Degrees;
        self
    }

    /// Puts the ticks of the horizontal axis, which counts something, at whole numbers.
    #[must_use]
    pub fn x_whole(mut self) -> Self {
        self.x_scale = Scale::Whole;
        self
    }

    /// Names the places 1, 2 and so on of the horizontal axis.
    #[must_use]
    pub fn x_names(mut self, names: &'static [&'static str]) -> Self {
        self.x_scale = Scale::Names(names);
        self.x_range(0.5, names.len() as f64 + 0.5)
    }

    /// Sets the width of the figure, logical pixels (default 1000).
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

    fn shown_x_range(&self) -> Limits {
        let all = self.panels.iter().flat_map(|p| &p.series).flat_map(|s| &s.points).map(|p| p.x);
        let of_data = || range_of(all, self.x_scale, 0.0);
        self.x_range.or_else(of_data).unwrap_or(Limits::new(0.0, 1.0))
    }
}

impl Panel {
    /// Creates an empty panel; `label` names its vertical axis with the unit.
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

    /// Adds a series on top of the others.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Sets the range of the vertical axis; by default it shows all data.
    #[must_use]
    pub fn range(mut self, low: f64, high: f64) -> Self {
        self.range = Some(Limits::new(low, high));
        self
    }

    /// Makes the vertical axis logarithmic.
    #[must_use]
    pub fn logarithmic(mut self) -> Self {
        self.scale = Scale::Logarithmic;
        self
    }

    /// Puts the ticks of the vertical axis, which is an angle in degrees, at parts of a turn.
    #[must_use]
    pub fn degrees(mut self) -> Self {
        self.scale = Scale::Degrees;
        self
    }

    /// Sets the height of the panel, logical pixels (default 150).
    #[must_use]
    pub fn height(mut self, pixels: f64) -> Self {
        self.height = pixels;
        self
    }

    /// Adds a named horizontal line at a limit or a target.
    #[must_use]
    pub fn rule(mut self, at: f64, label: impl Into<String>) -> Self {
        self.rules.push((at, label.into()));
        self
    }

    /// Adds a shaded and named interval of the horizontal axis.
    #[must_use]
    pub fn span(mut self, from: f64, to: f64, label: impl Into<String>, colour: Colour) -> Self {
        self.spans.push(Span { from, to, label: label.into(), colour });
        self
    }

    fn shown_range(&self) -> Limits {
        let values = self.series.iter().flat_map(|s| &s.points).map(|p| p.y);
        let values = values.chain(self.rules.iter().map(|r| r.0));
        let of_data = || match self.scale {
            Scale::Degrees => range_of(values, self.scale, 0.0)
                .map(|range| ended_at_ticks(range, self.height / TICK_SPACING)),
            _ => range_of(values, self.scale, 0.06),
        };
        self.range.or_else(of_data).unwrap_or(Limits::new(0.0, 1.0))
    }

    fn draw(&self, canvas: &mut Canvas, x: &Axis, frame: Frame) {
        let y = Axis::new(self.shown_range(), self.scale, frame.bottom, frame.top);
        self.draw_spans(canvas, x, frame);
        draw_grid(canvas, (x, &y), frame);
        for (index, series) in self.series.iter().enumerate() {
            series.draw(canvas, (x, &y), frame, colour_of(series, index), true);
        }
        for (at, label) in &self.rules {
            draw_rule(canvas, &y, frame, *at, label);
        }
        let heading = frame.top - HEADING / 2.0 - 1.0;
        let at = Pixel::new(frame.left, heading);
        canvas.text(at, &self.label, label_text(colour::INK, true));
        draw_legend(canvas, &self.series, frame.right, heading);
    }

    fn draw_spans(&self, canvas: &mut Canvas, x: &Axis, frame: Frame) {
        for span in &self.spans {
            let (Some(from), Some(to)) = (x.pixel(span.from), x.pixel(span.to)) else {
                continue;
            };
            let (from, to) = (from.max(frame.left), to.min(frame.right));
            if from >= to {
                continue;
            }
            let corners = (Pixel::new(from, frame.top), Pixel::new(to, frame.bottom));
            canvas.rectangle(corners.0, corners.1, span.colour, 0.13);
            if text_width(&span.label, TICK, false) < to - from {
                let look = Text { align: Align::Centre, ..tick_text(span.colour) };
                let at = Pixel::new((from + to) / 2.0, frame.top + 10.0);
                canvas.text(at, &span.label, look);
            }
        }
    }
}

impl Figure for Chart {
    fn size(&self) -> Size {
        let panels: f64 = self.panels.iter().map(|p| p.height + HEADING).sum();
        let title = title_height(&self.title, &self.subtitle);
        Size { width: self.width, height: title + panels + FOOT + MARGIN / 2.0 }
    }

    fn draw(&self, canvas: &mut Canvas) {
        draw_title(canvas, &self.title, &self.subtitle);
        let (left, right) = (MARGIN + TICK_COLUMN, self.width - MARGIN - 6.0);
        let x = Axis::new(self.shown_x_range(), self.x_scale, left, right);
        let mut top = title_height(&self.title, &self.subtitle);
        for panel in &self.panels {
            let frame =
                Frame { left, right, top: top + HEADING, bottom: top + HEADING + panel.height };
            panel.draw(canvas, &x, frame);
            top = frame.bottom;
        }
        draw_x_ticks(canvas, &x, top, 80.0);
        let look = Text { align: Align::Centre, ..label_text(colour::MUTED, false) };
        canvas.text(Pixel::new((left + right) / 2.0, top + 34.0), &self.x_label, look);
    }
}

pub(super) fn title_height(title: &str, subtitle: &str) -> f64 {
    let line = |text: &str, height: f64| if text.is_empty() { 0.0 } else { height };
    MARGIN * 0.7 + line(title, 26.0) + line(subtitle, 20.0)
}

pub(super) fn draw_title(canvas: &mut Canvas, title: &str, subtitle: &str) {
    let look = Text { size: TITLE, ..label_text(colour::INK, true) };
    canvas.text(Pixel::new(MARGIN, MARGIN * 0.7 + 12.0), title, look);
    let below = title_height(title, "");
    canvas.text(Pixel::new(MARGIN, below + 9.0), subtitle, label_text(colour::MUTED, false));
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

/// Draws the grid, the numbers of the vertical axis, and the frame.
pub(super) fn draw_grid(canvas: &mut Canvas, (x, y): (&Axis, &Axis), frame: Frame) {
    for (at, _) in x.ticks(80.0) {
        let ends = [Pixel::new(at, frame.top), Pixel::new(at, frame.bottom)];
        canvas.line(&ends, Pen::new(colour::GRID, 1.0));
    }
    for (at, text) in y.ticks(TICK_SPACING) {
        let ends = [Pixel::new(frame.left, at), Pixel::new(frame.right, at)];
        canvas.line(&ends, Pen::new(colour::GRID, 1.0));
        let look = Text { align: Align::Right, ..tick_text(colour::MUTED) };
        canvas.text(ends[0].moved(-8.0, 0.0), &text, look);
    }
    let Frame { left, top, right, bottom } = frame;
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
    canvas.line(&corners.map(|(x, y)| Pixel::new(x, y)), Pen::new(colour::FRAME, 1.0));
}

/// Draws the numbers of the horizontal axis below `bottom`.
pub(super) fn draw_x_ticks(canvas: &mut Canvas, x: &Axis, bottom: f64, spacing: f64) {
    for (at, text) in x.ticks(spacing) {
        let ends = [Pixel::new(at, bottom), Pixel::new(at, bottom + 4.0)];
        canvas.line(&ends, Pen::new(colour::FRAME, 1.0));
        let look = Text { align: Align::Centre, ..tick_text(colour::MUTED) };
        canvas.text(Pixel::new(at, bottom + 14.0), &text, look);
    }
}

/// Draws the names of the series in one row that ends at `right`.
pub(super) fn draw_legend(canvas: &mut Canvas, series: &[Series], right: f64, y: f64) {
    const SAMPLE: f64 = 20.0;
    let mut end = right;
    for (index, one) in series.iter().enumerate().rev().filter(|(_, s)| !s.label.is_empty()) {
        let begin = end - text_width(&one.label, LABEL, false) - SAMPLE - 6.0;
        one.draw_sample(canvas, Pixel::new(begin, y), SAMPLE, colour_of(one, index));
        let at = Pixel::new(begin + SAMPLE + 6.0, y);
        canvas.text(at, &one.label, label_text(colour::INK, false));
        end = begin - 16.0;
    }
}

fn draw_rule(canvas: &mut Canvas, y: &Axis, frame: Frame, at: f64, label: &str) {
    let Some(pixel) = y.pixel(at) else {
        return;
    };
    if pixel < frame.top || pixel > frame.bottom {
        return;
    }
    let ends = [Pixel::new(frame.left, pixel), Pixel::new(frame.right, pixel)];
    canvas.line(&ends, Pen::new(colour::RED, 1.1).dashed(2.0, 3.0));
    let above = if pixel - frame.top > 18.0 { -9.0 } else { 10.0 };
    let width = text_width(label, TICK, false);
    let middle = ends[1].moved(0.0, above);
    let corners = (middle.moved(-width - 8.0, -7.0), middle.moved(-4.0, 7.0));
    canvas.rectangle(corners.0, corners.1, colour::WHITE, 0.8);
    let look = Text { align: Align::Right, ..tick_text(colour::RED) };
    canvas.text(middle.moved(-6.0, 0.0), label, look);
}
