//! What breaks in the robot itself: encoders, wires, amplifiers, battery, processor.

use core::time::Duration;

use flix_firmware::hardware::{
    Actuation, Bridge, Encoder, EncoderAngle, EncoderReading, Magnet, Sensors, TICK_US,
};
use flix_protocol::units::Instant;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::plant::electronics::Electronics;
use crate::plant::electronics::inverter::Leg;
use crate::rig::simulated::{Disturbance, Processor};

/// Time that the boot loader and the start of the software take. Assumed: what an ESP32 takes from flash.
pub const BOOT_TIME: Duration = Duration::from_millis(300);

/// What breaks. Motors are 0 top, 1 bottom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HardwareFault {
    /// The encoder of this motor repeats one reading.
    EncoderStuck(usize),
    /// The encoder of this motor does not answer.
    EncoderLost(usize),
    /// The readings of both encoders have this much more noise, degrees RMS.
    EncoderNoise(f64),
    /// Every so many readings of this motor's encoder are off by this much, degrees.
    EncoderJumps(usize, u32, f64),
    /// The encoder of this motor says this of its magnet.
    Magnet(usize, Magnet),
    /// Something holds the rotor of this motor: a bearing of so much friction, N m.
    Jammed(usize, f64),
    /// The driver of this motor's bridge shuts itself down, as one that is too hot does.
    BridgeShutDown(usize),
    /// The wire of a phase (0 to 2) of this motor breaks.
    OpenPhase(usize, usize),
    /// A leg (0 to 2) of this motor's bridge breaks.
    Leg(usize, usize, Leg),
    /// The amplifier of phase A of this motor reads so many counts too much.
    CurrentOffset(usize, i16),
    /// The battery's open-circuit voltage falls by this, V.
    BusSag(f64),
    /// The battery's divider shows this share of the bus: none with its wire off.
    BusReads(f64),
    /// The divider's pin floats: it shows any share of the bus.
    BusFloats,
    /// One reading in each tenth of a second shows this share of the bus, for 1.6 ms.
    BusOutliers(f64),
    /// The processor does something else than its work.
    Processor(Processor),
}

/// A fault that comes at a time and goes at another.
#[derive(Debug, Clone)]
pub struct Injected {
    fault: HardwareFault,
    from: Instant,
    until: Instant,
    is_active: bool,
    random: Xoshiro256PlusPlus,
    /// Where the encoder got stuck.
    stuck: Option<EncoderAngle>,
    /// Readings of the encoder that jumps.
    readings: u32,
    /// Friction of a bearing that nothing holds, N m.
    free: f64,
}

impl Injected {
    /// Limits a fault to this time on, and before that time.
    #[must_use]
    pub fn new(fault: HardwareFault, from: Instant, until: Instant, seed: u64) -> Self {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Self { fault, from, until, is_active: false, random, stuck: None, readings: 0, free: 0.0 }
    }

    fn set(&mut self, is_active: bool, electronics: &mut Electronics) {
        if core::mem::replace(&mut self.is_active, is_active) == is_active {
            return;
        }
        match self.fault {
            HardwareFault::OpenPhase(motor, phase) => {
                electronics.motor_mut(motor).break_wire(phase, is_active);
            }
            HardwareFault::Leg(motor, phase, leg) => {
                electronics.set_leg(motor, phase, if is_active { leg } else { Leg::Good });
            }
            HardwareFault::Magnet(motor, magnet) => {
                electronics.set_magnet(motor, if is_active { magnet } else { Magnet::Good });
            }
            HardwareFault::Jammed(motor, held) => {
                let friction = &mut electronics.motor_mut(motor).parameters_mut().coulomb_friction;
                if is_active {
                    self.free = *friction;
                }
                *friction = if is_active { held } else { self.free };
            }
            HardwareFault::BusSag(volts) => {
                electronics.battery_mut().disturb(if is_active { -volts } else { 0.0 });
            }
            _ => {}
        }
    }

    fn disturb_encoder(&mut self, index: usize, encoder: &mut Encoder) {
        let Encoder::Reading(EncoderReading { angle, .. }) = encoder else { return };
        match self.fault {
            HardwareFault::EncoderStuck(motor) if motor == index && self.is_active => {
                *angle = *self.stuck.get_or_insert(*angle);
            }
            HardwareFault::EncoderLost(motor) if motor == index && self.is_active => {
                *encoder = Encoder::Failed;
            }
            HardwareFault::EncoderNoise(degrees) if self.is_active => {
                let error: f64 = StandardNormal.sample(&mut self.random);
                *angle = angle.turned(turned(error * degrees));
            }
            HardwareFault::EncoderJumps(motor, every, degrees)
                if motor == index && self.is_active =>
            {
                self.readings += 1;
                if self.readings.is_multiple_of(every) {
                    *angle = angle.turned(turned(degrees));
                }
            }
            _ => {}
        }
    }
}

/// Degrees in 2^-32 turn.
fn turned(degrees: f64) -> i32 {
    (degrees / 360.0 * 2f64.powi(32)) as i64 as i32
}

impl Disturbance for Injected {
    fn electronics(&mut self, now: Instant, electronics: &mut Electronics) {
        self.set((self.from..self.until).contains(&now), electronics);
    }

    fn mend(&mut self, electronics: &mut Electronics) {
        self.set(false, electronics);
    }

    fn actuation(&mut self, _now: Instant, actuation: &mut Actuation) {
        if let (HardwareFault::BridgeShutDown(motor), true) = (self.fault, self.is_active) {
            actuation.bridges[motor] = Bridge::Off;
        }
    }

    fn processor(&mut self, _now: Instant) -> Processor {
        match self.fault {
            HardwareFault::Processor(processor) if self.is_active => processor,
            _ => Processor::Runs,
        }
    }

    fn sensors(&mut self, now: Instant, sensors: &mut Sensors) {
        if let (true, Some(counts)) = (self.is_active, &mut sensors.bus_voltage) {
            let is_outlier = now.as_micros() % 100_000 < u64::from(16 * TICK_US);
            let share = match self.fault {
                HardwareFault::BusReads(share) => share,
                HardwareFault::BusFloats => self.random.random(),
                HardwareFault::BusOutliers(share) if is_outlier => share,
                _ => 1.0,
            };
            *counts = (share * f64::from(*counts)) as u16;
        }
        for (index, encoder) in sensors.encoders.iter_mut().enumerate() {
            self.disturb_encoder(index, encoder);
        }
        if let (HardwareFault::CurrentOffset(motor, counts), true, Some(currents)) =
            (self.fault, self.is_active, &mut sensors.phase_current)
        {
            currents[motor][0] = currents[motor][0].saturating_add(counts);
        }
    }
}
