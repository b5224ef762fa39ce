//! Whether the rotors turn as commanded.

use flix_protocol::message::{Setpoint, Telemetry};
use flix_protocol::units::Hertz;

/// Largest error of f that counts as reached, Hz.
const FREQUENCY_REACHED_HZ: f32 = 0.5;
/// Largest error of theta that counts as reached, degrees.
const DIRECTION_REACHED_DEG: f32 = 5.0;

/// Returns the errors of f (Hz) and theta (degrees) that telemetry shows. Rotors at rest have no direction.
#[must_use]
pub fn errors(telemetry: &Telemetry, setpoint: &Setpoint) -> [f32; 2] {
    let frequency = telemetry.frequency.get() - setpoint.frequency().get();
    let direction = if setpoint.frequency() == Hertz::ZERO {
        0.0
    } else {
        line_difference(f64::from(telemetry.direction.get() - setpoint.direction().get())) as f32
    };
    [frequency, direction]
}

/// Returns whether the robot has taken this setpoint and its rotors have reached it.
#[must_use]
pub fn is_reached(telemetry: &Telemetry, setpoint: &Setpoint) -> bool {
    let [frequency, direction] = errors(telemetry, setpoint);
    telemetry.setpoint == *setpoint
        && frequency.abs() <= FREQUENCY_REACHED_HZ
        && direction.abs() <= DIRECTION_REACHED_DEG
}

/// Returns the difference of two directions, degrees in [-90, 90): half a turn apart they are one
/// line of force.
#[must_use]
pub fn line_difference(degrees: f64) -> f64 {
    (degrees + 90.0).rem_euclid(180.0) - 90.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opposite_directions_are_one_line() {
        for (degrees, expected) in [(0.0, 0.0), (180.0, 0.0), (-179.0, 1.0), (95.0, -85.0)] {
            assert!((line_difference(degrees) - expected).abs() < 1e-4, "{degrees}");
        }
    }
}
