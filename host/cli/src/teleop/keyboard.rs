//! Converts keys to actions.

use std::collections::VecDeque;
use std::time::Duration;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use flix_host::teleop::action::{Action, DIRECTION_STEPS, FREQUENCY_STEPS};
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::units::Instant as Moment;

/// Returns the action of a key; releases and unknown keys have none.
#[must_use]
pub fn action(key: KeyEvent) -> Option<Action> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    // The space bar stops, whatever else is pressed.
    if let KeyCode::Char(character) = key.code
        && (is_blank(character) || is_plain(key) && is_accent(half_width(character)))
    {
        return Some(Action::Stop);
    }
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return match key.code {
            KeyCode::Char('c' | 'd' | '\\') => Some(Action::Interrupt),
            _ => None,
        };
    }
    if !is_plain(key) {
        return None;
    }
    let fine = usize::from(key.modifiers.contains(KeyModifiers::SHIFT));
    let KeyCode::Char(character) = key.code else {
        return match key.code {
            KeyCode::Enter => Some(Action::Arm),
            KeyCode::Backspace | KeyCode::Delete => Some(Action::Disarm),
            KeyCode::Esc => Some(Action::Quit),
            KeyCode::Up => Some(Action::Frequency(FREQUENCY_STEPS[fine])),
            KeyCode::Down => Some(Action::Frequency(-FREQUENCY_STEPS[fine])),
            KeyCode::Right => Some(Action::Direction(DIRECTION_STEPS[fine])),
            KeyCode::Left => Some(Action::Direction(-DIRECTION_STEPS[fine])),
            _ => None,
        };
    };
    Some(match half_width(character).to_ascii_lowercase() {
        'w' | '1' => Action::Walk(PaperMode::Forward),
        'a' | '2' => Action::Walk(PaperMode::LeftTurn),
        'd' | '3' => Action::Walk(PaperMode::RightTurn),
        'q' | '4' => Action::Walk(PaperMode::StrafeLeft),
        'e' | '5' => Action::Walk(PaperMode::StrafeRight),
        's' | '0' => Action::Rest,
        'c' => Action::Clear,
        'h' => Action::HoldHeading,
        _ => return None,
    })
}

/// Returns whether no modifier but shift is held. Nothing is at a key with Alt and the like; an answer of the terminal to somebody
/// else begins as such a key does.
const fn is_plain(key: KeyEvent) -> bool {
    KeyModifiers::SHIFT.contains(key.modifiers)
}

/// Returns whether the space bar sends this character, on any keyboard: white space and characters without a width (Unicode's
/// property White_Space, and format characters), but no control character. An input method sends U+3000, Option or AltGr with the
/// space bar U+00A0 or U+202F, a Persian keyboard U+200C with shift.
fn is_blank(character: char) -> bool {
    let is_space = character.is_whitespace() && !character.is_control();
    let is_without_width = matches!(
        character,
        '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{2800}' | '\u{3164}' | '\u{feff}' | '\u{f0b}' | '\u{1361}'
    );
    is_space || is_without_width
}

/// Returns whether this is an accent alone: a dead key and then the space bar send that. Some keyboards have the quotation marks
/// for acute and diaeresis.
const fn is_accent(character: char) -> bool {
    matches!(
        character,
        '^' | '`' | '~' | '\'' | '"' | '\u{a8}' | '\u{af}' | '\u{b0}' | '\u{b4}' | '\u{b8}' | '\u{2c6}' | '\u{2c7}'
            | '\u{2d8}'..='\u{2dd}' | '\u{37a}' | '\u{ffe3}' | '\u{300}'..='\u{36f}' | '\u{384}' | '\u{385}' | '\u{309b}' | '\u{309c}'
    )
}

/// Returns a full-width letter or digit, which an input method sends, in its ordinary form (Unicode's block Halfwidth and Fullwidth
/// Forms).
fn half_width(character: char) -> char {
    match character {
        '\u{ff01}'..='\u{ff5e}' => {
            char::from_u32(u32::from(character) - 0xfee0).unwrap_or(character)
        }
        _ => character,
    }
}

/// Returns a key, whether shift was held or not.
fn letter(code: KeyCode) -> KeyCode {
    match code {
        KeyCode::Char(character) => KeyCode::Char(half_width(character).to_ascii_lowercase()),
        code => code,
    }
}

/// Time between two keys that a hand leaves at the least: keys repeat up to 50 times per second, and a hand rolls over two
/// of them in some 10 ms.
const APART: Duration = Duration::from_millis(5);
/// Most keys in one go that may come from a hand: a slow network hands over some together. Even of these none arms, clears or
/// begins a walk: two letters may be pasted.
const TOGETHER: usize = 3;
/// Longest silence of a key that is held: systems wait up to 0.7 s until it repeats, and the terminal may be gone.
const HELD: Duration = Duration::from_millis(800);
/// A hand presses a key not faster again; one that comes faster repeats, since it is held.
const PRESSED_AGAIN: Duration = Duration::from_millis(100);
/// A key that repeats is held until it was silent for so long: a network may hold some of them back.
const RELEASED: Duration = Duration::from_millis(500);
/// Longest pause within an answer of the terminal, which may come in pieces. Its end may be lost.
const PAUSE: Duration = Duration::from_secs(1);
/// The same within pasted text, which a slow network may hold up.
const PASTE_PAUSE: Duration = Duration::from_secs(5);
/// A program that did not look at its keys for longer stood still: what was typed meanwhile was for what it showed before.
const STOOD_STILL: Duration = Duration::from_millis(250);
/// A terminal that has answered before and does not within this time shows an old picture, and hands over old keys: its connection
/// stands still.
const UNANSWERED: Duration = Duration::from_secs(1);
/// Questions whose answers may still come: of older ones none is expected any more.
const MOST_QUESTIONS: usize = 128;
/// Most columns and rows of the places by which answers are told apart, from the second row on: some terminals report F3 as a place
/// in the first one.
const PLACES: [u16; 2] = [40, 10];
/// Why a robot rests whose operator may have missed a key.
const MISSED: &str = "a key was pressed that does nothing";
/// What an answer of the terminal begins with, read as a key with Alt: ECMA-48's control strings DCS, SOS, OSC, PM, APC.
const STRINGS: [KeyCode; 5] = [
    KeyCode::Char('P'),
    KeyCode::Char('X'),
    KeyCode::Char(']'),
    KeyCode::Char('^'),
    KeyCode::Char('_'),
];

/// What a terminal reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Report {
    /// A key, or what looks like one.
    Key(KeyEvent),
    /// A key by kitty's protocol, whose release will be reported as well.
    Held(KeyEvent),
    /// Column and row of the cursor, from 1, as the terminal states them. The terminal has shown the picture that was drawn before it
    /// was [asked](Typing::ask) with the cursor at this place.
    Cursor([u16; 2]),
    /// Nobody looks: the focus is lost, or nobody is attached to tmux or screen.
    Unwatched,
    /// The focus is here again.
    Watched,
    /// Whether a program on the way answers in the terminal's place, and does not say whether anybody looks.
    Unsure(bool),
    /// The end of pasted text, or of an answer of the terminal.
    Text,
    /// A byte that is no character: of a key, where the terminal has another encoding than UTF-8, or of text.
    Foreign,
    /// A sequence has no end: what follows may be a part of it. Pasted text may be long under way.
    BrokenOff {
        /// Whether it was one.
        is_paste: bool,
    },
    /// It cannot be read any more.
    Closed,
}

/// What was typed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Typed {
    /// What the operator wants.
    pub actions: Vec<Action>,
    /// Steps of f and theta by keys that repeat: they change a walk, and are no new wish of the operator.
    pub steps: Vec<Action>,
    /// Whether a key was pressed, with an action or without. One that repeats is no sign that somebody is there, unless it is
    /// that of a walk.
    pub is_touched: bool,
    /// Whether nobody looks: the focus was lost, and neither a key nor the focus came since.
    pub is_unwatched: bool,
    /// Whether it cannot be known if anybody looks.
    pub is_unsure: bool,
    /// Time of a picture that the operator had on the screen before any of these keys; `None` where the terminal answers no question.
    pub seen: Option<Moment>,
    /// Time since the first press of the oldest of these keys, which may have been held since. A picture that was drawn after that
    /// press is no reason for the operator's wish.
    pub pressed: Duration,
    /// Why a robot that walks has to rest, in words.
    pub doubt: Option<&'static str>,
    /// Keys that came in one go, or while the program stood still, and were dropped.
    pub dropped: usize,
}

/// Distinguishes typing from text: pasted into a terminal that does not mark it, held back while a network stood still, or the answer
/// to somebody else's question. A hand leaves time between two keys. What lets the robot rest or stop is obeyed in any case.
#[derive(Debug, Clone, Default)]
pub struct Typing {
    /// Whether the robot walks only while its key is held.
    holds: bool,
    /// The key of the walk that goes on, and when it was reported last.
    held: Option<(KeyCode, Duration)>,
    /// Whether the focus was lost, and neither a key nor the focus came since.
    is_unwatched: bool,
    /// Whether it cannot be known if anybody looks.
    is_unsure: bool,
    ready: Typed,
    /// The key that was reported last.
    repeated: Option<Pressed>,
    /// When the oldest key that is ready was pressed.
    since: Option<Duration>,
    /// What the keys that came together last are there for, whether they repeat, and when the last of them came.
    together: Vec<Option<(Action, bool)>>,
    /// Whether any of them shows that somebody is there.
    is_touched: bool,
    /// Whether any of them is a character without an action.
    is_unknown: bool,
    last: Duration,
    /// Whether text came among them.
    is_text: bool,
    /// When the last character of an answer of the terminal came that has not ended yet.
    answer: Option<Duration>,
    /// When the last character came of what follows a sequence without its end, and the pause that ends that.
    rest: Option<(Duration, Duration)>,
    /// When the keys were looked at last.
    looked: Duration,
    /// Keys until then are too old. Those of a program that stood still are read shortly after it goes on.
    old_until: Duration,
    /// Questions that the terminal has not answered, the oldest first.
    asked: VecDeque<Question>,
    /// Of the next question.
    number: u16,
    /// Time of the newest picture that the terminal has shown.
    shown: Option<Moment>,
}

/// A key that may be held.
#[derive(Debug, Clone, Copy)]
struct Pressed {
    code: KeyCode,
    /// When the first of its reports came; each followed within [`HELD`].
    since: Duration,
    /// When the last came.
    last: Duration,
    /// Whether it repeats, beyond doubt.
    repeats: bool,
}

/// A question to the terminal that is not answered.
#[derive(Debug, Clone, Copy)]
struct Question {
    at: Duration,
    /// The place that the terminal will state.
    place: [u16; 2],
    /// Time of the picture before it.
    picture: Moment,
}

impl Typing {
    /// Reads keys. `holds`: a walk begins with a key whose release will be reported, and ends with that, or when the key repeats no
    /// more.
    #[must_use]
    pub fn new(holds: bool) -> Self {
        Self { holds, ..Self::default() }
    }

    /// Looks at the keys at this time, before those that wait are reported. They are too old after a time without a look, but
    /// for what calms or leaves.
    pub fn look(&mut self, now: Duration) {
        if now.saturating_sub(self.looked) > STOOD_STILL {
            self.together.clear();
            self.old_until = now + STOOD_STILL;
        }
        self.looked = now;
    }

    /// Returns the column and row, from 1, to which the cursor is to be set, at this time, before the terminal is asked where the cursor
    /// is; `None` where the terminal, of so many columns and rows, is better not asked now. It answers once it has shown the picture
    /// of this moment, and its answers stand among the keys in the order in which a person saw and typed.
    pub fn ask(
        &mut self,
        now: Duration,
        picture: Moment,
        [columns, rows]: [u16; 2],
    ) -> Option<[u16; 2]> {
        let columns = columns.min(PLACES[0]);
        let places = columns * rows.saturating_sub(1).min(PLACES[1]);
        if usize::from(places) < MOST_QUESTIONS {
            // Too small for as many answers to be told apart.
            (self.shown, self.asked) = (None, VecDeque::new());
            return None;
        }
        let is_soon = |last: &Question| now.saturating_sub(last.at) < UNANSWERED;
        if self.is_unanswered(now) && self.asked.back().is_some_and(is_soon) {
            return None;
        }
        if self.asked.len() >= MOST_QUESTIONS {
            self.asked.pop_front();
        }
        self.number = (self.number + 1) % places;
        let place = [1 + self.number % columns, 2 + self.number / columns];
        self.asked.push_back(Question { at: now, place, picture });
        Some(place)
    }

    /// Returns whether an answer of the terminal may still come in time.
    #[must_use]
    pub fn is_answer_due(&self, now: Duration) -> bool {
        self.asked.front().is_some_and(|oldest| now.saturating_sub(oldest.at) <= UNANSWERED)
    }

    /// Returns whether a question was not answered in time.
    fn is_silent(&self, now: Duration) -> bool {
        self.asked.front().is_some_and(|oldest| now.saturating_sub(oldest.at) > UNANSWERED)
    }

    /// Returns whether a terminal that answers has not for long.
    fn is_unanswered(&self, now: Duration) -> bool {
        self.shown.is_some() && self.is_silent(now)
    }

    /// Takes what a terminal reported at this time.
    pub fn report(&mut self, at: Duration, report: Report) {
        self.settle(at);
        let is_held = matches!(report, Report::Held(_));
        match report {
            Report::Key(key) | Report::Held(key) if key.kind == KeyEventKind::Release => {
                self.repeated = None;
                let code = letter(key.code);
                // The release of a digit that needs shift names another character where shift was released first.
                let is_unknown = matches!(code, KeyCode::Char(_))
                    && action(KeyEvent::new(code, KeyModifiers::NONE)).is_none();
                if self.held.take_if(|(held, _)| *held == code || is_unknown).is_some() {
                    self.together.fill(None);
                    self.ready.actions.push(Action::Rest);
                }
            }
            Report::Key(key) | Report::Held(key) => {
                let repeats = self.repeats(at, key);
                let action = action(key);
                let is_unknown =
                    action.is_none() && is_plain(key) && matches!(key.code, KeyCode::Char(_));
                let is_walk = matches!(action, Some(Action::Walk(_)));
                // Whoever holds a key wants what he wanted when he pressed it.
                let action = action
                    .filter(|action| !repeats || is_step(action) || is_calming(action))
                    .filter(|action| {
                        !(self.holds && !is_held && matches!(action, Action::Walk(_)))
                    });
                let is_answer = self.answers(at, key);
                let is_late = at < self.old_until || self.is_unanswered(at);
                let is_old = is_late && action != Some(Action::Quit);
                // An accent may be the end of a sequence, as a tilde is of many.
                let is_blank = matches!(key.code, KeyCode::Char(character) if is_blank(character));
                let is_end = is_answer && action == Some(Action::Stop) && !is_blank;
                let is_calm = action.as_ref().is_some_and(is_calming) && !is_end;
                if (is_answer || is_old) && !is_calm {
                    self.ready.dropped += 1;
                    return;
                }
                self.is_unknown |= is_unknown;
                if self.holds && matches!(action, Some(Action::Walk(_))) {
                    self.held = Some((letter(key.code), at));
                } else if let Some((held, last)) = &mut self.held
                    && *held == letter(key.code)
                {
                    *last = at;
                }
                if let Some(calming) = action.filter(is_calming) {
                    // What was pressed before it is over.
                    self.together.fill(None);
                    self.ready.actions.push(calming);
                }
                self.is_touched |= !repeats || is_walk;
                let wish = action.filter(|action| !is_calming(action));
                self.together.push(wish.map(|action| (action, repeats)));
                self.last = at;
            }
            Report::Cursor(place) => {
                // The terminal answers in order: earlier questions without an answer, and their pictures, were lost on the way.
                if let Some(index) = self.asked.iter().position(|asked| asked.place == place) {
                    self.shown = self.asked.drain(..=index).next_back().map(|asked| asked.picture);
                }
            }
            Report::Unwatched => {
                // A key of before is no sign that somebody looks now.
                self.is_unwatched = true;
                (self.is_touched, self.ready.is_touched) = (false, false);
                self.ready.doubt = Some("nobody looks at the terminal");
            }
            Report::Watched => self.is_unwatched = false,
            Report::Unsure(is_unsure) => self.is_unsure = is_unsure,
            Report::Text | Report::Foreign => {
                (self.is_text, self.last, self.rest) = (true, at, None);
                if report == Report::Foreign {
                    self.ready.doubt = Some(MISSED);
                }
            }
            Report::BrokenOff { is_paste } => {
                self.together.fill(None);
                self.rest = Some((at, if is_paste { PASTE_PAUSE } else { PAUSE }));
                self.ready.doubt = Some("the terminal broke off within a sequence");
            }
            Report::Closed => self.ready.actions.push(Action::Interrupt),
        }
    }

    /// Returns whether a key comes again because it is held: the terminal says so, or no hand is as fast.
    fn repeats(&mut self, at: Duration, key: KeyEvent) -> bool {
        let code = letter(key.code);
        let silent = |before: &Pressed| at.saturating_sub(before.last);
        let before = self.repeated.filter(|it| it.code == code && silent(it) < HELD);
        let is_fast = before
            .is_some_and(|it| silent(&it) < if it.repeats { RELEASED } else { PRESSED_AGAIN });
        let repeats = key.kind == KeyEventKind::Repeat || is_fast;
        let since = before.map_or(at, |it| it.since);
        self.repeated = Some(Pressed { code, since, last: at, repeats });
        repeats
    }

    /// Returns whether a key is a part of an answer of the terminal to somebody else, or may be one of a sequence without its end.
    fn answers(&mut self, at: Duration, key: KeyEvent) -> bool {
        let with = |modifier| key.modifiers.contains(modifier);
        let begins = with(KeyModifiers::ALT) && STRINGS.contains(&key.code);
        let goes_on_since = |last: Duration, pause| at.saturating_sub(last) < pause;
        let goes_on = self.answer.is_some_and(|last| goes_on_since(last, PAUSE));
        let rest = self.rest.filter(|(last, pause)| goes_on_since(*last, *pause));
        let ends = match key.code {
            KeyCode::Esc => true,
            KeyCode::Char('\\') => with(KeyModifiers::ALT),
            KeyCode::Char('g') => with(KeyModifiers::CONTROL),
            _ => false,
        };
        self.answer = (begins || (goes_on && !ends)).then_some(at);
        self.rest = rest.map(|(_, pause)| (at, pause));
        begins || goes_on || rest.is_some()
    }

    /// Returns what was typed since the last call, as far as that is known by now.
    pub fn take(&mut self, now: Duration) -> Typed {
        self.settle(now);
        if self.held.take_if(|(_, last)| now.saturating_sub(*last) > HELD).is_some() {
            self.ready.doubt = Some("the key of the walk repeats no more");
        }
        if self.is_unanswered(now) {
            self.ready.doubt = Some("the terminal does not answer");
        }
        self.is_unwatched &= !self.ready.is_touched;
        // Of the keys to come: some of them may have been typed before the newest answer, and are not judged yet.
        let seen = if self.together.is_empty() { self.shown } else { self.ready.seen };
        let ready = Typed { seen, ..Typed::default() };
        let pressed = self.since.take().map_or(Duration::ZERO, |since| now.saturating_sub(since));
        let ready = std::mem::replace(&mut self.ready, ready);
        // A terminal that never answers may be gone, and its session kept.
        let is_mute = self.shown.is_none() && self.is_silent(now);
        let (is_unwatched, is_unsure) = (self.is_unwatched, self.is_unsure || is_mute);
        Typed { is_unwatched, is_unsure, pressed, ..ready }
    }

    /// Judges the keys that came together, once nothing followed for long enough.
    fn settle(&mut self, now: Duration) {
        if now.saturating_sub(self.last) < APART {
            return;
        }
        let keys = std::mem::take(&mut self.together);
        let is_text = std::mem::take(&mut self.is_text);
        let is_touched = std::mem::take(&mut self.is_touched);
        if std::mem::take(&mut self.is_unknown) && !is_text {
            // Whoever misses a key of a robot that walks may have meant any other.
            self.ready.doubt = Some(MISSED);
        }
        if is_text || keys.len() > TOGETHER {
            self.ready.dropped += keys.len();
            return;
        }
        if keys.is_empty() {
            return;
        }
        self.ready.is_touched |= is_touched;
        let begins =
            |action: &Action| matches!(action, Action::Walk(_) | Action::Arm | Action::Clear);
        let is_alone = keys.len() == 1;
        let since = self.repeated.map_or(self.last, |it| it.since);
        for (action, repeats) in keys.into_iter().flatten() {
            if repeats {
                self.ready.steps.push(action);
            } else if is_alone || !begins(&action) {
                self.since = Some(self.since.map_or(since, |oldest| oldest.min(since)));
                self.ready.actions.push(action);
            } else {
                self.ready.dropped += 1;
            }
        }
    }
}

/// Returns whether an action moves nothing, so that it never waits for doubts.
const fn is_calming(action: &Action) -> bool {
    matches!(action, Action::Stop | Action::Interrupt | Action::Rest | Action::Disarm)
}

/// Returns whether an action changes f or theta by a step.
const fn is_step(action: &Action) -> bool {
    matches!(action, Action::Frequency(_) | Action::Direction(_))
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn key(code: KeyCode) -> Report {
        Report::Key(KeyEvent::new(code, KeyModifiers::NONE))
    }

    const fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    const SIZE: [u16; 2] = [80, 24];

    /// Reports keys of a text, so long apart.
    fn type_text(typing: &mut Typing, text: &str, apart: Duration) -> Typed {
        for (index, character) in (0..).zip(text.chars()) {
            typing.report(ms(100) + apart * index, key(KeyCode::Char(character)));
        }
        typing.take(ms(100) + apart * u32::try_from(text.len()).unwrap_or(0) + APART)
    }

    #[test]
    fn a_key_that_a_connection_held_back_does_nothing_but_calm() {
        let moment = |time: u64| Moment::from_micros(time * 1_000);
        let walks = |typed: &Typed| typed.actions == [Action::Walk(PaperMode::Forward)];
        let mut typing = Typing::default();
        let type_w = |typing: &mut Typing, at: u64| {
            // The program never stood still.
            (0..=at).step_by(100).for_each(|time| typing.look(ms(time)));
            typing.report(ms(at), key(KeyCode::Char('w')));
            typing.take(ms(at) + APART)
        };
        // Keys of a terminal that never answers count; whether a person sees the screen is not known.
        let first = typing.ask(ms(100), moment(100), SIZE).unwrap();
        let [early, late] = [200, 3_000].map(|at| type_w(&mut typing, at));
        assert!(walks(&early) && walks(&late));
        assert_eq!([early.is_unsure, late.is_unsure], [false, true]);
        typing.report(ms(3_010), Report::Cursor(first));
        let answered = typing.take(ms(3_020));
        assert_eq!((answered.seen, answered.is_unsure), (None, false));
        // While the connection stands still, the terminal is asked once a second, and every key that arrives is old.
        let asked: Vec<_> =
            (3_100..8_000).step_by(33).map(|at| typing.ask(ms(at), moment(at), SIZE)).collect();
        let places: Vec<_> = asked.iter().flatten().collect();
        assert!((30..40).contains(&places.len()), "{}", places.len());
        let old = type_w(&mut typing, 8_000);
        assert_eq!((old.seen, old.dropped, &old.actions[..]), (Some(moment(100)), 1, &[][..]));
        assert_eq!(old.doubt, Some("the terminal does not answer"));
        for (character, action) in [('s', Action::Rest), (' ', Action::Stop)] {
            typing.report(ms(8_100), key(KeyCode::Char(character)));
            assert_eq!(typing.take(ms(8_150)).actions, [action]);
        }
        // Whatever it has lost, the answer to the newest question makes it new.
        typing.report(ms(8_200), Report::Cursor(*places[3]));
        assert_eq!(type_w(&mut typing, 8_300).dropped, 1);
        typing.report(ms(8_310), Report::Cursor(**places.last().unwrap()));
        assert!(!typing.is_answer_due(ms(8_310)));
        typing.report(ms(8_320), Report::Cursor([3, 3]));
        let new = type_w(&mut typing, 8_500);
        assert!(walks(&new) && new.doubt.is_none(), "{new:?}");
        assert!(type_w(&mut typing, 8_700).seen > Some(moment(7_000)));
        // Who typed before an answer came has not seen its picture.
        let place = typing.ask(ms(8_800), moment(8_800), SIZE).unwrap();
        typing.report(ms(8_900), key(KeyCode::Enter));
        typing.report(ms(8_900), Report::Cursor(place));
        assert_eq!(typing.take(ms(8_901)).actions, []);
        let entered = typing.take(ms(8_910));
        assert_eq!(entered.actions, [Action::Arm]);
        assert!(entered.seen < Some(moment(8_800)));
        assert_eq!(typing.take(ms(8_950)).seen, Some(moment(8_800)));
        // A window that is too small to tell answers apart is not asked.
        assert_eq!(typing.ask(ms(9_000), moment(9_000), [80, 4]), None);
        assert!(typing.ask(ms(9_000), moment(9_000), [80, 8]).unwrap()[1] <= 8);
    }

    #[test]
    fn nobody_looks_from_a_lost_focus_until_it_comes_back_or_a_key_is_typed() {
        let mut typing = Typing::default();
        let is_unwatched = |typing: &mut Typing, at, report| {
            typing.report(ms(at), report);
            typing.take(ms(at) + APART).is_unwatched
        };
        assert!(!is_unwatched(&mut typing, 100, Report::Watched));
        assert!(is_unwatched(&mut typing, 200, Report::Unwatched));
        assert!(is_unwatched(&mut typing, 300, Report::Text));
        assert!(!is_unwatched(&mut typing, 400, Report::Watched));
        assert!(is_unwatched(&mut typing, 500, Report::Unwatched));
        assert!(!is_unwatched(&mut typing, 600, key(KeyCode::Char('x'))));
        typing.report(ms(700), key(KeyCode::Char('x')));
        assert!(is_unwatched(&mut typing, 701, Report::Unwatched));
    }

    #[test]
    fn typed_keys_act_and_a_text_in_one_go_does_not() {
        let typed = type_text(&mut Typing::default(), "wq", ms(20));
        let walk = |mode| Action::Walk(mode);
        assert_eq!(typed.actions, [walk(PaperMode::Forward), walk(PaperMode::StrafeLeft)]);
        assert!(typed.is_touched && typed.dropped == 0);
        let text = type_text(&mut Typing::default(), "flix-walker", ms(0));
        let doubt = Some("a key was pressed that does nothing");
        assert_eq!(text, Typed { dropped: 11, doubt, ..Typed::default() });
        // A slow network hands over some keys together: they may change a walk, and begin none.
        let begins = type_text(&mut Typing::default(), "wq", ms(0));
        assert_eq!(begins, Typed { dropped: 2, is_touched: true, ..Typed::default() });
        let mut typing = Typing::default();
        for code in [KeyCode::Up, KeyCode::Up, KeyCode::Enter] {
            typing.report(ms(1), key(code));
        }
        let up = [Action::Frequency(FREQUENCY_STEPS[0])];
        let typed = typing.take(ms(50));
        assert_eq!((&typed.actions[..], &typed.steps[..]), (&up[..], &up[..]));
    }

    #[test]
    fn whatever_the_space_bar_sends_stops() {
        let sent = [
            ' ', '\u{3000}', '\u{a0}', '\u{202f}', '\u{2009}', '\u{200b}', '\u{200c}', '\u{200d}',
            '\u{2060}', '\u{feff}', '^', '`', '~', '\'', '"', '\u{b4}', '\u{a8}', '\u{2c7}',
            '\u{301}',
        ];
        for character in sent {
            let typed = type_text(&mut Typing::default(), &character.to_string(), ms(20));
            assert_eq!(typed.actions, [Action::Stop], "{character:?}");
        }
        for code in [' ', '\u{3000}', '\u{a0}'] {
            let with = KeyModifiers::ALT | KeyModifiers::SHIFT;
            let stops = action(KeyEvent::new(KeyCode::Char(code), with));
            assert_eq!(stops, Some(Action::Stop), "{code:?}");
        }
    }

    #[test]
    fn a_letter_of_full_width_is_that_letter_and_an_unknown_one_lets_the_robot_rest() {
        let wide = type_text(&mut Typing::default(), "\u{ff37}\u{ff13}", ms(20)).actions;
        assert_eq!(wide, [PaperMode::Forward, PaperMode::RightTurn].map(Action::Walk));
        for character in ["x", "\u{446}", "\u{0663}", ";", "-"] {
            let typed = type_text(&mut Typing::default(), character, ms(20));
            assert!(typed.actions.is_empty() && typed.doubt.is_some(), "{character}");
        }
        for code in [KeyCode::F(1), KeyCode::Home, KeyCode::Tab, KeyCode::CapsLock] {
            let mut typing = Typing::default();
            typing.report(ms(1), key(code));
            assert_eq!(typing.take(ms(50)).doubt, None, "{code:?}");
        }
    }

    #[test]
    fn an_answer_to_somebody_else_is_no_typing() {
        // The colour of the background, as it is read when nobody asked for it here: Alt and ], then characters.
        let mut typing = Typing::default();
        typing.report(ms(1), Report::Key(KeyEvent::new(KeyCode::Char(']'), KeyModifiers::ALT)));
        for character in "11;rgb:1e1e/1e1e/2e2e".chars() {
            typing.report(ms(1), key(KeyCode::Char(character)));
        }
        assert_eq!(typing.take(ms(50)).actions, []);
        for code in ['w', '1', 'c', 'h'] {
            for with in [KeyModifiers::ALT, KeyModifiers::META, KeyModifiers::SUPER] {
                assert_eq!(action(KeyEvent::new(KeyCode::Char(code), with)), None);
            }
        }
    }

    #[test]
    fn an_answer_that_comes_in_pieces_is_no_typing() {
        let alt =
            |character| Report::Key(KeyEvent::new(KeyCode::Char(character), KeyModifiers::ALT));
        let bell = Report::Key(KeyEvent::new(KeyCode::Char('g'), KeyModifiers::CONTROL));
        let forward = [Action::Walk(PaperMode::Forward)];
        let ends = [(']', Some(alt('\\'))), ('P', Some(bell)), ('X', Some(key(KeyCode::Esc)))];
        for (begin, end) in ends.into_iter().chain([('^', None), ('_', None)]) {
            let mut typing = Typing::default();
            let mut typed = |at, report| {
                typing.report(ms(at), report);
                typing.take(ms(at + 50)).actions
            };
            assert_eq!(typed(1000, alt(begin)), []);
            for (count, character) in (1..).zip("11;rgb:dcd".chars()) {
                assert_eq!(typed(1000 + 200 * count, key(KeyCode::Char(character))), []);
            }
            assert_eq!(typed(3200, key(KeyCode::Char(' '))), [Action::Stop]);
            // Where no end comes, silence is one.
            match end {
                Some(end) => assert_eq!(typed(3400, end), []),
                None => assert_eq!(typed(4100, key(KeyCode::Char('w'))), []),
            }
            let next = if end.is_some() { 3500 } else { 5200 };
            assert_eq!(typed(next, key(KeyCode::Char('w'))), forward, "{begin}");
        }
    }

    #[test]
    fn what_stops_or_rests_is_obeyed_at_once_even_within_a_text() {
        let mut typing = Typing::default();
        for character in "was ist los".chars() {
            typing.report(ms(1), key(KeyCode::Char(character)));
        }
        let actions = typing.take(ms(1)).actions;
        assert!(actions.iter().all(is_calming) && actions.contains(&Action::Stop), "{actions:?}");
        // Once, not again when the rest is judged.
        assert_eq!(typing.take(ms(100)).actions, []);
        // Nor does a key act that was pressed before.
        for character in ['w', 's'] {
            typing.report(ms(200), key(KeyCode::Char(character)));
        }
        assert_eq!(typing.take(ms(300)).actions, [Action::Rest]);
    }

    #[test]
    fn keys_that_repeat_act_and_those_held_back_by_a_network_do_not() {
        let mut typing = Typing::default();
        for count in 0..50 {
            typing.report(ms(20 * count), key(KeyCode::Up));
        }
        let typed = typing.take(ms(2000));
        assert_eq!((typed.actions.len(), typed.steps.len()), (1, 49), "one wish");
        for _ in 0..50 {
            typing.report(ms(5000), key(KeyCode::Up));
        }
        let held_back = typing.take(ms(6000));
        assert_eq!((held_back.actions.len(), held_back.dropped), (0, 50));
        assert!(!held_back.is_touched);
    }

    #[test]
    fn only_a_first_press_is_a_wish() {
        // Held, with a pause of the network in it; and pressed again and again.
        let held = (0..10).map(|count| 500 + 33 * count).chain([1200, 1233]);
        let tapped = [3000, 3150, 3300];
        for code in ['w', 'c', 'h'].map(KeyCode::Char).into_iter().chain([KeyCode::Enter]) {
            let mut typing = Typing::default();
            let wishes = |times: Vec<u64>, typing: &mut Typing| -> usize {
                let mut wishes = 0;
                for at in times {
                    typing.report(ms(at), key(code));
                    let typed = typing.take(ms(at + 10));
                    assert!(typed.steps.is_empty());
                    let is_somebody = !typed.actions.is_empty() || code == KeyCode::Char('w');
                    assert_eq!(typed.is_touched, is_somebody, "a key that is stuck is nobody");
                    wishes += typed.actions.len();
                }
                wishes
            };
            assert_eq!(wishes(held.clone().collect(), &mut typing), 1, "{code:?}");
            assert_eq!(wishes(tapped.to_vec(), &mut typing), 3, "{code:?}");
        }
        // What calms acts as often as it comes.
        let typed = type_text(&mut Typing::default(), "sss", ms(33));
        assert_eq!(typed.actions, [Action::Rest; 3]);
    }

    #[test]
    fn a_key_that_may_be_held_is_a_wish_of_when_it_was_pressed() {
        let w = KeyCode::Char('w');
        let mut typing = Typing::default();
        let mut typed = |at: u64, report| {
            typing.report(ms(at), report);
            let typed = typing.take(ms(at + 10));
            (typed.actions.len(), typed.pressed)
        };
        assert_eq!(typed(1_000, key(w)), (1, ms(10)));
        // The first repeat comes as late as a second press; a network holds later ones back.
        assert_eq!(typed(1_700, key(w)), (1, ms(710)));
        assert_eq!(typed(1_733, key(w)), (0, Duration::ZERO));
        assert_eq!(typed(2_300, key(w)), (1, ms(1_310)));
        assert_eq!(typed(2_400, key(KeyCode::Char('c'))), (1, ms(10)), "another key");
        assert_eq!(typed(2_500, key(w)), (1, ms(10)), "another press");
        assert_eq!(typed(3_310, key(w)), (1, ms(10)), "after longer than systems wait");
        let kind = KeyEventKind::Release;
        let release = KeyEvent { kind, ..KeyEvent::new(w, KeyModifiers::NONE) };
        typed(3_400, Report::Held(release));
        assert_eq!(typed(3_500, key(w)), (1, ms(10)), "it was released");
    }

    #[test]
    fn keys_of_a_program_that_stood_still_do_nothing_but_calm() {
        let mut typing = Typing::default();
        typing.look(ms(200));
        // Read before it stood still, while, and just after.
        typing.report(ms(201), key(KeyCode::Char('w')));
        typing.look(ms(6000));
        for (at, code) in [
            (3000, KeyCode::Enter),
            (5999, KeyCode::Char('w')),
            (6001, KeyCode::Char('c')),
            (6003, KeyCode::Backspace),
        ] {
            typing.report(ms(at), key(code));
        }
        typing.look(ms(6240));
        let typed = typing.take(ms(6240));
        assert_eq!((typed.actions, typed.is_touched), (vec![Action::Disarm], true));
        for (at, code, walks) in [(6249, 'w', 0), (6260, 'a', 1)] {
            typing.report(ms(at), key(KeyCode::Char(code)));
            typing.look(ms(at + 5));
            assert_eq!(typing.take(ms(at + 5)).actions.len(), walks);
        }
    }

    #[test]
    fn nobody_looking_and_a_closed_terminal_are_reported() {
        let mut typing = Typing::default();
        typing.report(ms(1), Report::Unwatched);
        typing.report(ms(1), Report::Closed);
        let typed = typing.take(ms(1));
        assert!(typed.doubt.is_some() && !typed.is_touched);
        assert_eq!(typed.actions, [Action::Interrupt]);
    }

    #[test]
    fn the_space_bar_stops_whatever_else_is_pressed() {
        for bits in 0..=KeyModifiers::all().bits() {
            let key = KeyEvent::new(KeyCode::Char(' '), KeyModifiers::from_bits_truncate(bits));
            assert_eq!(action(key), Some(Action::Stop), "{key:?}");
        }
    }

    #[test]
    fn the_release_of_a_key_has_no_action() {
        let mut key = KeyEvent::new(KeyCode::Char('w'), KeyModifiers::NONE);
        assert!(action(key).is_some());
        key.kind = KeyEventKind::Release;
        assert_eq!(action(key), None);
    }

    #[test]
    fn a_walk_that_is_held_ends_when_its_key_is_silent() {
        let held = |kind| {
            let key = KeyEvent::new(KeyCode::Char('w'), KeyModifiers::NONE);
            Report::Held(KeyEvent { kind, ..key })
        };
        let mut typing = Typing::new(true);
        let mut at = 0;
        let mut typed = |kind: Option<KeyEventKind>, pause| {
            kind.into_iter().for_each(|kind| typing.report(ms(at), held(kind)));
            at += pause;
            let typed = typing.take(ms(at));
            (typed.actions.len(), typed.doubt.is_some())
        };
        // Pressed, and neither repeated nor released.
        assert_eq!(typed(Some(KeyEventKind::Press), 800), (1, false));
        assert_eq!(typed(None, 1), (0, true));
        // What comes then begins nothing.
        assert_eq!(typed(Some(KeyEventKind::Repeat), 30), (0, false));
        assert_eq!(typed(Some(KeyEventKind::Release), 30), (0, false));
        assert_eq!(typed(Some(KeyEventKind::Press), 600), (1, false));
        for _ in 0..50 {
            assert_eq!(typed(Some(KeyEventKind::Repeat), 33), (0, false));
        }
        assert_eq!(typed(None, 800), (0, true));
    }

    #[test]
    fn a_walk_that_is_held_begins_with_a_key_alone_whose_release_is_reported() {
        for (holds, walks) in [(true, 0), (false, 1)] {
            let mut typing = Typing::new(holds);
            typing.report(ms(0), key(KeyCode::Char('w')));
            assert_eq!(typing.take(ms(10)).actions.len(), walks);
            typing.report(ms(100), key(KeyCode::Char(' ')));
            assert_eq!(typing.take(ms(110)).actions, [Action::Stop]);
        }
    }

    #[test]
    fn a_walk_that_is_held_ends_when_its_key_is_released() {
        let key = |code, kind| {
            let key = KeyEvent::new(KeyCode::Char(code), KeyModifiers::NONE);
            Report::Held(KeyEvent { kind, ..key })
        };
        let (down, again, up) = (KeyEventKind::Press, KeyEventKind::Repeat, KeyEventKind::Release);
        let [forward, left] = [PaperMode::Forward, PaperMode::LeftTurn].map(Action::Walk);
        for (holds, wanted) in [
            (true, vec![forward, left, Action::Rest, forward, Action::Rest]),
            (false, vec![forward, left, forward]),
        ] {
            let mut typing = Typing::new(holds);
            let mut actions = Vec::new();
            let reports = [
                ('w', down),
                ('w', again),
                ('a', down),
                // No more the key of the walk that goes on.
                ('w', up),
                ('A', up),
                ('w', down),
                ('w', up),
                ('w', up),
            ];
            for (number, (code, kind)) in (1_u64..).zip(reports) {
                typing.report(Duration::from_millis(100 * number), key(code, kind));
                actions.extend(typing.take(Duration::from_millis(100 * number + 50)).actions);
            }
            assert_eq!(actions, wanted, "{holds}");
        }
        // The key of 1 on a French keyboard, whose shift is released first.
        let mut typing = Typing::new(true);
        typing.report(Duration::ZERO, key('1', down));
        typing.report(Duration::from_millis(100), key('&', up));
        assert_eq!(typing.take(Duration::from_millis(150)).actions, [forward, Action::Rest]);
        // A press that is released at once moves nothing.
        let mut typing = Typing::new(true);
        typing.report(Duration::ZERO, key('w', down));
        typing.report(Duration::from_millis(1), key('w', up));
        assert_eq!(typing.take(Duration::from_millis(50)).actions, [Action::Rest]);
    }
}
