//! What a session promises, between two ends in virtual time.

use core::net::SocketAddr;
use core::time::Duration;
use std::collections::BTreeSet;

use crate::ends::{
    Ends, OPERATOR, SECOND_OPERATOR, STOP, answer, connect, key, ping, telemetry, walk,
};
use flix_protocol::failsafe::COMMAND_AGE;
use flix_protocol::frame::{
    Confirm, Datagram, Frame, MAGIC, MAXIMUM_DATAGRAM, SEALED, SEALED_HEADER,
};
use flix_protocol::message::{DropReason, Outcome, Reply, ToOperator};
use flix_protocol::session::{
    CONFIRM_PATIENCE, CONNECT_PATIENCE, COOKIE_LIFE, ConnectError, HANDSHAKE_RETRY, HINT_PATIENCE,
    HOLDER_SILENCE, Key, KeyError, LONGEST_COMMAND_AGE, OperatorReceived, OperatorSession,
    PROTOCOL_VERSION, RobotReceived, RobotSession, SESSION_EXPIRY, SendError, Status, VERSION,
};
use flix_protocol::units::Instant;

const TICK: Duration = Duration::from_micros(1);

fn second_operator(now: Instant) -> OperatorSession {
    OperatorSession::new(key(1), [33; 32], now)
}

// Connecting

#[test]
fn the_right_key_connects_and_both_ends_are_heard() {
    let mut ends = Ends::connected();
    let frame = ends.operator.send(ends.now, &ping(7)).unwrap();
    assert_eq!(ends.robot_hears(&frame), RobotReceived::Message(ping(7)));
    let (peer, frame) = ends.robot.send(ends.now, &telemetry(5)).unwrap();
    assert_eq!(peer, OPERATOR);
    assert_eq!(ends.operator_hears(&frame), OperatorReceived::Message(telemetry(5)));
    assert_eq!(ends.robot.quality(ends.now).dropped.total(), 0);
}

#[test]
fn a_wrong_key_is_refused_with_that_sentence() {
    let mut ends = Ends::new(Some(key(1)), key(2));
    assert_eq!(ends.run(), Status::Failed(ConnectError::WrongKey));
    assert!(ends.now < Instant::START + 2 * HINT_PATIENCE, "without long waiting");
    assert!(ConnectError::WrongKey.to_string().contains("another key"));
}

#[test]
fn a_robot_without_a_key_refuses_everybody() {
    let mut ends = Ends::new(None, key(1));
    assert_eq!(ends.run(), Status::Failed(ConnectError::Unprovisioned));
    assert!(ends.robot.quality(ends.now).dropped.unprovisioned > 0);
}

#[test]
fn silence_is_reported_as_no_answer_after_the_patience() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let began = ends.now;
    let mut hellos = 0;
    while let Some(at) = ends.operator.poll_at() {
        ends.now = at;
        while ends.operator.poll(at).is_some() {
            hellos += 1;
        }
    }
    assert_eq!(ends.operator.status(ends.now), Status::Failed(ConnectError::NoAnswer));
    assert_eq!(ends.now.since(began), CONNECT_PATIENCE);
    assert_eq!(hellos, 30, "one each 100 ms");
    assert_eq!(ends.operator.poll(ends.now), None);
    ends.operator.connect(ends.now);
    assert_eq!(ends.run(), Status::Connected, "and it can be tried again");
}

#[test]
fn another_version_is_named_and_told_which_end_to_update() {
    // A hello of another version: the version's bytes follow magic and kind.
    let mut ends = Ends::new(Some(key(1)), key(1));
    let mut hello = ends.operator.poll(ends.now).unwrap();
    hello[4] = hello[4].wrapping_add(1);
    let RobotReceived::Dropped(DropReason::Version, Some(mut refusal)) = ends.robot_hears(&hello)
    else {
        panic!("refused for its version");
    };
    // The refusal of a robot of a later version: reason and version follow magic and kind.
    refusal[5..7].copy_from_slice(&(VERSION.number + 4).to_le_bytes());
    ends.operator_hears(&refusal);
    while let Some(at) = ends.operator.poll_at() {
        ends.now = at;
        let _ = ends.operator.poll(at);
    }
    let Status::Failed(error) = ends.operator.status(ends.now) else { panic!("refused") };
    assert_eq!(error, ConnectError::OtherVersion(VERSION.number + 4));
    assert!(error.to_string().ends_with("update this program"), "{error}");
}

#[test]
fn the_end_that_is_behind_is_the_one_to_update() {
    for (robot, advice) in [
        (PROTOCOL_VERSION - 1, "update the robot's firmware"),
        (PROTOCOL_VERSION, "update the robot's firmware and this program to one release"),
        (PROTOCOL_VERSION + 1, "update this program"),
    ] {
        let message = ConnectError::OtherVersion(robot).to_string();
        assert!(message.ends_with(&format!(": {advice}")), "{message}");
    }
}

#[test]
fn a_lasting_refusal_is_doubted_from_its_own_arrival_on_whatever_came_before() {
    let mut ends = Ends::connected();
    let mut second = second_operator(ends.now);
    let hello = second.poll(ends.now).unwrap();
    let held = answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    second.receive(ends.now, &held);
    ends.wait(2 * HINT_PATIENCE);
    let mut stranger = RobotSession::new(Some(key(9)), [9; 32]);
    let refusal = answer(stranger.receive(ends.now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    second.receive(ends.now, &refusal);
    let mut status_after = |wait| {
        let _ = second.poll(ends.now + wait);
        second.status(ends.now + wait)
    };
    assert_eq!(status_after(HINT_PATIENCE - TICK), Status::Connecting);
    assert_eq!(status_after(HINT_PATIENCE), Status::Failed(ConnectError::WrongKey));
}

#[test]
fn a_confirm_that_stays_unanswered_starts_over_with_a_new_nonce() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.wait(CONFIRM_PATIENCE - HANDSHAKE_RETRY);
    assert_eq!(ends.operator.poll(ends.now), Some(confirm));
    ends.wait(HANDSHAKE_RETRY);
    let anew = ends.operator.poll(ends.now).unwrap();
    assert!(anew != hello && anew.len() == hello.len(), "{anew:?}");
    assert_eq!(ends.run(), Status::Connected);
}

#[test]
fn a_datagram_is_as_long_as_the_longest_at_most() {
    let mut sealed = [&MAGIC[..], &[SEALED]].concat();
    sealed.resize(MAXIMUM_DATAGRAM, 0);
    assert!(matches!(Datagram::parse(&sealed), Some(Datagram::Sealed(_))));
    sealed.push(0);
    assert_eq!(Datagram::parse(&sealed), None);
}

#[test]
fn a_forged_refusal_does_not_keep_an_operator_from_its_robot() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let mut stranger = RobotSession::new(Some(key(9)), [9; 32]);
    let forged = answer(stranger.receive(ends.now, OPERATOR, &hello), hello.len()).unwrap();
    ends.operator_hears(&forged);
    assert_eq!(ends.run(), Status::Connected);
}

#[test]
fn a_refusal_for_somebody_else_is_ignored() {
    let mut ends = Ends::new(Some(key(2)), key(1));
    let hello = second_operator(ends.now).poll(ends.now).unwrap();
    let refusal = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    assert_eq!(ends.operator_hears(&refusal), OperatorReceived::Dropped(DropReason::Session));
}

#[test]
fn a_lost_accept_is_said_again_and_nothing_starts_over() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    let RobotReceived::Connected(lost) = ends.robot_hears(&confirm) else { panic!("connected") };
    ends.wait(Duration::from_millis(100));
    let again = ends.operator.poll(ends.now).unwrap();
    assert_eq!(ends.robot_hears(&again), RobotReceived::Answer(lost.clone()));
    assert_eq!(ends.operator_hears(&lost), OperatorReceived::Connected);
}

/// Accept brings the robot's ephemeral key, without which nothing opens.
#[test]
fn messages_before_a_lost_accept_are_dropped_and_those_after_its_repetition_are_heard() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.robot_hears(&confirm);
    let [before, after] = [1, 2].map(|time| ends.robot.send(ends.now, &telemetry(time)).unwrap().1);
    assert_eq!(ends.operator_hears(&before), OperatorReceived::Dropped(DropReason::Session));
    assert_eq!(ends.operator.status(ends.now), Status::Connecting);
    ends.wait(HANDSHAKE_RETRY);
    assert_eq!(ends.run(), Status::Connected);
    assert_eq!(ends.operator_hears(&after), OperatorReceived::Message(telemetry(2)));
}

#[test]
fn each_session_has_ephemeral_keys_of_its_own_at_either_end() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let mut publics = BTreeSet::new();
    for _ in 0..3 {
        ends.operator.connect(ends.now);
        while let Some(frame) = ends.operator.poll(ends.now) {
            let answer = answer(ends.robot_hears(&frame), frame.len()).unwrap();
            for datagram in [&frame[..], &answer] {
                if let Some(
                    Datagram::Confirm(Confirm { client_public: public, .. })
                    | Datagram::Accept { robot_public: public, .. },
                ) = Datagram::parse(datagram)
                {
                    publics.insert(public);
                }
            }
            ends.operator_hears(&answer);
        }
    }
    assert_eq!(publics.len(), 6, "{publics:?}");
}

#[test]
fn every_session_has_new_keys() {
    let mut ends = Ends::connected();
    let first = ends.operator.send(ends.now, &ping(1)).unwrap();
    ends.operator.connect(ends.now);
    ends.run();
    let second = ends.operator.send(ends.now, &ping(1)).unwrap();
    assert_ne!(first[4..8], second[4..8], "another session id");
    assert_ne!(first[SEALED_HEADER..], second[SEALED_HEADER..], "another ciphertext");
}

// One operator at a time

#[test]
fn a_second_operator_waits_until_the_first_is_silent_for_one_second() {
    let mut ends = Ends::connected();
    let silent_since = ends.moment();
    ends.ping();
    let mut second = second_operator(ends.now);
    let hello = second.poll(ends.now).unwrap();
    let before = silent_since + (HOLDER_SILENCE - TICK);
    let received = ends.robot.receive(before, SECOND_OPERATOR, &hello);
    assert!(matches!(received, RobotReceived::Dropped(DropReason::Busy, Some(_))), "{received:?}");
    let after = silent_since + HOLDER_SILENCE;
    let received = ends.robot.receive(after, SECOND_OPERATOR, &hello);
    assert!(matches!(received, RobotReceived::Answer(_)), "{received:?}");
}

#[test]
fn a_second_program_with_the_same_key_is_told_that_its_operator_holds_the_robot() {
    let mut ends = Ends::connected();
    let mut second = second_operator(ends.now);
    while let Some(at) = second.poll_at() {
        ends.now = at;
        let (_, frame) = ends.robot.send(at, &telemetry(1)).unwrap();
        ends.operator_hears(&frame);
        ends.ping();
        while let Some(frame) = second.poll(at) {
            let received = ends.robot.receive(at, SECOND_OPERATOR, &frame);
            second.receive(at, &answer(received, frame.len()).unwrap());
        }
    }
    let busy = ConnectError::Busy(None);
    assert_eq!(second.status(ends.now), Status::Failed(busy));
    assert!(busy.to_string().contains("you hold the robot already"), "{busy}");
    assert_eq!(ends.robot.peer(ends.now), Some(OPERATOR), "the first keeps the robot");
}

#[test]
fn a_challenge_won_while_the_robot_was_free_does_not_take_it_from_its_holder() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let mut second = second_operator(ends.now);
    let hello = second.poll(ends.now).unwrap();
    let challenge =
        answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    second.receive(ends.now, &challenge);
    let confirm = second.poll(ends.now).unwrap();
    ends.run();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &confirm);
    assert!(matches!(received, RobotReceived::Dropped(..)), "{received:?}");
    assert_eq!(ends.robot.peer(ends.now), Some(OPERATOR));
}

#[test]
fn an_operator_that_died_is_replaced_in_one_attempt() {
    let mut ends = Ends::connected();
    let mut second = second_operator(ends.now);
    let (now, status) = connect(ends.now, &mut second, &mut ends.robot, SECOND_OPERATOR);
    assert_eq!(status, Status::Connected);
    assert_eq!(ends.robot.peer(now), Some(SECOND_OPERATOR));
}

#[test]
fn the_holder_itself_may_connect_again_at_once() {
    let mut ends = Ends::connected();
    let began = ends.now;
    ends.operator.connect(ends.now);
    assert_eq!(ends.run(), Status::Connected);
    assert_eq!(ends.now, began);
}

#[test]
fn goodbye_frees_the_robot_at_once() {
    let mut ends = Ends::connected();
    let began = ends.now;
    let goodbye = ends.operator.goodbye().unwrap();
    assert_eq!(ends.robot_hears(&goodbye), RobotReceived::Left);
    assert_eq!(ends.robot.send(ends.now, &telemetry(1)), Err(SendError::NoSession));
    let mut second = second_operator(ends.now);
    let (now, status) = connect(ends.now, &mut second, &mut ends.robot, SECOND_OPERATOR);
    assert_eq!((now, status), (began, Status::Connected));
}

#[test]
fn a_replayed_goodbye_does_not_end_the_next_session() {
    let mut ends = Ends::connected();
    let goodbye = ends.operator.goodbye().unwrap();
    ends.robot_hears(&goodbye);
    ends.operator.connect(ends.now);
    ends.run();
    assert_eq!(ends.robot_hears(&goodbye), RobotReceived::Dropped(DropReason::Session, None));
}

#[test]
fn a_robot_that_leaves_says_so() {
    let mut ends = Ends::connected();
    let (_, goodbye) = ends.robot.goodbye(ends.now).unwrap();
    assert_eq!(ends.operator_hears(&goodbye), OperatorReceived::Left);
    assert_eq!(ends.operator.status(ends.now), Status::Left);
}

#[test]
fn a_silent_session_is_forgotten() {
    let mut ends = Ends::connected();
    ends.moment();
    ends.ping();
    ends.wait(SESSION_EXPIRY - TICK);
    assert!(ends.robot.send(ends.now, &telemetry(1)).is_ok());
    ends.wait(TICK);
    assert_eq!(ends.robot.send(ends.now, &telemetry(1)), Err(SendError::NoSession));
    let late = ends.operator.send(ends.now, &ping(1)).unwrap();
    assert_eq!(ends.robot_hears(&late), RobotReceived::Dropped(DropReason::Session, None));
}

#[test]
fn the_operator_sees_when_the_robot_falls_silent() {
    let mut ends = Ends::connected();
    ends.wait(HOLDER_SILENCE - TICK);
    assert_eq!(ends.operator.status(ends.now), Status::Connected);
    ends.wait(TICK);
    assert_eq!(ends.operator.status(ends.now), Status::Silent(HOLDER_SILENCE));
}

#[test]
fn another_key_ends_the_session_of_a_live_robot() {
    let mut ends = Ends::connected();
    let frame = ends.operator.send(ends.now, &ping(1)).unwrap();
    assert!(!ends.robot.set_operators(Some(key(2))));
    assert_eq!(ends.robot_hears(&frame), RobotReceived::Dropped(DropReason::Session, None));
    ends.operator.connect(ends.now);
    assert_eq!(ends.run(), Status::Failed(ConnectError::WrongKey));
    let mut owner = OperatorSession::new(key(2), [44; 32], ends.now);
    let (_, status) = connect(ends.now, &mut owner, &mut ends.robot, OPERATOR);
    assert_eq!(status, Status::Connected);
}

// Newest wins

#[test]
fn a_command_older_than_one_obeyed_is_stale() {
    let mut ends = Ends::connected();
    let older = ends.operator.send(ends.now, &walk(30.0, 0.0)).unwrap();
    let newer = ends.operator.send(ends.now, &walk(10.0, 0.0)).unwrap();
    assert_eq!(ends.robot_hears(&newer), RobotReceived::Message(walk(10.0, 0.0)));
    assert_eq!(ends.robot_hears(&older), RobotReceived::Dropped(DropReason::Stale, None));
    assert_eq!(ends.robot.quality(ends.now).dropped.stale, 1);
}

#[test]
fn telemetry_older_than_what_was_shown_is_stale_but_replies_are_not() {
    let mut ends = Ends::connected();
    let reply = ToOperator::Reply(Reply { request: 1, outcome: Outcome::Done });
    let (_, late_reply) = ends.robot.send(ends.now, &reply).unwrap();
    let (_, older) = ends.robot.send(ends.now, &telemetry(1)).unwrap();
    let (_, newer) = ends.robot.send(ends.now, &telemetry(2)).unwrap();
    ends.operator_hears(&newer);
    assert_eq!(ends.operator_hears(&older), OperatorReceived::Dropped(DropReason::Stale));
    assert_eq!(ends.operator_hears(&late_reply), OperatorReceived::Message(reply));
}

// What cannot be

#[test]
fn a_request_that_cannot_be_read_is_named_and_an_order_dropped() {
    let mut ends = Ends::connected();
    let shake = |f: f32, theta: f32| {
        [[0, 2, 3].as_slice(), &f.to_le_bytes(), &theta.to_le_bytes()].concat()
    };
    let malformed = RobotReceived::Dropped(DropReason::Malformed, None);
    for (plain, expected) in [
        (vec![1, 7, 99], RobotReceived::Unreadable(7)),
        (vec![0, 99], malformed.clone()),
        (shake(f32::NAN, 0.0), malformed.clone()),
        (shake(0.0, f32::INFINITY), malformed.clone()),
        (shake(0.0, 400.0), malformed),
        (shake(30.0, 0.0), RobotReceived::Message(walk(30.0, 0.0))),
    ] {
        let frame = ends.operator.send_bytes(&plain).unwrap();
        assert_eq!(ends.robot_hears(&frame), expected, "{plain:?}");
    }
}

// Replays

#[test]
fn an_old_confirm_never_opens_a_session_again() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    assert!(matches!(ends.robot_hears(&confirm), RobotReceived::Connected(_)));
    ends.robot.end();
    assert_eq!(ends.robot_hears(&confirm), RobotReceived::Dropped(DropReason::Replayed, None));
}

#[test]
fn a_kept_confirm_goes_stale_with_its_epoch() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.wait(COOKIE_LIFE);
    assert_eq!(ends.robot_hears(&confirm), RobotReceived::Dropped(DropReason::Replayed, None));
}

#[test]
fn a_confirm_from_another_address_is_worth_nothing() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    for thief in [SECOND_OPERATOR, SocketAddr::new(OPERATOR.ip(), OPERATOR.port() + 1)] {
        let received = ends.robot.receive(ends.now, thief, &confirm);
        assert_eq!(received, RobotReceived::Dropped(DropReason::Replayed, None));
    }
}

#[test]
fn datagrams_of_a_rolled_back_session_are_dropped() {
    let mut ends = Ends::connected();
    let old = ends.operator.send(ends.now, &walk(35.0, 0.0)).unwrap();
    ends.operator.connect(ends.now);
    ends.run();
    assert_eq!(ends.robot_hears(&old), RobotReceived::Dropped(DropReason::Session, None));
}

#[test]
fn what_one_robot_was_sent_moves_no_other_even_with_the_same_key() {
    let mut ends = Ends::connected();
    let mut other_robot = RobotSession::new(Some(key(1)), [12; 32]);
    let mut other_operator = second_operator(ends.now);
    connect(ends.now, &mut other_operator, &mut other_robot, OPERATOR);
    let mut frame = ends.operator.send(ends.now, &walk(35.0, 0.0)).unwrap();
    let theirs = other_operator.send(ends.now, &ping(1)).unwrap();
    let dropped = RobotReceived::Dropped(DropReason::Session, None);
    assert_eq!(other_robot.receive(ends.now, OPERATOR, &frame), dropped);
    // Spliced: the other session's header before this session's body.
    frame[..SEALED_HEADER].copy_from_slice(&theirs[..SEALED_HEADER]);
    let dropped = RobotReceived::Dropped(DropReason::Forged, None);
    assert_eq!(other_robot.receive(ends.now, OPERATOR, &frame), dropped);
}

#[test]
fn a_datagram_reflected_to_its_sender_is_dropped() {
    let mut ends = Ends::connected();
    let frame = ends.operator.send(ends.now, &ping(1)).unwrap();
    assert_eq!(ends.operator_hears(&frame), OperatorReceived::Dropped(DropReason::Forged));
    let (_, frame) = ends.robot.send(ends.now, &telemetry(1)).unwrap();
    assert_eq!(ends.robot_hears(&frame), RobotReceived::Dropped(DropReason::Forged, None));
}

#[test]
fn a_session_belongs_to_the_address_that_opened_it() {
    let mut ends = Ends::connected();
    let frame = ends.operator.send(ends.now, &ping(1)).unwrap();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &frame);
    assert_eq!(received, RobotReceived::Dropped(DropReason::Session, None));
}

// Freshness

/// A walk, sealed by an operator that has just seen everything.
fn sealed_walk(ends: &mut Ends) -> Frame {
    ends.moment();
    ends.operator.send(ends.now, &walk(30.0, 0.0)).unwrap()
}

#[test]
fn a_command_counts_up_to_the_command_age_and_not_after_it() {
    let mut ends = Ends::connected();
    let frame = sealed_walk(&mut ends);
    ends.wait(COMMAND_AGE);
    let counts = RobotReceived::Message(walk(30.0, 0.0));
    assert_eq!(ends.robot_hears(&frame), counts);
    assert_eq!(ends.robot.quality(ends.now).age(), Some(COMMAND_AGE));

    let frame = sealed_walk(&mut ends);
    ends.wait(COMMAND_AGE + TICK);
    let late = RobotReceived::Late { message: walk(30.0, 0.0), age: Some(COMMAND_AGE + TICK) };
    assert_eq!(ends.robot_hears(&frame), late);
    assert_eq!(ends.robot.quality(ends.now).late, 1);
}

#[test]
fn the_command_age_can_be_set_up_to_the_longest() {
    let mut ends = Ends::connected();
    let age = COMMAND_AGE / 2;
    ends.robot.set_command_age(age);
    let frame = sealed_walk(&mut ends);
    ends.wait(age + TICK);
    let late = RobotReceived::Late { message: walk(30.0, 0.0), age: Some(age + TICK) };
    assert_eq!((ends.robot_hears(&frame), ends.robot.command_age()), (late, age));
    ends.robot.set_command_age(LONGEST_COMMAND_AGE + TICK);
    assert_eq!(ends.robot.command_age(), LONGEST_COMMAND_AGE);
}

#[test]
fn the_moment_is_that_of_the_newest_fresh_command_of_a_session() {
    let mut ends = Ends::connected();
    let frame = sealed_walk(&mut ends);
    let seen = ends.now;
    ends.wait(COMMAND_AGE);
    ends.robot_hears(&frame);
    assert_eq!(ends.robot.moment(), Some(seen));
    ends.robot.end();
    assert_eq!(ends.robot.moment(), None);
}

#[test]
fn a_session_begins_with_the_moment_of_its_challenge_however_long_the_robot_runs() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    ends.wait(Duration::from_secs(1_000));
    ends.operator = second_operator(ends.now);
    assert_eq!(ends.run(), Status::Connected);
    let age = ends.robot.moment().map(|moment| ends.now.since(moment));
    assert!(age.is_some_and(|age| age <= COOKIE_LIFE), "{age:?}");
}

#[test]
fn a_command_that_is_older_than_the_robot_remembers_never_counts() {
    let mut ends = Ends::connected();
    let held_back = sealed_walk(&mut ends);
    for _ in 0..1_000 {
        ends.wait(Duration::from_millis(20));
        ends.moment();
        ends.ping();
    }
    // A datagram that the replay window still takes.
    let RobotReceived::Dropped(..) = ends.robot_hears(&held_back) else { panic!("dropped") };
    let mut ends = Ends::connected();
    let held_back = sealed_walk(&mut ends);
    for _ in 0..500 {
        ends.wait(Duration::from_millis(9));
        let _ = ends.robot.send(ends.now, &telemetry(1)).unwrap();
    }
    let late = RobotReceived::Late { message: walk(30.0, 0.0), age: None };
    assert_eq!(ends.robot_hears(&held_back), late);
}

#[test]
fn an_echo_of_what_was_never_sent_is_not_fresh() {
    // Two robots with the same entropy make the same keys: one has sent more than the other.
    let mut ends = Ends::connected();
    let mut silent = Ends::connected().robot;
    for _ in 0..3 {
        ends.moment();
    }
    let frame = ends.operator.send(ends.now, &walk(30.0, 0.0)).unwrap();
    let received = silent.receive(ends.now, OPERATOR, &frame);
    assert!(matches!(received, RobotReceived::Late { age: None, .. }), "{received:?}");
}

#[test]
fn datagrams_released_one_by_one_hold_the_robot_no_longer_than_fresh_ones_could() {
    let mut ends = Ends::connected();
    ends.moment();
    let intent = ends.now;
    let held_back: Vec<Frame> =
        (0..100).map(|request| ends.operator.send(ends.now, &ping(request)).unwrap()).collect();
    let mut second = second_operator(ends.now);
    for frame in &held_back {
        ends.wait(Duration::from_millis(90));
        ends.robot_hears(frame);
        if ends.now.since(intent) >= COMMAND_AGE + HOLDER_SILENCE {
            break;
        }
    }
    let hello = second.poll(ends.now).unwrap();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
    assert!(matches!(received, RobotReceived::Answer(_)), "{received:?}");
}

#[test]
fn datagrams_released_one_by_one_do_not_keep_a_session() {
    let mut ends = Ends::connected();
    ends.moment();
    let intent = ends.now;
    let held_back: Vec<Frame> =
        (0..3).map(|request| ends.operator.send(ends.now, &ping(request)).unwrap()).collect();
    for frame in &held_back {
        ends.wait(SESSION_EXPIRY / 2);
        ends.robot_hears(frame);
    }
    assert!(ends.now.since(intent) > SESSION_EXPIRY);
    assert_eq!(ends.robot.peer(ends.now), None);
}

#[test]
fn a_confirm_that_was_held_back_keeps_the_next_operator_out_no_longer_than_silence_would() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let intent = ends.now;
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.wait(Duration::from_millis(900));
    assert!(matches!(ends.robot_hears(&confirm), RobotReceived::Connected(_)));
    ends.now = intent + HOLDER_SILENCE;
    let hello = second_operator(ends.now).poll(ends.now).unwrap();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
    assert!(matches!(received, RobotReceived::Answer(_)), "{received:?}");
}

#[test]
fn a_holder_that_connects_anew_was_heard_in_its_session_before() {
    let mut ends = Ends::connected();
    let last = ends.operator.send(ends.now, &ping(1)).unwrap();
    ends.operator.connect(ends.now);
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.wait(Duration::from_millis(300));
    let heard = ends.now;
    assert!(matches!(ends.robot_hears(&last), RobotReceived::Message(_)));
    ends.wait(Duration::from_millis(500));
    assert!(matches!(ends.robot_hears(&confirm), RobotReceived::Connected(_)));
    let hello = second_operator(ends.now).poll(ends.now).unwrap();
    let before = ends.robot.receive(heard + (HOLDER_SILENCE - TICK), SECOND_OPERATOR, &hello);
    assert!(matches!(before, RobotReceived::Dropped(DropReason::Busy, Some(_))), "{before:?}");
    let after = ends.robot.receive(heard + HOLDER_SILENCE, SECOND_OPERATOR, &hello);
    assert!(matches!(after, RobotReceived::Answer(_)), "{after:?}");
}

#[test]
fn a_handshake_over_a_link_of_400_ms_each_way_completes() {
    let mut now = Instant::START;
    let mut robot = RobotSession::new(Some(key(1)), [11; 32]);
    let mut operator = OperatorSession::new(key(1), [22; 32], now);
    let way = Duration::from_millis(400);
    let (mut there, mut back) = (Vec::new(), Vec::new());
    while now < Instant::START + CONNECT_PATIENCE {
        while let Some(frame) = operator.poll(now) {
            there.push((now + way, frame));
        }
        for (_, frame) in there.extract_if(.., |(due, _)| *due <= now) {
            if let Some(answer) = answer(robot.receive(now, OPERATOR, &frame), frame.len()) {
                back.push((now + way, answer));
            }
        }
        for (_, answer) in back.extract_if(.., |(due, _)| *due <= now) {
            operator.receive(now, &answer);
        }
        if operator.status(now) == Status::Connected {
            return;
        }
        now = now + Duration::from_millis(10);
    }
    panic!("{:?}", operator.status(now));
}

// Health

#[test]
fn gaps_and_silence_are_counted() {
    let mut ends = Ends::connected();
    let frames: Vec<_> =
        (0..5).map(|request| ends.operator.send(ends.now, &ping(request)).unwrap()).collect();
    assert_eq!(ends.robot.quality(ends.now).silence_us, u32::MAX, "no command yet");
    ends.robot_hears(&frames[0]);
    ends.robot_hears(&frames[4]);
    ends.wait(Duration::from_millis(7));
    let quality = ends.robot.quality(ends.now);
    assert_eq!((quality.lost, quality.silence_us), (3, 7_000));
    ends.robot_hears(&frames[2]);
    assert_eq!(ends.robot.quality(ends.now).lost, 2, "late, not lost");

    for time in 0..5 {
        let (_, frame) = ends.robot.send(ends.now, &telemetry(time)).unwrap();
        if time % 2 == 0 {
            ends.operator_hears(&frame);
        }
    }
    let health = ends.operator.health();
    assert_eq!((health.accepted, health.lost, health.loss()), (3, 2, 0.4));
}

#[test]
fn a_reply_tells_the_round_trip_unless_its_command_was_repeated() {
    let mut ends = Ends::connected();
    let reply = |request| ToOperator::Reply(Reply { request, outcome: Outcome::Done });
    ends.operator.send(ends.now, &ping(1)).unwrap();
    ends.wait(Duration::from_millis(12));
    let (_, frame) = ends.robot.send(ends.now, &reply(1)).unwrap();
    ends.operator_hears(&frame);
    assert_eq!(ends.operator.health().round_trip, Some(Duration::from_millis(12)));
    for _ in 0..2 {
        ends.operator.send(ends.now, &STOP).unwrap();
        ends.wait(Duration::from_millis(50));
    }
    let (_, frame) = ends.robot.send(ends.now, &reply(2)).unwrap();
    ends.operator_hears(&frame);
    assert_eq!(ends.operator.health().round_trip, Some(Duration::from_millis(12)));
}

#[test]
fn of_several_unanswered_commands_each_reply_is_timed_by_its_own_and_once() {
    let mut ends = Ends::connected();
    for request in [1, 2] {
        ends.operator.send(ends.now, &ping(request)).unwrap();
    }
    let mut round_trip_after = |wait, request| {
        ends.wait(Duration::from_millis(wait));
        let reply = ToOperator::Reply(Reply { request, outcome: Outcome::Done });
        let (_, frame) = ends.robot.send(ends.now, &reply).unwrap();
        ends.operator_hears(&frame);
        ends.operator.health().round_trip.unwrap().as_millis()
    };
    let round_trips = [(12, 1), (18, 2), (10, 2)].map(|(wait, of)| round_trip_after(wait, of));
    assert_eq!(round_trips, [12, 30, 30]);
}

// Keys

#[test]
fn a_key_comes_back_from_its_text_and_is_never_shown() {
    let key = Key::new(core::array::from_fn(|place| place as u8 * 7));
    let text = key.to_text();
    let text = core::str::from_utf8(&*text).unwrap();
    assert_eq!(text.parse(), Ok(key.clone()));
    assert_eq!(format!(" {}\n", text.to_uppercase()).parse(), Ok(key.clone()));
    assert_eq!(format!("{key:?}"), "Key(secret)");
}

#[test]
fn text_that_is_no_key_is_refused_with_its_fault() {
    let parse = |text: &str| text.parse::<Key>().unwrap_err();
    assert_eq!(parse(""), KeyError::Length(0));
    assert_eq!(parse(&"a".repeat(63)), KeyError::Length(63));
    assert_eq!(parse(&"a".repeat(65)), KeyError::Length(65));
    assert_eq!(parse(&("a".repeat(10) + "g" + &"a".repeat(53))), KeyError::Digit(10));
    assert_eq!(parse(&("a".repeat(62) + "ä")), KeyError::Digit(62));
    assert_eq!(parse(&("a".repeat(62) + "+1")), KeyError::Digit(62));
    assert_eq!(parse(&"0".repeat(64)), KeyError::Zero);
}
