//! A computer whose address changes while it talks to a robot. Each test runs in a network of its own, which Linux lends: its robot
//! is at [`ROBOT`], and the computer sends from one of two other addresses.

use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use flix_host::link::udp::{Connection, stop};
use flix_host::link::{RobotLink, Update};
use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::{Setpoint, State};

use crate::support::{FakeRobot, ServedRobot, key};

const ROBOT: &str = "10.9.0.1";
const HOME: &str = "10.9.0.2";
const AWAY: &str = "10.9.0.3";
/// Says to the program of the tests that it is in a network of its own.
const IS_INSIDE: &str = "FLIX_NETWORK_OF_ITS_OWN";
/// Within it a computer that moves is back: until the robot takes the silence for the end of a session, and some handshakes.
const BACK: Duration = Duration::from_millis(2_500);

/// Runs the test of this name, `body`, in a network of its own; where the system lends none, not at all.
fn within(name: &str, body: fn()) {
    if std::env::var_os(IS_INSIDE).is_some() {
        return body();
    }
    let lent = |words: &[&str]| {
        let mut command = Command::new("unshare");
        command.args(words).args(["--net", "--"]);
        command
    };
    let ways: [&[&str]; 2] = [&[], &["--map-root-user"]];
    let is_lent =
        |words: &&[&str]| lent(words).arg("true").output().is_ok_and(|it| it.status.success());
    let Some(words) = ways.into_iter().find(is_lent) else {
        eprintln!("passed over: the system lends no network");
        return;
    };
    let test = std::env::current_exe().unwrap();
    let inside = lent(words)
        .arg(test)
        .args(["--exact", &format!("moving::{name}"), "--nocapture"])
        .env(IS_INSIDE, "1")
        .output()
        .unwrap();
    let said = [inside.stdout, inside.stderr].map(|it| String::from_utf8_lossy(&it).into_owned());
    assert!(inside.status.success(), "{}", said.concat());
}

fn ip(words: &str) {
    let ended = Command::new("ip").args(words.split(' ')).output().unwrap();
    assert!(ended.status.success(), "ip {words}: {ended:?}");
}

/// The computer sends to the robot from this address, and no more from the other.
fn move_to(address: &str, from: Option<&str>) {
    ip(&format!("addr add {address}/32 dev lo"));
    if let Some(from) = from {
        ip(&format!("addr del {from}/32 dev lo"));
    }
    ip(&format!("route replace local {ROBOT} dev lo table local src {address}"));
}

/// Serves a robot to a computer at home; the network between them loses what `lose` says.
fn serve(lose: impl FnMut() -> bool + Send + 'static) -> ServedRobot {
    ip("link set lo up");
    ip(&format!("addr add {ROBOT}/32 dev lo"));
    move_to(HOME, None);
    ServedRobot::at(ROBOT, FakeRobot::new(Some(key())), lose)
}

/// Begins a walk of a robot, from home.
fn walk() -> (ServedRobot, Connection) {
    let served = serve(|| false);
    let mut connection = Connection::open(served.address, key(), Interrupt::never()).unwrap();
    connection.wait_until_connected().unwrap();
    connection.arm().unwrap();
    let (client, now) = connection.operate();
    client.hold(now, Setpoint::saturating(-30.0, 30.0));
    connection.pause(Duration::from_millis(100)).unwrap();
    assert_eq!(served.robot().state, State::Running);
    (served, connection)
}

/// Waits until the session is open again, and looks that nothing else is reported as the end of it.
fn is_back(connection: &mut Connection) -> bool {
    let deadline = connection.now() + BACK;
    let back = connection.look_until(deadline, |_, now, update| match update {
        Some(Update::Connected) => Some(true),
        Some(Update::Failed(_)) => Some(false),
        Some(_) => None,
        None => (now >= deadline).then_some(false),
    });
    back.unwrap()
}

#[test]
fn a_computer_with_another_address_is_back_and_its_robot_disarmed() {
    within("a_computer_with_another_address_is_back_and_its_robot_disarmed", || {
        let (served, mut connection) = walk();
        move_to(AWAY, Some(HOME));
        assert!(is_back(&mut connection));
        connection.pause(Duration::from_millis(100)).unwrap();
        assert_eq!(served.robot().state, State::Disarmed);
        move_to(HOME, Some(AWAY));
        assert!(is_back(&mut connection));
    });
}

#[test]
fn a_stop_leaves_a_computer_with_another_address() {
    within("a_stop_leaves_a_computer_with_another_address", || {
        let (served, mut connection) = walk();
        move_to(AWAY, Some(HOME));
        assert!(connection.stop(Duration::from_secs(1)));
        assert!(served.robot().stopped);
    });
}

#[test]
fn a_stop_beside_a_session_goes_on_from_another_address() {
    within("a_stop_beside_a_session_goes_on_from_another_address", || {
        static IS_CUT: AtomicBool = AtomicBool::new(true);
        let served = serve(|| IS_CUT.load(Ordering::SeqCst));
        let stopped = std::thread::scope(|scope| {
            let ask = || stop(served.address, &[&key()], &Interrupt::never(), || None);
            let stopping = scope.spawn(ask);
            std::thread::sleep(Duration::from_millis(100));
            move_to(AWAY, Some(HOME));
            IS_CUT.store(false, Ordering::SeqCst);
            stopping.join().unwrap()
        });
        assert_eq!(stopped, Ok(0));
        assert!(served.robot().stopped);
    });
}
