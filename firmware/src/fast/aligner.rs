//! Finding the electrical angle: phase order, electrical offset, sign and zero of the current
//! sense, and the encoders' eccentricity, for both motors at once.
//!
//! With the bridges off the current amplifiers' zero is averaged. Then a voltage vector, as much as
//! drives the alignment current through a resting motor, or as the supply gives where that is less
//! ([`SUPPLY_SHARE`]), pulls each rotor along for a whole turn forward and back. The rotor follows the field like a compass needle, so the field *is* the
//! angle reference:
//!
//! - the direction in which the encoder follows is the phase order;
//! - the mean of angle minus field over both ways is the electrical offset (friction and speed act
//!   the other way on the way back and cancel, and so does cogging over a whole turn);
//! - its first and second harmonic over the turn are what the encoder's magnet adds;
//! - a rotor that lags by a quarter electrical turn does not follow: missing magnet, open phase;
//! - currents that do not follow the voltage are a broken current sense.
//!
//! Where all that is known from before, the field pulls only a quarter electrical turn, as a check
//! that encoder, phases and current sense still agree with the stored alignment.

use flix_protocol::message::Fault;

use crate::alignment::Alignment;
use crate::fast::configuration::Configuration;
use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::{Direction, Stator, clarke, inverse_clarke, park};
use crate::fast::standstill_and_zero::{LONGEST_REST_WAIT_TICKS, Stillness, ZERO_TICKS, ZeroMeter};
use crate::fast::tracker::{Tracker, harmonic_factors};
use crate::hardware::Bridge;
use crate::units::{
    Counts, ElectricalAngle, Quantity, RotorAngle, Voltage, magnitude, multiply_high,
};

#[cfg(test)]
mod tests;

/// Ticks for the voltage to build up, for the field to turn to where it begins, and to let the
/// rotor swing out: 0.15 s each.
const RAMP_TICKS: u32 = 1_500;
/// The field's speed: 2^-13 turn per tick, 1.22 Hz.
const SWEEP_RATE: u32 = 1 << 19;
/// Ticks in which the field gathers this speed.
const GATHER_TICKS: u32 = 1 << 10;
/// Ticks at full speed before and after the part that counts.
const LEAD_TICKS: u32 = 1 << 9;
/// Ticks of a whole turn at full speed, those that count.
const TURN_TICKS: u32 = 1 << 13;
/// The part that counts begins here,
const WINDOW_BEGIN: u32 = GATHER_TICKS + LEAD_TICKS;
/// ends here,
const WINDOW_END: u32 = WINDOW_BEGIN + TURN_TICKS;
/// and one way is over here.
const WAY_TICKS: u32 = WINDOW_END + LEAD_TICKS + GATHER_TICKS;
/// Ticks of the check's quarter electrical turn, and again to swing out: 0.1 s each.
const CHECK_TICKS: u32 = 1_000;
/// A quarter electrical turn: a rotor that lags this far has lost the field.
const QUARTER: i64 = 1 << 30;
/// A rotor in the check may be off by this much: an eighth electrical turn.
const CHECK_TOLERANCE: i32 = 1 << 29;

/// A field takes at most this share of [`Bus::limit`], 2^-31: 0.9 of 1/sqrt(3) of the bus, which the bridge gives in every
/// direction.
const SUPPLY_SHARE: i32 = 1_859_775_393;
/// All of the alignment current, 2^-30.
const WHOLE: i32 = 1 << 30;

/// Currents are summed with so many more bits than they have.
const CURRENT_SHIFT: u32 = 8;

/// What is measured of the motors in one tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observation<'a> {
    /// Top, bottom.
    pub(crate) trackers: &'a [Tracker; 2],
    /// What the amplifiers of phases A and B show, no zero subtracted.
    pub(crate) counts: Option<[[Counts; 2]; 2]>,
    /// Battery side of the bridges.
    pub(crate) bus: &'a Bus,
}

/// How far alignment is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Not done yet.
    Busy,
    /// Done; both results are valid.
    Done,
    /// Given up.
    Failed(Fault),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Rest,
    Zero,
    Ramp,
    Forward,
    Back,
    Check,
}

/// Fourier sums over the part of the sweep that counts.
#[derive(Debug, Clone, Copy, Default)]
struct Sweep {
    /// Angle minus field where the part that counts began.
    origin: i32,
    /// Sum of the lag behind it.
    lag: i64,
    /// Sums of lag times cosine and sine of one and two angles.
    harmonics: [i64; 4],
    /// Sums of current times the cosine of the field seen from phase A, B, C.
    currents: [i64; 3],
}

#[derive(Debug, Clone, Copy, Default)]
struct Motor {
    /// What the supply gives of the alignment current, 2^-30.
    share: i32,
    /// Electrical angle of the field at field position zero.
    base: ElectricalAngle,
    /// Uncorrected rotor angle when the field began to move.
    start: RotorAngle,
    sweep: Sweep,
    result: Alignment,
}

/// Aligns both motors.
#[derive(Debug, Clone)]
pub(crate) struct Aligner {
    /// Whether everything is looked for, so that [`Aligner::results`] is news.
    pub(crate) full: bool,
    stage: Stage,
    tick: u32,
    stillness: Stillness,
    zero: ZeroMeter,
    /// Mechanical position of the field, 2^-32 turn in its own direction.
    field: u32,
    /// By how much it moved in this tick.
    rate: i32,
    motors: [Motor; 2],
    /// What the amplifiers of phases A and B show at no current.
    pub(crate) zeros: [[Counts; 2]; 2],
}

impl Aligner {
    /// Starts from the beginning; `full` looks for everything, else what is remembered is checked.
    pub(crate) fn new(full: bool, configuration: &Configuration) -> Self {
        let motors = configuration.alignment.map(|result| Motor { result, ..Motor::default() });
        let zeros = [[Counts::ZERO; 2]; 2];
        Self {
            full,
            stage: Stage::Rest,
            tick: 0,
            stillness: Stillness::default(),
            zero: ZeroMeter::default(),
            field: 0,
            rate: 0,
            motors,
            zeros,
        }
    }

    /// Returns what was found.
    pub(crate) fn results(&self) -> [Alignment; 2] {
        self.motors.map(|motor| motor.result)
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
            Stage::Ramp => self.ramp(configuration, observation),
            Stage::Forward => self.sweep(configuration, observation, true),
            Stage::Back => self.sweep(configuration, observation, false),
            Stage::Check => self.check(configuration, observation),
        };
        self.tick = self.tick.wrapping_add(1);
        (self.bridges(configuration, observation.bus), progress)
    }

    fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        // `update` counts on to zero at once.
        self.tick = u32::MAX;
    }

    /// Waits until both rotors stand.
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
        let Some(counts) = observation.counts else {
            self.enter(Stage::Ramp);
            return Progress::Busy;
        };
        self.zero.add(counts);
        if self.tick + 1 >= ZERO_TICKS {
            let Some(zeros) = self.zero.zeros(configuration) else {
                return Progress::Failed(Fault::CurrentSense);
            };
            self.zeros = zeros;
            self.enter(Stage::Ramp);
        }
        Progress::Busy
    }

    /// Raises the voltage and draws the rotor to the field; in the check it should be there already.
    fn ramp(&mut self, configuration: &Configuration, observation: &Observation<'_>) -> Progress {
        if self.tick == 0 {
            let given = multiply_high(observation.bus.limit.raw() << 1, SUPPLY_SHARE);
            for (index, motor) in self.motors.iter_mut().enumerate() {
                let needed = configuration.alignment_voltage[index % 2].raw();
                motor.share = if needed > given {
                    ((i64::from(given) << 30) / i64::from(needed.max(1))) as i32
                } else {
                    WHOLE
                };
                let angle = observation.trackers[index % 2].angle();
                motor.start = angle;
                motor.base = if self.full {
                    ElectricalAngle::ZERO
                } else {
                    configuration.electrical_angle(index, angle)
                };
            }
        }
        if self.full {
            // A rotor opposite to the field feels no torque and may stay there: from a quarter
            // turn before, the field draws those too.
            let moved = self.tick.saturating_sub(RAMP_TICKS).min(RAMP_TICKS);
            let short = (RAMP_TICKS - moved) * (QUARTER as u32 / RAMP_TICKS);
            for motor in &mut self.motors {
                motor.base = ElectricalAngle::from_raw(short.wrapping_neg());
            }
        }
        let swung_out = if self.full { 3 * RAMP_TICKS } else { RAMP_TICKS };
        if self.tick >= swung_out {
            if !self.full && !self.follows(configuration, observation) {
                return Progress::Failed(Fault::Alignment);
            }
            self.enter(if self.full { Stage::Forward } else { Stage::Check });
        }
        Progress::Busy
    }

    /// Does one tick of one way of the sweep.
    fn sweep(
        &mut self,
        configuration: &Configuration,
        observation: &Observation<'_>,
        forward: bool,
    ) -> Progress {
        if forward && self.tick == 0 {
            for (motor, tracker) in self.motors.iter_mut().zip(observation.trackers) {
                motor.start = tracker.angle();
            }
        }
        if forward && self.tick == WINDOW_BEGIN && !self.find_order(observation) {
            return Progress::Failed(Fault::Alignment);
        }
        let counts = self.tick >= WINDOW_BEGIN && self.tick < WINDOW_END;
        if counts && !self.accumulate(configuration, observation) {
            return Progress::Failed(Fault::Alignment);
        }
        let to_end = WAY_TICKS.saturating_sub(self.tick);
        let rate = SWEEP_RATE.min(self.tick.min(to_end).saturating_mul(SWEEP_RATE / GATHER_TICKS));
        self.rate = if forward { rate as i32 } else { -(rate as i32) };
        self.field = self.field.wrapping_add(self.rate as u32);
        if self.tick >= WAY_TICKS {
            if forward {
                self.enter(Stage::Back);
            } else {
                return self.conclude(configuration, observation.counts.is_some());
            }
        }
        Progress::Busy
    }

    /// Finds which way each rotor went in the lead; returns false when one did not go as far as the field.
    fn find_order(&mut self, observation: &Observation<'_>) -> bool {
        let field = self.field as i32;
        self.motors.iter_mut().zip(observation.trackers).all(|(motor, tracker)| {
            let travel = tracker.angle().ahead_of(motor.start);
            motor.result.reversed = travel.is_negative();
            motor.sweep.origin = tracker.angle().ahead_of(motor.along(self.field));
            let shortfall = magnitude(magnitude(travel).saturating_sub(field));
            shortfall < field / 2
        })
    }

    /// Adds a tick to the sums; false when a rotor lost the field.
    fn accumulate(&mut self, configuration: &Configuration, observation: &Observation<'_>) -> bool {
        let field = self.field;
        let electrical = ElectricalAngle::from_raw(field.wrapping_mul(configuration.pole_pairs));
        let mut follows = true;
        for (index, motor) in self.motors.iter_mut().enumerate() {
            let angle = observation.trackers[index % 2].angle();
            let lag = angle.ahead_of(motor.along(field)).wrapping_sub(motor.sweep.origin);
            let electrical_lag = i64::from(lag) * i64::from(configuration.pole_pairs);
            follows &= electrical_lag.abs() < QUARTER;
            motor.sweep.add_lag(angle, lag);
            if let Some(counts) = observation.counts {
                motor.sweep.add_currents(electrical, counts[index % 2], self.zeros[index % 2]);
            }
        }
        follows
    }

    /// Works out the results.
    fn conclude(&mut self, configuration: &Configuration, sensed: bool) -> Progress {
        for motor in &mut self.motors {
            let Sweep { origin, lag, harmonics, currents } = motor.sweep;
            let samples = i64::from(2 * TURN_TICKS);
            let mean = origin.wrapping_add((lag / samples) as i32);
            let offset = (mean as u32).wrapping_mul(configuration.pole_pairs);
            motor.result.electrical_offset = ElectricalAngle::from_raw(if motor.result.reversed {
                offset
            } else {
                offset.wrapping_neg()
            });
            // Sums hold half the products; a Fourier coefficient is twice the mean.
            motor.result.eccentricity = harmonics.map(|sum| (4 * sum / samples) as i32);
            if sensed {
                let expected = motor.of_whole(configuration.alignment_counts.raw());
                let amplitudes = currents.map(|sum| (4 * sum / samples) as i32 >> CURRENT_SHIFT);
                let inverted = amplitudes.iter().all(|amplitude| amplitude.is_negative());
                let agree = amplitudes.iter().all(|amplitude| {
                    let along = if inverted { -amplitude } else { *amplitude };
                    along > expected / 2 && along < expected.saturating_mul(2)
                });
                if !agree {
                    return Progress::Failed(Fault::CurrentSense);
                }
                motor.result.current_inverted = inverted;
            }
        }
        Progress::Done
    }

    /// Pulls the rotors a quarter electrical turn and looks whether they and the currents follow.
    fn check(&mut self, configuration: &Configuration, observation: &Observation<'_>) -> Progress {
        if self.tick <= CHECK_TICKS {
            let quarter = (QUARTER as u32) / configuration.pole_pairs.max(1);
            self.field = self.field.wrapping_add(quarter / CHECK_TICKS);
            return Progress::Busy;
        }
        if self.tick < 2 * CHECK_TICKS {
            return Progress::Busy;
        }
        if !self.follows(configuration, observation) {
            return Progress::Failed(Fault::Alignment);
        }
        let Some(counts) = observation.counts else { return Progress::Done };
        for ((motor, counts), zeros) in self.motors.iter().zip(counts).zip(self.zeros) {
            let [a, b] = centred(counts, zeros);
            let field = Direction::from(motor.electrical(configuration, self.field));
            let current = park(clarke(a, b), field);
            let along = if motor.result.current_inverted { -current.d } else { current.d }.raw();
            let expected = motor.of_whole(configuration.alignment_counts.raw());
            if along < expected / 2 || along > expected.saturating_mul(2) {
                return Progress::Failed(Fault::CurrentSense);
            }
        }
        Progress::Done
    }

    /// Returns whether both rotors stand where the field is, by what is remembered.
    fn follows(&self, configuration: &Configuration, observation: &Observation<'_>) -> bool {
        self.motors.iter().enumerate().all(|(index, motor)| {
            let angle = observation.trackers[index % 2].angle();
            let field = motor.electrical(configuration, self.field);
            let rotor = configuration.electrical_angle(index, angle);
            magnitude(field.ahead_of(rotor)) <= CHECK_TOLERANCE
        })
    }

    /// Returns the field as duties.
    fn bridges(&self, configuration: &Configuration, bus: &Bus) -> [Bridge; 2] {
        let share = match self.stage {
            Stage::Rest => return [Bridge::BRAKE; 2],
            Stage::Zero => return [Bridge::Off; 2],
            Stage::Ramp => (self.tick.min(RAMP_TICKS) * (WHOLE as u32 / RAMP_TICKS)) as i32,
            Stage::Forward | Stage::Back | Stage::Check => WHOLE,
        };
        let mut bridges = [Bridge::Off; 2];
        for (((bridge, motor), voltage), model) in bridges
            .iter_mut()
            .zip(&self.motors)
            .zip(configuration.alignment_voltage)
            .zip(&configuration.motors)
        {
            let direction = Direction::from(motor.electrical(configuration, self.field));
            let share = motor.of_whole(share);
            let current = field(direction, share, configuration.alignment_current);
            // Beside what the windings take, what the magnets give as they turn with the field.
            let speed = self.rate.wrapping_mul(configuration.pole_pairs as i32);
            let back_emf = Voltage::from_raw(multiply_high(speed, model.back_emf));
            let across = direction.quarter_turn_ahead();
            let mut phases = field(direction, share, voltage);
            for (phase, back_emf) in phases.iter_mut().zip(field(across, WHOLE, back_emf)) {
                *phase = *phase + back_emf;
            }
            for (phase, current) in phases.iter_mut().zip(current) {
                *phase = *phase + bus.dead_time_compensation(model.dead_time, current);
            }
            *bridge = Bridge::Duty(bus.duties(phases));
        }
        bridges
    }
}

impl Motor {
    /// Returns what is left of this where it goes with the alignment current.
    fn of_whole(&self, value: i32) -> i32 {
        ((i64::from(value) * i64::from(self.share)) >> 30) as i32
    }

    /// Returns the electrical angle of the field at this mechanical position.
    fn electrical(&self, configuration: &Configuration, field: u32) -> ElectricalAngle {
        self.base.turned(field.wrapping_mul(configuration.pole_pairs) as i32)
    }

    /// Returns the field's mechanical position counted the way the rotor goes.
    fn along(&self, field: u32) -> RotorAngle {
        RotorAngle::from_raw(if self.result.reversed { field.wrapping_neg() } else { field })
    }
}

impl Sweep {
    fn add_lag(&mut self, angle: RotorAngle, lag: i32) {
        self.lag += i64::from(lag);
        for (sum, factor) in self.harmonics.iter_mut().zip(harmonic_factors(angle)) {
            *sum += i64::from(multiply_high(lag, factor));
        }
    }

    fn add_currents(
        &mut self,
        electrical: ElectricalAngle,
        counts: [Counts; 2],
        zeros: [Counts; 2],
    ) {
        /// A third of a turn.
        const THIRD: i32 = 1_431_655_765;
        let [a, b] = centred(counts, zeros);
        let phases = [a, b, -a - b];
        let lags = [0, THIRD, THIRD.wrapping_mul(2)];
        for ((sum, phase), lag) in self.currents.iter_mut().zip(phases).zip(lags) {
            let cosine = Direction::from(electrical.turned(lag.wrapping_neg())).cosine;
            *sum += i64::from(multiply_high(phase.raw() << CURRENT_SHIFT, cosine));
        }
    }
}

/// Returns the phases of a field in this direction, of so much current or voltage; `share` is in
/// 2^-30.
pub(crate) fn field<T: Quantity>(direction: Direction, share: i32, size: T) -> [T; 3] {
    // 2^-31 times 2^-30 leaves an eighth of it after two upper halves.
    let along = |component: i32| {
        T::from_raw(multiply_high(multiply_high(component, share), size.raw() << 3))
    };
    inverse_clarke(Stator { alpha: along(direction.cosine), beta: along(direction.sine) })
}

/// Returns counts about their zero.
fn centred(counts: [Counts; 2], zeros: [Counts; 2]) -> [Counts; 2] {
    [counts[0] - zeros[0], counts[1] - zeros[1]]
}
