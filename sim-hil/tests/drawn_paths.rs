//! Closed paths as people draw them, by seed: stars, rectangles with spurs, hypocycloids with cusps, lanes to and fro, and polygons that
//! cross themselves. Some touch themselves, and all have corners. Four are walked
//! by the test `walks`, thirty by `statistics`.

use std::f64::consts::{PI, TAU};
use std::time::Duration;

use flix_host::nav::{Navigator, Path, Position, Progress, Settings, Task};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::RobotModel;
use flix_sim::rig::shipped_mode_tables::shipped_table;

const LATENCY: Duration = Duration::from_millis(20);
/// A robot that makes less way than this along its path, m/s, has not walked it.
const SLOWEST: f64 = 0.03;

/// Returns a path of 1 to 7 m.
fn drawn(seed: u64) -> Path {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(1);
    let mut draw = |low: f64, high: f64| {
        // Knuth's linear congruential generator (MMIX).
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    draw(0.0, 1.0);
    let corners: Vec<[f64; 2]> = match seed % 5 {
        0 => {
            let rays = draw(5.0, 9.0) as u32;
            let corner = |index: u32| {
                let [low, high] = if index.is_multiple_of(2) { [0.3, 0.5] } else { [0.12, 0.25] };
                let (sin, cos) = (PI * f64::from(index) / f64::from(rays)).sin_cos();
                let radius = draw(low, high);
                [radius * cos, radius * sin]
            };
            (0..2 * rays).map(corner).collect()
        }
        1 => {
            let (width, height) = (draw(0.4, 0.8), draw(0.3, 0.6));
            let (at, length) = (width * draw(0.2, 0.8), draw(0.1, 0.4));
            let tip = if draw(-1.0, 1.0) > 0.0 { -length } else { length };
            let (side, out) = (height * draw(0.2, 0.8), -draw(0.1, 0.3));
            vec![
                [0.0, 0.0],
                [at, 0.0],
                [at, tip],
                [at, 0.0],
                [width, 0.0],
                [width, height],
                [0.0, height],
                [0.0, side],
                [out, side],
                [0.0, side],
            ]
        }
        2 => {
            let cusps = f64::from(draw(3.0, 6.0) as u32);
            let scale = draw(0.3, 0.5) / cusps;
            let corner = |index: u32| {
                let ((sin, cos), (sines, cosines)) = {
                    let angle = TAU * f64::from(index) / 240.0;
                    (angle.sin_cos(), ((cusps - 1.0) * angle).sin_cos())
                };
                [(cusps - 1.0) * cos + cosines, (cusps - 1.0) * sin - sines].map(|it| scale * it)
            };
            (0..240).map(corner).collect()
        }
        3 => {
            let lanes = 2 * draw(2.0, 5.0) as u32;
            let (gap, length) = (draw(0.06, 0.15), draw(0.4, 0.8));
            let lane = |index: u32| {
                let y = gap * f64::from(index);
                let ends = if index.is_multiple_of(2) { [0.0, length] } else { [length, 0.0] };
                ends.map(|x| [x, y])
            };
            (0..lanes).flat_map(lane).collect()
        }
        _ => {
            let corners = draw(5.0, 10.0) as u32;
            (0..corners).map(|_| [draw(-0.5, 0.5), draw(-0.5, 0.5)]).collect()
        }
    };
    let corners: Vec<Position> = corners.into_iter().map(|[x, y]| Position::new(x, y)).collect();
    Path::through("drawn", &corners, true).unwrap()
}

/// Walks one lap of the path of this seed. Returns how that went, and how long the path is, m.
fn walked(seed: u64) -> (Ending, Progress, f64) {
    let path = drawn(seed);
    let (length, start) = (path.length(), path.start());
    let task = Task::Follow { path, laps: 1 };
    let table = shipped_table("W").unwrap();
    let settings = Settings { latency: LATENCY, ..Settings::for_task(&task) };
    let navigator = Navigator::new(task, &table, settings).unwrap();
    let model = RobotModel::named("W").unwrap();
    let conditions = Conditions { model, seed, latency: LATENCY, loss: 0.05, start };
    let mut course = Course::new(&conditions, Pilot::new(navigator, names(&table), None)).unwrap();
    let longest = 20.0 + length / SLOWEST;
    loop {
        if let Some(ending) = course.step().unwrap() {
            return (ending, course.pilot().helm().progress(), length);
        }
        let seconds = course.now().as_micros() as f64 * 1e-6;
        assert!(seconds < longest, "path {seed}: {:?}", course.pilot().helm().progress());
    }
}

/// Asserts that the path of this seed is walked once round: within 30 mm RMS, and all of it.
pub fn assert_walked(seed: u64) {
    let (ending, progress, length) = walked(seed);
    let is_walked = ending == Ending::Finished && progress.laps >= 0.95;
    assert!(
        is_walked && progress.error_rms < 0.03,
        "path {seed} of {length:.2} m: {ending}, {progress:?}"
    );
}
