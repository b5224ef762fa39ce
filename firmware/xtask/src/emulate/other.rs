//! The image with other encoders, run beside the one that is asked for.

use std::path::PathBuf;

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::toolchain;

/// The part in which the image with the other encoders is run.
pub(super) const PART: &str = "other";

/// Chooses the other encoders and a battery divider.
pub(super) fn options() -> Options {
    Options { encoder: Some("as5047p".into()), battery_divider: true, ..Options::default() }
}

/// Builds the other image; it lies beside the one that is built next.
pub(super) fn image() -> Result<PathBuf, Error> {
    let built = toolchain::build_silently(Chip::Esp32c6, &options())?;
    let kept = built.with_file_name("flix-robot-other");
    run::write(&kept, run::read(&built)?)?;
    Ok(kept)
}
