//! Names, addresses and reset values of the chip's registers, from the table that `registers.py` writes.

use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Name and reset value of a register.
#[derive(Debug, Clone)]
pub(crate) struct Register {
    pub(crate) name: String,
    pub(crate) reset: u32,
}

/// A peripheral's registers.
#[derive(Debug)]
pub(crate) struct Block {
    pub(crate) name: &'static str,
    pub(crate) base: u32,
    /// By offset.
    pub(crate) registers: BTreeMap<u32, Register>,
}

impl Block {
    /// Returns the block and name of the register at an offset.
    pub(crate) fn register_name(&self, offset: u32) -> String {
        match self.registers.get(&offset) {
            Some(register) => format!("{}.{}", self.name, register.name),
            None => format!("{}+{offset:#x}", self.name),
        }
    }
}

/// All blocks of the table.
pub(crate) static BLOCKS: LazyLock<Vec<Block>> =
    LazyLock::new(|| parse(include_str!("../registers.txt")));

fn parse(table: &'static str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let number = |word: Option<&str>| {
        word.and_then(|word| u32::from_str_radix(word.trim_start_matches("0x"), 16).ok())
    };
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let mut words = line.split(' ');
        let first = words.next().unwrap_or_default();
        if first.starts_with(|letter: char| letter.is_ascii_uppercase()) {
            let base = number(words.next()).unwrap_or_default();
            blocks.push(Block { name: first, base, registers: BTreeMap::new() });
            continue;
        }
        let (offset, reset) = (number(Some(first)), number(words.next()));
        let (Some(block), Some(offset), Some(reset)) = (blocks.last_mut(), offset, reset) else {
            continue;
        };
        let name = words.next().unwrap_or_default();
        let count = words.next().and_then(|word| word.parse().ok()).unwrap_or(1);
        let stride = number(words.next()).unwrap_or(4);
        for index in 0..count {
            let name = if count > 1 { format!("{name}[{index}]") } else { name.to_owned() };
            block.registers.entry(offset + stride * index).or_insert(Register { name, reset });
        }
    }
    blocks
}

/// Returns the block of this name in the table. Panics where there is none: names are written in this crate.
pub(crate) fn block(name: &str) -> &'static Block {
    let found = BLOCKS.iter().find(|block| block.name == name);
    found.expect("the table has every block that a model names")
}

/// What the registers of a block hold.
#[derive(Debug, Clone)]
pub(crate) struct Values {
    pub(crate) block: &'static Block,
    words: Vec<u32>,
}

impl Values {
    /// Creates the registers of a block out of reset.
    pub(crate) fn reset(name: &str) -> Self {
        let block = block(name);
        let last = block.registers.keys().next_back().copied().unwrap_or(0);
        let mut words = vec![0; last as usize / 4 + 1];
        for (offset, register) in &block.registers {
            words[*offset as usize / 4] = register.reset;
        }
        Self { block, words }
    }

    /// Contents of the register at an offset; 0 beyond the last.
    pub(crate) fn get(&self, offset: u32) -> u32 {
        self.words.get(offset as usize / 4).copied().unwrap_or(0)
    }

    /// Returns `count` bits of it, from bit `low` on.
    pub(crate) fn field(&self, offset: u32, low: u32, count: u32) -> u32 {
        self.get(offset) >> low & ((1_u64 << count) - 1) as u32
    }

    /// Returns one bit of it.
    pub(crate) fn bit(&self, offset: u32, bit: u32) -> bool {
        self.get(offset) >> bit & 1 == 1
    }

    /// Fills the register at an offset.
    pub(crate) fn set(&mut self, offset: u32, value: u32) {
        if let Some(word) = self.words.get_mut(offset as usize / 4) {
            *word = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_have_the_names_and_reset_values_of_the_vendors_description() {
        let pcr = Values::reset("PCR");
        assert_eq!(pcr.block.base, 0x6009_6000);
        assert_eq!(pcr.block.register_name(0xA0), "PCR.pwm_clk_conf");
        assert_eq!(pcr.get(0xA0), 0x0040_4000);
        let gpio = Values::reset("GPIO");
        assert_eq!(gpio.block.register_name(0x554 + 4 * 18), "GPIO.func_out_sel_cfg[18]");
        assert_eq!(gpio.get(0x554 + 4 * 18), 0x80);
    }
}
