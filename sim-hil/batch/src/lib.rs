#![forbid(unsafe_code)]
#![doc = include_str!("../README.md")]
//!
//! A robot's bits do not depend on its neighbours or on the number of threads. In [`Precision::Double`] they are those of a
//! [`Plant`] alone.

use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelRefIterator as _, IntoParallelRefMutIterator as _,
    ParallelIterator as _,
};
use rayon::slice::ParallelSlice as _;

use flix_plant::model::{ModelError, RobotModel};
use flix_plant::plant::mechanics::lane::{Double, Lane, Single};
use flix_plant::plant::mechanics::{Block, Pack, Robots};
use flix_plant::plant::{BodyState, Diverged, Plant, Wrench};

/// Numbers that a batch computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// 24 bits (`f32`), sixteen robots in a vector of 512 bits: for studies and learning.
    #[default]
    Single,
    /// 53 bits (`f64`), eight robots in it: the bits of [`Plant`].
    Double,
}

/// Many robots on ideal drives.
#[derive(Debug)]
pub struct Batch {
    blocks: Vec<Box<dyn Robots>>,
    models: Vec<RobotModel>,
    /// Robots of a block.
    lanes: usize,
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
        assert_eq!(models.len(), plants.len(), "a plant for each model");
        let (lanes, create): (usize, Create) = match precision {
            Precision::Single => (Single::LANES, block::<Single>),
            Precision::Double => (Double::LANES, block::<Double>),
        };
        let blocks = models.par_chunks(lanes).zip(plants.par_chunks(lanes));
        let blocks =
            blocks.map(|(models, plants)| create(models, plants)).collect::<Result<_, _>>()?;
        Ok(Self { blocks, models, lanes })
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

    /// Returns a robot as a plant of its own, for everything that a plant can tell.
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

    /// Advances all robots by so many steps of `step` seconds, on all cores.
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

    /// Returns the energy that the ideal drive has put into a robot, J.
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
