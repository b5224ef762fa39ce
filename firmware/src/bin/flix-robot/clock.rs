//! The clock that fast loop, encoders and link share.

use flix_protocol::units::Instant;

/// Returns the time since the chip started, in microseconds.
pub(crate) fn now() -> Instant {
    Instant::from_micros(esp_hal::time::Instant::now().duration_since_epoch().as_micros())
}
