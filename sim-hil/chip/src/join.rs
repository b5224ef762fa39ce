//! How a robot comes onto its network when not everything goes well: a pass phrase whose key takes the radio's library two
//! seconds, DHCP that loses a message and refuses for others, attempts of which nothing comes, a wrong password for minutes.

use std::time::Duration;

use flix_firmware::robot::UNPROVISIONED;
use flix_host::link::joining::{JoinError, PATIENCE, Wait};
use flix_protocol::provision::{Answer, JoinFailure, NetworkAddress, Provisioning, Request};
use serde::Serialize;

use crate::rig::{Rig, RigError};
use flix_esp32c6::chip::ResetReason;
use flix_esp32c6::cycles;
use flix_esp32c6::marks::Memory;
use flix_esp32c6::network::{
    AccessPoint, DISCOVER, DhcpTrouble, ENTERPRISE_NAME, LATIN_NAME, NAME, PASSPHRASE, REQUEST,
    Silence,
};

/// From the connection to an address, of which the first message was lost.
const ADDRESS: Duration = Duration::from_secs(5);
/// The first repetition of DHCP comes between these.
const REPETITION: [Duration; 2] = [Duration::from_secs(2), Duration::from_secs(4)];
/// So many messages are enough.
const MESSAGES: usize = 10;
/// A refused lease is asked for so rarely: messages in [`REFUSED`].
const REFUSED_MESSAGES: usize = 12;
const REFUSED: Duration = Duration::from_secs(10);
/// From an attempt of which nothing came to the next.
const RETRY: Duration = Duration::from_secs(30);
/// From the first attempt of which nothing came to a driver that is made anew, and connects.
const RENEWAL: Duration = Duration::from_secs(120);
/// From there to a restart, where that has not helped either.
const RESTART: Duration = Duration::from_secs(120);
/// How often a radio does not start: with the chip, and at the next three attempts.
const LATE_START: u32 = 4;
/// While the cable is in use, something comes over it so often.
const CABLE: Duration = Duration::from_secs(10);
/// The password stays wrong for so long; the same in short.
const WRONG: Duration = Duration::from_secs(600);
const QUICK_WRONG: Duration = Duration::from_secs(12);
/// A robot whose password is right again is connected by then: the longest wait, an attempt with the wrong one, one more.
const RIGHT_AGAIN: Duration = Duration::from_secs(40);
/// A network that is not there.
const ABSENT: &str = "lab-5G";
/// How often the robot is asked over the cable how far it is.
const ASK: Duration = Duration::from_millis(250);
/// From the connection to the next one without an address in between.
const REASSOCIATION: Duration = Duration::from_secs(70);
/// What the robot is called in DHCP.
const HOST_NAME: &str = "flix-walker";
const OTHER_PASSPHRASE: &str = "another pass phrase";

/// Result of a join.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Join {
    /// From the start to the first connection, s.
    pub connected_after_s: f64,
    /// From there to an address, of which the first message was lost, s.
    pub address_after_s: f64,
    /// Messages of DHCP by then.
    pub dhcp_messages: usize,
    /// From an attempt of which nothing came to the next, s.
    pub retried_after_s: f64,
    /// From the first of several to a connection by a driver that was made anew, s.
    pub renewed_after_s: f64,
    /// From provisioning to what the cable states: a wrong password, no such network, no DHCP, an address, s.
    pub stated_after_s: Vec<f64>,
    /// From a start without the radio to a connection, s.
    pub started_late_after_s: f64,
    /// From there to a restart, s; none in short.
    pub restarted_after_s: Option<f64>,
    /// What does not hold, in sentences.
    pub failures: Vec<String>,
}

/// Tries all of it with a new robot, whose radio's library takes as long as it may.
pub fn try_all(rig: &mut Rig, is_quick: bool, progress: &dyn Fn(&str)) -> Result<Join, RigError> {
    let mut join = Join::default();
    for (name, scene) in SCENES {
        progress(&format!("joining: {name}"));
        scene(&mut join, rig, is_quick)?;
        // In short, the first failure is enough.
        if is_quick && !(join.failures.is_empty() && unasked(rig).is_empty()) {
            break;
        }
    }
    join.failures.extend(unasked(rig));
    join.failures.extend(Memory::of(&rig.chip).failures());
    join.failures.extend(rig.findings());
    join.failures.iter_mut().for_each(|failure| failure.insert_str(0, "joining: "));
    Ok(join)
}

/// What is tried, in this order: its name, and how.
type Scene = fn(&mut Join, &mut Rig, bool) -> Result<(), RigError>;
const SCENES: [(&str, Scene); 7] = [
    ("a pass phrase, DHCP that loses and refuses", |join, rig, _| join.dhcp(rig)),
    ("the same network once more, and a refused lease", |join, rig, _| join.refusals(rig)),
    ("a wrong password", |join, rig, is_quick| {
        join.wrong_password(rig, if is_quick { QUICK_WRONG } else { WRONG })
    }),
    ("what the cable states of a join", |join, rig, is_quick| join.cable(rig, is_quick)),
    ("attempts of which nothing comes", |join, rig, _| join.silence(rig)),
    ("a radio that does not start at first", |join, rig, _| join.late_start(rig)),
    ("a radio that only a restart helps", |join, rig, is_quick| match is_quick {
        true => Ok(()),
        false => join.restart(rig),
    }),
];

/// Returns sentences about resets that nobody asked for.
fn unasked(rig: &Rig) -> Vec<String> {
    let unasked = rig.resets.iter().filter(|(_, reason)| *reason != ResetReason::Software);
    unasked.map(|(at, reason)| format!("a reset by {reason:?} after {at:?}")).collect()
}

/// Takes the network away and gives it back, and waits for the connection.
fn reconnect(rig: &mut Rig) -> Result<(), RigError> {
    lose(rig)?;
    rig.until_log("connection to the network", "wi-fi: connected")
}

/// Takes the network away and gives it back before the next attempt.
fn lose(rig: &mut Rig) -> Result<(), RigError> {
    rig.chip.network.air.is_up = false;
    rig.until_log("loss of the network", "wi-fi: lost")?;
    rig.chip.network.air.is_up = true;
    Ok(())
}

/// Runs until something is so, at most for `limit`; returns how long that took, s, if it came to be.
fn wait_for(
    rig: &mut Rig,
    limit: Duration,
    mut is_so: impl FnMut(&mut Rig) -> bool,
) -> Result<Option<f64>, RigError> {
    let began = rig.chip.now();
    while !is_so(rig) {
        if rig.chip.now() > began + limit {
            return Ok(None);
        }
        rig.step()?;
    }
    Ok(Some((rig.chip.now() - began).as_secs_f64()))
}

/// Whether the log says that it is connected after its first `from` bytes.
fn is_connected(rig: &Rig, from: usize) -> bool {
    let text = b"wi-fi: connected";
    let from = from.saturating_sub(text.len());
    rig.serial[from..].windows(text.len()).any(|window| window == text)
}

/// Asks over the cable until it is decided how the robot joins, as `flix provision` does; returns that, and when, s.
fn stated(rig: &mut Rig) -> Result<(Result<NetworkAddress, JoinError>, f64), RigError> {
    let (mut wait, began) = (Wait::default(), rig.chip.now());
    loop {
        let answer = rig.ask_serial(&Request::Network)?;
        let waited = rig.chip.now() - began;
        // An answer to a question before is passed over.
        if let Answer::Network(state) = answer
            && let Some(result) = wait.hear(state, waited)
        {
            return Ok((result, waited.as_secs_f64()));
        }
        rig.run(ASK)?;
    }
}

impl Join {
    fn expect(&mut self, found: Option<f64>, what: &str, limit: Duration) -> f64 {
        found.unwrap_or_else(|| {
            self.failures.push(format!("no {what} within {} s", limit.as_secs()));
            f64::INFINITY
        })
    }

    fn dhcp(&mut self, rig: &mut Rig) -> Result<(), RigError> {
        rig.chip.network.trouble = DhcpTrouble { lost: 1, refuses: false, has_refuser: true };
        rig.until_log("invitation to provision", "flix provision")?;
        self.hears_all(rig, 1)?;
        let provisioning = rig.provisioning(None)?;
        rig.ask_serial(&Request::Provision(provisioning, rig.operator()))?;
        let began = rig.chip.now();
        rig.until_log("connection to the network", "wi-fi: connected")?;
        self.connected_after_s = (rig.chip.now() - began).as_secs_f64();
        let found = wait_for(rig, ADDRESS, |rig| rig.chip.network.station().is_some())?;
        self.address_after_s = self.expect(found, "address", ADDRESS);
        let messages = &rig.chip.network.dhcp;
        self.dhcp_messages = messages.len();
        if messages.len() > MESSAGES {
            self.failures.push(format!("{} messages of DHCP for an address", messages.len()));
        }
        let mut discovers = messages.iter().filter(|(_, kind)| *kind == DISCOVER);
        if let (Some((first, _)), Some((second, _))) = (discovers.next(), discovers.next()) {
            let [least, most] = REPETITION.map(cycles);
            if !(least..=most).contains(&(second - first)) {
                let ms = (second - first) * 1_000 / flix_esp32c6::CYCLES_PER_SECOND;
                self.failures.push(format!("DHCP repeats its first message after {ms} ms"));
            }
        }
        rig.chip.network.trouble = DhcpTrouble::default();
        let said = rig.chip.network.host_name.as_deref().unwrap_or_default();
        if said != HOST_NAME.as_bytes() {
            let said = String::from_utf8_lossy(said);
            self.failures.push(format!("DHCP hears the host name {said:?}, not {HOST_NAME:?}"));
        }
        self.group_report(rig, 0)?;
        let reports = rig.chip.network.group_reports;
        reconnect(rig)?;
        self.group_report(rig, reports)?;
        rig.connect()?;
        rig.is_alone = true;
        Ok(())
    }

    /// Asks over the cable for the access points that the robot hears.
    fn hears_all(&mut self, rig: &mut Rig, number: u8) -> Result<(), RigError> {
        let began = rig.chip.now();
        let heard = loop {
            match rig.ask_serial(&Request::Scan { number, from: 0 })? {
                Answer::Networks(Some(heard)) => break heard.networks,
                _ if rig.chip.now() > began + RETRY => break Default::default(),
                _ => rig.run(ASK)?,
            }
        };
        let mut there = AccessPoint::all();
        there.sort_by_key(|it| -it.dbm);
        let found = heard.iter().map(|it| (it.name.as_bytes(), it.channel, i32::from(it.dbm)));
        if !found.eq(there.iter().map(|it| (&it.name[..], it.channel, it.dbm))) {
            self.failures.push(format!("scan {number} hears {heard:?}, not {there:?}"));
        }
        Ok(())
    }

    /// Waits until the robot has reported its group once more.
    fn group_report(&mut self, rig: &mut Rig, reports: u64) -> Result<(), RigError> {
        let is_reported = |rig: &mut Rig| rig.chip.network.group_reports > reports;
        let found = wait_for(rig, ADDRESS, is_reported)?;
        self.expect(found, "report of the group of multicast DNS", ADDRESS);
        Ok(())
    }

    /// The server itself refuses each request: asked again, but not as fast as it answers.
    fn refusals(&mut self, rig: &mut Rig) -> Result<(), RigError> {
        rig.chip.network.trouble.refuses = true;
        rig.chip.network.dhcp.clear();
        reconnect(rig)?;
        rig.run(REFUSED)?;
        let count = rig.chip.network.dhcp.len();
        let requests = rig.chip.network.dhcp.iter().filter(|(_, kind)| *kind == REQUEST).count();
        if count > REFUSED_MESSAGES || requests == 0 {
            let s = REFUSED.as_secs();
            self.failures.push(format!("{count} messages of DHCP in {s} s while it is refused"));
        }
        rig.chip.network.trouble.refuses = false;
        reconnect(rig)?;
        self.hears_all(rig, 2)?;
        rig.connect()?;
        rig.is_alone = true;
        Ok(())
    }

    fn silence(&mut self, rig: &mut Rig) -> Result<(), RigError> {
        rig.chip.network.silence = Silence::Once;
        lose(rig)?;
        let attempts = rig.chip.counters().connect_attempts;
        let from = rig.serial.len();
        wait_for(rig, RETRY, |rig| rig.chip.counters().connect_attempts > attempts)?;
        let retry = |rig: &mut Rig| rig.chip.counters().connect_attempts > attempts + 1;
        let found = wait_for(rig, RETRY, retry)?;
        self.retried_after_s = self.expect(found, "second attempt", RETRY);
        let connected = wait_for(rig, RETRY, |rig| is_connected(rig, from))?;
        self.expect(connected, "connection after it", RETRY);

        rig.chip.network.silence = Silence::UntilRenewed;
        lose(rig)?;
        let from = rig.serial.len();
        let found = wait_for(rig, RENEWAL, |rig| is_connected(rig, from))?;
        self.renewed_after_s = self.expect(found, "driver that is made anew and connects", RENEWAL);
        Ok(())
    }

    /// The radio's library does not start with the chip, nor at the next attempts.
    fn late_start(&mut self, rig: &mut Rig) -> Result<(), RigError> {
        rig.chip.network.start_failures = LATE_START;
        rig.chip.power_on();
        rig.until_log("radio that does not start", "wi-fi: does not start")?;
        let from = rig.serial.len();
        let found = wait_for(rig, RENEWAL, |rig| is_connected(rig, from))?;
        self.started_late_after_s = self.expect(found, "radio that starts late", RENEWAL);
        if String::from_utf8_lossy(&rig.serial[from..]).contains(UNPROVISIONED) {
            self.failures.push("a robot with a key states that it has none".to_owned());
        }
        Ok(())
    }

    /// The robot is given other words over its cable, and states there how it joins.
    fn cable(&mut self, rig: &mut Rig, is_quick: bool) -> Result<(), RigError> {
        let lease = rig.lease();
        let (address, prefix_length) = (lease.address, lease.prefix_length);
        let address = NetworkAddress { address, prefix_length, is_fixed: false };
        let [name, absent, school] = [NAME, ABSENT, ENTERPRISE_NAME].map(str::as_bytes);
        for (network, password, has_dhcp, expected) in [
            (name, OTHER_PASSPHRASE, true, Err(JoinError::Failed(JoinFailure::Password))),
            (absent, PASSPHRASE, true, Err(JoinError::Failed(JoinFailure::Absent))),
            (school, PASSPHRASE, true, Err(JoinError::Failed(JoinFailure::Security))),
            (LATIN_NAME, PASSPHRASE, true, Ok(address)),
            (name, PASSPHRASE, false, Err(JoinError::NoAddress(20))),
            (absent, OTHER_PASSPHRASE, true, Err(JoinError::Failed(JoinFailure::Absent))),
            (name, PASSPHRASE, true, Ok(address)),
        ] {
            rig.chip.network.trouble.lost = if has_dhcp { 0 } else { u32::MAX };
            let provisioning = Provisioning::new("walker", network, password, None)
                .map_err(|error| RigError::Fault(error.to_string()))?;
            rig.ask_serial(&Request::Provision(provisioning, rig.operator()))?;
            let (stated, after_s) = stated(rig)?;
            self.stated_after_s.push(after_s);
            if stated != expected || after_s > PATIENCE.as_secs_f64() {
                let sentence = format!("the cable states {stated:?}, not {expected:?},");
                let network = network.escape_ascii();
                self.failures.push(format!("{sentence} {after_s:.1} s after {network} was given"));
            }
            if !(has_dhcp || is_quick) {
                let from = rig.serial.len();
                let again = wait_for(rig, REASSOCIATION, |rig| is_connected(rig, from))?;
                self.expect(again, "new connection without an address", REASSOCIATION);
            }
        }
        rig.connect()?;
        rig.is_alone = true;
        Ok(())
    }

    fn restart(&mut self, rig: &mut Rig) -> Result<(), RigError> {
        rig.chip.network.silence = Silence::UntilRestarted;
        lose(rig)?;
        let resets = rig.resets.len();
        let mut due = rig.chip.now();
        let in_use = |rig: &mut Rig| {
            if rig.chip.now() >= due {
                due += CABLE;
                rig.chip.send_serial(b"\0");
            }
            rig.resets.len() > resets
        };
        if wait_for(rig, RENEWAL + RESTART, in_use)?.is_some() {
            self.failures.push("the chip restarts while its cable is in use".to_owned());
        }
        let found = wait_for(rig, RENEWAL + RESTART, |rig| rig.resets.len() > resets)?;
        let limit = RENEWAL + RESTART;
        self.restarted_after_s = Some(self.expect(found, "restart without the cable", limit));
        rig.until_log("connection to the network", "wi-fi: connected")
    }

    fn wrong_password(&mut self, rig: &mut Rig, time: Duration) -> Result<(), RigError> {
        rig.chip.network.change_passphrase(OTHER_PASSPHRASE);
        let resets = rig.resets.len();
        lose(rig)?;
        rig.run(time)?;
        if rig.resets.len() > resets {
            self.failures.push("the chip restarts while the password is wrong".to_owned());
        }
        rig.chip.network.change_passphrase(PASSPHRASE);
        let from = rig.serial.len();
        let found = wait_for(rig, RIGHT_AGAIN, |rig| is_connected(rig, from))?;
        self.expect(found, "connection with the right password", RIGHT_AGAIN);
        Ok(())
    }
}
