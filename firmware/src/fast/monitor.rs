//! What is wrong: each fault that currents, voltages and motion show, debounced.
//!
//! A lost encoder and a late loop are looked for by [`control`](crate::fast::control), in every tick; over-current is counted
//! here, in every tick, too; all else builds up slowly and is looked at in one tick of [`DIAGNOSTIC_TICKS`].

use flix_protocol::message::{Fault, Faults};

use crate::fast::configuration::{Configuration, DIAGNOSTIC_TICKS};
use crate::fast::foc::current::CurrentLoop;
use crate::fast::shaker::Shaker;
use crate::fast::tracker::Tracker;
use crate::units::{
    Current, RotorAngle, Speed, TURN_PER_DEGREE, Voltage, magnitude, product, within,
};

/// Consecutive samples above the limit that are an over-current: one alone may be a spike.
const OVER_CURRENT_TICKS: u32 = 2;
/// Ticks for which the bus must be too low: 20 ms, longer than a sag of one turn.
const UNDER_VOLTAGE_TICKS: u32 = 200;
/// Ticks for which the bus must be too high: 3.2 ms.
const OVER_VOLTAGE_TICKS: u32 = 32;
/// Ticks for which a reading of the bus must contradict what is known: 4.8 ms.
const BUS_SENSE_TICKS: u32 = 48;
/// Ticks at the current limit without movement: 0.2 s.
const STALL_TICKS: u32 = 2_000;
/// Ticks without movement while f goes on: 20 ms.
const BLOCKED_TICKS: u32 = 200;
/// f goes on from here: 5 Hz.
const GOING_ON: Speed = Speed::from_centihertz(500);
/// Slower than this is no movement: 1 Hz.
const STALLED: Speed = Speed::from_centihertz(100);
/// Twice theta may be off by this much: 15 degrees of theta.
const LARGEST_SUM_ERROR: i32 = (30.0 * TURN_PER_DEGREE) as i32;
/// Ticks for which theta may be further off, or the phase slip: 0.1 s.
const UNLOCKED_TICKS: u32 = 1_000;
/// Ticks for which f may stay away from what is asked for with the motors at their limits: 1 s.
const DROOP_TICKS: u32 = 10_000;
/// f may be off by this much: 10 Hz. A walking body that swings against its rotors at 35 Hz takes up
/// to 8 Hz for a second (seen in simulation); theta is held meanwhile, and telemetry shows f.
const LARGEST_DROOP: Speed = Speed::from_centihertz(1_000);
/// With twice theta off by more than this, 6 degrees, a ceiling of the voltage is no reason for a low f: with it, theta is held.
const CEILING_SUM_ERROR: i32 = (6 * (1 << 32_u64) / 360_u64) as i32;
/// Ticks for which f must be held back to be called limited, too long for a step to settle in half a second: 0.3 s.
const HELD_BACK_TICKS: u32 = 3_000;
/// Ticks after which an f is expected to be reached, 1 s, and those for which one that is held back then is lost: 50 ms.
const REACHED_TICKS: u32 = 10_000;
const LOST_TICKS: u32 = 500;
/// Ticks for which a motor may differ from its model: 10 ms.
const RESIDUAL_TICKS: u32 = 100;
/// Ticks for which a phase must carry next to nothing while the others do: 0.1 s.
const OPEN_PHASE_TICKS: u32 = 1_000;
/// A phase is open when its mean magnitude is below this share of the largest, 2^-3.
const OPEN_PHASE_SHIFT: u32 = 3;
/// Mean magnitudes below this are not judged: 0.032 A, of a current of 0.05 A.
const SIGNIFICANT_CURRENT: Current = Current::from_raw(2_086);
/// They are those of 2^6 looks, two in a diagnosis: 51 ms, several electrical turns.
const MEAN_SHIFT: u32 = 6;
/// Heat that currents which come and go may make in both motors where the rotors are to rest: 0.4 W, 2^-16 W. Holding a
/// mass against gravity takes a current that stays; a robot that is carried about, less than 0.1 W.
const LARGEST_SHIVER: i64 = 26_214;
/// Ticks for which they may make more: 0.5 s, longer than what a push leaves in the averages.
const SHIVER_TICKS: u32 = 5_000;
/// The current that stays is averaged over 2^4 diagnoses: what changes more slowly than at 6 Hz stays.
const STAY_SHIFT: u32 = 4;
/// Squares are averaged over 2^6 diagnoses, 0.1 s, to judge them; over 2^4, 26 ms, to know whether it goes on.
const SHIVER_SHIFTS: [u32; 2] = [6, 4];
/// Larger currents are taken for this: 8 A.
const LARGEST_SHIVER_CURRENT: i32 = 8 << 16;
/// In voltage mode, a change of the sum of both speeds that currents should have made and the rotors did not: 6 Hz. With a battery
/// too weak for f it stays below 6 Hz wherever theta is off by as much as here; with a strong one below 3 Hz.
const LARGEST_UNANSWERED: i32 = Speed::from_centihertz(600).raw();
/// What is missing of one change counts up to this: 156 Hz.
const LARGEST_MISSING: i32 = 1 << 26;
/// It is forgotten within 2^4 diagnoses: 26 ms.
const UNANSWERED_SHIFT: u32 = 4;
/// Flux linkages that were entered are wrong by a twentieth: by so much of what would flow through shorted windings the model is, too.
const WRONG_FLUX: i32 = 20;
/// It counts where twice theta is off by more than this: 2.2 degrees of theta.
const UNANSWERED_SUM_ERROR: i32 = (4.4 * TURN_PER_DEGREE) as i32;
/// Ticks for which it must be there: 6.4 ms.
const UNANSWERED_TICKS: u32 = 64;

/// Counts observations of a fault; falls at the same rate while it is not observed.
#[derive(Debug, Clone, Copy, Default)]
struct Debounce(u32);

impl Debounce {
    /// Counts an observation and returns whether `limit` is reached.
    #[inline(always)]
    const fn count(&mut self, wrong: bool, limit: u32) -> bool {
        self.weigh(wrong, 1, limit)
    }

    /// Counts an observation so many times.
    #[inline(always)]
    const fn weigh(&mut self, wrong: bool, times: u32, limit: u32) -> bool {
        let sum = self.0 + times;
        self.0 = match wrong {
            false => self.0.saturating_sub(times),
            true if sum < limit => sum,
            true => limit,
        };
        self.0 >= limit
    }

    /// Counts one diagnosis, for a limit in ticks.
    const fn diagnose(&mut self, wrong: bool, ticks: u32) -> bool {
        self.count(wrong, ticks / DIAGNOSTIC_TICKS)
    }
}

/// How far the currents of a motor come and go.
#[derive(Debug, Clone, Copy, Default)]
struct Shiver {
    /// Means of d and q current, 2^-16 A in 2^-4.
    means: [i32; 2],
    /// Mean squares about them by [`SHIVER_SHIFTS`], 2^-16 A^2, each in 2^-shift.
    squares: [i32; 2],
}

impl Shiver {
    /// Takes d and q current of a diagnosis.
    fn add(&mut self, currents: [Current; 2]) {
        let mut square = 0;
        for (mean, current) in self.means.iter_mut().zip(currents) {
            *mean += current.raw() - (*mean >> STAY_SHIFT);
            let off = within(current.raw() - (*mean >> STAY_SHIFT), LARGEST_SHIVER_CURRENT);
            square += ((i64::from(off) * i64::from(off)) >> 16) as i32;
        }
        for (mean, shift) in self.squares.iter_mut().zip(SHIVER_SHIFTS) {
            *mean += square - (*mean >> shift);
        }
    }

    /// Returns the heat that they make in phases of this resistance, 2^-24 ohm, by each mean: 2^-16 W. A square of d and q
    /// currents is two thirds of the sum of the phases' squares.
    fn heat(self, resistance: i32) -> [i64; 2] {
        let heat = |index: usize| {
            let square = self.squares[index] >> SHIVER_SHIFTS[index];
            (i64::from(square) * i64::from(resistance) * 3) >> 25
        };
        [heat(0), heat(1)]
    }
}

/// What currents that nobody measures should have done to the sum of both speeds, and did not: a bridge that shuts itself down
/// drives nothing. Friction slows both rotors alike, and so does a body that swings against them: neither shows in the sum.
#[derive(Debug, Clone, Copy, Default)]
struct Unanswered {
    /// 2^-32 turn per tick.
    speed: i32,
    /// The sum of both speeds at the last diagnosis.
    last: i32,
}

impl Unanswered {
    /// Takes what the currents since the last diagnosis should have added to the sum of both speeds, and that sum.
    const fn add(&mut self, expected: i32, sum: i32) {
        let came = sum.wrapping_sub(self.last);
        self.last = sum;
        let missing = within(expected.saturating_sub(came), LARGEST_MISSING);
        self.speed += missing - (self.speed >> UNANSWERED_SHIFT);
    }
}

/// What the monitor looks at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observation<'a> {
    /// Its limits.
    pub(crate) configuration: &'a Configuration,
    /// Battery side of the bridges, averaged.
    pub(crate) bus_voltage: Voltage,
    /// The last reading of it alone.
    pub(crate) bus_reading: Voltage,
    /// Whether what is read of it contradicts what is known.
    pub(crate) bus_contradicts: bool,
    /// Top, bottom.
    pub(crate) trackers: &'a [Tracker; 2],
    /// Currents of phases A and B, top and bottom.
    pub(crate) currents: &'a [[Current; 2]; 2],
    /// Top, bottom.
    pub(crate) loops: &'a [CurrentLoop; 2],
    /// Whether the rotors are controlled.
    pub(crate) shaking: bool,
    /// The shaker that controls them.
    pub(crate) shaker: &'a Shaker,
    /// f that is asked for.
    pub(crate) setpoint: Speed,
    /// The same below the ceiling of the voltage.
    pub(crate) reachable: Speed,
}

/// What was observed but is not sure yet.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Monitor {
    over_current: Debounce,
    under_voltage: Debounce,
    over_voltage: Debounce,
    bus_sense: Debounce,
    stall: [Debounce; 2],
    blocked: [Debounce; 2],
    unlocked: Debounce,
    droop: Debounce,
    held_back: Debounce,
    frequency_limited: bool,
    /// What is asked for, and for how many diagnoses it has been.
    asked: (Speed, RotorAngle),
    asked_for: u32,
    residual: Debounce,
    open_phase: [Debounce; 2],
    shiver: Debounce,
    unanswered: Unanswered,
    unanswered_for_long: Debounce,
    /// Top, bottom.
    shivers: [Shiver; 2],
    /// Mean magnitudes of the phase currents, in 2^-[`MEAN_SHIFT`].
    magnitudes: [[i32; 3]; 2],
}

impl Monitor {
    /// Starts anew, but for over-current, as the rotors begin to be controlled.
    pub(crate) fn restart(&mut self) {
        *self = Self { over_current: self.over_current, ..Self::default() };
    }

    /// Takes a diagnosis of whether f is held back while this f and this theta are asked for; returns whether it has just become
    /// limited: f comes and goes within a turn, so that it is in most of them. It ends where it has not been for as long.
    pub(crate) fn becomes_limited(&mut self, held_back: bool, asked: (Speed, RotorAngle)) -> bool {
        let is_new = asked != core::mem::replace(&mut self.asked, asked);
        self.asked_for = if is_new { 0 } else { self.asked_for.saturating_add(1) };
        let is_reached = self.asked_for >= REACHED_TICKS / DIAGNOSTIC_TICKS;
        let is_lost = is_reached && !self.frequency_limited;
        let times = if is_lost { HELD_BACK_TICKS / LOST_TICKS } else { 1 };
        let limited = self.held_back.weigh(held_back, times, HELD_BACK_TICKS / DIAGNOSTIC_TICKS);
        let becomes = limited && !self.frequency_limited;
        self.frequency_limited = limited || (self.frequency_limited && self.held_back.0 != 0);
        becomes
    }

    /// Returns whether f is limited.
    pub(crate) const fn frequency_limited(&self) -> bool {
        self.frequency_limited
    }

    /// Counts a tick in which a phase carried too much, or not; returns whether that is a fault.
    #[inline(always)]
    pub(crate) const fn over_current(&mut self, excess: bool) -> bool {
        self.over_current.count(excess, OVER_CURRENT_TICKS)
    }

    /// Takes the currents of phases A and B, top and bottom, for their mean magnitudes: in the diagnosis, and once more between two.
    pub(crate) fn take_magnitudes(&mut self, currents: &[[Current; 2]; 2]) {
        for (means, [a, b]) in self.magnitudes.iter_mut().zip(*currents) {
            for (mean, current) in means.iter_mut().zip([a, b, a + b]) {
                *mean += current.magnitude().raw() - (*mean >> MEAN_SHIFT);
            }
        }
    }

    /// Adds the faults whose cause is there now, but for those that every tick looks for.
    pub(crate) fn faults(&mut self, faults: Faults, observation: &Observation<'_>) -> Faults {
        let Observation { configuration, bus_voltage, trackers, .. } = *observation;
        let fast = |tracker: &Tracker| tracker.speed().magnitude() > configuration.over_speed;
        let low = bus_voltage < configuration.under_voltage;
        // At once: a capacitor that takes what rotors give fills within milliseconds.
        let high = observation.bus_reading > configuration.over_voltage;
        let contradicts = observation.bus_contradicts;
        let faults = faults
            .with_if(Fault::OverSpeed, trackers.iter().any(fast))
            .with_if(Fault::UnderVoltage, self.under_voltage.diagnose(low, UNDER_VOLTAGE_TICKS))
            .with_if(Fault::OverVoltage, self.over_voltage.diagnose(high, OVER_VOLTAGE_TICKS))
            .with_if(Fault::BusSense, self.bus_sense.diagnose(contradicts, BUS_SENSE_TICKS));
        if observation.shaking { self.shaking_faults(faults, observation) } else { faults }
    }

    /// Adds the faults that show only while the rotors are controlled.
    fn shaking_faults(&mut self, faults: Faults, observation: &Observation<'_>) -> Faults {
        let Observation { configuration, trackers, loops, shaker, .. } = *observation;
        let pressed = shaker.limited();
        let going_on = shaker.frequency().magnitude() > GOING_ON;
        let [shivers, goes_on] = self.shivers(observation);
        let held = is_held(observation);
        let [mut stalled, mut stuck] = [false; 2];
        let counts = self.stall.iter_mut().zip(&mut self.blocked);
        for (tracker, (stall, blocked)) in trackers.iter().zip(counts) {
            let still = tracker.speed().magnitude() < STALLED;
            stuck |= still && pressed;
            // One that shivers is pressed, and moves too fast to be seen to; one that was stopped suddenly stands by the time
            // that this counts.
            stalled |= (stall.diagnose(still && pressed, STALL_TICKS) && !goes_on)
                | blocked.diagnose(still && going_on, BLOCKED_TICKS);
        }
        let unlocked = shaker.slipping() || magnitude(shaker.sum_error()) > LARGEST_SUM_ERROR;
        let is_off = magnitude(shaker.sum_error()) > CEILING_SUM_ERROR;
        let setpoint = if is_off { observation.setpoint } else { observation.reachable };
        let droop = (setpoint - shaker.frequency()).magnitude();
        let ramps = shaker.ramps(&configuration.shaker.ramps);
        // What is stuck is about to be a stall.
        let lost = self.unlocked.diagnose(unlocked && !stuck, UNLOCKED_TICKS)
            | self.droop.diagnose(pressed && droop > LARGEST_DROOP && !ramps, DROOP_TICKS)
            | self.unanswered(observation, going_on && !held);
        let off = loops.iter().enumerate().any(|(motor, current_loop)| {
            let speed = configuration.electrical_speed(motor, trackers[motor % 2].speed());
            let residual = current_loop.residual(&configuration.motors[motor % 2], speed);
            residual.d.magnitude().max(residual.q.magnitude()) > configuration.largest_residual
        });
        faults
            .with_if(Fault::Shiver, self.shiver.diagnose(shivers, SHIVER_TICKS))
            .with_if(Fault::Stall, stalled)
            .with_if(Fault::PhaseLockLost, lost)
            .with_if(Fault::Alignment, self.open_phase(observation.currents, going_on))
            .with_if(Fault::CurrentSense, self.residual.diagnose(off && !held, RESIDUAL_TICKS))
    }

    /// Returns whether, in voltage mode, the rotors have not answered to their currents for long. It counts where they `turn`: one
    /// that is held does not answer either, and that is a stall.
    fn unanswered(&mut self, observation: &Observation<'_>, turn: bool) -> bool {
        let Observation { configuration, trackers, loops, shaker, .. } = *observation;
        if configuration.sensed {
            return false;
        }
        let (mut expected, mut doubt) = (0_i32, 0_i32);
        for (motor, tracker) in trackers.iter().enumerate() {
            let adds = |current: Current| {
                product(current.raw(), configuration.speed_per_current[motor % 2], 16)
            };
            let q = configuration.clockwise(motor, loops[motor % 2].current().q);
            expected = expected.saturating_add(adds(q));
            let speed = configuration.electrical_speed(motor, tracker.speed());
            let shorted = configuration.motors[motor % 2].shorted(speed);
            doubt = doubt.saturating_add(magnitude(adds(shorted)) / WRONG_FLUX);
        }
        let sum = trackers[0].speed().raw().wrapping_add(trackers[1].speed().raw());
        self.unanswered.add(expected, sum);
        let largest =
            LARGEST_UNANSWERED.saturating_add(doubt.saturating_mul(1 << UNANSWERED_SHIFT));
        let is_large = magnitude(self.unanswered.speed) > largest
            && magnitude(shaker.sum_error()) > UNANSWERED_SUM_ERROR;
        self.unanswered_for_long.diagnose(is_large && turn, UNANSWERED_TICKS)
    }

    /// Returns whether currents come and go in motors whose rotors are to rest: lately, and now.
    fn shivers(&mut self, observation: &Observation<'_>) -> [bool; 2] {
        let Observation { configuration, loops, shaker, .. } = *observation;
        if !shaker.standing() {
            self.shivers = [Shiver::default(); 2];
            return [false; 2];
        }
        let mut heat = [0; 2];
        for ((shiver, current_loop), model) in
            self.shivers.iter_mut().zip(loops).zip(&configuration.motors)
        {
            let current = current_loop.current();
            shiver.add([current.d, current.q]);
            for (sum, heat) in heat.iter_mut().zip(shiver.heat(model.resistance)) {
                *sum += heat;
            }
        }
        heat.map(|heat| heat > LARGEST_SHIVER)
    }

    /// Returns whether a phase carries next to nothing while its motor turns and the others carry.
    fn open_phase(&mut self, currents: &[[Current; 2]; 2], going_on: bool) -> bool {
        self.take_magnitudes(currents);
        let mut found = false;
        for ([a, b, c], debounce) in self.magnitudes.into_iter().zip(&mut self.open_phase) {
            let (least, most) = (a.min(b).min(c), a.max(b).max(c));
            let open = going_on
                && most > SIGNIFICANT_CURRENT.raw() << MEAN_SHIFT
                && least < most >> OPEN_PHASE_SHIFT;
            found |= debounce.diagnose(open, OPEN_PHASE_TICKS);
        }
        found
    }
}

/// Returns whether f goes on and a rotor is slower than half of that, or of the other: something holds it. What the motors do
/// meanwhile is no word against their current sense.
fn is_held(observation: &Observation<'_>) -> bool {
    let [top, bottom] = observation.trackers.each_ref().map(|it| it.speed().magnitude());
    let fastest = top.max(bottom).max(observation.shaker.frequency().magnitude());
    fastest > GOING_ON && top.min(bottom).raw() < fastest.raw() >> 1
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::board::DENGFOC_V3_01;
    use crate::fast::control::{DIAGNOSED, MEASURED};
    use crate::fast::foc::current::Input;
    use crate::fast::foc::modulation::Bus;
    use crate::fast::foc::transform::Rotor;
    use crate::fast::reference::STRIDE;
    use crate::fast::shaker::{Rotors, Setpoint};
    use crate::settings::Settings;
    use crate::units::{ElectricalAngle, ElectricalSpeed, RotorAngle, TICK_RATE_HZ};

    /// More diagnoses than any fault takes.
    const LONG: u32 = 1_000;
    const ONE: Speed = Speed::from_raw(1);
    /// Fast enough for every check: 6 Hz.
    const MOVING: Speed = Speed::from_centihertz(600);

    /// All that the monitor looks at; nothing is wrong.
    #[derive(Clone)]
    struct Scene {
        configuration: Configuration,
        bus_voltage: Voltage,
        bus_contradicts: bool,
        speeds: [Speed; 2],
        currents: [[Current; 2]; 2],
        loops: [CurrentLoop; 2],
        shaking: bool,
        shaker: Shaker,
        setpoint: Speed,
        /// Whether f is the ceiling of the voltage.
        is_ceiling: bool,
    }

    impl Scene {
        fn new(frequency: Speed) -> Self {
            Self::with(frequency, 0, false)
        }

        /// With f settled, twice theta off by `sum_error`, and the motors at their limits or not.
        fn with(frequency: Speed, sum_error: i32, limited: bool) -> Self {
            Self::after(1_000, frequency, sum_error, limited)
        }

        /// The same, so many updates after f was asked for at rest.
        fn after(updates: u32, frequency: Speed, sum_error: i32, limited: bool) -> Self {
            let hardware = DENGFOC_V3_01.with_battery_divider().hardware;
            let configuration = Configuration::new(&Settings::DEFAULT, &hardware);
            let rotors = |phase: u32, ahead: i32, speed: Speed| Rotors {
                angles: [phase.wrapping_add(ahead as u32), phase.wrapping_neg()]
                    .map(RotorAngle::from_raw),
                speeds: [speed, -speed],
            };
            let mut shaker = Shaker::at_rest(&rotors(0, 0, Speed::ZERO));
            let setpoint = Setpoint { frequency, direction: None };
            let mut phase = 0_u32;
            for update in (0..updates).rev() {
                let step = (shaker.frequency().raw() as u32).wrapping_mul(STRIDE);
                phase = phase.wrapping_add(step);
                let is_last = update == 0;
                let ahead = if is_last { -sum_error } else { 0 };
                let rotors = rotors(phase, ahead, shaker.frequency());
                shaker.update(&configuration.shaker, &rotors, &setpoint, limited && is_last);
            }
            assert_eq!(shaker.sum_error(), sum_error);
            assert!(shaker.limited() == limited || sum_error != 0);
            Self {
                bus_voltage: configuration.bus_nominal,
                bus_contradicts: false,
                speeds: [MOVING, -MOVING],
                currents: [[Current::ZERO; 2]; 2],
                loops: [CurrentLoop::default(); 2],
                shaking: true,
                setpoint: shaker.frequency(),
                is_ceiling: false,
                shaker,
                configuration,
            }
        }

        fn look(&self, monitor: &mut Monitor) -> Faults {
            let trackers = self.speeds.map(|speed| {
                let mut tracker = Tracker::new();
                tracker.feed_forward(speed);
                tracker
            });
            let observation = Observation {
                configuration: &self.configuration,
                bus_voltage: self.bus_voltage,
                bus_reading: self.bus_voltage,
                bus_contradicts: self.bus_contradicts,
                trackers: &trackers,
                currents: &self.currents,
                loops: &self.loops,
                shaking: self.shaking,
                shaker: &self.shaker,
                setpoint: self.setpoint,
                reachable: if self.is_ceiling { self.shaker.frequency() } else { self.setpoint },
            };
            monitor.faults(Faults::NONE, &observation)
        }

        /// Returns the first diagnosis that finds something, and what.
        fn found_by(&self, monitor: &mut Monitor) -> Option<(u32, Fault)> {
            (1..=LONG).find_map(|count| {
                let fault = self.look(monitor).iter().next();
                fault.map(|fault| (count, fault))
            })
        }
    }

    /// Holds that a scene is fine as it is, and a fault from the given number of ticks on with the
    /// least more.
    #[track_caller]
    fn assert_limit(fine: &Scene, wrong: &Scene, fault: Fault, ticks: u32) {
        assert_eq!(fine.found_by(&mut Monitor::default()), None, "{fault}");
        let diagnoses = (ticks / DIAGNOSTIC_TICKS).max(1);
        assert_eq!(wrong.found_by(&mut Monitor::default()), Some((diagnoses, fault)));
    }

    /// The same scene with a change.
    fn but(scene: &Scene, change: impl FnOnce(&mut Scene)) -> Scene {
        let mut scene = scene.clone();
        change(&mut scene);
        scene
    }

    #[test]
    fn over_speed_is_found_above_its_limit_either_way_on_either_rotor() {
        let scene = Scene { shaking: false, ..Scene::new(Speed::ZERO) };
        let limit = scene.configuration.over_speed;
        for motor in [0, 1] {
            for (fine, wrong) in [(limit, limit + ONE), (-limit, -limit - ONE)] {
                let fine = but(&scene, |scene| scene.speeds[motor] = fine);
                let wrong = but(&scene, |scene| scene.speeds[motor] = wrong);
                assert_limit(&fine, &wrong, Fault::OverSpeed, 0);
            }
        }
    }

    #[test]
    fn the_bus_may_reach_its_limits_and_go_beyond_for_a_while() {
        let scene = Scene { shaking: false, ..Scene::new(Speed::ZERO) };
        let at = |voltage| but(&scene, |scene| scene.bus_voltage = voltage);
        let (least, most) = (scene.configuration.under_voltage, scene.configuration.over_voltage);
        let step = Voltage::from_raw(1);
        assert_limit(&at(least), &at(least - step), Fault::UnderVoltage, UNDER_VOLTAGE_TICKS);
        assert_limit(&at(most), &at(most + step), Fault::OverVoltage, OVER_VOLTAGE_TICKS);
        let misread = but(&scene, |scene| scene.bus_contradicts = true);
        assert_limit(&scene, &misread, Fault::BusSense, BUS_SENSE_TICKS);
    }

    /// When a monitor names something that currents of this size make of a robot at rest, which come and go in the q axis of a
    /// motor, or stay; in diagnoses.
    fn seen_at_rest(motor: usize, amperes: f64, comes_and_goes: bool) -> Option<(u32, Fault)> {
        let mut scene = Scene::with(Speed::ZERO, 0, true);
        let mut monitor = Monitor::default();
        (1..=LONG).find_map(|count| {
            let sign = if comes_and_goes && count % 8 < 4 { -1.0 } else { 1.0 };
            let q = Current::from_amperes(sign * amperes);
            scene.loops[motor].note(Rotor { d: Current::ZERO, q }, Rotor::default());
            scene.look(&mut monitor).iter().next().map(|fault| (count, fault))
        })
    }

    #[test]
    fn currents_that_come_and_go_at_rest_are_a_shiver_from_four_tenths_of_a_watt_on() {
        // 2.5 ohm: 3.75 W at 1 A.
        for motor in [0, 1] {
            for amperes in [0.35, 0.5, 1.8] {
                let (count, fault) = seen_at_rest(motor, amperes, true).unwrap();
                assert_eq!(fault, Fault::Shiver, "{amperes} A");
                assert!(count * DIAGNOSTIC_TICKS < 8_000, "{amperes} A: {count}");
            }
            assert_eq!(seen_at_rest(motor, 0.3, true), None);
            assert_eq!(seen_at_rest(motor, 0.3, false), None);
        }
    }

    #[test]
    fn a_current_that_stays_is_no_shiver() {
        for motor in [0, 1] {
            for amperes in [0.5, 1.0, 2.0] {
                assert_eq!(seen_at_rest(motor, amperes, false), None, "{amperes} A");
            }
        }
    }

    #[test]
    fn a_rotor_that_stands_at_the_current_limit_or_while_f_goes_on_is_stalled() {
        let pressed = Scene::with(Speed::ZERO, 0, true);
        let going_on = Scene::new(GOING_ON + ONE);
        let still =
            |scene: &Scene, motor: usize, speed| but(scene, |scene| scene.speeds[motor] = speed);
        for motor in [0, 1] {
            for (scene, ticks) in [(&pressed, STALL_TICKS), (&going_on, BLOCKED_TICKS)] {
                let fine = still(scene, motor, STALLED);
                let wrong = still(scene, motor, STALLED - ONE);
                assert_limit(&fine, &wrong, Fault::Stall, ticks);
            }
            let fine = still(&Scene::new(GOING_ON), motor, Speed::ZERO);
            let wrong = still(&going_on, motor, Speed::ZERO);
            assert_limit(&fine, &wrong, Fault::Stall, BLOCKED_TICKS);
        }
    }

    #[test]
    fn the_lock_is_lost_when_theta_is_too_far_off_for_too_long() {
        let most = 2 * RotorAngle::from_degrees(15.0).raw() as i32;
        for sign in [1, -1] {
            let fine = Scene::with(MOVING, sign * most, false);
            let wrong = Scene::with(MOVING, sign * (most + 1), false);
            assert_limit(&fine, &wrong, Fault::PhaseLockLost, UNLOCKED_TICKS);
        }
    }

    #[test]
    fn the_lock_is_lost_when_f_stays_away_with_the_motors_at_their_limits() {
        let pressed = Scene::with(MOVING, 0, true);
        for sign in [1, -1] {
            let droop = |scene: &Scene, more: i32| {
                let away = sign * (LARGEST_DROOP.raw() + more);
                but(scene, |scene| scene.setpoint = scene.setpoint + Speed::from_raw(away))
            };
            let (fine, wrong) = (droop(&pressed, 0), droop(&pressed, 1));
            assert_limit(&fine, &wrong, Fault::PhaseLockLost, DROOP_TICKS);
            assert_limit(&droop(&Scene::new(MOVING), 1), &wrong, Fault::PhaseLockLost, DROOP_TICKS);
        }
    }

    #[test]
    fn f_at_the_ceiling_of_the_voltage_is_no_lost_lock_unless_theta_is_off() {
        for sign in [1, -1] {
            let at_ceiling = |sum_error: i32| {
                let mut scene = Scene::with(MOVING, sign * sum_error, true);
                scene.setpoint = scene.setpoint + LARGEST_DROOP + ONE;
                scene.is_ceiling = true;
                scene
            };
            let (fine, wrong) = (at_ceiling(CEILING_SUM_ERROR), at_ceiling(CEILING_SUM_ERROR + 1));
            assert_limit(&fine, &wrong, Fault::PhaseLockLost, DROOP_TICKS);
        }
    }

    #[test]
    fn f_that_ramps_slowly_is_on_its_way_with_the_motors_at_their_limits_too() {
        let mut scene = Scene::after(40, MOVING, 0, true);
        scene.setpoint = scene.setpoint + LARGEST_DROOP + ONE;
        assert_eq!(scene.found_by(&mut Monitor::default()), None);
    }

    /// When a monitor finds that the rotors do not answer, in diagnoses: without current sense, with theta off by 5 degrees, q
    /// current in one motor that adds this to the sum of both speeds at each diagnosis, of which this comes.
    fn unanswered_by(motor: usize, adds: i32, comes: i32) -> Option<(u32, Fault)> {
        let mut scene = Scene::with(MOVING, 2 * RotorAngle::from_degrees(5.0).raw() as i32, false);
        scene.configuration.sensed = false;
        // One that is twice as easy to turn is no other.
        scene.configuration.speed_per_current[1] *= 2;
        // Of flux linkages that leave no doubt.
        scene.configuration.motors.iter_mut().for_each(|model| model.back_emf = 0);
        let least =
            f64::from(scene.configuration.speed_per_current[motor]) / f64::from(1_u32 << 16);
        let amount = Current::from_raw((f64::from(adds) / least).round() as i32);
        let q = scene.configuration.clockwise(motor, amount);
        scene.loops[motor].note(Rotor { d: Current::ZERO, q }, Rotor::default());
        let mut monitor = Monitor::default();
        // As long as no rotor becomes too fast.
        (1..=100).find_map(|count| {
            scene.speeds[motor] = scene.speeds[motor] + Speed::from_raw(comes);
            scene.look(&mut monitor).iter().next().map(|fault| (count, fault))
        })
    }

    #[test]
    fn without_current_sense_rotors_that_do_not_answer_to_their_currents_have_lost_the_lock() {
        // What is forgotten at each diagnosis of as much as is allowed.
        let most = LARGEST_UNANSWERED >> UNANSWERED_SHIFT;
        for motor in [0, 1] {
            for sign in [1, -1] {
                let adds = |share: i32| sign * (most / 100 * share);
                assert_eq!(unanswered_by(motor, adds(95), 0), None, "{motor} {sign}");
                assert_eq!(unanswered_by(motor, adds(150), adds(60)), None, "{motor} {sign}");
                for (share, diagnoses) in [(105, 45..=54), (200, 13..=16)] {
                    let (count, fault) = unanswered_by(motor, adds(share), 0).unwrap();
                    assert_eq!(fault, Fault::PhaseLockLost, "{motor} {sign}");
                    assert!(diagnoses.contains(&count), "{motor} {sign} {share} %: {count}");
                }
            }
        }
    }

    #[test]
    fn without_current_sense_what_flux_linkages_that_are_a_twentieth_wrong_make_of_the_currents_is_no_lost_lock()
     {
        let error = 2 * RotorAngle::from_degrees(5.0).raw() as i32;
        let found_by = |percent: i32| {
            let mut scene = Scene::with(MOVING, error, false);
            scene.configuration.sensed = false;
            // 0.3 ohm at 30 Hz.
            scene.configuration.motors.iter_mut().for_each(|model| model.conductance *= 8);
            scene.speeds = [Speed::from_hertz(30.0), Speed::from_hertz(-30.0)];
            for motor in [0, 1] {
                let speed = scene.configuration.electrical_speed(motor, scene.speeds[motor]);
                let shorted = scene.configuration.motors[motor].shorted(speed);
                let q = Current::from_raw(shorted.magnitude().raw() / 100 * percent);
                // Both of the same sign are what the sum shows.
                let q = scene.configuration.clockwise(motor, q);
                scene.loops[motor].note(Rotor { d: Current::ZERO, q }, Rotor::default());
            }
            scene.found_by(&mut Monitor::default())
        };
        assert_eq!(found_by(5), None);
        assert_eq!(found_by(6), None);
        let (_, fault) = found_by(12).unwrap();
        assert_eq!(fault, Fault::PhaseLockLost);
    }

    #[test]
    fn a_phase_is_open_when_it_carries_next_to_nothing_while_others_carry() {
        let scene = |motor: usize, frequency, currents: [f64; 2]| {
            let currents = currents.map(Current::from_amperes);
            but(&Scene::new(frequency), |scene| scene.currents[motor] = currents)
        };
        /// Returns the first diagnosis that finds it, with a look between each two.
        fn found_by(scene: &Scene, monitor: &mut Monitor) -> Option<u32> {
            (1..=LONG).find(|_| {
                monitor.take_magnitudes(&scene.currents);
                scene.look(monitor).contains(Fault::Alignment)
            })
        }
        let least = OPEN_PHASE_TICKS / DIAGNOSTIC_TICKS;
        for motor in [0, 1] {
            let carries = |frequency, currents| scene(motor, frequency, currents);
            for (fine, wrong) in [
                ([0.0, 0.031], [0.0, 0.033]),
                ([0.031, 0.0], [0.033, 0.0]),
                ([0.031, -0.031], [0.033, -0.033]),
                ([0.126, -1.0], [0.124, -1.0]),
            ] {
                let [fine, wrong] =
                    [fine, wrong].map(|it| found_by(&carries(MOVING, it), &mut Monitor::default()));
                assert!(fine.is_none() && wrong.is_some_and(|count| count >= least), "{wrong:?}");
            }
            let open = carries(MOVING, [0.0, 1.0]);
            let slow = carries(GOING_ON, [0.0, 1.0]);
            assert_eq!(found_by(&slow, &mut Monitor::default()), None);
            let mut monitor = Monitor::default();
            assert_eq!(found_by(&carries(MOVING, [1.0, -0.5]), &mut monitor), None);
            // It fades to an eighth in 66 diagnoses; from then on as above.
            let count = found_by(&open, &mut monitor).unwrap();
            assert!((115..=135).contains(&count), "{count}");
        }
    }

    #[test]
    fn no_phase_is_open_whose_current_turns_however_fast() {
        // 1 A; from 6 Hz of 4 pole pairs to 35 Hz of 20.
        let carries = |tick: f64, hertz: f64, begin: f64| {
            [0.0, TAU / 3.0].map(|behind| {
                let angle = TAU * hertz * tick / f64::from(TICK_RATE_HZ);
                Current::from_amperes((begin + angle - behind).sin())
            })
        };
        let mut scene = Scene::new(MOVING);
        for hertz in (24..=700).map(f64::from).chain([312.5, 625.0]) {
            for begin in [0.0, TAU / 12.0, TAU / 6.0] {
                let mut monitor = Monitor::default();
                for count in 0..3 * OPEN_PHASE_TICKS / DIAGNOSTIC_TICKS {
                    let tick = f64::from(count * DIAGNOSTIC_TICKS);
                    scene.currents = [carries(tick, hertz, begin); 2];
                    assert_eq!(scene.look(&mut monitor), Faults::NONE, "{hertz} Hz");
                    let between = tick + f64::from(MEASURED - DIAGNOSED);
                    monitor.take_magnitudes(&[carries(between, hertz, begin); 2]);
                }
            }
        }
    }

    #[test]
    fn f_that_comes_and_goes_within_a_turn_is_limited_where_it_is_low_most_of_the_time() {
        for (low, expected) in [(2, 0), (3, 1)] {
            let mut monitor = Monitor::default();
            let begin = (Speed::ZERO, RotorAngle::ZERO);
            let said = (0..10 * REACHED_TICKS / DIAGNOSTIC_TICKS)
                .filter(|turn| monitor.becomes_limited(turn % 5 < low, begin))
                .count();
            assert_eq!(said, expected);
            assert_eq!(monitor.frequency_limited(), expected == 1);
        }
    }

    #[test]
    fn f_that_is_held_back_for_a_while_is_said_once_until_it_was_free_for_as_long() {
        let mut monitor = Monitor::default();
        let (mut turns, mut theta) = (0, 0);
        // Whoever asks for another theta now and again has reached nothing.
        let mut said = |held_back: bool, ticks: u32| {
            let asked = |_| {
                turns += 1;
                theta += u32::from(turns % 500 == 0);
                monitor.becomes_limited(held_back, (Speed::ZERO, RotorAngle::from_raw(theta)))
            };
            (0..ticks).map(asked).filter(|becomes| *becomes).count()
        };
        const LOOKS: u32 = HELD_BACK_TICKS / DIAGNOSTIC_TICKS;
        assert_eq!(said(true, LOOKS - 1), 0);
        assert_eq!(said(false, LOOKS), 0);
        assert_eq!(said(true, 3 * LOOKS), 1);
        assert_eq!(said(false, LOOKS / 10) + said(true, 2 * LOOKS), 0);
        assert_eq!(said(false, 2 * LOOKS), 0);
        assert_eq!(said(true, 2 * LOOKS), 1);
    }

    #[test]
    fn f_that_was_reached_is_lost_sooner_unless_another_is_asked_for() {
        const LOOKS: u32 = LOST_TICKS / DIAGNOSTIC_TICKS;
        let reached = || {
            let mut monitor = Monitor::default();
            for _ in 0..REACHED_TICKS / DIAGNOSTIC_TICKS {
                assert!(!monitor.becomes_limited(false, (Speed::ZERO, RotorAngle::ZERO)));
            }
            monitor
        };
        let lost = |monitor: &mut Monitor, asked| {
            (1..=HELD_BACK_TICKS).find(|_| monitor.becomes_limited(true, asked)).unwrap()
        };
        let soon = lost(&mut reached(), (Speed::ZERO, RotorAngle::ZERO));
        assert!((LOOKS..LOOKS + 2).contains(&soon), "{soon}");
        let all = HELD_BACK_TICKS / DIAGNOSTIC_TICKS;
        assert_eq!(lost(&mut reached(), (Speed::from_raw(1), RotorAngle::ZERO)), all);
        assert_eq!(lost(&mut reached(), (Speed::ZERO, RotorAngle::from_raw(1))), all);
    }

    #[test]
    fn a_motor_may_differ_from_its_model_up_to_a_bound() {
        let scene = Scene::new(Speed::ZERO);
        let bus = Bus::new(scene.bus_voltage, 0);
        // A current that is asked for and does not flow.
        for [reference, flowing] in [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3], [0.0, -0.3]] {
            let input = Input {
                phases: Some([Current::ZERO, Current::from_amperes(flowing)]),
                angle: ElectricalAngle::ZERO,
                speed: ElectricalSpeed::ZERO,
                reference: Rotor { d: Current::ZERO, q: Current::from_amperes(reference) },
            };
            let mut state = CurrentLoop::default();
            state.update(&scene.configuration.motors[0], &bus, &input);
            let residual = state.residual(&scene.configuration.motors[0], input.speed);
            let residual = residual.d.magnitude().max(residual.q.magnitude());
            for motor in [0, 1] {
                let bound = |bound| {
                    but(&scene, |scene| {
                        scene.loops[motor] = state;
                        scene.configuration.largest_residual = bound;
                    })
                };
                let (fine, wrong) = (bound(residual), bound(residual - Voltage::from_raw(1)));
                assert_limit(&fine, &wrong, Fault::CurrentSense, RESIDUAL_TICKS);
            }
        }
    }

    #[test]
    fn a_rotor_or_a_lock_for_which_two_causes_are_there_is_found_as_for_one() {
        let pressed = Scene::with(GOING_ON + ONE, 0, true);
        let still = but(&pressed, |scene| scene.speeds[0] = Speed::ZERO);
        let unlocked = but(&Scene::with(MOVING, LARGEST_SUM_ERROR + 1, true), |scene| {
            scene.setpoint = scene.setpoint + LARGEST_DROOP + ONE;
        });
        for (scene, fault) in [(still, Fault::Stall), (unlocked, Fault::PhaseLockLost)] {
            let mut monitor = Monitor::default();
            scene.found_by(&mut monitor);
            for _ in 0..LONG {
                assert!(scene.look(&mut monitor).contains(fault), "{fault}");
            }
        }
    }

    #[test]
    fn what_shows_only_under_control_is_not_looked_for_without_it_and_starts_anew_with_it() {
        let stalled =
            but(&Scene::with(Speed::ZERO, 0, true), |scene| scene.speeds[0] = Speed::ZERO);
        let idle = Scene { shaking: false, ..stalled.clone() };
        assert_eq!(idle.found_by(&mut Monitor::default()), None);
        let mut monitor = Monitor::default();
        for _ in 1..STALL_TICKS / DIAGNOSTIC_TICKS {
            assert_eq!(stalled.look(&mut monitor), Faults::NONE);
        }
        monitor.restart();
        let anew = (STALL_TICKS / DIAGNOSTIC_TICKS, Fault::Stall);
        assert_eq!(stalled.found_by(&mut monitor), Some(anew));
    }

    #[test]
    fn one_sample_above_the_current_limit_may_be_a_spike_and_two_in_a_row_are_not() {
        let found = |samples: &[bool]| {
            let mut monitor = Monitor::default();
            samples.iter().map(|sample| monitor.over_current(*sample)).collect::<std::vec::Vec<_>>()
        };
        assert_eq!(found(&[true, true, true, false]), [false, true, true, false]);
        assert_eq!(found(&[true, false, true]), [false; 3]);
        assert_eq!(found(&[false, true, false, true]), [false; 4]);
        // It outlasts a restart, and falls as it rose.
        let mut monitor = Monitor::default();
        monitor.over_current(true);
        monitor.restart();
        assert!(monitor.over_current(true) && !monitor.over_current(false));
    }
}
