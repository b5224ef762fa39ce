//! The steps that may follow a world: of the robot, of the network, and of persons.

use crate::canonical;
use crate::goal::Goal;
use crate::invariant::Invariant;
use crate::model::{Change, Model};
use crate::network::Telemetry;
use crate::order::{Age, Word};
use crate::persons;
use crate::robot::{Halt, Mode, Robot, Session};
use crate::step::{Kept, Step, Take, go};
use crate::world::{NOW, World};

/// Calls `take` with every step that may follow a canonical world, and the canonical world after it.
pub fn steps(model: &Model, world: &World, take: &mut dyn FnMut(Step, World)) {
    let mut take = |step: Step, mut next: World, result: Result<(), Invariant>| {
        next.broken = result.err();
        canonical::reduce(model, &mut next);
        take(step, next);
    };
    robot(model, world, &mut take);
    if world.goal.is_none() {
        halts(model, world, &mut take);
    }
    up(model, world, &mut take);
    down(model, world, &mut take);
    for who in [0, 1] {
        persons::steps(model, world, who, &mut take);
    }
}

/// Steps of the robot that are no halts of others.
fn robot(model: &Model, world: &World, take: &mut Take) {
    let robot = &world.robot;
    if robot.mode == Mode::Aligning {
        go(take, world, Step::Aligned, |next| {
            next.robot.mode = Mode::Armed;
            let counts = !model.has(Change::AlignedKeepsPermit) && !model.has(Change::WalkArms);
            next.halt(model, Halt::Aligned, counts);
            next.robot.obey(model)
        });
    }
    if matches!(robot.mode, Mode::Dip | Mode::Stopping) {
        go(take, world, Step::Rest, |next| {
            if next.robot.mode == Mode::Dip {
                next.robot.mode = Mode::Armed;
                next.halt(model, Halt::Other, true);
            } else {
                next.robot.mode = Mode::Disarmed;
            }
            next.robot.obey(model)
        });
    }
    if robot.mode == Mode::Trying && matches!(world.goal, None | Some(Goal::NextTrial)) {
        go(take, world, Step::Tried, |next| {
            next.robot.mode = Mode::Disarmed;
            next.halt(model, Halt::Tried, !model.has(Change::TriedKeepsPermit));
            if model.has(Change::TriedCountsTwice) {
                next.halt(model, Halt::Tried, true);
            }
            next.robot.obey(model)
        });
    }
    if robot.mode == Mode::Faulted && robot.may_forget(model) {
        go(take, world, Step::ForgetFault, |next| next.robot.forget_fault());
    }
    if robot.session == Session::Present && world.down.all().len() < model.down {
        go(take, world, Step::SendTelemetry, |next| {
            next.down.push(telemetry(&world.robot));
            Ok(())
        });
    }
    if model.has(Change::SlowHalfChecks) && robot.is_unreported {
        go(take, world, Step::Report, |next| {
            next.robot.is_unreported = false;
            Ok(())
        });
    }
}

fn telemetry(robot: &Robot) -> Telemetry {
    Telemetry {
        reader: robot.holder,
        moment: NOW,
        age: if robot.is_unreported { Age::Previous } else { Age::Present },
        is_unseen: false,
        is_idle: robot.mode.is_idle(),
        is_ill: robot.is_ill(),
        is_stopped: robot.is_stopped,
        halt: robot.halt,
        heard: robot.newest,
    }
}

/// Silence, faults and restarts.
fn halts(model: &Model, world: &World, take: &mut Take) {
    let robot = &world.robot;
    let waits = robot.order.word.needs_permit() && !robot.order.is_expired;
    if !robot.is_late && (robot.mode.is_driven() || waits) {
        go(take, world, Step::Silence, |next| {
            (next.robot.is_late, next.robot.order.is_expired) = (true, true);
            match next.robot.mode {
                Mode::Running => next.robot.mode = Mode::Dip,
                Mode::Aligning | Mode::Trying => {
                    next.robot.mode = Mode::Disarmed;
                    next.halt(model, Halt::LetGo, true);
                }
                _ => {}
            }
            Ok(())
        });
    }
    if robot.is_late && matches!(robot.mode, Mode::Armed | Mode::Dip) {
        go(take, world, Step::LinkLost, |next| {
            next.robot.mode = Mode::Stopping;
            next.halt(model, Halt::Other, true);
            Ok(())
        });
    }
    if matches!(robot.mode, Mode::Dip | Mode::Stopping) {
        go(take, world, Step::NoRest, |next| {
            next.robot.mode = Mode::Disarmed;
            next.halt(model, Halt::Other, true);
            next.robot.obey(model)
        });
    }
    if robot.mode != Mode::Disarmed && robot.faults < Robot::KINDS_OF_FAULTS {
        go(take, world, Step::Fault, |next| {
            let is_first = next.robot.mode != Mode::Faulted;
            if next.robot.mode == Mode::Trying && model.has(Change::TriedCountsTwice) {
                next.halt(model, Halt::Tried, true);
            }
            next.robot.faults += 1;
            next.robot.mode = Mode::Faulted;
            next.halt(model, Halt::Fault, is_first || !model.has(Change::SecondFaultKeepsPermit));
            // A `Clear` in force is for the faults before.
            next.robot.obey(model)
        });
    }
    go(take, world, Step::Restart, |next| {
        next.robot = Robot::default();
        // The robot counts from the start again, and comes to numbers that a client may have kept.
        next.halt(model, Halt::Other, !model.has(Change::ClientKeepsPermit));
        next.end_sessions();
        Ok(())
    });
}

/// Orders that arrive or are lost. An order that arrives too late and does not calm is withheld, which is as if it were lost.
fn up(model: &Model, world: &World, take: &mut Take) {
    for (place, datagram) in world.up.all().iter().enumerate() {
        let n = place as u8;
        let word = datagram.order.word;
        for kept in [Kept::Nothing, Kept::Copy] {
            // A stop from outside counts once for each cookie.
            if kept == Kept::Copy && word == Word::StopFromOutside {
                continue;
            }
            let arrive = |next: &mut World, is_late: bool| {
                if kept == Kept::Nothing {
                    next.up.remove(place);
                }
                next.take(model, datagram, is_late)
            };
            go(take, world, Step::Arrive(n, kept), |next| arrive(next, false));
            if word.calms() || model.has(Change::ExpiredBegins) {
                go(take, world, Step::ArriveLate(n, kept), |next| arrive(next, true));
            }
        }
        go(take, world, Step::Lose(n), |next| {
            next.up.remove(place);
            Ok(())
        });
    }
}

/// Telemetry that arrives or is lost. In the run of a goal, a program follows whatever it can.
fn down(model: &Model, world: &World, take: &mut Take) {
    for (place, telemetry) in world.down.all().iter().enumerate() {
        let n = place as u8;
        let reader = usize::from(telemetry.reader);
        let followed = match world.goal {
            None | Some(Goal::NextTrial) if model.has_programs => {
                world.clients[reader].followed(model, telemetry)
            }
            _ => None,
        };
        for kept in [Kept::Nothing, Kept::Copy] {
            let keep = |next: &mut World| {
                if kept == Kept::Nothing {
                    next.down.remove(place);
                }
            };
            if let Some(client) = followed {
                go(take, world, Step::Follow(n, kept), |next| {
                    keep(next);
                    next.clients[reader] = client;
                    Ok(())
                });
            }
            if followed.is_none() || world.goal.is_none() {
                go(take, world, Step::Hear(n, kept), |next| {
                    keep(next);
                    let client = &mut next.clients[reader];
                    let is_received = client.is_stop_received;
                    let is_acknowledged = client.hear(model, telemetry);
                    if is_acknowledged && !is_received { Err(Invariant::I6) } else { Ok(()) }
                });
            }
        }
        go(take, world, Step::LoseTelemetry(n), |next| {
            next.down.remove(place);
            Ok(())
        });
    }
}
