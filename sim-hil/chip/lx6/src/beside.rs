//! Two emulators beside each other: ours, and one that logs all registers before each instruction, as QEMU does with
//! `-singlestep -d cpu,nochain`. The first instruction after which they differ ends the comparison.
//!
//! Not compared is what depends on how fast time passes: the counter of cycles, timers and pending interrupts. What the program reads of the
//! counter, the number of a file that it opens, and where handlers are after reset, are the other's.

use std::io::{BufRead, Write};
use std::ops::RangeInclusive;

use crate::decode::{Operation, decode};
use crate::processor::{REGISTERS, special};
use crate::simulator::{Simulator, Stop};

/// Special registers that are compared, by QEMU's names.
const COMPARED: [(&str, u8); 12] = [
    ("LBEG", special::LBEG),
    ("LEND", special::LEND),
    ("LCOUNT", special::LCOUNT),
    ("SAR", special::SAR),
    ("BR", special::BR),
    ("SCOMPARE1", special::SCOMPARE1),
    ("WINDOWBASE", special::WINDOWBASE),
    ("WINDOWSTART", special::WINDOWSTART),
    ("EPC1", special::EPC1),
    ("PS", special::PS),
    ("VECBASE", special::VECBASE),
    ("INTENABLE", special::INTENABLE),
];
/// Number of the call that opens a file.
const OPEN: u32 = 5;

/// All registers before an instruction, as logged: those that were not are `None`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct State {
    pc: u32,
    special: [Option<u32>; COMPARED.len()],
    physical: [Option<u32>; REGISTERS],
}

/// Why a comparison ended before its time.
#[derive(Debug, thiserror::Error)]
pub enum Difference {
    /// A register differs.
    #[error(
        "after {instructions} instructions, at {pc:#010x}, behind the one at {before:#010x} in {place}: {name} is {ours:#x}, \
         and {other:#x} on the other emulator"
    )]
    Register {
        /// How many instructions were the same.
        instructions: u64,
        /// Program counter, ours.
        pc: u32,
        /// That of the instruction that was executed last.
        before: u32,
        /// The function that it is in.
        place: String,
        /// The register's name.
        name: String,
        /// Ours.
        ours: u32,
        /// The other's.
        other: u32,
    },
    /// The program cannot go on here.
    #[error("after {instructions} instructions: {stop}")]
    Stop {
        /// How many instructions were the same.
        instructions: u64,
        /// Why.
        stop: Stop,
    },
    /// The log ended, or is none.
    #[error("the log holds {0} instructions, and more were to be compared")]
    Log(u64),
    /// The log cannot be read.
    #[error("the log cannot be read: {0}")]
    Read(#[from] std::io::Error),
}

/// What was compared.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Compared {
    /// Instructions that were executed.
    pub instructions: u64,
    /// Those at addresses that are compared: all registers the same after each.
    pub compared: u64,
    /// Window overflows and underflows among them.
    pub windows: u64,
    /// How often each operation was among them.
    pub operations: std::collections::BTreeMap<Operation, u64>,
}

/// Reads a log, one state after the other.
struct Log<R> {
    lines: std::io::Lines<R>,
    /// Program counter that the next state begins with.
    next: Option<u32>,
}

fn number(text: &str) -> Option<u32> {
    u32::from_str_radix(text.get(..8)?, 16).ok()
}

impl<R: BufRead> Log<R> {
    fn new(lines: R) -> Self {
        Self { lines: lines.lines(), next: None }
    }

    /// Returns the next state; `None` at the end of the log.
    fn state(&mut self) -> Result<Option<State>, std::io::Error> {
        let mut state = None;
        if let Some(pc) = self.next.take() {
            state = Some(State::at(pc));
        }
        for line in self.lines.by_ref() {
            let line = line?;
            if let Some(pc) = line.strip_prefix("PC=").and_then(number) {
                if state.is_some() {
                    self.next = Some(pc);
                    return Ok(state);
                }
                state = Some(State::at(pc));
            } else if let Some(state) = &mut state {
                line.split_whitespace()
                    .filter_map(|word| word.split_once('='))
                    .for_each(|word| state.read(word));
            }
        }
        Ok(state)
    }
}

impl State {
    fn at(pc: u32) -> Self {
        Self { pc, special: [None; COMPARED.len()], physical: [None; REGISTERS] }
    }

    fn read(&mut self, (name, value): (&str, &str)) {
        let Some(value) = number(value) else { return };
        if let Some(register) = name.strip_prefix("AR").and_then(|register| register.parse().ok()) {
            if let Some(room) = self.physical.get_mut::<usize>(register) {
                *room = Some(value);
            }
        } else if let Some(index) = COMPARED.iter().position(|(compared, _)| *compared == name) {
            self.special[index] = Some(value);
        }
    }

    /// Returns name, ours and the other's of the first register that differs.
    fn difference<W: Write>(&self, simulator: &Simulator<W>) -> Option<(String, u32, u32)> {
        let core = &simulator.core;
        let program_counter = ("PC".to_owned(), core.pc, Some(self.pc));
        let special = COMPARED.iter().zip(self.special).map(|((name, number), other)| {
            ((*name).to_owned(), core.special(*number).unwrap_or_default(), other)
        });
        let physical = self.physical.iter().enumerate();
        let physical =
            physical.map(|(number, other)| (format!("AR{number}"), core.physical(number), *other));
        let all = std::iter::once(program_counter).chain(special).chain(physical);
        all.filter_map(|(name, ours, other)| Some((name, ours, other?)))
            .find(|(_, ours, other)| ours != other)
    }
}

/// Executes instructions beside what this log says until `most` were compared. Where `within` names addresses, only instructions at
/// these are in the log; between them all registers still have to come out alike.
///
/// # Errors
/// At the first difference.
pub fn compare<W: Write>(
    simulator: &mut Simulator<W>,
    log: impl BufRead,
    most: u64,
    within: &[RangeInclusive<u32>],
) -> Result<Compared, Difference> {
    let mut log = Log::new(log);
    let mut operations = std::collections::BTreeMap::new();
    let mut before = simulator.core.pc;
    let mut last: Option<State> = None;
    let stopped = |instructions, stop| Difference::Stop { instructions, stop };
    let mut adopted: Option<Operation> = None;
    let mut compared = 0;
    let is_logged = |pc: &u32| within.is_empty() || within.iter().any(|range| range.contains(pc));
    loop {
        while !is_logged(&simulator.core.pc) {
            adopted = None;
            let instructions = simulator.core.instructions;
            if simulator.step().map_err(|stop| stopped(instructions, stop))?.is_some() {
                let windows = simulator.core.windows;
                return Ok(Compared { instructions, compared, windows, operations });
            }
        }
        let instructions = simulator.core.instructions;
        let Some(state) = log.state()? else { return Err(Difference::Log(instructions)) };
        // Where the other emulator began an instruction twice, as when its time was up.
        if last.as_ref() == Some(&state) {
            continue;
        }
        if last.is_none() {
            let vectors = COMPARED.iter().position(|(_, number)| *number == special::VECBASE);
            let vectors = vectors.and_then(|index| state.special[index]);
            simulator.core.set_vectors(vectors.unwrap_or_default());
        }
        if let Some(operation) = adopted.take() {
            adopt(simulator, operation, before, &state);
        }
        if let Some((name, ours, other)) = state.difference(simulator) {
            let place = simulator.memory.place(before);
            let pc = simulator.core.pc;
            return Err(Difference::Register {
                instructions,
                pc,
                before,
                place,
                name,
                ours,
                other,
            });
        }
        last = Some(state);
        if compared >= most {
            let windows = simulator.core.windows;
            return Ok(Compared { instructions, compared, windows, operations });
        }
        before = simulator.core.pc;
        let instruction = decode(simulator.memory.fetch(before).unwrap_or_default());
        let is_call = simulator.core.get(2) == OPEN;
        let end = simulator.step().map_err(|stop| stopped(instructions, stop))?;
        if simulator.core.instructions > instructions {
            *operations.entry(instruction.operation).or_default() += 1;
        }
        let is_time = instruction.immediate == i32::from(special::CCOUNT);
        adopted = match instruction.operation {
            Operation::Rsr if is_time => Some(Operation::Rsr),
            Operation::Simcall if is_call => Some(Operation::Simcall),
            _ => None,
        };
        compared += u64::from(simulator.core.instructions > instructions);
        if end.is_some() {
            let instructions = simulator.core.instructions;
            let windows = simulator.core.windows;
            return Ok(Compared { instructions, compared, windows, operations });
        }
    }
}

/// Takes over what only the other emulator can know: the time that was read, the number of the file that was opened.
fn adopt<W: Write>(simulator: &mut Simulator<W>, operation: Operation, at: u32, state: &State) {
    let register = match operation {
        Operation::Simcall => 2,
        _ => decode(simulator.memory.fetch(at).unwrap_or_default()).t,
    };
    let base = simulator.core.special(special::WINDOWBASE).unwrap_or_default() as usize * 4;
    let place = (base + usize::from(register)) % simulator.core.registers();
    let Some(value) = state.physical.get(place).copied().flatten() else { return };
    if operation == Operation::Simcall {
        simulator.rename(simulator.core.get(register), value);
    }
    simulator.core.set(register, value);
}
