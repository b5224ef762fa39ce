//! What can go wrong, and what is promised then: the rows of the fault matrix.

use std::time::Duration;

use serde::Serialize;

use crate::plant::electronics::inverter::{Leg, Rail};
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault};
use crate::rig::lossy_network::{Bursts, ChannelParameters};
use crate::rig::simulated::Processor;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cause {
    /// The network, both ways.
    Link(ChannelParameters),
    /// The operator's clock shows so many seconds a second.
    Clock(f64),
    /// The robot.
    Hardware(HardwareFault),
}

/// What the robot makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Promise {
    /// f and theta are held.
    Holds,
    /// The rotors ramp down together, theta kept.
    RampsDown,
    /// The rotors come to rest.
    Rests,
    /// One of these: a robot on a stand that does not yield needs so little torque that it may turn on with a
    /// broken wire.
    HoldsOrRests,
}

/// A row of the matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// For people and for the snapshot.
    pub name: &'static str,
    /// What goes wrong.
    pub cause: Cause,
    /// For how long.
    pub lasts: Duration,
    /// How long after the onset the robot can know.
    pub knowable_after: Duration,
    /// Whether the board measures currents.
    pub senses_current: bool,
    /// What the robot makes of it.
    pub promise: Promise,
}

/// For good.
const STAYS: Duration = Duration::from_secs(3_600);
/// The robot knows that commands stay away, and are not merely late, once their deadline is over.
const DEADLINE: Duration = flix_protocol::failsafe::COMMAND_DEADLINE;
/// The network while nothing is wrong.
pub const WIFI: ChannelParameters = ChannelParameters::QUIET_WIFI;

const fn link(name: &'static str, network: ChannelParameters) -> Case {
    Case {
        name,
        cause: Cause::Link(network),
        lasts: STAYS,
        knowable_after: Duration::ZERO,
        senses_current: true,
        promise: Promise::Holds,
    }
}

const fn hardware(name: &'static str, fault: HardwareFault, promise: Promise) -> Case {
    Case {
        name,
        cause: Cause::Hardware(fault),
        lasts: STAYS,
        knowable_after: Duration::ZERO,
        senses_current: true,
        promise,
    }
}

const fn millis(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// All that goes wrong.
pub const CASES: [Case; 37] = [
    link("loss of 30 %", ChannelParameters { loss: 0.3, ..WIFI }),
    link(
        "bursts of 120 ms",
        ChannelParameters {
            bursts: Some(Bursts { length: millis(120), gap: millis(300) }),
            ..WIFI
        },
    ),
    link("delay of 150 ms", ChannelParameters { delay: millis(150), ..WIFI }),
    link("jitter of 100 ms", ChannelParameters { jitter: millis(100), ..WIFI }),
    link(
        "loss of 30 % and jitter of 100 ms",
        ChannelParameters { loss: 0.3, jitter: millis(100), ..WIFI },
    ),
    link("reordering of 30 %", ChannelParameters { reordering: 0.3, ..WIFI }),
    link("duplication of 50 %", ChannelParameters { duplication: 0.5, ..WIFI }),
    link("corruption of 30 %", ChannelParameters { corruption: 0.3, ..WIFI }),
    Case { lasts: millis(180), ..link("partition of 180 ms", ChannelParameters::CUT) },
    Case {
        knowable_after: DEADLINE,
        promise: Promise::RampsDown,
        ..link("partition", ChannelParameters::CUT)
    },
    Case { cause: Cause::Clock(1.05), ..link("operator's clock 5 % fast", WIFI) },
    Case { cause: Cause::Clock(0.95), ..link("operator's clock 5 % slow", WIFI) },
    hardware("top encoder stuck", HardwareFault::EncoderStuck(0), Promise::Rests),
    hardware("bottom encoder stuck", HardwareFault::EncoderStuck(1), Promise::Rests),
    hardware("top encoder lost", HardwareFault::EncoderLost(0), Promise::Rests),
    hardware("bottom encoder lost", HardwareFault::EncoderLost(1), Promise::Rests),
    Case {
        lasts: millis(2),
        ..hardware("top encoder lost for 2 ms", HardwareFault::EncoderLost(0), Promise::Holds)
    },
    hardware("encoders noisy by 0.2 degrees", HardwareFault::EncoderNoise(0.2), Promise::Holds),
    hardware("encoders noisy by 20 degrees", HardwareFault::EncoderNoise(20.0), Promise::Rests),
    hardware("top phase A open", HardwareFault::OpenPhase(0, 0), Promise::HoldsOrRests),
    hardware("bottom phase C open", HardwareFault::OpenPhase(1, 2), Promise::HoldsOrRests),
    hardware("top rotor held", HardwareFault::Jammed(0, 1.0), Promise::Rests),
    Case {
        senses_current: false,
        ..hardware(
            "bottom rotor held, no current sense",
            HardwareFault::Jammed(1, 1.0),
            Promise::Rests,
        )
    },
    Case {
        lasts: millis(200),
        ..hardware(
            "top bridge off for 200 ms",
            HardwareFault::BridgeShutDown(0),
            Promise::HoldsOrRests,
        )
    },
    Case {
        lasts: millis(200),
        senses_current: false,
        ..hardware(
            "bottom bridge off for 200 ms, no current sense",
            HardwareFault::BridgeShutDown(1),
            Promise::HoldsOrRests,
        )
    },
    hardware("current offset of 0.1 A", HardwareFault::CurrentOffset(0, 62), Promise::Holds),
    hardware("current offset of 1 A", HardwareFault::CurrentOffset(1, 620), Promise::Holds),
    hardware("bus sag of 1 V", HardwareFault::BusSag(1.0), Promise::HoldsOrRests),
    hardware("bus sag of 4 V", HardwareFault::BusSag(4.0), Promise::Rests),
    hardware(
        "top leg B short to the battery",
        HardwareFault::Leg(0, 1, Leg::Shorted(Rail::High)),
        Promise::Rests,
    ),
    hardware("divider's wire off", HardwareFault::BusReads(0.0), Promise::Rests),
    hardware("divider shows half", HardwareFault::BusReads(0.5), Promise::Rests),
    Case {
        senses_current: false,
        ..hardware("divider floats, no current sense", HardwareFault::BusFloats, Promise::Rests)
    },
    Case {
        senses_current: false,
        ..hardware(
            "bus misread now and then, no current sense",
            HardwareFault::BusOutliers(0.0),
            Promise::Holds,
        )
    },
    Case {
        knowable_after: DEADLINE,
        ..hardware(
            "network task stalls",
            HardwareFault::Processor(Processor::IsDeaf),
            Promise::RampsDown,
        )
    },
    Case {
        lasts: millis(5),
        ..hardware(
            "fast loop stalls for 5 ms",
            HardwareFault::Processor(Processor::Hangs),
            Promise::Rests,
        )
    },
    Case {
        lasts: BOOT_TIME,
        knowable_after: BOOT_TIME,
        ..hardware(
            "reboot in the middle of a run",
            HardwareFault::Processor(Processor::Restarts),
            Promise::Rests,
        )
    },
];
