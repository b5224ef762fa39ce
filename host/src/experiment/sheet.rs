//! The file of an experiment: CSV that names its columns and grows by whole tests. A comment above them, `# robot NAME, ...`,
//! names the robot that they are of.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::system::file;

/// A column of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Name, which ends in its unit.
    pub name: &'static str,
    /// Digits after the point.
    pub digits: usize,
}

impl Column {
    /// Creates a column.
    #[must_use]
    pub const fn new(name: &'static str, digits: usize) -> Self {
        Self { name, digits }
    }
}

/// Why a file cannot take rows.
#[derive(Debug, thiserror::Error)]
pub enum SheetError {
    /// Its folder is none.
    #[error("{} is not a folder: name the folder of the experiments", .0.display())]
    NotAFolder(PathBuf),
    /// It cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It is a file of something else.
    #[error(
        "{} has the columns {found}, and this experiment has {expected}: name another folder, or move the file away",
        path.display()
    )]
    OtherColumns {
        /// The file.
        path: PathBuf,
        /// The columns that it has.
        found: String,
        /// The columns that are written.
        expected: String,
    },
    /// It is of another robot.
    #[error(
        "{} holds tests of the robot {found}, and this is {robot}: name another file, or change the name in its comments if \
         both are one robot",
        path.display()
    )]
    OtherRobot {
        /// The file.
        path: PathBuf,
        /// The robot in its comments.
        found: String,
        /// The robot that tests would be written of.
        robot: String,
    },
    /// A line of it is no row.
    #[error("{}, line {line}: this is no whole row of {expected}: remove it", path.display())]
    NotARow {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The columns of a row.
        expected: String,
    },
}

/// A file that rows are appended to; see the module's documentation.
#[derive(Debug)]
pub struct Sheet {
    path: PathBuf,
    columns: &'static [Column],
    has_header: bool,
    rows: Vec<Vec<f64>>,
    /// The robots in its comments.
    robots: Vec<String>,
    /// The comment above the last rows that were appended.
    comment: String,
}

impl Sheet {
    /// Checks that `NAME.csv` in this folder is missing or has these columns, and can be written. Changes nothing but
    /// that it makes the folder.
    ///
    /// # Errors
    /// When it has other columns, holds what is no row, or cannot be read or written.
    pub fn open(folder: &Path, name: &str, columns: &'static [Column]) -> Result<Self, SheetError> {
        if folder.exists() && !folder.is_dir() {
            return Err(SheetError::NotAFolder(folder.to_owned()));
        }
        let path = folder.join(format!("{name}.csv"));
        file::check_writable(&path)
            .map_err(|source| SheetError::Write { path: path.clone(), source })?;
        let text = match path.exists() {
            false => String::new(),
            true => file::read_text(&path)
                .map_err(|source| SheetError::Read { path: path.clone(), source })?,
        };
        let mut sheet = Self {
            path,
            columns,
            has_header: false,
            rows: Vec::new(),
            robots: Vec::new(),
            comment: String::new(),
        };
        // Spreadsheets begin a file with the mark.
        sheet.read(text.trim_start_matches('\u{feff}'))?;
        Ok(sheet)
    }

    /// Returns the file, if no test in it is of another robot.
    ///
    /// # Errors
    /// When a comment in it names another robot.
    pub fn of_robot(self, robot: &str) -> Result<Self, SheetError> {
        match self.robots.iter().find(|found| *found != robot) {
            Some(found) => Err(SheetError::OtherRobot {
                path: self.path.clone(),
                found: found.clone(),
                robot: robot.to_owned(),
            }),
            None => Ok(self),
        }
    }

    fn read(&mut self, text: &str) -> Result<(), SheetError> {
        let (path, expected) = (self.path.clone(), self.header());
        for (index, line) in text.split_inclusive('\n').enumerate() {
            if line.starts_with('#') || line.trim().is_empty() {
                let named = line.strip_prefix("# robot ").and_then(|rest| rest.split_once(", "));
                self.robots.extend(named.map(|(robot, _)| robot.to_owned()));
                continue;
            }
            if !self.has_header {
                let names: Vec<&str> = line.trim().split(',').map(str::trim).collect();
                if names.join(",") != expected {
                    let found = line.trim().to_owned();
                    return Err(SheetError::OtherColumns { path, found, expected });
                }
                self.has_header = true;
                continue;
            }
            let number = |cell: &str| cell.trim().parse().ok().filter(|it: &f64| it.is_finite());
            let numbers: Option<Vec<f64>> = line.split(',').map(number).collect();
            match numbers {
                Some(row) if row.len() == self.columns.len() && line.ends_with('\n') => {
                    self.rows.push(row);
                }
                _ => return Err(SheetError::NotARow { path, line: index + 1, expected }),
            }
        }
        Ok(())
    }

    fn header(&self) -> String {
        self.columns.iter().map(|column| column.name).collect::<Vec<_>>().join(",")
    }

    /// Returns the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns its rows, those of earlier runs among them.
    #[must_use]
    pub fn rows(&self) -> &[Vec<f64>] {
        &self.rows
    }

    /// Returns the largest number in its first column; 0 without rows.
    #[must_use]
    pub fn last(&self) -> f64 {
        self.rows.iter().fold(0.0, |last, row| last.max(row[0]))
    }

    /// Appends rows under a comment, which is written once if it stays the same. Without rows the file stays as it is.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn append(&mut self, comment: &str, rows: &[Vec<f64>]) -> Result<(), SheetError> {
        if rows.is_empty() {
            return Ok(());
        }
        // A comment is one line, whatever is in it.
        let comment: String =
            comment.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let mut text = String::new();
        if comment != self.comment {
            text += &format!("# {comment}\n");
        }
        if !self.has_header {
            text += &(self.header() + "\n");
        }
        for row in rows {
            let cell = |(value, column): (&f64, &Column)| {
                // No negative zero.
                let scale = 10f64.powi(column.digits as i32);
                format!("{:.*}", column.digits, (value * scale).round() / scale + 0.0)
            };
            let cells: Vec<String> = row.iter().zip(self.columns).map(cell).collect();
            text += &(cells.join(",") + "\n");
        }
        let write = || -> io::Result<()> {
            let mut file = File::options().append(true).create(true).open(&self.path)?;
            file.write_all(text.as_bytes())
        };
        write().map_err(|source| SheetError::Write { path: self.path.clone(), source })?;
        (self.has_header, self.comment) = (true, comment);
        self.rows.extend_from_slice(rows);
        Ok(())
    }

    /// Waits until the disk has what was appended.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn sync(&self) -> Result<(), SheetError> {
        let synced = match File::options().append(true).open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            file => file.and_then(|file| file.sync_all()),
        };
        synced.map_err(|source| SheetError::Write { path: self.path.clone(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 2] = [Column::new("test", 0), Column::new("z_mm", 2)];

    fn opened(text: &str) -> Result<Sheet, SheetError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("lab.csv"), text).unwrap();
        Sheet::open(folder.path(), "lab", &COLUMNS)
    }

    #[test]
    fn a_file_grows_under_one_header_and_its_tests_are_numbered_on() {
        let folder = tempfile::tempdir().unwrap();
        let lab = folder.path().join("new");
        for (comment, number) in [("one\nline", 1.0), ("two", 2.0)] {
            let mut sheet = Sheet::open(&lab, "lab", &COLUMNS).unwrap();
            assert_eq!(sheet.last(), number - 1.0);
            sheet.append(comment, &[vec![number, -0.001], vec![number, 1.235]]).unwrap();
        }
        let text = std::fs::read_to_string(lab.join("lab.csv")).unwrap();
        let expected = "# one line\ntest,z_mm\n1,0.00\n1,1.24\n# two\n2,0.00\n2,1.24\n";
        assert_eq!(text.replace("1.23\n", "1.24\n"), expected);
    }

    #[test]
    fn rows_of_one_run_stand_under_one_comment() {
        let folder = tempfile::tempdir().unwrap();
        let mut sheet = Sheet::open(folder.path(), "lab", &COLUMNS).unwrap();
        for number in [1.0, 2.0] {
            sheet.append("one run", &[vec![number, 0.0]]).unwrap();
        }
        sheet.sync().unwrap();
        let text = std::fs::read_to_string(sheet.path()).unwrap();
        assert_eq!(text, "# one run\ntest,z_mm\n1,0.00\n2,0.00\n");
    }

    #[test]
    fn a_file_of_another_robot_is_refused_and_one_that_names_none_is_not() {
        let of =
            |text: &str| opened(text).unwrap().of_robot("walker-3f2c").map(|sheet| sheet.last());
        let rows = "test,z_mm\n3,1\n";
        assert_eq!(of(&format!("# robot walker-3f2c, today: flix\n{rows}")).unwrap(), 3.0);
        assert_eq!(of(&format!("# a robot\n{rows}")).unwrap(), 3.0);
        let refused = of(&format!("{rows}# robot walker-2, today: flix\n4,1\n")).unwrap_err();
        assert!(refused.to_string().contains("of the robot walker-2, and this is walker-3f2c"));
    }

    #[test]
    fn a_name_with_a_dot_keeps_what_comes_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let sheet = Sheet::open(folder.path(), "walker.2", &COLUMNS).unwrap();
        assert_eq!(sheet.path(), folder.path().join("walker.2.csv"));
    }

    #[test]
    fn without_rows_there_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut sheet = Sheet::open(folder.path(), "lab", &COLUMNS).unwrap();
        sheet.append("nothing", &[]).unwrap();
        assert!(!folder.path().join("lab.csv").exists());
    }

    #[test]
    fn a_file_of_another_format_is_refused_and_says_where() {
        assert_eq!(opened("# lab\n test, z_mm\n3,1\n").unwrap().last(), 3.0);
        assert_eq!(opened("\u{feff}test,z_mm\r\n3,1\r\n").unwrap().last(), 3.0);
        for (text, words) in [
            ("z_mm,test\n", "has the columns z_mm,test, and this experiment has test,z_mm"),
            ("anything\n", "anything"),
            ("test,z_mm\n1,2\n1,2,3\n", "line 3"),
            ("test,z_mm\n1,2\n1,", "line 3"),
            ("test,z_mm\n1,2\n1,2", "line 3: this is no whole row"),
            ("test,z_mm\none,2\n", "line 2"),
            ("test,z_mm\n1,NaN\n", "line 2"),
            ("test,z_mm\n1,2\n1,inf\n", "line 3"),
        ] {
            let sentence = opened(text).unwrap_err().to_string();
            assert!(sentence.contains(words), "{text:?}: {sentence}");
        }
    }
}
