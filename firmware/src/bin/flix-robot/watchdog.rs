//! The watchdog of the low-power side: from the first line of `main` on it restarts a chip that hangs.
//!
//! The fast loop feeds a watchdog of its own, [`crate::fast`]. This one is fed by the tasks, and only while the fast loop
//! reports. It is patient while the radio's library may keep the processor from all tasks: when the radio starts, and while it
//! connects, which it does only with motors that are not driven ([`Window`]).

use core::cell::RefCell;

use critical_section::Mutex;
use esp_hal::peripherals::RTC_TIMER;
use esp_hal::rtc_cntl::{Rtc, RwdtStage, SocResetReason};
use esp_hal::time::{Duration, Instant};
use flix_firmware::blackbox::Kept;
use flix_firmware::joining;
use flix_protocol::message::ResetReason;

/// The chip starts anew when nobody has fed for so long. A sector takes up to 400 ms to erase (Winbond W25Q32JV, data
/// sheet revision G, table 9.6) and the slow clock may run a quarter fast: assumed, the data sheet states no figure.
const PATIENCE: Duration = Duration::from_millis(600);
/// The same while the radio starts or connects. Its library was seen to derive a key for 0.7 s at the least, and it derives,
/// calibrates and authenticates in one go at worst: 2 s, and as much again.
const CONNECTING_PATIENCE: Duration = Duration::from_secs(4);
/// For so long at most after it was opened.
const WINDOW: Duration = Duration::from_millis(joining::WINDOW.as_millis() as u64);

static WATCHDOG: Mutex<RefCell<Option<Watchdog>>> = Mutex::new(RefCell::new(None));

struct Watchdog {
    rtc: Rtc<'static>,
    /// When it is impatient again.
    patient_until: Option<Instant>,
}

impl Watchdog {
    fn wait_for(&mut self, patience: Duration) {
        // Fed first: it may have waited for longer already than it is to wait from now on.
        self.rtc.rwdt.feed();
        self.rtc.rwdt.set_timeout(RwdtStage::Stage0, patience);
    }

    fn close_window(&mut self) {
        if self.patient_until.take().is_some() {
            self.wait_for(PATIENCE);
        }
    }
}

fn with(work: impl FnOnce(&mut Watchdog)) {
    critical_section::with(|token| WATCHDOG.borrow_ref_mut(token).as_mut().map(work));
}

/// Starts the watchdog.
pub(crate) fn start(timer: RTC_TIMER<'static>) {
    let mut rtc = Rtc::new(timer);
    rtc.rwdt.set_timeout(RwdtStage::Stage0, PATIENCE);
    rtc.rwdt.enable();
    let watchdog = Watchdog { rtc, patient_until: None };
    critical_section::with(|token| WATCHDOG.borrow_ref_mut(token).replace(watchdog));
}

/// Feeds it, and ends its patience when that has lasted long enough.
pub(crate) fn feed() {
    with(|watchdog| {
        if watchdog.patient_until.is_some_and(|end| Instant::now() >= end) {
            watchdog.close_window();
        }
        watchdog.rtc.rwdt.feed();
    });
}

/// Ends its patience at once.
pub(crate) fn close_window() {
    with(Watchdog::close_window);
}

/// A time in which the radio's library may keep the processor. It ends when this is dropped, when the motors are driven, and
/// by itself.
pub(crate) struct Window(());

impl Window {
    /// Makes the watchdog patient.
    pub(crate) fn open() -> Self {
        with(|watchdog| {
            watchdog.patient_until = Some(Instant::now() + WINDOW);
            watchdog.wait_for(CONNECTING_PATIENCE);
        });
        Self(())
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        close_window();
    }
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
