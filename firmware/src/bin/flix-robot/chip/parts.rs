//! The chip, shared out among those who need a part of it.

use esp_hal::gpio::AnyPin;
use esp_hal::peripherals::{FLASH, FROM_CPU_INTR0, RTC_TIMER, TIMG0, UART0, WIFI};

use crate::pins;

/// The chip's parts. What the fast loop needs differs from chip to chip.
pub(crate) struct Parts<Fast> {
    /// For the scheduler.
    pub(crate) scheduler: (TIMG0<'static>, FROM_CPU_INTR0<'static>),
    /// For the watchdog of the tasks.
    pub(crate) low_power: RTC_TIMER<'static>,
    /// For the settings.
    pub(crate) flash: FLASH<'static>,
    /// For the network.
    pub(crate) wifi: WIFI<'static>,
    /// For provisioning and the log, at the board's USB connector.
    pub(crate) serial: (UART0<'static>, pins::Serial),
    /// For the state.
    pub(crate) status_led: AnyPin<'static>,
    /// For the fast loop.
    pub(crate) fast: Fast,
}
