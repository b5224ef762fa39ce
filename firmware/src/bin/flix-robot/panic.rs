//! A panic switches the bridges off, notes and prints why, and restarts the robot.

use core::panic::PanicInfo;

use esp_println::println;

use crate::choice::BOARD;
use crate::pins::seize;
use crate::rtc_memory;

#[expect(unsafe_code, reason = "the bridges' pins belong to the fast loop")]
#[panic_handler]
fn on_panic(info: &PanicInfo) -> ! {
    critical_section::with(|_| {
        // Taken from the PWM, driven low: off where there is an enable, else braking.
        for bridge in &BOARD.bridges {
            for pin in bridge.enable.iter().chain(&bridge.phases) {
                // SAFETY: the chip starts anew before it leaves this critical section.
                unsafe { seize(*pin) };
            }
        }
        rtc_memory::keep_panic(info);
        println!("panic: {info}");
        println!("bridges off; starting anew");
        esp_hal::system::software_reset()
    })
}
