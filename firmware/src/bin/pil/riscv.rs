//! QEMU's machine `virt`: an RV32IMAC with semihosting.

use core::ffi::CStr;

use semihosting::io::Read;

pub(crate) use riscv_rt::entry;
pub(crate) use semihosting::println;
pub(crate) use semihosting::process::exit;

/// Counts the instructions from one moment to another.
pub(crate) struct Stopwatch(u32);

impl Stopwatch {
    #[inline(always)]
    pub(crate) fn start() -> Self {
        // Its lower half: what is counted is far below its range.
        Self(riscv::register::minstret::read() as u32)
    }

    /// Returns the instructions since the start, those of counting included.
    #[inline(always)]
    pub(crate) fn instructions(&self) -> u32 {
        (riscv::register::minstret::read() as u32).wrapping_sub(self.0)
    }
}

/// A file of the computer that runs QEMU.
pub(crate) struct File(semihosting::fs::File);

impl File {
    /// Opens a file to read it.
    pub(crate) fn open(name: &CStr) -> Option<Self> {
        semihosting::fs::File::open(name).ok().map(Self)
    }

    /// Fills the room; an error where the file ends before.
    pub(crate) fn read_exact(&mut self, room: &mut [u8]) -> Result<(), semihosting::io::Error> {
        self.0.read_exact(room)
    }
}
