//! Register windows: frames that do not fit are saved and fetched by the program's own handlers.

use super::{Code, DATA, add, addi, movi, rri8, rrr, run, simcall, wide};
use flix_lx6::memory::Memory;
use flix_lx6::processor::{Clock, Core, REGISTERS, Trouble};

/// Where the handlers are.
const VECTORS: u32 = 0x400;
/// Where the recursive program is: beyond 1 GiB, as the ESP32's. The upper two bits of an address are the caller's.
const FAR: u32 = 0x6000_1000;
/// Distance from one to the next.
const SPACING: usize = 0x40;

/// `l32e` (0) or `s32e` (4), so many words below the register.
fn frame(operation: u32, t: u32, s: u32, words: u32) -> Code {
    rrr(9, operation, 16 - words, s, t)
}

/// Handlers for frames of 4, 8 and 12 registers, overflow and underflow of each in turn (manual, section 4.7.1.4): the first four
/// registers go below the next frame's stack, the rest below the caller's.
fn vectors() -> Vec<u8> {
    let mut vectors = Vec::new();
    for groups in 1..=3_u32 {
        let next = groups * 4 + 1;
        // The caller's stack pointer lies three words below the frame's own.
        let rest: Vec<(u32, u32)> = (4..groups * 4).map(|t| (t, 4 * groups - t + 4)).collect();
        let mut overflow: Vec<Code> = vec![frame(4, 0, next, 4)];
        if groups > 1 {
            overflow.push(frame(0, 0, 1, 3));
        }
        overflow.extend((1..4).map(|t| frame(4, t, next, 4 - t)));
        overflow.extend(rest.iter().map(|(t, words)| frame(4, *t, 0, *words)));
        overflow.push(rrr(0, 0, 3, 4, 0));
        let last = groups * 4 - 1;
        let mut underflow: Vec<Code> = vec![];
        if groups > 1 {
            underflow.extend([frame(0, 1, next, 3), frame(0, last, 1, 3)]);
        }
        underflow.extend((0..4).map(|t| frame(0, t, next, 4 - t)));
        underflow.extend(rest.iter().map(|(t, words)| frame(0, *t, last, *words)));
        underflow.push(rrr(0, 0, 3, 5, 0));
        for handler in [overflow, underflow] {
            let mut handler = handler.concat();
            assert!(handler.len() <= SPACING);
            handler.resize(SPACING, 0);
            vectors.extend(handler);
        }
    }
    vectors
}

/// A program that turns windows on and calls a function, which sums up to its argument by calling itself with windows turned by
/// `groups` each time.
fn program(groups: u32, depth: i32) -> Vec<u8> {
    let (argument, link) = (groups * 4 + 2, groups << 4 | 5);
    let special = |number: u32, t| rrr(3, 1, number >> 4, number & 15, t);
    let start: Vec<Code> = vec![
        movi(2, 1),
        rrr(1, 0, 2, 2, 32 - 18),
        movi(3, VECTORS as i32),
        special(231, 3),
        movi(4, 1),
        special(73, 4),
        special(230, 2),
        movi(argument, depth),
        // To the function behind the next two instructions; both addresses are multiples of 4.
        wide(link),
        add(2, argument, argument),
        simcall(),
    ];
    let mut start = start.concat();
    let call_at = 8 * 3;
    let function = start.len().next_multiple_of(4);
    let distance = (function / 4 - call_at / 4 - 1) as u32;
    start[call_at..call_at + 3].copy_from_slice(&wide(link | distance << 6));
    start.resize(function, 0);
    // entry a1, 64; beqz.n a2, end; addi argument, a2, -1; call function; add a2, a2, result; end: retw.n
    let entry = wide(8 << 12 | 1 << 8 | 0x36);
    let back = -(8_i32 / 4 + 1);
    let call = wide(link | (back.cast_unsigned() & 0x3_ffff) << 6);
    let over = vec![0x8c, 0x72];
    let body = [entry, over, addi(argument, 2, -1), call, add(2, 2, argument), vec![0x1d, 0xf0]];
    [start, body.concat()].concat()
}

fn machine(groups: u32, depth: i32, registers: usize) -> (Core, Memory) {
    let mut memory = Memory::of(vec![
        (FAR, program(groups, depth), true),
        (VECTORS, vectors(), true),
        (DATA, vec![0; super::DATA_BYTES], false),
    ]);
    let mut core = Core::new(memory.entry, registers, Clock::CYCLES);
    // The first frame has no caller: what its handler saves goes below its own stack.
    let stack_pointer = DATA + super::DATA_BYTES as u32 - 64;
    core.set(1, stack_pointer);
    memory.write::<4>(stack_pointer - 12, stack_pointer);
    (core, memory)
}

#[test]
fn frames_of_every_size_are_saved_and_fetched_however_deep_the_calls_are() {
    for (groups, depth) in
        [1, 2, 3].into_iter().flat_map(|groups| [0, 1, 5, 17, 60].map(|depth| (groups, depth)))
    {
        for registers in [32, REGISTERS] {
            let (mut core, mut memory) = machine(groups, depth, registers);
            run(&mut core, &mut memory).expect("nothing else");
            let sum = (0..=depth).sum::<i32>().cast_unsigned();
            assert_eq!(
                core.get(2),
                2 * sum,
                "{groups} groups, depth {depth}, {registers} registers"
            );
            let fits = (depth.cast_unsigned() + 1) * groups < registers as u32 / 4;
            assert_eq!(core.windows == 0, fits, "{groups} groups, depth {depth}: {}", core.windows);
        }
    }
}

#[test]
fn a_return_without_a_frame_is_refused() {
    let (mut core, mut memory) = super::machine(&[vec![0x1d, 0xf0]]);
    assert_eq!(run(&mut core, &mut memory).unwrap_err().trouble, Trouble::Windows);
    let (mut core, mut memory) = super::machine(&[rri8(6, 1, 1, 3, 0)]);
    assert_eq!(
        run(&mut core, &mut memory).unwrap_err().trouble,
        Trouble::Windows,
        "entry in an exception"
    );
}

#[test]
fn frames_that_the_manual_leaves_undefined_are_refused() {
    let special = |number: u32, t| rrr(3, 1, number >> 4, number & 15, t);
    let retw = || vec![0x1d, 0xf0];
    let entry = |s: u32| wide(4 << 12 | s << 8 | 0x36);
    // PS with windows, and in an exception besides; a0; the instruction.
    for (state, link, instruction) in [
        (1 << 18, 0, retw()),
        (1 << 18 | 16, 1 << 30, retw()),
        (0, 1 << 30, retw()),
        (1 << 18, 2 << 30, retw()),
        (1 << 18, 0, entry(4)),
        (1 << 18 | 16, 0, entry(1)),
        (0, 0, entry(1)),
    ] {
        // The caller is one group behind.
        let program = [special(73, 5), special(230, 6), instruction, simcall()];
        let (mut core, mut memory) = super::machine(&program);
        for (register, value) in [(0, link), (5, 1 << 15 | 1), (6, state)] {
            core.set(register, value);
        }
        let refused = run(&mut core, &mut memory).map_err(|fault| fault.trouble);
        assert_eq!(refused, Err(Trouble::Windows), "{state:#x} and {link:#x}");
    }
}

#[test]
fn a_call_leaves_how_far_it_turns_above_where_it_comes_from() {
    for turn in 1..=3 {
        for call in [wide(turn << 4 | 5 | 1 << 6), wide(2 << 8 | (12 + turn) << 4)] {
            let code = [call, vec![0xff; 5], simcall()].concat();
            let mut memory = Memory::of(vec![(FAR, code, true)]);
            let mut core = Core::new(FAR, REGISTERS, Clock::CYCLES);
            core.set(2, FAR + 8);
            run(&mut core, &mut memory).expect("it is called");
            assert_eq!(core.get(turn as u8 * 4), turn << 30 | 0x2000_1003, "{turn}");
            let state = core.special(flix_lx6::processor::special::PS);
            assert_eq!(state.map(|bits| bits >> 16 & 3), Some(turn));
        }
    }
}

#[test]
fn a_window_turns_by_hand_and_a_stack_pointer_moves_above_a_caller_that_is_in_registers_alone() {
    let special = |number: u32, t| rrr(3, 1, number >> 4, number & 15, t);
    let turned = super::after(&[(4, 7)], &[rrr(0, 4, 8, 0, 1), movi(1, 3), rrr(0, 4, 8, 0, 15)]);
    assert_eq!((turned.get(4), turned.get(5)), (7, 3));
    // `movsp`: the caller one, two or three groups behind, and none.
    for (frames, is_moved) in [(1 << 15, true), (1 << 14, true), (1 << 13, true), (1 << 12, false)]
    {
        let program = [special(73, 4), rrr(0, 0, 1, 5, 3), simcall()];
        let (mut core, mut memory) = super::machine(&program);
        core.set(4, frames | 1);
        core.set(5, 9);
        let outcome = run(&mut core, &mut memory).map_err(|fault| fault.trouble);
        let expected = if is_moved { Ok(()) } else { Err(Trouble::Alloca) };
        assert_eq!((outcome, core.get(3) == 9), (expected, is_moved), "{frames:#x}");
    }
}
