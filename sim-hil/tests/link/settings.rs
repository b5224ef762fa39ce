//! Settings over the link, and what becomes of damaged ones.

use std::time::Duration;

use flix_firmware::settings::{MOTOR_VALUES, Settings};
use flix_protocol::message::{
    Command, Event, Fault, Name, Order, Outcome, ParameterCommand, Refusal, State, Withheld,
};
use flix_sim::rig::simulated::Flash;

use super::bench::Bench;

fn name(name: &str) -> Name {
    Name::try_from(name).unwrap()
}

fn set(setting: &str, value: f32) -> Command {
    Command::Parameter(ParameterCommand::Set(name(setting), value))
}

fn value(bench: &mut Bench, setting: &str) -> f32 {
    match bench.say(Command::Parameter(ParameterCommand::Get(name(setting)))) {
        Outcome::Parameter(parameter) => parameter.value,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_setting_is_tried_until_power_off_and_kept_when_saved() {
    let mut bench = Bench::connected();
    bench.say(set("over_speed", 60.0));
    let tried = value(&mut bench, "over_speed");
    bench.restart();
    let forgotten = value(&mut bench, "over_speed");
    bench.say(set("over_speed", 60.0));
    // Rotors that may still turn brake first.
    let save = Command::Parameter(ParameterCommand::Save);
    let stopping = Outcome::Refused(Refusal::State(State::Stopping));
    assert_eq!(bench.say(save.clone()), stopping);
    bench.wait(Duration::from_millis(20));
    assert_eq!(bench.say(save), Outcome::Done);
    bench.restart();
    let kept = value(&mut bench, "over_speed");
    assert_eq!([tried, forgotten, kept], [60.0, Settings::DEFAULT.over_speed, 60.0]);
}

#[test]
fn settings_do_not_change_while_the_motors_are_driven() {
    let mut bench = Bench::armed();
    let before = value(&mut bench, "over_speed");
    let outcome = bench.say(set("over_speed", 60.0));
    assert_eq!(outcome, Outcome::Refused(Refusal::State(State::Armed)));
    assert_eq!(value(&mut bench, "over_speed"), before);
}

#[test]
fn a_changed_setting_is_obeyed_by_the_fast_loop() {
    let mut bench = Bench::connected();
    bench.wait(Duration::from_millis(20));
    bench.say(set("over_speed", 15.0));
    bench.arm();
    bench.hold(bench.walk(20.0, 0.0), Duration::from_millis(600));
    assert_eq!(bench.robot.report().first_fault, Some(Fault::OverSpeed));
}

#[test]
fn an_alignment_is_kept_over_power_off() {
    let mut bench = Bench::armed();
    bench.hold(Order::Off, Duration::from_millis(200));
    bench.restart();
    let aligned = [value(&mut bench, "top_aligned"), value(&mut bench, "bottom_aligned")];
    assert_eq!(aligned, [1.0, 1.0]);
}

/// A robot whose flash holds what it should not.
#[test]
fn damaged_settings_are_defaults_that_arm_only_once_cleared_and_known() {
    let flash = Flash::default();
    flash.overwrite(Some(vec![0x5a; 100]));
    let mut bench = Bench::with_flash(flash);
    bench.connect();
    bench.hold(Order::Off, Duration::from_millis(1_000));
    assert!(bench.events().contains(&Event::SettingsDefaulted));
    assert_eq!(value(&mut bench, "over_speed"), Settings::DEFAULT.over_speed);
    let shown = bench.see(Order::Arm(bench.permit()));
    assert_eq!(shown.state, State::Faulted);
    assert!(shown.faults.contains(Fault::Settings), "{shown:?}");
    assert!(bench.see(Order::Clear(bench.permit())).faults.is_empty());
    bench.hold(Order::Off, Duration::from_millis(1_000));
    let shown = bench.see(Order::Arm(bench.permit()));
    assert_eq!((shown.withheld, shown.state), (Some(Withheld::Settings), State::Disarmed));
    let refused = bench.say(Command::Parameter(ParameterCommand::Check));
    assert!(matches!(refused, Outcome::Refused(Refusal::Assumed { .. })), "{refused:?}");
    // An operator who enters values is no longer asking to arm.
    bench.see(Order::Off);
    for setting in MOTOR_VALUES {
        let known = value(&mut bench, setting);
        let entered = bench.say(set(setting, known));
        assert!(matches!(entered, Outcome::Parameter(_)), "{entered:?}");
    }
    bench.arm();
}

#[test]
fn settings_too_long_for_this_firmware_are_damage_too() {
    let flash = Flash::default();
    flash.overwrite(Some(vec![0; 10_000]));
    let bench = Bench::with_flash(flash);
    assert_eq!(bench.robot.software().slow.settings(), &Settings::DEFAULT);
}
