//! The parts of a record's file, each judged by itself, so that one that is damaged hides no other.
//!
//! ```text
//! magic  header  [chunk of rows | facts | attachment | index] ...  end of data  summary  footer  magic
//! ```
//!
//! Every part is a kind, the length of its body, and the body (MCAP specification, <https://mcap.dev/spec>). A chunk carries the
//! check sum of its rows, an attachment one of its own. Where a length is damaged, the next part is found by the summary,
//! or else by looking for one whose check sum is right.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crc::{CRC_32_ISO_HDLC, Crc, Digest};
use mcap::McapResult;
use mcap::records::{AttachmentHeader, Metadata, Record, op};

use crate::system::data_from;

/// What a file begins and ends with.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Length of a kind and a length, bytes.
const PREFIX: u64 = 9;
/// Length of a footer's body, bytes.
const FOOTER: u64 = 20;
/// Length of what stands before the rows of a chunk that is not compressed, bytes.
const CHUNK_HEADER: u64 = 40;
/// Length of what stands before the table of an index, bytes: its kind and length, its channel, the table's length.
const INDEX_HEADER: u64 = PREFIX + 6;
/// Length of an index's entry for one row, bytes.
const INDEX_ENTRY: u64 = 16;
/// Length of the end of data with its check sum, bytes.
const DATA_END: u64 = PREFIX + 4;
/// Longest part that is taken for one, bytes: the writer's chunks have some 100 kB.
const LONGEST: u64 = 256 << 20;
/// Bytes that are looked through at once for the next part.
const STRETCH: u64 = 64 << 10;
/// How often lengths that contradict each other may have the whole file read again, of one that is shorter than [`LONGEST`]; then
/// lost parts are looked for no more.
const MOST_AGAIN: u64 = 64;
/// Most bytes of the first eight, and of the nine before the check sum at the end of data, that may be damaged.
const MOST_WRONG: usize = 2;
/// Longest name of facts, bytes.
const LONGEST_NAME: usize = 256;

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// A part of a record.
pub(super) enum Part {
    /// A group of facts.
    Facts(Metadata),
    /// A file in the record.
    Attachment(AttachmentHeader, Vec<u8>),
    /// Rows, with the channels that they need; for [`records`].
    Rows(Vec<u8>),
    /// The last rows of a program that was killed: nothing says that they are whole.
    Rest(Vec<u8>),
    /// Rows that were there before, byte for byte.
    Repeated(Vec<u8>),
    /// What cannot be trusted: its kind, as the summary lists it or as it says itself, and what may be rows, for
    /// [`Directory::read_damaged`].
    Damaged(u8, Vec<u8>),
}

/// What stands behind the data of a record that is complete.
struct Summary {
    /// Where it begins.
    start: u64,
    /// Its records.
    records: Vec<u8>,
    /// Rows of the whole record.
    rows: Option<u64>,
    /// Where the parts that it lists are, in order.
    places: Vec<Place>,
}

/// Where a part begins, its kind, and how long it is, bytes.
type Place = (u64, u8, u64);

/// Reads a record part by part.
pub(super) struct Parts {
    file: BufReader<File>,
    at: u64,
    end: u64,
    summary: Option<Summary>,
    /// Check sum of the file up to `summed`: of what was read anyway, as far as that follows on.
    sum: Digest<'static, u32>,
    summed: u64,
    /// Where what it is stored of ends.
    sum_end: u64,
    /// Up to where the file was read.
    seen: u64,
    /// Bytes that were read again.
    again: u64,
    /// Where the data ends, as far as it was read.
    data_end: Option<u64>,
    /// Whether all that was read since is what stands behind the data.
    is_behind_data: bool,
    /// Where the parts are that a summary lists, as far as they were read.
    places: Vec<Place>,
    /// Where chunks of which header begin.
    chunks: BTreeMap<Vec<u8>, u64>,
    /// When the rows began that other programs have compressed, ns since 1970.
    pub(super) compressed: Option<u64>,
    /// Whether it begins or ends as a record does.
    pub(super) is_record: bool,
}

impl Parts {
    /// Opens a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = crate::system::file::open(path)?;
        let end = file.metadata()?.len();
        let mut parts = Self {
            file: BufReader::new(file),
            at: MAGIC.len() as u64,
            end,
            summary: None,
            sum: CRC.digest(),
            summed: 0,
            sum_end: 0,
            seen: 0,
            again: 0,
            data_end: None,
            is_behind_data: false,
            places: Vec::new(),
            chunks: BTreeMap::new(),
            compressed: None,
            is_record: true,
        };
        if let Some(summary) = parts.find_summary()? {
            parts.end = summary.start;
            parts.sum_end = summary.start.saturating_sub(DATA_END);
            parts.summary = Some(summary);
        } else {
            // Any other file is not looked through.
            let begin = parts.bytes(0, MAGIC.len() as u64)?;
            let right = begin.iter().zip(MAGIC).filter(|(one, other)| one == other).count();
            parts.is_record = right + MOST_WRONG >= MAGIC.len();
            parts.end = if parts.is_record { parts.end } else { 0 };
        }
        Ok(parts)
    }

    /// Returns whether the record has its summary and its end.
    pub(super) const fn is_complete(&self) -> bool {
        self.summary.is_some()
    }

    /// Returns how many rows the record was given, where it is complete.
    pub(super) fn rows(&self) -> Option<u64> {
        self.summary.as_ref()?.rows
    }

    /// Returns whether all of the data was read, and nothing is missing but its summary, or that leads elsewhere.
    pub(super) fn lost_its_summary(&self) -> bool {
        let Some(summary) = &self.summary else { return self.is_behind_data };
        // A summary may list no parts of a kind.
        let is_listed = |kind: u8| summary.places.iter().any(|place| place.1 == kind);
        let kinds = [op::CHUNK, op::METADATA, op::ATTACHMENT].map(|kind| (kind, is_listed(kind)));
        let read = self.places.iter().filter(|place| kinds.contains(&(place.1, true)));
        !summary.places.iter().eq(read)
    }

    /// Returns the records of the summary, which name all channels; for [`records`].
    pub(super) fn summary(&self) -> &[u8] {
        self.summary.as_ref().map_or(&[], |summary| &summary.records)
    }

    /// Returns whether the check sum over all of the data is right; nothing where there is none.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn is_unchanged(&mut self) -> io::Result<Option<bool>> {
        let data = match &self.summary {
            Some(summary) => summary.start.checked_sub(DATA_END),
            None => self.data_end,
        };
        let Some(data) = data else { return Ok(None) };
        self.sum_end = data;
        let stored = self.bytes(data, DATA_END)?;
        let stored = number(&stored, PREFIX as usize, 4);
        if stored == 0 {
            return Ok(None);
        }
        // No part is as long: what is behind a wrong length, or the hole of a file that takes no room.
        if self.summary.is_some() && data.saturating_sub(self.summed) > LONGEST {
            return Ok(Some(false));
        }
        // What was not read, such as behind a length that is wrong.
        while self.summed < data {
            let stretch = STRETCH.min(data - self.summed);
            if self.bytes(self.summed, stretch)?.is_empty() {
                break;
            }
        }
        Ok(Some(u64::from(self.sum.clone().finalize()) == stored))
    }

    /// Returns the next part; rows only where they are wanted.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn next(&mut self, with_rows: bool) -> io::Result<Option<Part>> {
        while self.at < self.end {
            let at = self.at;
            let kind = self.byte(at)?;
            if let Some((part, next)) = self.part(at, with_rows)? {
                self.at = next;
                if self.summary.is_some() && is_listed(kind) {
                    self.places.push((at, kind, next - at));
                }
                let part = match part {
                    Some(Part::Damaged(kind, rows)) => {
                        // Its length may lead over others.
                        if self.summary.is_some() {
                            self.at = self.find(at + 1)?.map_or(next, |place| place.min(next));
                        }
                        Part::Damaged(self.listed(at, kind), rows)
                    }
                    Some(part) => part,
                    None => continue,
                };
                self.is_behind_data &= !matches!(part, Part::Rows(_) | Part::Repeated(_));
                return Ok(Some(part));
            }
            // Its length is wrong, or the file was cut off within it.
            let found = self.find(at + 1)?;
            self.at = found.unwrap_or(self.end);
            let is_cut = found.is_none() && self.is_cut(at)?;
            let is_chunk = kind == op::CHUNK;
            if is_cut && !is_chunk {
                continue;
            }
            let begin = at.saturating_add(PREFIX + CHUNK_HEADER);
            let again = self.again;
            let mut lost = self.bytes(begin, self.at.saturating_sub(begin).min(LONGEST))?;
            if found.is_some() || !is_chunk {
                // No byte is lost twice.
                self.again = again;
                return Ok(Some(Part::Damaged(self.listed(at, kind), lost)));
            }
            // What is no row, such as the zeros after a loss of power, is looked at by itself.
            if !self.is_exhausted()
                && let Some(length) = end_of_rows(&lost)
            {
                lost.truncate(length);
                self.at = begin + length as u64;
            }
            return Ok(Some(Part::Rest(lost)));
        }
        Ok(None)
    }

    /// Returns the kind of the part that the summary lists at this place, or the other one.
    fn listed(&self, at: u64, other: u8) -> u8 {
        let places = self.summary.as_ref().map_or(&[][..], |summary| &summary.places);
        places.binary_search_by_key(&at, |place| place.0).map_or(other, |found| places[found].1)
    }

    /// Returns whether the file ends within this part, with nothing of the data lost but what was not written yet.
    fn is_cut(&mut self, at: u64) -> io::Result<bool> {
        if self.is_behind_data {
            return Ok(true);
        }
        let prefix = self.bytes(at, PREFIX)?;
        let is_kind = prefix.first().is_some_and(|kind| (1..=op::DATA_END).contains(kind));
        // The bytes of a length that are missing count as 0.
        let length = prefix.iter().skip(1).rev().fold(0, |sum, digit| sum << 8 | u64::from(*digit));
        let is_longer =
            (prefix.len() as u64) < PREFIX || at + PREFIX + length.min(LONGEST) > self.end;
        Ok(self.summary.is_none() && is_kind && length <= LONGEST && is_longer)
    }

    /// Returns the part at this place, if it is one that is wanted, and where the next begins; nothing where its length is
    /// wrong.
    fn part(&mut self, at: u64, with_rows: bool) -> io::Result<Option<(Option<Part>, u64)>> {
        let prefix = self.bytes(at, PREFIX)?;
        if prefix.len() < PREFIX as usize {
            return Ok(None);
        }
        let (kind, length) = (prefix[0], number(&prefix, 1, 8));
        let next = at.saturating_add(PREFIX).saturating_add(length);
        let has_length = length <= LONGEST && self.can_be_next(next)?;
        if kind == op::CHUNK {
            return self.chunk(at, has_length.then_some(next), with_rows);
        }
        if !has_length {
            return Ok(None);
        }
        let body = self.bytes(at + PREFIX, length)?;
        let is_record = parse_record(kind, &body).is_ok();
        let part = match kind {
            op::METADATA | op::ATTACHMENT => described(kind, &body),
            // The summary of a record that has lost its end.
            _ if self.is_behind_data => return Ok(Some((None, next))),
            // Rows without a chunk, as others write them.
            op::SCHEMA | op::CHANNEL | op::MESSAGE if is_record => {
                Some(Part::Rows(self.bytes(at, PREFIX + length)?))
            }
            op::HEADER if is_record && at == MAGIC.len() as u64 => return Ok(Some((None, next))),
            op::DATA_END if length == 4 => {
                (self.data_end, self.is_behind_data) = (Some(at), true);
                return Ok(Some((None, next)));
            }
            // A channel, then the length of its table.
            op::MESSAGE_INDEX if number(&body, 2, 4) + 6 == length => {
                return Ok(Some((None, next)));
            }
            _ => None,
        };
        // Its kind is wrong, or what it holds; it may have been a chunk, unless it says what else it is.
        let damaged = || {
            let rows = body.get(CHUNK_HEADER as usize..).filter(|_| !is_listed(kind));
            Part::Damaged(kind, rows.unwrap_or_default().to_vec())
        };
        Ok(Some((Some(part.unwrap_or_else(damaged)), next)))
    }

    fn chunk(
        &mut self,
        at: u64,
        next: Option<u64>,
        with_rows: bool,
    ) -> io::Result<Option<(Option<Part>, u64)>> {
        let header = self.bytes(at + PREFIX, CHUNK_HEADER)?;
        for name in ["zstd", "lz4"] {
            if number(&header, 28, 4) == name.len() as u64
                && header.get(32..).is_some_and(|rest| rest.starts_with(name.as_bytes()))
            {
                self.compressed = Some(number(&header, 0, 8));
                let sentence = format!(
                    "other programs have compressed it ({name}): `mcap decompress` writes it without"
                );
                return Err(io::Error::new(io::ErrorKind::Unsupported, sentence));
            }
        }
        let rows = at + PREFIX + CHUNK_HEADER;
        if let (false, Some(next)) = (with_rows, next) {
            self.is_behind_data = false;
            return Ok(Some((None, next)));
        }
        if header.len() == CHUNK_HEADER as usize && number(&header, 28, 4) == 0 {
            let sum = number(&header, 24, 4);
            // Its length stands there three times.
            let by_prefix = next.and_then(|next| next.checked_sub(rows));
            let sizes = [by_prefix, Some(number(&header, 32, 8)), Some(number(&header, 16, 8))];
            for size in sizes.into_iter().flatten() {
                let is_stated = next == rows.checked_add(size);
                if size > LONGEST
                    || rows.saturating_add(size) > self.end
                    || (!is_stated && self.is_exhausted())
                {
                    continue;
                }
                let data = self.bytes(rows, size)?;
                if sum != 0 && u64::from(CRC.checksum(&data)) == sum {
                    let is_first = *self.chunks.entry(header).or_insert(at) == at;
                    let part = if is_first { Part::Rows(data) } else { Part::Repeated(data) };
                    return Ok(Some((Some(part), rows + size)));
                }
                if sum == 0 && is_stated {
                    return Ok(Some((Some(Part::Rows(data)), rows + size)));
                }
            }
        }
        let Some(mut next) = next else { return Ok(None) };
        // Its indexes count its rows.
        let most = next.saturating_add(LONGEST).min(self.end);
        while let Some(length) = index(&self.bytes(next, INDEX_HEADER)?)
            && next + length <= most
        {
            next += length;
        }
        let data = self.bytes(rows, next.saturating_sub(rows))?;
        Ok(Some((Some(Part::Damaged(op::CHUNK, data)), next)))
    }

    /// Returns whether a part can begin here, or the data ends.
    fn can_be_next(&mut self, at: u64) -> io::Result<bool> {
        let is_kind = |kind: u8| (1..=op::DATA_END).contains(&kind);
        Ok(at == self.end
            || (at < self.end && (is_kind(self.listed(at, 0)) || is_kind(self.byte(at)?))))
    }

    /// Looks for the next part that is whole, from a place on.
    fn find(&mut self, from: u64) -> io::Result<Option<u64>> {
        if let Some(summary) = &self.summary {
            let next = summary.places.partition_point(|place| place.0 < from);
            return Ok(summary.places.get(next).map(|place| place.0));
        }
        let mut at = from;
        while at < self.end {
            let stretch = self.bytes(at, STRETCH.min(self.end - at))?;
            if stretch.iter().all(|byte| *byte == 0) {
                let behind = at + stretch.len().max(1) as u64;
                at = data_from(self.file.get_ref(), behind).unwrap_or(self.end).max(behind);
                // The system has moved it, too.
                self.file.seek(SeekFrom::Start(at))?;
                continue;
            }
            for (place, kind) in (at..).zip(&stretch) {
                if self.is_exhausted() {
                    return Ok(None);
                }
                if self.is_whole(place, *kind)? {
                    return Ok(Some(place));
                }
            }
            at += stretch.len() as u64;
        }
        Ok(None)
    }

    /// Returns whether a part of this kind begins here, by more than its length.
    fn is_whole(&mut self, at: u64, kind: u8) -> io::Result<bool> {
        if !is_listed(kind) {
            return Ok(false);
        }
        let part = self.part(at, true)?.and_then(|(part, _)| part);
        Ok(match part {
            Some(Part::Rows(_) | Part::Repeated(_)) => {
                let sum = self.bytes(at + PREFIX + 24, 4)?;
                number(&sum, 0, 4) != 0
            }
            Some(Part::Facts(_) | Part::Attachment(..)) => true,
            _ => false,
        })
    }

    /// Returns whether no more is read again for lengths that contradict each other.
    fn is_exhausted(&self) -> bool {
        self.again > self.end.saturating_mul(MOST_AGAIN).min(LONGEST)
    }

    fn find_summary(&mut self) -> io::Result<Option<Summary>> {
        let magic = MAGIC.len() as u64;
        let Some(footer) = self.end.checked_sub(magic + PREFIX + FOOTER) else { return Ok(None) };
        let tail = self.bytes(footer, magic + PREFIX + FOOTER)?;
        let start = number(&tail, PREFIX as usize, 8);
        let is_footer = tail.first() == Some(&op::FOOTER) && tail.ends_with(MAGIC);
        if !is_footer || !(magic..footer).contains(&start) || footer - start > LONGEST {
            return Ok(None);
        }
        let mut all = self.bytes(start, footer - start + PREFIX + FOOTER)?;
        let sum = number(&all, all.len() - 4, 4);
        if sum != 0 && u64::from(CRC.checksum(&all[..all.len() - 4])) != sum {
            return Ok(None);
        }
        all.truncate((footer - start) as usize);
        if !self.is_behind_end(start)? || !is_summary(&all) {
            return Ok(None);
        }
        let (mut rows, mut places) = (None, Vec::new());
        for (kind, body) in records(&all) {
            match parse_record(kind, body) {
                Ok(Record::Statistics(statistics)) => rows = Some(statistics.message_count),
                Ok(Record::ChunkIndex(index)) => {
                    places.push((index.chunk_start_offset, op::CHUNK, index.chunk_length));
                }
                Ok(Record::MetadataIndex(index)) => {
                    places.push((index.offset, op::METADATA, index.length));
                }
                Ok(Record::AttachmentIndex(index)) => {
                    places.push((index.offset, op::ATTACHMENT, index.length));
                }
                _ => {}
            }
        }
        places.sort_unstable();
        Ok(Some(Summary { start, records: all, rows, places }))
    }

    /// Returns whether the data ends right before this place, by most bytes of what says so.
    fn is_behind_end(&mut self, at: u64) -> io::Result<bool> {
        let Some(begin) = at.checked_sub(DATA_END) else { return Ok(false) };
        let end = self.bytes(begin, PREFIX)?;
        let right = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
        Ok(right.iter().zip(&end).filter(|(one, other)| one != other).count() <= MOST_WRONG)
    }

    fn byte(&mut self, at: u64) -> io::Result<u8> {
        Ok(self.bytes(at, 1)?.first().copied().unwrap_or(0))
    }

    /// Returns so many bytes from here on, or those that there are.
    fn bytes(&mut self, at: u64, count: u64) -> io::Result<Vec<u8>> {
        let here = self.file.stream_position()?;
        // Keeps what is buffered, where that is near.
        match i64::try_from(i128::from(at) - i128::from(here)) {
            Ok(distance) => self.file.seek_relative(distance)?,
            Err(_) => drop(self.file.seek(SeekFrom::Start(at))?),
        }
        let mut bytes = Vec::new();
        self.file.by_ref().take(count).read_to_end(&mut bytes)?;
        let until = at.saturating_add(bytes.len() as u64);
        self.again += self.seen.min(until).saturating_sub(at);
        self.seen = self.seen.max(until);
        let place = |of: u64| usize::try_from(of.checked_sub(at)?).ok();
        let end = place(self.sum_end).map(|end| end.min(bytes.len()));
        if let (Some(known), Some(end)) = (place(self.summed), end)
            && let Some(new) = bytes.get(known..end)
        {
            self.sum.update(new);
            self.summed += new.len() as u64;
        }
        Ok(bytes)
    }
}

/// Parses the body of a record.
///
/// # Errors
/// When it is none of this kind.
fn parse_record(kind: u8, body: &[u8]) -> McapResult<Record<'_>> {
    // The library takes for granted that an attachment has the four bytes of its check sum.
    if kind == op::ATTACHMENT && !is_attachment(body) {
        return Err(mcap::McapError::UnexpectedEof);
    }
    mcap::read::parse_record(kind, body)
}

/// Returns whether the lengths in an attachment fill its body.
fn is_attachment(body: &[u8]) -> bool {
    let text = |at: u64| at.checked_add(4 + number(body, usize::try_from(at).ok()?, 4));
    // Two times, its name, its type, its data, its check sum.
    let end = text(16).and_then(text).and_then(|data| {
        let length = number(body, usize::try_from(data).ok()?, 8);
        data.checked_add(8)?.checked_add(length)?.checked_add(4)
    });
    end == Some(body.len() as u64)
}

/// Returns facts or an attachment, if its body is one from its first to its last byte.
fn described(kind: u8, body: &[u8]) -> Option<Part> {
    match parse_record(kind, body).ok()? {
        Record::Metadata(facts) => {
            let name = number(body, 0, 4) as usize;
            let table = number(body, name.checked_add(4)?, 4) as usize;
            let is_whole = name.checked_add(table)?.checked_add(8)? == body.len();
            (is_whole && name <= LONGEST_NAME).then_some(Part::Facts(facts))
        }
        Record::Attachment { header, data, .. } => {
            Some(Part::Attachment(header, data.into_owned()))
        }
        _ => None,
    }
}

/// Returns a number of so many bytes, the least first; 0 where it is cut off.
fn number(bytes: &[u8], at: usize, count: usize) -> u64 {
    let digits = bytes.get(at..).and_then(|bytes| bytes.get(..count)).unwrap_or_default();
    digits.iter().rev().fold(0, |sum, digit| sum << 8 | u64::from(*digit))
}

/// Returns kind and body of each record of a part, up to the first that does not fit.
pub(super) fn records(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        // No kind is 0: zeros are room that was never written.
        let kind = *bytes.first().filter(|kind| **kind != 0)?;
        let length = usize::try_from(number(bytes.get(..PREFIX as usize)?, 1, 8)).ok()?;
        let body = bytes.get(PREFIX as usize..)?;
        let record = body.get(..length)?;
        bytes = &body[length..];
        Some((kind, record))
    })
}

/// Returns whether a summary lists parts of this kind.
const fn is_listed(kind: u8) -> bool {
    matches!(kind, op::CHUNK | op::METADATA | op::ATTACHMENT)
}

/// Returns whether these are records of a summary from the first byte to the last, and none that stands in the data alone.
fn is_summary(bytes: &[u8]) -> bool {
    let mut length = 0;
    records(bytes).all(|(kind, body)| {
        length += PREFIX as usize + body.len();
        parse_record(kind, body).is_ok()
            && !is_listed(kind)
            && !matches!(
                kind,
                op::HEADER | op::FOOTER | op::MESSAGE | op::MESSAGE_INDEX | op::DATA_END
            )
    }) && length == bytes.len()
}

/// Returns where the rows of a part end that goes on with something else; nothing where it ends with them, or within one.
fn end_of_rows(part: &[u8]) -> Option<usize> {
    let is_row = |kind: u8| matches!(kind, op::SCHEMA | op::CHANNEL | op::MESSAGE);
    let rows = records(part).take_while(|(kind, _)| is_row(*kind));
    let length = rows.map(|(_, body)| PREFIX as usize + body.len()).sum();
    part.get(length).is_some_and(|kind| !is_row(*kind)).then_some(length)
}

/// Returns the length of the index that begins here, bytes, if it is one: it states the length of its table twice.
fn index(bytes: &[u8]) -> Option<u64> {
    let table = number(bytes, INDEX_HEADER as usize - 4, 4);
    let is_one = bytes.len() as u64 >= INDEX_HEADER
        && bytes[0] == op::MESSAGE_INDEX
        && table.is_multiple_of(INDEX_ENTRY)
        && number(bytes, 1, 8) == INDEX_HEADER - PREFIX + table;
    is_one.then_some(INDEX_HEADER + table)
}

/// Returns how many rows the indexes in a damaged part count.
fn indexed(part: &[u8]) -> u64 {
    let (mut at, mut rows) = (0, 0);
    let next = |at: usize| part.get(at..)?.iter().position(|kind| *kind == op::MESSAGE_INDEX);
    while let Some(skipped) = next(at) {
        let rest = &part[at + skipped..];
        let length = index(rest).filter(|length| *length <= rest.len() as u64);
        rows += length.map_or(0, |length| (length - INDEX_HEADER) / INDEX_ENTRY);
        at += skipped + length.unwrap_or(1) as usize;
    }
    rows
}

/// A kind of row, as a record describes it.
#[derive(Debug, Clone)]
pub(super) struct Described {
    pub(super) topic: String,
    pub(super) encoding: String,
    pub(super) metadata: BTreeMap<String, String>,
    pub(super) schema: u16,
}

/// A schema, as a record has it.
#[derive(Debug, Clone)]
pub(super) struct Schema {
    pub(super) name: String,
    pub(super) encoding: String,
    pub(super) text: Vec<u8>,
}

/// The channels and schemas that a record has named so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Directory {
    pub(super) channels: BTreeMap<u16, Described>,
    pub(super) schemas: BTreeMap<u16, Schema>,
}

impl Directory {
    /// Takes the channels and schemas of a part, and gives each row, with its channel's number, to `row`.
    pub(super) fn read(
        &mut self,
        part: &[u8],
        mut row: impl FnMut(&Self, &mcap::records::MessageHeader, &[u8]),
    ) {
        for (kind, body) in records(part) {
            match parse_record(kind, body) {
                Ok(Record::Schema { header, data }) => {
                    let mcap::records::SchemaHeader { id, name, encoding } = header;
                    self.schemas.insert(id, Schema { name, encoding, text: data.into_owned() });
                }
                Ok(Record::Channel(channel)) => {
                    let described = Described {
                        topic: channel.topic,
                        encoding: channel.message_encoding,
                        metadata: channel.metadata,
                        schema: channel.schema_id,
                    };
                    self.channels.insert(channel.id, described);
                }
                Ok(Record::Message { header, data }) => row(self, &header, &data),
                _ => {}
            }
        }
    }

    /// Takes from a damaged part the channels of topics that are known, and counts its rows.
    pub(super) fn read_damaged(&mut self, part: &[u8]) -> u64 {
        let (mut found, mut rows) = (Self::default(), 0);
        found.read(part, |_, _, _| rows += 1);
        let is_known = |topic: &str| super::CHANNELS.iter().any(|channel| channel.topic == topic);
        for (id, channel) in found.channels {
            if is_known(&channel.topic) {
                self.channels.entry(id).or_insert(channel);
            }
        }
        for (id, schema) in found.schemas {
            self.schemas.entry(id).or_insert(schema);
        }
        rows.max(indexed(part))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    /// Chunks without rows, each of which states, in this of its lengths, that all that follows it is its rows.
    fn nested(count: u64, lengths: [bool; 3]) -> Vec<u8> {
        let mut file = MAGIC.to_vec();
        for number in 1..=count {
            let rest = (count - number) * (PREFIX + CHUNK_HEADER);
            let [prefix, size, second] = lengths.map(|is_long| if is_long { rest } else { 0 });
            file.push(op::CHUNK);
            file.extend((prefix + CHUNK_HEADER).to_le_bytes());
            file.extend([0; 16]);
            file.extend(size.to_le_bytes());
            file.extend(1_u32.to_le_bytes());
            file.extend([0; 4]);
            file.extend(second.saturating_sub(number % 2).to_le_bytes());
        }
        file.push(0);
        file
    }

    #[test]
    fn lengths_that_contradict_each_other_have_a_file_read_a_bounded_number_of_times() {
        for lengths in [[true, true, true], [false, true, true], [true, false, false]] {
            let mut file = tempfile::NamedTempFile::new().unwrap();
            let bytes = nested(2000, lengths);
            file.write_all(&bytes).unwrap();
            let mut parts = Parts::open(file.path()).unwrap();
            let (mut read, mut found) = (0, 0);
            while let Some(part) = parts.next(true).unwrap() {
                found += 1;
                if let Part::Rows(rows) | Part::Rest(rows) | Part::Damaged(_, rows) = part {
                    read += rows.len();
                }
            }
            let times = (parts.again + read as u64) / bytes.len() as u64;
            assert!(found > 0 && times <= MOST_AGAIN + 10, "{lengths:?}: {times} times");
        }
    }

    #[test]
    fn a_hole_that_no_part_is_as_long_as_is_not_read_for_its_check_sum() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let hole = 40 << 30;
        let mut end = vec![op::DATA_END];
        end.extend(4_u64.to_le_bytes());
        end.extend(7_u32.to_le_bytes());
        let start = hole + end.len() as u64;
        // A record of a kind that is nobody's, and empty.
        end.extend([0xff, 0, 0, 0, 0, 0, 0, 0, 0]);
        end.push(op::FOOTER);
        end.extend(FOOTER.to_le_bytes());
        end.extend(start.to_le_bytes());
        end.extend([0; 12]);
        end.extend(MAGIC);
        let mut target = file.reopen().unwrap();
        target.write_all(MAGIC).unwrap();
        target.seek(SeekFrom::Start(hole)).unwrap();
        target.write_all(&end).unwrap();
        let mut parts = Parts::open(file.path()).unwrap();
        while parts.next(true).unwrap().is_some() {}
        assert!(parts.is_complete());
        assert_eq!(parts.is_unchanged().unwrap(), Some(false));
        assert!(parts.summed <= LONGEST, "it is read no further");
    }
}
