//! Whether the poses of a run are those of the robot that it drives.
//!
//! A tracker may swap two bodies, report a default pose for a body that it lost, flip a body's axes, stand still, play a
//! recording, or track another robot. Its poses look like poses. They differ from the robot's in two ways:
//!
//! - **Jump.** A pose is within reach of the one before it when a hand can have pushed the robot there
//!   ([`FASTEST`]), or, after a gap, when the commands can have led it there: as far from where the model of the robot's
//!   motion puts it as that says that it moved, and [`REACH`] more. A pose out of reach is not used. Where the poses are
//!   out of reach for [`STEADY_TIME`], the robot is not where they are.
//! - **Answer.** In each [`WINDOW`] the motion that is seen, `s`, is compared with the motion that is commanded, `c`, both as
//!   (east, north, turn times [`ARM`]). Their agreement `2 s c / (s s + c c)` is 1 where they are the same, and 0 where they have
//!   nothing in common. The best of those with the commands of the last second counts, because robots may ramp slower than
//!   their model, by the motion as known at the beginning or as believed now: a robot that is known by the experience of others
//!   may walk otherwise. The doubt grows with the time while the agreement is 0, and shrinks above [`ENOUGH`]. At [`PATIENCE`]
//!   the poses do not answer to the commands.

use std::time::Duration;

use flix_protocol::units::Instant;

use super::bearing::Bearing;
use super::end_reason::EndReason;
use super::moved::{ARM, Moved, between, length, size, sum};
use crate::pose::continuity::{FASTEST, FASTEST_TURN, REACH, STEADY_TIME, TURN};
use crate::pose::geometry::{PlanarPose, wrap};

/// Longest time between two poses for which a hand may have moved the robot unseen: as long as a pose may be steered by.
const GAP: Duration = Duration::from_millis(100);
/// Time over which motions are compared: longer than a change of mode.
const WINDOW: f64 = 0.5;
/// Halves of windows that are kept, 1.5 s: the commanded motion may be up to 1 s older.
const SLOTS: usize = 6;
/// Motion in a window below which a robot stands, m: well above the noise of motion capture.
const STANDS: f64 = 0.01;
/// Agreement from which poses answer: that of a robot which moves in the commanded direction at 0.15 to 6.5 times the expected
/// speed. Of robots that ramp three times slower than their model, over the worst link, the doubt stays below [`PATIENCE`].
const ENOUGH: f64 = 0.3;
/// Doubt at which a run ends, s: that of poses which have nothing in common with the commands for so long.
const PATIENCE: f64 = 2.0;
/// Fastest walk of a robot whose motion is not known beforehand, m/s, and its turn, rad/s: 1.5 times the paper's fastest modes.
const SPEED: f64 = 0.2;
const YAW: f64 = 2.5;
/// Longest time for which such a robot walks without a pose, s: until the pose is too old, and while the rotors ramp down.
const WALKED: f64 = 0.5;

/// Motion that is commanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Commanded {
    /// The robot has moved so since the last pose, as known at the beginning and as believed now.
    Moved([Moved; 2]),
    /// The robot walks in a way that is not known.
    Walks,
}

/// Watch over the poses of one run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Plausibility {
    believed: Option<(Instant, PlanarPose)>,
    /// A pose nearby, and since when the robot has not left it by more than [`STANDS`].
    stand: Option<(Instant, PlanarPose)>,
    /// Motions of the last slots, newest first; the first one is under way.
    slots: [Slot; SLOTS],
    /// Seconds.
    doubt: f64,
    jump: Option<EndReason>,
    bearing: Bearing,
}

/// Motions in half a window.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    seconds: f64,
    seen: Moved,
    commanded: [Moved; 2],
    /// Whether the robot walked in it in a way that is not known.
    walks: bool,
}

impl Plausibility {
    /// Takes a trusted pose, and the motion that was commanded since the last one. Returns whether the pose is within reach.
    pub(crate) fn observe(
        &mut self,
        time: Instant,
        measured: PlanarPose,
        commanded: Commanded,
    ) -> bool {
        let Some((before, last)) = self.believed else {
            self.believed = Some((time, measured));
            self.stand_at(time, measured);
            return true;
        };
        let elapsed = time.since(before);
        let seconds = elapsed.as_secs_f64();
        let seen = between(&last, &measured);
        let (expected, room) = match commanded {
            Commanded::Moved(both) => (both, [length(both[0]), both[0][2].abs()]),
            Commanded::Walks => {
                ([[0.0; 3]; 2], [SPEED, YAW].map(|speed| speed * seconds.min(WALKED)))
            }
        };
        let room =
            if elapsed <= GAP { [FASTEST, FASTEST_TURN].map(|it| it * seconds) } else { room };
        let off: Moved = std::array::from_fn(|axis| seen[axis] - expected[0][axis]);
        if length(off) > REACH + room[0] || wrap(off[2]).abs() > TURN + room[1] {
            if elapsed >= STEADY_TIME {
                let (distance, turn) = (length(seen), seen[2].to_degrees().abs());
                self.jump = Some(EndReason::Jumped { distance, turn });
            }
            return false;
        }
        self.believed = Some((time, measured));
        self.stand_at(time, measured);
        if seconds > WINDOW {
            self.slots = Default::default();
            return true;
        }
        let slot = &mut self.slots[0];
        slot.seconds += seconds;
        slot.walks |= commanded == Commanded::Walks;
        slot.seen = sum(slot.seen, seen);
        for (commanded, expected) in slot.commanded.iter_mut().zip(expected) {
            *commanded = sum(*commanded, expected);
        }
        if slot.seconds >= 0.5 * WINDOW {
            let passed = slot.seconds;
            let [last, before, ..] = self.slots;
            self.bearing.add(last.seen, last.commanded[1], before.commanded[1]);
            self.doubt = (self.doubt + passed * (1.0 - self.agreement(time) / ENOUGH)).max(0.0);
            self.slots.rotate_right(1);
            self.slots[0] = Slot::default();
        }
        true
    }

    /// Returns the agreement of the window that ends now with the commands, as far as the robot may be late.
    fn agreement(&self, now: Instant) -> f64 {
        let [last, before, ..] = self.slots;
        if last.walks || before.walks {
            return f64::from(u8::from(!self.stands_for(now, WINDOW)));
        }
        let seen = sum(last.seen, before.seen);
        // A robot that stands is not late, and what is believed by its poses is that it stands.
        let (lags, ways) = if size(seen) < STANDS { (1, 1) } else { (SLOTS - 1, 2) };
        let windows = self.slots.windows(2).take(lags);
        let commanded = windows
            .flat_map(|it| (0..ways).map(|way| sum(it[0].commanded[way], it[1].commanded[way])));
        commanded.map(|it| agreement(seen, it)).fold(0.0, f64::max)
    }

    /// Returns why the run has to end, if it has.
    pub(crate) fn end(&self) -> Option<EndReason> {
        let doubtful = self.doubt >= PATIENCE;
        let (time, _) = self.believed.filter(|_| doubtful || self.jump.is_some())?;
        let walked = Duration::from_secs_f64(PATIENCE);
        let frozen = || EndReason::NotMoving { walked };
        let stands = self.stands_for(time, WINDOW).then(frozen);
        self.jump.clone().or(stands).or(Some(EndReason::NotAnswering { walked }))
    }

    /// Returns by how many degrees the axes of the tracked body are turned to the left of the robot's, where they are.
    pub(crate) fn turned(&self) -> Option<f64> {
        self.bearing.turned()
    }

    /// Returns whether the robot has stood for so many seconds.
    pub(crate) fn stands_for(&self, now: Instant, seconds: f64) -> bool {
        self.stand.is_some_and(|(since, _)| now.since(since).as_secs_f64() >= seconds)
    }

    fn stand_at(&mut self, time: Instant, measured: PlanarPose) {
        if self.stand.is_none_or(|(_, stand)| size(between(&stand, &measured)) > STANDS) {
            self.stand = Some((time, measured));
        }
    }

    /// Forgets all but for how long the robot has stood: until a run begins it may be carried.
    pub(crate) fn begin_again(&mut self) {
        *self = Self { stand: self.stand, ..Self::default() };
    }

    /// Forgets the doubt, not where the robot is.
    pub(crate) fn trust_again(&mut self) {
        (self.doubt, self.slots) = (0.0, Default::default());
    }
}

fn agreement(seen: Moved, commanded: Moved) -> f64 {
    let squares = size(seen).powi(2) + size(commanded).powi(2);
    if squares < STANDS.powi(2) {
        return 1.0;
    }
    let common =
        seen[0] * commanded[0] + seen[1] * commanded[1] + ARM.powi(2) * seen[2] * commanded[2];
    2.0 * common / squares
}
