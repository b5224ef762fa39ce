//! A panic switches the bridges off, notes and prints why, and restarts the robot.

use core::panic::PanicInfo;

use esp_println::println;

use crate::blackbox;
use crate::bridge::output;
use crate::choice::BOARD;

#[panic_handler]
fn on_panic(info: &PanicInfo) -> ! {
    critical_section::with(|_| {
        // Taken from the PWM, driven low: off where there is an enable, else braking.
        for bridge in &BOARD.bridges {
            for pin in bridge.enable.iter().chain(&bridge.phases) {
                core::mem::forget(output(*pin));
            }
        }
        blackbox::keep_panic(info);
        println!("panic: {info}");
        println!("bridges off; starting anew");
        esp_hal::system::software_reset()
    })
}
