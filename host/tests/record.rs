//! A run is recorded, read back, repaired, listed and exported.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use std::time::{Duration, UNIX_EPOCH};

use flix_host::record::*;
use flix_protocol::message::Telemetry;

use crate::walked::*;

#[test]
fn what_was_recorded_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::read(&write_record(folder.path())).unwrap();
    assert_eq!(
        (run.poses.len(), run.commands.len(), run.telemetry.len(), run.events.len()),
        (600, 600, 600, 1)
    );
    assert_eq!(run.poses[100].pose, sample(5.0).pose);
    assert!((run.seconds() - 29.95).abs() < 1e-6);
    assert_eq!(run.fact("settings", "latency"), "20ms");
    assert_eq!(run.fact("results", "path_error_rms_mm"), "7.1");
    assert_eq!(run.attachments, [("modes.toml".to_owned(), 8)]);
    assert_eq!(run.telemetry[0].faults, ["stall"]);
    assert_eq!(run.telemetry[0].first_fault.as_deref(), Some("stall"));
    assert_eq!(run.telemetry[0].dropped["forged"], 3);
    assert_eq!(run.telemetry[0].top.readings_dropped, Some(2));
    assert_eq!(run.telemetry[0].bottom.readings_corrected, Some(5));
}

#[test]
fn a_record_whose_program_was_killed_is_still_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let run = Run::read(&file).unwrap();
    assert!(run.poses.len() > 100, "{} poses", run.poses.len());
}

#[test]
fn a_record_whose_program_was_killed_is_completed_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let whole = std::fs::read(&file).unwrap();
    let cut = &whole[..whole.len() * 2 / 3];
    std::fs::write(&file, cut).unwrap();
    let before = Run::read(&file).unwrap();
    assert!(!before.is_complete && mcap::Summary::read(&std::fs::read(&file).unwrap()).is_err());
    let Repaired { rows, damage, original } = repair(&file).unwrap().unwrap();
    assert!(damage.is_none() && std::fs::read(&original).unwrap() == cut, "{damage}");
    let after = Run::read(&file).unwrap();
    assert!(after.is_complete, "other readers find its summary");
    assert_eq!((after.poses.len(), &after.facts), (before.poses.len(), &before.facts));
    assert_eq!(after.attachments, before.attachments);
    assert!(rows > 100);
    assert_eq!(repair(&file).unwrap(), None, "a complete record is left as it is");
}

#[test]
fn a_record_that_is_being_written_is_not_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let description = RunDescription::default();
    let recorder = Recorder::create(folder.path(), UNIX_EPOCH, &description).unwrap();
    let file = recorder.path().to_owned();
    assert!(is_being_written(&file));
    assert!(matches!(repair(&file), Err(RepairError::Busy(_))));
    recorder.finish().unwrap();
    assert!(!is_being_written(&file));
}

#[test]
fn a_record_ends_whole_before_the_disk_has_less_room_than_is_to_stay() {
    let folder = tempfile::tempdir().unwrap();
    let description = RunDescription::default();
    let mut recorder = Recorder::create(folder.path(), UNIX_EPOCH, &description).unwrap();
    let log = |recorder: &mut Recorder, seconds: u64| {
        let now = flix_protocol::units::Instant::from_micros(seconds * 1_000_000);
        recorder.log(now, Level::Information, "a row")
    };
    recorder.leave_free(0).unwrap();
    assert!((0..5).all(|second| log(&mut recorder, second).is_ok()));
    let sentence = recorder.leave_free(u64::MAX).unwrap_err().to_string();
    assert!(sentence.contains("MB are free") && sentence.contains("--leave-free"), "{sentence}");
    log(&mut recorder, 5).unwrap_err();
    let file = recorder.path().to_owned();
    drop(recorder);
    let run = Run::read(&file).unwrap();
    assert_eq!((run.events.len(), run.is_complete), (6, true));
}

#[test]
fn a_record_that_is_cut_off_within_its_first_rows_still_says_what_the_run_was() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let whole = std::fs::read(&file).unwrap();
    let facts = Run::read(&file).unwrap().facts;
    let is_cut = |length: &usize| {
        std::fs::write(&file, &whole[..*length]).unwrap();
        Run::read(&file).is_ok_and(|run| run.poses.is_empty() && !run.facts.is_empty())
    };
    let length = (64..whole.len()).step_by(256).find(is_cut).expect("the facts come first");
    std::fs::write(&file, &whole[..length]).unwrap();
    let run = Run::read(&file).unwrap();
    assert_eq!(run.fact("run", "name"), facts["run"]["name"]);
    assert!(!run.is_complete);
}

#[test]
fn a_file_that_is_no_record_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("x.mcap");
    std::fs::write(&file, b"hello").unwrap();
    assert!(Run::read(&file).unwrap_err().to_string().contains("not a record"));
}

#[test]
fn runs_of_one_second_get_files_of_their_own_and_are_found_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let first = write_record(folder.path());
    assert_eq!(Run::find(folder.path(), "circle").unwrap().poses.len(), 600);
    let second = write_record(folder.path());
    assert_ne!(first, second);
    assert_eq!(list(folder.path()).unwrap().runs.len(), 2);
    let find = |name: &str| Run::find(folder.path(), name).map(|run| run.file);
    assert_eq!(find("last").unwrap(), second);
    // Its whole name is a part of the other's, too.
    assert_eq!(find(first.file_stem().unwrap().to_str().unwrap()).unwrap(), first);
    assert!(matches!(find("circle"), Err(ReadError::Ambiguous { count: 2, .. })));
    for name in ["square", ""] {
        assert!(matches!(find(name), Err(ReadError::NoSuchRun { .. })), "{name}");
    }
}

#[test]
fn entries_that_are_no_files_are_named_and_no_runs() {
    let out = tempfile::tempdir().unwrap();
    let run = write_record(out.path());
    let at = |name: &str| out.path().join(FOLDER).join(name);
    let owner = rustix::fs::Mode::from_raw_mode(0o600);
    rustix::fs::mkfifoat(rustix::fs::CWD, at("9-pipe.mcap"), owner).unwrap();
    std::fs::create_dir(at("9-folder.mcap")).unwrap();
    std::os::unix::fs::symlink(at("nothing"), at("9-link.mcap")).unwrap();
    let found = list(out.path()).unwrap();
    assert_eq!(found.runs.iter().map(|it| &it.file).collect::<Vec<_>>(), [&run]);
    let mut skipped: Vec<_> = found.skipped.iter().map(|it| it.1.to_string()).collect();
    skipped.sort();
    for (sentence, words) in
        skipped.iter().zip(["folder.mcap: it is a directory", "No such file", "it is a pipe"])
    {
        assert!(sentence.contains(words), "{skipped:?}");
    }
    assert_eq!(Run::find(out.path(), "last").unwrap().file, run);
    assert!(Run::find(out.path(), at("9-pipe.mcap").to_str().unwrap()).is_err());
}

#[test]
fn tables_have_one_line_a_row_and_quote_texts() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::read(&write_record(folder.path())).unwrap();
    let files = csv::export(&run, &folder.path().join("tables")).unwrap();
    assert_eq!(files.len(), 5);
    let telemetry = std::fs::read_to_string(&files[3]).unwrap();
    let columns: Vec<_> = telemetry.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.len() == 601 && columns.iter().all(|c| *c == columns[0]), "{}", columns[0]);
}

/// Returns whether Python has this package of PyPI. Missing, the test says so and passes, unless
/// `FLIX_REQUIRE_PYTHON_MCAP` is set, as continuous integration does after installing it.
fn has_package(name: &str) -> bool {
    let found = Command::new("python3").args(["-c", &format!("import {name}")]).output();
    let has_it = found.is_ok_and(|output| output.status.success());
    assert!(
        has_it || std::env::var_os("FLIX_REQUIRE_PYTHON_MCAP").is_none(),
        "python3 with the package {name} is required here: pip install {name}"
    );
    if !has_it {
        eprintln!("skipped: python3 has no package {name} (pip install {name})");
    }
    has_it
}

/// An independent reader: the `mcap` package of PyPI.
#[test]
fn an_independent_reader_opens_the_record() {
    const SCRIPT: &str = r#"
import json, sys
from mcap.reader import make_reader
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    schemas = {summary.schemas[c.schema_id].name: c.topic for c in summary.channels.values()}
    assert schemas["foxglove.PoseInFrame"] == "/pose", schemas
    rows = [json.loads(m.data) for _, c, m in reader.iter_messages(topics=["/pose"])]
    assert abs(rows[0]["pose"]["position"]["x"] - 0.5) < 1e-9
    names = [m.name for m in reader.iter_metadata()]
    assert {"run", "settings", "versions", "results"} <= set(names), names
    assert [a.name for a in reader.iter_attachments()] == ["modes.toml"]
    print(len(rows))
"#;
    if !has_package("mcap") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let output = Command::new("python3").args(["-c", SCRIPT]).arg(&file).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && output.stdout.starts_with(b"600"), "{said}");
}

/// ROS 2's bags by another reader: the package `rosbags` of PyPI, as above.
#[test]
fn an_independent_reader_of_ros_2_opens_the_exported_bag() {
    const SCRIPT: &str = r#"
import math, sys
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
types = get_typestore(Stores.ROS2_HUMBLE)
seen = {}
with Reader(sys.argv[1]) as bag:
    for connection, time, data in bag.messages():
        message = types.deserialize_cdr(data, connection.msgtype)
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == time
        seen.setdefault(connection.topic, []).append((time, message))
    assert bag.message_count == sum(map(len, seen.values()))
poses, twists, batteries = (seen[topic] for topic in ("/pose", "/twist", "/battery_state"))
assert abs(poses[0][1].pose.position.x - 0.5) < 1e-9 and poses[0][1].header.frame_id == "map"
(before, one), (now, other) = poses[:2]
turn = one.pose.orientation
heading = 2 * math.atan2(turn.z, turn.w)
way = [getattr(other.pose.position, axis) - getattr(one.pose.position, axis) for axis in "xy"]
forward = (math.cos(heading) * way[0] + math.sin(heading) * way[1]) / (now - before) * 1e9
assert twists[0][0] == now and abs(twists[0][1].twist.linear.x - forward) < 0.02 * abs(forward) + 1e-3, (twists[0], forward)
battery = batteries[0][1]
assert 5 < battery.voltage < 20 and math.isnan(battery.current) and battery.present and len(battery.cell_voltage) == 0
print(len(poses))
"#;
    if !has_package("rosbags") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = Run::read(&write_record(folder.path())).unwrap();
    let bag = ros2::export(&run, &folder.path().join("bags")).unwrap();
    let output = Command::new("python3").args(["-c", SCRIPT]).arg(&bag).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && output.stdout.starts_with(b"600"), "{said}");
}

/// What the panels of a layout show, by topic: `/telemetry.top.current_q_a`.
fn shown(panel: &serde_json::Value) -> Vec<String> {
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let paths = panel["paths"].as_array().into_iter().flatten().map(|path| text(&path["value"]));
    let topics = panel["topics"].as_object().into_iter().flat_map(|topics| topics.keys().cloned());
    paths.chain(topics).chain(panel.get("topicToRender").map(text)).collect()
}

/// Returns the rows of a run by topic, each as its text.
fn rows(run: &Run) -> Vec<String> {
    let texts = |rows: Vec<serde_json::Result<String>>| rows.into_iter().map(Result::unwrap);
    let poses = texts(run.poses.iter().map(serde_json::to_string).collect());
    let commands = texts(run.commands.iter().map(serde_json::to_string).collect());
    let telemetry = texts(run.telemetry.iter().map(serde_json::to_string).collect());
    let navigation = texts(run.navigation.iter().map(serde_json::to_string).collect());
    let events = texts(run.events.iter().map(serde_json::to_string).collect());
    let path = texts(run.path.iter().map(serde_json::to_string).collect());
    poses.chain(commands).chain(telemetry).chain(navigation).chain(events).chain(path).collect()
}

#[test]
fn damage_costs_the_rows_of_its_part_alone_and_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(folder.path(), 120);
    let whole = std::fs::read(&file).unwrap();
    let run = Run::read(&file).unwrap();
    let all: BTreeSet<String> = rows(&run).into_iter().collect();
    let count = all.len() + run.unknown;
    assert_eq!(repair(&file).unwrap(), None);
    // From a fixed seed: where, how many bytes, and whether the file is cut off as well.
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut draw = |below: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (mut most, mut said) = (0, 0);
    for attempt in 0..200 {
        let mut bytes = whole.clone();
        let (at, length) = (draw(bytes.len()), [1, 1, 9, 4_000][draw(4)]);
        for byte in bytes.iter_mut().skip(at).take(length) {
            *byte ^= 1 << draw(8);
        }
        let is_cut = attempt % 4 == 3;
        if is_cut {
            bytes.truncate(bytes.len() * 3 / 4);
        }
        std::fs::write(&file, &bytes).unwrap();
        let run = Run::read(&file).unwrap();
        let read = rows(&run);
        assert!(read.iter().all(|row| all.contains(row)), "{attempt}: a row is another one");
        let missing = count - read.len() - run.unknown;
        if !is_cut {
            most = most.max(missing);
            // Where the end is damaged, too, rows that are no rows any more cannot be counted.
            let counted = run.damage.rows as usize;
            let is_told = if run.is_complete { counted == missing } else { counted <= missing };
            assert!(is_told, "{attempt} at {at}: {missing} missing, {}", run.damage);
            assert!(missing == 0 || !run.damage.is_none(), "{attempt} at {at}");
        }
        said += usize::from(!run.damage.is_none() || !run.is_complete);
        if let Some(Repaired { original, .. }) = repair(&file).unwrap() {
            assert_eq!(std::fs::read(&original).unwrap(), bytes, "{attempt}: it is kept");
            std::fs::remove_file(original).unwrap();
            let again = Run::read(&file).unwrap();
            assert!(again.is_complete && again.damage.is_none(), "{attempt}: {}", again.damage);
            assert_eq!(rows(&again), read, "{attempt}");
        } else {
            assert_eq!(std::fs::read(&file).unwrap(), bytes, "{attempt}");
        }
    }
    // A second of five topics, and the one beside it.
    assert!(most <= 2 * 5 * 21, "{most} rows of one place");
    assert_eq!(said, 200, "every damage is seen");
}

/// Returns kind, begin and end of each part of a whole record.
fn parts(bytes: &[u8]) -> Vec<(u8, usize, usize)> {
    let (mut at, mut parts) = (8, Vec::new());
    while at + 17 <= bytes.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        parts.push((bytes[at], at, at + 9 + length));
        at += 9 + length;
    }
    parts
}

/// Returns where the chunks of a whole record begin, and where its data ends.
fn chunks(bytes: &[u8]) -> (Vec<usize>, usize) {
    use mcap::records::op;
    let begins = |of: u8| {
        parts(bytes).into_iter().filter(move |(kind, ..)| *kind == of).map(|(_, begin, _)| begin)
    };
    (begins(op::CHUNK).collect(), begins(op::DATA_END).next().unwrap())
}

/// Writes a record, and returns its file, its bytes and how many rows it has.
fn whole(folder: &std::path::Path) -> (std::path::PathBuf, Vec<u8>, usize) {
    let file = write_record_of(folder, 120);
    let run = Run::read(&file).unwrap();
    let bytes = std::fs::read(&file).unwrap();
    (file, bytes, rows(&run).len() + run.unknown)
}

fn count(run: &Run) -> usize {
    rows(run).len() + run.unknown
}

#[test]
fn zeros_of_a_lost_power_are_said_and_hide_no_rows_behind_them() {
    use std::io::{Seek as _, SeekFrom, Write as _};
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let (begins, end) = chunks(&whole);
    let middle = begins[begins.len() / 2];
    for cut in [middle, middle + 2_000] {
        std::fs::write(&file, [&whole[..cut], &[0; 64 << 10]].concat()).unwrap();
        let run = Run::read(&file).unwrap();
        assert!(count(&run) > all / 3 && run.damage.is_loss(), "{cut}: {}", run.damage);
        assert!(run.damage.is_least, "{}", run.damage);
    }
    // Two, for which room on the disk was never taken, each longer than any part.
    let third = begins[begins.len() * 3 / 4];
    let mut target = std::fs::File::create(&file).unwrap();
    for stretch in [&whole[..middle], &whole[middle..third], &whole[third..end]] {
        target.write_all(stretch).unwrap();
        target.seek(SeekFrom::Current(300 << 20)).unwrap();
    }
    drop(target);
    let run = Run::read(&file).unwrap();
    assert_eq!((count(&run), run.damage.parts), (all, 2), "{}", run.damage);
    assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64);
}

#[test]
fn a_repair_mends_what_other_readers_refuse_and_says_what_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    for place in 0..8 {
        let mut bytes = whole.clone();
        bytes[place] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64, "{place}");
        assert_eq!(std::fs::read(&file).unwrap()[..8], whole[..8]);
        let run = Run::read(&file).unwrap();
        assert!(run.damage.is_none() && run.fact("repair", "damage").contains("changed"));
    }
}

#[test]
fn damage_behind_the_data_costs_no_row_and_is_said_to() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let end = chunks(&whole).1 + 13;
    let mut changed = whole.clone();
    changed[end + 20] ^= 1;
    let cuts = [end, end + 100, whole.len() - 20, whole.len() - 1].map(|cut| whole[..cut].to_vec());
    for bytes in cuts.into_iter().chain([changed, [&whole[..], b"\n"].concat()]) {
        std::fs::write(&file, &bytes).unwrap();
        let run = Run::read(&file).unwrap();
        let said = run.damage.to_string();
        assert_eq!((count(&run), run.damage.parts), (all, 0), "{said}");
        assert!(said.contains("all rows are there") && !said.contains("left out"), "{said}");
        repair(&file).unwrap().unwrap();
        assert!(Run::read(&file).unwrap().damage.is_none());
    }
    // Not of one that was changed within the data.
    let mut bytes = whole[..whole.len() - 20].to_vec();
    bytes[whole.windows(4).position(|it| it == b"20ms").unwrap()] = b'9';
    std::fs::write(&file, &bytes).unwrap();
    assert!(Run::read(&file).unwrap().damage.is_changed);
}

#[test]
fn rows_are_counted_by_the_indexes_behind_them_or_as_the_least() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let place = chunks(&whole).0[5] + 500;
    let longer = [&whole[..place], &[b'x'; 64], &whole[place..]].concat();
    std::fs::write(&file, &longer).unwrap();
    let run = Run::read(&file).unwrap();
    let missing = all - count(&run);
    assert!(missing > 10 && run.damage.rows == missing as u64, "{missing}: {}", run.damage);
    assert!(run.damage.to_string().contains("at least"), "{}", run.damage);
    // As a program that takes it for a text writes it.
    let mut text = Vec::new();
    for byte in &whole {
        text.extend(if *byte == b'\n' { &b"\r\n"[..] } else { std::slice::from_ref(byte) });
    }
    std::fs::write(&file, &text).unwrap();
    assert!(Run::read(&file).map_or(true, |run| run.damage.is_least));
    repair(&file).unwrap_err();
    assert_eq!(std::fs::read(&file).unwrap(), text, "it is as it was");
}

#[test]
fn a_record_without_rows_is_not_completed() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, _) = whole(folder.path());
    let bytes = [&whole[..chunks(&whole).0[1]], &[0; 4096]].concat();
    std::fs::write(&file, &bytes).unwrap();
    Run::read(&file).unwrap();
    assert!(matches!(repair(&file), Err(RepairError::Empty(_))));
    assert_eq!(std::fs::read(&file).unwrap(), bytes);
}

#[test]
fn rows_that_stand_twice_and_counts_that_are_wrong_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let (begins, end) = chunks(&whole);
    let chunk = &whole[begins[4]..begins[5]];
    let again = [&whole[..begins[6]], chunk, &whole[begins[6]..]].concat();
    // With its summary, which now leads elsewhere, and without.
    for bytes in [&again[..], &again[..end + chunk.len()]] {
        std::fs::write(&file, bytes).unwrap();
        let run = Run::read(&file).unwrap();
        assert_eq!(count(&run), all, "{}", run.damage);
        assert!(run.damage.repeated > 10, "{}", run.damage);
        assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64);
    }
    let statistics = parts(&whole).into_iter().find(|part| part.0 == 11).unwrap().1;
    for counted in [0, all as u64 - 1, all as u64 + 1, 1 << 40] {
        let mut bytes = whole.clone();
        bytes[statistics + 9..statistics + 17].copy_from_slice(&counted.to_le_bytes());
        sum_up(&mut bytes, end + 13);
        std::fs::write(&file, &bytes).unwrap();
        let run = Run::read(&file).unwrap();
        assert!(run.is_complete && run.damage.rows == 0, "{}", run.damage);
        assert_eq!(run.damage.counted, Some(counted), "{}", run.damage);
        repair(&file).unwrap().unwrap();
        assert!(Run::read(&file).unwrap().damage.is_none());
    }
}

/// Has a record's summary begin at this place, with the check sum that is right for that.
fn sum_up(bytes: &mut [u8], start: usize) {
    let (begins, sum) = (bytes.len() - 28, bytes.len() - 12);
    bytes[begins..begins + 8].copy_from_slice(&(start as u64).to_le_bytes());
    let right = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes[start..sum]);
    bytes[sum..sum + 4].copy_from_slice(&right.to_le_bytes());
}

#[test]
fn a_summary_that_begins_elsewhere_hides_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let (begins, end) = chunks(&whole);
    let behind = |place: usize| parts(&whole).into_iter().find(|part| part.1 > place).unwrap().1;
    let (results, later) = (behind(*begins.last().unwrap()), behind(end + 13));
    for start in [begins[2], results, end, end + 1, later] {
        let mut bytes = whole.clone();
        sum_up(&mut bytes, start);
        let mut unsummed = bytes.clone();
        let sum = unsummed.len() - 12;
        unsummed[sum..sum + 4].fill(0);
        for bytes in [bytes, unsummed] {
            std::fs::write(&file, &bytes).unwrap();
            let run = Run::read(&file).unwrap();
            assert_eq!((count(&run), run.damage.parts), (all, 0), "{start}: {}", run.damage);
            assert_eq!(run.fact("results", "path_error_rms_mm"), "7.1", "{start}");
            assert!(run.damage.to_string().contains("all rows are there"), "{start}");
            assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64, "{start}");
            assert!(Run::read(&file).unwrap().damage.is_none());
        }
    }
}

#[test]
fn an_index_that_does_not_lead_to_its_part_has_the_summary_written_anew() {
    use mcap::records::op;
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let (begins, end) = chunks(&whole);
    let index = |of: u8| parts(&whole).into_iter().rfind(|part| part.0 == of).unwrap().1 + 9;
    let chunk = index(op::CHUNK_INDEX);
    let [attachment, facts] = [index(op::ATTACHMENT_INDEX), index(op::METADATA_INDEX) + 8];
    // And the length of a channel's name, without which other readers read no summary.
    let places = [chunk + 16, chunk + 24, attachment, facts, index(op::CHANNEL) + 4];
    for place in places {
        for wrong in [0, begins[3] as u64, begins[3] as u64 + 1, u64::MAX] {
            let mut bytes = whole.clone();
            bytes[place..place + 8].copy_from_slice(&wrong.to_le_bytes());
            sum_up(&mut bytes, end + 13);
            std::fs::write(&file, &bytes).unwrap();
            let run = Run::read(&file).unwrap();
            assert_eq!((count(&run), run.damage.parts), (all, 0), "{place}: {}", run.damage);
            assert!(run.damage.to_string().contains("all rows are there"), "{place}: {wrong}");
            assert!(!Run::read_head(&file).unwrap().damage.is_none(), "{place}: {wrong}");
            assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64);
            assert!(Run::read(&file).unwrap().damage.is_none());
        }
    }
}

#[test]
fn an_attached_file_and_facts_that_are_left_out_are_said() {
    use mcap::records::op;
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let end = chunks(&whole).1;
    let first = |of: u8| parts(&whole).into_iter().find(|part| part.0 == of).unwrap();
    let (_, attached, behind) = first(op::ATTACHMENT);
    let facts = first(op::METADATA).1;
    // A bit of its content, its kind and its length; the length of the name of facts, their kind and their length.
    for (place, words) in [
        (behind - 6, "damaged: 1 attached file left out, 1 part"),
        (attached, "damaged: 1 attached file left out, 1 part"),
        (attached + 2, "damaged: 1 attached file left out, 1 part"),
        (facts + 12, "damaged: 1 group of facts left out, 1 part"),
        (facts, "damaged: 1 group of facts left out, 1 part"),
        (facts + 2, "damaged: 1 group of facts left out, 1 part"),
    ] {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x40;
        std::fs::write(&file, &bytes).unwrap();
        let run = Run::read(&file).unwrap();
        assert!(run.damage.to_string().starts_with(words), "{place}: {}", run.damage);
        assert_eq!(count(&run), all, "{place}");
        // Without its end, its kind is known by itself alone.
        if place != attached && place != facts {
            std::fs::write(&file, &bytes[..end]).unwrap();
            let run = Run::read(&file).unwrap();
            let what = words.split(' ').skip(2).take(2).collect::<Vec<_>>().join(" ");
            assert!(run.damage.to_string().contains(&what), "{place}: {}", run.damage);
            assert_eq!(count(&run), all, "{place}");
        }
        std::fs::write(&file, &bytes).unwrap();
        assert_eq!(repair(&file).unwrap().unwrap().rows, all as u64);
        let again = Run::read(&file).unwrap();
        assert!(again.damage.is_none() && again.fact("repair", "damage").starts_with(words));
    }
}

#[test]
fn the_head_of_an_unfinished_record_says_what_it_lacks_without_its_rows() {
    let folder = tempfile::tempdir().unwrap();
    let (file, whole, all) = whole(folder.path());
    let (begins, end) = chunks(&whole);
    let again = [&whole[..end + 13], &whole[begins[0]..begins[1]]].concat();
    for (bytes, has_rows, is_summary_lost) in [
        (&whole[..begins[4] + 500], true, false),
        (&whole[..end], true, false),
        (&whole[..end + 13], true, true),
        (&whole[..whole.len() - 1], true, true),
        (&whole[..begins[0]], false, false),
        (&again, true, false),
    ] {
        std::fs::write(&file, bytes).unwrap();
        let head = Run::read_head(&file).unwrap();
        assert!(count(&head) < all / 3, "{} rows", count(&head));
        let said = (head.is_complete, head.has_rows(), head.damage.is_summary_lost);
        assert_eq!(said, (false, has_rows, is_summary_lost), "{} bytes", bytes.len());
    }
}

#[test]
fn a_file_that_is_no_record_is_never_the_last_run_and_its_name_adds_no_line() {
    let out = tempfile::tempdir().unwrap();
    let run = write_record(out.path());
    let stray = out.path().join(FOLDER).join("new\nline.mcap");
    std::fs::write(&stray, "no record").unwrap();
    assert_eq!(list(out.path()).unwrap().runs.len(), 2);
    let last = Run::find(out.path(), "last").unwrap();
    assert_eq!((last.file, last.newer.len()), (run.clone(), 1));
    let refusal = Run::read(&stray).unwrap_err().to_string();
    assert!(refusal.contains("new?line.mcap") && !refusal.contains('\n'), "{refusal}");
    std::fs::remove_file(run).unwrap();
    assert!(matches!(Run::find(out.path(), "last"), Err(ReadError::NoRuns(_))));
}

/// Lengths that a file states of itself: none may be trusted.
#[test]
fn no_length_in_a_record_lets_its_reader_panic_or_wait() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(folder.path(), 2);
    let whole = std::fs::read(&file).unwrap();
    let judge = |bytes: &[u8], repairs: bool| {
        std::fs::write(&file, bytes).unwrap();
        let read = Run::read(&file).is_ok();
        Run::read_head(&file).unwrap();
        list(folder.path()).unwrap();
        // It waits for the disk.
        let is_read = || matches!(repair(&file), Ok(_) | Err(RepairError::Empty(_)));
        assert!(!repairs || is_read() == read);
        for entry in std::fs::read_dir(file.parent().unwrap()).unwrap() {
            std::fs::remove_file(entry.unwrap().path()).unwrap();
        }
    };
    // A length of 2^64 - 1, and shorter ones, wherever one may stand.
    for at in (0..whole.len() - 8).step_by(101) {
        let mut bytes = whole.clone();
        bytes[at..at + 8 - at % 5].fill(0xff);
        judge(&bytes, at % 8 == 0);
    }
    // Parts of every kind and of every length that is too short, beside others that are whole.
    for kind in 0..=0x10_u8 {
        for filling in [0, 1, 0xff] {
            let mut bytes = whole[..8].to_vec();
            for length in 0..80_u64 {
                bytes.push(kind);
                bytes.extend(length.to_le_bytes());
                bytes.extend(std::iter::repeat_n(filling, length as usize));
            }
            bytes.extend(&whole[8..]);
            judge(&bytes, filling == 1);
        }
    }
}

#[test]
fn a_record_that_others_compressed_is_not_called_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let whole = std::fs::read(&file).unwrap();
    for name in ["zstd", "lz4"] {
        let mut chunk = [0_u8; 28].to_vec();
        chunk.extend((name.len() as u32).to_le_bytes());
        chunk.extend(name.as_bytes());
        chunk.extend(9_u64.to_le_bytes());
        chunk.extend([0xab; 9]);
        let length = (chunk.len() as u64).to_le_bytes();
        let prefix = [&whole[..8], &[mcap::records::op::CHUNK], &length].concat();
        let bytes = [&prefix[..], &chunk, &whole[8..]].concat();
        std::fs::write(&file, &bytes).unwrap();
        let words = format!("compressed it ({name}): `mcap decompress`");
        for refusal in
            [Run::read(&file).unwrap_err().to_string(), repair(&file).unwrap_err().to_string()]
        {
            assert!(refusal.contains(&words), "{refusal}");
        }
        assert_eq!(std::fs::read(&file).unwrap(), bytes);
    }
}

#[test]
#[cfg(unix)]
fn a_repair_follows_no_link() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() * 2 / 3]).unwrap();
    let precious = folder.path().join("precious");
    std::fs::write(&precious, "kept").unwrap();
    for planted in ["mcap.part", "mcap.original"] {
        symlink(&precious, file.with_extension(planted)).unwrap();
    }
    repair(&file).unwrap().unwrap();
    assert_eq!(std::fs::read_to_string(&precious).unwrap(), "kept");
    assert!(Run::read(&file).unwrap().is_complete);
    // Neither the record itself: what it leads to stays as it is.
    let away = folder.path().join("away");
    std::fs::write(&away, &whole[..whole.len() * 2 / 3]).unwrap();
    let link = file.with_file_name("link.mcap");
    symlink(&away, &link).unwrap();
    assert!(matches!(repair(&link), Err(RepairError::Link(_))));
    assert!(link.is_symlink() && std::fs::read(&away).unwrap().len() == whole.len() * 2 / 3);
}

#[test]
fn a_computer_whose_clock_is_not_set_records_too() {
    let folder = tempfile::tempdir().unwrap();
    for (started, begins) in [
        (UNIX_EPOCH - Duration::from_secs(9), "19700101-000000-"),
        (UNIX_EPOCH, "19700101-000000-"),
        (UNIX_EPOCH + Duration::from_secs(300_000_000_000), "99991231-235959-"),
    ] {
        let description = RunDescription { name: "drive".into(), ..Default::default() };
        let mut recorder = Recorder::create(folder.path(), started, &description).unwrap();
        recorder.pose(&sample(1.0)).unwrap();
        let file = recorder.finish().unwrap();
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        assert!(name.starts_with(begins), "{name}");
        assert_eq!(Run::read(&file).unwrap().poses.len(), 1);
    }
}

/// What the readers of Foxglove and Lichtblick make of a schema, by which one field they cannot read drops a whole topic: each has
/// one type, by its name; an object has fields, or is a table of any names; an array has items of one type.
fn refused(schema: &serde_json::Value, path: &str) -> Vec<String> {
    match schema["type"].as_str() {
        Some("boolean" | "number" | "integer") => Vec::new(),
        Some("string") => match schema.get("contentEncoding").map(|it| it.as_str()) {
            None | Some(Some("base64")) => Vec::new(),
            other => vec![format!("{path}: content encoding {other:?}")],
        },
        Some("object") => {
            let fields = schema["properties"].as_object().into_iter().flatten();
            fields.flat_map(|(name, field)| refused(field, &format!("{path}.{name}"))).collect()
        }
        Some("array") => refused(&schema["items"], &format!("{path}[]")),
        _ => vec![format!("{path}: type {}", schema["type"])],
    }
}

/// Returns the values of a row that its schema does not allow.
fn mismatches(value: &serde_json::Value, schema: &serde_json::Value, path: &str) -> Vec<String> {
    let fits = match schema["type"].as_str() {
        Some("boolean") => value.is_boolean(),
        Some("string") => value.is_string(),
        Some("number") => value.is_number(),
        Some("integer") => value.is_i64() || value.is_u64(),
        Some("object") => value.is_object(),
        Some("array") => value.is_array(),
        _ => false,
    };
    if !fits {
        return vec![format!("{path}: {value} is no {}", schema["type"])];
    }
    if let Some(items) = value.as_array() {
        return items.iter().flat_map(|it| mismatches(it, &schema["items"], path)).collect();
    }
    let fields = value.as_object().into_iter().flatten();
    let of = |(name, field)| {
        let path = format!("{path}.{name}");
        match [&schema["properties"][name], &schema["additionalProperties"]]
            .into_iter()
            .find(|schema| schema.is_object())
        {
            Some(schema) => mismatches(field, schema, &path),
            None => vec![format!("{path} is not in the schema")],
        }
    };
    fields.flat_map(of).collect()
}

#[test]
fn every_schema_is_one_that_viewers_read() {
    let kinds = ["string", "null"];
    let two = serde_json::json!({"type": "object", "properties": {"a": {"type": kinds}}});
    assert_eq!(refused(&two, "").len(), 1);
    for channel in &CHANNELS {
        let schema: serde_json::Value = serde_json::from_str(channel.text).unwrap();
        assert_eq!(refused(&schema, channel.topic), [""; 0]);
    }
}

#[test]
fn every_row_is_what_its_schema_says() {
    let folder = tempfile::tempdir().unwrap();
    let description = RunDescription {
        name: "absent".into(),
        run: BTreeMap::new(),
        settings: BTreeMap::new(),
        versions: BTreeMap::new(),
    };
    // A robot that measures no voltage, and has neither a fault nor a memory of a command.
    let mut recorder = Recorder::create(folder.path(), started(), &description).unwrap();
    let bare = Telemetry {
        first_fault: None,
        bus_voltage: None,
        bus_voltage_range: None,
        ..telemetry(0.0)
    };
    recorder.telemetry(at(0.0), &bare).unwrap();
    let files = [write_record(folder.path()), recorder.finish().unwrap()];
    let mut topics = BTreeSet::new();
    for file in files {
        let bytes = std::fs::read(file).unwrap();
        for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
            let schema = serde_json::from_slice(&message.channel.schema.as_ref().unwrap().data);
            let row = serde_json::from_slice(&message.data).unwrap();
            let topic = &message.channel.topic;
            assert_eq!(mismatches(&row, &schema.unwrap(), topic), [""; 0], "{row}");
            topics.insert(topic.clone());
        }
    }
    assert!(topics.len() >= 5, "{topics:?}");
}

#[test]
fn the_layout_for_foxglove_shows_what_records_have() {
    let layout: serde_json::Value =
        serde_json::from_str(include_str!("../docs/foxglove-layout.json")).unwrap();
    let panels = layout["configById"].as_object().unwrap();
    let paths: Vec<String> = panels.values().flat_map(shown).collect();
    assert!(paths.len() > 10, "{paths:?}");
    for path in &paths {
        let mut words = path.split('.');
        let topic = words.next().unwrap();
        let channel = CHANNELS.iter().find(|channel| channel.topic == topic);
        let channel = channel.unwrap_or_else(|| panic!("no record has {topic}"));
        let mut schema: serde_json::Value = serde_json::from_str(channel.text).unwrap();
        for word in words {
            schema = schema["properties"][word].clone();
            assert!(schema.is_object(), "{path}: no row has {word}");
        }
    }
    let arranged = layout["layout"].to_string();
    for name in panels.keys() {
        assert!(arranged.contains(&format!("\"{name}\"")), "{name} has no place");
    }
}
