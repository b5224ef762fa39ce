//! When a goal is promised, and when it is reached.

use crate::goal::Goal;
use crate::model::{Change, Model};
use crate::order::Word;
use crate::robot::{Mode, Session};
use crate::world::World;

impl Goal {
    /// Returns whether the goal can be promised to operator `who`: a press that begins something needs a client that shows the
    /// newest halt, and a robot on which nothing that was asked before is about to prevent the press.
    pub(crate) fn is_promised(self, model: &Model, world: &World, who: usize) -> bool {
        let (robot, client) = (&world.robot, &world.clients[who]);
        let holds = client.session == Session::Present;
        let is_shown = holds && client.has_telemetry && !client.is_unseen;
        let stops_in_any_order = model.has(Change::StopInAnyOrder) || model.has(Change::NoCounter);
        let a_halt_is_under_way =
            world.up.all().iter().map(|it| it.order.word).any(|word| {
                word == Word::StopFromOutside || word == Word::Stop && stops_in_any_order
            });
        let is_ready = is_shown && !a_halt_is_under_way && client.takes(model, self.word());
        let newer = || {
            world.up.all().iter().filter(|it| it.counter >= robot.newest).map(|it| it.order.word)
        };
        match self {
            Self::Armed => is_ready && !robot.is_ill(),
            Self::Walking => {
                let keeps = client.order.word.keeps_armed() && newer().all(Word::keeps_armed);
                is_ready && !robot.is_ill() && robot.mode == Mode::Armed && keeps
            }
            Self::Cleared => is_ready && robot.is_ill(),
            Self::Stopped => holds && client.order.word != Word::Stop,
            Self::StoppedFromOutside => !holds,
            Self::NextTrial => {
                let rests = robot.mode == Mode::Disarmed && newer().all(|it| it != Word::Arm);
                model.has_programs && is_ready && !robot.is_ill() && rests
            }
        }
    }

    /// Returns whether the world has reached the goal.
    pub(crate) fn is_reached(self, world: &World) -> bool {
        let robot = &world.robot;
        match self {
            Self::Armed => robot.mode == Mode::Armed,
            Self::Walking => robot.mode == Mode::Running,
            Self::Cleared => !robot.is_ill(),
            Self::Stopped | Self::StoppedFromOutside => robot.is_stopped && robot.mode.is_idle(),
            Self::NextTrial => world.clients[usize::from(world.actor)].order.word == Word::Next,
        }
    }
}
