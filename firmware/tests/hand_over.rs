//! What crosses between the two halves, as on a chip: each half gets its turns when the test says so, and the
//! slow half may work from an old report.

use crate::ends::{Ends, address, key, set};
use crate::still::AT_REST;
use flix_firmware::alignment::Alignment;
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::configuration::Configuration;
use flix_firmware::fast::exchange::{Access, Exchange, Report};
use flix_firmware::hardware::{Actuation, Bridge, TICK};
use flix_firmware::scope::Memory;
use flix_firmware::units::ElectricalAngle;
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Channel, Command, Event, LoopTiming, Order, Outcome, Permit, Refusal, SCOPE_VALUES,
    ScopeCommand, ScopePlan, ScopeState, State, ToRobot, Trigger,
};
use flix_protocol::session::StopSession;

/// Ticks from one order to the next: 20 ms.
const ORDER_TICKS: u32 = 200;

/// Connected in this very moment, nothing exchanged since.
fn connected() -> Ends {
    let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
    ends.tick(100);
    ends.cross();
    ends.connect();
    ends
}

/// With a link steady for long enough to arm.
fn proven() -> Ends {
    let mut ends = connected();
    ends.run(6_000);
    ends
}

/// Being aligned, and the slow half knows it.
fn aligning() -> Ends {
    let mut ends = proven();
    ends.give(Order::Arm(ends.permit()));
    ends.run(ORDER_TICKS);
    assert_eq!(ends.slow.report().state, State::Aligning);
    ends
}

impl Ends {
    /// Both halves; the order is repeated every 20 ms.
    fn run(&mut self, ticks: u32) {
        for _ in 0..ticks / ORDER_TICKS {
            self.repeat();
            self.cross();
            self.tick(ORDER_TICKS);
            self.cross();
        }
    }

    /// How the fast half was when it last reported, which the slow half need not know.
    fn reported(&self) -> &Report {
        self.exchange.newest_report()
    }

    fn change(&mut self, name: &str, value: f32) {
        let outcome = self.say(set(name, value));
        assert!(matches!(outcome, Outcome::Parameter(_)), "{outcome:?}");
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

/// The duties well into the alignment of a robot whose motors have this resistance by the time when
/// [`Ends`] are given to `arm`; the voltage that turns the rotors follows from it.
fn duties_while_aligning(arm: impl FnOnce(&mut Ends)) -> Actuation {
    let mut ends = proven();
    arm(&mut ends);
    ends.give(Order::Arm(ends.permit()));
    ends.cross();
    ends.run(3_000);
    let report = ends.reported();
    assert_eq!(report.state, State::Aligning, "{:?}", report.first_fault);
    ends.actuation
}

#[test]
fn a_configuration_is_in_force_before_the_order_that_came_with_it() {
    let set = |ends: &mut Ends| ends.change("top_phase_resistance", 1.0);
    let together = duties_while_aligning(set);
    let long_before = duties_while_aligning(|ends| {
        set(ends);
        ends.run(ORDER_TICKS);
    });
    assert_eq!(together, long_before);
    assert_ne!(together, duties_while_aligning(|_| {}), "the setting makes a difference");
}

#[test]
fn of_two_configurations_the_newest_wins() {
    let once = duties_while_aligning(|ends| ends.change("top_phase_resistance", 1.0));
    let twice = duties_while_aligning(|ends| {
        ends.change("top_phase_resistance", 5.0);
        ends.cross();
        ends.change("top_phase_resistance", 1.0);
        ends.cross();
    });
    assert_eq!(twice, once);
}

#[test]
fn settings_are_refused_from_the_order_to_arm_on_whatever_was_reported() {
    let mut ends = proven();
    ends.give(Order::Arm(ends.permit()));
    ends.cross();
    ends.tick(1);
    assert_eq!(ends.slow.report().state, State::Disarmed);
    let outcome = ends.say(set("over_speed", 60.0));
    assert_eq!(outcome, Outcome::Refused(Refusal::State(State::Aligning)));
}

#[test]
fn settings_are_refused_from_the_order_to_arm_on_though_the_report_is_of_a_stop_cleared_since() {
    let mut ends = proven();
    ends.give(Order::Stop);
    ends.run(ORDER_TICKS);
    // Reports, which the next nine ticks do not.
    ends.tick(1);
    for order in [Order::Clear(ends.permit()), Order::Arm(ends.permit())] {
        ends.give(order);
        ends.cross();
        ends.tick(2);
    }
    assert!(ends.slow.report().stopped, "as of the last report");
    let outcome = ends.say(set("position_bandwidth", 50.0));
    assert_eq!(outcome, Outcome::Refused(Refusal::State(State::Aligning)));
    ends.run(ORDER_TICKS);
    assert_eq!(ends.reported().state, State::Aligning);
}

#[test]
fn a_stop_latches_and_is_cleared_however_often_somebody_stopped_the_robot_before() {
    let outsider = ([192, 168, 4, 3], 4_000).into();
    let mut ends = proven();
    // What counts stops between the halves has eight bits.
    for count in 0..300_u32 {
        let mut entropy = [0; 32];
        entropy[..4].copy_from_slice(&count.to_le_bytes());
        let (mut stop, mut frame) = (StopSession::new(&key(), entropy, ends.now), Frame::new());
        for _ in 0..2 {
            let asked = stop.poll(ends.now).unwrap();
            ends.slow.receive(ends.now, outsider, &asked);
            assert_eq!(ends.slow.transmit(ends.now, &mut frame), Some(outsider));
            stop.receive(ends.now, &frame).unwrap();
        }
        let before = ends.reported().permit;
        ends.run(2 * ORDER_TICKS);
        assert_eq!((ends.reported().stopped, ends.reported().permit), (true, before.next()));
        ends.give(Order::Clear(ends.permit()));
        ends.run(ORDER_TICKS);
        assert!(!ends.reported().stopped, "{count} stops before");
    }
}

#[test]
fn a_configuration_waits_while_the_motors_are_driven() {
    let mut ends = aligning();
    let is_driven = |actuation: &Actuation| {
        actuation.bridges.iter().any(|bridge| ![Bridge::BRAKE, Bridge::Off].contains(bridge))
    };
    ends.run(3_000);
    assert!(is_driven(&ends.actuation));
    // Past the link, which lets none pass by now.
    let asked = ends.exchange.take(|_| false);
    let configuration = Configuration::new(ends.slow.settings(), &DENGFOC_V3_01.hardware);
    ends.exchange.ask(asked, Some(&configuration));
    let mut seen = Vec::new();
    for _ in 0..100 {
        ends.tick(1);
        seen.push((is_driven(&ends.actuation), ends.exchange.is_configuration_waiting()));
    }
    assert_eq!(seen[0], (false, true), "coasting before it is taken over");
    assert!(!seen.contains(&(true, true)), "{seen:?}");
    assert!(seen.iter().any(|(_, waits)| !waits), "taken over in the end");
}

#[test]
fn of_two_orders_the_newest_wins() {
    for (crosses, arms) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut ends = proven();
        let mut orders = [Order::Off, Order::Arm(ends.permit())];
        if !arms {
            orders.reverse();
        }
        for order in orders {
            ends.give(order);
            if crosses {
                ends.cross();
            }
        }
        ends.cross();
        ends.tick(100);
        let state = if arms { State::Aligning } else { State::Disarmed };
        assert_eq!(ends.reported().state, state, "{crosses}");
    }
}

/// Says something to the scope, which answers once it was reached.
fn ask_scope(ends: &mut Ends, command: ScopeCommand) -> Outcome {
    ends.ask(Command::Scope(command));
    assert_eq!(ends.outcomes, [], "the scope is where both halves reach it");
    ends.cross();
    ends.drain();
    ends.outcomes.pop().expect("an answer")
}

#[test]
fn an_operator_reads_from_the_scope_whatever_the_fast_half_recorded() {
    let mut ends = connected();
    let plan = ScopePlan {
        channels: [Channel::TopAngle, Channel::Bus].into_iter().collect(),
        trigger: Trigger::Now,
        before: 0,
    };
    let begun = ask_scope(&mut ends, ScopeCommand::Begin(plan));
    assert!(matches!(&begun, Outcome::Scope(it) if it.state == ScopeState::Waiting), "{begun:?}");
    let early = ask_scope(&mut ends, ScopeCommand::Read(0));
    assert_eq!(early, Outcome::Refused(Refusal::NotCaptured));
    // One tick is that of the plan before.
    ends.tick(SCOPE_VALUES as u32 / 2 + 2);
    let answer = ask_scope(&mut ends, ScopeCommand::Status);
    let Outcome::Scope(status) = answer else { panic!("{answer:?}") };
    assert_eq!((status.state, status.rows), (ScopeState::Complete, SCOPE_VALUES as u16 / 2));
    let read = ask_scope(&mut ends, ScopeCommand::Read(0));
    let Outcome::ScopeRows(rows) = read else { panic!("{read:?}") };
    // This board does not measure its bus: it takes the nominal 11.1 V.
    let counts = (11.1 / Channel::Bus.quantity().count()) as i16;
    // The rotors of this test stand a quarter turn to the left.
    let row = [i16::MIN / 2, counts].map(i16::to_le_bytes).concat();
    assert_eq!(rows.values[..8], [row.clone(), row].concat());
    assert_eq!(
        ask_scope(
            &mut ends,
            ScopeCommand::Begin(ScopePlan { before: 2_400, ..ScopePlan::watch() })
        ),
        Outcome::Refused(Refusal::Scope)
    );
}

#[test]
fn the_scope_watches_for_faults_again_once_its_operator_has_gone() {
    let mut ends = connected();
    let plan = ScopePlan { trigger: Trigger::Now, before: 0, ..ScopePlan::watch() };
    ask_scope(&mut ends, ScopeCommand::Begin(plan));
    ends.tick(3_000);
    ends.change_operator();
    ends.now = ends.now + core::time::Duration::from_secs(2);
    ends.connect();
    let answer = ask_scope(&mut ends, ScopeCommand::Status);
    let Outcome::Scope(status) = answer else { panic!("{answer:?}") };
    assert_eq!((status.plan, status.state), (ScopePlan::watch(), ScopeState::Waiting));
}

#[test]
fn no_operator_gets_the_answer_that_another_asked_of_the_scope() {
    let mut ends = connected();
    ends.ask(Command::Scope(ScopeCommand::Status));
    ends.change_operator();
    ends.now = ends.now + core::time::Duration::from_secs(2);
    ends.connect();
    ends.cross();
    ends.drain();
    assert_eq!(ends.outcomes, []);
}

#[test]
fn the_fast_half_reports_every_millisecond() {
    let mut ends = connected();
    // The first tick reports, and each tenth from there.
    ends.tick(1);
    let first = ends.reported().timing.ticks;
    ends.tick(9);
    let before = ends.reported().timing.ticks;
    ends.tick(1);
    assert_eq!([before - first, ends.reported().timing.ticks - first], [0, 10]);
}

#[test]
fn events_between_two_exchanges_are_reported_however_many_reports_were_missed() {
    let mut ends = proven();
    ends.give(Order::Stop);
    ends.cross();
    ends.tick(1_000);
    ends.events.clear();
    ends.cross();
    ends.drain();
    let events: Vec<_> = ends.events.iter().map(|(_, event)| *event).collect();
    assert_eq!(events, [Event::Stopped]);
}

/// An alignment that was finished while the slow half looked away.
fn report_alignment(ends: &mut Ends) -> Alignment {
    let found = Alignment {
        electrical_offset: ElectricalAngle::from_raw(1 << 30),
        reversed: true,
        ..Alignment::default()
    };
    let report = *ends.reported();
    let timing = LoopTiming { ticks: report.timing.ticks + 1, ..report.timing };
    ends.exchange.with(|exchange| {
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
    let mut ends = proven();
    ends.change("over_speed", 60.0);
    ends.cross();
    let found = report_alignment(&mut ends);
    ends.cross();
    let mut expected = *ends.slow.settings();
    expected.learn([found; 2]);
    assert_eq!(*ends.slow.settings(), expected);
    let expected = Configuration::new(&expected, &DENGFOC_V3_01.hardware);
    let mut waiting = None;
    ends.exchange.take(|configuration| {
        waiting = Some(*configuration);
        true
    });
    assert_eq!(waiting, Some(expected));
}

#[test]
fn the_fast_half_is_not_configured_with_what_it_found_itself() {
    let mut ends = proven();
    report_alignment(&mut ends);
    ends.cross();
    assert!(!ends.exchange.is_configuration_waiting());
}

#[test]
fn another_operator_arms_by_a_permit_of_his_session_alone() {
    let mut ends = aligning();
    let before = ends.permit();
    ends.change_operator();
    ends.connect();
    // The second time the link is proven, too.
    for permit in [before, Permit::default()] {
        ends.give(Order::Arm(permit));
        ends.run(6_000);
        assert_eq!(ends.reported().state, State::Disarmed);
    }
    ends.give(Order::Arm(ends.permit()));
    ends.run(ORDER_TICKS);
    assert_eq!(ends.reported().state, State::Aligning);
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
    let mut ends = connected();
    let messages = [ToRobot::request(1, set("over_speed", 60.0)), ToRobot::Order(Order::Stop)];
    let datagrams = messages.map(|it| ends.seal(it));
    let Ends { mut fast, mut slow, exchange, now, .. } = ends;
    let mut shared = Shared(loom::sync::Arc::new(loom::sync::Mutex::new(exchange)));
    let other = core({
        let mut shared = shared.clone();
        move || {
            for datagram in datagrams {
                slow.receive(now, address(), &datagram);
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
fn settings_and_orders_arrive_however_two_cores_interleave() {
    loom::model(|| core(hear_and_tick_on_two_cores).join().unwrap());
}
