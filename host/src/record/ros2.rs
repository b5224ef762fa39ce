//! Exports a run as a bag of ROS 2, which `ros2 bag play` plays: poses, velocity and battery in standard messages.
//!
//! A bag is a folder with `metadata.yaml` and an MCAP file, whose messages are in CDR (OMG's Common Data Representation, XCDR1,
//! little-endian): each number is aligned to its size, counted from the end of a head of four bytes; text has its length before it and
//! a zero behind it.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};

use super::{BASE_LINK, MAP, PoseRow, RecordError, Run, Timestamp};
use crate::system::file;

/// A kind of message: topic, type and definition, with those of its parts.
struct Topic {
    name: &'static str,
    of: &'static str,
    definition: &'static str,
}

const TOPICS: [Topic; 3] = [
    Topic {
        name: "/pose",
        of: "geometry_msgs/msg/PoseStamped",
        definition: include_str!("schemas/PoseStamped.msg"),
    },
    Topic {
        name: "/twist",
        of: "geometry_msgs/msg/TwistStamped",
        definition: include_str!("schemas/TwistStamped.msg"),
    },
    Topic {
        name: "/battery_state",
        of: "sensor_msgs/msg/BatteryState",
        definition: include_str!("schemas/BatteryState.msg"),
    },
];
/// Two poses farther apart, s, state no velocity.
const LONGEST_GAP: f64 = 0.5;
/// `POWER_SUPPLY_STATUS_DISCHARGING`
const DISCHARGING: u8 = 2;

/// A message: nanoseconds since 1970, number of its topic, bytes.
type Message = (u64, u16, Vec<u8>);

/// Writes the folder `STEM-ros2` with a bag into `folder`, and returns its path. `/pose` has each pose that its source trusted,
/// `/twist` the mean velocity since the one before in axes of the body, and `/battery_state` the voltage of the battery. Replaces links
/// of these names, and follows none.
///
/// # Errors
/// When a file cannot be written.
pub fn export(run: &Run, folder: &Path) -> Result<PathBuf, RecordError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| RecordError::File { path, source }
    };
    let stem = run.file.file_stem().unwrap_or_else(|| "run".as_ref()).to_string_lossy();
    let bag = folder.join(format!("{stem}-ros2"));
    fs::create_dir_all(&bag).map_err(failed(&bag))?;
    let mut messages: Vec<Message> = [poses(run), twists(run), batteries(run)].concat();
    messages.sort_by_key(|(time, ..)| *time);
    let (name, path) = ("bag.mcap", bag.join("bag.mcap"));
    let cause = |error| match error {
        McapError::Io(cause) => cause,
        other => io::Error::other(other),
    };
    file::replace(&path, |target| write(&messages, target))
        .map_err(cause)
        .map_err(failed(&path))?;
    let path = bag.join("metadata.yaml");
    let text = metadata(&messages, name);
    file::replace(&path, |mut target| target.write_all(text.as_bytes())).map_err(failed(&path))?;
    Ok(bag)
}

fn write(messages: &[Message], target: &File) -> Result<(), McapError> {
    let options = WriteOptions::new().profile("ros2").compression(None);
    let mut writer =
        options.library(crate::system::program::get()).create(BufWriter::new(target))?;
    let qualities = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
    let mut ids = Vec::new();
    for Topic { name, of, definition } in TOPICS {
        let schema = writer.add_schema(of, "ros2msg", definition.as_bytes())?;
        ids.push(writer.add_channel(schema, name, "cdr", &qualities)?);
    }
    for (sequence, (time, topic, data)) in messages.iter().enumerate() {
        let header = MessageHeader {
            channel_id: ids[usize::from(*topic)],
            sequence: sequence as u32,
            log_time: *time,
            publish_time: *time,
        };
        writer.write_to_known_channel(&header, data)?;
    }
    writer.finish()?;
    writer.into_inner().into_inner().map_err(|error| McapError::Io(error.into_error()))?;
    Ok(())
}

/// Returns the text of `metadata.yaml` (version 5, of ROS 2 Humble and later).
fn metadata(messages: &[Message], file: &str) -> String {
    let first = messages.first().map_or(0, |(time, ..)| *time);
    let nanoseconds = messages.last().map_or(0, |(time, ..)| time - first);
    let count = messages.len();
    let topic = |(number, Topic { name, of, .. }): (usize, Topic)| {
        let count = messages.iter().filter(|(_, topic, _)| usize::from(*topic) == number).count();
        format!(
            "    - topic_metadata: {{name: {name}, type: {of}, serialization_format: cdr, offered_qos_profiles: \"\"}}\n      \
             message_count: {count}\n"
        )
    };
    let topics: String = TOPICS.into_iter().enumerate().map(topic).collect();
    let span = format!(
        "duration: {{nanoseconds: {nanoseconds}}}, starting_time: {{nanoseconds_since_epoch: {first}}}, message_count: {count}"
    );
    format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {nanoseconds}\n  \
         starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {count}\n  topics_with_message_count:\n{topics}  \
         compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  files:\n    \
         - {{path: {file}, {span}}}\n"
    )
}

fn nanos(time: &Timestamp) -> u64 {
    u64::from(time.sec) * 1_000_000_000 + u64::from(time.nsec)
}

fn poses(run: &Run) -> Vec<Message> {
    let message = |row: &PoseRow| {
        let [w, x, y, z] = row.pose.orientation.components();
        let mut data = Cdr::new(&row.timestamp, MAP);
        data.doubles(row.pose.position.coordinates());
        data.doubles([x, y, z, w]);
        (nanos(&row.timestamp), 0, data.0)
    };
    run.poses.iter().filter(|row| row.valid).map(message).collect()
}

fn twists(run: &Run) -> Vec<Message> {
    let valid: Vec<&PoseRow> = run.poses.iter().filter(|row| row.valid).collect();
    let message = |pair: &[&PoseRow]| {
        let [before, now] = pair else { return None };
        let seconds = now.timestamp.seconds_since(&before.timestamp);
        if !(seconds > 0.0 && seconds <= LONGEST_GAP) {
            return None;
        }
        let [from, to] = [before, now].map(|row| row.pose.position.coordinates());
        let moved: [f64; 3] = core::array::from_fn(|axis| (to[axis] - from[axis]) / seconds);
        let back = now.pose.orientation.inverse();
        let turned = before.pose.orientation.inverse().after(now.pose.orientation);
        let mut data = Cdr::new(&now.timestamp, BASE_LINK);
        data.doubles(back.turn(moved.into()).coordinates());
        data.doubles(turned.rotation_vector().coordinates().map(|angle| angle / seconds));
        Some((nanos(&now.timestamp), 1, data.0))
    };
    valid.windows(2).filter_map(message).collect()
}

fn batteries(run: &Run) -> Vec<Message> {
    let measured = run.telemetry.iter().filter_map(|row| Some((row.timestamp, row.bus_voltage_v?)));
    let message = |(time, volts): (Timestamp, f64)| {
        let mut data = Cdr::new(&time, BASE_LINK);
        data.put((volts as f32).to_le_bytes());
        // Temperature, current, charge, capacity, that of its design and percentage are not measured.
        (0..6).for_each(|_| data.put(f32::NAN.to_le_bytes()));
        // Status, health, technology, presence.
        for value in [DISCHARGING, 0, 0, 1] {
            data.put([value]);
        }
        // Voltages and temperatures of cells: none.
        data.put(0_u32.to_le_bytes());
        data.put(0_u32.to_le_bytes());
        data.text("");
        data.text("");
        (nanos(&time), 2, data.0)
    };
    measured.map(message).collect()
}

/// A message in CDR.
struct Cdr(Vec<u8>);

impl Cdr {
    /// Bytes before the message: representation (little-endian CDR) and options.
    const HEAD: [u8; 4] = [0, 1, 0, 0];

    /// Begins with a `std_msgs/Header`.
    fn new(time: &Timestamp, frame: &str) -> Self {
        let mut data = Self(Self::HEAD.to_vec());
        // Seconds are signed there, and end in 2038.
        data.put(i32::try_from(time.sec).unwrap_or(i32::MAX).to_le_bytes());
        data.put(time.nsec.to_le_bytes());
        data.text(frame);
        data
    }

    /// Puts a number, aligned to its size.
    fn put<const SIZE: usize>(&mut self, bytes: [u8; SIZE]) {
        let used = self.0.len() - Self::HEAD.len();
        self.0.resize(Self::HEAD.len() + used.next_multiple_of(SIZE), 0);
        self.0.extend(bytes);
    }

    fn doubles<const COUNT: usize>(&mut self, values: [f64; COUNT]) {
        values.iter().for_each(|value| self.put(value.to_le_bytes()));
    }

    fn text(&mut self, text: &str) {
        self.put((text.len() as u32 + 1).to_le_bytes());
        self.0.extend(text.bytes().chain([0]));
    }
}
