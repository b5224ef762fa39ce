//! The frames of the encoders: bytes on the bus to an angle, or to nothing when they are wrong.
//!
//! Sources: ams AS5600 data sheet (registers STATUS, RAW ANGLE), ams AS5047P data sheet (SPI
//! frames, parity, DIAAGC), MagnTek MT6701 data sheet (SSI frame, CRC-6). Angles come out
//! left-aligned ([`EncoderAngle`]), as [`EncoderReading`](crate::hardware::EncoderReading) wants them.

use crate::hardware::EncoderAngle;

/// AS5600: I2C address.
pub const AS5600_ADDRESS: u8 = 0x36;
/// AS5600: STATUS, followed by the two bytes of RAW ANGLE: three bytes a reading.
pub const AS5600_STATUS_REGISTER: u8 = 0x0B;
/// AS5600: CONF, two bytes, which last until its supply goes.
pub const AS5600_CONFIGURATION_REGISTER: u8 = 0x07;
/// AS5600 CONF: always on, no hysteresis, its least filter (SF = 2x), which settles in 0.29 ms. Out of the box it is 16x,
/// 2.2 ms: at 35 Hz and 7 pole pairs 97 electrical degrees.
pub const AS5600_CONFIGURATION: [u8; 2] = [0x03, 0x00];
/// AS5600 STATUS: a magnet is there.
const AS5600_MAGNET_DETECTED: u8 = 1 << 5;
/// AS5600 and its brothers: 12 bits.
const TWELVE_BITS: u32 = 12;
/// AS5047P and MT6701: 14 bits.
const FOURTEEN_BITS: u32 = 14;

/// Reads the three bytes from [`AS5600_STATUS_REGISTER`] on. `None` without a magnet.
#[must_use]
pub fn as5600(frame: [u8; 3]) -> Option<EncoderAngle> {
    let [status, high, low] = frame;
    let angle = u32::from(high & 0x0F) << 8 | u32::from(low);
    (status & AS5600_MAGNET_DETECTED != 0).then_some(EncoderAngle::from_count(angle, TWELVE_BITS))
}

/// MT6701 status: the field is too strong, too weak, or over-speed makes the angle worthless.
const MT6701_FIELD: u8 = 0b0011;
/// MT6701 status: loss of track.
const MT6701_LOSS_OF_TRACK: u8 = 0b1000;
/// MT6701: x^6 + x + 1.
const MT6701_POLYNOMIAL: u8 = 0b000_0011;

/// Returns the CRC-6 over the 18 bits of angle and status, most significant first.
fn mt6701_crc(bits: u32) -> u8 {
    (0..18).rev().fold(0, |crc, bit| {
        let feedback = (crc >> 5 & 1) ^ (bits >> bit & 1) as u8;
        (crc << 1 & 0x3F) ^ if feedback == 1 { MT6701_POLYNOMIAL } else { 0 }
    })
}

/// Reads the three bytes of an MT6701's SSI frame: 14 bits of angle, 4 of status, 6 of CRC.
/// `None` when the check sum is wrong, the field out of range or the track lost.
#[must_use]
pub fn mt6701(frame: [u8; 3]) -> Option<EncoderAngle> {
    let [first, second, third] = frame;
    let word = u32::from(first) << 16 | u32::from(second) << 8 | u32::from(third);
    let (payload, crc) = (word >> 6, (word & 0x3F) as u8);
    let (angle, status) = (payload >> 4, (payload & 0x0F) as u8);
    let field_good = matches!(status & MT6701_FIELD, 0);
    let good = mt6701_crc(payload) == crc && field_good && status & MT6701_LOSS_OF_TRACK == 0;
    good.then_some(EncoderAngle::from_count(angle, FOURTEEN_BITS))
}

/// AS5047P: read ANGLECOM (0x3FFF), with the read bit; its parity is even without the top bit.
pub const AS5047P_READ_ANGLE: [u8; 2] = [0xFF, 0xFF];
/// AS5047P: read DIAAGC (0x3FFC); parity even, as above.
pub const AS5047P_READ_DIAGNOSTICS: [u8; 2] = [0xFF, 0xFC];
/// AS5047P: read ERRFL (0x0001), which clears the error flag; parity even, as above.
pub const AS5047P_READ_ERRORS: [u8; 2] = [0x40, 0x01];
/// AS5047P DIAAGC: the field is too weak, too strong, or the angle computation overflowed.
const AS5047P_FIELD: u16 = 1 << 11 | 1 << 10 | 1 << 9;
/// AS5047P DIAAGC: offset compensation has finished; set whenever the encoder works.
const AS5047P_READY: u16 = 1 << 8;
/// AS5047P: a command was wrong since [`AS5047P_READ_ERRORS`].
const AS5047P_ERROR: u16 = 1 << 14;
/// AS5047P: the 14 bits of data.
const AS5047P_DATA: u16 = 0x3FFF;

/// Returns whether somebody answers, without a wrong bit.
const fn as5047p_is_word(word: u16) -> bool {
    word != u16::MAX && word.count_ones().is_multiple_of(2)
}

/// Returns whether an answer can be read and carries the error flag, which every answer does until
/// [`AS5047P_READ_ERRORS`].
#[must_use]
pub const fn as5047p_has_error(frame: [u8; 2]) -> bool {
    let word = u16::from_be_bytes(frame);
    as5047p_is_word(word) && word & AS5047P_ERROR != 0
}

/// Returns whether an answer can be read and carries no error flag.
#[must_use]
pub const fn as5047p_is_answer(frame: [u8; 2]) -> bool {
    let word = u16::from_be_bytes(frame);
    as5047p_is_word(word) && word & AS5047P_ERROR == 0
}

/// Returns the data of an answer: parity, error flag, 14 bits. `None` when parity is odd, the error flag
/// set, or nobody answers (the bus is pulled up).
fn as5047p_data(frame: [u8; 2]) -> Option<u16> {
    as5047p_is_answer(frame).then_some(u16::from_be_bytes(frame) & AS5047P_DATA)
}

/// Reads the answer to [`AS5047P_READ_ANGLE`], which comes with the next transfer.
#[must_use]
pub fn as5047p(frame: [u8; 2]) -> Option<EncoderAngle> {
    as5047p_data(frame).map(|angle| EncoderAngle::from_count(angle.into(), FOURTEEN_BITS))
}

/// Reads the answer to [`AS5047P_READ_DIAGNOSTICS`]: whether a magnet is there and the angle good.
#[must_use]
pub fn as5047p_is_healthy(frame: [u8; 2]) -> bool {
    as5047p_data(frame).is_some_and(|d| d & AS5047P_READY != 0 && d & AS5047P_FIELD == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as5600_angle_fills_the_upper_twelve_bits() {
        assert_eq!(as5600([0x20, 0x08, 0x00]), Some(EncoderAngle::from_raw(1 << 31)));
        assert_eq!(as5600([0x20, 0xFF, 0xFF]), Some(EncoderAngle::from_raw(0xFFF0_0000)));
    }

    #[test]
    fn as5600_without_a_magnet_gives_nothing() {
        assert_eq!(as5600([0x00, 0x08, 0x00]), None);
    }

    fn mt6701_frame(angle: u32, status: u32) -> [u8; 3] {
        let payload = angle << 4 | status;
        let [_, first, second, third] =
            (payload << 6 | u32::from(mt6701_crc(payload))).to_be_bytes();
        [first, second, third]
    }

    #[test]
    fn mt6701_angle_fills_the_upper_fourteen_bits() {
        assert_eq!(mt6701(mt6701_frame(0x2000, 0)), Some(EncoderAngle::from_raw(1 << 31)));
        assert_eq!(mt6701(mt6701_frame(0x3FFF, 0)), Some(EncoderAngle::from_raw(0xFFFC_0000)));
    }

    #[test]
    fn mt6701_crc_is_that_of_its_polynomial() {
        // x^6 mod (x^6 + x + 1) = x + 1, for a one in the last of the 18 bits.
        assert_eq!(mt6701_crc(1), 0b11);
        assert_eq!(mt6701_crc(1 << 1), 0b110);
    }

    #[test]
    fn mt6701_refuses_any_single_wrong_bit() {
        let good = mt6701_frame(0x1234, 0);
        for bit in 0..24 {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(mt6701(bad), None, "bit {bit}");
        }
    }

    #[test]
    fn mt6701_without_a_good_magnet_gives_nothing() {
        for status in [0b0001, 0b0010, 0b1000] {
            assert_eq!(mt6701(mt6701_frame(0x1234, status)), None, "status {status:04b}");
        }
    }

    #[test]
    fn mt6701_push_button_is_not_a_fault() {
        assert!(mt6701(mt6701_frame(0x1234, 0b0100)).is_some());
    }

    #[test]
    fn as5047p_angle_fills_the_upper_fourteen_bits() {
        // 0x2000 has one set bit: the parity bit makes it even.
        assert_eq!(as5047p([0xA0, 0x00]), Some(EncoderAngle::from_raw(1 << 31)));
    }

    #[test]
    fn as5047p_refuses_any_single_wrong_bit() {
        for bit in 0..16 {
            let word = 0x2923_u16;
            assert!(as5047p(word.to_be_bytes()).is_some());
            assert_eq!(as5047p((word ^ 1 << bit).to_be_bytes()), None, "bit {bit}");
        }
    }

    #[test]
    fn as5047p_commands_have_even_parity() {
        for command in [AS5047P_READ_ANGLE, AS5047P_READ_DIAGNOSTICS, AS5047P_READ_ERRORS] {
            assert_eq!(u16::from_be_bytes(command).count_ones() % 2, 0, "{command:02X?}");
        }
    }

    #[test]
    fn as5047p_without_a_magnet_is_not_healthy() {
        assert!(as5047p_is_healthy([0x01, 0x01]));
        // Ready, but the field too weak (bit 11).
        assert!(!as5047p_is_healthy([0x09, 0x00]));
        // A dead bus that reads as zeros.
        assert!(!as5047p_is_healthy([0x00, 0x00]));
    }

    #[test]
    fn a_pulled_up_bus_without_an_encoder_is_not_an_angle() {
        assert_eq!(as5047p([0xFF, 0xFF]), None);
        assert_eq!(mt6701([0xFF, 0xFF, 0xFF]), None);
    }
}
