//! A world without a page, commanded by a script.

use std::time::Duration;

use flix_host::teleop::page::pages::Pages;
use flix_protocol::units::Instant;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::world::{Options, Trouble, World};

/// The script that is run where no other is given: it arms, walks, turns, is pulled, loses datagrams, and stops.
pub const SCRIPT: &str = r#"[
    [0.3, {"do": "arm"}],
    [1.0, {"do": {"walk": "forward"}}],
    [5.0, {"do": {"walk": "left turn"}}],
    [6.5, {"pull": [0.1, 0.1]}],
    [7.0, {"pull": null}],
    [7.2, {"link": {"latency_ms": 20, "loss": 0.2}}],
    [8.0, {"do": {"walk": "strafe right"}}],
    [9.5, {"do": "stop"}]
]"#;
/// Interval at which the operator shows to be there.
const SIGN_OF_LIFE: Duration = Duration::from_millis(20);
/// Longest run, s.
const LONGEST: f64 = 3600.0;

/// Result of a script.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// SHA-256 of the plant's state after each tick.
    pub hash: String,
    /// Way of the robot from its start, m.
    pub moved: f64,
}

/// Runs a script for `seconds` of the robot's time, 0 to 3600. A script is a list of pairs: the time in seconds, rising,
/// and a line of the page, without the stamp in those of the cockpit.
///
/// # Errors
/// When it is no script, something in it cannot be done, or the plant diverges.
pub fn run(options: &Options, script: &str, seconds: f64) -> Result<Verdict, Trouble> {
    if !(0.0..=LONGEST).contains(&seconds) {
        return Err(Trouble::Sentence(format!("{seconds} s is out of range: 0 to {LONGEST}")));
    }
    let lines: Vec<(f64, Value)> = serde_json::from_str(script)?;
    let mut lines = lines.into_iter().peekable();
    let mut world = World::new(options)?;
    let mut hash = Sha256::new();
    let end = Instant::START + Duration::from_secs_f64(seconds);
    while world.now() < end {
        let now = world.now();
        let stamp = Pages::stamp(now);
        world.say(&json!({ "seen": stamp }).to_string())?;
        let time = now.since(Instant::START).as_secs_f64();
        while let Some((_, mut line)) = lines.next_if(|(at, _)| *at <= time) {
            if line.get("do").is_some() {
                line["seen"] = stamp.into();
            }
            world.say(&line.to_string())?;
        }
        world.advance(now + SIGN_OF_LIFE, |world| absorb(&mut hash, world))?;
    }
    let [x, y, _] = world.plant().body().position;
    let hash = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Verdict { hash, moved: x.hypot(y) })
}

/// Adds the bits of the plant's state.
fn absorb(hash: &mut Sha256, world: &World) {
    let truth = world.truth();
    let body = world.plant().body();
    let electrical = [truth.rotor_angle, truth.rotor_speed];
    let numbers = body
        .position
        .iter()
        .chain(&body.orientation)
        .chain(&body.velocity)
        .chain(&body.angular_velocity)
        .chain(electrical.iter().flatten())
        .chain(truth.phase_currents.iter().flatten())
        .chain([&truth.bus_voltage]);
    for number in numbers {
        hash.update(number.to_bits().to_le_bytes());
    }
    for leg in world.plant().legs().into_iter().flatten() {
        for number in leg.angles.iter().chain(&leg.speeds) {
            hash.update(number.to_bits().to_le_bytes());
        }
    }
}
