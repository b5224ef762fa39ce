//! Functions of the mask ROM that the image calls, done here by name: the ROM's code is not published.
//!
//! Each takes the cycles that its work would roughly take on the chip.

use std::collections::HashMap;

use md5::{Digest, Md5};

use crate::block::CYCLES_PER_SECOND;
use crate::block::flash::PowerLost;
use crate::cpu::Cpu;
use crate::fault::Trouble;
use crate::memory::{ROM, ROM_BYTES};
use crate::soc::{Outside, Soc};

/// A call and the return from it.
const CALL_CYCLES: u64 = 10;
/// An operation in floating point, in software.
const FLOAT_CYCLES: u64 = 60;
/// A look at a state that is waited for.
const POLL_CYCLES: u64 = 40;
/// Bytes that are copied, filled or compared in a cycle, on average.
const BYTES_A_CYCLE: u64 = 2;

/// How a call went on.
#[derive(Debug)]
pub(crate) enum Outcome {
    /// It returned.
    Returned,
    /// It waits: it is to be called again.
    Waits,
    /// The chip is reset by software.
    Reset,
    /// Power went while flash was written.
    PowerLost,
}

/// The ROM.
#[derive(Default)]
pub(crate) struct Rom {
    names: HashMap<u32, String>,
    /// Hashes that are being computed. The image moves its context, so that holds a handle.
    hashes: Vec<Md5>,
    /// Why the chip started last, as the ROM's numbers have it.
    pub(crate) reset_reason: u32,
    /// Longest time that a flash operation stopped everything, cycles.
    pub(crate) longest_flash: u64,
}

/// Arguments and results in registers.
fn a(cpu: &Cpu, index: usize) -> u32 {
    cpu.x[10 + index]
}

fn wide(cpu: &Cpu, index: usize) -> u64 {
    u64::from(a(cpu, index + 1)) << 32 | u64::from(a(cpu, index))
}

fn double(cpu: &Cpu, index: usize) -> f64 {
    f64::from_bits(wide(cpu, index))
}

fn single(cpu: &Cpu, index: usize) -> f32 {
    f32::from_bits(a(cpu, index))
}

impl Rom {
    /// Knows the functions that the image's symbols name.
    pub(crate) fn new(symbols: impl Iterator<Item = (u32, String)>) -> Self {
        let mut rom = Self::default();
        for (address, name) in symbols {
            if address.wrapping_sub(ROM) >= ROM_BYTES {
                continue;
            }
            // Of several names the compiler's own says what is meant.
            let is_better = name.starts_with("__") || name.starts_with("mem");
            if is_better || !rom.names.contains_key(&address) {
                rom.names.insert(address, name);
            }
        }
        rom
    }

    /// Does the function at the program counter.
    pub(crate) fn call<O: Outside>(
        &mut self,
        cpu: &mut Cpu,
        soc: &mut Soc<O>,
    ) -> Result<Outcome, Trouble> {
        let Some(name) = self.names.get(&cpu.pc).cloned() else {
            return Err(Trouble::Rom(format!("{:#010x}", cpu.pc)));
        };
        let waits = |cpu: &mut Cpu| {
            cpu.cycles += POLL_CYCLES;
            Ok(Outcome::Waits)
        };
        match name.as_str() {
            "uart_tx_one_char" | "esp_rom_output_tx_one_char" | "esp_rom_uart_tx_one_char" => {
                if !soc.uart.has_room() {
                    return waits(cpu);
                }
                let (byte, now) = (a(cpu, 0) as u8, cpu.cycles);
                soc.feed_transmitter(byte, now);
                Self::returns(cpu, 0, false, CALL_CYCLES);
                return Ok(Outcome::Returned);
            }
            "uart_tx_flush" | "uart_tx_wait_idle" | "esp_rom_uart_tx_wait_idle" => {
                if !soc.uart.is_idle() {
                    return waits(cpu);
                }
                Self::returns(cpu, 0, false, CALL_CYCLES);
                return Ok(Outcome::Returned);
            }
            "ets_delay_us" | "esp_rom_delay_us" => {
                // A microsecond at a time, so that interrupts come through.
                if a(cpu, 0) > 0 {
                    cpu.x[10] -= 1;
                    cpu.cycles += CYCLES_PER_SECOND / 1_000_000;
                    return Ok(Outcome::Waits);
                }
                Self::returns(cpu, 0, false, CALL_CYCLES);
                return Ok(Outcome::Returned);
            }
            "software_reset" | "software_reset_cpu" | "esp_rom_software_reset_system" => {
                return Ok(Outcome::Reset);
            }
            _ => {}
        }
        let flash = self.flash(&name, cpu, soc)?;
        if let Some(flash) = flash {
            return Ok(flash);
        }
        if let Some((result, cycles)) = self.memory(&name, cpu, soc)? {
            Self::returns(cpu, u64::from(result), false, cycles);
            return Ok(Outcome::Returned);
        }
        if let Some((result, is_wide)) = arithmetic(&name, cpu) {
            Self::returns(cpu, result, is_wide, FLOAT_CYCLES);
            return Ok(Outcome::Returned);
        }
        let result = match name.as_str() {
            "rtc_get_reset_reason" => self.reset_reason,
            "ets_update_cpu_frequency"
            | "ets_update_cpu_frequency_rom"
            | "esp_rom_set_cpu_ticks_per_us"
            | "ets_get_printf_channel" => 0,
            "ets_clk_get_xtal_freq" => 40_000_000,
            known if known.starts_with("Cache_") => 0,
            _ => return Err(Trouble::Rom(name)),
        };
        Self::returns(cpu, u64::from(result), false, CALL_CYCLES);
        Ok(Outcome::Returned)
    }

    fn returns(cpu: &mut Cpu, result: u64, is_wide: bool, cycles: u64) {
        cpu.x[10] = result as u32;
        if is_wide {
            cpu.x[11] = (result >> 32) as u32;
        }
        cpu.cycles += cycles;
        cpu.pc = cpu.x[1];
    }

    /// The ROM's flash driver. Nothing else runs meanwhile: the callers mask interrupts, and the cache is off.
    fn flash<O: Outside>(
        &mut self,
        name: &str,
        cpu: &mut Cpu,
        soc: &mut Soc<O>,
    ) -> Result<Option<Outcome>, Trouble> {
        let beyond = || Trouble::Rom(format!("{name}, beyond the flash or memory"));
        let (at, buffer, length) = (a(cpu, 0) as usize, a(cpu, 1), a(cpu, 2) as usize);
        let outcome = match name {
            "esp_rom_spiflash_unlock" => Ok(CALL_CYCLES),
            "esp_rom_spiflash_read" => {
                let bytes = soc.memory.bytes_mut(buffer, length).ok_or_else(beyond)?;
                Ok(soc.flash.read(at, bytes).ok_or_else(beyond)?)
            }
            "esp_rom_spiflash_write" => {
                let bytes = soc.memory.bytes(buffer, length).ok_or_else(beyond)?.to_vec();
                soc.flash.program(at, &bytes).ok_or_else(beyond)?
            }
            "esp_rom_spiflash_erase_sector" => soc.flash.erase(at).ok_or_else(beyond)?,
            _ => return Ok(None),
        };
        soc.early.flash.get_or_insert(cpu.cycles);
        if name == "esp_rom_spiflash_read" {
            cpu.forget(buffer, length);
        }
        Ok(Some(match outcome {
            Ok(cycles) => {
                self.longest_flash = self.longest_flash.max(cycles);
                Self::returns(cpu, 0, false, cycles);
                Outcome::Returned
            }
            Err(PowerLost) => Outcome::PowerLost,
        }))
    }

    /// Copying, comparing, hashing: result and cycles.
    fn memory<O: Outside>(
        &mut self,
        name: &str,
        cpu: &mut Cpu,
        soc: &mut Soc<O>,
    ) -> Result<Option<(u32, u64)>, Trouble> {
        let beyond = || Trouble::Rom(format!("{name}, beyond memory"));
        let (first, second, length) = (a(cpu, 0), a(cpu, 1), a(cpu, 2) as usize);
        let cycles = CALL_CYCLES + length as u64 / BYTES_A_CYCLE;
        let memory = &mut soc.memory;
        let result = match name {
            // Nothing, from or to a dangling pointer.
            "memcpy" | "memmove" | "memset" if length == 0 => {
                return Ok(Some((first, CALL_CYCLES)));
            }
            "memcmp" if length == 0 => return Ok(Some((0, CALL_CYCLES))),
            "memcpy" | "memmove" => {
                let bytes = memory.bytes(second, length).ok_or_else(beyond)?.to_vec();
                memory.bytes_mut(first, length).ok_or_else(beyond)?.copy_from_slice(&bytes);
                cpu.forget(first, length);
                first
            }
            "memset" => {
                memory.bytes_mut(first, length).ok_or_else(beyond)?.fill(second as u8);
                cpu.forget(first, length);
                first
            }
            "memcmp" => {
                let one = memory.bytes(first, length).ok_or_else(beyond)?;
                let other = memory.bytes(second, length).ok_or_else(beyond)?;
                one.cmp(other) as i32 as u32
            }
            "strlen" => {
                let mut length = 0;
                while memory.load(first.wrapping_add(length), 1).ok_or_else(beyond)? != 0 {
                    length += 1;
                }
                return Ok(Some((length, CALL_CYCLES + u64::from(length))));
            }
            "esp_rom_md5_init" | "MD5Init" => {
                let handle = self.hashes.len() as u32;
                self.hashes.push(Md5::new());
                memory.store(first, handle, 4).ok_or_else(beyond)?;
                return Ok(Some((0, CALL_CYCLES)));
            }
            "esp_rom_md5_update" | "MD5Update" => {
                let handle = memory.load(first, 4).ok_or_else(beyond)? as usize;
                let bytes = memory.bytes(second, length).ok_or_else(beyond)?;
                self.hashes.get_mut(handle).ok_or_else(beyond)?.update(bytes);
                return Ok(Some((0, CALL_CYCLES + 10 * length as u64)));
            }
            "esp_rom_md5_final" | "MD5Final" => {
                let handle = memory.load(second, 4).ok_or_else(beyond)? as usize;
                let sum = self.hashes.get(handle).ok_or_else(beyond)?.clone().finalize();
                memory.bytes_mut(first, sum.len()).ok_or_else(beyond)?.copy_from_slice(&sum);
                return Ok(Some((0, CALL_CYCLES)));
            }
            _ => return Ok(None),
        };
        Ok(Some((result, cycles)))
    }
}

/// The compiler's arithmetic on doubles, singles and 64 bits: result, and whether it takes two registers.
fn arithmetic(name: &str, cpu: &Cpu) -> Option<(u64, bool)> {
    use std::cmp::Ordering;
    let d = |index| double(cpu, index);
    let s = |index| single(cpu, index);
    let l = |index| wide(cpu, index);
    let order = |order: Option<Ordering>, unordered: i32| {
        (u64::from(order.map_or(unordered, |order| order as i32) as u32), false)
    };
    let of_double = |value: f64| (value.to_bits(), true);
    let of_single = |value: f32| (u64::from(value.to_bits()), false);
    let of_wide = |value: u64| (value, true);
    let of_word = |value: u32| (u64::from(value), false);
    let shift = a(cpu, 2) & 63;
    Some(match name {
        "__adddf3" => of_double(d(0) + d(2)),
        "__subdf3" => of_double(d(0) - d(2)),
        "__muldf3" => of_double(d(0) * d(2)),
        "__divdf3" => of_double(d(0) / d(2)),
        "__addsf3" => of_single(s(0) + s(1)),
        "__subsf3" => of_single(s(0) - s(1)),
        "__mulsf3" => of_single(s(0) * s(1)),
        "__divsf3" => of_single(s(0) / s(1)),
        "__muldi3" => of_wide(l(0).wrapping_mul(l(2))),
        "__divdi3" => of_wide((l(0) as i64).checked_div(l(2) as i64).unwrap_or(0) as u64),
        "__moddi3" => of_wide((l(0) as i64).checked_rem(l(2) as i64).unwrap_or(0) as u64),
        "__udivdi3" => of_wide(l(0).checked_div(l(2)).unwrap_or(0)),
        "__umoddi3" => of_wide(l(0).checked_rem(l(2)).unwrap_or(0)),
        "__ashldi3" => of_wide(l(0) << shift),
        "__lshrdi3" => of_wide(l(0) >> shift),
        "__ashrdi3" => of_wide((l(0) as i64 >> shift) as u64),
        "__eqdf2" | "__nedf2" | "__ltdf2" | "__ledf2" => order(d(0).partial_cmp(&d(2)), 1),
        "__gedf2" | "__gtdf2" => order(d(0).partial_cmp(&d(2)), -1),
        "__eqsf2" | "__nesf2" | "__ltsf2" | "__lesf2" => order(s(0).partial_cmp(&s(1)), 1),
        "__gesf2" | "__gtsf2" => order(s(0).partial_cmp(&s(1)), -1),
        "__unorddf2" => of_word((d(0).is_nan() || d(2).is_nan()).into()),
        "__unordsf2" => of_word((s(0).is_nan() || s(1).is_nan()).into()),
        "__extendsfdf2" => of_double(s(0).into()),
        "__truncdfsf2" => of_single(d(0) as f32),
        "__fixdfsi" => of_word(d(0) as i32 as u32),
        "__fixsfsi" => of_word(s(0) as i32 as u32),
        "__fixunsdfsi" => of_word(d(0) as u32),
        "__fixunssfsi" => of_word(s(0) as u32),
        "__fixsfdi" => of_wide(s(0) as i64 as u64),
        "__fixdfdi" => of_wide(d(0) as i64 as u64),
        "__fixunssfdi" => of_wide(s(0) as u64),
        "__fixunsdfdi" => of_wide(d(0) as u64),
        "__floatsidf" => of_double((a(cpu, 0) as i32).into()),
        "__floatunsidf" => of_double(a(cpu, 0).into()),
        "__floatsisf" => of_single(a(cpu, 0) as i32 as f32),
        "__floatunsisf" => of_single(a(cpu, 0) as f32),
        "__floatdisf" => of_single(l(0) as i64 as f32),
        "__floatundisf" => of_single(l(0) as f32),
        "__floatdidf" => of_double(l(0) as i64 as f64),
        "__floatundidf" => of_double(l(0) as f64),
        "__clzsi2" => of_word(a(cpu, 0).leading_zeros()),
        "__ctzsi2" => of_word(a(cpu, 0).trailing_zeros()),
        "__popcountsi2" => of_word(a(cpu, 0).count_ones()),
        "__bswapsi2" => of_word(a(cpu, 0).swap_bytes()),
        "__ffssi2" => of_word(match a(cpu, 0) {
            0 => 0,
            value => value.trailing_zeros() + 1,
        }),
        _ => return None,
    })
}
