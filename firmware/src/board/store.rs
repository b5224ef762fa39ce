//! A few short entries in flash: settings, provisioning. Power may go at any moment, within an erasure too, and
//! either the old or the new bytes are there after every start that follows. Works on any flash that
//! `embedded-storage` describes whose words may be programmed again with the same bits.
//!
//! A *copy* is all entries in one sector. Saving writes a whole copy into another sector; the newest complete one counts:
//!
//! | word | holds |
//! |---|---|
//! | 0 | nothing: a sector where something stands here holds no copy |
//! | 1 | the mark *complete*: zero once the copy has been written and read back |
//! | 2 | the mark *swept*: zero once all other sectors have been erased and read back; where no copy is, this sector |
//! | 3 | head, 16 bytes: format, counter, length, whether it owes a sweep, CRC-32 |
//! | 7 | entries: key and length in a word, then the bytes in whole words |
//! | last | nothing, as word 0 |
//!
//! What is written last decides, and no cell is trusted whose last change may have been cut (it reads well, and fades):
//!
//! - A sector is erased in the same step that writes it, whatever it reads: nothing is ever written to a sector that was
//!   found blank.
//! - The mark *complete* is begun after the last of the copy. A mark that reads zero says that the copy is whole;
//!   the mark itself may be weak, so it is programmed again before any other sector is erased.
//! - A copy that replaces a key owes a sweep, as do all that follow it, until one has the mark *swept*: the sweep goes on at
//!   the next start.
//! - What lies in a copy that was not completed was never in force, and may be a key: the next start erases it, and what
//!   reads blank but is not marked as erased.
//! - Everything that is written or erased is read back: flash that does not take it is an error.
//! - Once all superseded bytes are erased, flash holds two copies of the entries: a damaged word in one copy loses no entry.

use core::cell::RefCell;
use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;

use crate::hardware::SettingsStore;
use crate::stored::CRC;

/// Key of an entry; settings have the first, provisioning the second.
pub type Key = u8;

/// Longest entry, with its key, bytes.
const LONGEST: usize = 1024;
/// Most entries.
const MOST_ENTRIES: usize = 16;
/// Bytes that are read or written at once, in a buffer of the flash's alignment.
const CHUNK: usize = 256;
/// Shortest word, bytes: marks are one, and must not come about by chance.
const SHORTEST_WORD: usize = 4;
/// What a word reads like that was erased.
const BLANK_WORD: [u8; SHORTEST_WORD] = [0xFF; SHORTEST_WORD];
/// What a mark reads like that is set.
const ZERO_WORD: [u8; SHORTEST_WORD] = [0; SHORTEST_WORD];
/// Times that reading is tried before it counts as failed.
const READ_TRIES: usize = 3;
/// Length of a copy's head, bytes.
const HEAD: usize = 16;
/// Begins a head: this form of a copy.
const FORMAT: [u8; 4] = *b"flx2";
/// Fewest sectors: a copy and the one that replaces it.
const FEWEST_SECTORS: u32 = 2;

/// Why an entry was not read or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// More bytes than fit: an entry, or what the caller has room for.
    #[error("the entry is longer than fits")]
    TooLong,
    /// No room for all entries in a sector, or too small a region.
    #[error("the flash region is full or too small")]
    Full,
    /// The flash reported an error.
    #[error("the flash failed")]
    Flash,
    /// The flash reported success, but other bytes come back.
    #[error("the flash does not keep what is written")]
    NotKept,
}

/// A buffer as flash drivers want it: those of the chips copy by way of a whole sector on the stack otherwise.
#[repr(align(4))]
struct Chunk([u8; CHUNK]);

impl Chunk {
    const BLANK: Self = Self([0xFF; CHUNK]);
}

/// Where the bytes of an entry lie.
#[derive(Debug, Clone, Copy)]
struct Located {
    key: Key,
    /// From the start of the flash.
    at: u32,
    length: usize,
}

type Entries = Vec<Located, MOST_ENTRIES>;

/// A complete copy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Copy {
    sector: u32,
    counter: u32,
    /// Bytes of its entries, in whole words.
    length: u32,
    owes_sweep: bool,
    is_swept: bool,
}

impl Copy {
    const fn has_superseded(self) -> bool {
        self.owes_sweep && !self.is_swept
    }
}

/// What is in a sector.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Content {
    /// Nothing, and that it was erased to the end.
    Erased,
    /// Nothing; it was never written, or erased and that was cut.
    Blank,
    /// A part of a copy that was not completed, or that was erased by half.
    Unfinished,
    /// A copy, or something else's.
    Other,
}

/// What the flash holds.
struct Mounted {
    newest: Option<Copy>,
    entries: Entries,
}

impl Mounted {
    /// Returns whether superseded bytes may be in flash. Without a copy, flash holds unknown bytes.
    fn has_superseded(&self) -> bool {
        self.newest.is_none_or(Copy::has_superseded)
    }
}

/// A region of flash that keeps a few short entries.
pub struct FlashStore<F> {
    flash: F,
    region: Range<u32>,
}

impl<F: NorFlash> FlashStore<F> {
    /// Bytes that are read and written together.
    const WORD: usize = {
        let word = if F::READ_SIZE > F::WRITE_SIZE { F::READ_SIZE } else { F::WRITE_SIZE };
        let word = if word > SHORTEST_WORD { word } else { SHORTEST_WORD };
        assert!(HEAD.is_multiple_of(word) && CHUNK.is_multiple_of(word));
        assert!(F::ERASE_SIZE.is_multiple_of(CHUNK));
        word
    };
    const COMPLETE_AT: u32 = Self::WORD as u32;
    const SWEPT_AT: u32 = 2 * Self::WORD as u32;
    const HEAD_AT: u32 = 3 * Self::WORD as u32;
    const ENTRIES_AT: u32 = Self::HEAD_AT + HEAD as u32;
    /// Most bytes of the entries of a copy.
    const ROOM: u32 = F::ERASE_SIZE as u32 - Self::ENTRIES_AT - Self::WORD as u32;

    /// Takes a region, which must begin and end at sectors and hold at least two of them. Each save takes an erasure of one
    /// of them in turn.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { flash, region }
    }

    /// Copies an entry into `buffer`; `None` when it was never written.
    ///
    /// # Errors
    /// When the flash fails or the entry does not fit.
    pub fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreError> {
        let entries = self.mount()?.entries;
        let Some(entry) = entries.iter().find(|entry| entry.key == key) else { return Ok(None) };
        let mut rest = buffer.get_mut(..entry.length).ok_or(StoreError::TooLong)?;
        self.stream(entry.at, entry.length, |_, piece| {
            if let Some((room, more)) = core::mem::take(&mut rest).split_at_mut_checked(piece.len())
            {
                room.copy_from_slice(piece);
                rest = more;
            }
        })?;
        Ok(Some(entry.length))
    }

    /// Replaces an entry. Takes an erasure of a sector: 45 ms typically, up to 400 ms.
    ///
    /// # Errors
    /// When the flash fails, does not keep it, or the entry does not fit; what was kept before is kept still.
    pub fn save(&mut self, key: Key, bytes: &[u8]) -> Result<(), StoreError> {
        let mounted = self.mount()?;
        self.replace(&mounted, Some((key, bytes)), mounted.has_superseded())
    }

    /// Replaces an entry, and erases from flash what it replaces: [`FlashStore::save`] alone leaves the
    /// old bytes where they are until their sector is needed. When power goes in between, the entry is
    /// the old one or the new one, and [`FlashStore::sweep`] goes on at the next start.
    ///
    /// # Errors
    /// When the flash fails, does not keep the entry, or it does not fit. [`FlashStore::load`] says which entry is
    /// kept; old bytes may then still be in flash.
    pub fn save_and_sweep(&mut self, key: Key, bytes: &[u8]) -> Result<(), StoreError> {
        let mounted = self.mount()?;
        self.replace(&mounted, Some((key, bytes)), true)?;
        self.sweep()
    }

    /// Erases all superseded bytes from flash, unless they are erased already: every sector but that of the newest copy, and the
    /// remains of copies that were not completed. Then writes a second copy, unless flash refuses that. A loss of power at any
    /// moment loses no entry. Takes up to 2.8 s for six sectors.
    ///
    /// # Errors
    /// When the flash fails, or a sector still holds something afterwards; what is kept is kept still.
    pub fn sweep(&mut self) -> Result<(), StoreError> {
        match self.newest()?.filter(|newest| newest.has_superseded()) {
            None => self.clear_remains()?,
            Some(newest) => {
                self.strengthen(newest);
                for sector in (0..self.sectors()?).filter(|sector| *sector != newest.sector) {
                    self.clear(sector)?;
                }
                self.set_mark(self.sector_at(newest.sector) + Self::SWEPT_AT)?;
            }
        }
        // One copy is enough for all but damage.
        let _ = self.duplicate();
        Ok(())
    }

    /// Writes a second copy of the newest copy, unless a second intact copy exists.
    fn duplicate(&mut self) -> Result<(), StoreError> {
        let mounted = self.mount()?;
        let Some(newest) = mounted.newest else { return Ok(()) };
        for sector in (0..self.sectors()?).filter(|sector| *sector != newest.sector) {
            if let Some(copy) = self.head(sector)?
                && self.is_intact(copy)?
            {
                return Ok(());
            }
        }
        self.replace(&mounted, None, false)
    }

    /// Erases what is left of copies that were not completed, and sectors that look erased without the mark of it: those
    /// first, so that a store that was used never looks like a new one.
    fn clear_remains(&mut self) -> Result<(), StoreError> {
        let mut is_new = true;
        for sector in 0..self.sectors()? {
            is_new &= self.content(sector)? == Content::Blank;
        }
        if is_new {
            return Ok(());
        }
        for content in [Content::Blank, Content::Unfinished] {
            for sector in 0..self.sectors()? {
                if self.content(sector)? == content {
                    self.clear(sector)?;
                }
            }
        }
        Ok(())
    }

    /// Erases a sector, reads that back, and marks it as erased. One that cannot be erased and holds nothing never held
    /// anything.
    fn clear(&mut self, sector: u32) -> Result<(), StoreError> {
        let erased = self.erase(sector);
        self.check_blank(sector).map_err(|error| erased.err().unwrap_or(error))?;
        // Without the mark it is erased again at the next start.
        let _ = self.set_mark(self.sector_at(sector) + Self::SWEPT_AT);
        Ok(())
    }

    /// Looks at what is in a sector.
    fn content(&mut self, sector: u32) -> Result<Content, StoreError> {
        let at = self.sector_at(sector);
        if self.word(at)? != BLANK_WORD || self.is_marked(at + Self::COMPLETE_AT)? {
            return Ok(Content::Other);
        }
        let mark = Self::SWEPT_AT as usize..Self::SWEPT_AT as usize + Self::WORD;
        let mut is_blank = true;
        self.stream(at, F::ERASE_SIZE, |from, piece| {
            let mut bytes = (from..).zip(piece);
            is_blank &= bytes.all(|(place, byte)| *byte == 0xFF || mark.contains(&place));
        })?;
        Ok(match self.word(at + Self::SWEPT_AT)? {
            _ if !is_blank => Content::Unfinished,
            BLANK_WORD => Content::Blank,
            ZERO_WORD => Content::Erased,
            _ => Content::Unfinished,
        })
    }

    /// Number of sectors.
    fn sectors(&self) -> Result<u32, StoreError> {
        let sector = F::ERASE_SIZE as u32;
        let is_whole =
            self.region.start.is_multiple_of(sector) && self.region.end.is_multiple_of(sector);
        let sectors = self.region.end.saturating_sub(self.region.start) / sector;
        if is_whole && sectors >= FEWEST_SECTORS { Ok(sectors) } else { Err(StoreError::Full) }
    }

    const fn sector_at(&self, sector: u32) -> u32 {
        self.region.start + sector * F::ERASE_SIZE as u32
    }

    /// Looks at the flash as after a start: nothing is remembered between two calls.
    fn mount(&mut self) -> Result<Mounted, StoreError> {
        let newest = self.newest()?;
        let entries = newest.map_or(Ok(Entries::new()), |newest| self.entries(newest))?;
        Ok(Mounted { newest, entries })
    }

    /// Finds the newest complete copy.
    fn newest(&mut self) -> Result<Option<Copy>, StoreError> {
        let order = |copy: &Copy| (copy.counter, copy.sector);
        let mut below = None;
        loop {
            let mut best: Option<Copy> = None;
            for sector in 0..self.sectors()? {
                let Some(copy) = self.head(sector)? else { continue };
                let is_left = below.as_ref().is_none_or(|below| order(&copy) < order(below));
                if is_left && best.as_ref().is_none_or(|best| order(&copy) > order(best)) {
                    best = Some(copy);
                }
            }
            let Some(found) = best else { return Ok(None) };
            if self.is_intact(found)? {
                return Ok(Some(found));
            }
            below = Some(found);
        }
    }

    /// Reads the head of a copy that is marked as complete. Its check sum is for [`FlashStore::is_intact`].
    fn head(&mut self, sector: u32) -> Result<Option<Copy>, StoreError> {
        let at = self.sector_at(sector);
        let end = at + F::ERASE_SIZE as u32 - Self::WORD as u32;
        if self.word(at)? != BLANK_WORD
            || self.word(end)? != BLANK_WORD
            || !self.is_marked(at + Self::COMPLETE_AT)?
        {
            return Ok(None);
        }
        let is_swept = self.is_marked(at + Self::SWEPT_AT)?;
        let [format, counter, length, _] = self.head_words(sector)?;
        let length = u32::from_le_bytes(length);
        let copy = Copy {
            sector,
            counter: u32::from_le_bytes(counter),
            length: length >> 1,
            owes_sweep: length & 1 == 1,
            is_swept,
        };
        let fits = copy.length <= Self::ROOM && (copy.length as usize).is_multiple_of(Self::WORD);
        Ok((format == FORMAT && fits).then_some(copy))
    }

    /// Format, counter, length and whether it owes a sweep, check sum.
    fn head_words(&mut self, sector: u32) -> Result<[[u8; 4]; HEAD / 4], StoreError> {
        let mut words = [[0; 4]; HEAD / 4];
        let at = self.sector_at(sector) + Self::HEAD_AT;
        self.stream(at, HEAD, |_, head| {
            for (word, bytes) in words.iter_mut().zip(head.chunks_exact(4)) {
                word.copy_from_slice(bytes);
            }
        })?;
        Ok(words)
    }

    /// Whether a copy has its check sum, in one of a few readings.
    fn is_intact(&mut self, copy: Copy) -> Result<bool, StoreError> {
        for _ in 0..READ_TRIES {
            let [format, counter, length, sum] = self.head_words(copy.sector)?;
            if self.sum(copy.sector, copy.length, [format, counter, length])? == sum {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The check sum of the entries in a sector, and of the head before them.
    fn sum(&mut self, sector: u32, length: u32, head: [[u8; 4]; 3]) -> Result<[u8; 4], StoreError> {
        let mut digest = CRC.digest();
        let at = self.sector_at(sector) + Self::ENTRIES_AT;
        self.stream(at, length as usize, |_, piece| digest.update(piece))?;
        digest.update(head.as_flattened());
        Ok(digest.finalize().to_le_bytes())
    }

    /// Where the entries of a copy lie.
    fn entries(&mut self, copy: Copy) -> Result<Entries, StoreError> {
        let mut entries = Entries::new();
        let mut at = self.sector_at(copy.sector) + Self::ENTRIES_AT;
        let end = at + copy.length;
        while at < end {
            let [key, _, length @ ..] = self.word(at)?;
            let length = usize::from(u16::from_le_bytes(length));
            let entry = Located { key, at: at + Self::WORD as u32, length };
            entries.push(entry).map_err(|_| StoreError::Full)?;
            at = entry.at + Self::padded(length);
        }
        Ok(entries)
    }

    /// The length of as many whole words, bytes.
    const fn padded(length: usize) -> u32 {
        length.next_multiple_of(Self::WORD) as u32
    }

    /// Writes the mounted entries, at most one of them replaced, to the first sector that accepts a copy.
    fn replace(
        &mut self,
        mounted: &Mounted,
        replaced: Option<(Key, &[u8])>,
        owes_sweep: bool,
    ) -> Result<(), StoreError> {
        if replaced.is_some_and(|(_, bytes)| size_of::<Key>() + bytes.len() > LONGEST) {
            return Err(StoreError::TooLong);
        }
        let sectors = self.sectors()?;
        let (counter, first, tries) = match mounted.newest {
            Some(newest) => {
                self.strengthen(newest);
                (newest.counter, newest.sector + 1, sectors - 1)
            }
            None => (0, 0, sectors),
        };
        let mut outcome = Err(StoreError::Full);
        for step in 0..tries {
            let sector = (first + step) % sectors;
            // Each try has a number of its own: what one left behind is no copy of another.
            outcome = self.write_copy(
                sector,
                counter.saturating_add(step + 1),
                &mounted.entries,
                replaced,
                owes_sweep,
            );
            if matches!(outcome, Ok(()) | Err(StoreError::Full)) {
                break;
            }
        }
        outcome
    }

    fn write_copy(
        &mut self,
        sector: u32,
        counter: u32,
        entries: &Entries,
        replaced: Option<(Key, &[u8])>,
        owes_sweep: bool,
    ) -> Result<(), StoreError> {
        let is_kept = |kept: &&Located| replaced.is_none_or(|(key, _)| kept.key != key);
        let kept = || entries.iter().filter(is_kept);
        let size = |length: usize| Self::WORD as u32 + Self::padded(length);
        let lengths = kept().map(|kept| kept.length).chain(replaced.map(|(_, bytes)| bytes.len()));
        let (count, length) = lengths.fold((0, 0), |(count, sum), it| (count + 1, sum + size(it)));
        if length > Self::ROOM || count > MOST_ENTRIES {
            return Err(StoreError::Full);
        }
        self.erase(sector)?;
        self.check_blank(sector)?;
        let mut at = self.sector_at(sector) + Self::ENTRIES_AT;
        for kept in kept() {
            at = self.write_entry(at, kept.key, Source::Flash(kept.at, kept.length))?;
        }
        if let Some((key, bytes)) = replaced {
            self.write_entry(at, key, Source::Memory(bytes))?;
        }
        let words =
            [FORMAT, counter.to_le_bytes(), (length << 1 | u32::from(owes_sweep)).to_le_bytes()];
        let [format, counter_bytes, length_bytes] = words;
        let sum = self.sum(sector, length, words)?;
        let mut head = Chunk::BLANK;
        head.0[..HEAD].copy_from_slice([format, counter_bytes, length_bytes, sum].as_flattened());
        self.write(self.sector_at(sector) + Self::HEAD_AT, &head.0[..HEAD])?;
        let copy = Copy { sector, counter, length, owes_sweep, is_swept: false };
        if !self.is_intact(copy)? {
            return Err(StoreError::NotKept);
        }
        self.set_mark(self.sector_at(sector) + Self::COMPLETE_AT)?;
        // As the next start will.
        if self.newest()? == Some(copy) { Ok(()) } else { Err(StoreError::NotKept) }
    }

    /// Writes an entry; returns where the next one begins.
    fn write_entry(&mut self, at: u32, key: Key, source: Source<'_>) -> Result<u32, StoreError> {
        let length = match source {
            Source::Flash(_, length) => length,
            Source::Memory(bytes) => bytes.len(),
        };
        let [low, high] = (length as u16).to_le_bytes();
        let mut chunk = Chunk::BLANK;
        chunk.0[..SHORTEST_WORD].copy_from_slice(&[key, 0xFF, low, high]);
        self.write(at, &chunk.0[..Self::WORD])?;
        let at = at + Self::WORD as u32;
        for done in (0..length).step_by(CHUNK) {
            let piece = CHUNK.min(length - done);
            let mut chunk = Chunk::BLANK;
            self.fill(&mut chunk, source, done, piece)?;
            self.write(at + done as u32, &chunk.0[..Self::padded(piece) as usize])?;
            // The source is read again, too: one wrong reading must not be kept.
            let mut again = Chunk::BLANK;
            self.fill(&mut again, source, done, piece)?;
            if chunk.0 != again.0 {
                return Err(StoreError::Flash);
            }
        }
        Ok(at + Self::padded(length))
    }

    /// Copies a piece of a source into a chunk.
    fn fill(
        &mut self,
        chunk: &mut Chunk,
        source: Source<'_>,
        done: usize,
        piece: usize,
    ) -> Result<(), StoreError> {
        match source {
            Source::Memory(bytes) => {
                chunk.0[..piece].copy_from_slice(&bytes[done..][..piece]);
                Ok(())
            }
            Source::Flash(at, _) => self.stream(at + done as u32, piece, |from, bytes| {
                chunk.0[from..][..bytes.len()].copy_from_slice(bytes);
            }),
        }
    }

    /// Programs the mark *complete* of a copy again: power may have gone while it was written the first time.
    /// A sector that takes nothing any more keeps its mark as it is.
    fn strengthen(&mut self, newest: Copy) {
        let _ = self.set_mark(self.sector_at(newest.sector) + Self::COMPLETE_AT);
    }

    fn set_mark(&mut self, at: u32) -> Result<(), StoreError> {
        let mut zeros = Chunk::BLANK;
        zeros.0.fill(0);
        self.write(at, &zeros.0[..Self::WORD])
    }

    fn is_marked(&mut self, at: u32) -> Result<bool, StoreError> {
        Ok(self.word(at)? == ZERO_WORD)
    }

    fn word(&mut self, at: u32) -> Result<[u8; SHORTEST_WORD], StoreError> {
        let mut word = [0; SHORTEST_WORD];
        self.stream(at, SHORTEST_WORD, |_, bytes| word.copy_from_slice(bytes))?;
        Ok(word)
    }

    fn erase(&mut self, sector: u32) -> Result<(), StoreError> {
        let at = self.sector_at(sector);
        self.flash.erase(at, at + F::ERASE_SIZE as u32).map_err(|_| StoreError::Flash)
    }

    fn check_blank(&mut self, sector: u32) -> Result<(), StoreError> {
        let mut is_blank = true;
        self.stream(self.sector_at(sector), F::ERASE_SIZE, |_, piece| {
            is_blank &= piece.iter().all(|byte| *byte == 0xFF);
        })?;
        if is_blank { Ok(()) } else { Err(StoreError::NotKept) }
    }

    /// Writes whole words, at most a chunk, and reads them back.
    fn write(&mut self, at: u32, words: &[u8]) -> Result<(), StoreError> {
        self.flash.write(at, words).map_err(|_| StoreError::Flash)?;
        let mut is_kept = true;
        self.stream(at, words.len(), |from, found| {
            is_kept &= words.get(from..from + found.len()) == Some(found);
        })?;
        if is_kept { Ok(()) } else { Err(StoreError::NotKept) }
    }

    /// Reads from anywhere, in pieces, each with its distance from the first byte.
    fn stream(
        &mut self,
        at: u32,
        length: usize,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), StoreError> {
        let mut chunk = Chunk::BLANK;
        let mut done = 0;
        while done < length {
            let at = at + done as u32;
            let before = at as usize % Self::WORD;
            let piece = (CHUNK - before).min(length - done);
            let words = &mut chunk.0[..Self::padded(before + piece) as usize];
            let is_read =
                (0..READ_TRIES).any(|_| self.flash.read(at - before as u32, words).is_ok());
            if !is_read {
                return Err(StoreError::Flash);
            }
            take(done, &words[before..][..piece]);
            done += piece;
        }
        Ok(())
    }
}

/// Where the bytes of an entry come from.
#[derive(Clone, Copy)]
enum Source<'a> {
    /// Address and length.
    Flash(u32, usize),
    Memory(&'a [u8]),
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
mod model;
#[cfg(test)]
mod tests;
