//! How the robot joins its network: when it tries, what it hands to the radio, and what it does when nothing comes of it.
//!
//! The radio's library works above all tasks: it derives keys, calibrates and authenticates for a second and more while no
//! task runs. So the robot tries only while its motors are not driven, and within [`WINDOW`], in which the watchdog of the
//! tasks is patient. A try fails for a reason that the radio states, or nothing comes of it at all; then the driver is to blame.
//!
//! ```text
//! try ---> connected ---> lost ---> wait ---> try
//!  |---> failed: no such network, wrong password ---> wait, twice as long each time ---> try
//!  |---> nothing within ATTEMPT ---> wait ---> try; after SILENT_TRIES the driver is made anew, after as many more
//!        the chip is restarted, unless the motors are driven or the serial cable is in use
//! connected ---> no address within REASSOCIATION, or no frame for SILENCE ---> lost
//! ```
//!
//! [`Joining`] and [`Connection`] state how far the robot is ([`NetworkState`]), which the serial cable reports.

use core::time::Duration;

use flix_protocol::message::State;
use flix_protocol::network_key::is_key;
use flix_protocol::provision::{JoinFailure, NetworkAddress, NetworkState};

/// Wait after the first failed try; doubled after each further one.
pub const SHORTEST_WAIT: Duration = Duration::from_millis(500);
/// Never longer than this: a robot that comes back into range connects soon.
pub const LONGEST_WAIT: Duration = Duration::from_secs(8);
/// A connection that held so long was a good one: start again with the shortest wait.
pub const GOOD_CONNECTION: Duration = Duration::from_secs(30);
/// A try that has come to nothing by then is given up. A scan of all channels takes 1.6 s, a handshake that the access point
/// does not answer 3 s (ESP-IDF), a derivation 2 s; with the longest wait the next try is within 30 s.
pub const ATTEMPT: Duration = Duration::from_secs(15);
/// The watchdog of the tasks is patient for so long at most from the beginning of a try on.
pub const WINDOW: Duration = Duration::from_secs(18);
/// Tries in a row of which nothing came before the driver is made anew, or the chip is restarted.
pub const SILENT_TRIES: u8 = 3;
/// The serial cable is in use for so long after the last byte that came in.
pub const CABLE_IN_USE: Duration = Duration::from_secs(60);

/// A connected robot reports that it has no address after this time. DHCP has sent its first message four times by then.
pub const ADDRESS_PATIENCE: Duration = Duration::from_secs(20);
/// It ends a connection without an address after this time, and connects anew.
pub const REASSOCIATION: Duration = Duration::from_secs(60);
/// It ends a connection over which no frame has come for this time, though the gateway was asked for one every minute.
pub const SILENCE: Duration = Duration::from_secs(120);

/// What to hand to the radio as the network's password.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Credential {
    /// The key, derived by the robot: the radio's library derives nothing.
    Key,
    /// The password as it was provisioned: a key already, none at all, or a pass phrase for an access point that takes it
    /// by WPA3's handshake (SAE) alone.
    Password,
}

/// What to do after a try.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// Wait so long, and try again.
    Retry(Duration),
    /// Make the driver anew, wait so long, and try again.
    Renew(Duration),
    /// Restart the chip if that is allowed ([`may_restart`]); else wait so long, and try again.
    Restart(Duration),
}

/// The robot's tries.
#[derive(Debug, Clone)]
pub struct Joining {
    wait: Duration,
    /// Tries in a row of which nothing came.
    silent: u8,
    credential: Credential,
    /// Whether there is a pass phrase to derive a key from.
    has_passphrase: bool,
    state: NetworkState,
}

impl Joining {
    /// Returns the state before the first try, with the password of provisioning.
    #[must_use]
    pub fn new(password: &str) -> Self {
        let has_passphrase = !password.is_empty() && !is_key(password);
        let credential = if has_passphrase { Credential::Key } else { Credential::Password };
        let state = NetworkState::Joining;
        Self { wait: SHORTEST_WAIT, silent: 0, credential, has_passphrase, state }
    }

    /// Returns how far the robot is while it is not connected.
    #[must_use]
    pub const fn state(&self) -> NetworkState {
        self.state
    }

    /// Returns what the next try hands to the radio.
    #[must_use]
    pub const fn credential(&self) -> Credential {
        self.credential
    }

    /// Notes that the radio connected.
    pub const fn connected(&mut self) {
        self.silent = 0;
        self.state = NetworkState::Joining;
    }

    /// Notes that a connection that held for so long was lost.
    pub fn lost(&mut self, held: Duration) -> Next {
        if held > GOOD_CONNECTION {
            self.wait = SHORTEST_WAIT;
        }
        Next::Retry(self.next_wait())
    }

    /// Notes that a try failed, and the radio stated why. The other credential is tried next, unless there was no access point
    /// that could have refused this one.
    pub fn failed(&mut self, reason: JoinFailure) -> Next {
        self.silent = 0;
        self.note(reason);
        if reason != JoinFailure::Absent && self.has_passphrase {
            self.credential = match self.credential {
                Credential::Key => Credential::Password,
                Credential::Password => Credential::Key,
            };
        }
        Next::Retry(self.next_wait())
    }

    /// Notes that a try had no result, or the driver refused it.
    pub fn silent(&mut self) -> Next {
        self.silent += 1;
        self.note(JoinFailure::Radio);
        let wait = self.next_wait();
        match self.silent {
            SILENT_TRIES => Next::Renew(wait),
            count if count >= 2 * SILENT_TRIES => {
                self.silent = 0;
                Next::Restart(wait)
            }
            _ => Next::Retry(wait),
        }
    }

    const fn note(&mut self, reason: JoinFailure) {
        let before = match self.state {
            NetworkState::Failed { tries, .. } => tries,
            _ => 0,
        };
        self.state = NetworkState::Failed { reason, tries: before.saturating_add(1) };
    }

    fn next_wait(&mut self) -> Duration {
        let wait = self.wait;
        self.wait = (wait * 2).min(LONGEST_WAIT);
        wait
    }
}

/// A change of the address of a connected robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// It has this address from now on.
    Address(NetworkAddress),
    /// It has had none for [`ADDRESS_PATIENCE`].
    NoAddress,
    /// It has had none for [`REASSOCIATION`]: end the connection.
    Leave,
    /// No frame has come for [`SILENCE`]: end the connection.
    Silent,
}

/// A connection to the network, and its address.
#[derive(Debug, Clone, Default)]
pub struct Connection {
    address: Option<NetworkAddress>,
    /// Time from the connection to the last moment with an address, and to the last one looked at.
    without_since: Duration,
    held: Duration,
    /// Whether the missing address was reported.
    is_reported: bool,
    /// The last moment in which silence was reported.
    silent_at: Duration,
}

impl Connection {
    /// Takes the present address, `held` after the robot has connected, and `silence`, the time since the newest frame, where the
    /// gateway is asked for replies. Returns the change, if there is one.
    pub fn look(
        &mut self,
        held: Duration,
        address: Option<NetworkAddress>,
        silence: Option<Duration>,
    ) -> Option<News> {
        let is_new = address != self.address;
        (self.address, self.held) = (address, held);
        if silence.is_some_and(|it| it.min(held.saturating_sub(self.silent_at)) >= SILENCE) {
            self.silent_at = held;
            return Some(News::Silent);
        }
        if let Some(address) = address {
            (self.without_since, self.is_reported) = (held, false);
            return is_new.then_some(News::Address(address));
        }
        let without = held.saturating_sub(self.without_since);
        if without >= REASSOCIATION {
            (self.without_since, self.is_reported) = (held, false);
            return Some(News::Leave);
        }
        let is_due = without >= ADDRESS_PATIENCE && !self.is_reported;
        self.is_reported |= is_due;
        is_due.then_some(News::NoAddress)
    }

    /// Returns how far the robot is.
    #[must_use]
    pub fn state(&self) -> NetworkState {
        let seconds = self.held.saturating_sub(self.without_since).as_secs();
        let seconds = u32::try_from(seconds).unwrap_or(u32::MAX);
        self.address.map_or(NetworkState::NoAddress { seconds }, NetworkState::Joined)
    }
}

/// Returns whether the robot may try to connect: while it does, no task may run for a while.
#[must_use]
pub const fn may_try(state: State) -> bool {
    state.is_idle()
}

/// Returns whether the chip may restart, which lets the motors coast for a moment. `cable_silent` is the time since the last
/// byte came in over the serial cable, if one did.
#[must_use]
pub fn may_restart(state: State, cable_silent: Option<Duration>) -> bool {
    state.is_idle() && cable_silent.is_none_or(|silent| silent >= CABLE_IN_USE)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PASSPHRASE: &str = "a pass phrase";

    #[test]
    fn a_try_that_comes_to_nothing_is_repeated_within_30_s() {
        let mut joining = Joining::new(PASSPHRASE);
        for _ in 0..20 {
            let (Next::Retry(wait) | Next::Renew(wait) | Next::Restart(wait)) = joining.silent();
            assert!(ATTEMPT + wait < Duration::from_secs(30), "{wait:?}");
        }
    }

    #[test]
    fn the_driver_is_made_anew_before_the_chip_is_restarted() {
        let mut joining = Joining::new(PASSPHRASE);
        let next: std::vec::Vec<Next> = (0..12).map(|_| joining.silent()).collect();
        let place = |of: fn(&Next) -> bool| -> std::vec::Vec<usize> {
            (0..12).filter(|index| of(&next[*index])).collect()
        };
        assert_eq!(place(|next| matches!(next, Next::Renew(_))), [2, 8]);
        assert_eq!(place(|next| matches!(next, Next::Restart(_))), [5, 11]);
    }

    #[test]
    fn a_network_that_is_not_there_restarts_nothing() {
        let mut joining = Joining::new(PASSPHRASE);
        for _ in 0..1_000 {
            assert!(
                matches!(joining.failed(JoinFailure::Absent), Next::Retry(wait) if wait <= LONGEST_WAIT)
            );
        }
        assert_eq!(joining.credential(), Credential::Key);
    }

    #[test]
    fn a_refused_key_is_followed_by_the_pass_phrase_and_the_key_again() {
        let mut joining = Joining::new(PASSPHRASE);
        let tried: std::vec::Vec<Credential> = (0..3)
            .map(|_| {
                let credential = joining.credential();
                let _ = joining.failed(JoinFailure::Password);
                credential
            })
            .collect();
        assert_eq!(tried, [Credential::Key, Credential::Password, Credential::Key]);
    }

    #[test]
    fn a_key_and_an_open_network_are_handed_down_as_they_are() {
        for password in ["", "0123456789abcdef0123456789ABCDEF0123456789abcdef0123456789abcdef"] {
            let mut joining = Joining::new(password);
            for _ in 0..3 {
                assert_eq!(joining.credential(), Credential::Password);
                let _ = joining.failed(JoinFailure::Password);
            }
        }
    }

    #[test]
    fn a_good_connection_shortens_the_wait_again() {
        let mut joining = Joining::new("");
        while joining.failed(JoinFailure::Absent) != Next::Retry(LONGEST_WAIT) {}
        joining.connected();
        assert_eq!(joining.lost(Duration::from_secs(1)), Next::Retry(LONGEST_WAIT));
        let held = GOOD_CONNECTION + Duration::from_secs(1);
        assert_eq!(joining.lost(held), Next::Retry(SHORTEST_WAIT));
    }

    #[test]
    fn failed_tries_are_counted_until_the_robot_connects() {
        let mut joining = Joining::new(PASSPHRASE);
        assert_eq!(joining.state(), NetworkState::Joining);
        for tries in 1..4 {
            let _ = joining.failed(JoinFailure::Absent);
            let reason = JoinFailure::Absent;
            assert_eq!(joining.state(), NetworkState::Failed { reason, tries });
        }
        let _ = joining.silent();
        let reason = JoinFailure::Radio;
        assert_eq!(joining.state(), NetworkState::Failed { reason, tries: 4 });
        joining.connected();
        assert_eq!(joining.state(), NetworkState::Joining);
    }

    const ADDRESS: NetworkAddress =
        NetworkAddress { address: [192, 168, 1, 7], prefix_length: 24, is_fixed: false };

    /// Looks every second from `from` to `until` after the connection; returns the seconds of all news.
    fn news(
        connection: &mut Connection,
        [from, until]: [u64; 2],
        address: Option<NetworkAddress>,
    ) -> std::vec::Vec<(u64, News)> {
        let look = |s| connection.look(Duration::from_secs(s), address, None).map(|news| (s, news));
        (from..until).filter_map(look).collect()
    }

    #[test]
    fn a_connection_without_an_address_is_reported_after_20_s_and_ended_after_60_s() {
        let mut connection = Connection::default();
        let found = news(&mut connection, [0, 100], None);
        assert_eq!(found, [(20, News::NoAddress), (60, News::Leave), (80, News::NoAddress)]);
        assert_eq!(connection.state(), NetworkState::NoAddress { seconds: 39 });
    }

    #[test]
    fn an_address_is_reported_once_and_missed_from_its_loss_on() {
        let mut connection = Connection::default();
        assert_eq!(news(&mut connection, [0, 19], None), []);
        let found = news(&mut connection, [19, 500], Some(ADDRESS));
        assert_eq!(found, [(19, News::Address(ADDRESS))]);
        assert_eq!(connection.state(), NetworkState::Joined(ADDRESS));
        let other = NetworkAddress { address: [192, 168, 1, 8], ..ADDRESS };
        let found = news(&mut connection, [500, 1_000], Some(other));
        assert_eq!(found, [(500, News::Address(other))]);
        assert_eq!(news(&mut connection, [1_000, 1_019], None), []);
        assert_eq!(news(&mut connection, [1_019, 1_030], None), [(1_019, News::NoAddress)]);
        let found = news(&mut connection, [1_030, 1_040], Some(other));
        assert_eq!(found, [(1_030, News::Address(other))]);
    }

    #[test]
    fn a_connection_that_is_silent_for_120_s_is_ended_and_120_s_later_once_more() {
        let mut connection = Connection::default();
        let mut look = |s: u64, silence: Option<u64>| {
            connection.look(Duration::from_secs(s), Some(ADDRESS), silence.map(Duration::from_secs))
        };
        assert_eq!(look(0, None), Some(News::Address(ADDRESS)));
        for s in 1..600 {
            assert_eq!(look(s, None), None);
            assert_eq!(look(s, Some(119)), None);
        }
        let ended = (600..900).filter(|s| look(*s, Some(s - 500)) == Some(News::Silent));
        assert_eq!(ended.collect::<std::vec::Vec<_>>(), [620, 740, 860]);
    }

    #[test]
    fn nothing_is_tried_and_nothing_restarts_while_the_motors_are_driven() {
        for state in [State::Aligning, State::Armed, State::Running, State::Stopping] {
            assert!(!may_try(state) && !may_restart(state, None), "{state:?}");
        }
        for state in [State::Disarmed, State::Faulted] {
            assert!(may_try(state) && may_restart(state, None), "{state:?}");
        }
    }

    #[test]
    fn nothing_restarts_while_the_cable_is_in_use() {
        assert!(!may_restart(State::Disarmed, Some(Duration::from_secs(59))));
        assert!(may_restart(State::Disarmed, Some(Duration::from_secs(60))));
    }
}
