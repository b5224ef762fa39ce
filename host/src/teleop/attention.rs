//! How long a robot walks on without a sign of its operator.

use std::time::Duration;

use flix_protocol::units::Instant;

/// Time for which a robot walks on without a sign of its operator, and the time of his last sign.
#[derive(Debug, Clone, Copy)]
pub(super) struct Attention {
    pub(super) patience: Duration,
    /// Shorter, while it cannot be known whether anybody looks.
    pub(super) unsure: Option<Duration>,
    pub(super) since: Instant,
}

impl Attention {
    /// Returns for how long it still walks.
    pub(super) fn left(self, now: Instant) -> Duration {
        self.patience().saturating_sub(now.since(self.since))
    }

    pub(super) fn patience(self) -> Duration {
        self.unsure.map_or(self.patience, |unsure| unsure.min(self.patience))
    }
}
