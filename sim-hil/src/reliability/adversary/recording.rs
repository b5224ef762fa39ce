//! A session that was recorded whole, its renewal too, and the pre-shared key that is learnt later.
//!
//! Who has both derives what can be derived of them, by the rules of [`flix_protocol::session`] written down here once more, with
//! ephemeral secrets that are missing or that everybody could guess, and tries to open what the two ends sealed. Another is
//! given what the operator's program has wiped, too, the secret half of its ephemeral key: unless that opens everything, the
//! attack shows nothing.

use core::net::SocketAddr;
use std::time::Duration;

use chacha20poly1305::aead::AeadInOut;
use chacha20poly1305::{ChaCha20Poly1305, KeyInit};
use flix_protocol::frame::{Confirm, Datagram, ECHO_LENGTH, Nonce, PublicKey, Sealed};
use flix_protocol::message::{Command, Outcome, Reply, ToOperator, ToRobot};
use flix_protocol::session::{
    OperatorSession, RobotReceived, RobotSession, SESSION_EXPIRY, SESSION_RENEWAL, VERSION,
};
use flix_protocol::units::Instant;
use hkdf::{Hkdf, HkdfExtract};
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sha2::Sha256;
use x25519_dalek::x25519;

use super::findings::Findings;
use super::kind::Kind;
use crate::rig::bench::bench_key;

const OPERATOR: ([u8; 4], u16) = ([192, 0, 2, 10], 40_000);
/// Sessions that are recorded.
const SESSIONS: u64 = 20;
/// From one command to the next: no session is forgotten meanwhile.
const STEP: Duration = SESSION_EXPIRY.saturating_sub(Duration::from_secs(1));
/// Time that is recorded: past a renewal.
const RECORDED: Duration = SESSION_RENEWAL.saturating_add(Duration::from_secs(60));

/// Returns whether a recording fails to be forward secret: whether the key opens any of it, or does not open all of it together with the
/// secret half of an ephemeral key.
const fn is_failure(opened: u64, opened_with_secret: u64, sealed: u64) -> bool {
    opened > 0 || opened_with_secret != sealed || sealed == 0
}

/// Records sessions, and attacks what was recorded.
pub(super) fn run(seed: u64) -> Findings {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed ^ (Kind::RecordedSession as u64) << 40);
    let mut findings = Findings::default();
    for _ in 0..SESSIONS {
        let [mut robot, mut operator] = [[0; 32]; 2];
        random.fill_bytes(&mut robot);
        random.fill_bytes(&mut operator);
        let recording = record(robot, operator);
        let sealed = |it: &&Vec<u8>| matches!(Datagram::parse(it), Some(Datagram::Sealed(_)));
        let sealed = recording.iter().filter(sealed).count() as u64;
        let opened = open(&recording, &guesses());
        let opened_with_secret = open(&recording, &[Ephemeral::Secret(wiped(operator))]);
        findings.count(Kind::RecordedSession, sealed);
        findings.failures += u64::from(is_failure(opened, opened_with_secret, sealed));
    }
    findings
}

/// Returns all that crosses the network in a session of two ends with these seeds.
fn record(robot: [u8; 32], operator: [u8; 32]) -> Vec<Vec<u8>> {
    let begun = Instant::START + STEP;
    let mut now = begun;
    let mut robot = RobotSession::new(bench_key(), robot);
    let mut operator = OperatorSession::new(bench_key(), operator, now);
    let mut recording = Vec::new();
    while now.since(begun) < RECORDED {
        while let Some(datagram) = operator.poll(now) {
            recording.push(datagram.to_vec());
            let received = robot.receive(now, SocketAddr::from(OPERATOR), &datagram);
            if let RobotReceived::Answer(answer) | RobotReceived::Connected(answer) = received {
                recording.push(answer.to_vec());
                operator.receive(now, &answer);
            }
        }
        let report = ToOperator::Reply(Reply { request: 1, outcome: Outcome::Done });
        if let Ok((_, report)) = robot.send(now, &report) {
            recording.push(report.to_vec());
            operator.receive(now, &report);
        }
        let ping = ToRobot::request(1, Command::Ping(1));
        if let Ok(ping) = operator.send(now, &ping) {
            recording.push(ping.to_vec());
            robot.receive(now, SocketAddr::from(OPERATOR), &ping);
        }
        now = now + STEP;
    }
    recording
}

/// What the attacker takes for the operator's ephemeral key.
enum Ephemeral {
    /// The keys come of the pre-shared key and the nonces.
    None,
    /// They come of the public halves besides.
    Public,
    /// They come of this secret on which both ends agree.
    Shared([u8; 32]),
    /// This is the operator's secret half.
    Secret([u8; 32]),
}

fn guesses() -> [Ephemeral; 4] {
    let zero = [0; 32];
    [Ephemeral::None, Ephemeral::Public, Ephemeral::Shared(zero), Ephemeral::Secret(zero)]
}

/// Returns the secret half that an operator with this seed drew: its second secret, after the nonce of Hello.
fn wiped(seed: [u8; 32]) -> [u8; 32] {
    let [mut next, mut secret] = [[0; 32]; 2];
    expand(&Hkdf::new(None, &seed), b"flix entropy", &mut next);
    expand(&Hkdf::new(None, &next), b"flix secret", &mut secret);
    secret
}

/// Returns how many sealed datagrams open, with the pre-shared key and what of this is right.
fn open(recording: &[Vec<u8>], ephemerals: &[Ephemeral]) -> u64 {
    let mut keys: Vec<Keys> = Vec::new();
    let (mut nonces, mut client) = ([Nonce::default(); 2], PublicKey::default());
    let mut opened = 0;
    for datagram in recording.iter().filter_map(|datagram| Datagram::parse(datagram)) {
        match datagram {
            Datagram::Confirm(Confirm { client_nonce, robot_nonce, client_public, .. }) => {
                (nonces, client) = ([client_nonce, robot_nonce], client_public);
            }
            Datagram::Accept { robot_public, .. } => {
                let first = |it: &Ephemeral| Keys::first(it, nonces, [client, robot_public]);
                keys.extend(ephemerals.iter().map(first));
            }
            Datagram::Sealed(Sealed { is_renewal, counter, header, ciphertext, tag, .. }) => {
                let opens = |it: &Keys| it.open(counter, header, ciphertext, &tag);
                let Some((next, plain)) = keys.iter().find_map(|it| Some((it.next, opens(it)?)))
                else {
                    continue;
                };
                opened += 1;
                // The operator's nonce comes behind an echo, the robot's alone.
                match plain.get(ECHO_LENGTH..).and_then(|nonce| nonce.try_into().ok()) {
                    Some(nonce) if is_renewal => nonces[0] = nonce,
                    _ if is_renewal => {
                        nonces[1] = plain.try_into().unwrap_or_default();
                        keys.push(Keys::derive(nonces, &[&next]));
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
    opened
}

/// What seals a session.
struct Keys {
    to_robot: [u8; 32],
    to_operator: [u8; 32],
    next: [u8; 32],
}

impl Keys {
    fn first(ephemeral: &Ephemeral, nonces: [Nonce; 2], publics: [PublicKey; 2]) -> Self {
        let key = bench_key();
        let [client, robot] = &publics;
        match ephemeral {
            Ephemeral::None => Self::derive(nonces, &[key.as_bytes()]),
            Ephemeral::Public => Self::derive(nonces, &[key.as_bytes(), client, robot]),
            Ephemeral::Shared(shared) => {
                Self::derive(nonces, &[key.as_bytes(), shared, client, robot])
            }
            Ephemeral::Secret(secret) => {
                let shared = x25519(*secret, *robot);
                Self::derive(nonces, &[key.as_bytes(), &shared, client, robot])
            }
        }
    }

    fn derive(nonces: [Nonce; 2], secrets: &[&[u8; 32]]) -> Self {
        let mut extract = HkdfExtract::<Sha256>::new(Some(nonces.as_flattened()));
        for secret in secrets {
            extract.input_ikm(*secret);
        }
        let (_, derivation) = extract.finalize();
        let key = |purpose: &str| {
            let mut key = [0; 32];
            let schema_key = VERSION.schema_key.to_le_bytes();
            let info = [&b"flix session "[..], purpose.as_bytes(), &schema_key].concat();
            expand(&derivation, &info, &mut key);
            key
        };
        Self { to_robot: key("r"), to_operator: key("o"), next: key("n") }
    }

    fn open(
        &self,
        counter: u64,
        header: &[u8],
        ciphertext: &[u8],
        tag: &[u8; 16],
    ) -> Option<Vec<u8>> {
        let mut nonce = [0; 12];
        nonce[4..].copy_from_slice(&counter.to_le_bytes());
        [self.to_robot, self.to_operator].into_iter().find_map(|key| {
            let mut plain = ciphertext.to_vec();
            let opened = ChaCha20Poly1305::new(&key.into()).decrypt_inout_detached(
                &nonce.into(),
                header,
                plain.as_mut_slice().into(),
                tag.into(),
            );
            opened.ok().map(|()| plain)
        })
    }
}

fn expand(derivation: &Hkdf<Sha256>, info: &[u8], output: &mut [u8; 32]) {
    derivation.expand(info, output).expect("HKDF-SHA256 gives up to 8160 bytes");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_recorded_stays_closed_when_the_key_is_learnt_later() {
        assert_eq!(run(3).failures, 0);
    }

    #[test]
    fn a_session_is_recorded_past_its_renewal_and_opens_whole_with_the_ephemeral_secret() {
        let recording = record([1; 32], [2; 32]);
        let mut sessions = std::collections::BTreeSet::new();
        let (mut renewals, mut sealed) = (0, 0);
        for datagram in recording.iter().filter_map(|datagram| Datagram::parse(datagram)) {
            if let Datagram::Sealed(Sealed { is_renewal, session, .. }) = datagram {
                sessions.insert(session);
                renewals += u32::from(is_renewal);
                sealed += 1;
            }
        }
        assert_eq!((sessions.len(), renewals), (2, 2));
        assert_eq!(open(&recording, &[Ephemeral::Secret(wiped([2; 32]))]), sealed);
    }

    #[test]
    fn a_recording_that_the_key_opens_or_that_nothing_opens_is_not_forward_secret() {
        let verdicts = [(0, 9, 9), (1, 9, 9), (0, 8, 9), (0, 0, 0)];
        let verdicts =
            verdicts.map(|(opened, with_secret, sealed)| is_failure(opened, with_secret, sealed));
        assert_eq!(verdicts, [false, true, true, true]);
    }
}
