//! Somebody on the network who sees everything, holds back and sends anything from any address, and does not have the
//! key: what he makes up ([`FORGERIES`]), what he does to genuine datagrams ([`HOLD_UPS`]) and to the renewal of keys
//! ([`RENEWALS`]), what he puts on the wire beside them ([`INTRUSIONS`]), poses in the name of the motion capture, what he does
//! at the operator's end, the cable and the cockpit's server ([`SIEGES`]), any bytes, and what he recorded, should he learn the key
//! later.

mod attacker;
mod forgery;
mod fuzz;
mod hold_up;
mod intrusion;
mod kind;
mod poses;
mod recording;
mod renewal;
mod siege;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use flix_firmware::mdns::AMPLIFICATION;
use flix_firmware::net::DISCOVERY_INTERVAL;
use flix_protocol::message::DropReason;
use rayon::prelude::*;
use serde::Serialize;

use forgery::{Scenario, Turn};
pub use hold_up::{FOREIGN_STOP_LIMIT_S, MOVEMENT_LIMIT_S, NEXT_OPERATOR_LIMIT_S};
pub use kind::{FORGERIES, HOLD_UPS, INTRUSIONS, Kind, RENEWALS, SIEGES};
pub use poses::POSE_LIMIT_M;

use crate::rig::bench::{Base, BenchError, learnt};

/// Datagrams in a scenario when there are enough for several: 100,000 a second, ten times a flood.
const DATAGRAMS_PER_SCENARIO: u64 = 900_000;
/// Bytes fuzzed in one piece of work.
const FUZZED_AT_ONCE: u64 = 5_000_000;
/// Fewest and most poses that are forged; between them, a tenth as many as datagrams.
const FEWEST_POSES: u64 = 10_000;
const MOST_POSES: u64 = 1_000_000;
/// Longest time that a handshake may take under a flood, s.
pub const HANDSHAKE_LIMIT_S: f64 = 1.0;
/// Least share of commands whose answers the operator has to hear under a flood.
pub const ANSWERS_LIMIT: f64 = 0.99;
/// Most bytes that the robot sends for each byte that somebody asks it over mDNS in its own network.
pub const AMPLIFICATION_LIMIT: f64 = AMPLIFICATION as f64;
/// Most answers to mDNS in a second.
pub const DISCOVERY_LIMIT_PER_S: u64 = 1_000 / DISCOVERY_INTERVAL.as_millis();
/// Sessions of which a quarter has to get as far as moving the robot.
const A_FEW: u64 = 2 * HOLD_UPS.len() as u64;

/// How much of an attack.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Datagrams that the attacker makes up.
    pub datagrams: u64,
    /// Sessions over a network in the attacker's hands.
    pub sessions: u64,
    /// Bytes fed to decoders, sessions and the robot.
    pub bytes: u64,
}

/// Verdict of an attack.
#[derive(Debug, Clone, Serialize)]
pub struct Verdict {
    /// The robots.
    pub seed: u64,
    /// Made up by the attacker.
    pub datagrams: u64,
    /// Made up, or held up, by kind.
    pub kinds: BTreeMap<Kind, u64>,
    /// What the robots dropped of the former, by reason, whoever sent it.
    pub dropped: BTreeMap<String, u64>,
    /// Ticks in which a robot obeyed something that its twin did not; a scenario ends with its first.
    pub accepted_forgeries: u64,
    /// Ticks in which a robot moved otherwise than its twin.
    pub movements: u64,
    /// Longest time from the operator's first Hello to the session, under a flood or an intrusion, in virtual time.
    pub handshake_s: f64,
    /// Least share of an operator's commands, under a flood or an intrusion, whose answers he heard.
    pub answers_heard: f64,
    /// Ticks of the fast loop that came too late.
    pub overruns: u64,
    /// Sessions over a network in the attacker's hands.
    pub sessions: u64,
    /// Sessions in which somebody else put frames on the wire.
    pub intrusions: u64,
    /// Bytes of mDNS that each byte of a question from another network brought out.
    pub off_link_amplification: f64,
    /// Most bytes of mDNS that each byte of a question from the robot's own network brought out.
    pub on_link_amplification: f64,
    /// Most answers to mDNS in a second.
    pub discovery_answers_per_s: u64,
    /// Those among the sessions over a network in the attacker's hands in which a rotor turned when the operator's intent to move ended.
    pub driven_sessions: u64,
    /// Longest time that a rotor turned after the operator's last intent to move.
    pub longest_movement_after_intent_s: f64,
    /// Longest time from the stop of a second key holder, of whose datagrams a fifth is lost, to the latched stop.
    pub longest_foreign_stop_s: f64,
    /// Longest time from an operator's last intent to move to the next operator's session.
    pub longest_wait_of_next_operator_s: f64,
    /// Starts of movement, and clears, by operators whom the robot had not stated its present permit; orders in force that idle ones
    /// undid which were sent before them.
    pub unshown_starts: u64,
    /// Commands lost, and datagrams accepted that should not be, while keys were renewed under attack.
    pub renewal_failures: u64,
    /// Stops that counted twice, keys heard at the cable, pages turned out of the cockpit, rotors that turned again unasked, forgeries
    /// that an operator believed, and operators that were kept out.
    pub siege_failures: u64,
    /// Whether recorded sessions stay closed when the key is learnt later, and the ephemeral secrets are all that is missing to
    /// open them.
    pub forward_secret: bool,
    /// Farthest trusted pose from the robot, while somebody forges poses, m.
    pub farthest_trusted_pose_m: f64,
    /// Fed to decoders, sessions and [`flix_firmware::robot::SlowHalf::receive`].
    pub fuzzed_bytes: u64,
    /// Of any of them.
    pub panics: u64,
    /// Whether nothing was accepted, nothing moved without intent, nothing panicked, and the operators got through.
    pub pass: bool,
}

/// Attacks robots of this seed. `done` is called with what was done since its last call: datagrams, sessions or bytes.
///
/// # Errors
/// When a robot cannot be armed even without an attack.
pub fn measure(
    seed: u64,
    effort: Effort,
    done: impl Fn(u64) + Sync,
) -> Result<Verdict, BenchError> {
    attack(seed, effort, &learnt(Base::Free, seed)?, done)
}

/// Attacks robots of this seed with this in their flash.
fn attack(
    seed: u64,
    effort: Effort,
    flash: &Option<Vec<u8>>,
    done: impl Fn(u64) + Sync,
) -> Result<Verdict, BenchError> {
    let forged = forge(seed, effort.datagrams, flash, &done)?;
    // Those on a wire share one virtual time.
    let intrude =
        || if effort.sessions > 0 { intrusion::run_all(seed, flash) } else { Ok(Vec::new()) };
    let (intruded, held_up) = rayon::join(intrude, || hold_up(seed, effort.sessions, flash, &done));
    let (intruded, held_up) = (intruded?, held_up?);
    let renewed: Vec<_> = RENEWALS.into_par_iter().map(|kind| renewal::run(seed, kind)).collect();
    let besieged = siege::run_all(seed, flash)?;
    let recorded = recording::run(seed);
    let poses = poses::run(seed, (effort.datagrams / 10).clamp(FEWEST_POSES, MOST_POSES));
    let fuzzed = fuzz_all(seed, effort.bytes, &done);
    let beside = (&renewed[..], &besieged[..], recorded, poses);
    Ok(verdict(seed, effort, &forged, &held_up, &intruded, beside, &fuzzed))
}

fn forge(
    seed: u64,
    datagrams: u64,
    flash: &Option<Vec<u8>>,
    done: &(impl Fn(u64) + Sync),
) -> Result<Vec<forgery::Account>, BenchError> {
    // One for each turn at least.
    let scenarios = datagrams.div_ceil(DATAGRAMS_PER_SCENARIO).max(2);
    (0..scenarios)
        .into_par_iter()
        .map(|number| {
            let share = datagrams / scenarios + u64::from(number < datagrams % scenarios);
            let turn = if number % 2 == 0 { Turn::KeyChange } else { Turn::Restart };
            let account = Scenario::new(seed, number, turn, flash.clone())?.run(share)?;
            done(account.kinds.iter().sum());
            Ok(account)
        })
        .collect()
}

/// Each robot lives through a session of each kind, in an order of its own.
fn hold_up(
    seed: u64,
    sessions: u64,
    flash: &Option<Vec<u8>>,
    done: &(impl Fn(u64) + Sync),
) -> Result<Vec<hold_up::Account>, BenchError> {
    let kinds = HOLD_UPS.len() as u64;
    (0..sessions.div_ceil(kinds))
        .into_par_iter()
        .map(|life| {
            let mut order = HOLD_UPS;
            order.rotate_left((life % kinds) as usize);
            let share = (sessions - life * kinds).min(kinds) as usize;
            let account = hold_up::run(seed, life, &order[..share], flash.clone())?;
            done(share as u64);
            Ok(account)
        })
        .collect()
}

/// Returns bytes fed and panics of each piece of work.
fn fuzz_all(seed: u64, bytes: u64, done: &(impl Fn(u64) + Sync)) -> Vec<(u64, u64)> {
    let pieces = bytes.div_ceil(FUZZED_AT_ONCE);
    (0..pieces)
        .into_par_iter()
        .map(|piece| {
            let share = bytes / pieces + u64::from(piece < bytes % pieces);
            let outcome = catch_unwind(AssertUnwindSafe(|| fuzz::fuzz(seed ^ piece << 32, share)));
            done(share);
            outcome.map_or((0, 1), |fuzzed| (fuzzed, 0))
        })
        .collect()
}

/// What was attacked beside whole robots.
type Beside<'a> =
    (&'a [renewal::Account], &'a [siege::Account], recording::Account, poses::Account);

fn verdict(
    seed: u64,
    effort: Effort,
    forged: &[forgery::Account],
    held_up: &[hold_up::Account],
    intruded: &[intrusion::Account],
    (renewed, besieged, recorded, poses): Beside<'_>,
    fuzzed: &[(u64, u64)],
) -> Verdict {
    let sum = |figure: &dyn Fn(&forgery::Account) -> u64| forged.iter().map(figure).sum::<u64>();
    let made_up = FORGERIES.into_iter().enumerate();
    let made_up = made_up.map(|(index, kind)| (kind, sum(&|account| account.kinds[index])));
    let mut kinds: BTreeMap<_, _> = made_up.collect();
    for (kind, count) in held_up.iter().flat_map(|account| &account.kinds) {
        *kinds.entry(*kind).or_default() += count;
    }
    kinds.extend(renewed.iter().map(|account| (account.kind, account.datagrams)));
    kinds.extend(besieged.iter().map(|account| (account.kind, account.sent)));
    kinds.insert(Kind::RecordedSession, recorded.sealed);
    kinds.insert(Kind::ForgedPoses, poses.forged);
    for account in intruded {
        *kinds.entry(account.kind).or_default() += account.frames;
    }
    let dropped = DropReason::ALL.into_iter().map(|reason| {
        let count = sum(&|account| u64::from(account.dropped.get(reason)));
        (reason.to_string().replace(' ', "_"), count)
    });
    let longest = |times: &mut dyn Iterator<Item = f64>| times.fold(0.0, f64::max);
    let answers = forged.iter().map(|account| account.answers_heard);
    let answers = answers.chain(intruded.iter().map(|account| account.answers_heard));
    let handshakes = forged.iter().map(|account| account.handshake_s);
    let movements = held_up.iter().map(|account| account.movement_s);
    let foreign_stops = held_up.iter().map(|account| account.foreign_stop_s);
    let amplification = |kind| {
        let asked = intruded.iter().filter(move |account| account.kind == kind);
        longest(&mut asked.map(|account| account.discovery.amplification()))
    };
    let mut verdict = Verdict {
        seed,
        datagrams: sum(&|account| account.kinds.iter().sum()),
        kinds,
        dropped: dropped.collect(),
        accepted_forgeries: sum(&|account| account.forgeries),
        movements: sum(&|account| account.movements),
        handshake_s: longest(
            &mut handshakes.chain(intruded.iter().map(|account| account.handshake_s)),
        ),
        answers_heard: answers.fold(1.0, f64::min),
        overruns: sum(&|account| account.overruns)
            + intruded.iter().map(|account| account.overruns).sum::<u64>(),
        sessions: effort.sessions,
        driven_sessions: held_up.iter().map(|account| account.driven).sum(),
        intrusions: intruded.len() as u64,
        off_link_amplification: amplification(Kind::ForeignQuestions),
        on_link_amplification: amplification(Kind::NeighbourQuestions),
        discovery_answers_per_s: intruded
            .iter()
            .map(|account| account.discovery.answers_per_s())
            .max()
            .unwrap_or(0),
        longest_movement_after_intent_s: longest(
            &mut movements.chain(intruded.iter().map(|account| account.movement_s)),
        ),
        longest_foreign_stop_s: longest(
            &mut foreign_stops.chain(intruded.iter().map(|account| account.foreign_stop_s)),
        ),
        longest_wait_of_next_operator_s: longest(
            &mut held_up.iter().map(|account| account.next_operator_s),
        ),
        unshown_starts: held_up.iter().map(|account| account.unshown + account.undone).sum(),
        renewal_failures: renewed.iter().map(|account| account.failures).sum(),
        siege_failures: besieged.iter().map(|account| account.failures).sum(),
        forward_secret: recorded.is_forward_secret(),
        farthest_trusted_pose_m: poses.farthest_m,
        fuzzed_bytes: fuzzed.iter().map(|(bytes, _)| bytes).sum(),
        panics: fuzzed.iter().map(|(_, panics)| panics).sum(),
        pass: false,
    };
    verdict.pass = verdict.accepted_forgeries == 0
        && verdict.movements == 0
        && verdict.panics == 0
        && verdict.overruns == 0
        && verdict.handshake_s < HANDSHAKE_LIMIT_S
        && verdict.answers_heard >= ANSWERS_LIMIT
        && verdict.longest_movement_after_intent_s <= MOVEMENT_LIMIT_S
        && verdict.longest_foreign_stop_s <= FOREIGN_STOP_LIMIT_S
        && verdict.longest_wait_of_next_operator_s <= NEXT_OPERATOR_LIMIT_S
        && verdict.off_link_amplification == 0.0
        && verdict.on_link_amplification <= AMPLIFICATION_LIMIT
        && verdict.discovery_answers_per_s <= DISCOVERY_LIMIT_PER_S
        && verdict.unshown_starts == 0
        && verdict.renewal_failures == 0
        && verdict.siege_failures == 0
        && verdict.forward_secret
        && verdict.farthest_trusted_pose_m <= POSE_LIMIT_M
        // Else there was little to disturb.
        && (4 * verdict.driven_sessions >= verdict.sessions || verdict.sessions < A_FEW)
        && forged.iter().all(|account| account.is_complete)
        && intruded.iter().all(|account| account.was_driven);
    verdict
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use super::*;
    use crate::rig::bench::bench;
    use flix_host::link::RobotLink;
    use flix_protocol::message::{Command, ParameterCommand};

    /// Two scenarios under forged datagrams, two lives on a network in the attacker's hands, and all that is attacked beside.
    static ATTACKED: LazyLock<Verdict> = LazyLock::new(|| {
        measure(3, Effort { datagrams: 60_000, sessions: 32, bytes: 300_000 }, |_| ()).unwrap()
    });

    #[test]
    fn nothing_is_accepted_and_nothing_moves_in_two_scenarios_under_attack() {
        let verdict = &*ATTACKED;
        assert!(verdict.pass, "{verdict:?}");
        assert_eq!((verdict.datagrams, verdict.fuzzed_bytes), (60_000, 300_000));
    }

    #[test]
    fn no_network_makes_a_robot_move_longer_than_the_command_age_and_the_ramp_down() {
        let verdict = &*ATTACKED;
        assert!(verdict.pass, "{verdict:?}");
        let mut kinds = HOLD_UPS.iter().chain(&INTRUSIONS);
        assert!(kinds.all(|kind| verdict.kinds[kind] > 0), "{verdict:?}");
        // The intruder did ask, and was answered where he may be.
        assert!(verdict.on_link_amplification > 0.0, "{verdict:?}");
    }

    #[test]
    fn each_siege_is_withstood() {
        assert_eq!(ATTACKED.siege_failures, 0);
        assert!(SIEGES.iter().all(|kind| ATTACKED.kinds[kind] > 0), "{:?}", ATTACKED.kinds);
    }

    /// The age of commands and the ramp down are what bounds the movement: a robot that brakes too weakly moves on for longer.
    #[test]
    fn a_robot_that_brakes_weakly_does_not_pass() {
        let mut operation = bench(Base::Free, 3).unwrap();
        operation.wait_until_connected().unwrap();
        let set = ParameterCommand::Set("current_limit".try_into().unwrap(), 0.25);
        operation.request(Command::Parameter(set)).unwrap();
        operation.request(Command::Parameter(ParameterCommand::Save)).unwrap();
        let flash = operation.robot.parameters().flash.content();
        let effort = Effort { datagrams: 0, sessions: 44, bytes: 0 };
        let verdict = attack(3, effort, &flash, |_| ()).unwrap();
        let movement_s = verdict.longest_movement_after_intent_s;
        assert!(!verdict.pass && movement_s > MOVEMENT_LIMIT_S, "{verdict:?}");
    }

    #[test]
    fn renewals_that_are_held_back_or_played_again_lose_no_command_and_prolong_nothing() {
        for kind in RENEWALS {
            let account = renewal::run(3, kind);
            assert!(account.failures == 0 && account.datagrams > 0, "{account:?}");
        }
    }

    #[test]
    fn every_reason_to_drop_but_two_is_met() {
        let flash = learnt(Base::Free, 4).unwrap();
        let forged = forge(4, 60_000, &flash, &|_| ()).unwrap();
        let is_never = |reason: &DropReason| forged.iter().all(|it| it.dropped.get(*reason) == 0);
        let never = DropReason::ALL.into_iter().filter(is_never);
        let names: Vec<_> = never.map(|reason| reason.to_string()).collect();
        // Nothing late is genuine here, and the robot has a key.
        assert!(
            names.iter().all(|name| ["stale", "unprovisioned"].contains(&&**name)),
            "{names:?}"
        );
    }
}
