//! Steps of the world.

use std::fmt;

use crate::goal::Goal;
use crate::invariant::Invariant;
use crate::order::Word;
use crate::world::{OPERATORS, World};

/// A step of the world. Operators are 0 or 1, datagrams are named by their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// An operator opens a session.
    Connect(u8),
    /// A client loses its session, or restarts.
    Forget(u8),
    /// A person presses.
    Press(u8, Word),
    /// A program presses by the permit that it holds.
    PressNext(u8, Word),
    /// The patience of a client ends.
    GiveUp(u8),
    /// A client sends its order.
    Send(u8),
    /// The robot sends telemetry.
    SendTelemetry,
    /// An order arrives.
    Arrive(u8, Kept),
    /// An order arrives that is too old.
    ArriveLate(u8, Kept),
    /// An order is lost.
    Lose(u8),
    /// Telemetry arrives.
    Hear(u8, Kept),
    /// Telemetry arrives, and a program follows its permit.
    Follow(u8, Kept),
    /// Telemetry is lost.
    LoseTelemetry(u8),
    /// The motors are aligned.
    Aligned,
    /// The trial is done.
    Tried,
    /// The rotors stand.
    Rest,
    /// A ramp down ends without rest.
    NoRest,
    /// Orders stay away for 0.25 s, or the newest has expired.
    Silence,
    /// Orders stay away for 1 s.
    LinkLost,
    /// A new fault.
    Fault,
    /// The cause of a fault is gone, and the order in force clears it.
    ForgetFault,
    /// The robot restarts.
    Restart,
    /// The fast half reports to the slow half.
    Report,
    /// From now on no more halts come, and the press of an operator has to reach a goal.
    Calm(Goal, u8),
}

/// Whether the network keeps a copy of a datagram that arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// A copy stays under way.
    Copy,
    /// No copy stays.
    Nothing,
}

/// Receives a step, the world after it, and the invariant that it broke.
pub(crate) type Take<'a> = dyn FnMut(Step, World, Result<(), Invariant>) + 'a;

/// Changes a copy of the world, and calls `take` with it.
pub(crate) fn go(
    take: &mut Take,
    world: &World,
    step: Step,
    change: impl FnOnce(&mut World) -> Result<(), Invariant>,
) {
    let mut next = *world;
    let result = change(&mut next);
    take(step, next, result);
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |it: u8| OPERATORS[usize::from(it)];
        let copy = |it: Kept| if it == Kept::Copy { "; a copy stays" } else { "" };
        match *self {
            Self::Connect(who) => write!(f, "{} opens a session", name(who)),
            Self::Forget(who) => write!(f, "{}'s client restarts", name(who)),
            Self::Press(who, word) => write!(f, "{} presses {word:?}", name(who)),
            Self::PressNext(who, word) => write!(f, "{}'s program presses {word:?}", name(who)),
            Self::GiveUp(who) => write!(f, "{}'s client gives up", name(who)),
            Self::Send(who) => write!(f, "{}'s client sends", name(who)),
            Self::SendTelemetry => f.write_str("the robot sends telemetry"),
            Self::Arrive(n, kept) => write!(f, "order {n} arrives{}", copy(kept)),
            Self::ArriveLate(n, kept) => write!(f, "order {n} arrives too late{}", copy(kept)),
            Self::Lose(n) => write!(f, "order {n} is lost"),
            Self::Hear(n, kept) => write!(f, "telemetry {n} arrives{}", copy(kept)),
            Self::Follow(n, kept) => {
                write!(f, "telemetry {n} arrives and is followed{}", copy(kept))
            }
            Self::LoseTelemetry(n) => write!(f, "telemetry {n} is lost"),
            Self::Aligned => f.write_str("the motors are aligned"),
            Self::Tried => f.write_str("the trial is done"),
            Self::Rest => f.write_str("the rotors stand"),
            Self::NoRest => f.write_str("a ramp ends without rest"),
            Self::Silence => f.write_str("the newest order expires"),
            Self::LinkLost => f.write_str("no order for 1 s"),
            Self::Fault => f.write_str("a new fault"),
            Self::ForgetFault => f.write_str("a fault is forgotten"),
            Self::Restart => f.write_str("the robot restarts"),
            Self::Report => f.write_str("the fast half reports"),
            Self::Calm(goal, who) => write!(f, "no more halts; {} presses for {goal:?}", name(who)),
        }
    }
}
