//! The table of a study.

use std::collections::BTreeMap;

use serde_json::{Map, json};

use super::column::{Column, FAILURE, Fingerprint, Kind, Row, Value, keeps, object};
use super::figure::Figure;
use super::shard::Shard;

/// Rows of a study, or of one shard of it, with what they belong to.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Name of the study.
    pub study: String,
    /// What the results depend on.
    pub fingerprint: Fingerprint,
    /// The cells that are in it.
    pub shard: Shard,
    /// Cells of the whole study.
    pub cells: usize,
    /// What the caller chose.
    pub parameters: serde_json::Value,
    /// Meaning of the rows' values.
    pub columns: Vec<Column>,
    /// By cell.
    pub rows: BTreeMap<usize, Row>,
}

impl Table {
    /// Returns where a column is in a row; `None` when there is no such column.
    #[must_use]
    pub fn index(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.name == name)
    }

    /// Picks the values of a column, in order of cells; none when there is no such column.
    pub fn values<'a, T>(&'a self, name: &str, pick: impl Fn(&'a Value) -> Option<T>) -> Vec<T> {
        let index = self.index(name);
        let values = self.rows.values().filter_map(|row| row.get(index?));
        values.filter_map(pick).collect()
    }

    /// Values of one column of numbers, in order of cells; empty when there is no such column.
    #[must_use]
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        self.values(name, Value::number)
    }

    /// Words of one column of text, in order of cells; empty when there is no such column.
    #[must_use]
    pub fn texts(&self, name: &str) -> Vec<&str> {
        self.values(name, Value::as_text)
    }

    /// Returns the rows of the simulations that did not fail, and why the others did, in order of cells.
    #[must_use]
    pub fn succeeded(&self) -> (Self, Vec<String>) {
        let mut table = self.clone();
        let mut failures = self.texts(FAILURE).into_iter();
        table.rows.retain(|_, _| failures.next().is_none_or(str::is_empty));
        let why = self.texts(FAILURE).into_iter().filter(|failure| !failure.is_empty());
        (table, why.map(str::to_owned).collect())
    }

    /// Returns whether a row did not fail and keeps all limits.
    #[must_use]
    pub fn keeps(&self, row: &Row) -> bool {
        row.last().and_then(Value::as_text).is_some_and(str::is_empty) && keeps(&self.columns, row)
    }

    /// Returns whether no cell failed and every value keeps its limit.
    #[must_use]
    pub fn pass(&self) -> bool {
        self.rows.values().all(|row| self.keeps(row))
    }

    /// Returns the worst value of each column that has a limit, of the cells that did not fail.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        let (succeeded, _) = self.succeeded();
        let worst = |column: &Column| {
            let numbers = succeeded.numbers(&column.name).into_iter();
            let there = numbers.filter(|number| !(column.may_be_missing && number.is_nan()));
            Figure::worst(&column.name, column.limit?, there)
        };
        let is_figure = |column: &&Column| column.kind != Kind::Flag;
        self.columns.iter().filter(is_figure).filter_map(worst).collect()
    }

    /// Returns the rows as JSON objects. A missing number is null; a cell that failed has the key `failure`.
    #[must_use]
    pub fn objects(&self) -> Vec<Map<String, serde_json::Value>> {
        let each = self.rows.values().map(|row| {
            let mut object = object(self.columns.iter().zip(row));
            if object.get(FAILURE).is_some_and(|failure| *failure == json!(null)) {
                object.remove(FAILURE);
            }
            object
        });
        each.collect()
    }
}
