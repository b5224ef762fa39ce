//! Measurements and studies as data: cells that are computed one by one, the table of their rows, and the limits of its columns.
//!
//! A [`Study`] lists its cells and computes them. [`compute`] computes all of them; `flix_study::run` keeps them on the disk as
//! they finish, in shards. A cell that fails is a row, too: NaN, and the reason in the column `failure`. Table, JSON and verdict
//! follow from the columns: each may carry a [`Limit`], and a table passes when no cell failed and every value keeps its limit.

mod column;
mod figure;
mod measurement;
mod shard;
mod table;

pub use column::{Column, FAILURE, Fingerprint, Kind, Row, Value, keeps};
pub use figure::{Figure, Limit};
pub use measurement::Measurement;
pub use shard::{Shard, ShardError};
pub use table::Table;

use std::panic::{AssertUnwindSafe, catch_unwind};

use rayon::prelude::*;
use serde::Serialize;

/// Many independent cells.
pub trait Study: Sync {
    /// Returns the name for files and people, for example `mobility`.
    fn name(&self) -> &'static str;

    /// Returns what is in the results, in a few words for the name of a folder: the model at least.
    fn label(&self) -> String;

    /// Returns everything that results depend on and that the caller can change, models included.
    fn parameters(&self) -> serde_json::Value;

    /// Returns the columns of the table: what a cell asks, then what was found.
    fn columns(&self) -> Vec<Column>;

    /// Returns what a cell asks: the first values of its row.
    fn asked(&self, cell: usize) -> Row;

    /// Returns how many cells there are.
    fn cells(&self) -> usize;

    /// Returns how many cells are best computed together.
    fn batch(&self) -> usize {
        1
    }

    /// Returns the number of the run of a robot that a cell belongs to. No shard and no batch separates the cells of a run, which
    /// are neighbours.
    fn run_of(&self, cell: usize) -> usize {
        cell
    }

    /// Computes these cells in order: what was found in each, or what went wrong, as a sentence. Must not depend on which cells
    /// come together.
    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>>;

    /// Returns the key of the rows in JSON.
    fn rows_key(&self) -> &'static str {
        "cells"
    }

    /// Returns further keys of the JSON object.
    fn facts(&self) -> serde_json::Value {
        serde_json::json!({})
    }

    /// Returns the columns by which rows are grouped for people; of each group the worst values are shown.
    fn groups(&self) -> &'static [&'static str] {
        &[]
    }
}

/// Returns the columns of a study's table.
#[must_use]
pub fn all_columns(study: &dyn Study) -> Vec<Column> {
    let mut columns = study.columns();
    columns.push(Column::text(FAILURE));
    columns
}

/// Returns cells in batches that separate no run.
#[must_use]
pub fn batches<'a>(study: &dyn Study, mut cells: &'a [usize]) -> Vec<&'a [usize]> {
    let mut batches = Vec::new();
    while !cells.is_empty() {
        let run_at = |place: usize| study.run_of(cells[place]);
        let ends = (study.batch().clamp(1, cells.len())..cells.len())
            .find(|end| run_at(*end) != run_at(end - 1));
        let (batch, rest) = cells.split_at(ends.unwrap_or(cells.len()));
        batches.push(batch);
        cells = rest;
    }
    batches
}

/// Computes cells, and returns their rows. Cells that panic have failed.
#[must_use]
pub fn rows(study: &dyn Study, columns: &[Column], cells: &[usize]) -> Vec<(usize, Row)> {
    let computed = catch_unwind(AssertUnwindSafe(|| study.compute(cells)));
    let found = computed.unwrap_or_else(|_| vec![Err("panicked".to_owned()); cells.len()]);
    let found = cells.iter().zip(found);
    found.map(|(cell, found)| (*cell, row(columns, study.asked(*cell), found))).collect()
}

/// Returns the row of a cell.
fn row(columns: &[Column], asked: Row, found: Result<Row, String>) -> Row {
    let (found, failure) = match found {
        Ok(found) => (found, String::new()),
        Err(failure) => {
            let found = &columns[asked.len()..columns.len() - 1];
            (found.iter().map(|column| column.kind.nothing()).collect(), failure)
        }
    };
    asked.into_iter().chain(found).chain([Value::Text(failure)]).collect()
}

/// Computes all cells on all cores, without the disk.
#[must_use]
pub fn compute(study: &dyn Study) -> Table {
    let columns = all_columns(study);
    let cells: Vec<usize> = (0..study.cells()).collect();
    let batches = batches(study, &cells).into_par_iter();
    let rows = batches.flat_map_iter(|batch| rows(study, &columns, batch)).collect();
    Table {
        study: study.name().to_owned(),
        fingerprint: Fingerprint::default(),
        shard: Shard::WHOLE,
        cells: cells.len(),
        parameters: study.parameters(),
        columns,
        rows,
    }
}

/// Returns a line for every figure: its key in JSON and its value. Null values have no line.
#[must_use]
pub fn lines(figures: &impl Serialize) -> String {
    fn add(text: &mut String, key: &str, value: serde_json::Value) {
        use serde_json::Value;
        match value {
            Value::Object(entries) => {
                let dot = if key.is_empty() { "" } else { "." };
                entries
                    .into_iter()
                    .for_each(|(name, it)| add(text, &format!("{key}{dot}{name}"), it));
            }
            Value::Array(items) if items.iter().any(|it| it.is_object() || it.is_array()) => {
                let items = items.into_iter().enumerate();
                items.for_each(|(index, it)| add(text, &format!("{key}[{index}]"), it));
            }
            Value::Null => {}
            value => *text += &format!("{key}: {value}\n"),
        }
    }
    let mut text = String::new();
    add(&mut text, "", serde_json::to_value(figures).unwrap_or_default());
    text
}
