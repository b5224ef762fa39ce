//! How much of the main stack and of the heap was never used: memory is painted at power-on, what the boot loader leaves
//! likewise, and the part of the heap that is not reclaimed from it starts as zeros.
//!
//! Of the heap this is what the program itself takes: the radio's closed library, which is not executed here, takes some
//! 50 KiB more while it is connected, and so many frames as the image allows it on top of that.

use serde::Serialize;

use crate::chip::Chip;
use crate::soc::Outside;

/// A region of the heap is no smaller, bytes.
const LEAST_HEAP: u32 = 1_024;
/// Less must not be left, bytes.
const LEAST_LEFT: u32 = 4_096;

/// What the radio's library takes of the heap while it is connected, its static buffers by default included, bytes: as
/// the firmware assumes. Those are 10 (esp-radio 1.0.0-beta.1, `ControllerConfig`).
const RADIO: u64 = 50 * 1_024;
const STATIC_BUFFERS: u64 = 10;
/// A frame in a buffer of its own takes so many bytes (the same, "1.6KB").
const BUFFER: u64 = 1_600;

/// Bytes of the main stack, which interrupts share, and of the heap, and how many of them nothing has ever written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Memory {
    /// All.
    pub stack: u32,
    /// Never written.
    pub stack_left: u32,
    /// The heap, in all its regions.
    pub heap: u32,
    /// The longest part of each region that has never been written.
    pub heap_left: u32,
    /// What the radio's library may take of the heap with all buffers full; `None` without end, or before it starts.
    pub radio_at_most: Option<u64>,
}

/// Returns what the radio takes with so many buffers: received, static and dynamic, and to send, likewise.
fn radio_at_most(buffers: [u32; 4]) -> Option<u64> {
    let [_, received, _, sent] = buffers;
    let all: u64 = buffers.into_iter().map(u64::from).sum();
    // The two dynamic kinds are without end where they are 0.
    (received > 0 && sent > 0)
        .then(|| (RADIO + all * BUFFER).saturating_sub(STATIC_BUFFERS * BUFFER))
}

impl Memory {
    /// Looks at a chip.
    #[must_use]
    pub fn of<O: Outside>(chip: &Chip<O>) -> Self {
        let image = chip.image();
        let at = |wanted: &str| image.find(|name| name == wanted).map_or(0, |(at, _)| at);
        // Above the word that guards the end.
        let (bottom, top) = (at("__stack_chk_guard") + 4, at("_stack_start"));
        // Every item's name ends with a hash; the allocator's own table has the same name and few bytes.
        let is_heap = |(_, size): &(u32, u32)| *size >= LEAST_HEAP;
        let heaps: Vec<_> = image.find_all(|name| name.contains("4HEAP")).filter(is_heap).collect();
        Self {
            stack: top.saturating_sub(bottom),
            stack_left: chip.untouched(bottom, top),
            heap: heaps.iter().map(|(_, size)| size).sum(),
            heap_left: heaps
                .iter()
                .map(|(start, size)| chip.longest_untouched(*start, *size))
                .sum(),
            radio_at_most: chip.counters().radio_buffers.and_then(radio_at_most),
        }
    }

    /// Returns what does not hold, in sentences.
    #[must_use]
    pub fn failures(&self) -> Vec<String> {
        let Self { stack_left, heap, radio_at_most, .. } = *self;
        let mut failures = Vec::new();
        if stack_left < LEAST_LEFT {
            failures.push(format!("of the main stack only {stack_left} bytes were never used"));
        }
        if radio_at_most.is_none_or(|bytes| bytes > heap.into()) {
            failures.push(format!(
                "the radio's buffers may take more than the heap: {radio_at_most:?} of {heap} bytes"
            ));
        }
        failures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Memory = Memory {
        stack: 200_000,
        stack_left: LEAST_LEFT,
        heap: 80 * 1_024,
        heap_left: 0,
        radio_at_most: Some(80 * 1_024),
    };

    #[test]
    fn what_just_fits_passes_and_a_byte_more_is_told() {
        assert_eq!(GOOD.failures(), [""; 0]);
        for (memory, words) in [
            (Memory { stack_left: LEAST_LEFT - 1, ..GOOD }, "stack"),
            (Memory { radio_at_most: Some(u64::from(GOOD.heap) + 1), ..GOOD }, "radio"),
            (Memory { radio_at_most: None, ..GOOD }, "radio"),
        ] {
            let failures = memory.failures();
            assert!(matches!(&failures[..], [one] if one.contains(words)), "{failures:?}");
        }
    }

    #[test]
    fn buffers_of_eight_each_fit_and_those_of_the_driver_do_not() {
        // 50 KiB, two static buffers less, sixteen frames more.
        assert_eq!(radio_at_most([8, 8, 0, 8]), Some(51_200 + 14 * 1_600));
        assert!(radio_at_most([10, 32, 0, 32]).is_some_and(|bytes| bytes > 80 * 1_024));
        assert_eq!(radio_at_most([8, 0, 0, 8]), None);
        assert_eq!(radio_at_most([8, 8, 0, 0]), None);
    }
}
