//! What misses of the cache in front of the flash take: nothing, unless a run asks for it.

/// Bytes of a line, lines of a set, and sets: 16 KiB, which is on the small side of what Espressif's chips with this core have.
/// Of a set the line that was used longest ago is replaced: assumed.
const LINE_BITS: u32 = 5;
const WAYS: usize = 4;
const SETS: usize = 128;

/// The cache; a line that is not there has a number that no address has.
pub(crate) struct Cache {
    sets: [[u32; WAYS]; SETS],
    /// Cycles of a miss.
    pub(crate) miss: u64,
}

impl Cache {
    /// Creates an empty cache whose misses take so many cycles.
    pub(crate) const fn new(miss: u64) -> Self {
        Self { sets: [[u32::MAX; WAYS]; SETS], miss }
    }

    /// Reads a halfword of flash by its number; returns the cycles that this takes.
    #[inline(always)]
    pub(crate) fn read(&mut self, halfword: usize) -> u64 {
        if self.miss == 0 { 0 } else { self.look(halfword as u32 >> (LINE_BITS - 1)) }
    }

    #[cold]
    fn look(&mut self, line: u32) -> u64 {
        let set = &mut self.sets[line as usize % SETS];
        let found = set.iter().position(|known| *known == line);
        set[..=found.unwrap_or(WAYS - 1)].rotate_right(1);
        set[0] = line;
        if found.is_some() { 0 } else { self.miss }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALFWORDS: usize = 1 << (LINE_BITS - 1);

    #[test]
    fn what_was_read_lately_is_there_and_a_fifth_line_of_a_set_replaces_the_oldest() {
        let mut cache = Cache::new(7);
        let mut read = |line: usize| cache.read(line * SETS * HALFWORDS + HALFWORDS - 1);
        assert_eq!([0, 1, 2, 3, 0].map(&mut read), [7, 7, 7, 7, 0]);
        // The oldest is 1 by now.
        assert_eq!([4, 0, 2, 3, 1].map(&mut read), [7, 0, 0, 0, 7]);
    }

    #[test]
    fn a_line_has_32_bytes_and_neighbours_lie_in_other_sets() {
        let mut cache = Cache::new(7);
        let taken: Vec<u64> = (0..2 * HALFWORDS).map(|halfword| cache.read(halfword)).collect();
        assert_eq!(taken.iter().sum::<u64>(), 14);
        assert_eq!((taken[0], taken[HALFWORDS]), (7, 7));
        assert_eq!((0..WAYS * SETS).map(|line| cache.read(line * HALFWORDS)).sum::<u64>(), 510 * 7);
        assert_eq!((0..WAYS * SETS).map(|line| cache.read(line * HALFWORDS)).sum::<u64>(), 0);
    }

    #[test]
    fn without_a_time_nothing_misses() {
        assert_eq!(Cache::new(0).read(5), 0);
    }
}
