//! Text of strangers: of robots, trackers, serial devices and whoever answers in the network. Shown as it comes it could
//! move a terminal's cursor, rename its window, or add lines that look like the program's own.

use std::borrow::Cow;
use std::path::Path;

use flix_protocol::network_name::is_seen;

/// What stands for a character that is not shown; no longer than any of them.
const HIDDEN: char = '?';

/// Returns a text of one line as it may be shown: what controls a terminal (C0 and C1, line ends among them), what turns
/// the direction of a text, and what takes no room, become `?`.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    hide(text, is_seen)
}

/// Returns a text of several lines as [`printable`] does, with its line ends and tabs.
#[must_use]
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    hide(text, |letter| is_seen(letter) || matches!(letter, '\n' | '\t'))
}

/// Returns a path as [`printable`] shows a text: a file's name may hold line ends.
#[must_use]
pub fn shown(path: &Path) -> String {
    printable(&path.display().to_string()).into_owned()
}

fn hide(text: &str, is_shown: fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(is_shown) {
        return Cow::Borrowed(text);
    }
    let shown = text.chars().map(|letter| if is_shown(letter) { letter } else { HIDDEN });
    Cow::Owned(shown.collect())
}

/// Returns a number with so many decimals, and never a negative zero.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|c| matches!(c, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_steers_a_terminal_is_shown() {
        for hostile in [
            "\x1b[31m",
            "\x1b]0;title\x07",
            "\u{9b}2J",
            "a\r\nflix: all is well",
            "\u{202e}gnp",
            "\x7f",
        ] {
            for shown in [printable(hostile), printable_lines(hostile)] {
                assert!(!shown.contains(|c: char| c.is_control() && c != '\n'), "{shown:?}");
                assert!(!shown.contains('\u{202e}'), "{shown:?}");
            }
            assert!(!printable(hostile).contains('\n'));
        }
        for text in ["MKS DUAL FOC V3.3 PLUS", "Käfer 25 µm", "歩く"] {
            assert_eq!(printable(text), text);
        }
        assert_eq!(printable_lines("a\tb\nc"), "a\tb\nc");
    }

    #[test]
    fn no_zero_is_negative() {
        let texts = [fixed(-0.0, 0), fixed(-0.004, 2), fixed(-0.006, 2), fixed(0.5, 1)];
        assert_eq!(texts, ["0", "0.00", "-0.01", "0.5"]);
    }
}
