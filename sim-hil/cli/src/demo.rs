//! `flix-sim demo`: the paper's modes and a reversal on a bench, then a figure eight with the whole robot.

use std::path::PathBuf;
use std::process::ExitCode;

use flix_plot::{Chart, Figure, Panel, Series, Stroke, Written, colour};
use flix_shell::number::whole;

use super::error::Error;
use super::output::{headings, mark, print, progress, row, table};
use super::track;
use flix_sim::reliability::accuracy::{
    ACROSS_LIMIT, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, FREQUENCY_LIMIT_HZ, SETTLE_LIMIT_S,
};
use flix_sim::reliability::demonstration::{Demonstration, ROW, Row, near, scenes};

/// Shake through the paper's five walking modes and a reversal, then walk a figure eight: figures, plot, replay
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:\n  flix-sim demo\n  flix-sim demo --seed 7 --out /tmp/flix")]
pub struct Args {
    /// Seed of the robot: its motors, wiring, sensor errors and noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Folder for pictures, replay and record.
    #[arg(long, default_value = "out")]
    out: PathBuf,
}

impl Default for Args {
    fn default() -> Self {
        Self { seed: 1, out: PathBuf::from("out") }
    }
}

/// Largest path error on the figure eight, root mean square: less than a fifth of the robot's length.
const PATH_ERROR_LIMIT_MM: f64 = 40.0;

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    print("The shaker on a sliding body holds f and theta:\n\n")?;
    let holds = shake(args)?;
    print("\nThe whole robot walks, over a link that is 20 ms late and loses 5 %:\n\n")?;
    let report = track::follow(&track::Args::of("figure8", args.seed, &args.out))?;
    print(&report.to_text())?;
    let follows = report.finished && report.path_error_rms_mm <= PATH_ERROR_LIMIT_MM;
    Ok(if holds && follows { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Shows all scenes; whether all are within their limits.
fn shake(args: &Args) -> Result<bool, Error> {
    let bar = progress(scenes().len() as u64 + 1, "shaking");
    let shown = Demonstration::of(args.seed, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let written = draw(&shown, args)?;
    print(&text(&shown))?;
    print(&format!("plot {}\n", written.png.display()))?;
    Ok(shown.passes())
}

fn text(Demonstration { scenes, current_limit, .. }: &Demonstration) -> String {
    let mut rows = vec![headings(
        "walking mode|f (Hz)|theta (deg)|f rms (Hz)|theta rms (deg)|force error (deg)|across (%)|settled (s)|current (A)",
    )];
    rows.extend(scenes.iter().map(|scene| {
        let (f, theta) = (scene.setpoint.frequency().get(), scene.setpoint.direction().get());
        let figures = &scene.figures;
        row![
            scene.name,
            f,
            theta,
            format!("{:.3}", figures.frequency_rms_hz),
            format!("{:.2}", figures.direction_rms_deg),
            format!("{:.2}", figures.force_error_deg),
            format!("{:.1}", 100.0 * figures.across_axis),
            scene.settled_s.map_or_else(|| "never".to_owned(), |s| format!("{s:.2}")),
            format!("{:.2}", scene.peak_current),
            mark(scene.passes(*current_limit)),
        ]
    }));
    rows.push(row![
        "limit",
        "",
        "",
        format!("{FREQUENCY_LIMIT_HZ:.3}"),
        format!("{DIRECTION_LIMIT_DEG:.2}"),
        format!("+-{FORCE_LIMIT_DEG:.0}"),
        format!("{:.1}", 100.0 * ACROSS_LIMIT),
        format!("{SETTLE_LIMIT_S:.2}"),
        format!("{current_limit:.2}"),
    ]);
    table(&rows) + "\n"
}

fn draw(shown: &Demonstration, args: &Args) -> Result<Written, Error> {
    let (scenes, current_limit) = (&shown.scenes, shown.current_limit);
    let end = shown.rows.last().map_or(0.0, |row| row.time);
    let with_scenes = |mut panel: Panel| {
        for (index, scene) in scenes.iter().enumerate() {
            let until = scenes.get(index + 1).map_or(end, |next| next.began_s);
            let shade = if index % 2 == 0 { colour::BLUE } else { colour::MUTED };
            panel = panel.span(scene.began_s, until, scene.name, shade);
        }
        panel
    };
    let commanded = |of: fn(&Row) -> f64| {
        Series::line("commanded", shown.points(of)).colour(colour::MUTED).stroke(Stroke::Dashed)
    };
    let frequency = with_scenes(Panel::new("f (Hz)").range(-48.0, 48.0))
        .series(commanded(|row| row.commanded.0))
        .series(Series::line("held", shown.points(|row| row.frequency)).colour(colour::BLUE));
    let direction = Panel::new("theta (degrees, right positive)")
        .degrees()
        .series(commanded(|row| row.commanded.1))
        .series(
            Series::line("held", shown.points(|row| near(row.direction, row.commanded.1)))
                .colour(colour::BLUE),
        )
        .series(Series::line("line of force", shown.lines_of_force()).colour(colour::ORANGE));
    let error = Panel::new("theta error (degrees)")
        .range(-6.0, 6.0)
        .rule(DIRECTION_LIMIT_DEG, "rms limit")
        .rule(-DIRECTION_LIMIT_DEG, "")
        .series(
            Series::line(
                "",
                shown.points(|row| near(row.direction, row.commanded.1) - row.commanded.1),
            )
            .colour(colour::BLUE),
        );
    let torque = Panel::new("torque current i_q, mean over a turn (A)")
        .series(Series::line("top", shown.torque_currents(0)))
        .series(Series::line("bottom", shown.torque_currents(1)));
    let current = Panel::new("largest phase current (A)")
        .range(0.0, 1.1 * current_limit)
        .rule(current_limit, "limit")
        .series(Series::line("top", shown.points(|row| row.largest_current[0])))
        .series(Series::line("bottom", shown.points(|row| row.largest_current[1])));
    let chart = Chart::new("Five walking modes and a reversal", "Time since power-up (s)")
        .subtitle(format!(
            "Robot of seed {} on a sliding 350 g body: the plant's truth, means over {} ms",
            args.seed,
            ROW.as_millis()
        ))
        .panel(frequency)
        .panel(direction)
        .panel(error)
        .panel(torque)
        .panel(current);
    Ok(chart.write(&args.out, "demo")?)
}
