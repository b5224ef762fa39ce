//! The chip, the simulated robot at its pins and an operator, all in one virtual time.

use std::time::Duration;

use flix_firmware::board::{EncoderKind, PWM_FREQUENCY_HZ};
use flix_host::link::{Client, LinkError, RobotLink};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::message::{OperatorName, Refusal};
use flix_protocol::provision::{
    Answer, FixedAddress, FrameReader, Provisioning, Request, write_frame,
};
use flix_protocol::session::{Key, Operator};
use flix_protocol::units::Instant;
use flix_sim::plant::Diverged;
use flix_sim::rig::simulated::Truth;

use crate::flood::Flood;
use crate::pins::{Robot, STEP_CYCLES};
use flix_esp32c6::CYCLES_PER_SECOND;
use flix_esp32c6::RadioTimes as Times;
use flix_esp32c6::chip::{Chip, ResetReason, Stop};
use flix_esp32c6::cycles;
use flix_esp32c6::flash::Flash;
use flix_esp32c6::image::{Image, programmed_flash};
use flix_esp32c6::network::{AccessPoint, Datagram, NAME, PASSPHRASE};

/// How long is waited for what the serial port or telemetry shows: an answer, a restart.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// The operator's port.
const OPERATOR_PORT: u16 = 40_000;
/// When the plant's step begins after the fast loop's tick: its duties are at the pins by then.
const STEP_AFTER_TICK: u64 = STEP_CYCLES * 8 / 10;
/// An unanswered request over the serial port is repeated after this time.
const SERIAL_RETRY: Duration = Duration::from_secs(1);
/// Registers of a block without a clock that esp-hal 1.2 touches when it starts.
const KNOWN_FINDINGS: [&str; 2] = ["TIMG1.wdtconfig0", "TIMG1.wdtwprotect"];
/// Restarts that are normal in one wait.
const RESTARTS: usize = 8;

/// The rig did not do what was asked of it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// The image or the emulator is at its end; the sentence says where.
    #[error("{0}")]
    Fault(String),
    /// Power went in a flash operation.
    #[error("power was lost")]
    PowerLost,
    /// The mechanics' state is useless.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The robot does not do what it is asked.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// It took too long.
    #[error("no {awaited} within {} s", PATIENCE.as_secs())]
    TooLate {
        /// What was waited for.
        awaited: &'static str,
    },
    /// It starts again and again.
    #[error("the chip starts anew again and again, last because of {0:?}")]
    Restarts(ResetReason),
}

/// What was seen of the pins and the loop since [`Rig::forget_seen`].
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Steps of the plant.
    pub steps: u64,
    /// Lowest and highest frequency of the six PWM pins, Hz.
    pub pwm_hz: [f64; 2],
    /// Least and most time from the beginning of a PWM period to a tick, at most half a period before or after, microseconds.
    pub tick_phase_us: [f64; 2],
    /// Least and most time from a tick to the last duty that it set, microseconds.
    pub duties_after_us: [f64; 2],
    /// Sum, lowest and highest share of each pin: top A B C, bottom A B C.
    pub shares: [[f64; 3]; 6],
    /// Steps that found a bridge enabled before its duties were set.
    pub early_enables: u64,
    /// Ticks that the fast loop missed while a motor was driven.
    pub missed: u64,
    /// Longest time between two rounds of the fast loop meanwhile, microseconds.
    pub longest_gap_us: f64,
    /// Longest wait of its interrupt meanwhile, cycles, and the address at which the program let it in.
    pub longest_wait: (u64, u32),
}

impl Seen {
    /// Nothing yet.
    const NOTHING: Self = Self {
        steps: 0,
        pwm_hz: [f64::INFINITY, 0.0],
        tick_phase_us: [f64::INFINITY, f64::NEG_INFINITY],
        duties_after_us: [f64::INFINITY, 0.0],
        shares: [[0.0, f64::INFINITY, 0.0]; 6],
        early_enables: 0,
        missed: 0,
        longest_gap_us: 0.0,
        longest_wait: (0, 0),
    };
}

/// An emulated chip, the plant at its pins, its network and an operator.
pub struct Rig {
    /// The chip.
    pub chip: Chip<Robot>,
    client: Client,
    /// Whether no operator is there.
    pub is_alone: bool,
    /// What came out of the serial port.
    pub serial: Vec<u8>,
    /// What of it nobody has taken yet.
    pub fresh_serial: Vec<u8>,
    /// Resets since power-on of the rig, and when.
    pub resets: Vec<(Duration, ResetReason)>,
    /// What was seen lately.
    pub seen: Seen,
    /// The key that the robot is provisioned with, and operators have.
    pub key: Key,
    next_step: u64,
    /// Whether a motor was driven at the last step's end.
    is_driven: bool,
    flood: Option<Flood>,
    /// Ticks of the loop's timer and rounds of the loop at which counting starts.
    ticks: u64,
    rounds: u64,
    /// Attempts to connect so far, those of them while a motor was driven, and the weakest signal while connected.
    attempts: u64,
    attempts_driven: u64,
    weakest_signal_dbm: Option<i32>,
}

/// Power of the strongest access point of the network, dBm.
fn strongest_dbm() -> i32 {
    let all = AccessPoint::all().into_iter().filter(|it| it.name == NAME.as_bytes());
    all.map(|it| it.dbm).max().unwrap_or(0)
}

impl Rig {
    /// Creates a robot with an image, powered on. `seed` is where all chance starts.
    pub fn new(image: Image, encoder: EncoderKind, seed: u64) -> Self {
        let mut rig = Self::with_flash(image, encoder, seed, programmed_flash());
        rig.chip.charge(Times::WORST);
        rig
    }

    /// Creates one as [`Rig::new`] does, with a flash that was used before and a radio that is ready at once.
    pub fn with_flash(image: Image, encoder: EncoderKind, seed: u64, flash: Flash) -> Self {
        let chip = Chip::with_flash(image, Robot::new(encoder, seed), flash, seed);
        let next_step = chip.cycles();
        let key = Key::new([7; 32]);
        Self {
            chip,
            client: Client::new(key.clone(), [0; 32], Instant::START),
            is_alone: true,
            serial: Vec::new(),
            fresh_serial: Vec::new(),
            resets: Vec::new(),
            seen: Seen::NOTHING,
            key,
            next_step,
            is_driven: false,
            flood: None,
            ticks: 0,
            rounds: 0,
            attempts: 0,
            attempts_driven: 0,
            weakest_signal_dbm: None,
        }
    }

    /// Returns the virtual time.
    pub fn now(&self) -> Instant {
        Instant::from_micros(self.chip.cycles() * 1_000_000 / CYCLES_PER_SECOND)
    }

    /// Returns how the robot truly is.
    pub fn truth(&mut self) -> Truth {
        let now = self.now();
        self.chip.outside().truth(now)
    }

    /// Returns what came out of the serial port, as text.
    pub fn log(&self) -> String {
        String::from_utf8_lossy(&self.serial).into_owned()
    }

    /// Forgets what was seen so far.
    pub fn forget_seen(&mut self) {
        self.seen = Seen::NOTHING;
        self.watch_loop_from_here();
    }

    /// Accesses to blocks without a clock, but for those that the HAL is known to make: it switches off the watchdog of
    /// timer group 1 after it has taken that group's clock away. The watchdog is off by then.
    pub fn findings(&self) -> Vec<String> {
        let is_known =
            |finding: &String| KNOWN_FINDINGS.iter().any(|known| finding.contains(known));
        let findings = self.chip.findings().into_iter().filter(|finding| !is_known(finding));
        let driven = (self.attempts_driven > 0).then(|| {
            format!("the radio connects while a motor is driven, {} times", self.attempts_driven)
        });
        let signal = self.weakest_signal_dbm.filter(|dbm| *dbm < strongest_dbm()).map(|dbm| {
            format!("the radio is on an access point with {dbm} dBm, not {}", strongest_dbm())
        });
        findings.chain(driven).chain(signal).collect()
    }

    /// Advances everything to the end of a step of the plant.
    pub fn step(&mut self) -> Result<(), RigError> {
        // A step is longer where it catches up with the loop.
        self.advance(2 * STEP_CYCLES)
    }

    /// Advances the chip by so many cycles, at most to the end of a step of the plant.
    pub fn advance(&mut self, cycles: u64) -> Result<(), RigError> {
        if self.chip.cycles() >= self.next_step {
            self.begin_step()?;
        }
        self.run_chip(self.next_step.min(self.chip.cycles() + cycles))?;
        if self.chip.cycles() >= self.next_step {
            self.end_step();
        }
        Ok(())
    }

    fn begin_step(&mut self) -> Result<(), RigError> {
        self.move_plant()?;
        self.next_step += STEP_CYCLES;
        // In step with the loop, so that its duties act when they reach the pins.
        let late = (self.next_step - self.chip.last_tick()) % STEP_CYCLES;
        if self.chip.counters().ticks > 0 && late != STEP_AFTER_TICK {
            self.next_step += (STEP_AFTER_TICK + STEP_CYCLES - late) % STEP_CYCLES;
        }
        Ok(())
    }

    fn end_step(&mut self) {
        self.watch_loop();
        let bytes = self.chip.take_serial();
        self.fresh_serial.extend(&bytes);
        self.serial.extend(bytes);
        self.exchange();
    }

    /// Lowers the supply for a moment.
    pub fn brown_out(&mut self) -> Result<(), RigError> {
        if self.chip.brown_out() {
            self.resets.push((self.chip.now(), ResetReason::BrownOut));
            self.rest_until(self.chip.cycles())?;
        }
        Ok(())
    }

    fn run_chip(&mut self, until: u64) -> Result<(), RigError> {
        match self.chip.run_until(until) {
            Ok(()) => Ok(()),
            Err(Stop::Reset(reason)) => {
                self.resets.push((self.chip.now(), reason));
                self.rest_until(self.chip.cycles())
            }
            Err(Stop::PowerLost) => Err(RigError::PowerLost),
            Err(Stop::Fault(fault)) => Err(RigError::Fault(self.chip.explain(&fault))),
        }
    }

    /// Counts what the fast loop missed in a step at whose start and end a motor was driven: its bridge enabled, and not
    /// all low. Flash is written only while both coast or brake; that stops the loop, too, and is no harm.
    fn watch_loop(&mut self) {
        let was_driven = self.is_driven;
        let mut is_high = |pin| self.chip.output(pin).is_some_and(|wave| wave.share > 0.0);
        self.is_driven = Robot::bridge_pins().into_iter().any(|(phases, enable)| {
            enable.is_some_and(&mut is_high) && phases.into_iter().any(&mut is_high)
        });
        let counters = self.chip.counters();
        if self.is_driven {
            self.attempts_driven += counters.connect_attempts - self.attempts;
        }
        self.attempts = counters.connect_attempts;
        if let Some(dbm) = counters.signal_dbm {
            self.weakest_signal_dbm = Some(self.weakest_signal_dbm.map_or(dbm, |it| it.min(dbm)));
        }
        if !(was_driven && self.is_driven) {
            self.watch_loop_from_here();
            return;
        }
        self.watch_phase();
        let [ticks, rounds] = [counters.ticks - self.ticks, counters.rounds - self.rounds];
        // One may be on its way.
        let missed = ticks.saturating_sub(rounds + 1);
        self.seen.missed += missed;
        self.ticks += missed;
        let gap = counters.longest_gap_cycles.max(counters.silence_cycles);
        let gap_us = gap as f64 * 1e6 / CYCLES_PER_SECOND as f64;
        self.seen.longest_gap_us = self.seen.longest_gap_us.max(gap_us);
        self.seen.longest_wait = self.seen.longest_wait.max(self.chip.longest_wait());
    }

    fn watch_phase(&mut self) {
        let period_us = 1e6 / f64::from(PWM_FREQUENCY_HZ);
        let phase_us = self.chip.tick_phase() * 1e6;
        let phase_us = phase_us - period_us * (phase_us / period_us).round();
        let [least, most] = &mut self.seen.tick_phase_us;
        (*least, *most) = (least.min(phase_us), most.max(phase_us));
        if let Some(after) = self.chip.last_round().checked_sub(self.chip.last_tick()) {
            let after_us = after as f64 * 1e6 / CYCLES_PER_SECOND as f64;
            let [least, most] = &mut self.seen.duties_after_us;
            (*least, *most) = (least.min(after_us), most.max(after_us));
        }
    }

    fn watch_loop_from_here(&mut self) {
        let counters = self.chip.counters();
        (self.ticks, self.rounds) = (counters.ticks, counters.rounds);
        self.chip.forget_gaps();
    }

    /// The plant goes on while the chip boots: nothing drives the pins.
    fn rest_until(&mut self, cycles: u64) -> Result<(), RigError> {
        while self.next_step < cycles {
            let nothing = ([None; 3], None);
            self.chip.outside().step(self.next_step, [nothing; 2])?;
            self.next_step += STEP_CYCLES;
        }
        Ok(())
    }

    fn move_plant(&mut self) -> Result<(), RigError> {
        let mut pin = 0;
        let chip = &mut self.chip;
        let seen = &mut self.seen;
        let pins = Robot::bridge_pins().map(|(phases, enable)| {
            let is_late = |enable| phases.iter().any(|phase| chip.is_duty_late(*phase, enable));
            seen.early_enables += u64::from(enable.is_some_and(is_late));
            let waves = phases.map(|phase| {
                let wave = chip.output(phase);
                let (hertz, share) = wave.map_or((0.0, 0.0), |wave| (wave.hertz, wave.share));
                seen.pwm_hz = [seen.pwm_hz[0].min(hertz), seen.pwm_hz[1].max(hertz)];
                let [sum, lowest, highest] = &mut seen.shares[pin];
                *sum += share;
                *lowest = lowest.min(share);
                *highest = highest.max(share);
                pin += 1;
                wave
            });
            (waves, enable.and_then(|pin| chip.output(pin)))
        });
        seen.steps += 1;
        let now = chip.cycles();
        chip.outside().step(now, pins)?;
        Ok(())
    }

    fn exchange(&mut self) {
        let (now, at) = (self.now(), self.chip.cycles());
        if let Some(flood) = &mut self.flood {
            flood.send(&mut self.chip.network, at);
        }
        if self.is_alone {
            return;
        }
        while let Some(datagram) = self.chip.network.receive_datagram(at) {
            if datagram.port == OPERATOR_PORT {
                self.client.receive(now, &datagram.payload);
            }
        }
        if self.client.transmit_at().is_some_and(|due| due <= now) {
            while let Some(frame) = self.client.transmit(now) {
                let datagram = Datagram { port: OPERATOR_PORT, payload: frame.to_vec() };
                self.chip.network.send_datagram(&datagram, DEFAULT_PORT, at);
            }
        }
    }

    /// Runs for so long.
    pub fn run(&mut self, time: Duration) -> Result<(), RigError> {
        let end = self.chip.cycles() + cycles(time);
        while self.chip.cycles() < end {
            self.step()?;
        }
        Ok(())
    }

    /// Runs until `found` finds something.
    pub fn until<T>(
        &mut self,
        what: &'static str,
        mut found: impl FnMut(&mut Self) -> Result<Option<T>, RigError>,
    ) -> Result<T, RigError> {
        let end = self.chip.cycles() + cycles(PATIENCE);
        let resets = self.resets.len();
        while self.chip.cycles() < end {
            if let Some(it) = found(self)? {
                return Ok(it);
            }
            self.step()?;
            if let Some((_, reason)) = self.resets.get(resets + RESTARTS) {
                return Err(RigError::Restarts(*reason));
            }
        }
        Err(RigError::TooLate { awaited: what })
    }

    /// Runs until the log says `text`.
    pub fn until_log(&mut self, what: &'static str, text: &str) -> Result<(), RigError> {
        let from = self.serial.len();
        let text = text.as_bytes();
        self.until(what, |rig| {
            let fresh = rig.serial.get(from.saturating_sub(text.len())..).unwrap_or(&[]);
            Ok(fresh.windows(text.len()).any(|window| window == text).then_some(()))
        })
    }

    /// Sends a request over the serial port and returns the robot's answer.
    pub fn ask_serial(&mut self, request: &Request) -> Result<Answer, RigError> {
        let frame = write_frame(request)
            .ok_or_else(|| RigError::Fault("a request fits no frame".to_owned()))?;
        let mut at = self.serial.len();
        let mut reader = FrameReader::new();
        let mut ask_at = self.chip.cycles();
        self.until("answer over the serial port", |rig| {
            // Asked again until it is heard, as `flix` does.
            if rig.chip.cycles() >= ask_at {
                rig.chip.send_serial(&frame);
                ask_at = rig.chip.cycles() + cycles(SERIAL_RETRY);
            }
            let fresh = rig.serial[at..].to_vec();
            at = rig.serial.len();
            Ok(fresh.into_iter().find_map(|byte| reader.push::<Answer>(byte)))
        })
    }

    /// Returns the address that the network gives this rig's robot.
    pub fn lease(&self) -> FixedAddress {
        FixedAddress { address: self.chip.network.lease, prefix_length: 24, gateway: None }
    }

    /// Returns what this rig's robot is given; without an address it asks DHCP for one.
    pub fn provisioning(&self, address: Option<FixedAddress>) -> Result<Provisioning, RigError> {
        let provisioning = Provisioning::new("walker", NAME, PASSPHRASE, address);
        provisioning.map_err(|error| RigError::Fault(error.to_string()))
    }

    /// Returns who may command this rig's robot.
    pub fn operator(&self) -> Operator {
        Operator::new(OperatorName::OWNER, &self.key)
    }

    /// Provisions the robot over its serial port and waits until it is on the network.
    pub fn provision(&mut self) -> Result<(), RigError> {
        self.until_log("invitation to provision", "flix provision")?;
        self.provision_anew()
    }

    /// Provisions it as [`Rig::provision`] does, where it may have been provisioned before.
    pub fn provision_anew(&mut self) -> Result<(), RigError> {
        let provisioning = self.provisioning(Some(self.lease()))?;
        self.ask_serial(&Request::Provision(provisioning, self.operator()))?;
        self.until_log("connection to the network", "wi-fi: connected")
    }

    /// Connects an operator.
    pub fn connect(&mut self) -> Result<(), RigError> {
        let now = self.now();
        let entropy = (self.chip.cycles() ^ 0x5A5A).to_le_bytes();
        let mut seed = [0x3C; 32];
        seed[..8].copy_from_slice(&entropy);
        self.client = Client::new(self.key.clone(), seed, now);
        self.is_alone = false;
        self.wait_until_connected()
    }

    /// Arms a robot that nobody has commissioned: enters what it assumes as it is.
    pub fn arm_uncommissioned(&mut self) -> Result<(), RigError> {
        loop {
            match self.arm() {
                Err(RigError::Link(LinkError::Refused(
                    Refusal::Assumed { name } | Refusal::AssumedUnmeasured { name },
                ))) => {
                    let value = self.parameter(name.clone())?.value;
                    self.set(name, value)?;
                }
                ended => return ended,
            }
        }
    }

    /// Starts or ends a flood; returns the one that was.
    pub fn flood(&mut self, flood: Option<Flood>) -> Option<Flood> {
        std::mem::replace(&mut self.flood, flood)
    }

    /// Returns whether both motors coast: no bridge is enabled.
    pub fn coasts(&mut self) -> bool {
        let enables = Robot::bridge_pins().map(|(_, enable)| enable);
        enables
            .into_iter()
            .flatten()
            .all(|pin| self.chip.output(pin).is_none_or(|wave| wave.share == 0.0))
    }

    /// Returns whether all phases' pins are low.
    pub fn is_low(&mut self) -> bool {
        let phases = Robot::bridge_pins().map(|(phases, _)| phases);
        let is_low = |pin| {
            self.chip.output(pin).is_some_and(|wave| wave.hertz.is_finite() && wave.share == 0.0)
        };
        phases.into_iter().flatten().all(is_low)
    }

    /// Returns the share of the time that the light is on now: 0 or 1.
    pub fn light(&mut self) -> f64 {
        self.chip.output(Robot::light_pin()).map_or(0.0, |wave| wave.share)
    }

    /// Returns whether a motor was driven at the last step's end.
    pub fn is_driven(&self) -> bool {
        self.is_driven
    }
}

impl RobotLink for Rig {
    type Error = RigError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        let now = self.now();
        (&mut self.client, now)
    }

    fn wait(&mut self, _: Duration) -> Result<(), RigError> {
        self.step()
    }
}
