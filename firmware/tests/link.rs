//! The robot's end of the link alone: what an operator may ask for in each state, and what comes back. The fast half
//! is a report that the test writes.

use core::net::SocketAddr;
use core::time::Duration;

use crate::no_store::NoStore;
use flix_firmware::blackbox::{self, Kept};
use flix_firmware::board::{DENGFOC_V3_01, GENERIC_ESP32C6};
use flix_firmware::fast::exchange::{Asked, EventCounters, MotorReport, Report, Wanted};
use flix_firmware::hardware::Hardware;
use flix_firmware::link::{EVENTS, Link, bridges, identity};
use flix_firmware::robot::Robot;
use flix_firmware::settings::{COUNT, MOTOR_VALUES, Settings, Tuning};
use flix_firmware::units::{Current, RotorAngle, Speed, Voltage};
use flix_protocol::failsafe::{COMMAND_AGE, LINK_LATE, PROVING_TIME};
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, Event, Fault, Faults, Identity, Magnet, Mark, Name, OperatorName, Order, Outcome,
    PARAMETERS_PER_REPLY, ParameterCommand, Pattern, Permit, Refusal, ResetReason, ScopeCommand,
    ScopePlan, Setpoint, State, Telemetry, ToOperator, ToRobot, Trial,
};
use flix_protocol::session::{
    ConnectError, Key, Operator, OperatorReceived, OperatorSession, Operators, STOP_RETRY, Status,
    StopSession, StopStatus,
};
use flix_protocol::units::{Degrees, Hertz, Instant, Volts};

const MILLISECOND: Duration = Duration::from_millis(1);
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

/// A link and its operator, whose datagrams arrive at once.
struct Ends {
    link: Link,
    tuning: Tuning<NoStore>,
    operator: OperatorSession,
    intent: u8,
    halts: u8,
    now: Instant,
    report: Report,
    outcomes: Vec<Outcome>,
    events: Vec<(u32, Event)>,
    telemetry: Vec<Telemetry>,
}

fn key() -> Key {
    Key::new([9; 32])
}

fn outsider() -> SocketAddr {
    ([192, 168, 4, 3], 4_000).into()
}

fn address() -> SocketAddr {
    ([192, 168, 4, 2], 4_000).into()
}

fn setpoint(frequency: f32, direction: f32) -> Setpoint {
    Setpoint::new(Hertz::new(frequency).unwrap(), Degrees::new(direction).unwrap()).unwrap()
}

fn refused(refusal: Refusal) -> Outcome {
    Outcome::Refused(refusal)
}

impl Ends {
    fn unconnected() -> Self {
        Self::on(DENGFOC_V3_01.hardware)
    }

    fn on(hardware: Hardware) -> Self {
        let report = Robot::new(hardware, "ends", None, [1; 32], NoStore).report();
        let (tuning, now) = (Tuning::new(NoStore), Instant::from_micros(1_000));
        let name = identity("ends", &hardware);
        let link = Link::new(name, &hardware, Some(key()), [2; 32], tuning.settings(), report);
        let operator = OperatorSession::new(key(), [3; 32], now);
        let (outcomes, events, telemetry) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            link,
            tuning,
            operator,
            intent: 0,
            halts: 0,
            now,
            report,
            outcomes,
            events,
            telemetry,
        }
    }

    fn connected() -> Self {
        let mut ends = Self::unconnected();
        ends.connect();
        ends
    }

    /// With a link that was steady for long enough to arm.
    fn proven() -> Self {
        let mut ends = Self::connected();
        ends.live(PROVING_TIME + LINK_LATE);
        ends
    }

    /// The same, in this state.
    fn at(state: State) -> Self {
        let mut ends = Self::proven();
        ends.observe(|report| report.state = state);
        ends
    }

    fn connect(&mut self) {
        while self.operator.status(self.now) != Status::Connected {
            let frame = self.operator.poll(self.now).unwrap();
            self.hear(&frame);
        }
        // The fast half counts the session.
        self.observe(|_| {});
        self.drain();
    }

    fn hear(&mut self, datagram: &[u8]) {
        self.link.receive(self.now, address(), datagram, &mut self.tuning);
        self.drain();
    }

    /// Gives the operator all that the link has to send now.
    fn drain(&mut self) {
        let mut frame = Frame::new();
        while self.link.poll_at(self.now).is_some_and(|at| at <= self.now) {
            let to = self.link.transmit(self.now, self.tuning.settings(), &mut frame);
            assert_eq!(to, Some(address()), "there was something to send");
            match self.operator.receive(self.now, &frame) {
                OperatorReceived::Message(ToOperator::Reply(reply)) => {
                    self.outcomes.push(reply.outcome);
                }
                OperatorReceived::Message(ToOperator::Event(event)) => {
                    self.events.push((event.number, event.event));
                }
                OperatorReceived::Message(ToOperator::Telemetry(telemetry)) => {
                    self.telemetry.push(telemetry);
                }
                _ => {}
            }
        }
    }

    fn seal(&mut self, command: Command) -> Frame {
        self.seal_as(7, command)
    }

    fn seal_as(&mut self, request: u32, command: Command) -> Frame {
        let message = ToRobot { request, intent: self.intent, halts: self.halts, command };
        self.operator.send(self.now, &message).unwrap()
    }

    /// Whatever the operator asks for from now on, he knows of all halts.
    fn hear_of_halts(&mut self) {
        self.live(TELEMETRY);
        self.halts = self.telemetry.last().unwrap().halts;
    }

    fn say(&mut self, command: Command) -> Outcome {
        let frame = self.seal(command);
        self.hear(&frame);
        self.outcomes.pop().expect("every command is answered at once")
    }

    fn wait(&mut self, time: Duration) {
        for _ in 0..time.as_millis() {
            self.now = self.now + MILLISECOND;
            self.drain();
        }
    }

    /// Waits with a ping every 20 ms.
    fn live(&mut self, time: Duration) {
        for _ in 0..time.as_millis() / 20 {
            self.wait(20 * MILLISECOND);
            self.say(Command::Ping(0));
        }
    }

    /// Returns the order in force, and how many stops are to latch.
    fn asked(&self) -> (Wanted, u8) {
        (self.link.asked().wanted, self.link.asked().stops)
    }

    fn observe(&mut self, change: impl FnOnce(&mut Report)) {
        self.report.time = self.now;
        let Asked { number, stops, halts, .. } = *self.link.asked();
        (self.report.obeyed, self.report.stops, self.report.halts) = (number, stops, halts);
        change(&mut self.report);
        self.link.observe(&self.report);
    }

    fn happened(&mut self) -> Vec<Event> {
        self.wait(TELEMETRY);
        self.events.drain(..).map(|(_, event)| event).collect()
    }
}

#[test]
fn each_state_accepts_what_its_rotors_may_do_and_refuses_the_rest_with_its_name() {
    use State::{Aligning, Armed, Disarmed, Faulted, Running, Stopping};
    let [off, shake, stop, clear] =
        [(Wanted::Off, 0), (Wanted::Shake, 0), (Wanted::Off, 1), (Wanted::Clear, 0)];
    let set = ParameterCommand::Set("over_speed".try_into().unwrap(), 60.0);
    for (command, accepting, asks) in [
        (Command::Setpoint(setpoint(20.0, 30.0)), &[Armed, Running, Stopping][..], shake),
        (Command::Disarm, &STATES, off),
        (Command::Stop, &STATES, stop),
        (Command::Clear, &STATES, clear),
        (Command::Parameter(set), &[Disarmed, Faulted], off),
        (Command::Parameter(ParameterCommand::Reset), &[Disarmed, Faulted], off),
        (Command::Parameter(ParameterCommand::Save), &[Disarmed, Faulted], off),
        (Command::Parameter(ParameterCommand::Accept), &[Disarmed, Faulted], off),
        (Command::Parameter(ParameterCommand::Check), &STATES, off),
        (Command::Ping(5), &STATES, off),
        (Command::Crash, &STATES, off),
        (Command::Bridges, &STATES, off),
    ] {
        for state in STATES {
            let mut ends = Ends::at(state);
            let outcome = ends.say(command.clone());
            let is_accepted = accepting.contains(&state);
            assert_eq!(
                is_accepted,
                outcome != refused(Refusal::State(state)),
                "{command:?} while {state}: {outcome:?}"
            );
            assert!(is_accepted != matches!(outcome, Outcome::Refused(_)), "{outcome:?}");
            let is_latched = matches!(state, Disarmed | Faulted);
            let expected = if is_accepted && (is_latched || asks != clear) { asks } else { off };
            assert_eq!(ends.asked(), expected, "{command:?} while {state}");
        }
    }
    for (state, outcome, asks) in [
        (Disarmed, Outcome::Done, Wanted::Arm),
        (Aligning, Outcome::Done, Wanted::Off),
        (Armed, Outcome::Done, Wanted::Off),
        (Running, Outcome::Done, Wanted::Off),
        (Stopping, refused(Refusal::State(Stopping)), Wanted::Off),
        (Faulted, refused(Refusal::State(Faulted)), Wanted::Off),
    ] {
        let mut ends = Ends::at(state);
        assert_eq!((ends.say(Command::Arm), ends.asked()), (outcome, (asks, 0)), "{state}");
    }
}

#[test]
fn a_setpoint_is_handed_on_and_shown_until_the_robot_ramps_down() {
    let shown = |ends: &mut Ends| {
        ends.wait(TELEMETRY);
        ends.telemetry.last().unwrap().setpoint
    };
    type Act = fn(&mut Ends);
    let ends_it: [Act; 5] = [
        |ends| drop(ends.say(Command::Disarm)),
        |ends| drop(ends.say(Command::Stop)),
        |ends| ends.observe(|report| report.state = State::Disarmed),
        |ends| ends.observe(|report| report.state = State::Aligning),
        |ends| ends.observe(|report| report.state = State::Faulted),
    ];
    for act in ends_it {
        let mut ends = Ends::at(State::Armed);
        ends.say(Command::Setpoint(setpoint(20.0, 30.0)));
        let asked = *ends.link.asked();
        assert_eq!((asked.frequency, asked.wanted), (Speed::from_hertz(20.0), Wanted::Shake));
        assert_eq!(asked.direction, RotorAngle::from_degrees(30.0));
        assert_eq!(shown(&mut ends), setpoint(20.0, 30.0));
        act(&mut ends);
        assert_eq!(shown(&mut ends), Setpoint::REST);
    }
}

#[test]
fn rotors_that_came_to_rest_by_silence_turn_again_only_on_another_intent() {
    let walk = || Command::Setpoint(setpoint(20.0, 30.0));
    let mut ends = Ends::at(State::Armed);
    assert_eq!(ends.say(walk()), Outcome::Done);
    // A dip: what goes on before it rests needs no other intent.
    for state in [State::Running, State::Stopping] {
        ends.observe(|report| report.state = state);
        assert_eq!(ends.say(walk()), Outcome::Done, "{state:?}");
    }
    ends.observe(|report| (report.state, report.permit) = (State::Armed, RESTED));
    assert_ne!(ends.link.asked().permit, RESTED);
    for _ in 0..2 {
        ends.wait(TELEMETRY);
        assert_eq!(ends.telemetry.last().unwrap().setpoint.frequency(), Hertz::ZERO);
        assert_eq!(ends.say(walk()), refused(Refusal::Rested));
        assert_eq!(ends.say(Command::Setpoint(setpoint(0.0, 30.0))), Outcome::Done);
        assert_eq!(ends.link.asked().frequency, Speed::ZERO);
        ends.observe(|_| {});
    }
    // Somebody who did not know yet that they rest.
    ends.intent = 1;
    assert_eq!(ends.say(walk()), refused(Refusal::Rested));
    ends.wait(TELEMETRY);
    (ends.intent, ends.halts) = (2, ends.telemetry.last().unwrap().halts);
    for _ in 0..2 {
        assert_eq!(ends.say(walk()), Outcome::Done, "it goes on with what began it");
    }
    let asked = *ends.link.asked();
    assert_eq!((asked.frequency, asked.permit), (Speed::from_hertz(20.0), RESTED));
    // Nor does one that was asked for earlier, and one that is armed anew starts from nothing.
    for state in [State::Stopping, State::Armed, State::Disarmed] {
        ends.observe(|report| report.state = state);
    }
    ends.live(PROVING_TIME);
    ends.hear_of_halts();
    assert_eq!(ends.say(Command::Arm), Outcome::Done);
    ends.observe(|report| report.state = State::Armed);
    assert_eq!(ends.say(walk()), Outcome::Done);
}

#[test]
fn motors_that_were_let_go_in_silence_while_they_were_aligned_count_as_a_halt() {
    for by_silence in [true, false] {
        let mut ends = Ends::at(State::Aligning);
        ends.live(TELEMETRY);
        let before = ends.telemetry.last().unwrap().halts;
        ends.observe(|report| {
            report.state = State::Disarmed;
            report.events.command_deadline += u8::from(by_silence);
        });
        ends.live(2 * TELEMETRY);
        let after = ends.telemetry.last().unwrap().halts;
        assert_eq!(after.wrapping_sub(before), u8::from(by_silence));
    }
}

#[test]
fn a_robot_that_was_asked_to_ramp_down_takes_no_setpoint_until_it_did() {
    for command in [Command::Disarm, Command::Stop] {
        let mut ends = Ends::at(State::Running);
        ends.say(command.clone());
        let late = ends.say(Command::Setpoint(setpoint(20.0, 0.0)));
        let clear = ends.say(Command::Clear);
        let stopping = refused(Refusal::State(State::Stopping));
        let latched =
            if command == Command::Stop { refused(Refusal::Stopped) } else { stopping.clone() };
        assert_eq!([late, clear], [latched, stopping]);
        ends.observe(|report| report.state = State::Disarmed);
        assert_eq!(ends.say(Command::Clear), Outcome::Done);
    }
}

#[test]
fn a_robot_that_was_disarmed_before_it_began_to_arm_is_armed_again_only_once_it_obeyed() {
    let mut ends = Ends::at(State::Disarmed);
    let asked = [Command::Arm, Command::Disarm, Command::Arm].map(|command| ends.say(command));
    assert_eq!(asked, [Outcome::Done, Outcome::Done, refused(Refusal::State(State::Stopping))]);
    ends.observe(|_| {});
    assert_eq!(ends.say(Command::Arm), Outcome::Done);
}

#[test]
fn a_stop_from_outside_is_answered_with_rest_once_it_is_latched_and_nothing_is_driven() {
    for (stopped, state, status) in [
        (false, State::Disarmed, StopStatus::Latched),
        (true, State::Stopping, StopStatus::Latched),
        (true, State::Disarmed, StopStatus::AtRest),
    ] {
        let mut ends = Ends::at(state);
        let mut stop = StopSession::new(&key(), [4; 32], ends.now);
        let mut frame = Frame::new();
        // Hello, the first Stop, and again once the robot has obeyed or not.
        for turn in 0..3 {
            if turn == 2 {
                ends.observe(|report| (report.stopped, report.state) = (stopped, state));
                ends.now = ends.now + STOP_RETRY;
            }
            let asked = stop.poll(ends.now).unwrap();
            ends.link.receive(ends.now, outsider(), &asked, &mut ends.tuning);
            let to = ends.link.transmit(ends.now, ends.tuning.settings(), &mut frame);
            assert_eq!(to, Some(outsider()));
            stop.receive(ends.now, &frame).unwrap();
        }
        assert_eq!(stop.status(), status, "{stopped} {state}");
    }
}

#[test]
fn a_stop_from_outside_is_cleared_by_nobody_who_has_not_heard_of_it() {
    let mut ends = Ends::at(State::Disarmed);
    ends.live(TELEMETRY);
    // Sealed before, it arrives after.
    let early = ends.seal(Command::Clear);
    let mut stop = StopSession::new(&key(), [4; 32], ends.now);
    let mut frame = Frame::new();
    for _ in 0..2 {
        let asked = stop.poll(ends.now).unwrap();
        ends.link.receive(ends.now, outsider(), &asked, &mut ends.tuning);
        ends.link.transmit(ends.now, ends.tuning.settings(), &mut frame);
        stop.receive(ends.now, &frame).unwrap();
    }
    ends.observe(|report| report.stopped = true);
    ends.hear(&early);
    assert_eq!(ends.outcomes.pop(), Some(refused(Refusal::Stopped)));
    ends.live(2 * TELEMETRY);
    assert_eq!(ends.say(Command::Clear), refused(Refusal::Stopped), "asked for before");
    ends.hear_of_halts();
    assert_eq!(ends.say(Command::Clear), Outcome::Done);
    // A stop that was cleared holds up no clear of later ones, however often the rotors came to rest since.
    ends.halts = ends.halts.wrapping_add(i8::MAX as u8 + 2);
    assert_eq!(ends.say(Command::Clear), Outcome::Done);
}

#[test]
fn a_robot_that_halted_is_armed_by_nobody_who_has_not_heard_of_it() {
    let lost: fn(&mut Report) = |report| report.events.link_lost += 1;
    let rested: fn(&mut Report) = |report| report.state = State::Stopping;
    for (from, halt) in [
        (State::Armed, lost),
        (State::Running, lost),
        (State::Stopping, lost),
        (State::Running, rested),
    ] {
        let mut ends = Ends::at(from);
        ends.observe(halt);
        for state in [State::Armed, State::Disarmed] {
            ends.observe(|report| report.state = state);
        }
        ends.live(PROVING_TIME);
        assert_eq!(ends.say(Command::Arm), refused(Refusal::Rested), "{from}");
        ends.hear_of_halts();
        assert_eq!(ends.say(Command::Arm), Outcome::Done, "{from}");
        // Repeated, it is answered again, whatever its operator knew: it is armed.
        ends.observe(|report| report.state = State::Armed);
        ends.halts = ends.halts.wrapping_sub(1);
        assert_eq!(ends.say(Command::Arm), Outcome::Done, "{from}");
    }
}

#[test]
fn a_robot_that_its_operator_disarmed_has_not_halted_by_itself() {
    for command in [Command::Disarm, Command::Stop] {
        let mut ends = Ends::at(State::Running);
        ends.say(command);
        ends.observe(|report| report.events.link_lost += 1);
        ends.observe(|report| report.state = State::Disarmed);
        // Nor has one that was at rest.
        ends.observe(|report| report.events.link_lost += 1);
        ends.live(TELEMETRY);
        assert_eq!(ends.telemetry.last().unwrap().halts, 0);
    }
}

#[test]
fn a_fault_is_cleared_by_nobody_who_has_not_heard_of_it() {
    let mut ends = Ends::at(State::Armed);
    let fail = |ends: &mut Ends, fault| {
        ends.observe(|report| {
            report.state = State::Faulted;
            report.faults = report.faults.with(fault);
        });
    };
    let early = ends.seal(Command::Clear);
    fail(&mut ends, Fault::Stall);
    ends.hear(&early);
    let stall = Faults::NONE.with(Fault::Stall);
    assert_eq!(ends.outcomes.pop(), Some(refused(Refusal::Faulted(stall))));
    ends.hear_of_halts();
    fail(&mut ends, Fault::OverCurrent);
    let both = stall.with(Fault::OverCurrent);
    assert_eq!(ends.say(Command::Clear), refused(Refusal::Faulted(both)), "another one since");
    ends.hear_of_halts();
    ends.observe(|_| {});
    assert_eq!(ends.say(Command::Clear), Outcome::Done);
    ends.observe(|report| (report.state, report.faults) = (State::Disarmed, Faults::NONE));
    ends.live(PROVING_TIME);
    assert_eq!(ends.say(Command::Arm), Outcome::Done, "its operator knew of both");
}

#[test]
fn what_was_asked_before_the_newest_change_undoes_nothing_when_it_is_repeated() {
    let current = |value| {
        let name = "current_limit".try_into().unwrap();
        Command::Parameter(ParameterCommand::Set(name, value))
    };
    for (earlier, newer) in [
        (Command::Arm, Command::Disarm),
        (Command::Clear, Command::Stop),
        (current(2.4), current(0.9)),
    ] {
        let mut ends = Ends::at(State::Disarmed);
        let newer = ends.seal_as(9, newer);
        ends.hear(&newer);
        assert!(ends.outcomes.pop().is_some());
        let asked = *ends.link.asked();
        // Asked again by a client that repeats everything side by side.
        let earlier = ends.seal_as(8, earlier);
        ends.hear(&earlier);
        assert_eq!(ends.outcomes.pop(), None);
        let Asked { wanted, number, stops, .. } = *ends.link.asked();
        assert_eq!((wanted, number, stops), (asked.wanted, asked.number, asked.stops));
        assert!(ends.tuning.settings().current_limit < 2.4);
    }
    // A question overtakes nothing, and is not overtaken.
    for (earlier, newer) in [(current(0.9), Command::Ping(9)), (Command::Ping(8), current(0.9))] {
        let mut ends = Ends::at(State::Disarmed);
        for (number, command) in [(9, newer), (8, earlier)] {
            let frame = ends.seal_as(number, command);
            ends.hear(&frame);
            assert!(ends.outcomes.pop().is_some());
        }
    }
    // What makes the motors coast is obeyed however old it is.
    for (number, command) in [(3, Command::Disarm), (2, Command::Stop)] {
        let mut ends = Ends::at(State::Running);
        let frame = ends.seal_as(number, command);
        ends.hear(&frame);
        assert_eq!(ends.outcomes.pop(), Some(Outcome::Done));
    }
}

#[test]
fn a_stop_and_a_fault_are_named_until_they_are_cleared() {
    let faults = Faults::NONE.with(Fault::Stall);
    for command in [Command::Arm, Command::Setpoint(setpoint(20.0, 0.0))] {
        let mut ends = Ends::at(State::Disarmed);
        ends.observe(|report| report.stopped = true);
        assert_eq!(ends.say(command.clone()), refused(Refusal::Stopped));
        // A robot that a program stopped because of the fault has both.
        for stopped in [true, false] {
            ends.observe(|report| (report.stopped, report.faults) = (stopped, faults));
            assert_eq!(ends.say(command.clone()), refused(Refusal::Faulted(faults)));
        }
    }
}

#[test]
fn a_latched_stop_is_reported_with_who_asked_for_it() {
    let mut ends = Ends::at(State::Running);
    let shown = |ends: &mut Ends, stopped| {
        ends.observe(|report| report.stopped = stopped);
        ends.wait(TELEMETRY);
        ends.telemetry.last().unwrap().stopped_by
    };
    assert_eq!(shown(&mut ends, false), None);
    ends.say(Command::Stop);
    assert_eq!(shown(&mut ends, true), Some(OperatorName::OWNER));
    assert_eq!(shown(&mut ends, false), None, "cleared");
}

#[test]
fn arming_wants_commands_without_a_gap_for_the_proving_time() {
    // Commands so often, for so long, and a last one so much later.
    for (every, time, gap, outcome) in [
        (99, PROVING_TIME, 0, Outcome::Done),
        (100, 2 * PROVING_TIME, 0, refused(Refusal::LinkUnproven)),
        (50, PROVING_TIME - 100 * MILLISECOND, 99, refused(Refusal::LinkUnproven)),
        (50, PROVING_TIME - 50 * MILLISECOND, 50, Outcome::Done),
        (50, PROVING_TIME, 99, Outcome::Done),
        (50, PROVING_TIME, 100, refused(Refusal::LinkUnproven)),
    ] {
        let mut ends = Ends::connected();
        ends.say(Command::Ping(0));
        for _ in 0..(time.as_millis() as u32).div_ceil(every) {
            ends.wait(every * MILLISECOND);
            ends.say(Command::Ping(0));
        }
        ends.wait(gap * MILLISECOND);
        assert_eq!(ends.say(Command::Arm), outcome, "{every} {time:?} {gap}");
    }
}

#[test]
fn any_command_is_a_sign_of_life_at_rest_and_a_setpoint_alone_while_rotors_turn() {
    let mut ends = Ends::at(State::Armed);
    let heard = |ends: &mut Ends, command| {
        ends.wait(10 * MILLISECOND);
        ends.say(command);
        let asked = ends.link.asked();
        let age = asked.expires.since(asked.heard);
        assert!(age <= COMMAND_AGE && age > COMMAND_AGE - 2 * TELEMETRY, "{age:?}");
        asked.heard == ends.now
    };
    let ping = heard(&mut ends, Command::Ping(0));
    let turn = heard(&mut ends, Command::Setpoint(setpoint(20.0, 0.0)));
    let ping_while_turning = heard(&mut ends, Command::Ping(0));
    let again = heard(&mut ends, Command::Setpoint(setpoint(20.0, 0.0)));
    assert_eq!([ping, turn, ping_while_turning, again], [true, true, false, true]);
}

#[test]
fn what_comes_too_late_is_refused_with_its_age_but_for_stopping_and_reading() {
    let read = ParameterCommand::Get("over_speed".try_into().unwrap());
    let set = ParameterCommand::Set("over_speed".try_into().unwrap(), 60.0);
    for (command, counts) in [
        (Command::Stop, true),
        (Command::Disarm, true),
        (Command::Identify, true),
        (Command::Crash, true),
        (Command::Bridges, true),
        (Command::Ping(3), true),
        (Command::Parameter(read), true),
        (Command::Parameter(ParameterCommand::List(0)), true),
        (Command::Parameter(ParameterCommand::Check), true),
        (Command::Parameter(ParameterCommand::Accept), false),
        (Command::Scope(ScopeCommand::Status), true),
        (Command::Scope(ScopeCommand::Read(0)), true),
        (Command::Setpoint(setpoint(20.0, 0.0)), false),
        (Command::Arm, false),
        (Command::Clear, false),
        (Command::Parameter(set), false),
        (Command::Scope(ScopeCommand::Begin(ScopePlan::watch())), false),
    ] {
        let mut ends = Ends::at(State::Armed);
        let [first, second] = [ends.seal(command.clone()), ends.seal(command.clone())];
        ends.happened();
        let heard = ends.link.asked().heard;
        ends.wait(COMMAND_AGE + 100 * MILLISECOND);
        ends.hear(&first);
        ends.hear(&second);
        let late = ends.happened();
        let [Event::CommandsLate { age_ms, limit_ms: 400 }] = late[..] else { panic!("{late:?}") };
        assert!((500..560).contains(&age_ms), "{age_ms} ms");
        let is_late = |outcome: &Outcome| matches!(outcome, Outcome::Refused(Refusal::Late { .. }));
        assert_eq!(
            ends.outcomes.iter().filter(|outcome| is_late(outcome)).count(),
            2 * usize::from(!counts)
        );
        assert_eq!(ends.link.asked().heard, heard, "{command:?} is no sign of life");
    }
}

#[test]
fn a_slow_link_is_reported_again_only_after_it_was_steady() {
    for (steady, reports) in [(PROVING_TIME - LINK_LATE, 0), (PROVING_TIME + LINK_LATE, 1)] {
        let mut ends = Ends::proven();
        let late = |ends: &mut Ends| {
            let kept = ends.seal(Command::Ping(0));
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
fn the_command_age_counts_as_soon_as_it_is_set_and_until_it_is_reset() {
    let limit = |ends: &mut Ends| {
        ends.live(PROVING_TIME + LINK_LATE);
        let frame = ends.seal(Command::Arm);
        ends.wait(Duration::from_millis(1_500));
        ends.hear(&frame);
        match ends.outcomes.pop() {
            Some(Outcome::Refused(Refusal::Late { limit_ms, .. })) => limit_ms,
            other => panic!("{other:?}"),
        }
    };
    let mut ends = Ends::proven();
    let set = ParameterCommand::Set("command_age".try_into().unwrap(), 0.8);
    ends.say(Command::Parameter(set));
    let longer = limit(&mut ends);
    ends.say(Command::Parameter(ParameterCommand::Reset));
    assert_eq!([longer, limit(&mut ends)], [800, 400]);
}

/// The age of commands and the ramp down are 0.85 s together at most: the promise holds for the settings that are in force.
#[test]
fn a_robot_arms_with_no_age_of_commands_that_lets_rotors_turn_longer_than_promised() {
    let set = |ends: &mut Ends, name: &str, value: f32| {
        let outcome =
            ends.say(Command::Parameter(ParameterCommand::Set(name.try_into().unwrap(), value)));
        assert!(matches!(outcome, Outcome::Parameter(it) if it.value == value), "{name}");
    };
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
        let mut ends = Ends::proven();
        set(&mut ends, "frequency_ramp", ramp);
        set(&mut ends, "command_age", age);
        let wanted = longest.map_or(Outcome::Done, |maximum| {
            let name = "command_age".try_into().unwrap();
            Outcome::Refused(Refusal::OutOfRange { name, minimum: 0.1, maximum })
        });
        for command in [Command::Parameter(ParameterCommand::Check), Command::Arm] {
            assert_eq!(ends.say(command), wanted, "{age} s, {ramp} Hz/s");
        }
        // It is refused, and never changed.
        let get = ParameterCommand::Get("command_age".try_into().unwrap());
        let outcome = ends.say(Command::Parameter(get));
        assert!(matches!(outcome, Outcome::Parameter(it) if it.value == age), "{age} s");
    }
}

#[test]
fn what_the_fast_half_reports_becomes_one_event_each_with_numbers_that_count_up() {
    let mut ends = Ends::connected();
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
fn of_too_many_events_the_newest_stay() {
    let mut ends = Ends::unconnected();
    for number in 0..EVENTS + 5 {
        ends.link.add_event(ends.now, if number < 5 { Event::Stopped } else { Event::Cleared });
    }
    ends.connect();
    let events = ends.happened();
    assert_eq!(events.len(), EVENTS);
    assert_eq!(events.iter().filter(|event| **event == Event::Cleared).count(), EVENTS - 1);
    assert_eq!(events.last(), Some(&Event::OperatorConnected(OperatorName::OWNER)));
}

#[test]
fn an_operator_who_gives_orders_has_telemetry_of_at_most_20_ms() {
    let mut ends = Ends::connected();
    let rate = ParameterCommand::Set("telemetry_rate".try_into().unwrap(), 1.0);
    assert!(matches!(ends.say(Command::Parameter(rate)), Outcome::Parameter(_)));
    for (orders, least) in [(false, 0), (true, 49)] {
        ends.telemetry.clear();
        if orders {
            let order = ends.seal(Command::Order(Order::Off));
            ends.hear(&order);
        }
        ends.wait(Duration::from_millis(990));
        let count = ends.telemetry.len();
        assert!((least..=least + 1).contains(&count), "{orders}: {count}");
    }
}

#[test]
fn telemetry_comes_at_its_rate_and_says_what_was_reported() {
    let mut ends = Ends::connected();
    ends.link.set_signal(Some(-60));
    ends.observe(|report| {
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
        (telemetry.link.signal_dbm, ends.link.quality(ends.now).signal_dbm),
        (Some(-60), Some(-60))
    );
    // After a pause it goes on at its rate: nothing is made up for.
    let period = ends.link.asked().period;
    ends.now = ends.now + 10 * TELEMETRY;
    ends.drain();
    ends.wait(2 * TELEMETRY);
    assert_eq!((ends.telemetry.len(), ends.link.asked().period), (5 - 1 + 3, period + 3));
}

#[test]
fn telemetry_that_is_sent_late_does_not_shift_the_next_and_a_whole_interval_late_counts_for_both() {
    let mut ends = Ends::connected();
    for (late, next) in [(TELEMETRY / 4, TELEMETRY * 3 / 4), (TELEMETRY, TELEMETRY)] {
        ends.telemetry.clear();
        ends.now = ends.link.poll_at(ends.now).unwrap() + late;
        ends.drain();
        let due = ends.link.poll_at(ends.now).unwrap();
        assert_eq!((ends.telemetry.len(), due.since(ends.now)), (1, next), "{late:?}");
    }
}

#[test]
fn parameters_are_listed_page_by_page_found_by_name_and_kept_in_range() {
    let mut ends = Ends::proven();
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
    let mut say = |command| ends.say(Command::Parameter(command));
    let get = |name: &str| ParameterCommand::Get(name.try_into().unwrap());
    let set = |name: &str, value| ParameterCommand::Set(name.try_into().unwrap(), value);
    assert_eq!(say(get("warp_factor")), refused(Refusal::UnknownParameter));
    let refusal = say(set("over_speed", 1e9));
    assert!(matches!(refusal, Outcome::Refused(Refusal::OutOfRange { .. })), "{refusal:?}");
    let Outcome::Parameter(changed) = say(set("over_speed", 60.0)) else { panic!("not set") };
    let Outcome::Parameter(read) = say(get("over_speed")) else { panic!("not found") };
    assert_eq!((changed.value, read.value), (60.0, 60.0));
    assert_eq!(say(ParameterCommand::Reset), Outcome::Done);
    assert_eq!(ends.tuning.settings(), &Settings::DEFAULT);
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Save)), Outcome::Done);
    assert!(ends.happened().contains(&Event::SettingsSaved));
}

#[test]
fn a_robot_does_not_arm_on_assumed_motors_until_their_values_are_entered_or_measured() {
    let mut ends = Ends::proven();
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    for (index, name) in MOTOR_VALUES.into_iter().enumerate() {
        let name: Name = name.try_into().unwrap();
        let refusal = Refusal::Assumed { name: name.clone() };
        assert!(refusal.to_string().contains("flix commission"), "{refusal}");
        assert!(refusal.to_string().contains("flix parameters accept"), "{refusal}");
        for command in [Command::Arm, Command::Parameter(ParameterCommand::Check)] {
            assert_eq!(ends.say(command), refused(refusal.clone()));
        }
        let value = ends.tuning.settings().get(&name).unwrap();
        let mark = if index % 2 == 0 { Mark::Entered } else { Mark::Measured };
        let command = match mark {
            Mark::Entered => ParameterCommand::Set(name, value),
            mark => ParameterCommand::Put(name, value, mark),
        };
        let Outcome::Parameter(put) = ends.say(Command::Parameter(command)) else {
            panic!("not set")
        };
        assert_eq!(put.mark, Some(mark));
    }
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Check)), Outcome::Done);
    assert_eq!(ends.say(Command::Arm), Outcome::Done);
}

#[test]
fn what_is_assumed_is_taken_on_request_where_currents_are_measured() {
    let mut ends = Ends::proven();
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    assert!(matches!(ends.say(Command::Arm), Outcome::Refused(Refusal::Assumed { .. })));
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Accept)), Outcome::Done);
    assert_eq!(ends.say(Command::Arm), Outcome::Done);
}

#[test]
fn in_voltage_mode_resistance_and_flux_are_entered_and_nothing_else_will_do() {
    let mut ends = Ends::on(GENERIC_ESP32C6.hardware);
    ends.connect();
    ends.live(PROVING_TIME + LINK_LATE);
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    let accept = Command::Parameter(ParameterCommand::Accept);
    for name in ["phase_resistance", "flux_linkage"] {
        for motor in ["top", "bottom"] {
            let name: Name = format!("{motor}_{name}").as_str().try_into().unwrap();
            let refusal = Refusal::AssumedUnmeasured { name: name.clone() };
            assert!(refusal.to_string().contains("flix parameters set"), "{refusal}");
            assert_eq!(ends.say(Command::Arm), refused(refusal.clone()));
            assert_eq!(ends.say(accept.clone()), refused(refusal));
            ends.say(Command::Parameter(ParameterCommand::Set(name, 4.0)));
        }
    }
    assert_eq!(ends.say(Command::Arm), Outcome::Done);
}

#[test]
fn arming_is_refused_by_what_the_loops_are_now_and_by_nothing_that_was_before() {
    let unstable =
        |outcome: &Outcome| matches!(outcome, Outcome::Refused(Refusal::UnstablePosition { .. }));
    let set = |ends: &mut Ends, name: &str, value| {
        ends.say(Command::Parameter(ParameterCommand::Set(name.try_into().unwrap(), value)))
    };
    let said = |ends: &mut Ends| {
        let check = ends.say(Command::Parameter(ParameterCommand::Check));
        let arm = ends.say(Command::Arm);
        assert_eq!(check, arm);
        check
    };
    let mut ends = Ends::proven();
    let stable = ends.tuning.settings().position_bandwidth;
    assert!(matches!(set(&mut ends, "position_bandwidth", 50.0), Outcome::Parameter(_)));
    assert!(unstable(&said(&mut ends)));
    // Nothing else makes it better: neither a mark, nor another alignment.
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Accept)), Outcome::Done);
    assert!(unstable(&said(&mut ends)));
    set(&mut ends, "top_electrical_offset", 12.0);
    assert!(unstable(&said(&mut ends)));
    // What the loops are changes with their partners, one after the other, and back.
    set(&mut ends, "position_bandwidth", stable);
    set(&mut ends, "tracker_bandwidth", 40.0);
    assert!(unstable(&said(&mut ends)));
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Reset)), Outcome::Done);
    assert!(matches!(ends.say(Command::Arm), Outcome::Refused(Refusal::Assumed { .. })));
    assert_eq!(ends.say(Command::Parameter(ParameterCommand::Accept)), Outcome::Done);
    assert_eq!(said(&mut ends), Outcome::Done);
}

#[test]
fn each_trouble_with_a_magnet_is_an_event_once_for_each_motor() {
    let mut ends = Ends::connected();
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
fn another_operator_inherits_no_running_robot() {
    for leave in [false, true] {
        let mut ends = Ends::at(State::Running);
        let before = ends.link.asked().halts;
        if leave {
            let goodbye = ends.operator.goodbye().unwrap();
            ends.hear(&goodbye);
            assert_eq!(ends.link.operator(ends.now), None);
        } else {
            ends.link.set_operators(None);
        }
        let Asked { wanted, halts, .. } = *ends.link.asked();
        assert_eq!((wanted, halts), (Wanted::Off, before.wrapping_add(1)));
    }
}

#[test]
fn revoking_the_operator_disarms_and_revoking_another_does_not() {
    let bob = Operator::new("bob".parse().unwrap(), &Key::new([0xb0; 32]));
    for (operators, disarm) in [(Operators::from(Some(key())), 0), (bob.into(), 1)] {
        let mut ends = Ends::at(State::Running);
        let before = ends.link.asked().halts;
        ends.link.set_operators(operators);
        assert_eq!(ends.link.asked().halts.wrapping_sub(before), disarm);
        assert_eq!(ends.link.operator(ends.now).is_none(), disarm == 1);
    }
}

#[test]
fn a_robot_says_who_it_is_and_who_holds_it() {
    let mut ends = Ends::unconnected();
    assert_eq!((ends.link.operator(ends.now), ends.link.poll_at(ends.now)), (None, None));
    ends.connect();
    assert_eq!(ends.link.operator(ends.now), Some(address()));
    assert_eq!(ends.link.driver(ends.now), Some(OperatorName::OWNER));
    let hardware = DENGFOC_V3_01.hardware;
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(identity("ends", &hardware)));
    assert_ne!(identity("ends", &hardware), identity("daisy", &hardware));
    ends.link.set_name("daisy");
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(identity("daisy", &hardware)));
    ends.link.set_reset(ResetReason::BrownOut);
    let restarted = Identity { reset: ResetReason::BrownOut, ..identity("daisy", &hardware) };
    assert_eq!(ends.say(Command::Identify), Outcome::Identity(restarted));
    assert_eq!(ends.say(Command::Ping(41)), Outcome::Pong(41));
}

#[test]
fn a_robot_without_operators_opens_no_session() {
    let mut ends = Ends::connected();
    ends.link.set_operators(None);
    assert_eq!(ends.link.operator(ends.now), None);
    let mut newcomer = OperatorSession::new(key(), [5; 32], ends.now);
    let mut frame = Frame::new();
    while let Status::Connecting = newcomer.status(ends.now) {
        if let Some(said) = newcomer.poll(ends.now) {
            ends.link.receive(ends.now, outsider(), &said, &mut ends.tuning);
        }
        while ends.link.transmit(ends.now, ends.tuning.settings(), &mut frame) == Some(outsider()) {
            let _ = newcomer.receive(ends.now, &frame);
        }
        ends.now = ends.now + MILLISECOND;
    }
    assert_eq!(newcomer.status(ends.now), Status::Failed(ConnectError::Unprovisioned));
}

#[test]
fn a_robot_says_what_it_kept_of_its_last_accident_and_keeps_its_faults_for_the_next_run() {
    let mut ends = Ends::connected();
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(None));
    let run = |link: &mut Link| {
        let mut bytes = [0; blackbox::BYTES];
        bytes[blackbox::RUN].copy_from_slice(&link.keep().unwrap());
        Kept::decode(&bytes).report(ResetReason::Tasks).unwrap()
    };
    let quiet = run(&mut ends.link);
    assert_eq!((quiet.version.as_str(), quiet.fault), (env!("CARGO_PKG_VERSION"), None));
    ends.observe(|report| {
        report.faults = Faults::NONE.with(Fault::Stall);
        report.first_fault = Some(Fault::Stall);
    });
    let kept = run(&mut ends.link);
    assert_eq!(kept.fault.unwrap().first_fault, Some(Fault::Stall));
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(None), "that was this run");
    ends.link.set_crash(Some(kept.clone()));
    assert_eq!(ends.say(Command::Crash), Outcome::Crash(Some(kept)));
}

/// The permit after a halt.
const RESTED: Permit = Permit::new(1);

const TRIAL: Trial = Trial {
    motors: [true, false],
    current_ma: 700,
    angle: 0,
    pattern: Pattern::Turn(60),
    ticks: 3_000,
};

#[test]
fn a_trial_is_for_a_disarmed_robot_over_a_steady_link() {
    let mut ends = Ends::proven();
    let bridges = bridges(&DENGFOC_V3_01.hardware);
    assert_eq!(ends.say(Command::Trial(TRIAL)), Outcome::Bridges(bridges));
    let asked = *ends.link.asked();
    assert_eq!((asked.trial, asked.wanted), (Some(TRIAL), Wanted::Try));
    for state in [State::Aligning, State::Armed, State::Running, State::Stopping, State::Faulted] {
        let mut ends = Ends::at(state);
        assert_eq!(ends.say(Command::Trial(TRIAL)), refused(Refusal::State(state)), "{state}");
        assert_eq!(ends.link.asked().trial, None, "{state}");
    }
    let mut ends = Ends::connected();
    assert_eq!(ends.say(Command::Trial(TRIAL)), refused(Refusal::LinkUnproven));
    let mut ends = Ends::proven();
    let wild = Trial { current_ma: 5_000, ..TRIAL };
    let refusal = ends.say(Command::Trial(wild));
    assert!(matches!(refusal, Outcome::Refused(Refusal::OutOfRange { .. })), "{refusal:?}");
    ends.observe(|report| report.stopped = true);
    assert_eq!(ends.say(Command::Trial(TRIAL)), refused(Refusal::Stopped));
    assert_ne!(ends.link.asked().wanted, Wanted::Try);
}

#[test]
fn a_trial_whose_answer_was_lost_begins_once() {
    let mut ends = Ends::proven();
    let bridges = bridges(&DENGFOC_V3_01.hardware);
    assert_eq!(ends.say(Command::Trial(TRIAL)), Outcome::Bridges(bridges));
    let number = ends.link.asked().number;
    ends.observe(|report| report.state = State::Aligning);
    // The same request again, as it comes over the link: answered, whatever became of it.
    assert_eq!(ends.say(Command::Trial(TRIAL)), Outcome::Bridges(bridges));
    ends.observe(|report| {
        report.state = State::Faulted;
        report.faults = Faults::NONE.with(Fault::CurrentSense);
    });
    assert_eq!(ends.say(Command::Trial(TRIAL)), Outcome::Bridges(bridges));
    assert_eq!(ends.link.asked().number, number);
    // Another request is another trial.
    let another = ToRobot { request: 8, intent: 0, halts: 0, command: Command::Trial(TRIAL) };
    let frame = ends.operator.send(ends.now, &another).unwrap();
    ends.hear(&frame);
    assert!(matches!(ends.outcomes.pop(), Some(Outcome::Refused(Refusal::Faulted(_)))));
}

#[test]
fn a_fault_can_be_cleared_however_often_somebody_stopped_the_robot_since() {
    let mut ends = Ends::at(State::Armed);
    ends.observe(|report| {
        report.state = State::Faulted;
        report.faults = report.faults.with(Fault::Stall);
    });
    for count in 0..130u8 {
        let mut stop = StopSession::new(&key(), [count; 32], ends.now);
        let mut frame = Frame::new();
        for _ in 0..2 {
            let asked = stop.poll(ends.now).unwrap();
            ends.link.receive(ends.now, outsider(), &asked, &mut ends.tuning);
            ends.link.transmit(ends.now, ends.tuning.settings(), &mut frame);
            let _ = stop.receive(ends.now, &frame);
        }
        ends.observe(|report| report.stopped = true);
        ends.live(TELEMETRY);
    }
    ends.hear_of_halts();
    assert!(ends.halts > 128, "{}", ends.halts);
    ends.observe(|_| {});
    assert_eq!(ends.say(Command::Clear), Outcome::Done, "its operator knows of all halts");
}

#[test]
fn a_trial_moves_no_robot_whose_halt_its_operator_has_not_heard_of() {
    let mut ends = Ends::at(State::Aligning);
    ends.live(TELEMETRY);
    ends.observe(|report| {
        report.state = State::Disarmed;
        report.events.command_deadline += 1;
    });
    ends.live(PROVING_TIME);
    assert_eq!(ends.say(Command::Arm), refused(Refusal::Rested));
    assert_eq!(ends.say(Command::Trial(TRIAL)), refused(Refusal::Rested));
    assert_ne!(ends.link.asked().wanted, Wanted::Try);
}

#[test]
fn a_fault_at_power_on_is_cleared() {
    // Before anybody is connected, between two sessions, and after the session began.
    for connects_at in 0..3 {
        let mut ends = Ends::unconnected();
        let fail = |ends: &mut Ends| {
            ends.observe(|report| {
                report.state = State::Faulted;
                report.faults = report.faults.with(Fault::Stall);
            })
        };
        if connects_at == 0 {
            fail(&mut ends);
        }
        ends.connect();
        if connects_at == 1 {
            fail(&mut ends);
        }
        ends.live(PROVING_TIME);
        if connects_at == 2 {
            fail(&mut ends);
        }
        ends.hear_of_halts();
        assert_eq!(ends.say(Command::Clear), Outcome::Done, "{connects_at}");
        ends.observe(|report| (report.state, report.faults) = (State::Disarmed, Faults::NONE));
        ends.live(PROVING_TIME);
        assert_eq!(ends.say(Command::Arm), Outcome::Done, "{connects_at}");
    }
}

#[test]
fn a_session_that_begins_while_the_robot_ramps_down_arms_afterwards() {
    for state in [State::Aligning, State::Armed, State::Running, State::Stopping] {
        let mut ends = Ends::at(state);
        ends.wait(Duration::from_secs(2));
        ends.operator = OperatorSession::new(key(), [5; 32], ends.now);
        ends.halts = 0;
        ends.connect();
        ends.observe(|report| report.events.link_lost += 1);
        if state != State::Aligning {
            ends.observe(|report| report.state = State::Stopping);
        }
        ends.observe(|report| report.state = State::Disarmed);
        ends.live(PROVING_TIME + LINK_LATE);
        assert_eq!(ends.say(Command::Arm), Outcome::Done, "{state}");
    }
}
