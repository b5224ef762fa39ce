//! What the scope keeps is what happened: tick by tick, value by value, around a lost phase lock as at any other time.
use std::time::Duration;

use flix_firmware::fast::exchange::Report;
use flix_host::link::{RobotLink, Wish};
use flix_host::scope::Capture;
use flix_protocol::message::{
    Channel, Command, Fault, Outcome, ParameterCommand, ScopeCommand, ScopePlan, ScopeState,
    ScopeStatus, Trigger,
};
use flix_protocol::units::{Degrees, Hertz};
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::{Base, Subject, bench, setpoint};
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::Truth;

const TICK_US: u64 = 100;

fn ask(operation: &mut Operation, command: ScopeCommand) -> ScopeStatus {
    match operation.request(Command::Scope(command)).unwrap() {
        Outcome::Scope(status) => status,
        other => panic!("{other:?}"),
    }
}

fn plan(channels: &[Channel], trigger: Trigger, before: u16) -> ScopePlan {
    ScopePlan { channels: channels.iter().copied().collect(), trigger, before }
}

/// Fetches a complete capture as an operator does.
fn fetch(operation: &mut Operation) -> Capture {
    let status = ask(operation, ScopeCommand::Status);
    assert_eq!(status.state, ScopeState::Complete);
    let mut capture = Capture::new(status);
    while let Some(first) = capture.wanted() {
        let Outcome::ScopeRows(rows) =
            operation.request(Command::Scope(ScopeCommand::Read(first))).unwrap()
        else {
            panic!("no rows")
        };
        assert!(capture.take(&rows), "{first}");
    }
    capture
}

/// What the fast half reported after each tick, and what was true.
fn run(operation: &mut Operation, duration: Duration) -> Vec<(Report, Truth)> {
    let end = operation.now() + duration;
    let mut seen = Vec::new();
    while operation.now() < end {
        operation.tick().unwrap();
        seen.push((operation.robot.report(), operation.robot.truth()));
    }
    seen
}

/// Returns the difference of two angles in degrees, -180 to 180.
fn turned(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

fn set(operation: &mut Operation, name: &str, value: f32) {
    let command = ParameterCommand::Set(name.try_into().unwrap(), value);
    let outcome = operation.request(Command::Parameter(command)).unwrap();
    assert!(matches!(outcome, Outcome::Parameter(_)), "{name}: {outcome:?}");
}

#[test]
fn a_lost_phase_lock_is_kept_as_it_happened() {
    let channels = [
        Channel::TopCurrentQ,
        Channel::BottomCurrentD,
        Channel::TopAngle,
        Channel::BottomSpeed,
        Channel::Theta,
        Channel::ThetaError,
        Channel::Bus,
    ];
    let mut model = RobotModel::named("W").unwrap();
    model.electrical.motor.viscous_friction_un_m_s_rad = 20.0;
    let mut operation = Subject { model: Some(model), seed: 5 }.on(Base::Free).unwrap();
    operation.arm().unwrap();
    operation.disarm().unwrap();
    // Motors that may take next to nothing do not follow through thick oil.
    set(&mut operation, "alignment_current", 0.1);
    set(&mut operation, "current_limit", 0.11);
    ask(&mut operation, ScopeCommand::Begin(plan(&channels, Trigger::Fault, 1_400)));
    operation.arm().unwrap();
    operation.want(setpoint(35.0, 40.0).unwrap());
    let seen = run(&mut operation, Duration::from_secs(4));
    let fault = seen.last().unwrap().0.first_fault;
    assert_eq!(fault, Some(Fault::PhaseLockLost));
    let capture = fetch(&mut operation);
    let status = capture.status();
    assert_eq!(usize::from(status.trigger_row), 1_400);
    let at = |row: usize| {
        let time = status.trigger_time_us + TICK_US * row as u64 - TICK_US * 1_400;
        seen.iter().find(|(report, _)| report.time.as_micros() == time).unwrap()
    };
    assert_eq!(at(1_399).0.first_fault, None);
    assert_eq!(at(1_400).0.first_fault, Some(Fault::PhaseLockLost));
    for row in (0..capture.rows()).step_by(7) {
        let (report, truth) = at(row);
        let [top, bottom] = report.motors;
        let expected = [
            top.current_q.raw() as f64 / 65_536.0,
            bottom.current_d.raw() as f64 / 65_536.0,
            f64::from(Degrees::from(top.angle).get()),
            f64::from(Hertz::from(bottom.speed).get()),
            f64::from(Degrees::from(report.direction).get()),
        ];
        for (channel, (value, expected)) in
            capture.channels().iter().zip(capture.row(row).zip(expected))
        {
            let is_angle = channel.quantity().unit() == "deg";
            let off = if is_angle { turned(value - expected) } else { value - expected };
            assert!(
                off.abs() <= 1.01 * channel.quantity().count(),
                "{row}: {channel} {value} {expected}"
            );
        }
        // What the robot believes is what is: within its encoder's and its divider's errors.
        let angle = capture.row(row).nth(2).unwrap();
        let off = turned(angle + truth.rotor_angle[0].to_degrees());
        assert!(off.abs() < 2.0, "{row}: {off} degrees");
        let bus = capture.row(row).nth(6).unwrap();
        assert!((bus - truth.bus_voltage).abs() < 0.4, "{row}: {bus} of {} V", truth.bus_voltage);
    }
    let speed = capture.row(1_400).nth(3).unwrap();
    assert!(speed.abs() < 34.0, "f stayed behind: {speed} Hz");
}

#[test]
fn a_robot_that_nobody_told_otherwise_has_kept_the_last_200_ms_before_a_fault() {
    use flix_sim::rig::hardware_fault::{HardwareFault, Injected};

    let mut operation = bench(Base::Fixed, 3).unwrap();
    operation.arm().unwrap();
    operation.want(setpoint(-30.0, 0.0).unwrap());
    run(&mut operation, Duration::from_secs(1));
    let from = operation.now() + Duration::from_millis(300);
    let until = from + Duration::from_secs(60);
    operation.robot.disturb(Injected::new(HardwareFault::EncoderLost(1), from, until, 1));
    run(&mut operation, Duration::from_secs(1));
    let capture = fetch(&mut operation);
    assert_eq!((capture.rows(), capture.status().trigger_row), (2_400, 2_000));
    let f = capture.channels().iter().position(|channel| *channel == Channel::Frequency).unwrap();
    let before: Vec<f64> = capture.column(f).take(1_900).map(|(_, value)| value).collect();
    assert!(before.iter().all(|f| (f + 30.0).abs() < 1.0), "it held f until then");
    let fault = capture.nanos(2_000);
    let lost = from.as_micros() * 1_000;
    assert!((lost..lost + 20_000_000).contains(&fault), "{fault} of {lost}");
    // Driven again, it waits for the next.
    operation.robot.mend();
    operation.press(Wish::Clear).unwrap();
    run(&mut operation, Duration::from_millis(500));
    operation.arm().unwrap();
    operation.want(setpoint(-30.0, 0.0).unwrap());
    run(&mut operation, Duration::from_millis(300));
    assert_eq!(ask(&mut operation, ScopeCommand::Status).state, ScopeState::Waiting);
}

#[test]
fn a_level_is_caught_at_the_row_that_crosses_it() {
    let mut operation = bench(Base::Fixed, 8).unwrap();
    let level = Trigger::Level {
        channel: 0,
        level: (20.0 / Channel::Frequency.quantity().count()) as i16,
        rising: true,
    };
    let channels = [Channel::Frequency, Channel::WantedFrequency];
    ask(&mut operation, ScopeCommand::Begin(plan(&channels, level, 3_000)));
    operation.arm().unwrap();
    run(&mut operation, Duration::from_millis(400));
    operation.want(setpoint(30.0, 0.0).unwrap());
    run(&mut operation, Duration::from_secs(1));
    let capture = fetch(&mut operation);
    let at = usize::from(capture.status().trigger_row);
    let f: Vec<f64> = capture.column(0).map(|(_, f)| f).collect();
    assert!(f[at - 1] < 20.0 && f[at] >= 19.99, "{:?}", &f[at - 1..=at]);
    assert_eq!((at, capture.rows()), (3_000, 9_600));
}
