//! Completes the record of a program that was killed, or one that is damaged: the rows that are whole get the index and the end
//! that other readers of MCAP need.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, McapResult, WriteOptions, Writer};

use super::parts::{Described, Directory, Part, Parts};
use super::reader::{Damage, ReadError};
use super::writer::{RecordError, failed};
use crate::system::file;
use crate::system::text::shown;

/// Why a record could not be completed. The file is as it was.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// It cannot be read, or is not a record.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It is a link.
    #[error("{} is a link: name the file that it leads to", shown(.0))]
    Link(PathBuf),
    /// Its run goes on.
    #[error("{} is still being written: let the run end first", shown(.0))]
    Busy(PathBuf),
    /// None of its rows is whole.
    #[error("{} has no row that is whole: nothing to complete", shown(.0))]
    Empty(PathBuf),
    /// The complete record cannot be written.
    #[error(transparent)]
    Write(#[from] RecordError),
}

/// Returns whether a program still writes this record.
#[must_use]
pub fn is_being_written(file: &Path) -> bool {
    let lock = file::open(file).map(|file| file.try_lock_shared());
    matches!(lock, Ok(Err(TryLockError::WouldBlock)))
}

/// What was done to a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repaired {
    /// Rows of the complete record.
    pub rows: u64,
    /// What was left out.
    pub damage: Damage,
    /// The file as it was.
    pub original: PathBuf,
}

/// Completes a record from the parts that are whole; `None` when it is complete, and neither damaged nor changed. The file is
/// replaced in one step; the original stays beside it, with `.original` behind its name. The facts `repair` of the new one say
/// what was wrong. Follows no link, so that nothing outside the record's
/// folder changes.
///
/// # Errors
/// When it cannot be read, is not a record, has no row that is whole, is still being written, or the complete one cannot be
/// written.
pub fn repair(file: &Path) -> Result<Option<Repaired>, RepairError> {
    if std::fs::symlink_metadata(file).is_ok_and(|it| it.is_symlink()) {
        return Err(RepairError::Link(file.to_owned()));
    }
    if is_being_written(file) {
        return Err(RepairError::Busy(file.to_owned()));
    }
    // Refuses what is no record at all.
    let run = super::Run::read(file)?;
    if run.is_complete && run.damage.is_none() {
        return Ok(None);
    }
    let mut is_empty = false;
    let repaired = file::replace(file, |target| {
        let rows = copy(file, target, run.damage)?;
        is_empty = rows == 0;
        if is_empty {
            return Err(McapError::UnexpectedEof);
        }
        Ok(Repaired { rows, damage: run.damage, original: keep(file)? })
    });
    if is_empty {
        return Err(RepairError::Empty(file.to_owned()));
    }
    Ok(Some(repaired.map_err(|error| failed(file, error))?))
}

/// Gives a file a second name that is not in use, or a copy where the file system knows no second names; returns that name.
fn keep(file: &Path) -> std::io::Result<PathBuf> {
    let mut attempt = 1;
    loop {
        let ending = if attempt == 1 { String::new() } else { format!("-{attempt}") };
        let kept = file.with_extension(format!("mcap.original{ending}"));
        match std::fs::hard_link(file, &kept) {
            Ok(()) => return Ok(kept),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => attempt += 1,
            Err(_) => {
                std::io::copy(&mut file::open(file)?, &mut File::create_new(&kept)?)?;
                return Ok(kept);
            }
        }
    }
}

fn copy(file: &Path, target: &File, damage: Damage) -> McapResult<u64> {
    let options = WriteOptions::new().compression(None);
    let mut writer =
        options.library(crate::system::program::get()).create(BufWriter::new(target))?;
    let mut parts = Parts::open(file)?;
    let mut directory = Directory::default();
    directory.read(parts.summary(), |_, _, _| ());
    let (mut rows, mut ids) = (0, BTreeMap::new());
    while let Some(part) = parts.next(true)? {
        match part {
            Part::Facts(facts) => writer.write_metadata(&facts)?,
            Part::Attachment(header, data) => writer.attach(&Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data: Cow::Owned(data),
            })?,
            Part::Damaged(_, part) => drop(directory.read_damaged(&part)),
            Part::Repeated(_) => {}
            Part::Rows(part) | Part::Rest(part) => {
                let mut written = Ok(());
                directory.read(&part, |directory, header, data| {
                    let Some(channel) = directory.channels.get(&header.channel_id) else { return };
                    let is_json = || serde_json::from_slice::<serde::de::IgnoredAny>(data).is_ok();
                    if written.is_err() || (channel.encoding == "json" && !is_json()) {
                        return;
                    }
                    written =
                        channel_of(&mut writer, directory, channel, &mut ids).and_then(|id| {
                            rows += 1;
                            let header = MessageHeader { channel_id: id, ..*header };
                            writer.write_to_known_channel(&header, data)
                        });
                });
                written?;
            }
        }
    }
    if !damage.is_none() {
        let metadata = BTreeMap::from([("damage".to_owned(), damage.to_string())]);
        writer.write_metadata(&Metadata { name: "repair".to_owned(), metadata })?;
    }
    writer.finish()?;
    writer.into_inner().into_inner().map_err(|error| McapError::Io(error.into_error()))?;
    Ok(rows)
}

/// Returns the number of a channel in the new file.
fn channel_of(
    writer: &mut Writer<BufWriter<&File>>,
    directory: &Directory,
    channel: &Described,
    ids: &mut BTreeMap<String, u16>,
) -> McapResult<u16> {
    if let Some(id) = ids.get(&channel.topic) {
        return Ok(*id);
    }
    // One whose schema was lost has none.
    let schema = match directory.schemas.get(&channel.schema) {
        Some(schema) => writer.add_schema(&schema.name, &schema.encoding, &schema.text)?,
        None => 0,
    };
    let id = writer.add_channel(schema, &channel.topic, &channel.encoding, &channel.metadata)?;
    ids.insert(channel.topic.clone(), id);
    Ok(id)
}
