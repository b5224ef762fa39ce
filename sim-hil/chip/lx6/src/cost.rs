//! Cycles that an LX6 takes. Its makers publish no table: these are assumptions from a pipeline of seven stages (ESP32 data
//! sheet, "CPU and Memory") without prediction of branches, on the slow side; a bench with hardware replaces them.
//!
//! Not modelled: misses of the flash cache, as the fast loop lies in memory; waits for a memory that both cores or DMA want at once;
//! peripherals, which are the chip's.

/// Each instruction is issued in a cycle of its own, one after the other.
pub const ISSUE: u64 = 1;
/// A jump, a call, a return or a taken branch: the stages before execution are filled anew. The end of a zero-overhead
/// loop costs nothing.
pub const TAKEN: u64 = 3;
/// After a load of memory or of a literal: an instruction that needs the value at once waits so long.
pub const LOAD_USE: u64 = 2;
/// After a multiplication, likewise.
pub const MULTIPLY_USE: u64 = 1;
/// A division or a remainder, whatever its operands.
pub const DIVIDE: u64 = 13;
/// A barrier, or a write to a special register, which others may have to wait for.
pub const SYNCHRONIZE: u64 = 4;
/// Comparing and storing in one: the memory is read and written.
pub const COMPARE_AND_STORE: u64 = 3;
/// Entering the handler of a window: as a jump, with what is in the pipeline thrown away.
pub const EXCEPTION: u64 = 5;
