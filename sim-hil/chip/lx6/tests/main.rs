//! What the core promises, by programs of a few instructions, put together here by the formats of the Xtensa Instruction Set
//! Architecture Reference Manual, section 7.3.

mod arithmetic;
mod beside;
mod cycles;
mod flow;
mod formats;
mod windows;

use flix_lx6::memory::Memory;
use flix_lx6::processor::{Clock, Core, Fault, REGISTERS, Step};

/// Where programs and data begin.
const CODE: u32 = 0x1000;
const DATA: u32 = 0x8000;
const DATA_BYTES: usize = 0x4000;

/// An instruction's bytes.
type Code = Vec<u8>;

fn wide(word: u32) -> Code {
    word.to_le_bytes()[..3].to_vec()
}

/// Format RRR.
fn rrr(op1: u32, op2: u32, r: u32, s: u32, t: u32) -> Code {
    wide(op2 << 20 | op1 << 16 | r << 12 | s << 8 | t << 4)
}

/// Format RRI8, whose operation is `r`.
fn rri8(op0: u32, r: u32, s: u32, t: u32, immediate: i32) -> Code {
    wide((immediate.cast_unsigned() & 0xff) << 16 | r << 12 | s << 8 | t << 4 | op0)
}

fn movi(t: u32, value: i32) -> Code {
    let bits = value.cast_unsigned();
    rri8(2, 10, bits >> 8 & 15, t, value)
}

fn addi(t: u32, s: u32, value: i32) -> Code {
    rri8(2, 12, s, t, value)
}

fn add(r: u32, s: u32, t: u32) -> Code {
    rrr(0, 8, r, s, t)
}

/// Waits for nothing and does nothing.
fn nop() -> Code {
    vec![0x3d, 0xf0]
}

fn simcall() -> Code {
    vec![0x00, 0x51, 0x00]
}

/// A core and a memory with this program, and data behind it.
fn machine(program: &[Code]) -> (Core, Memory) {
    let code = program.concat();
    let memory = Memory::of(vec![(CODE, code, true), (DATA, vec![0; DATA_BYTES], false)]);
    (Core::new(memory.entry, REGISTERS, Clock::CYCLES), memory)
}

/// Runs to the program's first `simcall`, or to what it cannot do.
fn run(core: &mut Core, memory: &mut Memory) -> Result<(), Fault> {
    for _ in 0..100_000 {
        if core.step(memory)? == Step::Simcall {
            return Ok(());
        }
    }
    panic!("the program does not end");
}

/// Runs a program with these registers to its end; returns the core.
fn after(registers: &[(u8, u32)], program: &[Code]) -> Core {
    let (mut core, mut memory) = machine(&[program, &[simcall()]].concat());
    registers.iter().for_each(|(register, value)| core.set(*register, *value));
    run(&mut core, &mut memory).expect("the program does what is emulated");
    core
}
