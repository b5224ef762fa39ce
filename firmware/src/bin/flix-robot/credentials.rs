//! What provisioning left in flash: the network, the robot's name, its key.

use core::net::Ipv4Addr;

use flix_protocol::session::Key;
use heapless::String;
use serde::{Deserialize, Serialize};

/// Longest stored form.
pub(crate) const STORED_LENGTH: usize = 256;

/// An address that does not come from DHCP.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct FixedAddress {
    /// The robot's.
    pub(crate) address: Ipv4Addr,
    /// Bits of the network's mask.
    pub(crate) prefix: u8,
    /// The way out, where there is one.
    pub(crate) gateway: Option<Ipv4Addr>,
}

/// As stored.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Credentials {
    /// Name of the Wi-Fi network.
    pub(crate) network: String<32>,
    /// Its password; empty for an open network.
    pub(crate) password: String<64>,
    /// What the robot is called.
    pub(crate) name: String<32>,
    /// What operators must have.
    pub(crate) key: [u8; 32],
    /// `None` asks DHCP.
    pub(crate) address: Option<FixedAddress>,
}

impl Credentials {
    /// Reads the stored form; `None` when it makes no sense.
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok()
    }

    /// The key; `None` for a place-holder.
    pub(crate) fn key(&self) -> Option<Key> {
        (self.key != [0; 32]).then(|| Key::new(self.key))
    }
}
