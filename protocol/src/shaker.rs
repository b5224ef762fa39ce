//! Converts the shaker's coordinates (phase, theta) to the rotors' angles and back.
//!
//! `phase` and `theta` count clockwise (`theta` positive to the right); angles in the body frame
//! FLU count counter-clockwise. All angles are in radians, of any size: nothing is wrapped.

/// Returns the angles of the rotors about body +z (FLU, counter-clockwise), top and bottom, at
/// shaking phase `phase = omega t` and direction `theta` (both clockwise). Radians.
#[must_use]
pub fn rotor_angles(phase: f64, theta: f64) -> [f64; 2] {
    [-(phase + theta), -(theta - phase)]
}

/// Returns `(phase, theta)`, clockwise, of rotors at these angles about body +z. Radians.
///
/// The inverse of [`rotor_angles`]; a full turn added to one rotor shifts both results by half a
/// turn, which is the same line of force.
#[must_use]
pub fn phase_and_direction(rotor_angles: [f64; 2]) -> (f64, f64) {
    let [top, bottom] = rotor_angles.map(|angle| -angle);
    ((top - bottom) / 2.0, (top + bottom) / 2.0)
}

/// Returns the direction of the line of force of two rotors, degrees clockwise from forward, in
/// [-90, 90).
#[must_use]
pub fn line_of_force(rotor_angles: [f64; 2]) -> f64 {
    let (_, theta) = phase_and_direction(rotor_angles);
    let half_turns = theta / core::f64::consts::PI + 0.5;
    (half_turns - floor(half_turns) - 0.5) * 180.0
}

/// `core` has no `f64::floor`. Exact for angles of any size that a run can reach.
fn floor(value: f64) -> f64 {
    let truncated = value as i64 as f64;
    if truncated > value { truncated - 1.0 } else { truncated }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positive_frequency_turns_the_top_rotor_clockwise() {
        let [before, _] = rotor_angles(0.0, 0.3);
        let [after, _] = rotor_angles(0.1, 0.3);
        assert!(after < before, "clockwise is negative about +z");
    }

    #[test]
    fn positive_theta_points_the_common_line_to_the_right() {
        let [top, bottom] = rotor_angles(0.0, 0.5);
        assert!(top == bottom && top.sin() < 0.0, "right is -y");
    }

    #[test]
    fn the_two_ways_are_inverse() {
        for step in 0..200 {
            let (phase, theta) = (f64::from(step) * 0.37 - 30.0, f64::from(step) * 0.011 - 1.1);
            let (phase_back, theta_back) = phase_and_direction(rotor_angles(phase, theta));
            assert!((phase_back - phase).abs() < 1e-12 && (theta_back - theta).abs() < 1e-12);
        }
    }

    #[test]
    fn plus_and_minus_ninety_degrees_are_one_line() {
        let right = line_of_force(rotor_angles(0.2, core::f64::consts::FRAC_PI_2));
        let left = line_of_force(rotor_angles(0.2, -core::f64::consts::FRAC_PI_2));
        assert!(((right - left).abs() % 180.0).min(180.0 - (right - left).abs() % 180.0) < 1e-9);
    }
}
