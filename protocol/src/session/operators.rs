//! Operators of a robot, each with a name and a key.

use core::fmt;

use heapless::Vec;
use serde::{Deserialize, Serialize};
use zeroize::ZeroizeOnDrop;

use super::Key;
use crate::frame::KeyId;
use crate::message::OperatorName;

/// Most operators of one robot.
pub const MAXIMUM_OPERATORS: usize = 8;

/// An operator of a robot: a name, and the key that proves it. `Debug` does not show the key, and it is
/// wiped from memory when dropped.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, ZeroizeOnDrop)]
pub struct Operator {
    key: [u8; 32],
    #[zeroize(skip)]
    name: OperatorName,
}

impl Operator {
    /// Joins a name and a key.
    #[must_use]
    pub const fn new(name: OperatorName, key: &Key) -> Self {
        Self { key: *key.as_bytes(), name }
    }

    /// Returns the name.
    #[must_use]
    pub const fn name(&self) -> OperatorName {
        self.name
    }

    /// Returns the key.
    #[must_use]
    pub const fn key(&self) -> Key {
        Key::new(self.key)
    }

    /// Returns whether there is a key: zeros are empty memory.
    #[must_use]
    pub fn has_key(&self) -> bool {
        self.key != [0; 32]
    }
}

impl fmt::Debug for Operator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Operator").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Why an operator was not added.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AddError {
    /// There are [`MAXIMUM_OPERATORS`] already.
    #[error("there are {MAXIMUM_OPERATORS} operators already")]
    Full,
    /// Another key has this name.
    #[error("another operator has this name")]
    Taken,
}

/// The operators of one robot, at most [`MAXIMUM_OPERATORS`]; names and keys differ. Without any, the robot
/// refuses everybody.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Operators(Vec<Operator, MAXIMUM_OPERATORS>);

impl Operators {
    /// Returns the operators, in the order in which they were added.
    pub fn iter(&self) -> core::slice::Iter<'_, Operator> {
        self.0.iter()
    }

    /// Returns the names, in the order in which they were added.
    #[must_use]
    pub fn names(&self) -> Vec<OperatorName, MAXIMUM_OPERATORS> {
        self.iter().map(Operator::name).collect()
    }

    /// Returns the operator whose key has this identifier.
    #[must_use]
    pub fn find(&self, id: &KeyId) -> Option<&Operator> {
        self.iter().find(|operator| operator.key().id() == *id)
    }

    /// Adds an operator. One whose key is here already gets the name.
    ///
    /// # Errors
    /// When there is no room, or another key has the name; then nothing changes.
    pub fn add(&mut self, operator: Operator) -> Result<(), AddError> {
        let is_other = |known: &&Operator| known.key() != operator.key();
        if self.iter().filter(is_other).any(|known| known.name == operator.name) {
            return Err(AddError::Taken);
        }
        match self.0.iter_mut().find(|known| !is_other(&&**known)) {
            Some(known) => known.name = operator.name,
            None => self.0.push(operator).map_err(|_| AddError::Full)?,
        }
        Ok(())
    }

    /// Removes the operator of this name and its key. Does nothing when there is none.
    pub fn revoke(&mut self, name: OperatorName) {
        self.0.retain(|operator| operator.name != name);
    }
}

impl From<Operator> for Operators {
    fn from(operator: Operator) -> Self {
        Self(core::iter::once(operator).collect())
    }
}

impl From<Key> for Operators {
    fn from(key: Key) -> Self {
        Operator::new(OperatorName::OWNER, &key).into()
    }
}

impl From<Option<Key>> for Operators {
    /// Returns the operator of this key, named [`OperatorName::OWNER`]; none without a key.
    fn from(key: Option<Key>) -> Self {
        key.map(Self::from).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;

    use super::*;

    fn operator(name: &str, key: u8) -> Operator {
        Operator::new(name.parse().unwrap(), &Key::new([key; 32]))
    }

    #[test]
    fn names_and_keys_differ_and_there_are_eight_at_most() {
        let mut operators = Operators::from(operator("anna", 1));
        assert_eq!(operators.add(operator("anna", 2)), Err(AddError::Taken));
        for number in 2..=8 {
            assert_eq!(operators.add(operator(&format!("o{number}"), number)), Ok(()));
        }
        let eight = operators.clone();
        assert_eq!(operators.add(operator("ninth", 9)), Err(AddError::Full));
        assert_eq!(operators, eight);
        assert_eq!(operators.add(operator("anna-maria", 1)), Ok(()));
        assert_eq!(operators.iter().next(), Some(&operator("anna-maria", 1)));
        assert_eq!(operators.find(&Key::new([3; 32]).id()), Some(&operator("o3", 3)));
        operators.revoke("o2".parse().unwrap());
        assert_eq!((operators.names().len(), operators.find(&Key::new([2; 32]).id())), (7, None));
    }

    #[test]
    fn a_key_of_zeros_is_empty_memory_and_none() {
        assert_eq!([0, 1].map(|key| operator("anna", key).has_key()), [false, true]);
    }

    #[test]
    fn debug_output_shows_no_key() {
        let text = format!("{:?}", Operators::from(operator("anna", 0xa5)));
        assert!(text.contains("anna") && !text.contains("165"), "{text}");
    }
}
