//! Promises of `flix-sim` as it is typed.

use std::path::Path;
use std::process::{Command, Output, Stdio};

fn flix_sim(folder: &Path, words: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flix-sim"));
    command.current_dir(folder).args(words.split(' '));
    command
}

fn study(folder: &Path, words: &str) -> Output {
    flix_sim(folder, &format!("study {words}"))
        .output()
        .expect("cargo built the program that it tests")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn table_3_is_told_as_json_with_a_count_of_signs_and_hits_for_each_of_nine_modes() {
    let folder = tempfile::tempdir().unwrap();
    let words =
        "mobility --table3 --model W --seeds 2 --first-seed 9 --seconds 0.1 --step 0.5ms --json";
    let output = study(folder.path(), words);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 9);
    for row in rows {
        let count = |key: &str| row[key].as_u64().unwrap();
        assert!(count("seeds") == 2 && count("hits") <= count("signs") && count("signs") <= 2);
        assert!(row["strict"].is_boolean(), "{row}");
        let turns = row["mode"].as_str().is_some_and(|name| !name.starts_with(['f', 's']));
        assert!(row["keeps_heading"].is_null() == turns, "{row}");
        for key in ["f_hz", "theta_deg", "forward_m_s", "lateral_m_s", "yaw_rad_s"] {
            assert!(row[key].is_f64(), "{key} of {row}");
        }
    }
    assert_eq!(
        (&rows[8]["mode"], &rows[8]["theta_deg"]),
        (&"strafe-right".into(), &(-60.0).into())
    );
}

#[test]
fn one_walk_has_no_spread_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let spread = |seeds: u8| {
        let words = format!(
            "walk --model W --frequency -30 --direction 30 --seeds {seeds} --seconds 0.1 --json"
        );
        let output = flix_sim(folder.path(), &words).output().unwrap();
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        report["forward_m_s"]["spread"].clone()
    };
    assert!(spread(1).is_null() && spread(2).as_f64().is_some_and(|it| it > 0.0));
}

#[test]
fn merged_slices_draw_the_figure_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    for slice in ["1/3", "2/3", "3/3"] {
        let output = study(folder.path(), &format!("mobility --quick --out all --shard {slice}"));
        assert!(output.status.success(), "{}", said(&output));
    }
    let files = "all/results-1-of-3.parquet all/results-2-of-3.parquet all/results-3-of-3.parquet";
    assert!(study(folder.path(), &format!("merge {files}")).status.success());
    assert!(study(folder.path(), "mobility --quick --out whole").status.success());
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("all/mobility.svg"), read("whole/mobility.svg"));
}

#[test]
fn a_slice_of_another_study_is_refused_as_a_wrong_file() {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path(), "mobility --quick --out a --shard 1/2");
    study(folder.path(), "mobility --quick --out b --shard 2/2 --first-seed 2");
    let output = study(folder.path(), "merge a/results-1-of-2.parquet b/results-2-of-2.parquet");
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("b/results-2-of-2.parquet is a shard of mobility"));
}

#[test]
fn a_bad_number_of_a_laboratory_is_named_with_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let table = "f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s\n30,0,0.1,0,nan\n";
    std::fs::write(folder.path().join("lab.csv"), table).unwrap();
    let output = study(folder.path(), "calibrate --measured lab.csv");
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("lab.csv, line 2, column 5: \"nan\""), "{}", said(&output));
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = flix_sim(folder.path(), "export-mjcf --model A");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
}

/// Follows a circle with this program, as JSON; `controller.sh` is a script with these lines.
fn track_with(process: &str, script: &str) -> (Option<i32>, serde_json::Value, String) {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("controller.sh"), script).expect("a script");
    let mut command = flix_sim(folder.path(), "track circle --radius 0.3 --laps 1 --json");
    let output = command.args(["--controller-process", process]).output().expect("flix-sim runs");
    let report = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code(), report, said(&output))
}

#[test]
fn the_controller_of_the_guide_follows_a_path() {
    let process = concat!("python3 '", env!("CARGO_MANIFEST_DIR"), "/../examples/follow.py'");
    let (code, report, said) = track_with(process, "");
    assert_eq!((code, &report["finished"]), (Some(0), &true.into()), "{report} {said}");
    assert!(report["path_error_rms_mm"].as_f64().is_some_and(|error| error < 60.0), "{report}");
    assert_eq!(report["controller"], process);
}

#[test]
fn a_controller_that_hangs_dies_or_talks_nonsense_stops_the_robot_with_a_sentence() {
    let answers = |answer: &str| format!("while read pose; do echo '{answer}'; done");
    for (then, sentence) in [
        ("exec sleep 3600".to_owned(), "did not answer within 2 s"),
        ("read pose; echo '{\"f\":-30,\"theta\":30}'".to_owned(), "the controller process ended"),
        (answers("forward!"), "answered `forward!`"),
        (answers(""), "answered ``"),
        (answers(r#"{"f":99,"theta":30}"#), "-35"),
        (answers(r#"{"f":-30}"#), "theta"),
        (answers(r#"{"f":-30,"theta":30,"speed":1}"#), "speed"),
        (r#"while :; do echo '{"f":-30,"theta":30}'; done"#.to_owned(), "before it was asked"),
        ("exec cat /dev/zero".to_owned(), "before it was asked"),
    ] {
        let (code, report, said) =
            track_with("cd . && sh controller.sh", &format!("read path\necho ready\n{then}\n"));
        let ending = report["ending"].as_str().unwrap_or_default();
        assert!(code == Some(1) && ending.contains(sentence), "{then}: {code:?} {report} {said}");
    }
}

#[test]
fn a_run_that_takes_too_long_says_so() {
    let folder = tempfile::tempdir().unwrap();
    for words in ["track circle --patience 3s --json", "home --pushes 1 --patience 2s --json"] {
        let output = flix_sim(folder.path(), words).output().unwrap();
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let ending = report["ending"].as_str().unwrap();
        assert!(ending.contains("not done within"), "{words}: {ending}");
        assert_eq!(output.status.code(), Some(1), "{words}");
    }
}

#[test]
fn pushes_are_not_errors_of_the_robot_in_the_record_of_home() {
    let folder = tempfile::tempdir().unwrap();
    let output = flix_sim(folder.path(), "home --pushes 1 --json").output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let run = flix_host::record::Run::find(&folder.path().join("out"), "last").unwrap();
    assert_eq!(run.fact("results", "path_error_rms_mm"), "");
    let final_error: f64 = run.fact("results", "final_error_mm").parse().unwrap();
    assert!(final_error < 50.0, "{final_error} mm");
}

#[test]
fn a_study_is_kept_in_a_folder_that_names_its_model_and_walks() {
    let folder = tempfile::tempdir().unwrap();
    assert!(study(folder.path(), "mobility --quick --model A").status.success());
    let kept = std::fs::read_dir(folder.path().join("out/study/mobility")).unwrap();
    let names: Vec<_> = kept.map(|it| it.unwrap().file_name().into_string().unwrap()).collect();
    assert!(names.len() == 1 && names[0].starts_with("A-1x0.5s-"), "{names:?}");
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    assert!(flix_sim(folder.path(), "man pages").status().unwrap().success());
    for name in ["flix-sim.1", "flix-sim-serve.1", "flix-sim-study-mobility.1"] {
        assert!(folder.path().join("pages").join(name).exists(), "{name}");
    }
}
