//! A run as tables: one CSV file a topic, for spreadsheets and scripts.

use std::fmt::Write;
use std::path::{Path as FilePath, PathBuf};

use super::{RecordError, Run};

/// Writes `STEM-pose.csv`, `-command.csv`, `-navigation.csv`, `-telemetry.csv` and `-log.csv` (those
/// that have rows) into `folder` and says which. Times are seconds since the first row.
///
/// # Errors
/// When a file cannot be written.
pub fn export(run: &Run, folder: &FilePath) -> Result<Vec<PathBuf>, RecordError> {
    let failed = |path: &FilePath| {
        let path = path.to_owned();
        move |source| RecordError::File { path, source }
    };
    std::fs::create_dir_all(folder).map_err(failed(folder))?;
    let stem =
        run.file.file_stem().map_or_else(|| "run".into(), |s| s.to_string_lossy().into_owned());
    let mut written = Vec::new();
    for (topic, table) in tables(run) {
        let path = folder.join(format!("{stem}-{topic}.csv"));
        std::fs::write(&path, table).map_err(failed(&path))?;
        written.push(path);
    }
    Ok(written)
}

/// The tables with at least one row, by topic.
#[must_use]
pub fn tables(run: &Run) -> Vec<(&'static str, String)> {
    let mut tables = vec![
        ("pose", poses(run)),
        ("command", commands(run)),
        ("navigation", navigation(run)),
        ("telemetry", telemetry(run)),
        ("log", log(run)),
    ];
    tables.retain(|(_, table)| table.lines().count() > 1);
    tables
}

fn poses(run: &Run) -> String {
    let mut table = String::from("time_s,x_m,y_m,z_m,qw,qx,qy,qz,valid\n");
    for row in &run.poses {
        let pose = row.pose.pose();
        let numbers = pose.position.iter().chain(&pose.orientation).map(f64::to_string);
        let numbers: Vec<_> = numbers.collect();
        line(&mut table, run.time(&row.timestamp), &[&numbers.join(","), &row.valid.to_string()]);
    }
    table
}

fn commands(run: &Run) -> String {
    let mut table = String::from("time_s,frequency_hz,direction_deg,mode\n");
    for row in &run.commands {
        let (f, theta) = (row.frequency_hz.to_string(), row.direction_deg.to_string());
        line(&mut table, run.time(&row.timestamp), &[&f, &theta, &quoted(&row.mode)]);
    }
    table
}

fn navigation(run: &Run) -> String {
    let mut table =
        String::from("time_s,x_m,y_m,heading_rad,error_m,error_rms_m,arc_length_m,laps\n");
    for row in &run.navigation {
        let numbers = [
            row.x_m,
            row.y_m,
            row.heading_rad,
            row.error_m,
            row.error_rms_m,
            row.arc_length_m,
            row.laps,
        ];
        line(&mut table, run.time(&row.timestamp), &[&joined(&numbers)]);
    }
    table
}

fn telemetry(run: &Run) -> String {
    let mut table = String::from(
        "time_s,robot_time_s,state,faults,commanded_frequency_hz,commanded_direction_deg,frequency_hz,\
         direction_deg,top_angle_deg,top_speed_hz,top_current_d_a,top_current_q_a,bottom_angle_deg,\
         bottom_speed_hz,bottom_current_d_a,bottom_current_q_a,bus_voltage_v,modulation,overruns,lost\n",
    );
    for row in &run.telemetry {
        let shaking = [
            row.commanded_frequency_hz,
            row.commanded_direction_deg,
            row.frequency_hz,
            row.direction_deg,
        ];
        let motor =
            |m: &super::MotorRow| joined(&[m.angle_deg, m.speed_hz, m.current_d_a, m.current_q_a]);
        line(
            &mut table,
            run.time(&row.timestamp),
            &[
                &row.robot_time_s.to_string(),
                &quoted(&row.state),
                &quoted(&row.faults.join(" ")),
                &joined(&shaking),
                &motor(&row.top),
                &motor(&row.bottom),
                &row.bus_voltage_v.map(|v| v.to_string()).unwrap_or_default(),
                &row.modulation.to_string(),
                &row.overruns.to_string(),
                &row.lost.to_string(),
            ],
        );
    }
    table
}

fn log(run: &Run) -> String {
    let mut table = String::from("time_s,level,message\n");
    for row in &run.events {
        line(
            &mut table,
            run.time(&row.timestamp),
            &[&row.level.to_string(), &quoted(&row.message)],
        );
    }
    table
}

fn line(table: &mut String, time: f64, cells: &[&str]) {
    // Writing into a string cannot fail.
    let _ = writeln!(table, "{time:.6},{}", cells.join(","));
}

fn joined(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
}

/// A text as RFC 4180 wants it.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
