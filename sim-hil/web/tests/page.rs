//! The packed page in a real browser, as a file: it loads, walks, shows a fault in words, and its
//! robot is the native one, bit for bit.
//!
//! Skipped without `chromedriver` (Debian: `chromium chromium-driver`) or the page (`cargo xtask web`), unless
//! FLIX_REQUIRE_BROWSER is set; with FLIX_WITHOUT_BROWSER it is in any case.

#[path = "../../cli/tests/cockpit/browser.rs"]
#[allow(dead_code, reason = "shared with the test of the cockpit, which needs more of it")]
mod browser;

use std::path::Path;
use std::time::{Duration, Instant};

use browser::{Browser, Engine};
use flix_web::{Options, script};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Time after which something hangs.
const PATIENCE: Duration = Duration::from_secs(120);
/// Pause between two looks at a condition.
const LOOK: Duration = Duration::from_millis(20);
/// Pause before a key is pressed again.
const AGAIN: Duration = Duration::from_secs(1);
/// Whether the page says that it took an input too late.
const LATE: &str = "document.getElementById('note').textContent.includes('passed over')";
const ENTER: char = '\u{e007}';

/// Opens the page; nothing where it is to be skipped.
fn open() -> Outcome<Option<Browser>> {
    let target = Path::new(env!("CARGO_BIN_EXE_flix-web")).ancestors().nth(2).ok_or("no target")?;
    let page = target.join("site/index.html");
    let missing = "no page (`cargo xtask web`) or no browser (`apt install chromium-driver`)";
    if !Browser::is_to_be_tried(Engine::Chromium, page.exists(), missing)? {
        return Ok(None);
    }
    let browser = Browser::open(Engine::Chromium)?;
    browser.go(&format!("file://{}", page.display()))?;
    Ok(Some(browser))
}

/// Looks until a JavaScript expression is true.
fn wait(browser: &Browser, condition: &str) -> Outcome<()> {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        if browser.run(&format!("return Boolean({condition})"))?.as_bool() == Some(true) {
            return Ok(());
        }
        std::thread::sleep(LOOK);
    }
    let text = browser.run("return document.body.innerText")?;
    Err(format!("still not: {condition}; the page shows:\n{text}").into())
}

/// Presses a key until a JavaScript expression is true; again where the page was too busy to take it in time, as a person
/// does who reads that.
fn press(browser: &Browser, key: char, condition: &str) -> Outcome<()> {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        browser.press(key)?;
        wait(browser, &format!("{condition} || {LATE}"))?;
        if browser.run(&format!("return Boolean({condition})"))?.as_bool() == Some(true) {
            return Ok(());
        }
        std::thread::sleep(AGAIN);
    }
    Err(format!("the page is too busy for {key:?}").into())
}

fn state(name: &str) -> String {
    format!("document.getElementById('state').dataset.state === '{name}'")
}

#[test]
fn a_visitor_drives_and_breaks_the_robot() -> Outcome<()> {
    let Some(browser) = open()? else { return Ok(()) };
    wait(&browser, "!document.querySelector('.row [data-do=arm]').disabled")?;
    let shakes =
        "Math.abs(parseFloat(document.getElementById('f').textContent.replace('−', '-'))) > 25";
    press(&browser, ENTER, &state("armed"))?;
    press(&browser, 'w', shakes)?;
    // How long that takes is the computer's, which others may keep busy.
    println!("first motion by {} s of the page", browser.run("return performance.now() / 1000")?);

    browser.run("const fault = document.getElementById('fault'); fault.value = 'top encoder lost'; fault.onchange()")?;
    wait(&browser, &state("faulted"))?;
    wait(
        &browser,
        "/encoder.*Then press Clear/s.test(document.getElementById('banner-text').textContent)",
    )?;
    Ok(())
}

#[test]
fn an_input_that_a_busy_page_takes_late_does_nothing_and_is_named() -> Outcome<()> {
    let Some(browser) = open()? else { return Ok(()) };
    wait(&browser, "!document.querySelector('.row [data-do=arm]').disabled")?;
    browser.run(
        "const key = new KeyboardEvent('keydown', { key: 'Enter', bubbles: true });
        const end = performance.now() + 500;
        while (performance.now() < end);
        document.body.dispatchEvent(key)",
    )?;
    wait(&browser, LATE)?;
    assert_eq!(browser.run(&format!("return {}", state("disarmed")))?.as_bool(), Some(true));
    Ok(())
}

#[test]
fn the_page_has_the_same_bits_as_the_native_program() -> Outcome<()> {
    let Some(browser) = open()? else { return Ok(()) };
    let native = script::run(&Options::default(), script::SCRIPT, 10.0)?;
    assert!(native.moved > 0.1, "{native:?}");
    browser.run("runScript().then((verdict) => { window.verdict = verdict; })")?;
    wait(&browser, "window.verdict")?;
    assert_eq!(browser.run("return window.verdict.hash")?, native.hash);
    Ok(())
}
