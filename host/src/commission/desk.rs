//! What commissioning asks of a robot: trials, runs, captures, and settings that can be put back.

use std::time::Duration;

use flix_protocol::message::{
    Bridges, Channel, Command, Outcome, ParameterCommand, Pattern, ScopeCommand, ScopePlan,
    ScopeState, Setpoint, State, Trial, Trigger,
};

use super::phases::{Phases, Standing};
use super::running::{self, Change, Steady};
use super::turning::{self, Rotor, Turning};
use super::{CommissionError, Finding, Step, Subject, motor_name};
use crate::scope::Capture;

/// Most current of a standing field, mA: a rotor that swings to it adds as much again in a motor of little resistance.
const STANDING_CURRENT_MA: u16 = 700;
/// Ticks of half, and of whole, voltage.
const HALVED_TICKS: u16 = 20;
/// Ticks that the scope keeps of the halved voltages, and some more.
const STANDING_TICKS: u16 = 2_800;
/// Speed of the turning field, 2^-16 turn per tick, and its most current, mA: 10 Hz; where the rotor does not follow
/// that, 6 Hz of more.
const FIELDS: [(i16, u16); 2] = [(66, 800), (40, 1_000)];
/// Ticks for which it turns.
const TURNING_TICKS: u16 = 3_300;
/// Interval of looks at a trial or capture.
const LOOK: Duration = Duration::from_millis(20);
/// Looks after which one is not waited for any longer: 10 s.
const LOOKS: usize = 500;
/// Time to settle at another frequency.
const SETTLING: Duration = Duration::from_millis(1_200);
/// Longest ramp, s.
const RAMP_SECONDS: f64 = 0.2;
/// Time before a ramp that is captured with it.
const BEFORE_RAMP: Duration = Duration::from_millis(80);
/// Rows of the capture before and after a ramp: 80 and 150 ms.
const STEADY_ROWS: [usize; 2] = [800, 1_500];
/// Ramps up and down.
const RAMPS: usize = 6;
/// Most that a rotor which follows its field is off, root mean square, electrical degrees.
const LARGEST_SLIP_DEG: f64 = 60.0;
/// How far the pole pairs may be from a whole number.
const LARGEST_FRACTION: f64 = 0.3;

type Done<T, S> = Result<T, CommissionError<<S as Subject>::Error>>;

/// A robot, and what was changed about it.
pub(super) struct Desk<'a, S> {
    subject: &'a mut S,
    /// Settings: name, value before, value now.
    changed: Vec<(String, f32, f32)>,
}

impl<'a, S: Subject> Desk<'a, S> {
    pub(super) const fn new(subject: &'a mut S) -> Self {
        Self { subject, changed: Vec::new() }
    }

    /// Returns the settings that are not what they were.
    pub(super) fn changes(&self) -> Vec<(String, f32, f32)> {
        self.changed.iter().filter(|(_, before, now)| before != now).cloned().collect()
    }

    /// Disarms, and puts all settings back; what the robot refuses stays.
    pub(super) fn restore(&mut self) {
        let _ = self.subject.disarm();
        for (name, before, _) in core::mem::take(&mut self.changed) {
            let _ = self.write(&name, before);
        }
    }

    pub(super) fn setting(&mut self, name: &str) -> Done<f64, S> {
        self.read(name).map(f64::from)
    }

    fn read(&mut self, name: &str) -> Done<f32, S> {
        let name = name.try_into().map_err(|_| CommissionError::OtherAnswer)?;
        match self.subject.ask(Command::Parameter(ParameterCommand::Get(name)))? {
            Outcome::Parameter(parameter) => Ok(parameter.value),
            _ => Err(CommissionError::OtherAnswer),
        }
    }

    fn write(&mut self, name: &str, value: f32) -> Done<(), S> {
        let name = name.try_into().map_err(|_| CommissionError::OtherAnswer)?;
        self.subject.ask(Command::Parameter(ParameterCommand::Set(name, value)))?;
        Ok(())
    }

    /// Changes a setting.
    pub(super) fn set(&mut self, name: &str, value: f64) -> Done<(), S> {
        let value = value as f32;
        match self.changed.iter().position(|changed| changed.0 == name) {
            Some(index) => self.changed[index].2 = value,
            None => {
                let before = self.read(name)?;
                self.changed.push((name.to_owned(), before, value));
            }
        }
        self.write(name, value)
    }

    /// Changes a setting of both motors.
    pub(super) fn set_each(&mut self, name: &str, values: [f64; 2]) -> Done<(), S> {
        for (motor, value) in values.into_iter().enumerate() {
            self.set(&format!("{}_{name}", motor_name(motor)), value)?;
        }
        Ok(())
    }

    /// Gives a setting the value that it had.
    pub(super) fn set_back(&mut self, name: &str) -> Done<(), S> {
        let before = self.changed.iter().find(|changed| changed.0 == name).map(|it| it.1);
        before.map_or(Ok(()), |before| self.set(name, before.into()))
    }

    /// Corrects what the robot takes for the bus voltage.
    pub(super) fn take_battery(&mut self, battery: f64) -> Done<(), S> {
        let shown = self.subject.telemetry().and_then(|telemetry| telemetry.bus_voltage);
        match shown {
            Some(shown) => {
                let scale = self.setting("battery_scale")?;
                self.set("battery_scale", scale * battery / f64::from(shown.get()))
            }
            None => self.set("nominal_voltage", battery),
        }
    }

    /// Returns the faults, where there are any.
    fn check(&mut self, step: Step) -> Done<(), S> {
        match self.subject.telemetry() {
            Some(telemetry) if telemetry.state == State::Faulted => {
                Err(CommissionError::Faulted { step, faults: telemetry.faults })
            }
            _ => Ok(()),
        }
    }

    pub(super) fn arm(&mut self, step: Step) -> Done<(), S> {
        let armed = self.subject.arm();
        self.check(step)?;
        Ok(armed?)
    }

    pub(super) fn disarm(&mut self, step: Step) -> Done<(), S> {
        let disarmed = self.subject.disarm();
        self.check(step)?;
        Ok(disarmed?)
    }

    fn begin_capture(&mut self, channels: &[Channel], trigger: Trigger) -> Done<(), S> {
        let channels = channels.iter().copied().collect();
        let plan = ScopePlan { channels, trigger, before: 0 };
        self.subject.ask(Command::Scope(ScopeCommand::Begin(plan)))?;
        Ok(())
    }

    /// Waits until the capture is complete, and fetches it.
    fn capture(&mut self, step: Step) -> Done<Columns, S> {
        for _ in 0..LOOKS {
            let Outcome::Scope(status) = self.subject.ask(Command::Scope(ScopeCommand::Status))?
            else {
                return Err(CommissionError::OtherAnswer);
            };
            if status.state == ScopeState::Complete {
                return self.fetch(Capture::new(status));
            }
            self.check(step)?;
            self.subject.pause(LOOK)?;
        }
        Err(CommissionError::Endless(step))
    }

    fn fetch(&mut self, mut capture: Capture) -> Done<Columns, S> {
        while let Some(first) = capture.wanted() {
            let outcome = self.subject.ask(Command::Scope(ScopeCommand::Read(first)))?;
            let is_taken = matches!(&outcome, Outcome::ScopeRows(rows) if capture.take(rows));
            if !is_taken {
                return Err(CommissionError::OtherAnswer);
            }
        }
        Ok(Columns(capture))
    }

    /// Does a trial and captures its pattern.
    fn try_out(
        &mut self,
        step: Step,
        trial: Trial,
        channels: &[Channel],
    ) -> Done<(Columns, Bridges), S> {
        self.begin_capture(channels, Trigger::Pattern)?;
        let Outcome::Trial(bridges) = self.subject.ask(Command::Trial(trial))? else {
            return Err(CommissionError::OtherAnswer);
        };
        let columns = self.capture(step)?;
        for _ in 0..LOOKS {
            self.check(step)?;
            if self.subject.telemetry().is_some_and(|it| it.state == State::Disarmed) {
                return Ok((columns, bridges));
            }
            self.subject.pause(LOOK)?;
        }
        Err(CommissionError::Endless(step))
    }

    /// Captures a standing field of both motors.
    pub(super) fn stand(&mut self) -> Done<([Standing; 2], Bridges), S> {
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
            motors: [true; 2],
            current_ma: STANDING_CURRENT_MA,
            angle: 0,
            pattern: Pattern::Halve(HALVED_TICKS),
            ticks: STANDING_TICKS,
        };
        let (columns, bridges) = self.try_out(Step::Phases, trial, &channels)?;
        let standing = [0, 1].map(|motor| Standing {
            voltage: columns.of(3 * motor),
            currents: [columns.of(3 * motor + 1), columns.of(3 * motor + 2)],
            bus: columns.mean(6),
            interval: HALVED_TICKS.into(),
        });
        Ok((standing, bridges))
    }

    /// Measures one motor under a turning field.
    pub(super) fn turn(
        &mut self,
        motor: usize,
        phases: &Phases,
        bridges: &Bridges,
    ) -> Done<Rotor, S> {
        let mut finding = Finding::DoesNotTurn;
        for field in FIELDS {
            let turning = self.turn_at(field, motor, phases, bridges)?;
            match check_rotor(turning::measure(&turning, &phases.circuit)) {
                Ok(rotor) => return Ok(rotor),
                Err(found) => finding = found,
            }
        }
        Err(CommissionError::Found { motor, finding })
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
        let (columns, _) = self.try_out(Step::Turning(motor), trial, &channels)?;
        let sign = if phases.inverted { -1.0 } else { 1.0 };
        let scaled = |column, scale: f64| -> Vec<f64> {
            columns.of(column).into_iter().map(|current| current * scale).collect()
        };
        Ok(Turning {
            trial,
            voltage: columns.of(0),
            currents: [scaled(1, sign), scaled(2, sign / phases.balance)],
            angles: [columns.of(3), columns.of(4)],
            bus: columns.mean(5),
            pwm_frequency: bridges.pwm_frequency_hz.into(),
        })
    }

    fn hold(&mut self, frequency: f64) {
        self.subject.hold(Setpoint::saturating(frequency as f32, 0.0));
    }

    /// Returns the means of both motors while f is held, Hz.
    pub(super) fn steady(&mut self, step: Step, frequency: f64) -> Done<[Steady; 2], S> {
        self.hold(frequency);
        self.subject.pause(SETTLING)?;
        let channels = [
            Channel::TopSpeed,
            Channel::TopCurrentQ,
            Channel::TopVoltageD,
            Channel::TopVoltageQ,
            Channel::BottomSpeed,
            Channel::BottomCurrentQ,
            Channel::BottomVoltageD,
            Channel::BottomVoltageQ,
        ];
        self.begin_capture(&channels, Trigger::Now)?;
        let columns = self.capture(step)?;
        Ok([0, 1].map(|motor| {
            let mean = |column: usize| columns.mean(4 * motor + column);
            Steady { speed: mean(0), current: mean(1), voltage: [mean(2), mean(3)] }
        }))
    }

    /// Returns the current that each motor takes for an acceleration, A s^2/rad, from ramps between two frequencies (Hz) at so
    /// many Hz/s. Where the bus is not measured only those up count: on the way down d currents burn what the rotors lose.
    pub(super) fn ramps(
        &mut self,
        [slow, fast]: [f64; 2],
        ramp: f64,
        measures_bus: bool,
    ) -> Done<[f64; 2], S> {
        let channels = [
            Channel::TopCurrentQ,
            Channel::TopSpeed,
            Channel::BottomCurrentQ,
            Channel::BottomSpeed,
        ];
        let fast = fast.min(slow + RAMP_SECONDS * ramp);
        self.hold(slow);
        self.subject.pause(SETTLING)?;
        let mut changes: [Vec<Change>; 2] = Default::default();
        for count in 0..RAMPS {
            self.begin_capture(&channels, Trigger::Now)?;
            self.subject.pause(BEFORE_RAMP)?;
            self.hold(if count % 2 == 0 { fast } else { slow });
            let columns = self.capture(Step::Ramps)?;
            if !measures_bus && count % 2 == 1 {
                continue;
            }
            for (motor, changes) in changes.iter_mut().enumerate() {
                let (current, speed) = (columns.of(2 * motor), columns.of(2 * motor + 1));
                changes.push(Change { current, speed });
            }
        }
        Ok(changes.map(|all| running::current_per_acceleration(&all, STEADY_ROWS).unwrap_or(0.0)))
    }
}

/// Returns the rotor if it followed its field.
fn check_rotor(rotor: Option<Rotor>) -> Result<Rotor, Finding> {
    let Some(rotor) = rotor else { return Err(Finding::DoesNotTurn) };
    if rotor.other_travel > rotor.travel {
        return Err(Finding::EncodersSwapped);
    }
    if !(1..=32).contains(&rotor.pole_pairs()) || rotor.slip > LARGEST_SLIP_DEG {
        return Err(Finding::DoesNotTurn);
    }
    if (rotor.ratio.abs() - f64::from(rotor.pole_pairs())).abs() > LARGEST_FRACTION {
        return Err(Finding::PolePairs(rotor.ratio.abs()));
    }
    Ok(rotor)
}

/// The columns of a capture.
struct Columns(Capture);

impl Columns {
    fn of(&self, column: usize) -> Vec<f64> {
        self.0.column(column).map(|(_, value)| value).collect()
    }

    fn mean(&self, column: usize) -> f64 {
        let column = self.of(column);
        column.iter().sum::<f64>() / column.len().max(1) as f64
    }
}
