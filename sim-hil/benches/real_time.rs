//! How much faster than real time one robot runs, its software, operator and plant included, on one core.
//!
//! Prints one line a base. The target is 20 times.

use std::time::{Duration, Instant};

use flix_host::link::RobotLink;
use flix_sim::rig::bench::{Base, bench, setpoint};

/// Virtual time that is timed, after a first stretch that warms up.
const STRETCH: Duration = Duration::from_secs(20);
/// The best of so many counts: other programs can only slow a run down.
const REPETITIONS: u32 = 3;

fn main() {
    for base in [Base::Fixed, Base::Free] {
        let mut operation = bench(base, 1).expect("a shipped model");
        operation.arm().expect("the robot arms");
        operation.want(setpoint(30.0, 30.0).expect("within the robot's range"));
        let mut run = || {
            let start = Instant::now();
            operation.run(STRETCH, |_| {}).expect("the plant does not diverge");
            STRETCH.as_secs_f64() / start.elapsed().as_secs_f64()
        };
        let best = (0..REPETITIONS).map(|_| run()).fold(0.0, f64::max);
        println!("{base} base: {best:.0} times real time");
    }
}
