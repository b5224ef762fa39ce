//! Linking: objects in disguise, `rust-lld`, and the instructions filled in from the relocations that it emits.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::disguise;
use crate::elf::{self, Elf};
use crate::fault::{self, Fault};
use crate::instruction::{self, Kind, Misfit};
use crate::release::LLD;

/// Options of `rust-lld` before all others: what the disguise is, and that it reports where addresses belong.
const OPTIONS: [&str; 6] = ["-flavor", "gnu", "-m", "elf32lriscv", "--emit-relocs", "--no-relax"];
/// An option for compilers that link, which the ESP32's usual linker is.
const FOR_COMPILERS: &str = "-nostartfiles";
/// Flags of an Xtensa program: with GNU's and Espressif's notes on its instructions (`EF_XTENSA_XT_INSN | EF_XTENSA_XT_LIT`).
const FLAGS: u32 = 0x300;
/// What names of the compiler's library's functions for 128 bits begin with, besides those that [`is_wide`] knows by their end.
const WIDE: [&str; 4] = ["floatti", "floatunti", "rust_u128", "rust_i128"];
/// Symbols that rustc defines beside all crates, by the end of their names, and what they are the same as. Only the compiler
/// proper generates them.
const SHIMS: [(&str, Shim); 2] = [
    ("26___rust_alloc_error_handler", Shim::Like("25___rdl_alloc_error_handler")),
    ("35___rust_no_alloc_shim_is_unstable_v2", Shim::Is("no_init_hook")),
];
/// What is in front of the names above: rustc's own mangled names.
const OF_COMPILER: &str = "_7___rustc";
/// Most misfits that a message lists.
const LISTED: usize = 10;

/// What a symbol is the same as: one of another name of the same crate, or one of this name, which does nothing.
#[derive(Clone, Copy)]
enum Shim {
    Like(&'static str),
    Is(&'static str),
}

/// Why nothing was linked.
#[derive(Debug)]
pub enum Error {
    /// A file cannot be read or written.
    File(PathBuf, std::io::Error),
    /// An object or an archive that cannot be linked.
    Object(PathBuf, Fault),
    /// `rust-lld` failed and has printed why.
    Lld,
    /// An option is missing.
    Usage(&'static str),
    /// Instructions that cannot name their targets: the places and the targets.
    Misfits(Vec<(u32, u32, Misfit)>),
    /// Symbols that instructions name and nothing defines.
    Undefined(BTreeSet<String>),
    /// Functions that are known to be compiled wrongly.
    Wide(BTreeSet<String>),
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path, error) => write!(formatter, "{}: {error}", path.display()),
            Self::Object(path, fault) => write!(formatter, "{}: {fault}", path.display()),
            Self::Lld => formatter.write_str("rust-lld failed; its message is above"),
            Self::Usage(sentence) => formatter.write_str(sentence),
            Self::Misfits(misfits) => {
                write!(formatter, "{} instructions cannot name their targets:", misfits.len())?;
                misfits.iter().take(LISTED).try_for_each(|(place, target, misfit)| {
                    write!(formatter, "\n  at {place:#010x} for {target:#010x}: {misfit}")
                })
            }
            Self::Undefined(names) => write!(formatter, "undefined: {}", listed(names)),
            Self::Wide(names) => write!(
                formatter,
                "arithmetic of 128 bits is linked ({}), which this compiler gets wrong: use 64 bits",
                listed(names)
            ),
        }
    }
}

impl std::error::Error for Error {}

fn listed(names: &BTreeSet<String>) -> String {
    names.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

/// How many instructions of each kind were filled in.
pub type Filled = BTreeMap<Kind, usize>;

/// Links as a linker is called: with the arguments of the command line.
#[must_use]
pub fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match std::env::var_os(LLD) {
        Some(lld) => link(Path::new(&lld), &arguments).map(drop),
        None => Err(Error::Usage("XTENSA_LLD shall hold the path of rust-lld")),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Links by GNU linkers' options, among them `-o`; returns what was filled in.
///
/// # Errors
/// Where something is missing or cannot be linked; each message says what.
pub fn link(lld: &Path, arguments: &[String]) -> Result<Filled, Error> {
    let arguments = unfolded(arguments)?;
    let output = arguments.iter().skip_while(|argument| *argument != "-o").nth(1);
    let output = PathBuf::from(output.ok_or(Error::Usage("-o and a path are missing"))?);
    let mut copies = Copies::open(output.with_extension("disguised"))?;
    let disguised = arguments
        .iter()
        .filter(|argument| *argument != FOR_COMPILERS)
        .map(|argument| copies.argument(argument, &arguments, &output))
        .collect::<Result<Vec<String>, Error>>()?;
    let shims = copies.shims.iter().map(|(name, same)| format!("--defsym={name}={same}"));
    let status = Command::new(lld).args(OPTIONS).args(shims).args(&disguised).status();
    let status = status.map_err(|error| Error::File(lld.to_path_buf(), error))?;
    if !status.success() {
        return Err(Error::Lld);
    }
    let in_output = |error| Error::File(output.clone(), error);
    let mut file = fs::read(&output).map_err(in_output)?;
    let filled = finish(&mut file, &output);
    match filled {
        Ok(_) => fs::write(&output, &file).map_err(in_output)?,
        // Half of a program shall not be taken for one.
        Err(_) => fs::remove_file(&output).map_err(in_output)?,
    }
    filled
}

/// Returns the arguments, or those in the file that `@FILE` names, one a line.
fn unfolded(arguments: &[String]) -> Result<Vec<String>, Error> {
    let [folded] = arguments else { return Ok(arguments.to_vec()) };
    let Some(path) = folded.strip_prefix('@') else { return Ok(arguments.to_vec()) };
    let text = fs::read_to_string(path).map_err(|error| Error::File(path.into(), error))?;
    let lines = text.lines().map(|line| unescaped(line.trim().trim_matches('"')));
    Ok(lines.filter(|line| !line.is_empty()).collect())
}

/// Returns the text with each character that stands behind a backslash in place of both.
fn unescaped(text: &str) -> String {
    let mut characters = text.chars();
    let next = || match characters.next()? {
        '\\' => characters.next(),
        character => Some(character),
    };
    std::iter::from_fn(next).collect()
}

/// Copies of objects and archives, disguised, in a folder that goes with this.
struct Copies {
    folder: PathBuf,
    made: BTreeMap<PathBuf, String>,
    shims: BTreeMap<String, String>,
}

impl Copies {
    fn open(folder: PathBuf) -> Result<Self, Error> {
        fs::create_dir_all(&folder).map_err(|error| Error::File(folder.clone(), error))?;
        Ok(Self { folder, made: BTreeMap::new(), shims: BTreeMap::new() })
    }

    /// Returns an argument with a disguised copy in place of an object, an archive or a library.
    fn argument(&mut self, argument: &str, all: &[String], output: &Path) -> Result<String, Error> {
        if let Some(library) = argument.strip_prefix("-l").filter(|library| !library.is_empty()) {
            let file = format!("lib{library}.a");
            let found = folders(all)
                .map(|folder| Path::new(folder).join(&file))
                .find(|path| path.is_file());
            return found.map_or_else(|| Ok(argument.to_owned()), |path| self.copy(&path));
        }
        let path = Path::new(argument);
        if argument.starts_with('-') || path == output || !path.is_file() {
            return Ok(argument.to_owned());
        }
        self.copy(path)
    }

    fn copy(&mut self, path: &Path) -> Result<String, Error> {
        if let Some(copy) = self.made.get(path) {
            return Ok(copy.clone());
        }
        let in_path = |error| Error::File(path.to_path_buf(), error);
        let mut file = fs::read(path).map_err(in_path)?;
        let mut copy = path.to_string_lossy().into_owned();
        if disguise::is_linkable(&file) {
            let fault = |fault| Error::Object(path.to_path_buf(), fault);
            disguise::for_each_object(&mut file, |object| self.find_shims(object))
                .map_err(fault)?;
            disguise::disguise(&mut file).map_err(fault)?;
            // Two of the same name in different folders stay two.
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let disguised = self.folder.join(format!("{}-{name}", self.made.len()));
            fs::write(&disguised, &file).map_err(in_path)?;
            copy = disguised.to_string_lossy().into_owned();
        }
        self.made.insert(path.to_path_buf(), copy.clone());
        Ok(copy)
    }

    /// Looks for symbols that rustc alone would define.
    fn find_shims(&mut self, object: &mut [u8]) -> Result<(), Fault> {
        let elf = Elf::read(object)?;
        for section in elf.sections().into_iter().filter(|section| section.kind == elf::SYMBOLS) {
            for symbol in elf.symbols(section)?.into_iter().filter(|symbol| symbol.section == 0) {
                let name = elf.symbol_name(section, symbol)?;
                for (end, shim) in SHIMS {
                    let Some(crate_of) =
                        name.strip_suffix(end).filter(|rest| rest.ends_with(OF_COMPILER))
                    else {
                        continue;
                    };
                    let same = match shim {
                        Shim::Like(other) => format!("{crate_of}{other}"),
                        Shim::Is(other) => other.to_owned(),
                    };
                    self.shims.insert(name.to_owned(), same);
                }
            }
        }
        Ok(())
    }
}

impl Drop for Copies {
    fn drop(&mut self) {
        // What is left is in the way of nobody.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Returns the folders of libraries: `-L FOLDER` and `-LFOLDER`.
fn folders(arguments: &[String]) -> impl Iterator<Item = &str> {
    let next = arguments.iter().skip(1).map(String::as_str).chain([""]);
    arguments.iter().zip(next).filter_map(|(argument, next)| match argument.strip_prefix("-L")? {
        "" => Some(next),
        folder => Some(folder),
    })
}

/// Fills in the instructions of what was linked and takes the disguise off.
fn finish(file: &mut [u8], output: &Path) -> Result<Filled, Error> {
    let fault = |fault| Error::Object(output.to_path_buf(), fault);
    let mut elf = Elf::read(file).map_err(fault)?;
    let wide = wide(&elf).map_err(fault)?;
    if !wide.is_empty() {
        return Err(Error::Wide(wide));
    }
    let mut unfilled = Unfilled::default();
    let filled = fill(&mut elf, &mut unfilled).map_err(fault)?;
    elf.set_machine(disguise::XTENSA, FLAGS).map_err(fault)?;
    match unfilled {
        Unfilled { undefined, .. } if !undefined.is_empty() => Err(Error::Undefined(undefined)),
        Unfilled { misfits, .. } if !misfits.is_empty() => Err(Error::Misfits(misfits)),
        _ => Ok(filled),
    }
}

/// What cannot be filled in: instructions, and symbols that nothing defines.
#[derive(Default)]
struct Unfilled {
    misfits: Vec<(u32, u32, Misfit)>,
    undefined: BTreeSet<String>,
}

fn fill(elf: &mut Elf<'_>, unfilled: &mut Unfilled) -> Result<Filled, Fault> {
    let mut filled = Filled::new();
    for section in elf.sections().into_iter().filter(|section| section.kind == elf::WITH_ADDENDS) {
        let code = elf.section(section.info)?;
        if code.flags & elf::ALLOCATED == 0 {
            continue;
        }
        let table = elf.section(section.link)?;
        let symbols = elf.symbols(table)?;
        for relocation in elf.relocations(section)? {
            let is_left = relocation.symbol == 0 && relocation.addend == disguise::LEFT_ALONE;
            // Words are filled in.
            if relocation.kind != disguise::NONE || is_left {
                continue;
            }
            let symbol = match relocation.symbol {
                0 => return Err(Fault::Untargeted),
                number => *symbols.get(number).ok_or(Fault::Truncated)?,
            };
            if symbol.section == 0 {
                unfilled.undefined.insert(elf.symbol_name(table, symbol)?.to_owned());
                continue;
            }
            let target = symbol.value.wrapping_add(relocation.addend);
            let offset = relocation.place.checked_sub(code.address).ok_or(Fault::Truncated)?;
            match instruction::fill(elf.contents(code, offset)?, relocation.place, target) {
                Ok(kind) => *filled.entry(kind).or_default() += 1,
                Err(misfit) => unfilled.misfits.push((relocation.place, target, misfit)),
            }
            let kind = fault::INSTRUCTION;
            elf.set_relocation(elf::Relocation { kind, ..relocation })?;
        }
    }
    Ok(filled)
}

/// Returns whether a function of the compiler's library takes or gives 128 bits: its name ends with `ti` and the number of its
/// operands, converts from or to `ti`, or is rustc's own.
fn is_wide(name: &str) -> bool {
    let Some(name) = name.strip_prefix("__") else { return false };
    let operation = name.trim_end_matches(|last: char| last.is_ascii_digit());
    let is_counted = operation.len() < name.len() && operation.ends_with("ti");
    let is_made = name.starts_with("fix") && name.ends_with("ti");
    is_counted || is_made || WIDE.iter().any(|begin| name.starts_with(begin))
}

/// Returns the functions for 128 bits that are linked.
fn wide(elf: &Elf<'_>) -> Result<BTreeSet<String>, Fault> {
    let mut wide = BTreeSet::new();
    for section in elf.sections().into_iter().filter(|section| section.kind == elf::SYMBOLS) {
        for symbol in elf.symbols(section)?.into_iter().filter(|symbol| symbol.section != 0) {
            let name = elf.symbol_name(section, symbol)?;
            if is_wide(name) {
                wide.insert(name.to_owned());
            }
        }
    }
    Ok(wide)
}
