//! OptiTrack: poses over NatNet, layouts 3.0 to 4.1, multicast and unicast. A newer server is asked for 4.1, by unicast.
//!
//! [`NatNetSource`] reads the stream of Motive (or of a simulated robot); [`NatNetServer`] sends
//! such a stream. Motive's frame has y up by default; [`UpAxis`] converts its frame to ENU and back.
//!
//! In Motive, create the rigid body while the robot faces along Motive's +x, so that the axes of the
//! body are those of the robot.

mod frames;
mod missing;
mod server;
mod source;

pub use frames::{NatNetReading, NatNetStatistics};
pub use server::{NatNetServer, ServerSettings};
pub use source::{Body, NatNetError, NatNetSettings, NatNetSource};

use std::fmt;
use std::net::Ipv4Addr;
use std::str::FromStr;

use super::Pose;

/// Default port of a server for commands.
pub const COMMAND_PORT: u16 = 1510;
/// Default port for poses.
pub(crate) const DATA_PORT: u16 = 1511;
/// Default multicast group.
pub(crate) const MULTICAST_GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

/// Motive's axis that points up (its streaming setting "Up Axis").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// Motive's default: y up. North is Motive's -z.
    #[default]
    Y,
    /// ENU already.
    Z,
}

impl UpAxis {
    /// Converts Motive's position (m) and quaternion (x, y, z, w) to a pose in our frame.
    #[must_use]
    pub fn to_pose(self, position: [f32; 3], orientation: [f32; 4]) -> Pose {
        let [x, y, z] = position.map(f64::from);
        let [qx, qy, qz, qw] = orientation.map(f64::from);
        match self {
            Self::Y => Pose { position: [x, -z, y].into(), orientation: [qw, qx, -qz, qy].into() },
            Self::Z => Pose { position: [x, y, z].into(), orientation: [qw, qx, qy, qz].into() },
        }
    }

    /// Converts a pose to Motive's frame: the inverse of [`UpAxis::to_pose`].
    #[must_use]
    pub fn from_pose(self, pose: &Pose) -> ([f32; 3], [f32; 4]) {
        let [x, y, z] = pose.position.coordinates().map(|p| p as f32);
        let [w, qx, qy, qz] = pose.orientation.components().map(|q| q as f32);
        match self {
            Self::Y => ([x, z, -y], [qx, qz, -qy, w]),
            Self::Z => ([x, y, z], [qx, qy, qz, w]),
        }
    }
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Y => "y",
            Self::Z => "z",
        })
    }
}

impl FromStr for UpAxis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "y" | "Y" => Ok(Self::Y),
            "z" | "Z" => Ok(Self::Z),
            other => Err(format!(
                "\"{other}\" is not an up axis: write y or z, as in Motive's streaming settings"
            )),
        }
    }
}

#[cfg(test)]
mod tests;
