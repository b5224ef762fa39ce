//! Every command of README.md and firmware/README.md, in their order, as it is typed, in a fresh home.
//!
//! A folder that is alone on the PATH has `cargo` and `flix`, both this program under another name: `cargo run` starts
//! the program of this build that it names. A line `serve` goes on in a terminal of its own until the next one, as the
//! README says, `teleop` gets a terminal and is left by its key, and `cockpit` is ended once it serves. A comment "short: `OPTIONS`" names the form in which
//! a long run is tried here. What needs hardware or a network is compared with the aliases and tasks that there are.
//! Every other command in the running text of the documentation has to be one that the programs take.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::collections::HashSet;
use std::fs::File;
use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use clap::error::ErrorKind;
use flix_host::nav::PlanarPose;
use flix_host::record::Run;
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Longest time that one command may take: a hang, not slowness.
const PATIENCE: Duration = Duration::from_secs(300);
/// How often a command is tried while the machine is too busy for a robot in real time.
const ATTEMPTS: u32 = 5;
/// What `serve` prints once its robot answers.
const SERVES: &str = "Ctrl-C switches it off";
/// What `serve` complains of when it loses real time.
const TOO_BUSY: &str = "too busy for real time";
/// What the screen of `teleop` shows.
const SCREEN: &str = "leave";
/// What `cockpit` prints.
const PAGE: &str = "open http://";
/// Distance from its start within which `identify` keeps the robot, and to which it brings it back, m.
const IDENTIFIED_WITHIN: (f64, f64) = (1.0, 0.15);
/// The first command of the README in full.
const DEMO: &str = "cargo run --release -- demo";
/// Commands that build for hardware, ask the network, or are what runs this test.
const NOT_HERE: [&str; 7] = [
    "cargo xtask",
    "cargo flash-",
    "cargo install",
    "cargo test",
    "cargo doc",
    "cargo bench",
    "python3 -m pip",
];

fn main() -> ExitCode {
    let name = std::env::args_os().next().map(PathBuf::from).unwrap_or_default();
    match name.file_name().and_then(|name| name.to_str()) {
        Some("flix") => return flix_cli::main(),
        Some("cargo") => return cargo(std::env::args().skip(1).collect()),
        _ => {}
    }
    let asked: Vec<String> =
        std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    if !asked.is_empty() && !asked.iter().any(|word| "readme".contains(word.as_str())) {
        return ExitCode::SUCCESS;
    }
    let pages = [
        "README.md",
        "firmware/README.md",
        "SECURITY.md",
        "CONTRIBUTING.md",
        "sim-hil/docs/paper.md",
    ];
    for page in pages {
        text_names_commands(page, &read(page));
    }
    let home = tempfile::tempdir().unwrap();
    let mut session = Session::new(home.path());
    for page in ["README.md", "firmware/README.md"] {
        for section in commands(&read(page)) {
            section.iter().for_each(|line| session.run(line));
            session.end_serving();
        }
    }
    assert!(session.done.len() > 30, "the commands are not found");
    println!("readme: {} commands", session.done.len());
    ExitCode::SUCCESS
}

/// Stands in for cargo: starts the program of this build that a `run` names.
fn cargo(words: Vec<String>) -> ExitCode {
    let is_alias = words.first().is_some_and(|word| ["flix", "sim"].contains(&word.as_str()));
    let (options, arguments) = match words.iter().position(|word| word == "--") {
        _ if is_alias => (&words[..1], &words[1..]),
        Some(end) => (&words[..end], &words[end + 1..]),
        None => (&words[..], &[][..]),
    };
    let program = match options.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["run", "--release"] => env!("CARGO_BIN_EXE_flix-sim"),
        ["flix", ..] => "flix",
        ["sim", ..] => env!("CARGO_BIN_EXE_flix-sim"),
        _ => {
            eprintln!("cargo: the README test does not know {options:?}");
            return ExitCode::from(101);
        }
    };
    let error = Command::new(program).args(arguments).exec();
    eprintln!("cargo: {program}: {error}");
    ExitCode::from(101)
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn read(page: &str) -> String {
    std::fs::read_to_string(root().join(page)).unwrap()
}

/// Returns the lines of the blocks of code of each section, but for diagrams.
fn commands(page: &str) -> Vec<Vec<String>> {
    let code = |section: &str| {
        let lines = section.lines().filter_map(|line| line.strip_prefix("    "));
        lines.filter(|line| !line.contains(" -> ")).map(|line| line.trim().to_owned()).collect()
    };
    page.split("\n## ").map(code).collect()
}

/// Returns the command in the form in which it is tried: without its comment, in the short form that this names.
fn short(line: &str) -> String {
    let (command, comment) = line.split_once(" #").unwrap_or((line, ""));
    let mut words: Vec<&str> = command.split_whitespace().collect();
    let short = comment.split_once("short: `").and_then(|(_, rest)| rest.split('`').next());
    let options: Vec<&str> = short.into_iter().flat_map(str::split_whitespace).collect();
    for option in options.iter().filter(|option| option.starts_with("--")) {
        if let Some(at) = words.iter().position(|word| word == option) {
            words.drain(at..at + 2);
        }
    }
    words.extend(options);
    words.join(" ")
}

/// Checks the commands in running text, such as `flix status NAME`: program, subcommand and options.
fn text_names_commands(page: &str, text: &str) {
    let text = text.lines().filter(|line| !line.starts_with("    ")).collect::<Vec<_>>().join(" ");
    for span in text.split('`').skip(1).step_by(2) {
        let words: Vec<&str> = span.split_whitespace().collect();
        let (program, words) = match words[..] {
            ["flix", ..] => (flix_cli::Cli::description(), &words[..]),
            ["flix-sim", ..] => (flix_sim_cli::Cli::description(), &words[..]),
            ["cargo", "run", "--release", "--", ..] => {
                (flix_sim_cli::Cli::description(), &words[3..])
            }
            _ => continue,
        };
        let Err(error) = program.try_get_matches_from(words) else { continue };
        let is_a_name_or_help = matches!(
            error.kind(),
            ErrorKind::DisplayHelp
                | ErrorKind::MissingRequiredArgument
                | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
                | ErrorKind::MissingSubcommand
        );
        assert!(is_a_name_or_help, "{page}: `{span}`: {error}");
    }
}

/// Somebody who types what the README says.
struct Session {
    home: PathBuf,
    path: PathBuf,
    done: HashSet<String>,
    robot: Option<Program>,
    /// Nobody else serves a robot at the port of the README meanwhile.
    _port: File,
}

impl Session {
    fn new(home: &Path) -> Self {
        let path = home.join("bin");
        std::fs::create_dir(&path).unwrap();
        let me = std::env::current_exe().unwrap();
        for name in ["cargo", "flix"] {
            symlink(&me, path.join(name)).unwrap();
        }
        let port = File::create(std::env::temp_dir().join("flix-readme.lock")).unwrap();
        port.lock().unwrap();
        Self { home: home.to_owned(), path, done: HashSet::new(), robot: None, _port: port }
    }

    fn run(&mut self, line: &str) {
        let command = short(line);
        if !self.done.insert(command.clone()) && !command.contains(" serve") {
            return;
        }
        // What a bare `run` does.
        self.done.insert(DEMO.to_owned());
        if NOT_HERE.iter().any(|prefix| command.starts_with(prefix)) || command.contains("target/")
        {
            return exists(&command);
        }
        let begun = Instant::now();
        if command.contains(" serve") {
            self.end_serving();
            let robot = self.start(&command, Stdio::null());
            robot.wait_for(SERVES);
            self.robot = Some(robot);
        } else if command.contains(" cockpit") {
            let page = self.start(&command, Stdio::null());
            page.wait_for(PAGE);
            interrupt(page);
        } else if command.contains(" teleop") {
            self.at_a_terminal(&command);
        } else {
            self.until_it_works(&command);
        }
        if command.contains(" identify") {
            self.identified_near_its_start();
        }
        println!("{:7.1} s  {command}", begun.elapsed().as_secs_f64());
    }

    /// A robot in real time that lost time to other programs is no reason to fail.
    fn until_it_works(&self, command: &str) {
        for attempt in 1.. {
            let missed = self.missed();
            let mut program = self.start(command, Stdio::null());
            let code = program.end();
            if code == Some(0) {
                return;
            }
            let again = self.missed() > missed && attempt < ATTEMPTS;
            assert!(again, "`{command}` ended with {code:?}:\n{}", program.output());
            self.start("flix clear", Stdio::null()).end();
        }
    }

    fn missed(&self) -> usize {
        self.robot.as_ref().map_or(0, |robot| robot.output().matches(TOO_BUSY).count())
    }

    fn at_a_terminal(&self, command: &str) {
        let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&terminal).unwrap();
        unlockpt(&terminal).unwrap();
        let name = ptsname(&terminal, Vec::new()).unwrap().into_string().unwrap();
        let slave = File::options().read(true).write(true).open(name).unwrap();
        rustix::termios::tcsetwinsize(
            &slave,
            rustix::termios::Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 },
        )
        .unwrap();
        let mut keys = File::from(terminal);
        let mut program = self.spawn(command, slave.try_clone().unwrap().into(), slave.into());
        program.listen(keys.try_clone().unwrap());
        program.wait_for(SCREEN);
        keys.write_all(b"\x1b").unwrap();
        assert_eq!(program.end(), Some(0), "`{command}`:\n{}", program.output());
    }

    fn start(&self, command: &str, stdin: Stdio) -> Program {
        let mut program = self.spawn(command, stdin, Stdio::piped());
        let stdout = program.child.stdout.take().unwrap();
        program.listen(stdout);
        program
    }

    fn spawn(&self, command: &str, stdin: Stdio, stdout: Stdio) -> Program {
        let mut shell = Command::new("/bin/sh");
        shell.arg("-c").arg(format!("exec {command}")).current_dir(&self.home);
        shell.env_clear().env("HOME", &self.home).env("PATH", &self.path).env("TERM", "xterm");
        let mut child = shell.stdin(stdin).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap();
        let stderr = child.stderr.take().unwrap();
        let mut program = Program { command: command.to_owned(), child, said: Arc::default() };
        program.listen(stderr);
        program
    }

    fn end_serving(&mut self) {
        if let Some(robot) = self.robot.take() {
            interrupt(robot);
        }
    }

    fn identified_near_its_start(&self) {
        let run = Run::find(&self.home.join("out"), "last").unwrap();
        let poses: Vec<PlanarPose> = run
            .poses
            .iter()
            .filter(|pose| pose.valid)
            .map(|pose| pose.pose.on_the_floor())
            .collect();
        let start = poses[0].position();
        let farthest = poses.iter().map(|pose| pose.distance_to(start)).fold(0.0, f64::max);
        let last = poses.last().unwrap().distance_to(start);
        let (reach, back) = IDENTIFIED_WITHIN;
        assert!(farthest < reach && last < back, "{farthest} m away, {last} m at last");
    }
}

/// A running program, and what it has said so far.
struct Program {
    command: String,
    child: Child,
    said: Arc<(Mutex<String>, Condvar)>,
}

impl Program {
    fn listen(&mut self, mut from: impl std::io::Read + Send + 'static) {
        let said = Arc::clone(&self.said);
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            // A terminal whose program has ended is an error to read.
            while let Ok(length @ 1..) = from.read(&mut bytes) {
                said.0.lock().unwrap().push_str(&String::from_utf8_lossy(&bytes[..length]));
                said.1.notify_all();
            }
        });
    }

    fn output(&self) -> String {
        self.said.0.lock().unwrap().clone()
    }

    fn wait_for(&self, text: &str) {
        let said = self.said.0.lock().unwrap();
        let (said, waited) =
            self.said.1.wait_timeout_while(said, PATIENCE, |said| !said.contains(text)).unwrap();
        assert!(!waited.timed_out(), "`{}` does not print {text:?}:\n{said}", self.command);
    }

    /// Waits for its end; a program that hangs is killed.
    fn end(&mut self) -> Option<i32> {
        let pid = Pid::from_child(&self.child);
        let (ended, is_over) = std::sync::mpsc::channel::<()>();
        let watch = std::thread::spawn(move || {
            if is_over
                .recv_timeout(PATIENCE)
                .is_err_and(|it| it == std::sync::mpsc::RecvTimeoutError::Timeout)
            {
                let _ = kill_process(pid, Signal::KILL);
            }
        });
        let code = self.child.wait().unwrap().code();
        drop(ended);
        watch.join().unwrap();
        code
    }
}

impl Drop for Program {
    /// A test that fails leaves no robot behind at the port of the README.
    fn drop(&mut self) {
        // One that has ended already is none to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Ends a program as Ctrl-C does.
fn interrupt(mut program: Program) {
    kill_process(Pid::from_child(&program.child), Signal::INT).unwrap();
    assert_eq!(program.end(), Some(0), "`{}`:\n{}", program.command, program.output());
}

/// Returns the name of the variant that clap reads as `task`.
fn variant(task: &str) -> String {
    task.split('-').map(|word| word[..1].to_uppercase() + &word[1..]).collect()
}

/// What cannot be run here has to exist at least: the alias, the task, the crate.
fn exists(command: &str) {
    let words: Vec<&str> = command.split_whitespace().collect();
    let (file, text) = match words[..] {
        ["cargo", "xtask", task, ..] => {
            ("firmware/xtask/src/main.rs", format!("Task::{}", variant(task)))
        }
        ["cargo", alias, ..] if alias.starts_with("flash-") => {
            (".cargo/config.toml", format!("{alias} = "))
        }
        ["cargo", "install", "--locked", "--path", folder, ..] => {
            return assert!(root().join(folder).join("Cargo.toml").exists());
        }
        ["cargo", "run", "--release", "-p", "flix-chip", ..] => {
            ("sim-hil/chip/Cargo.toml", "\"flix-chip\"".to_owned())
        }
        _ => return,
    };
    assert!(read(file).contains(&text), "`{command}`: {file} has no {text}");
}
