//! Writes a page as an SVG document.

use std::fmt::{self, Write as _};

use flix_host::system::program;

use super::canvas::{Align, Canvas, Pen, Pixel, Shape, Text};

/// Font family: the embedded font, then one of the same widths, then any.
const FONT: &str = "DejaVu Sans, Verdana, sans-serif";

/// Returns the document.
pub(super) fn document(canvas: &Canvas) -> String {
    let (width, height) = (canvas.size.width, canvas.size.height);
    let mut svg = format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"{FONT}\" stroke-linejoin=\"round\" stroke-linecap=\"round\" \
         xmlns=\"http://www.w3.org/2000/svg\">\n<metadata>{}</metadata>\n",
        program::get()
    );
    for shape in &canvas.shapes {
        // Writing to a string does not fail.
        let _ = element(&mut svg, shape);
    }
    svg.push_str("</svg>\n");
    svg
}

fn element(svg: &mut String, shape: &Shape) -> fmt::Result {
    match shape {
        Shape::Line { points, pen: Pen { colour, width, opacity, dashes } } => {
            let (width, opacity) = (rounded(*width), rounded(*opacity));
            write!(
                svg,
                "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" \
                 stroke-opacity=\"{opacity}\""
            )?;
            if let Some([dash, gap]) = dashes {
                write!(svg, " stroke-dasharray=\"{dash} {gap}\"")?;
            }
            list(svg, points)
        }
        Shape::Polygon { corners, colour, opacity } => {
            write!(svg, "<polygon fill=\"{colour}\" fill-opacity=\"{}\"", rounded(*opacity))?;
            list(svg, corners)
        }
        Shape::Rectangle { corner, size, colour, opacity } => writeln!(
            svg,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{colour}\" \
             fill-opacity=\"{}\"/>",
            rounded(corner.x),
            rounded(corner.y),
            rounded(size.width),
            rounded(size.height),
            rounded(*opacity)
        ),
        Shape::Disc { centre, radius, colour, opacity } => writeln!(
            svg,
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"{colour}\" fill-opacity=\"{}\"/>",
            rounded(centre.x),
            rounded(centre.y),
            rounded(*radius),
            rounded(*opacity)
        ),
        Shape::Text { at, text, look: Text { size, colour, bold, align } } => {
            let anchor = match align {
                Align::Left => "start",
                Align::Centre => "middle",
                Align::Right => "end",
            };
            let weight = if *bold { "bold" } else { "normal" };
            writeln!(
                svg,
                "<text x=\"{}\" y=\"{}\" dy=\"0.5ex\" text-anchor=\"{anchor}\" font-size=\"{size}\" \
                 font-weight=\"{weight}\" fill=\"{colour}\">{}</text>",
                rounded(at.x),
                rounded(at.y),
                escaped(text)
            )
        }
    }
}

fn list(svg: &mut String, points: &[Pixel]) -> fmt::Result {
    svg.push_str(" points=\"");
    for Pixel { x, y } in points {
        write!(svg, "{},{} ", rounded(*x), rounded(*y))?;
    }
    svg.push_str("\"/>\n");
    Ok(())
}

/// A hundredth of a pixel is far below what can be seen, and keeps the file small.
fn rounded(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// Returns a text in which XML finds no markup.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
