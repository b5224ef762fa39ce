//! A program that hangs or panics, and a supply that sags: the chip must start anew within a second, state why, and leave the motors alone.

use std::time::Duration;

use flix_host::link::{LinkError, RobotLink};
use flix_protocol::message::{Command, Outcome, ParameterCommand, ResetReason};
use serde::Serialize;

use crate::rig::{Rig, RigError};
use flix_esp32c6::chip::Place;
use flix_esp32c6::cycles;
use flix_esp32c6::flash::Operation;

/// From a hang or panic to the first instruction of the program that starts anew.
pub const LIMIT: Duration = Duration::from_secs(1);
/// Between two looks for the place, cycles.
const LOOK_CYCLES: u64 = 50;
/// A step of the plant and more; the program that starts anew has touched no pin by then.
const MOMENT: Duration = Duration::from_millis(1);
/// The store has room for fewer copies of the settings.
const SAVES: usize = 200;
/// By then the place has been found.
const SEARCH: Duration = Duration::from_secs(2);

/// What went wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Accident {
    /// An endless loop.
    Hang,
    /// An index out of bounds.
    Panic,
    /// A supply that sags for a moment.
    BrownOut,
}

/// An accident and what follows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Restart {
    /// What went wrong.
    pub accident: Accident,
    /// Where: before the loop, the loop, tasks.
    pub place: &'static str,
    /// Until the program runs again, s.
    pub seconds: Option<f64>,
    /// What it states as the reason, over the network as in its log.
    pub reason: String,
    /// What does not hold.
    pub failures: Vec<String>,
}

/// What [`Chip::panic`](flix_esp32c6::chip::Chip::panic) pretends.
const PANIC: &str = "a panic at emulated.rs:1";

const CASES: [(Accident, Place, &str, &str); 7] = [
    (Accident::Hang, Place::BeforeTheLoop, "before the fast loop", "tasks that hung"),
    (Accident::Hang, Place::Loop, "in the fast loop", "a fast loop that hung"),
    (Accident::Hang, Place::Tasks, "in the tasks", "tasks that hung"),
    (Accident::Panic, Place::BeforeTheLoop, "before the fast loop", PANIC),
    (Accident::Panic, Place::Loop, "in the fast loop", PANIC),
    (Accident::Panic, Place::Tasks, "in the tasks", PANIC),
    (Accident::BrownOut, Place::Tasks, "in the tasks", "a brown-out"),
];

/// Lets everything go wrong, one after the other. `rig` is provisioned and runs; it is armed for each that happens in a
/// running robot.
pub fn try_all(rig: &mut Rig, progress: &dyn Fn(&str)) -> Result<Vec<Restart>, RigError> {
    CASES
        .into_iter()
        .map(|(accident, place, name, reason)| {
            progress(&format!("{accident:?} {name}"));
            happen(rig, accident, place, name, reason)
        })
        .collect()
}

/// Saves the settings until a sector is erased for them, for which the fast loop's watchdog waits; then no longer.
fn erase(rig: &mut Rig) -> Result<(), RigError> {
    let from = rig.chip.flash().operations().len();
    for _ in 0..SAVES {
        rig.ask(Command::Parameter(ParameterCommand::Save))?;
        rig.run(MOMENT)?;
        let fresh = &rig.chip.flash().operations()[from..];
        if fresh.iter().any(|operation| matches!(operation, Operation::Erase { .. })) {
            return Ok(());
        }
    }
    Err(RigError::TooLate { awaited: "erasure of a sector" })
}

fn happen(
    rig: &mut Rig,
    accident: Accident,
    place: Place,
    name: &'static str,
    reason: &str,
) -> Result<Restart, RigError> {
    if place == Place::BeforeTheLoop {
        rig.is_alone = true;
        rig.chip.power_on();
    } else {
        rig.connect()?;
        if (accident, place) == (Accident::Hang, Place::Loop) {
            erase(rig)?;
        }
        rig.arm_uncommissioned()?;
    }
    let end = rig.chip.cycles() + cycles(SEARCH);
    while !rig.chip.is_in(place) {
        if rig.chip.cycles() > end {
            return Err(RigError::TooLate { awaited: "place of the program" });
        }
        rig.advance(LOOK_CYCLES)?;
    }
    let resets = rig.resets.len();
    let from = rig.serial.len();
    let began = rig.chip.now();
    match accident {
        Accident::Hang => rig.chip.hang(),
        Accident::BrownOut => rig.brown_out()?,
        Accident::Panic if rig.chip.panic() => {}
        Accident::Panic => return Err(RigError::Fault("the image cannot panic".to_owned())),
    }
    let mut restart = Restart {
        accident,
        place: name,
        seconds: None,
        reason: String::new(),
        failures: Vec::new(),
    };
    let mut fail =
        |failure: String| restart.failures.push(format!("{accident:?} {name}: {failure}"));
    if accident == Accident::Panic {
        rig.run(MOMENT)?;
        if rig.is_driven() {
            fail("a motor is driven while the reason is printed".to_owned());
        }
    }
    // A client that is not answered gives up by itself.
    rig.is_alone = true;
    while rig.resets.len() == resets && rig.chip.now() < began + 2 * LIMIT {
        rig.step()?;
    }
    match rig.resets.get(resets) {
        // Resets are noted when the program runs again.
        Some((at, _)) if *at - began <= LIMIT => {
            restart.seconds = Some((*at - began).as_secs_f64())
        }
        Some((at, _)) => {
            fail(format!("the chip starts anew after {:.2} s", (*at - began).as_secs_f64()))
        }
        None => fail("the chip does not start anew".to_owned()),
    }
    rig.run(MOMENT)?;
    if rig.is_driven() {
        fail("a motor is driven after it".to_owned());
    }
    rig.until_log("connection to the network", "wi-fi: connected")?;
    let log = String::from_utf8_lossy(&rig.serial[from..]).into_owned();
    let stated = log.lines().rev().find_map(|line| line.strip_prefix("started after "));
    restart.reason = stated.unwrap_or_default().trim().to_owned();
    rig.connect()?;
    let Outcome::Identity(identity) = rig.request(Command::Identify)? else {
        return Err(LinkError::OtherAnswer.into());
    };
    for failure in check_black_box(rig, accident, &identity.reset)? {
        restart.failures.push(format!("{accident:?} {name}: {failure}"));
    }
    rig.is_alone = true;
    if identity.reset.to_string() != reason {
        let failure = format!("the robot reports that it was {}, not {reason:?}", identity.reset);
        restart.failures.push(format!("{accident:?} {name}: {failure}"));
    }
    if restart.reason != reason {
        let failure = format!("the reason is stated as {:?}, not {reason:?}", restart.reason);
        restart.failures.push(format!("{accident:?} {name}: {failure}"));
    }
    Ok(restart)
}

/// Returns what the robot does not report of the accident as it should.
fn check_black_box(
    rig: &mut Rig,
    accident: Accident,
    reset: &ResetReason,
) -> Result<Vec<String>, RigError> {
    let crash = match rig.request(Command::Crash)? {
        Outcome::Crash(Some(crash)) => crash,
        Outcome::Crash(None) => return Ok(vec!["the robot kept nothing of it".to_owned()]),
        _ => return Err(LinkError::OtherAnswer.into()),
    };
    let panicked = accident == Accident::Panic;
    let promises = [
        (crash.reset == *reset, "another reason than that of the start"),
        (panicked == crash.message.starts_with("index out of bounds"), "another message"),
        (panicked != crash.counters.is_empty(), "no calls of a panic, or calls without one"),
        (crash.uptime.is_some(), "no time"),
        (!crash.version.is_empty(), "no version"),
    ];
    let broken = promises.into_iter().filter(|(holds, _)| !holds);
    Ok(broken.map(|(_, what)| format!("it kept {what}: {crash:?}")).collect())
}
