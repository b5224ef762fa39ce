//! The whole robot under the ideal drive stays on its feet.

use flix_sim::experiment::walk::{DEFAULT_STEP, Shaking, Walk, WalkDrive, walk};
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::DIRECTIONS;
use rayon::prelude::*;

#[test]
fn at_full_speed_in_every_direction_it_stays_on_its_feet() {
    // Standing, the plate is 57 mm high; on its side or through the floor its middle is below.
    const LOWEST: f64 = 0.035;
    // Higher than it can hop: 35 Hz lift the feet by a few millimetres.
    const HIGHEST: f64 = 0.10;
    let model = RobotModel::named("W").unwrap();
    let runs: Vec<(f64, f64, u64)> = [-35.0, 35.0]
        .into_iter()
        .flat_map(|f| DIRECTIONS.map(|theta| (f, theta)))
        .flat_map(|(f, theta)| (1..=16).map(move |seed| (f, theta, seed)))
        .collect();
    runs.into_par_iter().for_each(|(f, theta, seed)| {
        let what = Walk {
            shaking: Shaking::new(f, theta).unwrap(),
            seconds: 8.0,
            drive: WalkDrive::Ideal,
            step: DEFAULT_STEP,
            heading: None,
        };
        let mut heights = (f64::INFINITY, f64::NEG_INFINITY);
        let walked = walk(&model, &what, seed, |plant| {
            let height = plant.body().position[2];
            heights = (heights.0.min(height), heights.1.max(height));
        })
        .unwrap();
        assert!(
            heights.0 > LOWEST && heights.1 < HIGHEST && walked.yaw_rad_s.is_finite(),
            "{f} Hz, {theta} degrees, seed {seed}: plate between {heights:?} m"
        );
    });
}
