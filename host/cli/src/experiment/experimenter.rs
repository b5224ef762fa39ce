//! What the experiments share: pairs, a walk, rows that are kept as they come, a report.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::SystemTime;

use flix_protocol::message::Setpoint;
use serde::Serialize;

use crate::drive;
use crate::run::{RecordArgs, Run, unrecorded, verdict};
use flix_host::experiment::walks::{SHORTEST, rows};
use flix_host::experiment::{Sheet, SheetError};
use flix_host::nav::Identification;
use flix_host::pilot::{Helm, Pilot, Recorded};
use flix_host::record::in_calendar;
use flix_shell::output::{complain, optional_path_as_text, path_as_text, print, print_json};
use flix_shell::{Error, Exit};

/// A pair `F:THETA`, Hz and degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair(pub(super) Setpoint);

impl FromStr for Pair {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refusal = |why: String| {
            format!("{text:?} is no pair F:THETA, such as -30:30, Hz and degrees{why}")
        };
        let (f, theta) = text.split_once(':').ok_or_else(|| refusal(String::new()))?;
        let because = |error: String| refusal(format!(": {error}"));
        let f = drive::frequency(f).map_err(because)?;
        let theta = drive::direction(theta).map_err(because)?;
        Setpoint::new(f, theta).map(Self).map_err(|error| because(error.to_string()))
    }
}

impl Pair {
    pub(super) fn name(&self) -> String {
        flix_host::experiment::grid::name(&self.0)
    }
}

/// What was written.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    #[serde(serialize_with = "path_as_text")]
    pub(super) file: PathBuf,
    pub(super) tests: usize,
    pub(super) rows: usize,
    pub(super) ending: String,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "optional_path_as_text")]
    pub(super) record: Option<PathBuf>,
}

impl Report {
    pub(super) fn show(&self, is_json: bool) -> Result<(), Error> {
        if is_json {
            return print_json(self);
        }
        let Self { file, tests, rows, record, .. } = self;
        let mut text = match tests {
            0 => format!("no test is whole: {} is as it was\n", file.display()),
            _ => format!("{tests} tests in {rows} rows written to {}\n", file.display()),
        };
        if let Some(record) = record {
            text += &format!("record {}\n", record.display());
        }
        print(&text)
    }
}

/// Returns the comment above the rows: robot, date and command.
pub(super) fn comment(robot: &str) -> String {
    let date = humantime::format_rfc3339_seconds(in_calendar(SystemTime::now()));
    let words: Vec<String> =
        std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    format!("robot {robot}, {date}: flix {}", words.join(" "))
}

/// An experiment that drives the robot.
pub(crate) struct Experimenter<'a> {
    /// Name of the experiment.
    pub name: &'static str,
    /// Name of the robot.
    pub robot: &'a str,
    pub record: &'a RecordArgs,
    pub sheet: Sheet,
    pub json: bool,
}

impl Experimenter<'_> {
    /// Drives a helm to its end. Writes the rows of each test once it is whole. `done`: tests that are over, and all;
    /// `rows`: whole tests and their rows, numbered on from the last of the file.
    pub fn run<H: Helm>(
        self,
        mut run: Run,
        (helm, names): (H, Vec<String>),
        done: impl Fn(&H) -> (usize, usize),
        rows: impl Fn(&H, f64) -> (usize, Vec<Vec<f64>>),
    ) -> Result<ExitCode, Error> {
        let facts = BTreeMap::from([("file".into(), self.sheet.path().display().to_string())]);
        let recorder = run.record(self.record, self.name, facts)?;
        let mut pilot =
            Pilot::new(helm, names, Some(recorder)).driving_unrecorded(self.record.unrecorded);
        let mut kept = Kept::new(self.sheet, comment(self.robot));
        let message = |pilot: &Pilot<H>| {
            let (done, all) = done(pilot.helm());
            format!("{:<24} test {} of {all}", pilot.doing(), (done + 1).min(all))
        };
        let driven = run.drive_keeping(&mut pilot, message, |helm| {
            kept.keep(done(helm).0, |last| rows(helm, last).1)
        });
        // Where it failed, the run stops the robot, if it still drives it.
        let driven = driven.map(|(ending, _)| (ending, run.leave()));
        let (helm, Recorded { file, error }) = pilot.finish(BTreeMap::new());
        let (tests, rows) = rows(&helm, kept.last);
        let sheet = kept.finish(&rows)?;
        let ending =
            driven.as_ref().map_or_else(ToString::to_string, |(ending, _)| ending.to_string());
        let path = sheet.path().to_owned();
        let report = Report { file: path, tests, rows: rows.len(), ending, record: file.clone() };
        report.show(self.json)?;
        let (ending, stop) = driven?;
        verdict(&ending, stop, file.as_ref())?;
        unrecorded(error, self.record.unrecorded)?;
        Ok(Exit::Done.into())
    }

    /// Drives walks to their end, as [`Self::run`].
    pub fn walk(
        self,
        run: Run,
        helm: Identification,
        names: Vec<String>,
    ) -> Result<ExitCode, Error> {
        let left_out = Cell::new(0);
        let result = self.run(
            run,
            (helm, names),
            |helm| {
                let (done, all) = helm.progress();
                (done as usize, all as usize)
            },
            |helm, _| {
                let rows = rows(helm);
                left_out.set(helm.stretches().len() - rows.len());
                (rows.len(), rows)
            },
        );
        if left_out.get() > 0 {
            complain(format_args!(
                "{} walks are left out: they were shorter than {SHORTEST} s, or the rotors did not hold their pair",
                left_out.get()
            ));
        }
        result
    }
}

/// What was written of a run.
pub(super) struct Kept {
    sheet: Sheet,
    comment: String,
    /// The largest test in the file before the run.
    last: f64,
    /// Tests that were over as of the last look.
    done: usize,
    /// Rows of the run that are in the file.
    rows: usize,
    failed: Option<SheetError>,
}

impl Kept {
    fn new(sheet: Sheet, comment: String) -> Self {
        Self { last: sheet.last(), sheet, comment, done: 0, rows: 0, failed: None }
    }

    /// Writes what is new once another test is over, so that nothing that ends the program takes it away. `rows`: all
    /// of the run so far.
    fn keep(&mut self, done: usize, rows: impl FnOnce(f64) -> Vec<Vec<f64>>) -> Result<(), String> {
        if done == self.done || self.failed.is_some() {
            return Ok(());
        }
        self.done = done;
        self.append(&rows(self.last)).map_err(|error| {
            let trouble = error.to_string();
            self.failed = Some(error);
            trouble
        })
    }

    fn append(&mut self, rows: &[Vec<f64>]) -> Result<(), SheetError> {
        self.sheet.append(&self.comment, &rows[self.rows..])?;
        self.rows = rows.len();
        Ok(())
    }

    /// Writes what is left of all rows of the run.
    fn finish(mut self, rows: &[Vec<f64>]) -> Result<Sheet, SheetError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        self.append(rows)?;
        self.sheet.sync()?;
        Ok(self.sheet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: usize) -> Vec<Vec<f64>> {
        (0..count).map(|row| vec![30.0, 0.0, 0.01 * row as f64, 0.0, 0.0, 7.0]).collect()
    }

    fn opened(folder: &std::path::Path) -> Sheet {
        let sheet = Sheet::open(folder, "walks", &flix_host::experiment::walks::COLUMNS).unwrap();
        sheet.of_robot("walker-3f2c").unwrap()
    }

    #[test]
    fn each_test_is_in_the_file_once_it_is_over_and_once_only() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = Kept::new(opened(folder.path()), comment("walker-3f2c"));
        let mut in_file = Vec::new();
        for done in [0, 1, 1, 2] {
            kept.keep(done, |_| rows(done)).unwrap();
            in_file.push(opened(folder.path()).rows().len());
        }
        assert_eq!(in_file, [0, 1, 1, 2]);
        kept.finish(&rows(3)).unwrap();
        assert_eq!(opened(folder.path()).rows(), rows(3));
    }

    #[test]
    fn what_cannot_be_written_ends_the_run_and_nothing_follows_half_a_row() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = Kept::new(opened(folder.path()), comment("walker-3f2c"));
        std::fs::create_dir(folder.path().join("walks.csv")).unwrap();
        assert!(kept.keep(1, |_| rows(1)).unwrap_err().contains("cannot write"));
        std::fs::remove_dir(folder.path().join("walks.csv")).unwrap();
        assert_eq!(kept.keep(2, |_| rows(2)), Ok(()));
        assert!(kept.finish(&rows(2)).is_err() && !folder.path().join("walks.csv").exists());
    }

    #[test]
    fn tests_of_another_robot_are_not_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        Kept::new(opened(folder.path()), comment("walker-2")).finish(&rows(1)).unwrap();
        let sheet = Sheet::open(folder.path(), "walks", &flix_host::experiment::walks::COLUMNS);
        assert!(matches!(
            sheet.unwrap().of_robot("walker-3f2c"),
            Err(SheetError::OtherRobot { .. })
        ));
    }

    #[test]
    fn a_pair_is_read_with_its_signs_or_refused_with_what_to_write() {
        assert_eq!("-35:30".parse(), Ok(Pair(Setpoint::saturating(-35.0, 30.0))));
        assert_eq!("-35Hz:30deg".parse(), Ok(Pair(Setpoint::saturating(-35.0, 30.0))));
        assert_eq!("20.5: -90".parse(), Ok(Pair(Setpoint::saturating(20.5, -90.0))));
        for (text, words) in [
            ("30", "F:THETA"),
            ("30:", "F:THETA"),
            ("a:b", "F:THETA"),
            ("36:0", "36"),
            ("30:91", "91"),
            ("nan:0", "nan:0"),
        ] {
            let sentence = text.parse::<Pair>().unwrap_err();
            assert!(sentence.contains(words), "{text}: {sentence}");
        }
    }
}
