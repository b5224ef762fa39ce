//! The program's memory: pieces at addresses, little-endian.

use object::{Object, ObjectSegment, ObjectSymbol, SegmentFlags, elf};

/// Why a file is no program for this core.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// Not an ELF file.
    #[error("the program is no ELF file: {0}")]
    NotElf(#[from] object::Error),
    /// Of another processor.
    #[error("the program is for another processor than Xtensa")]
    OtherProcessor,
}

/// A piece of memory.
#[derive(Debug)]
pub(crate) struct Piece {
    pub(crate) start: u32,
    pub(crate) bytes: Vec<u8>,
    pub(crate) is_code: bool,
}

/// A program in memory.
#[derive(Debug)]
pub struct Memory {
    pub(crate) pieces: Vec<Piece>,
    /// Address of the first instruction.
    pub entry: u32,
    symbols: Vec<(u32, String)>,
}

impl Memory {
    /// Loads an ELF file: each segment is a piece as large as it is in memory.
    ///
    /// # Errors
    /// When it is none, or of another processor.
    pub fn load(file: &[u8]) -> Result<Self, ProgramError> {
        let file = object::File::parse(file)?;
        if file.architecture() != object::Architecture::Xtensa {
            return Err(ProgramError::OtherProcessor);
        }
        let mut pieces = Vec::new();
        for segment in file.segments() {
            let mut bytes = segment.data()?.to_vec();
            bytes.resize(segment.size() as usize, 0);
            let is_code = match segment.flags() {
                SegmentFlags::Elf { p_flags, .. } => p_flags.0 & elf::PF_X.0 != 0,
                _ => false,
            };
            pieces.push(Piece { start: segment.address() as u32, bytes, is_code });
        }
        // Assembled text has no kinds of symbols: those in code are functions, or places in them.
        let is_code = |address: u32| {
            pieces.iter().any(|piece: &Piece| {
                piece.is_code && (address.wrapping_sub(piece.start) as usize) < piece.bytes.len()
            })
        };
        let symbols = file
            .symbols()
            .map(|symbol| (symbol.address() as u32, symbol.name().unwrap_or_default().to_owned()));
        let mut symbols: Vec<(u32, String)> =
            symbols.filter(|(address, name)| is_code(*address) && !name.is_empty()).collect();
        symbols.sort();
        Ok(Self { pieces, entry: file.entry() as u32, symbols })
    }

    /// Creates memory of pieces: where each starts, its bytes, and whether it is code. The program starts at the first.
    #[must_use]
    pub fn of(pieces: Vec<(u32, Vec<u8>, bool)>) -> Self {
        let entry = pieces.first().map_or(0, |(start, ..)| *start);
        let piece = |(start, bytes, is_code)| Piece { start, bytes, is_code };
        Self { pieces: pieces.into_iter().map(piece).collect(), entry, symbols: Vec::new() }
    }

    /// Returns the function that an address lies in; the address itself where none is known.
    #[must_use]
    pub fn place(&self, address: u32) -> String {
        let after = self.symbols.partition_point(|(start, _)| *start <= address);
        match self.symbols[..after].last() {
            Some((start, name)) => format!("{name}+{:#x}", address - start),
            None => format!("{address:#010x}"),
        }
    }

    /// Returns the bytes at an address, to read.
    #[must_use]
    pub fn bytes(&self, address: u32, length: usize) -> Option<&[u8]> {
        self.pieces.iter().find_map(|piece| {
            piece.bytes.get(address.wrapping_sub(piece.start) as usize..)?.get(..length)
        })
    }

    /// Returns the bytes at an address, to write; none of code.
    pub fn bytes_mut(&mut self, address: u32, length: usize) -> Option<&mut [u8]> {
        self.pieces.iter_mut().filter(|piece| !piece.is_code).find_map(|piece| {
            piece.bytes.get_mut(address.wrapping_sub(piece.start) as usize..)?.get_mut(..length)
        })
    }

    /// Returns the number of `N` bytes at an address.
    #[inline]
    #[must_use]
    pub fn read<const N: usize>(&self, address: u32) -> Option<u32> {
        let bytes = self.bytes(address, N)?;
        let mut word = [0; 4];
        word[..N].copy_from_slice(bytes);
        Some(u32::from_le_bytes(word))
    }

    /// Stores the lowest `N` bytes of a number.
    #[inline]
    pub fn write<const N: usize>(&mut self, address: u32, value: u32) -> Option<()> {
        self.bytes_mut(address, N)?.copy_from_slice(&value.to_le_bytes()[..N]);
        Some(())
    }

    /// Returns the bits from an address on, as many as an instruction has at most; what is behind the end is zero.
    #[must_use]
    pub fn fetch(&self, address: u32) -> Option<u32> {
        let whole = self.read::<4>(address).or_else(|| self.read::<3>(address));
        whole.or_else(|| self.read::<2>(address))
    }
}
