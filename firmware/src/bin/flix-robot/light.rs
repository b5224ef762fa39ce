//! The status LED: one blink pattern a state, readable from across a room.

use embassy_time::Timer;
use esp_hal::gpio::Output;
use flix_protocol::message::State;

use crate::shared::Shared;

/// One step of a pattern.
const STEP_MILLISECONDS: u64 = 125;
/// Steps of a pattern: two seconds.
const STEPS: u32 = u16::BITS;

/// Returns the lit steps, the first one in the lowest bit.
const fn pattern(state: State, provisioned: bool) -> u16 {
    match state {
        // Two short flashes: no key yet.
        State::Disarmed if !provisioned => 0b0000_0000_0000_0101,
        // One short flash: ready, motors off.
        State::Disarmed => 0b0000_0000_0000_0001,
        // Fast: stand clear, the rotors are about to move.
        State::Aligning => 0b0101_0101_0101_0101,
        // Mostly on: armed.
        State::Armed => 0b0111_1111_0111_1111,
        State::Running => 0b1111_1111_1111_1111,
        State::Stopping => 0b0011_0011_0011_0011,
        // Long flashes: a fault.
        State::Faulted => 0b0000_1111_0000_1111,
    }
}

/// Blinks for ever.
#[embassy_executor::task]
pub(crate) async fn blink(mut led: Output<'static>, provisioned: bool, exchange: &'static Shared) {
    let mut step = 0;
    loop {
        led.set_level((pattern(exchange.state(), provisioned) >> step & 1 == 1).into());
        step = (step + 1) % STEPS;
        Timer::after_millis(STEP_MILLISECONDS).await;
    }
}
