//! `flix provision` on a pseudo-terminal with a robot's serial end behind it.
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use flix_host::link::keys::Keyring;
use flix_protocol::message::{Identity, ResetReason};
use flix_protocol::network_name::NetworkName;
use flix_protocol::provision::{
    Answer, FrameReader, HEARD_AT_ONCE, HeardNetwork, HeardNetworks, HeardSecurity, JoinFailure,
    NetworkAddress, NetworkState, ProvisionRefusal, Provisioning, Request, write_frame,
};
use flix_protocol::session::{Key, Operator as Holder, Operators};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// What a robot stores.
#[derive(Clone)]
struct Kept {
    provisioning: Provisioning,
    operators: Operators,
}

impl std::ops::Deref for Kept {
    type Target = Provisioning;

    fn deref(&self) -> &Provisioning {
        &self.provisioning
    }
}

impl Kept {
    /// Returns the first operator's key.
    fn key(&self) -> Key {
        self.operators.iter().next().unwrap().key()
    }

    fn names(&self) -> Vec<String> {
        self.operators.names().iter().map(|name| name.to_string()).collect()
    }
}

/// What a robot answers when it is asked for its network, one after the other, the last again and again; nothing while it starts.
type Way = VecDeque<Option<NetworkState>>;

const JOINED: NetworkState = NetworkState::Joined(NetworkAddress {
    address: [192, 168, 1, 7],
    prefix_length: 24,
    is_fixed: false,
});

/// Returns the way of a robot that starts anew, and then is in these states.
fn way(states: impl IntoIterator<Item = NetworkState>) -> Way {
    [None].into_iter().chain(states.into_iter().map(Some)).collect()
}

/// Returns the way of a robot whose tries fail for this reason.
fn failures(reason: JoinFailure) -> Way {
    let tries = (1..9).map(|tries| NetworkState::Failed { reason, tries });
    way([NetworkState::Joining].into_iter().chain(tries))
}

/// The radio of a robot: it hears these once it has listened for two questions.
#[derive(Default)]
struct Scanner(u32);

fn heard(name: &[u8], channel: u8, dbm: i8, security: HeardSecurity) -> HeardNetwork {
    HeardNetwork { name: NetworkName::new(name).unwrap(), channel, dbm, security }
}

impl Scanner {
    fn answer(&mut self, from: u8) -> Answer {
        self.0 += 1;
        if self.0 < 3 {
            return Answer::Networks(None);
        }
        let strong = [
            heard(b"caf\xe9\x1b[2J", 11, -41, HeardSecurity::Open),
            heard("Anna\u{2019}s iPhone".as_bytes(), 6, -60, HeardSecurity::Wpa2),
            heard(b"", 1, -85, HeardSecurity::Enterprise),
        ];
        let crowd = (0..8).map(|n| heard(&[b'n', b'0' + n], 3, -90, HeardSecurity::Wpa2Wpa3));
        let all: Vec<_> = strong.into_iter().chain(crowd).collect();
        let part = all.iter().skip(from.into()).take(HEARD_AT_ONCE).cloned();
        let (total, networks) = (all.len() as u8, part.collect());
        Answer::Networks(Some(HeardNetworks { total, from, networks }))
    }
}

/// A robot at the other end of a cable, which also logs to it.
struct CabledRobot {
    port: PathBuf,
    kept: Arc<Mutex<Option<Kept>>>,
    asked: Arc<Mutex<Vec<Request>>>,
    network: Arc<Mutex<Way>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl CabledRobot {
    fn new() -> Self {
        Self::with_trouble(0, None)
    }

    /// Is deaf to its first `deaf` requests, then refuses with this, if anything.
    fn with_trouble(deaf: u32, refusal: Option<ProvisionRefusal>) -> Self {
        Self::at_a_cable(Arc::default(), deaf, refusal, false)
    }

    /// Somebody between the cable and that robot, who passes on all that is said.
    fn relay(robot: &Self) -> Self {
        Self::at_a_cable(Arc::clone(&robot.kept), 0, None, false)
    }

    /// A robot whose cable is pulled when it has taken a key, before it answers.
    fn cut_off(robot: &Self) -> Self {
        Self::at_a_cable(Arc::clone(&robot.kept), 0, None, true)
    }

    fn at_a_cable(
        kept: Arc<Mutex<Option<Kept>>>,
        mut deaf: u32,
        refusal: Option<ProvisionRefusal>,
        is_cut: bool,
    ) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let port = PathBuf::from(ptsname(&master, Vec::new()).unwrap().into_string().unwrap());
        // As long as one end stays open here, the cable is never cut.
        let held = File::options().read(true).write(true).open(&port).unwrap();
        let asked = Arc::new(Mutex::new(Vec::new()));
        let ends = Arc::new(AtomicBool::new(false));
        let (shared, log, stop) = (Arc::clone(&kept), Arc::clone(&asked), Arc::clone(&ends));
        let network = Arc::new(Mutex::new(Way::from([Some(JOINED)])));
        let states = Arc::clone(&network);
        let thread = std::thread::spawn(move || {
            let mut master = File::from(master);
            let mut reader = FrameReader::new();
            let mut bytes = [0; 64];
            let mut scans = Scanner::default();
            while !stop.load(Ordering::SeqCst) {
                let Ok(length) = master.read(&mut bytes) else { break };
                let mut requests: Vec<Request> = Vec::new();
                requests.extend(bytes[..length].iter().filter_map(|byte| reader.push(*byte)));
                for request in requests {
                    log.lock().unwrap().push(request.clone());
                    if deaf > 0 {
                        deaf -= 1;
                        master.write_all(b"I (42) boot: not there yet\r\n").unwrap();
                        continue;
                    }
                    let takes_a_key = matches!(request, Request::Provision(..));
                    let mut way = states.lock().unwrap();
                    let is_over = way.len() == 1 || request != Request::Network;
                    let network = if is_over { way[0] } else { way.pop_front().unwrap() };
                    let answer =
                        answer(&mut shared.lock().unwrap(), request, refusal, network, &mut scans);
                    let Some(answer) = answer else { continue };
                    if is_cut && takes_a_key {
                        return;
                    }
                    master.write_all(b"I (99) flix: answering\r\n").unwrap();
                    master.write_all(&write_frame(&answer).unwrap()).unwrap();
                }
            }
            drop(held);
        });
        Self { port, kept, asked, network, ends, thread: Some(thread) }
    }

    /// Goes this way from now on.
    fn goes(&self, way: Way) {
        *self.network.lock().unwrap() = way;
    }

    fn kept(&self) -> Kept {
        self.kept.lock().unwrap().clone().unwrap()
    }
}

/// Returns the answer; none to a question for the network while it is unknown.
fn answer(
    kept: &mut Option<Kept>,
    request: Request,
    refusal: Option<ProvisionRefusal>,
    network: Option<NetworkState>,
    scans: &mut Scanner,
) -> Option<Answer> {
    Some(match (request, refusal) {
        (Request::Network, _) if kept.is_none() => Answer::Refused(ProvisionRefusal::Unprovisioned),
        (Request::Network, _) => Answer::Network(network?),
        (Request::Identify, _) => Answer::Identity {
            identity: Identity {
                name: kept.as_ref().map_or("walker-0ab3", |kept| kept.name()).try_into().unwrap(),
                board: "bench".try_into().unwrap(),
                version: "0.1.0".try_into().unwrap(),
                reset: ResetReason::PowerOn,
            },
            has_key: kept.is_some(),
        },
        (Request::Prove(challenge, id), _) => {
            let holder = kept.as_ref().and_then(|kept| kept.operators.find(&id));
            Answer::Proof(holder.map(|holder| holder.key().prove(&challenge)))
        }
        (Request::Operators, _) => {
            Answer::Operators(kept.as_ref().map(|it| it.operators.names()).unwrap_or_default())
        }
        (_, Some(refusal)) => Answer::Refused(refusal),
        (Request::Scan { from, .. }, None) => scans.answer(from),
        (Request::Provision(provisioning, operator), None) => {
            *kept = Some(Kept { provisioning, operators: operator.into() });
            Answer::Done
        }
        (Request::Keep(provisioning, name, id), None) => {
            let mut operators = kept.take().unwrap().operators;
            let key = operators.find(&id).unwrap().key();
            operators.add(Holder::new(name, &key)).unwrap();
            *kept = Some(Kept { provisioning, operators });
            Answer::Done
        }
        (Request::Add(operator), None) => match kept.as_mut().unwrap().operators.add(operator) {
            Ok(()) => Answer::Done,
            Err(error) => Answer::Refused(error.into()),
        },
        (Request::Revoke(name), None) => {
            kept.as_mut().unwrap().operators.revoke(name);
            Answer::Done
        }
        (Request::Forget, None) => {
            *kept = None;
            Answer::Done
        }
    })
}

impl Drop for CabledRobot {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        // Wakes the thread.
        let _ = File::options().write(true).open(&self.port).and_then(|mut it| it.write_all(b"\n"));
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Operator {
    home: tempfile::TempDir,
}

impl Operator {
    fn new() -> Self {
        Self { home: tempfile::tempdir().unwrap() }
    }

    fn keyring(&self) -> Keyring {
        Keyring::in_directory(self.home.path().join("flix/robots"))
    }

    fn provision(&self, robot: &CabledRobot, words: &[&str]) -> Output {
        self.command(robot, words).env("USER", "anna.b").output().unwrap()
    }

    fn command(&self, robot: &CabledRobot, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flix"));
        command
            .args(["provision", "--port", robot.port.to_str().unwrap()])
            .args(words)
            .env("XDG_CONFIG_HOME", self.home.path())
            .env("HOME", self.home.path())
            .env("FLIX_NETWORK_PASSWORD", "correct horse")
            .env_remove("LOGNAME")
            .env_remove("USERNAME")
            .current_dir(self.home.path())
            .stdin(Stdio::null());
        command
    }

    #[track_caller]
    fn provisions(&self, robot: &CabledRobot, words: &[&str]) -> String {
        let output = self.provision(robot, words);
        let said = String::from_utf8(output.stdout).unwrap();
        let complaint = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{complaint}");
        said + &complaint
    }

    #[track_caller]
    fn fails(&self, robot: &CabledRobot, words: &[&str], code: i32, word: &str) {
        let output = self.provision(robot, words);
        let complaint = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{complaint}");
        assert!(complaint.contains(word), "`{word}` is missing in: {complaint}");
    }
}

#[test]
fn a_new_robot_gets_name_network_password_and_the_key_that_is_kept() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let kept = robot.kept();
    assert_eq!(
        (kept.name(), kept.network().as_bytes(), kept.password()),
        ("walker-0ab3", &b"lab"[..], "correct horse")
    );
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), kept.key());
}

#[test]
fn provisioning_ends_with_the_robots_address() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    let no_address = NetworkState::NoAddress { seconds: 0 };
    robot.goes(way([NetworkState::Joining, no_address, no_address, JOINED]));
    let said = operator.provisions(&robot, &["--ssid", "lab"]);
    for word in ["192.168.1.7/24 by DHCP", "host name flix-walker-0ab3", "waits for an address"] {
        assert_eq!(said.matches(word).count(), 1, "`{word}` in {said}");
    }
}

#[test]
fn a_join_that_fails_names_its_cause_and_undoes_nothing() {
    for (way, cause) in [
        (failures(JoinFailure::Password), "password is refused"),
        (failures(JoinFailure::Absent), "5 GHz"),
        (failures(JoinFailure::Security), "802.1X"),
        (failures(JoinFailure::Full), "no more devices"),
        (failures(JoinFailure::Refused), "refuses the robot"),
        (failures(JoinFailure::Radio), "radio"),
        (self::way([NetworkState::NoAddress { seconds: 20 }]), "DHCP"),
    ] {
        let (operator, robot) = (Operator::new(), CabledRobot::new());
        robot.goes(way);
        operator.fails(&robot, &["--ssid", "lab"], 32, cause);
        assert_eq!(robot.kept().network().as_bytes(), b"lab");
        assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
        // The same words again: the robot has them already, and joins meanwhile.
        robot.goes(Way::from([Some(JOINED)]));
        operator.provisions(&robot, &["--ssid", "lab"]);
    }
}

#[test]
fn a_robot_is_asked_for_its_address_again_and_nothing_changes() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.fails(&robot, &["--wait"], 32, "provision it first");
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover", "--no-wait"]);
    assert!(!robot.asked.lock().unwrap().contains(&Request::Network));
    robot.asked.lock().unwrap().clear();
    robot.goes(failures(JoinFailure::Absent));
    operator.fails(&robot, &["--wait"], 32, "--wait");
    robot.goes(way([NetworkState::Joining, JOINED]));
    assert!(operator.provisions(&robot, &["--wait"]).contains("192.168.1.7"));
    let asks = |it: &Request| matches!(it, Request::Identify | Request::Network);
    assert!(robot.asked.lock().unwrap().iter().all(asks));
}

#[test]
fn a_network_is_chosen_from_what_the_robot_hears() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    let said = operator.provisions(&robot, &["--networks"]);
    let rows: Vec<&str> = said.lines().map(str::trim).collect();
    assert_eq!(rows.len(), 12, "{said}");
    assert!(rows[1].starts_with("-41") && rows[1].ends_with(r"caf\xe9\x1b[2J"), "{said}");
    assert!(rows[2].ends_with("Anna\u{2019}s iPhone") && rows[2].contains("WPA2"), "{said}");
    assert!(rows[3].contains("802.1X") && rows[3].ends_with("(hidden)"), "{said}");
    assert!(rows[11].ends_with("n7"), "{said}");
    let robot = CabledRobot::new();
    let json = operator.provisions(&robot, &["--networks", "--json"]);
    let list: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(list.as_array().unwrap().len(), 11);
    assert_eq!(
        list[0],
        serde_json::json!({"name": r"caf\xe9\x1b[2J", "channel": 11, "dbm": -41, "security": "open or WPA3"})
    );
    let changes = |it: &Request| !matches!(it, Request::Scan { .. });
    assert!(!robot.asked.lock().unwrap().iter().any(changes));
}

#[test]
fn a_robot_that_drives_or_whose_radio_fails_lists_no_networks() {
    let operator = Operator::new();
    for (refusal, word) in
        [(ProvisionRefusal::Driving, "disarm"), (ProvisionRefusal::Radio, "radio")]
    {
        let robot = CabledRobot::with_trouble(0, Some(refusal));
        operator.fails(&robot, &["--networks"], 32, word);
    }
    operator.fails(&CabledRobot::new(), &["--ssid", "lab", "--json"], 2, "--json");
}

#[test]
fn neither_key_nor_password_is_shown() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    let said = operator.provisions(&robot, &["--ssid", "lab"]);
    let text = robot.kept().key().to_text();
    let key = std::str::from_utf8(text.as_slice()).unwrap();
    assert!(!said.contains(key) && !said.contains("correct horse"), "{said}");
}

#[test]
fn the_key_file_is_for_its_owner_alone() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover"]);
    let mode = fs::metadata(operator.keyring().key_file("rover")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
}

#[test]
fn a_robot_that_is_still_starting_is_asked_again() {
    let (operator, robot) = (Operator::new(), CabledRobot::with_trouble(2, None));
    operator.provisions(&robot, &["--ssid", "lab"]);
    assert!(robot.asked.lock().unwrap().len() >= 4);
}

#[test]
fn another_network_keeps_name_and_key() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover"]);
    let first = robot.kept();
    operator.provisions(&robot, &["--ssid", "home"]);
    let second = robot.kept();
    assert_eq!((second.name(), second.network().as_bytes()), ("rover", &b"home"[..]));
    assert_eq!(first.key(), second.key());
}

#[test]
fn a_key_is_rotated_on_demand_and_the_robot_has_what_is_kept() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let first = robot.kept().key();
    operator.provisions(&robot, &["--ssid", "lab", "--new-key"]);
    assert_ne!(first, robot.kept().key());
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
}

#[test]
fn a_refused_rotation_keeps_the_old_key() {
    let operator = Operator::new();
    let robot = CabledRobot::new();
    operator.provisions(&robot, &["--ssid", "lab"]);
    let first = operator.keyring().key("walker-0ab3").unwrap();
    let driving = CabledRobot::with_trouble(0, Some(ProvisionRefusal::Driving));
    let words = ["--ssid", "lab", "--name", "walker-0ab3", "--new-key"];
    operator.fails(&driving, &words, 32, "disarm");
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), first);
}

#[test]
fn two_robots_never_share_a_key() {
    let operator = Operator::new();
    let (first, second) = (CabledRobot::new(), CabledRobot::new());
    operator.provisions(&first, &["--ssid", "lab", "--name", "rover"]);
    operator.fails(&second, &["--ssid", "lab", "--name", "rover"], 20, "another --name");
    operator.provisions(&second, &["--ssid", "lab"]);
    assert_ne!(first.kept().key(), second.kept().key());
}

/// Returns whether the device was ever sent this key.
fn was_sent(device: &CabledRobot, key: &Key) -> bool {
    let is_it = |request: &Request| matches!(request, Request::Provision(_, sent) | Request::Add(sent) if sent.key() == *key);
    device.asked.lock().unwrap().iter().any(is_it)
}

#[test]
fn a_device_that_claims_a_known_name_is_not_handed_its_key() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover"]);
    let device = CabledRobot::new();
    let provisioning = Provisioning::new("rover", "lab", "password", None).unwrap();
    let operators = Operators::from(Some(Key::new([9; 32])));
    *device.kept.lock().unwrap() = Some(Kept { provisioning, operators });
    for words in [&["--ssid", "lab"][..], &["--ssid", "lab", "--name", "rover"]] {
        operator.fails(&device, words, 20, "--new-key");
    }
    for task in [&["--operators"][..], &["--add-operator", "bob"], &["--revoke-operator", "owner"]]
    {
        operator.fails(&device, task, 20, "does not have it");
    }
    assert_eq!(device.kept().names(), ["owner"]);
    assert!(!was_sent(&device, &robot.kept().key()));
    assert_eq!(operator.keyring().key("rover").unwrap(), robot.kept().key());
}

/// Somebody at the cable proves every key that the robot has, by asking the robot.
#[test]
fn a_device_that_passes_questions_on_to_the_robot_is_handed_no_key_either() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let key = robot.kept().key();
    let relay = CabledRobot::relay(&robot);
    operator.provisions(&relay, &["--ssid", "home"]);
    operator.provisions(&relay, &["--operators"]);
    assert!(!was_sent(&relay, &key));
    assert_eq!((robot.kept().network().as_bytes(), robot.kept().key()), (&b"home"[..], key));
}

#[test]
fn a_lost_answer_to_a_new_key_locks_nobody_out() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let former = robot.kept().key();
    let words = ["--ssid", "lab", "--new-key"];
    operator.fails(&CabledRobot::cut_off(&robot), &words, 10, "both keys are kept");
    assert_ne!(robot.kept().key(), former);
    // At the cable, as if nothing had been.
    operator.provisions(&CabledRobot::relay(&robot), &["--operators"]);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
    // One that was never taken is of no harm.
    let key = robot.kept().key();
    operator.keyring().offer("walker-0ab3", &former).unwrap();
    operator.provisions(&CabledRobot::relay(&robot), &["--ssid", "home"]);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), key);
    assert_eq!(operator.keyring().offered("walker-0ab3").unwrap(), None, "the robot has the other");
    operator.provisions(&CabledRobot::relay(&robot), &words);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
    assert_eq!(operator.keyring().offered("walker-0ab3").unwrap(), None);
}

#[test]
fn a_second_new_key_costs_no_key_that_the_robot_may_have() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let words = ["--ssid", "lab", "--name", "walker-0ab3", "--new-key"];
    operator.fails(&CabledRobot::cut_off(&robot), &words, 10, "both keys are kept");
    let (former, new) = (operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
    // Another device at the cable, which refuses or obeys.
    for refusal in [Some(ProvisionRefusal::Driving), None] {
        let other = CabledRobot::with_trouble(0, refusal);
        operator.fails(&other, &words, 20, "walker-0ab3.new");
        assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), former);
        assert_eq!(operator.keyring().offered("walker-0ab3").unwrap().as_ref(), Some(&new));
        assert!(other.kept.lock().unwrap().is_none());
    }
    operator.provisions(&CabledRobot::relay(&robot), &words);
    assert_ne!(robot.kept().key(), new);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
    // An offer whose file was never written whole, and a robot that proves the former.
    fs::write(operator.keyring().offered_file("walker-0ab3"), "").unwrap();
    operator.provisions(&CabledRobot::relay(&robot), &words);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
}

#[test]
fn a_robot_that_forgot_its_key_gets_a_new_one_and_the_old_is_sent_to_nobody() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover"]);
    let old = robot.kept().key();
    robot.asked.lock().unwrap().clear();
    operator.provisions(&robot, &["--forget"]);
    operator.provisions(&robot, &["--ssid", "lab"]);
    assert_eq!(robot.kept().name(), "walker-0ab3");
    operator.provisions(&robot, &["--ssid", "lab", "--name", "rover", "--new-key"]);
    assert_eq!(operator.keyring().key("rover").unwrap(), robot.kept().key());
    assert!(!was_sent(&robot, &old));
}

#[test]
fn operators_are_added_with_keys_of_their_own_listed_and_revoked() {
    let (anna, robot) = (Operator::new(), CabledRobot::new());
    anna.provisions(&robot, &["--ssid", "lab"]);
    assert_eq!(robot.kept().names(), ["anna-b"]);
    let said = anna.provisions(&robot, &["--add-operator", "bob"]);
    let file = anna.home.path().join("walker-0ab3-bob.key");
    let key = flix_host::link::keys::read(&file).unwrap();
    let text = String::from_utf8(key.to_text().to_vec()).unwrap();
    assert!(said.contains("walker-0ab3-bob.key") && !said.contains(&text), "{said}");
    let bob = Holder::new("bob".parse().unwrap(), &key);
    assert_eq!(robot.kept().operators.iter().nth(1), Some(&bob));
    assert_eq!(anna.provisions(&robot, &["--operators"]), "anna-b\nbob\n");

    // With his key in his keyring, bob owns the robot as anna does: another network keeps both.
    let his = Operator::new();
    his.keyring().store("walker-0ab3", &key).unwrap();
    his.provisions(&robot, &["--ssid", "home", "--operator", "robert"]);
    assert_eq!(
        (robot.kept().network().as_bytes(), robot.kept().names()),
        (&b"home"[..], vec!["anna-b".into(), "robert".into()])
    );

    his.fails(&robot, &["--revoke-operator", "carla"], 2, "anna-b, robert");
    his.provisions(&robot, &["--revoke-operator", "anna-b"]);
    assert_eq!(robot.kept().names(), ["robert"]);
    anna.fails(&robot, &["--operators"], 20, "--new-key");
}

#[test]
fn an_operator_that_the_robot_refuses_leaves_no_key_behind() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--operator", "anna"]);
    operator.fails(&robot, &["--add-operator", "anna"], 32, "another operator has this name");
    assert!(!operator.home.path().join("walker-0ab3-anna.key").exists());
    let file = operator.home.path().join("known.key");
    fs::write(&file, "mine").unwrap();
    let words = ["--add-operator", "bob", "--key-file", "known.key"];
    operator.fails(&robot, &words, 2, "exists already");
    assert_eq!(fs::read_to_string(file).unwrap(), "mine");
    assert_eq!(robot.kept().names(), ["anna"]);
}

#[test]
fn a_new_key_erases_all_former_ones_and_says_whose() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--operator", "anna"]);
    operator.provisions(&robot, &["--add-operator", "bob"]);
    let kept = operator.provisions(&robot, &["--ssid", "home", "--operator", "anna"]);
    assert!(!kept.contains("erased"), "{kept}");
    let said = operator.provisions(&robot, &["--ssid", "lab", "--new-key"]);
    assert!(said.contains("erased: anna, bob"), "{said}");
    assert_eq!(robot.kept().names(), ["anna-b"]);
}

#[test]
fn a_robot_without_an_owner_has_no_operators_to_change() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    for task in [&["--operators"][..], &["--add-operator", "bob"], &["--revoke-operator", "bob"]] {
        operator.fails(&robot, task, 32, "provision it first");
    }
}

#[test]
fn a_fixed_address_is_sent_and_remembered() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    let words = ["--ssid", "lab", "--address", "10.0.0.7/24", "--gateway", "10.0.0.1"];
    operator.provisions(&robot, &words);
    let address = robot.kept().address().unwrap();
    assert_eq!((address.address, address.prefix_length), ([10, 0, 0, 7], 24));
    assert_eq!(address.gateway, Some([10, 0, 0, 1]));
    assert_eq!(operator.keyring().address("walker-0ab3").as_deref(), Some("10.0.0.7"));
}

#[test]
fn the_password_can_come_from_a_file_and_what_is_not_seen_in_it_is_remarked() {
    for (text, password, is_remarked) in [
        ("from a file\n", "from a file", false),
        // As editors of Windows write it.
        ("\u{feff}from a file\r\n", "from a file", false),
        ("blank at the end \n", "blank at the end ", true),
        ("\u{a0}no break", "\u{a0}no break", true),
        ("no\u{200b}width", "no\u{200b}width", true),
        ("an em\u{2003}quad", "an em\u{2003}quad", true),
    ] {
        let (operator, robot) = (Operator::new(), CabledRobot::new());
        let file = operator.home.path().join("password");
        fs::write(&file, text).unwrap();
        let words = ["--ssid", "lab", "--password-file", file.to_str().unwrap()];
        fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
        operator.fails(&robot, &words, 2, "--password-file - <");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
        let said = operator.provisions(&robot, &words);
        assert_eq!(robot.kept().password(), password);
        assert_eq!(said.contains("taken as it is"), is_remarked, "{text:?}: {said}");
    }
}

#[test]
fn an_open_network_has_no_password() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "café", "--open"]);
    let kept = robot.kept();
    assert_eq!((kept.network().as_bytes(), kept.password()), ("café".as_bytes(), ""));
}

#[test]
fn a_network_whose_name_is_not_utf_8_is_named_by_its_bytes() {
    for (text, bytes) in
        [(r"caf\xe9", &b"caf\xe9"[..]), (r"\xff\\x", b"\xff\\x"), ("a\u{2019}s", b"a\xe2\x80\x99s")]
    {
        let (operator, robot) = (Operator::new(), CabledRobot::new());
        let said = operator.provisions(&robot, &["--ssid", text]);
        assert_eq!(robot.kept().network().as_bytes(), bytes);
        assert!(said.contains(&format!("the network `{text}`")), "{said}");
    }
}

#[test]
fn a_robot_forgets_before_it_is_given_away() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    operator.provisions(&robot, &["--forget"]);
    assert!(robot.kept.lock().unwrap().is_none());
}

#[test]
fn the_name_of_a_robot_that_forgot_is_free_for_the_next() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--address", "10.0.0.7/24"]);
    let former = robot.kept().key();
    assert!(operator.provisions(&robot, &["--forget"]).contains("walker-0ab3.forgotten"));
    assert_eq!(operator.keyring().names(), <[&str; 0]>::default());
    operator.provisions(&robot, &["--ssid", "lab"]);
    assert_eq!(robot.kept().name(), "walker-0ab3");
    assert_ne!(robot.kept().key(), former);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
    assert_eq!(operator.keyring().address("walker-0ab3"), None, "that was the former one's");
}

#[test]
fn a_robot_that_does_not_prove_its_key_or_does_not_forget_leaves_the_keyring_alone() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab"]);
    let driving = CabledRobot::with_trouble(0, Some(ProvisionRefusal::Driving));
    *driving.kept.lock().unwrap() = Some(robot.kept());
    operator.fails(&driving, &["--forget"], 32, "disarm");
    let device = CabledRobot::new();
    let provisioning = Provisioning::new("walker-0ab3", "lab", "password", None).unwrap();
    let operators = Operators::from(Some(Key::new([9; 32])));
    *device.kept.lock().unwrap() = Some(Kept { provisioning, operators });
    operator.provisions(&device, &["--forget"]);
    assert_eq!(operator.keyring().key("walker-0ab3").unwrap(), robot.kept().key());
}

#[test]
fn a_robot_that_leaves_its_fixed_address_is_found_by_its_name_again() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    operator.provisions(&robot, &["--ssid", "lab", "--address", "10.0.0.7/24"]);
    operator.provisions(&robot, &["--ssid", "home"]);
    assert_eq!(operator.keyring().address("walker-0ab3"), None);
}

#[test]
fn the_operator_has_the_name_of_the_user_on_every_system() {
    for (variables, name) in [
        (&[("USERNAME", "Anna Berg")][..], "Anna-Berg"),
        (&[("USER", ""), ("LOGNAME", "anna")], "anna"),
        (&[("USER", "анна"), ("USERNAME", "anna")], "anna"),
        (&[("USER", "anna"), ("USERNAME", "bob")], "anna"),
        (&[], "owner"),
    ] {
        let (operator, robot) = (Operator::new(), CabledRobot::new());
        let mut command = operator.command(&robot, &["--ssid", "lab"]);
        let status = command.env_remove("USER").envs(variables.iter().copied()).output().unwrap();
        assert!(status.status.success());
        assert_eq!(robot.kept().names(), [name]);
    }
}

#[test]
fn values_that_no_robot_takes_are_usage() {
    let (operator, robot) = (Operator::new(), CabledRobot::new());
    for (words, word) in [
        (&["--ssid", ""][..], "network"),
        (&["--ssid", &"x".repeat(33)], "network"),
        (&["--ssid", r"home\lab"], r"`\\` is a backslash"),
        (&["--ssid", r"lab\x00"], "zero"),
        (&["--ssid", "lab", "--name", "a b"], "name"),
        (&["--ssid", "lab", "--address", "10.0.0.7"], "10.0.0.7/24"),
        (&["--ssid", "lab", "--operator", "a b"], "operator's name"),
        (&["--add-operator", "a-name-too-long-x"], "operator's name"),
        (&["--ssid", "lab", "--operators"], "--operators"),
        (&["--name", "rover", "--forget"], "--forget"),
        (&["--wait", "--no-wait"], "--no-wait"),
        (&["--ssid", "lab", "--wait"], "--wait"),
        (&[], "--add-operator"),
        (&["--ssid", "lab", "--password-file", "/nonexistent"], "/nonexistent"),
    ] {
        operator.fails(&robot, words, 2, word);
    }
    assert!(robot.kept.lock().unwrap().is_none());
}

#[test]
fn a_port_that_is_not_there_is_usage_with_what_to_look_for() {
    let operator = Operator::new();
    let output = Command::new(env!("CARGO_BIN_EXE_flix"))
        .args(["provision", "--port", "/dev/ttyNONE", "--ssid", "lab"])
        .env("XDG_CONFIG_HOME", operator.home.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8(output.stderr).unwrap().contains("dialout"));
}

#[test]
fn a_port_without_an_answer_shows_its_last_lines() {
    let operator = Operator::new();
    let robot = CabledRobot::with_trouble(u32::MAX, None);
    operator.fails(&robot, &["--ssid", "lab"], 10, "another firmware");
    operator.fails(&robot, &["--ssid", "lab"], 10, "I (42) boot: not there yet");
}
