//! The linker, as the compiler calls it: [`flix_xtensa::link`].

fn main() -> std::process::ExitCode {
    flix_xtensa::link::main()
}
