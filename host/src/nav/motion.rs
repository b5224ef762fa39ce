//! Prediction of the motion: the rotors ramp, and the gait follows them.
//!
//! A command does not move the robot at once. It arrives after the latency of the link; then the
//! rotors ramp to the new f and slew to the new theta; then the gait settles. While the sign of f
//! stays, the motion changes evenly from the old to the new. Through a reversal it fades with
//! (f/f0)^2, as the shaking force does, and returns the same way.

use super::modes::ModeTable;
use crate::link::line_difference;
use crate::pose::geometry::{PlanarPose, Twist};

/// Response of the robot to a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Ramp of the shaking frequency, Hz/s.
    pub frequency_ramp: f64,
    /// Slew of the shaking direction, degrees/s.
    pub direction_slew: f64,
    /// Settling time of the gait after the rotors have arrived, s.
    pub settling: f64,
}

impl Response {
    /// The response of simulated robots in the 0.3 s after a command: what the learned controller, which keeps on
    /// comparing, predicts best with.
    pub const MEASURED: Self =
        Self { frequency_ramp: 200.0, direction_slew: 900.0, settling: 0.12 };
}

impl Default for Response {
    /// Returns a response slightly slower than the robot's ramps (settings `frequency_ramp`, default
    /// 200 Hz/s, and `direction_ramp`, default 900 degrees/s), because their ends are rounded.
    fn default() -> Self {
        Self { frequency_ramp: 150.0, direction_slew: 600.0, settling: 0.15 }
    }
}

/// A mode as the prediction needs it. Index 0 of every list is rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Shaking frequency f, Hz.
    pub frequency: f64,
    /// Shaking direction theta, degrees.
    pub direction: f64,
    /// Expected steady motion on a level floor.
    pub twist: Twist,
    /// What a sloping floor adds: the first times the cosine of the heading, the second times its sine.
    pub slide: [Twist; 2],
    /// Spread of what is expected of the translation, m/s.
    pub spread: f64,
}

impl Motion {
    /// Returns the expected steady motion of a robot with this heading, rad.
    #[must_use]
    pub fn at(&self, heading: f64) -> Twist {
        self.facing(heading.sin_cos())
    }

    /// Returns the same by sine and cosine of the heading.
    fn facing(&self, (sin, cos): (f64, f64)) -> Twist {
        self.twist.plus(self.slide[0].scaled(cos)).plus(self.slide[1].scaled(sin))
    }
}

/// Index of rest in every list of motions.
pub const REST: usize = 0;

/// Returns the motions of a table, rest first.
#[must_use]
pub fn motions(table: &ModeTable) -> Vec<Motion> {
    let slide = [Twist::REST; 2];
    let rest = Motion { frequency: 0.0, direction: 0.0, twist: Twist::REST, slide, spread: 0.0 };
    let modes = table.modes().iter().map(|mode| Motion {
        frequency: f64::from(mode.setpoint.frequency().get()),
        direction: f64::from(mode.setpoint.direction().get()),
        twist: mode.twist(),
        slide,
        spread: 0.0,
    });
    std::iter::once(rest).chain(modes).collect()
}

/// State of rotors and gait on the way to a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gait {
    mode: usize,
    elapsed: f64,
    duration: f64,
    from_frequency: f64,
    from_direction: f64,
    from: usize,
    from_twist: Twist,
}

impl Gait {
    /// Returns the gait of a robot at rest.
    #[must_use]
    pub fn at_rest() -> Self {
        Self {
            mode: REST,
            elapsed: 0.0,
            duration: 0.0,
            from_frequency: 0.0,
            from_direction: 0.0,
            from: REST,
            from_twist: Twist::REST,
        }
    }

    /// Returns the mode that is in force or under way.
    #[must_use]
    pub fn mode(&self) -> usize {
        self.mode
    }

    /// Returns whether the motion is the steady motion of the mode.
    #[must_use]
    pub fn is_steady(&self) -> bool {
        self.elapsed >= self.duration
    }

    /// Returns this gait at the moment when another command reaches it.
    #[must_use]
    pub fn commanded(
        self,
        mode: usize,
        heading: f64,
        motions: &[Motion],
        response: &Response,
    ) -> Self {
        if mode == self.mode {
            return self;
        }
        let target = &motions[mode];
        let (from_frequency, from_direction) = self.rotors(motions, response);
        // At rest, and on the way there, theta is kept: there is no line of force to turn.
        let direction = if mode == REST { from_direction } else { target.direction };
        let ramp = (target.frequency - from_frequency).abs() / response.frequency_ramp;
        let slew = line_difference(from_direction - direction).abs() / response.direction_slew;
        Self {
            mode,
            elapsed: 0.0,
            duration: ramp.max(if from_frequency == 0.0 { 0.0 } else { slew }) + response.settling,
            from_frequency,
            from_direction: if from_frequency == 0.0 { direction } else { from_direction },
            from: self.mode,
            from_twist: self.twist(heading, motions, response),
        }
    }

    /// Returns the present f (Hz) and theta (degrees).
    fn rotors(&self, motions: &[Motion], response: &Response) -> (f64, f64) {
        let target = &motions[self.mode];
        if self.is_steady() {
            return (target.frequency, target.direction);
        }
        let change = target.frequency - self.from_frequency;
        let ramped = (response.frequency_ramp * self.elapsed).min(change.abs());
        let share = (self.elapsed / self.duration).min(1.0);
        let direction = if self.mode == REST { self.from_direction } else { target.direction };
        (
            self.from_frequency + ramped.copysign(change),
            self.from_direction + (direction - self.from_direction) * share,
        )
    }

    /// Returns how much of the present motion is that of the mode before, and how much that of the mode in force. Through
    /// a reversal it is less than one together.
    #[must_use]
    pub fn shares(&self, motions: &[Motion], response: &Response) -> [(usize, f64); 2] {
        let target = &motions[self.mode];
        let share = (self.elapsed / self.duration).min(1.0);
        let (before, now) = if self.is_steady() {
            (0.0, 1.0)
        } else if self.from_frequency * target.frequency > 0.0 {
            (1.0 - share, share)
        } else {
            let (frequency, _) = self.rotors(motions, response);
            let force =
                |whole: f64| if whole == 0.0 { 0.0 } else { (frequency / whole).powi(2).min(1.0) };
            if frequency * self.from_frequency > 0.0 {
                (force(self.from_frequency), 0.0)
            } else {
                (0.0, force(target.frequency).min(share))
            }
        };
        [(self.from, before), (self.mode, now)]
    }

    /// Returns the present motion of a robot with this heading, rad.
    #[must_use]
    pub fn twist(&self, heading: f64, motions: &[Motion], response: &Response) -> Twist {
        self.facing(heading.sin_cos(), motions, response)
    }

    /// Returns the same by sine and cosine of the heading.
    fn facing(&self, sin_cos: (f64, f64), motions: &[Motion], response: &Response) -> Twist {
        let [(_, before), (mode, now)] = self.shares(motions, response);
        self.from_twist.scaled(before).plus(motions[mode].facing(sin_cos).scaled(now))
    }

    /// Advances `pose` and the gait by `seconds` (one step: below some 0.1 s).
    pub fn advance(
        &mut self,
        pose: &mut PlanarPose,
        seconds: f64,
        motions: &[Motion],
        response: &Response,
    ) {
        let sin_cos = pose.heading.sin_cos();
        let before = self.facing(sin_cos, motions, response);
        self.elapsed += seconds;
        let after = self.facing(sin_cos, motions, response);
        *pose = pose.moved(before.plus(after).scaled(0.5), seconds);
    }
}

#[cfg(test)]
mod tests {
    use super::super::modes::tests::model_w;
    use super::*;

    const RESPONSE: Response =
        Response { frequency_ramp: 60.0, direction_slew: 360.0, settling: 0.1 };
    const FORWARD: usize = 1;
    const LEFT: usize = 3;
    const RIGHT: usize = 5;

    fn steady(mode: usize, motions: &[Motion]) -> Gait {
        let mut gait = Gait::at_rest().commanded(mode, 0.0, motions, &RESPONSE);
        gait.elapsed = 10.0;
        gait
    }

    #[test]
    fn a_reversal_takes_the_ramp_through_zero() {
        let motions = motions(&model_w());
        let turn = steady(LEFT, &motions).commanded(RIGHT, 0.0, &motions, &RESPONSE);
        assert!((turn.duration - (60.0 / 60.0 + 0.1)).abs() < 1e-9, "{turn:?}");
    }

    #[test]
    fn in_the_middle_of_a_reversal_the_robot_is_at_rest() {
        let motions = motions(&model_w());
        let mut turn = steady(LEFT, &motions).commanded(RIGHT, 0.0, &motions, &RESPONSE);
        turn.elapsed = 0.5;
        assert!(turn.twist(0.0, &motions, &RESPONSE).yaw.abs() < 1e-9);
    }

    #[test]
    fn from_forward_to_left_only_theta_slews() {
        let motions = motions(&model_w());
        let turn = steady(FORWARD, &motions).commanded(LEFT, 0.0, &motions, &RESPONSE);
        assert!((turn.duration - (60.0 / 360.0 + 0.1)).abs() < 1e-9, "{turn:?}");
    }

    #[test]
    fn an_interrupted_ramp_continues_from_where_it_is() {
        let motions = motions(&model_w());
        let mut gait = Gait::at_rest().commanded(FORWARD, 0.0, &motions, &RESPONSE);
        gait.elapsed = 0.25;
        let stopped = gait.commanded(REST, 0.0, &motions, &RESPONSE);
        assert!((stopped.from_frequency + 15.0).abs() < 1e-9);
        let before = gait.twist(0.0, &motions, &RESPONSE);
        assert_eq!(stopped.twist(0.0, &motions, &RESPONSE), before);
    }

    #[test]
    fn a_steady_gait_moves_as_its_table_says() {
        let motions = motions(&model_w());
        let mut gait = steady(LEFT, &motions);
        let mut pose = PlanarPose::default();
        for _ in 0..100 {
            gait.advance(&mut pose, 0.01, &motions, &RESPONSE);
        }
        assert!((pose.heading - 1.95).abs() < 1e-9);
    }
}
