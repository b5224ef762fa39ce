//! Names what lies at an address of the firmware: functions, files and lines, from its ELF file.

use addr2line::gimli::{Dwarf, EndianSlice, RunTimeEndian, SectionId};
use addr2line::{Context, demangle_auto};
use flix_protocol::message::BuildId;
use object::read::File;
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use serde::Serialize;
use sha2::{Digest, Sha256};

type Bytes<'elf> = EndianSlice<'elf, RunTimeEndian>;

/// Largest ELF file that is read, bytes; that of the firmware has some 20 million.
pub const LARGEST_ELF: u64 = 512 << 20;

/// Why a file names nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SymbolError {
    /// It is no ELF file.
    #[error("it is not an ELF file; the firmware's is target/*/chip/flix-robot")]
    NoElf,
    /// It is one without lines.
    #[error("it has no debug information; take the file that was built, before it was stripped")]
    NoDebugInformation,
    /// What it has of them is damaged.
    #[error("its debug information is damaged")]
    Damaged,
}

/// The names in an ELF file.
pub struct Symbols<'elf> {
    build: BuildId,
    context: Context<Bytes<'elf>>,
    file: File<'elf>,
}

/// A function that was running, or into which another was inlined.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Frame {
    /// Its name; `None` where nobody knows.
    pub function: Option<String>,
    /// The file of the place in it.
    pub file: Option<String>,
    /// The line, from 1.
    pub line: Option<u32>,
}

impl<'elf> Symbols<'elf> {
    /// Reads an ELF file from its bytes. Never panics.
    pub fn read(elf: &'elf [u8]) -> Result<Self, SymbolError> {
        let file = match File::parse(elf) {
            Ok(file @ (File::Elf32(_) | File::Elf64(_))) => file,
            _ => return Err(SymbolError::NoElf),
        };
        let section = |id: SectionId| file.section_by_name(id.name());
        if section(SectionId::DebugInfo).is_none() || section(SectionId::DebugLine).is_none() {
            return Err(SymbolError::NoDebugInformation);
        }
        let endian = match file.is_little_endian() {
            true => RunTimeEndian::Little,
            false => RunTimeEndian::Big,
        };
        let dwarf = Dwarf::load(|id| {
            let bytes = section(id).map_or(Ok(&[][..]), |section| section.data())?;
            Ok::<_, object::Error>(EndianSlice::new(bytes, endian))
        });
        let context = dwarf
            .map_err(|_| SymbolError::Damaged)
            .and_then(|dwarf| Context::from_dwarf(dwarf).map_err(|_| SymbolError::Damaged))?;
        let build = BuildId::of(&Sha256::digest(elf).into());
        Ok(Self { build: build.ok_or(SymbolError::NoElf)?, context, file })
    }

    /// Returns which build of the firmware this is.
    pub const fn build(&self) -> BuildId {
        self.build
    }

    /// Returns the functions at an address, those that were inlined first; at least one, which may have no name.
    pub fn frames(&self, address: u32) -> Vec<Frame> {
        let mut frames = self.known_frames(address).unwrap_or_default();
        if frames.is_empty() {
            frames.push(Frame { function: None, file: None, line: None });
        }
        // Debug information that is lines alone names no modules; the table of symbols does.
        if let (Some(last), Some(name)) = (frames.last_mut(), self.symbol(address)) {
            last.function = Some(name);
        }
        frames
    }

    fn known_frames(&self, address: u32) -> Option<Vec<Frame>> {
        let mut found = self.context.find_frames(address.into()).skip_all_loads().ok()?;
        let mut frames = Vec::new();
        while let Some(frame) = found.next().ok()? {
            let name = frame.function.and_then(|name| Some(name.demangle().ok()?.into_owned()));
            let (file, line) = frame.location.map_or((None, None), |it| (it.file, it.line));
            frames.push(Frame { function: name, file: file.map(str::to_owned), line });
        }
        Some(frames)
    }

    /// Returns the function that the table of symbols has at an address.
    fn symbol(&self, address: u32) -> Option<String> {
        let address = u64::from(address);
        let mut symbols = self.file.symbols().filter(|it| it.kind() == SymbolKind::Text);
        let symbol = symbols.find(|it| {
            address.checked_sub(it.address()).is_some_and(|offset| offset < it.size())
        })?;
        Some(demangle_auto(symbol.name().ok()?.into(), None).into_owned())
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use flix_host::system::file;

    /// Where nothing is inlined.
    #[inline(never)]
    fn marked() -> u32 {
        std::hint::black_box(line!())
    }

    fn own_program() -> Vec<u8> {
        let program = std::env::current_exe().expect("a test has a program");
        file::read(&program, LARGEST_ELF).expect("it runs")
    }

    fn address_of(elf: &[u8], name: &str) -> u32 {
        let file = File::parse(elf).expect("it runs");
        let found = file.symbols().find(|symbol| {
            symbol.kind() == SymbolKind::Text && symbol.name().is_ok_and(|it| it.contains(name))
        });
        let address = found.expect("it is in this file").address();
        address.try_into().expect("programs that find their own place begin at 0")
    }

    #[test]
    fn an_address_has_the_function_the_file_and_the_line_that_lie_there() {
        let line = marked();
        let elf = own_program();
        let symbols = Symbols::read(&elf).unwrap();
        let frames = symbols.frames(address_of(&elf, "symbols5tests6marked"));
        let frame = frames.last().unwrap();
        let name = frame.function.as_deref().unwrap();
        assert!(name.ends_with("symbols::tests::marked"), "{name}");
        assert!(frame.file.as_deref().unwrap().ends_with("host/cli/src/symbols.rs"), "{frame:?}");
        assert!(frame.line.unwrap().abs_diff(line) <= 2, "{frame:?}");
    }

    #[test]
    fn an_address_outside_the_program_has_no_name() {
        let elf = own_program();
        let symbols = Symbols::read(&elf).unwrap();
        assert_eq!(symbols.frames(u32::MAX), [Frame { function: None, file: None, line: None }]);
    }

    #[test]
    fn a_build_is_the_beginning_of_the_files_sha256() {
        let elf = own_program();
        let sha256: [u8; 32] = Sha256::digest(&elf).into();
        assert_eq!(Symbols::read(&elf).unwrap().build().0, sha256[..8]);
    }

    #[test]
    fn what_is_no_elf_file_with_lines_is_refused() {
        let mut elf = own_program();
        assert_eq!(Symbols::read(b"").err(), Some(SymbolError::NoElf));
        assert_eq!(Symbols::read(b"flix").err(), Some(SymbolError::NoElf));
        assert_eq!(Symbols::read(&elf[..16]).err(), Some(SymbolError::NoElf));
        // The names of the sections are what finds them.
        let name = b".debug_line\0";
        let at = elf.windows(name.len()).rposition(|bytes| bytes == name).unwrap();
        elf[at + 1] = b'D';
        assert_eq!(Symbols::read(&elf).err(), Some(SymbolError::NoDebugInformation));
    }
}
