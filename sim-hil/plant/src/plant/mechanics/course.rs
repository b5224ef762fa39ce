//! How an ideal drive gets from one (f, theta) to the next.

use core::f64::consts::TAU;

use flix_firmware::fast::reference::{Ramps, Reference, UPDATE_S};
use flix_firmware::settings::Settings;
use flix_firmware::units::{RotorAngle, Speed};
use serde::{Deserialize, Serialize};

use super::system::Rotor;

/// A hair of rounding, in updates, is none that is not due yet.
const HAIR: f64 = 1e-9;

/// What an ideal drive follows: the references of the robot's software with its default ramps, between whose updates speeds
/// change evenly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Course {
    frequency_hz: f64,
    target: (Speed, RotorAngle),
    ramps: Ramps,
    reference: Reference,
    /// f and the speed of the line of force, turns per second, at the last update and at the next.
    speeds: [[f64; 2]; 2],
    /// Since the last update, s.
    elapsed: f64,
    /// Direction of the line of force, rad; it counts on over full turns.
    theta_rad: f64,
    steady: bool,
}

fn target(frequency_hz: f64, theta_rad: f64) -> (Speed, RotorAngle) {
    (
        Speed::from_hertz(frequency_hz as f32),
        RotorAngle::from_degrees(theta_rad.to_degrees() as f32),
    )
}

impl Course {
    /// Starts at this f (Hz) and theta (rad).
    pub(super) fn new(frequency_hz: f64, theta_rad: f64) -> Self {
        let (frequency, direction) = target(frequency_hz, theta_rad);
        Self {
            frequency_hz,
            target: (frequency, direction),
            ramps: Ramps::of(&Settings::DEFAULT),
            reference: Reference::steady(frequency, direction),
            speeds: [[frequency_hz, 0.0]; 2],
            elapsed: 0.0,
            theta_rad,
            steady: true,
        }
    }

    /// Asks for another f (Hz) and theta (rad).
    pub(super) fn ask(&mut self, frequency_hz: f64, theta_rad: f64) {
        self.frequency_hz = frequency_hz;
        self.target = target(frequency_hz, theta_rad);
        if self.steady {
            self.elapsed = 0.0;
            self.update();
        }
    }

    /// Returns whether nothing changes any more.
    pub(super) const fn is_steady(&self) -> bool {
        self.steady
    }

    /// Returns the direction of the line of force, rad; it counts on over full turns.
    pub(super) const fn theta_rad(&self) -> f64 {
        self.theta_rad
    }

    /// Returns f and the speed of the line of force now, turns per second.
    pub(super) fn now(&self) -> [f64; 2] {
        let [from, to] = self.speeds;
        let share = self.elapsed / UPDATE_S;
        core::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
    }

    /// Moves on by a step, s; returns f and the speed of the line of force at its end, turns per second.
    pub(super) fn advance(&mut self, step: f64) -> [f64; 2] {
        let [_, before] = self.now();
        self.elapsed += step;
        while !self.steady && self.elapsed > UPDATE_S * (1.0 - HAIR) {
            self.elapsed = (self.elapsed - UPDATE_S).max(0.0);
            self.update();
        }
        let after = self.now();
        self.theta_rad += 0.5 * TAU * step * (before + after[1]);
        after
    }

    /// Moves on by a step, s; returns the rotors as they go through it, f64 or long lanes.
    pub(super) fn followed(&mut self, rotors: [Rotor<f64>; 2], step: f64) -> [Rotor<f64>; 2] {
        if self.steady {
            return rotors.map(|rotor| Rotor { acceleration: 0.0, ..rotor });
        }
        let speeds = rotor_speeds(self.advance(step));
        core::array::from_fn(|i| {
            let acceleration = (speeds[i] - rotors[i].speed) / step;
            Rotor { acceleration, ..rotors[i] }
        })
    }

    /// Does one update of the references.
    fn update(&mut self) {
        let [_, from] = self.speeds;
        let (frequency, direction) = self.target;
        self.reference.approach(&self.ramps, frequency, direction);
        let is_there = self.reference.is_steady_at(frequency);
        // As exactly as it is asked.
        let to = if is_there { [self.frequency_hz, 0.0] } else { self.reference.speeds() };
        self.speeds = [from, to];
        self.steady = is_there && from == to;
    }
}

/// Returns the speeds of top and bottom rotor about body +z, rad/s, of f and the speed of the line of force, turns per second.
pub(super) fn rotor_speeds([frequency_hz, turns]: [f64; 2]) -> [f64; 2] {
    [1.0, -1.0].map(|sign| -(sign * TAU * frequency_hz + TAU * turns))
}
