//! A panic switches the bridges off, prints why, and stops. The watchdog then restarts the robot, once
//! the fast loop has started it; before, the robot stays off until its power goes.

use core::panic::PanicInfo;

use esp_println::println;

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
        println!("panic: {info}");
        println!("bridges off; the watchdog restarts a robot whose fast loop had begun");
        loop {
            core::hint::spin_loop();
        }
    })
}
