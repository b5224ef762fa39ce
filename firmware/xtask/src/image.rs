//! The flashable file, and what it takes of flash and memory.

use std::path::PathBuf;

use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind, elf};

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::setup::ImageMaker;
use crate::toolchain;

/// Ceiling of the flashable file. The bare Wi-Fi template is 528 KiB.
const FLASH_CEILING: u64 = 800 * 1024;
/// Ceiling of everything that is taken of memory before the program runs: code in RAM, data,
/// zeroed data and the heap inside it, without the stack and what is reclaimed from the boot loader.
const MEMORY_CEILING: u64 = 200 * 1024;

/// Builds a chip's firmware and makes a flashable file of it.
pub(crate) fn make(chip: Chip, options: &Options) -> Result<PathBuf, Error> {
    let elf = toolchain::build(chip, options)?;
    let image = elf.with_file_name(format!("flix-robot-{}.bin", chip.name()));
    match ImageMaker::find() {
        Some(ImageMaker::Espflash) => run::run(
            run::command("espflash")
                .args(["save-image", "--chip", chip.name()])
                .arg(&elf)
                .arg(&image),
        )?,
        Some(ImageMaker::Esptool(esptool)) => {
            run::run(
                run::command(&esptool)
                    .args(["--chip", chip.name(), "elf2image"])
                    // As espflash does by itself: which build it is, into the descriptor at the image's beginning.
                    .args(["--elf-sha256-offset", "0xb0", "--output"])
                    .arg(&image)
                    .arg(&elf),
            )?;
            run::run(
                run::command(&esptool)
                    .args(["--chip", chip.name(), "image-info"])
                    .arg(&image)
                    .stdout(std::process::Stdio::null()),
            )?;
        }
        None => {
            return Err(Error::Sentence(
                "neither espflash nor esptool is installed: run `cargo xtask setup`".into(),
            ));
        }
    }
    println!("{}", image.display());
    Ok(image)
}

/// What an image takes, bytes.
#[derive(Debug, Default, PartialEq, Eq)]
struct Use {
    /// Sections in flash that the cache maps.
    flash: u64,
    /// Code and data copied to RAM.
    memory_loaded: u64,
    /// RAM zeroed at start, the rest of the heap included.
    memory_zeroed: u64,
    /// RAM that only the boot loader needed; heap.
    memory_reclaimed: u64,
    /// The whole heap.
    heap: u64,
    /// What the stack has left.
    stack: u64,
}

/// RAM of the ESP32-C6 as the processor sees it; everything else that is loaded is flash.
const MEMORY: std::ops::Range<u64> = 0x4080_0000..0x4088_0000;

fn measure(elf: &[u8]) -> Result<Use, Error> {
    let file = object::File::parse(elf)
        .map_err(|error| Error::Sentence(format!("the built file is not an ELF file: {error}")))?;
    let mut used = Use::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
        if !sh_flags.contains(elf::SHF_ALLOC) {
            continue;
        }
        let zeroed = section.kind() == SectionKind::UninitializedData;
        let in_memory = MEMORY.contains(&section.address());
        match section.name() {
            Ok(".stack") => used.stack += section.size(),
            Ok(".dram2_uninit") => used.memory_reclaimed += section.size(),
            // Placeholders that keep two views of the same memory apart.
            Ok(name) if name.ends_with("_dummy") || name.ends_with("dummy") => {}
            _ if in_memory && zeroed => used.memory_zeroed += section.size(),
            _ if in_memory => used.memory_loaded += section.size(),
            _ => used.flash += section.size(),
        }
    }
    used.heap = file
        .symbols()
        .filter(|symbol| symbol.name().is_ok_and(|name| name.contains("HEAP")))
        .map(|symbol| symbol.size())
        .filter(|size| *size >= 1024)
        .sum();
    Ok(used)
}

/// Prints the table of the ESP32-C6 image; an error above a ceiling.
pub(crate) fn size() -> Result<(), Error> {
    let options = Options::default();
    let image = make(Chip::Esp32c6, &options)?;
    let file = run::read(&image)?.len() as u64;
    let used = measure(&run::read(&toolchain::riscv_binary("flix-robot"))?)?;
    let memory = used.memory_loaded + used.memory_zeroed;
    println!("\n| ESP32-C6 | bytes | KiB | ceiling, KiB |");
    println!("|---|---:|---:|---:|");
    let row = |what: &str, bytes: u64, ceiling: Option<u64>| {
        let ceiling = ceiling.map_or_else(String::new, |bytes| (bytes / 1024).to_string());
        println!("| {what} | {bytes} | {:.1} | {ceiling} |", bytes as f64 / 1024.0);
    };
    row("flash: image", file, Some(FLASH_CEILING));
    row("memory: static", memory, Some(MEMORY_CEILING));
    row("of this, code and data loaded", used.memory_loaded, None);
    row("of this, heap", used.heap - used.memory_reclaimed, None);
    row("memory: more heap, reclaimed from the boot loader", used.memory_reclaimed, None);
    row("memory: left for the stack", used.stack, None);
    verdict(file, memory)
}

/// Returns an error where a ceiling is exceeded.
fn verdict(flash: u64, memory: u64) -> Result<(), Error> {
    for (what, bytes, ceiling) in
        [("flash image", flash, FLASH_CEILING), ("static memory", memory, MEMORY_CEILING)]
    {
        if bytes > ceiling {
            return Err(Error::Sentence(format!(
                "the {what} takes {bytes} bytes, {} more than its ceiling",
                bytes - ceiling
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_at_its_ceilings_passes() {
        assert!(verdict(FLASH_CEILING, MEMORY_CEILING).is_ok());
    }

    #[test]
    fn a_byte_above_a_ceiling_fails_and_is_told() {
        for (flash, memory) in [(FLASH_CEILING + 1, 0), (0, MEMORY_CEILING + 1)] {
            let message = verdict(flash, memory).unwrap_err().to_string();
            assert!(message.contains("1 more than its ceiling"), "{message}");
        }
    }
}
