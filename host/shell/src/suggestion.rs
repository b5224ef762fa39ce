//! What somebody may have meant by a word that is not known.

/// Likeness from which a word is taken for the one that was meant: as clap takes it for options.
const ALIKE: f64 = 0.7;

/// Returns the known word that is most like this one, where one is like it.
pub fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase().replace('-', "_");
    known
        .map(|it| (strsim::jaro_winkler(&word, it), it))
        .filter(|(likeness, _)| *likeness >= ALIKE)
        .max_by(|one, other| one.0.total_cmp(&other.0))
        .map(|(_, it)| it)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_of_the_finger_is_recognised_and_another_word_is_not() {
        let known = ["current_limit", "over_current", "command_age", "telemetry_rate"];
        let find = |word| nearest(word, known.into_iter());
        assert_eq!(find("curent_limit"), Some("current_limit"));
        assert_eq!(find("Current-Limit"), Some("current_limit"));
        assert_eq!(find("telemetry_rat"), Some("telemetry_rate"));
        assert_eq!(find("xyz"), None);
    }
}
