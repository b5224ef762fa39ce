//! The few shapes that a figure has, in logical pixels: [`svg`](super::svg) and [`raster`](super::raster) both draw
//! them.

use std::sync::OnceLock;

use ab_glyph::{Font, FontRef};
use flix_host::system::text::printable;

use super::Colour;

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
    pub(super) colour: Colour,
    pub(super) width: f64,
    pub(super) opacity: f64,
    /// Lengths of a dash and of a gap.
    pub(super) dashes: Option<[f64; 2]>,
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

/// One thing that is drawn. Fillings have an opacity of 0 to 1.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    Line { points: Vec<Pixel>, pen: Pen },
    Polygon { corners: Vec<Pixel>, colour: Colour, opacity: f64 },
    Rectangle { corner: Pixel, size: Size, colour: Colour, opacity: f64 },
    Disc { centre: Pixel, radius: f64, colour: Colour, opacity: f64 },
    Text { at: Pixel, text: String, look: Text },
}

/// A white page, and what is drawn on it so far.
pub struct Canvas {
    pub(super) size: Size,
    pub(super) shapes: Vec<Shape>,
}

impl Canvas {
    /// Starts a white page.
    pub(super) fn new(size: Size) -> Self {
        let mut canvas = Self { size, shapes: Vec::new() };
        let corners = [Pixel::new(0.0, 0.0), Pixel::new(size.width, size.height)];
        canvas.rectangle(corners[0], corners[1], super::colour::WHITE, 1.0);
        canvas
    }

    /// Draws a polyline.
    pub(super) fn line(&mut self, points: &[Pixel], pen: Pen) {
        if points.len() >= 2 {
            self.shapes.push(Shape::Line { points: points.to_vec(), pen });
        }
    }

    /// Draws a filled polygon.
    pub(super) fn polygon(&mut self, corners: &[Pixel], colour: Colour, opacity: f64) {
        self.shapes.push(Shape::Polygon { corners: corners.to_vec(), colour, opacity });
    }

    /// Draws a filled rectangle between its upper left and its lower right corner.
    pub(super) fn rectangle(&mut self, a: Pixel, b: Pixel, colour: Colour, opacity: f64) {
        let size = Size { width: b.x - a.x, height: b.y - a.y };
        self.shapes.push(Shape::Rectangle { corner: a, size, colour, opacity });
    }

    /// Draws a filled disc.
    pub(super) fn disc(&mut self, centre: Pixel, radius: f64, colour: Colour, opacity: f64) {
        self.shapes.push(Shape::Disc { centre, radius, colour, opacity });
    }

    /// Writes one line of text, vertically centred on `at`.
    pub(super) fn text(&mut self, at: Pixel, text: &str, look: Text) {
        if !text.is_empty() {
            let text = printable(text).into_owned();
            self.shapes.push(Shape::Text { at, text, look });
        }
    }
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
