//! The fast half of the robot, put together: encoders and currents in, duties out, 10,000 times a
//! second, in integers alone.
//!
//! The slow half (link, settings, telemetry) runs at another priority or on another core. The two
//! exchange whole values through mailboxes: an [`Order`] goes in, a [`Report`] comes out, and a
//! [`Configuration`] is taken over while the motors are let go. Events cross as counters, so that
//! none is lost when a mailbox is overwritten.
//!
//! # Fixed point
//!
//! | quantity | unit of the integer |
//! |---|---|
//! | angle | 2^-32 turn, wrapping ([`Turn`]) |
//! | speed | 2^-32 turn per tick ([`Speed`]) |
//! | current | 2^-16 A |
//! | voltage | 2^-16 V |
//!
//! Rotor angles inside are clockwise from forward, as `theta` and `f` are.

#[cfg(test)]
mod bench;
#[cfg(test)]
mod tests;

use flix_protocol::message::{Fault, Faults, State};
use flix_protocol::units::Instant;

use crate::exchange::{MotorReport, Order, Report, Timing};
use crate::fast::aligner::{Aligner, Observation, Progress};
use crate::fast::configuration::Configuration;
use crate::fast::foc::current::{CurrentLoop, Input};
use crate::fast::foc::modulation::Bus;
use crate::fast::shaker::{Rotors, STRIDE, Shaker, Target};
use crate::fast::supervisor::{Conditions, Drive, Supervisor};
use crate::fast::tracker::{TABLE_LENGTH, Tracker};
use crate::fast::units::{Speed, TURN_PER_DEGREE};
use crate::fast::units::{magnitude, multiply_high};
use crate::hardware::{Actuation, Bridge, Sensors, TICK_RATE_HZ, TICK_US, Turn};

/// A tick later than this is late: half as long again, microseconds.
const LATE_US: u32 = TICK_US + TICK_US / 2;
/// A gap beyond which references and trackers are of no use any more: 3 ms.
const LONGEST_GAP_US: u32 = 3_000;
/// Late ticks within [`LATE_FORGIVEN_TICKS`] each that are a fault.
const LATE_LIMIT: u32 = 10;
/// Ticks in time that make up for one late tick.
const LATE_FORGIVEN_TICKS: u32 = 100;
/// Consecutive samples above the limit that are an over-current: one alone may be a spike.
const OVER_CURRENT_TICKS: u32 = 2;
/// Ticks for which the bus must be too low: 20 ms, longer than a sag of one turn.
const UNDER_VOLTAGE_TICKS: u32 = 200;
/// Ticks for which the bus must be too high: 3.2 ms.
const OVER_VOLTAGE_TICKS: u32 = 32;
/// Ticks at the current limit without movement: 0.2 s.
const STALL_TICKS: u32 = 2_000;
/// Ticks without movement while f goes on: 20 ms.
const BLOCKED_TICKS: u32 = 200;
/// f goes on from here: 5 Hz.
const GOING_ON: Speed = hertz(500);
/// Slower than this is no movement: 1 Hz.
const STALLED: Speed = hertz(100);
/// Twice theta may be off by this much: 15 degrees of theta.
const LARGEST_SUM_ERROR: i32 = (30.0 * TURN_PER_DEGREE) as i32;
/// Ticks for which theta may be further off, or the phase slip: 0.1 s.
const UNLOCKED_TICKS: u32 = 1_000;
/// Ticks for which f may stay away from what is asked for with the motors at their limits: 1 s.
const DROOP_TICKS: u32 = 10_000;
/// f may be off by this much: 10 Hz. A walking body that swings against its rotors at 35 Hz takes up to 8 Hz
/// for a second (seen in simulation); theta is held meanwhile, and telemetry tells f.
const LARGEST_DROOP: Speed = hertz(1_000);
/// Ticks for which a motor may differ from its model: 10 ms.
const RESIDUAL_TICKS: u32 = 100;
/// Ticks of slow rotors that count as rest: 10 ms.
const REST_TICKS: u32 = 100;
/// Slower than this is at rest: 0.3 Hz.
const AT_REST: Speed = hertz(30);
/// The bus voltage is averaged over 2 surveys.
const BUS_FILTER_SHIFT: u32 = 1;
/// f is averaged over 2^4 surveys, about one turn.
const FREQUENCY_FILTER_SHIFT: u32 = 4;
/// The battery must recover by this much before it is warned of again: 0.3 V.
const BATTERY_HYSTERESIS: i32 = 19_661;
/// Ticks for which a phase must carry next to nothing while the others do: 0.1 s.
const OPEN_PHASE_TICKS: u32 = 1_000;
/// A phase is open when its peak is below this share of the largest, 2^-3.
const OPEN_PHASE_SHIFT: u32 = 3;
/// Peaks below this tell nothing: 0.15 A.
const TELLING_CURRENT: i32 = 9_830;
/// Peaks fade within 2^5 surveys, 50 ms, several electrical turns.
const PEAK_SHIFT: u32 = 5;
/// What builds up slowly is looked at in one tick of so many.
const SURVEY_TICKS: u32 = 16;

/// Hundredths of a hertz as a [`Speed`].
const fn hertz(hundredths: i64) -> Speed {
    (hundredths * (1 << 32) / (100 * TICK_RATE_HZ as i64)) as Speed
}

/// Counts looks at which something is wrong; falls at the same rate when it is not.
#[derive(Debug, Clone, Copy, Default)]
struct Suspicion(u32);

impl Suspicion {
    /// Counts a tick; whether `limit` is reached.
    #[inline(always)]
    const fn count(&mut self, wrong: bool, limit: u32) -> bool {
        if wrong {
            self.0 += (self.0 < limit) as u32;
        } else {
            self.0 = self.0.saturating_sub(1);
        }
        self.0 >= limit
    }
}

/// What is suspected but not sure yet.
#[derive(Debug, Clone, Copy, Default)]
struct Suspicions {
    under_voltage: Suspicion,
    over_voltage: Suspicion,
    stall: [Suspicion; 2],
    blocked: [Suspicion; 2],
    unlocked: Suspicion,
    droop: Suspicion,
    residual: Suspicion,
    open_phase: [Suspicion; 2],
    /// Fading peaks of the phase currents, 2^-16 A.
    peaks: [[i32; 3]; 2],
}

/// What the bridges do at present.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one exists, in a static; nothing is allocated")]
enum Activity {
    /// Let go or braking.
    Idle,
    Aligning(Aligner),
    /// Alignment is done; its eccentricity goes into the tables, one entry a tick.
    Learning(usize),
    Shaking,
}

/// The fast half.
#[derive(Debug, Clone)]
pub struct Control {
    configuration: Configuration,
    supervisor: Supervisor,
    trackers: [Tracker; 2],
    loops: [CurrentLoop; 2],
    shaker: Shaker,
    activity: Activity,
    bus: Bus,
    bus_voltage: i32,
    battery_low: bool,
    /// Counts at no current, 2^-4.
    zeros: [[i32; 2]; 2],
    /// Currents of phases A and B, 2^-16 A.
    currents: [[i32; 2]; 2],
    /// Clockwise currents, 2^-16 A.
    wanted: [i32; 2],
    over_current: Suspicion,
    suspicions: Suspicions,
    /// Faults of the last survey.
    present: Faults,
    at_rest: bool,
    aligned: bool,
    /// A fault that alignment found, for the next tick.
    misaligned: Faults,
    still: u32,
    lateness: u32,
    time: Instant,
    /// [`Report::frequency`], 2^-4.
    frequency: i32,
    largest_voltage: i32,
    timing: Timing,
    period: u8,
    alignments: u8,
}

impl Control {
    /// Disarmed, at power-up.
    #[must_use]
    pub fn new(configuration: Configuration) -> Self {
        let rotors = Rotors { angles: [0; 2], speeds: [0; 2] };
        Self {
            supervisor: Supervisor::new(),
            trackers: [Tracker::new(); 2],
            loops: [CurrentLoop::default(); 2],
            shaker: Shaker::at_rest(&rotors),
            activity: Activity::Idle,
            bus: Bus::new(configuration.bus_nominal, configuration.dead_share),
            bus_voltage: configuration.bus_nominal,
            battery_low: false,
            zeros: [[configuration.zero_design; 2]; 2],
            currents: [[0; 2]; 2],
            wanted: [0; 2],
            over_current: Suspicion::default(),
            suspicions: Suspicions::default(),
            present: Faults::NONE,
            at_rest: false,
            aligned: false,
            misaligned: Faults::NONE,
            still: 0,
            lateness: 0,
            time: Instant::START,
            frequency: 0,
            largest_voltage: 0,
            timing: Timing::default(),
            period: 0,
            alignments: 0,
            configuration,
        }
    }

    /// Takes over a new configuration; only while disarmed or faulted, with the rotors at rest.
    /// Tells whether it did.
    pub fn configure(&mut self, configuration: &Configuration) -> bool {
        let idle = matches!(self.supervisor.state(), State::Disarmed | State::Faulted)
            && self.still >= REST_TICKS;
        if idle {
            self.configuration = *configuration;
        }
        idle
    }

    /// Latches a fault that the slow half found (settings).
    pub fn raise(&mut self, fault: Fault) {
        self.supervisor.raise(Faults::NONE.with(fault));
    }

    /// One tick: sensors and order in, bridges out. Integers alone; never panics.
    #[inline]
    pub fn tick(&mut self, now: Instant, sensors: &Sensors, order: &Order) -> Actuation {
        let late = self.keep_time(now, order.period);
        let [top, bottom] = sensors.encoders;
        self.trackers[0].update(&self.configuration.encoders[0], top);
        self.trackers[1].update(&self.configuration.encoders[1], bottom);
        let excess = self.measure_currents(sensors);
        let rotors = self.rotors();
        let count = self.timing.ticks as u32;
        if count % SURVEY_TICKS == 1 {
            self.survey(sensors, order, &rotors);
        }
        let mut present = self.present;
        if self.over_current.count(excess, OVER_CURRENT_TICKS) {
            present = present.with(Fault::OverCurrent);
        }
        if late {
            present = present.with(Fault::LoopOverrun);
        }
        if self.trackers[0].lost() | self.trackers[1].lost() {
            present = present.with(Fault::EncoderLost);
        }
        let conditions = Conditions {
            present,
            at_rest: self.at_rest,
            aligned: core::mem::take(&mut self.aligned),
        };
        match self.supervisor.update(now, order, &conditions) {
            Drive::Shake(frequency, turn) => {
                let target = Target { frequency, direction: turn.then_some(order.direction) };
                self.shake(&rotors, &target, count.is_multiple_of(STRIDE))
            }
            Drive::Align => self.align(sensors),
            Drive::Brake => self.let_go(Bridge::BRAKE),
            Drive::Off => self.let_go(Bridge::Off),
        }
    }

    /// How it is, as of the last tick.
    #[must_use]
    pub fn report(&self) -> Report {
        let rotors = self.rotors();
        let mut motors = [MotorReport::default(); 2];
        for (index, motor) in motors.iter_mut().enumerate() {
            let current = self.loops[index % 2].current();
            *motor = MotorReport {
                angle: rotors.angles[index % 2],
                speed: rotors.speeds[index % 2],
                current_d: current.d,
                current_q: current.q.wrapping_mul(self.configuration.clockwise[index % 2]),
            };
        }
        let modulation = i64::from(self.largest_voltage) * i64::from(u16::MAX)
            / i64::from(self.bus.limit.max(1));
        Report {
            time: self.time,
            state: self.supervisor.state(),
            faults: self.supervisor.faults(),
            first_fault: self.supervisor.first_fault(),
            stopped: self.supervisor.stopped(),
            link_late: self.supervisor.link_late(),
            obeyed: self.supervisor.obeyed(),
            frequency: self.frequency >> FREQUENCY_FILTER_SHIFT,
            direction: rotors.direction(),
            motors,
            bus_voltage: (self.configuration.bus_per_count != 0).then_some(self.bus_voltage),
            modulation: modulation.clamp(0, i64::from(u16::MAX)) as u16,
            timing: self.timing,
            alignments: self.alignments,
            alignment: self.configuration.alignment,
            events: self.supervisor.events(),
        }
    }

    #[inline(always)]
    fn rotors(&self) -> Rotors {
        let [top, bottom] = &self.trackers;
        Rotors { angles: [top.angle(), bottom.angle()], speeds: [top.speed(), bottom.speed()] }
    }

    /// Moves everything that predicts over ticks that never came; whether the loop is late beyond
    /// forgiveness.
    #[inline(always)]
    fn keep_time(&mut self, now: Instant, period: u8) -> bool {
        let interval = (now.as_micros() as u32).wrapping_sub(self.time.as_micros() as u32);
        self.time = now;
        self.timing.ticks = self.timing.ticks.wrapping_add(1);
        if period != self.period {
            self.period = period;
            self.timing.longest_interval_us = 0;
            self.largest_voltage = 0;
        }
        self.timing.longest_interval_us = self.timing.longest_interval_us.max(interval);
        if interval > LATE_US {
            return self.miss(interval);
        }
        if self.lateness != 0 {
            core::hint::cold_path();
            self.lateness -= 1;
        }
        false
    }

    #[cold]
    fn miss(&mut self, interval: u32) -> bool {
        if self.timing.ticks == 1 {
            // There was none before.
            self.timing.longest_interval_us = 0;
            return false;
        }
        self.timing.overruns = self.timing.overruns.saturating_add(1);
        self.lateness = self.lateness.saturating_add(LATE_FORGIVEN_TICKS);
        let missed = (interval.saturating_add(TICK_US / 2) / TICK_US).saturating_sub(1);
        for tracker in &mut self.trackers {
            tracker.skip(missed);
        }
        self.shaker.skip(missed);
        interval > LONGEST_GAP_US || self.lateness >= LATE_LIMIT * LATE_FORGIVEN_TICKS
    }

    /// Counts to amperes; whether a phase carries too much, or its amplifier cannot tell.
    #[inline(always)]
    fn measure_currents(&mut self, sensors: &Sensors) -> bool {
        let Some(counts) = sensors.phase_current else { return false };
        let limit = self.configuration.over_current_counts;
        let beyond = |count: i32| count.wrapping_add(limit) as u32 > limit.wrapping_mul(2) as u32;
        let mut excess = false;
        let scales = &self.configuration.current_per_count;
        let motors = self.currents.iter_mut().zip(&self.zeros).zip(scales);
        for (((currents, zeros), scale), [a, b]) in motors.zip(counts) {
            let [zero_a, zero_b] = zeros;
            let (a, b) = (i32::from(a) * 16 - zero_a, i32::from(b) * 16 - zero_b);
            excess |= beyond(a) | beyond(b) | beyond(a + b);
            *currents = [multiply_high(a << 11, *scale), multiply_high(b << 11, *scale)];
        }
        excess
    }

    /// What need not be looked at in every tick: bus, faults that build up, rest, averages.
    #[inline(never)]
    fn survey(&mut self, sensors: &Sensors, order: &Order, rotors: &Rotors) {
        self.measure_bus(sensors.bus_voltage);
        self.present = self.faults(order);
        self.at_rest = self.rest(rotors);
        self.frequency += rotors.frequency() - (self.frequency >> FREQUENCY_FILTER_SHIFT);
        for current_loop in &self.loops {
            self.largest_voltage = self.largest_voltage.max(magnitude(current_loop.voltage().q));
        }
    }

    fn measure_bus(&mut self, counts: Option<u16>) {
        if let Some(counts) = counts {
            let voltage = multiply_high(i32::from(counts) << 14, self.configuration.bus_per_count);
            self.bus_voltage += (voltage - self.bus_voltage) >> BUS_FILTER_SHIFT;
        }
        self.bus = Bus::new(self.bus_voltage, self.configuration.dead_share);
        let low = self.bus_voltage < self.configuration.bus_low;
        if low && !self.battery_low {
            self.supervisor.warn_battery();
        }
        let recovered = self.bus_voltage > self.configuration.bus_low + BATTERY_HYSTERESIS;
        self.battery_low = low || (self.battery_low && !recovered);
    }

    /// Faults whose cause is there now, but for those that every tick looks for.
    fn faults(&mut self, order: &Order) -> Faults {
        let mut faults = core::mem::take(&mut self.misaligned);
        for tracker in &self.trackers {
            if magnitude(tracker.speed()) > self.configuration.over_speed {
                faults = faults.with(Fault::OverSpeed);
            }
        }
        let suspicions = &mut self.suspicions;
        let low = self.bus_voltage < self.configuration.under_voltage;
        if suspicions.under_voltage.count(low, UNDER_VOLTAGE_TICKS / SURVEY_TICKS) {
            faults = faults.with(Fault::UnderVoltage);
        }
        let high = self.bus_voltage > self.configuration.over_voltage;
        if suspicions.over_voltage.count(high, OVER_VOLTAGE_TICKS / SURVEY_TICKS) {
            faults = faults.with(Fault::OverVoltage);
        }
        if matches!(self.activity, Activity::Shaking) {
            self.shaking_faults(faults, order)
        } else {
            faults
        }
    }

    /// Faults that show only while the rotors are controlled.
    fn shaking_faults(&mut self, mut faults: Faults, order: &Order) -> Faults {
        let suspicions = &mut self.suspicions;
        let pressed = self.shaker.limited();
        let going_on = magnitude(self.shaker.frequency()) > GOING_ON;
        let counts = suspicions.stall.iter_mut().zip(&mut suspicions.blocked);
        for (tracker, (stall, blocked)) in self.trackers.iter().zip(counts) {
            let still = magnitude(tracker.speed()) < STALLED;
            if stall.count(still && pressed, STALL_TICKS / SURVEY_TICKS)
                | blocked.count(still && going_on, BLOCKED_TICKS / SURVEY_TICKS)
            {
                faults = faults.with(Fault::Stall);
            }
        }
        let unlocked =
            self.shaker.slipping() || magnitude(self.shaker.sum_error()) > LARGEST_SUM_ERROR;
        let droop = order.frequency.wrapping_sub(self.shaker.frequency());
        let drooping = pressed && magnitude(droop) > LARGEST_DROOP;
        if suspicions.unlocked.count(unlocked, UNLOCKED_TICKS / SURVEY_TICKS)
            | suspicions.droop.count(drooping, DROOP_TICKS / SURVEY_TICKS)
        {
            faults = faults.with(Fault::PhaseLockLost);
        }
        if self.open_phase(going_on) {
            faults = faults.with(Fault::Alignment);
        }
        let suspicions = &mut self.suspicions;
        let bound = self.configuration.largest_residual;
        let off = self.loops.iter().any(|current_loop| {
            let residual = current_loop.residual();
            magnitude(residual.d).max(magnitude(residual.q)) > bound
        });
        if suspicions.residual.count(off, RESIDUAL_TICKS / SURVEY_TICKS) {
            faults = faults.with(Fault::CurrentSense);
        }
        faults
    }

    /// Whether a phase carries next to nothing while its motor turns and the others carry.
    fn open_phase(&mut self, going_on: bool) -> bool {
        let Suspicions { open_phase, peaks, .. } = &mut self.suspicions;
        let mut found = false;
        for ((peaks, suspicion), [a, b]) in peaks.iter_mut().zip(open_phase).zip(self.currents) {
            for (peak, current) in peaks.iter_mut().zip([a, b, a.wrapping_add(b)]) {
                *peak = (*peak - (*peak >> PEAK_SHIFT)).max(magnitude(current));
            }
            let [a, b, c] = *peaks;
            let (least, most) = (a.min(b).min(c), a.max(b).max(c));
            let open = going_on && most > TELLING_CURRENT && least < most >> OPEN_PHASE_SHIFT;
            found |= suspicion.count(open, OPEN_PHASE_TICKS / SURVEY_TICKS);
        }
        found
    }

    /// Whether the rotors have been slow for a while, and nobody wants them to turn.
    fn rest(&mut self, rotors: &Rotors) -> bool {
        let [top, bottom] = rotors.speeds;
        let slow = magnitude(top) < AT_REST && magnitude(bottom) < AT_REST;
        self.still = if slow { self.still.saturating_add(SURVEY_TICKS) } else { 0 };
        let standing = !matches!(self.activity, Activity::Shaking) || self.shaker.standing();
        self.still >= REST_TICKS && standing
    }

    #[inline(always)]
    fn shake(&mut self, rotors: &Rotors, target: &Target, outer: bool) -> Actuation {
        if !matches!(self.activity, Activity::Shaking) {
            self.begin_shaking(rotors);
        }
        if outer {
            let limited = self.loops[0].limited() | self.loops[1].limited();
            let demand = self.shaker.update(&self.configuration.shaker, rotors, target, limited);
            self.wanted = demand.currents;
            for (tracker, change) in self.trackers.iter_mut().zip(demand.speed_changes) {
                tracker.foresee(change);
            }
        }
        Actuation {
            bridges: [
                self.drive(0, rotors.angles[0], rotors.speeds[0]),
                self.drive(1, rotors.angles[1], rotors.speeds[1]),
            ],
        }
    }

    #[cold]
    fn begin_shaking(&mut self, rotors: &Rotors) {
        self.activity = Activity::Shaking;
        self.loops = [CurrentLoop::default(); 2];
        self.shaker = Shaker::at_rest(rotors);
        self.wanted = [0; 2];
        self.suspicions = Suspicions::default();
    }

    /// One motor: its wanted current to its bridge.
    #[inline(always)]
    fn drive(&mut self, index: usize, angle: Turn, speed: Speed) -> Bridge {
        let configuration = &self.configuration;
        let input = Input {
            phases: configuration.sensed.then_some(self.currents[index]),
            angle: configuration.electrical_angle(index, angle),
            speed: speed.wrapping_mul(configuration.signed_pole_pairs[index]),
            current_q: self.wanted[index].wrapping_mul(configuration.clockwise[index]),
        };
        Bridge::Duty(self.loops[index].update(&configuration.motors[index], &self.bus, &input))
    }

    fn let_go(&mut self, bridge: Bridge) -> Actuation {
        if !matches!(self.activity, Activity::Idle) {
            self.activity = Activity::Idle;
            self.loops = [CurrentLoop::default(); 2];
        }
        Actuation { bridges: [bridge; 2] }
    }

    #[inline(never)]
    fn align(&mut self, sensors: &Sensors) -> Actuation {
        if let Activity::Learning(entry) = self.activity {
            return self.learn(entry);
        }
        if !matches!(self.activity, Activity::Aligning(_)) {
            self.begin_aligning();
        }
        let Activity::Aligning(aligner) = &mut self.activity else { return Actuation::OFF };
        let observation = Observation {
            trackers: &self.trackers,
            counts: sensors
                .phase_current
                .filter(|_| self.configuration.sensed)
                .map(|motors| motors.map(|phases| phases.map(|count| i32::from(count) * 16))),
            bus: &self.bus,
        };
        let (bridges, progress) = aligner.update(&self.configuration, &observation);
        match progress {
            Progress::Busy => {}
            Progress::Failed(fault) => self.misaligned = Faults::NONE.with(fault),
            Progress::Done => {
                self.zeros = aligner.zeros();
                if aligner.full() {
                    self.configuration.apply(aligner.results());
                    self.configuration.aligned = true;
                    self.activity = Activity::Learning(0);
                } else {
                    self.aligned = true;
                }
            }
        }
        Actuation { bridges }
    }

    #[cold]
    fn begin_aligning(&mut self) {
        let full = !self.configuration.aligned;
        if full {
            for encoder in &mut self.configuration.encoders {
                encoder.eccentricity = [0; TABLE_LENGTH];
            }
        }
        self.activity = Activity::Aligning(Aligner::new(full, &self.configuration));
    }

    /// One entry of both eccentricity tables; the motors brake meanwhile.
    fn learn(&mut self, entry: usize) -> Actuation {
        for (encoder, alignment) in
            self.configuration.encoders.iter_mut().zip(&self.configuration.alignment)
        {
            encoder.learn_entry(entry, &alignment.eccentricity);
        }
        if entry + 1 < TABLE_LENGTH {
            self.activity = Activity::Learning(entry + 1);
        } else {
            self.activity = Activity::Idle;
            self.aligned = true;
            self.alignments = self.alignments.wrapping_add(1);
        }
        Actuation { bridges: [Bridge::BRAKE; 2] }
    }
}
