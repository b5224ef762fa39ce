#![forbid(unsafe_code)]
//! Studies: many independent cells, computed in parallel, never lost.
//!
//! A [`flix_sim::study::Study`] lists its cells and computes a batch of them. [`run`] does the rest: it takes the
//! cells of a shard, skips those that an interrupted run of the same program already finished, computes
//! the others on all cores with a progress bar, writes each batch to the journal as it ends, and at
//! last writes one Parquet file. [`merge`] joins the Parquet files of shards into that of the whole.
//!
//! ```text
//! cells of the study -> those of the shard -> those not in cells.csv -> computed -> cells.csv
//!                                                                  all there? -> results.parquet
//! ```
//!
//! What a result depends on (parameters, model, the bytes of the program that runs) is hashed into a
//! [`Fingerprint`]; results of another fingerprint are never mixed. Those of other parameters are refused, those of another
//! program are computed anew.

pub mod actuation;
pub mod calibrate;
pub mod cmaes;
pub mod controllers;
pub mod figure;
pub mod front;
pub mod headroom;
mod journal;
pub mod learn;
pub mod leg;
pub mod measured;
pub mod modes;
pub mod selection;
pub mod sensitivity;
pub mod statements;
pub mod sweep;
pub mod sysid;
mod table;

pub use journal::{Earlier, JournalError};
pub use table::{TableError, merge, read, write};

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use flix_host::system::file;
use flix_host::system::interrupt::Interrupt;
use flix_sim::study::{
    Fingerprint, Row, Shard, Study, Table, all_columns, batches, rows as rows_of,
};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use sha2::{Digest, Sha256};

use journal::Journal;

/// Returns what the results of a study depend on.
#[must_use]
pub fn fingerprint(study: &dyn Study) -> Fingerprint {
    static PROGRAM: OnceLock<String> = OnceLock::new();
    // A program that cannot be read is known by its version alone.
    let bytes = || std::env::current_exe().and_then(std::fs::read);
    let program = PROGRAM
        .get_or_init(|| short_hash(&bytes().unwrap_or_else(|_| env!("CARGO_PKG_VERSION").into())));
    fingerprint_by(study, program)
}

/// Returns the fingerprint of a study that this program computes.
fn fingerprint_by(study: &dyn Study, program: &str) -> Fingerprint {
    let identity = serde_json::json!({
        "study": study.name(),
        "parameters": study.parameters(),
        "columns": all_columns(study),
    });
    Fingerprint::new(&short_hash(identity.to_string().as_bytes()), program)
}

/// Returns the first 16 hexadecimal digits of the SHA-256 hash.
fn short_hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

/// Where and how to run a study.
#[derive(Debug, Clone)]
pub struct Options {
    /// Folder for everything that the study writes; made when missing.
    pub folder: PathBuf,
    /// The cells to compute.
    pub shard: Shard,
    /// What is taken of what an earlier run left in the folder.
    pub earlier: Earlier,
    /// Ends the run between two batches, with all finished cells kept.
    pub interrupt: Interrupt,
}

/// Why a study did not end with a table.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The journal failed.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The table failed.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Somebody asked to end.
    #[error(
        "interrupted with {finished} of {cells} cells finished; run the same command again to go on"
    )]
    Interrupted {
        /// Cells that are safe.
        finished: usize,
        /// Cells of the shard.
        cells: usize,
    },
}

impl Options {
    /// Returns the name of the folder's files for this shard.
    fn path(&self, stem: &str, extension: &str) -> PathBuf {
        self.folder.join(format!("{stem}{}.{extension}", self.shard.suffix()))
    }
}

/// Computes what is missing and returns the whole table of the shard, rows in order of cells, those of failed cells too.
///
/// # Errors
/// See [`StudyError`]; finished cells are on the disk whatever happens, and the same call goes on
/// from there.
pub fn run(study: &dyn Study, options: &Options) -> Result<Table, StudyError> {
    run_as(study, options, fingerprint(study))
}

/// Runs a study whose results depend on this.
fn run_as(
    study: &dyn Study,
    options: &Options,
    fingerprint: Fingerprint,
) -> Result<Table, StudyError> {
    let columns = all_columns(study);
    let is_of_shard = |cell: usize| options.shard.contains(study.run_of(cell));
    let cells: Vec<usize> = (0..study.cells()).filter(|cell| is_of_shard(*cell)).collect();
    let journal_path = options.path("cells", "csv");
    let (mut journal, mut rows) =
        Journal::open(&journal_path, study.name(), &fingerprint, &columns, options.earlier)?;
    rows.retain(|cell, _| *cell < study.cells() && is_of_shard(*cell));
    if rows.len() == cells.len() && options.earlier == Earlier::Unfinished {
        journal.begin()?;
        rows.clear();
    }
    let missing: Vec<usize> =
        cells.iter().copied().filter(|cell| !rows.contains_key(cell)).collect();

    let bar = progress(cells.len() as u64, study.name());
    bar.set_position(rows.len() as u64);
    bar.reset_eta();
    let journal = Mutex::new(journal);
    let computed: Vec<Result<Vec<(usize, Row)>, StudyError>> = batches(study, &missing)
        .into_par_iter()
        .map(|batch| {
            if options.interrupt.is_raised() {
                return Ok(Vec::new());
            }
            let rows = rows_of(study, &columns, batch);
            journal.lock().unwrap_or_else(std::sync::PoisonError::into_inner).append(&rows)?;
            bar.inc(batch.len() as u64);
            Ok(rows)
        })
        .collect();

    let mut failure = None;
    for batch in computed {
        match batch {
            Ok(batch) => rows.extend(batch),
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    match failure {
        Some(failure) => return Err(failure),
        None if rows.len() < cells.len() => {
            return Err(StudyError::Interrupted { finished: rows.len(), cells: cells.len() });
        }
        None => bar.finish_and_clear(),
    }
    let table = Table {
        study: study.name().to_owned(),
        fingerprint,
        shard: options.shard,
        cells: study.cells(),
        parameters: study.parameters(),
        columns,
        rows,
    };
    write(&table, &options.path("results", "parquet"))?;
    Ok(table)
}

/// Creates a bar with time left on standard error; invisible when that is no terminal.
#[must_use]
pub fn progress(steps: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(steps).with_message(what);
    if let Ok(style) =
        ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {elapsed} (left: {eta})")
    {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Writes a file that appears whole or not at all.
pub fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    file::replace(path, |mut new| new.write_all(bytes))
}

#[cfg(test)]
mod tests;
