//! Why a command failed.

use std::io;
use std::net::SocketAddr;

use flix_protocol::message::OperatorName;
use flix_protocol::session::AddError;

/// Why a command failed: one sentence for people.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A simulated robot could not be brought to run.
    #[error(transparent)]
    Bench(#[from] flix_sim::rig::bench::BenchError),
    /// The simulation did not go on.
    #[error(transparent)]
    Operation(#[from] flix_sim::rig::operation::OperationError),
    /// A model is damaged.
    #[error(transparent)]
    Model(#[from] flix_sim::model::ModelError),
    /// A figure was not drawn.
    #[error(transparent)]
    Plot(#[from] flix_plot::PlotError),
    /// A key could not be made or read.
    #[error(transparent)]
    Key(#[from] flix_host::link::keys::KeyError),
    /// The robot cannot be on the network.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// f or theta cannot be asked for.
    #[error("{0}; the robot takes -35 to 35 Hz and -90 to 90 degrees")]
    Setpoint(#[from] flix_protocol::units::OutOfRange),
    /// The robot did not walk.
    #[error(transparent)]
    Walk(#[from] flix_sim::experiment::walk::WalkError),
    /// The mechanics gave no answer.
    #[error(transparent)]
    Probe(#[from] flix_sim::experiment::probe::ProbeError),
    /// A replay was not written.
    #[error(transparent)]
    Recording(#[from] flix_sim::view::RecordingError),
    /// A file was not written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// Names the folder or file.
        path: std::path::PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// JSON was not written.
    #[error("cannot write JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// What was asked for cannot be done, or did not come about.
    #[error("{0}")]
    Refused(String),
    /// As the host's programs say it.
    #[error(transparent)]
    Host(#[from] flix_shell::Error),
    /// A study did not end.
    #[error(transparent)]
    Study(#[from] flix_study::StudyError),
    /// A table of a study was not read, written or merged.
    #[error(transparent)]
    Table(#[from] flix_study::TableError),
    /// A calibration did not end.
    #[error(transparent)]
    Calibration(#[from] flix_study::calibrate::CalibrationError),
    /// A laboratory's table is refused.
    #[error(transparent)]
    Measured(#[from] flix_study::measured::MeasuredError),
    /// A robot was not identified.
    #[error(transparent)]
    Sysid(#[from] flix_study::sysid::SysidError),
    /// The record was not written.
    #[error(transparent)]
    Record(#[from] flix_host::record::RecordError),
    /// The record could not be read back.
    #[error(transparent)]
    Read(#[from] flix_host::record::ReadError),
}

impl Error {
    /// Creates a refusal from something that has its own words.
    pub fn refused(sentence: impl std::fmt::Display) -> Self {
        Self::Refused(sentence.to_string())
    }

    /// Returns whether the command line, or a file that it names, is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        use flix_sim::experiment::probe::ProbeError;
        use flix_sim::experiment::walk::WalkError;
        use flix_study::calibrate::CalibrationError;
        use flix_study::sysid::SysidError;
        use flix_study::{StudyError, TableError};
        matches!(
            self,
            Self::Setpoint(_)
                | Self::Host(_)
                | Self::Refused(_)
                | Self::Model(_)
                | Self::Measured(_)
                | Self::Calibration(CalibrationError::NoLegs(_) | CalibrationError::Other { .. })
                | Self::Sysid(
                    SysidError::Measured(_)
                        | SysidError::Plan(_)
                        | SysidError::NoFolder(_)
                        | SysidError::Empty(_)
                        | SysidError::Write { .. }
                )
                | Self::Study(StudyError::Journal(_) | StudyError::Table(TableError::File { .. }),)
                | Self::Table(_)
                | Self::Key(_)
                | Self::Serve(
                    ServeError::Listen { .. }
                        | ServeError::Operators { .. }
                        | ServeError::OneKey { .. }
                )
                | Self::Write { .. }
                | Self::Record(_)
                | Self::Read(_)
                | Self::Plot(flix_plot::PlotError::Write { .. })
                | Self::Recording(flix_sim::view::RecordingError::Write { .. })
                | Self::Probe(
                    ProbeError::Model(_)
                        | ProbeError::Setpoint(_)
                        | ProbeError::NoLegs { .. }
                        | ProbeError::Overloaded
                        | ProbeError::Still
                )
                | Self::Walk(WalkError::Model(_))
        )
    }
}

impl From<flix_sim::plant::Diverged> for Error {
    fn from(error: flix_sim::plant::Diverged) -> Self {
        Self::Operation(error.into())
    }
}

/// The robot cannot be on the network.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address cannot be had.
    #[error("{option} {address}: cannot listen there: {source}; {advice}", advice = advice(source, option))]
    Listen {
        /// The option that gives it.
        option: &'static str,
        /// Gives the address.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// The operators cannot be those of one robot.
    #[error("--operator {name}: {source}")]
    Operators {
        /// The operator.
        name: OperatorName,
        /// Why.
        source: AddError,
    },
    /// Two operators have one key.
    #[error(
        "--operator {name}: the key of this file is that of {known}; make one with `flix keygen FILE`"
    )]
    OneKey {
        /// The operator.
        name: OperatorName,
        /// Whose key it is.
        known: OperatorName,
    },
    /// The network failed later.
    #[error("the network failed: {0}")]
    Network(#[from] io::Error),
}

/// Returns what to do about an address that cannot be had.
fn advice(source: &io::Error, option: &str) -> String {
    match source.kind() {
        io::ErrorKind::AddrInUse => {
            format!(
                "another program listens there, perhaps a robot: give another port with {option}"
            )
        }
        io::ErrorKind::AddrNotAvailable => {
            format!(
                "it is no address of this computer: give one that is with {option}, or 0.0.0.0 for all"
            )
        }
        io::ErrorKind::PermissionDenied => {
            format!("ports below 1024 are for the system: give a higher one with {option}")
        }
        _ => format!("give another with {option}"),
    }
}
