//! A three-phase bridge, averaged over its PWM period.
//!
//! A phase stands at `duty x bus`, less what dead time takes: while neither switch conducts the current's
//! sign decides (Holtz 1992), which takes `dead time x PWM frequency` of the bus from the side that
//! drives the current. Near zero current the ripple crosses zero within the period and the loss fades.
//! A coasting bridge feeds what current there is back to the bus through its diodes, until it is
//! spent or the motor's back EMF no longer exceeds the bus.

use flix_firmware::hardware::{Bridge, Duty, Hardware, TICK_RATE_HZ};

use super::motor::{Motor, Sweep, Terminal};

/// Length of a tick, s.
pub const TICK: f64 = 1.0 / TICK_RATE_HZ as f64;

/// Voltage across a conducting body diode, V (silicon, at a few hundred milliamperes).
const DIODE_DROP: f64 = 0.7;

/// What matters of a bridge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverterParameters {
    /// Time in each PWM period in which neither switch of a phase conducts, s.
    pub dead_time: f64,
    /// PWM frequency, Hz.
    pub pwm_frequency: f64,
    /// From the tick's samples to the time from which its duties act, s.
    pub latency: f64,
    /// Whether an unpowered bridge lets the motor coast; else all low sides are on.
    pub can_coast: bool,
}

impl InverterParameters {
    /// Creates the bridge of this board: duties act as it states.
    #[must_use]
    pub fn of(hardware: &Hardware) -> Self {
        let pwm_frequency = f64::from(hardware.pwm_frequency_hz);
        Self {
            dead_time: f64::from(hardware.dead_time_ns) * 1e-9,
            pwm_frequency,
            latency: f64::from(hardware.actuation_delay_us) * 1e-6 - TICK / 2.0,
            can_coast: hardware.can_coast,
        }
    }
}

/// How a leg of a bridge is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Leg {
    /// It does what it is told.
    #[default]
    Good,
    /// It does not switch: it stays at this rail, and lets go where the bridge coasts.
    Stuck(Rail),
    /// One of its switches, or its wire, is short to this rail, whatever the bridge does. Its other switch has burnt out.
    Shorted(Rail),
}

/// What the bridge does to the motor during a sub-step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drive {
    /// What the wires are connected to.
    pub(super) terminals: [Terminal; 3],
    /// Share of each phase's charge that the bus gives.
    pub(super) from_bus: [f64; 3],
    /// Whether diodes carry the current, which then cannot reverse but in phases that are held.
    pub(super) by_diodes: bool,
    held: [bool; 3],
}

impl InverterParameters {
    pub(super) fn drive(
        &self,
        bridge: Bridge,
        legs: [Leg; 3],
        bus: f64,
        motor: &Motor,
        sweep: &Sweep,
    ) -> Drive {
        let coasts = bridge == Bridge::Off && self.can_coast;
        let held = legs.map(|leg| match leg {
            Leg::Shorted(rail) => Some(rail),
            Leg::Stuck(rail) if !coasts => Some(rail),
            Leg::Good | Leg::Stuck(_) => None,
        });
        if coasts {
            return freewheel(bus, held, motor.phase_currents(), sweep);
        }
        let mut shares = match bridge {
            Bridge::Duty(duties) => self.shares(duties, bus, motor),
            Bridge::Off => [0.0; 3],
        };
        for (share, rail) in shares.iter_mut().zip(held) {
            *share = rail.map_or(*share, |rail| if rail == Rail::High { 1.0 } else { 0.0 });
        }
        Drive::switched(shares, bus)
    }

    /// Share of the PWM period that each phase spends at the bus.
    fn shares(&self, duties: [Duty; 3], bus: f64, motor: &Motor) -> [f64; 3] {
        let lost = self.dead_time * self.pwm_frequency;
        // Half the peak-to-peak ripple of a phase at mid duty.
        let ripple = bus / (8.0 * motor.parameters().inductance * self.pwm_frequency);
        let currents = motor.phase_currents();
        core::array::from_fn(|phase| {
            let duty = duties[phase].share();
            let switches = duties[phase] > Duty::ZERO && duties[phase] < Duty::MAX;
            let side = (currents[phase] / ripple).clamp(-1.0, 1.0);
            if switches { (duty - lost * side).clamp(0.0, 1.0) } else { duty }
        })
    }
}

impl Drive {
    fn switched(shares: [f64; 3], bus: f64) -> Self {
        Self {
            terminals: shares.map(|share| Some(share * bus)),
            from_bus: shares,
            by_diodes: false,
            held: [false; 3],
        }
    }

    fn by_diodes(bus: f64, rails: [Option<Rail>; 3]) -> Self {
        Self {
            terminals: rails.map(|rail| {
                rail.map(|rail| match rail {
                    Rail::Low => -DIODE_DROP,
                    Rail::High => bus + DIODE_DROP,
                })
            }),
            from_bus: rails.map(|rail| if rail == Some(Rail::High) { 1.0 } else { 0.0 }),
            by_diodes: true,
            held: [false; 3],
        }
    }
}

/// A side of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rail {
    /// The negative one.
    Low,
    /// The positive one.
    High,
}

/// Where the diodes hold the wires of a coasting motor, beside those that are held.
fn freewheel(bus: f64, held: [Option<Rail>; 3], currents: [f64; 3], sweep: &Sweep) -> Drive {
    let mut rails = currents.map(|current| match current {
        into_motor if into_motor > CURRENT_IS_NONE => Some(Rail::Low),
        out_of_motor if out_of_motor < -CURRENT_IS_NONE => Some(Rail::High),
        _ => None,
    });
    let emf = Motor::back_emf(sweep);
    if held.iter().any(Option::is_some) {
        return beside_held(bus, held, rails, emf);
    }
    if rails.iter().all(Option::is_none) {
        rails = rectify(bus, emf);
    }
    Drive::by_diodes(bus, rails)
}

/// A wire that neither diode holds floats at the star point's potential plus its back EMF, until that opens a diode.
fn beside_held(
    bus: f64,
    held: [Option<Rail>; 3],
    mut rails: [Option<Rail>; 3],
    emf: [f64; 3],
) -> Drive {
    let potential = |phase: usize, rails: &[Option<Rail>; 3]| match (held[phase], rails[phase]) {
        (Some(Rail::High), _) => Some(bus),
        (Some(Rail::Low), _) => Some(0.0),
        (None, Some(Rail::High)) => Some(bus + DIODE_DROP),
        (None, Some(Rail::Low)) => Some(-DIODE_DROP),
        (None, None) => None,
    };
    let stars = (0..3).filter_map(|phase| Some(potential(phase, &rails)? - emf[phase]));
    let (sum, count) = stars.fold((0.0, 0.0), |(sum, count), star| (sum + star, count + 1.0));
    for (rail, emf) in rails.iter_mut().zip(emf) {
        let floats_at = sum / count + emf;
        *rail = rail.or(match floats_at {
            high if high > bus + DIODE_DROP => Some(Rail::High),
            low if low < -DIODE_DROP => Some(Rail::Low),
            _ => None,
        });
    }
    Drive {
        terminals: core::array::from_fn(|phase| potential(phase, &rails)),
        from_bus: core::array::from_fn(|phase| {
            f64::from(u8::from(held[phase].or(rails[phase]) == Some(Rail::High)))
        }),
        by_diodes: true,
        held: held.map(|rail| rail.is_some()),
    }
}

/// Without current, diodes start to conduct only when the back EMF between two phases exceeds the bus.
fn rectify(bus: f64, emf: [f64; 3]) -> [Option<Rail>; 3] {
    let phase_of = |better: fn(f64, f64) -> bool| {
        (1..3).fold(0, |best, phase| if better(emf[phase], emf[best]) { phase } else { best })
    };
    let (top, bottom) = (phase_of(|a, b| a > b), phase_of(|a, b| a < b));
    let mut rails = [None; 3];
    if emf[top] - emf[bottom] > bus + 2.0 * DIODE_DROP {
        rails[top] = Some(Rail::High);
        rails[bottom] = Some(Rail::Low);
    }
    rails
}

/// Below this a diode's current counts as spent, A.
const CURRENT_IS_NONE: f64 = 1e-6;

/// Diodes carry current one way only: a phase that would reverse stops.
pub(super) fn block_reversed(motor: &mut Motor, drive: &Drive) {
    let mut currents = motor.phase_currents();
    let mut stopped = false;
    for (phase, current) in currents.iter_mut().enumerate() {
        let out_of_motor = drive.from_bus[phase] > 0.0;
        let reversed = if out_of_motor { *current > 0.0 } else { *current < 0.0 };
        let reversed = reversed && !drive.held[phase];
        if drive.terminals[phase].is_none() || reversed {
            stopped |= reversed;
            *current = 0.0;
        }
    }
    if stopped {
        motor.set_phase_currents(balanced(currents));
    }
}

/// At most two phases still flow: their currents are opposite, of the mean size.
fn balanced(mut currents: [f64; 3]) -> [f64; 3] {
    let flowing = currents.iter().filter(|current| **current != 0.0).count();
    if flowing < 2 {
        return [0.0; 3];
    }
    let common = currents.iter().sum::<f64>() / 2.0;
    for current in currents.iter_mut().filter(|current| **current != 0.0) {
        *current -= common;
    }
    currents
}
