#![forbid(unsafe_code)]
//! Packs the page, and runs its scripts natively: `cargo xtask web` calls it.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use flix_web::{Options, page, script};

/// Packs the page of the simulated robot, and runs its scripts natively.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Write the page into a folder, and print its size packed with gzip, in bytes.
    Pack {
        /// The package's WebAssembly module.
        module: PathBuf,
        /// Folder to write `index.html` into.
        folder: PathBuf,
    },
    /// Run a script and print the hash of all states of the plant.
    Hash {
        /// File of the script [default: the page's own].
        script: Option<PathBuf>,
        /// Robot's time to run, s.
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
    },
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().task {
        Task::Pack { module, folder } => pack(&module, &folder),
        Task::Hash { script, seconds } => hash(script.as_deref(), seconds),
    };
    match outcome {
        Ok(line) => {
            println!("{line}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn pack(module: &Path, folder: &Path) -> Result<String, Box<dyn std::error::Error>> {
    let named = |error| format!("{}: {error}", module.display());
    let html = page::document(&std::fs::read(module).map_err(named)?)?;
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("index.html"), &html)?;
    Ok(page::pack(html.as_bytes())?.len().to_string())
}

fn hash(file: Option<&Path>, seconds: f64) -> Result<String, Box<dyn std::error::Error>> {
    let text = file.map(std::fs::read_to_string).transpose()?;
    let verdict =
        script::run(&Options::default(), text.as_deref().unwrap_or(script::SCRIPT), seconds)?;
    Ok(format!("{} after {:.3} m", verdict.hash, verdict.moved))
}
