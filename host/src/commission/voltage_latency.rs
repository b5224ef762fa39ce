//! Latency of the encoders of a board that measures no phase currents.
//!
//! At one speed and load a motor makes the same torque however its voltage is turned against the magnets. Runs with the believed
//! electrical angle turned back, not at all and ahead so say where the magnets are:
//!
//! ```text
//! v turned by the believed angle less the true one = (R + j w L) (i_d + j i_q) + j w lambda,   i_q = friction, whatever i_d is
//! believed less true angle = offset - w (true latency - believed latency)
//! ```
//!
//! Latency is what of that angle is odd in speed. R, L and lambda are entered, and believed to [`ENTERED`]. Without the turns latency
//! would be hidden: the angle by which a load turns the voltage is odd in speed, too. Lambda is found no better than it was
//! entered: friction that grows with speed takes a voltage that does, too.

use std::f64::consts::PI;

use flix_protocol::message::Bridges;

use super::least_squares::fit;

/// By how much an entered resistance, inductance or flux linkage may be off, as a share.
pub const ENTERED: f64 = 0.05;
/// Angle by which alignment may be off, rad.
const OFFSET: f64 = 0.05;
/// Latency that is looked for, s.
const LATENCY: f64 = 1e-3;
/// Friction that motors of this size have, A; what of it grows with speed is [`GROWING`] of it at the fastest.
const FRICTION: f64 = 0.2;
const GROWING: f64 = 0.2;
/// Voltage that a mean is off, V, and the share of the back-EMF that it is.
const NOISE: (f64, f64) = (2e-3, 2e-3);

/// What somebody entered of a motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entered {
    /// Terminal to star point, ohm.
    pub resistance: f64,
    /// Terminal to star point, H.
    pub inductance: f64,
    /// Peak phase back-EMF per electrical rad/s, Wb.
    pub flux_linkage: f64,
}

/// Means of one motor that runs steadily while its electrical angle is believed to be elsewhere; in its own phase order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turned {
    /// By how much the believed angle was turned ahead, electrical rad.
    pub angle: f64,
    /// Latency of the encoder that was believed, s.
    pub latency: f64,
    /// Electrical speed, rad/s.
    pub speed: f64,
    /// q current that dead time was made up for, A.
    pub current: f64,
    /// d and q voltage along the believed angle, V.
    pub voltage: [f64; 2],
}

/// What was found of one motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Of its encoder, s.
    pub latency: f64,
    /// Root mean square of what the voltages are off the motor's, V.
    pub misfit: f64,
}

/// What dead time takes.
#[derive(Debug, Clone, Copy)]
struct DeadTime {
    /// Of a phase that carries much, V.
    voltage: f64,
    /// Current from which on it takes all, A, times the inductance, H.
    knee: f64,
}

impl DeadTime {
    fn of(bridges: &Bridges, bus: f64) -> Self {
        let frequency = f64::from(bridges.pwm_frequency_hz);
        let voltage = f64::from(bridges.dead_time_ns) * 1e-9 * frequency * bus;
        Self { voltage, knee: bus / (8.0 * frequency) }
    }

    /// Returns d and q of the fundamental of what it takes from a current that turns: a sine that is cut at the knee.
    fn taken(&self, inductance: f64, [d, q]: [f64; 2]) -> [f64; 2] {
        let knee = self.knee / inductance;
        let share = (knee / d.hypot(q).max(1e-9)).min(1.0);
        let gain = 2.0 / PI * (share.asin() + share * (1.0 - share * share).sqrt());
        [d, q].map(|it| self.voltage * gain * it / knee)
    }
}

/// A motor as it is fitted: what was entered, times what it is off, and what nobody knows.
struct Motor {
    entered: Entered,
    latency: f64,
    offset: f64,
    friction: [f64; 2],
}

impl Motor {
    /// Parameters are about 1.
    fn of(entered: &Entered, parameters: &[f64; 7], fastest: f64) -> Self {
        let [latency, offset, resistance, inductance, flux, friction, growing] = *parameters;
        Self {
            entered: Entered {
                resistance: entered.resistance * resistance,
                inductance: entered.inductance * inductance,
                flux_linkage: entered.flux_linkage * flux,
            },
            latency: LATENCY * latency,
            offset: OFFSET * (offset - 1.0),
            friction: [FRICTION * friction, FRICTION * GROWING * (growing - 1.0) / fastest],
        }
    }

    /// Returns by how much the voltage that makes the torque differs from the one that friction takes, V.
    fn missing(&self, at: &Turned, dead: &DeadTime) -> f64 {
        let Entered { resistance, inductance, flux_linkage } = self.entered;
        let reactance = at.speed * inductance;
        let square = resistance * resistance + reactance * reactance;
        let ahead = at.angle + self.offset - at.speed * (self.latency - at.latency);
        let (sin, cos) = ahead.sin_cos();
        let to_magnets = |[d, q]: [f64; 2]| [d * cos - q * sin, d * sin + q * cos];
        let made_up = dead.taken(inductance, [0.0, at.current]);
        let given = to_magnets([0, 1].map(|axis| at.voltage[axis] + made_up[axis]));
        let flows = |taken: [f64; 2]| {
            let d = given[0] - taken[0];
            let q = given[1] - taken[1] - at.speed * flux_linkage;
            [(resistance * d + reactance * q) / square, (resistance * q - reactance * d) / square]
        };
        let mut taken = to_magnets(made_up);
        for _ in 0..ROUNDS {
            let now = dead.taken(inductance, flows(taken));
            taken = [0, 1].map(|axis| taken[axis] + (now[axis] - taken[axis]) * STEP);
        }
        let friction = at.speed.signum() * self.friction[0] + at.speed * self.friction[1];
        (flows(taken)[1] - friction) * square.sqrt()
    }
}

/// Steps, and their length, in which the current and what dead time takes of it settle.
const ROUNDS: usize = 24;
const STEP: f64 = 0.3;

/// Finds the latency of a motor's encoder from runs at speeds of both signs, at a bus voltage, V; `None` where nothing fits.
#[must_use]
pub fn measure(entered: &Entered, runs: &[Turned], bridges: &Bridges, bus: f64) -> Option<Found> {
    let dead = DeadTime::of(bridges, bus);
    let fastest = runs.iter().map(|it| it.speed.abs()).fold(0.0, f64::max);
    if fastest <= 0.0 {
        return None;
    }
    let missing = |parameters: &[f64; 7]| -> Vec<f64> {
        let motor = Motor::of(entered, parameters, fastest);
        runs.iter().map(|it| motor.missing(it, &dead)).collect()
    };
    let noise = |run: &Turned| NOISE.0.hypot(NOISE.1 * run.speed * entered.flux_linkage);
    let residuals = |parameters: &[f64; 7]| -> Vec<f64> {
        let [_, offset, resistance, inductance, flux, friction, growing] = *parameters;
        let mut all: Vec<f64> =
            missing(parameters).iter().zip(runs).map(|(one, run)| one / noise(run)).collect();
        all.extend([resistance, inductance, flux].map(|it| (it - 1.0) / ENTERED));
        all.extend([offset, friction, growing].map(|it| it - 1.0));
        all
    };
    let start = [runs.first()?.latency.max(0.1 * LATENCY) / LATENCY, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
    let found = fit(start, residuals);
    let left = missing(&found);
    let square = left.iter().map(|it| it * it).sum::<f64>();
    let misfit = (square / left.len() as f64).sqrt();
    let Motor { latency, .. } = Motor::of(entered, &found, fastest);
    (latency.is_finite() && misfit.is_finite()).then_some(Found { latency, misfit })
}

/// Returns how far the voltage may be turned so that it drives no more than this d current, A, at this electrical speed, rad/s;
/// rad, at most `most`.
#[must_use]
pub fn turn(entered: &Entered, speed: f64, current: f64, most: f64) -> f64 {
    let impedance = entered.resistance.hypot(speed * entered.inductance);
    let share = current * impedance / (speed * entered.flux_linkage);
    if share < most.sin() { share.asin() } else { most }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    const BRIDGES: Bridges = Bridges {
        dead_time_ns: 300,
        pwm_frequency_hz: 20_000,
        measures_bus: true,
        measures_current: false,
    };

    /// What a motor of 7 pole pairs takes at these speeds, Hz, each way and turned, with an encoder that is so late, s, and
    /// aligned so far off, rad.
    fn runs(motor: &Entered, speeds: &[f64], late: f64, offset: f64, current: f64) -> Vec<Turned> {
        let dead = DeadTime::of(&BRIDGES, 11.1);
        let mut runs = Vec::new();
        for speed in speeds.iter().flat_map(|it| [*it, -it]).map(|it| TAU * 7.0 * it) {
            for angle in [0.0, 0.4, -0.4] {
                // The d current for which the voltage stands where it was asked to.
                let believed = 1.2e-3;
                let ahead = angle + offset - speed * (late - believed);
                let i_q = current * speed.signum();
                let voltage = |i_d: f64| {
                    let taken = dead.taken(motor.inductance, [i_d, i_q]);
                    let v_d = motor.resistance * i_d - speed * motor.inductance * i_q + taken[0];
                    let v_q = motor.resistance * i_q
                        + speed * (motor.inductance * i_d + motor.flux_linkage)
                        + taken[1];
                    let (sin, cos) = ahead.sin_cos();
                    [v_d * cos + v_q * sin, v_q * cos - v_d * sin]
                };
                let made_up = dead.taken(motor.inductance, [0.0, i_q]);
                // The robot asks for no d current: v_d is what the q current alone takes.
                let wanted = -speed * motor.inductance * i_q;
                let (mut low, mut high) = (-20.0, 20.0);
                for _ in 0..80 {
                    let middle = (low + high) / 2.0;
                    if voltage(middle)[0] < wanted { low = middle } else { high = middle }
                }
                let [d, q] = voltage(low);
                let voltage = [d - made_up[0], q - made_up[1]];
                runs.push(Turned { angle, latency: believed, speed, current: i_q, voltage });
            }
        }
        runs
    }

    #[test]
    fn latency_is_found_whatever_friction_and_alignment_are() {
        for (resistance, inductance, flux_linkage) in
            [(0.1, 60e-6, 0.6e-3), (2.3, 0.86e-3, 3.4e-3), (10.0, 5e-3, 9e-3), (6.0, 0.4e-3, 2e-3)]
        {
            let motor = Entered { resistance, inductance, flux_linkage };
            for (late, offset, current) in
                [(0.0, 0.03, 0.1), (0.9e-3, 0.0, 0.3), (2.5e-3, -0.05, 0.05)]
            {
                let runs = runs(&motor, &[5.0, 15.0], late, offset, current);
                let found = measure(&motor, &runs, &BRIDGES, 11.1).unwrap();
                assert!((found.latency - late).abs() < 5e-6, "{motor:?}, {late}: {found:?}");
            }
        }
    }

    #[test]
    fn what_was_entered_wrongly_costs_little() {
        let motor = Entered { resistance: 2.3, inductance: 0.86e-3, flux_linkage: 3.4e-3 };
        let runs = runs(&motor, &[5.0, 15.0], 1.7e-3, 0.02, 0.15);
        for [resistance, inductance, flux] in
            [[1.03, 0.97, 1.03], [0.97, 1.03, 0.97], [1.0, 1.0, 1.1]]
        {
            let entered = Entered {
                resistance: resistance * motor.resistance,
                inductance: inductance * motor.inductance,
                flux_linkage: flux * motor.flux_linkage,
            };
            let found = measure(&entered, &runs, &BRIDGES, 11.1).unwrap();
            assert!((found.latency - 1.7e-3).abs() < 40e-6, "{found:?}");
        }
    }

    #[test]
    fn a_turned_voltage_drives_no_more_than_it_may() {
        let motor = Entered { resistance: 0.1, inductance: 60e-6, flux_linkage: 0.6e-3 };
        let turn_at = |speed: f64| turn(&motor, speed, 0.5, 0.44);
        let speed = 900.0;
        let impedance = motor.resistance.hypot(speed * motor.inductance);
        let driven = speed * motor.flux_linkage * turn_at(speed).sin() / impedance;
        assert!((driven - 0.5).abs() < 1e-9, "{driven}");
        assert_eq!(turn(&Entered { resistance: 10.0, ..motor }, speed, 0.5, 0.44), 0.44);
    }
}
