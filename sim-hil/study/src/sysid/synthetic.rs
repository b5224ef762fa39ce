//! Hidden robots: how well the identification does on robots of which the truth is known to nobody but the score.
//!
//! A hidden robot is the plan with every leg's stiffness and damping 5 to 10 % off, every friction by up to a quarter,
//! the core and the floor off, and a mass somewhere on its body. A laboratory measures it, with sensors that have
//! noise, bias and 0.5 % error of gain, and writes the files. What identifies it reads them, as it reads any others.

use std::path::Path;

use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;

use super::fit::{Experiment, GAIN};
use super::planned::{drag_rows, leg_rows, planned_drag, planned_legs, planned_scales};
use super::unknowns::Kind;
use super::{Data, Identified, SysidError, air, centre_of_mass, drag, drops, identify, legs};
use super::{scales, truth, walks};
use crate::write_whole;
use flix_sim::experiment::probe::ProbeError;
use flix_sim::experiment::walk::{ideal_motion, require_walker};
use flix_sim::model::{Load, RobotModel};

/// Everything random of one robot and its laboratory.
struct Chance(Xoshiro256PlusPlus);

impl Chance {
    /// A stream of its own for each seed and purpose.
    fn new(seed: u64, purpose: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ purpose))
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn normal(&mut self, deviation: f64) -> f64 {
        let normal: f64 = StandardNormal.sample(&mut self.0);
        deviation * normal
    }

    /// What the sensors of an experiment do wrong.
    fn sensors(&mut self, experiment: &dyn Experiment) -> Vec<f64> {
        experiment.sensors().iter().map(|sensor| self.normal(sensor.spread)).collect()
    }
}

/// Draws a robot that was built by this plan, as well as hands can.
#[must_use]
pub fn hidden(plan: &RobotModel, seed: u64) -> RobotModel {
    let mut chance = Chance::new(seed, 1);
    let mut robot = plan.clone();
    robot.body.total_mass_g *= chance.within(0.97, 1.03);
    robot.body.offset_x_mm += chance.within(-3.0, 3.0);
    robot.body.offset_y_mm += chance.within(-3.0, 3.0);
    robot.core.z_mm += chance.within(-3.0, 3.0);
    robot.contact.stiffness_n_per_m *= chance.within(0.7, 1.3);
    robot.contact.damping_n_s_per_m *= chance.within(0.7, 1.3);
    robot.load.push(Load {
        mass_g: chance.within(5.0, 40.0),
        x_mm: chance.within(-50.0, 50.0),
        y_mm: chance.within(-30.0, 30.0),
        z_mm: chance.within(0.0, 30.0),
    });
    for leg in robot.legs.iter_mut().flat_map(|legs| legs.each_mut()) {
        let mut off = || 1.0 + chance.within(0.05, 0.10) * chance.within(-1.0, 1.0).signum();
        leg.bend_stiffness_factor *= off();
        leg.twist_stiffness_factor *= off();
        leg.bend_damping_factor *= off();
        leg.twist_damping_factor *= off();
        leg.friction *= chance.within(0.75, 1.25);
    }
    robot
}

/// How the laboratory measures: step of the simulation that stands in for it, s.
const STEP: f64 = 1e-4;
/// Time of each shake in the air, s, and steps between two pictures of its cameras (250 Hz).
const SHAKE: (f64, usize) = (1.0, 40);
/// Noise of a marker, mm, and of a body's rotation, degrees.
const CAMERA: [f64; 2] = [0.1, 0.06];
/// Steps between two pictures of a drop (1 kHz), and how long it is watched, s.
const DROP: (usize, f64) = (10, 0.25);
/// Walks of each pair, and how long each is, s.
pub const WALKS: (u64, f64) = (2, 1.0);
/// The same for a first look.
pub const QUICK_WALKS: (u64, f64) = (1, 0.5);

/// Measures a robot and writes the files that [`Data::read`] reads.
///
/// # Errors
/// When the robot cannot be simulated, or a file not written.
pub fn measure(
    robot: &RobotModel,
    seed: u64,
    walks: (u64, f64),
    folder: &Path,
) -> Result<(), SysidError> {
    let mut chance = Chance::new(seed, 2);
    // No laboratory knows how good its sensors are.
    let mut quality = || chance.within(0.7, 1.4);
    let quality: [f64; 6] = core::array::from_fn(|_| quality());
    let write = |name: &str, text: String| {
        let path = folder.join(name).with_extension("csv");
        write_whole(&path, text.as_bytes()).map_err(|source| SysidError::Write { path, source })
    };
    let rows = weigh(robot, &mut chance, quality[0])?;
    write("scales", scales::TABLE.to_csv(&[], &rows))?;
    let rows = bend(robot, &mut chance, quality[1])?;
    write("legs", legs::TABLE.to_csv(&[], &rows))?;
    let rows = shake(robot, &mut chance, quality[2])?;
    write("air", air::TABLE.to_csv(&air::FEET, &rows))?;
    let rows = pull(robot, &mut chance, quality[3])?;
    write("drag", drag::TABLE.to_csv(&[], &rows))?;
    let rows = fall(robot, &mut chance, quality[4], seed);
    write("drops", drops::TABLE.to_csv(&[], &rows))?;
    let rows = walk(robot, &mut chance, seed, walks);
    write("walks", walks::TABLE.to_csv(&walks::OPTIONAL[..1], &rows))
}

fn weigh(
    robot: &RobotModel,
    chance: &mut Chance,
    quality: f64,
) -> Result<Vec<Vec<f64>>, ProbeError> {
    let scales = planned_scales();
    let sensors = chance.sensors(&scales);
    let read = scales.observe(&scales.simulate(robot)?, &sensors);
    let noise = quality * scales.noise()[0];
    let row = |([roll, pitch], loads): ([f64; 2], &[f64])| {
        let noisy: Vec<f64> = loads.iter().map(|g| g + chance.normal(noise)).collect();
        [&[roll, pitch], noisy.as_slice()].concat()
    };
    Ok(scales::USUAL.into_iter().zip(read.chunks(4)).map(row).collect())
}

fn bend(
    robot: &RobotModel,
    chance: &mut Chance,
    quality: f64,
) -> Result<Vec<Vec<f64>>, ProbeError> {
    let legs = planned_legs();
    let sensors = chance.sensors(&legs);
    let noise = legs.noise();
    let moved = legs.simulate(robot)?;
    let row = |(mut row, moved): (Vec<f64>, &[f64])| {
        let size = row[1..7].iter().map(|c| c * c).sum::<f64>().sqrt();
        let twists = usize::from(row[4..7].iter().any(|t| *t != 0.0));
        let cell = 1.0 + sensors[twists] + sensors[4 + twists] / size;
        row[1..7].iter_mut().for_each(|load| *load *= cell);
        for (i, moved) in moved.iter().enumerate() {
            let turned = usize::from(i >= 3);
            let unit = [1e3, 1f64.to_degrees()][turned];
            let noise = chance.normal(quality * noise[turned]);
            let seen = moved * (1.0 + sensors[2 + turned]) + sensors[6 + i] + noise;
            row[7 + i] = unit * seen;
        }
        row
    };
    Ok(leg_rows().into_iter().zip(moved.chunks(6)).map(row).collect())
}

fn shake(
    robot: &RobotModel,
    chance: &mut Chance,
    quality: f64,
) -> Result<Vec<Vec<f64>>, ProbeError> {
    let [gain, delay, x, y, z] = {
        let sensors = chance.sensors(&air::Air::planned(&air::USUAL));
        core::array::from_fn(|i| sensors[i])
    };
    let axes = nalgebra::Vector3::new(x, y, z);
    let mut rows = Vec::new();
    for (test, (f, theta)) in air::USUAL.into_iter().enumerate() {
        let seen = air::shaken(robot, (f, theta), STEP, SHAKE.0, SHAKE.1)?;
        for (index, time) in seen.times.iter().enumerate() {
            // The phase is known now, the picture is a delay old.
            let phase = seen.phases[index] + core::f64::consts::TAU * f * delay;
            let mut row = vec![test as f64 + 1.0, f, theta, *time, phase.to_degrees()];
            for (vector, signals) in seen.signals.chunks(3).enumerate() {
                let v = nalgebra::Vector3::from_fn(|i, _| signals[i][index]);
                let turned = usize::from(vector == 1);
                let unit = [1e3 * (1.0 + gain), 1f64.to_degrees()][turned];
                let noise = quality * CAMERA[turned];
                row.extend((unit * (v + axes.cross(&v))).iter().map(|c| c + chance.normal(noise)));
            }
            rows.push(row);
        }
    }
    Ok(rows)
}

fn pull(
    robot: &RobotModel,
    chance: &mut Chance,
    quality: f64,
) -> Result<Vec<Vec<f64>>, ProbeError> {
    let drag = planned_drag();
    let sensors = chance.sensors(&drag);
    let read = drag.observe(&drag.simulate(robot)?, &sensors);
    let row = |(mut row, share): ([f64; 4], f64)| {
        row[3] = row[2] * (share + chance.normal(quality * drag.noise()[0]));
        row.to_vec()
    };
    Ok(drag_rows().into_iter().zip(read).map(row).collect())
}

fn fall(robot: &RobotModel, chance: &mut Chance, quality: f64, seed: u64) -> Vec<Vec<f64>> {
    let (height, repeats) = drops::USUAL;
    let gain = 1.0 + chance.normal(GAIN);
    let mut rows = Vec::new();
    for drop in 0..repeats {
        let start = Chance::new(seed, 100 + drop as u64).0.random();
        let fallen = drops::fall(robot, height, start, STEP, (DROP.1, DROP.0));
        rows.extend(fallen.into_iter().flatten().map(|(t, z)| {
            vec![drop as f64 + 1.0, height, t, gain * z + chance.normal(quality * CAMERA[0])]
        }));
    }
    rows
}

fn walk(
    robot: &RobotModel,
    chance: &mut Chance,
    seed: u64,
    (repeats, seconds): (u64, f64),
) -> Vec<Vec<f64>> {
    let gain = 1.0 + chance.normal(GAIN);
    let pairs = flix_host::nav::PAPER_PAIRS.map(|(_, f, theta)| (f64::from(f), f64::from(theta)));
    let mut rows = Vec::new();
    for (index, pair) in pairs.into_iter().enumerate() {
        for repeat in 0..repeats {
            let start = Chance::new(seed, 1000 + 100 * index as u64 + repeat).0.random();
            if let Some(motion) = ideal_motion(robot, pair, seconds, STEP, start) {
                let (forward, lateral) = (gain * motion.forward, gain * motion.lateral);
                rows.push(vec![pair.0, pair.1, forward, lateral, motion.yaw, seconds]);
            }
        }
    }
    rows
}

/// How well one hidden robot was identified.
#[derive(Debug, Clone, Default)]
pub struct Score {
    /// For each of stiffness, damping, friction and centre: whether each interval holds the truth.
    inside: [Vec<bool>; 4],
    /// For each of stiffness, damping, friction and centre: errors as shares; of the centre, mm.
    errors: [Vec<f64>; 4],
    /// Sums of the square errors of the walks, as they are fitted and as they are held out.
    walks: [f64; 2],
}

/// Hides a robot, measures it into `folder` with so many walks of so many seconds a pair, identifies it from the files,
/// and compares.
///
/// # Errors
/// As [`measure`] and [`identify`].
pub fn trial(
    plan: &RobotModel,
    seed: u64,
    walks: (u64, f64),
    folder: &Path,
) -> Result<Score, SysidError> {
    require_walker(plan)?;
    let robot = hidden(plan, seed);
    measure(&robot, seed, walks, folder)?;
    let found = identify(plan, &Data::read(folder)?, seed, false, |_| {})?;
    score(plan, &robot, &found)
}

fn score(plan: &RobotModel, robot: &RobotModel, found: &Identified) -> Result<Score, SysidError> {
    let mut score = Score::default();
    for (estimate, truth) in found.estimates.iter().zip(truth(plan, robot)) {
        let kind = match estimate.kind {
            Kind::Stiffness => 0,
            Kind::Damping => 1,
            Kind::Friction => 2,
            Kind::Mass | Kind::Floor => continue,
        };
        score.inside[kind].push((estimate.low..=estimate.high).contains(&truth));
        score.errors[kind].push((estimate.value / truth - 1.0).abs());
    }
    let truth = centre_of_mass(robot)?;
    let mut square = 0.0;
    for (estimate, truth) in found.centre_mm.iter().zip(truth) {
        score.inside[3].push((estimate.low..=estimate.high).contains(&truth));
        square += (estimate.value - truth).powi(2);
    }
    score.errors[3].push(square.sqrt());
    if let Some(walks) = &found.walks {
        score.walks = walks.square_errors();
    }
    Ok(score)
}

/// A number for each of stiffness, damping, friction and centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Kinds {
    /// Bend and twist stiffness of the legs.
    pub stiffness: f64,
    /// Bend and twist damping of the legs.
    pub damping: f64,
    /// Friction of the feet.
    pub friction: f64,
    /// Centre of mass.
    pub centre: f64,
}

/// The verdict over all hidden robots.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Verdict {
    /// How many robots.
    pub robots: u64,
    /// Share of the 95 % intervals that hold the truth.
    pub coverage: Kinds,
    /// Median error: shares; of the centre the distance, mm.
    pub median_error: Kinds,
    /// Root mean square error of the walks, each by the robot identified without it, over that by the robot that all identify.
    pub held_out_ratio: f64,
    /// All within their limits.
    pub pass: bool,
}

/// Limits of a verdict: coverage, median error of stiffness and friction as a share and of the centre in mm, ratio.
pub const COVERAGE: core::ops::RangeInclusive<f64> = 0.90..=0.99;
/// Robots from which on coverage and held-out walks are judged: fewer do not separate 95 % from 99 %.
pub const ENOUGH: usize = 100;
/// Largest median error of stiffness and friction, as a share.
pub const MEDIAN_SHARE: f64 = 0.03;
/// Largest median error of the centre of mass, mm.
pub const MEDIAN_CENTRE_MM: f64 = 0.5;
/// Largest ratio of the errors of held-out and fitted walks.
pub const HELD_OUT_RATIO: f64 = 1.2;

impl Verdict {
    /// Returns whether coverage and held-out walks are judged; of fewer than [`ENOUGH`] robots they are chance.
    #[must_use]
    pub const fn has_enough(&self) -> bool {
        self.robots >= ENOUGH as u64
    }
}

/// Judges the scores of all robots.
#[must_use]
pub fn judge(scores: &[Score]) -> Verdict {
    let of = |each: fn(&[Score], usize) -> f64| Kinds {
        stiffness: each(scores, 0),
        damping: each(scores, 1),
        friction: each(scores, 2),
        centre: each(scores, 3),
    };
    let coverage = of(|scores, kind| {
        let all: Vec<bool> = scores.iter().flat_map(|s| s.inside[kind].clone()).collect();
        all.iter().filter(|inside| **inside).count() as f64 / all.len().max(1) as f64
    });
    let median_error = of(|scores, kind| {
        let mut all: Vec<f64> = scores.iter().flat_map(|s| s.errors[kind].clone()).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
    });
    let sum = |which: usize| scores.iter().map(|score| score.walks[which]).sum::<f64>();
    let held_out_ratio = (sum(1) / sum(0)).sqrt();
    let covers = |kinds: &Kinds| {
        [kinds.stiffness, kinds.damping, kinds.friction, kinds.centre]
            .iter()
            .all(|share| COVERAGE.contains(share))
    };
    Verdict {
        robots: scores.len() as u64,
        coverage,
        median_error,
        held_out_ratio,
        pass: (scores.len() < ENOUGH || covers(&coverage) && held_out_ratio <= HELD_OUT_RATIO)
            && median_error.stiffness <= MEDIAN_SHARE
            && median_error.friction <= MEDIAN_SHARE
            && median_error.centre <= MEDIAN_CENTRE_MM,
    }
}

#[cfg(test)]
mod tests {
    use rayon::iter::{IntoParallelIterator as _, ParallelIterator as _};

    use super::*;

    #[test]
    fn three_hidden_robots_are_found_from_their_files() {
        let plan = RobotModel::named("W").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let scores: Vec<Score> = (1..=3_u64)
            .into_par_iter()
            .map(|seed| {
                let folder = folder.path().join(seed.to_string());
                trial(&plan, seed, QUICK_WALKS, &folder).unwrap()
            })
            .collect();
        let verdict = judge(&scores);
        let Kinds { stiffness, damping, friction, centre } = verdict.coverage;
        assert!(stiffness.min(damping).min(friction).min(centre) > 0.7, "{verdict:?}");
        let off = verdict.median_error;
        assert!(off.stiffness < MEDIAN_SHARE && off.friction < MEDIAN_SHARE, "{verdict:?}");
        assert!(off.damping < 0.08 && off.centre < MEDIAN_CENTRE_MM, "{verdict:?}");
    }

    #[test]
    fn a_slip_of_the_pen_is_named_and_leaves_the_intervals_as_they_were() {
        let plan = RobotModel::named("W").unwrap();
        let (robot, mut chance) = (hidden(&plan, 1), Chance::new(1, 2));
        let tables = [
            ("scales.csv", scales::TABLE.to_csv(&[], &weigh(&robot, &mut chance, 1.0).unwrap())),
            ("legs.csv", legs::TABLE.to_csv(&[], &bend(&robot, &mut chance, 1.0).unwrap())),
            ("drag.csv", drag::TABLE.to_csv(&[], &pull(&robot, &mut chance, 1.0).unwrap())),
        ];
        // File, line from 1, column from 0, and the change of the value.
        type Slipped<'a> = (&'a str, usize, usize, fn(f64) -> String);
        let found = |slip: Option<Slipped<'_>>| {
            let folder = tempfile::tempdir().unwrap();
            for (name, text) in &tables {
                let mut rows: Vec<Vec<String>> =
                    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
                if let Some((_, line, column, change)) = slip.filter(|slip| slip.0 == *name) {
                    let cell = &mut rows[line - 1][column];
                    *cell = change(cell.parse().unwrap_or_default());
                }
                let lines: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
                std::fs::write(folder.path().join(name), lines.join("\n") + "\n").unwrap();
            }
            identify(&plan, &Data::read(folder.path()).unwrap(), 1, false, |_| {}).unwrap()
        };
        let clean = found(None);
        assert_eq!(clean.slips, []);
        let shift = |value: f64| (10.0 * value).to_string();
        let flip = |value: f64| (-value).to_string();
        let slips: [Slipped<'_>; 5] = [
            ("scales.csv", 4, 3, shift),
            ("legs.csv", 2, 7, flip),
            ("legs.csv", 4, 8, shift),
            // Of another leg.
            ("legs.csv", 4, 0, |_| "fr".to_owned()),
            ("drag.csv", 7, 3, shift),
        ];
        for (name, line, column, change) in slips {
            let slipped = found(Some((name, line, column, change)));
            let [slip] = &slipped.slips[..] else { panic!("{name}, {line}: {:?}", slipped.slips) };
            assert_eq!((slip.experiment, slip.line), (&name[..name.len() - 4], line as u64));
            let text =
                tables.iter().find(|it| it.0 == name).unwrap().1.lines().nth(line - 1).unwrap();
            if column > 0 {
                let truth: f64 = text.split(',').nth(column).unwrap().parse().unwrap();
                assert!((slip.expected - truth).abs() < 4.0 * slip.deviation, "{slip:?}, {truth}");
            }
            for (clean, slipped) in clean.estimates.iter().zip(&slipped.estimates) {
                let width = (slipped.high - slipped.low) / (clean.high - clean.low);
                assert!((0.8..1.25).contains(&width), "{name}, {line}: {}: {width}", clean.name);
            }
        }
    }

    #[test]
    fn a_verdict_fails_where_intervals_are_too_narrow_or_too_wide() {
        let scores = |inside: usize, error: f64, held_out: f64| -> Vec<Score> {
            let one = |robot| Score {
                inside: [(); 4].map(|()| vec![robot < inside]),
                errors: [(); 4].map(|()| vec![error]),
                walks: [1.0, held_out],
            };
            (0..ENOUGH).map(one).collect()
        };
        let passes = |inside, error, held_out| judge(&scores(inside, error, held_out)).pass;
        assert!(passes(95, 0.01, 1.0));
        assert!(!passes(89, 0.01, 1.0) && !passes(100, 0.01, 1.0));
        assert!(!passes(95, 0.04, 1.0) && !passes(95, 0.01, 1.5));
    }
}
