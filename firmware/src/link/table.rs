//! The table of orders: the states that follow each order in each state, with the present permit and with an earlier one.
//!
//! An order goes out over the session every 20 ms, as a client repeats it, and link and supervisor obey it together. Motors and
//! rotors are a few lines of the test: alignment takes 0.1 s, a ramp down 0.1 s.
//!
//! ```sh
//! FLIX_REGENERATE_TABLE=1 cargo test -p flix-firmware --lib table
//! ```

use core::fmt::Write;
use core::net::SocketAddr;
use std::string::String;
use std::vec::Vec;

use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, Fault, Faults, Order, Pattern, Permit, Setpoint, State, Telemetry, ToOperator,
    ToRobot, Trial,
};
use flix_protocol::session::{
    Key, OperatorReceived, OperatorSession, Operators, Status, StopSession,
};
use flix_protocol::units::Instant;

use super::{Link, identity};
use crate::board::DENGFOC_V3_01;
use crate::fast::configuration::Configuration;
use crate::fast::control::Control;
use crate::fast::exchange::Report;
use crate::fast::supervisor::{Conditions, Drive, Supervisor};
use crate::hardware::{NoStore, TICK};
use crate::settings::{Settings, Tuning};
use crate::units::Speed;

/// Ticks between two datagrams of the operator: 20 ms.
const KEEP_ALIVE_TICKS: u32 = 200;
/// Ticks between two reports of the fast half: 1 ms.
const REPORT_TICKS: u32 = 10;
/// Ticks of an alignment, and of a ramp down: 0.1 s.
const MOVEMENT_TICKS: u32 = 1_000;
/// Ticks after which a fault may be cleared, and the link is proven: 0.8 s.
const SETTLING_TICKS: u32 = 8_000;
/// Ticks for which an order is watched: 1.2 s.
const WATCHED_TICKS: u32 = 12_000;

const TRIAL: Trial =
    Trial { motors: [true; 2], current_ma: 500, angle: 0, pattern: Pattern::Halve(10), ticks: 100 };

/// An order as an operator means it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Want {
    Off,
    Arm,
    Rest,
    Walk,
    Try,
    Clear,
    Stop,
}

const WANTS: [Want; 7] =
    [Want::Off, Want::Arm, Want::Rest, Want::Walk, Want::Try, Want::Clear, Want::Stop];

/// Whether the operator knows of the last halt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knows {
    Present,
    Old,
}

/// How datagrams travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// Without delay, for longer than the proving time.
    Steady,
    /// Without delay, but with a gap of 0.15 s just before the order.
    Gap,
    /// The operator has received nothing for 0.5 s: commands are too old to count.
    Late,
}

/// A state in which the order finds the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum From {
    Disarmed,
    Aligning,
    Trying,
    Armed,
    Running,
    /// Ramping down since commands stayed away.
    Silent,
    /// Armed after such a ramp.
    Rested,
    Disarming,
    /// Disarmed, with a stop of the operator's own.
    Stopped,
    /// Disarmed, with a stop of a second operator.
    StoppedFromOutside,
    Faulted,
    FaultedAndStopped,
    /// The cause of the fault is still there.
    Failing,
}

const FROM: [From; 13] = [
    From::Disarmed,
    From::Aligning,
    From::Trying,
    From::Armed,
    From::Running,
    From::Silent,
    From::Rested,
    From::Disarming,
    From::Stopped,
    From::StoppedFromOutside,
    From::Faulted,
    From::FaultedAndStopped,
    From::Failing,
];

/// Link, supervisor and operator.
struct Pair {
    link: Link,
    tuning: Tuning<NoStore>,
    supervisor: Supervisor,
    operator: OperatorSession,
    report: Report,
    present: Faults,
    telemetry: Option<Telemetry>,
    /// Whether the operator receives.
    hears: bool,
    /// Repeated every 20 ms.
    order: Order,
    tick: u32,
    /// Ticks since motors began to align, or to ramp down.
    moved: u32,
    walks: bool,
}

fn key() -> Key {
    Key::new([9; 32])
}

fn here() -> SocketAddr {
    ([192, 168, 4, 2], 4_000).into()
}

fn elsewhere() -> SocketAddr {
    ([192, 168, 4, 3], 4_000).into()
}

impl Pair {
    fn new() -> Self {
        let hardware = DENGFOC_V3_01.hardware;
        let tuning = Tuning::new(NoStore);
        let configuration = Configuration::new(&Settings::DEFAULT, &hardware);
        let report = Control::new(configuration).report();
        let operators = Operators::from(Some(key()));
        let name = identity("table", &hardware);
        let link = Link::new(name, &hardware, operators, [2; 32], tuning.settings(), report);
        let mut pair = Self {
            link,
            tuning,
            supervisor: Supervisor::new(),
            operator: OperatorSession::new(key(), [3; 32], Instant::START),
            report,
            present: Faults::NONE,
            telemetry: None,
            hears: true,
            order: Order::Off,
            tick: 0,
            moved: 0,
            walks: false,
        };
        while pair.operator.status(pair.now()) != Status::Connected {
            let frame = pair.operator.poll(pair.now()).expect("the handshake goes on");
            pair.deliver(&frame);
        }
        // Motors are known.
        let accept = flix_protocol::message::ParameterCommand::Accept;
        pair.send(ToRobot::request(0, Command::Parameter(accept)));
        pair.idle(SETTLING_TICKS);
        pair
    }

    fn now(&self) -> Instant {
        Instant::from_micros(1_000) + TICK * self.tick
    }

    fn deliver(&mut self, datagram: &[u8]) {
        let now = self.now();
        self.link.receive(now, here(), datagram, &mut self.tuning);
        self.drain();
    }

    fn drain(&mut self) {
        let now = self.now();
        let mut frame = Frame::new();
        while let Some(to) = self.link.transmit(now, self.tuning.settings(), &mut frame) {
            if to == here()
                && self.hears
                && let OperatorReceived::Message(ToOperator::Telemetry(telemetry)) =
                    self.operator.receive(now, &frame)
            {
                self.telemetry = Some(telemetry);
            }
        }
    }

    fn send(&mut self, message: ToRobot) {
        let frame = self.operator.send(self.now(), &message).expect("a session");
        self.deliver(&frame);
    }

    fn permit(&self) -> Permit {
        self.telemetry.map_or(Permit::default(), |telemetry| telemetry.permit)
    }

    /// Gives an order with this permit.
    fn want(&mut self, want: Want, permit: Permit) {
        self.order = match want {
            Want::Off => Order::Off,
            Want::Arm => Order::Arm(permit),
            Want::Rest => Order::Shake(permit, Setpoint::REST),
            Want::Walk => Order::Shake(permit, Setpoint::saturating(20.0, 30.0)),
            Want::Try => Order::Try(permit, TRIAL),
            Want::Clear => Order::Clear(permit),
            Want::Stop => Order::Stop,
        };
    }

    /// Does one tick of the supervisor, and of the motors and rotors that it drives.
    fn step(&mut self) {
        self.tick += 1;
        let state = self.supervisor.state;
        let conditions = Conditions {
            present: self.present,
            at_rest: !self.walks && self.moved >= MOVEMENT_TICKS,
            finished: state == State::Aligning && self.moved == MOVEMENT_TICKS,
            outdated: false,
        };
        let drive = self.supervisor.update(self.now(), self.link.asked(), &conditions);
        let walked = self.walks;
        self.walks = matches!(drive, Drive::Shake(frequency, _) if frequency != Speed::ZERO);
        let is_new = self.supervisor.state != state || self.walks != walked;
        self.moved = if is_new { 0 } else { self.moved.saturating_add(1) };
        if self.tick.is_multiple_of(REPORT_TICKS) {
            self.report.time = self.now();
            self.report.state = self.supervisor.state;
            self.report.faults = self.supervisor.faults;
            self.report.first_fault = self.supervisor.first_fault;
            self.report.stopped = self.supervisor.stopped;
            self.report.link_late = self.supervisor.link_late;
            self.report.permit = self.supervisor.permit;
            self.report.halt = self.supervisor.halt;
            self.report.obeyed = self.supervisor.obeyed;
            self.report.stops = self.supervisor.stops;
            self.report.halts = self.supervisor.halts;
            self.report.events = self.supervisor.events;
            self.link.observe(&self.report);
            self.drain();
        }
    }

    fn silent(&mut self, ticks: u32) {
        (0..ticks).for_each(|_| self.step());
    }

    /// Lets time pass in which the order in force is repeated.
    fn idle(&mut self, ticks: u32) {
        for tick in 0..ticks {
            if tick.is_multiple_of(KEEP_ALIVE_TICKS) {
                self.send(ToRobot::Order(self.order));
            }
            self.step();
        }
    }

    /// Gives an order with the present permit, for so many ticks.
    fn hold(&mut self, want: Want, ticks: u32) {
        self.want(want, self.permit());
        self.idle(ticks);
    }

    fn stop_from_outside(&mut self) {
        let mut stop = StopSession::new(&key(), [4; 32], self.now());
        let mut frame = Frame::new();
        for _ in 0..2 {
            let now = self.now();
            let asked = stop.poll(now).expect("a stop that is not answered goes on");
            self.link.receive(now, elsewhere(), &asked, &mut self.tuning);
            while let Some(to) = self.link.transmit(now, self.tuning.settings(), &mut frame) {
                if to == elsewhere() {
                    stop.receive(now, &frame).expect("an answer");
                }
            }
        }
    }

    fn at(from: From) -> Self {
        let mut pair = Self::new();
        let armed = 2 * MOVEMENT_TICKS;
        let half = MOVEMENT_TICKS / 2;
        match from {
            From::Disarmed => {}
            From::Aligning => pair.hold(Want::Arm, half),
            From::Trying => pair.hold(Want::Try, half),
            From::Armed => {
                pair.hold(Want::Arm, armed);
                pair.hold(Want::Rest, armed);
            }
            From::Running | From::Silent | From::Rested | From::Disarming => {
                pair.hold(Want::Arm, armed);
                pair.hold(Want::Walk, armed);
                match from {
                    From::Silent => pair.silent(2_500 + half / 2),
                    From::Rested => {
                        pair.silent(2_500 + armed);
                        pair.idle(2 * KEEP_ALIVE_TICKS);
                    }
                    From::Disarming => pair.hold(Want::Off, half),
                    _ => {}
                }
            }
            From::Stopped => pair.hold(Want::Stop, armed),
            From::StoppedFromOutside => {
                pair.stop_from_outside();
                pair.idle(armed);
            }
            From::Faulted | From::FaultedAndStopped | From::Failing => {
                pair.hold(Want::Arm, armed);
                pair.present = Faults::NONE.with(Fault::Stall);
                pair.idle(10 * KEEP_ALIVE_TICKS);
                if from != From::Failing {
                    pair.present = Faults::NONE;
                }
                if from == From::FaultedAndStopped {
                    pair.hold(Want::Stop, armed);
                }
                pair.idle(SETTLING_TICKS);
            }
        }
        pair
    }

    /// Returns the state, and what else decides.
    fn name(&self) -> String {
        let mut name = std::format!("{}", self.supervisor.state);
        for (holds, word) in [
            (self.supervisor.stopped, "+stop"),
            (!self.supervisor.faults.is_empty(), "+fault"),
            (self.walks, "*"),
        ] {
            if holds {
                name.push_str(word);
            }
        }
        name
    }

    /// Returns all that follows an order that is repeated, state after state.
    fn follow(&mut self, want: Want, knows: Knows, way: Way) -> Vec<String> {
        match way {
            Way::Steady => {}
            Way::Gap => self.silent(1_500),
            Way::Late => {
                self.hears = false;
                self.idle(5_000);
            }
        }
        let permit = match knows {
            Knows::Present => self.permit(),
            Knows::Old => Permit::new(self.permit().number().wrapping_sub(1)),
        };
        self.want(want, permit);
        let mut names = std::vec![self.name()];
        for tick in 0..WATCHED_TICKS {
            if tick.is_multiple_of(KEEP_ALIVE_TICKS) {
                self.send(ToRobot::Order(self.order));
            }
            self.step();
            let name = self.name();
            if names.last() != Some(&name) {
                names.push(name);
            }
        }
        names
    }
}

#[test]
fn each_order_in_each_state_leads_where_the_table_says() {
    let mut table = String::new();
    for from in FROM {
        for want in WANTS {
            for way in [Way::Steady, Way::Gap, Way::Late] {
                for knows in [Knows::Present, Knows::Old] {
                    let names = Pair::at(from).follow(want, knows, way);
                    let row = std::format!("{from:?}, {want:?}, {knows:?}, {way:?}");
                    writeln!(table, "{row:<44} {}", names.join(" > ")).expect("a string");
                }
            }
        }
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/link/table.txt");
    if std::env::var_os("FLIX_REGENERATE_TABLE").is_some() {
        std::fs::write(path, &table).expect("a folder of the sources");
    }
    let known = std::fs::read_to_string(path).expect("the table");
    for (line, known) in table.lines().zip(known.lines()) {
        assert_eq!(line, known);
    }
    assert_eq!(table.lines().count(), known.lines().count());
}
