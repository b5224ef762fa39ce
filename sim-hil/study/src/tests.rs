use std::sync::atomic::{AtomicUsize, Ordering};

use flix_sim::study::Column;

use super::*;

/// Squares of the cells' numbers, counted, failing from one cell on when asked to.
struct Squares {
    cells: usize,
    scale: f64,
    computed: AtomicUsize,
    interrupt_after: usize,
    interrupt: Interrupt,
}

impl Squares {
    fn new(cells: usize) -> Self {
        Self {
            cells,
            scale: 1.0,
            computed: AtomicUsize::new(0),
            interrupt_after: usize::MAX,
            interrupt: Interrupt::never(),
        }
    }
}

impl Study for Squares {
    fn name(&self) -> &'static str {
        "squares"
    }
    fn label(&self) -> String {
        "squares".to_owned()
    }

    fn parameters(&self) -> serde_json::Value {
        serde_json::json!({ "scale": self.scale })
    }
    fn columns(&self) -> Vec<Column> {
        vec![Column::whole("root"), Column::text("parity"), Column::number("square")]
    }
    fn cells(&self) -> usize {
        self.cells
    }
    fn batch(&self) -> usize {
        3
    }
    fn asked(&self, cell: usize) -> Row {
        vec![(u64::MAX - cell as u64).into()]
    }
    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
        if self.computed.fetch_add(cells.len(), Ordering::SeqCst) >= self.interrupt_after {
            self.interrupt.raise();
        }
        let each = cells.iter().map(|&cell| {
            let parity = if cell % 2 == 0 { "even, \"so\"" } else { "odd" };
            Ok(vec![parity.into(), (self.scale * (cell * cell) as f64 / 3.0).into()])
        });
        each.collect()
    }
}

fn options(folder: &Path, shard: &str) -> Options {
    Options {
        folder: folder.to_owned(),
        shard: shard.parse().unwrap(),
        earlier: Earlier::Unfinished,
        interrupt: Interrupt::never(),
    }
}

/// As `options`, with all results that are there.
fn resumed(folder: &Path) -> Options {
    Options { earlier: Earlier::All, ..options(folder, "1/1") }
}

#[test]
fn shards_merged_equal_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let whole = run(&Squares::new(20), &options(folder.path(), "1/1")).unwrap();
    let mut files = Vec::new();
    for index in 1..=3 {
        let options = options(folder.path(), &format!("{index}/3"));
        run(&Squares::new(20), &options).unwrap();
        files.push(options.path("results", "parquet"));
    }
    assert_eq!(merge(&files, false).unwrap(), whole);
    assert_eq!(read(&folder.path().join("results.parquet")).unwrap(), whole);
}

#[test]
fn an_interrupted_study_goes_on_where_it_ended() {
    let folder = tempfile::tempdir().unwrap();
    let first = Squares { interrupt_after: 6, ..Squares::new(300) };
    let stopped = run(
        &first,
        &Options { interrupt: first.interrupt.clone(), ..options(folder.path(), "1/1") },
    );
    let Err(StudyError::Interrupted { finished, cells: 300 }) = stopped else {
        panic!("must be interrupted, was {stopped:?}")
    };
    let second = Squares::new(300);
    let table = run(&second, &options(folder.path(), "1/1")).unwrap();
    assert_eq!((table.rows.len(), second.computed.into_inner()), (300, 300 - finished));
}

#[test]
fn a_row_cut_off_by_a_kill_is_computed_again() {
    let folder = tempfile::tempdir().unwrap();
    let whole = run(&Squares::new(5), &options(folder.path(), "1/1")).unwrap();
    let journal = folder.path().join("cells.csv");
    let text = std::fs::read_to_string(&journal).unwrap();
    std::fs::write(&journal, &text[..text.len() - 2]).unwrap();
    let again = Squares::new(5);
    assert_eq!(run(&again, &options(folder.path(), "1/1")).unwrap(), whole);
    assert_eq!(again.computed.into_inner(), 1);
}

#[test]
fn cells_of_other_parameters_are_refused_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    run(&Squares::new(5), &options(folder.path(), "1/1")).unwrap();
    let other = Squares { scale: 2.0, ..Squares::new(5) };
    let refused = run(&other, &options(folder.path(), "1/1"));
    assert!(matches!(refused, Err(StudyError::Journal(JournalError::Other { .. }))));
    let again = Squares::new(5);
    run(&again, &resumed(folder.path())).unwrap();
    assert_eq!(again.computed.into_inner(), 0);
}

#[test]
fn a_shard_of_other_parameters_is_refused_by_name() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    run(&Squares::new(4), &options(one.path(), "1/2")).unwrap();
    run(&Squares { scale: 2.0, ..Squares::new(4) }, &options(two.path(), "2/2")).unwrap();
    let files =
        [one.path().join("results-1-of-2.parquet"), two.path().join("results-2-of-2.parquet")];
    let Err(TableError::Other { path, .. }) = merge(&files, false) else {
        panic!("must be refused")
    };
    assert_eq!(path, files[1]);
}

#[test]
fn a_missing_shard_is_told_with_its_first_cell() {
    let folder = tempfile::tempdir().unwrap();
    run(&Squares::new(9), &options(folder.path(), "1/2")).unwrap();
    let merged = merge(&[folder.path().join("results-1-of-2.parquet")], false);
    assert!(matches!(merged, Err(TableError::Missing { missing: 4, first: 1, cells: 9 })));
}

#[test]
fn a_file_of_something_else_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("results.parquet");
    std::fs::write(&path, "not parquet").unwrap();
    assert!(matches!(read(&path), Err(TableError::Parquet { .. })));
}

#[test]
fn slices_are_counted_from_one() {
    assert!("0/2".parse::<Shard>().is_err() && "3/2".parse::<Shard>().is_err());
    assert!("x".parse::<Shard>().is_err() && "2/2".parse::<Shard>().is_ok());
}

#[test]
fn a_second_process_in_the_folder_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let whole = run(&Squares::new(5), &options(folder.path(), "1/1")).unwrap();
    let path = folder.path().join("cells.csv");
    let other = std::fs::File::open(&path).unwrap();
    other.lock().unwrap();
    for earlier in [Earlier::Unfinished, Earlier::All, Earlier::Forget] {
        let refused = run(&Squares::new(5), &Options { earlier, ..options(folder.path(), "1/1") });
        assert!(matches!(refused, Err(StudyError::Journal(JournalError::Busy { .. }))));
    }
    drop(other);
    let again = Squares::new(5);
    assert_eq!(run(&again, &resumed(folder.path())).unwrap(), whole);
    assert_eq!(again.computed.into_inner(), 0);
}

#[test]
fn rows_that_were_changed_joined_or_torn_are_computed_again() {
    let folder = tempfile::tempdir().unwrap();
    let whole = run(&Squares::new(9), &options(folder.path(), "1/1")).unwrap();
    let path = folder.path().join("cells.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let (head, rows) = lines.split_at(2);
    let digit = |row: &str| row.replacen("0.333", "0.334", 1).replacen("1.333", "1.334", 1);
    let tear = |row: &str| format!("{}{row}", &row[..row.len() / 2]);
    let other_cell = |row: &str| format!("9{row}").replacen("98,", "7,", 1);
    let quoted = |row: &str| format!("\"{row}");
    let damages: [&dyn Fn(&str) -> String; 4] = [&digit, &tear, &other_cell, &quoted];
    for damage in damages {
        for at in [1, 2, 8] {
            let mut rows: Vec<String> = rows.iter().map(|row| (*row).to_owned()).collect();
            rows[at] = damage(&rows[at]);
            let damaged = [head.join("\n"), rows.join("\n")].join("\n") + "\n";
            std::fs::write(&path, [damaged.as_bytes(), b"\xff\xfe\n"].concat()).unwrap();
            let again = Squares::new(9);
            assert_eq!(run(&again, &options(folder.path(), "1/1")).unwrap(), whole);
            assert!(again.computed.into_inner() <= 1, "row {at}");
        }
    }
}

#[test]
fn rows_that_end_as_on_windows_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let whole = run(&Squares::new(5), &options(folder.path(), "1/1")).unwrap();
    let path = folder.path().join("cells.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace('\n', "\r\n")).unwrap();
    let again = Squares::new(5);
    assert_eq!(run(&again, &resumed(folder.path())).unwrap(), whole);
    assert_eq!(again.computed.into_inner(), 0);
    assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
}

#[test]
fn a_finished_run_is_computed_anew_unless_its_results_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let computed = |options: &Options| {
        let study = Squares::new(5);
        run(&study, options).unwrap();
        study.computed.into_inner()
    };
    let anew = options(folder.path(), "1/1");
    assert_eq!([&anew, &anew, &resumed(folder.path())].map(computed), [5, 5, 0]);
}

#[test]
fn another_program_computes_anew_and_never_takes_the_cells_of_the_former() {
    let folder = tempfile::tempdir().unwrap();
    let run_by = |program: &str, options: &Options| {
        let study = Squares { interrupt_after: 6, ..Squares::new(300) };
        let options = Options { interrupt: study.interrupt.clone(), ..options.clone() };
        let outcome = run_as(&study, &options, fingerprint_by(&study, program));
        (outcome, study.computed.into_inner())
    };
    let (interrupted, first) = run_by("one", &options(folder.path(), "1/1"));
    assert!(matches!(interrupted, Err(StudyError::Interrupted { .. })));
    let (refused, _) = run_by("other", &resumed(folder.path()));
    assert!(matches!(refused, Err(StudyError::Journal(JournalError::Other { .. }))));
    let (again, second) = run_by("other", &options(folder.path(), "1/1"));
    let Err(StudyError::Interrupted { finished, .. }) = again else { panic!("{again:?}") };
    assert_eq!((finished, first > 0), (second, true));
}

#[test]
fn cells_and_slices_of_another_build_are_taken_where_that_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let of_any = Options { earlier: Earlier::OfAnyBuild, ..options(folder.path(), "1/1") };
    let computed = |scale: f64, program: &str, options: &Options| {
        let study = Squares { scale, ..Squares::new(5) };
        let table = run_as(&study, options, fingerprint_by(&study, program));
        table.map(|table| (table, study.computed.into_inner()))
    };
    let (first, _) = computed(1.0, "one", &options(folder.path(), "1/1")).unwrap();
    let (taken, cells) = computed(1.0, "other", &of_any).unwrap();
    assert_eq!((taken.rows, cells), (first.rows.clone(), 0));
    // From now on they are of the later build.
    let (_, cells) = computed(1.0, "other", &resumed(folder.path())).unwrap();
    assert_eq!(cells, 0);
    assert!(computed(2.0, "other", &of_any).is_err(), "other parameters");
    let slices = [("one", "1/2"), ("other", "2/2")].map(|(program, shard)| {
        computed(1.0, program, &options(folder.path(), shard)).unwrap();
        folder.path().join(format!("results-{}.parquet", shard.replace('/', "-of-")))
    });
    assert!(matches!(merge(&slices, false), Err(TableError::Other { .. })));
    assert_eq!(merge(&slices, true).unwrap().rows, first.rows);
}

#[test]
fn the_fingerprint_changes_with_the_program_and_its_first_half_with_the_parameters() {
    let [one, other] = [1.0, 2.0].map(|scale| Squares { scale, ..Squares::new(5) });
    let [a, b] = ["a", "b"].map(|program| fingerprint_by(&one, program));
    assert_eq!((a.parameters(), a == b), (b.parameters(), false));
    assert_ne!(fingerprint_by(&other, "a").parameters(), a.parameters());
    assert_eq!(fingerprint(&one), fingerprint(&one));
}
