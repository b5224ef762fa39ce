//! ELF files of 32 bits, little-endian, read and changed in place (System V ABI, "Object Files").

use crate::fault::Fault;

/// First bytes of a file of 32 bits, little-endian.
const IDENTITY: [u8; 6] = [0x7f, b'E', b'L', b'F', 1, 1];
/// Where the header states the processor.
const MACHINE: usize = 18;
/// Where the header states where the section headers begin.
const SECTION_HEADERS: usize = 32;
/// Where the header states the processor's flags.
const FLAGS: usize = 36;
/// Where the header states the size of a section header, how many there are, and which one's section holds their names.
const SECTION_HEADER_SIZE: usize = 46;
const SECTION_COUNT: usize = 48;
const SECTION_NAMES: usize = 50;
/// Where a section header states the section's flags.
const SECTION_FLAGS: usize = 8;
/// Size of a section header, of a relocation with an addend, and of a symbol.
const SECTION: usize = 40;
const RELOCATION: usize = 12;
const SYMBOL: usize = 16;

/// Kinds of sections.
pub(crate) const SYMBOLS: u32 = 2;
pub(crate) const WITH_ADDENDS: u32 = 4;
const WITHOUT_CONTENTS: u32 = 8;
pub(crate) const WITHOUT_ADDENDS: u32 = 9;
/// Flags of sections: in memory when the program runs; left out by the linker.
pub(crate) const ALLOCATED: u32 = 2;
pub(crate) const EXCLUDED: u32 = 0x8000_0000;

/// A section, as its header states it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Section {
    header: usize,
    name: u32,
    pub(crate) kind: u32,
    pub(crate) flags: u32,
    pub(crate) address: u32,
    pub(crate) offset: usize,
    size: usize,
    pub(crate) link: usize,
    pub(crate) info: usize,
}

/// A relocation with an addend, and where it is in the file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Relocation {
    pub(crate) at: usize,
    pub(crate) place: u32,
    pub(crate) kind: u8,
    pub(crate) symbol: usize,
    pub(crate) addend: u32,
}

/// A symbol's value, and the index of the section that defines it, which is 0 for one that is not defined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Symbol {
    name: u32,
    pub(crate) value: u32,
    pub(crate) section: u16,
}

/// A file.
pub(crate) struct Elf<'a> {
    bytes: &'a mut [u8],
    sections: Vec<Section>,
    names: usize,
}

/// Returns whether these bytes begin an ELF file.
pub(crate) fn is_elf(bytes: &[u8]) -> bool {
    bytes.starts_with(&IDENTITY[..4])
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N], Fault> {
    bytes.get(at..).and_then(<[u8]>::first_chunk).copied().ok_or(Fault::Truncated)
}

fn half(bytes: &[u8], at: usize) -> Result<u16, Fault> {
    array(bytes, at).map(u16::from_le_bytes)
}

fn word(bytes: &[u8], at: usize) -> Result<u32, Fault> {
    array(bytes, at).map(u32::from_le_bytes)
}

fn index(bytes: &[u8], at: usize) -> Result<usize, Fault> {
    word(bytes, at).map(|word| word as usize)
}

impl<'a> Elf<'a> {
    /// Reads the headers.
    pub(crate) fn read(bytes: &'a mut [u8]) -> Result<Self, Fault> {
        if !bytes.starts_with(&IDENTITY) {
            return Err(Fault::Foreign);
        }
        let first = index(bytes, SECTION_HEADERS)?;
        let size = usize::from(half(bytes, SECTION_HEADER_SIZE)?);
        let count = match half(bytes, SECTION_COUNT)? {
            // Too many for the field: the first header holds the number.
            0 if first != 0 => index(bytes, first + 20)?,
            count => usize::from(count),
        };
        if count > 0 && size != SECTION {
            return Err(Fault::Truncated);
        }
        let section = |number: usize| {
            let header = first + number * size;
            Ok(Section {
                header,
                name: word(bytes, header)?,
                kind: word(bytes, header + 4)?,
                flags: word(bytes, header + SECTION_FLAGS)?,
                address: word(bytes, header + 12)?,
                offset: index(bytes, header + 16)?,
                size: index(bytes, header + 20)?,
                link: index(bytes, header + 24)?,
                info: index(bytes, header + 28)?,
            })
        };
        let sections: Vec<Section> = (0..count).map(section).collect::<Result<_, Fault>>()?;
        let names = usize::from(half(bytes, SECTION_NAMES)?);
        let names = sections.get(names).map_or(0, |section| section.offset);
        Ok(Self { bytes, sections, names })
    }

    /// Returns the processor that the file is for.
    pub(crate) fn machine(&self) -> Result<u16, Fault> {
        half(self.bytes, MACHINE)
    }

    /// Writes which processor the file is for, and the flags that only it knows.
    pub(crate) fn set_machine(&mut self, machine: u16, flags: u32) -> Result<(), Fault> {
        self.write(MACHINE, &machine.to_le_bytes())?;
        self.write(FLAGS, &flags.to_le_bytes())
    }

    /// Returns all sections.
    pub(crate) fn sections(&self) -> Vec<Section> {
        self.sections.clone()
    }

    /// Returns a section by its index.
    pub(crate) fn section(&self, number: usize) -> Result<Section, Fault> {
        self.sections.get(number).copied().ok_or(Fault::Truncated)
    }

    /// Returns the name of a section.
    pub(crate) fn section_name(&self, section: Section) -> &[u8] {
        self.text(self.names + section.name as usize)
    }

    /// Writes the flags of a section.
    pub(crate) fn set_section_flags(&mut self, section: Section, flags: u32) -> Result<(), Fault> {
        self.write(section.header + SECTION_FLAGS, &flags.to_le_bytes())
    }

    /// Returns the relocations in a section of them.
    pub(crate) fn relocations(&self, section: Section) -> Result<Vec<Relocation>, Fault> {
        let relocation = |at: usize| {
            let [kind, symbol @ ..] = array::<4>(self.bytes, at + 4)?;
            let [low, middle, high] = symbol;
            Ok(Relocation {
                at,
                place: word(self.bytes, at)?,
                kind,
                symbol: u32::from_le_bytes([low, middle, high, 0]) as usize,
                addend: word(self.bytes, at + 8)?,
            })
        };
        entries(section, RELOCATION).map(relocation).collect()
    }

    /// Writes a relocation back.
    pub(crate) fn set_relocation(&mut self, relocation: Relocation) -> Result<(), Fault> {
        let Relocation { at, place, kind, symbol, addend } = relocation;
        let information = (symbol as u32) << 8 | u32::from(kind);
        for (offset, word) in [(0, place), (4, information), (8, addend)] {
            self.write(at + offset, &word.to_le_bytes())?;
        }
        Ok(())
    }

    /// Returns the symbols in a section of them.
    pub(crate) fn symbols(&self, section: Section) -> Result<Vec<Symbol>, Fault> {
        let symbol = |at: usize| {
            Ok(Symbol {
                name: word(self.bytes, at)?,
                value: word(self.bytes, at + 4)?,
                section: half(self.bytes, at + 14)?,
            })
        };
        entries(section, SYMBOL).map(symbol).collect()
    }

    /// Returns the name of a symbol in a section of symbols.
    pub(crate) fn symbol_name(&self, section: Section, symbol: Symbol) -> Result<&str, Fault> {
        let names = self.section(section.link)?.offset;
        std::str::from_utf8(self.text(names + symbol.name as usize)).map_err(|_| Fault::Truncated)
    }

    /// Returns the bytes of a section from an offset in it to its end.
    pub(crate) fn contents(&mut self, section: Section, from: u32) -> Result<&mut [u8], Fault> {
        let end = section.offset + section.size;
        let has_contents = section.kind != WITHOUT_CONTENTS;
        let bytes = self.bytes.get_mut(section.offset + from as usize..end);
        bytes.filter(|_| has_contents).ok_or(Fault::Truncated)
    }

    /// Returns a text that ends with a zero.
    fn text(&self, at: usize) -> &[u8] {
        let rest = self.bytes.get(at..).unwrap_or_default();
        rest.split(|byte| *byte == 0).next().unwrap_or_default()
    }

    fn write(&mut self, at: usize, bytes: &[u8]) -> Result<(), Fault> {
        let room = self.bytes.get_mut(at..at + bytes.len()).ok_or(Fault::Truncated)?;
        room.copy_from_slice(bytes);
        Ok(())
    }
}

/// Returns the offsets of the entries of a section.
fn entries(section: Section, size: usize) -> impl Iterator<Item = usize> {
    (0..section.size / size).map(move |number| section.offset + number * size)
}
