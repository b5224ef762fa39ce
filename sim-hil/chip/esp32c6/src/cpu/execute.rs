//! Executing decoded instructions.

use super::decode::{Instruction, Kind};
use super::{
    Access, Bus, Cpu, Exit, FLASH_REGION, JUMPS, MSTATUS_MIE, MSTATUS_MPIE, PAGE_BITS, Refusal,
    cause, cost, place,
};
use crate::fault::{Fault, Trouble};
use crate::memory::{FLASH, FLASH_BYTES, RAM, RAM_BYTES};
use crate::memory::{ROM, ROM_BYTES};

/// An instruction that did not complete.
enum Incomplete {
    Exception(u32, u32),
    Exit(Exit),
}

impl Cpu {
    /// Runs until `until` cycles have passed since the chip started, or something else ends the run.
    pub(crate) fn run(&mut self, bus: &mut impl Bus, until: u64) -> Exit {
        while self.cycles < until {
            let Some((region, index)) = place(self.pc) else {
                if self.pc.wrapping_sub(ROM) < ROM_BYTES {
                    return Exit::Elsewhere;
                }
                if let Some(exit) = self.raise(cause::FETCH_FAULT, self.pc) {
                    return exit;
                }
                continue;
            };
            let mut instruction = self.decoded[region][index];
            if instruction.kind == Kind::Unknown {
                instruction = self.decode(bus, region, index);
            }
            self.instructions += 1;
            if region == FLASH_REGION {
                self.tick.access(index);
                self.cycles += self.cache.read(index);
            }
            match self.execute(bus, instruction) {
                Ok(()) => {}
                Err(Incomplete::Exception(cause, value)) => {
                    if let Some(exit) = self.raise(cause, value) {
                        return exit;
                    }
                }
                Err(Incomplete::Exit(exit)) => return exit,
            }
        }
        Exit::Time
    }

    fn decode(&mut self, bus: &mut impl Bus, region: usize, index: usize) -> Instruction {
        let raw = bus.memory().fetch(self.pc).unwrap_or(0);
        let instruction = Instruction::decode(raw);
        self.decoded[region][index] = instruction;
        if region == 0 {
            let first = index * 2;
            self.holds_code[first >> PAGE_BITS] = true;
            // The second half may lie on the next page.
            if let Some(page) = self.holds_code.get_mut((first + 2) >> PAGE_BITS) {
                *page = true;
            }
        }
        instruction
    }

    /// Enters the exception handler; without one, the emulation ends.
    fn raise(&mut self, cause: u32, value: u32) -> Option<Exit> {
        if self.mtvec == 0 {
            let fault = Fault { trouble: Trouble::Exception { cause, value }, pc: self.pc };
            return Some(Exit::Fault(fault));
        }
        self.cycles += cost::INTERRUPT;
        self.enter(cause, value);
        None
    }

    #[inline(always)]
    fn execute(&mut self, bus: &mut impl Bus, instruction: Instruction) -> Result<(), Incomplete> {
        let pc = self.pc;
        let next = pc.wrapping_add(instruction.length());
        let a = self.x[(instruction.rs1 & 31) as usize];
        let b = self.x[instruction.rs2() as usize];
        let immediate = instruction.immediate as u32;
        let mut taken = cost::SIMPLE;
        let result = match instruction.kind {
            Kind::Lui => immediate,
            Kind::Auipc => pc.wrapping_add(immediate),
            Kind::Jal => {
                self.jump(instruction, pc.wrapping_add(immediate), next);
                return Ok(());
            }
            Kind::Jalr => {
                self.jump(instruction, a.wrapping_add(immediate) & !1, next);
                return Ok(());
            }
            Kind::Beq => return self.branch(a == b, immediate, next),
            Kind::Bne => return self.branch(a != b, immediate, next),
            Kind::Blt => return self.branch((a as i32) < b as i32, immediate, next),
            Kind::Bge => return self.branch(a as i32 >= b as i32, immediate, next),
            Kind::Bltu => return self.branch(a < b, immediate, next),
            Kind::Bgeu => return self.branch(a >= b, immediate, next),
            Kind::Lb => self.load(bus, a.wrapping_add(immediate), 1, &mut taken)? as i8 as u32,
            Kind::Lh => self.load(bus, a.wrapping_add(immediate), 2, &mut taken)? as i16 as u32,
            Kind::Lw => self.load(bus, a.wrapping_add(immediate), 4, &mut taken)?,
            Kind::Lbu => self.load(bus, a.wrapping_add(immediate), 1, &mut taken)?,
            Kind::Lhu => self.load(bus, a.wrapping_add(immediate), 2, &mut taken)?,
            Kind::Sb => return self.store_next(bus, a.wrapping_add(immediate), b, 1, next),
            Kind::Sh => return self.store_next(bus, a.wrapping_add(immediate), b, 2, next),
            Kind::Sw => return self.store_next(bus, a.wrapping_add(immediate), b, 4, next),
            Kind::Addi => a.wrapping_add(immediate),
            Kind::Slti => u32::from((a as i32) < immediate as i32),
            Kind::Sltiu => u32::from(a < immediate),
            Kind::Xori => a ^ immediate,
            Kind::Ori => a | immediate,
            Kind::Andi => a & immediate,
            Kind::Slli => a << (immediate & 31),
            Kind::Srli => a >> (immediate & 31),
            Kind::Srai => (a as i32 >> (immediate & 31)) as u32,
            Kind::Add => a.wrapping_add(b),
            Kind::Sub => a.wrapping_sub(b),
            Kind::Sll => a << (b & 31),
            Kind::Slt => u32::from((a as i32) < b as i32),
            Kind::Sltu => u32::from(a < b),
            Kind::Xor => a ^ b,
            Kind::Srl => a >> (b & 31),
            Kind::Sra => (a as i32 >> (b & 31)) as u32,
            Kind::Or => a | b,
            Kind::And => a & b,
            Kind::Mul => a.wrapping_mul(b),
            Kind::Mulh => ((i64::from(a as i32) * i64::from(b as i32)) >> 32) as u32,
            Kind::Mulhsu => ((i64::from(a as i32) * i64::from(b)) >> 32) as u32,
            Kind::Mulhu => ((u64::from(a) * u64::from(b)) >> 32) as u32,
            Kind::Div | Kind::Divu | Kind::Rem | Kind::Remu => {
                taken = cost::DIVIDE;
                divide(instruction.kind, a, b)
            }
            Kind::Fence => 0,
            Kind::LoadReserved => {
                let value = self.load(bus, a, 4, &mut taken)?;
                self.reservation = Some(a);
                value
            }
            Kind::StoreConditional => {
                let holds = self.reservation.take() == Some(a);
                if holds {
                    self.store(bus, a, b, 4, &mut taken)?;
                }
                u32::from(!holds)
            }
            Kind::AmoAdd
            | Kind::AmoSwap
            | Kind::AmoXor
            | Kind::AmoOr
            | Kind::AmoAnd
            | Kind::AmoMin
            | Kind::AmoMax
            | Kind::AmoMinu
            | Kind::AmoMaxu => {
                let old = self.load(bus, a, 4, &mut taken)?;
                self.store(bus, a, combine(instruction.kind, old, b), 4, &mut taken)?;
                old
            }
            Kind::Csr => {
                let result = self.access_csr(instruction, a)?;
                self.finish(instruction.rd, result, next, taken);
                // Interrupts may be enabled now.
                return self.noticing(self.mstatus & MSTATUS_MIE != 0);
            }
            Kind::Mret => {
                let previous = self.mstatus & MSTATUS_MPIE;
                self.mstatus = self.mstatus & !MSTATUS_MIE | previous >> 4 | MSTATUS_MPIE;
                self.cycles += cost::JUMP;
                self.pc = self.mepc;
                self.tick.leave();
                self.reservation = None;
                return self.noticing(previous != 0);
            }
            Kind::Wfi => {
                self.cycles += taken;
                self.pc = next;
                return Err(Incomplete::Exit(Exit::Wait));
            }
            Kind::Ecall => return Err(Incomplete::Exception(cause::ECALL, 0)),
            Kind::Ebreak => return Err(Incomplete::Exception(cause::BREAKPOINT, pc)),
            Kind::Host => return Err(Incomplete::Exit(Exit::Host(instruction.immediate))),
            Kind::Illegal | Kind::Unknown => {
                return Err(Incomplete::Exception(cause::ILLEGAL, immediate));
            }
        };
        self.finish(instruction.rd, result, next, taken);
        Ok(())
    }

    #[inline(always)]
    fn finish(&mut self, rd: u8, result: u32, next: u32, cycles: u64) {
        self.x[(rd & 63) as usize] = result;
        self.pc = next;
        self.cycles += cycles;
    }

    fn noticing(&mut self, may_interrupt: bool) -> Result<(), Incomplete> {
        if may_interrupt { Err(Incomplete::Exit(Exit::Attention)) } else { Ok(()) }
    }

    #[inline(always)]
    fn jump(&mut self, instruction: Instruction, target: u32, next: u32) {
        self.jumps_at = (self.jumps_at + 1) % JUMPS;
        self.jumps[self.jumps_at] = self.pc;
        self.finish(instruction.rd, next, target, cost::JUMP);
    }

    #[inline(always)]
    fn branch(&mut self, is_taken: bool, offset: u32, next: u32) -> Result<(), Incomplete> {
        if is_taken {
            self.pc = self.pc.wrapping_add(offset);
            self.cycles += cost::JUMP;
        } else {
            self.pc = next;
            self.cycles += cost::SIMPLE;
        }
        Ok(())
    }

    #[inline(always)]
    fn load(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: u32,
        taken: &mut u64,
    ) -> Result<u32, Incomplete> {
        *taken = cost::LOAD;
        let memory = bus.memory();
        let (bytes, offset) = match address.wrapping_sub(RAM) as usize {
            offset if offset < RAM_BYTES => (&memory.ram[..], offset),
            _ => match address.wrapping_sub(FLASH) as usize {
                offset if offset < FLASH_BYTES => {
                    self.tick.access(offset / 2);
                    *taken += self.cache.read(offset / 2);
                    (&memory.flash[..], offset)
                }
                _ => return self.load_elsewhere(bus, address, size, taken),
            },
        };
        let value = match (bytes.get(offset..offset + size as usize), size) {
            (Some(bytes), 4) => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
            (Some(bytes), 2) => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            (Some(bytes), _) => u32::from(bytes[0]),
            (None, _) => return Err(Incomplete::Exception(cause::LOAD_FAULT, address)),
        };
        Ok(value)
    }

    #[cold]
    fn load_elsewhere(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: u32,
        taken: &mut u64,
    ) -> Result<u32, Incomplete> {
        if let Some(value) = bus.memory().load(address, size) {
            return Ok(value);
        }
        if !address.is_multiple_of(size) {
            return Err(Incomplete::Exception(cause::LOAD_MISALIGNED, address));
        }
        *taken = cost::PERIPHERAL_READ;
        let access = self.access();
        bus.load(address, size, access).map_err(|refusal| match refusal {
            Refusal::Nothing => Incomplete::Exception(cause::LOAD_FAULT, address),
            Refusal::Fault(fault) => Incomplete::Exit(Exit::Fault(fault)),
        })
    }

    #[inline(always)]
    fn store_next(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        value: u32,
        size: u32,
        next: u32,
    ) -> Result<(), Incomplete> {
        let mut taken = 0;
        let attention = self.store(bus, address, value, size, &mut taken)?;
        self.cycles += taken;
        self.pc = next;
        self.noticing(attention)
    }

    /// Stores; whether the run has to stop to look at interrupts.
    #[inline(always)]
    fn store(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        value: u32,
        size: u32,
        taken: &mut u64,
    ) -> Result<bool, Incomplete> {
        *taken = cost::STORE;
        let offset = address.wrapping_sub(RAM) as usize;
        if offset >= RAM_BYTES {
            return self.store_elsewhere(bus, address, value, size, taken);
        }
        let memory = bus.memory();
        let Some(bytes) = memory.ram.get_mut(offset..offset + size as usize) else {
            return Err(Incomplete::Exception(cause::STORE_FAULT, address));
        };
        match size {
            4 => bytes.copy_from_slice(&value.to_le_bytes()),
            2 => bytes.copy_from_slice(&(value as u16).to_le_bytes()),
            _ => bytes[0] = value as u8,
        }
        if self.holds_code[offset >> PAGE_BITS] {
            self.forget_page(offset >> PAGE_BITS);
        }
        Ok(false)
    }

    /// An access by the present instruction.
    fn access(&self) -> Access {
        Access { time: self.cycles, pc: self.pc, is_interruptible: self.takes_interrupts() }
    }

    #[cold]
    fn store_elsewhere(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        value: u32,
        size: u32,
        taken: &mut u64,
    ) -> Result<bool, Incomplete> {
        if bus.memory().store(address, value, size).is_some() {
            return Ok(false);
        }
        if !address.is_multiple_of(size) {
            return Err(Incomplete::Exception(cause::STORE_MISALIGNED, address));
        }
        *taken = cost::PERIPHERAL_WRITE;
        let access = self.access();
        bus.store(address, value, size, access).map_err(|refusal| match refusal {
            Refusal::Nothing => Incomplete::Exception(cause::STORE_FAULT, address),
            Refusal::Fault(fault) => Incomplete::Exit(Exit::Fault(fault)),
        })?;
        Ok(bus.wants_attention())
    }

    fn access_csr(&mut self, instruction: Instruction, a: u32) -> Result<u32, Incomplete> {
        let number = instruction.immediate as u16;
        let funct3 = instruction.rs2();
        let illegal = || Incomplete::Exception(cause::ILLEGAL, u32::from(number) << 20);
        let old = self.read_csr(number, self.cycles).ok_or_else(illegal)?;
        let operand = if funct3 & 4 != 0 { u32::from(instruction.rs1) } else { a };
        let new = match funct3 & 3 {
            1 => Some(operand),
            2 => (instruction.rs1 != 0).then_some(old | operand),
            _ => (instruction.rs1 != 0).then_some(old & !operand),
        };
        if let Some(new) = new
            && !self.write_csr(number, new)
        {
            return Err(illegal());
        }
        Ok(old)
    }
}

/// Division as the specification defines it for zero and for overflow.
fn divide(kind: Kind, a: u32, b: u32) -> u32 {
    match kind {
        Kind::Div if b == 0 => u32::MAX,
        Kind::Div => (a as i32).wrapping_div(b as i32) as u32,
        Kind::Divu => a.checked_div(b).unwrap_or(u32::MAX),
        Kind::Rem if b == 0 => a,
        Kind::Rem => (a as i32).wrapping_rem(b as i32) as u32,
        _ => a.checked_rem(b).unwrap_or(a),
    }
}

/// What an atomic operation leaves in memory.
fn combine(kind: Kind, old: u32, operand: u32) -> u32 {
    match kind {
        Kind::AmoAdd => old.wrapping_add(operand),
        Kind::AmoXor => old ^ operand,
        Kind::AmoOr => old | operand,
        Kind::AmoAnd => old & operand,
        Kind::AmoMin => (old as i32).min(operand as i32) as u32,
        Kind::AmoMax => (old as i32).max(operand as i32) as u32,
        Kind::AmoMinu => old.min(operand),
        Kind::AmoMaxu => old.max(operand),
        _ => operand,
    }
}
