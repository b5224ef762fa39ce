//! `serve --foxglove`: shows the simulated robot as it moves.

#[cfg(feature = "live")]
pub use with::LiveArgs;
#[cfg(not(feature = "live"))]
pub use without::LiveArgs;

#[cfg(feature = "live")]
mod with {
    use std::net::SocketAddr;
    use std::time::{Duration, SystemTime, UNIX_EPOCH};

    use flix_host::cli::stream::{address, introduce};
    use flix_host::record::stream::{PORT, Stream};
    use flix_host::record::{Channel, FRAMES_CHANNEL, FramesRow, Reader, Timestamp, WORLD};
    use flix_protocol::units::Instant;
    use serde::Serialize;

    use crate::cli::Error;
    use crate::model::RobotModel;
    use crate::model::links::links;
    use crate::model::urdf::urdf;
    use crate::plant::Plant;
    use crate::rig::robot::SimulatedRobot;
    use crate::view::FrameView;

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

    /// Options of a live stream.
    #[derive(Debug, Clone, clap::Args)]
    pub struct LiveArgs {
        /// Stream how the robot stands, for Foxglove or Lichtblick on this computer; =0.0.0.0 for others in this
        /// network, too, =127.0.0.1:8766 for another port than 8765
        #[arg(
            long,
            value_name = "ADDRESS[:PORT]",
            num_args = 0..=1,
            require_equals = true,
            default_missing_value = "127.0.0.1",
            value_parser = |text: &str| address(text, PORT),
        )]
        foxglove: Option<SocketAddr>,
    }

    impl LiveArgs {
        /// Opens the stream, where one is asked for, and says where.
        ///
        /// # Errors
        /// When the address cannot be had.
        pub fn open(&self, model: &RobotModel) -> Result<Option<Shown>, Error> {
            let Some(address) = self.foxglove else { return Ok(None) };
            let mut stream = Stream::open(address, "flix-sim", &CHANNELS)
                .map_err(flix_host::cli::Error::usage)?;
            introduce("flix-sim", address.ip(), &stream);
            let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            let start = u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX);
            let description = Description { data: urdf(&model.name, &links(model)) };
            stream.row(DESCRIPTION, start, &serde_json::to_vec(&description)?);
            Ok(Some(Shown { stream, view: FrameView::new(model), start, next: Instant::START }))
        }
    }

    /// A robot that is shown.
    pub struct Shown {
        stream: Stream,
        view: FrameView,
        start: u64,
        next: Instant,
    }

    impl Shown {
        /// Shows how the robot stands, when that is due.
        ///
        /// # Errors
        /// When a number has no JSON form.
        pub fn show(&mut self, robot: &SimulatedRobot<Plant>) -> Result<(), Error> {
            let now = robot.now();
            if now < self.next {
                return Ok(());
            }
            self.next = now + PERIOD;
            let nanos = self.start.saturating_add(now.as_micros().saturating_mul(1000));
            let poses = self.view.poses(WORLD, robot.mechanics());
            let row = FramesRow::new(Timestamp::from_nanos(nanos), poses);
            self.stream.row(FRAMES, nanos, &serde_json::to_vec(&row)?);
            Ok(())
        }
    }
}

#[cfg(not(feature = "live"))]
mod without {
    use crate::cli::Error;
    use crate::model::RobotModel;
    use crate::plant::Plant;
    use crate::rig::robot::SimulatedRobot;

    /// Options of a live stream, which this program was built without.
    #[derive(Debug, Clone, clap::Args)]
    pub struct LiveArgs {}

    impl LiveArgs {
        /// Opens nothing.
        ///
        /// # Errors
        /// Never.
        pub fn open(&self, _: &RobotModel) -> Result<Option<Shown>, Error> {
            Ok(None)
        }
    }

    /// A robot that is shown: never.
    pub enum Shown {}

    impl Shown {
        /// Shows nothing.
        ///
        /// # Errors
        /// Never.
        pub fn show(&mut self, _: &SimulatedRobot<Plant>) -> Result<(), Error> {
            Ok(())
        }
    }
}
