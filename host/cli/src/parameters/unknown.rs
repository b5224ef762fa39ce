//! A name that no setting has.

use flix_shell::suggestion::nearest;

/// Returns that there is no such setting, and which may be meant.
pub(super) fn no_setting<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let meant =
        nearest(name, known).map_or_else(|| ";".to_owned(), |it| format!(", did you mean `{it}`?"));
    format!("the robot has no setting `{name}`{meant} `flix parameters list` shows all names")
}
