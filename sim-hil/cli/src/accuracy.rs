//! `flix-sim accuracy`: the figures that the robot promises, measured.

use std::process::ExitCode;

use flix_plot::Figure as _;
use flix_shell::number::whole;

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use super::output::{headings, outside, print_figures, row, table, words};
use flix_sim::model::RobotModel;
use flix_sim::reliability::accuracy::{holds, steps};
use flix_sim::reliability::commissioned_accuracy;
use flix_sim::rig::bench::Subject;
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
    /// those that keep every promise, or say why not, beside what an ideal drive could hold, with the figures headroom.svg and
    /// headroom.png of the same over the charge of their batteries; 100 take seven minutes
    #[arg(long, value_name = "COUNT", value_parser = whole::<usize>(1..=100_000), conflicts_with_all = ["model", "seed"])]
    robots: Option<usize>,
    /// Seed of the first of these robots; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX), requires = "robots")]
    first_seed: u64,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if let Some(robots) = args.robots {
        let study = commissioned_accuracy::robots(robots, args.first_seed);
        let (table, folder) = args.measure.table("accuracy", &study)?;
        let (_, failures) = table.succeeded();
        let headroom = judge(robots, commissioned_accuracy::found(&table))?;
        over_charge(&headroom).write(&folder, "headroom")?;
        let mut json = serde_json::to_value(&headroom)?;
        if !failures.is_empty() {
            json["failures"] = failures.into();
        }
        let pass = headroom.pass && json.get("failures").is_none();
        json["pass"] = pass.into();
        let text =
            || text_of_all(&headroom) + &outside(&table) + &args.measure.next(&study, &folder);
        return print_figures(&json, pass, args.measure.json, text);
    }
    let model = args.model.as_deref().map(RobotModel::named).transpose()?;
    let subject = Subject { model, seed: args.seed };
    measure("accuracy", &[&holds(&subject), &steps(&subject)], &args.measure)
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
