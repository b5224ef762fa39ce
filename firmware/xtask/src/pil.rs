//! Processor in the loop: the fast half on an emulated RV32IMAC against a trace from the simulator.

use std::process::Command;

use crate::run::{self, Error};
use crate::toolchain;

/// Most instructions of half of all ticks, both motors: 12.5 % of the ESP32-C6 at 10 kHz.
const MEDIAN_CEILING: u32 = 2_000;
/// Most instructions of any tick: under 20 % of the ESP32-C6 at 10 kHz.
const WORST_CEILING: u32 = 3_000;

/// Clock of the ESP32-C6, instructions a second at best.
const CLOCK_HZ: f64 = 160e6;
/// Datagrams a second whose share of the chip is printed.
const FLOODS: [f64; 2] = [1_000.0, 10_000.0];

/// The simulator's example that records the trace.
const RECORDER: &str = "record-trace";

/// What the image counted of one candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

/// Reads the lines `datagram N NAME` of the image's output.
fn datagrams(output: &str) -> impl Iterator<Item = (f64, &str)> {
    output.lines().filter_map(|line| {
        let (count, name) = line.strip_prefix("datagram ")?.split_once(' ')?;
        Some((count.parse().ok()?, name))
    })
}

/// Builds what is missing, records, replays, compares, counts.
pub(crate) fn run() -> Result<(), Error> {
    if !run::succeeds(run::command("qemu-system-riscv32").arg("--version")) {
        let sentence = "qemu-system-riscv32 is not installed: run `cargo xtask setup`";
        if std::env::var_os("CI").is_some() {
            return Err(Error::Sentence(sentence.into()));
        }
        println!("skipped: {sentence}");
        return Ok(());
    }
    let directory = run::target_directory().join("xtask/pil");
    let trace = directory.join("trace.bin");
    run::write(&trace, [])?;
    // As the tests build it, so that it need not be built twice.
    run::run(
        toolchain::cargo()
            .args(["build", "--quiet", "--workspace", "--profile", "test"])
            .args(["--example", RECORDER]),
    )?;
    let recorder = run::target_directory().join("debug/examples").join(RECORDER);
    run::run(run::command(recorder).arg(&trace))?;
    run::run(toolchain::riscv("build")?.args(["--package", "flix-firmware"]).args([
        "--bin",
        "pil",
        "--features",
        "pil",
    ]))?;
    let mut emulator = Command::new("qemu-system-riscv32");
    emulator
        .args(["-M", "virt", "-bios", "none", "-nographic", "-icount", "shift=0"])
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(toolchain::riscv_binary("pil"))
        .current_dir(&directory)
        .stdin(std::process::Stdio::null());
    let output = run::output(&mut emulator)?;
    report(&output)
}

/// Prints the table; an error where a promise does not hold.
fn report(output: &str) -> Result<(), Error> {
    let incomplete = || Error::Sentence(format!("the image did not finish; it said:\n{output}"));
    let differences: u32 = output
        .lines()
        .find_map(|line| line.strip_prefix("differences "))
        .and_then(|number| number.trim().parse().ok())
        .ok_or_else(incomplete)?;
    let [all, running, peer] = ["tick", "running", "foc"].map(|name| counts(output, name));
    let all = all.ok_or_else(incomplete)?;
    let running = running.ok_or_else(incomplete)?;
    let peer = peer.ok_or_else(incomplete)?;
    println!("| RV32IMAC, instructions per tick, both motors | median | 99 % | worst | ceilings |");
    println!("|---|---:|---:|---:|---|");
    let row = |what: &str, counts: Counts, ceilings: &str| {
        let Counts { median, p99, worst, .. } = counts;
        println!("| {what} | {median} | {p99} | {worst} | {ceilings} |");
    };
    let ceilings = format!("{MEDIAN_CEILING} / {WORST_CEILING}");
    row("this firmware while running: sensors to duties, supervisor included", running, &ceilings);
    row("the same, from power-up to the fault at the end", all, &ceilings);
    row("crate `foc` 0.3: two current loops and modulation alone", peer, "");
    println!(
        "\n| RV32IMAC, a datagram received | instructions | of an ESP32-C6 at 1,000 a second | at 10,000 |"
    );
    println!("|---|---:|---:|---:|");
    for (count, name) in datagrams(output) {
        let [few, many] = FLOODS.map(|rate| 100.0 * count * rate / CLOCK_HZ);
        println!("| {name} | {count} | {few:.1} % | {many:.0} % |");
    }
    if differences != 0 {
        return Err(Error::Sentence(format!(
            "{differences} of {} ticks decided otherwise than on this computer:\n{output}",
            all.ticks
        )));
    }
    println!("{} ticks, every outcome bit for bit the same as on this computer", all.ticks);
    let is_slow = |counts: Counts| counts.median > MEDIAN_CEILING || counts.worst > WORST_CEILING;
    if is_slow(running) || is_slow(all) {
        return Err(Error::Sentence("the tick takes more instructions than its ceilings".into()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "differences 0\n\
        tick median 1500 p99 1700 worst 2900 ticks 60000\n\
        running median 1600 p99 1800 worst 2800 ticks 50000\n\
        foc median 2400 p99 2500 worst 2600 ticks 60000\n";

    #[test]
    fn a_good_run_passes() {
        assert!(report(GOOD).is_ok());
    }

    #[test]
    fn datagrams_are_read_with_their_names() {
        let read: Vec<_> = datagrams("tick\ndatagram 300 a good stop\ndatagram x y\n").collect();
        assert_eq!(read, [(300.0, "a good stop")]);
    }

    #[test]
    fn a_difference_fails() {
        let output = GOOD.replace("differences 0", "differences 1");
        assert!(report(&output).unwrap_err().to_string().contains("1 of 60000"));
    }

    #[test]
    fn a_tick_above_its_ceiling_fails() {
        for (good, bad) in [
            ("worst 2900", "worst 3001"),
            ("median 1500", "median 2001"),
            ("worst 2800", "worst 3001"),
            ("median 1600", "median 2001"),
        ] {
            assert!(report(&GOOD.replace(good, bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn an_image_that_stops_early_fails() {
        assert!(report("differences 0\n").is_err());
        assert!(report("panic: here\n").is_err());
    }
}
