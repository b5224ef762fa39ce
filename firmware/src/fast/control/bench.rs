//! A small double-precision shaker for the tests of the fast half: two motors, two eccentric
//! rotors, a base that is fixed or slides in the plane, sensors with noise. The real plant lives
//! in the simulator; this one is here so that the controller's promises are tested where it lives.

use core::num::NonZeroU16;
use std::f64::consts::TAU;

use crate::fast::configuration::Configuration;
use crate::fast::control::Control;
use crate::fast::exchange::{Asked, Wanted};
use crate::hardware::{
    Actuation, Bridge, CurrentSense, Encoder, EncoderAngle, EncoderReading, Hardware, Sensors,
};
use crate::settings::Settings;
use flix_protocol::failsafe::COMMAND_AGE;
use flix_protocol::message::{Setpoint, State};
use flix_protocol::units::{Degrees, Hertz, Instant};

pub(crate) const HARDWARE: Hardware = Hardware {
    name: "bench",
    current_sense: Some(CurrentSense {
        microamperes_per_count: 1611,
        zero_count: 2048,
        valid_counts: (8, 4087),
    }),
    bus_microvolts_per_count: NonZeroU16::new(4_000),
    bus_largest_count: 4_095,
    dead_time_ns: 500,
    pwm_frequency_hz: 25_000,
    actuation_delay_us: Hardware::actuation_delay(25_000),
    can_coast: true,
};

const SUB_STEPS: u32 = 10;
const MASS_ARM: f64 = 0.012 * 0.028;

pub(crate) struct Motor {
    pub(crate) resistance: f64,
    pub(crate) inductance: f64,
    pub(crate) flux: f64,
    pub(crate) inertia: f64,
    pub(crate) coulomb: f64,
    pub(crate) viscous: f64,
    pub(crate) cogging: f64,
    /// Rad, electrical.
    pub(crate) offset: f64,
    pub(crate) reversed: bool,
    /// Phase A's wire is broken.
    pub(crate) open: bool,
    /// Amplitude and phase of the first and second harmonic, rad.
    pub(crate) eccentricity: [(f64, f64); 2],
    pub(crate) encoder_alive: bool,
    pub(crate) encoder_stuck: Option<EncoderAngle>,
    pub(crate) blocked: bool,
    /// Clockwise, rad, rad/s.
    pub(crate) angle: f64,
    pub(crate) speed: f64,
    pub(crate) current: [f64; 2],
}

impl Motor {
    fn new(scale: f64) -> Self {
        Self {
            resistance: 2.5 * scale,
            inductance: 1e-3,
            flux: 3e-3 * scale,
            inertia: 1.05e-5,
            coulomb: 1e-3 * scale,
            viscous: 4e-6 * scale,
            cogging: 0.8e-3,
            offset: 1.0,
            reversed: false,
            open: false,
            eccentricity: [(0.012, 0.7), (0.004, 2.0)],
            encoder_alive: true,
            encoder_stuck: None,
            blocked: false,
            angle: 0.6,
            speed: 0.0,
            current: [0.0; 2],
        }
    }

    fn electrical(&self) -> f64 {
        let sign = if self.reversed { -7.0 } else { 7.0 };
        sign * self.angle + self.offset
    }

    /// Returns phase currents A, B, C.
    pub(crate) fn phases(&self) -> [f64; 3] {
        phases_of(self.current)
    }

    /// Returns the back-EMF, alpha and beta.
    fn back_emf(&self) -> [f64; 2] {
        let sign = if self.reversed { -1.0 } else { 1.0 };
        let omega = sign * 7.0 * self.speed;
        let (sine, cosine) = self.electrical().sin_cos();
        [-omega * self.flux * sine, omega * self.flux * cosine]
    }

    /// Returns the torque on the rotor, clockwise.
    fn electric(&mut self, bridge: Bridge, bus: f64, dt: f64) -> f64 {
        let electrical = self.electrical();
        let sign = if self.reversed { -1.0 } else { 1.0 };
        let (sine, cosine) = electrical.sin_cos();
        let emf = self.back_emf();
        match bridge {
            Bridge::Off => {
                let decay = (1.0 - dt / 0.5e-4).max(0.0);
                self.current = self.current.map(|current| current * decay);
            }
            Bridge::Duty(duties) => {
                let currents = self.phases();
                let mut phase = [0.0; 3];
                for index in 0..3 {
                    let dead = 0.0125 * (currents[index] / 0.01).clamp(-1.0, 1.0);
                    phase[index] = bus * (f64::from(duties[index].raw()) / 65_536.0 - dead);
                }
                let [a, b, c] = phase;
                let voltage = [(2.0 * a - b - c) / 3.0, (b - c) / 3_f64.sqrt()];
                for axis in 0..2 {
                    let drop = voltage[axis] - emf[axis] - self.resistance * self.current[axis];
                    self.current[axis] += drop / self.inductance * dt;
                }
                if self.open {
                    self.current[0] = 0.0;
                }
            }
        }
        let i_q = -self.current[0] * sine + self.current[1] * cosine;
        1.5 * 7.0 * self.flux * i_q * sign
    }
}

/// Returns phases A, B, C of alpha and beta.
fn phases_of([alpha, beta]: [f64; 2]) -> [f64; 3] {
    let half = beta * 3_f64.sqrt() / 2.0;
    [alpha, half - alpha / 2.0, -half - alpha / 2.0]
}

pub(crate) struct Bench {
    pub(crate) control: Control,
    pub(crate) asked: Asked,
    pub(crate) motors: [Motor; 2],
    /// Total mass of a sliding base; `None` is fixed.
    pub(crate) base_mass: Option<f64>,
    pub(crate) bus: f64,
    pub(crate) now_us: u64,
    pub(crate) peak_current: f64,
    pub(crate) encoder_age_us: u16,
    pub(crate) encoder_every: u64,
    pub(crate) keep_alive: bool,
    /// Each motor's encoder watches the other rotor.
    pub(crate) encoders_swapped: bool,
    /// Counts added to what both motors' phase A shows.
    pub(crate) sense_offset: i16,
    /// How long before the middle of a PWM period one phase is converted, and the other as long after it, in turn; s.
    pub(crate) aside: f64,
    /// What the amplifiers show instead, all four.
    pub(crate) sense_dead: Option<i16>,
    pub(crate) last: Actuation,
    base_damping: f64,
    base: [f64; 2],
    accelerations: [f64; 2],
    history: [[f64; 2]; 64],
    seed: u64,
}

impl Bench {
    pub(crate) fn new(base_mass: Option<f64>) -> Self {
        Self::with(base_mass, Settings::DEFAULT, HARDWARE)
    }

    pub(crate) fn with(base_mass: Option<f64>, settings: Settings, hardware: Hardware) -> Self {
        let mut bottom = Motor::new(0.95);
        bottom.angle = 2.9;
        bottom.offset = -2.0;
        Self {
            control: Control::new(Configuration::new(&settings, &hardware)),
            asked: Asked::default(),
            motors: [Motor::new(1.05), bottom],
            base_mass,
            bus: 12.0,
            now_us: 0,
            peak_current: 0.0,
            encoder_age_us: 40,
            encoder_every: 1,
            keep_alive: true,
            encoders_swapped: false,
            sense_offset: 0,
            aside: 0.0,
            sense_dead: None,
            last: Actuation::OFF,
            base_damping: 2.0,
            base: [0.0; 2],
            accelerations: [0.0; 2],
            history: [[0.0; 2]; 64],
            seed: 1,
        }
    }

    fn uniform(&mut self) -> f64 {
        self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((self.seed >> 33) as f64 / f64::from(1_u32 << 31)) * 2.0 - 1.0
    }

    fn noise(&mut self, deviation: f64) -> f64 {
        (self.uniform() + self.uniform() + self.uniform()) * deviation
    }

    fn sensors(&mut self) -> Sensors {
        let mut encoders = [Encoder::Pending; 2];
        let mut counts = [[0; 2]; 2];
        let fresh = (self.now_us / 100).is_multiple_of(self.encoder_every);
        for index in 0..2 {
            let back = usize::from(self.encoder_age_us / 10) % 64;
            let angle = self.history[(63 - back) % 64][index];
            let mut wrong = 0.0;
            for (harmonic, (amplitude, phase)) in self.motors[index].eccentricity.iter().enumerate()
            {
                wrong += amplitude * ((harmonic + 1) as f64 * angle + phase).sin();
            }
            let reading = -(angle + wrong) + self.noise(0.001);
            let turn = (reading / TAU).rem_euclid(1.0);
            let angle = EncoderAngle::from_count((turn * 4096.0) as u32, 12);
            if !self.motors[index].encoder_alive {
                encoders[index] = Encoder::Failed;
            } else if let Some(stuck) = self.motors[index].encoder_stuck {
                encoders[index] = Encoder::Reading(EncoderReading { angle: stuck, age_us: 0 });
            } else if fresh {
                encoders[index] =
                    Encoder::Reading(EncoderReading { angle, age_us: self.encoder_age_us });
            }
            let phases = self.motors[index].phases();
            let back_emf = phases_of(self.motors[index].back_emf());
            let in_turn = if (self.now_us / 100).is_multiple_of(2) { 1.0 } else { -1.0 };
            for (phase, side) in [in_turn, -in_turn].into_iter().enumerate() {
                // In the middle all phases are low.
                let falls = back_emf[phase] / self.motors[index].inductance;
                let shown = phases[phase] + side * self.aside * falls + self.noise(0.005);
                counts[index][phase] = (2060.0 + shown / 1.611e-3).round() as i16;
            }
            counts[index][0] += self.sense_offset;
            if let Some(dead) = self.sense_dead {
                counts[index] = [dead; 2];
            }
        }
        if self.encoders_swapped {
            encoders.swap(0, 1);
        }
        Sensors {
            magnets: Default::default(),
            encoders,
            phase_current: Some(counts),
            bus_voltage: Some(((self.bus / 4e-3) as u16).min(HARDWARE.bus_largest_count)),
        }
    }

    /// Does one tick.
    pub(crate) fn tick(&mut self) {
        self.tick_with(Control::tick);
    }

    /// Does one tick through something that calls [`Control::tick`].
    pub(crate) fn tick_with(
        &mut self,
        tick: impl Fn(&mut Control, Instant, &Sensors, &Asked) -> Actuation,
    ) {
        let sensors = self.sensors();
        let now = Instant::from_micros(self.now_us);
        if self.keep_alive {
            self.asked.hear(now, now + COMMAND_AGE);
        }
        self.last = tick(&mut self.control, now, &sensors, &self.asked);
        let dt = 1e-4 / f64::from(SUB_STEPS);
        for _ in 0..SUB_STEPS {
            self.step(dt);
        }
        self.now_us += 100;
    }

    fn step(&mut self, dt: f64) {
        let mut push = [0.0; 2];
        for (motor, acceleration) in self.motors.iter().zip(self.accelerations) {
            let (sine, cosine) = motor.angle.sin_cos();
            push[0] += MASS_ARM * (motor.speed.powi(2) * cosine + acceleration * sine);
            push[1] += MASS_ARM * (motor.speed.powi(2) * sine - acceleration * cosine);
        }
        let mut base_acceleration = [0.0; 2];
        if let Some(mass) = self.base_mass {
            for axis in 0..2 {
                base_acceleration[axis] = (push[axis] - self.base_damping * self.base[axis]) / mass;
                self.base[axis] += base_acceleration[axis] * dt;
            }
        }
        for index in 0..2 {
            let motor = &mut self.motors[index];
            let torque = motor.electric(self.last.bridges[index], self.bus, dt);
            let (sine, cosine) = motor.angle.sin_cos();
            let driven = MASS_ARM * (-base_acceleration[0] * -sine - base_acceleration[1] * cosine);
            let cogging = motor.cogging * (84.0 * motor.angle).sin();
            let mut net = torque + driven - cogging - motor.viscous * motor.speed;
            let friction = motor.coulomb * (motor.speed / 0.05).clamp(-1.0, 1.0);
            net -= friction;
            self.accelerations[index] = net / motor.inertia;
            motor.speed += self.accelerations[index] * dt;
            if motor.blocked {
                motor.speed = 0.0;
            }
            motor.angle += motor.speed * dt;
            for phase in motor.phases() {
                self.peak_current = self.peak_current.max(phase.abs());
            }
        }
        self.history.rotate_left(1);
        self.history[63] = [self.motors[0].angle, self.motors[1].angle];
    }

    pub(crate) fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds * 1e4) as u32 {
            self.tick();
        }
    }

    pub(crate) fn state(&self) -> State {
        self.control.report().state
    }

    /// Runs until this state; panics after some seconds.
    pub(crate) fn until(&mut self, state: State) {
        let arrived = (0..60_000).any(|_| {
            self.tick();
            self.state() == state
        });
        let report = self.control.report();
        assert!(arrived, "stays {}, faults: {}", report.state, report.faults);
    }

    pub(crate) fn arm(&mut self) {
        self.run(0.05);
        self.want(Wanted::Arm);
        self.until(State::Armed);
    }

    /// Gives an order with the present permit, over a link that is steady.
    pub(crate) fn want(&mut self, wanted: Wanted) {
        self.asked.begins = true;
        self.asked.want(wanted, self.control.report().permit);
    }

    pub(crate) fn command(&mut self, frequency: f32, direction: f32) {
        let setpoint =
            Setpoint::new(Hertz::new(frequency).unwrap(), Degrees::new(direction).unwrap());
        self.asked.set(&setpoint.unwrap());
        self.want(Wanted::Shake);
        let now = Instant::from_micros(self.now_us);
        self.asked.hear(now, now + COMMAND_AGE);
    }

    /// Returns true theta minus this, degrees within a quarter turn.
    pub(crate) fn direction_error(&self, direction: f64) -> f64 {
        let theta = (self.motors[0].angle + self.motors[1].angle) / 2.0;
        let half_turns = (theta.to_degrees() - direction) / 180.0;
        (half_turns - half_turns.round()) * 180.0
    }

    pub(crate) fn frequency(&self) -> f64 {
        (self.motors[0].speed - self.motors[1].speed) / 2.0 / TAU
    }

    pub(crate) fn fastest(&self) -> f64 {
        self.motors.iter().fold(0.0_f64, |most, motor| most.max(motor.speed.abs())) / TAU
    }
}

/// What holding a pair came to.
#[derive(Debug)]
pub(crate) struct Held {
    /// RMS of f averaged over turns minus the command, Hz.
    pub(crate) frequency: f64,
    /// RMS of theta minus the command, degrees.
    pub(crate) direction: f64,
}

impl Bench {
    /// Holds a pair for so long and looks.
    pub(crate) fn hold(&mut self, frequency: f64, direction: f64, seconds: f64) -> Held {
        let ticks = (seconds * 1e4) as u32;
        let per_turn = (1e4 / frequency.abs()) as u32;
        let (mut squares, mut frequency_squares, mut turns) = (0.0, 0.0, 0);
        let phase = |bench: &Self| (bench.motors[0].angle - bench.motors[1].angle) / 2.0;
        let mut begin = phase(self);
        for tick in 1..=ticks {
            self.tick();
            let error = self.direction_error(direction);
            squares += error * error;
            if tick % per_turn == 0 {
                let end = phase(self);
                let mean = (end - begin) / TAU / f64::from(per_turn) * 1e4;
                frequency_squares += (mean - frequency).powi(2);
                begin = end;
                turns += 1;
            }
        }
        Held {
            frequency: (frequency_squares / f64::from(turns)).sqrt(),
            direction: (squares / f64::from(ticks)).sqrt(),
        }
    }
}
