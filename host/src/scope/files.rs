//! A capture as table and record.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use mcap::WriteOptions;
use mcap::records::MessageHeader;
use serde_json::{Map, Value, json};

use super::Capture;
use crate::record::Timestamp;
use crate::system::file;

/// Writes a table: seconds since the trigger, then one column for each channel, named with its unit.
///
/// # Errors
/// When the file cannot be written.
pub fn write_csv(capture: &Capture, file: &Path) -> Result<(), csv::Error> {
    file::replace(file, |target| write_rows(capture, target))
}

fn write_rows(capture: &Capture, target: &File) -> Result<(), csv::Error> {
    let mut table = csv::Writer::from_writer(target);
    let names = capture.channels().iter().map(|it| format!("{it}_{}", it.quantity().unit()));
    table.write_record(std::iter::once("time_s".to_owned()).chain(names))?;
    for row in 0..capture.rows() {
        let time = format!("{:.4}", capture.time(row));
        let values = capture.row(row).map(|value| format!("{value:.6}"));
        table.write_record(std::iter::once(time).chain(values))?;
    }
    table.flush()?;
    Ok(())
}

/// Writes a record for Foxglove and its kin: topic `/scope`, one message for each row, on the robot's clock.
///
/// # Errors
/// When the file cannot be written.
pub fn write_mcap(capture: &Capture, file: &Path) -> Result<(), mcap::McapError> {
    file::replace(file, |target| write_messages(capture, target))
}

fn write_messages(capture: &Capture, target: &File) -> Result<(), mcap::McapError> {
    let mut writer = WriteOptions::new()
        .compression(None)
        .library(crate::system::program::get())
        .create(BufWriter::new(target))?;
    let schema = schema(capture).to_string();
    let schema = writer.add_schema("flix.Scope", "jsonschema", schema.as_bytes())?;
    let channel = writer.add_channel(schema, "/scope", "json", &BTreeMap::new())?;
    for row in 0..capture.rows() {
        let nanos = capture.nanos(row);
        let header = MessageHeader {
            channel_id: channel,
            sequence: row as u32,
            log_time: nanos,
            publish_time: nanos,
        };
        let mut message = Map::new();
        message.insert("timestamp".to_owned(), json!(Timestamp::from_nanos(nanos)));
        for (channel, value) in capture.channels().iter().zip(capture.row(row)) {
            message.insert(channel.to_string(), json!(value));
        }
        let message = serde_json::to_vec(&Value::Object(message)).map_err(io::Error::from)?;
        writer.write_to_known_channel(&header, &message)?;
    }
    writer.finish()?;
    writer.into_inner().into_inner().map_err(|error| mcap::McapError::Io(error.into_error()))?;
    Ok(())
}

fn schema(capture: &Capture) -> Value {
    let number = |text: &str| json!({ "type": "integer", "description": text });
    let mut properties = Map::new();
    let timestamp = json!({
        "type": "object",
        "description": "Since the robot started",
        "properties": { "sec": number("s"), "nsec": number("ns") },
    });
    properties.insert("timestamp".to_owned(), timestamp);
    for channel in capture.channels() {
        let unit = channel.quantity().unit();
        properties.insert(channel.to_string(), json!({ "type": "number", "description": unit }));
    }
    json!({ "title": "flix.Scope", "type": "object", "properties": properties })
}
