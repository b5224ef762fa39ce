//! Identification of a real robot: which robot is it, and how sure is that?
//!
//! The paper's section II identifies one leg and calibrates the whole robot on its walks. Walks alone say little: they
//! are chaotic, and many robots walk nearly alike. So each value is measured where it shows, in this order:
//!
//! | file | experiment | shows |
//! |---|---|---|
//! | `scales.csv` | on four scales, level and tilted | mass, centre of mass |
//! | `legs.csv` | each leg pulled and twisted | stiffness |
//! | `air.csv` | hung and shaken, motion capture | mass, stiffness, damping |
//! | `drag.csv` | each foot dragged | friction |
//! | `drops.csv` | dropped | the floor's stiffness and damping |
//! | `walks.csv` | walks | all together; a third is held out |
//!
//! The first four are smooth: Gauss-Newton with the intervals of Laplace ([`fit`]); what a sensor may do wrong, its gain
//! and its bias, is unknown like everything else. The last two are contact: an [`ensemble`]. Formats and equations are in
//! `docs/sysid.md`.

pub mod air;
pub mod drag;
pub mod drops;
pub mod ensemble;
pub mod fit;
pub mod legs;
mod planned;
pub mod report;
pub mod scales;
pub mod synthetic;
pub mod table;
pub mod unknowns;
pub mod walks;

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use serde::Serialize;

use self::fit::{Experiment, Fit, Fitted, Posterior, Slip};
use self::unknowns::{Kind, Unknown, apply, unknowns, values};
use self::walks::Walks;
use super::measured::MeasuredError;
use flix_sim::experiment::probe::ProbeError;
use flix_sim::experiment::walk::{WalkError, require_walker};
use flix_sim::model::{ModelError, RobotModel};
use flix_sim::plant::Plant;

/// Standard deviations to either side of a value that hold 95 % of a normal distribution.
const NINETY_FIVE: f64 = 1.96;

/// The experiments in their order: file, and what it would bring.
pub const EXPERIMENTS: [(&str, &str); 6] = [
    ("scales", "mass and centre of mass"),
    ("legs", "stiffness of each leg, twist apart from bend"),
    ("air", "damping of each leg, and mass and stiffness once more"),
    ("drag", "friction of each foot"),
    ("drops", "stiffness and damping of the floor"),
    ("walks", "a check of the whole on walks that nothing was fitted to"),
];

/// Why nothing was identified.
#[derive(Debug, thiserror::Error)]
pub enum SysidError {
    /// A file is refused.
    #[error(transparent)]
    Measured(#[from] MeasuredError),
    /// The plan cannot walk.
    #[error(transparent)]
    Plan(#[from] WalkError),
    /// The plan, or what came out, is no robot.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// An experiment could not be simulated.
    #[error(transparent)]
    Probe(#[from] ProbeError),
    /// There is no folder of this name.
    #[error("{} is not a folder: name the one with the experiments", .0.display())]
    NoFolder(PathBuf),
    /// There is nothing to identify from.
    #[error(
        "{} holds none of the experiments (scales.csv, legs.csv, air.csv, drag.csv, drops.csv, walks.csv): sim-hil/docs/sysid.md \
         has their columns",
        .0.display()
    )]
    Empty(PathBuf),
    /// A file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Names the file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What was measured of one robot.
#[derive(Debug, Clone, Default)]
pub struct Data {
    scales: Option<scales::Scales>,
    legs: Option<legs::Legs>,
    air: Option<air::Air>,
    drag: Option<drag::Drag>,
    drops: Option<drops::Drops>,
    walks: Option<Walks>,
}

impl Data {
    /// Reads a folder.
    ///
    /// # Errors
    /// When a file is refused, with its line and column, or there is none.
    pub fn read(folder: &Path) -> Result<Self, SysidError> {
        if !folder.is_dir() {
            return Err(SysidError::NoFolder(folder.to_owned()));
        }
        let drops = drops::TABLE.read(folder)?.map(|rows| {
            let path = folder.join("drops.csv");
            let rows: Vec<_> = rows.into_iter().map(|(_, row)| row).collect();
            drops::Drops::new(&rows).map_err(|reason| MeasuredError::Whole { path, reason })
        });
        let data = Self {
            scales: scales::TABLE.read(folder)?.map(|rows| scales::Scales::read(&rows)),
            legs: legs::Legs::read(folder)?,
            air: air::Air::read(folder)?,
            drag: drag::TABLE.read(folder)?.map(|rows| drag::Drag::read(&rows)),
            drops: drops.transpose()?,
            walks: Walks::read(folder)?,
        };
        if data.given().iter().any(|given| *given) {
            Ok(data)
        } else {
            Err(SysidError::Empty(folder.to_owned()))
        }
    }

    /// Returns which of [`EXPERIMENTS`] there are.
    #[must_use]
    pub fn given(&self) -> [bool; 6] {
        [
            self.scales.is_some(),
            self.legs.is_some(),
            self.air.is_some(),
            self.drag.is_some(),
            self.drops.is_some(),
            self.walks.is_some(),
        ]
    }

    fn smooth(&self) -> [Option<&dyn Experiment>; 4] {
        [
            self.scales.as_ref().map(|it| it as &dyn Experiment),
            self.legs.as_ref().map(|it| it as &dyn Experiment),
            self.air.as_ref().map(|it| it as &dyn Experiment),
            self.drag.as_ref().map(|it| it as &dyn Experiment),
        ]
    }
}

/// One value of the robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// What it is called, with its unit.
    pub name: String,
    /// What it is about.
    pub kind: Kind,
    /// In the plan.
    pub plan: f64,
    /// Identified.
    pub value: f64,
    /// The truth is between this
    pub low: f64,
    /// and this in 95 of 100 cases.
    pub high: f64,
}

impl Estimate {
    fn new(name: String, kind: Kind, plan: f64, value: f64, deviation: f64) -> Self {
        let half = NINETY_FIVE * deviation;
        Self { name, kind, plan, value, low: value - half, high: value + half }
    }
}

/// What is left of the plan's uncertainty: for each of [`Kind::ALL`] the mean standard deviation as a share of the
/// prior's.
pub type Left = [f64; 5];

/// What was known after an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    /// Names the experiment.
    pub experiment: &'static str,
    /// What is left after it.
    pub left: Left,
    /// How far the readings are from what was expected beforehand, in standard deviations; experiments on the floor only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance: Option<f64>,
}

/// What one more experiment would bring.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// Names the experiment.
    pub experiment: &'static str,
    /// There is one already: this is about another.
    pub again: bool,
    /// Mean share by which the variance of a value falls.
    pub gain: f64,
    /// What would be left after it.
    pub left: Left,
}

/// How far walks of the identified robot are from the measured ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WalkScores {
    /// Root mean square error (equation 3) of the pairs by the robot that all of them identify, m/s.
    pub fitted_rmse_m_s: f64,
    /// Of the same pairs, each by the robot that is identified without it.
    pub held_out_rmse_m_s: f64,
}

/// What was found.
#[derive(Debug, Clone, Serialize)]
pub struct Identified {
    /// The robot.
    #[serde(skip)]
    pub model: RobotModel,
    /// Its values.
    pub estimates: Vec<Estimate>,
    /// Centre of mass from the plate's middle, rotors forward: x, y, z in mm.
    pub centre_mm: [Estimate; 3],
    /// The experiments, one after the other.
    pub stages: Vec<Stage>,
    /// Lines that do not fit the others, and were left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slips: Vec<Slip>,
    /// What is missing, of [`EXPERIMENTS`].
    pub missing: Vec<&'static str>,
    /// What would bring most, first.
    pub proposals: Vec<Proposal>,
    /// How well it walks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scores: Option<WalkScores>,
    /// Walks, measured and simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub walks: Option<Walks>,
    /// Readings and what the fit says of them.
    #[serde(skip)]
    pub fitted: Vec<Fitted>,
    /// Measured and simulated course after a drop: time (s) and height (mm).
    #[serde(skip)]
    pub drops: Option<[Vec<(f64, f64)>; 2]>,
}

/// Identifies a robot that was built by this plan. `advise` also works out what further experiments would bring.
///
/// # Errors
/// When the plan cannot walk, or no robot near it can be simulated.
pub fn identify(
    plan: &RobotModel,
    data: &Data,
    seed: u64,
    advise: bool,
    mut report: impl FnMut(&'static str),
) -> Result<Identified, SysidError> {
    require_walker(plan)?;
    let (base, unknowns) = unknowns(plan);
    let robot = (&base, unknowns.as_slice());
    let mut stages = Vec::new();
    let mut fit = Fit::new(&base, &unknowns);
    for experiment in data.smooth().into_iter().flatten() {
        report(experiment.name());
        fit.add(experiment)?;
        let left = left(fit.posterior(), &unknowns);
        stages.push(Stage { experiment: experiment.name(), left, distance: None });
    }
    let (fitted, slips) = (fit.fitted(), fit.slips());
    let mut posterior = fit.posterior().clone();
    let mut conditioned = |name: &'static str, (next, distance): (Posterior, f64)| {
        stages.push(Stage {
            experiment: name,
            left: left(&next, &unknowns),
            distance: Some(distance),
        });
        next
    };
    if let Some(drops) = &data.drops {
        report("drops");
        posterior = conditioned("drops", drops.condition(&posterior, robot, seed));
    }
    let mut walks = data.walks.clone();
    if let Some(walks) = &mut walks {
        report("walks");
        posterior = conditioned("walks", walks.condition(&posterior, robot, seed));
    }
    let point = &posterior.mean.as_slice()[..unknowns.len()];
    let mut model = apply(&base, &unknowns, point);
    model.name = "identified".to_owned();
    model.check()?;
    let scores = walks.as_ref().map(|walks| {
        let [fitted_rmse_m_s, held_out_rmse_m_s] =
            walks.square_errors().map(|sum| (sum / walks.pairs.len() as f64).sqrt());
        WalkScores { fitted_rmse_m_s, held_out_rmse_m_s }
    });
    let drops = data.drops.as_ref().and_then(|drops| {
        let simulated = drops.simulate(&model, seed)?;
        let times = drops.course().into_iter().map(|(t, _)| t);
        Some([drops.course(), times.zip(simulated).collect()])
    });
    let missing = EXPERIMENTS.iter().zip(data.given()).filter(|(_, given)| !given);
    Ok(Identified {
        estimates: estimates(&unknowns, &posterior),
        centre_mm: centre(plan, robot, &posterior)?,
        stages,
        slips,
        missing: missing.map(|((name, _), _)| *name).collect(),
        proposals: if advise { proposals(data, robot, &posterior, seed)? } else { Vec::new() },
        scores,
        walks,
        fitted,
        drops,
        model,
    })
}

fn left(posterior: &Posterior, unknowns: &[Unknown]) -> Left {
    Kind::ALL.map(|kind| {
        let of_kind = unknowns.iter().enumerate().filter(|(_, unknown)| unknown.kind == kind);
        let each: Vec<f64> = of_kind.map(|(index, _)| posterior.deviation(index)).collect();
        each.iter().sum::<f64>() / each.len().max(1) as f64
    })
}

fn estimates(unknowns: &[Unknown], posterior: &Posterior) -> Vec<Estimate> {
    let each = unknowns.iter().enumerate().map(|(index, unknown)| {
        let deviation = unknown.deviation(posterior.deviation(index));
        let value = unknown.value(posterior.mean[index]);
        Estimate::new(unknown.name.clone(), unknown.kind, unknown.value(0.0), value, deviation)
    });
    each.collect()
}

/// Centre of mass of a robot with straight legs and its rotors forward, from the plate's middle, mm.
///
/// # Errors
/// When the model is refused.
pub(crate) fn centre_of_mass(model: &RobotModel) -> Result<[f64; 3], ModelError> {
    let plant = Plant::new(model)?;
    let (_, centre, _) = plant.mass_properties();
    Ok(core::array::from_fn(|i| 1e3 * (centre[i] - plant.body().position[i])))
}

/// Step of the difference quotients of the centre of mass, in spreads.
const NUDGE: f64 = 0.01;

fn centre(
    plan: &RobotModel,
    (base, unknowns): (&RobotModel, &[Unknown]),
    posterior: &Posterior,
) -> Result<[Estimate; 3], ModelError> {
    let count = unknowns.len();
    let point = &posterior.mean.as_slice()[..count];
    let here = centre_of_mass(&apply(base, unknowns, point))?;
    let mut slopes = DMatrix::zeros(3, count);
    for index in (0..count).filter(|i| unknowns[*i].kind == Kind::Mass) {
        let mut nudged = point.to_vec();
        nudged[index] += NUDGE;
        let there = centre_of_mass(&apply(base, unknowns, &nudged))?;
        (0..3).for_each(|axis| slopes[(axis, index)] = (there[axis] - here[axis]) / NUDGE);
    }
    let covariance =
        &slopes * posterior.covariance.view((0, 0), (count, count)) * slopes.transpose();
    let planned = centre_of_mass(plan)?;
    Ok(core::array::from_fn(|axis| {
        let name = format!("centre_of_mass_{}_mm", ["x", "y", "z"][axis]);
        let deviation = covariance[(axis, axis)].max(0.0).sqrt();
        Estimate::new(name, Kind::Mass, planned[axis], here[axis], deviation)
    }))
}

fn proposals(
    data: &Data,
    robot: (&RobotModel, &[Unknown]),
    posterior: &Posterior,
    seed: u64,
) -> Result<Vec<Proposal>, SysidError> {
    let (base, unknowns) = robot;
    let planned: [Box<dyn Experiment>; 4] = [
        Box::new(planned::planned_scales()),
        Box::new(planned::planned_legs()),
        Box::new(air::Air::planned(&air::USUAL)),
        Box::new(planned::planned_drag()),
    ];
    let given = data.given();
    let proposal = |index: usize, next: &Posterior| {
        let reduction = |i: usize| {
            1.0 - (next.deviation(i) / posterior.deviation(i).max(f64::MIN_POSITIVE)).powi(2)
        };
        Proposal {
            experiment: EXPERIMENTS[index].0,
            again: given[index],
            gain: (0..unknowns.len()).map(reduction).sum::<f64>() / unknowns.len() as f64,
            left: left(next, unknowns),
        }
    };
    let mut all = Vec::new();
    for (index, experiment) in planned.iter().enumerate() {
        let fit = Fit::after(base, unknowns, posterior.clone());
        let covariance = fit.expect(experiment.as_ref())?;
        all.push(proposal(index, &Posterior { mean: posterior.mean.clone(), covariance }));
    }
    let model = apply(base, unknowns, &posterior.mean.as_slice()[..unknowns.len()]);
    if !given[4] {
        let mut drops = drops::Drops::planned();
        drops.expect(&model, seed);
        all.push(proposal(4, &drops.condition(posterior, robot, seed).0));
    }
    if !given[5] {
        let mut walks = Walks::planned();
        walks.expect(&model, seed);
        all.push(proposal(5, &walks.condition(posterior, robot, seed).0));
    }
    all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    Ok(all)
}

/// Returns the values of a robot that is known, in the order of [`Identified::estimates`]; its last load is the mass
/// besides the plan.
#[must_use]
pub fn truth(plan: &RobotModel, robot: &RobotModel) -> Vec<f64> {
    values(robot, &unknowns(plan).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(file: &str, text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(file), text).unwrap();
        Data::read(folder.path()).unwrap_err().to_string()
    }

    #[test]
    fn files_that_do_not_fit_are_refused_with_their_line_and_column() {
        let legs = "leg,fx_n,fy_n,fz_n,tx_n_m,ty_n_m,tz_n_m,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n";
        let both = refused(
            "legs.csv",
            &format!("{legs}fl,1,0,0,0,0,1,0,0,0,0,0,0\nfl,1,0,0,0,0,0,0,0,0,0,0,0\n"),
        );
        assert!(both.contains("legs.csv, line 2, column 2: a row is a pull"), "{both}");
        let metres =
            refused("scales.csv", "roll_deg,pitch_deg,fl_g,fr_g,rl_g,rr_g\n0,0,90,90,90000,90\n");
        assert!(metres.contains("scales.csv, line 2, column 5: 90000 is outside"), "{metres}");
        let one = refused("drag.csv", "leg,direction_deg,load_n,drag_n\nfl,0,1,0.5\n");
        assert!(one.contains("1 rows of numbers; at least 2"), "{one}");
        let mut air =
            "test,f_hz,theta_deg,t_s,phase_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n".to_owned();
        for picture in 0..60 {
            let (time, phase) = (f64::from(picture) / 60.0, 180.2 * f64::from(picture));
            air += &format!("1,30,0,{time},{phase},0,0,{},0,0,0\n", 0.1 * phase.to_radians().cos());
        }
        let aliased = refused("air.csv", &air);
        assert!(aliased.contains("aliasing") && aliased.contains("2 phases"), "{aliased}");
        let nan = refused(
            "walks.csv",
            "f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s\n30,0,NaN,0,0\n",
        );
        assert!(nan.contains("line 2, column 3: \"NaN\""), "{nan}");
    }

    #[test]
    fn from_drags_alone_frictions_are_found_and_the_rest_is_proposed() {
        let folder = tempfile::tempdir().unwrap();
        let mut text = "leg,direction_deg,load_n,drag_n\n".to_owned();
        for (leg, friction) in [("fl", 0.60), ("fr", 0.65), ("rl", 0.70), ("rr", 0.75)] {
            for (direction, load, error) in
                [(0, 1.0, 0.99), (90, 1.0, 1.01), (0, 2.0, 1.01), (90, 2.0, 0.99)]
            {
                text += &format!("{leg},{direction},{load},{}\n", friction * load * error);
            }
        }
        std::fs::write(folder.path().join("drag.csv"), text).unwrap();
        let data = Data::read(folder.path()).unwrap();
        let found = identify(&RobotModel::named("W").unwrap(), &data, 1, false, |_| {}).unwrap();
        let of = |name: &str| found.estimates.iter().find(|it| it.name == name).unwrap();
        let rear = of("rr_friction");
        assert!((rear.value / 0.75 - 1.0).abs() < 0.02 && rear.low < 0.75 && rear.high > 0.75);
        let stiffness = of("fl_bend_stiffness_n_m_rad");
        assert!((stiffness.value / stiffness.plan - 1.0).abs() < 1e-12);
        assert_eq!(found.missing, ["scales", "legs", "air", "drops", "walks"]);
    }
}
