//! The watchdog of the low-power side: from the first line of `main` on it restarts a chip that hangs.
//!
//! The fast loop feeds a watchdog of its own, [`crate::fast`]. This one is fed by the tasks, and only while the fast loop
//! reports.

use core::cell::RefCell;

use critical_section::Mutex;
use esp_hal::peripherals::RTC_TIMER;
use esp_hal::rtc_cntl::{Rtc, RwdtStage, SocResetReason};
use esp_hal::time::Duration;
use flix_firmware::blackbox::Kept;
use flix_protocol::message::ResetReason;

/// The chip starts anew when nobody has fed for so long. A sector takes up to 400 ms to erase (Winbond W25Q32JV, data
/// sheet revision G, table 9.6) and the slow clock may run a quarter fast: assumed, the data sheet states no figure.
const PATIENCE: Duration = Duration::from_millis(600);

static WATCHDOG: Mutex<RefCell<Option<Rtc<'static>>>> = Mutex::new(RefCell::new(None));

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

/// Returns why the chip started, given what the run before left.
pub(crate) fn reason(kept: &Kept) -> ResetReason {
    match esp_hal::system::reset_reason() {
        Some(SocResetReason::CoreSw) => kept.reset_by_software(),
        Some(SocResetReason::ChipPowerOn) => ResetReason::PowerOn,
        Some(SocResetReason::CoreMwdt1) => ResetReason::FastLoop,
        Some(SocResetReason::CoreRtcWdt | SocResetReason::SysRtcWdt) => ResetReason::Tasks,
        Some(SocResetReason::SysBrownOut) => ResetReason::BrownOut,
        _ => ResetReason::Other,
    }
}
