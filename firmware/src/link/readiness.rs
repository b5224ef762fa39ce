//! What has to hold before motors move: a link that was steady, and settings with which they rest.

use flix_protocol::failsafe::{LINK_LATE, PROVING_TIME, arms_with, longest_command_age};
use flix_protocol::message::Refusal;
use flix_protocol::units::Instant;

use crate::alignment::Alignment;
use crate::fast::margin;
use crate::hardware::Hardware;
use crate::settings::{self, Settings, text};

/// For how long commands have come without a gap.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Steadiness {
    /// Since when, and when the last one came.
    run: Option<(Instant, Instant)>,
}

impl Steadiness {
    pub(super) fn heard(&mut self, now: Instant) {
        self.run = match self.run {
            Some((since, last)) if now.since(last) < LINK_LATE => Some((since, now)),
            _ => Some((now, now)),
        };
    }

    /// Returns whether the last one ended a run that is long enough to arm.
    pub(super) fn is_proven(&self) -> bool {
        self.run.is_some_and(|(since, last)| last.since(since) >= PROVING_TIME)
    }
}

/// Settings with what is to be said of them before anything moves: of the age of commands, and of their stability margin.
/// Working that out takes a processor without a floating-point unit some
/// 100 ms, in which nothing is received: whoever arms must not wait for it.
pub(super) struct Judged {
    settings: Settings,
    pub(super) verdict: Result<(), Refusal>,
}

impl Judged {
    pub(super) fn of(settings: &Settings, hardware: &Hardware) -> Self {
        let settings = decisive(settings);
        let measures_current = hardware.current_sense.is_some();
        let verdict = judge_command_age(&settings)
            .and_then(|()| margin::judge(&settings.on(hardware), measures_current));
        Self { settings, verdict }
    }

    pub(super) fn is_of(&self, settings: &Settings) -> bool {
        self.settings == decisive(settings)
    }
}

/// Refuses an age of commands with which the rotors could turn longer than promised after the last intent to move. It stays
/// stored: only its robot does not arm.
fn judge_command_age(settings: &Settings) -> Result<(), Refusal> {
    const NAME: &str = "command_age";
    if arms_with(settings.command_age, settings.frequency_ramp) {
        return Ok(());
    }
    let longest = longest_command_age(settings.frequency_ramp);
    let minimum = settings::TABLE.iter().find(|it| it.name == NAME).map_or(0.0, |it| it.minimum);
    Err(Refusal::OutOfRange { name: text(NAME), minimum, maximum: longest.as_secs_f32() })
}

/// Returns settings without what no loop is judged by: what an alignment finds, and how values are known.
fn decisive(settings: &Settings) -> Settings {
    let mut settings = Settings { marks: Settings::DEFAULT.marks, ..*settings };
    settings.learn([Alignment::default(); 2]);
    settings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;

    /// To judge takes a time in which nothing is received: what no loop depends on must not cause it.
    #[test]
    fn neither_marks_nor_an_alignment_make_settings_be_judged_anew() {
        let judged = Judged::of(&Settings::DEFAULT, &DENGFOC_V3_01.hardware);
        let mut settings = Settings::DEFAULT;
        assert_eq!(settings.accept(true), Ok(()));
        assert_ne!(settings, Settings::DEFAULT);
        assert!(judged.is_of(&settings), "other marks");
        settings.learn([Alignment { reversed: true, ..Alignment::default() }; 2]);
        assert!(judged.is_of(&settings), "another alignment");
        settings.position_bandwidth += 1.0;
        assert!(!judged.is_of(&settings), "another loop");
    }
}
