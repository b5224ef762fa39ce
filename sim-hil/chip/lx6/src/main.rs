#![forbid(unsafe_code)]
//! Runs a program on an emulated LX6: `flix-lx6 PROGRAM`. With `--beside -`, compares it with another emulator's log.

use std::io::{BufWriter, Read, Write, stdin, stdout};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use flix_lx6::beside::{Compared, Difference, compare};
use flix_lx6::memory::{Memory, ProgramError};
use flix_lx6::processor::{Clock, Core, REGISTERS};
use flix_lx6::simulator::{Simulator, Stop};

/// Run a program for Xtensa on an emulated LX6, with the calls of its makers' simulator; the exit code is the program's.
#[derive(Parser)]
#[command(name = "flix-lx6", version)]
struct Cli {
    /// The program (ELF).
    program: PathBuf,
    /// What the counter CCOUNT counts.
    #[arg(long, value_enum, default_value = "cycles")]
    count: Count,
    /// How fast it counts: 10.24 counts for each is what programs expect that were built for QEMU's cores with -icount shift=10.
    #[arg(long, default_value_t = 1.0)]
    counts_per: f64,
    /// Physical registers.
    #[arg(long, default_value_t = REGISTERS, value_parser = registers)]
    registers: usize,
    /// Compare so many instructions with the log on the standard input, of `qemu-system-xtensa -singlestep -d cpu,nochain`.
    #[arg(long, value_name = "INSTRUCTIONS")]
    beside: Option<u64>,
    /// The log holds instructions at these addresses alone, as QEMU's -dfilter names them: 0x1000..0x1fff,0x3000..0x3fff.
    #[arg(long, value_delimiter = ',', value_parser = addresses, requires = "beside")]
    within: Vec<RangeInclusive<u32>>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Count {
    Cycles,
    Instructions,
}

/// Denominator of counts for each cycle.
const EACH: u64 = 100;

fn addresses(text: &str) -> Result<RangeInclusive<u32>, String> {
    let number = |text: &str| u32::from_str_radix(text.strip_prefix("0x")?, 16).ok();
    let range =
        text.split_once("..").and_then(|(first, last)| Some(number(first)?..=number(last)?));
    range.ok_or_else(|| format!("{text:?} is no range of addresses: write 0x1000..0x1fff"))
}

fn registers(text: &str) -> Result<usize, String> {
    match text {
        "32" => Ok(32),
        "64" => Ok(64),
        _ => Err("a core with windows has 32 or 64 registers".into()),
    }
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error("{stop} ({place})")]
    Stop { stop: Stop, place: String },
    #[error(transparent)]
    Difference(#[from] Difference),
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(100)
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, Error> {
    std::fs::read(path).map_err(|source| Error::File { path: path.to_path_buf(), source })
}

fn run(cli: &Cli) -> Result<u8, Error> {
    let memory = Memory::load(&read(&cli.program)?)?;
    let clock = Clock {
        of_instructions: matches!(cli.count, Count::Instructions),
        counts: (cli.counts_per * EACH as f64).round() as u64,
        each: EACH,
    };
    let core = Core::new(memory.entry, cli.registers, clock);
    let folder = PathBuf::from(".");
    if let Some(most) = cli.beside {
        let mut simulator = Simulator::new(core, memory, folder, std::io::sink());
        let mut input = stdin().lock();
        let compared = compare(&mut simulator, &mut input, most, &cli.within)?;
        print(&compared);
        // Until the other emulator ends: it would end by a broken pipe.
        let _ = input.read(&mut []);
        return Ok(0);
    }
    let mut simulator = Simulator::new(core, memory, folder, BufWriter::new(stdout().lock()));
    let code = simulator
        .run()
        .map_err(|stop| Error::Stop { stop, place: simulator.memory.place(simulator.core.pc) })?;
    let Core { instructions, cycles, windows, .. } = simulator.core;
    eprintln!("{instructions} instructions, {cycles} cycles, {windows} windows saved and fetched");
    Ok(code.min(99) as u8)
}

fn print(Compared { instructions, compared, windows, operations }: &Compared) {
    let mut output = stdout().lock();
    // Whoever reads it may have seen enough.
    let _ = writeln!(
        output,
        "{instructions} instructions, registers alike after each of {compared}; {windows} windows saved and fetched"
    );
    for (operation, count) in operations {
        let _ = writeln!(output, "{operation:?} {count}");
    }
}
