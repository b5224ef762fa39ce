//! The calls that led to a place, read off a RISC-V stack without frame pointers.
//!
//! A called function keeps on the stack where it returns to: behind the instruction that called it. So each word of the
//! stack that points behind a call may be such an address. Words that earlier calls left behind look the same: a list found
//! so has all calls of which the stack still shows, and may have some that were over.

use flix_protocol::message::ProgramCounters;

/// Registers that calls leave their return address in: `ra`.
const RETURN_ADDRESS: u32 = 1;

/// Returns the addresses of the calls that the words of a stack point behind, topmost word first, as many as there is room
/// for; each once in a row.
///
/// `code` returns the two bytes of program at an even address, little-endian, or `None` where there is no program. Never
/// panics.
pub fn calls(
    stack: impl Iterator<Item = u32>,
    code: impl Fn(u32) -> Option<u16>,
) -> ProgramCounters {
    let mut calls = ProgramCounters::new();
    for call in stack.filter_map(|word| call_before(word, &code)) {
        if calls.last() != Some(&call) && calls.push(call).is_err() {
            break;
        }
    }
    calls
}

/// Returns the address of the call that ends just before this address.
fn call_before(address: u32, code: &impl Fn(u32) -> Option<u16>) -> Option<u32> {
    if !address.is_multiple_of(2) {
        return None;
    }
    let (short, long) = (address.checked_sub(2)?, address.checked_sub(4)?);
    // The return goes to program too.
    code(address)?;
    let high = code(short)?;
    let low = code(long);
    if low.is_some_and(|low| is_long_call(u32::from(high) << 16 | u32::from(low))) {
        return Some(long);
    }
    is_short_call(high).then_some(short)
}

/// `jal ra` and `jalr ra`.
fn is_long_call(instruction: u32) -> bool {
    let returns_by_ra = instruction >> 7 & 0x1F == RETURN_ADDRESS;
    let is_jal = instruction & 0x7F == 0x6F;
    let is_jalr = instruction & 0x707F == 0x67;
    returns_by_ra && (is_jal || is_jalr)
}

/// `c.jal` and `c.jalr`.
fn is_short_call(instruction: u16) -> bool {
    let is_jal = instruction & 0xE003 == 0x2001;
    // Without a register it is `c.ebreak`.
    let is_jalr = instruction & 0xF07F == 0x9002 && instruction & 0x0F80 != 0;
    is_jal || is_jalr
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use bolero::check;

    use super::*;

    const BASE: u32 = 0x4200_0000;
    /// As `llvm-mc -triple=riscv32 -mattr=+c` encodes them.
    const PROGRAM: [u16; 14] = [
        0x1141, // 0x00: c.addi sp, -16
        0x00EF, 0x0100, // 0x02: jal ra, 16
        0x0001, // 0x06: c.nop
        0x80E7, 0x0005, // 0x08: jalr ra, 0(a1)
        0x9582, // 0x0C: c.jalr a1
        0x2011, // 0x0E: c.jal 4
        0x9002, // 0x10: c.ebreak
        0x8067, 0x0000, // 0x12: jalr zero, 0(ra): a return
        0x006F, 0x0100, // 0x16: jal zero, 16: a jump
        0x0001, // 0x1A: c.nop
    ];

    fn code(address: u32) -> Option<u16> {
        PROGRAM.get(address.checked_sub(BASE)? as usize / 2).copied()
    }

    fn found(stack: &[u32]) -> Vec<u32> {
        let calls = calls(stack.iter().map(|offset| BASE.wrapping_add(*offset)), code);
        calls.iter().map(|call| call - BASE).collect()
    }

    #[test]
    fn words_behind_calls_of_every_kind_are_found_in_order() {
        assert_eq!(found(&[0x10, 0x0E, 0x0C, 0x06]), [0x0E, 0x0C, 0x08, 0x02]);
    }

    #[test]
    fn nothing_else_is_a_call() {
        // Behind other instructions, in the middle of one, odd, before and after the program.
        assert_eq!(found(&[0x02, 0x08, 0x0A, 0x12, 0x16, 0x1A, 0x07, 0, u32::MAX, 0x1C, 0x20]), []);
    }

    #[test]
    fn a_call_that_several_words_in_a_row_tell_is_listed_once() {
        assert_eq!(found(&[0x06, 0, 0x06, 0x0C, 0x06]), [0x02, 0x08, 0x02]);
    }

    #[test]
    fn only_the_topmost_calls_are_kept() {
        let stack = [0x06, 0x0C].repeat(20);
        assert_eq!(found(&stack), [0x02, 0x08].repeat(6));
    }

    #[test]
    fn any_stack_and_any_program_are_read() {
        check!().with_type::<(Vec<u32>, u16)>().for_each(|(stack, instruction)| {
            for call in calls(stack.iter().copied(), |_| Some(*instruction)) {
                assert!(stack.iter().any(|word| (2..=4).contains(&word.wrapping_sub(call))));
            }
        });
    }
}
