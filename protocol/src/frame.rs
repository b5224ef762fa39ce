//! Datagrams: what is where, in bytes.
//!
//! Every datagram begins with [`MAGIC`] and a kind. Integers are little-endian. A tag is 16 bytes:
//! the first half of an HMAC-SHA256 during the handshake, a Poly1305 tag afterwards.
//!
//! | kind | from | bytes | fields after magic and kind |
//! |---|---|---|---|
//! | 1 Hello | operator | 62 | version u16, schema key u64, client nonce 16, zeros 16, tag |
//! | 2 Challenge | robot | 36 | robot nonce 16, tag |
//! | 3 Confirm | operator | 52 | client nonce 16, robot nonce 16, tag |
//! | 4 Accept | robot | 24 | session u32, tag |
//! | 5 Refusal | robot | 47 | reason u8, version u16, schema key u64, client nonce 16, tag |
//! | 6 Sealed | both | 32 to 512 | session u32, counter u64, ciphertext, tag |
//!
//! Hello's first 14 bytes and the whole of Refusal are the same in every version for ever, so that
//! ends of different versions can tell each other so. No answer is longer than what it answers: the
//! robot amplifies nothing.
//!
//! Here is only the layout; [`crate::session`] says what the datagrams mean and what protects them.
//! Parsing never panics and never copies.

use heapless::Vec;

/// Longest datagram, bytes.
pub const MAXIMUM_DATAGRAM: usize = 512;
/// Any datagram.
pub type Frame = Vec<u8, MAXIMUM_DATAGRAM>;

/// Longest datagram of the handshake, bytes.
pub const MAXIMUM_HANDSHAKE: usize = 64;
/// A datagram of the handshake.
pub type HandshakeFrame = Vec<u8, MAXIMUM_HANDSHAKE>;

/// First bytes of every datagram.
pub const MAGIC: [u8; 3] = *b"flx";

/// Bytes in a nonce of the handshake.
pub const NONCE_LENGTH: usize = 16;
/// Bytes in a tag.
pub const TAG_LENGTH: usize = 16;
/// Bytes before the ciphertext of a sealed datagram: authenticated, not encrypted.
pub const SEALED_HEADER: usize = MAGIC.len() + 1 + 4 + 8;
/// Longest plain message that fits a sealed datagram, bytes.
pub const MAXIMUM_MESSAGE: usize = MAXIMUM_DATAGRAM - SEALED_HEADER - TAG_LENGTH;

/// Makes Hello longer than any answer, and short enough for its tag to take two rounds of SHA-256.
const HELLO_RESERVED: usize = 16;

/// A random number used once.
pub type Nonce = [u8; NONCE_LENGTH];
/// Proof that a datagram was made by a holder of the key.
pub type Tag = [u8; TAG_LENGTH];

const HELLO: u8 = 1;
const CHALLENGE: u8 = 2;
const CONFIRM: u8 = 3;
const ACCEPT: u8 = 4;
const REFUSAL: u8 = 5;
const SEALED: u8 = 6;

/// Why the robot will not talk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum RefusalReason {
    /// The robot speaks another version.
    Version = 1,
    /// The tag did not fit the robot's key.
    Key = 2,
    /// Another operator holds the robot.
    Busy = 3,
    /// The robot has no key yet.
    Unprovisioned = 4,
}

impl RefusalReason {
    const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            1 => Some(Self::Version),
            2 => Some(Self::Key),
            3 => Some(Self::Busy),
            4 => Some(Self::Unprovisioned),
            _ => None,
        }
    }
}

/// Version number and schema hash of one end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Version {
    /// Counted up by hand when meaning changes though the schema does not.
    pub number: u16,
    /// Hash over the schema of all messages.
    pub schema_key: u64,
}

/// The parts of a datagram, as received: nothing in it is trusted yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Datagram<'a> {
    /// "I would like to talk."
    Hello {
        /// What the operator speaks.
        version: Version,
        /// Fresh, from the operator.
        client_nonce: Nonce,
        /// All that the tag covers.
        signed: &'a [u8],
        /// Over `signed`.
        tag: Tag,
    },
    /// "Show that you are there now."
    Challenge {
        /// The robot's cookie.
        robot_nonce: Nonce,
        /// All that the tag covers, save what both ends know.
        signed: &'a [u8],
        /// Over `signed` and the client nonce.
        tag: Tag,
    },
    /// "I am."
    Confirm {
        /// As in Hello.
        client_nonce: Nonce,
        /// As in Challenge.
        robot_nonce: Nonce,
        /// All that the tag covers.
        signed: &'a [u8],
        /// Over `signed`.
        tag: Tag,
    },
    /// "The robot is yours."
    Accept {
        /// Names the session in each sealed datagram.
        session: u32,
        /// All that the tag covers, save what both ends know.
        signed: &'a [u8],
        /// Over `signed` and both nonces.
        tag: Tag,
    },
    /// "No."
    Refusal {
        /// Why.
        reason: RefusalReason,
        /// What the robot speaks.
        version: Version,
        /// Of the Hello or Confirm that is refused.
        client_nonce: Nonce,
        /// All that the tag covers.
        signed: &'a [u8],
        /// Over `signed`, with the robot's key; zeros where no key can be held in common.
        tag: Tag,
    },
    /// A message of a session.
    Sealed {
        /// Which session.
        session: u32,
        /// Counts up with every datagram of one sender in one session.
        counter: u64,
        /// Header: authenticated, not encrypted.
        header: &'a [u8],
        /// Ciphertext.
        ciphertext: &'a [u8],
        /// Over header and ciphertext.
        tag: Tag,
    },
}

impl<'a> Datagram<'a> {
    /// Takes a datagram apart. `None` when it has not exactly the shape of its kind.
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
                fields.take::<HELLO_RESERVED>()?;
                Self::Hello { version, client_nonce, signed, tag }
            }
            CHALLENGE => Self::Challenge { robot_nonce: fields.take()?, signed, tag },
            CONFIRM => Self::Confirm {
                client_nonce: fields.take()?,
                robot_nonce: fields.take()?,
                signed,
                tag,
            },
            ACCEPT => Self::Accept { session: fields.u32()?, signed, tag },
            REFUSAL => Self::Refusal {
                reason: RefusalReason::from_byte(fields.u8()?)?,
                version: fields.version()?,
                client_nonce: fields.take()?,
                signed,
                tag,
            },
            SEALED => {
                let session = fields.u32()?;
                let counter = fields.u64()?;
                let (header, ciphertext) = signed.split_at(SEALED_HEADER);
                fields.0 = &[];
                Self::Sealed { session, counter, header, ciphertext, tag }
            }
            _ => return None,
        };
        fields.0.is_empty().then_some(datagram)
    }
}

/// Reads fields off the front.
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

pub(crate) fn hello(
    version: Version,
    client_nonce: &Nonce,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    let (number, schema_key) = (version.number.to_le_bytes(), version.schema_key.to_le_bytes());
    handshake(HELLO, &[&number, &schema_key, client_nonce, &[0; HELLO_RESERVED]], sign)
}

pub(crate) fn challenge(robot_nonce: &Nonce, sign: impl FnOnce(&[u8]) -> Tag) -> HandshakeFrame {
    handshake(CHALLENGE, &[robot_nonce], sign)
}

pub(crate) fn confirm(
    client_nonce: &Nonce,
    robot_nonce: &Nonce,
    sign: impl FnOnce(&[u8]) -> Tag,
) -> HandshakeFrame {
    handshake(CONFIRM, &[client_nonce, robot_nonce], sign)
}

pub(crate) fn accept(session: u32, sign: impl FnOnce(&[u8]) -> Tag) -> HandshakeFrame {
    handshake(ACCEPT, &[&session.to_le_bytes()], sign)
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

/// Header of a sealed datagram.
pub(crate) fn sealed_header(session: u32, counter: u64) -> [u8; SEALED_HEADER] {
    let mut header = [0; SEALED_HEADER];
    header[..3].copy_from_slice(&MAGIC);
    header[3] = SEALED;
    header[4..8].copy_from_slice(&session.to_le_bytes());
    header[8..].copy_from_slice(&counter.to_le_bytes());
    header
}
