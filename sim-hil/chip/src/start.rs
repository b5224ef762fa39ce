//! From the image's first instruction to the fast loop's first tick: both bridges off and the tasks' watchdog on before anything
//! that takes time (flash, radio, a chip that is refused), and no bridge's pin high or let go of after that.

use std::time::Duration;

use serde::Serialize;

use crate::pins::Robot;
use flix_esp32c6::CYCLES_PER_SECOND;
use flix_esp32c6::chip::Chip;
use flix_esp32c6::cycles;
use flix_esp32c6::early::Line;

/// All of it is done so soon after the image's first instruction: the HAL sets up the clocks in 1.4 ms, and flash and radio
/// come later.
const LATEST: Duration = Duration::from_millis(2);

/// What a pin of a bridge is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Its bridge is off while it is low.
    Enable,
    /// One of three that the PWM drives.
    Phase,
}

/// A pin of a bridge, and each time that it was driven otherwise than before: cycles from the image's first instruction on.
/// Until the first one nothing drove it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pin {
    role: Role,
    number: u32,
    lines: Vec<(u64, Line)>,
}

/// Cycles from the image's first instruction on; `None` for what did not happen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Start {
    pins: Vec<Pin>,
    flash: Option<u64>,
    radio: Option<u64>,
    tick: Option<u64>,
    watchdog: Option<u64>,
}

/// A step of the trace, in microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Step {
    /// When.
    pub us: f64,
    /// The pin.
    pub pin: u32,
    /// What it is for.
    pub role: Role,
    /// What drives it from then on.
    pub line: Line,
}

/// The same in microseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Until each bridge's enable is driven low.
    pub enables_low_us: Option<f64>,
    /// Until each phase is.
    pub phases_low_us: Option<f64>,
    /// Until the tasks' watchdog runs.
    pub watchdog_us: Option<f64>,
    /// Until flash is first read or written.
    pub flash_us: Option<f64>,
    /// Until the radio's library is first called; none on a robot without a network.
    pub radio_us: Option<f64>,
    /// Until the fast loop's first tick.
    pub tick_us: Option<f64>,
    /// Each change of a bridge's pin until then.
    pub trace: Vec<Step>,
}

fn us(cycles: u64) -> f64 {
    cycles as f64 * 1e6 / CYCLES_PER_SECOND as f64
}

impl Pin {
    /// Returns when it was driven low first.
    fn low(&self) -> Option<u64> {
        self.lines.iter().find(|(_, line)| *line == Line::Low).map(|(at, _)| *at)
    }

    /// Returns what it was driven by that it may not be before the first tick: anything but a low level, and of a phase the PWM.
    fn astray(&self) -> Option<(u64, Line)> {
        let low = self.low().unwrap_or(0);
        let is_phase = self.role == Role::Phase;
        let may = |(at, line): &(u64, Line)| match line {
            Line::Low => true,
            Line::Floats => *at < low,
            Line::Peripheral => is_phase && *at > low,
            Line::High => false,
        };
        self.lines.iter().copied().find(|line| !may(line))
    }
}

impl Start {
    /// Looks at how a chip started last.
    pub fn of(chip: &Chip<Robot>) -> Self {
        let pin = |role, number| Pin { role, number, lines: chip.early_lines(number).collect() };
        let bridges = Robot::bridge_pins();
        let enables = bridges.iter().filter_map(|(_, enable)| *enable);
        let phases = bridges.iter().flat_map(|(phases, _)| *phases);
        let [flash, radio, tick] = chip.early_uses();
        Self {
            pins: enables
                .map(|number| pin(Role::Enable, number))
                .chain(phases.map(|number| pin(Role::Phase, number)))
                .collect(),
            flash,
            radio,
            tick,
            watchdog: chip.counters().slow_watchdog_after_cycles,
        }
    }

    fn of_role(&self, role: Role) -> impl Iterator<Item = &Pin> {
        self.pins.iter().filter(move |pin| pin.role == role)
    }

    /// Returns when all pins of a role were low; `None` where one never was.
    fn low(&self, role: Role) -> Option<u64> {
        let low: Option<Vec<u64>> = self.of_role(role).map(Pin::low).collect();
        low?.into_iter().max()
    }

    /// Returns the figures.
    pub fn report(&self) -> Report {
        let steps = |pin: &Pin| {
            let Pin { role, number, .. } = *pin;
            let step = move |(at, line): &(u64, Line)| Step {
                us: us(*at),
                pin: number,
                role,
                line: *line,
            };
            pin.lines.iter().map(step).collect::<Vec<_>>()
        };
        let mut trace: Vec<Step> = self.pins.iter().flat_map(steps).collect();
        trace.sort_by(|a, b| a.us.total_cmp(&b.us));
        Report {
            enables_low_us: self.low(Role::Enable).map(us),
            phases_low_us: self.low(Role::Phase).map(us),
            watchdog_us: self.watchdog.map(us),
            flash_us: self.flash.map(us),
            radio_us: self.radio.map(us),
            tick_us: self.tick.map(us),
            trace,
        }
    }

    /// Returns what does not hold, in sentences.
    pub fn failures(&self) -> Vec<String> {
        let Report { enables_low_us, phases_low_us, watchdog_us, .. } = self.report();
        let [enables, phases] = [Role::Enable, Role::Phase].map(|role| self.low(role));
        let slow = [self.flash, self.radio].into_iter().flatten().min();
        let is_late = |after: Option<u64>| {
            after
                .is_none_or(|after| after > cycles(LATEST) || slow.is_some_and(|slow| after > slow))
        };
        let mut failures = Vec::new();
        if is_late(enables) || is_late(phases) {
            failures.push(format!(
                "after a start the bridges' pins float: enables are low after {enables_low_us:?} us, phases after \
                 {phases_low_us:?} us"
            ));
        } else if enables > phases {
            failures.push("after a start a phase is driven before the enables are low".to_owned());
        }
        for pin in &self.pins {
            if let Some((at, line)) = pin.astray() {
                let Pin { role, number, .. } = pin;
                failures.push(format!(
                    "before the first tick {role:?} {number} is {line:?} after {:.1} us",
                    us(at)
                ));
            }
        }
        if is_late(self.watchdog) {
            failures.push(format!("the tasks' watchdog starts after {watchdog_us:?} us"));
        }
        if self.tick.is_none() {
            failures.push("after a start the fast loop does not tick".to_owned());
        }
        failures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Enables after 1 and phases after 1.1 ms, flash after 2 and the first tick after 10 ms, with the PWM on the phase before.
    fn good() -> Start {
        let pin = |role, number, lines: &[(u64, Line)]| Pin { role, number, lines: lines.to_vec() };
        Start {
            pins: vec![
                pin(Role::Enable, 10, &[(160_000, Line::Low)]),
                pin(Role::Phase, 18, &[(176_000, Line::Low), (1_500_000, Line::Peripheral)]),
            ],
            flash: Some(320_000),
            radio: None,
            tick: Some(1_600_000),
            watchdog: Some(192_000),
        }
    }

    #[test]
    fn a_good_start_passes() {
        assert_eq!(good().failures(), [""; 0]);
        let Report { phases_low_us, flash_us, trace, .. } = good().report();
        assert_eq!((phases_low_us, flash_us), (Some(1_100.0), Some(2_000.0)));
        assert_eq!(trace.len(), 3);
    }

    #[test]
    fn what_is_late_never_done_or_done_in_another_order_is_told() {
        let late = cycles(LATEST) + 1;
        type Edit = fn(&mut Start, u64);
        let edits: [(Edit, &str); 16] = [
            (|start, late| start.pins[0].lines[0].0 = late, "pins float"),
            (|start, _| start.pins[0].lines.clear(), "pins float"),
            (|start, late| start.pins[1].lines[0].0 = late, "pins float"),
            (|start, _| start.pins[1].lines.clear(), "pins float"),
            (|start, _| start.flash = Some(100), "pins float"),
            (|start, _| start.radio = Some(170_000), "pins float"),
            (|start, _| start.pins[1].lines[0].0 = 1, "before the enables"),
            (|start, _| start.pins[0].lines.push((170_000, Line::High)), "Enable 10 is High"),
            (|start, _| start.pins[0].lines.push((170_000, Line::Floats)), "Enable 10 is Floats"),
            (|start, _| start.pins[0].lines.push((170_000, Line::Peripheral)), "Enable 10 is Peri"),
            (|start, _| start.pins[0].lines.insert(0, (9, Line::High)), "Enable 10 is High"),
            (|start, _| start.pins[1].lines.push((1_500_001, Line::Floats)), "Phase 18 is Floats"),
            (
                |start, _| start.pins[1].lines.insert(1, (1_499_999, Line::Floats)),
                "Phase 18 is Floats",
            ),
            (|start, late| start.watchdog = Some(late), "watchdog"),
            (|start, _| start.watchdog = None, "watchdog"),
            (|start, _| start.tick = None, "does not tick"),
        ];
        for (edit, words) in edits {
            let mut start = good();
            edit(&mut start, late);
            let failures = start.failures();
            assert!(
                failures.iter().any(|failure| failure.contains(words)),
                "{words}: {failures:?}"
            );
        }
    }
}
