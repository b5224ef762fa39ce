//! How arming ends, in virtual time against a robot's end of the link.

use std::time::Duration;

use flix_host::link::{ARM_PATIENCE, Arming, LinkError, REQUEST_PATIENCE, TELEMETRY_LAG};
use flix_protocol::message::{Command, Fault, Refusal, State};

use crate::link::World;
use crate::support::FakeRobot;

/// Arms for so long; `change` is what happens to the robot all the time. Returns how that ends, and when.
fn armed(
    patience: Duration,
    mut change: impl FnMut(&mut FakeRobot),
) -> (Result<(), LinkError>, Duration) {
    let mut world = World::connected();
    // Of what was before arming nothing is said.
    while world.client.update().is_some() {}
    let begun = world.now;
    let mut arming = Arming::begin(begun, &mut world.client, begun + patience);
    loop {
        change(&mut world.robot);
        world.exchange();
        while let Some(update) = world.client.update() {
            if let Some(ended) = arming.observe(world.now, &world.client, &update) {
                return (ended, world.now.since(begun));
            }
        }
        if let Some(error) = arming.poll(world.now, &mut world.client) {
            return (Err(error), world.now.since(begun));
        }
    }
}

/// The same of a robot that is so from the beginning.
fn ends(patience: Duration, change: fn(&mut FakeRobot)) -> (Result<(), LinkError>, Duration) {
    let mut is_new = true;
    armed(patience, |robot| {
        if std::mem::take(&mut is_new) {
            change(robot);
        }
    })
}

#[test]
fn a_robot_that_aligns_its_motors_first_is_armed_then() {
    let mut ticks = 0;
    let (ended, after) = armed(ARM_PATIENCE, |robot| {
        ticks += 1;
        robot.aligns_for_ever = ticks < 3_000;
        if ticks == 3_000 {
            robot.state = State::Armed;
        }
    });
    assert_eq!(ended, Ok(()));
    assert!((3.0..3.1).contains(&after.as_secs_f64()), "{after:?}");
}

#[test]
fn who_runs_out_of_patience_learns_what_the_robot_said_last() {
    let short = Duration::from_secs(1);
    let aligning = LinkError::State { wanted: State::Armed, actual: State::Aligning };
    let stopping = LinkError::Refused(Refusal::State(State::Stopping));
    let mute: fn(&mut FakeRobot) = |robot| robot.lost = Some(Command::Arm);
    for (change, error) in [
        ((|robot| robot.aligns_for_ever = true) as fn(&mut FakeRobot), aligning),
        (|robot| robot.ramps_down_for = u32::MAX, stopping),
        (mute, LinkError::Unanswered),
    ] {
        let (ended, after) = ends(short, change);
        assert_eq!(ended, Err(error));
        assert!((1.0..1.01).contains(&after.as_secs_f64()), "{after:?}");
    }
    // Asked again after a request that nobody answered.
    let (ended, after) = ends(2 * REQUEST_PATIENCE, mute);
    assert_eq!(ended, Err(LinkError::Unanswered));
    assert!(after > 2 * REQUEST_PATIENCE);
}

#[test]
fn a_stop_and_a_fault_end_it_by_their_names() {
    let (ended, _) = ends(ARM_PATIENCE, |robot| robot.fail(Fault::Stall));
    assert!(matches!(ended, Err(LinkError::Refused(Refusal::Faulted(_)))), "{ended:?}");
    let (ended, _) = ends(ARM_PATIENCE, |robot| robot.stopped = true);
    assert!(matches!(ended, Err(LinkError::StoppedBy(_) | LinkError::Refused(Refusal::Stopped))));
    // The same while the motors are aligned.
    let late = |change: fn(&mut FakeRobot)| {
        let mut ticks = 0;
        armed(ARM_PATIENCE, move |robot| {
            robot.aligns_for_ever = true;
            ticks += 1;
            if ticks == 500 {
                change(robot);
            }
        })
    };
    let (ended, _) = late(|robot| robot.fail(Fault::Alignment));
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "{ended:?}");
    let (ended, _) = late(FakeRobot::stop_from_outside);
    assert!(matches!(ended, Err(LinkError::StoppedBy(_))), "{ended:?}");
}

#[test]
fn a_robot_that_disarms_by_itself_is_not_armed_again() {
    let (ended, after) = ends(ARM_PATIENCE, |robot| robot.lapses = Some(false));
    let disarmed = LinkError::State { wanted: State::Armed, actual: State::Disarmed };
    assert_eq!(ended, Err(disarmed));
    assert!(after > TELEMETRY_LAG && after < 2 * TELEMETRY_LAG, "{after:?}");
}

#[test]
fn a_robot_whose_commands_stay_away_is_armed_again_three_times() {
    for (lapses, ended) in [(3, Ok(())), (4, Err(LinkError::Lapsed))] {
        let mut left = lapses;
        let (result, _) = armed(ARM_PATIENCE, |robot| {
            if left > 0 && robot.lapses.is_none() && robot.state == State::Disarmed {
                left -= 1;
                robot.lapses = Some(true);
            }
        });
        assert_eq!(result, ended, "{lapses}");
    }
}
