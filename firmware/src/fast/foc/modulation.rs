//! Space-vector modulation with an over-modulation limit and dead-time compensation.

use crate::units::{Current, Duty, Voltage, multiply_high, shifted};

/// Largest phase voltage asked for, as a share of the bus, in 2^-16: 0.6.
///
/// 1/sqrt(3) = 0.577 is the inner circle of the hexagon that a bridge can reach, 2/3 its corners.
/// Up to 0.6 the corners add 4 % of voltage and the flats are cut by at most 4 %, which is less
/// ripple than an encoder's noise makes.
const LIMIT: i32 = 39_322;
/// A bus below this reads as this: 4 V, 2^-16 V.
const LOWEST_BUS: i32 = 4 << 16;
/// A bus above this reads as this: 60 V, 2^-16 V.
const HIGHEST_BUS: i32 = 60 << 16;

/// Returns what dead time takes for each ampere of a phase that swings through zero within a PWM period, V/A: what it takes
/// in whole, `share` x bus, over half the ripple, bus / (8 L f). `share` is of the PWM period, the inductance in H, the
/// frequency in Hz.
#[must_use]
pub fn dead_time_slope(share: f64, inductance: f64, pwm_frequency: f64) -> f64 {
    8.0 * share * inductance * pwm_frequency
}

/// What the bridge can do with the present bus voltage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bus {
    /// Bus voltage.
    pub voltage: Voltage,
    /// Largest phase voltage.
    pub limit: Voltage,
    /// Half of it, the most that d may take.
    pub(crate) limit_d: Voltage,
    /// What is left for q when d takes a quarter: 0.968 of it.
    pub(crate) limit_q: Voltage,
    /// 2^48 / voltage.
    reciprocal: i32,
    /// 2^39 / limit.
    pub(crate) reciprocal_limit: i32,
    /// What dead time takes of a phase that carries much.
    dead_voltage: Voltage,
}

impl Bus {
    /// Derives all from the bus voltage and the share of a PWM period that dead time takes (2^-31). It
    /// divides, so every few ticks is often enough. Never panics.
    #[must_use]
    pub const fn new(voltage: Voltage, dead_share: i32) -> Self {
        let voltage = voltage.raw();
        let voltage = if voltage < LOWEST_BUS {
            LOWEST_BUS
        } else if voltage > HIGHEST_BUS {
            HIGHEST_BUS
        } else {
            voltage
        };
        let limit = multiply_high(voltage << 4, LIMIT << 12);
        let reciprocal = ((u32::MAX / (voltage as u32 >> 4)) << 12) as i32;
        Self {
            voltage: Voltage::from_raw(voltage),
            limit: Voltage::from_raw(limit),
            limit_d: Voltage::from_raw(limit >> 1),
            limit_q: Voltage::from_raw(limit - (limit >> 5)),
            reciprocal,
            // 2^39 / (0.6 voltage) = reciprocal x 5/6 / 2^8.
            reciprocal_limit: multiply_high(reciprocal, 1_789_569_706) >> 7,
            dead_voltage: Voltage::from_raw(multiply_high(voltage << 1, dead_share)),
        }
    }

    /// Returns what must be added to the voltage of a phase that carries this current (into the
    /// motor), to make up for dead time; `slope` is in V/A, 2^-24 ([`dead_time_slope`]).
    #[inline(always)]
    #[must_use]
    pub const fn dead_time_compensation(&self, slope: i32, current: Current) -> Voltage {
        // Most often beyond the bend, either way: no branch.
        let most = self.dead_voltage.raw();
        let volts = multiply_high(shifted(current.raw(), 8), slope);
        let bent = if volts < -most { -most } else { volts };
        Voltage::from_raw(if bent > most { most } else { bent })
    }

    /// Returns duties that give these phase voltages, up to a common part: the middle of the largest and
    /// the smallest is put at half the bus, which is space-vector modulation. Clipped to the bus.
    #[inline(always)]
    #[must_use]
    pub const fn duties(&self, phases: [Voltage; 3]) -> [Duty; 3] {
        let [a, b, c] = [phases[0].raw(), phases[1].raw(), phases[2].raw()];
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        let low = if c < low { c } else { low };
        let high = if c > high { c } else { high };
        let common = low.wrapping_add(high) >> 1;
        [
            self.duty(a.wrapping_sub(common)),
            self.duty(b.wrapping_sub(common)),
            self.duty(c.wrapping_sub(common)),
        ]
    }

    #[inline(always)]
    const fn duty(&self, voltage: i32) -> Duty {
        let share = multiply_high(voltage, self.reciprocal).wrapping_add(1 << 15);
        if share as u32 <= u16::MAX as u32 {
            return Duty::from_raw(share as u16);
        }
        core::hint::cold_path();
        if share < 0 { Duty::ZERO } else { Duty::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fast::foc::transform::{Direction, Stator, inverse_clarke};
    use crate::units::ElectricalAngle;

    const TWELVE_VOLTS: Voltage = Voltage::from_raw(12 << 16);

    fn line_voltages(duties: [Duty; 3]) -> [f64; 3] {
        let phase = duties.map(|duty| f64::from(duty.raw()) / 65_536.0 * 12.0);
        [phase[0] - phase[1], phase[1] - phase[2], phase[2] - phase[0]]
    }

    #[test]
    fn gives_the_line_voltages_that_were_asked_for_up_to_the_inner_circle() {
        let bus = Bus::new(TWELVE_VOLTS, 0);
        let radius = (0.577 * f64::from(TWELVE_VOLTS.raw())) as i32;
        for step in 0..720_u32 {
            let angle = ElectricalAngle::from_raw(step.wrapping_mul(5_965_232));
            let direction = Direction::from(angle);
            let along = |part| Voltage::from_raw(multiply_high(radius * 2, part));
            let vector = Stator { alpha: along(direction.cosine), beta: along(direction.sine) };
            let phases = inverse_clarke(vector).map(|phase| f64::from(phase.raw()) / 65_536.0);
            let want = [phases[0] - phases[1], phases[1] - phases[2], phases[2] - phases[0]];
            for (have, want) in line_voltages(bus.duties(inverse_clarke(vector))).iter().zip(want) {
                assert!((have - want).abs() < 0.002, "step {step}: {have} for {want}");
            }
        }
    }

    #[test]
    fn clips_at_the_bus_beyond_the_hexagon() {
        let bus = Bus::new(TWELVE_VOLTS, 0);
        let beyond = Stator { alpha: Voltage::from_raw(40 << 16), beta: Voltage::ZERO };
        let duties = bus.duties(inverse_clarke(beyond));
        assert_eq!(duties, [Duty::MAX, Duty::ZERO, Duty::ZERO]);
    }

    #[test]
    fn dead_time_is_made_up_for_with_the_sign_of_the_current() {
        // 1.25 % of 12 V are 0.15 V.
        let bus = Bus::new(TWELVE_VOLTS, (0.0125 * 2_147_483_648.0) as i32);
        // 2 V/A.
        let added = |current| bus.dead_time_compensation(2 << 24, Current::from_raw(current)).raw();
        let full = added(1 << 16);
        assert!((full - 9_830).abs() < 4, "{full}");
        assert!((added(-(1 << 16)) + full).abs() < 2);
        assert_eq!(added(0), 0);
        assert!((added(3_277) - 6_554).abs() < 2, "{}", added(3_277));
    }

    #[test]
    fn no_bus_voltage_is_too_small_or_too_large() {
        for voltage in [i32::MIN, -1, 0, 1, i32::MAX] {
            let bus = Bus::new(Voltage::from_raw(voltage), i32::MAX);
            assert!(bus.limit > Voltage::ZERO && bus.reciprocal > 0);
        }
    }
}
