//! The boards as data: which pin does what, how current is measured, whether the motors can coast.
//!
//! A board is one constant here. The chip files beside this one (`esp32.rs`, `esp32s3.rs`,
//! `esp32c6.rs`) belong to the chip binary, not to the library; they take their pins from these
//! constants. [`Board::check`] holds a board against what its chip can do: at compile time for
//! the board that is built, in the tests for all of them.
//!
//! Terms: *top* and *bottom* are the rotors and their motors, in this order everywhere; the
//! vendors' "motor 0" drives the top one. A pin is the chip's GPIO number.
//!
//! Sources: the vendors' schematics and examples (MKS, DengFOC), the ESP32, ESP32-S3 and
//! ESP32-C6 data sheets (pin tables, ADC chapter).

pub mod as5047p;
pub mod as5600;
pub mod encoder;
pub mod store;

use core::num::NonZeroU16;

use crate::hardware::{CurrentSense, Hardware};

/// A GPIO number.
pub type Pin = u8;

/// The chips that carry a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chip {
    /// Two Xtensa LX6 cores, the paper's chip.
    Esp32,
    /// Two Xtensa LX7 cores.
    Esp32S3,
    /// One RISC-V core, no floating point.
    Esp32C6,
}

impl Chip {
    /// Returns whether the pin exists, can drive, and is free: not wired to the flash chip inside the
    /// module, to USB, or to the serial port.
    #[must_use]
    pub const fn can_drive(self, pin: Pin) -> bool {
        match self {
            // 6 to 11 carry the flash, 34 to 39 have no output stage, 20, 24, 28 to 31 do not
            // exist, 1 and 3 are the serial port.
            Self::Esp32 => matches!(pin, 0 | 2 | 4 | 5 | 12..=19 | 21..=23 | 25..=27 | 32..=33),
            // 26 to 32 carry the flash, 33 to 37 the octal PSRAM of some modules, 19 and 20 USB,
            // 43 and 44 are the serial port.
            Self::Esp32S3 => matches!(pin, 0..=18 | 21 | 38..=42 | 45..=48),
            // 24 to 30 carry the flash, 12 and 13 USB, 16 and 17 are the serial port.
            Self::Esp32C6 => matches!(pin, 0..=11 | 15 | 18..=23),
        }
    }

    /// Returns the pins of the serial port at the board's USB connector: from the computer, to the computer.
    #[must_use]
    pub const fn serial_pins(self) -> [Pin; 2] {
        match self {
            Self::Esp32 => [3, 1],
            Self::Esp32S3 => [44, 43],
            Self::Esp32C6 => [17, 16],
        }
    }

    /// Returns the channel of ADC1 on the pin. ADC2 is not used: on the ESP32 it collides with Wi-Fi.
    #[must_use]
    pub const fn adc1_channel(self, pin: Pin) -> Option<u8> {
        match (self, pin) {
            (Self::Esp32, 36..=39) => Some(pin - 36),
            (Self::Esp32, 32..=35) => Some(pin - 28),
            (Self::Esp32S3, 1..=10) => Some(pin - 1),
            (Self::Esp32C6, 0..=6) => Some(pin),
            _ => None,
        }
    }

    /// Returns the lowest and the highest of the millivolts that a calibrated conversion of ADC1 in its widest range
    /// follows on every chip of this kind. What is stated at these or beyond may be clipped.
    #[must_use]
    pub const fn converter_millivolts(self) -> [u16; 2] {
        match self {
            // Nothing is taken for up to 200 mV, by what the fuses may say of two points, and for 142 where they hold the reference
            // alone. All ones are taken for 3,056 mV with the lowest reference of the fuses, 995 mV (ESP-IDF,
            // `adc_cali_line_fitting.c` of the ESP32). The data sheet measures from 150 mV on.
            Self::Esp32 => [200, 3_056],
            // The data sheets measure from 0 to 2,900 and to 3,300 mV.
            Self::Esp32S3 => [CONVERTER_ERROR_MILLIVOLTS, 2_900],
            Self::Esp32C6 => [CONVERTER_ERROR_MILLIVOLTS, 3_300 - CONVERTER_ERROR_MILLIVOLTS],
        }
    }

    /// Returns whether four conversions fit into one tick. Those of the C6 take 40 microseconds each.
    #[must_use]
    pub const fn samples_currents_in_a_tick(self) -> bool {
        !matches!(self, Self::Esp32C6)
    }
}

/// The encoders that the firmware reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EncoderKind {
    /// 12 bits, I2C at 1 MHz, one fixed address.
    As5600,
    /// 14 bits, read over SPI (SSI frame with CRC-6).
    Mt6701,
    /// 14 bits, SPI with parity.
    As5047p,
}

impl EncoderKind {
    /// Returns how much older than its reading an angle is, microseconds: the AS5600's filter, half of what
    /// [`encoder::AS5600_CONFIGURATION`] settles in; the MT6701's 5 us (data sheet revision 1.8); the AS5047P predicts.
    #[must_use]
    pub const fn delay_us(self) -> u16 {
        match self {
            Self::As5600 => 143,
            Self::Mt6701 => 5,
            Self::As5047p => 0,
        }
    }
}

/// Pins of one three-phase bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BridgePins {
    /// PWM of phases A, B, C.
    pub phases: [Pin; 3],
    /// High lets the bridge drive; `None` where the driver has no such input.
    pub enable: Option<Pin>,
    /// ADC1 pins of the current amplifiers on phases A and B.
    pub currents: Option<[Pin; 2]>,
}

/// Pins of one I2C master, by number or as the chip's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct I2cPins<P = Pin> {
    /// Data.
    pub sda: P,
    /// Clock.
    pub scl: P,
}

/// Pins of the SPI bus that both encoders share, by number or as the chip's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiPins<P = Pin> {
    /// Clock.
    pub sclk: P,
    /// From the encoders.
    pub miso: P,
    /// To the encoders; the MT6701 does not listen.
    pub mosi: P,
    /// Chip selects of the top and the bottom encoder, active low.
    pub selects: [P; 2],
}

/// A battery divider and the ADC1 pin that reads it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Divider {
    /// ADC1 pin.
    pub pin: Pin,
    /// Whether the pin is taken from a current amplifier, whose output then has to be cut.
    pub replaces_current_sense: bool,
}

/// A board, whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Name of the cargo feature that selects it.
    pub feature: &'static str,
    /// The chip on it.
    pub chip: Chip,
    /// What the robot's software has to know.
    pub hardware: Hardware,
    /// Top, bottom.
    pub bridges: [BridgePins; 2],
    /// The encoder that the vendor sells with it.
    pub encoder: EncoderKind,
    /// One I2C bus an encoder: top, bottom. `None` where the chip has one master only.
    pub i2c: Option<[I2cPins; 2]>,
    /// The SPI bus, where SPI encoders are used instead.
    pub spi: SpiPins,
    /// Where a battery divider can be added.
    pub divider_option: Divider,
    /// The divider in use. None of the known boards has one.
    pub divider: Option<Divider>,
    /// Where the amplifiers of added driver boards can be read; for generic boards.
    pub current_option: Option<[[Pin; 2]; 2]>,
    /// An LED, lit when high: on the board or added with a resistor.
    pub status_led: Pin,
}

/// PWM frequency, above what people hear: two periods to a tick of the fast loop, so that currents are sampled at the same
/// place of each, and 8,000 counts of the 160 MHz that the MCPWM counts with. 30 kHz would take 5,333.3.
pub const PWM_FREQUENCY_HZ: u32 = 20_000;

/// Built-in interlock of the L6234, nominal (ST application note AN1088).
const L6234_DEAD_TIME_NS: u16 = 300;
/// Built-in interlock of the EG2133, order of magnitude: not stated for every lot. On the small
/// side, where compensating it cannot overshoot.
const EG2133_DEAD_TIME_NS: u16 = 100;
/// Drivers on a generic board are not known: no compensation.
const UNKNOWN_DEAD_TIME_NS: u16 = 0;

/// Returns the counts of an ideal converter, of which full scale is 3.3 V, at this voltage: at most 4,095.
#[must_use]
pub const fn counts_of_millivolts(millivolts: u16) -> u16 {
    let counts = millivolts as u32 * ADC_LARGEST_COUNT / ADC_FULL_SCALE_MILLIVOLTS;
    if counts < ADC_LARGEST_COUNT { counts as u16 } else { ADC_LARGEST_COUNT as u16 }
}

/// Returns the count of a counter that counts up and down, upwards, at which what takes so many counts has to begin to lie
/// around its peak; nothing where it takes longer than the counter from zero to zero.
#[must_use]
pub const fn centred_start(half_period: u16, counts: u32) -> Option<u16> {
    let before = counts.div_ceil(2);
    if before <= half_period as u32 { Some(half_period - before as u16) } else { None }
}

/// Millivolts of an ideal full-scale conversion (4095 counts); chips' own conversions are calibrated to it.
const ADC_FULL_SCALE_MILLIVOLTS: u32 = 3_300;
/// Largest count of a 12-bit conversion.
const ADC_LARGEST_COUNT: u32 = 4_095;
/// What a converter that begins at ground, or ends at its supply, may state there instead: assumed.
const CONVERTER_ERROR_MILLIVOLTS: u16 = 77;
/// Shunt in series with a phase, milliohms.
const SHUNT_MILLIOHMS: u32 = 10;

/// Divider that the battery option asks for, kiloohms: 13 V give 2.3 V, inside the linear range.
const DIVIDER_UPPER_KILOOHMS: u32 = 100;
/// The resistor to ground.
const DIVIDER_LOWER_KILOOHMS: u32 = 22;

/// Describes a sense around half the supply (1.65 V) with an amplifier of the given gain, converted by this chip.
const fn bidirectional_sense(chip: Chip, gain: u32) -> CurrentSense {
    let nanovolts_per_count = ADC_FULL_SCALE_MILLIVOLTS * 1_000_000 / ADC_LARGEST_COUNT;
    let microamperes_per_count = nanovolts_per_count / (SHUNT_MILLIOHMS * gain);
    assert!(microamperes_per_count <= u16::MAX as u32);
    let [lowest, highest] = chip.converter_millivolts();
    CurrentSense {
        microamperes_per_count: microamperes_per_count as u16,
        zero_count: (ADC_LARGEST_COUNT as i16).div_euclid(2) + 1,
        valid_counts: (
            counts_of_millivolts(lowest).cast_signed(),
            counts_of_millivolts(highest).cast_signed(),
        ),
    }
}

/// Microvolts of the battery per count behind the divider option.
const DIVIDER_MICROVOLTS_PER_COUNT: u16 = {
    let at_pin = ADC_FULL_SCALE_MILLIVOLTS * 1_000 / ADC_LARGEST_COUNT;
    let at_battery =
        at_pin * (DIVIDER_UPPER_KILOOHMS + DIVIDER_LOWER_KILOOHMS) / DIVIDER_LOWER_KILOOHMS;
    assert!(at_battery <= u16::MAX as u32);
    at_battery as u16
};

/// Describes electronics that do not measure their battery.
const fn hardware(
    name: &'static str,
    current_sense: Option<CurrentSense>,
    dead_time_ns: u16,
    can_coast: bool,
) -> Hardware {
    Hardware {
        name,
        current_sense,
        bus_microvolts_per_count: None,
        bus_largest_count: ADC_LARGEST_COUNT as u16,
        dead_time_ns,
        pwm_frequency_hz: PWM_FREQUENCY_HZ,
        actuation_delay_us: Hardware::actuation_delay(PWM_FREQUENCY_HZ),
        can_coast,
    }
}

/// Describes a board with the pin map that the dual-motor ESP32 boards share.
const fn dual_esp32(
    feature: &'static str,
    name: &'static str,
    current_sense: Option<CurrentSense>,
    enables: Option<[Pin; 2]>,
    dead_time_ns: u16,
) -> Board {
    let (top_enable, bottom_enable) = match enables {
        Some([top, bottom]) => (Some(top), Some(bottom)),
        None => (None, None),
    };
    Board {
        feature,
        chip: Chip::Esp32,
        hardware: hardware(name, current_sense, dead_time_ns, enables.is_some()),
        bridges: [
            BridgePins {
                phases: [32, 33, 25],
                enable: top_enable,
                currents: if current_sense.is_some() { Some([39, 36]) } else { None },
            },
            BridgePins {
                phases: [26, 27, 14],
                enable: bottom_enable,
                currents: if current_sense.is_some() { Some([35, 34]) } else { None },
            },
        ],
        encoder: EncoderKind::As5600,
        i2c: Some([I2cPins { sda: 19, scl: 18 }, I2cPins { sda: 23, scl: 5 }]),
        // The second select is the bottom encoder's index pin, free with SPI encoders.
        spi: SpiPins { sclk: 18, miso: 19, mosi: 23, selects: [5, 13] },
        // All ADC1 pins that the module brings out are taken: the option costs one amplifier.
        divider_option: Divider { pin: 34, replaces_current_sense: true },
        divider: None,
        current_option: None,
        status_led: 2,
    }
}

/// MKS DUAL FOC V3.1: L6234. REF of its INA181A2 is tied to ground, so negative currents clip,
/// and the motors run in voltage mode.
pub const MKS_DUAL_FOC_V3_1: Board =
    dual_esp32("mks-dual-foc-v3-1", "MKS DUAL FOC V3.1", None, Some([22, 12]), L6234_DEAD_TIME_NS);

/// MKS DUAL FOC V3.3 PLUS: EG2133 without an enable (it brakes), INA240A2 (x50) around 1.65 V.
pub const MKS_DUAL_FOC_V3_3_PLUS: Board = dual_esp32(
    "mks-dual-foc-v3-3-plus",
    "MKS DUAL FOC V3.3 PLUS",
    Some(bidirectional_sense(Chip::Esp32, 50)),
    None,
    EG2133_DEAD_TIME_NS,
);

/// MKS ESP32 FOC V1.0: EG2133 without an enable. The amplifier's marking says x20, the vendor's
/// code implies x50. Taken at its marking; should it be x50, alignment sees 2.5 times the current
/// that it asked for and ends in a fault, and the setting `current_scale` puts it right.
pub const MKS_ESP32_FOC_V1_0: Board = dual_esp32(
    "mks-esp32-foc-v1-0",
    "MKS ESP32 FOC V1.0",
    Some(bidirectional_sense(Chip::Esp32, 20)),
    None,
    EG2133_DEAD_TIME_NS,
);

/// DengFOC V3.01: L6234 with both enables wired (the vendor's library drives only pin 12).
pub const DENGFOC_V3_01: Board = dual_esp32(
    "dengfoc-v3-01",
    "DengFOC V3.01",
    Some(bidirectional_sense(Chip::Esp32, 50)),
    Some([22, 12]),
    L6234_DEAD_TIME_NS,
);

/// An ESP32-S3 development board and two driver boards with three PWM inputs and an enable.
pub const GENERIC_ESP32S3: Board = Board {
    feature: "generic-esp32s3",
    chip: Chip::Esp32S3,
    hardware: hardware("generic ESP32-S3", None, UNKNOWN_DEAD_TIME_NS, true),
    bridges: [
        BridgePins { phases: [11, 12, 13], enable: Some(15), currents: None },
        BridgePins { phases: [14, 21, 47], enable: Some(16), currents: None },
    ],
    encoder: EncoderKind::As5600,
    i2c: Some([I2cPins { sda: 8, scl: 9 }, I2cPins { sda: 17, scl: 18 }]),
    spi: SpiPins { sclk: 40, miso: 41, mosi: 42, selects: [10, 7] },
    divider_option: Divider { pin: 6, replaces_current_sense: false },
    divider: None,
    current_option: Some([[1, 2], [4, 5]]),
    status_led: 38,
};

/// An ESP32-C6 development board and two driver boards with three PWM inputs and an enable.
/// Voltage mode: its conversions are too slow for phase currents.
pub const GENERIC_ESP32C6: Board = Board {
    feature: "generic-esp32c6",
    chip: Chip::Esp32C6,
    hardware: hardware("generic ESP32-C6", None, UNKNOWN_DEAD_TIME_NS, true),
    bridges: [
        BridgePins { phases: [18, 19, 20], enable: Some(10), currents: None },
        BridgePins { phases: [21, 22, 23], enable: Some(11), currents: None },
    ],
    encoder: EncoderKind::Mt6701,
    i2c: None,
    spi: SpiPins { sclk: 6, miso: 2, mosi: 7, selects: [3, 1] },
    divider_option: Divider { pin: 0, replaces_current_sense: false },
    divider: None,
    current_option: None,
    status_led: 15,
};

/// Every board.
pub const BOARDS: [&Board; 6] = [
    &MKS_DUAL_FOC_V3_1,
    &MKS_DUAL_FOC_V3_3_PLUS,
    &MKS_ESP32_FOC_V1_0,
    &DENGFOC_V3_01,
    &GENERIC_ESP32S3,
    &GENERIC_ESP32C6,
];

/// Why a board cannot be what it says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BoardError {
    /// A pin has two uses.
    #[error("GPIO {0} has two uses")]
    PinUsedTwice(Pin),
    /// A pin that has to drive cannot.
    #[error("GPIO {0} cannot be an output")]
    CannotDrive(Pin),
    /// A pin that has to be measured is not on ADC1.
    #[error("GPIO {0} is not an input of ADC1")]
    NotOnAdc1(Pin),
    /// Two AS5600 need two I2C masters.
    #[error("two AS5600 share one address and need two I2C masters: take SPI encoders")]
    OneI2cMaster,
    /// Currents are asked for where the chip cannot sample them in time.
    #[error("the chip cannot sample four phase currents in one tick")]
    TooSlowForCurrents,
}

/// What a pin has to do.
enum Role {
    Output,
    Input,
    Analog,
}

/// The pins of a board as they are handed out, and the first that cannot be.
struct Pins {
    chip: Chip,
    used: u64,
    outcome: Result<(), BoardError>,
}

impl Pins {
    /// Hands out pins that have the same to do.
    const fn take(mut self, role: Role, pins: &[Pin]) -> Self {
        let mut index = 0;
        while index < pins.len() && self.outcome.is_ok() {
            let pin = pins[index];
            self.outcome = match role {
                Role::Output if !self.chip.can_drive(pin) => Err(BoardError::CannotDrive(pin)),
                Role::Analog if self.chip.adc1_channel(pin).is_none() => {
                    Err(BoardError::NotOnAdc1(pin))
                }
                _ if self.used >> pin & 1 == 1 => Err(BoardError::PinUsedTwice(pin)),
                _ => Ok(()),
            };
            self.used |= 1 << pin;
            index += 1;
        }
        self
    }
}

impl Board {
    /// Returns the board that a cargo feature names; the constants of the binary are built with it.
    #[must_use]
    pub const fn named(feature: &str) -> Option<&'static Self> {
        let mut index = 0;
        while index < BOARDS.len() {
            if same(BOARDS[index].feature, feature) {
                return Some(BOARDS[index]);
            }
            index += 1;
        }
        None
    }

    /// Returns the board with a battery divider (100 kiloohms over 22 kiloohms) on its option pin. Where
    /// that pin belongs to a current amplifier, the motors then run in voltage mode.
    #[must_use]
    pub const fn with_battery_divider(mut self) -> Self {
        self.divider = Some(self.divider_option);
        self.hardware.bus_microvolts_per_count = NonZeroU16::new(DIVIDER_MICROVOLTS_PER_COUNT);
        let [_, highest] = self.chip.converter_millivolts();
        self.hardware.bus_largest_count = counts_of_millivolts(highest);
        if self.divider_option.replaces_current_sense {
            self.hardware.current_sense = None;
            self.bridges[0].currents = None;
            self.bridges[1].currents = None;
        }
        self
    }

    /// Returns a generic board whose driver boards measure the currents of phases A and B at 0.5 V/A
    /// around 1.65 V (0.01 ohm and x50). Boards with amplifiers of their own stay as they are.
    #[must_use]
    pub const fn with_current_sense(mut self) -> Self {
        if let Some([top, bottom]) = self.current_option {
            self.hardware.current_sense = Some(bidirectional_sense(self.chip, 50));
            self.bridges[0].currents = Some(top);
            self.bridges[1].currents = Some(bottom);
        }
        self
    }

    /// Returns the board with other encoders than those it is sold with.
    #[must_use]
    pub const fn with_encoder(mut self, encoder: EncoderKind) -> Self {
        self.encoder = encoder;
        self
    }

    /// Holds the board against its chip.
    ///
    /// # Errors
    /// When a pin is used twice, cannot do what is asked of it, or the chip lacks a bus.
    pub const fn check(&self) -> Result<(), BoardError> {
        let mut pins = Pins { chip: self.chip, used: 0, outcome: Ok(()) };
        let mut motor = 0;
        while motor < self.bridges.len() {
            let BridgePins { phases, enable, currents } = self.bridges[motor];
            pins = pins.take(Role::Output, &phases).take(Role::Output, enable.as_slice());
            if let Some(currents) = currents {
                if !self.chip.samples_currents_in_a_tick() {
                    return Err(BoardError::TooSlowForCurrents);
                }
                pins = pins.take(Role::Analog, &currents);
            }
            motor += 1;
        }
        if let Some(divider) = self.divider {
            pins = pins.take(Role::Analog, &[divider.pin]);
        }
        pins = pins.take(Role::Output, &[self.status_led]);
        pins = match (self.encoder, self.i2c) {
            (EncoderKind::As5600, Some([top, bottom])) => {
                pins.take(Role::Output, &[top.sda, top.scl, bottom.sda, bottom.scl])
            }
            (EncoderKind::As5600, None) => return Err(BoardError::OneI2cMaster),
            (EncoderKind::Mt6701 | EncoderKind::As5047p, _) => {
                let SpiPins { sclk, miso, mosi, selects: [top, bottom] } = self.spi;
                pins.take(Role::Output, &[sclk, mosi, top, bottom]).take(Role::Input, &[miso])
            }
        };
        pins.outcome
    }
}

impl EncoderKind {
    /// Returns the encoder that a cargo feature names.
    #[must_use]
    pub const fn named(feature: &str) -> Option<Self> {
        if same(feature, "encoder-as5600") {
            Some(Self::As5600)
        } else if same(feature, "encoder-mt6701") {
            Some(Self::Mt6701)
        } else if same(feature, "encoder-as5047p") {
            Some(Self::As5047p)
        } else {
            None
        }
    }
}

/// Returns whether two strings are equal, in constant functions.
const fn same(left: &str, right: &str) -> bool {
    let (left, right) = (left.as_bytes(), right.as_bytes());
    if left.len() != right.len() {
        return false;
    }
    let mut index = 0;
    while index < left.len() {
        if left[index] != right[index] {
            return false;
        }
        index += 1;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns every board with every option that it offers.
    fn variants() -> impl Iterator<Item = Board> {
        BOARDS.into_iter().flat_map(|board| {
            let currents = board.with_current_sense();
            [*board, board.with_battery_divider(), currents, currents.with_battery_divider()]
                .into_iter()
                .flat_map(|board| {
                    [EncoderKind::As5600, EncoderKind::Mt6701, EncoderKind::As5047p]
                        .map(|encoder| board.with_encoder(encoder))
                })
        })
    }

    #[test]
    fn conversions_lie_around_the_peak_or_do_not_fit() {
        // Four of 5 and of 10 us at 160 MHz, around the peak at 4,000 counts; the most that fits, and one more.
        let starts = [0, 3_200, 6_400, 8_000, 8_001].map(|counts| centred_start(4_000, counts));
        assert_eq!(starts, [Some(4_000), Some(2_400), Some(800), Some(0), None]);
    }

    #[test]
    fn every_board_fits_its_chip_with_every_option() {
        for board in variants() {
            let needs_two_masters = board.encoder == EncoderKind::As5600;
            let expected = if needs_two_masters && board.chip == Chip::Esp32C6 {
                Err(BoardError::OneI2cMaster)
            } else {
                Ok(())
            };
            assert_eq!(board.check(), expected, "{} {:?}", board.feature, board.encoder);
        }
    }

    #[test]
    fn a_pin_with_two_uses_is_refused() {
        let mut board = MKS_DUAL_FOC_V3_3_PLUS;
        board.bridges[1].phases[0] = board.bridges[0].phases[2];
        assert_eq!(board.check(), Err(BoardError::PinUsedTwice(25)));
    }

    #[test]
    fn an_input_only_pin_cannot_switch_a_phase() {
        let mut board = MKS_DUAL_FOC_V3_3_PLUS;
        board.bridges[0].phases[1] = 35;
        assert_eq!(board.check(), Err(BoardError::CannotDrive(35)));
    }

    #[test]
    fn currents_are_measured_on_adc1_alone() {
        let mut board = DENGFOC_V3_01;
        board.bridges[0].currents = Some([4, 36]);
        assert_eq!(board.check(), Err(BoardError::NotOnAdc1(4)));
    }

    #[test]
    fn a_board_without_an_enable_brakes() {
        for board in variants() {
            let has_enables = board.bridges.iter().all(|bridge| bridge.enable.is_some());
            assert_eq!(board.hardware.can_coast, has_enables, "{}", board.feature);
        }
    }

    #[test]
    fn sense_that_clips_runs_in_voltage_mode() {
        assert_eq!(MKS_DUAL_FOC_V3_1.hardware.current_sense, None);
    }

    #[test]
    fn current_is_told_exactly_where_it_is_measured() {
        for board in variants() {
            let measured = board.bridges.iter().all(|bridge| bridge.currents.is_some());
            assert_eq!(board.hardware.current_sense.is_some(), measured, "{}", board.feature);
        }
    }

    #[test]
    fn fifty_fold_sense_reads_1_6_milliamperes_a_count() {
        let sense = MKS_DUAL_FOC_V3_3_PLUS.hardware.current_sense.map(|s| s.microamperes_per_count);
        assert_eq!(sense, Some(1_611));
    }

    #[test]
    fn a_full_three_cell_battery_stays_in_the_linear_range() {
        let full = 12_600_000 / u32::from(DIVIDER_MICROVOLTS_PER_COUNT);
        assert!((2_000..3_100).contains(&full), "{full} counts");
    }

    #[test]
    fn the_largest_count_of_the_battery_is_that_of_the_chips_converter() {
        for (chip, largest) in
            [(Chip::Esp32, 3_792), (Chip::Esp32S3, 3_598), (Chip::Esp32C6, 3_999)]
        {
            for board in BOARDS.iter().filter(|board| board.chip == chip) {
                assert_eq!(board.with_battery_divider().hardware.bus_largest_count, largest);
            }
        }
    }

    #[test]
    fn no_fuses_of_an_esp32_make_what_is_clipped_look_measured() {
        // Source: ESP-IDF, `adc_cali_line_fitting.c` of the ESP32, converter 1, 11 dB. A reference is 1,100 mV and 15 steps of
        // 7 more or fewer; the two points are 278 and 3,265 and 63 and 255 steps of 4. Millivolts of all ones: between the last
        // cells of its two tables, of references of 1,000 and 1,200 mV.
        let of_ones = |reference: i32| {
            let cell = |low: i32, high: i32| low * (1_200 - reference) + high * (reference - 1_000);
            (cell(3_030, 3_184) + 63 * cell(3_060, 3_209) + 6_400) / 12_800
        };
        let of_nothing = |low: i32, high: i32| {
            let span = high - low;
            850 - (700 * high + span / 2) / span + 54
        };
        let ones = (-15..=15).map(|step| of_ones(1_100 + 7 * step)).min();
        let lows = (-63..=63).map(|step| 278 + 4 * step);
        let both = lows.flat_map(|low| (-255..=255).map(move |step| (low, 3_265 + 4 * step)));
        let nothing = both.map(|(low, high)| of_nothing(low, high)).max();
        let range = Chip::Esp32.converter_millivolts().map(i32::from);
        assert_eq!([nothing, ones], range.map(Some));
    }

    #[test]
    fn every_board_is_found_by_its_feature() {
        for board in BOARDS {
            assert_eq!(Board::named(board.feature), Some(board));
        }
        assert_eq!(Board::named("mks"), None);
    }
}
