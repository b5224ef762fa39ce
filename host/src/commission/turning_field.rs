//! Pole pairs, direction and flux linkage from a field that turns slowly and draws the rotor along.
//!
//! The rotor follows like a compass needle, so that electrical turns of the field over turns of the rotor are the pole
//! pairs. What the voltage leaves behind resistance and inductance is the flux of the magnets, which turns with the rotor:
//!
//! ```text
//! integral of (v - R i) - L i = lambda (cos, sin)(p theta + offset) + constant + drift
//! ```

use std::f64::consts::TAU;

use flix_protocol::message::Trial;

use super::circuit::{Circuit, TICK};
use super::least_squares::solve;

/// Least flux linkage of magnets, Wb, besides this share of what the current makes: so much is left of it by what is not known
/// of the circuit.
const LEAST_FLUX: f64 = 0.2e-3;
const FLUX_SHARE: f64 = 1.1;

/// Of a rotor that turned less, degrees, or whose pole pairs are so far from a whole number, they are not sure yet.
const LEAST_TRAVEL: f64 = 120.0;
const CLEAR_FRACTION: f64 = 0.12;

/// A capture of a turning field, of one motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Turning {
    /// The trial; the first row is of the tick in which the field has its speed.
    pub trial: Trial,
    /// Voltage along the field in every tick, V.
    pub voltage: Vec<f64>,
    /// Currents of phases A and B, A.
    pub currents: [Vec<f64>; 2],
    /// Angles of the rotor of this motor, and of the other's, degrees, within half a turn of forward.
    pub angles: [Vec<f64>; 2],
    /// Resistances of phases A, B and C over their mean.
    pub uneven: [f64; 3],
    /// Bus voltage, V.
    pub bus: f64,
    /// PWM frequency, Hz.
    pub pwm_frequency: f64,
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Rotor {
    /// Electrical turns of the field over turns of the rotor, positive when the rotor turns clockwise with the phase order.
    pub ratio: f64,
    /// Flux linkage, Wb.
    pub flux_linkage: f64,
    /// How far the rotor turned, degrees.
    pub travel: f64,
    /// How far the other motor's turned, degrees.
    pub other_travel: f64,
    /// Root mean square of how far the rotor was from where its pole pairs have it, electrical degrees.
    pub slip: f64,
    /// Electrical angle of its magnets where the encoder shows forward, rad.
    pub offset: f64,
}

impl Rotor {
    /// Returns the nearest number of pole pairs.
    #[must_use]
    pub fn pole_pairs(&self) -> u32 {
        self.ratio.abs().round() as u32
    }

    /// Returns whether it did not turn far enough to be sure of its pole pairs.
    pub(super) fn is_unclear(&self) -> bool {
        self.travel < LEAST_TRAVEL || self.fraction() > CLEAR_FRACTION
    }

    /// Returns how far they are from a whole number.
    #[must_use]
    pub fn fraction(&self) -> f64 {
        (self.ratio - self.ratio.round()).abs()
    }
}

/// Returns the angle without jumps, degrees.
pub(super) fn unwrapped(angles: &[f64]) -> Vec<f64> {
    let mut turned = 0.0;
    let mut last = angles.first().copied().unwrap_or_default();
    angles
        .iter()
        .map(|angle| {
            turned += (angle - last + 180.0).rem_euclid(360.0) - 180.0;
            last = *angle;
            turned
        })
        .collect()
}

/// Measures a motor that follows a turning field; `None` when it does not turn at all.
#[must_use]
pub fn measure(turning: &Turning, circuit: &Circuit) -> Option<Rotor> {
    let rows = turning.voltage.len();
    let [own, other] = [&turning.angles[0], &turning.angles[1]].map(|angles| unwrapped(angles));
    let field = field(&turning.trial, rows);
    let (ratio, _) = ratio(&turning.trial, &turning.angles[0])?;
    let travel = |angles: &[f64]| {
        let span = angles
            .iter()
            .copied()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), angle| {
                (low.min(angle), high.max(angle))
            });
        span.1 - span.0
    };
    let electrical: Vec<f64> = own.iter().map(|angle| ratio.round() * angle.to_radians()).collect();
    let lag: Vec<f64> = (0..rows).map(|row| electrical[row] - TAU * field[row]).collect();
    let mean = lag.iter().sum::<f64>() / lag.len() as f64;
    let slip = lag.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / lag.len() as f64;
    let [along, across] = flux(turning, circuit, &field, &electrical)?;
    let flux_linkage = along.hypot(across);
    let (travel, other_travel) = (travel(&own), travel(&other));
    let start = turning.angles[0].first()?.to_radians();
    let offset = across.atan2(along) - ratio.round() * start;
    let slip = slip.sqrt().to_degrees();
    Some(Rotor { ratio, flux_linkage, travel, other_travel, slip, offset })
}

/// Returns the electrical turns of the field over the turns of a rotor at these angles (degrees), and how far it is off that,
/// root mean square, electrical degrees.
#[must_use]
pub fn ratio(trial: &Trial, angles: &[f64]) -> Option<(f64, f64)> {
    let (field, ones) = (field(trial, angles.len()), vec![1.0; angles.len()]);
    let angles = unwrapped(angles);
    let [turns, start] = solve([&field, &ones], &angles)?;
    let off = angles.iter().zip(&field).map(|(it, field)| (it - start - turns * field).powi(2));
    let off = (off.sum::<f64>() / field.len() as f64).sqrt();
    let ratio = 360.0 / turns;
    Some((ratio, ratio.abs() * off))
}

/// Returns the angles of the field, turns.
fn field(trial: &Trial, rows: usize) -> Vec<f64> {
    let first = trial.ticks_before();
    let turns = |raw: u32| f64::from(raw as i32) / 4_294_967_296.0;
    let start = trial.field(first);
    let step = turns(trial.field(first + 1).wrapping_sub(start));
    (0..rows).map(|row| turns(start) + step * row as f64).collect()
}

/// Returns whether magnets turn with the field, whatever the encoder sees: they leave a flux along it that no current makes.
#[must_use]
pub(crate) fn is_drawn_along(turning: &Turning, circuit: &Circuit) -> bool {
    let field = field(&turning.trial, turning.voltage.len());
    let electrical: Vec<f64> = field.iter().map(|turns| TAU * turns).collect();
    let found = flux(turning, circuit, &field, &electrical);
    let most = turning.currents[0].iter().fold(0.0, |most: f64, it| most.max(it.abs()));
    let least = LEAST_FLUX + FLUX_SHARE * circuit.inductance * most;
    found.is_some_and(|[along, _]| along > least)
}

/// Returns the flux linkage, Wb, along and across a rotor at these electrical angles (rad) under a field at these (turns).
fn flux(
    turning: &Turning,
    circuit: &Circuit,
    field: &[f64],
    electrical: &[f64],
) -> Option<[f64; 2]> {
    let Circuit { resistance, inductance, delay, dead_voltage, .. } = *circuit;
    let knee = turning.bus / (8.0 * inductance * turning.pwm_frequency);
    let lost = |current: f64| dead_voltage * (current / knee).clamp(-1.0, 1.0);
    let rows = field.len();
    let mut sum = [0.0; 2];
    let mut linked = [Vec::with_capacity(rows), Vec::with_capacity(rows)];
    for row in 0..rows {
        let (a, b) = (turning.currents[0][row], turning.currents[1][row]);
        let stator = [a, (a + 2.0 * b) / 3.0_f64.sqrt()];
        let phases = [a, b, -a - b];
        // Of each phase: what dead time takes, and what its resistance differs from the mean by.
        let [lost_a, lost_b, lost_c] = core::array::from_fn(|phase| {
            lost(phases[phase]) + (turning.uneven[phase] - 1.0) * resistance * phases[phase]
        });
        let lost = [(2.0 * lost_a - lost_b - lost_c) / 3.0, (lost_b - lost_c) / 3.0_f64.sqrt()];
        for axis in 0..2 {
            linked[axis].push(sum[axis] - inductance * stator[axis]);
        }
        // What acts until the next sample: the voltage of the tick before, then this one's.
        let vector = |row: usize| {
            let (sin, cos) = (TAU * field[row]).sin_cos();
            [turning.voltage[row] * cos, turning.voltage[row] * sin]
        };
        let (before, now) = (vector(row.saturating_sub(1)), vector(row));
        let late = delay / TICK;
        for axis in 0..2 {
            let voltage = late * before[axis] + (1.0 - late) * now[axis];
            sum[axis] += TICK * (voltage - lost[axis] - resistance * stator[axis]);
        }
    }
    // Both axes in one fit: cosine and sine of the rotor, a constant and a drift of each axis.
    let both = |alpha: &dyn Fn(usize) -> f64, beta: &dyn Fn(usize) -> f64| -> Vec<f64> {
        (0..rows).map(alpha).chain((0..rows).map(beta)).collect()
    };
    let (cos, sin) = (|row: usize| electrical[row].cos(), |row: usize| electrical[row].sin());
    let (none, one, time) = (|_: usize| 0.0, |_: usize| 1.0, |row: usize| row as f64);
    let columns = [
        both(&cos, &sin),
        both(&|row| -sin(row), &cos),
        both(&one, &none),
        both(&none, &one),
        both(&time, &none),
        both(&none, &time),
    ];
    let found = solve(columns.each_ref().map(Vec::as_slice), &linked.concat())?;
    Some([found[0], found[1]])
}
