//! The watchdog of the low-power side: from the first line of `main` on it restarts a chip that hangs.
//!
//! The fast loop feeds a watchdog of its own, [`crate::fast`]. This one is fed by the tasks, and only while the fast loop
//! reports.

use core::cell::RefCell;
use core::panic::Location;
use core::sync::atomic::Ordering;

use critical_section::Mutex;
use esp_hal::peripherals::RTC_TIMER;
use esp_hal::rtc_cntl::{Rtc, RwdtStage, SocResetReason};
use esp_hal::time::Duration;
use flix_protocol::message::{NAME_LENGTH, Name, ResetReason};
use portable_atomic::{AtomicU8, AtomicU32};

/// The chip starts anew when nobody has fed for so long. A sector takes up to 400 ms to erase (Winbond W25Q32JV, data
/// sheet revision G, table 9.6) and the slow clock may run a quarter fast: assumed, the data sheet states no figure.
const PATIENCE: Duration = Duration::from_millis(600);
/// What a panic leaves behind.
const PANICKED: u32 = 0x7061_6E69;

static WATCHDOG: Mutex<RefCell<Option<Rtc<'static>>>> = Mutex::new(RefCell::new(None));
/// Survives every restart but one after power was lost, which clears it.
#[esp_hal::ram(unstable(rtc_fast, persistent))]
static LAST_WORD: AtomicU32 = AtomicU32::new(0);
/// The place of a panic, with zeros behind it. Survives likewise.
#[esp_hal::ram(unstable(rtc_fast, persistent))]
static PLACE: [AtomicU8; NAME_LENGTH] = [const { AtomicU8::new(0) }; NAME_LENGTH];

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

/// Restarts the chip after a panic at this place.
pub(crate) fn restart_after_panic(place: Option<&Location<'_>>) -> ! {
    let place = place.map(|place| ResetReason::panic(place.file(), place.line()));
    let bytes = match &place {
        Some(ResetReason::Panic(place)) => place.as_bytes(),
        _ => &[],
    };
    for (kept, byte) in PLACE.iter().zip(bytes.iter().copied().chain(core::iter::repeat(0))) {
        kept.store(byte, Ordering::Relaxed);
    }
    LAST_WORD.store(PANICKED, Ordering::Relaxed);
    esp_hal::system::software_reset()
}

/// Returns why the chip started. Call once.
pub(crate) fn reason() -> ResetReason {
    let panicked = LAST_WORD.load(Ordering::Relaxed) == PANICKED;
    LAST_WORD.store(0, Ordering::Relaxed);
    match esp_hal::system::reset_reason() {
        Some(SocResetReason::CoreSw) if panicked => ResetReason::Panic(place_of_panic()),
        Some(SocResetReason::CoreSw) => ResetReason::Requested,
        Some(SocResetReason::ChipPowerOn) => ResetReason::PowerOn,
        Some(SocResetReason::CoreMwdt1) => ResetReason::FastLoop,
        Some(SocResetReason::CoreRtcWdt | SocResetReason::SysRtcWdt) => ResetReason::Tasks,
        Some(SocResetReason::SysBrownOut) => ResetReason::BrownOut,
        _ => ResetReason::Other,
    }
}

fn place_of_panic() -> Name {
    let mut place = Name::new();
    for byte in PLACE.iter().map(|kept| kept.load(Ordering::Relaxed)).take_while(|it| *it != 0) {
        // As long as the name at most; what is no ASCII is left out.
        let _ = if byte.is_ascii() { place.push(byte.into()) } else { Ok(()) };
    }
    place
}
