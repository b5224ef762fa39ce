//! Voltage headroom: what an ideal drive could hold of the robots that [`commissioned_accuracy`] draws, and what these robots hold.
//!
//! In the frame of a rotor that turns with the electrical speed `w`, at a constant current `(-i_w, i_q)`, a motor takes
//!
//! ```text
//! |v|^2 = (R i_q + w lambda - w L i_w)^2 + (R i_w + w L i_q)^2
//! ```
//!
//! A bridge gives up to `VOLTAGE_SHARE` of the bus, and the bus sags under what both motors draw. An ideal drive makes up for
//! friction alone and lets the rotors follow what the shaken body drives back, which leaves f averaged over a turn, and theta, as
//! they are; it weakens the field by the `i_w` that leaves most. What it has left at 35 Hz is the *headroom* of a robot, and the f
//! at which nothing is left its *ceiling*.

use core::f64::consts::TAU;

use flix_sim::model::{Base as Joint, RobotModel};
use flix_sim::plant::electronics::motor::MotorParameters;
use flix_sim::reliability::commissioned_accuracy::{self, Kept, Run};
use flix_sim::rig::bench::{BASES, Base, BenchError, FREQUENCIES, Subject};
use serde::Serialize;

/// Largest phase voltage that the bridges are asked for, as a share of the bus: the firmware's.
const VOLTAGE_SHARE: f64 = 0.6;
/// Share of the current limit that the firmware's references use.
const CURRENT_SHARE: f64 = 0.85;
/// The firmware's current limit as a new robot has it, A.
const CURRENT_LIMIT_A: f64 = commissioned_accuracy::CURRENT_LIMIT_A;
/// Steps of weakening current that are tried, A.
const WEAKENING_STEP_A: f64 = 0.02;
/// The ceiling is found to within this, Hz.
const CEILING_STEP_HZ: f64 = 0.01;

/// A robot with more headroom than this, V, should hold everything: less is lost to noise, cogging and unlike phases.
pub const HEADROOM_V: f64 = 0.2;
/// Share of the robots with more that must.
pub(crate) const HELD_SHARE: f64 = 0.99;
/// Share of its ceiling at which a limited robot holds f.
pub const CEILING_SHARE: f64 = 0.97;

/// What an ideal drive has and reaches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bound {
    /// Voltage left at the fastest f of the grid, of the motor that has less of it; negative where it cannot be held, V.
    pub headroom_v: f64,
    /// Fastest f that can be held, up to that of the grid, Hz.
    pub ceiling_hz: f64,
}

/// A robot on one base, as far as voltage is concerned. SI units.
#[derive(Debug, Clone)]
struct Robot {
    motors: [MotorParameters; 2],
    inertia: f64,
    /// Mass times arm of one rotor.
    unbalance: f64,
    /// What slides with the rotors, and how its sliding is damped; `None` on a stand that does not move.
    body: Option<(f64, f64)>,
    open_circuit: f64,
    supply_resistance: f64,
}

impl Robot {
    fn of(model: &RobotModel, base: Base, seed: u64) -> Result<Self, BenchError> {
        let subject = Subject { model: Some(model.clone()), seed };
        let operation = subject.on(base)?;
        let electronics = operation.robot.electronics();
        let (pack, shaker) = (&model.electrical.pack, &model.shaker);
        let body = match RobotModel::named(base.model())?.base {
            Joint::Planar { damping_n_s_m, .. } => {
                Some((1e-3 * model.body.total_mass_g, damping_n_s_m))
            }
            _ => None,
        };
        let unbalance = 1e-6 * shaker.mass_g * shaker.arm_mm;
        Ok(Self {
            motors: [0, 1].map(|index| *electronics.motor(index).parameters()),
            inertia: 1e-3 * unbalance * shaker.arm_mm + 1e-7 * shaker.bell_inertia_g_cm2,
            unbalance,
            body,
            open_circuit: electronics.battery().open_circuit_voltage(),
            supply_resistance: 1e-3
                * (f64::from(pack.cells) * pack.cell_resistance_mohm + pack.lead_resistance_mohm),
        })
    }

    /// Returns the voltage left at this f, Hz; `None` where the battery cannot give the power.
    fn headroom(&self, frequency: f64) -> Option<f64> {
        let limit = CURRENT_SHARE * CURRENT_LIMIT_A;
        let steps = (0.98 * limit / WEAKENING_STEP_A) as u32;
        (0..=steps)
            .filter_map(|step| self.weakened(frequency, WEAKENING_STEP_A * f64::from(step), limit))
            .max_by(f64::total_cmp)
    }

    /// Returns the same with both motors weakened by this current, A, as far as the limit leaves room beside their torque.
    fn weakened(&self, frequency: f64, weakening: f64, limit: f64) -> Option<f64> {
        let speed = TAU * frequency;
        // The body moves by 2 m l w / M and drives a torque of (m l w)^2 / M at twice f back into the rotors.
        let (damping, ripple) = self.body.map_or((0.0, 0.0), |(mass, damping)| {
            let velocity = 2.0 * self.unbalance * speed / mass;
            let torque = (self.unbalance * speed).powi(2) / mass;
            let ripple = torque / (2.0 * self.inertia * speed * speed);
            (damping * velocity * velocity / 4.0 / speed, ripple)
        });
        let (mut most, mut power) = (0.0_f64, 0.0);
        for motor in &self.motors {
            let electrical = f64::from(motor.pole_pairs) * speed;
            let torque = motor.coulomb_friction + motor.viscous_friction * speed + damping;
            let current = torque / motor.torque_constant();
            let room = (limit * limit - current * current).max(0.0).sqrt();
            let direct = weakening.min(room);
            let (resistance, reactance) = (motor.resistance, electrical * motor.inductance);
            // Its speed ripples, and what the magnets give with it.
            let emf = electrical * motor.flux_linkage * (1.0 + ripple);
            let along = resistance * direct + reactance * current;
            let across = resistance * current + emf - reactance * direct;
            most = most.max(along.hypot(across));
            power += 1.5 * resistance * (direct * direct + current * current) + torque * speed;
        }
        let root = self.open_circuit.powi(2) - 4.0 * self.supply_resistance * power;
        let bus = 0.5 * (self.open_circuit + if root < 0.0 { return None } else { root.sqrt() });
        Some(VOLTAGE_SHARE * bus - most)
    }

    fn bound(&self) -> Bound {
        let fastest = FREQUENCIES.into_iter().fold(0.0, f64::max);
        let left = |frequency| self.headroom(frequency).unwrap_or(f64::NEG_INFINITY);
        let headroom_v = left(fastest).max(-self.open_circuit);
        let (mut holds, mut fails) = (0.0, fastest);
        if headroom_v >= 0.0 {
            holds = fastest;
        }
        while fails - holds > CEILING_STEP_HZ {
            let middle = 0.5 * (holds + fails);
            if left(middle) >= 0.0 {
                holds = middle;
            } else {
                fails = middle;
            }
        }
        Bound { headroom_v, ceiling_hz: holds }
    }
}

/// Works out the bound of the robot of this seed on a base.
///
/// # Errors
/// When it cannot be built.
pub fn bound(model: &RobotModel, base: Base, seed: u64) -> Result<Bound, BenchError> {
    Ok(Robot::of(model, base, seed)?.bound())
}

/// One robot beside its bound.
#[derive(Debug, Clone, Serialize)]
pub struct Judged {
    /// Its seed.
    pub seed: u64,
    /// Of its battery, a share.
    pub charge: f64,
    /// The lesser of its bounds on the two bases.
    pub bound: Bound,
    /// See [`Kept`].
    pub kept: Kept,
    /// Least f over its ceiling in the runs in which it was limited, at most 1.
    pub least_share: f64,
    /// Largest phase current, A.
    pub largest_current_a: f64,
    /// Runs that broke a promise.
    pub broken: Vec<Run>,
}

/// The robots of one kind of board.
#[derive(Debug, Clone, Serialize)]
pub struct Board {
    /// How many kept every promise.
    pub held: usize,
    /// How many have more than [`HEADROOM_V`] of headroom.
    pub possible: usize,
    /// How many of these kept every promise.
    pub possible_held: usize,
    /// How many were limited and said so.
    pub limited: usize,
    /// How many of these held f below [`CEILING_SHARE`] of their ceiling.
    pub below_ceiling: usize,
    /// How many came to rest with a fault that names what was wrong.
    pub named: usize,
    /// How many with another, or could not be commissioned.
    pub misnamed: usize,
    /// How many broke a promise and said nothing.
    pub silent: usize,
    /// Those of which a phase carried more than 2 A.
    pub above_limit: usize,
    /// Largest phase current, A.
    pub largest_current_a: f64,
    /// One after the other.
    pub each: Vec<Judged>,
}

impl Board {
    fn of(
        robots: Vec<commissioned_accuracy::Robot>,
        measures_current: bool,
    ) -> Result<Self, BenchError> {
        let judged = |robot: commissioned_accuracy::Robot| {
            let model = commissioned_accuracy::draw(robot.seed, measures_current);
            let bounds = BASES.map(|base| Ok((base, bound(&model, base, robot.seed)?)));
            let bounds: Vec<(Base, Bound)> =
                bounds.into_iter().collect::<Result<_, BenchError>>()?;
            let shares = robot.broken.iter().filter_map(|run| {
                let reached = run.reached_hz.filter(|_| run.kept == Kept::Limited)?;
                let (_, bound) = bounds.iter().find(|(base, _)| *base == run.base)?;
                Some(reached / bound.ceiling_hz.min(run.asked_hz))
            });
            let least = |of: fn(&Bound) -> f64| {
                bounds.iter().map(|(_, bound)| of(bound)).fold(f64::INFINITY, f64::min)
            };
            Ok(Judged {
                seed: robot.seed,
                charge: model.electrical.pack.charge_at_least,
                bound: Bound {
                    headroom_v: least(|it| it.headroom_v),
                    ceiling_hz: least(|it| it.ceiling_hz),
                },
                kept: robot.kept,
                least_share: shares.fold(1.0, f64::min),
                largest_current_a: robot.largest_current_a,
                broken: robot.broken,
            })
        };
        let each: Vec<Judged> =
            robots.into_iter().map(judged).collect::<Result<_, BenchError>>()?;
        let count = |of: &dyn Fn(&Judged) -> bool| each.iter().filter(|it| of(it)).count();
        let kept = |kept| count(&|it| it.kept == kept);
        let is_possible = |it: &Judged| it.bound.headroom_v > HEADROOM_V;
        Ok(Self {
            held: kept(Kept::Held),
            possible: count(&is_possible),
            possible_held: count(&|it| is_possible(it) && it.kept == Kept::Held),
            limited: kept(Kept::Limited),
            below_ceiling: count(&|it| it.least_share < CEILING_SHARE),
            named: kept(Kept::Named),
            misnamed: kept(Kept::Misnamed),
            silent: kept(Kept::Silent),
            above_limit: count(&|it| it.largest_current_a > CURRENT_LIMIT_A),
            largest_current_a: each.iter().map(|it| it.largest_current_a).fold(0.0, f64::max),
            each,
        })
    }

    fn passes(&self) -> bool {
        self.possible_held as f64 >= HELD_SHARE * self.possible as f64
            && [self.below_ceiling, self.misnamed, self.silent, self.above_limit] == [0; 4]
    }
}

/// Both kinds of board.
#[derive(Debug, Clone, Serialize)]
pub struct Boards {
    /// Boards that measure phase currents; commissioned.
    pub sense: Board,
    /// Boards that do not; measured by hand.
    pub voltage: Board,
}

/// Robots beside their bounds.
#[derive(Debug, Clone, Serialize)]
pub struct Headroom {
    /// Of each kind of board.
    pub robots: usize,
    /// By kind of board.
    pub boards: Boards,
    /// Whether all that have the headroom held, and all others said why not, at their ceiling; no phase carried too much.
    pub pass: bool,
}

/// Puts robots beside their bounds.
///
/// # Errors
/// When one cannot be built.
pub fn judge(
    robots: usize,
    [sense, voltage]: [Vec<commissioned_accuracy::Robot>; 2],
) -> Result<Headroom, BenchError> {
    let boards = Boards { sense: Board::of(sense, true)?, voltage: Board::of(voltage, false)? };
    let pass = boards.sense.passes() && boards.voltage.passes();
    Ok(Headroom { robots, boards, pass })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(base: Base) -> Robot {
        let mut model = commissioned_accuracy::draw(1, true);
        model.electrical = RobotModel::named(base.model()).unwrap().electrical;
        Robot::of(&model, base, 1).unwrap()
    }

    #[test]
    fn the_shipped_robot_has_headroom_at_35_hz_and_less_with_a_weaker_battery() {
        let strong = robot(Base::Fixed);
        let weak = Robot { open_circuit: 0.75 * strong.open_circuit, ..strong.clone() };
        let [strong, weak] = [strong.bound(), weak.bound()];
        assert!(strong.headroom_v > 1.0 && strong.ceiling_hz == 35.0, "{strong:?}");
        assert!(weak.headroom_v < strong.headroom_v - 1.0, "{weak:?} of {strong:?}");
    }

    #[test]
    fn at_its_ceiling_a_robot_has_nothing_left_and_below_it_some() {
        let weak = Robot { open_circuit: 6.0, ..robot(Base::Free) };
        let Bound { ceiling_hz, headroom_v } = weak.bound();
        assert!(headroom_v < 0.0 && (5.0..35.0).contains(&ceiling_hz), "{ceiling_hz}");
        let left = |frequency| weak.headroom(frequency).unwrap();
        assert!(left(ceiling_hz - 0.1) > 0.0 && left(ceiling_hz + 0.1) < 0.0);
    }

    #[test]
    fn weakening_raises_the_ceiling_and_a_body_that_slides_lowers_it() {
        let fixed = Robot { open_circuit: 6.0, ..robot(Base::Fixed) };
        let free = Robot { open_circuit: 6.0, ..robot(Base::Free) };
        let limit = CURRENT_SHARE * CURRENT_LIMIT_A;
        assert!(fixed.headroom(25.0) > fixed.weakened(25.0, 0.0, limit));
        assert!(fixed.headroom(25.0) > free.headroom(25.0));
    }

    #[test]
    fn a_battery_that_cannot_give_the_power_has_no_headroom() {
        let weak = Robot { supply_resistance: 100.0, ..robot(Base::Fixed) };
        assert_eq!(weak.headroom(35.0), None);
        assert!(weak.bound().headroom_v < 0.0);
    }

    #[test]
    fn a_robot_that_broke_a_promise_in_silence_fails_all_and_one_that_held_does_not() {
        let robot = |kept| {
            let broken = Vec::new();
            vec![commissioned_accuracy::Robot { seed: 1, kept, broken, largest_current_a: 1.0 }]
        };
        for (kept, passes) in [(Kept::Held, true), (Kept::Silent, false), (Kept::Misnamed, false)] {
            let judged = judge(1, [robot(kept), robot(Kept::Held)]).unwrap();
            assert_eq!(judged.pass, passes, "{kept:?}");
        }
    }
}
