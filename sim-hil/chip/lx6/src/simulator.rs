//! The calls that a program makes of its makers' simulator (instruction `simcall`), as QEMU answers them (`target/xtensa/xtensa-semi.c`):
//! the call's number in `a2`, arguments from `a3` on, the result in `a2`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};
use std::path::PathBuf;

use crate::memory::Memory;
use crate::processor::{Core, Fault, Step};

/// Numbers of the calls.
mod number {
    pub(super) const EXIT: u32 = 1;
    pub(super) const READ: u32 = 3;
    pub(super) const WRITE: u32 = 4;
    pub(super) const OPEN: u32 = 5;
}

/// The program's output and its errors, as descriptors.
const OUTPUT: [u32; 2] = [1, 2];
/// The first descriptor of a file.
const FIRST_FILE: u32 = 3;
/// Longest path.
const LONGEST_PATH: u32 = 4096;
const FAILED: u32 = u32::MAX;

/// Why a program ended otherwise than by `exit`.
#[derive(Debug, thiserror::Error)]
pub enum Stop {
    /// It did what is not emulated.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// A call that is not known.
    #[error("call {0} of the simulator, which is not known")]
    Call(u32),
    /// Its output could not be written.
    #[error("the program's output cannot be written: {0}")]
    Output(#[from] std::io::Error),
}

/// A computer with a processor, a program, files to read and an output.
pub struct Simulator<W> {
    /// The processor.
    pub core: Core,
    /// The program.
    pub memory: Memory,
    folder: PathBuf,
    files: BTreeMap<u32, File>,
    output: W,
}

impl<W: Write> Simulator<W> {
    /// Creates a computer; relative paths that the program opens are in `folder`.
    pub fn new(core: Core, memory: Memory, folder: PathBuf, output: W) -> Self {
        Self { core, memory, folder, files: BTreeMap::new(), output }
    }

    /// Runs the program to its end; returns its exit code.
    ///
    /// # Errors
    /// When it does what is not emulated.
    pub fn run(&mut self) -> Result<u32, Stop> {
        loop {
            if let Some(code) = self.step()? {
                return Ok(code);
            }
        }
    }

    /// Executes an instruction; returns the exit code of a program that ends.
    ///
    /// # Errors
    /// When it does what is not emulated.
    #[inline]
    pub fn step(&mut self) -> Result<Option<u32>, Stop> {
        match self.core.step(&mut self.memory)? {
            Step::Done => Ok(None),
            Step::Simcall => self.answer(),
        }
    }

    /// Gives the file that was opened as `descriptor` another one.
    pub fn rename(&mut self, descriptor: u32, other: u32) {
        if let Some(file) = self.files.remove(&descriptor) {
            self.files.insert(other, file);
        }
    }

    fn answer(&mut self) -> Result<Option<u32>, Stop> {
        let [call, first, second, third] = [2, 3, 4, 5].map(|register| self.core.get(register));
        let result = match call {
            number::EXIT => {
                self.output.flush()?;
                return Ok(Some(first));
            }
            number::WRITE => self.write(first, second, third)?,
            number::READ => self.read(first, second, third),
            number::OPEN => self.open(first),
            _ => return Err(Stop::Call(call)),
        };
        self.core.set(2, result.unwrap_or(FAILED));
        // The error's number: none, or "input or output".
        self.core.set(3, if result.is_some() { 0 } else { 5 });
        Ok(None)
    }

    fn write(&mut self, descriptor: u32, start: u32, length: u32) -> Result<Option<u32>, Stop> {
        let Some(text) = self.memory.bytes(start, length as usize) else { return Ok(None) };
        if !OUTPUT.contains(&descriptor) {
            return Ok(None);
        }
        self.output.write_all(text)?;
        Ok(Some(length))
    }

    fn read(&mut self, descriptor: u32, start: u32, length: u32) -> Option<u32> {
        let file = self.files.get_mut(&descriptor)?;
        let room = self.memory.bytes_mut(start, length as usize)?;
        let mut count = 0;
        while count < room.len() {
            match file.read(&mut room[count..]).ok()? {
                0 => break,
                more => count += more,
            }
        }
        Some(count as u32)
    }

    fn open(&mut self, path: u32) -> Option<u32> {
        let bytes = (0..LONGEST_PATH).map_while(|index| self.memory.read::<1>(path + index));
        let path: Vec<u8> = bytes.take_while(|byte| *byte != 0).map(|byte| byte as u8).collect();
        let file = File::open(self.folder.join(String::from_utf8(path).ok()?)).ok()?;
        let descriptor = self.files.last_key_value().map_or(FIRST_FILE, |(last, _)| last + 1);
        self.files.insert(descriptor, file);
        Some(descriptor)
    }
}
