#![no_std]
#![no_main]
//! The robot on a chip: peripherals and tasks around `flix_firmware`, and nothing that decides.
//!
//! | who | where | how often |
//! |---|---|---|
//! | fast loop ([`fast`]) | an interrupt executor; core 1 of the ESP32 and S3, the C6's only core | 10 kHz |
//! | I2C encoders ([`encoders`]) | core 1's thread, below the fast loop | as fast as the bus |
//! | network, settings, lights | embassy tasks on core 0 | as needed |
//!
//! Fast loop and tasks exchange whole values through [`mailbox`]; neither waits for the other.
//! A panic, a brown-out and a fast loop that stops for 200 ms all end with the bridges let go.

#[cfg_attr(feature = "esp32", path = "../../board/esp32.rs")]
#[cfg_attr(feature = "esp32s3", path = "../../board/esp32s3.rs")]
#[cfg_attr(feature = "esp32c6", path = "../../board/esp32c6.rs")]
mod chip;

mod bridge;
mod choice;
mod encoders;
mod fast;
mod flash;
mod light;
mod mailbox;
mod network;
mod panic;

use embassy_executor::Spawner;
use esp_hal::clock::CpuClock;
use esp_hal::timer::timg::TimerGroup;
use esp_println::println;

use choice::BOARD;

esp_bootloader_esp_idf::esp_app_desc!();

/// What Wi-Fi may allocate. The driver takes some 50 KiB connected; the rest is for bursts.
const HEAP_BYTES: usize = 72 * 1024;

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    let peripherals = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    esp_alloc::heap_allocator!(size: HEAP_BYTES);
    chip::reset_on_brown_out();
    announce();

    let timers = TimerGroup::new(peripherals.TIMG0);
    esp_rtos::start(timers.timer0, peripherals.FROM_CPU_INTR0);
}

/// What a person at the serial port should know of this board before the motors move.
fn announce() {
    let hardware = &BOARD.hardware;
    println!("flix-walker {} on {}", env!("CARGO_PKG_VERSION"), hardware.name);
    println!("encoders: {:?}", BOARD.encoder);
    match hardware.current_sense {
        Some(_) => println!("motors: current control"),
        None => println!("motors: voltage mode, because this board measures no phase currents"),
    }
    if !hardware.can_coast {
        println!("motors: brake when let go, because this board's bridges cannot be switched off");
    }
    match hardware.bus_microvolts_per_count {
        Some(_) => println!("battery: measured"),
        None => println!("battery: NOT measured, because this board has no divider: watch it"),
    }
}
