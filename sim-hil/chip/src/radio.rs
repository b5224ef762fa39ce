//! The radio at the border between the open driver (esp-radio) and Espressif's closed library: the functions of the
//! library that the image calls are done here, and the driver's callbacks are called as the library would.
//!
//! The library's own work (its tasks, the hardware, encryption) is not emulated, and its time is not counted.

use std::collections::{HashMap, VecDeque};

use crate::cpu::Cpu;
use crate::fault::Trouble;
use crate::memory::{RADIO, RADIO_BYTES};
use crate::network::Network;
use crate::soc::{Outside, Soc};

/// Where a call of the image by the library returns to: an address that no function has.
pub(crate) const RETURN: u32 = crate::rom::ROM + crate::rom::ROM_BYTES - 0x10;
/// Bytes for a received frame.
const FRAME_BYTES: u32 = 2_048;
/// Received frames that the driver may hold.
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
/// Received power, dBm.
const SIGNAL_DBM: i32 = -42;

/// Events of the library (`wifi_event_t`).
mod event {
    pub(super) const STARTED: u32 = 2;
    pub(super) const CONNECTED: u32 = 4;
    pub(super) const DISCONNECTED: u32 = 5;
}
/// Why a connection ended: the beacon was lost.
const REASON_BEACON_LOST: u8 = 200;
/// Where the reason lies in the event's data (`wifi_event_sta_disconnected_t`).
const REASON_OFFSET: usize = 39;

/// Functions of the library that are known; those that only set something return 0.
const FUNCTIONS: [&str; 20] = [
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
    "esp_wifi_set_protocols",
    "esp_wifi_set_bandwidths",
    "esp_wifi_disconnect_internal",
];
/// The driver's own receiver of events.
const EVENT_RECEIVER: &str = "__esp_radio_esp_event_post";

/// A call that the library makes of the image.
#[derive(Debug, Clone, Copy)]
struct Call {
    function: u32,
    arguments: [u32; 5],
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
    calls: VecDeque<Call>,
    interrupted: Option<Interrupted>,
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
            calls: VecDeque::new(),
            interrupted: None,
            busy: [false; FRAMES],
            overruns: 0,
            longest_call: 0,
            began: 0,
        }
    }

    /// Resets, as with the chip.
    pub(crate) fn reset(&mut self) {
        let functions = std::mem::take(&mut self.functions);
        let event_receiver = self.event_receiver;
        *self = Self { functions, event_receiver, ..Self::new(std::iter::empty()) };
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
        let argument = |index: usize| cpu.x[10 + index];
        let beyond = || Trouble::Radio(format!("{name}: an argument beyond memory"));
        cpu.cycles += CALL_CYCLES;
        let mut result = 0;
        match name {
            "esp_wifi_set_mode" => self.mode = argument(0),
            "esp_wifi_get_mode" => {
                soc.memory.store(argument(0), self.mode, 4).ok_or_else(beyond)?;
            }
            "esp_wifi_set_max_tx_power" => self.transmit_power = Some(argument(0) as i8),
            "esp_wifi_set_ps" => self.power_saving = argument(0),
            "esp_wifi_set_tx_done_cb" => self.sent_receiver = argument(0),
            "esp_wifi_internal_reg_rxcb" if argument(0) == 0 => self.frame_receiver = argument(1),
            "esp_wifi_sta_get_rssi" => {
                soc.memory.store(argument(0), SIGNAL_DBM as u32, 4).ok_or_else(beyond)?;
            }
            // ESP_ERR_WIFI_NOT_INIT: nothing was configured before.
            "esp_wifi_get_config" => result = 0x3001,
            // Events come before the call returns: the receiver is called in its place.
            "esp_wifi_start" => return self.post(event::STARTED, cpu, soc),
            "esp_wifi_connect_internal" => {
                self.is_connected = network.air.is_up;
                let event = match self.is_connected {
                    true => event::CONNECTED,
                    false => event::DISCONNECTED,
                };
                return self.post(event, cpu, soc);
            }
            "esp_wifi_disconnect_internal" | "esp_wifi_stop" => self.is_connected = false,
            "esp_wifi_internal_free_rx_buffer" => {
                let index = (argument(0).wrapping_sub(RADIO) / FRAME_BYTES) as usize;
                *self.busy.get_mut(index).ok_or_else(beyond)? = false;
            }
            "esp_wifi_internal_tx" => {
                let (data, length) = (argument(1), argument(2) as usize);
                let frame = soc.memory.bytes(data, length).ok_or_else(beyond)?.to_vec();
                let arguments = [0, data, 0, 1, 0];
                self.calls.push_back(Call { function: self.sent_receiver, arguments });
                if self.is_connected {
                    network.transmit(&frame, cpu.cycles);
                }
            }
            _ => {}
        }
        cpu.x[10] = result;
        cpu.pc = cpu.x[1];
        Ok(())
    }

    fn event(&self, event: u32, soc: &mut Soc<impl Outside>) -> Result<Call, Trouble> {
        let beyond = || Trouble::Radio("no memory for an event".to_owned());
        let data = soc.memory.bytes_mut(EVENT_DATA, EVENT_BYTES).ok_or_else(beyond)?;
        data.fill(0);
        if event == event::DISCONNECTED {
            data[REASON_OFFSET] = REASON_BEACON_LOST;
        }
        let arguments = [0, event, EVENT_DATA, EVENT_BYTES as u32, 0];
        Ok(Call { function: self.event_receiver, arguments })
    }

    fn post(
        &mut self,
        event: u32,
        cpu: &mut Cpu,
        soc: &mut Soc<impl Outside>,
    ) -> Result<(), Trouble> {
        let call = self.event(event, soc)?;
        cpu.x[10..15].copy_from_slice(&call.arguments);
        cpu.pc = call.function;
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
            let call = self.event(event::DISCONNECTED, soc)?;
            self.calls.push_back(call);
        }
        while let Some(frame) = network.arrived(now) {
            if !self.is_connected || self.frame_receiver == 0 {
                continue;
            }
            let Some(index) = self.busy.iter().position(|busy| !busy) else {
                self.overruns += 1;
                continue;
            };
            let at = RADIO + index as u32 * FRAME_BYTES;
            let Some(memory) = soc.memory.bytes_mut(at, frame.len()) else { continue };
            memory.copy_from_slice(&frame);
            self.busy[index] = true;
            let arguments = [at, frame.len() as u32, at, 0, 0];
            self.calls.push_back(Call { function: self.frame_receiver, arguments });
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
        self.began = cpu.cycles;
        cpu.x[1] = RETURN;
        cpu.x[10..15].copy_from_slice(&call.arguments);
        cpu.pc = call.function;
        true
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
        self.longest_call = self.longest_call.max(cpu.cycles - self.began);
        cpu.x = interrupted.x;
        cpu.pc = interrupted.pc;
        soc.interrupts.set_threshold(interrupted.threshold);
        Ok(())
    }
}
