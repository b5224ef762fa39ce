//! `cargo xtask web`: the simulated robot in one page of a browser.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::run::{self, Error, command, output, succeeds, target_directory};

/// Largest page that is accepted, packed with gzip, bytes.
const LARGEST: u64 = 3_000_000;
/// Robot's time of the script that is compared, s.
const SECONDS: &str = "10";
const TARGET: &str = "wasm32-unknown-unknown";

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Compare the page's robot with the native one, bit for bit, and print JSON (needs Node.js)
    #[arg(long)]
    json: bool,
    /// Program of the package that packs the page, where one is built already [default: built here]
    #[arg(long, value_name = "PROGRAM")]
    program: Option<PathBuf>,
}

#[derive(serde::Serialize)]
struct Verdict {
    bytes_gzip: u64,
    hash_equal: bool,
    real_time_factor: f64,
}

#[derive(serde::Deserialize)]
struct Checked {
    hash: String,
    real_time_factor: f64,
}

fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Calls the program of the package: this one, or built in the same way whether the rest of the workspace is built or not.
fn packer(program: Option<&Path>) -> Command {
    if let Some(program) = program {
        return command(program);
    }
    let mut packer = cargo();
    packer.args(["run", "--quiet", "--release", "--package", "flix-web", "--"]);
    packer
}

pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let program = args.program.as_deref().map(run::absolute).transpose()?;
    // A toolchain without rustup has the target or fails with a sentence of its own.
    succeeds(command("rustup").args(["target", "add", TARGET]));
    run::run(
        cargo()
            .args(["build", "--quiet", "--profile", "web", "--package", "flix-web", "--lib"])
            .args(["--target", TARGET]),
    )?;
    let module = target_directory().join(TARGET).join("web/flix_web.wasm");
    let folder = target_directory().join("site");
    let printed = output(packer(program.as_deref()).arg("pack").args([&module, &folder]))?;
    let bytes_gzip: u64 = printed
        .trim()
        .parse()
        .map_err(|_| Error::Sentence(format!("the packer printed {printed}")))?;
    if bytes_gzip > LARGEST {
        return Err(Error::Sentence(format!(
            "the page takes {bytes_gzip} bytes packed, more than {LARGEST}: leave something out"
        )));
    }
    if !args.json {
        println!(
            "{} ({bytes_gzip} bytes packed): open it, or serve its folder",
            folder.join("index.html").display()
        );
        return Ok(());
    }
    let native = output(packer(program.as_deref()).args(["hash", "--seconds", SECONDS]))?;
    let printed = output(command("node").arg("sim-hil/web/check.mjs").arg(&module).arg(SECONDS))?;
    let checked: Checked = serde_json::from_str(&printed)
        .map_err(|error| Error::Sentence(format!("the check printed {printed}: {error}")))?;
    let hash_equal = native.split_whitespace().next() == Some(&checked.hash);
    let verdict = Verdict { bytes_gzip, hash_equal, real_time_factor: checked.real_time_factor };
    let line =
        serde_json::to_string(&verdict).map_err(|error| Error::Sentence(error.to_string()))?;
    println!("{line}");
    if hash_equal {
        Ok(())
    } else {
        Err(Error::Sentence("the page's robot is not the native one, bit for bit".to_owned()))
    }
}
