//! Settings of the robot, by name.

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::names::names;

/// Longest parameter name, in bytes.
pub const NAME_LENGTH: usize = 32;
/// A name on the wire.
pub type Name = String<NAME_LENGTH>;
/// Most parameter entries in one reply.
pub const PARAMETERS_PER_REPLY: usize = 4;

/// A command that reads or changes settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ParameterCommand {
    /// Read one setting.
    Get(Name),
    /// Change one setting, until power-off unless saved. Refused while the motors turn.
    Set(Name, f32),
    /// Read the settings from this index on, as many as fit one reply.
    List(u16),
    /// Store all settings in flash.
    Save,
    /// Return to the defaults, until power-off unless saved. The values of the motors then count as assumed.
    Reset,
    /// Change one setting as [`ParameterCommand::Set`] does, and say how its value is known. The mark of a setting that
    /// has none is ignored.
    Put(Name, f32, Mark),
    /// Take every assumed value as if it had been entered. A board that measures no currents does not take the
    /// resistance and the flux linkage of a motor in this way.
    Accept,
    /// Ask whether the robot would arm with these settings: it answers with the refusal that arming would get.
    Check,
}

/// How a value is known. A robot does not arm on assumed values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Mark {
    /// The default, or a value measured before a setting that it depends on was changed.
    Assumed,
    /// An operator entered it.
    Entered,
    /// Commissioning measured it.
    Measured,
}

// In the order of their numbers.
names!(Mark { Assumed: "assumed", Entered: "entered", Measured: "measured" });

/// A setting with its unit, range and default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Parameter {
    /// Position in the list, from 0.
    pub index: u16,
    /// For example `current_limit`.
    pub name: Name,
    /// Symbol of the unit, for example `A`.
    pub unit: String<8>,
    /// The present value.
    pub value: f32,
    /// The value of a new robot.
    pub default: f32,
    /// Smallest accepted value.
    pub minimum: f32,
    /// Largest accepted value.
    pub maximum: f32,
    /// Origin of a motor's value; `None` for other settings, except those whose stored value was unusable (then `Assumed`).
    pub mark: Option<Mark>,
}
