//! A robot of one's own: a shipped model with a camera on its front edge, walked beside the model that it came from.
//!
//! What is printed first is the whole model as TOML: kept in a file and edited, it is what `flix-sim --model FILE` reads.
//!
//! `cargo run --release -p flix-sim --example own-model`

use std::error::Error;

use flix_sim::experiment::walk::{DEFAULT_STEP, Shaking, Spread, Walk, WalkDrive, walk};
use flix_sim::model::{Load, RobotModel};

/// Walks of each model, each with its start disturbed.
const SEEDS: u64 = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let shipped = RobotModel::named("W")?;
    let mut own = RobotModel { name: "W with a camera".to_owned(), ..shipped.clone() };
    own.load.push(Load { mass_g: 25.0, x_mm: 90.0, y_mm: 0.0, z_mm: 15.0 });
    own.check()?;
    println!("{}", toml::to_string(&own)?);

    let what = Walk {
        shaking: Shaking::new(-30.0, 30.0)?,
        seconds: 4.0,
        drive: WalkDrive::Ideal,
        step: DEFAULT_STEP,
        heading: None,
    };
    for model in [&shipped, &own] {
        let walks: Vec<_> =
            (1..=SEEDS).map(|seed| walk(model, &what, seed, |_| {})).collect::<Result<_, _>>()?;
        let speeds: Vec<f64> = walks.iter().map(|walked| walked.forward_m_s).collect();
        let Spread { mean, spread } = Spread::of(&speeds);
        let spread = spread.map_or_else(String::new, |spread| format!(" +- {spread:.4}"));
        println!("{:16} {mean:.4}{spread} m/s forward", model.name);
    }
    Ok(())
}
