//! Walks: the mean motion of each stretch of an identification, as rows of `walks.csv`.

use super::Column;
use crate::nav::Identification;

/// Columns of `walks.csv`.
pub const COLUMNS: [Column; 6] = [
    Column::new("f_hz", 3),
    Column::new("theta_deg", 3),
    Column::new("forward_m_s", 5),
    Column::new("lateral_m_s", 5),
    Column::new("yaw_rad_s", 4),
    Column::new("seconds", 2),
];

/// Shortest walk that counts, s: the study takes no shorter one.
pub const SHORTEST: f64 = 0.5;

/// Returns a row for each stretch in which the rotors held their pair, [`SHORTEST`] or longer.
#[must_use]
pub fn rows(identification: &Identification) -> Vec<Vec<f64>> {
    let whole = identification
        .stretches()
        .iter()
        .filter(|stretch| stretch.at_speed && stretch.time.as_secs_f64() >= SHORTEST);
    whole
        .map(|stretch| {
            let (_, setpoint) = &identification.settings().pairs[stretch.mode];
            let motion = stretch.motion;
            vec![
                f64::from(setpoint.frequency().get()),
                f64::from(setpoint.direction().get()),
                motion.forward,
                motion.lateral,
                motion.yaw,
                stretch.time.as_secs_f64(),
            ]
        })
        .collect()
}
