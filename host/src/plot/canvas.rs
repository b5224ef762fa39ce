//! Drawing primitives in logical pixels, on `plotters`' SVG backend.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, TextStyle, register_font};
use std::sync::OnceLock;

use super::{Colour, PlotError};

/// Steps of the backend's integer grid in one logical pixel: curves stay smooth in a backend of whole pixels.
const STEPS: f64 = 8.0;

/// What the SVG asks for: the embedded font, then one of the same widths, then anything.
const FONT: &str = "DejaVu Sans, Verdana, sans-serif";

/// `plotters` takes the size of a font as its line height, which for it is 1.24 em.
const LINE_HEIGHT_EM: f64 = 1.24;

/// Where a text stands against its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Align {
    /// The text begins at the point.
    Left,
    /// The text is centred on the point.
    Centre,
    /// The text ends at the point.
    Right,
}

/// How a text looks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Text {
    /// Height of the font, logical pixels per em.
    pub(super) size: f64,
    /// Colour.
    pub(super) colour: Colour,
    /// Weight.
    pub(super) bold: bool,
    /// Horizontal place against the point; vertically a text is centred on it.
    pub(super) align: Align,
}

/// An empty page and the few strokes that every figure is made of.
pub struct Canvas<'a> {
    area: DrawingArea<SVGBackend<'a>, Shift>,
}

/// A point, logical pixels, y downwards.
pub(super) type Pixel = (f64, f64);

impl Canvas<'_> {
    /// An SVG document of `size` logical pixels on which `draw` has drawn.
    pub(super) fn render(
        size: (f64, f64),
        draw: impl FnOnce(&Canvas<'_>) -> Result<(), PlotError>,
    ) -> Result<String, PlotError> {
        prepare_fonts()?;
        let steps = ((size.0 * STEPS) as u32, (size.1 * STEPS) as u32);
        let mut svg = String::new();
        {
            let canvas =
                Canvas { area: SVGBackend::with_string(&mut svg, steps).into_drawing_area() };
            canvas.area.fill(&WHITE).map_err(failed)?;
            draw(&canvas)?;
            canvas.area.present().map_err(failed)?;
        }
        // The backend counts in steps; a reader of the file wants the figure at its logical size.
        let body = svg.split_once('>').map_or("", |(_, body)| body);
        Ok(format!(
            "<svg width=\"{}\" height=\"{}\" viewBox=\"0 0 {} {}\" stroke-linejoin=\"round\" \
             stroke-linecap=\"round\" xmlns=\"http://www.w3.org/2000/svg\">{body}",
            size.0, size.1, steps.0, steps.1
        ))
    }

    /// A polyline; `opacity` 0 to 1, `width` in logical pixels.
    pub(super) fn line(
        &self,
        points: &[Pixel],
        colour: Colour,
        width: f64,
        opacity: f64,
    ) -> Result<(), PlotError> {
        if points.len() < 2 {
            return Ok(());
        }
        let style = shade(colour, opacity).stroke_width((width * STEPS).round().max(1.0) as u32);
        self.area
            .draw(&PathElement::new(points.iter().map(|p| step(*p)).collect::<Vec<_>>(), style))
            .map_err(failed)
    }

    /// A polyline in dashes of `on` and gaps of `off` logical pixels.
    pub(super) fn dashed(
        &self,
        points: &[Pixel],
        (on, off): (f64, f64),
        colour: Colour,
        width: f64,
    ) -> Result<(), PlotError> {
        for dash in dashes(points, on, off) {
            self.line(&dash, colour, width, 1.0)?;
        }
        Ok(())
    }

    /// A filled polygon.
    pub(super) fn polygon(
        &self,
        corners: &[Pixel],
        colour: Colour,
        opacity: f64,
    ) -> Result<(), PlotError> {
        let corners: Vec<_> = corners.iter().map(|p| step(*p)).collect();
        self.area.draw(&Polygon::new(corners, shade(colour, opacity).filled())).map_err(failed)
    }

    /// A filled rectangle between two corners.
    pub(super) fn rectangle(
        &self,
        a: Pixel,
        b: Pixel,
        colour: Colour,
        opacity: f64,
    ) -> Result<(), PlotError> {
        self.area
            .draw(&Rectangle::new([step(a), step(b)], shade(colour, opacity).filled()))
            .map_err(failed)
    }

    /// A filled disc.
    pub(super) fn disc(
        &self,
        centre: Pixel,
        radius: f64,
        colour: Colour,
        opacity: f64,
    ) -> Result<(), PlotError> {
        let radius = (radius * STEPS).round() as i32;
        self.area
            .draw(&Circle::new(step(centre), radius, shade(colour, opacity).filled()))
            .map_err(failed)
    }

    /// One line of text, vertically centred on `at`.
    pub(super) fn text(&self, at: Pixel, text: &str, look: Text) -> Result<(), PlotError> {
        let align = match look.align {
            Align::Left => HPos::Left,
            Align::Centre => HPos::Center,
            Align::Right => HPos::Right,
        };
        let colour = shade(look.colour, 1.0);
        let style = TextStyle::from(font(look.size * STEPS, look.bold))
            .color(&colour)
            .pos(Pos::new(align, VPos::Center));
        self.area.draw_text(text, &style, step(at)).map_err(failed)
    }
}

/// Width of a text in logical pixels.
pub(super) fn text_width(text: &str, size: f64, bold: bool) -> f64 {
    // Without the font (it is embedded, so this does not happen) half an em a letter is a fair guess.
    font(size * STEPS, bold)
        .box_size(text)
        .map_or(text.chars().count() as f64 * size * 0.6, |(w, _)| f64::from(w) / STEPS)
}

fn font(size: f64, bold: bool) -> FontDesc<'static> {
    let weight = if bold { FontStyle::Bold } else { FontStyle::Normal };
    FontDesc::new(FontFamily::Name(FONT), size * LINE_HEIGHT_EM, weight)
}

fn prepare_fonts() -> Result<(), PlotError> {
    static READY: OnceLock<bool> = OnceLock::new();
    let ready = *READY.get_or_init(|| {
        register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok()
            && register_font(FONT, FontStyle::Bold, dejavu::sans::bold()).is_ok()
    });
    if ready { Ok(()) } else { Err(PlotError::Draw("the embedded font is damaged".into())) }
}

fn step((x, y): Pixel) -> (i32, i32) {
    ((x * STEPS).round() as i32, (y * STEPS).round() as i32)
}

fn shade(colour: Colour, opacity: f64) -> RGBAColor {
    RGBAColor(colour.0, colour.1, colour.2, opacity)
}

fn failed<E: std::error::Error + Send + Sync>(error: DrawingAreaErrorKind<E>) -> PlotError {
    PlotError::Draw(error.to_string())
}

/// Cuts a polyline into its dashes.
fn dashes(points: &[Pixel], on: f64, off: f64) -> Vec<Vec<Pixel>> {
    let mut dashes = Vec::new();
    let mut dash: Vec<Pixel> = points.first().copied().into_iter().collect();
    let (mut drawing, mut left) = (true, on);
    for pair in points.windows(2) {
        let (mut from, to) = (pair[0], pair[1]);
        loop {
            let length = (to.0 - from.0).hypot(to.1 - from.1);
            if length < left {
                left -= length;
                if drawing {
                    dash.push(to);
                }
                break;
            }
            let share = left / length;
            from = (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
            if drawing {
                dash.push(from);
                dashes.push(std::mem::take(&mut dash));
            } else {
                dash = vec![from];
            }
            drawing = !drawing;
            left = if drawing { on } else { off };
        }
    }
    if drawing && dash.len() > 1 {
        dashes.push(dash);
    }
    dashes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_cover_their_share_of_the_line() {
        let line = [(0.0, 0.0), (7.0, 0.0), (7.0, 13.0)];
        let length: f64 = dashes(&line, 3.0, 2.0)
            .iter()
            .flat_map(|dash| dash.windows(2))
            .map(|p| (p[1].0 - p[0].0).hypot(p[1].1 - p[0].1))
            .sum();
        assert!((length - 12.0).abs() < 1e-9, "{length}");
    }
}
