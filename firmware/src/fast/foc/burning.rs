//! Braking that gives nothing back: what the rotors lose is burnt in their own windings.
//!
//! A bench supply takes no current back, so what a braking motor gives lifts the bus until something
//! breaks. Electrical power of a motor, with its short-circuit current `b = w lambda / R`:
//!
//! ```text
//! p = 3/2 (R (i_d^2 + i_q^2) + w lambda i_q) = 3/2 R (i_d^2 - (b/2)^2 + (i_q + b/2)^2)
//! ```
//!
//! With `|i_d|` of `b/2` or more it is never below zero, whatever `i_q` is: torque, and with it theta,
//! stay under control. `i_d` is against the magnets, which takes voltage from the bridge's limit
//! rather than adding to it.

use crate::units::{Current, ElectricalSpeed, magnitude, multiply_high, shifted};

/// Beyond `b/2`, for a flux linkage or a resistance that differs from its setting: 1.25.
const MARGIN: f64 = 1.25;
/// Currents are squared in 2^-11 A: 32 A still fit.
const SQUARED_SHIFT: u32 = 5;

/// Fixed point of [`current_per_speed`], of 2^-16 A per (2^-32 turn per tick) in 2^-32: 30 mWb and 0.02 ohm make 58,905 A.
pub(crate) const PER_SPEED_BITS: u32 = 15;

/// Returns direct current per electrical speed, A per (turn per tick), for a motor of this phase resistance (ohm)
/// and flux linkage (V per (turn per tick)).
pub(crate) fn current_per_speed(resistance: f64, flux_linkage: f64) -> f64 {
    MARGIN * 0.5 * flux_linkage / resistance
}

/// Returns the direct current with which a motor at this speed gives nothing back, as far as there is [`room`]. `per_speed`: in 2^-[`PER_SPEED_BITS`] A per (turn per tick); zero asks for none.
#[inline(always)]
pub(crate) fn direct_current(
    per_speed: i32,
    speed: ElectricalSpeed,
    current_q: Current,
    limit: Current,
) -> Current {
    let burning = shifted(multiply_high(magnitude(speed.raw()), per_speed), 16 - PER_SPEED_BITS);
    -Current::from_raw(burning).within(room(current_q, limit))
}

/// Returns the direct current for which the torque-making current leaves room below 7/8 of `limit`: while both change, each in its
/// own way, together they pass what either may.
#[inline(always)]
pub(crate) fn room(current_q: Current, limit: Current) -> Current {
    let square = |current: Current| {
        let size = (current.magnitude().raw() >> SQUARED_SHIFT) as u32;
        size.saturating_mul(size)
    };
    let limit = Current::from_raw(limit.raw() - (limit.raw() >> 3));
    let room = square(limit).saturating_sub(square(current_q)).isqrt() << SQUARED_SHIFT;
    Current::from_raw(room as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESISTANCE: f64 = 2.5;
    /// Of 3 mWb, V per (turn per tick).
    const FLUX_LINKAGE: f64 = 3e-3 * core::f64::consts::TAU * 1e4;
    /// 35 Hz with 7 pole pairs, turns per tick.
    const FASTEST: f64 = 245.0 / 1e4;
    const LIMIT: f64 = 1.7;

    fn direct(speed: f64, current_q: f64, limit: f64) -> f64 {
        let per_speed =
            current_per_speed(RESISTANCE, FLUX_LINKAGE) * f64::from(1 << PER_SPEED_BITS);
        let speed = ElectricalSpeed::from_raw((speed * 4_294_967_296.0) as i32);
        let amperes = Current::from_amperes;
        let current = direct_current(per_speed as i32, speed, amperes(current_q), amperes(limit));
        f64::from(current.raw()) / 65_536.0
    }

    /// Every speed and torque-making current that occurs.
    fn cases() -> impl Iterator<Item = (f64, f64)> {
        (-20..=20).flat_map(|speed| {
            let speed = FASTEST * f64::from(speed) / 20.0;
            (-100..=100).map(move |current| (speed, LIMIT * f64::from(current) / 100.0))
        })
    }

    #[test]
    fn a_motor_whose_flux_is_a_tenth_stronger_and_resistance_a_tenth_lower_gives_nothing_back() {
        for (speed, q) in cases() {
            let d = direct(speed, q, 10.0);
            let power = 0.9 * RESISTANCE * (d * d + q * q) + 1.1 * FLUX_LINKAGE * speed * q;
            assert!(power > -1e-3, "{power} W at {speed} with {q} A");
        }
    }

    #[test]
    fn the_phase_current_stays_within_its_limit() {
        for (speed, q) in cases() {
            let d = direct(speed, q, LIMIT);
            assert!(d <= 0.0 && d.hypot(q) < LIMIT + 1e-3, "{d} A beside {q} A");
        }
    }

    #[test]
    fn no_current_is_asked_for_where_the_bus_is_measured() {
        let fast = ElectricalSpeed::from_raw(1 << 27);
        let current = direct_current(0, fast, Current::ZERO, Current::from_amperes(LIMIT));
        assert_eq!(current, Current::ZERO);
    }
}
