//! The client's promises, in virtual time against a robot's end of the link.
use std::net::SocketAddr;
use std::time::Duration;

use crate::support::{FakeRobot, key, seeded_loss};
use flix_host::link::{
    Client, DISARMED_AFTER, KEEP_ALIVE, REQUEST_PATIENCE, SILENCE, STOP_BESIDE_AFTER, StopState,
    TRY_AGAIN, Update,
};
use flix_host::nav::Decision;
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_host::pose::PoseSample;
use flix_protocol::message::{Command, Fault, Outcome, ParameterCommand, Refusal, Setpoint, State};
use flix_protocol::session::{ConnectError, StopSession};
use flix_protocol::units::Instant;

const OPERATOR: &str = "10.0.0.1:5000";
const TICK: Duration = Duration::from_millis(1);

/// Operator and robot, with a network between them that is late and loses.
pub struct World {
    pub now: Instant,
    pub client: Client,
    pub robot: FakeRobot,
    latency: Duration,
    lose: Box<dyn FnMut() -> bool>,
    is_cut: bool,
    /// Datagrams of this length never arrive.
    lost_length: Option<usize>,
    to_robot: Vec<(Instant, Vec<u8>)>,
    to_client: Vec<(Instant, Vec<u8>)>,
    updates: Vec<Update>,
}

impl World {
    fn new() -> Self {
        let now = Instant::from_micros(1_000_000);
        Self {
            now,
            client: Client::new(key(), [9; 32], now),
            robot: FakeRobot::new(Some(key())),
            latency: Duration::from_millis(5),
            lose: Box::new(|| false),
            is_cut: false,
            lost_length: None,
            to_robot: Vec::new(),
            to_client: Vec::new(),
            updates: Vec::new(),
        }
    }

    pub fn connected() -> Self {
        let mut world = Self::new();
        world.run(Duration::from_millis(600));
        assert!(world.client.is_connected(world.now));
        world
    }

    fn armed() -> Self {
        let mut world = Self::connected();
        world.client.request(world.now, Command::Arm);
        world.run(Duration::from_millis(50));
        assert_eq!(world.robot.state, State::Armed);
        world
    }

    fn run(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            self.step();
        }
    }

    fn step(&mut self) {
        self.exchange();
        while let Some(update) = self.client.update() {
            if !matches!(update, Update::Telemetry(_)) {
                self.updates.push(update);
            }
        }
    }

    /// Sends and receives for a moment; what the client learns is left to somebody else.
    pub fn exchange(&mut self) {
        let operator: SocketAddr = OPERATOR.parse().unwrap();
        while let Some(frame) = self.client.transmit(self.now) {
            let is_lost = self.lost_length == Some(frame.len());
            if !(self.is_cut || is_lost || (self.lose)()) {
                self.to_robot.push((self.now + self.latency, frame.to_vec()));
            }
        }
        let mut answers = self.robot.tick(self.now);
        for datagram in arrived(&mut self.to_robot, self.now) {
            answers.extend(self.robot.receive(self.now, operator, &datagram));
        }
        for (_, datagram) in answers {
            if !(self.is_cut || (self.lose)()) {
                self.to_client.push((self.now + self.latency, datagram));
            }
        }
        for datagram in arrived(&mut self.to_client, self.now) {
            self.client.receive(self.now, &datagram);
        }
        self.now = self.now + TICK;
    }

    /// Somebody without a session stops the robot.
    fn stop_from_outside(&mut self) {
        let mut stop = StopSession::new(&key(), [6; 32], self.now);
        let outside: SocketAddr = "10.0.0.2:5000".parse().unwrap();
        for _ in 0..2 {
            let asked = stop.poll(self.now).unwrap();
            for (to, datagram) in self.robot.receive(self.now, outside, &asked) {
                if to == outside {
                    stop.receive(self.now, &datagram).unwrap();
                }
            }
        }
        assert!(self.robot.stopped);
    }

    fn answer(&self, wanted: u32) -> Option<&Outcome> {
        self.updates.iter().find_map(|update| match update {
            Update::Answer { request, outcome } if *request == wanted => Some(outcome),
            _ => None,
        })
    }
}

fn arrived(queue: &mut Vec<(Instant, Vec<u8>)>, now: Instant) -> Vec<Vec<u8>> {
    queue.extract_if(.., |(at, _)| *at <= now).map(|(_, datagram)| datagram).collect()
}

fn setpoint(frequency: f32, direction: f32) -> Setpoint {
    Setpoint::from_numbers(frequency, direction).unwrap()
}

#[test]
fn what_is_held_is_repeated_at_a_fixed_rate() {
    let mut world = World::armed();
    let before = world.robot.commands.len();
    world.client.hold(world.now, setpoint(-30.0, 30.0));
    world.run(Duration::from_secs(1));
    let setpoints = world.robot.commands[before..]
        .iter()
        .filter(|command| matches!(command, Command::Setpoint(_)))
        .count();
    let expected = usize::try_from(Duration::from_secs(1).as_millis() / KEEP_ALIVE.as_millis());
    assert!(setpoints.abs_diff(expected.unwrap()) <= 1, "{setpoints} setpoints in a second");
    assert_eq!(world.robot.setpoint, setpoint(-30.0, 30.0));
}

#[test]
fn a_new_setpoint_leaves_at_once() {
    let mut world = World::armed();
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.run(Duration::from_millis(107));
    world.client.hold(world.now, setpoint(20.0, 0.0));
    assert!(world.client.transmit_at().unwrap() <= world.now);
    world.run(world.latency + 2 * TICK);
    assert_eq!(world.robot.setpoint, setpoint(20.0, 0.0));
}

#[test]
fn a_request_is_answered_under_heavy_loss() {
    for seed in 0..50 {
        let mut world = World::connected();
        world.lose = Box::new(seeded_loss(seed, 0.3));
        let request = world.client.request(world.now, Command::Identify);
        world.run(Duration::from_secs(2));
        assert!(matches!(world.answer(request), Some(Outcome::Identity(_))), "seed {seed}");
    }
}

#[test]
fn a_request_without_an_answer_is_given_up_and_reported_once() {
    let mut world = World::connected();
    world.is_cut = true;
    let request = world.client.request(world.now, Command::Identify);
    world.run(Duration::from_secs(5));
    let reported = world.updates.iter().filter(|it| **it == Update::Unanswered { request }).count();
    assert_eq!(reported, 1);
}

#[test]
fn stop_is_repeated_until_it_is_acknowledged() {
    for seed in 0..50 {
        let mut world = World::armed();
        world.client.hold(world.now, setpoint(-30.0, 90.0));
        world.run(Duration::from_millis(100));
        world.lose = Box::new(seeded_loss(seed, 0.6));
        world.client.stop(world.now);
        world.run(Duration::from_secs(1));
        assert!(world.robot.stopped, "seed {seed}");
        assert_eq!(world.client.stop_state(), StopState::Acknowledged, "seed {seed}");
    }
}

#[test]
fn an_acknowledged_stop_is_not_repeated() {
    let mut world = World::armed();
    world.client.stop(world.now);
    world.run(Duration::from_millis(100));
    let stops = |world: &World| {
        world.robot.commands.iter().filter(|command| **command == Command::Stop).count()
    };
    let acknowledged = stops(&world);
    world.run(Duration::from_secs(1));
    assert_eq!(stops(&world), acknowledged);
}

#[test]
fn stop_overtakes_what_was_asked_before() {
    let mut world = World::connected();
    let arm = world.client.request(world.now, Command::Arm);
    world.client.stop(world.now);
    world.run(Duration::from_secs(1));
    assert!(!world.robot.commands.contains(&Command::Arm));
    assert!(world.updates.contains(&Update::Unanswered { request: arm }));
}

#[test]
fn a_robot_that_was_disarmed_is_not_armed_by_what_was_asked_before() {
    let mut world = World::connected();
    let arm = world.client.request(world.now, Command::Arm);
    world.run(Duration::from_millis(2));
    // The answer to it is lost.
    world.is_cut = true;
    world.run(Duration::from_millis(40));
    world.is_cut = false;
    world.client.release();
    world.client.request(world.now, Command::Disarm);
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.state, State::Disarmed);
    assert_eq!(world.robot.commands.iter().filter(|it| **it == Command::Arm).count(), 1);
    assert!(world.updates.contains(&Update::Unanswered { request: arm }));
}

/// Counts how often the robot was asked to arm.
fn armings(world: &World) -> usize {
    count(world, &Command::Arm)
}

/// How often the robot got this command.
fn count(world: &World, command: &Command) -> usize {
    world.robot.commands.iter().filter(|it| *it == command).count()
}

#[test]
fn what_is_insisted_on_is_asked_again_while_the_robot_refuses_for_what_passes() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 3;
    let arm = world.client.insist(world.now, Command::Arm, Duration::from_secs(1));
    world.run(Duration::from_millis(50));
    assert_eq!(armings(&world), 1);
    assert_eq!(world.answer(arm), None);
    world.run(4 * TRY_AGAIN);
    assert_eq!(armings(&world), 4);
    assert_eq!(world.answer(arm), Some(&Outcome::Done));
    assert_eq!(world.robot.state, State::Armed);
}

#[test]
fn what_is_insisted_on_is_refused_once_patience_is_over_and_at_once_for_what_stays() {
    let patience = TRY_AGAIN * 5 / 2;
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    let arm = world.client.insist(world.now, Command::Arm, patience);
    world.run(2 * patience);
    let stopping = Outcome::Refused(Refusal::State(State::Stopping));
    assert_eq!((armings(&world), world.answer(arm)), (3, Some(&stopping)));
    // What is asked once is answered once.
    let arm = world.client.request(world.now, Command::Arm);
    world.run(Duration::from_millis(50));
    assert_eq!((armings(&world), world.answer(arm)), (4, Some(&stopping)));

    world.robot.ramps_down_for = 0;
    world.stop_from_outside();
    world.run(Duration::from_millis(50));
    let arm = world.client.insist(world.now, Command::Arm, patience);
    world.run(Duration::from_millis(50));
    assert_eq!(world.answer(arm), Some(&Outcome::Refused(Refusal::Stopped)));
}

#[test]
fn what_is_given_up_is_asked_no_more() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    let [arm, question] = [Command::Arm, Command::Identify]
        .map(|it| world.client.insist(world.now, it, Duration::from_secs(1)));
    world.run(Duration::from_millis(50));
    world.client.give_up_on_moving(None);
    world.run(Duration::from_millis(500));
    assert_eq!((armings(&world), world.answer(arm)), (1, None));
    assert!(world.answer(question).is_some());
}

#[test]
fn what_is_never_answered_is_given_up_while_the_session_stands() {
    let mut world = World::connected();
    world.robot.lost = Some(Command::Identify);
    let question = world.client.request(world.now, Command::Identify);
    world.run(REQUEST_PATIENCE - Duration::from_millis(50));
    assert!(!world.updates.contains(&Update::Unanswered { request: question }));
    world.run(Duration::from_millis(100));
    assert!(world.updates.contains(&Update::Unanswered { request: question }));
    assert!(world.client.is_connected(world.now));
}

#[test]
fn what_changes_the_robot_is_asked_in_turn_whatever_is_lost() {
    let set = |value| {
        let name = "current_limit".try_into().unwrap();
        Command::Parameter(ParameterCommand::Set(name, value))
    };
    for seed in 0..50 {
        let mut world = World::connected();
        world.lose = Box::new(seeded_loss(seed, 0.4));
        let [first, question, second] =
            [set(2.4), Command::Identify, set(0.9)].map(|it| world.client.request(world.now, it));
        world.run(Duration::from_secs(3));
        assert!([first, question, second].iter().all(|it| world.answer(*it).is_some()), "{seed}");
        let sets = world.robot.commands.iter().filter(|it| matches!(it, Command::Parameter(_)));
        let sets: Vec<_> = sets.cloned().collect();
        assert!(sets.is_sorted_by_key(|it| *it == set(0.9)), "{seed}: {sets:?}");
    }
}

#[test]
fn nothing_that_was_asked_before_a_stop_from_outside_clears_it() {
    let mut world = World::armed();
    world.client.stop(world.now);
    world.run(Duration::from_millis(50));
    let clear = world.client.request(world.now, Command::Clear);
    world.run(Duration::from_millis(2));
    world.stop_from_outside();
    // Even where the event is lost.
    world.to_robot.clear();
    world.run(Duration::from_secs(1));
    assert_eq!(world.answer(clear), Some(&Outcome::Refused(Refusal::Stopped)));
    assert!(world.robot.stopped);
}

#[test]
fn who_knows_of_a_stop_clears_it() {
    let mut world = World::connected();
    for stop in [|it: &mut World| it.client.stop(it.now), World::stop_from_outside] {
        stop(&mut world);
        world.run(Duration::from_millis(100));
        let clear = world.client.request(world.now, Command::Clear);
        world.run(Duration::from_millis(100));
        assert_eq!(world.answer(clear), Some(&Outcome::Done));
    }
}

#[test]
fn who_asked_to_arm_is_driving_until_the_robot_has_answered() {
    let mut world = World::new();
    while !world.client.is_connected(world.now) {
        world.step();
    }
    let arm = world.client.request(world.now, Command::Arm);
    // Also where the first telemetry states the robot as it was before.
    while world.client.telemetry().is_none() || world.answer(arm).is_none() {
        world.step();
        assert!(world.client.is_driving());
    }
}

#[test]
fn a_robot_that_stays_away_has_disarmed_by_itself() {
    let mut world = World::armed();
    world.run(Duration::from_secs(3));
    assert!(world.client.is_driving());
    world.is_cut = true;
    while !world.updates.contains(&Update::Lost) {
        world.step();
    }
    world.run(DISARMED_AFTER);
    assert!(world.client.is_driving());
    world.step();
    assert!(!world.client.is_driving());
}

#[test]
fn who_wakes_late_learns_that_a_robot_has_disarmed_by_itself() {
    let mut world = World::armed();
    world.is_cut = true;
    world.run(SILENCE + DISARMED_AFTER - Duration::from_millis(100));
    assert!(world.client.is_driving());
    world.now = world.now + Duration::from_millis(200);
    world.step();
    assert!(!world.client.is_driving());
}

#[test]
fn after_an_outage_a_robot_at_rest_is_driven_no_more() {
    for (state, is_driven) in [(State::Disarmed, false), (State::Armed, true)] {
        let mut world = World::armed();
        world.is_cut = true;
        world.run(Duration::from_millis(1_100));
        world.is_cut = false;
        while world.client.telemetry().is_none() {
            world.robot.state = state;
            world.step();
        }
        assert_eq!(world.client.is_driving(), is_driven);
    }
}

#[test]
fn a_robot_that_is_kept_from_hearing_disarm_hears_no_sign_of_life_either() {
    let mut world = World::armed();
    world.client.release();
    world.client.request(world.now, Command::Disarm);
    let disarm = world.client.transmit(world.now).unwrap();
    world.lost_length = Some(disarm.len());
    world.run(Duration::from_millis(1_500));
    assert_eq!(world.robot.state, State::Disarmed);
    assert!(!world.robot.commands.contains(&Command::Disarm));
}

#[test]
fn a_stop_after_what_the_robot_stated_last_is_news_however_late_that_came() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(400);
    world.run(Duration::from_secs(1));
    // Telemetry from before the stop is still under way.
    world.stop_from_outside();
    world.lose = Box::new(|| true);
    world.run(Duration::from_millis(2_000));
    let clear = world.client.request(world.now, Command::Clear);
    (world.lose, world.latency) = (Box::new(|| false), Duration::from_millis(5));
    world.run(Duration::from_millis(1_500));
    assert_eq!(world.answer(clear), Some(&Outcome::Refused(Refusal::Stopped)));
}

#[test]
fn what_was_asked_without_a_session_clears_no_stop_that_came_meanwhile() {
    // Of the times between two pieces of telemetry one has it stated at the very time of the stop.
    for (is_news, after) in [true, false].into_iter().flat_map(|it| (0..20).map(move |ms| (it, ms)))
    {
        let mut world = World::connected();
        world.run(Duration::from_millis(after));
        if !is_news {
            world.stop_from_outside();
            while world.client.telemetry().is_none_or(|it| !it.stopped) {
                world.step();
            }
        }
        world.is_cut = true;
        world.run(Duration::from_millis(1_500));
        let [clear, arm] =
            [Command::Clear, Command::Arm].map(|it| world.client.request(world.now, it));
        if is_news {
            world.stop_from_outside();
        }
        world.is_cut = false;
        world.run(Duration::from_millis(1_500));
        let refused = Some(&Outcome::Refused(Refusal::Stopped));
        assert_eq!(world.answer(clear) == refused, is_news);
        assert_eq!(world.answer(arm) == refused, is_news);
        assert_eq!(world.robot.stopped, is_news);
    }
}

#[test]
fn what_was_asked_before_the_first_session_clears_no_stop_that_came_meanwhile() {
    for is_news in [true, false] {
        let mut world = World::new();
        if !is_news {
            world.stop_from_outside();
            world.run(Duration::from_millis(100));
            world.client = Client::new(key(), [8; 32], world.now);
        }
        world.is_cut = true;
        world.run(Duration::from_millis(300));
        let clear = world.client.request(world.now, Command::Clear);
        if is_news {
            world.stop_from_outside();
        }
        world.is_cut = false;
        world.run(Duration::from_millis(1_500));
        assert_eq!(world.robot.stopped, is_news);
        assert_eq!(world.answer(clear) == Some(&Outcome::Done), !is_news);
    }
}

#[test]
fn a_person_who_wants_the_same_again_is_heard_at_once_and_a_program_that_holds_it_is_not() {
    let mut world = World::armed();
    let walk = setpoint(-30.0, 30.0);
    for _ in 0..3 {
        let intent = world.robot.intent;
        world.client.hold(world.now, walk);
        world.run(Duration::from_millis(100));
        assert_eq!(world.robot.intent, intent);
        world.client.want(world.now, walk);
        world.run(2 * world.latency + TICK);
        assert_eq!(world.robot.intent, intent.wrapping_add(1));
    }
    assert_eq!(world.client.held(), Some(walk));
}

#[test]
fn a_robot_that_another_holds_is_stopped_all_the_same() {
    let mut world = World::connected();
    world.is_cut = true;
    world.run(Duration::from_millis(1_500));
    let other: SocketAddr = "10.0.0.2:5000".parse().unwrap();
    let mut holder = Client::new(key(), [4; 32], world.now);
    let mut hold = |world: &mut World, time: Duration| {
        let end = world.now + time;
        while world.now < end {
            world.step();
            while let Some(frame) = holder.transmit(world.now) {
                for (to, datagram) in world.robot.receive(world.now, other, &frame) {
                    if to == other {
                        holder.receive(world.now, &datagram);
                    }
                }
            }
        }
    };
    hold(&mut world, Duration::from_millis(100));
    world.is_cut = false;
    hold(&mut world, Duration::from_secs(4));
    let busy = |it: &Update| matches!(it, Update::Failed(ConnectError::Busy(_)));
    assert!(world.updates.iter().any(busy));
    world.client.stop(world.now);
    hold(&mut world, Duration::from_millis(100));
    assert!(world.robot.stopped);
    assert_eq!(world.client.stop_state(), StopState::Acknowledged);
}

#[test]
fn a_stop_is_asked_for_beside_the_session_only_after_a_while() {
    let mut world = World::armed();
    world.is_cut = true;
    world.client.stop(world.now);
    let begin = world.now;
    let greeting = StopSession::new(&key(), [6; 32], world.now).poll(world.now).unwrap().len();
    let mut lengths = std::collections::BTreeSet::new();
    for (time, greets) in [(STOP_BESIDE_AFTER, false), (2 * STOP_BESIDE_AFTER, true)] {
        while world.now.since(begin) < time {
            lengths
                .extend(std::iter::from_fn(|| world.client.transmit(world.now)).map(|it| it.len()));
            world.step();
        }
        assert_eq!(lengths.contains(&greeting), greets, "{greeting} {lengths:?}");
    }
}

#[test]
fn stop_survives_a_lost_session() {
    let mut world = World::armed();
    world.is_cut = true;
    world.client.stop(world.now);
    world.run(Duration::from_millis(2500));
    assert_eq!(world.client.stop_state(), StopState::Sending);
    world.is_cut = false;
    world.run(Duration::from_secs(1));
    assert!(world.robot.stopped);
    assert_eq!(world.client.stop_state(), StopState::Acknowledged);
}

#[test]
fn a_robot_that_comes_back_is_not_started_again() {
    let mut world = World::armed();
    world.client.hold(world.now, setpoint(-30.0, 30.0));
    world.run(Duration::from_millis(100));
    world.is_cut = true;
    world.run(Duration::from_millis(1500));
    assert!(world.updates.contains(&Update::Lost));
    world.is_cut = false;
    world.run(Duration::from_secs(1));
    assert!(world.client.is_connected(world.now), "it comes back by itself");
    assert_eq!(world.client.held(), None);
    assert_eq!(world.robot.state, State::Disarmed);
}

#[test]
fn a_robot_that_ramps_down_hears_setpoints_all_the_way() {
    let mut world = World::armed();
    world.client.hold(world.now, setpoint(-30.0, 30.0));
    world.run(Duration::from_millis(100));
    world.client.release();
    world.robot.state = State::Stopping;
    world.run(Duration::from_millis(100));
    let before = world.robot.commands.len();
    world.run(Duration::from_millis(100));
    let heard = &world.robot.commands[before..];
    assert!(heard.len() >= 4 && heard.iter().all(|it| *it == Command::Setpoint(Setpoint::REST)));
}

#[test]
fn a_refused_setpoint_is_reported_once() {
    let mut world = World::connected();
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.run(Duration::from_secs(1));
    let reported: Vec<_> = world
        .updates
        .iter()
        .filter(|update| matches!(update, Update::SetpointRefused(_)))
        .collect();
    assert_eq!(reported, [&Update::SetpointRefused(Refusal::State(State::Disarmed))]);
}

#[test]
fn round_trips_are_measured_and_losses_counted() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(20);
    world.run(Duration::from_secs(30));
    let half = world.client.statistics().round_trip_quantile(0.5).unwrap();
    assert!(half.abs_diff(Duration::from_millis(40)) <= 3 * TICK, "{half:?}");
    assert!(world.client.statistics().loss() < 1e-9);

    world.lose = Box::new(seeded_loss(1, 0.1));
    let before = world.client.statistics().unanswered();
    world.run(Duration::from_secs(60));
    let lost = (world.client.statistics().unanswered() - before) as f64 / (60.0 * 50.0);
    assert!((lost - 0.19).abs() < 0.03, "0.1 each way is 0.19 there and back: {lost}");
}

#[test]
fn goodbye_lets_the_next_operator_in_at_once() {
    let mut world = World::connected();
    world.client.leave();
    world.run(Duration::from_millis(20));
    let next: SocketAddr = "10.0.0.2:5000".parse().unwrap();
    let mut second = Client::new(key(), [4; 32], world.now);
    for _ in 0..4 {
        while let Some(frame) = second.transmit(world.now) {
            for (to, datagram) in world.robot.receive(world.now, next, &frame) {
                assert_eq!(to, next);
                second.receive(world.now, &datagram);
            }
        }
    }
    assert!(second.is_connected(world.now));
}

#[test]
fn after_goodbye_nothing_is_sent() {
    let mut world = World::connected();
    world.client.leave();
    world.run(Duration::from_millis(20));
    let commands = world.robot.commands.len();
    world.run(Duration::from_secs(5));
    assert_eq!(world.robot.commands.len(), commands);
    assert!(!world.client.is_connected(world.now));
}

#[test]
fn a_robot_with_another_key_is_reported_as_such() {
    let mut world = World::new();
    world.robot = FakeRobot::new(Some(flix_protocol::session::Key::new([8; 32])));
    world.run(Duration::from_secs(4));
    assert!(world.updates.contains(&Update::Failed(ConnectError::WrongKey)));
}

#[test]
fn nobody_there_is_reported_as_no_answer() {
    let mut world = World::new();
    world.is_cut = true;
    world.run(Duration::from_secs(4));
    assert!(world.updates.contains(&Update::Failed(ConnectError::NoAnswer)));
}

#[test]
fn transmit_at_lets_no_due_datagram_wait_and_wakes_nobody_for_nothing() {
    let mut world = World::armed();
    world.lose = Box::new(seeded_loss(5, 0.2));
    world.client.hold(world.now, setpoint(-30.0, 30.0));
    for step in 0..6000 {
        let (now, client) = (world.now, &mut world.client);
        match step {
            700 => drop(client.request(now, Command::Identify)),
            1000 => {
                client.request(now, Command::Arm);
                client.stop(now);
            }
            // The robot hears neither, and the session ends.
            1500 => world.is_cut = true,
            1600 => drop(client.request(now, Command::Disarm)),
            1800 => client.stop(now),
            4000 => world.is_cut = false,
            _ => {}
        }
        let due = world.client.transmit_at();
        if let Some(frame) = world.client.transmit(world.now) {
            assert!(due.is_some_and(|at| at <= world.now), "step {step}: {due:?}");
            if !world.is_cut {
                world.to_robot.push((world.now + world.latency, frame.to_vec()));
            }
            while world.client.transmit(world.now).is_some() {}
        }
        let next = world.client.transmit_at();
        assert!(next.is_none_or(|at| at > world.now), "step {step}: {next:?}");
        world.step();
    }
    assert!(world.robot.stopped && world.client.stop_state() == StopState::Acknowledged);
}

fn too_large() -> Command {
    let name = "current_limit".try_into().unwrap();
    Command::Parameter(ParameterCommand::Set(name, 1e6))
}

fn set_current() -> Command {
    let name = "current_limit".try_into().unwrap();
    Command::Parameter(ParameterCommand::Set(name, 0.9))
}

#[test]
fn what_waits_behind_an_insisting_request_is_sent_before_it_is_given_up() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    let set = world.client.request(world.now, set_current());
    world.run(Duration::from_secs(6));
    assert!(world.answer(set).is_some(), "never sent: {:?}", world.updates);
}

#[test]
fn who_disarms_and_arms_at_once_is_driving() {
    let mut world = World::armed();
    world.client.release();
    world.client.request(world.now, Command::Disarm);
    world.run(Duration::from_secs(1));
    assert!(!world.client.is_driving());
    let mut world = World::armed();
    world.client.release();
    world.client.request(world.now, Command::Disarm);
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.state, State::Armed);
    assert!(world.client.is_driving());
}

#[test]
fn who_stops_clears_and_arms_at_once_is_driving() {
    let mut world = World::connected();
    world.client.stop(world.now);
    world.client.insist(world.now, Command::Clear, Duration::from_secs(3));
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.state, State::Armed);
    assert!(world.client.is_driving());
}

#[test]
fn a_robot_that_arms_is_not_said_to_have_refused() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(75);
    world.run(Duration::from_millis(500));
    world.robot.ramps_down_for = 1;
    let arm = world.client.insist(world.now, Command::Arm, Duration::from_millis(50));
    world.run(Duration::from_secs(1));
    let refused = matches!(world.answer(arm), Some(Outcome::Refused(_)));
    assert!(!(refused && world.robot.state == State::Armed), "{:?}", world.updates);
}

#[test]
fn a_second_answer_to_a_request_is_none_to_the_setpoint() {
    let mut world = World::armed();
    world.client.want(world.now, setpoint(-30.0, 30.0));
    world.latency = Duration::from_millis(75);
    world.run(Duration::from_millis(500));
    for _ in 0..3 {
        world.client.request(world.now, too_large());
    }
    world.client.request(world.now, Command::Identify);
    world.run(Duration::from_secs(1));
    let is_refused = |it: &Update| matches!(it, Update::SetpointRefused(_));
    assert!(!world.updates.iter().any(is_refused), "{:?}", world.updates);
}

#[test]
fn what_is_asked_more_than_once_tells_nothing_of_the_link() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(75);
    world.run(Duration::from_secs(1));
    world.robot.ramps_down_for = 5;
    world.client.request(world.now, Command::Identify);
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    world.run(Duration::from_secs(4));
    let statistics = world.client.statistics();
    // Since the latency changed; before, it was 2 ms each way.
    let of_now = statistics.round_trip_quantile(0.5).unwrap();
    assert!(of_now >= 2 * world.latency, "{of_now:?}");
    let odd = (1..100).map(|it| statistics.round_trip_quantile(f64::from(it) / 100.0).unwrap());
    let odd: Vec<_> = odd.filter(|it| (20..140).contains(&it.as_millis())).collect();
    assert_eq!((odd, statistics.unanswered()), (Vec::new(), 0));
}

#[test]
fn a_client_alone_arms_no_robot_that_halted_meanwhile() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    world.run(Duration::from_millis(300));
    world.robot.halt();
    world.run(Duration::from_millis(100));
    world.robot.ramps_down_for = 0;
    world.run(Duration::from_secs(2));
    assert_eq!(world.robot.state, State::Disarmed);
}

#[test]
fn a_repeated_clear_clears_no_fault_that_came_after_it() {
    let mut world = World::armed();
    world.client.stop(world.now);
    world.run(Duration::from_millis(50));
    world.robot.lost_answer = Some(Command::Clear);
    world.client.insist(world.now, Command::Clear, Duration::from_secs(3));
    world.run(Duration::from_millis(50));
    world.robot.fail(Fault::Stall);
    world.run(Duration::from_millis(200));
    assert!(!world.robot.faults.is_empty());
}

/// Every request has had one end, an answer or none.
fn assert_each_ended_once(world: &World, asked: &[u32], seed: u64) {
    for request in asked {
        let ends = world.updates.iter().filter(|it| match it {
            Update::Answer { request: it, .. } | Update::Unanswered { request: it } => {
                it == request
            }
            _ => false,
        });
        assert_eq!(ends.count(), 1, "seed {seed}, request {request}");
    }
}

/// A generator of numbers, enough for a test.
struct Dice(u64);
impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) % sides
    }
}

#[test]
fn every_request_ends_once_and_a_stopped_robot_is_armed_by_nothing_older() {
    for seed in 0..60 {
        let mut dice = Dice(seed);
        let mut world = World::connected();
        world.lose = Box::new(seeded_loss(seed, [0.0, 0.2, 0.5][dice.roll(3) as usize]));
        world.latency = Duration::from_millis([2, 30, 80, 150][dice.roll(4) as usize]);
        let mut asked = Vec::new();
        // How often the robot had been asked to arm when it was asked to stop or to disarm, with no wish to arm it since.
        let mut before = None;
        for _ in 0..dice.roll(12) + 3 {
            world.robot.ramps_down_for = dice.roll(12) as u32;
            let patience = Duration::from_millis([0, 100, 1000, 3000][dice.roll(4) as usize]);
            match dice.roll(9) {
                0..=2 => {
                    asked.push(world.client.insist(world.now, Command::Arm, patience));
                    before = None;
                }
                3 => asked.push(world.client.insist(world.now, Command::Clear, patience)),
                4 => asked.push(world.client.request(world.now, set_current())),
                5 => asked.push(world.client.request(world.now, Command::Identify)),
                6 => {
                    asked.push(world.client.request(world.now, Command::Disarm));
                    let under_way = world.latency + 2 * TICK;
                    world.run(under_way);
                    before = Some(armings(&world));
                }
                7 => {
                    world.client.stop(world.now);
                    let under_way = world.latency + 2 * TICK;
                    world.run(under_way);
                    before = Some(armings(&world));
                }
                _ => world.is_cut = dice.roll(4) == 0,
            }
            if dice.roll(2) == 0 {
                world.run(Duration::from_millis(dice.roll(800)));
            }
        }
        world.is_cut = false;
        world.lose = Box::new(|| false);
        world.run(Duration::from_secs(20));
        assert!(before.is_none_or(|it| it == armings(&world)), "seed {seed}");
        assert_each_ended_once(&world, &asked, seed);
    }
}

#[test]
fn patience_without_end_and_none() {
    let mut world = World::connected();
    world.robot.ramps_down_for = u32::MAX;
    let arm = world.client.insist(world.now, Command::Arm, Duration::MAX);
    world.run(Duration::from_secs(10));
    assert_eq!(world.answer(arm), None);
    world.client.stop(world.now);
    world.run(Duration::from_millis(50));
    assert!(world.robot.stopped);
    assert!(world.updates.contains(&Update::Unanswered { request: arm }));
}

#[test]
fn a_stop_is_not_delayed_by_what_insists() {
    let mut world = World::connected();
    world.robot.ramps_down_for = u32::MAX;
    for _ in 0..5 {
        world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
        world.client.insist(world.now, Command::Clear, Duration::from_secs(3));
    }
    world.run(Duration::from_millis(333));
    world.client.stop(world.now);
    world.run(world.latency + 2 * TICK);
    assert!(world.robot.stopped);
}

/// Has nothing to do.
struct Rests;

impl Helm for Rests {
    fn observe(&mut self, _: &PoseSample) {}
    fn decide(&mut self, _: Instant) -> Decision {
        Decision::Finished
    }
}

/// Both ways are cut for 300 ms just when a robot begins to align its motors: they coast, and it was never driven.
fn ends_after_an_outage(answer_is_lost: bool) -> Ending {
    let mut world = World::connected();
    let mut pilot = Pilot::new(Rests, Vec::new(), None);
    world.robot.aligns_for_ever = true;
    let mut ended = None;
    let mut cut_until = None;
    for _ in 0..40_000 {
        if world.robot.state == State::Aligning && cut_until.is_none() {
            // As the real one: without commands for 250 ms it disarms, and counts that.
            world.is_cut = true;
            if answer_is_lost {
                world.to_client.clear();
            }
            cut_until = Some(world.now + Duration::from_millis(300));
        }
        if cut_until.is_some_and(|at| world.now + Duration::from_millis(50) == at) {
            world.robot.state = State::Disarmed;
            world.robot.aligns_for_ever = false;
            world.robot.halt();
        }
        if cut_until.is_some_and(|at| world.now >= at) {
            world.is_cut = false;
        }
        world.exchange();
        ended = pilot.step(world.now, &mut world.client, &[]);
        if ended.is_some() {
            break;
        }
    }
    ended.unwrap()
}

#[test]
fn a_pilot_arms_again_a_robot_that_let_go_while_it_aligned_whose_answer_came() {
    assert_eq!(ends_after_an_outage(false), Ending::Finished);
}

#[test]
fn a_pilot_arms_again_a_robot_that_let_go_while_it_aligned_whose_answer_was_lost() {
    assert_eq!(ends_after_an_outage(true), Ending::Finished);
}

#[test]
fn older_telemetry_that_was_overtaken_is_no_halt() {
    let mut world = World::connected();
    // A datagram with telemetry from before the fault is delayed.
    let until = world.now + Duration::from_millis(30);
    let mut delayed = Vec::new();
    while world.now < until {
        world.step();
        if delayed.is_empty() && !world.to_client.is_empty() {
            let at = |it: &mut (Instant, Vec<u8>)| it.1.len() > 90;
            delayed.extend(world.to_client.extract_if(.., |it| at(it)).map(|(_, it)| it));
        }
    }
    assert!(!delayed.is_empty());
    world.robot.fail(Fault::Stall);
    world.run(Duration::from_millis(60));
    assert_eq!(world.client.halts(), 1);
    world.robot.ramps_down_for = 2;
    let clear = world.client.insist(world.now, Command::Clear, Duration::from_secs(3));
    world.run(Duration::from_millis(20));
    for datagram in delayed {
        world.client.receive(world.now, &datagram);
    }
    world.run(Duration::from_secs(1));
    assert_eq!(world.answer(clear), Some(&Outcome::Done), "{:?}", world.updates);
}

#[test]
fn what_a_halt_ended_names_the_fault_that_came_and_not_the_stop_that_was_known() {
    let mut world = World::connected();
    world.client.stop(world.now);
    world.run(Duration::from_millis(100));
    world.robot.ramps_down_for = 100;
    let clear = world.client.insist(world.now, Command::Clear, Duration::from_secs(3));
    world.run(Duration::from_millis(100));
    world.robot.fail(Fault::Stall);
    world.run(Duration::from_millis(200));
    let answer = world.answer(clear);
    assert!(matches!(answer, Some(Outcome::Refused(Refusal::Faulted(_)))), "{answer:?}");
}

#[test]
fn nothing_that_insists_is_sent_long_after_its_patience() {
    let mut world = World::connected();
    world.robot.lost = Some(set_current());
    let patience = Duration::from_millis(1_900);
    let set = world.client.insist(world.now, set_current(), patience);
    world.run(Duration::from_millis(1_800));
    world.robot.lost = Some(Command::Disarm);
    let before = count(&world, &set_current());
    world.client.request(world.now, Command::Disarm);
    world.run(Duration::from_millis(700));
    world.robot.lost = None;
    world.run(Duration::from_secs(3));
    assert_eq!(before, count(&world, &set_current()), "{:?} {set}", world.updates);
}

#[test]
fn nothing_wakes_for_ever_nothing_moves_late_and_everything_ends() {
    for seed in 0..60 {
        let mut dice = Dice(seed);
        let mut world = World::connected();
        let loss = [0.0, 0.3, 0.6][dice.roll(3) as usize];
        world.lose = Box::new(seeded_loss(seed, loss));
        world.latency = Duration::from_millis([2, 40, 120][dice.roll(3) as usize]);
        let mut asked = Vec::new();
        let mut dead_at = world.now;
        let mut seen = armings(&world);
        let mut stop_by = None;
        for _ in 0..4000 {
            if dice.roll(150) == 0 {
                world.robot.ramps_down_for = dice.roll(8) as u32;
                let patience = Duration::from_millis([0, 100, 3000][dice.roll(3) as usize]);
                match dice.roll(9) {
                    0 | 1 => {
                        asked.push(world.client.insist(world.now, Command::Arm, patience));
                        dead_at = dead_at.max(world.now + patience.max(REQUEST_PATIENCE));
                    }
                    2 => asked.push(world.client.insist(world.now, Command::Clear, patience)),
                    3 => asked.push(world.client.request(world.now, set_current())),
                    4 => {
                        asked.push(world.client.request(world.now, Command::Disarm));
                        let by = world.now + world.latency + 2 * TICK;
                        let before = count(&world, &Command::Disarm);
                        let is_sent =
                            loss == 0.0 && world.client.stop_state() != StopState::Sending;
                        stop_by = is_sent.then_some((by, before, Command::Disarm));
                    }
                    5 => world.robot.halt(),
                    6 => world.robot.fail(Fault::Stall),
                    7 => asked.push(world.client.request(world.now, Command::Identify)),
                    _ => {
                        world.client.stop(world.now);
                        let by = world.now + world.latency + 2 * TICK;
                        let before = count(&world, &Command::Stop);
                        stop_by = (loss == 0.0).then_some((by, before, Command::Stop));
                    }
                }
            }
            if let Some((_, before, command)) = stop_by.take_if(|it| world.now > it.0) {
                assert!(count(&world, &command) > before, "seed {seed}: {command:?} is delayed");
            }
            world.step();
            if armings(&world) != seen {
                seen = armings(&world);
                assert!(world.now <= dead_at + world.latency + 2 * TICK, "seed {seed}: late");
            }
            let after = world.now;
            let mut many = 0;
            for _ in 0..2 {
                while world.client.transmit(after).is_some() {
                    many += 1;
                    assert!(many < 50, "seed {seed}: sends for ever");
                }
            }
            let at = world.client.transmit_at();
            assert!(at.is_none_or(|at| at > after), "seed {seed}: {at:?} at {after:?}");
        }
        world.lose = Box::new(|| false);
        world.run(Duration::from_secs(30));
        assert_each_ended_once(&world, &asked, seed);
    }
}

#[test]
fn what_a_disarm_overtook_does_not_keep_the_robot_from_being_armed() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    world.client.insist(world.now, Command::Arm, Duration::from_secs(3));
    let set = world.client.request(world.now, set_current());
    world.run(Duration::from_millis(50));
    world.robot.ramps_down_for = 0;
    world.client.request(world.now, Command::Disarm);
    world.client.request(world.now, Command::Arm);
    world.run(Duration::from_secs(4));
    assert_eq!(world.robot.state, State::Armed, "{set}: {:?}", world.updates);
}
