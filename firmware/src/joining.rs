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
//! ```

use core::time::Duration;

use flix_protocol::message::State;
use flix_protocol::network_key::is_key;

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
}

impl Joining {
    /// Returns the state before the first try, with the password of provisioning.
    #[must_use]
    pub fn new(password: &str) -> Self {
        let has_passphrase = !password.is_empty() && !is_key(password);
        let credential = if has_passphrase { Credential::Key } else { Credential::Password };
        Self { wait: SHORTEST_WAIT, silent: 0, credential, has_passphrase }
    }

    /// Returns what the next try hands to the radio.
    #[must_use]
    pub const fn credential(&self) -> Credential {
        self.credential
    }

    /// Notes that the radio connected.
    pub const fn connected(&mut self) {
        self.silent = 0;
    }

    /// Notes that a connection that held for so long was lost.
    pub fn lost(&mut self, held: Duration) -> Next {
        if held > GOOD_CONNECTION {
            self.wait = SHORTEST_WAIT;
        }
        Next::Retry(self.next_wait())
    }

    /// Notes that a try failed, and the radio stated why. Whether there was an access point at all that refused the credential: then the
    /// other is tried next.
    pub fn failed(&mut self, was_refused: bool) -> Next {
        self.silent = 0;
        if was_refused && self.has_passphrase {
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

    fn next_wait(&mut self) -> Duration {
        let wait = self.wait;
        self.wait = (wait * 2).min(LONGEST_WAIT);
        wait
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
            assert!(matches!(joining.failed(false), Next::Retry(wait) if wait <= LONGEST_WAIT));
        }
        assert_eq!(joining.credential(), Credential::Key);
    }

    #[test]
    fn a_refused_key_is_followed_by_the_pass_phrase_and_the_key_again() {
        let mut joining = Joining::new(PASSPHRASE);
        let tried: std::vec::Vec<Credential> = (0..3)
            .map(|_| {
                let credential = joining.credential();
                let _ = joining.failed(true);
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
                let _ = joining.failed(true);
            }
        }
    }

    #[test]
    fn a_good_connection_shortens_the_wait_again() {
        let mut joining = Joining::new("");
        while joining.failed(false) != Next::Retry(LONGEST_WAIT) {}
        joining.connected();
        assert_eq!(joining.lost(Duration::from_secs(1)), Next::Retry(LONGEST_WAIT));
        let held = GOOD_CONNECTION + Duration::from_secs(1);
        assert_eq!(joining.lost(held), Next::Retry(SHORTEST_WAIT));
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
