//! What crossed the border in every tick, as bytes: recorded where a plant is, replayed where it is
//! not, on another processor, to compare what the fast half decides bit for bit.
//!
//! A trace is the [`Hardware`](crate::hardware::Hardware) that it was recorded on and then one [`Row`]
//! after the other, each in `postcard`'s form behind one byte of length. Its reader must be of the same build as its writer: it is made and used within
//! one test run, never kept.

use flix_protocol::message::State;
use flix_protocol::units::Instant;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::fast::control::Control;
use crate::fast::exchange::Asked;
use crate::hardware::{Actuation, Sensors};
use crate::units::Speed;

/// Most bytes that the hardware or a [`Row`] takes, its length included.
pub const LONGEST: usize = 1 + u8::MAX as usize;

/// Not a trace, or not one of this build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a trace that this build wrote")]
pub struct Malformed;

/// One tick: what went in, and what came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Row {
    /// Time of the tick.
    pub now: Instant,
    /// What the fast half was shown.
    pub sensors: Sensors,
    /// What it was asked for.
    pub asked: Asked,
    /// What it decided.
    pub outcome: Outcome,
}

/// What a tick decided, and how it left the fast half.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// The bridges.
    pub actuation: Actuation,
    /// The supervisor's state.
    pub state: State,
    /// Whether a fault is latched.
    pub faulted: bool,
    /// f as measured.
    pub frequency: Speed,
}

impl Outcome {
    /// Returns what a tick decided, right after it.
    #[must_use]
    pub fn after(control: &Control, actuation: Actuation) -> Self {
        let report = control.report();
        Self {
            actuation,
            state: report.state,
            faulted: report.first_fault.is_some(),
            frequency: report.frequency,
        }
    }
}

/// Encodes the hardware or a [`Row`].
///
/// # Errors
/// When it takes more than [`LONGEST`] bytes, which neither does.
pub fn encode<'a>(
    value: &impl Serialize,
    buffer: &'a mut [u8; LONGEST],
) -> Result<&'a [u8], Malformed> {
    let length = postcard::to_slice(value, &mut buffer[1..]).map_err(|_| Malformed)?.len();
    buffer[0] = length as u8;
    Ok(&buffer[..=length])
}

/// Decodes the hardware or a [`Row`]; `None` at the end of the trace. `fill` reads as many bytes as it
/// is given room for.
///
/// # Errors
/// When the bytes end within a value or are not such a value's.
pub fn decode<T: DeserializeOwned, E>(
    mut fill: impl FnMut(&mut [u8]) -> Result<(), E>,
) -> Result<Option<T>, Malformed> {
    let mut buffer = [0; LONGEST];
    let (length, bytes) = buffer.split_at_mut(1);
    if fill(length).is_err() {
        return Ok(None);
    }
    let bytes = &mut bytes[..usize::from(length[0])];
    fill(bytes).map_err(|_| Malformed)?;
    postcard::from_bytes(bytes).map(Some).map_err(|_| Malformed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::BOARDS;
    use crate::fast::exchange::Wanted;
    use crate::units::RotorAngle;
    use flix_protocol::message::{Pattern, Permit, Trial};

    use crate::hardware::{Bridge, Duty, Encoder, EncoderAngle, EncoderReading, Hardware, Magnet};
    use std::io::Read;

    fn read<T: DeserializeOwned>(mut bytes: &[u8]) -> Result<Option<T>, Malformed> {
        decode(|room| bytes.read_exact(room))
    }

    #[test]
    fn hardware_survives_its_bytes_but_for_its_name() {
        for board in BOARDS {
            let hardware = Hardware { name: "", ..board.hardware };
            let mut buffer = [0; LONGEST];
            assert_eq!(read(encode(&hardware, &mut buffer).unwrap()), Ok(Some(hardware)));
        }
    }

    fn row(first: Encoder, second: Encoder) -> Row {
        Row {
            now: Instant::from_micros(u64::MAX - 5),
            sensors: Sensors {
                magnets: [Magnet::Weak, Magnet::Missing],
                encoders: [first, second],
                phase_current: Some([[1, -2], [i16::MAX, i16::MIN]]),
                bus_voltage: Some(0xABCD),
            },
            asked: Asked {
                wanted: Wanted::Try,
                permit: Permit::new(u32::MAX),
                number: u32::MAX,
                begins: true,
                frequency: Speed::from_raw(i32::MIN),
                direction: RotorAngle::from_raw(u32::MAX),
                heard: Instant::from_micros(u64::MAX),
                expires: Instant::from_micros(u64::MAX),
                trial: Some(Trial {
                    motors: [true, false],
                    current_ma: u16::MAX,
                    angle: u16::MAX,
                    pattern: Pattern::Turn(i16::MIN),
                    ticks: u16::MAX,
                }),
                stops: 3,
                halts: 4,
                period: 5,
            },
            outcome: Outcome {
                actuation: Actuation {
                    bridges: [Bridge::Off, Bridge::Duty([1, 2, 0xFFFF].map(Duty::from_raw))],
                },
                state: State::Running,
                faulted: true,
                frequency: Speed::from_raw(i32::MIN),
            },
        }
    }

    #[test]
    fn a_row_survives_its_bytes() {
        let reading = EncoderReading { angle: EncoderAngle::from_raw(0xFEDC_BA98), age_us: 0x1234 };
        for (first, second) in
            [(Encoder::Reading(reading), Encoder::Failed), (Encoder::Pending, Encoder::Pending)]
        {
            let row = row(first, second);
            let mut buffer = [0; LONGEST];
            assert_eq!(read(encode(&row, &mut buffer).unwrap()), Ok(Some(row)));
        }
    }

    #[test]
    fn other_bytes_are_not_a_trace() {
        assert_eq!(read::<Row>(&[0xFF; LONGEST]), Err(Malformed));
    }

    #[test]
    fn a_trace_that_ends_within_a_row_is_malformed_and_one_that_ends_after_it_is_not() {
        let row = row(Encoder::Pending, Encoder::Failed);
        let mut buffer = [0; LONGEST];
        let bytes = encode(&row, &mut buffer).unwrap();
        assert_eq!(read::<Row>(&bytes[..bytes.len() - 1]), Err(Malformed));
        assert_eq!(read::<Row>(&[]), Ok(None));
    }
}
