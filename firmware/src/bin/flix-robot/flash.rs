//! The flash: the partition that keeps settings and provisioning, and erasing under a watchdog that waits.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use esp_bootloader_esp_idf::partitions::{
    self, DataPartitionSubType, PARTITION_TABLE_MAX_LEN, PartitionType,
};
use esp_storage::FlashStorage;

use crate::chip::parking;
use crate::{fast, watchdog};

/// Key of the robot's settings.
pub(crate) const SETTINGS: u8 = 0;
/// Key of network, name and key.
pub(crate) const PROVISIONING: u8 = 1;

/// The chip's flash. While a sector is erased, up to 400 ms, no code runs from it on any core, so
/// the watchdog waits; the robot writes only while its motors are not driven.
pub(crate) struct Flash(FlashStorage<'static>);

impl Flash {
    /// Takes the flash. The other core, if any, is parked while it is written.
    pub(crate) fn new(flash: FlashStorage<'static>) -> Self {
        Self(crate::chip::share_with_other_core(flash))
    }

    /// Returns the standard partition table's `nvs`, which nothing else uses here.
    pub(crate) fn region(&mut self) -> Option<Range<u32>> {
        let mut buffer = [0; PARTITION_TABLE_MAX_LEN];
        let table = partitions::read_partition_table(&mut self.0, &mut buffer).ok()?;
        let wanted = PartitionType::Data(DataPartitionSubType::Nvs);
        let partition = table.find_partition(wanted).ok()??;
        Some(partition.offset()..partition.offset() + partition.len())
    }
}

impl ErrorType for Flash {
    type Error = <FlashStorage<'static> as ErrorType>::Error;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = <FlashStorage<'static> as ReadNorFlash>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        ReadNorFlash::read(&mut self.0, offset, bytes)
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = <FlashStorage<'static> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = <FlashStorage<'static> as NorFlash>::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        for sector in (from..to).step_by(Self::ERASE_SIZE) {
            watchdog::feed();
            fast::with_patient_watchdog(|| {
                parking(|| NorFlash::erase(&mut self.0, sector, sector + Self::ERASE_SIZE as u32))
            })?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        parking(|| NorFlash::write(&mut self.0, offset, bytes))
    }
}
