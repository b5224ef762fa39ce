//! QEMU's machine `sim`: an Xtensa core with register windows, and the calls of its makers' simulator.
//!
//! The cores that QEMU has are not the ESP32's LX6: counts of instructions are theirs. Those with windows lack the upper half of
//! a product (`mulsh`, `muluh`), so that this image is built without it and takes a few instructions more for each.

use core::arch::asm;
use core::ffi::CStr;

use assembly::simcall;
pub(crate) use xtensa_lx_rt::entry;

/// The first instructions after reset, and the calls of the simulator.
mod assembly {
    #![expect(unsafe_code, reason = "assembly, and its name for what calls it")]

    use core::arch::global_asm;

    // The state in which the ESP32's ROM hands over: windows on, one frame in use, interrupts off. xtensa-lx-rt goes on from there.
    global_asm!(
        ".section .reset,\"ax\",@progbits",
        ".global start",
        ".p2align 2",
        "start:",
        "j .Lstart",
        ".p2align 2",
        // Windows on, exceptions of user programs, interrupts masked.
        ".Lps: .4byte 0x4002f",
        ".Lstack: .4byte _stack_start_cpu0",
        ".Lvectors: .4byte _init_start",
        ".Lreset: .4byte Reset",
        ".Lstart:",
        "movi a0, 0",
        "wsr a0, windowbase",
        "rsync",
        "movi a0, 1",
        "wsr a0, windowstart",
        // Comparing and storing in one (`s32c1i`) on every kind of memory: ATOMCTL.
        "movi a0, 0x15",
        "wsr a0, 99",
        "l32r a0, .Lps",
        "wsr a0, ps",
        "rsync",
        "l32r a1, .Lstack",
        "l32r a4, .Lvectors",
        "wsr a4, vecbase",
        "rsync",
        "movi a0, 0",
        "l32r a4, .Lreset",
        "callx4 a4",
        // `simcall`, which LLVM does not know: number and arguments from a2 on, the result in a2.
        ".section .text.simcall,\"ax\",@progbits",
        ".global simcall",
        ".p2align 2",
        "simcall:",
        "entry a1, 32",
        ".byte 0x00, 0x51, 0x00",
        "retw.n",
    );

    unsafe extern "C" {
        pub(super) fn simcall(number: u32, first: u32, second: u32, third: u32) -> i32;
    }
}

/// Numbers of the simulator's calls (QEMU, `target/xtensa/xtensa-semi.c`).
const EXIT: u32 = 1;
const READ: u32 = 3;
const WRITE: u32 = 4;
const OPEN: u32 = 5;
/// The computer's standard output.
const OUTPUT: u32 = 1;

/// Asks the simulator for something.
fn call(number: u32, first: u32, second: u32, third: u32) -> i32 {
    // SAFETY: it writes to no memory but what `READ` names, which is a buffer that its caller has borrowed for writing.
    #[expect(unsafe_code, reason = "a call that assembly makes")]
    unsafe {
        simcall(number, first, second, third)
    }
}

/// Ends QEMU with this exit code.
pub(crate) fn exit(code: i32) -> ! {
    call(EXIT, code.cast_unsigned(), 0, 0);
    loop {
        core::hint::spin_loop();
    }
}

/// The computer's standard output.
pub(crate) struct Console;

impl core::fmt::Write for Console {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        call(WRITE, OUTPUT, text.as_ptr() as u32, text.len() as u32);
        Ok(())
    }
}

macro_rules! println {
    ($($words:tt)*) => {{
        use core::fmt::Write as _;
        // The console takes everything.
        let _ = writeln!($crate::machine::Console, $($words)*);
    }};
}
pub(crate) use println;

/// Counts the instructions from one moment to another.
pub(crate) struct Stopwatch(u32);

impl Stopwatch {
    #[inline(always)]
    pub(crate) fn start() -> Self {
        Self(cycles())
    }

    /// Returns the instructions since the start, those of counting included.
    #[inline(always)]
    pub(crate) fn instructions(&self) -> u32 {
        // QEMU's `-icount shift=10` gives each 1,024 ns, and these cores count at 10 MHz: 10.24 to an instruction.
        let cycles = u64::from(cycles().wrapping_sub(self.0));
        ((cycles * 25 + 128) / 256) as u32
    }
}

#[inline(always)]
fn cycles() -> u32 {
    let cycles: u32;
    // SAFETY: it reads a counter.
    #[expect(unsafe_code, reason = "a register of the processor")]
    unsafe {
        asm!("rsr.ccount {0}", out(reg) cycles, options(nomem, nostack));
    }
    cycles
}

/// A file of the computer that runs QEMU, read by buffers.
pub(crate) struct File {
    descriptor: u32,
    buffer: [u8; 4096],
    /// What of the buffer is not read yet.
    left: core::ops::Range<usize>,
}

impl File {
    /// Opens a file to read it.
    pub(crate) fn open(name: &CStr) -> Option<Self> {
        let descriptor = call(OPEN, name.as_ptr() as u32, 0, 0);
        let descriptor = u32::try_from(descriptor).ok()?;
        Some(Self { descriptor, buffer: [0; 4096], left: 0..0 })
    }

    /// Fills the room; an error where the file ends before.
    pub(crate) fn read_exact(&mut self, room: &mut [u8]) -> Result<(), ()> {
        for byte in room {
            if self.left.is_empty() {
                let (start, size) = (self.buffer.as_mut_ptr() as u32, self.buffer.len() as u32);
                let count = usize::try_from(call(READ, self.descriptor, start, size));
                self.left = 0..count.map_err(|_| ())?;
            }
            let next = self.left.next().ok_or(())?;
            *byte = *self.buffer.get(next).ok_or(())?;
        }
        Ok(())
    }
}

/// Ends the run: what LLVM makes of code that cannot be reached.
#[expect(unsafe_code, reason = "the linker needs the name")]
#[unsafe(no_mangle)]
extern "C" fn abort() -> ! {
    println!("panic: aborted");
    exit(5)
}
