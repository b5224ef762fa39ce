#![no_std]
#![no_main]
//! The fast tick and nothing else, for `cargo xtask panic-free`: linked with all that it can reach.
//! Were a panic among that, the handler below would be linked too, and found by its name.

use flix_firmware::fast::exchange::Exchange;
use flix_firmware::hardware::{Actuation, Sensors};
use flix_firmware::robot::FastHalf;
use flix_protocol::units::Instant;

/// The entry: the linker keeps what it reaches and drops the rest.
#[expect(unsafe_code, reason = "the linker needs the name")]
#[unsafe(no_mangle)]
pub extern "C" fn fast_tick(
    half: &mut FastHalf,
    microseconds: u64,
    sensors: &Sensors,
    exchange: &mut Exchange,
    actuation: &mut Actuation,
) {
    *actuation = half.tick(Instant::from_micros(microseconds), sensors, exchange);
}

#[panic_handler]
fn on_panic(_: &core::panic::PanicInfo) -> ! {
    flix_panic_is_reachable()
}

#[expect(unsafe_code, reason = "found by its name")]
#[unsafe(no_mangle)]
extern "C" fn flix_panic_is_reachable() -> ! {
    loop {
        core::hint::spin_loop();
    }
}
