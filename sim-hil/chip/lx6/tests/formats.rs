//! Instructions whose fields lie elsewhere: narrow ones, branches on zero, bits and booleans, jumps, calls, literals.

use super::{CODE, Code, DATA, add, addi, after, movi, nop, rri8, rrr, wide};
use flix_lx6::processor::special;

/// A narrow instruction.
fn narrow(op0: u32, r: u32, s: u32, t: u32) -> Code {
    wide(r << 12 | s << 8 | t << 4 | op0)[..2].to_vec()
}

/// What all registers are after this program, with a different number in each before it, and data in `a4`.
fn registers(program: &[Code]) -> [u32; 16] {
    let before: Vec<(u8, u32)> =
        (0..16).map(|register| (register, 0x0101_0101 * u32::from(register))).collect();
    let core = after(&[&before[..], &[(4, DATA)]].concat(), program);
    std::array::from_fn(|register| core.get(register as u8))
}

#[test]
fn narrow_instructions_do_what_wide_ones_do() {
    let load = |offset| rri8(2, 2, 4, 9, offset / 4);
    let pairs: [(Code, Code); 5] = [
        (narrow(10, 3, 5, 6), add(3, 5, 6)),
        (narrow(11, 3, 5, 15), addi(3, 5, 15)),
        (narrow(11, 3, 5, 0), addi(3, 5, -1)),
        (narrow(13, 0, 5, 3), rrr(0, 2, 3, 5, 5)),
        (narrow(12, 15, 3, 7), movi(3, -1)),
    ];
    for (narrow, wide) in pairs {
        assert_eq!(registers(std::slice::from_ref(&narrow)), registers(&[wide]), "{narrow:x?}");
    }
    for words in 0..16 {
        let offset = words as i32 * 4;
        let [stored, stored_wide] = [narrow(9, words, 4, 7), rri8(2, 6, 4, 7, offset / 4)];
        let found = registers(&[stored.clone(), load(offset)]);
        assert_eq!(found, registers(&[stored_wide, load(offset)]));
        assert_eq!(registers(&[stored, narrow(8, words, 4, 9)]), found, "{words} words");
    }
}

/// Returns whether the branch over an instruction that sets a register is taken; its constant is 2 of a wide one and 1 of a narrow.
fn is_taken(value: u32, booleans: u32, branch: Code) -> bool {
    let set = rrr(3, 1, 0, u32::from(special::BR), 6);
    after(&[(4, value), (6, booleans)], &[set, branch, movi(3, 1)]).get(3) == 0
}

#[test]
fn branches_on_zero_and_sign_are_taken_when_the_manual_says() {
    for value in [0, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX] {
        let sign = value.cast_signed();
        for (m, condition) in [(0, value == 0), (1, value != 0), (2, sign < 0), (3, sign >= 0)] {
            let branch = wide(2 << 12 | 4 << 8 | m << 6 | 1 << 4 | 6);
            assert_eq!(is_taken(value, 0, branch), condition, "{m} of {value:#x}");
        }
        for (t, condition) in [(8, value == 0), (12, value != 0)] {
            assert_eq!(is_taken(value, 0, narrow(12, 1, 4, t)), condition, "{t} of {value:#x}");
        }
    }
}

#[test]
fn branches_on_a_bit_or_a_boolean_are_taken_when_the_manual_says() {
    let pattern = 0x8421_a5c3;
    for number in 0..32 {
        let is_set = pattern >> number & 1 == 1;
        let bit = |r: u32| rri8(7, r | number >> 4, 4, number & 15, 2);
        assert_eq!(is_taken(pattern, 0, bit(6)), !is_set, "bbci {number}");
        assert_eq!(is_taken(pattern, 0, bit(14)), is_set, "bbsi {number}");
    }
    for number in 0..16 {
        let is_set = 0xa5c3 >> number & 1 == 1;
        let boolean = |r| rri8(6, r, number, 7, 2);
        assert_eq!(is_taken(0, 0xa5c3, boolean(0)), !is_set, "bf {number}");
        assert_eq!(is_taken(0, 0xa5c3, boolean(1)), is_set, "bt {number}");
        let set = rrr(3, 1, 0, u32::from(special::BR), 6);
        for (op2, moves) in [(12, !is_set), (13, is_set)] {
            let moved = after(&[(5, 7), (6, 0xa5c3)], &[set.clone(), rrr(3, op2, 3, 5, number)]);
            assert_eq!(moved.get(3) == 7, moves, "movf or movt {number}");
        }
    }
}

#[test]
fn branches_with_an_unsigned_constant_are_taken_when_the_manual_says() {
    let constants = [32_768, 65_536, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 32, 64, 128, 256_u32];
    for (index, constant) in (0..).zip(constants) {
        for value in [0, constant - 1, constant, constant + 1, u32::MAX] {
            for (m, condition) in [(2, value < constant), (3, value >= constant)] {
                let branch = rri8(6, index, 4, m << 2 | 3, 2);
                assert_eq!(is_taken(value, 0, branch), condition, "{m} of {value} and {constant}");
            }
        }
    }
}

#[test]
fn jumps_go_where_they_say_and_calls_leave_where_they_come_from() {
    // Each over a word that no core knows, to an address that is a multiple of 4.
    let unknown = || vec![0xff; 5];
    let at = CODE + 8;
    for (name, jump, link) in [
        ("j", wide(4 << 6 | 6), 0x77),
        ("jx", wide(5 << 8 | 10 << 4), 0x77),
        ("call0", wide(1 << 6 | 5), CODE + 3),
        ("callx0", wide(5 << 8 | 12 << 4), CODE + 3),
    ] {
        let core = after(&[(0, 0x77), (5, at)], &[jump, unknown(), movi(3, 9)]);
        assert_eq!((core.get(3), core.get(0)), (9, link), "{name}");
    }
    for (name, back) in [("ret", wide(8 << 4)), ("ret.n", narrow(13, 15, 0, 0))] {
        let over = vec![0xff; 8 - back.len()];
        assert_eq!(after(&[(0, at)], &[back, over, movi(3, 9)]).get(3), 9, "{name}");
    }
    // Backwards, from an address that is no multiple of 4, to the end, which stands before it.
    let back = wide((-2_i32).cast_unsigned() << 6 & 0xff_ffff | 5);
    let core = after(&[], &[wide(5 << 6 | 6), vec![0], super::simcall(), nop(), back]);
    assert_eq!((core.get(0), core.instructions), (CODE + 12, 3));
}

#[test]
fn a_literal_is_the_word_so_far_before_the_next_multiple_of_four() {
    // Over two words; then a load from each place in a word.
    let words = [0x1234_5678_u32, 0x9abc_def0];
    let start = [wide(8 << 6 | 6), vec![0], words.map(u32::to_le_bytes).concat()].concat();
    for before in [vec![], [nop(), movi(9, 0)].concat(), nop(), movi(9, 0)] {
        let place = CODE + (start.len() + before.len()) as u32;
        for (literal, value) in [CODE + 4, CODE + 8].into_iter().zip(words) {
            let back = (4 * place.div_ceil(4) - literal) / 4;
            let load = wide((0x1_0000 - back) << 8 | 3 << 4 | 1);
            let core = after(&[], &[start.clone(), before.clone(), load]);
            assert_eq!(core.get(3), value, "at {place:#x}");
        }
    }
}

#[test]
fn special_registers_are_exchanged_in_one() {
    let exchange = rrr(1, 6, 0, u32::from(special::SCOMPARE1), 5);
    let set = rrr(3, 1, 0, u32::from(special::SCOMPARE1), 4);
    let core = after(&[(4, 11), (5, 22)], &[set, exchange]);
    assert_eq!((core.get(5), core.special(special::SCOMPARE1)), (11, Some(22)));
}

#[test]
fn special_registers_hold_the_bits_that_they_have() {
    for (number, written, held) in [
        (special::SAR, 0xffff_ffe0, 32),
        (special::BR, u32::MAX, 0xffff),
        (special::WINDOWSTART, u32::MAX, 0xffff),
        (special::WINDOWBASE, 0x13, 3),
        (special::PS, u32::MAX, 0x7_0fff),
    ] {
        let (high, low) = (u32::from(number >> 4), u32::from(number & 15));
        let core = after(&[(4, written)], &[rrr(3, 1, high, low, 4)]);
        assert_eq!(core.special(number), Some(held), "{number}");
    }
    // `rsil`: the level alone is set, and what was there is kept.
    let core = after(&[(4, 0x7_0f0f)], &[rrr(3, 1, 14, 6, 4), rrr(0, 0, 6, 3, 5)]);
    assert_eq!((core.get(5), core.special(special::PS)), (0x7_0f0f, Some(0x7_0f03)));
}

#[test]
fn shifts_by_32_leave_nothing_of_what_is_shifted() {
    // `ssl` of 0, `ssa8b` of 0: 32.
    for set in [1, 3] {
        for (code, expected) in [
            (rrr(1, 9, 3, 0, 5), 0),
            (rrr(1, 11, 3, 0, 5), u32::MAX),
            (rrr(1, 10, 3, 4, 0), 0x1234_5678),
            (rrr(1, 8, 3, 4, 5), 0x1234_5678),
        ] {
            let registers = [(4, 0x1234_5678), (5, 0x8765_4321), (6, 0)];
            let found = after(&registers, &[rrr(0, 4, set, 6, 0), code.clone()]).get(3);
            assert_eq!(found, expected, "{code:x?}");
        }
    }
    for (bytes, amount) in [(1, 24), (2, 16), (3, 8), (4, 32)] {
        let core = after(&[(6, bytes)], &[rrr(0, 4, 3, 6, 0)]);
        assert_eq!(core.special(special::SAR), Some(amount), "ssa8b {bytes}");
    }
}

#[test]
fn products_and_quotients_at_the_ends_are_what_the_manual_says() {
    const LEAST: u32 = 0x8000_0000;
    for (op2, s, t, expected) in [
        (10, u32::MAX, u32::MAX, u32::MAX - 1),
        (10, LEAST, LEAST, 0x4000_0000),
        (11, u32::MAX, u32::MAX, 0),
        (11, LEAST, LEAST, 0x4000_0000),
        (11, LEAST, u32::MAX, 0),
        (11, LEAST, 1, u32::MAX),
        (12, LEAST, u32::MAX, 0),
        (13, LEAST, u32::MAX, LEAST),
        (13, (-7_i32).cast_unsigned(), 2, (-3_i32).cast_unsigned()),
        (14, LEAST, u32::MAX, LEAST),
        (15, LEAST, u32::MAX, 0),
        (15, (-7_i32).cast_unsigned(), 2, u32::MAX),
        (15, 7, (-2_i32).cast_unsigned(), 1),
    ] {
        let core = after(&[(4, s), (5, t)], &[rrr(2, op2, 3, 4, 5)]);
        assert_eq!(core.get(3), expected, "{op2} of {s:#x} and {t:#x}");
    }
}
