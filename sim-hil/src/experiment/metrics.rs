//! Figures from the plant's truth: how well f and theta are held, and how soon they are reached.
//!
//! - *f over a turn*: one over the time of a turn of the shaking phase.
//! - *theta error*: of the line of force at a tick, so that half a turn more or less is none.
//! - *line of force*: the principal axis of the force that the rotors put on the body.
//! - *across*: root mean square of the force across the commanded line, as a share of that along it.

use core::f64::consts::{PI, TAU};
use std::collections::VecDeque;

use flix_protocol::message::Setpoint;

use crate::rig::simulated::Truth;

/// Figures of a held setpoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// Root mean square of (f over each turn - commanded f), Hz. Infinite without a whole turn.
    pub frequency_rms_hz: f64,
    /// Root mean square over all ticks of (theta - commanded theta), degrees.
    pub direction_rms_deg: f64,
    /// Line of force against commanded theta, degrees, positive to the right.
    pub force_error_deg: f64,
    /// Force across the commanded line as a share of the force along it.
    pub across_axis: f64,
    /// Mean direct currents of top and bottom motor, A: they make heat and no torque, and show by how much voltages are
    /// turned from the rotor where it truly is.
    pub direct_currents: [f64; 2],
}

/// Takes the truth of every tick while a setpoint is held.
#[derive(Debug, Clone)]
pub struct HoldMeter {
    frequency: f64,
    direction: f64,
    before: Option<Truth>,
    turn_began: Option<f64>,
    next_turn: f64,
    turns: Mean,
    errors: Mean,
    direct_currents: [Mean; 2],
    /// Sums of squares and products of the force: forward, mixed, right.
    force: [f64; 3],
}

impl HoldMeter {
    /// Holds the truth against this setpoint.
    #[must_use]
    pub fn new(setpoint: Setpoint) -> Self {
        Self {
            frequency: f64::from(setpoint.frequency().get()),
            direction: f64::from(setpoint.direction().get()).to_radians(),
            before: None,
            turn_began: None,
            next_turn: 0.0,
            turns: Mean::default(),
            errors: Mean::default(),
            direct_currents: [Mean::default(); 2],
            force: [0.0; 3],
        }
    }

    /// Takes one tick into account.
    pub fn watch(&mut self, truth: &Truth) {
        if let Some(before) = self.before.replace(*truth) {
            self.watch_turns(&before, truth);
        } else {
            self.next_turn = truth.phase;
        }
        let error = line_error(truth.direction, self.direction);
        self.errors.add(error * error);
        for (mean, [direct, _]) in self.direct_currents.iter_mut().zip(truth.rotor_frame_currents) {
            mean.add(direct);
        }
        let [forward, left, _] = truth.shaker_force;
        let right = -left;
        self.force[0] += forward * forward;
        self.force[1] += forward * right;
        self.force[2] += right * right;
    }

    /// Notes each moment at which another whole turn is complete.
    fn watch_turns(&mut self, before: &Truth, now: &Truth) {
        let sign = self.frequency.signum();
        let (from, to) = (before.phase * sign, now.phase * sign);
        let next = self.next_turn * sign;
        if to < next || to <= from {
            return;
        }
        let [before_s, now_s] = [before, now].map(|truth| truth.time.as_micros() as f64 * 1e-6);
        let crossed = before_s + (now_s - before_s) * ((next - from) / (to - from)).clamp(0.0, 1.0);
        if let Some(began) = self.turn_began.replace(crossed) {
            let error = sign / (crossed - began) - self.frequency;
            self.turns.add(error * error);
        }
        self.next_turn += TAU * sign;
    }

    /// Returns the figures so far.
    #[must_use]
    pub fn figures(&self) -> Hold {
        let [forward, mixed, right] = self.force;
        let axis = 0.5 * (2.0 * mixed).atan2(forward - right);
        let (sin, cos) = self.direction.sin_cos();
        let along = forward * cos * cos + 2.0 * mixed * sin * cos + right * sin * sin;
        let across = forward * sin * sin - 2.0 * mixed * sin * cos + right * cos * cos;
        Hold {
            frequency_rms_hz: self.turns.value().sqrt(),
            direction_rms_deg: self.errors.value().sqrt().to_degrees(),
            force_error_deg: line_error(axis, self.direction).to_degrees(),
            across_axis: (across.max(0.0) / along).sqrt(),
            direct_currents: self.direct_currents.map(Mean::value),
        }
    }
}

/// Returns the difference of two lines, rad in [-pi/2, pi/2): a line turned by half a turn is the same line.
#[must_use]
pub fn line_error(direction: f64, commanded: f64) -> f64 {
    (direction - commanded + 0.5 * PI).rem_euclid(PI) - 0.5 * PI
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    /// Infinite when there was nothing to measure: no figure is no success.
    fn value(self) -> f64 {
        if self.count == 0 { f64::INFINITY } else { self.sum / self.count as f64 }
    }
}

/// How near f and theta must come for a step to be settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Of f, Hz either side.
    pub frequency_hz: f64,
    /// Of theta, degrees either side.
    pub direction_deg: f64,
}

/// Takes the truth of every tick from a new command on.
///
/// f is the mean over the time of one turn at the commanded f, up to the tick: the rotors' speed ripples twice a turn
/// where the body yields.
#[derive(Debug, Clone)]
pub struct StepMeter {
    frequency: f64,
    direction: f64,
    band: Band,
    window: f64,
    past: VecDeque<(f64, f64)>,
    began: Option<f64>,
    last_outside: f64,
    now: f64,
    peak_current: f64,
}

impl StepMeter {
    /// Waits for this setpoint, which must not be at rest.
    #[must_use]
    pub fn new(setpoint: Setpoint, band: Band) -> Self {
        let frequency = f64::from(setpoint.frequency().get());
        Self {
            frequency,
            direction: f64::from(setpoint.direction().get()).to_radians(),
            band,
            window: 1.0 / frequency.abs(),
            past: VecDeque::new(),
            began: None,
            last_outside: 0.0,
            now: 0.0,
            peak_current: 0.0,
        }
    }

    /// Takes one tick into account.
    pub fn watch(&mut self, truth: &Truth) {
        let now = truth.time.as_micros() as f64 * 1e-6;
        self.began.get_or_insert(now);
        self.now = now;
        self.past.push_back((now, truth.phase));
        while self.past.len() > 2 && self.past[1].0 <= now - self.window {
            self.past.pop_front();
        }
        let is_outside = self.frequency_error(now, truth.phase).abs() > self.band.frequency_hz
            || line_error(truth.direction, self.direction).abs().to_degrees()
                > self.band.direction_deg;
        if is_outside {
            self.last_outside = now;
        }
        self.peak_current = self.peak_current.max(truth.largest_current());
    }

    /// Infinite before a whole window is there.
    fn frequency_error(&self, now: f64, phase: f64) -> f64 {
        match self.past.front() {
            Some((then, phase_then)) if now - then >= 0.999 * self.window => {
                (phase - phase_then) / (now - then) / TAU - self.frequency
            }
            _ => f64::INFINITY,
        }
    }

    /// Seconds from the first tick until f and theta were near for good; `None` when they never were.
    #[must_use]
    pub fn settled_after(&self) -> Option<f64> {
        let began = self.began?;
        (self.last_outside < self.now).then_some(self.last_outside - began)
    }

    /// Returns the largest current of any phase, A.
    #[must_use]
    pub fn peak_current(&self) -> f64 {
        self.peak_current
    }
}

#[cfg(test)]
mod tests {
    use flix_protocol::shaker;
    use flix_protocol::units::Instant;

    use super::*;

    fn setpoint(frequency: f64, direction: f64) -> Setpoint {
        crate::rig::bench::setpoint(frequency, direction).unwrap()
    }

    /// A shaker that turns as commanded.
    fn truth(tick: u64, phase: f64, direction: f64) -> Truth {
        let rotor_angle = shaker::rotor_angles(phase, direction);
        let force =
            |axis: fn(f64) -> f64| rotor_angle.iter().map(|angle| axis(*angle)).sum::<f64>();
        Truth {
            time: Instant::from_micros(tick * 100),
            phase,
            direction,
            rotor_angle,
            rotor_speed: [0.0; 2],
            phase_currents: [[0.0; 3]; 2],
            rotor_frame_currents: [[0.0; 2]; 2],
            bus_voltage: 0.0,
            shaker_force: [force(f64::cos), force(f64::sin), 0.0],
        }
    }

    fn hold(frequency: f64, direction: f64, is: impl Fn(f64) -> (f64, f64)) -> Hold {
        let mut meter = HoldMeter::new(setpoint(frequency, direction));
        for tick in 0..20_000 {
            let (phase, theta) = is(tick as f64 * 1e-4);
            meter.watch(&truth(tick, phase, theta));
        }
        meter.figures()
    }

    #[test]
    fn a_perfect_shaker_has_no_error_in_either_direction() {
        for (f, theta) in [(30.0_f64, 60.0_f64), (-35.0, -90.0), (10.0, 90.0)] {
            let of = |t| (TAU * f * t + 1.0, theta.to_radians() + PI);
            let figures = hold(f, theta, of);
            assert!(figures.frequency_rms_hz < 1e-6 && figures.direction_rms_deg < 1e-9);
            assert!(figures.force_error_deg.abs() < 1e-9 && figures.across_axis < 1e-9);
        }
    }

    #[test]
    fn a_shaker_two_degrees_to_the_right_and_half_a_hertz_fast_is_seen_so() {
        let figures = hold(-20.0, 30.0, |t| (-TAU * 20.5 * t, 32_f64.to_radians()));
        assert!((figures.frequency_rms_hz - 0.5).abs() < 1e-6);
        assert!((figures.direction_rms_deg - 2.0).abs() < 1e-9);
        assert!((figures.force_error_deg - 2.0).abs() < 1e-6);
        assert!((figures.across_axis - 2_f64.to_radians().tan()).abs() < 1e-6);
    }

    #[test]
    fn a_rotor_at_rest_is_no_success() {
        assert!(hold(20.0, 0.0, |_| (0.0, 0.0)).frequency_rms_hz.is_infinite());
    }

    #[test]
    fn a_step_is_settled_when_both_are_near_for_good() {
        let band = Band { frequency_hz: 0.2, direction_deg: 3.0 };
        let mut meter = StepMeter::new(setpoint(25.0, 0.0), band);
        let mut phase = 0.0;
        for tick in 0..10_000_u64 {
            let t = tick as f64 * 1e-4;
            phase += TAU * (if t < 0.2 { 20.0 } else { 25.0 }) * 1e-4;
            let theta = if (0.4..0.45).contains(&t) { 4.0_f64 } else { 1.0 };
            meter.watch(&truth(tick, phase, theta.to_radians()));
        }
        assert!((meter.settled_after().unwrap() - 0.45).abs() < 2e-4);
    }

    #[test]
    fn a_step_that_never_comes_near_has_no_settling_time() {
        let band = Band { frequency_hz: 0.2, direction_deg: 3.0 };
        let mut meter = StepMeter::new(setpoint(25.0, 0.0), band);
        for tick in 0..5_000 {
            meter.watch(&truth(tick, TAU * 24.5 * tick as f64 * 1e-4, 0.0));
        }
        assert_eq!(meter.settled_after(), None);
    }
}
