//! What a decision weighs, and how much each of it counts.

/// What counts how much in a decision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Error that costs one second per second, m.
    pub error_scale: f64,
    /// Errors beyond this many scales count linearly.
    pub linear_from: f64,
    /// Reward for progress at full speed, seconds per second.
    pub progress: f64,
    /// Cost of a switch, s.
    pub switch: f64,
    /// Cost of a switch that reverses the sense of rotation, s, besides.
    pub reversal: f64,
    /// Weight of the course at the end, s, where nothing is known of the way ahead.
    pub course: f64,
    /// Time for which the error at the end is assumed to last, s, likewise.
    pub tail: f64,
    /// Distance ahead at which the course returns to the path, m.
    pub return_length: f64,
    /// Weight of what is not known of a motion.
    pub risk: f64,
}

/// A robot that has been held for so long, s, is taken to risk more for its progress,
const HELD_FOR: f64 = 2.0;
/// up to so many times.
const LARGEST_FACTOR: f64 = 5.0;

impl Weights {
    /// Those of the predictive controller, chosen by hand.
    pub const PREDICTIVE: Self = Self {
        error_scale: 0.025,
        linear_from: 2.0,
        progress: 2.0,
        switch: 0.06,
        reversal: 0.0,
        course: 2.0,
        tail: 0.6,
        return_length: 0.12,
        risk: 0.0,
    };
    /// Those of the learned controller.
    pub const LEARNED: Self = Self { progress: 2.0, reversal: 0.15, risk: 1.0, ..Self::PREDICTIVE };

    /// Returns the weights of a robot without progress for `held` seconds: progress counts the more, the longer. Otherwise a robot
    /// could tremble for ever before a tip of its path, where turning round costs an error.
    #[must_use]
    pub fn held(self, held: f64) -> Self {
        let factor = (held / HELD_FOR).clamp(1.0, LARGEST_FACTOR);
        Self { progress: factor * self.progress, ..self }
    }

    /// Returns what it costs a second that the motion may be another than expected: an error of a second of it.
    #[must_use]
    pub fn risk(&self, spread: f64) -> f64 {
        self.risk * (spread / self.error_scale).powi(2)
    }

    /// Returns Huber's function of an error in scales: square near zero, linear beyond.
    #[must_use]
    pub fn robust(&self, error: f64) -> f64 {
        let (scales, from) = (error.abs() / self.error_scale, self.linear_from);
        if scales <= from { scales * scales } else { from * (2.0 * scales - from) }
    }
}
