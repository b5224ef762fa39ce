//! Time of one step of 0.1 ms, one thread.
//!
//!     cargo bench -p flix-sim --bench plant

use criterion::{Criterion, criterion_group, criterion_main};
use flix_sim::model::RobotModel;
use flix_sim::plant::{Drive, Mechanics, Plant};

fn steps(c: &mut Criterion) {
    for (name, model) in [
        ("a shaker on a stand", "bench-fixed"),
        ("a shaker that slides", "bench-planar"),
        ("model A, 30 Hz, 30 degrees", "A"),
        ("model W, 30 Hz, 30 degrees", "W"),
    ] {
        let model = RobotModel::named(model).expect("shipped models are valid");
        let mut plant = Plant::new(&model).expect("shipped models are valid");
        plant.set_drive(Drive::Ideal { frequency_hz: 30.0, theta_rad: 30f64.to_radians() });
        c.bench_function(name, |b| {
            b.iter(|| plant.step([0.0; 2], 1e-4).expect("a walk does not diverge"));
        });
    }
}

criterion_group!(benches, steps);
criterion_main!(benches);
