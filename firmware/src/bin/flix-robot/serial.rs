//! The serial port, where the robot is provisioned. The log goes out over the same port.

use core::cell::Cell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant as Moment, Timer};
use esp_hal::Async;
use esp_hal::peripherals::UART0;
use esp_hal::uart::{Config, Uart, UartRx, UartTx};
use flix_firmware::board::store::Entry;
use flix_firmware::provision::Provisioner;
use flix_protocol::provision::BAUD_RATE;

use crate::flash::Flash;
use crate::log::{self, log};
use crate::pins::Serial;
use crate::shared::Shared;

/// Bytes taken at once.
const CHUNK: usize = 64;
/// When the last byte came in.
static LAST_BYTE: Mutex<CriticalSectionRawMutex, Cell<Option<Moment>>> =
    Mutex::new(Cell::new(None));

/// Returns how long ago the last byte came in; none before the first.
pub(crate) fn silence() -> Option<core::time::Duration> {
    let last = LAST_BYTE.lock(Cell::get)?;
    Some(core::time::Duration::from_micros(last.elapsed().as_micros()))
}

/// Rest between the answer and the restart, for the last bytes to leave.
const REST: Duration = Duration::from_millis(200);

/// What the port is made of.
pub(crate) type Parts = (UART0<'static>, Serial);

/// Opens both directions of the port; `None` when it cannot be had at its speed.
pub(crate) fn port(
    (unit, pins): Parts,
) -> Option<(UartRx<'static, Async>, UartTx<'static, Async>)> {
    let config = Config::default().with_baudrate(BAUD_RATE);
    let port = Uart::new(unit, config).ok()?;
    Some(port.with_rx(pins.receive).with_tx(pins.transmit).into_async().split())
}

/// Answers requests for ever. A robot that was provisioned anew restarts;
/// it takes such requests only while its motors are not driven.
#[embassy_executor::task]
pub(crate) async fn serve(
    mut port: UartRx<'static, Async>,
    mut provisioner: Provisioner<Entry<'static, Flash>>,
    exchange: &'static Shared,
) {
    let mut chunk = [0; CHUNK];
    loop {
        // An error is lost bytes; the frame that they were part of is refused by its check sum.
        let Ok(length) = port.read_async(&mut chunk).await else { continue };
        LAST_BYTE.lock(|last| last.set(Some(Moment::now())));
        for byte in &chunk[..length] {
            let response = provisioner.receive(*byte, exchange.settled(), exchange);
            let Some(response) = response else { continue };
            log::put(&response.frame);
            if response.changed {
                log!("\r\nprovisioning: changed, starting anew");
                log::drained().await;
                Timer::after(REST).await;
                esp_hal::system::software_reset();
            }
        }
    }
}
