//! What of flash the fast loop's tick executes and reads. Each access may miss the cache, and waits then for the flash, or for ever
//! where that is being written.

use crate::memory::{FLASH, FLASH_BYTES};

/// Halfwords that a word of the map stands for.
const BITS: usize = u64::BITS as usize;

/// From the tick's interrupt to the return from it.
#[derive(Default)]
pub(crate) struct Tick {
    /// Handlers that were entered since then and not left; none outside of a tick.
    depth: u32,
    /// Instructions and data of flash.
    pub(crate) accesses: u64,
    /// The halfwords that these were.
    touched: Vec<u64>,
}

impl Tick {
    /// Takes the interrupt that was just entered for the tick's.
    pub(crate) fn begin(&mut self) {
        self.depth = self.depth.max(1);
    }

    /// A handler is entered, in a tick or not.
    pub(super) fn enter(&mut self) {
        self.depth += u32::from(self.depth > 0);
    }

    /// A handler is left.
    pub(super) fn leave(&mut self) {
        self.depth = self.depth.saturating_sub(1);
    }

    /// The loop is over: what runs from here on, as after a panic in it or a reset, is none of a tick's.
    pub(crate) fn abandon(&mut self) {
        self.depth = 0;
    }

    /// Notes an access to flash, in a tick or not, by the number of its halfword.
    #[inline(always)]
    pub(super) fn access(&mut self, halfword: usize) {
        if self.depth > 0 {
            self.note(halfword);
        }
    }

    #[cold]
    fn note(&mut self, halfword: usize) {
        self.accesses += 1;
        self.touched.resize(FLASH_BYTES / 2 / BITS, 0);
        if let Some(word) = self.touched.get_mut(halfword / BITS) {
            *word |= 1 << (halfword % BITS);
        }
    }

    /// Returns the addresses of what was accessed, ascending.
    pub(crate) fn addresses(&self) -> impl Iterator<Item = u32> + '_ {
        let halfwords = (0..self.touched.len() * BITS)
            .filter(|halfword| self.touched[halfword / BITS] >> (halfword % BITS) & 1 == 1);
        halfwords.map(|halfword| FLASH + 2 * halfword as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accesses_count_from_the_ticks_interrupt_to_the_return_from_it() {
        let mut tick = Tick::default();
        let handlers: [fn(&mut Tick); 8] = [
            // Another interrupt, then the tick's with an exception in it, then another again.
            Tick::enter,
            Tick::leave,
            |tick| {
                tick.enter();
                tick.begin();
            },
            Tick::enter,
            Tick::leave,
            Tick::leave,
            Tick::enter,
            Tick::leave,
        ];
        for (step, handler) in handlers.into_iter().enumerate() {
            handler(&mut tick);
            tick.access(100 * step);
        }
        assert_eq!(tick.accesses, 3);
        assert!(tick.addresses().eq([200, 300, 400].map(|halfword| FLASH + 2 * halfword)));
    }
}
