//! Records that somebody else made: whatever they hold, `flix runs` ends with a sentence, and never with a panic.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

use crate::walked::{at, started, write_record_of};
use flix_host::record::{Level, Recorder, RunDescription};

/// Floating-point numbers at the ends of what there is.
const EXTREMES: [f64; 8] =
    [f64::MAX, f64::MIN, 5e-324, 0.0, -0.0, 1e300, f64::MIN_POSITIVE, -1e-300];
/// Whole numbers at the ends of what rows have.
const WHOLE: [u64; 4] = [0, u32::MAX as u64, 1, u64::MAX];

/// Replaces the numbers of a row; `turn` picks by which.
fn distort(value: &mut Value, turn: &mut usize) {
    match value {
        Value::Number(number) => {
            *turn += 1;
            *value = if number.is_f64() {
                json!(EXTREMES[*turn % EXTREMES.len()])
            } else {
                json!(WHOLE[*turn % 2])
            };
        }
        Value::Array(items) => items.iter_mut().for_each(|item| distort(item, turn)),
        Value::Object(fields) => fields.values_mut().for_each(|field| distort(field, turn)),
        _ => {}
    }
}

/// Writes the rows of a record into another, each changed.
fn write_changed(from: &Path, to: &Path, mut change: impl FnMut(usize, &mut Value)) {
    let bytes = std::fs::read(from).unwrap();
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(std::io::BufWriter::new(std::fs::File::create(to).unwrap()))
        .unwrap();
    let mut channels = BTreeMap::new();
    for (number, message) in mcap::MessageStream::new(&bytes).unwrap().enumerate() {
        let message = message.unwrap();
        let topic = message.channel.topic.clone();
        let id = *channels
            .entry(topic.clone())
            .or_insert_with(|| writer.add_channel(0, &topic, "json", &BTreeMap::new()).unwrap());
        let mut row = serde_json::from_slice(&message.data).unwrap();
        change(number, &mut row);
        let time = WHOLE[number % WHOLE.len()];
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, row.to_string().as_bytes()).unwrap();
    }
    writer.finish().unwrap();
}

fn flix(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_flix")).args(words).output().unwrap()
}

fn judge(file: &Path, tables: &Path) {
    let file = file.to_str().unwrap();
    let tables = tables.to_str().unwrap();
    for words in [
        &["runs", "show", file][..],
        &["runs", "show", file, "--json"],
        &["runs", "plot", file, "--to", tables],
        &["runs", "export-csv", file, "--to", tables],
        &["runs", "repair", file],
    ] {
        let Output { status, stderr, .. } = flix(words);
        let stderr = String::from_utf8_lossy(&stderr);
        let is_end = matches!(status.code(), Some(0 | 2));
        assert!(is_end && !stderr.contains("panicked"), "{words:?}: {status}, {stderr}");
    }
}

#[test]
fn rows_with_numbers_without_measure_are_shown_plotted_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let good = write_record_of(folder.path(), 6);
    let (bad, tables) = (folder.path().join("bad.mcap"), folder.path().join("tables"));
    for start in 0..EXTREMES.len() {
        let mut turn = start;
        write_changed(&good, &bad, |_, row| distort(row, &mut turn));
        judge(&bad, &tables);
        // One number in all rows: a range of nothing, or of the least there is.
        let mut rows = 0;
        write_changed(&good, &bad, |_, row| {
            rows += 1;
            let mut turn = start * usize::from(rows % 2 == 0);
            distort_alike(row, &mut turn);
        });
        judge(&bad, &tables);
    }
}

/// Replaces all floating-point numbers of a row by one.
fn distort_alike(value: &mut Value, turn: &mut usize) {
    match value {
        Value::Number(number) if number.is_f64() => {
            *value = json!(EXTREMES[(*turn + 2) % EXTREMES.len()])
        }
        Value::Array(items) => items.iter_mut().for_each(|item| distort_alike(item, turn)),
        Value::Object(fields) => fields.values_mut().for_each(|it| distort_alike(it, turn)),
        _ => {}
    }
}

#[test]
fn lengths_without_measure_end_no_command_with_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let whole = std::fs::read(write_record_of(folder.path(), 2)).unwrap();
    let (bad, tables) = (folder.path().join("bad.mcap"), folder.path().join("tables"));
    // An attachment that ends before its check sum, and one that says it is 2^64 - 1 bytes long.
    for (length, data) in [(32_u64, 0_u64), (34, 0), (36, u64::MAX), (36, u64::MAX - 35)] {
        let mut bytes = whole[..8].to_vec();
        bytes.push(mcap::records::op::ATTACHMENT);
        bytes.extend(length.to_le_bytes());
        let body = [&[0; 24][..], &data.to_le_bytes(), &[0; 8]].concat();
        bytes.extend(&body[..length as usize]);
        bytes.extend(&whole[8..]);
        std::fs::write(&bad, &bytes).unwrap();
        judge(&bad, &tables);
    }
}

#[cfg(unix)]
#[test]
fn where_files_may_not_be_long_a_copy_ends_with_a_sentence_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let record = write_record_of(folder.path(), 2000);
    let whole = std::fs::read(&record).unwrap();
    std::fs::write(&record, &whole[..whole.len() - 100]).unwrap();
    let (tables, file) = (folder.path().join("tables"), record.to_str().unwrap());
    for words in [
        ["runs", "repair", file].as_slice(),
        &["runs", "export-csv", file, "--to", tables.to_str().unwrap()],
        &["runs", "plot", file, "--to", tables.to_str().unwrap()],
    ] {
        let limited = ["-c", "ulimit -f 4; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_flix")];
        let output = Command::new("bash").args(limited).args(words).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {said}");
        assert!(said.contains("File too large"), "{words:?}: {said}");
    }
    let folders = [folder.path(), &tables].map(|folder| std::fs::read_dir(folder).unwrap());
    let left: Vec<_> = folders.into_iter().flatten().map(|it| it.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().ends_with(".part")), "{left:?}");
    assert_eq!(std::fs::read(&record).unwrap().len(), whole.len() - 100);
}

#[test]
fn a_repair_says_what_is_wrong_and_keeps_the_file_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(folder.path(), 30);
    let whole = std::fs::read(&file).unwrap();
    let place = |what: &[u8]| whole.windows(what.len()).position(|it| it == what).unwrap();
    // A setting, which has no check sum of its own; a row; and the end.
    let (mut changed, mut damaged) = (whole.clone(), whole.clone());
    changed[place(b"20ms")] = b'9';
    damaged[place(b"{\"")] = b'[';
    let cut = whole[..whole.len() * 2 / 3].to_vec();
    for (bytes, words) in
        [(changed, "changed since it was written"), (damaged, " left out, "), (cut, "as it was: ")]
    {
        std::fs::write(&file, &bytes).unwrap();
        let Output { status, stderr, .. } = flix(&["runs", "repair", file.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&stderr);
        assert!(status.success() && said.contains(words), "{words}: {said}");
        let original = file.with_extension("mcap.original");
        assert_eq!(std::fs::read(&original).unwrap(), bytes, "{words}");
        std::fs::remove_file(original).unwrap();
    }
}

#[test]
fn every_command_says_on_one_line_that_a_record_has_no_end() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(folder.path(), 30);
    let whole = std::fs::read(&file).unwrap();
    for (length, words) in
        [(whole.len() * 2 / 3, ": unfinished: `flix runs repair`"), (whole.len() - 9, ": all rows")]
    {
        std::fs::write(&file, &whole[..length]).unwrap();
        for command in ["show", "plot", "export-csv", "export-ros2"] {
            let Output { status, stderr, .. } = flix(&["runs", command, file.to_str().unwrap()]);
            let said = String::from_utf8_lossy(&stderr);
            assert!(status.success() && said.contains(words), "{command}: {said}");
            assert_eq!(said.lines().count(), 1, "{command}: {said}");
        }
    }
}

#[test]
fn a_record_that_cannot_be_read_hides_no_other_from_the_list() {
    let out = tempfile::tempdir().unwrap();
    let runs = out.path().join("runs");
    let file = write_record_of(out.path(), 6);
    let mut bytes = std::fs::read(&file).unwrap();
    // As long as a chunk's header, behind its first rows: rows that are said to be compressed.
    let header = [&[0; 28][..], &4_u32.to_le_bytes(), b"zstd", &[0; 8]].concat();
    let chunk = [&[mcap::records::op::CHUNK][..], &44_u64.to_le_bytes(), &header].concat();
    let footer = bytes.len() - 37;
    let end = u64::from_le_bytes(bytes[footer + 9..footer + 17].try_into().unwrap()) as usize - 13;
    bytes.truncate(end);
    bytes.extend(chunk);
    std::fs::write(runs.join("compressed.mcap"), bytes).unwrap();
    let Output { status, stdout, stderr, .. } =
        flix(&["runs", "list", "--out", out.path().to_str().unwrap()]);
    let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    let stem = file.file_stem().unwrap().to_str().unwrap();
    assert!(status.success() && stdout.contains(stem), "{stdout}{stderr}");
    assert!(stderr.contains("mcap decompress") && stderr.contains("skipped"), "{stderr}");
}

/// Asks `flix runs` in a folder; returns whether all went well, and both of what it says.
fn ask(folder: &Path, words: &[&str]) -> (bool, String, String) {
    let flix = env!("CARGO_BIN_EXE_flix");
    let Output { status, stdout, stderr } =
        Command::new(flix).arg("runs").args(words).current_dir(folder).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    (status.success(), text(stdout), text(stderr))
}

#[test]
fn last_is_a_word_and_a_folder_no_record() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(&folder.path().join("out"), 6);
    let stem = file.file_stem().unwrap().to_str().unwrap();
    // As `runs export-csv RUN --to RUN` leaves one.
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at(stem)).unwrap();
    std::fs::create_dir(at("last")).unwrap();
    let judge = |name: &str| {
        let (is_well, shown, said) = ask(folder.path(), &["show", name]);
        assert!(is_well && shown.contains(stem) && said.is_empty(), "{name}: {shown}{said}");
    };
    judge(stem);
    judge("last");
    std::fs::remove_dir(at("last")).unwrap();
    std::fs::write(at("last"), "no record").unwrap();
    judge("last");
    // Whoever means the file writes so; a folder that no run is named as is said to be one.
    for (name, words) in [("./last", "not a record"), ("out", "it is a directory")] {
        let (is_well, _, said) = ask(folder.path(), &["show", name]);
        assert!(!is_well && said.contains(words), "{name}: {said}");
    }
}

#[test]
fn a_record_that_the_list_skips_is_named_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(&folder.path().join("out"), 6);
    let whole = std::fs::read(&file).unwrap();
    let stem = file.file_stem().unwrap().to_str().unwrap();
    // In the place of the rows, some that began at this time, and that another program has compressed.
    let compress = |nanos: u64| {
        let header = [&nanos.to_le_bytes()[..], &[0; 20], &4_u32.to_le_bytes(), b"zstd", &[0; 8]];
        let chunk = [&[mcap::records::op::CHUNK][..], &44_u64.to_le_bytes(), &header.concat()];
        let bytes = [&whole[..8], &chunk.concat(), &whole[8..]].concat();
        std::fs::write(file.with_file_name("packed.mcap"), bytes).unwrap();
    };
    let began = started().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64;
    compress(began + 1_000_000_000);
    for command in ["show", "repair", "plot", "export-csv", "export-ros2"] {
        for name in ["packed", "pack"] {
            let (is_well, _, said) = ask(folder.path(), &[command, name]);
            assert!(!is_well && said.contains("mcap decompress"), "{command} {name}: {said}");
        }
        // The last that can be read, and that it is not the newest.
        let (is_well, _, said) = ask(folder.path(), &[command, "last"]);
        assert!(is_well && said.contains("mcap decompress"), "{command}: {said}");
        let (_, shown, _) = ask(folder.path(), &["show", "last"]);
        assert!(shown.contains(stem), "{command}: {shown}");
    }
    // An older one is not the last.
    compress(began - 1_000_000_000);
    let (is_well, _, said) = ask(folder.path(), &["show", "last"]);
    assert!(is_well && said.is_empty(), "{said}");
    std::fs::remove_file(&file).unwrap();
    let (is_well, _, said) = ask(folder.path(), &["show", "last"]);
    assert!(!is_well && said.contains("mcap decompress"), "{said}");
}

#[test]
#[cfg(target_os = "linux")]
fn the_list_takes_no_memory_for_the_rows_of_an_unfinished_record() {
    use std::io::Write as _;
    let folder = tempfile::tempdir().unwrap();
    let file = write_record_of(&folder.path().join("out"), 400);
    let whole = std::fs::read(&file).unwrap();
    let next = |at: &usize| {
        let length = whole.get(at + 1..at + 9)?.try_into().unwrap();
        Some(at + 9 + u64::from_le_bytes(length) as usize)
    };
    let is_data = |at: &usize| whole[*at] != mcap::records::op::DATA_END;
    let places: Vec<_> = std::iter::successors(Some(8), next).take_while(is_data).collect();
    let chunks: Vec<_> =
        places.iter().copied().filter(|at| whole[*at] == mcap::records::op::CHUNK).collect();
    let (first, end) = (chunks[0], next(places.last().unwrap()).unwrap());
    let mut target = std::io::BufWriter::new(std::fs::File::create(&file).unwrap());
    target.write_all(&whole[..first]).unwrap();
    // 120 MB of rows.
    for turn in 0..(120 << 20) / (end - first) as u64 {
        let mut rows = whole[first..end].to_vec();
        // Another time in each header: what stands there again is no row.
        for chunk in &chunks {
            rows[chunk - first + 9..][..8].copy_from_slice(&turn.to_le_bytes());
        }
        target.write_all(&rows).unwrap();
    }
    target.into_inner().unwrap();
    let limited = "ulimit -v 80000; exec \"$0\" runs list";
    let Output { status, stdout, stderr } = Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_flix")])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let (shown, said) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    let word = "unfinished: `flix runs repair` completes";
    assert!(status.success() && shown.contains(word), "{status}: {shown}{said}");
}

#[test]
fn figures_and_tables_beside_a_record_follow_no_link() {
    let out = tempfile::tempdir().unwrap();
    let record = write_record_of(out.path(), 6);
    let victim = out.path().join("victim");
    std::fs::write(&victim, "precious").unwrap();
    let run = |words: &str| {
        let Output { status, stdout, .. } = flix(&["runs", words, record.to_str().unwrap()]);
        assert!(status.success());
        String::from_utf8(stdout).unwrap()
    };
    let written = ["plot", "export-csv"].map(run).concat();
    for file in written.lines() {
        std::fs::remove_file(file).unwrap();
        std::os::unix::fs::symlink(&victim, file).unwrap();
    }
    assert_eq!(["plot", "export-csv"].map(run).concat(), written);
    assert_eq!(std::fs::read_to_string(victim).unwrap(), "precious");
}

#[test]
fn what_a_record_holds_adds_no_line_of_its_own() {
    let out = tempfile::tempdir().unwrap();
    let hostile = "all is well\r\nflix: forged".to_owned();
    let facts = BTreeMap::from([(hostile.clone(), hostile.clone())]);
    let description = RunDescription {
        name: "forged".into(),
        run: facts.clone(),
        settings: facts.clone(),
        versions: facts,
    };
    let mut recorder = Recorder::create(out.path(), started(), &description).unwrap();
    recorder.attach(at(0.0), &hostile, "text/plain", b"").unwrap();
    recorder.log(at(0.0), Level::Warning, &hostile).unwrap();
    let file = recorder.finish().unwrap();
    let Output { status, stdout, .. } = flix(&["runs", "show", file.to_str().unwrap()]);
    let shown = String::from_utf8(stdout).unwrap();
    assert!(status.success() && shown.contains("all is well??flix: forged"), "{shown}");
    assert!(!shown.contains("\nflix: forged"), "{shown}");
}
