//! Why a command failed: with exit code 2 the command line, or a file that it names, is wrong; with 1 the run failed.

use std::fmt::Display;
use std::io;
use std::path::Path;
use std::process::ExitCode;

use flix_host::link::keys::KeyError;
use flix_host::record::{ReadError, RecordError};
use flix_plot::PlotError;
use flix_shell::Exit;
use flix_sim::experiment::probe::ProbeError;
use flix_sim::experiment::walk::WalkError;
use flix_sim::model::ModelError;
use flix_sim::plant::Diverged;
use flix_sim::rig::bench::BenchError;
use flix_sim::rig::operation::OperationError;
use flix_sim::view::RecordingError;
use flix_study::calibrate::CalibrationError;
use flix_study::measured::MeasuredError;
use flix_study::sysid::SysidError;
use flix_study::{StudyError, TableError};

/// Why a command failed: an exit code for scripts, a sentence for people.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct Error(#[from] flix_shell::Error);

impl Error {
    /// Makes an error about a wrong option, file or value.
    pub fn usage(sentence: impl Display) -> Self {
        Self(flix_shell::Error::usage(sentence))
    }

    /// Makes the error of a file that cannot be written.
    pub(crate) fn write(path: &Path) -> impl Fn(io::Error) -> Self {
        move |error| Self::usage(format_args!("cannot write {}: {error}", path.display()))
    }

    /// Makes the error of a network that failed while the robot was served.
    pub(crate) fn network(error: io::Error) -> Self {
        Self(flix_shell::Error::new(Exit::Failed, format_args!("the network failed: {error}")))
    }

    /// Returns the exit code.
    pub(crate) fn exit(&self) -> ExitCode {
        self.0.exit.into()
    }
}

/// Gives every error its exit code: errors of the pattern are failures of the run, all others are wrong usage.
macro_rules! failures {
    ($($kind:ty $(: $failure:pat)?,)*) => {
        $(impl From<$kind> for Error {
            fn from(error: $kind) -> Self {
                let has_failed = [$(matches!(&error, $failure))?].contains(&true);
                let exit = if has_failed { Exit::Failed } else { Exit::Usage };
                Self(flix_shell::Error::new(exit, error))
            }
        })*
    };
}

failures! {
    BenchError: _,
    CalibrationError: CalibrationError::Keep { .. } | CalibrationError::Interrupted(_),
    Diverged: _,
    KeyError,
    MeasuredError,
    ModelError,
    OperationError: _,
    PlotError: PlotError::Rasterise(_),
    ProbeError: ProbeError::Diverged(_) | ProbeError::Singular { .. },
    ReadError,
    RecordError,
    RecordingError: RecordingError::Empty | RecordingError::Mismatch { .. } | RecordingError::Encode(_),
    StudyError: StudyError::Table(TableError::Parquet { .. }) | StudyError::Interrupted { .. },
    SysidError: SysidError::Model(_) | SysidError::Probe(_),
    TableError,
    WalkError: WalkError::Diverged(_) | WalkError::Setpoint(_) | WalkError::Operation(_),
    serde_json::Error: _,
}
