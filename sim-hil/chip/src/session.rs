//! What a robot is used for, from its first start to disarming, and what has to hold meanwhile.

use std::time::Duration;

use flix_firmware::hardware::{Magnet, TICK_US};
use flix_firmware::link::MAGNET_SHOWN;
use flix_host::link::RobotLink;
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::{Command, Telemetry};
use flix_sim::experiment::metrics::HoldMeter;
use flix_sim::reliability::accuracy::{DIRECTION_LIMIT_DEG, FREQUENCY_LIMIT_HZ};
use flix_sim::rig::bench::setpoint;
use serde::Serialize;

use crate::pins::BOARD;
use crate::rig::{PATIENCE, Rig, RigError};
use flix_esp32c6::CYCLES_PER_SECOND;

/// The PWM's frequency, Hz.
pub const PWM_HZ: f64 = flix_firmware::board::PWM_FREQUENCY_HZ as f64;
/// No two rounds of the fast loop are further apart, microseconds.
pub const LONGEST_GAP_US: f64 = 120.0;
/// A tick lies so near behind the beginning of a PWM period, microseconds: both timers are started by neighbouring writes.
pub const TICK_PHASE_US: f64 = 0.5;
/// The outputs take duties over at the counter's peaks: each tick's have to be set between the same two, microseconds.
pub const TAKEN_OVER_US: [f64; 2] = [0.5e6 / PWM_HZ, 1.5e6 / PWM_HZ];
// So they act when the board states.
const _: () =
    assert!(TAKEN_OVER_US[1] + TICK_US as f64 / 2.0 == BOARD.hardware.actuation_delay_us as f64);
/// After disarming the rotors, braked, stand by then.
const REST: Duration = Duration::from_millis(500);
/// The light's pattern repeats after this time; of a disarmed robot's it is on for one step of sixteen.
const LIGHT_PERIOD: Duration = Duration::from_secs(2);
const LIT_DISARMED: f64 = 1.0 / 16.0;
/// A step may be cut by the ends of the look.
const LIGHT_TOLERANCE: f64 = 0.01;
/// The battery's voltage, by a divider without an error, is stated within this share.
const BATTERY_TOLERANCE: f64 = 0.01;
/// Largest mean direct current of both motors, A. At 30 Hz voltages that act a tick later than stated make 0.21 A, and so does an
/// angle that is older by a tick.
const LARGEST_DIRECT_CURRENT_A: f64 = 0.12;
/// A robot's telemetry shows what its encoders say of their magnets within this time.
const MAGNET_PATIENCE: Duration = Duration::from_millis(300);
/// The mean share of every phase's pin lies this near to a half.
const SHARE_TOLERANCE: f64 = 0.05;

/// A setpoint that was held, against the plant's truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Hold {
    /// What was asked for, Hz.
    pub f_hz: f64,
    /// What was asked for, degrees.
    pub theta_deg: f64,
    /// RMS of the error of f over each turn, Hz.
    pub f_rms_hz: f64,
    /// RMS of the error of theta, degrees.
    pub theta_rms_deg: f64,
    /// Largest phase current, A.
    pub peak_current_a: f64,
    /// Its limit, A.
    pub current_limit_a: f64,
    /// Mean direct currents of top and bottom motor, A: they make no torque, and none is asked for at constant f.
    pub direct_currents_a: [f64; 2],
}

impl Hold {
    /// Takes the figures of a setpoint in Hz and degrees.
    pub fn of(
        (f_hz, theta_deg): (f64, f64),
        meter: &HoldMeter,
        peak_current_a: f64,
        current_limit_a: f64,
    ) -> Self {
        let figures = meter.figures();
        Self {
            f_hz,
            theta_deg,
            f_rms_hz: figures.frequency_rms_hz,
            theta_rms_deg: figures.direction_rms_deg,
            peak_current_a,
            current_limit_a,
            direct_currents_a: figures.direct_currents,
        }
    }

    /// Returns what does not hold, in sentences.
    pub fn failures(&self) -> Vec<String> {
        let at = format!("at {} Hz, {} degrees", self.f_hz, self.theta_deg);
        let mut failures = Vec::new();
        if self.f_rms_hz.is_nan() || self.f_rms_hz > FREQUENCY_LIMIT_HZ {
            failures.push(format!("f is off by {:.3} Hz RMS {at}", self.f_rms_hz));
        }
        if self.theta_rms_deg.is_nan() || self.theta_rms_deg > DIRECTION_LIMIT_DEG {
            failures.push(format!("theta is off by {:.2} degrees RMS {at}", self.theta_rms_deg));
        }
        if self.peak_current_a > self.current_limit_a {
            let (peak, limit) = (self.peak_current_a, self.current_limit_a);
            failures.push(format!("{peak:.2} A of {limit:.2} A {at}"));
        }
        let direct = self.direct_currents_a.iter().sum::<f64>() / 2.0;
        if direct.is_nan() || direct.abs() > LARGEST_DIRECT_CURRENT_A {
            failures.push(format!("{direct:.2} A of direct current {at}"));
        }
        failures
    }
}

/// Returns what does not hold of the fast loop's timing, in sentences.
pub(crate) fn loop_failures(missed: u64, longest_gap_us: f64) -> Vec<String> {
    let mut failures = Vec::new();
    if missed > 0 {
        failures.push(format!("the fast loop missed {missed} ticks"));
    }
    if longest_gap_us > LONGEST_GAP_US {
        failures.push(format!("{longest_gap_us:.0} us between two rounds"));
    }
    failures
}

/// What a session came to.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Report {
    /// Every setpoint.
    pub hold: Vec<Hold>,
    /// PWM frequency: of all pins and times from arming to disarming that furthest from what it should be, Hz.
    pub pwm_hz: f64,
    /// Earliest and latest tick, from the beginning of a PWM period on, microseconds.
    pub tick_phase_us: [f64; 2],
    /// Shortest and longest time from a tick to the last duty that it set, microseconds.
    pub duties_after_us: [f64; 2],
    /// Mean, lowest and highest share of the six pins.
    pub shares: [[f64; 3]; 6],
    /// Steps that found a bridge enabled before its duties were set.
    pub early_enables: u64,
    /// Rounds that the fast loop missed.
    pub overruns: u64,
    /// Longest time between two rounds, microseconds.
    pub longest_gap_us: f64,
    /// Longest wait of the fast loop's interrupt while a motor was driven, microseconds,
    pub longest_wait_us: f64,
    /// and the function that let it in.
    pub waited_at: String,
    /// Whether the motors coasted after disarming, once the rotors stood.
    pub coasted: bool,
    /// Whether all phases' pins were low then.
    pub were_low: bool,
    /// Whether duties are taken over at the PWM counter's peaks alone, where the pins are low.
    pub taken_over_at_peaks: bool,
    /// Instructions and data that the fast loop took of flash.
    pub flash_in_ticks: u64,
    /// Share of the time that the light is on: running, and disarmed.
    pub lit: [f64; 2],
}

impl Report {
    /// Returns what does not hold, in sentences.
    pub fn failures(&self) -> Vec<String> {
        let mut failures = Vec::new();
        failures.extend(self.hold.iter().flat_map(Hold::failures));
        if self.pwm_hz != PWM_HZ {
            failures.push(format!("the PWM runs at {} Hz instead of {PWM_HZ}", self.pwm_hz));
        }
        let [earliest, latest] = self.tick_phase_us;
        if !(earliest >= 0.0 && latest <= TICK_PHASE_US) {
            failures.push(format!("ticks lie {earliest:.2} to {latest:.2} us after a PWM period"));
        }
        let [first, last] = self.duties_after_us;
        let [from, until] = TAKEN_OVER_US;
        if !(first > from && last < until) {
            let sentence = "duties are set at times that are taken over in different PWM periods";
            failures.push(format!("{sentence}: {first:.0} to {last:.0} us after the tick"));
        }
        for (pin, [mean, ..]) in self.shares.iter().enumerate() {
            if (mean - 0.5).abs() > SHARE_TOLERANCE {
                failures.push(format!("the mean share of PWM pin {pin} is {mean:.3}"));
            }
        }
        if self.early_enables > 0 {
            failures.push("a bridge is enabled before its own duties are set".to_owned());
        }
        if !self.coasted {
            failures.push("a bridge is enabled after disarming".to_owned());
        }
        if !self.were_low {
            failures.push("a phase's pin is high after disarming".to_owned());
        }
        if !self.taken_over_at_peaks {
            failures.push("duties are taken over elsewhere than at the PWM's peaks".to_owned());
        }
        let [running, disarmed] = self.lit;
        if running < 1.0 || (disarmed - LIT_DISARMED).abs() > LIGHT_TOLERANCE {
            failures
                .push(format!("the light's share is {running:.2} running, {disarmed:.2} disarmed"));
        }
        failures.extend(loop_failures(self.overruns, self.longest_gap_us));
        failures
    }
}

/// How long a setpoint is approached and how long it is then measured.
#[derive(Debug, Clone, Copy)]
pub struct Times {
    /// To get there.
    pub settle: Duration,
    /// To be measured.
    pub measure: Duration,
}

/// Holds a setpoint and measures it.
pub fn hold(
    rig: &mut Rig,
    (f_hz, theta_deg): (f64, f64),
    times: Times,
    current_limit_a: f64,
) -> Result<Hold, RigError> {
    let setpoint = setpoint(f_hz, theta_deg).map_err(|error| RigError::Fault(error.to_string()))?;
    rig.hold(setpoint);
    rig.run(times.settle)?;
    let mut meter = HoldMeter::new(setpoint);
    let mut peak_current_a: f64 = 0.0;
    let end = rig.chip.now() + times.measure;
    while rig.chip.now() < end {
        rig.step()?;
        let truth = rig.truth();
        meter.watch(&truth);
        peak_current_a = peak_current_a.max(truth.largest_current());
    }
    Ok(Hold::of((f_hz, theta_deg), &meter, peak_current_a, current_limit_a))
}

/// What a robot says of its battery before it is armed, and what is true.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Battery {
    /// Said, V; none where it does not measure.
    pub said_v: Option<f64>,
    /// True, V.
    pub true_v: f64,
}

impl Battery {
    /// Asks a disarmed robot.
    pub fn of(rig: &mut Rig) -> Result<Self, RigError> {
        let is_idle = |telemetry: &Telemetry| telemetry.state.is_idle();
        let telemetry = rig.wait_for_telemetry(PATIENCE, is_idle)?;
        let said = telemetry.and_then(|telemetry| telemetry.bus_voltage);
        let true_v = rig.chip.outside().bus_voltage();
        Ok(Self { said_v: said.map(|volts| f64::from(volts.get())), true_v })
    }

    /// Returns what does not hold, in a sentence.
    pub fn failure(&self) -> Option<String> {
        let Self { said_v, true_v } = *self;
        let Some(said_v) = said_v else {
            return Some("the battery is not measured".to_owned());
        };
        let is_off = (said_v / true_v - 1.0).abs() > BATTERY_TOLERANCE;
        is_off.then(|| format!("the battery has {true_v:.2} V, the robot says {said_v:.2} V"))
    }
}

/// Makes the magnet of one encoder after the other too weak, then too strong, then both good again; returns what the robot does
/// not report of it. Each magnet is reported as the worst that it was within [`MAGNET_SHOWN`].
pub fn magnet_failures(rig: &mut Rig) -> Result<Vec<String>, RigError> {
    let mut failures = Vec::new();
    let mut wanted = [Magnet::Good; 2];
    let mut look = |rig: &mut Rig, wanted, patience| {
        rig.run(patience)?;
        rig.request(Command::Ping(0))?;
        let found = rig.telemetry().map(|telemetry| telemetry.encoders.map(|it| it.magnet));
        if found != Some(wanted) {
            failures.push(format!("magnets that are {wanted:?} are reported as {found:?}"));
        }
        Ok::<(), RigError>(())
    };
    for motor in [0, 1] {
        for magnet in [Magnet::Weak, Magnet::Strong] {
            rig.chip.outside().magnets[motor] = magnet;
            wanted[motor] = magnet;
            look(rig, wanted, MAGNET_PATIENCE)?;
        }
    }
    rig.chip.outside().magnets = [Magnet::Good; 2];
    look(rig, [Magnet::Good; 2], MAGNET_SHOWN + MAGNET_PATIENCE)?;
    Ok(failures)
}

/// Arms, holds the five modes, of which the last reverses the one before, and disarms, all in one session.
pub fn drive(rig: &mut Rig, times: Times, progress: &dyn Fn(&str)) -> Result<Report, RigError> {
    let current_limit = rig.setting("current_limit")?;
    rig.forget_seen();
    progress("arming, which aligns first");
    rig.arm_uncommissioned()?;
    let mut report = Report::default();
    // Alignment turns each motor alone: shares are those of driving.
    rig.seen.shares = [[0.0, f64::INFINITY, 0.0]; 6];
    rig.seen.steps = 0;
    let mut lit_at_ends = 0.0;
    // The last one is a reversal from the one before.
    for mode in PaperMode::ALL {
        progress(mode.name());
        report.hold.push(hold(rig, mode.pair(), times, current_limit)?);
        lit_at_ends += rig.light();
    }
    let steps = rig.seen.steps.max(1) as f64;
    report.shares = rig.seen.shares.map(|[sum, lowest, highest]| [sum / steps, lowest, highest]);
    rig.disarm()?;
    let off = |hertz: &f64| (hertz - PWM_HZ).abs();
    report.pwm_hz =
        rig.seen.pwm_hz.into_iter().max_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0.0);
    rig.run(REST)?;
    report.coasted = rig.coasts();
    report.were_low = rig.is_low();
    report.taken_over_at_peaks = !rig.chip.counters().duties_taken_over_elsewhere;
    let (mut steps, mut lit) = (0, 0.0);
    let end = rig.chip.now() + LIGHT_PERIOD;
    while rig.chip.now() < end {
        rig.step()?;
        steps += 1;
        lit += rig.light();
    }
    report.lit = [lit_at_ends / PaperMode::ALL.len() as f64, lit / f64::from(steps)];
    report.flash_in_ticks = rig.chip.counters().flash_in_ticks;
    report.early_enables = rig.seen.early_enables;
    report.tick_phase_us = rig.seen.tick_phase_us;
    report.duties_after_us = rig.seen.duties_after_us;
    report.overruns = rig.seen.missed;
    report.longest_gap_us = rig.seen.longest_gap_us;
    let (waited, at) = rig.seen.longest_wait;
    report.longest_wait_us = waited as f64 * 1e6 / CYCLES_PER_SECOND as f64;
    report.waited_at = rig.chip.image().place(at);
    Ok(report)
}
