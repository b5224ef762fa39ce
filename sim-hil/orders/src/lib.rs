//! Who may move the robot: an explicit-state model, explored over all histories.
//!
//! An **order** is the whole wish of the operator, sent every 20 ms. A **permit** is a number of the robot, new after every
//! **halt**: after the robot came to rest, or had to, without this operator's order. An order that begins something
//! needs the present permit, an order that calms needs none, and the newest order of a session counts alone.
//!
//! The model has one robot, two operators (anna and bob, each a person with a client), and datagrams that the network loses,
//! repeats, delays and reorders. Faults, silences, trials, restarts of both ends, sessions and presses come at any time and
//! without number. [`search()`] explores every state and checks the [`Invariant`]s I1 to I7. [`mutants`] lists changes of the
//! rule, each of which has to break an invariant, so that the invariants are known to see something.
//!
//! # What the model leaves out
//!
//! - Time: silence comes at any moment, and an order is too old at any moment. So a robot that coasts, brakes or ramps down
//!   takes any time to do so, and `flix clear`, which compares the age of a stop with its own, is not in the model.
//! - Settings, the proof of a steady link and pages of a browser. Each withholds orders that the model obeys.
//! - The limit of repeated trials and alignments: a program repeats without number, so the limit is not needed for safety.
//! - Events and messages: the robot reports each order number at most once, which moves nothing.
//!
//! In all of these the model allows more than the robot does. Liveness (I3) says that a way to the goal is left; a fair
//! network takes it.
//!
//! Modules: [`robot`], [`client`], [`network`], persons (`persons`), [`step`]s and [`successors`], [`world`]s made canonical
//! (`canonical`), [`goal`]s (`liveness`) and [`invariant`]s, the [`mod@search`], [`mutants`].
#![forbid(unsafe_code)]

mod canonical;
pub mod client;
pub mod goal;
pub mod invariant;
mod liveness;
pub mod model;
pub mod mutants;
pub mod network;
pub mod order;
mod persons;
pub mod robot;
pub mod search;
pub mod step;
pub mod successors;
pub mod world;

pub use goal::Goal;
pub use invariant::Invariant;
pub use model::{Change, Model};
pub use mutants::{RUNS, Run};
pub use search::{End, Verdict, search};
pub use step::Step;
pub use successors::steps;
pub use world::World;
