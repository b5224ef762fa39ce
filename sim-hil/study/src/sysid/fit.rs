//! Gauss-Newton over several experiments at once, with the intervals of Laplace's approximation.
//!
//! Unknown are the robot's values and what every sensor does wrong: its gain, its bias. Each has a Gaussian prior and is
//! counted in its spread, `x ~ N(0, 1)`. An experiment adds `|W^(1/2) (y - f(x))|^2` to `|x|^2`; at the minimum the
//! inverse of `H = 1 + sum J^T W J` is the covariance. The noise of each kind of reading is estimated with the rest, from
//! what the fit leaves over, so that nobody has to know it: `s^2 = (n0 s0^2 + |r|^2)/(n0 + n - p)` with the readings `n`,
//! the parameters `p` that they determine, and a first guess `s0` that counts as `n0` readings.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::unknowns::{Kind, Unknown, apply};
use flix_sim::experiment::probe::ProbeError;
use flix_sim::model::RobotModel;

/// Something that a sensor may do wrong, as the standard deviation of its prior in its own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// What it is called.
    pub name: &'static str,
    /// Standard deviation.
    pub spread: f64,
}

/// Where a reading stands in its file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Line, from 1.
    pub line: u64,
    /// Name of the column.
    pub column: &'static str,
    /// The reading over the value in the file.
    pub unit: f64,
}

/// A line that does not fit the others, and is left out: a slip of the pen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Slip {
    /// Names the experiment.
    pub experiment: &'static str,
    /// Line of its file, from 1.
    pub line: u64,
    /// Column of the value that fits worst.
    pub column: &'static str,
    /// The value, in the column's unit.
    pub value: f64,
    /// Value that the other lines predict.
    pub expected: f64,
    /// Standard deviation of that.
    pub deviation: f64,
}

/// Gain error of a good sensor, as a share.
pub const GAIN: f64 = 0.005;

/// An experiment that is smooth in the robot's values.
pub trait Experiment: Sync + Send {
    /// Its file, without `.csv`.
    fn name(&self) -> &'static str;
    /// Returns whether values of this kind show in it.
    fn shows(&self, kind: Kind) -> bool;
    /// Computes what a robot does in it.
    ///
    /// # Errors
    /// When the model is refused or the plant diverges.
    fn simulate(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError>;
    /// Computes the same well enough for derivatives: in less time, if it can.
    ///
    /// # Errors
    /// As [`Experiment::simulate`].
    fn sketch(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        self.simulate(model)
    }
    /// What its sensors may do wrong.
    fn sensors(&self) -> Vec<Sensor>;
    /// Computes the readings from what the robot does and what the sensors do wrong (in their own units).
    fn observe(&self, done: &[f64], sensors: &[f64]) -> Vec<f64>;
    /// The readings.
    fn measured(&self) -> &[f64];
    /// Guesses of the noise of each kind of reading.
    fn noise(&self) -> Vec<f64>;
    /// The kind of a reading, as an index of [`Experiment::noise`].
    fn kind_of(&self, reading: usize) -> usize;
    /// Returns where a reading stands in the file; nothing for a reading that is planned, or computed from many lines.
    fn place(&self, _reading: usize) -> Option<Place> {
        None
    }
}

/// How many readings the guess of the noise counts as.
const GUESS_READINGS: f64 = 4.0;
/// Step of the difference quotients, in spreads.
const NUDGE: f64 = 0.05;
/// How far a point may be from where derivatives were taken, in spreads.
const NEAR: f64 = 0.25;
/// Steps of the search at each stage.
const MOST_STEPS: usize = 12;
/// A step that is shorter than this share of each standard deviation ends the search.
const SETTLED: f64 = 0.03;
/// Halvings of a step that does not better the fit.
const HALVINGS: usize = 6;
/// A line with a reading as many standard deviations off the fit is a slip of the pen. Chance shows one in 500 million readings.
const SLIPPED: f64 = 6.0;
/// Most lines that are left out of an experiment.
const MOST_SLIPS: usize = 3;

/// Returns the standard deviation of readings from a guess of it, which counts as [`GUESS_READINGS`], and the sum of the squares of so
/// many residuals.
fn estimated_noise(guess: f64, squares: f64, count: f64) -> f64 {
    ((GUESS_READINGS * guess.powi(2) + squares) / (GUESS_READINGS + count)).sqrt()
}

/// An experiment inside a fit.
struct Block<'a> {
    experiment: &'a dyn Experiment,
    sensors: Vec<Sensor>,
    /// Where its sensors begin among the unknowns.
    first: usize,
    /// Standard deviation of each kind of reading.
    noise: Vec<f64>,
    /// Readings less what is predicted at the present point.
    residual: DVector<f64>,
    /// Lines of the file that are left out.
    left_out: Vec<u64>,
    jacobian: DMatrix<f64>,
    /// Where the Jacobian was taken.
    taken: Option<DVector<f64>>,
}

/// The robot's values, some known better than others; then the sensors'.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// In spreads of the prior.
    pub mean: DVector<f64>,
    /// The same.
    pub covariance: DMatrix<f64>,
}

impl Posterior {
    /// Creates the prior of so many unknowns.
    #[must_use]
    pub fn prior(unknowns: usize) -> Self {
        Self { mean: DVector::zeros(unknowns), covariance: DMatrix::identity(unknowns, unknowns) }
    }

    /// Returns the standard deviation of one.
    #[must_use]
    pub fn deviation(&self, index: usize) -> f64 {
        self.covariance[(index, index)].max(0.0).sqrt()
    }
}

/// How one experiment fits.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// Its name.
    pub name: &'static str,
    /// Readings, and what the fit says they should be.
    pub readings: Vec<(f64, f64)>,
    /// Estimated noise of each kind of reading.
    pub noise: Vec<f64>,
    /// What it was guessed to be.
    pub guess: Vec<f64>,
    /// The kind of each.
    pub kinds: Vec<usize>,
}

/// Several experiments, one after the other.
pub struct Fit<'a> {
    base: &'a RobotModel,
    unknowns: &'a [Unknown],
    blocks: Vec<Block<'a>>,
    posterior: Posterior,
}

impl<'a> Fit<'a> {
    /// Begins at the plan.
    #[must_use]
    pub fn new(base: &'a RobotModel, unknowns: &'a [Unknown]) -> Self {
        Self::after(base, unknowns, Posterior::prior(unknowns.len()))
    }

    /// Goes on from what is known.
    #[must_use]
    pub fn after(base: &'a RobotModel, unknowns: &'a [Unknown], posterior: Posterior) -> Self {
        Self { base, unknowns, blocks: Vec::new(), posterior }
    }

    /// Returns what is known so far.
    #[must_use]
    pub fn posterior(&self) -> &Posterior {
        &self.posterior
    }

    /// Adds an experiment, with what came before as its prior.
    ///
    /// # Errors
    /// When no robot near the plan can be simulated.
    pub fn add(&mut self, experiment: &'a dyn Experiment) -> Result<(), ProbeError> {
        self.join(experiment);
        let residuals = self.residuals(&self.posterior.mean)?;
        self.accept(self.posterior.mean.clone(), residuals);
        self.search()?;
        for _ in 0..MOST_SLIPS {
            let Some(block) = self.blocks.last_mut() else { break };
            let Some(line) = block.slipped() else { break };
            block.left_out.push(line);
            block.noise = block.experiment.noise();
            self.search()?;
        }
        if let Some(factor) = self.precision().cholesky() {
            self.posterior.covariance = factor.inverse();
        }
        Ok(())
    }

    /// Goes to the minimum.
    fn search(&mut self) -> Result<(), ProbeError> {
        for _ in 0..MOST_STEPS {
            self.linearise()?;
            let step = self.step();
            if step.max(self.estimate_noise()) < SETTLED {
                break;
            }
        }
        Ok(())
    }

    /// Returns the lines that are left out.
    #[must_use]
    pub fn slips(&self) -> Vec<Slip> {
        let of = |block: &Block<'_>, line: u64| {
            let readings = (0..block.residual.len()).filter_map(|index| {
                let place = block.experiment.place(index).filter(|place| place.line == line)?;
                let slope = block.jacobian.row(index);
                let open = (slope * &self.posterior.covariance).dot(&slope);
                let noise = block.noise[block.experiment.kind_of(index)];
                Some((index, place, open.max(0.0).sqrt().hypot(noise)))
            });
            let off = |(index, _, deviation): &(usize, Place, f64)| {
                block.residual[*index].abs() / deviation
            };
            let (index, place, deviation) = readings.max_by(|a, b| off(a).total_cmp(&off(b)))?;
            let value = block.experiment.measured()[index];
            Some(Slip {
                experiment: block.experiment.name(),
                line,
                column: place.column,
                value: value / place.unit,
                expected: (value - block.residual[index]) / place.unit,
                deviation: deviation / place.unit,
            })
        };
        let lines = |block: &Block<'_>| {
            block.left_out.iter().filter_map(|line| of(block, *line)).collect::<Vec<_>>()
        };
        self.blocks.iter().flat_map(lines).collect()
    }

    /// Returns the covariance that one more experiment would leave, before anybody makes it.
    ///
    /// # Errors
    /// When no robot near the plan can be simulated.
    pub fn expect(mut self, experiment: &'a dyn Experiment) -> Result<DMatrix<f64>, ProbeError> {
        self.blocks.clear();
        self.join(experiment);
        self.linearise()?;
        let precision = self.posterior.covariance.clone().try_inverse();
        let more = precision.map(|precision| precision + self.information());
        let covariance = more.and_then(DMatrix::try_inverse);
        Ok(covariance.unwrap_or(self.posterior.covariance))
    }

    fn join(&mut self, experiment: &'a dyn Experiment) {
        let (sensors, first) = (experiment.sensors(), self.posterior.mean.len());
        let count = first + sensors.len();
        let mut wider = Posterior::prior(count);
        wider.mean.rows_mut(0, first).copy_from(&self.posterior.mean);
        wider.covariance.view_mut((0, 0), (first, first)).copy_from(&self.posterior.covariance);
        self.posterior = wider;
        for block in &mut self.blocks {
            let jacobian = core::mem::replace(&mut block.jacobian, DMatrix::zeros(0, 0));
            block.jacobian = jacobian.resize_horizontally(count, 0.0);
            block.taken = block.taken.take().map(|taken| taken.resize_vertically(count, 0.0));
        }
        let readings = experiment.measured().len();
        self.blocks.push(Block {
            experiment,
            sensors,
            first,
            noise: experiment.noise(),
            residual: DVector::zeros(readings),
            left_out: Vec::new(),
            jacobian: DMatrix::zeros(readings, count),
            taken: None,
        });
    }

    fn model(&self, point: &DVector<f64>) -> RobotModel {
        apply(self.base, self.unknowns, &point.as_slice()[..self.unknowns.len()])
    }

    /// Residuals of all experiments at a point.
    fn residuals(&self, point: &DVector<f64>) -> Result<Vec<DVector<f64>>, ProbeError> {
        let model = self.model(point);
        self.blocks
            .iter()
            .map(|block| Ok(block.residual(&block.experiment.simulate(&model)?, point)))
            .collect()
    }

    fn accept(&mut self, point: DVector<f64>, residuals: Vec<DVector<f64>>) {
        self.posterior.mean = point;
        for (block, residual) in self.blocks.iter_mut().zip(residuals) {
            block.residual = residual;
        }
    }

    /// Takes the derivatives anew of those experiments from whose last ones the point has gone far.
    fn linearise(&mut self) -> Result<(), ProbeError> {
        let point = self.posterior.mean.clone();
        let model = self.model(&point);
        for block in &mut self.blocks {
            let shows = |index: &usize| block.experiment.shows(self.unknowns[*index].kind);
            let moved = |taken: &DVector<f64>| {
                let shown = (0..self.unknowns.len()).filter(shows);
                shown.map(|i| (taken[i] - point[i]).abs()).fold(0.0, f64::max)
            };
            if block.taken.as_ref().is_some_and(|taken| moved(taken) < NEAR) {
                continue;
            }
            let done = block.experiment.sketch(&model)?;
            let here = block.predict(&done, &point);
            for (index, unknown) in self.unknowns.iter().enumerate() {
                if !block.experiment.shows(unknown.kind) {
                    continue;
                }
                let mut nudged = point.clone();
                nudged[index] += NUDGE;
                let slice = &nudged.as_slice()[..self.unknowns.len()];
                let there = apply(self.base, self.unknowns, slice);
                let there = block.predict(&block.experiment.sketch(&there)?, &point);
                block.jacobian.set_column(index, &((there - &here) / NUDGE));
            }
            for sensor in 0..block.sensors.len() {
                let mut nudged = point.clone();
                nudged[block.first + sensor] += NUDGE;
                let there = block.predict(&done, &nudged);
                block.jacobian.set_column(block.first + sensor, &((there - &here) / NUDGE));
            }
            block.taken = Some(point.clone());
        }
        Ok(())
    }

    /// `sum J^T W J`.
    fn information(&self) -> DMatrix<f64> {
        let count = self.posterior.mean.len();
        let zero = DMatrix::zeros(count, count);
        self.blocks.iter().fold(zero, |sum, block| {
            let weighted = block.weighted();
            sum + weighted.transpose() * weighted
        })
    }

    /// `H = 1 + sum J^T W J`.
    fn precision(&self) -> DMatrix<f64> {
        let count = self.posterior.mean.len();
        DMatrix::identity(count, count) + self.information()
    }

    fn cost(&self, residuals: &[DVector<f64>], point: &DVector<f64>) -> f64 {
        let each = self.blocks.iter().zip(residuals).map(|(block, residual)| {
            let weigh = |(index, r): (usize, &f64)| (r / block.deviation(index)).powi(2);
            residual.iter().enumerate().map(weigh).sum::<f64>()
        });
        each.sum::<f64>() + point.norm_squared()
    }

    /// Goes to the minimum of the linear problem, or part of the way; returns the largest change in standard deviations.
    fn step(&mut self) -> f64 {
        let Some(factor) = self.precision().cholesky() else { return 0.0 };
        self.posterior.covariance = factor.inverse();
        let point = self.posterior.mean.clone();
        let slope = self.blocks.iter().fold(-&point, |sum, block| {
            let deviations = DVector::from_fn(block.residual.len(), |i, _| block.deviation(i));
            sum + block.weighted().transpose() * block.residual.component_div(&deviations)
        });
        let mut step = factor.solve(&slope);
        let own: Vec<DVector<f64>> = self.blocks.iter().map(|b| b.residual.clone()).collect();
        let before = self.cost(&own, &point);
        for _ in 0..HALVINGS {
            let next = &point + &step;
            // A point that cannot be simulated is as bad as one that fits worse.
            let better = self
                .residuals(&next)
                .ok()
                .filter(|residuals| self.cost(residuals, &next) <= before * (1.0 + 1e-9));
            if let Some(residuals) = better {
                self.accept(next, residuals);
                let change = |i: usize| step[i].abs() / self.posterior.deviation(i);
                return (0..step.len()).map(change).fold(0.0, f64::max);
            }
            step *= 0.5;
        }
        0.0
    }

    /// Estimates the noise of every kind of reading; returns the largest change as a share.
    fn estimate_noise(&mut self) -> f64 {
        let mut change = 0.0_f64;
        for block in &mut self.blocks {
            let guesses = block.experiment.noise();
            // What each reading determines: the diagonal of J C J^T W.
            let known = &block.jacobian * &self.posterior.covariance;
            let mut sums = vec![(0.0, 0.0); guesses.len()];
            for index in block.used() {
                let (square, free) = &mut sums[block.experiment.kind_of(index)];
                let leverage = known.row(index).dot(&block.jacobian.row(index));
                *square += block.residual[index].powi(2);
                *free += 1.0 - leverage / block.deviation(index).powi(2);
            }
            for ((noise, guess), (square, free)) in block.noise.iter_mut().zip(guesses).zip(sums) {
                let next = estimated_noise(guess, square, f64::max(0.0, free));
                change = change.max((next / *noise - 1.0).abs());
                *noise = next;
            }
        }
        change
    }

    /// Returns how each experiment fits.
    #[must_use]
    pub fn fitted(&self) -> Vec<Fitted> {
        let each = self.blocks.iter().map(|block| {
            let measured = block.experiment.measured();
            let readings = block.used().map(|i| (measured[i], measured[i] - block.residual[i]));
            Fitted {
                name: block.experiment.name(),
                readings: readings.collect(),
                noise: block.noise.clone(),
                guess: block.experiment.noise(),
                kinds: block.used().map(|i| block.experiment.kind_of(i)).collect(),
            }
        });
        each.collect()
    }
}

impl Block<'_> {
    fn predict(&self, done: &[f64], point: &DVector<f64>) -> DVector<f64> {
        let sensors: Vec<f64> = self
            .sensors
            .iter()
            .enumerate()
            .map(|(index, sensor)| sensor.spread * point[self.first + index])
            .collect();
        DVector::from_vec(self.experiment.observe(done, &sensors))
    }

    fn residual(&self, done: &[f64], point: &DVector<f64>) -> DVector<f64> {
        DVector::from_column_slice(self.experiment.measured()) - self.predict(done, point)
    }

    /// Returns whether a reading counts.
    fn is_used(&self, reading: usize) -> bool {
        let place = self.experiment.place(reading);
        place.is_none_or(|place| !self.left_out.contains(&place.line))
    }

    fn used(&self) -> impl Iterator<Item = usize> {
        (0..self.residual.len()).filter(|reading| self.is_used(*reading))
    }

    /// Standard deviation of a reading: infinite where the reading does not count.
    fn deviation(&self, reading: usize) -> f64 {
        if self.is_used(reading) {
            self.noise[self.experiment.kind_of(reading)]
        } else {
            f64::INFINITY
        }
    }

    /// Returns the line with the largest residual, where that exceeds [`SLIPPED`] standard deviations of the residuals of all other
    /// lines.
    fn slipped(&self) -> Option<u64> {
        let guesses = self.experiment.noise();
        let places = self.used().filter_map(|index| Some((self.experiment.place(index)?, index)));
        let places: Vec<(Place, usize)> = places.collect();
        let lines = places.chunk_by(|(a, _), (b, _)| a.line == b.line);
        let off = lines.map(|line| {
            let mut sums = vec![(0.0, 0.0); guesses.len()];
            for (_, index) in places.iter().filter(|(place, _)| place.line != line[0].0.line) {
                let (square, count) = &mut sums[self.experiment.kind_of(*index)];
                *square += self.residual[*index].powi(2);
                *count += 1.0;
            }
            let each = line.iter().map(|(_, index)| {
                let kind = self.experiment.kind_of(*index);
                let (square, count) = sums[kind];
                self.residual[*index].abs() / estimated_noise(guesses[kind], square, count)
            });
            (line[0].0.line, each.fold(0.0, f64::max))
        });
        off.max_by(|(_, a), (_, b)| a.total_cmp(b)).filter(|(_, off)| *off > SLIPPED).map(|it| it.0)
    }

    /// `W^(1/2) J`.
    fn weighted(&self) -> DMatrix<f64> {
        let mut weighted = self.jacobian.clone();
        for (index, mut row) in weighted.row_iter_mut().enumerate() {
            row.unscale_mut(self.deviation(index));
        }
        weighted
    }
}
