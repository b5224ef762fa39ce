//! Tables that a laboratory measured, as CSV.
//!
//! The first line names the columns with their units (`f_hz`, not `f`); order is free, lines that begin with `#`
//! are skipped. What does not fit is refused with its line and column, counted from 1.

use std::path::{Path, PathBuf};

use flix_host::nav::Twist;
use serde::Serialize;

use crate::rig::bench::setpoint;

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

/// Reads the named columns, all of which must be there and no others; at least `fewest` rows.
///
/// # Errors
/// [`MeasuredError`], naming line and column.
pub fn read<const N: usize>(
    path: &Path,
    names: [&str; N],
    fewest: usize,
) -> Result<Vec<[f64; N]>, MeasuredError> {
    let bytes = std::fs::read(path)
        .map_err(|source| MeasuredError::Read { path: path.to_owned(), source })?;
    parse(path, &bytes, names, fewest)
}

fn parse<const N: usize>(
    path: &Path,
    bytes: &[u8],
    names: [&str; N],
    fewest: usize,
) -> Result<Vec<[f64; N]>, MeasuredError> {
    let whole = |reason: String| MeasuredError::Whole { path: path.to_owned(), reason };
    let place =
        |line, column, reason| MeasuredError::Place { path: path.to_owned(), line, column, reason };
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
    let mut at = [None; N];
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
    if let Some(missing) = at.iter().position(Option::is_none) {
        let reason = format!("the column {} is missing; columns are {expected}", names[missing]);
        return Err(place(line, header.len() + 1, reason));
    }
    let mut rows = Vec::new();
    while let Some((line, record)) = next()? {
        if record.len() != header.len() {
            let reason = format!("{} values in a table of {} columns", record.len(), header.len());
            return Err(place(line, record.len().min(header.len()) + 1, reason));
        }
        let mut row = [0.0; N];
        for (index, value) in row.iter_mut().enumerate() {
            let column = at[index].unwrap_or_default();
            let text = &record[column];
            let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
            *value = number.ok_or_else(|| {
                let reason = format!("{text:?} is no finite number for {}", names[index]);
                place(line, column + 1, reason)
            })?;
        }
        rows.push(row);
    }
    if rows.len() < fewest {
        return Err(whole(format!("{} rows of numbers; at least {fewest} are needed", rows.len())));
    }
    Ok(rows)
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

/// Reads speeds of a prototype: `f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s`.
///
/// # Errors
/// As [`read`], and when a pair is one that the robot does not take.
pub fn speeds(path: &Path) -> Result<Vec<Measured>, MeasuredError> {
    let names = ["f_hz", "theta_deg", "forward_m_s", "lateral_m_s", "yaw_rad_s"];
    let rows = read(path, names, 3)?;
    for (index, [f, theta, ..]) in rows.iter().enumerate() {
        if let Err(error) = setpoint(*f, *theta) {
            let reason = format!("row {} of numbers: {error}", index + 1);
            return Err(MeasuredError::Whole { path: path.to_owned(), reason });
        }
    }
    Ok(rows
        .into_iter()
        .map(|[f_hz, theta_deg, forward, lateral, yaw]| Measured {
            f_hz,
            theta_deg,
            motion: Twist { forward, lateral, yaw },
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        parse(Path::new("lab.csv"), text.as_bytes(), ["t_s", "x_mm"], 2).unwrap_err().to_string()
    }

    #[test]
    fn columns_come_in_any_order_and_comments_are_skipped() {
        let text = "# lab 3\nx_mm, t_s\n1.5,0\n-2e-1,0.1\n";
        let rows = parse(Path::new("lab.csv"), text.as_bytes(), ["t_s", "x_mm"], 2).unwrap();
        assert_eq!(rows, [[0.0, 1.5], [0.1, -0.2]]);
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
    }

    #[test]
    fn bytes_that_are_no_text_are_refused_with_their_line() {
        let refused = parse(Path::new("lab.csv"), b"t_s,x_mm\n0,\xff\n", ["t_s", "x_mm"], 1);
        assert!(refused.unwrap_err().to_string().contains("line 2"));
    }
}
