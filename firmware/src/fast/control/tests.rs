//! What the fast half promises, on the bench.

use core::time::Duration;

use crate::board::{BOARDS, Board, Chip, GENERIC_ESP32C6, counts_of_millivolts};
use crate::fast::configuration::Configuration;
use crate::fast::control::Control;
use crate::fast::control::bench::{Bench, HARDWARE};
use crate::fast::exchange::{Asked, Wanted};
use crate::fast::foc::current::CurrentLoop;
use crate::fast::supervisor::{Conditions, Supervisor};
use crate::hardware::{
    Bridge, CurrentSense, Encoder, EncoderAngle, EncoderReading, Hardware, Magnet, Sensors,
};
use crate::settings::Settings;
use crate::units::{Counts, Speed};
use flix_protocol::message::{Fault, Faults, State};
use flix_protocol::units::Instant;

const FREE: Option<f64> = Some(0.35);
const PAIRS: [(f32, f32); 6] =
    [(10.0, 0.0), (20.0, 30.0), (30.0, -60.0), (-30.0, 90.0), (35.0, 0.0), (-35.0, 45.0)];

fn armed(base: Option<f64>) -> Bench {
    let mut bench = Bench::new(base);
    bench.arm();
    bench
}

fn running(base: Option<f64>, frequency: f32, direction: f32) -> Bench {
    let mut bench = armed(base);
    bench.command(frequency, direction);
    bench.run(0.7);
    assert_eq!(bench.state(), State::Running);
    bench
}

/// Commands, waits, and holds the truth against it.
#[track_caller]
fn assert_holds(bench: &mut Bench, frequency: f32, direction: f32) {
    bench.command(frequency, direction);
    bench.run(0.5);
    let held = bench.hold(frequency.into(), direction.into(), 0.5);
    assert!(held.frequency < 0.01 && held.direction < 0.15, "{frequency} {direction} {held:?}");
}

#[test]
fn holds_frequency_and_direction_on_a_fixed_base() {
    let mut bench = armed(None);
    for (frequency, direction) in PAIRS {
        assert_holds(&mut bench, frequency, direction);
    }
}

#[test]
fn holds_frequency_and_direction_on_a_base_that_drives_back() {
    let mut bench = armed(FREE);
    for (frequency, direction) in PAIRS {
        assert_holds(&mut bench, frequency, direction);
    }
}

#[test]
fn alignment_finds_offset_phase_order_and_eccentricity() {
    let mut bench = Bench::new(FREE);
    bench.motors[1].reversed = true;
    bench.arm();
    let report = bench.control.report();
    assert_eq!(report.alignments, 1);
    for (motor, found) in bench.motors.iter().zip(report.alignment) {
        assert_eq!(found.reversed, motor.reversed);
        let radians = |turn: i32| f64::from(turn) / 4_294_967_296.0 * std::f64::consts::TAU;
        let offset = radians(found.electrical_offset.raw() as i32) - motor.offset;
        assert!(offset.abs() < 0.03, "electrical offset is off by {offset} rad");
        let [(first, phase), _] = motor.eccentricity;
        // amplitude sin(angle + phase) = cosine cos(angle) + sine sin(angle)
        let [cosine, sine, ..] = found.eccentricity.map(radians);
        assert!((cosine - first * phase.sin()).abs() < 0.001, "{cosine}");
        assert!((sine - first * phase.cos()).abs() < 0.001, "{sine}");
    }
}

#[test]
fn works_with_swapped_wires_on_one_motor() {
    let mut bench = Bench::new(FREE);
    bench.motors[0].reversed = true;
    bench.arm();
    assert_holds(&mut bench, 30.0, 30.0);
}

#[test]
fn a_voltage_limit_counts_in_whichever_tick_it_holds() {
    let mut bench = running(FREE, 20.0, 30.0);
    while !bench.control.timing.ticks.is_multiple_of(4) {
        bench.tick();
    }
    for _ in 0..40 {
        // A spike of the amplifiers between two updates of the shaker.
        let count = bench.control.timing.ticks as u32;
        bench.sense_offset = if count.is_multiple_of(4) { 1_000 } else { 0 };
        bench.tick();
        let limited = bench.control.loops.iter().any(CurrentLoop::limited);
        match count % 4 {
            0 => assert!(limited, "{count}"),
            3 => assert!(!limited && bench.control.shaker.limited(), "{count}"),
            _ => {}
        }
    }
}

#[test]
fn reverses_within_half_a_second_below_the_current_limit() {
    let mut bench = running(FREE, 30.0, 20.0);
    bench.command(-30.0, 20.0);
    bench.run(0.5);
    assert!((bench.frequency() + 30.0).abs() < 0.2, "{}", bench.frequency());
    assert!(bench.direction_error(20.0).abs() < 3.0);
    assert!(bench.peak_current < 2.0, "{}", bench.peak_current);
}

#[test]
fn turns_theta_the_short_way_through_ninety_degrees_without_losing_f() {
    let mut bench = running(FREE, 30.0, 80.0);
    bench.command(30.0, -80.0);
    // Turns of the shaker: within one the base turns the rotors to and fro.
    for _ in 0..15 {
        let mut sum = 0.0;
        for _ in 0..333 {
            bench.tick();
            // The long way would pass forward.
            assert!(bench.direction_error(90.0).abs() < 15.0);
            sum += bench.frequency();
        }
        assert!((sum / 333.0 - 30.0).abs() < 0.2, "{}", sum / 333.0);
    }
    assert!(bench.direction_error(-80.0).abs() < 0.5);
}

#[test]
fn works_in_voltage_mode_without_a_current_sense() {
    let hardware = Hardware { current_sense: None, ..HARDWARE };
    let mut bench = Bench::with(FREE, Settings::DEFAULT, hardware);
    bench.arm();
    assert_holds(&mut bench, 30.0, -30.0);
}

#[test]
fn predicts_where_the_encoder_is_slower_than_the_loop() {
    let mut bench = Bench::new(FREE);
    bench.encoder_every = 3;
    bench.arm();
    bench.command(30.0, 30.0);
    bench.run(0.5);
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.02 && held.direction < 0.2, "{held:?}");
}

#[test]
fn stop_brings_the_rotors_to_rest_together_and_is_latched() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.asked.stops += 1;
    for _ in 0..3_500 {
        bench.tick();
        if bench.frequency().abs() > 3.0 {
            assert!(bench.direction_error(30.0).abs() < 3.0, "phase-locked on the way down");
        }
    }
    assert_eq!(bench.state(), State::Disarmed);
    assert!(bench.fastest() < 0.5);
    bench.want(Wanted::Arm);
    bench.run(0.1);
    assert_eq!(bench.state(), State::Disarmed, "the stop is latched");
}

#[test]
fn a_robot_that_restarts_while_its_rotors_spin_brakes_them() {
    let mut bench = running(FREE, 35.0, 30.0);
    let started = Bench::new(FREE);
    bench.control = started.control;
    bench.asked = started.asked;
    // The tracker knows nothing yet.
    bench.motors[1].encoder_alive = false;
    bench.run(0.5);
    assert_eq!((bench.state(), bench.fastest() < 0.5), (State::Disarmed, true));
    bench.run(0.1);
    assert_eq!(bench.last.bridges, [Bridge::Off; 2]);
}

#[test]
fn a_lost_encoder_brakes_both_rotors_to_rest() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.motors[0].encoder_alive = false;
    bench.run(0.5);
    assert_eq!(bench.control.report().first_fault, Some(Fault::EncoderLost));
    assert!(bench.fastest() < 0.5, "{}", bench.fastest());
    assert!(bench.peak_current < 2.0, "{}", bench.peak_current);
    bench.run(1.5);
    assert_eq!(bench.last.bridges, [Bridge::Off; 2]);
}

#[test]
fn a_dead_encoder_is_named_and_nothing_spins() {
    let mut bench = Bench::new(FREE);
    bench.motors[1].encoder_alive = false;
    bench.run(0.05);
    bench.want(Wanted::Arm);
    bench.until(State::Faulted);
    assert_eq!(bench.control.report().first_fault, Some(Fault::EncoderLost));
}

/// Lets something go wrong at 35 Hz and checks the promise of every fault: named, latched, rotors
/// at rest within 0.6 s of being knowable, current below its limit.
fn goes_wrong(expected: Fault, knowable_s: f64, break_it: impl Fn(&mut Bench)) -> Bench {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.peak_current = 0.0;
    break_it(&mut bench);
    bench.run(knowable_s + 0.6);
    let report = bench.control.report();
    assert_eq!(report.first_fault, Some(expected), "{}", report.faults);
    assert_eq!(report.state, State::Faulted);
    assert!(bench.fastest() < 0.5, "still at {} Hz", bench.fastest());
    assert!(bench.peak_current < 2.0, "{} A", bench.peak_current);
    bench.want(Wanted::Arm);
    bench.run(0.1);
    assert_eq!(bench.state(), State::Faulted, "latched");
    bench
}

#[test]
fn a_stuck_encoder_is_a_lost_one() {
    goes_wrong(Fault::EncoderLost, 0.01, |bench| {
        bench.motors[1].encoder_stuck = Some(EncoderAngle::from_count(123, 12))
    });
}

#[test]
fn an_empty_battery_ramps_down_phase_locked() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.bus = 8.9;
    for _ in 0..5_500 {
        bench.tick();
        let locked = bench.direction_error(30.0).abs() < 5.0;
        assert!(locked || bench.frequency().abs() < 3.0, "{}", bench.direction_error(30.0));
    }
    assert_eq!(bench.control.report().first_fault, Some(Fault::UnderVoltage));
    assert!(bench.fastest() < 0.5);
}

#[test]
fn a_weak_battery_holds_f_close_to_what_its_voltage_allows_and_says_so() {
    for (base, frequency) in [(None, 35.0), (FREE, 35.0), (FREE, -35.0)] {
        let weak = Settings { under_voltage: 5.5, ..Settings::DEFAULT };
        let mut bench = Bench::with(base, weak, HARDWARE);
        bench.bus = 6.4;
        bench.arm();
        bench.command(frequency, 30.0);
        bench.run(1.5);
        let report = bench.control.report();
        assert_eq!(report.faults, Faults::NONE);
        assert_eq!(report.events.frequency_limited, 1, "{base:?} {frequency}");
        // It stays where it is.
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for _ in 0..10 {
            bench.run(0.1);
            let hertz =
                f64::from(bench.control.driving_shaker().unwrap().frequency().raw()) / 429_496.7;
            (least, most) = (least.min(hertz.abs()), most.max(hertz.abs()));
        }
        assert!(most < 34.0 && least > 0.97 * most && least > 24.0, "{least} to {most} Hz");
        assert!(bench.direction_error(30.0).abs() < 1.0, "{}", bench.direction_error(30.0));
        // What can be reached is no limit.
        bench.bus = 12.0;
        bench.run(1.0);
        let held = bench.hold(frequency.into(), 30.0, 0.3);
        assert!(held.frequency < 0.02 && held.direction < 0.3, "{held:?}");
    }
}

#[test]
fn a_bus_above_its_limit_is_over_voltage() {
    goes_wrong(Fault::OverVoltage, 0.02, |bench| bench.bus = 15.0);
}

#[test]
fn a_bus_that_the_converter_does_not_tell_from_a_higher_one_is_over_voltage_whatever_the_limit() {
    for battery_scale in [0.95, 1.0, 1.05] {
        let settings = Settings { over_voltage: 40.0, battery_scale, ..Settings::DEFAULT };
        for (bus, is_told) in [(16.2, true), (16.4, false), (40.0, false)] {
            let mut bench = Bench::with(FREE, settings, HARDWARE);
            bench.bus = bus;
            bench.run(0.1);
            bench.want(Wanted::Arm);
            bench.run(0.1);
            let is_high = bench.control.report().faults.contains(Fault::OverVoltage);
            assert_eq!(is_high, !is_told, "{bus} V, {battery_scale}");
        }
    }
}

#[test]
fn a_blocked_rotor_stalls_or_loses_its_lock() {
    let mut bench = running(FREE, 30.0, 0.0);
    bench.motors[0].blocked = true;
    bench.run(1.0);
    let first = bench.control.report().first_fault;
    assert!(matches!(first, Some(Fault::Stall | Fault::PhaseLockLost)), "{first:?}");
    assert!(bench.fastest() < 0.5);
    assert!(bench.peak_current < 2.0, "{} A", bench.peak_current);
}

#[test]
fn a_rotor_blocked_from_the_start_is_a_stall() {
    let mut bench = armed(FREE);
    bench.motors[0].blocked = true;
    bench.command(20.0, 0.0);
    bench.run(1.0);
    let first = bench.control.report().first_fault;
    assert!(matches!(first, Some(Fault::Stall | Fault::PhaseLockLost)), "{first:?}");
}

#[test]
fn dead_current_amplifiers_are_a_fault() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.sense_dead = Some(2060);
    bench.run(0.7);
    let first = bench.control.report().first_fault;
    assert_eq!(first, Some(Fault::CurrentSense));
    assert!(bench.fastest() < 0.5);
}

#[test]
fn amplifiers_at_their_stop_are_an_over_current() {
    let bench = goes_wrong(Fault::OverCurrent, 0.001, |bench| bench.sense_dead = Some(4095));
    assert!(bench.now_us > 0);
}

/// What amplifiers around half the supply show at no current, mV.
const MIDDLE: u16 = 1_650;

/// Returns whether a phase at this voltage of its amplifier is an over-current with the highest limit, where no current is
/// measured to be so many counts off its design.
fn is_beyond(board: &Board, millivolts: u16, zero_off: i16) -> Option<bool> {
    let zero = board.hardware.current_sense?.zero_count + zero_off;
    let settings = Settings { over_current: 30.0, ..Settings::DEFAULT };
    let mut control = Control::new(Configuration::new(&settings, &board.hardware));
    control.take_zeros([[Counts::new(zero); 2]; 2]);
    control.take_range();
    let count = counts_of_millivolts(millivolts).cast_signed();
    Some(control.measure_currents(&Sensors {
        encoders: [Encoder::Failed; 2],
        magnets: [Magnet::Good; 2],
        phase_current: Some([[zero, count], [zero; 2]]),
        bus_voltage: None,
    }))
}

#[test]
fn what_a_chips_converter_clips_is_an_over_current_whatever_the_limit() {
    for board in BOARDS.map(|board| board.with_current_sense()) {
        // What calibration makes of no and of all ones (ESP-IDF for the ESP32, the data sheet of the ESP32-S3), and within.
        let [clipped, measured] = match board.chip {
            Chip::Esp32 => [[200, 3_056], [210, 3_050]],
            Chip::Esp32S3 => [[0, 2_900], [90, 2_890]],
            Chip::Esp32C6 => [[0, 3_300], [90, 3_210]],
        };
        for zero_off in [-300, -15, 0, 15, 300] {
            for millivolts in clipped {
                let found = is_beyond(&board, millivolts, zero_off);
                assert_ne!(found, Some(false), "{} {millivolts} mV {zero_off}", board.feature);
            }
        }
        // Of both ends the nearer one is the limit.
        let nearer = measured.into_iter().min_by_key(|millivolts| MIDDLE.abs_diff(*millivolts));
        let found = nearer.and_then(|millivolts| is_beyond(&board, millivolts, 0));
        assert_ne!(found, Some(true), "{}", board.feature);
    }
}

#[test]
fn a_bus_that_nobody_measures_is_neither_too_low_nor_too_high() {
    // Two cells and four.
    for nominal_voltage in [7.4, 14.8] {
        let settings = Settings { nominal_voltage, ..Settings::DEFAULT };
        let mut control = Control::new(Configuration::new(&settings, &GENERIC_ESP32C6.hardware));
        let reading = Encoder::Reading(EncoderReading { angle: EncoderAngle::ZERO, age_us: 0 });
        let sensors = Sensors {
            encoders: [reading; 2],
            magnets: [Magnet::Good; 2],
            phase_current: None,
            bus_voltage: None,
        };
        let mut asked = Asked { begins: true, ..Asked::default() };
        for tick in 0..3_000 {
            let now = Instant::from_micros(100 * tick);
            asked.hear(now, now + Duration::from_secs(1));
            asked.wanted = if tick > 100 { Wanted::Arm } else { Wanted::Off };
            control.tick(now, &sensors, &asked);
        }
        let report = control.report();
        assert_eq!((report.faults, report.events.battery_low), (Faults::NONE, 0));
        assert_ne!(report.state, State::Disarmed, "it was armed");
    }
}

#[test]
fn a_loop_that_stands_still_is_an_overrun() {
    goes_wrong(Fault::LoopOverrun, 0.001, |bench| bench.now_us += 5_000);
}

#[test]
fn a_single_late_tick_is_forgiven() {
    let mut bench = running(FREE, 30.0, 30.0);
    for _ in 0..20 {
        bench.now_us += 100;
        bench.run(0.02);
    }
    let report = bench.control.report();
    assert_eq!((report.state, report.timing.overruns), (State::Running, 20));
}

#[test]
fn ticks_that_were_late_before_arming_are_forgiven_within_a_tenth_of_a_second() {
    let mut bench = Bench::new(FREE);
    for _ in 0..2_000 {
        bench.now_us += 100;
        bench.run(1e-4);
    }
    bench.arm();
    bench.now_us += 100;
    bench.run(0.1);
    assert_eq!(bench.control.report().state, State::Armed);
}

#[test]
fn a_tick_is_late_once_it_is_half_an_interval_behind() {
    for (behind, overruns) in [(49, 0), (50, 0), (51, 1)] {
        let mut bench = Bench::new(FREE);
        bench.run(0.1);
        bench.now_us += behind;
        bench.run(0.1);
        let timing = bench.control.report().timing;
        assert_eq!((timing.overruns, timing.longest_interval_us), (overruns, 100 + behind as u32));
    }
}

/// Settings that the bench's 12 V are beyond.
fn strict() -> Configuration {
    Configuration::new(&Settings { over_voltage: 11.0, ..Settings::DEFAULT }, &HARDWARE)
}

#[test]
fn settings_are_taken_over_at_rest_and_not_before() {
    let mut bench = running(FREE, 30.0, 30.0);
    assert!(!bench.control.configure(&strict()), "the motors are driven");
    bench.want(Wanted::Off);
    bench.until(State::Disarmed);
    bench.arm();
    bench.want(Wanted::Off);
    bench.until(State::Disarmed);
    bench.run(0.1);
    assert!(bench.control.configure(&strict()));
    bench.want(Wanted::Arm);
    bench.until(State::Faulted);
    assert_eq!(bench.control.report().first_fault, Some(Fault::OverVoltage));

    let mut bench = Bench::new(FREE);
    bench.tick();
    assert!(!bench.control.configure(&strict()), "nobody knows yet whether the rotors rest");
    bench.run(0.05);
    assert!(bench.control.configure(&strict()));
}

#[test]
fn a_fault_that_the_slow_half_found_is_latched() {
    let mut bench = Bench::new(FREE);
    bench.run(0.05);
    bench.control.raise(Fault::Settings);
    bench.want(Wanted::Arm);
    bench.run(0.05);
    let report = bench.control.report();
    assert_eq!((report.state, report.first_fault), (State::Faulted, Some(Fault::Settings)));
}

#[test]
fn each_motor_is_reported_as_it_is() {
    let mut bench = armed(None);
    bench.motors[1].viscous *= 4.0;
    bench.command(30.0, 30.0);
    bench.run(0.7);
    let [top, bottom] = bench.control.report().motors;
    assert!(top.speed.raw() > 0 && bottom.speed.raw() < 0, "{top:?} {bottom:?}");
    let [light, heavy] = [top, bottom].map(|motor| motor.current_q.magnitude().raw());
    assert!(heavy > 2 * light, "{light} {heavy}");
    for (motor, truth) in [top, bottom].into_iter().zip(&bench.motors) {
        let turns = f64::from(motor.angle.raw()) / 4_294_967_296.0;
        let off = (turns - truth.angle / std::f64::consts::TAU + 0.5).rem_euclid(1.0) - 0.5;
        assert!(off.abs() < 0.02, "{off} turns");
    }
}

#[test]
fn frequency_battery_and_share_of_its_voltage_are_reported() {
    let mut bench = running(None, 30.0, 30.0);
    let mut at = |bus: f64| {
        bench.bus = bus;
        bench.run(0.3);
        bench.asked.period = bench.asked.period.wrapping_add(1);
        bench.run(0.3);
        let report = bench.control.report();
        let frequency = report.frequency.raw() - Speed::from_hertz(30.0).raw();
        assert!(frequency.abs() < Speed::from_hertz(0.3).raw(), "{frequency}");
        let volts = f64::from(report.bus_voltage.unwrap().raw()) / 65_536.0;
        assert!((volts - bus).abs() < 0.1, "{volts} V");
        f64::from(report.modulation) / 65_535.0
    };
    let (full, low) = (at(12.6), at(10.5));
    assert!((0.3..0.7).contains(&full), "{full}");
    assert!((low / full - 12.6 / 10.5).abs() < 0.05, "{full} {low}");
    let unmeasured = Hardware { bus_microvolts_per_count: None, ..HARDWARE };
    let mut bench = Bench::with(None, Settings::DEFAULT, unmeasured);
    bench.run(0.05);
    assert_eq!(bench.control.report().bus_voltage, None);
}

#[test]
fn a_robot_that_is_armed_on_a_low_battery_says_so_again() {
    let mut bench = Bench::new(None);
    bench.bus = 9.5;
    bench.run(0.5);
    let said = bench.control.report().events.battery_low;
    bench.arm();
    assert_eq!((said, bench.control.report().events.battery_low), (1, 2));
}

#[test]
fn an_open_phase_is_named_in_alignment_and_nothing_spins() {
    let mut bench = Bench::new(FREE);
    bench.motors[0].open = true;
    bench.run(0.05);
    bench.want(Wanted::Arm);
    bench.until(State::Faulted);
    let first = bench.control.report().first_fault;
    assert!(matches!(first, Some(Fault::Alignment | Fault::CurrentSense)), "{first:?}");
    assert!(bench.fastest() < 3.0);
}

#[test]
fn a_missing_magnet_is_named_in_alignment() {
    let mut bench = Bench::new(FREE);
    bench.motors[1].encoder_stuck = Some(EncoderAngle::from_count(77, 12));
    bench.run(0.05);
    bench.want(Wanted::Arm);
    bench.until(State::Faulted);
    assert_eq!(bench.control.report().first_fault, Some(Fault::Alignment));
}

#[test]
fn encoders_of_each_others_motors_are_a_fault_at_the_first_command() {
    let mut bench = Bench::new(FREE);
    bench.encoders_swapped = true;
    bench.arm();
    bench.command(5.0, 0.0);
    bench.run(1.0);
    let first = bench.control.report().first_fault;
    assert!(matches!(first, Some(Fault::PhaseLockLost | Fault::CurrentSense)), "{first:?}");
    assert!(bench.fastest() < 0.5, "still at {} Hz", bench.fastest());
}

#[test]
fn a_current_zero_far_off_is_named_in_alignment() {
    let mut bench = Bench::new(FREE);
    bench.sense_offset = 600;
    bench.run(0.05);
    bench.want(Wanted::Arm);
    bench.until(State::Faulted);
    assert_eq!(bench.control.report().first_fault, Some(Fault::CurrentSense));
}

/// Aligns with amplifiers of which the board's description reads 2.5 times their gain.
fn aligned_with_misread_gain(current_scale: f32) -> Bench {
    let sense = HARDWARE.current_sense.map(|sense| CurrentSense {
        microamperes_per_count: sense.microamperes_per_count / 2 * 5,
        ..sense
    });
    let hardware = Hardware { current_sense: sense, ..HARDWARE };
    let mut bench = Bench::with(FREE, Settings { current_scale, ..Settings::DEFAULT }, hardware);
    bench.run(0.05);
    bench.want(Wanted::Arm);
    while matches!(bench.state(), State::Disarmed | State::Aligning) {
        bench.tick();
    }
    bench
}

#[test]
fn amplifiers_of_another_gain_are_named_in_alignment() {
    let report = aligned_with_misread_gain(1.0).control.report();
    assert_eq!(report.first_fault, Some(Fault::CurrentSense));
}

#[test]
fn the_scale_of_the_current_sense_sets_a_misread_gain_right() {
    let mut bench = aligned_with_misread_gain(0.4);
    assert_eq!(bench.state(), State::Armed);
    bench.command(30.0, 30.0);
    bench.run(0.5);
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.01 && held.direction < 0.15, "{held:?}");
}

#[test]
fn a_remembered_alignment_is_checked_and_arms_in_half_a_second() {
    let mut first = armed(FREE);
    let found = first.control.report().alignment;
    let mut remembered = Settings::DEFAULT;
    remembered.learn(found);
    let mut bench = Bench::with(FREE, remembered, HARDWARE);
    bench.run(0.05);
    bench.want(Wanted::Arm);
    bench.run(0.6);
    assert_eq!(bench.state(), State::Armed);
    assert_holds(&mut bench, 30.0, 30.0);
    // The same memory on a motor whose wires were swapped since.
    first = Bench::with(FREE, remembered, HARDWARE);
    first.motors[1].reversed = true;
    first.run(0.05);
    first.want(Wanted::Arm);
    first.until(State::Faulted);
    assert_eq!(first.control.report().first_fault, Some(Fault::Alignment));
}

#[test]
fn a_cleared_fault_arms_again() {
    let mut bench = goes_wrong(Fault::LoopOverrun, 0.001, |bench| bench.now_us += 5_000);
    bench.run(0.5);
    bench.want(Wanted::Clear);
    bench.run(0.01);
    assert_eq!(bench.state(), State::Disarmed);
    bench.want(Wanted::Arm);
    bench.until(State::Armed);
}

#[test]
fn a_fault_whose_cause_stays_is_not_cleared() {
    let mut bench = goes_wrong(Fault::OverVoltage, 0.02, |bench| bench.bus = 15.0);
    bench.run(0.5);
    bench.want(Wanted::Clear);
    bench.run(0.01);
    assert_eq!(bench.control.report().first_fault, Some(Fault::OverVoltage));
    bench.bus = 12.0;
    bench.run(0.1);
    bench.want(Wanted::Clear);
    bench.run(0.01);
    assert_eq!(bench.state(), State::Disarmed);
}

/// Returns the state in the tick that falls on this age of the last command.
fn silent_for(bench: &mut Bench, microseconds: u64) -> (State, bool) {
    let heard = bench.asked.heard.as_micros();
    while bench.now_us <= heard + microseconds {
        bench.tick();
    }
    let report = bench.control.report();
    (report.state, report.link_late)
}

#[test]
fn the_ladder_warns_ramps_and_disarms_to_the_tick() {
    let mut bench = running(FREE, 30.0, 30.0);
    bench.keep_alive = false;
    assert_eq!(silent_for(&mut bench, 99_900), (State::Running, false));
    assert_eq!(silent_for(&mut bench, 100_000), (State::Running, true));
    assert_eq!(silent_for(&mut bench, 249_900), (State::Running, true));
    assert_eq!(silent_for(&mut bench, 250_000), (State::Stopping, true));
    assert_eq!(silent_for(&mut bench, 999_900), (State::Armed, true));
    assert!(bench.fastest() < 0.5);
    let (state, _) = silent_for(&mut bench, 1_000_000);
    assert!(matches!(state, State::Stopping | State::Disarmed), "{state}");
    assert_eq!(silent_for(&mut bench, 1_100_000), (State::Disarmed, false));
    let events = bench.control.report().events;
    assert_eq!((events.link_late, events.command_deadline, events.link_lost), (1, 1, 1));
}

#[test]
fn commands_that_come_back_before_the_disarm_go_on() {
    let mut bench = running(FREE, 30.0, 30.0);
    bench.keep_alive = false;
    bench.run(0.3);
    assert_eq!(bench.state(), State::Stopping);
    bench.keep_alive = true;
    bench.run(0.5);
    assert_eq!(bench.state(), State::Running);
    assert!((bench.frequency() - 30.0).abs() < 0.2);
}

#[test]
fn encoders_that_see_no_rest_do_not_keep_a_stopped_robot_armed() {
    let mut supervisor = Supervisor::new();
    let mut asked = Asked { wanted: Wanted::Arm, begins: true, ..Asked::default() };
    let conditions =
        Conditions { present: Faults::NONE, at_rest: false, finished: true, outdated: false };
    supervisor.update(Instant::START, &asked, &conditions);
    supervisor.update(Instant::START, &asked, &conditions);
    asked.wanted = Wanted::Off;
    let mut update = || {
        supervisor.update(Instant::START, &asked, &conditions);
        supervisor.state
    };
    let first = update();
    let ticks = (0..20_000).take_while(|_| update() == State::Stopping).count();
    assert_eq!(first, State::Stopping);
    // Ramps down for 0.4 s, then brakes for 0.5 s.
    assert!((8_990..=9_010).contains(&ticks), "{ticks}");
    assert_eq!(supervisor.state, State::Disarmed);
}

#[test]
fn rests_after_arming_until_the_first_setpoint() {
    let mut bench = Bench::new(FREE);
    bench.command(30.0, 0.0);
    bench.arm();
    bench.run(0.3);
    assert_eq!(bench.state(), State::Armed, "a setpoint from before arming moves nothing");
    assert!(bench.fastest() < 0.5);
}

#[test]
fn a_battery_too_flat_for_f_costs_f_and_not_theta() {
    let weak = Settings { under_voltage: 5.5, ..Settings::DEFAULT };
    let mut bench = Bench::with(FREE, weak, HARDWARE);
    bench.bus = 6.4;
    bench.arm();
    bench.command(35.0, 30.0);
    bench.run(0.6);
    let held = bench.hold(35.0, 30.0, 0.3);
    assert!(held.direction < 3.0 && held.frequency > 0.5, "{held:?}");
    assert_eq!(bench.control.report().faults, Faults::NONE);
    bench.bus = 12.0;
    bench.run(0.5);
    let held = bench.hold(35.0, 30.0, 0.3);
    assert!(held.frequency < 0.01 && held.direction < 0.15, "{held:?}");
}

#[test]
fn a_phase_that_opens_while_running_stops_the_rotors() {
    let mut bench = running(FREE, 30.0, 30.0);
    bench.peak_current = 0.0;
    bench.motors[0].open = true;
    bench.run(1.0);
    let report = bench.control.report();
    assert_eq!(report.first_fault, Some(Fault::Alignment), "{}", report.faults);
    assert!(bench.fastest() < 0.5, "still at {} Hz", bench.fastest());
    assert!(bench.peak_current < 2.0, "{} A", bench.peak_current);
}

#[test]
fn conversions_beside_the_middle_of_the_pwm_period_hide_no_phase() {
    // Of an inductance so small that pulses move the current by as much as flows.
    const MILLIHENRY: f32 = 0.1;
    for (inverted, frequency) in [(1.0, 15.0), (-1.0, 15.0), (1.0, 30.0), (-1.0, 30.0)] {
        let settings = Settings { phase_inductance: [MILLIHENRY; 2], ..Settings::DEFAULT };
        let mut bench = Bench::with(None, settings, HARDWARE);
        for motor in &mut bench.motors {
            motor.inductance = 1e-3 * f64::from(MILLIHENRY);
            motor.coulomb = 4e-3;
        }
        bench.arm();
        bench.command(frequency, 0.0);
        bench.run(0.5);
        for microseconds in 1..10 {
            bench.aside = inverted * 1e-6 * f64::from(microseconds);
            bench.run(0.3);
            let faults = bench.control.report().faults;
            assert_eq!(faults, Faults::NONE, "{frequency} Hz, {inverted} x {microseconds} us");
        }
    }
}

#[test]
fn survives_an_offset_of_the_current_sense() {
    let mut bench = running(FREE, 30.0, 30.0);
    bench.sense_offset = 60;
    bench.run(0.2);
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.05 && held.direction < 0.5, "{held:?}");
}

#[test]
fn survives_a_sag_of_the_battery() {
    let mut bench = running(FREE, 30.0, 30.0);
    bench.bus = 9.6;
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.05 && held.direction < 0.5, "{held:?}");
}
