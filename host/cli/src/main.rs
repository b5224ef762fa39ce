//! The operator's command line.

fn main() -> std::process::ExitCode {
    flix_cli::main()
}
