//! The pre-shared key, and everything that is derived from it.

use core::fmt;
use core::str::FromStr;

use hkdf::Hkdf;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use subtle::ConstantTimeEq;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use super::VERSION;
use crate::frame::{KEY_ID_LENGTH, KeyId, Nonce, TAG_LENGTH, Tag};

pub(super) type HmacSha256 = Hmac<Sha256>;

/// Characters in the text form of a key.
pub const KEY_TEXT_LENGTH: usize = 64;

/// The 256-bit key that robot and operator share.
///
/// Wiped from memory when dropped; `Debug` does not show it. Its text form, for key files, is 64
/// hexadecimal digits: [`Key::to_text`] and [`str::parse`].
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct Key([u8; 32]);

/// Text was refused as a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// Not 64 characters long; this many bytes.
    #[error("a key is {KEY_TEXT_LENGTH} hexadecimal digits, and this is {0} long")]
    Length(usize),
    /// Not a hexadecimal digit at this place, counted from 0.
    #[error("a key is {KEY_TEXT_LENGTH} hexadecimal digits, and character {} is not one", .0 + 1)]
    Digit(usize),
    /// All zeros: a place-holder, not a key.
    #[error("this key is all zeros: make a new one")]
    Zero,
}

impl Key {
    /// Makes a key from 32 bytes of a cryptographic random source.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns the bytes, for storage.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Returns the public identifier of this key, by which a robot finds it among its own. It reveals
    /// nothing else of the key.
    #[must_use]
    pub fn id(&self) -> KeyId {
        let mut id = [0; KEY_ID_LENGTH];
        expand(&Hkdf::new(None, &self.0), b"flix key id", &mut id);
        id
    }

    /// Returns the proof that its maker has this key and was asked with this challenge. It serves for
    /// provisioning alone.
    #[must_use]
    pub fn prove(&self, challenge: &Nonce) -> Tag {
        tag(&keyed(&Signer::derive(self, b"flix provision").0), &[challenge])
    }

    /// Returns whether this proves that its maker has this key and was asked with this challenge, in
    /// constant time.
    #[must_use]
    pub fn is_proved(&self, challenge: &Nonce, proof: &Tag) -> bool {
        same(&self.prove(challenge), proof)
    }

    /// Returns 64 lower-case hexadecimal digits (ASCII), wiped from memory when dropped.
    #[must_use]
    pub fn to_text(&self) -> Zeroizing<[u8; KEY_TEXT_LENGTH]> {
        const DIGITS: &[u8; 16] = b"0123456789abcdef";
        let mut text = Zeroizing::new([0; KEY_TEXT_LENGTH]);
        for (pair, byte) in text.chunks_exact_mut(2).zip(&self.0) {
            pair[0] = DIGITS[usize::from(byte >> 4)];
            pair[1] = DIGITS[usize::from(byte & 15)];
        }
        text
    }
}

impl FromStr for Key {
    type Err = KeyError;

    /// Reads 64 hexadecimal digits of either case; white space around them is ignored.
    fn from_str(text: &str) -> Result<Self, KeyError> {
        let text = text.trim().as_bytes();
        if text.len() != KEY_TEXT_LENGTH {
            return Err(KeyError::Length(text.len()));
        }
        let mut key = Self([0; 32]);
        for (place, &digit) in text.iter().enumerate() {
            let value = char::from(digit).to_digit(16).ok_or(KeyError::Digit(place))?;
            key.0[place / 2] = 16 * key.0[place / 2] + value as u8;
        }
        if key.0 == [0; 32] { Err(KeyError::Zero) } else { Ok(key) }
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(secret)")
    }
}

impl PartialEq for Key {
    /// Compares in constant time.
    fn eq(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }
}

impl Eq for Key {}

/// Returns the first 16 bytes of HMAC-SHA256 over the parts. `mac` has absorbed the key.
pub(super) fn tag(mac: &HmacSha256, parts: &[&[u8]]) -> Tag {
    let mut mac = mac.clone();
    for part in parts {
        mac.update(part);
    }
    let mut tag = [0; TAG_LENGTH];
    tag.copy_from_slice(&mac.finalize().into_bytes()[..TAG_LENGTH]);
    tag
}

/// Compares in constant time.
pub(super) fn same(left: &Tag, right: &Tag) -> bool {
    left.ct_eq(right).into()
}

/// Makes the tags of the handshake.
///
/// The signed bytes begin with magic and kind, so no tag of one kind fits another. It keeps the key alone, a sixth of
/// what HMAC takes once it has absorbed it: a robot has two of these for each operator.
#[derive(Clone)]
pub(super) struct Signer(Zeroizing<[u8; 32]>);

impl Signer {
    /// Creates what signs the handshake.
    pub(super) fn new(key: &Key) -> Self {
        Self::derive(key, b"flix handshake")
    }

    /// Creates what signs a stop outside a session.
    pub(super) fn for_stop(key: &Key) -> Self {
        Self::derive(key, b"flix stop")
    }

    fn derive(key: &Key, purpose: &[u8]) -> Self {
        let mut signing_key = Zeroizing::new([0; 32]);
        expand(&Hkdf::new(None, &key.0), purpose, &mut *signing_key);
        Self(signing_key)
    }

    /// Returns the tag over the datagram so far, the schema key of its sender, and context that the
    /// datagram does not carry.
    pub(super) fn tag(&self, signed: &[u8], context: &[&Nonce]) -> Tag {
        let schema_key = VERSION.schema_key.to_le_bytes();
        let [first, second] = [context.first(), context.get(1)]
            .map(|nonce| nonce.map_or(&[][..], |nonce| nonce.as_slice()));
        tag(&keyed(&self.0), &[signed, &schema_key, first, second])
    }

    /// Returns the tag of a refusal, which carries the version of its sender.
    pub(super) fn tag_any_version(&self, signed: &[u8]) -> Tag {
        tag(&keyed(&self.0), &[signed])
    }

    /// Returns whether the tag fits, in constant time.
    pub(super) fn verify(&self, signed: &[u8], context: &[&Nonce], claimed: &Tag) -> bool {
        same(&self.tag(signed, context), claimed)
    }
}

/// Returns HMAC-SHA256 that has absorbed this key.
pub(super) fn keyed(key: &[u8; 32]) -> HmacSha256 {
    HmacSha256::new_from_slice(key).expect("HMAC takes a key of any length")
}

fn expand(derivation: &Hkdf<Sha256>, info: &[u8], output: &mut [u8]) {
    derivation.expand(info, output).expect("HKDF-SHA256 gives up to 8160 bytes");
}

/// Keys and number of one session.
#[derive(Zeroize, ZeroizeOnDrop)]
pub(super) struct SessionKeys {
    pub(super) to_robot: [u8; 32],
    pub(super) to_operator: [u8; 32],
    pub(super) session: u32,
}

impl SessionKeys {
    pub(super) fn derive(key: &Key, client_nonce: &Nonce, robot_nonce: &Nonce) -> Self {
        let mut salt = [0; 32];
        salt[..16].copy_from_slice(client_nonce);
        salt[16..].copy_from_slice(robot_nonce);
        let derivation = Hkdf::new(Some(&salt), &key.0);
        let mut keys = Self { to_robot: [0; 32], to_operator: [0; 32], session: 0 };
        expand(&derivation, &info(b'r'), &mut keys.to_robot);
        expand(&derivation, &info(b'o'), &mut keys.to_operator);
        let mut session = [0; 4];
        expand(&derivation, &info(b's'), &mut session);
        keys.session = u32::from_le_bytes(session);
        keys
    }
}

/// Returns the HKDF info: `flix session `, purpose, schema key.
fn info(purpose: u8) -> [u8; 22] {
    let mut info = *b"flix session ?________";
    info[13] = purpose;
    info[14..].copy_from_slice(&VERSION.schema_key.to_le_bytes());
    info
}

/// A stream of secrets from one seed. Its state reveals nothing about earlier output.
#[derive(Zeroize, ZeroizeOnDrop)]
pub(super) struct Entropy([u8; 32]);

impl Entropy {
    pub(super) const fn new(seed: [u8; 32]) -> Self {
        Self(seed)
    }

    /// Returns 32 unpredictable bytes.
    pub(super) fn secret(&mut self) -> Zeroizing<[u8; 32]> {
        let derivation = Hkdf::new(None, &self.0);
        let mut secret = Zeroizing::new([0; 32]);
        expand(&derivation, b"flix secret", &mut *secret);
        expand(&derivation, b"flix entropy", &mut self.0);
        secret
    }

    /// Returns a fresh nonce.
    pub(super) fn nonce(&mut self) -> Nonce {
        let mut nonce = [0; 16];
        nonce.copy_from_slice(&self.secret()[..16]);
        nonce
    }
}
