//! How arming ends, in virtual time against a robot's end of the link.

use std::time::Duration;

use flix_host::link::{
    ARM_PATIENCE, Client, LinkError, PASSING_PATIENCE, RobotLink, TELEMETRY_LAG, Update, Wish,
};
use flix_protocol::message::{Event, Fault, Halt, Order, Refusal, Setpoint, State, ToRobot};
use flix_protocol::units::Instant;

use crate::link::World;
use crate::support::FakeRobot;

/// A world as a link, with what happens to its robot all the time.
struct Rig<C> {
    world: World,
    change: C,
}

impl<C: FnMut(&mut FakeRobot)> RobotLink for Rig<C> {
    type Error = LinkError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        (&mut self.world.client, self.world.now)
    }

    fn wait(&mut self, _: Duration) -> Result<(), LinkError> {
        (self.change)(&mut self.world.robot);
        self.world.exchange();
        Ok(())
    }
}

impl<C: FnMut(&mut FakeRobot)> Rig<C> {
    fn new(change: C) -> Self {
        let mut world = World::connected();
        // Of what was before arming nothing is said.
        while world.client.update().is_some() {}
        Self { world, change }
    }

    /// Arms it. Returns how that ends, and when.
    fn arms(&mut self) -> (Result<(), LinkError>, Duration) {
        let begun = self.world.now;
        let ended = self.arm();
        (ended, self.world.now.since(begun))
    }
}

/// Arms a robot that is changed so just before. Returns how that ends, and when.
fn ends(change: fn(&mut FakeRobot)) -> (Result<(), LinkError>, Duration) {
    let mut rig = Rig::new(|_| {});
    change(&mut rig.world.robot);
    rig.arms()
}

#[test]
fn a_robot_that_aligns_its_motors_first_is_armed_then() {
    let mut ticks = 0;
    let mut rig = Rig::new(move |robot: &mut FakeRobot| {
        ticks += 1;
        robot.aligns_for_ever = ticks < 3_500;
    });
    let (ended, after) = rig.arms();
    assert_eq!(ended, Ok(()));
    assert!((3.5..3.6).contains(&after.as_secs_f64()), "{after:?}");
}

#[test]
fn events_that_come_while_a_robot_is_armed_are_left_to_who_drives_it() {
    let mut rig = Rig::new(|_| {});
    rig.world.robot.is_low = true;
    rig.arms().0.unwrap();
    let mut left = std::iter::from_fn(|| rig.world.client.update());
    assert!(
        left.any(|it| matches!(it, Update::Event(it) if matches!(it.event, Event::BatteryLow(_))))
    );
}

#[test]
fn who_runs_out_of_patience_learns_what_the_robot_said_last() {
    let (ended, after) = ends(|robot| robot.aligns_for_ever = true);
    let (wanted, actual) = (State::Armed, State::Aligning);
    assert_eq!(ended, Err(LinkError::State { wanted, actual }));
    assert!(after.abs_diff(ARM_PATIENCE) < Duration::from_millis(50), "{after:?}");
    let unproven = LinkError::Refused(Refusal::LinkUnproven);
    let mute: fn(&mut FakeRobot) = |robot| {
        robot.loses = |it| matches!(it, ToRobot::Order(Order::Arm(_)));
    };
    for (change, error) in [
        ((|robot| robot.is_unproven = true) as fn(&mut FakeRobot), unproven),
        (mute, LinkError::Unanswered),
    ] {
        let (ended, after) = ends(change);
        assert_eq!(ended, Err(error));
        assert!(after.abs_diff(ARM_PATIENCE) < Duration::from_millis(50), "{after:?}");
    }
}

#[test]
fn a_program_insists_for_as_long_as_it_says() {
    let patience = 2 * PASSING_PATIENCE;
    let mut world = World::connected();
    while world.client.update().is_some() {}
    world.robot.is_unproven = true;
    world.client.insist_on(world.now, Wish::Arm, patience).unwrap();
    let (begun, order) = (world.now, world.client.order());
    while world.client.order() == order {
        world.exchange();
    }
    let after = world.now.since(begun);
    assert!(after.abs_diff(patience) < Duration::from_millis(50), "{after:?}");
    let why = Some(Refusal::LinkUnproven);
    let updates = std::iter::from_fn(|| world.client.update());
    assert!(updates.into_iter().any(|it| it == Update::Ended { order, why: why.clone() }));
}

#[test]
fn a_stop_and_a_fault_end_it_by_their_names() {
    let (ended, _) = ends(|robot| robot.fail(Fault::Stall));
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "{ended:?}");
    let (ended, _) = ends(|robot| robot.stopped = true);
    assert!(matches!(ended, Err(LinkError::StoppedBy(_))), "{ended:?}");
    // The same while the motors are aligned.
    let late = |change: fn(&mut FakeRobot)| {
        let mut ticks = 0;
        let mut rig = Rig::new(move |robot: &mut FakeRobot| {
            robot.aligns_for_ever = true;
            ticks += 1;
            if ticks == 500 {
                change(robot);
            }
        });
        rig.arms().0
    };
    let ended = late(|robot| robot.fail(Fault::Alignment));
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "{ended:?}");
    let ended = late(FakeRobot::stop_from_outside);
    assert!(matches!(ended, Err(LinkError::StoppedBy(_))), "{ended:?}");
}

#[test]
fn a_robot_that_disarms_by_itself_is_not_armed_again() {
    let mut rig = Rig::new(|_| {});
    rig.world.robot.lapses = Some(Halt::LinkLost);
    let (ended, after) = rig.arms();
    assert_eq!(ended, Err(LinkError::Lapsed));
    assert!(after < TELEMETRY_LAG, "{after:?}");
    let _ = rig.pause(ARM_PATIENCE);
    assert_eq!(rig.world.robot.state, State::Disarmed);
}

#[test]
fn a_robot_whose_commands_stay_away_is_armed_again_three_times() {
    for (lapses, ended) in [(3, Ok(())), (4, Err(LinkError::Lapsed))] {
        let mut left = lapses;
        let mut rig = Rig::new(move |robot: &mut FakeRobot| {
            if left > 0 && robot.lapses.is_none() && robot.state == State::Disarmed {
                left -= 1;
                robot.lapses = Some(Halt::LetGo);
            }
        });
        assert_eq!(rig.arms().0, ended, "{lapses}");
    }
}

#[test]
fn a_person_arms_again_himself_what_let_go_while_it_aligned() {
    let mut rig = Rig::new(|_| {});
    rig.world.robot.lapses = Some(Halt::LetGo);
    rig.press(Wish::Arm).unwrap();
    rig.pause(PASSING_PATIENCE).unwrap();
    assert_eq!(rig.world.robot.state, State::Disarmed);
    assert_eq!(rig.world.client.order(), Order::Off);
}

#[test]
fn a_robot_that_is_armed_already_is_armed_at_once() {
    for walks in [false, true] {
        let mut rig = Rig::new(|_| {});
        assert_eq!(rig.arms().0, Ok(()));
        if walks {
            rig.hold(Setpoint::from_numbers(-30.0, 30.0).unwrap());
            rig.pause(TELEMETRY_LAG).unwrap();
        }
        let (ended, after) = rig.arms();
        assert_eq!(ended, Ok(()), "{walks}");
        assert!(after < TELEMETRY_LAG, "{after:?}");
    }
}

#[test]
fn who_arms_before_the_last_halt_is_heard_of_arms_only_once_it_is() {
    let mut rig = Rig::new(|_| {});
    rig.world.robot.halt();
    assert_eq!(rig.arms().0, Err(LinkError::Lapsed));
    assert_eq!(rig.world.robot.state, State::Disarmed);
    assert_eq!(rig.arms().0, Ok(()));
}
