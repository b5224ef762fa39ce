//! The features of the chip binary: sensible defaults, and one sentence where they contradict.

use crate::choice::{Choice, choose};
use flix_firmware::board::{BOARDS, Board, Chip, EncoderKind};

/// The cargo feature that selects a chip.
fn feature(chip: Chip) -> String {
    format!("{chip:?}").to_lowercase()
}

/// On the target of the first feature, which is the chip.
fn chosen(features: &[&str]) -> Result<Option<Choice>, String> {
    let target = match features.first() {
        Some(&"esp32c6") => "riscv32imac-unknown-none-elf",
        Some(chip) => &format!("xtensa-{chip}-none-elf"),
        None => "x86_64-unknown-linux-gnu",
    };
    choose(&|feature| features.contains(&feature), target)
}

#[test]
fn a_chip_is_not_built_for_this_computer() {
    let refusal = choose(&|feature| feature == "esp32", "x86_64-unknown-linux-gnu").unwrap_err();
    assert!(refusal.contains("cargo xtask build esp32"), "{refusal}");
}

#[test]
fn the_host_chooses_no_board() {
    assert_eq!(chosen(&[]), Ok(None));
}

#[test]
fn the_esp32_defaults_to_the_v3_3_plus() {
    let choice = chosen(&["esp32"]).unwrap().unwrap();
    assert_eq!(choice.board, "mks-dual-foc-v3-3-plus");
}

#[test]
fn every_board_can_be_chosen_on_its_chip_and_on_no_other() {
    for board in BOARDS {
        for chip in ["esp32", "esp32s3", "esp32c6"] {
            let choice = chosen(&[chip, board.feature]);
            if feature(board.chip) == chip {
                assert_eq!(choice.unwrap().unwrap().board, board.feature);
            } else {
                let sentence = choice.unwrap_err();
                assert!(sentence.contains(&feature(board.chip)), "{sentence}");
            }
        }
    }
}

#[test]
fn every_default_is_a_board_of_that_chip() {
    for chip in ["esp32", "esp32s3", "esp32c6"] {
        let choice = chosen(&[chip]).unwrap().unwrap();
        assert_eq!(feature(Board::named(choice.board).unwrap().chip), chip);
    }
}

#[test]
fn two_of_a_kind_are_refused() {
    for features in [
        &["esp32", "esp32c6"][..],
        &["esp32", "dengfoc-v3-01", "mks-dual-foc-v3-1"],
        &["esp32", "encoder-mt6701", "encoder-as5047p"],
    ] {
        assert!(chosen(features).is_err(), "{features:?}");
    }
}

#[test]
fn two_as5600_on_one_i2c_master_are_refused() {
    assert!(chosen(&["esp32c6", "encoder-as5600"]).unwrap_err().contains("encoder-mt6701"));
}

#[test]
fn encoder_features_name_encoders() {
    for (feature, kind) in [
        ("encoder-as5600", EncoderKind::As5600),
        ("encoder-mt6701", EncoderKind::Mt6701),
        ("encoder-as5047p", EncoderKind::As5047p),
    ] {
        let choice = chosen(&["esp32", feature]).unwrap().unwrap();
        assert_eq!(choice.encoder.and_then(EncoderKind::named), Some(kind));
    }
}
