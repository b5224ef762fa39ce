//! `flix-sim study select`: which pairs to steer with, and what the paper says about robustness.

use flix_shell::number::within;
use std::path::PathBuf;
use std::process::ExitCode;

use flix_host::nav::ModeTableError;
use flix_plot::Figure;
use serde::Serialize;

use super::options::SweepArgs;
use super::sensitivity;
use crate::error::Error;

use crate::output::{headings, print, print_figures, row, table};
use flix_sim::experiment::walk::Spread;
use flix_sim::study::Shard;
use flix_study::figure;
use flix_study::selection::{
    Candidate, Exclusion, LEAST_SPEED, Robustness, Selected, TABLE_4, candidates, mode_table, rank,
    robustness, worthwhile,
};
use flix_study::sensitivity::Change;
use flix_study::statements::{Claim, Verdict, claims};
use flix_study::sweep::{Cell, cells};

/// Pairs listed for each kind of motion.
const LISTED: usize = 3;
/// Seeds below which claims are not judged without a warning.
const ENOUGH_SEEDS: usize = 8;
/// The paper's letter of each kind of motion; it selects no pair that goes backward.
const LETTERS: [(&str, char); 6] = [
    ("forward", 'A'),
    ("strafe right", 'B'),
    ("strafe left", 'C'),
    ("turn right", 'D'),
    ("turn left", 'E'),
    ("backward", 'F'),
];

/// Choose robust pairs by index P from both sensitivity studies, beside the paper's table IV; write a mode table
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Uses what `study sensitivity` computed with the same options, and computes what is missing.\n\nP (equation 9) is of the mode's own component: what I' stands for is not defined. Its +- is the standard error over the seeds. Pairs below --least are left out twice over: by the speed of their own component, and by their heading speed, as the paper's words have it. A pair whose other components exceed half of its own comes after those that are purer. A claim of section III-B holds when the 95 % interval (Student's t over the seeds) leaves out zero; mirrored claims count once; chance is the share of all pairs for which the same sentence holds.\n\nExamples:\n  flix-sim study select\n  flix-sim study select --model W --modes out/W.modes.toml\n  flix-sim study select --statements --seeds 8    # the paper's sensitivity section, claim by claim\n  flix-sim study select --seeds 8 --step 0.25ms --json"
)]
pub struct Args {
    #[command(flatten)]
    sweep: SweepArgs,
    /// Least speed of a mode, 0 to 10 m/s, yaw rates times 0.1 m
    #[arg(long, value_name = "SPEED", default_value_t = LEAST_SPEED, value_parser = within(0.0..=10.0, "speed", " m/s"))]
    least: f64,
    /// File of the mode table [default: modes.toml beside the figure]
    #[arg(long, value_name = "FILE")]
    modes: Option<PathBuf>,
    /// Check the claims of the paper's sensitivity section instead
    #[arg(long)]
    statements: bool,
    /// Print selection and claims as JSON only; draw no figure, write no mode table
    #[arg(long, conflicts_with_all = ["statements", "modes"])]
    json: bool,
}

/// A row of the paper's table IV, and what the robot makes of it.
#[derive(Debug, Serialize)]
struct TableRow {
    mode: &'static str,
    letter: &'static str,
    /// Hz, degrees.
    paper: (f64, f64),
    /// Among the fast pairs of its kind by their own component; none where it is slow or moves in another way.
    rank: Option<usize>,
    /// The same with slow headings left out.
    rank_literal: Option<usize>,
    /// P of the mode's component at the paper's pair.
    p: Option<f64>,
    /// Its standard error over the seeds.
    p_spread: Option<f64>,
    /// The robot's best pair, by its own component; Hz, degrees.
    best: Option<(f64, f64)>,
    /// The same with slow headings left out.
    best_literal: Option<(f64, f64)>,
}

/// Claims that can be read one way, and those that contradict themselves.
#[derive(Debug, Serialize)]
struct Counts {
    independent: usize,
    hold: usize,
    fail: usize,
    unclear: usize,
    /// Claims that hold by chance: the sum of their shares.
    chance: f64,
}

impl Counts {
    fn of<'a>(claims: impl Iterator<Item = &'a Claim> + Clone) -> Self {
        let count = |verdict| claims.clone().filter(|claim| claim.verdict == verdict).count();
        Self {
            independent: claims.clone().count(),
            hold: count(Verdict::Holds),
            fail: count(Verdict::Fails),
            unclear: count(Verdict::Unclear),
            // The sum of nothing is -0.
            chance: 0.0 + claims.map(|claim| claim.chance).sum::<f64>(),
        }
    }
}

#[derive(Debug, Serialize)]
struct ClaimRow {
    sentences: Vec<String>,
    verdict: Verdict,
    chance: f64,
    contradicts_itself: bool,
}

#[derive(Debug, Serialize)]
struct Statements {
    #[serde(flatten)]
    counts: Counts,
    contradictory: Counts,
    claims: Vec<ClaimRow>,
}

#[derive(Debug, Serialize)]
struct Report {
    model: String,
    seeds: usize,
    least_m_s: f64,
    table4: Vec<TableRow>,
    statements: Statements,
}

type Kinds = Vec<(&'static str, Vec<Candidate>)>;

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if args.sweep.run.shard != Shard::WHOLE {
        return Err(Error::usage(
            "select needs all walks: shard `study sensitivity` instead, then merge",
        ));
    }
    let model = args.sweep.model()?;
    let walked = |change, name: &str| -> Result<(Vec<Cell>, PathBuf), Error> {
        let sweep = sensitivity::sweep(&args.sweep, &model, change);
        let mut run = args.sweep.run.clone();
        run.out = run.out.map(|folder| folder.join(name));
        let folder = run.folder(&sweep);
        let table = run.run(&sweep)?.ok_or_else(|| Error::usage("not all walks are there"))?;
        Ok((cells(&table), folder))
    };
    let (mass, folder) = walked(Change::Mass, "mass")?;
    let (friction, _) = walked(Change::Friction, "friction")?;
    let seeds = mass.first().map_or(0, |cell| cell.walks.len());
    if args.statements {
        print(&claims_text(&model.name, seeds, &claims(&mass, &friction)))?;
        return Ok(ExitCode::SUCCESS);
    }
    let [own, literal] = [Exclusion::Own, Exclusion::Heading]
        .map(|exclusion| candidates(&mass, &friction, args.least, exclusion));
    let table4 = TABLE_4
        .iter()
        .map(|it| {
            table_row(it, [&own, &literal], robustness(&mass, &friction, it.pair, it.component))
        })
        .collect();
    let report = Report {
        model: model.name.clone(),
        seeds,
        least_m_s: args.least,
        table4,
        statements: summed(&claims(&mass, &friction)),
    };
    if args.json {
        return print_figures(&report, true, true, String::new);
    }
    let labelled = labels(&own);
    print(&text(&labelled, args.least))?;
    print(&format!("\n{}", beside(&report)))?;
    let figure = figure::selection(&model.name, &mass, &friction, args.least, &labelled)
        .write(&folder, "selection")?;
    let path = args.modes.clone().unwrap_or_else(|| folder.join("modes.toml"));
    let walked = sensitivity::sweep(&args.sweep, &model, Change::Mass);
    let source = format!(
        "flix-sim study select: index P over {} seeds of {} s, least speed {} m/s",
        walked.seeds, walked.seconds, args.least
    );
    let modes = match mode_table(&model.name, &source, &own) {
        Err(ModeTableError::Empty) if args.modes.is_none() => {
            "none: no pair up to 35 Hz makes a mode".to_owned()
        }
        table => {
            table.and_then(|table| table.save(&path)).map_err(Error::usage)?;
            path.display().to_string()
        }
    };
    print(&format!("\nmodes   {modes}\nfigure  {}\n", figure.png.display()))?;
    Ok(ExitCode::SUCCESS)
}

/// A row of table IV, with the pairs by their own component and by their heading speed.
fn table_row(it: &Selected, kinds: [&Kinds; 2], found: Option<Robustness>) -> TableRow {
    let best = |kinds: &Kinds| {
        let (_, of) = kinds.iter().find(|(kind, _)| *kind == it.word())?;
        of.first().filter(|best| best.fast).map(|best| (best.cell.f_hz, best.cell.theta_deg))
    };
    TableRow {
        mode: it.mode,
        letter: it.letter,
        paper: it.pair,
        rank: rank(kinds[0], it),
        rank_literal: rank(kinds[1], it),
        p: found.map(|found| found.index),
        p_spread: found.and_then(|found| found.spread),
        best: best(kinds[0]),
        best_literal: best(kinds[1]),
    }
}

fn summed(claims: &[Claim]) -> Statements {
    let row = |claim: &Claim| ClaimRow {
        sentences: claim.statements.iter().map(|it| it.claim.clone()).collect(),
        verdict: claim.verdict,
        chance: claim.chance,
        contradicts_itself: claim.contradicts_itself,
    };
    Statements {
        counts: Counts::of(claims.iter().filter(|claim| !claim.contradicts_itself)),
        contradictory: Counts::of(claims.iter().filter(|claim| claim.contradicts_itself)),
        claims: claims.iter().map(row).collect(),
    }
}

/// The best of each kind with the paper's letters: A, A', A'' go forward, B strafe right and so on.
fn labels(kinds: &[(&'static str, Vec<Candidate>)]) -> Vec<(String, Candidate)> {
    let lettered = LETTERS.iter().filter_map(|(word, letter)| {
        let (_, found) = kinds.iter().find(|(kind, _)| kind == word)?;
        let listed = worthwhile(found).iter().take(LISTED).enumerate();
        Some(listed.map(move |(rank, it)| (format!("{letter}{}", "'".repeat(rank)), it.clone())))
    });
    lettered.flatten().collect()
}

fn text(labelled: &[(String, Candidate)], least: f64) -> String {
    let mut rows =
        vec![headings("|motion|f (Hz)|theta (deg)|P|forward (m/s)|lateral (m/s)|yaw (rad/s)")];
    rows.extend(labelled.iter().map(|(label, candidate)| {
        let mean = candidate.cell.mean();
        let [forward, lateral, yaw] =
            [mean.forward, mean.lateral, mean.yaw].map(|speed| format!("{speed:.4}"));
        let slow = if candidate.fast { String::new() } else { format!("below {least} m/s") };
        let mixed = if candidate.minimal { "" } else { "others not minimal" };
        row![
            label,
            candidate.component.word(candidate.component.of(mean)),
            candidate.cell.f_hz,
            candidate.cell.theta_deg,
            index_text(Some(candidate.robustness.index), candidate.robustness.spread),
            forward,
            lateral,
            yaw,
            [slow.as_str(), mixed]
                .iter()
                .filter(|it| !it.is_empty())
                .copied()
                .collect::<Vec<_>>()
                .join(", ")
        ]
    }));
    table(&rows)
}

fn index_text(index: Option<f64>, spread: Option<f64>) -> String {
    let spread = spread.map_or_else(String::new, |spread| format!(" \u{b1} {spread:.2}"));
    index.map_or_else(|| "-".to_owned(), |index| format!("{index:.2}{spread}"))
}

/// The robot's selection beside table IV.
fn beside(report: &Report) -> String {
    let mut rows = vec![headings("table IV||paper|P there|rank|rank, heading|best|best, heading")];
    let place = |rank: Option<usize>| rank.map_or_else(|| "-".to_owned(), |rank| rank.to_string());
    let pair = |pair: Option<(f64, f64)>| {
        pair.map_or_else(|| "none".to_owned(), |(f, theta)| format!("({f}, {theta})"))
    };
    rows.extend(report.table4.iter().map(|it| {
        row![
            it.mode,
            it.letter,
            pair(Some(it.paper)),
            index_text(it.p, it.p_spread),
            place(it.rank),
            place(it.rank_literal),
            pair(it.best),
            pair(it.best_literal)
        ]
    }));
    format!(
        "{}\nrank among the pairs of its kind that are faster than {} m/s in their own component; heading: that advance \
         as fast, by the paper's word\n",
        table(&rows),
        report.least_m_s
    )
}

fn claims_text(model: &str, seeds: usize, claims: &[Claim]) -> String {
    let mut rows = vec![headings("claim|from|to||chance")];
    for claim in claims {
        let mark = if claim.contradicts_itself { "*" } else { "" };
        for (place, it) in claim.statements.iter().enumerate() {
            let [before, after] = it.values.map(|Spread { mean, spread }| {
                let spread =
                    spread.map_or_else(String::new, |spread| format!(" \u{b1} {spread:.3}"));
                format!("{mean:+.3}{spread}")
            });
            let chance = format!("{:.0} %", 100.0 * claim.chance);
            let (and, chance) = if place == 0 { ("", chance) } else { ("and ", String::new()) };
            rows.push(row![
                format!("{and}{}", it.claim),
                before,
                after,
                format!("{}{mark}", it.verdict),
                chance
            ]);
        }
    }
    let judged = summed(claims);
    let few = if seeds < ENOUGH_SEEDS {
        format!(
            "\n{seeds} walks a cell are few to judge by: --seeds {ENOUGH_SEEDS}, without --quick\n"
        )
    } else {
        String::new()
    };
    let line = |it: &Counts| {
        format!(
            "{} hold, {} fail, {} are unclear; by chance {:.1} would hold",
            it.hold, it.fail, it.unclear, it.chance
        )
    };
    format!(
        "What the paper's section III-B says, and what model {model} does (left is positive; \u{b1} between {seeds} seeds):\n\n\
         {}\n{} independent claims, a mirrored pair counted once: {}\n\
         * {} where the paper's word and sign contradict each other, by the word: {}\n\
         unclear: the 95 % interval of the difference (Student's t) holds zero; chance: the share of all pairs for which \
         the same holds\n{few}",
        table(&rows),
        judged.counts.independent,
        line(&judged.counts),
        judged.contradictory.independent,
        line(&judged.contradictory)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_study::statements::Statement;

    fn claim(walks: &[f64], contradicts_itself: bool) -> Claim {
        let values = [Spread::of(walks); 2];
        let statement =
            Statement { claim: "a load turns it".to_owned(), values, verdict: Verdict::Unclear };
        Claim {
            statements: vec![statement.clone(), statement],
            verdict: Verdict::Unclear,
            contradicts_itself,
            chance: 0.25,
        }
    }

    #[test]
    fn statements_from_one_walk_a_cell_claim_no_spread() {
        let one = claims_text("W", 1, &[claim(&[0.01], false)]);
        assert!(!one.contains("+0.010 \u{b1}") && one.contains("1 walks a cell are few"), "{one}");
        let eight = claims_text("W", 8, &[claim(&[0.01, 0.03], false)]);
        assert!(eight.contains("\u{b1} 0.014") && !eight.contains("few"), "{eight}");
    }

    #[test]
    fn without_a_claim_chance_gives_none() {
        let text = claims_text("W", 8, &[]);
        assert!(text.contains("0 independent") && !text.contains("-0.0"), "{text}");
    }

    #[test]
    fn mirrored_sentences_are_counted_once_with_chance_beside_them() {
        let text = claims_text("W", 8, &[claim(&[0.01, 0.03], false), claim(&[0.0, 0.1], true)]);
        assert!(text.contains("1 independent claims") && text.contains("chance 0.2"), "{text}");
        assert!(text.contains("and a load turns it") && text.contains("unclear*"), "{text}");
    }
}
