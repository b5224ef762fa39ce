//! The radio at the border between the open driver (esp-radio) and Espressif's closed library: the functions of the
//! library that the image calls are done here, and the driver's callbacks are called as the library would.
//!
//! The library's own work (its tasks, the hardware, encryption) is not emulated. What it takes is charged ([`Times`]): it
//! scans and waits for answers while others run, and it calibrates and derives keys on the processor, in threads above all
//! of the image's, which only interrupts above its own come through.

use std::collections::{HashMap, VecDeque};
use std::time::Duration;

use crate::block::cycles;
use crate::cpu::Cpu;
use crate::fault::Trouble;
use crate::memory::{RADIO, RADIO_BYTES, ROM, ROM_BYTES, SCRATCH};
use crate::network::{AccessPoint, CHANNELS, Network, Security, Silence, is_key, key_of};
use crate::soc::{Outside, Soc};

/// Where a call of the image by the library returns to: an address that no function has.
pub(crate) const RETURN: u32 = ROM + ROM_BYTES - 0x10;
/// Bytes for a received frame.
const FRAME_BYTES: u32 = 2_048;
/// Received frames that there is room for here; how many the driver may hold the image states.
const FRAMES: usize = 32;
/// Where the data of an event lies.
const EVENT_DATA: u32 = RADIO + FRAMES as u32 * FRAME_BYTES;
const EVENT_BYTES: usize = 64;
const _: () = assert!(EVENT_DATA as usize + EVENT_BYTES <= RADIO as usize + RADIO_BYTES);
/// Cycles of a call into the library.
const CALL_CYCLES: u64 = 200;
/// Priority of interrupts that run the library's tasks: its calls of the image keep these out, and let higher ones in.
const OWN_PRIORITY: u32 = 1;
/// Modes of saving power: none, and what the library starts with (ESP-IDF, `wifi_ps_type_t`).
const NO_SLEEP: u32 = 0;
const LEAST_SLEEP: u32 = 1;
/// Bytes of a station's configuration (`wifi_sta_config_t`): name, password, how to scan.
const NAME: std::ops::Range<usize> = 0..32;
const PASSWORD: std::ops::Range<usize> = 32..96;
const SCAN_METHOD: usize = 96;
const STATION_BYTES: usize = 100;
/// Of the configuration of the library (`wifi_init_config_t`): the size of a part of its own in front of the numbers of buffers, and
/// those numbers behind it: received frames, static and dynamic, kind of those to send, these, static and dynamic.
const CRYPTO_SIZE: u32 = 4;
const BUFFERS: [u32; 4] = [0, 4, 12, 16];
/// Scans all channels and takes the strongest access point (`WIFI_ALL_CHANNEL_SCAN`).
const ALL_CHANNELS: u8 = 1;
/// What the program waits in while the library works: an interrupt, and again.
const WAIT: u32 = SCRATCH + 0x30;
const WAIT_FOR_INTERRUPT: u32 = 0x1050_0073;
const JUMP_BACK: u32 = 0xFFDF_F06F;

/// What the closed library takes, at worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Times {
    /// To calibrate the radio when it starts, on the processor: 100 ms were seen (ESP-IDF, "RF calibration"), three times
    /// as long is assumed.
    pub calibration: Duration,
    /// To listen on a channel (ESP-IDF, default of `wifi_scan_time_t`: active scans stay 120 ms at most).
    pub channel: Duration,
    /// For authentication, association and handshake, most of it waiting: assumed.
    pub association: Duration,
    /// For the handshake's check sums, on the processor: assumed.
    pub handshake: Duration,
    /// To derive a key from a pass phrase, on the processor. 111.8 million instructions of the library in this very image
    /// take 0.7 s at the least; three times as long is charged.
    pub derivation: Duration,
}

impl Times {
    /// At worst.
    pub const WORST: Self = Self {
        calibration: Duration::from_millis(300),
        channel: Duration::from_millis(120),
        association: Duration::from_millis(300),
        handshake: Duration::from_millis(50),
        derivation: Duration::from_secs(2),
    };
    /// None: the radio is ready at once.
    pub const NONE: Self = Self {
        calibration: Duration::ZERO,
        channel: Duration::ZERO,
        association: Duration::ZERO,
        handshake: Duration::ZERO,
        derivation: Duration::ZERO,
    };
}

/// How the image wants to connect.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Station {
    name: Vec<u8>,
    password: Vec<u8>,
    scans_all: bool,
}

/// What the library does at a time.
#[derive(Debug, Clone, Copy)]
enum Task {
    /// Keeps the processor for so many cycles.
    Keep(u64),
    /// Is on the network, and receives this power, dBm.
    Connect(i32),
    /// Is not, for this reason.
    Fail(u8),
    /// Has listened on all channels.
    Scanned,
}

/// Events of the library (`wifi_event_t`).
mod event {
    pub(super) const SCANNED: u32 = 1;
    pub(super) const STARTED: u32 = 2;
    pub(super) const CONNECTED: u32 = 4;
    pub(super) const DISCONNECTED: u32 = 5;
}
/// Why a connection ended, or none began (`wifi_err_reason_t`): the station leaves, the password is wrong, the beacon was
/// lost, there is no such network, none of it with a security that fits, or with enough of it.
mod reason {
    pub(super) const LEAVES: u8 = 8;
    pub(super) const HANDSHAKE: u8 = 15;
    pub(super) const BEACON_LOST: u8 = 200;
    pub(super) const NO_ACCESS_POINT: u8 = 201;
    pub(super) const OTHER_SECURITY: u8 = 210;
    pub(super) const TOO_OPEN: u8 = 211;
}
/// Where the reason lies in the event's data (`wifi_event_sta_disconnected_t`).
const REASON_OFFSET: usize = 39;

/// What the library returns where it does not start (`ESP_ERR_NO_MEM`).
const NO_MEMORY: u32 = 0x101;
/// What it returns while it connects (`ESP_ERR_WIFI_STATE`), and behind the last record of a scan (`ESP_FAIL`).
const BUSY: u32 = 0x3006;
const NO_MORE: u32 = u32::MAX;
/// Where a record of an access point has its name, channel, power and security, and how much of it is written
/// (`wifi_ap_record_t`).
const RECORD_NAME: usize = 6;
const RECORD_CHANNEL: usize = 39;
const RECORD_POWER: usize = 44;
const RECORD_SECURITY: usize = 48;
const RECORD_BYTES: usize = 80;
/// Functions of the library that are known; those that only set something return 0.
const FUNCTIONS: [&str; 26] = [
    "esp_wifi_init_internal",
    "esp_wifi_set_mode",
    "esp_wifi_get_mode",
    "esp_supplicant_init",
    "esp_wifi_set_tx_done_cb",
    "esp_wifi_internal_reg_rxcb",
    "esp_wifi_set_country",
    "esp_wifi_set_ps",
    "esp_wifi_set_max_tx_power",
    "esp_wifi_start",
    "esp_wifi_stop",
    "esp_wifi_set_config",
    "esp_wifi_get_config",
    "esp_wifi_connect_internal",
    "esp_wifi_internal_tx",
    "esp_wifi_internal_free_rx_buffer",
    "esp_wifi_sta_get_rssi",
    "esp_wifi_scan_start",
    "esp_wifi_scan_get_ap_num",
    "esp_wifi_scan_get_ap_record",
    "esp_wifi_clear_ap_list",
    "esp_wifi_set_protocols",
    "esp_wifi_set_bandwidths",
    "esp_wifi_disconnect_internal",
    "esp_wifi_deinit_internal",
    "esp_supplicant_deinit",
];
/// The driver's own receiver of events.
const EVENT_RECEIVER: &str = "__esp_radio_esp_event_post";

/// A call that the library makes of the image, or so many cycles in which it lets none of its threads run.
#[derive(Debug, Clone, Copy)]
enum Call {
    Image { function: u32, arguments: [u32; 5] },
    Keep(u64),
}

/// What a call interrupted.
struct Interrupted {
    x: [u32; 64],
    pc: u32,
    threshold: u32,
}

/// The library.
pub(crate) struct Radio {
    /// Where the known functions lie.
    pub(crate) functions: Vec<(u32, &'static str)>,
    event_receiver: u32,
    frame_receiver: u32,
    sent_receiver: u32,
    mode: u32,
    transmit_power: Option<i8>,
    power_saving: u32,
    is_connected: bool,
    station: Station,
    signal_dbm: i32,
    /// Access points that the last scan found, and whether one is under way.
    found: VecDeque<AccessPoint>,
    is_scanning: bool,
    /// What it does at which cycle.
    agenda: VecDeque<(u64, Task)>,
    calls: VecDeque<Call>,
    interrupted: Option<Interrupted>,
    /// Until when it keeps the processor.
    keeps_until: Option<u64>,
    /// What everything takes.
    pub(crate) times: Times,
    /// Cycles for which it masks all interrupts with each call.
    pub(crate) lock: u64,
    /// Attempts to connect since power-on, and how often it was made anew.
    pub(crate) attempts: u64,
    pub(crate) renewals: u64,
    /// Buffers for frames that the image allows: received, static and dynamic, and to send, likewise; 0 is without end.
    pub(crate) buffers: Option<[u32; 4]>,
    busy: [bool; FRAMES],
    /// Frames that no buffer was free for.
    pub(crate) overruns: u64,
    /// The longest call of the image, cycles, and when the present one began.
    pub(crate) longest_call: u64,
    began: u64,
}

impl Radio {
    /// Creates the radio before it was started, in an image with these symbols.
    pub(crate) fn new(symbols: impl Iterator<Item = (u32, String)>) -> Self {
        let by_name: HashMap<String, u32> = symbols.map(|(at, name)| (name, at)).collect();
        let functions = FUNCTIONS
            .iter()
            .filter_map(|name| by_name.get(*name).map(|address| (*address, *name)))
            .collect();
        Self {
            functions,
            event_receiver: by_name.get(EVENT_RECEIVER).copied().unwrap_or(0),
            frame_receiver: 0,
            sent_receiver: 0,
            mode: 0,
            transmit_power: None,
            power_saving: LEAST_SLEEP,
            is_connected: false,
            station: Station::default(),
            signal_dbm: 0,
            found: VecDeque::new(),
            is_scanning: false,
            agenda: VecDeque::new(),
            calls: VecDeque::new(),
            interrupted: None,
            keeps_until: None,
            times: Times::NONE,
            lock: 0,
            attempts: 0,
            renewals: 0,
            buffers: None,
            busy: [false; FRAMES],
            overruns: 0,
            longest_call: 0,
            began: 0,
        }
    }

    fn none() -> Self {
        Self::new(std::iter::empty())
    }

    /// Resets, as with the chip.
    pub(crate) fn reset(&mut self) {
        let functions = std::mem::take(&mut self.functions);
        let Self { event_receiver, times, lock, attempts, renewals, .. } = *self;
        let none = Self::none();
        let kept = Self { functions, event_receiver, times, lock, attempts, renewals, ..none };
        *self = kept;
    }

    /// Returns the transmit power that the image asked for, dBm; `None` where it left the driver's.
    pub(crate) fn transmit_power(&self) -> Option<f64> {
        // In quarters of a decibel.
        self.transmit_power.map(|quarters| f64::from(quarters) / 4.0)
    }

    /// Returns whether it sleeps between beacons.
    pub(crate) fn sleeps(&self) -> bool {
        self.power_saving != NO_SLEEP
    }

    /// Returns the received power, dBm, while it is connected.
    pub(crate) fn signal(&self) -> Option<i32> {
        self.is_connected.then_some(self.signal_dbm)
    }

    /// Notes how the image wants to connect.
    fn configure(&mut self, at: u32, soc: &Soc<impl Outside>) -> Option<()> {
        let bytes = soc.memory.bytes(at, STATION_BYTES)?;
        let text = |range: std::ops::Range<usize>| {
            bytes[range].iter().copied().take_while(|byte| *byte != 0).collect()
        };
        self.station = Station {
            name: text(NAME),
            password: text(PASSWORD),
            scans_all: bytes[SCAN_METHOD] == ALL_CHANNELS,
        };
        Some(())
    }

    /// Notes how many buffers the image allows.
    fn configure_buffers(&mut self, at: u32, soc: &Soc<impl Outside>) -> Option<()> {
        let behind = at + CRYPTO_SIZE + soc.memory.load(at + CRYPTO_SIZE, 4)?;
        let mut buffers = [0; 4];
        for (number, offset) in buffers.iter_mut().zip(BUFFERS) {
            *number = soc.memory.load(behind.wrapping_add(offset), 4)?;
        }
        self.buffers = Some(buffers);
        Some(())
    }

    /// Returns whether it connects, or listens for access points.
    fn is_busy(&self) -> bool {
        self.agenda.iter().any(|(_, task)| !matches!(task, Task::Keep(_)))
    }

    /// Ends whatever it was about to do.
    fn clear_agenda(&mut self) {
        self.is_scanning = false;
        self.agenda.clear();
    }

    /// Returns how many received frames the driver may hold.
    fn frames(&self) -> usize {
        match self.buffers {
            Some([_, dynamic, ..]) if dynamic > 0 => FRAMES.min(dynamic as usize),
            _ => FRAMES,
        }
    }

    /// Begins to connect: what it will do when.
    fn connect(&mut self, network: &mut Network, now: u64) {
        self.attempts += 1;
        self.is_connected = false;
        self.clear_agenda();
        if network.silence.swallows() {
            return;
        }
        let times = self.times;
        let mut at = now;
        let found = network.found(&self.station.name, self.station.scans_all);
        let channels = found.map_or(CHANNELS, |(channels, _)| channels);
        at += channels * cycles(times.channel);
        let password = String::from_utf8_lossy(&self.station.password).into_owned();
        let refusal = match found.map(|(_, access_point)| access_point.security) {
            None => Some(reason::NO_ACCESS_POINT),
            Some(Security::Open) if !password.is_empty() => Some(reason::TOO_OPEN),
            Some(Security::Enterprise) => Some(reason::OTHER_SECURITY),
            Some(Security::Wpa2) if password.is_empty() => Some(reason::OTHER_SECURITY),
            Some(Security::Open | Security::Wpa2) => None,
        };
        let Some((_, access_point)) = found.filter(|_| refusal.is_none()) else {
            self.agenda.push_back((at, Task::Fail(refusal.unwrap_or(reason::NO_ACCESS_POINT))));
            return;
        };
        at += cycles(times.association);
        if !password.is_empty() {
            let derivation = if is_key(&password) { Duration::ZERO } else { times.derivation };
            let kept = cycles(derivation + times.handshake);
            self.agenda.push_back((at, Task::Keep(kept)));
            at += kept;
        }
        let name = &self.station.name;
        let is_right = key_of(name, &access_point.passphrase) == key_of(name, &password);
        let task =
            if is_right { Task::Connect(access_point.dbm) } else { Task::Fail(reason::HANDSHAKE) };
        self.agenda.push_back((at, task));
    }

    /// Does what is due.
    fn work(
        &mut self,
        now: u64,
        soc: &mut Soc<impl Outside>,
        network: &Network,
    ) -> Result<(), Trouble> {
        while let Some((_, task)) = self.agenda.pop_front_if(|(at, _)| *at <= now) {
            let call = match task {
                Task::Keep(0) => continue,
                Task::Keep(cycles) => Call::Keep(cycles),
                Task::Connect(signal_dbm) if network.air.is_up => {
                    self.is_connected = true;
                    self.signal_dbm = signal_dbm;
                    self.event(event::CONNECTED, 0, soc)?
                }
                Task::Connect(_) => {
                    self.event(event::DISCONNECTED, reason::NO_ACCESS_POINT, soc)?
                }
                Task::Fail(reason) => self.event(event::DISCONNECTED, reason, soc)?,
                Task::Scanned => {
                    self.is_scanning = false;
                    self.found = network.heard().iter().cloned().collect();
                    self.event(event::SCANNED, 0, soc)?
                }
            };
            self.calls.push_back(call);
        }
        Ok(())
    }

    /// Does a function of the library.
    pub(crate) fn call<O: Outside>(
        &mut self,
        number: i32,
        cpu: &mut Cpu,
        soc: &mut Soc<O>,
        network: &mut Network,
    ) -> Result<(), Trouble> {
        let unknown = || Trouble::Radio(format!("call of function {number}"));
        let (_, name) = *self.functions.get(number as usize).ok_or_else(unknown)?;
        soc.early.radio.get_or_insert(cpu.cycles);
        let argument = |index: usize| cpu.x[10 + index];
        let beyond = || Trouble::Radio(format!("{name}: an argument beyond memory"));
        cpu.cycles += CALL_CYCLES + self.lock;
        let mut result = 0;
        match name {
            "esp_wifi_init_internal" if network.start_failures > 0 => {
                network.start_failures -= 1;
                result = NO_MEMORY;
            }
            "esp_wifi_init_internal" => {
                self.configure_buffers(argument(0), soc).ok_or_else(beyond)?;
            }
            "esp_wifi_set_mode" => self.mode = argument(0),
            "esp_wifi_get_mode" => {
                soc.memory.store(argument(0), self.mode, 4).ok_or_else(beyond)?;
            }
            "esp_wifi_set_max_tx_power" => self.transmit_power = Some(argument(0) as i8),
            "esp_wifi_set_ps" => self.power_saving = argument(0),
            "esp_wifi_set_tx_done_cb" => self.sent_receiver = argument(0),
            "esp_wifi_internal_reg_rxcb" if argument(0) == 0 => self.frame_receiver = argument(1),
            "esp_wifi_sta_get_rssi" => {
                soc.memory.store(argument(0), self.signal_dbm as u32, 4).ok_or_else(beyond)?;
            }
            // It listens on all channels, and hears nothing of its own meanwhile.
            "esp_wifi_scan_start" if !self.is_busy() => {
                self.is_scanning = true;
                let at = cpu.cycles + CHANNELS * cycles(self.times.channel);
                self.agenda.push_back((at, Task::Scanned));
            }
            "esp_wifi_scan_start" => result = BUSY,
            "esp_wifi_scan_get_ap_num" => {
                let number = self.found.len() as u32;
                soc.memory.store(argument(0), number, 2).ok_or_else(beyond)?;
            }
            "esp_wifi_scan_get_ap_record" => match self.found.pop_front() {
                Some(access_point) => {
                    let record = record(&access_point);
                    let bytes = soc.memory.bytes_mut(argument(0), RECORD_BYTES);
                    bytes.ok_or_else(beyond)?.copy_from_slice(&record);
                }
                None => result = NO_MORE,
            },
            "esp_wifi_clear_ap_list" => self.found.clear(),
            // Interface 0 is the station's.
            "esp_wifi_set_config" if argument(0) == 0 => {
                self.configure(argument(1), soc).ok_or_else(beyond)?;
            }
            // ESP_ERR_WIFI_NOT_INIT: nothing was configured before.
            "esp_wifi_get_config" => result = 0x3001,
            // Its event comes before the call returns: the receiver is called in its place.
            "esp_wifi_start" => {
                let calibration = cycles(self.times.calibration);
                self.agenda.push_back((cpu.cycles, Task::Keep(calibration)));
                return self.post(event::STARTED, cpu, soc);
            }
            "esp_wifi_connect_internal" => self.connect(network, cpu.cycles),
            "esp_wifi_disconnect_internal" => {
                // An attempt is over, too; but one that nothing comes of stays so.
                let is_on = self.is_connected || !self.agenda.is_empty();
                self.is_connected = false;
                self.clear_agenda();
                if is_on {
                    self.agenda.push_back((cpu.cycles, Task::Fail(reason::LEAVES)));
                }
            }
            "esp_wifi_stop" => {
                self.is_connected = false;
                self.clear_agenda();
            }
            "esp_wifi_deinit_internal" => {
                self.renewals += 1;
                self.mode = 0;
                self.frame_receiver = 0;
                network.silence.end(Silence::UntilRenewed);
            }
            "esp_wifi_internal_free_rx_buffer" => {
                let index = (argument(0).wrapping_sub(RADIO) / FRAME_BYTES) as usize;
                *self.busy.get_mut(index).ok_or_else(beyond)? = false;
            }
            "esp_wifi_internal_tx" => {
                let (data, length) = (argument(1), argument(2) as usize);
                let frame = soc.memory.bytes(data, length).ok_or_else(beyond)?.to_vec();
                let arguments = [0, data, 0, 1, 0];
                self.calls.push_back(Call::Image { function: self.sent_receiver, arguments });
                if self.is_connected && !self.is_scanning {
                    network.transmit(&frame, cpu.cycles);
                }
            }
            _ => {}
        }
        cpu.x[10] = result;
        cpu.pc = cpu.x[1];
        Ok(())
    }

    fn event(&self, event: u32, reason: u8, soc: &mut Soc<impl Outside>) -> Result<Call, Trouble> {
        let beyond = || Trouble::Radio("no memory for an event".to_owned());
        let data = soc.memory.bytes_mut(EVENT_DATA, EVENT_BYTES).ok_or_else(beyond)?;
        data.fill(0);
        if event == event::DISCONNECTED {
            data[REASON_OFFSET] = reason;
        }
        let arguments = [0, event, EVENT_DATA, EVENT_BYTES as u32, 0];
        Ok(Call::Image { function: self.event_receiver, arguments })
    }

    fn post(
        &mut self,
        event: u32,
        cpu: &mut Cpu,
        soc: &mut Soc<impl Outside>,
    ) -> Result<(), Trouble> {
        if let Call::Image { function, arguments } = self.event(event, 0, soc)? {
            cpu.x[10..15].copy_from_slice(&arguments);
            cpu.pc = function;
        }
        Ok(())
    }

    /// Takes what the air brings, and notices when it is gone.
    pub(crate) fn poll<O: Outside>(
        &mut self,
        now: u64,
        soc: &mut Soc<O>,
        network: &mut Network,
    ) -> Result<(), Trouble> {
        if self.is_connected && !network.air.is_up {
            self.is_connected = false;
            let call = self.event(event::DISCONNECTED, reason::BEACON_LOST, soc)?;
            self.calls.push_back(call);
        }
        self.work(now, soc, network)?;
        while let Some(frame) = network.arrived(now) {
            if !self.is_connected || self.is_scanning || self.frame_receiver == 0 {
                continue;
            }
            let Some(index) = self.busy.iter().take(self.frames()).position(|busy| !busy) else {
                self.overruns += 1;
                continue;
            };
            let at = RADIO + index as u32 * FRAME_BYTES;
            let Some(memory) = soc.memory.bytes_mut(at, frame.len()) else { continue };
            memory.copy_from_slice(&frame);
            self.busy[index] = true;
            let arguments = [at, frame.len() as u32, at, 0, 0];
            self.calls.push_back(Call::Image { function: self.frame_receiver, arguments });
        }
        Ok(())
    }

    /// Calls the image, if there is something to call and nothing masks it; whether it did.
    ///
    /// As in an interrupt of the lowest priority: the scheduler does not switch threads in its middle, and the fast
    /// loop goes on.
    pub(crate) fn inject(&mut self, cpu: &mut Cpu, soc: &mut Soc<impl Outside>) -> bool {
        let threshold = soc.interrupts.threshold();
        let is_free =
            self.interrupted.is_none() && cpu.takes_interrupts() && threshold <= OWN_PRIORITY;
        let Some(call) = self.calls.pop_front_if(|_| is_free) else { return false };
        self.interrupted = Some(Interrupted { x: cpu.x, pc: cpu.pc, threshold });
        soc.interrupts.set_threshold(OWN_PRIORITY + 1);
        cpu.cycles += self.lock;
        self.began = cpu.cycles;
        match call {
            Call::Image { function, arguments } => {
                cpu.x[1] = RETURN;
                cpu.x[10..15].copy_from_slice(&arguments);
                cpu.pc = function;
            }
            Call::Keep(cycles) => {
                soc.memory.store(WAIT, WAIT_FOR_INTERRUPT, 4);
                soc.memory.store(WAIT + 4, JUMP_BACK, 4);
                cpu.forget(WAIT, 8);
                cpu.pc = WAIT;
                self.keeps_until = Some(cpu.cycles + cycles);
            }
        }
        true
    }

    /// Returns when the library gives the processor back.
    pub(crate) fn keeps_until(&self) -> Option<u64> {
        self.keeps_until
    }

    /// Gives the processor back, once it is time and no interrupt is under way; whether it did.
    pub(crate) fn give_back(
        &mut self,
        cpu: &mut Cpu,
        soc: &mut Soc<impl Outside>,
    ) -> Result<bool, Trouble> {
        let is_over = self.keeps_until.is_some_and(|until| until <= cpu.cycles);
        let is_waiting = cpu.pc.wrapping_sub(WAIT) < 8;
        if !(is_over && is_waiting && cpu.takes_interrupts()) {
            return Ok(false);
        }
        self.keeps_until = None;
        self.returned(cpu, soc).map(|()| true)
    }

    /// Returns whether the image is in a call by the library.
    pub(crate) fn is_calling(&self) -> bool {
        self.interrupted.is_some()
    }

    /// Returns whether something waits to be called.
    pub(crate) fn wants(&self) -> bool {
        !self.calls.is_empty() && self.interrupted.is_none()
    }

    /// Goes on after the image has returned from a call.
    pub(crate) fn returned(
        &mut self,
        cpu: &mut Cpu,
        soc: &mut Soc<impl Outside>,
    ) -> Result<(), Trouble> {
        let nobody = || Trouble::Radio("a return without a call".to_owned());
        let interrupted = self.interrupted.take().ok_or_else(nobody)?;
        if cpu.pc == RETURN {
            self.longest_call = self.longest_call.max(cpu.cycles - self.began);
        }
        cpu.x = interrupted.x;
        cpu.pc = interrupted.pc;
        soc.interrupts.set_threshold(interrupted.threshold);
        Ok(())
    }
}

/// Returns the library's record of an access point.
fn record(access_point: &AccessPoint) -> [u8; RECORD_BYTES] {
    let mut record = [0; RECORD_BYTES];
    record[RECORD_NAME..][..access_point.name.len()].copy_from_slice(&access_point.name);
    record[RECORD_CHANNEL] = access_point.channel;
    record[RECORD_POWER] = access_point.dbm as u8;
    record[RECORD_SECURITY] = access_point.security as u8;
    record
}
