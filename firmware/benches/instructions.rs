//! Instructions of the fast loop on this machine, counted by callgrind (Debian: `valgrind`).
//!
//! `cargo bench -p flix-firmware --bench instructions` runs this program under valgrind, which
//! counts only inside [`whole_tick`] and [`current_loop`]. It guards against growth; what has to fit the robot's chip is
//! counted there, by `cargo xtask pil`. The whole tick is measured in closed
//! loop on the test bench's shaker: 10,000 ticks at 30 Hz with noisy sensors on a base that drives
//! back. The current loop runs over the 10,000 rows of `rows.rs`, made from a fixed seed.

#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs, reason = "a bench, not the robot")]

use std::process::{Command, ExitCode};

use flix_firmware::fast::foc::current::{CurrentLoop, Input, Model};
use flix_firmware::fast::foc::modulation::Bus;
use flix_firmware::hardware::{Actuation, Duty, Sensors};
use flix_protocol::units::Instant;

// The shaker of the unit tests names the library `crate`.
pub(crate) use flix_firmware::{fast, hardware, settings};

#[path = "../src/fast/control/bench.rs"]
#[expect(dead_code, reason = "the unit tests use the rest of it")]
mod bench;
#[path = "../tests/support/rows.rs"]
mod rows;

/// Ticks that are counted.
const TICKS: usize = 10_000;
/// Most instructions of a whole tick, both motors, supervision included: what it took in November 2026, and 1 %.
const TICK_LIMIT: f64 = 1_256.0;
/// Most instructions from Clarke to duties, one motor, found alike.
const PATH_LIMIT: f64 = 366.0;

#[inline(never)]
fn whole_tick(
    control: &mut fast::control::Control,
    now: Instant,
    sensors: &Sensors,
    asked: &fast::exchange::Asked,
) -> Actuation {
    control.tick(now, sensors, asked)
}

#[inline(never)]
fn current_loop(state: &mut CurrentLoop, model: &Model, bus: &Bus, input: &Input) -> [Duty; 3] {
    state.update(model, bus, input)
}

fn run_ticks() {
    let mut bench = bench::Bench::new(Some(0.35));
    bench.arm();
    bench.command(30.0, 30.0);
    bench.run(0.5);
    for _ in 0..TICKS {
        bench.tick_with(whole_tick);
    }
    let held = bench.hold(30.0, 30.0, 0.1);
    assert!(held.direction < 1.0, "the measured ticks held theta: {held:?}");
}

fn run_rows() {
    let (model, bus, mut state) = (rows::model(), rows::bus(), CurrentLoop::default());
    let mut sum = 0_u64;
    for input in rows::rows() {
        let duties = current_loop(&mut state, &model, &bus, &input);
        sum += duties.iter().map(|duty| u64::from(duty.raw())).sum::<u64>();
    }
    assert!(sum > 0);
}

/// Instructions that this program spends inside `function` when asked to `run` it.
fn count(run: &str, function: &str) -> Result<u64, String> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--collect-atstart=no", "--callgrind-out-file=/dev/null"])
        .arg(format!("--toggle-collect=*::{function}*"))
        .arg(program)
        .args(["--run", run])
        .output()
        .map_err(|error| format!("valgrind cannot be started ({error}): install it"))?;
    let text = String::from_utf8_lossy(&output.stderr);
    let collected = text.lines().find_map(|line| line.split("Collected :").nth(1));
    collected
        .and_then(|number| number.trim().parse().ok())
        .filter(|_| output.status.success())
        .ok_or_else(|| format!("valgrind failed:\n{text}"))
}

fn measure() -> Result<bool, String> {
    let tick = count("ticks", "whole_tick")? as f64 / TICKS as f64;
    let path = count("rows", "current_loop")? as f64 / rows::COUNT as f64;
    println!("whole tick, both motors:            {tick:7.1} instructions (at most {TICK_LIMIT})");
    println!("Clarke to duties, one motor:        {path:7.1} instructions (at most {PATH_LIMIT})");
    Ok(tick <= TICK_LIMIT && path <= PATH_LIMIT)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    if has("--run") {
        if has("ticks") {
            run_ticks()
        } else {
            run_rows()
        }
        return ExitCode::SUCCESS;
    }
    if !has("--bench") {
        return ExitCode::SUCCESS;
    }
    match measure() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::FAILURE
        }
    }
}
