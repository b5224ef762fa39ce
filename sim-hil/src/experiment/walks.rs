//! Many walks at once, each by a robot of its own, with ideal drives.

use flix_host::nav::Twist;

use super::walk::{Odometer, Shaking, Start, WalkError, Walked};
use crate::batch::{Batch, Precision};
use crate::model::RobotModel;
use crate::plant::mechanics::lane::{Lane as _, Single};

/// Time between two looks at the robots, s: ten in a turn at 100 Hz.
const LOOK: f64 = 1e-3;
/// Walks that fill the lanes of a block.
pub const TOGETHER: usize = Single::LANES;

/// One of many walks.
#[derive(Debug, Clone)]
pub struct OneOfMany {
    /// The robot.
    pub model: RobotModel,
    /// f and theta.
    pub shaking: Shaking,
    /// Where and how it starts.
    pub start: Start,
}

/// Walks each for `seconds` in steps of `step` seconds, by single precision; what a walk gives does not depend on the
/// others. Runs on the calling thread alone when there are no more than [`TOGETHER`].
#[must_use]
pub fn walks(many: &[OneOfMany], seconds: f64, step: f64) -> Vec<Result<Walked, WalkError>> {
    walks_while(many, seconds, step, || true).unwrap_or_default()
}

/// Walks as [`walks`] does, but only while `goes_on`, which is asked every millisecond of the walks; none when it did not.
pub fn walks_while(
    many: &[OneOfMany],
    seconds: f64,
    step: f64,
    goes_on: impl Fn() -> bool,
) -> Option<Vec<Result<Walked, WalkError>>> {
    let mut results: Vec<Option<Result<Walked, WalkError>>> = many.iter().map(|_| None).collect();
    let mut walking = Vec::new();
    for (index, one) in many.iter().enumerate() {
        match one.start.plant(&one.model) {
            Ok(mut plant) => {
                plant.set_drive(one.shaking.drive());
                walking.push((index, plant));
            }
            Err(error) => results[index] = Some(Err(error)),
        }
    }
    let models = walking.iter().map(|(index, _)| many[*index].model.clone()).collect();
    let plants: Vec<_> = walking.iter().map(|(_, plant)| plant).collect();
    let Ok(mut batch) = Batch::of(models, &plants, Precision::Single) else {
        unreachable!("each of these robots was built")
    };
    let mut odometers: Vec<_> = plants.iter().map(|plant| Odometer::start(plant)).collect();
    let steps = (seconds / step).round() as usize;
    let look = ((LOOK / step).round() as usize).max(1);
    let mut done = 0;
    while done < steps {
        if !goes_on() {
            return None;
        }
        let now = look.min(steps - done);
        batch.run(now, step);
        for (robot, odometer) in odometers.iter_mut().enumerate() {
            odometer.add(&batch.body(robot), step * now as f64);
        }
        done += now;
    }
    for (robot, ((index, _), odometer)) in walking.iter().zip(odometers).enumerate() {
        results[*index] = Some(match batch.diverged(robot) {
            Some(diverged) => Err(diverged.into()),
            None => Ok(odometer.finish(&batch.body(robot), batch.motor_work(robot))),
        });
    }
    Some(results.into_iter().flatten().collect())
}

/// Walks each from a heading of its own, at f (Hz) and theta (degrees), and returns the mean motions; none for a walk
/// that did not come about.
#[must_use]
pub fn ideal_motions(
    many: &[(&RobotModel, (f64, f64), u64)],
    seconds: f64,
    step: f64,
) -> Vec<Option<Twist>> {
    let mut motions = vec![None; many.len()];
    let walking: Vec<(usize, OneOfMany)> = many
        .iter()
        .enumerate()
        .filter_map(|(index, (model, (f_hz, theta_deg), seed))| {
            let shaking = Shaking::new(*f_hz, *theta_deg).ok()?;
            let start = Start { seed: *seed, heading: None };
            Some((index, OneOfMany { model: (*model).clone(), shaking, start }))
        })
        .collect();
    let (indices, walking): (Vec<_>, Vec<_>) = walking.into_iter().unzip();
    for (index, walked) in indices.into_iter().zip(walks(&walking, seconds, step)) {
        motions[index] = walked.ok().map(|walked| walked.motion());
    }
    motions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::walk::{Spread, ideal_motion};

    const SEEDS: u64 = 24;

    /// Speeds of the seeds along the three axes.
    fn axes(motions: &[Twist]) -> [Spread; 3] {
        let of =
            |pick: fn(&Twist) -> f64| Spread::of(&motions.iter().map(pick).collect::<Vec<_>>());
        [of(|m| m.forward), of(|m| m.lateral), of(|m| m.yaw)]
    }

    #[test]
    fn short_numbers_walk_as_long_ones_do_within_the_spread_of_the_seeds() {
        let model = RobotModel::named("W").unwrap();
        for pair in [(30.0, 0.0), (-30.0, 60.0)] {
            let many: Vec<_> = (0..SEEDS).map(|seed| (&model, pair, seed)).collect();
            let short: Vec<Twist> =
                ideal_motions(&many, 2.0, 2.5e-4).into_iter().map(Option::unwrap).collect();
            // Other seeds: two samples of the same walk.
            let long: Vec<Twist> = (100..100 + SEEDS)
                .map(|seed| ideal_motion(&model, pair, 2.0, 2.5e-4, seed).unwrap())
                .collect();
            for (short, long) in axes(&short).into_iter().zip(axes(&long)) {
                let error =
                    (short.spread.unwrap().powi(2) + long.spread.unwrap().powi(2)) / SEEDS as f64;
                let off = (short.mean - long.mean).abs() / error.sqrt();
                assert!(off < 3.0, "{pair:?}: {short:?} {long:?}");
            }
        }
    }

    #[test]
    fn a_walk_does_not_depend_on_the_others() {
        let model = RobotModel::named("A").unwrap();
        let many: Vec<_> = (0..5).map(|seed| (&model, (-25.0, 30.0), seed)).collect();
        let together = ideal_motions(&many, 0.2, 1e-4);
        assert_eq!(ideal_motions(&many[3..4], 0.2, 1e-4)[0], together[3]);
    }

    #[test]
    fn energy_and_path_agree_with_a_walk_alone_while_it_is_too_short_for_chaos() {
        use crate::experiment::walk::{Walk, WalkDrive, walk};
        let model = RobotModel::named("W").unwrap();
        let shaking = Shaking::new(20.0, 40.0).unwrap();
        let start = Start { seed: 4, heading: Some(1.0) };
        let one = OneOfMany { model: model.clone(), shaking, start };
        let many = walks(&[one], 0.05, 1e-4).remove(0).unwrap();
        let what = Walk {
            shaking,
            seconds: 0.05,
            drive: WalkDrive::Ideal,
            step: 1e-4,
            heading: Some(1.0),
        };
        let alone = walk(&model, &what, 4, |_| {}).unwrap();
        for (many, alone) in [
            (many.energy_j, alone.energy_j),
            (many.path_m, alone.path_m),
            (many.forward_m_s, alone.forward_m_s),
            (many.yaw_rad_s, alone.yaw_rad_s),
        ] {
            assert!((many - alone).abs() < 0.01 * alone.abs(), "{many} {alone}");
        }
    }
}
