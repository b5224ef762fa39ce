//! The log: lines wait in a queue until the serial port takes them, so that nobody waits for the port.
//!
//! The port takes 87 microseconds a character; the fast loop comes every 100. A line is put into the queue whole, in the time
//! of a copy, or, when the queue is full, not at all. Answers over the serial port go the same way, so that no line falls
//! into one.

use core::fmt::{Arguments, Write};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_time::Timer;
use esp_hal::Async;
use esp_hal::uart::UartTx;
use heapless::String;

/// Bytes that wait: everything that is said at start.
const QUEUE_BYTES: usize = 1024;
/// Longest line; what is longer is cut.
const LINE_BYTES: usize = 160;
/// Bytes that are given to the port at once.
const CHUNK_BYTES: usize = 32;
/// How often somebody who waits for an empty queue looks.
const LOOK_MILLISECONDS: u64 = 5;

static QUEUE: Pipe<CriticalSectionRawMutex, QUEUE_BYTES> = Pipe::new();

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
pub(crate) fn put(mut bytes: &[u8]) {
    critical_section::with(|_| {
        if QUEUE.free_capacity() >= bytes.len() {
            // In two parts where the queue's end lies within the bytes.
            while let Ok(written @ 1..) = QUEUE.try_write(bytes) {
                bytes = &bytes[written..];
            }
        }
    });
}

/// Waits until the port has taken everything.
pub(crate) async fn drained() {
    while !QUEUE.is_empty() {
        Timer::after_millis(LOOK_MILLISECONDS).await;
    }
}

/// Gives the port what is in the queue, for ever.
#[embassy_executor::task]
pub(crate) async fn drain(mut port: UartTx<'static, Async>) {
    let mut chunk = [0; CHUNK_BYTES];
    loop {
        let length = QUEUE.read(&mut chunk).await;
        let mut rest = &chunk[..length];
        while let Ok(written @ 1..) = port.write_async(rest).await {
            rest = &rest[written..];
        }
    }
}
