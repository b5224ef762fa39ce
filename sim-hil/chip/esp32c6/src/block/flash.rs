//! The flash: bits only fall, sectors erase, both take their time, and power may go in the middle. A cell whose change was
//! cut may read well, take a write, and fade later to what it was ([`Flash::fade`]).
//!
//! Times are those of a Winbond W25Q32JV (data sheet revision G, table 9.6).

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use super::CYCLES_PER_SECOND;

/// Bytes.
pub const FLASH_BYTES: usize = 0x40_0000;
/// Erased at once.
pub const SECTOR_BYTES: usize = 4_096;
/// Programmed at once.
const PAGE_BYTES: usize = 256;
/// Typical time, 3 ms at most.
const PROGRAM_PAGE: Duration = Duration::from_micros(400);
/// Longest time, which watchdogs have to bear; 45 ms typically.
const ERASE_SECTOR: Duration = Duration::from_millis(400);
/// Reading over four lines at 40 MHz.
const READ_CYCLES_A_BYTE: u64 = 8;

/// An operation that changes the flash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Operation {
    /// Of a piece of a page.
    Program {
        /// Address of the first byte.
        at: usize,
        /// What is written.
        bytes: Vec<u8>,
    },
    /// Of a sector.
    Erase {
        /// Address of its first byte.
        at: usize,
    },
}

/// The memory, and what was done to it.
#[derive(Debug, Clone)]
pub struct Flash {
    cells: Vec<u8>,
    /// Bits whose last change was cut, by their byte's address.
    weak: BTreeMap<usize, u8>,
    /// Operations since power-on of the emulation.
    operations: Vec<Operation>,
    /// Where operations ever began.
    touched: BTreeSet<usize>,
    /// The operation in which power goes, counted from the first, and how much of it is done by then.
    cut: Option<(usize, f64)>,
    random: u64,
}

/// Power went in the middle of an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PowerLost;

impl Default for Flash {
    fn default() -> Self {
        Self::new()
    }
}

impl Flash {
    /// Creates an erased flash.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cells: vec![0xFF; FLASH_BYTES],
            weak: BTreeMap::new(),
            operations: Vec::new(),
            touched: BTreeSet::new(),
            cut: None,
            random: 0x9E37_79B9_7F4A_7C15,
        }
    }

    /// Returns the contents.
    #[must_use]
    pub fn cells(&self) -> &[u8] {
        &self.cells
    }

    /// Writes as a programmer would, before the chip runs.
    pub fn burn(&mut self, at: usize, bytes: &[u8]) {
        if let Some(cells) = self.cells.get_mut(at..at + bytes.len()) {
            cells.copy_from_slice(bytes);
        }
    }

    /// Returns what was done to it so far.
    #[must_use]
    pub fn operations(&self) -> &[Operation] {
        &self.operations
    }

    /// Addresses at which it was ever changed.
    pub(crate) fn touched(&self) -> impl Iterator<Item = usize> {
        self.touched.iter().copied()
    }

    /// Forgets what was done, and lets power go in the middle of an operation from now on, counted from 0, when a share
    /// of it (0 to 1) is done.
    pub fn cut_power_in(&mut self, cut: Option<(usize, f64)>) {
        self.operations.clear();
        self.cut = cut;
    }

    /// Returns the flash after these operations, in whose last power goes when a share of it (0 to 1) is done.
    #[must_use]
    pub fn cut(&self, operations: &[Operation], share: f64) -> Self {
        let mut flash = self.clone();
        flash.cut_power_in(operations.len().checked_sub(1).map(|last| (last, share)));
        for operation in operations {
            // The last one loses power; all were within the flash before.
            let _ = match operation {
                Operation::Program { at, bytes } => flash.program(*at, bytes),
                Operation::Erase { at } => flash.erase(at / SECTOR_BYTES),
            };
        }
        flash.cut_power_in(None);
        flash
    }

    /// Lets each cell whose last change was cut fade with this chance (0 to 1) to what it was before.
    pub fn fade(&mut self, chance: f64) {
        for (at, bits) in std::mem::take(&mut self.weak) {
            let faded = bits & self.chosen_bits(chance);
            self.cells[at] ^= faded;
            if bits != faded {
                self.weak.insert(at, bits & !faded);
            }
        }
    }

    /// Notes which bits of a byte were changed by an operation that was cut.
    fn weaken(&mut self, at: usize, before: u8) {
        let bits = self.cells[at] ^ before;
        if bits != 0 {
            *self.weak.entry(at).or_default() |= bits;
        }
    }

    fn random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }

    /// The share of the operation that is carried out, `None` for all of it.
    fn begin(&mut self, operation: Operation) -> Option<f64> {
        let number = self.operations.len();
        let (Operation::Program { at, .. } | Operation::Erase { at }) = operation;
        self.touched.insert(at);
        self.operations.push(operation);
        self.cut.filter(|(at, _)| *at == number).map(|(_, share)| share)
    }

    /// Reads bytes; returns the cycles that it takes.
    pub(crate) fn read(&self, at: usize, bytes: &mut [u8]) -> Option<u64> {
        bytes.copy_from_slice(self.cells.get(at..at + bytes.len())?);
        Some(bytes.len() as u64 * READ_CYCLES_A_BYTE)
    }

    /// Programs bytes; returns the cycles that it takes, `None` beyond the end.
    pub(crate) fn program(&mut self, at: usize, bytes: &[u8]) -> Option<Result<u64, PowerLost>> {
        self.cells.get(at..at + bytes.len())?;
        let mut cycles = 0;
        let mut done = 0;
        while done < bytes.len() {
            let start = at + done;
            let length = (PAGE_BYTES - start % PAGE_BYTES).min(bytes.len() - done);
            let piece = &bytes[done..done + length];
            match self.begin(Operation::Program { at: start, bytes: piece.to_vec() }) {
                None => {
                    for (cell, byte) in self.cells[start..].iter_mut().zip(piece) {
                        *cell &= byte;
                    }
                    for (at, byte) in (start..).zip(piece) {
                        if let Some(bits) = self.weak.get_mut(&at) {
                            *bits &= byte;
                        }
                    }
                }
                Some(share) => {
                    // Each bit that is to fall has fallen or not.
                    for (index, byte) in piece.iter().enumerate() {
                        let fallen = self.chosen_bits(share);
                        let before = self.cells[start + index];
                        self.cells[start + index] &= byte | !fallen;
                        self.weaken(start + index, before);
                    }
                    return Some(Err(PowerLost));
                }
            }
            cycles += cycles_in(PROGRAM_PAGE);
            done += length;
        }
        Some(Ok(cycles))
    }

    /// Erases the sector with the given number; cycles that it takes. `None` beyond the end.
    pub(crate) fn erase(&mut self, sector: usize) -> Option<Result<u64, PowerLost>> {
        let at = sector * SECTOR_BYTES;
        self.cells.get(at..at + SECTOR_BYTES)?;
        match self.begin(Operation::Erase { at }) {
            None => {
                self.cells[at..at + SECTOR_BYTES].fill(0xFF);
                self.weak.retain(|byte, _| !(at..at + SECTOR_BYTES).contains(byte));
            }
            Some(share) => {
                for index in at..at + SECTOR_BYTES {
                    let risen = self.chosen_bits(share);
                    let before = self.cells[index];
                    self.cells[index] |= risen;
                    self.weaken(index, before);
                }
                return Some(Err(PowerLost));
            }
        }
        Some(Ok(cycles_in(ERASE_SECTOR)))
    }

    /// Eight bits, each set with this chance.
    fn chosen_bits(&mut self, chance: f64) -> u8 {
        (0..8).fold(0, |bits, bit| {
            let draw = (self.random() >> 11) as f64 / (1_u64 << 53) as f64;
            bits | u8::from(draw < chance) << bit
        })
    }
}

fn cycles_in(time: Duration) -> u64 {
    time.as_micros() as u64 * (CYCLES_PER_SECOND / 1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_only_fall_until_their_sector_is_erased() {
        let mut flash = Flash::new();
        flash.program(0, &[0xF0]).unwrap().unwrap();
        flash.program(0, &[0x0F]).unwrap().unwrap();
        assert_eq!(flash.cells()[0], 0);
        let cycles = flash.erase(0).unwrap().unwrap();
        assert_eq!(flash.cells()[0], 0xFF);
        assert_eq!(cycles, CYCLES_PER_SECOND * 400 / 1_000);
    }

    #[test]
    fn power_that_goes_within_an_operation_leaves_it_half_done() {
        let mut flash = Flash::new();
        flash.cut_power_in(Some((1, 0.5)));
        flash.program(0, &[0; 64]).unwrap().unwrap();
        assert_eq!(flash.erase(0).unwrap(), Err(PowerLost));
        let risen: u32 = flash.cells()[..64].iter().map(|byte| byte.count_ones()).sum();
        assert!((100..412).contains(&risen), "{risen} of 512 bits");
    }

    #[test]
    fn what_a_cut_erasure_left_blank_takes_a_write_and_fades() {
        let mut flash = Flash::new();
        flash.program(0, &[0; 64]).unwrap().unwrap();
        flash.cut_power_in(Some((0, 1.0)));
        assert_eq!(flash.erase(0).unwrap(), Err(PowerLost));
        assert_eq!(flash.cells()[..64], [0xFF; 64]);
        flash.cut_power_in(None);
        flash.program(0, &[0xF0; 64]).unwrap().unwrap();
        assert_eq!(flash.cells()[..64], [0xF0; 64]);
        flash.fade(1.0);
        assert_eq!(flash.cells()[..64], [0; 64]);
        flash.erase(0).unwrap().unwrap();
        flash.fade(1.0);
        assert_eq!(flash.cells()[..64], [0xFF; 64]);
    }
}
