//! The black box, in memory that a restart leaves alone.

use core::hint::black_box;
use core::ops::Range;
use core::panic::PanicInfo;
use core::sync::atomic::Ordering;

use flix_firmware::blackbox::{BYTES, Kept, PANIC, Panic, RUN, RUN_BYTES, beginning};
use flix_protocol::message::BuildId;
use portable_atomic::AtomicU8;

use crate::chip;
use crate::clock::now;

/// Survives every restart but one after power was lost, which clears it. On the ESP32 it is slow memory: core 1, which may
/// panic too, does not reach the fast one. The C6 has no slow one.
#[cfg_attr(feature = "esp32", esp_hal::ram(unstable(rtc_slow, persistent)))]
#[cfg_attr(not(feature = "esp32"), esp_hal::ram(unstable(rtc_fast, persistent)))]
static KEPT: [AtomicU8; BYTES] = [const { AtomicU8::new(0) }; BYTES];

/// Returns what the run before left, and begins anew. Call once, at the start.
pub(crate) fn take() -> Kept {
    let mut bytes = [0; BYTES];
    for (byte, kept) in bytes.iter_mut().zip(&KEPT) {
        // Two steps: this memory may know no others.
        *byte = kept.load(Ordering::Relaxed);
        kept.store(0, Ordering::Relaxed);
    }
    keep_run(&beginning(build()));
    Kept::decode(&bytes)
}

/// Leaves for the next run how this one is.
pub(crate) fn keep_run(bytes: &[u8; RUN_BYTES]) {
    keep(RUN, bytes);
}

/// Leaves for the next run that this one panics.
pub(crate) fn keep_panic(info: &PanicInfo<'_>) {
    let panic = Panic::new(now(), info.location(), info.message(), chip::calls());
    keep(PANIC, &panic.encode());
}

fn keep(place: Range<usize>, bytes: &[u8]) {
    for (kept, byte) in KEPT.iter().skip(place.start).zip(bytes) {
        kept.store(*byte, Ordering::Relaxed);
    }
}

/// Returns which build runs; `None` where whoever made the image left its descriptor without.
pub(crate) fn build() -> Option<BuildId> {
    // The compiler knows the zeros that the image maker fills in afterwards.
    BuildId::of(black_box(&crate::ESP_APP_DESC).app_elf_sha256())
}
