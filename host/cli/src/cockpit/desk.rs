//! The loop between the pages and the drive.

use std::time::{Duration, Instant};

use super::server::{FromPage, Server};
use crate::by_hand::drive::{Drive, DriveError, Ending};
use flix_host::system::interrupt::Interrupt;
use flix_host::teleop::page::pages::Pages;
use flix_host::teleop::page::snapshot::{News, snapshot};

/// Longest wait for a datagram between two looks at the pages.
const SLICE: Duration = Duration::from_millis(2);
/// Interval of the snapshots: 30 per second are smooth.
const FRAME: Duration = Duration::from_millis(33);

/// Lets the pages drive until the program is interrupted.
///
/// # Errors
/// When the network or the source of poses fails.
pub fn run(
    drive: &mut Drive,
    server: &Server,
    interrupt: &Interrupt,
) -> Result<Ending, DriveError> {
    let mut pages = Pages::default();
    let mut shown = None::<Instant>;
    let mut news = News::default();
    while !interrupt.is_raised() {
        drive.step(SLICE)?;
        let (cockpit, client, now) = drive.operate();
        while let Some((page, event)) = server.event() {
            let is_misused = match event {
                FromPage::Said(said) => pages.receive(page, said, cockpit, client, now).is_err(),
                FromPage::Misused => true,
                FromPage::Opened => {
                    pages.open(page, now);
                    false
                }
                FromPage::Closed => {
                    pages.close(page, cockpit, client, now);
                    false
                }
            };
            if is_misused {
                pages.expel(page, cockpit, client, now);
            }
        }
        pages.watch(cockpit, client, now);
        if shown.is_none_or(|at| at.elapsed() >= FRAME) {
            shown = Some(Instant::now());
            cockpit.tick(client, now);
            server.show(snapshot(cockpit, &pages, now).to_string());
            for (extra, value) in news.of(cockpit) {
                server.show_extra(extra, value);
            }
        }
    }
    // With a robot that is not driven, Ctrl-C is the way to leave.
    Ok(if drive.operate().1.is_driving() { Ending::Interrupted } else { Ending::Quit })
}
