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
use crate::fast::units::{multiply_high, within};
use crate::hardware::{Duty, Turn};

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
}

/// What the loop works from in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Input {
    /// Currents of phases A and B into the motor, 2^-16 A; `None` for voltage mode.
    pub phases: Option<[i32; 2]>,
    /// Electrical angle at the moment of the samples.
    pub angle: Turn,
    /// Electrical speed, 2^-32 turn per tick.
    pub speed: i32,
    /// Torque-making current wanted, 2^-16 A.
    pub current_q: i32,
}

/// State of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CurrentLoop {
    integral: Rotor,
    current: Rotor,
    voltage: Rotor,
    limited: bool,
}

impl CurrentLoop {
    /// Currents as of the last tick, 2^-16 A.
    #[must_use]
    pub const fn current(&self) -> Rotor {
        self.current
    }

    /// Voltages asked for in the last tick, after limiting, 2^-16 V.
    #[must_use]
    pub const fn voltage(&self) -> Rotor {
        self.voltage
    }

    /// What the motor took beyond the model: zero for a perfect model, 2^-16 V.
    #[must_use]
    pub const fn residual(&self) -> Rotor {
        self.integral
    }

    /// Whether the voltage limit held in the last tick.
    #[must_use]
    pub const fn limited(&self) -> bool {
        self.limited
    }

    /// Clarke to duties. Never panics.
    #[inline(always)]
    pub fn update(&mut self, model: &Model, bus: &Bus, input: &Input) -> [Duty; 3] {
        let direction = Direction::new(input.angle);
        let (current, phases) = match input.phases {
            Some([a, b]) => {
                (park(clarke(a, b), direction), [a, b, a.wrapping_add(b).wrapping_neg()])
            }
            None => {
                let wanted = Rotor { d: 0, q: input.current_q };
                (wanted, inverse_clarke(inverse_park(wanted, direction)))
            }
        };
        self.current = current;
        let error =
            Rotor { d: current.d.wrapping_neg(), q: input.current_q.wrapping_sub(current.q) };
        let wanted = self.demand(model, input, current, error);
        let voltage = self.limit(wanted, bus);
        self.voltage = voltage;
        let step = |error: i32| multiply_high(error.wrapping_shl(8), model.integral);
        self.integral.d = self.integral.d.wrapping_add(step(error.d));
        self.integral.q = self.integral.q.wrapping_add(step(error.q));

        let lead = multiply_high(input.speed, model.lead) << 4;
        let [a, b, c] = inverse_clarke(inverse_park(turn_ahead(voltage, lead), direction));
        let [i_a, i_b, i_c] = phases;
        bus.duties([
            a.wrapping_add(bus.dead_time_compensation(i_a)),
            b.wrapping_add(bus.dead_time_compensation(i_b)),
            c.wrapping_add(bus.dead_time_compensation(i_c)),
        ])
    }

    /// Voltage before limiting.
    #[inline(always)]
    fn demand(&self, model: &Model, input: &Input, current: Rotor, error: Rotor) -> Rotor {
        // d couples to q by what is wanted and q to d by what is: the wanted d is zero.
        let reactance = multiply_high(input.speed, model.reactance);
        let coupling_d = multiply_high(input.current_q.wrapping_shl(10), reactance);
        let coupling_q = multiply_high(current.d.wrapping_shl(10), reactance);
        let resistive = multiply_high(input.current_q.wrapping_shl(8), model.resistance);
        let back_emf = multiply_high(input.speed, model.back_emf);
        Rotor {
            d: multiply_high(error.d.wrapping_shl(8), model.proportional)
                .wrapping_add(self.integral.d)
                .wrapping_sub(coupling_d),
            q: multiply_high(error.q.wrapping_shl(8), model.proportional)
                .wrapping_add(self.integral.q)
                .wrapping_add(resistive)
                .wrapping_add(coupling_q)
                .wrapping_add(back_emf),
        }
    }

    /// The voltage nearest to what is wanted that the bridge can give: d gets up to half of the
    /// limit, q the rest, `sqrt(limit^2 - d^2)`. What was wanted beyond it is taken back from the
    /// integrals within a few ticks, so that they stay bounded.
    #[inline(always)]
    fn limit(&mut self, wanted: Rotor, bus: &Bus) -> Rotor {
        // Most often neither is near its limit: d within a quarter leaves q at least 0.968.
        let near = |value: i32, bound: i32| {
            value.wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2)
        };
        self.limited = false;
        if near(wanted.d, bus.limit_d >> 1) && near(wanted.q, bus.limit_q) {
            return wanted;
        }
        core::hint::cold_path();
        let given = circle(wanted, bus);
        let excess = |given: i32, wanted: i32| given.wrapping_sub(wanted) >> BACK_CALCULATION_SHIFT;
        self.limited = given != wanted;
        self.integral.d = self.integral.d.wrapping_add(excess(given.d, wanted.d));
        self.integral.q = self.integral.q.wrapping_add(excess(given.q, wanted.q));
        given
    }
}

/// d within half of the limit, q within what that leaves.
const fn circle(wanted: Rotor, bus: &Bus) -> Rotor {
    let d = within(wanted.d, bus.limit_d);
    // sqrt(1 - y) = 1 - y/2 - y^2/8 - y^3/16, wrong by at most 2e-4 for y up to 1/4; in 2^-15.
    let share = multiply_high(d << 8, bus.reciprocal_limit);
    let y = share.wrapping_mul(share) >> 15;
    let y_squared = y.wrapping_mul(y) >> 15;
    let y_cubed = y_squared.wrapping_mul(y) >> 15;
    let root = (1 << 15) - (y >> 1) - (y_squared >> 3) - (y_cubed >> 4);
    let q = within(wanted.q, multiply_high(bus.limit << 2, root << 15));
    Rotor { d, q }
}
