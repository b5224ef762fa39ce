//! What a visitor does to the robot in the page, natively.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::f64::consts::TAU;
use std::time::Duration;

use flix_web::{Options, World};
use serde_json::{Value, json};

/// Runs for so many seconds with a page that shows everything at once.
fn run(world: &mut World, seconds: f64) {
    let end = world.now() + Duration::from_secs_f64(seconds);
    while world.now() < end {
        say(world, json!({}));
        world.advance(world.now() + Duration::from_millis(20), |_| {}).unwrap();
    }
}

/// Says something with the newest stamp.
fn say(world: &mut World, mut line: Value) {
    line["seen"] = (world.now().as_micros() / 1000).into();
    world.say(&line.to_string()).unwrap();
}

fn armed() -> World {
    let mut world = World::new(&Options::default()).unwrap();
    run(&mut world, 0.5);
    say(&mut world, json!({ "do": "arm" }));
    run(&mut world, 1.0);
    world
}

fn circle() -> String {
    let points: Vec<[f64; 2]> = (0..40)
        .map(|i| TAU * f64::from(i) / 40.0)
        .map(|angle| [0.3 * angle.sin(), 0.3 - 0.3 * angle.cos()])
        .collect();
    json!({ "follow": points }).to_string()
}

#[test]
fn a_drawn_path_is_followed_within_30_mm() {
    let mut world = armed();
    world.say(&circle()).unwrap();
    run(&mut world, 20.0);
    let error = world.snapshot()["world"]["error_rms"].as_f64().unwrap();
    assert!(error < 0.03, "{error} m");
}

#[test]
fn stop_ends_a_drawn_path() {
    let mut world = armed();
    world.say(&circle()).unwrap();
    run(&mut world, 2.0);
    say(&mut world, json!({ "do": "stop" }));
    run(&mut world, 1.0);
    let shown = world.snapshot();
    assert_eq!(
        (&shown["world"]["tracks"], &shown["telemetry"]["stopped"]),
        (&json!(false), &json!(true))
    );
    assert!(world.truth().is_slower_than(0.5));
}

#[test]
fn a_path_is_refused_before_the_robot_is_armed() {
    let mut world = World::new(&Options::default()).unwrap();
    assert!(world.say(&circle()).unwrap_err().to_string().contains("not armed"));
}

#[test]
fn a_hand_drags_the_robot_to_where_it_points() {
    let mut world = World::new(&Options::default()).unwrap();
    world.say(r#"{"pull":[0.2,0.1]}"#).unwrap();
    run(&mut world, 3.0);
    let [x, y, _] = world.plant().body().position;
    assert!((x - 0.2).hypot(y - 0.1) < 0.05, "{x} {y}");
}
