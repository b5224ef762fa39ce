//! How much of the main stack and of the heap was never used: memory is painted at power-on, and the heap starts as zeros.
//!
//! Of the heap this is what the program itself takes: the radio's closed library, which is not executed here, takes some
//! 50 KiB more.

use serde::Serialize;

use crate::chip::Chip;
use crate::soc::Outside;

/// Less must not be left, bytes.
const LEAST_LEFT: u32 = 4_096;

/// Bytes of the main stack, which interrupts share, and of the heap, and how many of them nothing has ever written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Memory {
    /// All.
    pub stack: u32,
    /// Never written.
    pub stack_left: u32,
    /// The heap.
    pub heap: u32,
    /// Its longest part that has never been written.
    pub heap_left: u32,
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
        let heaps = image.find_all(|name| name.contains("4HEAP"));
        let (start, heap) = heaps.max_by_key(|(_, size)| *size).unwrap_or((0, 0));
        Self {
            stack: top.saturating_sub(bottom),
            stack_left: chip.untouched(bottom, top),
            heap,
            heap_left: chip.longest_zeros(start, heap),
        }
    }

    /// Returns what does not hold, in a sentence.
    #[must_use]
    pub fn failure(&self) -> Option<String> {
        let left = self.stack_left;
        (left < LEAST_LEFT).then(|| format!("of the main stack only {left} bytes were never used"))
    }
}
