//! Battery, bridges, motors and sensors put together, driving whatever the rotors hang on.
//!
//! A tick of the robot's software is cut into [`SUB_STEPS`]. In each, bridge voltages, back EMF, dead
//! time and bus voltage are constant and the circuits are solved exactly; the mean torque of the tick then moves the
//! mechanics in one step, in which the rotors are taken to turn at the speed they had at its start.

use flix_firmware::hardware::{
    Actuation, Bridge, Encoder as EncoderOutput, Hardware, Magnet, Sensors,
};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use self::battery::{Battery, BatteryParameters, BusDecay, PAPER_BATTERY};
use self::inverter::{InverterParameters, Leg, block_reversed};
use self::motor::{ASSUMED_MOTOR, Decay, Motor, MotorParameters};
use self::ripple::{Sampling, ripple};
use self::sensor::{
    AS5600, AmplifierParameters, BusSensor, CurrentSensor, Encoder, EncoderParameters,
    INLINE_AMPLIFIER,
};
use super::{Diverged, Mechanics};

pub use self::inverter::TICK;

pub mod battery;
mod build;
pub mod inverter;
pub mod motor;
pub mod ripple;
pub mod sensor;

/// Sub-steps of the electrical circuits in each tick. The fastest of them, the bus capacitor, has a time constant
/// of 40 us.
pub const SUB_STEPS: usize = 4;
const SUB_STEP: f64 = TICK / SUB_STEPS as f64;

/// What the electrical part is made of, before chance varies it.
#[derive(Debug, Clone, PartialEq)]
pub struct ElectronicsParameters {
    /// The board.
    pub hardware: Hardware,
    /// Both motors.
    pub motor: MotorParameters,
    /// By how much the two motors differ in resistance, flux linkage and friction, as a share of
    /// `motor`'s; each quantity is larger in a motor that chance picks.
    pub motor_difference: f64,
    /// The battery.
    pub battery: BatteryParameters,
    /// Charge at the start as a share of the capacity, lowest and highest that chance may give.
    pub charge: (f64, f64),
    /// Both encoders.
    pub encoder: EncoderParameters,
    /// Current amplifiers, where the board has any.
    pub amplifier: AmplifierParameters,
}

impl ElectronicsParameters {
    /// Creates the paper's robot with the assumed motors on this board, battery charged to more than a half.
    #[must_use]
    pub fn on(hardware: Hardware) -> Self {
        Self {
            hardware,
            motor: ASSUMED_MOTOR,
            motor_difference: 0.10,
            battery: PAPER_BATTERY,
            charge: (0.5, 1.0),
            encoder: AS5600,
            amplifier: INLINE_AMPLIFIER,
        }
    }
}

/// Everything between the robot's software and the rotors.
#[derive(Debug, Clone)]
pub struct Electronics {
    inverter: InverterParameters,
    bus_decay: BusDecay,
    chains: [Chain; 2],
    battery: Battery,
    sampling: Sampling,
    bus_sensor: Option<BusSensor>,
    random: Xoshiro256PlusPlus,
    ticks: u64,
    ledger: Ledger,
    /// Share of its inertia that each rotor has.
    inertia_share: [f64; 2],
    magnets: [Magnet; 2],
}

/// One motor with its bridge and sensors.
#[derive(Debug, Clone)]
struct Chain {
    motor: Motor,
    decay: Decay,
    encoder: Encoder,
    current_sensor: Option<CurrentSensor>,
    /// How the legs of its bridge are.
    legs: [Leg; 3],
    /// Actuation that is in force.
    bridge: Bridge,
    /// Actuation of the tick before: in force only later than a tick after its samples where the carrier is slow.
    before: Bridge,
}

/// Where energy went since the start, J.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ledger {
    /// Given by the battery's chemistry.
    pub battery: f64,
    /// Heat in the battery and its leads.
    pub battery_heat: f64,
    /// Heat in the diodes of coasting bridges.
    pub diodes: f64,
    /// Heat in the windings.
    pub copper: f64,
    /// Heat in the bearings, and windage.
    pub friction: f64,
    /// Work on the rotors beyond friction and cogging: the mechanics' income.
    pub mechanical: f64,
    /// In bus capacitor, windings, stuck bearings and magnets over teeth, more than at the start.
    pub stored: f64,
}

impl Ledger {
    /// Returns what came in and is not accounted for, J. Zero but for the error of the sub-steps.
    #[must_use]
    pub fn imbalance(&self) -> f64 {
        self.battery
            - self.battery_heat
            - self.diodes
            - self.copper
            - self.friction
            - self.mechanical
            - self.stored
    }
}

impl Electronics {
    /// Builds, mounts and wires one as this seed has it: which motor is the stronger, how wires, magnets and
    /// amplifiers are connected, how wrong sensors are, how full the battery is, and all noise that follows.
    #[must_use]
    pub fn new(parameters: &ElectronicsParameters, seed: u64) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let motors = different_motors(parameters, &mut random);
        let inverted = random.random::<f64>() < 0.5;
        let chains = motors.map(|motor| Chain::built(parameters, motor, inverted, &mut random));
        let (lowest, highest) = parameters.charge;
        let charge = lowest + (highest - lowest) * random.random::<f64>();
        let bus_sensor = parameters
            .hardware
            .bus_microvolts_per_count
            .map(|step| BusSensor::built(step, parameters.hardware.bus_largest_count, &mut random));
        let mut electronics = Self {
            inverter: InverterParameters::of(&parameters.hardware),
            bus_decay: BusDecay::new(&parameters.battery, SUB_STEP),
            chains,
            battery: Battery::new(parameters.battery, charge),
            sampling: Sampling::of(parameters.hardware.pwm_frequency_hz, &mut random),
            bus_sensor,
            random,
            ticks: 0,
            ledger: Ledger::default(),
            inertia_share: [1.0; 2],
            magnets: [Magnet::Good; 2],
        };
        electronics.ledger.stored = -electronics.stored([0.0; 2]);
        electronics
    }

    /// Returns what the robot's software reads at the start of a tick.
    pub fn sense(&mut self, mechanics: &impl Mechanics) -> Sensors {
        let (angle, speed) = (mechanics.rotor_angle(), mechanics.rotor_speed());
        let (ticks, random) = (self.ticks, &mut self.random);
        let mut encoders = [EncoderOutput::Pending; 2];
        let mut currents = [None; 2];
        for (index, chain) in self.chains.iter().enumerate() {
            let reading = chain.encoder.read(ticks, angle[index], speed[index], random);
            let is_missing = self.magnets[index] == Magnet::Missing;
            encoders[index] = if is_missing { EncoderOutput::Failed } else { reading };
            let sampled = || {
                let currents = chain.motor.phase_currents();
                [0, 1].map(|phase| {
                    let at = self.sampling.phase(ticks, 2 * index + phase);
                    currents[phase]
                        + chain.ripple(self.battery.bus_voltage(), &self.sampling, at)[phase]
                })
            };
            currents[index] =
                chain.current_sensor.as_ref().map(|sensor| sensor.read(sampled(), random));
        }
        let [top, bottom] = currents;
        Sensors {
            encoders,
            magnets: self.magnets,
            phase_current: top.zip(bottom).map(|(top, bottom)| [top, bottom]),
            bus_voltage: self
                .bus_sensor
                .as_ref()
                .map(|sensor| sensor.read(self.battery.bus_voltage(), random)),
        }
    }

    /// Advances by one tick of [`TICK`] seconds under what the software decided from the sensors at its start.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn advance(
        &mut self,
        actuation: &Actuation,
        mechanics: &mut impl Mechanics,
    ) -> Result<(), Diverged> {
        let (angle, speed) = (mechanics.rotor_angle(), mechanics.rotor_speed());
        let electromagnetic = self.run_circuits(actuation, angle, speed);
        let mut friction = [0.0; 2];
        let mut torque = electromagnetic;
        for (index, chain) in self.chains.iter().enumerate() {
            friction[index] = chain.motor.friction(speed[index]);
            torque[index] +=
                friction[index] + chain.motor.cogging(angle[index], speed[index] * TICK);
        }
        let accelerating: [f64; 2] =
            core::array::from_fn(|index| torque[index] / self.inertia_share[index]);
        mechanics.step(accelerating, TICK)?;
        let after = mechanics.rotor_angle();
        for (index, chain) in self.chains.iter_mut().enumerate() {
            let turned = after[index] - angle[index];
            chain.motor.slide(turned);
            self.ledger.friction -= friction[index] * turned;
            self.ledger.mechanical += torque[index] * turned;
        }
        self.ticks += 1;
        Ok(())
    }

    /// Mean electromagnetic torque of each motor over the tick.
    fn run_circuits(
        &mut self,
        actuation: &Actuation,
        angle: [f64; 2],
        speed: [f64; 2],
    ) -> [f64; 2] {
        let mut sweeps: [_; 2] = core::array::from_fn(|index| {
            self.chains[index].motor.sweep(angle[index], speed[index], SUB_STEP)
        });
        let late = (self.inverter.latency / SUB_STEP).round() as usize;
        let (ticks, late) = (late / SUB_STEPS, late % SUB_STEPS);
        let mut torque = [0.0; 2];
        for sub_step in 0..SUB_STEPS {
            let bus = self.battery.bus_voltage();
            let mut drawn = 0.0;
            for (index, chain) in self.chains.iter_mut().enumerate() {
                if sub_step == late {
                    chain.bridge = if ticks == 0 { actuation.bridges[index] } else { chain.before };
                }
                let (mean_torque, charge) =
                    chain.run(&self.inverter, bus, &sweeps[index], &mut self.ledger);
                torque[index] += mean_torque / SUB_STEPS as f64;
                drawn += charge;
                sweeps[index].advance();
            }
            self.battery.draw(drawn, &self.bus_decay);
        }
        for (chain, bridge) in self.chains.iter_mut().zip(actuation.bridges) {
            chain.before = bridge;
        }
        torque
    }

    /// Currents of phases A, B, C of both motors, A into the motor.
    #[must_use]
    pub fn phase_currents(&self) -> [[f64; 3]; 2] {
        [0, 1].map(|index| self.chains[index].motor.phase_currents())
    }

    /// Currents (d, q) of both motors in their rotors' frames, positive q about body +z, A.
    #[must_use]
    pub fn rotor_frame_currents(&self, rotor_angle: [f64; 2]) -> [[f64; 2]; 2] {
        [0, 1].map(|index| self.chains[index].motor.rotor_frame_current(rotor_angle[index]))
    }

    /// Changes what an encoder says of its magnet; without one it gives no angle.
    pub const fn set_magnet(&mut self, motor: usize, magnet: Magnet) {
        self.magnets[motor] = magnet;
    }

    /// Breaks (or mends) a leg, 0 to 2, of a motor's bridge (0 top, 1 bottom). Panics on others.
    pub const fn set_leg(&mut self, motor: usize, phase: usize, leg: Leg) {
        self.chains[motor].legs[phase] = leg;
    }

    /// Returns the battery, to read or to disturb.
    pub fn battery_mut(&mut self) -> &mut Battery {
        &mut self.battery
    }

    /// Returns the battery.
    #[must_use]
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// Returns a motor, to read or to break: 0 top, 1 bottom. Panics on another.
    pub fn motor_mut(&mut self, index: usize) -> &mut Motor {
        &mut self.chains[index].motor
    }

    /// Returns a motor: 0 top, 1 bottom. Panics on another.
    #[must_use]
    pub fn motor(&self, index: usize) -> &Motor {
        &self.chains[index].motor
    }

    /// Leaves a rotor (0 top, 1 bottom) this share of its inertia, as without its mass. Right on a stand that does not move
    /// only, where a rotor's inertia is all that its torque meets.
    pub fn lighten(&mut self, index: usize, share: f64) {
        self.inertia_share[index] = share;
    }

    /// Returns where energy went, with the rotors at these angles.
    #[must_use]
    pub fn ledger(&self, rotor_angle: [f64; 2]) -> Ledger {
        Ledger {
            battery: self.battery.delivered(),
            battery_heat: self.battery.internal_loss(),
            stored: self.ledger.stored + self.stored(rotor_angle),
            ..self.ledger
        }
    }

    fn stored(&self, rotor_angle: [f64; 2]) -> f64 {
        let of_motor = |(chain, angle): (&Chain, f64)| {
            chain.motor.magnetic_energy() + chain.motor.cogging_energy(angle)
        };
        self.battery.capacitor_energy()
            + self.chains.iter().zip(rotor_angle).map(of_motor).sum::<f64>()
    }
}

impl Chain {
    fn built(
        parameters: &ElectronicsParameters,
        motor: MotorParameters,
        inverted: bool,
        random: &mut Xoshiro256PlusPlus,
    ) -> Self {
        let electrical_offset = core::f64::consts::TAU * random.random::<f64>();
        let swapped = random.random::<f64>() < 0.5;
        Self {
            decay: Decay::new(&motor, SUB_STEP),
            motor: Motor::new(motor, electrical_offset, swapped),
            encoder: Encoder::mounted(parameters.encoder, random),
            current_sensor: parameters
                .hardware
                .current_sense
                .map(|sense| CurrentSensor::built(sense, parameters.amplifier, inverted, random)),
            legs: [Leg::Good; 3],
            bridge: Bridge::Off,
            before: Bridge::Off,
        }
    }

    /// Ripple of the phases at a share of the PWM period, A.
    fn ripple(&self, bus: f64, sampling: &Sampling, phase: f64) -> [f64; 3] {
        let Bridge::Duty(duties) = self.bridge else { return [0.0; 3] };
        let swing = bus * sampling.period() / self.motor.parameters().inductance;
        ripple(swing, duties.map(|duty| duty.share()), phase)
    }

    /// One sub-step: mean torque, and charge drawn from the bus.
    fn run(
        &mut self,
        inverter: &InverterParameters,
        bus: f64,
        sweep: &motor::Sweep,
        ledger: &mut Ledger,
    ) -> (f64, f64) {
        let drive = inverter.drive(self.bridge, self.legs, bus, &self.motor, sweep);
        let step = self.motor.advance(drive.terminals, sweep, &self.decay);
        if drive.by_diodes {
            block_reversed(&mut self.motor, &drive);
        }
        let mut from_bus = 0.0;
        for phase in 0..3 {
            let charge = step.charge[phase];
            let taken = drive.from_bus[phase] * charge;
            from_bus += taken;
            ledger.diodes += taken * bus - drive.terminals[phase].unwrap_or(0.0) * charge;
        }
        ledger.copper += step.copper;
        (step.torque, from_bus)
    }
}

/// Two motors that differ by `motor_difference` in resistance, flux linkage and friction, each either way.
fn different_motors(
    parameters: &ElectronicsParameters,
    random: &mut Xoshiro256PlusPlus,
) -> [MotorParameters; 2] {
    let half = 0.5 * parameters.motor_difference;
    let mut side = || if random.random::<f64>() < 0.5 { half } else { -half };
    let (resistance, flux, friction) = (side(), side(), side());
    [1.0, -1.0].map(|sign| {
        let mut motor = parameters.motor;
        motor.resistance *= 1.0 + sign * resistance;
        motor.flux_linkage *= 1.0 + sign * flux;
        motor.viscous_friction *= 1.0 + sign * friction;
        motor.coulomb_friction *= 1.0 + sign * friction;
        motor
    })
}
