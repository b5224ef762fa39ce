//! What the robot reports, in plain words with what to do.

use flix_protocol::message::{Event, Fault, Refusal, State};

/// What a fault means and what to do about it.
#[must_use]
pub const fn fault(fault: Fault) -> &'static str {
    match fault {
        Fault::OverCurrent => {
            "a phase drew more current than the driver stands: look for a blocked rotor or a short"
        }
        Fault::UnderVoltage => "the battery is empty: charge it",
        Fault::OverVoltage => {
            "the supply is above what the driver stands: check the battery and braking energy"
        }
        Fault::OverSpeed => {
            "a rotor turned faster than any command: check that its mass and magnet are tight"
        }
        Fault::EncoderLost => {
            "an angle sensor does not answer: check its cable and the magnet's distance"
        }
        Fault::Stall => "full current and no movement: free the rotor",
        Fault::PhaseLockLost => "the rotors did not follow f and theta: free them, or ask for less",
        Fault::LoopOverrun => "the processor fell behind: update the firmware, and report it",
        Fault::Alignment => {
            "a motor did not follow its alignment: check its phases, magnet and encoder"
        }
        Fault::CurrentSense => {
            "the current sensors disagree, or read far from zero at rest: check the board"
        }
        Fault::Settings => {
            "the stored settings were unreadable and defaults are in force: import yours again"
        }
    }
}

/// A state as one says it.
#[must_use]
pub const fn state(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed: the motors are let go",
        State::Aligning => "aligning: finding the motors' angles",
        State::Armed => "armed: holding the rotors at rest",
        State::Running => "running",
        State::Stopping => "stopping: both rotors ramp down",
        State::Faulted => "faulted: the motors are not driven",
    }
}

/// What to do about a refusal, beyond what it says itself.
#[must_use]
pub fn refusal(refusal: &Refusal) -> Option<String> {
    let hint = match refusal {
        Refusal::Stopped => "`flix clear` makes the robot ready again",
        Refusal::Faulted(faults) => {
            return faults.iter().next().map(|first| {
                format!("{}; then `flix clear` makes the robot ready again", fault(first))
            });
        }
        Refusal::UnknownParameter => "`flix parameters list` shows all names",
        Refusal::State(_) => "disarm it first: `flix stop`, then `flix clear`",
        _ => return None,
    };
    Some(hint.to_owned())
}

/// An event as a line of a log.
#[must_use]
pub fn event(event: &Event) -> String {
    match event {
        Event::Started => "the robot started".to_owned(),
        Event::State(state) => format!("{state}"),
        Event::Fault(kind) => format!("fault: {kind}: {}", fault(*kind)),
        Event::Cleared => "stop and faults cleared".to_owned(),
        Event::Stopped => "stopped, until cleared".to_owned(),
        Event::OperatorConnected => "an operator connected".to_owned(),
        Event::OperatorLeft => "the operator left".to_owned(),
        Event::LinkLate => "commands are late".to_owned(),
        Event::CommandDeadline => "no commands for 250 ms: ramping down".to_owned(),
        Event::LinkLost => "no commands for 1 s: disarmed".to_owned(),
        Event::SettingsSaved => "settings saved".to_owned(),
        Event::SettingsDefaulted => "stored settings were damaged: defaults in force".to_owned(),
        Event::BatteryLow(voltage) => format!("battery low: {:.1} V", voltage.get()),
    }
}
