//! What objects and archives may be refused for.

use std::fmt;

/// Kinds of relocations: a word; an instruction; a long call that a linker may shorten.
pub(crate) const WORD: u8 = 1;
pub(crate) const INSTRUCTION: u8 = 20;
pub(crate) const EXPANSION: u8 = 11;

/// What is wrong with an object or an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// It is cut short: something that it names lies beyond its end.
    Truncated,
    /// An ELF file of another kind.
    Foreign,
    /// Relocations without addends.
    WithoutAddends,
    /// A relocation of an instruction that names no symbol.
    Untargeted,
    /// A relocation of another kind than Xtensa objects were seen to have.
    Relocation(u8),
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => formatter.write_str("cut short: it names what lies beyond its end"),
            Self::Foreign => formatter.write_str("no ELF file of 32 bits, little-endian"),
            Self::WithoutAddends => {
                formatter.write_str("relocations without addends, which no Xtensa object has")
            }
            Self::Untargeted => formatter.write_str(
                "a relocation of an instruction that names no symbol, or one in a section that is discarded",
            ),
            Self::Relocation(kind) => write!(
                formatter,
                "a relocation of kind {kind}, and what is known is a word ({WORD}), an instruction ({INSTRUCTION}), \
                 a long call ({EXPANSION}) and differences (17 to 19, 57 to 62)"
            ),
        }
    }
}

impl std::error::Error for Fault {}
