//! `flix keygen`: makes a new pre-shared key.

use std::path::PathBuf;
use std::process::ExitCode;

use flix_host::link::keys::{self, Keyring};
use flix_shell::output::print;
use flix_shell::{Error, Exit};

/// Make a new key, in a file that only you can read.
///
/// The key itself is never shown. Give the same file to the robot (`flix provision`,
/// `flix-sim serve --key`) and to its operator (`--key`); each operator has a key of its own
/// (`flix provision --add-operator`).
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix keygen walker.key              a key in a file
  flix keygen --robot daisy   a key in your own keyring, found by its name")]
#[group(required = true)]
pub struct Args {
    /// File to write; it must not exist.
    file: Option<PathBuf>,
    /// Store the key in your keyring, under this name.
    #[arg(long, value_name = "NAME", conflicts_with = "file")]
    robot: Option<String>,
}

/// Makes the key and prints its path.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let key = keys::generate()?;
    let path = match (&args.robot, &args.file) {
        (Some(name), _) => Keyring::of_user()?.store(name, &key)?,
        (None, Some(path)) => {
            keys::write_new(path, &key)?;
            path.clone()
        }
        (None, None) => return Err(Error::usage("name a FILE or a --robot for the key")),
    };
    print(&format!("{}\n", path.display()))?;
    Ok(Exit::Done.into())
}
