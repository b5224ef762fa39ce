//! `cargo xtask pil`, processor in the loop: the instructions of each tick and its bits. It runs the fast half on an emulated
//! processor, RV32IMAC or Xtensa, against a trace from the simulator.
//!
//! QEMU's Xtensa cores with register windows are not the ESP32's: their counts of instructions are theirs.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Serialize;

use crate::chip::Chip;
use crate::run::{self, Error};
use crate::stock::{self, Core};
use crate::toolchain;

/// Most instructions of half of all ticks, both motors: 12.5 % of the ESP32-C6 at 10 kHz.
const MEDIAN_CEILING: u32 = 2_000;
/// Most instructions of any tick: under 20 % of the ESP32-C6 at 10 kHz.
const WORST_CEILING: u32 = 3_000;

/// Clock of the ESP32-C6, instructions a second at best.
const CLOCK_HZ: f64 = 160e6;
/// Datagrams a second whose share of the chip is printed.
const FLOODS: [f64; 2] = [1_000.0, 10_000.0];

/// QEMU's core where none is named.
const FIRST_CORE: &str = "dc233c";
/// The simulator's example that records the trace.
const RECORDER: &str = "record-trace";

/// On which processor, and what is printed.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The chip: the ESP32-C6's processor, or, built by the stock compiler as an experiment, an Xtensa core near the ESP32's.
    #[arg(long, default_value = "esp32c6")]
    chip: Chip,
    /// QEMU's core that stands in for the ESP32's, dc233c where none is named.
    #[arg(long, value_parser = [FIRST_CORE, "de233_fpu"])]
    core: Option<String>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// A processor that QEMU emulates.
struct Processor {
    chip: Chip,
    title: String,
    program: &'static str,
    arguments: Vec<String>,
    /// Whether its instructions are those of the chip, so that the ceilings hold for them.
    is_the_chips: bool,
}

impl Processor {
    fn of(args: &Args) -> Result<Self, Error> {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect();
        let core = args.core.as_deref().unwrap_or(FIRST_CORE);
        if args.core.is_some() && args.chip != Chip::Esp32 {
            return Err(Error::Sentence(format!(
                "--core {core} stands in for the ESP32's: name --chip esp32, too"
            )));
        }
        match args.chip {
            Chip::Esp32c6 => Ok(Self {
                chip: args.chip,
                title: "RV32IMAC".into(),
                program: "qemu-system-riscv32",
                arguments: words(
                    "-M virt -bios none -nographic -icount shift=0 -semihosting-config enable=on,target=native -kernel",
                ),
                is_the_chips: true,
            }),
            // The image counts on the shift. Longer than an instruction takes, so that the clock runs in whole counts.
            Chip::Esp32 => Ok(Self {
                chip: args.chip,
                title: format!("Xtensa, QEMU's {core}"),
                program: "qemu-system-xtensa",
                arguments: words(&format!(
                    "-M sim -m 64 -cpu {core} -display none -serial none -monitor none -semihosting -icount shift=10,sleep=off -kernel"
                )),
                is_the_chips: false,
            }),
            Chip::Esp32s3 => Err(Error::Sentence(
                "no processor of QEMU's is near the ESP32-S3's: name esp32c6 or esp32".into(),
            )),
        }
    }

    /// Builds the image; returns its path.
    fn image(&self) -> Result<PathBuf, Error> {
        if self.chip == Chip::Esp32 {
            return stock::binary(self.chip, Core::Emulated, "pil", "pil");
        }
        let arguments = ["--package", "flix-firmware", "--bin", "pil", "--features", "pil"];
        run::run(toolchain::riscv("build")?.args(arguments))?;
        Ok(toolchain::riscv_binary("pil"))
    }

    /// Runs an image in this folder; returns what it printed.
    fn run(&self, image: &Path, folder: &Path) -> Result<String, Error> {
        let mut emulator = Command::new(self.program);
        emulator.args(&self.arguments).arg(image);
        run::output(emulator.current_dir(folder).stdin(Stdio::null()))
    }
}

/// What the image counted of one candidate, instructions a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct Counts {
    median: u32,
    p99: u32,
    worst: u32,
    ticks: u32,
}

/// Reads a line `NAME median N p99 N worst N ticks N` of the image's output.
fn counts(output: &str, name: &str) -> Option<Counts> {
    let line = output.lines().find_map(|line| line.strip_prefix(name))?;
    let mut numbers = line.split_whitespace().filter_map(|word| word.parse().ok());
    let [median, p99, worst, ticks] = [(); 4].map(|()| numbers.next());
    Some(Counts { median: median?, p99: p99?, worst: worst?, ticks: ticks? })
}

/// What a datagram of one kind takes, its answer included.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Datagram {
    kind: String,
    instructions: u32,
}

/// Reads the lines `datagram N NAME` of the image's output.
fn datagrams(output: &str) -> Vec<Datagram> {
    let read = |line: &str| {
        let (count, kind) = line.strip_prefix("datagram ")?.split_once(' ')?;
        Some(Datagram { kind: kind.into(), instructions: count.parse().ok()? })
    };
    output.lines().filter_map(read).collect()
}

/// What the image counted: the tick from power-up to the fault at the end, while running, and the peer's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct Ticks {
    all: Counts,
    running: Counts,
    foc: Counts,
}

/// What a replay found.
#[derive(Debug, PartialEq, Eq, Serialize)]
struct Replay {
    chip: &'static str,
    /// Whose instructions are counted.
    processor: String,
    ticks: u32,
    /// Ticks that decided otherwise than on this computer.
    differences: u32,
    instructions: Ticks,
    datagrams: Vec<Datagram>,
    #[serde(skip)]
    is_the_chips: bool,
}

impl Replay {
    /// Reads the image's output; an error where it did not finish.
    fn read(processor: &Processor, output: &str) -> Result<Self, Error> {
        let differences =
            output.lines().find_map(|line| line.strip_prefix("differences ")?.trim().parse().ok());
        let [all, running, foc] = ["tick", "running", "foc"].map(|name| counts(output, name));
        let Processor { chip, title, is_the_chips, .. } = processor;
        match (differences, all, running, foc) {
            // The peer is called once a tick: another number is that of memory that was overwritten.
            (Some(differences), Some(all), Some(running), Some(foc))
                if all.ticks > 0 && foc.ticks == all.ticks =>
            {
                Ok(Self {
                    chip: chip.name(),
                    processor: title.clone(),
                    ticks: all.ticks,
                    differences,
                    instructions: Ticks { all, running, foc },
                    datagrams: datagrams(output),
                    is_the_chips: *is_the_chips,
                })
            }
            _ => Err(Error::Sentence(format!(
                "the image did not finish, or overwrote what it counted; it said:\n{output}"
            ))),
        }
    }

    /// Prints the tables.
    fn print(&self) {
        let Self { processor, instructions: Ticks { all, running, foc }, .. } = self;
        println!(
            "| {processor}, instructions per tick, both motors | median | 99 % | worst | ceilings |"
        );
        println!("|---|---:|---:|---:|---|");
        let row = |what: &str, counts: &Counts, ceilings: &str| {
            let Counts { median, p99, worst, .. } = counts;
            println!("| {what} | {median} | {p99} | {worst} | {ceilings} |");
        };
        let ceilings = match self.is_the_chips {
            true => format!("{MEDIAN_CEILING} / {WORST_CEILING}"),
            false => String::new(),
        };
        row(
            "this firmware while running: sensors to duties, supervisor included",
            running,
            &ceilings,
        );
        row("the same, from power-up to the fault at the end", all, &ceilings);
        row("crate `foc` 0.3: two current loops and modulation alone", foc, "");
        if self.is_the_chips {
            self.print_datagrams();
        }
    }

    fn print_datagrams(&self) {
        println!(
            "\n| {}, a datagram received | instructions | of an ESP32-C6 at 1,000 a second | at 10,000 |",
            self.processor
        );
        println!("|---|---:|---:|---:|");
        for Datagram { kind, instructions } in &self.datagrams {
            let share = |rate: f64| 100.0 * f64::from(*instructions) * rate / CLOCK_HZ;
            let [few, many] = FLOODS.map(share);
            println!("| {kind} | {instructions} | {few:.1} % | {many:.0} % |");
        }
    }

    /// Returns an error where a promise does not hold.
    fn verdict(&self, output: &str) -> Result<(), Error> {
        let Self { ticks, differences, .. } = self;
        if *differences != 0 {
            return Err(Error::Sentence(format!(
                "{differences} of {ticks} ticks decided otherwise than on this computer:\n{output}"
            )));
        }
        let is_slow =
            |counts: &Counts| counts.median > MEDIAN_CEILING || counts.worst > WORST_CEILING;
        let Ticks { all, running, .. } = &self.instructions;
        if self.is_the_chips && [all, running].into_iter().any(is_slow) {
            return Err(Error::Sentence(
                "the tick takes more instructions than its ceilings".into(),
            ));
        }
        Ok(())
    }
}

/// Builds what is missing, records, replays, compares, counts.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let processor = Processor::of(args)?;
    if !run::succeeds(run::command(processor.program).arg("--version")) {
        let program = processor.program;
        let sentence = format!("{program} is not installed: run `cargo xtask setup`");
        if args.json || std::env::var_os("CI").is_some() {
            return Err(Error::Sentence(sentence));
        }
        println!("skipped: {sentence}");
        return Ok(());
    }
    let directory = run::target_directory().join("xtask/pil");
    let trace = directory.join("trace.bin");
    run::write(&trace, [])?;
    record(&trace)?;
    let image = processor.image()?;
    let output = processor.run(&image, &directory)?;
    let replay = Replay::read(&processor, &output)?;
    if args.json {
        println!("{}", serde_json::json!(replay));
    } else {
        replay.print();
    }
    replay.verdict(&output)?;
    if !args.json {
        println!("{} ticks, every outcome bit for bit the same as on this computer", replay.ticks);
    }
    Ok(())
}

/// Records a walk of the simulated robot.
fn record(trace: &Path) -> Result<(), Error> {
    // As the tests build it, so that it need not be built twice.
    run::run(
        toolchain::cargo()
            .args(["build", "--quiet", "--workspace", "--profile", "test"])
            .args(["--example", RECORDER]),
    )?;
    let recorder = run::target_directory().join("debug/examples").join(RECORDER);
    run::run(run::command(recorder).arg(trace).stdout(Stdio::null()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "datagram 300 a good stop\n\
        differences 0\n\
        tick median 1500 p99 1700 worst 2900 ticks 60000\n\
        running median 1600 p99 1800 worst 2800 ticks 50000\n\
        foc median 2400 p99 2500 worst 2600 ticks 60000\n";

    fn processor_with(chip: Chip, core: Option<&str>) -> Result<Processor, Error> {
        Processor::of(&Args { chip, core: core.map(str::to_owned), json: false })
    }

    fn processor(chip: Chip) -> Processor {
        processor_with(chip, None).unwrap()
    }

    fn report_of(chip: Chip, output: &str) -> Result<(), Error> {
        Replay::read(&processor(chip), output)?.verdict(output)
    }

    fn report(output: &str) -> Result<(), Error> {
        report_of(Chip::Esp32c6, output)
    }

    #[test]
    fn a_good_run_passes() {
        assert!(report(GOOD).is_ok());
    }

    #[test]
    fn datagrams_are_read_with_their_names() {
        let read = datagrams("tick\ndatagram 300 a good stop\ndatagram x y\n");
        assert_eq!(read, [Datagram { kind: "a good stop".into(), instructions: 300 }]);
    }

    #[test]
    fn a_difference_fails_on_every_processor() {
        let output = GOOD.replace("differences 0", "differences 1");
        for chip in [Chip::Esp32c6, Chip::Esp32] {
            assert!(report_of(chip, &output).unwrap_err().to_string().contains("1 of 60000"));
        }
    }

    #[test]
    fn a_tick_above_its_ceiling_fails_where_it_is_the_chips() {
        for (good, bad) in [
            ("worst 2900", "worst 3001"),
            ("median 1500", "median 2001"),
            ("worst 2800", "worst 3001"),
            ("median 1600", "median 2001"),
        ] {
            assert!(report(&GOOD.replace(good, bad)).is_err(), "{bad}");
            assert!(report_of(Chip::Esp32, &GOOD.replace(good, bad)).is_ok(), "{bad}");
        }
    }

    #[test]
    fn an_image_that_stops_early_or_replays_nothing_fails() {
        assert!(report("differences 0\n").is_err());
        assert!(report("panic: here\n").is_err());
        assert!(report(&GOOD.replace("worst 2900 ticks 60000", "worst 2900 ticks 0")).is_err());
        assert!(report(&GOOD.replace("worst 2600 ticks 60000", "worst 2600 ticks 70000")).is_err());
    }

    #[test]
    fn a_core_of_another_chip_is_refused() {
        for chip in [Chip::Esp32c6, Chip::Esp32s3] {
            let refused =
                processor_with(chip, Some(FIRST_CORE)).err().map(|error| error.to_string());
            assert!(refused.is_some_and(|sentence| sentence.contains("--chip esp32")), "{chip:?}");
        }
    }

    #[test]
    fn programs_read_the_counts_and_whose_they_are() {
        let replay = Replay::read(&processor(Chip::Esp32), GOOD).unwrap();
        let counts = |median, p99, worst, ticks| serde_json::json!({"median": median, "p99": p99, "worst": worst, "ticks": ticks});
        assert_eq!(
            serde_json::json!(replay),
            serde_json::json!({
                "chip": "esp32",
                "processor": "Xtensa, QEMU's dc233c",
                "ticks": 60000,
                "differences": 0,
                "instructions": {
                    "all": counts(1500, 1700, 2900, 60000),
                    "running": counts(1600, 1800, 2800, 50000),
                    "foc": counts(2400, 2500, 2600, 60000),
                },
                "datagrams": [{"kind": "a good stop", "instructions": 300}],
            })
        );
    }
}
