//! A stop from any holder of the key, whoever holds the session, in virtual time.

use core::net::SocketAddr;
use core::time::Duration;

use crate::ends::{Ends, OPERATOR, SECOND_OPERATOR, answer, key, ping, walk};
use flix_protocol::frame::{MAXIMUM_DATAGRAM, NONCE_LENGTH, PUBLIC_KEY_LENGTH, TAG_LENGTH};
use flix_protocol::message::DropReason;
use flix_protocol::session::{
    CONNECT_PATIENCE, COOKIE_LIFE, ConnectError, Key, OperatorSession, RobotReceived, RobotSession,
    STOP_ANSWER_PATIENCE, STOP_COOKIE_LIFE, STOP_RETRY, Status, StopSession, StopStatus,
};
use flix_protocol::units::Instant;

/// Longest time from asking for a stop to the stop.
const LIMIT: Duration = Duration::from_millis(300);
const MILLISECOND: Duration = Duration::from_millis(1);

fn stop(now: Instant) -> StopSession {
    StopSession::new(&key(1), [44; 32], now)
}

/// Returns the Stop that this operator sends after the robot's Challenge.
fn challenged(robot: &mut RobotSession, stop: &mut StopSession, now: Instant) -> Vec<u8> {
    let hello = stop.poll(now).unwrap();
    assert!(!stop.is_challenged());
    let challenge = answer(robot.receive(now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    stop.receive(now, &challenge).unwrap();
    assert!(stop.is_challenged());
    stop.poll(now).unwrap().to_vec()
}

/// Returns the robot's answer to a Stop that it obeys.
fn obeyed(received: RobotReceived) -> Vec<u8> {
    let RobotReceived::Stop(stopped, _) = received else { panic!("not obeyed: {received:?}") };
    stopped.to_vec()
}

/// Numbers that look random.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (self.0 >> 33) % limit
    }
}

/// A network that loses a share of all datagrams and delivers the others late.
struct Network {
    loss_percent: u64,
    delay: Duration,
    random: Random,
    /// Arrival, sender and content of what is under way.
    to_robot: Vec<(Instant, SocketAddr, Vec<u8>)>,
    to_operator: Vec<(Instant, Vec<u8>)>,
}

impl Network {
    fn loses(&mut self) -> bool {
        self.random.below(100) < self.loss_percent
    }
}

/// Datagrams that a stranger sends in the turn of this number, a flood of 1,000 a second: noise,
/// Hellos and Stops of another key, repeated Hellos and Stops of the right one.
fn forged(number: u64, recorded: &[Vec<u8>], random: &mut Random) -> (SocketAddr, Vec<u8>) {
    let from = ([10, 9, random.below(256) as u8, 7], 4000).into();
    let bytes = match number % 3 {
        0 => (0..random.below(MAXIMUM_DATAGRAM as u64)).map(|_| random.below(256) as u8).collect(),
        1 => recorded[random.below(recorded.len() as u64) as usize].clone(),
        _ => {
            let mut forged = recorded[random.below(recorded.len() as u64) as usize].clone();
            let place = random.below(forged.len() as u64) as usize;
            forged[place] ^= 1 << random.below(8);
            forged
        }
    };
    (from, bytes)
}

/// Returns the time from asking for a stop until the robot obeys it, while another operator drives and
/// a stranger floods the robot.
fn time_to_stop(seed: u64, loss_percent: u64, delay: Duration) -> Duration {
    let mut ends = Ends::connected();
    let recorded = {
        let mut earlier = stop(ends.now);
        let hello = earlier.poll(ends.now).unwrap().to_vec();
        vec![hello, challenged(&mut ends.robot, &mut stop(ends.now), ends.now)]
    };
    ends.wait(2 * COOKIE_LIFE);
    ends.operator.connect(ends.now);
    assert_eq!(ends.run(), Status::Connected);
    let begun = ends.now;
    let mut stop = stop(begun);
    let mut random = Random(seed);
    let mut network = Network {
        loss_percent,
        delay,
        random: Random(seed ^ 0x5eed),
        to_robot: Vec::new(),
        to_operator: Vec::new(),
    };
    for turn in 0.. {
        let now = ends.now;
        if turn % 20 == 0 {
            let driving = ends.operator.send(now, &walk(30.0, 0.0)).unwrap();
            ends.robot_hears(&driving);
        }
        for (at, bytes) in std::mem::take(&mut network.to_operator) {
            if at > now {
                network.to_operator.push((at, bytes));
            } else {
                let _ = stop.receive(now, &bytes);
            }
        }
        while let Some(frame) = stop.poll(now) {
            if !network.loses() {
                network.to_robot.push((now + network.delay, SECOND_OPERATOR, frame.to_vec()));
            }
        }
        let (from, bytes) = forged(turn, &recorded, &mut random);
        network.to_robot.push((now, from, bytes));
        for (at, from, bytes) in std::mem::take(&mut network.to_robot) {
            if at > now {
                network.to_robot.push((at, from, bytes));
                continue;
            }
            match ends.robot.receive(now, from, &bytes) {
                RobotReceived::Stop(..) => {
                    assert_eq!(from, SECOND_OPERATOR, "nobody else stops the robot");
                    assert_eq!(ends.robot.peer(now), Some(OPERATOR), "the session goes on");
                    return now.since(begun);
                }
                received if from == SECOND_OPERATOR && !network.loses() => {
                    let answer = answer(received, bytes.len());
                    network.to_operator.extend(answer.map(|answer| (now + network.delay, answer)));
                }
                _ => {}
            }
        }
        assert!(now.since(begun) < Duration::from_secs(5), "seed {seed}: no stop");
        ends.wait(MILLISECOND);
    }
    unreachable!("the loop ends by a stop")
}

#[test]
fn a_stop_acts_within_300_ms_while_another_drives_at_20_percent_loss_and_in_a_flood() {
    let slowest = (0..200).map(|seed| time_to_stop(seed, 20, Duration::from_millis(10))).max();
    assert!(slowest.unwrap() <= LIMIT, "{slowest:?}");
}

#[test]
fn a_stop_on_a_quiet_network_takes_one_and_a_half_round_trips() {
    assert_eq!(time_to_stop(1, 0, Duration::from_millis(20)), Duration::from_millis(60));
}

#[test]
fn a_repeated_stop_is_answered_again_and_stops_once() {
    let mut ends = Ends::connected();
    let mut stop = stop(ends.now);
    let datagram = challenged(&mut ends.robot, &mut stop, ends.now);
    let first = obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    let again = ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram);
    assert_eq!(again, RobotReceived::Answer(first[..].try_into().unwrap()));
}

#[test]
fn a_robot_whose_answers_come_more_than_a_second_late_is_stopped() {
    for half in [300, 600, 700, 800, 870] {
        let half = Duration::from_millis(half);
        let mut ends = Ends::connected();
        let mut stop = stop(ends.now);
        let (mut out, mut back) =
            (Vec::<(Instant, Vec<u8>)>::new(), Vec::<(Instant, Vec<u8>)>::new());
        let begun = ends.now;
        while stop.status() == StopStatus::Asking {
            if let Some(datagram) = stop.poll(ends.now) {
                out.push((ends.now + half, datagram.to_vec()));
            }
            for (_, datagram) in out.extract_if(.., |(at, _)| *at <= ends.now) {
                if let RobotReceived::Answer(answer) | RobotReceived::Stop(answer, _) =
                    ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram)
                {
                    back.push((ends.now + half, answer.to_vec()));
                }
            }
            for (_, datagram) in back.extract_if(.., |(at, _)| *at <= ends.now) {
                let _ = stop.receive(ends.now, &datagram);
            }
            ends.wait(MILLISECOND);
        }
        assert_eq!(stop.status(), StopStatus::Latched, "{half:?}");
        assert!(ends.now.since(begun) <= 4 * half + 20 * MILLISECOND, "{half:?}");
    }
}

#[test]
fn a_stop_that_stays_unanswered_starts_over_with_a_new_nonce() {
    let mut ends = Ends::connected();
    let mut stop = stop(ends.now);
    let lost = challenged(&mut ends.robot, &mut stop, ends.now);
    ends.wait(STOP_ANSWER_PATIENCE - MILLISECOND);
    let nonces = 4..4 + 2 * NONCE_LENGTH;
    assert_eq!(stop.poll(ends.now).unwrap()[nonces.clone()], lost[nonces.clone()]);
    ends.wait(STOP_RETRY);
    let anew = challenged(&mut ends.robot, &mut stop, ends.now);
    assert_ne!(anew[nonces.clone()], lost[nonces]);
    obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &anew));
}

#[test]
fn a_stop_starts_over_until_its_patience_ends() {
    let nonce = 4..4 + NONCE_LENGTH;
    for (left, starts_over) in [(MILLISECOND, true), (Duration::ZERO, false)] {
        let mut ends = Ends::connected();
        let mut stop = stop(ends.now);
        ends.wait(CONNECT_PATIENCE - STOP_ANSWER_PATIENCE - MILLISECOND);
        let lost = challenged(&mut ends.robot, &mut stop, ends.now);
        ends.wait(STOP_ANSWER_PATIENCE + MILLISECOND - left);
        let next = stop.poll(ends.now).unwrap();
        assert_eq!(next[nonce.clone()] != lost[nonce.clone()], starts_over, "{left:?} left");
    }
}

#[test]
fn what_a_robot_says_out_of_turn_is_of_no_session() {
    let mut ends = Ends::connected();
    let mut operator = stop(ends.now);
    let hello = operator.poll(ends.now).unwrap();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
    let challenge = answer(received, hello.len()).unwrap();
    operator.receive(ends.now, &challenge).unwrap();
    assert_eq!(operator.receive(ends.now, &challenge), Err(DropReason::Session));
    let demand = operator.poll(ends.now).unwrap();
    let stopped = obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &demand));
    assert_eq!(stop(ends.now).receive(ends.now, &stopped), Err(DropReason::Session));
}

#[test]
fn a_stop_ends_once_the_robot_is_at_rest() {
    let mut ends = Ends::connected();
    let mut stop = stop(ends.now);
    let datagram = challenged(&mut ends.robot, &mut stop, ends.now);
    let latched = obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    stop.receive(ends.now, &latched).unwrap();
    assert_eq!(stop.status(), StopStatus::Latched);
    ends.robot.set_at_rest(true);
    ends.wait(stop.poll_at().unwrap().since(ends.now));
    let again = stop.poll(ends.now).unwrap();
    let at_rest = answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &again), again.len());
    stop.receive(ends.now, &at_rest.unwrap()).unwrap();
    stop.receive(ends.now, &latched).unwrap();
    assert_eq!((stop.status(), stop.poll_at()), (StopStatus::AtRest, None));
}

#[test]
fn a_stop_does_nothing_once_the_cookie_has_lived() {
    let mut ends = Ends::connected();
    let datagram = challenged(&mut ends.robot, &mut stop(ends.now), ends.now);
    obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    ends.wait(STOP_COOKIE_LIFE);
    let held_back = challenged(&mut ends.robot, &mut stop(ends.now), ends.now);
    ends.wait(STOP_COOKIE_LIFE);
    for datagram in [datagram, held_back] {
        let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram);
        assert_eq!(received, RobotReceived::Dropped(DropReason::Replayed, None));
    }
}

#[test]
fn a_stop_is_good_for_its_robot_its_sender_its_start_and_its_key_alone() {
    let mut ends = Ends::connected();
    let datagram = challenged(&mut ends.robot, &mut stop(ends.now), ends.now);
    let refuses = |robot: &mut RobotSession, from| {
        let received = robot.receive(ends.now, from, &datagram);
        assert!(matches!(received, RobotReceived::Dropped(_, None)), "{received:?}");
    };
    let mut restarted_or_another = RobotSession::new(Some(key(1)), [12; 32]);
    refuses(&mut restarted_or_another, SECOND_OPERATOR);
    refuses(&mut ends.robot, OPERATOR);
    for key in [key(2), key(1)] {
        ends.robot.set_operators(Some(key));
        refuses(&mut ends.robot, SECOND_OPERATOR);
    }
}

#[test]
fn a_stop_cannot_be_made_from_a_handshake_nor_a_session_from_a_stop() {
    let mut robot = RobotSession::new(Some(key(1)), [11; 32]);
    let now = Instant::from_micros(1_000);
    let stop = challenged(&mut robot, &mut stop(now), now);
    let mut operator = OperatorSession::new(key(1), [22; 32], now);
    let hello = operator.poll(now).unwrap();
    let challenge = answer(robot.receive(now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    operator.receive(now, &challenge);
    let confirm = operator.poll(now).unwrap();
    // Confirm has an ephemeral key before its tag, where Stop counts its repetitions.
    let place = confirm.len() - TAG_LENGTH - PUBLIC_KEY_LENGTH;
    let (fields, rest) = confirm.split_at(place);
    let (key, tag) = rest.split_at(PUBLIC_KEY_LENGTH);
    let from_stop = [&stop[..place], key, &stop[place + 1..]].concat();
    let from_confirm = [fields, &stop[place..=place], tag].concat();
    for (kind, mut datagram) in [(confirm[3], from_stop), (stop[3], from_confirm)] {
        datagram[3] = kind;
        let received = robot.receive(now, SECOND_OPERATOR, &datagram);
        assert_eq!(received, RobotReceived::Dropped(DropReason::Forged, None));
    }
}

#[test]
fn every_changed_bit_of_a_stop_makes_it_void() {
    let mut ends = Ends::connected();
    let datagram = challenged(&mut ends.robot, &mut stop(ends.now), ends.now);
    for bit in 0..datagram.len() * 8 {
        let mut changed = datagram.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &changed);
        assert!(matches!(received, RobotReceived::Dropped(_, None)), "bit {bit}: {received:?}");
    }
    obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
}

#[test]
fn only_the_robot_itself_says_that_it_stopped() {
    let mut ends = Ends::connected();
    let mut operator = stop(ends.now);
    let datagram = challenged(&mut ends.robot, &mut operator, ends.now);
    let stopped = obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    for bit in 0..stopped.len() * 8 {
        let mut changed = stopped.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        operator.receive(ends.now, &changed).unwrap_err();
    }
    // What it said of an earlier stop.
    let mut later = StopSession::new(&key(1), [45; 32], ends.now);
    challenged(&mut ends.robot, &mut later, ends.now);
    assert_eq!(later.receive(ends.now, &stopped), Err(DropReason::Forged));
    assert_eq!([operator.status(), later.status()], [StopStatus::Asking; 2]);
}

#[test]
fn a_session_that_begins_meanwhile_does_not_make_a_stop_void() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let datagram = challenged(&mut ends.robot, &mut stop(ends.now), ends.now);
    assert_eq!(ends.run(), Status::Connected);
    obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    let driving = ends.operator.send(ends.now, &ping(1)).unwrap();
    assert!(matches!(ends.robot_hears(&driving), RobotReceived::Message(_)));
}

fn fails_with(robot: Option<Key>) -> (StopStatus, Duration) {
    let mut now = Instant::from_micros(1_000);
    let begun = now;
    let mut robot = RobotSession::new(robot, [11; 32]);
    let mut stop = stop(now);
    while let Some(at) = stop.poll_at() {
        now = at;
        if let Some(hello) = stop.poll(now) {
            let refusal = answer(robot.receive(now, OPERATOR, &hello), hello.len());
            stop.receive(now, &refusal.unwrap()).unwrap();
        }
    }
    (stop.status(), now.since(begun))
}

#[test]
fn a_stop_that_is_refused_says_why() {
    let (status, after) = fails_with(Some(key(2)));
    assert_eq!(status, StopStatus::Failed(ConnectError::WrongKey));
    assert_eq!(after, CONNECT_PATIENCE, "anybody could have said so");
    assert_eq!(fails_with(None).0, StopStatus::Failed(ConnectError::Unprovisioned));
}

#[test]
fn forged_refusals_do_not_end_a_stop_however_slow_the_robot_is() {
    let mut ends = Ends::connected();
    let mut forger = RobotSession::new(Some(key(2)), [11; 32]);
    let mut stop = stop(ends.now);
    let mut underway: Option<(Instant, Vec<u8>)> = None;
    while stop.status() == StopStatus::Asking {
        let due = stop.poll_at().unwrap();
        ends.now = underway.as_ref().map_or(due, |(at, _)| due.min(*at));
        if let Some((_, answer)) = underway.take_if(|(at, _)| *at <= ends.now) {
            let _ = stop.receive(ends.now, &answer);
        }
        let Some(sent) = stop.poll(ends.now) else { continue };
        if let Some(refusal) = answer(forger.receive(ends.now, OPERATOR, &sent), sent.len()) {
            let _ = stop.receive(ends.now, &refusal);
        }
        if underway.is_none() {
            let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &sent);
            let back = match received {
                RobotReceived::Stop(stopped, _) => stopped.to_vec(),
                other => answer(other, sent.len()).unwrap(),
            };
            underway = Some((ends.now + Duration::from_millis(600), back));
        }
    }
    assert_eq!(stop.status(), StopStatus::Latched);
}

#[test]
fn a_stop_without_an_answer_gives_up_after_the_patience() {
    let mut now = Instant::from_micros(1_000);
    let mut stop = stop(now);
    while let Some(at) = stop.poll_at() {
        now = at;
        let _ = stop.poll(now);
    }
    assert_eq!(stop.status(), StopStatus::Failed(ConnectError::NoAnswer));
    assert_eq!(now, Instant::from_micros(1_000) + CONNECT_PATIENCE);
}

/// A stop that is forgotten must not count again: its cookie is good for a while longer.
#[test]
fn no_stop_counts_twice_however_many_came_between() {
    for between in [7, 8, 9, 17, 40] {
        let mut ends = Ends::connected();
        let now = ends.now;
        let recorded: Vec<Vec<u8>> = (0..=between)
            .map(|number| {
                let mut stop = StopSession::new(&key(1), [number; 32], now);
                let datagram = challenged(&mut ends.robot, &mut stop, now);
                let stopped = obeyed(ends.robot.receive(now, SECOND_OPERATOR, &datagram));
                stop.receive(now, &stopped).unwrap();
                assert_eq!(stop.status(), StopStatus::Latched, "{number} of {between}");
                datagram
            })
            .collect();
        for age in [0, 500, 1_200, 2_000] {
            for (number, datagram) in recorded.iter().enumerate() {
                let later = now + age * MILLISECOND;
                let received = ends.robot.receive(later, SECOND_OPERATOR, datagram);
                let is_obeyed = matches!(received, RobotReceived::Stop(..));
                assert!(!is_obeyed, "{number} of {between} counts again after {age} ms");
            }
        }
    }
}

#[test]
fn one_stop_after_the_other_is_answered_as_often_as_it_is_repeated() {
    let mut ends = Ends::connected();
    for number in 0..20 {
        let mut stop = StopSession::new(&key(1), [number; 32], ends.now);
        let datagram = challenged(&mut ends.robot, &mut stop, ends.now);
        obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
        ends.wait(STOP_RETRY);
        let repeated = ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram);
        assert!(matches!(repeated, RobotReceived::Answer(_)), "{number}: {repeated:?}");
        ends.wait(Duration::from_millis(400));
    }
}

/// Whose cookie is made invalid by the stops of others asks for another.
#[test]
fn a_stop_gets_through_while_others_stop_without_end() {
    let mut ends = Ends::connected();
    let mut stop = stop(ends.now);
    let begun = ends.now;
    let _ = challenged(&mut ends.robot, &mut stop, ends.now);
    for number in 0..20 {
        let mut other = StopSession::new(&key(1), [100 + number; 32], ends.now);
        let datagram = challenged(&mut ends.robot, &mut other, ends.now);
        obeyed(ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram));
    }
    while stop.status() == StopStatus::Asking {
        ends.wait(MILLISECOND);
        if let Some(frame) = stop.poll(ends.now) {
            let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &frame);
            if let Some(answer) = answer(received, frame.len()) {
                let _ = stop.receive(ends.now, &answer);
            }
        }
    }
    assert_eq!(stop.status(), StopStatus::Latched);
    assert!(ends.now.since(begun) <= STOP_ANSWER_PATIENCE + LIMIT);
}
