//! What the law promises, with rotors that do exactly what their currents make them do.

use std::f64::consts::TAU;

use super::*;
use crate::fast::configuration::Configuration;
use crate::fast::control::bench::HARDWARE;
use crate::fast::reference::{SLOPE_UPDATES, STANDING, STRIDE, moved};
use crate::hardware::Hardware;
use crate::settings::Settings;

const TURN: f64 = 4_294_967_296.0;
const DEGREE: f64 = TURN / 360.0;
const UPDATES_PER_S: usize = 10_000 / STRIDE as usize;

fn hertz(frequency: f64) -> Speed {
    Speed::from_hertz(frequency as f32)
}

fn degrees(angle: f64) -> RotorAngle {
    RotorAngle::from_raw((angle * DEGREE) as i64 as u32)
}

/// A disturbance of sum and difference: amplitude of the cosine and sine of a harmonic of the phase, 2^-40 turn
/// per tick^2.
#[derive(Debug, Clone, Copy, Default)]
struct Disturbance {
    harmonic: f64,
    sum: [f64; 2],
    difference: [f64; 2],
    /// The amplitude grows with the square of f, from this f on; 0: it stays.
    normal: f64,
}

/// Two rotors without friction under the shaker; angles and speeds in 2^-32 turn.
#[derive(Clone)]
struct Rig {
    model: ShakerModel,
    shaker: Shaker,
    angles: [f64; 2],
    speeds: [f64; 2],
    disturbance: Disturbance,
    voltage_limited: bool,
    torques: Torques,
}

impl Rig {
    fn at_rest() -> Self {
        let model = Configuration::new(&Settings::DEFAULT, &HARDWARE).shaker;
        let mut rig = Self {
            model,
            shaker: Shaker::at_rest(&Rotors {
                angles: [RotorAngle::ZERO; 2],
                speeds: [Speed::ZERO; 2],
            }),
            angles: [70.0 * DEGREE, -30.0 * DEGREE],
            speeds: [0.0; 2],
            disturbance: Disturbance::default(),
            voltage_limited: false,
            torques: Torques { currents: [Current::ZERO; 2], speed_changes: [Speed::ZERO; 2] },
        };
        rig.shaker = Shaker::at_rest(&rig.rotors());
        rig
    }

    /// Shakes at this f already.
    fn at(frequency: f64) -> Self {
        let mut rig = Self::at_rest();
        rig.shaker.reference.frequency = hertz(frequency);
        // The references of an update are those of its end.
        rig.shaker.reference.phase = moved(rig.shaker.reference.phase, hertz(-frequency), STRIDE);
        let speed = f64::from(hertz(frequency).raw());
        rig.speeds = [speed, -speed];
        rig
    }

    /// Returns current over acceleration of a motor.
    fn gain(&self, motor: usize) -> f64 {
        let gain = f64::from(self.model.current_per_acceleration[motor]) / TURN;
        gain * f64::from(1_u32 << self.model.acceleration_shift)
    }

    fn rotors(&self) -> Rotors {
        Rotors {
            angles: self.angles.map(|angle| RotorAngle::from_raw(angle.rem_euclid(TURN) as u32)),
            speeds: self.speeds.map(|speed| Speed::from_raw(speed as i32)),
        }
    }

    fn update(&mut self, frequency: Speed, direction: Option<RotorAngle>) {
        let setpoint = Setpoint { frequency, direction };
        let rotors = self.rotors();
        self.torques = self.shaker.update(&self.model, &rotors, &setpoint, self.voltage_limited);
        for _ in 0..STRIDE {
            let phase = (self.angles[0] - self.angles[1]) / 2.0 / TURN * TAU;
            let Disturbance { harmonic, sum, difference, normal } = self.disturbance;
            let (sine, cosine) = (harmonic * phase).sin_cos();
            let now = (self.speeds[0] - self.speeds[1]) / 2.0;
            let scale =
                if normal > 0.0 { (now / f64::from(hertz(normal).raw())).powi(2) } else { 1.0 };
            let along = |[c, s]: [f64; 2]| scale * (c * cosine + s * sine);
            for (motor, sign) in [(0, 1.0), (1, -1.0)] {
                let driven = f64::from(self.torques.currents[motor].raw()) / self.gain(motor);
                let coordinate = along(sum) + sign * along(difference);
                self.speeds[motor] += (driven + coordinate) / 2.0 / 256.0;
                self.angles[motor] += self.speeds[motor];
            }
        }
    }

    /// Forgets what it took for driven back by a body, of which this rig has none.
    fn drives_nothing_back(&mut self) {
        self.shaker.difference_coordinate.amplitudes[1] = Complex::default();
    }

    /// Holds f and theta for so long; returns the RMS errors of sum and difference, degrees.
    fn hold(&mut self, frequency: f64, seconds: f64) -> [f64; 2] {
        let updates = (seconds * UPDATES_PER_S as f64) as usize;
        let mut squares = [0.0; 2];
        for _ in 0..updates {
            self.update(hertz(frequency), None);
            let errors = [self.shaker.sum_error, self.shaker.difference_error];
            for (square, error) in squares.iter_mut().zip(errors) {
                *square += (f64::from(error) / DEGREE).powi(2);
            }
        }
        squares.map(|square| (square / updates as f64).sqrt())
    }

    fn f(&self) -> f64 {
        f64::from(self.shaker.reference.frequency.raw()) / f64::from(hertz(1.0).raw())
    }
}

#[test]
fn the_inverse_response_is_that_of_double_precision_with_a_torque_that_acts_late() {
    for settings in crate::fast::ends::settings() {
        let model = Configuration::new(&settings, &HARDWARE).shaker;
        for lag in [0.0, 5.5, 14.9] {
            let model = ShakerModel { lag: (lag * f64::from(1 << LAG_BITS)) as i32, ..model };
            for (frequency, harmonic) in
                [(5.0, 1), (-20.0, 1), (35.0, 1), (12.0, 2), (35.0, 2), (-39.0, 2)]
            {
                let omega = TAU * frequency * f64::from(harmonic) / 1e4;
                let proportional = f64::from(model.proportional) / 2_f64.powi(40);
                let derivative = f64::from(model.derivative) / 2_f64.powi(32);
                let (sine, cosine) = (omega * lag).sin_cos();
                let want = [
                    proportional - omega * omega * cosine,
                    omega * derivative - omega * omega * sine,
                ];
                let have = Complex::inverse_response(&model, hertz(frequency), harmonic);
                for (have, want) in [have.real, have.imaginary].into_iter().zip(want) {
                    let off = (f64::from(have) / 2_f64.powi(38) - want).abs();
                    assert!(off < 1e-5 + 1e-3 * omega * omega, "{off} at {frequency} Hz, {lag}");
                }
            }
        }
    }
}

#[test]
fn a_torque_acts_later_by_half_a_stride_the_bridges_and_the_current_loop() {
    let ticks = |settings: &Settings, hardware: &Hardware| {
        let lag = Configuration::new(settings, hardware).shaker.lag;
        f64::from(lag) / f64::from(1 << LAG_BITS)
    };
    let settings =
        Settings { actuation_delay: 125.0, current_bandwidth: 500.0, ..Settings::DEFAULT };
    let of_loop = 1e4 / (TAU * 500.0);
    for current_sense in [HARDWARE.current_sense, None] {
        let lag = ticks(&settings, &Hardware { current_sense, ..HARDWARE });
        assert!((lag - (2.0 + 1.25 + of_loop)).abs() < 1e-6, "{lag}");
    }
    let slow = Settings { actuation_delay: 500.0, current_bandwidth: 50.0, ..settings };
    assert!((ticks(&slow, &HARDWARE) - 15.0).abs() < 1e-6);
}

#[test]
fn f_is_held_back_where_it_stays_away_from_what_is_asked_with_less_than_all_of_the_headroom() {
    let Rig { mut shaker, model, .. } = Rig::at_rest();
    let ramps = &model.ramps;
    for sign in [1, -1] {
        shaker.reference.frequency = Speed::from_raw(sign * hertz(30.0).raw());
        let asked = |beyond: i32| Speed::from_raw(shaker.reference.frequency.raw() + sign * beyond);
        let unreached = Speed::from_centihertz(10).raw();
        for (headroom, limited) in [(30_720, false), (30_719, true), (0, true)] {
            shaker.headroom = headroom;
            let there = shaker.reference.frequency;
            for rotors in [there, asked(unreached), -asked(unreached)] {
                assert_eq!(
                    shaker.held_back(ramps, asked(unreached + 1), rotors),
                    limited,
                    "{headroom}"
                );
                assert!(!shaker.held_back(ramps, asked(unreached), rotors), "{headroom}");
                assert!(!shaker.held_back(ramps, asked(-hertz(20.0).raw()), rotors), "{headroom}");
            }
            // Rotors that are slower than the reference, which is where it should be.
            assert_eq!(
                shaker.held_back(ramps, there, asked(-unreached - 1)),
                limited,
                "{headroom}"
            );
            assert!(!shaker.held_back(ramps, there, asked(-unreached)), "{headroom}");
            for (share, on_its_way) in
                [(ramps.frequency / 2, false), (ramps.frequency / 2 + 1, true)]
            {
                shaker.reference.frequency_slope = -sign * share;
                let held_back = shaker.held_back(ramps, asked(unreached + 1), there);
                assert_eq!(held_back, limited && !on_its_way, "{headroom}");
            }
            shaker.reference.frequency_slope = 0;
        }
    }
}

#[test]
fn the_feedback_pushes_the_way_that_double_precision_does_at_every_error() {
    for settings in crate::fast::ends::settings() {
        let model = Configuration::new(&settings, &HARDWARE).shaker;
        for error in [0, 1 << 27, LARGEST_ERROR, i32::MAX, i32::MIN, -LARGEST_ERROR] {
            for speed in [0, 1 << 22, (1 << 23) - 1, 1 << 23, 1 << 24, i32::MAX, i32::MIN] {
                let bounded = |value: i32, bound: i32| i128::from(value.clamp(-bound, bound));
                let want = (bounded(error, 1 << 28) * i128::from(model.proportional)
                    + bounded(speed, 1 << 23) * 256 * i128::from(model.derivative))
                    >> 32;
                let off = (i128::from(feedback(&model, error, speed)) - want).abs();
                assert!(off <= 2 + i128::from(model.derivative >> 22), "{off}: {error}, {speed}");
            }
        }
    }
}

#[test]
fn f_and_theta_are_half_difference_and_half_sum_of_the_rotors() {
    let rotors =
        Rotors { angles: [degrees(70.0), degrees(-30.0)], speeds: [hertz(31.0), hertz(-29.0)] };
    let theta = f64::from(rotors.direction().signed()) / DEGREE;
    assert!((theta - 20.0).abs() < 1e-5, "{theta}");
    assert!((rotors.frequency().raw() - hertz(30.0).raw()).abs() <= 1);
    let behind = Rotors { angles: [degrees(-70.0), degrees(-60.0)], ..rotors };
    let theta = f64::from(behind.direction().signed()) / DEGREE;
    assert!((theta + 65.0).abs() < 1e-5, "{theta}");
}

#[test]
fn a_stop_that_is_taken_back_turns_f_round_within_2_hz_however_slow_the_ramps_are() {
    for (ramp, sign) in [(1.0, 1.0), (5.0, -1.0), (200.0, 1.0)] {
        let slow = Ramps::of(&Settings { frequency_ramp: ramp, ..Settings::DEFAULT });
        let asked = hertz(sign * 20.0).raw();
        let mut reference = Reference::steady(hertz(sign * 20.0), degrees(0.0));
        let full = FULL_HEADROOM;
        for _ in 0..200 {
            reference.ramp_frequency(&slow.stopping(), full, full, 0);
        }
        let from = reference.frequency.magnitude();
        for _ in 0..100 {
            reference.ramp_frequency(&slow, full, full, asked);
            let lost = from - reference.frequency.magnitude();
            assert!(lost < hertz(2.0), "{ramp} Hz/s: {lost:?}");
        }
        assert!(reference.frequency_slope ^ asked >= 0, "{ramp} Hz/s");
    }
}

#[test]
fn f_ramps_as_steeply_as_is_set_and_no_steeper_and_the_rotors_follow_without_error() {
    for setpoint in [30.0, -30.0] {
        let mut rig = Rig::at_rest();
        let ramp = f64::from(rig.model.ramps.frequency);
        let (mut before, mut steepest, mut slope_before) = (0, 0, 0);
        let updates = (hertz(30.0).raw() / (rig.model.ramps.frequency * STEP)) as usize;
        for update in 0..updates + 400 {
            rig.update(hertz(setpoint), None);
            rig.drives_nothing_back();
            let f = rig.shaker.reference.frequency.raw();
            let slope = (f - before) / STEP;
            steepest = steepest.max(slope.abs());
            let build_up = (slope - slope_before).abs();
            assert!(
                build_up <= rig.model.ramps.frequency / SLOPE_UPDATES + 1
                    || f == hertz(setpoint).raw(),
                "{build_up}"
            );
            (before, slope_before) = (f, slope);
            assert!(f.abs() <= hertz(30.0).raw(), "overshoot in {update}");
            for error in [rig.shaker.sum_error, rig.shaker.difference_error] {
                assert!(f64::from(error).abs() < DEGREE, "{} degrees", f64::from(error) / DEGREE);
            }
            for motor in [0, 1] {
                let change = f64::from(rig.torques.speed_changes[motor].raw());
                assert!(change.abs() <= ramp * f64::from(STEP) + 1.0, "{change}");
            }
        }
        assert!((f64::from(steepest) - ramp).abs() <= 1.0, "{steepest} of {ramp}");
        assert_eq!(rig.shaker.reference.frequency, hertz(setpoint));
        assert!(!rig.shaker.limited() && !rig.shaker.slipping());
    }
}

#[test]
fn what_is_announced_of_the_rotors_speeds_is_what_the_references_do() {
    let mut rig = Rig::at_rest();
    let (mut announced, mut turned) = ([0.0; 2], 0.0);
    for _ in 0..UPDATES_PER_S {
        rig.update(hertz(25.0), Some(degrees(60.0)));
        rig.drives_nothing_back();
        for (sum, change) in announced.iter_mut().zip(rig.torques.speed_changes) {
            *sum += f64::from(change.raw());
        }
        turned = f64::from(rig.shaker.reference.sum_speed.raw());
    }
    let f = f64::from(rig.shaker.reference.frequency.raw());
    let expected = [f + turned / 2.0, turned / 2.0 - f];
    for (have, want) in announced.iter().zip(expected) {
        assert!((have - want).abs() < 2_000.0, "{have} for {want}");
    }
}

#[test]
fn theta_turns_the_short_way_as_fast_as_is_set_and_no_faster() {
    // Theta is 20 degrees at first; from it, 100 degrees are as far as 80 the other way.
    for (direction, sign) in [(80.0, 1.0), (-60.0, -1.0), (105.0, 1.0), (-75.0, 1.0)] {
        let mut rig = Rig::at(20.0);
        let ramp = rig.model.ramps.sum.raw();
        let mut fastest = 0;
        for _ in 0..UPDATES_PER_S {
            rig.update(hertz(20.0), Some(degrees(direction)));
            let speed = rig.shaker.reference.sum_speed.raw();
            fastest = fastest.max(speed.abs());
            assert!(f64::from(speed) * sign > -2_000.0, "{speed} towards {direction}");
            for error in [rig.shaker.sum_error, rig.shaker.difference_error] {
                assert!(f64::from(error).abs() < DEGREE, "{}", f64::from(error) / DEGREE);
            }
        }
        assert!(fastest <= ramp && fastest > ramp / 10 * 9, "{fastest} of {ramp}");
        let off = rig.rotors().direction().signed().wrapping_sub(degrees(direction).signed());
        let off = (f64::from(off) / DEGREE / 180.0).fract() * 180.0;
        assert!(off.abs().min(180.0 - off.abs()) < 0.3, "{off} degrees from {direction}");
        // Without a direction it stays where it is.
        let there = rig.shaker.reference.sum;
        rig.hold(20.0, 0.5);
        let moved = f64::from(rig.shaker.reference.sum.wrapping_sub(there) as i32) / DEGREE;
        assert!(moved.abs() < 0.5, "{moved} degrees");
    }
}

#[test]
fn the_errors_of_each_harmonic_decay_in_a_tenth_of_a_second() {
    for (frequency, harmonic) in
        [(12.0, 1.0), (30.0, 1.0), (-30.0, 1.0), (12.0, 2.0), (30.0, 2.0), (-20.0, 2.0)]
    {
        for coordinate in [0, 1] {
            let mut rig = Rig::at(frequency);
            let size = f64::from(rig.model.largest_acceleration) / 60.0;
            rig.disturbance = Disturbance { harmonic, ..Disturbance::default() };
            let place = if coordinate == 0 {
                &mut rig.disturbance.sum
            } else {
                &mut rig.disturbance.difference
            };
            *place = [0.8 * size, -0.6 * size];
            let period = 1.0 / frequency.abs();
            for _ in 0..UPDATES_PER_S {
                rig.hold(frequency, 1.0 / UPDATES_PER_S as f64);
                rig.shaker.sum_coordinate.amplitudes = [Complex::default(); 2];
                rig.shaker.difference_coordinate.amplitudes = [Complex::default(); 2];
            }
            let mut frozen = rig.clone();
            let first = frozen.hold(frequency, period)[coordinate];
            assert!(first > 0.02, "{first} degrees: nothing to adapt to");
            rig.hold(frequency, 0.1 - period / 2.0);
            let later = rig.hold(frequency, period)[coordinate];
            let share = later / first;
            assert!(
                (0.2..0.7).contains(&share),
                "{share} at {frequency} Hz, {harmonic}, {coordinate}"
            );
            rig.hold(frequency, 0.6);
            let [sum, difference] = rig.hold(frequency, period);
            let last = [sum, difference][coordinate] / first;
            assert!(last < 0.03, "{last} at {frequency} Hz, {harmonic}, {coordinate}");
        }
    }
}

#[test]
fn what_was_learnt_of_the_driving_back_stays_right_while_f_changes() {
    let calm = Rig::at(20.0);
    let size = f64::from(calm.model.largest_acceleration) / 60.0;
    let mut learnt = calm.clone();
    let difference = [0.0, size];
    learnt.disturbance =
        Disturbance { harmonic: 2.0, difference, normal: 20.0, ..Disturbance::default() };
    let mut rigs = [calm, learnt.clone(), learnt];
    let mut worst = [0.0_f64; 2];
    for update in 0..UPDATES_PER_S * 17 / 10 {
        let changes = update >= UPDATES_PER_S * 3 / 2;
        if !changes {
            rigs[2].shaker.difference_coordinate.amplitudes = [Complex::default(); 2];
        }
        let [calm, learnt, ignorant] = rigs.each_mut().map(|rig| {
            rig.update(hertz(if changes { 32.0 } else { 20.0 }), None);
            f64::from(rig.shaker.difference_error) / DEGREE
        });
        if changes {
            let more = [(learnt - calm).abs(), (ignorant - calm).abs()];
            worst = [worst[0].max(more[0]), worst[1].max(more[1])];
        }
    }
    assert!(worst[0] < worst[1] / 2.0, "{} degrees, {} without", worst[0], worst[1]);
}

/// Returns the mean square of both currents, A^2, on a base that drives back: over the first turn, and over one a second later.
fn currents_on_a_base(frequency: f64, size: f64) -> [f64; 2] {
    let mut rig = Rig::at(frequency);
    let difference = [0.6 * size, -0.8 * size];
    rig.disturbance = Disturbance { harmonic: 2.0, difference, normal: 35.0, ..rig.disturbance };
    let turn = (UPDATES_PER_S as f64 / frequency.abs()) as usize;
    let square = |rig: &mut Rig| {
        let mut sum = 0.0;
        for _ in 0..turn {
            rig.update(hertz(frequency), None);
            sum += rig
                .torques
                .currents
                .map(|it| (f64::from(it.raw()) / 65_536.0).powi(2))
                .iter()
                .sum::<f64>();
        }
        sum / turn as f64
    };
    let first = square(&mut rig);
    rig.hold(frequency, 1.0);
    [first, square(&mut rig)]
}

#[test]
fn what_the_body_drives_back_turns_the_rotors_and_takes_no_current() {
    for frequency in [20.0, 35.0, -35.0] {
        // Half an ampere in each motor at 35 Hz.
        let size = 0.5 * 65_536.0 / Rig::at(frequency).gain(0);
        let [first, last] = currents_on_a_base(frequency, size);
        assert!(first > 0.01, "{first} A^2 at {frequency} Hz: nothing to yield to");
        assert!(last < first / 20.0, "{last} of {first} A^2 at {frequency} Hz");
    }
}

#[test]
fn the_share_by_which_the_speeds_come_and_go_is_that_of_the_rotors() {
    for (frequency, angle) in [(15.0, 0.3_f64), (35.0, 2.5), (-35.0, 4.0)] {
        let mut rig = Rig::at(frequency);
        let size = f64::from(rig.model.largest_acceleration) / 20.0;
        let difference = [angle.cos() * size, angle.sin() * size];
        rig.disturbance =
            Disturbance { harmonic: 2.0, difference, normal: 35.0, ..rig.disturbance };
        rig.hold(frequency, 1.0);
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for _ in 0..UPDATES_PER_S / 10 {
            rig.update(hertz(frequency), None);
            let speed = rig.speeds[0].abs();
            (least, most) = (least.min(speed), most.max(speed));
        }
        let expected = (most - least) / (most + least);
        let share = f64::from(rig.shaker.ripple_share()) / TURN;
        assert!(expected > 0.0005, "{expected}");
        assert!((0.97..1.1).contains(&(share / expected)), "{share} of {expected}");
    }
}

#[test]
fn a_constant_torque_leaves_no_error() {
    for sign in [1.0, -1.0] {
        let mut rig = Rig::at(20.0);
        let size = sign * f64::from(rig.model.largest_acceleration) / 40.0;
        rig.disturbance.sum = [size, 0.0];
        rig.disturbance.difference = [-size, 0.0];
        rig.hold(20.0, 0.05);
        let early = rig.hold(20.0, 0.02);
        rig.hold(20.0, 1.5);
        let late = rig.hold(20.0, 0.1);
        for (early, late) in early.iter().zip(late) {
            assert!(*early > 0.5 && late < 0.05, "{early} degrees, then {late}");
        }
    }
}

#[test]
fn below_5_hz_no_harmonic_adapts() {
    for (frequency, adapts) in [(4.9, false), (-4.9, false), (5.1, true), (-5.1, true)] {
        let mut rig = Rig::at(frequency);
        rig.disturbance.harmonic = 1.0;
        rig.disturbance.sum = [f64::from(rig.model.largest_acceleration) / 60.0, 0.0];
        rig.hold(frequency, 0.2);
        let is_adapted = rig.shaker.sum_coordinate.amplitudes != [Complex::default(); 2];
        assert_eq!(is_adapted, adapts, "{frequency} Hz");
    }
}

#[test]
fn at_a_limit_only_the_ripple_is_learnt_and_f_rises_no_further() {
    let mut rig = Rig::at(20.0);
    rig.disturbance.sum = [f64::from(rig.model.largest_acceleration) / 60.0; 2];
    rig.hold(20.0, 0.2);
    rig.voltage_limited = true;
    let coordinates = |rig: &Rig| [rig.shaker.sum_coordinate, rig.shaker.difference_coordinate];
    let size = |it: Complex| f64::from(it.real).hypot(f64::from(it.imaginary));
    let learnt = coordinates(&rig);
    let updates = 50;
    rig.hold(20.0, updates as f64 / UPDATES_PER_S as f64);
    assert!(rig.shaker.limited());
    for (now, then) in coordinates(&rig).iter().zip(&learnt) {
        assert_eq!(now.integral, then.integral);
        // Within 25 ms to less than half, in the first 20.
        let left = 63.0_f64.powi(updates) / 64.0_f64.powi(updates);
        let [now, then] = [now, then].map(|it| size(it.amplitudes[0]));
        assert!((now - left * then).abs() < 70.0, "{now} of {then}");
    }
    let [now, then] = [coordinates(&rig)[0], learnt[0]].map(|it| size(it.amplitudes[1]));
    assert!(now < then / 2.0, "{now} of {then}");
    // The ripple, whatever makes it: the rotors may follow it.
    rig.disturbance =
        Disturbance { harmonic: 2.0, difference: rig.disturbance.sum, ..Disturbance::default() };
    let before = size(coordinates(&rig)[1].amplitudes[1]);
    rig.hold(20.0, 0.05);
    let after = size(coordinates(&rig)[1].amplitudes[1]);
    assert!(after > 10.0 * before, "{after} from {before}");
    for sign in [1.0, -1.0] {
        let full = Rig::at(sign * 20.0);
        let [mut free, mut held] = [full.clone(), full];
        held.voltage_limited = true;
        for rig in [&mut free, &mut held] {
            rig.hold(sign * 30.0, 0.03);
        }
        let (free, held) = (sign * free.f() - 20.0, sign * held.f() - 20.0);
        assert!(held > 0.0 && held < free / 4.0, "{held} Hz where {free} Hz were possible");
    }
    // It falls by a quarter in each update.
    let mut limited = Rig::at(20.0);
    limited.shaker.limited = true;
    limited.update(hertz(20.0), None);
    assert_eq!(limited.shaker.headroom, FULL_HEADROOM / 4 * 3);
    // Slowing down needs no headroom, and it comes back within 50 ms.
    let mut down = Rig::at(20.0);
    down.voltage_limited = true;
    down.hold(20.0, 0.02);
    let mut free = Rig::at(20.0);
    for rig in [&mut free, &mut down] {
        rig.hold(10.0, 0.03);
    }
    assert!((free.f() - down.f()).abs() < 0.01, "{} and {} Hz", free.f(), down.f());
    down.voltage_limited = false;
    down.hold(down.f(), 0.06);
    assert!(down.shaker.headroom > FULL_HEADROOM / 10 * 9, "{}", down.shaker.headroom);
}

#[test]
fn f_gives_way_to_theta_alone_and_only_at_the_limit_of_voltage() {
    // The sum counts twice theta: 3 degrees are YIELDING_SUM_ERROR.
    for (error, gives_way) in [(2.9, false), (3.1, true), (-3.1, true)] {
        let mut rig = Rig::at(30.0);
        rig.shaker.sum_error = (error * DEGREE) as i32;
        rig.voltage_limited = true;
        rig.update(hertz(30.0), None);
        let lost = f64::from(hertz(30.0).raw() - rig.shaker.reference.frequency.raw());
        let share = lost / f64::from(hertz(30.0).raw());
        let expected = if gives_way { 1.0 / 1024.0 } else { 0.0 };
        assert!((share - expected).abs() < 2e-4, "{share} at {error} degrees");
        let mut rig = Rig::at(30.0);
        rig.shaker.sum_error = (error * DEGREE) as i32;
        rig.update(hertz(30.0), None);
        assert_eq!(rig.shaker.reference.frequency, hertz(30.0));
    }
}

#[test]
fn the_phase_reference_waits_for_rotors_that_lag_by_an_eighth_of_a_turn() {
    for (lag, slips) in [(44.0, false), (46.0, true), (-46.0, true)] {
        let mut rig = Rig::at(20.0);
        // The difference counts twice the phase.
        rig.angles[0] -= lag * DEGREE;
        let speed = f64::from(hertz(4.0).raw());
        rig.speeds = [speed, -speed];
        rig.update(hertz(20.0), None);
        assert_eq!(rig.shaker.slipping(), slips, "{lag} degrees");
        let error = f64::from(rig.shaker.difference_error) / DEGREE;
        assert!(error.abs() <= 45.0 + 1e-6, "{error}");
        let gave_way = 20.0 - rig.f();
        let expected = if slips { (20.0 - 4.0) / 16.0 } else { 0.0 };
        assert!((gave_way - expected).abs() < 0.01, "{gave_way} Hz");
        if slips {
            // It stands just an eighth of a turn ahead of where they were.
            let before = lag.signum() * 45.0;
            assert!((error - before).abs() < 1e-3, "{error}");
            let behind = rig.shaker.reference.phase.wrapping_mul(2) as i32;
            let rotors =
                Rotors { angles: [degrees(70.0 - lag), degrees(-30.0)], speeds: [Speed::ZERO; 2] };
            let ahead = behind.wrapping_sub(rotors.difference() as i32);
            assert!((f64::from(ahead) / DEGREE - before).abs() < 0.01, "{ahead}");
        }
    }
}

#[test]
fn theta_gets_three_quarters_of_what_the_motors_can_and_f_the_rest() {
    // Behind by these angles, and as fast away from there.
    let asked = |sum: f64, difference: f64, away: f64| {
        let mut rig = Rig::at_rest();
        for (motor, sign) in [(0, 1.0), (1, -1.0)] {
            rig.angles[motor] -= (sum + sign * difference) / 2.0 * DEGREE;
            let signum = |it: f64| if it == 0.0 { 0.0 } else { it.signum() };
            let speed = f64::from(hertz(away).raw()) / 2.0;
            rig.speeds[motor] = -(signum(sum) + sign * signum(difference)) * speed;
        }
        rig.update(Speed::ZERO, None);
        let [top, bottom] =
            [0, 1].map(|motor| f64::from(rig.torques.currents[motor].raw()) / rig.gain(motor));
        let bound = f64::from(rig.model.largest_acceleration);
        let share = |acceleration: f64| (acceleration / 2.0 / bound * 100.0).round();
        (share(top + bottom), share(top - bottom), rig.shaker.limited())
    };
    assert_eq!(asked(22.0, 0.0, 10.0), (75.0, 0.0, true));
    assert_eq!(asked(-22.0, 0.0, 10.0), (-75.0, 0.0, true));
    assert_eq!(asked(0.0, 22.0, 10.0), (0.0, 100.0, true));
    assert_eq!(asked(22.0, -22.0, 10.0), (75.0, -25.0, true));
    // Two limits at once are a limit, too.
    for sign in [1.0, -1.0] {
        let mut both = Rig::at_rest();
        both.angles = [both.angles[0] - 45.0 * DEGREE, both.angles[1] - sign * 45.0 * DEGREE];
        let speed = -f64::from(hertz(15.0).raw());
        both.speeds = [speed, sign * speed];
        both.voltage_limited = true;
        both.update(Speed::ZERO, None);
        assert!(both.shaker.limited());
    }
    let (sum, difference, limited) = asked(2.0, -1.0, 0.0);
    assert!(!limited && sum > 0.0 && difference < 0.0, "{sum} {difference}");
}

#[test]
fn missed_ticks_move_the_references_on_as_they_would_have() {
    let mut rig = Rig::at(30.0);
    rig.shaker.reference.sum_speed = hertz(0.3);
    let (phase, sum) = (rig.shaker.reference.phase, rig.shaker.reference.sum);
    rig.shaker.skip(7);
    assert_eq!(rig.shaker.reference.phase.wrapping_sub(phase), hertz(30.0).raw() as u32 * 7);
    assert_eq!(rig.shaker.reference.sum.wrapping_sub(sum), hertz(0.3).raw() as u32 * 7);
}

#[test]
fn references_stand_below_a_hundredth_of_a_hertz_of_both() {
    let standing = |frequency: f64, sum: f64| {
        let mut shaker = Rig::at_rest().shaker;
        (shaker.reference.frequency, shaker.reference.sum_speed) = (hertz(frequency), hertz(sum));
        shaker.standing()
    };
    assert!(standing(0.0099, 0.0099) && standing(-0.0099, -0.0099));
    assert!(!standing(0.0101, 0.0) && !standing(0.0, 0.0101) && !standing(-0.0101, 0.0));
    let just = Speed::from_raw(STANDING);
    let shaker = Rig::at_rest().shaker;
    let with = |reference: Reference| Shaker { reference, ..shaker };
    assert!(!with(Reference { frequency: just, ..shaker.reference }).standing());
    assert!(!with(Reference { sum_speed: just, ..shaker.reference }).standing());
    assert_eq!(Rig::at(30.0).shaker.frequency(), hertz(30.0));
    let mut rig = Rig::at_rest();
    rig.shaker.sum_error = 17;
    assert_eq!(rig.shaker.sum_error(), 17);
}

#[test]
fn the_integral_grows_by_its_gain_times_the_error_in_each_tick_up_to_its_bound() {
    for sign in [1, -1] {
        let mut rig = Rig::at_rest();
        rig.angles[0] -= f64::from(sign) * DEGREE;
        rig.update(Speed::ZERO, None);
        let step = multiply_high(rig.shaker.sum_error, rig.model.integral) * 4;
        assert!(step * sign > 0, "{step}");
        let integrals = |shaker: &Shaker| {
            [shaker.sum_coordinate.integral, shaker.difference_coordinate.integral]
        };
        assert_eq!(integrals(&rig.shaker), [step; 2]);
        let bound = sign * LARGEST_INTEGRAL;
        let mut coordinate = Coordinate { integral: bound - sign, ..Coordinate::default() };
        for _ in 0..2 {
            coordinate.integrate(&rig.model, sign * LARGEST_ERROR);
            assert_eq!(coordinate.integral, bound);
        }
    }
}
