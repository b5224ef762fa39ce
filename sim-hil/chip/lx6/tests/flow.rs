//! Branches, loops and memory.

use super::{Code, DATA, add, addi, after, machine, movi, nop, rri8, rrr, run};
use flix_lx6::cost;
use flix_lx6::processor::{Trouble, special};

/// `loop` (8), `loopnez` (9), `loopgtz` (10) over so many bytes.
fn looping(kind: u32, s: u32, bytes: i32) -> Code {
    rri8(6, kind, s, 7, bytes - 1)
}

#[test]
fn a_loop_runs_as_often_as_its_register_says() {
    for (kind, count, times) in
        [(8, 1, 1), (8, 5, 5), (9, 0, 0), (9, 5, 5), (10, 5, 5), (10, 0, 0), (10, -1, 0)]
    {
        let body = [addi(3, 3, 1), nop()];
        let program = [vec![movi(4, count), looping(kind, 4, 5)], body.to_vec()].concat();
        // In an exception, as after reset, no loop goes round.
        assert_eq!(after(&[], &program).get(3), times.min(1), "loop {kind} of {count}");
        let program = [clear_exception(), program].concat();
        let core = after(&[], &program);
        assert_eq!(core.get(3), times, "loop {kind} of {count}");
        assert_eq!(
            core.cycles,
            core.instructions + cost::SYNCHRONIZE + if times == 0 { cost::TAKEN } else { 0 }
        );
    }
}

/// `wsr`: a register to a special one.
fn special(number: u8, t: u32) -> Code {
    rrr(3, 1, (number >> 4).into(), (number & 15).into(), t)
}

/// Leaves the exception that a processor is in after reset.
fn clear_exception() -> Vec<Code> {
    vec![movi(2, 0), special(special::PS, 2)]
}

#[test]
fn a_branch_to_a_loops_end_leaves_it() {
    // The branch stands before the last instruction; its target is behind that.
    let body = [addi(3, 3, 1), rri8(7, 1, 3, 5, 1), nop()];
    let program =
        [clear_exception(), vec![movi(4, 10), movi(5, 4), looping(8, 4, 8)], body.to_vec()]
            .concat();
    let core = after(&[], &program);
    assert_eq!(core.get(3), 4);
    assert_eq!(core.special(special::LCOUNT), Some(6));
}

#[test]
fn a_loop_goes_round_behind_a_branch_that_is_not_taken_and_ends_behind_one_that_is() {
    // The branch is the last instruction of the loop; it leaves when the count reaches its register, over an instruction.
    let body = [addi(3, 3, 1), rri8(7, 1, 3, 5, 2)];
    for (limit, times, behind) in [(4, 4, 0), (20, 10, 1)] {
        let start = vec![movi(4, 10), movi(5, limit), looping(8, 4, 6)];
        let program = [clear_exception(), start, body.to_vec(), vec![movi(6, 1)]].concat();
        let core = after(&[], &program);
        let left = core.special(special::LCOUNT);
        assert_eq!((core.get(3), core.get(6), left), (times, behind, Some(10 - times)));
    }
}

#[test]
fn branches_that_compare_are_taken_when_the_manual_says() {
    type Condition = fn(u32, u32) -> bool;
    let conditions: [(u32, Condition); 12] = [
        (0, |s, t| s & t == 0),
        (1, |s, t| s == t),
        (2, |s, t| s.cast_signed() < t.cast_signed()),
        (3, |s, t| s < t),
        (4, |s, t| s & t == t),
        (5, |s, t| s >> (t & 31) & 1 == 0),
        (8, |s, t| s & t != 0),
        (9, |s, t| s != t),
        (10, |s, t| s.cast_signed() >= t.cast_signed()),
        (11, |s, t| s >= t),
        (12, |s, t| s & t != t),
        (13, |s, t| s >> (t & 31) & 1 == 1),
    ];
    let values = [0, 1, 2, 5, 0x7fff_ffff, 0x8000_0000, u32::MAX];
    for (kind, condition) in conditions {
        for (s, t) in values.iter().flat_map(|s| values.map(|t| (*s, t))) {
            // Over an instruction that sets a register.
            let core = after(&[(4, s), (5, t)], &[rri8(7, kind, 4, 5, 2), movi(3, 1)]);
            assert_eq!(core.get(3) == 0, condition(s, t), "branch {kind} of {s:#x} and {t:#x}");
        }
    }
    for (index, constant) in
        [-1, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 32, 64, 128, 256].into_iter().enumerate()
    {
        for (m, condition) in [
            (0, (|s, t| s == t) as fn(i32, i32) -> bool),
            (1, |s, t| s != t),
            (2, |s, t| s < t),
            (3, |s, t| s >= t),
        ] {
            for s in [constant - 1_i32, constant, constant + 1] {
                let code = rri8(6, index as u32, 4, m << 2 | 2, 2);
                let core = after(&[(4, s.cast_unsigned())], &[code, movi(3, 1)]);
                assert_eq!(core.get(3) == 0, condition(s, constant), "{m} of {s} and {constant}");
            }
        }
    }
}

#[test]
fn memory_is_read_as_it_was_written_signed_and_unsigned() {
    let program = [
        rri8(2, 6, 4, 5, 1),
        rri8(2, 1, 4, 6, 3),
        rri8(2, 9, 4, 7, 3),
        rri8(2, 0, 4, 8, 7),
        rri8(2, 4, 4, 5, 3),
        rri8(2, 2, 4, 10, 0),
        rri8(2, 4, 4, 5, 0),
        rri8(2, 5, 4, 5, 1),
        rri8(2, 2, 4, 9, 0),
    ];
    let core = after(&[(4, DATA), (5, 0x8765_4321)], &program);
    assert_eq!(
        [6, 7, 8, 9, 10].map(|register| core.get(register)),
        [0x8765, 0xffff_8765, 0x87, 0x4321_0021, 0x2100_0000]
    );
}

#[test]
fn comparing_and_storing_in_one_stores_only_what_was_expected() {
    let program = [special(special::SCOMPARE1, 6), rri8(2, 14, 4, 5, 3), rri8(2, 2, 4, 7, 3)];
    for (expected, left) in [(0, 9), (1, 0)] {
        let core = after(&[(4, DATA), (5, 9), (6, expected)], &program);
        assert_eq!([5, 7].map(|register| core.get(register)), [0, left]);
    }
}

#[test]
fn what_is_not_emulated_ends_the_run_with_its_place() {
    for (name, code, trouble) in [
        ("floating point", rrr(10, 0, 3, 4, 5), Trouble::Instruction(0x0a_3450)),
        ("multiply and add", rri8(4, 0, 0, 0, 0x34), Trouble::Instruction(0x34_0004)),
        ("a load beside a word", rri8(2, 2, 4, 3, 0), Trouble::Memory(DATA + 1)),
        ("a load beside a half", rri8(2, 1, 4, 3, 0), Trouble::Memory(DATA + 1)),
        ("a signed load beside a half", rri8(2, 9, 4, 3, 0), Trouble::Memory(DATA + 1)),
        ("a store beside a half", rri8(2, 5, 4, 3, 0), Trouble::Memory(DATA + 1)),
        ("a store into code", rri8(2, 6, 5, 3, 0), Trouble::Memory(super::CODE)),
        ("a division by zero", rrr(2, 12, 3, 4, 6), Trouble::Division),
        (
            "an interrupt let in",
            special(special::INTENABLE, 4),
            Trouble::Special { number: special::INTENABLE, value: DATA + 1 },
        ),
    ] {
        let (mut core, mut memory) = machine(&[add(3, 3, 3), code]);
        core.set(4, DATA + 1);
        core.set(5, super::CODE);
        let fault = run(&mut core, &mut memory).unwrap_err();
        assert_eq!((fault.trouble, fault.pc), (trouble, super::CODE + 3), "{name}");
    }
}
