//! What an attack achieved, and the limit of each figure.

use std::collections::BTreeMap;

use flix_firmware::mdns::AMPLIFICATION;
use flix_firmware::net::DISCOVERY_INTERVAL;
use flix_protocol::failsafe::{COMMAND_AGE, LINK_LOST, LONGEST_MOVEMENT};
use flix_protocol::message::{DropReason, Dropped};
use flix_protocol::session::HANDSHAKE_RETRY;

use super::kind::Kind;
use crate::study::{Column, Limit, Row, Value};

/// Longest time that a handshake may take under a flood, s.
const HANDSHAKE_LIMIT_S: f64 = 1.0;
/// Least share of commands whose answers the operator has to hear under a flood.
const ANSWERS_LIMIT: f64 = 0.99;
/// Least share of sessions in which there has to be something to disturb: a rotor that turns.
const DRIVEN_LIMIT: f64 = 0.25;
/// Most answers to mDNS in a second.
const DISCOVERY_LIMIT_PER_S: f64 = 1_000.0 / DISCOVERY_INTERVAL.as_millis() as f64;

/// Longest movement after the operator's last intent to move, s: the command age and the ramp down from 35 Hz.
pub const MOVEMENT_LIMIT_S: f64 = LONGEST_MOVEMENT.as_millis() as f64 / 1e3;
/// Longest time from somebody else's stop to the latched stop of a robot that an operator holds, s.
pub(super) const FOREIGN_STOP_LIMIT_S: f64 = 0.3;
/// Longest time from an operator's last intent to the next one's session, s: the command age, the silence after which
/// a session is free, and two attempts.
pub(super) const NEXT_OPERATOR_LIMIT_S: f64 =
    (COMMAND_AGE.as_millis() + LINK_LOST.as_millis() + 2 * HANDSHAKE_RETRY.as_millis()) as f64
        / 1e3;
/// Largest distance of a trusted pose from the robot, m: three times what is always within reach.
pub(super) const POSE_LIMIT_M: f64 = 0.1;

/// What an attack achieved. A figure that an attack does not look at is `None`.
#[derive(Debug, Clone, Default)]
pub(super) struct Findings {
    /// Datagrams, frames, poses, sockets or bytes of the attacker.
    pub(super) sent: BTreeMap<Kind, u64>,
    /// What the robot dropped, whoever sent it.
    pub(super) dropped: Dropped,
    /// Ticks in which a robot obeyed something that its twin did not; a scenario ends with its first.
    pub(super) forgeries: u64,
    /// Ticks in which a robot moved otherwise than its twin.
    pub(super) movements: u64,
    /// Ticks of the fast loop that came too late.
    pub(super) overruns: u64,
    /// Starts of movement, and clears, by operators whom the robot had not stated its present permit; orders in force that idle
    /// ones undid which were sent before them.
    pub(super) unshown: u64,
    /// Commands that did not count although they should, datagrams that counted although they should not, stops that counted twice,
    /// keys that were overheard, pages that were turned out, rotors that turned unasked, forgeries that an operator believed,
    /// operators that were kept out, and recordings that a key learnt later opens.
    pub(super) failures: u64,
    /// Time from the operator's first Hello to the session, s.
    pub(super) handshake_s: Option<f64>,
    /// Share of the operator's commands whose answers he heard.
    pub(super) answers_heard: Option<f64>,
    /// Share of the sessions in which a rotor turned when the operator's intent to move ended.
    pub(super) driven: Option<f64>,
    /// Longest time that a rotor turned after the operator's last intent to move, s.
    pub(super) movement_s: Option<f64>,
    /// Longest time from the stop of a second key holder, of whose datagrams a fifth is lost, to the latched stop, s.
    pub(super) foreign_stop_s: Option<f64>,
    /// Longest time from an operator's last intent to move to the next operator's session, s.
    pub(super) next_operator_s: Option<f64>,
    /// Bytes of mDNS that each byte of a question from another network brought out.
    pub(super) off_link_amplification: Option<f64>,
    /// The same of questions from the robot's own network.
    pub(super) on_link_amplification: Option<f64>,
    /// Most answers to mDNS in a second.
    pub(super) answers_per_s: Option<f64>,
    /// Farthest trusted pose from the robot, m.
    pub(super) pose_m: Option<f64>,
}

/// A figure: name, limit, and its value among findings.
type Judged = (&'static str, Limit, fn(&Findings) -> Option<f64>);

/// All figures.
const FIGURES: [Judged; 15] = [
    ("accepted_forgeries", Limit::Exactly(0.0), |it| Some(it.forgeries as f64)),
    ("movements", Limit::Exactly(0.0), |it| Some(it.movements as f64)),
    ("overruns", Limit::Exactly(0.0), |it| Some(it.overruns as f64)),
    ("unshown_starts", Limit::Exactly(0.0), |it| Some(it.unshown as f64)),
    ("failures", Limit::Exactly(0.0), |it| Some(it.failures as f64)),
    ("handshake_s", Limit::AtMost(HANDSHAKE_LIMIT_S), |it| it.handshake_s),
    ("answers_heard", Limit::AtLeast(ANSWERS_LIMIT), |it| it.answers_heard),
    ("driven_share", Limit::AtLeast(DRIVEN_LIMIT), |it| it.driven),
    ("movement_after_intent_s", Limit::AtMost(MOVEMENT_LIMIT_S), |it| it.movement_s),
    ("foreign_stop_s", Limit::AtMost(FOREIGN_STOP_LIMIT_S), |it| it.foreign_stop_s),
    ("next_operator_s", Limit::AtMost(NEXT_OPERATOR_LIMIT_S), |it| it.next_operator_s),
    ("off_link_amplification", Limit::Exactly(0.0), |it| it.off_link_amplification),
    ("on_link_amplification", Limit::AtMost(AMPLIFICATION as f64), |it| it.on_link_amplification),
    ("discovery_answers_per_s", Limit::AtMost(DISCOVERY_LIMIT_PER_S), |it| it.answers_per_s),
    ("farthest_trusted_pose_m", Limit::AtMost(POSE_LIMIT_M), |it| it.pose_m),
];

/// Returns the columns of [`Findings::row`].
pub(super) fn columns() -> impl Iterator<Item = Column> {
    let figures = FIGURES
        .into_iter()
        .map(|(name, limit, _)| Column::number(name).limited(limit).or_missing());
    [Column::text("sent"), Column::text("dropped")].into_iter().chain(figures)
}

impl Findings {
    /// Counts what the attacker sent.
    pub(super) fn count(&mut self, kind: Kind, number: u64) {
        *self.sent.entry(kind).or_default() += number;
    }

    /// Returns the row of these findings.
    pub(super) fn row(&self) -> Row {
        let sent = self.sent.iter().map(|(kind, number)| {
            format!("{} {number}", Value::word(kind).as_text().unwrap_or_default())
        });
        let dropped = DropReason::ALL.into_iter().filter(|reason| self.dropped.get(*reason) > 0);
        let dropped = dropped.map(|reason| format!("{reason} {}", self.dropped.get(reason)));
        let texts = [sent.collect::<Vec<_>>(), dropped.collect()].map(|all| all.join(", ").into());
        texts.into_iter().chain(FIGURES.map(|(_, _, value)| value(self).into())).collect()
    }
}

/// Raises a figure to this value, if that is larger.
pub(super) fn raise(figure: &mut Option<f64>, value: f64) {
    *figure = Some(figure.map_or(value, |it| it.max(value)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::keeps;

    #[test]
    fn each_figure_beyond_its_limit_fails_its_row() {
        let columns: Vec<_> = columns().collect();
        assert!(keeps(&columns, &Findings::default().row()));
        let worse: [fn(&mut Findings); 15] = [
            |it| it.forgeries = 1,
            |it| it.movements = 1,
            |it| it.overruns = 1,
            |it| it.unshown = 1,
            |it| it.failures = 1,
            |it| it.handshake_s = Some(f64::INFINITY),
            |it| it.answers_heard = Some(0.98),
            |it| it.driven = Some(0.2),
            |it| raise(&mut it.movement_s, 0.9),
            |it| raise(&mut it.foreign_stop_s, 0.4),
            |it| raise(&mut it.next_operator_s, 60.0),
            |it| it.off_link_amplification = Some(0.1),
            |it| it.on_link_amplification = Some(12.0),
            |it| it.answers_per_s = Some(1_000.0),
            |it| it.pose_m = Some(0.2),
        ];
        for (figure, worse) in worse.iter().enumerate() {
            let mut findings = Findings::default();
            worse(&mut findings);
            assert!(!keeps(&columns, &findings.row()), "{}", FIGURES[figure].0);
        }
    }
}
