//! The current loop of one motor: d/q proportional-integral control with feed-forward of
//! resistance, speed coupling and back-EMF, a voltage limit that d may take at most half of, and
//! integrators that are pulled back when the limit holds (back-calculation).
//!
//! Without a current sense the same code runs in voltage mode: the current that the model says flows is taken for the
//! measurement, and there is no integral. So a motor follows its reference as quickly as with a sense, however slow its
//! winding, and where the voltage limit holds d is decoupled from the current that is left.

use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::{Direction, Rotor, clarke, inverse_clarke, inverse_park, park};
use crate::units::{
    Current, Duty, ElectricalAngle, ElectricalSpeed, Voltage, multiply_high, shifted, within,
};

/// How quickly a held voltage limit pulls the integrators back: a quarter of the excess a tick.
const BACK_CALCULATION_SHIFT: u32 = 2;

/// Fixed point of `Model::proportional`: 1,500 Hz and 20 mH make 188 V/A.
pub const PROPORTIONAL_BITS: u32 = 23;
/// Fixed point of [`Model::reactance`]: 20 mH make 1,257 ohm.
pub const REACTANCE_BITS: u32 = 20;
/// Fixed point of [`Model::delay`]: 500 us are 5 ticks.
pub const DELAY_BITS: u32 = 28;

/// One motor as its current loop sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Model {
    /// Proportional gain, V/A in 2^-[`PROPORTIONAL_BITS`].
    pub proportional: i32,
    /// Integral gain, V/A per tick in 2^-24.
    pub integral: i32,
    /// Phase resistance, ohm in 2^-24.
    pub resistance: i32,
    /// One over the phase resistance, S in 2^-24.
    pub conductance: i32,
    /// What a volt adds to the current in a tick, S in 2^-24.
    pub admittance: i32,
    /// Phase inductance times electrical speed: ohm per (turn per tick), in 2^-[`REACTANCE_BITS`].
    pub reactance: i32,
    /// Flux linkage times electrical speed: 2^-16 V per (2^-32 turn per tick), in 2^-32.
    pub back_emf: i32,
    /// From the samples of a tick to the middle of the interval in which its duties act, ticks in 2^-[`DELAY_BITS`].
    pub delay: i32,
    /// What dead time takes of a small current, V/A in 2^-24.
    pub dead_time: i32,
}

impl Model {
    /// Returns the proportional part for an error below 128 A.
    #[inline(always)]
    const fn proportional(&self, error: Current) -> Voltage {
        Voltage::from_raw(shifted(volts(error, self.proportional).raw(), 24 - PROPORTIONAL_BITS))
    }

    /// Returns what a voltage below 128 V drives through the resistance alone.
    pub(crate) const fn through(&self, voltage: Voltage) -> Current {
        Current::from_raw(multiply_high(shifted(voltage.raw(), 8), self.conductance))
    }

    /// Returns what the back-EMF would drive through the resistance alone at this electrical speed.
    pub(crate) const fn shorted(&self, speed: ElectricalSpeed) -> Current {
        self.through(Voltage::from_raw(multiply_high(speed.raw(), self.back_emf)))
    }

    /// Returns a current a tick later, by the voltage for its error and what the limit gave beyond that.
    #[inline(always)]
    const fn next(&self, current: Current, error: Current, excess: Voltage) -> Current {
        let [across, proportional] = [volts(error, self.resistance), self.proportional(error)];
        // 64 V are more than any bus has, and 32 A more than any bridge.
        let voltage = within(across.raw() + proportional.raw() + excess.raw(), 1 << 22);
        let change = multiply_high(shifted(voltage, 8), self.admittance);
        Current::from_raw(within(current.raw() + change, 32 << 16))
    }
}

/// What the loop works from in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Input {
    /// Currents of phases A and B into the motor, below 32 A; `None` for voltage mode.
    pub phases: Option<[Current; 2]>,
    /// Electrical angle at the moment of the samples.
    pub angle: ElectricalAngle,
    /// Electrical speed.
    pub speed: ElectricalSpeed,
    /// What is to flow: q makes the torque, d only heat.
    pub reference: Rotor<Current>,
}

/// State of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CurrentLoop {
    integral: Rotor<Voltage>,
    current: Rotor<Current>,
    voltage: Rotor<Voltage>,
    limited: bool,
    /// Whether it was since somebody asked.
    has_been_limited: bool,
    /// By how much the current of the last tick missed its reference.
    error: Rotor<Current>,
    /// What the limit gave beyond the voltage before it, where it held.
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
        let Rotor { d, q } = self.error;
        let missing = |error| volts(error, model.resistance) + model.proportional(error);
        // d was decoupled from the reference of q, not from the one that flows.
        let coupling = across(q, multiply_high(speed.raw(), model.reactance));
        let held =
            Rotor { d: self.integral.d + missing(d) - coupling, q: self.integral.q + missing(q) };
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

    /// Returns whether the voltage limit held in any tick since the last call.
    pub(crate) const fn take_limited(&mut self) -> bool {
        core::mem::replace(&mut self.has_been_limited, false)
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
            None => (self.current, inverse_clarke(inverse_park(self.current, direction))),
        };
        self.current = current;
        let error = Rotor { d: input.reference.d - current.d, q: input.reference.q - current.q };
        let unlimited = self.unlimited_voltage(model, input, current, error);
        let voltage = self.limit(unlimited, bus, input);
        self.voltage = voltage;
        if input.phases.is_some() {
            self.error = error;
            self.integral.d = self.integral.d + volts(error.d, model.integral);
            self.integral.q = self.integral.q + volts(error.q, model.integral);
        } else {
            self.current.d = model.next(current.d, error.d, voltage.d - unlimited.d);
            self.current.q = model.next(current.q, error.q, voltage.q - unlimited.q);
        }

        // What is beyond a turn goes, as in every angle.
        let lead = multiply_high(input.speed.raw(), model.delay) << (32 - DELAY_BITS);
        let ahead = Direction::from(input.angle.turned(lead));
        let [a, b, c] = inverse_clarke(inverse_park(voltage, ahead));
        let [i_a, i_b, i_c] = phases;
        bus.duties([
            a + bus.dead_time_compensation(model.dead_time, i_a),
            b + bus.dead_time_compensation(model.dead_time, i_b),
            c + bus.dead_time_compensation(model.dead_time, i_c),
        ])
    }

    /// Returns the voltage before limiting.
    #[inline(always)]
    fn unlimited_voltage(
        &self,
        model: &Model,
        input: &Input,
        current: Rotor<Current>,
        error: Rotor<Current>,
    ) -> Rotor<Voltage> {
        let (speed, reference) = (input.speed.raw(), input.reference);
        // d couples to q by the reference, where the current is not known better, and q to d by what flows: that d is most often zero.
        let coupled = if input.phases.is_some() { reference.q } else { current.q };
        let reactance = multiply_high(speed, model.reactance);
        let back_emf = Voltage::from_raw(multiply_high(speed, model.back_emf));
        Rotor {
            d: model.proportional(error.d) + self.integral.d + volts(reference.d, model.resistance)
                - across(coupled, reactance),
            q: model.proportional(error.q)
                + self.integral.q
                + volts(reference.q, model.resistance)
                + across(current.d, reactance)
                + back_emf,
        }
    }

    /// Returns the voltage nearest to this one that the bridge can give: d gets up to half of
    /// the limit, q the rest, `sqrt(limit^2 - d^2)`. Where currents are measured, what is beyond
    /// it is taken back from the integrals within a few ticks, so that they stay bounded.
    #[inline(always)]
    fn limit(&mut self, voltage: Rotor<Voltage>, bus: &Bus, input: &Input) -> Rotor<Voltage> {
        // Most often neither is near its limit: d within a quarter leaves q at least 0.968.
        let near = |value: Voltage, bound: i32| {
            value.raw().wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2)
        };
        self.limited = false;
        if near(voltage.d, bus.limit_d.raw() >> 1) && near(voltage.q, bus.limit_q.raw()) {
            return voltage;
        }
        core::hint::cold_path();
        let given = circle(voltage, bus);
        self.limited = given != voltage;
        self.has_been_limited |= self.limited;
        if input.phases.is_none() {
            return given;
        }
        let excess = Rotor { d: given.d - voltage.d, q: given.q - voltage.q };
        self.excess = excess;
        let share = |excess: Voltage| Voltage::from_raw(excess.raw() >> BACK_CALCULATION_SHIFT);
        self.integral.d = self.integral.d + share(excess.d);
        self.integral.q = self.integral.q + share(excess.q);
        given
    }
}

/// Returns the voltage of a current below 128 A through this, V/A in 2^-24.
#[inline(always)]
pub(crate) const fn volts(current: Current, gain: i32) -> Voltage {
    Voltage::from_raw(multiply_high(shifted(current.raw(), 8), gain))
}

/// Returns the voltage across a reactance, ohm in 2^-[`REACTANCE_BITS`], that carries a current below 128 A.
#[inline(always)]
pub(crate) const fn across(current: Current, reactance: i32) -> Voltage {
    Voltage::from_raw(shifted(volts(current, reactance).raw(), 24 - REACTANCE_BITS))
}

/// Returns d within half of the limit, q within what that leaves.
const fn circle(voltage: Rotor<Voltage>, bus: &Bus) -> Rotor<Voltage> {
    let d = voltage.d.within(bus.limit_d);
    // sqrt(1 - y) = 1 - y/2 - y^2/8 - y^3/16, wrong by at most 2e-4 for y up to 1/4; in 2^-15.
    let share = multiply_high(shifted(d.raw(), 8), bus.reciprocal_limit);
    let y = share.wrapping_mul(share) >> 15;
    let y_squared = y.wrapping_mul(y) >> 15;
    let y_cubed = y_squared.wrapping_mul(y) >> 15;
    let root = (1 << 15) - (y >> 1) - (y_squared >> 3) - (y_cubed >> 4);
    let room = multiply_high(bus.limit.raw() << 2, root << 15);
    Rotor { d, q: Voltage::from_raw(within(voltage.q.raw(), room)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;
    use core::f64::consts::TAU;

    use crate::fast::configuration::Configuration;
    use crate::fast::ends;
    use crate::settings::Settings;

    /// A speed whose back-EMF leaves next to nothing of the bus below: 35 Hz with 7 pole pairs.
    const SPEED: ElectricalSpeed = ElectricalSpeed::from_raw(245 * 429_497);

    fn input(phases: Option<[Current; 2]>) -> Input {
        let reference = Rotor { d: Current::ZERO, q: Current::from_amperes(1.5) };
        Input { phases, angle: ElectricalAngle::from_raw(0), speed: SPEED, reference }
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

    /// The fastest field of a motor with these pole pairs that its tracker follows: 75 Hz.
    fn fastest(settings: &Settings) -> i32 {
        75 * 429_497 * settings.pole_pairs as i32
    }

    #[test]
    fn the_voltage_asked_for_is_that_of_double_precision_at_the_ends_of_all_settings() {
        let amperes = |current: f64| Current::from_amperes(current);
        for settings in ends::settings() {
            let model = Configuration::current_loop(&settings, &DENGFOC_V3_01.hardware, 0);
            let resistance = f64::from(settings.phase_resistance[0]);
            let inductance = 1e-3 * f64::from(settings.phase_inductance[0]);
            let flux = 1e-3 * f64::from(settings.flux_linkage[0]);
            let gain = inductance * f64::from(settings.current_bandwidth) * TAU;
            let limit = f64::from(settings.current_limit);
            for case in 0..32 {
                let end = |bit: u32| if case >> bit & 1 == 0 { 1.0 } else { -1.0 };
                let speed = fastest(&settings) / 2 * (1 + end(0) as i32) - fastest(&settings) / 2;
                let omega = f64::from(speed) / 4_294_967_296.0 * TAU * 1e4;
                let reference = [limit * end(1), limit * end(2)];
                let [d, q] = [30.0 * end(3), 30.0 * end(4)];
                let current = Rotor { d: amperes(d), q: amperes(q) };
                let error = Rotor { d: amperes(reference[0] - d), q: amperes(reference[1] - q) };
                let input = Input {
                    phases: Some([Current::ZERO; 2]),
                    angle: ElectricalAngle::ZERO,
                    speed: ElectricalSpeed::from_raw(speed),
                    reference: Rotor { d: amperes(reference[0]), q: amperes(reference[1]) },
                };
                let have = CurrentLoop::default().unlimited_voltage(&model, &input, current, error);
                let want = [
                    gain * (reference[0] - d) + resistance * reference[0]
                        - omega * inductance * reference[1],
                    gain * (reference[1] - q)
                        + resistance * reference[1]
                        + omega * (inductance * d + flux),
                ];
                let size =
                    gain * 60.0 + resistance * 20.0 + omega.abs() * (inductance * 30.0 + flux);
                for (have, want) in [have.d, have.q].iter().zip(want) {
                    let off = (f64::from(have.raw()) / 65_536.0 - want).abs();
                    assert!(off < 1e-3 * size + 1e-3, "{have:?} for {want} V: {settings:?}");
                }
            }
        }
    }

    #[test]
    fn the_voltage_leads_by_the_actuation_delay_however_far_the_field_turns_meanwhile() {
        for (actuation_delay, pole_pairs) in
            [(50.0, 7.0), (125.0, 7.0), (500.0, 14.0), (500.0, 32.0)]
        {
            let settings = Settings {
                actuation_delay,
                pole_pairs,
                flux_linkage: [0.2; 2],
                phase_inductance: [0.005; 2],
                ..Settings::DEFAULT
            };
            let model = Configuration::current_loop(&settings, &DENGFOC_V3_01.hardware, 0);
            let bus = Bus::new(Voltage::from_volts(12.0), 0);
            for speed in [fastest(&settings), -fastest(&settings), fastest(&settings) / 3] {
                let input = Input {
                    phases: Some([Current::ZERO; 2]),
                    angle: ElectricalAngle::ZERO,
                    speed: ElectricalSpeed::from_raw(speed),
                    reference: Rotor::default(),
                };
                let duties = CurrentLoop::default().update(&model, &bus, &input);
                let [a, b, c] = duties.map(|duty| f64::from(duty.raw()) / 65_536.0 * 12.0);
                let (alpha, beta) = ((2.0 * a - b - c) / 3.0, (b - c) / 3_f64.sqrt());
                let turns = f64::from(speed) / 4_294_967_296.0;
                // The back-EMF stands along q, a quarter turn ahead of the field.
                let want = turns * f64::from(actuation_delay) / 100.0 + 0.25 * turns.signum();
                let off = (beta.atan2(alpha) / TAU - want).rem_euclid(1.0);
                let off = off.min(1.0 - off);
                assert!(off < 3e-4, "{actuation_delay} us, {pole_pairs}, {turns}: {off} turns");
            }
        }
    }

    #[test]
    fn in_voltage_mode_the_current_is_that_of_the_voltage_that_is_given_at_the_ends_of_all_settings()
     {
        let bus = Bus::new(Voltage::from_volts(11.1), 0);
        let volts = |voltage: Voltage| f64::from(voltage.raw()) / 65_536.0;
        let amperes = |current: Current| f64::from(current.raw()) / 65_536.0;
        for settings in ends::settings() {
            let model = Configuration::current_loop(&settings, &DENGFOC_V3_01.hardware, 0);
            let resistance = f64::from(settings.phase_resistance[0]);
            let inductance = 1e-3 * f64::from(settings.phase_inductance[0]);
            let flux = 1e-3 * f64::from(settings.flux_linkage[0]);
            let kept = (-resistance * 1e-4 / inductance).exp();
            for (sign, turning) in [(1.0, 1), (1.0, -1), (-1.0, 1), (-1.0, 0)] {
                let q = Current::from_amperes(sign * f64::from(settings.current_limit));
                let speed = turning * fastest(&settings);
                let input = Input {
                    phases: None,
                    angle: ElectricalAngle::ZERO,
                    speed: ElectricalSpeed::from_raw(speed),
                    reference: Rotor { d: Current::ZERO, q },
                };
                let omega = f64::from(speed) / 4_294_967_296.0 * TAU * 1e4;
                let mut current_loop = CurrentLoop::default();
                for tick in 0..20 {
                    let [d, q] = [current_loop.current().d, current_loop.current().q].map(amperes);
                    current_loop.update(&model, &bus, &input);
                    let Rotor { d: v_d, q: v_q } = current_loop.voltage();
                    let driving = [
                        volts(v_d) + omega * inductance * q,
                        volts(v_q) - omega * (inductance * d + flux),
                    ];
                    let have = [current_loop.current().d, current_loop.current().q].map(amperes);
                    for ((now, driving), have) in [d, q].into_iter().zip(driving).zip(have) {
                        let changed = driving - resistance * now;
                        let want = now + (1.0 - kept) * changed / resistance;
                        // A voltage is right to some 2^-16 V. What impossible speeds would drive is bounded.
                        let off = (have - want).abs();
                        assert!(
                            off < 2e-3 * want.abs() + 1e-4 / resistance + 1e-3
                                || changed.abs() > 63.0
                                || have.abs() == 32.0,
                            "tick {tick}: {have} for {want}: {settings:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn in_voltage_mode_a_motor_follows_its_reference_however_slow_its_winding_is() {
        let settings = Settings { phase_inductance: [10.0; 2], ..Settings::DEFAULT };
        let model = Configuration::current_loop(&settings, &DENGFOC_V3_01.hardware, 0);
        let bus = Bus::new(Voltage::from_volts(24.0), 0);
        let reference = Rotor { d: Current::ZERO, q: Current::from_amperes(0.1) };
        let (mut current_loop, mut flows) = (CurrentLoop::default(), 0.0);
        for _ in 0..10 {
            let (angle, speed) = (ElectricalAngle::ZERO, ElectricalSpeed::ZERO);
            current_loop.update(&model, &bus, &Input { phases: None, angle, speed, reference });
            let volts = f64::from(current_loop.voltage().q.raw()) / 65_536.0;
            flows += (volts - f64::from(settings.phase_resistance[0]) * flows) / 10e-3 * 1e-4;
        }
        // Within a millisecond, of a winding that takes four.
        assert!((0.095..0.105).contains(&flows), "{flows} A");
    }

    #[test]
    fn a_limit_that_held_in_any_tick_is_said_once() {
        let mut current_loop = CurrentLoop::default();
        let model = Configuration::current_loop(&Settings::DEFAULT, &DENGFOC_V3_01.hardware, 0);
        let bus = Bus::new(Voltage::from_volts(12.0), 0);
        let update = |current_loop: &mut CurrentLoop, q: f64| {
            let reference = Rotor { d: Current::ZERO, q: Current::from_amperes(q) };
            let still = ElectricalSpeed::ZERO;
            let phases = Some([Current::ZERO; 2]);
            let angle = ElectricalAngle::ZERO;
            current_loop.update(&model, &bus, &Input { phases, angle, speed: still, reference });
        };
        update(&mut current_loop, 5.0);
        assert!(current_loop.limited());
        update(&mut current_loop, 0.0);
        assert!(!current_loop.limited());
        assert!(current_loop.take_limited());
        assert!(!current_loop.take_limited());
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
