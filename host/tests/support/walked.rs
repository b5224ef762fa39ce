//! A walk as a record has it.
#![allow(dead_code, unreachable_pub, reason = "every test file uses its part")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::collections::BTreeMap;
use std::path::{Path as FilePath, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use flix_host::nav::{Path, PlanarPose, Progress};
use flix_host::pose::{Pose, PoseSample};
use flix_host::record::{Recorder, RunDescription};
use flix_protocol::message::{
    Dropped, EncoderHealth, Event, EventReport, Fault, Faults, LinkQuality, MotorTelemetry,
    OperatorName, Setpoint, State, Telemetry,
};
use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Ratio, Volts};

pub fn started() -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_795_244_400)
}

pub fn at(seconds: f64) -> Instant {
    Instant::from_micros((seconds * 1e6) as u64)
}

pub fn telemetry(seconds: f64) -> Telemetry {
    let motor = MotorTelemetry {
        angle: Degrees::saturating(10.0),
        speed: Hertz::saturating(30.0),
        current_d: Amperes::saturating(0.01),
        current_q: Amperes::saturating(0.5 + 0.1 * (seconds * 3.0).sin() as f32),
        current_q_range: [0.2, 0.8].map(Amperes::saturating),
    };
    Telemetry {
        time: at(seconds),
        state: State::Running,
        faults: Faults::NONE.with(Fault::Stall),
        first_fault: Some(Fault::Stall),
        stopped: false,
        link_late: false,
        frequency_limited: false,
        permit: Default::default(),
        halt: Default::default(),
        heard: 0,
        held_us: 0,
        withheld: None,
        stopped_by: None,
        latched_at: None,
        setpoint: forward(),
        frequency: Hertz::saturating(-29.9),
        direction: Degrees::saturating(30.2),
        direction_range: [29.0, 31.5].map(Degrees::saturating),
        motors: [motor; 2],
        encoders: [(2, 0), (0, 5)].map(|(dropped, corrected)| EncoderHealth {
            dropped,
            corrected,
            ..Default::default()
        }),
        bus_voltage: Some(Volts::saturating(11.8)),
        bus_voltage_range: Some([11.7, 11.9].map(Volts::saturating)),
        modulation: Ratio::saturating(0.7),
        timing: Default::default(),
        link: LinkQuality {
            dropped: Dropped { forged: 3, ..Default::default() },
            ..Default::default()
        },
        operator: OperatorName::OWNER,
    }
}

pub fn forward() -> Setpoint {
    Setpoint::new(Hertz::saturating(-30.0), Degrees::saturating(30.0)).unwrap()
}

pub fn sample(seconds: f64) -> PoseSample {
    let angle = seconds * 0.2;
    let pose = PlanarPose {
        x: 0.5 * angle.cos(),
        y: 0.5 * angle.sin(),
        heading: angle + std::f64::consts::FRAC_PI_2,
    };
    PoseSample { time: at(seconds), pose: Pose::planar(pose, 0.057), valid: true, picture: None }
}

/// A record of 30 s on a circle in `folder`.
pub fn write_record(folder: &FilePath) -> PathBuf {
    write_record_of(folder, 600)
}

/// A record of so many steps of 50 ms.
pub fn write_record_of(folder: &FilePath, steps: u16) -> PathBuf {
    let description = RunDescription {
        name: "track circle".into(),
        run: BTreeMap::from([("robot".into(), "walker-3f2c".into())]),
        settings: BTreeMap::from([("latency".into(), "20ms".into())]),
        versions: BTreeMap::from([("flix".into(), "0.1.0".into())]),
    };
    let mut recorder = Recorder::create(folder, started(), &description).unwrap();
    recorder.path_to_follow(at(0.0), &Path::circle(0.5).unwrap()).unwrap();
    recorder.attach(at(0.0), "modes.toml", "application/toml", b"[[mode]]").unwrap();
    for step in 0..steps {
        let seconds = f64::from(step) * 0.05;
        let sample = sample(seconds);
        recorder.pose(&sample).unwrap();
        recorder.command(at(seconds), &forward(), "forward").unwrap();
        recorder.telemetry(at(seconds), &telemetry(seconds)).unwrap();
        let progress =
            Progress { error: 0.01 * seconds.sin(), error_rms: 0.007, ..Progress::default() };
        recorder.navigation(at(seconds), &sample.pose.on_the_floor(), &progress).unwrap();
    }
    let fault = EventReport { number: 1, time: at(29.0), event: Event::Fault(Fault::Stall) };
    recorder.event(at(29.5), &fault).unwrap();
    recorder.results(BTreeMap::from([("path_error_rms_mm".into(), "7.1".into())])).unwrap();
    recorder.finish().unwrap()
}
