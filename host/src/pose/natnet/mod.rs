//! OptiTrack: poses over NatNet, layouts 3.0 to 4.1, multicast and unicast.
//!
//! [`NatNetSource`] reads the stream of Motive (or of a simulated robot); [`NatNetServer`] makes
//! such a stream. Motive counts with y upwards unless it is told otherwise; [`UpAxis`] turns its
//! frame into ours and back.
//!
//! In Motive, make the rigid body while the robot faces along Motive's +x, so that the body's axes
//! are the robot's.

mod server;
mod source;

pub use server::{NatNetServer, ServerSettings};
pub use source::{
    Body, NatNetError, NatNetReading, NatNetSettings, NatNetSource, NatNetStatistics,
};

use std::fmt;
use std::net::Ipv4Addr;
use std::str::FromStr;

use super::Pose;

/// Where a server takes commands unless told otherwise (NatNet's default).
pub const COMMAND_PORT: u16 = 1510;
/// Where poses arrive unless the server says otherwise (NatNet's default).
pub const DATA_PORT: u16 = 1511;
/// NatNet's usual multicast group.
pub const MULTICAST_GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

/// Which of Motive's axes points to the ceiling (its streaming setting "Up Axis").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// Motive's own: x, y up, z. Our north is Motive's -z.
    #[default]
    Y,
    /// Already ours.
    Z,
}

impl UpAxis {
    /// Motive's position (m) and quaternion (x, y, z, w) as a pose of ours.
    #[must_use]
    pub fn to_pose(self, position: [f32; 3], orientation: [f32; 4]) -> Pose {
        let [x, y, z] = position.map(f64::from);
        let [qx, qy, qz, qw] = orientation.map(f64::from);
        match self {
            Self::Y => Pose { position: [x, -z, y], orientation: [qw, qx, -qz, qy] },
            Self::Z => Pose { position: [x, y, z], orientation: [qw, qx, qy, qz] },
        }
    }

    /// The inverse of [`UpAxis::to_pose`].
    #[must_use]
    pub fn from_pose(self, pose: &Pose) -> ([f32; 3], [f32; 4]) {
        let [x, y, z] = pose.position.map(|p| p as f32);
        let [w, qx, qy, qz] = pose.orientation.map(|q| q as f32);
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
                "\"{other}\" is no up axis: write y or z, as in Motive's streaming settings"
            )),
        }
    }
}

#[cfg(test)]
mod tests;
