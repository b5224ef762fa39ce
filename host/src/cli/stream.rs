//! `--foxglove`: shows a run as it goes on.

use crate::record::Recorder;

#[cfg(feature = "live")]
pub use live::{StreamArgs, address, introduce};

/// Options of a live stream, which this program was built without.
#[cfg(not(feature = "live"))]
#[derive(Debug, Clone, clap::Args)]
pub struct StreamArgs {}

#[cfg(not(feature = "live"))]
impl StreamArgs {
    /// Streams nothing.
    ///
    /// # Errors
    /// Never.
    pub fn start(&self, _: &mut Recorder) -> Result<(), super::Error> {
        Ok(())
    }

    /// Returns whether a stream is asked for: never.
    #[must_use]
    pub fn is_asked_for(&self) -> bool {
        false
    }
}

#[cfg(feature = "live")]
mod live {
    use std::net::{IpAddr, Ipv4Addr, SocketAddr};

    use super::Recorder;
    use crate::cli::Error;
    use crate::cli::output::say;
    use crate::record::CHANNELS;
    use crate::record::stream::{PORT, Stream};

    /// Options of a live stream.
    #[derive(Debug, Clone, clap::Args)]
    pub struct StreamArgs {
        /// Stream what is recorded, for Foxglove or Lichtblick on this computer; =0.0.0.0 for others in this network,
        /// too, =127.0.0.1:8766 for another port than 8765.
        #[arg(
            long,
            value_name = "ADDRESS[:PORT]",
            num_args = 0..=1,
            require_equals = true,
            default_missing_value = "127.0.0.1",
            value_parser = |text: &str| address(text, PORT),
        )]
        foxglove: Option<SocketAddr>,
    }

    impl StreamArgs {
        /// Streams what this record gets from now on, where that is asked for, and says where.
        ///
        /// # Errors
        /// When the address cannot be had.
        pub fn start(&self, recorder: &mut Recorder) -> Result<(), Error> {
            if let Some(address) = self.foxglove {
                let stream = Stream::open(address, "flix", &CHANNELS).map_err(Error::usage)?;
                introduce("flix", address.ip(), &stream);
                recorder.show(stream);
            }
            Ok(())
        }

        /// Returns whether a stream is asked for.
        #[must_use]
        pub fn is_asked_for(&self) -> bool {
            self.foxglove.is_some()
        }
    }

    /// Says where a program's stream is found.
    pub fn introduce(program: &str, ip: IpAddr, stream: &Stream) {
        let ip = if ip.is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { ip };
        let at = SocketAddr::new(ip, stream.port());
        say(
            program,
            format_args!("streams: open the connection ws://{at} in Foxglove or Lichtblick"),
        );
    }

    /// Parses an address of this computer, which takes this port when it names none.
    ///
    /// # Errors
    /// With a sentence, when it is none.
    pub fn address(text: &str, port: u16) -> Result<SocketAddr, String> {
        let alone = text.parse::<IpAddr>().map(|ip| SocketAddr::new(ip, port));
        alone.or_else(|_| text.parse()).map_err(|_| {
            format!(
                "\"{text}\" is not an address of this computer: write {} or {}:{port}",
                Ipv4Addr::LOCALHOST,
                Ipv4Addr::UNSPECIFIED
            )
        })
    }
}
