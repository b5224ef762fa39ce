//! A robot, its operator, and what a visitor does to them.

use std::time::Duration;

use flix_host::link::RobotLink;
use flix_host::nav::{
    Approach, Decision, ModeTable, Navigator, Path, PathError, Position, Settings, Task,
};
use flix_host::pose::PoseSample;
use flix_host::teleop::Cockpit;
use flix_host::teleop::cockpit::Weight;
use flix_host::teleop::page::message::Message;
use flix_host::teleop::page::pages::{PageId, Pages};
use flix_host::teleop::page::snapshot::{EXTRAS, News, snapshot};
use flix_protocol::message::{Setpoint, State};
use flix_protocol::session::Key;
use flix_protocol::units::Instant;
use flix_sim::model::{ModelError, RobotModel};
use flix_sim::plant::{Diverged, Plant, Wrench};
use flix_sim::reliability::fault_cases::{CASES, Cause};
use flix_sim::rig::hardware_fault::Injected;
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::motion_capture::{MotionCapture, POSE_PERIOD};
use flix_sim::rig::operation::{Operation, OperationError};
use flix_sim::rig::shipped_mode_tables::shipped_table;
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot, Truth};
use flix_sim::view::RobotView;
use serde::Deserialize;
use serde_json::{Value, json};

/// Number of the one page.
pub const PAGE: PageId = 1;
/// Interval at which the operator's side looks at link and poses.
const SLICE: Duration = Duration::from_millis(1);
/// Force of the hand for each metre between it and the robot, N/m: chosen to follow a finger within centimetres.
const PULL_STIFFNESS: f64 = 60.0;
/// Damping of the hand, N s/m.
const PULL_DAMPING: f64 = 4.0;
/// Largest force of the hand, N: about the robot's weight.
const STRONGEST_PULL: f64 = 3.5;
/// A drawn path whose ends are nearer than this is closed, m.
const CLOSES_WITHIN: f64 = 0.1;
/// Laps of a closed path.
const LAPS: u32 = 3;
/// Most points of a drawn path.
const MOST_POINTS: usize = 2000;
/// A drawn path reaches at most this far from the origin, m.
const FARTHEST_POINT: f64 = 20.0;

/// What a world is made of.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// A shipped model or a random one, such as `random-7`.
    pub model: String,
    /// All chance comes from here.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { model: "W".to_owned(), seed: 1 }
    }
}

/// What a visitor asked cannot be done.
#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// No such model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The plant's state is useless.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The robot could not be aligned.
    #[error(transparent)]
    Operation(#[from] OperationError),
    /// A path that cannot be followed.
    #[error(transparent)]
    Path(#[from] PathError),
    /// No such wish.
    #[error("not understood: {0}")]
    Unknown(#[from] serde_json::Error),
    /// Something else; the sentence says what to do.
    #[error("{0}")]
    Sentence(String),
}

/// What a visitor does to the world, in one line of JSON such as `{"pull":[0.1,0.2]}`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Wish {
    /// Latency each way, ms, and share of datagrams lost, 0 to 1.
    Link { latency_ms: u64, loss: f64 },
    /// Breaks something, by its name in `flix-sim faults`.
    Fault(String),
    /// Mends all.
    Mend,
    /// Pulls the robot to a point of the floor, m, or no more.
    Pull(Option<[f64; 2]>),
    /// Follows a path of points on the floor, m.
    Follow(Vec<[f64; 2]>),
}

/// A path that is followed.
struct Tracking {
    navigator: Navigator,
    /// What the navigator commands; the operator commands something else to end it.
    commanded: Setpoint,
}

/// A robot, its operator and the floor.
pub struct World {
    operation: Operation,
    cockpit: Cockpit,
    pages: Pages,
    news: News,
    cameras: MotionCapture,
    look_at: Instant,
    view: RobotView,
    table: Option<ModeTable>,
    tracking: Option<Tracking>,
    path: Vec<[f64; 2]>,
    pull: Option<[f64; 2]>,
    seed: u64,
    broken: Vec<&'static str>,
}

impl World {
    /// Creates a robot at rest and an operator who connects.
    ///
    /// # Errors
    /// When there is no such model.
    pub fn new(options: &Options) -> Result<Self, Trouble> {
        let model = RobotModel::named(&options.model)?;
        let mut plant = Plant::new(&model)?;
        plant.disturb(options.seed, false);
        let key = Key::new([0x5a; 32]);
        let parameters = RobotParameters::of(&model.electrical, key, options.seed)?;
        align(&parameters, &model)?;
        let robot = SimulatedRobot::new(parameters, plant);
        let mut pages = Pages::default();
        pages.open(PAGE, Instant::START);
        Ok(Self {
            operation: Operation::new(robot, ChannelParameters::QUIET_WIFI),
            cockpit: Cockpit::new("simulated", Instant::START),
            pages,
            news: News::default(),
            cameras: MotionCapture::new(options.seed),
            look_at: Instant::START,
            view: RobotView::new(&model),
            table: shipped_table(&options.model).ok(),
            tracking: None,
            path: Vec::new(),
            pull: None,
            seed: options.seed,
            broken: Vec::new(),
        })
    }

    /// Returns the time since the start.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.operation.now()
    }

    /// Returns how the plant truly is.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.operation.robot.truth()
    }

    /// Returns the mechanics.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        self.operation.robot.mechanics()
    }

    /// Takes a line of the page: a message of the cockpit, or what a visitor does to the world.
    ///
    /// # Errors
    /// When it is neither, or cannot be done.
    pub fn say(&mut self, line: &str) -> Result<(), Trouble> {
        let now = self.now();
        if let Some(message) = Message::parse(line) {
            let client = self.operation.client();
            if self.pages.receive(PAGE, message, &mut self.cockpit, client, now).is_err() {
                self.pages.expel(PAGE, &mut self.cockpit, client, now);
            }
            return Ok(());
        }
        match serde_json::from_str(line)? {
            Wish::Link { latency_ms, loss } => self.change_link(latency_ms, loss)?,
            Wish::Fault(name) => self.inject(&name)?,
            Wish::Mend => {
                self.operation.robot.mend();
                self.broken.clear();
            }
            Wish::Pull(to) => self.pull = to.filter(|to| to.iter().all(|c| c.is_finite())),
            Wish::Follow(points) => self.follow(&points)?,
        }
        Ok(())
    }

    /// Takes what a visitor asked in vain.
    pub fn complain(&mut self, trouble: &Trouble) {
        self.cockpit.note(self.operation.now(), Weight::Warning, &trouble.to_string());
    }

    fn change_link(&mut self, latency_ms: u64, loss: f64) -> Result<(), Trouble> {
        if latency_ms > 1000 || !(0.0..=1.0).contains(&loss) {
            let text = "a link has a latency from 0 to 1000 ms and a loss from 0 to 1";
            return Err(Trouble::Sentence(text.to_owned()));
        }
        let delay = Duration::from_millis(latency_ms);
        let parameters = ChannelParameters { delay, loss, ..ChannelParameters::QUIET_WIFI };
        for operator in &mut self.operation.operators {
            operator.to_robot.parameters = parameters;
            operator.to_operator.parameters = parameters;
        }
        Ok(())
    }

    fn inject(&mut self, name: &str) -> Result<(), Trouble> {
        let known = hardware_faults().find(|(known, ..)| *known == name);
        let Some((name, fault, lasts)) = known else {
            return Err(Trouble::Sentence(format!("there is no fault \"{name}\"")));
        };
        let now = self.now();
        self.operation.robot.disturb(Injected::new(fault, now, now + lasts, self.seed));
        self.broken.push(name);
        self.cockpit.note(now, Weight::Warning, &format!("injected: {name}"));
        Ok(())
    }

    fn follow(&mut self, points: &[[f64; 2]]) -> Result<(), Trouble> {
        let is_near = |c: &f64| c.abs() <= FARTHEST_POINT;
        if points.len() > MOST_POINTS || !points.iter().flatten().all(is_near) {
            let text = format!(
                "a path has at most {MOST_POINTS} points within {FARTHEST_POINT} m of the origin"
            );
            return Err(Trouble::Sentence(text));
        }
        let Some(table) = &self.table else {
            let text = "only the models W and calibrated have a mode table to follow a path with";
            return Err(Trouble::Sentence(text.to_owned()));
        };
        if !self.is_armed() {
            return Err(Trouble::Sentence("not armed: press Enter first".to_owned()));
        }
        let points: Vec<Position> = points.iter().map(|[x, y]| Position::new(*x, *y)).collect();
        let ends = points.first().zip(points.last());
        let is_closed =
            points.len() > 3 && ends.is_some_and(|(a, b)| a.distance_to(*b) < CLOSES_WITHIN);
        let path = Path::through("drawn", &points, is_closed)?;
        self.path = points.iter().map(|point| [point.x, point.y]).collect();
        if is_closed {
            self.path.extend(self.path.first().copied());
        }
        let task = Task::Follow { path, laps: if is_closed { LAPS } else { 1 } };
        let settings = Settings { approach: Approach::Anywhere, ..Settings::for_task(&task) };
        let navigator = Navigator::new(task, table, settings)
            .map_err(|missing| Trouble::Sentence(missing.to_string()))?;
        let now = self.now();
        self.cockpit.note(now, Weight::Note, "follows the path");
        let commanded = self.cockpit.setpoint;
        self.tracking = Some(Tracking { navigator, commanded });
        Ok(())
    }

    fn is_armed(&self) -> bool {
        let state = self.cockpit.telemetry.as_ref().map(|telemetry| telemetry.state);
        matches!(state, Some(State::Armed | State::Running)) && !self.cockpit.is_stopping
    }

    /// Advances everything to this time; `watch` sees the world after every tick.
    ///
    /// # Errors
    /// When the plant diverges.
    pub fn advance(&mut self, until: Instant, mut watch: impl FnMut(&Self)) -> Result<(), Trouble> {
        while self.now() < until {
            let end = self.now() + SLICE;
            let push = self.hand();
            self.operation.robot.mechanics_mut().set_push(push);
            while self.now() < end {
                self.operation.tick()?;
                watch(self);
            }
            self.attend();
        }
        Ok(())
    }

    /// Returns the force of the hand that pulls the robot.
    fn hand(&self) -> Wrench {
        let Some(to) = self.pull else { return Wrench::default() };
        let body = self.plant().body();
        let force: [f64; 2] = core::array::from_fn(|i| {
            PULL_STIFFNESS * (to[i] - body.position[i]) - PULL_DAMPING * body.velocity[i]
        });
        let size = (force[0] * force[0] + force[1] * force[1]).sqrt();
        let share = if size > STRONGEST_PULL { STRONGEST_PULL / size } else { 1.0 };
        Wrench { force: [force[0] * share, force[1] * share, 0.0], torque: [0.0; 3] }
    }

    /// Lets the operator's side take what has arrived.
    fn attend(&mut self) {
        let now = self.now();
        let mut poses = Vec::new();
        if now >= self.look_at {
            self.look_at = now + POSE_PERIOD;
            self.cameras.look(now, &self.operation.robot);
            poses = self.cameras.seen(now);
        }
        let client = self.operation.client();
        while let Some(update) = client.update() {
            self.cockpit.observe(&update, client, now);
        }
        for sample in &poses {
            self.cockpit.see(sample, client, now);
        }
        self.cockpit.watch(client, now);
        self.pages.watch(&mut self.cockpit, client, now);
        self.track(&poses);
    }

    fn track(&mut self, poses: &[PoseSample]) {
        let now = self.now();
        let is_armed = self.is_armed();
        let Some(tracking) = &mut self.tracking else { return };
        // Whatever else is commanded ends it.
        if !is_armed || self.cockpit.setpoint != tracking.commanded {
            self.tracking = None;
            return self.cockpit.note(now, Weight::Note, "follows the path no more");
        }
        for sample in poses {
            tracking.navigator.observe(sample);
        }
        let (setpoint, end) = match tracking.navigator.decide(now) {
            Decision::Drive { setpoint, .. } => (setpoint, None),
            Decision::Rest(_) => (Setpoint::REST, None),
            Decision::Finished => (Setpoint::REST, Some("the path is done".to_owned())),
            Decision::Stopped(stop) => (Setpoint::REST, Some(stop.to_string())),
        };
        tracking.commanded = setpoint;
        self.cockpit.setpoint = setpoint;
        self.operation.client().hold(now, setpoint);
        if let Some(text) = end {
            self.tracking = None;
            self.cockpit.note(now, Weight::Note, &text);
        }
    }

    /// Returns what the page is sent first: its number, the parts of the robot, and what can break.
    #[must_use]
    pub fn hello(&self) -> Value {
        let faults: Vec<&str> = hardware_faults().map(|(name, ..)| name).collect();
        json!({ "you": PAGE, "parts": self.view.parts(), "faults": faults })
    }

    /// Returns what the page shows: the cockpit's snapshot with `world` added. Lengths in metres.
    pub fn snapshot(&mut self) -> Value {
        let now = self.now();
        self.cockpit.tick(self.operation.client(), now);
        let mut shown = snapshot(&self.cockpit, &self.pages, now);
        for (extra, value) in self.news.of(&self.cockpit) {
            shown[EXTRAS[extra]] = value;
        }
        let frame = self.view.frame(self.plant(), now.as_micros() as f64 * 1e-6);
        // A hundredth of a millimetre is enough to draw.
        let short = |value: f64| (value * 1e5).round() / 1e5;
        let poses: Vec<[f64; 7]> = frame
            .poses
            .iter()
            .map(|pose| {
                let ([x, y, z], [w, i, j, k]) =
                    (pose.position.coordinates(), pose.orientation.components());
                [x, y, z, w, i, j, k].map(short)
            })
            .collect();
        let progress = self.tracking.as_ref().map(|tracking| tracking.navigator.progress());
        shown["world"] = json!({
            "poses": poses,
            "pull": self.pull,
            "path": self.path,
            "error_rms": progress.filter(|it| it.joined).map(|it| it.error_rms),
            "tracks": progress.is_some(),
            "broken": self.broken,
        });
        shown
    }
}

/// Lets a robot align its motors and keep that in its flash, so that a visitor need not wait for it.
fn align(parameters: &RobotParameters, model: &RobotModel) -> Result<(), Trouble> {
    // Clones share one flash.
    let robot = SimulatedRobot::new(parameters.clone(), Plant::new(model)?);
    let mut operation = Operation::new(robot, ChannelParameters::QUIET_WIFI);
    operation.arm()?;
    Ok(operation.disarm()?)
}

/// Returns what can break in the robot: name, fault, and for how long.
fn hardware_faults()
-> impl Iterator<Item = (&'static str, flix_sim::rig::hardware_fault::HardwareFault, Duration)> {
    CASES.iter().filter_map(|case| match case.cause {
        Cause::Hardware(fault) => Some((case.name, fault, case.lasts)),
        Cause::Link(_) | Cause::Clock(_) => None,
    })
}
