//! Converts keys to actions.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use flix_host::teleop::action::{Action, DIRECTION_STEPS, FREQUENCY_STEPS, Mode};

/// Returns the action of a key; releases and unknown keys have none.
#[must_use]
pub fn action(key: KeyEvent) -> Option<Action> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return match key.code {
            KeyCode::Char('c' | 'd' | '\\') => Some(Action::Interrupt),
            // The space bar stops, whatever else is pressed.
            KeyCode::Char(' ') => Some(Action::Stop),
            _ => None,
        };
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
    Some(match character.to_ascii_lowercase() {
        ' ' => Action::Stop,
        'w' | '1' => Action::Walk(Mode::Forward),
        'a' | '2' => Action::Walk(Mode::LeftTurn),
        'd' | '3' => Action::Walk(Mode::RightTurn),
        'q' | '4' => Action::Walk(Mode::StrafeLeft),
        'e' | '5' => Action::Walk(Mode::StrafeRight),
        's' | '0' => Action::Rest,
        'c' => Action::Clear,
        'h' => Action::HoldHeading,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
