//! Whoever trains in the batch engine learns what is true of the robot under its software.

use flix_sim::experiment::random_sequences::{drawn, in_batch, root_mean_square, under_software};
use flix_sim::experiment::walk::Start;
use flix_sim::model::RobotModel;
use rayon::prelude::*;

/// Sequences that are drawn, and starts of each: a walk of changing commands magnifies a millimetre, so that means are compared.
const SEQUENCES: u64 = 12;
const STARTS: u64 = 6;
/// Share of its way by which the engine may be off: what is promised of 100 sequences.
const PROMISED: f64 = 0.1;
/// What so few sequences add to that and to chance.
const FEW: f64 = 1.25;

fn mean(vectors: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|axis| vectors.iter().map(|v| v[axis]).sum::<f64>() / vectors.len() as f64)
}

/// Returns how far each is from their mean, as of one that is not among them.
fn spread(vectors: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let (mean, n) = (mean(vectors), vectors.len() as f64);
    let fair = (n / (n - 1.0)).sqrt();
    vectors.iter().map(|v| [0, 1].map(|axis| fair * (v[axis] - mean[axis]))).collect()
}

#[test]
fn changing_commands_take_a_robot_as_far_in_the_batch_engine_as_under_its_software() {
    let model = RobotModel::named("W").unwrap();
    let all: Vec<_> = (0..SEQUENCES)
        .into_par_iter()
        .map(|number| {
            let sequence = drawn(number);
            let (mut starts, mut robots) = (Vec::new(), Vec::new());
            for seed in (0..STARTS).map(|start| number + 1000 * start) {
                let start = Start { seed, heading: Some(0.0) };
                let (robot, theta_rad) = under_software(&model, start, &sequence).unwrap();
                robots.push(robot);
                starts.push((start, theta_rad));
            }
            (robots, in_batch(&model, &starts, &sequence).unwrap())
        })
        .collect();
    let (mut walked, mut off, mut chance) = (Vec::new(), Vec::new(), Vec::new());
    for (robots, batch) in all {
        let (robot, ideal) = (mean(&robots), mean(&batch));
        walked.push(robot);
        off.push([ideal[0] - robot[0], ideal[1] - robot[1]]);
        chance.extend(spread(&robots).into_iter().chain(spread(&batch)));
    }
    let [walked, off, chance] = [&walked, &off, &chance].map(|all| root_mean_square(all));
    // Of the difference of two means.
    let by_chance = chance * (2.0 / STARTS as f64).sqrt();
    let figures = format!("walked {walked:.4} m, off {off:.4} m, by chance {by_chance:.4} m");
    println!("{figures}");
    let bound = FEW * by_chance.hypot(PROMISED * walked);
    assert!(off <= bound && by_chance < 0.2 * walked, "{figures}");
}
