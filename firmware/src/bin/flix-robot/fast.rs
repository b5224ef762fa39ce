//! The fast loop: the PWM's tick wakes it 10,000 times a second, above everything else.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use esp_hal::interrupt::Priority;
use esp_hal::peripherals::{FROM_CPU_INTR2, TIMG1};
use esp_hal::time::Duration;
use esp_hal::timer::timg::{MwdtStage, TimerGroup, Wdt};
use esp_rtos::embassy::InterruptExecutor;
use flix_firmware::hardware::Sensors;
use flix_firmware::robot::FastHalf;
use static_cell::StaticCell;

use crate::bridge;
use crate::chip::Electronics;
use crate::clock::now;
use crate::encoders::Encoders;
use crate::log::log;
use crate::shared::Shared;

/// The chip starts anew when the loop has not run for so long.
const WATCHDOG: Duration = Duration::from_millis(200);
/// While flash is erased, during which no code runs from it: ten times what a sector may take.
const PATIENT_WATCHDOG: Duration = Duration::from_secs(4);

/// The tick's interrupt to the loop.
static TICK: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static EXECUTOR: StaticCell<InterruptExecutor<2>> = StaticCell::new();

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
pub(crate) fn start(
    timers: TIMG1<'static>,
    software_interrupt: FROM_CPU_INTR2<'static>,
    work: Loop,
) {
    let mut watchdog = TimerGroup::new(timers).wdt;
    watchdog.set_timeout(MwdtStage::Stage0, WATCHDOG);
    watchdog.enable();

    let executor = EXECUTOR.init(InterruptExecutor::new(software_interrupt));
    let spawner = executor.start(Priority::Priority3);
    match run(work, watchdog) {
        Ok(task) => spawner.spawn(task),
        // The watchdog restarts the chip.
        Err(error) => log!("the fast loop does not start: {error:?}"),
    }

    bridge::listen(on_tick);
}

#[esp_hal::handler(priority = Priority::Priority3)]
fn on_tick() {
    bridge::acknowledge();
    TICK.signal(());
}

#[embassy_executor::task]
async fn run(mut work: Loop, mut watchdog: Wdt<TIMG1<'static>>) {
    loop {
        TICK.wait().await;
        let now = now();
        let sensors = Sensors {
            encoders: work.encoders.read(now),
            magnets: work.encoders.magnets(),
            phase_current: work.electronics.phase_current(),
            bus_voltage: work.electronics.bus_voltage(),
        };
        let actuation = work.half.tick(now, &sensors, &mut work.exchange);
        work.electronics.motors.apply(&actuation);
        critical_section::with(|_| watchdog.feed());
    }
}
