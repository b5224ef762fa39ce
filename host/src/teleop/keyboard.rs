//! Converts keys to actions.

use flix_protocol::message::Setpoint;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// A walking mode, with the pair of the paper for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Linear translation.
    Forward,
    /// Turning to the left.
    LeftTurn,
    /// Turning to the right.
    RightTurn,
    /// Sideways to the left.
    StrafeLeft,
    /// Sideways to the right.
    StrafeRight,
}

impl Mode {
    /// All modes, in the order of the paper's Table IV.
    pub const ALL: [Self; 5] =
        [Self::Forward, Self::LeftTurn, Self::RightTurn, Self::StrafeLeft, Self::StrafeRight];

    /// Returns f in Hz and theta in degrees (paper, Table IV).
    #[must_use]
    pub const fn pair(self) -> (f32, f32) {
        match self {
            Self::Forward => (-30.0, 30.0),
            Self::LeftTurn => (-30.0, 90.0),
            Self::RightTurn => (30.0, 90.0),
            Self::StrafeLeft => (30.0, 30.0),
            Self::StrafeRight => (-30.0, -60.0),
        }
    }

    /// Returns the pair as a command.
    #[must_use]
    pub const fn setpoint(self) -> Setpoint {
        let (frequency, direction) = self.pair();
        Setpoint::saturating(frequency, direction)
    }

    /// Returns the name for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::LeftTurn => "left turn",
            Self::RightTurn => "right turn",
            Self::StrafeLeft => "strafe left",
            Self::StrafeRight => "strafe right",
        }
    }
}

/// What the operator commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Stop now; the stop is latched.
    Stop,
    /// Arm.
    Arm,
    /// Ramp down and disarm.
    Disarm,
    /// Clear stop and faults.
    Clear,
    /// Walk in this mode.
    Walk(Mode),
    /// Ramp down, and stay armed.
    Rest,
    /// Change f by this step, Hz.
    Frequency(f32),
    /// Change theta by this step, degrees.
    Direction(f32),
    /// Hold the present heading, or end that.
    HoldHeading,
    /// Disarm, then leave.
    Quit,
    /// Stop, then leave.
    Interrupt,
}

/// Step of f, Hz: coarse, and fine with shift.
pub(crate) const FREQUENCY_STEPS: [f32; 2] = [1.0, 0.1];
/// Step of theta, degrees: coarse, and fine with shift.
pub(crate) const DIRECTION_STEPS: [f32; 2] = [5.0, 1.0];

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
    fn the_modes_are_those_of_table_iv() {
        let pairs = Mode::ALL.map(Mode::pair);
        let table = [(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0), (30.0, 30.0), (-30.0, -60.0)];
        assert_eq!(pairs, table);
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
}
