//! A flash that fails as flash does: power goes within an operation, cells that were left half-way read well and fade,
//! sectors are protected, bits are stuck, reads fail.

use std::vec;
use std::vec::Vec;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

pub(super) const SECTOR: usize = 4096;
pub(super) const SECTORS: usize = 6;

/// What a flash does with what it is to keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Protection {
    /// Keeps it.
    #[default]
    None,
    /// Reports success, and nothing changes.
    Silent,
    /// Reports an error, and nothing changes.
    Reported,
}

/// Where cells rise first while a sector is erased.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Rise {
    /// Anywhere.
    #[default]
    Even,
    /// At the sector's start.
    FromStart,
    /// At its end.
    FromEnd,
}

#[derive(Clone)]
pub(super) struct Flash {
    pub(super) cells: Vec<u8>,
    /// What cells fade to whose last change was cut; elsewhere the same as `cells`.
    faded: Vec<u8>,
    /// Words written and sectors erased until power goes.
    pub(super) power: usize,
    /// Share of the operation that is done when power goes, 0 to 1.
    pub(super) share: f64,
    /// Cells whose change was cut read either way at each start, those too that read unchanged at first.
    pub(super) flickers: bool,
    /// How sectors rise that are cut.
    pub(super) rise: Rise,
    /// Of each sector.
    pub(super) protection: [Protection; SECTORS],
    /// Bits that never change.
    pub(super) stuck: Vec<u8>,
    /// The reads from now on that fail, counted from 0.
    pub(super) failing_read: Option<usize>,
    /// Reads fail for ever from `failing_read` on, rather than once.
    pub(super) fails_for_ever: bool,
    /// Of each operation so far, whether it erased.
    pub(super) operations: Vec<bool>,
    random: u64,
}

#[derive(Debug)]
pub(super) struct PowerGone;

impl NorFlashError for PowerGone {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl Flash {
    pub(super) fn new() -> Self {
        let blank = vec![0xFF; SECTOR * SECTORS];
        Self {
            cells: blank.clone(),
            faded: blank,
            power: usize::MAX,
            share: 0.0,
            flickers: false,
            rise: Rise::Even,
            protection: [Protection::None; SECTORS],
            stuck: vec![0; SECTOR * SECTORS],
            failing_read: None,
            fails_for_ever: false,
            operations: Vec::new(),
            random: 0x9E37_79B9_7F4A_7C15,
        }
    }

    pub(super) fn seeded(seed: u64) -> Self {
        let mut flash = Self::new();
        flash.random ^= seed.wrapping_mul(0xD134_2543_DE82_EF95);
        flash
    }

    /// The same flash, which draws other bits.
    pub(super) fn with_seed(&self, seed: u64) -> Self {
        Self { random: Self::seeded(seed).random, ..self.clone() }
    }

    /// Starts the chip again: power is back, and each cell whose last change was cut fades with this chance.
    pub(super) fn start(&mut self, fading: f64) {
        self.power = usize::MAX;
        for index in 0..self.cells.len() {
            let changed = self.cells[index] ^ self.faded[index];
            if changed != 0 {
                let bits = changed & self.bits(fading);
                self.cells[index] ^= bits;
                if self.flickers {
                    self.faded[index] ^= bits;
                }
            }
        }
    }

    /// Fills everything with noise.
    pub(super) fn fill_with_noise(&mut self) {
        for index in 0..self.cells.len() {
            self.cells[index] = self.bits(0.5);
            self.faded[index] = self.cells[index];
        }
    }

    /// Keeps a drawn bit as it is for ever.
    pub(super) fn stick(&mut self) {
        let at = (self.draw() * (8 * self.stuck.len()) as f64) as usize;
        self.stuck[at / 8] |= 1 << (at % 8);
    }

    pub(super) fn holds(&self, secret: &[u8]) -> bool {
        contains(&self.cells, secret)
    }

    /// Whether it holds this, or may again once cells have faded.
    pub(super) fn may_hold(&self, secret: &[u8]) -> bool {
        self.holds(secret) || contains(&self.faded, secret)
    }

    fn draw(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Eight bits, each set with this chance.
    fn bits(&mut self, chance: f64) -> u8 {
        if chance >= 1.0 {
            return 0xFF;
        }
        (0..8).fold(0, |bits, bit| bits | u8::from(self.draw() < chance) << bit)
    }

    /// Brings a byte to `to`; a change that is cut moves a share of its cells, which fade back.
    fn change(&mut self, index: usize, to: u8, share: Option<f64>) {
        let from = self.cells[index];
        let to = (to & !self.stuck[index]) | (from & self.stuck[index]);
        if let Some(share) = share {
            let moved = (from ^ to) & self.bits(share);
            self.faded[index] = (self.faded[index] & !moved) | (from & moved);
            self.cells[index] = from ^ moved;
            if self.flickers {
                let unsure = from ^ to;
                self.faded[index] = (self.faded[index] & !unsure) | (!self.cells[index] & unsure);
            }
        } else {
            self.cells[index] = to;
        }
    }

    /// Whether power goes in this operation.
    fn spend(&mut self, is_erasure: bool) -> Result<bool, PowerGone> {
        self.operations.push(is_erasure);
        match self.power {
            usize::MAX => Ok(false),
            0 => Err(PowerGone),
            left => {
                self.power = left - 1;
                Ok(self.power == 0)
            }
        }
    }
}

/// Whether these bytes hold a secret; most places differ in the first byte.
fn contains(bytes: &[u8], secret: &[u8]) -> bool {
    bytes.windows(secret.len()).any(|window| window[0] == secret[0] && window == secret)
}

impl ErrorType for Flash {
    type Error = PowerGone;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerGone> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4), "whole words");
        match self.failing_read {
            Some(0) => {
                if !self.fails_for_ever {
                    self.failing_read = None;
                }
                return Err(PowerGone);
            }
            Some(left) => self.failing_read = Some(left - 1),
            None => {}
        }
        bytes.copy_from_slice(&self.cells[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.cells.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerGone> {
        assert!(from.is_multiple_of(SECTOR as u32) && to.is_multiple_of(SECTOR as u32));
        for sector in from as usize / SECTOR..to as usize / SECTOR {
            match self.protection[sector] {
                Protection::Reported => return Err(PowerGone),
                Protection::Silent => continue,
                Protection::None => {}
            }
            let is_cut = self.spend(true)?;
            for index in sector * SECTOR..(sector + 1) * SECTOR {
                let place = (index % SECTOR) as f64 / SECTOR as f64;
                let share = match self.rise {
                    Rise::Even => self.share,
                    Rise::FromStart => f64::from(u8::from(place < self.share)),
                    Rise::FromEnd => f64::from(u8::from(1.0 - place <= self.share)),
                };
                self.change(index, 0xFF, is_cut.then_some(share));
                if !is_cut {
                    self.faded[index] = self.cells[index];
                }
            }
            if is_cut {
                return Err(PowerGone);
            }
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerGone> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4), "whole words");
        for (at, word) in (offset as usize..).step_by(4).zip(bytes.chunks(4)) {
            match self.protection[at / SECTOR] {
                Protection::Reported => return Err(PowerGone),
                Protection::Silent => continue,
                Protection::None => {}
            }
            let is_cut = self.spend(false)?;
            for (index, byte) in (at..).zip(word) {
                let to = self.cells[index] & byte;
                self.change(index, to, is_cut.then_some(self.share));
                if !is_cut {
                    // What was programmed to its end stays; what was left half risen stays so.
                    self.faded[index] &= byte | self.stuck[index];
                }
            }
            if is_cut {
                return Err(PowerGone);
            }
        }
        Ok(())
    }
}
