//! The simulated robot: the robot's own software and its plant in lock step, in virtual time.
//!
//! In each tick the software is given what the sensors show, and the plant then moves for 100 us under
//! what it decided. Nothing in the software knows that it is simulated. Things that go wrong
//! ([`Disturbance`]) act on what passes between the two, or on the plant.

use core::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

use flix_firmware::blackbox::{self, Kept};
use flix_firmware::fast::exchange::Report;
use flix_firmware::hardware::{Actuation, Sensors, SettingsStore, TICK_US};
use flix_firmware::robot::Robot;
use flix_firmware::settings::Settings;
use flix_protocol::frame::Frame;
use flix_protocol::message::{LinkQuality, OperatorName, ResetReason};
use flix_protocol::session::{Key, Operator, Operators};
use flix_protocol::shaker;
use flix_protocol::units::Instant;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::model::{Electrical, ModelError, SIMULATED_BOARD};
use crate::plant::electronics::{Electronics, ElectronicsParameters};
use crate::plant::{Diverged, Mechanics, Plant};

/// What a simulated robot is, besides its mechanics.
#[derive(Clone)]
pub struct RobotParameters {
    /// Electrical part; its board is what the software is built for.
    pub electronics: ElectronicsParameters,
    /// What the robot calls itself.
    pub name: &'static str,
    /// Who may command it.
    pub operators: Operators,
    /// What its flash holds at power-up.
    pub flash: Flash,
    /// All chance of the plant comes from here.
    pub seed: u64,
    /// What the robot's own random source starts from; from the seed in virtual time, from the operating system on a
    /// real network.
    pub entropy: [u8; 32],
}

impl RobotParameters {
    /// Creates a robot on the simulated board, what its motors are like entered.
    #[must_use]
    pub fn new(operators: impl Into<Operators>, seed: u64) -> Self {
        let mut entropy = [0; 32];
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        // Another stream than the plant's.
        random.jump();
        random.fill_bytes(&mut entropy);
        Self {
            entropy,
            electronics: ElectronicsParameters::on(SIMULATED_BOARD),
            name: "simulated",
            operators: operators.into(),
            flash: Flash::with(&Settings::DEFAULT.entered()),
            seed,
        }
    }

    /// Returns the first operator's key.
    #[must_use]
    pub fn key(&self) -> Option<Key> {
        self.operators.iter().next().map(Operator::key)
    }

    /// Creates the robot of a model file: its electrical part, and its settings where the file names any.
    ///
    /// # Errors
    /// When a setting of the model is refused.
    pub fn of(
        electrical: &Electrical,
        operators: impl Into<Operators>,
        seed: u64,
    ) -> Result<Self, ModelError> {
        let mut parameters = Self::new(operators, seed);
        parameters.electronics = electrical.into();
        if let Some(settings) = electrical.stored_settings()? {
            parameters.flash = Flash::with(&settings);
        }
        Ok(parameters)
    }
}

/// The robot's settings memory; clones share one content, which so survives a reboot.
#[derive(Debug, Clone, Default)]
pub struct Flash(Arc<Mutex<Option<Vec<u8>>>>);

/// What is stored does not fit the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the flash holds {stored} bytes, the buffer takes {room}")]
pub struct FlashError {
    stored: usize,
    room: usize,
}

impl Flash {
    /// Creates one that holds these settings.
    #[must_use]
    pub fn with(settings: &Settings) -> Self {
        let mut flash = Self::default();
        // This memory never fails.
        let _ = settings.save(&mut flash);
        flash
    }

    /// Overwrites the content, as wear or a power failure would.
    pub fn overwrite(&self, bytes: Option<Vec<u8>>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = bytes;
    }

    /// Returns what it holds.
    #[must_use]
    pub fn content(&self) -> Option<Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl SettingsStore for Flash {
    type Error = FlashError;

    fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, FlashError> {
        let Some(bytes) = self.content() else { return Ok(None) };
        let too_long = FlashError { stored: bytes.len(), room: buffer.len() };
        buffer.get_mut(..bytes.len()).ok_or(too_long)?.copy_from_slice(&bytes);
        Ok(Some(bytes.len()))
    }

    fn save(&mut self, bytes: &[u8]) -> Result<(), FlashError> {
        self.overwrite(Some(bytes.to_vec()));
        Ok(())
    }
}

/// Whether the robot's processor does its work in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Processor {
    /// It does.
    Runs,
    /// Its slow half hangs: the fast loop goes on, but no datagram is taken and none is sent.
    IsDeaf,
    /// It hangs: the bridges keep their last duties.
    Hangs,
    /// It is in its boot loader: the bridges are off. When it runs again the software starts anew, and finds in its black
    /// box what the run before left.
    Restarts,
}

/// Something that goes wrong with the hardware. Each method is asked once a tick, in this order.
pub trait Disturbance {
    /// Returns whether the processor works.
    fn processor(&mut self, _now: Instant) -> Processor {
        Processor::Runs
    }
    /// Changes what the sensors show.
    fn sensors(&mut self, _now: Instant, _sensors: &mut Sensors) {}
    /// Changes what the bridges are to do.
    fn actuation(&mut self, _now: Instant, _actuation: &mut Actuation) {}
    /// Changes motors and battery.
    fn electronics(&mut self, _now: Instant, _electronics: &mut Electronics) {}
    /// Undoes what it did to motors and battery.
    fn mend(&mut self, _electronics: &mut Electronics) {}
}

/// How the plant truly is: what no sensor shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// When.
    pub time: Instant,
    /// Shaking phase, rad, clockwise positive; counts on over full turns.
    pub phase: f64,
    /// Shaking direction theta, rad, positive to the right; not wrapped.
    pub direction: f64,
    /// Angles of top and bottom rotor about body +z, rad, not wrapped.
    pub rotor_angle: [f64; 2],
    /// Speeds of top and bottom rotor about body +z, rad/s.
    pub rotor_speed: [f64; 2],
    /// Currents of phases A, B, C of top and bottom motor, A.
    pub phase_currents: [[f64; 3]; 2],
    /// Currents (d, q) of top and bottom motor in their rotors' frames, q about body +z, A.
    pub rotor_frame_currents: [[f64; 2]; 2],
    /// Bus voltage, V.
    pub bus_voltage: f64,
    /// Force of the rotors on the body, body frame FLU, N.
    pub shaker_force: [f64; 3],
}

impl Truth {
    /// Reads the plant at a time.
    #[must_use]
    pub fn of(time: Instant, mechanics: &impl Mechanics, electronics: &Electronics) -> Self {
        let rotor_angle = mechanics.rotor_angle();
        let (phase, direction) = shaker::phase_and_direction(rotor_angle);
        Self {
            time,
            phase,
            direction,
            rotor_angle,
            rotor_speed: mechanics.rotor_speed(),
            phase_currents: electronics.phase_currents(),
            rotor_frame_currents: electronics.rotor_frame_currents(rotor_angle),
            bus_voltage: electronics.battery().bus_voltage(),
            shaker_force: mechanics.shaker_force(),
        }
    }

    /// Returns the momentary shaking frequency, Hz.
    #[must_use]
    pub fn frequency(&self) -> f64 {
        let [top, bottom] = self.rotor_speed;
        -(top - bottom) / 2.0 / core::f64::consts::TAU
    }

    /// Returns whether both rotors turn slower than this, Hz.
    #[must_use]
    pub fn is_slower_than(&self, hertz: f64) -> bool {
        self.rotor_speed.iter().all(|speed| speed.abs() < hertz * core::f64::consts::TAU)
    }

    /// Returns the largest phase current of both motors, A.
    #[must_use]
    pub fn largest_current(&self) -> f64 {
        self.phase_currents
            .iter()
            .flatten()
            .fold(0.0, |largest, current| current.abs().max(largest))
    }
}

/// The robot's own software on a simulated plant.
pub struct SimulatedRobot {
    parameters: RobotParameters,
    software: Robot<Flash>,
    mechanics: Plant,
    electronics: Electronics,
    disturbances: Vec<Box<dyn Disturbance + Send>>,
    actuation: Actuation,
    ticks: u64,
    started: u64,
    processor: Processor,
    /// Memory that survives a restart.
    black_box: [u8; blackbox::BYTES],
    /// Why it restarts, or did last.
    reset: ResetReason,
    entropy: Xoshiro256PlusPlus,
}

impl SimulatedRobot {
    /// Creates the robot at power-up, on these mechanics.
    #[must_use]
    pub fn new(parameters: RobotParameters, mechanics: Plant) -> Self {
        let mut entropy = Xoshiro256PlusPlus::from_seed(parameters.entropy);
        Self {
            software: power_up(&parameters, &mut entropy),
            electronics: Electronics::new(&parameters.electronics, parameters.seed),
            mechanics,
            disturbances: Vec::new(),
            actuation: Actuation::OFF,
            ticks: 0,
            started: 0,
            processor: Processor::Runs,
            black_box: [0; blackbox::BYTES],
            reset: ResetReason::PowerOn,
            parameters,
            entropy,
        }
    }

    /// Adds something that goes wrong from now on.
    pub fn disturb(&mut self, disturbance: impl Disturbance + Send + 'static) {
        self.disturbances.push(Box::new(disturbance));
    }

    /// Mends all that went wrong; nothing more does.
    pub fn mend(&mut self) {
        for mut disturbance in self.disturbances.drain(..) {
            disturbance.mend(&mut self.electronics);
        }
    }

    /// Returns whether the processor did its work in the last tick.
    #[must_use]
    pub fn processor(&self) -> Processor {
        self.processor
    }

    /// Returns the time since the simulation began.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::from_micros(self.ticks * u64::from(TICK_US))
    }

    /// Time as the robot's software counts it, from its last start.
    fn software_time(&self) -> Instant {
        Instant::from_micros((self.ticks - self.started) * u64::from(TICK_US))
    }

    /// Advances software and plant by one tick.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn tick(&mut self) -> Result<(), Diverged> {
        let now = self.now();
        for disturbance in &mut self.disturbances {
            disturbance.electronics(now, &mut self.electronics);
        }
        let mut sensors = self.electronics.sense(&self.mechanics);
        let mut processor = Processor::Runs;
        for disturbance in &mut self.disturbances {
            processor = processor.max(disturbance.processor(now));
            disturbance.sensors(now, &mut sensors);
        }
        self.run_software(processor, &sensors);
        let mut actuation = self.actuation;
        for disturbance in &mut self.disturbances {
            disturbance.actuation(now, &mut actuation);
        }
        self.electronics.advance(&actuation, &mut self.mechanics)?;
        self.ticks += 1;
        Ok(())
    }

    fn run_software(&mut self, processor: Processor, sensors: &Sensors) {
        let before = core::mem::replace(&mut self.processor, processor);
        match processor {
            Processor::Runs | Processor::IsDeaf => {
                if before == Processor::Restarts {
                    self.restart();
                }
                self.actuation = self.software.tick(self.software_time(), sensors);
                if let Some(bytes) = self.software.slow.link.keep() {
                    self.black_box[blackbox::RUN].copy_from_slice(&bytes);
                }
            }
            Processor::Hangs => {}
            Processor::Restarts => {
                self.actuation = Actuation::OFF;
                self.reset = match before {
                    Processor::Runs => ResetReason::Other,
                    Processor::IsDeaf => ResetReason::Tasks,
                    Processor::Hangs => ResetReason::FastLoop,
                    Processor::Restarts => return,
                };
            }
        }
    }

    /// Starts the software anew, with what it finds in its black box.
    fn restart(&mut self) {
        self.started = self.ticks;
        self.software = power_up(&self.parameters, &mut self.entropy);
        let kept = Kept::decode(&self.black_box);
        self.software.slow.link.set_crash(kept.report(self.reset.clone()));
        self.software.slow.link.set_reset(self.reset.clone());
    }

    /// Hands a datagram to the robot's network interface, and returns whether its operator sent it just now.
    pub fn receive(&mut self, from: SocketAddr, datagram: &[u8]) -> bool {
        self.processor == Processor::Runs
            && self.software.slow.receive(self.software_time(), from, datagram)
    }

    /// Returns the next datagram that the robot sends now, and to whom.
    pub fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr> {
        let now = self.software_time();
        let is_silent = self.processor != Processor::Runs;
        if is_silent || self.software.slow.poll_at(now).is_none_or(|at| at > now) {
            return None;
        }
        self.software.slow.transmit(now, frame)
    }

    /// Returns who holds the session with the robot.
    #[must_use]
    pub fn operator(&self) -> Option<SocketAddr> {
        self.software.slow.link.operator(self.software_time())
    }

    /// Returns the name of the operator who holds the session.
    #[must_use]
    pub fn driver(&self) -> Option<OperatorName> {
        self.software.slow.link.driver(self.software_time())
    }

    /// Returns how well the robot hears, and what it dropped.
    #[must_use]
    pub fn link_quality(&self) -> LinkQuality {
        self.software.slow.link.quality(self.software_time())
    }

    /// Gives the live robot other operators, as over its cable.
    pub fn change_operators(&mut self, operators: impl Into<Operators>) {
        self.parameters.operators = operators.into();
        self.software.slow.provision(self.parameters.name, self.parameters.operators.clone());
    }

    /// Returns what the software believes.
    #[must_use]
    pub fn report(&self) -> Report {
        self.software.report()
    }

    /// Returns the robot's own software.
    #[must_use]
    pub fn software(&self) -> &Robot<Flash> {
        &self.software
    }

    /// Returns what it was built from.
    #[must_use]
    pub fn parameters(&self) -> &RobotParameters {
        &self.parameters
    }

    /// Returns the mechanics.
    #[must_use]
    pub fn mechanics(&self) -> &Plant {
        &self.mechanics
    }

    /// Returns the mechanics, to push.
    pub fn mechanics_mut(&mut self) -> &mut Plant {
        &mut self.mechanics
    }

    /// Returns the motors, bridges and battery.
    #[must_use]
    pub fn electronics(&self) -> &Electronics {
        &self.electronics
    }

    /// Swaps the battery for one with this share of its charge, 0 to 1.
    pub(crate) fn swap_battery(&mut self, charge: f64) {
        self.electronics.battery_mut().recharge(charge);
    }

    /// Returns what the bridges were last to do.
    #[must_use]
    pub fn actuation(&self) -> Actuation {
        self.actuation
    }

    /// Returns how the plant truly is.
    #[must_use]
    pub fn truth(&self) -> Truth {
        Truth::of(self.now(), &self.mechanics, &self.electronics)
    }
}

fn power_up(parameters: &RobotParameters, entropy: &mut Xoshiro256PlusPlus) -> Robot<Flash> {
    let mut fresh = [0; 32];
    entropy.fill_bytes(&mut fresh);
    Robot::new(
        parameters.electronics.hardware,
        parameters.name,
        parameters.operators.clone(),
        fresh,
        parameters.flash.clone(),
    )
}
