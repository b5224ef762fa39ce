#![forbid(unsafe_code)]
//! An emulated Xtensa core: what an ESP32's LX6 executes of a program that is compiled without floating point, and how many
//! cycles that takes.
//!
//! | room | what is there |
//! |---|---|
//! | [`decode`] | an instruction's bits as an operation with its fields |
//! | [`processor`] | registers, their windows, special registers, loops; one instruction at a time |
//! | [`cost`] | cycles of an LX6, each an assumption that is stated |
//! | [`memory`] | the program's memory |
//! | [`simulator`] | the calls that a program makes of its makers' simulator: files, output, exit |
//! | [`beside`] | another emulator's log of registers, one block an instruction, and the first instruction that differs |
//!
//! The core knows no chip: a chip's memory and peripherals belong to whoever steps it. Window overflows and underflows enter
//! the program's own handlers. What is not emulated ends the run with its name and the program counter: floating point, the
//! multiply-accumulate unit, exceptions other than those of the windows, and interrupts.
//!
//! Source of all instructions: Xtensa Instruction Set Architecture Reference Manual, chapters 4 (options), 5 (special registers), 6 and 7.

pub mod beside;
pub mod cost;
pub mod decode;
pub mod memory;
pub mod processor;
pub mod simulator;
