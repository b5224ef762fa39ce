//! What is typed wrongly is refused: with exit code 2, before anything is computed, with a sentence that names it.

use std::path::Path;
use std::process::{Command, Stdio};

/// Command line, and a word of the refusal.
const COMMANDS: &[(&str, &str)] = &[
    ("nonsense", "unrecognized"),
    ("--nonsense", "--nonsense"),
    ("demo --seed -1", "--seed"),
    ("demo --seed 1.5", "1.5"),
    ("demo --seed x", "no whole number"),
    ("demo --seed 99999999999999999999", "no whole number"),
    ("demo extra", "extra"),
    ("demo --out", "--out"),
    ("serve --listen nowhere", "--listen"),
    ("serve --listen 127.0.0.1", "--listen"),
    ("serve --listen 127.0.0.1:99999", "--listen"),
    ("serve --listen 192.0.2.1:13549", "192.0.2.1"),
    ("serve --key missing.key", "missing.key"),
    ("serve --operator anna=missing.key", "missing.key"),
    ("serve --operator anna", "NAME=FILE"),
    ("serve --operator =lab.key", "operator's name"),
    ("serve --operator anna=lab.key --operator anna=second.key", "another operator has this name"),
    ("serve --operator a=lab.key --key lab.key", "cannot be used with"),
    ("serve --operator ann\u{e4}=lab.key", "operator's name"),
    ("serve --operator waytoolonganameforanybody=lab.key", "operator's name"),
    ("serve --operator anna=lab.key --operator bob=lab.key", "is that of anna"),
    ("serve --key .", "."),
    ("serve --key A.toml", "A.toml"),
    ("serve --model missing.toml --key lab.key", "missing.toml"),
    ("serve --natnet nowhere", "127.0.0.1:1510"),
    ("serve --natnet --pose-rate 0", "1 to 1000 Hz"),
    ("serve --natnet --pose-rate 1001", "1 to 1000 Hz"),
    ("serve --natnet --pose-rate nan", "1 to 1000 Hz"),
    ("serve --pose-rate 250", "--natnet"),
    ("serve --hang --model bench-fixed --key lab.key", "no legs"),
    ("serve --natnet 1610", "127.0.0.1:1510"),
    ("serve --natnet 127.0.0.1", "127.0.0.1:1510"),
    ("serve --listen 13549", "0.0.0.0:13549"),
    ("serve --listen :13549", "0.0.0.0:13549"),
    ("serve --listen 127.0.0.1:", "0.0.0.0:13549"),
    ("serve --listen localhost:x --key lab.key", "0.0.0.0:13549"),
    ("serve --natnet [::1]:1510", "--natnet"),
    (
        "serve --natnet 192.0.2.1:1510 --key lab.key --listen 127.0.0.1:0",
        "no address of this computer: give one that is with --natnet",
    ),
    ("serve --listen 192.0.2.1:13549 --key lab.key", "give one that is with --listen"),
    ("serve --seed one", "--seed"),
    ("accuracy --seed 1e3", "--seed"),
    ("accuracy --model missing.toml", "missing.toml"),
    ("accuracy --robots 0", "--robots"),
    ("accuracy --robots 2 --model W", "--model"),
    ("accuracy --first-seed 3", "--robots"),
    ("faults --seed", "--seed"),
    ("faults --hours 1", "--hours"),
    ("adversary --datagrams -5", "--datagrams"),
    ("adversary --datagrams many", "--datagrams"),
    ("adversary --datagrams 0", "no whole number from 1"),
    ("adversary --sessions 0", "no whole number from 1"),
    ("adversary --bytes 0.5", "--bytes"),
    ("adversary --sessions -1", "--sessions"),
    ("soak --hours 0", "from 0.0167 to 8760"),
    ("soak --hours -1", "hours"),
    ("soak --hours nan", "hours"),
    ("soak --hours inf", "hours"),
    ("soak --hours week", "hours"),
    ("walk", "--frequency"),
    ("walk --frequency -30", "--direction"),
    ("walk --frequency 36 --direction 0", "35"),
    ("walk --frequency nan --direction 0", "35"),
    ("walk --frequency inf --direction 0", "35"),
    ("walk --frequency thirty --direction 0", "thirty"),
    ("walk --frequency 30 --direction 91", "90"),
    ("walk --frequency 30 --direction -90.5", "90"),
    ("walk --frequency 30 --direction nan", "90"),
    ("walk --frequency 30 --direction 0 --seconds 0", "--seconds"),
    ("walk --frequency 30 --direction 0 --seconds -1", "--seconds"),
    ("walk --frequency 30 --direction 0 --seconds nan", "--seconds"),
    ("walk --frequency 30 --direction 0 --seconds 2days", "day"),
    ("walk --frequency 30 --direction 0 --seconds 8parsecs", "8parsecs"),
    ("walk --frequency 30 --direction 0 --seeds 0", "--seeds"),
    ("walk --frequency 30 --direction 0 --seeds -1", "--seeds"),
    ("walk --frequency 30 --direction 0 --seeds 1000000", "--seeds"),
    ("walk --frequency 30 --direction 0 --seeds 1.5", "--seeds"),
    ("walk --frequency 30 --direction 0 --first-seed -1", "--first-seed"),
    ("walk --frequency 30 --direction 0 --drive steam", "steam"),
    ("walk --frequency 30 --direction 0 --step 0", "--step"),
    ("walk --frequency 30 --direction 0 --step nan", "--step"),
    ("walk --frequency 30 --direction 0 --step 1day --seconds 1 --seeds 1", "5ms"),
    ("walk --frequency 30 --direction 0 --step 2s --seconds 1 --seeds 1 --drive ideal", "5ms"),
    ("walk --frequency 30 --direction 0 --model bench-fixed", "legs"),
    ("walk --frequency 30 --direction 0 --model .", "cannot read"),
    ("walk --frequency 30 --direction 0 --model missing.toml", "missing.toml"),
    ("walk --frequency 30 --direction 0 --model empty.toml", "empty.toml"),
    ("walk --frequency 30 --direction 0 --model noise.bin", "noise.bin"),
    (
        "walk --frequency 30 --direction 0 --seeds 1 --seconds 0.1 --drive ideal --out empty.toml",
        "empty.toml",
    ),
    ("rest --model", "--model"),
    ("rest --model fifo", "is a pipe"),
    ("rest --model /dev/zero", "is a device"),
    ("rest --model huge", "larger than"),
    ("rest --model noise.bin", "not text"),
    ("track fifo", "is a pipe"),
    ("track /dev/zero", "is a device"),
    ("track huge", "larger than"),
    ("track circle --modes fifo", "is a pipe"),
    ("track circle --modes /dev/zero", "is a device"),
    ("serve --key fifo", "is a pipe"),
    ("serve --key /dev/zero", "is a device"),
    ("serve --operator anna=fifo", "is a pipe"),
    ("study leg --measured fifo", "is a pipe"),
    ("study leg --measured /dev/zero", "is a device"),
    ("study leg --measured huge", "larger than"),
    ("study calibrate --measured fifo", "is a pipe"),
    ("study merge fifo", "is a pipe"),
    ("study merge /dev/zero", "is a device"),
    ("rest --model bench-fixed", "legs"),
    ("rest --model bench-planar", "legs"),
    ("rest extra", "extra"),
    ("leg --leg xx", "xx"),
    ("leg --leg 1", "1"),
    ("leg --force 1,2", "three"),
    ("leg --force 1,2,3,4", "three"),
    ("leg --force a,b,c", "three"),
    ("leg --force nan,0,0", "three"),
    ("leg --force inf,0,0", "three"),
    ("leg --torque 1", "three"),
    ("leg --force 1e9,0,0", "does not bear"),
    ("leg --force 0,0,1e300", "does not bear"),
    ("leg --torque 1e6,0,0", "does not bear"),
    ("leg --force 1e-12,0,0", "did not ring"),
    ("leg", "did not ring"),
    ("rest --model nosuch", "random-SEED"),
    ("rest --model random-x", "random-SEED"),
    ("rest --model random-", "random-SEED"),
    ("rest --model", "--model"),
    ("track figure8 --side 1", "figure8 has --width and --height"),
    ("track circle --at 1e30,0", "within 1000"),
    ("track circle --out empty.toml", "cannot write the record"),
    ("home --out empty.toml", "cannot write the record"),
    ("man empty.toml", "not a folder"),
    ("completions ksh", "possible values"),
    ("leg --model bench-fixed", "legs"),
    ("eigenmodes --clamp head", "head"),
    ("eigenmodes --leg tail", "tail"),
    ("eigenmodes --model bench-planar", "legs"),
    ("shake --frequency 30", "--direction"),
    ("shake --frequency 40 --direction 0", "35"),
    ("shake --frequency 30 --direction 100", "90"),
    ("shake --frequency 30 --direction 0 --base sky", "sky"),
    ("shake --frequency 30 --direction 0 --step 0", "--step"),
    ("shake --frequency 30 --direction 0 --step -1ms", "-1"),
    ("validate --model missing.toml", "missing.toml"),
    ("validate --model bench-fixed", "legs"),
    ("validate --frequency 99", "35"),
    ("validate --frequency nan", "35"),
    ("validate --direction 200", "90"),
    ("validate --leg 5", "5"),
    ("validate --force 1", "three"),
    ("validate --torque x", "three"),
    ("export-mjcf --step-ms 0", "--step-ms"),
    ("export-mjcf --step-ms nan", "step"),
    ("export-mjcf --step-ms -1", "step"),
    ("export-mjcf --step-ms inf", "step"),
    ("export-mjcf --step-ms 1000", "step"),
    ("export-mjcf --step-ms fast", "step"),
    ("export-mjcf --out missing/folder/a.xml", "missing/folder"),
    ("export-mjcf --out .", "cannot write"),
    ("export-urdf --out missing/folder/a.urdf", "missing/folder"),
    ("export-urdf --model nothing", "nothing"),
    ("serve --foxglove=nowhere", "127.0.0.1"),
    ("serve --foxglove=127.0.0.1:99999", "127.0.0.1"),
    ("track", "PATH"),
    ("track nowhere", "nowhere"),
    ("track empty.toml", "two points"),
    ("track A.toml", "line 5"),
    ("track noise.bin", "noise.bin"),
    ("track one-point.csv", "two points"),
    ("track nan.csv", "line 2"),
    ("track circle --radius 0", "radius"),
    ("track circle --radius -1", "radius"),
    ("track circle --radius nan", "radius"),
    ("track circle --radius 1e9", "radius"),
    ("track figure8 --width 0", "width"),
    ("track figure8 --width nan", "width"),
    ("track figure8 --height 0", "height"),
    ("track square --side -1", "side"),
    ("track square --side inf", "side"),
    ("track figure8 --laps 0", "--laps"),
    ("track figure8 --laps 1.5", "--laps"),
    ("track figure8 --at 1", "X,Y"),
    ("track figure8 --at a,b", "X,Y"),
    ("track figure8 --error-limit 0", "error limit"),
    ("track figure8 --error-limit -1", "error limit"),
    ("track figure8 --error-limit nan", "error limit"),
    ("track figure8 --controller three-state", "three-state"),
    ("track figure8 --fence 1,2,3", "fence"),
    ("track figure8 --fence 1,1,0,0", "fence"),
    ("track figure8 --latency 0", "--latency"),
    ("track figure8 --latency -1ms", "-1"),
    ("track figure8 --latency forever", "--latency"),
    ("track figure8 --loss 1", "0.9"),
    ("track figure8 --loss -0.1", "0.9"),
    ("track figure8 --loss nan", "0.9"),
    ("track figure8 --modes missing.toml", "missing.toml"),
    ("track figure8 --modes A.toml", "A.toml"),
    ("track figure8 --model A", "identify"),
    ("track figure8 --model bench-fixed", "identify"),
    ("track figure8 --patience 0", "--patience"),
    ("track figure8 --seed -3", "--seed"),
    ("home --pushes 0", "no whole number from 1 to 1000"),
    ("home --pushes 1001", "--pushes"),
    ("home --pushes few", "--pushes"),
    ("home --patience nan", "--patience"),
    ("home --loss 2", "0.9"),
    ("home --modes missing.toml", "missing.toml"),
    ("home --model A", "identify"),
    ("identify --modes fifo", "is a pipe"),
    ("identify --modes .", "is a directory"),
    ("identify --modes empty.toml/modes.toml", "modes.toml"),
    ("identify --model bench-fixed", "legs"),
    ("identify --model missing.toml", "missing.toml"),
    ("identify --loss x", "--loss"),
    ("study", "command"),
    ("study dance", "dance"),
    ("study mobility --shard 0/3", "shard"),
    ("study mobility --shard 4/3", "shard"),
    ("study mobility --shard 1", "shard"),
    ("study mobility --seeds 0", "--seeds"),
    ("study mobility --seconds 0", "--seconds"),
    ("study mobility --step nan", "--step"),
    ("study mobility --scatter 0.5", "0.2"),
    ("study mobility --scatter nan", "0.2"),
    ("study mobility --drive legs", "legs"),
    ("study mobility --frequencies 40,nan", "-120 to 120 Hz"),
    ("study mobility --frequencies 130", "-120 to 120 Hz"),
    ("study mobility --directions 91", "-90 to 90 degrees"),
    ("study mobility --frequencies 40 --drive firmware", "up to 35 Hz"),
    ("study mobility --table3 --directions 0", "--table3"),
    ("study mobility --model bench-fixed", "legs"),
    ("study mobility --model missing.toml", "missing.toml"),
    ("study sensitivity", "CHANGE"),
    ("study sensitivity wind", "wind"),
    ("study select --least nan --quick", "0 to 10"),
    ("study select --least -1 --quick", "0 to 10"),
    ("study select --statements --json", "--json"),
    ("study leg --leg q", "q"),
    ("study leg --load-g 0", "1 to 5000 g"),
    ("study leg --load-g nan", "1 to 5000 g"),
    ("study leg --gravity sideways", "across"),
    ("study leg --rate 10", "50 to 10000 Hz"),
    ("study leg --repeats 0", "--repeats"),
    ("study leg --lever-mm nan", "lever"),
    ("study leg --noise-mm -1", "noise"),
    ("study leg --noise-deg nan", "noise"),
    ("study leg --measured missing.csv", "missing.csv"),
    ("study leg --measured empty.toml", "empty.toml"),
    ("study leg --measured A.toml", "A.toml"),
    ("study leg --model bench-fixed", "legs"),
    ("study sysid", "DATA_DIR"),
    ("study sysid missing", "is not a folder"),
    ("study sysid .", "scales.csv"),
    ("study sysid --synthetic 0", "--synthetic"),
    ("study sysid --synthetic 1 --first-seed -1", "--first-seed"),
    ("study sysid . --synthetic 1", "--synthetic"),
    ("study sysid . --model bench-fixed", "legs"),
    ("study actuation --shard x", "shard"),
    ("study actuation --model missing.toml", "missing.toml"),
    ("study merge", "FILE"),
    ("study merge missing.parquet", "missing.parquet"),
    ("study merge A.toml", "A.toml"),
    ("study merge empty.toml", "empty.toml"),
    ("study calibrate --measured missing.csv", "missing.csv"),
    ("study calibrate --measured empty.toml", "empty.toml"),
    ("study calibrate --start moon", "moon"),
    ("study calibrate --fit published", "unpublished"),
    ("study calibrate --advance --measured A.toml", "--advance"),
    ("study calibrate --shuffle x", "--shuffle"),
    ("study calibrate --generations -1", "--generations"),
    ("study calibrate --generations 0", "--generations"),
    ("study calibrate --samples 0", "--samples"),
    ("study calibrate --samples 1001", "--samples"),
    ("study calibrate --widen 0", "widen"),
    ("study calibrate --widen nan", "widen"),
    ("study calibrate --scatter 1", "scatter"),
    ("study calibrate --step 0ms", "--step"),
    ("study calibrate --seconds 0", "--seconds"),
    ("study calibrate --fresh-seeds 0", "--fresh-seeds"),
    ("study calibrate --seed 2000000", "--seed"),
    ("study calibrate --model bench-planar", "legs"),
    ("study calibrate --measured lab.csv --hold-out 9", "9"),
    ("study calibrate --measured lab.csv --shuffle 1", "shuffle"),
    ("study all --model bench-fixed", "legs"),
    ("study all --seeds 3", "--seeds"),
    ("walk --frequency 30 --direction 0 --step 1ms", "0.1ms"),
    ("study calibrate --generations 1000000", "--generations"),
    ("home --model bench-planar --modes W.modes.toml", "legs"),
    ("serve --seed -1", "--seed"),
    ("accuracy --model short.toml", "short.toml"),
];

/// What is replaced in model A, by what, and a word of the refusal.
const MODELS: &[(&str, &str, &str)] = &[
    (
        "twist_deg = [0.0, 45.0, 45.0]",
        "twist_deg = [0.0, 45.0, 45.0, 0.0]",
        "4 numbers where 3 are meant",
    ),
    ("twist_deg = [0.0, 45.0, 45.0]", "twist_deg = [0.0, 45.0]", "2 numbers where 3 are meant"),
    ("twist_deg = [0.0, 45.0, 45.0]", "twist_deg = 45.0", "twist_deg"),
    ("twist_deg = [0.0, 45.0, 45.0]", "twist_deg = [0.0, 45.0, 181.0]", "twist_deg[2]"),
    ("size_mm = [51.0, 51.0, 60.0]", "size_mm = [51.0, 51.0, 60.0, 1.0]", "4 numbers"),
    ("size_mm = [51.0, 51.0, 60.0]", "size_mm = [51.0, 51.0, 260.0]", "core.size_mm (z)"),
    ("mass_g = 30.0", "mass_kg = 0.03", "mass_kg"),
    ("mass_g = 30.0", "mass_g = \"30\"", "mass_g"),
    ("mass_g = 30.0", "mass_g = -1.0", "battery.mass_g"),
    ("mass_g = 30.0", "mass_g = 900.0", "total_mass_g"),
    ("mass_g = 30.0", "mass_g = nan", "battery.mass_g"),
    ("total_mass_g = 350.0", "total_mass_g = inf", "total_mass_g"),
    ("total_mass_g = 350.0", "total_mass_g = 100.0", "150 .. 2000"),
    ("total_mass_g = 350.0", "", "total_mass_g"),
    ("joint = \"free\"", "joint = \"flying\"", "flying"),
    ("joint = \"free\"", "joint = \"fixed\"", "stand free"),
    ("joint = \"free\"", "joint = \"free\"\ndamping_n_s_m = 1.0", "damping_n_s_m"),
    ("axis = \"across\"", "axis = \"upwards\"", "upwards"),
    ("friction = 0.54", "friction = 0.0", "legs.fl.friction"),
    ("friction = 0.54", "friction = 4.0", "0.01 .. 3"),
    ("twist_hand = 1.0", "twist_hand = 0.5", "1 or -1"),
    ("length_mm = 85.0", "length_mm = 250.0", "inside each other"),
    ("[legs.rr]", "[legs.middle]", "middle"),
    ("[contact]", "[contacts]", "contacts"),
    ("damping_n_s_per_m = 45.6", "damping_n_s_per_m = 0.0", "contact.damping_n_s_per_m"),
    ("name = \"A\"", "name = ", "line"),
    ("name = \"A\"", "name = \"A\"\nname = \"B\"", "duplicate"),
    ("[contact]", "[electrical.motor]\npole_pairs = 0\n[contact]", "pole_pairs"),
    ("[contact]", "[electrical.motor]\npole_pairs = 7.5\n[contact]", "pole_pairs"),
    ("[contact]", "[electrical.motor]\npole_pair = 7\n[contact]", "pole_pair"),
    ("[contact]", "[electrical.motor]\nphase_resistance_ohm = 0\n[contact]", "0.02 .. 30"),
    (
        "[contact]",
        "[electrical.motor]\nphase_inductance_mh = nan\n[contact]",
        "phase_inductance_mh",
    ),
    ("[contact]", "[electrical.engine]\n[contact]", "engine"),
    ("[contact]", "[electrical.encoder]\nbits = 40\n[contact]", "8 .. 24"),
    ("[contact]", "[electrical.encoder]\nage_us = -1\n[contact]", "age_us"),
    ("[contact]", "[electrical.encoder]\neccentricity_deg = [0.1]\n[contact]", "1 numbers where 2"),
    ("[contact]", "[electrical.inverter]\npwm_frequency_hz = 50\n[contact]", "pwm_frequency_hz"),
    ("[contact]", "[electrical.inverter]\ncan_coast = 1\n[contact]", "can_coast"),
    ("[contact]", "[electrical.sense]\ncurrent_gain_error = 2.0\n[contact]", "0 .. 0.5"),
    ("[contact]", "[electrical.pack]\ncells = 9\n[contact]", "electrical.pack.cells"),
    (
        "[contact]",
        "[electrical.pack]\ncharge_at_least = 0.9\ncharge_at_most = 0.3\n[contact]",
        "charge_at_most",
    ),
    ("[contact]", "[electrical.settings]\npole_pairs = 50\n[contact]", "from 1 to 32"),
    ("[contact]", "[electrical.settings]\nwarp_factor = 9\n[contact]", "no setting has this name"),
    ("[contact]", "[electrical.settings]\ncurrent_limit = 9.0\n[contact]", "current_limit"),
];

/// Rows at least, so that the table keeps covering every command.
const AT_LEAST: usize = 170;

fn refusal(folder: &Path, words: &str) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_flix-sim"))
        .current_dir(folder)
        .env("HOME", folder)
        .env("XDG_CONFIG_HOME", folder)
        .args(words.split(' '))
        .stdin(Stdio::null())
        .output()
        .expect("cargo built the program that it tests");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be written");
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).expect("a temporary folder can be written")
    };
    write("lab.key", &[b'5'; 64]);
    write("second.key", &[b'6'; 64]);
    let huge = std::fs::File::create(folder.path().join("huge")).expect("it can be written");
    // Without its blocks: it takes no room.
    huge.set_len(1 << 40).expect("a file may have holes");
    let made = Command::new("mkfifo").arg(folder.path().join("fifo")).status();
    assert!(made.is_ok_and(|status| status.success()));
    write("A.toml", include_bytes!("../../models/A.toml"));
    write("W.modes.toml", include_bytes!("../../models/W.modes.toml"));
    write("short.toml", b"name = \"short\"\n");
    write("empty.toml", b"");
    write("noise.bin", &[0xff; 300]);
    write("one-point.csv", b"1,2\n");
    write("nan.csv", b"0,0\n1,nan\n");
    let row = "30,0,0.1,0,0\n".repeat(4);
    let table = format!("f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s\n{row}");
    write("lab.csv", table.as_bytes());
    // A key that others can read is refused for that alone.
    for key in ["lab.key", "second.key"] {
        std::fs::set_permissions(
            folder.path().join(key),
            std::os::unix::fs::PermissionsExt::from_mode(0o600),
        )
        .expect("a temporary folder can be written");
    }
    folder
}

#[test]
fn a_command_that_is_typed_wrongly_is_refused_by_name() {
    assert!(COMMANDS.len() + MODELS.len() >= AT_LEAST);
    let folder = folder();
    let wrong: Vec<String> = COMMANDS
        .iter()
        .filter_map(|(words, word)| {
            let (code, said) = refusal(folder.path(), words);
            let refused = code == Some(2) && said.contains(word);
            (!refused).then(|| format!("{words}: {code:?}, without {word:?}: {said}"))
        })
        .collect();
    assert_eq!(wrong, Vec::<String>::new());
}

#[test]
fn a_model_with_an_error_is_refused_by_file_and_key() {
    let folder = folder();
    let model = include_str!("../../models/A.toml");
    let wrong: Vec<String> = MODELS
        .iter()
        .filter_map(|(from, to, word)| {
            assert!(model.contains(from), "model A has no {from:?}");
            let own = model.replacen(from, to, 1);
            std::fs::write(folder.path().join("own.toml"), own).unwrap();
            let (code, said) =
                refusal(folder.path(), "walk --frequency 30 --direction 0 --model own.toml");
            // What the model says of itself is complete without its file.
            let named = said.contains("own.toml") || said.contains("stand free");
            let refused = code == Some(2) && said.contains(word) && named;
            (!refused).then(|| format!("{to:?}: {code:?}, without {word:?}: {said}"))
        })
        .collect();
    assert_eq!(wrong, Vec::<String>::new());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_or_error_is_no_panic() {
    let folder = folder();
    let full = || Stdio::from(std::fs::File::options().write(true).open("/dev/full").unwrap());
    for words in
        ["validate", "validate --json", "export-mjcf", "rest --model missing.toml", "--help"]
    {
        let status = Command::new(env!("CARGO_BIN_EXE_flix-sim"))
            .current_dir(folder.path())
            .args(words.split(' '))
            .stdout(full())
            .stderr(full())
            .status()
            .unwrap();
        assert!(matches!(status.code(), Some(1 | 2)), "{words}: {status}");
    }
}
