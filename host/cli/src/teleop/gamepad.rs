//! Driving with a gamepad, by the rules of the cockpit's page (`cockpit/page.js`).
//!
//! Stick or arrows walk and turn, the shoulder buttons strafe; B stops, Y clears, Select disarms, Start arms, by their
//! names on an Xbox gamepad. Of several gamepads any stops, and the one that was touched last drives; one whose layout is not
//! known stops with every button, and does no more. A gamepad is obeyed only after it was seen neutral, and again after everything that let the
//! robot rest, so that a stick which is held, or stuck, begins nothing. Stop is always obeyed.

use std::collections::BTreeMap;
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

    /// Looks at a gamepad that does not drive; returns whether it stops.
    fn stops(&mut self, reading: &Reading) -> bool {
        let [stopped, ..] = std::mem::replace(&mut self.pressed, reading.commands);
        self.was_neutral = reading.is_neutral();
        reading.commands[0] && !stopped
    }

    fn release(&mut self) -> Vec<Action> {
        self.was_neutral = false;
        self.drives.take().map(|_| Action::Rest).into_iter().collect()
    }
}

/// A gamepad of this computer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pad {
    /// Its number.
    pub id: usize,
    /// What it shows; nothing where its layout is not known.
    pub reading: Option<Reading>,
    /// Whether any of its buttons is pressed.
    pub is_pressed: bool,
}

/// The hands on all gamepads.
#[derive(Debug, Clone, Default)]
pub struct Hands {
    hands: BTreeMap<usize, Hand>,
    driver: Option<usize>,
    /// What the one that drives showed last.
    seen: Option<Reading>,
    is_touched: bool,
}

impl Hands {
    /// Returns what the operator wants now.
    pub fn read(&mut self, pads: &[Pad], cockpit: &Cockpit, now: Instant) -> Vec<Action> {
        let mut actions = Vec::new();
        let driver = self.choose(pads);
        if let Some(before) = self.driver.filter(|before| Some(*before) != driver) {
            actions.extend(self.hands.entry(before).or_default().release());
        }
        self.driver = driver;
        let seen = pads.iter().find(|pad| Some(pad.id) == driver).and_then(|pad| pad.reading);
        let before = std::mem::replace(&mut self.seen, seen);
        self.is_touched = self.is_held() && before != seen;
        self.hands.retain(|id, _| pads.iter().any(|pad| pad.id == *id));
        for pad in pads {
            let hand = self.hands.entry(pad.id).or_default();
            match &pad.reading {
                Some(reading) if driver == Some(pad.id) => {
                    actions.extend(hand.read(Some(reading), cockpit, now));
                }
                reading => {
                    let any = [pad.is_pressed, false, false, false];
                    let unknown = Reading { commands: any, ..Reading::default() };
                    actions.extend(
                        hand.stops(reading.as_ref().unwrap_or(&unknown)).then_some(Action::Stop),
                    );
                }
            }
        }
        actions
    }

    /// Returns whether a hand was on the one that lets the robot walk, at the last reading: what it shows has changed. A gamepad
    /// whose radio is lost may show for ever what it showed last.
    #[must_use]
    pub const fn is_touched(&self) -> bool {
        self.is_touched
    }

    fn is_held(&self) -> bool {
        self.driver.and_then(|id| self.hands.get(&id)).is_some_and(Hand::is_held)
    }

    /// Returns the gamepad that drives: one that lets the robot walk, until it is let go of; else the one that is touched; else
    /// the one that did before.
    fn choose(&self, pads: &[Pad]) -> Option<usize> {
        let known = || pads.iter().filter_map(|pad| Some((pad.id, pad.reading?)));
        let is_before = |(id, _): &(usize, Reading)| Some(*id) == self.driver;
        known()
            .find(|pad| is_before(pad) && self.is_held())
            .or_else(|| known().find(|(_, reading)| !reading.is_neutral()))
            .or_else(|| known().find(is_before))
            .or_else(|| known().next())
            .map(|(id, _)| id)
    }
}

#[cfg(feature = "gamepad")]
pub use device::Gamepads;
#[cfg(not(feature = "gamepad"))]
pub use without::Gamepads;

#[cfg(feature = "gamepad")]
mod device {
    use gilrs::{Axis, Button, Gamepad, Gilrs, MappingSource};

    use super::{Action, Cockpit, Hands, Instant, Pad, Reading};

    /// The gamepads of this computer.
    pub struct Gamepads {
        /// None where the system has none to offer.
        gilrs: Option<Gilrs>,
        hands: Hands,
    }

    impl Gamepads {
        /// Looks for gamepads. They may come and go later.
        #[must_use]
        pub fn open() -> Self {
            Self { gilrs: Gilrs::new().ok(), hands: Hands::default() }
        }

        /// Returns whether a hand was on the one that lets the robot walk, at the last reading.
        #[must_use]
        pub const fn is_touched(&self) -> bool {
            self.hands.is_touched()
        }

        /// Returns what the operator wants now.
        pub fn read(&mut self, cockpit: &Cockpit, now: Instant) -> Vec<Action> {
            let pads = self.gilrs.as_mut().map(pads).unwrap_or_default();
            self.hands.read(&pads, cockpit, now)
        }
    }

    fn pads(gilrs: &mut Gilrs) -> Vec<Pad> {
        // Events change the state that is asked for below.
        while gilrs.next_event().is_some() {}
        let pad = |(id, pad): (gilrs::GamepadId, Gamepad<'_>)| Pad {
            id: id.into(),
            reading: (pad.mapping_source() != MappingSource::None).then(|| reading(&pad)),
            is_pressed: pad.state().buttons().any(|(_, button)| button.is_pressed()),
        };
        gilrs.gamepads().map(pad).collect()
    }

    fn reading(pad: &Gamepad<'_>) -> Reading {
        let pressed = |button| pad.is_pressed(button);
        Reading {
            right: pad.value(Axis::LeftStickX),
            up: pad.value(Axis::LeftStickY),
            arrows: [Button::DPadUp, Button::DPadLeft, Button::DPadRight].map(pressed),
            shoulders: [Button::LeftTrigger, Button::RightTrigger].map(pressed),
            commands: [Button::East, Button::North, Button::Select, Button::Start].map(pressed),
            other: [Button::South, Button::West, Button::DPadDown, Button::LeftTrigger2]
                .into_iter()
                .chain([Button::RightTrigger2, Button::LeftThumb, Button::RightThumb])
                .any(pressed),
        }
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

        /// Returns that none was touched.
        #[must_use]
        pub const fn is_touched(&self) -> bool {
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
    fn any_gamepad_stops_and_the_one_that_is_touched_drives() {
        let (mut hands, mut cockpit) = (Hands::default(), cockpit(State::Running));
        let still = Reading::default();
        let mut read = |readings: [Option<Reading>; 2], is_walking: bool, time| {
            cockpit.wanted = if is_walking { Mode::Forward.setpoint() } else { Setpoint::REST };
            let pads = [0, 1].map(|id| Pad { id, reading: readings[id], is_pressed: false });
            hands.read(&pads, &cockpit, at(time))
        };
        assert_eq!(read([Some(still), Some(still)], false, 0), []);
        assert_eq!(read([Some(still), Some(AHEAD)], false, 10), [Action::Walk(Mode::Forward)]);
        // It keeps the robot until it is let go of; the other one stops at any time.
        assert_eq!(read([Some(AHEAD), Some(AHEAD)], true, 20), []);
        assert_eq!(read([Some(pressed(0)), Some(AHEAD)], true, 30), [Action::Stop]);
        assert_eq!(read([Some(pressed(0)), Some(still)], true, 40), [Action::Rest]);
        // The other one was not neutral a moment ago.
        assert_eq!(read([Some(AHEAD), Some(still)], false, 50), []);
        assert_eq!(read([Some(still), Some(still)], false, 60), []);
        assert_eq!(read([Some(AHEAD), Some(still)], false, 70), [Action::Walk(Mode::Forward)]);
        // Its layout is known no more.
        assert_eq!(read([None, Some(still)], true, 80), [Action::Rest]);
    }

    #[test]
    fn a_gamepad_that_is_unplugged_while_it_drives_lets_the_robot_rest() {
        let (mut hands, cockpit) = (Hands::default(), cockpit(State::Running));
        let pad = |reading| Pad { id: 3, reading: Some(reading), is_pressed: false };
        hands.read(&[pad(Reading::default())], &cockpit, at(0));
        hands.read(&[pad(AHEAD)], &cockpit, at(10));
        assert!(hands.is_held());
        assert_eq!(hands.read(&[], &cockpit, at(20)), [Action::Rest]);
        assert!(!hands.is_held());
        // It is back, and still held.
        assert_eq!(hands.read(&[pad(AHEAD)], &cockpit, at(30)), []);
    }

    #[test]
    fn a_gamepad_that_shows_the_same_for_ever_has_no_hand_on_it() {
        let (mut hands, mut cockpit) = (Hands::default(), cockpit(State::Running));
        cockpit.wanted = Mode::Forward.setpoint();
        let mut is_touched = |reading, time| {
            hands.read(
                &[Pad { id: 0, reading: Some(reading), is_pressed: false }],
                &cockpit,
                at(time),
            );
            hands.is_touched()
        };
        assert!(!is_touched(Reading { up: 0.1, ..Reading::default() }, 0));
        is_touched(AHEAD, 10);
        assert!(!is_touched(AHEAD, 20), "its radio may be lost");
        assert!(is_touched(Reading { up: 0.99, ..AHEAD }, 30));
        assert!(!is_touched(Reading { up: 0.99, ..AHEAD }, 40));
    }

    #[test]
    fn a_gamepad_of_an_unknown_layout_stops_with_every_button_once() {
        let (mut hands, cockpit) = (Hands::default(), cockpit(State::Running));
        let mut read =
            |is_pressed| hands.read(&[Pad { id: 0, reading: None, is_pressed }], &cockpit, at(0));
        assert_eq!(read(false), []);
        assert_eq!(read(true), [Action::Stop]);
        assert_eq!(read(true), []);
        assert_eq!(read(false), []);
        assert_eq!(read(true), [Action::Stop]);
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
