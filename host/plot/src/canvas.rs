//! Writes the few shapes of a figure as SVG, in logical pixels.

use std::fmt::Write;
use std::sync::OnceLock;

use ab_glyph::{Font, FontRef};

use super::Colour;
use flix_host::text::printable;

/// Font family in the SVG: the embedded font, then one of the same widths, then any.
const FONT: &str = "DejaVu Sans, Verdana, sans-serif";

/// A point of the page, logical pixels, y downwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pixel {
    pub(super) x: f64,
    pub(super) y: f64,
}

impl Pixel {
    pub(super) const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Returns the pixel `dx` to the right and `dy` below.
    pub(super) fn moved(self, dx: f64, dy: f64) -> Self {
        Self::new(self.x + dx, self.y + dy)
    }
}

/// Width and height, logical pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Width, logical pixels.
    pub width: f64,
    /// Height, logical pixels.
    pub height: f64,
}

/// Horizontal position of a text relative to its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Align {
    /// The text begins at the point.
    Left,
    /// The text is centred on the point.
    Centre,
    /// The text ends at the point.
    Right,
}

/// Style of a text.
#[derive(Debug, Clone, Copy)]
pub(super) struct Text {
    /// Size of the font, logical pixels per em.
    pub(super) size: f64,
    /// Colour.
    pub(super) colour: Colour,
    /// Weight.
    pub(super) bold: bool,
    /// Horizontal alignment; vertically a text is centred on its point.
    pub(super) align: Align,
}

/// Style of a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pen {
    colour: Colour,
    width: f64,
    opacity: f64,
    dashes: Option<[f64; 2]>,
}

impl Pen {
    /// Creates a solid opaque line of this width, logical pixels.
    pub(super) const fn new(colour: Colour, width: f64) -> Self {
        Self { colour, width, opacity: 1.0, dashes: None }
    }

    /// Sets the opacity, 0 to 1.
    pub(super) const fn opacity(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// Sets dashes and gaps of these lengths, logical pixels.
    pub(super) const fn dashed(self, dash: f64, gap: f64) -> Self {
        Self { dashes: Some([dash, gap]), ..self }
    }
}

/// An SVG document under construction.
pub struct Canvas {
    svg: String,
}

impl Canvas {
    /// Starts a white page.
    pub(super) fn new(Size { width, height }: Size) -> Self {
        let mut canvas = Self { svg: String::new() };
        canvas.write(format_args!(
            "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"{FONT}\" stroke-linejoin=\"round\" stroke-linecap=\"round\" \
             xmlns=\"http://www.w3.org/2000/svg\">"
        ));
        canvas.rectangle(
            Pixel::new(0.0, 0.0),
            Pixel::new(width, height),
            super::colour::WHITE,
            1.0,
        );
        canvas
    }

    /// Ends the document and returns it.
    pub(super) fn finish(mut self) -> String {
        self.svg.push_str("</svg>\n");
        self.svg
    }

    /// Draws a polyline.
    pub(super) fn line(&mut self, points: &[Pixel], pen: Pen) {
        if points.len() < 2 {
            return;
        }
        let Pen { colour, width, opacity, dashes } = pen;
        self.write(format_args!(
            "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"{}\" stroke-opacity=\"{}\"",
            rounded(width),
            rounded(opacity)
        ));
        if let Some([dash, gap]) = dashes {
            self.write(format_args!(" stroke-dasharray=\"{dash} {gap}\""));
        }
        self.points(points);
    }

    /// Draws a filled polygon; `opacity` 0 to 1, as for all fillings.
    pub(super) fn polygon(&mut self, corners: &[Pixel], colour: Colour, opacity: f64) {
        self.write(format_args!(
            "<polygon fill=\"{colour}\" fill-opacity=\"{}\"",
            rounded(opacity)
        ));
        self.points(corners);
    }

    /// Draws a filled rectangle between its upper left and its lower right corner.
    pub(super) fn rectangle(&mut self, a: Pixel, b: Pixel, colour: Colour, opacity: f64) {
        self.write(format_args!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{colour}\" \
             fill-opacity=\"{}\"/>\n",
            rounded(a.x),
            rounded(a.y),
            rounded(b.x - a.x),
            rounded(b.y - a.y),
            rounded(opacity)
        ));
    }

    /// Draws a filled disc.
    pub(super) fn disc(&mut self, centre: Pixel, radius: f64, colour: Colour, opacity: f64) {
        self.write(format_args!(
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"{colour}\" fill-opacity=\"{}\"/>\n",
            rounded(centre.x),
            rounded(centre.y),
            rounded(radius),
            rounded(opacity)
        ));
    }

    /// Writes one line of text, vertically centred on `at`.
    pub(super) fn text(&mut self, at: Pixel, text: &str, Text { size, colour, bold, align }: Text) {
        if text.is_empty() {
            return;
        }
        let anchor = match align {
            Align::Left => "start",
            Align::Centre => "middle",
            Align::Right => "end",
        };
        let weight = if bold { "bold" } else { "normal" };
        self.write(format_args!(
            "<text x=\"{}\" y=\"{}\" dy=\"0.5ex\" text-anchor=\"{anchor}\" font-size=\"{size}\" \
             font-weight=\"{weight}\" fill=\"{colour}\">{}</text>\n",
            rounded(at.x),
            rounded(at.y),
            escaped(text)
        ));
    }

    fn points(&mut self, points: &[Pixel]) {
        self.svg.push_str(" points=\"");
        for Pixel { x, y } in points {
            self.write(format_args!("{},{} ", rounded(*x), rounded(*y)));
        }
        self.svg.push_str("\"/>\n");
    }

    fn write(&mut self, text: std::fmt::Arguments<'_>) {
        // Writing to a string does not fail.
        let _ = self.svg.write_fmt(text);
    }
}

/// A hundredth of a pixel is far below what can be seen, and keeps the file small.
fn rounded(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// Returns a text in which XML finds no markup.
fn escaped(text: &str) -> String {
    printable(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Returns the embedded font.
pub(super) fn font(bold: bool) -> Option<&'static FontRef<'static>> {
    static FONTS: OnceLock<Option<[FontRef<'static>; 2]>> = OnceLock::new();
    let fonts = FONTS.get_or_init(|| {
        let font = |data| FontRef::try_from_slice(data).ok();
        Some([font(dejavu::sans::regular())?, font(dejavu::sans::bold())?])
    });
    fonts.as_ref().map(|fonts| &fonts[usize::from(bold)])
}

/// Returns the width of a text in logical pixels.
pub(super) fn text_width(text: &str, size: f64, bold: bool) -> f64 {
    let ems = |font: &FontRef<'_>| -> Option<f32> {
        let units = text.chars().map(|c| font.h_advance_unscaled(font.glyph_id(c))).sum::<f32>();
        Some(units / font.units_per_em()?)
    };
    // Without the font (it is embedded) 0.6 em per letter is a fair estimate.
    let estimate = text.chars().count() as f32 * 0.6;
    f64::from(font(bold).and_then(ems).unwrap_or(estimate)) * size
}
