//! What crossed the border in every tick, as bytes: recorded where a plant is, replayed where it is
//! not, on another processor, to compare what the fast half decides bit for bit.
//!
//! A trace is a [`Header`] and then one [`Row`] after the other, each of fixed length,
//! little-endian. Its reader must be of the same build as its writer: it is made and used within one test run,
//! never kept.

use core::num::NonZeroU16;

use flix_protocol::units::Instant;

use crate::exchange::Order;
use crate::fast::control::Control;
use crate::fast::units::{RotorAngle, Speed};
use crate::hardware::{
    Actuation, Bridge, CurrentSense, Duty, Encoder, EncoderAngle, EncoderReading, Hardware, Sensors,
};

/// Bytes of a [`Header`].
pub const HEADER_LENGTH: usize = 8 + 1 + 8 + 2 + 2 + 4 + 1;
/// Bytes of a [`Row`].
pub const ROW_LENGTH: usize = 8 + 2 * 7 + 9 + 3 + 23 + 2 * 7 + 6;

/// First bytes of a trace.
const MAGIC: [u8; 8] = *b"flixtrc1";

/// Not a trace, or not one of this build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Malformed;

impl core::fmt::Display for Malformed {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("this is not a trace that this build wrote")
    }
}

impl core::error::Error for Malformed {}

/// Puts values one after the other into a buffer that is long enough by construction.
struct Writer<'a>(&'a mut [u8]);

impl Writer<'_> {
    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        let (head, tail) = core::mem::take(&mut self.0).split_at_mut(N);
        head.copy_from_slice(&bytes);
        self.0 = tail;
    }
}

/// Takes values one after the other.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let (head, tail) = self.0.split_first_chunk().ok_or(Malformed)?;
        self.0 = tail;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, Malformed> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Result<u16, Malformed> {
        self.take().map(u16::from_le_bytes)
    }

    fn i16(&mut self) -> Result<i16, Malformed> {
        self.take().map(i16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, Malformed> {
        self.take().map(u32::from_le_bytes)
    }

    fn i32(&mut self) -> Result<i32, Malformed> {
        self.take().map(i32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, Malformed> {
        self.take().map(u64::from_le_bytes)
    }
}

/// The electronics that the trace was recorded on. Settings are those of a new robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Header {
    /// All but its name.
    pub hardware: Hardware,
}

impl Header {
    /// As bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; HEADER_LENGTH] {
        let mut bytes = [0; HEADER_LENGTH];
        let mut writer = Writer(&mut bytes);
        writer.put(MAGIC);
        let hardware = &self.hardware;
        let sense = hardware.current_sense;
        writer.put([u8::from(sense.is_some())]);
        let sense = sense.unwrap_or(CurrentSense {
            microamperes_per_count: 0,
            zero_count: 0,
            valid_counts: (0, 0),
        });
        writer.put(sense.microamperes_per_count.to_le_bytes());
        writer.put(sense.zero_count.to_le_bytes());
        writer.put(sense.valid_counts.0.to_le_bytes());
        writer.put(sense.valid_counts.1.to_le_bytes());
        writer.put(hardware.bus_microvolts_per_count.map_or(0, NonZeroU16::get).to_le_bytes());
        writer.put(hardware.dead_time_ns.to_le_bytes());
        writer.put(hardware.pwm_frequency_hz.to_le_bytes());
        writer.put([u8::from(hardware.can_coast)]);
        bytes
    }

    /// From bytes.
    ///
    /// # Errors
    /// When this is no trace.
    pub fn from_bytes(bytes: &[u8; HEADER_LENGTH]) -> Result<Self, Malformed> {
        let mut reader = Reader(bytes);
        if reader.take()? != MAGIC {
            return Err(Malformed);
        }
        let has_sense = reader.u8()? != 0;
        let sense = CurrentSense {
            microamperes_per_count: reader.u16()?,
            zero_count: reader.i16()?,
            valid_counts: (reader.i16()?, reader.i16()?),
        };
        let hardware = Hardware {
            name: "recorded",
            current_sense: has_sense.then_some(sense),
            bus_microvolts_per_count: NonZeroU16::new(reader.u16()?),
            dead_time_ns: reader.u16()?,
            pwm_frequency_hz: reader.u32()?,
            can_coast: reader.u8()? != 0,
        };
        Ok(Self { hardware })
    }
}

/// One tick: what went in, and what came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// Time of the tick.
    pub now: Instant,
    /// What the fast half was shown.
    pub sensors: Sensors,
    /// What it was asked for.
    pub order: Order,
    /// What it decided.
    pub outcome: Outcome,
}

/// What a tick decided, and how it left the fast half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outcome {
    /// The bridges.
    pub actuation: Actuation,
    /// Number of the supervisor's state.
    pub state: u8,
    /// Whether a fault is latched.
    pub faulted: bool,
    /// f as measured.
    pub frequency: Speed,
}

impl Outcome {
    /// After a tick.
    #[must_use]
    pub fn after(control: &Control, actuation: Actuation) -> Self {
        let report = control.report();
        Self {
            actuation,
            state: report.state as u8,
            faulted: report.first_fault.is_some(),
            frequency: report.frequency,
        }
    }
}

impl Row {
    /// As bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; ROW_LENGTH] {
        let mut bytes = [0; ROW_LENGTH];
        let mut writer = Writer(&mut bytes);
        writer.put(self.now.as_micros().to_le_bytes());
        for encoder in self.sensors.encoders {
            let (kind, reading) = match encoder {
                Encoder::Reading(reading) => (0, reading),
                Encoder::Pending => (1, EncoderReading { angle: EncoderAngle::ZERO, age_us: 0 }),
                Encoder::Failed => (2, EncoderReading { angle: EncoderAngle::ZERO, age_us: 0 }),
            };
            writer.put([kind]);
            writer.put(reading.angle.raw().to_le_bytes());
            writer.put(reading.age_us.to_le_bytes());
        }
        writer.put([u8::from(self.sensors.phase_current.is_some())]);
        for counts in self.sensors.phase_current.unwrap_or_default().as_flattened() {
            writer.put(counts.to_le_bytes());
        }
        writer.put([u8::from(self.sensors.bus_voltage.is_some())]);
        writer.put(self.sensors.bus_voltage.unwrap_or_default().to_le_bytes());
        let order = &self.order;
        writer.put(order.frequency.raw().to_le_bytes());
        writer.put(order.direction.raw().to_le_bytes());
        writer.put(order.setpoints.to_le_bytes());
        writer.put(order.heard.as_micros().to_le_bytes());
        writer.put([order.arm, order.disarm, order.stop, order.clear, order.period]);
        let outcome = &self.outcome;
        for bridge in outcome.actuation.bridges {
            let (kind, duties) = match bridge {
                Bridge::Off => (0, [Duty::ZERO; 3]),
                Bridge::Duty(duties) => (1, duties),
            };
            writer.put([kind]);
            for duty in duties {
                writer.put(duty.raw().to_le_bytes());
            }
        }
        writer.put([outcome.state, u8::from(outcome.faulted)]);
        writer.put(outcome.frequency.raw().to_le_bytes());
        bytes
    }

    /// From bytes.
    ///
    /// # Errors
    /// When they are not a row's.
    pub fn from_bytes(bytes: &[u8; ROW_LENGTH]) -> Result<Self, Malformed> {
        let mut reader = Reader(bytes);
        let now = Instant::from_micros(reader.u64()?);
        let mut encoders = [Encoder::Pending; 2];
        for encoder in &mut encoders {
            let kind = reader.u8()?;
            let reading = EncoderReading {
                angle: EncoderAngle::from_raw(reader.u32()?),
                age_us: reader.u16()?,
            };
            *encoder = match kind {
                0 => Encoder::Reading(reading),
                1 => Encoder::Pending,
                2 => Encoder::Failed,
                _ => return Err(Malformed),
            };
        }
        let has_currents = reader.u8()? != 0;
        let currents = [[reader.i16()?, reader.i16()?], [reader.i16()?, reader.i16()?]];
        let has_bus = reader.u8()? != 0;
        let bus = reader.u16()?;
        let sensors = Sensors {
            encoders,
            phase_current: has_currents.then_some(currents),
            bus_voltage: has_bus.then_some(bus),
        };
        let order = Order {
            frequency: Speed::from_raw(reader.i32()?),
            direction: RotorAngle::from_raw(reader.u32()?),
            setpoints: reader.u16()?,
            heard: Instant::from_micros(reader.u64()?),
            arm: reader.u8()?,
            disarm: reader.u8()?,
            stop: reader.u8()?,
            clear: reader.u8()?,
            period: reader.u8()?,
        };
        let mut bridges = [Bridge::Off; 2];
        for bridge in &mut bridges {
            let kind = reader.u8()?;
            let duties = [reader.u16()?, reader.u16()?, reader.u16()?].map(Duty::from_raw);
            *bridge = match kind {
                0 => Bridge::Off,
                1 => Bridge::Duty(duties),
                _ => return Err(Malformed),
            };
        }
        let outcome = Outcome {
            actuation: Actuation { bridges },
            state: reader.u8()?,
            faulted: reader.u8()? != 0,
            frequency: Speed::from_raw(reader.i32()?),
        };
        Ok(Self { now, sensors, order, outcome })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::BOARDS;

    #[test]
    fn a_header_survives_its_bytes() {
        for board in BOARDS {
            let hardware = Hardware { name: "recorded", ..board.hardware };
            let header = Header { hardware };
            assert_eq!(Header::from_bytes(&header.to_bytes()), Ok(header));
        }
    }

    #[test]
    fn a_row_survives_its_bytes() {
        let reading = EncoderReading { angle: EncoderAngle::from_raw(0xFEDC_BA98), age_us: 0x1234 };
        for (first, second) in
            [(Encoder::Reading(reading), Encoder::Failed), (Encoder::Pending, Encoder::Pending)]
        {
            let row = Row {
                now: Instant::from_micros(u64::MAX - 5),
                sensors: Sensors {
                    encoders: [first, second],
                    phase_current: Some([[1, -2], [i16::MAX, i16::MIN]]),
                    bus_voltage: Some(0xABCD),
                },
                order: Order {
                    frequency: Speed::from_raw(-123_456_789),
                    direction: RotorAngle::from_raw(987_654_321),
                    setpoints: 0x4321,
                    heard: Instant::from_micros(0x0102_0304_0506_0708),
                    arm: 1,
                    disarm: 2,
                    stop: 3,
                    clear: 4,
                    period: 5,
                },
                outcome: Outcome {
                    actuation: Actuation {
                        bridges: [Bridge::Off, Bridge::Duty([1, 2, 0xFFFF].map(Duty::from_raw))],
                    },
                    state: 3,
                    faulted: true,
                    frequency: Speed::from_raw(i32::MIN),
                },
            };
            assert_eq!(Row::from_bytes(&row.to_bytes()), Ok(row));
        }
    }

    #[test]
    fn other_bytes_are_not_a_trace() {
        assert_eq!(Header::from_bytes(&[0; HEADER_LENGTH]), Err(Malformed));
        assert_eq!(Row::from_bytes(&[0xFF; ROW_LENGTH]), Err(Malformed));
    }
}
