use std::collections::BTreeMap;
use std::path::{Path as FilePath, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use flix_protocol::message::{
    Dropped, Event, EventReport, Fault, Faults, LinkQuality, MotorTelemetry, OperatorName,
    Setpoint, State, Telemetry,
};
use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Ratio, Volts};

use super::*;
use crate::nav::{Path, PlanarPose, Progress};
use crate::plot::Figure;
use crate::pose::{Pose, PoseSample};

fn started() -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_795_244_400)
}

fn at(seconds: f64) -> Instant {
    Instant::from_micros((seconds * 1e6) as u64)
}

pub(crate) fn telemetry(seconds: f64) -> Telemetry {
    let motor = MotorTelemetry {
        angle: Degrees::saturating(10.0),
        speed: Hertz::saturating(30.0),
        current_d: Amperes::saturating(0.01),
        current_q: Amperes::saturating(0.5 + 0.1 * (seconds * 3.0).sin() as f32),
    };
    Telemetry {
        time: at(seconds),
        state: State::Running,
        faults: Faults::NONE.with(Fault::Stall),
        first_fault: Some(Fault::Stall),
        stopped: false,
        link_late: false,
        stopped_by: None,
        setpoint: forward(),
        frequency: Hertz::saturating(-29.9),
        direction: Degrees::saturating(30.2),
        motors: [motor; 2],
        bus_voltage: Some(Volts::saturating(11.8)),
        modulation: Ratio::saturating(0.7),
        timing: Default::default(),
        link: LinkQuality {
            dropped: Dropped { forged: 3, ..Default::default() },
            ..Default::default()
        },
        operator: OperatorName::OWNER,
    }
}

fn forward() -> Setpoint {
    Setpoint::new(Hertz::saturating(-30.0), Degrees::saturating(30.0)).unwrap()
}

fn sample(seconds: f64) -> PoseSample {
    let angle = seconds * 0.2;
    let pose = PlanarPose {
        x: 0.5 * angle.cos(),
        y: 0.5 * angle.sin(),
        heading: angle + std::f64::consts::FRAC_PI_2,
    };
    PoseSample { time: at(seconds), pose: Pose::planar(pose, 0.057), valid: true, picture: None }
}

/// A record of 30 s on a circle in `folder`.
fn write_record(folder: &FilePath) -> PathBuf {
    let description = RunDescription {
        name: "track circle".into(),
        run: BTreeMap::from([("robot".into(), "walker-1".into())]),
        settings: BTreeMap::from([("latency".into(), "20ms".into())]),
        versions: BTreeMap::from([("flix".into(), "0.1.0".into())]),
    };
    let mut recorder = Recorder::create(folder, started(), &description).unwrap();
    recorder.path_to_follow(at(0.0), &Path::circle(0.5).unwrap()).unwrap();
    recorder.attach(at(0.0), "modes.toml", "application/toml", b"[[mode]]").unwrap();
    for step in 0..600 {
        let seconds = f64::from(step) * 0.05;
        let sample = sample(seconds);
        recorder.pose(&sample).unwrap();
        recorder.command(at(seconds), &forward(), "forward").unwrap();
        recorder.telemetry(at(seconds), &telemetry(seconds)).unwrap();
        let progress =
            Progress { error: 0.01 * seconds.sin(), error_rms: 0.007, ..Progress::default() };
        recorder.navigation(at(seconds), &sample.pose.on_the_floor(), &progress).unwrap();
    }
    let fault = EventReport { number: 1, time: at(29.0), event: Event::Fault(Fault::Stall) };
    recorder.event(at(29.5), &fault).unwrap();
    recorder.results(BTreeMap::from([("path_error_rms_mm".into(), "7.1".into())])).unwrap();
    recorder.finish().unwrap()
}

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
    std::fs::write(&file, &whole[..whole.len() * 2 / 3]).unwrap();
    let before = Run::read(&file).unwrap();
    assert!(!before.is_complete && mcap::Summary::read(&std::fs::read(&file).unwrap()).is_err());
    let rows = repair(&file).unwrap().unwrap();
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
    let mut skipped: Vec<_> = found.skipped.iter().map(ToString::to_string).collect();
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

#[test]
fn a_run_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::read(&write_record(folder.path())).unwrap();
    let out = std::env::var("FLIX_PLOT_OUT").map_or(folder.path().to_owned(), PathBuf::from);
    figures::track(&run).write(&out, "run-track").unwrap();
    let timeline = figures::timeline(&run);
    timeline.write(&out, "run-timeline").unwrap();
    let svg = timeline.svg();
    for label in ["Heading", "Current q", "commanded", "held", "walker-1"] {
        assert!(svg.contains(label), "{label}");
    }
}

#[test]
fn start_and_end_of_a_track_are_named_in_its_legend() {
    let folder = tempfile::tempdir().unwrap();
    let svg = figures::track(&Run::read(&write_record(folder.path())).unwrap()).svg();
    assert!(svg.contains(">start<") && svg.contains(">end<"));
}

#[test]
fn the_approach_is_marked_in_the_error_as_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::read(&write_record(folder.path())).unwrap();
    let said = "shaded: approach, not counted";
    assert!(!figures::timeline(&run).svg().contains(said), "it began on its path");
    for row in &mut run.navigation[..200] {
        (row.error_m, row.error_rms_m) = (0.08, 0.0);
    }
    let svg = figures::timeline(&run).svg();
    assert!(svg.contains(said) && svg.contains(">approach<"));
}

/// An independent reader: the `mcap` package of PyPI. Missing, the test says so and passes, unless
/// `FLIX_REQUIRE_PYTHON_MCAP` is set, as continuous integration does after installing it.
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
    let has_mcap = Command::new("python3").args(["-c", "import mcap"]).output();
    if !has_mcap.is_ok_and(|output| output.status.success()) {
        assert!(
            std::env::var_os("FLIX_REQUIRE_PYTHON_MCAP").is_none(),
            "python3 with the package mcap is required here: pip install mcap"
        );
        eprintln!("skipped: python3 has no package mcap (pip install mcap)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = write_record(folder.path());
    let output = Command::new("python3").args(["-c", SCRIPT]).arg(&file).output().unwrap();
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

#[test]
fn the_layout_for_foxglove_shows_what_records_have() {
    let layout: serde_json::Value =
        serde_json::from_str(include_str!("../../docs/foxglove-layout.json")).unwrap();
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
