//! `flix scope`: captures inner values of the fast loop.

mod screen;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

use flix_protocol::message::{
    SCOPE_RATE_HZ, ScopeCommand, ScopePlan, ScopeState, ScopeStatus, Setpoint, State, Trigger,
};
use flix_protocol::session::ConnectError;
use flix_protocol::units::{Degrees, Hertz, Instant};
use indicatif::ProgressBar;
use ratatui::Frame;
use serde::Serialize;

use super::address::RobotArgs;
use super::drive::{direction, frequency, give_up, stop};
use crate::teleop::terminal::{Screen, UNSEEN, is_closed};
use flix_host::link::udp::Connection;
use flix_host::link::{Client, LinkError, RobotLink, Update, is_reached};
use flix_host::record::dated;
use flix_host::scope::{self, Capture, Extent, channels, files, trigger};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::fixed;
use flix_host::teleop::action::Action;
use flix_plot::Figure as _;
use flix_shell::outlet::drawn;
use flix_shell::output::{headings, path_as_text, print, print_json, table, waiting};
use flix_shell::time::positive_duration;
use flix_shell::{Error, Exit};

/// Interval of looks at a capture that is under way.
const LOOK: Duration = Duration::from_millis(20);
/// Time for which a robot that is driven may take to hold f and theta before it is captured all the same.
const SETTLING: Duration = Duration::from_secs(3);
/// Folder of the files.
const FOLDER: &str = "scope";

/// Capture inner values of the robot's fast loop, 10,000 rows a second.
///
/// Up to 8 channels go into the robot's memory: 240 ms of eight, 1.92 s of one. Without a plan of yours the robot
/// always watches for faults; --last fetches the 200 ms before the last one. With --frequency and --direction the
/// robot is armed, driven meanwhile, and disarmed. Ctrl-C stops a robot that is driven.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Channels, of each motor (iq is both, top_iq one):
  id iq iq_wanted   currents, d and q (torque), A       vd vq   voltages, V
  ia ib             phase currents as measured, A       angle   deg
  speed             Hz
and of the robot: f f_wanted (Hz), theta theta_error (deg), bus (V)

Examples:
  flix scope walker-3f2c --channels \"ia,ib,angle\"
  flix scope walker-3f2c --channels \"id,iq,theta\" --frequency -30 --direction 30
  flix scope walker-3f2c --trigger \"f>15\" --frequency 30 --direction 90
  flix scope walker-3f2c --trigger fault --frequency 35 --direction 0 --for 1m
  flix scope walker-3f2c --last
  flix scope walker-3f2c --live --channels \"iq,f,bus\"

Without its double quotes a level is a file name to most shells (f>15 writes to
a file `15`), and a list is several words to PowerShell.")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Channels, with commas between them.
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        default_value = "iq,id,f,f_wanted,theta_error,bus"
    )]
    channels: Vec<String>,
    /// Trigger: now, fault, or a level such as "top_iq>0.8" or "bus<10".
    #[arg(long, value_name = "WHEN", default_value = "now")]
    trigger: String,
    /// Share of the capture from before the trigger, 0 to 99 % [default: 50% for a fault or level].
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    pre: Option<u16>,
    /// Wait so long for the trigger.
    #[arg(long = "for", value_name = "TIME", default_value = "10s", value_parser = positive_duration)]
    patience: Duration,
    /// Drive meanwhile: shaking frequency, -35 to 35 Hz.
    #[arg(long, value_name = "HZ", requires = "direction", allow_hyphen_values = true, value_parser = frequency)]
    frequency: Option<Hertz>,
    /// Drive meanwhile: shaking direction, -90 to 90 degrees.
    #[arg(long, value_name = "DEG", requires = "frequency", allow_hyphen_values = true, value_parser = direction)]
    direction: Option<Degrees>,
    /// Fetch what the robot has kept of the last fault.
    #[arg(long, conflicts_with_all = ["channels", "trigger", "pre", "patience", "frequency", "live"])]
    last: bool,
    /// Draw one capture after the other in the terminal, until Esc; write no files.
    #[arg(long, conflicts_with = "json")]
    live: bool,
    /// Folder for the files.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

fn percent(text: &str) -> Result<u16, String> {
    match text.trim().trim_end_matches('%').trim_end().parse() {
        Ok(percent @ 0..100) => Ok(percent),
        _ => Err(format!("`{text}` is not a share: write 0% to 99%")),
    }
}

impl Args {
    fn plan(&self) -> Result<ScopePlan, Error> {
        let mut channels = channels(&self.channels.join(",")).map_err(Error::usage)?;
        let trigger = trigger(&self.trigger, &mut channels).map_err(Error::usage)?;
        let plan = ScopePlan { channels: channels.into_iter().collect(), trigger, before: 0 };
        let share = match (trigger, self.pre) {
            (Trigger::Now, Some(1..)) => {
                return Err(Error::usage(
                    "a capture that begins now has nothing before it: leave --pre out, or name a --trigger",
                ));
            }
            (Trigger::Now, _) => 0,
            (_, share) => share.unwrap_or(50),
        };
        let before = u32::from(plan.rows()) * u32::from(share) / 100;
        Ok(ScopePlan { before: before as u16, ..plan })
    }

    fn setpoint(&self) -> Result<Option<Setpoint>, Error> {
        let pair = self.frequency.zip(self.direction);
        pair.map(|(f, theta)| Setpoint::new(f, theta)).transpose().map_err(Error::usage)
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let (plan, setpoint) = (args.plan()?, args.setpoint()?);
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let mut driven = Driven {
        touched: connection.now(),
        connection: &mut connection,
        setpoint,
        awaits_fault: plan.trigger == Trigger::Fault,
        screen: None,
        is_left: false,
    };
    let done = if args.last {
        last(&mut driven)
    } else if args.live {
        live(&mut driven, &plan, args.patience).map(|()| None)
    } else {
        once(&mut driven, &plan, args.patience)
    };
    let capture = match done {
        Ok(capture) => capture,
        Err(error) if error.exit == Exit::Interrupted && connection.client().is_driving() => {
            return Err(stop(&mut connection));
        }
        Err(error) => return Err(give_up(&mut connection, error)),
    };
    connection.leave();
    let Some(capture) = capture else { return Ok(Exit::Done.into()) };
    let report = Report::write(&args.out, &args.robot.robot, &capture)?;
    if args.json {
        print_json(&report)?
    } else {
        print(&report.describe())?
    }
    Ok(Exit::Done.into())
}

/// Captures once, and drives meanwhile where that is wanted. Once the session ends the robot watches for faults again.
fn once(
    driven: &mut Driven<'_>,
    plan: &ScopePlan,
    patience: Duration,
) -> Result<Option<Capture>, Error> {
    let begins_now = plan.trigger == Trigger::Now;
    if !begins_now {
        scope::ask(driven, ScopeCommand::Begin(plan.clone()))?;
    }
    driven.begin()?;
    if begins_now {
        scope::ask(driven, ScopeCommand::Begin(plan.clone()))?;
    }
    let status = await_capture(driven, patience)?;
    driven.end()?;
    let capture = status.map(|status| fetch(driven, status)).transpose()?;
    Ok(capture.flatten())
}

/// Fetches what the robot has kept of a fault.
fn last(driven: &mut Driven<'_>) -> Result<Option<Capture>, Error> {
    let status = scope::ask(driven, ScopeCommand::Status)?;
    if status.state != ScopeState::Complete {
        return Err(Error::new(
            Exit::Nothing,
            "the robot has had no fault since it was armed last, so nothing is kept; `flix scope --trigger fault` waits for one",
        ));
    }
    fetch(driven, status)
}

/// Draws one capture after the other until the operator leaves.
fn live(driven: &mut Driven<'_>, plan: &ScopePlan, patience: Duration) -> Result<(), Error> {
    if is_closed() {
        return Err(Error::usage(
            "--live needs a terminal; without it the capture is written to files",
        ));
    }
    driven.begin()?;
    let screen = Screen::open(false)
        .map_err(|error| Error::usage(format_args!("the terminal failed: {error}")))?;
    driven.screen = Some(screen);
    let mut newest: Option<Capture> = None;
    let mut count = 0_u32;
    let ended = loop {
        let words = format!("capture {count}");
        let draw = |frame: &mut Frame<'_>| screen::draw(frame, newest.as_ref(), &words);
        let now = driven.connection.now();
        let shown = driven
            .screen
            .as_mut()
            .filter(|screen| screen.is_ready())
            .map_or(Ok(()), |it| it.draw(draw).and_then(|()| it.ask(now)));
        if shown.is_err() {
            break Err(LinkError::Interrupted.into());
        }
        let captured = scope::ask(driven, ScopeCommand::Begin(plan.clone()))
            .map_err(Error::from)
            .and_then(|_| await_capture(driven, patience))
            .and_then(|status| match status {
                Some(status) => fetch(driven, status),
                None => Ok(None),
            });
        match captured {
            Ok(Some(capture)) => newest = Some(capture),
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
        count += 1;
    };
    // Read later, the last answers of the terminal would be input of the shell.
    while driven.screen.as_ref().is_some_and(Screen::is_answer_due) && driven.wait(LOOK).is_ok() {}
    driven.screen = None;
    ended?;
    driven.end()
}

/// A robot that is driven while it is captured, or one that is left alone.
struct Driven<'a> {
    connection: &'a mut Connection,
    setpoint: Option<Setpoint>,
    awaits_fault: bool,
    /// Where the operator looks meanwhile, and may press keys.
    screen: Option<Screen>,
    /// When a key was pressed last.
    touched: Instant,
    /// Whether the operator wants to leave.
    is_left: bool,
}

impl RobotLink for Driven<'_> {
    type Error = LinkError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        self.connection.operate()
    }

    /// Looks at the keys, also while an answer is awaited.
    fn wait(&mut self, longest: Duration) -> Result<(), LinkError> {
        self.look_at_keys()?;
        self.connection.wait(longest)
    }

    fn no_session(&self, error: ConnectError) -> LinkError {
        self.connection.no_session(error)
    }
}

impl Driven<'_> {
    fn look_at_keys(&mut self) -> Result<(), LinkError> {
        let Some(screen) = &mut self.screen else { return Ok(()) };
        if is_closed() {
            return Err(LinkError::Interrupted);
        }
        let typed = screen.typed();
        let drives = self.setpoint.is_some();
        // A robot does not walk on for nobody.
        let now = self.connection.now();
        if typed.is_touched {
            self.touched = now;
        }
        let is_unseen = typed.is_unsure && now.since(self.touched) >= UNSEEN;
        self.is_left |= drives && (typed.doubt.is_some() || is_unseen);
        for action in typed.actions {
            match action {
                Action::Stop | Action::Interrupt => return Err(LinkError::Interrupted),
                Action::Quit => self.is_left = true,
                // A robot that is captured here rests by being disarmed.
                Action::Rest | Action::Disarm => self.is_left |= drives,
                _ => {}
            }
        }
        if self.is_left && drives {
            let (client, now) = self.connection.operate();
            client.disarm(now);
        }
        Ok(())
    }

    /// Arms and waits until f and theta are held, as long as no fault is awaited.
    fn begin(&mut self) -> Result<(), Error> {
        let Some(setpoint) = self.setpoint else { return Ok(()) };
        waiting("the robot to align its motors and prove its link", || self.arm())?;
        self.hold(setpoint);
        if self.awaits_fault {
            return Ok(());
        }
        let held = self.wait_for(SETTLING, |_, update| match update {
            Update::Telemetry(telemetry) if telemetry.state == State::Faulted => {
                Some(Err(LinkError::faulted(telemetry)))
            }
            Update::Telemetry(telemetry) if is_reached(telemetry, &setpoint) => Some(Ok(())),
            _ => None,
        })?;
        // One that cannot hold them is worth looking at.
        Ok(held.transpose().map(drop)?)
    }

    /// Fails where the walk has ended, unless by the fault that is waited for.
    fn check_walk(&self) -> Result<(), Error> {
        let client = self.connection.client();
        if self.is_left || self.setpoint.is_none() || client.held() == self.setpoint {
            return Ok(());
        }
        let shown = client.telemetry().copied().map(Update::Telemetry);
        match shown.and_then(|update| LinkError::while_driven(&update)) {
            Some(LinkError::Faulted { .. }) if self.awaits_fault => Ok(()),
            why => Err(why.unwrap_or(LinkError::Lapsed).into()),
        }
    }

    /// Disarms; a robot with the fault that was waited for is disarmed.
    fn end(&mut self) -> Result<(), Error> {
        if self.setpoint.is_none() {
            return Ok(());
        }
        match self.disarm() {
            Err(LinkError::Faulted { .. }) if self.awaits_fault => Ok(()),
            ended => Ok(ended?),
        }
    }
}

/// Waits until the capture is complete; `None` when the operator leaves before.
fn await_capture(
    driven: &mut Driven<'_>,
    patience: Duration,
) -> Result<Option<ScopeStatus>, Error> {
    let start = std::time::Instant::now();
    while !driven.is_left {
        let status = scope::ask(driven, ScopeCommand::Status)?;
        driven.check_walk()?;
        if status.state == ScopeState::Complete {
            return Ok(Some(status));
        }
        if status.state == ScopeState::Waiting && start.elapsed() > patience {
            driven.end()?;
            let sentence = format!(
                "the trigger has not come within {} s: wait longer with --for, or choose another",
                patience.as_secs_f64()
            );
            return Err(Error::new(Exit::Nothing, sentence));
        }
        driven.pause(LOOK)?;
    }
    Ok(None)
}

/// Fetches the rows; `None` when the operator leaves before.
fn fetch(driven: &mut Driven<'_>, status: ScopeStatus) -> Result<Option<Capture>, Error> {
    // On the screen of --live it would be in the way.
    let bar = match driven.screen {
        Some(_) => ProgressBar::hidden(),
        None => drawn(ProgressBar::new(status.rows.into())),
    };
    let mut capture = Capture::new(status);
    while !driven.is_left {
        if !scope::fetch(driven, &mut capture)? {
            bar.finish_and_clear();
            return Ok(Some(capture));
        }
        bar.set_position(capture.rows() as u64);
    }
    Ok(None)
}

#[derive(Debug, Serialize)]
struct Report {
    rows: usize,
    rate_hz: u32,
    trigger_row: u16,
    /// On the robot's clock.
    trigger_time_s: f64,
    channels: Vec<Column>,
    #[serde(serialize_with = "path_as_text")]
    csv: PathBuf,
    #[serde(serialize_with = "path_as_text")]
    svg: PathBuf,
    #[serde(serialize_with = "path_as_text")]
    png: PathBuf,
    #[serde(serialize_with = "path_as_text")]
    mcap: PathBuf,
}

#[derive(Debug, Serialize)]
struct Column {
    name: String,
    unit: &'static str,
    #[serde(flatten)]
    extent: Option<Extent>,
}

impl Report {
    fn write(out: &Path, robot: &str, capture: &Capture) -> Result<Self, Error> {
        let folder = out.join(FOLDER);
        let cannot = |path: &Path, why: &dyn std::fmt::Display| {
            Error::usage(format_args!("cannot write {}: {why}", path.display()))
        };
        std::fs::create_dir_all(&folder).map_err(|error| cannot(&folder, &error))?;
        let first = dated(SystemTime::now(), robot);
        let name = std::iter::once(first.clone())
            .chain((2..1_000).map(|attempt| format!("{first}-{attempt}")))
            .find(|name| !folder.join(format!("{name}.csv")).exists())
            .unwrap_or(first);
        let file = |ending: &str| folder.join(format!("{name}.{ending}"));
        let (csv, mcap) = (file("csv"), file("mcap"));
        files::write_csv(capture, &csv).map_err(|error| cannot(&csv, &error))?;
        files::write_mcap(capture, &mcap).map_err(|error| cannot(&mcap, &error))?;
        let title = format!("Scope of {robot}");
        let written =
            flix_plot::scope::chart(capture, &title).write(&folder, &name).map_err(Error::usage)?;
        let columns = capture.channels().iter().enumerate().map(|(column, channel)| Column {
            name: channel.to_string(),
            unit: channel.quantity().unit(),
            extent: capture.extent(column),
        });
        Ok(Self {
            rows: capture.rows(),
            rate_hz: SCOPE_RATE_HZ,
            trigger_row: capture.status().trigger_row,
            trigger_time_s: capture.status().trigger_time_us as f64 * 1e-6,
            channels: columns.collect(),
            csv,
            svg: written.svg,
            png: written.png,
            mcap,
        })
    }

    fn describe(&self) -> String {
        let mut rows = vec![headings("channel|minimum|maximum|mean|unit")];
        for Column { name, unit, extent } in &self.channels {
            let [minimum, maximum, mean] = extent
                .map_or([f64::NAN; 3], |it| [it.minimum, it.maximum, it.mean])
                .map(|value| fixed(value, 3));
            rows.push(vec![name.clone(), minimum, maximum, mean, (*unit).to_owned()]);
        }
        let mut text = table(&rows);
        let milliseconds = |rows: f64| 1e3 * rows / f64::from(self.rate_hz);
        let before = milliseconds(self.trigger_row.into());
        let _ = writeln!(
            text,
            "{} rows: {before:.1} ms before the trigger, {:.1} ms from it on",
            self.rows,
            milliseconds(self.rows as f64) - before
        );
        for path in [&self.csv, &self.svg, &self.png, &self.mcap] {
            let _ = writeln!(text, "{}", path.display());
        }
        text
    }
}
