//! Completes the record of a program that was killed: the rows up to then get the index and the end
//! that other readers of MCAP need.

use std::borrow::Cow;
use std::fs::{File, TryLockError};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::read::{LinearReader, Options};
use mcap::records::Record;
use mcap::{Attachment, McapError, McapResult, MessageStream, WriteOptions};

use super::reader::{ReadError, is_complete, read_bytes};
use super::writer::{RecordError, failed};

/// Why a record could not be completed. The file is as it was.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// It cannot be read, or is not a record.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Its run goes on.
    #[error("{} is still being written: let the run end first", .0.display())]
    Busy(PathBuf),
    /// The complete record cannot be written.
    #[error(transparent)]
    Write(#[from] RecordError),
}

/// Returns whether a program still writes this record.
#[must_use]
pub fn is_being_written(file: &Path) -> bool {
    let lock = crate::file::open(file).map(|file| file.try_lock_shared());
    matches!(lock, Ok(Err(TryLockError::WouldBlock)))
}

/// Completes a record, and returns its rows; `None` when it is complete already. The file is replaced
/// in one step.
///
/// # Errors
/// When it cannot be read, is not a record, is still being written, or the complete one cannot be written.
pub fn repair(file: &Path) -> Result<Option<u64>, RepairError> {
    let bytes = read_bytes(file)?;
    if is_complete(&bytes) {
        return Ok(None);
    }
    if is_being_written(file) {
        return Err(RepairError::Busy(file.to_owned()));
    }
    // Refuses what is no record at all.
    super::Run::read(file)?;
    let new = file.with_extension("mcap.part");
    let write = |source| RecordError::File { path: new.clone(), source };
    let target = File::create(&new).map_err(write)?;
    let copied = copy(&bytes, &target).map_err(|error| failed(&new, error));
    let rows = copied.and_then(|rows| {
        target.sync_all().map_err(write)?;
        std::fs::rename(&new, file).map_err(write)?;
        Ok(rows)
    });
    if rows.is_err() {
        // The rest of an attempt; the record itself was not touched.
        let _ = std::fs::remove_file(&new);
    }
    Ok(Some(rows?))
}

fn copy(bytes: &[u8], target: &File) -> McapResult<u64> {
    let options = WriteOptions::new().compression(None);
    let mut writer = options
        .library(concat!("flix ", env!("CARGO_PKG_VERSION")))
        .create(BufWriter::new(target))?;
    let tolerant = || Options::IgnoreEndMagic.into();
    for record in LinearReader::new_with_options(bytes, tolerant())?.map_while(Result::ok) {
        match record {
            Record::Metadata(metadata) => writer.write_metadata(&metadata)?,
            Record::Attachment { header, data, .. } => writer.attach(&Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data: Cow::Borrowed(&data),
            })?,
            _ => {}
        }
    }
    let mut rows = 0;
    for message in MessageStream::new_with_options(bytes, tolerant())?.map_while(Result::ok) {
        writer.write(&message)?;
        rows += 1;
    }
    writer.finish()?;
    writer.into_inner().into_inner().map_err(|error| McapError::Io(error.into_error()))?;
    Ok(rows)
}
