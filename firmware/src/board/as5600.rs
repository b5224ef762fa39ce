//! The driver of one AS5600 on its own I2C bus: filter set before any angle is taken, and a slower clock for a bus on which
//! it does not answer, or answers what cannot be.
//!
//! Most readings are of the angle alone, whose address the part still knows: 29 clocks of the bus. Every [`STATUS_INTERVAL`]th also
//! asks for the magnet's state and addresses the angle anew, so that a part whose supply dipped is not read elsewhere for longer; every
//! [`CHECK_INTERVAL`]th of these reads the filter instead, and sets it anew where that dip has changed it.

use embedded_hal::i2c::I2c;
use flix_protocol::units::Instant;

use super::encoder::{
    AS5600_ADDRESS, AS5600_ANGLE_REGISTER, AS5600_CONFIGURATION, AS5600_CONFIGURATION_BITS,
    AS5600_CONFIGURATION_REGISTER, AS5600_STATUS_REGISTER, as5600, as5600_magnet,
};
use crate::hardware::{EncoderAngle, Magnet};

/// Failures in a row, at any time, after which the bus is to run slower until the next start: no answer, or one that cannot
/// be, which is what weak pull-ups make of bits.
const FAILURES: u8 = 8;
/// So many readings from one look at the magnet to the next: 2 ms at most, as two parts are read in turn; 4 ms where a look at the
/// filter comes in between.
pub const STATUS_INTERVAL: u8 = 16;
/// So many looks at the magnet from one at the filter to the next: 32 ms at most.
pub const CHECK_INTERVAL: u8 = 16;

/// What is known of an AS5600.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct As5600 {
    is_configured: bool,
    failures: u8,
    magnet: Magnet,
    /// Readings until the next look at the magnet.
    until_status: u8,
    /// Looks at the magnet until the next one at the filter.
    until_check: u8,
}

impl As5600 {
    /// Knows nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            is_configured: false,
            failures: 0,
            magnet: Magnet::Good,
            until_status: 0,
            until_check: 0,
        }
    }

    /// Reads the angle, and when it was sampled; `None` when the encoder does not answer, has no magnet, or does not keep
    /// its filter, which is set anew after each loss: it may have been without its supply. Never panics.
    pub fn read(
        &mut self,
        bus: &mut impl I2c,
        now: impl Fn() -> Instant,
    ) -> (Option<EncoderAngle>, Instant) {
        let prepared = self.prepare(bus);
        let mut frame = [0; 2];
        let before = now();
        let outcome = match prepared {
            Some(Pointer::AtAngle) => bus.read(AS5600_ADDRESS, &mut frame),
            _ => bus.write_read(AS5600_ADDRESS, &[AS5600_ANGLE_REGISTER], &mut frame),
        };
        // The angle is latched as its first byte is read, about in the middle.
        let half = now().as_micros().saturating_sub(before.as_micros()) / 2;
        let is_good = outcome.is_ok() && prepared.is_some();
        self.failures = if is_good { 0 } else { self.failures.saturating_add(1) };
        let angle = (is_good && self.magnet != Magnet::Missing).then(|| as5600(frame));
        self.is_configured = angle.is_some();
        self.until_status =
            if self.is_configured { self.until_status.saturating_sub(1) } else { 0 };
        (angle, Instant::from_micros(before.as_micros() + half))
    }

    /// Sets the filter where it may be lost, and looks at the magnet where it is time; returns what the part's pointer is at, and
    /// `None` where it answers nothing, or what cannot be.
    fn prepare(&mut self, bus: &mut impl I2c) -> Option<Pointer> {
        if self.is_configured && self.until_status > 0 {
            return Some(Pointer::AtAngle);
        }
        if !self.is_configured && !configure(bus) {
            return None;
        }
        self.until_check = self.until_check.checked_sub(1).unwrap_or(CHECK_INTERVAL);
        if self.is_configured && self.until_check == 0 {
            self.until_status = STATUS_INTERVAL;
            let is_kept = configuration(bus)? & BITS == WANTED;
            return (is_kept || configure(bus)).then_some(Pointer::Elsewhere);
        }
        let mut status = [0];
        bus.write_read(AS5600_ADDRESS, &[AS5600_STATUS_REGISTER], &mut status).ok()?;
        self.magnet = as5600_magnet(status[0])?;
        self.until_status = STATUS_INTERVAL;
        Some(Pointer::Elsewhere)
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

/// Where the part's address pointer is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pointer {
    /// At the angle: it need not be addressed.
    AtAngle,
    /// Elsewhere.
    Elsewhere,
}

/// Mask of the configuration bits that the robot sets, and their values.
const BITS: u16 = u16::from_be_bytes(AS5600_CONFIGURATION_BITS);
const WANTED: u16 = u16::from_be_bytes(AS5600_CONFIGURATION);

/// Reads the configuration.
fn configuration(bus: &mut impl I2c) -> Option<u16> {
    let mut found = [0; 2];
    bus.write_read(AS5600_ADDRESS, &[AS5600_CONFIGURATION_REGISTER], &mut found).ok()?;
    Some(u16::from_be_bytes(found))
}

/// Sets the filter, and leaves reserved bits as they are; returns whether it is set then.
fn configure(bus: &mut impl I2c) -> bool {
    let Some(found) = configuration(bus) else { return false };
    let [high, low] = (found & !BITS | WANTED).to_be_bytes();
    bus.write(AS5600_ADDRESS, &[AS5600_CONFIGURATION_REGISTER, high, low]).is_ok()
        && configuration(bus).is_some_and(|found| found & BITS == WANTED)
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
        /// Address that the next reading begins at.
        pointer: u8,
        /// Clocks of the bus of the last transaction: start or stop on either side, and nine a byte, the address among them.
        clocks: u32,
        /// Bits of all answers that are ones at 1 MHz, as rising edges come too late or early.
        stuck: u8,
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
                pointer: 0,
                clocks: 0,
                stuck: 0,
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
            self.clocks = 0;
            for operation in operations {
                self.clocks += 2 + 9;
                match operation {
                    Operation::Write([pointer, bytes @ ..]) => {
                        self.clocks += 9 * (1 + bytes.len() as u32);
                        self.pointer = *pointer;
                        for (index, byte) in bytes.iter().enumerate() {
                            assert_eq!((*pointer, bytes.len()), (AS5600_CONFIGURATION_REGISTER, 2));
                            let fixed = if self.is_stubborn { 0xFF } else { self.fixed[index] };
                            self.configuration[index] =
                                self.configuration[index] & fixed | byte & !fixed;
                        }
                    }
                    Operation::Read(room) => {
                        self.clocks += 9 * room.len() as u32;
                        for (offset, byte) in (0..).zip(room.iter_mut()) {
                            let found = match self.pointer + offset {
                                0x07 => self.configuration[0],
                                0x08 => self.configuration[1],
                                0x0B => self.status,
                                0x0C => 0x08,
                                _ => 0x00,
                            };
                            *byte = if self.khz == 1_000 { found | self.stuck } else { found };
                        }
                        if self.pointer != AS5600_ANGLE_REGISTER {
                            self.pointer += room.len() as u8;
                        }
                    }
                    Operation::Write([]) => return Err(ErrorKind::Other),
                }
            }
            Ok(())
        }
    }

    /// Half a turn.
    const ANGLE: Option<EncoderAngle> = Some(EncoderAngle::from_raw(1 << 31));

    fn angle(encoder: &mut As5600, bus: &mut Bus) -> Option<EncoderAngle> {
        encoder.read(bus, || Instant::START).0
    }

    /// Reads for so long that the magnet is looked at, and returns the last angle.
    fn angle_a_while_later(encoder: &mut As5600, bus: &mut Bus) -> Option<EncoderAngle> {
        for _ in 0..STATUS_INTERVAL {
            angle(encoder, bus);
        }
        angle(encoder, bus)
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
    fn a_filter_that_falls_back_between_two_readings_is_set_again() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        for _ in 0..50 {
            angle(&mut encoder, &mut bus);
        }
        bus.configuration = [0; 2];
        let readings = u32::from(STATUS_INTERVAL) * u32::from(CHECK_INTERVAL);
        let mut later = (1..).take_while(|_| {
            assert_eq!(angle(&mut encoder, &mut bus), ANGLE);
            bus.configuration != AS5600_CONFIGURATION
        });
        assert!(later.by_ref().count() < readings as usize + 16);
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
            let found = angle_a_while_later(&mut encoder, &mut bus);
            assert_eq!((found, encoder.magnet()), (seen, magnet), "{status:02X}");
        }
    }

    #[test]
    fn most_readings_take_29_clocks_and_the_magnet_is_seen_within_the_interval() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        let mut clocks = std::vec::Vec::new();
        for _ in 0..10 * usize::from(STATUS_INTERVAL) {
            assert_eq!(angle(&mut encoder, &mut bus), ANGLE);
            clocks.push(bus.clocks);
        }
        let long = clocks.iter().filter(|clocks| **clocks > 29).count();
        assert_eq!((long, clocks.iter().min()), (10, Some(&29)));
        bus.status = 0x00;
        let seen = (1..).find(|_| angle(&mut encoder, &mut bus).is_none());
        assert!(seen.is_some_and(|readings| readings <= u32::from(STATUS_INTERVAL)), "{seen:?}");
    }

    #[test]
    fn a_pointer_that_was_lost_is_set_again_within_the_interval() {
        let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
        angle(&mut encoder, &mut bus);
        bus.pointer = 0;
        assert_eq!(angle_a_while_later(&mut encoder, &mut bus), ANGLE);
    }

    #[test]
    fn a_bus_whose_bits_are_wrong_at_1_mhz_is_slowed_down_and_is_read_from_then_on() {
        for bit in 0..8 {
            let (mut encoder, mut bus) = (As5600::new(), Bus::up_to(1_000));
            bus.stuck = 1 << bit;
            let mut slowed_after = None;
            for reading in 1..=40 {
                angle(&mut encoder, &mut bus);
                if encoder.wants_slower_bus() {
                    slowed_after = Some(reading);
                    bus.khz = 400;
                }
            }
            // Two bits of the configuration's first byte are reserved, and its second one shows them.
            assert_eq!(slowed_after, Some(u32::from(FAILURES)), "bit {bit}");
            assert_eq!(angle(&mut encoder, &mut bus), ANGLE, "bit {bit}");
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
