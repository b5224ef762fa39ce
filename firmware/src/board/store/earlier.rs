//! Reads the store of earlier releases, which never becomes today's form before it was read whole: a map of the crate
//! `sequential-storage` (8.0), written round the region. Nothing here writes.
//!
//! A sector opens with a word of zeros once it is in use, and ends with one once it is full. In between lie items: CRC-32
//! of the data, its length, CRC-16 of the length, then the data in whole words; the first byte is the key. The sector after the one
//! in use is blank. Before the region goes on to a sector, the items of the sector after it that are in force are copied
//! into it, and that sector is erased.
//!
//! Power may have gone anywhere in that. So items count by their check sums alone, and the order of sectors is not taken
//! from marks that an erasure may have left half risen: such a sector always comes after the one in use.

use core::num::NonZeroU32;

use crc::{Algorithm, Crc, NoTable};
use embedded_storage::nor_flash::NorFlash;

use super::{Entries, FlashStore, Key, Located, SHORTEST_WORD, StoreError};

/// CRC-32 of the data: Castagnoli's polynomial from a start of its own.
static DATA_SUM: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&Algorithm {
    width: 32,
    poly: 0x1EDC_6F41,
    init: 0x7777_7777,
    refin: true,
    refout: true,
    xorout: u32::MAX,
    check: 0,
    residue: 0,
});
/// CRC-16 of the length.
static LENGTH_SUM: Crc<u16, NoTable> = Crc::<u16, NoTable>::new(&Algorithm {
    width: 16,
    poly: 0x7458,
    init: u16::MAX,
    refin: true,
    refout: true,
    xorout: u16::MAX,
    check: 0,
    residue: 0,
});
/// Zero bits in a word that count as a mark.
const MARKED_BITS: u32 = 4;
/// Check sum and length before the data of an item, bytes.
const ITEM_HEAD: u32 = 8;
/// The key before an entry, bytes.
const KEY: usize = size_of::<Key>();
/// So many sectors after the one in use may have been erased by half: the next by an earlier release, and by this one the
/// next that holds nothing in force.
const MOST_AFTER: u32 = 2;
/// Keys from here on were the store's own.
const OWN_KEYS: Key = 254;
/// Fill a sum that would be taken for blank or for an erased item.
const RESERVED: [u8; 2] = [0x00, 0xFF];

/// What a store of earlier releases holds.
pub(super) struct Earlier {
    /// The newest of each entry.
    pub(super) entries: Entries,
    /// A sector that holds none of them.
    pub(super) free: u32,
    /// The mark of the sector in use, if one is.
    pub(super) mark: Option<u32>,
}

/// How a sector is marked.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    /// Neither of the two, or erased by half.
    None,
    Begun,
    Full,
}

impl<F: NorFlash> FlashStore<F> {
    /// Finds the newest entries of earlier releases; none where there is no such store.
    pub(super) fn earlier(&mut self) -> Result<Earlier, StoreError> {
        let sectors = self.sectors()?;
        let Some((current, is_in_use)) = self.current()? else {
            return Ok(Earlier { entries: Entries::new(), free: 0, mark: None });
        };
        let mark = is_in_use.then(|| self.sector_at(current));
        let entries = self.newest_items(current, sectors)?;
        // Power may have gone while items were copied into the sector in use: its copies may be weak, and count on those
        // that they were made from.
        let others = match is_in_use {
            true => self.newest_items((current + sectors - 1) % sectors, sectors - 1)?,
            false => Entries::new(),
        };
        let is_free = |sector: &u32| {
            let from = self.sector_at(*sector);
            let in_sector = from..from + F::ERASE_SIZE as u32;
            entries.iter().chain(&others).all(|entry| !in_sector.contains(&entry.at))
        };
        let mut steps = (1..sectors).map(|step| (current + step) % sectors);
        let free = steps.find(is_free).ok_or(StoreError::Full)?;
        Ok(Earlier { entries, free, mark })
    }

    /// The sector that was written last, and whether it is marked as in use.
    fn current(&mut self) -> Result<Option<(u32, bool)>, StoreError> {
        let sectors = self.sectors()?;
        let mut last_full = None;
        for sector in 0..sectors {
            let use_of_next = self.use_of((sector + 1) % sectors)?;
            match self.use_of(sector)? {
                Use::Begun if !self.is_one_before_in_use(sector)? => {
                    return Ok(Some((sector, true)));
                }
                Use::Full if use_of_next != Use::Full => last_full = Some(sector),
                _ => {}
            }
        }
        Ok(last_full.map(|sector| (sector, false)))
    }

    /// Whether a sector just before this one is in use: then this one was erased by half, and looks like it.
    fn is_one_before_in_use(&mut self, sector: u32) -> Result<bool, StoreError> {
        let sectors = self.sectors()?;
        for before in 1..=MOST_AFTER.min(sectors - 1) {
            if self.use_of((sector + sectors - before) % sectors)? == Use::Begun {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn use_of(&mut self, sector: u32) -> Result<Use, StoreError> {
        let at = self.sector_at(sector);
        let end = at + F::ERASE_SIZE as u32 - Self::WORD as u32;
        let is_marked =
            |word: [u8; SHORTEST_WORD]| u32::from_le_bytes(word).count_zeros() >= MARKED_BITS;
        Ok(match (is_marked(self.word(at)?), is_marked(self.word(end)?)) {
            (true, true) => Use::Full,
            (true, false) => Use::Begun,
            (false, _) => Use::None,
        })
    }

    /// The newest item of each key, in so many sectors from the newest to the oldest.
    fn newest_items(&mut self, newest: u32, sectors: u32) -> Result<Entries, StoreError> {
        let all = self.sectors()?;
        let mut found = Entries::new();
        for age in 0..sectors {
            let mut here = Entries::new();
            self.items((newest + all - age) % all, &mut here)?;
            for item in here {
                if found.iter().all(|newer| newer.key != item.key) {
                    found.push(item).map_err(|_| StoreError::Full)?;
                }
            }
        }
        Ok(found)
    }

    /// The last intact item of each key in a sector.
    fn items(&mut self, sector: u32, found: &mut Entries) -> Result<(), StoreError> {
        let word = Self::WORD as u32;
        let end = self.sector_at(sector) + F::ERASE_SIZE as u32 - word;
        let mut at = self.sector_at(sector) + word;
        while at + ITEM_HEAD <= end {
            let (sum, head) = (self.word(at)?, self.word(at + word)?);
            if (sum, head) == ([0xFF; 4], [0xFF; 4]) {
                break;
            }
            let [low, high, sum_low, sum_high] = head;
            let length = u16::from_le_bytes([low, high]);
            let data_at = at + ITEM_HEAD;
            let is_length = length_sum([low, high]) == u16::from_le_bytes([sum_low, sum_high])
                && data_at + Self::padded(length.into()) <= end;
            if !is_length {
                at += word;
                continue;
            }
            at = data_at + Self::padded(length.into());
            if length == 0 || self.data_sum(data_at, length.into())? != sum {
                continue;
            }
            let [key, ..] = self.word(data_at)?;
            if key < OWN_KEYS {
                let item =
                    Located { key, at: data_at + KEY as u32, length: usize::from(length) - KEY };
                found.retain(|older| older.key != key);
                found.push(item).map_err(|_| StoreError::Full)?;
            }
        }
        Ok(())
    }

    fn data_sum(&mut self, at: u32, length: usize) -> Result<[u8; 4], StoreError> {
        let mut digest = DATA_SUM.digest();
        self.stream(at, length, |_, piece| digest.update(piece))?;
        let sum = digest.finalize();
        let [first, ..] = sum.to_le_bytes();
        let sum = match sum {
            0 => NonZeroU32::MIN.get(),
            _ if RESERVED.contains(&first) => sum ^ 1,
            _ => sum,
        };
        Ok(sum.to_le_bytes())
    }
}

fn length_sum(length: [u8; 2]) -> u16 {
    // All ones would be blank.
    LENGTH_SUM.checksum(&length).min(u16::MAX - 1)
}
