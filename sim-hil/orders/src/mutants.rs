//! The runs: the rule itself, variants that hold too, and mutants, each of which has to break an invariant.

use crate::invariant::Invariant::{self, I1, I2, I3, I4, I5, I6, I7};
use crate::model::{Change, Model};
use crate::search::{End, Verdict};

/// A search with its expected end.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Name, by which the run is chosen.
    pub name: &'static str,
    /// What the search explores.
    pub model: Model,
    /// Invariants of which one has to break first; none where all have to hold.
    pub breaks: &'static [Invariant],
}

impl Run {
    /// Returns whether the search ended as expected.
    pub fn is_as_expected(&self, verdict: &Verdict) -> bool {
        match &verdict.end {
            End::Holds => self.breaks.is_empty(),
            End::Breaks(invariant, _) => self.breaks.contains(invariant),
            End::TooManyStates => false,
        }
    }
}

const SMALL: Model = Model::new(2, 1);
const PROGRAMS: Model = SMALL.with_programs();

const fn mutant(name: &'static str, change: Change, breaks: &'static [Invariant]) -> Run {
    Run { name, model: SMALL.with(change), breaks }
}

const fn mutant_of_programs(
    name: &'static str,
    change: Change,
    breaks: &'static [Invariant],
) -> Run {
    Run { name, model: PROGRAMS.with(change), breaks }
}

const fn holds(name: &'static str, model: Model) -> Run {
    Run { name, model, breaks: &[] }
}

/// All runs, the largest last.
pub const RUNS: [Run; 31] = [
    mutant("mutant: the robot checks no permit", Change::NoPermit, &[I1]),
    mutant("mutant: the robot checks no counter", Change::NoCounter, &[I2]),
    mutant("mutant: a session neither binds orders nor is a new permit", Change::NoSession, &[I4]),
    mutant("mutant: the slow half checks the permit", Change::SlowHalfChecks, &[I1, I5]),
    mutant("mutant: a permit of one bit", Change::OneBit, &[I1, I5]),
    mutant("mutant: the end of alignment is no new permit", Change::AlignedKeepsPermit, &[I1]),
    mutant("mutant: the end of a trial is no new permit", Change::TriedKeepsPermit, &[I1]),
    mutant_of_programs(
        "mutant: the end of a trial is two new permits",
        Change::TriedCountsTwice,
        &[I3],
    ),
    mutant(
        "mutant: a trial ended by its operator is a new permit",
        Change::OwnEndOfTrialCounts,
        &[I3],
    ),
    mutant("mutant: a second fault is no new permit", Change::SecondFaultKeepsPermit, &[I5]),
    mutant("mutant: own Off is a new permit", Change::OwnOffCounts, &[I3]),
    mutant("mutant: Off counts in any order", Change::OffInAnyOrder, &[I3]),
    mutant("mutant: an expired order begins", Change::ExpiredBegins, &[I1]),
    mutant("mutant: a late Off or Stop is withheld", Change::LateStopWithheld, &[I2]),
    mutant("mutant: Walk arms", Change::WalkArms, &[I7]),
    mutant("mutant: Clear disarms, and clients send it unasked", Change::ClearDisarms, &[I3]),
    mutant("mutant: a client renews its permit by itself", Change::ClientRenewsPermit, &[I1, I5]),
    mutant("mutant: a client keeps its permit over sessions", Change::ClientKeepsPermit, &[I1, I5]),
    mutant("mutant: a stop is acknowledged by the flag alone", Change::AcknowledgedByFlag, &[I6]),
    mutant_of_programs("mutant: a program follows any reason", Change::FollowsAnyReason, &[I1]),
    mutant_of_programs(
        "mutant: a program keeps Try with the next permit",
        Change::TriesAgainUnasked,
        &[I1],
    ),
    mutant_of_programs(
        "mutant: a program presses by the shown permit",
        Change::ProgramPressesShown,
        &[I1, I5],
    ),
    holds("variant: Stop in any order, and counted", SMALL.with(Change::StopInAnyOrder)),
    holds("variant: clients send Clear unasked", SMALL.with(Change::ClearUnasked)),
    holds("rule, 2 up, 1 down", SMALL.renamed()),
    holds("rule, 2 up, 1 down, unreduced", SMALL.renamed().unreduced()),
    holds(
        "rule with programs, 1 up, 1 down, unreduced",
        Model::new(1, 1).with_programs().unreduced(),
    ),
    holds("rule, 2 up, 2 down", Model::new(2, 2).renamed()),
    holds("rule with programs, 2 up, 1 down", PROGRAMS.renamed()),
    holds("rule with programs, 2 up, 2 down", Model::new(2, 2).with_programs().renamed()),
    holds("rule, 3 up, 3 down", Model::new(3, 3).renamed()),
];
