//! A controller in a program of its own, in any language.
//!
//! The program is started with the run. It reads lines of JSON from its standard input and answers each with one line on
//! its standard output:
//!
//! ```text
//! <- {"path":[[0.0,0.0],[0.05,0.04]],"closed":true}        once: the path, m; the answer is any line
//! <- {"time":12.34,"x":0.1,"y":0.2,"heading":1.57}         with each pose: s, m, m, rad counter-clockwise from x
//! -> {"f":-30,"theta":30}                                  shake so: Hz, degrees; f 0 is rest
//! ```
//!
//! The [`Navigator`] stays the referee: it counts laps and errors, and age of poses, fence and distance from the path end
//! the run as they do with its own controllers. So does a program that ends, that does not answer in time, that answers
//! before it is asked, or whose answer cannot be driven.

use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel, sync_channel};
use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_protocol::units::{Degrees, Hertz, Instant};
use serde::Deserialize;

use crate::nav::{Decision, EndReason, ModeTable, Navigator, PlanarPose, Progress, Task};
use crate::pilot::Helm;
use crate::pose::PoseSample;
use crate::system;

/// Name of what such a program commands, in records.
pub const NAME: &str = "controller process";
/// Longest time from the start of the program to its first answer: an interpreter has to be loaded.
const START_PATIENCE: Duration = Duration::from_secs(10);
/// Longest time from the end of the program's output to its own.
const EXIT_PATIENCE: Duration = Duration::from_millis(100);
/// Distance between the points of the path that the program is sent, m.
const POINT_SPACING: f64 = 0.02;
/// Longest answer, bytes; a longer one is cut and therefore wrong.
const LONGEST: u64 = 4096;
/// Longest part of a wrong answer that is repeated to people, characters.
const SHOWN: usize = 80;

/// Returns the names of the modes, in the order of the table, and of what a controller process commands.
#[must_use]
pub fn names(table: &ModeTable) -> Vec<String> {
    let names = table.modes().iter().map(|mode| mode.name.clone());
    names.chain([NAME.to_owned()]).collect()
}

/// A program that chooses f and theta.
#[derive(Debug)]
pub struct ControllerProcess {
    child: Child,
    questions: Sender<String>,
    answers: Receiver<String>,
    patience: Duration,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    f: f32,
    theta: f32,
}

impl ControllerProcess {
    /// Starts the program with this command line of the shell, and sends it the path. `patience`: the longest time for
    /// an answer.
    ///
    /// # Errors
    /// When it cannot be started, or does not answer.
    pub fn start(command: &str, task: &Task, patience: Duration) -> io::Result<Self> {
        let mut child =
            system::shell(command).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let (mut input, output) =
            child.stdin.take().zip(child.stdout.take()).ok_or(io::ErrorKind::BrokenPipe)?;
        let (questions, to_write) = channel::<String>();
        // One answer waits at most, and no more is read.
        let (read, answers) = sync_channel(0);
        // A program that does not read fills its pipe: writing must not block the run.
        std::thread::spawn(move || {
            to_write
                .iter()
                .all(|line| input.write_all(line.as_bytes()).and_then(|()| input.flush()).is_ok())
        });
        std::thread::spawn(move || {
            let mut output = BufReader::new(output);
            loop {
                let mut line = Vec::new();
                let length = (&mut output).take(LONGEST).read_until(b'\n', &mut line).unwrap_or(0);
                let line = String::from_utf8_lossy(&line).trim_end().to_owned();
                if length == 0 || read.send(line).is_err() {
                    return;
                }
            }
        });
        let mut process = Self { child, questions, answers, patience };
        process.ask(&introduction(task), START_PATIENCE).map_err(io::Error::other)?;
        Ok(process)
    }

    /// Sends a line, and returns the one that answers it.
    fn ask(&mut self, question: &serde_json::Value, patience: Duration) -> Result<String, String> {
        if let Ok(line) = self.answers.try_recv() {
            return Err(format!(
                "the controller process wrote `{}` before it was asked: one line answers each line",
                shown(&line)
            ));
        }
        // A program that has ended is noticed by its missing answer.
        let _ = self.questions.send(format!("{question}\n"));
        self.answers.recv_timeout(patience).map_err(|error| match error {
            RecvTimeoutError::Timeout => {
                format!("the controller process did not answer within {} s", patience.as_secs_f64())
            }
            RecvTimeoutError::Disconnected => {
                format!("the controller process ended{}", self.exit_status())
            }
        })
    }

    /// Returns how the process ended, in brackets; nothing where it only closed its output.
    fn exit_status(&mut self) -> String {
        let begin = std::time::Instant::now();
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return format!(" ({status})"),
                Ok(None) if begin.elapsed() < EXIT_PATIENCE => {
                    std::thread::sleep(EXIT_PATIENCE / 20)
                }
                _ => return String::new(),
            }
        }
    }

    fn steer(&mut self, now: Instant, pose: &PlanarPose) -> Result<Setpoint, String> {
        let PlanarPose { x, y, heading } = pose;
        let time = now.as_micros() as f64 * 1e-6;
        let question = serde_json::json!({ "time": time, "x": x, "y": y, "heading": heading });
        let line = self.ask(&question, self.patience)?;
        let wrong = |why: String| {
            format!(
                "the controller process answered `{}`: {why}; an answer is {{\"f\": -30, \"theta\": 30}}",
                shown(&line)
            )
        };
        let answer: Answer =
            serde_json::from_str(&line).map_err(|error| wrong(error.to_string()))?;
        Hertz::new(answer.f)
            .and_then(|f| Setpoint::new(f, Degrees::new(answer.theta)?))
            .map_err(|error| wrong(error.to_string()))
    }
}

impl Drop for ControllerProcess {
    fn drop(&mut self) {
        system::end_together(&mut self.child);
    }
}

/// Returns what of a line is repeated to people.
fn shown(line: &str) -> String {
    line.chars().take(SHOWN).collect()
}

/// Returns the first line: where the robot is to walk.
fn introduction(task: &Task) -> serde_json::Value {
    match task {
        Task::Follow { path, .. } => {
            let count = (path.length() / POINT_SPACING).ceil() as u32;
            let points: Vec<[f64; 2]> = (0..=count)
                .map(|index| {
                    path.at(f64::from(index) * path.length() / f64::from(count)).position()
                })
                .map(|point| [point.x, point.y])
                .collect();
            serde_json::json!({ "path": points, "closed": path.is_closed() })
        }
        Task::Reach { point, .. } => {
            serde_json::json!({ "path": [[point.x, point.y]], "closed": false })
        }
    }
}

/// A navigator that chooses the modes itself, or leaves that to a program.
#[derive(Debug)]
pub struct Steering {
    navigator: Navigator,
    process: Option<ControllerProcess>,
    /// Index of what the program commands among the names of the modes.
    index: usize,
    commanded: Setpoint,
    is_answered: bool,
}

impl Steering {
    /// Lets the program steer, if there is one. `modes`: the number of modes in the table.
    #[must_use]
    pub fn new(navigator: Navigator, process: Option<ControllerProcess>, modes: usize) -> Self {
        Self { navigator, process, index: modes, commanded: Setpoint::REST, is_answered: true }
    }

    /// Returns the navigator.
    #[must_use]
    pub fn navigator(&self) -> &Navigator {
        &self.navigator
    }
}

impl Helm for Steering {
    fn observe(&mut self, sample: &PoseSample) {
        self.navigator.observe(sample);
        self.is_answered = false;
    }

    fn decide(&mut self, now: Instant) -> Decision {
        let Some(process) = &mut self.process else { return self.navigator.decide(now) };
        let walks = self.commanded.frequency() != Hertz::ZERO;
        if let Some(decision) = self.navigator.judge(now, walks) {
            self.commanded = Setpoint::REST;
            return decision;
        }
        if let Some(pose) = self.navigator.pose().filter(|_| !self.is_answered) {
            match process.steer(now, &pose) {
                Ok(setpoint) => self.commanded = setpoint,
                Err(trouble) => return self.navigator.stop(now, EndReason::Controller(trouble)),
            }
            self.is_answered = true;
        }
        Decision::Drive { mode: self.index, setpoint: self.commanded }
    }

    fn set_latency(&mut self, latency: Duration) {
        self.navigator.set_latency(latency);
    }

    fn set_pose_period(&mut self, period: Duration) {
        self.navigator.set_pose_period(period);
    }

    fn progress(&self) -> Option<(PlanarPose, Progress)> {
        Helm::progress(&self.navigator)
    }
}
