//! Manual pages of a program.

use std::path::{Path, PathBuf};

use crate::Error;
use crate::output::print;

/// Write the manual pages into a folder.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the pages.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Writes a page of a program, and one of each of its commands.
///
/// # Errors
/// When they cannot be written.
pub fn write(program: clap::Command, folder: &Path) -> Result<(), Error> {
    if folder.exists() && !folder.is_dir() {
        return Err(Error::usage(format_args!("{} is not a folder", folder.display())));
    }
    let page = folder.join(format!("{}.1", program.get_name()));
    std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(program, folder))
        .map_err(|error| Error::usage(format_args!("{}: {error}", folder.display())))?;
    print(&format!("{} and the pages of its commands\n", page.display()))
}
