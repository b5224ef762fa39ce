//! Resistance, inductance and the amplifiers' signs and balance, from a standing field whose voltage is halved and restored.
//!
//! The captured periods are laid over each other, and the mean period is compared with the circuit's, solved exactly
//! between the moments at which its voltage changes:
//!
//! ```text
//! L di/dt = v - R i - dead time
//! dead time of a phase = t f V_bus clamp(i / i_r, -1, 1),   i_r = V_bus / (8 L f)      t: dead time, f: PWM frequency
//! ```
//!
//! Below `i_r`, half the ripple of a phase, dead time looks like a resistance and cannot be separated from the winding's: there the
//! board's description is believed. Above, it is measured.
//!
//! No current is converted in the middle of a PWM period itself, but before it and after it in turn: a sample is off by what
//! the pulses move the current meanwhile, `-+ v t / L`, and that `t` is fitted too.

use flix_protocol::message::{Bridges, SCOPE_RATE_HZ};

use super::least_squares::fit;

/// Length of a tick, s.
pub(super) const TICK: f64 = 1.0 / SCOPE_RATE_HZ as f64;
/// Periods at the beginning that are left out: the rotor may still move.
const LEFT_OUT: usize = 4;
/// Share of the board's dead time by which it may be off.
const DEAD_TIME_SPREAD: f64 = 0.05;
/// What dead time may take where the board states none, V.
const UNKNOWN_DEAD_TIME: f64 = 0.05;
/// PWM periods from samples until duties act: a robot sets them in the first, and its bridges take them over in the middle of the second.
const ACTS_AFTER: f64 = 1.5;
/// How far the delay of the bridges may be off that, s: a conversion may be early or late by so much. Less cannot be separated from the
/// inductance.
const DELAY_SPREAD: f64 = 10e-6;
/// How far samples may lie off the middle of the PWM period, s: one conversion, or two.
const ASIDE: f64 = 5e-6;
/// What the mean period may differ from the circuit's, A.
const DIFFERENCE: f64 = 2e-3;

/// What a motor's circuit is made of.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct Circuit {
    /// Terminal to star point, ohm.
    pub resistance: f64,
    /// Terminal to star point, H.
    pub inductance: f64,
    /// From a tick's samples until its duties act, s.
    pub delay: f64,
    /// How far its samples lie off the middle of the PWM period, in turn before and after it, s.
    pub aside: f64,
    /// What dead time takes of a phase that carries much, V.
    pub dead_voltage: f64,
}

/// A capture of a standing field along phase A, of one motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// Voltage along the field in every tick, V.
    pub voltage: Vec<f64>,
    /// Currents of phases A and B as shown, A.
    pub currents: [Vec<f64>; 2],
    /// Bus voltage, V.
    pub bus: f64,
    /// Ticks for which the voltage is half, and whole.
    pub interval: usize,
}

impl Standing {
    /// Adds another capture of the same field.
    pub fn extend(&mut self, other: Self) {
        let period = 2 * self.interval;
        let add = |column: &mut Vec<f64>, other: Vec<f64>| {
            column.truncate(column.len() / period * period);
            column.extend(other.into_iter().skip(LEFT_OUT * period));
        };
        add(&mut self.voltage, other.voltage);
        self.currents.iter_mut().zip(other.currents).for_each(|(one, other)| add(one, other));
        self.bus = (self.bus + other.bus) / 2.0;
    }
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Phases {
    /// Of amperes as phase A shows them.
    pub circuit: Circuit,
    /// Whether the amplifiers count down for current into the motor.
    pub inverted: bool,
    /// What phase B's amplifier shows for the same current, over what A's does.
    pub balance: f64,
    /// Resistances of phases A, B and C over their mean.
    pub uneven: [f64; 3],
    /// Root mean square of what is left over, as a share of the current.
    pub misfit: f64,
    /// Current of phase A with the whole voltage, A.
    pub current: f64,
}

impl Phases {
    /// Corrects it for phases A, B and C of unlike resistance, given over their mean: a field along A sees A in series with B
    /// and C in parallel, which carry unlike currents then.
    #[must_use]
    pub(crate) fn of_uneven(self, uneven: [f64; 3]) -> Self {
        let [a, b, c] = uneven;
        let along = (a + b * c / (b + c)) / 1.5;
        let resistance = self.circuit.resistance / along;
        let balance = self.balance * (b + c) / (2.0 * c);
        Self { circuit: Circuit { resistance, ..self.circuit }, balance, uneven, ..self }
    }
}

/// Solves the circuit for one period of voltages (per tick) that has been repeated for long; returns the samples.
fn period(circuit: &Circuit, voltages: &[f64], bus: f64, frequency: f64) -> Vec<f64> {
    /// Parts of a tick in which the dead time is constant.
    const PARTS: usize = 4;
    let Circuit { resistance, inductance, delay, aside, dead_voltage } = *circuit;
    let knee = bus / (8.0 * inductance * frequency);
    let lost = |current: f64| {
        let share = |current: f64| (current / knee).clamp(-1.0, 1.0);
        // Along phase A, with half the current out of B and of C each.
        dead_voltage * 2.0 / 3.0 * (share(current) + share(current / 2.0))
    };
    let run = |mut current: f64, voltage: f64, seconds: f64| {
        let part = seconds / PARTS as f64;
        let factor = (-part * resistance / inductance).exp();
        for _ in 0..PARTS {
            let steady = (voltage - lost(current)) / resistance;
            current = steady + (current - steady) * factor;
        }
        current
    };
    let late = delay.clamp(0.0, TICK);
    let ticks = voltages.len();
    let mut current = voltages[ticks - 1] / (resistance + dead_voltage / knee);
    let mut samples = vec![0.0; ticks];
    // So many time constants that the beginning is forgotten.
    let rounds = 12.0 * inductance / resistance / (ticks as f64 * TICK);
    for _ in 0..2 + rounds.clamp(0.0, 40.0) as usize {
        for tick in 0..ticks {
            let before = voltages[(tick + ticks - 1) % ticks];
            // All phases are low there: the mean voltage is what the current falls by.
            let side = if tick % 2 == 0 { aside } else { -aside };
            samples[tick] = current - side * before / inductance;
            current = run(current, before, late);
            current = run(current, voltages[tick], TICK - late);
        }
    }
    samples
}

/// Returns the mean of all periods of a column but the first.
fn folded(column: &[f64], period: usize) -> Vec<f64> {
    let periods = column.len() / period;
    let first = LEFT_OUT.min(periods.saturating_sub(1));
    (0..period)
        .map(|tick| {
            let of_tick = (first..periods).map(|round| column[round * period + tick]);
            of_tick.sum::<f64>() / (periods - first).max(1) as f64
        })
        .collect()
}

/// Measures the phases of a motor. `scale` is what a true ampere is shown as, 1 where nobody knows.
#[must_use]
pub fn measure(standing: &Standing, bridges: &Bridges, scale: f64) -> Option<Phases> {
    let ticks = 2 * standing.interval;
    if standing.voltage.len() < 2 * ticks {
        return None;
    }
    let voltages = folded(&standing.voltage, ticks);
    let [a, b] = [0, 1].map(|phase| folded(&standing.currents[phase], ticks));
    // Field along A: half of its current comes out of B.
    let along = |column: &[f64], other: &[f64]| -> f64 {
        column.iter().zip(other).map(|(x, y)| x * y).sum()
    };
    let balance = -2.0 * along(&a, &b) / along(&a, &a);
    let sign = a.iter().sum::<f64>().signum();
    let shown: Vec<f64> = a.iter().map(|current| sign * current / scale).collect();
    let whole = shown.iter().copied().fold(0.0, f64::max);
    let most = voltages.iter().copied().fold(0.0, f64::max);
    if whole <= 0.0 || most <= 0.0 {
        return None;
    }
    let frequency = f64::from(bridges.pwm_frequency_hz);
    let stated = f64::from(bridges.dead_time_ns) * 1e-9 * frequency * standing.bus;
    let spread = if stated > 0.0 { DEAD_TIME_SPREAD * stated } else { UNKNOWN_DEAD_TIME };
    let resistance = most / whole;
    let circuit = |[resistance, inductance, delay, aside, dead]: &[f64; 5]| Circuit {
        resistance: resistance.exp(),
        inductance: inductance.exp(),
        delay: *delay,
        aside: *aside,
        dead_voltage: dead.abs(),
    };
    let residuals = |parameters: &[f64; 5]| -> Vec<f64> {
        let circuit = circuit(parameters);
        let solved = period(&circuit, &voltages, standing.bus, frequency);
        let mut all: Vec<f64> = solved
            .iter()
            .zip(&shown)
            .map(|(solved, shown)| (solved - shown) / DIFFERENCE)
            .collect();
        all.push((circuit.dead_voltage - stated) / spread);
        all.push((circuit.delay - ACTS_AFTER / frequency) / DELAY_SPREAD);
        all
    };
    let best = [0.1e-3, 0.4e-3, 1.5e-3]
        .map(|time_constant: f64| {
            let inductance = (resistance * time_constant).ln();
            let start = [resistance.ln(), inductance, 0.5 * TICK, ASIDE, stated.max(1e-3)];
            let found = fit(start, residuals);
            (found, residuals(&found).iter().map(|one| one * one).sum::<f64>())
        })
        .into_iter()
        .min_by(|one, other| one.1.total_cmp(&other.1))?
        .0;
    let circuit = circuit(&best);
    let solved = period(&circuit, &voltages, standing.bus, frequency);
    let left = solved.iter().zip(&shown).map(|(one, other)| (one - other).powi(2)).sum::<f64>();
    let misfit = (left / ticks as f64).sqrt() / whole;
    let uneven = [1.0; 3];
    Some(Phases { circuit, inverted: sign < 0.0, balance, uneven, misfit, current: whole })
}

/// Most that the current of a winding differs from its circuit's, as a share.
const LARGEST_MISFIT: f64 = 0.05;

/// Returns whether this is a winding: its current fits one circuit, and its phases are alike.
pub(super) fn is_winding(found: &Phases) -> bool {
    found.misfit < LARGEST_MISFIT && (0.5..2.0).contains(&found.balance)
}
