//! The steps of commissioning, and why it ends without a result.

use flix_protocol::message::{Faults, Halt};

use super::finding::Finding;

/// Current limit while the amplifiers' scale is hardly known, A: a margin of 30 % below 2 A for what currents overshoot.
pub(super) const CURRENT_LIMIT: f64 = 1.4;

/// Why commissioning ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum CommissionError<E> {
    /// The robot did not do as asked.
    #[error(transparent)]
    Robot(#[from] E),
    /// A step ended in a fault.
    #[error("{step} ended in a fault: {faults}")]
    Faulted {
        /// Of which step.
        step: Step,
        /// All that are latched.
        faults: Faults,
    },
    /// The robot did not do what a step takes.
    #[error("{0} came to no end")]
    Endless(Step),
    /// The robot stopped by itself in the middle of a step, each time that the step was tried.
    #[error("{step} broke off: {halt}; `flix link-test` measures the link")]
    Lapsed {
        /// The step.
        step: Step,
        /// Why the robot stopped last.
        halt: Halt,
    },
    /// The robot may be given less current than this takes.
    #[error(
        "current_limit is {limit:.3} A, and commissioning takes up to {CURRENT_LIMIT} A: raise it with `flix parameters set`, or \
         enter the values of the motors by hand"
    )]
    Limited {
        /// Setting, A.
        limit: f64,
    },
    /// Currents would rest on a value that nobody entered.
    #[error("{name} is assumed: measure it, and enter it with `flix parameters set`")]
    Assumed {
        /// Of the setting.
        name: String,
    },
    /// The answer was of another kind.
    #[error("the robot answered something else than was asked; is its firmware of this version?")]
    OtherAnswer,
    /// Something is wired wrongly, or a motor does not behave like one.
    #[error(transparent)]
    Found(Finding),
}

/// Parts of commissioning, for progress and errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// [`super::wiring`].
    Wiring,
    /// [`super::circuit`].
    Phases,
    /// [`super::turning_field`], of the top or the bottom motor.
    Turning(usize),
    /// Alignment.
    Aligning,
    /// [`super::running`], slow.
    Slow,
    /// [`super::running`], fast.
    Fast,
    /// [`super::running`], changing speed.
    Ramps,
}

impl Step {
    /// All, in order.
    pub const ALL: [Self; 8] = [
        Self::Wiring,
        Self::Phases,
        Self::Turning(0),
        Self::Turning(1),
        Self::Aligning,
        Self::Slow,
        Self::Fast,
        Self::Ramps,
    ];
}

impl std::fmt::Display for Step {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Wiring => "looking at the wiring",
            Self::Phases => "measuring the phases",
            Self::Turning(0) => "turning the top motor",
            Self::Turning(_) => "turning the bottom motor",
            Self::Aligning => "aligning",
            Self::Slow => "running slowly",
            Self::Fast => "running fast",
            Self::Ramps => "changing speed",
        })
    }
}
