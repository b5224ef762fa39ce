//! Settings of the robot, by name.

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
    /// Return to the defaults, until power-off unless saved.
    Reset,
}

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
}
