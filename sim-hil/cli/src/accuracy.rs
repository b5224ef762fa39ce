//! `flix-sim accuracy`: the figures that the robot promises, measured.

use std::path::PathBuf;
use std::process::ExitCode;

use flix_plot::Figure as _;
use flix_shell::number::whole;

use super::error::Error;
use super::output::{headings, mark, print_verdict, progress, row, table, words};
use flix_sim::model::RobotModel;
use flix_sim::reliability::accuracy::{
    ACROSS_LIMIT, Accuracy, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, FREQUENCY_LIMIT_HZ, HoldResult,
    RUNS, SETTLE_LIMIT_S, measure,
};
use flix_sim::reliability::commissioned_accuracy;
use flix_sim::rig::bench::{BASES, Subject};
use flix_study::figure::over_charge;
use flix_study::headroom::{CEILING_SHARE, HEADROOM_V, Headroom, judge};

/// Measure how well f and theta are held over their whole range
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim accuracy\n  flix-sim accuracy --seed 7 --json\n  flix-sim accuracy --model my-robot.toml\n  flix-sim accuracy --robots 20 --first-seed 100 --json\n  flix-sim accuracy --robots 200 --out out/accuracy"
)]
pub struct Args {
    /// Model whose body, shaker and electrical part are put on the bench: a TOML file or a name [default: the bench]
    #[arg(long, value_name = "FILE|NAME")]
    model: Option<String>,
    /// Seed of the robot: its motors, wiring, sensor errors and noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Draw so many robots about the assumed one, with current sense (commissioned) and without (measured by hand), and count
    /// those that keep every promise, or say why not, beside what an ideal drive could hold; 100 take seven minutes
    #[arg(long, value_name = "COUNT", value_parser = whole::<usize>(1..=100_000), conflicts_with_all = ["model", "seed"])]
    robots: Option<usize>,
    /// Seed of the first of these robots; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX), requires = "robots")]
    first_seed: u64,
    /// Folder for headroom.svg and headroom.png: how many of these robots hold everything, over the charge of their batteries
    #[arg(long, value_name = "DIR", requires = "robots")]
    out: Option<PathBuf>,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When the model is refused, a robot could not be brought to run, or the figure not be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if let Some(robots) = args.robots {
        let bar = progress(2 * robots as u64, "commissioning and measuring");
        let measured =
            commissioned_accuracy::measure(robots, args.first_seed, || bar.inc(1)).and_then(judge);
        bar.finish_and_clear();
        if let (Some(folder), Ok(measured)) = (&args.out, &measured) {
            over_charge(measured).write(folder, "headroom")?;
        }
        return print_verdict(measured, |it| it.pass, args.json, text_of_all);
    }
    let model = args.model.as_deref().map(RobotModel::named).transpose()?;
    let subject = Subject { model, seed: args.seed };
    let bar = progress(RUNS as u64, "measuring");
    let measured = measure(&subject, || bar.inc(1));
    bar.finish_and_clear();
    print_verdict(measured, |it| it.pass, args.json, |accuracy| text(accuracy, args.seed))
}

fn text_of_all(headroom: &Headroom) -> String {
    let boards = &headroom.boards;
    let kinds = [("with current sense", &boards.sense), ("voltage mode", &boards.voltage)];
    let mut rows = vec![headings(
        "board|held|of these possible|possible|limited, said so|too low|fault, right name|wrong name|silent|above 2 A|current (A)",
    )];
    rows.extend(kinds.map(|(kind, it)| {
        row![
            kind,
            it.held,
            it.possible_held,
            it.possible,
            it.limited,
            it.below_ceiling,
            it.named,
            it.misnamed,
            it.silent,
            it.above_limit,
            format!("{:.2}", it.largest_current_a),
        ]
    }));
    let mut broken = vec![headings("board|seed|headroom (V)|ceiling (Hz)|base|asked|kept|why")];
    for (kind, board) in kinds {
        for robot in &board.each {
            let bound =
                [robot.bound.headroom_v, robot.bound.ceiling_hz].map(|it| format!("{it:.2}"));
            broken.extend(robot.broken.iter().map(|run| {
                let [left, ceiling] = &bound;
                row![
                    kind,
                    robot.seed,
                    left,
                    ceiling,
                    run.base,
                    run.asked,
                    words(&run.kept),
                    run.why
                ]
            }));
        }
    }
    format!(
        "{}\nPossible: an ideal drive has more than {HEADROOM_V} V left at 35 Hz. Too low: f below {CEILING_SHARE} of what it reaches.\n\n{}",
        table(&rows),
        table(&broken)
    )
}

fn text(accuracy: &Accuracy, seed: u64) -> String {
    let mut held = vec![headings(
        "base|f (Hz)|theta (deg)|f rms (Hz)|theta rms (deg)|force error (deg)|across (%)",
    )];
    held.extend(accuracy.hold.iter().map(|hold| {
        let mut row = row![hold.base, hold.f_hz, hold.theta_deg];
        row.extend(figures([
            hold.f_rms_hz,
            hold.theta_rms_deg,
            hold.force_error_deg,
            hold.across_axis,
        ]));
        row.push(mark(hold.passes()).to_owned());
        row
    }));
    let summary = |name: &str, values| [row![name, "", ""], figures(values).to_vec()].concat();
    let limits = [FREQUENCY_LIMIT_HZ, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, ACROSS_LIMIT];
    held.push(summary("limit", limits));
    for base in BASES {
        let of_base = accuracy.hold.iter().filter(|hold| hold.base == base);
        held.push(summary(&format!("worst, {base}"), worst(of_base)));
    }
    let mut steps = vec![row!["step", "settled (s)", "current (A)", "limit (A)"]];
    steps.extend(accuracy.steps.iter().map(|step| {
        row![
            step.name,
            step.settle_s.map_or_else(|| "never".to_owned(), |s| format!("{s:.3}")),
            format!("{:.3}", step.peak_current_a),
            format!("{:.3}", step.current_limit_a),
            mark(step.passes()),
        ]
    }));
    steps.push(row!["limit", format!("{SETTLE_LIMIT_S:.3}")]);
    format!(
        "Robot of seed {seed}, the plant's truth:\n\n{}\n{}\n{}\n",
        table(&held),
        table(&steps),
        if accuracy.pass { "All within limits." } else { "Not all within limits." }
    )
}

/// Returns the text of f and theta (RMS), the line of force and the share of force across it.
fn figures([f, theta, force, across]: [f64; 4]) -> [String; 4] {
    [
        format!("{f:.4}"),
        format!("{theta:.3}"),
        format!("{force:.3}"),
        format!("{:.2}", 100.0 * across),
    ]
}

fn worst<'a>(of: impl Iterator<Item = &'a HoldResult>) -> [f64; 4] {
    of.fold([0.0_f64; 4], |largest, hold| {
        [
            largest[0].max(hold.f_rms_hz),
            largest[1].max(hold.theta_rms_deg),
            largest[2].max(hold.force_error_deg.abs()),
            largest[3].max(hold.across_axis),
        ]
    })
}
