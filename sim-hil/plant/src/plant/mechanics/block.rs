//! Several robots that walk side by side, one in each lane.

use core::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::body::{BodyState, Wrench};
use super::build::{self, PlainState};
use super::course::Course;
use super::lane::Lane;
use super::leg::LegStep;
use super::pack::{Numbers as _, Pack};
use super::plant::{Drive, Plant, aimed, phase, stray};
use super::system::{BaseJoint, Constants, Rotor, Several, advance};
use crate::model::{ModelError, RobotModel};
use crate::plant::{Diverged, Part};

/// Steps after which short numbers are folded into long ones.
const FOLD: usize = 50;

/// What a robot has beside its lane.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Seat {
    /// f in Hz and theta in rad, as asked.
    drive: [f64; 2],
    /// What the rotors follow, from the first drive on.
    course: Option<Course>,
    /// Angle of the rotors about their mean, rad, so many steps ago; short numbers only.
    phase: f64,
    phase_steps: usize,
    /// Did the rotors change speed in the last step?
    follows: bool,
    /// Steps since short numbers were folded into long ones.
    unfolded: usize,
    /// Where the lane's own x and y begin, m; zero for long numbers.
    origin: [f64; 2],
    /// Energies that the lane no longer holds, J; zero for long numbers.
    work: [f64; 5],
    /// What it took to bring the rotors to speed at once, J.
    spun: f64,
    /// Its body and motor work when it was last looked at and moved as robots do.
    sane: (BodyState, f64),
    /// Did it move as no robot does?
    diverged: Option<Diverged>,
}

impl Seat {
    /// Returns f and the speed of the line of force now, turns per second.
    fn speeds(&self) -> [f64; 2] {
        self.course.map_or([0.0; 2], |course| course.now())
    }

    /// Brings the phase up to now, through steps of constant speed.
    fn catch_up(&mut self, step: f64) {
        let [f, _] = self.speeds();
        self.phase -= TAU * f * step * self.phase_steps as f64;
        self.phase_steps = 0;
    }

    /// Returns rotors that turn at constant speed.
    fn aimed(&self) -> [Rotor<f64>; 2] {
        let theta = self.course.map_or(0.0, |course| course.theta_rad());
        aimed(self.phase, self.speeds(), theta)
    }
}

/// All that a robot of a block is at a time, beside its model.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Kept {
    state: Vec<f64>,
    seat: Seat,
}

/// How long a block has run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Clock {
    /// Until steps of this length began, s.
    began: f64,
    /// Their number.
    taken: usize,
    /// Their length, s.
    step: f64,
}

/// Robots in the lanes of a block, whatever its numbers.
pub trait Robots: Send + Sync + core::fmt::Debug {
    /// Puts another robot into a lane, as it stands, moves and is shaken; 0 Hz if it has no ideal drive.
    ///
    /// # Errors
    /// If the model is refused or cannot walk.
    fn place(&mut self, lane: usize, model: &RobotModel, plant: &Plant) -> Result<(), ModelError>;
    /// Shakes a robot at this f (Hz) and theta (rad): at once if it was shaken at none before, else approached as the robot's
    /// software does. Its phase runs on.
    fn set_drive(&mut self, lane: usize, frequency_hz: f64, theta_rad: f64);
    /// Applies a force and a couple to a body at its origin, world axes, until changed.
    fn set_push(&mut self, lane: usize, push: Wrench);
    /// Advances all robots by equal steps, s.
    fn run(&mut self, steps: usize, step: f64);
    /// Returns how long the block has run, s.
    fn time(&self) -> f64;
    /// Returns the longest step, s, that the contact of all its robots' feet takes.
    fn longest_step(&self) -> f64;
    /// Returns when and where a robot moved as none does, if it did: its state is useless from then on, and its body and work
    /// are those of at most 50 steps before.
    fn diverged(&self, lane: usize) -> Option<Diverged>;
    /// Returns the pose and velocity of a body.
    fn body(&self, lane: usize) -> BodyState;
    /// Returns the energy that the ideal drive has put into a robot, J; what the first one put into the rotors, too.
    fn motor_work(&self, lane: usize) -> f64;
    /// Returns all that a robot is now.
    fn keep(&self, lane: usize) -> Kept;
    /// Puts a robot of this model into a lane as it was when it was kept, by a block of the same numbers; it goes on with the
    /// same bits.
    ///
    /// # Errors
    /// If the model is refused or cannot walk.
    fn restore(&mut self, lane: usize, model: &RobotModel, kept: &Kept) -> Result<(), ModelError>;
    /// Returns the block's clock.
    fn clock(&self) -> Clock;
    /// Sets the block's clock.
    fn set_clock(&mut self, clock: Clock);
    /// Returns a robot as a plant of its own, for everything that a plant reports.
    ///
    /// # Errors
    /// If the model is refused.
    fn plant(&self, lane: usize, model: &RobotModel) -> Result<Plant, ModelError>;
}

/// As many robots as `B` has lanes, on ideal drives.
#[derive(Clone, Debug)]
pub struct Block<B> {
    constants: Constants<B, B, 4>,
    state: Several<B>,
    scratch: [LegStep<B>; 4],
    /// -1 for robots that have moved as none does, and the steps until then since the last look.
    sane: B,
    steps: B,
    seats: Vec<Seat>,
    /// Longest step of each robot, s.
    longest: Vec<f64>,
    clock: Clock,
    arch: pulp::Arch,
}

/// Numbers of a vector of 128 bits or two: as many robots as a block may have on every machine. Code for more of them by
/// vectors of that size is several times as long and takes as much longer to compile.
const SHORT_BLOCK: usize = 4;

/// Returns whether a vector of these has the 256 bits that blocks of eight and sixteen robots are made for.
const fn is_long<S: pulp::Simd>() -> bool {
    S::F64_LANES >= SHORT_BLOCK
}

struct LongVectors;

impl pulp::WithSimd for LongVectors {
    type Output = bool;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> bool {
        const { is_long::<S>() }
    }
}

/// Returns whether this machine has vectors of 256 bits or more, and so takes blocks of more than four robots.
#[must_use]
pub fn has_long_vectors() -> bool {
    pulp::Arch::new().dispatch(LongVectors)
}

/// Steps, compiled for every vector unit that the machine may have.
struct Steps<'a, B> {
    block: &'a mut Block<B>,
    steps: usize,
    step: B,
}

impl<B: Lane> pulp::WithSimd for Steps<'_, B> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        if const { is_long::<S>() } {
            self.take();
        } else {
            unreachable!("a block of many robots on a machine of short vectors");
        }
    }
}

impl<B: Lane> Steps<'_, B> {
    #[inline(always)]
    fn take(self) {
        let Block { constants, state, scratch, sane, steps, .. } = self.block;
        let (none, one) = (B::splat(0.0), B::splat(1.0));
        for _ in 0..self.steps {
            advance(constants, state, scratch, [none; 2], self.step);
            *sane = sane.negative_then(*sane, state.sane());
            *steps += sane.negative_then(none, one);
        }
    }
}

/// Returns a robot as it is put into a lane.
fn seated(plant: &Plant) -> (PlainState, Seat) {
    let mut state = plant.plain_state();
    let drive = match plant.drive() {
        Drive::Ideal { frequency_hz, theta_rad } => [frequency_hz, theta_rad],
        Drive::Torque => {
            state.rotors = aimed(0.0, [0.0; 2], 0.0);
            [0.0; 2]
        }
    };
    let seat = Seat {
        drive,
        course: plant.course(),
        phase: phase(&state.rotors),
        phase_steps: 0,
        follows: state.rotors.iter().any(|rotor| rotor.acceleration != 0.0),
        unfolded: 0,
        origin: [0.0; 2],
        work: [0.0; 5],
        spun: 0.0,
        sane: (plant.body(), state.work[0]),
        diverged: None,
    };
    (state, seat)
}

impl<B: Lane + Pack<Single = f64> + core::fmt::Debug> Block<B> {
    /// Creates a block with this robot in every lane, as it stands, moves and is shaken; 0 Hz if it has no ideal drive.
    ///
    /// # Errors
    /// If the model is refused or cannot walk ([`RobotModel::check_walker`]).
    ///
    /// # Panics
    /// If a block of so many robots wants a machine with longer vectors ([`has_long_vectors`]).
    pub fn new(model: &RobotModel, plant: &Plant) -> Result<Self, ModelError> {
        assert!(B::LANES <= SHORT_BLOCK || has_long_vectors(), "{} robots at once", B::LANES);
        model.check_walker()?;
        let plain = build::constants(model);
        let (state, seat) = seated(plant);
        let mut block = Block {
            constants: Constants {
                base: BaseJoint::Free,
                inertia: Pack::all(&plain.inertia),
                rotor_mass: Pack::all(&plain.rotor_mass),
                rotor_arm: Pack::all(&plain.rotor_arm),
                bell_inertia: Pack::all(&plain.bell_inertia),
                rotor_height: Pack::all(&plain.rotor_height),
                shaker_height: Pack::all(&plain.shaker_height),
                gravity: Pack::all(&plain.gravity),
                legs: plain.legs.as_ref().map(Pack::all),
                floor: true,
                ideal: true,
            },
            state: Pack::all(&state),
            scratch: [LegStep::blank(); 4],
            sane: B::splat(1.0),
            steps: B::splat(0.0),
            seats: vec![seat; B::LANES],
            longest: vec![build::longest_step(&plain); B::LANES],
            clock: Clock::default(),
            arch: pulp::Arch::new(),
        };
        (0..B::LANES).for_each(|lane| block.fold_lane(lane));
        Ok(block)
    }

    /// Makes a lane that of another model.
    fn set_model(&mut self, lane: usize, model: &RobotModel) -> Result<(), ModelError> {
        model.check_walker()?;
        let plain = build::constants(model);
        self.longest[lane] = build::longest_step(&plain);
        let c = &mut self.constants;
        c.inertia.set(lane, &plain.inertia);
        c.rotor_mass.set(lane, &plain.rotor_mass);
        c.rotor_arm.set(lane, &plain.rotor_arm);
        c.bell_inertia.set(lane, &plain.bell_inertia);
        c.rotor_height.set(lane, &plain.rotor_height);
        c.shaker_height.set(lane, &plain.shaker_height);
        c.gravity.set(lane, &plain.gravity);
        if let (Some(legs), Some(own)) = (&mut c.legs, &plain.legs) {
            legs.set(lane, own);
        }
        Ok(())
    }

    /// Returns how many steps can be taken at once: up to the next fold of a robot, one where the rotors of a robot change speed.
    fn at_once(&self) -> usize {
        let steps = |seat: &Seat| match seat.course {
            Some(course) if !course.is_steady() => 1,
            _ => FOLD - seat.unfolded,
        };
        self.seats.iter().map(steps).min().unwrap_or(FOLD)
    }

    /// Lets rotors that change speed do so in the coming steps.
    fn follow_courses(&mut self, steps: usize) {
        for (lane, seat) in self.seats.iter_mut().enumerate() {
            let course = match &mut seat.course {
                Some(course) if seat.follows || !course.is_steady() => course,
                _ => {
                    seat.phase_steps += steps;
                    continue;
                }
            };
            let [from, _] = course.now();
            let rotors = if B::SHORT {
                aimed(seat.phase, course.now(), course.theta_rad())
            } else {
                self.state.rotors.get(lane)
            };
            seat.follows = !course.is_steady();
            self.state.rotors.set(lane, &course.followed(rotors, self.clock.step));
            if seat.follows {
                let [to, _] = course.now();
                seat.phase -= 0.5 * TAU * self.clock.step * (from + to);
            } else {
                seat.phase_steps += steps;
            }
        }
    }

    /// Notes who has diverged in the last steps, and folds short numbers into long ones.
    fn look(&mut self, steps: usize) {
        if self.sane.any_negative() {
            self.note_strays();
        }
        self.steps = B::splat(0.0);
        self.clock.taken += steps;
        for lane in 0..B::LANES {
            let seat = &mut self.seats[lane];
            seat.unfolded += steps;
            if seat.unfolded < FOLD {
                continue;
            }
            seat.unfolded = 0;
            if B::SHORT && !seat.follows {
                seat.catch_up(self.clock.step);
                self.state.rotors.set(lane, &seat.aimed());
            }
            self.fold_lane(lane);
            if self.seats[lane].diverged.is_none() {
                self.seats[lane].sane = self.present(lane);
            }
        }
    }

    /// Returns a body, and the energy that the ideal drive has put in, J.
    fn present(&self, lane: usize) -> (BodyState, f64) {
        let (s, seat) = (&self.state, &self.seats[lane]);
        let [x, y] = seat.origin;
        let position = s.position.get(lane).0;
        let velocity = s.velocity.get(lane);
        let body = BodyState {
            position: [position[0] + x, position[1] + y, position[2]],
            orientation: s.orientation.get(lane),
            velocity: velocity.linear.0,
            angular_velocity: velocity.angular.0,
        };
        (body, seat.spun + seat.work[0] + s.work[0].get(lane))
    }

    /// Returns the same of a robot that moves as robots do, or of when it did.
    fn sane(&self, lane: usize) -> (BodyState, f64) {
        let seat = &self.seats[lane];
        if seat.diverged.is_some() { seat.sane } else { self.present(lane) }
    }

    #[cold]
    fn note_strays(&mut self) {
        let time = self.time();
        for (lane, seat) in self.seats.iter_mut().enumerate() {
            if self.sane.get(lane) >= 0.0 || seat.diverged.is_some() {
                continue;
            }
            let s = &self.state;
            let bent = core::array::from_fn(|leg| s.legs[leg].bent().get(lane));
            let speeds = s.rotors.get(lane).map(|rotor| rotor.speed);
            // What strayed for a moment only was the body.
            let part = stray(&s.velocity.get(lane), speeds, bent).unwrap_or(Part::Body);
            let time = time + self.clock.step * (self.steps.get(lane) + 1.0);
            seat.diverged = Some(Diverged { time, part });
        }
    }

    fn fold_lane(&mut self, lane: usize) {
        if !B::SHORT {
            return;
        }
        let (s, seat) = (&mut self.state, &mut self.seats[lane]);
        for (axis, origin) in seat.origin.iter_mut().enumerate() {
            *origin += s.position.0[axis].get(lane);
            s.position.0[axis].set(lane, &0.0);
        }
        for (long, short) in seat.work.iter_mut().zip(&mut s.work) {
            *long += short.get(lane);
            short.set(lane, &0.0);
        }
    }
}

impl<B: Lane + Pack<Single = f64> + core::fmt::Debug> Robots for Block<B> {
    fn place(&mut self, lane: usize, model: &RobotModel, plant: &Plant) -> Result<(), ModelError> {
        self.set_model(lane, model)?;
        let (state, seat) = seated(plant);
        self.seats[lane] = seat;
        self.state.set(lane, &state);
        self.sane.set(lane, &1.0);
        self.steps.set(lane, &0.0);
        self.fold_lane(lane);
        Ok(())
    }
    fn set_drive(&mut self, lane: usize, frequency_hz: f64, theta_rad: f64) {
        let seat = &mut self.seats[lane];
        seat.drive = [frequency_hz, theta_rad];
        if let Some(mut course) = seat.course {
            course.ask(frequency_hz, theta_rad);
            if !course.is_steady() && !seat.follows {
                seat.catch_up(self.clock.step);
            }
            seat.course = Some(course);
            return;
        }
        if !B::SHORT {
            seat.phase = phase(&self.state.rotors.get(lane));
        }
        seat.course = Some(Course::new(frequency_hz, theta_rad));
        let c = &self.constants;
        let [mass, arm, bell] =
            [&c.rotor_mass, &c.rotor_arm, &c.bell_inertia].map(|it| it.get(lane));
        let rotors = seat.aimed();
        let squares: f64 = rotors.iter().map(|rotor| rotor.speed.powi(2)).sum();
        seat.spun = 0.5 * (bell + mass * arm * arm) * squares;
        seat.sane.1 += seat.spun;
        self.state.rotors.set(lane, &rotors);
    }
    fn set_push(&mut self, lane: usize, push: Wrench) {
        self.state.push.set(lane, &push.spatial());
    }
    fn run(&mut self, steps: usize, step: f64) {
        if step != self.clock.step {
            let before = self.clock.step;
            self.seats.iter_mut().for_each(|seat| seat.catch_up(before));
            self.clock = Clock { began: self.time(), taken: 0, step };
        }
        let arch = self.arch;
        let mut left = steps;
        while left > 0 {
            let now = left.min(self.at_once());
            self.follow_courses(now);
            let steps = Steps { block: self, steps: now, step: B::splat(step) };
            if const { B::LANES > SHORT_BLOCK } {
                arch.dispatch(steps);
            } else {
                steps.take();
            }
            self.look(now);
            left -= now;
        }
    }
    fn time(&self) -> f64 {
        self.clock.began + self.clock.taken as f64 * self.clock.step
    }
    fn longest_step(&self) -> f64 {
        self.longest.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn diverged(&self, lane: usize) -> Option<Diverged> {
        self.seats[lane].diverged
    }
    fn body(&self, lane: usize) -> BodyState {
        self.sane(lane).0
    }
    fn motor_work(&self, lane: usize) -> f64 {
        self.sane(lane).1
    }
    fn keep(&self, lane: usize) -> Kept {
        let mut state = Vec::new();
        self.state.get(lane).each(&mut |number| state.push(*number));
        Kept { state, seat: self.seats[lane] }
    }
    fn restore(&mut self, lane: usize, model: &RobotModel, kept: &Kept) -> Result<(), ModelError> {
        self.set_model(lane, model)?;
        let (mut state, mut numbers) = (self.state.get(lane), kept.state.iter());
        state.each(&mut |number| *number = numbers.next().copied().unwrap_or(f64::NAN));
        self.state.set(lane, &state);
        self.seats[lane] = kept.seat;
        self.sane.set(lane, if kept.seat.diverged.is_some() { &-1.0 } else { &1.0 });
        self.steps.set(lane, &0.0);
        Ok(())
    }
    fn clock(&self) -> Clock {
        self.clock
    }
    fn set_clock(&mut self, clock: Clock) {
        self.clock = clock;
    }
    fn plant(&self, lane: usize, model: &RobotModel) -> Result<Plant, ModelError> {
        let mut plant = Plant::new(model)?;
        let seat = &self.seats[lane];
        let mut state = self.state.get(lane);
        for (axis, origin) in seat.origin.iter().enumerate() {
            state.position.0[axis] += origin;
        }
        for (work, long) in state.work.iter_mut().zip(seat.work) {
            *work += long;
        }
        let [frequency_hz, theta_rad] = seat.drive;
        let drive = Drive::Ideal { frequency_hz, theta_rad };
        plant.set_plain_state(&state, self.time(), drive, seat.course);
        Ok(plant)
    }
}
