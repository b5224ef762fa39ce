//! The watchdog of the low-power side: from the first line of `main` on it restarts a chip that hangs.
//!
//! The fast loop feeds a watchdog of its own, [`crate::fast`]. This one is fed by the tasks, and only while the fast loop
//! reports.

use core::cell::RefCell;
use core::sync::atomic::Ordering;

use critical_section::Mutex;
use esp_hal::peripherals::RTC_TIMER;
use esp_hal::rtc_cntl::{Rtc, RwdtStage, SocResetReason};
use esp_hal::time::Duration;
use portable_atomic::AtomicU32;

/// The chip starts anew when nobody has fed for so long. A sector takes up to 400 ms to erase (Winbond W25Q32JV, data
/// sheet revision G, table 9.6) and the slow clock may run a quarter fast: assumed, the data sheet states no figure.
const PATIENCE: Duration = Duration::from_millis(600);
/// What a panic leaves behind.
const PANICKED: u32 = 0x7061_6E69;

static WATCHDOG: Mutex<RefCell<Option<Rtc<'static>>>> = Mutex::new(RefCell::new(None));
/// Survives every restart but one after power was lost, which clears it.
#[esp_hal::ram(unstable(rtc_fast, persistent))]
static LAST_WORD: AtomicU32 = AtomicU32::new(0);

/// Starts the watchdog.
pub(crate) fn start(timer: RTC_TIMER<'static>) {
    let mut rtc = Rtc::new(timer);
    rtc.rwdt.set_timeout(RwdtStage::Stage0, PATIENCE);
    rtc.rwdt.enable();
    critical_section::with(|token| WATCHDOG.borrow_ref_mut(token).replace(rtc));
}

/// Feeds it.
pub(crate) fn feed() {
    critical_section::with(|token| {
        if let Some(rtc) = WATCHDOG.borrow_ref_mut(token).as_mut() {
            rtc.rwdt.feed();
        }
    });
}

/// Restarts the chip after a panic.
pub(crate) fn restart_after_panic() -> ! {
    LAST_WORD.store(PANICKED, Ordering::Relaxed);
    esp_hal::system::software_reset()
}

/// Returns why the chip started. Call once.
pub(crate) fn reason() -> &'static str {
    let panicked = LAST_WORD.load(Ordering::Relaxed) == PANICKED;
    LAST_WORD.store(0, Ordering::Relaxed);
    match esp_hal::system::reset_reason() {
        Some(SocResetReason::CoreSw) if panicked => "a panic",
        Some(SocResetReason::CoreSw) => "its own request",
        Some(SocResetReason::ChipPowerOn) => "power-on",
        Some(SocResetReason::CoreMwdt1) => "a fast loop that hung",
        Some(SocResetReason::CoreRtcWdt | SocResetReason::SysRtcWdt) => "tasks that hung",
        Some(SocResetReason::SysBrownOut) => "a brown-out",
        _ => "another reset",
    }
}
