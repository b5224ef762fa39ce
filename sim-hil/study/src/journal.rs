//! Finished cells, on the disk as soon as they are finished.
//!
//! A CSV file: the header names the study and its fingerprint, then `cell` and the columns; each
//! row is one cell. A row that was cut off by a kill or a full disk is dropped when the file is
//! opened again, and its cell computed anew.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::{Column, Fingerprint, Row, Value};

/// Why finished cells could not be kept or found.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The file cannot be read or written.
    #[error("cannot keep finished cells in {}: {source}; cells written before are kept", path.display())]
    File {
        /// The journal.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file belongs to another study, other parameters or another version.
    #[error(
        "{} holds cells of {found}, not of {expected}: choose another folder with --out, or --restart to forget them",
        path.display()
    )]
    Other {
        /// The journal.
        path: PathBuf,
        /// Its header.
        found: String,
        /// The header that fits.
        expected: String,
    },
}

/// The file that finished cells are appended to.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens or begins the journal and returns the cells that are in it.
    pub(super) fn open(
        path: &Path,
        study: &str,
        fingerprint: &Fingerprint,
        columns: &[Column],
        restart: bool,
    ) -> Result<(Self, BTreeMap<usize, Row>), JournalError> {
        let failed = |source| JournalError::File { path: path.to_owned(), source };
        flix_host::system::file::check_writable(path).map_err(failed)?;
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(restart)
            .open(path)
            .map_err(failed)?;
        let mut text = String::new();
        io::Read::read_to_string(&mut file, &mut text).map_err(failed)?;

        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        let title = format!("# {study} {fingerprint}");
        let header = format!("{title}\ncell,{}\n", names.join(","));
        if !text.starts_with(&header) {
            let found = text.lines().next().unwrap_or_default();
            if header.starts_with(text.as_str()) {
                // New, or cut off within its header.
                file.set_len(0).map_err(failed)?;
                file.seek(SeekFrom::Start(0)).map_err(failed)?;
                file.write_all(header.as_bytes()).map_err(failed)?;
                return Ok((Self { path: path.to_owned(), file }, BTreeMap::new()));
            }
            return Err(JournalError::Other {
                path: path.to_owned(),
                found: found.trim_start_matches("# ").to_owned(),
                expected: title.trim_start_matches("# ").to_owned(),
            });
        }
        let whole = text.rfind('\n').map_or(0, |last| last + 1);
        let rows = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_reader(&text.as_bytes()[header.len()..whole])
            .records()
            .filter_map(|record| parse(&record.ok()?, columns))
            .collect();
        file.set_len(whole as u64).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map_err(failed)?;
        Ok((Self { path: path.to_owned(), file }, rows))
    }

    /// Writes these cells through to the disk.
    pub(super) fn append(&mut self, rows: &[(usize, Row)]) -> Result<(), JournalError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |source| JournalError::File { path: self.path.clone(), source };
        for (cell, row) in rows {
            let fields =
                std::iter::once(cell.to_string()).chain(row.iter().map(|value| match value {
                    Value::Number(number) => number.to_string(),
                    Value::Text(text) => text.clone(),
                }));
            writer.write_record(fields).map_err(|error| failed(error.into()))?;
        }
        let bytes = writer.into_inner().map_err(|error| failed(error.into_error()))?;
        self.file.write_all(&bytes).and_then(|()| self.file.sync_data()).map_err(failed)
    }
}

fn parse(record: &csv::StringRecord, columns: &[Column]) -> Option<(usize, Row)> {
    if record.len() != columns.len() + 1 {
        return None;
    }
    let cell = record.get(0)?.parse().ok()?;
    let row: Option<Row> = columns
        .iter()
        .zip(record.iter().skip(1))
        .map(|(column, field)| {
            if column.text {
                Some(Value::from(field))
            } else {
                field.parse().ok().map(Value::Number)
            }
        })
        .collect();
    Some((cell, row?))
}
