//! Voltage headroom: what the battery leaves for f, and a direct current against the magnets where it leaves little.
//!
//! A motor at the electrical speed `w`, with `X = w L` and `E = w lambda`, takes in its rotor's frame
//!
//! ```text
//! v_d = R i_d - X i_q,   v_q = R i_q + X i_d + E,   v_d^2 + v_q^2 <= V^2
//! ```
//!
//! *Weakening*: where the reference currents ask for nearly all of `V`, `i_d = -i_w` grows until they do not. The voltage is least
//! at `i_w = X E / (R^2 + X^2)`, whatever `i_q` carries: beyond it weakening takes voltage rather than giving it.
//!
//! *Ceiling*: the f at which the load that the rotors show takes all of `V` but a margin, with as much weakening as there is. It
//! follows battery, load and motors as they are. What is asked beyond it is clamped to it, so that theta, which needs voltage too,
//! keeps some, and so that f is known to be limited by its cause rather than by what comes of it.
//!
//! Both work from references and from the model: a current sense that is off must not reach them. What a motor takes beyond its
//! model lowers the ceiling too, on average over several electrical turns, in which an offset of the sense cancels.

use crate::fast::foc::current::{Model, REACTANCE_BITS, across, volts};
use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::Rotor;
use crate::units::{Current, ElectricalSpeed, Speed, Voltage, magnitude, multiply_high, within};

/// Ticks from one look at a motor to the next.
pub(crate) const LOOK_TICKS: u32 = 16;
/// Beyond any f that can be asked for: 36 Hz, which is no ceiling.
const HIGHEST: i32 = Speed::from_centihertz(3_600).raw();
/// No ceiling is lower: 1 Hz.
const LOWEST: i32 = Speed::from_centihertz(100).raw();
/// Asked for beyond the ceiling by more than this, f is limited: 0.02 Hz.
const BEYOND: i32 = Speed::from_centihertz(2).raw();
/// The square of all of the voltage.
const ALL: i32 = 1 << 28;
/// Weakening holds the references at 7/8 of the voltage.
const PRESSED: i32 = ALL / 64 * (7 * 7);
/// The ceiling leaves 1/64 of the voltage for what comes and goes,
const USABLE: i32 = ALL / 4_096 * (63 * 63);
/// and more, of its square, where the rotors stay behind all the same, or less where no limit holds and f could be higher: model
/// and mean do not know everything. By that f falls by 5 Hz/s and rises by 0.6 Hz/s at the most.
const MARGIN_GROWS: i32 = ALL >> 12;
const MARGIN_FADES: i32 = MARGIN_GROWS >> 3;
const MOST_MARGIN: i32 = ALL / 4;
const LEAST_MARGIN: i32 = -ALL / 16;
/// What a motor takes beyond its model is averaged over 2^5 looks, 50 ms,
const BEYOND_MODEL_SHIFT: u32 = 5;
/// and is taken for an eighth of the square of the voltage at the most, either way.
const MOST_BEYOND: i32 = ALL / 8;
/// The ceiling falls by 200 Hz/s at the most and rises by 20 Hz/s, in half of [`LOOK_TICKS`].
const FALLS: i32 = Speed::from_centihertz(20_000).raw() / 1_250;
const RISES: i32 = FALLS / 10;
/// Loads are averaged over 2^5 looks, 50 ms.
const LOAD_SHIFT: u32 = 5;
/// Weakening grows to 1 A within 20 ms at the fastest, and fades within 100 ms: 2^-16 A a look.
const GROWS: i32 = 65_536 / 20 * LOOK_TICKS as i32 / 10;
const FADES: i32 = GROWS / 5;

/// What one look at a motor works from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look<'a> {
    pub(crate) model: &'a Model,
    pub(crate) bus: &'a Bus,
    /// Electrical turns per turn.
    pub(crate) pole_pairs: i32,
    /// Electrical speed of the rotor.
    pub(crate) speed: ElectricalSpeed,
    /// Currents that are the motor's references.
    pub(crate) reference: Rotor<Current>,
    /// The q current that keeps the rotor turning, zero or more.
    pub(crate) load: Current,
    /// Whether f stands, so that the load is no other.
    pub(crate) steady: bool,
    /// The currents that flow at the voltages that are given, as the loop has them.
    pub(crate) current: Rotor<Current>,
    pub(crate) voltage: Rotor<Voltage>,
    /// Whether current or voltage are at their limits.
    pub(crate) limited: bool,
    /// Whether the rotors stay behind because of a limit.
    pub(crate) lags: bool,
    /// f that is asked for.
    pub(crate) setpoint: Speed,
    /// By which share the rotor's speed comes and goes within a turn, 2^-32.
    pub(crate) ripple: i32,
    /// Largest current.
    pub(crate) limit: Current,
}

/// Weakening of both motors, and the ceiling of f.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Headroom {
    /// `i_w`, zero or more.
    weakening: [Current; 2],
    /// What keeps each rotor turning, as of when f stood.
    loads: [Current; 2],
    /// What each motor takes beyond its model: of the square of the voltage, as [`ALL`], in 2^-5.
    beyond_model: [i32; 2],
    /// What is left beyond [`USABLE`]: of the square of the voltage, as [`ALL`].
    margin: i32,
    /// What each motor leaves at the ceiling: of the square of the voltage, as [`ALL`].
    left: [i32; 2],
    /// 2^-32 turn per tick.
    ceiling: i32,
}

impl Headroom {
    /// Starts without weakening and without a ceiling.
    pub(crate) const fn new() -> Self {
        Self {
            weakening: [Current::ZERO; 2],
            loads: [Current::ZERO; 2],
            beyond_model: [0; 2],
            margin: 0,
            left: [ALL; 2],
            ceiling: HIGHEST,
        }
    }

    /// Returns f within the ceiling.
    pub(crate) const fn clamp(&self, frequency: Speed) -> Speed {
        Speed::from_raw(within(frequency.raw(), self.ceiling))
    }

    /// Returns whether the ceiling is below what is asked.
    pub(crate) const fn limits(&self, setpoint: Speed) -> bool {
        magnitude(setpoint.raw()) - self.ceiling > BEYOND
    }

    /// Returns the direct current of a motor, zero or less, as far as its q current leaves room below `limit`.
    #[inline(always)]
    pub(crate) fn direct_current(&self, motor: usize, q: Current, limit: Current) -> Current {
        -self.weakening[motor % 2].min(room(q, limit))
    }

    /// Looks at one motor, due every [`LOOK_TICKS`] for each. Never panics.
    pub(crate) fn look(&mut self, motor: usize, look: &Look<'_>) {
        let Look { model, bus, reference, limit, .. } = *look;
        let load = &mut self.loads[motor % 2];
        if look.steady {
            *load = *load + Current::from_raw((look.load - *load).raw() >> LOAD_SHIFT);
            let change = match (look.lags, look.limited) {
                (true, _) => MARGIN_GROWS,
                (false, true) => 0,
                (false, false) => -MARGIN_FADES,
            };
            let least = if self.limits(look.setpoint) { LEAST_MARGIN } else { 0 };
            self.margin = (self.margin + change).max(least).min(MOST_MARGIN);
        }
        let load = self.loads[motor % 2];
        let fastest = self.ceiling + multiply_high(self.ceiling, look.ripple);
        let fastest = ElectricalSpeed::from_raw(fastest.wrapping_mul(look.pole_pairs));
        let most =
            weakest(model, fastest).min(room(load, limit)).min(direct(model, bus, fastest, load));

        let pressed = voltage_square(model, bus, look.speed, reference) - PRESSED;
        // 1/8 A for each volt.
        let change = multiply_high(bus.limit.raw(), pressed).clamp(-FADES, GROWS);
        let weakening = &mut self.weakening[motor % 2];
        *weakening = (*weakening + Current::from_raw(change)).min(most).max(Current::ZERO);

        let point = Rotor { d: -most, q: load };
        // What the motor takes beyond its model, on average: flux, resistance and dead time.
        let modelled = voltage_square(model, bus, look.speed, look.current);
        let beyond = &mut self.beyond_model[motor % 2];
        let now = (square(bus, look.voltage) - modelled).clamp(-MOST_BEYOND, MOST_BEYOND);
        *beyond += now - (*beyond >> BEYOND_MODEL_SHIFT);
        let left = USABLE - self.margin - voltage_square(model, bus, fastest, point);
        self.left[motor % 2] = left - (*beyond >> BEYOND_MODEL_SHIFT);
        let [top, bottom] = self.left;
        // 1/32 of the way, twice in as many ticks: within 26 ms.
        let change = multiply_high(self.ceiling, top.min(bottom)) >> 2;
        self.ceiling = (self.ceiling + change.clamp(-FALLS, RISES)).clamp(LOWEST, HIGHEST);
    }

    /// Lowers the ceiling to an f that has given way, from half of it on: below it, rotors are on their way up or round.
    pub(crate) const fn give_way(&mut self, frequency: Speed) {
        let reached = magnitude(frequency.raw());
        if reached < self.ceiling && reached > self.ceiling / 2 {
            self.ceiling = reached;
        }
    }
}

/// Returns 11/16 of the limit, or less where q comes near to it: a chord within the circle `d^2 + q^2 = limit^2`.
#[inline(always)]
fn room(q: Current, limit: Current) -> Current {
    let limit = limit.raw();
    let chord = ((limit - q.magnitude().raw()) >> 3) * 19;
    Current::from_raw(chord.min((limit >> 4) * 11).max(0))
}

/// Returns the weakening that d has voltage for, up to half of what there is, beside what q takes of it.
fn direct(model: &Model, bus: &Bus, speed: ElectricalSpeed, load: Current) -> Current {
    let reactance = multiply_high(magnitude(speed.raw()), model.reactance);
    let coupling = across(load, reactance).raw();
    let room = (bus.limit_d.raw() - (bus.limit_d.raw() >> 4) - coupling).max(0);
    model.through(Voltage::from_raw(room))
}

/// Returns the `i_w` at which a motor takes the least voltage, up to 256 A. It takes a division.
fn weakest(model: &Model, speed: ElectricalSpeed) -> Current {
    /// 32 ohm, 32 V in 2^-10: more than any motor has.
    const MOST: i32 = 1 << 15;
    let most = |value: i32| value.min(MOST) as u32;
    let speed = magnitude(speed.raw());
    let reactance = most(multiply_high(speed, model.reactance) >> (REACTANCE_BITS - 10));
    let back_emf = most(multiply_high(speed, model.back_emf) >> 6);
    let resistance = most(model.resistance >> 14);
    let square = (reactance * reactance + resistance * resistance) >> 12 | 1;
    Current::from_raw(((reactance * back_emf / square).min(1 << 20) << 4) as i32)
}

/// Returns the square of the voltage that these currents take at this speed, as [`ALL`] is that of all there is; up to 6.7 of it.
fn voltage_square(
    model: &Model,
    bus: &Bus,
    speed: ElectricalSpeed,
    current: Rotor<Current>,
) -> i32 {
    let reactance = multiply_high(speed.raw(), model.reactance);
    let back_emf = Voltage::from_raw(multiply_high(speed.raw(), model.back_emf));
    let d = volts(current.d, model.resistance) - across(current.q, reactance);
    let q = volts(current.q, model.resistance) + across(current.d, reactance) + back_emf;
    square(bus, Rotor { d, q })
}

/// Returns the square of a voltage, as [`ALL`] is that of all there is; up to 6.7 of it.
fn square(bus: &Bus, voltage: Rotor<Voltage>) -> i32 {
    let square = |voltage: Voltage| {
        // 64 V are more than any bus has. Over what there is, 2^-14.
        let share = multiply_high(within(voltage.raw(), 1 << 22) << 8, bus.reciprocal_limit) >> 1;
        let share = within(share, 30_000);
        share * share
    };
    square(voltage.d) + square(voltage.q)
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use super::*;
    use crate::fast::configuration::regulator;
    use crate::settings::Settings;

    const POLE_PAIRS: i32 = 7;
    const LIMIT: f64 = 1.7;

    fn amperes(current: Current) -> f64 {
        f64::from(current.raw()) / 65_536.0
    }

    /// A motor, its battery and its load.
    #[derive(Debug, Clone, Copy)]
    struct Motor {
        ohm: f64,
        henry: f64,
        weber: f64,
        bus: f64,
        load: f64,
    }

    impl Motor {
        /// From a battery that is too weak for 36 Hz to one that is not, of small resistance and of small inductance.
        fn all() -> impl Iterator<Item = Self> {
            let of = |values: [f64; 3]| values.into_iter();
            of([0.75, 2.5, 7.5]).flat_map(move |ohm| {
                of([0.3e-3, 1e-3, 3e-3]).flat_map(move |henry| {
                    of([2e-3, 3e-3, 4.2e-3]).flat_map(move |weber| {
                        of([8.0, 10.0, 12.6]).flat_map(move |bus| {
                            of([0.02, 0.1, 0.4]).map(move |load| Self {
                                ohm,
                                henry,
                                weber,
                                bus,
                                load,
                            })
                        })
                    })
                })
            })
        }

        fn model(&self) -> Model {
            let settings = Settings {
                phase_resistance: [self.ohm as f32; 2],
                phase_inductance: [self.henry as f32 * 1e3; 2],
                flux_linkage: [self.weber as f32 * 1e3; 2],
                ..Settings::DEFAULT
            };
            regulator(&settings, 0)
        }

        fn bus(&self) -> Bus {
            Bus::new(Voltage::from_volts(self.bus), 0)
        }

        /// Returns the voltage of both axes, V.
        fn voltage(&self, hertz: f64, d: f64, q: f64) -> [f64; 2] {
            let speed = TAU * hertz * f64::from(POLE_PAIRS);
            let reactance = speed * self.henry;
            [self.ohm * d - reactance * q, self.ohm * q + reactance * d + speed * self.weber]
        }

        /// Returns the voltage over what there is.
        fn share(&self, hertz: f64, d: f64, q: f64) -> f64 {
            let [v_d, v_q] = self.voltage(hertz, d, q);
            v_d.hypot(v_q) / (0.6 * self.bus)
        }

        fn weakest(&self, hertz: f64) -> f64 {
            let speed = TAU * hertz * f64::from(POLE_PAIRS);
            let reactance = speed * self.henry;
            reactance * speed * self.weber / (self.ohm * self.ohm + reactance * reactance)
        }

        fn room(&self, q: f64) -> f64 {
            (19.0 / 8.0 * (LIMIT - q)).clamp(0.0, 11.0 / 16.0 * LIMIT)
        }

        /// Returns the most weakening at this f, A.
        fn most(&self, hertz: f64) -> f64 {
            let coupling = TAU * hertz * f64::from(POLE_PAIRS) * self.henry * self.load;
            let direct = (0.3 * self.bus * 15.0 / 16.0 - coupling).max(0.0) / self.ohm;
            self.weakest(hertz).min(self.room(self.load)).min(direct)
        }

        /// Returns the f at which the voltage is used, Hz, by halving.
        fn ceiling(&self, ripple: f64) -> f64 {
            let (mut low, mut high) = (1.0, 36.0);
            for _ in 0..40 {
                let middle = (low + high) / 2.0;
                let fastest = middle * (1.0 + ripple);
                let most = self.most(fastest);
                let fits = self.share(fastest, -most, self.load) < 63.0 / 64.0;
                if fits { low = middle } else { high = middle }
            }
            low
        }

        /// Looks at both motors, both of this kind, for so many seconds, at this f with a q current.
        fn look(&self, headroom: &mut Headroom, seconds: f64, hertz: f64, ripple: f64) {
            let (model, bus) = (self.model(), self.bus());
            let limit = Current::from_amperes(LIMIT);
            let q = Current::from_amperes(self.load);
            let speed = ElectricalSpeed::from_raw((hertz * 7.0 * 429_496.729_6) as i32);
            for _ in 0..(seconds * 1e4 / f64::from(LOOK_TICKS)) as u32 {
                for motor in [0, 1] {
                    let reference = Rotor { d: headroom.direct_current(motor, q, limit), q };
                    let [v_d, v_q] = self
                        .voltage(hertz, amperes(reference.d), self.load)
                        .map(Voltage::from_volts);
                    let look = Look {
                        model: &model,
                        bus: &bus,
                        pole_pairs: POLE_PAIRS,
                        speed,
                        reference,
                        load: q,
                        steady: true,
                        limited: false,
                        lags: false,
                        setpoint: Speed::ZERO,
                        current: reference,
                        voltage: Rotor { d: v_d, q: v_q },
                        ripple: (ripple * 4_294_967_296.0) as i32,
                        limit,
                    };
                    headroom.look(motor, &look);
                }
            }
        }
    }

    fn hertz(headroom: &Headroom) -> f64 {
        f64::from(headroom.ceiling) / f64::from(Speed::from_centihertz(100).raw())
    }

    #[test]
    fn the_ceiling_is_the_f_at_which_the_load_takes_the_voltage_but_a_64th() {
        let mut ceilings = std::vec::Vec::new();
        for motor in Motor::all() {
            for ripple in [0.0, 0.03] {
                let mut headroom = Headroom::new();
                motor.look(&mut headroom, 1.5, 10.0, ripple);
                let (found, expected) = (hertz(&headroom), motor.ceiling(ripple));
                assert!((found / expected - 1.0).abs() < 0.005, "{found} {expected} {motor:?}");
                ceilings.push(found);
            }
        }
        let limited = ceilings.iter().filter(|it| **it < 35.0).count();
        assert!(limited > 100 && ceilings.len() - limited > 100, "{limited}");
    }

    #[test]
    fn the_ceiling_follows_the_battery_down_and_up_within_a_fifth_of_a_second() {
        let weak = Motor { ohm: 2.5, henry: 1e-3, weber: 3e-3, bus: 8.0, load: 0.1 };
        let strong = Motor { bus: 9.0, ..weak };
        let mut headroom = Headroom::new();
        for motor in [weak, strong, weak] {
            motor.look(&mut headroom, 0.2, 10.0, 0.0);
            let (found, expected) = (hertz(&headroom), motor.ceiling(0.0));
            assert!((found / expected - 1.0).abs() < 0.03, "{found} {expected}");
        }
    }

    /// A motor at rest, of which nothing is asked.
    fn standing<'a>(model: &'a Model, bus: &'a Bus, pole_pairs: i32, limit: Current) -> Look<'a> {
        Look {
            model,
            bus,
            pole_pairs,
            speed: ElectricalSpeed::ZERO,
            reference: Rotor::default(),
            load: Current::ZERO,
            steady: true,
            limited: false,
            lags: false,
            setpoint: Speed::ZERO,
            current: Rotor::default(),
            voltage: Rotor::default(),
            ripple: 0,
            limit,
        }
    }

    #[test]
    fn the_motor_that_has_less_voltage_to_spare_sets_the_ceiling() {
        let strong = Motor { ohm: 2.5, henry: 1e-3, weber: 3e-3, bus: 8.0, load: 0.05 };
        let weak = Motor { load: 0.5, ..strong };
        for weaker in [0, 1] {
            let mut headroom = Headroom::new();
            let limit = Current::from_amperes(LIMIT);
            let bus = strong.bus();
            for _ in 0..1_000 {
                for index in [0, 1] {
                    let motor = if index == weaker { weak } else { strong };
                    let model = motor.model();
                    let load = Current::from_amperes(motor.load);
                    let look = Look { load, ..standing(&model, &bus, POLE_PAIRS, limit) };
                    headroom.look(index, &look);
                }
            }
            let (found, expected) = (hertz(&headroom), weak.ceiling(0.0));
            assert!((found / expected - 1.0).abs() < 0.005, "{found} {expected}");
        }
    }

    #[test]
    fn what_a_ramp_takes_is_no_load_and_what_a_motor_takes_beyond_its_model_lowers_the_ceiling() {
        let motor = Motor { ohm: 2.5, henry: 1e-3, weber: 3e-3, bus: 7.6, load: 0.1 };
        let look = |headroom: &mut Headroom, load: f64, steady: bool, volts: f64| {
            let voltage = Rotor { d: Voltage::ZERO, q: Voltage::from_volts(volts) };
            let load = Current::from_amperes(load);
            for _ in 0..500 {
                for index in [0, 1] {
                    headroom.look(
                        index,
                        &Look {
                            model: &motor.model(),
                            bus: &motor.bus(),
                            pole_pairs: POLE_PAIRS,
                            speed: ElectricalSpeed::ZERO,
                            reference: Rotor { d: Current::ZERO, q: load },
                            load,
                            steady,
                            limited: false,
                            lags: false,
                            setpoint: Speed::ZERO,
                            current: Rotor::default(),
                            voltage,
                            ripple: 0,
                            limit: Current::from_amperes(LIMIT),
                        },
                    );
                }
            }
            hertz(headroom)
        };
        let mut headroom = Headroom::new();
        assert!(look(&mut headroom, 0.1, true, 0.0) > 35.9);
        assert!(look(&mut headroom, 1.0, false, 0.0) > 35.9);
        // 2.4 V of 4.6 V: more than an eighth of the square.
        let lower = look(&mut headroom, 0.1, true, 2.4);
        assert!((30.0..35.5).contains(&lower), "{lower}");
    }

    #[test]
    fn f_that_gave_way_lowers_the_ceiling_which_rises_by_20_hz_a_second() {
        let motor = Motor { ohm: 2.5, henry: 1e-3, weber: 3e-3, bus: 12.6, load: 0.1 };
        let mut headroom = Headroom::new();
        for sign in [1, -1] {
            headroom.give_way(Speed::from_centihertz(sign * 2_500));
            assert!((hertz(&headroom) - 25.0).abs() < 0.01);
            headroom.give_way(Speed::from_centihertz(sign * 3_000));
            headroom.give_way(Speed::from_centihertz(sign * 1_240));
            assert!((hertz(&headroom) - 25.0).abs() < 0.01);
            motor.look(&mut headroom, 0.2, 10.0, 0.0);
            assert!((hertz(&headroom) - 29.0).abs() < 0.1, "{}", hertz(&headroom));
        }
    }

    #[test]
    fn f_is_limited_by_what_is_asked_beyond_the_ceiling_either_way() {
        let ceiling = Speed::from_centihertz(3_000).raw();
        let headroom = Headroom { ceiling, ..Headroom::new() };
        for sign in [1, -1] {
            let asked = |beyond: i32| Speed::from_raw(sign * (ceiling + beyond));
            assert_eq!(headroom.clamp(asked(-5)), asked(-5));
            assert_eq!(headroom.clamp(asked(5)), asked(0));
            assert!(!headroom.limits(asked(BEYOND)) && headroom.limits(asked(BEYOND + 1)));
            assert!(!Headroom::new().limits(Speed::from_centihertz(sign as i64 * 3_500)));
        }
    }

    #[test]
    fn weakening_holds_the_references_at_7_8ths_of_the_voltage_where_it_can_and_fades_where_there_is_enough()
     {
        for motor in Motor::all() {
            let mut headroom = Headroom::new();
            let f = motor.ceiling(0.0).min(35.0);
            motor.look(&mut headroom, 0.5, f, 0.0);
            let d = amperes(headroom.direct_current(
                0,
                Current::from_amperes(motor.load),
                Current::from_amperes(LIMIT),
            ));
            let most = motor.most(hertz(&headroom));
            let (with, without) = (motor.share(f, d, motor.load), motor.share(f, 0.0, motor.load));
            if without < 0.87 {
                assert_eq!(d, 0.0, "{motor:?}");
            } else if -d < 0.97 * most - 0.01 {
                assert!((with - 0.875).abs() < 0.005, "{with} {d} of {most}: {motor:?}");
            }
            assert!(with <= without && -d < 1.03 * most + 0.01, "{d} of {most}: {motor:?}");
            motor.look(&mut headroom, 0.2, 5.0, 0.0);
            assert_eq!(headroom.weakening, [Current::ZERO; 2]);
        }
    }

    #[test]
    fn weakening_and_torque_together_stay_within_the_limit_of_the_current() {
        let limit = Current::from_amperes(LIMIT);
        let full = Headroom { weakening: [Current::from_amperes(5.0); 2], ..Headroom::new() };
        for q in 0..=180 {
            for sign in [1.0, -1.0] {
                let q = f64::from(q) * 0.01 * sign;
                let d = amperes(full.direct_current(1, Current::from_amperes(q), limit));
                assert!(d <= 0.0 && (d == 0.0 || d.hypot(q) <= LIMIT), "{d} {q}");
            }
        }
        assert!(amperes(full.direct_current(0, Current::ZERO, limit)) < -0.68 * LIMIT);
    }

    #[test]
    fn no_motor_that_can_be_set_makes_a_sum_wrap() {
        use crate::settings::TABLE;
        let ends = ["phase_resistance", "phase_inductance", "flux_linkage"];
        for bits in 0..1_u32 << 4 {
            let end = |bit: u32, name: &str| {
                let setting = TABLE.iter().find(|it| it.name == name).unwrap();
                if bits >> bit & 1 == 0 { setting.minimum } else { setting.maximum }
            };
            let mut settings = Settings::DEFAULT;
            for (bit, name) in (0..).zip(ends) {
                let name = std::format!("top_{name}");
                settings.set(&name, end(bit, &name)).unwrap();
            }
            let model = regulator(&settings, 0);
            let pole_pairs = end(3, "pole_pairs") as i32;
            for (volts, sign, limit) in [(0.0, 1.0, 20.0), (70.0, 1.0, 0.1), (11.1, -1.0, 1.7)] {
                let mut headroom = Headroom::new();
                let bus = Bus::new(Voltage::from_volts(volts), 0);
                for _ in 0..2_000 {
                    let limit = Current::from_amperes(limit);
                    let q = Current::from_raw((f64::from(limit.raw()) * sign) as i32);
                    let reference = Rotor { d: headroom.direct_current(0, q, limit), q };
                    let speed = (75.0 * 429_496.729_6 * f64::from(pole_pairs) * sign) as i32;
                    let look = Look {
                        speed: ElectricalSpeed::from_raw(speed),
                        reference,
                        load: q.magnitude(),
                        ripple: 1 << 27,
                        ..standing(&model, &bus, pole_pairs, limit)
                    };
                    headroom.look(0, &look);
                    assert!((LOWEST..=HIGHEST).contains(&headroom.ceiling));
                    assert!(headroom.weakening[0] >= Current::ZERO);
                }
            }
        }
    }
}
