//! Finished cells, on the disk as soon as they are finished.
//!
//! A CSV file: the header names the study and its fingerprint, then `cell`, the columns and `check`; each row is one cell with its
//! check sum. A row that was cut off by a kill or a full disk, or changed, is dropped when the file is opened again, and its cell
//! computed anew. One process at a time has the file.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use flix_host::system::file;
use flix_sim::study::{Column, Fingerprint, Kind, Row, Value};
use sha2::{Digest, Sha256};

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
    /// Another process has it.
    #[error(
        "another process writes {}: wait until it has ended, or choose another folder with --out",
        path.display()
    )]
    Busy {
        /// The journal.
        path: PathBuf,
    },
    /// The file belongs to another study, other parameters or another version.
    #[error(
        "{} holds cells of {found}, not of {expected}: choose another folder with --out, --restart to forget them, or \
         --another-build where the parameters (before the dash) are the same",
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

/// Which cells of an earlier run are taken for those of this run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// Those of a run of this program that did not finish. A run that finished is computed anew.
    Unfinished,
    /// Those of a run of this program, finished or not.
    All,
    /// Those of a run of any build of this program, finished or not.
    OfAnyBuild,
    /// None.
    Forget,
}

/// The file that finished cells are appended to.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    fingerprint: Fingerprint,
    header: String,
    file: File,
}

impl Journal {
    /// Opens or begins the journal and returns the cells that are in it. Cells of another program are forgotten, unless all
    /// earlier ones are asked for.
    pub(super) fn open(
        path: &Path,
        study: &str,
        fingerprint: &Fingerprint,
        columns: &[Column],
        earlier: Earlier,
    ) -> Result<(Self, BTreeMap<usize, Row>), JournalError> {
        let failed = |source| JournalError::File { path: path.to_owned(), source };
        file::check_writable(path).map_err(failed)?;
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(failed)?;
        // Where a network's folder has no locks, the check sums have to do.
        if file::is_held_elsewhere(&file) {
            return Err(JournalError::Busy { path: path.to_owned() });
        }
        if earlier == Earlier::Forget {
            file.set_len(0).map_err(failed)?;
        }
        // Whatever damage made of it: rows are checked one by one.
        let mut bytes = Vec::new();
        io::Read::read_to_end(&mut file, &mut bytes).map_err(failed)?;
        // An editor or a transfer may have ended its lines as Windows does.
        let has_returns = bytes.windows(2).any(|pair| pair == b"\r\n");
        if has_returns {
            bytes.retain(|byte| *byte != b'\r');
        }
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
        let text = String::from_utf8_lossy(&bytes);

        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        let title = format!("# {study} {fingerprint}");
        let header = format!("{title}\ncell,{},check\n", names.join(","));
        let mut journal =
            Self { path: path.to_owned(), fingerprint: fingerprint.clone(), header, file };
        let found = text.lines().next().unwrap_or_default();
        let by = found.strip_prefix(&format!("# {study} ")).unwrap_or_default();
        let by = Fingerprint::parse(by.to_owned());
        let has_parameters = by.parameters() == fingerprint.parameters();
        let is_taken = by == *fingerprint || has_parameters && earlier == Earlier::OfAnyBuild;
        if !is_taken || !text[found.len()..].starts_with(&journal.header[title.len()..]) {
            let is_of_another_program = earlier == Earlier::Unfinished && has_parameters;
            // Or new, or cut off within its header.
            if is_of_another_program || journal.header.starts_with(&*text) {
                journal.begin()?;
                return Ok((journal, BTreeMap::new()));
            }
            return Err(JournalError::Other {
                path: path.to_owned(),
                found: found.trim_start_matches("# ").to_owned(),
                expected: title.trim_start_matches("# ").to_owned(),
            });
        }
        // A row is a line: quotes that damage opened end with it.
        let row = |line: &str| {
            let mut reader =
                csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
            parse(&reader.records().next()?.ok()?, columns, &by)
        };
        let rows: Vec<(usize, Row)> = text.lines().skip(2).filter_map(row).collect();
        if by != *fingerprint || has_returns {
            let bytes = [journal.header.as_bytes(), &journal.lines(&rows)?].concat();
            journal.file = file::replace(path, |mut new: &File| {
                let _ = file::is_held_elsewhere(new);
                new.write_all(&bytes)?;
                new.try_clone()
            })
            .map_err(failed)?;
        } else {
            journal.file.set_len(whole as u64).map_err(failed)?;
            journal.file.seek(SeekFrom::End(0)).map_err(failed)?;
        }
        Ok((journal, rows.into_iter().collect()))
    }

    /// Forgets all cells.
    pub(super) fn begin(&mut self) -> Result<(), JournalError> {
        let failed = |source| JournalError::File { path: self.path.clone(), source };
        self.file.set_len(0).map_err(failed)?;
        self.file.seek(SeekFrom::Start(0)).map_err(failed)?;
        self.file.write_all(self.header.as_bytes()).map_err(failed)
    }

    /// Writes these cells through to the disk.
    pub(super) fn append(&mut self, rows: &[(usize, Row)]) -> Result<(), JournalError> {
        let bytes = self.lines(rows)?;
        let failed = |source| JournalError::File { path: self.path.clone(), source };
        self.file.write_all(&bytes).and_then(|()| self.file.sync_data()).map_err(failed)
    }

    fn lines(&self, rows: &[(usize, Row)]) -> Result<Vec<u8>, JournalError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |source| JournalError::File { path: self.path.clone(), source };
        for (cell, row) in rows {
            let values = row.iter().map(|value| match value {
                Value::Number(number) => number.to_string(),
                Value::Whole(whole) => whole.to_string(),
                Value::Text(text) => text.clone(),
                Value::Flag(flag) => flag.to_string(),
            });
            let mut fields: Vec<String> = std::iter::once(cell.to_string()).chain(values).collect();
            fields.push(check(&self.fingerprint, fields.iter().map(String::as_str)));
            writer.write_record(fields).map_err(|error| failed(error.into()))?;
        }
        writer.into_inner().map_err(|error| failed(error.into_error()))
    }
}

/// Returns the check sum of a row: 16 hexadecimal digits.
fn check<'a>(fingerprint: &Fingerprint, fields: impl Iterator<Item = &'a str>) -> String {
    let mut digest = Sha256::new_with_prefix(fingerprint.to_string());
    for field in fields {
        digest.update((field.len() as u64).to_le_bytes());
        digest.update(field);
    }
    digest.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

fn parse(
    record: &csv::StringRecord,
    columns: &[Column],
    fingerprint: &Fingerprint,
) -> Option<(usize, Row)> {
    let fields = columns.len() + 1;
    if record.len() != fields + 1
        || record.get(fields)? != check(fingerprint, record.iter().take(fields))
    {
        return None;
    }
    let cell = record.get(0)?.parse().ok()?;
    let row: Option<Row> = columns
        .iter()
        .zip(record.iter().skip(1))
        .map(|(column, field)| {
            Some(match column.kind {
                Kind::Number => Value::Number(field.parse().ok()?),
                Kind::Whole => Value::Whole(field.parse().ok()?),
                Kind::Text => Value::from(field),
                Kind::Flag => Value::Flag(field.parse().ok()?),
            })
        })
        .collect();
    Some((cell, row?))
}
