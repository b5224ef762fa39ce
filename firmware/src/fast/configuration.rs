//! What the fast half has to know of motors, rotors, limits and board, in fixed point, from the
//! settings and the board's description.

use core::f64::consts::TAU;

use crate::alignment::Alignment;
use crate::fast::foc::burning;
use crate::fast::foc::current::{DELAY_BITS, Model, PROPORTIONAL_BITS, REACTANCE_BITS};
use crate::fast::foc::modulation::dead_time_slope;
use crate::fast::reference::{Ramps, STRIDE};
use crate::fast::shaker::{INTEGRAL_BITS, LAG_BITS, LARGEST_ACCELERATION, ShakerModel};
use crate::fast::tracker::{ANGLE_GAIN_BITS, EncoderModel, TABLE_LENGTH};
use crate::hardware::Hardware;
use crate::settings::Settings;
use crate::units::{
    Counts, Current, ElectricalAngle, ElectricalSpeed, Quantity, RotorAngle, Speed, TICK_RATE_HZ,
    TICK_US, Voltage, magnitude, scaled,
};

/// What builds up slowly is looked at in one tick of so many.
pub(crate) const DIAGNOSTIC_TICKS: u32 = 16;

/// Settings and board as the tick wants them: see each type for its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    pub(crate) shaker: ShakerModel,
    pub(crate) motors: [Model; 2],
    /// What [`burning::direct_current`] needs; zero where the bus is measured: there, over-voltage is a fault.
    pub(crate) burning_per_speed: [i32; 2],
    pub(crate) encoders: [EncoderModel; 2],
    pub(crate) alignment: [Alignment; 2],
    pub(crate) aligned: bool,
    pub(crate) pole_pairs: u32,
    /// Pole pairs with the sign of the phase order.
    pub(crate) signed_pole_pairs: [i32; 2],
    /// +1 where a positive current turns the rotor clockwise, else -1.
    pub(crate) clockwise: [i32; 2],
    /// 2^-16 A per [`Counts`] of phases A and B, in 2^-21, with the sign of the current sense.
    pub(crate) current_per_count: [[i32; 2]; 2],
    /// What the amplifiers show at no current as designed, and how far they may be off.
    pub(crate) zero_design: Counts,
    pub(crate) zero_tolerance: Counts,
    pub(crate) sensed: bool,
    /// Current of a phase beyond which it is an over-current, and the counts at which amplifier and converter end.
    over_current: Current,
    valid_counts: [Counts; 2],
    pub(crate) alignment_voltage: [Voltage; 2],
    pub(crate) alignment_current: Current,
    /// What the amplifiers show of the alignment current.
    pub(crate) alignment_counts: Counts,
    /// 2^-16 V per count in 2^-18; zero where the bus is not measured.
    pub(crate) bus_per_count: i32,
    pub(crate) bus_nominal: Voltage,
    pub(crate) battery_low: Voltage,
    pub(crate) under_voltage: Voltage,
    pub(crate) over_voltage: Voltage,
    /// By how much a motor may differ from its model.
    pub(crate) largest_residual: Voltage,
    /// Share of a PWM period, 2^-31.
    pub(crate) dead_share: i32,
    pub(crate) over_speed: Speed,
    /// By how much a current changes the speed of its rotor from one diagnosis to the next: 2^-32 turn per tick for 2^-16 A,
    /// in 2^-16.
    pub(crate) speed_per_current: [i32; 2],
}

/// Damping of the encoder trackers.
const TRACKER_DAMPING: f64 = 0.9;
/// The integral part of the position loops, as a share of what would make them unstable.
const INTEGRAL_SHARE: f64 = 0.06;
/// References stay below the current limit by this factor, so that overshoot stays below it too.
const CURRENT_MARGIN: f64 = 0.85;
/// Longest time from an update of the position loops to its torque that is counted, ticks.
const LARGEST_LAG: f64 = 15.0;
/// A motor's voltage may differ from its model by this share of the nominal bus: 10 % of flux and
/// resistance explain 0.1 of it.
const RESIDUAL_SHARE: f64 = 0.3;
/// The current zero may be off by this share of the range.
const ZERO_SHARE: f64 = 0.1;
/// Settings state inductances in mH and flux linkages in mWb.
const MILLI: f32 = 1e-3;
/// Settings state inertias in g cm^2.
const KG_M2_PER_G_CM2: f32 = 1e-7;
/// A resistance below this is taken for this, ohm, where one is divided by it.
const LEAST_RESISTANCE: f64 = 0.02;
/// Ticks per second.
const RATE: f64 = TICK_RATE_HZ as f64;

impl Configuration {
    /// Converts the settings; a value outside what fixed point can hold becomes the nearest that it can, and
    /// NaN becomes zero. Never panics.
    #[must_use]
    pub fn new(settings: &Settings, hardware: &Hardware) -> Self {
        let volts = |value: f32| Voltage::from_volts(value.into());
        let sense = hardware.current_sense;
        let microamperes = sense.map_or(0.0, |sense| f64::from(sense.microamperes_per_count));
        let amperes_per_count = microamperes * 1e-6 * f64::from(settings.current_scale);
        let counts = |current: f32| scaled(f64::from(current) / amperes_per_count, 4);
        let (lowest, highest) = sense.map_or((i16::MIN, i16::MAX), |sense| sense.valid_counts);
        let range = f64::from(highest) - f64::from(lowest);
        let zero = sense.map_or(0, |sense| i32::from(sense.zero_count));
        let gains = [0, 1].map(|motor| {
            [settings.current_gain_a, settings.current_gain_b].map(|gain| f64::from(gain[motor]))
        });
        let divider = hardware.bus_microvolts_per_count;
        let bus = divider.map_or(0.0, |scale| f64::from(scale.get()) * 1e-6)
            * f64::from(settings.battery_scale);
        let mut configuration = Self {
            shaker: ShakerModel { lag: lag(&settings.on(hardware)), ..position_loop(settings) },
            motors: [0, 1].map(|motor| Self::current_loop(settings, hardware, motor)),
            burning_per_speed: [0, 1].map(|motor| match divider {
                Some(_) => 0,
                None => scaled(burning_per_speed(settings, motor), burning::PER_SPEED_BITS),
            }),
            encoders: [0, 1].map(|motor| encoder(settings, motor)),
            alignment: [0, 1].map(|motor| settings.alignment(motor)),
            aligned: settings.aligned.iter().all(|aligned| *aligned != 0.0),
            pole_pairs: u32::from(pole_pairs(settings).max(1)),
            signed_pole_pairs: [0; 2],
            clockwise: [1; 2],
            current_per_count: gains
                .map(|motor| motor.map(|gain| scaled(gain * amperes_per_count * 4096.0, 21))),
            zero_design: Counts::from_raw(zero * 16),
            zero_tolerance: Counts::from_raw(scaled(ZERO_SHARE * range, 4)),
            sensed: sense.is_some(),
            over_current: Current::from_amperes(settings.over_current.into()),
            valid_counts: [lowest, highest].map(Counts::new),
            alignment_voltage: settings
                .phase_resistance
                .map(|resistance| volts(resistance * settings.alignment_current)),
            alignment_current: Current::from_amperes(settings.alignment_current.into()),
            alignment_counts: Counts::from_raw(
                sense.map_or(0, |_| counts(settings.alignment_current)),
            ),
            bus_per_count: scaled(bus * 65_536.0, 18),
            bus_nominal: volts(settings.nominal_voltage),
            // One that nobody measures is as it was entered, neither low nor high.
            battery_low: divider.map_or(Voltage::ZERO, |_| volts(settings.battery_low)),
            under_voltage: divider.map_or(Voltage::ZERO, |_| volts(settings.under_voltage)),
            // A bus that the converter does not tell from a higher one is too high, whatever the limit.
            over_voltage: divider.map_or(Voltage::from_raw(i32::MAX), |_| {
                let largest = bus * (f64::from(hardware.bus_largest_count) - 1.0);
                volts(settings.over_voltage).min(Voltage::from_volts(largest))
            }),
            largest_residual: Voltage::from_volts(
                RESIDUAL_SHARE * f64::from(settings.nominal_voltage),
            ),
            dead_share: scaled(dead_share(hardware), 31),
            over_speed: Speed::from_hertz(settings.over_speed),
            speed_per_current: [0, 1].map(|motor| speed_per_current(settings, motor)),
        };
        configuration.apply(configuration.alignment);
        configuration
    }

    /// Returns the current of a phase beyond which it is an over-current, of each motor whose amplifiers show this at no
    /// current: the limit or, where that is nearer, what the last count shows at which they do not end.
    pub(crate) fn over_current(&self, zeros: &[[Counts; 2]; 2]) -> [Current; 2] {
        if !self.sensed {
            return [Current::from_raw(i32::MAX / 4); 2];
        }
        let [lowest, highest] = self.valid_counts;
        let reach = |(zero, scale): (&Counts, &i32)| {
            let counts = (highest - *zero).min(*zero - lowest) - Counts::new(1);
            counts.current(magnitude(*scale))
        };
        [0, 1].map(|motor| {
            let phases = zeros[motor % 2].iter().zip(&self.current_per_count[motor % 2]);
            phases.map(reach).fold(self.over_current, Current::min).max(Current::ZERO)
        })
    }

    /// Takes over what an alignment found, but for the eccentricity tables.
    pub(crate) fn apply(&mut self, alignment: [Alignment; 2]) {
        self.alignment = alignment;
        for (index, found) in alignment.iter().enumerate() {
            let sign = |negative: bool| if negative { -1 } else { 1 };
            for scale in &mut self.current_per_count[index % 2] {
                *scale = magnitude(*scale) * sign(found.current_inverted);
            }
            self.clockwise[index % 2] = sign(found.reversed);
            self.signed_pole_pairs[index % 2] = self.pole_pairs as i32 * sign(found.reversed);
        }
    }

    /// Returns the current loop of a motor (0: top, 1: bottom).
    #[must_use]
    pub fn current_loop(settings: &Settings, hardware: &Hardware, motor: usize) -> Model {
        let inductance = f64::from(settings.phase_inductance[motor] * MILLI);
        let pwm_frequency = f64::from(hardware.pwm_frequency_hz);
        Model {
            dead_time: scaled(dead_time_slope(dead_share(hardware), inductance, pwm_frequency), 24),
            ..regulator(&settings.on(hardware), motor)
        }
    }

    /// Returns the electrical angle of a motor at this rotor angle.
    #[inline(always)]
    pub(crate) const fn electrical_angle(
        &self,
        motor: usize,
        angle: RotorAngle,
    ) -> ElectricalAngle {
        let turned = angle.raw().wrapping_mul(self.signed_pole_pairs[motor % 2] as u32);
        self.alignment[motor % 2].electrical_offset.turned(turned as i32)
    }

    /// Returns the electrical speed of a motor at this rotor speed.
    #[inline(always)]
    pub(crate) const fn electrical_speed(&self, motor: usize, speed: Speed) -> ElectricalSpeed {
        ElectricalSpeed::from_raw(speed.raw().wrapping_mul(self.signed_pole_pairs[motor % 2]))
    }

    /// Converts what makes a motor's torque (its q current or voltage) from clockwise positive to its own
    /// phase order, and back.
    #[inline(always)]
    pub(crate) fn clockwise<Q: Quantity>(&self, motor: usize, q: Q) -> Q {
        Q::from_raw(q.raw().wrapping_mul(self.clockwise[motor % 2]))
    }
}

/// Returns the current loop of a motor on bridges without dead time.
pub(crate) fn regulator(settings: &Settings, motor: usize) -> Model {
    let bandwidth = TAU * f64::from(settings.current_bandwidth);
    let resistance = f64::from(settings.phase_resistance[motor]);
    let inductance = f64::from(settings.phase_inductance[motor] * MILLI);
    // Electrical radians per second in one 2^-32 turn per tick, times 2^32.
    let speed = TAU * RATE;
    Model {
        proportional: scaled(inductance * bandwidth, PROPORTIONAL_BITS),
        integral: scaled(resistance * bandwidth / RATE, 24),
        resistance: scaled(resistance, 24),
        conductance: scaled(1.0 / resistance.max(LEAST_RESISTANCE), 24),
        admittance: scaled(admittance(resistance, inductance), 24),
        reactance: scaled(speed * inductance, REACTANCE_BITS),
        back_emf: scaled(speed * flux_linkage(settings, motor), 16),
        delay: scaled(f64::from(settings.actuation_delay) * 1e-6 * RATE, DELAY_BITS),
        dead_time: 0,
    }
}

/// Returns what a volt adds to the current of a winding in a tick, `(1 - exp(-x)) / R` with `x = R T / L`, by the series of
/// `exp(x)`: right to 0.1 % up to x = 1, and in the end one over R.
fn admittance(resistance: f64, inductance: f64) -> f64 {
    let x = resistance / (RATE * inductance);
    let numerator =
        1.0 + x / 2.0 * (1.0 + x / 3.0 * (1.0 + x / 4.0 * (1.0 + x / 5.0 * (1.0 + x / 6.0))));
    numerator / (RATE * inductance * (1.0 + x * numerator))
}

/// Returns by which share of its speed a shorted motor of this inertia slows down in a tick, at first.
pub(crate) fn braking(settings: &Settings, motor: usize) -> f32 {
    let linked = f32::from(pole_pairs(settings)) * settings.flux_linkage[motor] * MILLI;
    let inertia = settings.rotor_inertia * KG_M2_PER_G_CM2;
    1.5 * linked * linked / (settings.phase_resistance[motor] * inertia * TICK_RATE_HZ as f32)
}

/// Returns the share of a PWM period that dead time takes.
fn dead_share(hardware: &Hardware) -> f64 {
    f64::from(hardware.dead_time_ns) * 1e-9 * f64::from(hardware.pwm_frequency_hz)
}

fn pole_pairs(settings: &Settings) -> u8 {
    settings.pole_pairs as u8
}

/// Returns the flux linkage of a motor, Wb.
fn flux_linkage(settings: &Settings, motor: usize) -> f64 {
    f64::from(settings.flux_linkage[motor] * MILLI)
}

/// Returns the direct current that burns what a motor gives while it brakes, A per (turn per tick).
fn burning_per_speed(settings: &Settings, motor: usize) -> f64 {
    let resistance = f64::from(settings.phase_resistance[motor]);
    burning::current_per_speed(resistance, TAU * RATE * flux_linkage(settings, motor))
}

/// Returns the current that speeds up the rotor of a motor, A per (turn per tick^2).
fn current_per_acceleration(settings: &Settings, motor: usize) -> f64 {
    let inertia = f64::from(settings.rotor_inertia * KG_M2_PER_G_CM2);
    // N m per ampere of torque-making current.
    let torque_constant = 1.5 * f64::from(pole_pairs(settings)) * flux_linkage(settings, motor);
    inertia * TAU * RATE * RATE / torque_constant.max(1e-6)
}

/// See [`Configuration::speed_per_current`].
fn speed_per_current(settings: &Settings, motor: usize) -> i32 {
    let ticks = f64::from(DIAGNOSTIC_TICKS);
    // From 2^-16 A to 2^-32 turn.
    scaled(ticks / current_per_acceleration(settings, motor).max(1e-3), 16 + 16)
}

/// Returns how long after an update its torque acts: half a stride, what the bridges take, and the current loop's own time.
fn lag(settings: &Settings) -> i32 {
    let response = 1.0 / (TAU * f64::from(settings.current_bandwidth).max(1.0));
    let seconds = f64::from(settings.actuation_delay) * 1e-6 + response;
    scaled((f64::from(STRIDE) / 2.0 + RATE * seconds).min(LARGEST_LAG), LAG_BITS)
}

/// Returns the loops that hold f and theta, but for their lag.
pub(crate) fn position_loop(settings: &Settings) -> ShakerModel {
    let natural = TAU * f64::from(settings.position_bandwidth) / RATE;
    let limit = f64::from(settings.current_limit) * CURRENT_MARGIN;
    // A half because each motor takes half of either.
    let gains = [0, 1].map(|motor| current_per_acceleration(settings, motor) / 2.0);
    let largest =
        scaled(limit / gains[0].max(gains[1]).max(1e-6), 40).clamp(1, LARGEST_ACCELERATION);
    // As far as the largest may go up; the gains go down as far.
    let acceleration_shift = largest.leading_zeros() - 1;
    // From 2^-40 turn to 2^-16 A.
    let per_acceleration =
        |gain: f64| scaled(gain / f64::from(1_u32 << acceleration_shift), 16 + 32 - 40).max(1);
    ShakerModel {
        proportional: scaled(natural * natural, 40),
        derivative: scaled(2.0 * natural, 32),
        integral: scaled(INTEGRAL_SHARE * 2.0 * natural * natural * natural, INTEGRAL_BITS),
        current_per_acceleration: gains.map(per_acceleration),
        lag: 0,
        acceleration_shift,
        largest_acceleration: largest,
        current_limit: Current::from_amperes(limit),
        ramps: Ramps::of(settings),
    }
}

fn encoder(settings: &Settings, motor: usize) -> EncoderModel {
    let mut model = tracker(settings, motor);
    let alignment = settings.alignment(motor);
    for entry in 0..TABLE_LENGTH {
        model.set_entry(entry, &alignment.eccentricity);
    }
    model
}

/// Returns how the encoder of a motor is followed, but for its eccentricity.
pub(crate) fn tracker(settings: &Settings, motor: usize) -> EncoderModel {
    let natural = TAU * f64::from(settings.tracker_bandwidth) / RATE;
    // A reading is brought forward at the present speed, so that an error of that speed shows in it with the other sign: it
    // takes damping, as much as the late reading is ticks late.
    let late = f64::from(settings.encoder_latency) / f64::from(TICK_US);
    let damping = 2.0 * TRACKER_DAMPING * natural + natural * natural * late;
    EncoderModel {
        direction_sign: if settings.encoder_clockwise[motor] != 0.0 { 1 } else { -1 },
        zero: RotorAngle::from_degrees(settings.encoder_zero[motor]),
        latency_us: settings.encoder_latency as i32,
        angle_gain: scaled(damping, ANGLE_GAIN_BITS),
        speed_gain: scaled(natural * natural, 32),
        eccentricity: [0; TABLE_LENGTH],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::GENERIC_ESP32C6;

    #[test]
    fn battery_scale_scales_the_measured_battery() {
        let hardware = GENERIC_ESP32C6.with_battery_divider().hardware;
        let [as_built, scaled] = [1.0, 1.5].map(|battery_scale| {
            let settings = Settings { battery_scale, ..Settings::DEFAULT };
            Configuration::new(&settings, &hardware).bus_per_count
        });
        assert!((2 * scaled - 3 * as_built).abs() <= 3, "{as_built} {scaled}");
    }
}
