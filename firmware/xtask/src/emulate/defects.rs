//! Images with one defect each: every one has to be caught on the emulated chip.
//!
//! A copy of the firmware is edited and built in a folder of its own, so that no image with a defect lies where images are
//! flashed from, and nothing but the firmware is built again. It is linked without optimization across packages, in a tenth
//! of the time; the image without a defect, built likewise, has to pass.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Args, OTHER, other_options};
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

/// Tries the defects; an error when one is not caught.
pub(super) fn run(args: &Args) -> Result<(), Error> {
    let named = args.named.as_deref().unwrap_or_default();
    let list = List::read()?;
    let copy = Copy::new()?;
    for part in ["session", "network", "restarts", "power", OTHER] {
        let sound = copy.build(part)?;
        if let Some(failure) = first_failure(args, &sound, part)? {
            return Err(Error::Sentence(format!("without a defect: {failure}")));
        }
    }
    let mut outcomes = Vec::new();
    for defect in list.defect.into_iter().filter(|defect| defect.name.contains(named)) {
        let caught_by = match copy.with(&defect.edit, || copy.build(&defect.part)) {
            Ok(image) => first_failure(args, &image, &defect.part)?,
            Err(error) => {
                eprintln!("{}: {error}", defect.name);
                None
            }
        };
        let verdict = caught_by.as_deref().unwrap_or("NOT CAUGHT");
        eprintln!("{}: {verdict}", defect.name);
        outcomes.push(Outcome { name: defect.name, caught_by });
    }
    let caught = outcomes.iter().filter(|outcome| outcome.caught_by.is_some()).count();
    let tried = outcomes.len();
    let pass = caught == tried && tried > 0;
    let summary = Summary { defects: Counts { tried, caught }, outcomes, pass };
    if args.json {
        println!("{}", serde_json::to_string(&summary).unwrap_or_default());
    } else {
        println!("{caught} of {tried} defects caught");
    }
    match pass {
        true => Ok(()),
        false => Err(Error::Sentence(format!("{} defects are not caught", tried - caught))),
    }
}

/// What the emulator finds first in a part of its short run; `None` when the image passes.
fn first_failure(args: &Args, image: &Path, part: &str) -> Result<Option<String>, Error> {
    let mut command = super::emulator(args, image)?;
    if part == OTHER {
        command.arg("--other").arg(image);
    }
    let output = command
        .args(["--quick", "--json", "--part", part])
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

/// The copy of the workspace.
struct Copy {
    source: PathBuf,
    target: PathBuf,
}

impl Copy {
    fn new() -> Result<Self, Error> {
        let folder = root().join(run::target_directory()).join("defects");
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
        let options = if part == OTHER { other_options() } else { Options::default() };
        let settings =
            [("CARGO_PROFILE_CHIP_LTO", "off"), ("CARGO_PROFILE_CHIP_CODEGEN_UNITS", "16")];
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
        assert!(list.defect.len() >= 25);
        for edit in list.defect.iter().flat_map(|defect| &defect.edit) {
            let text = run::read(&root().join("firmware/src").join(&edit.file)).unwrap();
            edit.make(&String::from_utf8(text).unwrap()).unwrap();
        }
    }
}
