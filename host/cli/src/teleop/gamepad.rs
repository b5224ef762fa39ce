//! Driving with a gamepad, by the rules of the cockpit's page (`cockpit/page.js`).
//!
//! Stick or arrows walk and turn, the shoulder buttons strafe. The right button stops (B on Xbox, A on Nintendo, circle), and so
//! does the lower one while the robot walks: it is B on Nintendo. The upper button clears, Select disarms, Start arms. Of several
//! gamepads the one drives whose command changed last, and any of them ends the walk: it stops, disarms, or lets go of its stick. One whose layout is not known stops with every button, and does no more. A gamepad
//! is obeyed only after it was seen neutral, and again after everything that let the robot rest, so that a stick which is held, or
//! stuck, begins nothing, and keeps no other from driving. Stop and disarm are always obeyed.

use std::collections::BTreeMap;
use std::time::Duration;

use flix_protocol::message::{Setpoint, State};
use flix_protocol::units::Instant;

use flix_host::teleop::Cockpit;
use flix_host::teleop::action::Action;
use flix_host::teleop::paper_modes::PaperMode;

/// Deflection of the stick below which it is neutral, of 1.
const DEAD_ZONE: f32 = 0.25;
/// Deflection of the stick from which it commands, of 1.
const DEFLECTED: f32 = 0.6;
/// Deflection below which a stick that commands does so no longer: it may tremble about the one from which it does.
const KEPT: f32 = 0.4;
/// By how much the other axis has to lead before it commands.
const LEAD: f32 = 0.1;
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
    /// The lower button of the right hand: A on Xbox, B on Nintendo.
    pub lower: bool,
    /// Any other button.
    pub other: bool,
}

const COMMANDS: [Action; 4] = [Action::Stop, Action::Clear, Action::Disarm, Action::Arm];

impl Reading {
    fn is_neutral(&self) -> bool {
        let is_pressed =
            self.arrows.iter().chain(&self.shoulders).chain(&self.commands).any(|it| *it);
        !(is_pressed || self.lower || self.other) && self.right.abs().max(self.up.abs()) < DEAD_ZONE
    }

    /// Takes an axis that shows no number for one at rest.
    fn in_numbers(self) -> Self {
        let [right, up] = [self.right, self.up].map(|axis| if axis.is_nan() { 0.0 } else { axis });
        Self { right, up, ..self }
    }

    /// Returns what it commands, after `before`.
    fn mode(&self, before: Option<PaperMode>) -> Option<PaperMode> {
        let from = |mode| if before == Some(mode) { KEPT } else { DEFLECTED };
        let [ahead, left, right] = self.arrows;
        // The axis that leads goes on to until the other leads by so much.
        let lead = match before {
            Some(PaperMode::Forward) => LEAD,
            Some(PaperMode::LeftTurn | PaperMode::RightTurn) => -LEAD,
            _ => 0.0,
        };
        let is_sideways = self.right.abs() > self.up.abs() + lead;
        match self.shoulders {
            [true, _] => Some(PaperMode::StrafeLeft),
            [_, true] => Some(PaperMode::StrafeRight),
            _ if ahead || (!is_sideways && self.up > from(PaperMode::Forward)) => {
                Some(PaperMode::Forward)
            }
            _ if left || (is_sideways && -self.right > from(PaperMode::LeftTurn)) => {
                Some(PaperMode::LeftTurn)
            }
            _ if right || (is_sideways && self.right > from(PaperMode::RightTurn)) => {
                Some(PaperMode::RightTurn)
            }
            _ => None,
        }
    }
}

/// The hand on a gamepad: what it commands from one reading to the next.
#[derive(Debug, Clone, Default)]
pub struct Hand {
    /// What the gamepad showed last.
    seen: Option<Reading>,
    was_neutral: bool,
    pressed: [bool; 4],
    was_lower: bool,
    /// What it lets the robot do, and since when.
    drives: Option<(PaperMode, Instant)>,
}

impl Hand {
    /// Returns what the operator, who looks elsewhere, wants now: what is pressed is meant for what he looks at.
    fn unwatched(&mut self, reading: Option<&Reading>, cockpit: &Cockpit) -> Vec<Action> {
        self.seen = reading.copied();
        let mut actions = self.release();
        actions.extend(reading.into_iter().flat_map(|it| self.commands(it, cockpit)));
        actions
    }

    /// Returns what the operator wants now. `None`: there is no gamepad, or it is gone.
    pub fn read(
        &mut self,
        reading: Option<&Reading>,
        cockpit: &Cockpit,
        now: Instant,
    ) -> Vec<Action> {
        self.seen = reading.copied();
        let Some(reading) = reading else { return self.release() };
        let mut actions = self.commands(reading, cockpit);
        let may_drive = cockpit.telemetry.as_ref().is_some_and(|telemetry| {
            !telemetry.stopped && matches!(telemetry.state, State::Armed | State::Running)
        });
        if !may_drive {
            self.drives = None;
        }
        // The robot rests although the stick commands: something let it rest.
        let is_at_rest = cockpit.setpoint == Setpoint::REST;
        if self.drives.is_some_and(|(_, since)| now.since(since) > SETTLED && is_at_rest) {
            actions.extend(self.release());
        }
        self.was_neutral |= reading.is_neutral();
        let driven = self.drives.map(|(mode, _)| mode);
        let wanted = reading.mode(driven);
        if !self.was_neutral || wanted == driven {
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
    fn commands(&mut self, reading: &Reading, cockpit: &Cockpit) -> Vec<Action> {
        let walks = cockpit.setpoint != Setpoint::REST
            || cockpit.telemetry.as_ref().is_some_and(|it| it.state == State::Running);
        let was_lower = std::mem::replace(&mut self.was_lower, reading.lower);
        if reading.lower && !was_lower && walks {
            return vec![Action::Stop];
        }
        let before = std::mem::replace(&mut self.pressed, reading.commands);
        let is_new = |index: usize| reading.commands[index] && !before[index];
        let new = (0..COMMANDS.len()).filter(|index| is_new(*index)).map(|index| COMMANDS[index]);
        let is_calming = |action: &Action| matches!(action, Action::Stop | Action::Disarm);
        new.filter(|action| self.was_neutral || is_calming(action)).collect()
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
    is_touched: bool,
}

impl Hands {
    /// Returns what the operator wants now. Of one who looks elsewhere (`is_watched`) they only stop and disarm.
    pub fn read(
        &mut self,
        pads: &[Pad],
        is_watched: bool,
        cockpit: &Cockpit,
        now: Instant,
    ) -> Vec<Action> {
        let mut actions = Vec::new();
        self.is_touched = false;
        for (id, hand) in &mut self.hands {
            if !pads.iter().any(|pad| pad.id == *id) {
                actions.extend(hand.release());
            }
        }
        self.hands.retain(|id, _| pads.iter().any(|pad| pad.id == *id));
        for pad in pads {
            let hand = self.hands.entry(pad.id).or_default();
            let reading = pad.reading.map(Reading::in_numbers);
            let before = hand.seen;
            actions.extend(if is_watched {
                hand.read(reading.as_ref(), cockpit, now)
            } else {
                hand.unwatched(reading.as_ref(), cockpit)
            });
            self.is_touched |= hand.is_held() && hand.seen != before;
            if reading.is_none() {
                // Nobody knows which of its buttons stops.
                let any = [pad.is_pressed, false, false, false];
                let reading = Reading { commands: any, ..Reading::default() };
                actions.extend(hand.commands(&reading, cockpit));
            }
        }
        actions
    }

    /// Returns whether a hand was on one that lets the robot walk, at the last reading: what it shows has changed. A gamepad
    /// whose radio is lost may show for ever what it showed last.
    #[must_use]
    pub const fn is_touched(&self) -> bool {
        self.is_touched
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
        pub fn read(&mut self, is_watched: bool, cockpit: &Cockpit, now: Instant) -> Vec<Action> {
            let pads = self.gilrs.as_mut().map(pads).unwrap_or_default();
            self.hands.read(&pads, is_watched, cockpit, now)
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
            lower: pressed(Button::South),
            other: [Button::West, Button::DPadDown, Button::LeftTrigger2]
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
        pub fn read(&mut self, _: bool, _: &Cockpit, _: Instant) -> Vec<Action> {
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
        lower: false,
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
        let walk = [Action::Walk(PaperMode::Forward)];
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(40)), walk);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(50)), []);
    }

    #[test]
    fn a_stick_that_is_let_go_lets_the_robot_rest() {
        let (mut hand, mut cockpit) = (Hand::default(), cockpit(State::Running));
        hand.read(Some(&Reading::default()), &cockpit, at(0));
        hand.read(Some(&AHEAD), &cockpit, at(10));
        cockpit.setpoint = PaperMode::Forward.setpoint();
        let slack = Reading { up: 0.39, ..AHEAD };
        assert_eq!(hand.read(Some(&slack), &cockpit, at(20)), [Action::Rest]);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(30)), [Action::Walk(PaperMode::Forward)]);
        // It is gone.
        assert_eq!(hand.read(None, &cockpit, at(40)), [Action::Rest]);
        assert_eq!(hand.read(Some(&AHEAD), &cockpit, at(50)), []);
    }

    #[test]
    fn a_stick_that_is_held_does_not_undo_what_let_the_robot_rest() {
        let (mut hand, mut cockpit) = (Hand::default(), cockpit(State::Running));
        hand.read(Some(&Reading::default()), &cockpit, at(0));
        hand.read(Some(&AHEAD), &cockpit, at(10));
        cockpit.setpoint = Setpoint::REST;
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
    fn stop_and_disarm_are_obeyed_at_once_and_the_other_buttons_after_neutral() {
        let cockpit = cockpit(State::Disarmed);
        for (index, action) in COMMANDS.into_iter().enumerate() {
            let mut hand = Hand::default();
            let is_calming = matches!(action, Action::Stop | Action::Disarm);
            let expected: Vec<_> = is_calming.then_some(action).into_iter().collect();
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(0)), expected);
            hand.read(Some(&Reading::default()), &cockpit, at(10));
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(20)), [action]);
            assert_eq!(hand.read(Some(&pressed(index)), &cockpit, at(30)), []);
        }
    }

    #[test]
    fn the_lower_button_which_is_b_on_nintendo_stops_a_robot_that_walks() {
        let lower = Reading { lower: true, ..Reading::default() };
        for is_watched in [true, false] {
            for (state, setpoint, expected) in [
                (State::Running, PaperMode::Forward.setpoint(), [Action::Stop].as_slice()),
                (State::Running, Setpoint::REST, &[Action::Stop]),
                (State::Armed, Setpoint::REST, &[]),
            ] {
                let (mut hands, mut cockpit) = (Hands::default(), cockpit(state));
                cockpit.setpoint = setpoint;
                let pad = [Pad { id: 0, reading: Some(lower), is_pressed: true }];
                assert_eq!(hands.read(&pad, is_watched, &cockpit, at(0)), expected);
                assert_eq!(hands.read(&pad, is_watched, &cockpit, at(10)), []);
            }
        }
    }

    #[test]
    fn the_gamepad_drives_whose_command_changed_last_and_any_ends_the_walk() {
        let (mut hands, mut cockpit) = (Hands::default(), cockpit(State::Running));
        let still = Reading::default();
        let left = Reading { right: -1.0, ..still };
        let mut read = |readings: [Option<Reading>; 2], is_walking: bool, time| {
            cockpit.setpoint =
                if is_walking { PaperMode::Forward.setpoint() } else { Setpoint::REST };
            let pads = [0, 1].map(|id| Pad { id, reading: readings[id], is_pressed: false });
            hands.read(&pads, true, &cockpit, at(time))
        };
        let [forward, turn] = [PaperMode::Forward, PaperMode::LeftTurn].map(Action::Walk);
        assert_eq!(read([Some(still), Some(still)], false, 0), []);
        assert_eq!(read([Some(still), Some(AHEAD)], false, 10), [forward]);
        assert_eq!(read([Some(left), Some(AHEAD)], true, 20), [turn]);
        assert_eq!(read([Some(left), Some(still)], true, 30), [Action::Rest]);
        // The other one is held, and was not let go of since.
        assert_eq!(read([Some(left), Some(still)], false, 500), [Action::Rest]);
        assert_eq!(read([Some(AHEAD), Some(still)], false, 510), []);
        assert_eq!(read([Some(AHEAD), Some(AHEAD)], false, 520), [forward]);
        assert_eq!(read([Some(pressed(0)), Some(AHEAD)], true, 530), [Action::Stop]);
        assert_eq!(read([Some(pressed(2)), Some(AHEAD)], true, 540), [Action::Disarm]);
        // Its layout is known no more.
        assert_eq!(read([Some(still), None], true, 550), [Action::Rest]);
    }

    #[test]
    fn a_gamepad_that_is_never_neutral_keeps_no_other_from_driving() {
        let still = Reading::default();
        for stuck in [
            Reading { right: 0.4, ..still },
            Reading { up: f32::NAN, right: f32::NAN, ..still },
            Reading { other: true, ..still },
            AHEAD,
        ] {
            let (mut hands, cockpit) = (Hands::default(), cockpit(State::Armed));
            let mut read = |reading, time| {
                let pads = [stuck, reading];
                let pads = [0, 1].map(|id| Pad { id, reading: Some(pads[id]), is_pressed: false });
                (hands.read(&pads, true, &cockpit, at(time)), hands.is_touched())
            };
            assert_eq!(read(still, 0), (vec![], false));
            assert_eq!(
                read(AHEAD, 10),
                (vec![Action::Walk(PaperMode::Forward)], true),
                "{stuck:?}"
            );
            assert_eq!(read(AHEAD, 20), (vec![], false), "{stuck:?}");
            assert_eq!(read(still, 30), (vec![Action::Rest], false), "{stuck:?}");
            assert_eq!(read(pressed(0), 40).0, [Action::Stop], "{stuck:?}");
        }
        let up = Reading { up: f32::NAN, right: 1.0, ..still }.in_numbers();
        assert!(up.mode(None) == Some(PaperMode::RightTurn) && up == up.in_numbers());
    }

    #[test]
    fn a_gamepad_that_is_unplugged_while_it_drives_lets_the_robot_rest() {
        let (mut hands, cockpit) = (Hands::default(), cockpit(State::Running));
        let pad = |reading| Pad { id: 3, reading: Some(reading), is_pressed: false };
        hands.read(&[pad(Reading::default())], true, &cockpit, at(0));
        hands.read(&[pad(AHEAD)], true, &cockpit, at(10));
        assert_eq!(hands.read(&[], true, &cockpit, at(20)), [Action::Rest]);
        // It is back, and still held.
        assert_eq!(hands.read(&[pad(AHEAD)], true, &cockpit, at(30)), []);
    }

    #[test]
    fn without_the_focus_gamepads_only_stop_and_disarm() {
        let (mut hands, cockpit) = (Hands::default(), cockpit(State::Running));
        let mut read = |reading, is_watched, time| {
            let pad = Pad { id: 0, reading: Some(reading), is_pressed: false };
            hands.read(&[pad], is_watched, &cockpit, at(time))
        };
        let walk = [Action::Walk(PaperMode::Forward)];
        read(Reading::default(), true, 0);
        assert_eq!(read(AHEAD, true, 10), walk);
        assert_eq!(read(AHEAD, false, 20), [Action::Rest]);
        for (index, expected) in
            [[Action::Stop].as_slice(), &[], &[Action::Disarm], &[]].iter().enumerate()
        {
            assert_eq!(read(Reading::default(), false, 30), []);
            assert_eq!(read(pressed(index), false, 40), *expected);
        }
        // What was held meanwhile begins nothing when the focus is back.
        assert_eq!(read(AHEAD, false, 50), []);
        assert_eq!(read(AHEAD, true, 60), []);
        assert_eq!(read(Reading::default(), true, 70), []);
        assert_eq!(read(AHEAD, true, 80), walk);
    }

    #[test]
    fn a_gamepad_that_shows_the_same_for_ever_has_no_hand_on_it() {
        let (mut hands, mut cockpit) = (Hands::default(), cockpit(State::Running));
        cockpit.setpoint = PaperMode::Forward.setpoint();
        let mut is_touched = |reading, time| {
            hands.read(
                &[Pad { id: 0, reading: Some(reading), is_pressed: false }],
                true,
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
        let mut read = |is_pressed| {
            hands.read(&[Pad { id: 0, reading: None, is_pressed }], true, &cockpit, at(0))
        };
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
            (Reading { up: 0.7, right: 0.6, ..still }, Some(PaperMode::Forward)),
            (Reading { up: 0.6, right: -0.7, ..still }, Some(PaperMode::LeftTurn)),
            (Reading { up: -0.6, right: 0.7, ..still }, Some(PaperMode::RightTurn)),
            (Reading { up: -1.0, ..still }, None),
            (Reading { arrows: [true, false, false], ..still }, Some(PaperMode::Forward)),
            (Reading { arrows: [false, true, false], ..still }, Some(PaperMode::LeftTurn)),
            (Reading { arrows: [false, false, true], ..still }, Some(PaperMode::RightTurn)),
            (Reading { shoulders: [true, false], ..still }, Some(PaperMode::StrafeLeft)),
            (Reading { shoulders: [false, true], ..still }, Some(PaperMode::StrafeRight)),
            (Reading { other: true, ..still }, None),
        ];
        for (reading, mode) in places {
            assert_eq!(reading.mode(None), mode, "{reading:?}");
            assert!(!reading.is_neutral());
        }
        // A stick that trembles keeps what it began.
        let trembles = Reading { up: 0.5, right: 0.49, ..still };
        let mode = Some(PaperMode::Forward);
        assert_eq!((trembles.mode(None), trembles.mode(mode)), (None, mode));
        assert_eq!(Reading { up: 0.39, ..still }.mode(mode), None);
        assert_eq!(
            Reading { up: -0.7, right: 0.5, ..still }.mode(Some(PaperMode::RightTurn)),
            None
        );
    }
}
