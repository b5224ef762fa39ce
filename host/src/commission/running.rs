//! Flux linkage, latency of the encoder, and the amplifiers' scale, from a robot that runs by provisional values.
//!
//! The back-EMF stands across the magnets. Where the fast half believes them to be elsewhere, it sees the back-EMF turned by
//! as much. What grows with the speed of that angle is latency; what does not is an offset:
//!
//! ```text
//! e = v - R i - j w L i = w lambda (sin, cos)(angle),   angle = offset - w (true latency - believed latency)
//! ```
//!
//! The inertia of a rotor is known from its mass. The current that speeds it up says what a shown ampere is worth:
//! `3/2 p lambda i = J dw/dt + friction`.

use std::f64::consts::TAU;

use super::circuit::{Circuit, TICK};
use super::least_squares::solve;

/// Means of one motor that runs steadily, without d current; clockwise positive, as the scope shows them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steady {
    /// Speed of the rotor, Hz.
    pub speed: f64,
    /// Standard deviation of the speed, Hz.
    pub swing: f64,
    /// q current, A.
    pub current: f64,
    /// d and q voltage, V.
    pub voltage: [f64; 2],
}

/// The back-EMF of a motor at one speed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BackEmf {
    /// Electrical speed, rad/s.
    pub speed: f64,
    /// Flux linkage, Wb.
    pub flux_linkage: f64,
    /// How far the believed angle is ahead of the magnets, electrical rad.
    pub ahead: f64,
}

impl BackEmf {
    /// Derives it from steady means.
    #[must_use]
    pub fn of(steady: &Steady, circuit: &Circuit, pole_pairs: f64) -> Self {
        let speed = TAU * pole_pairs * steady.speed;
        let [v_d, v_q] = steady.voltage;
        let e_d = v_d + speed * circuit.inductance * steady.current;
        let e_q = v_q - circuit.resistance * steady.current;
        let sign = speed.signum();
        Self {
            speed,
            flux_linkage: e_d.hypot(e_q) / speed.abs(),
            ahead: (sign * e_d).atan2(sign * e_q),
        }
    }
}

/// Returns by how much the latency is larger than believed, s, from back-EMFs at speeds of both signs.
#[must_use]
pub fn latency(measured: &[BackEmf]) -> Option<f64> {
    let speeds: Vec<f64> = measured.iter().map(|one| one.speed).collect();
    let ones = vec![1.0; speeds.len()];
    let ahead: Vec<f64> = measured.iter().map(|one| one.ahead).collect();
    solve([&speeds, &ones], &ahead).map(|[slope, _]| -slope)
}

/// Returns the integral of a column over time, tick by tick.
pub(super) fn integral(column: &[f64]) -> Vec<f64> {
    column
        .iter()
        .scan(0.0, |sum, value| {
            *sum += value * TICK;
            Some(*sum)
        })
        .collect()
}

/// A change of speed, or none, tick by tick, as the scope shows it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Change {
    /// Rows at the beginning and at the end in which the speed is steady.
    pub steady: [usize; 2],
    /// q current, A.
    pub current: Vec<f64>,
    /// Speed of the rotor, Hz.
    pub speed: Vec<f64>,
}

impl Change {
    /// Returns the current of the rows in which it is steady, at the faster end and at the slower one.
    pub(super) fn ends(&self) -> [&[f64]; 2] {
        let [first, last] = steady_rows(self.steady, &self.current);
        let magnitude = |speed: Option<&f64>| speed.map_or(0.0, |it| it.abs());
        if magnitude(self.speed.first()) > magnitude(self.speed.last()) {
            [first, last]
        } else {
            [last, first]
        }
    }
}

/// Returns the first and the last rows of a column, so many of each or all that there are.
fn steady_rows(steady: [usize; 2], column: &[f64]) -> [&[f64]; 2] {
    let [first, last] = steady.map(|rows| rows.min(column.len()));
    [&column[..first], &column[column.len() - last..]]
}

/// Returns the current that a rotor takes for each rad/s^2, A s^2/rad, from changes of its speed. Speeds count where they are
/// steady; in between they lag. Friction is one for all changes: constant, and growing with speed.
#[must_use]
pub fn current_per_acceleration(changes: &[Change]) -> Option<f64> {
    let mut columns: [Vec<f64>; 3] = Default::default();
    let mut target = Vec::new();
    for Change { steady, current, speed } in changes {
        let first = *speed.first()?;
        let gained: Vec<f64> = speed.iter().map(|speed| TAU * (speed - first)).collect();
        let time: Vec<f64> = (0..speed.len()).map(|row| row as f64 * TICK).collect();
        // Against the mean of its own rows: each change has a constant of its own.
        let centred = |column: Vec<f64>| {
            let column = steady_rows(*steady, &column).concat();
            let mean = column.iter().sum::<f64>() / column.len().max(1) as f64;
            column.into_iter().map(move |value| value - mean)
        };
        for (column, part) in columns.iter_mut().zip([gained, time, integral(speed)]) {
            column.extend(centred(part));
        }
        target.extend(centred(integral(current)));
    }
    let [slope, ..] = solve(columns.each_ref().map(Vec::as_slice), &target)?;
    Some(slope)
}
