//! What `flix` says to input that cannot be right: every row ends with its exit code and a sentence
//! that holds its words, soon, and without a panic.
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// No answer, refused or interrupted may take a while; usage never does.
const LONGEST: Duration = Duration::from_secs(20);
/// Command lines that are tried at once.
const SIDE_BY_SIDE: usize = 8;

/// Command line, exit code, and a word of the message. `{home}` is an empty directory with the files
/// of [`FILES`].
const ROWS: &[(&str, i32, &str)] = &[
    // The command itself.
    ("", 2, "Usage"),
    ("fly", 2, "unrecognized subcommand"),
    ("--frequency 3", 2, "unexpected argument"),
    ("drvie walker", 2, "drive"),
    // What would clear a screen, or name a window.
    ("\u{1b}[2J", 2, "unrecognized subcommand"),
    ("drive walker --frequency 3\u{1b}]0;x\u{7}", 2, "is not a number"),
    ("drive walker --fre\u{9b}2J=3", 2, "unexpected argument"),
    ("status walker\u{202e}\u{1b}[31m --key none", 2, "none"),
    ("help fly", 2, "unrecognized subcommand"),
    ("completions", 2, "SHELL"),
    ("completions tcsh", 2, "possible values"),
    ("keygen", 2, "FILE"),
    ("keygen {home}", 2, "is a directory"),
    ("keygen {home}/none/robot.key", 2, "No such file"),
    ("keygen {home}/good.key", 2, "exists already"),
    ("keygen /dev/full", 2, "is a device"),
    ("keygen {home}/fifo", 2, "is a pipe"),
    ("keygen --robot ../up", 2, "robot's name"),
    ("keygen --robot w {home}/new.key", 2, "cannot be used with"),
    // Which robot.
    ("status 10.0.0.7", 2, "--key"),
    ("status 127.0.0.1:99999", 2, "1 to 65535"),
    ("status 127.0.0.1:0", 2, "1 to 65535"),
    ("status 127.0.0.1:-1", 2, "1 to 65535"),
    ("status 127.0.0.1:", 2, "1 to 65535"),
    ("status 127.0.0.1:x", 2, "1 to 65535"),
    ("status :4000", 2, "there is no host"),
    ("status a:1:2", 2, "HOST:PORT"),
    ("status [::1]9", 2, "HOST:PORT"),
    ("stop 127.0.0.1:99999", 2, "1 to 65535"),
    ("clear 127.0.0.1:99999", 2, "1 to 65535"),
    ("teleop 127.0.0.1:99999", 2, "1 to 65535"),
    ("doctor 127.0.0.1:99999 --no-poses", 2, "1 problem"),
    ("link-test 127.0.0.1:99999", 2, "1 to 65535"),
    ("parameters list 127.0.0.1:99999", 2, "1 to 65535"),
    ("status nobody.invalid --key {home}/good.key", 10, "nobody.invalid"),
    ("status 127.0.0.1:9 --key {home}/good.key", 10, "answer"),
    ("clear 127.0.0.1:9 --key {home}/good.key", 10, "answer"),
    ("stop 127.0.0.1:9 --key {home}/good.key", 10, "answer"),
    // A crash and its ELF file.
    ("crash 127.0.0.1:9 --elf", 2, "--elf"),
    ("crash 127.0.0.1:9 --elf {home}/none.elf", 2, "No such file"),
    ("crash 127.0.0.1:9 --elf {home}", 2, "is a directory"),
    ("crash 127.0.0.1:9 --elf {home}/fifo", 2, "is a pipe"),
    ("crash 127.0.0.1:9 --elf /dev/zero", 2, "is a device"),
    ("crash 127.0.0.1:9 --elf {home}/empty", 2, "not an ELF file"),
    ("crash 127.0.0.1:9 --elf {home}/short.key", 2, "not an ELF file"),
    ("crash 127.0.0.1:9 --key {home}/good.key", 10, "answer"),
    // Its key.
    ("status 127.0.0.1:9 --key", 2, "--key"),
    ("status 127.0.0.1:9 --key {home}/none.key", 2, "No such file"),
    ("status 127.0.0.1:9 --key {home}", 2, "is a directory"),
    ("status 127.0.0.1:9 --key {home}/fifo", 2, "is a pipe"),
    ("status 127.0.0.1:9 --key /dev/null", 2, "is a device"),
    ("status 127.0.0.1:9 --key {home}/open.key", 2, "chmod 600"),
    ("status 127.0.0.1:9 --key {home}/short.key", 2, "not a key file"),
    ("status 127.0.0.1:9 --key {home}/empty", 2, "not a key file"),
    ("drive 127.0.0.1:9 --frequency 1 --direction 1 --for 1 --key {home}/fifo", 2, "is a pipe"),
    // Drive.
    ("drive", 2, "--frequency"),
    ("drive w --direction 30 --for 5s", 2, "--frequency"),
    ("drive w --frequency 1 --direction 1 --for 1 --foxglove=here", 2, "127.0.0.1"),
    ("drive w --frequency 1 --direction 1 --for 1 --foxglove --no-record", 2, "--no-record"),
    ("drive w --frequency 30 --for 5s", 2, "--direction"),
    ("drive w --frequency 36 --direction 30 --for 5s", 2, "-35 to 35"),
    ("drive w --frequency -36 --direction 30 --for 5s", 2, "-35 to 35"),
    ("drive w --frequency nan --direction 30 --for 5s", 2, "-35 to 35"),
    ("drive w --frequency -inf --direction 30 --for 5s", 2, "-35 to 35"),
    ("drive w --frequency 1e99 --direction 30 --for 5s", 2, "-35 to 35"),
    ("drive w --frequency 30kg --direction 30 --for 5s", 2, "not a number"),
    ("drive w --frequency 30,5 --direction 30 --for 5s", 2, "not a number"),
    ("drive w --frequency --direction 30 --for 5s", 2, "unexpected argument"),
    ("drive w --frequency 30 --direction 91 --for 5s", 2, "-90 to 90"),
    ("drive w --frequency 30 --direction -90.1 --for 5s", 2, "-90 to 90"),
    ("drive w --frequency 30 --direction left --for 5s", 2, "not a number"),
    ("drive w --frequency 30 --direction 30 --for 0", 2, "5s"),
    ("drive w --frequency 30 --direction 30 --for -5", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for -5s", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for nan", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for inf", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for 1e300", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for soon", 2, "not a time"),
    ("drive w --frequency 30 --direction 30 --for 5 --frequency 3", 2, "cannot be used multiple"),
    ("drive w x --frequency 30 --direction 30 --for 5", 2, "unexpected argument"),
    ("drive w --frequency 30 --direction 30 --for 5 --speed 3", 2, "unexpected argument"),
    ("drive 127.0.0.1:9 --frequency 30 --direction 30 --for 5 --key {home}/good.key", 10, "answer"),
    (
        "drive w --frequency 30 --direction 30 --for 5 --natnet-server 127.0.0.1:9",
        2,
        "--pose natnet",
    ),
    ("drive w --frequency 30 --direction 30 --for 5 --up z", 2, "--pose natnet"),
    ("drive w --frequency 30 --direction 30 --for 5 --body 3", 2, "--pose natnet"),
    ("drive w --frequency 30 --direction 30 --for 5 --interface 127.0.0.1", 2, "--pose natnet"),
    ("drive w --frequency 30 --direction 30 --for 5 --pose udp:5005 --body 3", 2, "--pose natnet"),
    ("doctor w --pose udp:5005 --up z --no-poses", 2, "cannot be used with"),
    // Teleop.
    ("teleop w --natnet-server 127.0.0.1", 2, "--pose natnet"),
    ("teleop w --pose udp:5005 --natnet-server 127.0.0.1", 2, "--pose natnet alone"),
    ("teleop a b", 2, "unexpected argument"),
    ("teleop 127.0.0.1:9 --key {home}/fifo", 2, "is a pipe"),
    // Discover and link test.
    ("discover here", 2, "unexpected argument"),
    ("discover --for -3", 2, "not a time"),
    ("discover --for 0", 2, "longer than 0"),
    ("discover --for 1e9", 2, "to a year"),
    ("link-test w --for 0s", 2, "longer than 0"),
    ("drive w --frequency 30 --direction 30 --for 400days", 2, "to a year"),
    ("discover --for never", 2, "not a time"),
    ("link-test w --for -1s", 2, "not a time"),
    ("link-test w --for x", 2, "not a time"),
    // Parameters.
    ("parameters", 2, "Usage"),
    ("parameters lsit w", 2, "list"),
    ("parameters get", 2, "NAME"),
    ("parameters set current_limit", 2, "VALUE"),
    ("parameters set w current_limit", 2, "not a number"),
    ("parameters set w current_limit 1 2", 2, "unexpected value"),
    ("parameters set w current_limit much", 2, "not a number"),
    ("parameters set w current_limit nan", 2, "not a number"),
    ("parameters set w current_limit inf", 2, "not a number"),
    ("parameters import", 2, "FILE"),
    ("parameters import 127.0.0.1:9 {home}/none.toml --key {home}/good.key", 2, "none.toml"),
    ("parameters import 127.0.0.1:9 {home} --key {home}/good.key", 2, "directory"),
    ("parameters import 127.0.0.1:9 {home}/fifo --key {home}/good.key", 2, "is a pipe"),
    ("parameters import 127.0.0.1:9 /dev/zero --key {home}/good.key", 2, "is a device"),
    ("parameters import 127.0.0.1:9 {home}/broken.toml --key {home}/good.key", 2, "broken.toml"),
    // Track.
    ("track", 2, "PATH"),
    ("track circle --laps 0", 2, "no whole number from 1 to 1000000"),
    ("track circle --laps -1", 2, "--laps"),
    ("track circle --laps 1.5", 2, "--laps"),
    ("track circle --radius 0", 2, "radius"),
    ("track circle --radius -0.4", 2, "radius"),
    ("track circle --radius nan", 2, "radius"),
    ("track circle --radius 1e300", 2, "radius"),
    ("track circle --radius wide", 2, "--radius"),
    ("track square --side -1", 2, "side"),
    ("track square --side inf", 2, "side"),
    ("track figure8 --width -1", 2, "width"),
    ("track figure8 --height 0", 2, "height"),
    ("track circle --side 1", 2, "circle has --radius"),
    ("track figure8 --radius 1", 2, "figure8 has --width and --height"),
    ("track square --width 1", 2, "square has --side"),
    ("track {home}/words.csv --side 1", 2, "in its file"),
    ("track circle --at 1e30,0", 2, "--at"),
    ("track circle --at 1", 2, "--at"),
    ("track circle --at 1,x", 2, "--at"),
    ("track circle --at nan,0", 2, "--at"),
    ("track circle --turned east", 2, "--turned"),
    ("track circle --turned nan", 2, "--turned"),
    ("track circle --error-limit 0", 2, "error limit"),
    ("track circle --error-limit -5", 2, "error limit"),
    ("track circle --error-limit nan", 2, "error limit"),
    ("track circle --fence 1,2,3", 2, "--fence"),
    ("track circle --fence 1,1,0,0", 2, "--fence"),
    ("track circle --fence a,b,c,d", 2, "--fence"),
    ("track circle --fence -1e9,-1,1,1", 2, "within 1000"),
    ("track circle --controller best", 2, "controller"),
    ("track {home}/none.csv", 2, "none.csv"),
    ("track {home}", 2, "waypoints"),
    ("track {home}/empty", 2, "/empty: a path needs"),
    ("track {home}/one.csv", 2, "one.csv: a path needs"),
    ("track {home}/words.csv", 2, "words.csv: line 2"),
    ("track circle --approach --no-approach", 2, "cannot be used with"),
    (
        "track circle --modes {home}/modes.toml --controller-process false",
        2,
        "ended (exit status: 1)",
    ),
    ("track circle --controller two-state --controller-process cat", 2, "cannot be used with"),
    ("track {home}/binary", 2, "waypoints"),
    ("track /dev/null", 2, "is a device"),
    ("track /dev/zero", 2, "is a device"),
    ("track {home}/fifo", 2, "is a pipe"),
    ("track {home}/huge", 2, "larger than"),
    ("track circle --modes {home}/fifo", 2, "is a pipe"),
    ("track circle --modes /dev/zero", 2, "is a device"),
    ("track circle --modes {home}/huge", 2, "larger than"),
    ("track circle --modes {home}/none.toml", 2, "none.toml"),
    ("track circle --modes {home}", 2, "directory"),
    ("track circle --modes {home}/broken.toml", 2, "broken.toml"),
    ("track circle --modes {home}/empty", 2, "empty"),
    ("track circle --modes {home}/modes.toml --natnet-server host", 2, "IPv4"),
    ("track circle --modes {home}/modes.toml --natnet-server 1.2.3", 2, "IPv4"),
    ("track circle --modes {home}/modes.toml --natnet-server 255.255.255.255", 2, "IPv4"),
    ("track circle --modes {home}/modes.toml --natnet-server 127.0.0.1:0", 2, "IPv4"),
    ("track circle --modes {home}/modes.toml --natnet-server localhost:9", 10, "Motive"),
    ("track circle --modes {home}/modes.toml --natnet-server 127.0.0.1:99999", 2, "IPv4"),
    ("track circle --modes {home}/modes.toml --natnet-server 127.0.0.1:9", 10, "Motive"),
    ("track circle --modes {home}/modes.toml --up x", 2, "up"),
    ("track circle --modes {home}/modes.toml --pose gps", 2, "--pose"),
    ("track circle --modes {home}/modes.toml --pose udp", 2, "udp:PORT"),
    ("track circle --modes {home}/modes.toml --pose udp:0", 2, "1 to 65535"),
    ("track circle --modes {home}/modes.toml --pose udp:70000", 2, "1 to 65535"),
    ("home --modes {home}/modes.toml --pose udp:5005 --interface 203.0.113.9", 2, "another port"),
    ("track circle --modes {home}/modes.toml --interface eth0", 2, "--interface"),
    ("track circle --modes {home}/modes.toml --interface 203.0.113.9", 2, "network card"),
    // Home.
    ("home --to here", 2, "--to"),
    ("home --to 1,nan", 2, "--to"),
    ("home --to 1e30,0", 2, "within 1000"),
    ("home --modes {home}/none.toml", 2, "none.toml"),
    ("home --fence 0,0,0,0", 2, "--fence"),
    ("home a b", 2, "unexpected argument"),
    // Identify.
    ("identify --seconds 1", 2, "2 to 120"),
    ("identify --seconds -3", 2, "not a time"),
    ("identify --seconds 121s", 2, "2 to 120"),
    ("identify --seconds long", 2, "not a time"),
    ("identify --rounds 0", 2, "--rounds"),
    ("identify --rounds -1", 2, "--rounds"),
    ("identify --rounds 101", 2, "--rounds"),
    ("identify --only flying", 2, "choose from"),
    ("identify --fence 1,2", 2, "--fence"),
    ("identify --frequencies 30", 2, "--grid"),
    ("identify --grid {home}/speeds.csv --frequencies 36", 2, "36"),
    ("identify --grid {home}/speeds.csv --directions 91", 2, "91"),
    ("identify --grid {home}/speeds.csv --least-battery low", 2, "--least-battery"),
    ("identify --grid {home}/speeds.csv --only left", 2, "cannot be used with"),
    ("identify --grid {home}", 2, "speeds.csv"),
    ("identify --grid {home}/speeds.txt", 2, "speeds.csv"),
    ("identify --modes {home}", 2, "is a directory"),
    ("identify --modes {home}/fifo", 2, "is a pipe"),
    ("identify --modes {home}/empty/modes.toml", 2, "modes.toml"),
    ("identify --natnet-server 127.0.0.1:9", 10, "Motive"),
    // Experiment.
    ("experiment", 2, "Usage"),
    ("experiment swim lab", 2, "unrecognized subcommand"),
    ("experiment walks", 2, "DIR"),
    ("experiment walks w {home}/lab x", 2, "unexpected argument"),
    ("experiment walks {home}/lab --pairs 30", 2, "F:THETA"),
    ("experiment walks {home}/lab --pairs -36:0", 2, "-36"),
    ("experiment walks {home}/lab --pairs 30:0,30:91", 2, "91"),
    ("experiment walks {home}/lab --pairs nan:0", 2, "nan"),
    ("experiment walks {home}/lab --repeat 0", 2, "--repeat"),
    ("experiment walks {home}/lab --seconds 1s", 2, "2 to 120"),
    ("experiment walks {home}/lab --fence 1,2", 2, "--fence"),
    ("experiment walks {home}/lab --modes {home}/none.toml", 2, "none.toml"),
    ("experiment walks {home}/lab --natnet-server 127.0.0.1:9", 10, "Motive"),
    ("experiment walks {home}/good.key", 2, "good.key is not a folder"),
    ("experiment walks {home}/other --natnet-server 127.0.0.1:9", 2, "has the columns speed,f_hz"),
    ("experiment walks {home}/torn --natnet-server 127.0.0.1:9", 2, "line 2: this is no whole row"),
    ("experiment air {home}/lab --pairs 4:0", 2, "5 Hz or more"),
    ("experiment air {home}/lab --pairs 28", 2, "F:THETA"),
    ("experiment air {home}/lab --seconds 0.1", 2, "0.5 to 10"),
    ("experiment air {home}/lab --seconds nan", 2, "not a time"),
    ("experiment air {home}/lab --pose udp:0", 2, "1 to 65535"),
    ("experiment air {home}/lab --natnet-server 127.0.0.1:9", 10, "Motive"),
    ("experiment drops", 2, "DIR"),
    ("experiment drops {home}/lab --height 4", 2, "5 to 100 mm"),
    ("experiment drops {home}/lab --height nan", 2, "5 to 100 mm"),
    ("experiment drops {home}/lab --repeat 0", 2, "--repeat"),
    ("experiment drops {home}/lab --pairs 28:0", 2, "unexpected argument"),
    ("experiment drops {home}/lab --natnet-server 127.0.0.1:9", 10, "Motive"),
    // Doctor.
    ("doctor --natnet-server x", 2, "IPv4"),
    ("doctor --json=yes", 2, "--json"),
    // Runs.
    ("runs", 2, "Usage"),
    ("runs open", 2, "unrecognized subcommand"),
    ("runs show --out {home}", 33, "no run"),
    ("runs show none --out {home}", 2, "none"),
    ("runs plot last --out {home}", 33, "no run"),
    ("runs export-csv last --out {home}/none", 33, "no run"),
    ("runs show {home}/empty", 2, "empty"),
    ("runs plot {home}/empty", 2, "empty"),
    ("runs show {home}/binary", 2, "binary"),
    ("runs show {home}/half.mcap", 2, "half.mcap"),
    ("runs show {home}", 2, "directory"),
    ("runs show {home}/fifo", 2, "is a pipe"),
    ("runs plot /dev/zero", 2, "is a device"),
    ("runs repair --out {home}", 33, "no run"),
    ("runs repair {home}/fifo", 2, "is a pipe"),
    ("runs show {home}/huge", 2, "does not begin as an MCAP file"),
    ("runs list --out {home}/fifo", 2, "Not a directory"),
    ("runs list --out /dev/zero", 2, "Not a directory"),
    ("man {home}/one.csv", 2, "one.csv is not a folder"),
    ("man {home}/fifo", 2, "fifo is not a folder"),
    ("man", 2, "DIR"),
    ("runs export-csv {home}/binary", 2, "binary"),
    // Provision.
    ("provision", 2, "Usage"),
    ("provision walker", 2, "--port"),
    ("provision -walker- --port /dev/null", 2, "unexpected argument"),
];

/// Files that rows name, with their contents.
const FILES: &[(&str, &[u8], u32)] = &[
    ("good.key", b"0707070707070707070707070707070707070707070707070707070707070707\n", 0o600),
    ("open.key", b"0707070707070707070707070707070707070707070707070707070707070707\n", 0o644),
    ("short.key", b"0707\n", 0o600),
    ("empty", b"", 0o600),
    ("binary", b"\x00\xff\xfe\x80binary", 0o600),
    ("one.csv", b"x,y\n0,0\n", 0o600),
    ("words.csv", b"0,0\n1,oops\n", 0o600),
    ("broken.toml", b"robot = \n", 0o600),
    ("half.mcap", b"\x89MCAP0\r\n", 0o600),
    ("modes.toml", crate::support::MODES.as_bytes(), 0o600),
    ("other/walks.csv", b"speed,f_hz\n", 0o600),
    ("torn/walks.csv", b"f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s,seconds\n1,2,3", 0o600),
];

fn home() -> tempfile::TempDir {
    use std::os::unix::fs::PermissionsExt;
    let home = tempfile::tempdir().unwrap();
    for (name, content, mode) in FILES {
        let path = home.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(*mode)).unwrap();
    }
    let huge = std::fs::File::create(home.path().join("huge")).unwrap();
    // Without its blocks: it takes no room.
    huge.set_len(1 << 40).unwrap();
    assert!(Command::new("mkfifo").arg(home.path().join("fifo")).status().unwrap().success());
    home
}

fn flix(home: &Path, line: &str) -> Option<Output> {
    let line = line.replace("{home}", home.to_str().unwrap());
    let mut child = Command::new(env!("CARGO_BIN_EXE_flix"))
        .args(line.split_whitespace())
        .current_dir(home)
        .env("XDG_CONFIG_HOME", home)
        .env("HOME", home)
        .env_remove("FLIX_KEY_FILE")
        .env_remove("FLIX_ROBOT")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begin.elapsed() > LONGEST {
            child.kill().unwrap();
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Some(child.wait_with_output().unwrap())
}

#[test]
fn help_that_cannot_be_printed_is_an_error_and_a_closed_pipe_is_none() {
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    for words in [&["--help"][..], &["--version"], &["drive", "--help"], &["help", "track"]] {
        let flix = || Command::new(env!("CARGO_BIN_EXE_flix"));
        let output = flix().args(words).stdout(full()).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{words:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("No space left"), "{words:?}");
        let mut child = flix().args(words).stdout(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{words:?}");
    }
}

#[test]
fn bad_input_ends_with_its_exit_code_and_a_sentence() {
    let home = home();
    // They wait for robots that do not answer: side by side.
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let parts = ROWS.chunks(ROWS.len().div_ceil(SIDE_BY_SIDE));
        let parts: Vec<_> = parts
            .map(|rows| {
                scope.spawn(|| {
                    rows.iter().filter_map(|row| wrong(home.path(), row)).collect::<Vec<_>>()
                })
            })
            .collect();
        parts.into_iter().flat_map(|part| part.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{} of {}:\n{}", wrong.len(), ROWS.len(), wrong.join("\n"));
}

/// Returns what a command line does instead of what its row says.
fn wrong(home: &Path, (line, code, word): &(&str, i32, &str)) -> Option<String> {
    let Some(output) = flix(home, line) else { return Some(format!("flix {line}: hangs")) };
    let said = String::from_utf8_lossy(&output.stderr);
    let steers = said.contains(|letter: char| letter.is_control() && !"\n\t".contains(letter));
    let is_right = output.status.code() == Some(*code)
        && said.contains(word)
        && !said.contains("panicked")
        && !steers;
    (!is_right).then(|| format!("flix {line}: {:?} {said}", output.status.code()))
}
