//! Wires, amplifiers and windings, from a field that stands along phase A, B and C in turn, one motor after the other.
//!
//! The currents of a star, or of whatever is left of it, are those of three conductances between its terminals. A field along
//! a phase puts V on it and -V/2 on the other two:
//!
//! ```text
//! along:        A                     B                     C
//! i_a =  3/2 V (g_ab + g_ca)    -3/2 V g_ab           -3/2 V g_ca
//! i_b = -3/2 V g_ab              3/2 V (g_ab + g_bc)  -3/2 V g_bc
//! ```
//!
//! Each amplifier says on its own which phase it shows, and how two of the conductances compare, whatever its gain. A star of
//! resistances has R_a : R_b : R_c = g_bc : g_ca : g_ab.

use super::circuit::Circuit;
use super::finding::{Finding, Phase};
use super::turning_field::unwrapped;

/// Electrical angles of a field along phases A, B and C, 2^-16 turn.
pub(crate) const ANGLES: [u16; 3] = [0, 0x5555, 0xaaab];
/// Less than this share of the largest is nothing.
const NOTHING: f64 = 0.15;
/// Of a phase C that is open A and B show less than this share: ten times the resistance of the others leaves a tenth.
const NOTHING_OF_C: f64 = 0.06;
/// More than this share of the largest shows in the other motor's amplifiers only when they are connected to this one.
const CROSSED: f64 = 0.3;
/// Less than this is no current at all, A/V: 3 mA where the robot looks for one, at 0.15 V.
const LEAST: f64 = 0.02;
/// Less than this may be noise, A/V.
const NOISE: f64 = 0.013;
/// And less than this does not compare two resistances, A/V: 4 mA/V of noise are a fifth of it.
const FAINT: f64 = 0.02;
/// Largest ratio of the resistances of two phases of a good motor.
const LARGEST_UNEVENNESS: f64 = 1.25;
/// The same where some fields showed no current that the robot goes on with: they were looked at with less voltage, of which dead
/// time takes more.
const LARGEST_FAINT_UNEVENNESS: f64 = 2.0;
/// Phases whose resistances differ by less than this are alike: what dead time and noise make of a good motor.
const EVEN: f64 = 1.04;
/// Largest ratio of the gains of two amplifiers that are each within 20 %, and some more.
const LARGEST_GAINS: f64 = 1.72;
/// Two phases that touch have less than this share of the other motor's inductance.
const SHORTED_INDUCTANCE: f64 = 0.7;

/// Most that the angle of a standing rotor jumps, root mean square, degrees.
const NOISY_DEG: f64 = 0.3;
/// Most current that an amplifier shows where none flows, A.
const LARGEST_OFFSET: f64 = 0.12;

/// A robot that does nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Resting {
    /// Angles of both rotors, degrees, in every tick.
    pub angles: [Vec<f64>; 2],
    /// Mean currents that amplifiers A and B of both motors show, A.
    pub currents: [[f64; 2]; 2],
}

impl Resting {
    /// Judges it.
    ///
    /// # Errors
    /// What is wrong.
    pub fn check(&self) -> Result<(), Finding> {
        for (motor, angles) in self.angles.iter().enumerate() {
            let angles = unwrapped(angles);
            let count = angles.len().max(1) as f64;
            let mean = angles.iter().sum::<f64>() / count;
            let square = angles.iter().map(|angle| (angle - mean).powi(2)).sum::<f64>() / count;
            let degrees = square.sqrt();
            if degrees > NOISY_DEG {
                return Err(Finding::EncoderNoisy { motor, degrees });
            }
        }
        for (motor, currents) in self.currents.iter().enumerate() {
            for (phase, shown) in currents.iter().enumerate() {
                if shown.abs() > LARGEST_OFFSET {
                    let (phase, shown) = (Phase(phase), *shown);
                    return Err(Finding::AmplifierOffset { motor, phase, shown });
                }
            }
        }
        Ok(())
    }
}

/// What a motor showed under a field along one phase.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stood {
    /// Currents that its amplifiers A and B showed, per volt along the field, A/V.
    pub own: [f64; 2],
    /// And those of the other motor's.
    pub other: [f64; 2],
    /// The circuit along the field, as one amplifier shows it.
    pub circuit: Option<Circuit>,
}

impl Stood {
    /// Returns what amplifiers would have shown that show a current as it is, of what these did that show `scale` times as much.
    pub(super) fn unscaled(self, scale: f64) -> Self {
        let [own, other] = [self.own, self.other].map(|pair| pair.map(|it| it / scale));
        let circuit = self.circuit.map(|it| Circuit {
            resistance: scale * it.resistance,
            inductance: scale * it.inductance,
            ..it
        });
        Self { own, other, circuit }
    }
}

/// Judges both motors, each under a field along A, B and C.
///
/// # Errors
/// What is wrong.
pub fn judge(motors: &[[Stood; 3]; 2]) -> Result<(), Finding> {
    for (motor, stood) in motors.iter().enumerate() {
        let connected = Motor { motor, stood, other: &motors[1 - motor] };
        connected.carries()?;
        connected.is_own()?;
        connected.is_closed()?;
        connected.is_in_order()?;
        connected.is_alike()?;
        connected.is_even()?;
    }
    Ok(())
}

/// Returns whether a finding compares sizes of currents.
pub(super) const fn compares(finding: Finding) -> bool {
    matches!(
        finding,
        Finding::NotConnected(_)
            | Finding::AmplifiersDiffer { .. }
            | Finding::BadJoint { .. }
            | Finding::ShortedTurns { .. }
            | Finding::ShortedPhases { .. }
    )
}

/// Returns the resistances of phases A, B and C of a motor over their mean, by its three fields; all 1 where they are alike.
#[must_use]
pub fn uneven(stood: &[Stood; 3]) -> [f64; 3] {
    let star = star([0, 1].map(|amplifier| stood.map(|it| it.own[amplifier])));
    let [low, high] = [f64::min, f64::max].map(|of| star.into_iter().fold(1.0, of));
    let mean = star.iter().sum::<f64>() / 3.0;
    if high / low < EVEN { [1.0; 3] } else { star.map(|resistance| resistance / mean) }
}

/// Returns the resistances of phases A, B and C over that of C, from what amplifiers A and B showed along A, B and C.
fn star([a, b]: [[f64; 3]; 2]) -> [f64; 3] {
    [b[2] / b[0], a[2] / a[1], 1.0]
}

struct Motor<'a> {
    motor: usize,
    stood: &'a [Stood; 3],
    other: &'a [Stood; 3],
}

fn largest(row: [f64; 3]) -> f64 {
    row.into_iter().fold(0.0, |most, value| most.max(value.abs()))
}

/// Returns the phase that a row of currents belongs to, and its sign.
fn phase_of(row: [f64; 3]) -> (usize, f64) {
    let along = |phase: usize| 3.0 * row[phase] - row.iter().sum::<f64>();
    let better = |best: usize, phase: usize| {
        if along(phase).abs() > along(best).abs() { phase } else { best }
    };
    let phase = (1..3).fold(0, better);
    (phase, along(phase).signum())
}

impl Motor<'_> {
    /// What amplifier A or B showed along A, B and C.
    fn row(&self, amplifier: usize) -> [f64; 3] {
        [0, 1, 2].map(|field| self.stood[field].own[amplifier])
    }

    fn other_row(&self, amplifier: usize) -> [f64; 3] {
        [0, 1, 2].map(|field| self.stood[field].other[amplifier])
    }

    /// The largest that anything showed.
    fn most(&self) -> f64 {
        [0, 1].iter().fold(0.0, |most: f64, amplifier| {
            most.max(largest(self.row(*amplifier))).max(largest(self.other_row(*amplifier)))
        })
    }

    fn carries(&self) -> Result<(), Finding> {
        if self.most() < LEAST { Err(Finding::NotConnected(self.motor)) } else { Ok(()) }
    }

    /// Whether its own amplifiers show its currents, and not the other motor's.
    fn is_own(&self) -> Result<(), Finding> {
        let most = (CROSSED * self.most()).max(NOISE);
        let crossed = [0, 1].map(|amplifier| largest(self.other_row(amplifier)) > most);
        let motor = 1 - self.motor;
        match crossed {
            [false, false] => Ok(()),
            [true, true] => Err(Finding::AmplifiersOfOther(motor)),
            [is_first, _] => {
                let phase = Phase(usize::from(!is_first));
                Err(Finding::AmplifierOfOther { motor, phase })
            }
        }
    }

    /// Whether all three phases carry, and both amplifiers show it.
    fn is_closed(&self) -> Result<(), Finding> {
        let motor = self.motor;
        for phase in [0, 1] {
            if largest(self.row(phase)) > NOTHING * self.most() {
                continue;
            }
            // Open, this phase gives nothing to the other one either.
            let other = self.row(1 - phase);
            let phase_is_open = other[phase].abs() < NOTHING * largest(other);
            let phase = Phase(phase);
            return Err(if phase_is_open {
                Finding::OpenPhase { motor, phase }
            } else {
                Finding::AmplifierDead { motor, phase }
            });
        }
        let [a, b] = [self.row(0), self.row(1)];
        let shown = a[2].abs() + b[2].abs();
        if shown < NOTHING_OF_C * (largest(a) + largest(b)) {
            Err(Finding::OpenPhase { motor, phase: Phase(2) })
        } else {
            Ok(())
        }
    }

    /// Whether the amplifiers show phases A and B, with one sign.
    fn is_in_order(&self) -> Result<(), Finding> {
        let motor = self.motor;
        let [(of_a, sign_a), (of_b, sign_b)] = [0, 1].map(|it| phase_of(self.row(it)));
        match [of_a, of_b] {
            [0, 1] if sign_a == sign_b => Ok(()),
            [0, 1] => Err(Finding::AmplifiersOpposed(motor)),
            [1, 0] => Err(Finding::AmplifiersSwapped(motor)),
            [0, phase] => {
                let (amplifier, phase) = (Phase(1), Phase(phase));
                Err(Finding::AmplifierElsewhere { motor, amplifier, phase })
            }
            [phase, _] => {
                let (amplifier, phase) = (Phase(0), Phase(phase));
                Err(Finding::AmplifierElsewhere { motor, amplifier, phase })
            }
        }
    }

    /// Whether its phases have one resistance.
    fn is_even(&self) -> Result<(), Finding> {
        let motor = self.motor;
        let [a, b] = [self.row(0), self.row(1)];
        if [b[0], b[2], a[1], a[2]].iter().all(|it| it.abs() < FAINT) {
            return Ok(());
        }
        let star = star([a, b]);
        let mut order = [0, 1, 2];
        order.sort_by(|one, other| star[*one].total_cmp(&star[*other]));
        let [low, middle, high] = order;
        let (above, below) = (star[high] / star[middle], star[low] / star[middle]);
        let found = self.stood.iter().filter(|it| it.circuit.is_some()).count();
        let largest = if found % 3 == 0 { LARGEST_UNEVENNESS } else { LARGEST_FAINT_UNEVENNESS };
        if star[high] / star[low] < largest {
            return Ok(());
        }
        if above * below < 1.0 {
            return Err(Finding::ShortedTurns { motor, phase: Phase(low), ratio: below });
        }
        let inductance = |stood: &[Stood; 3]| stood[low].circuit.map(|it| it.inductance);
        let is_shorted = inductance(self.stood)
            .zip(inductance(self.other))
            .is_some_and(|(own, other)| own < SHORTED_INDUCTANCE * other);
        Err(if is_shorted {
            let phases = [low.min(middle), low.max(middle)].map(Phase);
            Finding::ShortedPhases { motor, phases }
        } else {
            Finding::BadJoint { motor, phase: Phase(high), ratio: above }
        })
    }

    /// Whether its amplifiers show a current as one: what B shows along A and A along B flows through the same conductance.
    fn is_alike(&self) -> Result<(), Finding> {
        let (b, a) = (self.row(1)[0], self.row(0)[1]);
        let ratio = b / a;
        if b.abs().min(a.abs()) < NOISE || (1.0 / LARGEST_GAINS..LARGEST_GAINS).contains(&ratio) {
            Ok(())
        } else {
            Err(Finding::AmplifiersDiffer { motor: self.motor, ratio })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Currents per volt of a star of these resistances, shown with these gains.
    fn star(resistances: [f64; 3], gains: [f64; 2]) -> [Stood; 3] {
        [0, 1, 2].map(|field| {
            let volts = [0, 1, 2].map(|phase| if phase == field { 1.0 } else { -0.5 });
            let all: f64 = resistances.iter().map(|it| 1.0 / it).sum();
            let middle: f64 = (0..3).map(|it| volts[it] / resistances[it]).sum::<f64>() / all;
            let own = [0, 1].map(|it| gains[it] * (volts[it] - middle) / resistances[it]);
            Stood { own, other: [0.0; 2], circuit: None }
        })
    }

    const OPEN: f64 = 1e9;

    #[test]
    fn good_motors_pass_with_amplifiers_of_any_sign_that_are_20_percent_off() {
        for gains in [[1.2, 0.8], [-0.8, -1.2]] {
            assert_eq!(judge(&[star([2.0; 3], gains), star([2.3; 3], [1.0; 2])]), Ok(()));
        }
    }

    #[test]
    fn an_open_phase_and_a_bad_joint_are_told_from_a_dead_amplifier() {
        let good = star([2.0; 3], [1.0; 2]);
        for phase in [0, 1, 2] {
            let mut resistances = [2.0; 3];
            resistances[phase] = OPEN;
            let bad = star(resistances, [0.9, 1.1]);
            let expected = Finding::OpenPhase { motor: 1, phase: Phase(phase) };
            assert_eq!(judge(&[good, bad]), Err(expected));
            resistances[phase] = 5.0;
            let found = judge(&[star(resistances, [1.1, 0.9]), good]);
            let Err(Finding::BadJoint { motor: 0, phase: Phase(named), ratio }) = found else {
                panic!("{found:?}");
            };
            assert_eq!(named, phase);
            assert!((ratio - 2.5).abs() < 1e-9);
            resistances[phase] = 1.0;
            let found = judge(&[star(resistances, [1.1, 0.9]), good]);
            assert!(
                matches!(found, Err(Finding::ShortedTurns { motor: 0, phase: Phase(named), .. }) if named == phase)
            );
        }
        for phase in [0, 1] {
            let mut gains = [1.0; 2];
            gains[phase] = 0.0;
            let expected = Finding::AmplifierDead { motor: 0, phase: Phase(phase) };
            assert_eq!(judge(&[star([2.0; 3], gains), good]), Err(expected));
        }
        let expected = Err(Finding::NotConnected(1));
        assert_eq!(judge(&[good, star([OPEN; 3], [1.0; 2])]), expected);
    }

    #[test]
    fn what_was_looked_at_with_less_voltage_compares_less_well() {
        let good = star([2.0; 3], [1.0; 2]);
        let judged = |ratio: f64, found: usize| {
            let mut stood = star([2.0 * ratio, 2.0, 2.0], [1.0; 2]);
            for stood in &mut stood[..found] {
                stood.circuit = Some(Circuit::default());
            }
            judge(&[stood, good]).is_ok()
        };
        for found in [0, 3] {
            assert!(judged(1.2, found) && !judged(1.3, found), "{found}");
        }
        for found in [1, 2] {
            assert!(judged(1.9, found) && !judged(2.1, found), "{found}");
        }
    }

    #[test]
    fn amplifiers_that_are_connected_elsewhere_are_named() {
        let good = star([2.0; 3], [1.0, 1.1]);
        let changed = |change: fn(&mut Stood)| {
            let mut stood = good;
            stood.iter_mut().for_each(change);
            judge(&[good, stood])
        };
        let swapped = changed(|it| it.own.swap(0, 1));
        assert_eq!(swapped, Err(Finding::AmplifiersSwapped(1)));
        let opposed = changed(|it| it.own[0] = -it.own[0]);
        assert_eq!(opposed, Err(Finding::AmplifiersOpposed(1)));
        let third = changed(|it| it.own[1] = -it.own[0] - it.own[1] / 1.1);
        let (amplifier, phase) = (Phase(1), Phase(2));
        assert_eq!(third, Err(Finding::AmplifierElsewhere { motor: 1, amplifier, phase }));
        let one = changed(|it| core::mem::swap(&mut it.own[1], &mut it.other[1]));
        assert_eq!(one, Err(Finding::AmplifierOfOther { motor: 0, phase: Phase(1) }));
        let both = changed(|it| core::mem::swap(&mut it.own, &mut it.other));
        assert_eq!(both, Err(Finding::AmplifiersOfOther(0)));
        let weak = changed(|it| it.own[0] /= 2.0);
        assert!(matches!(weak, Err(Finding::AmplifiersDiffer { motor: 1, ratio }) if ratio > 2.1));
    }

    #[test]
    fn windings_that_touch_lose_their_inductance() {
        let with = |stood: [Stood; 3], inductance: f64| {
            let circuit = Some(Circuit { resistance: 1.0, inductance, ..Circuit::default() });
            stood.map(|it| Stood { circuit, ..it })
        };
        let good = with(star([2.0; 3], [1.0; 2]), 1e-3);
        let bad = star([2.5, 1.0, 1.0], [1.0; 2]);
        let phases = [Phase(1), Phase(2)];
        let touching = judge(&[with(bad, 0.3e-3), good]);
        assert_eq!(touching, Err(Finding::ShortedPhases { motor: 0, phases }));
        assert!(matches!(judge(&[with(bad, 1e-3), good]), Err(Finding::BadJoint { .. })));
    }
}
