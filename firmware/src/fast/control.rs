//! The fast half of the robot, put together: encoders and currents in, duties out, 10,000 times a
//! second, in integers alone.
//!
//! It takes what is [`Asked`] in every tick and gives a [`Report`] when it is called for; a [`Configuration`] is taken
//! over only while the motors are not driven.

#[cfg(test)]
pub(crate) mod bench;
#[cfg(test)]
mod tests;

use flix_protocol::message::{Channel, EncoderHealth, Fault, Faults, LoopTiming, State};
use flix_protocol::units::Instant;

use crate::fast::aligner::{self, Aligner, Progress};
use crate::fast::configuration::{Configuration, DIAGNOSTIC_TICKS};
use crate::fast::exchange::{Asked, MotorReport, Report};
use crate::fast::foc::burning::{self, direct_current};
use crate::fast::foc::current::{CurrentLoop, Input};
use crate::fast::foc::modulation::Bus;
use crate::fast::foc::transform::Rotor;
use crate::fast::headroom::{Headroom, LOOK_TICKS, Look};
use crate::fast::interval::Interval;
use crate::fast::monitor::{Monitor, Observation};
use crate::fast::reference::STRIDE;
use crate::fast::shaker::{Rotors, Setpoint, Shaker};
use crate::fast::supervisor::{Conditions, Drive, Supervisor};
use crate::fast::tracker::{TABLE_LENGTH, Tracker};
use crate::fast::trial::{self, TrialRun};
use crate::hardware::{Actuation, Bridge, Magnet, Sensors};
use crate::scope::{Sample, row};
use crate::units::{
    Counts, Current, RotorAngle, Speed, TICK_US, Voltage, magnitude, multiply_high,
};

/// Tick after a multiple of [`DIAGNOSTIC_TICKS`] that diagnoses.
pub(crate) const DIAGNOSED: u32 = 1;
/// Tick after a multiple of [`DIAGNOSTIC_TICKS`] that looks at the magnitudes of the currents once more: an even one. Boards convert a phase
/// before and after the middle of the PWM period in turn, and what pulses add to its current changes its sign.
pub(crate) const MEASURED: u32 = 10;
/// Tick after a multiple of [`DIAGNOSTIC_TICKS`] that adds to the interval: half-way between two diagnoses, and not one of those
/// in which the shaker is updated.
const OBSERVED: u32 = 9;
/// Tick after a multiple of [`DIAGNOSTIC_TICKS`] that works out the range of the amplifiers, where that is new: another such tick.
const RANGED: u32 = 5;
/// The current that burns what the rotors lose grows by this share of the limit with each update of the shaker, 2^-3: within 3 ms.
const BURNING_SHIFT: u32 = 3;
/// It fades by this share an update, 2^-5: in 12.8 ms, three times the time constant of 3 mH and 0.75 ohm.
const FADING_SHIFT: u32 = 5;
/// Ticks after a multiple of [`LOOK_TICKS`] that look at the voltage headroom of a motor: two more such ticks.
const LOOKED_AT_TOP: u32 = 7;
const LOOKED_AT_BOTTOM: u32 = 15;
/// A tick later than this is late: half as long again, microseconds.
const LATE_US: u32 = TICK_US + TICK_US / 2;
/// Currents beyond this are taken for this, 32 A: more than any over-current limit.
const LARGEST_CURRENT: Current = Current::from_raw(32 << 16);
/// A gap beyond which references and trackers are of no use any more: 3 ms.
const LONGEST_GAP_US: u32 = 3_000;
/// Late ticks within [`LATE_FORGIVEN_TICKS`] each that are a fault.
const LATE_LIMIT: u32 = 10;
/// Ticks in time that make up for one late tick.
const LATE_FORGIVEN_TICKS: u32 = 100;
/// Ticks of slow rotors that count as rest: 10 ms.
const REST_TICKS: u32 = 100;
/// Slower than this is at rest: 0.3 Hz.
const AT_REST: Speed = Speed::from_centihertz(30);
/// The bus voltage is averaged over 2 diagnoses.
const BUS_FILTER_SHIFT: u32 = 1;
/// By so much of itself the bus that duties are made for may fall from one diagnosis to the next, 2^-6: 117 V/s from 12 V.
const BUS_FALLS_SHIFT: u32 = 6;
/// f is averaged over 2^4 diagnoses, about one turn.
const FREQUENCY_FILTER_SHIFT: u32 = 4;
/// The battery must recover by this much before it is warned of again: 0.3 V.
const BATTERY_HYSTERESIS: Voltage = Voltage::from_raw(19_661);

/// What the bridges do at present.
#[derive(Debug, Clone)]
enum Activity {
    /// Off or braking.
    Idle,
    Aligning(Aligner),
    /// Alignment is done; its eccentricity goes into the tables, one entry a tick.
    Tabulating(usize),
    Trying(TrialRun),
    Shaking,
}

/// The fast half.
#[derive(Debug, Clone)]
pub struct Control {
    configuration: Configuration,
    supervisor: Supervisor,
    trackers: [Tracker; 2],
    /// What the encoders said of their magnets at the last diagnosis.
    magnets: [Magnet; 2],
    loops: [CurrentLoop; 2],
    shaker: Shaker,
    activity: Activity,
    bus: Bus,
    bus_voltage: Voltage,
    /// The last two readings of the bus, the newer one last.
    bus_readings: [Voltage; 2],
    battery_low: bool,
    /// What the amplifiers show at no current, and the current beyond which a phase is an over-current.
    zeros: [[Counts; 2]; 2],
    over_current: [Current; 2],
    /// Whether `over_current` still has to follow new zeros or settings.
    is_range_new: bool,
    /// Currents of phases A and B.
    currents: [[Current; 2]; 2],
    references: [Rotor<Current>; 2],
    headroom: Headroom,
    /// f that is asked for, before the ceiling of the voltage lowers it.
    setpoint: Speed,
    monitor: Monitor,
    /// Faults of the last diagnosis.
    present: Faults,
    at_rest: bool,
    /// Whether alignment, or a trial, has just ended well.
    finished: bool,
    /// Whether a configuration waits that was not taken yet.
    outdated: bool,
    /// A fault that alignment found, for the next tick.
    misaligned: Faults,
    still: u32,
    lateness: u32,
    time: Instant,
    /// [`Report::frequency`], 2^-4.
    frequency: i32,
    largest_voltage: Voltage,
    interval: Interval,
    timing: LoopTiming,
    period: u8,
    alignments: u8,
}

impl Control {
    /// Starts disarmed, at power-up.
    #[must_use]
    pub fn new(configuration: Configuration) -> Self {
        let rotors = Rotors { angles: [RotorAngle::ZERO; 2], speeds: [Speed::ZERO; 2] };
        let zeros = [[configuration.zero_design; 2]; 2];
        Self {
            supervisor: Supervisor::new(),
            trackers: [Tracker::new(); 2],
            magnets: [Magnet::Good; 2],
            loops: [CurrentLoop::default(); 2],
            shaker: Shaker::at_rest(&rotors),
            activity: Activity::Idle,
            bus: Bus::new(configuration.bus_nominal, configuration.dead_share),
            bus_voltage: configuration.bus_nominal,
            bus_readings: [configuration.bus_nominal; 2],
            battery_low: false,
            over_current: configuration.over_current(&zeros),
            zeros,
            is_range_new: false,
            currents: [[Current::ZERO; 2]; 2],
            references: [Rotor::default(); 2],
            headroom: Headroom::new(),
            setpoint: Speed::ZERO,
            monitor: Monitor::default(),
            present: Faults::NONE,
            at_rest: false,
            finished: false,
            outdated: false,
            misaligned: Faults::NONE,
            still: 0,
            lateness: 0,
            time: Instant::START,
            frequency: 0,
            largest_voltage: Voltage::ZERO,
            interval: Interval::default(),
            timing: LoopTiming::default(),
            period: 0,
            alignments: 0,
            configuration,
        }
    }

    /// Takes over a new configuration; only while disarmed or faulted, or before aligning begins, with the rotors at rest.
    /// Returns whether it did; one that it did not take keeps it from beginning to drive the motors in the next tick.
    pub fn configure(&mut self, configuration: &Configuration) -> bool {
        let idle = match self.supervisor.state {
            State::Disarmed | State::Faulted => true,
            State::Aligning => matches!(self.activity, Activity::Idle),
            State::Armed | State::Running | State::Stopping => false,
        };
        let idle = idle && (self.still >= REST_TICKS || self.supervisor.braked_for_long());
        self.outdated = !idle;
        if idle {
            for (tracker, (old, new)) in self
                .trackers
                .iter_mut()
                .zip(self.configuration.encoders.iter().zip(&configuration.encoders))
            {
                tracker.count_otherwise(old, new);
            }
            self.configuration = *configuration;
            self.take_zeros(self.zeros);
            if configuration.bus_per_count == 0 {
                self.bus_voltage = configuration.bus_nominal;
                self.bus_readings = [configuration.bus_nominal; 2];
            }
        }
        idle
    }

    /// Latches a fault that the slow half found (settings).
    pub fn raise(&mut self, fault: Fault) {
        self.supervisor.raise(Faults::NONE.with(fault));
    }

    /// Does one tick: sensors and what is asked in, bridges out. Integers alone; never panics.
    #[inline]
    pub fn tick(&mut self, now: Instant, sensors: &Sensors, asked: &Asked) -> Actuation {
        let late = self.keep_time(now, asked.period);
        let [top, bottom] = sensors.encoders;
        self.trackers[0].update(&self.configuration.encoders[0], top);
        self.trackers[1].update(&self.configuration.encoders[1], bottom);
        let excess = self.measure_currents(sensors);
        let rotors = self.rotors();
        let count = self.timing.ticks as u32;
        if count % DIAGNOSTIC_TICKS == DIAGNOSED {
            self.diagnose(sensors, asked, &rotors);
        } else if count % DIAGNOSTIC_TICKS == OBSERVED {
            self.observe(&rotors);
        } else if count % DIAGNOSTIC_TICKS == MEASURED {
            self.monitor.take_magnitudes(&self.currents);
        } else if self.is_range_new && count % DIAGNOSTIC_TICKS == RANGED {
            self.take_range();
        }
        let lost = self.trackers[0].lost() || self.trackers[1].lost();
        let mut present = self.present;
        for (fault, is_present) in [
            (Fault::OverCurrent, self.monitor.over_current(excess)),
            (Fault::LoopOverrun, late),
            (Fault::EncoderLost, lost),
        ] {
            if is_present {
                core::hint::cold_path();
                present = present.with(fault);
            }
        }
        let conditions = Conditions {
            present,
            at_rest: self.at_rest,
            finished: core::mem::take(&mut self.finished),
            outdated: core::mem::take(&mut self.outdated),
        };
        match self.supervisor.update(now, asked, &conditions) {
            Drive::Shake(frequency, turn) => {
                let setpoint = Setpoint { frequency, direction: turn.then_some(asked.direction) };
                self.shake(&rotors, &setpoint, count.is_multiple_of(STRIDE))
            }
            Drive::Align => self.align(sensors),
            Drive::Try => self.try_out(sensors, asked),
            Drive::Brake => self.rest_in(Bridge::BRAKE),
            Drive::BrakeHigh => self.rest_in(Bridge::BRAKE_HIGH),
            Drive::Off => self.rest_in(Bridge::Off),
        }
    }

    /// Returns how it is, as of the last tick.
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
                current_q: self.configuration.clockwise(index, current.q),
            };
        }
        let modulation = i64::from(self.largest_voltage.raw()) * i64::from(u16::MAX)
            / i64::from(self.bus.limit.raw().max(1));
        Report {
            time: self.time,
            state: self.supervisor.state,
            rests: matches!(self.activity, Activity::Idle)
                && (self.at_rest || self.supervisor.has_braked()),
            faults: self.supervisor.faults,
            first_fault: self.supervisor.first_fault,
            stopped: self.supervisor.stopped,
            link_late: self.supervisor.link_late,
            frequency_limited: self.monitor.frequency_limited(),
            permit: self.supervisor.permit,
            halt: self.supervisor.halt,
            obeyed: self.supervisor.obeyed,
            stops: self.supervisor.stops,
            halts: self.supervisor.halts,
            frequency: Speed::from_raw(self.frequency >> FREQUENCY_FILTER_SHIFT),
            direction: rotors.direction(),
            motors,
            interval: self.interval,
            encoders: [0, 1].map(|index| self.encoder(index)),
            bus_voltage: (self.configuration.bus_per_count != 0).then_some(self.bus_voltage),
            modulation: modulation.clamp(0, i64::from(u16::MAX)) as u16,
            timing: self.timing,
            alignments: self.alignments,
            alignment: self.configuration.alignment,
            events: self.supervisor.events,
        }
    }

    fn encoder(&self, index: usize) -> EncoderHealth {
        let (dropped, corrected) = self.trackers[index % 2].counted();
        EncoderHealth { dropped, corrected, magnet: self.magnets[index % 2] }
    }

    /// Returns what the scope keeps of the last tick; `revision` is that of the plan with these channels.
    #[inline]
    #[must_use]
    pub fn sample(&self, channels: &[Channel], revision: u8) -> Sample {
        let rotors = self.rotors();
        Sample {
            time: self.time,
            revision,
            row: row(channels.iter().map(|channel| self.count(*channel, &rotors))),
            is_faulted: self.supervisor.first_fault.is_some(),
            is_driven: matches!(self.supervisor.state, State::Aligning | State::Running),
            is_pattern: matches!(&self.activity, Activity::Trying(run) if run.is_pattern()),
        }
    }

    /// Returns the value of a channel in counts of its [`Quantity`](flix_protocol::message::Quantity).
    #[inline(always)]
    fn count(&self, channel: Channel, rotors: &Rotors) -> i32 {
        let current = |current: Current| current.raw() >> 5;
        let voltage = |voltage: Voltage| voltage.raw() >> 7;
        let speed = |speed: Speed| speed.raw() >> 11;
        let angle = |angle: RotorAngle| angle.raw() as i32 >> 16;
        let ([top, bottom], signs) = (&self.loops, &self.configuration);
        match channel {
            Channel::TopCurrentD => current(top.current().d),
            Channel::BottomCurrentD => current(bottom.current().d),
            Channel::TopCurrentQ => current(signs.clockwise(0, top.current().q)),
            Channel::BottomCurrentQ => current(signs.clockwise(1, bottom.current().q)),
            Channel::TopWantedQ => current(signs.clockwise(0, self.references[0].q)),
            Channel::BottomWantedQ => current(signs.clockwise(1, self.references[1].q)),
            Channel::TopVoltageD => voltage(top.voltage().d),
            Channel::BottomVoltageD => voltage(bottom.voltage().d),
            Channel::TopVoltageQ => voltage(signs.clockwise(0, top.voltage().q)),
            Channel::BottomVoltageQ => voltage(signs.clockwise(1, bottom.voltage().q)),
            Channel::TopPhaseA => current(self.currents[0][0]),
            Channel::BottomPhaseA => current(self.currents[1][0]),
            Channel::TopPhaseB => current(self.currents[0][1]),
            Channel::BottomPhaseB => current(self.currents[1][1]),
            Channel::TopAngle => angle(rotors.angles[0]),
            Channel::BottomAngle => angle(rotors.angles[1]),
            Channel::TopSpeed => speed(rotors.speeds[0]),
            Channel::BottomSpeed => speed(rotors.speeds[1]),
            Channel::Frequency => speed(rotors.frequency()),
            Channel::WantedFrequency => {
                speed(self.driving_shaker().map_or(Speed::ZERO, Shaker::frequency))
            }
            Channel::Theta => angle(rotors.direction()),
            // Of twice theta, behind: half of it, ahead.
            Channel::ThetaError => self.driving_shaker().map_or(0, |it| -(it.sum_error() >> 17)),
            Channel::Bus => voltage(self.bus_voltage),
        }
    }

    /// Returns the shaker while it drives.
    #[inline]
    fn driving_shaker(&self) -> Option<&Shaker> {
        matches!(self.activity, Activity::Shaking).then_some(&self.shaker)
    }

    #[inline(always)]
    fn rotors(&self) -> Rotors {
        let [top, bottom] = &self.trackers;
        Rotors { angles: [top.angle(), bottom.angle()], speeds: [top.speed(), bottom.speed()] }
    }

    /// Moves everything that predicts over ticks that never came; returns whether the loop is late
    /// beyond forgiveness.
    #[inline(always)]
    fn keep_time(&mut self, now: Instant, period: u8) -> bool {
        let interval = (now.as_micros() as u32).wrapping_sub(self.time.as_micros() as u32);
        self.time = now;
        self.timing.ticks = self.timing.ticks.wrapping_add(1);
        if period != self.period {
            self.period = period;
            self.timing.longest_interval_us = 0;
            self.largest_voltage = Voltage::ZERO;
            self.interval.restart();
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
        // What is beyond the limit would take as long to be forgiven.
        self.lateness = (self.lateness + LATE_FORGIVEN_TICKS).min(LATE_LIMIT * LATE_FORGIVEN_TICKS);
        let missed = (interval.saturating_add(TICK_US / 2) / TICK_US).saturating_sub(1);
        for tracker in &mut self.trackers {
            tracker.skip(missed);
        }
        self.shaker.skip(missed);
        interval > LONGEST_GAP_US || self.lateness >= LATE_LIMIT * LATE_FORGIVEN_TICKS
    }

    /// Converts counts to amperes; returns whether a phase carries too much, or more than its
    /// amplifier can show.
    #[inline(always)]
    fn measure_currents(&mut self, sensors: &Sensors) -> bool {
        let Some([top, bottom]) = sensors.phase_current else { return false };
        self.measure_motor(0, top) | self.measure_motor(1, bottom)
    }

    #[inline(always)]
    fn measure_motor(&mut self, motor: usize, [a, b]: [i16; 2]) -> bool {
        let limit = self.over_current[motor].raw();
        let beyond = |current: Current| {
            current.raw().wrapping_add(limit) as u32 > limit.wrapping_mul(2) as u32
        };
        let [zero_a, zero_b] = self.zeros[motor];
        let [scale_a, scale_b] = self.configuration.current_per_count[motor];
        let a = (Counts::new(a) - zero_a).current(scale_a);
        let b = (Counts::new(b) - zero_b).current(scale_b);
        self.currents[motor] = [a, b];
        if beyond(a) || beyond(b) || beyond(a + b) {
            core::hint::cold_path();
            self.currents[motor] = [a, b].map(|current| current.within(LARGEST_CURRENT));
            return true;
        }
        false
    }

    /// Takes over what the amplifiers show at no current, and so how much more they can show: within [`DIAGNOSTIC_TICKS`].
    const fn take_zeros(&mut self, zeros: [[Counts; 2]; 2]) {
        self.zeros = zeros;
        self.is_range_new = true;
    }

    #[cold]
    fn take_range(&mut self) {
        self.is_range_new = false;
        self.over_current = self.configuration.over_current(&self.zeros);
    }

    /// Adds to what telemetry reports of the interval.
    #[inline(never)]
    fn observe(&mut self, rotors: &Rotors) {
        let [top, bottom] = self.loops.each_ref().map(CurrentLoop::current);
        let signs = &self.configuration;
        let currents = [signs.clockwise(0, top.q), signs.clockwise(1, bottom.q)];
        self.interval.add(rotors.direction(), currents, self.bus_voltage);
    }

    /// Looks at what need not be looked at in every tick: bus, faults that build up, rest, averages.
    #[inline(never)]
    fn diagnose(&mut self, sensors: &Sensors, asked: &Asked, rotors: &Rotors) {
        let bus_contradicts = self.measure_bus(sensors.bus_voltage);
        self.magnets = sensors.magnets;
        let observation = Observation {
            configuration: &self.configuration,
            bus_voltage: self.bus_voltage,
            bus_reading: self.bus_readings[1],
            bus_contradicts,
            trackers: &self.trackers,
            currents: &self.currents,
            loops: &self.loops,
            shaking: matches!(self.activity, Activity::Shaking),
            shaker: &self.shaker,
            setpoint: self.setpoint,
            reachable: self.headroom.clamp(self.setpoint),
        };
        let misaligned = core::mem::take(&mut self.misaligned);
        self.present = self.monitor.faults(misaligned, &observation);
        let rotating = Speed::from_raw(self.frequency >> FREQUENCY_FILTER_SHIFT);
        let held_back = self.driving_shaker().is_some_and(|it| {
            let ramps = &self.configuration.shaker.ramps;
            it.held_back(ramps, asked.frequency, rotating) || self.headroom.limits(self.setpoint)
        });
        if self.monitor.becomes_limited(held_back, (asked.frequency, asked.direction)) {
            let events = &mut self.supervisor.events;
            events.frequency_limited = events.frequency_limited.wrapping_add(1);
        }
        self.at_rest = self.rest(rotors);
        self.frequency += rotors.frequency().raw() - (self.frequency >> FREQUENCY_FILTER_SHIFT);
        for current_loop in &self.loops {
            self.largest_voltage = self.largest_voltage.max(current_loop.voltage().q.magnitude());
        }
    }

    /// Takes a reading of the bus: the middle one of three, as one alone may be an outlier. Returns whether it contradicts what is
    /// known while the motors are driven. Duties, which grow as the bus falls, believe none that does, and let no other fall faster
    /// than by 2^-[`BUS_FALLS_SHIFT`].
    fn measure_bus(&mut self, counts: Option<u16>) -> bool {
        let is_driven = !matches!(self.activity, Activity::Idle);
        let mut contradicts = false;
        let mut believed = self.bus_voltage;
        if let Some(counts) = counts {
            let voltage = multiply_high(i32::from(counts) << 14, self.configuration.bus_per_count);
            let newest = Voltage::from_raw(voltage);
            let [oldest, older] = self.bus_readings;
            self.bus_readings = [older, newest];
            let reading = older.min(newest).max(oldest.min(older.max(newest)));
            let change = (reading - self.bus_voltage).raw() >> BUS_FILTER_SHIFT;
            self.bus_voltage = self.bus_voltage + Voltage::from_raw(change);
            contradicts = is_driven && self.contradicts(reading);
            let before = self.bus.voltage;
            believed = match is_driven {
                false => self.bus_voltage,
                true if contradicts => before,
                true => self
                    .bus_voltage
                    .max(before - Voltage::from_raw(before.raw() >> BUS_FALLS_SHIFT)),
            };
        }
        self.bus = Bus::new(believed, self.configuration.dead_share);
        let low = self.bus_voltage < self.configuration.battery_low;
        if low && !self.battery_low {
            let events = &mut self.supervisor.events;
            events.battery_low = events.battery_low.wrapping_add(1);
        }
        let recovered = self.bus_voltage > self.configuration.battery_low + BATTERY_HYSTERESIS;
        self.battery_low = low || (self.battery_low && !recovered);
        contradicts
    }

    /// Returns whether the bus cannot be as low as this: no battery falls by more than 3/8 within two readings, and magnets that
    /// turn charge one that is empty.
    fn contradicts(&self, bus: Voltage) -> bool {
        let configuration = &self.configuration;
        let induces = |motor: usize, tracker: &Tracker| {
            let speed = configuration.electrical_speed(motor, tracker.speed()).raw();
            magnitude(multiply_high(speed, configuration.motors[motor % 2].back_emf))
        };
        let [top, bottom] = &self.trackers;
        bus.raw() < 5 * (self.bus.voltage.raw() >> 3)
            || bus < configuration.under_voltage
                && bus.raw() < induces(0, top).max(induces(1, bottom))
    }

    /// Returns whether the rotors have been slow for a while, and nobody wants them to turn.
    fn rest(&mut self, rotors: &Rotors) -> bool {
        let [top, bottom] = rotors.speeds;
        let slow = top.magnitude() < AT_REST && bottom.magnitude() < AT_REST;
        self.still = if slow { self.still.saturating_add(DIAGNOSTIC_TICKS) } else { 0 };
        let standing = !matches!(self.activity, Activity::Shaking) || self.shaker.standing();
        self.still >= REST_TICKS && standing
    }

    #[inline(always)]
    fn shake(&mut self, rotors: &Rotors, setpoint: &Setpoint, outer: bool) -> Actuation {
        if !matches!(self.activity, Activity::Shaking) {
            self.begin_shaking(rotors);
        }
        match self.timing.ticks as u32 % LOOK_TICKS {
            LOOKED_AT_TOP => self.look(0, rotors),
            LOOKED_AT_BOTTOM => self.look(1, rotors),
            _ => {}
        }
        if outer {
            self.setpoint = setpoint.frequency;
            let frequency = self.headroom.clamp(setpoint.frequency);
            let setpoint = &Setpoint { frequency, direction: setpoint.direction };
            let limited = self.loops[0].take_limited() | self.loops[1].take_limited();
            let torques = self.shaker.update(&self.configuration.shaker, rotors, setpoint, limited);
            let [top, bottom] = torques.currents;
            self.references = [
                self.reference_currents(0, top, rotors.speeds[0]),
                self.reference_currents(1, bottom, rotors.speeds[1]),
            ];
            for (tracker, change) in self.trackers.iter_mut().zip(torques.speed_changes) {
                tracker.feed_forward(change);
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
        self.references = [Rotor::default(); 2];
        self.headroom = Headroom::new();
        self.monitor.restart();
        // It may have been low long before anybody armed the robot.
        let events = &mut self.supervisor.events;
        events.battery_low = events.battery_low.wrapping_add(u8::from(self.battery_low));
    }

    /// Looks at the voltage headroom of a motor.
    #[inline(never)]
    fn look(&mut self, index: usize, rotors: &Rotors) {
        let configuration = &self.configuration;
        let steady = self.shaker.is_steady(&configuration.shaker);
        if steady && (self.shaker.gives_way() || self.shaker.slipping()) {
            self.headroom.give_way(self.shaker.frequency());
        }
        let load = self.shaker.load(&configuration.shaker)[index];
        let backwards = rotors.speeds[index].raw() < 0;
        let load = if backwards { -load } else { load };
        self.headroom.look(
            index,
            &Look {
                model: &configuration.motors[index],
                bus: &self.bus,
                pole_pairs: configuration.pole_pairs as i32,
                speed: configuration.electrical_speed(index, rotors.speeds[index]),
                reference: self.references[index],
                load: load.max(Current::ZERO),
                steady,
                limited: self.shaker.limited(),
                lags: self.shaker.lags(),
                setpoint: self.setpoint,
                current: self.loops[index].current(),
                voltage: self.loops[index].voltage(),
                ripple: self.shaker.ripple_share(),
                limit: configuration.shaker.current_limit,
            },
        );
    }

    /// Returns the current of a motor that makes this clockwise torque, and burns what the rotors lose
    /// while f falls where nobody knows whether the bus can take it.
    #[inline(always)]
    fn reference_currents(&self, index: usize, clockwise: Current, speed: Speed) -> Rotor<Current> {
        let configuration = &self.configuration;
        let q = configuration.clockwise(index, clockwise);
        let per_speed = configuration.burning_per_speed[index];
        let limit = configuration.shaker.current_limit;
        let weakening = self.headroom.direct_current(index, q, limit);
        // At the ceiling f comes and goes by little, and what burns would take the voltage that it lacks; a reversal leaves it.
        let reverses = self.setpoint.raw() ^ self.shaker.frequency().raw() < 0;
        let burns = self.shaker.gives_back()
            || self.shaker.slowing() && (reverses || !self.headroom.limits(self.setpoint));
        let before = self.references[index].d;
        if per_speed == 0 || !burns && weakening <= before {
            return Rotor { d: weakening, q };
        }
        if !burns {
            // What the inductance holds goes into the winding, not back: slower than in any winding that is shorted.
            let fading = before - Current::from_raw(before.raw() >> FADING_SHIFT);
            return Rotor { d: fading.within(burning::room(q, limit)).min(weakening), q };
        }
        let speed = configuration.electrical_speed(index, speed);
        let burning = direct_current(per_speed, speed, q, limit);
        // A step of all of it would overshoot by half.
        let begins = before - Current::from_raw(limit.raw() >> BURNING_SHIFT);
        Rotor { d: burning.max(begins).min(weakening), q }
    }

    /// Drives one motor: from its current reference to its bridge.
    #[inline(always)]
    fn drive(&mut self, index: usize, angle: RotorAngle, speed: Speed) -> Bridge {
        let configuration = &self.configuration;
        let input = Input {
            phases: configuration.sensed.then_some(self.currents[index]),
            angle: configuration.electrical_angle(index, angle),
            speed: configuration.electrical_speed(index, speed),
            reference: self.references[index],
        };
        Bridge::Duty(self.loops[index].update(&configuration.motors[index], &self.bus, &input))
    }

    /// Leaves both bridges in one state.
    fn rest_in(&mut self, bridge: Bridge) -> Actuation {
        if !matches!(self.activity, Activity::Idle) {
            self.activity = Activity::Idle;
            self.loops = [CurrentLoop::default(); 2];
        }
        Actuation { bridges: [bridge; 2] }
    }

    #[inline(never)]
    fn align(&mut self, sensors: &Sensors) -> Actuation {
        if let Activity::Tabulating(entry) = self.activity {
            return self.tabulate(entry);
        }
        if !matches!(self.activity, Activity::Aligning(_)) {
            self.begin_aligning();
        }
        let Activity::Aligning(aligner) = &mut self.activity else { return Actuation::OFF };
        let observation = aligner::Observation {
            trackers: &self.trackers,
            counts: sensors
                .phase_current
                .filter(|_| self.configuration.sensed)
                .map(|motors| motors.map(|phases| phases.map(Counts::new))),
            bus: &self.bus,
        };
        let (bridges, progress) = aligner.update(&self.configuration, &observation);
        match progress {
            Progress::Busy => {}
            Progress::Failed(fault) => self.misaligned = Faults::NONE.with(fault),
            Progress::Done => {
                (self.zeros, self.is_range_new) = (aligner.zeros, true);
                if aligner.full {
                    self.configuration.apply(aligner.results());
                    self.configuration.aligned = true;
                    self.activity = Activity::Tabulating(0);
                } else {
                    self.finished = true;
                }
            }
        }
        Actuation { bridges }
    }

    /// Does a tick of a trial: motors and sense are driven and measured without any value of theirs.
    #[inline(never)]
    fn try_out(&mut self, sensors: &Sensors, asked: &Asked) -> Actuation {
        let (Some(counts), Some(trial)) = (sensors.phase_current, &asked.trial) else {
            self.misaligned = Faults::NONE.with(Fault::CurrentSense);
            return Actuation { bridges: [Bridge::BRAKE; 2] };
        };
        if !matches!(self.activity, Activity::Trying(_)) {
            self.activity = Activity::Trying(TrialRun::new(trial));
        }
        let Activity::Trying(run) = &mut self.activity else { return Actuation::OFF };
        let observation = trial::Observation {
            trackers: &self.trackers,
            counts: counts.map(|phases| phases.map(Counts::new)),
            currents: &self.currents,
            bus: &self.bus,
        };
        let (bridges, progress) = run.update(&self.configuration, &observation);
        for (index, (current_loop, currents)) in
            self.loops.iter_mut().zip(self.currents).enumerate()
        {
            let (current, voltage) = run.of_motor(index, currents);
            current_loop.note(current, voltage);
        }
        if let Some(zeros) = run.zeros
            && zeros != self.zeros
        {
            self.take_zeros(zeros);
        }
        match progress {
            Progress::Busy => {}
            Progress::Failed(fault) => self.misaligned = Faults::NONE.with(fault),
            Progress::Done => self.finished = true,
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

    /// Works out one entry of both eccentricity tables; the motors brake meanwhile.
    fn tabulate(&mut self, entry: usize) -> Actuation {
        for (encoder, alignment) in
            self.configuration.encoders.iter_mut().zip(&self.configuration.alignment)
        {
            encoder.set_entry(entry, &alignment.eccentricity);
        }
        if entry + 1 < TABLE_LENGTH {
            self.activity = Activity::Tabulating(entry + 1);
        } else {
            self.activity = Activity::Idle;
            self.finished = true;
            self.alignments = self.alignments.wrapping_add(1);
        }
        Actuation { bridges: [Bridge::BRAKE; 2] }
    }
}
