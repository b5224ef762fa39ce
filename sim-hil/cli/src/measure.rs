//! What commands that measure have in common: where their cells are kept, and what becomes of their tables.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::{Map, Value as Json};

use super::error::Error;
use super::output::{mark, outside, print_figures, table as aligned};
use super::study::RunArgs;
use flix_sim::study::{Column, FAILURE, Figure, Kind, Limit, Row, Study, Table, Value};

/// Folder of all measurements.
const FOLDER: &str = "out";
/// Longest list of different words that a row of a group shows, bytes.
const LONGEST_WORDS: usize = 60;

/// Where a measurement is kept, and what is printed.
#[derive(Debug, Clone, clap::Args)]
pub struct MeasureArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Print every cell as JSON only
    #[arg(long)]
    pub(crate) json: bool,
}

impl MeasureArgs {
    /// Computes what is missing of a measurement; returns its table and the folder where it is kept.
    pub(crate) fn table(
        &self,
        command: &str,
        study: &dyn Study,
    ) -> Result<(Table, PathBuf), Error> {
        let folder = self.run.folder_below(&Path::new(FOLDER).join(command), study);
        Ok((self.run.compute(study, &folder)?, folder))
    }

    /// Returns a line that says where a slice is; empty where the measurement is the whole.
    pub(crate) fn next(&self, study: &dyn Study, folder: &Path) -> String {
        self.run.next(study, folder)
    }
}

/// Computes what is missing of the parts of a measurement and prints all of them; the exit code states whether no cell failed and
/// every value keeps its limit.
pub fn measure(command: &str, parts: &[&dyn Study], args: &MeasureArgs) -> Result<ExitCode, Error> {
    let mut tables = Vec::new();
    for part in parts {
        let mut args = args.clone();
        // Parts share no file.
        if let Some(folder) = args.run.out.as_mut().filter(|_| parts.len() > 1) {
            folder.push(part.rows_key());
        }
        let (table, folder) = args.table(command, *part)?;
        tables.push((*part, table, folder));
    }
    let pass = tables.iter().all(|(_, table, _)| table.pass());
    let json = json(tables.iter().map(|(study, table, _)| (*study, table)), pass);
    print_figures(&json, pass, args.json, || {
        let mut text = String::new();
        for (study, table, folder) in &tables {
            text += &format!("{}\n", of_groups(table, study.groups(), study.asked(0).len()));
            text += &outside(table);
            text += &args.next(*study, folder);
        }
        let verdict = if pass { "All within limits." } else { "Not all within limits." };
        text + verdict + "\n"
    })
}

/// Returns all parts of a measurement as one JSON object.
fn json<'a>(parts: impl Iterator<Item = (&'a dyn Study, &'a Table)>, pass: bool) -> Json {
    let mut all = Map::new();
    let mut figures = Vec::new();
    for (study, table) in parts {
        if let Json::Object(facts) = study.facts() {
            all.extend(facts);
        }
        all.insert(study.rows_key().to_owned(), Json::from(table.objects()));
        figures.extend(table.figures());
    }
    all.insert("figures".to_owned(), serde_json::json!(figures));
    all.insert("pass".to_owned(), pass.into());
    all.into()
}

/// Returns a table for people: all rows, or of each group the worst values.
fn of_groups(table: &Table, groups: &[&str], asked: usize) -> String {
    let (succeeded, _) = table.succeeded();
    let is_shown = |(index, column): &(usize, &Column)| {
        let is_group = groups.contains(&column.name.as_str());
        let is_value = column.kind != Kind::Flag && column.name != FAILURE;
        is_group || is_value && (groups.is_empty() || *index >= asked)
    };
    let columns: Vec<(usize, &Column)> =
        table.columns.iter().enumerate().filter(is_shown).collect();
    let group = |row: &Row| -> Vec<Value> {
        groups.iter().filter_map(|name| Some(row[table.index(name)?].clone())).collect()
    };
    let mut rows: Vec<Vec<&Row>> = Vec::new();
    for row in succeeded.rows.values() {
        let of_same = |of: &&mut Vec<&Row>| group(of[0]) == group(row) && !groups.is_empty();
        match rows.iter_mut().find(of_same) {
            Some(of) => of.push(row),
            None => rows.push(vec![row]),
        }
    }
    let names = columns.iter().map(|(_, column)| column.name.clone());
    let mut lines: Vec<Vec<String>> = vec![names.collect()];
    if !groups.is_empty() {
        lines[0].push("cells".to_owned());
    }
    for rows in rows {
        let values = |index: usize| rows.iter().map(move |row| &row[index]);
        let mut line: Vec<String> =
            columns.iter().map(|(index, column)| worst(column, values(*index))).collect();
        if !groups.is_empty() {
            line.push(rows.len().to_string());
        }
        line.push(mark(rows.iter().all(|row| table.keeps(row))).to_owned());
        lines.push(line);
    }
    let limits = columns.iter().map(|(_, column)| column.limit.map_or_else(String::new, bound));
    let mut limits: Vec<String> = limits.collect();
    if limits.iter().any(|limit| !limit.is_empty()) {
        limits[0] = "limit".to_owned();
        lines.push(limits);
    }
    aligned(&lines)
}

fn bound(limit: Limit) -> String {
    short(limit.bound())
}

/// Returns the worst of these values: by its limit, the largest magnitude where there is none, or all different words.
fn worst<'a>(column: &Column, values: impl Iterator<Item = &'a Value>) -> String {
    match column.kind {
        Kind::Text => {
            let mut words: Vec<&str> =
                values.filter_map(Value::as_text).filter(|word| !word.is_empty()).collect();
            words.sort_unstable();
            words.dedup();
            let all = words.join(", ");
            if all.len() <= LONGEST_WORDS { all } else { format!("{} different", words.len()) }
        }
        Kind::Number | Kind::Whole | Kind::Flag => {
            let limit = column.limit.unwrap_or(Limit::Within(f64::INFINITY));
            let numbers: Vec<f64> = values.filter_map(Value::number).collect();
            let mut there = numbers.iter().copied();
            let all_count = column.limit.is_some() && !column.may_be_missing;
            let figure =
                Figure::worst("", limit, there.by_ref().filter(|it| all_count || !it.is_nan()));
            figure.map_or_else(|| "-".to_owned(), |figure| short(figure.value))
        }
    }
}

/// Digits of a number.
const DIGITS: i32 = 4;
/// Largest and smallest magnitudes that are written without an exponent.
const PLAIN: (f64, f64) = (1e-4, 1e6);

/// Returns a number with four digits.
fn short(number: f64) -> String {
    let magnitude = number.abs();
    if number.is_nan() {
        "-".to_owned()
    } else if number.fract() == 0.0 && magnitude < PLAIN.1 {
        format!("{number}")
    } else if magnitude < PLAIN.0 || magnitude >= PLAIN.1 {
        format!("{number:.3e}")
    } else {
        let decimals = (DIGITS - 1 - magnitude.log10().floor() as i32).max(0) as usize;
        format!("{number:.decimals$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Robots whose error is the number of their cell, mm; that of cell 3 diverges, if it is asked to.
    struct Robots {
        diverges: bool,
    }

    impl Study for Robots {
        fn name(&self) -> &'static str {
            "robots"
        }

        fn label(&self) -> String {
            "robots".to_owned()
        }

        fn parameters(&self) -> Json {
            serde_json::json!({ "diverges": self.diverges })
        }

        fn columns(&self) -> Vec<Column> {
            vec![
                Column::text("base"),
                Column::number("error_mm").limited(Limit::AtMost(5.0)),
                Column::number("heat_w").limited(Limit::AtMost(1.0)).or_missing(),
                Column::promise("pass"),
            ]
        }

        fn cells(&self) -> usize {
            6
        }

        fn run_of(&self, cell: usize) -> usize {
            cell / 2
        }

        fn asked(&self, cell: usize) -> Row {
            vec![["fixed", "free"][cell / 3].into()]
        }

        fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
            let found = |cell: &usize| match cell {
                3 if self.diverges => Err("the simulation diverged".to_owned()),
                _ => Ok(vec![(*cell as f64).into(), None.into(), true.into()]),
            };
            cells.iter().map(found).collect()
        }

        fn facts(&self) -> Json {
            serde_json::json!({ "seed": 7 })
        }

        fn groups(&self) -> &'static [&'static str] {
            &["base"]
        }
    }

    fn args(folder: &Path, shard: &str) -> MeasureArgs {
        let (shard, out) = (shard.parse().unwrap(), Some(folder.to_owned()));
        let run = RunArgs { shard, out, resume: false, restart: false, another_build: false };
        MeasureArgs { run, json: false }
    }

    #[test]
    fn a_robot_that_diverges_in_cell_3_costs_one_row_and_the_exit_code() {
        for (diverges, exit) in [(false, ExitCode::SUCCESS), (true, ExitCode::FAILURE)] {
            let folder = tempfile::tempdir().unwrap();
            let (study, args) = (Robots { diverges }, args(folder.path(), "1/1"));
            assert_eq!(measure("robots", &[&study], &args).unwrap(), exit);
            let (table, _) = args.table("robots", &study).unwrap();
            let (succeeded, failures) = table.succeeded();
            assert_eq!((table.rows.len(), succeeded.rows.len()), (6, 6 - usize::from(diverges)));
            assert_eq!(failures, vec!["the simulation diverged"; usize::from(diverges)]);
            let json = json([(&study as &dyn Study, &table)].into_iter(), table.pass());
            assert_eq!((&json["pass"], &json["seed"]), (&(!diverges).into(), &7.into()));
            assert_eq!(json["cells"][5]["error_mm"], 5.0);
            let failed = &json["cells"][3];
            assert_eq!(failed.get("failure").is_some(), diverges, "{failed}");
            assert_eq!(outside(&table).contains("diverged"), diverges);
        }
    }

    #[test]
    fn slices_separate_no_run_and_merged_equal_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let study = Robots { diverges: true };
        let (whole, _) = args(folder.path(), "1/1").table("robots", &study).unwrap();
        let slices = [1, 2].map(|index| {
            let args = args(folder.path(), &format!("{index}/2"));
            let (table, _) = args.table("robots", &study).unwrap();
            assert!(table.rows.keys().all(|cell| table.rows.contains_key(&(cell ^ 1))));
            folder.path().join(format!("results-{index}-of-2.parquet"))
        });
        let merged = flix_study::merge(&slices, false).unwrap();
        // NaN is not equal to itself.
        assert_eq!(format!("{merged:?}"), format!("{whole:?}"));
        assert!(!merged.pass());
    }

    #[test]
    fn people_see_the_worst_of_each_group_its_limit_and_what_is_outside() {
        let mut table = flix_sim::study::compute(&Robots { diverges: false });
        table.columns[1].limit = Some(Limit::AtMost(4.0));
        assert_eq!(
            of_groups(&table, &["base"], 1),
            "base   error_mm  heat_w  cells\n\
             fixed         2       -      3\n\
             free          5       -      3  <-- outside\n\
             limit         4       1\n"
        );
        assert!(
            outside(&table).starts_with("outside: base \"free\", error_mm 5.0"),
            "{}",
            outside(&table)
        );
        assert_eq!(
            [0.25, 35.0, -1.23456, 1.5e-7, f64::NAN].map(short),
            ["0.2500", "35", "-1.235", "1.500e-7", "-"]
        );
    }
}
