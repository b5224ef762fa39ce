//! Figures of studies, drawn from their tables alone.

use std::path::Path;

use flix_host::nav::Twist;
use flix_host::plot::{Figure, HeatMap, HeatMaps, PlotError, Written};

use super::Table;
use super::modes::paper_modes;
use super::sweep::{Cell, cells};

/// Reads a speed off a motion.
type Speed = fn(Twist) -> f64;

/// The three speeds with their names and units.
const SPEEDS: [(&str, Speed); 3] = [
    ("longitudinal speed (m/s)", |motion| motion.forward),
    ("lateral speed, left + (m/s)", |motion| motion.lateral),
    ("turning speed, left + (rad/s)", |motion| motion.yaw),
];

/// Draws the figures of a table, as SVG and PNG, into a folder.
///
/// # Errors
/// When they cannot be drawn or written.
pub fn draw(table: &Table, folder: &Path) -> Result<Vec<Written>, PlotError> {
    let cells = cells(table);
    match table.study.as_str() {
        "mobility" => Ok(vec![mobility(table, &cells).write(folder, "mobility")?]),
        _ => Ok(Vec::new()),
    }
}

/// Sorted values of an axis.
fn axis(cells: &[Cell], of: fn(&Cell) -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = cells.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// A map over the pairs of `cells`: f to the right, theta upwards.
fn map(title: &str, cells: &[Cell], value: impl Fn(&Cell) -> f64) -> HeatMap {
    let (x, y) = (axis(cells, |c| c.f_hz), axis(cells, |c| c.theta_deg));
    let at = |f: f64, theta: f64| {
        cells.iter().find(|c| (c.f_hz, c.theta_deg) == (f, theta)).map_or(f64::NAN, &value)
    };
    let values = y.iter().map(|theta| x.iter().map(|f| at(*f, *theta)).collect()).collect();
    HeatMap::new(title, x, y, values).labels("f (Hz)", "\u{3b8} (\u{b0})")
}

/// Figure 3b: maps of the three speeds, the paper's modes marked with their numbers.
fn mobility(table: &Table, cells: &[Cell]) -> HeatMaps {
    let (x, y) = (axis(cells, |c| c.f_hz), axis(cells, |c| c.theta_deg));
    let figure = HeatMaps::new(format!("Mobility of model {}", name(table)), 3)
        .subtitle(format!("{}; rings: the modes of table III by number", conditions(table)));
    SPEEDS.iter().fold(figure, |figure, (title, of)| {
        let map = map(title, cells, |cell| of(cell.mean()));
        let marked = paper_modes().iter().enumerate().fold(map, |map, (number, mode)| {
            let column = x.iter().position(|f| *f == mode.f_hz);
            let row = y.iter().position(|theta| *theta == mode.theta_deg);
            match column.zip(row) {
                Some((column, row)) => map.mark(column, row, (number + 1).to_string()),
                None => map,
            }
        });
        figure.map(marked)
    })
}

/// Name of the model that a sweep is about.
fn name(table: &Table) -> &str {
    table.parameters["model"].as_str().unwrap_or("?")
}

/// How a sweep was walked, in words.
fn conditions(table: &Table) -> String {
    let of = |key: &str| &table.parameters[key];
    format!(
        "{} walks of {} s, {} drive, {} ms a step",
        of("seeds"),
        of("seconds"),
        of("drive").as_str().unwrap_or("?"),
        1e3 * of("step_s").as_f64().unwrap_or(f64::NAN)
    )
}
