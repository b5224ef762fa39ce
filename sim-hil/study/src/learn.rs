//! Gains the [`Experience`] of a kind of robot: how its pairs (f, theta) move many of its robots.
//!
//! Strangers ([`stranger`]) walk in every pair, on a slope, at four headings a quarter turn apart. Over the four
//! the slope cancels, and what is left is the robot; between them the robot cancels, and what is left is the slope. What
//! robots share are the principal components of their motions in all pairs.

use core::f64::consts::{FRAC_PI_2, TAU};

use flix_host::nav::{
    Experience, ExperienceError, Factor, PlanarPose, Twist, Walks, mean_twist, wrap,
};
use flix_protocol::message::Setpoint;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use flix_sim::batch::{Batch, Precision};
use flix_sim::model::{ModelError, RobotModel, STEEPEST_DEG, stranger};
use flix_sim::plant::Plant;

/// Frequencies of the pairs, Hz, and their directions, degrees: where robots go on best.
const FREQUENCIES: [f32; 6] = [-35.0, -30.0, -25.0, 25.0, 30.0, 35.0];
const DIRECTIONS: [f32; 12] =
    [-75.0, -60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0];
/// Headings in which a robot walks.
const HEADINGS: usize = 4;
/// Time before the gait is steady, s.
const SETTLING: f64 = 0.8;
/// Time of a stretch, between the middles of its ends, s.
const STRETCH: f64 = 0.5;
/// Stretches of a walk.
const STRETCHES: usize = 4;
/// Time over which poses are averaged at the ends of a stretch, s, and how many of them.
const END: f64 = 0.1;
const LOOKS: usize = 20;
/// Length that makes a yaw rate comparable with a speed: half the robot's, m.
const LEVER: f64 = 0.1;
/// Numbers of a pair that robots are compared by.
const COLUMNS: usize = 9;
/// Least spread of what is a robot's own, m/s.
const LEAST: f64 = 3e-3;

/// How much experience is gained.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Robots that walk.
    pub robots: u64,
    /// Seed of the first.
    pub first_seed: u64,
    /// Ways to differ that all pairs share.
    pub factors: usize,
    /// Step of the simulation, s.
    pub step: f64,
}

/// Why no experience was gained.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// The model is refused, or cannot walk.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// What was found cannot be true.
    #[error(transparent)]
    Experience(#[from] ExperienceError),
}

/// The motions of one robot in one pair.
#[derive(Debug, Clone, Copy)]
struct Seen {
    mean: Twist,
    slide: [Twist; 2],
    /// Sum of squares within a walk, of that many numbers.
    noise: Twist,
}

/// Returns the spread of the slope along one axis, as a sine: it is evenly distributed in steepness and direction.
fn usual_slope() -> f64 {
    STEEPEST_DEG.to_radians().sin() / 6f64.sqrt()
}

/// Returns all pairs.
#[must_use]
pub fn pairs() -> Vec<Setpoint> {
    let all = FREQUENCIES.iter().flat_map(|f| DIRECTIONS.map(|theta| (*f, theta)));
    all.map(|(f, theta)| Setpoint::saturating(f, theta)).collect()
}

/// Lets robots of a kind walk, and returns what they have in common. `walked` is called with the robots so far.
///
/// # Errors
/// When the model is refused or cannot walk.
pub fn gain(
    model: &RobotModel,
    plan: &Plan,
    walked: &mut dyn FnMut(u64),
) -> Result<Experience, LearnError> {
    let pairs = pairs();
    let mut seen = Vec::new();
    for robot in 0..plan.robots {
        seen.push(walks(model, plan.first_seed.wrapping_add(robot), &pairs, plan.step)?);
        walked(robot + 1);
    }
    let common = factors(&seen, plan.factors);
    let walks = pairs.iter().enumerate().map(|(pair, setpoint)| {
        let of = |pick: &dyn Fn(&Seen) -> Twist| {
            let sum = seen.iter().fold(Twist::REST, |sum, robot| sum.plus(pick(&robot[pair])));
            sum.scaled(1.0 / seen.len() as f64)
        };
        let noise = of(&|s| s.noise);
        let common = &common[pair];
        Walks {
            setpoint: *setpoint,
            mean: of(&|s| s.mean),
            slide: [of(&|s| s.slide[0]), of(&|s| s.slide[1])],
            factors: common.factors.clone(),
            own: common.own,
            noise: Twist {
                forward: noise.forward.sqrt().max(LEAST),
                lateral: noise.lateral.sqrt().max(LEAST),
                yaw: noise.yaw.sqrt().max(LEAST / LEVER),
            },
        }
    });
    let source =
        format!("{} robots from seed {}, {} factors", plan.robots, plan.first_seed, plan.factors);
    Ok(Experience::new(&model.name, &source, [STRETCH, usual_slope()], walks.collect())?)
}

/// Lets one robot walk in every pair.
fn walks(
    kind: &RobotModel,
    seed: u64,
    pairs: &[Setpoint],
    step: f64,
) -> Result<Vec<Seen>, ModelError> {
    let mut model = stranger(kind, seed);
    model.contact.slope_deg = STEEPEST_DEG;
    let downhill = model.contact.downhill_deg.to_radians();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    random.jump();
    model.check_walker()?;
    let standing = Plant::new(&model)?;
    let mut plants: Vec<Plant> = Vec::new();
    for index in 0..pairs.len() {
        let first = TAU * random.random::<f64>();
        for quarter in 0..HEADINGS {
            let mut plant = standing.clone();
            plant.disturb((index * HEADINGS + quarter) as u64 ^ seed.rotate_left(32), false);
            plant.displace([0.0; 3], first + FRAC_PI_2 * quarter as f64);
            plants.push(plant);
        }
    }
    let refs: Vec<&Plant> = plants.iter().collect();
    let mut batch = Batch::of(vec![model.clone(); plants.len()], &refs, Precision::Single)?;
    for robot in 0..batch.len() {
        let pair = pairs[robot / HEADINGS];
        let (f, theta) = (f64::from(pair.frequency().get()), f64::from(pair.direction().get()));
        batch.set_drive(robot, f, theta.to_radians());
    }
    let steps = |seconds: f64| (seconds / step).round().max(1.0) as usize;
    batch.run(steps(SETTLING), step);
    let mut ends = vec![end(&mut batch, step)];
    for _ in 0..STRETCHES {
        batch.run(steps(STRETCH - END), step);
        ends.push(end(&mut batch, step));
    }
    let slope = STEEPEST_DEG.to_radians().sin();
    let stretches = |robot: usize| {
        ends.windows(2).map(move |pair| {
            let (from, to) = (pair[0][robot], pair[1][robot]);
            let to = PlanarPose { heading: from.heading + wrap(to.heading - from.heading), ..to };
            let lean = downhill - 0.5 * (from.heading + to.heading);
            (mean_twist(&from, &to, STRETCH), [slope * lean.cos(), slope * lean.sin()])
        })
    };
    Ok((0..pairs.len())
        .map(|pair| {
            let quarters = || HEADINGS * pair..HEADINGS * (pair + 1);
            let all: Vec<(Twist, [f64; 2])> = quarters().flat_map(&stretches).collect();
            let (mean, slide) = fit(&all);
            let expected =
                |lean: [f64; 2]| mean.plus(slide[0].scaled(lean[0])).plus(slide[1].scaled(lean[1]));
            // About the mean of each walk: what stays is the robot's own, not noise.
            let left = quarters().flat_map(|robot| {
                let left: Vec<Twist> = stretches(robot)
                    .map(|(motion, lean)| motion.plus(expected(lean).scaled(-1.0)))
                    .collect();
                let middle = average(&left);
                left.into_iter().map(move |twist| twist.plus(middle.scaled(-1.0)))
            });
            let squares: Vec<Twist> = left
                .map(|t| Twist {
                    forward: t.forward.powi(2),
                    lateral: t.lateral.powi(2),
                    yaw: t.yaw.powi(2),
                })
                .collect();
            let freedom = STRETCHES as f64 / (STRETCHES as f64 - 1.0);
            Seen { mean, slide, noise: average(&squares).scaled(freedom) }
        })
        .collect())
}

fn average(twists: &[Twist]) -> Twist {
    let sum = twists.iter().fold(Twist::REST, |sum, twist| sum.plus(*twist));
    sum.scaled(1.0 / twists.len() as f64)
}

/// Returns the mean poses over the time of an end.
fn end(batch: &mut Batch, step: f64) -> Vec<PlanarPose> {
    let steps = (END / LOOKS as f64 / step).round().max(1.0) as usize;
    let pose = |batch: &Batch, robot: usize| {
        let body = batch.body(robot);
        PlanarPose { x: body.position[0], y: body.position[1], heading: body.yaw() }
    };
    let first: Vec<f64> = (0..batch.len()).map(|robot| pose(batch, robot).heading).collect();
    let mut mean = vec![PlanarPose::default(); batch.len()];
    for _ in 0..LOOKS {
        batch.run(steps, step);
        for (robot, mean) in mean.iter_mut().enumerate() {
            let now = pose(batch, robot);
            mean.x += now.x / LOOKS as f64;
            mean.y += now.y / LOOKS as f64;
            mean.heading += wrap(now.heading - first[robot]) / LOOKS as f64;
        }
    }
    for (mean, first) in mean.iter_mut().zip(first) {
        mean.heading += first;
    }
    mean
}

/// Fits motion = mean + slide . lean by least squares.
fn fit(all: &[(Twist, [f64; 2])]) -> (Twist, [Twist; 2]) {
    let terms = DMatrix::from_fn(all.len(), 3, |i, j| if j == 0 { 1.0 } else { all[i].1[j - 1] });
    let motions = DMatrix::from_fn(all.len(), 3, |i, j| {
        let Twist { forward, lateral, yaw } = all[i].0;
        [forward, lateral, yaw][j]
    });
    let normal = terms.tr_mul(&terms) + DMatrix::from_diagonal_element(3, 3, 1e-9);
    let found = normal
        .cholesky()
        .map_or_else(|| DMatrix::zeros(3, 3), |factor| factor.solve(&terms.tr_mul(&motions)));
    let row =
        |i: usize| Twist { forward: found[(i, 0)], lateral: found[(i, 1)], yaw: found[(i, 2)] };
    (row(0), [row(1), row(2)])
}

/// What one pair has in common with others, and what not.
struct Common {
    factors: Vec<Factor>,
    own: Twist,
}

/// Finds the principal components of the robots' motions and slides.
fn factors(seen: &[Vec<Seen>], count: usize) -> Vec<Common> {
    let pairs = seen.first().map_or(0, Vec::len);
    // By pair: on a level floor, and on usual slopes forward and to the left; three speeds each.
    let number = |robot: usize, column: usize| {
        let seen = &seen[robot][column / COLUMNS];
        let [ahead, left] = seen.slide.map(|slide| slide.scaled(usual_slope()));
        let twist = [seen.mean, ahead, left][column % COLUMNS / 3];
        [twist.forward, twist.lateral, LEVER * twist.yaw][column % 3]
    };
    let mut table = DMatrix::from_fn(seen.len(), COLUMNS * pairs, number);
    let means = DVector::from_fn(COLUMNS * pairs, |column, _| table.column(column).mean());
    for column in 0..COLUMNS * pairs {
        table.column_mut(column).add_scalar_mut(-means[column]);
    }
    let freedom = (seen.len() as f64 - 1.0).max(1.0);
    let variances: Vec<f64> = table.column_iter().map(|c| c.norm_squared() / freedom).collect();
    let found = table.svd(false, true);
    let components = found.v_t.unwrap_or_else(|| DMatrix::zeros(0, COLUMNS * pairs));
    let count = count.min(components.nrows());
    (0..pairs)
        .map(|pair| {
            let loading = |k: usize, column: usize| {
                components[(k, COLUMNS * pair + column)] * found.singular_values[k] / freedom.sqrt()
            };
            let twist = |k: usize, first: usize| Twist {
                forward: loading(k, first),
                lateral: loading(k, first + 1),
                yaw: loading(k, first + 2) / LEVER,
            };
            let own = |axis: usize| {
                let explained = (0..count).map(|k| loading(k, axis).powi(2)).sum::<f64>();
                (variances[COLUMNS * pair + axis] - explained).max(LEAST * LEAST).sqrt()
            };
            Common {
                factors: (0..count)
                    .map(|k| Factor {
                        level: twist(k, 0),
                        slide: [3, 6].map(|first| twist(k, first).scaled(1.0 / usual_slope())),
                    })
                    .collect(),
                own: Twist { forward: own(0), lateral: own(1), yaw: own(2) / LEVER },
            }
        })
        .collect()
}
