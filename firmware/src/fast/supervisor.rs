//! The one place that decides whether an order moves the robot, and what stops it.
//!
//! ```text
//!            Arm                aligned             Shake, f not 0
//! Disarmed --------> Aligning ---------> Armed <---------------------> Running
//!    ^                  |                  |      f = 0, at rest          |
//!    |                  | Off, stop,       | Off, stop, link lost         | Off, stop, link silent
//!    |                  | link silent      |                              |
//!    +------------------+------------------+------------ Stopping <-------+
//!    |  Clear, 0.5 s after the fault, cause gone    (at rest)
//! Faulted <------------------ any fault; while Disarmed its cause alone counts for nothing
//! ```
//!
//! A robot that ramps down because of silence runs on if an order comes in time before its rotors stand, within 0.4 s; else it ends
//! in Armed, and after 1 s of silence in Disarmed. A trial goes from Disarmed to Aligning and back.
//!
//! # Orders and permits
//!
//! An order is a level: [`Asked::wanted`] in every tick, not an edge. The supervisor holds one [`Permit`] and counts it up at
//! each [`Halt`]: at a fault; at the begin and end of a session; at a stop from outside; when rotors came to rest, alignment ended or
//! the robot was disarmed for want of orders; when rotors were not seen to come to rest; and when an alignment or a trial has
//! finished. No order of the operator in session counts it. **What begins something needs the present permit; what calms needs none.**
//!
//! In the table p is the order's permit. *For good*: ends in Disarmed. *Back*: Running again, where the order is in time. An order is
//! *late* [`LINK_LATE`] after it came or once it has expired ([`Asked::expires`]), *silent* after [`COMMAND_DEADLINE`], *lost* after
//! [`LINK_LOST`]; in time: not late.
//!
//! | state | `Off` | `Arm(p)` | `Shake(p)` | `Try(p)` | `Clear(p)` |
//! |---|---|---|---|---|---|
//! | Disarmed | stays | p present: Aligning | stays | p present: the trial begins | stays |
//! | Disarmed, stop latched | stays | stays | stays | stays | p present: the stop is forgotten |
//! | Aligning | Disarmed | goes on | goes on | Disarmed | goes on |
//! | Aligning, in a trial | Disarmed | Disarmed | Disarmed | the same trial: goes on; else Disarmed | Disarmed |
//! | Armed | Stopping for good | rest | p present, in time: Running; else rest | Stopping for good | rest |
//! | Running | Stopping for good | to rest, then Armed | p present: follow; else as `Arm` | Stopping for good | as `Arm` |
//! | Stopping on silence, ramping | for good | back, to rest | p present: back, follow; else to rest | for good | back, to rest |
//! | Stopping for good | waits | waits | waits | waits | waits |
//! | Stopping on silence, braking | for good | waits | waits | for good | waits |
//! | Faulted | stays | stays | stays | stays | p present: forgets the stop, and after 0.5 s the faults whose cause is gone |
//!
//! Nothing is cleared, and no motor begins to be driven, by an order that is late. A robot leaves Disarmed only while
//! [`Asked::begins`] holds: link and settings are in order. A stop ([`Asked::stops`]) latches in every state and disarms the robot.
//! Each count of [`Asked::halts`] disarms it too, and latches nothing: a session begins or ends, or a stop comes without a session.
//!
//! Settings are taken over where the rotors rest. Until they are, a robot in Aligning brakes; after 2 s that is a fault.
//!
//! The failsafe ladder counts from the arrival of the newest valid command: after [`LINK_LATE`] the
//! operator is warned, after [`COMMAND_DEADLINE`] both rotors ramp down together, after [`LINK_LOST`]
//! the motors are disarmed. A command counts only until it expires ([`Asked::expires`]): once the newest has, both rotors ramp
//! down too, so that a network that delays commands gains no time of movement.
//!
//! # How each fault stops the rotors
//!
//! An eccentric rotor coasts for seconds, so switching off is not a stop. With all low sides on, a
//! motor brakes itself within 0.3 s from 35 Hz; that needs neither encoder nor current sense nor
//! battery, feeds nothing back into the bus, and slows both rotors alike. So all faults brake,
//! except two: under-voltage, where nothing is wrong with control, ramps down phase-locked; and
//! over-current first coasts until the current is gone. Where braking is over-current, an upper switch is short or stuck, and the
//! high sides brake instead, on the same rail as that switch, until the robot is armed anew. A ramp down feeds the bus where it is measured,
//! and burns what the rotors lose where it is not ([`burning`](crate::fast::foc::burning)).

#[cfg(test)]
mod tests;

use flix_protocol::failsafe::{COMMAND_DEADLINE, LINK_LATE, LINK_LOST};
use flix_protocol::message::{Fault, Faults, Halt, Permit, State, Trial};
use flix_protocol::units::Instant;

use crate::fast::exchange::{Asked, EventCounters, Wanted};
use crate::fast::standstill_and_zero::LONGEST_REST_WAIT_TICKS;
use crate::units::Speed;

/// [`LINK_LATE`] in microseconds.
const LINK_LATE_US: u64 = LINK_LATE.as_micros() as u64;
/// [`COMMAND_DEADLINE`] in microseconds.
const COMMAND_DEADLINE_US: u64 = COMMAND_DEADLINE.as_micros() as u64;
/// [`LINK_LOST`] in microseconds.
const LINK_LOST_US: u64 = LINK_LOST.as_micros() as u64;
/// Ticks that a ramp down may take before the motors brake instead: 0.4 s. From 35 Hz it takes
/// 0.25 s.
const LONGEST_RAMP_TICKS: u16 = 4_000;
/// Ticks for which motors that are not driven brake at least, whatever the encoders say: 0.5 s.
const BRAKE_TICKS: u16 = 5_000;
/// Ticks for which an over-current coasts before it brakes: 2 ms, six electrical time constants.
const COAST_TICKS: u16 = 20;
/// Ticks after which too much current is that of the high rail, 10 ms: what the other left is gone.
const RAIL_TICKS: u16 = 100;

/// Ticks for which arming waits for rotors to come to rest, so that settings are taken over: 2 s, as alignment does.
const LONGEST_WAIT_TICKS: u16 = LONGEST_REST_WAIT_TICKS as u16;

/// What the motors are to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Drive {
    /// Switch the bridges off.
    Off,
    /// Short the motors, by all low sides or, where that is said, by all high sides.
    Brake,
    BrakeHigh,
    /// Find the electrical angles.
    Align,
    /// Do the trial that was asked for.
    Try,
    /// Follow this f; `false`: stop, and keep theta as it is.
    Shake(Speed, bool),
}

/// What the supervisor looks at in every tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Conditions {
    /// Faults whose cause is there in this tick.
    pub(crate) present: Faults,
    /// Whether both rotors stand.
    pub(crate) at_rest: bool,
    /// Whether alignment, or the trial, finished in the last tick.
    pub(crate) finished: bool,
    /// Whether settings wait to be taken over: nothing is driven with those before.
    pub(crate) outdated: bool,
}

/// Where the motors are shorted. A leg that is stuck or short at the high rail takes from the battery what braking low shorts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rail {
    /// By all low sides.
    Low,
    /// By all high sides, for so many ticks, as too much flowed by the low ones.
    High(u16),
    /// By all low sides for good: too much flows either way.
    LowAgain,
}

/// Why the rotors ramp down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reason {
    /// No commands: may go on when they come back before the rotors stand.
    Deadline,
    /// Asked to, or gone for too long.
    Final,
}

/// The state machine. Its owner reads the fields for its report; [`Supervisor::update`] and [`Supervisor::raise`]
/// change them.
#[derive(Debug, Clone)]
pub(crate) struct Supervisor {
    pub(crate) state: State,
    /// Latched.
    pub(crate) faults: Faults,
    /// The first of them.
    pub(crate) first_fault: Option<Fault>,
    /// Whether a stop is latched.
    pub(crate) stopped: bool,
    /// Whether commands are late while motors are, or may at once be, driven.
    pub(crate) link_late: bool,
    link_lost: bool,
    reason: Reason,
    /// Ticks in this state, saturating.
    ticks: u16,
    /// Counted up at each halt.
    pub(crate) permit: Permit,
    /// Why the permit was counted up last.
    pub(crate) halt: Halt,
    /// [`Asked::number`] of the newest order that was looked at.
    pub(crate) obeyed: u32,
    /// [`Asked::stops`] that have latched.
    pub(crate) stops: u8,
    /// [`Asked::halts`] that have counted.
    pub(crate) halts: u8,
    ramp_down: bool,
    rail: Rail,
    /// The trial under way; `None` while the motors are aligned.
    trial: Option<Trial>,
    /// What happened since power-up.
    pub(crate) events: EventCounters,
}

impl Supervisor {
    /// Starts disarmed, at power-up.
    pub(crate) fn new() -> Self {
        Self {
            state: State::Disarmed,
            faults: Faults::NONE,
            first_fault: None,
            stopped: false,
            link_late: false,
            link_lost: false,
            reason: Reason::Final,
            ticks: 0,
            permit: Permit::default(),
            halt: Halt::Started,
            obeyed: 0,
            stops: 0,
            halts: 0,
            ramp_down: false,
            rail: Rail::Low,
            trial: None,
            events: EventCounters::default(),
        }
    }

    /// Returns whether motors are, or may at once be, driven.
    pub(crate) const fn driving(&self) -> bool {
        matches!(self.state, State::Aligning | State::Armed | State::Running | State::Stopping)
    }

    /// Latches faults; the lowest bit of the first to come is the first cause.
    #[inline]
    pub(crate) fn raise(&mut self, faults: Faults) {
        if faults.is_empty() {
            return;
        }
        self.first_fault = self.first_fault.or_else(|| faults.iter().next());
        let all = self.faults.union(faults);
        if all != self.faults {
            self.faults = all;
            self.count(Halt::Fault);
        }
        if self.state != State::Faulted {
            // A ramp down needs both rotors under control: alignment has none to ramp down, and one that took too long brakes.
            self.ramp_down = match self.state {
                State::Armed | State::Running => true,
                State::Stopping => self.ticks <= LONGEST_RAMP_TICKS,
                State::Disarmed | State::Aligning | State::Faulted => false,
            };
            self.enter(State::Faulted);
        }
    }

    /// Does one tick. Never panics.
    #[inline]
    pub(crate) fn update(&mut self, now: Instant, asked: &Asked, conditions: &Conditions) -> Drive {
        self.ticks = self.ticks.saturating_add(1);
        if !conditions.present.is_empty() && self.state != State::Disarmed {
            self.raise(conditions.present);
        }
        if (asked.stops, asked.halts) != (self.stops, self.halts) {
            self.halt(asked);
        }
        if self.driving() {
            self.climb_ladder(now, asked);
        } else {
            self.link_late = false;
            self.link_lost = false;
        }
        self.obeyed = asked.number;
        self.advance(now, asked, conditions)
    }

    /// Returns whether it has been in its state for longer than rotors brake.
    pub(crate) const fn has_braked(&self) -> bool {
        self.ticks >= BRAKE_TICKS
    }

    /// Returns whether it has been in its state for so long that rotors which are not driven stand, whatever the encoders say.
    pub(crate) const fn braked_for_long(&self) -> bool {
        self.ticks == u16::MAX
    }

    fn enter(&mut self, state: State) {
        self.state = state;
        self.ticks = 0;
    }

    /// Counts the permit up: orders that carry an earlier one begin nothing any more.
    const fn count(&mut self, halt: Halt) {
        (self.permit, self.halt) = (self.permit.next(), halt);
    }

    /// Latches the stops, and obeys the halts, that came since the last tick.
    #[cold]
    fn halt(&mut self, asked: &Asked) {
        let is_stop = asked.stops != self.stops;
        if is_stop && !core::mem::replace(&mut self.stopped, true) {
            self.events.stopped = self.events.stopped.wrapping_add(1);
        }
        if asked.halts != self.halts {
            self.count(if is_stop { Halt::StoppedFromOutside } else { Halt::Operator });
        }
        (self.stops, self.halts) = (asked.stops, asked.halts);
        self.ramp_down_and_disarm();
    }

    /// Returns whether the order carries the present permit and has come in time, so that it may begin or clear something.
    fn is_permitted(&self, now: Instant, asked: &Asked) -> bool {
        let silence = now.as_micros().saturating_sub(asked.heard.as_micros());
        asked.permit == self.permit && silence < LINK_LATE_US && now <= asked.expires
    }

    /// Begins to align, or with a trial, after which the robot is disarmed again.
    #[cold]
    fn begin(&mut self, now: Instant, asked: &Asked) {
        let trial = asked.trial.filter(|_| asked.wanted == Wanted::Try);
        let is_whole = trial.is_some() == (asked.wanted == Wanted::Try);
        if asked.begins && is_whole && self.is_permitted(now, asked) {
            self.trial = trial;
            self.rail = Rail::Low;
            self.enter(State::Aligning);
        }
    }

    /// Brings the rotors to rest and disarms, from whatever state.
    fn ramp_down_and_disarm(&mut self) {
        match self.state {
            State::Disarmed | State::Faulted => {}
            State::Aligning => self.enter(State::Disarmed),
            State::Armed | State::Running => {
                self.reason = Reason::Final;
                self.enter(State::Stopping);
            }
            State::Stopping => self.reason = Reason::Final,
        }
    }

    /// Forgets the stop, and the faults whose cause is gone. Reported where something was forgotten.
    #[cold]
    fn clear(&mut self, now: Instant, asked: &Asked, conditions: &Conditions) {
        if !self.is_permitted(now, asked) {
            return;
        }
        let mut is_news = core::mem::take(&mut self.stopped);
        if self.state == State::Faulted && self.ticks >= BRAKE_TICKS {
            let mut left = Faults::NONE;
            for fault in self.faults.iter().filter(|fault| conditions.present.contains(*fault)) {
                left = left.with(fault);
            }
            is_news |= left != self.faults;
            self.faults = left;
            if left.is_empty() {
                self.first_fault = None;
                self.enter(State::Disarmed);
            } else if !self.first_fault.is_some_and(|first| left.contains(first)) {
                self.first_fault = left.iter().next();
            }
        }
        if is_news {
            self.events.cleared = self.events.cleared.wrapping_add(1);
        }
    }

    #[inline]
    fn climb_ladder(&mut self, now: Instant, asked: &Asked) {
        let silence = now.as_micros().saturating_sub(asked.heard.as_micros());
        let expired = now > asked.expires;
        if silence < LINK_LATE_US && !expired {
            self.link_late = false;
            self.link_lost = false;
            return;
        }
        core::hint::cold_path();
        if !self.link_late {
            self.link_late = true;
            self.events.link_late = self.events.link_late.wrapping_add(1);
        }
        let silent = silence >= COMMAND_DEADLINE_US;
        // Rotors turn while the robot aligns its motors, too.
        if (silent || expired) && matches!(self.state, State::Running | State::Aligning) {
            let event = if silent {
                &mut self.events.command_deadline
            } else {
                &mut self.events.command_age
            };
            *event = event.wrapping_add(1);
            if self.state == State::Running {
                self.reason = Reason::Deadline;
                self.enter(State::Stopping);
            } else {
                self.count(Halt::LetGo);
                self.enter(State::Disarmed);
            }
        }
        if silence >= LINK_LOST_US && !self.link_lost {
            self.link_lost = true;
            self.events.link_lost = self.events.link_lost.wrapping_add(1);
            // The operator's own order to disarm is under way: nothing else halts the robot.
            let is_asked = self.state == State::Stopping && self.reason == Reason::Final;
            if self.driving() && !is_asked {
                self.count(Halt::LinkLost);
            }
            self.ramp_down_and_disarm();
        }
    }

    /// Obeys the order in force, and returns the drive of the state that this leads to.
    #[inline]
    fn advance(&mut self, now: Instant, asked: &Asked, conditions: &Conditions) -> Drive {
        match self.state {
            State::Disarmed => {
                match asked.wanted {
                    Wanted::Arm | Wanted::Try if !self.stopped => self.begin(now, asked),
                    Wanted::Clear => self.clear(now, asked, conditions),
                    _ => {}
                }
                // Alignment begins in the next tick, so that this one does no more than others.
                self.rest(conditions)
            }
            State::Aligning => self.align(asked, conditions),
            State::Armed | State::Running => self.shake(asked, conditions),
            State::Stopping => self.stop(asked, conditions),
            State::Faulted => {
                if asked.wanted == Wanted::Clear {
                    self.clear(now, asked, conditions);
                }
                match self.state {
                    State::Faulted => self.make_safe(conditions),
                    _ => self.rest(conditions),
                }
            }
        }
    }

    fn align(&mut self, asked: &Asked, conditions: &Conditions) -> Drive {
        let tries = self.trial.is_some();
        let goes_on = match asked.wanted {
            Wanted::Off => false,
            Wanted::Try => tries && self.trial == asked.trial,
            Wanted::Arm | Wanted::Shake | Wanted::Clear => !tries,
        };
        if !goes_on {
            self.enter(State::Disarmed);
            return self.rest(conditions);
        }
        if conditions.outdated {
            return self.wait(conditions);
        }
        if conditions.finished && tries {
            self.count(Halt::Tried);
            self.enter(State::Disarmed);
            return Drive::Brake;
        }
        if conditions.finished {
            self.count(Halt::Aligned);
            self.enter(State::Armed);
            return Drive::Shake(Speed::ZERO, false);
        }
        if tries { Drive::Try } else { Drive::Align }
    }

    #[inline]
    fn shake(&mut self, asked: &Asked, conditions: &Conditions) -> Drive {
        let is_followed = asked.wanted == Wanted::Shake && asked.permit == self.permit;
        let frequency = if is_followed { asked.frequency } else { Speed::ZERO };
        if matches!(asked.wanted, Wanted::Off | Wanted::Try) {
            core::hint::cold_path();
            self.ramp_down_and_disarm();
            return self.stop(asked, conditions);
        }
        if self.state == State::Armed {
            if frequency == Speed::ZERO || self.link_late {
                return Drive::Shake(Speed::ZERO, false);
            }
            self.enter(State::Running);
        } else if frequency == Speed::ZERO && conditions.at_rest {
            self.enter(State::Armed);
        }
        Drive::Shake(frequency, is_followed)
    }

    /// Brakes until the newest settings are in force.
    #[cold]
    fn wait(&mut self, conditions: &Conditions) -> Drive {
        if self.ticks <= LONGEST_WAIT_TICKS {
            return Drive::Brake;
        }
        self.raise(Faults::NONE.with(Fault::Alignment));
        self.make_safe(conditions)
    }

    fn stop(&mut self, asked: &Asked, conditions: &Conditions) -> Drive {
        if matches!(asked.wanted, Wanted::Off | Wanted::Try) {
            self.reason = Reason::Final;
        }
        // Rotors that brake are not under control any more.
        let ramps = self.ticks <= LONGEST_RAMP_TICKS;
        let drive = if ramps { Drive::Shake(Speed::ZERO, false) } else { Drive::Brake };
        let back = self.reason == Reason::Deadline && !self.link_late && ramps;
        if back {
            self.enter(State::Running);
        } else if conditions.at_rest {
            match self.reason {
                Reason::Deadline => {
                    self.count(Halt::Rested);
                    self.enter(State::Armed);
                }
                Reason::Final => self.enter(State::Disarmed),
            }
        } else if self.ticks > LONGEST_RAMP_TICKS + BRAKE_TICKS {
            // Encoders that see no rest where there must be one.
            self.count(Halt::Rested);
            self.enter(State::Disarmed);
        }
        drive
    }

    /// Switches off where the rotors stand, and brakes where they do not: a robot that restarts in the
    /// middle of a run finds them spinning.
    fn rest(&self, conditions: &Conditions) -> Drive {
        let stands = conditions.at_rest || self.braked_for_long();
        match self.rail {
            // A bridge that cannot coast is off by its low sides, which would feed that switch again.
            Rail::High(_) => Drive::BrakeHigh,
            _ if self.has_braked() && stands => Drive::Off,
            Rail::Low | Rail::LowAgain => Drive::Brake,
        }
    }

    fn make_safe(&mut self, conditions: &Conditions) -> Drive {
        let only = |fault| self.faults == Faults::NONE.with(fault);
        let coasts = self.first_fault == Some(Fault::OverCurrent) && self.ticks < COAST_TICKS;
        if coasts {
            Drive::Off
        } else if self.ramp_down && only(Fault::UnderVoltage) && self.ticks < LONGEST_RAMP_TICKS {
            Drive::Shake(Speed::ZERO, false)
        } else {
            let is_excess = conditions.present.contains(Fault::OverCurrent);
            self.rail = match self.rail {
                Rail::Low if is_excess => Rail::High(0),
                Rail::High(RAIL_TICKS..) if is_excess => Rail::LowAgain,
                Rail::High(ticks) => Rail::High(ticks.saturating_add(1)),
                rail => rail,
            };
            self.rest(conditions)
        }
    }
}
