//! What a search explores: the bounds of the network, and at most one change of the rule.

/// A design: the rule, or the rule with one change.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// Most datagrams under way to the robot, 1 to [`Model::MOST`].
    pub up: usize,
    /// Most datagrams under way to the clients, 1 to [`Model::MOST`].
    pub down: usize,
    /// Whether clients may be programs, which follow permits.
    pub has_programs: bool,
    /// Whether operators are renamed so that anna holds the session: half the states, but unreadable traces.
    pub renames: bool,
    /// Whether states that differ in nothing later are explored once. Without, a search has three times the states or more, and shows
    /// that the reductions hide nothing.
    pub reduces: bool,
    /// The change of the rule.
    pub change: Option<Change>,
}

impl Model {
    /// Most datagrams under way in one direction.
    pub const MOST: usize = 3;

    /// Returns the rule with bounds of the network.
    pub const fn new(up: usize, down: usize) -> Self {
        Self { up, down, has_programs: false, renames: false, reduces: true, change: None }
    }

    /// Returns the model with programs.
    pub const fn with_programs(self) -> Self {
        Self { has_programs: true, ..self }
    }

    /// Returns the model with operators that are renamed.
    pub const fn renamed(self) -> Self {
        Self { renames: true, ..self }
    }

    /// Returns the model whose states are explored one by one.
    pub const fn unreduced(self) -> Self {
        Self { reduces: false, ..self }
    }

    /// Returns the model with a change of the rule.
    pub const fn with(self, change: Change) -> Self {
        Self { change: Some(change), ..self }
    }

    /// Returns whether the rule has this change.
    pub fn has(&self, change: Change) -> bool {
        self.change == Some(change)
    }

    /// Returns whether permits have two ages only, present and old, and an old permit is good for nothing at either end.
    pub(crate) fn forgets_old_permits(&self) -> bool {
        self.reduces && self.keeps_old_permits_old() && !self.has_programs
    }

    /// Returns whether the robot obeys orders as the rule says.
    pub(crate) fn obeys_as_the_rule(&self) -> bool {
        use Change::{AlignedKeepsPermit, ClearDisarms, ExpiredBegins, TriedKeepsPermit, WalkArms};
        let is_otherwise = matches!(
            self.change,
            Some(AlignedKeepsPermit | ClearDisarms | ExpiredBegins | TriedKeepsPermit | WalkArms)
        );
        self.reduces && self.keeps_old_permits_old() && !is_otherwise
    }

    /// Returns whether an old permit never counts as the present permit.
    pub(crate) const fn keeps_old_permits_old(&self) -> bool {
        use Change::{ClientKeepsPermit, ClientRenewsPermit, NoPermit, OneBit, SlowHalfChecks};
        !matches!(
            self.change,
            Some(NoPermit | OneBit | SlowHalfChecks | ClientRenewsPermit | ClientKeepsPermit)
        )
    }
}

/// A change of the rule. [`mutants`](crate::mutants) says which invariant each of them breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The robot checks no permit.
    NoPermit,
    /// The robot checks no counter.
    NoCounter,
    /// A session neither binds orders nor is a new permit.
    NoSession,
    /// The slow half of the robot checks the permit, by the newest report of the fast half.
    SlowHalfChecks,
    /// A permit has one bit.
    OneBit,
    /// The end of alignment is no new permit.
    AlignedKeepsPermit,
    /// The end of a trial is no new permit.
    TriedKeepsPermit,
    /// The end of a trial is two new permits.
    TriedCountsTwice,
    /// A trial that its operator ends by an order is a new permit, too.
    OwnEndOfTrialCounts,
    /// A second fault of a faulted robot is no new permit.
    SecondFaultKeepsPermit,
    /// `Off` of the operator is a new permit.
    OwnOffCounts,
    /// `Off` counts in any order.
    OffInAnyOrder,
    /// `Stop` counts in any order, and is a new permit where it latches.
    StopInAnyOrder,
    /// An order that has expired begins what it asks for.
    ExpiredBegins,
    /// `Off` and `Stop` that arrive too late are withheld.
    LateStopWithheld,
    /// `Walk` arms.
    WalkArms,
    /// Clients send `Clear` to robots without stop and fault.
    ClearUnasked,
    /// As before, and `Clear` disarms an armed robot.
    ClearDisarms,
    /// A client takes a new permit for the wish that it has.
    ClientRenewsPermit,
    /// A client keeps its permit over sessions, and the robot's numbers coincide.
    ClientKeepsPermit,
    /// A client calls a stop acknowledged by the flag of the telemetry alone.
    AcknowledgedByFlag,
    /// A program follows a permit for any reason.
    FollowsAnyReason,
    /// A program whose trial was done keeps its order, with the next permit.
    TriesAgainUnasked,
    /// A program presses its next trial by the permit that is shown, not by the permit that it followed.
    ProgramPressesShown,
}
