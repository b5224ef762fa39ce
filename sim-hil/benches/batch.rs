//! Steps thousands of robots here and by MuJoCo's `rollout`, on two threads of the same machine in one run.
//!
//! Model W at 0.1 ms, 30 Hz, each robot with a theta and a start of its own, feet on the floor. What a step costs in
//! arithmetic is counted by numbers that count; the peak is that of a loop of additions and multiplications alone, in double
//! precision, and twice that in single.
//! Needs Python with `mujoco` for the comparison.
//!
//!     cargo bench -p flix-sim --bench batch

use std::time::Instant;

use flix_sim::batch::{Batch, Precision};
use flix_sim::model::RobotModel;
use flix_sim::model::mjcf::mjcf;
use flix_sim::plant::mechanics::lane::{Double, Lane};
use flix_sim::plant::mechanics::reference_contact;

#[path = "batch/counting.rs"]
mod counting;
#[path = "support/python.rs"]
mod python;

const THREADS: usize = 2;
const ROBOTS: usize = 2048;
const STEP: f64 = 1e-4;
const ROUNDS: usize = 3;

/// Rolls out robots of the exported model, each at its own theta, and prints steps a second.
const THEIRS: &str = include_str!("../python/flixwalker/_rollout.py");

fn main() {
    rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build_global()
        .expect("no pool was built before");
    let model = RobotModel::named("W").expect("shipped models are valid");
    let mut best = [0.0f64; 3];
    for _ in 0..ROUNDS {
        for (best, precision) in best.iter_mut().zip([Precision::Single, Precision::Double]) {
            *best = best.max(here(&model, precision));
        }
        best[2] = best[2].max(there(&model).unwrap_or(0.0));
    }
    let [single, double, theirs] = best;
    let peak = peak();
    let work = counting::operations_of_a_step(&model, STEP);
    println!("model W, 0.1 ms, {THREADS} threads, best of {ROUNDS}, {work:.0} operations a step");
    for (name, rate, peak) in
        [("single precision", single, 2.0 * peak), ("double precision", double, peak)]
    {
        println!(
            "{name}: {:.2} million steps/s, {:.0} % of the peak ({:.0} Gop/s)",
            1e-6 * rate,
            100.0 * rate * work / peak,
            1e-9 * peak
        );
    }
    if theirs > 0.0 {
        println!(
            "MuJoCo rollout: {theirs:.0} steps/s; single precision {:.0} times, double {:.0} times as many",
            single / theirs,
            double / theirs
        );
    }
}

/// Steps a second of all robots together.
fn here(model: &RobotModel, precision: Precision) -> f64 {
    const STEPS: usize = 1000;
    let mut batch =
        Batch::new(vec![model.clone(); ROBOTS], precision).expect("shipped models walk");
    for robot in 0..ROBOTS {
        batch.change(robot, |plant| plant.disturb(robot as u64, false)).expect("still the model");
        batch.set_drive(robot, 30.0, 3.0 * robot as f64 / ROBOTS as f64);
    }
    batch.run(1000, STEP);
    let start = Instant::now();
    batch.run(STEPS, STEP);
    (ROBOTS * STEPS) as f64 / start.elapsed().as_secs_f64()
}

fn there(model: &RobotModel) -> Option<f64> {
    let path = std::env::temp_dir().join(format!("flix-bench-{}.xml", std::process::id()));
    std::fs::write(&path, mjcf(model, STEP, reference_contact(model))).ok()?;
    let arguments = [THREADS.to_string(), "64".to_owned(), "1000".to_owned()];
    let number = python::number(THEIRS, &path, &arguments);
    let _ = std::fs::remove_file(&path);
    number
}

/// Additions and multiplications a second of all threads together, eight independent chains each.
fn peak() -> f64 {
    struct Chains([Double; 8]);
    impl pulp::NullaryFnOnce for Chains {
        type Output = [Double; 8];
        #[inline(always)]
        fn call(self) -> [Double; 8] {
            let (a, b) = (Double::splat(0.999), Double::splat(1e-3));
            let mut x = self.0;
            for _ in 0..CHAIN {
                for x in &mut x {
                    *x = *x * a + b;
                }
            }
            x
        }
    }
    const CHAIN: usize = 20_000_000;
    let start = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                let chains = core::array::from_fn(|i| Double::splat(i as f64));
                std::hint::black_box(pulp::Arch::new().dispatch(Chains(chains)));
            });
        }
    });
    (THREADS * CHAIN * 8 * 2 * Double::LANES) as f64 / start.elapsed().as_secs_f64()
}
