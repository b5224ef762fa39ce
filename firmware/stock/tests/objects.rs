//! Objects and archives as compilers for Xtensa write them, made here (System V ABI, "Object Files").

/// Numbers of GNU binutils, `include/elf/xtensa.h`.
pub const WORD: u8 = 1;
pub const EXPANSION: u8 = 11;
pub const INSTRUCTION: u8 = 20;

/// What a symbol is (System V ABI, `st_info`): global; local; a section.
pub const GLOBAL: u8 = 0x10;
pub const LOCAL: u8 = 0;
pub const SECTION: u8 = 3;

pub struct Relocation {
    pub place: u32,
    pub kind: u8,
    pub symbol: &'static str,
    pub addend: i32,
}

#[derive(Default)]
pub struct Section {
    pub name: &'static str,
    pub is_code: bool,
    /// Whether it has no contents, but a size.
    pub is_zeroed: bool,
    /// Whether it is in no memory.
    pub is_note: bool,
    pub bytes: Vec<u8>,
    pub relocations: Vec<Relocation>,
}

impl Section {
    pub fn code(name: &'static str) -> Self {
        Self { name, is_code: true, ..Self::default() }
    }

    pub fn data(name: &'static str) -> Self {
        Self { name, ..Self::default() }
    }

    /// Adds bytes, and a relocation of the first of them.
    pub fn with(mut self, bytes: &[u8], kind: u8, symbol: &'static str, addend: i32) -> Self {
        let place = self.bytes.len() as u32;
        self.relocations.push(Relocation { place, kind, symbol, addend });
        self.plain(bytes)
    }

    pub fn plain(mut self, bytes: &[u8]) -> Self {
        self.bytes.extend_from_slice(bytes);
        self
    }
}

/// Sections, and symbols: each a name, the section that defines it, and the offset there. A relocation may name no symbol.
pub struct Object {
    pub sections: Vec<Section>,
    pub symbols: Vec<(&'static str, &'static str, u32)>,
    /// What all symbols are that are defined.
    pub defined: u8,
    /// Whether relocations are written without their addends.
    pub is_without_addends: bool,
}

fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Names with a zero after each, and where one begins.
#[derive(Default)]
struct Names(Vec<u8>);

impl Names {
    fn add(&mut self, name: &str) -> u32 {
        if self.0.is_empty() {
            self.0.push(0);
        }
        let at = self.0.len() as u32;
        self.0.extend(name.bytes().chain([0]));
        at
    }
}

impl Object {
    pub fn new(sections: Vec<Section>, symbols: &[(&'static str, &'static str, u32)]) -> Self {
        Self { sections, symbols: symbols.to_vec(), defined: GLOBAL, is_without_addends: false }
    }

    /// Returns all symbols: those defined, then those that relocations name besides.
    fn all_symbols(&self) -> Vec<(&'static str, &'static str, u32)> {
        let mut all = self.symbols.clone();
        for relocation in self.sections.iter().flat_map(|section| &section.relocations) {
            let is_listed = all.iter().any(|(name, ..)| *name == relocation.symbol);
            if !relocation.symbol.is_empty() && !is_listed {
                all.push((relocation.symbol, "", 0));
            }
        }
        all
    }

    pub fn bytes(&self) -> Vec<u8> {
        let symbols = self.all_symbols();
        let index = |name: &str| match name {
            "" => 0,
            _ => 1 + symbols.iter().position(|(one, ..)| *one == name).unwrap() as u32,
        };
        let (mut names, mut strings) = (Names::default(), Names::default());
        let count = self.sections.len() as u32;
        // Name, kind, flags, contents, link, information, alignment, size of an entry.
        let mut headers: Vec<([u32; 3], Vec<u8>, [u32; 4])> = vec![([0; 3], Vec::new(), [0; 4])];
        for section in &self.sections {
            let flags = match section {
                Section { is_note: true, .. } => 0,
                Section { is_code: true, .. } => 6,
                _ => 3,
            };
            let kind = if section.is_zeroed { 8 } else { 1 };
            headers.push((
                [names.add(section.name), kind, flags],
                section.bytes.clone(),
                [0, 0, 4, 0],
            ));
        }
        // Behind the sections: one of relocations for each, symbols, and the two of names.
        let table_of_symbols = 1 + 2 * count;
        for (section, number) in self.sections.iter().zip(1..) {
            let contents = section.relocations.iter().flat_map(|relocation| {
                let Relocation { place, kind, symbol, addend } = relocation;
                let information = index(symbol) << 8 | u32::from(*kind);
                let addend = (!self.is_without_addends).then_some(addend.cast_unsigned());
                words(&[*place, information]).into_iter().chain(words(addend.as_slice()))
            });
            let (kind, size) = if self.is_without_addends { (9, 8) } else { (4, 12) };
            let name = names.add(&format!(".rela{}", section.name));
            headers.push((
                [name, kind, 0],
                contents.collect(),
                [table_of_symbols, number, 4, size],
            ));
        }
        let mut contents = words(&[0; 4]);
        for (name, section, value) in &symbols {
            let place =
                self.sections.iter().position(|one| one.name == *section).map_or(0, |at| at + 1);
            let kind = if place == 0 { GLOBAL } else { self.defined };
            let information = u32::from(kind) | (place as u32) << 16;
            contents.extend(words(&[strings.add(name), *value, 0, information]));
        }
        // Behind those that are not global.
        let first = if self.defined == GLOBAL { 1 } else { 1 + self.symbols.len() as u32 };
        headers.push((
            [names.add(".symtab"), 2, 0],
            contents,
            [table_of_symbols + 1, first, 4, 16],
        ));
        headers.push(([names.add(".strtab"), 3, 0], strings.0, [0, 0, 1, 0]));
        let own = names.add(".shstrtab");
        headers.push(([own, 3, 0], names.0, [0, 0, 1, 0]));
        Self::file(headers)
    }

    fn file(headers: Vec<([u32; 3], Vec<u8>, [u32; 4])>) -> Vec<u8> {
        let count = headers.len() as u32;
        let (mut body, mut table) = (Vec::new(), Vec::new());
        for (first, contents, [link, information, alignment, entry]) in headers {
            body.resize(body.len().next_multiple_of(4), 0);
            let offset = 52 + body.len() as u32;
            table.extend(words(&first));
            table.extend(words(&[
                0,
                offset,
                contents.len() as u32,
                link,
                information,
                alignment,
                entry,
            ]));
            body.extend(contents);
        }
        body.resize(body.len().next_multiple_of(4), 0);
        // 32 bits, little-endian; an object for Xtensa.
        let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
        file.extend(words(&[1 | 94 << 16, 1, 0, 0, 52 + body.len() as u32, 0x300, 52]));
        file.extend(words(&[40 << 16, count | (count - 1) << 16]));
        file.extend(body);
        file.extend(table);
        file
    }
}

/// Returns an archive of these files, without a table of symbols.
pub fn archive(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = b"!<arch>\n".to_vec();
    for (name, bytes) in members {
        let size = bytes.len();
        archive.extend(
            format!("{:<16}{:<12}{:<6}{:<6}{:<8}{size:<10}`\n", format!("{name}/"), 0, 0, 0, 644)
                .bytes(),
        );
        archive.extend(bytes);
        archive.resize(archive.len().next_multiple_of(2), b'\n');
    }
    archive
}
