//! Draws a page in pixels.
//!
//! A renderer of all of SVG costs a fifth of what there is to compile; five shapes are all that a figure has.

use ab_glyph::{Font as _, OutlineCurve};
use crc::{CRC_32_ISO_HDLC, Crc};
use flix_host::system::program;
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, StrokeDash,
    Transform,
};

use super::Colour;
use super::canvas::{self, Align, Canvas, Pen, Pixel, Shape, Text};

/// Pixels of the PNG for each logical pixel of the figure: sharp on dense screens and in print.
pub const PNG_DENSITY: f64 = 2.0;

/// Half of the height of an x, em: half of what SVG's `0.5ex` is in a font of which nothing is known.
const HALF_X_HEIGHT: f64 = 0.25;

/// Returns the page as PNG, with [`PNG_DENSITY`] pixels for each logical pixel.
///
/// # Errors
/// When it is too large; says so.
pub(super) fn png(canvas: &Canvas) -> Result<Vec<u8>, String> {
    let pixels = |logical: f64| (logical * PNG_DENSITY).ceil().max(1.0) as u32;
    let (width, height) = (pixels(canvas.size.width), pixels(canvas.size.height));
    let too_large = || format!("{width} x {height} pixels are too many");
    let mut map = Pixmap::new(width, height).ok_or_else(too_large)?;
    for shape in &canvas.shapes {
        draw(&mut map, shape);
    }
    let png = map.encode_png().map_err(|error| error.to_string())?;
    let text = ["Software\0", program::get()].concat();
    Ok(with_chunk(&png, *b"tEXt", text.as_bytes()))
}

/// Returns a PNG file with this chunk behind its header, which has the same length in each (PNG, third edition, 5.2 and 5.3).
fn with_chunk(png: &[u8], kind: [u8; 4], data: &[u8]) -> Vec<u8> {
    const HEADER: usize = 8 + 12 + 13;
    let (header, rest) = png.split_at(HEADER);
    let sums = Crc::<u32>::new(&CRC_32_ISO_HDLC);
    let mut sum = sums.digest();
    sum.update(&kind);
    sum.update(data);
    let length = u32::try_from(data.len()).unwrap_or_default();
    [header, &length.to_be_bytes(), &kind, data, &sum.finalize().to_be_bytes(), rest].concat()
}

/// Draws one shape; one without an extent draws nothing.
fn draw(map: &mut Pixmap, shape: &Shape) -> Option<()> {
    let scale = Transform::from_scale(PNG_DENSITY as f32, PNG_DENSITY as f32);
    let (path, paint) = match shape {
        Shape::Line { points, pen: Pen { colour, width, opacity, dashes } } => {
            let stroke = Stroke {
                width: *width as f32,
                line_cap: LineCap::Round,
                line_join: LineJoin::Round,
                dash: dashes.and_then(|it| StrokeDash::new(it.map(|l| l as f32).to_vec(), 0.0)),
                ..Stroke::default()
            };
            let path = polyline(points, false)?;
            map.stroke_path(&path, &paint(*colour, *opacity), &stroke, scale, None);
            return Some(());
        }
        Shape::Polygon { corners, colour, opacity } => {
            (polyline(corners, true)?, paint(*colour, *opacity))
        }
        Shape::Rectangle { corner, size, colour, opacity } => {
            let [x, y, width, height] = [corner.x, corner.y, size.width, size.height];
            let rectangle = Rect::from_xywh(x as f32, y as f32, width as f32, height as f32)?;
            (PathBuilder::from_rect(rectangle), paint(*colour, *opacity))
        }
        Shape::Disc { centre, radius, colour, opacity } => {
            let (x, y) = (centre.x as f32, centre.y as f32);
            (PathBuilder::from_circle(x, y, *radius as f32)?, paint(*colour, *opacity))
        }
        Shape::Text { at, text, look } => (outlines(*at, text, look)?, paint(look.colour, 1.0)),
    };
    map.fill_path(&path, &paint, FillRule::Winding, scale, None);
    Some(())
}

fn paint(Colour(red, green, blue): Colour, opacity: f64) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (opacity.clamp(0.0, 1.0) * 255.0).round() as u8);
    paint
}

fn polyline(points: &[Pixel], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for Pixel { x, y } in points {
        let (x, y) = (*x as f32, *y as f32);
        if path.is_empty() { path.move_to(x, y) } else { path.line_to(x, y) }
    }
    if closed {
        path.close();
    }
    path.finish()
}

/// Returns the outlines of a line of text.
fn outlines(at: Pixel, text: &str, look: &Text) -> Option<Path> {
    let font = canvas::font(look.bold)?;
    let scale = look.size as f32 / font.units_per_em()?;
    let width = canvas::text_width(text, look.size, look.bold);
    let begin = match look.align {
        Align::Left => 0.0,
        Align::Centre => width / 2.0,
        Align::Right => width,
    };
    let mut x = (at.x - begin) as f32;
    let y = (at.y + look.size * HALF_X_HEIGHT) as f32;
    let mut path = PathBuilder::new();
    for letter in text.chars() {
        let glyph = font.glyph_id(letter);
        let place = |point: ab_glyph::Point| (x + point.x * scale, y - point.y * scale);
        // A contour ends where the next curve begins elsewhere.
        let mut last = None;
        for curve in font.outline(glyph).into_iter().flat_map(|outline| outline.curves) {
            let (OutlineCurve::Line(from, to)
            | OutlineCurve::Quad(from, _, to)
            | OutlineCurve::Cubic(from, _, _, to)) = curve;
            if last != Some(from) {
                path.close();
                let (x, y) = place(from);
                path.move_to(x, y);
            }
            last = Some(to);
            let (end_x, end_y) = place(to);
            match curve {
                OutlineCurve::Line(..) => path.line_to(end_x, end_y),
                OutlineCurve::Quad(_, by, _) => {
                    let (x, y) = place(by);
                    path.quad_to(x, y, end_x, end_y);
                }
                OutlineCurve::Cubic(_, first, second, _) => {
                    let (first, second) = (place(first), place(second));
                    path.cubic_to(first.0, first.1, second.0, second.1, end_x, end_y);
                }
            }
        }
        path.close();
        x += font.h_advance_unscaled(glyph) * scale;
    }
    path.finish()
}
