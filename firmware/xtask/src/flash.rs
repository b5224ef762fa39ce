//! `cargo xtask flash`: a chip's firmware onto a board at the cable.

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::toolchain::build_silently;

/// How fast the flash is read unless the user names another frequency.
const FREQUENCY: [&str; 2] = ["--flash-freq", "80mhz"];

/// Returns the options of espflash: those of the user, and [`FREQUENCY`] unless they name one.
pub(crate) fn espflash_options(given: &[String]) -> Vec<&str> {
    let names_one =
        |it: &String| it == FREQUENCY[0] || it.starts_with("--flash-freq=") || it.starts_with("-f");
    let own = if given.iter().any(names_one) { &[][..] } else { &FREQUENCY };
    own.iter().copied().chain(given.iter().map(String::as_str)).collect()
}

/// Builds, flashes, and stays with the log.
pub(crate) fn flash(chip: Chip, options: &Options, given: &[String]) -> Result<(), Error> {
    if !run::succeeds(run::command("espflash").arg("--version")) {
        return Err(Error::Sentence(
            "flashing needs espflash: `cargo install espflash --locked`".into(),
        ));
    }
    let elf = build_silently(chip, options)?;
    let mut command = run::command("espflash");
    command.args(["flash", "--monitor"]).args(espflash_options(given)).arg(elf);
    run::run(command.stdin(std::process::Stdio::inherit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_users_flash_frequency_replaces_the_default() {
        for (given, wanted) in [
            (&[][..], &["--flash-freq", "80mhz"][..]),
            (&["--port", "COM3"], &["--flash-freq", "80mhz", "--port", "COM3"]),
            (&["--flash-freq", "40mhz"], &["--flash-freq", "40mhz"]),
            (&["--flash-freq=40mhz"], &["--flash-freq=40mhz"]),
            (&["-f", "40mhz", "--no-stub"], &["-f", "40mhz", "--no-stub"]),
        ] {
            let given: Vec<String> = given.iter().copied().map(str::to_owned).collect();
            assert_eq!(espflash_options(&given), wanted);
        }
    }
}
