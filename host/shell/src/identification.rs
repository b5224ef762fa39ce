//! Options of an identification, and its stretches: what all commands that walk a robot in stretches share.

use std::path::Path;
use std::time::Duration;

use flix_host::nav::{Area, Identification, IdentificationSettings, ModeTable};
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::Setpoint;

use crate::Error;
use crate::course::pairs;
use crate::number::whole;
use crate::outlet::stdout;
use crate::output::{headings, print, table};
use crate::time::duration;

/// Options of an identification.
#[derive(Debug, Clone, clap::Args)]
pub struct IdentificationArgs {
    /// Duration of each stretch, 2 to 120 s; its first second does not count.
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = stretch)]
    pub seconds: Duration,
    /// Number of stretches of each mode; their scatter becomes the spread.
    #[arg(long, default_value_t = 2, value_parser = whole::<u32>(1..=100))]
    pub rounds: u32,
    /// Names of the modes to identify [default: all of the paper].
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Fence, m: outside it the identification ends.
    #[arg(long, value_name = "W,S,E,N", default_value = "-2,-2,2,2", allow_hyphen_values = true)]
    pub fence: Area,
}

impl IdentificationArgs {
    /// Returns an identification with these options, and the names of its modes.
    ///
    /// # Errors
    /// When the name of a mode is unknown.
    pub fn identification(&self) -> Result<(Identification, Vec<String>), Error> {
        let pairs = pairs(&self.only)?;
        let names = pairs.iter().map(|(name, _)| name.clone()).collect();
        Ok((Identification::new(self.settings(pairs)), names))
    }

    /// Returns the settings of an identification of these pairs.
    #[must_use]
    pub fn settings(&self, pairs: Vec<(String, Setpoint)>) -> IdentificationSettings {
        settings(pairs, self.seconds, self.rounds, self.fence)
    }

    /// Returns how the table is made, in a few words.
    #[must_use]
    pub fn source(&self) -> String {
        let seconds = self.seconds.as_secs_f64();
        match self.rounds {
            1 => format!("identified: 1 stretch of {seconds} s a mode; the spread is assumed"),
            rounds => format!("identified: {rounds} stretches of {seconds} s a mode"),
        }
    }
}

/// Without trusted poses a measurement ends after this time.
pub const POSE_PATIENCE: Duration = Duration::from_secs(5);

/// Parses the duration of a stretch, 2 to 120 s.
pub fn stretch(text: &str) -> Result<Duration, String> {
    let time = duration(text)?;
    if (Duration::from_secs(2)..=Duration::from_secs(120)).contains(&time) {
        Ok(time)
    } else {
        Err(format!("a stretch of {} s is outside 2 to 120 s", time.as_secs_f64()))
    }
}

/// Returns the settings of an identification of these pairs, as every command has them.
pub fn settings(
    pairs: Vec<(String, Setpoint)>,
    stretch: Duration,
    rounds: u32,
    fence: Area,
) -> IdentificationSettings {
    IdentificationSettings {
        pairs,
        stretch,
        rounds,
        fence,
        pose_deadline: Duration::from_millis(100),
        pose_patience: POSE_PATIENCE,
        least_battery: None,
        known: None,
    }
}

/// Prints a table that was measured, and writes it into its file; where that fails, the file is printed.
///
/// # Errors
/// When it cannot be written or printed.
pub fn save(modes: &ModeTable, remark: &str, path: &Path) -> Result<(), Error> {
    // A terminal that takes nothing keeps no file from being written.
    stdout().put(format!("{}{remark}\n", describe(modes)).as_bytes());
    modes.save(path).inspect_err(|_| {
        let _ = print(&modes.to_toml());
    })?;
    print(&format!("written to {}\n", path.display()))
}

/// Returns the table as text.
#[must_use]
pub fn describe(modes: &ModeTable) -> String {
    let speed = |s: flix_host::nav::Spread, digits: usize| {
        format!("{:.*} \u{b1} {:.*}", digits, s.mean, digits, s.spread)
    };
    let mut rows = vec![headings("mode|f/Hz|theta/deg|forward m/s|lateral m/s|yaw rad/s")];
    rows.extend(modes.modes().iter().map(|mode| {
        vec![
            mode.name.clone(),
            mode.setpoint.frequency().get().to_string(),
            mode.setpoint.direction().get().to_string(),
            speed(mode.forward, 4),
            speed(mode.lateral, 4),
            speed(mode.yaw, 3),
        ]
    }));
    let remarks = modes.modes().iter().filter_map(wrong_way);
    remarks.fold(table(&rows), |text, remark| text + &remark + "\n")
}

/// Returns a remark on a turn that goes the other way.
fn wrong_way(mode: &flix_host::nav::Mode) -> Option<String> {
    let is = |turn: PaperMode| turn.setpoint() == mode.setpoint;
    let (side, other, sign) = if is(PaperMode::LeftTurn) {
        ("left", "right", 1.0)
    } else if is(PaperMode::RightTurn) {
        ("right", "left", -1.0)
    } else {
        return None;
    };
    (sign * mode.yaw.mean < -mode.yaw.spread).then(|| {
        format!(
            "{}: it turns to the {other}, where this pair turns to the {side}: are the motors swapped (top, bottom), or the \
             tracked body's axes (z up, --up)?",
            mode.name
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_host::nav::{Mode as Measured, Spread};

    #[test]
    fn a_turn_that_goes_the_other_way_is_remarked() {
        let of = |turn: PaperMode, mean: f64| {
            let still = Spread { mean: 0.0, spread: 0.01 };
            let mode = Measured {
                name: "turning".into(),
                setpoint: turn.setpoint(),
                forward: still,
                lateral: still,
                yaw: Spread { mean, spread: 0.2 },
            };
            describe(&ModeTable::new("robot", "test", vec![mode]).unwrap())
        };
        assert!(of(PaperMode::LeftTurn, -1.0).contains("turning: it turns to the right, where"));
        assert!(of(PaperMode::RightTurn, 1.0).contains("turning: it turns to the left, where"));
        for (turn, mean) in [
            (PaperMode::LeftTurn, 1.0),
            (PaperMode::LeftTurn, -0.1),
            (PaperMode::RightTurn, -1.0),
            (PaperMode::Forward, -1.0),
        ] {
            assert!(!of(turn, mean).contains("it turns"), "{turn:?} {mean}");
        }
    }
}
