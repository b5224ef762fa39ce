//! rustc with what the stock one lacks for Xtensa, around its own library; for all other targets it is rustc.
//!
//! - rustc hands `asm!` to LLVM only for processors in its table of register classes. What is written for the ESP32 uses the
//!   class `reg` alone, which is LLVM's constraint `r` for every processor: the table of another one serves ([`STAND_IN`]).
//! - LLVM 22 writes literals out of reach where it writes object files. Each unit is written as text, its literals are moved
//!   ([`flix_xtensa::literals`]), and this program, called anew, assembles it by the same LLVM ([`assemble`]).
//! - Two packages are compiled with a change each ([`flix_xtensa::patches`]).
#![feature(rustc_private)]

extern crate rustc_ast;
extern crate rustc_codegen_llvm;
extern crate rustc_codegen_ssa;
extern crate rustc_data_structures;
extern crate rustc_driver;
extern crate rustc_interface;
extern crate rustc_metadata;
extern crate rustc_middle;
extern crate rustc_session;
extern crate rustc_span;
extern crate rustc_target;

mod backend;
mod sources;

use std::process::ExitCode;

use rustc_driver::{Callbacks, Compilation};
use rustc_interface::interface::{Compiler, Config};
use rustc_target::asm::InlineAsmArch;
use rustc_target::spec::Arch;

use backend::ByText;
use sources::Patched;

/// The processor whose table of register classes serves: its class `reg` takes 8 to 32 bits, and it adds no clobbers.
const STAND_IN: InlineAsmArch = InlineAsmArch::Hexagon;

/// Writes to a field of what the compiler hands out to be read, and returns what was there. Never inlined, and by a pointer: an
/// optimizer that saw the reference that the field was reached by would take the field for constant.
///
/// # Safety
/// No reference into the field may be alive, and no other thread may read it meanwhile.
#[expect(unsafe_code, reason = "the compiler has no other way to change these settings")]
#[inline(never)]
unsafe fn replace<T>(field: *const T, value: T) -> T {
    // SAFETY: the caller's promise.
    unsafe { std::ptr::replace(std::hint::black_box(field).cast_mut(), value) }
}

struct ForXtensa;

impl Callbacks for ForXtensa {
    fn config(&mut self, config: &mut Config) {
        config.file_loader = Some(Box::new(Patched));
        config.make_codegen_backend = Some(Box::new(|_, target| {
            let llvm = rustc_codegen_llvm::LlvmCodegenBackend::new();
            let assembles = std::env::var_os(backend::TEXT).is_some();
            if target.arch == Arch::Xtensa && !assembles { Box::new(ByText(llvm)) } else { llvm }
        }));
    }

    fn after_crate_root_parsing(
        &mut self,
        compiler: &Compiler,
        _: &mut rustc_ast::Crate,
    ) -> Compilation {
        let session = &compiler.sess;
        if session.target.arch == Arch::Xtensa && session.asm_arch.is_none() {
            // SAFETY: nothing but the crate's root is parsed yet, by this thread; what reads the field comes later.
            #[expect(unsafe_code, reason = "the compiler has no other way to change this setting")]
            unsafe {
                replace(&raw const session.asm_arch, Some(STAND_IN));
            }
        }
        Compilation::Continue
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    rustc_driver::catch_with_exit_code(|| {
        rustc_driver::run_compiler(&arguments, &mut ForXtensa);
    })
}
