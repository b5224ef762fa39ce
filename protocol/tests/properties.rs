//! What holds for every unit, message, counter and network, tried on values that nobody chose.

use std::collections::{BTreeSet, VecDeque};

use core::time::Duration;

use crate::ends::{Ends, OPERATOR, answer, key, ping};
use flix_protocol::frame::{Datagram, MAXIMUM_MESSAGE};
use flix_protocol::message::*;
use flix_protocol::session::{
    OperatorReceived, OperatorSession, REPLAY_WINDOW, ReplayWindow, RobotReceived, RobotSession,
    Status,
};
use flix_protocol::units::*;
use proptest::prelude::*;
use proptest::sample::select;
use serde::Serialize;
use serde::de::DeserializeOwned;

// Units

/// Any bits, and often the interesting ones.
fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        -2000.0_f32..2000.0,
        select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.0, 1e-40, f32::MAX, f32::MIN]),
    ]
}

macro_rules! unit_promises {
    ($($name:ident: $unit:ident;)*) => {$(
        proptest! {
            #[test]
            fn $name(value in number()) {
                let (minimum, maximum) = ($unit::MINIMUM.get(), $unit::MAXIMUM.get());
                let in_range = (minimum..=maximum).contains(&value);
                prop_assert_eq!($unit::new(value).is_ok(), in_range);
                prop_assert!((minimum..=maximum).contains(&$unit::saturating(value).get()));
                if in_range {
                    prop_assert_eq!($unit::saturating(value).get(), value);
                }
                // What comes over the wire is checked alike.
                let wire = postcard::from_bytes::<$unit>(&value.to_le_bytes());
                prop_assert_eq!(wire.ok().map($unit::get), in_range.then_some(value));
            }
        }
    )*};
}

unit_promises! {
    hertz_are_in_range: Hertz;
    degrees_are_in_range: Degrees;
    volts_are_in_range: Volts;
    amperes_are_in_range: Amperes;
    metres_are_in_range: Metres;
    ratios_are_in_range: Ratio;
}

proptest! {
    #[test]
    fn a_setpoint_exists_only_within_what_the_robot_can_do(f in -40.0_f32..40.0, theta in -100.0_f32..100.0) {
        let made = Setpoint::new(Hertz::new(f).unwrap(), Degrees::new(theta).unwrap());
        prop_assert_eq!(made.is_ok(), f.abs() <= 35.0 && theta.abs() <= 90.0);
    }

    #[test]
    fn time_adds_up_and_saturates(start in any::<u64>(), length in any::<u64>()) {
        let start = Instant::from_micros(start);
        let end = start + Duration::from_micros(length);
        prop_assert_eq!(end.as_micros(), start.as_micros().saturating_add(length));
        prop_assert_eq!(start.since(end), Duration::ZERO);
        prop_assert_eq!(start + end.since(start), end);
    }
}

// Messages

fn text<const LENGTH: usize>() -> impl Strategy<Value = heapless::String<LENGTH>> {
    "\\PC{0,32}".prop_map(|text| {
        let mut kept = heapless::String::new();
        let _ = text.chars().try_for_each(|character| kept.push(character));
        kept
    })
}

fn finite() -> impl Strategy<Value = f32> {
    any::<f32>().prop_filter("finite", |value| value.is_finite())
}

fn hertz() -> impl Strategy<Value = Hertz> {
    any::<f32>().prop_map(Hertz::saturating)
}

fn degrees() -> impl Strategy<Value = Degrees> {
    any::<f32>().prop_map(Degrees::saturating)
}

fn amperes() -> impl Strategy<Value = Amperes> {
    any::<f32>().prop_map(Amperes::saturating)
}

fn volts() -> impl Strategy<Value = Volts> {
    any::<f32>().prop_map(Volts::saturating)
}

fn instant() -> impl Strategy<Value = Instant> {
    any::<u64>().prop_map(Instant::from_micros)
}

fn any_setpoint() -> impl Strategy<Value = Setpoint> {
    (-35.0_f32..=35.0, -90.0_f32..=90.0).prop_map(|(f, theta)| {
        Setpoint::new(Hertz::new(f).unwrap(), Degrees::new(theta).unwrap()).unwrap()
    })
}

fn any_command() -> impl Strategy<Value = Command> {
    prop_oneof![
        select(vec![
            Command::Identify,
            Command::Crash,
            Command::Bridges,
            Command::Parameter(ParameterCommand::Save),
            Command::Parameter(ParameterCommand::Reset),
            Command::Parameter(ParameterCommand::Put(Name::new(), 1.0, Mark::Assumed)),
            Command::Parameter(ParameterCommand::Accept),
            Command::Parameter(ParameterCommand::Check),
        ]),
        text().prop_map(|name| Command::Parameter(ParameterCommand::Get(name))),
        (text(), finite())
            .prop_map(|(name, value)| Command::Parameter(ParameterCommand::Set(name, value))),
        any::<u16>().prop_map(|first| Command::Parameter(ParameterCommand::List(first))),
        any::<u32>().prop_map(Command::Ping),
        scope_plan().prop_map(|plan| Command::Scope(ScopeCommand::Begin(plan))),
        any::<u16>().prop_map(|first| Command::Scope(ScopeCommand::Read(first))),
    ]
}

fn trial() -> impl Strategy<Value = Trial> {
    let pattern = prop_oneof![
        any::<u16>().prop_map(Pattern::Halve),
        any::<i16>().prop_map(Pattern::Turn),
        any::<u16>().prop_map(Pattern::Swing),
    ];
    (any::<[bool; 2]>(), any::<u16>(), any::<u16>(), pattern, any::<u16>()).prop_map(
        |(motors, current_ma, angle, pattern, ticks)| Trial {
            motors,
            current_ma,
            angle,
            pattern,
            ticks,
        },
    )
}

fn scope_plan() -> impl Strategy<Value = ScopePlan> {
    let trigger = prop_oneof![
        select(vec![Trigger::Now, Trigger::Fault, Trigger::Pattern]),
        (any::<u8>(), any::<i16>(), any::<bool>())
            .prop_map(|(channel, level, rising)| Trigger::Level { channel, level, rising }),
    ];
    let channels = prop::collection::vec(select(Channel::ALL.to_vec()), 0..=SCOPE_CHANNELS);
    (channels, trigger, any::<u16>()).prop_map(|(channels, trigger, before)| ScopePlan {
        channels: channels.into_iter().collect(),
        trigger,
        before,
    })
}

fn fault() -> impl Strategy<Value = Fault> {
    select(Fault::ALL.to_vec())
}

fn faults() -> impl Strategy<Value = Faults> {
    prop::collection::vec(fault(), 0..5)
        .prop_map(|faults| faults.into_iter().fold(Faults::NONE, Faults::with))
}

fn state() -> impl Strategy<Value = State> {
    select(vec![
        State::Disarmed,
        State::Aligning,
        State::Armed,
        State::Running,
        State::Stopping,
        State::Faulted,
    ])
}

fn parameter() -> impl Strategy<Value = Parameter> {
    (any::<u16>(), text(), text(), [finite(), finite(), finite(), finite()], mark()).prop_map(
        |(index, name, unit, [value, default, minimum, maximum], mark)| Parameter {
            index,
            name,
            unit,
            value,
            default,
            minimum,
            maximum,
            mark,
        },
    )
}

fn mark() -> impl Strategy<Value = Option<Mark>> {
    proptest::option::of(select(Mark::ALL.to_vec()))
}

fn refusal() -> impl Strategy<Value = Refusal> {
    prop_oneof![
        select(vec![
            Refusal::Malformed,
            Refusal::UnknownParameter,
            Refusal::Stopped,
            Refusal::LinkUnproven,
            Refusal::Storage,
        ]),
        (text(), finite(), finite()).prop_map(|(name, minimum, maximum)| Refusal::OutOfRange {
            name,
            minimum,
            maximum
        }),
        text().prop_map(|name| Refusal::NotWhole { name }),
        (any::<u16>(), any::<u16>())
            .prop_map(|(age_ms, limit_ms)| Refusal::Late { age_ms, limit_ms }),
        state().prop_map(Refusal::State),
        faults().prop_map(Refusal::Faulted),
    ]
}

fn resets() -> impl Strategy<Value = ResetReason> {
    use ResetReason::{BrownOut, FastLoop, Other, PowerOn, Requested, Tasks};
    prop_oneof![
        proptest::sample::select(vec![PowerOn, BrownOut, Requested, FastLoop, Tasks, Other]),
        text().prop_map(ResetReason::Panic),
    ]
}

fn crash() -> impl Strategy<Value = CrashReport> {
    let currents = || {
        (amperes(), amperes()).prop_map(|(direct, quadrature)| MotorCurrents { direct, quadrature })
    };
    let fault = (
        (instant(), faults(), prop::option::of(fault()), state()),
        (hertz(), degrees(), [currents(), currents()], prop::option::of(volts())),
    )
        .prop_map(|(standing, (frequency, direction, currents, bus_voltage))| {
            let (time, faults, first_fault, state) = standing;
            FaultSummary {
                time,
                faults,
                first_fault,
                state,
                frequency,
                direction,
                currents,
                bus_voltage,
            }
        });
    (
        (resets(), text(), prop::collection::vec(any::<u32>(), 0..=PROGRAM_COUNTERS)),
        (text(), any::<Option<[u8; 8]>>(), prop::option::of(instant()), prop::option::of(fault)),
    )
        .prop_map(|((reset, message, counters), (version, build, uptime, fault))| {
            CrashReport {
                reset,
                message,
                counters: counters.into_iter().collect(),
                version,
                build: build.map(BuildId),
                uptime,
                fault,
            }
        })
}

fn outcome() -> impl Strategy<Value = Outcome> {
    prop_oneof![
        Just(Outcome::Done),
        refusal().prop_map(Outcome::Refused),
        parameter().prop_map(Outcome::Parameter),
        (any::<u16>(), prop::collection::vec(parameter(), 0..=PARAMETERS_PER_REPLY)).prop_map(
            |(total, entries)| Outcome::Parameters {
                total,
                entries: entries.into_iter().collect()
            }
        ),
        (text(), text(), text(), resets()).prop_map(|(name, board, version, reset)| {
            Outcome::Identity(Identity { name, board, version, reset })
        }),
        prop::option::of(crash()).prop_map(Outcome::Crash),
        any::<u32>().prop_map(Outcome::Pong),
        (any::<u16>(), prop::collection::vec(any::<u8>(), 0..=2 * SCOPE_VALUES_PER_REPLY))
            .prop_map(|(first, values)| {
                Outcome::ScopeRows(ScopeRows { first, values: values.into_iter().collect() })
            }),
    ]
}

fn magnet() -> impl Strategy<Value = Magnet> {
    select(Magnet::ALL.to_vec())
}

fn withheld() -> impl Strategy<Value = Withheld> {
    prop_oneof![
        select(vec![
            Withheld::Permit,
            Withheld::State,
            Withheld::Faulted,
            Withheld::Stopped,
            Withheld::LinkUnproven,
            Withheld::Settings,
            Withheld::Range,
            Withheld::NoCurrentSense,
        ]),
        any::<[u16; 2]>().prop_map(|[age_ms, limit_ms]| Withheld::Late { age_ms, limit_ms }),
    ]
}

fn order() -> impl Strategy<Value = Order> {
    let permit = || any::<u32>().prop_map(Permit::new);
    prop_oneof![
        select(vec![Order::Off, Order::Stop]),
        permit().prop_map(Order::Arm),
        permit().prop_map(Order::Clear),
        (permit(), any_setpoint()).prop_map(|(permit, setpoint)| Order::Shake(permit, setpoint)),
        (permit(), trial()).prop_map(|(permit, trial)| Order::Try(permit, trial)),
    ]
}

fn telemetry() -> impl Strategy<Value = Telemetry> {
    let motor = || {
        (degrees(), hertz(), amperes(), amperes(), [amperes(), amperes()]).prop_map(
            |(angle, speed, current_d, current_q, current_q_range)| MotorTelemetry {
                angle,
                speed,
                current_d,
                current_q,
                current_q_range,
            },
        )
    };
    let dropped = any::<[u32; 8]>().prop_map(
        |[malformed, version, forged, replayed, stale, session, busy, unprovisioned]| Dropped {
            malformed,
            version,
            forged,
            replayed,
            stale,
            session,
            busy,
            unprovisioned,
        },
    );
    let link = (any::<[u32; 5]>(), dropped, any::<Option<i8>>()).prop_map(
        |([accepted, lost, silence_us, age_us, late], dropped, signal_dbm)| LinkQuality {
            accepted,
            lost,
            dropped,
            silence_us,
            age_us,
            late,
            signal_dbm,
        },
    );
    let encoder = || {
        (any::<[u32; 2]>(), magnet()).prop_map(|([dropped, corrected], magnet)| EncoderHealth {
            dropped,
            corrected,
            magnet,
        })
    };
    let timing =
        (any::<u64>(), any::<[u32; 2]>()).prop_map(|(ticks, [longest_interval_us, overruns])| {
            LoopTiming { ticks, longest_interval_us, overruns }
        });
    (
        (instant(), state(), faults(), prop::option::of(fault()), any::<[bool; 4]>()),
        (
            any::<u32>().prop_map(Permit::new),
            select(Halt::ALL.to_vec()),
            any::<u64>(),
            any::<u16>(),
            prop::option::of(withheld()),
        ),
        (
            any_setpoint(),
            hertz(),
            degrees(),
            [degrees(), degrees()],
            [motor(), motor()],
            [encoder(), encoder()],
        ),
        ([volts(), volts(), volts()], any::<bool>(), any::<f32>(), timing, link),
    )
        .prop_map(|(standing, orders, motion, electrical)| {
            let (time, state, faults, first_fault, flags) = standing;
            let [stopped, link_late, frequency_limited, named] = flags;
            let (setpoint, frequency, direction, direction_range, motors, encoders) = motion;
            let (voltages, measured, modulation, timing, link) = electrical;
            let (permit, halt, heard, held_us, withheld) = orders;
            let [bus, least, largest] = voltages;
            Telemetry {
                operator: OperatorName::OWNER,
                stopped_by: named.then_some(OperatorName::OWNER),
                latched_at: named.then_some(time),
                time,
                state,
                faults,
                first_fault,
                stopped,
                link_late,
                frequency_limited,
                permit,
                halt,
                heard,
                held_us,
                withheld,
                setpoint,
                frequency,
                direction,
                direction_range,
                motors,
                encoders,
                bus_voltage: measured.then_some(bus),
                bus_voltage_range: measured.then_some([least, largest]),
                modulation: Ratio::saturating(modulation),
                timing,
                link,
            }
        })
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        select(vec![
            Event::Started,
            Event::Cleared,
            Event::Stopped,
            Event::OperatorConnected(OperatorName::OWNER),
            Event::StoppedFromOutside(OperatorName::OWNER),
            Event::OperatorLeft,
            Event::LinkLate,
            Event::CommandDeadline,
            Event::LinkLost,
            Event::SettingsSaved,
            Event::SettingsDefaulted,
            Event::CommandAge,
        ]),
        (any::<u16>(), any::<u16>())
            .prop_map(|(age_ms, limit_ms)| Event::CommandsLate { age_ms, limit_ms }),
        state().prop_map(Event::State),
        fault().prop_map(Event::Fault),
        volts().prop_map(Event::BatteryLow),
        hertz().prop_map(Event::FrequencyLimited),
        (any::<u8>(), magnet()).prop_map(|(motor, magnet)| Event::Magnet { motor, magnet }),
    ]
}

fn to_operator() -> impl Strategy<Value = ToOperator> {
    prop_oneof![
        (any::<u32>(), outcome())
            .prop_map(|(request, outcome)| ToOperator::Reply(Reply { request, outcome })),
        telemetry().prop_map(ToOperator::Telemetry),
        (any::<u32>(), instant(), event()).prop_map(|(number, time, event)| ToOperator::Event(
            EventReport { number, time, event }
        )),
    ]
}

fn comes_back<T: Serialize + DeserializeOwned>(message: &T) -> T {
    let mut buffer = [0; MAXIMUM_MESSAGE];
    let bytes = postcard::to_slice(message, &mut buffer).expect("every message fits a datagram");
    postcard::from_bytes(bytes).expect("what was written can be read")
}

proptest! {
    #[test]
    fn every_message_to_the_robot_comes_back(
        message in prop_oneof![
            order().prop_map(ToRobot::Order),
            (any::<u32>(), any_command()).prop_map(|(number, it)| ToRobot::request(number, it)),
        ],
    ) {
        prop_assert_eq!(comes_back(&message), message);
    }

    #[test]
    fn every_message_to_the_operator_fits_and_comes_back(message in to_operator()) {
        prop_assert_eq!(comes_back(&message), message);
    }

    #[test]
    fn an_unreadable_request_keeps_its_number_and_an_order_has_none(
        number in any::<u32>(),
        rest in prop::collection::vec(any::<u8>(), 0..20),
    ) {
        let mut start = [0; 5];
        let start = postcard::to_slice(&number, &mut start).unwrap();
        prop_assert_eq!(unreadable(&[&[1][..], start, &rest].concat()), Some(number));
        prop_assert_eq!(unreadable(&[&[0][..], start, &rest].concat()), None);
    }

    #[test]
    fn no_bytes_make_the_decoders_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = Datagram::parse(&bytes);
        let _ = postcard::from_bytes::<ToRobot>(&bytes);
        let _ = postcard::from_bytes::<ToOperator>(&bytes);
        let _ = unreadable(&bytes);
    }

    #[test]
    fn a_set_of_faults_holds_what_was_put_in(inside in prop::collection::vec(fault(), 0..12)) {
        let set = inside.iter().copied().fold(Faults::NONE, Faults::with);
        for fault in Fault::ALL {
            prop_assert_eq!(set.contains(fault), inside.contains(&fault));
            prop_assert!(!set.without(fault).contains(fault));
        }
        prop_assert_eq!(set.iter().count(), inside.iter().collect::<std::collections::HashSet<_>>().len());
    }
}

// Replay window

/// The window as one would explain it: everything seen, and how far behind the newest is too far.
#[derive(Default)]
struct ExplainedWindow {
    seen: BTreeSet<u64>,
}

impl ExplainedWindow {
    fn accept(&mut self, counter: u64) -> bool {
        let is_recent = self.seen.last().is_none_or(|newest| {
            u128::from(counter) + u128::from(REPLAY_WINDOW) > u128::from(*newest)
        });
        counter != u64::MAX && is_recent && self.seen.insert(counter)
    }
}

/// Counters that cluster, as a network's do, from anywhere up to the very end.
fn counters() -> impl Strategy<Value = Vec<u64>> {
    let start = prop_oneof![Just(0), any::<u64>(), (u64::MAX - 400)..=u64::MAX];
    let step = prop_oneof![0..4_u64, 0..300_u64, Just(REPLAY_WINDOW), Just(REPLAY_WINDOW - 1)];
    (start, prop::collection::vec((step, any::<bool>()), 0..300)).prop_map(|(start, steps)| {
        let mut newest = start;
        steps
            .into_iter()
            .map(|(step, ahead)| {
                if ahead {
                    newest = newest.saturating_add(step);
                    newest
                } else {
                    newest.saturating_sub(step)
                }
            })
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn the_replay_window_lets_through_what_its_explanation_does(counters in counters()) {
        let (mut window, mut explained) = (ReplayWindow::new(), ExplainedWindow::default());
        for counter in counters {
            let is_new = window.is_new(counter);
            prop_assert_eq!(window.accept(counter), explained.accept(counter), "{}", counter);
            prop_assert_eq!(is_new && !window.is_new(counter), is_new, "once alone");
            prop_assert_eq!(window.newest(), explained.seen.last().copied());
            prop_assert_eq!(window.accepted(), explained.seen.len() as u64);
            let sent = explained.seen.last().map_or(0, |newest| newest + 1);
            prop_assert_eq!(window.missing(), sent - window.accepted());
        }
    }
}

#[test]
fn the_last_counter_is_refused_so_that_none_ever_wraps() {
    let mut window = ReplayWindow::new();
    assert!(window.accept(u64::MAX - 1));
    assert!(!window.accept(u64::MAX));
    assert!(!window.accept(0) && !window.accept(u64::MAX - 1));
    assert!(window.accept(u64::MAX - 2), "and what is behind still arrives");
}

// Sessions on a bad network

/// What the network does to the next datagram.
#[derive(Debug, Clone, Copy)]
enum Fate {
    Arrives,
    Lost,
    /// Arrives twice.
    Doubled,
    /// Arrives after so many others.
    Late(usize),
}

fn fate() -> impl Strategy<Value = Fate> {
    prop_oneof![
        3 => Just(Fate::Arrives),
        2 => Just(Fate::Lost),
        1 => Just(Fate::Doubled),
        2 => (1..40_usize).prop_map(Fate::Late),
    ]
}

/// A network that gives datagrams back in the order of their fates.
struct Network {
    fates: VecDeque<Fate>,
    queue: Vec<(usize, Vec<u8>)>,
    sent: usize,
}

impl Network {
    fn new(fates: Vec<Fate>) -> Self {
        Self { fates: fates.into(), queue: Vec::new(), sent: 0 }
    }

    fn send(&mut self, datagram: &[u8]) -> Vec<Vec<u8>> {
        self.sent += 1;
        let fate = self.fates.pop_front().unwrap_or(Fate::Arrives);
        let due = match fate {
            Fate::Late(by) => self.sent + by,
            _ => self.sent,
        };
        let copies = match fate {
            Fate::Lost => 0,
            Fate::Doubled => 2,
            _ => 1,
        };
        self.queue.extend(std::iter::repeat_n((due, datagram.to_vec()), copies));
        let sent = self.sent;
        self.queue.extract_if(.., |(due, _)| *due <= sent).map(|(_, datagram)| datagram).collect()
    }
}

proptest! {
    #[test]
    fn messages_arrive_unchanged_at_most_once_and_never_backwards(
        fates in prop::collection::vec(fate(), 200),
        commands in prop::collection::vec(prop::option::of(any_command()), 200),
    ) {
        let messages: Vec<_> = (0..)
            .zip(commands)
            .map(|(number, command)| match command {
                Some(command) => ToRobot::request(number, command),
                None => ToRobot::Order(Order::Arm(Permit::new(number))),
            })
            .collect();
        let mut ends = Ends::connected();
        let mut network = Network::new(fates);
        let mut delivered = Vec::new();
        let mut received_in_all = 0;
        for message in &messages {
            let frame = ends.operator.send(ends.now, message).unwrap();
            for datagram in network.send(&frame) {
                received_in_all += 1;
                match ends.robot_hears(&datagram) {
                    RobotReceived::Message(message) => delivered.push(message),
                    RobotReceived::Dropped(reason, None) => {
                        prop_assert!(matches!(reason, DropReason::Stale | DropReason::Replayed));
                    }
                    other => prop_assert!(false, "{:?}", other),
                }
            }
        }
        let places: Vec<_> = delivered
            .iter()
            .map(|message| messages.iter().position(|it| it == message).expect("unchanged"))
            .collect();
        prop_assert!(places.is_sorted_by(|a, b| a < b), "newest wins, once each");
        let dropped = ends.robot.quality(ends.now).dropped;
        prop_assert_eq!(delivered.len() as u64 + dropped.total(), received_in_all, "each counted");
    }

    #[test]
    fn a_handshake_completes_on_a_network_that_loses_doubles_and_delays(
        there in prop::collection::vec(fate(), 12),
        back in prop::collection::vec(fate(), 12),
        entropy in any::<[u8; 32]>(),
    ) {
        let mut now = Instant::from_micros(5);
        let mut robot = RobotSession::new(Some(key(1)), entropy);
        let mut operator = OperatorSession::new(key(1), [22; 32], now);
        let (mut there, mut back) = (Network::new(there), Network::new(back));
        while let Some(at) = operator.poll_at() {
            now = now.max(at);
            while let Some(frame) = operator.poll(now) {
                for datagram in there.send(&frame) {
                    let Some(answer) = answer(robot.receive(now, OPERATOR, &datagram), datagram.len())
                    else { continue };
                    for datagram in back.send(&answer) {
                        operator.receive(now, &datagram);
                    }
                }
            }
        }
        prop_assert_eq!(operator.status(now), Status::Connected);
        let frame = operator.send(now, &ping(1)).unwrap();
        // The Accept may have taken so long that what answers it is late.
        let (RobotReceived::Message(received) | RobotReceived::Late { message: received, .. }) =
            robot.receive(now, OPERATOR, &frame)
        else {
            return Err(TestCaseError::fail("the first command is not taken"));
        };
        prop_assert_eq!(received, ping(1));
        let (_, frame) = robot.send(now, &crate::ends::telemetry(1)).unwrap();
        prop_assert_eq!(operator.receive(now, &frame), OperatorReceived::Message(crate::ends::telemetry(1)));
    }
}
