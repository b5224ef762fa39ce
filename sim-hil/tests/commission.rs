//! A robot whose motors nobody knows finds their values, harms none of them, and is left as it was when it cannot.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::Duration;

use flix_firmware::hardware::Sensors;
use flix_firmware::settings::{MOTOR_VALUES, Settings};
use flix_host::commission::voltage_mode::find_latency;
use flix_host::commission::{CommissionError, Finding, Known, Step, commission};
use flix_host::link::{Client, LinkError, RobotLink, Wish};
use flix_protocol::message::{
    Command, Fault, Halt, Mark, Outcome, ParameterCommand, Setpoint, State, Telemetry,
};
use flix_protocol::units::Instant;
use flix_sim::model::Electrical;
use flix_sim::reliability::commission::{CURRENT_LIMIT_A, motors, voltage_mode, wiring_faults};
use flix_sim::reliability::unknown_motors::{Watched, motor_values, rotor_inertia, unknown_motors};
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};
use flix_sim::rig::operation::OperationError;
use flix_sim::rig::simulated::Disturbance;
use flix_sim::study::compute;

#[test]
fn a_robot_of_unknown_motors_finds_its_own_values_and_names_what_is_wired_wrongly() {
    for (rows, study) in
        [(1, motors(&[1], 0.01)), (1, voltage_mode(&[1], 0.01)), (25, wiring_faults(&[1]))]
    {
        let table = compute(&study);
        assert!(table.pass() && table.rows.len() == rows, "{table:?}");
    }
}

/// The encoders are on each other's motors.
struct Swapped;

impl Disturbance for Swapped {
    fn sensors(&mut self, _now: Instant, sensors: &mut Sensors) {
        sensors.encoders.swap(0, 1);
    }
}

#[test]
fn a_commissioned_robot_knows_its_motors() {
    let mut robot = Watched::power_up(unknown_motors(3), 3).unwrap();
    assert_eq!(robot.settings().marks, Settings::DEFAULT.marks);
    commission(&mut robot, &Known::default(), |_| {}).unwrap();
    for name in MOTOR_VALUES {
        assert_eq!(robot.settings().marked(name), Some(Mark::Measured), "{name}");
    }
}

#[test]
fn swapped_encoders_are_named_and_the_settings_stay_as_they_were() {
    let mut robot = Watched::power_up(unknown_motors(2), 2).unwrap();
    robot.operation.robot.disturb(Swapped);
    let before = robot.settings();
    let found = commission(&mut robot, &Known::default(), |_| {});
    let Err(CommissionError::Found(finding)) = found else { panic!("{found:?}") };
    assert_eq!(finding, Finding::EncodersSwapped(0));
    assert_eq!(robot.settings(), before);
}

/// Returns a robot without current sense whose motors were entered as they are, but for pole pairs times this.
fn entered(seed: u64, times: f64) -> Watched {
    let mut model = unknown_motors(seed);
    model.electrical.sense.current = false;
    let (inertia, pairs) = (rotor_inertia(&model.shaker), model.electrical.motor.pole_pairs);
    let mut robot = Watched::power_up(model, seed).unwrap();
    let mut values: BTreeMap<_, _> = motor_values(&robot).collect();
    values.insert("pole_pairs".to_owned(), times * f64::from(pairs));
    values.insert("rotor_inertia".to_owned(), 1e7 * inertia);
    robot.enter(values).unwrap();
    robot
}

/// Its angle is that of the alignment: the current that speeds it up would seem larger, and its resistance with it.
#[test]
fn a_magnet_that_slips_while_it_is_measured_is_named() {
    let model = unknown_motors(9_201);
    for (motor, slip, after) in [(1, -3.0, 46), (0, -2.0, 58), (1, 2.0, 61), (0, 1.0, 66)] {
        let mut robot = Watched::power_up(model.clone(), 9_201).unwrap();
        let from = robot.operation.now() + Duration::from_secs(after);
        let until = from + Duration::from_secs(300);
        let slips = HardwareFault::EncoderJumps(motor, 1, slip);
        robot.operation.robot.disturb(Injected::new(slips, from, until, 1));
        let known = Known { rotor_inertia: Some(rotor_inertia(&model.shaker)), battery: None };
        let found = commission(&mut robot, &known, |_| {});
        let Err(CommissionError::Found(Finding::MagnetSlips { motor: named, degrees })) = found
        else {
            panic!("{slip} after {after} s: {found:?}");
        };
        assert!(named == motor && (degrees + slip).abs() < 0.1, "{named}: {degrees} for {slip}");
    }
}

#[test]
fn a_robot_without_current_sense_knows_how_late_its_encoders_are_and_what_that_rests_on() {
    let mut robot = entered(4, 1.0);
    let before = robot.settings();
    let found = find_latency(&mut robot, &Known::default(), |_| {}).unwrap();
    let late = unknown_motors(4).electrical.encoder.late_us;
    assert!((1e6 * found.encoder_latency - late).abs() < 30.0, "{found:?} of {late} us");
    assert_eq!(found.rests_on.len(), 7);
    let after = robot.settings();
    assert!((f64::from(after.encoder_latency) - 1e6 * found.encoder_latency).abs() < 0.1);
    // Neither the turned angle nor what bounded the runs stays.
    let kept = |settings: &Settings| {
        let Settings { frequency_ramp, current_limit, alignment_current, .. } = *settings;
        (frequency_ramp, current_limit, alignment_current, settings.flux_linkage)
    };
    assert_eq!(kept(&after), kept(&before));
    assert_eq!(after.aligned, [1.0; 2]);
    assert!(!found.changes.iter().any(|(name, ..)| name.ends_with("electrical_offset")));
}

#[test]
fn a_robot_whose_encoders_were_found_late_can_be_armed_with_what_that_left() {
    let mut robot = entered(52_001, 1.0);
    let found = find_latency(&mut robot, &Known::default(), |_| {}).unwrap();
    assert!(found.encoder_latency > 2e-3, "{found:?}");
    let bandwidth = robot.settings().position_bandwidth;
    assert!(bandwidth < Settings::DEFAULT.position_bandwidth, "{bandwidth} Hz");
    robot.operation.arm().unwrap();
}

/// Returns a robot of this kind without current sense, and its settings as they are but for R, L and flux linkage times these.
fn of_corner(seed: u64, change: impl FnOnce(&mut Electrical), times: [f64; 3]) -> Watched {
    let mut model = unknown_motors(seed);
    change(&mut model.electrical);
    model.electrical.sense.current = false;
    let inertia = rotor_inertia(&model.shaker);
    let pairs = model.electrical.motor.pole_pairs;
    let mut robot = Watched::power_up(model, seed).unwrap();
    let mut values: BTreeMap<_, _> = motor_values(&robot).collect();
    for (name, value) in &mut values {
        let kinds = ["resistance", "inductance", "linkage"];
        let kind = kinds.iter().position(|kind| name.ends_with(kind)).unwrap();
        *value *= times[kind];
    }
    values.insert("pole_pairs".to_owned(), pairs.into());
    values.insert("rotor_inertia".to_owned(), 1e7 * inertia);
    robot.enter(values).unwrap();
    robot
}

#[test]
fn weak_windings_without_current_sense_carry_no_more_than_2_a_whatever_is_unknown() {
    for (pairs, late_us, times) in
        [(14, 0.0, [0.95, 1.05, 1.05]), (4, 0.0, [0.95, 0.95, 1.05]), (14, 2_500.0, [1.0; 3])]
    {
        let weak = |electrical: &mut Electrical| {
            let motor = &mut electrical.motor;
            motor.phase_resistance_ohm = 0.1;
            motor.phase_inductance_mh = 0.08;
            motor.flux_linkage_mwb = 0.9;
            (motor.pole_pairs, motor.cogging_periods) = (pairs, 12 * pairs);
            motor.cogging_torque_mn_m /= 1.5;
            motor.coulomb_friction_mn_m /= 1.5;
            electrical.encoder.late_us = late_us;
            // Nobody knows what the bus takes back, nor how full the battery is.
            electrical.sense.bus_uv_per_count = 0;
            (electrical.pack.charge_at_least, electrical.pack.charge_at_most) = (1.0, 1.0);
        };
        let mut robot = of_corner(1, weak, times);
        for battery in [None, Some(robot.operation.robot.truth().bus_voltage)] {
            let found =
                find_latency(&mut robot, &Known { rotor_inertia: None, battery }, |_| {}).unwrap();
            assert!((1e6 * found.encoder_latency - late_us).abs() < 100.0, "{found:?}");
            let mut changed = found.changes.iter().map(|(name, ..)| name.as_str());
            let known = ["nominal_voltage", "position_bandwidth", "encoder_latency"];
            assert!(changed.all(|name| known.contains(&name)), "{found:?}");
            let largest = robot.largest_current.get();
            assert!(largest <= CURRENT_LIMIT_A, "{pairs} pairs: {largest} A");
        }
    }
}

/// Sets these, each after the other.
fn set(robot: &mut Watched, settings: &[(&str, f32)]) {
    for (name, value) in settings {
        let put = ParameterCommand::Set((*name).try_into().unwrap(), *value);
        let outcome = robot.operation.request(Command::Parameter(put)).unwrap();
        assert!(matches!(outcome, Outcome::Parameter(_)), "{name}: {outcome:?}");
    }
}

#[test]
fn an_owner_who_allows_less_current_than_commissioning_takes_is_asked_first() {
    for senses in [false, true] {
        let mut robot =
            if senses { Watched::power_up(unknown_motors(3), 3).unwrap() } else { entered(4, 1.0) };
        set(&mut robot, &[("alignment_current", 0.3), ("current_limit", 0.5)]);
        let before = robot.settings();
        let error = match senses {
            true => commission(&mut robot, &Known::default(), |_| {}).map(drop),
            false => find_latency(&mut robot, &Known::default(), |_| {}).map(drop),
        };
        assert!(
            matches!(error, Err(CommissionError::Limited { limit }) if limit == 0.5),
            "{error:?}"
        );
        assert_eq!(robot.settings(), before);
        assert_eq!(robot.largest_current.get(), 0.0);
    }
}

#[test]
fn settings_of_an_owner_that_fit_each_other_are_put_back_after_commissioning() {
    for senses in [false, true] {
        let mut robot =
            if senses { Watched::power_up(unknown_motors(3), 3).unwrap() } else { entered(4, 1.0) };
        // One has just enough current.
        let [limit, aligning] = if senses { [1.4, 1.0] } else { [1.6, 1.5] };
        let own = [("current_limit", limit), ("alignment_current", aligning), ("command_age", 0.6)];
        set(&mut robot, &own);
        let before = robot.settings();
        match senses {
            true => drop(commission(&mut robot, &Known::default(), |_| {}).unwrap()),
            false => drop(find_latency(&mut robot, &Known::default(), |_| {}).unwrap()),
        }
        let after = robot.settings();
        let kept = |it: &Settings| (it.current_limit, it.command_age, it.frequency_ramp);
        assert_eq!(kept(&after), kept(&before));
        // A robot that measures itself knows better what turns its rotors.
        assert!(senses || after.alignment_current == before.alignment_current);
    }
}

#[test]
fn a_delay_that_was_entered_is_named_as_what_a_latency_rests_on() {
    let mut robot = entered(4, 1.0);
    set(&mut robot, &[("actuation_delay", 125.0)]);
    let found = find_latency(&mut robot, &Known::default(), |_| {}).unwrap();
    assert!(found.rests_on.iter().any(|name| name == "actuation_delay"), "{found:?}");
}

#[test]
fn pole_pairs_entered_wrongly_end_a_search_for_latency_and_leave_the_settings_as_they_were() {
    let mut robot = entered(9004, 2.0);
    let before = robot.settings();
    let found = find_latency(&mut robot, &Known::default(), |_| {});
    let Err(CommissionError::Faulted { faults, .. }) = &found else { panic!("{found:?}") };
    assert!(faults.contains(Fault::Alignment), "{found:?}");
    let after = robot.settings();
    let kept = |settings: &Settings| {
        (settings.encoder_latency, settings.position_bandwidth, settings.tracker_bandwidth)
    };
    assert_eq!(kept(&after), kept(&before));
    assert_eq!(after.frequency_ramp, before.frequency_ramp);
    assert!(robot.largest_current.get() <= CURRENT_LIMIT_A);
}

/// A robot whose operator falls silent some time after a step has begun, or for a while in trials.
struct Leaving<'a> {
    robot: &'a mut Watched,
    leaves: &'a Cell<bool>,
    /// Commands that still go out.
    left: u32,
    /// Whether the next trial is one of these.
    is_lost: &'a mut dyn FnMut() -> bool,
    /// Walks in which he still falls silent.
    broken_walks: u32,
}

impl<'a> Leaving<'a> {
    fn of(
        robot: &'a mut Watched,
        leaves: &'a Cell<bool>,
        is_lost: &'a mut dyn FnMut() -> bool,
    ) -> Self {
        Self { robot, leaves, left: 1, is_lost, broken_walks: 0 }
    }

    fn goes_on(&mut self) -> Result<(), OperationError> {
        if self.leaves.get() {
            self.left = self.left.saturating_sub(1);
        }
        match self.left {
            0 => Err(LinkError::OtherAnswer.into()),
            _ => Ok(()),
        }
    }

    fn fall_silent(&mut self, time: Duration) -> Result<(), OperationError> {
        self.robot.operation.operators[0].is_gone = true;
        self.robot.pause(time)?;
        self.robot.operation.operators[0].is_gone = false;
        Ok(())
    }
}

impl RobotLink for Leaving<'_> {
    type Error = OperationError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        self.robot.operate()
    }

    fn wait(&mut self, longest: Duration) -> Result<(), OperationError> {
        self.robot.wait(longest)
    }

    fn insist(&mut self, command: Command) -> Result<Outcome, OperationError> {
        self.goes_on()?;
        self.robot.insist(command)
    }

    fn press(&mut self, wish: Wish) -> Result<(), OperationError> {
        self.goes_on()?;
        self.robot.press(wish)?;
        if matches!(wish, Wish::Try(_)) && (self.is_lost)() {
            let begins = |telemetry: &Telemetry| telemetry.state == State::Aligning;
            self.robot.wait_for_telemetry(Duration::from_secs(3), begins)?;
            self.fall_silent(Duration::from_millis(300))?;
        }
        Ok(())
    }

    fn pause(&mut self, duration: Duration) -> Result<(), OperationError> {
        self.goes_on()?;
        self.robot.pause(duration)?;
        let walks = self.robot.telemetry().is_some_and(|it| it.state == State::Running);
        if walks && self.broken_walks > 0 {
            self.broken_walks -= 1;
            self.fall_silent(Duration::from_millis(800))?;
        }
        Ok(())
    }

    fn arm(&mut self) -> Result<(), OperationError> {
        self.goes_on()?;
        self.robot.arm()
    }

    fn disarm(&mut self) -> Result<(), OperationError> {
        self.goes_on()?;
        self.robot.disarm()
    }

    fn hold(&mut self, setpoint: Setpoint) {
        self.robot.hold(setpoint);
    }
}

#[test]
fn an_operator_who_falls_silent_at_any_step_leaves_rotors_at_rest() {
    for last in Step::ALL {
        let mut robot = Watched::power_up(unknown_motors(3), 3).unwrap();
        let leaves = Cell::new(false);
        let mut hears_all = || false;
        let mut leaving = Leaving { left: 20, ..Leaving::of(&mut robot, &leaves, &mut hears_all) };
        let found = commission(&mut leaving, &Known::default(), |step| {
            leaves.set(leaves.get() || step == last);
        });
        assert!(found.is_err(), "{last}");
        robot.operation.operators[0].is_gone = true;
        robot.operation.run(Duration::from_secs(3), |_| {}).unwrap();
        let truth = robot.operation.robot.truth();
        assert!(truth.is_slower_than(0.1), "{last}: {:?}", truth.rotor_speed);
        assert!(truth.largest_current() < 0.01, "{last}");
        assert!(robot.largest_current.get() < CURRENT_LIMIT_A, "{last}");
    }
}

#[test]
fn what_broke_off_in_silence_is_done_again_and_never_taken_for_a_motor() {
    let lossy = |is_lost: &mut dyn FnMut() -> bool, broken_walks| {
        let mut robot = Watched::power_up(unknown_motors(3), 3).unwrap();
        let leaves = Cell::new(false);
        let mut lossy = Leaving { broken_walks, ..Leaving::of(&mut robot, &leaves, is_lost) };
        commission(&mut lossy, &Known::default(), |_| {})
    };
    let mut trials = 0;
    let mut every_third = || {
        trials += 1;
        trials % 3 == 1
    };
    lossy(&mut every_third, 2).unwrap();
    assert!(trials > 9);
    for (in_trials, broken_walks, step, halt) in
        [(true, 0, Step::Wiring, Halt::LetGo), (false, 99, Step::Slow, Halt::Rested)]
    {
        let ended = lossy(&mut || in_trials, broken_walks).unwrap_err();
        let CommissionError::Lapsed { step: of, halt: why } = ended else { panic!("{ended:?}") };
        assert_eq!((of, why), (step, halt));
    }
}

#[test]
fn motors_of_a_tenth_of_an_ohm_carry_no_more_than_2_a() {
    for seed in [7032, 7039, 13] {
        let robot = compute(&motors(&[seed], 0.01));
        assert!(robot.numbers("resistance_ohm")[0] < 0.12 && robot.pass(), "{robot:?}");
    }
}

#[test]
fn a_robot_whose_trial_runs_lose_the_lock_with_one_position_loop_is_found_with_the_other() {
    let robot = compute(&motors(&[7006], 0.01));
    assert!(robot.pass(), "{robot:?}");
}
