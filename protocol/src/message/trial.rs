//! Trials: drives of motors with unknown values. The scope captures them, and the operator's program finds the values.
//!
//! After each trial, also a failed one, the robot is disarmed. A trial begins with rest and the zero of the current sense. Then a
//! field of fixed direction grows from nearly nothing until a phase carries [`Trial::current_ma`], as its amplifier shows it, or
//! the bridge gives no more; [`TRIAL_BOUND_MA`] ends the trial in an over-current fault, and no current at all in a
//! fault of the current sense. Half a second later, with the voltage held, the [`Pattern`] begins.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::units::{OutOfRange, within};

/// Least current of a trial, mA.
pub const LEAST_TRIAL_CURRENT_MA: u16 = 50;
/// Most current of a trial, mA.
pub const MOST_TRIAL_CURRENT_MA: u16 = 1_300;
/// Current that ends a trial, mA: with an amplifier that shows 20 % too little still below 2 A.
pub const TRIAL_BOUND_MA: u16 = 1_500;
/// Longest pattern, ticks: 1 s.
pub const LONGEST_PATTERN_TICKS: u16 = 10_000;
/// Fastest field: 50 Hz, in 2^-16 turn per tick.
pub const FASTEST_FIELD: i16 = 328;

/// One trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Trial {
    /// Whether the top and the bottom motor are driven; one that is not is shorted.
    pub motors: [bool; 2],
    /// Largest phase current, 50 to 1,300 mA.
    pub current_ma: u16,
    /// Electrical angle of the field where it grows, from phase A, 2^-16 turn.
    pub angle: u16,
    /// Motion of the field afterwards.
    pub pattern: Pattern,
    /// For how long, at most 10,000 ticks.
    pub ticks: u16,
}

/// Motion of a trial's field once its voltage is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Pattern {
    /// Its voltage is halved for so many ticks, then whole for as many, and so on; at least 1.
    Halve(u16),
    /// It turns, in the order of the phases where positive; it gathers speed evenly in [`GATHER_TICKS`], which come before
    /// the others. In 2^-16 turn per tick, 328 (50 Hz) either way.
    Turn(i16),
    /// It jumps a third of a turn, in the order of the phases, after so many ticks, then back, and so on; at least 1.
    Swing(u16),
}

/// Ticks in which a turning field gathers its speed, so softly that the rotor hardly swings: 0.41 s.
pub const GATHER_TICKS: u16 = 1 << 12;

/// A third of a turn, 2^-32 turn.
const THIRD: u32 = 0x5555_5555;

impl Trial {
    /// Checks its values against their ranges.
    ///
    /// # Errors
    /// When one is out of range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let (least, most) = (LEAST_TRIAL_CURRENT_MA.into(), MOST_TRIAL_CURRENT_MA.into());
        within("current", "mA", f32::from(self.current_ma), least, most)?;
        within("length", "ticks", self.ticks.into(), 1.0, LONGEST_PATTERN_TICKS.into())?;
        let fastest: f32 = FASTEST_FIELD.into();
        match self.pattern {
            Pattern::Halve(ticks) | Pattern::Swing(ticks) => {
                within("interval", "ticks", ticks.into(), 1.0, LONGEST_PATTERN_TICKS.into())?;
            }
            Pattern::Turn(speed) => {
                within("field", "2^-16 turn per tick", speed.into(), -fastest, fastest)?;
            }
        }
        Ok(())
    }

    /// Returns how many ticks it takes before the pattern is captured.
    #[must_use]
    pub const fn ticks_before(&self) -> u32 {
        match self.pattern {
            Pattern::Halve(_) | Pattern::Swing(_) => 0,
            Pattern::Turn(_) => GATHER_TICKS as u32,
        }
    }

    /// Returns the electrical angle of the field so many ticks after it began to turn, 2^-32 turn.
    #[must_use]
    pub const fn field(&self, tick: u32) -> u32 {
        let start = (self.angle as u32) << 16;
        let speed = match self.pattern {
            Pattern::Halve(_) | Pattern::Swing(0) => return start,
            Pattern::Swing(ticks) => {
                let is_ahead = !(tick / ticks as u32).is_multiple_of(2);
                return start.wrapping_add(if is_ahead { THIRD } else { 0 });
            }
            Pattern::Turn(speed) => speed,
        };
        // Sum of the speeds of the ticks before: evenly more in each while it gathers.
        let gather = GATHER_TICKS as u32;
        let gathered = if tick < gather { tick } else { gather };
        let whole = tick - gathered;
        let gathering = (gathered * gathered.saturating_sub(1) / 2) << 4;
        let distance = gathering.wrapping_add(whole << 16) as i32;
        start.wrapping_add((distance as i64 * speed as i64) as u32)
    }
}

/// Figures of the bridges from the board's description, which no trial can tell from the motor's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Bridges {
    /// Time in each PWM period in which neither switch of a phase conducts, nanoseconds; 0 where it is not known.
    pub dead_time_ns: u16,
    /// PWM frequency, hertz.
    pub pwm_frequency_hz: u32,
    /// Whether the bus voltage is measured; else the setting `nominal_voltage` is taken for it.
    pub measures_bus: bool,
    /// Whether phase currents are measured; else there are no trials, and motors are driven by voltages.
    pub measures_current: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURNING: Trial = Trial {
        motors: [true; 2],
        current_ma: 500,
        angle: 0x4000,
        pattern: Pattern::Turn(-100),
        ticks: 2_000,
    };

    #[test]
    fn a_field_gathers_speed_evenly_and_keeps_it() {
        let step = |tick| TURNING.field(tick + 1).wrapping_sub(TURNING.field(tick)) as i32;
        assert_eq!(TURNING.field(0), 0x4000_0000);
        let whole = -100 << 16;
        let expected = [0, -1_600, whole / 2, whole, whole];
        assert_eq!([0, 1, 2_048, 4_096, 9_000].map(step), expected);
        let standing = Trial { pattern: Pattern::Halve(40), ..TURNING };
        assert_eq!(standing.field(7_777), 0x4000_0000);
        let swinging = Trial { pattern: Pattern::Swing(40), ..TURNING };
        let expected = [0x4000_0000, 0x4000_0000, 0x9555_5555, 0x9555_5555, 0x4000_0000];
        assert_eq!([0, 39, 40, 79, 80].map(|tick| swinging.field(tick)), expected);
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        assert!(TURNING.check().is_ok());
        for wrong in [
            Trial { current_ma: 49, ..TURNING },
            Trial { current_ma: 1_301, ..TURNING },
            Trial { ticks: 0, ..TURNING },
            Trial { ticks: 10_001, ..TURNING },
            Trial { pattern: Pattern::Halve(0), ..TURNING },
            Trial { pattern: Pattern::Swing(0), ..TURNING },
            Trial { pattern: Pattern::Turn(329), ..TURNING },
            Trial { pattern: Pattern::Turn(i16::MIN), ..TURNING },
        ] {
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
    }
}
