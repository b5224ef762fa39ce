//! Name of an operator.

use core::fmt;
use core::str::FromStr;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Longest name of an operator, bytes.
pub const OPERATOR_NAME_LENGTH: usize = 16;

/// Name under which a robot knows an operator: 1 to [`OPERATOR_NAME_LENGTH`] letters, digits and
/// hyphens (ASCII), beginning and ending with a letter or digit. Zeros fill it up on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[serde(try_from = "[u8; OPERATOR_NAME_LENGTH]")]
pub struct OperatorName([u8; OPERATOR_NAME_LENGTH]);

/// Text was refused as the name of an operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "an operator's name is 1 to {OPERATOR_NAME_LENGTH} letters, digits and hyphens, and neither begins nor ends with a hyphen"
)]
pub struct OperatorNameError;

impl OperatorName {
    /// Name of an operator whose key came without one.
    pub const OWNER: Self = Self(*b"owner\0\0\0\0\0\0\0\0\0\0\0");

    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(trimmed(&self.0)).unwrap_or_default()
    }

    /// Returns the name with the zeros that fill it up.
    pub(crate) const fn as_bytes(&self) -> &[u8; OPERATOR_NAME_LENGTH] {
        &self.0
    }
}

impl FromStr for OperatorName {
    type Err = OperatorNameError;

    fn from_str(text: &str) -> Result<Self, OperatorNameError> {
        let mut bytes = [0; OPERATOR_NAME_LENGTH];
        match bytes.get_mut(..text.len()) {
            Some(part) if is_label(text.as_bytes()) => part.copy_from_slice(text.as_bytes()),
            _ => return Err(OperatorNameError),
        }
        Ok(Self(bytes))
    }
}

impl TryFrom<[u8; OPERATOR_NAME_LENGTH]> for OperatorName {
    type Error = OperatorNameError;

    fn try_from(bytes: [u8; OPERATOR_NAME_LENGTH]) -> Result<Self, OperatorNameError> {
        if is_label(trimmed(&bytes)) { Ok(Self(bytes)) } else { Err(OperatorNameError) }
    }
}

impl fmt::Display for OperatorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for OperatorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Returns the bytes before the zeros at the end.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let zeros = bytes.iter().rev().take_while(|byte| **byte == 0).count();
    &bytes[..bytes.len() - zeros]
}

/// Returns whether this is a label of a host name: letters, digits and hyphens, no hyphen at either end.
pub(crate) fn is_label(bytes: &[u8]) -> bool {
    let is_inner = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'-';
    let ends = [bytes.first(), bytes.last()];
    bytes.iter().all(is_inner) && ends.iter().all(|end| end.is_some_and(|byte| *byte != b'-'))
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString;

    use super::*;

    #[test]
    fn names_are_labels_of_16_bytes_at_most() {
        for name in ["a", "anna-2", "A1234567890123-6"] {
            assert_eq!(name.parse::<OperatorName>().unwrap().to_string(), name);
        }
        for name in ["", "-a", "a-", "a b", "\u{1b}[31m", "ä", "a\0", "a\0b", "12345678901234567"]
        {
            let bytes = name.parse::<OperatorName>();
            assert_eq!(bytes, Err(OperatorNameError), "{name:?}");
        }
    }

    #[test]
    fn a_name_that_is_no_label_is_no_message() {
        let good = *OperatorName::OWNER.as_bytes();
        assert_eq!(postcard::from_bytes(&good), Ok(OperatorName::OWNER));
        for (place, byte) in [(0, b'-'), (2, 0x1b), (2, 0), (15, b' ')] {
            let mut bad = good;
            bad[place] = byte;
            assert!(postcard::from_bytes::<OperatorName>(&bad).is_err(), "{place}");
        }
    }
}
