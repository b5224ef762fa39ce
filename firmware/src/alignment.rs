//! What an alignment finds out about a motor, as the fast half uses it and the settings keep it.

use crate::units::{ElectricalAngle, RotorAngle, cosine_sine};

/// What alignment found out about one motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Alignment {
    /// Electrical angle at rotor angle zero.
    pub electrical_offset: ElectricalAngle,
    /// Whether the electrical angle falls when the rotor turns clockwise.
    pub reversed: bool,
    /// Whether the current amplifiers count down when current flows into the motor.
    pub current_inverted: bool,
    /// Error of the encoder by rotor angle, 2^-32 turn: cosine and sine of the first, then of the
    /// second harmonic.
    pub eccentricity: [i32; 4],
}

/// How the angle of a rotor is counted: from where, and which way the encoder counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Clockwise angle of the eccentric mass from forward at reading zero.
    pub zero: RotorAngle,
    /// Whether the encoder counts clockwise.
    pub clockwise: bool,
    /// Pole pairs of the motor.
    pub pole_pairs: u32,
}

impl Alignment {
    /// Returns the same of the same motor where its angle is counted otherwise: the same reading of the encoder is the same
    /// electrical angle. `None` where the pole pairs differ: what was found with others says nothing.
    ///
    /// With `angle = zero + sign reading`, `electrical = pairs angle + offset` and an error `e(angle)`:
    ///
    /// ```text
    /// angle' = zero' + m (angle - zero),  m = sign sign'
    /// pairs' = m pairs,  offset' = offset + pairs zero - pairs' zero',  e'(angle') = m e(angle)
    /// ```
    #[must_use]
    pub fn counted(&self, from: Frame, to: Frame) -> Option<Self> {
        if from.pole_pairs != to.pole_pairs {
            return None;
        }
        let mirrored = from.clockwise != to.clockwise;
        let reversed = self.reversed != mirrored;
        let turned = |frame: Frame, reversed: bool| {
            let angle = frame.zero.raw().wrapping_mul(frame.pole_pairs) as i32;
            if reversed { angle.wrapping_neg() } else { angle }
        };
        let moved = turned(from, self.reversed).wrapping_sub(turned(to, reversed));
        let [cosine_1, sine_1, cosine_2, sine_2] = self.eccentricity;
        let first = mirrored_harmonic([cosine_1, sine_1], 1, mirrored, from, to);
        let second = mirrored_harmonic([cosine_2, sine_2], 2, mirrored, from, to);
        Some(Self {
            electrical_offset: self.electrical_offset.turned(moved),
            reversed,
            current_inverted: self.current_inverted,
            eccentricity: [first[0], first[1], second[0], second[1]],
        })
    }
}

/// Returns cosine and sine of an error's harmonic where the angle is counted otherwise.
fn mirrored_harmonic(
    [cosine, sine]: [i32; 2],
    order: u32,
    mirrored: bool,
    from: Frame,
    to: Frame,
) -> [i32; 2] {
    let zero = if mirrored { from.zero.raw().wrapping_neg() } else { from.zero.raw() };
    let (turn_cosine, turn_sine) =
        cosine_sine(zero.wrapping_sub(to.zero.raw()).wrapping_mul(order));
    let [turn_cosine, turn_sine] = [turn_cosine, turn_sine].map(i64::from);
    let (cosine, sine) = (i64::from(cosine), i64::from(sine));
    let sine = if mirrored { -sine } else { sine };
    let turned = [cosine * turn_cosine + sine * turn_sine, sine * turn_cosine - cosine * turn_sine];
    turned.map(|part| {
        let part = (part >> 31) as i32;
        if mirrored { -part } else { part }
    })
}
