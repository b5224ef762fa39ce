//! A study whose runs are values.

use std::fmt::Display;

use super::Study;
use super::column::{Column, Row};

/// Returns what a run asks in one of its rows.
type Asked<C> = Box<dyn Fn(&C, usize) -> Row + Send + Sync>;
/// Returns what was found in each row of a run.
type Found<C> = Box<dyn Fn(&C) -> Result<Vec<Row>, String> + Send + Sync>;

/// A study whose runs are values of one type. Each gives one row or several.
pub struct Measurement<C> {
    name: &'static str,
    parameters: serde_json::Value,
    columns: Vec<Column>,
    runs: Vec<C>,
    /// Of each cell: its run, and the number of its row there.
    cells: Vec<(usize, usize)>,
    asked: Asked<C>,
    found: Found<C>,
    rows_key: &'static str,
    groups: &'static [&'static str],
    facts: serde_json::Value,
}

impl<C> Measurement<C> {
    /// Creates a measurement without runs. `asked` returns the first values of a row, `found` the others of all rows of a run.
    pub fn new<E: Display>(
        name: &'static str,
        parameters: serde_json::Value,
        columns: Vec<Column>,
        asked: impl Fn(&C, usize) -> Row + Send + Sync + 'static,
        found: impl Fn(&C) -> Result<Vec<Row>, E> + Send + Sync + 'static,
    ) -> Self {
        let found = move |run: &C| found(run).map_err(|error| error.to_string());
        Self {
            name,
            parameters,
            columns,
            runs: Vec::new(),
            cells: Vec::new(),
            asked: Box::new(asked),
            found: Box::new(found),
            rows_key: "cells",
            groups: &[],
            facts: serde_json::json!({}),
        }
    }

    /// Adds runs, each of so many rows.
    #[must_use]
    pub fn runs(mut self, runs: impl IntoIterator<Item = C>, rows: usize) -> Self {
        for run in runs {
            let number = self.runs.len();
            self.cells.extend((0..rows).map(|row| (number, row)));
            self.runs.push(run);
        }
        self
    }

    /// Chooses the key of the rows in JSON, and the columns by which rows are grouped for people.
    #[must_use]
    pub fn listed(self, rows_key: &'static str, groups: &'static [&'static str]) -> Self {
        Self { rows_key, groups, ..self }
    }

    /// Adds keys to the JSON object.
    #[must_use]
    pub fn with_facts(self, facts: serde_json::Value) -> Self {
        Self { facts, ..self }
    }
}

impl<C: Sync> Study for Measurement<C> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn label(&self) -> String {
        self.name.to_owned()
    }

    fn parameters(&self) -> serde_json::Value {
        self.parameters.clone()
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn asked(&self, cell: usize) -> Row {
        let (run, row) = self.cells[cell];
        (self.asked)(&self.runs[run], row)
    }

    fn cells(&self) -> usize {
        self.cells.len()
    }

    fn run_of(&self, cell: usize) -> usize {
        self.cells[cell].0
    }

    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
        let of_run = |cells: &[usize]| {
            let found = (self.found)(&self.runs[self.run_of(cells[0])]);
            let row = |cell: &usize| match &found {
                Ok(rows) => {
                    rows.get(self.cells[*cell].1).cloned().ok_or_else(|| "missing".to_owned())
                }
                Err(failure) => Err(failure.clone()),
            };
            cells.iter().map(row).collect::<Vec<_>>()
        };
        cells
            .chunk_by(|one, other| self.run_of(*one) == self.run_of(*other))
            .flat_map(of_run)
            .collect()
    }

    fn rows_key(&self) -> &'static str {
        self.rows_key
    }

    fn facts(&self) -> serde_json::Value {
        self.facts.clone()
    }

    fn groups(&self) -> &'static [&'static str] {
        self.groups
    }
}

#[cfg(test)]
mod tests {
    use super::super::compute;
    use super::*;
    use crate::study::FAILURE;

    #[test]
    fn a_run_that_panics_or_fails_costs_its_own_row() {
        let found = |run: &u64| match run {
            1 => Err("diverged"),
            2 => panic!("a defect"),
            run => Ok(vec![vec![(*run).into()]]),
        };
        let columns = ["run", "found"].map(Column::whole).to_vec();
        let asked = |run: &u64, _| vec![(*run).into()];
        let study = Measurement::new("test", serde_json::json!({}), columns, asked, found);
        let table = compute(&study.runs(0..4, 1));
        let failure = table.index(FAILURE).unwrap();
        let failures = table.rows.values().map(|row| row[failure].as_text().unwrap());
        assert_eq!(failures.collect::<Vec<_>>(), ["", "diverged", "panicked", ""]);
        assert!(!table.pass());
    }
}
