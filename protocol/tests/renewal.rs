//! The keys of a session are renewed without a gap, and end when they are not; in virtual time.

use core::time::Duration;
use std::collections::BTreeSet;

use crate::ends::{Ends, OPERATOR, STOP, ping, telemetry, walk};
use flix_protocol::failsafe::COMMAND_DEADLINE;
use flix_protocol::message::DropReason;
use flix_protocol::session::{
    HANDSHAKE_RETRY, OLD_KEYS_LIFE, OperatorReceived, RobotReceived, SESSION_LIFE, SESSION_RENEWAL,
    SendError, Status,
};
use flix_protocol::units::Instant;

/// Interval of commands and of telemetry.
const INTERVAL: Duration = Duration::from_millis(20);
const MILLISECOND: Duration = Duration::from_millis(1);

impl Ends {
    /// Both ends speak every [`INTERVAL`] until this time, without loss; whether the operator asks for
    /// new keys when it is due.
    fn talk_until(&mut self, end: Instant, renews: bool) {
        while self.now < end {
            self.wait(INTERVAL.min(end.since(self.now)));
            while renews && let Some(frame) = self.operator.poll(self.now) {
                let RobotReceived::Answer(answer) = self.robot_hears(&frame) else {
                    panic!("new keys")
                };
                self.operator_hears(&answer);
            }
            if let Ok(frame) = self.operator.send(self.now, &walk(30.0, 0.0)) {
                self.robot_hears(&frame);
            }
            if let Ok((_, frame)) = self.robot.send(self.now, &telemetry(1)) {
                self.operator_hears(&frame);
            }
        }
    }

    /// The operator's request for new keys, once it is due.
    fn renewal(&mut self) -> Vec<u8> {
        self.talk_until(self.now + SESSION_RENEWAL, false);
        self.operator.poll(self.now).unwrap().to_vec()
    }

    fn answer(&mut self, renewal: &[u8]) -> Vec<u8> {
        let RobotReceived::Answer(answer) = self.robot_hears(renewal) else { panic!("new keys") };
        assert!(answer.len() <= renewal.len());
        answer.to_vec()
    }

    /// The operator commands, and the robot obeys.
    fn drives(&mut self) -> bool {
        let driving = ping(1);
        let frame = self.operator.send(self.now, &driving).unwrap();
        self.robot_hears(&frame) == RobotReceived::Message(driving)
    }
}

/// The number of the session under which a datagram is sealed.
fn session(frame: &[u8]) -> u32 {
    u32::from_le_bytes(frame[4..8].try_into().unwrap())
}

/// Drives over several renewals on a network that loses and delays; returns the longest time between
/// two commands that counted, and how many keys sealed them.
fn drive(seed: u64, loss_percent: u64, longest_delay: u64) -> (Duration, usize) {
    let mut state = seed;
    let mut below = move |limit: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (state >> 33) % limit
    };
    let mut ends = Ends::connected();
    let end = ends.now + 2 * SESSION_LIFE;
    let (mut last, mut longest) = (ends.now, Duration::ZERO);
    let mut sessions = BTreeSet::new();
    // Arrival, and what arrives; to the robot and to the operator.
    let mut under_way: [Vec<(Instant, Vec<u8>)>; 2] = Default::default();
    for turn in 0_u64.. {
        if ends.now >= end {
            break;
        }
        let now = ends.now;
        let mut sent: [Vec<Vec<u8>>; 2] = Default::default();
        if turn.is_multiple_of(20) {
            while let Some(frame) = ends.operator.poll(now) {
                sent[0].push(frame.to_vec());
            }
            let frame = ends.operator.send(now, &walk(30.0, 0.0)).unwrap();
            sessions.insert(session(&frame));
            sent[0].push(frame.to_vec());
            sent[1].push(ends.robot.send(now, &telemetry(1)).unwrap().1.to_vec());
        }
        for datagram in take_arrived(&mut under_way[0], now) {
            match ends.robot.receive(now, OPERATOR, &datagram) {
                RobotReceived::Message(_) => {
                    longest = longest.max(now.since(last));
                    last = now;
                }
                RobotReceived::Answer(answer) => sent[1].push(answer.to_vec()),
                // A delayed one was overtaken.
                RobotReceived::Dropped(DropReason::Stale, None) => {}
                other => panic!("{other:?}"),
            }
        }
        for datagram in take_arrived(&mut under_way[1], now) {
            let received = ends.operator.receive(now, &datagram);
            let is_overtaken = received == OperatorReceived::Dropped(DropReason::Stale);
            let is_good =
                matches!(received, OperatorReceived::Message(_) | OperatorReceived::Progress);
            assert!(is_good || is_overtaken, "{received:?}");
        }
        for (under_way, sent) in under_way.iter_mut().zip(sent) {
            for datagram in sent {
                if below(100) >= loss_percent {
                    let delay = Duration::from_millis(5 + below(longest_delay));
                    under_way.push((now + delay, datagram));
                }
            }
        }
        ends.wait(MILLISECOND);
    }
    (longest, sessions.len())
}

fn take_arrived(under_way: &mut Vec<(Instant, Vec<u8>)>, now: Instant) -> Vec<Vec<u8>> {
    let (arrived, rest) = std::mem::take(under_way).into_iter().partition(|(at, _)| *at <= now);
    *under_way = rest;
    let arrived: Vec<_> = arrived;
    arrived.into_iter().map(|(_, datagram)| datagram).collect()
}

#[test]
fn driving_over_renewals_with_loss_and_delay_misses_no_command_deadline() {
    for (seed, loss_percent, longest_delay) in [(1, 0, 1), (2, 20, 20), (3, 20, 80), (4, 30, 50)] {
        let (longest, keys) = drive(seed, loss_percent, longest_delay);
        assert!(longest < COMMAND_DEADLINE, "{loss_percent} %: {longest:?} without a command");
        // One for each 300 s, and the first.
        assert_eq!(keys, 4, "{loss_percent} %");
    }
}

#[test]
fn what_is_under_way_when_keys_change_is_opened_and_nothing_later() {
    let mut ends = Ends::connected();
    let renewal = ends.renewal();
    let [in_time, too_late] = [(); 2].map(|()| ends.operator.send(ends.now, &STOP).unwrap());
    let answer = ends.answer(&renewal);
    ends.operator_hears(&answer);
    assert!(ends.drives());
    ends.wait(OLD_KEYS_LIFE - MILLISECOND);
    // Opened, and older than the message by the new keys.
    assert_eq!(ends.robot_hears(&in_time), RobotReceived::Dropped(DropReason::Stale, None));
    ends.wait(MILLISECOND);
    assert_eq!(ends.robot_hears(&too_late), RobotReceived::Dropped(DropReason::Session, None));
    let received = ends.robot_hears(&renewal);
    assert_eq!(received, RobotReceived::Dropped(DropReason::Session, None));
}

#[test]
fn the_operator_hears_what_was_under_way_and_nothing_of_former_keys_later() {
    let mut ends = Ends::connected();
    let renewal = ends.renewal();
    let answer = ends.answer(&renewal);
    let [in_time, too_late] = [(); 2].map(|()| ends.robot.send(ends.now, &telemetry(1)).unwrap().1);
    ends.operator_hears(&answer);
    ends.wait(OLD_KEYS_LIFE - MILLISECOND);
    assert_eq!(ends.operator_hears(&in_time), OperatorReceived::Message(telemetry(1)));
    ends.wait(MILLISECOND);
    assert_eq!(ends.operator_hears(&too_late), OperatorReceived::Dropped(DropReason::Session));
}

#[test]
fn a_session_that_is_not_renewed_ends_with_its_keys() {
    let mut ends = Ends::new(Some(crate::ends::key(1)), crate::ends::key(1));
    let begun = ends.now;
    assert_eq!(ends.run(), Status::Connected);
    ends.talk_until(begun + (SESSION_LIFE - MILLISECOND), false);
    assert!(ends.drives());
    let sealed = ends.operator.send(ends.now, &STOP).unwrap();
    ends.wait(MILLISECOND);
    assert_eq!(ends.robot_hears(&sealed), RobotReceived::Dropped(DropReason::Session, None));
    assert_eq!(ends.robot.peer(ends.now), None);
    let refused = ends.operator.send(ends.now, &STOP).unwrap_err();
    assert_eq!((refused, ends.operator.status(ends.now)), (SendError::NoSession, Status::Left));
}

#[test]
fn a_lost_answer_is_given_again_and_the_session_goes_on() {
    let mut ends = Ends::connected();
    let renewal = ends.renewal();
    ends.answer(&renewal);
    assert!(ends.drives(), "with the former keys");
    ends.wait(HANDSHAKE_RETRY);
    let again = ends.operator.poll(ends.now).unwrap();
    assert_ne!(again[..], renewal[..], "another counter");
    let answer = ends.answer(&again);
    ends.operator_hears(&answer);
    assert!(ends.drives(), "with the new keys");
    ends.talk_until(ends.now + SESSION_LIFE, true);
    assert!(ends.drives());
}

#[test]
fn a_repeated_request_changes_nothing_so_that_the_first_answer_counts() {
    let mut ends = Ends::connected();
    let renewal = ends.renewal();
    let answer = ends.answer(&renewal);
    ends.wait(HANDSHAKE_RETRY);
    let again = ends.operator.poll(ends.now).unwrap();
    ends.answer(&again);
    ends.operator_hears(&answer);
    assert!(ends.drives());
}

#[test]
fn a_renewal_that_is_changed_or_repeated_is_dropped_at_either_end() {
    let mut ends = Ends::connected();
    let renewal = ends.renewal();
    for bit in 0..renewal.len() * 8 {
        let mut changed = renewal.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let received = ends.robot_hears(&changed);
        assert!(matches!(received, RobotReceived::Dropped(_, None)), "bit {bit}: {received:?}");
    }
    let answer = ends.answer(&renewal);
    assert_eq!(ends.robot_hears(&renewal), RobotReceived::Dropped(DropReason::Replayed, None));
    for bit in 0..answer.len() * 8 {
        let mut changed = answer.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let received = ends.operator_hears(&changed);
        assert!(matches!(received, OperatorReceived::Dropped(_)), "bit {bit}: {received:?}");
    }
    ends.operator_hears(&answer);
    assert_eq!(ends.operator_hears(&answer), OperatorReceived::Dropped(DropReason::Replayed));
    assert!(ends.drives());
}
