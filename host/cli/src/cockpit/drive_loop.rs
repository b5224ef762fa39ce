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
/// When the network, the source of poses or the server of the pages fails.
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
        while let Some((page, event)) = server.event()? {
            let is_misused = match event {
                FromPage::Said(said) => {
                    let received = pages.receive(page, said, cockpit, client, now);
                    received.inspect_err(|_| server.close(page)).is_err()
                }
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

#[cfg(test)]
mod tests {
    use flix_host::link::udp::Connection;
    use flix_protocol::session::Key;

    use super::*;
    use crate::by_hand::drive::Extras;

    #[test]
    fn pages_that_cannot_be_served_any_more_end_the_drive() {
        let nobody = (std::net::Ipv4Addr::LOCALHOST, flix_protocol::DEFAULT_PORT).into();
        let mut connection =
            Connection::open(nobody, Key::new([7; 32]), Interrupt::never()).unwrap();
        let mut extras = Extras::default();
        let mut drive = Drive::new(&mut connection, "walker", &mut extras);
        let ended = run(&mut drive, &Server::that_fails(), &Interrupt::never());
        let error = flix_shell::Error::from(ended.unwrap_err());
        assert_eq!(error.exit, flix_shell::Exit::PageLost, "{error}");
    }
}
