//! The SPI master (SPI2): full duplex, up to 64 bytes from its own buffer (technical reference manual, chapter 29).
//!
//! Registers reach the part that shifts only through `cmd.update`. Commands, addresses, dummy bits, several lines, DMA
//! and slave operation are not modelled.

use super::{Answer, NEVER, Unmodelled, cycles_of};
use crate::registers::Values;

const COMMAND: u32 = 0x00;
const CONTROL: u32 = 0x08;
const CLOCK: u32 = 0x0C;
const USER: u32 = 0x10;
const LENGTH: u32 = 0x1C;
const MISC: u32 = 0x20;
const DMA: u32 = 0x30;
const INTERRUPT_ENABLE: u32 = 0x34;
const INTERRUPT_CLEAR: u32 = 0x38;
const INTERRUPT_RAW: u32 = 0x3C;
const INTERRUPT_STATUS: u32 = 0x40;
const BUFFER: u32 = 0x98;
const SLAVE: u32 = 0xE0;
const CLOCK_GATE: u32 = 0xE8;

const START: u32 = 1 << 24;
const TAKE_OVER: u32 = 1 << 23;
const DONE: u32 = 1 << 12;
/// Bytes of the buffer.
const BUFFER_BYTES: usize = 64;

/// What the master clocks out and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Transfer {
    /// Mode 0 to 3: clock polarity and phase.
    pub mode: u8,
    /// Clock, hertz.
    pub hertz: u64,
    /// Length, bits.
    pub bits: usize,
    /// What goes out, most significant bit first.
    pub data: Vec<u8>,
}

/// What the shifting part works with.
#[derive(Debug, Clone, Copy, Default)]
struct Setup {
    user: u32,
    misc: u32,
    clock: u32,
    length: u32,
}

/// The block.
pub(crate) struct Spi {
    pub(crate) values: Values,
    setup: Setup,
    done_at: u64,
    raw: u32,
    answer: Vec<u8>,
    /// Transfers so far.
    pub(crate) transfers: u64,
}

impl Spi {
    pub(crate) fn new() -> Self {
        Self {
            values: Values::reset("SPI2"),
            setup: Setup::default(),
            done_at: NEVER,
            raw: 0,
            answer: Vec::new(),
            transfers: 0,
        }
    }

    fn settle(&mut self, now: u64) {
        if self.done_at > now {
            return;
        }
        self.done_at = NEVER;
        self.raw |= DONE;
        for (index, bytes) in std::mem::take(&mut self.answer).chunks(4).enumerate() {
            let mut word = [0; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            self.values.set(BUFFER + 4 * index as u32, u32::from_le_bytes(word));
        }
    }

    pub(crate) fn next_event(&self) -> u64 {
        if self.values.get(INTERRUPT_ENABLE) & DONE == 0 { NEVER } else { self.done_at }
    }

    pub(crate) fn advance(&mut self, now: u64) {
        self.settle(now);
    }

    pub(crate) fn level(&self) -> bool {
        self.raw & self.values.get(INTERRUPT_ENABLE) != 0
    }

    pub(crate) fn read(&mut self, offset: u32, now: u64) -> Answer<u32> {
        self.settle(now);
        Ok(match offset {
            COMMAND => {
                if self.done_at == NEVER {
                    0
                } else {
                    START
                }
            }
            INTERRUPT_RAW => self.raw,
            INTERRUPT_STATUS => self.raw & self.values.get(INTERRUPT_ENABLE),
            _ => self.values.get(offset),
        })
    }

    /// Writes a register; the transfer that it started, if it started one. `clock_hz` is the block's function clock.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        clock_hz: u64,
    ) -> Answer<Option<Transfer>> {
        self.settle(now);
        match offset {
            COMMAND => {
                if value & TAKE_OVER != 0 {
                    self.setup = Setup {
                        user: self.values.get(USER),
                        misc: self.values.get(MISC),
                        clock: self.values.get(CLOCK),
                        length: self.values.get(LENGTH),
                    };
                }
                if value & START != 0 {
                    return self.start(now, clock_hz).map(Some);
                }
            }
            INTERRUPT_CLEAR => self.raw &= !value,
            CONTROL if value >> 23 & 0xF != 0 => {
                return Err(Unmodelled::Value("the least significant bit first"));
            }
            DMA if value & 3 << 27 != 0 => return Err(Unmodelled::Value("DMA")),
            SLAVE if value >> 26 & 1 == 1 => return Err(Unmodelled::Value("slave operation")),
            CONTROL..=MISC | 0x24..=0x2C | DMA | INTERRUPT_ENABLE | SLAVE | CLOCK_GATE => {
                self.values.set(offset, value);
            }
            BUFFER..=0xD4 => self.values.set(offset, value),
            _ => return Err(Unmodelled::Register),
        }
        Ok(None)
    }

    fn start(&mut self, now: u64, clock_hz: u64) -> Answer<Transfer> {
        let Setup { user, misc, clock, length } = self.setup;
        let several_lines = 1 << 3 | 1 << 4 | 7 << 12 | 1 << 17;
        let phases = 7 << 29;
        let halves_of_the_buffer = 3 << 24;
        if user & (several_lines | phases | halves_of_the_buffer) != 0 {
            return Err(Unmodelled::Value("a transfer of other phases, lines or half a buffer"));
        }
        let bits = (length & 0x3_FFFF) as usize + 1;
        let bytes = bits.div_ceil(8);
        if bytes > BUFFER_BYTES {
            return Err(Unmodelled::Value("a transfer longer than the buffer"));
        }
        let idles_high = misc >> 29 & 1;
        let out_edge = user >> 9 & 1;
        let mode = (idles_high << 1 | (out_edge ^ idles_high)) as u8;
        let has_gate = self.values.field(CLOCK_GATE, 0, 2) == 3;
        let clock_hz = if has_gate { clock_hz } else { 0 };
        let hertz = match clock >> 31 {
            1 => clock_hz,
            _ => {
                let divider =
                    u64::from((clock >> 18 & 0xF) + 1) * u64::from((clock >> 12 & 0x3F) + 1);
                clock_hz / divider
            }
        };
        let sends = user >> 27 & 1 == 1;
        let data = (0..bytes)
            .map(|index| {
                let word = self.values.get(BUFFER + (index as u32 & !3));
                if sends { word.to_le_bytes()[index & 3] } else { 0 }
            })
            .collect();
        // Without a clock it goes on for ever.
        self.done_at = now.saturating_add(cycles_of(bits as u64, hertz)).min(NEVER - 1);
        self.transfers += 1;
        Ok(Transfer { mode, hertz, bits, data })
    }

    /// Takes what came in meanwhile, to be found in the buffer when the transfer is done.
    pub(crate) fn answer(&mut self, bytes: Vec<u8>) {
        if self.setup.user >> 28 & 1 == 1 {
            self.answer = bytes;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const XTAL: u64 = 40_000_000;

    /// 8 MHz, mode 1, full duplex, 24 bits.
    fn set_up() -> Spi {
        let mut spi = Spi::new();
        for (offset, value) in [
            (CLOCK, 4 << 12 | 2 << 6 | 4),
            (USER, 1 | 1 << 9 | 3 << 27),
            (LENGTH, 23),
            (MISC, 0),
            (CLOCK_GATE, 3),
            (BUFFER, 0x0033_2211),
        ] {
            spi.write(offset, value, 0, XTAL).unwrap();
        }
        spi
    }

    #[test]
    fn a_transfer_has_the_mode_the_clock_and_the_length_of_the_registers() {
        let mut spi = set_up();
        spi.write(COMMAND, TAKE_OVER, 0, XTAL).unwrap();
        let transfer = spi.write(COMMAND, START, 0, XTAL).unwrap();
        let data = vec![0x11, 0x22, 0x33];
        assert_eq!(transfer, Some(Transfer { mode: 1, hertz: 8_000_000, bits: 24, data }));
        spi.answer(vec![1, 2, 3]);
        assert_eq!(spi.read(COMMAND, 479).unwrap(), START);
        assert_eq!(spi.read(COMMAND, 480).unwrap(), 0);
        assert_eq!(spi.read(BUFFER, 480).unwrap(), 0x0003_0201);
    }

    #[test]
    fn what_was_not_taken_over_has_no_effect() {
        let mut spi = set_up();
        let transfer = spi.write(COMMAND, START, 0, XTAL).unwrap().unwrap();
        assert_ne!(transfer.mode, 1);
        assert_eq!(transfer.bits, 1);
    }

    #[test]
    fn without_a_function_clock_a_transfer_never_ends() {
        let mut spi = set_up();
        spi.write(COMMAND, TAKE_OVER, 0, 0).unwrap();
        spi.write(COMMAND, START, 0, 0).unwrap();
        assert_eq!(spi.read(COMMAND, 1_000_000_000).unwrap(), START);
    }
}
