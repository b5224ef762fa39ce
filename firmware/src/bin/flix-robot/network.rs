//! Wi-Fi: connects, connects again when it is lost, and never blocks anything else meanwhile.

use core::cell::Cell;

use embassy_net::{Config, Ipv4Cidr, Runner, StaticConfigV4};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Timer};
use esp_radio::wifi::sta::StationConfig;
use esp_radio::wifi::{
    AuthenticationMethodConfig, Config as WifiConfig, Interface, PowerSaveMode, WifiController,
};

use flix_firmware::neighbours::Guarded;
use flix_protocol::provision::Provisioning;

use crate::chip;
use crate::log::log;

/// Wait after the first failed attempt; doubled after each further one.
const SHORTEST_WAIT: Duration = Duration::from_millis(500);
/// Never longer than this: a robot that comes back into range connects soon.
const LONGEST_WAIT: Duration = Duration::from_secs(8);
/// A connection that held so long was a good one: start again with the shortest wait.
const GOOD_CONNECTION: Duration = Duration::from_secs(30);
/// How often the radio's power is read.
const SIGNAL_INTERVAL: Duration = Duration::from_secs(1);

/// Transmit power, in quarters of a decibel: 15 dBm. The driver's own 5 dBm are for a table; above 16 dBm it has been seen
/// to fail to authenticate (esp-radio 1.0.0-beta.1, `set_max_tx_power`).
const TRANSMIT_POWER: i8 = 60;

/// Radio power as last received, dBm.
pub(crate) static SIGNAL: Mutex<CriticalSectionRawMutex, Cell<Option<i8>>> =
    Mutex::new(Cell::new(None));

/// Returns the network's name and password for the driver; `None` when they are longer than Wi-Fi allows.
fn station(provisioning: &Provisioning) -> Option<WifiConfig> {
    let authentication = match provisioning.password() {
        "" => AuthenticationMethodConfig::Open,
        // The least that is accepted. The driver takes WPA3 (SAE) and protected management frames where
        // the access point offers them.
        password => AuthenticationMethodConfig::Wpa2Personal(password.try_into().ok()?),
    };
    let station = StationConfig::default()
        .with_ssid(provisioning.network().try_into().ok()?)
        .with_authentication(authentication);
    Some(WifiConfig::Station(station))
}

/// Chooses DHCP, or the fixed address of provisioning, whose prefix was checked when it was stored.
pub(crate) fn addresses(provisioning: &Provisioning) -> Config {
    match provisioning.address() {
        None => Config::dhcpv4(embassy_net::DhcpConfig::default()),
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
    mut controller: WifiController<'static>,
    provisioning: &'static Provisioning,
) {
    let Some(station) = station(provisioning) else {
        log!("wi-fi: the network's name or password is too long: provision the robot again");
        return;
    };
    // Modem sleep was seen to add up to half a second to a datagram.
    if controller.set_power_saving(PowerSaveMode::None).is_err() {
        log!("wi-fi: power saving cannot be switched off: expect late commands");
    }
    let mut wait = SHORTEST_WAIT;
    loop {
        let connected = match controller.set_config(&station) {
            Ok(()) => {
                if controller.set_max_tx_power(TRANSMIT_POWER).is_err() {
                    log!("wi-fi: transmits at 5 dBm: expect a short range");
                }
                controller.connect_async().await.is_ok()
            }
            Err(_) => false,
        };
        if connected {
            log!("wi-fi: connected to {}", provisioning.network());
            let heap = esp_alloc::HEAP.stats();
            log!("heap: {} of {} bytes used at most", heap.max_usage, heap.size);
            if let Some([unused, bytes]) = chip::unused_stack() {
                log!("stack of core 1: {unused} of {bytes} bytes never used");
            }
            let since = Instant::now();
            watch(&mut controller).await;
            log!("wi-fi: lost");
            if since.elapsed() > GOOD_CONNECTION {
                wait = SHORTEST_WAIT;
            }
        } else {
            log!("wi-fi: cannot connect, next attempt in {} ms", wait.as_millis());
        }
        Timer::after(wait).await;
        wait = (wait * 2).min(LONGEST_WAIT);
    }
}

/// Reads the radio's power until the connection is gone.
async fn watch(controller: &mut WifiController<'static>) {
    while controller.is_connected() {
        let dbm = controller.rssi().ok().and_then(|dbm| i8::try_from(dbm).ok());
        SIGNAL.lock(|signal| signal.set(dbm.or(signal.get())));
        Timer::after(SIGNAL_INTERVAL).await;
    }
    SIGNAL.lock(Cell::take);
}
