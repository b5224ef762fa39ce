//! The robot that is commissioned: trials, runs, captures, and settings that can be put back.

use std::f64::consts::TAU;
use std::time::Duration;

use flix_protocol::failsafe::longest_command_age;
use flix_protocol::message::{
    Channel, Command, Fault, Halt, Mark, Outcome, Parameter, ParameterCommand, Permit, Refusal,
    ScopeCommand, ScopePlan, ScopeState, Setpoint, State, Trigger,
};

use super::finding::{Finding, motor_name};
use super::running::{self, Change, Steady};
use super::step::{CURRENT_LIMIT, CommissionError, Step};
use crate::link::RobotLink;
use crate::scope::{self, Capture};

/// How far the divider may be off a voltmeter.
const BATTERY_RATIOS: std::ops::Range<f64> = 0.85..1.18;
/// Interval of looks at a trial or capture.
pub(super) const LOOK: Duration = Duration::from_millis(20);
/// Looks after which one is not waited for any longer: 10 s.
pub(super) const LOOKS: usize = 500;
/// f that comes down is there when it is no more than this times what it comes down to.
const NEARLY: f64 = 1.1;
/// Time to settle at another frequency.
const SETTLING: Duration = Duration::from_millis(1_200);
/// Longest ramp, s.
const RAMP_SECONDS: f64 = 0.2;
/// Time before a ramp that is captured with it.
const BEFORE_RAMP: Duration = Duration::from_millis(80);
/// Longest time from the question for the capture of a ramp to its answer: the capture lasts 480 ms, of which the ramp takes 430.
const BEGUN_WITHIN: Duration = Duration::from_millis(40);
/// Captures that are begun until one is answered in time.
const BEGINNINGS: usize = 10;
/// Rows of the capture before and after a ramp: 80 and 150 ms.
const STEADY_ROWS: [usize; 2] = [800, 1_500];
/// The same of a capture without one.
const ALL_STEADY: [usize; 2] = [usize::MAX, 0];
const POSITION_BANDWIDTH: &str = "position_bandwidth";
/// Ramps that count, up and down, and the most there are.
const LEAST_RAMPS: f64 = 6.0;
const MOST_RAMPS: f64 = 72.0;
/// Parts of the ramps, one after the other, of which each shows what current speeds a rotor up.
const THIRDS: usize = 3;
/// By how much the largest of these may be above the smallest, as a share, times the root of the ramps that count. On a body that
/// stands on its legs it is up to 0.12, on one that is held 0.04; a rotor that begins to rub makes 0.6 or more of it.
const LARGEST_UNEVENNESS: f64 = 0.3;
/// Change of friction, fast and slow, from before the ramps to their ends and until after them, as a share of the current that speeds a
/// rotor up, and by how many standard errors of the ramps' ends it may be larger. Friction of 1 mN m more, for which resistance comes
/// out a tenth wrong, makes 0.04; on legs up to 0.052 and 0.019 was seen.
const LARGEST_CHANGES: [f64; 2] = [0.06, 0.03];
const STANDARD_ERRORS: f64 = 3.0;
/// Current times time of a ramp, A s, from which on friction and noise are little beside it. A motor that makes much torque of little
/// current takes less, and more ramps.
const FULL_IMPULSE: f64 = 8e-3;
pub(super) type Done<T, S> = Result<T, CommissionError<<S as RobotLink>::Error>>;

/// A robot, and what was changed about it.
pub(super) struct RobotUnderTest<'a, S> {
    pub(super) robot: &'a mut S,
    changed: Vec<Changed>,
    /// Whether the robot was armed, and so aligned anew.
    is_aligned: bool,
}

/// A setting that was changed.
struct Changed {
    name: String,
    before: f32,
    /// How the value before was known; `None` where that needs no word.
    mark: Option<Mark>,
    now: f32,
}

impl<'a, S: RobotLink> RobotUnderTest<'a, S> {
    pub(super) const fn new(robot: &'a mut S) -> Self {
        Self { robot, changed: Vec::new(), is_aligned: false }
    }

    /// Returns the settings that are not what they were; whether it is aligned a robot sets itself.
    pub(super) fn changes(&self) -> Vec<(String, f32, f32)> {
        let differs = |it: &&Changed| it.before != it.now && !it.name.ends_with("_aligned");
        let differing = self.changed.iter().filter(differs);
        differing.map(|it| (it.name.clone(), it.before, it.now)).collect()
    }

    /// Disarms, and puts all settings back, the newest first; what the robot refuses stays. An alignment of before does not
    /// come back once there was a new one.
    fn restore(&mut self) {
        let _ = self.robot.disarm();
        for Changed { name, before, mark, .. } in
            core::mem::take(&mut self.changed).into_iter().rev()
        {
            if self.is_aligned && name.ends_with("_aligned") {
                continue;
            }
            // First as if it were measured: that makes nothing else assumed.
            let _ = self.write(&name, before, Mark::Measured);
            let _ = mark.map(|mark| self.write(&name, before, mark));
        }
    }

    /// Returns what was found; on an error puts all settings back first.
    pub(super) fn conclude<T>(&mut self, found: Done<T, S>) -> Done<T, S> {
        if found.is_err() {
            self.restore();
        }
        match found {
            Err(CommissionError::Faulted { faults, .. }) if faults.contains(Fault::EncoderLost) => {
                Err(CommissionError::Found(Finding::EncoderLost))
            }
            found => found,
        }
    }

    /// Checks that the robot has no fault, and may be given the current that commissioning takes.
    pub(super) fn begin(&mut self) -> Done<(), S> {
        self.check(Step::Wiring)?;
        let limit = self.setting("current_limit")?;
        // As the robot has it, rounded.
        if limit < f64::from(CURRENT_LIMIT as f32) {
            Err(CommissionError::Limited { limit })
        } else {
            Ok(())
        }
    }

    /// Bounds ramps, Hz/s, the current of alignment, and all current, A. The slower a ramp, the younger must commands be.
    pub(super) fn bound(&mut self, ramp: f64, aligning: f64, limit: f64) -> Done<(), S> {
        let age = self.setting("command_age")?;
        self.set("command_age", age.min(longest_command_age(ramp as f32).as_secs_f64()))?;
        self.set("frequency_ramp", ramp)?;
        // At most the limit, before and after.
        self.set("alignment_current", aligning)?;
        self.set("current_limit", limit)
    }

    /// Ends the bounds, but for that of alignment.
    pub(super) fn unbound(&mut self) -> Done<(), S> {
        ["frequency_ramp", "command_age", "current_limit"]
            .into_iter()
            .try_for_each(|name| self.set_back(name))
    }

    pub(super) fn setting(&mut self, name: &str) -> Done<f64, S> {
        Ok(self.robot.setting(name)?)
    }

    /// Returns a setting and how it is known.
    pub(super) fn marked(&mut self, name: &str) -> Done<(f64, Option<Mark>), S> {
        let parameter = self.robot.parameter(name)?;
        Ok((parameter.value.into(), parameter.mark))
    }

    fn write(&mut self, name: &str, value: f32, mark: Mark) -> Done<(), S> {
        self.robot.set_marked(name, value, mark)?;
        Ok(())
    }

    /// Changes a setting.
    pub(super) fn set(&mut self, name: &str, value: f64) -> Done<(), S> {
        let value = value as f32;
        match self.changed.iter().position(|changed| changed.name == name) {
            Some(index) => self.changed[index].now = value,
            None => {
                let Parameter { value: before, mark, .. } = self.robot.parameter(name)?;
                self.changed.push(Changed { name: name.to_owned(), before, mark, now: value });
            }
        }
        self.write(name, value, Mark::Measured)
    }

    /// Changes a setting of both motors.
    pub(super) fn set_each(&mut self, name: &str, values: [f64; 2]) -> Done<(), S> {
        for (motor, value) in values.into_iter().enumerate() {
            self.set(&format!("{}_{name}", motor_name(motor)), value)?;
        }
        Ok(())
    }

    /// Gives the position loops this bandwidth, Hz, or the largest that the robot calls stable beside its other settings.
    pub(super) fn set_position_bandwidth(&mut self, bandwidth: f64) -> Done<(), S> {
        self.set(POSITION_BANDWIDTH, bandwidth)?;
        match self.robot.insist(Command::Parameter(ParameterCommand::Check))? {
            Outcome::Refused(Refusal::UnstablePosition { position_bandwidth_instead, .. })
                if position_bandwidth_instead > 0.0 =>
            {
                self.set(POSITION_BANDWIDTH, position_bandwidth_instead.into())
            }
            // What else it refuses is said when it is armed.
            _ => Ok(()),
        }
    }

    /// Gives a setting the value that it had.
    pub(super) fn set_back(&mut self, name: &str) -> Done<(), S> {
        let before = self.changed.iter().find(|changed| changed.name == name).map(|it| it.before);
        before.map_or(Ok(()), |before| self.set(name, before.into()))
    }

    /// Corrects what the robot takes for the bus voltage.
    pub(super) fn take_battery(&mut self, battery: f64) -> Done<(), S> {
        let shown = self.robot.telemetry().and_then(|telemetry| telemetry.bus_voltage);
        match shown {
            Some(shown) => {
                let (shown, entered) = (shown.get(), battery);
                if !BATTERY_RATIOS.contains(&(entered / f64::from(shown))) {
                    let finding = Finding::Battery { shown: shown.into(), entered };
                    return Err(CommissionError::Found(finding));
                }
                let scale = self.setting("battery_scale")?;
                self.set("battery_scale", scale * battery / f64::from(shown))
            }
            None => self.set("nominal_voltage", battery),
        }
    }

    /// Returns the bus voltage as the robot takes it, V.
    pub(super) fn bus(&mut self) -> Done<f64, S> {
        match self.robot.telemetry().and_then(|telemetry| telemetry.bus_voltage) {
            Some(shown) => Ok(shown.get().into()),
            None => self.setting("nominal_voltage"),
        }
    }

    /// Returns the faults, where there are any.
    pub(super) fn check(&mut self, step: Step) -> Done<(), S> {
        match self.robot.telemetry() {
            Some(telemetry) if telemetry.state == State::Faulted => {
                Err(CommissionError::Faulted { step, faults: telemetry.faults })
            }
            _ => Ok(()),
        }
    }

    /// Returns the faults, or that the walk has ended, where f is not held any more.
    fn check_held(&mut self, step: Step, frequency: f64) -> Done<(), S> {
        self.check(step)?;
        if self.robot.operate().0.held() == Some(along(frequency)) {
            Ok(())
        } else {
            Err(self.lapsed(step))
        }
    }

    /// Returns the error of a robot that stopped by itself.
    pub(super) fn lapsed(&mut self, step: Step) -> CommissionError<S::Error> {
        let halt = self.robot.telemetry().map_or(Halt::Operator, |it| it.halt);
        CommissionError::Lapsed { step, halt }
    }

    /// Does this at most so many times: again while the robot stopped by itself in the middle of it.
    pub(super) fn until_held<T>(
        &mut self,
        most: u32,
        mut attempt: impl FnMut(&mut Self) -> Done<T, S>,
    ) -> Done<T, S> {
        for _ in 1..most {
            match attempt(self) {
                Err(CommissionError::Lapsed { .. }) => self.robot.disarm()?,
                done => return done,
            }
        }
        attempt(self)
    }

    pub(super) fn arm(&mut self, step: Step) -> Done<(), S> {
        self.is_aligned = true;
        let armed = self.robot.arm();
        self.check(step)?;
        Ok(armed?)
    }

    /// Lets f, Hz, come down to this by its ramp, then disarms: what still turns 0.4 s later is braked, and a motor of little
    /// resistance turns that into much current.
    pub(super) fn disarm(&mut self, step: Step, braked_from: f64) -> Done<(), S> {
        let mut frequency = self.frequency();
        self.hold(braked_from.copysign(frequency));
        for _ in 0..LOOKS {
            if frequency.abs() <= NEARLY * braked_from {
                break;
            }
            self.robot.pause(LOOK)?;
            self.check(step)?;
            frequency = self.frequency();
        }
        let disarmed = self.robot.disarm();
        self.check(step)?;
        Ok(disarmed?)
    }

    pub(super) fn begin_capture(
        &mut self,
        channels: &[Channel],
        trigger: Trigger,
        before: u16,
    ) -> Done<(), S> {
        let channels = channels.iter().copied().collect();
        let plan = ScopePlan { channels, trigger, before };
        self.robot.ask(Command::Scope(ScopeCommand::Begin(plan)))?;
        Ok(())
    }

    /// Begins a capture, and another where the answer was late: the capture would end before the ramp that follows does.
    fn begin_capture_now(&mut self, channels: &[Channel]) -> Done<(), S> {
        for _ in 0..BEGINNINGS {
            let asked = self.robot.operate().1;
            self.begin_capture(channels, Trigger::Now, 0)?;
            if self.robot.operate().1.since(asked) <= BEGUN_WITHIN {
                break;
            }
        }
        Ok(())
    }

    /// Waits until the capture is complete, and fetches its first rows, at most so many.
    pub(super) fn capture(&mut self, step: Step, rows: u16) -> Done<Columns, S> {
        let permit = self.permit();
        self.capture_since(step, rows, permit)
    }

    /// The same, of a robot that stated this permit when the step began: a halt ends it. Without a permit none does.
    pub(super) fn capture_since(
        &mut self,
        step: Step,
        rows: u16,
        permit: Option<Permit>,
    ) -> Done<Columns, S> {
        for _ in 0..LOOKS {
            if let Some(columns) = self.captured(rows)? {
                return Ok(columns);
            }
            self.check(step)?;
            self.check_unbroken(step, permit)?;
            self.robot.pause(LOOK)?;
        }
        Err(CommissionError::Endless(step))
    }

    /// Returns the permit that the robot states.
    pub(super) fn permit(&mut self) -> Option<Permit> {
        self.robot.telemetry().map(|it| it.permit)
    }

    /// Checks that the robot has not halted since it stated this permit, but for the end of a trial or of the alignment. Without a
    /// permit any halt is right.
    pub(super) fn check_unbroken(&mut self, step: Step, permit: Option<Permit>) -> Done<(), S> {
        let shown = self.robot.telemetry().map(|it| (it.permit, it.halt));
        let is_end = permit.map(Permit::next) == shown.map(|it| it.0)
            && matches!(shown, Some((_, Halt::Aligned | Halt::Tried)));
        if permit.is_none() || permit == shown.map(|it| it.0) || is_end {
            Ok(())
        } else {
            Err(self.lapsed(step))
        }
    }

    /// Fetches the capture if it is complete.
    pub(super) fn captured(&mut self, rows: u16) -> Done<Option<Columns>, S> {
        let mut status = scope::ask(self.robot, ScopeCommand::Status)?;
        if status.state != ScopeState::Complete {
            return Ok(None);
        }
        status.rows = status.rows.min(rows);
        let mut capture = Capture::new(status);
        while scope::fetch(self.robot, &mut capture)? {}
        Ok(Some(Columns(capture)))
    }

    /// Waits until the robot is in this state. A fault ends that unless it is `expected`.
    pub(super) fn await_state(&mut self, step: Step, state: State, expected: bool) -> Done<(), S> {
        for _ in 0..LOOKS {
            if !expected {
                self.check(step)?;
            }
            if self.robot.telemetry().is_some_and(|it| it.state == state) {
                return Ok(());
            }
            self.robot.pause(LOOK)?;
        }
        Err(CommissionError::Endless(step))
    }

    /// Returns f, Hz.
    fn frequency(&mut self) -> f64 {
        self.robot.telemetry().map_or(0.0, |it| it.frequency.get().into())
    }

    fn hold(&mut self, frequency: f64) {
        self.robot.hold(along(frequency));
    }

    /// Returns the means of both motors while f is held, Hz, once it has come there by a ramp of so many Hz/s.
    pub(super) fn steady(&mut self, step: Step, frequency: f64, ramp: f64) -> Done<[Steady; 2], S> {
        let gap = (frequency - self.frequency()).abs();
        self.hold(frequency);
        self.robot.pause(SETTLING + Duration::from_secs_f64(gap / ramp))?;
        self.means_held(step, frequency)
    }

    /// The same over so many captures, of a robot whose ramp takes so long.
    pub(super) fn long_steady(
        &mut self,
        step: Step,
        frequency: f64,
        ramp: Duration,
        captures: usize,
    ) -> Done<[Steady; 2], S> {
        self.hold(frequency);
        self.robot.pause(ramp)?;
        self.check_held(step, frequency)?;
        self.robot.pause(SETTLING)?;
        let all: Vec<[Steady; 2]> =
            (0..captures).map(|_| self.means_held(step, frequency)).collect::<Result<_, _>>()?;
        Ok([0, 1].map(|motor| {
            let mean = |of: fn(&Steady) -> f64| {
                all.iter().map(|it| of(&it[motor])).sum::<f64>() / captures as f64
            };
            let voltage = [mean(|it| it.voltage[0]), mean(|it| it.voltage[1])];
            Steady {
                speed: mean(|it| it.speed),
                swing: mean(|it| it.swing),
                current: mean(|it| it.current),
                voltage,
            }
        }))
    }

    /// Returns the means of both motors while f is held until their end.
    fn means_held(&mut self, step: Step, frequency: f64) -> Done<[Steady; 2], S> {
        let means = self.means(step)?;
        self.check_held(step, frequency)?;
        Ok(means)
    }

    /// Returns the means of both motors, now.
    pub(super) fn means(&mut self, step: Step) -> Done<[Steady; 2], S> {
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
        self.begin_capture(&channels, Trigger::Now, 0)?;
        let columns = self.capture(step, u16::MAX)?;
        Ok([0, 1].map(|motor| {
            let mean = |column: usize| columns.mean(4 * motor + column);
            let swing = columns.deviation(4 * motor);
            Steady { speed: mean(0), swing, current: mean(1), voltage: [mean(2), mean(3)] }
        }))
    }

    /// Returns what both motors showed in ramps between two frequencies, Hz, at so many Hz/s, and while nothing changed before and
    /// after them. On a board that does not measure its bus, only ramps up count: d currents burn the energy of rotors that slow down.
    /// A motor takes at least the charge `per_hertz`, A s, for each hertz.
    pub(super) fn ramps(
        &mut self,
        [slow, fast]: [f64; 2],
        ramp: f64,
        per_hertz: f64,
        measures_bus: bool,
    ) -> Done<[Vec<Change>; 2], S> {
        let channels = [
            Channel::TopCurrentQ,
            Channel::TopSpeed,
            Channel::BottomCurrentQ,
            Channel::BottomSpeed,
        ];
        let fast = fast.min(slow + RAMP_SECONDS * ramp);
        let mut changes: [Vec<Change>; 2] = Default::default();
        let mut add = |steady, columns: &Columns| {
            for (motor, changes) in changes.iter_mut().enumerate() {
                let (current, speed) = (columns.of(2 * motor), columns.of(2 * motor + 1));
                changes.push(Change { steady, current, speed });
            }
        };
        // Friction, where nothing changes: before the ramps, and after them.
        for frequency in [fast, slow] {
            add(ALL_STEADY, &self.turns(&channels, frequency)?);
        }
        let impulse = per_hertz * (fast - slow);
        let counting = (LEAST_RAMPS * FULL_IMPULSE / impulse).clamp(LEAST_RAMPS, MOST_RAMPS / 2.0);
        // Half of them count where the bus is not measured, and what they show scatters more.
        let ramps = if measures_bus { counting } else { (6.0 * counting).min(MOST_RAMPS) } as usize;
        for count in 0..ramps {
            self.begin_capture_now(&channels)?;
            self.robot.pause(BEFORE_RAMP)?;
            let frequency = if count % 2 == 0 { fast } else { slow };
            self.hold(frequency);
            let columns = self.capture(Step::Ramps, u16::MAX)?;
            self.check_held(Step::Ramps, frequency)?;
            if measures_bus || count % 2 == 0 {
                add(STEADY_ROWS, &columns);
            }
        }
        for frequency in [fast, slow] {
            add(ALL_STEADY, &self.turns(&channels, frequency)?);
        }
        Ok(changes)
    }

    /// Returns what these channels show while f, Hz, is held.
    fn turns(&mut self, channels: &[Channel], frequency: f64) -> Done<Columns, S> {
        self.hold(frequency);
        self.robot.pause(SETTLING)?;
        self.begin_capture(channels, Trigger::Now, 0)?;
        let columns = self.capture(Step::Ramps, u16::MAX)?;
        self.check_held(Step::Ramps, frequency)?;
        Ok(columns)
    }
}

/// Returns the setpoint of f, Hz, along the body.
const fn along(frequency: f64) -> Setpoint {
    Setpoint::saturating(frequency as f32, 0.0)
}

/// Returns the current that each motor takes for an acceleration, A s^2/rad, from its changes of speed at so many Hz/s.
pub(super) fn slopes(changes: &[Vec<Change>; 2], ramp: f64) -> Result<[f64; 2], Finding> {
    let mut slopes = [0.0; 2];
    for (motor, changes) in changes.iter().enumerate() {
        slopes[motor] = running::current_per_acceleration(changes).unwrap_or(0.0);
        if let Some(change) = change_meanwhile(changes, slopes[motor] * TAU * ramp) {
            return Err(Finding::Uneven { motor, change });
        }
    }
    Ok(slopes)
}

/// Returns by how much the current that a rotor takes changed among its ramps, as a share of what speeds it up, A, where that is too
/// much. Two changes before the ramps and two after them show its friction, fast and slow, and so do the ends of the ramps.
fn change_meanwhile(changes: &[Change], speeds_up: f64) -> Option<f64> {
    let (before, others) = changes.split_at(2);
    let (ramps, after) = others.split_at(others.len() - 2);
    for (place, limit) in LARGEST_CHANGES.into_iter().enumerate() {
        let ends: Vec<f64> = ramps.iter().map(|ramp| mean(ramp.ends()[place])).collect();
        let [before, after] = [before, after].map(|them| mean(&them[place].current));
        let friction = [before, mean(&ends), after];
        let most = friction.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let change = most - friction.into_iter().fold(f64::INFINITY, f64::min);
        // Of what a rub that begins or ends among them does not move: the middle one of three parts.
        let mut scatter: Vec<f64> =
            ends.chunks(ends.len().div_ceil(THIRDS)).map(estimate).collect();
        scatter.sort_by(f64::total_cmp);
        let scatter = scatter[scatter.len() / 2];
        let by_chance = STANDARD_ERRORS * scatter / (ends.len() as f64).sqrt();
        if change > limit * speeds_up.abs() + by_chance {
            return Some(change / speeds_up.abs());
        }
    }
    let (least, most) = ramps
        .chunks(ramps.len().div_ceil(THIRDS))
        .map(|third| running::current_per_acceleration(&[before, third].concat()).unwrap_or(0.0))
        .fold((f64::INFINITY, 0.0_f64), |(least, most), it| (least.min(it), most.max(it)));
    let more = most / least - 1.0;
    let allowed = LARGEST_UNEVENNESS / (ramps.len() as f64).sqrt();
    (!(0.0..=allowed).contains(&more)).then_some(more)
}

/// Returns the standard deviation.
fn deviation(column: &[f64]) -> f64 {
    let about = mean(column);
    mean(&column.iter().map(|it| (it - about).powi(2)).collect::<Vec<_>>()).sqrt()
}

/// Returns the standard deviation of what this is a sample of.
fn estimate(sample: &[f64]) -> f64 {
    deviation(sample) * (sample.len() as f64 / (sample.len() as f64 - 1.0).max(1.0)).sqrt()
}

fn mean(column: &[f64]) -> f64 {
    column.iter().sum::<f64>() / column.len().max(1) as f64
}

/// The columns of a capture.
pub(super) struct Columns(Capture);

impl Columns {
    pub(super) fn of(&self, column: usize) -> Vec<f64> {
        self.0.column(column).map(|(_, value)| value).collect()
    }

    pub(super) fn mean(&self, column: usize) -> f64 {
        mean(&self.of(column))
    }

    /// Returns the standard deviation.
    fn deviation(&self, column: usize) -> f64 {
        deviation(&self.of(column))
    }
}
