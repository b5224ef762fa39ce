//! `serve --foxglove`: shows the simulated robot as it moves.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use flix_host::record::{Channel, FRAMES_CHANNEL, FramesRow, MAP, Reader, Timestamp};
use flix_protocol::units::Instant;
use flix_shell::foxglove::Stream;
use flix_shell::stream::StreamArgs;
use serde::Serialize;

use flix_sim::model::RobotModel;
use flix_sim::model::links::links;
use flix_sim::model::urdf::urdf;
use flix_sim::rig::simulated::SimulatedRobot;
use flix_sim::view::FrameView;

use crate::error::Error;

/// Time between two rows.
const PERIOD: Duration = Duration::from_millis(20);

const FRAMES: usize = 0;
const DESCRIPTION: usize = 1;
const CHANNELS: [Channel; 2] = [
    FRAMES_CHANNEL,
    Channel {
        topic: "/robot_description",
        schema: "std_msgs/String",
        text: r#"{"title":"std_msgs/String","type":"object","properties":{"data":{"type":"string"}}}"#,
        holds: true,
    },
];

/// A model as programs expect it.
#[derive(Serialize)]
struct Description {
    data: String,
}

/// A robot that is shown.
pub struct Shown {
    stream: Stream,
    view: FrameView,
    start: u64,
    next: Instant,
}

impl Shown {
    /// Opens the stream, where one is asked for, and says where.
    pub fn open(args: &StreamArgs, model: &RobotModel) -> Result<Option<Self>, Error> {
        let Some(mut stream) = args.open("flix-sim", &CHANNELS)? else { return Ok(None) };
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let start = u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX);
        let description = Description { data: urdf(&model.name, &links(model)) };
        stream.row(DESCRIPTION, start, &serde_json::to_vec(&description)?);
        Ok(Some(Self { stream, view: FrameView::new(model), start, next: Instant::START }))
    }

    /// Shows how the robot stands, when that is due.
    pub fn show(&mut self, robot: &SimulatedRobot) -> Result<(), Error> {
        let now = robot.now();
        if now < self.next {
            return Ok(());
        }
        self.next = now + PERIOD;
        let nanos = self.start.saturating_add(now.as_micros().saturating_mul(1000));
        let poses = self.view.poses(MAP, robot.mechanics());
        let row = FramesRow::new(Timestamp::from_nanos(nanos), poses);
        self.stream.row(FRAMES, nanos, &serde_json::to_vec(&row)?);
        Ok(())
    }
}
