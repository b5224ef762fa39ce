//! Images with one defect each: every one has to be caught on the emulated chip.
//!
//! Copies of the firmware, one for each processor, are edited and built in folders of their own, so that no image with a defect
//! lies where images are flashed from, and nothing but the firmware is built again. They are linked without optimization across
//! packages, in a tenth of the time. What that costs the fast loop is made up for by the compiler's highest level: at the level
//! of the real image its duties would be set 54 to 75 us after the tick, at the very end of the 25 to 75 us that one PWM period
//! takes over, where the real image needs 35 to 47 us. The image without a defect, built likewise, has to pass.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::other;
use crate::chip::{Chip, Options};
use crate::run::{self, Error, root};
use crate::toolchain;

#[derive(Deserialize)]
struct List {
    defect: Vec<Defect>,
}

/// A defect, and the part of the emulator's run that shall catch it.
#[derive(Deserialize)]
struct Defect {
    name: String,
    part: String,
    edit: Vec<Edit>,
}

/// Text that is replaced wherever it stands in a file below `firmware/src`.
#[derive(Deserialize)]
struct Edit {
    file: PathBuf,
    from: String,
    to: String,
}

impl List {
    fn read() -> Result<Self, Error> {
        let path = root().join("sim-hil/chip/defects.toml");
        let text = String::from_utf8_lossy(&run::read(&path)?).into_owned();
        toml::from_str(&text)
            .map_err(|error| Error::Sentence(format!("{}: {error}", path.display())))
    }
}

impl Edit {
    /// Returns the file's text with the edit made.
    fn make(&self, text: &str) -> Result<String, Error> {
        let (from, file) = (&self.from, self.file.display());
        let lacks = || Error::Sentence(format!("{file} has no {from:?} to be edited"));
        text.contains(from).then(|| text.replace(from, &self.to)).ok_or_else(lacks)
    }
}

/// What the emulator prints.
#[derive(Deserialize)]
struct Verdict {
    failures: Vec<String>,
    pass: bool,
}

#[derive(Serialize)]
struct Outcome {
    name: String,
    /// The first failure; none where the defect passes.
    caught_by: Option<String>,
}

#[derive(Serialize)]
struct Counts {
    tried: usize,
    caught: usize,
}

#[derive(Serialize)]
struct Summary {
    defects: Counts,
    outcomes: Vec<Outcome>,
    pass: bool,
}

/// Tries those defects whose names contain one of these, all without any, by this emulator; an error when one is not caught.
pub(super) fn run(program: &Path, named: &[String], is_json: bool) -> Result<(), Error> {
    let list = List::read()?;
    let is_wanted =
        |defect: &Defect| named.is_empty() || named.iter().any(|part| defect.name.contains(part));
    let defects: Vec<Defect> = list.defect.into_iter().filter(is_wanted).collect();
    if defects.is_empty() {
        return Err(Error::Sentence(format!("no defect is named {named:?}")));
    }
    let copies = Copy::all()?;
    let parts: BTreeSet<String> = defects.iter().map(|defect| defect.part.clone()).collect();
    let sound: Vec<Trial> = parts
        .into_iter()
        .map(|part| Trial { name: "without a defect".into(), part, edits: Vec::new() })
        .collect();
    if let Some(Outcome { caught_by: Some(failure), .. }) =
        try_all(&copies, program, sound).into_iter().find(|outcome| outcome.caught_by.is_some())
    {
        return Err(Error::Sentence(format!("without a defect: {failure}")));
    }
    let trials = defects
        .into_iter()
        .map(|Defect { name, part, edit }| Trial { name, part, edits: edit })
        .collect();
    let outcomes = try_all(&copies, program, trials);
    let caught = outcomes.iter().filter(|outcome| outcome.caught_by.is_some()).count();
    let tried = outcomes.len();
    let pass = caught == tried;
    let summary = Summary { defects: Counts { tried, caught }, outcomes, pass };
    if is_json {
        println!("{}", serde_json::to_string(&summary).unwrap_or_default());
    } else {
        println!("{caught} of {tried} defects caught");
    }
    match pass {
        true => Ok(()),
        false => Err(Error::Sentence(format!("{} defects are not caught", tried - caught))),
    }
}

/// An image to be built, and the part that runs it.
struct Trial {
    name: String,
    part: String,
    edits: Vec<Edit>,
}

/// Builds and runs images, one after the other in each copy.
fn try_all(copies: &[Copy], program: &Path, trials: Vec<Trial>) -> Vec<Outcome> {
    let trials = Mutex::new(trials.into_iter().enumerate());
    let next = || trials.lock().unwrap_or_else(PoisonError::into_inner).next();
    let try_in = |copy: &Copy| {
        let mut outcomes = Vec::new();
        while let Some((number, Trial { name, part, edits })) = next() {
            let found = copy
                .with(&edits, || copy.build(&part))
                .and_then(|image| first_failure(program, &image, &part));
            let caught_by = match found {
                Ok(caught_by) => caught_by,
                // What does not build, or what the emulator does not understand, is not caught.
                Err(error) => {
                    eprintln!("{name}: {error}");
                    None
                }
            };
            match (&caught_by, edits.is_empty()) {
                (None, true) => eprintln!("{name} ({part}): pass"),
                (None, false) => eprintln!("{name}: NOT CAUGHT"),
                (Some(failure), _) => eprintln!("{name}: {failure}"),
            }
            outcomes.push((number, Outcome { name, caught_by }));
        }
        outcomes
    };
    let mut outcomes = std::thread::scope(|scope| {
        let workers: Vec<_> = copies.iter().map(|copy| scope.spawn(move || try_in(copy))).collect();
        let ended = workers.into_iter().filter_map(|worker| worker.join().ok());
        ended.flatten().collect::<Vec<_>>()
    });
    outcomes.sort_by_key(|(number, _)| *number);
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

/// What the emulator finds first in a part of its short run; `None` when the image passes.
fn first_failure(program: &Path, image: &Path, part: &str) -> Result<Option<String>, Error> {
    let mut command = run::command(program);
    command.arg(image);
    if part == other::PART {
        command.arg("--other").arg(image);
    }
    let output = command
        .args(["--quick", "--until-failure", "--json", "--part", part])
        .stderr(std::process::Stdio::inherit())
        .output()
        .map_err(|source| Error::Missing { program: "flix-chip".into(), source })?;
    let verdict: Verdict = serde_json::from_slice(&output.stdout)
        .map_err(|error| Error::Sentence(format!("the emulator says nothing: {error}")))?;
    let unsaid = || "it fails without a sentence".to_owned();
    Ok((!verdict.pass).then(|| verdict.failures.into_iter().next().unwrap_or_else(unsaid)))
}

/// The folders of the workspace's packages.
const PACKAGES: [&str; 4] = ["protocol", "firmware", "host", "sim-hil"];

/// Most copies: each builds the firmware's dependencies once.
const COPIES: usize = 4;

/// A copy of the workspace.
struct Copy {
    source: PathBuf,
    target: PathBuf,
}

impl Copy {
    /// Returns one for each processor.
    fn all() -> Result<Vec<Self>, Error> {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        (0..processors.min(COPIES)).map(Self::new).collect()
    }

    fn new(number: usize) -> Result<Self, Error> {
        let folder = root().join(run::target_directory()).join("defects").join(number.to_string());
        let copy = Self { source: folder.join("source"), target: folder.join("target") };
        let file = |path: &Path, source| Error::File { path: path.to_path_buf(), source };
        match std::fs::remove_dir_all(&copy.source) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(file(&copy.source, source));
            }
            _ => {}
        }
        std::fs::create_dir_all(&copy.source).map_err(|source| file(&copy.source, source))?;
        for name in ["Cargo.toml", "Cargo.lock"].into_iter().chain(PACKAGES) {
            copy_tree(&root().join(name), &copy.source.join(name))
                .map_err(|source| file(&root().join(name), source))?;
        }
        Ok(copy)
    }

    /// Builds the image that a part runs.
    fn build(&self, part: &str) -> Result<PathBuf, Error> {
        let options = if part == other::PART { other::options() } else { Options::default() };
        let settings = [
            ("CARGO_PROFILE_CHIP_LTO", "off"),
            ("CARGO_PROFILE_CHIP_CODEGEN_UNITS", "16"),
            ("CARGO_PROFILE_CHIP_OPT_LEVEL", "3"),
            ("CARGO_PROFILE_CHIP_DEBUG", "false"),
        ];
        toolchain::build_copy(Chip::Esp32c6, &options, &self.source, &self.target, &settings)
    }

    /// Does `work` while these edits are made.
    fn with<T>(&self, edits: &[Edit], work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        let path = |edit: &Edit| self.source.join("firmware/src").join(&edit.file);
        let originals: Vec<_> =
            edits.iter().map(|edit| run::read(&path(edit))).collect::<Result<_, _>>()?;
        for edit in edits {
            let text = String::from_utf8_lossy(&run::read(&path(edit))?).into_owned();
            run::write(&path(edit), edit.make(&text)?)?;
        }
        let outcome = work();
        for (edit, original) in edits.iter().zip(originals) {
            run::write(&path(edit), original)?;
        }
        outcome
    }
}

/// Copies a file, or a folder with all below it.
fn copy_tree(from: &Path, to: &Path) -> std::io::Result<()> {
    if !from.is_dir() {
        return std::fs::copy(from, to).map(drop);
    }
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let name = entry?.file_name();
        copy_tree(&from.join(&name), &to.join(&name))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_edit_of_the_list_finds_its_text() {
        let list = List::read().unwrap();
        assert!(list.defect.len() >= 65);
        for edit in list.defect.iter().flat_map(|defect| &defect.edit) {
            let text = run::read(&root().join("firmware/src").join(&edit.file)).unwrap();
            edit.make(&String::from_utf8(text).unwrap()).unwrap();
        }
    }
}
