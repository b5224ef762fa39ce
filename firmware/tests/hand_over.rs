//! What crosses between the two halves, as on a chip: each half gets its turns when the test says so, and the
//! slow half may work from an old report.

use core::net::SocketAddr;

use crate::no_store::NoStore;
use crate::still::AT_REST;
use flix_firmware::alignment::Alignment;
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::configuration::Configuration;
use flix_firmware::fast::exchange::{Access, Exchange, Report};
use flix_firmware::hardware::{Actuation, Bridge, TICK};
use flix_firmware::robot::{FastHalf, SlowHalf, halves};
use flix_firmware::scope::Memory;
use flix_firmware::units::ElectricalAngle;
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Channel, Command, Event, LoopTiming, Outcome, ParameterCommand, Refusal, SCOPE_VALUES,
    ScopeCommand, ScopePlan, ScopeState, State, ToOperator, ToRobot, Trigger,
};
use flix_protocol::session::{Key, OperatorReceived, OperatorSession, Status};
use flix_protocol::units::Instant;

/// Ticks from one ping to the next: 20 ms.
const PING_TICKS: u32 = 200;

/// Two halves, what crosses between them, and an operator.
struct Halves {
    fast: FastHalf,
    slow: SlowHalf<NoStore>,
    exchange: Exchange,
    operator: OperatorSession,
    address: SocketAddr,
    now: Instant,
    request: u32,
    outcome: Option<Outcome>,
    events: Vec<Event>,
    actuation: Actuation,
}

impl Halves {
    /// Connected in this very moment, nothing exchanged since.
    fn connected() -> Self {
        let (fast, slow, report) =
            halves(DENGFOC_V3_01.hardware, "halves", Some(key()), [11; 32], NoStore);
        let exchange = Exchange::new(report, [0; SCOPE_VALUES]);
        let now = Instant::from_micros(1_000);
        let mut halves = Self {
            fast,
            slow,
            exchange,
            operator: OperatorSession::new(key(), [22; 32], now),
            address: ([192, 168, 4, 2], 4_000).into(),
            now,
            request: 0,
            outcome: None,
            events: Vec::new(),
            actuation: Actuation::OFF,
        };
        halves.tick(100);
        halves.exchange();
        halves.connect();
        halves
    }

    /// With a link steady for long enough to arm.
    fn proven() -> Self {
        let mut halves = Self::connected();
        halves.live(6_000);
        halves
    }

    /// Being aligned, and the slow half knows it.
    fn aligning() -> Self {
        let mut halves = Self::proven();
        assert_eq!(halves.say(Command::Arm), Outcome::Done);
        halves.live(PING_TICKS);
        assert_eq!(halves.slow.report().state, State::Aligning);
        halves
    }

    fn connect(&mut self) {
        while self.operator.status(self.now) != Status::Connected {
            if let Some(frame) = self.operator.poll(self.now) {
                self.hear(&frame);
            }
        }
    }

    /// Another operator, of whom the robot knows nothing yet, from the same address.
    fn change_operator(&mut self) {
        self.operator = OperatorSession::new(key(), [self.request as u8; 32], self.now);
    }

    /// The slow half takes a datagram, the operator what comes back. Nothing crosses.
    fn hear(&mut self, datagram: &[u8]) {
        self.slow.receive(self.now, self.address, datagram);
        let mut frame = Frame::new();
        while self.slow.poll_at(self.now).is_some_and(|at| at <= self.now) {
            if self.slow.transmit(self.now, &mut frame).is_none() {
                break;
            }
            match self.operator.receive(self.now, &frame) {
                OperatorReceived::Message(ToOperator::Reply(reply)) => {
                    self.outcome = Some(reply.outcome);
                }
                OperatorReceived::Message(ToOperator::Event(event)) => {
                    self.events.push(event.event);
                }
                _ => {}
            }
        }
    }

    /// Returns the operator's next datagram.
    fn seal(&mut self, command: Command) -> Frame {
        self.request += 1;
        let message = ToRobot { request: self.request, intent: 0, halts: 0, command };
        self.operator.send(self.now, &message).unwrap()
    }

    fn say(&mut self, command: Command) -> Outcome {
        let frame = self.seal(command);
        self.hear(&frame);
        self.outcome.take().expect("every command is answered at once")
    }

    fn set(&mut self, name: &str, value: f32) {
        let command = ParameterCommand::Set(name.try_into().unwrap(), value);
        let outcome = self.say(Command::Parameter(command));
        assert!(matches!(outcome, Outcome::Parameter(_)), "{outcome:?}");
    }

    fn exchange(&mut self) {
        self.slow.exchange(&mut self.exchange);
    }

    /// The fast half alone.
    fn tick(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.now = self.now + TICK;
            self.actuation = self.fast.tick(self.now, &AT_REST, &mut self.exchange);
        }
    }

    /// Both halves, with pings.
    fn live(&mut self, ticks: u32) {
        for _ in 0..ticks / PING_TICKS {
            self.say(Command::Ping(0));
            self.exchange();
            self.tick(PING_TICKS);
            self.exchange();
        }
    }

    /// How the fast half was when it last reported, which the slow half need not know.
    fn reported(&self) -> &Report {
        self.exchange.newest_report()
    }
}

/// An exchange between two cores.
#[derive(Clone)]
struct Shared(loom::sync::Arc<loom::sync::Mutex<Exchange>>);

impl Access for Shared {
    type Memory = Memory;

    fn with<R>(&mut self, access: impl FnOnce(&mut Exchange) -> R) -> R {
        access(&mut self.0.lock().unwrap())
    }
}

fn key() -> Key {
    Key::new([7; 32])
}

/// The duties well into the alignment of a robot whose motors have this resistance by the time when
/// `Halves` is given to `arm`; the voltage that turns the rotors follows from it.
fn duties_while_aligning(arm: impl FnOnce(&mut Halves)) -> Actuation {
    let mut halves = Halves::proven();
    arm(&mut halves);
    assert_eq!(halves.say(Command::Arm), Outcome::Done);
    halves.exchange();
    halves.live(3_000);
    let report = halves.reported();
    assert_eq!(report.state, State::Aligning, "{:?}", report.first_fault);
    halves.actuation
}

#[test]
fn a_configuration_is_in_force_before_the_order_that_came_with_it() {
    let set = |halves: &mut Halves| halves.set("top_phase_resistance", 1.0);
    let together = duties_while_aligning(set);
    let long_before = duties_while_aligning(|halves| {
        set(halves);
        halves.live(PING_TICKS);
    });
    assert_eq!(together, long_before);
    assert_ne!(together, duties_while_aligning(|_| {}), "the setting makes a difference");
}

#[test]
fn of_two_configurations_the_newest_wins() {
    let once = duties_while_aligning(|halves| halves.set("top_phase_resistance", 1.0));
    let twice = duties_while_aligning(|halves| {
        halves.set("top_phase_resistance", 5.0);
        halves.exchange();
        halves.set("top_phase_resistance", 1.0);
        halves.exchange();
    });
    assert_eq!(twice, once);
}

#[test]
fn settings_are_refused_once_arming_was_asked_for_though_the_last_report_says_disarmed() {
    let mut halves = Halves::proven();
    halves.say(Command::Arm);
    halves.exchange();
    halves.tick(1);
    assert_eq!(halves.slow.report().state, State::Disarmed);
    let command = ParameterCommand::Set("over_speed".try_into().unwrap(), 60.0);
    let outcome = halves.say(Command::Parameter(command));
    assert_eq!(outcome, Outcome::Refused(Refusal::State(State::Aligning)));
}

#[test]
fn a_configuration_that_comes_while_the_motors_are_driven_waits_until_they_are_not() {
    let mut halves = Halves::aligning();
    let is_driven = |actuation: &Actuation| {
        actuation.bridges.iter().any(|bridge| ![Bridge::BRAKE, Bridge::Off].contains(bridge))
    };
    halves.live(3_000);
    assert!(is_driven(&halves.actuation));
    // Past the link, which lets none pass by now.
    let asked = halves.exchange.take(|_| false);
    let configuration = Configuration::new(halves.slow.settings(), &DENGFOC_V3_01.hardware);
    halves.exchange.ask(asked, Some(&configuration));
    let mut seen = Vec::new();
    for _ in 0..100 {
        halves.tick(1);
        seen.push((is_driven(&halves.actuation), halves.exchange.is_configuration_waiting()));
    }
    assert_eq!(seen[0], (false, true), "coasting before it is taken over");
    assert!(!seen.contains(&(true, true)), "{seen:?}");
    assert!(seen.iter().any(|(_, waits)| !waits), "taken over in the end");
}

#[test]
fn of_two_orders_the_newest_wins() {
    let mut halves = Halves::proven();
    halves.say(Command::Arm);
    halves.exchange();
    halves.say(Command::Disarm);
    halves.exchange();
    halves.tick(100);
    assert_eq!(halves.reported().state, State::Disarmed);
}

/// Says something to the scope, which answers once it was reached.
fn ask_scope(halves: &mut Halves, command: ScopeCommand) -> Outcome {
    let frame = halves.seal(Command::Scope(command));
    halves.hear(&frame);
    assert_eq!(halves.outcome, None, "the scope is where both halves reach it");
    halves.exchange();
    halves.hear(&[]);
    halves.outcome.take().expect("an answer")
}

#[test]
fn the_scope_is_begun_by_an_operator_filled_by_the_fast_half_and_read_by_the_operator() {
    let mut halves = Halves::connected();
    let plan = ScopePlan {
        channels: [Channel::TopAngle, Channel::Bus].into_iter().collect(),
        trigger: Trigger::Now,
        before: 0,
    };
    let begun = ask_scope(&mut halves, ScopeCommand::Begin(plan));
    assert!(matches!(&begun, Outcome::Scope(it) if it.state == ScopeState::Waiting), "{begun:?}");
    let early = ask_scope(&mut halves, ScopeCommand::Read(0));
    assert_eq!(early, Outcome::Refused(Refusal::NotCaptured));
    // One tick is that of the plan before.
    halves.tick(SCOPE_VALUES as u32 / 2 + 2);
    let answer = ask_scope(&mut halves, ScopeCommand::Status);
    let Outcome::Scope(status) = answer else { panic!("{answer:?}") };
    assert_eq!((status.state, status.rows), (ScopeState::Complete, SCOPE_VALUES as u16 / 2));
    let read = ask_scope(&mut halves, ScopeCommand::Read(0));
    let Outcome::ScopeRows(rows) = read else { panic!("{read:?}") };
    // This board does not measure its bus: it takes the nominal 11.1 V.
    let counts = (11.1 / Channel::Bus.quantity().count()) as i16;
    // The rotors of this test stand a quarter turn to the left.
    let row = [i16::MIN / 2, counts].map(i16::to_le_bytes).concat();
    assert_eq!(rows.values[..8], [row.clone(), row].concat());
    assert_eq!(
        ask_scope(
            &mut halves,
            ScopeCommand::Begin(ScopePlan { before: 2_400, ..ScopePlan::watch() })
        ),
        Outcome::Refused(Refusal::Scope)
    );
}

#[test]
fn the_scope_watches_for_faults_again_once_its_operator_has_gone() {
    let mut halves = Halves::connected();
    let plan = ScopePlan { trigger: Trigger::Now, before: 0, ..ScopePlan::watch() };
    ask_scope(&mut halves, ScopeCommand::Begin(plan));
    halves.tick(3_000);
    halves.change_operator();
    halves.now = halves.now + core::time::Duration::from_secs(2);
    halves.connect();
    let answer = ask_scope(&mut halves, ScopeCommand::Status);
    let Outcome::Scope(status) = answer else { panic!("{answer:?}") };
    assert_eq!((status.plan, status.state), (ScopePlan::watch(), ScopeState::Waiting));
}

#[test]
fn what_another_operator_asked_of_the_scope_is_not_answered_to_the_next() {
    let mut halves = Halves::connected();
    let frame = halves.seal(Command::Scope(ScopeCommand::Status));
    halves.slow.receive(halves.now, halves.address, &frame);
    halves.change_operator();
    halves.now = halves.now + core::time::Duration::from_secs(2);
    halves.connect();
    halves.exchange();
    halves.hear(&[]);
    assert_eq!(halves.outcome, None);
}

#[test]
fn the_fast_half_reports_every_millisecond() {
    let mut halves = Halves::connected();
    // The first tick reports, and each tenth from there.
    halves.tick(1);
    let first = halves.reported().timing.ticks;
    halves.tick(9);
    let before = halves.reported().timing.ticks;
    halves.tick(1);
    assert_eq!([before - first, halves.reported().timing.ticks - first], [0, 10]);
}

#[test]
fn what_happened_between_two_exchanges_is_reported_however_many_reports_were_missed() {
    let mut halves = Halves::proven();
    halves.say(Command::Stop);
    halves.exchange();
    halves.tick(1_000);
    halves.events.clear();
    halves.exchange();
    halves.say(Command::Ping(0));
    assert_eq!(halves.events, [Event::Stopped]);
}

/// An alignment that was finished while the slow half looked away.
fn report_alignment(halves: &mut Halves) -> Alignment {
    let found = Alignment {
        electrical_offset: ElectricalAngle::from_raw(1 << 30),
        reversed: true,
        ..Alignment::default()
    };
    let report = *halves.reported();
    let timing = LoopTiming { ticks: report.timing.ticks + 1, ..report.timing };
    halves.exchange.with(|exchange| {
        exchange.report(Report {
            timing,
            state: State::Armed,
            alignments: report.alignments + 1,
            alignment: [found; 2],
            ..report
        });
    });
    found
}

#[test]
fn a_configuration_that_waited_through_an_alignment_knows_what_was_found() {
    let mut halves = Halves::proven();
    halves.set("over_speed", 60.0);
    halves.exchange();
    let found = report_alignment(&mut halves);
    halves.exchange();
    let mut expected = *halves.slow.settings();
    expected.learn([found; 2]);
    assert_eq!(*halves.slow.settings(), expected);
    let expected = Configuration::new(&expected, &DENGFOC_V3_01.hardware);
    let mut waiting = None;
    halves.exchange.take(|configuration| {
        waiting = Some(*configuration);
        true
    });
    assert_eq!(waiting, Some(expected));
}

#[test]
fn the_fast_half_is_not_configured_with_what_it_found_itself() {
    let mut halves = Halves::proven();
    report_alignment(&mut halves);
    halves.exchange();
    assert!(!halves.exchange.is_configuration_waiting());
}

#[test]
fn an_idle_robot_can_be_armed_and_cleared_before_anything_crossed() {
    let mut halves = Halves::connected();
    let outcomes = [halves.say(Command::Arm), halves.say(Command::Clear)];
    assert_eq!(outcomes, [Outcome::Refused(Refusal::LinkUnproven), Outcome::Done]);
}

#[test]
fn an_idle_robot_that_is_disarmed_can_be_armed_at_once() {
    let mut halves = Halves::proven();
    halves.say(Command::Disarm);
    assert_eq!(halves.say(Command::Arm), Outcome::Done);
    halves.exchange();
    halves.tick(10);
    assert_eq!(halves.reported().state, State::Aligning);
}

#[test]
fn disarming_right_after_arming_wins_though_the_robot_was_idle_by_its_last_report() {
    let mut halves = Halves::proven();
    halves.say(Command::Arm);
    halves.say(Command::Disarm);
    let again = halves.say(Command::Arm);
    halves.exchange();
    halves.tick(1_000);
    let refused = Outcome::Refused(Refusal::State(State::Stopping));
    assert_eq!((again, halves.reported().state), (refused, State::Disarmed));
}

#[test]
fn nobody_arms_a_robot_that_still_has_to_ramp_down_for_another_operator() {
    let mut halves = Halves::aligning();
    halves.change_operator();
    // Once the old session is silent for long enough to be left to another.
    while halves.operator.status(halves.now) != Status::Connected {
        assert_eq!(halves.reported().state, State::Aligning, "the robot disarmed by itself");
        if halves.operator.poll_at().is_none() {
            halves.operator.connect(halves.now);
        }
        if let Some(frame) = halves.operator.poll(halves.now) {
            halves.hear(&frame);
        }
        if halves.operator.status(halves.now) != Status::Connected {
            halves.tick(1);
        }
    }
    let at_once = halves.say(Command::Arm);
    halves.exchange();
    halves.tick(10);
    let by_an_old_report = halves.say(Command::Arm);
    halves.exchange();
    let by_the_newest = halves.say(Command::Arm);
    let refused = |refusal| Outcome::Refused(refusal);
    assert_eq!(
        [at_once, by_an_old_report, by_the_newest],
        [
            refused(Refusal::State(State::Stopping)),
            refused(Refusal::State(State::Stopping)),
            refused(Refusal::LinkUnproven)
        ]
    );
    assert_eq!(halves.reported().state, State::Disarmed);
}

/// Ticks of the one core beside two datagrams of the other: every order of their accesses is tried.
const TICKS_BESIDE: u32 = 3;

/// Stack of a modelled core, words.
const STACK: usize = 1 << 17;

fn core<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> loom::thread::JoinHandle<T> {
    loom::thread::Builder::new().stack_size(STACK).spawn(work).unwrap()
}

fn hear_and_tick_on_two_cores() {
    let mut halves = Halves::connected();
    let setting = ParameterCommand::Set("over_speed".try_into().unwrap(), 60.0);
    let datagrams = [Command::Parameter(setting), Command::Stop].map(|it| halves.seal(it));
    let Halves { mut fast, mut slow, exchange, address, now, .. } = halves;
    let mut shared = Shared(loom::sync::Arc::new(loom::sync::Mutex::new(exchange)));
    let other = core({
        let mut shared = shared.clone();
        move || {
            for datagram in datagrams {
                slow.receive(now, address, &datagram);
                slow.exchange(&mut shared);
            }
            slow
        }
    });
    for tick in 1..=TICKS_BESIDE {
        fast.tick(now + tick * TICK, &AT_REST, &mut shared);
    }
    let mut slow = other.join().unwrap();
    for tick in 1..=20 {
        fast.tick(now + (TICKS_BESIDE + tick) * TICK, &AT_REST, &mut shared);
    }
    slow.exchange(&mut shared);
    assert!(!shared.with(|exchange| exchange.is_configuration_waiting()));
    assert!(slow.report().stopped);
    assert_eq!(slow.report().events.stopped, 1);
}

#[test]
fn however_two_cores_interleave_settings_and_orders_arrive_and_nothing_that_happened_is_lost() {
    loom::model(|| core(hear_and_tick_on_two_cores).join().unwrap());
}
