//! Boards that measure no current, on a battery too weak for what is asked: the robot holds theta at the f that the voltage
//! reaches, says so by an event, and nothing winds up.

use core::time::Duration;

use flix_host::link::{RobotLink, Update};
use flix_protocol::message::{Command, Event, Fault, Outcome, ParameterCommand};
use flix_sim::experiment::metrics::HoldMeter;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::bench::{BASES, Base, BenchError, Subject, bench_key, setpoint};
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::{Flash, RobotParameters, SimulatedRobot};

/// Asked for, Hz: the most there is.
const ASKED: f64 = 35.0;
const DIRECTION_DEG: f64 = 20.0;
/// Cells of a battery that does not reach it when it is next to empty, and of one that does.
const WEAK: u32 = 2;
const NEXT_TO_EMPTY: f64 = 0.02;
const STRONG: u32 = 3;

/// What was seen of a robot that was asked for all there is.
#[derive(Debug)]
struct Seen {
    /// Means over the last second.
    f_hz: f64,
    theta_rms_deg: f64,
    /// Mean d current of each motor, A.
    d: [f64; 2],
    /// Largest phase current from power-up on, A.
    largest: f64,
    events: Vec<Event>,
    faults: Vec<Fault>,
}

impl Seen {
    /// Has the robot said that f is limited?
    fn is_told(&self) -> bool {
        self.events.iter().any(|event| matches!(event, Event::FrequencyLimited(_)))
    }
}

/// Asks a robot of this seed with so many cells for all there is, for some seconds.
fn asked(base: Base, cells: u32, seed: u64) -> Result<Seen, BenchError> {
    let mut model = RobotModel::named("W")?;
    let electrical = &mut model.electrical;
    electrical.sense.current = false;
    electrical.pack.cells = cells;
    if cells == WEAK {
        [electrical.pack.charge_at_least, electrical.pack.charge_at_most] = [NEXT_TO_EMPTY; 2];
    }
    // The warning and the fault of an empty battery are for three cells.
    electrical.settings.insert("battery_low".to_owned(), 4.5);
    electrical.settings.insert("under_voltage".to_owned(), 4.2);
    let mut operation = Subject { model: Some(model), seed }.on(base)?;
    operation.arm()?;
    let asked = setpoint(ASKED, DIRECTION_DEG)?;
    operation.want(asked);
    let mut largest = 0.0_f64;
    operation.run(Duration::from_secs(4), |truth| {
        largest = truth.phase_currents.as_flattened().iter().fold(largest, |a, b| a.max(b.abs()));
    })?;
    let (mut d, mut f, mut ticks) = ([0.0; 2], 0.0, 0.0);
    let mut meter = HoldMeter::new(asked);
    operation.run(Duration::from_secs(1), |truth| {
        meter.watch(truth);
        f += truth.frequency();
        ticks += 1.0;
        for (sum, currents) in d.iter_mut().zip(truth.rotor_frame_currents) {
            *sum += currents[0];
        }
    })?;
    let mut events = Vec::new();
    while let Some(update) = operation.client().update() {
        if let Update::Event(report) = update {
            events.push(report.event);
        }
    }
    Ok(Seen {
        f_hz: f / ticks,
        theta_rms_deg: meter.figures().direction_rms_deg,
        d: d.map(|sum| sum / ticks),
        largest,
        events,
        faults: operation.robot.report().faults.iter().collect(),
    })
}

#[test]
fn a_weak_battery_limits_f_with_an_event_and_theta_is_held() {
    for base in BASES {
        for seed in 1..6 {
            let seen = asked(base, WEAK, seed).unwrap();
            assert_eq!(seen.faults, [], "{base}, seed {seed}: {seen:?}");
            assert!(seen.theta_rms_deg < 3.0, "{base}, seed {seed}: {seen:?}");
            assert!(seen.f_hz > 20.0 && seen.f_hz < ASKED - 0.5, "{base}, seed {seed}: {seen:?}");
            assert!(seen.is_told(), "{base}, seed {seed}: {seen:?}");
            // As much against the magnets as weakening may, and else a share of the 1.5 A that walk: nothing has wound up.
            let d_range = -1.2..0.15;
            assert!(seen.d.iter().all(|d| d_range.contains(d)), "{base}, seed {seed}: {seen:?}");
            assert!(seen.largest < 2.0, "{base}, seed {seed}: {seen:?}");
        }
    }
}

#[test]
fn a_battery_that_is_strong_enough_limits_nothing() {
    for base in BASES {
        let seen = asked(base, STRONG, 1).unwrap();
        assert!((seen.f_hz - ASKED).abs() < 0.05, "{base}: {seen:?}");
        assert!(seen.theta_rms_deg < 1.0 && !seen.is_told(), "{base}: {seen:?}");
    }
}

/// A new robot in voltage mode with motors of a tenth of an ohm, of which it knows nothing.
fn new_with_strong_motors() -> Operation {
    let mut model = RobotModel::named("bench-fixed").unwrap();
    model.electrical.sense.current = false;
    model.electrical.motor.phase_resistance_ohm = 0.1;
    let mut parameters = RobotParameters::of(&model.electrical, bench_key(), 1).unwrap();
    parameters.flash = Flash::default();
    let robot = SimulatedRobot::new(parameters, Plant::new(&model).unwrap());
    Operation::new(robot, ChannelParameters::QUIET_WIFI)
}

/// Arms, or is refused; returns the largest phase current meanwhile and for a second after, A, and the refusal.
fn armed(operation: &mut Operation) -> (f64, Option<String>) {
    let refusal = operation.arm().err().map(|error| error.to_string());
    let mut largest = 0.0_f64;
    operation
        .run(Duration::from_secs(1), |truth| largest = largest.max(truth.largest_current()))
        .unwrap();
    (largest, refusal)
}

#[test]
fn a_new_robot_gives_its_motors_no_current_before_they_are_entered() {
    let mut operation = new_with_strong_motors();
    operation.wait_until_connected().unwrap();
    let settings = [
        ("top_phase_resistance", 0.1),
        ("bottom_phase_resistance", 0.1),
        ("top_flux_linkage", 3.0),
        ("bottom_flux_linkage", 3.0),
    ];
    for (name, value) in settings {
        let (largest, refusal) = armed(&mut operation);
        assert!(refusal.is_some_and(|it| it.contains("flix parameters set") && it.contains(name)));
        assert!(largest < 0.01, "{largest} A");
        let accept = operation.request(Command::Parameter(ParameterCommand::Accept)).unwrap();
        assert!(matches!(accept, Outcome::Refused(_)), "{accept:?}");
        let set = ParameterCommand::Set(name.try_into().unwrap(), value);
        operation.request(Command::Parameter(set)).unwrap();
    }
    let (largest, refusal) = armed(&mut operation);
    assert_eq!(refusal, None);
    assert!(largest < 2.0, "{largest} A");
}
