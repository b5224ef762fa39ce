//! Layout of the datagrams, in bytes.
//!
//! Every datagram begins with [`MAGIC`] and a kind. Integers are little-endian. A tag is 16 bytes:
//! the first half of an HMAC-SHA256 during the handshake, a Poly1305 tag afterwards.
//!
//! | kind | from | bytes | fields after magic and kind |
//! |---|---|---|---|
//! | 1 Hello | operator | 62 | version u16, schema key u64, client nonce 16, purpose u8, key identifier 8, zeros 7, tag |
//! | 2 Challenge | robot | 36 | robot nonce 16, tag |
//! | 3 Confirm | operator | 92 | client nonce 16, robot nonce 16, key identifier 8, ephemeral key 32, tag |
//! | 4 Accept | robot | 56 | session u32, ephemeral key 32, tag |
//! | 5 Refusal | robot | 47 | reason u8, version u16, schema key u64, client nonce 16, tag |
//! | 6 Sealed | both | 32 to 512 | session u32, counter u64, ciphertext, tag |
//! | 7 Stop | operator | 60 | client nonce 16, robot nonce 16, key identifier 8, tag |
//! | 8 Stopped | robot | 21 | at rest u8 (1 or 0), tag |
//! | 9 Renewal | operator | 56 | session u32, counter u64, ciphertext 24, tag |
//! | 9 Renewal | robot | 48 | session u32, counter u64, ciphertext 16, tag |
//! | 10 Held | robot | 52 | client nonce 16, name of the holder 16 or zeros where its key is that of the asker, tag |
//!
//! A sealed message of the operator begins with its echo ([`ECHO_LENGTH`] bytes): the number of the robot's newest sealed
//! datagram that the operator had seen in the session, 0 for the Accept alone.
//!
//! The first 14 bytes of Hello and the whole of Refusal are the same in every version, so that
//! ends of different versions can report that they differ. No answer is longer than the datagram
//! that it answers: the robot amplifies nothing.
//!
//! This module knows the layout only; [`crate::session`] defines meaning and protection of the datagrams. Parsing never panics
//! and never copies.

use core::ops::Range;

use heapless::Vec;

use crate::message::{OPERATOR_NAME_LENGTH, OperatorName};

/// Longest datagram, bytes.
pub const MAXIMUM_DATAGRAM: usize = 512;
/// A datagram.
pub type Frame = Vec<u8, MAXIMUM_DATAGRAM>;

/// Longest datagram of the handshake, bytes: Confirm.
pub const MAXIMUM_HANDSHAKE: usize = 92;
/// A datagram of the handshake.
pub type HandshakeFrame = Vec<u8, MAXIMUM_HANDSHAKE>;

/// First bytes of every datagram.
pub const MAGIC: [u8; 3] = *b"flx";

/// Bytes in a nonce of the handshake.
pub const NONCE_LENGTH: usize = 16;
/// Bytes in the identifier of a key.
pub const KEY_ID_LENGTH: usize = 8;
/// Bytes in the public half of an ephemeral key.
pub const PUBLIC_KEY_LENGTH: usize = 32;
/// Bytes in a tag.
pub const TAG_LENGTH: usize = 16;
/// Bytes of magic and kind, with which every datagram begins.
pub const HEAD: usize = MAGIC.len() + 1;
/// Place of the counter in a sealed datagram, behind head and session.
pub const SEALED_COUNTER: Range<usize> = HEAD + 4..HEAD + 4 + 8;
/// Bytes before the ciphertext of a sealed datagram: authenticated, not encrypted.
pub const SEALED_HEADER: usize = SEALED_COUNTER.end;
/// Longest plain message that fits a sealed datagram, bytes.
pub const MAXIMUM_MESSAGE: usize = MAXIMUM_DATAGRAM - SEALED_HEADER - TAG_LENGTH;

/// Bytes of the echo, with which every sealed message of an operator begins.
pub const ECHO_LENGTH: usize = 8;

/// Zeros in Hello. They make it longer than any answer, and leave it short enough for its tag to
/// take two rounds of SHA-256.
const HELLO_RESERVED: usize = 6;

/// A random number used once.
pub type Nonce = [u8; NONCE_LENGTH];
/// Public number that distinguishes the keys of one robot ([`Key::id`](crate::session::Key::id)).
pub type KeyId = [u8; KEY_ID_LENGTH];
/// Public half of an ephemeral key of X25519 (RFC 7748).
pub type PublicKey = [u8; PUBLIC_KEY_LENGTH];
/// Authentication tag: only a holder of the key can make it.
pub type Tag = [u8; TAG_LENGTH];

const HELLO: u8 = 1;
const CHALLENGE: u8 = 2;
const CONFIRM: u8 = 3;
const ACCEPT: u8 = 4;
const REFUSAL: u8 = 5;
/// Kind of a sealed datagram, whose length varies from [`SEALED_HEADER`] + [`TAG_LENGTH`] to
/// [`MAXIMUM_DATAGRAM`].
pub const SEALED: u8 = 6;
const STOP: u8 = 7;
const STOPPED: u8 = 8;
/// Kind of a sealed datagram that renews the keys of its session.
pub const RENEWAL: u8 = 9;
const HELD: u8 = 10;
/// A holder whose name is not stated: no name is all zeros.
const UNNAMED: [u8; OPERATOR_NAME_LENGTH] = [0; OPERATOR_NAME_LENGTH];

const VERSION_LENGTH: usize = 2 + 8;

/// Kind and length of each datagram of the handshake, bytes.
pub const HANDSHAKE_LENGTHS: [(u8, usize); 8] = [
    (
        HELLO,
        HEAD + VERSION_LENGTH + NONCE_LENGTH + 1 + KEY_ID_LENGTH + 1 + HELLO_RESERVED + TAG_LENGTH,
    ),
    (CHALLENGE, HEAD + NONCE_LENGTH + TAG_LENGTH),
    (CONFIRM, HEAD + 2 * NONCE_LENGTH + KEY_ID_LENGTH + PUBLIC_KEY_LENGTH + TAG_LENGTH),
    (ACCEPT, HEAD + 4 + PUBLIC_KEY_LENGTH + TAG_LENGTH),
    (REFUSAL, HEAD + 1 + VERSION_LENGTH + NONCE_LENGTH + TAG_LENGTH),
    (STOP, HEAD + 2 * NONCE_LENGTH + KEY_ID_LENGTH + 1 + TAG_LENGTH),
    (STOPPED, HEAD + 1 + TAG_LENGTH),
    (HELD, HEAD + NONCE_LENGTH + OPERATOR_NAME_LENGTH + TAG_LENGTH),
];

/// Purpose of a handshake, stated in its Hello.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Purpose {
    /// A session, to drive the robot.
    Drive = 0,
    /// One stop, without a session.
    Stop = 1,
}

impl Purpose {
    fn from_byte(byte: u8) -> Option<Self> {
        [Self::Drive, Self::Stop].into_iter().find(|purpose| *purpose as u8 == byte)
    }
}

/// Why the robot refuses a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum RefusalReason {
    /// The robot uses another version.
    Version = 1,
    /// The tag does not fit the robot's key.
    Key = 2,
    /// The robot has no key yet.
    Unprovisioned = 4,
}

impl RefusalReason {
    fn from_byte(byte: u8) -> Option<Self> {
        let all = [Self::Version, Self::Key, Self::Unprovisioned];
        all.into_iter().find(|reason| *reason as u8 == byte)
    }
}

/// Version number and schema hash of one end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Version {
    /// Incremented by hand when a meaning changes and the schema does not.
    pub number: u16,
    /// Hash over the schema of all messages.
    pub schema_key: u64,
}

/// The operator asks for a session or a stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello<'a> {
    /// Version of the operator.
    pub version: Version,
    /// Fresh nonce of the operator.
    pub client_nonce: Nonce,
    /// Purpose of the handshake; `None`: known to another version only.
    pub purpose: Option<Purpose>,
    /// The one of the robot's keys that it has.
    pub key_id: KeyId,
    /// All bytes that the tag covers.
    pub signed: &'a [u8],
    /// Tag over `signed`.
    pub tag: Tag,
}

/// The operator proves that it is present, and asks for a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Confirm<'a> {
    /// The nonce of Hello.
    pub client_nonce: Nonce,
    /// The nonce of Challenge.
    pub robot_nonce: Nonce,
    /// The key of Hello.
    pub key_id: KeyId,
    /// Ephemeral key of the operator.
    pub client_public: PublicKey,
    /// All bytes that the tag covers.
    pub signed: &'a [u8],
    /// Tag over `signed`.
    pub tag: Tag,
}

/// A message of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sealed<'a> {
    /// Whether it renews the keys of the session, and is no message.
    pub is_renewal: bool,
    /// Number of the session.
    pub session: u32,
    /// Number of the datagram: each sender counts up in each session.
    pub counter: u64,
    /// Header: authenticated, not encrypted.
    pub header: &'a [u8],
    /// Ciphertext.
    pub ciphertext: &'a [u8],
    /// Tag over header and ciphertext.
    pub tag: Tag,
}

/// The operator demands a stop, and proves that it is present.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stop<'a> {
    /// The nonce of Hello.
    pub client_nonce: Nonce,
    /// The nonce of Challenge.
    pub robot_nonce: Nonce,
    /// The key of Hello.
    pub key_id: KeyId,
    /// All bytes that the tag covers.
    pub signed: &'a [u8],
    /// Tag over `signed`.
    pub tag: Tag,
}

/// The fields of a datagram, as received: nothing in it is trusted yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Datagram<'a> {
    /// The operator asks for a session or a stop.
    Hello(Hello<'a>),
    /// The robot asks the operator to prove that it is present now.
    Challenge {
        /// The robot's cookie.
        robot_nonce: Nonce,
        /// The bytes that the tag covers, without those that both ends know.
        signed: &'a [u8],
        /// Tag over `signed` and the client nonce.
        tag: Tag,
    },
    /// The operator proves that it is present.
    Confirm(Confirm<'a>),
    /// The robot opens the session.
    Accept {
        /// Number of the session, repeated in each sealed datagram.
        session: u32,
        /// Ephemeral key of the robot.
        robot_public: PublicKey,
        /// The bytes that the tag covers, without those that both ends know.
        signed: &'a [u8],
        /// Tag over `signed` and the tag of Confirm.
        tag: Tag,
    },
    /// The robot refuses a session.
    Refusal {
        /// The reason.
        reason: RefusalReason,
        /// Version of the robot.
        version: Version,
        /// The nonce of the Hello or Confirm that is refused.
        client_nonce: Nonce,
        /// All bytes that the tag covers.
        signed: &'a [u8],
        /// Tag over `signed` with the robot's key; zeros where the two ends cannot hold one key.
        tag: Tag,
    },
    /// A message of a session.
    Sealed(Sealed<'a>),
    /// The operator demands a stop, and proves that it is present.
    Stop(Stop<'a>),
    /// The robot has latched the stop.
    Stopped {
        /// Whether its motors are not driven any more.
        at_rest: bool,
        /// The bytes that the tag covers, without those that both ends know.
        signed: &'a [u8],
        /// Tag over `signed` and both nonces.
        tag: Tag,
    },
    /// The robot refuses a session because another operator or program holds it.
    Held {
        /// The nonce of the Hello or Confirm that is refused.
        client_nonce: Nonce,
        /// Name of the holder; `None` where another program with the same key holds the session.
        holder: Option<OperatorName>,
        /// All bytes that the tag covers.
        signed: &'a [u8],
        /// Tag over `signed`.
        tag: Tag,
    },
}

impl<'a> Datagram<'a> {
    /// Parses a datagram. `None` when it does not have exactly the layout of its kind.
    #[must_use]
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        if bytes.len() > MAXIMUM_DATAGRAM {
            return None;
        }
        let (signed, &tag) = bytes.split_last_chunk::<TAG_LENGTH>()?;
        let mut fields = Fields(signed);
        if fields.take::<3>()? != MAGIC {
            return None;
        }
        let datagram = match fields.u8()? {
            HELLO => {
                let version = fields.version()?;
                let client_nonce = fields.take()?;
                let purpose = Purpose::from_byte(fields.u8()?);
                let key_id = fields.take()?;
                let _repetition = fields.u8()?;
                fields.take::<HELLO_RESERVED>()?;
                Self::Hello(Hello { version, client_nonce, purpose, key_id, signed, tag })
            }
            CHALLENGE => Self::Challenge { robot_nonce: fields.take()?, signed, tag },
            CONFIRM => Self::Confirm(Confirm {
                client_nonce: fields.take()?,
                robot_nonce: fields.take()?,
                key_id: fields.take()?,
                client_public: fields.take()?,
                signed,
                tag,
            }),
            ACCEPT => {
                Self::Accept { session: fields.u32()?, robot_public: fields.take()?, signed, tag }
            }
            REFUSAL => Self::Refusal {
                reason: RefusalReason::from_byte(fields.u8()?)?,
                version: fields.version()?,
                client_nonce: fields.take()?,
                signed,
                tag,
            },
            kind @ (SEALED | RENEWAL) => {
                let is_renewal = kind == RENEWAL;
                let session = fields.u32()?;
                let counter = fields.u64()?;
                let (header, ciphertext) = signed.split_at(SEALED_HEADER);
                fields.0 = &[];
                Self::Sealed(Sealed { is_renewal, session, counter, header, ciphertext, tag })
            }
            STOP => {
                let client_nonce = fields.take()?;
                let robot_nonce = fields.take()?;
                let key_id = fields.take()?;
                let _repetition = fields.u8()?;
                Self::Stop(Stop { client_nonce, robot_nonce, key_id, signed, tag })
            }
            STOPPED => Self::Stopped { at_rest: fields.bool()?, signed, tag },
            HELD => Self::Held {
                client_nonce: fields.take()?,
                holder: match fields.take()? {
                    UNNAMED => None,
                    name => Some(name.try_into().ok()?),
                },
                signed,
                tag,
            },
            _ => return None,
        };
        fields.0.is_empty().then_some(datagram)
    }
}

/// Reads fields from the front.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const LENGTH: usize>(&mut self) -> Option<[u8; LENGTH]> {
        let (&field, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(field)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take().map(u8::from_le_bytes)
    }

    fn bool(&mut self) -> Option<bool> {
        [false, true].get(usize::from(self.u8()?)).copied()
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn version(&mut self) -> Option<Version> {
        let number = self.take().map(u16::from_le_bytes)?;
        Some(Version { number, schema_key: self.u64()? })
    }
}

/// Writes a handshake datagram: magic, kind, fields, then the tag that `sign` makes over them.
fn handshake(kind: u8, fields: &[&[u8]], sign: impl FnOnce(&[u8]) -> Tag) -> HandshakeFrame {
    let mut frame = HandshakeFrame::new();
    let mut append = |bytes: &[u8]| {
        frame.extend_from_slice(bytes).expect("the layouts above are at most MAXIMUM_HANDSHAKE");
    };
    append(&MAGIC);
    append(&[kind]);
    for field in fields {
        append(field);
    }
    let tag = sign(&frame);
    frame.extend_from_slice(&tag).expect("the layouts above are at most MAXIMUM_HANDSHAKE");
    frame
}

/// Returns a Hello. `repetition` differs in each, so that a copy of an earlier Hello never passes for the next.
pub(crate) fn hello(
    version: Version,
    client_nonce: &Nonce,
    purpose: Purpose,
    key_id: &KeyId,
    repetition: u8,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    let (number, schema_key) = (version.number.to_le_bytes(), version.schema_key.to_le_bytes());
    let rest = [0; HELLO_RESERVED];
    let (purpose, repetition) = ([purpose as u8], [repetition]);
    let fields: [&[u8]; 7] =
        [&number, &schema_key, client_nonce, &purpose, key_id, &repetition, &rest];
    handshake(HELLO, &fields, sign)
}

pub(crate) fn challenge(robot_nonce: &Nonce, sign: impl FnOnce(&[u8]) -> Tag) -> HandshakeFrame {
    handshake(CHALLENGE, &[robot_nonce], sign)
}

pub(crate) fn confirm(
    client_nonce: &Nonce,
    robot_nonce: &Nonce,
    key_id: &KeyId,
    client_public: &PublicKey,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    handshake(CONFIRM, &[client_nonce, robot_nonce, key_id, client_public], sign)
}

pub(crate) fn accept(
    session: u32,
    robot_public: &PublicKey,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    handshake(ACCEPT, &[&session.to_le_bytes(), robot_public], sign)
}

pub(crate) fn refusal(
    reason: RefusalReason,
    version: Version,
    client_nonce: &Nonce,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    let (number, schema_key) = (version.number.to_le_bytes(), version.schema_key.to_le_bytes());
    handshake(REFUSAL, &[&[reason as u8], &number, &schema_key, client_nonce], sign)
}

pub(crate) fn stop(
    client_nonce: &Nonce,
    robot_nonce: &Nonce,
    key_id: &KeyId,
    repetition: u8,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    handshake(STOP, &[client_nonce, robot_nonce, key_id, &[repetition]], sign)
}

pub(crate) fn stopped(at_rest: bool, sign: impl FnOnce(&[u8]) -> Tag) -> HandshakeFrame {
    handshake(STOPPED, &[&[u8::from(at_rest)]], sign)
}

pub(crate) fn held(
    client_nonce: &Nonce,
    holder: Option<OperatorName>,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    let name = holder.as_ref().map_or(&UNNAMED, OperatorName::as_bytes);
    handshake(HELD, &[client_nonce, name], sign)
}

/// Returns the header of a sealed datagram.
pub(crate) fn sealed_header(is_renewal: bool, session: u32, counter: u64) -> [u8; SEALED_HEADER] {
    let mut header = [0; SEALED_HEADER];
    header[..3].copy_from_slice(&MAGIC);
    header[3] = if is_renewal { RENEWAL } else { SEALED };
    header[HEAD..SEALED_COUNTER.start].copy_from_slice(&session.to_le_bytes());
    header[SEALED_COUNTER].copy_from_slice(&counter.to_le_bytes());
    header
}
