//! Running other programs, and the one error of this program.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Why a task stopped. Each says what to do.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// A program is not installed.
    #[error("{program} cannot be started ({source}): {}", remedy(program))]
    Missing {
        /// Its name.
        program: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A program ended with an error, which it has printed.
    #[error("{0} failed; its message is above")]
    Failed(String),
    /// Something needed is absent, or a promise does not hold; the sentence says what to do.
    #[error("{0}")]
    Sentence(String),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Its path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Programs that `cargo xtask setup` brings.
const BROUGHT: [&str; 4] = ["qemu", "chrom", "esptool", "rust"];

/// Returns how a program comes onto this machine.
fn remedy(program: &str) -> String {
    let name = Path::new(program).file_name().map_or(program.into(), |name| name.to_string_lossy());
    match BROUGHT.iter().any(|brought| name.starts_with(brought)) {
        true => "run `cargo xtask setup`".to_owned(),
        false => format!("install {name}, and name its folder in PATH"),
    }
}

/// Returns the repository's folder.
pub(crate) fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here).to_path_buf()
}

/// Returns the folder where cargo builds.
pub(crate) fn target_directory() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Prepares a command in the repository, with cargo's influence on a nested toolchain removed.
pub(crate) fn command(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root()).stdin(Stdio::null());
    command
}

fn name(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let program = program.file_name().unwrap_or(program.as_os_str());
    let words = command.get_args().take(2).map(|argument| argument.to_string_lossy());
    std::iter::once(program.to_string_lossy()).chain(words).collect::<Vec<_>>().join(" ")
}

/// Runs to the end; its output goes where ours goes.
pub(crate) fn run(command: &mut Command) -> Result<(), Error> {
    let status = command.status().map_err(|source| Error::Missing {
        program: command.get_program().to_string_lossy().into_owned(),
        source,
    })?;
    if status.success() { Ok(()) } else { Err(Error::Failed(name(command))) }
}

/// Runs to the end and gives what it printed on its standard output.
pub(crate) fn output(command: &mut Command) -> Result<String, Error> {
    let output = command.stderr(Stdio::inherit()).output().map_err(|source| Error::Missing {
        program: command.get_program().to_string_lossy().into_owned(),
        source,
    })?;
    if output.status.success() {
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    } else {
        Err(Error::Failed(name(command)))
    }
}

/// Returns whether a command runs and succeeds, silently.
pub(crate) fn succeeds(command: &mut Command) -> bool {
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Returns whether the user may install programs.
pub(crate) fn is_root() -> bool {
    let user = command("id").arg("-u").output();
    user.is_ok_and(|user| user.stdout.trim_ascii() == b"0")
}

/// Returns the day, as in 2026-11-25, in UTC.
pub(crate) fn today() -> Result<String, Error> {
    Ok(output(command("date").args(["-u", "+%F"]))?.trim().to_owned())
}

/// Commands run in the repository; paths are given from where the user is.
pub(crate) fn absolute(path: &Path) -> Result<PathBuf, Error> {
    std::path::absolute(path).map_err(|source| Error::File { path: path.to_path_buf(), source })
}

/// Parses a file that was built for a chip.
pub(crate) fn elf(bytes: &[u8]) -> Result<object::File<'_>, Error> {
    object::File::parse(bytes)
        .map_err(|error| Error::Sentence(format!("the built file is not an ELF file: {error}")))
}

/// Reads a file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    std::fs::read(path).map_err(|source| Error::File { path: path.to_path_buf(), source })
}

/// Writes a file and the directories above it.
pub(crate) fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), Error> {
    let file = |source| Error::File { path: path.to_path_buf(), source };
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory).map_err(file)?;
    }
    std::fs::write(path, contents).map_err(file)
}
