//! Steps a second of this engine and of MuJoCo, on the same machine in one run.
//!
//! Model A at 0.1 ms, 30 Hz, 30 degrees, feet on the floor, one thread each. Needs Python with `mujoco`.
//!
//!     cargo bench -p flix-sim --bench mujoco

use std::time::Instant;

use flix_sim::model::RobotModel;
use flix_sim::model::mjcf::mjcf;
use flix_sim::plant::mechanics::reference_contact;
use flix_sim::plant::{Drive, Mechanics, Plant};

#[path = "support/python.rs"]
mod python;

/// Runs the exported model for `steps` steps and prints microseconds a step.
const THEIRS: &str = "
import math, sys, time, mujoco
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
for name, sign in (('top', 1), ('bottom', -1)):
    joint = model.joint(name)
    model.dof_armature[joint.dofadr[0]] = 1e6
    data.qpos[joint.qposadr[0]] = -math.radians(30)
    data.qvel[joint.dofadr[0]] = -sign * 2 * math.pi * 30
steps = int(sys.argv[2])
mujoco.mj_step(model, data, 1000)
start = time.process_time()
mujoco.mj_step(model, data, steps)
print(1e6 * (time.process_time() - start) / steps)
";

const STEPS: u32 = 20_000;
const ROUNDS: usize = 5;

fn main() {
    let model = RobotModel::named("A").expect("shipped models are valid");
    let path = std::env::temp_dir().join(format!("flix-bench-{}.xml", std::process::id()));
    std::fs::write(&path, mjcf(&model, 1e-4, reference_contact(&model)))
        .expect("the temporary directory takes a file");
    let (mut ours, mut theirs) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        ours = ours.min(here(&model));
        let Some(time) = python::number(THEIRS, &path, &[STEPS.to_string()]) else {
            println!("{ours:.2} us a step of model A here");
            return;
        };
        theirs = theirs.min(time);
    }
    let _ = std::fs::remove_file(&path);
    println!(
        "model A, 0.1 ms, one thread, best of {ROUNDS}: {ours:.2} us a step here, {theirs:.2} us MuJoCo, ratio {:.1}",
        theirs / ours
    );
}

fn here(model: &RobotModel) -> f64 {
    let mut plant = Plant::new(model).expect("shipped models are valid");
    plant.set_drive(Drive::Ideal { frequency_hz: 30.0, theta_rad: 30f64.to_radians() });
    let mut run = |steps: u32| {
        for _ in 0..steps {
            plant.step([0.0; 2], 1e-4).expect("a walk does not diverge");
        }
    };
    run(1000);
    let start = Instant::now();
    run(STEPS);
    1e6 * start.elapsed().as_secs_f64() / f64::from(STEPS)
}
