//! A robot that knows its motors, and keeps no settings.

use flix_firmware::hardware::SettingsStore;
use flix_firmware::settings::Settings;

pub(crate) struct NoStore;

/// Bytes for a store to hold.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl SettingsStore for Bytes {
    type Error = ();
    fn load(&mut self, _buffer: &mut [u8]) -> Result<Option<usize>, ()> {
        Ok(None)
    }
    fn save(&mut self, bytes: &[u8]) -> Result<(), ()> {
        self.0 = bytes.to_vec();
        Ok(())
    }
}

impl SettingsStore for NoStore {
    type Error = ();
    fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, ()> {
        let mut known = Bytes::default();
        Settings::DEFAULT.entered().save(&mut known).map_err(drop)?;
        buffer[..known.0.len()].copy_from_slice(&known.0);
        Ok(Some(known.0.len()))
    }
    fn save(&mut self, _bytes: &[u8]) -> Result<(), ()> {
        Ok(())
    }
}
