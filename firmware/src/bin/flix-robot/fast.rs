//! The fast loop: a timer interrupt wakes it 10,000 times a second, above everything else.

use core::cell::RefCell;

use critical_section::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use esp_hal::Blocking;
use esp_hal::interrupt::Priority;
use esp_hal::peripherals::{FROM_CPU_INTR2, TIMG1};
use esp_hal::time::Duration;
use esp_hal::timer::PeriodicTimer;
use esp_hal::timer::timg::{MwdtStage, TimerGroup, Wdt};
use esp_rtos::embassy::InterruptExecutor;
use flix_firmware::hardware::{Sensors, TICK_US};
use flix_firmware::robot::FastHalf;
use static_cell::StaticCell;

use crate::chip::Electronics;
use crate::clock::now;
use crate::encoders::Encoders;
use crate::shared::Shared;

/// The chip starts anew when the loop has not run for so long.
const WATCHDOG: Duration = Duration::from_millis(200);
/// While flash is erased, during which no code runs from it: ten times what a sector may take.
const PATIENT_WATCHDOG: Duration = Duration::from_secs(4);

/// The timer, for its interrupt to acknowledge.
static TIMER: Mutex<RefCell<Option<PeriodicTimer<'static, Blocking>>>> =
    Mutex::new(RefCell::new(None));
/// The timer's interrupt to the loop.
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
    let mut watchdog = Wdt::<TIMG1<'static>>::new();
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
    let group = TimerGroup::new(timers);
    let mut watchdog = group.wdt;
    watchdog.set_timeout(MwdtStage::Stage0, WATCHDOG);
    watchdog.enable();

    let executor = EXECUTOR.init(InterruptExecutor::new(software_interrupt));
    let spawner = executor.start(Priority::Priority3);
    if let Ok(task) = run(work, watchdog) {
        spawner.spawn(task);
    }

    let mut timer = PeriodicTimer::new(group.timer0);
    timer.set_interrupt_handler(on_timer);
    timer.listen();
    // Started only where its interrupt finds it.
    critical_section::with(|token| {
        let mut stored = TIMER.borrow_ref_mut(token);
        // A period that the timer cannot count would leave the loop asleep, and the watchdog bite.
        let _ = stored.insert(timer).start(Duration::from_micros(TICK_US.into()));
    });
}

#[esp_hal::handler(priority = Priority::Priority3)]
fn on_timer() {
    critical_section::with(|token| {
        if let Some(timer) = TIMER.borrow_ref_mut(token).as_mut() {
            timer.clear_interrupt();
        }
    });
    TICK.signal(());
}

#[embassy_executor::task]
async fn run(mut work: Loop, mut watchdog: Wdt<TIMG1<'static>>) {
    loop {
        TICK.wait().await;
        let now = now();
        let sensors = Sensors {
            encoders: work.encoders.read(now),
            phase_current: work.electronics.phase_current(),
            bus_voltage: work.electronics.bus_voltage(),
        };
        let actuation = work.half.tick(now, &sensors, &mut work.exchange);
        work.electronics.apply(&actuation);
        critical_section::with(|_| watchdog.feed());
    }
}
