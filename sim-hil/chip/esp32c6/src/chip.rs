//! The chip, whole: processor, peripherals, ROM and radio, stepped by virtual time.

use std::time::Duration;

use crate::block::flash::Flash;
use crate::block::interrupt::source;
use crate::block::mcpwm::Wave;
use crate::block::watchdog::Action;
use crate::block::{CYCLES_PER_SECOND, cycles};
use crate::cpu::{Cpu, Exit};
use crate::early::{Early, Line};
use crate::fault::{Fault, Trouble};
use crate::image::{Image, STORE, programmed_flash};
use crate::memory::{BOOT_LOADER, Memory, PAINT, ROM, ROM_BYTES, SCRATCH};
use crate::network::{Network, Silence};
use crate::radio::{self, Radio, Times};
use crate::rom::{Outcome, Rom};
use crate::soc::{Finding, Outside, Soc, Watchdog};

/// Why the chip started, as its ROM states it (technical reference manual, table 9.1-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetReason {
    /// Power came.
    PowerOn,
    /// The program asked for it.
    Software,
    /// The watchdog of timer group 0 or 1.
    TimerWatchdog(usize),
    /// The watchdog of the low-power side, which resets all but it.
    LowPowerWatchdog,
    /// The same, with the low-power side.
    LowPowerWatchdogAll,
    /// The supply sagged.
    BrownOut,
}

impl ResetReason {
    const fn code(self) -> u32 {
        match self {
            Self::PowerOn => 0x01,
            Self::Software => 0x03,
            Self::TimerWatchdog(0) => 0x07,
            Self::TimerWatchdog(_) => 0x08,
            Self::LowPowerWatchdog => 0x09,
            Self::LowPowerWatchdogAll => 0x10,
            Self::BrownOut => 0x0F,
        }
    }
}

/// Why a run ended before its time.
#[derive(Debug, Clone, PartialEq)]
pub enum Stop {
    /// The chip was reset; it goes on from its boot loader.
    Reset(ResetReason),
    /// Power went within a flash operation; [`Chip::power_on`] goes on.
    PowerLost,
    /// The image or the emulator is at its end.
    Fault(Fault),
}

/// What silicon takes and the emulated chip does not know: assumptions of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Silicon {
    /// ROM and boot loader, from reset to the image's first instruction.
    pub boot: Duration,
    /// A miss of the cache in front of the flash.
    pub cache_miss: Duration,
    /// For so long the radio's closed library masks all interrupts, the fast loop's too, each time that it is called and that it
    /// calls: its lock clears `mstatus.MIE` (esp-radio, `wifi_int_disable`).
    pub radio_lock: Duration,
}

impl Default for Silicon {
    /// A start that is estimated on the long side; no time for what can be said of no image.
    fn default() -> Self {
        Self {
            boot: Duration::from_millis(300),
            cache_miss: Duration::ZERO,
            radio_lock: Duration::ZERO,
        }
    }
}

/// Cycles between two looks at the network when nothing else happens.
const NETWORK_CYCLES: u64 = CYCLES_PER_SECOND / 4_000;
/// So many functions are named of those that should not be where they are.
const NAMED_PLACES: usize = 16;
/// A run without a single look at interrupts is no longer than this.
const SLICE_CYCLES: u64 = CYCLES_PER_SECOND / 10_000;

/// An ESP32-C6 with an image in its flash.
pub struct Chip<O> {
    cpu: Cpu,
    soc: Soc<O>,
    rom: Rom,
    radio: Radio,
    /// The network that the radio is on.
    pub network: Network,
    image: Image,
    waits: bool,
    next_poll: u64,
    silicon: Silicon,
    /// Why the chip started last.
    reason: ResetReason,
    /// When the image's first instruction ran last.
    started: u64,
    /// Cycles for which the processor did something since then.
    busy: u64,
    /// Longest wait of the fast loop's interrupt, cycles, and where the program let it in.
    longest_wait: (u64, u32),
}

impl<O: Outside> Chip<O> {
    /// Creates a chip, powered on, with an image and what is soldered to the pins. `seed` is where randomness starts.
    #[must_use]
    pub fn new(image: Image, outside: O, seed: u64) -> Self {
        Self::with_flash(image, outside, programmed_flash(), seed)
    }

    /// Creates a chip with a flash that was used before.
    #[must_use]
    pub fn with_flash(image: Image, outside: O, flash: Flash, seed: u64) -> Self {
        let mut soc = Soc::new(outside, seed);
        soc.flash = flash;
        let mut chip = Self {
            cpu: Cpu::new(image.entry),
            soc,
            rom: Rom::new(image.symbols()),
            radio: Radio::new(image.symbols()),
            network: Network::default(),
            image,
            waits: false,
            next_poll: 0,
            silicon: Silicon::default(),
            reason: ResetReason::PowerOn,
            started: 0,
            busy: 0,
            longest_wait: (0, 0),
        };
        chip.power_on();
        chip
    }

    /// Cuts power and restores it.
    pub fn power_on(&mut self) {
        self.soc.flash.cut_power_in(None);
        self.soc.memory = Memory::new();
        self.boot(ResetReason::PowerOn);
    }

    fn boot(&mut self, reason: ResetReason) {
        self.reason = reason;
        self.rom.reset_reason = reason.code();
        let now = self.cpu.cycles + cycles(self.silicon.boot);
        let tick = std::mem::take(&mut self.cpu.tick);
        self.cpu = Cpu::new(self.image.entry);
        self.cpu.tick = tick;
        self.cpu.tick.abandon();
        self.cpu.charge_misses(cycles(self.silicon.cache_miss));
        self.cpu.cycles = now;
        self.soc.reset(now, reason.code());
        self.radio.reset();
        self.network.silence.end(Silence::UntilRestarted);
        // The boot loader has been there; its memory is nothing that a program starts with.
        if let Some(memory) = self.soc.memory.bytes_mut(BOOT_LOADER.start, BOOT_LOADER.len()) {
            memory.fill(PAINT);
        }
        for segment in &self.image.segments {
            let (at, data) = (segment.address, &segment.data[..]);
            if let Some(memory) = self.soc.memory.bytes_mut(at, data.len()) {
                memory.copy_from_slice(data);
            } else {
                let offset = at.wrapping_sub(crate::memory::FLASH) as usize;
                if let Some(window) = self.soc.memory.flash.get_mut(offset..offset + data.len()) {
                    window.copy_from_slice(data);
                }
            }
        }
        for (number, (address, _)) in self.radio.functions.iter().enumerate() {
            self.cpu.divert(*address, number as i32);
        }
        self.waits = false;
        self.started = now;
        self.busy = 0;
        self.next_poll = now;
    }

    /// Cycles of 160 MHz since the first power-on.
    #[must_use]
    pub fn cycles(&self) -> u64 {
        self.cpu.cycles
    }

    /// Returns the time since the first power-on.
    #[must_use]
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.cpu.cycles * 25 / 4)
    }

    /// Runs until so many cycles have passed since the first power-on.
    ///
    /// # Errors
    /// When something ends the run before.
    pub fn run_until(&mut self, until: u64) -> Result<(), Stop> {
        while self.cpu.cycles < until {
            let now = self.cpu.cycles;
            if now >= self.soc.next_event
                && let Some((watchdog, action)) = self.soc.advance(now)
            {
                return Err(self.bite(watchdog, action));
            }
            if now >= self.next_poll {
                self.next_poll = now + NETWORK_CYCLES;
                self.radio
                    .poll(now, &mut self.soc, &mut self.network)
                    .map_err(|trouble| self.fault(trouble))?;
            }
            self.interrupt();
            let given = self
                .radio
                .give_back(&mut self.cpu, &mut self.soc)
                .map_err(|trouble| self.fault(trouble))?;
            self.waits &= !given;
            let kept = self.radio.keeps_until().unwrap_or(u64::MAX).max(now + 1);
            let horizon = self.soc.next_event.min(self.next_poll).min(until).min(kept);
            if self.waits {
                self.cpu.cycles = horizon.max(now);
                continue;
            }
            self.execute(horizon.min(now + SLICE_CYCLES))?;
        }
        Ok(())
    }

    /// Enters the interrupt that is due, or a call of the radio library.
    fn interrupt(&mut self) {
        self.soc.take_attention();
        let cpu = &self.cpu;
        if let Some(line) = self.soc.interrupts.line(|line| cpu.line_is_enabled(line)) {
            // Waiting ends, whether the interrupt is taken or not.
            self.waits = false;
            if self.cpu.takes_interrupts() {
                let is_tick = self.soc.interrupts.is_of(source::MCPWM, line);
                if is_tick {
                    let waited = self.cpu.cycles.saturating_sub(self.soc.mcpwm.last_tick);
                    self.longest_wait = self.longest_wait.max((waited, self.cpu.pc));
                }
                self.cpu.interrupt(line);
                if is_tick {
                    self.cpu.tick.begin();
                }
                return;
            }
        }
        if self.radio.wants() && self.radio.inject(&mut self.cpu, &mut self.soc) {
            self.waits = false;
        }
    }

    fn execute(&mut self, until: u64) -> Result<(), Stop> {
        let before = self.cpu.cycles;
        let exit = self.cpu.run(&mut self.soc, until);
        let divider = self.soc.clocks.cpu_divider();
        if divider > 1 {
            self.cpu.cycles += (self.cpu.cycles - before) * (divider - 1);
        }
        let outcome = match exit {
            Exit::Time | Exit::Attention => Ok(()),
            Exit::Wait => {
                self.waits = true;
                Ok(())
            }
            Exit::Host(number) => self
                .radio
                .call(number, &mut self.cpu, &mut self.soc, &mut self.network)
                .map_err(|trouble| self.fault(trouble)),
            Exit::Elsewhere => self.elsewhere(),
            Exit::Fault(fault) => Err(Stop::Fault(fault)),
        };
        self.busy += self.cpu.cycles - before;
        outcome
    }

    /// The program counter is outside of all memory: in the ROM, or the radio's.
    fn elsewhere(&mut self) -> Result<(), Stop> {
        if self.cpu.pc == radio::RETURN {
            return self
                .radio
                .returned(&mut self.cpu, &mut self.soc)
                .map_err(|trouble| self.fault(trouble));
        }
        match self.rom.call(&mut self.cpu, &mut self.soc) {
            Ok(Outcome::Returned | Outcome::Waits) => Ok(()),
            Ok(Outcome::Reset) => {
                self.boot(ResetReason::Software);
                Err(Stop::Reset(ResetReason::Software))
            }
            Ok(Outcome::PowerLost) => Err(Stop::PowerLost),
            Err(trouble) => Err(self.fault(trouble)),
        }
    }

    fn fault(&self, trouble: Trouble) -> Stop {
        // Functions outside are entered by a call: the caller is of interest.
        let in_rom = self.cpu.pc.wrapping_sub(ROM) < ROM_BYTES;
        Stop::Fault(Fault { trouble, pc: if in_rom { self.cpu.x[1] } else { self.cpu.pc } })
    }

    fn bite(&mut self, watchdog: Watchdog, action: Action) -> Stop {
        let reason = match (watchdog, action) {
            (Watchdog::TimerGroup(group), _) => ResetReason::TimerWatchdog(group),
            (Watchdog::LowPower, Action::ResetAll) => ResetReason::LowPowerWatchdogAll,
            (Watchdog::LowPower, _) => ResetReason::LowPowerWatchdog,
        };
        self.boot(reason);
        Stop::Reset(reason)
    }

    /// Lowers the supply for a moment. Returns whether the chip starts anew: the program has to have asked for it.
    pub fn brown_out(&mut self) -> bool {
        let resets = self.soc.resets_on_brown_out();
        if resets {
            self.boot(ResetReason::BrownOut);
        }
        resets
    }

    /// Returns whether a pin's duty was written soon after a plain output, its bridge's enable, rose.
    #[must_use]
    pub fn is_duty_late(&self, pin: u32, output: u32) -> bool {
        self.soc.is_duty_late(pin, output)
    }

    /// Returns whether the processor is at this place of the program.
    #[must_use]
    pub fn is_in(&self, place: Place) -> bool {
        let threshold = self.soc.interrupts.threshold();
        let fast = self.soc.interrupts.priority_of(source::MCPWM);
        let works = !self.waits && !self.radio.is_calling();
        let fed = self.soc.watchdog.fed_at.map(|at| self.cpu.cycles - at);
        match place {
            Place::BeforeTheLoop => works && fed.is_some() && self.soc.mcpwm.rounds == 0,
            Place::Loop => works && fast > 0 && threshold > fast,
            Place::Tasks => {
                works
                    && self.cpu.takes_interrupts()
                    && fed.is_some_and(|past| past < SHORTLY)
                    && self.soc.mcpwm.rounds > 0
                    && threshold <= 1
            }
        }
    }

    /// Lets the program hang where it is: the processor executes an endless loop, with interrupts as they are.
    pub fn hang(&mut self) {
        const JUMP_TO_ITSELF: u32 = 0x6F;
        self.soc.memory.store(SCRATCH, JUMP_TO_ITSELF, 4);
        self.cpu.forget(SCRATCH, 4);
        self.cpu.pc = SCRATCH;
    }

    /// Lets the program panic where it is, as if an index were out of bounds there; whether it has a function for that.
    pub fn panic(&mut self) -> bool {
        const FILE: &[u8] = b"emulated.rs\0";
        let Some((function, _)) = self.image.find(|name| name.contains("panic_bounds_check"))
        else {
            return false;
        };
        let location = SCRATCH + 0x10;
        // A `Location`: file, its length, line, column.
        for (index, word) in [SCRATCH, FILE.len() as u32 - 1, 1, 1].into_iter().enumerate() {
            self.soc.memory.store(location + 4 * index as u32, word, 4);
        }
        if let Some(bytes) = self.soc.memory.bytes_mut(SCRATCH, FILE.len()) {
            bytes.copy_from_slice(FILE);
        }
        self.cpu.x[10..13].copy_from_slice(&[7, 7, location]);
        self.cpu.pc = function;
        self.cpu.tick.abandon();
        true
    }

    /// Returns what comes out of a pin now; `None` where nothing drives or pulls it.
    pub fn output(&mut self, pin: u32) -> Option<Wave> {
        let now = self.cpu.cycles;
        self.soc.output(pin, now)
    }

    /// Returns when a pin was driven otherwise than before and how, from the image's first instruction to the fast loop's first
    /// tick, in cycles.
    pub fn early_lines(&self, pin: u32) -> impl Iterator<Item = (u64, Line)> {
        let changes = self.soc.early.changes.iter().filter(move |change| change.pin == pin);
        changes.map(|change| (change.at.saturating_sub(self.started), change.line))
    }

    /// Returns the cycles from the image's first instruction to the first use of flash, of the radio, and to the fast loop's
    /// first tick; `None` for what has not been yet.
    #[must_use]
    pub fn early_uses(&self) -> [Option<u64>; 3] {
        let Early { flash, radio, tick, .. } = self.soc.early;
        [flash, radio, tick].map(|at| Some(at?.saturating_sub(self.started)))
    }

    /// Assumes that silicon takes this, and powers on anew.
    pub fn assume(&mut self, silicon: Silicon) {
        self.silicon = silicon;
        self.radio.lock = cycles(silicon.radio_lock);
        self.power_on();
    }

    /// Charges these times to the radio's library from now on.
    pub fn charge(&mut self, times: Times) {
        self.radio.times = times;
    }

    /// Returns what is soldered to the pins.
    pub fn outside(&mut self) -> &mut O {
        &mut self.soc.outside
    }

    /// Returns the flash.
    pub fn flash(&mut self) -> &mut Flash {
        &mut self.soc.flash
    }

    /// Sends to the chip's serial port.
    pub fn send_serial(&mut self, bytes: &[u8]) {
        let now = self.cpu.cycles;
        self.soc.feed_serial(bytes, now);
    }

    /// Bytes that were sent and have not arrived.
    #[must_use]
    pub fn serial_backlog(&self) -> usize {
        self.soc.uart.incoming()
    }

    /// Returns what came out of the serial port since the last call.
    pub fn take_serial(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.soc.uart.sent)
    }

    /// Returns why the chip started last.
    #[must_use]
    pub fn reset_reason(&self) -> ResetReason {
        self.reason
    }

    /// Returns the image.
    #[must_use]
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Returns what no program should do and this one did.
    #[must_use]
    pub fn findings(&self) -> Vec<String> {
        let sentence = |(what, finding): (&String, &Finding)| {
            format!("{what}, {} times, first at {}", finding.count, self.image.place(finding.pc))
        };
        let strays = self.soc.flash.touched().filter(|at| !STORE.contains(at));
        let stray = |at| format!("flash is changed at {at:#x}, outside of its partition");
        let findings = self.soc.findings.iter().map(sentence).chain(strays.map(stray));
        findings.chain(self.flash_in_ticks()).collect()
    }

    /// Returns a sentence about what the fast loop takes of flash, if it does.
    fn flash_in_ticks(&self) -> Option<String> {
        let tick = &self.cpu.tick;
        let mut places: Vec<String> = tick.addresses().map(|at| self.image.name(at)).collect();
        places.dedup();
        let named = places.len().min(NAMED_PLACES);
        (named > 0).then(|| {
            format!(
                "the fast loop executes and reads flash, {} times, at {} places: {}",
                tick.accesses,
                places.len(),
                places[..named].join(", ")
            )
        })
    }

    /// Functions of the last jumps, for the report of a fault.
    #[must_use]
    pub fn trail(&self) -> Vec<String> {
        self.cpu.trail().into_iter().map(|pc| self.image.place(pc)).collect()
    }

    /// Returns a sentence about a fault, with the function's name.
    #[must_use]
    pub fn explain(&self, fault: &Fault) -> String {
        format!("{} in {}", fault, self.image.place(fault.pc))
    }

    /// Returns what the chip counts.
    #[must_use]
    pub fn counters(&self) -> Counters {
        Counters {
            instructions: self.cpu.instructions,
            busy_cycles: self.busy,
            run_cycles: self.cpu.cycles - self.started,
            ticks: self.soc.mcpwm.ticks,
            rounds: self.soc.mcpwm.rounds,
            longest_gap_cycles: self.soc.mcpwm.longest_gap,
            silence_cycles: self.soc.mcpwm.silence(self.cpu.cycles),
            pwm_hz: self.soc.mcpwm.frequency(0),
            cpu_hz: self.soc.clocks.cpu_hz(),
            serial_baud: self.soc.uart.baud(&self.soc.clocks),
            serial_lost: self.soc.uart.lost,
            transfers: self.soc.spi.transfers,
            transmit_power_dbm: self.radio.transmit_power(),
            radio_sleeps: self.radio.sleeps(),
            signal_dbm: self.radio.signal(),
            connect_attempts: self.radio.attempts,
            radio_renewals: self.radio.renewals,
            longest_radio_call_cycles: self.radio.longest_call,
            frames_dropped: self.radio.overruns,
            radio_buffers: self.radio.buffers,
            fast_watchdog_is_on: self.soc.timers[1].watchdog_is_on(),
            slow_watchdog_is_on: self.soc.watchdog.is_on(),
            fast_loop_priority: self.soc.interrupts.priority_of(source::MCPWM),
            flash_in_ticks: self.cpu.tick.accesses,
            slow_watchdog_after_cycles: self
                .soc
                .watchdog
                .on_since()
                .map(|at| at.saturating_sub(self.started)),
            duties_taken_over_elsewhere: self.soc.mcpwm.is_taken_over_elsewhere,
        }
    }

    /// Returns when the fast loop's tick was last due, cycles.
    #[must_use]
    pub fn last_tick(&self) -> u64 {
        self.soc.mcpwm.last_tick
    }

    /// Returns when the fast loop last set the last duty, cycles.
    #[must_use]
    pub fn last_round(&self) -> u64 {
        self.soc.mcpwm.last_round
    }

    /// Returns how long after the beginning of a PWM period that was, seconds.
    #[must_use]
    pub fn tick_phase(&self) -> f64 {
        self.soc.mcpwm.tick_phase()
    }

    /// Returns for how many cycles after its tick the fast loop's interrupt waited at most since [`Chip::forget_gaps`], and at
    /// which address the program let it in.
    #[must_use]
    pub fn longest_wait(&self) -> (u64, u32) {
        self.longest_wait
    }

    /// Forgets the longest gap between rounds of the fast loop, and the longest wait for one.
    pub fn forget_gaps(&mut self) {
        self.soc.mcpwm.longest_gap = 0;
        self.longest_wait = (0, 0);
    }

    /// Bytes of `start..end` in working memory that nothing has written since power-on, counted from the start.
    #[must_use]
    pub fn untouched(&self, start: u32, end: u32) -> u32 {
        let bytes = self.soc.memory.bytes(start, end.saturating_sub(start) as usize);
        let untouched = |bytes: &[u8]| bytes.iter().take_while(|byte| **byte == PAINT).count();
        bytes.map_or(0, |bytes| untouched(bytes) as u32)
    }

    /// Returns the longest run in `length` bytes from `start` on of what was there when the image started: zeros, or what the boot
    /// loader left.
    #[must_use]
    pub fn longest_untouched(&self, start: u32, length: u32) -> u32 {
        let before = if BOOT_LOADER.contains(&start) { PAINT } else { 0 };
        let bytes = self.soc.memory.bytes(start, length as usize).unwrap_or_default();
        bytes.split(|byte| *byte != before).map(<[u8]>::len).max().unwrap_or(0) as u32
    }

    /// Returns where the next interrupt or frame would come, for whoever paces the chip; cycles.
    #[must_use]
    pub fn next_event(&self) -> u64 {
        let at = self.soc.next_event.min(self.network.next_event());
        if self.waits { at } else { self.cpu.cycles }
    }

    /// Registers of the processor, for whoever debugs.
    #[must_use]
    pub fn state(&self) -> String {
        let (cause, value) = self.cpu.last_cause();
        format!(
            "pc {} ra {} sp {:#010x} last cause {cause:#x} value {value:#x}",
            self.image.place(self.cpu.pc),
            self.image.place(self.cpu.x[1]),
            self.cpu.x[2]
        )
    }
}

/// A place of the program, for what goes wrong there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Between the first feeding of the tasks' watchdog and the fast loop's first round.
    BeforeTheLoop,
    /// The fast loop.
    Loop,
    /// The task that feeds the tasks' watchdog, once the fast loop runs.
    Tasks,
}

/// Cycles after a feeding for which the task that fed goes on.
const SHORTLY: u64 = 1_000;

/// What the chip counted since power-on or, where it says so, since the image last started.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Counters {
    /// Instructions since the image started.
    pub instructions: u64,
    /// Cycles of 160 MHz since then in which the processor worked, and all.
    pub busy_cycles: u64,
    /// See above.
    pub run_cycles: u64,
    /// Ticks of the fast loop's timer since the image started.
    pub ticks: u64,
    /// Rounds of the fast loop, seen from the PWM's registers.
    pub rounds: u64,
    /// Longest time between two rounds since [`Chip::forget_gaps`].
    pub longest_gap_cycles: u64,
    /// Time since the last round, at most a second.
    pub silence_cycles: u64,
    /// PWM frequency.
    pub pwm_hz: f64,
    /// Clock of the processor.
    pub cpu_hz: u64,
    /// Rate of the serial port.
    pub serial_baud: f64,
    /// Bytes written into a full serial FIFO.
    pub serial_lost: u64,
    /// SPI transfers.
    pub transfers: u64,
    /// Whether the radio sleeps between beacons, as it does unless the image asks for the contrary.
    pub radio_sleeps: bool,
    /// Received power while connected, dBm.
    pub signal_dbm: Option<i32>,
    /// Attempts to connect since power-on.
    pub connect_attempts: u64,
    /// How often the radio was taken down, to be made anew.
    pub radio_renewals: u64,
    /// Transmit power that the image asked for.
    pub transmit_power_dbm: Option<f64>,
    /// Longest call of the image by the radio library.
    pub longest_radio_call_cycles: u64,
    /// Frames that no buffer was free for.
    pub frames_dropped: u64,
    /// Buffers for frames that the image allows the radio: received, static and dynamic, and to send, likewise; 0 is without end.
    pub radio_buffers: Option<[u32; 4]>,
    /// Whether the watchdog of the fast loop's timer group is on.
    pub fast_watchdog_is_on: bool,
    /// Whether the low-power side's is.
    pub slow_watchdog_is_on: bool,
    /// Priority of the fast loop.
    pub fast_loop_priority: u32,
    /// Instructions that the fast loop executed from flash, and data that it read there.
    pub flash_in_ticks: u64,
    /// From the image's start to the start of the tasks' watchdog.
    pub slow_watchdog_after_cycles: Option<u64>,
    /// Whether a duty was ever to be taken over elsewhere than at the counter's peak.
    pub duties_taken_over_elsewhere: bool,
}
