//! Canonical worlds: what makes no difference to any later step is forgotten, and numbers that only count are replaced by their
//! places in order. So a search ends, although presses, halts and sessions are without number.

use crate::client::Client;
use crate::model::{Change, Model};
use crate::network::{Datagram, Telemetry};
use crate::order::{Age, Order, Word};
use crate::robot::{Halt, Mode, Robot, Session};
use crate::world::{World, counts_in_any_order};

/// Makes a world canonical.
pub(crate) fn reduce(model: &Model, world: &mut World) {
    drop_datagrams_without_effect(model, world);
    reduce_clients(model, world);
    reduce_robot(model, &mut world.robot);
    reduce_orders(model, world);
    reduce_telemetry(model, world);
    if model.renames {
        rename(world);
    }
    let outside = world.up.all_mut().iter_mut().filter(|it| it.order.word == Word::StopFromOutside);
    outside.for_each(|it| it.sender = 0);
    number(world);
    while merge(world) {
        number(world);
    }
    world.up.sort();
    world.down.sort();
}

/// Drops datagrams that change nothing whenever they arrive: as if they were lost.
fn drop_datagrams_without_effect(model: &Model, world: &mut World) {
    let World { robot, clients, up, down, .. } = world;
    up.retain(|it| {
        let word = it.order.word;
        let is_of_session = model.has(Change::NoSession) || it.session == Session::Present;
        let is_in_order = model.has(Change::NoCounter) || it.counter >= robot.newest;
        word == Word::StopFromOutside
            || is_of_session && (is_in_order || counts_in_any_order(model, word))
    });
    down.retain(|it| {
        let client = &clients[usize::from(it.reader)];
        client.session == Session::Present && it.moment >= client.newest
    });
}

/// Forgets clients without a session, and permits and telemetry that a client does not show.
fn reduce_clients(model: &Model, world: &mut World) {
    let keeps_ended = model.has(Change::NoSession) || model.has(Change::ClientKeepsPermit);
    for (who, client) in world.clients.iter_mut().enumerate() {
        if client.session == Session::None || client.session == Session::Ended && !keeps_ended {
            *client = Client::default();
        }
        if !client.has_telemetry {
            client.age = if model.has_programs { Age::Older } else { Age::Previous };
            (client.is_unseen, client.shows_ill) = (true, false);
        }
        if model.forgets_old_permits() {
            // A press by an old permit does no more than a press of rest.
            client.has_telemetry &= client.age == Age::Present;
            client.shows_ill &= client.has_telemetry;
        }
        let mut under_way = world.down.all().iter().filter(|it| usize::from(it.reader) == who);
        if !under_way.any(|it| it.moment <= client.newest) {
            client.newest = 0;
        }
    }
}

/// Forgets an order that has expired, and the reason of a permit that no program follows.
fn reduce_robot(model: &Model, robot: &mut Robot) {
    if robot.is_late && !model.has(Change::ExpiredBegins) {
        robot.order = Order::default();
    }
    if !matches!(robot.mode, Mode::Armed | Mode::Dip) {
        robot.is_late = false;
    }
    robot.is_unreported &= model.has(Change::SlowHalfChecks);
    if !model.has_programs {
        robot.halt = Halt::Other;
    }
}

/// Replaces orders by simpler orders that do the same. To the robot an old permit stays old, so its order is rest or off.
fn reduce_orders(model: &Model, world: &mut World) {
    let World { robot, clients, up, .. } = world;
    let sent = up.all_mut().iter_mut().map(|it| &mut it.order).chain([&mut robot.order]);
    let sent = sent.map(|it| (it, model.reduces && model.keeps_old_permits_old()));
    let wishes = clients.iter_mut().map(|it| (&mut it.order, model.forgets_old_permits()));
    for (order, old_stays_old) in sent.chain(wishes) {
        if old_stays_old && order.age != Age::Present {
            match order.word {
                Word::Arm | Word::Walk => order.word = Word::Rest,
                Word::Clear if !model.has(Change::ClearDisarms) => order.word = Word::Rest,
                Word::Try | Word::Clear => *order = Order::default(),
                _ => {}
            }
        }
        if !order.word.needs_permit() && order.word != Word::Next {
            (order.age, order.is_unseen, order.is_expired) = (Age::Present, false, false);
        }
        // After a stop from outside every permit is old, so that its moment is needed only where permits are not checked.
        let is_outside =
            order.word == Word::StopFromOutside && model.reduces && model.keeps_old_permits_old();
        if is_outside || matches!(order.word, Word::Rest | Word::Next) {
            order.pressed = 0;
        }
    }
    if model.obeys_as_the_rule() {
        reduce_order_in_force(robot);
    }
}

/// Replaces an order that the robot has obeyed by the simplest order that leaves the robot in its state. Each step obeys the
/// order in force, so an order whose effect is still to come is among those that are kept: a walk while rotors turn, and in a
/// robot that ramps down or has a fault what waits for its end.
fn reduce_order_in_force(robot: &mut Robot) {
    let word = robot.order.word;
    robot.order = match robot.mode {
        Mode::Disarmed | Mode::Dip => Order::default(),
        Mode::Aligning | Mode::Armed => Order::withdrawn(Word::Rest),
        Mode::Trying => Order::withdrawn(Word::Try),
        Mode::Running => robot.order,
        Mode::Stopping if matches!(word, Word::Arm | Word::Try | Word::Clear) => robot.order,
        Mode::Faulted if word == Word::Clear => robot.order,
        Mode::Stopping | Mode::Faulted => Order::default(),
    };
}

/// Keeps of telemetry what its client looks at.
fn reduce_telemetry(model: &Model, world: &mut World) {
    let World { clients, down, .. } = world;
    for telemetry in down.all_mut() {
        let client = &clients[usize::from(telemetry.reader)];
        let is_stop = client.order.word == Word::Stop;
        if is_stop && client.stop_since != 0 && telemetry.heard >= client.stop_since {
            telemetry.heard = client.stop_since;
        } else {
            telemetry.heard = 0;
            telemetry.is_stopped &= is_stop && model.has(Change::AcknowledgedByFlag);
        }
        if !model.has_programs {
            telemetry.halt = Halt::Other;
        }
        if model.forgets_old_permits() {
            // No wish is left whose end depends on whether the robot is idle.
            telemetry.is_idle = false;
        }
    }
    if model.forgets_old_permits() {
        down.retain(|it| it.age == Age::Present || it.is_stopped);
    }
}

/// Renames the operators so that anna holds the session.
fn rename(world: &mut World) {
    if world.robot.session != Session::Present || world.robot.holder == 0 {
        return;
    }
    world.clients.swap(0, 1);
    world.up.all_mut().iter_mut().for_each(|it| it.sender = 1 - it.sender);
    world.down.all_mut().iter_mut().for_each(|it| it.reader = 1 - it.reader);
    (world.robot.holder, world.robot.giver) = (0, 1 - world.robot.giver);
    if world.goal.is_some() {
        world.actor = 1 - world.actor;
    }
}

/// Takes out a copy where the next datagram says the same: all that the copy could do, the next can, which may arrive more than
/// once. So different orders are under way, however often each of them is repeated. Returns whether a copy was taken out.
fn merge(world: &mut World) -> bool {
    let is_first_stop = |counter: u8| world.clients.iter().any(|it| it.stop_since == counter);
    let (ups, downs) = (world.up.all(), world.down.all());
    let is_repeated = |it: &Datagram| {
        it.order.word != Word::StopFromOutside
            && !is_first_stop(it.counter + 1)
            && ups.contains(&Datagram { counter: it.counter + 1, ..*it })
    };
    let is_stated_again =
        |it: &Telemetry| downs.contains(&Telemetry { moment: it.moment + 1, ..*it });
    if let Some(place) = ups.iter().position(is_repeated) {
        world.up.remove(place);
        return true;
    }
    if let Some(place) = downs.iter().position(is_stated_again) {
        world.down.remove(place);
        return true;
    }
    false
}

/// Replaces moments of presses, counters, and moments of telemetry by their places in order. 0 stays 0.
fn number(world: &mut World) {
    number_presses(world);
    let mut seen = Seen::default();
    counters(world, |it| seen.add(*it));
    counters(world, |it| *it = seen.place(*it));
    let mut seen = Seen::default();
    moments(world, |it| seen.add(*it));
    moments(world, |it| *it = seen.place(*it));
}

/// Numbers presses. A press that calms counts only where an order that begins something was pressed before; an order that begins
/// something has the place of the last press that calms before it.
fn number_presses(world: &mut World) {
    let mut first = u8::MAX;
    presses(world, |calms, moment| {
        if !calms {
            first = first.min(*moment);
        }
    });
    let mut seen = Seen::default();
    presses(world, |calms, moment| {
        if calms && *moment <= first {
            *moment = 0;
        }
        if calms {
            seen.add(*moment);
        }
    });
    presses(world, |_, moment| *moment = seen.place(*moment));
}

/// Calls `look` with the moment of each press, and whether the press calms.
fn presses(world: &mut World, mut look: impl FnMut(bool, &mut u8)) {
    let World { robot, clients, up, .. } = world;
    look(true, &mut robot.calmed);
    let orders = up.all_mut().iter_mut().map(|it| &mut it.order);
    for order in orders.chain(clients.iter_mut().map(|it| &mut it.order)).chain([&mut robot.order])
    {
        if order.word != Word::Rest {
            look(order.word.calms(), &mut order.pressed);
        }
    }
}

fn counters(world: &mut World, mut look: impl FnMut(&mut u8)) {
    look(&mut world.robot.newest);
    world.clients.iter_mut().for_each(|it| look(&mut it.stop_since));
    world.up.all_mut().iter_mut().for_each(|it| look(&mut it.counter));
    world.down.all_mut().iter_mut().for_each(|it| look(&mut it.heard));
}

fn moments(world: &mut World, mut look: impl FnMut(&mut u8)) {
    world.clients.iter_mut().for_each(|it| look(&mut it.newest));
    world.down.all_mut().iter_mut().for_each(|it| look(&mut it.moment));
}

/// The set of numbers from 0 to 63 that occur.
#[derive(Default)]
struct Seen(u64);

impl Seen {
    fn add(&mut self, number: u8) {
        self.0 |= 1 << number;
    }

    /// Returns how many numbers of the set lie in 1 to `number`.
    fn place(&self, number: u8) -> u8 {
        (self.0 >> 1 & ((1 << number) - 1)).count_ones() as u8
    }
}
