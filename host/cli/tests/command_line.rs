//! The `flix` command line against a robot on loopback: exit codes, sentences, JSON, signals.
use std::io::{Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{FakeRobot, MODES, ServedRobot, key, seeded_loss};
use flix_host::link::keys;
use flix_host::link::udp::{self, Connection};
use flix_host::link::{LinkError, RobotLink};
use flix_host::nav::PlanarPose;
use flix_host::pose::Pose;
use flix_host::pose::natnet::{NatNetServer, ServerSettings};
use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::{
    BuildId, CrashReport, Fault, FaultSummary, Faults, Mark, MotorCurrents, ResetReason, Setpoint,
    State, ToRobot,
};
use flix_protocol::session::{ConnectError, Key};
use flix_protocol::units::{Amperes, Degrees, Hertz};
use object::{Object, ObjectSymbol, SymbolKind};
use sha2::{Digest, Sha256};

/// An operator's account: a home of its own, and a key file.
struct Operator {
    home: tempfile::TempDir,
    key: PathBuf,
}

impl Operator {
    fn new() -> Self {
        Self::with_key(&key())
    }

    fn with_key(secret: &Key) -> Self {
        let home = tempfile::tempdir().unwrap();
        let key = home.path().join("robot.key");
        keys::write_new(&key, secret).unwrap();
        Self { home, key }
    }

    /// `flix` with these words, then the key.
    fn command(&self, words: &[&str]) -> Command {
        let mut command = self.command_without_key(words);
        command.arg("--key").arg(&self.key);
        command
    }

    fn command_without_key(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flix"));
        command
            .args(words)
            .env("XDG_CONFIG_HOME", self.home.path())
            .env("HOME", self.home.path())
            .env_remove("FLIX_KEY_FILE")
            .env_remove("FLIX_ROBOT")
            .current_dir(self.home.path())
            .stdin(Stdio::null());
        command
    }

    fn flix(&self, words: &[&str]) -> Ended {
        Ended(self.command(words).output().unwrap())
    }
}

/// A shell that runs this line for an operator, with `flix` as `$0`, the robot's address as `$1` and the key file as `$2`.
fn shell(operator: &Operator, line: &str, address: &str) -> Ended {
    let mut shell = Command::new("bash");
    shell.args(["-c", line, env!("CARGO_BIN_EXE_flix"), address]).arg(&operator.key);
    shell.env("XDG_CONFIG_HOME", operator.home.path()).env_remove("FLIX_KEY_FILE");
    Ended(shell.current_dir(operator.home.path()).stdin(Stdio::null()).output().unwrap())
}

#[test]
fn a_key_comes_by_a_pipe_or_standard_input_where_its_file_is_not_ones_own() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    std::fs::set_permissions(&operator.key, std::fs::Permissions::from_mode(0o644)).unwrap();
    for line in [
        r#"exec "$0" stop "$1" --key - < "$2""#,
        r#"cat "$2" | "$0" stop "$1" --key -"#,
        r#"exec "$0" stop "$1" --key <(cat "$2")"#,
        r#"FLIX_KEY_FILE=- exec "$0" stop "$1" < "$2""#,
    ] {
        shell(&operator, line, &address).expect(0, &[]);
        assert!(std::mem::take(&mut served.robot().stopped), "{line}");
    }
    let exposed = r#"exec "$0" stop "$1" --key "$2""#;
    shell(&operator, exposed, &address).expect(2, &["chmod 600", "--key - <"]);
    let twice = r#"exec "$0" parameters import "$1" - --key - <<< "$(echo [settings]; echo a=1)""#;
    shell(&operator, twice, &address).expect(2, &["standard input", "read already"]);
    // Who gives up is not held by a pipe that says nothing.
    let silent = r#"exec timeout --signal INT --kill-after 5 1 "$0" stop "$1" --key <(sleep 9)"#;
    shell(&operator, silent, &address).expect(124, &[]);
}

#[test]
fn a_drive_on_a_low_battery_says_so_and_records_it() {
    let mut low = robot();
    low.is_low = true;
    let (_served, address) = serve(low);
    let operator = Operator::new();
    operator.flix(&drive(&address, &[])).expect(0, &["flix: battery low: 9.5 V"]);
    let folder = std::fs::read_dir(operator.home.path().join("out/runs")).unwrap();
    let file = folder.flatten().map(|it| it.path()).find(|it| it.extension().is_some());
    let run = flix_host::record::Run::read(&file.unwrap()).unwrap();
    assert!(run.events.iter().any(|row| format!("{row:?}").contains("battery low")));
}

#[test]
fn a_terminal_that_takes_nothing_holds_up_no_drive() {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::os::unix::ffi::OsStringExt as _;
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let outside = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&outside).unwrap();
    unlockpt(&outside).unwrap();
    let name = std::ffi::OsString::from_vec(ptsname(&outside, Vec::new()).unwrap().into_bytes());
    let terminal = std::fs::File::options().read(true).write(true).open(name).unwrap();
    // As Ctrl-S does.
    rustix::termios::tcflow(&terminal, rustix::termios::Action::OOff).unwrap();
    let mut command = operator.command(&drive(&address, &["--json"]));
    let output = command.stderr(terminal.try_clone().unwrap()).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&output.stdout).contains("{"), "the drive is reported");
    // The stop has left before; the printed text is given up after a second.
    let stop = operator.command(&["stop", &address]).stdout(terminal).output().unwrap();
    let said = String::from_utf8_lossy(&stop.stderr);
    assert!(stop.status.code() == Some(2) && said.contains("the terminal takes nothing"), "{said}");
    assert!(served.robot().stopped);
}

#[test]
fn a_full_disk_leaves_an_exported_file_as_it_was_and_the_new_one_is_printed() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let file = operator.home.path().join("walker.toml");
    std::fs::write(&file, "old").unwrap();
    for line in [
        r#"ulimit -f 0; exec "$0" parameters export "$1" walker.toml --key "$2""#,
        r#"exec "$0" parameters export "$1" /dev/full --key "$2""#,
    ] {
        let ended = shell(&operator, line, &address);
        assert_eq!(ended.code(), 2, "{}", ended.stderr());
        assert!(ended.stdout().contains("[settings]"), "{}", ended.stdout());
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "old");
    let line = r#"ln -s walker.toml link; exec "$0" parameters export "$1" link --key "$2""#;
    assert_eq!(shell(&operator, line, &address).expect(0, &[]).stdout(), "");
    assert!(std::fs::read_to_string(&file).unwrap().contains("[settings]"));
}

#[test]
fn an_error_or_a_kill_at_any_call_leaves_a_file_that_is_replaced_whole() {
    if !is_installed("strace") {
        return;
    }
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let home = operator.home.path();
    let record = crate::walked::write_record_of(home, 2);
    let bytes = std::fs::read(&record).unwrap();
    std::fs::write(&record, &bytes[..bytes.len() - 40]).unwrap();
    let stem = record.file_stem().unwrap().to_str().unwrap();
    let at = |ending: &str| home.join(format!("{stem}{ending}"));
    let run = record.to_str().unwrap();
    let to = ["--to", home.to_str().unwrap()];
    let settings = home.join("walker.toml");
    let exported = ["parameters", "export", &address, settings.to_str().unwrap()];
    for (words, file) in [
        (exported.to_vec(), settings.clone()),
        ([&["runs", "export-csv", run][..], &to].concat(), at("-pose.csv")),
        ([&["runs", "export-ros2", run][..], &to].concat(), at("-ros2/bag.mcap")),
        ([&["runs", "plot", run][..], &to].concat(), at("-track.svg")),
        (vec!["runs", "repair", run], record.clone()),
    ] {
        let _ = std::fs::create_dir(at("-ros2"));
        if file != record {
            std::fs::write(&file, "old").unwrap();
        }
        let old = std::fs::read(&file).unwrap();
        let mut flix = match words[0] {
            "runs" => operator.command_without_key(&words),
            _ => operator.command(&words),
        };
        let part = format!("{}.part", file.display());
        for call in ["openat", "write", "fsync", "/^rename"] {
            for harm in ["error=EIO", "signal=KILL"] {
                let mut strace = Command::new("strace");
                strace.args(["-f", "-qq", "-o", "/dev/null", "-P", &part, "-e"]);
                strace.arg(format!("inject={call}:{harm}")).arg(flix.get_program());
                strace.args(flix.get_args()).current_dir(home);
                strace.envs(flix.get_envs().filter_map(|(name, value)| Some((name, value?))));
                let ended = strace.stdin(Stdio::null()).output().unwrap();
                let said = String::from_utf8_lossy(&ended.stderr);
                assert!(!ended.status.success(), "{words:?}: no {call} with {harm}");
                assert!(
                    harm != "error=EIO" || said.contains("error 5") || said.contains("I/O error"),
                    "{words:?}, {call}: {said}"
                );
                assert!(std::fs::read(&file).unwrap() == old, "{words:?}, {call}, {harm}");
            }
        }
        // The unfinished file of a killed program does not hinder the next one.
        Ended(flix.output().unwrap()).expect(0, &[]);
        assert!(std::fs::read(&file).unwrap() != old && !PathBuf::from(part).exists());
    }
}

#[test]
fn of_two_keys_the_one_that_the_robot_answers_by_is_used_and_kept() {
    let other = Key::new([9; 32]);
    for command in ["status", "stop"] {
        for (former, offered, left) in [(&other, &key(), None), (&key(), &other, Some(&other))] {
            let operator = Operator::new();
            let keyring = keys::Keyring::in_directory(operator.home.path().join("flix/robots"));
            keyring.store("simulated", former).unwrap();
            keyring.offer("simulated", offered).unwrap();
            let robot = ServedRobot::steady(FakeRobot::new(Some(key())));
            let address = robot.address.to_string();
            let output = operator.command_without_key(&[command, &address]).output().unwrap();
            let complaint = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(0), "{command}: {complaint}");
            assert_eq!(keyring.key("simulated").unwrap(), key());
            assert_eq!(keyring.offered("simulated").unwrap().as_ref(), left);
            let is_warned = complaint.contains("whoever knows the former one");
            assert_eq!(is_warned, left.is_some(), "{command}: {complaint}");
        }
    }
}

#[test]
fn a_robot_is_stopped_by_all_keys_at_once_and_says_which_it_has() {
    let robot = ServedRobot::steady(FakeRobot::new(Some(key())));
    let (others, own) = ([8, 9].map(|byte| Key::new([byte; 32])), key());
    let interrupt = Interrupt::never();
    let by =
        udp::stop(robot.address, &[&others[0], &own, &others[1]], &interrupt, || None).unwrap();
    assert!(by == 1 && robot.robot().stopped);
    let refused = udp::stop(robot.address, &[&others[0], &others[1]], &interrupt, || None);
    assert!(matches!(refused, Err(LinkError::Connect(ConnectError::WrongKey))), "{refused:?}");
}

#[test]
fn a_new_key_that_cannot_be_read_is_complained_of_and_in_nobodys_way() {
    for (text, mode) in [("", 0o600), ("no key", 0o600), (&"0".repeat(64), 0o644)] {
        let operator = Operator::new();
        let folder = operator.home.path().join("flix/robots");
        keys::Keyring::in_directory(folder.clone()).store("simulated", &key()).unwrap();
        let new = folder.join("simulated.new");
        std::fs::write(&new, text).unwrap();
        std::fs::set_permissions(&new, std::fs::Permissions::from_mode(mode)).unwrap();
        let robot = ServedRobot::steady(FakeRobot::new(Some(key())));
        let address = robot.address.to_string();
        for command in ["stop", "status"] {
            let output = operator.command_without_key(&[command, &address]).output().unwrap();
            Ended(output).expect(0, &["simulated is ignored", "simulated.new"]);
        }
        assert!(robot.robot().stopped && new.exists());
    }
}

/// A tracker that sends the poses of a robot on a circle, as text.
struct Tracker {
    /// For `--pose`.
    source: String,
    _end: std::sync::mpsc::Sender<()>,
}

impl Tracker {
    const SPEED: f64 = 0.2;
    const YAW_RATE: f64 = 1.0;

    fn start() -> Self {
        let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let (end, ended) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let (socket, start) = (UdpSocket::bind("127.0.0.1:0").unwrap(), Instant::now());
            let radius = Self::SPEED / Self::YAW_RATE;
            let slice = Duration::from_millis(5);
            while ended.recv_timeout(slice) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                let heading = Self::YAW_RATE * start.elapsed().as_secs_f64();
                let (x, y) = (radius * heading.sin(), radius * (1.0 - heading.cos()));
                let _ = socket.send_to(format!("{x} {y} 0.06 0 0 {heading}").as_bytes(), free);
            }
        });
        Self { source: format!("udp:{}", free.port()), _end: end }
    }
}

struct Ended(Output);

impl Ended {
    fn code(&self) -> i32 {
        self.0.status.code().unwrap()
    }

    fn stdout(&self) -> String {
        String::from_utf8(self.0.stdout.clone()).unwrap()
    }

    fn stderr(&self) -> String {
        String::from_utf8(self.0.stderr.clone()).unwrap()
    }

    fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout()).unwrap()
    }

    #[track_caller]
    fn expect(self, code: i32, words: &[&str]) -> Self {
        let said = self.stderr();
        assert_eq!(self.code(), code, "stderr: {said}");
        for word in words {
            assert!(said.contains(word), "`{word}` is missing in: {said}");
        }
        if code != 0 {
            assert_eq!(self.stdout(), "", "a failure prints nothing on stdout");
        }
        self
    }
}

fn serve(robot: FakeRobot) -> (ServedRobot, String) {
    let served = ServedRobot::steady(robot);
    let address = served.address.to_string();
    (served, address)
}

fn robot() -> FakeRobot {
    FakeRobot::new(Some(key()))
}

const FORWARD: [&str; 6] = ["--frequency", "-30", "--direction", "30", "--for", "300ms"];

fn drive<'a>(address: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["drive", address][..], &FORWARD, more].concat()
}

#[test]
fn drive_shakes_as_commanded_and_leaves_the_robot_disarmed() {
    let (served, address) = serve(robot());
    let ended = Operator::new().flix(&drive(&address, &["--json"])).expect(0, &[]);
    let json = ended.json();
    assert_eq!(json["commanded"]["frequency_hz"], -30.0);
    assert_eq!(json["commanded"]["direction_deg"], 30.0);
    assert!((json["held"]["frequency_hz"].as_f64().unwrap() + 30.0).abs() < 0.01);
    assert_eq!(served.robot().state, State::Disarmed);
    assert!(!served.robot().stopped, "a finished drive is no stop");
}

#[test]
fn a_drive_with_poses_reports_how_the_robot_moved() {
    let (_served, address) = serve(robot());
    let tracker = Tracker::start();
    let ended = Operator::new().flix(&drive(&address, &["--json", "--pose", &tracker.source]));
    let json = ended.expect(0, &[]).json();
    // Both are as fast as the tracker says, however long the drive was.
    let moved = |name: &str| json["moved"][name].as_f64().unwrap();
    let ratio = moved("turned_deg").to_radians() / moved("forward_m").hypot(moved("left_m"));
    assert!((ratio - Tracker::YAW_RATE / Tracker::SPEED).abs() < 0.5, "{json}");
    assert!(moved("yaw_rate_rad_s") > 0.5, "{json}");
}

#[test]
fn drive_gets_through_a_link_that_loses_a_fifth() {
    let served = ServedRobot::new(robot(), seeded_loss(3, 0.2));
    let address = served.address.to_string();
    Operator::new().flix(&drive(&address, &[])).expect(0, &[]);
}

#[test]
fn a_drive_goes_on_after_its_commands_were_late_for_a_moment() {
    let mut hears_late = robot();
    hears_late.reports_of_late_commands = 5;
    let (served, address) = serve(hears_late);
    Operator::new().flix(&drive(&address, &[])).expect(0, &[]);
    assert_eq!(served.robot().reports_of_late_commands, 0);
    assert!(!served.robot().stopped);
}

#[test]
fn numbers_out_of_range_are_usage_and_name_the_range() {
    let operator = Operator::new();
    for (frequency, direction, range) in [
        ("36", "0", "-35 to 35"),
        ("-35.5", "0", "-35 to 35"),
        ("NaN", "0", "-35 to 35"),
        ("-inf", "0", "-35 to 35"),
        ("30", "91", "-90 to 90"),
        ("30", "-nan", "-90 to 90"),
    ] {
        let words = [
            "drive",
            "127.0.0.1:9",
            "--frequency",
            frequency,
            "--direction",
            direction,
            "--for",
            "1s",
        ];
        operator.flix(&words).expect(2, &[range]);
    }
}

#[test]
fn a_robot_with_another_key_is_refused_with_a_sentence() {
    let (_served, address) = serve(robot());
    let other = Operator::with_key(&Key::new([8; 32]));
    for words in [drive(&address, &[]), vec!["status", &address], vec!["stop", &address]] {
        other.flix(&words).expect(20, &["key"]);
    }
}

#[test]
fn a_robot_without_a_key_is_refused_with_what_to_do() {
    let (_served, address) = serve(FakeRobot::new(None));
    Operator::new().flix(&["status", &address]).expect(20, &["no key yet", "provision"]);
}

#[test]
fn nobody_there_is_no_answer() {
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap().to_string();
    Operator::new().flix(&["status", &address]).expect(10, &["does not answer"]);
}

#[test]
fn a_name_that_nobody_knows_is_no_answer() {
    let name = "no-such-robot.invalid";
    Operator::new().flix(&["status", name]).expect(10, &[name, "flix discover"]);
}

#[test]
fn a_robot_of_another_version_is_refused_with_what_to_update() {
    const NEWER: u16 = flix_protocol::session::PROTOCOL_VERSION + 1;
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    let refuser = std::thread::spawn(move || refuse_version(&socket, NEWER));
    Operator::new()
        .flix(&["status", &address])
        .expect(20, &[&format!("version {NEWER}"), "update this program"]);
    refuser.join().unwrap();
}

/// Answers every Hello for a while as a robot of this version would; see `flix_protocol::frame`.
fn refuse_version(socket: &UdpSocket, version: u16) {
    socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let start = Instant::now();
    let mut hello = [0; 600];
    while start.elapsed() < Duration::from_secs(2) {
        let Ok((62, operator)) = socket.recv_from(&mut hello) else { continue };
        let mut refusal = b"flx\x05\x01".to_vec();
        refusal.extend(version.to_le_bytes());
        refusal.extend(77u64.to_le_bytes());
        refusal.extend(&hello[14..30]);
        refusal.extend([0; 16]);
        socket.send_to(&refusal, operator).unwrap();
    }
}

#[test]
fn a_robot_that_a_program_of_ones_own_holds_is_refused_as_busy() {
    let (_served, address) = serve(robot());
    let first = hold_session(address.parse().unwrap());
    Operator::new().flix(&["status", &address]).expect(21, &["you hold the robot already"]);
    first.0.raise();
    first.1.join().unwrap();
    Operator::new().flix(&["status", &address]).expect(0, &[]);
}

#[test]
fn programs_of_the_same_key_beside_a_walk_change_nothing_but_stop_stops_the_robot() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let mut driving = long_drive(&operator, &served);
    let orders = |served: &ServedRobot| {
        let is_order = |it: &&ToRobot| matches!(it, ToRobot::Order(_));
        served.robot().messages.iter().filter(is_order).cloned().collect::<Vec<_>>()
    };
    let before = orders(&served);
    let scope = ["scope", &address, "--channels", "iq"];
    for beside in [&["status", &address][..], &scope, &["link-test", &address, "--for", "100ms"]] {
        operator.flix(beside).expect(21, &["you hold the robot already"]);
        assert_eq!(served.robot().state, State::Running, "{beside:?}");
        assert_eq!(orders(&served), before, "{beside:?}");
    }
    operator.flix(&["stop", &address]).expect(0, &[]);
    wait_until(|| served.robot().state.is_idle() && served.robot().stopped);
    assert_ne!(driving.wait().unwrap().code(), Some(0));
}

/// Another operator, who stays until the flag is raised.
fn hold_session(address: SocketAddr) -> (Interrupt, std::thread::JoinHandle<()>) {
    let ends = Interrupt::never();
    let mut connection = Connection::open(address, key(), ends.clone()).unwrap();
    connection.wait_until_connected().unwrap();
    let thread = std::thread::spawn(move || {
        let _ = connection.wait_for(Duration::from_secs(60), |_, _| None::<()>);
    });
    (ends, thread)
}

/// Starts a drive of a minute, and waits until the robot runs.
fn long_drive(operator: &Operator, served: &ServedRobot) -> Child {
    drive_until(operator, served, State::Running)
}

fn drive_until(operator: &Operator, served: &ServedRobot, state: State) -> Child {
    let address = served.address.to_string();
    let words = drive(&address, &[]);
    run_until(operator, served, &[&words[..words.len() - 1], &["60s"]].concat(), state)
}

/// Starts to follow a circle, and waits for this state.
fn track_until(
    operator: &Operator,
    served: &ServedRobot,
    cameras: &Cameras,
    state: State,
) -> Child {
    let modes = operator.home.path().join("modes.toml");
    std::fs::write(&modes, MODES).unwrap();
    let (robot, modes) = (served.address.to_string(), modes.to_str().unwrap());
    let poses = ["--natnet-server", &cameras.address, "--modes", modes];
    run_until(operator, served, &[&["track", &robot, "circle"][..], &poses].concat(), state)
}

fn run_until(operator: &Operator, served: &ServedRobot, words: &[&str], state: State) -> Child {
    let mut command = operator.command(words);
    let child = command.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    wait_until(|| served.robot().state == state);
    child
}

#[test]
fn a_stop_while_the_motors_are_aligned_ends_a_run_by_name() {
    let cameras = Cameras::start();
    let operator = Operator::new();
    let starts: [&dyn Fn(&ServedRobot) -> Child; 2] =
        [&|served| drive_until(&operator, served, State::Aligning), &|served| {
            track_until(&operator, served, &cameras, State::Aligning)
        }];
    for start in starts {
        let mut robot = robot();
        robot.aligns_for_ever = true;
        let (served, _) = serve(robot);
        let child = start(&served);
        let bob = "bob".parse().unwrap();
        let mut robot = served.robot();
        (robot.state, robot.stopped, robot.stopped_by) = (State::Disarmed, true, bob);
        drop(robot);
        Ended(child.wait_with_output().unwrap()).expect(31, &["bob stopped the robot"]);
    }
}

#[test]
fn anybody_with_the_key_stops_a_drive_and_its_operator_learns_of_it() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let child = long_drive(&operator, &served);
    Operator::new().flix(&["stop", &address]).expect(0, &[]);
    assert!(served.robot().stopped);
    Ended(child.wait_with_output().unwrap()).expect(31, &["owner stopped the robot"]);
}

#[test]
fn a_drive_whose_robot_stops_by_itself_points_at_the_link() {
    let (served, _) = serve(robot());
    let operator = Operator::new();
    let child = long_drive(&operator, &served);
    served.robot().lose_link();
    let ended = Ended(child.wait_with_output().unwrap());
    ended.expect(34, &["stopped by itself", "flix link-test"]);
    // It is disarmed, and no order of the drive moves it any more: there is nothing to stop.
    assert!(!served.robot().stopped);
}

#[test]
fn everybody_learns_who_stopped_the_robot() {
    let mut stopped = robot();
    (stopped.stopped, stopped.stopped_by) = (true, "bob".parse().unwrap());
    let (_served, address) = serve(stopped);
    let operator = Operator::new();
    let json = operator.flix(&["status", &address, "--json"]).expect(0, &[]).json();
    assert_eq!((&json["stopped"], &json["stopped_by"]), (&true.into(), &"bob".into()));
    let text = operator.flix(&["status", &address]).expect(0, &[]).stdout();
    assert!(text.contains("stopped by bob: `flix clear`"), "{text}");
    operator.flix(&drive(&address, &[])).expect(31, &["bob stopped the robot", "flix clear"]);
    let doctor = operator.flix(&["doctor", &address, "--no-poses"]);
    assert_eq!(doctor.code(), 31);
    assert!(doctor.stdout().contains("bob stopped the robot"), "{}", doctor.stdout());
}

#[test]
fn a_drive_whose_robot_restarts_says_so_and_stops_what_still_moves_alone() {
    let (served, _) = serve(robot());
    let operator = Operator::new();
    let child = long_drive(&operator, &served);
    served.robot().restart();
    let ended = Ended(child.wait_with_output().unwrap());
    assert!(!ended.expect(10, &["restarted", "flix status"]).stderr().contains("flix clear"));
    assert!(!served.robot().stopped);
    // One that still brakes what it found spinning.
    let child = long_drive(&operator, &served);
    {
        let mut robot = served.robot();
        robot.restart();
        robot.ramps_down_for = 1_000;
    }
    let ended = Ended(child.wait_with_output().unwrap());
    ended.expect(10, &["restarted", "has acknowledged a stop", "flix clear"]);
    assert!(served.robot().stopped);
}

#[test]
fn an_operator_whose_key_is_revoked_while_driving_is_told_so() {
    let (served, _) = serve(robot());
    let operator = Operator::new();
    let child = long_drive(&operator, &served);
    served.robot().revoke();
    Ended(child.wait_with_output().unwrap()).expect(20, &["your key was revoked"]);
}

#[test]
fn an_operator_whose_key_is_revoked_while_walking_is_told_so() {
    let cameras = Cameras::start();
    let (served, _) = serve(robot());
    let operator = Operator::new();
    let child = track_until(&operator, &served, &cameras, State::Running);
    served.robot().revoke();
    Ended(child.wait_with_output().unwrap()).expect(20, &["your key was revoked", ".mcap"]);
}

#[test]
fn a_stop_with_another_key_is_refused() {
    let (served, address) = serve(robot());
    let other = Operator::with_key(&Key::new([8; 32]));
    other.flix(&["stop", &address]).expect(20, &["another key"]);
    assert!(!served.robot().stopped);
}

#[test]
fn every_way_to_end_a_drive_stops_the_robot_first() {
    for signal in ["INT", "TERM", "HUP", "QUIT"] {
        let (served, _) = serve(robot());
        let operator = Operator::new();
        let child = long_drive(&operator, &served);
        kill(signal, child.id());
        let ended = Ended(child.wait_with_output().unwrap());
        ended.expect(40, &["interrupted", "has acknowledged the stop"]);
        assert!(served.robot().stopped, "SIG{signal}");
        assert_eq!(served.robot().state, State::Disarmed, "SIG{signal}");
    }
}

#[test]
fn an_interrupted_drive_ends_even_when_the_robot_is_gone() {
    let (served, _) = serve(robot());
    let operator = Operator::new();
    let child = long_drive(&operator, &served);
    drop(served);
    kill("INT", child.id());
    let start = Instant::now();
    Ended(child.wait_with_output().unwrap()).expect(40, &["has not acknowledged"]);
    assert!(start.elapsed() < Duration::from_secs(5));
}

#[test]
fn every_way_to_end_a_walk_stops_the_robot_first() {
    let cameras = Cameras::start();
    for signal in ["INT", "TERM", "HUP", "QUIT"] {
        let (served, address) = serve(robot());
        let operator = Operator::new();
        let modes = operator.home.path().join("modes.toml");
        std::fs::write(&modes, MODES).unwrap();
        let mut command = operator.command(&["track", &address, "circle", "--pose", "natnet"]);
        command.args(["--natnet-server", &cameras.address, "--modes"]).arg(&modes);
        command.arg("--out").arg(operator.home.path());
        let child = command.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        wait_until(|| served.robot().state == State::Running);
        kill(signal, child.id());
        Ended(child.wait_with_output().unwrap()).expect(40, &["the robot was stopped", ".mcap"]);
        assert!(served.robot().stopped, "SIG{signal}");
        assert_eq!(served.robot().state, State::Disarmed, "SIG{signal}");
    }
}

/// `flix track` whose files may not grow beyond 512 KiB, as on a full disk.
fn track_on_a_full_disk(operator: &Operator, address: &str, cameras: &Cameras) -> Command {
    let modes = operator.home.path().join("modes.toml");
    std::fs::write(&modes, MODES).unwrap();
    let mut shell = Command::new("bash");
    shell.args(["-c", "ulimit -f 512; exec \"$@\"", "bash"]);
    shell.arg(env!("CARGO_BIN_EXE_flix")).args(["track", address, "circle", "--natnet-server"]);
    shell.arg(&cameras.address).arg("--modes").arg(&modes).arg("--key").arg(&operator.key);
    shell.arg("--out").arg(operator.home.path()).env("HOME", operator.home.path());
    shell
}

#[test]
fn a_full_disk_stops_the_robot_and_the_record_up_to_then_can_be_read() {
    let cameras = Cameras::start();
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let output = track_on_a_full_disk(&operator, &address, &cameras).output().unwrap();
    let ended = Ended(output);
    let said = ended.stderr();
    assert_eq!(said.matches("cannot write the record").count(), 1, "{said}");
    ended.expect(2, &["cannot write the record", "the robot was stopped", "flix clear"]);
    assert!(served.robot().stopped);
    let runs = flix_host::record::list(operator.home.path()).unwrap().runs;
    let run = flix_host::record::Run::read(&runs[0].file).unwrap();
    assert!(!run.poses.is_empty() && !run.telemetry.is_empty());
}

#[test]
fn a_full_disk_is_reported_at_once_when_the_run_goes_on_without_a_record() {
    use std::io::{BufRead, BufReader};
    let cameras = Cameras::start();
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let mut command = track_on_a_full_disk(&operator, &address, &cameras);
    command.arg("--unrecorded").stderr(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut said = String::new();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    while !said.contains("cannot write the record") {
        assert_ne!(errors.read_line(&mut said).unwrap(), 0, "{said}");
    }
    assert_eq!(served.robot().state, State::Running, "it walks on");
    kill("INT", child.id());
    assert_eq!(child.wait().unwrap().code(), Some(40));
}

#[test]
fn a_drive_whose_record_fails_reports_its_figures_all_the_same() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let mut long = Command::new("bash");
    long.args(["-c", "ulimit -f 64; exec \"$@\"", "bash", env!("CARGO_BIN_EXE_flix")])
        .args(["drive", &address, "--frequency", "-30", "--direction", "30", "--for", "10s"])
        .args(["--json", "--key"])
        .arg(&operator.key)
        .current_dir(operator.home.path())
        .env("HOME", operator.home.path());
    let ended = Ended(long.output().unwrap());
    assert_eq!(ended.code(), 2, "{}", ended.stderr());
    assert!(ended.stderr().contains("cannot write the record"), "{}", ended.stderr());
    let json = ended.json();
    assert!(json["held"]["frequency_hz"].is_number() && json["record"].is_null(), "{json}");
    assert_eq!(served.robot().state, State::Disarmed);
}

#[test]
fn a_program_that_panics_stops_the_robot_first() {
    let (served, address) = serve(robot());
    let mut connection =
        Connection::open(address.parse().unwrap(), key(), Interrupt::never()).unwrap();
    let program = std::thread::spawn(move || {
        connection.wait_until_connected().unwrap();
        connection.arm().unwrap();
        let (client, now) = connection.operate();
        client.hold(now, Setpoint::new(Hertz::saturating(30.0), Degrees::ZERO).unwrap());
        connection
            .wait_for_telemetry(Duration::from_secs(5), |it| it.state == State::Running)
            .unwrap();
        panic!("this test is about a program that breaks");
    });
    program.join().unwrap_err();
    assert!(served.robot().stopped);
    assert_eq!(served.robot().state, State::Disarmed);
}

/// One mode is enough to walk away with.
/// Motion capture of a robot that goes back and forth on a circle of 0.4 m.
struct Cameras {
    address: String,
    ends: Interrupt,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Cameras {
    fn start() -> Self {
        let settings = ServerSettings { multicast: None, ..ServerSettings::default() };
        let mut server = NatNetServer::bind(([127, 0, 0, 1], 0).into(), settings).unwrap();
        let address = server.local_addr().unwrap().to_string();
        let ends = Interrupt::never();
        let end = ends.clone();
        let thread = std::thread::spawn(move || {
            let begin = Instant::now();
            while !end.is_raised() {
                let time = begin.elapsed();
                let y = 0.1 * time.as_secs_f64().sin();
                let pose = Pose::planar(PlanarPose { x: 0.4, y, heading: 1.5 }, 0.06);
                server.serve(flix_protocol::units::Instant::START + time).unwrap();
                server.stream(time.as_secs_f64(), Some(&pose)).unwrap();
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        Self { address, ends, thread: Some(thread) }
    }
}

impl Drop for Cameras {
    fn drop(&mut self) {
        self.ends.raise();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn kill(signal: &str, process: u32) {
    let signal = format!("-{signal}");
    assert!(Command::new("kill").args([&signal, &process.to_string()]).status().unwrap().success());
}

#[track_caller]
fn wait_until(condition: impl Fn() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < Duration::from_secs(10), "it did not come about");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_fault_ends_the_drive_with_its_name_and_what_to_do() {
    let mut stalls = robot();
    stalls.fault_when_running = Some(Fault::Stall);
    let (_served, address) = serve(stalls);
    Operator::new().flix(&drive(&address, &[])).expect(30, &["stall", "free the rotor"]);
}

#[test]
fn a_stopped_robot_is_driven_again_only_after_clear() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    operator.flix(&["stop", &address]).expect(0, &[]);
    assert!(served.robot().stopped);
    operator.flix(&drive(&address, &[])).expect(31, &["owner stopped the robot", "flix clear"]);
    let cleared = operator.flix(&["clear", &address]).expect(0, &[]).stdout();
    assert_eq!(cleared, "cleared: the stop of owner\nready\n");
    operator.flix(&drive(&address, &[])).expect(0, &[]);
}

#[test]
fn clear_names_the_faults_that_it_cleared() {
    let mut robot = robot();
    robot.fail(Fault::Stall);
    let (_served, address) = serve(robot);
    let operator = Operator::new();
    let cleared = operator.flix(&["clear", &address]).expect(0, &[]).stdout();
    assert!(cleared.starts_with("cleared: stall: "), "{cleared}");
    assert!(cleared.ends_with("free the rotor\nready\n"), "{cleared}");
}

#[test]
fn a_stop_that_came_after_clear_was_typed_stays() {
    let mut robot = robot();
    // At this moment, whenever that is.
    (robot.stopped, robot.stopped_at) =
        (true, Some(flix_protocol::units::Instant::from_micros(u64::MAX)));
    let (served, address) = serve(robot);
    let operator = Operator::new();
    operator.flix(&["clear", &address]).expect(31, &["owner stopped the robot"]);
    assert!(served.robot().stopped);
}

#[test]
fn a_fault_that_came_after_clear_was_typed_stays() {
    let mut robot = robot();
    robot.fail(Fault::Stall);
    robot.failed_at = Some(flix_protocol::units::Instant::from_micros(u64::MAX));
    let (served, address) = serve(robot);
    let operator = Operator::new();
    operator.flix(&["clear", &address]).expect(30, &["stall"]);
    assert!(!served.robot().faults.is_empty());
}

#[test]
fn a_stopped_robot_walks_again_only_after_clear() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    operator.flix(&["stop", &address]).expect(0, &[]);
    let cameras = Cameras::start();
    let modes = operator.home.path().join("modes.toml");
    std::fs::write(&modes, MODES).unwrap();
    let mut command = operator.command(&["track", &address, "circle"]);
    command.args(["--natnet-server", &cameras.address, "--modes"]).arg(&modes);
    command.arg("--out").arg(operator.home.path());
    Ended(command.output().unwrap()).expect(31, &["flix clear"]);
    assert!(served.robot().stopped, "only `flix clear` clears a latched stop");
}

#[test]
fn commands_wait_for_a_state_that_passes() {
    let operator = Operator::new();
    for words in [&["clear"][..], &["drive"]] {
        let mut busy = robot();
        (busy.stopped, busy.ramps_down_for) = (words == ["clear"], 3);
        let (served, address) = serve(busy);
        let words = if words == ["drive"] { drive(&address, &[]) } else { vec!["clear", &address] };
        operator.flix(&words).expect(0, &[]);
        assert_eq!(served.robot().ramps_down_for, 0);
    }
}

#[test]
fn what_a_state_does_not_allow_has_a_code_of_its_own() {
    let operator = Operator::new();
    let mut busy = robot();
    (busy.stopped, busy.ramps_down_for) = (true, u32::MAX);
    let (_served, address) = serve(busy);
    operator.flix(&["clear", &address]).expect(32, &["is stopping and cannot do this now"]);
}

/// Starts a program at a terminal of 80 by 24 characters; returns it with the other side of that.
fn at_a_terminal(mut command: Command) -> (Child, std::fs::File) {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let size = rustix::termios::Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
    rustix::termios::tcsetwinsize(&master, size).unwrap();
    let port = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    let terminal = || std::fs::File::options().read(true).write(true).open(&port).unwrap();
    command.env("TERM", "xterm").stdin(terminal()).stdout(terminal()).stderr(terminal());
    (command.spawn().unwrap(), std::fs::File::from(master))
}

#[test]
fn teleop_shows_a_map_of_any_tracker_s_poses() {
    let (_served, address) = serve(robot());
    let (operator, tracker) = (Operator::new(), Tracker::start());
    let (mut child, mut master) =
        at_a_terminal(operator.command(&["teleop", &address, "--pose", &tracker.source]));
    let (mut shown, mut bytes) = (String::new(), [0; 4096]);
    // Every screen is drawn soon; without the map the end of the test's patience comes.
    while !shown.contains("map,") {
        let length = master.read(&mut bytes).unwrap();
        shown.push_str(&String::from_utf8_lossy(&bytes[..length]));
    }
    master.write_all(b"\x1b").unwrap();
    while master.read(&mut bytes).is_ok_and(|length| length > 0) {}
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn no_word_that_was_typed_steers_the_terminal_by_an_error_about_it() {
    for words in
        [&["\u{1b}]0;owned\u{7}"][..], &["drive", "w", "--frequency", "1\u{1b}[2J\u{9b}2J"]]
    {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flix"));
        command.args(words);
        let (mut child, mut master) = at_a_terminal(command);
        let (mut shown, mut bytes) = (Vec::new(), [0; 4096]);
        while let Ok(length @ 1..) = master.read(&mut bytes) {
            shown.extend_from_slice(&bytes[..length]);
        }
        let shown = String::from_utf8(shown).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(2));
        let steers = ["\u{1b}]", "\u{1b}[2J", "\u{9b}"].iter().any(|it| shown.contains(it));
        assert!(shown.contains("error: ") && !steers, "{shown:?}");
    }
}

#[test]
fn without_colours_bold_and_reversed_text_is_left() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let mut command = operator.command(&["teleop", &address]);
    command.env("NO_COLOR", "1");
    let (mut child, mut master) = at_a_terminal(command);
    let (mut shown, mut bytes) = (String::new(), [0; 4096]);
    while !shown.contains("DISARMED") {
        let length = master.read(&mut bytes).unwrap();
        shown.push_str(&String::from_utf8_lossy(&bytes[..length]));
    }
    // What is written of a colour that is left out ends bold and reversed text, too.
    let ends =
        shown.contains("\u{1b}[;m") || shown.contains("\u{1b}[38;") || shown.contains("\u{1b}[48;");
    let (before, _) = shown.split_once("DISARMED").unwrap();
    let style = &before[before.len() - 10..];
    assert!(!ends && style.contains("[1m") && style.contains("[7m"), "{style:?} {shown:?}");
    master.write_all(b"\x1b").unwrap();
    while master.read(&mut bytes).is_ok_and(|length| length > 0) {}
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

/// A terminal by xterm's rules: it does what the program asked for, and sends what a person causes.
struct Desk {
    child: Child,
    master: std::fs::File,
    /// The private modes that the program has set.
    modes: std::sync::Arc<std::sync::Mutex<std::collections::BTreeSet<u32>>>,
    /// Whether the terminal receives questions of the program and answers them.
    is_connected: std::sync::Arc<std::sync::atomic::AtomicBool>,
    reader: std::thread::JoinHandle<()>,
}

/// A key that comes again sooner may be held.
const PRESSED_AGAIN: Duration = Duration::from_millis(900);
/// Modes in which a terminal reports buttons of the mouse.
const MOUSE: [u32; 3] = [1000, 1002, 1003];
const FOCUS: u32 = 1004;
const PASTE: u32 = 2004;

impl Desk {
    fn new(command: Command) -> Self {
        let (child, master) = at_a_terminal(command);
        let modes = std::sync::Arc::<std::sync::Mutex<_>>::default();
        let (mut screen, known) = (master.try_clone().unwrap(), modes.clone());
        let is_connected = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
        let answers = is_connected.clone();
        let reader = std::thread::spawn(move || {
            let (mut shown, mut place, mut bytes) = (String::new(), String::new(), [0; 4096]);
            while let Ok(length @ 1..) = screen.read(&mut bytes) {
                shown.push_str(&String::from_utf8_lossy(&bytes[..length]));
                // The last sequence may not be whole yet.
                let is_whole = shown.ends_with("\u{1b}[6n");
                let end = shown.rfind('\u{1b}').filter(|_| !is_whole).unwrap_or(shown.len());
                let whole = shown.drain(..end).collect::<String>();
                Self::follow(&whole, &known);
                if answers.load(std::sync::atomic::Ordering::Relaxed) {
                    Self::answer(&whole, &mut place, &mut screen);
                }
            }
            Self::follow(&shown, &known);
        });
        Self { child, master, modes, is_connected, reader }
    }

    /// Keeps where the cursor was set to last, and states it whenever the program asks.
    fn answer(shown: &str, place: &mut String, screen: &mut std::fs::File) {
        for sequence in shown.split("\u{1b}[").skip(1) {
            match sequence.split_once('H') {
                Some((set, _)) => set.clone_into(place),
                None if sequence.starts_with("6n") => {
                    // At once, so that no key comes between. The program may have left.
                    let _ = screen.write_all(format!("\u{1b}[{place}R").as_bytes());
                }
                None => {}
            }
        }
    }

    fn follow(shown: &str, modes: &std::sync::Mutex<std::collections::BTreeSet<u32>>) {
        for sequence in shown.split("\u{1b}[?").skip(1) {
            let end = sequence.find(|letter: char| !letter.is_ascii_digit() && letter != ';');
            let (numbers, rest) = sequence.split_at(end.unwrap_or(sequence.len()));
            for mode in numbers.split(';').filter_map(|number| number.parse().ok()) {
                let mut modes = modes.lock().unwrap();
                match rest.chars().next() {
                    Some('h') => modes.insert(mode),
                    Some('l') => modes.remove(&mode),
                    _ => false,
                };
            }
        }
    }

    fn has(&self, mode: u32) -> bool {
        self.modes.lock().unwrap().contains(&mode)
    }

    fn send(&self, bytes: &str) {
        (&self.master).write_all(bytes.as_bytes()).unwrap();
    }

    /// Turns the wheel: reported to a program that asks for the mouse, arrow keys for one in full screen that does not.
    fn wheel(&self, notches: usize, up: bool) {
        let (button, arrow) = if up { (64, 'A') } else { (65, 'B') };
        for _ in 0..notches {
            if MOUSE.iter().any(|mode| self.has(*mode)) {
                self.send(&format!("\u{1b}[<{button};40;12M"));
            } else {
                self.send(&format!("\u{1b}[{arrow}"));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Pastes a text, marked for a program that asks for it.
    fn paste(&self, text: &str) {
        if self.has(PASTE) {
            self.send(&format!("\u{1b}[200~{text}\u{1b}[201~"));
        } else {
            self.send(text);
        }
    }

    fn lose_focus(&self) {
        if self.has(FOCUS) {
            self.send("\u{1b}[O");
        }
    }

    /// Arms, and lets the robot walk.
    fn walk(&self, served: &ServedRobot) {
        wait_until(|| {
            // Where the computer is busy, the robot may disarm for want of orders.
            let is_disarmed = served.robot().state == State::Disarmed;
            self.press(if is_disarmed { "\r" } else { "w" }, || {
                let state = served.robot().state;
                state == State::Running || is_disarmed && state == State::Armed
            }) && served.robot().state == State::Running
        });
    }

    fn arm(&self, served: &ServedRobot) {
        self.press_until("\r", || served.robot().state == State::Armed);
    }

    /// Presses a key again and again, as a hand does whose robot is not ready yet.
    fn press_until(&self, key: &str, condition: impl Fn() -> bool) {
        wait_until(|| self.press(key, &condition));
    }

    /// Presses a key, and returns whether it had its effect before a hand presses it again.
    fn press(&self, key: &str, condition: impl Fn() -> bool) -> bool {
        self.send(key);
        let pressed = Instant::now();
        while pressed.elapsed() < PRESSED_AGAIN {
            if condition() {
                return true;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        false
    }

    /// Presses a key whose effect shows that all before it was taken.
    fn mark(&self, served: &ServedRobot, theta: f32) {
        // One is dropped that is read with what came before it, or after the program stood still: a hand presses again.
        wait_until(|| {
            self.send("\u{1b}[C");
            (0..100).any(|_| {
                std::thread::sleep(Duration::from_millis(20));
                served.robot().setpoint.direction() == Degrees::saturating(theta)
            })
        });
    }

    fn leave(mut self) {
        self.send("\u{1b}");
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
        drop(self.master);
        self.reader.join().unwrap();
        let left = self.modes.lock().unwrap();
        let is_left = |mode: &u32| MOUSE.contains(mode) || [FOCUS, PASTE].contains(mode);
        assert!(!left.iter().any(is_left), "the terminal is left with {left:?}");
    }
}

#[test]
fn a_wheel_a_paste_and_an_answer_of_the_terminal_move_nothing() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let desk = Desk::new(operator.command(&["teleop", &address]));
    desk.arm(&served);
    desk.wheel(10, true);
    desk.wheel(10, false);
    desk.paste("flix-walker\n");
    desk.paste("w");
    // One that does not mark pasted text, and the colour of a background that nobody here asked for.
    desk.send("flix-walker\nwwwwww");
    std::thread::sleep(Duration::from_millis(20));
    desk.send("\u{1b}]11;rgb:1e1e/1e1e/2e2e\u{1b}\\");
    std::thread::sleep(Duration::from_millis(20));
    // The same in pieces, each as short as a word that is typed.
    for piece in ["\u{1b}]11", ";rg", "b:1e1e/1e1e/2e2e\u{1b}\\"] {
        desk.send(piece);
        std::thread::sleep(Duration::from_millis(20));
    }
    desk.mark(&served, 5.0);
    assert_eq!(served.robot().setpoint.frequency(), Hertz::ZERO);
    // A step of f alone begins nothing.
    desk.send("\u{1b}[A");
    desk.mark(&served, 10.0);
    assert_eq!(served.robot().setpoint.frequency(), Hertz::ZERO);
    // Nor does any of it change a walk.
    desk.press_until("w", || served.robot().state == State::Running);
    desk.wheel(10, true);
    desk.paste("d");
    std::thread::sleep(Duration::from_millis(20));
    // The walk's own direction is 30 degrees.
    desk.mark(&served, 35.0);
    assert_eq!(served.robot().setpoint.frequency(), Hertz::saturating(-30.0));
    desk.leave();
}

/// Only in a terminal of its own does a program get signals of its keys.
#[test]
#[cfg(target_os = "linux")]
fn ctrl_c_stops_where_a_sequence_without_its_end_swallows_all_keys() {
    for begun in ["\u{1b}[200~pasted", "\u{1b}[<0;1", "w\u{1a}"] {
        let (served, address) = serve(robot());
        let operator = Operator::new();
        let flix = operator.command(&["teleop", &address]);
        let mut command = Command::new("setsid");
        command.arg("--ctty").arg("--wait").arg(flix.get_program()).args(flix.get_args());
        for (name, value) in flix.get_envs() {
            if let Some(value) = value {
                command.env(name, value);
            }
        }
        let mut desk = Desk::new(command);
        desk.walk(&served);
        desk.send(begun);
        desk.send("\u{3}");
        wait_until(|| served.robot().stopped);
        assert_eq!(desk.child.wait().unwrap().code(), Some(40), "{begun:?}");
    }
}

#[test]
fn a_sequence_without_its_end_lets_the_robot_rest_and_the_space_bar_stop() {
    let begun = ["\u{1b}[200~pasted", "\u{1b}[<0;1", "\u{1b}[", "\u{1b}O", "\u{1b}[1;2"];
    for begun in begun {
        let (served, address) = serve(robot());
        let operator = Operator::new();
        let mut desk = Desk::new(operator.command(&["teleop", &address]));
        desk.walk(&served);
        desk.send(begun);
        wait_until(|| served.robot().setpoint.frequency() == Hertz::ZERO);
        assert!(!served.robot().stopped, "{begun:?}");
        desk.send(" ");
        wait_until(|| served.robot().stopped);
        desk.child.kill().unwrap();
        desk.child.wait().unwrap();
    }
}

#[test]
fn who_drives_by_hand_learns_at_the_end_that_the_record_could_not_be_written() {
    // By its key, and by Ctrl-C in a walk.
    for (end, code) in [("\u{1b}", 2), ("\u{3}", 40)] {
        let (served, address) = serve(robot());
        let operator = Operator::new();
        let mut command = Command::new("bash");
        let errors = operator.home.path().join("errors");
        command
            .args(["-c", "ulimit -f 64; exec \"$@\" 2>errors", "bash", env!("CARGO_BIN_EXE_flix")])
            .args(["teleop", &address, "--record", "--key"])
            .arg(&operator.key)
            .current_dir(operator.home.path())
            .env("HOME", operator.home.path());
        let mut desk = Desk::new(command);
        desk.walk(&served);
        let runs = operator.home.path().join("out/runs");
        wait_until(|| {
            let files = std::fs::read_dir(&runs).unwrap();
            files.flatten().any(|file| file.metadata().unwrap().len() == 64 << 10)
        });
        desk.send(end);
        assert_eq!(desk.child.wait().unwrap().code(), Some(code));
        let said = std::fs::read_to_string(errors).unwrap();
        assert!(said.contains("cannot write the record"), "{said}");
    }
}

#[test]
fn a_robot_rests_when_its_operator_looks_elsewhere() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let desk = Desk::new(operator.command(&["teleop", &address]));
    desk.walk(&served);
    desk.lose_focus();
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    assert_ne!(served.robot().state, State::Disarmed);
    desk.leave();
}

#[test]
fn a_robot_rests_when_the_connection_of_its_terminal_stands_still() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let desk = Desk::new(operator.command(&["teleop", &address]));
    desk.walk(&served);
    let connect = |is_connected| {
        desk.is_connected.store(is_connected, std::sync::atomic::Ordering::Relaxed);
    };
    connect(false);
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    // A key that comes before the answers was typed long ago.
    desk.send("w");
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(served.robot().setpoint, Setpoint::REST);
    connect(true);
    desk.walk(&served);
    desk.leave();
}

#[test]
fn a_robot_rests_soon_without_a_key_at_a_terminal_that_never_answers() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let desk = Desk::new(operator.command(&["teleop", &address, "--rest-after", "1h"]));
    desk.is_connected.store(false, std::sync::atomic::Ordering::Relaxed);
    desk.walk(&served);
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    assert_ne!(served.robot().state, State::Disarmed);
    desk.leave();
}

#[test]
fn a_robot_rests_without_keys_and_a_held_key_lets_it_walk() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let desk = Desk::new(operator.command(&["teleop", &address, "--rest-after", "1s"]));
    desk.walk(&served);
    let start = Instant::now();
    while start.elapsed() < Duration::from_millis(1500) {
        desk.send("w");
        std::thread::sleep(Duration::from_millis(30));
        assert_ne!(served.robot().setpoint, Setpoint::REST);
    }
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    desk.leave();
    let refused = operator.flix(&["teleop", &address, "--rest-after", "0.5s"]);
    refused.expect(2, &["name a time between 1s and 1h"]);
}

#[test]
fn a_robot_rests_when_nobody_is_attached_to_tmux_or_zellij() {
    for (program, variables, attached, left) in [
        ("tmux", [("TMUX", "/tmp/tmux-0/default,7,0"), ("TMUX_PANE", "%0")], "1 1", "0 1"),
        (
            "zellij",
            [("ZELLIJ", "0"), ("ZELLIJ_PANE_ID", "3")],
            "CLIENT_ID ZELLIJ_PANE_ID RUNNING_COMMAND\n1         terminal_3     flix",
            "CLIENT_ID ZELLIJ_PANE_ID RUNNING_COMMAND",
        ),
    ] {
        let (served, address) = serve(robot());
        let operator = Operator::new();
        let answer = operator.home.path().join("answer");
        let stand_in = operator.home.path().join(program);
        std::fs::write(&answer, attached).unwrap();
        std::fs::write(&stand_in, format!("#!/bin/sh\ncat {}\n", answer.display())).unwrap();
        std::fs::set_permissions(&stand_in, std::fs::Permissions::from_mode(0o755)).unwrap();
        let mut command = operator.command(&["teleop", &address, "--rest-after", "1h"]);
        let path = format!("{}:/usr/bin:/bin", operator.home.path().display());
        command.env("PATH", path).env_remove("TMUX").envs(variables);
        let desk = Desk::new(command);
        desk.walk(&served);
        std::fs::write(&answer, left).unwrap();
        wait_until(|| served.robot().setpoint == Setpoint::REST);
        desk.leave();
    }
}

/// Returns whether this program is installed, where its tests are not required.
fn is_installed(program: &str) -> bool {
    let look = Command::new("sh").args(["-c", "command -v $0", program]).output();
    let is_found = look.is_ok_and(|it| it.status.success());
    assert!(
        is_found || std::env::var_os("FLIX_REQUIRE_TERMINALS").is_none(),
        "install {program}, or leave FLIX_REQUIRE_TERMINALS unset"
    );
    is_found
}

#[test]
fn a_robot_rests_when_nobody_is_attached_to_dtach() {
    if !is_installed("dtach") {
        return;
    }
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let socket = operator.home.path().join("desk");
    let dtach = |mode: &str, rest: Option<&Command>| {
        let mut dtach = Command::new("dtach");
        dtach.arg(mode).arg(&socket).args(["-E", "-z"]);
        if let Some(program) = rest {
            dtach.arg(program.get_program()).args(program.get_args());
        }
        dtach
    };
    let teleop = operator.command(&["teleop", &address, "--rest-after", "1h"]);
    let mut desk = Desk::new(dtach("-c", Some(&teleop)));
    desk.walk(&served);
    desk.child.kill().unwrap();
    desk.child.wait().unwrap();
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    assert_ne!(served.robot().state, State::Disarmed);
    // Whoever comes back drives on.
    let desk = Desk::new(dtach("-a", None));
    desk.walk(&served);
    desk.send("\u{1b}");
    let child = std::cell::RefCell::new(desk.child);
    wait_until(|| child.borrow_mut().try_wait().unwrap().is_some());
}

#[test]
fn a_robot_rests_soon_without_a_key_behind_mosh_which_answers_for_a_terminal_that_is_gone() {
    if !is_installed("mosh-server") || !is_installed("mosh-client") {
        return;
    }
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let teleop = operator.command(&["teleop", &address, "--rest-after", "1h"]);
    let mut server = Command::new("mosh-server");
    server.args(["new", "-i", "127.0.0.1", "-l", "LC_ALL=C.UTF-8", "--"]);
    server.arg(teleop.get_program()).args(teleop.get_args()).env("LC_ALL", "C.UTF-8");
    server.env("TERM", "xterm").env_remove("TMUX").env_remove("STY");
    let said = server.stdin(Stdio::null()).output().unwrap();
    let said =
        [said.stdout, said.stderr].map(|it| String::from_utf8_lossy(&it).into_owned()).concat();
    let after = |words: &str| {
        let rest = said.split_once(words).unwrap_or_else(|| panic!("{said}")).1;
        rest.split([' ', ']', '\r', '\n']).map(ToOwned::to_owned).collect::<Vec<_>>()
    };
    let (connect, process) = (after("MOSH CONNECT "), after("pid = "));
    let mut client = Command::new("mosh-client");
    client.args(["127.0.0.1", &connect[0]]).env("MOSH_KEY", &connect[1]).env("LC_ALL", "C.UTF-8");
    let mut desk = Desk::new(client);
    desk.walk(&served);
    desk.child.kill().unwrap();
    desk.child.wait().unwrap();
    wait_until(|| served.robot().setpoint == Setpoint::REST);
    assert_ne!(served.robot().state, State::Disarmed);
    kill("TERM", process[0].parse().unwrap());
    wait_until(|| served.robot().stopped);
}

#[test]
fn teleop_stops_the_robot_when_its_terminal_closes() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    // Not its controlling terminal: no SIGHUP arrives, only the end of the input.
    let (mut child, master) = at_a_terminal(operator.command(&["teleop", &address]));
    let mut screen = master.try_clone().unwrap();
    let (closing, closed) = std::sync::mpsc::channel::<()>();
    let reader = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        while closed.try_recv().is_err() && screen.read(&mut bytes).is_ok() {}
    });
    wait_until(|| {
        (&master).write_all(b"\r").unwrap();
        std::thread::sleep(PRESSED_AGAIN);
        served.robot().state == State::Armed
    });
    closing.send(()).unwrap();
    drop(master);
    reader.join().unwrap();
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > Duration::from_secs(10) {
            child.kill().unwrap();
            panic!("teleop goes on without a terminal");
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(status.code(), Some(40));
    assert!(served.robot().stopped, "the stop is latched");
}

/// Returns whether this process has a handler for SIGINT: bit 1 of the mask of caught signals.
fn listens_for_interrupts(process: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    u64::from_str_radix(caught.trim(), 16).unwrap() & 2 != 0
}

#[test]
fn an_interrupted_search_or_check_is_interrupted_and_no_diagnosis() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    for words in [&["discover", "--for", "60"][..], &["doctor", &address]] {
        let mut command = match words {
            ["doctor", ..] => operator.command(words),
            _ => operator.command_without_key(words),
        };
        let child = command.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        wait_until(|| listens_for_interrupts(child.id()));
        kill("INT", child.id());
        Ended(child.wait_with_output().unwrap()).expect(40, &["interrupted"]);
    }
}

#[test]
fn status_tells_faults_in_plain_words_with_the_first_cause() {
    let mut ill = robot();
    ill.faults = Faults::NONE.with(Fault::OverCurrent).with(Fault::Stall);
    ill.state = State::Faulted;
    let (_served, address) = serve(ill);
    let operator = Operator::new();
    let json = operator.flix(&["status", &address, "--json"]).expect(0, &[]).json();
    assert_eq!(json["state"], "faulted");
    assert_eq!(json["first_fault"], "over-current");
    assert_eq!(json["faults"][1]["name"], "stall");
    assert_eq!(json["link"]["robot"]["dropped"]["forged"], 0);
    let text = operator.flix(&["status", &address]).expect(0, &[]).stdout();
    assert!(text.contains("first: over-current") && text.contains("free the rotor"), "{text}");
}

#[test]
fn status_tells_why_the_robot_started() {
    for (reset, said) in [
        (ResetReason::PowerOn, "power-on"),
        (ResetReason::panic("src/link.rs", 12), "a panic at src/link.rs:12"),
    ] {
        let mut started = robot();
        started.reset = reset;
        let (_served, address) = serve(started);
        let operator = Operator::new();
        let json = operator.flix(&["status", &address, "--json"]).expect(0, &[]).json();
        assert_eq!(json["robot"]["reset_reason"], said);
        let text = operator.flix(&["status", &address]).expect(0, &[]).stdout();
        assert!(text.contains(&format!("after {said}")), "{text}");
    }
}

fn watchdog_after_a_stall() -> CrashReport {
    CrashReport {
        reset: ResetReason::Tasks,
        message: "".try_into().unwrap(),
        counters: [0x4200_1234].into_iter().collect(),
        version: "0.1.0".try_into().unwrap(),
        build: None,
        uptime: None,
        fault: Some(FaultSummary {
            time: flix_protocol::units::Instant::from_micros(2_500_000),
            faults: Faults::NONE.with(Fault::Stall),
            first_fault: Some(Fault::Stall),
            state: State::Running,
            frequency: Hertz::saturating(-30.0),
            direction: Degrees::saturating(30.0),
            currents: [MotorCurrents { direct: Amperes::ZERO, quadrature: Amperes::ZERO }; 2],
            bus_voltage: None,
        }),
    }
}

#[test]
fn an_accident_is_pointed_out_by_status_and_described_by_crash() {
    let mut restarted = robot();
    restarted.crash = Some(watchdog_after_a_stall());
    let (_served, address) = serve(restarted);
    let operator = Operator::new();
    let status = operator.flix(&["status", &address]).expect(0, &[]).stdout();
    assert!(status.contains("tasks that hung, after the fault stall"), "{status}");
    assert!(status.contains(&format!("`flix crash {address}`")), "{status}");
    let text = operator.flix(&["crash", &address]).expect(0, &[]).stdout();
    for said in ["after tasks that hung", "2.500 s", "stall: ", "0x42001234", "--elf FILE"] {
        assert!(text.contains(said), "`{said}` is missing in: {text}");
    }
    let json = operator.flix(&["crash", &address, "--json"]).expect(0, &[]).json();
    assert_eq!(json["fault"]["first_fault"], "stall");
    assert_eq!(json["fault"]["state"], "running");
    assert_eq!(json["calls"][0]["address"], "0x42001234");
}

#[test]
fn without_an_accident_status_is_silent_about_it_and_crash_says_so() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let status = operator.flix(&["status", &address]).expect(0, &[]).stdout();
    assert!(!status.contains("flix crash"), "{status}");
    for words in [&["crash", &address][..], &["crash", &address, "--json"]] {
        operator.flix(words).expect(33, &["no accident"]);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_elf_file_of_the_build_that_crashed_names_its_functions_and_another_is_refused() {
    // Any program will do: this one is at hand.
    let program = env!("CARGO_BIN_EXE_flix");
    let elf = std::fs::read(program).unwrap();
    let build = BuildId::of(&Sha256::digest(&elf).into());
    let file = object::File::parse(&*elf).unwrap();
    let main = file.symbols().find(|symbol| {
        symbol.kind() == SymbolKind::Text && symbol.name().is_ok_and(|it| it.contains("4flix4main"))
    });
    let counter = u32::try_from(main.unwrap().address()).unwrap();
    let mut restarted = robot();
    let counters = [counter].into_iter().collect();
    restarted.crash = Some(CrashReport { build, counters, ..watchdog_after_a_stall() });
    let (_served, address) = serve(restarted);
    let operator = Operator::new();
    let text = operator.flix(&["crash", &address, "--elf", program]).expect(0, &[]).stdout();
    assert!(text.contains("flix::main") && text.contains("src/main.rs:"), "{text}");
    let other = std::env::current_exe().unwrap();
    let words = ["crash", &address, "--elf", other.to_str().unwrap()];
    operator.flix(&words).expect(2, &["build", "that was flashed"]);
}

#[test]
fn status_counts_dropped_datagrams_by_reason() {
    let (_served, address) = serve(robot());
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    for _ in 0..5 {
        stranger.send_to(b"junk", &address).unwrap();
    }
    let json = Operator::new().flix(&["status", &address, "--json"]).expect(0, &[]).json();
    assert_eq!(json["link"]["robot"]["dropped"]["malformed"], 5);
}

#[test]
fn link_test_measures_round_trip_and_loss() {
    let served = ServedRobot::new(robot(), seeded_loss(11, 0.1));
    let address = served.address.to_string();
    let words = ["link-test", &address, "--for", "3s", "--json"];
    let json = Operator::new().flix(&words).expect(0, &[]).json();
    let loss = json["loss"].as_f64().unwrap();
    assert!((0.08..0.32).contains(&loss), "0.19 there and back: {loss}");
    let (half, most) = (&json["round_trip_ms"]["p50"], &json["round_trip_ms"]["p99"]);
    assert!(half.as_f64().unwrap() <= most.as_f64().unwrap());
}

#[test]
fn exported_settings_come_back_by_import() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let file = operator.home.path().join("walker.toml");
    let file = file.to_str().unwrap();
    operator.flix(&["parameters", "set", &address, "current_limit", "2.25"]).expect(0, &[]);
    operator.flix(&["parameters", "export", &address, file]).expect(0, &[]);
    operator.flix(&["parameters", "reset", &address]).expect(0, &[]);
    assert!((served.robot().parameters[0].value - 1.5).abs() < 1e-6);
    operator.flix(&["parameters", "import", &address, file]).expect(0, &[]);
    assert!((served.robot().parameters[0].value - 2.25).abs() < 1e-6);
    let shown = operator.flix(&["parameters", "get", &address, "current_limit"]).expect(0, &[]);
    assert_eq!(shown.stdout(), "2.25 A\n");
}

#[test]
fn a_file_with_one_wrong_value_sets_nothing() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let file = operator.home.path().join("wrong.toml");
    std::fs::write(&file, "[settings]\ncurrent_limit = 2.0\nloop_gain = 99.0\n").unwrap();
    let words = ["parameters", "import", &address, file.to_str().unwrap()];
    operator.flix(&words).expect(2, &["loop_gain", "0.1 to 10", "nothing was changed"]);
    assert!((served.robot().parameters[0].value - 1.5).abs() < 1e-6);
}

#[test]
fn assumed_values_are_shown_and_accepted_only_where_that_is_wanted() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let mark = || served.robot().parameters.iter().find_map(|parameter| parameter.mark);
    let list = operator.flix(&["parameters", "list", &address]).expect(0, &[]).stdout();
    assert!(list.contains("flix commission"), "{list}");
    assert_eq!(mark(), Some(Mark::Assumed));
    let accept = ["parameters", "accept", &address, "--save"];
    let shown = operator.flix(&accept).expect(0, &[]).stdout();
    assert!(shown.contains("pole_pairs") && shown.contains("Accepted"), "{shown}");
    assert_eq!(mark(), Some(Mark::Entered));
    let shown = operator.flix(&accept).expect(0, &[]).stdout();
    assert_eq!(shown, "No value is assumed.\n");
}

#[test]
fn a_value_out_of_range_is_usage_and_names_the_range() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let set = |value| operator.flix(&["parameters", "set", &address, "current_limit", value]);
    set("-5").expect(2, &["0.1 to 3 A, not -5"]);
    set("NaN").expect(2, &["current_limit: `NaN` is not a number"]);
    let unknown = ["parameters", "get", &address, "colour"];
    operator.flix(&unknown).expect(2, &["flix parameters list"]);
}

#[test]
fn a_value_may_have_its_unit_and_a_name_that_is_nearly_right_is_answered_with_the_right_one() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let set = |name, value| operator.flix(&["parameters", "set", &address, name, value]);
    let value = |index: usize| served.robot().parameters[index].value;
    set("current_limit", "1750mA").expect(0, &[]);
    set("frequency_slew", "0.2 kHz/s").expect(2, &["not a number in Hz/s"]);
    set("frequency_slew", "200 Hz/s").expect(0, &[]);
    assert_eq!((value(0), value(1)), (1.75, 200.0));
    set("top_phases_reversed", "on").expect(0, &[]);
    set("loop_gain", "on").expect(2, &["loop_gain: `on` is not a number"]);
    set("current_limit", "2V").expect(2, &["current_limit: `2V` is not a number in A"]);
    set("current_limit", "on").expect(2, &["current_limit: `on` is not a number in A"]);
    set("current_limit", "much").expect(2, &["`much` is not a number, on or off"]);
    set("curent_limit", "1").expect(2, &["`curent_limit`, did you mean `current_limit`?"]);
    let get = ["parameters", "get", &address, "frequency-slew"];
    operator.flix(&get).expect(2, &["did you mean `frequency_slew`?"]);
    let file = operator.home.path().join("wrong.toml");
    std::fs::write(&file, "[settings]\npol_pairs = 7\n").unwrap();
    let import = ["parameters", "import", &address, file.to_str().unwrap()];
    operator.flix(&import).expect(2, &["did you mean `pole_pairs`?"]);
    let with_units = ["drive", &address, "--frequency", "-30Hz", "--direction", "30deg", "--for"];
    operator.flix(&[&with_units[..], &["200ms"]].concat()).expect(0, &[]);
}

#[test]
fn a_drive_that_was_refused_leaves_no_record() {
    let mut stopped = robot();
    stopped.stopped = true;
    let (_served, address) = serve(stopped);
    let operator = Operator::new();
    operator.flix(&drive(&address, &[])).expect(31, &["flix clear"]);
    let list = operator.command_without_key(&["runs", "show", "last"]).output().unwrap();
    Ended(list).expect(33, &["no run"]);
}

#[test]
fn where_no_simulated_robot_runs_its_start_is_named_and_what_is_waited_for() {
    let nobody = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = nobody.local_addr().unwrap().to_string();
    let words = ["flix-sim serve", &format!("waiting for {address} to answer")];
    for command in ["status", "stop"] {
        Operator::new().flix(&[command, &address]).expect(10, &words[..1]);
    }
    Operator::new().flix(&["clear", &address]).expect(10, &words);
    let search = Operator::new().command_without_key(&["discover", "--for", "1.2s"]).output();
    let said = String::from_utf8_lossy(&search.unwrap().stderr).into_owned();
    assert!(said.contains("waiting for robots to announce themselves"), "{said}");
}

#[test]
fn nothing_to_show_is_no_fault_and_every_code_is_in_help_and_in_the_table() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    operator.flix(&["scope", &address, "--last"]).expect(33, &[]);
    let help = operator.command_without_key(&["--help"]).output().unwrap();
    let page = include_str!("../../docs/drive.md");
    for (exit, meaning) in flix_shell::Exit::ALL {
        let code = exit as u8;
        assert!(
            Ended(help.clone()).stdout().contains(&format!("  {code:>2}  {meaning}\n")),
            "{code}"
        );
        assert!(page.contains(&format!("\n| {code} | {meaning} |\n")), "{code}");
    }
}

#[test]
fn all_settings_are_listed() {
    let (_served, address) = serve(robot());
    let json =
        Operator::new().flix(&["parameters", "list", &address, "--json"]).expect(0, &[]).json();
    let names: Vec<_> = json.as_array().unwrap().iter().map(|it| &it["name"]).collect();
    assert_eq!(names.len(), 7);
    assert_eq!(names[5], "pole_pairs");
}

#[test]
fn without_a_key_one_sentence_says_what_to_do() {
    let operator = Operator::new();
    let output = operator.command_without_key(&["status", "10.0.0.7"]).output().unwrap();
    let ended = Ended(output).expect(2, &["10.0.0.7", "--key", "FLIX_KEY_FILE", "flix provision"]);
    assert_eq!(ended.stderr().lines().count(), 1);
}

#[test]
fn the_key_file_can_be_named_by_the_environment() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let mut command = operator.command_without_key(&["status", &address]);
    let empty =
        operator.command_without_key(&["status", "10.0.0.7"]).env("FLIX_KEY_FILE", "").output();
    Ended(empty.unwrap()).expect(2, &["is FLIX_KEY_FILE set, and empty?"]);
    let output = command.env("FLIX_KEY_FILE", &operator.key).output().unwrap();
    Ended(output).expect(0, &[]);
}

#[test]
fn the_keyring_opens_a_robot_by_its_name() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let keyring = keys::Keyring::in_directory(operator.home.path().join("flix/robots"));
    keyring.store("walker", &key()).unwrap();
    keyring.store_address("walker", &address).unwrap();
    let output = operator.command_without_key(&["status", "walker"]).output().unwrap();
    Ended(output).expect(0, &[]);
}

#[test]
fn a_key_file_that_others_can_read_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let operator = Operator::new();
    std::fs::set_permissions(&operator.key, std::fs::Permissions::from_mode(0o644)).unwrap();
    operator.flix(&["status", "127.0.0.1:9"]).expect(2, &["chmod 600"]);
}

#[test]
fn keygen_makes_a_private_file_and_does_not_show_the_key() {
    use std::os::unix::fs::PermissionsExt;
    let operator = Operator::new();
    let file = operator.home.path().join("new.key");
    let output =
        operator.command_without_key(&["keygen", file.to_str().unwrap()]).output().unwrap();
    let ended = Ended(output).expect(0, &[]);
    let secret = std::fs::read_to_string(&file).unwrap();
    assert!(!ended.stdout().contains(secret.trim()) && !ended.stderr().contains(secret.trim()));
    assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    let again = operator.command_without_key(&["keygen", file.to_str().unwrap()]).output().unwrap();
    Ended(again).expect(2, &["exists already"]);
}

#[test]
fn every_shell_gets_its_completions() {
    let operator = Operator::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = operator.command_without_key(&["completions", shell]).output().unwrap();
        assert!(Ended(output).expect(0, &[]).stdout().contains("link-test"), "{shell}");
    }
}

#[test]
fn a_path_with_a_blank_is_completed_whole() {
    let operator = Operator::new();
    let home = operator.home.path();
    std::fs::write(home.join("my robot.key"), "").unwrap();
    let script = operator.command_without_key(&["completions", "bash"]).output().unwrap();
    std::fs::write(home.join("script"), script.stdout).unwrap();
    let asked = "compopt() { :; }; source ./script
        COMP_WORDS=(flix status --key my); COMP_CWORD=3
        _flix flix my --key; printf '%s\\n' \"${COMPREPLY[@]}\"";
    let completed = Command::new("bash").args(["-c", asked]).current_dir(home).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&completed.stdout), "my robot.key\n");
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let operator = Operator::new();
    let mut command = operator.command_without_key(&["completions", "bash"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    Ended(child.wait_with_output().unwrap()).expect(0, &[]);
}

#[test]
fn a_frequency_of_zero_is_driven_too() {
    let (served, address) = serve(robot());
    let words =
        ["drive", &address, "--frequency", "0", "--direction", "-90", "--for", "200ms", "--json"];
    let json = Operator::new().flix(&words).expect(0, &[]).json();
    assert_eq!(json["held"]["frequency_hz"], 0.0);
    assert_eq!(served.robot().setpoint.frequency(), Hertz::ZERO);
}

#[test]
fn the_list_of_settings_states_what_each_is_for() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let list = operator.flix(&["parameters", "list", &address]).expect(0, &[]).stdout();
    let sentence = flix_protocol::settings::description("current_limit").unwrap();
    let mut lines = list.lines().skip_while(|line| !line.starts_with("current_limit"));
    assert_eq!(lines.nth(1).map(str::trim), Some(sentence), "{list}");
}

#[test]
fn a_setting_is_changed_on_the_robot_of_the_environment() {
    let (served, address) = serve(robot());
    let operator = Operator::new();
    let mut set = operator.command(&["parameters", "set", "current_limit", "1.5"]);
    Ended(set.env("FLIX_ROBOT", address).output().unwrap()).expect(0, &[]);
    let limit =
        served.robot().parameters.iter().find(|it| it.name == "current_limit").unwrap().value;
    assert_eq!(limit, 1.5);
}

#[test]
fn every_command_has_a_manual_page() {
    let operator = Operator::new();
    Ended(operator.command_without_key(&["man", "pages"]).output().unwrap()).expect(0, &[]);
    let pages = operator.home.path().join("pages");
    for command in flix_cli::Cli::description().get_subcommands().filter(|it| !it.is_hide_set()) {
        let page =
            std::fs::read_to_string(pages.join(format!("flix-{}.1", command.get_name()))).unwrap();
        assert!(page.contains(".SH SYNOPSIS"), "{}", command.get_name());
    }
}

#[test]
fn a_drive_is_recorded_unless_that_is_declined() {
    let (_served, address) = serve(robot());
    let operator = Operator::new();
    let json = operator.flix(&drive(&address, &["--json"])).expect(0, &[]).json();
    let run = flix_host::record::Run::read(
        json["record"].as_str().map(|file| operator.home.path().join(file)).unwrap().as_ref(),
    )
    .unwrap();
    assert!(run.is_complete && !run.telemetry.is_empty(), "{} rows", run.telemetry.len());
    assert_eq!(run.fact("results", "ending"), "finished");
    std::fs::write(operator.home.path().join("out/runs/0.mcap"), "no record").unwrap();
    let list = operator.command_without_key(&["runs", "list"]).output().unwrap();
    let list = Ended(list).expect(0, &[]).stdout();
    assert!(list.contains("finished, within 0.000 Hz"), "{list}");
    assert!(list.contains("not a record of a run") && !list.contains("repair"), "{list}");
    assert_eq!(run.commands.iter().map(|row| row.frequency_hz).collect::<Vec<_>>(), [-30.0]);
    let json = operator.flix(&drive(&address, &["--json", "--no-record"])).expect(0, &[]).json();
    assert!(json["record"].is_null());
}
