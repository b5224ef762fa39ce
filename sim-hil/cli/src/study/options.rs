//! Options that studies share, and what becomes of their tables.

use std::path::{Path, PathBuf};
use std::time::Duration;

use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::MAXIMUM_FREQUENCY;
use flix_shell::number::{whole, within};

use crate::arguments::{PaperModelArgs, parse_step, parse_time};
use crate::error::Error;
use crate::output::{complain, print};
use flix_sim::experiment::walk::{Shaking, WalkDrive, require_walker};
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::{DIRECTIONS, FREQUENCIES};
use flix_sim::study::{Shard, Study, Table};
use flix_study::sweep::{Sweep, Variant, grid_of};
use flix_study::{Earlier, Options, figure};

/// Returns the rows of a study's table that can be judged, and says which simulations failed.
pub(super) fn judged(table: &Table) -> Result<Table, Error> {
    let (succeeded, failures) = table.succeeded();
    let Some(first) = failures.first() else { return Ok(succeeded) };
    let (failed, all) = (failures.len(), table.rows.len());
    if failed == all {
        return Err(Error::usage(format!("all {all} simulations failed, the first: {first}")));
    }
    complain(format!(
        "{failed} of {all} simulations failed and are left out of figures and verdicts; the table says why in its column failure. \
         The first: {first}"
    ));
    Ok(succeeded)
}

/// Draws the figures of a table and prints where everything is.
pub(super) fn show(table: &Table, folder: &Path) -> Result<(), Error> {
    print(&format!("{} rows  {}\n", table.rows.len(), folder.join("results.parquet").display()))?;
    for written in figure::draw(table, folder)? {
        print(&format!("figure  {}\n", written.png.display()))?;
    }
    Ok(())
}

/// Digits of the fingerprint in the name of a folder.
const FOLDER_HASH: usize = 8;

/// Where a study is kept, and which part of it is computed.
#[derive(Debug, Clone, clap::Args)]
pub struct RunArgs {
    /// Compute this slice of the cells only; `flix-sim study merge` joins slices
    #[arg(long, value_name = "I/N", default_value_t = Shard::WHOLE)]
    pub shard: Shard,
    /// Folder for cells, table and figure [default: one for each command and its parameters, under out]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Take all results that an earlier run of this program left there, not those of an interrupted run alone
    #[arg(long)]
    pub resume: bool,
    /// Forget what an earlier run left there
    #[arg(long, conflicts_with = "resume")]
    pub restart: bool,
    /// Take all results that an earlier run left there, of another build of this program too
    #[arg(long, conflicts_with_all = ["resume", "restart"])]
    pub another_build: bool,
}

impl RunArgs {
    /// Returns where this study is kept, by default below `root`.
    pub fn folder_below(&self, root: &Path, study: &dyn Study) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            // The hash distinguishes what the label does not.
            let hash = flix_study::fingerprint(study);
            let label = study.label().replace(|c: char| !c.is_alphanumeric() && c != '.', "-");
            root.join(format!("{label}-{}", &hash.parameters()[..FOLDER_HASH]))
        })
    }

    /// Returns where a study of the paper's is kept.
    pub fn folder(&self, study: &dyn Study) -> PathBuf {
        self.folder_below(&Path::new("out/study").join(study.name()), study)
    }

    /// Computes what is missing of the slice.
    pub fn compute(&self, study: &dyn Study, folder: &Path) -> Result<Table, Error> {
        let options = Options {
            folder: folder.to_owned(),
            shard: self.shard,
            earlier: match (self.resume, self.restart) {
                (true, _) => Earlier::All,
                (_, true) => Earlier::Forget,
                _ if self.another_build => Earlier::OfAnyBuild,
                _ => Earlier::Unfinished,
            },
            interrupt: listen()?,
        };
        Ok(flix_study::run(study, &options)?)
    }

    /// Returns a line that says where a slice is, and what is next; empty where it is the whole.
    pub(crate) fn next(&self, study: &dyn Study, folder: &Path) -> String {
        if self.shard == Shard::WHOLE {
            return String::new();
        }
        let (name, folder) = (study.name(), folder.display());
        format!(
            "slice {} of {name} is in {folder}; when all are there: flix-sim study merge {folder}/results-*.parquet\n",
            self.shard
        )
    }

    /// Computes what is missing of the slice. None, after saying what is next, when that is not the whole.
    pub fn run(&self, study: &dyn Study) -> Result<Option<Table>, Error> {
        let folder = self.folder(study);
        let table = self.compute(study, &folder)?;
        if self.shard == Shard::WHOLE {
            return judged(&table).map(Some);
        }
        print(&self.next(study, &folder))?;
        Ok(None)
    }
}

/// Listens for Ctrl-C.
pub fn listen() -> Result<Interrupt, Error> {
    Interrupt::listen().map_err(|error| Error::usage(format!("cannot listen to Ctrl-C: {error}")))
}

/// How the robot is walked in a study.
#[derive(Debug, Clone, clap::Args)]
pub struct SweepArgs {
    /// Robot.
    #[command(flatten)]
    pub model: PaperModelArgs,
    /// Walks of each pair, each with its start disturbed by up to 1 mm
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = whole::<u64>(1..=100_000))]
    pub seeds: u64,
    /// The first seed
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// Time of a walk
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = parse_time)]
    pub seconds: Duration,
    /// What turns the rotors
    #[arg(long, value_enum, default_value_t = WalkDrive::Ideal)]
    pub drive: WalkDrive,
    /// Step of the ideal drive; the firmware's is its own 0.1 ms
    #[arg(long, value_name = "TIME", default_value = "0.1ms", value_parser = parse_step)]
    pub step: Duration,
    /// Scatter every number of the model by this share, anew for each seed, for example 0.02
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = within(0.0..=0.2, "share", ""))]
    pub scatter: f64,
    /// Frequencies of the grid, Hz, -120 to 120; above 35 with the ideal drive [default: -35,-30,-20,-10,10,20,30,35]
    #[arg(long, value_name = "HZ", value_delimiter = ',', allow_hyphen_values = true, value_parser = within(-Shaking::FASTEST_HZ..=Shaking::FASTEST_HZ, "frequency", " Hz"))]
    pub frequencies: Vec<f64>,
    /// Directions of the grid, degrees, -90 to 90 [default: -90,-60,-30,0,30,60,90]
    #[arg(long, value_name = "DEG", value_delimiter = ',', allow_hyphen_values = true, value_parser = within(-90.0..=90.0, "direction", " degrees"))]
    pub directions: Vec<f64>,
    /// Read f and theta as the paper's equations state them (left, counter-clockwise), not its text
    #[arg(long)]
    pub mirrored: bool,
    /// Take a first look: one short, coarse walk of each pair
    #[arg(long)]
    pub quick: bool,
    /// Folder and slice.
    #[command(flatten)]
    pub run: RunArgs,
}

impl SweepArgs {
    /// Returns the model, which has to walk as the options ask.
    pub fn model(&self) -> Result<RobotModel, Error> {
        let model = self.model.load()?;
        require_walker(&model)?;
        let fastest = f64::from(MAXIMUM_FREQUENCY.get());
        let too_fast = self.frequencies.iter().find(|f| f.abs() > fastest);
        if let Some(f) = too_fast.filter(|_| self.drive == WalkDrive::Firmware) {
            return Err(Error::usage(format!(
                "--frequencies {f}: the firmware shakes at up to {fastest} Hz; take --drive ideal"
            )));
        }
        Ok(model)
    }

    /// Returns the pairs of the grid.
    pub fn grid(&self) -> Vec<(f64, f64)> {
        let or = |given: &[f64], usual: &[f64]| {
            if given.is_empty() { usual.to_vec() } else { given.to_vec() }
        };
        grid_of(&or(&self.frequencies, &FREQUENCIES), &or(&self.directions, &DIRECTIONS))
    }

    /// Returns the walks of these variants.
    pub fn sweep(
        &self,
        name: &'static str,
        variants: Vec<Variant>,
        pairs: Vec<(f64, f64)>,
    ) -> Sweep {
        let sweep = Sweep {
            name,
            variants,
            pairs,
            seeds: self.seeds,
            first_seed: self.first_seed,
            seconds: self.seconds.as_secs_f64(),
            step: self.step.as_secs_f64(),
            drive: self.drive,
            scatter: self.scatter,
            mirrored: self.mirrored,
        };
        if self.quick { Sweep { seeds: 1, seconds: 0.5, step: 5e-4, ..sweep } } else { sweep }
    }
}
