//! The robot's end of the link alone: what it makes of orders and requests in each state, and what comes back. The fast half
//! is a report that the test writes.

use core::net::SocketAddr;
use core::time::Duration;

use crate::ends::{Ends, MILLISECOND, REPETITION, address, key, set};
use flix_firmware::blackbox::{self, Kept};
use flix_firmware::board::{DENGFOC_V3_01, GENERIC_ESP32C6};
use flix_firmware::fast::exchange::{Asked, EventCounters, MotorReport, Report, Wanted};
use flix_firmware::link::{EVENTS, Link, bridges, identity};
use flix_firmware::settings::{COUNT, MOTOR_VALUES, Settings};
use flix_firmware::units::{Current, RotorAngle, Speed, Voltage};
use flix_protocol::failsafe::{COMMAND_AGE, LINK_LATE, PROVING_TIME};
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    BuildId, Command, Event, Fault, Faults, Halt, Identity, Magnet, Mark, Name, OperatorName,
    Order, Outcome, PARAMETERS_PER_REPLY, ParameterCommand, Pattern, Permit, Refusal, ResetReason,
    ScopeCommand, ScopePlan, Setpoint, State, Telemetry, ToRobot, Trial, Withheld,
};
use flix_protocol::session::{
    ConnectError, Key, Operator, OperatorSession, Operators, STOP_RETRY, Status, StopSession,
    StopStatus,
};
use flix_protocol::units::{Hertz, Volts};

/// Telemetry comes so often by default.
const TELEMETRY: Duration = Duration::from_millis(20);
const STATES: [State; 6] = [
    State::Disarmed,
    State::Aligning,
    State::Armed,
    State::Running,
    State::Stopping,
    State::Faulted,
];
const PAIR: Setpoint = Setpoint::saturating(20.0, 30.0);
const TRIAL: Trial = Trial {
    motors: [true, false],
    current_ma: 700,
    angle: 0,
    pattern: Pattern::Turn(60),
    ticks: 3_000,
};
/// A permit that the robot has never stated.
const UNKNOWN: Permit = Permit::new(77);

fn outsider() -> SocketAddr {
    ([192, 168, 4, 3], 4_000).into()
}

fn refused(refusal: Refusal) -> Outcome {
    Outcome::Refused(refusal)
}

fn connected() -> Ends {
    let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
    ends.start();
    ends
}

/// With a link that was steady for long enough to arm.
fn proven() -> Ends {
    let mut ends = connected();
    ends.live(PROVING_TIME + LINK_LATE);
    ends
}

/// The same, in this state.
fn at(state: State) -> Ends {
    let mut ends = proven();
    ends.observe(|report| report.state = state);
    ends
}

impl Ends {
    /// Opens a session, which the fast half counts.
    fn start(&mut self) {
        self.connect();
        self.observe(|_| {});
        self.drain();
    }

    fn wait(&mut self, time: Duration) {
        for _ in 0..time.as_millis() {
            self.now = self.now + MILLISECOND;
            self.drain();
        }
    }

    /// Waits, and repeats the order every 20 ms.
    fn live(&mut self, time: Duration) {
        for _ in 0..time.as_millis() / REPETITION.as_millis() {
            self.wait(REPETITION);
            self.repeat();
        }
    }

    /// The fast half obeys all that it is asked for, and reports.
    fn observe(&mut self, change: impl FnOnce(&mut Report)) {
        self.report.time = self.now;
        let Asked { number, stops, halts, .. } = *self.asked();
        (self.report.obeyed, self.report.stops, self.report.halts) = (number, stops, halts);
        self.report.rests = true;
        change(&mut self.report);
        self.slow.link.observe(&self.report);
    }

    /// Returns what the robot states next, in the moment in which it does.
    fn told(&mut self) -> Telemetry {
        let before = self.telemetry.len();
        while self.telemetry.len() == before {
            self.wait(MILLISECOND);
        }
        *self.telemetry.last().unwrap()
    }

    fn happened(&mut self) -> Vec<Event> {
        self.wait(TELEMETRY);
        self.events.drain(..).map(|(_, event)| event).collect()
    }

    /// Returns whether an order to arm may begin to drive motors, as [`ParameterCommand::Check`] has to say, too.
    fn may_arm(&mut self) -> bool {
        self.give(Order::Arm(self.permit()));
        let begins = self.asked().begins;
        let withheld = self.told().withheld;
        self.give(Order::Off);
        let check = self.say(Command::Parameter(ParameterCommand::Check));
        assert_eq!(begins, check == Outcome::Done, "{check:?}");
        assert_eq!(begins, withheld != Some(Withheld::Settings), "{withheld:?}");
        begins
    }
}

#[test]
fn requests_order_nothing_and_change_settings_only_while_the_robot_is_idle() {
    let parameter = Command::Parameter;
    for (command, is_change) in [
        (set("over_speed", 60.0), true),
        (parameter(ParameterCommand::Reset), true),
        (parameter(ParameterCommand::Save), true),
        (parameter(ParameterCommand::Accept), true),
        (parameter(ParameterCommand::Check), false),
        (Command::Ping(5), false),
        (Command::Crash, false),
        (Command::Bridges, false),
    ] {
        for state in STATES {
            let mut ends = at(state);
            let before = *ends.asked();
            let outcome = ends.say(command.clone());
            if is_change && !state.is_idle() {
                assert_eq!(outcome, refused(Refusal::State(state)), "{command:?}");
            } else {
                let is_refused = matches!(outcome, Outcome::Refused(_));
                assert!(!is_refused, "{command:?} while {state}: {outcome:?}");
            }
            assert_eq!(*ends.asked(), before, "{command:?} while {state}");
        }
    }
}

#[test]
fn each_order_is_handed_on_whole_whatever_the_state() {
    for state in STATES {
        for (order, wanted) in [
            (Order::Off, Wanted::Off),
            (Order::Stop, Wanted::Off),
            (Order::Arm(UNKNOWN), Wanted::Arm),
            (Order::Shake(UNKNOWN, PAIR), Wanted::Shake),
            (Order::Try(UNKNOWN, TRIAL), Wanted::Try),
            (Order::Clear(UNKNOWN), Wanted::Clear),
        ] {
            let mut ends = at(state);
            let before = *ends.asked();
            ends.give(order);
            let asked = *ends.asked();
            assert_eq!((asked.wanted, asked.number), (wanted, before.number + 1));
            assert_eq!(asked.stops - before.stops, u8::from(order == Order::Stop));
            assert_eq!(asked.halts, before.halts);
            if let Some(permit) = order.permit() {
                assert_eq!(asked.permit, permit);
            }
            if wanted == Wanted::Shake {
                assert_eq!(asked.frequency, Speed::from_hertz(20.0));
                assert_eq!(asked.direction, RotorAngle::from_degrees(30.0));
            }
            if wanted == Wanted::Try {
                assert_eq!(asked.trial, Some(TRIAL));
            }
        }
    }
}

#[test]
fn the_pair_that_the_robot_follows_is_shown_until_it_ramps_down() {
    type Act = fn(&mut Ends);
    let ends_it: [Act; 7] = [
        |ends| ends.give(Order::Off),
        |ends| ends.give(Order::Stop),
        |ends| ends.give(Order::Arm(ends.permit())),
        |ends| ends.observe(|report| report.permit = report.permit.next()),
        |ends| ends.observe(|report| report.state = State::Disarmed),
        |ends| ends.observe(|report| report.state = State::Stopping),
        |ends| ends.observe(|report| report.state = State::Faulted),
    ];
    for act in ends_it {
        let mut ends = at(State::Armed);
        ends.give(Order::Shake(ends.permit(), PAIR));
        assert_eq!(ends.told().setpoint, PAIR);
        act(&mut ends);
        assert_eq!(ends.told().setpoint, Setpoint::REST);
    }
}

#[test]
fn an_order_that_is_not_obeyed_is_answered_with_the_reason() {
    use State::{Aligning, Armed, Disarmed, Faulted, Running, Stopping};
    let no = None;
    let [wrong, old, stopped, faulted, unproven] = [
        Withheld::State,
        Withheld::Permit,
        Withheld::Stopped,
        Withheld::Faulted,
        Withheld::LinkUnproven,
    ]
    .map(Some);
    let stall = Faults::NONE.with(Fault::Stall);
    let [free, stop, fault, both] =
        [(false, Faults::NONE), (true, Faults::NONE), (false, stall), (true, stall)];
    // Whether the operator knows the last halt; what is said to `Arm`, `Shake`, `Try` and `Clear`.
    for (from, state, latched, knows, reasons) in [
        (proven as fn() -> Ends, Disarmed, free, true, [no, wrong, no, no]),
        (connected, Disarmed, free, true, [unproven, wrong, unproven, no]),
        (proven, Aligning, free, true, [no, wrong, no, wrong]),
        (proven, Armed, free, true, [no, no, wrong, wrong]),
        (proven, Running, free, true, [no, no, wrong, wrong]),
        (proven, Stopping, free, true, [wrong, wrong, wrong, wrong]),
        (proven, Disarmed, free, false, [old, old, old, no]),
        (proven, Running, free, false, [no, old, old, wrong]),
        // A fault is named before a stop, and both before all else.
        (connected, Disarmed, stop, true, [stopped, stopped, stopped, no]),
        (proven, Disarmed, stop, false, [stopped, stopped, stopped, old]),
        (connected, Faulted, fault, true, [faulted, faulted, faulted, no]),
        (proven, Faulted, both, false, [faulted, faulted, faulted, old]),
    ] {
        let mut ends = from();
        ends.observe(|report| {
            report.state = state;
            (report.stopped, report.faults) = latched;
        });
        let permit = if knows { ends.permit() } else { UNKNOWN };
        let orders = [
            Order::Arm(permit),
            Order::Shake(permit, PAIR),
            Order::Try(permit, TRIAL),
            Order::Clear(permit),
            Order::Stop,
            Order::Off,
        ];
        for (order, reason) in orders.into_iter().zip(reasons.into_iter().chain([no, no])) {
            ends.give(order);
            let withheld = ends.told().withheld;
            assert_eq!(withheld, reason, "{order:?} while {state}, {latched:?}, {knows}");
        }
    }
}

#[test]
fn orders_in_range_alone_are_signs_of_life() {
    let mut ends = at(State::Armed);
    for command in [Command::Ping(0), Command::Identify, set("over_speed", 60.0)] {
        let before = *ends.asked();
        ends.wait(10 * MILLISECOND);
        ends.say(command);
        assert_eq!(ends.asked().heard, before.heard);
    }
    let permit = ends.permit();
    let orders = [Order::Off, Order::Arm(permit), Order::Clear(permit), Order::Stop];
    for order in [&orders[..], &[Order::Shake(UNKNOWN, PAIR), Order::Try(UNKNOWN, TRIAL)]].concat()
    {
        ends.wait(10 * MILLISECOND);
        ends.give(order);
        let Asked { heard, expires, .. } = *ends.asked();
        let age = expires.since(heard);
        assert!(age <= COMMAND_AGE && age > COMMAND_AGE - 2 * TELEMETRY, "{age:?}");
        assert_eq!(heard, ends.now, "{order:?}");
    }
    let impossible = postcard::from_bytes(&[35.5f32, 0.0].map(f32::to_le_bytes).concat()).unwrap();
    let wild = Trial { current_ma: 5_000, ..TRIAL };
    for order in [Order::Shake(permit, impossible), Order::Try(permit, wild)] {
        let Asked { number, heard, .. } = *ends.asked();
        ends.wait(10 * MILLISECOND);
        ends.give(order);
        let after = ends.asked();
        assert_eq!((after.number, after.heard), (number, heard), "{order:?}");
        assert_eq!(ends.told().withheld, Some(Withheld::Range));
    }
}

#[test]
fn telemetry_names_the_newest_order_that_the_fast_half_looked_at() {
    let mut ends = proven();
    ends.observe(|_| {});
    let before = ends.told().heard;
    ends.give(Order::Off);
    let (number, arrival) = (ends.operator.sealed(), ends.now);
    ends.observe(|report| report.obeyed -= 1);
    assert_eq!(ends.told().heard, before, "not looked at yet");
    ends.observe(|_| {});
    let late = ends.seal(ToRobot::Order(Order::Arm(ends.permit())));
    // Neither a request nor an order that is not handed on takes its place.
    ends.say(Command::Ping(0));
    for _ in 0..5 {
        let Telemetry { heard, held_us, .. } = ends.told();
        let since = ends.now.since(arrival).as_micros();
        assert_eq!((heard, held_us), (number, u16::try_from(since).unwrap_or(u16::MAX)));
    }
    ends.wait(2 * COMMAND_AGE);
    ends.hear(&late);
    ends.observe(|_| {});
    assert_eq!((ends.told().heard, ends.told().held_us), (number, u16::MAX));
}

#[test]
fn no_operator_is_shown_a_permit_of_before_his_session() {
    let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
    ends.connect();
    ends.wait(5 * TELEMETRY);
    assert_eq!(ends.slow.transmit(ends.now, &mut Frame::new()), None);
    assert!(ends.telemetry.is_empty());
    let (permit, halt) = (Permit::new(5), Halt::Operator);
    ends.observe(|report| (report.permit, report.halt) = (permit, halt));
    assert_eq!((ends.told().permit, ends.told().halt), (permit, halt));
}

#[test]
fn a_session_inherits_nothing_of_the_session_before() {
    let accept = |number| ToRobot::request(number, Command::Parameter(ParameterCommand::Accept));
    let mut ends = at(State::Disarmed);
    ends.send(accept(99));
    ends.give(Order::Shake(UNKNOWN, PAIR));
    ends.observe(|_| {});
    let told = ends.told();
    assert_eq!((told.heard, told.withheld), (ends.operator.sealed(), Some(Withheld::Permit)));
    ends.change_operator();
    ends.start();
    let told = ends.told();
    assert_eq!((told.heard, told.withheld), (0, None));
    ends.give(Order::Arm(told.permit));
    assert!(!ends.asked().begins, "the link is proven anew");
    // Its requests are counted from one.
    ends.give(Order::Off);
    ends.outcomes.clear();
    ends.send(accept(1));
    assert_eq!(ends.outcomes, [Outcome::Done]);
}

#[test]
fn a_stop_from_outside_halts_once_and_is_answered_until_at_rest() {
    let bob = Operator::new("bob".parse().unwrap(), &Key::new([0xb0; 32]));
    let mut operators = Operators::from(key());
    operators.add(bob.clone()).unwrap();
    for (stopped, state, rests, order, status) in [
        (false, State::Disarmed, true, None, StopStatus::Latched),
        (true, State::Stopping, true, None, StopStatus::Latched),
        (true, State::Disarmed, true, None, StopStatus::AtRest),
        // Rotors that brake after a fault still turn.
        (true, State::Faulted, false, None, StopStatus::Latched),
        (true, State::Faulted, true, None, StopStatus::AtRest),
        // The fast half may have obeyed this order since its last report.
        (true, State::Disarmed, true, Some(Order::Clear(UNKNOWN)), StopStatus::Latched),
    ] {
        let mut ends = at(state);
        ends.slow.link.set_operators(operators.clone());
        let before = *ends.asked();
        let mut stop = StopSession::new(&bob.key(), [4; 32], ends.now);
        let mut frame = Frame::new();
        // Hello, the first Stop, and again once the robot has obeyed or not.
        for turn in 0..3 {
            if turn == 2 {
                ends.observe(|report| {
                    (report.stopped, report.state, report.rests) = (stopped, state, rests);
                });
                order.into_iter().for_each(|order| ends.give(order));
                ends.now = ends.now + STOP_RETRY;
            }
            let asked = stop.poll(ends.now).unwrap();
            ends.slow.receive(ends.now, outsider(), &asked);
            assert_eq!(ends.slow.transmit(ends.now, &mut frame), Some(outsider()));
            stop.receive(ends.now, &frame).unwrap();
        }
        assert_eq!(stop.status(), status, "{stopped} {state} {order:?}");
        let Asked { stops, halts, .. } = *ends.asked();
        assert_eq!((stops - before.stops, halts - before.halts), (1, 1));
        assert!(ends.happened().contains(&Event::StoppedFromOutside(bob.name())));
        // The first who stops is named.
        ends.give(Order::Stop);
        assert_eq!(ends.told().stopped_by, stopped.then(|| bob.name()));
    }
}

#[test]
fn settings_are_saved_only_once_the_rotors_rest() {
    let save = Command::Parameter(ParameterCommand::Save);
    for state in [State::Disarmed, State::Faulted] {
        let mut ends = at(state);
        ends.observe(|report| report.rests = false);
        let refused = Outcome::Refused(Refusal::State(State::Stopping));
        assert_eq!(ends.say(save.clone()), refused, "{state}");
        ends.observe(|_| {});
        assert_eq!(ends.say(save.clone()), Outcome::Done, "{state}");
    }
}

#[test]
fn nothing_older_undoes_the_newest_order_or_the_newest_change_of_settings() {
    // An order that was overtaken on its way.
    for (earlier, newer) in [
        (Order::Arm(Permit::default()), Order::Off),
        (Order::Clear(Permit::default()), Order::Stop),
        (Order::Off, Order::Arm(Permit::default())),
    ] {
        let mut ends = proven();
        let [earlier, newer] = [earlier, newer].map(|order| ends.seal(ToRobot::Order(order)));
        ends.hear(&newer);
        let asked = *ends.asked();
        ends.hear(&earlier);
        assert_eq!(*ends.asked(), asked);
    }
    // A request that was made earlier, and is repeated by a client that repeats several side by side. A question neither
    // overtakes nor is overtaken.
    let current = |value| set("current_limit", value);
    for (earlier, newer, answers) in [
        (current(2.4), current(0.9), 1),
        (current(0.9), Command::Ping(9), 2),
        (Command::Ping(8), current(0.9), 2),
    ] {
        let mut ends = proven();
        for (number, command) in [(9, newer), (8, earlier)] {
            ends.send(ToRobot::request(number, command));
        }
        assert_eq!(ends.outcomes.len(), answers);
        assert_eq!(ends.slow.settings().current_limit, 0.9);
    }
}

#[test]
fn a_latched_stop_is_stated_with_its_operator_and_its_moment() {
    let mut ends = at(State::Running);
    let shown = |ends: &mut Ends, stopped| {
        ends.observe(|report| report.stopped = stopped);
        let Telemetry { stopped_by, latched_at, .. } = ends.told();
        assert_eq!(stopped_by, latched_at.map(|_| OperatorName::OWNER));
        latched_at
    };
    assert_eq!(shown(&mut ends, false), None);
    for _ in 0..2 {
        ends.give(Order::Stop);
        let now = ends.now;
        // It is repeated until it is acknowledged, and a little longer.
        for _ in 0..3 {
            assert_eq!(shown(&mut ends, true), Some(now));
            ends.repeat();
        }
        ends.give(Order::Clear(ends.permit()));
    }
    assert_eq!(shown(&mut ends, false), None, "cleared");
}

#[test]
fn a_latched_fault_is_stated_with_its_moment() {
    let mut ends = at(State::Running);
    for (faults, is_new) in [
        (Faults::NONE.with(Fault::Stall), true),
        (Faults::NONE.with(Fault::Stall), false),
        (Faults::NONE.with(Fault::Stall).with(Fault::UnderVoltage), true),
    ] {
        ends.wait(MILLISECOND);
        let last = ends.told().latched_at;
        ends.observe(|report| report.faults = faults);
        let now = ends.now;
        assert_eq!(ends.told().latched_at, if is_new { Some(now) } else { last });
    }
}

#[test]
fn arming_wants_orders_without_a_gap_for_the_proving_time() {
    // Orders so often, for so long, and the order to arm so much later.
    for (every, time, gap, begins) in [
        (99, PROVING_TIME, 0, true),
        (100, 2 * PROVING_TIME, 0, false),
        (50, PROVING_TIME - 100 * MILLISECOND, 99, false),
        (50, PROVING_TIME - 50 * MILLISECOND, 50, true),
        (50, PROVING_TIME, 99, true),
        (50, PROVING_TIME, 100, false),
    ] {
        let mut ends = connected();
        ends.give(Order::Off);
        for _ in 0..(time.as_millis() as u32).div_ceil(every) {
            ends.wait(every * MILLISECOND);
            ends.repeat();
        }
        ends.wait(gap * MILLISECOND);
        ends.give(Order::Arm(ends.permit()));
        assert_eq!(ends.asked().begins, begins, "{every} {time:?} {gap}");
    }
}

/// The age at which commands of the next tests arrive.
const LATE: Duration = Duration::from_millis(500);

#[test]
fn orders_that_come_too_late_calm_and_do_nothing_else() {
    for (order, counts) in [
        (Order::Off, true),
        (Order::Stop, true),
        (Order::Arm(Permit::default()), false),
        (Order::Shake(Permit::default(), PAIR), false),
        (Order::Try(Permit::default(), TRIAL), false),
        (Order::Clear(Permit::default()), false),
    ] {
        let mut ends = proven();
        ends.observe(|report| report.stopped = true);
        let both = [order; 2].map(|order| ends.seal(ToRobot::Order(order)));
        ends.happened();
        let before = *ends.asked();
        ends.wait(LATE);
        both.iter().for_each(|frame| ends.hear(frame));
        let asked = *ends.asked();
        assert_eq!(asked.heard, before.heard, "{order:?} is no sign of life");
        assert_eq!(asked.number - before.number, 2 * u32::from(counts), "{order:?}");
        assert_eq!(asked.stops - before.stops, u8::from(order == Order::Stop));
        let events = ends.happened();
        let [Event::CommandsLate { age_ms, limit_ms: 400 }] = events[..] else {
            panic!("told once: {events:?}")
        };
        assert!((500..560).contains(&age_ms), "{age_ms} ms");
        let late = |it: Option<Withheld>| matches!(it, Some(Withheld::Late { limit_ms: 400, .. }));
        let withheld = ends.told().withheld;
        assert_eq!(late(withheld), !counts, "{order:?}: {withheld:?}");
    }
}

#[test]
fn requests_that_come_too_late_are_answered_where_they_only_ask() {
    let parameter = Command::Parameter;
    for (command, counts) in [
        (Command::Identify, true),
        (Command::Crash, true),
        (Command::Bridges, true),
        (Command::Ping(3), true),
        (parameter(ParameterCommand::Get("over_speed".try_into().unwrap())), true),
        (parameter(ParameterCommand::List(0)), true),
        (parameter(ParameterCommand::Check), true),
        (parameter(ParameterCommand::Accept), false),
        (set("over_speed", 60.0), false),
        (Command::Scope(ScopeCommand::Status), true),
        (Command::Scope(ScopeCommand::Read(0)), true),
        (Command::Scope(ScopeCommand::Begin(ScopePlan::watch())), false),
    ] {
        let mut ends = proven();
        let frame = ends.seal(ToRobot::request(1, command.clone()));
        ends.wait(LATE);
        ends.hear(&frame);
        ends.cross();
        ends.drain();
        let [outcome] = &ends.outcomes[..] else { panic!("{:?}", ends.outcomes) };
        let is_late = matches!(outcome, Outcome::Refused(Refusal::Late { limit_ms: 400, .. }));
        assert_eq!(is_late, !counts, "{command:?}: {outcome:?}");
    }
}

#[test]
fn a_slow_link_is_reported_again_only_after_it_was_steady() {
    for (steady, reports) in [(PROVING_TIME - LINK_LATE, 0), (PROVING_TIME + LINK_LATE, 1)] {
        let mut ends = proven();
        let late = |ends: &mut Ends| {
            let kept = ends.seal(ToRobot::Order(Order::Off));
            ends.wait(2 * COMMAND_AGE);
            ends.hear(&kept);
            ends.happened().iter().filter(|e| matches!(e, Event::CommandsLate { .. })).count()
        };
        assert_eq!(late(&mut ends), 1);
        ends.live(steady);
        assert_eq!(late(&mut ends), reports, "{steady:?}");
    }
}

#[test]
fn a_command_age_counts_at_once_when_it_is_set_or_reset() {
    let limit = |ends: &mut Ends| {
        ends.live(PROVING_TIME + LINK_LATE);
        let frame = ends.seal(ToRobot::Order(Order::Arm(ends.permit())));
        ends.wait(Duration::from_millis(1_500));
        ends.hear(&frame);
        match ends.told().withheld {
            Some(Withheld::Late { limit_ms, .. }) => limit_ms,
            other => panic!("{other:?}"),
        }
    };
    let mut ends = proven();
    ends.say(set("command_age", 0.8));
    let longer = limit(&mut ends);
    ends.say(Command::Parameter(ParameterCommand::Reset));
    assert_eq!([longer, limit(&mut ends)], [800, 400]);
}

/// The age of commands and the ramp down are 0.85 s together at most: the promise holds for the settings that are in force.
#[test]
fn a_robot_arms_with_no_age_of_commands_longer_than_promised() {
    for (ramp, age, longest) in [
        (200.0, 1.0, Some(0.6)),
        (200.0, 0.61, Some(0.6)),
        (200.0, 0.6, None),
        (1_000.0, 0.74, None),
        (1_000.0, 0.75, Some(0.74)),
        (20.0, 0.46, Some(0.45)),
        (20.0, 0.45, None),
        (200.0, 0.1, None),
    ] {
        let mut ends = proven();
        for (name, value) in [("frequency_ramp", ramp), ("command_age", age)] {
            let outcome = ends.say(set(name, value));
            assert!(matches!(outcome, Outcome::Parameter(it) if it.value == value), "{name}");
        }
        let wanted = longest.map_or(Outcome::Done, |maximum| {
            let name = "command_age".try_into().unwrap();
            refused(Refusal::OutOfRange { name, minimum: 0.1, maximum })
        });
        let check = ends.say(Command::Parameter(ParameterCommand::Check));
        assert_eq!(check, wanted, "{age} s, {ramp} Hz/s");
        assert_eq!(ends.may_arm(), longest.is_none());
        // It is refused, and never changed.
        assert_eq!(ends.slow.settings().command_age, age);
    }
}

#[test]
fn everything_that_the_fast_half_reports_becomes_one_numbered_event() {
    let mut ends = connected();
    ends.happened();
    ends.observe(|report| {
        report.events = EventCounters {
            cleared: 1,
            stopped: 1,
            link_late: 2,
            command_deadline: 1,
            command_age: 1,
            link_lost: 1,
            battery_low: 1,
            frequency_limited: 1,
        };
        report.bus_voltage = Some(Voltage::from_volts(9.5));
        report.frequency = Speed::ZERO;
        report.faults = Faults::NONE.with(Fault::Stall).with(Fault::OverSpeed);
        report.state = State::Faulted;
    });
    ends.wait(TELEMETRY);
    let (numbers, events): (Vec<_>, Vec<_>) = ends.events.drain(..).unzip();
    assert!(numbers.is_sorted_by(|a, b| a + 1 == *b), "{numbers:?}");
    assert_eq!(
        events,
        [
            Event::Cleared,
            Event::Stopped,
            Event::LinkLate,
            Event::LinkLate,
            Event::CommandDeadline,
            Event::CommandAge,
            Event::LinkLost,
            Event::BatteryLow(Volts::new(9.5).unwrap()),
            Event::FrequencyLimited(Hertz::ZERO),
            Event::Fault(Fault::OverSpeed),
            Event::Fault(Fault::Stall),
            Event::State(State::Faulted),
        ]
    );
    ends.observe(|_| {});
    assert_eq!(ends.happened(), [], "nothing new");
}

#[test]
fn the_newest_of_too_many_events_stay() {
    let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
    for number in 0..EVENTS + 5 {
        ends.slow
            .link
            .add_event(ends.now, if number < 5 { Event::Stopped } else { Event::Cleared });
    }
    ends.start();
    let events = ends.happened();
    assert_eq!(events.len(), EVENTS);
    assert_eq!(events.iter().filter(|event| **event == Event::Cleared).count(), EVENTS - 1);
    assert_eq!(events.last(), Some(&Event::OperatorConnected(OperatorName::OWNER)));
}

#[test]
fn an_operator_who_gives_orders_has_telemetry_of_at_most_20_ms() {
    let mut ends = connected();
    assert!(matches!(ends.say(set("telemetry_rate", 1.0)), Outcome::Parameter(_)));
    for (orders, least) in [(false, 0), (true, 49)] {
        ends.telemetry.clear();
        if orders {
            ends.give(Order::Off);
        }
        ends.wait(Duration::from_millis(990));
        let count = ends.telemetry.len();
        assert!((least..=least + 1).contains(&count), "{orders}: {count}");
    }
}

#[test]
fn telemetry_comes_at_its_rate_and_says_what_was_reported() {
    let mut ends = connected();
    ends.slow.link.set_signal(Some(-60));
    let (permit, halt) = (Permit::new(5), Halt::Rested);
    ends.observe(|report| {
        (report.permit, report.halt) = (permit, halt);
        report.modulation = u16::MAX / 4;
        report.direction = RotorAngle::from_degrees(31.0);
        // Two readings since the telemetry before: what is reported is their mean, and both.
        for (theta, current) in [(29.0, -0.5), (31.0, -1.5)] {
            let currents = [0.0, current].map(Current::from_amperes);
            report.interval.add(RotorAngle::from_degrees(theta), currents, Voltage::ZERO);
        }
        report.motors[1] = MotorReport {
            angle: RotorAngle::from_degrees(90.0),
            speed: Speed::from_hertz(10.0),
            current_d: Current::from_amperes(0.5),
            current_q: Current::from_amperes(-1.5),
        };
    });
    ends.telemetry.clear();
    ends.wait(100 * MILLISECOND);
    assert_eq!(ends.telemetry.len(), 5);
    let telemetry = ends.telemetry.pop().unwrap();
    assert_eq!((telemetry.permit, telemetry.halt), (permit, halt));
    assert!((telemetry.modulation.get() - 0.25).abs() < 1e-4);
    assert!((telemetry.direction.get() - 30.0).abs() < 1e-4);
    let motor = telemetry.motors[1];
    let ranges =
        [telemetry.direction_range.map(|it| it.get()), motor.current_q_range.map(|it| it.get())];
    for (value, expected) in ranges.concat().into_iter().zip([29.0, 31.0, -1.5, -0.5]) {
        assert!((value - expected).abs() < 1e-3, "{ranges:?}");
    }
    let values =
        [motor.angle.get(), motor.speed.get(), motor.current_d.get(), motor.current_q.get()];
    for (value, expected) in values.into_iter().zip([90.0, 10.0, 0.5, -1.0]) {
        assert!((value - expected).abs() < 1e-3, "{values:?}");
    }
    assert_eq!(
        (telemetry.link.signal_dbm, ends.slow.link.quality(ends.now).signal_dbm),
        (Some(-60), Some(-60))
    );
    // After a pause it goes on at its rate: nothing is made up for.
    let period = ends.asked().period;
    ends.now = ends.now + 10 * TELEMETRY;
    ends.drain();
    ends.wait(2 * TELEMETRY);
    assert_eq!((ends.telemetry.len(), ends.asked().period), (5 - 1 + 3, period + 3));
}

#[test]
fn telemetry_that_is_sent_late_does_not_shift_the_next() {
    let mut ends = connected();
    for (late, next) in [(TELEMETRY / 4, TELEMETRY * 3 / 4), (TELEMETRY, TELEMETRY)] {
        ends.telemetry.clear();
        ends.now = ends.slow.poll_at(ends.now).unwrap() + late;
        ends.drain();
        let due = ends.slow.poll_at(ends.now).unwrap();
        assert_eq!((ends.telemetry.len(), due.since(ends.now)), (1, next), "{late:?}");
    }
}

#[test]
fn parameters_are_listed_by_page_found_by_name_and_kept_in_range() {
    let mut ends = proven();
    let mut names = Vec::new();
    while names.len() < COUNT {
        let list = ParameterCommand::List(names.len() as u16);
        let Outcome::Parameters { total, entries } = ends.say(Command::Parameter(list)) else {
            panic!("no page after {} names", names.len())
        };
        assert_eq!(usize::from(total), COUNT);
        assert_eq!(entries.len(), PARAMETERS_PER_REPLY.min(COUNT - names.len()));
        names.extend(entries.iter().map(|entry| entry.name.clone()));
    }
    names.dedup();
    assert_eq!(names.len(), COUNT);
    let get = |name: &str| Command::Parameter(ParameterCommand::Get(name.try_into().unwrap()));
    assert_eq!(ends.say(get("warp_factor")), refused(Refusal::UnknownParameter));
    let refusal = ends.say(set("over_speed", 1e9));
    assert!(matches!(refusal, Outcome::Refused(Refusal::OutOfRange { .. })), "{refusal:?}");
    for command in [set("over_speed", 60.0), get("over_speed")] {
        let outcome = ends.say(command);
        assert!(matches!(outcome, Outcome::Parameter(ref it) if it.value == 60.0), "{outcome:?}");
    }
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    assert_eq!(ends.slow.settings(), &Settings::DEFAULT);
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Save)), Outcome::Done);
    assert!(ends.happened().contains(&Event::SettingsSaved));
}

#[test]
fn a_robot_arms_on_motor_values_that_are_entered_measured_or_accepted() {
    let reset = || Command::Parameter(ParameterCommand::Reset);
    let mut ends = proven();
    assert_eq!(ends.say(reset()), Outcome::Done);
    for (index, name) in MOTOR_VALUES.into_iter().enumerate() {
        let name: Name = name.try_into().unwrap();
        let refusal = Refusal::Assumed { name: name.clone() };
        assert!(refusal.to_string().contains("flix commission"), "{refusal}");
        assert!(refusal.to_string().contains("flix parameters accept"), "{refusal}");
        assert_eq!(ends.say(Command::Parameter(ParameterCommand::Check)), refused(refusal));
        assert!(!ends.may_arm());
        let value = ends.slow.settings().get(&name).unwrap();
        let (command, mark) = match index % 2 {
            0 => (ParameterCommand::Set(name, value), Mark::Entered),
            _ => (ParameterCommand::Put(name, value, Mark::Measured), Mark::Measured),
        };
        let outcome = ends.say(Command::Parameter(command));
        assert!(matches!(outcome, Outcome::Parameter(it) if it.mark == Some(mark)));
    }
    assert!(ends.may_arm());
    assert_eq!(ends.say(reset()), Outcome::Done);
    assert!(!ends.may_arm());
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Accept)), Outcome::Done);
    assert!(ends.may_arm());
}

#[test]
fn a_board_without_current_sense_wants_resistance_and_flux_entered() {
    let mut ends = Ends::unconnected(GENERIC_ESP32C6.hardware);
    ends.start();
    ends.live(PROVING_TIME + LINK_LATE);
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    for name in ["phase_resistance", "flux_linkage"] {
        for motor in ["top", "bottom"] {
            let name = format!("{motor}_{name}");
            let refusal = Refusal::AssumedUnmeasured { name: name.as_str().try_into().unwrap() };
            assert!(refusal.to_string().contains("flix parameters set"), "{refusal}");
            for command in [ParameterCommand::Check, ParameterCommand::Accept] {
                assert_eq!(ends.say(Command::Parameter(command)), refused(refusal.clone()));
            }
            assert!(!ends.may_arm());
            ends.say(set(&name, 4.0));
        }
    }
    assert!(ends.may_arm());
    // Nothing bounds a trial.
    let number = ends.asked().number;
    ends.give(Order::Try(ends.permit(), TRIAL));
    assert_eq!(ends.told().withheld, Some(Withheld::NoCurrentSense));
    assert_eq!(ends.asked().number, number);
}

#[test]
fn arming_is_refused_by_what_the_loops_are_now_alone() {
    let parameter = Command::Parameter;
    let mut ends = proven();
    let stable = ends.slow.settings().position_bandwidth;
    for command in [
        set("position_bandwidth", 50.0),
        // Nothing else makes it better: neither a mark, nor another alignment.
        parameter(ParameterCommand::Accept),
        set("top_electrical_offset", 12.0),
    ] {
        assert!(!matches!(ends.say(command), Outcome::Refused(_)));
        let check = ends.say(parameter(ParameterCommand::Check));
        assert!(matches!(check, Outcome::Refused(Refusal::UnstablePosition { .. })), "{check:?}");
        assert!(!ends.may_arm());
    }
    // The margin is that of both partners, one changed after the other, and back.
    ends.say(set("position_bandwidth", stable));
    assert!(ends.may_arm());
    ends.say(set("tracker_bandwidth", 40.0));
    assert!(!ends.may_arm());
    ends.say(parameter(ParameterCommand::Reset));
    let check = ends.say(parameter(ParameterCommand::Check));
    assert!(matches!(check, Outcome::Refused(Refusal::Assumed { .. })), "{check:?}");
    ends.say(parameter(ParameterCommand::Accept));
    assert!(ends.may_arm());
}

#[test]
fn each_trouble_with_a_magnet_is_an_event_once_for_each_motor() {
    let mut ends = connected();
    ends.happened();
    let mut shown = |magnets: [Magnet; 2]| {
        ends.observe(|report| {
            for (encoder, magnet) in report.encoders.iter_mut().zip(magnets) {
                encoder.magnet = magnet;
            }
        });
        ends.happened()
    };
    let event = |motor, magnet| Event::Magnet { motor, magnet };
    let troubles = Magnet::ALL.into_iter().filter(|magnet| *magnet != Magnet::Good);
    assert_eq!(shown([Magnet::Good; 2]), []);
    for magnet in troubles {
        assert_eq!(shown([magnet, Magnet::Good]), [event(0, magnet)]);
        assert_eq!(shown([Magnet::Good; 2]), [], "it is good again");
        assert_eq!(shown([magnet, magnet]), [event(1, magnet)], "one on the border comes and goes");
        assert_eq!(shown([magnet, Magnet::Good]), []);
    }
}

#[test]
fn telemetry_states_the_worst_that_an_encoder_said_of_its_magnet_within_5_s() {
    let mut ends = connected();
    let mut shown = |ms: u64, magnet: Magnet| {
        for _ in 0..ms / 100 {
            ends.wait(Duration::from_millis(100));
            ends.repeat();
        }
        ends.observe(|report| report.encoders[1].magnet = magnet);
        ends.told().encoders.map(|it| it.magnet)
    };
    let good = Magnet::Good;
    assert_eq!(shown(100, good), [good; 2]);
    assert_eq!(shown(100, Magnet::Strong), [good, Magnet::Strong]);
    assert_eq!(shown(4_500, good), [good, Magnet::Strong]);
    assert_eq!(shown(100, Magnet::Missing), [good, Magnet::Missing]);
    assert_eq!(shown(1_000, Magnet::Strong), [good, Magnet::Missing]);
    assert_eq!(shown(4_500, good), [good, Magnet::Strong]);
    assert_eq!(shown(1_000, good), [good; 2]);
}

#[test]
fn an_operator_who_leaves_or_is_revoked_leaves_a_robot_that_disarms() {
    let bob = Operator::new("bob".parse().unwrap(), &Key::new([0xb0; 32]));
    for (operators, is_over) in [
        (None, true),
        (Some(Operators::from(None)), true),
        (Some(bob.into()), true),
        (Some(Operators::from(Some(key()))), false),
    ] {
        let mut ends = at(State::Running);
        ends.give(Order::Shake(ends.permit(), PAIR));
        let before = ends.asked().halts;
        if let Some(operators) = operators {
            ends.slow.link.set_operators(operators);
        } else {
            let goodbye = ends.operator.goodbye().unwrap();
            ends.hear(&goodbye);
        }
        let wanted = if is_over { Wanted::Off } else { Wanted::Shake };
        let halts = ends.asked().halts - before;
        assert_eq!((ends.asked().wanted, halts), (wanted, u8::from(is_over)));
        assert_eq!(ends.slow.link.operator(ends.now).is_none(), is_over);
    }
}

#[test]
fn a_robot_says_who_it_is_and_who_holds_it() {
    let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
    assert_eq!((ends.slow.link.operator(ends.now), ends.slow.poll_at(ends.now)), (None, None));
    ends.start();
    assert_eq!(ends.slow.link.operator(ends.now), Some(address()));
    assert_eq!(ends.slow.link.driver(ends.now), Some(OperatorName::OWNER));
    let hardware = DENGFOC_V3_01.hardware;
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(identity("ends", &hardware)));
    assert_ne!(identity("ends", &hardware), identity("daisy", &hardware));
    ends.slow.link.set_name("daisy");
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(identity("daisy", &hardware)));
    ends.slow.link.set_reset(ResetReason::BrownOut);
    let restarted = Identity { reset: ResetReason::BrownOut, ..identity("daisy", &hardware) };
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(restarted));
    assert_eq!(ends.say(Command::Ping(41)), Outcome::Pong(41));
    let bridges = bridges(&hardware);
    assert_eq!(ends.say(Command::Bridges), Outcome::Bridges(bridges));
}

#[test]
fn a_robot_without_operators_opens_no_session() {
    let mut ends = connected();
    ends.slow.link.set_operators(None);
    assert_eq!(ends.slow.link.operator(ends.now), None);
    let mut newcomer = OperatorSession::new(key(), [5; 32], ends.now);
    let mut frame = Frame::new();
    while let Status::Connecting = newcomer.status(ends.now) {
        if let Some(said) = newcomer.poll(ends.now) {
            ends.slow.receive(ends.now, outsider(), &said);
        }
        while ends.slow.transmit(ends.now, &mut frame) == Some(outsider()) {
            let _ = newcomer.receive(ends.now, &frame);
        }
        ends.now = ends.now + MILLISECOND;
    }
    assert_eq!(newcomer.status(ends.now), Status::Failed(ConnectError::Unprovisioned));
}

#[test]
fn a_robot_reports_its_last_accident_and_keeps_faults_for_the_next() {
    let mut ends = connected();
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(None));
    let run = |link: &mut Link| {
        let mut bytes = [0; blackbox::BYTES];
        bytes[blackbox::RUN].copy_from_slice(&link.keep().unwrap());
        Kept::decode(&bytes).report(ResetReason::Tasks).unwrap()
    };
    let build = Some(BuildId([7; 8]));
    ends.slow.link.set_build(build);
    let quiet = run(&mut ends.slow.link);
    assert_eq!((quiet.version.as_str(), quiet.fault), (env!("CARGO_PKG_VERSION"), None));
    assert_eq!(quiet.build, build);
    ends.observe(|report| {
        report.faults = Faults::NONE.with(Fault::Stall);
        report.first_fault = Some(Fault::Stall);
    });
    let kept = run(&mut ends.slow.link);
    assert_eq!(kept.fault.unwrap().first_fault, Some(Fault::Stall));
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(None), "that was this run");
    ends.slow.link.set_crash(Some(kept.clone()));
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(Some(kept)));
}
