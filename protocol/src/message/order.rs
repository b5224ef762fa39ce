//! Orders and permits. An order states everything that an operator wants of the robot now; its permit proves that the operator
//! has seen the robot's last halt.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::names::names;
use super::setpoint::Setpoint;
use super::trial::Trial;

/// A number that the robot counts up at every [`Halt`] and states in telemetry. An order that begins movement, or clears a stop
/// or a fault, carries the permit that its operator was shown, and counts only while that is the present one.
///
/// Permits are compared for equality alone. A permit belongs to one session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct Permit(u32);

impl Permit {
    /// Returns the permit with this number.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self(number)
    }

    /// Returns the permit that the robot counts up to at its next halt.
    #[must_use]
    #[inline]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// Returns the number.
    #[must_use]
    pub const fn number(self) -> u32 {
        self.0
    }
}

/// Everything that an operator wants of the robot now. The operator's program repeats the order every 20 ms as its sign of life;
/// only the newest order of a session counts. [`Order::Off`] and [`Order::Stop`] need no permit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, Schema)]
pub enum Order {
    /// Disarm, and stay disarmed. The default.
    #[default]
    Off,
    /// Align the motors where needed, then hold the rotors at rest.
    Arm(Permit),
    /// Shake with this pair; f may be 0. Never arms.
    Shake(Permit, Setpoint),
    /// Do one trial. The robot is disarmed before and after.
    Try(Permit, Trial),
    /// Forget the latched stop and every latched fault whose cause is gone, at rest.
    Clear(Permit),
    /// Ramp down, and stay stopped until [`Order::Clear`].
    Stop,
}

impl Order {
    /// Returns the permit that the order carries; `None` for [`Order::Off`] and [`Order::Stop`], which need none.
    #[must_use]
    pub const fn permit(&self) -> Option<Permit> {
        match self {
            Self::Off | Self::Stop => None,
            Self::Arm(permit)
            | Self::Shake(permit, _)
            | Self::Try(permit, _)
            | Self::Clear(permit) => Some(*permit),
        }
    }

    /// Returns the same order with this permit, where the order carries any.
    #[must_use]
    pub const fn with_permit(self, permit: Permit) -> Self {
        match self {
            Self::Off | Self::Stop => self,
            Self::Arm(_) => Self::Arm(permit),
            Self::Shake(_, setpoint) => Self::Shake(permit, setpoint),
            Self::Try(_, trial) => Self::Try(permit, trial),
            Self::Clear(_) => Self::Clear(permit),
        }
    }
}

/// Why the robot counted its permit up: it came to rest, or must not go on, without an order of this operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub enum Halt {
    /// The robot started.
    #[default]
    Started,
    /// A session began or ended.
    Operator,
    /// The motors are aligned, and the robot is armed.
    Aligned,
    /// A trial ended.
    Tried,
    /// The rotors came to rest because orders stayed away or were too old, or were not seen to come to rest.
    Rested,
    /// No order came for so long that the motors were disarmed.
    LinkLost,
    /// Orders stayed away, or were too old, while the motors were aligned or tried: they brake.
    LetGo,
    /// A fault was latched.
    Fault,
    /// An operator stopped the robot without the session.
    StoppedFromOutside,
}

names!(Halt {
    Started: "the robot started",
    Operator: "a session began or ended",
    Aligned: "the motors are aligned",
    Tried: "a trial ended",
    Rested: "the rotors came to rest because commands stayed away",
    LinkLost: "the link was lost",
    LetGo: "commands stayed away while the motors were aligned",
    Fault: "a fault was latched",
    StoppedFromOutside: "the robot was stopped from outside",
});

/// Why the robot does not obey the newest order that has arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Withheld {
    /// Its permit is not the present one: the robot has halted since.
    Permit,
    /// The state of the supervisor does not allow it.
    State,
    /// A fault is latched.
    Faulted,
    /// A stop is latched.
    Stopped,
    /// The link has not been steady for long enough to begin.
    LinkUnproven,
    /// The settings are assumed or unstable; `ParameterCommand::Check` is answered with the reason.
    Settings,
    /// The order was too old when it arrived.
    Late {
        /// Its age, milliseconds; `u16::MAX` when it was older than the robot remembers.
        age_ms: u16,
        /// The largest age at which it counts, milliseconds.
        limit_ms: u16,
    },
    /// A value is out of range.
    Range,
    /// The board measures no phase currents, so that nothing bounds a trial.
    NoCurrentSense,
}
