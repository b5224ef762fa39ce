//! The wire format, byte for byte: a change of it is seen here before a robot sees it.
//!
//! `golden.txt` holds one line for each message: its name and its bytes in hexadecimal. After a
//! change that is meant, count up `PROTOCOL_VERSION` where old ends would misunderstand it, then
//! write the file anew and read its difference:
//!
//! ```text
//! FLIX_REGENERATE_GOLDEN=1 cargo test -p flix-protocol --test promises golden
//! git diff protocol/tests/golden.txt
//! ```
//!
//! The names come from matches without a wildcard, so a new variant does not compile until it is
//! named here, and does not pass until an example of it is listed.

use std::collections::BTreeSet;
use std::fmt::Write;

use crate::ends::{Ends, OPERATOR, SECOND_OPERATOR, answer, key, telemetry, walk};
use flix_protocol::frame::{HANDSHAKE_LENGTHS, MAXIMUM_MESSAGE};
use flix_protocol::message::*;
use flix_protocol::network_name::NetworkName;
use flix_protocol::provision::{
    Answer, FixedAddress, HeardNetwork, HeardNetworks, HeardSecurity, JoinFailure, NetworkAddress,
    NetworkState, ProvisionRefusal, Provisioning, Request, write_frame,
};
use flix_protocol::session::{
    Operator, RobotReceived, RobotSession, SESSION_EXPIRY, SESSION_RENEWAL, StopSession,
};
use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Ratio, Volts};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A name for each kind of command.
fn command_name(command: &Command) -> &'static str {
    match command {
        Command::Parameter(ParameterCommand::Get(_)) => "parameter-get",
        Command::Parameter(ParameterCommand::Set(..)) => "parameter-set",
        Command::Parameter(ParameterCommand::List(_)) => "parameter-list",
        Command::Parameter(ParameterCommand::Save) => "parameter-save",
        Command::Parameter(ParameterCommand::Reset) => "parameter-reset",
        Command::Parameter(ParameterCommand::Put(..)) => "parameter-put",
        Command::Parameter(ParameterCommand::Accept) => "parameter-accept",
        Command::Parameter(ParameterCommand::Check) => "parameter-check",
        Command::Identify => "identify",
        Command::Ping(_) => "ping",
        Command::Scope(ScopeCommand::Begin(_)) => "scope-begin",
        Command::Scope(ScopeCommand::Status) => "scope-status",
        Command::Scope(ScopeCommand::Read(_)) => "scope-read",
        Command::Crash => "crash",
        Command::Bridges => "bridges",
    }
}
const COMMANDS: usize = 15;

fn commands() -> Vec<Command> {
    vec![
        Command::Parameter(ParameterCommand::Get(name("current_limit"))),
        Command::Parameter(ParameterCommand::Set(name("current_limit"), 2.5)),
        Command::Parameter(ParameterCommand::List(300)),
        Command::Parameter(ParameterCommand::Save),
        Command::Parameter(ParameterCommand::Reset),
        Command::Parameter(ParameterCommand::Put(
            name("top_phase_resistance"),
            5.5,
            Mark::Measured,
        )),
        Command::Parameter(ParameterCommand::Accept),
        Command::Parameter(ParameterCommand::Check),
        Command::Identify,
        Command::Ping(0xDEAD_BEEF),
        Command::Scope(ScopeCommand::Begin(ScopePlan {
            trigger: Trigger::Level { channel: 2, level: -300, rising: true },
            ..ScopePlan::watch()
        })),
        Command::Scope(ScopeCommand::Status),
        Command::Scope(ScopeCommand::Read(300)),
        Command::Crash,
        Command::Bridges,
    ]
}

/// A name for each kind of order.
fn order_name(order: &Order) -> &'static str {
    match order {
        Order::Off => "off",
        Order::Arm(_) => "arm",
        Order::Shake(..) => "shake",
        Order::Try(_, Trial { pattern: Pattern::Halve(_), .. }) => "try-halve",
        Order::Try(_, Trial { pattern: Pattern::Turn(_), .. }) => "try-turn",
        Order::Try(_, Trial { pattern: Pattern::Swing(_), .. }) => "try-swing",
        Order::Clear(_) => "clear",
        Order::Stop => "stop",
    }
}
const ORDERS: usize = 8;

fn orders() -> Vec<Order> {
    let turn = Trial {
        motors: [true, false],
        current_ma: 800,
        angle: 0x4000,
        pattern: Pattern::Turn(-79),
        ticks: 4_000,
    };
    let attempt = |pattern| Order::Try(Permit::new(5), Trial { pattern, ..turn });
    vec![
        Order::Off,
        Order::Arm(Permit::new(3)),
        Order::Shake(Permit::new(4), Setpoint::saturating(20.0, 30.0)),
        attempt(Pattern::Halve(40)),
        attempt(turn.pattern),
        attempt(Pattern::Swing(600)),
        Order::Clear(Permit::new(u32::MAX)),
        Order::Stop,
    ]
}

fn refusal_name(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Malformed => "malformed",
        Refusal::OutOfRange { .. } => "out-of-range",
        Refusal::NotWhole { .. } => "not-whole",
        Refusal::UnknownParameter => "unknown-parameter",
        Refusal::State(_) => "state",
        Refusal::Faulted(_) => "faulted",
        Refusal::Stopped => "stopped",
        Refusal::LinkUnproven => "link-unproven",
        Refusal::Storage => "storage",
        Refusal::Late { .. } => "late",
        Refusal::Scope => "scope",
        Refusal::NotCaptured => "not-captured",
        Refusal::NoCurrentSense => "no-current-sense",
        Refusal::Assumed { .. } => "assumed",
        Refusal::AssumedUnmeasured { .. } => "assumed-unmeasured",
        Refusal::UnstablePosition { .. } => "unstable-position",
        Refusal::UnstableCurrent { .. } => "unstable-current",
        Refusal::Rested => "rested",
    }
}
const REFUSALS: usize = 18;

fn refusals() -> Vec<Refusal> {
    vec![
        Refusal::Malformed,
        Refusal::out_of_range("current_limit", 0.1, 3.0),
        Refusal::NotWhole { name: name("pole_pairs") },
        Refusal::UnknownParameter,
        Refusal::State(State::Running),
        Refusal::Faulted(Faults::NONE.with(Fault::OverCurrent).with(Fault::Settings)),
        Refusal::Stopped,
        Refusal::LinkUnproven,
        Refusal::Storage,
        Refusal::Late { age_ms: 612, limit_ms: 400 },
        Refusal::Scope,
        Refusal::NotCaptured,
        Refusal::NoCurrentSense,
        Refusal::Assumed { name: name("top_phase_resistance") },
        Refusal::AssumedUnmeasured { name: name("top_flux_linkage") },
        Refusal::UnstablePosition {
            margin: -0.0625,
            least: 0.1,
            position_bandwidth: 45.0,
            tracker_bandwidth: 125.0,
            encoder_latency: 200.0,
            current_bandwidth: 700.0,
            position_bandwidth_instead: 37.0,
        },
        Refusal::UnstableCurrent {
            margin: -0.5,
            least: 0.1,
            current_bandwidth: 1_500.0,
            actuation_delay: 400.0,
        },
        Refusal::Rested,
    ]
}

fn outcome_name(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Done => "done".into(),
        Outcome::Refused(refusal) => format!("refused-{}", refusal_name(refusal)),
        Outcome::Parameter(_) => "parameter".into(),
        Outcome::Parameters { .. } => "parameters".into(),
        Outcome::Identity(_) => "identity".into(),
        Outcome::Pong(_) => "pong".into(),
        Outcome::Scope(_) => "scope".into(),
        Outcome::ScopeRows(_) => "scope-rows".into(),
        Outcome::Bridges(_) => "bridges".into(),
        Outcome::Crash(None) => "no-crash".into(),
        Outcome::Crash(Some(_)) => "crash".into(),
    }
}
const OUTCOMES: usize = 10 + REFUSALS;

fn outcomes() -> Vec<Outcome> {
    let parameter = |index| Parameter {
        index,
        name: name("current_limit"),
        unit: "A".try_into().unwrap(),
        value: 2.5,
        default: 2.0,
        minimum: 0.1,
        maximum: 3.0,
        mark: None,
    };
    let mut outcomes = vec![
        Outcome::Done,
        Outcome::Parameter(parameter(3)),
        Outcome::Parameters {
            total: 40,
            entries: [parameter(3), parameter(4)].into_iter().collect(),
        },
        Outcome::Identity(Identity {
            name: name("flix-7"),
            board: name("MKS DUAL FOC V3.3 PLUS"),
            version: "0.1.0".try_into().unwrap(),
            reset: ResetReason::panic("src/link.rs", 12),
        }),
        Outcome::Pong(0xDEAD_BEEF),
        Outcome::Scope(ScopeStatus {
            plan: ScopePlan::watch(),
            state: ScopeState::Complete,
            rows: 2_400,
            trigger_row: 2_000,
            trigger_time_us: 12_345_600,
        }),
        Outcome::ScopeRows(ScopeRows {
            first: 28,
            values: [0x34, 0x12, 0xFF, 0xFF].into_iter().collect(),
        }),
        Outcome::Bridges(Bridges {
            dead_time_ns: 300,
            pwm_frequency_hz: 20_000,
            measures_bus: true,
            measures_current: false,
        }),
        Outcome::Crash(None),
        Outcome::Crash(Some(crash())),
    ];
    outcomes.extend(refusals().into_iter().map(Outcome::Refused));
    outcomes
}

/// An accident with a different number in every field.
fn crash() -> CrashReport {
    let currents = |first: f32| MotorCurrents {
        direct: Amperes::new(first).unwrap(),
        quadrature: Amperes::new(first + 1.0).unwrap(),
    };
    CrashReport {
        reset: ResetReason::panic("src/link.rs", 12),
        message: "index out of bounds".try_into().unwrap(),
        counters: [0x4200_1234, 0x4080_5678].into_iter().collect(),
        version: "0.1.0".try_into().unwrap(),
        build: Some(BuildId([1, 2, 3, 4, 5, 6, 7, 8])),
        uptime: Some(Instant::from_micros(7_654_321)),
        fault: Some(FaultSummary {
            time: Instant::from_micros(1_234_567),
            faults: Faults::NONE.with(Fault::Stall).with(Fault::OverCurrent),
            first_fault: Some(Fault::Stall),
            state: State::Running,
            frequency: Hertz::new(-29.75).unwrap(),
            direction: Degrees::new(59.5).unwrap(),
            currents: [currents(1.0), currents(3.0)],
            bus_voltage: Some(Volts::new(11.5).unwrap()),
        }),
    }
}

fn event_name(event: &Event) -> String {
    match event {
        Event::Started => "started".into(),
        Event::State(state) => format!("state-{state}"),
        Event::Fault(fault) => format!("fault-{}", fault.to_string().replace(' ', "-")),
        Event::Cleared => "cleared".into(),
        Event::Stopped => "stopped".into(),
        Event::OperatorConnected(_) => "operator-connected".into(),
        Event::OperatorLeft => "operator-left".into(),
        Event::LinkLate => "link-late".into(),
        Event::CommandDeadline => "command-deadline".into(),
        Event::LinkLost => "link-lost".into(),
        Event::SettingsSaved => "settings-saved".into(),
        Event::SettingsDefaulted => "settings-defaulted".into(),
        Event::BatteryLow(_) => "battery-low".into(),
        Event::CommandsLate { .. } => "commands-late".into(),
        Event::CommandAge => "command-age".into(),
        Event::StoppedFromOutside(_) => "stopped-from-outside".into(),
        Event::FrequencyLimited(_) => "frequency-limited".into(),
        Event::Magnet { .. } => "magnet".into(),
    }
}
const STATES: usize = 6;
const EVENTS: usize = 16 + STATES + Fault::ALL.len();

fn events() -> Vec<Event> {
    let mut events = vec![
        Event::Started,
        Event::Cleared,
        Event::Stopped,
        Event::OperatorConnected(operator("anna")),
        Event::OperatorLeft,
        Event::LinkLate,
        Event::CommandDeadline,
        Event::LinkLost,
        Event::SettingsSaved,
        Event::SettingsDefaulted,
        Event::BatteryLow(Volts::new(9.5).unwrap()),
        Event::CommandsLate { age_ms: 612, limit_ms: 400 },
        Event::CommandAge,
        Event::StoppedFromOutside(operator("bob")),
        Event::FrequencyLimited(Hertz::new(21.5).unwrap()),
        Event::Magnet { motor: 1, magnet: Magnet::Strong },
        Event::State(State::Disarmed),
        Event::State(State::Aligning),
        Event::State(State::Armed),
        Event::State(State::Running),
        Event::State(State::Stopping),
        Event::State(State::Faulted),
    ];
    events.extend(Fault::ALL.map(Event::Fault));
    events
}

fn name(text: &str) -> Name {
    text.try_into().unwrap()
}

fn operator(text: &str) -> OperatorName {
    text.parse().unwrap()
}

/// Telemetry with a different number in every field.
fn running() -> ToOperator {
    let motor = |first: f32| MotorTelemetry {
        angle: Degrees::new(first).unwrap(),
        speed: Hertz::new(first + 1.0).unwrap(),
        current_d: Amperes::new(first + 2.0).unwrap(),
        current_q: Amperes::new(first + 3.0).unwrap(),
        current_q_range: [first + 2.5, first + 3.5].map(|it| Amperes::new(it).unwrap()),
    };
    ToOperator::Telemetry(Telemetry {
        permit: Permit::new(300),
        halt: Halt::StoppedFromOutside,
        heard: 70_000,
        held_us: 1_900,
        withheld: Some(Withheld::Late { age_ms: 410, limit_ms: 400 }),
        time: Instant::from_micros(1_234_567),
        state: State::Running,
        faults: Faults::NONE.with(Fault::Stall),
        first_fault: Some(Fault::Stall),
        stopped: true,
        link_late: false,
        frequency_limited: true,
        setpoint: Setpoint::new(Hertz::new(-30.0).unwrap(), Degrees::new(60.0).unwrap()).unwrap(),
        frequency: Hertz::new(-29.75).unwrap(),
        direction: Degrees::new(59.5).unwrap(),
        direction_range: [58.5, 60.25].map(|it| Degrees::new(it).unwrap()),
        motors: [motor(10.0), motor(20.0)],
        encoders: [
            EncoderHealth { dropped: 31, corrected: 32, magnet: Magnet::Weak },
            EncoderHealth { dropped: 33, corrected: 34, magnet: Magnet::Missing },
        ],
        bus_voltage: Some(Volts::new(11.5).unwrap()),
        bus_voltage_range: Some([11.25, 11.75].map(|it| Volts::new(it).unwrap())),
        modulation: Ratio::new(0.75).unwrap(),
        timing: LoopTiming { ticks: 70_000, longest_interval_us: 130, overruns: 2 },
        link: LinkQuality {
            accepted: 300,
            lost: 4,
            dropped: Dropped {
                malformed: 5,
                version: 6,
                forged: 7,
                replayed: 8,
                stale: 9,
                session: 10,
                busy: 11,
                unprovisioned: 12,
            },
            silence_us: 13_000,
            age_us: 25_000,
            late: 14,
            signal_dbm: Some(-61),
        },
        operator: operator("anna"),
        stopped_by: Some(operator("bob")),
        latched_at: Some(Instant::from_micros(3_000_000)),
    })
}

/// Name and bytes, in the order of the file.
#[derive(Default)]
struct Golden(Vec<(String, Vec<u8>)>);

impl Golden {
    fn raw(&mut self, name: impl Into<String>, bytes: &[u8]) {
        let name = name.into();
        assert!(self.0.iter().all(|(known, _)| *known != name), "{name} is listed twice");
        self.0.push((name, bytes.to_vec()));
    }

    /// Adds a message, after looking that it comes back from its bytes.
    fn message<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(
        &mut self,
        name: impl Into<String>,
        message: &T,
    ) {
        let mut buffer = [0; MAXIMUM_MESSAGE];
        let bytes = postcard::to_slice(message, &mut buffer).expect("every message fits");
        assert_eq!(postcard::from_bytes::<T>(bytes).as_ref(), Ok(message));
        self.raw(name, bytes);
    }

    fn text(&self) -> String {
        self.0.iter().fold(String::new(), |mut text, (name, bytes)| {
            write!(text, "{name} ").unwrap();
            bytes.iter().for_each(|byte| write!(text, "{byte:02x}").unwrap());
            text + "\n"
        })
    }

    fn count(&self, prefix: &str) -> usize {
        let names: BTreeSet<_> = self.0.iter().map(|(name, _)| name).collect();
        names.iter().filter(|name| name.starts_with(prefix)).count()
    }
}

fn messages(golden: &mut Golden) {
    for (request, example) in (1..).zip(commands()) {
        golden.message(
            format!("command/{}", command_name(&example)),
            &ToRobot::request(request * 100, example),
        );
    }
    for order in orders() {
        golden.message(format!("order/{}", order_name(&order)), &ToRobot::Order(order));
    }
    for (request, outcome) in (1..).zip(outcomes()) {
        golden.message(
            format!("reply/{}", outcome_name(&outcome)),
            &ToOperator::Reply(Reply { request: request * 100, outcome }),
        );
    }
    golden.message("telemetry/at-rest", &telemetry(0));
    golden.message("telemetry/running", &running());
    for (number, event) in (1..).zip(events()) {
        let time = Instant::from_micros(u64::from(number) * 1_000_000);
        golden.message(
            format!("event/{}", event_name(&event)),
            &ToOperator::Event(EventReport { number, time, event }),
        );
    }
    assert_eq!(golden.count("command/"), COMMANDS, "every command is listed");
    assert_eq!(golden.count("order/"), ORDERS, "every order is listed");
    assert_eq!(golden.count("reply/"), OUTCOMES, "every outcome is listed");
    assert_eq!(golden.count("event/"), EVENTS, "every event is listed");
}

/// A whole session with fixed entropy at both ends.
fn datagrams(golden: &mut Golden) {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let hello = ends.operator.poll(ends.now).unwrap();
    golden.raw("datagram/hello", &hello);

    let mut refuse = |name: &str, mut robot: RobotSession, hello: &[u8]| {
        let refusal = answer(robot.receive(ends.now, OPERATOR, hello), hello.len()).unwrap();
        golden.raw(format!("datagram/refusal-{name}"), &refusal);
    };
    refuse("key", RobotSession::new(Some(key(2)), [3; 32]), &hello);
    refuse("unprovisioned", RobotSession::new(None, [3; 32]), &hello);
    let mut other_version = hello.clone();
    other_version[4] ^= 0x80;
    refuse("version", RobotSession::new(Some(key(1)), [3; 32]), &other_version);

    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    golden.raw("datagram/challenge", &challenge);
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    golden.raw("datagram/confirm", &confirm);
    let accept = answer(ends.robot_hears(&confirm), confirm.len()).unwrap();
    golden.raw("datagram/accept", &accept);
    ends.operator_hears(&accept);
    let busy = answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &hello), hello.len()).unwrap();
    golden.raw("datagram/held", &busy);

    let mut stop = StopSession::new(&key(1), [44; 32], ends.now);
    let hello = stop.poll(ends.now).unwrap();
    golden.raw("datagram/hello-to-stop", &hello);
    let challenge = answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &hello), hello.len());
    stop.receive(ends.now, &challenge.unwrap()).unwrap();
    let stop = stop.poll(ends.now).unwrap();
    golden.raw("datagram/stop", &stop);
    let stopped = answer(ends.robot.receive(ends.now, SECOND_OPERATOR, &stop), stop.len());
    golden.raw("datagram/stopped", &stopped.unwrap());

    let order = walk(-30.0, 60.0);
    let sealed = ends.operator.send(ends.now, &order).unwrap();
    golden.raw("datagram/sealed-order", &sealed);
    assert_eq!(ends.robot_hears(&sealed), RobotReceived::Message(order));
    let mut renewing = Ends::connected();
    let due = renewing.now + SESSION_RENEWAL;
    while renewing.now < due {
        renewing.wait(SESSION_EXPIRY / 2);
        renewing.moment();
        renewing.ping();
    }
    let renewal = renewing.operator.poll(renewing.now).unwrap();
    golden.raw("datagram/renewal", &renewal);
    let renewed = answer(renewing.robot_hears(&renewal), renewal.len()).unwrap();
    golden.raw("datagram/renewed", &renewed);
    golden.raw("datagram/sealed-telemetry", &ends.robot.send(ends.now, &running()).unwrap().1);
    golden.raw("datagram/operator-goodbye", &ends.operator.goodbye().unwrap());
    golden.raw("datagram/robot-goodbye", &ends.robot.goodbye(ends.now).unwrap().1);
}

fn serial(golden: &mut Golden) {
    let address = FixedAddress {
        address: [192, 168, 4, 9],
        prefix_length: 24,
        gateway: Some([192, 168, 4, 1]),
    };
    let anna = Operator::new(operator("anna"), &key(0xA5));
    let provision = |address| {
        let provisioning = Provisioning::new("flix-7", "lab", "correct horse", address).unwrap();
        Request::Provision(provisioning, anna.clone())
    };
    let identity = Identity {
        name: name("flix-7"),
        board: name("MKS DUAL FOC V3.3 PLUS"),
        version: "0.1.0".try_into().unwrap(),
        reset: ResetReason::Requested,
    };
    for request in [
        Request::Identify,
        provision(None),
        provision(Some(address)),
        Request::Forget,
        Request::Prove([0x5A; 16], key(0xA5).id()),
        Request::Operators,
        Request::Add(anna.clone()),
        Request::Revoke(operator("anna")),
        Request::Keep(
            Provisioning::new("flix-7", "lab", "correct horse", None).unwrap(),
            operator("anna"),
            key(0xA5).id(),
        ),
        Request::Network,
        Request::Scan { number: 7, from: 6 },
    ] {
        let name = match &request {
            Request::Identify => "identify",
            Request::Provision(provisioning, _) if provisioning.address().is_some() => {
                "provision-fixed-address"
            }
            Request::Provision(..) => "provision",
            Request::Forget => "forget",
            Request::Prove(..) => "prove",
            Request::Operators => "operators",
            Request::Add(_) => "add",
            Request::Revoke(_) => "revoke",
            Request::Keep(..) => "keep",
            Request::Network => "network",
            Request::Scan { .. } => "scan",
        };
        golden.raw(format!("serial/{name}"), &write_frame(&request).unwrap());
    }
    let heard = |name: &[u8], dbm, security| HeardNetwork {
        name: NetworkName::new(name).unwrap(),
        channel: 11,
        dbm,
        security,
    };
    let networks = [
        heard(b"lab", -42, HeardSecurity::Wpa2),
        heard(b"caf\xe9", -78, HeardSecurity::Enterprise),
    ];
    let networks = networks.into_iter().collect();
    let failed = |reason| Answer::Network(NetworkState::Failed { reason, tries: 3 });
    for answer in [
        Answer::Identity { identity, has_key: true },
        Answer::Done,
        Answer::Refused(ProvisionRefusal::Malformed),
        Answer::Refused(ProvisionRefusal::Driving),
        Answer::Refused(ProvisionRefusal::Storage),
        Answer::Refused(ProvisionRefusal::Unprovisioned),
        Answer::Refused(ProvisionRefusal::Full),
        Answer::Refused(ProvisionRefusal::Taken),
        Answer::Refused(ProvisionRefusal::Last),
        Answer::Refused(ProvisionRefusal::Unknown),
        Answer::Refused(ProvisionRefusal::Radio),
        Answer::Operators([operator("anna"), operator("bob")].into_iter().collect()),
        Answer::Proof(None),
        Answer::Proof(Some(key(0xA5).prove(&[0x5A; 16]))),
        Answer::Network(NetworkState::Joining),
        failed(JoinFailure::Absent),
        failed(JoinFailure::Password),
        failed(JoinFailure::Security),
        failed(JoinFailure::Full),
        failed(JoinFailure::Refused),
        failed(JoinFailure::Radio),
        Answer::Network(NetworkState::NoAddress { seconds: 300 }),
        Answer::Network(NetworkState::Joined(NetworkAddress {
            address: address.address,
            prefix_length: address.prefix_length,
            is_fixed: false,
        })),
        Answer::Networks(None),
        Answer::Networks(Some(HeardNetworks { total: 2, from: 0, networks })),
    ] {
        let name = match &answer {
            Answer::Identity { .. } => "identity",
            Answer::Done => "done",
            Answer::Refused(ProvisionRefusal::Malformed) => "refused-malformed",
            Answer::Refused(ProvisionRefusal::Driving) => "refused-driving",
            Answer::Refused(ProvisionRefusal::Storage) => "refused-storage",
            Answer::Refused(ProvisionRefusal::Unprovisioned) => "refused-unprovisioned",
            Answer::Refused(ProvisionRefusal::Full) => "refused-full",
            Answer::Refused(ProvisionRefusal::Taken) => "refused-taken",
            Answer::Refused(ProvisionRefusal::Last) => "refused-last",
            Answer::Refused(ProvisionRefusal::Unknown) => "refused-unknown",
            Answer::Refused(ProvisionRefusal::Radio) => "refused-radio",
            Answer::Networks(None) => "listening",
            Answer::Networks(Some(_)) => "networks",
            Answer::Operators(_) => "operators",
            Answer::Proof(None) => "no-proof",
            Answer::Proof(Some(_)) => "proof",
            Answer::Network(NetworkState::Joining) => "joining",
            Answer::Network(NetworkState::NoAddress { .. }) => "no-address",
            Answer::Network(NetworkState::Joined(_)) => "joined",
            Answer::Network(NetworkState::Failed { reason, .. }) => match reason {
                JoinFailure::Absent => "failed-absent",
                JoinFailure::Password => "failed-password",
                JoinFailure::Security => "failed-security",
                JoinFailure::Full => "failed-full",
                JoinFailure::Refused => "failed-refused",
                JoinFailure::Radio => "failed-radio",
            },
        };
        golden.raw(format!("serial/answer-{name}"), &write_frame(&answer).unwrap());
    }
}

#[test]
fn every_message_has_the_bytes_that_were_agreed() {
    let mut golden = Golden::default();
    messages(&mut golden);
    datagrams(&mut golden);
    serial(&mut golden);

    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden.txt");
    if std::env::var_os("FLIX_REGENERATE_GOLDEN").is_some() {
        std::fs::write(path, golden.text()).unwrap();
    }
    let agreed = std::fs::read_to_string(path).unwrap();
    for (line, agreed) in golden.text().lines().zip(agreed.lines()) {
        assert_eq!(line, agreed, "the wire format changed: see the head of this file");
    }
    assert_eq!(golden.text().len(), agreed.len(), "messages were added or taken away");
}

#[test]
fn every_datagram_of_a_handshake_has_the_length_that_is_stated() {
    let mut golden = Golden::default();
    datagrams(&mut golden);
    let names = ["sealed", "renew", "goodbye"];
    let handshakes =
        golden.0.iter().filter(|(name, _)| !names.iter().any(|part| name.contains(part)));
    let lengths: BTreeSet<_> = handshakes.map(|(_, bytes)| (bytes[3], bytes.len())).collect();
    assert_eq!(lengths, BTreeSet::from(HANDSHAKE_LENGTHS));
}

/// Longest value of every field, so that the bound holds whatever the robot measures.
#[test]
fn the_longest_messages_fit_a_datagram() {
    let name: Name = "n".repeat(NAME_LENGTH).as_str().try_into().unwrap();
    let parameter = Parameter {
        index: u16::MAX,
        name: name.clone(),
        unit: "u".repeat(8).as_str().try_into().unwrap(),
        value: f32::MIN,
        default: f32::MIN,
        minimum: f32::MIN,
        maximum: f32::MAX,
        mark: Some(Mark::Measured),
    };
    let ToOperator::Telemetry(mut longest) = running() else { unreachable!() };
    let most = u32::MAX;
    longest.time = Instant::from_micros(u64::MAX);
    longest.faults = Fault::ALL.into_iter().fold(Faults::NONE, Faults::with);
    let encoder = EncoderHealth { dropped: most, corrected: most, magnet: Magnet::Missing };
    longest.encoders = [encoder; 2];
    longest.timing = LoopTiming { ticks: u64::MAX, longest_interval_us: most, overruns: most };
    longest.link = LinkQuality {
        accepted: most,
        lost: most,
        dropped: Dropped {
            malformed: most,
            version: most,
            forged: most,
            replayed: most,
            stale: most,
            session: most,
            busy: most,
            unprovisioned: most,
        },
        silence_us: most,
        age_us: most,
        late: most,
        signal_dbm: Some(i8::MIN),
    };
    let reply = |outcome| ToOperator::Reply(Reply { request: most, outcome });
    let mut longest_crash = crash();
    longest_crash.reset = ResetReason::panic(&name, most);
    longest_crash.message = "m".repeat(PANIC_MESSAGE_LENGTH).as_str().try_into().unwrap();
    longest_crash.counters = [most; PROGRAM_COUNTERS].into_iter().collect();
    longest_crash.version = "v".repeat(16).as_str().try_into().unwrap();
    longest_crash.uptime = Some(Instant::from_micros(u64::MAX));
    if let Some(fault) = &mut longest_crash.fault {
        fault.time = Instant::from_micros(u64::MAX);
        fault.faults = Fault::ALL.into_iter().fold(Faults::NONE, Faults::with);
    }
    let mut ends = Ends::connected();
    for message in [
        ToOperator::Telemetry(longest),
        reply(Outcome::Parameter(parameter.clone())),
        reply(Outcome::Parameters {
            total: u16::MAX,
            entries: std::iter::repeat_n(parameter, PARAMETERS_PER_REPLY).collect(),
        }),
        reply(Outcome::Identity(Identity {
            name: name.clone(),
            board: name.clone(),
            version: "v".repeat(16).as_str().try_into().unwrap(),
            reset: ResetReason::panic(&name, most),
        })),
        reply(Outcome::Crash(Some(longest_crash))),
        reply(Outcome::Refused(Refusal::OutOfRange {
            name: name.clone(),
            minimum: f32::MIN,
            maximum: f32::MAX,
        })),
    ] {
        let (_, frame) = ends.robot.send(ends.now, &message).expect("it fits");
        assert_eq!(
            ends.operator_hears(&frame),
            flix_protocol::session::OperatorReceived::Message(message)
        );
    }
    let longest = ToRobot::request(most, Command::Parameter(ParameterCommand::Set(name, f32::MAX)));
    let frame = ends.operator.send(ends.now, &longest).expect("it fits");
    assert_eq!(ends.robot_hears(&frame), RobotReceived::Message(longest));
}

#[test]
fn a_question_is_what_reads_and_nothing_else() {
    let questions: Vec<_> =
        commands().iter().filter(|it| it.is_question()).map(command_name).collect();
    let reading =
        ["parameter-get", "parameter-list", "parameter-check", "identify", "ping", "scope-status"];
    assert_eq!(questions, [&reading[..], &["scope-read", "crash", "bridges"]].concat());
}

#[test]
fn telemetry_tells_whether_motors_are_driven_and_for_how_long_a_stop_is_latched() {
    let ToOperator::Telemetry(mut stated) = telemetry(5_000_000) else { panic!() };
    assert_eq!(stated.latched_for(), None);
    stated.latched_at = Some(Instant::from_micros(4_800_000));
    assert_eq!(stated.latched_for(), Some(std::time::Duration::from_millis(200)));
    let idle = |states: &[State]| states.iter().map(|it| it.is_idle()).collect::<Vec<_>>();
    assert_eq!(idle(&[State::Disarmed, State::Faulted]), [true; 2]);
    let driven = [State::Aligning, State::Armed, State::Running, State::Stopping];
    assert_eq!(idle(&driven), [false; 4]);
}
