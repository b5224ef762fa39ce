//! The chip's peripherals, one file each.

pub(crate) mod adc;
pub(crate) mod analog;
pub(crate) mod clock;
pub mod flash;
pub(crate) mod gpio;
pub(crate) mod held;
pub(crate) mod interrupt;
pub(crate) mod mcpwm;
pub(crate) mod spi;
pub(crate) mod system_timer;
pub(crate) mod timer_group;
pub(crate) mod uart;
pub(crate) mod watchdog;

use std::time::Duration;

/// Why a model does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unmodelled {
    /// Nobody has looked at what the register does.
    Register,
    /// The value asks for what is not modelled, or would not work.
    Value(&'static str),
}

/// What a model answers.
pub(crate) type Answer<T> = Result<T, Unmodelled>;

/// Cycles of the 160 MHz clock in a second: what all times are counted in.
pub const CYCLES_PER_SECOND: u64 = 160_000_000;

/// Cycles of that clock in a time.
#[must_use]
pub const fn cycles(time: Duration) -> u64 {
    (time.as_nanos() * 4 / 25) as u64
}

/// Never.
pub(crate) const NEVER: u64 = u64::MAX;

/// Cycles after which a clock of `hertz` has counted `ticks`, rounded up; [`NEVER`] for a clock that stands.
pub(crate) fn cycles_of(ticks: u64, hertz: u64) -> u64 {
    if hertz == 0 {
        return NEVER;
    }
    let cycles = (u128::from(ticks) * u128::from(CYCLES_PER_SECOND)).div_ceil(u128::from(hertz));
    u64::try_from(cycles).unwrap_or(NEVER)
}

/// Ticks that a clock of `hertz` counts in `cycles`.
pub(crate) fn ticks_of(cycles: u64, hertz: u64) -> u64 {
    (u128::from(cycles) * u128::from(hertz) / u128::from(CYCLES_PER_SECOND)) as u64
}
