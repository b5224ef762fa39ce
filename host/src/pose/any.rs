//! A source of poses of whatever kind.

use flix_protocol::units::Instant;

use super::natnet::NatNetSource;
use super::udp::UdpSource;
use super::{PoseError, PoseSample, PoseSource};
use crate::system::text::printable;

/// An open source of poses.
pub enum Poses {
    /// OptiTrack.
    NatNet(Box<NatNetSource>),
    /// Any tracker.
    Udp(Box<UdpSource>),
}

impl PoseSource for Poses {
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError> {
        match self {
            Self::NatNet(source) => source.poll(now),
            Self::Udp(source) => source.poll(now),
        }
    }
}

impl Poses {
    /// Returns whether the source may state poses in the plane alone, without a height.
    #[must_use]
    pub const fn is_planar(&self) -> bool {
        matches!(self, Self::Udp(_))
    }

    /// Returns the name of the source, for the record.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::NatNet(source) => {
                let info = source.server();
                let name = printable(&info.application_name);
                format!("{name} (NatNet {})", source.version())
            }
            Self::Udp(source) => source
                .address()
                .map_or_else(|_| "udp".to_owned(), |address| format!("udp {address}")),
        }
    }
}
