//! Every instruction that names an address, read back by the formulas of its page in the Xtensa Instruction Set Architecture
//! Reference Manual, chapter 6.

use flix_xtensa::instruction::{Kind, Misfit, fill};

/// An instruction without its address, and what the manual says of its target.
pub struct Case {
    pub name: &'static str,
    /// As the assembler leaves it, little-endian.
    pub bytes: &'static [u8],
    pub kind: Kind,
    /// Returns the target of the instruction at a place.
    pub target: fn(&[u8], u32) -> u32,
    /// The nearest and the farthest distance from the place itself that it reaches at places that are multiples of 4.
    pub reach: [i32; 2],
    pub step: i32,
}

fn word(bytes: &[u8]) -> u32 {
    u32::from(bytes[0]) | u32::from(bytes[1]) << 8 | u32::from(bytes[2]) << 16
}

/// Repeats the highest of so many bits.
fn signed(value: u32, bits: u32) -> u32 {
    ((value << (32 - bits)) as i32 >> (32 - bits)) as u32
}

/// `vAddr = ((PC + 3) 31..2 || 00) + (1^14 || imm16 || 0^2)`
fn l32r(bytes: &[u8], place: u32) -> u32 {
    ((place + 3) >> 2 << 2).wrapping_add(0xfffc_0000 | word(bytes) >> 8 << 2)
}

/// `nextPC = (PC 31..2 + offset extended + 1) || 00`
fn call(bytes: &[u8], place: u32) -> u32 {
    (place >> 2).wrapping_add(signed(word(bytes) >> 6, 18)).wrapping_add(1) << 2
}

/// `nextPC = PC + offset extended + 4`
fn jump(bytes: &[u8], place: u32) -> u32 {
    place.wrapping_add(signed(word(bytes) >> 6, 18)).wrapping_add(4)
}

/// `nextPC = PC + imm12 extended + 4`
fn zero_branch(bytes: &[u8], place: u32) -> u32 {
    place.wrapping_add(signed(word(bytes) >> 12, 12)).wrapping_add(4)
}

/// `nextPC = PC + imm8 extended + 4`
fn branch(bytes: &[u8], place: u32) -> u32 {
    place.wrapping_add(signed(word(bytes) >> 16, 8)).wrapping_add(4)
}

/// `LEND = PC + (0^24 || imm8) + 4`
fn loop_end(bytes: &[u8], place: u32) -> u32 {
    place + u32::from(bytes[2]) + 4
}

/// `nextPC = PC + (0^26 || imm6) + 4`, imm6 its bits 5..4 and 15..12
fn narrow(bytes: &[u8], place: u32) -> u32 {
    place + (u32::from(bytes[0]) >> 4 & 3) * 16 + u32::from(bytes[1] >> 4) + 4
}

macro_rules! case {
    ($name:literal, $bytes:expr, $kind:ident, $target:ident, $nearest:expr, $farthest:expr, $step:expr) => {
        Case {
            name: $name,
            bytes: &$bytes,
            kind: Kind::$kind,
            target: $target,
            reach: [$nearest, $farthest],
            step: $step,
        }
    };
}

macro_rules! branches {
    ($($name:literal: $bytes:expr),*) => {
        [$(case!($name, $bytes, Branch, branch, 4 - 128, 4 + 127, 1)),*]
    };
}

/// Every instruction but those that compare two registers, a bit, or a register and a constant.
pub const OTHERS: [Case; 13] = [
    case!("l32r a2", [0x21, 0, 0], LiteralLoad, l32r, -262_144, -4, 4),
    case!("call0", [0x05, 0, 0], Call, call, 4 - 524_288, 524_288, 4),
    case!("call4", [0x15, 0, 0], Call, call, 4 - 524_288, 524_288, 4),
    case!("call8", [0x25, 0, 0], Call, call, 4 - 524_288, 524_288, 4),
    case!("call12", [0x35, 0, 0], Call, call, 4 - 524_288, 524_288, 4),
    case!("j", [0x06, 0, 0], Jump, jump, 4 - 131_072, 4 + 131_071, 1),
    case!("beqz a3", [0x16, 0x03, 0], ZeroBranch, zero_branch, 4 - 2_048, 4 + 2_047, 1),
    case!("bnez a3", [0x56, 0x03, 0], ZeroBranch, zero_branch, 4 - 2_048, 4 + 2_047, 1),
    case!("bltz a3", [0x96, 0x03, 0], ZeroBranch, zero_branch, 4 - 2_048, 4 + 2_047, 1),
    case!("bgez a3", [0xd6, 0x03, 0], ZeroBranch, zero_branch, 4 - 2_048, 4 + 2_047, 1),
    case!("loop a3", [0x76, 0x83, 0], Loop, loop_end, 4, 4 + 255, 1),
    case!("beqz.n a3", [0x8c, 0x03], NarrowBranch, narrow, 4, 4 + 63, 1),
    case!("bnez.n a3", [0xcc, 0x03], NarrowBranch, narrow, 4, 4 + 63, 1),
];

pub const LOOPS: [Case; 2] = [
    case!("loopnez a3", [0x76, 0x93, 0], Loop, loop_end, 4, 4 + 255, 1),
    case!("loopgtz a3", [0x76, 0xa3, 0], Loop, loop_end, 4, 4 + 255, 1),
];

pub const BRANCHES: [Case; 24] = branches![
    "beqi a3, 4": [0x26, 0x43, 0], "bnei a3, 4": [0x66, 0x43, 0], "blti a3, 4": [0xa6, 0x43, 0],
    "bgei a3, 4": [0xe6, 0x43, 0], "bltui a3, 4": [0xb6, 0x43, 0], "bgeui a3, 4": [0xf6, 0x43, 0],
    "bf b3": [0x76, 0x03, 0], "bt b3": [0x76, 0x13, 0],
    "bnone a3, a4": [0x47, 0x03, 0], "beq a3, a4": [0x47, 0x13, 0], "blt a3, a4": [0x47, 0x23, 0],
    "bltu a3, a4": [0x47, 0x33, 0], "ball a3, a4": [0x47, 0x43, 0], "bbc a3, a4": [0x47, 0x53, 0],
    "bbci a3, 4": [0x47, 0x63, 0], "bbci a3, 20": [0x47, 0x73, 0], "bany a3, a4": [0x47, 0x83, 0],
    "bne a3, a4": [0x47, 0x93, 0], "bge a3, a4": [0x47, 0xa3, 0], "bgeu a3, a4": [0x47, 0xb3, 0],
    "bnall a3, a4": [0x47, 0xc3, 0], "bbs a3, a4": [0x47, 0xd3, 0], "bbsi a3, 4": [0x47, 0xe3, 0],
    "bbsi a3, 20": [0x47, 0xf3, 0]
];

/// Returns every instruction that names an address.
pub fn all() -> impl Iterator<Item = &'static Case> {
    OTHERS.iter().chain(&LOOPS).chain(&BRANCHES)
}

/// Flash of the ESP32 as its processor sees it.
const PLACE: u32 = 0x400d_0020;

/// Fills an instruction in, with others behind it; returns the kind and all bytes.
fn filled(case: &Case, place: u32, target: u32) -> Result<(Kind, Vec<u8>), Misfit> {
    let mut bytes = [case.bytes, &[0x5a; 3]].concat();
    fill(&mut bytes, place, target).map(|kind| (kind, bytes))
}

#[test]
fn each_instruction_names_its_target_over_all_of_its_reach() {
    for case in all() {
        let [least, greatest] = case.reach;
        let span = (greatest - least) / case.step;
        // Both ends, and 97 distances between them.
        for part in 0..=98 {
            let distance =
                least + i64::from(span).wrapping_mul(part).div_euclid(98) as i32 * case.step;
            let target = PLACE.wrapping_add_signed(distance);
            let (kind, bytes) = filled(case, PLACE, target).unwrap();
            assert_eq!((case.target)(&bytes, PLACE), target, "{} over {distance}", case.name);
            assert_eq!(kind, case.kind, "{}", case.name);
        }
    }
}

#[test]
fn places_that_are_no_multiple_of_four_count_as_the_manual_says() {
    for case in all() {
        for place in PLACE..PLACE + 4 {
            // Aligned, near, and before it for a literal.
            let target = if case.kind == Kind::LiteralLoad { PLACE - 64 } else { PLACE + 32 };
            let (_, bytes) = filled(case, place, target).unwrap();
            assert_eq!((case.target)(&bytes, place), target, "{} at {place:#x}", case.name);
        }
    }
}

#[test]
fn what_is_no_address_stays_as_it_is() {
    for case in all() {
        let target = PLACE.wrapping_add_signed(case.reach[0]);
        let (_, near) = filled(case, PLACE, target).unwrap();
        let (_, far) = filled(case, PLACE, PLACE.wrapping_add_signed(case.reach[1])).unwrap();
        // A third filling sees what the first two left, and the bits that neither touched are the assembler's.
        let mut again = near.clone();
        fill(&mut again, PLACE, PLACE.wrapping_add_signed(case.reach[1])).unwrap();
        assert_eq!(again, far, "{}", case.name);
        let zero = match case.kind {
            Kind::LiteralLoad => PLACE - 262_144,
            Kind::Call
            | Kind::Jump
            | Kind::ZeroBranch
            | Kind::Branch
            | Kind::Loop
            | Kind::NarrowBranch => PLACE + 4,
        };
        let (_, zeroed) = filled(case, PLACE, zero).unwrap();
        assert_eq!(&zeroed[..case.bytes.len()], case.bytes, "{}", case.name);
        assert_eq!(&zeroed[case.bytes.len()..], [0x5a; 3], "{} wrote behind itself", case.name);
    }
}

#[test]
fn a_target_beyond_its_reach_is_refused() {
    for case in all() {
        let [least, greatest] = case.reach;
        for distance in [least - case.step, greatest + case.step] {
            let refused = filled(case, PLACE, PLACE.wrapping_add_signed(distance)).unwrap_err();
            let is_named = matches!(refused, Misfit::OutOfReach { kind, .. } if kind == case.kind);
            assert!(is_named, "{} over {distance}: {refused}", case.name);
        }
    }
}

#[test]
fn a_target_between_words_is_refused_where_words_are_counted() {
    for case in all().filter(|case| case.step == 4) {
        for odd in 1..4 {
            let target = PLACE - 64 + odd;
            assert!(filled(case, PLACE, target).is_err(), "{} at {target:#x}", case.name);
        }
    }
}

#[test]
fn what_names_no_address_is_refused() {
    // `entry a1, 32`, `retw.n`, `movi.n a2, 1`, `add a2, a3, a4`, `l32i a2, a3, 0`, nothing.
    let others: [&[u8]; 8] = [
        &[0x36, 0x41, 0],
        &[0x1d, 0xf0],
        &[0x0c, 0x12],
        &[0x40, 0x23, 0x80],
        &[0x22, 0x23, 0],
        // `call0` and `beqz.n`, cut.
        &[0x05, 0],
        &[0x8c],
        &[],
    ];
    for bytes in others {
        let refused = fill(&mut bytes.to_vec(), PLACE, PLACE + 8).unwrap_err();
        assert!(matches!(refused, Misfit::Unknown { .. }), "{bytes:x?}: {refused}");
    }
}

/// Bits that instructions which name an address have in common, and what stands in them (chapter 7, opcode maps).
const MAP: [(u32, u32); 12] = [
    // `l32r`, `call`, `j`, `beqz` and the like, those with a constant, `bltui` and `bgeui`.
    (0xf, 0x1),
    (0xf, 0x5),
    (0x3f, 0x06),
    (0x3f, 0x16),
    (0x3f, 0x26),
    (0xbf, 0xb6),
    // `bf` and `bt`, the loops, those that compare two registers or a bit, narrow ones.
    (0xe0ff, 0x0076),
    (0xf0ff, 0x8076),
    (0xf0ff, 0x9076),
    (0xf0ff, 0xa076),
    (0xf, 0x7),
    (0x8f, 0x8c),
];

#[test]
fn of_all_words_those_of_the_manuals_map_are_filled_in_and_no_others() {
    for word in 0..=u32::from(u16::MAX) {
        let mut bytes = [word.to_le_bytes()[0], word.to_le_bytes()[1], 0];
        let target = if word & 0xf == 1 { PLACE - 64 } else { PLACE + 8 };
        let is_listed = MAP.iter().any(|(mask, bits)| word & mask == *bits);
        assert_eq!(fill(&mut bytes, PLACE, target).is_ok(), is_listed, "{word:#06x}");
    }
}
