//! Plain words for the robot's reports, each with a remedy.

use flix_protocol::failsafe::{COMMAND_AGE, COMMAND_DEADLINE, LINK_LOST, LONGEST_MOVEMENT};
use flix_protocol::message::{Event, Fault, Magnet, Refusal, ResetReason, State};

/// Returns meaning and remedy of a fault.
#[must_use]
pub const fn fault(fault: Fault) -> &'static str {
    match fault {
        Fault::OverCurrent => {
            "a phase current was above the limit of the driver: look for a blocked rotor or a short circuit"
        }
        Fault::UnderVoltage => {
            "the battery is empty, or its connector is loose: charge it, look at it"
        }
        Fault::OverVoltage => {
            "the supply is above the limit of the driver: check the battery and the braking energy"
        }
        Fault::OverSpeed => {
            "a rotor turned faster than any command: check that its mass and magnet are tight"
        }
        Fault::EncoderLost => {
            "an angle sensor does not answer: check its cable and the magnet's distance"
        }
        Fault::Stall => "the rotor does not move at full current: free the rotor",
        Fault::PhaseLockLost => {
            "the rotors did not follow f and theta: is the battery connected? Free them, or ask for less"
        }
        Fault::LoopOverrun => "the processor was too slow: update the firmware, and report it",
        Fault::Alignment => {
            "a motor did not follow its alignment: is the battery connected and switched on? Then check the motor's phases, magnet and encoder"
        }
        Fault::CurrentSense => {
            "the current sensors disagree, or read far from zero at rest: are battery and motors connected? Then check the board"
        }
        Fault::Settings => {
            "the stored settings were unreadable and defaults are in force: import yours again, or measure the motors anew"
        }
        Fault::Shiver => {
            "a rotor shivers where it should rest: lower position_bandwidth, or raise tracker_bandwidth; are the motors as the settings say?"
        }
        Fault::BusSense => {
            "the battery's voltage is misread, or the battery left in the run: look at its connector, then at the board's voltage divider"
        }
    }
}

/// Returns the state of a magnet, with its remedy.
#[must_use]
pub const fn magnet(magnet: Magnet) -> &'static str {
    match magnet {
        Magnet::Good => "its magnet is good",
        Magnet::Weak => {
            "its magnet is too weak or too far away: bring it nearer, or take a stronger one"
        }
        Magnet::Strong => {
            "its magnet is too strong or too near: move it away, or take a weaker one"
        }
        Magnet::Missing => {
            "it finds no magnet: is there one above the sensor, magnetised across its axis?"
        }
    }
}

/// Returns the remedy for an accidental restart.
#[must_use]
pub const fn reset(reset: &ResetReason) -> Option<&'static str> {
    match reset {
        ResetReason::BrownOut => {
            Some("charge the battery, and look at its leads and the board's supply")
        }
        reset if reset.is_accident() => {
            Some("a defect of the firmware: report it with what is shown here")
        }
        _ => None,
    }
}

/// Returns a state, with the motors' behaviour in it.
#[must_use]
pub const fn state(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed: the motors coast",
        State::Aligning => "aligning: finding the angles of the motors",
        State::Armed => "armed: holding the rotors at rest",
        State::Running => "running",
        State::Stopping => "stopping: both rotors ramp down",
        State::Faulted => "faulted: the motors are not driven",
    }
}

/// Returns the remedy for a refusal.
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
        Refusal::Rested => {
            "look that nobody is at the robot, then start again; `flix link-test` shows the link"
        }
        // The longest movement less the ramp down, which is below the setting's own maximum.
        Refusal::OutOfRange { name, maximum, .. }
            if name == "command_age" && *maximum < LONGEST_MOVEMENT.as_secs_f32() =>
        {
            return Some(format!(
                "with an older command and the setting frequency_ramp the rotors could turn for more than {} s after the \
                 last intent to move: `flix parameters set command_age {}`, and move nearer to the access point",
                LONGEST_MOVEMENT.as_secs_f64(),
                COMMAND_AGE.as_secs_f64()
            ));
        }
        Refusal::State(state) => blocking(*state),
        _ => return None,
    };
    Some(hint.to_owned())
}

/// Returns the remedy for a command that is refused in this state.
const fn blocking(state: State) -> &'static str {
    match state {
        State::Disarmed => "arm it first: `flix teleop` and `flix drive` do so",
        State::Aligning => "wait a second until the motors are aligned, then try again",
        State::Stopping => "wait a second until the rotors are at rest, then try again",
        State::Armed | State::Running => "disarm it first: `flix stop`, then `flix clear`",
        State::Faulted => "`flix status` shows the fault; `flix clear` clears it",
    }
}

/// Returns an event as a line of a log.
#[must_use]
pub fn event(event: &Event) -> String {
    match event {
        Event::Started => "the robot started".to_owned(),
        Event::State(state) => format!("{state}"),
        Event::Fault(kind) => format!("fault: {kind}: {}", fault(*kind)),
        Event::Cleared => "stop and faults cleared".to_owned(),
        Event::Stopped => "stopped, until cleared".to_owned(),
        Event::OperatorConnected(operator) => format!("{operator} connected"),
        Event::OperatorLeft => "the operator left".to_owned(),
        Event::LinkLate => "commands are late".to_owned(),
        Event::CommandDeadline => {
            format!("no commands for {} ms: the rotors come to rest", COMMAND_DEADLINE.as_millis())
        }
        Event::LinkLost => format!("no commands for {} s: disarmed", LINK_LOST.as_secs()),
        Event::CommandsLate { age_ms, limit_ms } => {
            Refusal::Late { age_ms: *age_ms, limit_ms: *limit_ms }.to_string()
        }
        Event::StoppedFromOutside(by) => format!("stopped by {by}, until cleared"),
        Event::CommandAge => "the newest command is too old: the rotors come to rest".to_owned(),
        Event::SettingsSaved => "settings saved".to_owned(),
        Event::SettingsDefaulted => {
            "stored settings could not be used: these have their defaults, which are assumed"
                .to_owned()
        }
        Event::BatteryLow(voltage) => format!("battery low: {:.1} V", voltage.get()),
        Event::Magnet { motor, magnet: found } => {
            let encoder = if *motor == 0 { "top" } else { "bottom" };
            format!("{encoder} encoder: {}", magnet(*found))
        }
        Event::FrequencyLimited(frequency) => {
            format!("f limited by voltage or current: {:.1} Hz", frequency.get())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_that_a_missing_battery_makes_name_the_battery() {
        for kind in [
            Fault::UnderVoltage,
            Fault::Alignment,
            Fault::CurrentSense,
            Fault::PhaseLockLost,
            Fault::BusSense,
        ] {
            assert!(fault(kind).contains("battery"), "{kind}");
        }
    }

    #[test]
    fn a_refusal_in_each_state_has_the_hint_of_that_state() {
        for (state, hint) in [
            (State::Disarmed, "arm it first"),
            (State::Aligning, "wait a second until the motors are aligned"),
            (State::Armed, "`flix stop`, then `flix clear`"),
            (State::Running, "`flix stop`, then `flix clear`"),
            (State::Stopping, "wait a second until the rotors are at rest"),
            (State::Faulted, "`flix clear` clears it"),
        ] {
            let found = refusal(&Refusal::State(state)).unwrap();
            assert!(found.contains(hint), "{state}: {found}");
        }
        let rested = refusal(&Refusal::Rested);
        assert!(rested.is_some_and(|hint| hint.contains("nobody is at the robot")));
    }

    #[test]
    fn an_age_of_commands_is_explained_where_the_robot_would_not_arm_and_not_outside_its_range() {
        let hint = |maximum| refusal(&Refusal::out_of_range("command_age", 0.1, maximum));
        assert!(
            hint(0.6).is_some_and(|hint| hint.contains("longer") || hint.contains("more than"))
        );
        assert_eq!((hint(LONGEST_MOVEMENT.as_secs_f32()), hint(1.0)), (None, None));
    }

    #[test]
    fn the_steps_of_the_failsafe_ladder_name_their_times() {
        assert_eq!(
            event(&Event::CommandDeadline),
            "no commands for 250 ms: the rotors come to rest"
        );
        assert_eq!(event(&Event::LinkLost), "no commands for 1 s: disarmed");
    }
}
