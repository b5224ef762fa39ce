//! The name of a Wi-Fi network (SSID), which is any bytes, and its form as text.

use core::fmt::{self, Write};
use core::str::FromStr;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::network_key::NETWORK_LENGTH;

/// Name of a network: up to [`NETWORK_LENGTH`] bytes, in no particular encoding (IEEE 802.11-2020, 9.4.2.2).
///
/// `Display` shows UTF-8 as it is, every other byte and every character that is not seen as `\xNN`, and a backslash as `\\`.
/// `FromStr` reads that form.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkName(Vec<u8, NETWORK_LENGTH>);

/// A text is not the name of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NetworkNameError {
    /// No byte, too many, or a zero byte, at which the radio's library would cut the name.
    #[error("a network's name is 1 to {NETWORK_LENGTH} bytes long, none of them zero")]
    Length,
    /// A backslash stands before something else.
    #[error(
        "in a network's name `\\xNN` is the byte with these two hexadecimal digits, and `\\\\` is a backslash"
    )]
    Escape,
}

impl NetworkName {
    /// Returns the name with these bytes.
    ///
    /// # Errors
    /// When they are too many. [`NetworkName::check`] finds the other faults.
    pub fn new(bytes: &[u8]) -> Result<Self, NetworkNameError> {
        Vec::from_slice(bytes).map(Self).map_err(|_| NetworkNameError::Length)
    }

    /// Returns whether a network can be joined by this name.
    ///
    /// # Errors
    /// When it is empty, as that of a hidden network in a list, or holds a zero byte.
    pub fn check(&self) -> Result<(), NetworkNameError> {
        let is_whole = !self.0.is_empty() && !self.0.contains(&0);
        is_whole.then_some(()).ok_or(NetworkNameError::Length)
    }

    /// Returns the name's bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

impl FromStr for NetworkName {
    type Err = NetworkNameError;

    fn from_str(text: &str) -> Result<Self, NetworkNameError> {
        let mut name = Self::default();
        let mut rest = text.as_bytes();
        while let [first, after @ ..] = rest {
            let (byte, after) = match (first, after) {
                (b'\\', [b'\\', after @ ..]) => (b'\\', after),
                (b'\\', [b'x', high, low, after @ ..]) => {
                    let digit =
                        |it: u8| char::from(it).to_digit(16).ok_or(NetworkNameError::Escape);
                    ((digit(*high)? << 4 | digit(*low)?) as u8, after)
                }
                (b'\\', _) => return Err(NetworkNameError::Escape),
                (byte, after) => (*byte, after),
            };
            name.0.push(byte).map_err(|_| NetworkNameError::Length)?;
            rest = after;
        }
        name.check().map(|()| name)
    }
}

impl fmt::Display for NetworkName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for chunk in self.0.utf8_chunks() {
            for letter in chunk.valid().chars() {
                match letter {
                    '\\' => f.write_str("\\\\")?,
                    letter if is_seen(letter) => f.write_char(letter)?,
                    letter => escape(letter.encode_utf8(&mut [0; 4]).as_bytes(), f)?,
                }
            }
            escape(chunk.invalid(), f)?;
        }
        Ok(())
    }
}

fn escape(bytes: &[u8], f: &mut fmt::Formatter<'_>) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(f, "\\x{byte:02x}"))
}

/// Returns whether a character is seen, and does nothing to a terminal: no control (C0 and C1, line ends among them), none
/// that turns the direction of a text, and none that takes no room.
#[must_use]
pub fn is_seen(letter: char) -> bool {
    let turns_or_hides = matches!(
        letter,
        '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}'
    );
    !letter.is_control() && !turns_or_hides
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString;

    use super::*;

    #[test]
    fn a_name_that_is_not_utf_8_is_written_with_its_bytes() {
        for (text, bytes) in [
            ("lab", &b"lab"[..]),
            (r"caf\xe9", b"caf\xe9"),
            (r"a\\b", b"a\\b"),
            (r"\xffx\\x41", b"\xffx\\x41"),
            (r"\xe2\x80", b"\xe2\x80"),
            ("Anna\u{2019}s iPhone", "Anna\u{2019}s iPhone".as_bytes()),
            (r"a\x1b[2Jb", b"a\x1b[2Jb"),
            (r"no\xe2\x80\x8bwidth", "no\u{200b}width".as_bytes()),
            (r"\x7f", b"\x7f"),
            (" lab ", b" lab "),
        ] {
            let name: NetworkName = text.parse().unwrap();
            assert_eq!(name.as_bytes(), bytes, "{text}");
            assert_eq!(name.to_string(), text);
        }
        assert_eq!(r"\xC3\xA9".parse::<NetworkName>().unwrap().to_string(), "é");
    }

    #[test]
    fn every_name_comes_back_from_its_text() {
        for first in 1..=u8::MAX {
            for second in 1..=u8::MAX {
                let name = NetworkName::new(&[first, second, b'x']).unwrap();
                assert_eq!(name.to_string().parse(), Ok(name));
            }
        }
    }

    #[test]
    fn a_text_that_is_no_name_is_refused() {
        for (text, error) in [
            ("", NetworkNameError::Length),
            (r"a\x00b", NetworkNameError::Length),
            (&"x".repeat(33), NetworkNameError::Length),
            (r"a\b", NetworkNameError::Escape),
            (r"a\x4", NetworkNameError::Escape),
            (r"a\xg0", NetworkNameError::Escape),
            (r"a\X41", NetworkNameError::Escape),
            ("a\\", NetworkNameError::Escape),
        ] {
            assert_eq!(text.parse::<NetworkName>(), Err(error), "{text}");
        }
        assert!(r"\x41".repeat(32).parse::<NetworkName>().is_ok());
    }
}
