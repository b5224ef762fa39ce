//! The chips, their targets, and the options that become cargo features.

#[path = "../../board_choice.rs"]
#[expect(dead_code, reason = "the build script chooses; here boards are listed")]
mod board_choice;

use clap::{Args, ValueEnum};

use board_choice::BOARDS;

/// A chip that the firmware is built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Chip {
    /// ESP32: the paper's chip, Xtensa.
    Esp32,
    /// ESP32-S3: Xtensa.
    Esp32s3,
    /// ESP32-C6: RISC-V.
    Esp32c6,
}

impl Chip {
    /// Returns the name of the cargo feature, and of the chip in Espressif's programs.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Esp32 => "esp32",
            Self::Esp32s3 => "esp32s3",
            Self::Esp32c6 => "esp32c6",
        }
    }

    /// Returns the chip's name for people.
    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Esp32 => "ESP32",
            Self::Esp32s3 => "ESP32-S3",
            Self::Esp32c6 => "ESP32-C6",
        }
    }

    /// Returns the compiler's target.
    pub(crate) fn target(self) -> &'static str {
        match self {
            Self::Esp32 => "xtensa-esp32-none-elf",
            Self::Esp32s3 => "xtensa-esp32s3-none-elf",
            Self::Esp32c6 => RISCV_TARGET,
        }
    }

    /// Boards that carry the chip.
    fn boards(self) -> impl Iterator<Item = &'static str> {
        BOARDS.iter().filter(move |(_, chip, _)| *chip == self.name()).map(|(board, ..)| *board)
    }

    /// Encoders that the chip can read two of, the default first.
    pub(crate) fn encoders(self) -> &'static [&'static str] {
        match self {
            Self::Esp32 | Self::Esp32s3 => &["as5600", "mt6701", "as5047p"],
            Self::Esp32c6 => &["mt6701", "as5047p"],
        }
    }
}

/// Target of the ESP32-C6 and of the emulated processor.
pub(crate) const RISCV_TARGET: &str = "riscv32imac-unknown-none-elf";

/// Board, encoder and added electronics.
#[derive(Debug, Clone, Default, PartialEq, Eq, Args)]
pub(crate) struct Options {
    /// The board, for example dengfoc-v3-01; the chip's default without it.
    #[arg(long)]
    pub(crate) board: Option<String>,
    /// The encoders, where they are not those the board is sold with.
    #[arg(long, value_parser = ["as5600", "mt6701", "as5047p"])]
    pub(crate) encoder: Option<String>,
    /// A battery divider (100 kiloohms over 22 kiloohms) is wired to the board's option pin.
    #[arg(long)]
    pub(crate) battery_divider: bool,
    /// The driver boards on a generic ESP32-S3 measure phase currents (0.5 V/A around 1.65 V).
    #[arg(long)]
    pub(crate) current_sense: bool,
}

impl Options {
    /// Returns the cargo features of these options on a chip, comma-separated.
    pub(crate) fn features(&self, chip: Chip) -> String {
        let mut features = vec![chip.name().to_string()];
        features.extend(self.board.clone());
        features.extend(self.encoder.as_ref().map(|encoder| format!("encoder-{encoder}")));
        features.extend(self.battery_divider.then(|| "battery-divider".into()));
        features.extend(self.current_sense.then(|| "current-sense".into()));
        features.join(",")
    }

    /// Returns these options, or, when nothing is chosen, enough variants to compile every board, every
    /// encoder and every option of the chip once.
    pub(crate) fn variants(&self, chip: Chip) -> Vec<Self> {
        if *self != Self::default() {
            return vec![self.clone()];
        }
        let boards =
            chip.boards().map(|board| Self { board: Some(board.into()), ..Self::default() });
        let encoders = chip
            .encoders()
            .iter()
            .skip(1)
            .map(|encoder| Self { encoder: Some((*encoder).into()), ..Self::default() });
        let added =
            Self { battery_divider: true, current_sense: chip == Chip::Esp32s3, ..Self::default() };
        boards.chain(encoders).chain([added]).collect()
    }
}
