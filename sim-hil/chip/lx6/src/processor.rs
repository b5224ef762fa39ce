//! The processor: registers and their windows, loops, special registers, one instruction at a time.
//!
//! Of the physical registers sixteen are seen, from the window's base on. A call turns the window by 4, 8 or 12 registers, and
//! an instruction that reaches a register of a frame further out first enters the program's handler, which saves that frame (manual, section 4.7.1).

use crate::cost;
use crate::decode::{Instruction, Operation, constant, decode, unsigned_constant};
use crate::memory::Memory;

/// The LX6 of an ESP32 has 64 physical registers.
pub const REGISTERS: usize = 64;

/// Bits of the processor's state, `PS` (manual, table 4-64).
mod state {
    pub(super) const EXCEPTION: u32 = 1 << 4;
    pub(super) const OLD_BASE_SHIFT: u32 = 8;
    pub(super) const OLD_BASE: u32 = 0xf << OLD_BASE_SHIFT;
    pub(super) const TURN_SHIFT: u32 = 16;
    pub(super) const TURN: u32 = 3 << TURN_SHIFT;
    pub(super) const WINDOWS: u32 = 1 << 18;
    pub(super) const INTERRUPT_LEVEL: u32 = 0xf;
    /// After reset: interrupts masked, in an exception.
    pub(super) const RESET: u32 = 0x1f;
    pub(super) const ALL: u32 = 0x7_0fff;
}

/// Special registers that do something here, by number (manual, chapter 5).
#[expect(missing_docs, reason = "the manual's chapter 5 has a section for each")]
pub mod special {
    pub const LBEG: u8 = 0;
    pub const LEND: u8 = 1;
    pub const LCOUNT: u8 = 2;
    pub const SAR: u8 = 3;
    pub const BR: u8 = 4;
    pub const SCOMPARE1: u8 = 12;
    pub const WINDOWBASE: u8 = 72;
    pub const WINDOWSTART: u8 = 73;
    pub const EPC1: u8 = 177;
    pub const INTCLEAR: u8 = 227;
    pub const INTENABLE: u8 = 228;
    pub const PS: u8 = 230;
    pub const VECBASE: u8 = 231;
    pub const CCOUNT: u8 = 234;
}

/// Special registers that only keep what is written: literal base, prefetch, memory, breakpoints, and what other exceptions would use.
const KEPT: [std::ops::RangeInclusive<u8>; 9] =
    [5..=5, 40..=40, 96..=99, 128..=129, 160..=161, 178..=215, 224..=224, 232..=233, 240..=247];

/// Distance of each handler from the vectors' base (table 4-60, as every core of this architecture with windows has it): a frame of 4, 8 or 12 registers.
const OVERFLOW: [u32; 3] = [0x000, 0x080, 0x100];
/// See [`OVERFLOW`].
const UNDERFLOW: [u32; 3] = [0x040, 0x0c0, 0x140];

/// Why the program cannot go on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Trouble {
    /// Bits that are no instruction that this core knows.
    #[error("instruction {0:#08x}, which is not emulated")]
    Instruction(u32),
    /// A special register that no program here needs, or a value that would start what is not emulated.
    #[error("special register {number} with {value:#x}, which is not emulated")]
    Special {
        /// Its number.
        number: u8,
        /// What was written, or 0 where it was read.
        value: u32,
    },
    /// No memory there, none that can be written, or an address that is no multiple of the size.
    #[error("access to {0:#010x}, where no memory is, none to write, or which is not aligned")]
    Memory(u32),
    /// No code there.
    #[error("nothing to execute there")]
    Fetch,
    /// A window is turned, or a frame left, as the manual leaves undefined.
    #[error("windows used as the manual leaves undefined")]
    Windows,
    /// A stack pointer is moved whose caller's frame was saved.
    #[error("a stack pointer moved below a saved frame (alloca exception), which is not emulated")]
    Alloca,
    /// A division by zero.
    #[error("a division by zero")]
    Division,
}

/// What was wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{trouble}, at {pc:#010x}")]
pub struct Fault {
    /// What.
    pub trouble: Trouble,
    /// Program counter.
    pub pc: u32,
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// An instruction was executed, or a window's handler entered.
    Done,
    /// The program calls its makers' simulator; the program counter is behind the call.
    Simcall,
}

/// What `CCOUNT` counts, and how often for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Instructions; otherwise cycles.
    pub of_instructions: bool,
    /// So many counts ...
    pub counts: u64,
    /// ... for so many of them.
    pub each: u64,
}

impl Clock {
    /// As an LX6: its cycles.
    pub const CYCLES: Self = Self { of_instructions: false, counts: 1, each: 1 };
}

/// A processor.
#[derive(Debug)]
pub struct Core {
    physical: [u32; REGISTERS],
    /// The cycle from which on each register can be read without waiting.
    ready: [u64; REGISTERS],
    /// Physical registers less one.
    mask: usize,
    /// Physical register that `a0` is.
    base: usize,
    window_start: u32,
    /// How many groups of four registers beyond the first belong to no other frame, at most 3.
    free: u8,
    /// Address of the next instruction.
    pub pc: u32,
    ps: u32,
    sar: u32,
    loop_begin: u32,
    loop_end: u32,
    loop_count: u32,
    booleans: u32,
    compared: u32,
    exception_pc: u32,
    vectors: u32,
    others: [u32; 256],
    clock: Clock,
    /// Cycles since reset.
    pub cycles: u64,
    /// Instructions since reset.
    pub instructions: u64,
    /// Window overflows and underflows since reset.
    pub windows: u64,
    decoded: Vec<(u32, Vec<Instruction>)>,
}

/// Where execution goes on.
enum Next {
    Follows,
    At(u32),
}

impl Core {
    /// Creates a processor out of reset with so many physical registers, 32 or 64, about to execute at `pc`.
    ///
    /// # Panics
    /// For another number of registers.
    #[must_use]
    pub fn new(pc: u32, registers: usize, clock: Clock) -> Self {
        assert!([32, REGISTERS].contains(&registers), "a core with windows has 32 or 64 registers");
        Self {
            physical: [0; REGISTERS],
            ready: [0; REGISTERS],
            mask: registers - 1,
            base: 0,
            window_start: 0,
            free: 3,
            pc,
            ps: state::RESET,
            sar: 0,
            loop_begin: 0,
            loop_end: 0,
            loop_count: 0,
            booleans: 0,
            compared: 0,
            exception_pc: 0,
            vectors: 0,
            others: [0; 256],
            clock,
            cycles: 0,
            instructions: 0,
            windows: 0,
            decoded: Vec::new(),
        }
    }

    /// Returns how many physical registers there are.
    #[must_use]
    pub const fn registers(&self) -> usize {
        self.mask + 1
    }

    /// Returns a physical register.
    #[must_use]
    pub const fn physical(&self, number: usize) -> u32 {
        self.physical[number & self.mask]
    }

    const fn place(&self, register: u8) -> usize {
        (self.base + register as usize) & self.mask & (REGISTERS - 1)
    }

    /// Returns one of the sixteen registers that are seen.
    #[inline]
    #[must_use]
    pub const fn get(&self, register: u8) -> u32 {
        self.physical[self.place(register)]
    }

    /// Sets it.
    #[inline]
    pub const fn set(&mut self, register: u8, value: u32) {
        self.physical[self.place(register)] = value;
    }

    /// Sets it to what is only there after so many cycles more.
    fn set_late(&mut self, register: u8, value: u32, cycles: u64) {
        self.ready[self.place(register)] = self.cycles + cycles;
        self.set(register, value);
    }

    const fn window_base(&self) -> u32 {
        (self.base / 4) as u32
    }

    const fn frames(&self) -> u32 {
        (self.registers() / 4) as u32
    }

    /// Sets where the handlers are, which each core is made with its own place for.
    pub const fn set_vectors(&mut self, base: u32) {
        self.vectors = base;
    }

    /// Turns the window by groups of four registers, forwards or back.
    fn turn(&mut self, groups: i32) {
        let registers = self.registers().cast_signed();
        self.base =
            (self.base.cast_signed() + 4 * groups as isize).rem_euclid(registers).cast_unsigned();
        self.look_for_frames();
    }

    /// Returns the beginnings of frames, the lowest bit the group `ahead` of the window's base.
    fn frames_from(&self, ahead: i32) -> u32 {
        let frames = self.frames();
        let twice = u64::from(self.window_start) | u64::from(self.window_start) << frames;
        let first = (self.window_base().cast_signed() + ahead).rem_euclid(frames.cast_signed());
        (twice >> first) as u32
    }

    fn look_for_frames(&mut self) {
        let checks = self.ps & (state::WINDOWS | state::EXCEPTION) == state::WINDOWS;
        self.free = if checks { self.frames_from(1).trailing_zeros().min(3) as u8 } else { 3 };
    }

    /// Returns a special register by number; `None` for one that is not emulated.
    #[must_use]
    pub fn special(&self, number: u8) -> Option<u32> {
        Some(match number {
            special::LBEG => self.loop_begin,
            special::LEND => self.loop_end,
            special::LCOUNT => self.loop_count,
            special::SAR => self.sar,
            special::BR => self.booleans,
            special::SCOMPARE1 => self.compared,
            special::WINDOWBASE => self.window_base(),
            special::WINDOWSTART => self.window_start,
            special::EPC1 => self.exception_pc,
            special::INTENABLE => 0,
            special::PS => self.ps,
            special::VECBASE => self.vectors,
            special::CCOUNT => {
                let Clock { of_instructions, counts, each } = self.clock;
                let time = if of_instructions { self.instructions } else { self.cycles };
                (time * counts / each) as u32
            }
            _ if KEPT.iter().any(|range| range.contains(&number)) => {
                self.others[usize::from(number)]
            }
            _ => return None,
        })
    }

    fn set_special(&mut self, number: u8, value: u32) -> Result<(), Trouble> {
        match number {
            special::LBEG => self.loop_begin = value,
            special::LEND => self.loop_end = value,
            special::LCOUNT => self.loop_count = value,
            special::SAR => self.sar = value & 0x3f,
            special::BR => self.booleans = value & 0xffff,
            special::SCOMPARE1 => self.compared = value,
            special::WINDOWBASE => self.base = value as usize % self.frames() as usize * 4,
            special::WINDOWSTART => self.window_start = value & ((1 << self.frames()) - 1),
            special::EPC1 => self.exception_pc = value,
            special::PS => self.ps = value & state::ALL,
            special::VECBASE => self.vectors = value,
            special::INTCLEAR => {}
            // No interrupt ever comes.
            special::INTENABLE if value == 0 => {}
            _ if KEPT.iter().any(|range| range.contains(&number)) => {
                self.others[usize::from(number)] = value;
            }
            _ => return Err(Trouble::Special { number, value }),
        }
        self.look_for_frames();
        Ok(())
    }

    /// Executes the next instruction, or enters the handler of a window that it needs first.
    ///
    /// # Errors
    /// When the program does what is not emulated.
    pub fn step(&mut self, memory: &mut Memory) -> Result<Step, Fault> {
        let pc = self.pc;
        let fault = |trouble| Fault { trouble, pc };
        let instruction = self.fetch(memory).ok_or(fault(Trouble::Fetch))?;
        let turn = match instruction.operation {
            Operation::Entry => (self.ps >> state::TURN_SHIFT & 3) as u8,
            _ => 0,
        };
        if instruction.reach.max(turn) > self.free {
            self.overflow();
            return Ok(Step::Done);
        }
        let mut issue = self.cycles;
        if instruction.reads_s {
            issue = issue.max(self.ready[self.place(instruction.s)]);
        }
        if instruction.reads_t {
            issue = issue.max(self.ready[self.place(instruction.t)]);
        }
        self.cycles = issue + cost::ISSUE;
        let next = self.execute(memory, instruction).map_err(fault)?;
        self.instructions += 1;
        self.pc = match next {
            Next::At(address) => {
                self.cycles += cost::TAKEN;
                address
            }
            Next::Follows => {
                let follows = pc.wrapping_add(u32::from(instruction.length));
                let loops = follows == self.loop_end && self.loop_count != 0;
                if loops && self.ps & state::EXCEPTION == 0 {
                    self.loop_count -= 1;
                    self.loop_begin
                } else {
                    follows
                }
            }
        };
        if instruction.operation == Operation::Simcall {
            return Ok(Step::Simcall);
        }
        Ok(Step::Done)
    }

    /// Returns the instruction at the program counter, decoded once.
    fn fetch(&mut self, memory: &Memory) -> Option<Instruction> {
        let pc = self.pc;
        let kept = self.decoded.iter_mut().find_map(|(start, instructions)| {
            instructions.get_mut(pc.wrapping_sub(*start) as usize)
        });
        if let Some(instruction) = kept {
            if instruction.operation == Operation::Unknown {
                *instruction = decode(memory.fetch(pc)?);
            }
            return Some(*instruction);
        }
        let piece = memory.pieces.iter().find(|piece| {
            piece.is_code && (pc.wrapping_sub(piece.start) as usize) < piece.bytes.len()
        })?;
        self.decoded.push((piece.start, vec![Instruction::UNKNOWN; piece.bytes.len()]));
        Some(decode(memory.fetch(pc)?))
    }

    /// Enters the handler that saves the nearest frame ahead.
    fn overflow(&mut self) {
        let ahead = self.free + 1;
        let old = self.window_base();
        self.turn(i32::from(ahead));
        // How large that frame is: up to the next one.
        let size = self.frames_from(1).trailing_zeros().min(2);
        self.enter(old, OVERFLOW[size as usize]);
    }

    fn enter(&mut self, old_base: u32, vector: u32) {
        self.ps = self.ps & !state::OLD_BASE | old_base << state::OLD_BASE_SHIFT | state::EXCEPTION;
        self.exception_pc = self.pc;
        self.pc = self.vectors.wrapping_add(vector);
        self.cycles += cost::EXCEPTION;
        self.windows += 1;
        self.look_for_frames();
    }

    #[inline(always)]
    fn execute(&mut self, memory: &mut Memory, instruction: Instruction) -> Result<Next, Trouble> {
        use Operation as O;
        let Instruction { operation, r, s: s_number, t: t_number, immediate, .. } = instruction;
        let (s, t) = (self.get(s_number), self.get(t_number & 15));
        let (s_signed, t_signed) = (s.cast_signed(), t.cast_signed());
        let constant_bits = immediate.cast_unsigned();
        let at = s.wrapping_add(constant_bits);
        let target = self.pc.wrapping_add(constant_bits);
        let behind = self.pc.wrapping_add(u32::from(instruction.length));
        let branch = |is_taken: bool| Ok(if is_taken { Next::At(target) } else { Next::Follows });
        let bit = |number: u32| s >> (number & 31) & 1 == 1;
        match operation {
            O::Add => self.set(r, s.wrapping_add(t)),
            O::Addi => self.set(r, at),
            O::Addx2 => self.set(r, (s << 1).wrapping_add(t)),
            O::Addx4 => self.set(r, (s << 2).wrapping_add(t)),
            O::Addx8 => self.set(r, (s << 3).wrapping_add(t)),
            O::Sub => self.set(r, s.wrapping_sub(t)),
            O::Subx2 => self.set(r, (s << 1).wrapping_sub(t)),
            O::Subx4 => self.set(r, (s << 2).wrapping_sub(t)),
            O::Subx8 => self.set(r, (s << 3).wrapping_sub(t)),
            O::Abs => self.set(r, t_signed.unsigned_abs()),
            O::Neg => self.set(r, t.wrapping_neg()),
            O::And => self.set(r, s & t),
            O::Or => self.set(r, s | t),
            O::Xor => self.set(r, s ^ t),
            O::Extui => {
                let (shift, count) = (constant_bits & 31, constant_bits >> 5);
                self.set(r, t >> shift & ((1 << count) - 1));
            }
            O::Movi => self.set(t_number, constant_bits),
            O::Clamps => {
                let greatest = (1 << immediate) - 1;
                self.set(r, s_signed.clamp(-greatest - 1, greatest).cast_unsigned());
            }
            O::Max => self.set(r, s_signed.max(t_signed).cast_unsigned()),
            O::Maxu => self.set(r, s.max(t)),
            O::Min => self.set(r, s_signed.min(t_signed).cast_unsigned()),
            O::Minu => self.set(r, s.min(t)),
            O::Nsa => {
                self.set(t_number, (s ^ (s_signed >> 31).cast_unsigned()).leading_zeros() - 1)
            }
            O::Nsau => self.set(t_number, s.leading_zeros()),
            O::Sext => {
                let unused = 31 - constant_bits;
                self.set(r, ((s << unused).cast_signed() >> unused).cast_unsigned());
            }
            O::Moveqz if t == 0 => self.set(r, s),
            O::Movnez if t != 0 => self.set(r, s),
            O::Movltz if t_signed < 0 => self.set(r, s),
            O::Movgez if t_signed >= 0 => self.set(r, s),
            O::Movf if self.booleans >> immediate & 1 == 0 => self.set(r, s),
            O::Movt if self.booleans >> immediate & 1 == 1 => self.set(r, s),
            O::Moveqz | O::Movnez | O::Movltz | O::Movgez | O::Movf | O::Movt => {}
            O::Slli => self.set(r, s << (constant_bits & 31)),
            O::Srai => self.set(r, (t_signed >> immediate).cast_unsigned()),
            O::Srli => self.set(r, t >> immediate),
            // Amounts from 0 to 63 into 64 bits.
            O::Src => self.set(r, ((u64::from(s) << 32 | u64::from(t)) >> self.sar) as u32),
            O::Sll => self.set(r, (u64::from(s) << 32 >> self.sar) as u32),
            O::Srl => self.set(r, (u64::from(t) >> self.sar) as u32),
            O::Sra => self.set(r, (i64::from(t_signed) >> self.sar) as u32),
            O::Ssr => self.sar = s & 31,
            O::Ssl => self.sar = 32 - (s & 31),
            O::Ssa8l => self.sar = (s & 3) << 3,
            O::Ssa8b => self.sar = 32 - ((s & 3) << 3),
            O::Ssai => self.sar = constant_bits,
            O::Mul16u => self.multiply(r, u64::from(s & 0xffff) * u64::from(t & 0xffff)),
            O::Mul16s => {
                let product = i64::from(s_signed as i16) * i64::from(t_signed as i16);
                self.multiply(r, product.cast_unsigned());
            }
            O::Mull => self.multiply(r, u64::from(s.wrapping_mul(t))),
            O::Muluh => self.multiply(r, (u64::from(s) * u64::from(t)) >> 32),
            O::Mulsh => {
                let product = i64::from(s_signed) * i64::from(t_signed);
                self.multiply(r, (product >> 32).cast_unsigned());
            }
            O::Quou | O::Quos | O::Remu | O::Rems => {
                let result = match operation {
                    O::Quou => s.checked_div(t),
                    O::Remu => s.checked_rem(t),
                    _ if t == 0 => None,
                    O::Quos => Some(s_signed.wrapping_div(t_signed).cast_unsigned()),
                    _ => Some(s_signed.wrapping_rem(t_signed).cast_unsigned()),
                };
                self.cycles += cost::DIVIDE - cost::ISSUE;
                self.set(r, result.ok_or(Trouble::Division)?);
            }
            O::L8ui => self.load::<1>(memory, t_number, at, |value| value)?,
            O::L16ui => self.load::<2>(memory, t_number, at, |value| value)?,
            O::L16si => self
                .load::<2>(memory, t_number, at, |value| i32::from(value as i16).cast_unsigned())?,
            O::L32i | O::L32e => self.load::<4>(memory, t_number, at, |value| value)?,
            O::L32r => {
                let at = (self.pc.wrapping_add(3) & !3).wrapping_add(constant_bits);
                self.load::<4>(memory, t_number, at, |value| value)?;
            }
            O::S8i => store::<1>(memory, at, t)?,
            O::S16i => store::<2>(memory, at, t)?,
            O::S32i | O::S32e => store::<4>(memory, at, t)?,
            O::S32c1i => {
                let old =
                    memory.read::<4>(at).filter(|_| at % 4 == 0).ok_or(Trouble::Memory(at))?;
                if old == self.compared {
                    store::<4>(memory, at, t)?;
                }
                self.set_late(t_number, old, cost::COMPARE_AND_STORE);
            }
            O::J => return Ok(Next::At(target)),
            O::Jx => return Ok(Next::At(s)),
            O::Call0 | O::Callx0 => {
                self.set(0, behind);
                let call = (self.pc & !3).wrapping_add(constant_bits);
                return Ok(Next::At(if operation == O::Call0 { call } else { s }));
            }
            O::Ret => return Ok(Next::At(s)),
            O::Call | O::Callx => {
                self.ps = self.ps & !state::TURN | u32::from(r) << state::TURN_SHIFT;
                self.set(r << 2, u32::from(r) << 30 | behind & 0x3fff_ffff);
                let call = (self.pc & !3).wrapping_add(constant_bits);
                return Ok(Next::At(if operation == O::Call { call } else { s }));
            }
            O::Entry => self.enter_frame(s_number, s.wrapping_sub(constant_bits))?,
            O::Retw => return self.leave_frame(),
            O::Movsp => {
                // A caller's frame is still in registers.
                if self.frames_from(-3) & 7 == 0 {
                    return Err(Trouble::Alloca);
                }
                self.set(t_number, s);
            }
            O::Rotw => self.turn(immediate),
            O::Rfwo | O::Rfwu => {
                let frame = 1 << self.window_base();
                match operation {
                    O::Rfwo => self.window_start &= !frame,
                    _ => self.window_start |= frame,
                }
                let old = (self.ps & state::OLD_BASE) >> state::OLD_BASE_SHIFT;
                self.ps &= !state::EXCEPTION;
                self.base = (old as usize * 4) & self.mask;
                self.look_for_frames();
                return Ok(Next::At(self.exception_pc));
            }
            O::Beqz => return branch(s == 0),
            O::Bnez => return branch(s != 0),
            O::Bltz => return branch(s_signed < 0),
            O::Bgez => return branch(s_signed >= 0),
            O::Beqi => return branch(s_signed == constant(t_number)),
            O::Bnei => return branch(s_signed != constant(t_number)),
            O::Blti => return branch(s_signed < constant(t_number)),
            O::Bgei => return branch(s_signed >= constant(t_number)),
            O::Bltui => return branch(s < unsigned_constant(t_number)),
            O::Bgeui => return branch(s >= unsigned_constant(t_number)),
            O::Ball => return branch(!s & t == 0),
            O::Bany => return branch(s & t != 0),
            O::Bnall => return branch(!s & t != 0),
            O::Bnone => return branch(s & t == 0),
            O::Bbc => return branch(!bit(t)),
            O::Bbs => return branch(bit(t)),
            O::Bbci => return branch(!bit(u32::from(t_number))),
            O::Bbsi => return branch(bit(u32::from(t_number))),
            O::Beq => return branch(s == t),
            O::Bne => return branch(s != t),
            O::Bge => return branch(s_signed >= t_signed),
            O::Bgeu => return branch(s >= t),
            O::Blt => return branch(s_signed < t_signed),
            O::Bltu => return branch(s < t),
            O::Bf => return branch(self.booleans >> t_number & 1 == 0),
            O::Bt => return branch(self.booleans >> t_number & 1 == 1),
            O::Loop | O::Loopnez | O::Loopgtz => {
                self.loop_count = s.wrapping_sub(1);
                self.loop_begin = behind;
                self.loop_end = target;
                return branch(match operation {
                    O::Loopnez => s == 0,
                    O::Loopgtz => s_signed <= 0,
                    _ => false,
                });
            }
            O::Rsr => {
                let number = constant_bits as u8;
                let value = self.special(number);
                self.set(t_number, value.ok_or(Trouble::Special { number, value: 0 })?);
            }
            O::Wsr => {
                self.cycles += cost::SYNCHRONIZE;
                self.set_special(constant_bits as u8, t)?;
            }
            O::Xsr => {
                let number = constant_bits as u8;
                let value = self.special(number).ok_or(Trouble::Special { number, value: t })?;
                self.cycles += cost::SYNCHRONIZE;
                self.set_special(number, t)?;
                self.set(t_number, value);
            }
            O::Rsil => {
                self.set(t_number, self.ps);
                self.cycles += cost::SYNCHRONIZE;
                self.ps = self.ps & !state::INTERRUPT_LEVEL | constant_bits;
            }
            O::Barrier => self.cycles += cost::SYNCHRONIZE - cost::ISSUE,
            O::Simcall | O::Nop => {}
            // Those of threads and floating point.
            O::Rur | O::Wur => {
                return Err(Trouble::Special { number: constant_bits as u8, value: t });
            }
            O::Illegal | O::Unknown => return Err(Trouble::Instruction(constant_bits)),
        }
        Ok(Next::Follows)
    }

    fn multiply(&mut self, register: u8, product: u64) {
        self.set_late(register, product as u32, cost::MULTIPLY_USE);
    }

    #[inline(always)]
    fn load<const N: usize>(
        &mut self,
        memory: &Memory,
        register: u8,
        address: u32,
        convert: impl Fn(u32) -> u32,
    ) -> Result<(), Trouble> {
        let value = memory.read::<N>(address).filter(|_| (address as usize).is_multiple_of(N));
        self.set_late(register, convert(value.ok_or(Trouble::Memory(address))?), cost::LOAD_USE);
        Ok(())
    }

    /// `entry`: turns the window as the call asked for, to a new frame with this stack pointer.
    fn enter_frame(&mut self, stack_pointer: u8, value: u32) -> Result<(), Trouble> {
        let checks = self.ps & (state::WINDOWS | state::EXCEPTION) == state::WINDOWS;
        if stack_pointer > 3 || !checks {
            return Err(Trouble::Windows);
        }
        let turn = self.ps >> state::TURN_SHIFT & 3;
        self.set((turn << 2) as u8 | stack_pointer, value);
        self.base = (self.base + 4 * turn as usize) & self.mask;
        self.window_start |= 1 << self.window_base();
        self.look_for_frames();
        Ok(())
    }

    /// `retw`: turns the window back to the caller's frame; enters the handler that fetches it where it was saved.
    fn leave_frame(&mut self) -> Result<Next, Trouble> {
        let link = self.get(0);
        let turn = link >> 30;
        let checks = self.ps & (state::WINDOWS | state::EXCEPTION) == state::WINDOWS;
        // The nearest frame behind, as a number of groups; 3 and more are in the highest bits of the three.
        let behind = match self.frames_from(-3) & 7 {
            0 => None,
            near if near & 4 != 0 => Some(1),
            near if near & 2 != 0 => Some(2),
            _ => Some(3),
        };
        if turn == 0 || !checks || behind.is_some_and(|behind| behind != turn) {
            return Err(Trouble::Windows);
        }
        let old = self.window_base();
        self.turn(-(turn.cast_signed()));
        if behind.is_some() {
            self.window_start &= !(1 << old);
            self.look_for_frames();
            return Ok(Next::At(self.pc & 0xc000_0000 | link & 0x3fff_ffff));
        }
        self.instructions = self.instructions.wrapping_sub(1);
        self.enter(old, UNDERFLOW[turn as usize - 1]);
        Ok(Next::At(self.pc))
    }
}

#[inline(always)]
fn store<const N: usize>(memory: &mut Memory, address: u32, value: u32) -> Result<(), Trouble> {
    let is_aligned = (address as usize).is_multiple_of(N);
    let stored = is_aligned.then(|| memory.write::<N>(address, value)).flatten();
    stored.ok_or(Trouble::Memory(address))
}
