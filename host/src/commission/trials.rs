//! The trials of commissioning, one field after the other.

use flix_protocol::message::{
    Bridges, Channel, Command, Fault, Faults, Halt, LEAST_TRIAL_CURRENT_MA, LONGEST_PATTERN_TICKS,
    MOST_TRIAL_CURRENT_MA, Outcome, Pattern, Refusal, State, Telemetry, Trial, Trigger,
};

use super::circuit;
use super::circuit::{Circuit, Phases, Standing};
use super::finding::Finding;
use super::robot_under_test::{Columns, Done, LOOK, LOOKS, RobotUnderTest};
use super::step::{CommissionError, Step};
use super::swing::Swing;
use super::turning_field::{self, Rotor, Turning};
use super::wiring::{ANGLES, Resting, Stood};
use crate::link::{LinkError, PASSING_PATIENCE, RobotLink, TELEMETRY_LAG, Update, Wish};

/// Current that shows how a motor is wired, mA: where an amplifier is dead, twice as much may flow.
const WIRING_CURRENT_MA: u16 = 300;
/// Ticks that the scope keeps of it: 0.1 s.
const WIRING_TICKS: u16 = 1_000;
/// Ticks before the end of a trial that found no current: the robot looks for one for 0.41 s.
const LOOKED_TICKS: u16 = 400;
/// Looks after which a trial of the wiring is over: 2.4 s; and how often it is done again.
const TRIAL_LOOKS: usize = 120;
const TRIES: usize = 4;
/// Most current of a standing field, mA: a rotor that swings to it adds as much again in a motor of little resistance.
const STANDING_CURRENT_MA: u16 = 700;
/// Currents, as they are shown, at which a rotor is looked at before anything is known of the amplifiers, mA: such as show a
/// twentieth let 1 A flow at first, and each rotor of this size turns before more than 2 A do.
const FIRST_CURRENTS_MA: [u16; 4] = [LEAST_TRIAL_CURRENT_MA, 100, 200, 400];
/// Ticks of half, and of whole, voltage.
const HALVED_TICKS: u16 = 20;
/// Ticks that the scope keeps of the halved voltages, and some more.
const STANDING_TICKS: u16 = 2_800;
/// Speed of the turning field, 2^-16 turn per tick, and its most current, mA: 10 Hz; where the rotor does not follow
/// that, 6 Hz of more, and of more.
const FIELDS: [(i16, u16); 3] = [(66, 800), (40, 1_000), (40, MOST_TRIAL_CURRENT_MA)];
/// Ticks for which it turns.
const TURNING_TICKS: u16 = 3_300;
/// Ticks between jumps of the field that a rotor swings after, and in all.
const SWING_TICKS: u16 = 600;
const SWING_ROWS: u16 = 2_700;
/// The fault of a trial whose amplifiers show no current; that of a trial with too much current; and both, which trials cause whose
/// amplifiers show less current than flows.
const UNSEEN: Faults = Faults::NONE.with(Fault::CurrentSense);
const TOO_MUCH: Faults = Faults::NONE.with(Fault::OverCurrent);
const OF_TRIALS: Faults = UNSEEN.union(TOO_MUCH);
/// How often a trial is begun whose commands stay away.
const MOST_TRIALS: u32 = 10;
/// Most that a rotor which follows its field is off, root mean square, electrical degrees.
const LARGEST_SLIP_DEG: f64 = 60.0;
/// The other motor's encoder sees a rotor turn when it turns farther, degrees.
const LEAST_OTHER_TRAVEL: f64 = 3.0;
/// How far the pole pairs may be from a whole number.
const LARGEST_FRACTION: f64 = 0.3;

/// What a motor made of little current.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct First {
    /// Whether any shows.
    pub(super) shows: bool,
    /// What its amplifiers show over what flows, by the inertia of its rotor; `None` where it did not turn.
    pub(super) scale: Option<f64>,
    /// By the currents that are shown; `None` where they are not a winding's.
    pub(super) circuit: Option<Circuit>,
}

impl<S: RobotLink> RobotUnderTest<'_, S> {
    /// Does a trial and captures its pattern; again where commands stayed away meanwhile, so that the motors coasted.
    fn try_out(
        &mut self,
        step: Step,
        trial: Trial,
        channels: &[Channel],
        rows: u16,
    ) -> Done<(Columns, Bridges), S> {
        self.until_held(MOST_TRIALS, |it| it.try_once(step, trial, channels, rows))
    }

    fn try_once(
        &mut self,
        step: Step,
        trial: Trial,
        channels: &[Channel],
        rows: u16,
    ) -> Done<(Columns, Bridges), S> {
        let permit = self.permit();
        self.begin_capture(channels, Trigger::Pattern, 0)?;
        let Outcome::Bridges(bridges) = self.robot.ask(Command::Bridges)? else {
            return Err(CommissionError::OtherAnswer);
        };
        self.begin_trial(step, trial)?;
        let columns = self.capture_since(step, rows, permit)?;
        self.await_state(step, State::Disarmed, false)?;
        self.check_unbroken(step, permit)?;
        Ok((columns, bridges))
    }

    /// Presses for a trial, and waits until it has begun.
    fn begin_trial(&mut self, step: Step, trial: Trial) -> Done<(), S> {
        let before = self.permit();
        self.robot.press(Wish::Try(trial))?;
        let patience = PASSING_PATIENCE + TELEMETRY_LAG;
        let begun = self.robot.wait_for(patience, |_, update| match update {
            Update::Ended { why, .. } => Some(Some(why.clone())),
            // Under way, or over already.
            Update::Telemetry(Telemetry { state: State::Aligning, .. }) => Some(None),
            Update::Telemetry(Telemetry { halt, permit, .. }) if Some(*permit) != before => {
                match halt {
                    Halt::Tried => Some(None),
                    Halt::LetGo => Some(Some(Some(Refusal::Rested))),
                    _ => None,
                }
            }
            _ => None,
        })?;
        match begun {
            Some(None) => Ok(()),
            Some(Some(Some(Refusal::Rested))) => Err(self.lapsed(step)),
            Some(Some(Some(refusal))) => {
                self.check(step)?;
                Ok(self.robot.refused(refusal)?)
            }
            Some(Some(None)) | None => Err(S::Error::from(LinkError::Unanswered).into()),
        }
    }

    /// Captures a robot that does nothing.
    pub(super) fn look(&mut self) -> Done<Resting, S> {
        let channels = [
            Channel::TopAngle,
            Channel::BottomAngle,
            Channel::TopPhaseA,
            Channel::TopPhaseB,
            Channel::BottomPhaseA,
            Channel::BottomPhaseB,
        ];
        self.begin_capture(&channels, Trigger::Now, 0)?;
        let columns = self.capture_since(Step::Wiring, WIRING_TICKS, None)?;
        let currents = [0, 1].map(|motor| [2, 3].map(|it| columns.mean(2 * motor + it)));
        Ok(Resting { angles: [columns.of(0), columns.of(1)], currents })
    }

    /// Lets a field stand along each phase of each motor, whose amplifiers show so many times the current that flows; 0 where
    /// nobody knows.
    pub(super) fn wiring(&mut self, scales: [f64; 2]) -> Done<[[Stood; 3]; 2], S> {
        let mut motors = [[Stood::default(); 3]; 2];
        for (motor, fields) in motors.iter_mut().enumerate() {
            let current_ma = shown_ma(WIRING_CURRENT_MA, scales[motor]);
            for (field, stood) in fields.iter_mut().enumerate() {
                *stood = self.stand_along(motor, field, current_ma)?;
            }
        }
        Ok(motors)
    }

    fn stand_along(&mut self, motor: usize, field: usize, current_ma: u16) -> Done<Stood, S> {
        let voltages = [Channel::TopVoltageD, Channel::BottomVoltageD];
        let phases = [
            [Channel::TopPhaseA, Channel::TopPhaseB],
            [Channel::BottomPhaseA, Channel::BottomPhaseB],
        ];
        let [[a, b], [other_a, other_b]] = [phases[motor], phases[1 - motor]];
        let channels = [voltages[motor], a, b, other_a, other_b, Channel::Bus];
        let trial = Trial {
            motors: [motor == 0, motor == 1],
            current_ma,
            angle: ANGLES[field],
            pattern: Pattern::Halve(HALVED_TICKS),
            ticks: WIRING_TICKS,
        };
        let (columns, bridges) = self.show_current(trial, &channels)?;
        let all: [Vec<f64>; 5] = core::array::from_fn(|column| columns.of(column));
        let mean = |index: usize| all[index].iter().sum::<f64>() / all[index].len() as f64;
        let per_volt = |index: usize| mean(index) / mean(0);
        let [own, other] = [[1, 2], [3, 4]].map(|pair| pair.map(per_volt));
        let third: Vec<f64> = all[1].iter().zip(&all[2]).map(|(a, b)| -a - b).collect();
        let along = [[&all[1], &all[2]], [&all[2], &all[1]], [&third, &all[1]]];
        let standing = Standing {
            currents: along[field].map(Clone::clone),
            bus: columns.mean(5),
            interval: HALVED_TICKS.into(),
            voltage: all[0].clone(),
        };
        let circuit = bridges
            .and_then(|bridges| circuit::measure(&standing, &bridges, 1.0))
            .map(|found| found.circuit);
        Ok(Stood { own, other, circuit })
    }

    /// Does a trial; where it finds no current, another, of which what all amplifiers show before it gives up is captured.
    fn show_current(
        &mut self,
        trial: Trial,
        channels: &[Channel],
    ) -> Done<(Columns, Option<Bridges>), S> {
        for _ in 0..TRIES {
            match self.try_out(Step::Wiring, trial, channels, WIRING_TICKS) {
                Ok((columns, bridges)) => return Ok((columns, Some(bridges))),
                Err(CommissionError::Faulted { faults, .. }) if faults == UNSEEN => {}
                Err(error) => return Err(error),
            }
            self.clear(Step::Wiring, UNSEEN)?;
            self.begin_capture(channels, Trigger::Fault, LOOKED_TICKS)?;
            match self.begin_trial(Step::Wiring, trial) {
                // It gave up before telemetry showed that it began.
                Ok(()) | Err(CommissionError::Faulted { .. }) => {}
                Err(error) => return Err(error),
            }
            // Where a current just about shows, this one may find it.
            for _ in 0..TRIAL_LOOKS {
                if let Some(columns) = self.captured(LOOKED_TICKS)? {
                    self.clear(Step::Wiring, UNSEEN)?;
                    return Ok((columns, None));
                }
                self.robot.pause(LOOK)?;
            }
        }
        Err(CommissionError::Endless(Step::Wiring))
    }

    /// Clears faults that were expected; the robot lets them go once its motors were braked.
    pub(super) fn clear(&mut self, step: Step, expected: Faults) -> Done<(), S> {
        self.await_state(step, State::Faulted, true)?;
        for _ in 0..LOOKS {
            // A program clears neither another fault nor a stop.
            if self.robot.telemetry().is_some_and(|it| it.stopped) {
                self.robot.refused(Refusal::Stopped)?;
            }
            if self.robot.telemetry().is_some_and(|it| it.faults.union(expected) != expected) {
                self.check(step)?;
            }
            self.robot.press(Wish::Clear)?;
            self.robot.pause(LOOK)?;
            if self.robot.telemetry().is_some_and(|it| it.state == State::Disarmed) {
                return Ok(());
            }
        }
        Err(CommissionError::Endless(step))
    }

    /// Captures a standing field of these motors.
    pub(super) fn stand(
        &mut self,
        step: Step,
        motors: [bool; 2],
        current_ma: u16,
    ) -> Done<([Standing; 2], Bridges), S> {
        let channels = [
            Channel::TopVoltageD,
            Channel::TopPhaseA,
            Channel::TopPhaseB,
            Channel::BottomVoltageD,
            Channel::BottomPhaseA,
            Channel::BottomPhaseB,
            Channel::Bus,
        ];
        let trial = Trial {
            motors,
            current_ma,
            angle: 0,
            pattern: Pattern::Halve(HALVED_TICKS),
            ticks: STANDING_TICKS,
        };
        let (columns, bridges) = self.try_out(step, trial, &channels, STANDING_TICKS)?;
        let standing = [0, 1].map(|motor| Standing {
            voltage: columns.of(3 * motor),
            currents: [columns.of(3 * motor + 1), columns.of(3 * motor + 2)],
            bus: columns.mean(6),
            interval: HALVED_TICKS.into(),
        });
        Ok((standing, bridges))
    }

    /// Looks what the amplifiers of a motor show of the current that turns it, while little is shown: at each step more, until
    /// the rotor follows.
    pub(super) fn first(&mut self, motor: usize, inertia: f64) -> Done<First, S> {
        let mut first = First::default();
        let mut tries = TRIES;
        let mut currents = FIRST_CURRENTS_MA.into_iter().peekable();
        while let Some(current_ma) = currents.peek() {
            match self.scale_at(motor, *current_ma, inertia) {
                Ok(found) => {
                    first = found;
                    currents.next();
                }
                Err(CommissionError::Faulted { faults, .. })
                    if faults.union(OF_TRIALS) == OF_TRIALS =>
                {
                    self.clear(Step::Wiring, OF_TRIALS)?;
                    tries -= 1;
                    // Where a current just about shows, the next one may find it.
                    if tries == 0 || !faults.contains(Fault::CurrentSense) {
                        break;
                    }
                }
                Err(error) => return Err(error),
            }
            if first.scale.is_some() {
                break;
            }
        }
        Ok(first)
    }

    fn scale_at(&mut self, motor: usize, current_ma: u16, inertia: f64) -> Done<First, S> {
        let driven = [motor == 0, motor == 1];
        let (standing, bridges) = self.stand(Step::Wiring, driven, current_ma)?;
        let found = circuit::measure(&standing[motor], &bridges, 1.0).filter(circuit::is_winding);
        let shown = First { shows: true, ..First::default() };
        let Some(phases) = found else { return Ok(shown) };
        let still = First { circuit: Some(phases.circuit), ..shown };
        let turning = self.turn_at((FIELDS[0].0, current_ma), motor, &phases, &bridges)?;
        let Ok(rotor) = follows(motor, turning_field::measure(&turning, &phases.circuit)) else {
            return Ok(still);
        };
        let swing = self.swing(motor, &phases, f64::from(turning.trial.current_ma) / 1e3)?;
        Ok(First { scale: super::swing::scale(&swing, &rotor, inertia), ..still })
    }

    /// Measures one motor under a turning field; returns it with the current that it followed, A.
    pub(super) fn turn(
        &mut self,
        motor: usize,
        phases: &Phases,
        bridges: &Bridges,
        scale: f64,
    ) -> Done<(Rotor, f64), S> {
        let mut finding = Finding::Blocked(motor);
        for (speed, current_ma) in FIELDS {
            let field = (speed, shown_ma(current_ma, scale));
            let turning = self.turn_at(field, motor, phases, bridges)?;
            let current = f64::from(turning.trial.current_ma) / 1e3;
            match follows(motor, turning_field::measure(&turning, &phases.circuit)) {
                Ok(rotor) if !rotor.is_unclear() => return Ok((rotor, current)),
                Ok(rotor) => {
                    let (ratio, slip) = self.turn_on(turning.trial)?;
                    let rotor = Rotor { ratio, slip, ..rotor };
                    if slip > LARGEST_SLIP_DEG {
                        continue;
                    }
                    if rotor.fraction() > LARGEST_FRACTION {
                        finding = Finding::PolePairs { motor, ratio: ratio.abs() };
                        break;
                    }
                    return Ok((rotor, current));
                }
                Err(Finding::Blocked(_))
                    if turning_field::is_drawn_along(&turning, &phases.circuit) =>
                {
                    finding = Finding::EncoderBlind(motor);
                }
                Err(Finding::Blocked(_)) => {}
                Err(found) => return Err(CommissionError::Found(found)),
            }
        }
        Err(CommissionError::Found(finding))
    }

    /// Turns a rotor as far as a trial goes, and returns its ratio and slip more closely: an encoder whose magnet is off its
    /// middle counts some way as more and some as less.
    fn turn_on(&mut self, trial: Trial) -> Done<(f64, f64), S> {
        let motor = usize::from(trial.motors[1]);
        let channel = [Channel::TopAngle, Channel::BottomAngle][motor];
        let trial = Trial { ticks: LONGEST_PATTERN_TICKS, ..trial };
        let (trial, columns) = self.try_gently(motor, trial, &[channel], LONGEST_PATTERN_TICKS)?;
        turning_field::ratio(&trial, &columns.of(0))
            .ok_or(CommissionError::Found(Finding::Blocked(motor)))
    }

    fn turn_at(
        &mut self,
        (speed, current_ma): (i16, u16),
        motor: usize,
        phases: &Phases,
        bridges: &Bridges,
    ) -> Done<Turning, S> {
        let channels = if motor == 0 {
            [
                Channel::TopVoltageD,
                Channel::TopPhaseA,
                Channel::TopPhaseB,
                Channel::TopAngle,
                Channel::BottomAngle,
                Channel::Bus,
            ]
        } else {
            [
                Channel::BottomVoltageD,
                Channel::BottomPhaseA,
                Channel::BottomPhaseB,
                Channel::BottomAngle,
                Channel::TopAngle,
                Channel::Bus,
            ]
        };
        let trial = Trial {
            motors: [motor == 0, motor == 1],
            current_ma,
            angle: 0,
            pattern: Pattern::Turn(speed),
            ticks: TURNING_TICKS,
        };
        let (trial, columns) = self.try_gently(motor, trial, &channels, TURNING_TICKS)?;
        Ok(Turning {
            trial,
            voltage: columns.of(0),
            currents: currents([columns.of(1), columns.of(2)], phases),
            angles: [columns.of(3), columns.of(4)],
            uneven: phases.uneven,
            bus: columns.mean(5),
            pwm_frequency: bridges.pwm_frequency_hz.into(),
        })
    }

    /// Does a trial of a rotor that moves. Where a phase carries too much it is done again with three quarters of the current.
    /// Returns it as it was done.
    fn try_gently(
        &mut self,
        motor: usize,
        mut trial: Trial,
        channels: &[Channel],
        rows: u16,
    ) -> Done<(Trial, Columns), S> {
        loop {
            match self.try_out(Step::Turning(motor), trial, channels, rows) {
                Ok((columns, _)) => return Ok((trial, columns)),
                Err(CommissionError::Faulted { faults, .. })
                    if faults == TOO_MUCH && trial.current_ma * 3 / 4 >= LEAST_TRIAL_CURRENT_MA => {
                }
                Err(error) => return Err(error),
            }
            self.clear(Step::Turning(motor), TOO_MUCH)?;
            trial.current_ma = trial.current_ma * 3 / 4;
        }
    }

    /// Lets the rotor swing after a field that jumps, by this current, A.
    pub(super) fn swing(&mut self, motor: usize, phases: &Phases, current: f64) -> Done<Swing, S> {
        let channels = if motor == 0 {
            [Channel::TopPhaseA, Channel::TopPhaseB, Channel::TopAngle]
        } else {
            [Channel::BottomPhaseA, Channel::BottomPhaseB, Channel::BottomAngle]
        };
        let trial = Trial {
            motors: [motor == 0, motor == 1],
            current_ma: (1e3 * current) as u16,
            angle: 0,
            pattern: Pattern::Swing(SWING_TICKS),
            ticks: SWING_ROWS,
        };
        let (_, columns) = self.try_gently(motor, trial, &channels, SWING_ROWS)?;
        let currents = currents([columns.of(0), columns.of(1)], phases);
        Ok(Swing { currents, angles: columns.of(2) })
    }
}

/// Returns how much of the standing field motors of these scales show.
pub(super) fn standing_ma(scales: [f64; 2]) -> u16 {
    shown_ma(STANDING_CURRENT_MA, scales[0].min(scales[1]))
}

/// Returns what amplifiers of this scale, shown over true, show of a current; of one that they exaggerate no more than it is.
pub(super) fn shown_ma(current_ma: u16, scale: f64) -> u16 {
    let shown = f64::from(current_ma) * scale.min(1.0);
    (shown as u16).max(LEAST_TRIAL_CURRENT_MA)
}

/// Returns the currents of phases A and B, in amperes as A shows them, from what both amplifiers showed.
fn currents([a, b]: [Vec<f64>; 2], phases: &Phases) -> [Vec<f64>; 2] {
    let sign = if phases.inverted { -1.0 } else { 1.0 };
    let scaled = |column: Vec<f64>, scale: f64| -> Vec<f64> {
        column.into_iter().map(|current| current * scale).collect()
    };
    [scaled(a, sign), scaled(b, sign / phases.balance)]
}

/// Returns the rotor if it followed its field.
fn follows(motor: usize, rotor: Option<Rotor>) -> Result<Rotor, Finding> {
    let Some(rotor) = rotor else { return Err(Finding::Blocked(motor)) };
    if rotor.other_travel > rotor.travel.max(LEAST_OTHER_TRAVEL) {
        return Err(Finding::EncodersSwapped(motor));
    }
    if !(1..=32).contains(&rotor.pole_pairs()) || rotor.slip > LARGEST_SLIP_DEG {
        return Err(Finding::Blocked(motor));
    }
    Ok(rotor)
}
