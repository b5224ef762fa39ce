//! Access points that the radio hears, for the serial cable.
//!
//! A scan takes the radio 1.6 s, and longer where a try to connect is under way. [`Scans`] keeps the number of the scan that the
//! computer asked for last, and its result, without radio and without clock.

use core::cmp::Reverse;

use flix_protocol::provision::{
    Answer, HEARD_AT_ONCE, HeardNetwork, HeardNetworks, ProvisionRefusal,
};
use heapless::Vec;

/// Access points that are kept of a scan: the strongest.
pub const MOST_HEARD: usize = 24;

/// The scan that was asked for last.
#[derive(Debug, Default)]
pub struct Scans {
    number: Option<u8>,
    /// Result of that scan, the strongest first; `Some(None)` where the radio could not listen.
    result: Option<Option<Vec<HeardNetwork, MOST_HEARD>>>,
}

impl Scans {
    /// Creates the state before anything was asked.
    #[must_use]
    pub const fn new() -> Self {
        Self { number: None, result: None }
    }

    /// Answers with what scan `number` heard, from place `from` on. Another number than before is another scan, which becomes due.
    pub fn ask(&mut self, number: u8, from: u8) -> Answer {
        if self.number != Some(number) {
            *self = Self { number: Some(number), result: None };
        }
        match &self.result {
            None => Answer::Networks(None),
            Some(None) => Answer::Refused(ProvisionRefusal::Radio),
            Some(Some(heard)) => {
                let some = heard.iter().skip(from.into()).take(HEARD_AT_ONCE).cloned();
                let total = u8::try_from(heard.len()).unwrap_or(u8::MAX);
                Answer::Networks(Some(HeardNetworks { total, from, networks: some.collect() }))
            }
        }
    }

    /// Returns whether the radio has to listen.
    #[must_use]
    pub const fn is_due(&self) -> bool {
        self.number.is_some() && self.result.is_none()
    }

    /// Takes the access points of a scan; `None` where the radio could not scan.
    pub fn end(&mut self, heard: Option<impl IntoIterator<Item = HeardNetwork>>) {
        self.result = Some(heard.map(|heard| {
            let mut strongest = Vec::<HeardNetwork, MOST_HEARD>::new();
            for network in heard {
                if strongest.is_full() && strongest.last().is_some_and(|it| it.dbm < network.dbm) {
                    strongest.pop();
                }
                if strongest.push(network).is_ok() {
                    strongest.sort_unstable_by_key(|it| Reverse(it.dbm));
                }
            }
            strongest
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_protocol::network_name::NetworkName;
    use flix_protocol::provision::HeardSecurity;

    fn heard(dbm: i8) -> HeardNetwork {
        let name = NetworkName::new(&[b'n', dbm.unsigned_abs()]).unwrap();
        HeardNetwork { name, channel: 6, dbm, security: HeardSecurity::Wpa2 }
    }

    /// Reads the whole list, page by page, as the computer does.
    fn list(scans: &mut Scans, number: u8) -> std::vec::Vec<i8> {
        let mut found = std::vec::Vec::new();
        loop {
            let from = u8::try_from(found.len()).unwrap();
            let Answer::Networks(Some(page)) = scans.ask(number, from) else { panic!() };
            found.extend(page.networks.iter().map(|it| it.dbm));
            if found.len() >= page.total.into() || page.networks.is_empty() {
                return found;
            }
        }
    }

    #[test]
    fn a_scan_is_due_until_it_ends_and_its_list_is_the_strongest_first() {
        let mut scans = Scans::new();
        assert!(!scans.is_due());
        assert_eq!(scans.ask(7, 0), Answer::Networks(None));
        assert!(scans.is_due());
        scans.end(Some([heard(-80), heard(-42), heard(-60)]));
        assert!(!scans.is_due());
        assert_eq!(list(&mut scans, 7), [-42, -60, -80]);
        // Asked again by the same number, nothing is done anew; by another, it is.
        assert!(!scans.is_due());
        assert_eq!(scans.ask(8, 0), Answer::Networks(None));
        assert!(scans.is_due());
    }

    #[test]
    fn of_many_access_points_the_strongest_are_listed() {
        let mut scans = Scans::new();
        scans.ask(1, 0);
        scans.end(Some((0..100_i32).map(|n| heard(-(n * 37 % 100) as i8))));
        let strongest: std::vec::Vec<i8> = (0..24).map(|n| -n).collect();
        assert_eq!(list(&mut scans, 1), strongest);
    }

    #[test]
    fn a_radio_that_cannot_listen_is_said_and_asked_again() {
        let mut scans = Scans::new();
        scans.ask(1, 0);
        scans.end(None::<[HeardNetwork; 0]>);
        assert_eq!(scans.ask(1, 0), Answer::Refused(ProvisionRefusal::Radio));
        assert_eq!(scans.ask(2, 0), Answer::Networks(None));
        assert!(scans.is_due());
    }
}
