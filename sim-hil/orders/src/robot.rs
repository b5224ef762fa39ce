//! The robot: its supervisor's states, the order in force, and what it obeys.

use crate::invariant::Invariant;
use crate::model::{Change, Model};
use crate::order::{Age, Order, Word};

/// State of the supervisor.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Mode {
    /// At rest, not armed.
    #[default]
    Disarmed,
    /// Aligns its motors, and is armed then.
    Aligning,
    /// Does a trial, and is disarmed then.
    Trying,
    /// Armed, rotors at rest.
    Armed,
    /// Rotors turn.
    Running,
    /// Ramps down because orders stay away.
    Dip,
    /// Ramps down, and is disarmed then.
    Stopping,
    /// Has a fault.
    Faulted,
}

impl Mode {
    /// Returns whether motors are driven and nothing ends that yet.
    pub const fn is_driven(self) -> bool {
        matches!(self, Self::Aligning | Self::Trying | Self::Armed | Self::Running | Self::Dip)
    }

    /// Returns whether the robot is idle, as telemetry shows it.
    pub const fn is_idle(self) -> bool {
        matches!(self, Self::Disarmed | Self::Faulted)
    }
}

/// Reason of the newest permit.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Halt {
    /// A reason that no program awaits.
    #[default]
    Other,
    /// The motors are aligned.
    Aligned,
    /// A trial is done.
    Tried,
    /// Motors that were aligned or tried coast, because orders stayed away.
    LetGo,
    /// A new fault.
    Fault,
}

/// State of a session, seen from the robot.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Session {
    /// No session.
    #[default]
    None,
    /// The robot's present session.
    Present,
    /// A session that has ended.
    Ended,
}

/// The robot.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
pub struct Robot {
    /// State of the supervisor.
    pub mode: Mode,
    /// Whether orders stay away while motors are driven.
    pub is_late: bool,
    /// Whether the stop is latched.
    pub is_stopped: bool,
    /// Number of faults that are latched, 0 to [`Robot::KINDS_OF_FAULTS`]. The kinds differ in nothing but that each is forgotten
    /// by itself.
    pub faults: u8,
    /// Operator of the session: 0 or 1.
    pub holder: u8,
    /// Its session, if any.
    pub session: Session,
    /// Counter of the newest order of the session; 0 before the first.
    pub newest: u8,
    /// The order in force.
    pub order: Order,
    /// Reason of the newest permit.
    pub halt: Halt,
    /// Of [`Change::SlowHalfChecks`]: whether the slow half does not know the present permit yet.
    pub is_unreported: bool,
    /// Of [`Change::SlowHalfChecks`]: whether the slow half has found the order's permit right.
    pub is_approved: bool,
    /// Ghost: moment of the newest press of `Off` or stop that was received.
    pub calmed: u8,
    /// Ghost: operator of the order in force.
    pub giver: u8,
    /// Ghost: session of the order in force.
    pub giver_session: Session,
}

impl Robot {
    /// Kinds of faults, each of which is latched at most once.
    pub const KINDS_OF_FAULTS: u8 = 2;

    /// Returns whether a stop or a fault is to be cleared first.
    pub fn is_ill(&self) -> bool {
        self.is_stopped || self.mode == Mode::Faulted
    }

    /// Ramps down and disarms, in any state.
    pub(crate) fn rest(&mut self) {
        self.mode = match self.mode {
            Mode::Aligning | Mode::Trying => Mode::Disarmed,
            Mode::Armed | Mode::Running | Mode::Dip => Mode::Stopping,
            other => other,
        };
    }

    /// Returns whether the order in force clears, and shows the present permit.
    pub(crate) fn may_forget(&self, model: &Model) -> bool {
        self.order.word == Word::Clear && !self.is_late && self.has_permit(model)
    }

    fn has_permit(&self, model: &Model) -> bool {
        if model.has(Change::SlowHalfChecks) {
            self.is_approved
        } else {
            model.has(Change::NoPermit) || self.order.age == Age::Present
        }
    }

    /// Obeys the order in force, as the supervisor does in every tick. An order that has expired begins and continues nothing.
    ///
    /// # Errors
    ///
    /// The invariant that breaks.
    pub(crate) fn obey(&mut self, model: &Model) -> Result<(), Invariant> {
        if self.is_late {
            return Ok(());
        }
        let (has_permit, word) = (self.has_permit(model), self.order.word);
        let disarms = !word.keeps_armed() || word == Word::Clear && model.has(Change::ClearDisarms);
        if self.is_stopped && self.mode.is_idle() {
            return if word == Word::Clear && has_permit { self.forget_stop() } else { Ok(()) };
        }
        match self.mode {
            Mode::Disarmed if has_permit && word == Word::Walk && model.has(Change::WalkArms) => {
                self.mode = Mode::Aligning;
                return Err(Invariant::I7);
            }
            Mode::Disarmed if has_permit && word == Word::Arm => {
                self.mode = Mode::Aligning;
                return self.check(Invariant::I1);
            }
            Mode::Disarmed if has_permit && word == Word::Try => {
                self.mode = Mode::Trying;
                return self.check(Invariant::I1);
            }
            Mode::Aligning if disarms => self.mode = Mode::Disarmed,
            Mode::Trying if word != Word::Try => self.mode = Mode::Disarmed,
            Mode::Armed | Mode::Running | Mode::Dip if disarms => self.mode = Mode::Stopping,
            Mode::Armed if word == Word::Walk && has_permit => {
                self.mode = Mode::Running;
                return self.check(Invariant::I1);
            }
            Mode::Dip if word == Word::Walk && has_permit => self.mode = Mode::Running,
            // An order without the present permit to walk is rest.
            Mode::Running | Mode::Dip if word != Word::Walk || !has_permit => {
                self.mode = Mode::Armed;
            }
            _ => {}
        }
        Ok(())
    }

    /// Forgets the stop of a robot at rest. Its faults stay, each by itself.
    fn forget_stop(&mut self) -> Result<(), Invariant> {
        self.is_stopped = false;
        self.check(Invariant::I5)
    }

    /// Forgets a fault whose cause is gone, after its motors have braked. A robot without faults is disarmed then.
    ///
    /// # Errors
    ///
    /// The invariant that breaks.
    pub(crate) fn forget_fault(&mut self) -> Result<(), Invariant> {
        self.faults -= 1;
        if self.faults == 0 {
            self.mode = Mode::Disarmed;
        }
        self.check(Invariant::I5)
    }

    /// Checks an order that moves the robot or clears it. `unseen` is the invariant that a person breaks who had not been shown
    /// the last halt.
    fn check(&self, unseen: Invariant) -> Result<(), Invariant> {
        if self.giver != self.holder || self.giver_session != Session::Present {
            Err(Invariant::I4)
        } else if self.order.is_unseen || self.order.is_expired {
            Err(unseen)
        } else if self.order.pressed < self.calmed {
            Err(Invariant::I2)
        } else {
            Ok(())
        }
    }
}
