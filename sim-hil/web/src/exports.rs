//! What a WebAssembly host calls, in plain C: lines of text go in and out through the module's memory.
//!
//! The host asks [`flix_input`] for room, writes a line there, and calls what takes it. Results lie at [`flix_output`];
//! each call returns their length, or the negative length of a sentence that says what was wrong.
#![allow(unsafe_code, reason = "exported names; no unsafe block is needed")]

use std::cell::RefCell;
use std::time::Duration;

use serde_json::json;

use crate::script;
use crate::world::{Options, Trouble, World};

/// What lies between two calls.
#[derive(Default)]
struct Desk {
    input: Vec<u8>,
    output: String,
    world: Option<World>,
}

thread_local! {
    static DESK: RefCell<Desk> = RefCell::default();
}

impl Desk {
    /// Does something with the line that was written.
    fn call(
        &mut self,
        what: impl FnOnce(&mut Option<World>, &str) -> Result<String, Trouble>,
    ) -> i32 {
        let line = String::from_utf8_lossy(&self.input).into_owned();
        let (sign, text) = match what(&mut self.world, &line) {
            Ok(text) => (1, text),
            Err(trouble) => (-1, trouble.to_string()),
        };
        self.output = text;
        sign * i32::try_from(self.output.len()).unwrap_or(i32::MAX)
    }
}

fn desk<T>(with: impl FnOnce(&mut Desk) -> T) -> T {
    DESK.with_borrow_mut(with)
}

fn present(world: &mut Option<World>) -> Result<&mut World, Trouble> {
    world.as_mut().ok_or_else(|| Trouble::Sentence("there is no world yet".to_owned()))
}

/// Returns room for a line of this length, bytes.
#[unsafe(no_mangle)]
extern "C" fn flix_input(length: usize) -> *mut u8 {
    desk(|desk| {
        desk.input.clear();
        desk.input.resize(length, 0);
        desk.input.as_mut_ptr()
    })
}

/// Returns where the last result lies.
#[unsafe(no_mangle)]
extern "C" fn flix_output() -> *const u8 {
    desk(|desk| desk.output.as_ptr())
}

/// Creates a world from its options, `{"model":"W","seed":1}`; the result is what the page is sent first.
#[unsafe(no_mangle)]
extern "C" fn flix_start() -> i32 {
    desk(|desk| {
        desk.call(|world, line| {
            let options: Options = serde_json::from_str(line)?;
            Ok(world.insert(World::new(&options)?).hello().to_string())
        })
    })
}

/// Takes a line of the page.
#[unsafe(no_mangle)]
extern "C" fn flix_say() -> i32 {
    desk(|desk| {
        desk.call(|world, line| {
            let world = present(world)?;
            if let Err(trouble) = world.say(line) {
                world.complain(&trouble);
            }
            Ok(String::new())
        })
    })
}

/// Advances the world by so much, milliseconds.
#[unsafe(no_mangle)]
extern "C" fn flix_advance(milliseconds: u32) -> i32 {
    desk(|desk| {
        desk.call(|world, _| {
            let world = present(world)?;
            let until = world.now() + Duration::from_millis(milliseconds.into());
            world.advance(until, |_| {}).map(|()| String::new())
        })
    })
}

/// Returns what the page shows.
#[unsafe(no_mangle)]
extern "C" fn flix_snapshot() -> i32 {
    desk(|desk| desk.call(|world, _| Ok(present(world)?.snapshot().to_string())))
}

/// Runs the script in the line, or where that is empty the usual one, for so many milliseconds.
#[unsafe(no_mangle)]
extern "C" fn flix_script(milliseconds: u32) -> i32 {
    desk(|desk| {
        desk.call(|_, line| {
            let script = if line.is_empty() { script::SCRIPT } else { line };
            let seconds = f64::from(milliseconds) * 1e-3;
            let verdict = script::run(&Options::default(), script, seconds)?;
            Ok(json!({ "hash": verdict.hash, "moved": verdict.moved }).to_string())
        })
    })
}
