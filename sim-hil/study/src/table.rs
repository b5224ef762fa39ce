//! The table of a study as one Parquet file, and the joining of shards.
//!
//! The file carries study, fingerprint, shard, number of cells, parameters and columns as key-value
//! metadata, so that it explains itself and strangers are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flix_sim::study::{Fingerprint, Kind, Row, Shard, Table, Value};
use parquet::basic::{ConvertedType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::types::Type;
use serde::de::DeserializeOwned;

use super::write_whole;

/// Why a table could not be written, read or merged.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be read or written.
    #[error("cannot read or write {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file cannot be written or read as Parquet.
    #[error("{} is no whole Parquet table: {source}", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// What the library said.
        source: ParquetError,
    },
    /// The Parquet file is not of a study.
    #[error("{} was not written by a study: it lacks {what}", path.display())]
    Stranger {
        /// The file.
        path: PathBuf,
        /// What is missing or unreadable.
        what: String,
    },
    /// Nothing to merge.
    #[error("there is nothing to merge: name the results-*.parquet files of all shards")]
    Nothing,
    /// A shard of something else.
    #[error(
        "{} is a shard of {found}, the others are of {expected}: merge only shards of one study, one set of parameters and one build, or state --another-build",
        path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// What it is of.
        found: String,
        /// What the first is of.
        expected: String,
    },
    /// The same cell came twice.
    #[error("{} holds cell {cell}, which another shard holds too: name every shard once", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        /// The cell.
        cell: usize,
    },
    /// Cells are missing.
    #[error(
        "{missing} of {cells} cells are in none of the shards, the first is cell {first}: run or name the shards that hold them"
    )]
    Missing {
        /// How many.
        missing: usize,
        /// The first of them.
        first: usize,
        /// Of how many.
        cells: usize,
    },
}

/// Writes a table. The file appears whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn write(table: &Table, path: &Path) -> Result<(), TableError> {
    let bytes = to_parquet(table)
        .map_err(|source| TableError::Parquet { path: path.to_owned(), source })?;
    write_whole(path, &bytes).map_err(|source| TableError::File { path: path.to_owned(), source })
}

fn to_parquet(table: &Table) -> Result<Vec<u8>, ParquetError> {
    let mut fields = vec![Arc::new(
        Type::primitive_type_builder("cell", Physical::INT64)
            .with_repetition(Repetition::REQUIRED)
            .build()?,
    )];
    for column in &table.columns {
        let of = |physical| Type::primitive_type_builder(&column.name, physical);
        let builder = match column.kind {
            Kind::Number => of(Physical::DOUBLE),
            Kind::Whole => of(Physical::INT64).with_converted_type(ConvertedType::UINT_64),
            Kind::Text => of(Physical::BYTE_ARRAY).with_converted_type(ConvertedType::UTF8),
            Kind::Flag => of(Physical::BOOLEAN),
        };
        fields.push(Arc::new(builder.with_repetition(Repetition::REQUIRED).build()?));
    }
    let schema = Arc::new(Type::group_type_builder("study").with_fields(fields).build()?);
    let entry = |key: &str, value: String| KeyValue::new(key.to_owned(), Some(value));
    let properties = WriterProperties::builder()
        .set_key_value_metadata(Some(vec![
            entry("study", table.study.clone()),
            entry("fingerprint", table.fingerprint.to_string()),
            entry("shard", table.shard.to_string()),
            entry("cells", table.cells.to_string()),
            entry("parameters", table.parameters.to_string()),
            entry("columns", serde_json::json!(table.columns).to_string()),
            entry("program", flix_host::system::program::get().to_owned()),
        ]))
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;

    let cells: Vec<i64> = table.rows.keys().map(|cell| *cell as i64).collect();
    if let Some(mut column) = group.next_column()? {
        column.typed::<Int64Type>().write_batch(&cells, None, None)?;
        column.close()?;
    }
    for column in &table.columns {
        let Some(mut out) = group.next_column()? else { break };
        match column.kind {
            Kind::Number => {
                let numbers = table.numbers(&column.name);
                out.typed::<DoubleType>().write_batch(&numbers, None, None)?;
            }
            Kind::Whole => {
                let whole = table.values(&column.name, Value::whole);
                let whole: Vec<i64> = whole.into_iter().map(u64::cast_signed).collect();
                out.typed::<Int64Type>().write_batch(&whole, None, None)?;
            }
            Kind::Flag => {
                let flags = table.values(&column.name, Value::flag);
                out.typed::<BoolType>().write_batch(&flags, None, None)?;
            }
            Kind::Text => {
                let words: Vec<ByteArray> =
                    table.texts(&column.name).into_iter().map(ByteArray::from).collect();
                out.typed::<ByteArrayType>().write_batch(&words, None, None)?;
            }
        }
        out.close()?;
    }
    group.close()?;
    writer.into_inner()
}

/// Reads a table that [`write()`] wrote.
///
/// # Errors
/// When the file is missing, damaged, or of something else.
pub fn read(path: &Path) -> Result<Table, TableError> {
    let file = flix_host::system::file::open(path)
        .map_err(|source| TableError::File { path: path.to_owned(), source })?;
    let damaged = |source| TableError::Parquet { path: path.to_owned(), source };
    let stranger =
        |what: &str| TableError::Stranger { path: path.to_owned(), what: what.to_owned() };
    let reader = SerializedFileReader::new(file).map_err(damaged)?;
    let metadata = reader.metadata().file_metadata();
    let entry = |key: &str| {
        metadata
            .key_value_metadata()
            .and_then(|entries| entries.iter().find(|entry| entry.key == key))
            .and_then(|entry| entry.value.clone())
            .ok_or_else(|| stranger(key))
    };
    let mut rows = BTreeMap::new();
    for record in reader.get_row_iter(None).map_err(damaged)? {
        let record = record.map_err(damaged)?;
        let mut cell = None;
        let mut row = Row::new();
        for (index, (_, field)) in record.get_column_iter().enumerate() {
            match field {
                Field::Long(number) if index == 0 => cell = usize::try_from(*number).ok(),
                Field::Double(number) => row.push(Value::Number(*number)),
                Field::ULong(whole) => row.push(Value::Whole(*whole)),
                Field::Str(text) => row.push(Value::Text(text.clone())),
                Field::Bool(flag) => row.push(Value::Flag(*flag)),
                _ => return Err(stranger("a table of numbers and words")),
            }
        }
        rows.insert(cell.ok_or_else(|| stranger("the cell column"))?, row);
    }
    Ok(Table {
        study: entry("study")?,
        fingerprint: Fingerprint::parse(entry("fingerprint")?),
        shard: entry("shard")?.parse().map_err(|_| stranger("a readable shard"))?,
        cells: entry("cells")?.parse().map_err(|_| stranger("a readable number of cells"))?,
        parameters: json(&entry("parameters")?).ok_or_else(|| stranger("readable parameters"))?,
        columns: json(&entry("columns")?).ok_or_else(|| stranger("readable columns"))?,
        rows,
    })
}

fn json<T: DeserializeOwned>(text: &str) -> Option<T> {
    serde_json::from_str(text).ok()
}

/// Joins the tables of all shards into that of the whole study.
///
/// # Errors
/// When a file is of another study, other parameters or, unless `of_any_build`, another build, when a cell is there
/// twice, or when cells are missing.
pub fn merge(paths: &[PathBuf], of_any_build: bool) -> Result<Table, TableError> {
    let mut whole: Option<Table> = None;
    for path in paths {
        let shard = read(path)?;
        let Some(merged) = &mut whole else {
            whole = Some(shard);
            continue;
        };
        let identity = |table: &Table| match of_any_build {
            true => format!("{} {}", table.study, table.fingerprint.parameters()),
            false => format!("{} {}", table.study, table.fingerprint),
        };
        if identity(merged) != identity(&shard) {
            return Err(TableError::Other {
                path: path.clone(),
                found: identity(&shard),
                expected: identity(merged),
            });
        }
        for (cell, row) in shard.rows {
            if merged.rows.insert(cell, row).is_some() {
                return Err(TableError::Twice { path: path.clone(), cell });
            }
        }
    }
    let mut whole = whole.ok_or(TableError::Nothing)?;
    let mut missing = (0..whole.cells).filter(|cell| !whole.rows.contains_key(cell));
    if let Some(first) = missing.next() {
        let missing = 1 + missing.count();
        return Err(TableError::Missing { missing, first, cells: whole.cells });
    }
    whole.shard = Shard::WHOLE;
    Ok(whole)
}
