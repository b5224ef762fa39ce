//! How much of the main stack and of the heap was never used: memory is painted at power-on, what the boot loader leaves
//! likewise, and the part of the heap that is not reclaimed from it starts as zeros.
//!
//! Of the heap this is what the program itself takes: the radio's closed library, which is not executed here, takes some
//! 50 KiB more.

use serde::Serialize;

use crate::chip::Chip;
use crate::soc::Outside;

/// A region of the heap is no smaller, bytes.
const LEAST_HEAP: u32 = 1_024;
/// Less must not be left, bytes.
const LEAST_LEFT: u32 = 4_096;

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
        }
    }

    /// Returns what does not hold, in a sentence.
    #[must_use]
    pub fn failure(&self) -> Option<String> {
        let left = self.stack_left;
        (left < LEAST_LEFT).then(|| format!("of the main stack only {left} bytes were never used"))
    }
}
