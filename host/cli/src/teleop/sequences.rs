//! Splits the bytes of a terminal into keys and everything else.
//!
//! A control sequence goes from its introducer to its final byte (ECMA-48, 5.4), a control string to its terminator (5.6),
//! pasted text from `CSI 200 ~` to `CSI 201 ~` (xterm's control sequences, mode 2004). Each may come in pieces, and its end may
//! be lost: a sequence without an end after 0.2 s is reported as [broken off](Report::BrokenOff), and its bytes as the keys that they
//! may be, since a space bar may be among them. A sequence that another sequence interrupts is reported as broken off, too. An
//! introducer may be one byte (5.3), where that byte is no part of a character in UTF-8.

use std::borrow::Cow;
use std::time::Duration;

use ratatui::crossterm::event::KeyCode;
use terminput::Event;
use terminput_crossterm::to_crossterm_key;

use super::keyboard::Report;

const ESCAPE: u8 = 0x1b;
const BELL: u8 = 0x07;
const BACKSPACE: u8 = 0x08;
/// String terminator, as one byte.
const TERMINATOR: u8 = 0x9c;
/// What pasted text stands between, after the introducer.
const PASTE: (&[u8], [&[u8]; 2]) = (b"200~", [b"\x1b[201~", b"\x9b201~"]);
/// Longest time from the first byte of a sequence to its last.
const WHOLE: Duration = Duration::from_millis(200);
/// Time after which an escape begins nothing: it is the key.
const ALONE: Duration = Duration::from_millis(50);

/// What a terminal lets a program know.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Heard {
    /// Bytes, as they came.
    Bytes(Vec<u8>),
    /// What is known already.
    Report(Report),
}

/// The bytes of a terminal, as far as they are no whole sequence yet.
#[derive(Debug, Clone, Default)]
pub struct Sequences {
    pending: Vec<u8>,
    /// When the first of them came.
    since: Duration,
}

impl Sequences {
    /// Returns what bytes report that came at this time. Never panics.
    pub fn take(&mut self, at: Duration, bytes: &[u8]) -> Vec<Report> {
        let mut reports = self.settle(at);
        if self.pending.is_empty() {
            self.since = at;
        }
        self.pending.extend_from_slice(bytes);
        self.split(at, &mut reports);
        reports
    }

    /// Returns what bytes report that nothing followed by now.
    pub fn settle(&mut self, now: Duration) -> Vec<Report> {
        let mut reports = Vec::new();
        let is_alone = self.pending == [ESCAPE];
        let patience = if is_alone { ALONE } else { WHOLE };
        if self.pending.is_empty() || now.saturating_sub(self.since) < patience {
            return reports;
        }
        if is_alone {
            self.pending.clear();
            reports.extend(report(&[ESCAPE]));
        } else {
            let is_paste =
                self.pending.strip_prefix(b"\x1b[").is_some_and(|it| it.starts_with(PASTE.0));
            reports.push(Report::BrokenOff { is_paste });
            self.pending.remove(0);
            self.split(now, &mut reports);
        }
        reports
    }

    fn split(&mut self, at: Duration, reports: &mut Vec<Report>) {
        loop {
            if let Some(introducer) = self.pending.first().copied().and_then(in_seven_bits) {
                self.pending.splice(..1, introducer);
            }
            let Some(length) = length(&self.pending) else { return };
            let sequence: Vec<u8> = self.pending.drain(..length).collect();
            reports.extend(match is_whole(&sequence) {
                true => report(&sequence),
                false => Some(Report::BrokenOff { is_paste: false }),
            });
            self.since = at;
        }
    }
}

/// Returns an introducer or terminator of one byte in its form of two (ECMA-48, 5.3): SS3, DCS, SOS, CSI, ST, OSC, PM, APC.
fn in_seven_bits(byte: u8) -> Option<[u8; 2]> {
    matches!(byte, 0x8f | 0x90 | 0x98 | 0x9b..=0x9f).then(|| [ESCAPE, byte - 0x40])
}

/// Returns the length of the sequence or character that bytes begin with, 1 or more; None if that is not known yet.
fn length(bytes: &[u8]) -> Option<usize> {
    match bytes {
        [] | [ESCAPE] => None,
        [ESCAPE, ESCAPE, ..] => Some(1),
        [ESCAPE, b'[', rest @ ..] => Some(2 + control_sequence(rest)?),
        [ESCAPE, b'P' | b'X' | b']' | b'^' | b'_', rest @ ..] => Some(2 + control_string(rest)?),
        [ESCAPE, b'O', rest @ ..] => Some(2 + usize::from(rest.first()?.is_ascii_graphic())),
        [ESCAPE, rest @ ..] => Some(1 + character(rest)?),
        bytes => character(bytes),
    }
}

/// Returns how many bytes after the introducer belong to a control sequence.
fn control_sequence(bytes: &[u8]) -> Option<usize> {
    let (begin, ends) = PASTE;
    if bytes.starts_with(begin) {
        let end = |end: &[u8]| Some(bytes.windows(end.len()).position(|it| it == end)? + end.len());
        return ends.into_iter().filter_map(end).min();
    }
    match bytes.first()? {
        // A button of the mouse, in the oldest encoding; a function key of Linux' console.
        b'M' => (bytes.len() >= 4).then_some(4),
        b'[' => (bytes.len() >= 2).then_some(2),
        _ => {
            // No terminal sends a space in one.
            let end = bytes.iter().position(|byte| !(b'!'..=b'?').contains(byte))?;
            let is_final = (b'@'..=b'~').contains(bytes.get(end)?);
            Some(end + usize::from(is_final))
        }
    }
}

/// Returns how many bytes after the introducer belong to a control string. Another sequence ends it.
fn control_string(bytes: &[u8]) -> Option<usize> {
    let mut length = 0;
    loop {
        length += match bytes.get(length..)? {
            [ESCAPE, b'\\', ..] => return Some(length + 2),
            [ESCAPE, _, ..] => return Some(length),
            [BELL | TERMINATOR, ..] => return Some(length + 1),
            [ESCAPE] => return None,
            rest => character(rest)?,
        };
    }
}

/// Returns whether nothing is missing of a control sequence or a key that begins as one: another sequence may have begun within it.
fn is_whole(sequence: &[u8]) -> bool {
    match sequence {
        [ESCAPE, b'[', b'M' | b'[', ..] => true,
        [ESCAPE, b'[', .., last] => (b'@'..=b'~').contains(last),
        [ESCAPE, b'[' | b'O'] => false,
        _ => true,
    }
}

/// Returns the length of the character that bytes begin with; 1 or more also where they are none.
fn character(bytes: &[u8]) -> Option<usize> {
    let valid = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) if error.valid_up_to() == 0 => return error.error_len(),
        Err(error) => std::str::from_utf8(bytes.get(..error.valid_up_to())?).ok()?,
    };
    valid.chars().next().map(char::len_utf8)
}

/// Returns a key with modifiers in the form that is known, `CSI character ; modifiers u`; xterm, and tmux for others, has
/// `CSI 27 ; modifiers ; character ~` as well (its resource `formatOtherKeys`).
fn with_modifiers(sequence: &[u8]) -> Cow<'_, [u8]> {
    let inner = sequence.strip_prefix(b"\x1b[27;").and_then(|rest| rest.strip_suffix(b"~"));
    let parts = inner.and_then(|inner| std::str::from_utf8(inner).ok()?.split_once(';'));
    match parts {
        Some((modifiers, character)) => {
            format!("\x1b[{character};{modifiers}u").into_bytes().into()
        }
        None => sequence.into(),
    }
}

/// Returns a key of kitty's protocol, `CSI key : shifted : base ; modifiers u`, by its place on the keyboard where the key is a
/// letter of another script: `base` is the letter of the same place on a Latin keyboard.
fn by_place(sequence: &[u8]) -> Option<Vec<u8>> {
    let inner = sequence.strip_prefix(b"\x1b[")?.strip_suffix(b"u")?;
    let inner = std::str::from_utf8(inner).ok()?;
    let (keys, rest) = inner.split_once(';').unwrap_or((inner, "1"));
    let mut keys = keys.split(':');
    let key = char::from_u32(keys.next()?.parse().ok()?)?;
    let base = keys.nth(1)?;
    let is_latin =
        matches!(key, '\0'..='\u{24f}' | '\u{1e00}'..='\u{1eff}' | '\u{ff01}'..='\u{ff5e}');
    // The space bar is that on every keyboard.
    (base == "32" || key.is_alphanumeric() && !is_latin)
        .then(|| format!("\x1b[{base};{rest}u").into_bytes())
}

/// Returns what a whole sequence reports: a key, a lost focus, or text that nobody typed. The mouse, where the cursor is, and
/// what is unknown report nothing.
fn report(sequence: &[u8]) -> Option<Report> {
    match sequence {
        [ESCAPE, b'[', b'M', ..] => return None,
        [ESCAPE, b'[', rest @ ..] if rest.starts_with(PASTE.0) || rest == b"201~" => {
            return Some(Report::Text);
        }
        [ESCAPE, b'[', .., b'm' | b'M'] => return None,
        // Also F3 with modifiers: nothing is at that key.
        [ESCAPE, b'[', place @ .., b'R'] => {
            let (row, column) = std::str::from_utf8(place).ok()?.split_once(';')?;
            return Some(Report::Cursor([column.parse().ok()?, row.parse().ok()?]));
        }
        [ESCAPE, b'P' | b'X' | b']' | b'^' | b'_' | b'\\', ..] => return Some(Report::Text),
        // Where `stty erase` is Ctrl-H, and the key Delete of st.
        [BACKSPACE] => return Some(Report::Key(KeyCode::Backspace.into())),
        b"\x1b[P" => return Some(Report::Key(KeyCode::Delete.into())),
        // The space bar with AltGr in Latin-1, and with an input method in EUC-JP, GBK and EUC-KR.
        [0xa0 | 0xa1] => return Some(Report::Key(KeyCode::Char('\u{a0}').into())),
        _ if std::str::from_utf8(sequence).is_err() => return Some(Report::Foreign),
        _ => {}
    }
    let sequence = &*by_place(sequence).map_or(Cow::Borrowed(sequence), Cow::Owned);
    match Event::parse_from(&with_modifiers(sequence)) {
        Ok(Some(Event::Key(key))) => {
            let by_kitty = matches!(sequence, [ESCAPE, b'[', .., b'u']);
            let report = if by_kitty { Report::Held } else { Report::Key };
            Some(report(to_crossterm_key(key)))
        }
        Ok(Some(Event::FocusLost)) => Some(Report::Unwatched),
        Ok(Some(Event::FocusGained)) => Some(Report::Watched),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use ratatui::crossterm::event::{KeyEvent, KeyModifiers};

    use super::super::keyboard::{Typed, Typing};
    use super::*;
    use flix_host::teleop::action::Action;

    fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    fn key(code: KeyCode, modifiers: KeyModifiers) -> Report {
        Report::Key(KeyEvent::new(code, modifiers))
    }

    fn held(code: KeyCode, modifiers: KeyModifiers) -> Report {
        Report::Held(KeyEvent::new(code, modifiers))
    }

    /// Sequences and what each reports.
    fn sequences() -> Vec<(&'static str, Option<Report>)> {
        let plain = |code| Some(key(code, KeyModifiers::NONE));
        vec![
            ("w", plain(KeyCode::Char('w'))),
            ("W", Some(key(KeyCode::Char('W'), KeyModifiers::SHIFT))),
            (" ", plain(KeyCode::Char(' '))),
            ("\r", plain(KeyCode::Enter)),
            ("\u{7f}", plain(KeyCode::Backspace)),
            ("\u{8}", plain(KeyCode::Backspace)),
            ("\u{1b}[P", plain(KeyCode::Delete)),
            // An ideographic space; the key of w where a keyboard has Cyrillic letters, and A with an accent, which is Latin.
            ("\u{1b}[12288u", Some(held(KeyCode::Char('\u{3000}'), KeyModifiers::NONE))),
            ("\u{1b}[3851::32;1u", Some(held(KeyCode::Char(' '), KeyModifiers::NONE))),
            ("\u{1b}[1094::119;1u", Some(held(KeyCode::Char('w'), KeyModifiers::NONE))),
            ("\u{1b}[228::39;1u", Some(held(KeyCode::Char('\u{e4}'), KeyModifiers::NONE))),
            ("\u{3}", Some(key(KeyCode::Char('c'), KeyModifiers::CONTROL))),
            ("\u{e9}", plain(KeyCode::Char('\u{e9}'))),
            ("\u{1b}[A", plain(KeyCode::Up)),
            ("\u{1b}OA", plain(KeyCode::Up)),
            ("\u{1b}[1;2C", Some(key(KeyCode::Right, KeyModifiers::SHIFT))),
            ("\u{1b}[3~", plain(KeyCode::Delete)),
            ("\u{1b}[27u", Some(held(KeyCode::Esc, KeyModifiers::NONE))),
            // Shift and the space bar, Ctrl and C, in both forms.
            ("\u{1b}[32;2u", Some(held(KeyCode::Char(' '), KeyModifiers::SHIFT))),
            ("\u{1b}[27;2;32~", Some(key(KeyCode::Char(' '), KeyModifiers::SHIFT))),
            ("\u{1b}[99;5u", Some(held(KeyCode::Char('c'), KeyModifiers::CONTROL))),
            ("\u{1b}[27;5;99~", Some(key(KeyCode::Char('c'), KeyModifiers::CONTROL))),
            ("\u{1b}x", Some(key(KeyCode::Char('x'), KeyModifiers::ALT))),
            ("\u{1b}\u{e9}", Some(key(KeyCode::Char('\u{e9}'), KeyModifiers::ALT))),
            ("\u{1b}[O", Some(Report::Unwatched)),
            ("\u{1b}[I", Some(Report::Watched)),
            ("\u{1b}[200~was ist los w\r\u{1b}[A\u{1b}[201~", Some(Report::Text)),
            ("\u{1b}[201~", Some(Report::Text)),
            // Its name, a colour, and both ends of a string; where the cursor is.
            ("\u{1b}P>|WezTerm 20240203 w\u{1b}\\", Some(Report::Text)),
            ("\u{1b}]11;rgb:dcd/dcd/dcd\u{7}", Some(Report::Text)),
            ("\u{1b}[24;80R", Some(Report::Cursor([80, 24]))),
            ("\u{1b}[<64;40;12M", None),
            ("\u{1b}[<0;0;0m", None),
            ("\u{1b}[32;0;0M", None),
            ("\u{1b}[M !w", None),
            // How a terminal is, what it is and which colours it prefers; a key that no crate knows.
            ("\u{1b}[0n", None),
            ("\u{1b}[?62;22c", None),
            ("\u{1b}[?997;1n", None),
            ("\u{1b}[?2026;2$y", None),
            ("\u{1b}[99~", None),
        ]
    }

    #[test]
    fn a_sequence_reports_the_same_in_whichever_pieces_it_comes() {
        for (text, report) in sequences() {
            // What follows is read as before.
            let (text, reports) = (
                format!("{text}w"),
                report.into_iter().chain([key(KeyCode::Char('w'), KeyModifiers::NONE)]),
            );
            let reports: Vec<_> = reports.collect();
            for cut in 0..=text.len() {
                let (begin, end) = text.as_bytes().split_at(cut);
                let mut sequences = Sequences::default();
                let mut heard = sequences.take(ms(0), begin);
                heard.extend(sequences.take(ms(40), end));
                heard.extend(sequences.settle(ms(1000)));
                assert_eq!(heard, reports, "{text:?} at {cut}");
            }
            let mut sequences = Sequences::default();
            let single: Vec<_> = (0..)
                .zip(text.bytes())
                .flat_map(|(at, byte)| sequences.take(ms(at), &[byte]))
                .collect();
            assert_eq!(single, reports, "{text:?}");
        }
    }

    #[test]
    fn an_introducer_of_one_byte_is_read_as_the_one_of_two() {
        let up = key(KeyCode::Up, KeyModifiers::NONE);
        let left = key(KeyCode::Left, KeyModifiers::NONE);
        for (bytes, reports) in [
            (&b"\x9bA"[..], vec![up]),
            (b"\x8fD", vec![left]),
            (b"\x9bO", vec![Report::Unwatched]),
            (b"\x9b200~w\x9b201~", vec![Report::Text]),
            (b"\x9d11;rgb:dcd w\x9c", vec![Report::Text]),
            (b"\x901+r524742 w\x1b\\", vec![Report::Text]),
            ("\u{1b}]l\u{dc}walk er\u{1b}\\".as_bytes(), vec![Report::Text]),
        ] {
            for cut in 0..=bytes.len() {
                let (begin, end) = bytes.split_at(cut);
                let mut sequences = Sequences::default();
                let mut heard = sequences.take(ms(0), begin);
                heard.extend(sequences.take(ms(40), end));
                assert_eq!(heard, reports, "{bytes:?} at {cut}");
            }
        }
    }

    #[test]
    fn keys_that_come_with_text_do_nothing() {
        for text in [
            &b"\x1b[200~x\x1b[201~w"[..],
            b"\x1b[200~x\x1b[201~\r\x1b[201~",
            b"w\x1b[201~",
            b"\x1b[201~c",
            b"\x1b]0;\x1b\\w",
            b"\xe9w",
            b"\x1b\xffw",
            b"\xc0\xafw",
            b"\xff\x1b[A",
        ] {
            let (mut sequences, mut typing) = (Sequences::default(), Typing::default());
            for report in sequences.take(ms(100), text) {
                typing.report(ms(100), report);
            }
            assert_eq!(typing.take(ms(200)).actions, [], "{text:?}");
            // What is typed later is.
            typing.report(ms(300), key(KeyCode::Char('w'), KeyModifiers::NONE));
            assert!(matches!(typing.take(ms(400)).actions[..], [Action::Walk(_)]), "{text:?}");
        }
    }

    #[test]
    fn an_escape_is_a_key_once_nothing_followed_and_never_swallows_an_arrow() {
        let escape = key(KeyCode::Esc, KeyModifiers::NONE);
        let mut sequences = Sequences::default();
        assert_eq!(sequences.take(ms(100), b"\x1b"), []);
        assert_eq!(sequences.settle(ms(149)), []);
        assert_eq!(sequences.settle(ms(150)), [escape]);
        let up = key(KeyCode::Up, KeyModifiers::NONE);
        assert_eq!(sequences.take(ms(200), b"\x1b\x1b[A"), [escape, up]);
        assert_eq!(sequences.settle(ms(9000)), []);
    }

    #[test]
    fn a_sequence_without_its_end_swallows_no_stop_and_starts_nothing() {
        let whole = sequences().into_iter().map(|(text, _)| text).filter(|text| text.len() > 1);
        for text in whole.chain(["\u{1b}[200~w", "\u{1b}[200~w\u{1b}[201"]) {
            for cut in (1..text.len()).filter(|cut| text.as_bytes()[..*cut] != *b"\x1b") {
                let begun = &text.as_bytes()[..cut];
                let (mut sequences, mut typing) = (Sequences::default(), Typing::default());
                let mut typed = |at, bytes: &[u8]| {
                    let settled = sequences.settle(ms(at));
                    for report in settled.into_iter().chain(sequences.take(ms(at), bytes)) {
                        typing.report(ms(at), report);
                    }
                    typing.take(ms(at + 6))
                };
                let at_once = typed(0, begun);
                let begun_is_whole = length(begun).is_some();
                let then = typed(200, b"");
                assert_eq!(then.doubt.is_some(), !begun_is_whole, "{begun:?}");
                for actions in [at_once.actions, then.actions, typed(300, b"w").actions] {
                    let walks = actions.iter().any(|action| matches!(action, Action::Walk(_)));
                    assert!(!walks || begun_is_whole, "{begun:?}: {actions:?}");
                }
                assert_eq!(typed(400, b" ").actions, [Action::Stop], "{begun:?}");
                // Silence is an end, too, and so is the end of pasted text.
                let is_paste = begun.starts_with(b"\x1b[200~") && !begun_is_whole;
                let walks = |typed: Typed| matches!(typed.actions[..], [Action::Walk(_)]);
                assert_eq!(walks(typed(1500, b"w")), !is_paste, "{begun:?}");
                typed(2600, b"\x1b[201~");
                assert!(walks(typed(2700, b"a")), "{begun:?}");
            }
        }
    }

    #[test]
    fn pasted_text_that_was_held_up_is_over_after_a_long_silence() {
        let (mut sequences, mut typing) = (Sequences::default(), Typing::default());
        let mut typed = |at, bytes: &[u8]| {
            let settled = sequences.settle(ms(at));
            for report in settled.into_iter().chain(sequences.take(ms(at), bytes)) {
                typing.report(ms(at), report);
            }
            let actions = typing.take(ms(at + 6)).actions;
            actions.iter().filter(|action| matches!(action, Action::Walk(_))).count()
        };
        assert_eq!((typed(0, b"\x1b[200~hello"), typed(200, b"")), (0, 0));
        assert_eq!((typed(4000, b"w"), typed(8900, b"w"), typed(14_000, b"w")), (0, 0, 1));
        assert_eq!(typed(14_500, b"a"), 1);
    }

    #[test]
    fn a_sequence_that_broke_off_stays_no_typing_while_keys_go_on() {
        for begun in ["\u{1b}[<0;1", "\u{1b}O"] {
            for at in [1_199, 1_200] {
                let (mut sequences, mut typing) = (Sequences::default(), Typing::default());
                sequences.take(ms(0), begun.as_bytes());
                for report in sequences.settle(ms(200)) {
                    typing.report(ms(200), report);
                }
                typing.take(ms(206));
                for report in sequences.take(ms(at), b"w") {
                    typing.report(ms(at), report);
                }
                assert_eq!(typing.take(ms(at + 6)).actions.len(), usize::from(at >= 1_200));
            }
        }
    }

    #[test]
    fn a_space_bar_pressed_within_a_sequence_without_its_end_stops() {
        for begun in ["\u{1b}[200~pasted", "\u{1b}[<0;1", "\u{1b}[", "\u{1b}O", "\u{1b}", "\u{c3}"]
        {
            let mut sequences = Sequences::default();
            let mut reports = sequences.take(ms(0), begun.as_bytes());
            reports.extend(sequences.take(ms(100), b" "));
            reports.extend(sequences.settle(ms(200)));
            let mut typing = Typing::default();
            reports.into_iter().for_each(|report| typing.report(ms(200), report));
            assert!(typing.take(ms(200)).actions.contains(&Action::Stop), "{begun:?}");
        }
    }

    #[test]
    fn no_bytes_panic_and_none_are_kept_for_ever() {
        proptest::proptest!(|(bytes: Vec<u8>, alike in "(\u{1b}[\\[O]?[<?0-9;:]{0,9}[ -~]?){0,4}")| {
            for bytes in [&bytes, alike.as_bytes()] {
                let mut sequences = Sequences::default();
                sequences.take(ms(0), bytes);
                for round in 1..=bytes.len() as u64 {
                    sequences.settle(ms(round * 200));
                }
                assert!(sequences.pending.is_empty(), "{bytes:?}");
            }
        });
    }
}
