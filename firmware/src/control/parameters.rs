//! What the fast half has to know of motors, rotors and limits: in SI units for people and
//! settings ([`Parameters`]), and in fixed point for the tick ([`Configuration`]).

use crate::control::{Alignment, TURN_PER_DEGREE};
use crate::hardware::Hardware;

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

impl AlignmentParameters {
    /// Not aligned yet.
    pub const UNKNOWN: Self = Self {
        known: false,
        electrical_offset_deg: 0.0,
        reversed: false,
        current_inverted: false,
        eccentricity_deg: [0.0; 4],
    };
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

impl Default for MotorParameters {
    /// The assumed gimbal motor: the paper names none.
    fn default() -> Self {
        Self {
            phase_resistance: 2.5,
            phase_inductance: 1.0e-3,
            flux_linkage: 3.0e-3,
            encoder_zero_deg: 0.0,
            encoder_inverted: false,
            alignment: AlignmentParameters::UNKNOWN,
        }
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            motors: [MotorParameters::default(); 2],
            pole_pairs: 7,
            rotor_inertia: 1.05e-5,
            current_limit: 2.0,
            over_current: 2.6,
            alignment_current: 0.8,
            current_bandwidth: 700.0,
            position_bandwidth: 25.0,
            tracker_bandwidth: 120.0,
            frequency_ramp: 200.0,
            direction_ramp: 900.0,
            encoder_latency_us: 0.0,
            actuation_delay_us: 50.0,
            bus_nominal: 11.1,
            bus_low: 9.9,
            under_voltage: 9.0,
            over_voltage: 14.0,
            over_speed: 45.0,
        }
    }
}

/// [`Parameters`] and board as the tick wants them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {}

impl Configuration {
    /// Converts; a value outside what fixed point can hold becomes the nearest that it can.
    #[must_use]
    pub fn new(_parameters: &Parameters, _hardware: &Hardware) -> Self {
        Self {}
    }
}
