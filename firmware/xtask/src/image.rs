//! The flashable file, and what it takes of flash and memory.

use std::fmt::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind, elf};

use crate::chip::{Chip, Options};
use crate::flash::espflash_options;
use crate::run::{self, Error};
use crate::setup::ImageMaker;
use crate::{stock, toolchain};

/// Most that an image may take, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Ceilings {
    /// The flashable file.
    flash: u64,
    /// Everything that is taken of memory before the program runs: code in RAM, data,
    /// zeroed data and the heap inside it, without the stack and what is reclaimed from the boot loader.
    memory: u64,
}

/// A chip's ceilings, and its RAM as its processor sees it; everything else that is loaded is flash.
struct Memory {
    ceilings: Ceilings,
    ranges: &'static [Range<u64>],
}

/// The bare Wi-Fi template for the ESP32-C6 is 528 KiB. RAM: technical reference manual, "System and Memory".
const ESP32C6: Memory = Memory {
    ceilings: Ceilings { flash: 1000 * 1024, memory: 256 * 1024 },
    ranges: core::slice::from_ref(&(0x4080_0000..0x4088_0000)),
};
/// Ceilings of an image without optimization across packages and with floats in software, a little above its size, so that growth shows. RAM: technical reference manual, "System and Memory":
/// of SRAM 2 and 1 what data uses, of SRAM 0 what is no cache.
const ESP32: Memory = Memory {
    ceilings: Ceilings { flash: 1300 * 1024, memory: 288 * 1024 },
    ranges: &[0x3ffa_e000..0x4000_0000, 0x4008_0000..0x400a_0000],
};

/// Makes a flashable file of a chip's firmware, with the user's options of espflash.
pub(crate) fn make(chip: Chip, elf: &Path, given: &[String]) -> Result<PathBuf, Error> {
    let image = elf.with_file_name(format!("flix-robot-{}.bin", chip.name()));
    let blank = match ImageMaker::find() {
        Some(ImageMaker::Espflash) => {
            run::run(
                run::command("espflash")
                    .args(["save-image", "--chip", chip.name()])
                    .args(espflash_options(given))
                    .arg(elf)
                    .arg(&image),
            )?;
            ""
        }
        Some(ImageMaker::Esptool(_)) if !given.is_empty() => {
            return Err(Error::Sentence(
                "options behind `--` are espflash's, which is not installed: `cargo install espflash --locked`"
                    .into(),
            ));
        }
        Some(ImageMaker::Esptool(esptool)) => {
            run::run(
                run::command(&esptool)
                    .args(["--chip", chip.name(), "elf2image", "--flash-freq", "80m"])
                    // As espflash does by itself: which build it is, into the descriptor at the image's beginning.
                    .args(["--elf-sha256-offset", "0xb0", "--output"])
                    .arg(&image)
                    .arg(elf),
            )?;
            run::run(
                run::command(&esptool)
                    .args(["--chip", chip.name(), "image-info"])
                    .arg(&image)
                    .stdout(std::process::Stdio::null()),
            )?;
            " (esptool has neither: `cargo install espflash --locked` first)"
        }
        None => {
            return Err(Error::Sentence(
                "neither espflash nor esptool is installed: run `cargo xtask setup`".into(),
            ));
        }
    };
    println!("{}", image.display());
    eprintln!(
        "the application alone, for address 0x10000 of a board that holds espflash's boot loader and table of partitions: \
         `esptool write-flash 0x10000 FILE`; a blank board needs those, too: `cargo flash-{}`{blank}",
        chip.name()
    );
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

fn measure(elf: &[u8], memory: &[Range<u64>]) -> Result<Use, Error> {
    let file = run::elf(elf)?;
    let mut used = Use::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
        if !sh_flags.contains(elf::SHF_ALLOC) {
            continue;
        }
        let zeroed = section.kind() == SectionKind::UninitializedData;
        let in_memory = memory.iter().any(|range| range.contains(&section.address()));
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

/// Of which images.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Chips, each a part of the table.
    #[arg(default_value = "esp32c6")]
    chips: Vec<Chip>,
    /// Build for the ESP32 by the stock compiler.
    #[arg(long)]
    stock: bool,
}

/// What one chip's image takes.
struct Sized {
    chip: Chip,
    file: u64,
    used: Use,
    ceilings: Ceilings,
}

impl Sized {
    fn of(chip: Chip, stock: bool) -> Result<Self, Error> {
        let Memory { ceilings, ranges } = match chip {
            Chip::Esp32c6 => ESP32C6,
            Chip::Esp32 => ESP32,
            Chip::Esp32s3 => {
                return Err(Error::Sentence(
                    "the sizes of the ESP32-S3's image are not looked at: name esp32c6, or esp32 --stock".into(),
                ));
            }
        };
        // The one chip that the stock compiler builds for by itself.
        let options = Options::default();
        let elf = match chip {
            Chip::Esp32 if stock => stock::build(chip, &options)?,
            _ => toolchain::build(chip, &options)?,
        };
        let file = run::read(&make(chip, &elf, &[])?)?.len() as u64;
        Ok(Self { chip, file, used: measure(&run::read(&elf)?, ranges)?, ceilings })
    }

    fn memory(&self) -> u64 {
        self.used.memory_loaded + self.used.memory_zeroed
    }

    /// Returns the rows of the table: bytes, and the ceiling where there is one.
    fn rows(&self) -> [(&'static str, u64, Option<u64>); 6] {
        let Use { memory_loaded, memory_reclaimed, heap, stack, .. } = self.used;
        [
            ("flash: image", self.file, Some(self.ceilings.flash)),
            ("memory: static", self.memory(), Some(self.ceilings.memory)),
            ("of this, code and data loaded", memory_loaded, None),
            ("of this, heap", heap - memory_reclaimed, None),
            ("memory: more heap, reclaimed from the boot loader", memory_reclaimed, None),
            ("memory: left for the stack", stack, None),
        ]
    }
}

/// Returns the table of images.
fn table(images: &[Sized]) -> String {
    let mut table = String::from("|");
    // Writing to a string never fails.
    for image in images {
        let _ = write!(table, " | {}, bytes | KiB | ceiling, KiB", image.chip.title());
    }
    table.push_str(" |\n|---");
    table.push_str(&"|---:|---:|---:".repeat(images.len()));
    table.push_str("|\n");
    let rows: Vec<_> = images.iter().map(Sized::rows).collect();
    for (number, (what, ..)) in rows.iter().flatten().take(rows[0].len()).enumerate() {
        let _ = write!(table, "| {what}");
        for (_, bytes, ceiling) in rows.iter().map(|rows| rows[number]) {
            let ceiling = ceiling.map_or_else(String::new, |bytes| (bytes / 1024).to_string());
            let _ = write!(table, " | {bytes} | {:.1} | {ceiling}", bytes as f64 / 1024.0);
        }
        table.push_str(" |\n");
    }
    table
}

/// Prints the table of images; an error above a ceiling.
pub(crate) fn size(args: &Args) -> Result<(), Error> {
    let images = args.chips.iter().map(|chip| Sized::of(*chip, args.stock));
    let images = images.collect::<Result<Vec<_>, Error>>()?;
    println!("\n{}", table(&images));
    images.iter().try_for_each(verdict)
}

/// Returns an error where a ceiling is exceeded.
fn verdict(image: &Sized) -> Result<(), Error> {
    let Ceilings { flash, memory } = image.ceilings;
    for (what, bytes, ceiling) in
        [("flash image", image.file, flash), ("static memory", image.memory(), memory)]
    {
        if bytes > ceiling {
            return Err(Error::Sentence(format!(
                "the {what} of the {} takes {bytes} bytes, {} more than its ceiling",
                image.chip.title(),
                bytes - ceiling
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CEILINGS: Ceilings = ESP32C6.ceilings;

    fn image(chip: Chip, flash: u64, memory: u64) -> Sized {
        let used = Use { memory_loaded: 1, memory_zeroed: memory - 1, ..Use::default() };
        Sized { chip, file: flash, used, ceilings: CEILINGS }
    }

    #[test]
    fn an_image_at_its_ceilings_passes() {
        assert!(verdict(&image(Chip::Esp32c6, CEILINGS.flash, CEILINGS.memory)).is_ok());
    }

    #[test]
    fn a_byte_above_a_ceiling_fails_and_is_told() {
        for (flash, memory) in [(CEILINGS.flash + 1, 1), (0, CEILINGS.memory + 1)] {
            let message = verdict(&image(Chip::Esp32, flash, memory)).unwrap_err().to_string();
            assert!(message.contains("of the ESP32 takes"), "{message}");
            assert!(message.contains("1 more than its ceiling"), "{message}");
        }
    }

    #[test]
    fn chips_stand_beside_each_other() {
        let table = table(&[image(Chip::Esp32c6, 2048, 1024), image(Chip::Esp32, 4096, 3072)]);
        let lines: Vec<&str> = table.lines().collect();
        let heads =
            "| | ESP32-C6, bytes | KiB | ceiling, KiB | ESP32, bytes | KiB | ceiling, KiB |";
        assert_eq!(lines[..2], [heads, "|---|---:|---:|---:|---:|---:|---:|"]);
        assert_eq!(lines[2], "| flash: image | 2048 | 2.0 | 1000 | 4096 | 4.0 | 1000 |");
        assert_eq!(lines[5], "| of this, heap | 0 | 0.0 |  | 0 | 0.0 |  |");
    }
}
