#![no_std]
#![no_main]
#![cfg_attr(target_arch = "xtensa", feature(asm_experimental_arch))]
//! The fast half on an emulated processor, RV32IMAC or Xtensa: replays a recorded trace
//! ([`flix_firmware::trace`]) from the file `trace.bin` in QEMU's working directory, compares every
//! outcome bit for bit, and counts instructions.
//!
//! With QEMU's `-icount` the count is exact and the same in every run. Beside
//! it, as a peer, the crate `foc` does its two updates on the same currents and angles: current
//! loops and modulation alone, without what the tick does besides. Before, it counts what a datagram takes.

mod datagrams;
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
#[cfg_attr(target_arch = "xtensa", path = "xtensa.rs")]
mod machine;

use fixed::types::I16F16;
use flix_firmware::fast::configuration::Configuration;
use flix_firmware::fast::control::Control;
use flix_firmware::hardware::{Encoder, Hardware, Sensors};
use flix_firmware::scope::Scope;
use flix_firmware::settings::Settings;
use flix_firmware::trace::{self, Malformed, Outcome, Row};
use flix_protocol::message::{SCOPE_VALUES, State};
use foc::Foc;
use foc::pid::PIController;
use foc::pwm::SpaceVector;

use machine::{File, Stopwatch, entry, exit, println};

/// Counts above this are put together: the table is about a tick of at most 3,000.
const LARGEST_COUNT: usize = 16_384;

/// How often a tick took how many instructions.
struct Counts {
    histogram: [u32; LARGEST_COUNT],
    ticks: u32,
}

impl Counts {
    const fn new() -> Self {
        Self { histogram: [0; LARGEST_COUNT], ticks: 0 }
    }

    fn add(&mut self, instructions: u32) {
        let slot = (instructions as usize).min(LARGEST_COUNT - 1);
        self.histogram[slot] += 1;
        self.ticks += 1;
    }

    /// Instructions that this share of the ticks, in thousandths, did not exceed.
    fn quantile(&self, thousandths: u64) -> usize {
        let wanted = (u64::from(self.ticks) * thousandths).div_ceil(1000).max(1);
        let mut seen = 0;
        for (instructions, &ticks) in self.histogram.iter().enumerate() {
            seen += u64::from(ticks);
            if seen >= wanted {
                return instructions;
            }
        }
        LARGEST_COUNT
    }

    fn print(&self, name: &str) {
        println!(
            "{name} median {} p99 {} worst {} ticks {}",
            self.quantile(500),
            self.quantile(990),
            self.quantile(1000),
            self.ticks
        );
    }
}

/// Instructions that counting itself takes.
fn overhead() -> u32 {
    Stopwatch::start().instructions()
}

/// The peer's two motors.
struct Peer {
    motors: [Foc<SpaceVector, 3200>; 2],
    angles: [I16F16; 2],
}

impl Peer {
    fn new() -> Self {
        let controller = || PIController::new(I16F16::lit("1.5"), I16F16::lit("0.5"));
        Self {
            motors: [0, 1].map(|_| Foc::new(controller(), controller())),
            angles: [I16F16::ZERO; 2],
        }
    }

    /// Prepares what the peer takes, in its units, outside of what is counted.
    fn inputs(&mut self, sensors: &Sensors) -> [[I16F16; 2]; 2] {
        for (angle, encoder) in self.angles.iter_mut().zip(sensors.encoders) {
            if let Encoder::Reading(reading) = encoder {
                // Seven pole pairs; an angle of the circle in radians, from -pi to pi.
                let electrical = reading.angle.raw().wrapping_mul(7) as i32;
                *angle = I16F16::from_bits(electrical >> 15) * I16F16::PI;
            }
        }
        let counts = sensors.phase_current.unwrap_or([[2048; 2]; 2]);
        counts.map(|phases| phases.map(|count| I16F16::from_bits((i32::from(count) - 2048) * 106)))
    }

    #[inline(never)]
    fn tick(&mut self, currents: [[I16F16; 2]; 2]) -> [[u16; 3]; 2] {
        let [top, bottom] = &mut self.motors;
        let torque = I16F16::lit("0.5");
        let interval = I16F16::lit("0.0001");
        [
            top.update(currents[0], self.angles[0], torque, interval),
            bottom.update(currents[1], self.angles[1], torque, interval),
        ]
    }
}

/// Does a tick, and keeps eight channels of it for the scope, as the chips do: one function, not spread into the replay.
#[inline(never)]
fn tick(control: &mut Control, scope: &mut Scope, row: &Row) -> flix_firmware::hardware::Actuation {
    let actuation = control.tick(row.now, &row.sensors, &row.asked);
    let sample = control.sample(&scope.plan().channels, scope.revision());
    scope.record(&sample);
    actuation
}

/// What is counted.
struct Counted {
    /// Our tick.
    all: Counts,
    /// Of these, those in which the rotors are held in motion.
    running: Counts,
    /// The peer's two updates.
    peer: Counts,
}

fn replay(counted: &mut Counted) -> Result<u32, Malformed> {
    let mut file = File::open(c"trace.bin").ok_or(Malformed)?;
    let hardware = trace::decode::<Hardware, _>(|room| file.read_exact(room))?.ok_or(Malformed)?;
    let mut control = Control::new(Configuration::new(&Settings::DEFAULT, &hardware));
    let mut peer = Peer::new();
    let mut scope = Scope::new([0; SCOPE_VALUES]);
    let overhead = overhead();
    let mut differences = 0;
    while let Some(row) = trace::decode::<Row, _>(|room| file.read_exact(room))? {
        let stopwatch = Stopwatch::start();
        let actuation = core::hint::black_box(tick(&mut control, &mut scope, &row));
        let spent = stopwatch.instructions().wrapping_sub(overhead);
        counted.all.add(spent);
        if row.outcome.state == State::Running {
            counted.running.add(spent);
        }
        let outcome = Outcome::after(&control, actuation);
        if outcome != row.outcome {
            if differences == 0 {
                println!("first difference at {} us", row.now.as_micros());
                println!("  there {:?}", row.outcome);
                println!("  here  {outcome:?}");
            }
            differences += 1;
        }
        let currents = peer.inputs(&row.sensors);
        let stopwatch = Stopwatch::start();
        core::hint::black_box(peer.tick(core::hint::black_box(currents)));
        counted.peer.add(stopwatch.instructions().wrapping_sub(overhead));
    }
    Ok(differences)
}

/// Replays the trace; called by what starts the processor.
#[entry]
fn main() -> ! {
    static COUNTED: static_cell::ConstStaticCell<Counted> =
        static_cell::ConstStaticCell::new(Counted {
            all: Counts::new(),
            running: Counts::new(),
            peer: Counts::new(),
        });
    let counted = COUNTED.take();
    if datagrams::count().is_none() {
        println!("operator and robot got no session");
        exit(4)
    }
    match replay(counted) {
        Ok(differences) => {
            println!("differences {differences}");
            counted.all.print("tick");
            counted.running.print("running");
            counted.peer.print("foc");
            exit(0)
        }
        Err(Malformed) => {
            println!("trace.bin: {Malformed}");
            exit(2)
        }
    }
}

#[panic_handler]
fn on_panic(info: &core::panic::PanicInfo) -> ! {
    println!("panic: {info}");
    exit(3)
}
