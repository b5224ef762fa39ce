//! tmux and GNU screen keep a program running when nobody looks at its terminal any more: they say whether somebody does.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the terminal of this program is inside of.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Multiplexer {
    /// tmux, with the name of this pane.
    Tmux(OsString),
    /// GNU screen, with the places where the socket of this session may be.
    Screen(Vec<PathBuf>),
}

impl Multiplexer {
    /// Returns the one around this program.
    pub(super) fn around() -> Option<Self> {
        Self::of(|name| std::env::var_os(name))
    }

    fn of(variable: impl Fn(&str) -> Option<OsString>) -> Option<Self> {
        if variable("TMUX").is_some() {
            return variable("TMUX_PANE").map(Self::Tmux);
        }
        let session = variable("STY").filter(|session| !session.is_empty())?;
        let user = variable("USER").or_else(|| variable("LOGNAME")).unwrap_or_default();
        let mut of_user = OsString::from("S-");
        of_user.push(user);
        let shared = ["/run/screen", "/var/run/screen", "/tmp/screens", "/tmp/uscreens"];
        let folders = variable("SCREENDIR")
            .map(PathBuf::from)
            .into_iter()
            .chain(shared.iter().map(|folder| Path::new(folder).join(&of_user)));
        let own = variable("HOME").map(|home| Path::new(&home).join(".screen"));
        Some(Self::Screen(folders.chain(own).map(|folder| folder.join(&session)).collect()))
    }

    /// Returns whether a terminal is attached that shows this program; nothing where that cannot be known.
    pub(super) fn is_attached(&self) -> Option<bool> {
        match self {
            Self::Tmux(pane) => {
                let asked = Command::new("tmux")
                    .args(["display-message", "-p", "-t"])
                    .arg(pane)
                    .arg("#{session_attached} #{window_active}")
                    .stdin(Stdio::null())
                    .stderr(Stdio::null())
                    .output()
                    .ok()?;
                shown(&String::from_utf8_lossy(&asked.stdout))
            }
            Self::Screen(sockets) => sockets.iter().find_map(|socket| is_executable(socket)),
        }
    }
}

/// Reads how many clients a tmux session has, and whether the window is the one that they show.
fn shown(answer: &str) -> Option<bool> {
    let (clients, active) = answer.trim().split_once(' ')?;
    Some(clients.parse::<u32>().ok()? > 0 && active.parse::<u32>().ok()? > 0)
}

/// Returns whether the owner may execute a file, by which screen marks the socket of an attached session.
#[cfg(unix)]
fn is_executable(file: &Path) -> Option<bool> {
    use std::os::unix::fs::PermissionsExt;
    let mode = std::fs::metadata(file).ok()?.permissions().mode();
    Some(mode & 0o100 != 0)
}

#[cfg(not(unix))]
fn is_executable(_: &Path) -> Option<bool> {
    None
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]
mod tests {
    use super::*;

    fn within(variables: &[(&str, &str)]) -> Option<Multiplexer> {
        Multiplexer::of(|wanted| {
            variables.iter().find(|(name, _)| *name == wanted).map(|(_, value)| value.into())
        })
    }

    #[test]
    fn a_plain_terminal_is_inside_of_nothing() {
        assert_eq!(within(&[]), None);
        assert_eq!(within(&[("STY", ""), ("TERM", "xterm")]), None);
    }

    #[test]
    fn tmux_is_asked_for_the_pane_of_this_program() {
        let tmux =
            within(&[("TMUX", "/tmp/tmux-0/default,7,0"), ("TMUX_PANE", "%3"), ("STY", "1.a")]);
        assert_eq!(tmux, Some(Multiplexer::Tmux("%3".into())));
        for (answer, shows) in [
            ("1 1\n", Some(true)),
            ("2 1\n", Some(true)),
            ("0 1\n", Some(false)),
            ("1 0\n", Some(false)),
            ("", None),
            ("can't find pane: %3", None),
        ] {
            assert_eq!(shown(answer), shows, "{answer:?}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_socket_of_screen_is_executable_while_somebody_is_attached() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("123.pts-0.desk");
        let folder = folder.path().to_str().unwrap();
        let screen = within(&[("STY", "123.pts-0.desk"), ("SCREENDIR", folder)]).unwrap();
        assert_eq!(screen.is_attached(), None, "there is no socket");
        std::fs::write(&socket, "").unwrap();
        for (mode, is_attached) in [(0o700, true), (0o600, false)] {
            std::fs::set_permissions(&socket, std::fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(screen.is_attached(), Some(is_attached));
        }
        let elsewhere =
            within(&[("STY", "123.pts-0.desk"), ("USER", "ada"), ("HOME", "/home/ada")]);
        let Some(Multiplexer::Screen(places)) = elsewhere else { panic!("{elsewhere:?}") };
        assert!(places.contains(&"/run/screen/S-ada/123.pts-0.desk".into()), "{places:?}");
    }
}
