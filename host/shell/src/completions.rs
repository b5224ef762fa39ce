//! Completion scripts of a program.

use clap::{Command, ValueHint};
pub use clap_complete::Shell;

use crate::Error;
use crate::output::print;

/// What options that take a folder call their value.
const FOLDER: &str = "DIR";

/// Prints the completion script of a shell.
///
/// # Errors
/// When standard output cannot be written.
pub fn write(shell: Shell, program: Command) -> Result<(), Error> {
    let (mut program, mut script) = (hinted(program), Vec::new());
    let name = program.get_name().to_owned();
    clap_complete::generate(shell, &mut program, name, &mut script);
    print(&String::from_utf8_lossy(&script))
}

/// Says of each path whether it is a file or a folder: a shell completes any other one only as far as its first blank.
fn hinted(command: Command) -> Command {
    let command = command.mut_args(|argument| {
        let is_folder = argument
            .get_value_names()
            .is_some_and(|names| names.iter().any(|name| name.as_str() == FOLDER));
        match argument.get_value_hint() {
            ValueHint::AnyPath if is_folder => argument.value_hint(ValueHint::DirPath),
            ValueHint::AnyPath => argument.value_hint(ValueHint::FilePath),
            _ => argument,
        }
    });
    command.mut_subcommands(hinted)
}
