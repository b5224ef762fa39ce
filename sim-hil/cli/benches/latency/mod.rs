//! Times the way from an operator's command to the first duty that it changes, of a robot in real time exactly as
//! `flix-sim serve` runs it.
//!
//! The rotors are held at rest, where duties move only by noise. A duty has changed when it leaves the range of the
//! last [`HISTORY`] ticks by more than half of that range; the same without a command shows that it is not noise.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant as WallClock};

use flix_firmware::hardware::{Actuation, Bridge, Duty};
use flix_host::system::interrupt::Interrupt;
use flix_protocol::session::Key;
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::simulated::{Disturbance, RobotParameters, SimulatedRobot};
use flix_sim_cli::serve::serve;

/// Commands that are timed.
const COMMANDS: usize = 200;
/// Times that nothing is commanded, and nothing must be seen.
const CONTROLS: usize = 50;
/// Rest before the next: the rotors stand again.
const RESTING: Duration = Duration::from_millis(500);
/// Ticks over which noise is learnt: 0.1 s.
const HISTORY: usize = 1_000;
/// How long a command is held; a change that takes longer is none.
const PATIENCE: Duration = Duration::from_millis(50);

/// Who commands the armed robot.
pub trait Operator {
    /// Commands a walk, or rest, at once, and holds it for this time.
    fn hold(&mut self, walks: bool, duration: Duration);
    /// Disarms the robot, and leaves.
    fn leave(self);
}

/// Sees the orders of the bridges, in the robot's own tick.
struct Probe {
    is_asked: Arc<AtomicBool>,
    changed: Sender<WallClock>,
    history: VecDeque<[u16; 6]>,
}

impl Probe {
    fn is_outside(&self, duties: &[u16; 6]) -> bool {
        (0..6).any(|phase| {
            let seen = self.history.iter().map(|duties| i32::from(duties[phase]));
            let (low, high) = seen
                .fold((i32::MAX, i32::MIN), |(low, high), duty| (low.min(duty), high.max(duty)));
            let margin = (high - low) / 2 + 1;
            !(low - margin..=high + margin).contains(&i32::from(duties[phase]))
        })
    }
}

impl Disturbance for Probe {
    fn actuation(&mut self, _now: Instant, actuation: &mut Actuation) {
        let [Bridge::Duty([a, b, c]), Bridge::Duty([d, e, f])] = actuation.bridges else { return };
        let duties = [a, b, c, d, e, f].map(Duty::raw);
        if !self.is_asked.load(Ordering::Acquire) {
            self.history.truncate(HISTORY - 1);
            self.history.push_front(duties);
        } else if self.is_outside(&duties) {
            self.is_asked.store(false, Ordering::Release);
            // Whoever asks is gone only when the bench is over.
            let _ = self.changed.send(WallClock::now());
        }
    }
}

/// Times the commands of an operator that `open` arms the robot for, and prints the quantiles.
pub fn measure<O: Operator>(open: impl FnOnce(SocketAddr, Key) -> O) {
    let key = Key::new([7; 32]);
    let plant = Plant::new(&RobotModel::named("W").expect("a shipped model")).expect("it is sound");
    let mut robot = SimulatedRobot::new(RobotParameters::new(key.clone(), 1), plant);
    let (sender, changes) = channel();
    let is_asked = Arc::new(AtomicBool::new(false));
    robot.disturb(Probe {
        is_asked: Arc::clone(&is_asked),
        changed: sender,
        history: VecDeque::new(),
    });
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("loopback");
    let address = socket.local_addr().expect("it is bound");
    let interrupt = Interrupt::never();
    let server = {
        let interrupt = interrupt.clone();
        std::thread::spawn(move || {
            serve(robot, &socket, None, &interrupt, |_| Ok(())).expect("it serves")
        })
    };
    let mut operator = open(address, key);
    let mut time = |walks| time_a_command(&mut operator, &is_asked, &changes, walks);
    let false_alarms = (0..CONTROLS).filter_map(|_| time(false)).count();
    let mut delays: Vec<Duration> = (0..COMMANDS).map(|_| time(true).unwrap_or(PATIENCE)).collect();
    operator.leave();
    interrupt.raise();
    server.join().expect("the robot is switched off");
    delays.sort_unstable();
    let quantile = |share: f64| delays[((COMMANDS - 1) as f64 * share).round() as usize];
    for (name, share) in [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("most", 1.0)] {
        println!("{name:>4} {:>7.3} ms", quantile(share).as_secs_f64() * 1e3);
    }
    println!("changes without a command: {false_alarms} of {CONTROLS}");
}

/// Commands this from rest; `None` when no duty changes within [`PATIENCE`].
fn time_a_command(
    operator: &mut impl Operator,
    is_asked: &AtomicBool,
    changes: &Receiver<WallClock>,
    walks: bool,
) -> Option<Duration> {
    operator.hold(false, RESTING);
    is_asked.store(true, Ordering::Release);
    let sent = WallClock::now();
    operator.hold(walks, PATIENCE);
    is_asked.store(false, Ordering::Release);
    changes.try_recv().ok().map(|changed| changed.saturating_duration_since(sent))
}
