//! Who may wait at the door of the cockpit's server, and for how long.
//!
//! Whoever has not shown the token is a stranger. A page shows it in its first datagram, so a stranger gets little time
//! ([`PATIENCE`]), and few may wait at once ([`MOST_STRANGERS`]): one more turns out the one who has waited longest, of those
//! behind the address that most wait behind. So a page is served while others open sockets without end, behind its own address
//! too, and the program keeps its descriptors for the robot.

use std::net::IpAddr;
use std::time::Duration;

/// Strangers that wait at once: a browser opens six sockets to a server, and ten may come together.
pub const MOST_STRANGERS: usize = 64;
/// Sockets at once that have shown the token and take the page.
pub const MOST_GUESTS: usize = 32;
/// Time in which a stranger shows the token: a first datagram that is lost is sent again after 1 s, and again after 3 s.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Time in which whoever has shown the token takes the page: some 100 kB over a slow radio.
pub const DELIVERY: Duration = Duration::from_secs(10);

/// Number of a socket, never used again.
pub type Number = u64;

/// All who have come in, in the order in which they came.
#[derive(Debug, Clone, Default)]
pub struct Hall {
    came: Number,
    strangers: Vec<(Number, IpAddr)>,
    guests: Vec<Number>,
}

impl Hall {
    /// Takes in a stranger behind this address: returns his number, and who is turned out for him. `None` where nobody can
    /// be taken in, as those that have shown the token fill the hall.
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

    /// Turns out who has waited longest, of the strangers behind the address that most wait behind.
    pub fn turn_out(&mut self) -> Option<Number> {
        let behind = |address| self.strangers.iter().filter(|it| it.1 == address).count();
        // Of equals the last is the largest; of a reversed list it is the first.
        let (_, crowded) = *self.strangers.iter().rev().max_by_key(|it| behind(it.1))?;
        let place = self.strangers.iter().position(|it| it.1 == crowded)?;
        Some(self.strangers.remove(place).0)
    }

    /// Takes that a stranger has shown the token: nobody turns him out any more.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const NEAR: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    const FAR: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 168, 1, 7));

    #[test]
    fn one_stranger_more_turns_out_who_has_waited_longest_behind_the_most_crowded_address() {
        let mut hall = Hall::default();
        let (far, _) = hall.admit(FAR).unwrap();
        let (first, _) = hall.admit(NEAR).unwrap();
        for _ in 0..MOST_STRANGERS - 2 {
            assert_eq!(hall.admit(NEAR).unwrap().1, None);
        }
        assert_eq!(hall.admit(NEAR).unwrap().1, Some(first));
        assert_eq!(hall.admit(FAR).unwrap().1, Some(first + 1));
        assert_eq!(hall.count(), [MOST_STRANGERS, 0]);
        hall.welcome(far);
        assert!(hall.is_guest(far), "the other address is never turned out");
    }

    #[test]
    fn whoever_has_shown_the_token_is_not_turned_out() {
        let mut hall = Hall::default();
        let (driver, _) = hall.admit(NEAR).unwrap();
        hall.welcome(driver);
        hall.welcome(driver);
        for _ in 0..3 * MOST_STRANGERS {
            let (_, turned_out) = hall.admit(NEAR).unwrap();
            assert_ne!(turned_out, Some(driver));
        }
        assert_eq!((hall.count(), hall.is_guest(driver)), ([MOST_STRANGERS, 1], true));
        hall.leave(driver);
        assert!(!hall.is_guest(driver));
    }

    #[test]
    fn those_that_show_the_token_are_counted_too() {
        let mut hall = Hall::default();
        for _ in 0..MOST_GUESTS {
            let (number, _) = hall.admit(NEAR).unwrap();
            hall.welcome(number);
        }
        assert!(hall.admit(NEAR).is_none());
        // One that has left does not come back as a guest.
        hall.leave(1);
        hall.welcome(1);
        assert_eq!(hall.count(), [0, MOST_GUESTS - 1]);
        assert!(hall.admit(NEAR).is_some());
    }
}
