//! What ripples with the rotors, over the interval between two telemetries: mean, least and largest.
//!
//! Each rotor pulls at the other and at the body twice a turn, so theta, the torque currents and the bus ripple at up to 70 Hz.
//! Single values, 50 a second, would show the 60 Hz of f = 30 Hz as a swing of 10 Hz that is not there.

use crate::units::{Current, RotorAngle, Voltage};

/// Most values of an interval: sums of so many fit up to 40 V and 40 A, and telemetry comes once a second or more often, after
/// 625.
const MOST: i32 = 800;
/// Bits of an angle that its sum leaves out: what is left is 2^-22 turns.
const ANGLE_SHIFT: u32 = 10;

/// Sum and extremes of the raw values of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Range {
    sum: i32,
    least: i32,
    largest: i32,
}

impl Range {
    #[inline(always)]
    fn add(&mut self, value: i32, is_first: bool) {
        if is_first {
            *self = Self { sum: value, least: value, largest: value };
        } else {
            self.sum = self.sum.wrapping_add(value);
            self.least = self.least.min(value);
            self.largest = self.largest.max(value);
        }
    }

    /// Returns mean, least and largest of so many values; `None` of none.
    fn spread(&self, count: i32) -> Option<[i32; 3]> {
        (count > 0).then(|| [self.sum / count, self.least, self.largest])
    }
}

/// What ripples, since the last telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Interval {
    count: i32,
    /// The first theta, and the turns of the line of force from there.
    reference: RotorAngle,
    turned: Range,
    currents: [Range; 2],
    bus: Range,
}

impl Interval {
    /// Begins anew with the next values.
    pub const fn restart(&mut self) {
        self.count = 0;
    }

    /// Takes theta, the torque currents (top, bottom; clockwise positive) and the voltage of the bus.
    pub fn add(&mut self, theta: RotorAngle, currents: [Current; 2], bus: Voltage) {
        if self.count >= MOST {
            return;
        }
        let is_first = self.count == 0;
        self.count += 1;
        if is_first {
            self.reference = theta;
        }
        let turned = theta.raw().wrapping_sub(self.reference.raw()) as i32;
        // The line of force repeats every half turn, and theta with it.
        self.turned.add((turned << 1) >> (1 + ANGLE_SHIFT), is_first);
        for (range, current) in self.currents.iter_mut().zip(currents) {
            range.add(current.raw(), is_first);
        }
        self.bus.add(bus.raw(), is_first);
    }

    /// Returns mean, least and largest theta; least and largest are those around the mean, which repeats every half turn.
    #[must_use]
    pub fn theta(&self) -> Option<[RotorAngle; 3]> {
        let angle = |turned: i32| self.reference.raw().wrapping_add_signed(turned << ANGLE_SHIFT);
        Some(self.turned.spread(self.count)?.map(|turned| RotorAngle::from_raw(angle(turned))))
    }

    /// Returns mean, least and largest torque current of a motor: 0 top, 1 bottom.
    #[must_use]
    pub fn current(&self, motor: usize) -> Option<[Current; 3]> {
        Some(self.currents[motor % 2].spread(self.count)?.map(Current::from_raw))
    }

    /// Returns mean, least and largest voltage of the bus.
    #[must_use]
    pub fn bus(&self) -> Option<[Voltage; 3]> {
        Some(self.bus.spread(self.count)?.map(Voltage::from_raw))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_protocol::units::{Amperes, Degrees};

    fn of(thetas: impl IntoIterator<Item = f64>) -> Interval {
        let mut interval = Interval::default();
        for theta in thetas {
            let current = Current::from_amperes(0.01 * theta);
            interval.add(
                RotorAngle::from_degrees(theta as f32),
                [current, -current],
                Voltage::from_volts(11.0),
            );
        }
        interval
    }

    #[test]
    fn mean_and_extremes_are_those_of_all_values() {
        let interval = of([30.0, 40.0, 20.0, 30.0]);
        let [mean, least, largest] =
            interval.theta().unwrap().map(|it| f64::from(Degrees::from(it).get()));
        let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
        assert!(close(mean, 30.0) && close(least, 20.0) && close(largest, 40.0));
        let [mean, least, largest] =
            interval.current(1).unwrap().map(|it| f64::from(Amperes::from(it).get()));
        assert!(close(mean, -0.3) && close(least, -0.4) && close(largest, -0.2));
        assert_eq!(interval.bus().unwrap(), [Voltage::from_volts(11.0); 3]);
        assert_eq!(Interval::default().theta(), None);
    }

    #[test]
    fn a_long_interval_of_the_largest_values_keeps_its_means() {
        let mut interval = Interval::default();
        let (current, bus) = (Current::from_amperes(-30.0), Voltage::from_volts(40.0));
        for _ in 0..2_000 {
            interval.add(RotorAngle::ZERO, [current, -current], bus);
        }
        assert_eq!(interval.bus().unwrap(), [bus; 3]);
        assert_eq!(interval.current(0).unwrap(), [current; 3]);
    }

    #[test]
    fn a_line_of_force_across_its_end_has_the_mean_between() {
        // 88 degrees and -88 degrees are 4 degrees apart, and so is the other end of the same line.
        for thetas in [[88.0, -88.0], [-92.0, -88.0], [179.0, -177.0]] {
            let [mean, least, largest] =
                of(thetas).theta().unwrap().map(|it| f64::from(Degrees::from(it).get()));
            let apart = |a: f64, b: f64| (a - b).rem_euclid(180.0);
            assert!((apart(mean, thetas[0]) - 2.0).abs() < 1e-3, "{thetas:?}: {mean}");
            assert!((apart(largest, least) - 4.0).abs() < 1e-3, "{thetas:?}");
        }
    }
}
