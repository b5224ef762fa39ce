//! A panic switches the bridges off, prints why, and restarts the robot.

use core::panic::PanicInfo;

use esp_println::println;

use crate::bridge::output;
use crate::choice::BOARD;
use crate::watchdog;

#[panic_handler]
fn on_panic(info: &PanicInfo) -> ! {
    critical_section::with(|_| {
        // Taken from the PWM, driven low: off where there is an enable, else braking.
        for bridge in &BOARD.bridges {
            for pin in bridge.enable.iter().chain(&bridge.phases) {
                core::mem::forget(output(*pin));
            }
        }
        println!("panic: {info}");
        println!("bridges off; starting anew");
        watchdog::restart_after_panic(info.location())
    })
}
