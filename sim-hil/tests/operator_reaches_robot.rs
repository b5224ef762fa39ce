//! What an operator asks travels through protocol and session to the robot's software and back.

use core::time::Duration;

use flix_host::link::{RobotLink, Wish};
use flix_protocol::message::{Command, CrashReport, Fault, Outcome, ResetReason, State, Withheld};
use flix_protocol::session::Key;
use flix_sim::model::RobotModel;
use flix_sim::model::SIMULATED_BOARD;
use flix_sim::plant::Plant;
use flix_sim::rig::bench::setpoint;
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::{Processor, RobotParameters, SimulatedRobot};

/// How often Enter is pressed.
const PRESSES: u64 = 300;

fn operation(network: ChannelParameters) -> Operation {
    let model = RobotModel::named("bench-fixed").expect("a shipped model");
    let mechanics = Plant::new(&model).expect("a shipped model");
    let robot = SimulatedRobot::new(RobotParameters::new(Key::new([7; 32]), 1), mechanics);
    Operation::new(robot, network)
}

#[test]
fn a_robot_with_a_fault_rests_only_once_its_rotors_do() {
    let mut operation = operation(ChannelParameters::PERFECT);
    operation.arm().unwrap();
    operation.want(setpoint(-30.0, 30.0).unwrap());
    operation.run(Duration::from_secs(2), |_| {}).unwrap();
    let (from, until) = (operation.now(), operation.now() + Duration::from_secs(1));
    let fault = HardwareFault::EncoderLost(0);
    operation.robot.disturb(Injected::new(fault, from, until, 1));
    let mut rests_at = None;
    while operation.now() < until {
        operation.run(Duration::from_millis(1), |_| {}).unwrap();
        let (report, f) = (operation.robot.report(), operation.robot.truth().frequency());
        assert!(!report.rests || f.abs() < 3.0, "flash may be written at {f} Hz");
        rests_at = rests_at.or(report.rests.then(|| report.time.since(from)));
    }
    assert_eq!(operation.robot.report().state, State::Faulted);
    assert!(rests_at.is_some_and(|at| at > Duration::from_millis(50)), "{rests_at:?}");
}

#[test]
fn the_robot_says_who_it_is() {
    let mut operation = operation(ChannelParameters::PERFECT);
    operation.wait_until_connected().unwrap();
    let Outcome::Identity(identity) = operation.request(Command::Identify).unwrap() else {
        panic!("another answer");
    };
    assert_eq!(
        (identity.name.as_str(), identity.board.as_str()),
        ("simulated", SIMULATED_BOARD.name)
    );
}

#[test]
fn a_session_stands_through_heavy_loss_and_jitter() {
    let mut operation = operation(ChannelParameters {
        loss: 0.3,
        jitter: std::time::Duration::from_millis(100),
        ..ChannelParameters::QUIET_WIFI
    });
    operation.wait_until_connected().unwrap();
    assert_eq!(operation.request(Command::Ping(5)).unwrap(), Outcome::Pong(5));
}

/// An order that is lost is repeated 20 ms later: 9 ms on the average, and a tenth of a second once in a thousand.
#[test]
fn enter_begins_within_one_or_few_repetitions_through_heavy_loss() {
    let mut operation = operation(ChannelParameters { loss: 0.3, ..ChannelParameters::PERFECT });
    operation.wait_until_connected().unwrap();
    let mut delays = Vec::new();
    for press in 0..PRESSES {
        operation.run(Duration::from_micros(700_000 + 1_300 * press), |_| {}).unwrap();
        let pressed = operation.now();
        operation.press(Wish::Arm).unwrap();
        let mut is_proven = true;
        while operation.robot.report().state == State::Disarmed {
            operation.tick().unwrap();
            let shown = operation.client().telemetry().and_then(|it| it.withheld);
            is_proven &= shown != Some(Withheld::LinkUnproven);
        }
        // A link that has just lost five orders in a row proves itself for half a second first.
        if is_proven {
            delays.push(operation.now().since(pressed).as_secs_f64());
        }
        operation.disarm().unwrap();
    }
    delays.sort_by(f64::total_cmp);
    let mean = delays.iter().sum::<f64>() / delays.len() as f64;
    let longest = delays[delays.len() - 1];
    assert!(delays.len() as u64 > PRESSES * 8 / 10, "{}", delays.len());
    assert!(mean < 0.014 && longest < 0.13, "mean {mean} s, longest {longest} s");
}

/// A walk goes on after a sleep of 0.3 s, when the rotors still turn. After a longer sleep the robot waits for a new wish.
#[test]
fn a_computer_that_sleeps_until_the_rotors_stand_moves_nothing_when_it_wakes() {
    for (asleep_ms, goes_on) in [(300, true), (900, false), (1_100, false), (3_000, false)] {
        let mut operation = operation(ChannelParameters::PERFECT);
        operation.arm().unwrap();
        operation.want(setpoint(20.0, 30.0).unwrap());
        operation.run(Duration::from_secs(1), |_| {}).unwrap();
        operation.operators[0].is_gone = true;
        operation.run(Duration::from_millis(asleep_ms), |_| {}).unwrap();
        operation.operators[0].is_gone = false;
        let mut turns = false;
        let watched = Duration::from_secs(2);
        operation.run(watched, |truth| turns |= !truth.is_slower_than(1.0)).unwrap();
        assert_eq!(turns, goes_on, "{asleep_ms} ms");
        let state = operation.robot.report().state;
        assert_eq!(state == State::Running, goes_on, "{state} after {asleep_ms} ms");
    }
}

fn crash(operation: &mut Operation) -> Option<CrashReport> {
    operation.wait_until_connected().unwrap();
    match operation.request(Command::Crash).unwrap() {
        Outcome::Crash(crash) => crash,
        other => panic!("another answer: {other:?}"),
    }
}

#[test]
fn a_fault_survives_a_restart_and_the_operator_learns_of_it() {
    let mut operation = operation(ChannelParameters::PERFECT);
    assert_eq!(crash(&mut operation), None, "power came");
    operation.arm().unwrap();
    operation.want(setpoint(-30.0, 30.0).unwrap());
    operation.run(Duration::from_secs(3), |_| {}).unwrap();

    let lost = operation.now();
    let mut from = lost;
    for (fault, milliseconds) in [
        (HardwareFault::EncoderLost(1), 300),
        (HardwareFault::Processor(Processor::Hangs), 200),
        (HardwareFault::Processor(Processor::Restarts), 500),
    ] {
        let until = from + Duration::from_millis(milliseconds);
        operation.robot.disturb(Injected::new(fault, from, until, 1));
        from = until;
    }
    operation.run(from.since(lost) + Duration::from_secs(1), |_| {}).unwrap();

    let crash = crash(&mut operation).unwrap();
    assert_eq!(crash.reset, ResetReason::FastLoop);
    let fault = crash.fault.unwrap();
    assert_eq!((fault.first_fault, fault.state), (Some(Fault::EncoderLost), State::Running));
    assert!((fault.frequency.get() + 30.0).abs() < 1.0, "{fault:?}");
    assert!(fault.time.since(lost) < Duration::from_millis(300), "{fault:?}");
    assert!(fault.time > lost && crash.uptime >= Some(fault.time), "{crash:?}");
}
