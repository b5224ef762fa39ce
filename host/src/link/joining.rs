//! The way of a robot onto its network, as its answers over the cable show it.
//!
//! [`Wait`] has no clock and no cable: it takes the time and each [`NetworkState`], and decides when to wait no longer.

use std::time::Duration;

use flix_protocol::provision::{JoinFailure, NetworkAddress, NetworkState};

/// Longest wait for an address. A robot starts within 1 s, derives its key in 2 s, scans in 1.6 s, and DHCP repeats itself
/// every 3 s.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// Failed tries in a row after which the robot will not connect by itself: the first hands the network's key to the radio, the
/// second the pass phrase, and the third follows a passing cause.
const TRIES: u32 = 3;
/// Time without an address after which the network gives none, s.
const WITHOUT_ADDRESS: u32 = 20;

/// Why a robot did not get onto its network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// It cannot connect.
    #[error("{0}")]
    Failed(JoinFailure),
    /// It is connected, and gets no address.
    #[error(
        "connected, but no address for {0} s: does this network have DHCP? Without it, give --address"
    )]
    NoAddress(u32),
    /// No try to connect ended in time.
    #[error("no try to connect has ended within {} s", PATIENCE.as_secs())]
    Late,
}

/// A wait for a robot's address.
#[derive(Debug, Clone, Default)]
pub struct Wait {
    /// Fewest failed tries in a row so far: those before the wait count for nothing.
    fewest: Option<u32>,
}

impl Wait {
    /// Takes the robot's state, `waited` after the wait began. Returns the result, once there is one.
    pub fn hear(
        &mut self,
        state: NetworkState,
        waited: Duration,
    ) -> Option<Result<NetworkAddress, JoinError>> {
        let tries = match state {
            NetworkState::Failed { tries, .. } => tries,
            _ => 0,
        };
        let before = *self.fewest.insert(self.fewest.map_or(tries, |fewest| fewest.min(tries)));
        let is_over = waited >= PATIENCE;
        match state {
            NetworkState::Joined(address) => Some(Ok(address)),
            NetworkState::Failed { reason, tries } if is_over || tries - before >= TRIES => {
                Some(Err(JoinError::Failed(reason)))
            }
            NetworkState::NoAddress { seconds } if is_over || seconds >= WITHOUT_ADDRESS => {
                Some(Err(JoinError::NoAddress(seconds)))
            }
            NetworkState::Joining if is_over => Some(Err(JoinError::Late)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADDRESS: NetworkAddress =
        NetworkAddress { address: [192, 168, 1, 7], prefix_length: 24, is_fixed: false };

    const fn failed(reason: JoinFailure, tries: u32) -> NetworkState {
        NetworkState::Failed { reason, tries }
    }

    /// Lets a robot be in these states, each from its second on; returns when the wait ended, s, and how.
    fn wait(states: &[(u64, NetworkState)]) -> (u64, Result<NetworkAddress, JoinError>) {
        let mut wait = Wait::default();
        for second in 0.. {
            let (_, state) = states.iter().rfind(|(from, _)| *from <= second).unwrap();
            if let Some(result) = wait.hear(*state, Duration::from_secs(second)) {
                return (second, result);
            }
        }
        unreachable!()
    }

    #[test]
    fn an_address_ends_the_wait_whatever_was_before() {
        let states = [
            (0, NetworkState::Joining),
            (3, failed(JoinFailure::Password, 1)),
            (6, failed(JoinFailure::Absent, 2)),
            (9, NetworkState::NoAddress { seconds: 0 }),
            (12, NetworkState::Joined(ADDRESS)),
        ];
        assert_eq!(wait(&states), (12, Ok(ADDRESS)));
    }

    #[test]
    fn the_third_failed_try_ends_the_wait_with_its_reason() {
        use JoinFailure::{Absent, Full, Password, Radio, Refused, Security};
        for reason in [Absent, Full, Password, Radio, Refused, Security] {
            let states = [
                (0, NetworkState::Joining),
                (4, failed(reason, 1)),
                (8, failed(reason, 2)),
                (12, failed(reason, 3)),
            ];
            assert_eq!(wait(&states), (12, Err(JoinError::Failed(reason))));
        }
    }

    #[test]
    fn tries_before_the_wait_count_for_nothing() {
        let absent = |tries| failed(JoinFailure::Absent, tries);
        let states = [(0, absent(70)), (9, absent(71)), (12, NetworkState::Joined(ADDRESS))];
        assert_eq!(wait(&states), (12, Ok(ADDRESS)));
        let states = [(0, absent(70)), (9, absent(71)), (18, absent(72)), (27, absent(73))];
        assert_eq!(wait(&states), (27, Err(JoinError::Failed(JoinFailure::Absent))));
        // The robot starts anew meanwhile.
        let states = [(0, absent(70)), (2, NetworkState::Joining), (5, absent(3))];
        assert_eq!(wait(&states), (5, Err(JoinError::Failed(JoinFailure::Absent))));
    }

    #[test]
    fn every_wait_ends_within_30_s_and_names_what_was_last() {
        let silent = failed(JoinFailure::Radio, 1);
        for (state, error) in [
            (NetworkState::Joining, JoinError::Late),
            (silent, JoinError::Failed(JoinFailure::Radio)),
            (NetworkState::NoAddress { seconds: 6 }, JoinError::NoAddress(6)),
        ] {
            assert_eq!(wait(&[(0, state)]), (30, Err(error)));
        }
        let late = NetworkState::NoAddress { seconds: 20 };
        let states = [(0, NetworkState::Joining), (24, late)];
        assert_eq!(wait(&states), (24, Err(JoinError::NoAddress(20))));
    }
}
