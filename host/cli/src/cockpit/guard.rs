//! Who may ask: the token, the host and the origin of a request.
//!
//! The token keeps out whoever was not given the address of the page. `Host` and `Origin` keep out pages of others in
//! the operator's own browser: a foreign page that opens a WebSocket here states its own origin, and one whose name was
//! made to point here (DNS rebinding) states that name as host.

use std::net::{IpAddr, SocketAddr};

use subtle::ConstantTimeEq as _;

/// The port that a browser takes where an address names none, and then does not state.
const HTTP: u16 = 80;

/// What keeps strangers out.
#[derive(Debug, Clone)]
pub struct Guard {
    token: String,
    bound: SocketAddr,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The host is not the one that is served.
    #[error("wrong host: open the address that `flix cockpit` has printed")]
    Host,
    /// The request comes from the page of another.
    #[error("wrong origin: open the address that `flix cockpit` has printed")]
    Origin,
    /// The token is not that of this run.
    #[error("wrong or old token: open the address that `flix cockpit` has printed last")]
    Token,
}

/// Writes bytes as text.
#[must_use]
pub fn hexadecimal(bytes: [u8; 16]) -> String {
    format!("{:032x}", u128::from_be_bytes(bytes))
}

impl Guard {
    /// Guards what is served at this address. `entropy` comes from the operating system, fresh for every run.
    #[must_use]
    pub fn new(bound: SocketAddr, entropy: [u8; 16]) -> Self {
        Self { token: hexadecimal(entropy), bound }
    }

    /// Returns the token.
    #[must_use]
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Checks a request. `needs_origin`: as browsers state it when a page opens a WebSocket.
    ///
    /// # Errors
    /// When it is not from a page that was opened with the address of this run.
    pub fn check(
        &self,
        token: &str,
        host: Option<&str>,
        origin: Option<&str>,
        needs_origin: bool,
    ) -> Result<(), Refusal> {
        let host = host.filter(|host| self.serves(host)).ok_or(Refusal::Host)?;
        let is_same = |origin: &str| origin.strip_prefix("http://") == Some(host);
        if !origin.map_or(!needs_origin, is_same) {
            return Err(Refusal::Origin);
        }
        match bool::from(token.as_bytes().ct_eq(self.token.as_bytes())) {
            true => Ok(()),
            false => Err(Refusal::Token),
        }
    }

    /// Returns whether this is a host of what is bound: its address with its port, which browsers leave out where it is
    /// [`HTTP`]; `localhost` for this computer; any
    /// address, but no name, where all addresses are bound.
    fn serves(&self, host: &str) -> bool {
        let (own, port) = (self.bound.ip().to_canonical(), self.bound.port());
        let name = host.strip_suffix(&format!(":{port}"));
        if let Some(name) = name.or((port == HTTP).then_some(host)) {
            if name.eq_ignore_ascii_case("localhost") {
                return own.is_loopback() || own.is_unspecified();
            }
            let address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
            return address.is_ok_and(|it| own.is_unspecified() || it.to_canonical() == own);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "07070707070707070707070707070707";

    fn check(bound: &str, host: &str, origin: Option<&str>) -> Result<(), Refusal> {
        Guard::new(bound.parse().unwrap(), [7; 16]).check(TOKEN, Some(host), origin, true)
    }

    #[test]
    fn a_page_of_this_run_is_served() {
        for (bound, host) in [
            ("127.0.0.1:13550", "127.0.0.1:13550"),
            ("127.0.0.1:13550", "localhost:13550"),
            ("[::1]:13550", "[::1]:13550"),
            ("0.0.0.0:13550", "192.168.1.7:13550"),
            ("192.168.1.7:80", "192.168.1.7:80"),
            ("127.0.0.1:80", "127.0.0.1"),
            ("127.0.0.1:80", "localhost"),
            ("[::1]:80", "[::1]"),
            ("[::]:13550", "[fd00::2]:13550"),
            ("[::]:13550", "192.168.1.7:13550"),
            ("[::ffff:127.0.0.1]:13550", "127.0.0.1:13550"),
            ("[::ffff:192.168.1.7]:13550", "[::ffff:192.168.1.7]:13550"),
        ] {
            assert_eq!(check(bound, host, Some(&format!("http://{host}"))), Ok(()), "{host}");
        }
    }

    #[test]
    fn names_that_were_made_to_point_here_are_refused() {
        for (bound, host) in [
            ("127.0.0.1:13550", "evil.example:13550"),
            ("127.0.0.1:13550", "127.0.0.1.evil.example:13550"),
            ("127.0.0.1:13550", "127.0.0.1:80"),
            ("127.0.0.1:13550", "127.0.0.1"),
            ("127.0.0.1:80", "127.0.0.1:13550"),
            ("127.0.0.1:80", "evil.example"),
            ("0.0.0.0:80", "evil.example"),
            ("127.0.0.1:13550", "192.168.1.7:13550"),
            ("0.0.0.0:13550", "evil.example:13550"),
            ("192.168.1.7:13550", "localhost:13550"),
        ] {
            let origin = format!("http://{host}");
            assert_eq!(check(bound, host, Some(&origin)), Err(Refusal::Host), "{host}");
        }
    }

    #[test]
    fn pages_of_others_are_refused() {
        let host = "127.0.0.1:13550";
        for origin in [
            None,
            Some("null"),
            Some("http://evil.example"),
            Some("http://localhost:13550"),
            Some("https://127.0.0.1:13550"),
            Some("http://127.0.0.1:13550.evil.example"),
        ] {
            assert_eq!(check(host, host, origin), Err(Refusal::Origin), "{origin:?}");
        }
    }

    #[test]
    fn a_wrong_token_is_refused() {
        let guard = Guard::new("127.0.0.1:1".parse().unwrap(), [7; 16]);
        for token in
            ["", "0", &TOKEN[1..], &format!("{TOKEN}0"), "08070707070707070707070707070707"]
        {
            let checked = guard.check(token, Some("127.0.0.1:1"), None, false);
            assert_eq!(checked, Err(Refusal::Token), "{token}");
        }
    }
}
