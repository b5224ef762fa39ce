//! The operator learns of his robot's encoders: readings that were dropped and corrected, and their magnets.

use std::time::Duration;

use flix_firmware::hardware::TICK;
use flix_protocol::message::{EncoderHealth, Event, Fault, Magnet, Order};
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};

use super::bench::Bench;

/// Injects a fault for so long, and waits for its end and for the report of it.
fn after(bench: &mut Bench, fault: HardwareFault, duration: Duration) -> [EncoderHealth; 2] {
    let from = bench.now();
    bench.robot.disturb(Injected::new(fault, from, from + duration, 1));
    bench.wait(duration);
    bench.telemetry();
    bench.telemetry().encoders
}

#[test]
fn readings_that_jump_are_counted_as_corrected_at_their_encoder_alone() {
    for (motor, every, degrees) in [(0, 30, 5.6), (1, 30, -5.6), (0, 50, 3.5), (1, 70, 10.0)] {
        let mut bench = Bench::connected();
        let before = bench.telemetry().encoders;
        let fault = HardwareFault::EncoderJumps(motor, every, degrees);
        let found = after(&mut bench, fault, Duration::from_secs(1));
        let count = |health: [EncoderHealth; 2], motor: usize| {
            health[motor].corrected - before[motor].corrected
        };
        // Encoders give a reading in each tick or in every second one.
        let jumps = 10_000 / every;
        assert!((jumps * 9 / 20..=jumps).contains(&count(found, motor)), "{found:?}");
        assert_eq!(count(found, 1 - motor), 0, "{found:?}");
        assert_eq!(found.map(|it| it.dropped), before.map(|it| it.dropped), "{found:?}");
    }
}

#[test]
fn readings_that_fail_or_are_beyond_belief_are_counted_as_dropped() {
    let mut bench = Bench::connected();
    let before = bench.telemetry().encoders;
    let lost = after(&mut bench, HardwareFault::EncoderLost(1), 20 * TICK);
    let dropped = lost[1].dropped - before[1].dropped;
    assert!((10..=20).contains(&dropped), "{lost:?}");
    let far = after(&mut bench, HardwareFault::EncoderJumps(0, 10, 90.0), Duration::from_secs(1));
    let dropped = far[0].dropped - before[0].dropped;
    assert!((450..=1_000).contains(&dropped), "{far:?}");
    assert_eq!(far.map(|it| it.corrected), before.map(|it| it.corrected), "{far:?}");
    assert!(bench.robot.report().faults.is_empty());
}

#[test]
fn a_robot_that_drives_well_counts_nothing() {
    let mut bench = Bench::shaking();
    bench.hold(bench.walk(30.0, 30.0), Duration::from_secs(2));
    let found = bench.telemetry().encoders;
    assert_eq!(found.map(|it| (it.dropped, it.corrected, it.magnet)), [(0, 0, Magnet::Good); 2]);
}

#[test]
fn a_magnet_out_of_range_is_told_once_and_shown_throughout() {
    for (motor, magnet) in [(0, Magnet::Weak), (1, Magnet::Strong)] {
        let mut bench = Bench::connected();
        for _ in 0..3 {
            let from = bench.now();
            let fault = HardwareFault::Magnet(motor, magnet);
            bench.robot.disturb(Injected::new(fault, from, from + Duration::from_millis(300), 1));
            bench.wait(Duration::from_millis(100));
            assert_eq!(bench.telemetry().encoders[motor].magnet, magnet);
            bench.wait(Duration::from_millis(300));
            assert_eq!(bench.telemetry().encoders[motor].magnet, magnet, "of the last seconds");
        }
        bench.hold(Order::Off, Duration::from_secs(5));
        assert_eq!(bench.telemetry().encoders[motor].magnet, Magnet::Good);
        let reported = Event::Magnet { motor: motor as u8, magnet };
        assert_eq!(bench.events().iter().filter(|event| **event == reported).count(), 1);
        assert!(bench.robot.report().faults.is_empty());
    }
}

#[test]
fn a_missing_magnet_is_named_beside_the_lost_encoder() {
    let mut bench = Bench::connected();
    let fault = HardwareFault::Magnet(1, Magnet::Missing);
    let from = bench.now();
    bench.robot.disturb(Injected::new(fault, from, from + Duration::from_secs(2), 1));
    bench.hold(Order::Off, Duration::from_millis(600));
    let magnets = [Magnet::Good, Magnet::Missing];
    assert_eq!(bench.telemetry().encoders.map(|it| it.magnet), magnets);
    bench.hold(Order::Arm(bench.permit()), Duration::from_millis(100));
    let telemetry = bench.telemetry();
    assert_eq!(telemetry.first_fault, Some(Fault::EncoderLost));
    assert_eq!(telemetry.encoders.map(|it| it.magnet), magnets);
}
