#![no_std]
#![no_main]
//! The robot on a chip: peripherals and tasks around `flix_firmware`, and nothing that decides.
//!
//! | who | where | how often |
//! |---|---|---|
//! | fast loop ([`fast`]) | an interrupt; core 1 of the ESP32 and S3, the C6's only core | 10 kHz |
//! | I2C encoders ([`encoders`]) | core 1's thread, below the fast loop | as fast as the bus |
//! | network, settings, lights | embassy tasks on core 0 | as needed |
//!
//! Fast loop and tasks exchange whole values through the library's `exchange`, [`shared`];
//! neither waits for the other.
//! A panic, a brown-out, a fast loop that stops for 200 ms and tasks that hang for 600 ms, or 4 s while the radio connects with
//! motors that are not driven, all end with the bridges off and a restart.

mod bridge;
mod chip;
mod choice;
mod clock;
mod encoders;
mod fast;
mod flash;
mod light;
mod log;
mod network;
mod panic;
mod pins;
mod rtc_memory;
mod serial;
mod shared;
mod slow;
mod watchdog;

use core::cell::RefCell;

use embassy_executor::{SpawnError, SpawnToken, Spawner};
use embassy_net::StackResources;
use embassy_time::Timer;
use esp_hal::clock::CpuClock;
use esp_hal::efuse::{InterfaceMacAddress, interface_mac_address};
use esp_hal::rng::{Rng, Trng};
use esp_hal::timer::timg::TimerGroup;
use esp_radio::wifi::{Interface, WifiController};
use esp_storage::FlashStorage;
use flix_firmware::board::store::{Entry, FlashStore};
use flix_firmware::fast::exchange::Exchange;
use flix_firmware::neighbours::{Guard, Guarded};
use flix_firmware::net;
use flix_firmware::provision::Provisioner;
use flix_firmware::robot::{UNPROVISIONED, halves};
use flix_firmware::scope::Memory;
use flix_protocol::message::{ResetReason, SCOPE_VALUES};
use flix_protocol::provision::Provisioning;
use flix_protocol::session::Operators;
use static_cell::{ConstStaticCell, StaticCell};

use choice::BOARD;
use fast::Loop;
use flash::Flash;
use log::log;
use shared::Shared;

esp_bootloader_esp_idf::esp_app_desc!();

/// What Wi-Fi may allocate: memory that the boot loader no longer needs, as much as every chip has of it, and some more.
/// The driver takes some 50 KiB connected; the rest is for bursts.
const RECLAIMED_HEAP_BYTES: usize = 64 * 1024;
/// See [`RECLAIMED_HEAP_BYTES`].
const MORE_HEAP_BYTES: usize = 14 * 1024;
/// From one line to the next of a chip that is refused: the watchdog waits for 600.
const REFUSAL_MILLISECONDS: u64 = 300;
/// Sockets: the network task's, and DHCP's.
const SOCKETS: usize = net::SOCKETS + 1;

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    static STORE: StaticCell<RefCell<FlashStore<Flash>>> = StaticCell::new();
    static EXCHANGE: StaticCell<Shared> = StaticCell::new();
    static SCOPE: ConstStaticCell<Memory> = ConstStaticCell::new([0; SCOPE_VALUES]);
    static PROVISIONING: StaticCell<Provisioning> = StaticCell::new();

    let clocks = esp_hal::Config::default().with_cpu_clock(CpuClock::max());
    let parts = chip::share_out(esp_hal::init(clocks));
    watchdog::start(parts.low_power);
    chip::enable_interrupts();
    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: RECLAIMED_HEAP_BYTES);
    esp_alloc::heap_allocator!(size: MORE_HEAP_BYTES);
    chip::reset_on_brown_out();
    let kept = rtc_memory::take();
    let reset = watchdog::reason(&kept);
    announce(&reset);

    let (timers, software_interrupt) = parts.scheduler;
    esp_rtos::start(TimerGroup::new(timers).timer0, software_interrupt);
    if let Some(why) = chip::unsuitable() {
        refuse(spawner, parts.serial, why).await;
    }

    let mut flash = Flash::new(FlashStorage::new(parts.flash));
    // Without a table the store has no room: settings then stay at their defaults, with a fault.
    let region = flash.region().unwrap_or(0..0);
    let store = &*STORE.init(RefCell::new(FlashStore::new(flash, region)));
    let entry = Entry::new(store, flash::PROVISIONING);
    let address = interface_mac_address(InterfaceMacAddress::Station);
    let address = address.as_bytes().try_into().unwrap_or_default();
    let mut provisioner = Provisioner::new(entry, BOARD.hardware, address);
    provisioner.set_reset(reset.clone());
    if let Err(error) = provisioner.loaded() {
        log!("provisioning: {error}: provision the robot again");
    }
    let provisioning = provisioner.provisioning().cloned().map(|found| &*PROVISIONING.init(found));

    let radio = provisioning.and_then(|_| network::start(parts.wifi));
    // Random numbers are only random while the radio runs. Without them the robot has no key, and so
    // no session.
    let entropy = secret();
    if provisioning.is_some() && entropy.is_none() {
        log!("robot: no random numbers, so it takes no operator");
    }
    let operators = provisioner.operators();
    let operators = if entropy.is_some() { operators } else { Operators::default() };
    let (half, slow, report) = halves(
        BOARD.hardware,
        provisioner.name(),
        operators,
        entropy.unwrap_or_default(),
        Entry::new(store, flash::SETTINGS),
    );
    let exchange = &*EXCHANGE.init(Shared::new(Exchange::new(report, SCOPE.take())));
    chip::start_fast_loop(parts.fast, |electronics, encoders, timers| {
        fast::start(timers, Loop { half, exchange, electronics, encoders });
    });
    // After the loop: it owns the watchdog, which has to wait. Nobody can arm the robot yet.
    if provisioner.finish_erasure().is_err() {
        log!("provisioning: a former key may still be in flash");
    }
    let light = light::blink(pins::low(parts.status_led), provisioning.is_some(), exchange);
    spawn(spawner, "the light", light);
    // Without the port there is nobody to say it to.
    if let Some((receiver, transmitter)) = serial::port(parts.serial) {
        spawn(spawner, "the log", log::drain(transmitter));
        spawn(spawner, "provisioning", serial::serve(receiver, provisioner, exchange));
    }
    let robot = slow::SlowTask::new(slow, reset, kept, exchange);
    match (provisioning, radio) {
        (Some(provisioning), Some(radio)) => operate(spawner, robot, provisioning, radio).await,
        (Some(_), None) => {
            spawn(spawner, "the radio", network::start_late(exchange));
            robot.run_alone().await
        }
        (None, _) => {
            log!("{UNPROVISIONED}");
            spawn(spawner, "the radio", network::only_listen(exchange));
            robot.run_alone().await
        }
    }
}

/// Starts a task; says so where it cannot, as when it runs already.
fn spawn<S>(spawner: Spawner, name: &str, task: Result<SpawnToken<S>, SpawnError>) {
    match task {
        Ok(task) => spawner.spawn(task),
        Err(error) => log!("{name} does not start: {error:?}"),
    }
}

/// Says for ever why this chip drives no motors.
async fn refuse(spawner: Spawner, port: serial::Parts, why: &str) -> ! {
    if let Some((_, transmitter)) = serial::port(port) {
        spawn(spawner, "the log", log::drain(transmitter));
    }
    loop {
        log!("robot: {why}");
        watchdog::feed();
        Timer::after_millis(REFUSAL_MILLISECONDS).await;
    }
}

/// A secret from the chip's true random number generator; `None` while its source of noise, the
/// radio, is off.
fn secret() -> Option<[u8; 32]> {
    let mut secret = [0; 32];
    Trng::try_new().ok()?.read(&mut secret);
    Some(secret)
}

/// Serves operators on the network for ever.
async fn operate(
    spawner: Spawner,
    mut robot: slow::SlowTask<Entry<'static, Flash>>,
    provisioning: &'static Provisioning,
    radio: WifiController<'static>,
) -> ! {
    static RESOURCES: StaticCell<StackResources<SOCKETS>> = StaticCell::new();
    static GUARD: StaticCell<Guard> = StaticCell::new();
    let guard: &Guard = GUARD.init(Guard::default());
    let seed = u64::from(Rng::new().random()) << 32 | u64::from(Rng::new().random());
    let (stack, runner) = embassy_net::new(
        Guarded::new(Interface::station(), guard),
        network::addresses(provisioning),
        RESOURCES.init(StackResources::new()),
        seed,
    );
    spawn(spawner, "the network", network::run_stack(runner));
    let connected = network::stay_connected(radio, stack, guard, provisioning, robot.shared());
    spawn(spawner, "the radio", connected);
    net::serve(stack, guard, provisioning.name(), &mut robot).await
}

/// Prints what a person at the serial port should know of this board before the motors move.
fn announce(reset: &ResetReason) {
    let hardware = &BOARD.hardware;
    log!("flix-walker {} on {}", env!("CARGO_PKG_VERSION"), hardware.name);
    log!("started after {reset}");
    log!("encoders: {:?}", BOARD.encoder);
    match hardware.current_sense {
        Some(_) => log!("motors: current control"),
        None => log!("motors: voltage mode, because this board measures no phase currents"),
    }
    if !hardware.can_coast {
        log!("motors: brake when off, because this board's bridges have no off input");
    }
    match hardware.bus_microvolts_per_count {
        Some(_) => log!("battery: measured"),
        None => log!("battery: NOT measured, because this board has no divider: watch it"),
    }
}
