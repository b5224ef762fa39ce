//! The frames of the encoders: bytes on the bus to an angle, or to nothing when they are wrong.
//!
//! Sources: ams AS5600 data sheet (registers STATUS, RAW ANGLE), ams AS5047P data sheet (SPI
//! frames, parity, DIAAGC), MagnTek MT6701 data sheet (SSI frame, CRC-6). Angles come out
//! left-aligned ([`EncoderAngle`]), as [`EncoderReading`](crate::hardware::EncoderReading) wants them.

use crate::hardware::{EncoderAngle, Magnet};

/// AS5600: I2C address.
pub const AS5600_ADDRESS: u8 = 0x36;
/// AS5600: STATUS, one byte.
pub const AS5600_STATUS_REGISTER: u8 = 0x0B;
/// AS5600: RAW ANGLE, two bytes. Once it was addressed, it can be read again and again without its address: reading it leaves
/// the part's address pointer where it is (data sheet, "Automatic Increment of the Address Pointer").
pub const AS5600_ANGLE_REGISTER: u8 = 0x0C;
/// AS5600: CONF, two bytes, which last until its supply goes.
pub const AS5600_CONFIGURATION_REGISTER: u8 = 0x07;
/// AS5600 CONF: always on, no hysteresis, its least filter (SF = 2x), which settles in 0.29 ms. Out of the box it is 16x,
/// 2.2 ms: at 35 Hz and 7 pole pairs 97 electrical degrees.
pub const AS5600_CONFIGURATION: [u8; 2] = [0x03, 0x00];
/// AS5600 CONF: the bits that mean something. The two others are reserved and keep what the part was made with.
pub const AS5600_CONFIGURATION_BITS: [u8; 2] = [0x3F, 0xFF];
/// AS5600 STATUS: a magnet is there.
const AS5600_MAGNET_DETECTED: u8 = 1 << 5;
/// AS5600 STATUS, ML: the gain is at its largest, the magnet too weak.
const AS5600_MAGNET_WEAK: u8 = 1 << 4;
/// AS5600 STATUS, MH: the gain is at its smallest, the magnet too strong.
const AS5600_MAGNET_STRONG: u8 = 1 << 3;
/// AS5600 and its brothers: 12 bits.
const TWELVE_BITS: u32 = 12;
/// AS5047P and MT6701: 14 bits.
const FOURTEEN_BITS: u32 = 14;

/// Reads the two bytes of [`AS5600_ANGLE_REGISTER`]: an angle only where there is a magnet ([`as5600_magnet`]).
#[must_use]
pub const fn as5600([high, low]: [u8; 2]) -> EncoderAngle {
    EncoderAngle::from_count((high as u32 & 0x0F) << 8 | low as u32, TWELVE_BITS)
}

/// Reads what the byte of [`AS5600_STATUS_REGISTER`] says of the magnet; `None` where it says that the magnet is both too weak and
/// too strong, which no AS5600 says. Too weak or too strong, there is an angle still, with more noise.
#[must_use]
pub const fn as5600_magnet(status: u8) -> Option<Magnet> {
    const BOTH: u8 = AS5600_MAGNET_WEAK | AS5600_MAGNET_STRONG;
    Some(if status & BOTH == BOTH {
        return None;
    } else if status & AS5600_MAGNET_DETECTED == 0 {
        Magnet::Missing
    } else if status & AS5600_MAGNET_STRONG != 0 {
        Magnet::Strong
    } else if status & AS5600_MAGNET_WEAK != 0 {
        Magnet::Weak
    } else {
        Magnet::Good
    })
}

/// MT6701 status: the field is too strong (1), too weak (2), or both bits.
const MT6701_FIELD: u8 = 0b0011;
/// MT6701 status: the field is too strong.
const MT6701_STRONG: u8 = 0b0001;
/// MT6701 status: the field is too weak.
const MT6701_WEAK: u8 = 0b0010;
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
    let (angle, status) = mt6701_parts(frame)?;
    let good = status & (MT6701_FIELD | MT6701_LOSS_OF_TRACK) == 0;
    good.then_some(EncoderAngle::from_count(angle, FOURTEEN_BITS))
}

/// Reads what an MT6701's frame says of the magnet; `None` when the check sum is wrong.
#[must_use]
pub fn mt6701_magnet(frame: [u8; 3]) -> Option<Magnet> {
    let (_, status) = mt6701_parts(frame)?;
    Some(match status & MT6701_FIELD {
        MT6701_STRONG => Magnet::Strong,
        MT6701_WEAK => Magnet::Weak,
        _ => Magnet::Good,
    })
}

/// Angle and status of a frame; `None` when the check sum is wrong.
fn mt6701_parts([first, second, third]: [u8; 3]) -> Option<(u32, u8)> {
    let word = u32::from(first) << 16 | u32::from(second) << 8 | u32::from(third);
    let (payload, crc) = (word >> 6, (word & 0x3F) as u8);
    (mt6701_crc(payload) == crc).then_some((payload >> 4, (payload & 0x0F) as u8))
}

/// AS5047P: read ANGLECOM (0x3FFF), with the read bit; its parity is even without the top bit.
pub const AS5047P_READ_ANGLE: [u8; 2] = [0xFF, 0xFF];
/// AS5047P: read DIAAGC (0x3FFC); parity even, as above.
pub const AS5047P_READ_DIAGNOSTICS: [u8; 2] = [0xFF, 0xFC];
/// AS5047P: read ERRFL (0x0001), which clears the error flag; parity even, as above.
pub const AS5047P_READ_ERRORS: [u8; 2] = [0x40, 0x01];
/// AS5047P DIAAGC, MAGL: the field is too weak.
const AS5047P_WEAK: u16 = 1 << 11;
/// AS5047P DIAAGC, MAGH: the field is too strong.
const AS5047P_STRONG: u16 = 1 << 10;
/// AS5047P DIAAGC: the field is too weak, too strong, or the angle computation overflowed.
const AS5047P_FIELD: u16 = AS5047P_WEAK | AS5047P_STRONG | 1 << 9;
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

/// Reads what the answer to [`AS5047P_READ_DIAGNOSTICS`] says of the magnet; `None` when it cannot be read.
#[must_use]
pub fn as5047p_magnet(frame: [u8; 2]) -> Option<Magnet> {
    let diagnostics = as5047p_data(frame).filter(|data| data & AS5047P_READY != 0)?;
    Some(match diagnostics {
        it if it & AS5047P_WEAK != 0 => Magnet::Weak,
        it if it & AS5047P_STRONG != 0 => Magnet::Strong,
        _ => Magnet::Good,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as5600_angle_fills_the_upper_twelve_bits() {
        assert_eq!(as5600([0x08, 0x00]), EncoderAngle::from_raw(1 << 31));
        assert_eq!(as5600([0xFF, 0xFF]), EncoderAngle::from_raw(0xFFF0_0000));
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
    fn each_encoder_says_whether_its_magnet_is_too_weak_or_too_strong() {
        let as5600 = [0x00, 0x10, 0x20, 0x28, 0x30].map(as5600_magnet);
        assert_eq!([0x18, 0x38, 0xFF].map(as5600_magnet), [None; 3]);
        let [missing, good, weak, strong] =
            [Magnet::Missing, Magnet::Good, Magnet::Weak, Magnet::Strong];
        assert_eq!(as5600, [missing, missing, good, strong, weak].map(Some));
        let mt6701 = [0, 1, 2, 4].map(|status| mt6701_magnet(mt6701_frame(0x1234, status)));
        assert_eq!(mt6701, [good, strong, weak, good].map(Some));
        assert_eq!(mt6701_magnet([0xFF; 3]), None);
        // Ready, the gain in the middle: the top bit makes the parity even.
        let answers = [[0x81, 0x80 ^ 0x80], [0x09, 0x00], [0x05, 0x00], [0xFF, 0xFF]];
        let as5047p = answers.map(as5047p_magnet);
        assert_eq!(as5047p, [Some(good), Some(weak), Some(strong), None]);
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
