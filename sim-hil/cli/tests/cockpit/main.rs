//! `flix cockpit` in a real browser, with a served robot: keyboard, touch and gamepad drive it, and a page that freezes
//! or dies leaves it at rest within a second.
//!
//! Times are of the robot's clock. The pages are tried in Chromium, and in short in Firefox and WebKitGTK. Browsers that are not
//! installed (`cargo xtask setup --browser` brings them) are left out, unless FLIX_REQUIRE_BROWSER is set; with FLIX_WITHOUT_BROWSER
//! all are. This program is its own operator: started with `cockpit` it is `flix`.

mod browser;
mod page;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant as WallClock};

use browser::{Browser, Engine, brought};
use flix_host::link::keys;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::session::Key;
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::reliability::fault_matrix::REST_HZ;
use flix_sim::rig::bench::{Base, learnt};
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};
use flix_sim_cli::serve::serve;
use page::Page;
use serde_json::json;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Time in which a robot that is left alone comes to rest.
const REST_WITHIN: Duration = Duration::from_secs(1);
/// Time for which it must then stay there.
const STAYS: Duration = Duration::from_secs(1);
/// Frequency from which it walks, Hz.
const WALKING_HZ: f64 = 29.0;
/// Time after which a robot that does not walk is commanded again.
const TRY_AGAIN: Duration = Duration::from_secs(3);
/// Wall time after which something hangs.
const PATIENCE: Duration = Duration::from_secs(180);
/// Notes what the page does first: say that it has no connection, or give up the one that it has.
#[cfg(unix)]
const NOTE_WHAT_IS_DONE: &str = "
    const { prototype } = WebSocket, close = prototype.close;
    window.done = [];
    prototype.close = function () { window.done.push('gives up'); close.call(this); };
    const banner = document.getElementById('banner-text');
    new MutationObserver(() => {
      if (banner.textContent.startsWith('No connection')) window.done.push('says so');
    }).observe(banner, { childList: true, characterData: true, subtree: true });
";
/// Pause between two looks at a condition.
const LOOK: Duration = Duration::from_millis(5);
/// Descriptors that the program is left with: some 20 are its own.
#[cfg(target_os = "linux")]
const DESCRIPTORS: u64 = 128;
/// Sockets that strangers open.
const SOCKETS: usize = 600;
const SEED: u64 = 1;
const ENTER: char = '\u{e007}';

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if words.first().is_some_and(|word| word == "cockpit") {
        return flix_cli::main();
    }
    let mut filters = words.iter().filter(|word| !word.starts_with('-')).peekable();
    if filters.peek().is_some() && !filters.any(|filter| "cockpit".contains(filter.as_str())) {
        return ExitCode::SUCCESS;
    }
    match try_all() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("cockpit: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Tries each program with a robot of its own, side by side: they wait most of their time.
fn try_all() -> Outcome<()> {
    let missing = "not installed: `cargo xtask setup --browser` brings it";
    std::thread::scope(|scope| {
        let said = |tried: Outcome<()>| tried.map_err(|error| error.to_string());
        let start = |(engine, options, tests): &'static (Engine, &[&str], &[Test])| {
            scope.spawn(move || {
                let has_all_else = *engine != Engine::Chromium || brought(AXE).exists();
                let is_tried = Browser::is_to_be_tried(*engine, has_all_else, missing);
                let is_tried = is_tried.map_err(|error| error.to_string())?;
                let pages = is_tried.then_some((*engine, *tests));
                said(with_a_robot(options, |program| try_program(program, pages)))
            })
        };
        // All are started before the first is waited for.
        let tried: Vec<_> = DESKS.iter().map(start).collect();
        let failed = tried
            .into_iter()
            .filter_map(|it| it.join().unwrap_or_else(|_| Err("a test panicked".to_owned())).err());
        let failed = failed.collect::<Vec<_>>().join("\ncockpit: ");
        if failed.is_empty() { Ok(()) } else { Err(failed.into()) }
    })
}

/// What the robot does, as the simulator knows it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    now: Instant,
    frequency: f64,
    /// When a rotor last turned.
    moved: Instant,
    /// When it last did not walk.
    slow: Instant,
}

/// The program `flix cockpit`, and the robot that it drives.
struct Program {
    id: u32,
    url: String,
    seen: Arc<Mutex<Seen>>,
}

/// Serves a robot while a cockpit with these options is tried.
fn with_a_robot(options: &[&str], use_program: impl FnOnce(Program) -> Outcome<()>) -> Outcome<()> {
    let key = Key::new([0x5a; 32]);
    let model = RobotModel::named("bench-fixed")?;
    let mut parameters = RobotParameters::of(&model.electrical, key.clone(), SEED)?;
    parameters.flash.overwrite(learnt(Base::Fixed, SEED)?);
    parameters.entropy = *keys::generate()?.as_bytes();
    let robot = SimulatedRobot::new(parameters, Plant::new(&model)?);
    let directory = tempfile::tempdir()?;
    let key_file = directory.path().join("robot.key");
    keys::write_new(&key_file, &key)?;
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let address = socket.local_addr()?.to_string();
    let start =
        Seen { now: Instant::START, frequency: 0.0, moved: Instant::START, slow: Instant::START };
    let seen = Arc::new(Mutex::new(start));
    let interrupt = Interrupt::never();
    let server = std::thread::spawn({
        let (interrupt, seen) = (interrupt.clone(), Arc::clone(&seen));
        move || {
            serve(robot, &socket, None, &interrupt, |robot| {
                let (now, truth) = (robot.now(), robot.truth());
                if let Ok(mut seen) = seen.lock() {
                    let moved = if truth.is_slower_than(REST_HZ) { seen.moved } else { now };
                    let frequency = truth.frequency();
                    let slow = if frequency.abs() > WALKING_HZ { seen.slow } else { now };
                    *seen = Seen { now, frequency, moved, slow };
                }
                Ok(())
            })
        }
    });
    let tried = cockpit(&address, &key_file, options).and_then(|(mut child, url)| {
        let tried = use_program(Program { id: child.id(), url, seen });
        end(&mut child)?;
        tried
    });
    interrupt.raise();
    server.join().map_err(|_| "the robot panicked")??;
    tried
}

/// Starts `flix cockpit`, and returns it with the address of its page.
fn cockpit(robot: &str, key_file: &Path, options: &[&str]) -> Outcome<(Child, String)> {
    let mut program = Command::new(std::env::current_exe()?)
        .args(["cockpit", robot, "--bind", "127.0.0.1:0", "--key"])
        .arg(key_file)
        .args(options)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut line = String::new();
    let read = program.stdout.as_mut().map(|output| BufReader::new(output).read_line(&mut line));
    match line.trim().strip_prefix("open ") {
        Some(url) => Ok((program, url.to_owned())),
        None => end(&mut program).and_then(|()| Err(format!("no address: {read:?}").into())),
    }
}

fn end(program: &mut Child) -> Outcome<()> {
    program.kill()?;
    program.wait()?;
    Ok(())
}

type Test = (&'static str, fn(&mut Desk) -> Outcome<()>);
/// Tried in each engine.
const JOURNEY: Test = ("a_page_drives_stops_and_sets", Desk::journey);
/// What judges accessibility (axe-core, Mozilla Public Licence 2.0).
const AXE: &str = "axe_playwright_python/axe.min.js";
/// What is tried one after the other with one robot, with the options of its program. Each takes about the same time.
const DESKS: &[(Engine, &[&str], &[Test])] = &[
    (Engine::Firefox, &[], &[JOURNEY]),
    (Engine::WebKit, &[], &[JOURNEY]),
    (
        Engine::Chromium,
        &[],
        &[
            ("small_screens_show_values_and_stop_whole", Desk::screens),
            ("the_scope_shows_its_channels", Desk::scope),
            ("settings_are_read_and_changed", Desk::settings),
            ("stop_stays_on_the_screen_and_nothing_under_a_notch", Desk::zooms),
            ("keys_drive_and_the_space_bar_stops", Desk::keys),
            ("a_finger_drives_and_stops", Desk::finger),
            ("of_two_pages_one_drives_and_both_stop", Desk::two_pages),
            ("a_page_that_comes_back_or_is_not_drawn_leaves_the_robot_at_rest", Desk::comes_back),
        ],
    ),
    (
        Engine::Chromium,
        &[],
        &[
            ("a_gamepad_drives_once_it_was_neutral", Desk::gamepad),
            ("any_gamepad_stops_and_the_one_touched_drives", Desk::gamepads),
            ("a_page_outlives_what_its_browser_lacks", Desk::poor_browser),
            ("inputs_count_whose_clock_is_not_that_of_the_page", Desk::clocks),
            ("states_are_seen_without_colours_and_keys_reach_the_panel", Desk::forms),
            (
                "pictures_are_drawn_on_change_alone_and_the_screen_stays_on_meanwhile",
                Desk::pictures,
            ),
        ],
    ),
    (
        Engine::Chromium,
        &[],
        &[
            ("a_page_is_read_by_everybody", Desk::accessible),
            JOURNEY,
            ("a_page_that_freezes_leaves_the_robot_at_rest", Desk::freeze),
            #[cfg(unix)]
            ("a_page_without_an_answer_says_so_and_stops_as_soon_as_it_can", Desk::silent_program),
            ("a_stop_that_is_lost_is_said_and_sent_again_whatever_is_shown", Desk::lost_stop),
            ("a_page_that_dies_leaves_the_robot_at_rest", Desk::dies),
        ],
    ),
    (
        Engine::Chromium,
        &["--hold-to-run"],
        &[("a_walk_that_is_held_ends_when_it_is_released", Desk::held)],
    ),
];

/// Tries what needs no browser, then pages, where there is one.
fn try_program(program: Program, pages: Option<(Engine, &[Test])>) -> Outcome<()> {
    strangers_are_refused(&program.url)?;
    println!("test strangers_are_refused ... ok");
    idle_and_slow_sockets_keep_no_page_from_stopping(&program)?;
    println!("test idle_and_slow_sockets_keep_no_page_from_stopping ... ok");
    let Some((engine, tests)) = pages else { return Ok(()) };
    let mut desk = Desk { browser: Browser::open(engine)?, program };
    for (name, test) in tests {
        let verdict = test(&mut desk);
        println!("test {name} in {engine:?} ... {}", if verdict.is_ok() { "ok" } else { "FAILED" });
        verdict.map_err(|error| format!("{name} in {engine:?}: {error}"))?;
    }
    Ok(())
}

/// Asks without a browser, as whoever can reach the port.
fn strangers_are_refused(url: &str) -> Outcome<()> {
    let (host, path) =
        url.strip_prefix("http://").and_then(|it| it.split_once('/')).ok_or("no path")?;
    let own = format!("http://{host}");
    let (token, other) = (&path[..path.len() - 2], if path.ends_with("0/") { '1' } else { '0' });
    let wrong = format!("{token}{other}/");
    let port = host.rsplit(':').next().ok_or("no port")?;
    let strange = format!("evil.example:{port}");
    let socket = |path: &str| format!("{path}socket");
    for (path, asked, origin, expected) in [
        (path, host, None, 200),
        (&wrong, host, None, 403),
        (path, &strange, None, 403),
        (path, host, Some("http://evil.example"), 403),
        (&path[..path.len() - 1], host, None, 308),
        (&wrong[..wrong.len() - 1], host, None, 403),
        (&socket(path), host, Some(own.as_str()), 101),
        // As `ssh -L` forwards it.
        (&socket(path), "localhost:8080", Some("http://localhost:8080"), 101),
        (path, &format!("{host}\r\nHost: {host}"), None, 400),
        (&socket(&wrong), host, Some(&own), 403),
        (&socket(path), host, Some("http://evil.example"), 403),
        (&socket(path), host, None, 403),
        (&socket(path), &strange, Some(&format!("http://{strange}")), 403),
    ] {
        let status = status(host, path, asked, origin)?;
        if status != expected {
            return Err(
                format!("{path} of {asked} from {origin:?}: {status}, not {expected}").into()
            );
        }
    }
    Ok(())
}

/// Opens more sockets than the program has descriptors, some of which say something slowly, as whoever can reach the port.
fn idle_and_slow_sockets_keep_no_page_from_stopping(program: &Program) -> Outcome<()> {
    let url = program.url.as_str();
    let (host, path) =
        url.strip_prefix("http://").and_then(|it| it.split_once('/')).ok_or("no path")?;
    leave_descriptors(program.id)?;
    let mut page = Page::open(url)?;
    page.until("rest", "disarmed")?;
    let mut sockets = Vec::new();
    for number in 0..SOCKETS {
        let mut socket = TcpStream::connect(host)?;
        if number % 2 == 0 {
            // Whom the server has turned out already is of no use any more.
            let _ = socket.write_all(b"GET / HTTP/1.1\r\nHost: a");
        }
        sockets.push(socket);
    }
    // The page that is open stops the robot, and one that is opened now shows it.
    page.say("stop")?;
    page.until("stop", "stopped")?;
    let served = status(host, path, host, None)?;
    if served != 200 {
        return Err(format!("a page is answered with {served} among {SOCKETS} sockets").into());
    }
    let mut other = Page::open(url)?;
    other.until("rest", "stopped")?;
    other.until("drive clear", "disarmed")?;
    Ok(())
}

/// Leaves a program few descriptors, where that can be done from outside.
#[cfg(target_os = "linux")]
fn leave_descriptors(program: u32) -> Outcome<()> {
    use rustix::process::{Pid, Resource, Rlimit, prlimit};
    let few = Rlimit { current: Some(DESCRIPTORS), maximum: Some(DESCRIPTORS) };
    let program = Pid::from_raw(program.try_into()?);
    prlimit(program, Resource::Nofile, few)?;
    Ok(())
}

#[cfg(not(target_os = "linux"))]
fn leave_descriptors(_: u32) -> Outcome<()> {
    Ok(())
}

/// Lets a program hang, or go on.
#[cfg(unix)]
fn hang(program: u32, hangs: bool) -> Outcome<()> {
    use rustix::process::{Pid, Signal, kill_process};
    let program = Pid::from_raw(program.try_into()?).ok_or("no program")?;
    kill_process(program, if hangs { Signal::STOP } else { Signal::CONT })?;
    Ok(())
}

/// Returns the status of the answer to a request for a page or a WebSocket.
fn status(to: &str, path: &str, host: &str, origin: Option<&str>) -> Outcome<u16> {
    let mut stream = TcpStream::connect(to)?;
    let origin = origin.map_or_else(String::new, |it| format!("Origin: {it}\r\n"));
    write!(
        stream,
        "GET /{path} HTTP/1.1\r\nHost: {host}\r\n{origin}Connection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )?;
    let mut answer = [0; 12];
    stream.read_exact(&mut answer)?;
    Ok(std::str::from_utf8(&answer[9..])?.parse()?)
}

/// A browser, and the robot that it drives.
struct Desk {
    browser: Browser,
    program: Program,
}

impl Desk {
    fn seen(&self) -> Outcome<Seen> {
        self.program.seen.lock().map(|seen| *seen).map_err(|_| "the robot panicked".into())
    }

    fn until(&self, what: &str, is_so: impl Fn(&Self) -> Outcome<bool>) -> Outcome<()> {
        let begun = WallClock::now();
        while !is_so(self)? {
            if begun.elapsed() > PATIENCE {
                let page = self.browser.run("return document.body.innerText");
                return Err(format!("not {what}: {:?}, {page:?}", self.seen()?).into());
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }

    fn until_text(&self, id: &str, text: &str) -> Outcome<()> {
        let script = format!("return document.getElementById('{id}').textContent");
        self.until(&format!("{id} = {text}"), |desk| Ok(desk.browser.run(&script)? == text))
    }

    /// Commands this until it is so: where the machine has no time for the page, a command is not done, or the robot rests.
    fn command(
        &self,
        what: &str,
        command: impl Fn(&Self) -> Outcome<()>,
        is_so: impl Fn(&Self) -> Outcome<bool>,
    ) -> Outcome<()> {
        let tried = std::cell::Cell::new(None::<Instant>);
        self.until(what, |desk| {
            if is_so(desk)? {
                return Ok(true);
            }
            let now = desk.seen()?.now;
            if tried.get().is_none_or(|at| now.since(at) > TRY_AGAIN) {
                tried.set(Some(now));
                command(desk)?;
            }
            Ok(false)
        })
    }

    fn walk(&self, command: impl Fn(&Self) -> Outcome<()>) -> Outcome<()> {
        self.walk_for(Duration::ZERO, command)
    }

    fn walk_for(&self, time: Duration, command: impl Fn(&Self) -> Outcome<()>) -> Outcome<()> {
        let armed = |desk: &Self| desk.until_armed().and_then(|()| command(desk));
        let walks = |seen: Seen| seen.now.since(seen.slow) > time;
        self.command("walking", armed, |desk| desk.seen().map(walks))
    }

    fn state(&self) -> Outcome<serde_json::Value> {
        self.browser.run("return document.getElementById('state').textContent")
    }

    /// Arms by keyboard, unless the robot is armed.
    fn until_armed(&self) -> Outcome<()> {
        self.until("armed", |desk| {
            let state = desk.state()?;
            if state == "disarmed" {
                desk.browser.press(ENTER)?;
            }
            Ok(state == "armed" || state == "running")
        })
    }

    fn until_resting(&self) -> Outcome<()> {
        self.until("resting", |desk| {
            desk.seen().map(|seen| seen.now.since(seen.moved) > Duration::from_millis(100))
        })
    }

    /// Opens the page, and arms by keyboard whatever was before.
    fn arm(&self) -> Outcome<()> {
        self.browser.go(&self.program.url)?;
        // On a busy machine a page that is loaded anew may come before the one that drove is gone: it watches.
        let is_ready = "const drive = document.getElementById('drive');
                        if (!drive.hidden) drive.click();
                        return document.querySelector('[data-do=arm]').disabled === false";
        self.until("connected", |desk| Ok(desk.browser.run(is_ready)? == true))?;
        let clear = |desk: &Self| desk.browser.press('c');
        self.command("cleared", clear, |desk| {
            let state = desk.state()?;
            Ok(["disarmed", "armed", "running"].iter().any(|it| state == *it))
        })?;
        self.until_armed()
    }

    /// Checks that the robot has come to rest in time after this, and stays there.
    fn rests_since(&self, left: Instant) -> Outcome<()> {
        self.until("a while later", |desk| Ok(desk.seen()?.now.since(left) > REST_WITHIN + STAYS))?;
        let moved = self.seen()?.moved.since(left);
        if moved > REST_WITHIN { Err(format!("moved for {moved:?}").into()) } else { Ok(()) }
    }

    /// Changes a setting as its operator does, and waits until the robot has it.
    fn change(&self, setting: &str, value: f64) -> Outcome<()> {
        let find = format!("const input = document.getElementById('setting-{setting}');");
        let change = format!(
            "{find} input.value = {value}; input.dispatchEvent(new Event('input'));
             input.dispatchEvent(new Event('change'));
             // What the page shows next comes from the robot.
             input.value = '';"
        );
        self.command(
            &format!("{setting} = {value}"),
            |desk| desk.browser.run(&change).map(drop),
            |desk| {
                let seen = format!("{find} return input?.disabled === false ? input.value : null");
                Ok(desk.browser.run(&seen)?.as_str() == Some(&value.to_string()))
            },
        )
    }

    /// Shows a part of the page as a pinch does, and another while a keyboard lies over it, which browsers of telephones say so.
    fn zooms(&mut self) -> Outcome<()> {
        self.arm()?;
        self.browser.resize(390, 844)?;
        let stop = "const { offsetLeft: x, offsetTop: y, width, height } = visualViewport, stop = document.getElementById('stop');
                    const box = stop.getBoundingClientRect(), within = (a, b) => a > b - 1;
                    const is_inside = within(box.left, x) && within(box.top, y) && within(x + width, box.right) && within(y + height, box.bottom);
                    const reached = document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2);
                    return is_inside && stop.contains(reached) && box.width > 0.9 * width && box.height < 0.4 * height";
        for scale in [1.0, 3.0, 5.0, 1.5] {
            let pinch = json!({ "pageScaleFactor": scale });
            self.browser.devtools("Emulation.setPageScaleFactor", &pinch)?;
            self.until("STOP in what is shown", |desk| Ok(desk.browser.run(stop)? == true))?;
            for (right, down) in [(-150, -200), (400, 600)] {
                let pan = json!({ "x": 20, "y": 40, "xDistance": right, "yDistance": down });
                self.browser.devtools("Input.synthesizeScrollGesture", &pan)?;
                self.until("STOP in what is shown", |desk| Ok(desk.browser.run(stop)? == true))?;
            }
        }
        self.browser.devtools("Emulation.setPageScaleFactor", &json!({ "pageScaleFactor": 1 }))?;
        let is_whole = "return document.getElementById('stop').style.transform === ''";
        self.until("STOP in its place", |desk| Ok(desk.browser.run(is_whole)? == true))?;
        let keyboard = format!(
            "Object.defineProperty(visualViewport, 'height', {{ value: 300, configurable: true }});
             visualViewport.dispatchEvent(new Event('resize')); {stop}"
        );
        let zoomed = "return [...document.querySelectorAll('input')].filter((it) => parseFloat(getComputedStyle(it).fontSize) < 16).length";
        if self.browser.run(&keyboard)? != true || self.browser.run(zoomed)? != 0 {
            return Err("a keyboard lies over STOP, or a field is zoomed in".into());
        }
        self.browser.run(
            "delete visualViewport.height; visualViewport.dispatchEvent(new Event('resize'))",
        )?;
        // A notch beside the page, and a bar below.
        self.browser.resize(844, 390)?;
        let insets = json!({ "insets": { "left": 47, "right": 47, "bottom": 21 } });
        self.browser.devtools("Emulation.setSafeAreaInsetsOverride", &insets)?;
        let hidden = "return [...document.querySelectorAll('aside button, aside input, header > *')].filter((it) => {
                        const box = it.getBoundingClientRect();
                        return box.width && (box.left < 47 || box.right > innerWidth - 47);
                      }).length || getComputedStyle(document.body).overscrollBehaviorY !== 'none'";
        self.until("nothing under the notch", |desk| Ok(desk.browser.run(hidden)? == false))?;
        self.browser.devtools("Emulation.setSafeAreaInsetsOverride", &json!({ "insets": {} }))?;
        self.browser.resize(0, 0)
    }

    /// Shows states without the colours of the page, and keeps the keys of the panel that drives from a screen reader.
    fn forms(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let differ = "const form = (it) => { const { backgroundColor, borderTopStyle, boxShadow } = getComputedStyle(it); return [backgroundColor, borderTopStyle, boxShadow]; };
                      const buttons = ['true', 'false'].map((is) => document.querySelector(`[aria-pressed=${is}]`));
                      // On a busy machine the robot rests, or its state is not drawn yet.
                      if (buttons.includes(null)) return false;
                      const [a, b] = buttons.map(form);
                      const stop = getComputedStyle(document.getElementById('stop')).backgroundColor;
                      return a.filter((it, index) => it !== b[index]).length > 1 && stop === 'rgb(198, 32, 32)'";
        for forced in ["none", "active"] {
            let media = json!({ "features": [{ "name": "forced-colors", "value": forced }] });
            self.browser.devtools("Emulation.setEmulatedMedia", &media)?;
            self.until(&format!("forms with forced colours {forced}"), |desk| {
                Ok(desk.browser.run(differ)? == true)
            })?;
        }
        self.browser.devtools("Emulation.setEmulatedMedia", &json!({ "features": [] }))?;
        let panel = "const [panel, other] = document.querySelectorAll('[role=application]');
                     const has = (selector) => [...document.querySelectorAll(selector)].every((it) => panel.contains(it));
                     return !other && has('[data-mode], .value button, [data-do=arm]') && !has('#log') && !has('#settings') && !has('#banner')";
        if self.browser.run(panel)? != true {
            return Err(
                "a screen reader takes the keys of the panel, or cannot read the log".into()
            );
        }
        self.browser.press('s')?;
        self.until_resting()
    }

    /// Leaves the page and comes back to it, which Chromium keeps without its connection; lets a page be seen and not drawn, as a telephone
    /// does that has woken up; and writes a blank as its keyboard does, which names no key.
    fn comes_back(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let left = self.seen()?.now;
        self.browser.go("about:blank")?;
        self.rests_since(left)?;
        self.browser.back()?;
        self.until("connected", |desk| Ok(desk.state()? == "disarmed"))?;
        self.stays_at_rest()?;
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let left = self.seen()?.now;
        self.browser.run("window.requestAnimationFrame = () => 0")?;
        self.rests_since(left)?;
        self.browser.press(' ')?;
        Page::open(&self.program.url)?.until("rest", "stopped")?;
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let field = "document.getElementById('settings').open = true;
                     const field = document.getElementById('settings-find');
                     // A field that is reached lets the robot rest.
                     Object.defineProperty(field, 'matches', { value: () => false }); field.focus()";
        self.browser.run(field)?;
        self.browser.devtools("Input.insertText", &json!({ "text": " " }))?;
        self.until_text("state", "stopped")?;
        let found = self.browser.run("return document.getElementById('settings-find').value")?;
        if found == "" { Ok(()) } else { Err(format!("`{found}` is written").into()) }
    }

    /// Counts pictures while the robot rests and while it walks, and looks whether the screen may go off.
    fn pictures(&mut self) -> Outcome<()> {
        self.arm()?;
        self.browser.run(
            "window.pictures = 0; window.locks = 0;
             const clear = CanvasRenderingContext2D.prototype.clearRect;
             CanvasRenderingContext2D.prototype.clearRect = function (...all) { window.pictures += 1; clear.apply(this, all); };
             const request = async () => { window.locks += 1; return { release: async () => { window.locks -= 1; } }; };
             Object.defineProperty(navigator, 'wakeLock', { value: { request }, configurable: true })",
        )?;
        let drawn = |desk: &Self| {
            let before = desk.browser.run("return window.pictures")?.as_u64();
            std::thread::sleep(STAYS);
            let after = desk.browser.run("return window.pictures")?.as_u64();
            Ok::<_, Box<dyn std::error::Error>>(
                after.zip(before).map_or(0, |(after, before)| after - before),
            )
        };
        let locks = |desk: &Self, count: u64| {
            desk.until("a lock of the screen", |desk| {
                Ok(desk.browser.run("return window.locks")? == count)
            })
        };
        self.until("still", |desk| Ok(drawn(desk)? == 0))?;
        self.walk(|desk| desk.browser.press('w'))?;
        locks(self, 1)?;
        if drawn(self)? == 0 {
            return Err("a robot that walks is not drawn".into());
        }
        self.browser.press('s')?;
        self.until_resting()?;
        locks(self, 0)?;
        // Whoever turns the picture sees it turned.
        self.until("still", |desk| Ok(drawn(desk)? == 0))?;
        let wheel = "const before = window.pictures; document.getElementById('view').dispatchEvent(new WheelEvent('wheel', { deltaY: 100, cancelable: true }));
                     return before";
        let before = self.browser.run(wheel)?;
        self.until("turned", |desk| Ok(desk.browser.run("return window.pictures")? != before))
    }

    /// Sends inputs whose times are of another clock than the page's, or of none.
    fn clocks(&mut self) -> Outcome<()> {
        self.arm()?;
        let press = |time: &str, before: &str| {
            format!(
                "{before}; const key = new KeyboardEvent('keydown', {{ key: 'w', code: 'KeyW', bubbles: true }});
                 Object.defineProperty(key, 'timeStamp', {{ value: {time} }});
                 document.body.dispatchEvent(key)"
            )
        };
        for time in ["0", "-60000", "Date.now()", "NaN"] {
            let press = press(time, "");
            self.walk(|desk| desk.browser.run(&press).map(drop))?;
            self.browser.press('s')?;
            self.until_resting()?;
        }
        // One that was queued while the page stood still, and one that is old for certain.
        let stood = "const end = performance.now() + 400; while (performance.now() < end)";
        for press in [press("0", stood), press("performance.now() - 900", "")] {
            self.browser.run(&press)?;
            self.stays_at_rest()?;
        }
        // A phone has slept: the clock of its inputs has not.
        self.browser.run(
            "const now = performance.now.bind(performance); performance.now = () => now() + 600000;",
        )?;
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.press(' ')?;
        self.until_text("state", "stopped")
    }

    /// Writes into the field of a setting as a person does, and again where the machine has no time for it, until it shows this value,
    /// and the sentence at it.
    fn type_in(&self, setting: &str, keys: &str, shown: &str) -> Outcome<()> {
        let find = format!("const input = document.getElementById('setting-{setting}');");
        let focus = format!(
            "{find} input.focus(); input.select(); return document.activeElement === input"
        );
        let type_keys = |desk: &Self| {
            desk.until("a field", |desk| Ok(desk.browser.run(&focus)? == true))?;
            keys.chars().try_for_each(|key| desk.browser.press(key))
        };
        let look = format!(
            "{find} if (document.activeElement === input) input.blur();
             const refused = document.getElementById('refused-{setting}').textContent;
             return [input.value, refused].join(' ').trim()"
        );
        type_keys(self)?;
        self.command(shown, type_keys, |desk| Ok(desk.browser.run(&look)? == shown))
    }

    fn settings(&mut self) -> Outcome<()> {
        self.browser.go(&self.program.url)?;
        // What is shown first moves the page under a finger.
        self.until("open settings", |desk| {
            let is_open = "return document.getElementById('settings').open";
            let was_open = desk.browser.run(is_open)? == true;
            if !was_open {
                desk.browser.touch("#settings summary")?;
            }
            Ok(was_open)
        })?;
        self.until("settings", |desk| {
            let rows = "return document.querySelectorAll('.setting input:enabled').length";
            Ok(desk.browser.run(rows)?.as_u64() > Some(40))
        })?;
        self.change("current_limit", 1.75)?;
        self.change("current_limit", 2.0)?;
        // Keys of people who write a decimal comma, and the sign that pages print.
        self.type_in("over_current", "2.7\u{e007}", "2.7")?;
        let comma =
            "2.7 over_current: `2,6` is not a number in A: write a decimal point, and no comma";
        self.type_in("over_current", "2,6\u{e007}", comma)?;
        self.type_in("over_current", "2600mA\u{e007}", "2.6")?;
        let before =
            self.browser.run("return document.getElementById('setting-top_encoder_zero').value")?;
        let before = before.as_str().ok_or("no value")?.to_owned();
        self.type_in("top_encoder_zero", "\u{2212}12\u{e007}", "-12")?;
        self.type_in("top_encoder_zero", &format!("{before}\u{e007}"), &before)?;
        self.type_in(
            "current_limit",
            "99\u{e007}",
            "2 current_limit must be from 0.8 to 2.6 A, not 99",
        )?;
        // Escape undoes what is not sent yet.
        self.type_in(
            "current_limit",
            "1.2\u{e00c}",
            "2 current_limit must be from 0.8 to 2.6 A, not 99",
        )?;
        self.type_in("current_limit", "2.0\u{e007}", "2")?;
        // Whoever looks for a setting finds its words without the space bar.
        let find = "const find = document.getElementById('settings-find'); find.value = 'CurrentLimit';
                    find.dispatchEvent(new Event('input'));
                    const shown = [...document.querySelectorAll('.setting')].filter((row) => row.offsetParent).length;
                    find.value = ''; find.dispatchEvent(new Event('input'));
                    return shown";
        if !self.browser.run(find)?.as_u64().is_some_and(|shown| (1..9).contains(&shown)) {
            return Err("the words of a setting are not found without a blank".into());
        }
        self.until_armed()?;
        self.until("no change while armed", |desk| {
            let enabled = "return document.querySelectorAll('.setting input:enabled').length";
            Ok(desk.browser.run(enabled)? == 0)
        })
    }

    /// Loads the page, arms, walks by key and pointer, stops by both, clears, and changes a setting.
    fn journey(&mut self) -> Outcome<()> {
        let click = |desk: &Self, selector: &str| {
            desk.browser.point("mouse", selector, &["pointerDown", "pointerUp"])
        };
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.press('s')?;
        self.until_resting()?;
        for stops_by_key in [true, false] {
            self.arm()?;
            self.walk(|desk| click(desk, "[data-mode='left turn']"))?;
            let left = self.seen()?.now;
            if stops_by_key {
                // Firefox clicks what has the focus once the space bar is released.
                self.browser.run("document.querySelector('[data-mode=forward]').focus()")?;
                self.browser.press(' ')?;
            } else {
                click(self, "#stop")?;
            }
            self.until_text("state", "stopped")?;
            self.rests_since(left)?;
        }
        self.browser.run("document.getElementById('settings').open = true")?;
        self.until("settings", |desk| {
            let rows = "return document.querySelectorAll('.setting input:enabled').length";
            Ok(desk.browser.run(rows)?.as_u64() > Some(40))
        })?;
        self.type_in("current_limit", "1.75\u{e007}", "1.75")?;
        let comma =
            "1.75 current_limit: `2,6` is not a number in A: write a decimal point, and no comma";
        self.type_in("current_limit", "2,6\u{e007}", comma)?;
        self.type_in("current_limit", "2.0\u{e007}", "2")
    }

    /// Judges the page as axe-core does, whole and open, in light and dark.
    fn accessible(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.run("for (const one of document.querySelectorAll('details')) one.open = true; document.getElementById('scope-now').click()")?;
        self.until("a capture", |desk| {
            Ok(desk.browser.run("return document.querySelector('#scope-charts b') !== null")?
                == true)
        })?;
        self.browser.run(&std::fs::read_to_string(brought(AXE))?)?;
        // What is scrolled out of sight is not judged.
        self.browser.resize(1280, 9000)?;
        for scheme in ["light", "dark"] {
            let media =
                json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
            self.browser.devtools("Emulation.setEmulatedMedia", &media)?;
            let findings = self.browser.run_until_called(
                "const done = arguments[arguments.length - 1];
                 const grave = ({ impact }) => impact === 'serious' || impact === 'critical';
                 const said = ({ id, nodes }) => nodes.map(({ html, any }) => `${id}: ${html} ${any.map(({ message }) => message)}`);
                 axe.run().then(({ violations }) => done(violations.filter(grave).flatMap(said).join('\\n')), (error) => done(String(error)))",
            )?;
            if findings != "" {
                return Err(
                    format!("in {scheme}: {}", findings.as_str().unwrap_or("no findings")).into()
                );
            }
        }
        self.browser.devtools("Emulation.setEmulatedMedia", &json!({ "features": [] }))?;
        self.browser.resize(0, 0)?;
        self.browser.press('s')?;
        self.until_resting()
    }

    fn screens(&mut self) -> Outcome<()> {
        self.arm()?;
        for (width, height) in
            [(320, 568), (360, 640), (390, 844), (844, 390), (667, 175), (1280, 800)]
        {
            self.browser.resize(width, height)?;
            // What is written longest, measured before it is written anew.
            let misfits = "const box = (of) => { const it = document.createRange(); it.selectNodeContents(of); return it.getBoundingClientRect(); };
                 const stop = document.getElementById('stop'), aside = document.querySelector('aside').getBoundingClientRect(), misfits = [];
                 const shown = stop.getBoundingClientRect(), text = box(stop);
                 if (shown.bottom > innerHeight || text.top < shown.top || text.bottom > shown.bottom) misfits.push('STOP');
                 for (const name of ['f', 'theta']) {
                   const [value, wanted] = [name, `${name}-wanted`].map((id) => document.getElementById(id));
                   value.textContent = '\u{2212}100.0 deg'; wanted.textContent = 'commanded \u{2212}30.0';
                   const [a, b] = [value, wanted].map(box), buttons = [...value.parentElement.querySelectorAll('button')].map((it) => it.getBoundingClientRect());
                   if (a.right > b.left - 3 && a.bottom > b.top + 3) misfits.push(`${name} touches what is commanded`);
                   if (Math.max(a.right, b.right) > buttons[0].left || buttons[1].right > aside.right) misfits.push(`${name} and its buttons`);
                 }
                 return misfits.join(', ')";
            let misfits = self.browser.run(misfits)?;
            if misfits != "" {
                return Err(format!("at {width} x {height}: {misfits}").into());
            }
        }
        self.browser.resize(0, 0)
    }

    fn scope(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.touch("#scope summary")?;
        let captions = "return document.getElementById('scope-charts').innerText";
        let capture = |desk: &Self| desk.browser.touch("#scope-now");
        self.command("captured", capture, |desk| {
            let text = desk.browser.run(captions)?;
            let text = text.as_str().unwrap_or_default();
            Ok(["top_iq", "bottom_id", "ms: f", "theta_error"]
                .iter()
                .all(|name| text.contains(name)))
        })?;
        // What is too long for a message is said in the page, and stops nothing.
        let long = "const field = document.getElementById('scope-channels');
                    field.value = 'iq,'.repeat(100);
                    document.getElementById('scope-now').click();
                    field.blur();
                    return field.validationMessage";
        if self.browser.run(long)? == "" {
            return Err("a field that is too long is taken".into());
        }
        self.until_resting()?;
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.press('s')?;
        self.until_resting()
    }

    fn keys(&mut self) -> Outcome<()> {
        self.arm()?;
        // At the last of these keys nothing is: its operator has missed another.
        for key in ['s', 'x'] {
            self.walk(|desk| desk.browser.press('w'))?;
            self.browser.press(key)?;
            self.until_resting()?;
        }
        // The second is what an input method sends for the space bar.
        for key in [' ', '\u{3000}'] {
            self.walk(|desk| desk.browser.press('d'))?;
            let left = self.seen()?.now;
            self.browser.press(key)?;
            self.until_text("state", "stopped")?;
            self.rests_since(left)?;
            self.arm()?;
        }
        Ok(())
    }

    fn finger(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.touch("[data-mode='left turn']"))?;
        self.browser.touch("[data-mode=rest]")?;
        self.until_resting()?;
        self.walk(|desk| desk.browser.touch("[data-mode='strafe right']"))?;
        self.browser.touch("#stop")?;
        self.until_text("state", "stopped")?;
        self.until_resting()
    }

    fn held(&mut self) -> Outcome<()> {
        self.arm()?;
        for by in ["w", "[data-mode='left turn']"] {
            let key = by.chars().next().filter(|_| by.len() == 1);
            let hold = |desk: &Self, is_down: bool| match key {
                Some(key) => desk.browser.hold(key, is_down),
                None if is_down => desk.browser.point("mouse", by, &["pointerDown"]),
                None => desk.browser.point("mouse", by, &["pointerUp"]),
            };
            // On a busy machine a command may not be done, or the robot rests.
            self.walk_for(STAYS, |desk| hold(desk, false).and_then(|()| hold(desk, true)))?;
            let left = self.seen()?.now;
            hold(self, false)?;
            self.rests_since(left)?;
        }
        // What is released without a word of it: where a Mac has its command key down, by a keyboard that is silent, and while
        // another button of the mouse is down.
        let key = |kind: &str, what: &str| {
            format!(
                "document.body.dispatchEvent(new KeyboardEvent('{kind}', {{ bubbles: true, {what} }}));"
            )
        };
        let press = key("keydown", "key: 'w', code: 'KeyW'");
        let repeat = key("keydown", "key: 'w', code: 'KeyW', repeat: true");
        // In its place the first one repeats no more.
        let other_key = key("keydown", "key: 'ArrowRight', code: 'ArrowRight'");
        let command_key = key("keydown", "key: 'Meta', code: 'MetaLeft', metaKey: true");
        let pointer = |kind: &str, what: &str| {
            format!(
                "document.querySelector(\"[data-mode='left turn']\").dispatchEvent(new PointerEvent('{kind}', {{ bubbles: true, pointerId: 7, {what} }}));"
            )
        };
        let down = pointer("pointerdown", "button: 0, buttons: 1");
        let other_button = pointer("pointermove", "button: 0, buttons: 2");
        for (begin, silent) in [
            (press.clone(), command_key),
            (press.clone(), repeat.repeat(3)),
            (press, repeat + &other_key),
            (down, other_button),
        ] {
            self.walk(|desk| desk.browser.run(&begin).map(drop))?;
            self.browser.run(&silent)?;
            self.until("let go", |desk| desk.seen().map(|seen| seen.frequency.abs() < WALKING_HZ))?;
            self.until_resting()?;
        }
        // Another button than the first begins nothing.
        self.browser.run(&pointer("pointerdown", "button: 2, buttons: 2"))?;
        self.stays_at_rest()
    }

    /// Checks that nothing moves the robot, which is at rest.
    fn stays_at_rest(&self) -> Outcome<()> {
        let begun = self.seen()?.now;
        self.until("a while later", |desk| Ok(desk.seen()?.now.since(begun) > STAYS))?;
        let is_moved = self.seen()?.moved > begun;
        if is_moved { Err("the robot moved".into()) } else { Ok(()) }
    }

    /// Moves the stick of the gamepad: right and down, from -1 to 1.
    fn stick(&self, axes: [f64; 2]) -> Outcome<()> {
        let script = format!(
            "window.stick = {axes:?};
             window.buttons = Array.from({{ length: 17 }}, () => ({{ pressed: false, value: 0 }}));
             const pad = (index, mapping, axes) => ({{ index, mapping, connected: true, axes, buttons: window.buttons }});
             window.pads = () => [null, pad(1, 'standard', window.stick)];
             window.pad = pad;
             navigator.getGamepads = () => window.pads();"
        );
        self.browser.run(&script).map(drop)
    }

    fn push_from_neutral(&self, axes: [f64; 2]) -> Outcome<()> {
        self.stick([0.0, 0.0])?;
        self.until_text("gamepad", "neutral")?;
        self.stick(axes)
    }

    fn gamepad(&mut self) -> Outcome<()> {
        self.arm()?;
        self.stick([0.0, -1.0])?;
        self.until_text("gamepad", "let go of stick and buttons first")?;
        self.stays_at_rest()?;
        self.walk(|desk| desk.push_from_neutral([0.0, -1.0]))?;
        self.stick([0.0, 0.0])?;
        self.until_resting()?;
        // What is pushed for another window.
        self.browser.run("document.hasFocus = () => false")?;
        self.until_text("gamepad", "without the focus: it stops, and disarms")?;
        self.stick([0.0, -1.0])?;
        self.stays_at_rest()?;
        self.browser.run("delete document.hasFocus")?;
        self.until_text("gamepad", "let go of stick and buttons first")?;
        self.stays_at_rest()
    }

    /// Shows these gamepads, an expression of `stick`, `pad` and `buttons`.
    fn pads(&self, expression: &str) -> Outcome<()> {
        self.browser.run(&format!("window.pads = () => {expression};")).map(drop)
    }

    fn gamepads(&mut self) -> Outcome<()> {
        let pressed = "{ ...window.pad(3, 'standard', [0, 0]), buttons: [{ pressed: false }, { pressed: true }] }";
        self.arm()?;
        self.walk(|desk| desk.push_from_neutral([0.0, -1.0]))?;
        // One whose radio is lost shows for ever what it showed last.
        self.browser.run(
            "const frame = window.requestAnimationFrame.bind(window);
             window.requestAnimationFrame = (draw) => frame((now) => draw(now + 31000));",
        )?;
        self.until_resting()?;
        self.until_text("gamepad", "let go of stick and buttons first")?;
        self.walk(|desk| desk.push_from_neutral([0.0, -1.0]))?;
        // B of another one, which this browser shows only now.
        self.pads(&format!("[null, window.pad(1, 'standard', window.stick), {pressed}]"))?;
        self.until_text("state", "stopped")?;
        self.arm()?;
        // The lower button, which is B on a Nintendo pad, stops a robot that walks.
        self.stick([0.0, 0.0])?;
        self.walk(|desk| desk.push_from_neutral([0.0, -1.0]))?;
        self.browser.run("window.buttons[0].pressed = true")?;
        self.until_text("state", "stopped")?;
        self.arm()?;
        // The second one drives, once it is touched; the first has a stick that drifts, and an axis without a number.
        self.stick([0.0, 0.0])?;
        let drifting = "window.pad(0, 'standard', [0.4, NaN])";
        self.pads(&format!("[{drifting}, window.pad(1, 'standard', window.stick)]"))?;
        self.until_text("gamepad", "neutral")?;
        self.walk(|desk| {
            desk.browser.run("window.stick = [0, 0]")?;
            desk.until_text("gamepad", "neutral")?;
            desk.browser.run("window.stick = [1, 0]").map(drop)
        })?;
        // Of one whose layout is not known every button stops; the standard layout has four axes.
        self.pads("[window.pad(0, 'standard', [0, -1, 0, 0, 0, 0, 0])]")?;
        self.until_text("gamepad", "of a layout that is not known: its buttons stop")?;
        self.until_resting()?;
        self.pads("[{ ...window.pad(0, '', [0, -1]), buttons: [{ pressed: window.isPressed }] }]")?;
        self.until_text("gamepad", "of a layout that is not known: its buttons stop")?;
        self.until_resting()?;
        self.browser.run("window.isPressed = true")?;
        self.until_text("state", "stopped")?;
        // One that cannot be read keeps no other from resting and stopping, and drives none.
        let broken = "{ index: 0, connected: true, get buttons() { throw new Error('lost'); } }";
        let beside = format!("[{broken}, window.pad(1, 'standard', window.stick)]");
        for end in ["window.stick = [0, 0]", "window.pads = () => [window.broken]"] {
            self.arm()?;
            self.walk(|desk| desk.push_from_neutral([0.0, -1.0]))?;
            self.pads(&beside)?;
            self.browser.run(&format!("window.broken = {broken}; {end}"))?;
            self.until_resting()?;
        }
        self.stick([0.0, 0.0])?;
        self.pads(&beside)?;
        self.browser.run("window.buttons[1].pressed = true")?;
        self.until_text("state", "stopped")
    }

    fn poor_browser(&mut self) -> Outcome<()> {
        // What is missing from the beginning takes away what needs it alone.
        for lacks in [
            "HTMLCanvasElement.prototype.getContext = () => { throw new Error('blocked'); }",
            "window.matchMedia = undefined; delete Array.prototype.at",
        ] {
            let script = self.browser.before_each_page(lacks)?;
            self.arm()?;
            self.walk(|desk| desk.browser.press('w'))?;
            self.browser.touch("#stop")?;
            self.until_text("state", "stopped")?;
            self.until_resting()?;
            self.browser.no_longer_before_each_page(&script)?;
        }
        self.arm()?;
        for lacks in ["undefined", "() => { throw new Error('not allowed'); }"] {
            self.browser.run(&format!("navigator.getGamepads = {lacks};"))?;
            self.until_text("gamepad", "none")?;
        }
        // A picture that fails is said, and the robot is driven on.
        let broken = "HTMLCanvasElement.prototype.getContext = () => { throw new Error('lost'); };
                      CanvasRenderingContext2D.prototype.clearRect = CanvasRenderingContext2D.prototype.beginPath = () => { throw new Error('lost'); };";
        self.browser.run(broken)?;
        self.until("a note", |desk| {
            let note = desk.browser.run("return document.getElementById('note').textContent")?;
            Ok(note.as_str().is_some_and(|note| note.contains("failed in this browser")))
        })?;
        self.walk(|desk| desk.browser.press('w'))?;
        // A keyboard without Latin letters: the key at the place of S.
        let other = "dispatchEvent(new KeyboardEvent('keydown', { key: 'ы', code: 'KeyS', bubbles: true }))";
        let other = format!("document.body.{other}");
        self.command(
            "at rest",
            |desk| desk.browser.run(&other).map(drop),
            |desk| desk.seen().map(|seen| seen.now.since(seen.moved) > Duration::from_millis(100)),
        )?;
        // What is written with AltGr, or composed, is no command.
        for with in ["modifierAltGraph", "isComposing"] {
            let walk = format!(
                "new KeyboardEvent('keydown', {{ key: 'w', code: 'KeyW', bubbles: true, {with}: true }})"
            );
            self.browser.run(&format!("document.body.dispatchEvent({walk})"))?;
            self.stays_at_rest()?;
        }
        // Who types does not watch.
        self.walk(|desk| desk.browser.press('w'))?;
        self.browser.run(
            "document.getElementById('settings').open = true; document.getElementById('settings-find').focus()",
        )?;
        self.until_resting()?;
        self.until("settings", |desk| {
            desk.browser
                .run("return document.getElementById('setting-current_limit') !== null")
                .map(|it| it == true)
        })?;
        // A wheel over a field is none over its value.
        let wheel = "const input = document.getElementById('setting-current_limit');
                     input.disabled = false; input.focus();
                     const before = input.value;
                     input.dispatchEvent(new WheelEvent('wheel', { deltaY: 1, cancelable: true }));
                     const after = input.value;
                     input.blur();
                     return before !== '' && before === after && input.type === 'text'";
        if self.browser.run(wheel)? != true {
            return Err("a wheel changes a setting".into());
        }
        Ok(())
    }

    fn freeze(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.push_from_neutral([1.0, 0.0]))?;
        let hang = "setTimeout(() => { const end = Date.now() + 4000; while (Date.now() < end); })";
        // The browser may answer only when the page does.
        let left = self.seen()?.now;
        self.browser.run(hang)?;
        self.rests_since(left)?;
        // It thaws with its stick still pushed, and does not walk on.
        self.until_armed()?;
        self.until_text("gamepad", "let go of stick and buttons first")?;
        self.stays_at_rest()
    }

    /// A connection may lose what the page sends, and bring pictures all the while.
    fn lost_stop(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        // The second time it is stopped already, as an old picture may show.
        for _ in 0..2 {
            self.browser.run(
                "const { prototype } = WebSocket, send = prototype.send;
                 let first;
                 prototype.send = function (text) {
                   const isStop = text.includes('stop');
                   if (isStop) first ??= this;
                   if (!isStop || first !== this) send.call(this, text);
                 };",
            )?;
            self.browser.touch("#stop")?;
            self.until_banner("STOP may not have arrived")?;
            self.until_banner("Stopped by")?;
            self.until_resting()?;
        }
        // So long ago was what a page shows now.
        self.browser.run(
            "const now = performance.now.bind(performance); performance.now = () => now() + 3000;",
        )?;
        self.until_banner("The connection is slow: this was 3 s ago.")?;
        // Without answers nothing more comes, though the connection stands.
        self.browser.run("WebSocket.prototype.send = () => {};")?;
        self.until_banner("The connection is slow: nothing has come for")
    }

    fn until_banner(&self, text: &str) -> Outcome<()> {
        let said = "return document.getElementById('banner-text').textContent";
        self.until(text, |desk| {
            Ok(desk.browser.run(said)?.as_str().is_some_and(|said| said.starts_with(text)))
        })
    }

    #[cfg(unix)]
    fn silent_program(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let left = self.seen()?.now;
        self.browser.run(NOTE_WHAT_IS_DONE)?;
        hang(self.program.id, true)?;
        let silent = self
            .until_banner("No connection")
            .and_then(|()| self.browser.touch("#stop"))
            .and_then(|()| self.until_banner("STOP may not have arrived"))
            .and_then(|()| self.until_text("f", "–"))
            .and_then(|()| {
                let first = |desk: &Self| desk.browser.run("return window.done.slice(0, 2).join()");
                self.until("says so, then gives up", |desk| Ok(first(desk)? == "says so,gives up"))
            });
        hang(self.program.id, false)?;
        silent?;
        self.rests_since(left)?;
        self.until_text("state", "stopped")
    }

    fn two_pages(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        let first = self.browser.window()?;
        let second = self.browser.open_window()?;
        self.browser.switch(&second)?;
        self.browser.go(&self.program.url)?;
        self.until("watching", |desk| {
            let text =
                desk.browser.run("return document.getElementById('banner-text').textContent")?;
            Ok(text.as_str().is_some_and(|text| text.contains("watches")))
        })?;
        self.browser.press(ENTER)?;
        self.browser.touch("#stop")?;
        self.until_text("state", "stopped")?;
        self.until_resting()?;
        let take = |desk: &Self| desk.browser.touch("#drive");
        self.command("driving", take, |desk| {
            desk.browser.run("return document.getElementById('drive').hidden").map(|it| it == true)
        })?;
        self.browser.switch(&first)?;
        self.until("watching", |desk| {
            desk.browser.run("return document.getElementById('drive').hidden").map(|it| it == false)
        })?;
        self.browser.switch(&second)
    }

    fn dies(&mut self) -> Outcome<()> {
        self.arm()?;
        self.walk(|desk| desk.browser.press('w'))?;
        // It takes its time where the machine is busy, and its page goes on until then.
        self.browser.kill()?;
        self.rests_since(self.seen()?.now)
    }
}
