//! The board that the cargo features chose, as one constant, checked while compiling.

use flix_firmware::board::{Board, BoardError, EncoderKind};

/// The board, with its encoders and added electronics.
pub(crate) const BOARD: Board = {
    let Some(board) = Board::named(env!("FLIX_BOARD")) else {
        panic!("the build script chose a board that the library does not know")
    };
    let mut board = *board;
    if cfg!(feature = "current-sense") {
        board = board.with_current_sense();
    }
    if cfg!(feature = "battery-divider") {
        board = board.with_battery_divider();
    }
    if let Some(encoder) = EncoderKind::named(env!("FLIX_ENCODER")) {
        board = board.with_encoder(encoder);
    }
    board
};

const _: () = match BOARD.check() {
    Ok(()) => {}
    Err(BoardError::PinUsedTwice(_)) => panic!("the chosen board uses a pin twice"),
    Err(BoardError::CannotDrive(_)) => panic!("the chosen board drives a pin that cannot"),
    Err(BoardError::NotOnAdc1(_)) => panic!("the chosen board measures a pin that is not on ADC1"),
    Err(BoardError::OneI2cMaster) => panic!("two AS5600 need two I2C masters"),
    Err(BoardError::TooSlowForCurrents) => panic!("this chip cannot sample phase currents in time"),
};
