#![forbid(unsafe_code)]
#![doc = include_str!("../README.md")]
//!
//! A robot's bits do not depend on its neighbours or on the number of threads. In [`Precision::Double`] they are those of a
//! [`Plant`] alone.

use std::collections::HashMap;

use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelRefIterator as _, IntoParallelRefMutIterator as _,
    ParallelIterator as _,
};
use rayon::slice::ParallelSlice as _;
use serde::{Deserialize, Serialize};

use flix_plant::model::{ModelError, RobotModel};
use flix_plant::plant::mechanics::lane::{Double, Lane, Quad, ShortQuad, Single};
use flix_plant::plant::mechanics::{Block, Clock, Kept, Pack, Robots, has_long_vectors};
use flix_plant::plant::{BodyState, Diverged, Plant, Wrench};

/// Numbers that a batch computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Precision {
    /// 24 bits (`f32`), sixteen robots in a vector of 512 bits, eight in one of 256: for studies and learning.
    #[default]
    Single,
    /// 53 bits (`f64`), half as many robots: the bits of [`Plant`].
    Double,
}

/// Many robots on ideal drives.
#[derive(Debug)]
pub struct Batch {
    blocks: Vec<Box<dyn Robots>>,
    models: Vec<RobotModel>,
    precision: Precision,
    /// Robots of a block.
    lanes: usize,
}

/// What a batch is made of anew.
#[derive(Serialize, Deserialize)]
struct State {
    /// What has written it: others may compute other bits.
    release: String,
    precision: Precision,
    clock: Clock,
    /// As JSON, each once.
    models: Vec<String>,
    /// The model of each robot, by its place in `models`, and the robot.
    robots: Vec<(usize, Kept)>,
}

const CHECK: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Why bytes do not become a batch.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// Something else, or some bytes are others.
    #[error(
        "these bytes are no state of a batch, or damaged: keep what get_state returns as it is"
    )]
    Damaged,
    /// Of another release.
    #[error("this state is of release {0}, and this is {release}: run the batch again", release = env!("CARGO_PKG_VERSION"))]
    Release(String),
    /// A model that this release refuses.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl Batch {
    /// Creates a robot of each model, standing still at the origin, shaken at 0 Hz; what fills up the last block is a
    /// copy of its first robot.
    ///
    /// # Errors
    /// If a model is refused or cannot walk ([`RobotModel::check_walker`]).
    pub fn new(models: Vec<RobotModel>, precision: Precision) -> Result<Self, ModelError> {
        let plants = models.par_iter().map(Plant::new).collect::<Result<Vec<_>, _>>()?;
        Self::of(models, &plants.iter().collect::<Vec<_>>(), precision)
    }

    /// Creates the robots that these plants are, one of each model.
    ///
    /// # Errors
    /// If a model is refused or cannot walk.
    ///
    /// # Panics
    /// If there is not a plant for each model.
    pub fn of(
        models: Vec<RobotModel>,
        plants: &[&Plant],
        precision: Precision,
    ) -> Result<Self, ModelError> {
        Self::in_blocks(models, plants, precision, has_long_vectors())
    }

    /// Creates the same robots in blocks of eight and sixteen or, as for machines without vectors of 256 bits, of four; their
    /// bits do not depend on it.
    ///
    /// # Errors
    /// If a model is refused or cannot walk.
    ///
    /// # Panics
    /// If there is not a plant for each model, or this machine has no such vectors.
    pub fn in_blocks(
        models: Vec<RobotModel>,
        plants: &[&Plant],
        precision: Precision,
        long_vectors: bool,
    ) -> Result<Self, ModelError> {
        assert_eq!(models.len(), plants.len(), "a plant for each model");
        let (lanes, create): (usize, Create) = match (precision, long_vectors) {
            (Precision::Single, true) => (Single::LANES, block::<Single>),
            (Precision::Single, false) => (ShortQuad::LANES, block::<ShortQuad>),
            (Precision::Double, true) => (Double::LANES, block::<Double>),
            (Precision::Double, false) => (Quad::LANES, block::<Quad>),
        };
        let blocks = models.par_chunks(lanes).zip(plants.par_chunks(lanes));
        let blocks =
            blocks.map(|(models, plants)| create(models, plants)).collect::<Result<_, _>>()?;
        Ok(Self { blocks, models, precision, lanes })
    }

    /// Returns all that the batch is now, as bytes for [`Batch::restored`]: models, robots and time.
    ///
    /// # Panics
    /// Never: models, robots and times have a form as bytes.
    #[must_use]
    pub fn state(&self) -> Vec<u8> {
        let (mut models, mut places) = (Vec::new(), HashMap::new());
        let robots = (0..self.len()).map(|robot| {
            let model =
                serde_json::to_string(&self.models[robot]).expect("a model has a form in JSON");
            let place = *places.entry(model).or_insert_with_key(|model| {
                models.push(model.clone());
                models.len() - 1
            });
            let (block, lane) = self.seat(robot);
            (place, block.keep(lane))
        });
        let robots = robots.collect();
        let state = State {
            release: env!("CARGO_PKG_VERSION").to_owned(),
            precision: self.precision,
            clock: self.blocks.first().map_or_else(Clock::default, |block| block.clock()),
            models,
            robots,
        };
        postcard::to_allocvec_crc32(&state, CHECK.digest()).expect("a state has a form as bytes")
    }

    /// Creates the batch that [`Batch::state`] has kept; it goes on with the same bits.
    ///
    /// # Errors
    /// If the bytes are damaged, of something else, or of another release.
    pub fn restored(bytes: &[u8]) -> Result<Self, StateError> {
        let state: State =
            postcard::from_bytes_crc32(bytes, CHECK.digest()).map_err(|_| StateError::Damaged)?;
        if state.release != env!("CARGO_PKG_VERSION") {
            return Err(StateError::Release(state.release));
        }
        let models = state.models.iter().map(|model| serde_json::from_str(model));
        let models =
            models.collect::<Result<Vec<RobotModel>, _>>().map_err(|_| StateError::Damaged)?;
        let model = |(place, _): &(usize, Kept)| models.get(*place).cloned();
        let each = state.robots.iter().map(model).collect::<Option<Vec<_>>>();
        let mut batch = Self::new(each.ok_or(StateError::Damaged)?, state.precision)?;
        for (robot, (place, kept)) in state.robots.iter().enumerate() {
            let (block, lane) = batch.seat_mut(robot);
            block.restore(lane, &models[*place], kept)?;
        }
        batch.blocks.iter_mut().for_each(|block| block.set_clock(state.clock));
        Ok(batch)
    }

    /// Returns the number of robots.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.models.len()
    }

    /// Returns whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.models.is_empty()
    }

    fn seat(&self, robot: usize) -> (&dyn Robots, usize) {
        assert!(robot < self.len(), "robot {robot} of {}", self.len());
        (&*self.blocks[robot / self.lanes], robot % self.lanes)
    }

    fn seat_mut(&mut self, robot: usize) -> (&mut dyn Robots, usize) {
        assert!(robot < self.len(), "robot {robot} of {}", self.len());
        (&mut *self.blocks[robot / self.lanes], robot % self.lanes)
    }

    /// Returns the model of a robot.
    ///
    /// # Panics
    /// If there is no such robot; so do all methods that take one.
    #[must_use]
    pub fn model(&self, robot: usize) -> &RobotModel {
        &self.models[robot]
    }

    /// Returns a robot as a plant of its own, for everything that a plant reports.
    ///
    /// # Errors
    /// If the model is refused.
    pub fn plant(&self, robot: usize) -> Result<Plant, ModelError> {
        let (block, lane) = self.seat(robot);
        block.plant(lane, &self.models[robot])
    }

    /// Puts another robot in the place of one, as it stands, moves and is shaken.
    ///
    /// # Errors
    /// If the model is refused or cannot walk.
    pub fn place(
        &mut self,
        robot: usize,
        model: RobotModel,
        plant: &Plant,
    ) -> Result<(), ModelError> {
        let (block, lane) = self.seat_mut(robot);
        block.place(lane, &model, plant)?;
        self.models[robot] = model;
        Ok(())
    }

    /// Changes a robot as a plant of its own: its place, its posture, its drive.
    ///
    /// # Errors
    /// If the model is refused.
    pub fn change(
        &mut self,
        robot: usize,
        change: impl FnOnce(&mut Plant),
    ) -> Result<(), ModelError> {
        let mut plant = self.plant(robot)?;
        change(&mut plant);
        let model = self.models[robot].clone();
        self.place(robot, model, &plant)
    }

    /// Shakes a robot at this f (Hz) and theta (rad): at once if it was shaken at none before, else it gets there as the robot's
    /// software does, by a ramp of f and the short way of theta. Its phase runs on.
    pub fn set_drive(&mut self, robot: usize, frequency_hz: f64, theta_rad: f64) {
        let (block, lane) = self.seat_mut(robot);
        block.set_drive(lane, frequency_hz, theta_rad);
    }

    /// Applies a force and a couple to a body at its origin, world axes, until changed.
    pub fn set_push(&mut self, robot: usize, push: Wrench) {
        let (block, lane) = self.seat_mut(robot);
        block.set_push(lane, push);
    }

    /// Returns the longest step, s, that the contact of all robots' feet takes: in longer ones the floor throws feet up.
    #[must_use]
    pub fn longest_step(&self) -> f64 {
        self.blocks.iter().map(|block| block.longest_step()).fold(f64::INFINITY, f64::min)
    }

    /// Advances all robots by so many steps of `step` seconds, on all cores: at most [`Batch::longest_step`].
    pub fn run(&mut self, steps: usize, step: f64) {
        match &mut self.blocks[..] {
            // Nothing to share: no need to wake anybody.
            [one] => one.run(steps, step),
            many => many.par_iter_mut().for_each(|block| block.run(steps, step)),
        }
    }

    /// Returns how long the batch has run, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.blocks.first().map_or(0.0, |block| block.time())
    }

    /// Returns when and where a robot moved as none does, if it did. From then on its body and its work are those of a
    /// moment before, at most 50 steps.
    #[must_use]
    pub fn diverged(&self, robot: usize) -> Option<Diverged> {
        let (block, lane) = self.seat(robot);
        block.diverged(lane)
    }

    /// Returns the pose and velocity of a body.
    #[must_use]
    pub fn body(&self, robot: usize) -> BodyState {
        let (block, lane) = self.seat(robot);
        block.body(lane)
    }

    /// Returns the energy that the ideal drive has put into a robot, J; where [`Batch::set_drive`] set the first one, also what
    /// brought its rotors to speed at once, over a body at rest.
    #[must_use]
    pub fn motor_work(&self, robot: usize) -> f64 {
        let (block, lane) = self.seat(robot);
        block.motor_work(lane)
    }
}

/// Creates a block of these robots.
type Create = fn(&[RobotModel], &[&Plant]) -> Result<Box<dyn Robots>, ModelError>;

fn block<B: Lane + Pack<Single = f64> + core::fmt::Debug + 'static>(
    models: &[RobotModel],
    plants: &[&Plant],
) -> Result<Box<dyn Robots>, ModelError> {
    let mut block = Block::<B>::new(&models[0], plants[0])?;
    for (lane, (model, plant)) in models.iter().zip(plants).enumerate().skip(1) {
        block.place(lane, model, plant)?;
    }
    Ok(Box::new(block))
}
