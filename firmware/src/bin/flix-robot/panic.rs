//! A panic switches the bridges off, prints why, and leaves the rest to the watchdog.

use core::panic::PanicInfo;

use esp_println::println;

use crate::bridge::output;
use crate::choice::BOARD;

#[panic_handler]
fn on_panic(info: &PanicInfo) -> ! {
    critical_section::with(|_| {
        // Taken from the PWM, driven low: off where there is an enable, else braking.
        for bridge in &BOARD.bridges {
            bridge
                .enable
                .iter()
                .chain(&bridge.phases)
                .copied()
                .map(output)
                .for_each(core::mem::forget);
        }
        println!("panic: {info}");
        println!("bridges off; the watchdog restarts the robot");
        loop {
            core::hint::spin_loop();
        }
    })
}
