//! Numbers with units, as people write them.

/// Prefixes of units, and what each multiplies by.
const PREFIXES: [(&str, f64); 8] = [
    ("", 1.0),
    ("u", 1e-6),
    ("\u{b5}", 1e-6),
    ("\u{3bc}", 1e-6),
    ("m", 1e-3),
    ("c", 1e-2),
    ("k", 1e3),
    ("M", 1e6),
];
/// Units that take prefixes.
const BASES: [&str; 9] = ["s", "m", "g", "Hz", "A", "V", "ohm", "H", "Wb"];
/// Other words for units, and for how many of the unit beside them each stands.
const ALIASES: [(&str, &str, f64); 6] = [
    ("\u{b0}", "deg", 1.0),
    ("degree", "deg", 1.0),
    ("degrees", "deg", 1.0),
    ("rad", "deg", 180.0 / std::f64::consts::PI),
    ("\u{3a9}", "ohm", 1.0),
    ("\u{2126}", "ohm", 1.0),
];
/// Words for the two positions of a switch.
const POSITIONS: [(&str, f64); 6] =
    [("on", 1.0), ("off", 0.0), ("true", 1.0), ("false", 0.0), ("yes", 1.0), ("no", 0.0)];

/// Reads a number in `unit`, which may be written behind it, also with another prefix: `400ms` is 0.4 in `s`. A plain number
/// (`unit` is `1`) may be the position of a switch: `on` is 1.
///
/// # Errors
/// When it is no finite number, or in another unit.
pub fn in_unit(text: &str, unit: &str) -> Result<f64, String> {
    let trimmed = text.trim();
    // The sign that tables and pages print is another than that of the keyboard.
    let number = |text: &str| {
        let text = text.trim().replace('\u{2212}', "-");
        text.parse::<f64>().ok().filter(|number| number.is_finite())
    };
    let position = || POSITIONS.iter().find(|it| it.0.eq_ignore_ascii_case(trimmed));
    let scaled = || {
        // From behind: 1e3 is longer than 1.
        let ends = trimmed.char_indices().rev();
        let (value, word) =
            ends.map(|(end, _)| trimmed.split_at(end)).find(|it| number(it.0).is_some())?;
        Some(number(value)? * scale(word, unit)?)
    };
    let found = match unit {
        "1" => number(trimmed).or_else(|| Some(position()?.1)),
        _ => number(trimmed).or_else(scaled),
    };
    let of = if unit == "1" { String::new() } else { format!(" in {unit}") };
    let hint = if text.contains(',') { ": write a decimal point, and no comma" } else { "" };
    found.ok_or_else(|| format!("`{text}` is not a number{of}{hint}"))
}

/// Returns how many of `unit` this one is.
fn scale(word: &str, unit: &str) -> Option<f64> {
    let plain = |text: &str| -> String {
        text.chars()
            .filter(|it| !it.is_whitespace())
            .map(|it| if it == '\u{b2}' { '2' } else { it })
            .collect()
    };
    let (word, unit) = (plain(word), plain(unit));
    if word == unit {
        return Some(1.0);
    }
    let meant = |word: &str| ALIASES.iter().find(|(alias, ..)| *alias == word);
    if let Some((_, of, count)) = meant(&word) {
        return scale(of, &unit).map(|scale| scale * count);
    }
    if let Some((_, of, count)) = meant(&unit) {
        return scale(&word, of).map(|scale| scale / count);
    }
    let split = |unit: &str| {
        PREFIXES.iter().find_map(|(prefix, by)| {
            let base = unit.strip_prefix(prefix)?;
            BASES.contains(&base).then(|| (base.to_owned(), *by))
        })
    };
    let ((base, from), (same, to)) = (split(&word)?, split(&unit)?);
    (base == same).then(|| from / to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_may_have_its_unit_behind_it() {
        for (text, unit, value) in [
            ("400ms", "s", 0.4),
            ("0.4", "s", 0.4),
            ("0.4 s", "s", 0.4),
            ("50us", "us", 50.0),
            ("0.05 ms", "us", 50.0),
            ("30deg", "deg", 30.0),
            ("-30\u{b0}", "deg", -30.0),
            ("1500mA", "A", 1.5),
            ("1.5e3 mA", "A", 1.5),
            ("1kHz", "Hz", 1000.0),
            ("2.5ohm", "ohm", 2.5),
            ("900 deg/s", "deg/s", 900.0),
            ("105 g cm2", "g cm2", 105.0),
            ("105 g cm\u{b2}", "g cm2", 105.0),
            ("1000\u{3bc}H", "mH", 1.0),
            ("1000\u{b5}H", "mH", 1.0),
            ("0.03 m", "mm", 30.0),
            ("30cm", "m", 0.3),
            ("\u{2212}30 Hz", "Hz", -30.0),
            ("30deg", "degrees", 30.0),
            ("30 degrees", "degrees", 30.0),
            ("on", "1", 1.0),
            ("Off", "1", 0.0),
            ("7", "1", 7.0),
        ] {
            let found = in_unit(text, unit).unwrap();
            assert!((found - value).abs() < 1e-9, "{text}: {found}");
        }
        assert!((in_unit("1rad", "deg").unwrap() - 57.295_779_513).abs() < 1e-6);
    }

    #[test]
    fn what_is_in_another_unit_is_no_number() {
        for (text, unit) in [
            ("400ms", "A"),
            ("30deg", "Hz"),
            ("on", "A"),
            ("2A", "1"),
            ("", "s"),
            ("s", "s"),
            ("NaN", "s"),
            ("infs", "s"),
            ("1.2.3 s", "s"),
            ("2,6", "A"),
            ("1,500 mA", "mA"),
            ("5 S", "s"),
            ("5MS", "s"),
        ] {
            let refused = in_unit(text, unit).unwrap_err();
            let is_hinted = refused.contains("decimal point") == text.contains(',');
            assert!(
                refused.contains(&format!("`{text}`")) && is_hinted,
                "{text} {unit}: {refused}"
            );
        }
    }
}
