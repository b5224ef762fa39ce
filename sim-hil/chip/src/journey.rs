//! What a laboratory does with a robot, by the very `flix` that it would use: provisioned over the serial port, found,
//! asked, driven over UDP by hand and by a command, stopped from outside, given to a second operator and taken from him,
//! forgotten.

use flix_host::teleop::paper_modes::PaperMode;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use rustix::termios::{Winsize, tcsetwinsize};
use serde::Serialize;
use serde_json::Value;

use crate::live::{Live, Pace, REACHED_HZ, Terminal, Watch};
use crate::rig::{PATIENCE, Rig, RigError};
use crate::session::{Hold, Times, loop_failures};
use flix_esp32c6::network::{NAME, PASSPHRASE};

/// What the robot and its second operator are called.
const ROBOT: &str = "walker";
const SECOND: &str = "bob";
/// What has to be entered before a robot arms that measures no currents.
const MOTORS: [&str; 4] =
    ["top_phase_resistance", "bottom_phase_resistance", "top_flux_linkage", "bottom_flux_linkage"];
/// A setting and another value than its default.
const SETTING: [&str; 2] = ["current_limit", "1.9"];
/// Rotors that are stopped rest so soon after they began to slow down: the longest ramp.
const REST: Duration = Duration::from_millis(600);
/// A person looks at a robot for so long before he clears its stop. `flix clear` clears none that came since it was started: by its
/// own clock, of which the chip's falls short by less on a busy machine.
const LOOK: Duration = Duration::from_secs(2);
/// Below so many seconds of the chip a second, deadlines of `flix` pass by the clock while the robot keeps its own.
const SLOW: f64 = 0.5;
/// A rotor that rests turns slower, Hz.
const RESTING_HZ: f64 = 0.5;
/// Longer than any part of the journey, in the chip's time: whoever waits for more waits for ever.
const LONG: Duration = Duration::from_secs(120);
/// Exit codes of `flix`.
const DONE: &[i32] = &[0];
const NOT_LET_IN: &[i32] = &[10, 20];
const ROBOT_STOPPED: &[i32] = &[31];
const NOT_PROVISIONED: &[i32] = &[32];
const INTERRUPTED: &[i32] = &[40];
/// The robot's log when it has an address of its network, from which it answers to its name, and when it is aligned and armed.
const ADDRESSED: &str = "wi-fi: address ";
const ARMED: &str = "robot: armed";
/// Keys of `flix teleop`: arm, the five modes in their order, disarm and leave.
const ARM: u8 = b'\r';
const MODE_KEYS: [u8; PaperMode::ALL.len()] = *b"wadqe";
const LEAVE: u8 = b'\x1b';
/// From one press of a key to the next: one that comes within 0.8 s of another counts as held since that one.
const PRESS_AGAIN: Duration = Duration::from_secs(1);
/// The least terminal that `flix teleop` draws on.
const SCREEN: Winsize = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };

/// Why there was no journey.
#[derive(Debug, thiserror::Error)]
pub enum JourneyError {
    /// The emulation is at its end.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// No pseudo-terminal, no socket, no folder, no program.
    #[error("{what}: {source}")]
    System {
        /// What there is none of.
        what: String,
        /// Why.
        source: std::io::Error,
    },
}

/// A command and its end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Step {
    /// As typed, without the robot's port.
    pub command: String,
    /// Its exit code; none where a signal ended it.
    pub exit: Option<i32>,
}

/// Result of a journey.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Journey {
    /// Every command.
    pub steps: Vec<Step>,
    /// Setpoints that `flix teleop`, then `flix drive` commanded, against the plant's truth.
    pub hold: Vec<Hold>,
    /// From the rotors' first slowing down by `flix stop` to their rest, s of the chip.
    pub stopped_s: Option<f64>,
    /// Ticks that the fast loop missed while a motor was driven.
    pub overruns: u64,
    /// Longest gap meanwhile, microseconds.
    pub longest_gap_us: f64,
    /// How fast the emulation was.
    pub pace: Option<Pace>,
    /// What does not hold, in sentences.
    pub failures: Vec<String>,
}

/// An operator's computer beside the robot.
struct Desk<'a> {
    live: Live,
    flix: &'a Path,
    /// Where keys are kept.
    home: PathBuf,
    journey: Journey,
    progress: &'a dyn Fn(&str),
}

/// Makes the journey with a robot as it comes from the factory.
pub fn travel(
    rig: Rig,
    flix: &Path,
    times: Times,
    progress: &dyn Fn(&str),
) -> Result<Journey, JourneyError> {
    let home = std::env::temp_dir().join(format!("flix-journey-{}", std::process::id()));
    std::fs::create_dir_all(&home).map_err(system(home.display()))?;
    let live = Live::new(rig).map_err(system("terminal and socket of the robot"))?;
    let mut desk = Desk { live, flix, home, journey: Journey::default(), progress };
    let result = desk.travel(times);
    // Keys of a robot that is no more.
    let _ = std::fs::remove_dir_all(&desk.home);
    result?;
    let Desk { live, mut journey, .. } = desk;
    (journey.overruns, journey.longest_gap_us) =
        (live.rig.seen.missed, live.rig.seen.longest_gap_us);
    let pace = live.pace();
    journey.pace = Some(pace);
    let share = pace.chip_s / pace.wall_s;
    if !journey.failures.is_empty() && share < SLOW {
        let sentence =
            "a second of the clock was too little of the chip's for the deadlines of `flix`:";
        journey.failures.push(format!("{sentence} {share:.2} s"));
    }
    journey.failures.extend(loop_failures(journey.overruns, journey.longest_gap_us));
    journey.failures.extend(journey.hold.iter().flat_map(Hold::failures));
    journey.failures.iter_mut().for_each(|failure| failure.insert_str(0, "journey: "));
    Ok(journey)
}

impl Desk<'_> {
    fn travel(&mut self, times: Times) -> Result<(), JourneyError> {
        let mut provision = vec!["provision", "--ssid", NAME, "--name", ROBOT];
        let fixed = format!("{}/24", self.live.address());
        if !self.live.is_announced {
            // Nothing finds it by its name.
            provision.extend(["--address", &fixed]);
        }
        self.serial(&provision, DONE, ADDRESSED)?;
        if self.live.is_announced {
            let found = self.flix(&["discover", "--json"], DONE)?;
            let address = Value::from(self.live.address().to_string());
            let is_found = found[0]["name"] == ROBOT && found[0]["addresses"][0] == address;
            self.expect(is_found, "discover", &found);
        }
        let status = self.flix(&["status", ROBOT, "--json"], DONE)?;
        let is_well = status["state"] == "disarmed"
            && status["robot"]["reset_reason"] == "its own request"
            && status["faults"] == Value::Array(vec![]);
        self.expect(is_well, "status", &status);
        let [name, value] = SETTING;
        self.flix(&["parameters", "set", ROBOT, name, value, "--save"], DONE)?;
        for name in MOTORS {
            // Those of the rig are as a new robot assumes.
            let value = self.flix(&["parameters", "get", ROBOT, name, "--json"], DONE)?;
            let value = value["default"].to_string();
            self.flix(&["parameters", "set", ROBOT, name, &value, "--save"], DONE)?;
        }
        let listed = self.flix(&["parameters", "list", ROBOT, "--json"], DONE)?;
        // Settings have single precision.
        let is_set = |entry: &Value| {
            entry["name"] == name
                && entry["value"].as_f64().map(|value| value as f32) == value.parse().ok()
        };
        let is_listed = listed.as_array().is_some_and(|list| list.iter().any(is_set));
        self.expect(is_listed, "parameters", &listed);
        self.live.rig.forget_seen();
        self.teleop(times)?;
        self.drive(times)?;
        self.stop()?;
        self.second_operator()?;
        self.serial(&["provision", "--forget"], DONE, "flix provision")?;
        let former = self.home.join(format!("flix/robots/{ROBOT}.forgotten"));
        let former = former.to_string_lossy().into_owned();
        self.flix(&["status", ROBOT, "--key", &former, "--json"], NOT_LET_IN)?;
        self.serial(&["provision", "--operators"], NOT_PROVISIONED, "")?;
        Ok(())
    }

    /// Drives by hand in one session: arms, which aligns first, walks in the five modes, of which two are reached by a
    /// reversal, and disarms.
    fn teleop(&mut self, times: Times) -> Result<(), JourneyError> {
        let (child, mut keys, shown) = self.start_at_a_terminal(["teleop", ROBOT])?;
        let mut press = |key| keys.write_all(&[key]).map_err(system("terminal of `flix teleop`"));
        self.until(|_| shown.try_recv().is_ok())?;
        let from = self.live.rig.serial.len();
        // Pressed again, as people do: `flix` arms once the robot has stated how it is, and takes a mode once it has heard that the
        // robot is armed. A terminal that is gone is a mode that is never reached.
        let mut due = self.live.rig.chip.now();
        let mut press_again = |key, now| {
            if now >= due {
                due = now + PRESS_AGAIN;
                let _ = press(key);
            }
        };
        self.until(|live| {
            press_again(ARM, live.rig.chip.now());
            has_logged(live, from, ARMED)
        })?;
        for (pair, key) in PaperMode::ALL.map(PaperMode::pair).into_iter().zip(MODE_KEYS) {
            self.watch(pair, times)?;
            self.measure(pair, |now| press_again(key, now))?;
        }
        press(LEAVE)?;
        self.end(format!("teleop {ROBOT}"), child, DONE)?;
        let status = self.flix(&["status", ROBOT, "--json"], DONE)?;
        let is_well = status["state"] == "disarmed" && status["stopped"] == false;
        self.expect(is_well, "status after teleop", &status);
        Ok(())
    }

    fn watch(&mut self, asked: (f64, f64), times: Times) -> Result<(), JourneyError> {
        let limit = SETTING[1].parse().unwrap_or(0.0);
        self.live.watch = Some(Watch::new(asked, times, limit)?);
        Ok(())
    }

    /// Goes on until what is watched is measured, and gives `meanwhile` the chip's time.
    fn measure(
        &mut self,
        asked: (f64, f64),
        mut meanwhile: impl FnMut(Duration),
    ) -> Result<(), JourneyError> {
        self.until(|live| {
            meanwhile(live.rig.chip.now());
            live.watch.as_ref().is_none_or(|watch| watch.hold.is_some())
        })?;
        match self.live.watch.take().and_then(|watch| watch.hold) {
            Some(hold) => self.journey.hold.push(hold),
            None => self.fail(format!("{asked:?} is never reached and held")),
        }
        Ok(())
    }

    /// Drives with one setpoint until it is measured.
    fn drive(&mut self, times: Times) -> Result<(), JourneyError> {
        let (f_hz, theta_deg) = PaperMode::Forward.pair();
        self.watch((f_hz, theta_deg), times)?;
        let child = self.start_driving((f_hz, theta_deg))?;
        self.measure((f_hz, theta_deg), |_| ())?;
        // It stops the robot before it ends.
        let _ = rustix::process::kill_process(
            rustix::process::Pid::from_child(&child),
            rustix::process::Signal::INT,
        );
        self.end("drive, then Ctrl-C".to_owned(), child, INTERRUPTED)?;
        self.clear()
    }

    fn start_driving(&mut self, (f_hz, theta_deg): (f64, f64)) -> Result<Child, JourneyError> {
        let (frequency, direction) = (f_hz.to_string(), theta_deg.to_string());
        self.start([
            "drive",
            ROBOT,
            "--frequency",
            &frequency,
            "--direction",
            &direction,
            "--for",
            "10m",
            "--no-record",
        ])
    }

    /// Stops a robot that somebody drives, and clears the stop.
    fn stop(&mut self) -> Result<(), JourneyError> {
        let (f_hz, theta_deg) = PaperMode::Forward.pair();
        let child = self.start_driving((f_hz, theta_deg))?;
        let is_reached = |live: &mut Live| (live.rig.truth().frequency() - f_hz).abs() < REACHED_HZ;
        self.until(is_reached)?;
        let stop = self.start(["stop", ROBOT])?;
        self.until(|live| !is_reached(live))?;
        let from = self.live.rig.chip.now();
        self.until(|live| live.rig.truth().is_slower_than(RESTING_HZ))?;
        let took = self.live.rig.chip.now() - from;
        self.journey.stopped_s = Some(took.as_secs_f64());
        if took > REST {
            self.fail(format!("the rotors take {:.2} s to rest", took.as_secs_f64()));
        }
        self.end(format!("stop {ROBOT}"), stop, DONE)?;
        self.end("drive, which another program stops".to_owned(), child, ROBOT_STOPPED)?;
        let status = self.flix(&["status", ROBOT, "--json"], DONE)?;
        self.expect(status["stopped"] == true, "status after a stop", &status);
        self.clear()
    }

    /// Clears a stop, after a look at the robot.
    fn clear(&mut self) -> Result<(), JourneyError> {
        let from = self.live.rig.chip.now();
        self.until(|live| live.rig.chip.now() - from > LOOK)?;
        self.flix(&["clear", ROBOT], DONE)?;
        Ok(())
    }

    fn second_operator(&mut self) -> Result<(), JourneyError> {
        let file = self.home.join("second.key");
        let key = file.to_string_lossy().into_owned();
        let add = ["provision", "--add-operator", SECOND, "--key-file", &key];
        self.serial(&add, DONE, ADDRESSED)?;
        let ask = ["status", ROBOT, "--key", &key, "--json"];
        let status = self.flix(&ask, DONE)?;
        self.expect(status["operator"] == SECOND, "status", &status);
        self.serial(&["provision", "--revoke-operator", SECOND], DONE, ADDRESSED)?;
        self.flix(&ask, NOT_LET_IN)?;
        self.flix(&["status", ROBOT, "--json"], DONE)?;
        Ok(())
    }

    /// Lets `flix` do something over the serial port, and waits until the robot's log says `then`.
    fn serial(
        &mut self,
        arguments: &[&str],
        exits: &[i32],
        then: &str,
    ) -> Result<(), JourneyError> {
        let from = self.live.rig.serial.len();
        let port = self.live.port.to_string_lossy().into_owned();
        let child = self.start(arguments.iter().copied().chain(["--port", &port]))?;
        self.end(arguments.join(" "), child, exits)?;
        self.until_log(from, then)
    }

    /// Goes on until the robot's log says `text` after its first `from` bytes.
    fn until_log(&mut self, from: usize, text: &str) -> Result<(), JourneyError> {
        self.until(|live| has_logged(live, from, text))
    }

    /// Lets `flix` do something over the network, and returns the JSON that it prints, if it does.
    fn flix(&mut self, arguments: &[&str], exits: &[i32]) -> Result<Value, JourneyError> {
        let child = self.start(arguments)?;
        let output = self.end(arguments.join(" "), child, exits)?;
        Ok(serde_json::from_slice(&output.stdout).unwrap_or(Value::Null))
    }

    fn start(
        &self,
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> Result<Child, JourneyError> {
        let mut command = self.command(arguments);
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        command.spawn().map_err(system(self.flix.display()))
    }

    fn command(&self, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
        let mut command = Command::new(self.flix);
        command.args(arguments).env("HOME", &self.home).env("XDG_CONFIG_HOME", &self.home);
        command.env("FLIX_NETWORK_PASSWORD", PASSPHRASE);
        command.stderr(Stdio::piped());
        command
    }

    /// Starts a program at a terminal; returns it, its keyboard, and what is sent something once its screen is drawn.
    fn start_at_a_terminal<const N: usize>(
        &self,
        arguments: [&str; N],
    ) -> Result<(Child, File, Receiver<()>), JourneyError> {
        let open = || -> std::io::Result<(Child, File, Receiver<()>)> {
            let Terminal { near, far, .. } = Terminal::open()?;
            tcsetwinsize(&near, SCREEN)?;
            let keys = File::from(near);
            let mut screen = keys.try_clone()?;
            let mut command = self.command(arguments);
            command.env("TERM", "xterm").stdin(far.try_clone()?).stdout(far);
            let child = command.spawn()?;
            let (drawn, shown) = channel();
            std::thread::spawn(move || {
                let (mut unasked, mut bytes) = (String::new(), [0; 4096]);
                // A terminal whose program has ended is an error to read.
                while let Ok(length @ 1..) = screen.read(&mut bytes) {
                    let _ = drawn.send(());
                    unasked.push_str(&String::from_utf8_lossy(&bytes[..length]));
                    for answer in answers(&mut unasked) {
                        let _ = screen.write_all(answer.as_bytes());
                    }
                }
            });
            Ok((child, keys, shown))
        };
        open().map_err(system(self.flix.display()))
    }

    /// Goes on until a program ends.
    fn end(
        &mut self,
        command: String,
        mut child: Child,
        exits: &[i32],
    ) -> Result<Output, JourneyError> {
        (self.progress)(&command);
        let end = self.live.rig.chip.now() + LONG;
        loop {
            if child.try_wait().map_err(system(&command))?.is_some() {
                break;
            }
            if self.live.rig.chip.now() > end {
                child.kill().map_err(system(&command))?;
            }
            self.live.advance()?;
        }
        let output = child.wait_with_output().map_err(system(&command))?;
        let exit = output.status.code();
        if !exit.is_some_and(|exit| exits.contains(&exit)) {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            self.fail(format!(
                "`flix {command}` ends with {exit:?}, not {exits:?}: {}",
                said.trim()
            ));
        }
        self.journey.steps.push(Step { command, exit });
        Ok(output)
    }

    /// Goes on until something is so, at most [`PATIENCE`].
    fn until(&mut self, mut is_so: impl FnMut(&mut Live) -> bool) -> Result<(), JourneyError> {
        let end = self.live.rig.chip.now() + PATIENCE;
        while !is_so(&mut self.live) && self.live.rig.chip.now() < end {
            self.live.advance()?;
        }
        Ok(())
    }

    fn expect(&mut self, holds: bool, command: &str, said: &Value) {
        if !holds {
            self.fail(format!("`flix {command}` says {said}"));
        }
    }

    fn fail(&mut self, failure: String) {
        self.journey.failures.push(failure);
    }
}

/// Takes the questions for the cursor's place (ECMA-48's DSR 6) off the front of a program's output, and returns a terminal's
/// answers: the place to which the program has just set it.
fn answers(output: &mut String) -> Vec<String> {
    let mut answers = Vec::new();
    while let Some((before, after)) = output.split_once("\x1b[6n") {
        let place = before.rsplit("\x1b[").next().and_then(|last| last.strip_suffix('H'));
        answers.push(format!("\x1b[{}R", place.unwrap_or("1;1")));
        *output = after.to_owned();
    }
    answers
}

fn has_logged(live: &Live, from: usize, text: &str) -> bool {
    String::from_utf8_lossy(&live.rig.serial[from..]).contains(text)
}

fn system(what: impl ToString) -> impl FnOnce(std::io::Error) -> JourneyError {
    move |source| JourneyError::System { what: what.to_string(), source }
}
