//! Xtensa instructions that name an address: the field of each, and how far it reaches.
//!
//! Source: Xtensa Instruction Set Architecture Reference Manual, chapter 6 (each instruction) and section 7.3 (formats).

use std::fmt;

/// Instructions alike in the field that holds the address.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// `l32r`: loads a literal that lies before it.
    LiteralLoad,
    /// `call0`, `call4`, `call8`, `call12`.
    Call,
    /// `j`.
    Jump,
    /// `beqz`, `bnez`, `bltz`, `bgez`.
    ZeroBranch,
    /// Branches that compare two registers, a register and a constant, a bit, or a boolean.
    Branch,
    /// `loop`, `loopnez`, `loopgtz`: the address is the loop's end.
    Loop,
    /// `beqz.n`, `bnez.n`: forwards alone.
    NarrowBranch,
}

/// Why an instruction cannot be filled in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Misfit {
    /// No instruction that names an address.
    Unknown {
        /// Its bytes, the first one lowest.
        instruction: u32,
    },
    /// The address is too far away, or not aligned.
    OutOfReach {
        /// The instruction.
        kind: Kind,
        /// From where it counts to the address, bytes.
        distance: i32,
    },
}

impl fmt::Display for Misfit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Unknown { instruction } => {
                write!(formatter, "{instruction:#08x} is no instruction that names an address")
            }
            Self::OutOfReach { kind, distance } => {
                let Field { least, greatest, step, .. } = kind.field();
                write!(
                    formatter,
                    "{kind:?} over {distance} bytes, and it reaches from {least} to {greatest} in steps of {step}"
                )
            }
        }
    }
}

impl std::error::Error for Misfit {}

/// Where an instruction holds the distance, and which distances it can hold, in bytes.
struct Field {
    /// The instruction's bits that are not the field's.
    kept: u32,
    /// The field's lowest bit.
    shift: u32,
    least: i32,
    greatest: i32,
    step: i32,
}

impl Kind {
    /// Returns the kind of an instruction; nothing where it names no address.
    fn of(instruction: u32) -> Option<Self> {
        let bits = |low: u32, count: u32| instruction >> low & ((1 << count) - 1);
        let (operation, n, m, r) = (bits(0, 4), bits(4, 2), bits(6, 2), bits(12, 4));
        match (operation, n, m, r) {
            (1, ..) => Some(Self::LiteralLoad),
            (5, ..) => Some(Self::Call),
            (6, 0, ..) => Some(Self::Jump),
            (6, 1, ..) => Some(Self::ZeroBranch),
            // A constant: signed; a boolean; unsigned.
            (6, 2, ..) | (6, 3, 1, 0 | 1) | (6, 3, 2 | 3, _) => Some(Self::Branch),
            (6, 3, 1, 8..=10) => Some(Self::Loop),
            (7, ..) => Some(Self::Branch),
            (12, _, 2 | 3, _) => Some(Self::NarrowBranch),
            _ => None,
        }
    }

    fn field(self) -> Field {
        let field =
            |kept, shift, least, greatest, step| Field { kept, shift, least, greatest, step };
        match self {
            Self::LiteralLoad => field(0xff, 8, -(1 << 18), -4, 4),
            Self::Call => field(0x3f, 6, -(1 << 19), (1 << 19) - 4, 4),
            Self::Jump => field(0x3f, 6, -(1 << 17), (1 << 17) - 1, 1),
            Self::ZeroBranch => field(0xfff, 12, -(1 << 11), (1 << 11) - 1, 1),
            Self::Branch => field(0xffff, 16, -(1 << 7), (1 << 7) - 1, 1),
            Self::Loop => field(0xffff, 16, 0, (1 << 8) - 1, 1),
            // Two parts: the lower four bits on top, the upper two at bit 4.
            Self::NarrowBranch => field(0x0fcf, 12, 0, (1 << 6) - 1, 1),
        }
    }

    /// Returns from where an instruction at this place counts.
    fn origin(self, place: u32) -> u32 {
        match self {
            Self::LiteralLoad => place.wrapping_add(3) & !3,
            Self::Call => (place & !3).wrapping_add(4),
            _ => place.wrapping_add(4),
        }
    }
}

/// Returns how many bytes an instruction takes that begins with this one.
fn length(first: u8) -> usize {
    if first & 0xf < 8 { 3 } else { 2 }
}

/// Returns whether these bytes hold a whole instruction at their beginning.
pub(crate) fn is_whole(bytes: &[u8]) -> bool {
    bytes.first().is_some_and(|first| bytes.len() >= length(*first))
}

/// Writes the target's address into the instruction that these bytes begin with, which will run at `place`.
///
/// # Errors
/// Where it names no address, or its field cannot hold this one.
pub fn fill(bytes: &mut [u8], place: u32, target: u32) -> Result<Kind, Misfit> {
    let begin = |bytes: &[u8]| {
        bytes.iter().take(3).rev().fold(0, |word, byte| word << 8 | u32::from(*byte))
    };
    let instruction = begin(bytes);
    let kind = Kind::of(instruction).ok_or(Misfit::Unknown { instruction })?;
    let Field { kept, shift, least, greatest, step } = kind.field();
    let distance = target.wrapping_sub(kind.origin(place)).cast_signed();
    if !(least..=greatest).contains(&distance) || distance % step != 0 {
        return Err(Misfit::OutOfReach { kind, distance });
    }
    let value = (distance / step).cast_unsigned();
    let field = match kind {
        Kind::NarrowBranch => (value & 0xf) << shift | value & 0x30,
        _ => value << shift,
    };
    let filled = instruction & kept | field & !kept;
    if !is_whole(bytes) {
        return Err(Misfit::Unknown { instruction });
    }
    let length = length(bytes[0]);
    bytes[..length].copy_from_slice(&filled.to_le_bytes()[..length]);
    Ok(kind)
}
