//! `flix-sim walk`: shake the whole robot at one f and theta and see where it goes.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use flix_host::nav::{PlanarPose, Position};
use flix_host::system::text::fixed;
use flix_plot::{Figure, Outline, Series, Track, colour};
use flix_shell::number::{whole, within};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::arguments::{ModelArgs, SetpointArgs, parse_step, parse_time};
use super::error::Error;
use super::output::{complain, print, print_figures, progress, row, table};
use flix_sim::experiment::walk::{Shaking, Spread, Walk, WalkDrive, Walked, walk};
use flix_sim::model::RobotModel;
use flix_sim::plant::electronics::TICK;
use flix_sim::view::Film;

/// Shortest time between two frames, s: some 16 frames a turn at 30 Hz.
const FRAME_INTERVAL: f64 = 2e-3;
/// Outlines of the robot on the track.
const OUTLINES: usize = 6;

/// Walk at one f and theta: mean speeds over several seeds, a picture of the track, a replay
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim walk --frequency -30 --direction 30\n  flix-sim walk --frequency 30 --direction 90 --seconds 20 --seeds 16 --drive ideal\n  flix-sim walk --frequency -30 --direction 30 --heading 45\n  flix-sim walk --frequency -100 --direction 0 --model flix --drive ideal --step 0.05ms\n  flix-sim walk --frequency 35 --direction 0 --model my-robot.toml --json"
)]
pub struct Args {
    #[command(flatten)]
    setpoint: SetpointArgs,
    /// Time of a walk
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = parse_time)]
    seconds: Duration,
    /// Number of walks, each with its start disturbed by up to 1 mm
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = whole::<u64>(1..=100_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Heading at the start of every walk, degrees to the left [default: each seed its own]
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, value_parser = within(-360.0..=360.0, "heading", " degrees"))]
    heading: Option<f64>,
    #[command(flatten)]
    model: ModelArgs,
    /// What turns the rotors; the ideal drive takes -120 to 120 Hz
    #[arg(long, value_enum, default_value_t = WalkDrive::Firmware)]
    drive: WalkDrive,
    /// Step; under the firmware's drive at most its own tick of 0.1 ms
    #[arg(long, value_name = "TIME", default_value = "0.1ms", value_parser = parse_step)]
    step: Duration,
    /// Folder for the picture and the replay
    #[arg(long, value_name = "DIR", default_value = "out/walk")]
    out: PathBuf,
    /// Print JSON only; draw no picture, write no replay
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    model: String,
    frequency_hz: f32,
    direction_deg: f32,
    seconds: f64,
    seeds: u64,
    first_seed: u64,
    /// None: each seed its own.
    heading_deg: Option<f64>,
    forward_m_s: Spread,
    lateral_m_s: Spread,
    yaw_rad_s: Spread,
    energy_j: Spread,
    path_m: Spread,
    cost_of_transport: Spread,
    /// Walks that ended on the side or the back.
    fallen: usize,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let shaking = match args.drive {
        WalkDrive::Firmware => args.setpoint.check()?.into(),
        WalkDrive::Ideal => {
            Shaking::new(args.setpoint.frequency.into(), args.setpoint.direction.into())
                .map_err(Error::usage)?
        }
    };
    let what = Walk {
        shaking,
        seconds: args.seconds.as_secs_f64(),
        drive: args.drive,
        step: args.step.as_secs_f64(),
        heading: args.heading.map(f64::to_radians),
    };
    if what.drive == WalkDrive::Firmware && what.step > TICK {
        return Err(Error::usage(format!(
            "--step {:?}: the firmware ticks every 0.1ms; take at most that, or --drive ideal",
            args.step
        )));
    }
    let caption = format!("{} s, seed {}", what.seconds, args.first_seed);
    let bar = progress(args.seeds, "walking");
    let seeds: Vec<u64> =
        (0..args.seeds).map(|index| args.first_seed.wrapping_add(index)).collect();
    let walked: Vec<(Walked, Option<Film>)> = seeds
        .into_par_iter()
        .map(|seed| {
            let mut film =
                (seed == args.first_seed && !args.json).then(|| Film::new(&model, FRAME_INTERVAL));
            let walked = walk(&model, &what, seed, |plant| {
                if let Some(film) = &mut film {
                    film.caption(plant, &caption);
                    film.shoot(plant);
                }
            })?;
            bar.inc(1);
            Ok((walked, film))
        })
        .collect::<Result<_, flix_sim::experiment::walk::WalkError>>()?;
    bar.finish_and_clear();

    let spread = |of: fn(&Walked) -> f64| {
        Spread::of(&walked.iter().map(|(walked, _)| of(walked)).collect::<Vec<_>>())
    };
    let report = Report {
        model: model.name.clone(),
        frequency_hz: args.setpoint.frequency,
        direction_deg: args.setpoint.direction,
        seconds: what.seconds,
        seeds: args.seeds,
        first_seed: args.first_seed,
        heading_deg: args.heading,
        forward_m_s: spread(|w| w.forward_m_s),
        lateral_m_s: spread(|w| w.lateral_m_s),
        yaw_rad_s: spread(|w| w.yaw_rad_s),
        energy_j: spread(|w| w.energy_j),
        path_m: spread(|w| w.path_m),
        cost_of_transport: spread(|w| w.cost_of_transport),
        fallen: walked.iter().filter(|(walked, _)| !walked.upright).count(),
    };
    if report.fallen > 0 {
        complain(format_args!(
            "{} of {} walks ended on the side or the back: their speeds are no walk's",
            report.fallen, report.seeds
        ));
    }
    if !args.json {
        print(&text(&report))?;
        for film in walked.into_iter().filter_map(|(_, film)| film) {
            write(film, &model, args)?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    print_figures(&report, true, true, String::new)
}

fn text(report: &Report) -> String {
    let row = |name: &str, value: &Spread, unit: &str| {
        let spread = value.spread.map(|spread| format!("\u{b1} {spread:.4}"));
        row![name, fixed(value.mean, 4), spread.unwrap_or_default(), unit]
    };
    format!(
        "Model {} at {} Hz, {} degrees: {} of {} s (seeds from {})\n\n{}",
        report.model,
        report.frequency_hz,
        report.direction_deg,
        if report.seeds == 1 { "1 walk".to_owned() } else { format!("{} walks", report.seeds) },
        report.seconds,
        report.first_seed,
        table(&[
            row!["", "mean", if report.seeds > 1 { "between seeds" } else { "" }],
            row("forward", &report.forward_m_s, "m/s"),
            row("lateral (left +)", &report.lateral_m_s, "m/s"),
            row("yaw rate (left +)", &report.yaw_rad_s, "rad/s"),
            row("energy", &report.energy_j, "J"),
            row("path", &report.path_m, "m"),
            row("cost of transport", &report.cost_of_transport, ""),
        ])
    )
}

/// Writes what is to be seen of the first walk.
fn write(film: Film, model: &RobotModel, args: &Args) -> Result<(), Error> {
    let title = format!(
        "Model {} at {} Hz, {}\u{b0}",
        model.name, args.setpoint.frequency, args.setpoint.direction
    );
    let track: Vec<_> = film.track().collect();
    let line = Series::line("middle of the body", track.iter().map(PlanarPose::position));
    let mut map = Track::new(title.clone(), "m")
        .subtitle(format!(
            "seed {}, {} s, seen from above",
            args.first_seed,
            args.seconds.as_secs_f64()
        ))
        .series(line.colour(colour::BLUE));
    for index in 0..OUTLINES {
        let last = track.len().saturating_sub(1);
        if let Some(pose) = track.get(index * last / (OUTLINES - 1)) {
            map = map.outline(outline(model, *pose));
        }
    }
    let picture = map.write(&args.out, "track")?;
    let page = film.into_recording(title).write(&args.out.join("replay.html"))?;
    print(&format!("\ntrack   {}\nreplay  {}\n", picture.png.display(), page.display()))?;
    Ok(())
}

/// The plate seen from above.
fn outline(model: &RobotModel, pose: PlanarPose) -> Outline {
    let (length, width) = (0.5e-3 * model.plate.length_mm, 0.5e-3 * model.plate.width_mm);
    // A nose shows which way is forward.
    let corners = [(-1.0, -1.0), (0.8, -1.0), (1.0, 0.0), (0.8, 1.0), (-1.0, 1.0)];
    Outline {
        corners: corners
            .into_iter()
            .map(|(u, v)| pose.place(Position::new(u * length, v * width)))
            .collect(),
        colour: colour::GREY,
        filling: 0.12,
    }
}
