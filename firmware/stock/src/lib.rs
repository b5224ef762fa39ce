#![forbid(unsafe_code)]
//! Code for an ESP32 (Xtensa LX6) by the stock compiler and linker, experimental: `cargo xtask build esp32 --stock`.
//!
//! Stock rustc knows the target and its LLVM writes code for it, but three things are missing:
//!
//! | what is missing | what stands in |
//! |---|---|
//! | inline assembly | rustc, built anew around its own library: `driver/`, a package outside of the workspace |
//! | object files whose literals are in reach | each unit is written as text, its literals are moved ([`literals`]), and it is assembled |
//! | a linker that knows Xtensa | `rust-lld` links objects that look like RISC-V ([`disguise`]); their instructions are filled in afterwards ([`link`], [`instruction`]) |
//!
//! Two packages hold assembly that LLVM does not take; they are compiled with a change each ([`patches`]).
//!
//! All of it fits one release of rustc, [`RUSTC`]. What is known to be wrong is refused: arithmetic of 128 bits in
//! functions of the compiler's library, whose calls LLVM and rustc understand differently.

pub mod disguise;
mod elf;
pub mod fault;
pub mod instruction;
pub mod link;
pub mod literals;
pub mod patches;
mod release;

pub use release::{LLD, RUSTC};
