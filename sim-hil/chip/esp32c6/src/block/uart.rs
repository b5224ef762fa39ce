//! UART0: both FIFOs, at the baud rate that its clock and dividers give (technical reference manual, chapter 27).
//!
//! What the other end of the wire sends or understands depends on the rate: more than [`TOLERANCE`] off, bytes arrive
//! mangled.

use std::collections::VecDeque;

use super::clock::Clocks;
use super::{Answer, CYCLES_PER_SECOND, NEVER, Unmodelled};
use crate::registers::Values;

const FIFO: u32 = 0x00;
const INTERRUPT_RAW: u32 = 0x04;
const INTERRUPT_STATUS: u32 = 0x08;
const INTERRUPT_ENABLE: u32 = 0x0C;
const INTERRUPT_CLEAR: u32 = 0x10;
const DIVIDER: u32 = 0x14;
const STATUS: u32 = 0x1C;
const CONF0: u32 = 0x20;
const CONF1: u32 = 0x24;
const TIMEOUT: u32 = 0x64;
const STATE: u32 = 0x70;
const UPDATE: u32 = 0x98;

/// Bytes in each FIFO.
const DEPTH: usize = 128;
/// Start bit, eight data bits, stop bit.
const BITS_OF_A_BYTE: u64 = 10;
/// Rates that differ by more are not understood: a byte of ten bits bears 4 to 5 %, of which the other end has its half.
const TOLERANCE: f64 = 0.02;
/// Rate of the wire, baud: a monitor's.
const WIRE_BAUD: f64 = 115_200.0;

const RECEIVER_FULL: u32 = 1 << 0;
const TRANSMITTER_EMPTY: u32 = 1 << 1;
const OVERFLOW: u32 = 1 << 4;
const RECEIVER_TIMEOUT: u32 = 1 << 8;
const TRANSMITTER_DONE: u32 = 1 << 14;

/// The block and both directions of its wire.
pub(crate) struct Uart {
    pub(crate) values: Values,
    receiver: VecDeque<u8>,
    transmitter: VecDeque<u8>,
    raw: u32,
    /// Cycles that a byte takes at the block's own rate; [`NEVER`] without a clock.
    byte_cycles: u64,
    /// When the byte that is being shifted out has left.
    leaves_at: u64,
    /// What the other end has sent and has not arrived.
    incoming: VecDeque<u8>,
    arrives_at: u64,
    /// When the receiver has been silent for its timeout.
    silent_at: u64,
    /// What has left, for whoever listens.
    pub(crate) sent: Vec<u8>,
    /// Bytes written into a full FIFO, which are gone.
    pub(crate) lost: u64,
}

impl Uart {
    /// Creates the port as the ROM leaves it: 115,200 baud.
    pub(crate) fn new(clocks: &Clocks) -> Self {
        let mut values = Values::reset("UART0");
        values.set(DIVIDER, 347 | 3 << 20);
        let mut uart = Self {
            values,
            receiver: VecDeque::new(),
            transmitter: VecDeque::new(),
            raw: 0,
            byte_cycles: NEVER,
            leaves_at: NEVER,
            incoming: VecDeque::new(),
            arrives_at: NEVER,
            silent_at: NEVER,
            sent: Vec::new(),
            lost: 0,
        };
        uart.retime(clocks);
        uart
    }

    /// Returns the baud rate as configured; 0 without a clock.
    pub(crate) fn baud(&self, clocks: &Clocks) -> f64 {
        let divider = f64::from(self.values.field(DIVIDER, 0, 12))
            + f64::from(self.values.field(DIVIDER, 20, 4)) / 16.0;
        if divider < 1.0 { 0.0 } else { clocks.uart0_hz() as f64 / divider }
    }

    /// Works at the rate that configuration and clock now give.
    pub(crate) fn retime(&mut self, clocks: &Clocks) {
        let baud = self.baud(clocks);
        self.byte_cycles = match baud > 0.0 {
            true => (CYCLES_PER_SECOND as f64 * BITS_OF_A_BYTE as f64 / baud) as u64,
            false => NEVER,
        };
    }

    /// What the two ends make of a byte, their rates being what they are.
    fn on_the_wire(&self, byte: u8) -> u8 {
        let own = CYCLES_PER_SECOND as f64 * BITS_OF_A_BYTE as f64 / self.byte_cycles as f64;
        let fits = (own / WIRE_BAUD - 1.0).abs() < TOLERANCE;
        if fits { byte } else { byte.rotate_left(3) ^ 0x80 }
    }

    /// Receives bytes that the other end sends.
    pub(crate) fn feed(&mut self, bytes: &[u8], now: u64) {
        if self.incoming.is_empty() && !bytes.is_empty() {
            self.arrives_at = now + wire_cycles();
        }
        self.incoming.extend(bytes);
    }

    /// Bytes that have not arrived.
    pub(crate) fn incoming(&self) -> usize {
        self.incoming.len()
    }

    pub(crate) fn next_event(&self) -> u64 {
        self.leaves_at.min(self.arrives_at).min(self.silent_at)
    }

    /// Lets happen what is due. `pins` say whether transmitter and receiver are connected to theirs.
    pub(crate) fn advance(&mut self, now: u64, pins: [bool; 2]) {
        while self.leaves_at <= now {
            if let Some(byte) = self.transmitter.pop_front()
                && pins[0]
            {
                let byte = self.on_the_wire(byte);
                self.sent.push(byte);
            }
            self.leaves_at = match self.transmitter.is_empty() {
                true => NEVER,
                false => self.leaves_at.saturating_add(self.byte_cycles),
            };
            if self.transmitter.is_empty() {
                self.raw |= TRANSMITTER_DONE;
            }
        }
        while self.arrives_at <= now {
            let at = self.arrives_at;
            if let Some(byte) = self.incoming.pop_front() {
                self.receive(byte, at, pins[1]);
            }
            self.arrives_at = if self.incoming.is_empty() { NEVER } else { at + wire_cycles() };
        }
        if self.silent_at <= now {
            self.silent_at = NEVER;
            if !self.receiver.is_empty() {
                self.raw |= RECEIVER_TIMEOUT;
            }
        }
        self.latch();
    }

    fn receive(&mut self, byte: u8, at: u64, is_connected: bool) {
        if !is_connected || self.byte_cycles == NEVER {
            return;
        }
        if self.receiver.len() == DEPTH {
            self.raw |= OVERFLOW;
            return;
        }
        let byte = self.on_the_wire(byte);
        self.receiver.push_back(byte);
        if self.values.bit(TIMEOUT, 0) {
            let bits = u64::from(self.values.field(TIMEOUT, 2, 10));
            self.silent_at = at + bits * self.byte_cycles / BITS_OF_A_BYTE;
        }
    }

    /// Levels of the FIFOs become interrupts, and stay until cleared.
    fn latch(&mut self) {
        let full = self.values.field(CONF1, 0, 8) as usize;
        let empty = self.values.field(CONF1, 8, 8) as usize;
        if self.receiver.len() > full {
            self.raw |= RECEIVER_FULL;
        }
        if self.transmitter.len() < empty {
            self.raw |= TRANSMITTER_EMPTY;
        }
    }

    pub(crate) fn level(&self) -> bool {
        self.raw & self.values.get(INTERRUPT_ENABLE) != 0
    }

    /// Returns whether the transmitter takes another byte.
    pub(crate) fn has_room(&self) -> bool {
        self.transmitter.len() < DEPTH
    }

    /// Returns whether everything has left.
    pub(crate) fn is_idle(&self) -> bool {
        self.transmitter.is_empty()
    }

    /// Takes a byte to send; one into a full FIFO is lost.
    pub(crate) fn push(&mut self, byte: u8, now: u64) {
        if !self.has_room() {
            self.lost += 1;
            return;
        }
        self.transmitter.push_back(byte);
        if self.leaves_at == NEVER {
            self.leaves_at = now.saturating_add(self.byte_cycles);
        }
    }

    pub(crate) fn read(&mut self, offset: u32) -> Answer<u32> {
        Ok(match offset {
            FIFO => u32::from(self.receiver.pop_front().unwrap_or(0)),
            INTERRUPT_RAW => self.raw,
            INTERRUPT_STATUS => self.raw & self.values.get(INTERRUPT_ENABLE),
            STATUS => self.receiver.len() as u32 | (self.transmitter.len() as u32) << 16,
            // Idle, or sending.
            STATE => u32::from(!self.transmitter.is_empty()) << 4,
            UPDATE => 0,
            _ => self.values.get(offset),
        })
    }

    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        clocks: &Clocks,
    ) -> Answer<()> {
        match offset {
            FIFO => self.push(value as u8, now),
            INTERRUPT_CLEAR => {
                self.raw &= !value;
                self.latch();
            }
            DIVIDER => {
                self.values.set(offset, value);
                self.retime(clocks);
            }
            CONF0 => {
                if value & 0x3 != 0 || value >> 2 & 3 != 3 || value >> 4 & 3 != 1 {
                    return Err(Unmodelled::Value("other formats than 8N1 are not modelled"));
                }
                if value >> 22 & 1 == 1 {
                    self.receiver.clear();
                }
                if value >> 23 & 1 == 1 {
                    self.transmitter.clear();
                    self.leaves_at = NEVER;
                }
                self.values.set(offset, value);
            }
            INTERRUPT_ENABLE | CONF1 | TIMEOUT | 0x18 | 0x2C | 0x3C..=0x5C | 0x60 | 0x88 => {
                self.values.set(offset, value);
                self.latch();
            }
            UPDATE => {}
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }
}

/// Cycles that a byte takes at the wire's rate.
fn wire_cycles() -> u64 {
    (CYCLES_PER_SECOND as f64 * BITS_OF_A_BYTE as f64 / WIRE_BAUD) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const PINS: [bool; 2] = [true; 2];

    #[test]
    fn a_byte_takes_eighty_seven_microseconds_and_a_full_fifo_loses_the_next() {
        let clocks = Clocks::new();
        let mut uart = Uart::new(&clocks);
        for byte in 0..130 {
            uart.push(byte, 0);
        }
        assert_eq!(uart.lost, 2);
        let micros = uart.next_event() * 1_000_000 / CYCLES_PER_SECOND;
        assert_eq!(micros, 86);
        uart.advance(uart.next_event(), PINS);
        assert_eq!(uart.sent, [0]);
    }

    #[test]
    fn at_another_rate_than_the_wires_bytes_are_mangled() {
        let clocks = Clocks::new();
        let mut uart = Uart::new(&clocks);
        uart.write(DIVIDER, 694, 0, &clocks).unwrap();
        uart.push(b'a', 0);
        uart.advance(CYCLES_PER_SECOND, PINS);
        assert_ne!(uart.sent, b"a");
    }

    #[test]
    fn without_its_pins_nothing_leaves_and_nothing_arrives() {
        let clocks = Clocks::new();
        let mut uart = Uart::new(&clocks);
        uart.push(b'a', 0);
        uart.feed(b"b", 0);
        uart.advance(CYCLES_PER_SECOND, [false; 2]);
        assert!(uart.sent.is_empty());
        assert_eq!(uart.read(STATUS).unwrap(), 0);
    }
}
