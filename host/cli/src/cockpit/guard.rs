//! Who may ask: the token, the host and the origin of a request.
//!
//! The token keeps out whoever was not given the address of the page. `Host` and `Origin` keep out pages of others in
//! the operator's own browser: a foreign page that opens a WebSocket here states its own origin, and one whose name was
//! made to point here (DNS rebinding) states that name as host. Every port is accepted, because `ssh -L`, editors and containers
//! forward another one.

use std::net::{IpAddr, SocketAddr};

use subtle::ConstantTimeEq as _;

/// What keeps strangers out.
#[derive(Debug, Clone)]
pub struct Guard {
    token: String,
    bound: IpAddr,
    /// Names by which proxies and forwarded ports reach the page.
    names: Vec<String>,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The host is not the one that is served.
    #[error(
        "wrong host: open the address that `flix cockpit` has printed, or start it with `--host NAME` where the page is reached by another name"
    )]
    Host,
    /// The request states more than one host.
    #[error("a request has one host")]
    Hosts,
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
        Self { token: hexadecimal(entropy), bound: bound.ip().to_canonical(), names: Vec::new() }
    }

    /// Serves these names, too.
    #[must_use]
    pub fn with_names(self, names: &[String]) -> Self {
        Self { names: names.to_vec(), ..self }
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
        // A proxy with a name may serve the page by https.
        let is_named = name_of(host).is_some_and(|name| self.is_named(name));
        let is_same = |origin: &str| match origin.split_once("://") {
            Some(("http", of)) => of == host,
            Some(("https", of)) => of == host && is_named,
            _ => false,
        };
        if !origin.map_or(!needs_origin, is_same) {
            return Err(Refusal::Origin);
        }
        match bool::from(token.as_bytes().ct_eq(self.token.as_bytes())) {
            true => Ok(()),
            false => Err(Refusal::Token),
        }
    }

    /// Returns whether the page is served for this host, by any port: the bound address, a name that was given, and `localhost` on this
    /// computer. Where all addresses are bound, each address is served, and no further name.
    fn serves(&self, host: &str) -> bool {
        let Some(name) = name_of(host) else { return false };
        if name.eq_ignore_ascii_case("localhost") {
            return self.bound.is_loopback() || self.bound.is_unspecified() || self.is_named(name);
        }
        match name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>() {
            Ok(address) => self.bound.is_unspecified() || address.to_canonical() == self.bound,
            Err(_) => self.is_named(name),
        }
    }

    fn is_named(&self, name: &str) -> bool {
        self.names.iter().any(|known| known.eq_ignore_ascii_case(name))
    }
}

/// Returns a host without its port.
fn name_of(host: &str) -> Option<&str> {
    let end = host.rfind(']').map_or(0, |end| end + 1);
    match host[end..].split_once(':') {
        None => Some(host),
        Some((name, port)) => port.parse::<u16>().is_ok().then(|| &host[..end + name.len()]),
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
            ("127.0.0.1:13550", "127.0.0.1:8080"),
            ("127.0.0.1:13550", "localhost:8080"),
            ("127.0.0.1:13550", "127.0.0.1"),
            ("127.0.0.1:80", "127.0.0.1:13550"),
            ("0.0.0.0:13550", "localhost:49153"),
            ("[::1]:13550", "[::1]:8080"),
        ] {
            assert_eq!(check(bound, host, Some(&format!("http://{host}"))), Ok(()), "{host}");
        }
    }

    #[test]
    fn names_that_were_made_to_point_here_are_refused() {
        for (bound, host) in [
            ("127.0.0.1:13550", "evil.example:13550"),
            ("127.0.0.1:13550", "127.0.0.1.evil.example:13550"),
            ("127.0.0.1:13550", "localhost.evil.example:13550"),
            ("127.0.0.1:13550", "127.0.0.1:80:80"),
            ("127.0.0.1:13550", "127.0.0.1:evil"),
            ("127.0.0.1:13550", "127.0.0.1:"),
            ("127.0.0.1:13550", ""),
            ("[::1]:13550", "[::1]evil:80"),
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
    fn a_name_is_served_where_it_was_given_encrypted_too() {
        let guard = Guard::new("127.0.0.1:1".parse().unwrap(), [7; 16]);
        let guard = guard.with_names(&["Robot.Lab".to_owned()]);
        let check = |host: &str, origin: &str| guard.check(TOKEN, Some(host), Some(origin), true);
        for (host, origin) in [
            ("robot.lab", "https://robot.lab"),
            ("robot.lab:8443", "https://robot.lab:8443"),
            ("robot.lab:8080", "http://robot.lab:8080"),
            ("localhost:8080", "http://localhost:8080"),
        ] {
            assert_eq!(check(host, origin), Ok(()), "{host}");
        }
        assert_eq!(check("evil.lab", "https://evil.lab"), Err(Refusal::Host));
        assert_eq!(check("robot.lab", "https://evil.lab"), Err(Refusal::Origin));
        assert_eq!(check("localhost", "https://localhost"), Err(Refusal::Origin));
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
