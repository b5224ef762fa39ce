//! Every command of the documents as it is typed, in their order, in a fresh home.
//!
//! A folder that is alone on the PATH has `cargo` and `flix`, both this program under another name: `cargo sim`, `cargo flix`
//! and `cargo run` start the program of this build that they name. A section of a page that serves a robot is typed line by
//! line in real time; a line `serve` goes on in a terminal of its own until the next one or the section's end, `teleop` gets
//! a terminal and is left by its key, and `cockpit` is ended once it serves. All other sections only compute: they are typed
//! beside, in a home of their own, at the lowest priority, so that they take no time from the robot. A comment "short:
//! `OPTIONS`" names the form in which a long run is tried here. What needs hardware or a network is compared with the
//! aliases and tasks that there are. Every other command in the documents has to be one that the programs take.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::collections::HashSet;
use std::fs::File;
use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use clap::error::ErrorKind;
use flix_host::nav::PlanarPose;
use flix_host::record::Run;
use rustix::process::{Pid, Signal, kill_process, setpriority_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// The pages whose commands are typed, in this order.
const PAGES: [&str; 11] = [
    "README.md",
    "host/docs/drive.md",
    "host/docs/track.md",
    "host/cli/README.md",
    "sim-hil/docs/simulate.md",
    "sim-hil/docs/your-own-robot.md",
    "sim-hil/docs/your-own-controller.md",
    "sim-hil/docs/study.md",
    "sim-hil/docs/reliability.md",
    "sim-hil/cli/README.md",
    "firmware/README.md",
];
/// What was true of earlier versions, and may name what is gone.
const HISTORY: &str = "CHANGELOG.md";
/// Folders that are not part of the repository.
const BUILT: [&str; 3] = ["target", "out", ".git"];
/// Most words of the front page: a screen and a half.
const FRONT_PAGE_WORDS: usize = 1100;
/// The two programs as they are typed inside the repository; `cargo` here knows them as these.
const ALIASES: [&str; 2] = [
    r#"flix = "run --release --package flix-cli --""#,
    r#"sim = "run --release --package flix-sim-cli --""#,
];
/// Longest time that one command may take: a hang, not slowness.
const PATIENCE: Duration = Duration::from_secs(3_600);
/// Priority of what only computes: the lowest.
const BESIDE: i32 = 19;
/// Options of features that are not built here.
const NOT_BUILT: [&str; 1] = ["--foxglove"];
/// How a block of commands begins; other blocks are files, programs, formats.
const TYPED: [&str; 3] = ["cargo ", "cp ", "python3 -m "];
/// What `serve` prints once its robot answers.
const SERVES: &str = "Ctrl-C switches it off";
/// What `serve` complains of when it loses real time.
const TOO_BUSY: &str = "too busy for real time";
/// What `doctor` rightly complains of on a machine that has no time for the robot.
const LOST_TIME: [&str; 3] = ["!!  clock", "!!  link", "poses per second are too few"];
/// What the screen of `teleop` shows.
const SCREEN: &str = "leave";
/// What `cockpit` prints.
const PAGE: &str = "open http://";
/// Distance from its start within which `identify` keeps the robot, and to which it brings it back, m.
const IDENTIFIED_WITHIN: (f64, f64) = (1.0, 0.15);
/// The first command of the front page, short and in full.
const DEMO: [&str; 2] = ["cargo run --release", "cargo sim demo"];
/// Commands that build for hardware, ask the network, or are what runs this test.
const NOT_HERE: [&str; 9] = [
    "cargo +esp",
    "cargo xtask",
    "cargo flash-",
    "cargo install",
    "cargo test",
    "cargo doc",
    "cargo bench",
    "cargo run --release -p flix-sim --example",
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
    for page in documents(&root()) {
        names_commands(&page);
    }
    front_page_is_short_and_names_all();
    let sections: Vec<Vec<String>> =
        PAGES.into_iter().flat_map(|page| commands(&read(page))).collect();
    let (driven, computed): (Vec<_>, Vec<_>) = sections
        .into_iter()
        .partition(|section| section.iter().any(|line| line.contains(" serve")));
    let home = tempfile::tempdir().unwrap();
    let failed = &AtomicBool::new(false);
    let typed = std::thread::scope(|scope| {
        // Nobody else serves a robot at the port of the documents meanwhile.
        let port = File::create(std::env::temp_dir().join("flix-readme.lock")).unwrap();
        port.lock().unwrap();
        let beside = scope.spawn({
            let home = home.path().join("beside");
            move || Session::new(&home, true, failed).type_all(&computed)
        });
        let driven = Session::new(&home.path().join("driven"), false, failed).type_all(&driven);
        driven + beside.join().unwrap()
    });
    assert!(typed > 50, "the commands are not found");
    println!("readme: {typed} commands");
    ExitCode::SUCCESS
}

/// Stands in for cargo: starts the program of this build that an alias or a `run` names.
fn cargo(words: Vec<String>) -> ExitCode {
    let [simulator, operator] = [env!("CARGO_BIN_EXE_flix-sim"), "flix"];
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let (program, arguments) = match words[..] {
        ["sim", ..] => (simulator, &words[1..]),
        ["flix", ..] => (operator, &words[1..]),
        ["run", "--release"] => (simulator, &[][..]),
        _ => {
            eprintln!("cargo: the test of the documents does not know {words:?}");
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

/// Returns the files below a folder that the repository has, by their path in it.
fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let ours = folders.iter().filter(|folder| BUILT.iter().all(|name| !folder.ends_with(name)));
    let own = files.iter().map(|file| file.strip_prefix(root()).unwrap().display().to_string());
    own.chain(ours.flat_map(|folder| self::files(folder))).collect()
}

fn documents(folder: &Path) -> Vec<String> {
    files(folder).into_iter().filter(|file| file.ends_with(".md") && file != HISTORY).collect()
}

/// Returns the commands of each section: the lines of its blocks of code that begin with one.
fn commands(page: &str) -> Vec<Vec<String>> {
    page.split("\n## ").map(|section| blocks(section).into_iter().flatten().collect()).collect()
}

fn blocks(section: &str) -> Vec<Vec<String>> {
    let lines: Vec<&str> = section.lines().collect();
    let blocks = lines.split(|line| !line.starts_with("    "));
    let is_typed = |block: &&[&str]| {
        block.first().is_some_and(|line| TYPED.iter().any(|it| line.trim_start().starts_with(it)))
    };
    let lines = |block: &[&str]| block.iter().map(|line| line.trim().to_owned()).collect();
    blocks.filter(is_typed).map(lines).collect()
}

fn front_page_is_short_and_names_all() {
    let page = read("README.md");
    let words = page.split_whitespace().count();
    assert!(words <= FRONT_PAGE_WORDS, "README.md has {words} words, {FRONT_PAGE_WORDS} at most");
    let config = read(".cargo/config.toml");
    assert!(
        ALIASES.iter().all(|alias| config.contains(alias)),
        ".cargo/config.toml lacks an alias of {ALIASES:?}"
    );
    for program in [flix_cli::Cli::description(), flix_sim_cli::Cli::description()] {
        let row = format!("| `{}` |", program.get_name());
        let row = page.lines().find(|line| line.contains(&row)).unwrap();
        for command in program.get_subcommands().filter(|command| !command.is_hide_set()) {
            let name = format!("`{}`", command.get_name());
            assert!(
                row.contains(&name),
                "README.md: the row of {} lacks {name}",
                program.get_name()
            );
        }
    }
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

/// Checks the commands that a page names without having them typed: in running text, such as `flix status NAME`, and as
/// lines of code of pages that state how a result came about. Pages with lines for `cargo` are typed.
fn names_commands(page: &str) {
    let text = read(page);
    let (code, prose): (Vec<&str>, Vec<&str>) =
        text.lines().partition(|line| line.starts_with("    "));
    let prose = prose.join(" ");
    prose.split('`').skip(1).step_by(2).for_each(|span| is_known(page, span));
    if PAGES.contains(&page) {
        return;
    }
    let code: Vec<&str> = code.into_iter().filter(|line| !line.contains(" -> ")).collect();
    code.iter().for_each(|line| is_known(page, line));
    let is_typed = code.iter().any(|line| line.trim_start().starts_with("cargo "));
    assert!(!is_typed, "{page} has commands, and nobody types them: add it to PAGES");
}

/// Checks one command: program, subcommand and options, or package and test.
fn is_known(page: &str, line: &str) {
    // What stands in brackets may be given.
    let line = line.split(" #").next().unwrap_or(line).replace(['[', ']'], "");
    let is_variable = |word: &&str| word.split_once('=').is_some_and(|(name, _)| is_capital(name));
    let words = line.split_whitespace().skip_while(is_variable);
    let words = words.filter(|word| !NOT_BUILT.contains(word));
    // A letter stands for a number.
    let words: Vec<&str> =
        words.map(|word| if word.len() == 1 && is_capital(word) { "1" } else { word }).collect();
    let after = |option: &str| words.iter().position(|word| *word == option);
    let (program, from) = match words[..] {
        ["flix", ..] => (flix_cli::Cli::description(), 0),
        ["flix-sim", ..] => (flix_sim_cli::Cli::description(), 0),
        ["cargo", "flix", ..] => (flix_cli::Cli::description(), 1),
        ["cargo", "sim", ..] => (flix_sim_cli::Cli::description(), 1),
        ["cargo", "run", ..] => match (after("flix-cli"), after("--")) {
            (Some(_), Some(end)) => (flix_cli::Cli::description(), end),
            (None, Some(end)) => (flix_sim_cli::Cli::description(), end),
            _ => return,
        },
        ["cargo", "test" | "bench", ..] => return has_target(page, &words),
        _ => return,
    };
    let Err(error) = program.try_get_matches_from(&words[from..]) else { return };
    let is_a_name_or_help = matches!(
        error.kind(),
        ErrorKind::DisplayHelp
            | ErrorKind::DisplayVersion
            | ErrorKind::MissingRequiredArgument
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
            | ErrorKind::MissingSubcommand
    );
    assert!(is_a_name_or_help, "{page}: `{line}`: {error}");
}

fn is_capital(word: &str) -> bool {
    !word.is_empty() && word.chars().all(|letter| letter.is_ascii_uppercase() || letter == '_')
}

/// Checks that the package of a test or a bench has it.
fn has_target(page: &str, words: &[&str]) {
    let after = |options: &[&str]| {
        words.windows(2).find(|pair| options.contains(&pair[0])).map(|pair| pair[1])
    };
    let Some(package) = after(&["-p", "--package"]) else { return };
    let names = |name: &str| format!("name = \"{name}\"");
    let manifests = files(&root()).into_iter().filter(|file| file.ends_with("Cargo.toml"));
    let manifest = manifests.map(|file| read(&file)).find(|text| text.contains(&names(package)));
    let Some(manifest) = manifest else { panic!("{page}: `{}`: no such package", words.join(" ")) };
    if let Some(target) = after(&["--test", "--bench"]) {
        assert!(manifest.contains(&names(target)), "{page}: {package} has no {target}");
    }
}

/// Somebody who types what the documents say.
struct Session<'a> {
    home: PathBuf,
    path: PathBuf,
    done: HashSet<String>,
    robot: Option<Program>,
    /// Nothing here waits for a clock: the other session goes first.
    is_beside: bool,
    /// One of the sessions has failed.
    failed: &'a AtomicBool,
}

impl<'a> Session<'a> {
    fn new(home: &Path, is_beside: bool, failed: &'a AtomicBool) -> Self {
        let path = home.join("bin");
        std::fs::create_dir_all(&path).unwrap();
        let me = std::env::current_exe().unwrap();
        for name in ["cargo", "flix"] {
            symlink(&me, path.join(name)).unwrap();
        }
        symlink(interpreter(), path.join("python3")).unwrap();
        symlink("/bin/cp", path.join("cp")).unwrap();
        // Commands are typed at the root of the repository, and leave nothing there.
        symlink(root().canonicalize().unwrap().join("sim-hil"), home.join("sim-hil")).unwrap();
        Self { home: home.to_owned(), path, done: HashSet::new(), robot: None, is_beside, failed }
    }

    /// Types these sections, and returns how many commands that were. Ends early when the other session has failed.
    fn type_all(mut self, sections: &[Vec<String>]) -> usize {
        for section in sections {
            // A robot is served for what is not typed yet.
            let is_new =
                |line: &String| !line.contains(" serve") && !self.done.contains(&short(line));
            if !section.iter().any(is_new) {
                continue;
            }
            for line in section {
                if self.failed.load(Ordering::Relaxed) {
                    return self.done.len();
                }
                self.run(line);
            }
            self.end_serving();
        }
        self.done.len()
    }

    fn run(&mut self, line: &str) {
        let command = short(line);
        if !self.done.insert(command.clone()) && !command.contains(" serve") {
            return;
        }
        if DEMO.contains(&command.as_str()) {
            self.done.extend(DEMO.map(str::to_owned));
        }
        if NOT_HERE.iter().any(|prefix| command.starts_with(prefix)) {
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
            self.works(&command);
        }
        if command.contains(" flix identify") {
            self.identified_near_its_start();
        }
        println!("{:7.1} s  {command}", begun.elapsed().as_secs_f64());
    }

    fn works(&self, command: &str) {
        let mut program = self.start(command, Stdio::null());
        let code = program.end();
        let output = program.output();
        let is_diagnosed = command.contains(" doctor") && {
            let mut complaints = output.lines().filter(|line| line.starts_with("!!")).peekable();
            complaints.peek().is_some()
                && complaints.all(|line| LOST_TIME.iter().any(|it| line.contains(it)))
        };
        let missed = self.robot.as_ref().map_or(0, |it| it.output().matches(TOO_BUSY).count());
        assert!(
            code == Some(0) || is_diagnosed,
            "`{command}` ended with {code:?}; `serve` lost real time {missed} times so far:\n{output}"
        );
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
        if self.is_beside {
            // One that has ended already needs no priority.
            let _ = setpriority_process(Some(Pid::from_child(&child)), BESIDE);
        }
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

impl Drop for Session<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.failed.store(true, Ordering::Relaxed);
        }
    }
}

/// Returns the file of Python itself: what is called so may be a script that finds it.
fn interpreter() -> PathBuf {
    let asked = Command::new("python3").args(["-c", "import sys; print(sys.executable)"]).output();
    String::from_utf8(asked.unwrap().stdout).unwrap().trim().into()
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
    /// A test that fails leaves no robot behind at the port of the documents.
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
        ["python3", "-m", "pip", "install", folder] => {
            return assert!(root().join(folder).join("pyproject.toml").exists(), "{folder}");
        }
        ["cargo", "run", "--release", "-p", "flix-sim", "--example", name] => {
            return assert!(root().join(format!("sim-hil/examples/{name}.rs")).exists(), "{name}");
        }
        _ => return,
    };
    assert!(read(file).contains(&text), "`{command}`: {file} has no {text}");
}
