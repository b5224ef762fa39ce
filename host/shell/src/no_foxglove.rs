//! Live streams, which this program was built without.

use std::net::SocketAddr;

use flix_host::record::{Channel, Reader};

/// Why nothing can be streamed.
#[derive(Debug, thiserror::Error)]
#[error(
    "--foxglove: this program was built without live streams; take a release, or build it with `--features foxglove`"
)]
pub struct StreamError;

/// A stream of rows: there is none.
pub enum Stream {}

impl Stream {
    /// Refuses.
    ///
    /// # Errors
    /// Always.
    pub fn open(_: SocketAddr, _: &str, _: &[Channel], _: &[String]) -> Result<Self, StreamError> {
        Err(StreamError)
    }

    /// Returns the port.
    #[must_use]
    pub fn port(&self) -> u16 {
        match *self {}
    }
}

impl Reader for Stream {
    fn row(&mut self, _: usize, _: u64, _: &[u8]) {
        match *self {}
    }
}
