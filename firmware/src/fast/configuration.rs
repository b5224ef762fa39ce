//! What the fast half has to know of motors, rotors and limits: in SI units for people and
//! settings ([`Parameters`]), and in fixed point for the tick ([`Configuration`]).

use core::f64::consts::TAU;

use crate::fast::alignment::Alignment;
use crate::fast::foc::current::Model;
use crate::fast::shaker::{LARGEST_ACCELERATION, ShakerModel};
use crate::fast::tracker::{EncoderModel, TABLE_LENGTH};
use crate::fast::units::{SPEED_PER_HERTZ, Speed, TURN_PER_DEGREE};
use crate::fast::units::{magnitude, scaled};
use crate::hardware::{Hardware, TICK_RATE_HZ, Turn};
use crate::settings::Settings;

/// What alignment found out about one motor, in the units of settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentParameters {
    /// Whether the rest was found by an alignment; if not, arming aligns first.
    pub known: bool,
    /// Electrical angle at rotor angle zero, degrees in [0, 360].
    pub electrical_offset_deg: f32,
    /// Whether the electrical angle falls when the rotor turns clockwise.
    pub reversed: bool,
    /// Whether the current amplifiers count down when current flows into the motor.
    pub current_inverted: bool,
    /// Error of the encoder, mechanical degrees: cosine and sine of the first, then of the second
    /// harmonic of the rotor angle.
    pub eccentricity_deg: [f32; 4],
}

impl From<Alignment> for AlignmentParameters {
    fn from(alignment: Alignment) -> Self {
        Self {
            known: true,
            electrical_offset_deg: alignment.electrical_offset as f32 / TURN_PER_DEGREE,
            reversed: alignment.reversed,
            current_inverted: alignment.current_inverted,
            eccentricity_deg: alignment.eccentricity.map(|part| part as f32 / TURN_PER_DEGREE),
        }
    }
}

/// One motor and its encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorParameters {
    /// Phase resistance, ohm.
    pub phase_resistance: f32,
    /// Phase inductance, henry.
    pub phase_inductance: f32,
    /// Peak flux linkage of one phase, weber.
    pub flux_linkage: f32,
    /// Clockwise angle of the eccentric mass from forward where the encoder reads zero, degrees.
    pub encoder_zero_deg: f32,
    /// Whether the encoder counts clockwise (seen from above) instead of counter-clockwise.
    pub encoder_inverted: bool,
    /// Found by alignment.
    pub alignment: AlignmentParameters,
}

/// Everything that the fast half has to know besides the board, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Top, bottom.
    pub motors: [MotorParameters; 2],
    /// Pole pairs of both motors.
    pub pole_pairs: u8,
    /// Inertia of one rotor about its axis, eccentric mass included, kg m^2.
    pub rotor_inertia: f32,
    /// True phase current over what [`CurrentSense`](crate::hardware::CurrentSense) reads.
    pub current_scale: f32,
    /// Phase current that is never exceeded, ampere.
    pub current_limit: f32,
    /// Phase current that trips [`flix_protocol::message::Fault::OverCurrent`], ampere.
    pub over_current: f32,
    /// Phase current while aligning, ampere.
    pub alignment_current: f32,
    /// Bandwidth of the current loops, hertz.
    pub current_bandwidth: f32,
    /// Natural frequency of the position loops (mean and difference), hertz.
    pub position_bandwidth: f32,
    /// Natural frequency of the encoder trackers, hertz.
    pub tracker_bandwidth: f32,
    /// Steepest change of f, hertz per second.
    pub frequency_ramp: f32,
    /// Fastest change of theta, degrees per second.
    pub direction_ramp: f32,
    /// Time by which a fresh encoder reading is always old, beyond its stated age, microseconds.
    pub encoder_latency_us: f32,
    /// From the current sample of a tick to the middle of the interval in which its duties act,
    /// microseconds.
    pub actuation_delay_us: f32,
    /// Bus voltage where the board cannot measure it, volt.
    pub bus_nominal: f32,
    /// Bus voltage below which the operator is warned, volt.
    pub bus_low: f32,
    /// Bus voltage that trips [`flix_protocol::message::Fault::UnderVoltage`], volt.
    pub under_voltage: f32,
    /// Bus voltage that trips [`flix_protocol::message::Fault::OverVoltage`], volt.
    pub over_voltage: f32,
    /// Rotor speed that trips [`flix_protocol::message::Fault::OverSpeed`], hertz.
    pub over_speed: f32,
}

impl Default for Parameters {
    /// Those of a new robot: the table of settings has the values and their reasons.
    fn default() -> Self {
        Settings::DEFAULT.parameters()
    }
}

/// [`Parameters`] and board as the tick wants them: integers, see each type for its units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    pub(crate) shaker: ShakerModel,
    pub(crate) motors: [Model; 2],
    pub(crate) encoders: [EncoderModel; 2],
    pub(crate) alignment: [Alignment; 2],
    pub(crate) aligned: bool,
    pub(crate) pole_pairs: u32,
    /// Pole pairs with the sign of the phase order.
    pub(crate) signed_pole_pairs: [i32; 2],
    /// +1 where a positive current turns the rotor clockwise, else -1.
    pub(crate) clockwise: [i32; 2],
    /// 2^-16 A per (2^-4 count), in 2^-21, with the sign of the current sense.
    pub(crate) current_per_count: [i32; 2],
    /// Counts at no current as designed, and how far they may be off, 2^-4.
    pub(crate) zero_design: i32,
    pub(crate) zero_tolerance: i32,
    pub(crate) sensed: bool,
    /// Counts of a phase from zero that are an over-current: the limit, or the end of the range of
    /// amplifier and converter where that is nearer, 2^-4.
    pub(crate) over_current_counts: i32,
    /// 2^-16 V.
    pub(crate) alignment_voltage: [i32; 2],
    /// 2^-16 A.
    pub(crate) alignment_current: i32,
    /// 2^-4 count.
    pub(crate) alignment_counts: i32,
    /// 2^-16 V per count in 2^-18; zero where the bus is not measured.
    pub(crate) bus_per_count: i32,
    /// 2^-16 V.
    pub(crate) bus_nominal: i32,
    pub(crate) bus_low: i32,
    pub(crate) under_voltage: i32,
    pub(crate) over_voltage: i32,
    /// 2^-16 V by which a motor may differ from its model.
    pub(crate) largest_residual: i32,
    /// Share of a PWM period, 2^-31.
    pub(crate) dead_share: i32,
    pub(crate) over_speed: Speed,
}

/// Damping of the encoder trackers.
const TRACKER_DAMPING: f64 = 0.9;
/// The integral part of the position loops, as a share of what would make them unstable.
const INTEGRAL_SHARE: f64 = 0.06;
/// References stay below the current limit by this factor, so that overshoot stays below it too.
const CURRENT_MARGIN: f64 = 0.85;
/// A motor's voltage may differ from its model by this share of the nominal bus: 10 % of flux and
/// resistance explain 0.1 of it.
const RESIDUAL_SHARE: f64 = 0.3;
/// The current zero may be off by this share of the range.
const ZERO_SHARE: f64 = 0.1;
/// Ticks per second.
const RATE: f64 = TICK_RATE_HZ as f64;

impl Configuration {
    /// Converts; a value outside what fixed point can hold becomes the nearest that it can, and
    /// NaN becomes zero. Never panics.
    #[must_use]
    pub fn new(parameters: &Parameters, hardware: &Hardware) -> Self {
        let amperes = |value: f32| scaled(f64::from(value), 16);
        let volts = amperes;
        let sense = hardware.current_sense;
        let microamperes = sense.map_or(0.0, |sense| f64::from(sense.microamperes_per_count));
        let amperes_per_count = microamperes * 1e-6 * f64::from(parameters.current_scale);
        let valid_counts = sense.map_or((i16::MIN, i16::MAX), |sense| sense.valid_counts);
        let range = f64::from(valid_counts.1) - f64::from(valid_counts.0);
        let zero = sense.map_or(0, |sense| i32::from(sense.zero_count));
        let reach = (i32::from(valid_counts.1) - zero).min(zero - i32::from(valid_counts.0));
        let over_current = match sense {
            Some(_) => scaled(f64::from(parameters.over_current) / amperes_per_count, 4),
            None => i32::MAX / 4,
        };
        let bus =
            hardware.bus_microvolts_per_count.map_or(0.0, |scale| f64::from(scale.get()) * 1e-6);
        let dead_time = f64::from(hardware.dead_time_ns) * 1e-9;
        let mut configuration = Self {
            shaker: shaker(parameters),
            motors: parameters.motors.map(|motor| Self::current_loop(parameters, &motor)),
            encoders: parameters.motors.map(|motor| encoder(parameters, &motor)),
            alignment: parameters.motors.map(|motor| motor.alignment.into()),
            aligned: parameters.motors.iter().all(|motor| motor.alignment.known),
            pole_pairs: u32::from(parameters.pole_pairs.max(1)),
            signed_pole_pairs: [0; 2],
            clockwise: [1; 2],
            current_per_count: [scaled(amperes_per_count * 4096.0, 21); 2],
            zero_design: zero * 16,
            zero_tolerance: scaled(ZERO_SHARE * range, 4),
            sensed: sense.is_some(),
            over_current_counts: over_current.min(reach * 16),
            alignment_voltage: parameters
                .motors
                .map(|motor| volts(motor.phase_resistance * parameters.alignment_current)),
            alignment_current: amperes(parameters.alignment_current),
            alignment_counts: if sense.is_some() {
                scaled(f64::from(parameters.alignment_current) / amperes_per_count, 4)
            } else {
                0
            },
            bus_per_count: scaled(bus * 65_536.0, 18),
            bus_nominal: volts(parameters.bus_nominal),
            bus_low: volts(parameters.bus_low),
            under_voltage: volts(parameters.under_voltage),
            over_voltage: volts(parameters.over_voltage),
            largest_residual: scaled(RESIDUAL_SHARE * f64::from(parameters.bus_nominal), 16),
            dead_share: scaled(dead_time * f64::from(hardware.pwm_frequency_hz), 31),
            over_speed: (parameters.over_speed * SPEED_PER_HERTZ) as i32,
        };
        configuration.apply(configuration.alignment);
        configuration
    }

    /// Takes over what an alignment found, but for the eccentricity tables.
    pub(crate) fn apply(&mut self, alignment: [Alignment; 2]) {
        self.alignment = alignment;
        for (index, found) in alignment.iter().enumerate() {
            let sign = |negative: bool| if negative { -1 } else { 1 };
            let scale = &mut self.current_per_count[index % 2];
            *scale = magnitude(*scale) * sign(found.current_inverted);
            self.clockwise[index % 2] = sign(found.reversed);
            self.signed_pole_pairs[index % 2] = self.pole_pairs as i32 * sign(found.reversed);
        }
    }

    /// The current loop of one of the motors.
    #[must_use]
    pub fn current_loop(parameters: &Parameters, motor: &MotorParameters) -> Model {
        let bandwidth = TAU * f64::from(parameters.current_bandwidth);
        let resistance = f64::from(motor.phase_resistance);
        let inductance = f64::from(motor.phase_inductance);
        // Electrical radians per second in one 2^-32 turn per tick, times 2^32.
        let speed = TAU * RATE;
        Model {
            proportional: scaled(inductance * bandwidth, 24),
            integral: scaled(resistance * bandwidth / RATE, 24),
            resistance: scaled(resistance, 24),
            reactance: scaled(speed * inductance, 22),
            back_emf: scaled(speed * f64::from(motor.flux_linkage), 16),
            lead: scaled(TAU * f64::from(parameters.actuation_delay_us) * 1e-6 * RATE, 28),
        }
    }

    /// Electrical angle at this rotor angle.
    #[inline(always)]
    pub(crate) const fn electrical_angle(&self, index: usize, angle: Turn) -> Turn {
        angle
            .wrapping_mul(self.signed_pole_pairs[index % 2] as u32)
            .wrapping_add(self.alignment[index % 2].electrical_offset)
    }
}

impl From<AlignmentParameters> for Alignment {
    fn from(parameters: AlignmentParameters) -> Self {
        let AlignmentParameters { electrical_offset_deg, reversed, current_inverted, .. } =
            parameters;
        Self {
            electrical_offset: (electrical_offset_deg * TURN_PER_DEGREE) as i64 as Turn,
            reversed,
            current_inverted,
            eccentricity: parameters.eccentricity_deg.map(|part| (part * TURN_PER_DEGREE) as i32),
        }
    }
}

/// N m per ampere of torque-making current.
fn torque_constant(parameters: &Parameters, motor: &MotorParameters) -> f64 {
    1.5 * f64::from(parameters.pole_pairs) * f64::from(motor.flux_linkage)
}

fn shaker(parameters: &Parameters) -> ShakerModel {
    let natural = TAU * f64::from(parameters.position_bandwidth) / RATE;
    let limit = f64::from(parameters.current_limit) * CURRENT_MARGIN;
    // 2^-16 A per 2^-40 turn per tick^2, and a half because each motor takes half of either.
    let gains = parameters.motors.map(|motor| {
        let torque_constant = torque_constant(parameters, &motor).max(1e-6);
        let per_turn = f64::from(parameters.rotor_inertia) * TAU * RATE * RATE / torque_constant;
        scaled(per_turn / 2.0, 8).max(1)
    });
    let largest = gains.map(|gain| scaled(limit / f64::from(gain), 48));
    ShakerModel {
        proportional: scaled(natural * natural, 40),
        derivative: scaled(2.0 * natural, 32),
        integral: scaled(INTEGRAL_SHARE * 2.0 * natural * natural * natural, 48),
        current_per_acceleration: gains,
        largest_acceleration: largest[0].min(largest[1]).min(LARGEST_ACCELERATION),
        current_limit: scaled(limit, 16),
        frequency_ramp: ((parameters.frequency_ramp * SPEED_PER_HERTZ / TICK_RATE_HZ as f32)
            as i32)
            .clamp(64, 60_000),
        sum_ramp: (2.0 * parameters.direction_ramp / 360.0 * SPEED_PER_HERTZ) as i32,
    }
}

fn encoder(parameters: &Parameters, motor: &MotorParameters) -> EncoderModel {
    let natural = TAU * f64::from(parameters.tracker_bandwidth) / RATE;
    let mut model = EncoderModel {
        sense: if motor.encoder_inverted { 1 } else { -1 },
        zero: (motor.encoder_zero_deg * TURN_PER_DEGREE) as i64 as Turn,
        latency_us: parameters.encoder_latency_us as i32,
        angle_gain: scaled(2.0 * TRACKER_DAMPING * natural, 32),
        speed_gain: scaled(natural * natural, 32),
        eccentricity: [0; TABLE_LENGTH],
    };
    let alignment = Alignment::from(motor.alignment);
    for entry in 0..TABLE_LENGTH {
        model.learn_entry(entry, &alignment.eccentricity);
    }
    model
}
