//! The robot's nonces, which it need not store.

use core::net::{IpAddr, SocketAddr};

use super::COOKIE_EPOCH;
use super::key::{Entropy, HmacSha256, keyed, same, tag};
use crate::frame::Nonce;
use crate::units::Instant;

/// Makes nonces that need not be stored.
pub(super) struct Cookies(HmacSha256);

impl Cookies {
    /// Creates cookies with a new secret: all earlier nonces become invalid.
    pub(super) fn new(entropy: &mut Entropy) -> Self {
        Self(keyed(&entropy.secret()))
    }

    /// Returns the nonce for this peer and this client nonce now.
    pub(super) fn nonce(&self, now: Instant, peer: SocketAddr, client_nonce: &Nonce) -> Nonce {
        self.nonce_of(epoch(now), peer, client_nonce)
    }

    /// Returns the beginning of the epoch in which this nonce was made for this peer and this client
    /// nonce; `None` when it was not, or not within so many epochs, the present one among them. Each
    /// nonce is compared in constant time.
    pub(super) fn moment(
        &self,
        now: Instant,
        epochs: u32,
        peer: SocketAddr,
        client_nonce: &Nonce,
        robot_nonce: &Nonce,
    ) -> Option<Instant> {
        let present = epoch(now);
        let epoch = (present.saturating_sub(u64::from(epochs) - 1)..=present)
            .rev()
            .find(|&epoch| same(&self.nonce_of(epoch, peer, client_nonce), robot_nonce))?;
        Some(Instant::from_micros(epoch * COOKIE_EPOCH.as_micros() as u64))
    }

    fn nonce_of(&self, epoch: u64, peer: SocketAddr, client_nonce: &Nonce) -> Nonce {
        let address = match peer.ip() {
            IpAddr::V4(address) => address.to_ipv6_mapped(),
            IpAddr::V6(address) => address,
        };
        let (epoch, port) = (epoch.to_le_bytes(), peer.port().to_le_bytes());
        tag(&self.0, &[&epoch, &address.octets(), &port, client_nonce])
    }
}

/// Returns the number of the cookie's epoch.
const fn epoch(now: Instant) -> u64 {
    now.as_micros() / COOKIE_EPOCH.as_micros() as u64
}
