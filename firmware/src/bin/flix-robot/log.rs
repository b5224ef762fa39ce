//! The log: lines wait in a queue until the serial port takes them, so that nobody waits for the port.
//!
//! The port takes 87 microseconds a character; the fast loop comes every 100. A line is put into the queue whole, in the time
//! of a copy, or, when the queue is full, not at all. Answers over the serial port go the same way, so that no line falls
//! into one.

use core::cell::RefCell;
use core::fmt::{Arguments, Write};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use esp_hal::Async;
use esp_hal::uart::UartTx;
use heapless::{Deque, String};

/// Bytes that wait: everything that is said at start.
const QUEUE_BYTES: usize = 1024;
/// Longest line; what is longer is cut.
const LINE_BYTES: usize = 160;
/// Bytes that are given to the port at once.
const CHUNK_BYTES: usize = 32;
/// How often somebody who waits for an empty queue looks.
const LOOK_MILLISECONDS: u64 = 5;

static QUEUE: Mutex<CriticalSectionRawMutex, RefCell<Deque<u8, QUEUE_BYTES>>> =
    Mutex::new(RefCell::new(Deque::new()));
/// There is something in the queue.
static FILLED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Says something, as `println!` would.
macro_rules! log {
    ($($arguments:tt)*) => { $crate::log::line(format_args!($($arguments)*)) };
}
pub(crate) use log;

/// Puts a line into the queue.
pub(crate) fn line(arguments: Arguments<'_>) {
    let mut line = String::<LINE_BYTES>::new();
    // A line that is too long is cut.
    let _ = line.write_fmt(arguments);
    if line.push_str("\r\n").is_err() {
        line.truncate(LINE_BYTES - 2);
        let _ = line.push_str("\r\n");
    }
    put(line.as_bytes());
}

/// Puts bytes into the queue, all of them or none.
pub(crate) fn put(bytes: &[u8]) {
    QUEUE.lock(|queue| {
        let mut queue = queue.borrow_mut();
        if queue.capacity() - queue.len() >= bytes.len() {
            for byte in bytes {
                // There is room.
                let _ = queue.push_back(*byte);
            }
        }
    });
    FILLED.signal(());
}

/// Waits until the port has taken everything.
pub(crate) async fn drained() {
    while QUEUE.lock(|queue| !queue.borrow().is_empty()) {
        Timer::after_millis(LOOK_MILLISECONDS).await;
    }
}

/// Gives the port what is in the queue, for ever.
#[embassy_executor::task]
pub(crate) async fn drain(mut port: UartTx<'static, Async>) {
    loop {
        let mut chunk = [0; CHUNK_BYTES];
        let length = QUEUE.lock(|queue| {
            let mut queue = queue.borrow_mut();
            let taken = chunk.iter_mut().map_while(|byte| {
                *byte = queue.pop_front()?;
                Some(())
            });
            taken.count()
        });
        if length == 0 {
            FILLED.wait().await;
            continue;
        }
        let mut rest = &chunk[..length];
        while let Ok(written @ 1..) = port.write_async(rest).await {
            rest = &rest[written..];
        }
    }
}
