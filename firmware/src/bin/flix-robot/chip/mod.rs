//! The chip that the features choose: its parts, and what reads and drives them.

#[cfg(not(feature = "esp32c6"))]
mod dual_core;
#[cfg(feature = "esp32")]
mod esp32;
#[cfg(feature = "esp32c6")]
mod esp32c6;
#[cfg(feature = "esp32s3")]
mod esp32s3;
mod parts;

#[cfg(feature = "esp32")]
use esp32 as chosen;
#[cfg(feature = "esp32c6")]
use esp32c6 as chosen;
#[cfg(feature = "esp32s3")]
use esp32s3 as chosen;

pub(crate) use chosen::{
    Electronics, enable_interrupts, reset_on_brown_out, share_out, share_with_other_core,
    start_fast_loop,
};
pub(crate) use parts::SerialParts;
