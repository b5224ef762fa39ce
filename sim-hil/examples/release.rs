//! Where the tip of model A's clamped front-left leg is, mm along x, 20 ms after its release from 0.1 rad in
//! every bending hinge, for the steps (in ms) given: one part of `validation/convergence.py`.

use std::error::Error;

use flix_sim::model::RobotModel;
use flix_sim::plant::{Mechanics, Plant};

fn main() -> Result<(), Box<dyn Error>> {
    for argument in std::env::args().skip(1) {
        let step = 1e-3 * argument.parse::<f64>()?;
        let mut plant = Plant::new(&RobotModel::named("A")?)?;
        plant.clamp();
        plant.set_hinges(0, [0.1, 0.0, 0.1, 0.0, 0.1, 0.0]);
        for _ in 0..(0.02 / step).round() as usize {
            plant.step([0.0; 2], step)?;
        }
        let legs = plant.legs().ok_or("model A has legs")?;
        let root = 0.1;
        println!("{}", 1e3 * (legs[0].joints[3][0] - root));
    }
    Ok(())
}
