//! An attacker on the network who sees everything, holds back and sends anything from any address, and does not have the key:
//! datagrams of 19 kinds that the attacker makes up, 16 harms to genuine datagrams, two to the renewal of keys, five intrusions on the
//! wire beside them, poses in the name of the motion capture, ten sieges of the operator's end, the cable and the cockpit's server,
//! any bytes, and recordings that are opened with a key learnt later.

mod attacker;
mod findings;
mod forgery;
mod fuzz;
mod hold_up;
mod intrusion;
mod kind;
mod poses;
mod recording;
mod renewal;
mod siege;

use std::sync::OnceLock;

use serde_json::json;

pub use findings::MOVEMENT_LIMIT_S;
use findings::{Findings, columns};
use forgery::{Scenario, Turn};
use kind::{HOLD_UPS, Kind, RENEWALS, SIEGES};

use crate::rig::bench::{Base, BenchError, learnt};
use crate::study::{Column, Measurement, Study};

/// Datagrams in a scenario when there are enough for several: 100,000 a second, ten times a flood.
const DATAGRAMS_PER_SCENARIO: u64 = 900_000;
/// Bytes fuzzed in one piece of work.
const FUZZED_AT_ONCE: u64 = 5_000_000;
/// Fewest and most poses that are forged; between them, a tenth as many as datagrams.
const FEWEST_POSES: u64 = 10_000;
const MOST_POSES: u64 = 1_000_000;

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

/// One piece of work of the attacker.
#[derive(Debug, Clone, Copy)]
enum Attack {
    /// So many datagrams of [`FORGERIES`](kind::FORGERIES) in a scenario of this number.
    Forgeries(u64, u64),
    /// So many sessions of [`HOLD_UPS`] in the life of a robot with this number.
    HoldUps(u64, usize),
    /// All [`INTRUSIONS`](kind::INTRUSIONS): they share one virtual time.
    Intrusions,
    Renewal(Kind),
    Siege(Kind),
    Recording,
    /// So many poses.
    Poses(u64),
    /// So many bytes, in the piece with this number.
    Fuzz(u64, u64),
}

impl Attack {
    /// Returns all pieces, and how many rows each gives.
    fn all(effort: Effort) -> impl Iterator<Item = (Self, usize)> {
        let Effort { datagrams, sessions, bytes } = effort;
        let share =
            |whole: u64, parts: u64, part: u64| whole / parts + u64::from(part < whole % parts);
        // One for each turn at least.
        let scenarios = datagrams.div_ceil(DATAGRAMS_PER_SCENARIO).max(2);
        let pieces = bytes.div_ceil(FUZZED_AT_ONCE);
        let kinds = HOLD_UPS.len() as u64;
        let forgeries =
            (0..scenarios).map(move |it| Self::Forgeries(it, share(datagrams, scenarios, it)));
        let lives = (0..sessions.div_ceil(kinds))
            .map(move |it| Self::HoldUps(it, (sessions - it * kinds).min(kinds) as usize));
        let fuzzed = (0..pieces).map(move |it| Self::Fuzz(it, share(bytes, pieces, it)));
        let poses = Self::Poses((datagrams / 10).clamp(FEWEST_POSES, MOST_POSES));
        let single = forgeries
            .chain(lives)
            .chain(RENEWALS.map(Self::Renewal))
            .chain(SIEGES.map(Self::Siege))
            .chain([Self::Recording, poses])
            .chain(fuzzed);
        let intrusions = (sessions > 0).then_some((Self::Intrusions, intrusion::COUNT));
        intrusions.into_iter().chain(single.map(|attack| (attack, 1)))
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Forgeries(..) => "forged datagrams",
            Self::HoldUps(..) => "held-up sessions",
            Self::Intrusions => "frames beside the operator's",
            Self::Renewal(_) => "renewals of keys",
            Self::Siege(_) => "sieges",
            Self::Recording => "recorded sessions",
            Self::Poses(_) => "forged poses",
            Self::Fuzz(..) => "any bytes",
        }
    }

    /// Attacks robots of this seed with this in their flash.
    fn run(self, seed: u64, flash: &Option<Vec<u8>>) -> Result<Vec<Findings>, BenchError> {
        let findings = match self {
            Self::Forgeries(number, datagrams) => {
                let turn = if number % 2 == 0 { Turn::KeyChange } else { Turn::Restart };
                Scenario::new(seed, number, turn, flash.clone())?.run(datagrams)?
            }
            Self::HoldUps(life, sessions) => {
                // Each kind, in an order of its own.
                let mut order = HOLD_UPS;
                order.rotate_left(life as usize % HOLD_UPS.len());
                hold_up::run(seed, life, &order[..sessions], flash.clone())?
            }
            Self::Intrusions => return intrusion::run_all(seed, flash),
            Self::Renewal(kind) => renewal::run(seed, kind),
            Self::Siege(kind) => siege::run(seed, kind, flash)?,
            Self::Recording => recording::run(seed),
            Self::Poses(poses) => poses::run(seed, poses),
            Self::Fuzz(piece, bytes) => {
                let mut findings = Findings::default();
                findings.count(Kind::Noise, fuzz::fuzz(seed ^ piece << 32, bytes));
                findings
            }
        };
        Ok(vec![findings])
    }
}

/// Returns the attacks on robots of this seed, a row each: the attacker's datagrams by kind, what the robot dropped, and what was
/// achieved, with limits. A decoder that panics fails its row.
#[must_use]
pub fn adversary(seed: u64, effort: Effort) -> impl Study {
    let Effort { datagrams, sessions, bytes } = effort;
    let asked = json!({ "seed": seed, "datagrams": datagrams, "sessions": sessions, "fuzzed_bytes": bytes });
    let columns =
        [Column::text("attack"), Column::whole("number")].into_iter().chain(self::columns());
    let flash = OnceLock::new();
    let measurement = Measurement::new(
        "adversary",
        asked.clone(),
        columns.collect(),
        |(attack, number): &(Attack, u64), row| {
            vec![attack.name().into(), (number + row as u64).into()]
        },
        move |(attack, _)| {
            // Learnt once, before the first attack.
            let learnt =
                flash.get_or_init(|| learnt(Base::Free, seed).map_err(|it| it.to_string()));
            let learnt = learnt.as_ref().map_err(String::clone)?;
            let found = attack.run(seed, learnt).map_err(|error| error.to_string())?;
            Ok::<_, String>(found.iter().map(Findings::row).collect())
        },
    );
    let mut number = 0;
    Attack::all(effort)
        .fold(measurement, |measurement, (attack, rows)| {
            let first = number;
            number += rows as u64;
            measurement.runs([(attack, first)], rows)
        })
        .listed("attacks", &["attack"])
        .with_facts(asked)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::rig::bench::bench;
    use crate::study::{Table, Value, compute, keeps};
    use flix_host::link::RobotLink;
    use flix_protocol::message::{Command, DropReason, ParameterCommand};
    use kind::{FORGERIES, INTRUSIONS};

    /// Returns the kinds of which something was sent.
    fn kinds(table: &Table) -> BTreeSet<String> {
        let sent = table.index("sent").unwrap();
        let texts = table.rows.values().filter_map(|row| row[sent].as_text());
        let parts = texts.flat_map(|text| text.split(", ")).filter_map(|part| part.split_once(' '));
        parts.filter(|(_, number)| *number != "0").map(|(kind, _)| kind.to_owned()).collect()
    }

    /// Returns how much was sent in the attacks of this name.
    fn sent_by(table: &Table, attack: &str) -> u64 {
        let [name, sent] = ["attack", "sent"].map(|column| table.index(column).unwrap());
        let rows = table.rows.values().filter(|row| row[name].as_text() == Some(attack));
        let parts = rows.filter_map(|row| row[sent].as_text()).flat_map(|text| text.split(", "));
        parts.map(|part| part.split_once(' ').unwrap().1.parse::<u64>().unwrap()).sum()
    }

    #[test]
    fn each_kind_of_attack_is_made_and_achieves_nothing() {
        let table =
            compute(&adversary(3, Effort { datagrams: 60_000, sessions: 32, bytes: 300_000 }));
        assert!(table.pass(), "{:#?}", table.objects());
        let single = [Kind::RecordedSession, Kind::ForgedPoses];
        let all = FORGERIES.iter().chain(&HOLD_UPS).chain(&RENEWALS).chain(&INTRUSIONS);
        let all: BTreeSet<_> = all
            .chain(&SIEGES)
            .chain(&single)
            .map(Value::word)
            .map(|it| it.as_text().unwrap().to_owned())
            .collect();
        assert_eq!(kinds(&table), all);
        assert_eq!(
            ["forged datagrams", "any bytes"].map(|it| sent_by(&table, it)),
            [60_000, 300_000]
        );
        // The intruder did ask, and was answered where he may be.
        let answered = table.index("on_link_amplification").unwrap();
        let answered = table.rows.values().filter_map(|row| row[answered].number());
        assert!(answered.fold(0.0, f64::max) > 0.0);
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
        let columns: Vec<_> = columns().collect();
        let passes = (0..3).all(|life| {
            let found = Attack::HoldUps(life, HOLD_UPS.len()).run(3, &flash).unwrap();
            keeps(&columns, &found[0].row())
        });
        assert!(!passes);
    }

    #[test]
    fn every_reason_to_drop_but_two_is_met() {
        let flash = learnt(Base::Free, 4).unwrap();
        let run = |number| Attack::Forgeries(number, 30_000).run(4, &flash).unwrap().remove(0);
        let forged = [0, 1].map(run);
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
