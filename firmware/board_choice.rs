//! Chip, board and options that the cargo features ask for, or one sentence on why they cannot
//! be had together. Shared by the build script, its test and `cargo xtask`.

/// Boards, the chip that each carries, and whether it is the chip's default.
pub(crate) const BOARDS: [(&str, &str, bool); 6] = [
    ("mks-dual-foc-v3-1", "esp32", false),
    ("mks-dual-foc-v3-3-plus", "esp32", true),
    ("mks-esp32-foc-v1-0", "esp32", false),
    ("dengfoc-v3-01", "esp32", false),
    ("generic-esp32s3", "esp32s3", true),
    ("generic-esp32c6", "esp32c6", true),
];

const CHIPS: [&str; 3] = ["esp32", "esp32s3", "esp32c6"];
/// What the compiler calls the chips.
const TARGETS: [(&str, &str); 3] = [
    ("esp32", "xtensa-esp32-none-elf"),
    ("esp32s3", "xtensa-esp32s3-none-elf"),
    ("esp32c6", "riscv32imac-unknown-none-elf"),
];
const ENCODERS: [&str; 3] = ["encoder-as5600", "encoder-mt6701", "encoder-as5047p"];

/// What the features ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Choice {
    /// Chip feature.
    pub(crate) chip: &'static str,
    /// Board feature.
    pub(crate) board: &'static str,
    /// Encoder feature, where it is not the board's own.
    pub(crate) encoder: Option<&'static str>,
}

/// The one of `known` that is asked for, or a sentence when there are several.
fn at_most_one(
    known: &[&'static str],
    has: &dyn Fn(&str) -> bool,
    kind: &str,
) -> Result<Option<&'static str>, String> {
    let asked: Vec<_> = known.iter().copied().filter(|name| has(name)).collect();
    match asked[..] {
        [] => Ok(None),
        [one] => Ok(Some(one)),
        _ => Err(format!("one {kind} at a time, not {}", asked.join(" and "))),
    }
}

/// Reads the features. `None` where no chip is asked for: the library is built for this computer.
pub(crate) fn choose(has: &dyn Fn(&str) -> bool, target: &str) -> Result<Option<Choice>, String> {
    let Some(chip) = at_most_one(&CHIPS, has, "chip")? else { return Ok(None) };
    if !TARGETS.contains(&(chip, target)) {
        return Err(format!("{target} is not the {chip}: use cargo xtask build {chip}"));
    }
    let board = match at_most_one(&BOARDS.map(|(board, ..)| board), has, "board")? {
        Some(board) => board,
        None => match BOARDS.iter().find(|(_, on, default)| *on == chip && *default) {
            Some((board, ..)) => board,
            None => return Err(format!("no board carries the {chip}")),
        },
    };
    if let Some((_, carries, _)) = BOARDS.iter().find(|(name, ..)| *name == board)
        && *carries != chip
    {
        return Err(format!(
            "the board {board} carries the {carries}, not the {chip}: \
             use --features {carries},{board}"
        ));
    }
    let encoder = at_most_one(&ENCODERS, has, "encoder")?;
    if chip == "esp32c6" && encoder == Some("encoder-as5600") {
        return Err("two AS5600 share one address and the esp32c6 has one I2C master: \
             use --features encoder-mt6701 or encoder-as5047p"
            .into());
    }
    if has("current-sense") && board != "generic-esp32s3" {
        return Err(format!(
            "current-sense is for amplifiers added to the board generic-esp32s3; \
             {board} has what it has"
        ));
    }
    Ok(Some(Choice { chip, board, encoder }))
}
