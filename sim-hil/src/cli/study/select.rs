//! `flix-sim study select`: which pairs to steer with, and what the paper says about robustness.

use flix_host::cli::number::parse_within;
use std::path::PathBuf;
use std::process::ExitCode;

use flix_host::plot::Figure;

use super::{SweepArgs, sensitivity};
use crate::cli::Error;

use crate::cli::output::{headings, print, row, table};
use crate::study::sensitivity::{Candidate, Change, LEAST_SPEED, candidates, mode_table};
use crate::study::statements::{Statement, Verdict, statements};
use crate::study::sweep::{Cell, cells};
use crate::study::{Shard, figure};

/// Pairs listed for each kind of motion.
const LISTED: usize = 3;

/// Choose robust pairs by index P from both sensitivity studies; write a mode table
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Uses what `study sensitivity` computed with the same options, and computes what is missing.\n\nExamples:\n  flix-sim study select\n  flix-sim study select --model W --modes out/W.modes.toml\n  flix-sim study select --statements        # the paper's sensitivity section, claim by claim"
)]
pub struct Args {
    #[command(flatten)]
    sweep: SweepArgs,
    /// Least speed of a mode's own component, 0 to 10 m/s, yaw rates times 0.1 m
    #[arg(long, value_name = "SPEED", default_value_t = LEAST_SPEED, value_parser = parse_speed)]
    least: f64,
    /// File of the mode table [default: modes.toml beside the figure]
    #[arg(long, value_name = "FILE")]
    modes: Option<PathBuf>,
    /// Check the claims of the paper's sensitivity section instead
    #[arg(long)]
    statements: bool,
}

fn parse_speed(text: &str) -> Result<f64, String> {
    parse_within(text, 0.0..=10.0, "speed", " m/s")
}

/// Runs the command.
///
/// # Errors
/// When the model is refused, a walk fails, or files cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if args.sweep.run.shard != Shard::WHOLE {
        return Err(Error::refused(
            "select needs all walks: shard `study sensitivity` instead, then merge",
        ));
    }
    let model = args.sweep.model()?;
    let walked = |change, name: &str| -> Result<(Vec<Cell>, PathBuf), Error> {
        let sweep = sensitivity::sweep(&args.sweep, &model, change);
        let mut run = args.sweep.run.clone();
        run.out = run.out.map(|folder| folder.join(name));
        let folder = run.folder(&sweep);
        let table = run.run(&sweep)?.ok_or_else(|| Error::refused("not all walks are there"))?;
        Ok((cells(&table), folder))
    };
    let (mass, folder) = walked(Change::Mass, "mass")?;
    let (friction, _) = walked(Change::Friction, "friction")?;
    if args.statements {
        print(&claims(&model.name, &statements(&mass, &friction)))?;
        return Ok(ExitCode::SUCCESS);
    }
    let kinds = candidates(&mass, &friction, args.least);
    let labelled = labels(&kinds);
    print(&text(&labelled, args.least))?;
    let figure = figure::selection(&model.name, &mass, &friction, args.least, &labelled)
        .write(&folder, "selection")?;
    let path = args.modes.clone().unwrap_or_else(|| folder.join("modes.toml"));
    let walked = sensitivity::sweep(&args.sweep, &model, Change::Mass);
    let source = format!(
        "flix-sim study select: index P over {} seeds of {} s, least speed {} m/s",
        walked.seeds, walked.seconds, args.least
    );
    let table = mode_table(&model.name, &source, &kinds).map_err(Error::refused)?;
    table.save(&path).map_err(Error::refused)?;
    print(&format!("\nmodes   {}\nfigure  {}\n", path.display(), figure.png.display()))?;
    Ok(ExitCode::SUCCESS)
}

/// The best of each kind, lettered like the paper's: A, A', A'' for the first kind and so on.
fn labels(kinds: &[(&'static str, Vec<Candidate>)]) -> Vec<(String, Candidate)> {
    let lettered = kinds.iter().zip('A'..='Z').flat_map(|((_, found), letter)| {
        found.iter().take(LISTED).enumerate().map(move |(rank, candidate)| {
            (format!("{letter}{}", "'".repeat(rank)), candidate.clone())
        })
    });
    lettered.collect()
}

fn text(labelled: &[(String, Candidate)], least: f64) -> String {
    let mut rows =
        vec![headings("|motion|f (Hz)|theta (deg)|P|forward (m/s)|lateral (m/s)|yaw (rad/s)")];
    rows.extend(labelled.iter().map(|(label, candidate)| {
        let mean = candidate.cell.mean();
        let [forward, lateral, yaw] =
            [mean.forward, mean.lateral, mean.yaw].map(|speed| format!("{speed:.4}"));
        row![
            label,
            candidate.component.word(candidate.component.of(mean)),
            candidate.cell.f_hz,
            candidate.cell.theta_deg,
            format!("{:.2}", candidate.index),
            forward,
            lateral,
            yaw,
            if candidate.fast { String::new() } else { format!("below {least} m/s") }
        ]
    }));
    table(&rows)
}

fn claims(model: &str, statements: &[Statement]) -> String {
    let mut rows = vec![headings("claim|from|to")];
    rows.extend(statements.iter().map(|it| {
        let [before, after] = it.values.map(|v| {
            let spread = v.spread.map_or_else(String::new, |spread| format!(" \u{b1} {spread:.3}"));
            format!("{:+.3}{spread}", v.mean)
        });
        let mark = if it.contradicts_itself { "*" } else { "" };
        row![it.claim, before, after, format!("{}{mark}", it.verdict)]
    }));
    let count = |contradicts, verdict| {
        let same = |s: &&Statement| s.contradicts_itself == contradicts && s.verdict == verdict;
        statements.iter().filter(same).count()
    };
    let has_errors = statements.iter().flat_map(|it| it.values).all(|v| v.spread.is_some());
    let why = if has_errors {
        "within two standard errors"
    } else {
        "one walk a cell; a verdict needs at least two: --seeds, without --quick"
    };
    let sums = |contradicts| {
        format!(
            "{} hold, {} fail, {} are unclear ({why})",
            count(contradicts, Verdict::Holds),
            count(contradicts, Verdict::Fails),
            count(contradicts, Verdict::Unclear)
        )
    };
    let plain = statements.iter().filter(|s| !s.contradicts_itself).count();
    format!(
        "What the paper's section III-B says, and what model {model} does (left is positive):\n\n{}\n\
         {plain} claims: {}\n* where the paper's word and sign contradict each other, by the word: {}\n",
        table(&rows),
        sums(false),
        sums(true)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::walk::Spread;

    #[test]
    fn statements_from_one_walk_a_cell_claim_no_spread() {
        let report = |walks: &[f64], verdict| {
            let values = [Spread::of(walks); 2];
            let claim = "a load turns it".to_owned();
            claims("W", &[Statement { claim, values, verdict, contradicts_itself: false }])
        };
        let one = report(&[0.01], Verdict::Unclear);
        assert!(!one.contains('\u{b1}') && one.contains("1 are unclear (one walk a cell"), "{one}");
        let two = report(&[0.01, 0.03], Verdict::Holds);
        assert!(two.contains("\u{b1} 0.014") && two.contains("(within two standard"), "{two}");
    }
}
