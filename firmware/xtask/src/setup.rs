//! What a fresh machine lacks, from rustup where it can be reached, else from Debian and PyPI.

use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::chip::RISCV_TARGET;
use crate::run::{self, Error};
use crate::toolchain;

/// Debian's compiler: new enough for the chip crates, from the security archive.
const DEBIAN_COMPILER: [&str; 4] =
    ["rustc-web=1.96*", "libstd-rust-web-dev=1.96*", "rust-web-src=1.96*", "lld-22"];
/// Debian's emulator for RISC-V.
const DEBIAN_QEMU: &str = "qemu-system-misc";
/// The image maker, from PyPI, where espflash is not installed.
const ESPTOOL: &str = "esptool==5.*";
/// The security archive, where the machine's sources do not name it.
const SECURITY_ARCHIVE: &str = "deb http://deb.debian.org/debian-security bookworm-security main\n";
/// How long rustup may try: a machine that cannot reach it should not wait for it.
const RUSTUP_PATIENCE: Duration = Duration::from_secs(90);

/// Brings everything that `build esp32c6`, `check`, `image`, `pil` and `size` need.
pub(crate) fn setup() -> Result<(), Error> {
    compiler()?;
    emulator()?;
    image_maker()
}

fn compiler() -> Result<(), Error> {
    let complete = || toolchain::stock_has_riscv() && toolchain::stock_has_sources();
    if !complete() {
        for arguments in [["target", "add", RISCV_TARGET], ["component", "add", "rust-src"]] {
            patiently(run::command("rustup").args(arguments), RUSTUP_PATIENCE);
        }
    }
    if complete() {
        println!("compiler: rustup's, with {RISCV_TARGET} and its sources");
        return Ok(());
    }
    if !toolchain::debian_is_complete() {
        println!("compiler: rustup cannot bring {RISCV_TARGET}; installing Debian's");
        refresh_packages(DEBIAN_COMPILER[0])?;
        install(&DEBIAN_COMPILER)?;
    }
    println!("compiler: Debian's, building core from its sources");
    Ok(())
}

fn emulator() -> Result<(), Error> {
    if !run::succeeds(run::command("qemu-system-riscv32").arg("--version")) {
        refresh_packages(DEBIAN_QEMU)?;
        install(&[DEBIAN_QEMU])?;
    }
    println!("emulator: qemu-system-riscv32");
    Ok(())
}

fn image_maker() -> Result<(), Error> {
    if let Some(maker) = ImageMaker::find() {
        println!("image maker: {maker:?}");
        return Ok(());
    }
    let environment = python_environment();
    run::run(run::command("python3").args(["-m", "venv"]).arg(&environment))?;
    run::run(run::command(environment.join("bin/pip")).args(["install", "--quiet", ESPTOOL]))?;
    println!("image maker: esptool, in {}", environment.display());
    Ok(())
}

fn python_environment() -> PathBuf {
    run::target_directory().join("xtask/python")
}

/// The program that makes flashable files.
#[derive(Debug)]
pub(crate) enum ImageMaker {
    /// Espressif's Rust program; also flashes.
    Espflash,
    /// Espressif's Python program, at this path.
    Esptool(PathBuf),
}

impl ImageMaker {
    /// The one that is installed; espflash first.
    pub(crate) fn find() -> Option<Self> {
        if run::succeeds(run::command("espflash").arg("--version")) {
            return Some(Self::Espflash);
        }
        let ours = python_environment().join("bin/esptool");
        [ours, "esptool".into()]
            .into_iter()
            .find(|path| run::succeeds(run::command(path).arg("version")))
            .map(Self::Esptool)
    }
}

/// Runs a command that may hang without a network; what becomes of it is seen from its effect.
fn patiently(command: &mut Command, patience: Duration) {
    let Ok(mut child) = command.spawn() else { return };
    let deadline = Instant::now() + patience;
    while Instant::now() < deadline {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    // It has ended by itself, or ends now: there is nothing to do about an error.
    let _ = child.kill();
    let _ = child.wait();
}

/// Brings the package lists up to date, with the security archive where the package needs it.
fn refresh_packages(wanted: &str) -> Result<(), Error> {
    run::run(run::command("apt-get").args(["update", "-qq"]))?;
    let simulated = |wanted: &str| {
        run::succeeds(run::command("apt-get").args(["install", "--simulate", "-qq", wanted]))
    };
    if !simulated(wanted) {
        let list = PathBuf::from("/etc/apt/sources.list.d/flix-walker-security.list");
        run::write(&list, SECURITY_ARCHIVE)?;
        run::run(run::command("apt-get").args(["update", "-qq"]))?;
    }
    Ok(())
}

fn install(packages: &[&str]) -> Result<(), Error> {
    run::run(
        run::command("apt-get")
            .args(["install", "-y", "-qq", "--no-install-recommends"])
            .args(packages)
            .env("DEBIAN_FRONTEND", "noninteractive"),
    )
}
