//! The fast loop: the PWM's tick interrupts everything else for it, 10,000 times a second.

use core::cell::Cell;

use critical_section::Mutex;
use esp_hal::interrupt::Priority;
use esp_hal::peripherals::TIMG1;
use esp_hal::time::Duration;
use esp_hal::timer::timg::{MwdtStage, TimerGroup, Wdt};
use flix_firmware::hardware::Sensors;
use flix_firmware::robot::FastHalf;
use static_cell::StaticCell;

use crate::bridge;
use crate::chip::Electronics;
use crate::clock::now;
use crate::encoders::Encoders;
use crate::shared::Shared;

/// The chip starts anew when the loop has not run for so long.
const WATCHDOG: Duration = Duration::from_millis(200);
/// While flash is erased, during which no code runs from it: ten times what a sector may take.
const PATIENT_WATCHDOG: Duration = Duration::from_secs(4);

/// The loop between two rounds; nothing until it is started, and during a round.
static LOOP: Mutex<Cell<Option<&'static mut Fed>>> = Mutex::new(Cell::new(None));

/// What the loop works with.
pub(crate) struct Loop {
    /// What decides.
    pub(crate) half: FastHalf,
    /// What crosses to and from the tasks.
    pub(crate) exchange: &'static Shared,
    /// Bridges and converters.
    pub(crate) electronics: Electronics,
    /// Encoders.
    pub(crate) encoders: Encoders,
}

/// The loop, and the watchdog that it feeds.
struct Fed {
    work: Loop,
    watchdog: Wdt<TIMG1<'static>>,
}

/// Runs `work`, during which the loop may stand still, with a watchdog that waits for it.
pub(crate) fn with_patient_watchdog<R>(work: impl FnOnce() -> R) -> R {
    // The loop owns the driver, which has no state: both write the same registers.
    // To make it unlocks the registers, too.
    let mut watchdog = critical_section::with(|_| Wdt::<TIMG1<'static>>::new());
    let mut wait_for = |time| {
        // Each unlocks the registers and locks them again: one at a time.
        critical_section::with(|_| {
            watchdog.set_timeout(MwdtStage::Stage0, time);
            watchdog.feed();
        });
    };
    wait_for(PATIENT_WATCHDOG);
    let result = work();
    wait_for(WATCHDOG);
    result
}

/// Starts the loop on the core that calls, and its watchdog.
pub(crate) fn start(timers: TIMG1<'static>, work: Loop) {
    static FED: StaticCell<Fed> = StaticCell::new();
    let mut watchdog = TimerGroup::new(timers).wdt;
    watchdog.set_timeout(MwdtStage::Stage0, WATCHDOG);
    watchdog.enable();
    let fed = FED.init(Fed { work, watchdog });
    critical_section::with(|token| LOOP.borrow(token).set(Some(fed)));
    bridge::listen(on_tick);
}

/// Does a round. A tick that comes meanwhile waits for its end.
#[esp_hal::handler(priority = Priority::Priority3)]
fn on_tick() {
    bridge::acknowledge();
    let Some(fed) = critical_section::with(|token| LOOP.borrow(token).take()) else { return };
    fed.work.round();
    critical_section::with(|token| {
        fed.watchdog.feed();
        LOOP.borrow(token).set(Some(fed));
    });
}

impl Loop {
    /// Reads, decides, drives.
    fn round(&mut self) {
        let now = now();
        let sensors = Sensors {
            encoders: self.encoders.read(now),
            magnets: self.encoders.magnets(),
            phase_current: self.electronics.phase_current(),
            bus_voltage: self.electronics.bus_voltage(),
        };
        let actuation = self.half.tick(now, &sensors, &mut self.exchange);
        self.electronics.motors.apply(&actuation);
    }
}
