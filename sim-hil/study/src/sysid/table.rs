//! The files of an identification: one CSV for each experiment.

use std::path::Path;

pub use crate::measured::Column;
use crate::measured::{Lines, MeasuredError, read_columns};

/// A file of required columns.
#[derive(Debug, Clone, Copy)]
pub struct Table<const N: usize> {
    /// Its name, without `.csv`.
    pub name: &'static str,
    /// Its columns.
    pub columns: [Column; N],
    /// How many rows it takes.
    pub fewest: usize,
}

/// Rows of a file, each with its line, from 1.
pub type Numbered<const N: usize> = Vec<(u64, [f64; N])>;

impl<const N: usize> Table<N> {
    /// Reads it, if it is there: each line, from 1, with its row.
    ///
    /// # Errors
    /// When it is refused, with file, line and column.
    pub fn read(&self, folder: &Path) -> Result<Option<Numbered<N>>, MeasuredError> {
        let lines = self.read_with(folder, &[])?;
        let row = |row: &Vec<f64>| core::array::from_fn(|i| row[i]);
        let all =
            |lines: Lines| lines.rows.iter().map(|(line, values)| (*line, row(values))).collect();
        Ok(lines.map(all))
    }

    /// Reads it with further columns that it may have.
    ///
    /// # Errors
    /// As [`Table::read`].
    pub fn read_with(
        &self,
        folder: &Path,
        optional: &[Column],
    ) -> Result<Option<Lines>, MeasuredError> {
        let path = folder.join(self.name).with_extension("csv");
        // A link that leads nowhere is refused when it is opened.
        if !path.is_symlink() && !path.exists() {
            return Ok(None);
        }
        let columns = [self.columns.as_slice(), optional].concat();
        read_columns(&path, &columns, N, self.fewest).map(Some)
    }

    /// Writes rows as they are read. Rows may have the further columns.
    #[must_use]
    pub fn to_csv(&self, optional: &[Column], rows: &[Vec<f64>]) -> String {
        let columns = [self.columns.as_slice(), optional].concat();
        let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
        let mut text = names.join(",") + "\n";
        for row in rows {
            let cells = row.iter().zip(&columns).map(|(value, column)| column.show(*value));
            text += &(cells.collect::<Vec<_>>().join(",") + "\n");
        }
        text
    }
}
