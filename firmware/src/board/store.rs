//! Settings in flash: one entry of a map that is written round a region of the flash, so that
//! power may go at any moment and either the old or the new bytes are there afterwards
//! (crate `sequential-storage`). Works on any flash that `embedded-storage` describes.

use core::cell::RefCell;
use core::ops::Range;

use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_futures::block_on;
use embedded_storage::nor_flash::NorFlash;
use sequential_storage::Error;
use sequential_storage::cache::{Cache, CacheImpl};
use sequential_storage::map::{MapConfig, MapStorage};

use crate::hardware::SettingsStore;

/// Key of an entry; settings have the first, provisioning the second.
pub type Key = u8;

/// Key of the entry that says whether superseded bytes may still be in flash. Not for callers.
const SWEEP: Key = 254;
/// Key of the entries that a sweep fills the flash with. Not for callers.
const FILLER: Key = 255;
/// Content of the entry [`SWEEP`] when no superseded bytes are in flash.
const SWEPT: &[u8] = &[1];
/// Content of the entry [`SWEEP`] when superseded bytes may be in flash; also what a store without it means.
const UNSWEPT: &[u8] = &[0];
/// Length of an entry that a sweep fills the flash with, bytes.
const FILLER_LENGTH: usize = 960;

/// Longest entry, with its key, rounded up to words of the flash.
const LONGEST: usize = 1024;

/// Why an entry was not read or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// More bytes than fit: an entry, or what the caller has room for.
    #[error("the entry is longer than fits")]
    TooLong,
    /// No room left in the region, or too small a region.
    #[error("the flash region is full or too small")]
    Full,
    /// What is in flash makes no sense.
    #[error("the flash region is corrupted")]
    Corrupted,
    /// The flash itself failed.
    #[error("the flash failed")]
    Flash,
}

impl<E> From<Error<E>> for StoreError {
    fn from(error: Error<E>) -> Self {
        match error {
            Error::FullStorage => Self::Full,
            Error::BufferTooBig | Error::BufferTooSmall(_) | Error::ItemTooBig => Self::TooLong,
            Error::Corrupted { .. } | Error::SerializationError(_) => Self::Corrupted,
            _ => Self::Flash,
        }
    }
}

/// A region of flash that keeps a few short entries.
pub struct FlashStore<F> {
    flash: F,
    region: Range<u32>,
}

impl<F: NorFlash> FlashStore<F> {
    /// Takes a region, which must begin and end at sectors and hold at least two of them. Fewer
    /// than a handful wear out early: each write takes a part of a sector, each full round an
    /// erasure of every sector.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { flash, region }
    }

    fn map(
        &mut self,
    ) -> Result<MapStorage<Key, BlockingAsync<&mut F>, impl CacheImpl<Key>>, StoreError> {
        let config = MapConfig::try_new(self.region.clone()).map_err(|_| StoreError::Full)?;
        Ok(MapStorage::new(BlockingAsync::new(&mut self.flash), config, Cache::new_uncached()))
    }

    /// Copies an entry into `buffer`; `None` when it was never written.
    ///
    /// # Errors
    /// When the flash fails or the entry does not fit.
    pub fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreError> {
        let mut scratch = [0; LONGEST];
        let mut map = self.map()?;
        let Some(bytes) = block_on(map.fetch_item::<&[u8]>(&mut scratch, &key))? else {
            return Ok(None);
        };
        let room = buffer.get_mut(..bytes.len()).ok_or(StoreError::TooLong)?;
        room.copy_from_slice(bytes);
        Ok(Some(bytes.len()))
    }

    /// Replaces an entry. A region of which no sense can be made is erased first.
    ///
    /// # Errors
    /// When the flash fails or the entry does not fit; what was kept before is kept still.
    pub fn save(&mut self, key: Key, bytes: &[u8]) -> Result<(), StoreError> {
        if size_of::<Key>() + bytes.len() > LONGEST {
            return Err(StoreError::TooLong);
        }
        let mut scratch = [0; LONGEST];
        let mut map = self.map()?;
        match block_on(map.store_item(&mut scratch, &key, &bytes)).map_err(StoreError::from) {
            Err(StoreError::Corrupted) => {
                block_on(map.erase_all())?;
                Ok(block_on(map.store_item(&mut scratch, &key, &bytes))?)
            }
            outcome => outcome,
        }
    }

    /// Replaces an entry, and erases from flash what it replaces: [`FlashStore::save`] alone leaves the
    /// old bytes where they are until their sector is needed. When power goes in between, the entry is
    /// the old one or the new one, and [`FlashStore::sweep`] goes on at the next start.
    ///
    /// # Errors
    /// When the flash fails or the entry does not fit. [`FlashStore::load`] says which entry is kept;
    /// old bytes may then still be in flash.
    pub fn save_and_sweep(&mut self, key: Key, bytes: &[u8]) -> Result<(), StoreError> {
        self.save(SWEEP, UNSWEPT)?;
        self.save(key, bytes)?;
        self.sweep()
    }

    /// Erases all superseded bytes from flash, unless this is done already: writes a whole round of
    /// the region, which erases every sector and keeps the newest of every entry. Power may go at
    /// any moment. Takes an erasure of every sector: up to 2.4 s for six.
    ///
    /// # Errors
    /// When the flash fails; what is kept is kept still.
    pub fn sweep(&mut self) -> Result<(), StoreError> {
        let mut state = [0; SWEPT.len()];
        if self.load(SWEEP, &mut state)?.is_some() && state == SWEPT {
            return Ok(());
        }
        let filler = [0; FILLER_LENGTH];
        // One round, and the sector that was in use when it began.
        let round = self.region.end - self.region.start + F::ERASE_SIZE as u32;
        for _ in 0..=round as usize / FILLER_LENGTH {
            self.save(FILLER, &filler)?;
        }
        self.save(FILLER, &[])?;
        self.save(SWEEP, SWEPT)
    }
}

/// One entry of a store that several share, as the robot wants it.
pub struct Entry<'a, F> {
    store: &'a RefCell<FlashStore<F>>,
    key: Key,
}

impl<'a, F> Entry<'a, F> {
    /// Names the entry under a key.
    pub const fn new(store: &'a RefCell<FlashStore<F>>, key: Key) -> Self {
        Self { store, key }
    }
}

impl<F: NorFlash> SettingsStore for Entry<'_, F> {
    type Error = StoreError;

    fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, StoreError> {
        self.store.borrow_mut().load(self.key, buffer)
    }

    fn save(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.store.borrow_mut().save(self.key, bytes)
    }

    fn save_and_sweep(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.store.borrow_mut().save_and_sweep(self.key, bytes)
    }

    fn sweep(&mut self) -> Result<(), StoreError> {
        self.store.borrow_mut().sweep()
    }
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use embedded_storage::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash};

    use super::*;

    const SECTOR: usize = 4096;
    const SECTORS: usize = 6;

    /// Flash whose power goes after so many words written or sectors erased.
    #[derive(Clone)]
    struct Flash {
        bytes: Vec<u8>,
        power: usize,
    }

    #[derive(Debug)]
    struct PowerGone;

    impl NorFlashError for PowerGone {
        fn kind(&self) -> NorFlashErrorKind {
            NorFlashErrorKind::Other
        }
    }

    impl Flash {
        fn new() -> Self {
            Self { bytes: vec![0xFF; SECTOR * SECTORS], power: usize::MAX }
        }

        fn spend(&mut self) -> Result<(), PowerGone> {
            self.power = self.power.checked_sub(1).ok_or(PowerGone)?;
            Ok(())
        }
    }

    impl ErrorType for Flash {
        type Error = PowerGone;
    }

    impl ReadNorFlash for Flash {
        const READ_SIZE: usize = 4;

        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerGone> {
            bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
            Ok(())
        }

        fn capacity(&self) -> usize {
            self.bytes.len()
        }
    }

    impl NorFlash for Flash {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = SECTOR;

        fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerGone> {
            for sector in (from as usize..to as usize).step_by(SECTOR) {
                self.spend()?;
                self.bytes[sector..][..SECTOR].fill(0xFF);
            }
            Ok(())
        }

        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerGone> {
            for (index, byte) in bytes.iter().enumerate() {
                if index % Self::WRITE_SIZE == 0 {
                    self.spend()?;
                }
                self.bytes[offset as usize + index] &= byte;
            }
            Ok(())
        }
    }

    fn store(flash: Flash) -> FlashStore<Flash> {
        FlashStore::new(flash, 0..(SECTOR * SECTORS) as u32)
    }

    fn loaded(store: &mut FlashStore<Flash>, key: Key) -> Option<Vec<u8>> {
        let mut buffer = [0; 512];
        let length = store.load(key, &mut buffer).unwrap()?;
        Some(buffer[..length].to_vec())
    }

    #[test]
    fn empty_flash_holds_nothing() {
        assert_eq!(loaded(&mut store(Flash::new()), 0), None);
    }

    #[test]
    fn the_newest_bytes_come_back_after_many_rounds_of_the_region() {
        let mut store = store(Flash::new());
        store.save(1, b"name and key").unwrap();
        for round in 0..200_u16 {
            store.save(0, &round.to_le_bytes().repeat(150)).unwrap();
        }
        assert_eq!(loaded(&mut store, 0), Some(199_u16.to_le_bytes().repeat(150)));
        assert_eq!(loaded(&mut store, 1), Some(b"name and key".to_vec()));
    }

    #[test]
    fn power_may_go_at_any_word_and_old_or_new_remains() {
        let mut before = store(Flash::new());
        // Nearly a whole round, so that the writes below also erase sectors.
        for _ in 0..57 {
            before.save(0, &[0xAA; 400]).unwrap();
        }
        let mut power = 0;
        loop {
            let mut flash = before.flash.clone();
            flash.power = power;
            let mut interrupted = store(flash);
            let finished = (0..4).all(|_| interrupted.save(0, &[0x55; 400]).is_ok());
            let mut flash = interrupted.flash;
            flash.power = usize::MAX;
            let found = loaded(&mut store(flash), 0).unwrap();
            assert!(found == [0xAA; 400] || found == [0x55; 400], "power for {power} words");
            if finished {
                assert_eq!(found, [0x55; 400]);
                break;
            }
            power += 1;
        }
        assert!(power > 400, "the test never wrote");
    }

    fn holds(flash: &Flash, secret: &[u8]) -> bool {
        flash.bytes.windows(secret.len()).any(|window| window == secret)
    }

    const OLD: &[u8] = b"the old key, which somebody knows";
    const NEW: &[u8] = b"the new key, which nobody knows";

    /// Settings saved so often, then the old key between two of them.
    fn used(saves: usize) -> FlashStore<Flash> {
        let mut store = store(Flash::new());
        for _ in 0..saves {
            store.save(0, &[0xAA; 400]).unwrap();
        }
        store.save(1, OLD).unwrap();
        store.save(0, &[0xBB; 400]).unwrap();
        store
    }

    #[test]
    fn a_replaced_key_is_nowhere_in_flash_wherever_it_was() {
        for saves in 0..70 {
            let mut store = used(saves);
            assert!(holds(&store.flash, OLD));
            store.save_and_sweep(1, NEW).unwrap();
            assert!(!holds(&store.flash, OLD), "after {saves} saves");
            assert_eq!(loaded(&mut store, 1).as_deref(), Some(NEW));
            assert_eq!(loaded(&mut store, 0), Some(vec![0xBB; 400]));
        }
    }

    #[test]
    fn power_may_go_while_a_key_is_replaced_and_the_next_start_erases_the_old_one() {
        let before = used(40);
        let mut power = 0;
        loop {
            let mut flash = before.flash.clone();
            flash.power = power;
            let mut interrupted = store(flash);
            let finished = interrupted.save_and_sweep(1, NEW).is_ok();
            let mut flash = interrupted.flash;
            flash.power = usize::MAX;
            let mut next = store(flash);
            next.sweep().unwrap();
            let key = loaded(&mut next, 1).unwrap();
            assert!(key == OLD || key == NEW, "power for {power} words");
            assert_eq!(holds(&next.flash, OLD), key == OLD, "power for {power} words");
            assert_eq!(loaded(&mut next, 0), Some(vec![0xBB; 400]), "power for {power} words");
            if finished {
                break;
            }
            // Every word at first, then every seventh: a round is some 7000 words.
            power += if power < 100 { 1 } else { 7 };
        }
        assert!(power > 6000, "the test never wrote a round");
    }

    #[test]
    fn a_swept_store_is_not_swept_again() {
        let mut store = used(3);
        store.sweep().unwrap();
        store.flash.power = 0;
        assert_eq!(store.sweep(), Ok(()));
    }

    #[test]
    fn an_entry_that_does_not_fit_is_refused_and_the_old_one_stays() {
        let mut store = store(Flash::new());
        store.save(0, b"old").unwrap();
        assert_eq!(store.save(0, &[0; 2 * LONGEST]), Err(StoreError::TooLong));
        assert_eq!(store.load(0, &mut [0; 2]), Err(StoreError::TooLong));
        assert_eq!(loaded(&mut store, 0), Some(b"old".to_vec()));
    }

    #[test]
    fn rubbish_in_flash_can_be_written_over() {
        let mut flash = Flash::new();
        let mut noise = 0x1234_5678_u32;
        for byte in &mut flash.bytes {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *byte = (noise >> 24) as u8;
        }
        let mut store = store(flash);
        store.save(0, b"new").unwrap();
        assert_eq!(loaded(&mut store, 0), Some(b"new".to_vec()));
    }

    #[test]
    fn a_region_of_one_sector_is_refused() {
        let mut store = FlashStore::new(Flash::new(), 0..SECTOR as u32);
        assert_eq!(store.save(0, b"x"), Err(StoreError::Full));
    }
}
