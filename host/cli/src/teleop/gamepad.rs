//! Driving with a gamepad, by the rules of the cockpit's page (`cockpit/page.js`).
//!
//! Stick or arrows walk and turn, the shoulder buttons strafe; B stops, Y clears, Select disarms, Start arms, by their
//! names on an Xbox gamepad. A gamepad is obeyed only after it was seen neutral, and again after everything that let the
//! robot rest, so that a stick which is held, or stuck, begins nothing. Stop is always obeyed.

use std::time::Duration;

use flix_protocol::message::{Setpoint, State};
use flix_protocol::units::Instant;

use flix_host::teleop::Cockpit;
use flix_host::teleop::action::{Action, Mode};

/// Deflection of the stick below which it is neutral, of 1.
const DEAD_ZONE: f32 = 0.25;
/// Deflection of the stick from which it commands, of 1.
const DEFLECTED: f32 = 0.6;
/// What lets the robot rest by itself is noticed in this time.
const SETTLED: Duration = Duration::from_millis(400);

/// What a gamepad shows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// Stick to the right, -1 to 1.
    pub right: f32,
    /// Stick up, -1 to 1.
    pub up: f32,
    /// Arrows: up, left, right.
    pub arrows: [bool; 3],
    /// Shoulder buttons: left, right.
    pub shoulders: [bool; 2],
    /// Stop, clear, disarm, arm.
    pub commands: [bool; 4],
    /// Any other button.
    pub other: bool,
}

const COMMANDS: [Action; 4] = [Action::Stop, Action::Clear, Action::Disarm, Action::Arm];

impl Reading {
    fn is_neutral(&self) -> bool {
        let is_pressed =
            self.arrows.iter().chain(&self.shoulders).chain(&self.commands).any(|it| *it);
        !(is_pressed || self.other) && self.right.abs().max(self.up.abs()) < DEAD_ZONE
    }

    fn mode(&self) -> Option<Mode> {
        let [ahead, left, right] = self.arrows;
        let is_sideways = self.right.abs() > self.up.abs();
        match self.shoulders {
            [true, _] => Some(Mode::StrafeLeft),
            [_, true] => Some(Mode::StrafeRight),
            _ if ahead || (!is_sideways && self.up > DEFLECTED) => Some(Mode::Forward),
            _ if left || (is_sideways && -self.right > DEFLECTED) => Some(Mode::LeftTurn),
            _ if right || (is_sideways && self.right > DEFLECTED) => Some(Mode::RightTurn),
            _ => None,
        }
    }
}

/// The hand on a gamepad: what it commands from one reading to the next.
#[derive(Debug, Clone, Default)]
pub struct Hand {
    was_neutral: bool,
    pressed: [bool; 4],
    /// What it lets the robot do, and since when.
    drives: Option<(Mode, Instant)>,
}

impl Hand {
    /// Returns what the operator wants now. `None`: there is no gamepad, or it is gone.
    pub fn read(
        &mut self,
        reading: Option<&Reading>,
        cockpit: &Cockpit,
        now: Instant,
    ) -> Vec<Action> {
        let Some(reading) = reading else {
            self.pressed = Default::default();
            return self.release();
        };
        let mut actions = self.commands(reading);
        let may_drive = cockpit.telemetry.as_ref().is_some_and(|telemetry| {
            !telemetry.stopped && matches!(telemetry.state, State::Armed | State::Running)
        });
        if !may_drive {
            self.drives = None;
        }
        // The robot rests although the stick commands: something let it rest.
        let is_at_rest = cockpit.wanted == Setpoint::REST;
        if self.drives.is_some_and(|(_, since)| now.since(since) > SETTLED && is_at_rest) {
            actions.extend(self.release());
        }
        self.was_neutral |= reading.is_neutral();
        let wanted = reading.mode();
        if !self.was_neutral || wanted == self.drives.map(|(mode, _)| mode) {
            return actions;
        }
        match wanted {
            Some(_) if !may_drive => self.was_neutral = false,
            Some(mode) => {
                self.drives = Some((mode, now));
                actions.push(Action::Walk(mode));
            }
            None => {
                self.drives = None;
                actions.push(Action::Rest);
            }
        }
        actions
    }

    /// Returns whether it lets the robot walk.
    #[must_use]
    pub const fn is_held(&self) -> bool {
        self.drives.is_some()
    }

    /// Returns the commands of buttons that have just been pressed.
    fn commands(&mut self, reading: &Reading) -> Vec<Action> {
        let before = std::mem::replace(&mut self.pressed, reading.commands);
        let is_new = |index: usize| reading.commands[index] && !before[index];
        let new = (0..COMMANDS.len()).filter(|index| is_new(*index)).map(|index| COMMANDS[index]);
        new.filter(|action| self.was_neutral || *action == Action::Stop).collect()
    }

    fn release(&mut self) -> Vec<Action> {
        self.was_neutral = false;
        self.drives.take().map(|_| Action::Rest).into_iter().collect()
    }
}

#[cfg(feature = "gamepad")]
pub use device::Gamepads;
#[cfg(not(feature = "gamepad"))]
pub use without::Gamepads;

#[cfg(feature = "gamepad")]
mod device {
    use gilrs::{Axis, Button, Gilrs};

    use super::{Action, Cockpit, Hand, Instant, Reading};

    /// The gamepads of this computer; the first one drives.
    pub struct Gamepads {
        /// None where the system has none to offer.
        gilrs: Option<Gilrs>,
        hand: Hand,
    }

    impl Gamepads {
        /// Looks for gamepads. They may come and go later.
        #[must_use]
        pub fn open() -> Self {
            Self { gilrs: Gilrs::new().ok(), hand: Hand::default() }
        }

        /// Returns whether one lets the robot walk.
        #[must_use]
        pub const fn is_held(&self) -> bool {
            self.hand.is_held()
        }

        /// Returns what the operator wants now.
        pub fn read(&mut self, cockpit: &Cockpit, now: Instant) -> Vec<Action> {
            let reading = self.gilrs.as_mut().and_then(reading);
            self.hand.read(reading.as_ref(), cockpit, now)
        }
    }

    fn reading(gilrs: &mut Gilrs) -> Option<Reading> {
        // Events change the state that is asked for below.
        while gilrs.next_event().is_some() {}
        let (_, pad) = gilrs.gamepads().next()?;
        let pressed = |button| pad.is_pressed(button);
        Some(Reading {
            right: pad.value(Axis::LeftStickX),
            up: pad.value(Axis::LeftStickY),
            arrows: [Button::DPadUp, Button::DPadLeft, Button::DPadRight].map(pressed),
            shoulders: [Button::LeftTrigger, Button::RightTrigger].map(pressed),
            commands: [Button::East, Button::North, Button::Select, Button::Start].map(pressed),
            other: [Button::South, Button::West, Button::DPadDown, Button::LeftTrigger2]
                .into_iter()
                .chain([Button::RightTrigger2, Button::LeftThumb, Button::RightThumb])
                .any(pressed),
        })
    }
}

#[cfg(not(feature = "gamepad"))]
mod without {
    use super::{Action, Cockpit, Instant};

    /// The gamepads, which this program was built without.
    pub struct Gamepads;

    impl Gamepads {
        /// Looks for none.
        #[must_use]
        pub fn open() -> Self {
            Self
        }

        /// Returns that none does.
        #[must_use]
        pub const fn is_held(&self) -> bool {
            false
        }

        /// Returns nothing.
        pub fn read(&mut self, _: &Cockpit, _: Instant) -> Vec<Action> {
            Vec::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walked::telemetry;

    const AHEAD: Reading = Reading {
        right: 0.0,
        up: 1.0,
        arrows: [false; 3],
        shoulders: [false; 2],
        commands: [false; 4],
        other: false,
    };

    fn at(milliseconds: u64) -> Instant {
        Instant::from_micros(1000 * milliseconds)
    }

    fn cockpit(state: State) -> Cockpit {
        let mut cockpit = Cockpit::new("walker", at(0));
        cockpit.telemetry = Some(flix_protocol::message::Telemetry { state, ..telemetry(0.0) });
        cockpit
    }

    fn pressed(index: usize) -> Reading {
        let mut reading = Reading::default();
        reading.commands[index] = true;
        reading
    }

    #[test]
    fn a_stick_that_was_never_neutral_begins_nothing() {
        let mut hand = Hand::default();
        let cockpit = cockpit(State::Armed);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(0)), []);
        let slack = Reading { up: 0.3, ..AHEAD };
        assert_eq!(hand.read(Some(&slack), &cockpit, at(10)), []);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(20)), []);
        assert_eq!(hand.read(Some(&Reading::default()), &cockpit, at(30)), []);
        let walk = [Action::Walk(Mode::Forward)];
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(40)), walk);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(50)), []);
    }

    #[test]
    fn a_stick_that_is_let_go_lets_the_robot_rest() {
        let (mut hand, mut cockpit) = (Hand::default(), cockpit(State::Running));
        hand.read(Some(&Reading::default()), &cockpit, at(0));
        hand.read(Some(&AHEAD), &cockpit, at(10));
        cockpit.wanted = Mode::Forward.setpoint();
        let slack = Reading { up: 0.5, ..AHEAD };
        assert_eq!(hand.read(Some(&slack), &cockpit, at(20)), [Action::Rest]);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(30)), [Action::Walk(Mode::Forward)]);
        // It is gone.
        assert_eq!(hand.read(None, &cockpit, at(40)), [Action::Rest]);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(50)), []);
    }

    #[test]
    fn a_stick_that_is_held_does_not_undo_what_let_the_robot_rest() {
        let (mut hand, mut cockpit) = (Hand::default(), cockpit(State::Running));
        hand.read(Some(&Reading::default()), &cockpit, at(0));
        hand.read(Some(&AHEAD), &cockpit, at(10));
        cockpit.wanted = Setpoint::REST;
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(410)), []);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(411)), [Action::Rest]);
        let aside = Reading { right: -1.0, up: 0.0, ..AHEAD };
        assert_eq!(hand.read(Some(&aside), &cockpit, at(420)), []);
    }

    #[test]
    fn a_robot_that_is_not_armed_wants_a_neutral_stick_first() {
        let mut hand = Hand::default();
        hand.read(Some(&Reading::default()), &cockpit(State::Disarmed), at(0));
        assert_eq!(hand.read(Some(&AHEAD), &cockpit(State::Disarmed), at(10)), []);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit(State::Armed), at(20)), []);
        let mut stopped = cockpit(State::Armed);
        stopped.telemetry.as_mut().unwrap().stopped = true;
        hand.read(Some(&Reading::default()), &stopped, at(30));
        assert_eq!(hand.read(Some(&AHEAD), &stopped, at(40)), []);
    }

    #[test]
    fn stop_is_obeyed_at_once_and_the_other_buttons_after_neutral() {
        let cockpit = cockpit(State::Disarmed);
        for (index, action) in COMMANDS.into_iter().enumerate() {
            let mut hand = Hand::default();
            let expected: &[Action] = if action == Action::Stop { &[Action::Stop] } else { &[] };
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(0)), expected);
            hand.read(Some(&Reading::default()), &cockpit, at(10));
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(20)), [action]);
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(30)), []);
        }
    }

    #[test]
    fn every_mode_has_a_place() {
        let still = Reading::default();
        let places = [
            (Reading { up: 0.7, right: 0.6, ..still }, Some(Mode::Forward)),
            (Reading { up: 0.6, right: -0.7, ..still }, Some(Mode::LeftTurn)),
            (Reading { up: -0.6, right: 0.7, ..still }, Some(Mode::RightTurn)),
            (Reading { up: -1.0, ..still }, None),
            (Reading { arrows: [true, false, false], ..still }, Some(Mode::Forward)),
            (Reading { arrows: [false, true, false], ..still }, Some(Mode::LeftTurn)),
            (Reading { arrows: [false, false, true], ..still }, Some(Mode::RightTurn)),
            (Reading { shoulders: [true, false], ..still }, Some(Mode::StrafeLeft)),
            (Reading { shoulders: [false, true], ..still }, Some(Mode::StrafeRight)),
            (Reading { other: true, ..still }, None),
        ];
        for (reading, mode) in places {
            assert_eq!(reading.mode(), mode, "{reading:?}");
            assert!(!reading.is_neutral());
        }
    }
}
