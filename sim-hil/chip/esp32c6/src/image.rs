//! The image as it is flashed: its segments, its symbols, and the partition table that is flashed with it.

use std::collections::BTreeMap;

use md5::{Digest, Md5};
use object::{Object, ObjectSegment, ObjectSymbol, SymbolKind};

use crate::block::flash::Flash;

/// Why an image cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Not an ELF file.
    #[error("the image is no ELF file: {0}")]
    NotElf(#[from] object::Error),
    /// Of another processor.
    #[error("the image is for another processor: the ESP32-C6's is 32-bit RISC-V")]
    OtherProcessor,
}

/// A piece of memory that the boot loader fills, or that the cache shows.
#[derive(Debug, Clone)]
pub(crate) struct Segment {
    pub(crate) address: u32,
    pub(crate) data: Vec<u8>,
}

/// An image.
#[derive(Debug, Clone)]
pub struct Image {
    pub(crate) entry: u32,
    pub(crate) segments: Vec<Segment>,
    functions: BTreeMap<u32, String>,
    symbols: Vec<(u32, u32, String)>,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// When it is none, or of another processor.
    pub fn parse(bytes: &[u8]) -> Result<Self, ImageError> {
        let file = object::File::parse(bytes)?;
        if file.architecture() != object::Architecture::Riscv32 {
            return Err(ImageError::OtherProcessor);
        }
        let mut segments = Vec::new();
        for segment in file.segments() {
            let data = segment.data()?.to_vec();
            segments.push(Segment { address: segment.address() as u32, data });
        }
        let mut functions = BTreeMap::new();
        let mut symbols = Vec::new();
        for symbol in file.symbols() {
            let (at, name) =
                (symbol.address() as u32, symbol.name().unwrap_or_default().to_owned());
            if symbol.kind() == SymbolKind::Text {
                functions.insert(at, name.clone());
            }
            symbols.push((at, symbol.size() as u32, name));
        }
        Ok(Self { entry: file.entry() as u32, segments, functions, symbols })
    }

    /// Address and name of every symbol.
    pub(crate) fn symbols(&self) -> impl Iterator<Item = (u32, String)> + '_ {
        self.symbols.iter().map(|(at, _, name)| (*at, name.clone()))
    }

    /// Address and size of the first symbol that satisfies `is_wanted`.
    #[must_use]
    pub fn find(&self, is_wanted: impl Fn(&str) -> bool) -> Option<(u32, u32)> {
        self.find_all(is_wanted).next()
    }

    /// Addresses and sizes of all of them.
    pub fn find_all(&self, is_wanted: impl Fn(&str) -> bool) -> impl Iterator<Item = (u32, u32)> {
        let wanted = self.symbols.iter().filter(move |(.., name)| is_wanted(name));
        wanted.map(|(at, size, _)| (*at, *size))
    }

    /// Returns the function or constant that an address lies in; the address where none is known.
    pub(crate) fn name(&self, address: u32) -> String {
        let is_in = |(at, size, _): &&(u32, u32, String)| address.wrapping_sub(*at) < *size;
        match self.symbols.iter().find(is_in) {
            Some((.., name)) => format!("{:#}", rustc_demangle::demangle(name)),
            None => format!("{address:#010x}"),
        }
    }

    /// Returns the function that an address lies in, with the offset.
    #[must_use]
    pub fn place(&self, address: u32) -> String {
        match self.functions.range(..=address).next_back() {
            Some((start, name)) => {
                format!("{:#}+{:#x}", rustc_demangle::demangle(name), address - start)
            }
            None => format!("{address:#010x}"),
        }
    }
}

/// Where the boot loader keeps the partition table.
const TABLE_AT: usize = 0x8000;
/// Type, subtype, offset, size and name of the standard partitions of a flash of 4 MiB, as espflash writes them.
const PARTITIONS: [(u8, u8, u32, u32, &str); 3] = [
    (1, 2, 0x9000, 0x6000, "nvs"),
    (1, 1, 0xF000, 0x1000, "phy_init"),
    (0, 0, 0x1_0000, 0x3F_0000, "factory"),
];
/// Where settings and provisioning lie: start and length of `nvs`.
pub const STORE: std::ops::Range<usize> = 0x9000..0xF000;
/// Magic number, segments, mode and size (4 MiB) of the boot loader's header.
const HEADER: [u8; 4] = [0xE9, 4, 2, 0x20];

/// Creates a flash with boot loader header and partition table, and an empty store.
#[must_use]
pub fn programmed_flash() -> Flash {
    let mut table = Vec::new();
    for (kind, subtype, offset, size, label) in PARTITIONS {
        table.extend([0xAA, 0x50, kind, subtype]);
        table.extend(offset.to_le_bytes());
        table.extend(size.to_le_bytes());
        let mut name = [0; 16];
        name[..label.len()].copy_from_slice(label.as_bytes());
        table.extend(name);
        table.extend([0; 4]);
    }
    let sum = Md5::digest(&table);
    table.extend([0xEB, 0xEB]);
    table.extend([0xFF; 14]);
    table.extend(sum);
    let mut flash = Flash::new();
    flash.burn(0, &HEADER);
    flash.burn(TABLE_AT, &table);
    flash
}
