//! A robot that keeps no settings.

use flix_firmware::hardware::SettingsStore;

pub(crate) struct NoStore;

impl SettingsStore for NoStore {
    type Error = ();
    fn load(&mut self, _buffer: &mut [u8]) -> Result<Option<usize>, ()> {
        Ok(None)
    }
    fn save(&mut self, _bytes: &[u8]) -> Result<(), ()> {
        Ok(())
    }
}
