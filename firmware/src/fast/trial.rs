//! Trials of motors that nobody knows: see [`flix_protocol::message::Trial`].
//!
//! No value of the motor is used. The voltage starts next to nothing and grows by 1/128 of itself a tick, so that within the time
//! constant of any motor of this size (2 ms) it gains at most a sixth; the growth ends once the current of a
//! phase, as its amplifier shows it, reaches the reference. At [`LOOK_VOLTAGE`] the growth waits until a current must show: without one
//! nothing tells how much flows.

use flix_protocol::message::{
    Fault, LEAST_TRIAL_CURRENT_MA, MOST_TRIAL_CURRENT_MA, Pattern, TRIAL_BOUND_MA, Trial,
};

use crate::fast::aligner::{Progress, field};
use crate::fast::configuration::Configuration;
use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::{Direction, Rotor, clarke, park};
use crate::fast::standstill_and_zero::{LONGEST_REST_WAIT_TICKS, Stillness, ZERO_TICKS, ZeroMeter};
use crate::fast::tracker::Tracker;
use crate::hardware::Bridge;
use crate::units::{Counts, Current, ElectricalAngle, Voltage, multiply_high};

#[cfg(test)]
mod tests;

/// The voltage grows by this share of itself a tick, 2^-7.
const GROWTH_SHIFT: u32 = 7;
/// Once the current is there, the voltage follows it by this share of itself a tick, 2^-9.
const HOLD_SHIFT: u32 = 9;
/// Where a rotor that swings back adds its back-EMF, the voltage falls by this share of itself a tick, 2^-5, once the current is
/// beyond its reference by a quarter.
const FALL_SHIFT: u32 = 5;
/// The current is averaged over 2^3 ticks to end the growth.
const QUICK_SHIFT: u32 = 3;
/// And over 2^6 to look whether there is any.
const SLOW_SHIFT: u32 = 6;
/// Where the growth waits for a current to show: 0.15 V, which drive 1.5 A through 0.1 ohm, and 15 mA through 10 ohm.
const LOOK_VOLTAGE: Voltage = Voltage::from_raw(9_830);
/// Ticks after which it looks for one, 51 ms, and those after which it gives up, 0.41 s: as long as a rotor swings to the field its
/// back-EMF may take this little voltage, so that no current flows.
const LOOK_TICKS: u32 = 1 << 9;
const LONGEST_LOOK_TICKS: u32 = 8 * LOOK_TICKS;
/// The least current that shows: 5 mA, five times the noise of the average.
const SHOWS: Current = Current::from_raw(328);
/// Ticks in which the current is held before the pattern: 0.5 s, for the rotor to swing out.
const HOLD_TICKS: u32 = 5_000;
/// Voltage times current beyond which neither grows, 2^-16 V A: 1.33 V A are 2 W in three phases, little enough for a
/// motor of 10 g to bear for the seconds of a trial.
const MOST_POWER: i32 = 87_381;
/// The voltage of the pattern is a multiple of 2^-8 V: its half is one of what the scope shows.
const WHOLE_STEPS: i32 = !0xFF;
/// The voltage stays below the bridge's limit by this share of it, 2^-4: it never clips.
const MARGIN_SHIFT: u32 = 4;
/// Samples in a row beyond the bound that end the trial; one may be a spike.
const BEYOND_TICKS: u8 = 2;

/// What is measured of the motors in one tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observation<'a> {
    /// Top, bottom.
    pub(crate) trackers: &'a [Tracker; 2],
    /// What the amplifiers of phases A and B show, no zero subtracted.
    pub(crate) counts: [[Counts; 2]; 2],
    /// Currents of phases A and B.
    pub(crate) currents: &'a [[Current; 2]; 2],
    /// Battery side of the bridges.
    pub(crate) bus: &'a Bus,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Rest,
    Zero,
    Grow,
    Hold,
    Pattern,
}

#[derive(Debug, Clone, Copy, Default)]
struct Motor {
    voltage: Voltage,
    /// Averages of the currents of phases A and B: quick, and slow in 2^-[`SLOW_SHIFT`].
    quick: [i32; 2],
    slow: [i32; 2],
    /// Ticks for which the growth has waited.
    looked: u32,
    /// Whether a current has shown then.
    shows: bool,
    /// Whether the growth is over.
    is_grown: bool,
    beyond: u8,
}

/// A trial under way.
#[derive(Debug, Clone)]
pub(crate) struct TrialRun {
    trial: Trial,
    reference: Current,
    stage: Stage,
    tick: u32,
    stillness: Stillness,
    zero: ZeroMeter,
    motors: [Motor; 2],
    /// What the amplifiers show at no current, once it is known.
    pub(crate) zeros: Option<[[Counts; 2]; 2]>,
}

impl TrialRun {
    /// Starts from the beginning. A current beyond the trial's range becomes the nearest in it.
    pub(crate) fn new(trial: &Trial) -> Self {
        let reference = trial.current_ma.clamp(LEAST_TRIAL_CURRENT_MA, MOST_TRIAL_CURRENT_MA);
        Self {
            trial: *trial,
            reference: milliamperes(reference),
            stage: Stage::Rest,
            tick: 0,
            stillness: Stillness::default(),
            zero: ZeroMeter::default(),
            motors: [Motor::default(); 2],
            zeros: None,
        }
    }

    /// Returns whether the pattern is under way, and a turning field has its speed.
    pub(crate) fn is_pattern(&self) -> bool {
        self.stage == Stage::Pattern && self.tick >= self.trial.ticks_before()
    }

    /// Returns current and voltage of a motor in the frame of the field: along it, and across.
    pub(crate) fn of_motor(
        &self,
        index: usize,
        currents: [Current; 2],
    ) -> (Rotor<Current>, Rotor<Voltage>) {
        let [a, b] = currents;
        let current = park(clarke(a, b), Direction::from(self.field()));
        let voltage = self.voltage(&self.motors[index % 2]);
        (current, Rotor { d: voltage, q: Voltage::ZERO })
    }

    /// Does one tick. Never panics.
    pub(crate) fn update(
        &mut self,
        configuration: &Configuration,
        observation: &Observation<'_>,
    ) -> ([Bridge; 2], Progress) {
        let progress = match self.stage {
            Stage::Rest => self.rest(observation),
            Stage::Zero => self.average_zero(configuration, observation),
            Stage::Grow => self.grow(observation),
            Stage::Hold => self.hold(observation),
            Stage::Pattern => self.follow(observation),
        };
        self.tick = self.tick.wrapping_add(1);
        (self.bridges(observation.bus), progress)
    }

    fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        // `update` counts on to zero at once.
        self.tick = u32::MAX;
    }

    fn rest(&mut self, observation: &Observation<'_>) -> Progress {
        if self.stillness.look(observation.trackers) {
            self.enter(Stage::Zero);
        } else if self.tick >= LONGEST_REST_WAIT_TICKS {
            return Progress::Failed(Fault::Alignment);
        }
        Progress::Busy
    }

    fn average_zero(
        &mut self,
        configuration: &Configuration,
        observation: &Observation<'_>,
    ) -> Progress {
        self.zero.add(observation.counts);
        if self.tick + 1 >= ZERO_TICKS {
            self.zeros = self.zero.zeros(configuration);
            if self.zeros.is_none() {
                return Progress::Failed(Fault::CurrentSense);
            }
            self.enter(Stage::Grow);
        }
        Progress::Busy
    }

    fn grow(&mut self, observation: &Observation<'_>) -> Progress {
        // The currents of the first tick still have the old zero.
        if self.tick == 0 {
            return Progress::Busy;
        }
        let most = most_voltage(observation.bus);
        let mut all_are_grown = true;
        let driven = self.driven();
        for ((motor, currents), driven) in
            self.motors.iter_mut().zip(observation.currents).zip(driven)
        {
            motor.average(*currents);
            if motor.is_grown {
                motor.falls(self.reference);
                continue;
            }
            all_are_grown = false;
            if motor.is_full(self.reference) || motor.voltage >= most {
                motor.is_grown = true;
            } else if motor.voltage < LOOK_VOLTAGE || motor.shows {
                let step = (motor.voltage.raw() >> GROWTH_SHIFT) + 1;
                motor.voltage = motor.voltage + Voltage::from_raw(step);
            } else {
                motor.looked += 1;
                if motor.looked.is_multiple_of(LOOK_TICKS) {
                    motor.shows = !driven || motor.carries();
                    if !motor.shows && motor.looked >= LONGEST_LOOK_TICKS {
                        return Progress::Failed(Fault::CurrentSense);
                    }
                }
            }
        }
        if all_are_grown {
            self.enter(Stage::Hold);
        }
        self.watch(observation)
    }

    /// Holds the current: the voltage follows slowly.
    fn hold(&mut self, observation: &Observation<'_>) -> Progress {
        let most = most_voltage(observation.bus);
        for (motor, currents) in self.motors.iter_mut().zip(observation.currents) {
            motor.average(*currents);
            if motor.falls(self.reference) {
                continue;
            }
            let step = Voltage::from_raw((motor.voltage.raw() >> HOLD_SHIFT) + 1);
            motor.voltage = if motor.is_full(self.reference) {
                motor.voltage - step
            } else {
                motor.voltage + step
            };
            motor.voltage = motor.voltage.within(most);
        }
        if self.tick >= HOLD_TICKS {
            for motor in &mut self.motors {
                motor.voltage = Voltage::from_raw(motor.voltage.raw() & WHOLE_STEPS);
            }
            self.enter(Stage::Pattern);
        }
        self.watch(observation)
    }

    fn follow(&mut self, observation: &Observation<'_>) -> Progress {
        if self.tick >= self.trial.ticks_before() + u32::from(self.trial.ticks) {
            return Progress::Done;
        }
        self.watch(observation)
    }

    /// Ends the trial when a phase carries too much.
    fn watch(&mut self, observation: &Observation<'_>) -> Progress {
        let bound = milliamperes(TRIAL_BOUND_MA);
        for (motor, currents) in self.motors.iter_mut().zip(observation.currents) {
            let is_beyond = largest(*currents) > bound;
            motor.beyond = if is_beyond { motor.beyond + 1 } else { 0 };
            if motor.beyond >= BEYOND_TICKS {
                return Progress::Failed(Fault::OverCurrent);
            }
        }
        Progress::Busy
    }

    fn driven(&self) -> [bool; 2] {
        self.trial.motors
    }

    /// Returns the electrical angle of the field.
    fn field(&self) -> ElectricalAngle {
        let tick = if self.stage == Stage::Pattern { self.tick } else { 0 };
        ElectricalAngle::from_raw(self.trial.field(tick))
    }

    /// Returns the voltage along the field.
    fn voltage(&self, motor: &Motor) -> Voltage {
        match self.trial.pattern {
            Pattern::Halve(ticks) if self.stage == Stage::Pattern => {
                let is_half = (self.tick / u32::from(ticks.max(1))).is_multiple_of(2);
                Voltage::from_raw(motor.voltage.raw() >> u32::from(is_half))
            }
            _ => motor.voltage,
        }
    }

    fn bridges(&self, bus: &Bus) -> [Bridge; 2] {
        match self.stage {
            Stage::Rest => return [Bridge::BRAKE; 2],
            Stage::Zero => return [Bridge::Off; 2],
            Stage::Grow | Stage::Hold | Stage::Pattern => {}
        }
        let direction = Direction::from(self.field());
        let mut bridges = [Bridge::BRAKE; 2];
        for ((bridge, motor), driven) in bridges.iter_mut().zip(&self.motors).zip(self.driven()) {
            if driven {
                *bridge = Bridge::Duty(bus.duties(field(direction, 1 << 30, self.voltage(motor))));
            }
        }
        bridges
    }
}

impl Motor {
    /// Returns whether its current has reached the reference, or it turns as much power to heat as it may.
    fn is_full(&self, reference: Current) -> bool {
        let current = self.current();
        // 2^-16 V times 2^-16 A, of which the upper half is in V A.
        let power = multiply_high(self.voltage.raw() << 8, current.raw() << 8);
        current >= reference || power >= MOST_POWER
    }

    /// Lets the voltage fall where the current is beyond its reference by a quarter; returns whether it did.
    fn falls(&mut self, reference: Current) -> bool {
        let is_beyond = self.current() > Current::from_raw(reference.raw() / 4 * 5);
        if is_beyond {
            self.voltage =
                Voltage::from_raw(self.voltage.raw() - (self.voltage.raw() >> FALL_SHIFT));
        }
        is_beyond
    }

    /// Returns the largest current of a phase.
    fn current(&self) -> Current {
        largest(self.quick.map(Current::from_raw))
    }

    /// Returns whether a current shows.
    fn carries(&self) -> bool {
        largest(self.slow.map(|slow| Current::from_raw(slow >> SLOW_SHIFT))) >= SHOWS
    }

    fn average(&mut self, currents: [Current; 2]) {
        for ((quick, slow), current) in self.quick.iter_mut().zip(&mut self.slow).zip(currents) {
            *quick += (current.raw() - *quick) >> QUICK_SHIFT;
            *slow += current.raw() - (*slow >> SLOW_SHIFT);
        }
    }
}

/// Returns so many milliamperes.
const fn milliamperes(current: u16) -> Current {
    Current::from_raw(((current as i32) << 16) / 1_000)
}

/// Returns the most voltage of a trial.
fn most_voltage(bus: &Bus) -> Voltage {
    Voltage::from_raw(bus.limit.raw() - (bus.limit.raw() >> MARGIN_SHIFT))
}

/// Returns the largest of the currents of phases A, B and C, without its sign.
fn largest([a, b]: [Current; 2]) -> Current {
    a.magnitude().max(b.magnitude()).max((a + b).magnitude())
}
