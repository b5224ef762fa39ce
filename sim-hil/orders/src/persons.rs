//! Persons and programs: sessions, presses, and the orders that their clients send.

use crate::client::Client;
use crate::goal::Goal;
use crate::model::{Change, Model};
use crate::network::Datagram;
use crate::order::{Order, Word};
use crate::robot::{Halt, Session};
use crate::step::{Step, Take, go};
use crate::world::{NOW, World};

/// Words that a person may press in a session.
const PRESSES: [Word; 7] =
    [Word::Off, Word::Arm, Word::Walk, Word::Rest, Word::Try, Word::Clear, Word::Stop];

/// Calls `take` with every step of operator `who` and of the operator's client.
pub(crate) fn steps(model: &Model, world: &World, who: u8, take: &mut Take) {
    send(model, world, who, take);
    if world.goal.is_none() {
        sessions(model, world, who, take);
        presses(model, world, who, take);
        goals(model, world, who, take);
    } else if world.goal == Some(Goal::StoppedFromOutside) && world.actor == who {
        let is_under_way = world.up.all().iter().any(|it| it.order.word == Word::StopFromOutside);
        if !world.robot.is_stopped && !is_under_way {
            stop_from_outside(model, world, who, take);
        }
    }
}

fn send(model: &Model, world: &World, who: u8, take: &mut Take) {
    let session = world.clients[usize::from(who)].session;
    let is_of_use =
        session == Session::Present || session == Session::Ended && model.has(Change::NoSession);
    if is_of_use && world.up.all().len() < model.up {
        go(take, world, Step::Send(who), |next| {
            let client = &mut next.clients[usize::from(who)];
            if client.order.word == Word::Stop && client.stop_since == 0 {
                client.stop_since = NOW;
            }
            let order = client.order.on_the_wire();
            next.up.push(Datagram { session, sender: who, counter: NOW, order });
            Ok(())
        });
    }
}

fn sessions(model: &Model, world: &World, who: u8, take: &mut Take) {
    go(take, world, Step::Connect(who), |next| {
        connect(model, next, who);
        Ok(())
    });
    let client = &world.clients[usize::from(who)];
    if client.session != Session::None && !model.has(Change::ClientKeepsPermit) {
        go(take, world, Step::Forget(who), |next| {
            next.clients[usize::from(who)] = Client::default();
            Ok(())
        });
    }
}

/// Opens a session of operator `who`: the robot rests, and the permit is new.
fn connect(model: &Model, world: &mut World, who: u8) {
    let index = usize::from(who);
    world.robot.rest();
    let counts = !model.has(Change::NoSession) && !model.has(Change::ClientKeepsPermit);
    world.halt(model, Halt::Other, counts);
    world.end_sessions();
    let off = Order { pressed: NOW, ..Order::default() };
    world.robot.order = off;
    (world.robot.holder, world.robot.session) = (who, Session::Present);
    (world.robot.giver, world.robot.giver_session) = (who, Session::Present);
    (world.robot.newest, world.robot.is_late) = (0, false);
    let client = &mut world.clients[index];
    if model.has(Change::ClientKeepsPermit) && client.session == Session::Ended {
        (client.session, client.newest, client.stop_since) = (Session::Present, 0, 0);
    } else {
        *client = Client { session: Session::Present, order: off, ..Default::default() };
    }
}

fn presses(model: &Model, world: &World, who: u8, take: &mut Take) {
    let index = usize::from(who);
    let client = &world.clients[index];
    for word in PRESSES.into_iter().filter(|word| client.takes(model, *word)) {
        go(take, world, Step::Press(who, word), |next| {
            next.clients[index].press(word, NOW);
            Ok(())
        });
    }
    if client.order.word == Word::Next {
        for word in [Word::Arm, Word::Try, Word::Clear]
            .into_iter()
            .filter(|word| client.takes(model, *word))
        {
            go(take, world, Step::PressNext(who, word), |next| {
                next.clients[index].press_next(word, NOW);
                Ok(())
            });
        }
    }
    if client.session != Session::None && client.order.word.needs_permit() {
        go(take, world, Step::GiveUp(who), |next| {
            next.clients[index].withdraw(false);
            Ok(())
        });
    }
    stop_from_outside(model, world, who, take);
}

fn stop_from_outside(model: &Model, world: &World, who: u8, take: &mut Take) {
    if world.up.all().len() < model.up {
        go(take, world, Step::Press(who, Word::StopFromOutside), |next| {
            let order = Order { word: Word::StopFromOutside, pressed: NOW, ..Order::default() };
            next.up.push(Datagram { sender: who, order, ..Datagram::default() });
            Ok(())
        });
    }
}

fn goals(model: &Model, world: &World, who: u8, take: &mut Take) {
    let index = usize::from(who);
    for goal in Goal::ALL.into_iter().filter(|it| it.is_promised(model, world, index)) {
        go(take, world, Step::Calm(goal, who), |next| {
            (next.goal, next.actor) = (Some(goal), who);
            if goal != Goal::StoppedFromOutside {
                next.clients[index].press(goal.word(), NOW);
            }
            Ok(())
        });
    }
}
