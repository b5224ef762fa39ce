//! `flix-sim study leg`: stiffness and damping of one leg from release tests.

use flix_shell::number::{whole, within};
use std::path::PathBuf;
use std::process::ExitCode;

use flix_plot::{Chart, Figure, Panel, Series, Stroke, colour};
use serde::Serialize;

use crate::arguments::{ModelArgs, parse_leg};
use crate::error::Error;
use crate::output::{print, print_figures, progress, row, table};
use flix_sim::experiment::probe::Gravity;
use flix_study::leg::{
    GENERATIONS, Identified, NAMES, Rig, Sample, Setup, Stiffness, add_noise, identify, read,
    to_csv,
};
use flix_study::write_whole;

/// Identify {k_bend, k_twist, b_bend, b_twist} of a leg from release tests at -60, 0 and 60 degrees
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without --measured the tests are simulated with the model's own values and noise, so that what is found can be compared with the truth. A laboratory's tests are a CSV with the columns load_deg,t_s,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg: the tip from its unloaded rest, from the release on, in body axes. At 0 degrees the load pulls along body x, which is down with --gravity across. What the paper leaves open is an option: load, attachment, rate, repeats. A load on the axis (--lever-mm 0) hardly twists the beam.\n\nExamples:\n  flix-sim study leg\n  flix-sim study leg --noise-mm 0.2 --noise-deg 1 --seed 7 --json\n  flix-sim study leg --measured tests.csv --load-g 200 --lever-mm 0\n  flix-sim study leg --gravity along --load-g 510 --lever-mm 40 --foot --rate 1000 --repeats 4    # pulled level, by a lever, on the robot's own leg"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Leg: fl, fr, rl or rr
    #[arg(long, default_value = "fl", value_parser = parse_leg)]
    leg: usize,
    /// Release tests of a laboratory
    #[arg(long, value_name = "CSV")]
    measured: Option<PathBuf>,
    /// Load whose weight pulls at the distal end before the release, g
    #[arg(long, value_name = "G", default_value_t = 1e3 * Setup::PAPER.load_kg, value_parser = within(1.0..=5000.0, "load", " g"))]
    load_g: f64,
    /// Where the load is attached: distance from the beam's axis, to the left seen along the pull, mm
    #[arg(long, value_name = "MM", default_value_t = 1e3 * Setup::PAPER.lever_m, value_parser = within(-100.0..=100.0, "lever", " mm"), allow_hyphen_values = true)]
    lever_mm: f64,
    /// How the beam is clamped: level, or hanging down
    #[arg(long, value_enum, default_value_t = Setup::PAPER.gravity)]
    gravity: Gravity,
    /// Leave the foot on
    #[arg(long)]
    foot: bool,
    /// Pictures a second of the simulated tests
    #[arg(long, value_name = "HZ", default_value_t = Setup::PAPER.rate_hz, value_parser = within(50.0..=10_000.0, "rate", " Hz"))]
    rate: f64,
    /// Releases at each angle of the simulated tests
    #[arg(long, value_name = "N", default_value_t = Setup::PAPER.repeats as u64, value_parser = whole::<u64>(1..=1000))]
    repeats: u64,
    /// Noise of the simulated tests, mm
    #[arg(long, value_name = "MM", default_value_t = 0.1, value_parser = within(0.0..=10.0, "noise", ""))]
    noise_mm: f64,
    /// Noise of the simulated tests, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.3, value_parser = within(0.0..=10.0, "noise", ""))]
    noise_deg: f64,
    /// Seed of the noise and of the search
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Folder for the tests and the figure
    #[arg(long, value_name = "DIR", default_value = "out/study/leg")]
    out: PathBuf,
    /// Print JSON only; draw no figure
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    found: Identified,
    /// What the simulated tests were made with.
    truth: Option<Stiffness>,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let setup = Setup {
        gravity: args.gravity,
        load_kg: 1e-3 * args.load_g,
        lever_m: 1e-3 * args.lever_mm,
        foot: args.foot,
        rate_hz: args.rate,
        repeats: args.repeats as usize,
    };
    let rig = Rig::new(&args.model.load()?, args.leg, setup)?;
    let (tests, truth) = match &args.measured {
        Some(path) => (read(path)?, None),
        None => {
            let truth = rig.own();
            let mut tests = match truth {
                Some(values) => rig.simulate(values, &setup.moments())?,
                None => Vec::new(),
            };
            add_noise(&mut tests, args.noise_mm, args.noise_deg, args.seed);
            (tests, truth)
        }
    };
    let bar = progress(GENERATIONS, "identifying");
    let found = identify(&rig, &tests, args.seed, |generation| bar.set_position(generation))?;
    bar.finish_and_clear();
    let report = Report { found, truth };
    if args.json {
        return print_figures(&report, true, true, String::new);
    }
    print(&text(&report))?;
    let path = args.out.join("tests.csv");
    write_whole(&path, to_csv(&tests).as_bytes()).map_err(Error::write(&path))?;
    let fit = rig.simulate(found.values, &tests)?;
    let figure = figure(&tests, &fit, &report).write(&args.out, "leg")?;
    print(&format!("\ntests   {}\nfigure  {}\n", path.display(), figure.png.display()))?;
    Ok(ExitCode::SUCCESS)
}

fn text(report: &Report) -> String {
    let mut rows = vec![row!["", "found", "+- (%)", "truth", "off (%)", ""]];
    for i in 0..4 {
        let value = report.found.values[i];
        let (truth, off) = report.truth.map_or_else(Default::default, |truth| {
            (format!("{:.5}", truth[i]), format!("{:.2}", 100.0 * (value / truth[i] - 1.0)))
        });
        rows.push(row![
            NAMES[i],
            format!("{value:.5}"),
            format!("{:.2}", 100.0 * report.found.uncertainty[i]),
            truth,
            off,
            if i < 2 { "N m/rad" } else { "N m s/rad" }
        ]);
    }
    format!(
        "{}\ndeviation {:.3} mm, {:.3} degrees a coordinate (rms)\n",
        table(&rows),
        report.found.rmse_mm,
        report.found.rmse_deg
    )
}

/// Figure 3a: end-point position and rotation, measured and fitted.
fn figure(tests: &[Sample], fit: &[Sample], report: &Report) -> Chart {
    let [k_bend, k_twist, b_bend, b_twist] = report.found.values;
    let chart = Chart::new("Release of a twisted beam: dots measured, lines fitted", "time (ms)")
        .subtitle(format!(
            "k_bend {k_bend:.4}, k_twist {k_twist:.4} N m/rad, b_bend {b_bend:.5}, b_twist {b_twist:.5} N m s/rad"
        ));
    type Coordinate = fn(&Sample) -> f64;
    let coordinates: [(&str, Coordinate); 6] = [
        ("x (mm)", |s| 1e3 * s.tip.position[0]),
        ("y (mm)", |s| 1e3 * s.tip.position[1]),
        ("z (mm)", |s| 1e3 * s.tip.position[2]),
        ("rotation about x (\u{b0})", |s| s.tip.rotation[0].to_degrees()),
        ("rotation about y (\u{b0})", |s| s.tip.rotation[1].to_degrees()),
        ("rotation about z (\u{b0})", |s| s.tip.rotation[2].to_degrees()),
    ];
    coordinates.into_iter().fold(chart, |chart, (label, of)| {
        let mut panel = Panel::new(label).height(105.0);
        for (samples, stroke) in [(tests, Stroke::Dots), (fit, Stroke::Solid)] {
            let by_load = samples.chunk_by(|a, b| a.load_deg == b.load_deg);
            for (test, shade) in by_load.zip(colour::CYCLE.into_iter().cycle()) {
                // One entry a load in the legend.
                let name = match stroke {
                    Stroke::Solid => format!("{}\u{b0}", test[0].load_deg),
                    _ => String::new(),
                };
                let points = test.iter().map(|sample| (1e3 * sample.t, of(sample)));
                panel = panel
                    .series(Series::line(name, points).stroke(stroke).colour(shade).width(1.2));
            }
        }
        chart.panel(panel)
    })
}
