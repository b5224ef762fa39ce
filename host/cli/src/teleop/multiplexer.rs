//! tmux, GNU screen and zellij keep a program running after its terminal is detached, and state whether one is attached. mosh and
//! editors keep it running too, answer in the terminal's place, and state nothing: the names of the processes above tell them. dtach and abduco pass questions on to the terminal, and need no more than that its answers stay away.
//!
//! A terminal that is attached to tmux may itself be inside of another tmux, or of mosh. Where the system shows with what variables
//! a process was started (Linux), that one is asked as well.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the terminal of this program is inside of.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Multiplexer {
    /// tmux, with its variable that names the server, and the name of this pane.
    Tmux(OsString, OsString),
    /// GNU screen, with the places where the socket of this session may be, its name, and the number of this window.
    Screen(Vec<PathBuf>, OsString, Option<String>),
    /// zellij, with the name of this pane.
    Zellij(String),
    /// Another that answers in the terminal's place.
    Silent,
}

impl Multiplexer {
    /// Returns the one around this program.
    pub(super) fn around() -> Option<Self> {
        Self::of(|name| std::env::var_os(name)).or_else(|| around(&std::process::id().to_string()))
    }

    fn of(variable: impl Fn(&str) -> Option<OsString>) -> Option<Self> {
        if let Some(server) = variable("TMUX").filter(|server| !server.is_empty()) {
            return Some(Self::Tmux(server, variable("TMUX_PANE")?));
        }
        if let Some(pane) = variable("ZELLIJ_PANE_ID").filter(|pane| !pane.is_empty()) {
            return Some(Self::Zellij(format!("terminal_{}", pane.to_string_lossy())));
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
        let sockets = folders.chain(own).map(|folder| folder.join(&session)).collect();
        let window = variable("WINDOW").and_then(|window| window.into_string().ok());
        Some(Self::Screen(sockets, session, window))
    }

    /// Returns whether a terminal is attached that shows this program; nothing where that cannot be known.
    pub(super) fn is_attached(&self) -> Option<bool> {
        self.shows(None, MOST_NESTED)
    }

    /// Returns the same, and nothing where this terminal is not the one of the pane. Asks so many others around the terminals
    /// that are attached.
    fn shows(&self, terminal: Option<&str>, nested: u32) -> Option<bool> {
        match self {
            Self::Tmux(server, pane) => {
                let question = ["display-message", "-p", "-t", pane.to_str()?, PANE];
                let pane = Pane::read(&ask(server, &question)?)?;
                if terminal.is_some_and(|terminal| terminal != pane.terminal) {
                    return None;
                }
                if !pane.is_shown {
                    return Some(false);
                }
                let clients = ask(server, &["list-clients", "-F", CLIENT]).unwrap_or_default();
                let is_watched = |process: &str, terminal: &str| {
                    let outer = around(process).filter(|_| nested > 0);
                    outer.map_or(Some(true), |it| it.shows(Some(terminal), nested - 1))
                };
                any_of(&clients, &pane.window, is_watched)
            }
            Self::Screen(sockets, session, window) if terminal.is_none() => {
                match sockets.iter().find_map(|socket| is_executable(socket)) {
                    Some(false) => Some(false),
                    attached => window
                        .as_ref()
                        .and_then(|window| is_shown(&windows(session)?, window))
                        .or(attached),
                }
            }
            Self::Zellij(pane) if terminal.is_none() => has_client(&clients_of_zellij()?, pane),
            // They do not say which terminals they are around.
            Self::Screen(..) | Self::Zellij(_) | Self::Silent => None,
        }
    }
}

/// Beginnings of the names of programs that emulate a terminal and keep its session while none is attached.
const SILENT: [&str; 9] =
    ["mosh-server", "tmux", "screen", "zellij", "dvtm", "wezterm-mux", "emacs", "nvim", "vim"];
/// Most multiplexers inside of each other that are asked.
const MOST_NESTED: u32 = 3;
/// Most processes above one that are looked at: shells, and what runs them.
const MOST_ANCESTORS: u32 = 8;
/// What is asked of tmux: how many terminals are attached to the session, and whether its window is the one that they show;
/// whether something of tmux has its keys, as its copy mode, and whether they go to this pane of the window; the window and the
/// terminal of the pane. Of tmux 3.1 and later also how many terminals show the window: sessions may share it.
const PANE: &str = "#{session_attached} #{window_active} #{pane_in_mode} #{pane_active} #{window_id} #{pane_tty} \
                    #{window_active_clients}";
/// What is asked about each terminal that is attached: the window that it shows, its process and its name; of tmux 3.2 and later
/// also whether it is suspended or locked, so that another program has its keys.
const CLIENT: &str = "#{window_id} #{client_pid} #{client_tty} #{client_flags}";

/// A pane of tmux.
#[derive(Debug, Default, PartialEq, Eq)]
struct Pane {
    /// Whether an attached terminal shows it, and its keys go to it.
    is_shown: bool,
    /// Its window.
    window: String,
    /// The terminal that it is.
    terminal: String,
}

impl Pane {
    fn read(answer: &str) -> Option<Self> {
        let words: Vec<&str> = answer.split_whitespace().collect();
        let number = |index: usize| words.get(index)?.parse::<u32>().ok();
        let word = |index: usize| words.get(index).map_or_else(String::new, ToString::to_string);
        let (attached, active) = (number(0)? > 0, number(1)? > 0);
        let is_hidden = number(2) > Some(0) || number(3) == Some(0);
        let is_shown = number(6).map_or(attached && active, |clients| clients > 0);
        Some(Self { is_shown: is_shown && !is_hidden, window: word(4), terminal: word(5) })
    }
}

/// Returns the answer of a tmux server.
fn ask(server: &OsString, question: &[&str]) -> Option<String> {
    let mut tmux = Command::new("tmux");
    tmux.args(question).env("TMUX", server).stdin(Stdio::null()).stderr(Stdio::null());
    Some(String::from_utf8_lossy(&tmux.output().ok()?.stdout).into_owned())
}

/// Returns which windows a session of screen says that it has.
fn windows(session: &OsString) -> Option<String> {
    let mut screen = Command::new("screen");
    screen.arg("-S").arg(session).args(["-Q", "windows"]).stdin(Stdio::null());
    let answer = screen.stderr(Stdio::null()).output().ok()?;
    answer.status.success().then(|| String::from_utf8_lossy(&answer.stdout).into_owned())
}

/// Returns which terminals are attached to the session of zellij around this program (0.42 and later).
fn clients_of_zellij() -> Option<String> {
    let mut zellij = Command::new("zellij");
    zellij.args(["action", "list-clients"]).stdin(Stdio::null()).stderr(Stdio::null());
    let answer = zellij.output().ok()?;
    answer.status.success().then(|| String::from_utf8_lossy(&answer.stdout).into_owned())
}

/// Returns whether one of zellij's terminals has its keys in this pane: a line for each below the heading, with number and pane.
fn has_client(clients: &str, pane: &str) -> Option<bool> {
    let mut lines = clients.lines();
    lines.next().filter(|heading| heading.starts_with("CLIENT_ID"))?;
    Some(lines.any(|line| line.split_whitespace().nth(1) == Some(pane)))
}

/// Returns whether a terminal shows one of the windows, as screen lists them: numbers with flags, and titles. `*` is the window
/// that the terminal shows, of several the first; `&` one that several show.
fn is_shown(windows: &str, window: &str) -> Option<bool> {
    let flags = windows.split("  ").find_map(|it| {
        let (number, _title) = it.split_once(' ')?;
        number.strip_prefix(window).filter(|flags| !flags.starts_with(char::is_numeric))
    })?;
    Some(flags.contains(['*', '&']))
}

/// Returns whether this is true of any process and terminal that show a window, and are not suspended; also where none is known.
/// Nothing where it is not known of one, and false of the others.
fn any_of(
    clients: &str,
    window: &str,
    is_true: impl Fn(&str, &str) -> Option<bool>,
) -> Option<bool> {
    let clients = clients.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        words.next().filter(|shown| *shown == window)?;
        Some((words.next()?, words.next()?, words.next().unwrap_or_default()))
    });
    let known: Vec<_> = clients
        .map(|(process, terminal, flags)| {
            let is_suspended = flags.split(',').any(|flag| flag == "suspended");
            if is_suspended { Some(false) } else { is_true(process, terminal) }
        })
        .collect();
    if known.is_empty() || known.contains(&Some(true)) {
        return Some(true);
    }
    known.into_iter().find(Option::is_none).unwrap_or(Some(false))
}

/// Returns what another process, or the nearest above it, is inside of; nothing where the system does not say so. Who starts
/// one tmux inside of another takes the variable away, and so does `sudo`.
fn around(process: &str) -> Option<Multiplexer> {
    let mut process = process.to_owned();
    for _ in 0..MOST_ANCESTORS {
        let variables = std::fs::read(Path::new("/proc").join(&process).join("environ"));
        let variables = variables.unwrap_or_default();
        let variables = String::from_utf8_lossy(&variables);
        let found = Multiplexer::of(|wanted| {
            let mut all = variables.split('\0').filter_map(|one| one.split_once('='));
            all.find(|(name, _)| *name == wanted).map(|(_, value)| value.into())
        });
        if found.is_some() {
            return found;
        }
        let above = above(&process)?;
        let name = name(&above)?.to_ascii_lowercase();
        if SILENT.iter().any(|silent| name.starts_with(silent)) {
            return Some(Multiplexer::Silent);
        }
        process = above;
    }
    None
}

/// Returns a property of a process, as Linux shows it, or `ps`.
fn property(process: &str, of_linux: &str, of_ps: &str) -> Option<String> {
    let status = std::fs::read_to_string(Path::new("/proc").join(process).join("status"));
    let text = status.map_or_else(
        |_| {
            let ps = Command::new("ps").args(["-o", of_ps, "-p", process]).output().ok()?;
            Some(String::from_utf8_lossy(&ps.stdout).trim().to_owned())
        },
        |status| {
            let line = status.lines().find_map(|line| line.strip_prefix(of_linux))?;
            Some(line.trim().to_owned())
        },
    );
    text.filter(|text| !text.is_empty())
}

/// Returns the process above another one.
fn above(process: &str) -> Option<String> {
    property(process, "PPid:", "ppid=")
}

/// Returns the name of a program that is running.
fn name(process: &str) -> Option<String> {
    let path = property(process, "Name:", "comm=")?;
    Some(path.rsplit('/').next().unwrap_or_default().to_owned())
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
        let server = "/tmp/tmux-0/default,7,0";
        assert_eq!(tmux, Some(Multiplexer::Tmux(server.into(), "%3".into())));
        for (answer, shows) in [
            // Older than 3.1.
            ("1 1 0 1 @0 /dev/pts/3 \n", Some(true)),
            ("2 1 0 1 @0 /dev/pts/3 \n", Some(true)),
            ("0 1 0 1 @0 /dev/pts/3 \n", Some(false)),
            ("1 0 0 1 @0 /dev/pts/3 \n", Some(false)),
            ("1 1 0 1 @0 /dev/pts/3 1\n", Some(true)),
            ("0 1 0 1 @0 /dev/pts/3 0\n", Some(false)),
            // Another session shows the same window, or this one shows another.
            ("0 1 0 1 @0 /dev/pts/3 1\n", Some(true)),
            ("1 0 0 1 @0 /dev/pts/3 0\n", Some(false)),
            // Another pane has the keys, or tmux itself, in the older form as well.
            ("1 1 0 0 @0 /dev/pts/3 1\n", Some(false)),
            ("1 1 1 1 @0 /dev/pts/3 1\n", Some(false)),
            ("1 1 2 1 @0 /dev/pts/3 \n", Some(false)),
            ("", None),
            ("can't find pane: %3", None),
        ] {
            let pane = shows.map(|is_shown| Pane {
                is_shown,
                window: "@0".to_owned(),
                terminal: "/dev/pts/3".to_owned(),
            });
            assert_eq!(Pane::read(answer), pane, "{answer:?}");
        }
    }

    #[test]
    fn zellij_is_asked_for_terminals_that_have_their_keys_in_this_pane() {
        let zellij = within(&[("ZELLIJ", "0"), ("ZELLIJ_PANE_ID", "3"), ("STY", "1.a")]);
        assert_eq!(zellij, Some(Multiplexer::Zellij("terminal_3".to_owned())));
        let heading = "CLIENT_ID ZELLIJ_PANE_ID RUNNING_COMMAND";
        for (clients, shown) in [
            ("", Some(false)),
            ("1         terminal_3     flix teleop", Some(true)),
            ("1         terminal_33    flix teleop", Some(false)),
            ("2         plugin_2       zellij:session-manager", Some(false)),
            ("1         terminal_4     vim terminal_3\n2 terminal_3 N/A", Some(true)),
        ] {
            let answer = format!("{heading}\n{clients}\n");
            assert_eq!(has_client(&answer, "terminal_3"), shown, "{clients}");
        }
        // Older than the question.
        assert_eq!(has_client("", "terminal_3"), None);
    }

    #[test]
    fn a_window_is_watched_where_one_of_its_terminals_is() {
        let clients = "@0 812 /dev/pts/1\n@0 813 /dev/pts/2 attached,UTF-8\n@1 814 /dev/pts/5\n\
                       @0 815 /dev/pts/6 attached,focused,suspended\n@3 816 /dev/pts/7 suspended";
        for (window, watched, expected) in [
            ("@0", ("812", "/dev/pts/1"), true),
            ("@0", ("813", "/dev/pts/2"), true),
            ("@0", ("814", "/dev/pts/5"), false),
            ("@0", ("815", "/dev/pts/6"), false),
            ("@3", ("816", "/dev/pts/7"), false),
            ("@1", ("814", "/dev/pts/5"), true),
            ("@1", ("812", "/dev/pts/1"), false),
            ("@2", ("none", "none"), true),
        ] {
            let is_watched = |process: &str, terminal: &str| Some((process, terminal) == watched);
            assert_eq!(any_of(clients, window, is_watched), Some(expected), "{window} {watched:?}");
        }
        // Of one it is not known.
        for (watched, expected) in [("812", Some(true)), ("none", None)] {
            let is_watched =
                |process: &str, _: &str| (process != "813").then(|| process == watched);
            assert_eq!(any_of(clients, "@0", is_watched), expected, "{watched}");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_a_process_is_inside_of_is_read_from_the_processes_above_it() {
        use std::io::BufRead;
        let mut shell = Command::new("sh")
            .args(["-c", "TMUX= sleep 60 & echo $!; wait"])
            .env("TMUX", "/tmp/outer,1,0")
            .env("TMUX_PANE", "%7")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut process = String::new();
        std::io::BufReader::new(shell.stdout.take().unwrap()).read_line(&mut process).unwrap();
        let found = [process.trim(), &shell.id().to_string()].map(around);
        let ended = Command::new("kill").arg(process.trim()).status().unwrap();
        assert!(ended.success() && shell.wait().is_ok());
        for found in found {
            assert_eq!(found, Some(Multiplexer::Tmux("/tmp/outer,1,0".into(), "%7".into())));
        }
        assert_eq!(around("no process"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_answers_in_the_terminal_s_place_is_known_by_its_name() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        for (name, found) in [("mosh-server", Some(Multiplexer::Silent)), ("dtach", None)] {
            let program = folder.path().join(name);
            symlink("/bin/sh", &program).unwrap();
            let mut shell = Command::new(program)
                .args(["-c", "sh -c 'read line; true'; true"])
                .env_clear()
                .stdin(Stdio::piped())
                .spawn()
                .unwrap();
            let id = shell.id();
            let below = || {
                let children = format!("/proc/{id}/task/{id}/children");
                std::fs::read_to_string(children).unwrap().trim().to_owned()
            };
            while below().is_empty() {
                std::thread::yield_now();
            }
            let around = around(&below());
            drop(shell.stdin.take());
            shell.wait().unwrap();
            assert_eq!(around.filter(|it| *it == Multiplexer::Silent), found, "{name}");
        }
    }

    #[test]
    fn a_window_of_screen_is_watched_while_it_is_shown() {
        for (windows, shown) in [
            ("0* flix", Some(true)),
            ("0- flix  1* vi a  b", Some(false)),
            ("0*& flix  10 bash", Some(true)),
            ("00* a  10* bash", None),
            ("0 flix  1 bash", Some(false)),
            ("0&$ flix", Some(true)),
            ("", None),
        ] {
            assert_eq!(is_shown(windows, "0"), shown, "{windows}");
        }
        let screen = within(&[("STY", "1.a"), ("WINDOW", "3")]);
        assert!(matches!(screen, Some(Multiplexer::Screen(_, _, Some(window))) if window == "3"));
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
        let Some(Multiplexer::Screen(places, ..)) = elsewhere else { panic!("{elsewhere:?}") };
        assert!(places.contains(&"/run/screen/S-ada/123.pts-0.desk".into()), "{places:?}");
    }
}
