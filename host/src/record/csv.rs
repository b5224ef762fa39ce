//! Exports a run as tables: one CSV file per topic, for spreadsheets and scripts.

use std::fs::File;
use std::path::{Path as FilePath, PathBuf};

use csv::Writer;

use super::{MotorRow, RecordError, Run, Timestamp};
use crate::system::file;

/// Writes `STEM-pose.csv`, `-command.csv`, `-navigation.csv`, `-telemetry.csv` and `-log.csv` (those
/// that have rows) into `folder`, and returns their paths. Times are in seconds since the first row. Replaces links of
/// these names, and follows none.
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
    for Table { topic, columns, rows } in tables(run) {
        if rows.is_empty() {
            continue;
        }
        let path = folder.join(format!("{stem}-{topic}.csv"));
        let write = |file: &File| -> csv::Result<()> {
            let mut writer = Writer::from_writer(file);
            writer.write_record(columns.split(','))?;
            rows.iter().try_for_each(|row| writer.write_record(row))?;
            Ok(writer.flush()?)
        };
        file::replace(&path, write).map_err(std::io::Error::from).map_err(failed(&path))?;
        written.push(path);
    }
    Ok(written)
}

/// The rows of one topic.
struct Table {
    topic: &'static str,
    columns: &'static str,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// Makes a table from the cells of each row; the time comes first.
    fn new<'a, Row>(
        run: &Run,
        topic: &'static str,
        columns: &'static str,
        rows: &'a [Row],
        cells: impl Fn(&'a Row) -> (Timestamp, Vec<String>),
    ) -> Self {
        let line = |row| {
            let (time, cells) = cells(row);
            [vec![format!("{:.6}", run.time(&time))], cells].concat()
        };
        Self { topic, columns, rows: rows.iter().map(line).collect() }
    }
}

fn tables(run: &Run) -> [Table; 5] {
    [
        Table::new(run, "pose", "time_s,x_m,y_m,z_m,qw,qx,qy,qz,valid", &run.poses, |row| {
            let (position, orientation) =
                (row.pose.position.coordinates(), row.pose.orientation.components());
            let pose = [texts(position), texts(orientation), texts([row.valid])];
            (row.timestamp, pose.concat())
        }),
        Table::new(
            run,
            "command",
            "time_s,frequency_hz,direction_deg,mode",
            &run.commands,
            |row| {
                let pair = texts([row.frequency_hz, row.direction_deg]);
                (row.timestamp, [pair, texts([&row.mode])].concat())
            },
        ),
        Table::new(
            run,
            "navigation",
            "time_s,x_m,y_m,heading_rad,error_m,error_rms_m,arc_length_m,laps",
            &run.navigation,
            |row| {
                let pose = [row.x_m, row.y_m, row.heading_rad];
                let progress = [row.error_m, row.error_rms_m, row.arc_length_m, row.laps];
                (row.timestamp, [texts(pose), texts(progress)].concat())
            },
        ),
        Table::new(
            run,
            "telemetry",
            "time_s,robot_time_s,state,faults,commanded_frequency_hz,commanded_direction_deg,\
             frequency_hz,direction_deg,top_angle_deg,top_speed_hz,top_current_d_a,top_current_q_a,\
             bottom_angle_deg,bottom_speed_hz,bottom_current_d_a,bottom_current_q_a,bus_voltage_v,\
             modulation,overruns,lost,command_age_ms,direction_least_deg,direction_largest_deg,\
             top_current_q_least_a,top_current_q_largest_a,bottom_current_q_least_a,bottom_current_q_largest_a,\
             bus_voltage_least_v,bus_voltage_largest_v,top_readings_dropped,top_readings_corrected,\
             bottom_readings_dropped,bottom_readings_corrected",
            &run.telemetry,
            |row| {
                let cells = [
                    texts([row.robot_time_s]),
                    texts([&row.state, &row.faults.join(" ")]),
                    texts([row.commanded_frequency_hz, row.commanded_direction_deg]),
                    texts([row.frequency_hz, row.direction_deg]),
                    motor(&row.top),
                    motor(&row.bottom),
                    optional([row.bus_voltage_v]),
                    texts([row.modulation]),
                    texts([row.overruns, row.lost]),
                    optional([row.command_age_ms]),
                    optional([row.direction_least_deg, row.direction_largest_deg]),
                    optional([row.top.current_q_least_a, row.top.current_q_largest_a]),
                    optional([row.bottom.current_q_least_a, row.bottom.current_q_largest_a]),
                    optional([row.bus_voltage_least_v, row.bus_voltage_largest_v]),
                    optional([row.top.readings_dropped, row.top.readings_corrected]),
                    optional([row.bottom.readings_dropped, row.bottom.readings_corrected]),
                ];
                (row.timestamp, cells.concat())
            },
        ),
        Table::new(run, "log", "time_s,level,message", &run.events, |row| {
            (row.timestamp, vec![row.level.to_string(), row.message.clone()])
        }),
    ]
}

fn motor(motor: &MotorRow) -> Vec<String> {
    texts([motor.angle_deg, motor.speed_hz, motor.current_d_a, motor.current_q_a])
}

/// Returns an empty cell for what is not there.
fn optional<const COUNT: usize>(values: [Option<impl ToString>; COUNT]) -> Vec<String> {
    values
        .iter()
        .map(|value| value.as_ref().map_or_else(String::new, ToString::to_string))
        .collect()
}

fn texts<const COUNT: usize>(values: [impl ToString; COUNT]) -> Vec<String> {
    values.iter().map(ToString::to_string).collect()
}
