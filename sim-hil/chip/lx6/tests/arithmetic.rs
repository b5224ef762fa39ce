//! Instructions that compute: each against the formula of its page.

use proptest::prelude::*;

use super::{Code, after, rri8, rrr, wide};
use flix_lx6::processor::special;

const R: u32 = 3;
const S: u32 = 4;
const T: u32 = 5;

/// What an instruction leaves in its destination.
type Formula = fn(u32, u32) -> u32;

fn i(value: u32) -> i64 {
    i64::from(value.cast_signed())
}

fn u(value: u32) -> u64 {
    u64::from(value)
}

/// Instructions of format RRR from s and t to r: op1, op2, formula.
const FORMULAS: [(u32, u32, Formula); 29] = [
    (0, 1, |s, t| s & t),
    (0, 2, |s, t| s | t),
    (0, 3, |s, t| s ^ t),
    (0, 8, |s, t| s.wrapping_add(t)),
    (0, 9, |s, t| s.wrapping_mul(2).wrapping_add(t)),
    (0, 10, |s, t| s.wrapping_mul(4).wrapping_add(t)),
    (0, 11, |s, t| s.wrapping_mul(8).wrapping_add(t)),
    (0, 12, |s, t| s.wrapping_sub(t)),
    (0, 13, |s, t| s.wrapping_mul(2).wrapping_sub(t)),
    (0, 14, |s, t| s.wrapping_mul(4).wrapping_sub(t)),
    (0, 15, |s, t| s.wrapping_mul(8).wrapping_sub(t)),
    (1, 12, |s, t| (s & 0xffff) * (t & 0xffff)),
    (1, 13, |s, t| (i32::from(s as i16) * i32::from(t as i16)).cast_unsigned()),
    (2, 8, |s, t| s.wrapping_mul(t)),
    (2, 10, |s, t| ((u(s) * u(t)) >> 32) as u32),
    (2, 11, |s, t| ((i(s) * i(t)) >> 32) as u32),
    (2, 12, |s, t| (u(s) / u(t.max(1))) as u32),
    (2, 13, |s, t| (i(s) / if t == 0 { 1 } else { i(t) }) as u32),
    (2, 14, |s, t| (u(s) % u(t.max(1))) as u32),
    (2, 15, |s, t| (i(s) % if t == 0 { 1 } else { i(t) }) as u32),
    (3, 4, |s, t| i(s).min(i(t)) as u32),
    (3, 5, |s, t| i(s).max(i(t)) as u32),
    (3, 6, |s, t| s.min(t)),
    (3, 7, |s, t| s.max(t)),
    // Conditional moves onto a register that holds 77.
    (3, 8, |s, t| if t == 0 { s } else { 77 }),
    (3, 9, |s, t| if t != 0 { s } else { 77 }),
    (3, 10, |s, t| if i(t) < 0 { s } else { 77 }),
    (3, 11, |s, t| if i(t) >= 0 { s } else { 77 }),
    // Bits 7 to 12.
    (5, 5, |_, t| t >> 20 & 63),
];

fn result(s: u32, t: u32, code: Code, register: u8) -> u32 {
    after(&[(3, 77), (4, s), (5, t)], &[code]).get(register)
}

/// Values at which carries, signs and sizes change.
fn value() -> impl Strategy<Value = u32> {
    prop_oneof![
        any::<u32>(),
        0..4_u32,
        Just(0x7fff_ffff),
        Just(0x8000_0000),
        Just(0x8000_0001),
        Just(u32::MAX),
        0x7ffe..0x8002_u32,
        0xfffe..0x1_0002_u32,
    ]
}

proptest! {
    #[test]
    fn what_two_registers_give_is_what_the_manual_says(s in value(), t in value()) {
        for (op1, op2, formula) in FORMULAS {
            let is_division = op1 == 2 && op2 >= 12;
            let t = if is_division { t.max(1) } else { t };
            prop_assert_eq!(result(s, t, rrr(op1, op2, R, S, T), 3), formula(s, t), "op1 {} op2 {}", op1, op2);
        }
    }

    #[test]
    fn what_one_register_gives_is_what_the_manual_says(value in value(), small in 0..16_u32) {
        let one = |code| result(value, value, code, 3);
        prop_assert_eq!(one(rrr(0, 6, R, 0, T)), value.wrapping_neg(), "neg");
        prop_assert_eq!(one(rrr(0, 6, R, 1, T)), value.cast_signed().unsigned_abs(), "abs");
        prop_assert_eq!(one(rrr(1, 4, R, small, T)), value >> small, "srli");
        prop_assert_eq!(one(rrr(1, 3, R, small, T)), (i(value) >> (16 + small)) as u32, "srai");
        prop_assert_eq!(one(rrr(1, 1, R, S, small)), value << (16 - small), "slli");
        prop_assert_eq!(one(rrr(4, small, R, 9, T)), value >> 9 & ((1 << (small + 1)) - 1), "extui");
        let bits = small + 8;
        let wrapped = i64::from(value) << (64 - bits) >> (64 - bits);
        prop_assert_eq!(one(rrr(3, 2, R, S, small)), wrapped as u32, "sext");
        let greatest = (1_i64 << (bits - 1)) - 1;
        prop_assert_eq!(one(rrr(3, 3, R, S, small)), i(value).clamp(-greatest - 1, greatest) as u32, "clamps");
        let leading = result(value, 0, rrr(0, 4, 15, S, R), 3);
        prop_assert_eq!(leading, (0..32).take_while(|bit| value >> (31 - bit) & 1 == 0).count() as u32, "nsau");
        let signs = result(value, 0, rrr(0, 4, 14, S, R), 3);
        let sign = value >> 31;
        prop_assert_eq!(signs, (1..32).take_while(|bit| value >> (31 - bit) & 1 == sign).count() as u32, "nsa");
        prop_assert_eq!(result(value, 0, rri8(2, 12, S, R, -3), 3), value.wrapping_sub(3), "addi");
        prop_assert_eq!(result(value, 0, rri8(2, 13, S, R, -3), 3), value.wrapping_sub(768), "addmi");
    }

    #[test]
    fn shifts_by_the_register_of_amounts_are_what_the_manual_says(s in value(), t in value(), amount in 0..32_u32) {
        let shifted = |set: u32, code: Code| {
            after(&[(3, 0), (4, s), (5, t), (6, amount)], &[rrr(0, 4, set, 6, 0), code]).get(3)
        };
        // `ssr` for shifts to the right, `ssl` for those to the left.
        prop_assert_eq!(shifted(0, rrr(1, 9, R, 0, T)), t >> amount, "srl");
        prop_assert_eq!(shifted(0, rrr(1, 11, R, 0, T)), (i(t) >> amount) as u32, "sra");
        prop_assert_eq!(shifted(1, rrr(1, 10, R, S, 0)), s << amount, "sll");
        prop_assert_eq!(shifted(0, rrr(1, 8, R, S, T)), ((u(s) << 32 | u(t)) >> amount) as u32, "src");
        let set = after(&[(6, amount)], &[rrr(0, 4, 2, 6, 0)]);
        prop_assert_eq!(set.special(special::SAR), Some(amount % 4 * 8), "ssa8l");
        let set = after(&[], &[rrr(0, 4, 4, amount & 15, amount >> 4)]);
        prop_assert_eq!(set.special(special::SAR), Some(amount), "ssai");
    }
}

#[test]
fn narrow_constants_are_from_32_below_zero_to_95() {
    for value in -32..=95_i32 {
        let bits = value.cast_unsigned() & 0x7f;
        let code = wide(0xc | (bits >> 4) << 4 | 3 << 8 | (bits & 15) << 12)[..2].to_vec();
        assert_eq!(result(0, 0, code, 3), value.cast_unsigned());
    }
}
