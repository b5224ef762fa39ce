//! The conditions of a closed-loop run, as options.

use flix_shell::number::{whole, within};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use flix_host::nav::{ModeTable, PlanarPose};
use flix_host::record::RunDescription;

use super::arguments::{ModelArgs, parse_time};
use super::error::Error;
use flix_sim::experiment::course::Conditions;
use flix_sim::experiment::walk::require_walker;
use flix_sim::rig::shipped_mode_tables::shipped_table;

/// Robot, link and seed of a closed-loop run.
#[derive(Debug, Clone, clap::Args)]
pub struct LoopArgs {
    /// Robot.
    #[command(flatten)]
    pub model: ModelArgs,
    /// Mode table, which `identify` writes and others read [default: the one shipped with W, calibrated or flix]
    #[arg(long, value_name = "FILE")]
    pub modes: Option<PathBuf>,
    /// Latency of the link, each way
    #[arg(long, value_name = "TIME", default_value = "20ms", value_parser = parse_time)]
    pub latency: Duration,
    /// Share of datagrams lost, each way, 0 to 0.9
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, value_parser = within(0.0..=0.9, "share", ""))]
    pub loss: f64,
    /// Seed of everything random
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
}

impl LoopArgs {
    /// Returns the mode table.
    pub fn table(&self) -> Result<ModeTable, Error> {
        match &self.modes {
            Some(file) => ModeTable::load(file)
                .map_err(|error| Error::usage(format!("--modes {}: {error}", file.display()))),
            None => shipped_table(&self.model.model).map_err(Error::usage),
        }
    }

    /// Returns the conditions, with the robot at `start`.
    pub fn conditions(&self, start: PlanarPose) -> Result<Conditions, Error> {
        let model = self.model.load()?;
        require_walker(&model)?;
        Ok(Conditions { model, seed: self.seed, latency: self.latency, loss: self.loss, start })
    }

    /// Returns the conditions as facts of a record.
    pub fn facts(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("model".into(), self.model.model.clone()),
            ("seed".into(), self.seed.to_string()),
            ("link_latency_ms".into(), (self.latency.as_secs_f64() * 1e3).to_string()),
            ("link_loss".into(), self.loss.to_string()),
        ])
    }
}

/// Describes a simulated run for its record.
pub fn description(name: &str, settings: BTreeMap<String, String>) -> RunDescription {
    RunDescription {
        name: name.to_owned(),
        run: BTreeMap::from([
            ("robot".into(), "simulated".into()),
            ("clock".into(), "virtual time".into()),
        ]),
        settings,
        versions: BTreeMap::from([(
            "flix-sim".into(),
            flix_host::system::program::version().into(),
        )]),
    }
}
