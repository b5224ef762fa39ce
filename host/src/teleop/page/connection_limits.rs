//! Limits of connections to the cockpit's server: number, and time to wait for a page.
//!
//! A stranger is a client that has not shown the token. A page shows it in its first packet, so a stranger gets little time
//! ([`PATIENCE`]), and few may wait at once ([`MOST_STRANGERS`]). One more turns another out, chosen so:
//!
//! 1. of those in the network in which most wait (256 addresses of IPv4, /24; one link of IPv6, /64): a client with many addresses
//!    has them in few networks;
//! 2. of these, those behind the address behind which most wait;
//! 3. of these, the one that has waited longest.
//!
//! So a page is served while others open sockets without end, behind its own address, too, and the program keeps its
//! descriptors for the robot. Strangers of other networks turn a page out only where no network holds more than its own.

use std::cmp::Reverse;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::time::Duration;

/// Strangers that wait at once: a browser opens six sockets to a server, and ten may come together.
pub const MOST_STRANGERS: usize = 64;
/// Sockets at once that have shown the token and take the page.
pub const MOST_GUESTS: usize = 32;
/// Time in which a stranger shows the token: a first packet that is lost is sent again after 1 s, and again after 3 s.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Time in which a client that has shown the token takes the page: some 100 kB over a slow radio.
pub const DELIVERY: Duration = Duration::from_secs(10);

/// Number of a socket, never used again.
pub type Number = u64;

/// All admitted clients, in the order of their arrival.
#[derive(Debug, Clone, Default)]
pub struct Visitors {
    came: Number,
    strangers: Vec<(Number, IpAddr)>,
    guests: Vec<Number>,
}

impl Visitors {
    /// Admits a stranger behind this address. Returns his number, and that of the stranger who is turned out for him; `None` where
    /// clients that have shown the token take all places.
    pub fn admit(&mut self, address: IpAddr) -> Option<(Number, Option<Number>)> {
        if self.guests.len() >= MOST_GUESTS {
            return None;
        }
        let is_full = self.strangers.len() >= MOST_STRANGERS;
        let turned_out = if is_full { self.turn_out() } else { None };
        self.came += 1;
        self.strangers.push((self.came, address));
        Some((self.came, turned_out))
    }

    /// Turns out the stranger that has waited longest in the [most crowded](most_crowded) place.
    pub fn turn_out(&mut self) -> Option<Number> {
        let addresses: Vec<_> = self.strangers.iter().map(|it| it.1).collect();
        Some(self.strangers.remove(most_crowded(&addresses)?).0)
    }

    /// Notes that a stranger has shown the token, and is turned out no more.
    pub fn welcome(&mut self, number: Number) {
        let strangers = self.strangers.len();
        self.strangers.retain(|stranger| stranger.0 != number);
        if self.strangers.len() < strangers {
            self.guests.push(number);
        }
    }

    /// Takes that a socket is closed, or has become a page's.
    pub fn leave(&mut self, number: Number) {
        self.strangers.retain(|stranger| stranger.0 != number);
        self.guests.retain(|guest| *guest != number);
    }

    /// Returns whether this socket has shown the token, and is here.
    #[must_use]
    pub fn is_guest(&self, number: Number) -> bool {
        self.guests.contains(&number)
    }

    /// Returns how many are here: strangers and guests.
    #[must_use]
    pub fn count(&self) -> [usize; 2] {
        [self.strangers.len(), self.guests.len()]
    }
}

/// Returns the first place in the list of those behind the address that most are behind, in the network that most are in.
#[must_use]
pub fn most_crowded(addresses: &[IpAddr]) -> Option<usize> {
    let places = addresses.iter().enumerate().map(|(place, it)| (network(*it), *it, place));
    let mut places: Vec<_> = places.collect();
    places.sort_unstable();
    let networks = places.chunk_by(|one, next| one.0 == next.0);
    let crowds = networks.flat_map(|within| {
        let crowds = within.chunk_by(|one, next| one.1 == next.1);
        crowds.map(|behind| (within.len(), behind.len(), Reverse(behind[0].2)))
    });
    crowds.max().map(|(_, _, Reverse(place))| place)
}

/// Returns the first address of the network that an address belongs to: /24 of IPv4, also where IPv6 writes it, /64 of IPv6.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => Ipv4Addr::from_bits(address.to_bits() >> 8 << 8).into(),
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    const FAR: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 168, 1, 7));

    #[test]
    fn one_stranger_more_turns_out_who_has_waited_longest_behind_the_most_crowded_address() {
        let mut visitors = Visitors::default();
        let (far, _) = visitors.admit(FAR).unwrap();
        let (first, _) = visitors.admit(NEAR).unwrap();
        for _ in 0..MOST_STRANGERS - 2 {
            assert_eq!(visitors.admit(NEAR).unwrap().1, None);
        }
        assert_eq!(visitors.admit(NEAR).unwrap().1, Some(first));
        assert_eq!(visitors.admit(FAR).unwrap().1, Some(first + 1));
        assert_eq!(visitors.count(), [MOST_STRANGERS, 0]);
        visitors.welcome(far);
        assert!(visitors.is_guest(far), "the other address is never turned out");
    }

    #[test]
    fn many_addresses_of_one_network_turn_out_nobody_of_another() {
        for (own, of_network) in [
            ("192.168.1.7", "10.0.0."),
            ("2001:db8:0:1::7", "2001:db8:0:2::"),
            ("::ffff:192.168.1.7", "::ffff:10.0.0."),
        ] {
            let mut visitors = Visitors::default();
            let own: IpAddr = own.parse().unwrap();
            let (page, _) = visitors.admit(own).unwrap();
            // A second connection that a browser opens.
            visitors.admit(own).unwrap();
            for number in 1..=250 {
                let other = format!("{of_network}{number}").parse().unwrap();
                let (_, turned_out) = visitors.admit(other).unwrap();
                assert!(turned_out != Some(page) && turned_out != Some(page + 1), "{own}");
            }
        }
    }

    #[test]
    fn one_address_turns_out_nobody_else_of_its_network() {
        let mut visitors = Visitors::default();
        let (page, _) = visitors.admit(FAR).unwrap();
        for _ in 0..3 * MOST_STRANGERS {
            let (_, turned_out) = visitors.admit(Ipv4Addr::new(192, 168, 1, 8).into()).unwrap();
            assert_ne!(turned_out, Some(page));
        }
    }

    #[test]
    fn in_every_crowd_the_first_of_the_densest_place_is_turned_out() {
        // Three networks; the third address is of the first one, as IPv6 writes it.
        let addresses =
            ["10.0.0.1", "10.0.0.2", "::ffff:10.0.0.1", "10.0.1.1", "2001:db8::1", "2001:db8::2"];
        let addresses = addresses.map(|it| it.parse::<IpAddr>().unwrap());
        for (length, number) in
            (1..=5).flat_map(|it| (0..6_usize.pow(it)).map(move |number| (it, number)))
        {
            let crowd: Vec<_> =
                (0..length).map(|it| addresses[number / 6_usize.pow(it) % 6]).collect();
            let density = |it: IpAddr| {
                let within = crowd.iter().filter(|other| network(**other) == network(it));
                (within.count(), crowd.iter().filter(|other| **other == it).count())
            };
            let densest = crowd.iter().map(|it| density(*it)).max();
            let first = crowd.iter().position(|it| Some(density(*it)) == densest);
            assert_eq!(most_crowded(&crowd), first, "{crowd:?}");
        }
        assert_eq!(most_crowded(&[]), None);
    }

    #[test]
    fn whoever_has_shown_the_token_is_not_turned_out() {
        let mut visitors = Visitors::default();
        let (driver, _) = visitors.admit(NEAR).unwrap();
        visitors.welcome(driver);
        visitors.welcome(driver);
        for _ in 0..3 * MOST_STRANGERS {
            let (_, turned_out) = visitors.admit(NEAR).unwrap();
            assert_ne!(turned_out, Some(driver));
        }
        assert_eq!((visitors.count(), visitors.is_guest(driver)), ([MOST_STRANGERS, 1], true));
        visitors.leave(driver);
        assert!(!visitors.is_guest(driver));
    }

    #[test]
    fn those_that_show_the_token_are_counted_too() {
        let mut visitors = Visitors::default();
        for _ in 0..MOST_GUESTS {
            let (number, _) = visitors.admit(NEAR).unwrap();
            visitors.welcome(number);
        }
        assert!(visitors.admit(NEAR).is_none());
        // One that has left does not come back as a guest.
        visitors.leave(1);
        visitors.welcome(1);
        assert_eq!(visitors.count(), [0, MOST_GUESTS - 1]);
        assert!(visitors.admit(NEAR).is_some());
    }
}
