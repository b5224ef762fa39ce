//! The ESP32 by the stock compiler, experimental: `--stock`. How it is done says the package `flix-xtensa`.
//!
//! Nothing so built has run on a chip yet; what is flashed is built by espup's toolchain.

#[path = "../../stock/src/release.rs"]
mod release;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::toolchain::{self, PROFILE};
use release::{LLD, RUSTC};

/// The driver's manifest, from the root.
const DRIVER: &str = "firmware/stock/driver/Cargo.toml";
/// What LLVM holds for Xtensa, where rustc's description of the target states something else (LLVM 22, `XtensaTargetMachine`).
const DATA_LAYOUT: &str = "e-m:e-p:32:32-i8:8:32-i16:16:32-i64:64-n32";
/// Names the linker to cargo.
const LINKER: &str = "CARGO_TARGET_XTENSA_ESP32_NONE_ELF_LINKER";

/// What the code is to run on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Core {
    /// The ESP32's LX6.
    Lx6,
    /// A core of QEMU's.
    Emulated,
}

impl Core {
    /// Returns the folder of what is built for it.
    fn folder(self) -> &'static str {
        match self {
            Self::Lx6 => "chip",
            Self::Emulated => "emulated",
        }
    }

    /// Returns features of the LX6 that are not used: its floating-point unit, which no register of a task is saved of, and
    /// the upper half of a product, which the cores of QEMU with register windows lack.
    fn without(self) -> &'static str {
        match self {
            Self::Lx6 => "-fp",
            Self::Emulated => "-fp,-mul32high",
        }
    }
}

/// A component of rustup that is built around, and how it is seen: the beginning of a file's name in a folder of the sysroot.
struct Component {
    name: &'static str,
    folder: fn(&Path, host: &str) -> PathBuf,
    file: &'static str,
}

const COMPONENTS: [Component; 3] = [
    Component {
        name: "rust-src",
        folder: |sysroot, _| sysroot.join("lib/rustlib/src/rust/library"),
        file: "Cargo.toml",
    },
    Component {
        name: "rustc-dev",
        folder: |sysroot, host| sysroot.join("lib/rustlib").join(host).join("lib"),
        file: "librustc_codegen_ssa-",
    },
    Component {
        name: "llvm-tools",
        folder: |sysroot, host| sysroot.join("lib/rustlib").join(host).join("bin"),
        file: "llvm-nm",
    },
];

impl Component {
    fn is_installed(&self, sysroot: &Path, host: &str) -> bool {
        let entries =
            std::fs::read_dir((self.folder)(sysroot, host)).into_iter().flatten().flatten();
        entries.into_iter().any(|entry| entry.file_name().to_string_lossy().starts_with(self.file))
    }
}

/// The stock compiler.
struct Compiler {
    rustc: PathBuf,
    host: String,
    sysroot: PathBuf,
}

impl Compiler {
    /// Finds it; an error where it is another release.
    fn find() -> Result<Self, Error> {
        let rustc = toolchain::stock_rustc();
        let version = run::output(run::command(&rustc).arg("-vV"))?;
        let host = is_release(&version)?.to_owned();
        let sysroot = run::output(run::command(&rustc).args(["--print", "sysroot"]))?;
        Ok(Self { rustc, host, sysroot: sysroot.trim().into() })
    }

    /// Returns the components that are missing.
    fn missing(&self) -> impl Iterator<Item = &'static str> {
        let missing = |component: &&Component| !component.is_installed(&self.sysroot, &self.host);
        COMPONENTS.iter().filter(missing).map(|component| component.name)
    }

    /// Returns the description of a chip's target, with words of its own: whatever they change is built anew.
    fn specification(&self, chip: Chip, words: &str) -> Result<String, Error> {
        let printed = run::output(
            run::command(&self.rustc)
                .args(["--target", chip.target(), "--print", "target-spec-json"])
                .arg("-Zunstable-options")
                .env("RUSTC_BOOTSTRAP", "1"),
        )?;
        specification(&printed, words).ok_or_else(|| {
            Error::Sentence(format!(
                "rustc describes {} unlike expected:\n{printed}",
                chip.target()
            ))
        })
    }

    /// Returns the path of the linker that rustup brings.
    fn lld(&self) -> PathBuf {
        self.sysroot.join("lib/rustlib").join(&self.host).join("bin/rust-lld")
    }
}

/// Returns the host of the compiler that describes itself so; an error for another release than the one.
fn is_release(version: &str) -> Result<&str, Error> {
    let field = |name: &str| version.lines().find_map(|line| line.strip_prefix(name));
    match (field("release: "), field("host: ")) {
        (Some(RUSTC), Some(host)) => Ok(host),
        (found, _) => Err(Error::Sentence(format!(
            "--stock is built around the library of rustc {RUSTC} alone, and this is rustc {}: \
             `rustup toolchain install {RUSTC}`, and `rustup run {RUSTC} cargo xtask ...`",
            found.unwrap_or("of an unknown release")
        ))),
    }
}

/// Returns a target's description as the compiler prints it, made fit; nothing where it is none.
fn specification(printed: &str, words: &str) -> Option<String> {
    let mut target: serde_json::Value = serde_json::from_str(printed).ok()?;
    let fields = target.as_object_mut()?;
    fields.insert("data-layout".into(), DATA_LAYOUT.into());
    fields.insert("linker-flavor".into(), "gnu".into());
    fields.remove("linker");
    fields.get_mut("metadata")?.as_object_mut()?.insert("description".into(), words.into());
    serde_json::to_string_pretty(&target).ok()
}

/// Brings the components that are missing.
pub(crate) fn set_up() -> Result<(), Error> {
    let compiler = Compiler::find()?;
    for component in compiler.missing() {
        toolchain::rustup(&["component", "add", component]);
    }
    complete(&compiler)?;
    println!("stock compiler for the ESP32: rustc {RUSTC}, with what it is built around");
    Ok(())
}

fn complete(compiler: &Compiler) -> Result<(), Error> {
    let missing: Vec<&str> = compiler.missing().collect();
    if missing.is_empty() {
        return Ok(());
    }
    Err(Error::Sentence(format!(
        "--stock needs components of rustc {RUSTC} that are not installed: \
         `cargo xtask setup --stock`, or `rustup component add {}`",
        missing.join(" ")
    )))
}

fn folder() -> PathBuf {
    run::target_directory().join("lanes/stock")
}

/// Builds compiler and linker; returns their paths.
fn tools() -> Result<[PathBuf; 2], Error> {
    let folder = folder().join("tools");
    run::run(
        toolchain::cargo()
            .args(["build", "--quiet", "--release", "--locked", "--manifest-path", DRIVER])
            .arg("--target-dir")
            .arg(&folder)
            .env("RUSTC_BOOTSTRAP", "1"),
    )?;
    Ok(["rustc-xtensa", "link-xtensa"].map(|name| folder.join("release").join(name)))
}

/// Returns a number of these files' contents.
fn digest(files: &[PathBuf]) -> Result<u64, Error> {
    let mut hasher = DefaultHasher::new();
    for file in files {
        run::read(file)?.hash(&mut hasher);
    }
    Ok(hasher.finish())
}

/// Builds a binary of the firmware with these features; returns its path.
pub(crate) fn binary(chip: Chip, core: Core, name: &str, features: &str) -> Result<PathBuf, Error> {
    is_possible(chip)?;
    let compiler = Compiler::find()?;
    complete(&compiler)?;
    let tools = tools()?;
    let folder = folder().join(core.folder());
    // Build scripts see the file's name as the target.
    let target = folder.join(format!("{}.json", chip.target()));
    let words = format!("ESP32 by the stock compiler, {:016x}", digest(&tools)?);
    run::write(&target, compiler.specification(chip, &words)?)?;
    let [rustc, linker] = &tools;
    let mut command = toolchain::cargo();
    set_compiler(&mut command, rustc, core);
    command
        .env(LINKER, linker)
        .env(LLD, compiler.lld())
        .args(["build", "--locked", "--profile", PROFILE])
        .args(["-Zbuild-std=core,alloc", "-Zjson-target-spec", "--target"])
        .arg(&target)
        .arg("--target-dir")
        .arg(&folder)
        .args(["--package", "flix-firmware", "--bin", name, "--features", features]);
    run::run(&mut command)?;
    Ok(folder.join(chip.target()).join(PROFILE).join(name))
}

/// Sets the variables by which cargo and build scripts know compiler and processor.
fn set_compiler(command: &mut Command, rustc: &Path, core: Core) {
    command
        .env("RUSTC", rustc)
        .env("RUSTC_BOOTSTRAP", "1")
        // xtensa-lx-rt's build script looks here for what is left out, and wants two words.
        .env("RUSTFLAGS", format!("-C target-feature={}", core.without()))
        // Each unit is written as text, so there is nothing to keep or to optimize across crates.
        .env("CARGO_INCREMENTAL", "0")
        .env("CARGO_PROFILE_CHIP_LTO", "off");
}

/// Builds a chip's firmware and gives the path of its ELF file.
pub(crate) fn build(chip: Chip, options: &Options) -> Result<PathBuf, Error> {
    let elf = binary(chip, Core::Lx6, "flix-robot", &options.features(chip))?;
    println!("{}", crate::in_memory::check(&run::read(&elf)?)?);
    println!("{}", elf.display());
    Ok(elf)
}

/// Returns an error for a chip that this is not for.
fn is_possible(chip: Chip) -> Result<(), Error> {
    let sentence = match chip {
        Chip::Esp32 => return Ok(()),
        Chip::Esp32s3 => {
            "LLVM of the stock compiler does not know the ESP32-S3's processor: `cargo xtask build esp32s3`, by espup's"
        }
        Chip::Esp32c6 => "the ESP32-C6 is built by the stock compiler without --stock",
    };
    Err(Error::Sentence(sentence.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_release_of_the_compiler_is_refused_and_both_are_named() {
        let version =
            |release: &str| format!("rustc {release}\nhost: x86_64-linux\nrelease: {release}\n");
        assert_eq!(is_release(&version(RUSTC)).unwrap(), "x86_64-linux");
        for release in ["1.96.0", "1.95.1", "1.95.0-nightly"] {
            let message = is_release(&version(release)).unwrap_err().to_string();
            let are_named = [RUSTC, release].iter().all(|named| message.contains(named));
            assert!(are_named, "{message}");
        }
    }

    #[test]
    fn the_target_gets_the_layout_of_llvm_and_keeps_the_rest() {
        let printed = r#"{"arch": "xtensa", "data-layout": "e", "linker": "gcc", "linker-flavor": "gnu-cc",
            "metadata": {"description": "x", "tier": 3}}"#;
        let target: serde_json::Value =
            serde_json::from_str(&specification(printed, "words").unwrap()).unwrap();
        assert_eq!(
            target,
            serde_json::json!({"arch": "xtensa", "data-layout": DATA_LAYOUT, "linker-flavor": "gnu",
                "metadata": {"description": "words", "tier": 3}})
        );
        assert_eq!(specification("none", "words"), None);
    }

    #[test]
    fn other_chips_are_refused() {
        assert!(is_possible(Chip::Esp32).is_ok());
        assert!(is_possible(Chip::Esp32s3).is_err() && is_possible(Chip::Esp32c6).is_err());
    }
}
