//! The client's promises, in virtual time against a robot's end of the link.
use std::net::SocketAddr;
use std::time::Duration;

use crate::support::{FakeRobot, key, seeded_loss};
use flix_host::link::{
    Client, DISARMED_AFTER, KEEP_ALIVE, NotTaken, PASSING_PATIENCE, REQUEST_PATIENCE, SILENCE,
    STOP_BESIDE_AFTER, StopState, Update, Wish,
};
use flix_host::nav::Decision;
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_host::pose::PoseSample;
use flix_protocol::message::{
    Command, Fault, Halt, Order, Outcome, ParameterCommand, Pattern, Refusal, Setpoint, State,
    ToRobot, Trial,
};
use flix_protocol::session::{ConnectError, StopSession};
use flix_protocol::units::Instant;

const OPERATOR: &str = "10.0.0.1:5000";
const TICK: Duration = Duration::from_millis(1);

/// Operator and robot, with a network between them that is late and loses.
pub struct World {
    pub now: Instant,
    pub client: Client,
    pub robot: FakeRobot,
    /// From where the robot hears the client.
    address: SocketAddr,
    latency: Duration,
    lose: Box<dyn FnMut() -> bool>,
    is_cut: bool,
    /// Of two datagrams that leave within so long, the robot hears the later first.
    overtaking: Duration,
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
            address: OPERATOR.parse().unwrap(),
            latency: Duration::from_millis(5),
            lose: Box::new(|| false),
            is_cut: false,
            overtaking: Duration::ZERO,
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
        world.press(Wish::Arm);
        world.run(Duration::from_millis(50));
        assert_eq!(world.robot.state, State::Armed);
        world
    }

    fn walking() -> Self {
        let mut world = Self::armed();
        world.client.want(world.now, setpoint(-30.0, 30.0));
        world.run(Duration::from_millis(50));
        assert_eq!(world.robot.state, State::Running);
        world
    }

    fn press(&mut self, wish: Wish) {
        self.client.press(self.now, wish).unwrap();
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
        while let Some(frame) = self.client.transmit(self.now) {
            if self.is_cut || (self.lose)() {
                continue;
            }
            let arrival = self.now + self.latency;
            for (earlier, _) in &mut self.to_robot {
                if arrival.since(*earlier) < self.overtaking {
                    *earlier = arrival + TICK;
                }
            }
            self.to_robot.push((arrival, frame.to_vec()));
        }
        let mut answers = self.robot.tick(self.now);
        for datagram in arrived(&mut self.to_robot, self.now) {
            answers.extend(self.robot.receive(self.now, self.address, &datagram));
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

    /// Why each wish ended.
    fn endings(&self) -> Vec<(Order, Option<Refusal>)> {
        let ended = |update: &Update| match update {
            Update::Ended { order, why } => Some((*order, why.clone())),
            _ => None,
        };
        self.updates.iter().filter_map(ended).collect()
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
    let before = world.robot.orders;
    world.client.hold(world.now, setpoint(-30.0, 30.0));
    world.run(Duration::from_secs(1));
    let orders = world.robot.orders - before;
    let expected = usize::try_from(Duration::from_secs(1).as_millis() / KEEP_ALIVE.as_millis());
    assert!(orders.abs_diff(expected.unwrap()) <= 1, "{orders} orders in a second");
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
fn a_request_that_an_order_overtakes_is_asked_again_between_orders() {
    for phase in 0..20 {
        let mut world = World::connected();
        world.overtaking = Duration::from_millis(4);
        world.run(Duration::from_millis(phase));
        let request = world.client.request(world.now, Command::Identify);
        world.run(Duration::from_millis(300));
        assert!(world.answer(request).is_some(), "{phase} ms");
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
    let at = world.robot.stopped_at;
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.stopped_at, at);
    assert_eq!(world.robot.messages.last(), Some(&ToRobot::Order(Order::Off)));
}

#[test]
fn a_robot_that_was_disarmed_is_not_armed_by_what_was_asked_before() {
    let mut world = World::connected();
    world.press(Wish::Arm);
    world.run(2 * TICK);
    let delayed: Vec<_> = world.to_robot.drain(..).map(|(_, datagram)| datagram).collect();
    assert!(!delayed.is_empty());
    world.client.disarm(world.now);
    world.run(Duration::from_millis(100));
    for datagram in delayed {
        world.robot.receive(world.now, OPERATOR.parse().unwrap(), &datagram);
    }
    world.run(Duration::from_secs(1));
    assert_eq!((world.robot.state, armings(&world)), (State::Disarmed, 0));
}

/// Counts how often the robot was ordered to arm.
fn armings(world: &World) -> usize {
    let is_arm = |it: &&ToRobot| matches!(it, ToRobot::Order(Order::Arm(_)));
    world.robot.messages.iter().filter(is_arm).count()
}

#[test]
fn what_a_robot_cannot_do_yet_is_done_once_it_can() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 10;
    world.press(Wish::Arm);
    world.run(Duration::from_millis(100));
    assert_eq!(world.robot.state, State::Disarmed);
    world.run(Duration::from_millis(300));
    assert_eq!((world.robot.state, armings(&world)), (State::Armed, 1));
    assert_eq!(world.endings(), []);
}

#[test]
fn wishes_of_a_person_end_in_time_with_what_was_said_last() {
    let mut world = World::connected();
    world.robot.is_unproven = true;
    world.press(Wish::Arm);
    let order = world.client.order();
    world.run(PASSING_PATIENCE - TICK);
    assert_eq!((world.client.order(), world.endings()), (order, Vec::new()));
    world.run(2 * TICK);
    assert_eq!(world.endings(), [(order, Some(Refusal::LinkUnproven))]);
    world.robot.is_unproven = false;
    world.run(Duration::from_secs(1));
    assert_eq!((world.robot.state, world.client.order()), (State::Disarmed, Order::Off));
}

#[test]
fn a_wish_that_the_robot_never_heard_ends_without_a_reason() {
    let mut world = World::connected();
    world.robot.loses = |it| matches!(it, ToRobot::Order(Order::Arm(_)));
    world.press(Wish::Arm);
    let order = world.client.order();
    world.run(PASSING_PATIENCE + TICK);
    assert_eq!(world.endings(), [(order, None)]);
}

#[test]
fn a_wish_ends_at_once_for_what_does_not_pass() {
    let stops: fn(&mut World) = World::stop_from_outside;
    let fails: fn(&mut World) = |it| it.robot.fail(Fault::Stall);
    for (comes, is_so) in [
        (stops, (|it| *it == Refusal::Stopped) as fn(&Refusal) -> bool),
        (fails, |it| matches!(it, Refusal::Faulted(_))),
    ] {
        let mut world = World::connected();
        comes(&mut world);
        world.run(Duration::from_millis(50));
        world.press(Wish::Arm);
        world.run(Duration::from_millis(50));
        let endings = world.endings();
        assert!(matches!(&endings[..], [(Order::Arm(_), Some(why))] if is_so(why)), "{endings:?}");
        assert_eq!(world.client.order(), Order::Off);
    }
}

fn is_asked(message: &ToRobot, expected: &Command) -> bool {
    matches!(message, ToRobot::Request(request) if request.command == *expected)
}

#[test]
fn settings_that_nothing_is_armed_with_are_named() {
    let mut world = World::connected();
    world.robot.minds_settings = true;
    world.press(Wish::Arm);
    world.run(Duration::from_millis(100));
    let name = "pole_pairs".try_into().unwrap();
    let endings = world.endings();
    assert!(
        matches!(&endings[..], [(Order::Arm(_), Some(why))] if *why == Refusal::Assumed { name }),
        "{endings:?}"
    );
    let is_check = |it: &&ToRobot| is_asked(it, &Command::Parameter(ParameterCommand::Check));
    assert_eq!(world.robot.messages.iter().filter(is_check).count(), 1);
    // Nobody asked for that answer.
    assert!(!world.updates.iter().any(|it| matches!(it, Update::Answer { .. })));
}

#[test]
fn a_wish_is_refused_before_the_robot_has_stated_its_permit() {
    let wishes = [Wish::Arm, Wish::Shake(setpoint(10.0, 0.0)), Wish::Clear];
    let mut world = World::new();
    world.robot.is_mute = true;
    let assert_refused = |world: &mut World| {
        for wish in wishes {
            assert_eq!(world.client.press(world.now, wish), Err(NotTaken::NotShown));
        }
    };
    assert_refused(&mut world);
    world.run(Duration::from_millis(200));
    assert!(world.client.is_connected(world.now));
    assert_refused(&mut world);
    world.robot.is_mute = false;
    world.run(Duration::from_millis(50));
    world.press(Wish::Arm);
    // Nothing of it outlives the session.
    world.is_cut = true;
    world.run(Duration::from_millis(1_500));
    assert_refused(&mut world);
    world.is_cut = false;
    world.run(Duration::from_secs(1));
    assert_eq!((world.robot.state, world.client.order()), (State::Disarmed, Order::Off));
}

#[test]
fn an_idle_client_says_off() {
    let mut world = World::connected();
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.messages, [ToRobot::Order(Order::Off)]);
    assert!(world.robot.orders > 45);
}

#[test]
fn a_robot_is_disarmed_by_a_client_that_wants_nothing() {
    let mut world = World::armed();
    world.client.disarm(world.now);
    world.run(Duration::from_millis(50));
    assert_eq!(world.robot.state, State::Disarmed);
}

#[test]
fn who_clears_where_nothing_is_latched_says_off_alone() {
    let mut world = World::connected();
    world.press(Wish::Clear);
    world.run(Duration::from_millis(200));
    assert_eq!(world.robot.messages, [ToRobot::Order(Order::Off)]);
    assert_eq!(world.endings(), []);
    // A walk goes on.
    let mut world = World::walking();
    world.press(Wish::Clear);
    world.run(Duration::from_millis(200));
    assert_eq!(world.robot.state, State::Running);
}

#[test]
fn a_permit_is_as_old_as_the_first_telemetry_that_states_it() {
    let mut world = World::connected();
    let first = world.client.permitted_at();
    world.run(Duration::from_secs(1));
    assert_eq!(world.client.permitted_at(), first);
    let halted = world.now;
    world.robot.halt();
    world.run(Duration::from_millis(500));
    let stated = world.client.permitted_at().since(halted);
    assert!((1..100).contains(&stated.as_millis()), "{stated:?}");
}

#[test]
fn a_walk_whose_permit_is_old_becomes_rest_and_that_is_told() {
    let mut world = World::walking();
    let walk = world.client.order();
    world.robot.halt();
    world.run(Duration::from_millis(50));
    let rest = setpoint(0.0, 30.0);
    assert_eq!(world.endings(), [(walk, Some(Refusal::Rested))]);
    assert_eq!(world.client.held(), Some(rest));
    world.run(Duration::from_secs(2));
    assert_eq!((world.robot.state, world.robot.setpoint), (State::Armed, Setpoint::REST));
    assert_eq!(world.endings().len(), 1);
}

#[test]
fn a_stop_is_acknowledged_only_by_a_robot_that_had_heard_it() {
    let mut world = World::connected();
    world.stop_from_outside();
    world.run(Duration::from_millis(100));
    assert!(world.client.telemetry().unwrap().stopped);
    world.robot.is_deaf = true;
    world.client.stop(world.now);
    world.run(Duration::from_millis(500));
    assert_eq!(world.client.stop_state(), StopState::Sending);
    world.robot.is_deaf = false;
    world.run(Duration::from_millis(100));
    assert_eq!(world.client.stop_state(), StopState::Acknowledged);
}

#[test]
fn nothing_else_is_pressed_until_a_stop_is_acknowledged() {
    let mut world = World::walking();
    world.client.stop(world.now);
    for wish in [Wish::Arm, Wish::Shake(setpoint(10.0, 0.0)), Wish::Clear] {
        assert_eq!(world.client.press(world.now, wish), Err(NotTaken::Stopping));
    }
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.client.disarm(world.now);
    assert_eq!(world.client.order(), Order::Stop);
    world.run(Duration::from_millis(100));
    assert!(world.robot.stopped);
    world.press(Wish::Clear);
}

#[test]
fn what_is_given_up_is_ordered_no_more() {
    let cannot: [fn(&mut FakeRobot); 3] = [
        |it| it.is_unproven = true,
        |it| it.ramps_down_for = 10,
        |it| (it.stopped, it.ramps_down_for) = (true, 10),
    ];
    for (place, cannot) in cannot.into_iter().enumerate() {
        let mut world = World::connected();
        cannot(&mut world.robot);
        world.run(Duration::from_millis(50));
        let stopped = world.robot.stopped;
        world.press(if stopped { Wish::Clear } else { Wish::Arm });
        let question = world.client.request(world.now, Command::Identify);
        world.run(Duration::from_millis(100));
        world.client.give_up(world.now);
        world.robot.is_unproven = false;
        world.run(Duration::from_secs(1));
        let state = (world.robot.state, world.robot.stopped);
        assert_eq!(state, (State::Disarmed, stopped), "{place}");
        assert!(world.answer(question).is_some());
    }
}

#[test]
fn who_gives_up_what_the_robot_has_done_changes_nothing() {
    let mut world = World::walking();
    world.client.give_up(world.now);
    world.run(Duration::from_millis(100));
    assert_eq!(world.robot.state, State::Running);
}

#[test]
fn what_is_never_answered_is_given_up_while_the_session_stands() {
    let mut world = World::connected();
    world.robot.loses = |it| is_asked(it, &Command::Identify);
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
        let is_set = |it: &&ToRobot| [2.4, 0.9].iter().any(|value| is_asked(it, &set(*value)));
        let sets: Vec<_> = world.robot.messages.iter().filter(is_set).collect();
        assert!(sets.is_sorted_by_key(|it| is_asked(it, &set(0.9))), "{seed}: {sets:?}");
    }
}

#[test]
fn nothing_that_was_asked_before_a_stop_from_outside_clears_it() {
    let mut world = World::armed();
    world.client.stop(world.now);
    world.run(Duration::from_millis(50));
    world.press(Wish::Clear);
    let clear = world.client.order();
    world.run(2 * TICK);
    world.stop_from_outside();
    world.run(Duration::from_secs(1));
    assert_eq!(world.endings(), [(clear, Some(Refusal::Stopped))]);
    assert!(world.robot.stopped);
}

#[test]
fn who_knows_of_a_stop_clears_it() {
    let mut world = World::connected();
    for stop in [|it: &mut World| it.client.stop(it.now), World::stop_from_outside] {
        stop(&mut world);
        world.run(Duration::from_millis(100));
        world.press(Wish::Clear);
        world.run(Duration::from_millis(100));
        assert!(!world.robot.stopped);
        assert_eq!((world.client.order(), world.endings()), (Order::Off, Vec::new()));
    }
}

#[test]
fn who_asked_to_arm_is_driving_until_the_robot_has_answered() {
    let mut world = World::new();
    while world.client.press(world.now, Wish::Arm).is_err() {
        world.step();
    }
    // Also where telemetry states the robot as it was before, and until its link is proven.
    while world.robot.state != State::Armed {
        assert!(world.client.is_driving());
        world.step();
    }
    world.client.disarm(world.now);
    world.run(Duration::from_millis(100));
    assert!(!world.client.is_driving());
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
    for (state, is_driven) in [(State::Disarmed, false), (State::Stopping, true)] {
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
fn what_was_asked_before_the_first_session_clears_no_stop_that_came_meanwhile() {
    let mut world = World::new();
    world.is_cut = true;
    world.run(Duration::from_millis(300));
    assert_eq!(world.client.press(world.now, Wish::Clear), Err(NotTaken::NotShown));
    world.stop_from_outside();
    world.is_cut = false;
    world.run(Duration::from_millis(1_500));
    assert!(world.robot.stopped);
    // Who has been shown it clears it.
    world.press(Wish::Clear);
    world.run(Duration::from_millis(100));
    assert!(!world.robot.stopped);
}

#[test]
fn a_person_who_wants_the_same_again_is_heard_at_once_and_a_program_that_holds_it_is_not() {
    let mut world = World::armed();
    let walk = setpoint(-30.0, 30.0);
    for _ in 0..3 {
        world.client.want(world.now, walk);
        world.run(2 * world.latency + TICK);
        assert_eq!(world.robot.setpoint, walk);
        // Commands stay away, and the rotors come to rest.
        world.robot.is_deaf = true;
        world.run(Duration::from_millis(300));
        world.robot.is_deaf = false;
        for _ in 0..10 {
            world.client.hold(world.now, walk);
            world.run(Duration::from_millis(20));
            assert_eq!(world.robot.setpoint, Setpoint::REST);
        }
    }
}

#[test]
fn a_walk_or_a_rest_behind_a_disarm_that_is_lost_undoes_no_disarm() {
    for wish in [setpoint(20.0, 0.0), Setpoint::REST] {
        let mut world = World::walking();
        world.is_cut = true;
        world.client.disarm(world.now);
        world.run(Duration::from_millis(30));
        let refused = (wish != Setpoint::REST).then_some(NotTaken::Disarming);
        assert_eq!(world.client.press(world.now, Wish::Shake(wish)).err(), refused);
        world.is_cut = false;
        world.run(Duration::from_millis(200));
        assert_eq!(world.robot.state, State::Disarmed);
    }
}

#[test]
fn a_robot_that_halted_while_it_was_armed_walks_after_enter() {
    let mut world = World::armed();
    world.robot.halt();
    world.run(Duration::from_millis(50));
    world.press(Wish::Arm);
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.run(Duration::from_millis(50));
    assert_eq!((world.robot.state, world.endings()), (State::Running, Vec::new()));
}

#[test]
fn arming_a_robot_that_walks_lets_it_walk_on() {
    let mut world = World::armed();
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.run(Duration::from_millis(100));
    world.press(Wish::Arm);
    world.run(Duration::from_millis(100));
    assert_eq!(
        (world.robot.state, world.client.held()),
        (State::Running, Some(setpoint(10.0, 0.0)))
    );
}

#[test]
fn a_program_that_steers_on_after_a_halt_is_told_of_it_once() {
    let mut world = World::armed();
    world.client.hold(world.now, setpoint(10.0, 0.0));
    world.run(Duration::from_millis(100));
    world.robot.halt();
    for direction in 0..20_u8 {
        world.client.hold(world.now, setpoint(10.0, direction.into()));
        world.run(Duration::from_millis(50));
    }
    assert_eq!(world.endings().len(), 1, "{:?}", world.endings());
}

#[test]
fn a_trial_of_an_armed_robot_that_is_given_up_is_not_done() {
    let mut world = World::armed();
    let pattern = Pattern::Halve(10);
    let trial = Trial { motors: [true; 2], current_ma: 500, angle: 0, pattern, ticks: 100 };
    world.press(Wish::Try(trial));
    world.client.give_up(world.now);
    assert_eq!(world.client.order(), Order::Off);
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
fn a_client_with_another_address_waits_until_its_own_session_ends() {
    let mut world = World::walking();
    world.robot.is_mute = true;
    world.run(Duration::from_millis(600));
    world.robot.is_mute = false;
    world.address = "10.0.0.9:5000".parse().unwrap();
    world.updates.clear();
    // Of these a second is the silence by which the robot knows that the holder is gone.
    world.run(Duration::from_millis(1_500));
    assert!(world.client.is_connected(world.now));
    assert!(!world.updates.iter().any(|it| matches!(it, Update::Failed(_))), "{:?}", world.updates);
    assert_eq!((world.robot.state, world.client.order()), (State::Disarmed, Order::Off));
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
fn round_trips_are_measured_and_losses_counted() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(20);
    world.run(Duration::from_secs(30));
    let half = world.client.statistics().round_trip_quantile(0.5).unwrap();
    assert!(half.abs_diff(Duration::from_millis(40)) <= 3 * TICK, "{half:?}");
    assert!(world.client.statistics().loss() < 1e-9);

    world.lose = Box::new(seeded_loss(1, 0.1));
    let counted = |world: &World| {
        let statistics = world.client.statistics();
        [statistics.orders(), statistics.answered()].map(|it| it as f64)
    };
    let before = counted(&world);
    world.run(Duration::from_secs(60));
    let after = counted(&world);
    let lost = 1.0 - (after[1] - before[1]) / (after[0] - before[0]);
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
    let orders = world.robot.orders;
    world.run(Duration::from_secs(5));
    assert_eq!(world.robot.orders, orders);
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
    // It tries again when that is asked of it, and not before.
    world.is_cut = false;
    world.run(Duration::from_secs(10));
    assert!(!world.client.is_connected(world.now));
    world.client.connect(world.now);
    world.run(Duration::from_millis(600));
    assert!(world.client.is_connected(world.now));
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
                client.press(now, Wish::Arm).unwrap();
                client.stop(now);
            }
            // The robot hears neither, and the session ends.
            1500 => world.is_cut = true,
            1600 => drop(client.request(now, set_current())),
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

fn set_current() -> Command {
    let name = "current_limit".try_into().unwrap();
    Command::Parameter(ParameterCommand::Set(name, 0.9))
}

#[test]
fn who_disarms_and_arms_at_once_is_driving() {
    let mut world = World::armed();
    world.client.disarm(world.now);
    world.run(Duration::from_secs(1));
    assert!(!world.client.is_driving());
    for between in [Duration::ZERO, 2 * TICK, Duration::from_millis(7)] {
        let mut world = World::armed();
        world.client.disarm(world.now);
        world.run(between);
        world.press(Wish::Arm);
        world.run(Duration::from_secs(1));
        assert_eq!(world.robot.state, State::Armed, "{between:?}");
        assert!(world.client.is_driving());
    }
}

#[test]
fn who_stops_clears_and_arms_at_once_is_driving() {
    let mut world = World::connected();
    world.client.stop(world.now);
    world.run(Duration::from_millis(20));
    for wish in [Wish::Clear, Wish::Arm] {
        let is_there = |world: &World| match wish {
            Wish::Clear => !world.robot.stopped,
            _ => world.robot.state == State::Armed,
        };
        while !is_there(&world) {
            if world.client.order() == Order::Off {
                world.press(wish);
            }
            world.step();
        }
    }
    world.run(Duration::from_secs(1));
    assert_eq!(world.robot.state, State::Armed);
    assert!(world.client.is_driving());
}

#[test]
fn what_is_asked_more_than_once_tells_nothing_of_the_link() {
    let mut world = World::connected();
    world.latency = Duration::from_millis(75);
    world.run(Duration::from_secs(1));
    world.robot.ramps_down_for = 5;
    world.client.request(world.now, Command::Identify);
    world.press(Wish::Arm);
    world.run(Duration::from_secs(4));
    let statistics = world.client.statistics();
    // Since the latency changed; before, it was 2 ms each way.
    let of_now = statistics.round_trip_quantile(0.5).unwrap();
    assert!(of_now >= 2 * world.latency, "{of_now:?}");
    let odd = (1..100).map(|it| statistics.round_trip_quantile(f64::from(it) / 100.0).unwrap());
    let odd: Vec<_> = odd.filter(|it| (20..140).contains(&it.as_millis())).collect();
    assert_eq!((odd, statistics.loss()), (Vec::new(), 0.0));
}

#[test]
fn a_client_alone_arms_no_robot_that_halted_meanwhile() {
    let mut world = World::connected();
    world.robot.ramps_down_for = 100;
    world.press(Wish::Arm);
    let arm = world.client.order();
    world.run(Duration::from_millis(300));
    world.robot.halt();
    world.run(Duration::from_millis(100));
    world.robot.ramps_down_for = 0;
    world.run(Duration::from_secs(2));
    assert_eq!(world.robot.state, State::Disarmed);
    assert_eq!(world.endings(), [(arm, Some(Refusal::Rested))]);
}

#[test]
fn a_repeated_clear_clears_no_fault_that_came_after_it() {
    let mut world = World::armed();
    world.client.stop(world.now);
    world.run(Duration::from_millis(50));
    world.robot.is_mute = true;
    world.press(Wish::Clear);
    world.run(Duration::from_millis(50));
    assert!(!world.robot.stopped);
    world.robot.fail(Fault::Stall);
    world.run(Duration::from_millis(200));
    world.robot.is_mute = false;
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
        // Whether the robot was to stop or disarm, with no wish to arm it since.
        let mut is_off = false;
        for _ in 0..dice.roll(12) + 3 {
            world.robot.ramps_down_for = dice.roll(12) as u32;
            match dice.roll(9) {
                0..=2 => is_off &= world.client.press(world.now, Wish::Arm).is_err(),
                3 => drop(world.client.press(world.now, Wish::Clear)),
                4 => asked.push(world.client.request(world.now, set_current())),
                5 => asked.push(world.client.request(world.now, Command::Identify)),
                6 => {
                    world.client.disarm(world.now);
                    is_off = true;
                }
                7 => {
                    world.client.stop(world.now);
                    is_off = true;
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
        assert!(!is_off || world.robot.state == State::Disarmed, "seed {seed}");
        assert_each_ended_once(&world, &asked, seed);
    }
}

#[test]
fn a_stop_is_not_delayed_by_what_insists() {
    let mut world = World::connected();
    world.robot.ramps_down_for = u32::MAX;
    let asked: Vec<_> = (0..5).map(|_| world.client.request(world.now, set_current())).collect();
    world.press(Wish::Arm);
    world.client.stop(world.now);
    world.run(world.latency + 2 * TICK);
    assert!(world.robot.stopped);
    assert_eq!(armings(&world), 0);
    assert_each_ended_once(&world, &asked, 0);
}

/// Has nothing to do.
struct Rests;

impl Helm for Rests {
    fn observe(&mut self, _: &PoseSample) {}
    fn decide(&mut self, _: Instant) -> Decision {
        Decision::Finished
    }
}

#[test]
fn a_pilot_arms_again_a_robot_that_let_go_while_it_aligned() {
    let mut world = World::connected();
    let mut pilot = Pilot::new(Rests, Vec::new(), None);
    world.robot.aligns_for_ever = true;
    let mut cut_until = None;
    let mut ended = None;
    for _ in 0..40_000 {
        if world.robot.state == State::Aligning && cut_until.is_none() {
            // Both ways are cut: its motors coast, and it was never driven.
            world.is_cut = true;
            cut_until = Some(world.now + Duration::from_millis(300));
        }
        if world.is_cut && cut_until.is_some_and(|at| world.now >= at) {
            assert_eq!(world.robot.halted_by, Halt::LetGo);
            world.robot.aligns_for_ever = false;
            world.is_cut = false;
        }
        world.exchange();
        ended = pilot.step(world.now, &mut world.client, &[]);
        if ended.is_some() {
            break;
        }
    }
    assert_eq!(ended, Some(Ending::Finished));
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
    world.robot.ramps_down_for = 10;
    world.press(Wish::Clear);
    world.run(Duration::from_millis(20));
    for datagram in delayed {
        world.client.receive(world.now, &datagram);
    }
    world.run(Duration::from_secs(1));
    assert_eq!((world.robot.faults.is_empty(), world.endings()), (true, Vec::new()));
}

#[test]
fn what_a_halt_ended_names_the_fault_that_came_and_not_the_stop_that_was_known() {
    let mut world = World::connected();
    world.client.stop(world.now);
    world.run(Duration::from_millis(100));
    world.robot.ramps_down_for = 100;
    world.press(Wish::Clear);
    world.run(Duration::from_millis(100));
    world.robot.fail(Fault::Stall);
    world.run(Duration::from_millis(200));
    let endings = world.endings();
    assert!(matches!(&endings[..], [(Order::Clear(_), Some(Refusal::Faulted(_)))]), "{endings:?}");
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
        let mut was_armed = false;
        let mut stop_by = None;
        for _ in 0..4000 {
            if dice.roll(150) == 0 {
                world.robot.is_unproven = dice.roll(3) == 0;
                match dice.roll(9) {
                    0 | 1 => {
                        let is_pressed = world.client.press(world.now, Wish::Arm).is_ok();
                        dead_at = if is_pressed { world.now + PASSING_PATIENCE } else { dead_at };
                    }
                    2 => drop(world.client.press(world.now, Wish::Clear)),
                    3 => asked.push(world.client.request(world.now, set_current())),
                    4 => world.client.disarm(world.now),
                    5 => world.robot.halt(),
                    6 => world.robot.fail(Fault::Stall),
                    7 => asked.push(world.client.request(world.now, Command::Identify)),
                    _ => {
                        world.client.stop(world.now);
                        let by = world.now + world.latency + 2 * TICK;
                        stop_by = (loss == 0.0).then_some((by, world.now));
                    }
                }
            }
            if let Some((_, asked)) = stop_by.take_if(|it| world.now > it.0) {
                let is_heard = world.robot.stopped_at.is_some_and(|at| at >= asked);
                assert!(is_heard, "seed {seed}: a stop is delayed");
            }
            world.step();
            let is_armed = world.robot.state == State::Armed;
            if is_armed && !was_armed {
                assert!(world.now <= dead_at + world.latency + 2 * TICK, "seed {seed}: late");
            }
            was_armed = is_armed;
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
