//! The compiler that builds or checks each chip on this machine.
//!
//! | chip | with rustup / espup | without |
//! |---|---|---|
//! | ESP32-C6 | the target `riscv32imac-unknown-none-elf` | Debian's `rustc-web`, its sources, `lld` |
//! | ESP32 | the toolchain `esp`; with `--stock`, an experiment, the stock one ([`crate::stock`]) | type-checked by a stand-in |
//! | ESP32-S3 | the toolchain `esp` | type-checked by a stand-in |
//!
//! The stand-in: stock compilers know the Xtensa targets but no assembly for them. A target file
//! that carries the Xtensa target's name and an ARM description, with `target_arch` overridden,
//! lets every type, name, feature and pin be checked. It proves nothing about code generation.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::chip::{Chip, Options, RISCV_TARGET};
use crate::run::{self, Error};

/// Debian's compiler, beside rustup's.
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
/// Debian's linker for bare targets.
const DEBIAN_LINKER: &str = "ld.lld-22";
/// The toolchain that `espup install` brings.
const ESP_TOOLCHAIN: &str = "esp";
/// How long rustup may try to bring one thing: a busy machine unpacks `rustc-dev` for minutes.
const RUSTUP_PATIENCE: Duration = Duration::from_secs(900);
/// Profile of chip images, in the root manifest.
pub(crate) const PROFILE: &str = "chip";
/// A bare target with inline assembly, to stand in for Xtensa.
const STAND_IN: &str = "armv7a-none-eabi";

/// Returns the real cargo: rustup's stand-in of that name would choose a compiler of its own.
pub(crate) fn cargo() -> Command {
    run::command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

fn sysroot(rustc: &Path) -> Option<PathBuf> {
    let output = run::command(rustc).args(["--print", "sysroot"]).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().into())
}

pub(crate) fn stock_rustc() -> PathBuf {
    std::env::var_os("RUSTC").map_or_else(|| "rustc".into(), PathBuf::from)
}

/// Returns whether the compiler's own sources are installed.
pub(crate) fn has_sources(rustc: &Path) -> bool {
    let library = |root: PathBuf| root.join("lib/rustlib/src/rust/library/Cargo.toml");
    sysroot(rustc).is_some_and(|root| library(root).is_file())
}

/// Returns whether the stock compiler can build for the C6 as it is.
pub(crate) fn stock_has_riscv() -> bool {
    sysroot(&stock_rustc()).is_some_and(|root| root.join("lib/rustlib").join(RISCV_TARGET).is_dir())
}

/// Returns whether the stock compiler can build `core` itself.
pub(crate) fn stock_has_sources() -> bool {
    has_sources(&stock_rustc())
}

/// Returns whether Debian's compiler, its sources and its linker are installed.
pub(crate) fn debian_is_complete() -> bool {
    has_sources(Path::new(DEBIAN_RUSTC))
        && run::succeeds(run::command(DEBIAN_LINKER).arg("--version"))
}

/// Lets rustup bring one thing; whether it could is seen from its effect. A machine that cannot reach it does not wait for long.
pub(crate) fn rustup(arguments: &[&str]) {
    let Ok(mut rustup) = run::command("rustup").args(arguments).spawn() else { return };
    let start = Instant::now();
    while rustup.try_wait().is_ok_and(|status| status.is_none()) {
        if start.elapsed() > RUSTUP_PATIENCE {
            // One that has ended meanwhile.
            let _ = rustup.kill();
        }
        std::thread::sleep(RUSTUP_PATIENCE / 1000);
    }
}

fn has_esp() -> bool {
    run::succeeds(run::command("rustup").args(["run", ESP_TOOLCHAIN, "rustc", "--version"]))
}

/// Finds a compiler that may build `core` from its sources.
fn with_sources(command: &mut Command) -> Result<PathBuf, Error> {
    command.env("RUSTC_BOOTSTRAP", "1");
    let stock = stock_rustc();
    if has_sources(&stock) {
        return Ok(stock);
    }
    let debian = PathBuf::from(DEBIAN_RUSTC);
    if has_sources(&debian) {
        command.env("RUSTC", DEBIAN_RUSTC);
        return Ok(debian);
    }
    Err(Error::Sentence(
        "no compiler with its own sources is installed: run `cargo xtask setup`".into(),
    ))
}

/// Returns options that name dependencies in an image without the folders of this computer: it is as large wherever it is
/// built, and 5 KiB smaller.
fn without_folders() -> Option<[String; 2]> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo")))?;
    let registries = std::fs::read_dir(home.join("registry/src")).ok()?.flatten();
    let flags: Vec<String> = registries
        .map(|registry| format!("'--remap-path-prefix={}/='", registry.path().display()))
        .collect();
    let flags = format!("target.'cfg(target_os = \"none\")'.rustflags=[{}]", flags.join(", "));
    Some(["--config".into(), flags])
}

/// Prepares a cargo command that builds for RISC-V. The caller adds package and features.
pub(crate) fn riscv(subcommand: &str) -> Result<Command, Error> {
    let mut command = cargo();
    command.args([subcommand, "--profile", PROFILE, "--target", RISCV_TARGET]);
    command.args(without_folders().into_iter().flatten());
    if stock_has_riscv() {
        return Ok(command);
    }
    if !debian_is_complete() {
        return Err(Error::Sentence(format!(
            "no compiler here builds for {RISCV_TARGET}: run `cargo xtask setup`"
        )));
    }
    eprintln!("rustup's target {RISCV_TARGET} is not installed: building with Debian's compiler");
    command
        .args(["-Zbuild-std=core,alloc"])
        .env("RUSTC", DEBIAN_RUSTC)
        .env("RUSTC_BOOTSTRAP", "1")
        .env("CARGO_TARGET_RISCV32IMAC_UNKNOWN_NONE_ELF_LINKER", DEBIAN_LINKER);
    Ok(command)
}

/// Returns where a RISC-V binary of this name is built.
pub(crate) fn riscv_binary(name: &str) -> PathBuf {
    run::target_directory().join(RISCV_TARGET).join(PROFILE).join(name)
}

/// Prepares a cargo command with espup's toolchain, or `None` where it is not installed.
fn xtensa(chip: Chip, subcommand: &str) -> Option<Command> {
    has_esp().then(|| {
        let mut command = run::command("rustup");
        command.args(["run", ESP_TOOLCHAIN, "cargo", subcommand, "--profile", PROFILE]);
        command.args(["-Zbuild-std=core,alloc", "--target", chip.target()]);
        command.args(without_folders().into_iter().flatten());
        // Chosen by the outer cargo for the outer compiler.
        command.env_remove("RUSTC").env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO");
        command
    })
}

pub(crate) fn for_chip(chip: Chip, subcommand: &str) -> Result<Command, Error> {
    match chip {
        Chip::Esp32c6 => riscv(subcommand),
        Chip::Esp32 | Chip::Esp32s3 => xtensa(chip, subcommand).ok_or_else(|| {
            Error::Sentence(format!(
                "building for the {0} needs the toolchain `{ESP_TOOLCHAIN}`: \
                 `cargo install espup && espup install`; \
                 without it, `cargo xtask check {0}` checks its types{1}",
                chip.name(),
                if chip == Chip::Esp32 { ", and `--stock` builds what nobody has run" } else { "" }
            ))
        }),
    }
}

pub(crate) fn choose(command: &mut Command, chip: Chip, options: &Options) {
    command.args(["--package", "flix-firmware", "--bin", "flix-robot", "--features"]);
    command.arg(options.features(chip));
}

/// Builds a chip's firmware and gives the path of its ELF file.
pub(crate) fn build(chip: Chip, options: &Options) -> Result<PathBuf, Error> {
    let elf = build_silently(chip, options)?;
    println!("{}", elf.display());
    Ok(elf)
}

/// Builds it as [`build`] does, and prints nothing on the standard output.
pub(crate) fn build_silently(chip: Chip, options: &Options) -> Result<PathBuf, Error> {
    build_copy(chip, options, &run::root(), &run::target_directory(), &[])
}

/// Builds it in a copy of the repository, with a target folder and cargo's settings (as variables) of its own.
pub(crate) fn build_copy(
    chip: Chip,
    options: &Options,
    source: &Path,
    target: &Path,
    settings: &[(&str, &str)],
) -> Result<PathBuf, Error> {
    let mut command = for_chip(chip, "build")?;
    choose(&mut command, chip, options);
    command.current_dir(source).env("CARGO_TARGET_DIR", target).envs(settings.iter().copied());
    run::run(&mut command)?;
    Ok(target.join(chip.target()).join(PROFILE).join("flix-robot"))
}

/// Type-checks a chip's firmware, every variant of it unless one is named.
pub(crate) fn check(chip: Chip, options: &Options) -> Result<(), Error> {
    for variant in options.variants(chip) {
        let real = match chip {
            Chip::Esp32c6 => Some(riscv("check")?),
            Chip::Esp32 | Chip::Esp32s3 => xtensa(chip, "check"),
        };
        let stand_in = real.is_none();
        let mut command = match real {
            Some(command) => command,
            None => stand_in_check(chip)?,
        };
        choose(&mut command, chip, &variant);
        run::run(&mut command)?;
        let how = if stand_in {
            "types, names, features and pins checked by a stand-in target; no code generated"
        } else {
            "checked with the chip's own target"
        };
        println!("{}: {how}", variant.features(chip));
    }
    Ok(())
}

/// Prepares `cargo check` for an Xtensa chip without its toolchain.
fn stand_in_check(chip: Chip) -> Result<Command, Error> {
    let mut command = cargo();
    let rustc = with_sources(&mut command)?;
    let specification = run::output(
        run::command(rustc)
            .args(["--target", STAND_IN, "--print", "target-spec-json", "-Zunstable-options"])
            .env("RUSTC_BOOTSTRAP", "1"),
    )?;
    // Build scripts see the file's name as the target.
    let file = run::target_directory().join("xtask").join(format!("{}.json", chip.target()));
    run::write(&file, specification)?;
    // Of its own: build scripts look at the variables of a command that builds `core`, and would
    // run anew, all that follows from them with them, whenever the other kind of command had been.
    let directory = run::target_directory().join("xtask/stand-in");
    command
        .args(["check", "--profile", PROFILE, "-Zbuild-std=core,alloc", "-Zjson-target-spec"])
        .arg("--target-dir")
        .arg(&directory)
        .arg("--target")
        .arg(&file)
        .env("RUSTFLAGS", "--cfg target_arch=\"xtensa\" -Aexplicit_builtin_cfgs_in_flags");
    Ok(command)
}
