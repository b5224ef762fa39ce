//! A grid of pairs of f and theta that a robot walks, as rows of [`walks`](super::walks): over several runs, each of which
//! goes on where the last one ended.

use flix_protocol::message::Setpoint;

use crate::nav::{ENOUGH_MODES, Mode, ModeTable, Spread};

/// What is to be walked.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Its pairs, in the order in which they are walked.
    pub pairs: Vec<Setpoint>,
    /// Walks of each pair.
    pub walks: usize,
}

/// Returns the name of a pair.
#[must_use]
pub fn name(pair: &Setpoint) -> String {
    format!("{}:{}", pair.frequency().get(), pair.direction().get())
}

/// Returns whether a row, as [`super::walks::rows`] makes it, is of this pair.
fn is_of(row: &[f64], pair: &Setpoint) -> bool {
    // The file has three digits.
    let is_near = |value: f64, wanted: f32| (value - f64::from(wanted)).abs() < 1e-3;
    is_near(row[0], pair.frequency().get()) && is_near(row[1], pair.direction().get())
}

impl Grid {
    /// Returns the pairs that lack walks and have the fewest; empty when the grid is whole.
    #[must_use]
    pub fn next_round(&self, rows: &[Vec<f64>]) -> Vec<Setpoint> {
        let walked = |pair: &Setpoint| rows.iter().filter(|row| is_of(row, pair)).count();
        let fewest = self.pairs.iter().map(walked).min().unwrap_or(0);
        let mut round = self.pairs.clone();
        round.retain(|pair| walked(pair) == fewest && fewest < self.walks);
        round
    }

    /// Returns the walked pairs as modes, in which a robot can walk back; none with fewer than 4.
    #[must_use]
    pub fn modes(&self, rows: &[Vec<f64>]) -> Option<ModeTable> {
        let mode = |pair: &Setpoint| {
            let own: Vec<&Vec<f64>> = rows.iter().filter(|row| is_of(row, pair)).collect();
            let column = |at: usize| Spread::of(&own.iter().map(|row| row[at]).collect::<Vec<_>>());
            let (forward, lateral, yaw) = (column(2), column(3), column(4));
            let setpoint = *pair;
            (!own.is_empty()).then(|| Mode { name: name(pair), setpoint, forward, lateral, yaw })
        };
        let table = ModeTable::new("", "", self.pairs.iter().filter_map(mode).collect()).ok();
        table.filter(|it| it.modes().len() >= ENOUGH_MODES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        of(&[(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0)])
    }

    fn of(pairs: &[(f32, f32)]) -> Grid {
        let pairs = pairs.iter().map(|(f, theta)| Setpoint::saturating(*f, *theta));
        Grid { pairs: pairs.collect(), walks: 2 }
    }

    fn row(f: f64, theta: f64, forward: f64) -> Vec<f64> {
        vec![f, theta, forward, 0.0, 0.5, 7.0]
    }

    #[test]
    fn a_run_goes_on_with_the_pairs_that_have_the_fewest_walks_until_the_grid_is_whole() {
        let (grid, mut rows) = (grid(), Vec::new());
        let names =
            |rows: &[Vec<f64>]| -> Vec<String> { grid.next_round(rows).iter().map(name).collect() };
        assert_eq!(names(&rows), ["-30:30", "-30:90", "30:90"]);
        rows.extend([row(-30.0, 30.0, 0.1), row(30.0, 90.0, 0.1), row(10.0, 0.0, 0.1)]);
        assert_eq!(names(&rows), ["-30:90"]);
        rows.push(row(-30.0, 90.0, 0.1));
        assert_eq!(names(&rows).len(), 3);
        rows.extend([row(-30.0, 30.0, 0.1), row(-30.0, 90.0, 0.1), row(30.0, 90.0, 0.1)]);
        assert_eq!(names(&rows), [""; 0]);
    }

    #[test]
    fn what_was_walked_is_known_for_the_way_back_once_it_is_four_modes() {
        let pairs = [(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0), (30.0, 30.0)];
        let mut rows: Vec<_> = pairs[..3].iter().map(|(f, theta)| row(*f, *theta, 0.1)).collect();
        let grid = of(&pairs.map(|(f, theta)| (f as f32, theta as f32)));
        assert!(grid.modes(&[]).is_none() && grid.modes(&rows).is_none());
        rows.extend([row(30.0, 30.0, 0.1), row(-30.0, 30.0, 0.2)]);
        let modes = grid.modes(&rows).unwrap();
        assert_eq!(modes.modes().len(), 4);
        assert!((modes.modes()[0].forward.mean - 0.15).abs() < 1e-9);
    }
}
