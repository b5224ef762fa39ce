//! Settings in flash: a map with one entry, written round the partition, safe against power going
//! in the middle of a write (crate `sequential-storage`).
