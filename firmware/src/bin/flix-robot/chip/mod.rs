//! The chip that the features choose: its parts, and what reads and drives them.

#[cfg(any(feature = "esp32", feature = "esp32s3"))]
mod dual_core;
#[cfg(feature = "esp32")]
mod esp32;
#[cfg(feature = "esp32c6")]
mod esp32c6;
#[cfg(feature = "esp32s3")]
mod esp32s3;
mod parts;

#[cfg(any(feature = "esp32", feature = "esp32s3"))]
use dual_core as cores;
#[cfg(feature = "esp32")]
use esp32 as chosen;
#[cfg(feature = "esp32s3")]
use esp32s3 as chosen;
#[cfg(feature = "esp32c6")]
use {esp32c6 as chosen, esp32c6 as cores};

pub(crate) use chosen::{reset_on_brown_out, unsuitable};
pub(crate) use cores::{
    Electronics, calls, enable_interrupts, parking, share_out, share_with_other_core,
    start_fast_loop, unused_stack,
};
