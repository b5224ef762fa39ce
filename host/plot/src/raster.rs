//! Rasterises what [`Canvas`](super::Canvas) writes: rectangles, polylines, polygons, discs and lines of text.
//!
//! A renderer of all of SVG costs a fifth of what there is to compile; five shapes are all that a figure has.

use std::str::FromStr;

use ab_glyph::{Font, FontRef, OutlineCurve};
use roxmltree::{Document, Node};
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, StrokeDash,
    Transform,
};

use super::{PNG_DENSITY, PlotError, canvas};

/// Converts a figure's SVG to PNG with the embedded fonts; fonts of the machine are not used.
///
/// # Errors
/// When it is not SVG of a figure, or too large.
pub fn rasterise(svg: &str) -> Result<Vec<u8>, PlotError> {
    let failed = |e: &dyn std::fmt::Display| PlotError::Rasterise(e.to_string());
    let document = Document::parse(svg).map_err(|e| failed(&e))?;
    let root = document.root_element();
    let size = |name| number(root, name).ok_or_else(|| failed(&format!("no {name}")));
    let pixels = |logical: f32| (logical * PNG_DENSITY).ceil().max(1.0) as u32;
    let mut map = Pixmap::new(pixels(size("width")?), pixels(size("height")?))
        .ok_or_else(|| failed(&"it is too large"))?;
    map.fill(Color::WHITE);
    for shape in root.children().filter(Node::is_element) {
        draw(&mut map, shape);
    }
    map.encode_png().map_err(|e| failed(&e))
}

/// Draws one element; one without an extent draws nothing.
fn draw(map: &mut Pixmap, shape: Node<'_, '_>) -> Option<()> {
    let scale = Transform::from_scale(PNG_DENSITY, PNG_DENSITY);
    let of = |name| number(shape, name);
    let path = match shape.tag_name().name() {
        "rect" => PathBuilder::from_rect(Rect::from_xywh(
            of("x")?,
            of("y")?,
            of("width")?,
            of("height")?,
        )?),
        "circle" => PathBuilder::from_circle(of("cx")?, of("cy")?, of("r")?)?,
        "polygon" => points(shape, true)?,
        "polyline" => {
            let dash = shape.attribute("stroke-dasharray").and_then(|lengths| {
                StrokeDash::new(lengths.split(' ').filter_map(|it| it.parse().ok()).collect(), 0.0)
            });
            let stroke = Stroke {
                width: of("stroke-width")?,
                line_cap: LineCap::Round,
                line_join: LineJoin::Round,
                dash,
                ..Stroke::default()
            };
            let paint = paint(shape, "stroke", "stroke-opacity")?;
            map.stroke_path(&points(shape, false)?, &paint, &stroke, scale, None);
            return Some(());
        }
        "text" => text(shape)?,
        _ => return None,
    };
    map.fill_path(&path, &paint(shape, "fill", "fill-opacity")?, FillRule::Winding, scale, None);
    Some(())
}

fn number(shape: Node<'_, '_>, name: &str) -> Option<f32> {
    shape.attribute(name).and_then(|text| f32::from_str(text).ok())
}

/// Returns the colour `#rrggbb` with its opacity.
fn paint(shape: Node<'_, '_>, colour: &str, opacity: &str) -> Option<Paint<'static>> {
    let rgb = u32::from_str_radix(shape.attribute(colour)?.strip_prefix('#')?, 16).ok()?;
    let [_, red, green, blue] = rgb.to_be_bytes();
    let alpha = number(shape, opacity).unwrap_or(1.0).clamp(0.0, 1.0);
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (alpha * 255.0).round() as u8);
    Some(paint)
}

fn points(shape: Node<'_, '_>, closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for point in shape.attribute("points")?.split_whitespace() {
        let (x, y) = point.split_once(',')?;
        let (x, y) = (x.parse().ok()?, y.parse().ok()?);
        if path.is_empty() { path.move_to(x, y) } else { path.line_to(x, y) }
    }
    if closed {
        path.close();
    }
    path.finish()
}

/// Returns the outlines of a line of text.
fn text(shape: Node<'_, '_>) -> Option<Path> {
    let (text, size) = (shape.text()?, number(shape, "font-size")?);
    let bold = shape.attribute("font-weight") == Some("bold");
    let font: &FontRef<'_> = canvas::font(bold)?;
    let scale = size / font.units_per_em()?;
    let width = canvas::text_width(text, f64::from(size), bold) as f32;
    let mut x = number(shape, "x")?
        - match shape.attribute("text-anchor") {
            Some("middle") => width / 2.0,
            Some("end") => width,
            _ => 0.0,
        };
    // Half of the height of an x, which counts as half an em: what `dy="0.5ex"` asks for.
    let y = number(shape, "y")? + size / 4.0;
    let mut path = PathBuilder::new();
    for c in text.chars() {
        let glyph = font.glyph_id(c);
        let mut last = None;
        for curve in font.outline(glyph).into_iter().flat_map(|outline| outline.curves) {
            let at = |p: ab_glyph::Point| (x + p.x * scale, y - p.y * scale);
            let (from, to) = match &curve {
                OutlineCurve::Line(from, to)
                | OutlineCurve::Quad(from, _, to)
                | OutlineCurve::Cubic(from, _, _, to) => (*from, *to),
            };
            if last != Some(from) {
                path.close();
                path.move_to(at(from).0, at(from).1);
            }
            last = Some(to);
            let (end_x, end_y) = at(to);
            match curve {
                OutlineCurve::Line(..) => path.line_to(end_x, end_y),
                OutlineCurve::Quad(_, by, _) => path.quad_to(at(by).0, at(by).1, end_x, end_y),
                OutlineCurve::Cubic(_, by, then, _) => {
                    path.cubic_to(at(by).0, at(by).1, at(then).0, at(then).1, end_x, end_y);
                }
            }
        }
        path.close();
        x += font.h_advance_unscaled(glyph) * scale;
    }
    path.finish()
}
