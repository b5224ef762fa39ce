//! The driver of one AS5600 on its own I2C bus: filter set before any angle is taken, and a slower clock for a bus on which
//! it does not answer.

use embedded_hal::i2c::I2c;
use flix_protocol::units::Instant;

use super::encoder::{
    AS5600_ADDRESS, AS5600_CONFIGURATION, AS5600_CONFIGURATION_BITS, AS5600_CONFIGURATION_REGISTER,
    AS5600_STATUS_REGISTER, as5600, as5600_magnet,
};
use crate::hardware::{EncoderAngle, Magnet};

/// Failures in a row, at any time, after which the bus is to run slower until the next start.
const FAILURES: u8 = 8;

/// What is known of an AS5600.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct As5600 {
    is_configured: bool,
    failures: u8,
    magnet: Magnet,
}

impl As5600 {
    /// Knows nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { is_configured: false, failures: 0, magnet: Magnet::Good }
    }

    /// Reads the angle, and when it was sampled; `None` when the encoder does not answer, has no magnet, or does not keep
    /// its filter, which is set anew after each loss: it may have been without its supply. Never panics.
    pub fn read(
        &mut self,
        bus: &mut impl I2c,
        now: impl Fn() -> Instant,
    ) -> (Option<EncoderAngle>, Instant) {
        if !self.is_configured {
            self.is_configured = configure(bus);
        }
        let mut frame = [0; 3];
        let before = now();
        let outcome = bus.write_read(AS5600_ADDRESS, &[AS5600_STATUS_REGISTER], &mut frame);
        // The angle is latched as its first byte is read, about in the middle.
        let half = now().as_micros().saturating_sub(before.as_micros()) / 2;
        self.failures = if outcome.is_ok() { 0 } else { self.failures.saturating_add(1) };
        if let (Ok(()), [status, ..]) = (&outcome, frame) {
            self.magnet = as5600_magnet(status);
        }
        let angle = outcome.ok().and_then(|()| as5600(frame)).filter(|_| self.is_configured);
        self.is_configured = angle.is_some();
        (angle, Instant::from_micros(before.as_micros() + half))
    }

    /// Returns what it last said of its magnet.
    #[must_use]
    pub const fn magnet(&self) -> Magnet {
        self.magnet
    }

    /// Returns whether the last reading was the one after which the bus is to run slower.
    #[must_use]
    pub const fn wants_slower_bus(&self) -> bool {
        self.failures == FAILURES
    }
}

/// Sets the filter, and leaves reserved bits as they are; returns whether it is set then.
fn configure(bus: &mut impl I2c) -> bool {
    let read = |bus: &mut _| {
        let mut found = [0; 2];
        I2c::write_read(bus, AS5600_ADDRESS, &[AS5600_CONFIGURATION_REGISTER], &mut found).ok()?;
        Some(u16::from_be_bytes(found))
    };
    let [wanted, bits] = [AS5600_CONFIGURATION, AS5600_CONFIGURATION_BITS].map(u16::from_be_bytes);
    let Some(found) = read(bus) else { return false };
    let [high, low] = (found & !bits | wanted).to_be_bytes();
    bus.write(AS5600_ADDRESS, &[AS5600_CONFIGURATION_REGISTER, high, low]).is_ok()
        && read(bus).is_some_and(|found| found & bits == wanted)
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use embedded_hal::i2c::{ErrorKind, ErrorType, NoAcknowledgeSource, Operation};

    use super::*;

    /// An AS5600 whose bus answers up to a clock.
    struct Bus {
        khz: u32,
        fastest_khz: u32,
        configuration: [u8; 2],
        /// Bits of its configuration that no write changes.
        fixed: [u8; 2],
        status: u8,
        /// Refuses what is written to its configuration.
        is_stubborn: bool,
    }

    impl Bus {
        const fn up_to(fastest_khz: u32) -> Self {
            Self {
                khz: 1_000,
                fastest_khz,
                configuration: [0; 2],
                fixed: [0; 2],
                status: 0x20,
                is_stubborn: false,
            }
        }
    }

    impl ErrorType for Bus {
        type Error = ErrorKind;
    }

    impl I2c for Bus {
        fn transaction(
            &mut self,
            address: u8,
            operations: &mut [Operation<'_>],
        ) -> Result<(), ErrorKind> {
            if self.khz > self.fastest_khz || address != AS5600_ADDRESS {
                return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address));
            }
            match operations {
                [Operation::Write([AS5600_CONFIGURATION_REGISTER, high, low])] => {
                    for (index, byte) in [*high, *low].into_iter().enumerate() {
                        let fixed = if self.is_stubborn { 0xFF } else { self.fixed[index] };
                        self.configuration[index] =
                            self.configuration[index] & fixed | byte & !fixed;
                    }
                }
                [Operation::Write([AS5600_CONFIGURATION_REGISTER]), Operation::Read(found)] => {
                    found.copy_from_slice(&self.configuration);
                }
                [Operation::Write([AS5600_STATUS_REGISTER]), Operation::Read(frame)] => {
                    frame.copy_from_slice(&[self.status, 0x08, 0x00]);
                }
                _ => return Err(ErrorKind::Other),
            }
            Ok(())
        }
    }

    /// Half a turn.
    const ANGLE: Option<EncoderAngle> = Some(EncoderAngle::from_raw(1 << 31));

    fn angle(encoder: &mut As5600, bus: &mut Bus) -> Option<EncoderAngle> {
        encoder.read(bus, || Instant::START).0
    }

    #[test]
    fn a_bus_that_is_too_slow_for_1_mhz_is_slowed_down_once_and_is_read_from_then_on() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(400));
        let mut slowed_after = std::vec::Vec::new();
        for reading in 1..=300 {
            let angle = angle(&mut encoder, &mut bus);
            assert_eq!(angle.is_some(), bus.khz == 400, "reading {reading}");
            if encoder.wants_slower_bus() {
                slowed_after.push(reading);
                bus.khz = 400;
            }
        }
        assert_eq!(slowed_after, [i32::from(FAILURES)]);
    }

    #[test]
    fn a_bus_that_answers_now_and_then_keeps_its_clock() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        for reading in 0..100 {
            bus.fastest_khz = if reading % u32::from(FAILURES) == 0 { 1_000 } else { 0 };
            angle(&mut encoder, &mut bus);
            assert!(!encoder.wants_slower_bus(), "reading {reading}");
        }
    }

    #[test]
    fn an_encoder_that_comes_back_is_configured_before_its_angle_is_taken() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        assert_eq!(angle(&mut encoder, &mut bus), ANGLE);
        bus.fastest_khz = 0;
        assert_eq!(angle(&mut encoder, &mut bus), None);
        // It was without its supply.
        (bus.fastest_khz, bus.configuration) = (1_000, [0; 2]);
        assert_eq!(angle(&mut encoder, &mut bus), ANGLE);
        assert_eq!(bus.configuration, AS5600_CONFIGURATION);
    }

    #[test]
    fn reserved_bits_of_the_configuration_keep_what_they_are_whether_they_can_be_written_or_not() {
        for reserved in [0x00, 0x40, 0x80, 0xC0] {
            for fixed in [0x00, 0x40, 0x80, 0xC0] {
                let configuration = [reserved | 0x20, 0x13];
                let mut bus = Bus { configuration, fixed: [fixed, 0], ..Bus::up_to(1_000) };
                assert_eq!(
                    angle(&mut As5600::new(), &mut bus),
                    ANGLE,
                    "{reserved:02X} {fixed:02X}"
                );
                assert_eq!(bus.configuration, [reserved | 0x03, 0x00]);
            }
        }
    }

    #[test]
    fn a_filter_bit_that_cannot_be_written_is_a_lost_encoder() {
        for bit in 0..14 {
            let fixed = (1_u16 << bit).to_be_bytes();
            let configuration = if bit == 8 || bit == 9 { [0; 2] } else { fixed };
            let mut bus = Bus { configuration, fixed, ..Bus::up_to(1_000) };
            assert_eq!(angle(&mut As5600::new(), &mut bus), None, "bit {bit}");
        }
    }

    #[test]
    fn a_magnet_that_is_too_weak_or_too_strong_is_named_beside_the_angle() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        for (status, magnet, seen) in [
            (0x30, Magnet::Weak, ANGLE),
            (0x28, Magnet::Strong, ANGLE),
            (0x10, Magnet::Missing, None),
            (0x20, Magnet::Good, ANGLE),
        ] {
            bus.status = status;
            let found = angle(&mut encoder, &mut bus);
            assert_eq!((found, encoder.magnet()), (seen, magnet), "{status:02X}");
        }
    }

    #[test]
    fn an_encoder_that_does_not_keep_its_filter_is_lost() {
        let mut bus = Bus { is_stubborn: true, ..Bus::up_to(1_000) };
        assert_eq!(angle(&mut As5600::new(), &mut bus), None);
    }

    #[test]
    fn the_angle_is_of_the_middle_of_its_reading() {
        let time = Cell::new(1_000);
        let now = || Instant::from_micros(time.replace(time.get() + 54));
        let (_, sampled) = As5600::new().read(&mut Bus::up_to(1_000), now);
        assert_eq!(sampled, Instant::from_micros(1_027));
    }
}
