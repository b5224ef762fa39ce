//! A store of settings in which all values of the motors are entered.

use flix_firmware::hardware::SettingsStore;
use flix_firmware::settings::Settings;

#[derive(Default)]
pub(crate) struct KnownMotors(Vec<u8>);

impl KnownMotors {
    pub(crate) fn new() -> Self {
        let mut store = Self::default();
        Settings::DEFAULT.entered().save(&mut store).unwrap();
        store
    }
}

impl SettingsStore for KnownMotors {
    type Error = core::convert::Infallible;

    fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, Self::Error> {
        buffer[..self.0.len()].copy_from_slice(&self.0);
        Ok(Some(self.0.len()))
    }

    fn save(&mut self, bytes: &[u8]) -> Result<(), Self::Error> {
        self.0 = bytes.to_vec();
        Ok(())
    }
}
