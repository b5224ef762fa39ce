//! Whoever trains in the batch engine learns what is true of the robot under its software.

use flix_sim::experiment::sequences::{drawn, in_batch, root_mean_square, under_software};
use flix_sim::experiment::walk::Start;
use flix_sim::model::RobotModel;

/// Sequences that are drawn.
const SEQUENCES: u64 = 10;
/// How much further apart both may be than two starts of one of them are: a walk of changing commands magnifies a millimetre.
const BEYOND_CHANCE: f64 = 1.25;

#[test]
fn changing_commands_take_a_robot_as_far_in_the_batch_engine_as_under_its_software() {
    let model = RobotModel::named("W").unwrap();
    let (mut walked, mut off, mut spread) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..SEQUENCES {
        let sequence = drawn(seed);
        let start = Start { seed, heading: Some(0.0) };
        let other = Start { seed: seed + 1000, ..start };
        let robot = under_software(&model, start, &sequence).unwrap();
        let batch = in_batch(&model, start, &sequence).unwrap();
        let again = in_batch(&model, other, &sequence).unwrap();
        let minus = |a: [f64; 2], b: [f64; 2]| [a[0] - b[0], a[1] - b[1]];
        walked.push(robot);
        off.push(minus(batch, robot));
        spread.push(minus(again, batch));
    }
    let [walked, off, spread] = [&walked, &off, &spread].map(|all| root_mean_square(all));
    let figures = format!("walked {walked:.4} m, off {off:.4} m, two starts {spread:.4} m");
    println!("{figures}");
    assert!(off <= BEYOND_CHANCE * spread && off < 0.5 * walked, "{figures}");
}
