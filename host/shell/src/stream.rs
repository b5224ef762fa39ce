//! `--foxglove`: shows a run as it goes on.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use flix_host::record::{CHANNELS, Channel, Recorder};

use crate::Error;
use crate::foxglove::Stream;
use crate::output::say;

/// Port that Foxglove tries first.
const PORT: u16 = 8765;

/// Parses an address of this computer, which takes this port when it names none. An address of IPv6 may stand in brackets.
///
/// # Errors
/// With a sentence, when it is none.
pub fn address(text: &str, port: u16) -> Result<SocketAddr, String> {
    let bare = text.strip_prefix('[').and_then(|it| it.strip_suffix(']')).unwrap_or(text);
    let alone = bare.parse::<IpAddr>().map(|ip| SocketAddr::new(ip, port));
    alone.or_else(|_| text.parse()).map_err(|_| {
        format!(
            "\"{text}\" is not an address of this computer: write {} or {}:{port}",
            Ipv4Addr::LOCALHOST,
            Ipv4Addr::UNSPECIFIED
        )
    })
}

/// Options of a live stream.
#[derive(Debug, Clone, clap::Args)]
pub struct StreamArgs {
    /// Stream live to Foxglove or Lichtblick on this computer; =0.0.0.0 for others in this network, too,
    /// =127.0.0.1:8766 for another port than 8765.
    #[arg(
        long,
        value_name = "ADDRESS[:PORT]",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1",
        value_parser = |text: &str| address(text, PORT),
    )]
    foxglove: Option<SocketAddr>,
    /// Show the stream to pages of this site, too, such as http://192.168.1.5:8080; beside programs and pages of this
    /// computer, Foxglove's and Lichtblick's own. May be given several times.
    #[arg(long, value_name = "ORIGIN", requires = "foxglove", value_parser = origin)]
    foxglove_origin: Vec<String>,
}

/// Parses the origin of pages: scheme, host and, but for the usual one, port.
fn origin(text: &str) -> Result<String, String> {
    let rest = text.strip_prefix("http://").or_else(|| text.strip_prefix("https://"));
    let is_plain = |it: char| it.is_ascii_alphanumeric() || ".-:[]".contains(it);
    match rest {
        Some(rest) if !rest.is_empty() && rest.chars().all(is_plain) => Ok(text.to_owned()),
        _ => Err("write it as a browser does, without a path: http://192.168.1.5:8080".to_owned()),
    }
}

impl StreamArgs {
    /// Streams what this record gets from now on, where that is asked for, and says where.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn start(&self, recorder: &mut Recorder) -> Result<(), Error> {
        if let Some(stream) = self.open("flix", &CHANNELS)? {
            recorder.show(stream);
        }
        Ok(())
    }

    /// Opens a stream of these channels, where one is asked for, and says where.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn open(&self, program: &str, channels: &[Channel]) -> Result<Option<Stream>, Error> {
        let Some(address) = self.foxglove else { return Ok(None) };
        let stream = Stream::open(address, program, channels, &self.foxglove_origin)
            .map_err(Error::usage)?;
        let is_every = address.ip().is_unspecified();
        let ip = if is_every { Ipv4Addr::LOCALHOST.into() } else { address.ip() };
        let at = SocketAddr::new(ip, stream.port());
        say(
            program,
            format_args!("streams: open the connection ws://{at} in Foxglove or Lichtblick"),
        );
        Ok(Some(stream))
    }

    /// Returns whether a stream is asked for.
    #[must_use]
    pub fn is_asked_for(&self) -> bool {
        self.foxglove.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_taken_with_or_without_brackets_and_port() {
        for (text, expected) in [
            ("127.0.0.1", "127.0.0.1:8080"),
            ("127.0.0.1:9000", "127.0.0.1:9000"),
            ("::1", "[::1]:8080"),
            ("[::1]", "[::1]:8080"),
            ("[::]", "[::]:8080"),
            ("[::]:9000", "[::]:9000"),
        ] {
            assert_eq!(address(text, 8080).map(|it| it.to_string()), Ok(expected.to_owned()));
        }
        for text in ["", "[]", "[::1", "::1]", "localhost", "[::1]:", "1.2.3.4:70000"] {
            assert!(address(text, 8080).is_err(), "{text}");
        }
    }
}
