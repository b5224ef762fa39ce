//! A three-phase permanent-magnet motor with its friction and cogging.
//!
//! Terms, with theta_e = `pole_pairs` x rotor angle + mounting offset, the electrical angle, counted
//! counter-clockwise about body +z like the rotor's, and amplitudes that are phase peaks:
//!
//! ```text
//! L di/dt = v - R i - e            each phase, star point floating (surface magnets: L_d = L_q)
//! e       = omega_e lambda (-sin theta_e, cos theta_e)         back EMF in (alpha, beta), volts
//! tau_em  = 3/2 p lambda i_q,   i_q = i_beta cos theta_e - i_alpha sin theta_e          newton metres
//! tau     = tau_em - tau_cogging - b omega - tau_Coulomb
//! ```
//!
//! Between two sub-steps voltages are constant and the back EMF is taken in the middle; the first-order
//! circuit is then solved exactly, so that no step is too long to be stable. Phases that do not conduct
//! (a bridge that coasts, a broken wire) leave the circuit.
//!
//! Coulomb friction sticks: it is a spring of [`MotorParameters::presliding_stiffness`] that
//! slides when it bears the Coulomb torque (an elasto-plastic element, Prandtl 1928). Below that torque a
//! rotor at rest stays at rest for ever.

/// What a motor is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorParameters {
    /// Pairs of magnet poles: electrical turns per turn.
    pub pole_pairs: u32,
    /// Of one phase with its share of the bridge's switches, ohm.
    pub resistance: f64,
    /// Of one phase, henry.
    pub inductance: f64,
    /// Peak flux linkage of one phase, weber.
    pub flux_linkage: f64,
    /// Amplitude of the cogging torque, newton metres.
    pub cogging_torque: f64,
    /// Cogging periods per turn: least common multiple of slots and poles.
    pub cogging_periods: u32,
    /// Viscous friction and windage, newton metre seconds per radian.
    pub viscous_friction: f64,
    /// Coulomb friction, newton metres.
    pub coulomb_friction: f64,
    /// Stiffness of the stuck bearing, newton metres per radian.
    pub presliding_stiffness: f64,
    /// Damping of the stuck bearing, newton metre seconds per radian.
    pub presliding_damping: f64,
}

/// The motor of the simulated robot. **Assumed**: the paper names none.
///
/// A small gimbal-class outrunner (12 slots, 14 poles) that can just reach 35 Hz from a 3S battery: at
/// 35 Hz the back EMF is 4.6 V per phase, and 11.1 V give at most 11.1 / sqrt(3) = 6.4 V, which leaves
/// 1.8 V for friction, for the shaking body that drives back, and for a flat battery. Resistance and
/// inductance are those of hobby motors of about 260 rpm/V; friction and cogging are of the order of
/// 1 mN m as felt by hand on such motors.
pub const ASSUMED_MOTOR: MotorParameters = MotorParameters {
    pole_pairs: 7,
    resistance: 2.5,
    inductance: 1.0e-3,
    flux_linkage: 3.0e-3,
    cogging_torque: 0.8e-3,
    cogging_periods: 84,
    viscous_friction: 4.0e-6,
    coulomb_friction: 1.0e-3,
    presliding_stiffness: 10.0,
    presliding_damping: 2.0e-3,
};

impl MotorParameters {
    /// Returns the torque per ampere of i_q, N m/A.
    #[must_use]
    pub fn torque_constant(&self) -> f64 {
        1.5 * f64::from(self.pole_pairs) * self.flux_linkage
    }
}

/// What a phase's wire is connected to during a sub-step: this potential above the negative rail
/// in volts, or nothing.
pub type Terminal = Option<f64>;

/// What happened in one sub-step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SubStep {
    /// Electromagnetic torque on the rotor about body +z, mean of the sub-step, N m.
    pub torque: f64,
    /// Heat in the windings, J.
    pub copper: f64,
    /// Charge that went into each phase, C.
    pub charge: [f64; 3],
}

/// One motor: its currents and the state of its bearing.
#[derive(Debug, Clone)]
pub struct Motor {
    parameters: MotorParameters,
    /// Electrical angle at rotor angle 0, rad.
    electrical_offset: f64,
    /// +1, or -1 when two wires are swapped, so that the field turns against the phase order.
    phase_order: f64,
    /// Phase currents in (alpha, beta), positive into the motor, A.
    current: [f64; 2],
    /// Deflection of the bearing's spring, rad.
    deflection: f64,
    open: [bool; 3],
    /// Resistance (ohm) and inductance (henry) of each phase, where they are not all alike.
    uneven: Option<[(f64, f64); 3]>,
}

impl Motor {
    /// Creates a motor without current. `electrical_offset` is the electrical angle at rotor angle zero, rad;
    /// `reversed` swaps two of its wires.
    #[must_use]
    pub fn new(parameters: MotorParameters, electrical_offset: f64, reversed: bool) -> Self {
        Self {
            parameters,
            electrical_offset,
            phase_order: if reversed { -1.0 } else { 1.0 },
            current: [0.0; 2],
            deflection: 0.0,
            open: [false; 3],
            uneven: None,
        }
    }

    /// Returns what it is made of.
    #[must_use]
    pub fn parameters(&self) -> &MotorParameters {
        &self.parameters
    }

    /// Returns what it is made of, to be another motor from now on. Its circuit stays: see [`Motor::spoil`].
    pub fn parameters_mut(&mut self) -> &mut MotorParameters {
        &mut self.parameters
    }

    /// Multiplies resistance and inductance of each phase by these. The back EMF stays that of a good motor, so that what
    /// such a motor does at speed is not shown.
    pub fn spoil(&mut self, factors: [(f64, f64); 3]) {
        let MotorParameters { resistance, inductance, .. } = self.parameters;
        self.uneven = Some(factors.map(|(r, l)| (r * resistance, l * inductance)));
    }

    /// Currents of phases A, B, C, positive into the motor, A. Their sum is zero, and a broken wire carries nothing.
    #[must_use]
    pub fn phase_currents(&self) -> [f64; 3] {
        let mut currents = from_alpha_beta(self.current);
        for (current, open) in currents.iter_mut().zip(self.open) {
            if open {
                *current = 0.0;
            }
        }
        currents
    }

    /// Currents in the rotor's frame (d, q) at this rotor angle, A.
    #[must_use]
    pub fn rotor_frame_current(&self, rotor_angle: f64) -> [f64; 2] {
        let (sin, cos) = libm::sincos(self.electrical_angle(rotor_angle));
        let [alpha, beta] = self.current;
        [alpha * cos + beta * sin, (beta * cos - alpha * sin) * self.phase_order]
    }

    /// Returns the energy in the inductances, J.
    #[must_use]
    pub fn magnetic_energy(&self) -> f64 {
        let [alpha, beta] = self.current;
        0.75 * self.parameters.inductance * (alpha * alpha + beta * beta)
    }

    /// Breaks (or mends) the wire of a phase, 0 to 2. Panics on another phase.
    pub fn break_wire(&mut self, phase: usize, broken: bool) {
        self.open[phase] = broken;
    }

    /// Electrical angle at this rotor angle, in the direction of the phase order, rad.
    fn electrical_angle(&self, rotor_angle: f64) -> f64 {
        self.phase_order
            * (f64::from(self.parameters.pole_pairs) * rotor_angle + self.electrical_offset)
    }

    /// Returns sine and cosine of the electrical angle in the middle of the first of `steps` sub-steps of
    /// `seconds`, and the rotation from one middle to the next: one evaluation serves a whole tick.
    #[must_use]
    pub(super) fn sweep(&self, rotor_angle: f64, speed: f64, seconds: f64) -> Sweep {
        let electrical_speed = self.phase_order * f64::from(self.parameters.pole_pairs) * speed;
        let middle = self.electrical_angle(rotor_angle) + 0.5 * seconds * electrical_speed;
        Sweep {
            direction: libm::sincos(middle),
            rotation: libm::sincos(seconds * electrical_speed),
            emf: electrical_speed * self.parameters.flux_linkage,
        }
    }

    /// Returns the back EMF of phases A, B, C in the middle of the sub-step, V.
    #[must_use]
    pub(super) fn back_emf(sweep: &Sweep) -> [f64; 3] {
        from_alpha_beta(sweep.back_emf())
    }

    /// Advances the currents by `seconds` with the wires so connected.
    pub(super) fn advance(
        &mut self,
        mut terminals: [Terminal; 3],
        sweep: &Sweep,
        decay: &Decay,
    ) -> SubStep {
        for (terminal, open) in terminals.iter_mut().zip(self.open) {
            if open {
                *terminal = None;
            }
        }
        let before = self.current;
        self.current = match terminals {
            [Some(a), Some(b), Some(c)] => match &self.uneven {
                None => self.three_conduct([a, b, c], sweep, decay),
                Some(phases) => self.uneven_conduct([a, b, c], phases, sweep, decay.seconds),
            },
            _ => self.two_conduct(terminals, sweep, decay),
        };
        let mean = [0, 1].map(|axis| 0.5 * (before[axis] + self.current[axis]));
        let (sin, cos) = sweep.direction;
        let square_mean = [0, 1]
            .map(|axis| {
                (before[axis] * before[axis]
                    + before[axis] * self.current[axis]
                    + self.current[axis] * self.current[axis])
                    / 3.0
            })
            .iter()
            .sum::<f64>();
        SubStep {
            torque: self.parameters.torque_constant()
                * self.phase_order
                * (mean[1] * cos - mean[0] * sin),
            copper: 1.5 * self.parameters.resistance * square_mean * decay.seconds,
            charge: from_alpha_beta(mean).map(|current| current * decay.seconds),
        }
    }

    fn three_conduct(&self, [a, b, c]: [f64; 3], sweep: &Sweep, decay: &Decay) -> [f64; 2] {
        let voltage = [(2.0 * a - b - c) / 3.0, (b - c) * INVERSE_SQRT_3];
        let emf = sweep.back_emf();
        [0, 1].map(|axis| {
            let steady = (voltage[axis] - emf[axis]) / self.parameters.resistance;
            steady + (self.current[axis] - steady) * decay.factor
        })
    }

    /// Three phases of their own resistance and inductance at one star point, by the midpoint rule.
    fn uneven_conduct(
        &self,
        terminals: [f64; 3],
        phases: &[(f64, f64); 3],
        sweep: &Sweep,
        seconds: f64,
    ) -> [f64; 2] {
        let (emf, now) = (Self::back_emf(sweep), self.phase_currents());
        let driven: [(f64, f64); 3] = core::array::from_fn(|phase| {
            let (resistance, inductance) = phases[phase];
            let half = 0.5 * seconds * resistance;
            let flux = (inductance - half) * now[phase] + seconds * (terminals[phase] - emf[phase]);
            let admittance = 1.0 / (inductance + half);
            (flux * admittance, admittance)
        });
        let all = driven.iter().fold((0.0, 0.0), |sum, it| (sum.0 + it.0, sum.1 + it.1));
        // What the star point takes of each, so that no current is left over.
        let star = all.0 / all.1;
        to_alpha_beta(driven.map(|(current, admittance)| current - star * admittance))
    }

    /// One current through two phases in series, or none through fewer.
    fn two_conduct(&self, terminals: [Terminal; 3], sweep: &Sweep, decay: &Decay) -> [f64; 2] {
        let connected = |(phase, terminal): (usize, Terminal)| terminal.map(|v| (phase, v));
        let mut pairs = terminals.into_iter().enumerate().filter_map(connected);
        let (Some((first, v_first)), Some((second, v_second))) = (pairs.next(), pairs.next())
        else {
            return [0.0; 2];
        };
        let (emf, now) = (Self::back_emf(sweep), self.phase_currents());
        let driving = v_first - v_second - (emf[first] - emf[second]);
        let steady = driving / (2.0 * self.parameters.resistance);
        let current = steady + (0.5 * (now[first] - now[second]) - steady) * decay.factor;
        let mut phases = [0.0; 3];
        phases[first] = current;
        phases[second] = -current;
        to_alpha_beta(phases)
    }

    /// Stops the current of phases that a diode has stopped.
    pub(super) fn set_phase_currents(&mut self, phases: [f64; 3]) {
        self.current = to_alpha_beta(phases);
    }

    /// Returns the friction torque on the rotor at this speed, N m. It changes sign only through the
    /// bearing's deflection, see [`Motor::slide`].
    #[must_use]
    pub(super) fn friction(&self, speed: f64) -> f64 {
        let p = &self.parameters;
        let stuck = p.presliding_stiffness * self.deflection + p.presliding_damping * speed;
        -stuck.clamp(-p.coulomb_friction, p.coulomb_friction) - p.viscous_friction * speed
    }

    /// Lets the bearing follow the rotor that turned by `angle`.
    pub(super) fn slide(&mut self, angle: f64) {
        let limit = self.parameters.coulomb_friction / self.parameters.presliding_stiffness;
        self.deflection = (self.deflection + angle).clamp(-limit, limit);
    }

    /// Returns the mean cogging torque on the rotor while it turns from `rotor_angle` by `sweep` rad, N m.
    #[must_use]
    pub(super) fn cogging(&self, rotor_angle: f64, sweep: f64) -> f64 {
        let periods = f64::from(self.parameters.cogging_periods);
        let half = 0.5 * periods * sweep;
        // The mean of a sine over a window is the sine of the middle times sin(half) / half.
        let blur = if half.abs() < 1e-6 { 1.0 } else { libm::sin(half) / half };
        -self.parameters.cogging_torque * libm::sin(periods * (rotor_angle + 0.5 * sweep)) * blur
    }

    /// Returns the potential energy of the magnets over the teeth at this rotor angle, J.
    #[must_use]
    pub fn cogging_energy(&self, rotor_angle: f64) -> f64 {
        let periods = f64::from(self.parameters.cogging_periods);
        -self.parameters.cogging_torque / periods * libm::cos(periods * rotor_angle)
    }
}

/// The rotor's electrical direction through the sub-steps of a tick at constant speed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sweep {
    direction: (f64, f64),
    rotation: (f64, f64),
    emf: f64,
}

impl Sweep {
    /// Goes on to the middle of the next sub-step.
    pub(super) fn advance(&mut self) {
        let ((sin, cos), (turn_sin, turn_cos)) = (self.direction, self.rotation);
        self.direction = (sin * turn_cos + cos * turn_sin, cos * turn_cos - sin * turn_sin);
    }

    fn back_emf(&self) -> [f64; 2] {
        let (sin, cos) = self.direction;
        [-self.emf * sin, self.emf * cos]
    }
}

/// How much of a current is left after a sub-step; the same for one phase and for two in series.
#[derive(Debug, Clone, Copy)]
pub(super) struct Decay {
    /// Length of the sub-step, s.
    pub(super) seconds: f64,
    factor: f64,
}

impl Decay {
    pub(super) fn new(parameters: &MotorParameters, seconds: f64) -> Self {
        Self {
            seconds,
            factor: libm::exp(-parameters.resistance / parameters.inductance * seconds),
        }
    }
}

const INVERSE_SQRT_3: f64 = 0.577_350_269_189_625_8;

/// Phases A, B, C of a vector (alpha, beta), amplitude kept.
#[must_use]
pub fn from_alpha_beta([alpha, beta]: [f64; 2]) -> [f64; 3] {
    let half_root = 3f64.sqrt() / 2.0;
    [alpha, -0.5 * alpha + half_root * beta, -0.5 * alpha - half_root * beta]
}

/// Transforms phases A, B, C into the vector (alpha, beta), amplitude kept; what they have in common is dropped.
#[must_use]
pub fn to_alpha_beta([a, b, c]: [f64; 3]) -> [f64; 2] {
    [(2.0 * a - b - c) / 3.0, (b - c) * INVERSE_SQRT_3]
}
