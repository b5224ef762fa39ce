//! Everything on the chip but the processor: where an address leads to, who interrupts, what happens next.

use std::collections::BTreeMap;

use crate::block::adc::Adc;
use crate::block::analog::Analog;
use crate::block::clock::{Clocks, Gate};
use crate::block::flash::Flash;
use crate::block::gpio::{Driver, Gpio};
use crate::block::held::Held;
use crate::block::interrupt::{Interrupts, source};
use crate::block::mcpwm::{Mcpwm, Wave};
use crate::block::spi::{Spi, Transfer};
use crate::block::system_timer::SystemTimer;
use crate::block::timer_group::{self, TimerGroup};
use crate::block::uart::Uart;
use crate::block::watchdog::{Action, LowPowerWatchdog};
use crate::block::{Answer, CYCLES_PER_SECOND, Unmodelled};
use crate::cpu::{Access, Bus, Refusal};
use crate::early::Early;
use crate::fault::{Fault, Trouble};
use crate::memory::Memory;
use crate::registers::{BLOCKS, Block};

/// What is soldered to the chip's pins.
pub trait Outside {
    /// The SPI master clocks a transfer at `cycles` of 160 MHz since power-on; what it reads, its length in bytes.
    fn exchange(&mut self, cycles: u64, pins: &Pins, transfer: &Transfer) -> Vec<u8>;

    /// Voltage at a pin that is measured, mV.
    fn millivolts(&mut self, cycles: u64, pin: u32) -> f64;
}

/// The pins as the chip drives them.
pub struct Pins<'a>(&'a Gpio);

impl Pins<'_> {
    /// Returns whether the SPI master's clock comes out of a pin.
    #[must_use]
    pub fn carries_spi_clock(&self, pin: u32) -> bool {
        self.0.driver(pin) == Driver::SpiClock
    }

    /// Returns whether the SPI master's data comes out of a pin.
    #[must_use]
    pub fn carries_spi_data(&self, pin: u32) -> bool {
        self.0.driver(pin) == Driver::SpiMosi
    }

    /// Returns the pin that the SPI master listens to.
    #[must_use]
    pub fn spi_input(&self) -> Option<u32> {
        self.0.spi_miso()
    }

    /// Returns the level of a plain output, or of a pin that is pulled; `None` where neither holds.
    #[must_use]
    pub fn level(&self, pin: u32) -> Option<bool> {
        self.0.level(pin)
    }
}

/// Something that the chip bears without a fault, but no program should do: an access to a block without a clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Times that it was done.
    pub count: u64,
    /// Where it was done first.
    pub pc: u32,
}

/// The model of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    Clocks,
    Uart,
    Timers(usize),
    SystemTimer,
    Matrix,
    Software,
    Controller,
    Mcpwm,
    Spi,
    Flash,
    Gpio,
    Pads,
    Adc,
    Analog,
    Watchdog,
    Held,
}

impl Model {
    fn of(block: &Block) -> Self {
        match block.name {
            "PCR" => Self::Clocks,
            "UART0" => Self::Uart,
            "TIMG0" => Self::Timers(0),
            "TIMG1" => Self::Timers(1),
            "SYSTIMER" => Self::SystemTimer,
            "INTERRUPT_CORE0" => Self::Matrix,
            "INTPRI" => Self::Software,
            "PLIC_MX" => Self::Controller,
            "MCPWM0" => Self::Mcpwm,
            "SPI2" => Self::Spi,
            "SPI1" => Self::Flash,
            "GPIO" => Self::Gpio,
            "IO_MUX" => Self::Pads,
            "APB_SARADC" => Self::Adc,
            "I2C_ANA_MST" => Self::Analog,
            "LP_WDT" => Self::Watchdog,
            _ => Self::Held,
        }
    }

    const fn gate(self) -> Option<Gate> {
        match self {
            Self::Uart => Some(Gate::Uart0),
            Self::Timers(group) => Some(Gate::Timers(group)),
            Self::SystemTimer => Some(Gate::SystemTimer),
            Self::Matrix => Some(Gate::InterruptMatrix),
            Self::Mcpwm => Some(Gate::Mcpwm),
            Self::Spi => Some(Gate::Spi2),
            Self::Pads => Some(Gate::IoMux),
            Self::Adc => Some(Gate::Adc),
            _ => None,
        }
    }
}

/// Peripherals, in the address space from here on.
const PERIPHERALS: u32 = 0x6000_0000;
const PERIPHERALS_BYTES: u32 = 0x10_0000;
const CONTROLLER: u32 = 0x2000_1000;
/// Addresses of blocks differ by at least so many bytes.
const STEP: u32 = 0x100;
/// Half a round of the fast loop.
const SOON_CYCLES: u64 = CYCLES_PER_SECOND / 20_000;
/// No block takes more.
const LARGEST_BLOCK: u32 = 0x1000;

/// The chip without its processor.
pub(crate) struct Soc<O> {
    pub(crate) memory: Memory,
    pub(crate) clocks: Clocks,
    pub(crate) interrupts: Interrupts,
    pub(crate) timers: [TimerGroup; 2],
    system_timer: SystemTimer,
    pub(crate) uart: Uart,
    gpio: Gpio,
    /// When each plain output last rose.
    rose: [u64; 32],
    /// What the pins did since the reset.
    pub(crate) early: Early,
    pub(crate) mcpwm: Mcpwm,
    pub(crate) spi: Spi,
    adc: Adc,
    analog: Analog,
    pub(crate) watchdog: LowPowerWatchdog,
    held: Held,
    pub(crate) flash: Flash,
    /// The flash chip's identity, as its controller read it.
    flash_identity: u32,
    pub(crate) outside: O,
    attention: bool,
    /// When something next happens by itself, in cycles.
    pub(crate) next_event: u64,
    pub(crate) findings: BTreeMap<String, Finding>,
    /// The block that lies at each step of the peripherals' addresses.
    map: Vec<Option<(&'static Block, Model)>>,
}

/// Priority of the fast loop's interrupt.
const FAST_LOOP_PRIORITY: u32 = 3;

impl<O: Outside> Soc<O> {
    pub(crate) fn new(outside: O, seed: u64) -> Self {
        let clocks = Clocks::new();
        Self {
            memory: Memory::new(),
            interrupts: Interrupts::new(),
            timers: [TimerGroup::new(0), TimerGroup::new(1)],
            system_timer: SystemTimer::new(),
            uart: Uart::new(&clocks),
            gpio: Gpio::new(),
            rose: [0; 32],
            early: Early::default(),
            mcpwm: Mcpwm::new(),
            spi: Spi::new(),
            adc: Adc::new(),
            analog: Analog::new(),
            watchdog: LowPowerWatchdog::new(0),
            held: Held::new(seed),
            flash: Flash::new(),
            flash_identity: 0,
            outside,
            attention: false,
            next_event: 0,
            findings: BTreeMap::new(),
            map: map(),
            clocks,
        }
    }

    /// Takes all peripherals out of reset at `now`; what survives a reset stays.
    pub(crate) fn reset(&mut self, now: u64, cause: u32) {
        self.clocks = Clocks::new();
        self.interrupts = Interrupts::new();
        self.timers = [TimerGroup::new(0), TimerGroup::new(1)];
        self.system_timer = SystemTimer::new();
        self.uart = Uart::new(&self.clocks);
        self.gpio = Gpio::new();
        self.rose = [0; 32];
        self.early = Early::default();
        self.mcpwm = Mcpwm::new();
        self.spi = Spi::new();
        self.adc = Adc::new();
        self.analog = Analog::new();
        self.watchdog = LowPowerWatchdog::new(now);
        let mut held = Held::new(0);
        held.survive(&self.held);
        self.held = held;
        self.held.set_reset_cause(cause);
        self.timers.iter_mut().for_each(|group| group.retime(now, &self.clocks));
        self.system_timer.retime(now, &self.clocks);
        self.schedule();
    }

    fn schedule(&mut self) {
        let timers = self.timers[0].next_event().min(self.timers[1].next_event());
        self.next_event = timers
            .min(self.system_timer.next_event())
            .min(self.uart.next_event())
            .min(self.spi.next_event())
            .min(self.adc.next_event())
            .min(self.mcpwm.next_event())
            .min(self.watchdog.next_event());
    }

    /// Lets everything happen that is due at `now`; what a watchdog does to the chip, and which.
    pub(crate) fn advance(&mut self, now: u64) -> Option<(Watchdog, Action)> {
        let mut bite = None;
        for (index, group) in self.timers.iter_mut().enumerate() {
            if group.next_event() <= now
                && let Some(action) = group.advance(now)
            {
                bite = Some((Watchdog::TimerGroup(index), action));
            }
        }
        self.system_timer.advance(now);
        self.uart.advance(now, self.gpio.console());
        self.spi.advance(now);
        self.adc.advance(now);
        self.mcpwm.advance(now);
        if let Some(action) = self.watchdog.advance(now) {
            bite = Some((Watchdog::LowPower, action));
        }
        self.refresh();
        bite
    }

    /// Interrupts and the next event follow the blocks' states.
    fn refresh(&mut self) {
        for group in 0..2 {
            let [timer, watchdog] = self.timers[group].levels();
            self.interrupts.set(source::TIMER[group], timer);
            self.interrupts.set(source::WATCHDOG[group], watchdog);
        }
        for (index, level) in self.system_timer.levels().into_iter().enumerate() {
            self.interrupts.set(source::SYSTEM_TIMER + index as u32, level);
        }
        self.interrupts.set(source::UART0, self.uart.level());
        self.interrupts.set(source::SPI2, self.spi.level());
        self.interrupts.set(source::MCPWM, self.mcpwm.level());
        self.interrupts.set(source::ADC, self.adc.level());
        self.interrupts.set(source::LP_WATCHDOG, self.watchdog.level());
        self.schedule();
        self.attention = true;
    }

    /// Returns once whether something changed that the processor has to see.
    pub(crate) fn take_attention(&mut self) -> bool {
        std::mem::take(&mut self.attention)
    }

    /// Gives the serial port a byte that the program sends.
    pub(crate) fn feed_transmitter(&mut self, byte: u8, now: u64) {
        self.uart.push(byte, now);
        self.refresh();
    }

    /// Receives bytes that the other end of the serial port sends.
    pub(crate) fn feed_serial(&mut self, bytes: &[u8], now: u64) {
        self.uart.feed(bytes, now);
        self.refresh();
    }

    /// Returns what comes out of a pin at `now`; `None` where nothing drives it.
    pub(crate) fn output(&mut self, pin: u32, now: u64) -> Option<Wave> {
        match self.gpio.driver(pin) {
            Driver::None => self.gpio.pull(pin).map(Wave::level),
            Driver::Level(level) => Some(Wave::level(level)),
            Driver::Pwm { operator, is_b, is_inverted } => {
                let wave = self.mcpwm.wave(operator, is_b, now);
                let share = if is_inverted { 1.0 - wave.share } else { wave.share };
                Some(Wave { share, ..wave })
            }
            Driver::SpiClock | Driver::SpiMosi | Driver::Uart0 | Driver::Other(_) => {
                Some(Wave { hertz: f64::NAN, share: f64::NAN })
            }
        }
    }

    /// Returns whether a pin's duty was written soon after a plain output rose: it then drove what was there before.
    pub(crate) fn is_duty_late(&self, pin: u32, output: u32) -> bool {
        let rose = self.rose.get(output as usize).copied().unwrap_or(0);
        let Driver::Pwm { operator, is_b, .. } = self.gpio.driver(pin) else { return false };
        let written = self.mcpwm.stamped[operator][usize::from(is_b)];
        rose > 0 && written > rose && written - rose < SOON_CYCLES
    }

    /// Returns whether a supply that sags resets the chip.
    pub(crate) fn resets_on_brown_out(&mut self) -> bool {
        const CONTROL: u32 = 0x00;
        const RESET: u32 = 1 << 31;
        self.held.read("LP_ANA", CONTROL).is_ok_and(|control| control & RESET != 0)
    }

    fn find(&self, address: u32) -> Option<(&'static Block, Model, u32)> {
        let index = match address {
            CONTROLLER..=0x2000_1FFF => self.map.len() - 1,
            _ => (address.wrapping_sub(PERIPHERALS) / STEP) as usize,
        };
        let (block, model) = (*self.map.get(index)?)?;
        let offset = (address & !3).wrapping_sub(block.base);
        block.registers.contains_key(&offset).then_some((block, model, offset))
    }

    /// Returns whether a block takes accesses; one that does not is a finding.
    fn is_awake(&mut self, block: &Block, model: Model, offset: u32, what: &str, pc: u32) -> bool {
        let Some(gate) = model.gate() else { return true };
        let state = match (self.clocks.is_clocked(gate), self.clocks.is_reset(gate)) {
            (true, false) => return true,
            (false, _) => "while its clock is off",
            (true, true) => "while it is held in reset",
        };
        let sentence = format!("{what} of {} {state}", block.register_name(offset));
        self.findings.entry(sentence).or_insert(Finding { count: 0, pc }).count += 1;
        false
    }

    /// Finds who opens the fast loop's watchdog where that loop may come between: it feeds, locks again, and the rest of
    /// what was to be written is lost.
    fn watch_unlocking(&mut self, model: Model, offset: u32, value: u32, access: Access) {
        let is_unlocked = matches!(model, Model::Timers(1))
            && offset == timer_group::WATCHDOG_PROTECT
            && value == timer_group::WATCHDOG_KEY;
        let may_come = access.is_interruptible && self.interrupts.threshold() <= FAST_LOOP_PRIORITY;
        if is_unlocked && may_come && self.mcpwm.ticks > 0 {
            let sentence = "the fast loop's watchdog is unlocked where the loop may come between";
            let finding = Finding { count: 0, pc: access.pc };
            self.findings.entry(sentence.to_owned()).or_insert(finding).count += 1;
        }
    }

    fn read(&mut self, block: &Block, model: Model, offset: u32, now: u64) -> Answer<u32> {
        match model {
            Model::Clocks => self.clocks.read(offset),
            Model::Uart => {
                let value = self.uart.read(offset);
                self.refresh();
                value
            }
            Model::Timers(group) => self.timers[group].read(offset),
            Model::SystemTimer => self.system_timer.read(offset),
            Model::Matrix => self.interrupts.read_matrix(offset),
            Model::Software => self.interrupts.read_software(offset),
            Model::Controller => self.interrupts.read_controller(offset),
            Model::Mcpwm => self.mcpwm.read(offset, now),
            Model::Spi => self.spi.read(offset, now),
            Model::Flash => match offset {
                0x00 => Ok(0),
                0x58 => Ok(self.flash_identity),
                _ => Err(Unmodelled::Register),
            },
            Model::Gpio => self.gpio.read(offset),
            Model::Pads => self.gpio.read_pads(offset),
            Model::Adc => self.adc.read(offset, now),
            Model::Analog => self.analog.read(offset),
            Model::Watchdog => self.watchdog.read(offset),
            Model::Held => self.held.read(block.name, offset),
        }
    }

    fn write(
        &mut self,
        block: &Block,
        model: Model,
        offset: u32,
        value: u32,
        now: u64,
    ) -> Answer<()> {
        match model {
            Model::Clocks => return self.write_clocks(offset, value, now),
            Model::Mcpwm => {
                self.mcpwm.write(offset, value, now, self.clocks.mcpwm_hz())?;
                if self.mcpwm.rounds > 0 {
                    self.early.tick.get_or_insert(now);
                }
                // Six duties a tick need no more.
                if !Mcpwm::concerns_interrupts(offset) {
                    return Ok(());
                }
            }
            Model::Gpio => {
                let before = self.gpio.outputs();
                self.gpio.write(offset, value)?;
                let risen = self.gpio.outputs() & !before;
                for (pin, rose) in self.rose.iter_mut().enumerate() {
                    *rose = if risen >> pin & 1 == 1 { now } else { *rose };
                }
                self.early.look(&self.gpio, now);
                return Ok(());
            }
            Model::Pads => {
                self.gpio.write_pads(offset, value)?;
                self.early.look(&self.gpio, now);
                return Ok(());
            }
            Model::Analog => {
                self.analog.write(offset, value)?;
                self.adc.offset = self.analog.adc_offset();
                return Ok(());
            }
            Model::Held => return self.held.write(block.name, offset, value),
            Model::Flash => return self.write_flash(offset, value),
            Model::Spi => self.write_spi(offset, value, now)?,
            Model::Uart => self.uart.write(offset, value, now, &self.clocks)?,
            Model::Timers(group) => {
                self.timers[group].write(offset, value, now, &self.clocks)?;
            }
            Model::SystemTimer => self.system_timer.write(offset, value, now, &self.clocks)?,
            Model::Matrix => self.interrupts.write_matrix(offset, value)?,
            Model::Software => self.interrupts.write_software(offset, value)?,
            Model::Controller => self.interrupts.write_controller(offset, value)?,
            Model::Adc => {
                let (hertz, outside) = (self.clocks.adc_hz(), &mut self.outside);
                // Channels of ADC1 are pins 0 to 6.
                self.adc.write(offset, value, now, hertz, |pin| outside.millivolts(now, pin))?;
            }
            Model::Watchdog => self.watchdog.write(offset, value, now)?,
        }
        self.refresh();
        Ok(())
    }

    fn write_spi(&mut self, offset: u32, value: u32, now: u64) -> Answer<()> {
        let started = self.spi.write(offset, value, now, self.clocks.spi2_hz())?;
        if let Some(transfer) = started {
            let answer = self.outside.exchange(now, &Pins(&self.gpio), &transfer);
            self.spi.answer(answer);
        }
        Ok(())
    }

    /// The controller that executes from flash; the image only asks the flash who it is.
    fn write_flash(&mut self, offset: u32, value: u32) -> Answer<()> {
        const READ_IDENTITY: u32 = 1 << 28;
        match (offset, value) {
            (0x00, READ_IDENTITY) => {
                // Winbond W25Q32: maker, kind, size.
                self.flash_identity = 0x0016_40EF;
                Ok(())
            }
            (0x58, _) => {
                self.flash_identity = value;
                Ok(())
            }
            _ => Err(Unmodelled::Register),
        }
    }

    fn write_clocks(&mut self, offset: u32, value: u32, now: u64) -> Answer<()> {
        let before = Gate::ALL.map(|gate| self.clocks.is_reset(gate));
        let mcpwm_before = self.clocks.mcpwm_hz();
        self.clocks.write(offset, value)?;
        for (gate, was_reset) in Gate::ALL.into_iter().zip(before) {
            if !was_reset && self.clocks.is_reset(gate) {
                self.reset_block(gate, now);
            }
        }
        match offset {
            0x00..=0x04 => self.uart.retime(&self.clocks),
            0x3C..=0x50 => self.timers.iter_mut().for_each(|group| group.retime(now, &self.clocks)),
            0x54..=0x58 => self.system_timer.retime(now, &self.clocks),
            _ => {}
        }
        if self.clocks.mcpwm_hz() != mcpwm_before {
            self.mcpwm.retime(now, self.clocks.mcpwm_hz());
        }
        self.refresh();
        Ok(())
    }

    fn reset_block(&mut self, gate: Gate, now: u64) {
        match gate {
            Gate::Uart0 => {
                // The boot loader's clock setting is PCR's and stays.
                let sent = std::mem::take(&mut self.uart.sent);
                self.uart = Uart::new(&self.clocks);
                self.uart.sent = sent;
            }
            Gate::Timers(group) => {
                self.timers[group] = TimerGroup::new(group);
                self.timers[group].retime(now, &self.clocks);
            }
            Gate::SystemTimer => {
                self.system_timer = SystemTimer::new();
                self.system_timer.retime(now, &self.clocks);
            }
            Gate::Adc => self.adc = Adc::new(),
            Gate::Mcpwm => self.mcpwm = Mcpwm::new(),
            Gate::Spi2 => self.spi = Spi::new(),
            Gate::InterruptMatrix => self.interrupts.matrix = Interrupts::new().matrix,
            Gate::IoMux => {}
        }
    }
}

/// The watchdog.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Watchdog {
    TimerGroup(usize),
    LowPower,
}

fn map() -> Vec<Option<(&'static Block, Model)>> {
    // One more for the interrupt controller, which lies elsewhere.
    let steps = (PERIPHERALS_BYTES / STEP) as usize;
    let mut map = vec![None; steps + 1];
    let mut blocks: Vec<&Block> = BLOCKS.iter().collect();
    blocks.sort_by_key(|block| block.base);
    for block in blocks {
        let model = Model::of(block);
        if block.base == CONTROLLER {
            map[steps] = Some((block, model));
            continue;
        }
        let first = ((block.base - PERIPHERALS) / STEP) as usize;
        let last = (first + (LARGEST_BLOCK / STEP) as usize).min(steps);
        // A block that starts later takes over from there on.
        map[first..last].fill(Some((block, model)));
    }
    map
}

impl<O: Outside> Bus for Soc<O> {
    fn memory(&mut self) -> &mut Memory {
        &mut self.memory
    }

    fn load(&mut self, address: u32, size: u32, access: Access) -> Result<u32, Refusal> {
        let fault = |trouble| Refusal::Fault(Fault { trouble, pc: access.pc });
        let Some((block, model, offset)) = self.find(address) else {
            return Err(match is_peripheral(address) {
                true => fault(Trouble::NoRegister { access: "read", address }),
                false => Refusal::Nothing,
            });
        };
        if !self.is_awake(block, model, offset, "read", access.pc) {
            return Ok(0);
        }
        let word = self.read(block, model, offset, access.time).map_err(|_| {
            let register = block.register_name(offset);
            fault(Trouble::NotModelled { access: "read", register, address })
        })?;
        let shifted = word >> (8 * (address & 3));
        Ok(match size {
            1 => shifted & 0xFF,
            2 => shifted & 0xFFFF,
            _ => shifted,
        })
    }

    fn store(
        &mut self,
        address: u32,
        value: u32,
        size: u32,
        access: Access,
    ) -> Result<(), Refusal> {
        let fault = |trouble| Refusal::Fault(Fault { trouble, pc: access.pc });
        let Some((block, model, offset)) = self.find(address) else {
            return Err(match is_peripheral(address) {
                true => fault(Trouble::NoRegister { access: "write", address }),
                false => Refusal::Nothing,
            });
        };
        if !self.is_awake(block, model, offset, "write", access.pc) {
            return Ok(());
        }
        self.watch_unlocking(model, offset, value, access);
        let register = || block.register_name(offset);
        if size != 4 {
            let reason = "registers are written whole";
            return Err(fault(Trouble::Value { register: register(), value, reason }));
        }
        self.write(block, model, offset, value, access.time).map_err(|unmodelled| {
            fault(match unmodelled {
                Unmodelled::Register => {
                    Trouble::NotModelled { access: "write", register: register(), address }
                }
                Unmodelled::Value(reason) => Trouble::Value { register: register(), value, reason },
            })
        })
    }

    fn wants_attention(&self) -> bool {
        self.attention
    }
}

/// Returns whether something should be there.
fn is_peripheral(address: u32) -> bool {
    address.wrapping_sub(PERIPHERALS) < PERIPHERALS_BYTES
        || address.wrapping_sub(CONTROLLER & !0xFFFF) < 0x1_0000
}
