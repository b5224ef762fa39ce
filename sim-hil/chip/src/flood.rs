//! Forged datagrams, many a second.

use std::time::Duration;

use flix_protocol::DEFAULT_PORT;
use rand::{Rng as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use flix_esp32c6::cycles;
use flix_esp32c6::network::{Datagram, Network};

/// Forged datagrams a second.
const FLOOD_HZ: u64 = 1_000;
/// The forger's port.
const FORGER_PORT: u16 = 50_000;
/// Bytes of a forged datagram: as long as a command's.
const FORGED_BYTES: usize = 64;
/// Somebody without the key, who sends datagrams of a right length and wrong content.
pub struct Flood {
    random: Xoshiro256PlusPlus,
    next: u64,
    /// Datagrams so far.
    pub sent: u64,
}

impl Flood {
    /// Creates one whose bytes follow from the seed.
    pub fn new(seed: u64) -> Self {
        Self { random: Xoshiro256PlusPlus::seed_from_u64(seed), next: 0, sent: 0 }
    }

    /// Sends what is due.
    pub(crate) fn send(&mut self, network: &mut Network, now: u64) {
        if now < self.next {
            return;
        }
        self.next = now.max(self.next) + cycles(Duration::from_secs(1)) / FLOOD_HZ;
        let mut payload = vec![0; FORGED_BYTES];
        self.random.fill_bytes(&mut payload);
        network.send_datagram(&Datagram { port: FORGER_PORT, payload }, DEFAULT_PORT, now);
        self.sent += 1;
    }
}
