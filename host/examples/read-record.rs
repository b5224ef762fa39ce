//! Reads the record of a run and prints its figures:
//!
//!     cargo run -p flix-host --example read-record -- out/runs/20261121-120000-home.mcap
//!
//! `flix track`, `flix home` and `flix-sim track` write such records.

use flix_host::record::Run;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("name the record of a run (MCAP)")?;
    let run = Run::read(file.as_ref())?;
    println!("{} s, {} poses, {} commands", run.seconds(), run.poses.len(), run.commands.len());
    for (name, value) in run.facts.get("results").into_iter().flatten() {
        println!("{name}: {value}");
    }
    let current = |motor: &flix_host::record::MotorRow| motor.current_d_a.hypot(motor.current_q_a);
    let currents = run.telemetry.iter().flat_map(|row| [current(&row.top), current(&row.bottom)]);
    println!("largest current: {:.2} A", currents.fold(0.0, f64::max));
    let poses: Vec<_> = run.poses.iter().filter(|row| row.valid).map(|row| row.pose).collect();
    let steps = poses
        .windows(2)
        .map(|pair| pair[0].on_the_floor().distance_to(pair[1].on_the_floor().position()));
    println!("way of the body, with its shaking: {:.2} m", steps.sum::<f64>());
    Ok(())
}
