//! What is wrongly wired, mounted or made from the beginning: what commissioning has to name.

use flix_firmware::hardware::{CurrentSense, Encoder, EncoderAngle, Sensors};
use flix_protocol::units::Instant;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::plant::electronics::Electronics;
use crate::rig::simulated::Disturbance;

/// What is wrong. Motors are 0 top and 1 bottom, phases 0 to 2, amplifiers 0 (phase A) and 1 (phase B).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WiringFault {
    /// No wire of this motor is connected.
    NotConnected(usize),
    /// A wire of this motor is not.
    OpenPhase(usize, usize),
    /// A bad joint multiplies the resistance of a phase by this.
    BadJoint(usize, usize, f64),
    /// The other two phases touch in the middle of their windings.
    ShortedBut(usize, usize),
    /// This share of the turns of a phase is left.
    ShortedTurns(usize, usize, f64),
    /// An amplifier shows nothing.
    AmplifierDead(usize, usize),
    /// The inputs of an amplifier are swapped.
    AmplifierInverted(usize, usize),
    /// The zero of an amplifier is off by so many counts.
    AmplifierOffset(usize, usize, i16),
    /// An amplifier shows so many times the current.
    AmplifierGain(usize, usize, f64),
    /// Both amplifiers of a motor show so many times the current.
    AmplifiersGain(usize, f64),
    /// An amplifier is connected to phase C.
    AmplifierOnC(usize, usize),
    /// The two amplifiers of a motor are swapped.
    AmplifiersSwapped(usize),
    /// An amplifier of one motor is swapped with one of the other.
    AmplifierCrossed(usize),
    /// Both motors' amplifiers are swapped.
    AmplifiersCrossed,
    /// All amplifiers show so many times the current: the image is another board's.
    OtherBoard(f64),
    /// The divider shows so many times the voltage.
    Divider(f64),
    /// The encoders of the motors are swapped.
    EncodersSwapped,
    /// An encoder does not answer.
    EncoderLost(usize),
    /// The magnet of an encoder is far: so much noise, degrees root mean square.
    EncoderNoisy(usize, f64),
    /// The magnet of an encoder does not turn with the shaft.
    EncoderStill(usize),
    /// The magnet of an encoder slips: it turns by this share.
    MagnetSlips(usize, f64),
    /// A rotor is held.
    Blocked(usize),
    /// The bottom motor has so many pole pairs.
    BottomPolePairs(u32),
    /// A rotor has this share of its inertia.
    NoMass(usize, f64),
}

/// A robot's wiring fault, from power-up on.
#[derive(Debug, Clone)]
pub struct Miswired {
    fault: WiringFault,
    sense: Option<CurrentSense>,
    is_wired: bool,
    random: Xoshiro256PlusPlus,
    /// The true angle of the last reading, and what is shown instead.
    last: Option<(EncoderAngle, EncoderAngle)>,
}

impl Miswired {
    /// Creates it for a board with these amplifiers.
    #[must_use]
    pub fn new(fault: WiringFault, sense: Option<CurrentSense>, seed: u64) -> Self {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Self { fault, sense, is_wired: false, random, last: None }
    }

    fn disturb_currents(&self, zero: i16, currents: &mut [[i16; 2]; 2]) {
        let scaled = |count: &mut i16, factor: f64| {
            *count = zero.saturating_add((factor * f64::from(*count - zero)).round() as i16);
        };
        match self.fault {
            WiringFault::AmplifierDead(motor, amplifier) => currents[motor][amplifier] = zero,
            WiringFault::AmplifierInverted(motor, amplifier) => {
                scaled(&mut currents[motor][amplifier], -1.0);
            }
            WiringFault::AmplifierOffset(motor, amplifier, counts) => {
                let count = &mut currents[motor][amplifier];
                *count = count.saturating_add(counts);
            }
            WiringFault::AmplifierGain(motor, amplifier, factor) => {
                scaled(&mut currents[motor][amplifier], factor);
            }
            WiringFault::AmplifiersGain(motor, factor) => {
                currents[motor].iter_mut().for_each(|count| scaled(count, factor));
            }
            WiringFault::AmplifierOnC(motor, amplifier) => {
                let [a, b] = currents[motor].map(|count| count - zero);
                currents[motor][amplifier] = zero - a - b;
            }
            WiringFault::AmplifiersSwapped(motor) => currents[motor].swap(0, 1),
            WiringFault::AmplifierCrossed(amplifier) => {
                let [top, bottom] = currents;
                core::mem::swap(&mut top[amplifier], &mut bottom[amplifier]);
            }
            WiringFault::AmplifiersCrossed => currents.swap(0, 1),
            WiringFault::OtherBoard(factor) => {
                currents.as_flattened_mut().iter_mut().for_each(|count| scaled(count, factor));
            }
            _ => {}
        }
    }

    fn disturb_encoder(&mut self, index: usize, encoder: &mut Encoder) {
        let Encoder::Reading(reading) = encoder else { return };
        let turned =
            |angle: EncoderAngle, turns: f64| angle.turned((turns * 2f64.powi(32)) as i64 as i32);
        match self.fault {
            WiringFault::EncoderLost(motor) if motor == index => *encoder = Encoder::Failed,
            WiringFault::EncoderNoisy(motor, degrees) if motor == index => {
                let error: f64 = StandardNormal.sample(&mut self.random);
                reading.angle = turned(reading.angle, error * degrees / 360.0);
            }
            WiringFault::EncoderStill(motor) if motor == index => {
                reading.angle = self.last.get_or_insert((reading.angle, reading.angle)).1;
            }
            WiringFault::MagnetSlips(motor, share) if motor == index => {
                let (last, shown) = self.last.unwrap_or((reading.angle, reading.angle));
                let moved = f64::from((reading.angle.raw().wrapping_sub(last.raw())) as i32);
                let shown = turned(shown, share * moved / 2f64.powi(32));
                self.last = Some((reading.angle, shown));
                reading.angle = shown;
            }
            _ => {}
        }
    }
}

/// Resistance and inductance of the three phases, one of which differs.
fn but(phase: usize, others: (f64, f64), it: (f64, f64)) -> [(f64, f64); 3] {
    core::array::from_fn(|index| if index == phase { it } else { others })
}

impl Disturbance for Miswired {
    fn electronics(&mut self, _now: Instant, electronics: &mut Electronics) {
        if core::mem::replace(&mut self.is_wired, true) {
            return;
        }
        match self.fault {
            WiringFault::NotConnected(motor) => {
                (0..3).for_each(|phase| electronics.motor_mut(motor).break_wire(phase, true));
            }
            WiringFault::OpenPhase(motor, phase) => {
                electronics.motor_mut(motor).break_wire(phase, true);
            }
            WiringFault::BadJoint(motor, phase, factor) => {
                electronics.motor_mut(motor).spoil(but(phase, (1.0, 1.0), (factor, 1.0)));
            }
            // Half of each is left, and the other halves lie beside each other before the third.
            WiringFault::ShortedBut(motor, phase) => {
                let (touching, third) = ((0.5, 0.25), (1.25, 1.0625));
                electronics.motor_mut(motor).spoil(but(phase, touching, third));
            }
            WiringFault::ShortedTurns(motor, phase, share) => {
                let left = (share, share * share);
                electronics.motor_mut(motor).spoil(but(phase, (1.0, 1.0), left));
            }
            WiringFault::Blocked(motor) => {
                electronics.motor_mut(motor).parameters_mut().coulomb_friction = 1.0;
            }
            WiringFault::BottomPolePairs(pairs) => {
                electronics.motor_mut(1).parameters_mut().pole_pairs = pairs;
            }
            WiringFault::NoMass(motor, share) => electronics.lighten(motor, share),
            _ => {}
        }
    }

    fn sensors(&mut self, _now: Instant, sensors: &mut Sensors) {
        if let (Some(sense), Some(currents)) = (self.sense, &mut sensors.phase_current) {
            self.disturb_currents(sense.zero_count, currents);
        }
        if let WiringFault::Divider(factor) = self.fault {
            sensors.bus_voltage =
                sensors.bus_voltage.map(|count| (factor * f64::from(count)).round() as u16);
        }
        if self.fault == WiringFault::EncodersSwapped {
            sensors.encoders.swap(0, 1);
        }
        for (index, encoder) in sensors.encoders.iter_mut().enumerate() {
            self.disturb_encoder(index, encoder);
        }
    }
}
