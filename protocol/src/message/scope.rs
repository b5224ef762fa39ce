//! The scope: inner values of the fast loop, tick by tick, kept in the robot's memory until they are fetched.
//!
//! A ring of rows always runs; a row holds one value of each channel, once a tick. After its trigger the scope goes on
//! until the ring holds the wanted rows before and after the trigger, and then waits to be read. An operator's plan
//! with another trigger than a fault ends with the session: the robot then watches for faults again.

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::names::names;

/// Most channels of a capture.
pub const SCOPE_CHANNELS: usize = 8;
/// Values that the robot keeps: with all channels 240 ms, with one 1.92 s.
pub const SCOPE_VALUES: usize = 19_200;
/// Rows a second: one in every tick of the fast loop.
pub const SCOPE_RATE_HZ: u32 = 10_000;
/// Most values in one reply.
pub const SCOPE_VALUES_PER_REPLY: usize = 224;

/// A value that can be captured. Angles, speeds and q count clockwise seen from above, as f and theta do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Channel {
    /// Top motor: current that makes no torque.
    TopCurrentD,
    /// Bottom motor: current that makes no torque.
    BottomCurrentD,
    /// Top motor: current that makes torque.
    TopCurrentQ,
    /// Bottom motor: current that makes torque.
    BottomCurrentQ,
    /// Top motor: wanted current that makes torque.
    TopWantedQ,
    /// Bottom motor: wanted current that makes torque.
    BottomWantedQ,
    /// Top motor: voltage along its magnets.
    TopVoltageD,
    /// Bottom motor: voltage along its magnets.
    BottomVoltageD,
    /// Top motor: voltage across its magnets.
    TopVoltageQ,
    /// Bottom motor: voltage across its magnets.
    BottomVoltageQ,
    /// Top motor: current of phase A, as the amplifier shows it.
    TopPhaseA,
    /// Bottom motor: current of phase A, as the amplifier shows it.
    BottomPhaseA,
    /// Top motor: current of phase B, as the amplifier shows it.
    TopPhaseB,
    /// Bottom motor: current of phase B, as the amplifier shows it.
    BottomPhaseB,
    /// Top rotor: angle from forward.
    TopAngle,
    /// Bottom rotor: angle from forward.
    BottomAngle,
    /// Top rotor: speed.
    TopSpeed,
    /// Bottom rotor: speed.
    BottomSpeed,
    /// f as measured.
    Frequency,
    /// Reference of f.
    WantedFrequency,
    /// theta as measured.
    Theta,
    /// How far theta is ahead of its reference.
    ThetaError,
    /// Voltage of the battery side of the bridges.
    Bus,
}

names!(Channel {
    TopCurrentD: "top_id",
    BottomCurrentD: "bottom_id",
    TopCurrentQ: "top_iq",
    BottomCurrentQ: "bottom_iq",
    TopWantedQ: "top_iq_wanted",
    BottomWantedQ: "bottom_iq_wanted",
    TopVoltageD: "top_vd",
    BottomVoltageD: "bottom_vd",
    TopVoltageQ: "top_vq",
    BottomVoltageQ: "bottom_vq",
    TopPhaseA: "top_ia",
    BottomPhaseA: "bottom_ia",
    TopPhaseB: "top_ib",
    BottomPhaseB: "bottom_ib",
    TopAngle: "top_angle",
    BottomAngle: "bottom_angle",
    TopSpeed: "top_speed",
    BottomSpeed: "bottom_speed",
    Frequency: "f",
    WantedFrequency: "f_wanted",
    Theta: "theta",
    ThetaError: "theta_error",
    Bus: "bus",
});

/// Physical quantity of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// 2^-11 A, 16 A either way.
    Current,
    /// 2^-9 V, 64 V either way.
    Voltage,
    /// 2^-21 turn per tick: 0.00477 Hz, 156 Hz either way.
    Speed,
    /// 2^-16 turn: 0.0055 degrees, half a turn either way.
    Angle,
}

impl Quantity {
    /// Returns the symbol of the unit in which people read it.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Current => "A",
            Self::Voltage => "V",
            Self::Speed => "Hz",
            Self::Angle => "deg",
        }
    }

    /// Returns one count in [`Quantity::unit`].
    #[must_use]
    pub fn count(self) -> f64 {
        match self {
            Self::Current => 1.0 / 2_048.0,
            Self::Voltage => 1.0 / 512.0,
            Self::Speed => f64::from(SCOPE_RATE_HZ) / 2_097_152.0,
            Self::Angle => 360.0 / 65_536.0,
        }
    }
}

impl Channel {
    /// Returns the physical quantity of its values.
    #[must_use]
    pub const fn quantity(self) -> Quantity {
        match self {
            Self::TopCurrentD
            | Self::BottomCurrentD
            | Self::TopCurrentQ
            | Self::BottomCurrentQ
            | Self::TopWantedQ
            | Self::BottomWantedQ
            | Self::TopPhaseA
            | Self::BottomPhaseA
            | Self::TopPhaseB
            | Self::BottomPhaseB => Quantity::Current,
            Self::TopVoltageD
            | Self::BottomVoltageD
            | Self::TopVoltageQ
            | Self::BottomVoltageQ
            | Self::Bus => Quantity::Voltage,
            Self::TopSpeed | Self::BottomSpeed | Self::Frequency | Self::WantedFrequency => {
                Quantity::Speed
            }
            Self::TopAngle | Self::BottomAngle | Self::Theta | Self::ThetaError => Quantity::Angle,
        }
    }
}

/// Event at which a capture is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Trigger {
    /// Nothing: it captures at once.
    Now,
    /// A fault. Once the motors are driven again, it waits for the next.
    Fault,
    /// A channel crosses a level, once all rows before it are there.
    Level {
        /// Position of the channel in [`ScopePlan::channels`], from 0.
        channel: u8,
        /// The level, in counts of the channel.
        level: i16,
        /// Whether it is crossed upwards.
        rising: bool,
    },
    /// The pattern of a [`Trial`](super::Trial) begins; a turning field has its speed.
    Pattern,
}

/// Channels, trigger and rows of a capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ScopePlan {
    /// Channels, one value of each in a row; at least one.
    pub channels: Vec<Channel, SCOPE_CHANNELS>,
    /// Event at which the capture is taken.
    pub trigger: Trigger,
    /// Rows to keep from before the trigger; fewer than [`ScopePlan::rows`].
    pub before: u16,
}

impl ScopePlan {
    /// Returns the default plan: 200 ms before a fault and 40 ms after it.
    #[must_use]
    pub fn watch() -> Self {
        let channels = [
            Channel::TopCurrentQ,
            Channel::BottomCurrentQ,
            Channel::TopCurrentD,
            Channel::BottomCurrentD,
            Channel::Frequency,
            Channel::WantedFrequency,
            Channel::ThetaError,
            Channel::Bus,
        ];
        Self { channels: channels.into_iter().collect(), trigger: Trigger::Fault, before: 2_000 }
    }

    /// Returns how many rows the robot keeps; 0 without channels.
    #[must_use]
    pub fn rows(&self) -> u16 {
        SCOPE_VALUES.checked_div(self.channels.len()).unwrap_or(0) as u16
    }

    /// Returns whether it can be captured: it has channels, a level is of one of them, and the row of the trigger fits.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let is_known = match self.trigger {
            Trigger::Now | Trigger::Fault | Trigger::Pattern => true,
            Trigger::Level { channel, .. } => usize::from(channel) < self.channels.len(),
        };
        is_known && self.before < self.rows()
    }
}

/// A command to the scope.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ScopeCommand {
    /// Discard the present capture, and begin with this plan.
    Begin(ScopePlan),
    /// Report how far it is.
    Status,
    /// Return as many rows as fit one reply, from this one on; only of a capture that is complete.
    Read(u16),
}

/// How far a capture is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum ScopeState {
    /// It waits for its trigger.
    Waiting,
    /// The trigger has come; rows after it are being captured.
    Filling,
    /// It is complete, and can be read.
    Complete,
}

/// Plan and progress of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct ScopeStatus {
    /// Plan of the capture.
    pub plan: ScopePlan,
    /// How far it is.
    pub state: ScopeState,
    /// Rows there are.
    pub rows: u16,
    /// The row of the trigger among them, once it has come.
    pub trigger_row: u16,
    /// When it came, microseconds since the robot started.
    pub trigger_time_us: u64,
}

/// Consecutive rows of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct ScopeRows {
    /// The first of them; 0 is the oldest of the capture.
    pub first: u16,
    /// Values row by row, each an `i16` in two bytes, little-endian.
    pub values: Vec<u8, { 2 * SCOPE_VALUES_PER_REPLY }>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_watches_the_last_200_ms_before_a_fault() {
        let plan = ScopePlan::watch();
        assert!(plan.is_possible());
        assert_eq!(u32::from(plan.before) * 1_000 / SCOPE_RATE_HZ, 200);
        assert_eq!(u32::from(plan.rows() - plan.before) * 1_000 / SCOPE_RATE_HZ, 40);
    }

    #[test]
    fn a_plan_needs_channels_room_and_a_level_of_one_of_them() {
        let plan = ScopePlan::watch();
        let level = |channel| Trigger::Level { channel, level: 0, rising: true };
        assert!(ScopePlan { trigger: level(7), before: 2_399, ..plan.clone() }.is_possible());
        assert!(!ScopePlan { trigger: level(8), ..plan.clone() }.is_possible());
        assert!(!ScopePlan { before: 2_400, ..plan.clone() }.is_possible());
        assert!(!ScopePlan { channels: Vec::new(), before: 0, ..plan }.is_possible());
    }
}
