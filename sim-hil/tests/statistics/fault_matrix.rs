//! Whatever goes wrong, in every mode and at every time: the rotors come to rest within 0.6 s of the moment at which
//! the robot could know, or f and theta are held within their limits.
//!
//! What the robot of seed 1 does is kept in `fault_matrix.csv`. When that changes on purpose, write the file anew and
//! read its difference:
//!
//! ```text
//! FLIX_REGENERATE_FAULTS=1 cargo test -p flix-sim --test statistics
//! git diff sim-hil/tests/fault_matrix.csv
//! ```
//!
//! Another machine's sines differ in their last digit, so figures are compared within [`TOLERANCES`], and a fault that
//! shows in several ways may be named by any of those that the file has for it.

use std::collections::BTreeSet;

use flix_sim::reliability::fault_matrix::matrix;
use flix_sim::study::{Row, Table, Value, compute};

const HEADER: &str = "fault,base,f_hz,theta_deg,onset,outcome,state,first_fault,safe_s,largest_current_a,phase_error_deg";
/// Leading columns that say which cell it is, what the robot did and where it ended.
const EXACT: usize = 7;
/// Of the last three columns.
const TOLERANCES: [f64; 3] = [0.05, 0.3, 15.0];

fn line(table: &Table, row: &Row) -> String {
    let value = |name: &str| &row[table.index(name).expect("a column of the matrix")];
    let decimals = |name: &str| match name {
        "safe_s" => 2,
        "largest_current_a" => 1,
        _ => 0,
    };
    let text = |name: &str| match value(name) {
        Value::Number(number) if number.is_nan() => String::new(),
        Value::Number(number) => format!("{number:.*}", decimals(name)),
        other => other.as_text().unwrap_or_default().to_owned(),
    };
    HEADER.split(',').map(text).collect::<Vec<_>>().join(",")
}

fn is_near(now: &str, kept: &str, tolerance: f64) -> bool {
    match (now.parse::<f64>(), kept.parse::<f64>()) {
        (Ok(now), Ok(kept)) => (now - kept).abs() <= tolerance,
        _ => now == kept,
    }
}

fn agree(now: &str, kept: &str, names: &BTreeSet<(&str, &str)>) -> bool {
    let (now, kept): (Vec<_>, Vec<_>) = (now.split(',').collect(), kept.split(',').collect());
    now.len() == kept.len()
        && now[..EXACT] == kept[..EXACT]
        && names.contains(&(now[0], now[EXACT]))
        && now[EXACT + 1..]
            .iter()
            .zip(&kept[EXACT + 1..])
            .zip(TOLERANCES)
            .all(|((now, kept), tolerance)| is_near(now, kept, tolerance))
}

#[test]
fn every_fault_in_every_mode_at_every_time_ends_at_rest_or_within_the_figures() {
    let table = compute(&matrix(1, |_| true));
    assert!(table.pass(), "{:#?}", table.rows.values().filter(|row| !table.keeps(row)));

    let lines: Vec<String> = table.rows.values().map(|row| line(&table, row)).collect();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fault_matrix.csv");
    if std::env::var_os("FLIX_REGENERATE_FAULTS").is_some() {
        let text = [HEADER.to_owned()].into_iter().chain(lines.iter().cloned());
        let text = text.collect::<Vec<_>>().join("\n") + "\n";
        std::fs::write(path, text).expect("the repository can be written to");
    }
    let kept = std::fs::read_to_string(path).expect("the file is part of the repository");
    let kept: Vec<&str> = kept.lines().skip(1).collect();
    assert_eq!(kept.len(), lines.len(), "rows were added or taken away: see the head of this file");
    let names: BTreeSet<(&str, &str)> = kept
        .iter()
        .filter_map(|line| Some((line.split(',').next()?, line.split(',').nth(EXACT)?)))
        .collect();
    let changed: Vec<_> =
        lines.iter().zip(&kept).filter(|(now, kept)| !agree(now, kept, &names)).collect();
    assert!(changed.is_empty(), "changed: see the head of this file\n{changed:#?}");
}
