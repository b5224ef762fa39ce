//! What somebody may have meant by a word that is not known.

/// Likeness from which a word is taken for the one that was meant: as clap takes it for options.
const ALIKE: f64 = 0.7;

/// Shortest part of a word by which the whole is found, letters.
const PART: usize = 3;

/// Returns the known word that has this one as a part, or else the one that is most like it, where one is like it.
pub fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase().replace('-', "_");
    let is_part = |it: &str| word.len() >= PART && it.split('_').any(|part| part == word);
    known
        .map(|it| (if is_part(it) { 1.0 } else { strsim::jaro_winkler(&word, it) }, it))
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
        assert_eq!(find("age"), Some("command_age"));
        assert_eq!(find("xyz"), None);
    }
}
