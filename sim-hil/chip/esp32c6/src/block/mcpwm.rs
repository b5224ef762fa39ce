//! The motor PWM: three timers, three operators with two generators each (technical reference manual, chapter 36).
//!
//! Nothing runs step by step: where a counter stands and when a shadow register is taken over follow from the time.
//! A generator's share of a period follows from walking the counter's events once. Of the
//! interrupts those of a timer's zero are modelled. Dead time, carriers, faults, captures and synchronisation are not modelled
//! and must stay as they are after reset.

use super::{Answer, CYCLES_PER_SECOND, Unmodelled, cycles_of, ticks_of};
use crate::registers::Values;

const CLOCK_PRESCALER: u32 = 0x00;
const TIMER: u32 = 0x04;
const TIMER_STRIDE: u32 = 0x10;
const TIMER_SELECTION: u32 = 0x38;
const OPERATOR: u32 = 0x3C;
const OPERATOR_STRIDE: u32 = 0x38;
const UPDATE: u32 = 0x10C;
const INTERRUPT_ENABLE: u32 = 0x110;
const INTERRUPT_STATUS: u32 = 0x118;
const INTERRUPT_CLEAR: u32 = 0x11C;
const REGISTER_CLOCK: u32 = 0x128;

/// The method by which a stamp is taken over at its counter's peak alone.
const AT_PEAK: u32 = 2;
/// The interrupt of each timer's zero.
const ZERO: [u32; 3] = [1 << 3, 1 << 4, 1 << 5];
/// The timer whose zero wakes the fast loop.
const TICK: usize = 1;
/// The timer whose period is the PWM's.
const CARRIER: usize = 0;

/// Offsets within an operator.
mod operator {
    pub(super) const STAMP_METHOD: u32 = 0x00;
    pub(super) const STAMP_A: u32 = 0x04;
    pub(super) const STAMP_B: u32 = 0x08;
    pub(super) const ACTION_METHOD: u32 = 0x0C;
    pub(super) const FORCE: u32 = 0x10;
    pub(super) const ACTIONS_A: u32 = 0x14;
    pub(super) const ACTIONS_B: u32 = 0x18;
}

/// How a pin's share of the time is high.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wave {
    /// Periods a second; 0 for a level.
    pub hertz: f64,
    /// Share of the time that the pin is high, 0 to 1.
    pub share: f64,
}

impl Wave {
    /// Creates a wave that neither rises nor falls.
    pub const fn level(is_high: bool) -> Self {
        Self { hertz: 0.0, share: if is_high { 1.0 } else { 0.0 } }
    }
}

/// How a counter moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Frozen,
    Up,
    Down,
    UpDown,
}

#[derive(Debug, Clone, Copy)]
struct Timer {
    mode: Mode,
    /// The active period register.
    peak: u32,
    /// Ticks into the period when `since` was.
    position: u64,
    since: u64,
    /// Ticks a second; 0 when it stands.
    hertz: u64,
}

impl Timer {
    const STOPPED: Self = Self { mode: Mode::Frozen, peak: 0xFF, position: 0, since: 0, hertz: 0 };

    /// Ticks of a whole period.
    fn length(self) -> u64 {
        match self.mode {
            Mode::UpDown => 2 * u64::from(self.peak).max(1),
            _ => u64::from(self.peak) + 1,
        }
    }

    fn position(self, now: u64) -> u64 {
        (self.position + ticks_of(now.saturating_sub(self.since), self.hertz)) % self.length()
    }

    /// When the counter next stands at this position, after `now`.
    fn next(self, position: u64, now: u64) -> u64 {
        if self.hertz == 0 || self.mode == Mode::Frozen {
            return super::NEVER;
        }
        let length = self.length();
        let ahead = (position + length - self.position(now) - 1) % length + 1;
        // By the counter's own beat, so that nothing drifts.
        let ticks = ticks_of(now - self.since, self.hertz) + ahead;
        self.since + cycles_of(ticks, self.hertz)
    }
}

/// A register with a shadow.
#[derive(Debug, Clone, Copy, Default)]
struct Shadowed {
    active: u32,
    waiting: Option<(u32, u64)>,
}

impl Shadowed {
    fn settle(&mut self, now: u64) {
        if let Some((value, at)) = self.waiting
            && at <= now
        {
            self.active = value;
            self.waiting = None;
        }
    }
}

/// The block.
pub(crate) struct Mcpwm {
    pub(crate) values: Values,
    timers: [Timer; 3],
    /// When each timer is next at its zero, where that interrupts.
    zero_at: [u64; 3],
    raw: u32,
    /// Ticks of the fast loop so far, and when the last one was due.
    pub(crate) ticks: u64,
    pub(crate) last_tick: u64,
    stamps: [[Shadowed; 2]; 3],
    /// When each was last written.
    pub(crate) stamped: [[u64; 2]; 3],
    /// Writes to the last operator's second stamp: one at the end of each round of the fast loop.
    pub(crate) rounds: u64,
    /// When the last one was.
    pub(crate) last_round: u64,
    /// Whether a stamp was ever to be taken over elsewhere than at its counter's peak alone.
    pub(crate) is_taken_over_elsewhere: bool,
    /// Highest and lowest position, in cycles, is of no interest; the longest time between two rounds is.
    pub(crate) longest_gap: u64,
}

impl Mcpwm {
    pub(crate) fn new() -> Self {
        Self {
            values: Values::reset("MCPWM0"),
            timers: [Timer::STOPPED; 3],
            zero_at: [super::NEVER; 3],
            raw: 0,
            ticks: 0,
            last_tick: 0,
            stamps: [[Shadowed::default(); 2]; 3],
            stamped: [[0; 2]; 3],
            rounds: 0,
            last_round: 0,
            is_taken_over_elsewhere: false,
            longest_gap: 0,
        }
    }

    /// Goes on at the rate that clock (hertz, 0 without one) and prescalers now give.
    pub(crate) fn retime(&mut self, now: u64, clock_hz: u64) {
        let clock = clock_hz / u64::from(self.values.field(CLOCK_PRESCALER, 0, 8) + 1);
        for index in 0..3 {
            self.settle(index, now);
            let offset = TIMER + TIMER_STRIDE * index as u32;
            let timer = &mut self.timers[index];
            timer.position = timer.position(now);
            timer.since = now;
            timer.hertz = clock / u64::from(self.values.field(offset, 0, 8) + 1);
            if timer.mode == Mode::Frozen {
                timer.hertz = 0;
            }
        }
        self.aim(now);
        // What waits for an event of a counter waits for it at its new rate.
        for operator in 0..3 {
            for generator in 0..2 {
                if let Some((value, _)) = self.stamps[operator][generator].waiting {
                    self.stamp(operator, generator, value, now);
                }
            }
        }
    }

    fn aim(&mut self, now: u64) {
        let enabled = self.values.get(INTERRUPT_ENABLE);
        for (index, timer) in self.timers.iter().enumerate() {
            let is_enabled = enabled & ZERO[index] != 0;
            self.zero_at[index] = if is_enabled { timer.next(0, now) } else { super::NEVER };
        }
    }

    /// Returns when a timer next interrupts.
    pub(crate) fn next_event(&self) -> u64 {
        self.zero_at.into_iter().min().unwrap_or(super::NEVER)
    }

    /// Lets happen what is due.
    pub(crate) fn advance(&mut self, now: u64) {
        let timers = self.timers.iter().zip(&mut self.zero_at).zip(ZERO).enumerate();
        for (index, ((timer, zero_at), bit)) in timers {
            while *zero_at <= now {
                self.raw |= bit;
                if index == TICK {
                    self.ticks += 1;
                    self.last_tick = *zero_at;
                }
                *zero_at = timer.next(0, *zero_at);
            }
        }
    }

    /// Returns whether it interrupts.
    pub(crate) fn level(&self) -> bool {
        self.raw & self.values.get(INTERRUPT_ENABLE) != 0
    }

    /// Returns how long after the carrier's zero the last tick was, at most a PWM period; seconds.
    pub(crate) fn tick_phase(&self) -> f64 {
        let carrier = self.timers[CARRIER];
        let hertz = carrier.hertz.max(1);
        carrier.position(self.last_tick) as f64 / hertz as f64
    }

    fn settle(&mut self, _timer: usize, now: u64) {
        self.stamps.iter_mut().flatten().for_each(|stamp| stamp.settle(now));
    }

    fn timer_of(&self, operator: usize) -> Timer {
        let selected = self.values.field(TIMER_SELECTION, 2 * operator as u32, 2) as usize;
        self.timers.get(selected).copied().unwrap_or(Timer::STOPPED)
    }

    fn stamp(&mut self, operator: usize, generator: usize, value: u32, now: u64) {
        let offset = OPERATOR + OPERATOR_STRIDE * operator as u32 + operator::STAMP_METHOD;
        let method = self.values.field(offset, 4 * generator as u32, 4);
        self.is_taken_over_elsewhere |= method != AT_PEAK;
        let timer = self.timer_of(operator);
        let at_zero = (method & 1 != 0).then(|| timer.next(0, now));
        let at_peak = (method & 2 != 0).then(|| timer.next(u64::from(timer.peak), now));
        let stamp = &mut self.stamps[operator][generator];
        stamp.settle(now);
        match method {
            0 => *stamp = Shadowed { active: value, waiting: None },
            // Bit 3 stops updates; bit 2 waits for a synchronisation that never comes.
            _ => {
                let updates =
                    if method & 8 != 0 { None } else { at_zero.into_iter().chain(at_peak).min() };
                stamp.waiting = Some((value, updates.unwrap_or(super::NEVER)));
            }
        }
    }

    /// Returns what a generator does at `now`.
    pub(crate) fn wave(&mut self, operator: usize, is_b: bool, now: u64) -> Wave {
        self.settle(0, now);
        let timer = self.timer_of(operator);
        let offset = OPERATOR + OPERATOR_STRIDE * operator as u32;
        let register = if is_b { operator::ACTIONS_B } else { operator::ACTIONS_A };
        let actions = self.values.get(offset + register);
        let [a, b] = self.stamps[operator].map(|stamp| stamp.active);
        let force = self.values.field(offset + operator::FORCE, if is_b { 8 } else { 6 }, 2);
        if let 1 | 2 = force {
            return Wave::level(force == 2);
        }
        if timer.mode == Mode::Frozen && timer.position == 0 {
            // Never started.
            return Wave::level(false);
        }
        let walk = walk(timer, actions, a, b);
        if timer.hertz == 0 {
            // Stands where it stood.
            return Wave::level(walk.level_at(timer.position));
        }
        let length = timer.length();
        Wave { hertz: timer.hertz as f64 / length as f64, share: walk.high as f64 / length as f64 }
    }

    pub(crate) fn read(&mut self, offset: u32, now: u64) -> Answer<u32> {
        match (offset, timer_register(offset)) {
            (_, Some((timer, 0x0C))) => {
                let timer = self.timers[timer];
                let position = timer.position(now);
                let (peak, length) = (u64::from(timer.peak), timer.length());
                Ok(match timer.mode {
                    Mode::UpDown if position > peak => (length - position) as u32 | 1 << 16,
                    Mode::Down => (length - 1 - position) as u32 | 1 << 16,
                    _ => position as u32,
                })
            }
            (INTERRUPT_STATUS, _) => Ok(self.raw & self.values.get(INTERRUPT_ENABLE)),
            (INTERRUPT_ENABLE, _) => Ok(self.values.get(offset)),
            (0xE4..=0x108 | 0x114..=0x124, _) => Err(Unmodelled::Register),
            _ => Ok(self.values.get(offset)),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64, clock_hz: u64) -> Answer<()> {
        if let Some((timer, register)) = timer_register(offset) {
            return self.write_timer(timer, register, value, now, clock_hz);
        }
        if let Some((operator, register)) = operator_register(offset) {
            return self.write_operator(operator, register, value, now);
        }
        match offset {
            CLOCK_PRESCALER => {
                self.values.set(offset, value);
                self.retime(now, clock_hz);
            }
            TIMER_SELECTION | REGISTER_CLOCK => self.values.set(offset, value),
            INTERRUPT_ENABLE if value & !(ZERO[0] | ZERO[1] | ZERO[2]) == 0 => {
                self.values.set(offset, value);
                self.aim(now);
            }
            INTERRUPT_CLEAR => self.raw &= !value,
            UPDATE if value == self.values.get(offset) => {}
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }

    fn write_timer(
        &mut self,
        index: usize,
        register: u32,
        value: u32,
        now: u64,
        clock_hz: u64,
    ) -> Answer<()> {
        let base = TIMER + TIMER_STRIDE * index as u32;
        match register {
            0x00 => {
                if value >> 24 & 3 != 0 {
                    return Err(Unmodelled::Value("a period that is taken over later"));
                }
                self.retime(now, clock_hz);
                self.values.set(base, value);
                self.timers[index].peak = value >> 8 & 0xFFFF;
                self.timers[index].position %= self.timers[index].length();
            }
            0x04 => {
                self.retime(now, clock_hz);
                self.values.set(base + register, value);
                let mode = match value >> 3 & 3 {
                    0 => Mode::Frozen,
                    1 => Mode::Up,
                    2 => Mode::Down,
                    _ => Mode::UpDown,
                };
                // 2 starts; others start and stop at an event, which nothing here needs.
                let starts = value & 7;
                if mode != Mode::Frozen && starts != 2 {
                    return Err(Unmodelled::Value("a timer that stops by itself"));
                }
                self.timers[index].mode = mode;
            }
            // A phase to be taken at a synchronisation, which does not come.
            0x08 if value & 3 == 0 => self.values.set(base + register, value),
            _ => return Err(Unmodelled::Register),
        }
        self.retime(now, clock_hz);
        Ok(())
    }

    fn write_operator(&mut self, index: usize, register: u32, value: u32, now: u64) -> Answer<()> {
        let offset = OPERATOR + OPERATOR_STRIDE * index as u32 + register;
        match register {
            operator::STAMP_A => {
                self.stamped[index][0] = now;
                self.stamp(index, 0, value & 0xFFFF, now);
            }
            operator::STAMP_B => {
                self.stamped[index][1] = now;
                self.stamp(index, 1, value & 0xFFFF, now);
                if index == 2 {
                    self.count_round(now);
                }
            }
            operator::STAMP_METHOD | operator::FORCE => {}
            operator::ACTION_METHOD if value & 0xF != 0 => {
                return Err(Unmodelled::Value("actions that are taken over later"));
            }
            operator::ACTION_METHOD => {}
            operator::ACTIONS_A | operator::ACTIONS_B if value & 0xF0_0F00 != 0 => {
                return Err(Unmodelled::Value("actions on faults and synchronisation"));
            }
            operator::ACTIONS_A | operator::ACTIONS_B => {}
            _ if value == self.values.get(offset) => {}
            _ => return Err(Unmodelled::Register),
        }
        self.values.set(offset, value);
        Ok(())
    }

    fn count_round(&mut self, now: u64) {
        if self.rounds > 0 {
            self.longest_gap = self.longest_gap.max(now - self.last_round);
        }
        self.rounds += 1;
        self.last_round = now;
    }

    /// Whether a write to this register changes when or whether it interrupts.
    pub(crate) fn concerns_interrupts(offset: u32) -> bool {
        offset < TIMER_SELECTION || (INTERRUPT_ENABLE..=INTERRUPT_CLEAR).contains(&offset)
    }

    /// Periods a second of the timer that drives an operator.
    pub(crate) fn frequency(&self, operator: usize) -> f64 {
        let timer = self.timer_of(operator);
        timer.hertz as f64 / timer.length() as f64
    }

    /// Cycles since the last round of the fast loop.
    pub(crate) fn silence(&self, now: u64) -> u64 {
        now.saturating_sub(self.last_round).min(CYCLES_PER_SECOND)
    }
}

/// Where a generator's output is high within a period.
struct Walk {
    /// Ticks of a period for which it is high.
    high: u64,
    /// Positions and the level from there on, in order.
    levels: Vec<(u64, bool)>,
}

impl Walk {
    fn level_at(&self, position: u64) -> bool {
        let before = self.levels.iter().rev().find(|(at, _)| *at <= position);
        before.or(self.levels.last()).is_some_and(|(_, level)| *level)
    }
}

/// Actions of the events that a counter passes in a period, by their bits in the action register: zero, period, stamps A
/// and B while counting up; the same while counting down.
fn walk(timer: Timer, actions: u32, a: u32, b: u32) -> Walk {
    let peak = u64::from(timer.peak);
    let [a, b] = [a, b].map(u64::from);
    let length = timer.length();
    let mut events: Vec<(u64, u32)> = Vec::with_capacity(6);
    match timer.mode {
        Mode::UpDown => {
            // At zero it counts up, at the peak down.
            events.push((0, 0));
            events.push((peak, 14));
            for (stamp, up, down) in [(a, 4, 16), (b, 6, 18)] {
                if stamp < peak {
                    events.push((stamp, up));
                }
                if stamp > 0 && stamp <= peak {
                    events.push((length - stamp, down));
                }
            }
        }
        Mode::Up => {
            events.extend([(0, 0), (peak, 2)]);
            let stamps = [(a, 4), (b, 6)];
            events.extend(stamps.into_iter().filter(|(stamp, _)| *stamp <= peak));
        }
        Mode::Down => {
            events.extend([(peak, 12), (0, 14)]);
            for (stamp, action) in [(a, 16), (b, 18)] {
                if stamp <= peak {
                    events.push((peak - stamp, action));
                }
            }
        }
        Mode::Frozen => {}
    }
    // At one tick the stamps have the last word over zero and peak.
    events.sort_unstable_by_key(|(at, bits)| (*at, matches!(bits, 4 | 6 | 16 | 18)));
    let (mut level, mut high, mut levels) = (false, 0, Vec::with_capacity(6));
    // The first round finds the level that the second starts with.
    for _ in 0..2 {
        high = 0;
        levels.clear();
        let mut last = 0;
        for &(at, bits) in &events {
            if level {
                high += at - last;
            }
            last = at;
            match actions >> bits & 3 {
                1 => level = false,
                2 => level = true,
                3 => level = !level,
                _ => {}
            }
            levels.push((at, level));
        }
        if level {
            high += length - last;
        }
    }
    Walk { high, levels }
}

/// Timer and register within it.
fn timer_register(offset: u32) -> Option<(usize, u32)> {
    let within = offset.checked_sub(TIMER)?;
    (within < 3 * TIMER_STRIDE).then_some(((within / TIMER_STRIDE) as usize, within % TIMER_STRIDE))
}

/// Operator and register within it.
fn operator_register(offset: u32) -> Option<(usize, u32)> {
    let within = offset.checked_sub(OPERATOR)?;
    (within < 3 * OPERATOR_STRIDE)
        .then_some(((within / OPERATOR_STRIDE) as usize, within % OPERATOR_STRIDE))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK: u64 = 160_000_000;
    /// Low at the way up's stamp and at the peak, high at the way down's stamp.
    const ACTIVE_HIGH_A: u32 = 0x24014;

    /// 25 kHz, up and down, operator 0 takes its stamps over at the peak.
    fn running() -> Mcpwm {
        let mut pwm = Mcpwm::new();
        pwm.write(TIMER, 3_200 << 8, 0, CLOCK).unwrap();
        pwm.write(TIMER + 4, 3 << 3 | 2, 1, CLOCK).unwrap();
        pwm.write(OPERATOR, 0x22, 1, CLOCK).unwrap();
        pwm.write(OPERATOR + operator::ACTIONS_A, ACTIVE_HIGH_A, 1, CLOCK).unwrap();
        pwm
    }

    #[test]
    fn a_centred_pulse_has_the_frequency_and_share_of_its_registers() {
        let mut pwm = running();
        pwm.write(OPERATOR + operator::STAMP_A, 800, 10, CLOCK).unwrap();
        let wave = pwm.wave(0, false, 7_000);
        assert_eq!(wave, Wave { hertz: 25_000.0, share: 0.25 });
    }

    #[test]
    fn a_stamp_is_taken_over_at_the_peak_and_not_before() {
        let mut pwm = running();
        pwm.write(OPERATOR + operator::STAMP_A, 800, 10, CLOCK).unwrap();
        assert_eq!(pwm.wave(0, false, 3_200).share, 0.0);
        assert_eq!(pwm.wave(0, false, 3_202).share, 0.25);
    }

    #[test]
    fn a_stamp_of_zero_is_low_for_ever_and_one_of_the_whole_is_nearly_always_high() {
        let mut pwm = running();
        assert_eq!(pwm.wave(0, false, 20_000).share, 0.0);
        pwm.write(OPERATOR + operator::STAMP_A, 3_199, 20_000, CLOCK).unwrap();
        let share = pwm.wave(0, false, 40_000).share;
        assert!((share - 3_199.0 / 3_200.0).abs() < 1e-9, "{share}");
    }

    #[test]
    fn without_a_clock_the_outputs_stand() {
        let mut pwm = running();
        pwm.write(OPERATOR + operator::STAMP_A, 800, 10, CLOCK).unwrap();
        pwm.retime(10_000, 0);
        let wave = pwm.wave(0, false, 50_000);
        assert_eq!(wave.hertz, 0.0);
    }

    #[test]
    fn a_timers_zero_interrupts_until_it_is_acknowledged_and_stays_where_it_is_in_the_pwms_period()
    {
        let mut pwm = running();
        // Timer 1 counts up, two periods of timer 0 long, and starts 100 cycles later.
        pwm.write(TIMER + TIMER_STRIDE, 12_799 << 8, 101, CLOCK).unwrap();
        pwm.write(TIMER + TIMER_STRIDE + 4, 1 << 3 | 2, 101, CLOCK).unwrap();
        pwm.write(INTERRUPT_ENABLE, ZERO[TICK], 200, CLOCK).unwrap();
        for tick in 1..=3 {
            let due = 101 + 12_800 * tick;
            assert_eq!(pwm.next_event(), due);
            assert!(!pwm.level());
            pwm.advance(due);
            assert!(pwm.level());
            assert_eq!(pwm.tick_phase(), 100.0 / CLOCK as f64);
            pwm.write(INTERRUPT_CLEAR, ZERO[TICK], due + 50, CLOCK).unwrap();
        }
        assert_eq!((pwm.ticks, pwm.last_tick), (3, 101 + 3 * 12_800));
    }

    #[test]
    fn a_wrong_action_gives_a_wrong_share() {
        let mut pwm = running();
        // High at zero, low on the way up: what an edge-aligned pulse wants.
        pwm.write(OPERATOR + operator::ACTIONS_A, 2 | 1 << 4, 1, CLOCK).unwrap();
        pwm.write(OPERATOR + operator::STAMP_A, 800, 10, CLOCK).unwrap();
        assert_eq!(pwm.wave(0, false, 7_000).share, 0.125);
    }
}
