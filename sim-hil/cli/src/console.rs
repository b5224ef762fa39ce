//! What `flix-sim serve` shows and takes while it serves: changes of state, one status line, lines that are typed.

use std::io::ErrorKind::{BrokenPipe, TimedOut};
use std::io::{self, BufRead as _, IsTerminal as _, Read as _};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant as WallClock};

use flix_host::experiment::drops::{HEIGHT, HEIGHTS};
use flix_host::system::has_keys;
use flix_host::system::text::{fixed, printable_lines};
use flix_protocol::message::{Faults, OperatorName, State};
use flix_shell::number::within;
use flix_shell::outlet::{drawn, stderr, stdout};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::error::Error;
use flix_sim::rig::simulated::SimulatedRobot;

/// From one status line to the next.
const STATUS_INTERVAL: Duration = Duration::from_millis(250);
/// From one look for typed lines to the next.
const KEY_INTERVAL: Duration = Duration::from_millis(200);
/// A longer line is taken in parts, bytes.
const LONGEST_LINE: u64 = 256;
/// Lines that wait to be done; whoever writes more waits, too.
const LINES_WAITING: usize = 16;
/// What may be typed.
const HELP: &str = "`back` puts the robot back to its start, `drop MM` drops it, `where` prints where it is,\n`operators` lists who may drive, `revoke NAME` erases the key of one, Ctrl-C ends.\n";

/// A terminal, or whatever takes its place.
pub(super) struct Console {
    typed: Receiver<String>,
    /// Visible on a terminal only.
    line: ProgressBar,
    next: WallClock,
    reported: Option<(State, Faults)>,
    /// Where the middle of the body is when the robot stands at its start, m.
    stands: [f64; 3],
}

/// Time in which a terminal that reads has taken a line.
const ERASED: Duration = Duration::from_millis(20);

impl Console {
    pub(super) fn open(robot: &SimulatedRobot) -> Self {
        let line = drawn(ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()));
        line.set_style(
            ProgressStyle::with_template("{msg}")
                .unwrap_or_else(|_| ProgressStyle::default_spinner()),
        );
        let stands = robot.mechanics().body().position;
        Self { typed: typed_lines(), line, next: WallClock::now(), reported: None, stands }
    }

    /// Reports changes, renews the status line, and does what was typed.
    pub(super) fn attend(&mut self, robot: &mut SimulatedRobot) -> Result<(), Error> {
        let report = robot.report();
        if self.reported != Some((report.state, report.faults)) {
            self.reported = Some((report.state, report.faults));
            let faults = match report.faults {
                none if none.is_empty() => String::new(),
                faults => format!("; faults: {faults}"),
            };
            self.say(&format!("The robot is {}{faults}.\n", report.state))?;
        }
        while let Ok(typed) = self.typed.try_recv() {
            match typed.trim().split_once(' ').unwrap_or((typed.trim(), "")) {
                ("", _) => {}
                ("operators", "") => self.say(&operators(robot))?,
                ("revoke", name) => self.say(&revoke(robot, name))?,
                ("back", "") => {
                    put_back(robot);
                    self.say("The robot is back at its start.\n")?;
                }
                ("drop", height) => self.say(&drop_from(robot, self.stands, height))?,
                ("where", "") => self.say(&(status(robot) + "\n"))?,
                _ => self.say(HELP)?,
            }
        }
        if WallClock::now() >= self.next {
            self.next = WallClock::now() + STATUS_INTERVAL;
            self.line.set_message(status(robot));
        }
        Ok(())
    }

    pub(super) fn close(self) {
        self.line.finish_and_clear();
    }

    fn say(&self, text: &str) -> Result<(), Error> {
        self.line.suspend(|| {
            // The line is erased first. The robot goes on where a terminal takes nothing.
            let _ = stderr().wait(Some(ERASED));
            stdout().put(printable_lines(text).as_bytes());
        });
        match stdout().wait(Some(ERASED)) {
            Err(error) if !matches!(error.kind(), TimedOut | BrokenPipe) => {
                Err(Error::usage(error))
            }
            _ => Ok(()),
        }
    }
}

/// Returns where the robot is and what it does, in one line.
fn status(robot: &SimulatedRobot) -> String {
    let (body, truth) = (robot.mechanics().body(), robot.truth());
    format!(
        "{}: x {} m, y {} m, heading {}\u{b0}, f {} Hz, battery {:.1} V",
        robot.report().state,
        fixed(body.position[0], 3),
        fixed(body.position[1], 3),
        fixed(body.yaw().to_degrees(), 0),
        fixed(truth.frequency(), 1),
        truth.bus_voltage
    )
}

/// Returns the names of the operators, one a line; a star marks who drives.
fn operators(robot: &SimulatedRobot) -> String {
    let driver = robot.driver();
    let names = robot.parameters().operators.names();
    let line =
        |name: &OperatorName| format!("{name}{}\n", if driver == Some(*name) { " *" } else { "" });
    names.iter().map(line).collect()
}

/// Erases the key of an operator, and returns what happened.
fn revoke(robot: &mut SimulatedRobot, name: &str) -> String {
    let mut operators = robot.parameters().operators.clone();
    match name.trim().parse() {
        Ok(name) if operators.names().as_slice() == [name] => {
            format!("{name} is the only operator: nobody could drive.\n")
        }
        Ok(name) if operators.names().contains(&name) => {
            operators.revoke(name);
            robot.change_operators(operators);
            format!("The key of {name} is erased.\n")
        }
        _ => format!("There is no operator called `{name}`.\n"),
    }
}

/// Carries the robot to where it stood at first, heading forward; it goes on doing what it does.
fn put_back(robot: &mut SimulatedRobot) {
    let plant = robot.mechanics_mut();
    plant.displace([0.0; 3], -plant.body().yaw());
    let [x, y, _] = plant.body().position;
    plant.displace([-x, -y, 0.0], 0.0);
}

/// Time for which the robot is held still before it is dropped, s.
const HELD: f64 = 1.0;

/// Holds the robot over its start, and releases it; returns what happens.
fn drop_from(robot: &mut SimulatedRobot, stands: [f64; 3], height: &str) -> String {
    if robot.mechanics().hangs() {
        return "The robot hangs: there is no floor.\n".to_owned();
    }
    if robot.report().state != State::Disarmed {
        return "The robot is not disarmed: nobody drops it.\n".to_owned();
    }
    let height = match height.trim() {
        "" => Ok(HEIGHT),
        text => within(HEIGHTS, "height", " mm")(text),
    };
    match height {
        Ok(height) => {
            robot.mechanics_mut().hold(stands, 1e-3 * height, HELD);
            format!("The robot is held {height} mm over the floor, and falls in {HELD} s.\n")
        }
        Err(error) => format!("{error}.\n"),
    }
}

/// Reads lines from standard input for as long as there are any. A terminal is read only while its keys are for this
/// program: a job in the background that reads is stopped by the system.
fn typed_lines() -> Receiver<String> {
    let (sender, receiver) = sync_channel(LINES_WAITING);
    std::thread::spawn(move || {
        let stdin = io::stdin();
        loop {
            if stdin.is_terminal() && !has_keys(KEY_INTERVAL) {
                continue;
            }
            let mut line = Vec::new();
            match stdin.lock().take(LONGEST_LINE).read_until(b'\n', &mut line) {
                Ok(0) | Err(_) => return,
                Ok(_) if sender.send(String::from_utf8_lossy(&line).into()).is_err() => return,
                Ok(_) => {}
            }
        }
    });
    receiver
}

#[cfg(test)]
mod tests {
    use flix_protocol::session::Key;

    use super::*;
    use flix_sim::model::RobotModel;
    use flix_sim::plant::Plant;
    use flix_sim::rig::simulated::RobotParameters;

    #[test]
    fn a_robot_is_dropped_where_it_stood_from_a_height_that_can_be_measured() {
        let plant = Plant::new(&RobotModel::named("W").unwrap()).unwrap();
        let mut robot = SimulatedRobot::new(RobotParameters::new(Key::new([1; 32]), 1), plant);
        let stands = robot.mechanics().body().position;
        assert!(drop_from(&mut robot, stands, "2000").contains("from 5 to 100 mm"));
        assert_eq!(robot.mechanics().body().position, stands);
        assert!(drop_from(&mut robot, stands, "").contains("20 mm"));
        assert!(drop_from(&mut robot, stands, " 30 ").contains("30 mm"));
        let [.., z] = robot.mechanics().body().position;
        assert!((z - stands[2] - 0.03).abs() < 1e-12);
    }

    #[test]
    fn a_robot_that_is_put_back_stands_at_its_start_and_says_so() {
        let plant = Plant::new(&RobotModel::named("A").unwrap()).unwrap();
        let parameters = RobotParameters::new(Key::new([1; 32]), 1);
        let mut robot = SimulatedRobot::new(parameters, plant);
        robot.mechanics_mut().displace([0.0; 3], 1.0);
        robot.mechanics_mut().displace([0.4, -0.3, 0.0], 0.0);
        let place = "x 0.400 m, y -0.300 m, heading 57\u{b0}";
        assert!(status(&robot).contains(place), "{}", status(&robot));
        put_back(&mut robot);
        let body = robot.mechanics().body();
        let off = [body.position[0], body.position[1], body.yaw()];
        assert!(off.into_iter().all(|it| it.abs() < 1e-12), "{off:?}");
    }
}
