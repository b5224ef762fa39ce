//! Records what the fast half of a simulated robot is shown and what it decides: power-up,
//! alignment, a second in each of the five walking modes (one step reverses the rotors), and a lost magnet at the end.
//!
//! `cargo run -p flix-sim --example record-trace -- FILE`

use flix_host::teleop::paper_modes::PaperMode;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::configuration::Configuration;
use flix_firmware::fast::control::Control;
use flix_firmware::fast::exchange::{Asked, Wanted};
use flix_firmware::hardware::{Encoder, Hardware, TICK_RATE_HZ, TICK_US};
use flix_firmware::settings::Settings;
use flix_firmware::trace::{LONGEST, Outcome, Row, encode};
use flix_protocol::failsafe::COMMAND_AGE;
use flix_protocol::message::State;
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::plant::electronics::{Electronics, ElectronicsParameters};
use flix_sim::rig::bench::setpoint;

/// A board as it is sold: it measures currents but not its bus, which takes the most instructions.
const BOARD: Hardware = DENGFOC_V3_01.hardware;
/// Ticks of each mode: a second.
const MODE_TICKS: u64 = TICK_RATE_HZ as u64;
/// Ticks with a lost magnet at the end.
const FAULT_TICKS: u64 = TICK_RATE_HZ as u64 / 5;
/// Ticks within which alignment must be done.
const PATIENCE_TICKS: u64 = 20 * TICK_RATE_HZ as u64;
/// Ticks of rest before arming.
const REST_TICKS: u64 = TICK_RATE_HZ as u64 / 5;
/// Chance of sensors and mounting.
const SEED: u64 = 7;

/// Records a trace of the fast half.
#[derive(Parser)]
struct Arguments {
    /// The file to write.
    file: PathBuf,
}

/// The fast half on a plant, with its recorder.
struct Recording<W> {
    control: Control,
    asked: Asked,
    electronics: Electronics,
    plant: Plant,
    tick: u64,
    magnet_lost: bool,
    trace: W,
}

impl<W: Write> Recording<W> {
    fn tick(&mut self) -> Result<(), Box<dyn std::error::Error>> {
        let now = Instant::from_micros(self.tick * u64::from(TICK_US));
        let mut sensors = self.electronics.sense(&self.plant);
        if self.magnet_lost {
            sensors.encoders[0] = Encoder::Failed;
        }
        // The operator never falls silent.
        self.asked.hear(now, now + COMMAND_AGE);
        let actuation = self.control.tick(now, &sensors, &self.asked);
        let outcome = Outcome::after(&self.control, actuation);
        let row = Row { now, sensors, asked: self.asked, outcome };
        self.trace.write_all(encode(&row, &mut [0; LONGEST])?)?;
        self.electronics.advance(&actuation, &mut self.plant)?;
        self.tick += 1;
        Ok(())
    }

    /// Gives an order with the present permit.
    fn want(&mut self, wanted: Wanted) {
        self.asked.begins = true;
        self.asked.want(wanted, self.control.report().permit);
    }

    fn ticks(&mut self, count: u64) -> Result<(), Box<dyn std::error::Error>> {
        (0..count).try_for_each(|_| self.tick())
    }

    fn until(&mut self, state: State) -> Result<(), Box<dyn std::error::Error>> {
        let end = self.tick + PATIENCE_TICKS;
        while self.control.report().state != state && self.tick < end {
            self.tick()?;
        }
        self.expect(state)
    }

    /// A walk that ended early would be a trace of rest.
    fn expect(&self, state: State) -> Result<(), Box<dyn std::error::Error>> {
        let report = self.control.report();
        if report.state == state {
            return Ok(());
        }
        let fault = report.first_fault;
        Err(format!("the robot is {} instead of {state}, {fault:?}", report.state).into())
    }
}

fn record(file: &Path) -> Result<u64, Box<dyn std::error::Error>> {
    let mut trace = BufWriter::new(File::create(file)?);
    trace.write_all(encode(&BOARD, &mut [0; LONGEST])?)?;
    let mut recording = Recording {
        control: Control::new(Configuration::new(&Settings::DEFAULT, &BOARD)),
        asked: Asked::default(),
        electronics: Electronics::new(&ElectronicsParameters::on(BOARD), SEED),
        plant: Plant::new(&RobotModel::named("W")?)?,
        tick: 0,
        magnet_lost: false,
        trace,
    };
    recording.ticks(REST_TICKS)?;
    recording.want(Wanted::Arm);
    recording.until(State::Armed)?;
    for (frequency, direction) in PaperMode::ALL.map(PaperMode::pair) {
        let setpoint = setpoint(frequency, direction)?;
        recording.asked.set(&setpoint);
        recording.want(Wanted::Shake);
        recording.ticks(MODE_TICKS)?;
        recording.expect(State::Running)?;
    }
    recording.magnet_lost = true;
    recording.until(State::Faulted)?;
    recording.ticks(FAULT_TICKS)?;
    recording.trace.flush()?;
    Ok(recording.tick)
}

fn main() -> ExitCode {
    let Arguments { file } = Arguments::parse();
    match record(&file) {
        Ok(ticks) => {
            println!("{}: {ticks} ticks", file.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {}: {error}", file.display());
            ExitCode::FAILURE
        }
    }
}
