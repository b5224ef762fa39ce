//! Lines of XML.

use std::fmt::Write;

/// Adds a line, so many steps in.
pub(super) fn line(out: &mut String, depth: usize, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{:indent$}{text}", "", indent = 2 * depth);
}

/// Returns a text as it may stand between quotation marks; control characters may not.
pub(super) fn escape(text: &str) -> String {
    let text: String = text.chars().filter(|it| !it.is_control()).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// Numbers in full precision.
pub(super) fn list(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| format!("{v}")).collect();
    words.join(" ")
}
