//! Deadlines of the failsafe and the battery warning of a new robot, shared by robot, operator and tests. The firmware's
//! `fast/supervisor.rs` applies the deadlines, and its `link.rs` the rules for arming.
//!
//! A rotor turns for at most [`LONGEST_MOVEMENT`] after its operator's last intent to move, on any network: the command age plus
//! the ramp down. Both are settings, so the robot arms only while their sum stays within the limit
//! ([`longest_command_age`]).
//!
//! Silence counts from the last valid command. moteus stops after 0.1 s, Crazyflie after 0.5 and
//! 2 s, PX4's offboard mode after 1 s; Betaflight holds for 0.3 s and drops after 1.5 s.

use core::time::Duration;

/// Silence after which the operator is warned: five missed commands at 50 Hz.
pub const LINK_LATE: Duration = Duration::from_millis(100);
/// Silence after which both rotors ramp down: a person's reaction time.
pub const COMMAND_DEADLINE: Duration = Duration::from_millis(250);
/// Age after which a command no longer counts and both rotors ramp down, unless the robot's settings
/// say otherwise: a link of 100 ms each way with losses stays below it.
pub const COMMAND_AGE: Duration = Duration::from_millis(400);
/// [`COMMAND_AGE`] in seconds, as the robot's setting has it.
pub const COMMAND_AGE_SECONDS: f32 = COMMAND_AGE.as_millis() as f32 / 1e3;
/// Longest time for which a rotor turns after its operator's last intent to move.
pub const LONGEST_MOVEMENT: Duration = Duration::from_millis(850);
/// Time of a ramp down beside its steepest part: its slope builds up, and rest is approached exponentially. Measured on the
/// simulated robot, from 35 Hz.
const RAMP_ENDS_MS: u32 = 75;
/// Ramps down that take longer end by braking.
const LONGEST_RAMP_MS: u32 = 400;
/// Fastest shaking, mHz.
const FASTEST_MHZ: f32 = 35_000.0;
/// Slowest ramp down of a stop or a lost link, Hz/s. A lower setting `frequency_ramp` is overruled, because a ramp of more than
/// 0.4 s ends by braking.
pub const SLOWEST_RAMP: f32 = FASTEST_MHZ / (LONGEST_RAMP_MS - RAMP_ENDS_MS) as f32;

/// Returns the longest ramp down of a stop or a lost link at this `frequency_ramp`, Hz/s.
#[must_use]
pub fn ramp_down(frequency_ramp: f32) -> Duration {
    let ramp_ms = (FASTEST_MHZ / frequency_ramp.max(SLOWEST_RAMP)) as u32;
    Duration::from_millis((ramp_ms + RAMP_ENDS_MS).into())
}

/// Returns the longest `command_age` with which a robot arms at this `frequency_ramp`, Hz/s: [`LONGEST_MOVEMENT`] less the ramp
/// down.
#[must_use]
pub fn longest_command_age(frequency_ramp: f32) -> Duration {
    LONGEST_MOVEMENT.saturating_sub(ramp_down(frequency_ramp))
}

/// Silence after which the motors are disarmed: as in PX4's offboard mode.
pub const LINK_LOST: Duration = Duration::from_secs(1);
/// Time without a gap of [`LINK_LATE`] between commands that the robot asks for before it arms: twice [`COMMAND_DEADLINE`], as a
/// proof that the link can keep this deadline.
pub const PROVING_TIME: Duration = Duration::from_millis(500);
/// Bus voltage below which a new robot reports a low battery, volt: 3.3 V for each of three cells.
pub const BATTERY_LOW_VOLTS: f32 = 9.9;

/// Returns whether a robot arms with these settings `command_age`, s, counted in whole milliseconds, and `frequency_ramp`, Hz/s.
#[must_use]
pub fn arms_with(command_age: f32, frequency_ramp: f32) -> bool {
    let age = Duration::from_millis((command_age * 1e3 + 0.5) as u64);
    age <= longest_command_age(frequency_ramp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_age_of_commands_and_the_ramp_down_are_the_longest_movement_together() {
        for (ramp, age_ms) in
            [(200.0, 600), (1_000.0, 740), (150.0, 542), (108.0, 451), (107.0, 450), (1.0, 450)]
        {
            let age = longest_command_age(ramp);
            assert_eq!(age.as_millis(), age_ms, "{ramp} Hz/s");
            assert_eq!(age + ramp_down(ramp), LONGEST_MOVEMENT, "{ramp}");
            // In whole milliseconds, to the nearest.
            for (beyond, arms) in [(-100.0, true), (0.0, true), (0.4, true), (0.6, false)] {
                assert_eq!(arms_with((age_ms as f32 + beyond) / 1e3, ramp), arms, "{beyond} ms");
            }
        }
        for (age, arms) in [(f32::INFINITY, false), (f32::MAX, false), (-1.0, true)] {
            assert_eq!(arms_with(age, 200.0), arms, "{age} s");
        }
        for ramp in [0.0, 1.0, f32::NAN] {
            assert_eq!(ramp_down(ramp), Duration::from_millis(LONGEST_RAMP_MS.into()), "{ramp}");
        }
    }
}
