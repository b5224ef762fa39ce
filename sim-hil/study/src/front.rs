//! The front of speed against cost of transport: pairs (f, theta) that no other pair beats in both.

use serde::Serialize;

use flix_sim::study::Table;

/// What a pair takes to move its robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gait {
    /// Hz.
    pub f_hz: f64,
    /// Degrees.
    pub theta_deg: f64,
    /// Mean speed along the path of the body, m/s; the path may bend.
    pub speed_m_s: f64,
    /// Energy over weight times path; of the ideal motors, or from the battery with `--drive firmware`.
    pub cost_of_transport: f64,
    /// Mean yaw rate, rad/s: a path with a radius of speed over yaw rate.
    pub yaw_rad_s: f64,
}

/// A walk: f, theta, speed along its path, cost of transport, yaw rate.
type Row = [f64; 5];

/// Returns the pairs of the first variant of a sweep, each as its mean over the seeds, from the slowest.
///
/// A pair that is slower than a millimetre a second, or whose motors gain energy, is none.
#[must_use]
pub fn gaits(table: &Table) -> Vec<Gait> {
    let variants = table.texts("variant");
    let columns = ["f_hz", "theta_deg", "path_m_s", "cost_of_transport", "yaw_rad_s"]
        .map(|name| table.numbers(name));
    let rows: Vec<Row> = (0..variants.len())
        .filter(|i| variants[*i] == variants[0])
        .map(|i| core::array::from_fn(|column| columns[column][i]))
        .collect();
    means(&rows)
}

/// Returns the means over the walks of each pair; walks of a pair lie together.
fn means(rows: &[Row]) -> Vec<Gait> {
    /// Slower is no walk, m/s.
    const LEAST_SPEED: f64 = 1e-3;
    let mut gaits: Vec<Gait> = rows
        .chunk_by(|a, b| a[..2] == b[..2])
        .map(|walks| {
            let mean =
                |of: &dyn Fn(&Row) -> f64| walks.iter().map(of).sum::<f64>() / walks.len() as f64;
            let [f_hz, theta_deg, ..] = walks[0];
            let speed_m_s = mean(&|row| row[2]);
            Gait {
                f_hz,
                theta_deg,
                speed_m_s,
                // All energy over the whole way: a walk that goes farther counts for more.
                cost_of_transport: mean(&|row| row[3] * row[2]) / speed_m_s,
                yaw_rad_s: mean(&|row| row[4]),
            }
        })
        .filter(|gait| gait.speed_m_s > LEAST_SPEED && gait.cost_of_transport > 0.0)
        .collect();
    gaits.sort_by(|a, b| a.speed_m_s.total_cmp(&b.speed_m_s));
    gaits
}

/// Returns those that no other beats in both, from the slowest and cheapest to the fastest.
#[must_use]
pub fn front(gaits: &[Gait]) -> Vec<Gait> {
    let beats = |other: &Gait, gait: &Gait| {
        other.speed_m_s >= gait.speed_m_s
            && other.cost_of_transport <= gait.cost_of_transport
            && other != gait
    };
    let unbeaten = |gait: &&Gait| !gaits.iter().any(|other| beats(other, gait));
    gaits.iter().filter(unbeaten).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk(f: f64, speed: f64, cost: f64) -> Row {
        [f, 30.0, speed, cost, 0.1]
    }

    #[test]
    fn the_front_is_what_no_other_pair_beats_in_both() {
        let rows = [
            walk(20.0, 0.02, 1.0),
            walk(25.0, 0.03, 2.0),
            walk(30.0, 0.05, 1.5),
            walk(35.0, 0.08, 3.0),
            walk(10.0, 0.0, 9.0),
            walk(15.0, 0.09, -0.1),
        ];
        let front = front(&means(&rows));
        let f: Vec<f64> = front.iter().map(|gait| gait.f_hz).collect();
        assert_eq!(f, [20.0, 30.0, 35.0]);
    }

    #[test]
    fn walks_of_a_pair_count_by_their_way() {
        let gaits = means(&[walk(30.0, 0.01, 4.0), walk(30.0, 0.03, 2.0)]);
        assert_eq!(gaits.len(), 1);
        assert!((gaits[0].speed_m_s - 0.02).abs() < 1e-12);
        assert!((gaits[0].cost_of_transport - 2.5).abs() < 1e-12);
    }
}
