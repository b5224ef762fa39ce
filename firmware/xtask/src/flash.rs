//! `cargo xtask flash`: a chip's firmware onto a board at the cable.

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::toolchain::{choose, for_chip};

/// Builds, flashes by the configured runner, and stays with the log.
pub(crate) fn flash(chip: Chip, options: &Options) -> Result<(), Error> {
    if !run::succeeds(run::command("espflash").arg("--version")) {
        return Err(Error::Sentence(
            "flashing needs espflash: `cargo install espflash --locked`".into(),
        ));
    }
    let mut command = for_chip(chip, "run")?;
    choose(&mut command, chip, options);
    run::run(command.stdin(std::process::Stdio::inherit()))
}
