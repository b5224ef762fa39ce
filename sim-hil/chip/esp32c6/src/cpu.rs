//! The processor: RV32IMAC in machine mode with the ESP32-C6's control registers.
//!
//! Instructions are decoded once and kept. Time is counted in cycles of the 160 MHz clock; what an instruction takes
//! is [`cost`]'s. Misses of the flash's cache take what a run charges for them.

mod cache;
mod decode;
mod execute;
mod tick;

pub(crate) use decode::Instruction;
pub(crate) use tick::Tick;

use std::collections::BTreeMap;

use cache::Cache;

use crate::fault::Fault;
use crate::memory::{FLASH, FLASH_BYTES, Memory, RAM, RAM_BYTES};

/// Cycles that instructions take (ESP32-C6 technical reference manual, chapter 1: a four-stage pipeline with static
/// branch prediction). The manual states no table: these are estimates on the slow side.
pub(crate) mod cost {
    /// Arithmetic, multiplication, not-taken branches.
    pub(crate) const SIMPLE: u64 = 1;
    /// A jump or a taken branch, with the pipeline filled again.
    pub(crate) const JUMP: u64 = 3;
    /// A load from memory.
    pub(crate) const LOAD: u64 = 2;
    /// A store to memory.
    pub(crate) const STORE: u64 = 1;
    /// A division.
    pub(crate) const DIVIDE: u64 = 16;
    /// A read from a peripheral, over the bus at 40 MHz.
    pub(crate) const PERIPHERAL_READ: u64 = 12;
    /// A write to a peripheral.
    pub(crate) const PERIPHERAL_WRITE: u64 = 6;
    /// Entry into an interrupt.
    pub(crate) const INTERRUPT: u64 = 6;
}

/// Control and status registers by number.
pub(crate) mod csr {
    pub(crate) const MSTATUS: u16 = 0x300;
    pub(crate) const MISA: u16 = 0x301;
    pub(crate) const MIE: u16 = 0x304;
    pub(crate) const MTVEC: u16 = 0x305;
    pub(crate) const MEPC: u16 = 0x341;
    pub(crate) const MCAUSE: u16 = 0x342;
    pub(crate) const MTVAL: u16 = 0x343;
}

/// Interrupts are enabled (`mstatus.MIE`).
pub(crate) const MSTATUS_MIE: u32 = 1 << 3;
const MSTATUS_MPIE: u32 = 1 << 7;
const MSTATUS_MPP: u32 = 3 << 11;
/// `mcause` of interrupts has its highest bit set.
const INTERRUPT: u32 = 1 << 31;

/// Exceptions by cause.
pub(crate) mod cause {
    pub(crate) const FETCH_FAULT: u32 = 1;
    pub(crate) const ILLEGAL: u32 = 2;
    pub(crate) const BREAKPOINT: u32 = 3;
    pub(crate) const LOAD_MISALIGNED: u32 = 4;
    pub(crate) const LOAD_FAULT: u32 = 5;
    pub(crate) const STORE_MISALIGNED: u32 = 6;
    pub(crate) const STORE_FAULT: u32 = 7;
    pub(crate) const ECALL: u32 = 11;
}

/// What the processor reads and writes.
pub(crate) trait Bus {
    /// Memory, which answers without side effects.
    fn memory(&mut self) -> &mut Memory;
    /// Reads `size` bytes of what is not memory.
    fn load(&mut self, address: u32, size: u32, access: Access) -> Result<u32, Refusal>;
    /// Writes `size` bytes of what is not memory.
    fn store(&mut self, address: u32, value: u32, size: u32, access: Access)
    -> Result<(), Refusal>;
    /// Returns whether something changed for which the run has to stop; asked after each of these accesses.
    fn wants_attention(&self) -> bool;
}

/// When, and from where in the program, something is accessed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Access {
    /// Cycles since the chip started.
    pub(crate) time: u64,
    /// The instruction.
    pub(crate) pc: u32,
    /// Whether an interrupt may come before the next one.
    pub(crate) is_interruptible: bool,
}

/// Why an access failed.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// Nothing is there: the processor takes an exception.
    Nothing,
    /// The model does not know: the emulation ends.
    Fault(Fault),
}

/// Why a run of instructions ended.
#[derive(Debug)]
pub(crate) enum Exit {
    /// The time is up.
    Time,
    /// Something happened that may interrupt.
    Attention,
    /// It waits for an interrupt.
    Wait,
    /// It entered a function that is done outside, of this number.
    Host(i32),
    /// The program counter is outside of what is executed: in the mask ROM.
    Elsewhere,
    /// The program cannot go on.
    Fault(Fault),
}

/// First address and number of halfwords of the two regions that are executed.
const REGIONS: [(u32, usize); 2] = [(RAM, RAM_BYTES / 2), (FLASH, FLASH_BYTES / 2)];
/// The one in flash.
const FLASH_REGION: usize = 1;
/// Granularity in which writes into code are noticed, as a power of two.
const PAGE_BITS: u32 = 10;

/// The processor.
pub(crate) struct Cpu {
    /// Registers; beyond the 31st what was written to `x0`.
    pub(crate) x: [u32; 64],
    pub(crate) pc: u32,
    pub(crate) mstatus: u32,
    mtvec: u32,
    pub(crate) mepc: u32,
    mcause: u32,
    mtval: u32,
    mie: u32,
    others: BTreeMap<u16, u32>,
    reservation: Option<u32>,
    /// Cycles since the chip started.
    pub(crate) cycles: u64,
    /// Instructions since the chip started.
    pub(crate) instructions: u64,
    decoded: [Vec<Instruction>; 2],
    holds_code: Vec<bool>,
    /// The last jumps, newest at `jumps_at`, for the report of a fault.
    jumps: [u32; JUMPS],
    jumps_at: usize,
    /// What the fast loop's tick takes of flash.
    pub(crate) tick: Tick,
    cache: Cache,
}

/// How many jumps are remembered.
const JUMPS: usize = 16;

impl Cpu {
    /// Creates a processor out of reset, about to execute at `pc`, with interrupts off.
    pub(crate) fn new(pc: u32) -> Self {
        Self {
            x: [0; 64],
            pc,
            mstatus: MSTATUS_MPP,
            mtvec: 0,
            mepc: 0,
            mcause: 0,
            mtval: 0,
            mie: 0,
            others: BTreeMap::new(),
            reservation: None,
            cycles: 0,
            instructions: 0,
            decoded: REGIONS.map(|(_, halfwords)| vec![Instruction::UNKNOWN; halfwords]),
            holds_code: vec![false; RAM_BYTES >> PAGE_BITS],
            jumps: [0; JUMPS],
            jumps_at: 0,
            tick: Tick::default(),
            cache: Cache::new(0),
        }
    }

    /// Charges so many cycles for each miss of the flash's cache, which is empty then.
    pub(crate) fn charge_misses(&mut self, cycles: u64) {
        self.cache = Cache::new(cycles);
    }

    /// Returns whether an interrupt line, enabled in `mie`, would be taken.
    pub(crate) fn takes_interrupts(&self) -> bool {
        self.mstatus & MSTATUS_MIE != 0
    }

    /// Returns whether `mie` lets a line through.
    pub(crate) fn line_is_enabled(&self, line: u32) -> bool {
        self.mie >> line & 1 == 1
    }

    /// Enters the handler of an interrupt line.
    pub(crate) fn interrupt(&mut self, line: u32) {
        self.cycles += cost::INTERRUPT;
        self.enter(INTERRUPT | line, 0);
    }

    fn enter(&mut self, cause: u32, value: u32) {
        self.tick.enter();
        self.mepc = self.pc;
        self.mcause = cause;
        self.mtval = value;
        let enabled = self.mstatus & MSTATUS_MIE;
        self.mstatus = self.mstatus & !(MSTATUS_MIE | MSTATUS_MPIE) | enabled << 4 | MSTATUS_MPP;
        self.reservation = None;
        let (base, is_vectored) = (self.mtvec & !0xFF, self.mtvec & 1 == 1);
        self.pc = match cause & INTERRUPT {
            0 => base,
            _ if is_vectored => base + 4 * (cause & 0x1F),
            _ => base,
        };
    }

    /// Diverts the function at `address` to the outside, as number `number`.
    pub(crate) fn divert(&mut self, address: u32, number: i32) {
        if let Some((region, index)) = place(address) {
            self.decoded[region][index] = Instruction::host(number);
        }
    }

    /// Drops what was decoded of working memory that was written from outside.
    pub(crate) fn forget(&mut self, address: u32, length: usize) {
        let first = address.wrapping_sub(RAM);
        if length == 0 || first as usize >= RAM_BYTES {
            return;
        }
        let last = (first + length as u32 - 1).min(RAM_BYTES as u32 - 1);
        for page in first >> PAGE_BITS..=last >> PAGE_BITS {
            self.forget_page(page as usize);
        }
    }

    fn forget_page(&mut self, page: usize) {
        if !std::mem::take(&mut self.holds_code[page]) {
            return;
        }
        let first = page << (PAGE_BITS - 1);
        let end = (page + 1) << (PAGE_BITS - 1);
        for instruction in &mut self.decoded[0][first..end] {
            if instruction.kind != decode::Kind::Host {
                *instruction = Instruction::UNKNOWN;
            }
        }
    }

    /// Returns the last jumps, oldest first.
    pub(crate) fn trail(&self) -> Vec<u32> {
        (0..JUMPS).map(|index| self.jumps[(self.jumps_at + 1 + index) % JUMPS]).collect()
    }

    /// Returns the cause and value of the last exception or interrupt.
    pub(crate) fn last_cause(&self) -> (u32, u32) {
        (self.mcause, self.mtval)
    }

    fn read_csr(&self, number: u16, time: u64) -> Option<u32> {
        Some(match number {
            csr::MSTATUS => self.mstatus,
            // RV32 with A, C, I, M and U.
            csr::MISA => 0x4010_1105,
            csr::MIE => self.mie,
            csr::MTVEC => self.mtvec,
            csr::MEPC => self.mepc,
            csr::MCAUSE => self.mcause,
            csr::MTVAL => self.mtval,
            // Espressif's identity, and the counter of cycles under its standard and own numbers.
            0xF11 => 0x612,
            0xF12 => 0x8000_0002,
            0xF13 => 2,
            0xF14 => 0,
            0xB00 | 0xC00 | 0x7E2 | 0x802 => time as u32,
            0xB80 | 0xC80 => (time >> 32) as u32,
            // Scratch; interrupt delegation; user traps; PMP and Espressif's PMA; triggers; counter control; GPIO.
            0x340
            | 0x344
            | 0x302..=0x303
            | 0x306
            | 0x000
            | 0x004..=0x005
            | 0x040..=0x043
            | 0x3A0..=0x3A3
            | 0x3B0..=0x3BF
            | 0xBC0..=0xBCF
            | 0xBD0..=0xBDF
            | 0x7A0..=0x7A5
            | 0x7B0..=0x7B3
            | 0x7E0..=0x7E1
            | 0x800..=0x805
            | 0x320 => self.others.get(&number).copied().unwrap_or(0),
            _ => return None,
        })
    }

    fn write_csr(&mut self, number: u16, value: u32) -> bool {
        match number {
            csr::MSTATUS => self.mstatus = value & (MSTATUS_MIE | MSTATUS_MPIE) | MSTATUS_MPP,
            csr::MIE => self.mie = value,
            csr::MTVEC => self.mtvec = value,
            csr::MEPC => self.mepc = value & !1,
            csr::MCAUSE => self.mcause = value,
            csr::MTVAL => self.mtval = value,
            csr::MISA | 0xB00 | 0xB80 | 0x7E2 => {}
            0xC00..=0xFFF => return false,
            _ => {
                self.others.insert(number, value);
            }
        }
        true
    }
}

/// Region and index of the instruction at an address.
fn place(address: u32) -> Option<(usize, usize)> {
    REGIONS.iter().enumerate().find_map(|(region, (start, halfwords))| {
        let index = address.wrapping_sub(*start) as usize / 2;
        (index < *halfwords).then_some((region, index))
    })
}
