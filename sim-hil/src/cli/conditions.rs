//! The conditions of a closed-loop run, as options.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use flix_host::nav::{ModeTable, PlanarPose};
use flix_host::record::RunDescription;

use super::Error;
use crate::experiment::course::{Conditions, shipped_table};
use crate::model::RobotModel;

/// Robot, link and chance.
#[derive(Debug, Clone, clap::Args)]
pub struct LoopArgs {
    /// The robot: A, W, calibrated, or a file.
    #[arg(long, value_name = "MODEL", default_value = "W")]
    pub model: String,
    /// Its mode table, which `identify` writes and others read; the one shipped with W or calibrated unless told.
    #[arg(long, value_name = "FILE")]
    pub modes: Option<PathBuf>,
    /// Of the link, each way.
    #[arg(long, value_name = "TIME", default_value = "20ms", value_parser = duration)]
    pub latency: Duration,
    /// Share of datagrams lost, each way, 0 to 0.9.
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, value_parser = share)]
    pub loss: f64,
    /// All chance comes from here.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Reads `20ms`, `5s`, `10m`.
///
/// # Errors
/// When it is no time, or longer than a day.
pub fn duration(text: &str) -> Result<Duration, String> {
    let time =
        humantime::parse_duration(text).map_err(|e| format!("{e}; write 20ms, 5s or 10m"))?;
    if time <= Duration::from_secs(86_400) { Ok(time) } else { Err("more than a day".into()) }
}

fn share(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|share| (0.0..=0.9).contains(share))
        .ok_or_else(|| format!("\"{text}\" is not a share from 0 to 0.9"))
}

impl LoopArgs {
    /// The mode table.
    ///
    /// # Errors
    /// When there is none for this model, or the file is no table.
    pub fn table(&self) -> Result<ModeTable, Error> {
        match &self.modes {
            Some(file) => ModeTable::load(file).map_err(Error::refused),
            None => shipped_table(&self.model).map_err(Error::refused),
        }
    }

    /// The conditions, with the robot at `start`.
    ///
    /// # Errors
    /// When the model is refused.
    pub fn conditions(&self, start: PlanarPose) -> Result<Conditions, Error> {
        Ok(Conditions {
            model: RobotModel::named(&self.model)?,
            seed: self.seed,
            latency: self.latency,
            loss: self.loss,
            start,
        })
    }

    /// The conditions as facts of a record.
    #[must_use]
    pub fn facts(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("model".into(), self.model.clone()),
            ("seed".into(), self.seed.to_string()),
            ("link_latency_ms".into(), (self.latency.as_secs_f64() * 1e3).to_string()),
            ("link_loss".into(), self.loss.to_string()),
        ])
    }
}

/// What the record of a simulated run says about it.
#[must_use]
pub fn description(name: &str, settings: BTreeMap<String, String>) -> RunDescription {
    RunDescription {
        name: name.to_owned(),
        run: BTreeMap::from([
            ("robot".into(), "simulated".into()),
            ("clock".into(), "virtual time".into()),
        ]),
        settings,
        versions: BTreeMap::from([("flix-sim".into(), env!("CARGO_PKG_VERSION").into())]),
    }
}
