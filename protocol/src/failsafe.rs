//! What happens to a robot whose commands stay away, and from which battery voltage it warns: the
//! figures that robot, operator and tests share.
//!
//! Silence counts from the last valid command. moteus stops after 0.1 s, Crazyflie after 0.5 and
//! 2 s, PX4's offboard mode after 1 s; Betaflight holds for 0.3 s and drops after 1.5 s.

use core::time::Duration;

/// Silence after which the operator is warned: two missed commands at 20 Hz.
pub const LINK_LATE: Duration = Duration::from_millis(100);
/// Silence after which both rotors ramp down: a person's reaction time.
pub const COMMAND_DEADLINE: Duration = Duration::from_millis(250);
/// Age after which a command no longer counts and both rotors ramp down, unless the robot's settings
/// say otherwise: a link of 100 ms each way with losses stays below it.
pub const COMMAND_AGE: Duration = Duration::from_millis(400);
/// [`COMMAND_AGE`] in seconds, as the robot's setting has it.
pub const COMMAND_AGE_SECONDS: f32 = COMMAND_AGE.as_millis() as f32 / 1e3;
/// Silence after which the motors are disarmed: as in PX4's offboard mode.
pub const LINK_LOST: Duration = Duration::from_secs(1);
/// For how long commands must have come without a gap of [`LINK_LATE`] before the robot arms: twice
/// [`COMMAND_DEADLINE`], so that whoever arms has shown that the link can keep it.
pub const PROVING_TIME: Duration = Duration::from_millis(500);
/// Bus voltage below which a new robot reports a low battery, volt: 3.3 V for each of three cells.
pub const BATTERY_LOW_VOLTS: f32 = 9.9;
