//! The current loop of one motor: d/q proportional-integral control with feed-forward of
//! resistance, speed coupling and back-EMF, a voltage limit that d may take at most half of, and
//! integrators that are pulled back when the limit holds (back-calculation).
//!
//! Without a current sense the same code runs in voltage mode: the reference is taken for the
//! measurement, so that only the feed-forward remains.

use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::{
    Direction, Rotor, clarke, inverse_clarke, inverse_park, park, turn_ahead,
};
use crate::fast::units::{
    Current, Duty, ElectricalAngle, ElectricalSpeed, Voltage, multiply_high, within,
};

/// How quickly a held voltage limit pulls the integrators back: a quarter of the excess a tick.
const BACK_CALCULATION_SHIFT: u32 = 2;

/// One motor as its current loop sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Model {
    /// Proportional gain, V/A in 2^-24.
    pub proportional: i32,
    /// Integral gain, V/A per tick in 2^-24.
    pub integral: i32,
    /// Phase resistance, ohm in 2^-24.
    pub resistance: i32,
    /// Phase inductance times electrical speed: ohm in 2^-22 per (2^-32 turn per tick) in 2^-32.
    pub reactance: i32,
    /// Flux linkage times electrical speed: 2^-16 V per (2^-32 turn per tick), in 2^-32.
    pub back_emf: i32,
    /// Electrical turn during the actuation delay: 2^-28 rad per (2^-32 turn per tick), in 2^-32.
    pub lead: i32,
    /// What dead time takes of a small current, V/A in 2^-24.
    pub dead_time: i32,
}

/// What the loop works from in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Input {
    /// Currents of phases A and B into the motor; `None` for voltage mode.
    pub phases: Option<[Current; 2]>,
    /// Electrical angle at the moment of the samples.
    pub angle: ElectricalAngle,
    /// Electrical speed.
    pub speed: ElectricalSpeed,
    /// Wanted: q makes the torque, d only heat.
    pub wanted: Rotor<Current>,
}

/// State of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CurrentLoop {
    integral: Rotor<Voltage>,
    current: Rotor<Current>,
    voltage: Rotor<Voltage>,
    limited: bool,
}

impl CurrentLoop {
    /// Returns the currents as of the last tick.
    #[must_use]
    pub const fn current(&self) -> Rotor<Current> {
        self.current
    }

    /// Returns the voltages asked for in the last tick, after limiting.
    #[must_use]
    pub const fn voltage(&self) -> Rotor<Voltage> {
        self.voltage
    }

    /// Returns what the motor took beyond the model: zero for a perfect model.
    #[must_use]
    pub const fn residual(&self) -> Rotor<Voltage> {
        self.integral
    }

    /// Returns whether the voltage limit held in the last tick.
    #[must_use]
    pub const fn limited(&self) -> bool {
        self.limited
    }

    /// Takes what another drive measures and asks for, to be reported.
    pub(crate) const fn note(&mut self, current: Rotor<Current>, voltage: Rotor<Voltage>) {
        self.current = current;
        self.voltage = voltage;
    }

    /// Does one tick, from phase currents to duties. Never panics.
    #[inline(always)]
    pub fn update(&mut self, model: &Model, bus: &Bus, input: &Input) -> [Duty; 3] {
        let direction = Direction::from(input.angle);
        let (current, phases) = match input.phases {
            Some([a, b]) => (park(clarke(a, b), direction), [a, b, -(a + b)]),
            None => (input.wanted, inverse_clarke(inverse_park(input.wanted, direction))),
        };
        self.current = current;
        let error = Rotor { d: input.wanted.d - current.d, q: input.wanted.q - current.q };
        let wanted = self.demand(model, input, current, error);
        let voltage = self.limit(wanted, bus);
        self.voltage = voltage;
        let step = |error: Current| {
            Voltage::from_raw(multiply_high(error.raw().wrapping_shl(8), model.integral))
        };
        self.integral.d = self.integral.d + step(error.d);
        self.integral.q = self.integral.q + step(error.q);

        let lead = multiply_high(input.speed.raw(), model.lead) << 4;
        let [a, b, c] = inverse_clarke(inverse_park(turn_ahead(voltage, lead), direction));
        let [i_a, i_b, i_c] = phases;
        bus.duties([
            a + bus.dead_time_compensation(model.dead_time, i_a),
            b + bus.dead_time_compensation(model.dead_time, i_b),
            c + bus.dead_time_compensation(model.dead_time, i_c),
        ])
    }

    /// Returns the voltage before limiting.
    #[inline(always)]
    fn demand(
        &self,
        model: &Model,
        input: &Input,
        current: Rotor<Current>,
        error: Rotor<Current>,
    ) -> Rotor<Voltage> {
        let (speed, wanted) = (input.speed.raw(), input.wanted);
        let volts = |current: i32, shift: u32, gain: i32| {
            Voltage::from_raw(multiply_high(current.wrapping_shl(shift), gain))
        };
        // d couples to q by what is wanted and q to d by what is: that d is most often zero.
        let reactance = multiply_high(speed, model.reactance);
        let coupling_d = volts(wanted.q.raw(), 10, reactance);
        let coupling_q = volts(current.d.raw(), 10, reactance);
        let resistive = |current: Current| volts(current.raw(), 8, model.resistance);
        let back_emf = volts(speed, 0, model.back_emf);
        let proportional = |error: Current| volts(error.raw(), 8, model.proportional);
        Rotor {
            d: proportional(error.d) + self.integral.d + resistive(wanted.d) - coupling_d,
            q: proportional(error.q)
                + self.integral.q
                + resistive(wanted.q)
                + coupling_q
                + back_emf,
        }
    }

    /// Returns the voltage nearest to what is wanted that the bridge can give: d gets up to half of
    /// the limit, q the rest, `sqrt(limit^2 - d^2)`. What was wanted beyond it is taken back from the
    /// integrals within a few ticks, so that they stay bounded.
    #[inline(always)]
    fn limit(&mut self, wanted: Rotor<Voltage>, bus: &Bus) -> Rotor<Voltage> {
        // Most often neither is near its limit: d within a quarter leaves q at least 0.968.
        let near = |value: Voltage, bound: i32| {
            value.raw().wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2)
        };
        self.limited = false;
        if near(wanted.d, bus.limit_d.raw() >> 1) && near(wanted.q, bus.limit_q.raw()) {
            return wanted;
        }
        core::hint::cold_path();
        let given = circle(wanted, bus);
        let excess = |given: Voltage, wanted: Voltage| {
            Voltage::from_raw((given - wanted).raw() >> BACK_CALCULATION_SHIFT)
        };
        self.limited = given != wanted;
        self.integral.d = self.integral.d + excess(given.d, wanted.d);
        self.integral.q = self.integral.q + excess(given.q, wanted.q);
        given
    }
}

/// Returns d within half of the limit, q within what that leaves.
const fn circle(wanted: Rotor<Voltage>, bus: &Bus) -> Rotor<Voltage> {
    let d = wanted.d.within(bus.limit_d);
    // sqrt(1 - y) = 1 - y/2 - y^2/8 - y^3/16, wrong by at most 2e-4 for y up to 1/4; in 2^-15.
    let share = multiply_high(d.raw() << 8, bus.reciprocal_limit);
    let y = share.wrapping_mul(share) >> 15;
    let y_squared = y.wrapping_mul(y) >> 15;
    let y_cubed = y_squared.wrapping_mul(y) >> 15;
    let root = (1 << 15) - (y >> 1) - (y_squared >> 3) - (y_cubed >> 4);
    let room = multiply_high(bus.limit.raw() << 2, root << 15);
    Rotor { d, q: Voltage::from_raw(within(wanted.q.raw(), room)) }
}
