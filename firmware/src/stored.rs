//! What is kept over power-off: a value behind the version of its form, with a CRC-32, in `postcard`'s form.

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::hardware::SettingsStore;

pub(crate) static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a stored value was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// The store failed.
    #[error("the settings could not be read")]
    Store,
    /// Damaged, cut short, or out of range.
    #[error("the stored settings are damaged")]
    Damaged,
    /// Written in a form of another version.
    #[error("the stored settings are of another version")]
    Version,
    /// Some are out of range: these have their defaults.
    #[error("some of the stored settings are out of range")]
    OutOfRange,
}

/// A value could not be written; what was stored before is stored still.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the settings could not be written")]
pub struct SaveError;

/// Reads what is stored in the form of this version, by way of `buffer`; `Ok(None)` when nothing ever was.
pub(crate) fn load<T: DeserializeOwned>(
    store: &mut impl SettingsStore,
    version: u16,
    buffer: &mut [u8],
) -> Result<Option<T>, LoadError> {
    let Some(length) = store.load(buffer).map_err(|_| LoadError::Store)? else { return Ok(None) };
    decode(version, buffer.get(..length).ok_or(LoadError::Damaged)?).map(Some)
}

/// Returns the value at the beginning of these bytes, in the form of this version. Never panics.
pub(crate) fn decode<T: DeserializeOwned>(version: u16, bytes: &[u8]) -> Result<T, LoadError> {
    let (stored, value) = postcard::from_bytes_crc32::<(u16, T)>(bytes, CRC.digest())
        .map_err(|_| LoadError::Damaged)?;
    if stored == version { Ok(value) } else { Err(LoadError::Version) }
}

/// Returns the bytes to store of a value, in the form of this version.
pub(crate) fn encode<'a>(
    version: u16,
    value: &impl Serialize,
    buffer: &'a mut [u8],
) -> Result<&'a [u8], SaveError> {
    match postcard::to_slice_crc32(&(version, value), buffer, CRC.digest()) {
        Ok(bytes) => Ok(bytes),
        Err(_) => Err(SaveError),
    }
}
