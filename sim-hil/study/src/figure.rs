//! Figures of studies, drawn from their tables alone.

use std::path::Path;

use flix_host::nav::Twist;
use flix_plot::{
    Chart, Colour, Figure, HeatMap, HeatMaps, Panel, PlotError, Series, Stroke, Written, colour,
};
use flix_sim::reliability::commissioned_accuracy::Kept;

use super::actuation::CYCLES;
use super::front::{Gait, front, gaits};
use super::headroom::{Board, Boards, HEADROOM_V, Headroom, Judged};
use super::measured::Measured;
use super::modes::{Component, PaperMode, paper_modes};
use super::selection::{Candidate, robustness};
use super::sensitivity::index;
use super::sweep::{Cell, cells};
use flix_sim::study::Table;

/// One of the three mean speeds, as it is drawn.
struct Speed {
    title: &'static str,
    /// Place in [`Cell::spreads`].
    which: usize,
    /// Drawn number for 1 m/s or 1 rad/s.
    factor: f64,
    decimals: usize,
}

const SPEEDS: [Speed; 3] = [
    Speed { title: "longitudinal speed (mm/s)", which: 0, factor: 1e3, decimals: 0 },
    Speed { title: "lateral speed, left + (mm/s)", which: 1, factor: 1e3, decimals: 0 },
    Speed { title: "turning speed, left + (rad/s)", which: 2, factor: 1.0, decimals: 2 },
];

impl Speed {
    fn of(&self, cell: &Cell) -> f64 {
        self.factor * cell.spreads()[self.which].mean
    }
}
/// The same without units.
const KINDS: [(&str, Component); 3] = [
    ("longitudinal", Component::Forward),
    ("lateral", Component::Lateral),
    ("turning", Component::Yaw),
];

/// Draws the figures of a table, as SVG and PNG, into a folder.
///
/// # Errors
/// When they cannot be drawn or written.
pub fn draw(table: &Table, folder: &Path) -> Result<Vec<Written>, PlotError> {
    match table.study.as_str() {
        "mobility" => Ok(vec![
            mobility(table, &cells(table)).write(folder, "mobility")?,
            speed_and_cost(table).write(folder, "front")?,
        ]),
        "sensitivity-mass" | "sensitivity-friction" => {
            let cells = cells(table);
            Ok(vec![
                speeds(table, &cells).write(folder, "speeds")?,
                indices(table, &cells).write(folder, "index")?,
            ])
        }
        "actuation" => {
            Ok(vec![peaks(table).write(folder, "force")?, cycles(table).write(folder, "cycle")?])
        }
        _ => Ok(Vec::new()),
    }
}

/// Draws how many robots could hold everything, and do, over the charge of their batteries.
#[must_use]
pub fn over_charge(headroom: &Headroom) -> Chart {
    let Boards { sense, voltage } = &headroom.boards;
    // Of each tenth of charge that has robots, in percent at its middle.
    let share = |board: &Board, of: fn(&Judged) -> bool| -> Vec<(f64, f64)> {
        (0..10)
            .filter_map(|tenth| {
                let range = f64::from(tenth) / 10.0..f64::from(tenth + 1) / 10.0;
                let robots: Vec<_> =
                    board.each.iter().filter(|it| range.contains(&it.charge)).collect();
                let counted = robots.iter().filter(|it| of(it)).count();
                let middle = 50.0 * (range.start + range.end);
                (!robots.is_empty()).then(|| (middle, 100.0 * counted as f64 / robots.len() as f64))
            })
            .collect()
    };
    let held = |it: &Judged| it.kept == Kept::Held;
    let possible = share(sense, |it| it.bound.headroom_v > HEADROOM_V);
    let panel = Panel::new("robots (%)")
        .range(0.0, 100.0)
        .series(Series::line("possible", possible).colour(colour::MUTED).width(5.0))
        .series(
            Series::line("held, current sense", share(sense, held))
                .stroke(Stroke::Marked)
                .colour(colour::BLUE),
        )
        .series(
            Series::line("held, voltage mode", share(voltage, held))
                .stroke(Stroke::Marked)
                .colour(colour::ORANGE),
        );
    Chart::new("Robots that hold f and theta up to 35 Hz", "charge of the battery (%)")
        .subtitle(format!(
            "{} robots drawn about the assumed one; possible: an ideal drive has more than {HEADROOM_V} V left",
            headroom.robots
        ))
        .panel(panel)
}

/// Returns the sorted values of an axis, each once.
#[must_use]
pub fn axis(cells: &[Cell], of: fn(&Cell) -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = cells.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// A map over the pairs of `cells`: f to the right, theta upwards.
fn map(
    title: impl Into<String>,
    cells: &[Cell],
    value: impl Fn(f64, f64) -> Option<f64>,
) -> HeatMap {
    let (x, y) = (axis(cells, |c| c.f_hz), axis(cells, |c| c.theta_deg));
    let row = |theta: &f64| x.iter().map(|f| value(*f, *theta).unwrap_or(f64::NAN)).collect();
    let values = y.iter().map(row).collect();
    HeatMap::new(title, x, y, values).labels("f (Hz)", "theta (deg)")
}

/// A map of one of the three mean speeds of these cells.
fn speed_map(title: impl Into<String>, cells: &[Cell], speed: &Speed) -> HeatMap {
    let map = map(title, cells, |f, theta| {
        cells.iter().find(|c| (c.f_hz, c.theta_deg) == (f, theta)).map(|cell| speed.of(cell))
    });
    map.decimals(speed.decimals)
}

/// Marks a pair of a map of `cells`.
fn mark(map: HeatMap, cells: &[Cell], (f, theta): (f64, f64), label: String) -> HeatMap {
    let column = axis(cells, |c| c.f_hz).iter().position(|x| *x == f);
    let row = axis(cells, |c| c.theta_deg).iter().position(|y| *y == theta);
    match column.zip(row) {
        Some((column, row)) => map.mark(column, row, label),
        None => map,
    }
}

/// Figure 3b: maps of the three speeds, the paper's modes marked with their numbers.
fn mobility(table: &Table, cells: &[Cell]) -> HeatMaps {
    let modes = paper_modes();
    let walked = |mode: &PaperMode| {
        cells.iter().any(|cell| (cell.f_hz, cell.theta_deg) == (mode.f_hz, mode.theta_deg))
    };
    let frames =
        if modes.iter().any(walked) { "; frames: the modes of table III by number" } else { "" };
    let figure = HeatMaps::new(format!("Mobility of model {}", name(table)), 3)
        .subtitle(format!("{}{frames}", conditions(table)));
    SPEEDS.iter().fold(figure, |figure, speed| {
        let map = speed_map(speed.title, cells, speed);
        figure.map(modes.iter().enumerate().fold(map, |map, (number, mode)| {
            mark(map, cells, (mode.f_hz, mode.theta_deg), (number + 1).to_string())
        }))
    })
}

/// Speed against cost of transport: a dot for each pair, and the pairs that none beats in both.
fn speed_and_cost(table: &Table) -> Chart {
    let all = gaits(table);
    let points = |gaits: &[Gait]| -> Vec<(f64, f64)> {
        gaits.iter().map(|gait| (1e3 * gait.speed_m_s, gait.cost_of_transport)).collect()
    };
    let best = front(&all);
    let fastest = best.last().map_or(1.0, |gait| 1e3 * gait.speed_m_s);
    let dots = Series::line("all pairs", points(&all)).stroke(Stroke::Dots).width(4.0);
    let line =
        Series::line("the front", points(&best)).stroke(Stroke::Marked).colour(colour::ORANGE);
    Chart::new(
        format!("Speed and cost of transport of model {}", name(table)),
        "speed along the path (mm/s)",
    )
    .subtitle(conditions(table))
    .x_range(0.0, 1.05 * fastest)
    .panel(
        Panel::new("cost of transport (energy / weight / path)")
            .height(300.0)
            .logarithmic()
            .series(dots.colour(colour::BLUE))
            .series(line),
    )
    .width(640.0)
}

/// Draws measured speeds (dots) over simulated ones (lines) of the same pairs, as figure 3b: over theta, a colour for each f.
#[must_use]
pub fn overlay(robot: &str, rows: &[(Measured, Cell)]) -> Chart {
    let cells: Vec<Cell> = rows.iter().map(|(_, cell)| cell.clone()).collect();
    let frequencies = axis(&cells, |cell| cell.f_hz);
    // The faster, the darker, among those that turn the same way.
    let shade = |f: f64| {
        let alike: Vec<&f64> = frequencies.iter().filter(|other| **other * f > 0.0).collect();
        let slower = alike.iter().filter(|other| other.abs() <= f.abs()).count();
        0.25 + 0.75 * slower as f64 / alike.len().max(1) as f64
    };
    let ends = axis(&cells, |cell| cell.theta_deg);
    let (low, high) = (ends.first().copied().unwrap_or(0.0), ends.last().copied().unwrap_or(0.0));
    let chart =
        Chart::new(format!("Measured and simulated speeds of model {robot}"), "theta (deg)")
            .subtitle("dots: measured; lines: simulated, the mean over the seeds")
            .x_range(low - 4.0, high + 4.0);
    SPEEDS.iter().fold(chart, |chart, speed| {
        let panel = frequencies.iter().fold(Panel::new(speed.title).height(200.0), |panel, f| {
            let dark = if *f < 0.0 { colour::ORANGE } else { colour::BLUE };
            let tone = colour::GRID.towards(dark, shade(*f));
            let mut own: Vec<&(Measured, Cell)> =
                rows.iter().filter(|(_, cell)| cell.f_hz == *f).collect();
            own.sort_by(|a, b| a.1.theta_deg.total_cmp(&b.1.theta_deg));
            let simulated = own.iter().map(|(_, cell)| (cell.theta_deg, speed.of(cell)));
            let measured = own.iter().map(|(row, _)| {
                let Twist { forward, lateral, yaw } = row.motion;
                (row.theta_deg, speed.factor * [forward, lateral, yaw][speed.which])
            });
            panel
                .series(Series::line(format!("{f} Hz"), simulated).colour(tone).width(1.6))
                .series(Series::line("", measured).stroke(Stroke::Dots).colour(tone).width(4.0))
        });
        chart.panel(panel)
    })
}

/// Figures 5a and 5d: the three speeds of every changed robot, alike in their colours.
fn speeds(table: &Table, cells: &[Cell]) -> HeatMaps {
    let figure = HeatMaps::new(format!("Speeds of model {}, changed", name(table)), 3)
        .subtitle(conditions(table));
    let limit =
        |speed: &Speed| cells.iter().map(|c| speed.of(c).abs()).fold(f64::MIN_POSITIVE, f64::max);
    cells.chunk_by(|a, b| a.variant == b.variant).fold(figure, |figure, variant| {
        SPEEDS.iter().fold(figure, |figure, speed| {
            let title = format!("{}: {}", variant[0].variant, speed.title);
            let map = speed_map(title, variant, speed);
            figure.map(map.limits(-limit(speed), limit(speed)).cell(42.0, 22.0))
        })
    })
}

/// Figures 5b and 5e: the index I.
fn indices(table: &Table, cells: &[Cell]) -> HeatMaps {
    let figure = HeatMaps::new(format!("Performance index I of model {}", name(table)), 3)
        .subtitle(format!("{}; colours end at \u{b1}10", conditions(table)));
    KINDS.iter().fold(figure, |figure, (kind, component)| {
        let map = map(*kind, cells, |f, theta| index(cells, f, theta, *component, None));
        figure.map(map.limits(-10.0, 10.0).decimals(1))
    })
}

/// Draws figure 5f: P of the pairs that are fast enough, the chosen ones marked.
#[must_use]
pub fn selection(
    robot: &str,
    mass: &[Cell],
    friction: &[Cell],
    least: f64,
    chosen: &[(String, Candidate)],
) -> HeatMaps {
    let baseline: Vec<Cell> =
        mass.iter().filter(|cell| cell.variant == "baseline").cloned().collect();
    let figure = HeatMaps::new(format!("Robustness index P of model {robot}"), 3).subtitle(format!(
        "red positive, blue negative direction; grey: slower than {least} m/s; colours end at \u{b1}10"
    ));
    KINDS.iter().fold(figure, |figure, (kind, component)| {
        let map = map(*kind, &baseline, |f, theta| {
            let cell = baseline.iter().find(|c| (c.f_hz, c.theta_deg) == (f, theta))?;
            let fast = component.of(cell.mean()).abs() >= least;
            let found = robustness(mass, friction, (f, theta), *component)?;
            fast.then_some(found.index)
        });
        let own = chosen.iter().filter(|(_, candidate)| candidate.component == *component);
        figure.map(own.fold(map.limits(-10.0, 10.0).decimals(1), |map, (label, candidate)| {
            mark(map, &baseline, (candidate.cell.f_hz, candidate.cell.theta_deg), label.clone())
        }))
    })
}

/// Rows of an actuation table as f, theta, phase, force, its direction, torque, its direction.
fn moments(table: &Table) -> Vec<[f64; 7]> {
    let columns: Vec<Vec<f64>> = table.columns.iter().map(|c| table.numbers(&c.name)).collect();
    (0..table.rows.len()).map(|i| core::array::from_fn(|c| columns[c][i])).collect()
}

/// Figure 3d: the largest force and torque of a turn at each frequency.
fn peaks(table: &Table) -> Chart {
    let rows = moments(table);
    let ahead: Vec<[f64; 7]> = rows.into_iter().filter(|r| r[0] > 0.0 && r[1] == 0.0).collect();
    let panel = |which: usize, label: &str, colour: Colour| {
        let mut peaks: Vec<(f64, f64)> = ahead
            .chunk_by(|a, b| a[0] == b[0])
            .map(|turn| (turn[0][0], turn.iter().map(|r| r[which]).fold(0.0, f64::max)))
            .collect();
        peaks.sort_by(|a, b| a.0.total_cmp(&b.0));
        Panel::new(label)
            .height(220.0)
            .series(Series::line("", peaks).stroke(Stroke::Marked).colour(colour))
    };
    Chart::new("Largest shaking force and torque of a turn", "f (Hz)")
        .panel(panel(3, "force (N)", colour::BLUE))
        .panel(panel(5, "torque (N m)", colour::ORANGE))
        .width(640.0)
}

/// Figure 3e: direction of force and torque over one turn, their magnitude as colour.
fn cycles(table: &Table) -> Chart {
    let rows = moments(table);
    let chart = Chart::new("Shaking force and torque over one turn", "phase (\u{b0})").x_degrees().x_range(0.0, 360.0).subtitle(
        "height: direction, positive to the right; colour: magnitude, from pale (none) to dark (largest)",
    );
    CYCLES.iter().fold(chart, |chart, (f, theta)| {
        let turn: Vec<&[f64; 7]> = rows.iter().filter(|r| r[0] == *f && r[1] == *theta).collect();
        [(3, "force", colour::BLUE), (5, "torque", colour::ORANGE)].into_iter().fold(
            chart,
            |chart, (which, kind, dark)| {
                let label = format!("{kind} at {f} Hz, {theta}\u{b0} (\u{b0})");
                let panel = Panel::new(label).height(84.0).range(-185.0, 185.0).degrees();
                chart.panel(shaded(panel, &turn, which, dark))
            },
        )
    })
}

/// Shades of magnitude.
const SHADES: usize = 8;

/// Dots at the direction (column after the magnitude), darker where the magnitude is larger.
fn shaded(panel: Panel, turn: &[&[f64; 7]], which: usize, dark: Colour) -> Panel {
    let largest = turn.iter().map(|r| r[which]).fold(f64::MIN_POSITIVE, f64::max);
    let shade = |value: f64| ((value / largest * SHADES as f64) as usize).min(SHADES - 1);
    (0..SHADES).fold(panel, |panel, step| {
        let dots = turn.iter().filter(|r| shade(r[which]) == step).map(|r| (r[2], r[which + 1]));
        let tone = colour::GRID.towards(dark, (step + 1) as f64 / SHADES as f64);
        panel.series(Series::line("", dots).stroke(Stroke::Dots).colour(tone).width(2.4))
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
        "seeds: {}, {} s each, {} drive, {} ms a step",
        of("seeds"),
        of("seconds"),
        of("drive").as_str().unwrap_or("?"),
        1e3 * of("step_s").as_f64().unwrap_or(f64::NAN)
    )
}
