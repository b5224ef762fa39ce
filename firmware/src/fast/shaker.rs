//! From (f, theta) to the currents of two motors.
//!
//! # Coordinates
//!
//! With the rotors' clockwise angles `top` and `bottom` (paper, section II-E), the shaker is
//! controlled in sum and difference, each of which wraps with one turn:
//!
//! ```text
//! sum        = top + bottom = 2 theta      the line of force repeats every half turn of theta
//! difference = top - bottom = 2 phase      d(phase)/dt = f
//! ```
//!
//! So theta turns the short way through +-90 degrees with no special case, and f reverses through
//! zero with theta held.
//!
//! # Law
//!
//! Both coordinates follow smooth references with the same law, in units of acceleration, every
//! fourth tick:
//!
//! ```text
//! u = reference'' + kp e + kd e' + ki integral(e) + periodic
//! i_top = (J / K_t) (u_sum + u_difference) / 2,   i_bottom = (J / K_t) (u_sum - u_difference) / 2
//! ```
//!
//! The *periodic* part makes up for what the shaking drives back into the rotors. A base of mass M
//! moves by `a = -(2 m l w^2 / M) cos(phase)`, which turns the rotors with a torque
//! `(m l w)^2 / M sin(2 phase)`; gravity on a tilted base, and a body that rocks, add a part at
//! `phase`. Base and legs vary, so the amplitudes of both parts adapt in both coordinates. The complex amplitude
//! `A` of each harmonic `h` grows by
//!
//! ```text
//! A += mu D(j h w) e exp(-j h phase)
//! ```
//!
//! where `D` is the inverse of the closed loop's response from torque to error: at every speed the
//! error of that harmonic decays at the rate `mu`. A torque acts later than it is asked for, by `t`:
//!
//! ```text
//! D(j w) = kp - w^2 exp(j w t) + j w kd
//! ```
//!
//! At twice 35 Hz 1 ms is 25 degrees. Left out, it would bring the phase error of the slowest robots' adaptation near 90 degrees,
//! where it no longer converges and theta swings.
//!
//! All of them are made up for but the second harmonic of the difference, an acceleration `c (w/w0)^2` with `w0` = 2 pi 35 Hz. It
//! takes half an ampere at 35 Hz to make up for, and neither f, the mean of a turn, nor theta, the sum, depends on it. So the
//! reference of the difference follows what the rotors do by themselves, whatever f is: the error, its speed and the acceleration
//! of
//!
//! ```text
//! n'' = c (w/w0)^2 exp(j 2 phase),    n' = j 2 w n,    n = -c / (4 w0^2) exp(j 2 phase)
//! ```

#[cfg(test)]
mod tests;

use crate::fast::reference::{FULL_HEADROOM, Ramps, Reference, STEP};
use crate::units::{
    Current, RotorAngle, Speed, cosine_sine, magnitude, multiply_high, shifted, within,
};

/// Largest error of a coordinate that is acted on: 1/16 turn.
const LARGEST_ERROR: i32 = 1 << 28;
/// Largest error of a coordinate's speed that is acted on: just below 19.5 Hz, of which 2^8 fit.
const LARGEST_SPEED_ERROR: i32 = (1 << 23) - 1;
/// Largest error that the periodic part adapts to: 1/128 turn.
const LARGEST_ADAPTED_ERROR: i32 = 1 << 25;
/// The phase reference waits for rotors that lag by more than this: 1/8 turn of the difference.
const LARGEST_LAG: i32 = 1 << 29;
/// With the voltage at its limit and twice theta off by more than this, f gives way: 3 degrees.
const YIELDING_SUM_ERROR: i32 = (3 * (1 << 32_u64) / 360_u64) as i32;
/// It gives way by 2^-10 of itself in each update: 85 Hz/s from 35 Hz.
const GIVING_WAY_SHIFT: u32 = 10;
/// Below this f the periodic part does not adapt: 5 Hz.
const SLOWEST_ADAPTATION: Speed = Speed::from_centihertz(500);
/// One over the f to which the second harmonic of the difference is normalised: 2^40 / 35 Hz.
const INVERSE_NORMAL_FREQUENCY: i32 =
    ((1_u64 << 40) / Speed::from_centihertz(3_500).raw() as u64) as i32;
/// Fixed point of an integral: 90 mN m fit of rotors of 94 g cm^2, more than motors of this size have.
pub(crate) const INTEGRAL_BITS: u32 = 46;
/// What takes an integral to 2^-40.
const INTEGRAL_SHIFT: u32 = INTEGRAL_BITS - 40;
/// Largest integral, turn per tick^2 in 2^-[`INTEGRAL_BITS`].
const LARGEST_INTEGRAL: i32 = i32::MAX >> 1;
/// Largest acceleration of a coordinate, 2^-40 turn per tick^2: 12 times what two amperes give.
pub(crate) const LARGEST_ACCELERATION: i32 = 1 << 27;
/// One in this many updates works out what changes slowly.
const SCHEDULE_UPDATES: u8 = 4;
/// The one of these that works out what is of the second harmonic.
const SECOND_UPDATE: u8 = SCHEDULE_UPDATES / 2;
/// Rate of adaptation, in every eighth tick: errors of a harmonic decay in 0.1 s.
const ADAPTATION_RATE: i32 = 32;
/// Fixed point of [`ShakerModel::lag`], of which 15 ticks fit: twice 39 Hz goes up as far.
pub(crate) const LAG_BITS: u32 = 27;
/// Amplitudes fade by 2^-6 of themselves in each update at a limit.
const FADING_SHIFT: u32 = 6;
/// With less headroom than this, the motors are at their limits at least once a turn: 15/16, which come back within 40 ms.
const HELD_BACK: i32 = FULL_HEADROOM - FULL_HEADROOM / 16;
/// f is not reached when it is off by more than this: 0.1 Hz.
const UNREACHED: i32 = Speed::from_centihertz(10).raw();

/// Gains and limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ShakerModel {
    /// `kp` per tick^2, 2^-40.
    pub(crate) proportional: i32,
    /// `kd` per tick, 2^-32.
    pub(crate) derivative: i32,
    /// `ki` per tick^3, 2^-[`INTEGRAL_BITS`].
    pub(crate) integral: i32,
    /// `J / (2 K_t)` of top and bottom: 2^-16 A per (2^-40 turn per tick^2) times 2^`acceleration_shift`, in 2^-32.
    pub(crate) current_per_acceleration: [i32; 2],
    /// From an update to the middle of the time in which its torque acts, ticks in 2^-[`LAG_BITS`].
    pub(crate) lag: i32,
    /// As far as the largest acceleration goes up in 31 bits, so that heavy rotors of weak motors fit too.
    pub(crate) acceleration_shift: u32,
    /// Largest sum of magnitudes of `u`, 2^-40 turn per tick^2.
    pub(crate) largest_acceleration: i32,
    /// Largest current.
    pub(crate) current_limit: Current,
    /// How steeply f and theta change.
    pub(crate) ramps: Ramps,
}

/// One of the two coordinates: its integral, in 2^-[`INTEGRAL_BITS`], and adapted amplitudes, in 2^-48 turn per tick^2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Coordinate {
    integral: i32,
    /// First and second harmonic.
    amplitudes: [Complex; 2],
}

impl Coordinate {
    #[inline(always)]
    fn integrate(&mut self, model: &ShakerModel, error: i32) {
        let step = multiply_high(within(error, LARGEST_ERROR), model.integral) * STEP;
        self.integral = within(self.integral + step, LARGEST_INTEGRAL);
    }
}

/// A complex number: the amplitude of a harmonic, 2^-48 turn per tick^2; a harmonic `exp(j h phase)`,
/// 2^-31; or the inverse response `D(j h w)` per tick^2, 2^-38, worked out every [`SCHEDULE_UPDATES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Complex {
    real: i32,
    imaginary: i32,
}

impl Complex {
    /// Returns the harmonic of an angle, 2^-32 turn.
    #[inline(always)]
    fn harmonic(angle: u32) -> Self {
        let (real, imaginary) = cosine_sine(angle);
        Self { real, imaginary }
    }

    /// Returns the harmonic of twice the angle.
    #[inline(always)]
    const fn doubled(self) -> Self {
        let Self { real, imaginary } = self;
        Self {
            real: multiply_high(real, real).wrapping_sub(multiply_high(imaginary, imaginary)) << 1,
            imaginary: multiply_high(real, imaginary) << 2,
        }
    }

    /// Returns the inverse response at a harmonic of f.
    fn inverse_response(model: &ShakerModel, frequency: Speed, harmonic: i32) -> Self {
        let omega = angular(frequency, harmonic);
        let square = shifted(multiply_high(omega, omega), 7);
        let turned = shifted(frequency.raw() * harmonic, 32 - LAG_BITS);
        let (cosine, sine) = cosine_sine(multiply_high(turned, model.lag) as u32);
        let part = |share| shifted(multiply_high(square, share), 2);
        Self {
            real: (model.proportional >> 2).wrapping_sub(part(cosine)),
            imaginary: shifted(multiply_high(omega, model.derivative), 7).wrapping_sub(part(sine)),
        }
    }

    /// Returns an inverse response times `exp(-j h phase)`, 2^-37.
    #[inline(always)]
    const fn gradient(self, harmonic: Self) -> Self {
        let Self { real: cosine, imaginary: sine } = harmonic;
        Self {
            real: multiply_high(self.real, cosine)
                .wrapping_add(multiply_high(self.imaginary, sine)),
            imaginary: multiply_high(self.imaginary, cosine)
                .wrapping_sub(multiply_high(self.real, sine)),
        }
    }

    /// Returns the present value of an amplitude, 2^-40 turn per tick^2.
    #[inline(always)]
    const fn value(self, harmonic: Self) -> i32 {
        multiply_high(self.real, harmonic.real)
            .wrapping_sub(multiply_high(self.imaginary, harmonic.imaginary))
            >> 7
    }

    /// Leaves 63/64 of it.
    const fn fade(&mut self) {
        self.real -= self.real >> FADING_SHIFT;
        self.imaginary -= self.imaginary >> FADING_SHIFT;
    }

    /// Adapts an amplitude to an error.
    #[inline(always)]
    const fn adapt(&mut self, error: i32, gradient: Self, rate: i32) {
        let real = multiply_high(error, gradient.real).wrapping_mul(rate);
        let imaginary = multiply_high(error, gradient.imaginary).wrapping_mul(rate);
        self.real = self.real.saturating_add(real);
        self.imaginary = self.imaginary.saturating_add(imaginary);
    }
}

/// Where the rotors are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rotors {
    /// Top and bottom.
    pub(crate) angles: [RotorAngle; 2],
    /// Top and bottom.
    pub(crate) speeds: [Speed; 2],
}

impl Rotors {
    /// Returns twice theta, 2^-32 turn, wrapping.
    const fn sum(&self) -> u32 {
        self.angles[0].raw().wrapping_add(self.angles[1].raw())
    }

    /// Returns twice the phase, 2^-32 turn, wrapping.
    const fn difference(&self) -> u32 {
        self.angles[0].raw().wrapping_sub(self.angles[1].raw())
    }

    /// Returns theta, within a quarter turn either side of forward.
    pub(crate) const fn direction(&self) -> RotorAngle {
        RotorAngle::from_raw((self.sum() as i32 / 2) as u32)
    }

    /// Returns f.
    pub(crate) const fn frequency(&self) -> Speed {
        Speed::from_raw(self.speeds[0].raw().wrapping_sub(self.speeds[1].raw()) / 2)
    }
}

/// The ripple of the difference that the body drives back: of its error, 2^-32 turn, of that error's speed, and its
/// acceleration, 2^-40.
#[derive(Debug, Clone, Copy)]
struct Ripple {
    lag: i32,
    speed: i32,
    acceleration: i32,
}

/// What the shaker is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Setpoint {
    /// f.
    pub(crate) frequency: Speed,
    /// theta; `None` keeps what it is, and stops by ramps that are steep enough for it.
    pub(crate) direction: Option<RotorAngle>,
}

/// What one update gives the motors: torques, as clockwise currents for the next [`STRIDE`] ticks, and the changes of speed
/// that they are to make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Torques {
    /// Top, bottom.
    pub(crate) currents: [Current; 2],
    /// By how much the references change the rotors' speeds, for those who estimate them.
    pub(crate) speed_changes: [Speed; 2],
}

/// References, feedback and adapted feed-forward. Phase, sum and their errors are in 2^-32 turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shaker {
    reference: Reference,
    sum_coordinate: Coordinate,
    difference_coordinate: Coordinate,
    inverse_responses: [Complex; 2],
    /// `(f / 35 Hz)^2` in 2^-26, and the rate of adaptation over it; zero when f is too low.
    square: i32,
    inverse_square: i32,
    /// Twice the speed of the phase, rad per tick in 2^-31.
    twice_angular: i32,
    headroom: i32,
    /// The same of ramps downwards.
    headroom_down: i32,
    countdown: u8,
    limited: bool,
    voltage_limited: bool,
    slipping: bool,
    sum_error: i32,
    difference_error: i32,
}

impl Shaker {
    /// Starts at rest with the rotors where they are, and with nothing adapted.
    pub(crate) fn at_rest(rotors: &Rotors) -> Self {
        Self {
            reference: Reference::at_rest(rotors.difference(), rotors.sum()),
            sum_coordinate: Coordinate::default(),
            difference_coordinate: Coordinate::default(),
            inverse_responses: [Complex::default(); 2],
            square: 0,
            inverse_square: 0,
            twice_angular: 0,
            headroom: FULL_HEADROOM,
            headroom_down: FULL_HEADROOM,
            countdown: 0,
            limited: false,
            voltage_limited: false,
            slipping: false,
            sum_error: 0,
            difference_error: 0,
        }
    }

    /// Returns the reference of f in this tick.
    pub(crate) const fn frequency(&self) -> Speed {
        self.reference.frequency
    }

    /// Returns whether the references stand still.
    pub(crate) const fn standing(&self) -> bool {
        self.reference.is_standing()
    }

    /// Returns whether f is being lowered towards zero: the rotors give energy back.
    pub(crate) const fn slowing(&self) -> bool {
        self.reference.is_slowing()
    }

    /// Returns whether it is lowered so steeply that no ceiling asks for it.
    pub(crate) const fn gives_back(&self) -> bool {
        self.reference.gives_back()
    }

    /// Returns by how much twice theta is off, 2^-32 turn.
    pub(crate) const fn sum_error(&self) -> i32 {
        self.sum_error
    }

    /// Returns whether the rotors lag so far behind that the phase reference waits for them.
    pub(crate) const fn slipping(&self) -> bool {
        self.slipping
    }

    /// Returns whether current or voltage were at their limits in the last tick.
    pub(crate) const fn limited(&self) -> bool {
        self.limited
    }

    /// Returns whether f gives way to theta.
    pub(crate) const fn gives_way(&self) -> bool {
        self.voltage_limited && magnitude(self.sum_error) > YIELDING_SUM_ERROR
    }

    /// Returns whether the rotors stay behind for want of current or voltage: f by more than 3 degrees of twice the phase, theta by
    /// more than a quarter of that.
    pub(crate) const fn lags(&self) -> bool {
        let ahead = self.difference_error;
        let behind = if self.reference.frequency.raw() < 0 { ahead.wrapping_neg() } else { ahead };
        self.limited
            && (behind > YIELDING_SUM_ERROR || magnitude(self.sum_error) > YIELDING_SUM_ERROR / 2)
    }

    /// Returns whether f changes by less than an eighth of its steepest ramp.
    pub(crate) const fn is_steady(&self, model: &ShakerModel) -> bool {
        magnitude(self.reference.frequency_slope) < model.ramps.frequency >> 3
    }

    /// Returns by which share the rotors' speeds come and go with what the body drives back, 2^-32; at most 7 % too much.
    pub(crate) fn ripple_share(&self) -> i32 {
        let Complex { real, imaginary } = self.difference_coordinate.amplitudes[1];
        let [real, imaginary] = [real, imaginary].map(|it| magnitude(it) >> 8);
        let amplitude = real.max(imaginary) + ((3 * real.min(imaginary)) >> 3);
        // w angle times twice its speed, over twice that speed: 2 pi for turns.
        (-displacement(amplitude) * 25) >> 2
    }

    /// Returns the clockwise currents of top and bottom motor that keep the rotors turning as they do: what has been integrated.
    pub(crate) fn load(&self, model: &ShakerModel) -> [Current; 2] {
        let [sum, difference] = [self.sum_coordinate, self.difference_coordinate]
            .map(|it| it.integral >> INTEGRAL_SHIFT);
        let [top_gain, bottom_gain] = model.current_per_acceleration;
        [(sum + difference, top_gain), (sum - difference, bottom_gain)].map(
            |(acceleration, gain)| {
                let acceleration = within(acceleration, model.largest_acceleration);
                let scaled = shifted(acceleration, model.acceleration_shift);
                Current::from_raw(multiply_high(scaled, gain)).within(model.current_limit)
            },
        )
    }

    /// Returns whether f, of the reference or that of the rotors over a turn, is held below what is asked because the motors are at
    /// their limits: while it ramps at half of its rate or more, it is on its way.
    pub(crate) const fn held_back(&self, ramps: &Ramps, setpoint: Speed, rotors: Speed) -> bool {
        if self.ramps(ramps) {
            return false;
        }
        let [reference, have] =
            [magnitude(self.reference.frequency.raw()), magnitude(rotors.raw())];
        let (reached, asked) =
            (if have < reference { have } else { reference }, magnitude(setpoint.raw()));
        self.headroom < HELD_BACK && asked - reached > UNREACHED
    }

    /// Returns whether f ramps, at half of its rate or more: it is on its way.
    pub(crate) const fn ramps(&self, ramps: &Ramps) -> bool {
        magnitude(self.reference.frequency_slope) > ramps.frequency / 2
    }

    /// Moves the references on by ticks that the loop missed.
    pub(crate) const fn skip(&mut self, ticks: u32) {
        self.reference.skip(ticks);
    }

    /// Does one update, due every [`STRIDE`] ticks. `voltage_limited`: either motor got less voltage
    /// than its current takes in a tick since the last. Never panics.
    #[inline]
    pub(crate) fn update(
        &mut self,
        model: &ShakerModel,
        rotors: &Rotors,
        setpoint: &Setpoint,
        voltage_limited: bool,
    ) -> Torques {
        self.follow_headroom();
        self.voltage_limited = voltage_limited;
        if self.gives_way() {
            self.give_way();
        }
        let stops = setpoint.direction.is_none();
        let ramps = &if stops { model.ramps.stopping() } else { model.ramps };
        let frequency = setpoint.frequency.raw();
        let acceleration_difference =
            self.reference.ramp_frequency(ramps, self.headroom, self.headroom_down, frequency);
        let acceleration_sum = self.reference.ramp_direction(ramps, setpoint.direction);
        match self.countdown {
            0 => self.schedule(model),
            SECOND_UPDATE => self.schedule_second(model),
            _ => {}
        }
        self.countdown = self.countdown.wrapping_sub(1) & (SCHEDULE_UPDATES - 1);

        self.sum_error = self.reference.sum.wrapping_sub(rotors.sum()) as i32;
        self.difference_error = self.wait_for(rotors);
        let (top, bottom) = (rotors.speeds[0].raw(), rotors.speeds[1].raw());
        let sum_speed_error = self.reference.sum_speed.raw().wrapping_sub(top).wrapping_sub(bottom);
        let difference_speed_error =
            self.reference.frequency.raw().wrapping_mul(2).wrapping_sub(top).wrapping_add(bottom);

        let first = Complex::harmonic(self.reference.phase);
        let second = first.doubled();
        let (periodic_sum, periodic_difference) = self.periodic(first, second);
        let ripple = self.ripple(second);
        self.difference_error = self.difference_error.wrapping_sub(ripple.lag);
        let difference_speed_error = difference_speed_error.wrapping_sub(ripple.speed);
        let u_sum = acceleration_sum
            + feedback(model, self.sum_error, sum_speed_error)
            + (self.sum_coordinate.integral >> INTEGRAL_SHIFT)
            + periodic_sum;
        let u_difference = acceleration_difference
            + feedback(model, self.difference_error, difference_speed_error)
            + (self.difference_coordinate.integral >> INTEGRAL_SHIFT)
            + periodic_difference;

        // theta first: what it takes is not there for f.
        let bound = model.largest_acceleration;
        let sum = within(u_sum, bound - (bound >> 2));
        let difference = within(u_difference, bound - magnitude(sum));
        self.limited = voltage_limited | (sum != u_sum) | (difference != u_difference);
        self.adapt(model, first, second);
        let [top_gain, bottom_gain] = model.current_per_acceleration;
        // Half of STRIDE ticks of acceleration: from 2^-40 to 2^-32.
        let [sum_change, difference_change] =
            [acceleration_sum, acceleration_difference - ripple.acceleration]
                .map(|acceleration| (acceleration * (STEP / 2)) >> 8);
        let current = |acceleration: i32, gain| {
            let scaled = shifted(acceleration, model.acceleration_shift);
            Current::from_raw(multiply_high(scaled, gain)).within(model.current_limit)
        };
        Torques {
            currents: [current(sum + difference, top_gain), current(sum - difference, bottom_gain)],
            speed_changes: [
                Speed::from_raw(sum_change + difference_change),
                Speed::from_raw(sum_change - difference_change),
            ],
        }
    }

    /// Ramps upwards give way when the motors are at their limits, and all ramps when the rotors slip: the headroom falls within a
    /// millisecond and comes back within 50.
    #[inline(always)]
    fn follow_headroom(&mut self) {
        for (headroom, gives_way) in [
            (&mut self.headroom, self.limited || self.slipping),
            (&mut self.headroom_down, self.slipping),
        ] {
            *headroom +=
                if gives_way { -(*headroom >> 2) } else { (FULL_HEADROOM - *headroom) >> 5 };
        }
    }

    /// Lowers f: a battery too flat for it costs theta first, since the motors differ; f gives way until
    /// theta is right again.
    #[cold]
    fn give_way(&mut self) {
        self.reference.frequency = self.reference.frequency
            - Speed::from_raw(self.reference.frequency.raw() >> GIVING_WAY_SHIFT);
    }

    /// Returns the error of the difference; beyond [`LARGEST_LAG`] the reference gives way, and f
    /// with it.
    #[inline(always)]
    fn wait_for(&mut self, rotors: &Rotors) -> i32 {
        let error = self.reference.phase.wrapping_mul(2).wrapping_sub(rotors.difference()) as i32;
        let held = within(error, LARGEST_LAG);
        self.slipping = held != error;
        if self.slipping {
            self.reference.phase =
                self.reference.phase.wrapping_sub((error.wrapping_sub(held) / 2) as u32);
            let excess = self.reference.frequency.raw() - rotors.frequency().raw();
            self.reference.frequency = self.reference.frequency - Speed::from_raw(excess >> 4);
        }
        held
    }

    /// Returns the periodic parts of sum and difference, 2^-40.
    #[inline(always)]
    fn periodic(&self, first: Complex, second: Complex) -> (i32, i32) {
        let [sum_first, sum_second] = self.sum_coordinate.amplitudes;
        let difference_first = self.difference_coordinate.amplitudes[0];
        (sum_first.value(first) + sum_second.value(second), difference_first.value(first))
    }

    /// Returns how the rotors ripple where what the body drives back, `a (f/f0)^2` at twice the phase, is not made up for:
    /// `y'' = -a (f/f0)^2 exp(j 2 phase)`, an error of `-a / (4 w0^2)` at every f.
    #[inline(always)]
    fn ripple(&self, second: Complex) -> Ripple {
        let amplitude = self.difference_coordinate.amplitudes[1];
        let quarter = Complex { real: second.imaginary.wrapping_neg(), imaginary: second.real };
        let value = amplitude.value(second);
        Ripple {
            lag: displacement(value),
            speed: multiply_high(displacement(amplitude.value(quarter)), self.twice_angular) << 1,
            acceleration: multiply_high(shifted(value, 6), self.square),
        }
    }

    /// Adapts the integrals in every update, the two harmonics in turn. At a limit only the ripple, which takes no current, adapts:
    /// what is learnt from part of a turn is wrong, so that the other harmonics fade, within 25 ms of limits, and the integrals stay.
    #[inline(always)]
    fn adapt(&mut self, model: &ShakerModel, first: Complex, second: Complex) {
        let (sum_error, difference_error) = (self.sum_error, self.difference_error);
        let sum = &mut self.sum_coordinate;
        let difference = &mut self.difference_coordinate;
        if self.limited {
            core::hint::cold_path();
            let [sum_first, sum_second] = &mut sum.amplitudes;
            for amplitude in [sum_first, sum_second, &mut difference.amplitudes[0]] {
                amplitude.fade();
            }
        } else {
            sum.integrate(model, sum_error);
            difference.integrate(model, difference_error);
        }
        if self.inverse_square == 0 {
            return;
        }
        let sum_error = if self.limited { 0 } else { within(sum_error, LARGEST_ADAPTED_ERROR) };
        let difference_error = within(difference_error, LARGEST_ADAPTED_ERROR);
        let [first_response, second_response] = self.inverse_responses;
        if self.countdown & 1 == 0 {
            if self.limited {
                return;
            }
            let gradient = first_response.gradient(first);
            sum.amplitudes[0].adapt(sum_error, gradient, ADAPTATION_RATE);
            difference.amplitudes[0].adapt(difference_error, gradient, ADAPTATION_RATE);
        } else {
            let gradient = second_response.gradient(second);
            sum.amplitudes[1].adapt(sum_error, gradient, ADAPTATION_RATE);
            difference.amplitudes[1].adapt(difference_error, gradient, self.inverse_square);
        }
    }

    /// Works out the inverse response of the second harmonic, in another update than the rest.
    fn schedule_second(&mut self, model: &ShakerModel) {
        self.inverse_responses[1] = Complex::inverse_response(model, self.reference.frequency, 2);
    }

    /// Works out what depends on f alone.
    fn schedule(&mut self, model: &ShakerModel) {
        self.inverse_responses[0] = Complex::inverse_response(model, self.reference.frequency, 1);
        self.twice_angular = angular(self.reference.frequency, 2);
        // f / 35 Hz in 2^-14.
        let ratio =
            multiply_high(shifted(self.reference.frequency.raw(), 6), INVERSE_NORMAL_FREQUENCY);
        let square = ratio.wrapping_mul(ratio);
        self.square = square >> 2;
        self.inverse_square =
            if magnitude(self.reference.frequency.raw()) < SLOWEST_ADAPTATION.raw() {
                0
            } else {
                (ADAPTATION_RATE << 24).wrapping_div(square >> 4 | 1).min(16 * ADAPTATION_RATE)
            };
    }
}

/// Returns `2 pi h f`, rad per tick in 2^-31.
const fn angular(frequency: Speed, harmonic: i32) -> i32 {
    /// pi in 2^-29.
    const PI: i32 = 1_686_629_713;
    // f pi h, since f is in 2^-32 turn.
    multiply_high(frequency.raw(), PI).wrapping_mul(harmonic) << 3
}

/// Returns the error of twice the phase, 2^-32 turn, from what is driven back at [`INVERSE_NORMAL_FREQUENCY`], 2^-40.
const fn displacement(driven_back: i32) -> i32 {
    /// 2^-8 / (4 w0^2), w0 = 2 pi 35 / 10000, in 2^-26.
    const PER_ACCELERATION: i32 = 135_513_936;
    -multiply_high(shifted(driven_back, 6), PER_ACCELERATION)
}

/// Returns `kp e + kd e'`, 2^-40.
#[inline(always)]
const fn feedback(model: &ShakerModel, error: i32, speed_error: i32) -> i32 {
    let error = within(error, LARGEST_ERROR);
    let speed_error = within(speed_error, LARGEST_SPEED_ERROR);
    multiply_high(error, model.proportional)
        + multiply_high(shifted(speed_error, 8), model.derivative)
}
