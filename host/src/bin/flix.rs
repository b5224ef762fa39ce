//! The operator's command line.

fn main() -> std::process::ExitCode {
    flix_host::cli::main()
}
