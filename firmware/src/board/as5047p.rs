//! The driver of one AS5047P on SPI: which command goes out in each tick, and what its answer means, which comes with the
//! next transfer.
//!
//! The encoder latches an error flag when it receives a frame that is cut short, has odd parity or names no register. From
//! then on every answer carries the flag, until the error register is read (data sheet v1-08, ERRFL): so it is read as soon as
//! the flag is seen, and the third tick after that has an angle again. An answer that cannot be read says nothing about the
//! encoder: it is asked again.

use super::encoder::{
    AS5047P_READ_ANGLE, AS5047P_READ_DIAGNOSTICS, AS5047P_READ_ERRORS, as5047p, as5047p_has_error,
    as5047p_is_answer, as5047p_is_healthy, as5047p_magnet,
};
use crate::hardware::{EncoderAngle, Magnet};

/// One transfer in so many asks for the diagnostics.
const DIAGNOSTICS_EVERY: u16 = 64;

/// So many bad diagnostics in a row are believed. Until they are good again they are asked for in every other transfer.
const BAD_DIAGNOSTICS: u8 = 2;

/// What a transfer asks for, and the next one answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Register {
    Angle,
    Diagnostics,
    Errors,
}

impl Register {
    const fn command(self) -> [u8; 2] {
        match self {
            Self::Angle => AS5047P_READ_ANGLE,
            Self::Diagnostics => AS5047P_READ_DIAGNOSTICS,
            Self::Errors => AS5047P_READ_ERRORS,
        }
    }
}

/// What a transfer brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum As5047pReading {
    /// The angle at the end of the transfer before.
    Angle(EncoderAngle),
    /// The answer to something else than the angle.
    Other,
    /// No answer, a wrong one, one with the error flag, or an encoder that sees no good magnet.
    Failed,
}

/// What is known of an AS5047P.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct As5047p {
    /// What the transfer before asked for; nothing yet after a start.
    asked: Option<Register>,
    /// Transfers since the diagnostics were answered, that one included.
    since_diagnostics: u16,
    /// Bad diagnostics in a row: one may be the answer to a command that was disturbed.
    bad_diagnostics: u8,
    has_error: bool,
    magnet: Magnet,
}

impl Default for As5047p {
    fn default() -> Self {
        Self::new()
    }
}

impl As5047p {
    /// Knows nothing yet, and takes the encoder for healthy.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            asked: None,
            since_diagnostics: 0,
            bad_diagnostics: 0,
            has_error: false,
            magnet: Magnet::Good,
        }
    }

    const fn is_healthy(&self) -> bool {
        self.bad_diagnostics < BAD_DIAGNOSTICS
    }

    /// Returns what it last said of its magnet, twice in a row if it is not good.
    #[must_use]
    pub const fn magnet(&self) -> Magnet {
        self.magnet
    }

    /// Does the tick's transfer, which `transfer` carries out: a command goes out, the answer to the one before comes in, or
    /// nothing when the bus failed. Never panics.
    pub fn read(&mut self, transfer: impl FnOnce([u8; 2]) -> Option<[u8; 2]>) -> As5047pReading {
        self.since_diagnostics = self.since_diagnostics.saturating_add(1);
        let register = if self.has_error {
            Register::Errors
        } else if self.since_diagnostics >= DIAGNOSTICS_EVERY && self.asked == Some(Register::Angle)
        {
            Register::Diagnostics
        } else {
            Register::Angle
        };
        // The answer to the error register's command may still carry the flag.
        let is_cleared = self.asked == Some(Register::Errors);
        let answer = transfer(register.command());
        let answers = self.asked.replace(register);
        self.has_error =
            answer.is_some_and(as5047p_has_error) && register != Register::Errors && !is_cleared;
        match (answers, answer) {
            (Some(Register::Diagnostics), Some(answer)) if as5047p_is_answer(answer) => {
                if as5047p_is_healthy(answer) {
                    (self.since_diagnostics, self.bad_diagnostics) = (1, 0);
                } else {
                    self.bad_diagnostics = self.bad_diagnostics.saturating_add(1);
                }
                if let Some(magnet) = as5047p_magnet(answer)
                    && (magnet == Magnet::Good || !self.is_healthy())
                {
                    self.magnet = magnet;
                }
                if self.is_healthy() { As5047pReading::Other } else { As5047pReading::Failed }
            }
            (Some(Register::Angle), Some(answer)) if self.is_healthy() => {
                as5047p(answer).map_or(As5047pReading::Failed, As5047pReading::Angle)
            }
            (Some(Register::Errors) | None, Some(_)) if self.is_healthy() => As5047pReading::Other,
            _ => As5047pReading::Failed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An AS5047P that always stands at half a turn, and latches errors.
    #[derive(Default)]
    struct Part {
        answer: u16,
        errors: u16,
        /// Diagnostics besides "ready".
        field: u16,
        /// What is flipped in the next command, and in the next answer.
        flips: (u16, u16),
    }

    const HALF_TURN: EncoderAngle = EncoderAngle::from_raw(1 << 31);
    const ANGLE: As5047pReading = As5047pReading::Angle(HALF_TURN);

    impl Part {
        fn transfer(&mut self, command: [u8; 2]) -> Option<[u8; 2]> {
            let (command_flips, answer_flips) = core::mem::take(&mut self.flips);
            let command = u16::from_be_bytes(command) ^ command_flips;
            let answer = self.answer ^ answer_flips;
            let data = match command & 0x3FFF {
                0x3FFF => 0x2000,
                0x3FFC => 0x0180 | self.field,
                0x0001 => core::mem::take(&mut self.errors),
                _ => {
                    self.errors |= 0b010;
                    0
                }
            };
            if command.count_ones() % 2 == 1 {
                self.errors |= 0b100;
            }
            let flag = u16::from(self.errors != 0) << 14;
            let word = data | flag;
            self.answer = word | ((word.count_ones() % 2) as u16) << 15;
            Some(answer.to_be_bytes())
        }
    }

    fn read(driver: &mut As5047p, part: &mut Part) -> As5047pReading {
        driver.read(|command| part.transfer(command))
    }

    #[test]
    fn the_angle_comes_in_all_ticks_but_those_of_the_diagnostics() {
        let (mut driver, mut part) = (As5047p::new(), Part::default());
        assert_eq!(read(&mut driver, &mut part), As5047pReading::Other);
        for tick in 1..1_000 {
            let is_diagnostics = tick % u32::from(DIAGNOSTICS_EVERY) == 0;
            let wanted = if is_diagnostics { As5047pReading::Other } else { ANGLE };
            assert_eq!(read(&mut driver, &mut part), wanted, "tick {tick}");
        }
    }

    #[test]
    fn any_bits_that_are_wrong_once_cost_four_ticks_at_most() {
        for tick in 1..150 {
            for (command, answer) in
                (0..16).flat_map(|bit| [(1 << bit, 0), (0, 1 << bit), (3 << bit, 0), (0, 3 << bit)])
            {
                let (mut driver, mut part) = (As5047p::new(), Part::default());
                for _ in 0..tick {
                    read(&mut driver, &mut part);
                }
                part.flips = (command, answer);
                read(&mut driver, &mut part);
                let after = (0..4).filter(|_| read(&mut driver, &mut part) == ANGLE).count();
                assert!(after > 0, "tick {tick}, bits {command:04X} {answer:04X}");
            }
        }
    }

    #[test]
    fn an_error_flag_that_was_latched_before_the_start_is_cleared() {
        let (mut driver, mut part) = (As5047p::new(), Part { errors: 0b001, ..Part::default() });
        let first = (0..6).position(|_| read(&mut driver, &mut part) == ANGLE);
        assert_eq!(first, Some(4));
    }

    #[test]
    fn a_line_that_is_disturbed_again_and_again_gives_angles_in_between() {
        let (mut driver, mut part) = (As5047p::new(), Part::default());
        let mut angles = 0;
        for tick in 0..1_000 {
            if tick % 10 == 0 {
                part.flips.0 = 1 << (tick % 16);
            }
            angles += u32::from(read(&mut driver, &mut part) == ANGLE);
        }
        assert!(angles > 550, "{angles} angles in 1,000 ticks");
    }

    #[test]
    fn a_bad_field_is_no_angle_until_it_is_good_again() {
        let (mut driver, mut part) = (As5047p::new(), Part { field: 1 << 11, ..Part::default() });
        let mut last =
            |part: &mut Part| (0..2 * DIAGNOSTICS_EVERY).map(|_| read(&mut driver, part)).last();
        assert_eq!(last(&mut part), Some(As5047pReading::Failed));
        part.field = 0;
        assert_eq!(last(&mut part), Some(ANGLE));
    }

    #[test]
    fn a_magnet_that_is_too_weak_or_too_strong_is_named_until_it_is_good_again() {
        let (mut driver, mut part) = (As5047p::new(), Part::default());
        let cases = [
            (0, Magnet::Good),
            (1 << 11, Magnet::Weak),
            (1 << 10, Magnet::Strong),
            (0, Magnet::Good),
        ];
        for (field, magnet) in cases {
            part.field = field;
            for _ in 0..2 * DIAGNOSTICS_EVERY {
                read(&mut driver, &mut part);
            }
            assert_eq!(driver.magnet(), magnet);
        }
    }

    #[test]
    fn diagnostics_that_cannot_be_read_are_asked_for_again() {
        let (mut driver, mut part) = (As5047p::new(), Part::default());
        for tick in 0..200 {
            // The answer's parity is wrong.
            let before = read(&mut driver, &mut part);
            if before == As5047pReading::Other && tick > 0 {
                continue;
            }
            part.flips.1 = u16::from(driver.asked == Some(Register::Diagnostics));
        }
        let angles = (0..4).filter(|_| read(&mut driver, &mut part) == ANGLE).count();
        assert!(angles > 0 && driver.is_healthy());
    }

    #[test]
    fn nobody_there_is_a_failure() {
        let mut driver = As5047p::new();
        for _ in 0..200 {
            assert_ne!(driver.read(|_| Some([0xFF; 2])), ANGLE);
        }
        assert_eq!(driver.read(|_| Some([0xFF; 2])), As5047pReading::Failed);
        assert_eq!(driver.read(|_| None), As5047pReading::Failed);
    }
}
