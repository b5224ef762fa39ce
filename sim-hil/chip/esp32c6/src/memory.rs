//! The chip's memories: addresses as in the technical reference manual, chapter 5.

/// Addresses of the ROM.
pub(crate) const ROM: u32 = 0x4000_0000;
pub(crate) const ROM_BYTES: u32 = 0x5_0000;
/// Working memory, also executed.
pub(crate) const RAM: u32 = 0x4080_0000;
/// 512 KiB.
pub(crate) const RAM_BYTES: usize = 0x8_0000;
/// Memory of the ROM, which nothing else here uses.
pub(crate) const SCRATCH: u32 = RAM + RAM_BYTES as u32 - 0x40;
/// What the boot loader uses of it, from its code on (esp-hal 1.2, `ld/esp32c6/memory.x`): a program may have it later.
pub(crate) const BOOT_LOADER: std::ops::Range<u32> = 0x4086_E610..0x4087_E610;
/// Where flash is mapped, executed and read.
pub(crate) const FLASH: u32 = 0x4200_0000;
/// As much of it as a flash of 4 MiB fills.
pub(crate) const FLASH_BYTES: usize = 0x40_0000;
/// Memory of the low-power side, which survives every reset but power-on.
const LP_RAM: u32 = 0x5000_0000;
const LP_RAM_BYTES: usize = 0x4000;
/// Where the radio keeps its frames. Outside of the chip's memory, so that what the closed library would take of it is
/// not taken from the image.
pub(crate) const RADIO: u32 = 0x40A0_0000;
/// Enough for its receive buffers.
pub(crate) const RADIO_BYTES: usize = 0x2_0000;

/// What fills memory at power-on, and what the boot loader leaves of its own, to be found again where nothing wrote.
pub(crate) const PAINT: u8 = 0xA5;

/// All of them.
pub(crate) struct Memory {
    pub(crate) ram: Vec<u8>,
    /// What the cache shows of the flash: the image's code and constants.
    pub(crate) flash: Vec<u8>,
    lp_ram: Vec<u8>,
    radio: Vec<u8>,
}

impl Memory {
    /// Creates the memories as they are at power-on.
    pub(crate) fn new() -> Self {
        Self {
            ram: vec![PAINT; RAM_BYTES],
            flash: vec![0xFF; FLASH_BYTES],
            lp_ram: vec![0; LP_RAM_BYTES],
            radio: vec![0; RADIO_BYTES],
        }
    }

    /// Returns the `length` bytes at an address, to read.
    pub(crate) fn bytes(&self, address: u32, length: usize) -> Option<&[u8]> {
        let (memory, base) = match address {
            RAM..=0x4087_FFFF => (&self.ram, RAM),
            FLASH..=0x423F_FFFF => (&self.flash, FLASH),
            LP_RAM..=0x5000_3FFF => (&self.lp_ram, LP_RAM),
            RADIO..=0x40A1_FFFF => (&self.radio, RADIO),
            _ => return None,
        };
        memory.get((address - base) as usize..)?.get(..length)
    }

    /// Returns the `length` bytes at an address, to write; none of flash.
    pub(crate) fn bytes_mut(&mut self, address: u32, length: usize) -> Option<&mut [u8]> {
        let (memory, base) = match address {
            RAM..=0x4087_FFFF => (&mut self.ram, RAM),
            LP_RAM..=0x5000_3FFF => (&mut self.lp_ram, LP_RAM),
            RADIO..=0x40A1_FFFF => (&mut self.radio, RADIO),
            _ => return None,
        };
        memory.get_mut((address - base) as usize..)?.get_mut(..length)
    }

    /// Returns the little-endian number of `size` bytes (1, 2, 4) at an address.
    pub(crate) fn load(&self, address: u32, size: u32) -> Option<u32> {
        let bytes = self.bytes(address, size as usize)?;
        Some(bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    /// Stores the lowest `size` bytes of a number.
    pub(crate) fn store(&mut self, address: u32, value: u32, size: u32) -> Option<()> {
        let bytes = self.bytes_mut(address, size as usize)?;
        bytes.copy_from_slice(&value.to_le_bytes()[..size as usize]);
        Some(())
    }

    /// Returns the instruction bits at an even address; above the end of a memory its upper half is zero.
    pub(crate) fn fetch(&self, address: u32) -> Option<u32> {
        self.load(address, 4).or_else(|| self.load(address, 2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_ends_where_the_chips_ends() {
        let mut memory = Memory::new();
        assert!(memory.store(RAM + RAM_BYTES as u32 - 4, 7, 4).is_some());
        assert!(memory.store(RAM + RAM_BYTES as u32 - 2, 7, 4).is_none());
        assert!(memory.store(FLASH, 7, 4).is_none(), "flash is not written by stores");
        assert_eq!(memory.load(RAM + RAM_BYTES as u32 - 4, 4), Some(7));
    }
}
