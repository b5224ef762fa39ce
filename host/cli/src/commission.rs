//! `flix commission`: lets a robot find the values of its motors.

use std::fmt::Write;
use std::process::ExitCode;

use flix_protocol::message::{Command, ParameterCommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::address::RobotArgs;
use super::drive::{give_up, stop};
use flix_host::commission::voltage_mode::{self, Latency, bridges, find_latency};
use flix_host::commission::{CommissionError, Commissioned, Known, Motor, Step, commission};
use flix_host::link::{LinkError, RobotLink};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::fixed;
use flix_shell::number::within;
use flix_shell::outlet::drawn;
use flix_shell::output::{headings, print, print_json, table};
use flix_shell::{Error, Exit};

/// Measure the robot's motors, encoders and current amplifiers, and set what follows.
///
/// Nothing of a motor is assumed: a voltage grows from nothing until a current flows, at most 1.5 A as the amplifiers show it. Then
/// the rotors turn, first slowly, at last at up to 26 Hz: put the robot on its feet or a stand, with room around its
/// rotors. It takes a minute and a half. What is wired, mounted or made wrongly is named, and the settings stay as they were. Both
/// motors must be of one kind. Ctrl-C stops the robot.
///
/// On a board that measures no phase currents the motors are measured by hand and entered with `flix parameters set`: pole_pairs,
/// phase_resistance and phase_inductance (of one phase: half of what is measured between two wires), flux_linkage. It then finds
/// how late the encoders are, and says what that rests on.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix commission walker-3f2c --save
  flix commission walker-3f2c --battery 12.31 --inertia 105
  flix commission walker-3f2c --json | jq .motors")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Battery voltage by a voltmeter, the robot at rest, 5 to 30 V: it corrects the divider, or stands for the battery
    /// where there is none.
    #[arg(long, value_name = "V", value_parser = within(5.0..=30.0, "voltage", " V"))]
    battery: Option<f64>,
    /// Inertia of one rotor about its shaft, mass and bell, 1 to 10000 g cm2 [default: the setting rotor_inertia].
    #[arg(long, value_name = "G_CM2", value_parser = within(1.0..=10_000.0, "inertia", " g cm2"))]
    inertia: Option<f64>,
    /// Store the settings; otherwise they are in force until power-off.
    #[arg(long)]
    save: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    found: Found,
    saved: bool,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Found {
    Measured(Commissioned),
    InVoltageMode(Latency),
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let bar = drawn(ProgressBar::new(Step::ALL.len() as u64));
    let style = ProgressStyle::with_template("{bar:40} {pos} of {len}: {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let known = Known { rotor_inertia: args.inertia.map(|it| 1e-7 * it), battery: args.battery };
    let show = |steps: &[Step], step: Step| {
        bar.set_length(steps.len() as u64);
        bar.set_position(steps.iter().position(|it| *it == step).unwrap_or(0) as u64);
        bar.set_message(step.to_string());
    };
    let found = match bridges(&mut connection) {
        Ok(bridges) if bridges.measures_current => {
            commission(&mut connection, &known, |step| show(&Step::ALL, step)).map(Found::Measured)
        }
        Ok(_) => find_latency(&mut connection, &known, |step| show(&voltage_mode::STEPS, step))
            .map(Found::InVoltageMode),
        Err(error) => Err(error),
    };
    bar.finish_and_clear();
    let found = match found {
        Ok(found) => found,
        Err(CommissionError::Robot(LinkError::Interrupted)) => {
            let error = stop(&mut connection);
            return Err(Error {
                sentence: format!("{error}; restart the robot: some of its settings were on trial"),
                ..error
            });
        }
        Err(error) => return Err(give_up(&mut connection, sentence(error))),
    };
    if args.save {
        connection.ask(Command::Parameter(ParameterCommand::Save))?;
    }
    connection.leave();
    if args.json {
        print_json(&Report { found, saved: args.save })?;
    } else {
        print(&describe(&found, args.save))?;
    }
    Ok(Exit::Done.into())
}

fn sentence(error: CommissionError<LinkError>) -> Error {
    match error {
        CommissionError::Assumed { name } => Error::new(
            Exit::NotNow,
            format!(
                "the board measures no phase currents, so that nothing but the values of the motors bounds them, and {name} is \
                 assumed: measure the motors by hand and enter them with `flix parameters set`: pole_pairs, phase_resistance and \
                 phase_inductance (of one phase: half of what is measured between two wires), flux_linkage"
            ),
        ),
        CommissionError::Robot(error) => error.into(),
        lapsed @ CommissionError::Lapsed { .. } => Error::new(Exit::NoAnswer, lapsed),
        limited @ CommissionError::Limited { .. } => Error::new(Exit::NotNow, limited),
        other => Error::new(Exit::RobotFault, other),
    }
}

fn describe(found: &Found, saved: bool) -> String {
    let (mut text, changes) = match found {
        Found::Measured(found) => (measured(found), &found.changes),
        Found::InVoltageMode(found) => (in_voltage_mode(found), &found.changes),
    };
    let mut rows = vec![headings("setting|before|now")];
    let value = |value: &f32| value.to_string();
    rows.extend(
        changes.iter().map(|(name, before, now)| vec![name.clone(), value(before), value(now)]),
    );
    let _ = write!(text, "\n{}", table(&rows));
    text += if saved {
        "\nStored.\n"
    } else {
        "\nIn force until power-off; `flix parameters save` stores them.\n"
    };
    text
}

fn in_voltage_mode(found: &Latency) -> String {
    format!(
        "Encoders {:.0} us late. This rests on values that were entered: {}.\n",
        1e6 * found.encoder_latency,
        found.rests_on.join(", ")
    )
}

fn measured(found: &Commissioned) -> String {
    let line = |name: &str, unit: &str, of: &dyn Fn(&Motor) -> String| {
        let [top, bottom] = found.motors.each_ref().map(of);
        vec![name.to_owned(), top, bottom, unit.to_owned()]
    };
    let rows = [
        headings("measured|top|bottom|unit"),
        line("phase resistance", "ohm", &|it| fixed(it.resistance, 3)),
        line("phase inductance", "mH", &|it| fixed(1e3 * it.inductance, 4)),
        line("flux linkage", "mWb", &|it| fixed(1e3 * it.flux_linkage, 3)),
        line("true over shown current, A", "1", &|it| fixed(it.current_gains[0], 3)),
        line("true over shown current, B", "1", &|it| fixed(it.current_gains[1], 3)),
        line("dead time takes", "mV", &|it| fixed(1e3 * it.dead_voltage, 0)),
    ];
    let mut text = table(&rows);
    let _ = writeln!(
        text,
        "{} pole pairs; encoders {:.0} us late; duties act {:.0} us after the samples",
        found.pole_pairs,
        1e6 * found.encoder_latency,
        1e6 * found.actuation_delay
    );
    text
}
