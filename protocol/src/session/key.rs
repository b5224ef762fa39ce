//! The pre-shared key, and everything that is derived from it.

use core::fmt;
use core::str::FromStr;

use hkdf::{Hkdf, HkdfExtract};
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use subtle::ConstantTimeEq;
use x25519_dalek::{X25519_BASEPOINT_BYTES, x25519};
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use super::VERSION;
use crate::frame::{KEY_ID_LENGTH, KeyId, Nonce, PublicKey, TAG_LENGTH, Tag};

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
/// The signed bytes begin with magic and kind, so no tag of one kind fits another. It keeps the key
/// alone, a sixth of the size of an HMAC state: a robot has two signers for each operator.
#[derive(Clone)]
pub(super) struct Signer(Zeroizing<[u8; 32]>);

impl Signer {
    /// Creates the signer of the handshake.
    pub(super) fn new(key: &Key) -> Self {
        Self::derive(key, b"flix handshake")
    }

    /// Creates the signer of a stop outside a session.
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

/// The secret half of an ephemeral key of X25519 (RFC 7748): made for one handshake, and wiped with it.
pub(super) struct EphemeralKey(Zeroizing<[u8; 32]>);

impl EphemeralKey {
    pub(super) fn new(entropy: &mut Entropy) -> Self {
        Self(entropy.secret())
    }

    /// Returns the public half.
    pub(super) fn public(&self) -> PublicKey {
        x25519(*self.0, X25519_BASEPOINT_BYTES)
    }

    /// Returns the shared secret of X25519; `None` for a public key of small order, which makes the secret zero (RFC 7748,
    /// section 6.1).
    pub(super) fn agree(&self, other: &PublicKey) -> Option<Zeroizing<[u8; 32]>> {
        let shared = Zeroizing::new(x25519(*self.0, *other));
        let is_zero: bool = shared.ct_eq(&[0; 32]).into();
        (!is_zero).then_some(shared)
    }
}

/// Keys and number of one session.
#[derive(Zeroize, ZeroizeOnDrop)]
pub(super) struct SessionKeys {
    pub(super) to_robot: [u8; 32],
    pub(super) to_operator: [u8; 32],
    /// Secret from which a renewal derives the next keys.
    pub(super) next: [u8; 32],
    pub(super) session: u32,
}

impl SessionKeys {
    /// Derives the first keys of a session. `publics` and `shared` are of its ephemeral keys.
    pub(super) fn first(
        key: &Key,
        nonces: [&Nonce; 2],
        publics: [&PublicKey; 2],
        shared: &[u8; 32],
    ) -> Self {
        Self::derive(nonces, &[&key.0, shared, publics[0], publics[1]])
    }

    /// Derives the keys that follow those with this `next`.
    pub(super) fn renewed(next: &[u8; 32], nonces: [&Nonce; 2]) -> Self {
        Self::derive(nonces, &[next])
    }

    /// Nonces and secrets have fixed lengths, so that none runs into another. The operator's come first.
    fn derive(nonces: [&Nonce; 2], secrets: &[&[u8; 32]]) -> Self {
        let mut salt = [0; 32];
        salt[..16].copy_from_slice(nonces[0]);
        salt[16..].copy_from_slice(nonces[1]);
        let mut extract = HkdfExtract::<Sha256>::new(Some(&salt));
        for secret in secrets {
            extract.input_ikm(*secret);
        }
        let (_, derivation) = extract.finalize();
        let mut keys = Self { to_robot: [0; 32], to_operator: [0; 32], next: [0; 32], session: 0 };
        expand(&derivation, &info(b'r'), &mut keys.to_robot);
        expand(&derivation, &info(b'o'), &mut keys.to_operator);
        expand(&derivation, &info(b'n'), &mut keys.next);
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

#[cfg(test)]
pub(super) mod tests {
    extern crate std;

    use super::*;

    /// Points of order 1, 2, 4 and 8, the last three in a form that is not reduced (D. J. Bernstein, "A state-of-the-art
    /// Diffie-Hellman function", "How do I validate Curve25519 public keys?").
    pub(in super::super) const SMALL_ORDER: [PublicKey; 7] = [
        [0; 32],
        with([0; 32], 1, 0),
        [
            0xe0, 0xeb, 0x7a, 0x7c, 0x3b, 0x41, 0xb8, 0xae, 0x16, 0x56, 0xe3, 0xfa, 0xf1, 0x9f,
            0xc4, 0x6a, 0xda, 0x09, 0x8d, 0xeb, 0x9c, 0x32, 0xb1, 0xfd, 0x86, 0x62, 0x05, 0x16,
            0x5f, 0x49, 0xb8, 0x00,
        ],
        [
            0x5f, 0x9c, 0x95, 0xbc, 0xa3, 0x50, 0x8c, 0x24, 0xb1, 0xd0, 0xb1, 0x55, 0x9c, 0x83,
            0xef, 0x5b, 0x04, 0x44, 0x5c, 0xc4, 0x58, 0x1c, 0x8e, 0x86, 0xd8, 0x22, 0x4e, 0xdd,
            0xd0, 0x9f, 0x11, 0x57,
        ],
        with([0xff; 32], 0xec, 0x7f),
        with([0xff; 32], 0xed, 0x7f),
        with([0xff; 32], 0xee, 0x7f),
    ];

    const fn with(mut bytes: PublicKey, first: u8, last: u8) -> PublicKey {
        (bytes[0], bytes[31]) = (first, last);
        bytes
    }

    fn ephemeral(seed: u8) -> EphemeralKey {
        EphemeralKey::new(&mut Entropy::new([seed; 32]))
    }

    #[test]
    fn two_ends_agree_and_a_third_does_not() {
        let [anna, bob, eve] = [1, 2, 3].map(ephemeral);
        let shared = anna.agree(&bob.public());
        assert_eq!(shared, bob.agree(&anna.public()));
        assert!(shared.is_some() && shared != eve.agree(&bob.public()));
    }

    #[test]
    fn no_secret_is_made_of_points_of_small_order() {
        assert_eq!(SMALL_ORDER.map(|public| ephemeral(1).agree(&public)), [const { None }; 7]);
    }

    /// Each input of a derivation is in every key that comes of it.
    #[test]
    fn keys_depend_on_each_secret_each_public_half_and_each_nonce() {
        let derive = |changed: Option<usize>| {
            let byte = |place| if changed == Some(place) { 9 } else { place as u8 };
            let nonces = [&[byte(0); 16], &[byte(1); 16]];
            let publics = [&[byte(2); 32], &[byte(3); 32]];
            let key = Key::new([byte(4); 32]);
            let first = SessionKeys::first(&key, nonces, publics, &[byte(5); 32]);
            let renewed = SessionKeys::renewed(&first.next, [&[byte(6); 16], &[byte(7); 16]]);
            [&first, &renewed].map(|keys| [keys.to_robot, keys.to_operator, keys.next])
        };
        let [first, renewed] = derive(None);
        for place in 0..8 {
            let [other, other_renewed] = derive(Some(place));
            for number in 0..3 {
                assert_eq!(first[number] != other[number], place < 6, "{place} in key {number}");
                assert_ne!(renewed[number], other_renewed[number], "{place} in key {number}");
            }
        }
        let all: std::collections::BTreeSet<_> = [first, renewed].into_iter().flatten().collect();
        assert_eq!(all.len(), 6, "no key is another");
    }
}
