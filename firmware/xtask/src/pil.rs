//! Processor in the loop.
use crate::run::Error;
pub(crate) fn run() -> Result<(), Error> {
    Ok(())
}
