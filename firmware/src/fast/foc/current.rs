//! The current loop of one motor: d/q proportional-integral control with feed-forward of
//! resistance, speed coupling and back-EMF, a voltage limit that d may take at most half of, and
//! integrators that are pulled back when the limit holds (back-calculation).
//!
//! Without a current sense the same code runs in voltage mode: the reference is taken for the
//! measurement, so that only the feed-forward remains, and there is no integral. Where the voltage
//! limit holds, the current is the one that the model says is left, and d is decoupled from that one.

use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::{
    Direction, Rotor, clarke, inverse_clarke, inverse_park, park, turn_ahead,
};
use crate::units::{
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
    /// One over the phase resistance, S in 2^-24.
    pub conductance: i32,
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
    /// What of the last tick's wish was not met.
    error: Rotor<Current>,
    /// What the limit gave beyond what was wanted, where it held.
    excess: Rotor<Voltage>,
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

    /// Returns what the motor takes beyond its model at this electrical speed, for the current that flows: zero for a perfect
    /// model in a steady state, whether or not the limit holds, and where no current is measured.
    #[must_use]
    pub fn residual(&self, model: &Model, speed: ElectricalSpeed) -> Rotor<Voltage> {
        let volts = |current: Current, shift: u32, gain: i32| {
            Voltage::from_raw(multiply_high(current.raw().wrapping_shl(shift), gain))
        };
        let gain = model.resistance.saturating_add(model.proportional);
        // d was decoupled from the q current that was wanted, not from the one that flows.
        let coupling = volts(self.error.q, 10, multiply_high(speed.raw(), model.reactance));
        let held = Rotor {
            d: self.integral.d + volts(self.error.d, 8, gain) - coupling,
            q: self.integral.q + volts(self.error.q, 8, gain),
        };
        if self.limited {
            return Rotor { d: held.d + self.excess.d, q: held.q + self.excess.q };
        }
        // A current that changes takes the proportional part, and an integral that a limit has left behind is made up for by it.
        let least = |integral: Voltage, held: Voltage| {
            if held.magnitude() < integral.magnitude() { held } else { integral }
        };
        Rotor { d: least(self.integral.d, held.d), q: least(self.integral.q, held.q) }
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
        self.error = error;
        let wanted = self.demand(model, input, current, error);
        let voltage = self.limit(wanted, model, bus, input);
        self.voltage = voltage;
        if input.phases.is_some() {
            let step = |error: Current| {
                Voltage::from_raw(multiply_high(error.raw().wrapping_shl(8), model.integral))
            };
            self.integral.d = self.integral.d + step(error.d);
            self.integral.q = self.integral.q + step(error.q);
        }

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
    /// the limit, q the rest, `sqrt(limit^2 - d^2)`. Where currents are measured, what was wanted beyond
    /// it is taken back from the integrals within a few ticks, so that they stay bounded.
    #[inline(always)]
    fn limit(
        &mut self,
        wanted: Rotor<Voltage>,
        model: &Model,
        bus: &Bus,
        input: &Input,
    ) -> Rotor<Voltage> {
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
        self.limited = given != wanted;
        if input.phases.is_none() {
            return self.settle(wanted, given, model, bus, input.speed);
        }
        let excess = Rotor { d: given.d - wanted.d, q: given.q - wanted.q };
        self.excess = excess;
        let share = |excess: Voltage| Voltage::from_raw(excess.raw() >> BACK_CALCULATION_SHIFT);
        self.integral.d = self.integral.d + share(excess.d);
        self.integral.q = self.integral.q + share(excess.q);
        given
    }

    /// Notes the q current that the model says a limited voltage leaves, and returns that voltage with d
    /// decoupled from what is left rather than from what was wanted: d carries no current for it.
    #[cold]
    fn settle(
        &mut self,
        wanted: Rotor<Voltage>,
        given: Rotor<Voltage>,
        model: &Model,
        bus: &Bus,
        speed: ElectricalSpeed,
    ) -> Rotor<Voltage> {
        let missing = (wanted.q - given.q).raw();
        let lost = multiply_high(missing.wrapping_shl(8), model.conductance);
        self.current.q = self.current.q - Current::from_raw(lost);
        let reactance = multiply_high(speed.raw(), model.reactance);
        let coupling = Voltage::from_raw(multiply_high(lost.wrapping_shl(10), reactance));
        circle(Rotor { d: wanted.d + coupling, q: given.q }, bus)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;
    use crate::fast::configuration::Configuration;
    use crate::settings::Settings;

    /// A speed whose back-EMF leaves next to nothing of the bus below: 35 Hz with 7 pole pairs.
    const SPEED: ElectricalSpeed = ElectricalSpeed::from_raw(245 * 429_497);

    fn input(phases: Option<[Current; 2]>) -> Input {
        let wanted = Rotor { d: Current::ZERO, q: Current::from_amperes(1.5) };
        Input { phases, angle: ElectricalAngle::from_raw(0), speed: SPEED, wanted }
    }

    /// Does ten thousand ticks at a bus voltage and returns the loop.
    fn after(volts: f64, phases: Option<[Current; 2]>) -> CurrentLoop {
        let model = Configuration::current_loop(&Settings::DEFAULT, &DENGFOC_V3_01.hardware, 0);
        let bus = Bus::new(Voltage::from_volts(volts), 0);
        let mut current_loop = CurrentLoop::default();
        for _ in 0..10_000 {
            current_loop.update(&model, &bus, &input(phases));
        }
        current_loop
    }

    #[test]
    fn a_limit_in_voltage_mode_leaves_no_integral_and_the_current_that_the_model_says() {
        let held = after(5.0, None);
        assert!(held.limited());
        assert_eq!((held.integral, held.excess), Default::default());
        let settings = Settings::DEFAULT;
        let volts = |voltage: Voltage| f64::from(voltage.raw()) / 65_536.0;
        let amperes = |current: Current| f64::from(current.raw()) / 65_536.0;
        let omega = f64::from(SPEED.raw()) / 4_294_967_296.0 * core::f64::consts::TAU * 1e4;
        let flux = f64::from(settings.flux_linkage[0]) * 1e-3;
        let reactance = omega * f64::from(settings.phase_inductance[0]) * 1e-3;
        let resistance = f64::from(settings.phase_resistance[0]);
        // The current that this voltage settles at, in both axes.
        let (d, q) = (volts(held.voltage().d), volts(held.voltage().q) - omega * flux);
        let square = resistance * resistance + reactance * reactance;
        let i_d = (resistance * d + reactance * q) / square;
        let i_q = (resistance * q - reactance * d) / square;
        assert!(i_d.abs() < 0.02, "d carries {i_d} A");
        assert!((i_q - amperes(held.current().q)).abs() < 0.02, "{i_q} A");
        assert!(i_q < 1.4, "{i_q} A");
        assert!(!after(24.0, None).limited());
    }

    #[test]
    fn a_motor_like_its_model_has_no_residual_at_the_limit_of_the_voltage_nor_after_it() {
        let settings = Settings::DEFAULT;
        let model = Configuration::current_loop(&settings, &DENGFOC_V3_01.hardware, 0);
        let omega = f64::from(SPEED.raw()) / 4_294_967_296.0 * core::f64::consts::TAU * 1e4;
        let [resistance, inductance, flux] = [
            f64::from(settings.phase_resistance[0]),
            f64::from(settings.phase_inductance[0]) * 1e-3,
            f64::from(settings.flux_linkage[0]) * 1e-3,
        ];
        let mut current_loop = CurrentLoop::default();
        let [mut d, mut q] = [0.0_f64; 2];
        let mut largest = Voltage::ZERO;
        // Limited for half a second, then not.
        for (volts, ticks) in [(9.0, 5_000), (24.0, 500)] {
            let bus = Bus::new(Voltage::from_volts(volts), 0);
            for tick in 0..ticks {
                // At angle 0 d lies along phase A.
                let phases = [d, -d / 2.0 + 0.75_f64.sqrt() * q].map(Current::from_amperes);
                current_loop.update(&model, &bus, &input(Some(phases)));
                let given = current_loop.voltage();
                let [v_d, v_q] = [given.d, given.q].map(|it| f64::from(it.raw()) / 65_536.0);
                // Ten steps of 10 us.
                for _ in 0..10 {
                    let slopes = [
                        (v_d - resistance * d + omega * inductance * q) / inductance,
                        (v_q - resistance * q - omega * (inductance * d + flux)) / inductance,
                    ];
                    d += 1e-5 * slopes[0];
                    q += 1e-5 * slopes[1];
                }
                // Once the currents stand.
                if tick >= 100 {
                    let residual = current_loop.residual(&model, SPEED);
                    largest = largest.max(residual.d.magnitude()).max(residual.q.magnitude());
                }
            }
            if volts < 10.0 {
                assert!(current_loop.limited());
                assert!(current_loop.integral.q.magnitude() > Voltage::from_volts(1.0));
            }
        }
        assert!(!current_loop.limited());
        assert!(largest < Voltage::from_volts(0.5), "{largest:?}");
    }
}
