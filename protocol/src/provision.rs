//! Provisioning: name, network and key of a robot, over its serial port.
//!
//! Physical access is the credential: the serial cable is enough, in every state in which the
//! motors coast. The port also carries the robot's log as text, so a message is a frame that text
//! cannot imitate:
//!
//! ```text
//! 0x00   COBS( version u8, message in postcard, CRC-32 little-endian )   0x00
//! ```
//!
//! COBS leaves no zero inside, so a reader that starts in the middle finds the next frame.
//! [`write_frame`] writes frames; [`FrameReader`] finds them in any stream of bytes and never
//! panics. The operator sends a [`Request`]; the robot answers each with one [`Answer`].
//!
//! Whatever is at the other end of a cable can say that it is a known robot, and can pass questions on to the
//! true one. So a key crosses the cable once, when it is new: a robot that proves to have a key already
//! ([`Request::Prove`]) is given the identifier of the key alone ([`Request::Keep`]); every other device gets
//! a new key.
//!
//! The robot starts anew with another network. [`Request::Network`] then asks how far it is: [`NetworkState`] states its address,
//! or why it has none. [`Request::Scan`] asks, with or without a network, for the access points that it hears.
//!
//! A robot has up to [`MAXIMUM_OPERATORS`] operators, which [`Request::Keep`] keeps. With
//! [`Request::Provision`] the robot has changed hands, and all former keys are erased.

use core::fmt;

use heapless::Vec;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use zeroize::{Zeroize, Zeroizing};

use crate::frame::{KeyId, Nonce, Tag};
use crate::message::{Identity, NAME_LENGTH, Name, OperatorName, is_label};
use crate::network_key::{PASSWORD_LENGTH, is_key};
use crate::network_name::{NetworkName, NetworkNameError};
use crate::session::{AddError, MAXIMUM_OPERATORS, Operator};

/// Version of these messages, incremented with every change. Both ends drop frames of another version.
pub const PROVISION_VERSION: u8 = 5;

/// Baud rate of the robot's serial port, that of the chip's boot log. 8 data bits, no parity, one
/// stop bit.
pub const BAUD_RATE: u32 = 115_200;

/// Longest frame with both its zeros, bytes.
pub const MAXIMUM_FRAME: usize = 256;
/// A whole frame. Wiped from memory when dropped: it may hold a key.
pub type SerialFrame = Zeroizing<Vec<u8, MAXIMUM_FRAME>>;

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
const CRC_LENGTH: usize = 4;

/// A request of the operator over the serial port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant, reason = "sent once, never stored")]
pub enum Request {
    /// Report the identity, and whether there is a key.
    Identify,
    /// Store this in flash, and join the network with it; the robot obeys this operator, and no other any more.
    Provision(Provisioning, Operator),
    /// Erase name, network and all keys: return to the state of a new robot.
    Forget,
    /// Prove that the robot has the key with this identifier, for this fresh random challenge.
    Prove(Nonce, KeyId),
    /// Report the names of the operators.
    Operators,
    /// Obey this operator, too.
    Add(Operator),
    /// Erase the key of this operator.
    Revoke(OperatorName),
    /// As [`Request::Provision`], for the operator whose key has this identifier: it has this name from now on. Its key
    /// and the other operators stay.
    Keep(Provisioning, OperatorName, KeyId),
    /// Report how far the robot is on its way onto its network.
    Network,
    /// Report the access points that the robot hears.
    Scan {
        /// Number of the scan, which the computer chooses: another number than before begins another scan.
        number: u8,
        /// Place in the list at which the answer begins.
        from: u8,
    },
}

/// Name and network of a robot. `Debug` does not show the password, which is wiped from memory when
/// dropped.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provisioning {
    name: Name,
    network: NetworkName,
    password: Vec<u8, PASSWORD_LENGTH>,
    address: Option<FixedAddress>,
}

/// Address of the robot on a network without DHCP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedAddress {
    /// IPv4 address of the robot.
    pub address: [u8; 4],
    /// Length of the network part of the address, 0 to 32 bits.
    pub prefix_length: u8,
    /// IPv4 address of the gateway, where there is one.
    pub gateway: Option<[u8; 4]>,
}

/// A value was refused for provisioning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ProvisioningError {
    /// The name is empty, too long, or not a host name's label.
    #[error(
        "a robot's name is 1 to {LONGEST_LABEL} letters, digits and hyphens, and neither begins nor ends with a hyphen"
    )]
    Name,
    /// The network's name.
    #[error(transparent)]
    Network(#[from] NetworkNameError),
    /// The password is not UTF-8, or neither empty (an open network) nor a pass phrase of 8 to 63 bytes nor a key of
    /// [`PASSWORD_LENGTH`] hexadecimal digits (IEEE 802.11, annex J.4).
    #[error(
        "a network's password is {SHORTEST_PASSWORD} to {LONGEST_PHRASE} bytes long, or a key of {PASSWORD_LENGTH} hexadecimal digits, or empty for an open network"
    )]
    Password,
    /// A fixed address that no host has, or more than 32 bits of network.
    #[error(
        "a fixed address is one that a host can have (not 0.x, multicast, or the first or last of its network), with a network part of 0 to 32 bits, and its gateway is another one"
    )]
    Address,
}

/// WPA2's shortest password.
const SHORTEST_PASSWORD: usize = 8;
/// WPA2's longest password that is no key.
const LONGEST_PHRASE: usize = PASSWORD_LENGTH - 1;
/// Longest robot's name; one less than fits, so that it also serves as a C string.
const LONGEST_LABEL: usize = NAME_LENGTH - 1;

/// Returns whether this can be a robot's name: a label of a host name, as mDNS needs it.
#[must_use]
pub fn is_name(name: &str) -> bool {
    name.len() <= LONGEST_LABEL && is_label(name.as_bytes())
}

impl FixedAddress {
    /// Returns whether a host can have this address. The stack panics on some that none can have.
    #[must_use]
    pub fn is_host(&self) -> bool {
        // Bits of the host; networks of one and two have no address of their own (RFC 3021).
        let hosts = u32::MAX.checked_shr(self.prefix_length.into()).unwrap_or(0);
        let own = u32::from_be_bytes(self.address) & hosts;
        let is_one = |address: [u8; 4]| !matches!(address[0], 0 | 224..);
        self.prefix_length <= 32
            && is_one(self.address)
            && (hosts < 2 || (own != 0 && own != hosts))
            && self.gateway.is_none_or(|gateway| is_one(gateway) && gateway != self.address)
    }
}

impl Provisioning {
    /// Checks the values.
    ///
    /// # Errors
    /// When one of them cannot be used.
    pub fn new(
        name: &str,
        network: impl AsRef<[u8]>,
        password: &str,
        address: Option<FixedAddress>,
    ) -> Result<Self, ProvisioningError> {
        let provisioning = Self {
            name: name.try_into().map_err(|_| ProvisioningError::Name)?,
            network: NetworkName::new(network.as_ref())?,
            password: Vec::from_slice(password.as_bytes())
                .map_err(|_| ProvisioningError::Password)?,
            address,
        };
        provisioning.check().map(|()| provisioning)
    }

    /// Checks values that came over the wire, before they are stored.
    ///
    /// # Errors
    /// As for [`Provisioning::new`].
    pub fn check(&self) -> Result<(), ProvisioningError> {
        if !is_name(&self.name) {
            return Err(ProvisioningError::Name);
        }
        self.network.check()?;
        let password =
            core::str::from_utf8(&self.password).map_err(|_| ProvisioningError::Password)?;
        let is_phrase = (SHORTEST_PASSWORD..=LONGEST_PHRASE).contains(&password.len());
        if !(password.is_empty() || is_phrase || is_key(password)) {
            return Err(ProvisioningError::Password);
        }
        match self.address {
            Some(address) if !address.is_host() => Err(ProvisioningError::Address),
            _ => Ok(()),
        }
    }

    /// Returns the robot's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the network to join (SSID).
    #[must_use]
    pub const fn network(&self) -> &NetworkName {
        &self.network
    }

    /// Returns the network's password; empty for an open network.
    #[must_use]
    pub fn password(&self) -> &str {
        core::str::from_utf8(&self.password).unwrap_or_default()
    }

    /// Returns the fixed address; none to request one by DHCP.
    #[must_use]
    pub const fn address(&self) -> Option<FixedAddress> {
        self.address
    }
}

impl fmt::Debug for Provisioning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Provisioning")
            .field("name", &self.name)
            .field("network", &self.network)
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl Drop for Provisioning {
    fn drop(&mut self) {
        self.password.as_mut_slice().zeroize();
    }
}

/// An answer of the robot over the serial port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// To [`Request::Identify`].
    Identity {
        /// Name, board and firmware.
        identity: Identity,
        /// Whether the robot has a key.
        has_key: bool,
    },
    /// Stored.
    Done,
    /// Refused; nothing was changed.
    Refused(ProvisionRefusal),
    /// To [`Request::Prove`]: the tag of [`Key::prove`](crate::session::Key::prove); `None` without that key.
    Proof(Option<Tag>),
    /// To [`Request::Operators`]: their names.
    Operators(Vec<OperatorName, MAXIMUM_OPERATORS>),
    /// To [`Request::Network`].
    Network(NetworkState),
    /// To [`Request::Scan`]; `None` while the robot listens.
    Networks(Option<HeardNetworks>),
}

/// Access points in one [`Answer::Networks`] at most: as many as fit a frame.
pub const HEARD_AT_ONCE: usize = 6;

/// A part of the list of access points that a robot hears, the strongest first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeardNetworks {
    /// Length of the whole list.
    pub total: u8,
    /// Place of the part in it, as the request named it.
    pub from: u8,
    /// The part.
    pub networks: Vec<HeardNetwork, HEARD_AT_ONCE>,
}

/// An access point that a robot hears.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeardNetwork {
    /// Name of its network; empty where it is hidden.
    pub name: NetworkName,
    /// Its channel.
    pub channel: u8,
    /// Power at the robot, dBm.
    pub dbm: i8,
    /// How it keeps others out.
    pub security: HeardSecurity,
}

/// How an access point keeps others out. `Display` and JSON have the same words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum HeardSecurity {
    /// Not at all, or by a way that the radio's library does not have and takes for none, as WPA3 alone.
    Open,
    /// WEP.
    Wep,
    /// WPA.
    Wpa,
    /// WPA2, alone or beside WPA.
    Wpa2,
    /// WPA2 beside WPA3.
    Wpa2Wpa3,
    /// WPA3 alone.
    Wpa3,
    /// User names (802.1X).
    Enterprise,
    /// Another one.
    Other,
}

impl fmt::Display for HeardSecurity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Open => "open or WPA3",
            Self::Wep => "WEP",
            Self::Wpa => "WPA",
            Self::Wpa2 => "WPA2",
            Self::Wpa2Wpa3 => "WPA2/WPA3",
            Self::Wpa3 => "WPA3",
            Self::Enterprise => "802.1X",
            Self::Other => "other",
        })
    }
}

/// How far a robot is on its way onto its network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum NetworkState {
    /// No try to connect has ended since the start, or since the connection was lost.
    Joining,
    /// The last try failed; the robot tries again.
    Failed {
        /// Why.
        reason: JoinFailure,
        /// Number of failed tries in a row.
        tries: u32,
    },
    /// Connected, without an address.
    NoAddress {
        /// Time without one, s.
        seconds: u32,
    },
    /// Connected, with this address.
    Joined(NetworkAddress),
}

/// The robot's address on its network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkAddress {
    /// IPv4 address.
    pub address: [u8; 4],
    /// Length of the network part of the address, bits.
    pub prefix_length: u8,
    /// Whether it was provisioned; otherwise DHCP gave it.
    pub is_fixed: bool,
}

impl fmt::Display for NetworkAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { address, prefix_length, is_fixed } = self;
        let origin = if *is_fixed { "as provisioned" } else { "by DHCP" };
        write!(f, "{}/{prefix_length} {origin}", core::net::Ipv4Addr::from(*address))
    }
}

/// Why a robot could not connect to its network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum JoinFailure {
    /// No access point of this name is in reach.
    #[error("no network of this name at 2.4 GHz: 5 GHz is not received")]
    Absent,
    /// The access point refused the password, or did not answer the handshake.
    #[error("the password is refused: is it right? WPA3 alone is not supported")]
    Password,
    /// The network offers no security that the robot has.
    #[error(
        "its security does not fit: an open network takes no password, every other one has to offer WPA2 with a password; WPA3 alone and user names (802.1X, WPA2 Enterprise, eduroam) are not supported"
    )]
    Security,
    /// The access point has no room for another station.
    #[error("the access point takes no more devices")]
    Full,
    /// The access point ended the try for another reason, which the robot's log states.
    #[error("the access point refuses the robot")]
    Refused,
    /// The robot's radio does not start, or gives no result.
    #[error("the robot's radio gives no result")]
    Radio,
}

/// Why a robot refused a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum ProvisionRefusal {
    /// A value cannot be used.
    #[error("the robot cannot use one of the values")]
    Malformed,
    /// The motors do not coast.
    #[error("the motors are on: disarm the robot first")]
    Driving,
    /// The storage could not be written.
    #[error("the robot could not write its storage")]
    Storage,
    /// The robot has no owner yet. An owner alone adds and revokes operators.
    #[error("the robot has no owner yet: provision it first")]
    Unprovisioned,
    /// There is no room for another operator.
    #[error("the robot has {MAXIMUM_OPERATORS} operators already: revoke one first")]
    Full,
    /// Another operator has this name.
    #[error("another operator has this name: choose another, or revoke that one first")]
    Taken,
    /// The only operator is not revoked, because no operator would be left.
    #[error("the robot has no other operator: add one first, or use --new-key or --forget")]
    Last,
    /// No operator has a key with this identifier.
    #[error("the robot does not have your key any more: use --new-key")]
    Unknown,
    /// The radio does not start, or does not listen.
    #[error("the robot's radio gives no result: its log says why")]
    Radio,
}

impl From<AddError> for ProvisionRefusal {
    fn from(error: AddError) -> Self {
        match error {
            AddError::Full => Self::Full,
            AddError::Taken => Self::Taken,
        }
    }
}

/// Returns the frame of a message, zeros included. `None` when the frame would be longer than
/// [`MAXIMUM_FRAME`], which no [`Request`] or [`Answer`] is.
#[must_use]
pub fn write_frame(message: &impl Serialize) -> Option<SerialFrame> {
    let mut plain = Zeroizing::new([0; MAXIMUM_FRAME]);
    plain[0] = PROVISION_VERSION;
    let length = 1 + postcard::to_slice(message, &mut plain[1..]).ok()?.len();
    let sum = CRC.checksum(&plain[..length]).to_le_bytes();
    plain.get_mut(length..length + CRC_LENGTH)?.copy_from_slice(&sum);
    let plain_length = length + CRC_LENGTH;

    let mut frame = SerialFrame::new(Vec::new());
    // COBS adds one byte to every 254, and there are two zeros.
    frame.resize_default(MAXIMUM_FRAME).ok()?;
    if plain_length + plain_length / 254 + 3 > MAXIMUM_FRAME {
        return None;
    }
    let encoded = cobs::encode(&plain[..plain_length], &mut frame[1..]);
    frame.truncate(encoded + 2);
    frame[encoded + 1] = 0;
    Some(frame)
}

/// Finds frames in a stream of bytes that also carries text.
#[derive(Default)]
pub struct FrameReader {
    bytes: SerialFrame,
    is_too_long: bool,
}

impl FrameReader {
    /// Creates a reader that has read nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Reads the next byte. Returns the message when it completes a frame with the right version
    /// and check sum. Never panics.
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<T> {
        if byte != 0 {
            self.is_too_long |= self.bytes.push(byte).is_err();
            return None;
        }
        let message = if self.is_too_long { None } else { decode(&mut self.bytes) };
        self.bytes.zeroize();
        self.is_too_long = false;
        message
    }
}

fn decode<T: DeserializeOwned>(bytes: &mut [u8]) -> Option<T> {
    if bytes.is_empty() {
        return None;
    }
    let length = cobs::decode_in_place(bytes).ok()?;
    let (content, sum) = bytes.get(..length)?.split_last_chunk::<CRC_LENGTH>()?;
    if CRC.checksum(content).to_le_bytes() != *sum {
        return None;
    }
    let (&version, message) = content.split_first()?;
    if version != PROVISION_VERSION {
        return None;
    }
    postcard::from_bytes(message).ok()
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;
    use std::string::String as Text;
    use std::vec::Vec as List;

    use super::*;
    use crate::session::Key;

    fn longest() -> Provisioning {
        let (address, gateway) = ([192, 168, 255, 254], Some([192, 168, 255, 253]));
        let address = FixedAddress { address, prefix_length: 24, gateway };
        let (name, password) = ("n".repeat(31), "a".repeat(64));
        Provisioning::new(&name, [0xff; 32], &password, Some(address)).unwrap()
    }

    fn operator() -> Operator {
        Operator::new("an-operator-here".parse().unwrap(), &Key::new([0xa5; 32]))
    }

    fn read<T: DeserializeOwned>(bytes: &[u8]) -> List<T> {
        let mut reader = FrameReader::new();
        bytes.iter().filter_map(|byte| reader.push(*byte)).collect()
    }

    #[test]
    fn the_longest_request_fits_a_frame_and_comes_back() {
        let request = Request::Provision(longest(), operator());
        assert_eq!(read::<Request>(&write_frame(&request).unwrap()), [request]);
    }

    #[test]
    fn the_longest_list_of_networks_fits_a_frame_and_comes_back() {
        let name = NetworkName::new(&[0xff; 32]).unwrap();
        let security = HeardSecurity::Other;
        let one = HeardNetwork { name, channel: 13, dbm: -100, security };
        let networks = core::iter::repeat_n(one, HEARD_AT_ONCE).collect();
        let answer = Answer::Networks(Some(HeardNetworks { total: u8::MAX, from: 0, networks }));
        assert_eq!(read::<Answer>(&write_frame(&answer).unwrap()), [answer]);
    }

    #[test]
    fn a_password_is_a_phrase_or_a_key() {
        let new = |password: &str| Provisioning::new("walker", "lab", password, None).map(drop);
        for password in ["", "12345678", &"p".repeat(63), &"aB".repeat(32)] {
            assert_eq!(new(password), Ok(()), "{password}");
        }
        for password in ["1234567", &"p".repeat(64), &"a".repeat(65)] {
            assert_eq!(new(password), Err(ProvisioningError::Password), "{password}");
        }
    }

    #[test]
    fn frames_are_found_in_the_midst_of_a_log() {
        let mut bytes = List::from(*b"I (31) boot: ESP-IDF v5\r\nhalf a frame\0\0 and \xff\xfe");
        bytes.extend_from_slice(&write_frame(&Answer::Done).unwrap());
        bytes.extend_from_slice(b"more log\n");
        let identity = Identity {
            name: "walker".try_into().unwrap(),
            board: "board".try_into().unwrap(),
            version: "0.1.0".try_into().unwrap(),
            reset: crate::message::ResetReason::Tasks,
        };
        let identity = Answer::Identity { identity, has_key: true };
        bytes.extend_from_slice(&write_frame(&identity).unwrap());
        assert_eq!(read::<Answer>(&bytes), [Answer::Done, identity]);
    }

    #[test]
    fn one_flipped_bit_anywhere_drops_the_frame() {
        let frame = write_frame(&Request::Provision(longest(), operator())).unwrap();
        for place in 1..frame.len() - 1 {
            for bit in 0..8 {
                let mut damaged = frame.clone();
                damaged[place] ^= 1 << bit;
                assert_eq!(read::<Request>(&damaged), [], "byte {place}, bit {bit}");
            }
        }
    }

    #[test]
    fn random_bytes_are_no_frame_and_no_panic() {
        let mut state = 1u64;
        let mut reader = FrameReader::new();
        for _ in 0..2_000_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            // Zeros often enough that frames of all lengths occur.
            let byte = if state >> 58 == 0 { 0 } else { (state >> 33) as u8 };
            assert_eq!(reader.push::<Request>(byte), None);
        }
    }

    #[test]
    fn a_frame_after_an_endless_line_is_read() {
        let mut bytes = List::from([b'x'; 10_000]);
        bytes.extend_from_slice(&write_frame(&Request::Identify).unwrap());
        assert_eq!(read::<Request>(&bytes), [Request::Identify]);
    }

    #[test]
    fn debug_output_shows_neither_key_nor_password() {
        let text = format!("{:?}", Request::Provision(longest(), operator()));
        assert!(!text.contains("ppp") && !text.contains("165") && !text.contains("a5"), "{text}");
    }

    #[test]
    fn values_that_no_network_takes_are_refused() {
        let refused = |name: &str, network: &str, password: &str| {
            Provisioning::new(name, network, password, None).unwrap_err()
        };
        for name in ["", "-a", "a-", "a.b", "ä", &Text::from("a").repeat(32)] {
            assert_eq!(refused(name, "lab", "password"), ProvisioningError::Name, "{name}");
        }
        for network in ["", &"w".repeat(33), "w\0w"] {
            let error = ProvisioningError::Network(NetworkNameError::Length);
            assert_eq!(refused("walker", network, "password"), error);
        }
        for password in ["short", &"p".repeat(65)] {
            assert_eq!(refused("walker", "lab", password), ProvisioningError::Password);
        }
        assert!(Provisioning::new("walker", "open", "", None).is_ok());
    }

    #[test]
    fn a_fixed_address_is_one_that_a_host_can_have() {
        let check = |address, prefix_length, gateway| {
            let address = FixedAddress { address, prefix_length, gateway };
            Provisioning::new("n", "w", "", Some(address)).map(|_| ())
        };
        let (own, other) = ([10, 0, 0, 7], [10, 0, 0, 254]);
        for (address, prefix_length, gateway) in [
            (own, 24, None),
            (own, 24, Some(other)),
            (own, 32, Some(other)),
            (own, 31, None),
            (own, 0, None),
            ([10, 0, 0, 255], 16, None),
            ([10, 0, 1, 0], 16, None),
            ([10, 0, 0, 255], 31, None),
            ([223, 255, 255, 254], 24, None),
            // Of an emulated robot on this computer.
            ([127, 0, 0, 7], 24, None),
        ] {
            assert_eq!(
                check(address, prefix_length, gateway),
                Ok(()),
                "{address:?}/{prefix_length}"
            );
        }
        for (address, prefix_length, gateway) in [
            (own, 33, None),
            (own, 24, Some(own)),
            (own, 24, Some([0; 4])),
            (own, 24, Some([255; 4])),
            ([0; 4], 24, None),
            ([0, 0, 0, 7], 24, None),
            ([224, 0, 0, 251], 4, None),
            ([255; 4], 24, None),
            ([255; 4], 32, None),
            ([10, 0, 0, 255], 24, None),
            ([10, 0, 0, 0], 24, None),
        ] {
            let refused = Err(ProvisioningError::Address);
            assert_eq!(
                check(address, prefix_length, gateway),
                refused,
                "{address:?}/{prefix_length}"
            );
        }
    }
}
