//! Wi-Fi: connects, connects again when it is lost, and never blocks anything else meanwhile.
//!
//! What is tried when is [`joining`]'s; this does it.

use core::cell::Cell;

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_net::{Config, Ipv4Cidr, Runner, StaticConfigV4};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use esp_hal::peripherals::WIFI;
use esp_radio::wifi::sta::{ScanMethod, StationConfig};
use esp_radio::wifi::{
    AuthenticationMethodConfig, Config as WifiConfig, ConnectionError, ControllerConfig,
    DisconnectReason, Interface, PowerSaveMode, WifiController,
};

use flix_firmware::joining::{self, ATTEMPT, Credential, Joining, Next};
use flix_firmware::neighbours::Guarded;
use flix_firmware::net;
use flix_protocol::network_key::{KeyDigits, NetworkKey};
use flix_protocol::provision::Provisioning;

use crate::chip;
use crate::log::{self, log};
use crate::serial;
use crate::shared::Shared;
use crate::watchdog::Window;

/// How often a robot whose motors are driven looks whether it may connect.
const IDLE_INTERVAL: Duration = Duration::from_millis(100);
/// A driver that is asked to end a try has so long to say so.
const FAREWELL: Duration = Duration::from_secs(1);
/// Rounds of a derivation before others get a turn: some milliseconds.
const ROUNDS_AT_ONCE: u32 = 64;
/// How often the radio's power is read.
const SIGNAL_INTERVAL: Duration = Duration::from_secs(1);

/// Transmit power, in quarters of a decibel: 15 dBm. The driver's own 5 dBm are for a table; above 16 dBm it has been seen
/// to fail to authenticate (esp-radio 1.0.0-beta.1, `set_max_tx_power`).
const TRANSMIT_POWER: i8 = 60;

/// Frames that the driver keeps at most, each way. Each takes 1.6 KB of its heap; by default it is 32, 51 KB of 80 KiB, of which a
/// connected driver takes some 50 KiB besides. No fewer than the receiver's own buffers, which are as many here, and those
/// no fewer than the 6 frames that are acknowledged at once (esp-radio 1.0.0-beta.1, `ControllerConfig`).
const BUFFERS: u8 = 8;

/// Radio power as last received, dBm.
pub(crate) static SIGNAL: Mutex<CriticalSectionRawMutex, Cell<Option<i8>>> =
    Mutex::new(Cell::new(None));

/// Starts the radio; `None` when it does not start.
pub(crate) fn start(wifi: WIFI<'static>) -> Option<WifiController<'static>> {
    // Calibrating takes its time.
    let _window = Window::open();
    let buffers = ControllerConfig::default()
        .with_static_rx_buf_num(BUFFERS)
        .with_dynamic_rx_buf_num(BUFFERS.into())
        .with_dynamic_tx_buf_num(BUFFERS.into());
    WifiController::new(wifi, buffers)
        .inspect_err(|error| log!("wi-fi: does not start: {error:?}"))
        .ok()
}

/// Starts the radio once more.
#[expect(unsafe_code, reason = "the driver keeps the peripheral that it was given")]
fn start_again() -> Option<WifiController<'static>> {
    // SAFETY: the driver that had the peripheral was dropped, and nobody else has it.
    start(unsafe { WIFI::steal() })
}

/// Returns the network's name and this password for the driver; `None` when they are longer than Wi-Fi allows.
fn station(network: &str, password: &str) -> Option<WifiConfig> {
    let authentication = match password {
        "" => AuthenticationMethodConfig::Open,
        // The least that is accepted. An access point that offers WPA3 alone is not supported (esp-radio 1.0.0-beta.1,
        // `wifi`); one that offers WPA2, too, is.
        password => AuthenticationMethodConfig::Wpa2Personal(password.try_into().ok()?),
    };
    let station = StationConfig::default()
        .with_ssid(network.try_into().ok()?)
        .with_authentication(authentication)
        // The strongest access point of the network, not the first.
        .with_scan_method(ScanMethod::AllChannels);
    Some(WifiConfig::Station(station))
}

/// Derives the network's key, a slice at a time: others run meanwhile.
async fn derive(provisioning: &Provisioning) -> KeyDigits {
    let mut derivation = NetworkKey::new(provisioning.network(), provisioning.password());
    loop {
        if let Some(key) = derivation.advance(ROUNDS_AT_ONCE) {
            return key;
        }
        yield_now().await;
    }
}

/// Chooses DHCP, or the fixed address of provisioning, whose prefix was checked when it was stored.
pub(crate) fn addresses(provisioning: &Provisioning) -> Config {
    match provisioning.address() {
        None => Config::dhcpv4(net::dhcp(provisioning.name())),
        Some(fixed) => Config::ipv4_static(StaticConfigV4 {
            address: Ipv4Cidr::new(fixed.address.into(), fixed.prefix_length),
            gateway: fixed.gateway.map(Into::into),
            dns_servers: Default::default(),
        }),
    }
}

/// Runs the network stack.
#[embassy_executor::task]
pub(crate) async fn run_stack(mut runner: Runner<'static, Guarded<Interface>>) {
    runner.run().await;
}

/// Keeps the station connected for ever.
#[embassy_executor::task]
pub(crate) async fn stay_connected(
    controller: WifiController<'static>,
    provisioning: &'static Provisioning,
    exchange: &'static Shared,
) {
    let mut joining = Joining::new(provisioning.password());
    let key = match joining.credential() {
        Credential::Key => derive(provisioning).await,
        Credential::Password => KeyDigits::default(),
    };
    let mut controller = Some(controller);
    loop {
        while !joining::may_try(exchange.state()) {
            Timer::after(IDLE_INTERVAL).await;
        }
        let password = match joining.credential() {
            Credential::Key => key.as_str(),
            Credential::Password => provisioning.password(),
        };
        let Some(station) = station(provisioning.network(), password) else {
            log!("wi-fi: the network's name or password is too long: provision the robot again");
            return;
        };
        let next = match controller.as_mut() {
            None => joining.silent(),
            Some(controller) => match connect(controller, &station).await {
                Ok(()) => {
                    joining.connected();
                    log!("wi-fi: connected to {}", provisioning.network());
                    log_memory();
                    let since = Instant::now();
                    watch(controller).await;
                    joining.lost(since.elapsed().into())
                }
                Err(Failure::Reason(reason)) => {
                    log!("wi-fi: cannot connect: {reason:?}{}", hint(reason));
                    joining.failed(!is_absent(reason))
                }
                Err(Failure::Silence) => {
                    log!(
                        "wi-fi: cannot connect: the radio says nothing for {} s",
                        ATTEMPT.as_secs()
                    );
                    joining.silent()
                }
            },
        };
        let (Next::Retry(wait) | Next::Renew(wait) | Next::Restart(wait)) = next;
        match next {
            Next::Retry(_) => {}
            Next::Restart(_) if may_restart(exchange) => {
                restart("the radio still says nothing", exchange).await;
            }
            Next::Renew(_) | Next::Restart(_) => {
                log!("wi-fi: the radio is started again");
                drop(controller.take());
                controller = start_again();
            }
        }
        log!("wi-fi: next attempt in {} ms", wait.as_millis());
        Timer::after(wait.try_into().unwrap_or(IDLE_INTERVAL)).await;
    }
}

/// Starts a radio that did not start with the chip, and then restarts the chip: the robot's secret and operators are made once, from
/// the noise of a running radio.
#[embassy_executor::task]
pub(crate) async fn start_late(exchange: &'static Shared) {
    let mut joining = Joining::new("");
    loop {
        let next = joining.silent();
        let (Next::Retry(wait) | Next::Renew(wait) | Next::Restart(wait)) = next;
        log!("wi-fi: next attempt to start the radio in {} ms", wait.as_millis());
        Timer::after(wait.try_into().unwrap_or(IDLE_INTERVAL)).await;
        if may_restart(exchange) {
            match (start_again(), next) {
                (Some(_), _) => restart("the radio starts now", exchange).await,
                (None, Next::Restart(_)) => restart("the radio does not start", exchange).await,
                (None, _) => {}
            }
        }
    }
}

/// Restarts the chip once the log has left, unless the motors are driven or the serial cable is in use then.
async fn restart(why: &str, exchange: &Shared) {
    log!("wi-fi: {why}: starting anew");
    log::drained().await;
    if may_restart(exchange) {
        esp_hal::system::software_reset();
    }
}

fn may_restart(exchange: &Shared) -> bool {
    joining::may_restart(exchange.state(), serial::silence())
}

/// Why a try failed.
enum Failure {
    /// For this one.
    Reason(DisconnectReason),
    /// Nobody knows: the driver refuses it, or nothing comes of it.
    Silence,
}

/// Tries once, with a watchdog that is patient meanwhile.
async fn connect(
    controller: &mut WifiController<'static>,
    station: &WifiConfig,
) -> Result<(), Failure> {
    let window = Window::open();
    // Modem sleep was seen to add up to half a second to a datagram.
    if controller.set_power_saving(PowerSaveMode::None).is_err() {
        log!("wi-fi: power saving cannot be switched off: expect late commands");
    }
    if let Err(error) = controller.set_config(station) {
        log!("wi-fi: the radio refuses the network: {error:?}");
        return Err(Failure::Silence);
    }
    if controller.set_max_tx_power(TRANSMIT_POWER).is_err() {
        log!("wi-fi: transmits at 5 dBm: expect a short range");
    }
    let attempt = embassy_time::Duration::from_millis(ATTEMPT.as_millis() as u64);
    match with_timeout(attempt, controller.connect_async()).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err(ConnectionError::Failed(info))) => Err(Failure::Reason(info.reason)),
        Ok(Err(error)) => {
            log!("wi-fi: the radio refuses to connect: {error:?}");
            Err(Failure::Silence)
        }
        Err(_) => {
            drop(window);
            // Whether it answers to this or not.
            let _ = with_timeout(FAREWELL, controller.disconnect_async()).await;
            Err(Failure::Silence)
        }
    }
}

/// Returns whether there is no access point that could have refused anything.
fn is_absent(reason: DisconnectReason) -> bool {
    matches!(reason, DisconnectReason::NoAccessPointFound | DisconnectReason::BeaconTimeout)
}

/// Returns what a person may look at.
fn hint(reason: DisconnectReason) -> &'static str {
    match reason {
        DisconnectReason::NoAccessPointFound => {
            " (no network of this name at 2.4 GHz: 5 GHz is not received)"
        }
        DisconnectReason::NoAccessPointFoundWithCompatibleSecurity
        | DisconnectReason::NoAccessPointFoundInAuthmodeThreshold => {
            " (it has to offer WPA2: WPA3 alone is not supported)"
        }
        DisconnectReason::FourWayHandshakeTimeout
        | DisconnectReason::HandshakeTimeout
        | DisconnectReason::MicFailure
        | DisconnectReason::AuthenticationFailed
        | DisconnectReason::AuthenticationExpired => {
            " (is the password right? WPA3 alone is not supported)"
        }
        _ => "",
    }
}

/// Prints what was used at most of memory so far.
fn log_memory() {
    let heap = esp_alloc::HEAP.stats();
    log!("heap: {} of {} bytes used at most", heap.max_usage, heap.size);
    if let Some([unused, bytes]) = chip::unused_stack() {
        log!("stack of core 1: {unused} of {bytes} bytes never used");
    }
}

/// Reads the radio's power until the connection is gone.
async fn watch(controller: &mut WifiController<'static>) {
    let mut reason = None;
    while controller.is_connected() {
        let dbm = controller.rssi().ok().and_then(|dbm| i8::try_from(dbm).ok());
        SIGNAL.lock(|signal| signal.set(dbm.or(signal.get())));
        let gone = controller.wait_for_disconnect_async();
        if let Either::First(Ok(info)) = select(gone, Timer::after(SIGNAL_INTERVAL)).await {
            reason = Some(info.reason);
        }
    }
    SIGNAL.lock(Cell::take);
    match reason {
        Some(reason) => log!("wi-fi: lost: {reason:?}"),
        None => log!("wi-fi: lost"),
    }
}
