//! From a command's leaving the operator's program to the first duty that it changes: two UDP sockets on
//! loopback, the real client, and the robot in real time exactly as `flix-sim serve` runs it.
//!
//! The rotors are held at rest, where duties move only by noise. A duty has changed when it leaves the range of the
//! last [`HISTORY`] ticks by more than half of that range; the same without a command shows that it is not noise. Prints the quantiles; the target is a 99th percentile
//! below 5 ms.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant as WallClock};

use flix_firmware::hardware::{Actuation, Bridge, Duty};
use flix_host::interrupt::Interrupt;
use flix_host::link::udp::Connection;
use flix_protocol::message::Setpoint;
use flix_protocol::session::Key;
use flix_protocol::units::Instant;
use flix_sim::cli::serve::serve;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::bench::setpoint;
use flix_sim::rig::robot::{Disturbance, RobotParameters, SimulatedRobot};

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

fn main() {
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
    let mut operator = Connection::open(address, key, Interrupt::never()).expect("loopback");
    operator.wait_until_connected().expect("a session");
    operator.arm().expect("the robot arms");
    let walking = setpoint(-30.0, 30.0).expect("within the robot's range");
    let mut time = |setpoint| time_a_command(&mut operator, &is_asked, &changes, setpoint);
    let false_alarms = (0..CONTROLS).filter_map(|_| time(Setpoint::REST)).count();
    let mut delays: Vec<Duration> =
        (0..COMMANDS).map(|_| time(walking).unwrap_or(PATIENCE)).collect();
    operator.disarm().expect("the robot disarms");
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
    operator: &mut Connection,
    is_asked: &AtomicBool,
    changes: &Receiver<WallClock>,
    setpoint: Setpoint,
) -> Option<Duration> {
    hold(operator, Setpoint::REST, RESTING);
    is_asked.store(true, Ordering::Release);
    let sent = WallClock::now();
    hold(operator, setpoint, PATIENCE);
    is_asked.store(false, Ordering::Release);
    changes.try_recv().ok().map(|changed| changed.saturating_duration_since(sent))
}

fn hold(operator: &mut Connection, setpoint: Setpoint, duration: Duration) {
    let (client, now) = operator.operate();
    client.hold(now, setpoint);
    let end = now + duration;
    while operator.now() < end {
        operator.step(Duration::from_millis(2)).expect("loopback");
        while operator.operate().0.update().is_some() {}
    }
}
