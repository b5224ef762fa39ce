//! The mode tables of the shipped models, which a navigator needs.

use flix_host::nav::ModeTable;

use crate::model::{STRANGERS, STRANGERS_PLAN};

/// The mode tables that come with models: learnt on them by `flix-sim identify`.
const TABLES: [(&str, &str); 3] = [
    ("W", include_str!("../../models/W.modes.toml")),
    ("calibrated", include_str!("../../models/calibrated.modes.toml")),
    ("flix", include_str!("../../models/flix.modes.toml")),
];

/// Reads the table of a shipped model, learnt on it.
///
/// # Errors
/// When the model has none; the sentence says how to learn one.
pub fn shipped_table(model: &str) -> Result<ModeTable, String> {
    // A stranger is a changed W, and known as W.
    let known = if model.starts_with(STRANGERS) { STRANGERS_PLAN } else { model };
    let Some((_, table)) = TABLES.iter().find(|(name, _)| *name == known) else {
        return Err(format!(
            "model {model} has no mode table: learn one with \
             `flix-sim identify --model {model} --modes FILE` and name it with --modes"
        ));
    };
    ModeTable::from_toml(table).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_table_is_that_of_its_model_and_a_model_without_one_is_told_how() {
        for (model, _) in TABLES {
            assert_eq!(shipped_table(model).unwrap().robot, model);
        }
        assert!(shipped_table("A").unwrap_err().contains("flix-sim identify --model A"));
    }
}
