//! Tables that a laboratory measured, as CSV.
//!
//! The first line names the columns with their units (`f_hz`, not `f`); order is free, lines that begin with `#`
//! are skipped. What does not fit is refused with its line and column, counted from 1.

use std::path::{Path, PathBuf};

use flix_host::nav::Twist;
use flix_host::system::file::{self, LARGEST_TEXT};
use serde::Serialize;

use flix_sim::model::LEGS;

/// Why a table was refused.
#[derive(Debug, thiserror::Error)]
pub enum MeasuredError {
    /// Not readable.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A place in the file is wrong.
    #[error("{}, line {line}, column {column}: {reason}", path.display())]
    Place {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: u64,
        /// From 1.
        column: usize,
        /// What is wrong there, and what would be right.
        reason: String,
    },
    /// The file as a whole is wrong.
    #[error("{}: {reason}", path.display())]
    Whole {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what would be right.
        reason: String,
    },
}

/// A column of a table: its name, which ends in its unit, and the range of values that make sense in that unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Name, as in the first line of the file.
    pub name: &'static str,
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
}

impl Column {
    /// Creates a column with its range.
    #[must_use]
    pub const fn new(name: &'static str, low: f64, high: f64) -> Self {
        Self { name, low, high }
    }

    /// The column `leg`, whose values are names: each reads as its index in [`LEGS`].
    pub const LEG: Self = Self::new("leg", 0.0, 3.0);

    /// Writes a value as it is read, to six digits.
    #[must_use]
    pub fn show(&self, value: f64) -> String {
        if self.name == Self::LEG.name {
            return LEGS.get(value as usize).copied().unwrap_or_default().to_owned();
        }
        let digits = 5 - value.abs().max(1e-12).log10().floor() as i32;
        format!("{value:.*}", digits.clamp(0, 8) as usize)
    }

    fn parse(&self, text: &str) -> Result<f64, String> {
        if self.name == Self::LEG.name {
            let leg = LEGS.iter().position(|leg| *leg == text);
            let index = leg.map(|index| index as f64);
            return index.ok_or_else(|| format!("{text:?} is no leg: one of {}", LEGS.join(", ")));
        }
        let Some(number) = text.parse::<f64>().ok().filter(|number| number.is_finite()) else {
            return Err(format!("{text:?} is no finite number for {}", self.name));
        };
        if (self.low..=self.high).contains(&number) {
            return Ok(number);
        }
        Err(format!(
            "{text} is outside {} .. {}: give it in the unit that the name {} ends in",
            self.low, self.high, self.name
        ))
    }
}

/// A table that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Lines {
    /// Whether the file has each of the columns asked for.
    pub given: Vec<bool>,
    /// Each row of numbers with its line in the file: a value for each column asked for, 0 where the file has none.
    pub rows: Vec<(u64, Vec<f64>)>,
}

/// Reads the named columns, all of which must be there and no others; at least `fewest` rows.
///
/// # Errors
/// [`MeasuredError`], naming line and column.
pub fn read<const N: usize>(
    path: &Path,
    names: [&'static str; N],
    fewest: usize,
) -> Result<Vec<[f64; N]>, MeasuredError> {
    let any = names.map(|name| Column::new(name, f64::NEG_INFINITY, f64::INFINITY));
    let rows = read_columns(path, &any, N, fewest)?.rows.into_iter();
    Ok(rows.map(|(_, row)| core::array::from_fn(|i| row[i])).collect())
}

/// Reads columns with their ranges. The first `required` must be there, the others may be; no further ones.
///
/// # Errors
/// [`MeasuredError`], naming line and column.
pub fn read_columns(
    path: &Path,
    columns: &[Column],
    required: usize,
    fewest: usize,
) -> Result<Lines, MeasuredError> {
    let bytes = file::read(path, LARGEST_TEXT)
        .map_err(|source| MeasuredError::Read { path: path.to_owned(), source })?;
    parse(path, &bytes, columns, required, fewest)
}

fn parse(
    path: &Path,
    bytes: &[u8],
    columns: &[Column],
    required: usize,
    fewest: usize,
) -> Result<Lines, MeasuredError> {
    let whole = |reason: String| MeasuredError::Whole { path: path.to_owned(), reason };
    let place =
        |line, column, reason| MeasuredError::Place { path: path.to_owned(), line, column, reason };
    let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
    let expected = names.join(",");
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(bytes);
    let mut records = reader.records();
    let mut next = || -> Result<Option<(u64, csv::StringRecord)>, MeasuredError> {
        let Some(record) = records.next() else { return Ok(None) };
        let record = record.map_err(|error| {
            let line = error.position().map_or(0, csv::Position::line);
            place(line, 1, "this is no text in UTF-8".to_owned())
        })?;
        let line = record.position().map_or(0, csv::Position::line);
        Ok(Some((line, record)))
    };
    let Some((line, header)) = next()? else {
        return Err(whole(format!("the file is empty; its first line has to be {expected}")));
    };
    let mut at = vec![None; columns.len()];
    for (column, name) in header.iter().enumerate() {
        let Some(index) = names.iter().position(|expected| *expected == name) else {
            let reason =
                format!("unknown column {name:?}; columns, with their units, are {expected}");
            return Err(place(line, column + 1, reason));
        };
        if at[index].replace(column).is_some() {
            return Err(place(line, column + 1, format!("the column {name} comes twice")));
        }
    }
    if let Some(missing) = at[..required].iter().position(Option::is_none) {
        let reason = format!("the column {} is missing; columns are {expected}", names[missing]);
        return Err(place(line, header.len() + 1, reason));
    }
    let mut rows = Vec::new();
    while let Some((line, record)) = next()? {
        if record.len() != header.len() {
            let reason = format!("{} values in a table of {} columns", record.len(), header.len());
            return Err(place(line, record.len().min(header.len()) + 1, reason));
        }
        let mut row = vec![0.0; columns.len()];
        for (index, column) in at.iter().enumerate() {
            if let Some(column) = column {
                row[index] = columns[index]
                    .parse(&record[*column])
                    .map_err(|reason| place(line, column + 1, reason))?;
            }
        }
        rows.push((line, row));
    }
    if rows.len() < fewest {
        return Err(whole(format!("{} rows of numbers; at least {fewest} are needed", rows.len())));
    }
    Ok(Lines { given: at.iter().map(Option::is_some).collect(), rows })
}

/// Mean speeds of the prototype under one pair.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// Hz.
    pub f_hz: f64,
    /// Degrees, to the right.
    pub theta_deg: f64,
    /// Body frame, left positive.
    #[serde(serialize_with = "motion")]
    pub motion: Twist,
}

fn motion<S: serde::Serializer>(motion: &Twist, serializer: S) -> Result<S::Ok, S::Error> {
    [motion.forward, motion.lateral, motion.yaw].serialize(serializer)
}

/// A walk: a pair that the robot takes, and the mean speeds that it can have.
pub const SPEEDS: [Column; 5] = [
    Column::new("f_hz", -35.0, 35.0),
    Column::new("theta_deg", -90.0, 90.0),
    Column::new("forward_m_s", -1.0, 1.0),
    Column::new("lateral_m_s", -1.0, 1.0),
    Column::new("yaw_rad_s", -10.0, 10.0),
];

/// Reads [`SPEEDS`] of a prototype, and `seconds`, the time of each walk, which may be missing and counts for nothing.
///
/// # Errors
/// As [`read`], and when a value is outside its column's range.
pub fn speeds(path: &Path) -> Result<Vec<Measured>, MeasuredError> {
    let [f, theta, forward, lateral, yaw] = SPEEDS;
    let seconds = Column::new("seconds", 0.0, f64::INFINITY);
    let columns = [f, theta, forward, lateral, yaw, seconds];
    let rows = read_columns(path, &columns, SPEEDS.len(), 3)?.rows.into_iter();
    Ok(rows
        .map(|(_, row)| Measured {
            f_hz: row[0],
            theta_deg: row[1],
            motion: Twist { forward: row[2], lateral: row[3], yaw: row[4] },
        })
        .collect())
}

/// Reads points of the unit cube: rows of `coordinates` numbers from 0 to 1, without a header.
///
/// # Errors
/// [`MeasuredError`], naming line and column.
pub fn points(path: &Path, coordinates: usize) -> Result<Vec<Vec<f64>>, MeasuredError> {
    let text = file::read_text(path)
        .map_err(|source| MeasuredError::Read { path: path.to_owned(), source })?;
    let mut points = Vec::new();
    for (line, row) in (1..).zip(text.lines()).filter(|(_, row)| !row.trim().is_empty()) {
        let cells: Vec<&str> = row.split(',').map(str::trim).collect();
        let place =
            |column, reason| MeasuredError::Place { path: path.to_owned(), line, column, reason };
        if cells.len() != coordinates {
            let reason = format!("{} numbers; a point has {coordinates}", cells.len());
            return Err(place(cells.len().min(coordinates) + 1, reason));
        }
        let mut point = Vec::new();
        for (column, cell) in (1..).zip(cells) {
            let number = cell.parse().ok().filter(|number| (0.0..=1.0).contains(number));
            let reason = || format!("{cell:?} is no number from 0 to 1");
            point.push(number.ok_or_else(|| place(column, reason()))?);
        }
        points.push(point);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 3] =
        [Column::new("t_s", 0.0, 10.0), Column::new("x_mm", -50.0, 50.0), Column::LEG];

    fn parsed(text: &[u8], required: usize) -> Result<Lines, MeasuredError> {
        parse(Path::new("lab.csv"), text, &COLUMNS[..required.max(2)], required, 2)
    }

    #[test]
    fn points_are_rows_of_shares_or_refused_with_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            points(&path, 2).map_err(|error| error.to_string())
        };
        assert_eq!(read("0, 0.5\n\n1,0.25\n").unwrap(), [[0.0, 0.5], [1.0, 0.25]]);
        assert_eq!(read("").unwrap(), Vec::<Vec<f64>>::new());
        for (text, words) in [
            ("0,1.1\n", "line 1, column 2: \"1.1\" is no number from 0 to 1"),
            ("0,1\n0,nan\n", "line 2, column 2"),
            ("0\n", "line 1, column 2: 1 numbers; a point has 2"),
            ("0,1,0\n", "line 1, column 3: 3 numbers"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn speeds_in_another_unit_are_refused_with_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("speeds.csv");
        let read = |row: &str| {
            let rows = "-30,90,0.05,0,0.5\n30,90,0.05,0,-0.5\n";
            let text = format!("f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s\n{rows}{row}\n");
            std::fs::write(&path, text).unwrap();
            speeds(&path).map_err(|error| error.to_string())
        };
        assert_eq!(read("-30,30,0.1,0,0").unwrap()[2].motion.forward, 0.1);
        for (row, place) in [
            ("-30,30,109,0,0", "line 4, column 3: 109 is outside -1 .. 1"),
            ("-30,30,0.1,0,45", "line 4, column 5"),
            ("60,30,0.1,0,0", "line 4, column 1"),
            ("-30,91,0.1,0,0", "line 4, column 2"),
        ] {
            let error = read(row).unwrap_err();
            assert!(error.contains(place), "{row}: {error}");
        }
    }

    fn refused(text: &str) -> String {
        parsed(text.as_bytes(), 2).unwrap_err().to_string()
    }

    #[test]
    fn columns_come_in_any_order_and_comments_are_skipped() {
        let lines = parsed(b"# lab 3\nx_mm, t_s\n1.5,0\n-2e-1,0.1\n", 2).unwrap();
        assert_eq!(lines.rows, [(3, vec![0.0, 1.5]), (4, vec![0.1, -0.2])]);
    }

    #[test]
    fn legs_are_named_and_optional_columns_may_be_missing() {
        let lines = parsed(b"t_s,leg,x_mm\n1,rl,2\n1,rr,2\n", 3).unwrap();
        assert_eq!(lines.rows[0].1, [1.0, 2.0, 2.0]);
        let lines = parse(Path::new("lab.csv"), b"t_s\n1\n", &COLUMNS, 1, 1).unwrap();
        assert_eq!(lines.given, [true, false, false]);
        let refused = parsed(b"t_s,leg,x_mm\n1,front,2\n", 3).unwrap_err().to_string();
        assert!(refused.contains("line 2, column 2: \"front\" is no leg"), "{refused}");
    }

    #[test]
    fn what_is_wrong_is_named_with_line_and_column() {
        assert!(refused("").contains("the file is empty"));
        assert!(refused("t_s,x\n").contains("line 1, column 2: unknown column \"x\""));
        assert!(refused("t_s\n0\n").contains("line 1, column 2: the column x_mm is missing"));
        assert!(refused("t_s,x_mm,t_s\n").contains("line 1, column 3: the column t_s comes twice"));
        assert!(refused("t_s,x_mm\n0,1\n0,five\n").contains("line 3, column 2: \"five\""));
        assert!(refused("t_s,x_mm\nNaN,1\n").contains("line 2, column 1: \"NaN\""));
        assert!(refused("t_s,x_mm\n0,\n").contains("line 2, column 2: \"\""));
        assert!(refused("t_s,x_mm\n0,1,2\n").contains("line 2, column 3: 3 values"));
        assert!(refused("t_s,x_mm\n0,1\n").contains("1 rows of numbers"));
        assert!(refused("t_s,x_mm\n0,1\n0,1e3\n").contains("line 3, column 2: 1e3 is outside"));
    }

    #[test]
    fn bytes_that_are_no_text_are_refused_with_their_line() {
        let refused = parsed(b"t_s,x_mm\n0,\xff\n", 2);
        assert!(refused.unwrap_err().to_string().contains("line 2"));
    }
}
