//! The simulated robot, soldered to the chip's pins as the generic ESP32-C6 board says: bridges at the PWM's pins,
//! encoders on the SPI bus, the battery's divider at the converter.
//!
//! The plant moves in steps of a tick of the simulator, [`STEP_CYCLES`], under what the pins do at the step's start;
//! between two steps the rotors are where a straight line puts them.

use flix_firmware::board::{Board, EncoderKind, GENERIC_ESP32C6};
use flix_firmware::hardware::{
    Actuation, Bridge, Duty, Encoder as Reading, Hardware, Magnet, TICK_RATE_HZ,
};
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::electronics::sensor::{Encoder, MT6701};
use flix_sim::plant::electronics::{Electronics, ElectronicsParameters};
use flix_sim::plant::mechanics::Plant;
use flix_sim::plant::{Diverged, Mechanics};
use flix_sim::rig::simulated::Truth;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

use flix_esp32c6::{CYCLES_PER_SECOND, Transfer, Wave};
use flix_esp32c6::{Outside, Pins};

/// Cycles of the chip in a step of the plant.
pub const STEP_CYCLES: u64 = CYCLES_PER_SECOND / TICK_RATE_HZ as u64;
/// The simulator has duties act when the board states; here the pins already have that delay, so none is left.
const NO_DELAY_US: u16 = (STEP_CYCLES / 2 * 1_000_000 / CYCLES_PER_SECOND) as u16;
/// Share of the battery's voltage at the divider's pin: 22 kiloohms of 122.
const DIVIDER: f64 = 22.0 / 122.0;
/// Fastest clocks that the encoders follow (MT6701 data sheet rev. 1.8, SSI; AS5047P data sheet v1-08, table 12).
const MT6701_FASTEST_HZ: u64 = 15_625_000;
const AS5047P_FASTEST_HZ: u64 = 10_000_000;
/// An AS5047P receives one command in so many, prime to those that ask for something else, with a wrong bit: the wires to
/// the motors are long.
const DISTURBED_EVERY: u64 = 4_999;
/// Both put data out on the rising edge, to be read on the falling one.
const ENCODER_MODE: u8 = 1;

/// Pins of the board that matter to the plant.
pub(crate) const BOARD: &Board = &GENERIC_ESP32C6;

/// Battery, bridges, motors, rotors and encoders.
pub struct Robot {
    plant: Plant,
    electronics: Electronics,
    encoders: [Encoder; 2],
    kind: EncoderKind,
    random: Xoshiro256PlusPlus,
    steps: u64,
    began: u64,
    before: [f64; 2],
    /// What AS5047P encoders answer with the next frame: the data that the last one asked for, of when it ended.
    answers: [u16; 2],
    /// Error registers of AS5047P encoders: what is set there is flagged in every answer until it is read.
    errors: [u16; 2],
    /// Commands that AS5047P encoders received.
    commands: [u64; 2],
    /// What the encoders find of their magnets.
    pub magnets: [Magnet; 2],
    /// SPI transfers that no encoder answered, or two at once did.
    pub bad_transfers: u64,
}

impl Robot {
    /// Creates the paper's robot with encoders of this kind; everything that chance decides follows from `seed`.
    ///
    /// # Panics
    /// Never: the model is one of the simulator's own, and is tested there.
    pub fn new(kind: EncoderKind, seed: u64) -> Self {
        let model = RobotModel::named("W").and_then(|model| Plant::new(&model));
        let hardware = Hardware { actuation_delay_us: NO_DELAY_US, ..BOARD.hardware };
        let parameters =
            ElectronicsParameters { encoder: MT6701, ..ElectronicsParameters::on(hardware) };
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        random.jump();
        Self {
            plant: model.expect("a model that comes with the simulator"),
            electronics: Electronics::new(&parameters, seed),
            encoders: [(); 2].map(|()| Encoder::mounted(MT6701, &mut random)),
            kind,
            random,
            steps: 0,
            began: 0,
            before: [0.0; 2],
            answers: [0; 2],
            errors: [0; 2],
            commands: [0; 2],
            magnets: [Magnet::Good; 2],
            bad_transfers: 0,
        }
    }

    /// Pins of the bridges' phases and of their enables: top, bottom.
    pub fn bridge_pins() -> [([u32; 3], Option<u32>); 2] {
        BOARD.bridges.map(|bridge| (bridge.phases.map(u32::from), bridge.enable.map(u32::from)))
    }

    /// Returns the pin of the status light.
    pub fn light_pin() -> u32 {
        BOARD.status_led.into()
    }

    /// Moves for [`STEP_CYCLES`] from `cycles` on, under what the pins do then: phases and enable of each bridge, `None`
    /// where nothing drives a pin. A bridge whose enable is not driven is off, as is an input that is not driven low.
    pub fn step(
        &mut self,
        cycles: u64,
        pins: [([Option<Wave>; 3], Option<Wave>); 2],
    ) -> Result<(), Diverged> {
        self.began = cycles;
        self.before = self.plant.rotor_angle();
        let bridges = pins.map(|(phases, enable)| {
            if enable.is_none_or(|wave| wave.share < 0.5) {
                return Bridge::Off;
            }
            let share = |wave: Option<Wave>| wave.map_or(0.0, |wave| wave.share);
            Bridge::Duty(
                phases.map(|wave| Duty::from_raw((share(wave) * f64::from(u16::MAX)) as u16)),
            )
        });
        self.electronics.advance(&Actuation { bridges }, &mut self.plant)?;
        // Sensors are read through the pins; their noise goes on.
        let _ = self.electronics.sense(&self.plant);
        self.steps += 1;
        Ok(())
    }

    /// Returns how the robot truly is, at the end of its last step, which was at `time`.
    pub fn truth(&self, time: Instant) -> Truth {
        Truth::of(time, &self.plant, &self.electronics)
    }

    /// Returns the battery's voltage at the bridges, V.
    pub fn bus_voltage(&self) -> f64 {
        self.electronics.battery().bus_voltage()
    }

    /// The angle that an encoder shows at `cycles`, as a count of 14 bits.
    fn count(&mut self, motor: usize, cycles: u64) -> u32 {
        let share = cycles.saturating_sub(self.began) as f64 / STEP_CYCLES as f64;
        let after = self.plant.rotor_angle()[motor];
        let angle = self.before[motor] + (after - self.before[motor]) * share.min(1.0);
        let speed = self.plant.rotor_speed()[motor];
        match self.encoders[motor].read(self.steps, angle, speed, &mut self.random) {
            Reading::Reading(reading) => reading.angle.raw() >> 18,
            // An encoder without a period of its own always has a reading.
            Reading::Pending | Reading::Failed => 0,
        }
    }

    /// The bits that an encoder shifts out, the first in the highest of `bits`.
    fn word(&mut self, motor: usize, cycles: u64, transfer: &Transfer) -> u32 {
        match self.kind {
            EncoderKind::As5047p => self.as5047p_word(motor, cycles, transfer),
            _ => mt6701_word(self.count(motor, cycles), mt6701_status(self.magnets[motor])),
        }
    }

    /// Answers the command before, with the error flag while an error is latched (AS5047P data sheet v1-08, ERRFL).
    fn as5047p_word(&mut self, motor: usize, cycles: u64, transfer: &Transfer) -> u32 {
        const READ: u16 = 1 << 14;
        const ANGLE: u16 = 0x3FFF;
        const DIAGNOSTICS: u16 = 0x3FFC;
        const ERRORS: u16 = 0x0001;
        const READY: u16 = 1 << 8;
        const LARGEST_GAIN: u16 = 0xFF;
        /// Ready, field in range.
        const HEALTHY: u16 = READY | 0x80;
        /// MAGL and MAGH.
        const WEAK: u16 = 1 << 11;
        const STRONG: u16 = 1 << 10;
        /// Errors: a frame cut short, no such register, parity.
        const FRAME: u16 = 1 << 0;
        const INVALID: u16 = 1 << 1;
        const PARITY: u16 = 1 << 2;
        let [first, second] = [0, 1].map(|index| transfer.data.get(index).copied().unwrap_or(0));
        let mut asked = u16::from_be_bytes([first, second]);
        self.commands[motor] += 1;
        let number = self.commands[motor] + motor as u64 * DISTURBED_EVERY / 2;
        if number.is_multiple_of(DISTURBED_EVERY) {
            asked ^= 1 << (number / DISTURBED_EVERY % 16);
        }
        let mut errors = self.errors[motor];
        let data = match asked & 0x3FFF {
            ANGLE => self.count(motor, cycles) as u16,
            DIAGNOSTICS => match self.magnets[motor] {
                Magnet::Good => HEALTHY,
                Magnet::Weak | Magnet::Missing => READY | WEAK | LARGEST_GAIN,
                Magnet::Strong => READY | STRONG,
            },
            ERRORS => core::mem::take(&mut errors),
            _ => {
                errors |= INVALID;
                0
            }
        };
        if transfer.bits != 16 {
            errors |= FRAME;
        }
        if asked.count_ones() % 2 == 1 {
            errors |= PARITY;
        }
        if asked & READ == 0 {
            errors |= INVALID;
        }
        self.errors[motor] = errors;
        let answer = data | u16::from(errors != 0) << 14;
        let answer = answer | ((answer.count_ones() % 2) as u16) << 15;
        u32::from(core::mem::replace(&mut self.answers[motor], answer))
    }

    const fn fastest_hz(&self) -> u64 {
        match self.kind {
            EncoderKind::As5047p => AS5047P_FASTEST_HZ,
            _ => MT6701_FASTEST_HZ,
        }
    }

    const fn frame_bits(&self) -> usize {
        match self.kind {
            EncoderKind::As5047p => 16,
            _ => 24,
        }
    }
}

/// An MT6701's status: its field is too strong, or too weak.
const fn mt6701_status(magnet: Magnet) -> u32 {
    match magnet {
        Magnet::Good => 0,
        Magnet::Strong => 0b01,
        Magnet::Weak | Magnet::Missing => 0b10,
    }
}

/// An MT6701's frame: 14 bits of angle, 4 of status, 6 of check sum (polynomial x^6 + x + 1).
fn mt6701_word(count: u32, status: u32) -> u32 {
    let payload = count << 4 | status;
    let sum = (0..18).rev().fold(0_u32, |sum, bit| {
        let feedback = (sum >> 5 ^ payload >> bit) & 1;
        (sum << 1 & 0x3F) ^ (feedback * 0b11)
    });
    payload << 6 | sum
}

impl Outside for Robot {
    fn exchange(&mut self, cycles: u64, pins: &Pins, transfer: &Transfer) -> Vec<u8> {
        let silence = vec![0xFF; transfer.data.len()];
        let spi = BOARD.spi;
        let selected = spi.selects.map(|pin| pins.level(pin.into()) == Some(false));
        let is_wired = pins.carries_spi_clock(spi.sclk.into())
            && pins.spi_input() == Some(spi.miso.into())
            && (self.kind != EncoderKind::As5047p || pins.carries_spi_data(spi.mosi.into()));
        let motor = match selected {
            [true, false] if is_wired => 0,
            [false, true] if is_wired => 1,
            _ => {
                self.bad_transfers += 1;
                return silence;
            }
        };
        let bits = self.frame_bits();
        let mut word = self.word(motor, cycles, transfer);
        if transfer.mode != ENCODER_MODE {
            // Read on the edge on which it changes: a bit late, after the line's idle level.
            word = word >> 1 | 1 << (bits - 1);
        }
        if transfer.hertz > self.fastest_hz() || transfer.hertz == 0 {
            // It does not follow.
            self.bad_transfers += 1;
            return silence;
        }
        if transfer.bits != bits {
            self.bad_transfers += 1;
        }
        let aligned = u64::from(word) << (64 - bits);
        let mut bytes = aligned.to_be_bytes().to_vec();
        bytes.resize(transfer.data.len(), 0xFF);
        bytes
    }

    fn millivolts(&mut self, _cycles: u64, pin: u32) -> f64 {
        if pin != u32::from(BOARD.divider_option.pin) {
            return 0.0;
        }
        self.bus_voltage() * DIVIDER * 1e3
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_firmware::board::as5047p::{As5047p, As5047pReading};
    use flix_firmware::board::encoder::mt6701;
    use flix_firmware::hardware::EncoderAngle;

    #[test]
    fn an_mt6701s_frame_is_read_by_the_robots_own_driver() {
        let [_, frame @ ..] = mt6701_word(0x2A5F, 0).to_be_bytes();
        assert_eq!(mt6701(frame), Some(EncoderAngle::from_count(0x2A5F, 14)));
    }

    #[test]
    fn an_as5047p_latches_a_wrong_command_and_its_driver_ends_that() {
        let mut robot = Robot::new(EncoderKind::As5047p, 1);
        let mut word = |command: [u8; 2]| {
            let transfer = Transfer { mode: 1, hertz: 8_000_000, bits: 16, data: command.to_vec() };
            let [.., high, low] = robot.as5047p_word(0, 0, &transfer).to_be_bytes();
            Some([high, low])
        };
        word([0x52, 0x34]);
        let is_flagged = |answer: Option<[u8; 2]>| answer.is_some_and(|[high, _]| high & 0x40 != 0);
        let latched = (0..100).filter(|_| is_flagged(word([0xFF, 0xFF]))).count();
        let mut driver = As5047p::new();
        let mut read = |driver: &mut As5047p| driver.read(&mut word);
        let first = core::iter::repeat_with(|| read(&mut driver))
            .take(10)
            .position(|reading| matches!(reading, As5047pReading::Angle(_)));
        assert_eq!((latched, first), (100, Some(3)));
    }
}
