//! `flix-sim faults`: what the robot does when something goes wrong.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::output::{headings, mark, print_verdict, progress, row, table};
use flix_sim::reliability::fault_cases::{CASES, Case};
use flix_sim::reliability::fault_matrix::{
    CELLS_OF_A_CASE, Cell, Matrix, Outcome, REST_LIMIT_S, measure,
};

/// Inject every fault in every walking mode at every onset and report what the robot does
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim faults\n  flix-sim faults --only partition --seed 7 --json"
)]
pub struct Args {
    /// Seed of the robot: its motors, wiring, sensor errors and noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Inject only the faults with this in their name
    #[arg(long, value_name = "NAME", default_value = "")]
    only: String,
    /// Print every cell of the matrix as JSON only
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When a robot could not be brought to run while all was well.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let wanted = |case: &Case| case.name.contains(&args.only);
    let cases = CASES.iter().filter(|case| wanted(case)).count();
    if cases == 0 {
        let names = CASES.map(|case| case.name).join(", ");
        return Err(Error::refused(format!(
            "--only {}: there is no such fault among {names}",
            args.only
        )));
    }
    let bar = progress((cases * CELLS_OF_A_CASE) as u64, "breaking");
    let measured = measure(args.seed, wanted, || bar.inc(1));
    bar.finish_and_clear();
    print_verdict(measured, |matrix| matrix.pass, args.json, text)
}

fn text(matrix: &Matrix) -> String {
    let mut rows = vec![headings(
        "fault|held|rested|safe (s)|current (A)|phase (deg)|f rms (Hz)|theta rms (deg)|first fault",
    )];
    rows.extend(
        matrix
            .cells
            .chunk_by(|a, b| a.fault == b.fault)
            .map(|of_case| worst(of_case[0].fault, &of_case.iter().collect::<Vec<_>>())),
    );
    rows.push(row!["limit", "", "", format!("{REST_LIMIT_S:.3}")]);
    let mut text = format!(
        "Robot of seed {}; the worst of {} cells a fault (mode, onset, base), the plant's truth:\n\n{}\n",
        matrix.seed,
        CELLS_OF_A_CASE,
        table(&rows),
    );
    for cell in matrix.cells.iter().filter(|cell| !cell.pass) {
        text += &format!(
            "outside: {}, {} base, f {} Hz, theta {} degrees, {:?}: {:?}, safe {:?} s, f {:?} Hz, \
             theta {:.2} degrees, phase {:?} degrees, {:.2} A, {}, {:?}\n",
            cell.fault,
            cell.base,
            cell.f_hz,
            cell.theta_deg,
            cell.onset,
            cell.outcome,
            cell.safe_s,
            cell.f_rms_hz,
            cell.theta_rms_deg,
            cell.phase_error_deg,
            cell.largest_current_a,
            cell.state,
            cell.first_fault,
        );
    }
    text + if matrix.pass { "All promises kept.\n" } else { "Not all promises kept.\n" }
}

/// Returns the row of one fault: the worst of its cells.
fn worst(name: &str, cells: &[&Cell]) -> Vec<String> {
    let count = |outcome| cells.iter().filter(|cell| cell.outcome == outcome).count();
    let worst = |decimals: usize, figure: &dyn Fn(&Cell) -> Option<f64>| {
        let figures = cells.iter().filter_map(|cell| figure(cell));
        let largest = figures.reduce(f64::max);
        largest.map_or_else(|| "-".to_owned(), |largest| format!("{largest:.decimals$}"))
    };
    let held = |cell: &Cell| cell.outcome == Outcome::Held;
    let mut faults: Vec<&str> =
        cells.iter().filter_map(|cell| cell.first_fault.as_deref()).collect();
    faults.sort_unstable();
    faults.dedup();
    row![
        name,
        count(Outcome::Held),
        count(Outcome::Rested),
        worst(3, &|cell| cell.safe_s),
        worst(2, &|cell| Some(cell.largest_current_a)),
        worst(1, &|cell| cell.phase_error_deg),
        worst(4, &|cell| cell.f_rms_hz.filter(|_| held(cell))),
        worst(3, &|cell| held(cell).then_some(cell.theta_rms_deg)),
        faults.join(", "),
        mark(cells.iter().all(|cell| cell.pass)),
    ]
}
