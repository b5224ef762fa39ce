//! Figures of a run.

use flix_host::link::line_difference;
use flix_host::nav::{JOINED_WITHIN, PlanarPose, Position, wrap};
use flix_host::record::{CommandRow, Run, TelemetryRow};

use crate::{Chart, Outline, Panel, Series, Stroke, Track, colour};

/// Length and width of the robot's plate, m (paper, Table II).
const PLATE: [f64; 2] = [0.22, 0.12];
/// Farther than this between two poses nothing walks, m: 5 m/s at 100 poses a second.
const JUMP: f64 = 0.05;
/// Number of robots drawn along a track.
const SNAPSHOTS: usize = 12;

/// Returns whether there is a track to draw: trusted poses, or a path.
#[must_use]
pub fn has_track(run: &Run) -> bool {
    run.path.is_some() || run.poses.iter().any(|pose| pose.valid)
}

/// Returns whether anything of a run changes over time.
#[must_use]
pub fn has_timeline(run: &Run) -> bool {
    !(run.navigation.is_empty() && run.commands.is_empty() && run.telemetry.is_empty())
}

/// Draws the track on the floor: the path, the way of the robot, and its pose at some moments.
#[must_use]
pub fn track(run: &Run) -> Track {
    let trusted: Vec<_> =
        run.poses.iter().filter(|p| p.valid).map(|p| p.pose.on_the_floor()).collect();
    let mut figure = Track::new(title(run, "seen from above"), "m").subtitle(subtitle(run));
    for index in snapshots(trusted.len()) {
        figure = figure.outline(plate(&trusted[index]));
    }
    if let Some(path) = &run.path {
        let points = path.poses.iter().map(|p| p.on_the_floor().position());
        figure =
            figure.series(Series::line("path", points).stroke(Stroke::Dashed).colour(colour::GREY));
    }
    let walked = broken_at_jumps(trusted.iter().map(PlanarPose::position));
    figure = figure.series(Series::line("robot", walked).colour(colour::BLUE));
    if let (Some(first), Some(last)) = (trusted.first(), trusted.last()) {
        // Named in the legend: text beside them would cover them on a closed path. The smaller end stays visible on
        // the start.
        let dot =
            |name, pose: &PlanarPose| Series::line(name, [pose.position()]).stroke(Stroke::Dots);
        figure = figure.series(dot("start", first).colour(colour::GREEN).width(4.4));
        figure = figure.series(dot("end", last).colour(colour::RED).width(2.6));
    }
    figure
}

/// Draws the plate of a robot, with a nose that shows the heading.
fn plate(pose: &PlanarPose) -> Outline {
    let [l, w] = PLATE.map(|side| side / 2.0);
    let corners = [(-l, w), (l * 0.7, w), (l, 0.0), (l * 0.7, -w), (-l, -w)];
    let corners = corners.map(|(x, y)| pose.place(Position::new(x, y))).to_vec();
    Outline { corners, colour: colour::SKY, filling: 0.10 }
}

fn snapshots(count: usize) -> Vec<usize> {
    let last = count.saturating_sub(1);
    (0..SNAPSHOTS.min(count))
        .map(|i| i * last / SNAPSHOTS.min(count).max(2).saturating_sub(1))
        .collect()
}

/// Draws everything over time: error, heading, f, theta, currents, battery.
#[must_use]
pub fn timeline(run: &Run) -> Chart {
    let mut chart = Chart::new(title(run, "over time"), "Time (s)").subtitle(subtitle(run));
    if !run.navigation.is_empty() {
        let error = run.navigation.iter().map(|n| (run.time(&n.timestamp), n.error_m * 1e3));
        // A run without a path has no such error.
        let followed = run.navigation.iter().filter(|n| n.error_rms_m > 0.0);
        let rms = followed.map(|n| (run.time(&n.timestamp), n.error_rms_m * 1e3));
        let heading = run
            .navigation
            .iter()
            .map(|n| (run.time(&n.timestamp), wrap(n.heading_rad).to_degrees()));
        let label = match approach(run) {
            Some(_) => "Error (mm); shaded: approach, not counted",
            None => "Error (mm)",
        };
        let mut errors = Panel::new(label)
            .series(Series::line("now", error).width(1.2))
            .series(Series::line("RMS so far", rms).stroke(Stroke::Dashed));
        if let Some((from, to)) = approach(run) {
            errors = errors.span(from, to, "approach", colour::PURPLE);
        }
        chart = chart.panel(errors).panel(
            Panel::new("Heading (°)")
                .height(110.0)
                .range(-185.0, 185.0)
                .degrees()
                .series(Series::line("", broken_at_wraps(heading)).width(1.2)),
        );
    }
    if !run.commands.is_empty() || !run.telemetry.is_empty() {
        chart = chart
            .panel(commanded_and_held(run, "f (Hz)", |c| c.frequency_hz, |t| t.frequency_hz))
            .panel(
                commanded_and_held(run, "theta (deg)", |c| c.direction_deg, line_held)
                    .series(extreme(run, "", colour::MEASURED, |t| line(t, t.direction_least_deg?)))
                    .series(extreme(run, EXTREMES, colour::MEASURED, |t| {
                        line(t, t.direction_largest_deg?)
                    }))
                    .degrees(),
            );
    }
    if !run.telemetry.is_empty() {
        chart = chart
            .panel(
                Panel::new("Current q (A)")
                    .series(extreme(run, "", colour::BLUE, |t| t.top.current_q_least_a))
                    .series(extreme(run, "", colour::BLUE, |t| t.top.current_q_largest_a))
                    .series(extreme(run, "", colour::ORANGE, |t| t.bottom.current_q_least_a))
                    .series(extreme(run, EXTREMES, colour::ORANGE, |t| {
                        t.bottom.current_q_largest_a
                    }))
                    .series(measured(run, "top", |t| Some(t.top.current_q_a)).colour(colour::BLUE))
                    .series(
                        measured(run, "bottom", |t| Some(t.bottom.current_q_a))
                            .colour(colour::ORANGE),
                    ),
            )
            .panel(
                Panel::new("Battery (V)")
                    .height(90.0)
                    .series(measured(run, "", |t| t.bus_voltage_v).colour(colour::GREEN)),
            );
    }
    chart
}

/// Returns when the robot walked to its path, s: that error is in no result. `None` where it began on the path.
fn approach(run: &Run) -> Option<(f64, f64)> {
    run.path.as_ref()?;
    let first = run.navigation.first().filter(|row| row.error_m.abs() >= JOINED_WITHIN)?;
    let joined = run.navigation.iter().find(|row| row.error_rms_m > 0.0);
    let end = joined.or(run.navigation.last())?;
    Some((run.time(&first.timestamp), run.time(&end.timestamp)))
}

fn commanded_and_held(
    run: &Run,
    label: &str,
    commanded: fn(&CommandRow) -> f64,
    held: fn(&TelemetryRow) -> f64,
) -> Panel {
    let mut commands: Vec<_> =
        run.commands.iter().map(|c| (run.time(&c.timestamp), commanded(c))).collect();
    // The last one holds to the end.
    if let (Some((_, value)), Some(end)) = (commands.last().copied(), run.telemetry.last()) {
        commands.push((run.time(&end.timestamp), value));
    }
    Panel::new(label)
        .height(110.0)
        .series(Series::line("commanded", commands).stroke(Stroke::Step).colour(colour::COMMANDED))
        .series(measured(run, "measured", move |t| Some(held(t))).colour(colour::MEASURED))
}

/// Returns the measured line of force next to the commanded one, degrees: it repeats every half turn.
fn line_held(row: &TelemetryRow) -> f64 {
    let commanded = row.commanded_direction_deg;
    commanded + line_difference(row.direction_deg - commanded)
}

/// Returns an end of the range of theta beside its mean, degrees.
fn line(row: &TelemetryRow, direction: f64) -> Option<f64> {
    Some(line_held(row) + line_difference(direction - row.direction_deg))
}

/// Names the thin lines above and below a mean.
const EXTREMES: &str = "least and largest";

/// Returns an end of the range of what ripples, since the telemetry before.
fn extreme(
    run: &Run,
    label: &str,
    of: colour::Colour,
    value: impl Fn(&TelemetryRow) -> Option<f64>,
) -> Series {
    measured(run, label, value).colour(of.towards(colour::WHITE, 0.55)).width(0.8)
}

fn measured(run: &Run, label: &str, value: impl Fn(&TelemetryRow) -> Option<f64>) -> Series {
    let points =
        run.telemetry.iter().map(|t| (run.time(&t.timestamp), value(t).unwrap_or(f64::NAN)));
    Series::line(label, points).width(1.2)
}

/// Breaks the line where a heading wraps from one end of its range to the other.
fn broken_at_wraps(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut broken: Vec<(f64, f64)> = Vec::new();
    for (time, angle) in points {
        if broken.last().is_some_and(|(_, last)| (angle - last).abs() > 180.0) {
            broken.push((time, f64::NAN));
        }
        broken.push((time, angle));
    }
    broken
}

/// Breaks the line where the robot was carried: from one pose to the next it walks millimetres.
fn broken_at_jumps(positions: impl Iterator<Item = Position>) -> Vec<Position> {
    let mut broken: Vec<Position> = Vec::new();
    for position in positions {
        if broken.last().is_some_and(|last| last.distance_to(position) > JUMP) {
            broken.push(Position::new(f64::NAN, f64::NAN));
        }
        broken.push(position);
    }
    broken
}

fn title(run: &Run, what: &str) -> String {
    let name = run.fact("run", "name").replace('-', " ");
    let mut letters = if name.is_empty() { "run".chars() } else { name.chars() };
    let first: String = letters.next().into_iter().flat_map(char::to_uppercase).collect();
    format!("{first}{}, {what}", letters.as_str())
}

fn subtitle(run: &Run) -> String {
    let mut parts =
        vec![run.fact("run", "robot").to_owned(), run.fact("run", "started").to_owned()];
    let rms = run.fact("results", "path_error_rms_mm");
    if !rms.is_empty() {
        parts.push(format!("path error {rms} mm RMS"));
    }
    parts.retain(|part| !part.is_empty());
    parts.join(" · ")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::Figure as _;
    use crate::walked::write_record;

    #[test]
    fn a_run_is_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::read(&write_record(folder.path())).unwrap();
        let out = std::env::var("FLIX_PLOT_OUT").map_or(folder.path().to_owned(), PathBuf::from);
        track(&run).write(&out, "run-track").unwrap();
        let timeline = timeline(&run);
        timeline.write(&out, "run-timeline").unwrap();
        let svg = timeline.svg();
        for label in
            ["Heading", "Current q", "commanded", "measured", "least and largest", "walker-3f2c"]
        {
            assert!(svg.contains(label), "{label}");
        }
    }

    #[test]
    fn start_and_end_of_a_track_are_named_in_its_legend() {
        let folder = tempfile::tempdir().unwrap();
        let svg = track(&Run::read(&write_record(folder.path())).unwrap()).svg();
        assert!(svg.contains(">start<") && svg.contains(">end<"));
    }

    #[test]
    fn the_approach_is_marked_in_the_error_as_not_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::read(&write_record(folder.path())).unwrap();
        let said = "shaded: approach, not counted";
        assert!(!timeline(&run).svg().contains(said), "it began on its path");
        for row in &mut run.navigation[..200] {
            (row.error_m, row.error_rms_m) = (0.08, 0.0);
        }
        let svg = timeline(&run).svg();
        assert!(svg.contains(said) && svg.contains(">approach<"));
    }
}
