//! Sensors of a robot that stands.

use flix_firmware::hardware::{Encoder, EncoderAngle, EncoderReading, Magnet, Sensors};

/// Rotors at rest, no current, a board without a battery divider.
pub(crate) const AT_REST: Sensors = {
    let encoder =
        Encoder::Reading(EncoderReading { angle: EncoderAngle::from_count(1, 2), age_us: 100 });
    Sensors {
        encoders: [encoder; 2],
        magnets: [Magnet::Good; 2],
        phase_current: Some([[2_048; 2]; 2]),
        bus_voltage: None,
    }
};
