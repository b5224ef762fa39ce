//! `flix-sim demo`: the paper's modes and a reversal on a bench, then a figure eight with the whole robot.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use flix_host::link::RobotLink;
use flix_host::teleop::paper_modes::PaperMode;
use flix_plot::{Chart, Figure, Panel, Series, Stroke, Written, colour};
use flix_protocol::message::Setpoint;
use flix_shell::number::whole;
use indicatif::ProgressBar;

use super::error::Error;
use super::output::{headings, mark, print, progress, row, table};
use super::track;
use flix_sim::experiment::metrics::{Hold, HoldMeter, StepMeter, line_error};
use flix_sim::plant::Plant;
use flix_sim::reliability::accuracy::{
    ACROSS_LIMIT, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, FREQUENCY_LIMIT_HZ, SETTLE_LIMIT_S,
    STEP_BAND,
};
use flix_sim::rig::bench::{Base, bench, setpoint};
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::Truth;

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

/// Returns the scenes by name, with their pairs: the paper's modes (Table IV), then the last one with its frequency reversed.
fn scenes() -> impl Iterator<Item = (&'static str, (f64, f64))> {
    let (f, theta) = PaperMode::StrafeRight.pair();
    PaperMode::ALL
        .map(|mode| (mode.name(), mode.pair()))
        .into_iter()
        .chain([("reversal", (-f, theta))])
}

/// Time from a command until its scene is measured.
const SETTLING: Duration = Duration::from_millis(700);
/// Time for which a scene is measured.
const MEASURING: Duration = Duration::from_millis(800);

/// Largest path error on the figure eight, root mean square: less than a fifth of the robot's length.
const PATH_ERROR_LIMIT_MM: f64 = 40.0;

/// What became of a scene.
struct Shown {
    name: &'static str,
    setpoint: Setpoint,
    began_s: f64,
    settled_s: Option<f64>,
    figures: Hold,
    peak_current: f64,
}

impl Shown {
    fn passes(&self, current_limit: f64) -> bool {
        self.settled_s.is_some_and(|settled| settled <= SETTLE_LIMIT_S)
            && self.figures.frequency_rms_hz <= FREQUENCY_LIMIT_HZ
            && self.figures.direction_rms_deg <= DIRECTION_LIMIT_DEG
            && self.figures.force_error_deg.abs() <= FORCE_LIMIT_DEG
            && self.figures.across_axis <= ACROSS_LIMIT
            && self.peak_current <= current_limit
    }
}

/// Runs the command.
///
/// # Errors
/// When the robot could not be brought to run, or the pictures not written.
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
    let mut operation = bench(Base::Free, args.seed)?;
    let bar = progress(scenes().count() as u64 + 1, "shaking");
    operation.wait_until_connected()?;
    let current_limit = operation.setting("current_limit")?;
    operation.arm()?;
    bar.inc(1);
    let mut recorder = Recorder::default();
    let shown = show_scenes(&mut operation, &mut recorder, &bar)?;
    bar.finish_and_clear();
    let written = draw(&recorder, &shown, current_limit, args)?;
    print(&text(&shown, current_limit))?;
    print(&format!("plot {}\n", written.png.display()))?;
    Ok(shown.iter().all(|scene| scene.passes(current_limit)))
}

fn show_scenes(
    operation: &mut Operation<Plant>,
    recorder: &mut Recorder,
    bar: &ProgressBar,
) -> Result<Vec<Shown>, Error> {
    scenes()
        .map(|(name, (frequency, direction))| {
            let setpoint = setpoint(frequency, direction)?;
            let began_s = operation.now().as_micros() as f64 * 1e-6;
            let mut step = StepMeter::new(setpoint, STEP_BAND);
            let mut hold = HoldMeter::new(setpoint);
            operation.want(setpoint);
            operation.run(SETTLING, |truth| {
                step.watch(truth);
                recorder.watch(truth, setpoint);
            })?;
            operation.run(MEASURING, |truth| {
                step.watch(truth);
                hold.watch(truth);
                recorder.watch(truth, setpoint);
            })?;
            bar.inc(1);
            Ok(Shown {
                name,
                setpoint,
                began_s,
                settled_s: step.settled_after(),
                figures: hold.figures(),
                peak_current: step.peak_current(),
            })
        })
        .collect()
}

fn text(shown: &[Shown], current_limit: f64) -> String {
    let mut rows = vec![headings(
        "walking mode|f (Hz)|theta (deg)|f rms (Hz)|theta rms (deg)|force error (deg)|across (%)|settled (s)|current (A)",
    )];
    rows.extend(shown.iter().map(|scene| {
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
            mark(scene.passes(current_limit)),
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

/// Gathers what is drawn: one [`Row`] for each [`ROW`].
#[derive(Default)]
struct Recorder {
    rows: Vec<Row>,
    gathering: Gathering,
}

/// Time that a drawn point stands for.
const ROW: Duration = Duration::from_millis(5);
/// Rows in a turn at 30 Hz: over it the force is one line, and the yielding body's ripple averages out.
const ROWS_OF_A_TURN: usize = 7;

/// Means and extremes over [`ROW`].
#[derive(Clone, Copy, Default)]
struct Row {
    time: f64,
    commanded: (f64, f64),
    frequency: f64,
    direction: f64,
    torque_current: [f64; 2],
    largest_current: [f64; 2],
    force: [f64; 3],
}

#[derive(Default)]
struct Gathering {
    row: Row,
    ticks: u32,
    phase: Option<(f64, f64)>,
}

impl Recorder {
    fn watch(&mut self, truth: &Truth, setpoint: Setpoint) {
        let time = truth.time.as_micros() as f64 * 1e-6;
        let gathering = &mut self.gathering;
        let (began, phase) = *gathering.phase.get_or_insert((time, truth.phase));
        let row = &mut gathering.row;
        gathering.ticks += 1;
        for motor in 0..2 {
            row.torque_current[motor] += truth.rotor_frame_currents[motor][1];
            let largest = truth.phase_currents[motor].iter().fold(0.0, |m: f64, i| m.max(i.abs()));
            row.largest_current[motor] = row.largest_current[motor].max(largest);
        }
        let [forward, left, _] = truth.shaker_force;
        row.force[0] += forward * forward;
        row.force[1] -= forward * left;
        row.force[2] += left * left;
        if time - began < ROW.as_secs_f64() {
            return;
        }
        row.time = time;
        row.commanded =
            (f64::from(setpoint.frequency().get()), f64::from(setpoint.direction().get()));
        row.frequency = (truth.phase - phase) / (time - began) / core::f64::consts::TAU;
        row.direction = truth.direction;
        row.torque_current = row.torque_current.map(|sum| sum / f64::from(gathering.ticks));
        self.rows.push(*row);
        self.gathering = Gathering { phase: Some((time, truth.phase)), ..Gathering::default() };
    }

    /// Points of something that each row has.
    fn points(&self, of: impl Fn(&Row) -> f64) -> Vec<(f64, f64)> {
        self.rows.iter().map(|row| (row.time, of(row))).collect()
    }

    /// Mean over a turn of the current that makes torque, A.
    fn torque_currents(&self, motor: usize) -> Vec<(f64, f64)> {
        self.rows
            .windows(ROWS_OF_A_TURN)
            .map(|rows| {
                let sum: f64 = rows.iter().map(|row| row.torque_current[motor]).sum();
                (rows[ROWS_OF_A_TURN / 2].time, sum / ROWS_OF_A_TURN as f64)
            })
            .collect()
    }

    /// Principal axis of the force over a turn, degrees to the right of forward, near the command.
    fn lines_of_force(&self) -> Vec<(f64, f64)> {
        self.rows
            .windows(ROWS_OF_A_TURN)
            .map(|rows| {
                let sum = |part: usize| rows.iter().map(|row| row.force[part]).sum::<f64>();
                let axis = 0.5 * (2.0 * sum(1)).atan2(sum(0) - sum(2));
                let middle = rows[ROWS_OF_A_TURN / 2];
                (middle.time, near(axis, middle.commanded.1))
            })
            .collect()
    }
}

/// A direction of a line, in degrees within a quarter turn of the commanded one.
fn near(direction: f64, commanded_deg: f64) -> f64 {
    commanded_deg + line_error(direction, commanded_deg.to_radians()).to_degrees()
}

fn draw(
    recorder: &Recorder,
    shown: &[Shown],
    current_limit: f64,
    args: &Args,
) -> Result<Written, Error> {
    let end = recorder.rows.last().map_or(0.0, |row| row.time);
    let with_scenes = |mut panel: Panel| {
        for (index, scene) in shown.iter().enumerate() {
            let until = shown.get(index + 1).map_or(end, |next| next.began_s);
            let shade = if index % 2 == 0 { colour::BLUE } else { colour::MUTED };
            panel = panel.span(scene.began_s, until, scene.name, shade);
        }
        panel
    };
    let commanded = |of: fn(&Row) -> f64| {
        Series::line("commanded", recorder.points(of)).colour(colour::MUTED).stroke(Stroke::Dashed)
    };
    let frequency = with_scenes(Panel::new("f (Hz)").range(-48.0, 48.0))
        .series(commanded(|row| row.commanded.0))
        .series(Series::line("held", recorder.points(|row| row.frequency)).colour(colour::BLUE));
    let direction = Panel::new("theta (degrees, right positive)")
        .degrees()
        .series(commanded(|row| row.commanded.1))
        .series(
            Series::line("held", recorder.points(|row| near(row.direction, row.commanded.1)))
                .colour(colour::BLUE),
        )
        .series(Series::line("line of force", recorder.lines_of_force()).colour(colour::ORANGE));
    let error = Panel::new("theta error (degrees)")
        .range(-6.0, 6.0)
        .rule(DIRECTION_LIMIT_DEG, "rms limit")
        .rule(-DIRECTION_LIMIT_DEG, "")
        .series(
            Series::line(
                "",
                recorder.points(|row| near(row.direction, row.commanded.1) - row.commanded.1),
            )
            .colour(colour::BLUE),
        );
    let torque = Panel::new("torque current i_q, mean over a turn (A)")
        .series(Series::line("top", recorder.torque_currents(0)))
        .series(Series::line("bottom", recorder.torque_currents(1)));
    let current = Panel::new("largest phase current (A)")
        .range(0.0, 1.1 * current_limit)
        .rule(current_limit, "limit")
        .series(Series::line("top", recorder.points(|row| row.largest_current[0])))
        .series(Series::line("bottom", recorder.points(|row| row.largest_current[1])));
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
