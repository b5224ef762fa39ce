//! Xtensa objects in the clothes of RISC-V, for a linker that does not know Xtensa.
//!
//! The linker is to lay sections out, keep what is reached, and write addresses into words of data. An absolute word and no
//! relocation at all have the same numbers in both (1 and 0), so that it does this for Xtensa, too. A relocation of an
//! instruction becomes none, which keeps its symbol alive; in what the linker emits it comes out with the final address and is
//! filled in there ([`crate::link`]).
//!
//! Source of the kinds: GNU binutils, `include/elf/xtensa.h`; RISC-V ELF psABI, "Relocations".

use crate::elf::{self, Elf, Relocation, Section};
use crate::fault::{EXPANSION, Fault, INSTRUCTION, WORD};
use crate::instruction::is_whole;

/// The processors' numbers (System V ABI, `e_machine`).
pub(crate) const XTENSA: u16 = 94;
const RISCV: u16 = 243;
/// Kind of no relocation.
pub(crate) const NONE: u8 = 0;
/// Addend of a relocation that is to be left alone; one of an instruction comes out without its symbol, too, where that is lost.
pub(crate) const LEFT_ALONE: u32 = 0x7466_656c;
/// Kinds of what tells a linker that shortens code how code hung together, besides [`EXPANSION`]: differences of addresses, which are
/// right as they are where nothing is shortened.
const DIFFERENCES: [std::ops::RangeInclusive<u8>; 2] = [17..=19, 57..=62];
/// Sections that say the same, by the beginning of their names.
const NOTES: [&[u8]; 2] = [b".xt.", b".xtensa.in"];

/// First bytes of an archive, and the sizes of a member's header and of what is before and in its field for the size.
const ARCHIVE: &[u8] = b"!<arch>\n";
const MEMBER: usize = 60;
const MEMBER_SIZE: std::ops::Range<usize> = 48..58;

/// Returns whether these bytes begin an object or an archive.
pub(crate) fn is_linkable(bytes: &[u8]) -> bool {
    elf::is_elf(bytes) || bytes.starts_with(ARCHIVE)
}

/// Calls a function with each ELF file: the file itself, or those in the archive.
pub(crate) fn for_each_object(
    file: &mut [u8],
    mut with: impl FnMut(&mut [u8]) -> Result<(), Fault>,
) -> Result<(), Fault> {
    let Some(mut rest) = file.strip_prefix(ARCHIVE).map(<[u8]>::len).map(|length| {
        let start = file.len() - length;
        &mut file[start..]
    }) else {
        return if elf::is_elf(file) { with(file) } else { Ok(()) };
    };
    while let Some((header, members)) = rest.split_at_mut_checked(MEMBER) {
        let digits = std::str::from_utf8(&header[MEMBER_SIZE]).map_err(|_| Fault::Truncated)?;
        let size: usize = digits.trim_end().parse().map_err(|_| Fault::Truncated)?;
        let (member, following) = members.split_at_mut_checked(size).ok_or(Fault::Truncated)?;
        if elf::is_elf(member) {
            with(member)?;
        }
        // Members begin at even offsets.
        rest = following.get_mut(size % 2..).unwrap_or_default();
    }
    Ok(())
}

/// Disguises each Xtensa object of a file, in place; other objects stay as they are.
///
/// # Errors
/// Where an object is cut short or has a relocation of an unknown kind.
pub fn disguise(file: &mut [u8]) -> Result<(), Fault> {
    for_each_object(file, object)
}

fn object(bytes: &mut [u8]) -> Result<(), Fault> {
    let mut elf = Elf::read(bytes)?;
    if elf.machine()? != XTENSA {
        return Ok(());
    }
    elf.set_machine(RISCV, 0)?;
    for section in elf.sections() {
        if NOTES.iter().any(|note| elf.section_name(section).starts_with(note)) {
            elf.set_section_flags(section, section.flags | elf::EXCLUDED)?;
        }
        match section.kind {
            elf::WITHOUT_ADDENDS => return Err(Fault::WithoutAddends),
            elf::WITH_ADDENDS => relocations(&mut elf, section)?,
            _ => {}
        }
    }
    Ok(())
}

fn relocations(elf: &mut Elf<'_>, section: Section) -> Result<(), Fault> {
    let place = elf.section(section.info)?;
    for relocation in elf.relocations(section)? {
        let disguised = match relocation.kind {
            WORD => word(elf, place, relocation)?,
            INSTRUCTION if relocation.symbol == 0 => return Err(Fault::Untargeted),
            // What lies behind the section's end is another one's.
            INSTRUCTION if !is_whole(elf.contents(place, relocation.place)?) => {
                return Err(Fault::Truncated);
            }
            INSTRUCTION => Relocation { kind: NONE, ..relocation },
            kind if is_left_alone(kind) => {
                Relocation { kind: NONE, symbol: 0, addend: LEFT_ALONE, ..relocation }
            }
            kind => return Err(Fault::Relocation(kind)),
        };
        elf.set_relocation(disguised)?;
    }
    Ok(())
}

/// Returns whether what a relocation of this kind is of is right as it is.
fn is_left_alone(kind: u8) -> bool {
    [NONE, EXPANSION].contains(&kind) || DIFFERENCES.iter().any(|range| range.contains(&kind))
}

/// Adds what stands in a word to its relocation's addend: for Xtensa it counts, for RISC-V it is overwritten.
fn word(elf: &mut Elf<'_>, place: Section, relocation: Relocation) -> Result<Relocation, Fault> {
    let contents = elf.contents(place, relocation.place)?;
    let contents = u32::from_le_bytes(*contents.first_chunk().ok_or(Fault::Truncated)?);
    Ok(Relocation { addend: relocation.addend.wrapping_add(contents), ..relocation })
}
