//! Wi-Fi: connects, connects again when it is lost, and never blocks anything else meanwhile.
//!
//! What is tried when is [`joining`]'s; this does it.

use core::cell::Cell;
use core::hash::{Hash, Hasher};

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_net::{Config, Ipv4Cidr, Runner, Stack, StaticConfigV4};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use esp_hal::peripherals::WIFI;
use esp_radio::wifi::ap::AccessPointInfo;
use esp_radio::wifi::scan::{ScanConfig, ScanTypeConfig};
use esp_radio::wifi::sta::{ScanMethod, StationConfig};
use esp_radio::wifi::{
    AuthenticationMethod, AuthenticationMethodConfig, Config as WifiConfig, ConnectionError,
    ControllerConfig, DisconnectReason, Interface, PowerSaveMode, Ssid, WifiController,
};

use flix_firmware::joining::{
    self, ADDRESS_PATIENCE, ATTEMPT, Connection, Credential, Joining, News, Next, SILENCE,
};
use flix_firmware::mdns;
use flix_firmware::neighbours::{Guard, Guarded, Rival};
use flix_firmware::net;
use flix_protocol::network_key::{KeyDigits, NETWORK_LENGTH, NetworkKey};
use flix_protocol::network_name::NetworkName;
use flix_protocol::provision::{
    HeardNetwork, HeardSecurity, JoinFailure, NetworkAddress, Provisioning,
};

use crate::chip;
use crate::log::{self, log};
use crate::serial;
use crate::shared::Shared;
use crate::watchdog::Window;

/// How often a robot that waits looks whether it may connect, or has to listen for access points.
const IDLE_INTERVAL: Duration = Duration::from_millis(100);
/// A driver that is asked to end a try has so long to say so.
const FAREWELL: Duration = Duration::from_secs(1);
/// Rounds of a derivation before others get a turn: some milliseconds.
const ROUNDS_AT_ONCE: u32 = 64;
/// How often the radio's power and the robot's address are read.
const LOOK_INTERVAL: Duration = Duration::from_millis(250);

/// Transmit power, in quarters of a decibel: 15 dBm. The driver's own 5 dBm are for a table; above 16 dBm it has been seen
/// to fail to authenticate (esp-radio 1.0.0-beta.1, `set_max_tx_power`).
const TRANSMIT_POWER: i8 = 60;

/// Frames that the driver keeps at most, each way. Each takes 1.6 KB of its heap; by default it is 32, 51 KB of 78 KiB, of which a
/// connected driver takes some 50 KiB besides. No fewer than the receiver's own buffers, which are as many here, and those
/// no fewer than the 6 frames that are acknowledged at once (esp-radio 1.0.0-beta.1, `ControllerConfig`).
const BUFFERS: u8 = 8;

/// Least and most time to listen on a channel (ESP-IDF, `wifi_scan_time_t`: 120 ms at most by default). The driver's own default of
/// 10 to 20 ms misses access points that answer late.
const CHANNEL_MILLISECONDS: [u64; 2] = [60, 120];

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

/// Starts the radio once more, or late.
#[expect(unsafe_code, reason = "the driver keeps the peripheral that it was given")]
fn start_again() -> Option<WifiController<'static>> {
    // SAFETY: the only other user of the peripheral is an earlier driver, which is never made or was dropped.
    start(unsafe { WIFI::steal() })
}

/// Returns the network's name and this password for the driver; `None` when they are longer than Wi-Fi allows.
fn station(network: &NetworkName, password: &str) -> Option<WifiConfig> {
    let authentication = match password {
        "" => AuthenticationMethodConfig::Open,
        // The least that is accepted. An access point that offers WPA3 alone is not supported (esp-radio 1.0.0-beta.1,
        // `wifi`); one that offers WPA2, too, is.
        password => AuthenticationMethodConfig::Wpa2Personal(password.try_into().ok()?),
    };
    let station = StationConfig::default()
        .with_ssid(network.as_bytes().try_into().ok()?)
        .with_authentication(authentication)
        // The strongest access point of the network, not the first.
        .with_scan_method(ScanMethod::AllChannels);
    Some(WifiConfig::Station(station))
}

/// Listens for access points if the serial cable asks for it. `controller`: none where the radio did not start.
async fn listen(controller: Option<&mut WifiController<'static>>, exchange: &Shared) {
    if !(exchange.scan_is_due() && joining::may_try(exchange.state())) {
        return;
    }
    let _window = Window::open();
    let [min, max] = CHANNEL_MILLISECONDS.map(esp_hal::time::Duration::from_millis);
    let config = ScanConfig::default()
        .with_show_hidden(true)
        .with_scan_type(ScanTypeConfig::Active { min, max });
    let found = match controller {
        None => None,
        Some(controller) => {
            let attempt = Duration::from_millis(ATTEMPT.as_millis() as u64);
            match with_timeout(attempt, controller.scan_async(&config)).await {
                Ok(Ok(found)) => Some(found),
                failed => {
                    log!("wi-fi: the radio does not listen: {:?}", failed.err());
                    None
                }
            }
        }
    };
    exchange.end_scan(found.as_ref().map(|found| found.iter().map(heard)));
}

/// Converts an access point of the driver to the entry that the serial cable carries.
fn heard(found: &AccessPointInfo) -> HeardNetwork {
    let security = match found.auth_method {
        // The driver states WPA3 alone so, too, as it does not have it (esp-radio 1.0.0-beta.1, `AuthenticationMethod::from_raw`).
        Some(AuthenticationMethod::None) | None => HeardSecurity::Open,
        Some(AuthenticationMethod::Wep) => HeardSecurity::Wep,
        Some(AuthenticationMethod::Wpa) => HeardSecurity::Wpa,
        Some(AuthenticationMethod::Wpa2Personal | AuthenticationMethod::WpaWpa2Personal) => {
            HeardSecurity::Wpa2
        }
        Some(AuthenticationMethod::Wpa2Wpa3Personal) => HeardSecurity::Wpa2Wpa3,
        Some(AuthenticationMethod::Wpa3Personal) => HeardSecurity::Wpa3,
        Some(
            AuthenticationMethod::WpaEnterprise
            | AuthenticationMethod::Wpa2Enterprise
            | AuthenticationMethod::Wpa2Wpa3Enterprise
            | AuthenticationMethod::Wpa3Enterprise
            | AuthenticationMethod::Wpa3EntSuiteB192Bit,
        ) => HeardSecurity::Enterprise,
        Some(_) => HeardSecurity::Other,
    };
    let (name, dbm) = (bytes_of(&found.ssid), found.signal_strength);
    HeardNetwork { name, channel: found.channel, dbm, security }
}

/// Returns the bytes of a network's name. The driver shows them as text alone, up to the first that is not UTF-8; but it hashes
/// all 32 of them (esp-radio 1.0.0-beta.1, `Ssid`).
fn bytes_of(ssid: &Ssid) -> NetworkName {
    #[derive(Default)]
    struct Bytes([u8; NETWORK_LENGTH]);
    impl Hasher for Bytes {
        fn write(&mut self, bytes: &[u8]) {
            if let Ok(bytes) = bytes.try_into() {
                self.0 = bytes;
            }
        }

        fn finish(&self) -> u64 {
            0
        }
    }
    let mut bytes = Bytes::default();
    ssid.hash(&mut bytes);
    NetworkName::new(&bytes.0[..ssid.len().min(NETWORK_LENGTH)]).unwrap_or_default()
}

/// Waits, and listens for access points meanwhile.
async fn wait_for(
    wait: core::time::Duration,
    mut controller: Option<&mut WifiController<'static>>,
    exchange: &Shared,
) {
    let end = Instant::now() + wait.try_into().unwrap_or(IDLE_INTERVAL);
    while Instant::now() < end {
        listen(controller.as_deref_mut(), exchange).await;
        Timer::at(end.min(Instant::now() + IDLE_INTERVAL)).await;
    }
}

/// Starts the radio of a robot without a network whenever it has to listen for access points.
#[embassy_executor::task]
pub(crate) async fn only_listen(exchange: &'static Shared) {
    loop {
        if exchange.scan_is_due() && joining::may_try(exchange.state()) {
            listen(start_again().as_mut(), exchange).await;
        }
        Timer::after(IDLE_INTERVAL).await;
    }
}

/// Derives the network's key, a slice at a time: others run meanwhile.
async fn derive(provisioning: &Provisioning) -> KeyDigits {
    let mut derivation =
        NetworkKey::new(provisioning.network().as_bytes(), provisioning.password());
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
    stack: Stack<'static>,
    guard: &'static Guard,
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
        listen(controller.as_mut(), exchange).await;
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
                    watch(controller, stack, guard, provisioning, exchange).await;
                    joining.lost(since.elapsed().into())
                }
                Err(Failure::Reason(reason)) => {
                    let failure = failure(reason);
                    log!("wi-fi: cannot connect: {reason:?} ({failure})");
                    joining.failed(failure)
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
        exchange.set_network(joining.state());
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
        wait_for(wait, controller.as_mut(), exchange).await;
    }
}

/// Starts a radio that did not start with the chip, and then restarts the chip: the robot's secret and operators are made once, from
/// the noise of a running radio.
#[embassy_executor::task]
pub(crate) async fn start_late(exchange: &'static Shared) {
    let mut joining = Joining::new("");
    loop {
        let next = joining.silent();
        exchange.set_network(joining.state());
        let (Next::Retry(wait) | Next::Renew(wait) | Next::Restart(wait)) = next;
        log!("wi-fi: next attempt to start the radio in {} ms", wait.as_millis());
        wait_for(wait, None, exchange).await;
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
    joining::may_restart(exchange.settled(), serial::silence())
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

/// Returns the cause of a failed try that the radio's reason stands for.
const fn failure(reason: DisconnectReason) -> JoinFailure {
    match reason {
        DisconnectReason::NoAccessPointFound
        | DisconnectReason::NoAccessPointFoundInRssiThreshold
        | DisconnectReason::BeaconTimeout => JoinFailure::Absent,
        DisconnectReason::NoAccessPointFoundWithCompatibleSecurity
        | DisconnectReason::NoAccessPointFoundInAuthmodeThreshold => JoinFailure::Security,
        DisconnectReason::FourWayHandshakeTimeout
        | DisconnectReason::HandshakeTimeout
        | DisconnectReason::MicFailure
        | DisconnectReason::AuthenticationFailed
        | DisconnectReason::AuthenticationExpired => JoinFailure::Password,
        DisconnectReason::AssociationTooMany => JoinFailure::Full,
        _ => JoinFailure::Refused,
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

/// Returns the robot's present address.
fn address(stack: Stack<'_>, provisioning: &Provisioning) -> Option<NetworkAddress> {
    let network = stack.config_v4()?.address;
    let (address, prefix_length) = (network.address().octets(), network.prefix_len());
    let is_fixed = provisioning.address().is_some();
    Some(NetworkAddress { address, prefix_length, is_fixed })
}

/// Reads the radio's power and the robot's address until the connection is gone. Ends a connection that brings no address.
async fn watch(
    controller: &mut WifiController<'static>,
    stack: Stack<'_>,
    guard: &Guard,
    provisioning: &Provisioning,
    exchange: &Shared,
) {
    let (mut reason, mut connection, since) = (None, Connection::default(), Instant::now());
    while controller.is_connected() {
        let dbm = controller.rssi().ok().and_then(|dbm| i8::try_from(dbm).ok());
        SIGNAL.lock(|signal| signal.set(dbm.or(signal.get())));
        let (held, address) = (since.elapsed().into(), address(stack, provisioning));
        let news = connection.look(held, address, guard.silence());
        exchange.set_network(connection.state());
        if let Some(Rival { address, hardware }) = guard.rival() {
            log!("wi-fi: another device, {hardware}, has the address {address}");
        }
        match news {
            Some(News::Address(address)) => {
                let host = mdns::host_name(provisioning.name());
                log!("wi-fi: address {address}, host name {host}");
            }
            Some(News::NoAddress) => log!(
                "wi-fi: no address for {} s: does this network have DHCP?",
                ADDRESS_PATIENCE.as_secs()
            ),
            Some(News::Leave) => log!("wi-fi: still no address: connects anew"),
            Some(News::Silent) => {
                log!("wi-fi: no frame for {} s: connects anew", SILENCE.as_secs())
            }
            None => {}
        }
        if matches!(news, Some(News::Leave | News::Silent)) {
            let _ = with_timeout(FAREWELL, controller.disconnect_async()).await;
        }
        listen(Some(&mut *controller), exchange).await;
        let gone = controller.wait_for_disconnect_async();
        if let Either::First(Ok(info)) = select(gone, Timer::after(LOOK_INTERVAL)).await {
            reason = Some(info.reason);
        }
    }
    SIGNAL.lock(Cell::take);
    match reason {
        Some(reason) => log!("wi-fi: lost: {reason:?}"),
        None => log!("wi-fi: lost"),
    }
}
