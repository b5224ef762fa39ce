//! The key of a WPA2 network, derived from its pass phrase in slices.
//!
//! ```text
//! key = PBKDF2-HMAC-SHA1(pass phrase, network's name, 4096 rounds), 256 bits     IEEE 802.11-2020, J.4.1
//!     = T_1 | T_2,   T_i = U_1 ^ ... ^ U_4096,   U_1 = HMAC(name | i),   U_n = HMAC(U_{n-1})
//! ```
//!
//! All of it takes a small processor a second or so, so [`NetworkKey::advance`] does as many rounds as the caller has
//! time for. The result is handed to a radio as 64 hexadecimal digits, from which it derives nothing more.

use heapless::{String, Vec};
use hmac::{Hmac, KeyInit, Mac};
use sha1::Sha1;
use zeroize::{Zeroize, Zeroizing};

/// Longest network name, bytes (IEEE 802.11).
pub const NETWORK_LENGTH: usize = 32;
/// Longest network password, bytes (WPA2: 63 characters; 64 hexadecimal digits for a raw key).
pub const PASSWORD_LENGTH: usize = 64;
/// Rounds of each block (IEEE 802.11-2020, J.4.1).
pub const ROUNDS: u32 = 4096;
/// Blocks of SHA-1 that make up a key.
pub const BLOCKS: u32 = KEY_BYTES.div_ceil(BLOCK_BYTES) as u32;

/// A key has 256 bits.
const KEY_BYTES: usize = 32;
/// Length of a hash by SHA-1.
const BLOCK_BYTES: usize = 20;
/// Each byte is two digits.
const DIGITS: &[u8; 16] = b"0123456789abcdef";
const _: () = assert!(2 * KEY_BYTES == PASSWORD_LENGTH);

/// A key as hexadecimal digits. Wiped from memory when dropped.
pub type KeyDigits = Zeroizing<String<PASSWORD_LENGTH>>;

/// Returns whether a network's password is a key already: 64 hexadecimal digits.
#[must_use]
pub fn is_key(password: &str) -> bool {
    password.len() == PASSWORD_LENGTH && password.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// A derivation that is under way. Wiped from memory when dropped.
pub struct NetworkKey {
    /// HMAC with the pass phrase as its key.
    mac: Hmac<Sha1>,
    /// `U_n` of the present block.
    last: [u8; BLOCK_BYTES],
    /// The exclusive or of those before, and of this one.
    sum: [u8; BLOCK_BYTES],
    /// Rounds done of the present block.
    rounds: u32,
    /// Number of the present block, from 1.
    block: u32,
    network: Vec<u8, NETWORK_LENGTH>,
    key: [u8; BLOCK_BYTES * BLOCKS as usize],
}

impl NetworkKey {
    /// Starts to derive the key of a network. A name that is longer than networks have is cut.
    ///
    /// # Panics
    /// Never: HMAC takes a key of any length.
    #[must_use]
    pub fn new(network: &[u8], passphrase: &str) -> Self {
        let mac =
            Hmac::new_from_slice(passphrase.as_bytes()).expect("HMAC takes a key of any length");
        let longest = network.len().min(NETWORK_LENGTH);
        let name = Vec::from_slice(&network[..longest]).unwrap_or_default();
        let mut derivation = Self {
            mac,
            last: [0; BLOCK_BYTES],
            sum: [0; BLOCK_BYTES],
            rounds: 0,
            block: 1,
            network: name,
            key: [0; BLOCK_BYTES * BLOCKS as usize],
        };
        derivation.begin_block();
        derivation
    }

    fn begin_block(&mut self) {
        let mac = self.mac.clone().chain_update(&self.network);
        self.last = mac.chain_update(self.block.to_be_bytes()).finalize().into_bytes().into();
        self.sum = self.last;
        self.rounds = 1;
    }

    /// Does up to `rounds` more rounds; returns the key once all [`ROUNDS`] of all [`BLOCKS`] are done.
    #[must_use]
    pub fn advance(&mut self, rounds: u32) -> Option<KeyDigits> {
        for _ in 0..rounds {
            if self.block > BLOCKS {
                break;
            }
            self.round();
        }
        (self.block > BLOCKS).then(|| self.digits())
    }

    fn round(&mut self) {
        if self.rounds < ROUNDS {
            let mac = self.mac.clone().chain_update(self.last);
            self.last = mac.finalize().into_bytes().into();
            self.sum.iter_mut().zip(self.last).for_each(|(sum, byte)| *sum ^= byte);
            self.rounds += 1;
            return;
        }
        let from = (self.block as usize - 1) * BLOCK_BYTES;
        if let Some(place) = self.key.get_mut(from..from + BLOCK_BYTES) {
            place.copy_from_slice(&self.sum);
        }
        self.block += 1;
        if self.block <= BLOCKS {
            self.begin_block();
        }
    }

    fn digits(&self) -> KeyDigits {
        let mut digits = KeyDigits::default();
        for byte in &self.key[..KEY_BYTES] {
            for half in [byte >> 4, byte & 0x0f] {
                // Two digits a byte fit.
                let _ = digits.push(DIGITS[usize::from(half)].into());
            }
        }
        digits
    }
}

impl Drop for NetworkKey {
    fn drop(&mut self) {
        // The state of the HMAC wipes itself (feature `zeroize`).
        self.last.zeroize();
        self.sum.zeroize();
        self.key.zeroize();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::string::ToString;

    fn derive(network: &str, passphrase: &str, slice: u32) -> std::string::String {
        derive_bytes(network.as_bytes(), passphrase, slice)
    }

    fn derive_bytes(network: &[u8], passphrase: &str, slice: u32) -> std::string::String {
        let mut derivation = NetworkKey::new(network, passphrase);
        loop {
            if let Some(key) = derivation.advance(slice) {
                return key.as_str().to_string();
            }
        }
    }

    #[test]
    fn derives_the_keys_of_the_standard() {
        // IEEE 802.11-2020, J.4.2.
        for (passphrase, network, key) in [
            (
                "password",
                "IEEE",
                "f42c6fc52df0ebef9ebb4b90b38a5f902e83fe1b135a70e23aed762e9710a12e",
            ),
            (
                "ThisIsAPassword",
                "ThisIsASSID",
                "0dc0d6eb90555ed6419756b9a15ec3e3209b63df707dd508d14581f8982721af",
            ),
            (
                "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
                "ZZZZZZZZZZZZZZZZZZZZZZZZZZZZZZZZ",
                "becb93866bb8c3832cb777c2f559807c8c59afcb6eae734885001300a981cc62",
            ),
        ] {
            assert_eq!(derive(network, passphrase, u32::MAX), key);
        }
    }

    #[test]
    fn a_name_that_is_not_utf_8_has_a_key_of_its_own() {
        // Python: hashlib.pbkdf2_hmac("sha1", b"password", b"caf\xe9", 4096, 32).
        let key = "38932b16dd6adf8c322eee0c9c54a83497b16e566aff700495f046c5e5645ee8";
        assert_eq!(derive_bytes(b"caf\xe9", "password", u32::MAX), key);
    }

    #[test]
    fn slices_of_any_size_give_the_same_key() {
        let whole = derive("lab", "a pass phrase", u32::MAX);
        for slice in [1, 7, 64, ROUNDS, ROUNDS + 1] {
            assert_eq!(derive("lab", "a pass phrase", slice), whole);
        }
    }

    #[test]
    fn no_slice_does_more_rounds_than_it_is_given() {
        let mut derivation = NetworkKey::new(b"lab", "a pass phrase");
        let slices = (1..).find(|_| derivation.advance(64).is_some());
        assert_eq!(slices, Some((ROUNDS * BLOCKS).div_ceil(64)));
    }

    #[test]
    fn only_64_hexadecimal_digits_are_a_key() {
        let key = derive("lab", "a pass phrase", u32::MAX);
        assert!(is_key(&key));
        assert!(!is_key(&key[1..]) && !is_key(&key.replace(|c: char| c.is_ascii_digit(), "x")));
        assert!(!is_key("a pass phrase") && !is_key(""));
    }
}
