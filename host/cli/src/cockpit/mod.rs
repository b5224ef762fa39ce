//! `flix cockpit`: drives in the browser.

pub mod drive_loop;
pub mod guard;
mod listener;
pub mod server;

use std::net::SocketAddr;
use std::process::ExitCode;

use super::by_hand::ByHandArgs;
use crate::cockpit::server::{ServeError, Server};
use flix_shell::Error;
use flix_shell::output::{complain, print};
use flix_shell::stream::address;
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;

/// Port of the page: the one after the robot's.
const PORT: u16 = flix_protocol::DEFAULT_PORT + 1;

/// Drive in the browser, by keyboard, touch or gamepad, and see the robot move.
///
/// Prints the address of the page; open it in any browser. One page drives, others watch, and every page can stop.
/// A page that is hidden, frozen or closed lets the robot rest, and disarms it after a second. The page changes
/// settings and shows the scope, too; it needs no internet. Ctrl-C ends; it stops a robot that is driven.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix cockpit                        the simulated robot, on this computer
  flix cockpit walker-3f2c --record
  flix cockpit walker-3f2c --pose natnet
  flix cockpit --bind 0.0.0.0         also for the phones in this network

The keys are those of `flix teleop`. Gamepad: stick or arrows walk and turn,
shoulder buttons strafe, the right button stops (B on Xbox, A on Nintendo,
circle) and the lower one, too, while it walks; Start arms, Back disarms, the
upper button clears.")]
pub struct Args {
    #[command(flatten)]
    by_hand: ByHandArgs,
    /// Address of this computer where the page is served, with or without a port; 0.0.0.0 is every one, port 0 any
    /// free one.
    #[arg(long, value_name = "ADDRESS[:PORT]", default_value = "127.0.0.1", value_parser = |text: &str| address(text, PORT))]
    bind: SocketAddr,
    /// Name by which browsers reach the page through a proxy or a forwarded port; addresses and localhost need none.
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
}

/// Serves the page until the program is interrupted.
///
/// # Errors
/// When the robot cannot be reached, the page cannot be served, or the program is interrupted while it drives.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    args.by_hand.drive("cockpit", |drive, interrupt| {
        let server = Server::start(args.bind, &args.host, args.by_hand.hold_to_run)?;
        if server.is_public() {
            complain(
                "the page is not encrypted: whoever can read this network can take its address, and drive; \
                 use a network of your own",
            );
        }
        let urls = server.urls();
        print(&format!("open {}\n", urls.join("\n  or ")))?;
        if let Some(picture) = urls.first().filter(|_| server.is_public()).and_then(|it| qr(it)) {
            print(&format!("{picture}\n"))?;
        }
        Ok(drive_loop::run(drive, &server, interrupt)?)
    })
}

/// Returns an address for the camera of a phone, for terminals with a dark ground; `None` where it is too long.
fn qr(url: &str) -> Option<String> {
    let code = QrCode::new(url).ok()?;
    let mut picture = code.render::<Dense1x2>();
    Some(picture.dark_color(Dense1x2::Light).light_color(Dense1x2::Dark).build())
}

impl From<ServeError> for Error {
    fn from(error: ServeError) -> Self {
        Self::usage(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of a picture: what is dark to a camera that sees light blocks on a dark ground.
    fn dark(picture: &str) -> Vec<Vec<bool>> {
        let halves = |half: usize| {
            move |line: &str| {
                let is_dark = |it: char| match it {
                    '\u{2588}' => false,
                    '\u{2580}' => half == 1,
                    '\u{2584}' => half == 0,
                    _ => true,
                };
                line.chars().map(is_dark).collect::<Vec<_>>()
            }
        };
        picture.lines().flat_map(|line| [halves(0)(line), halves(1)(line)]).collect()
    }

    #[test]
    fn the_address_of_the_page_has_a_code_with_three_corners_and_a_light_rim() {
        let picture = qr("http://192.168.1.7:4211/0123456789abcdef0123456789abcdef/").unwrap();
        let rows = dark(&picture);
        let width = rows[0].len();
        assert!(width >= 33 && rows.iter().all(|row| row.len() == width), "{picture}");
        // Four light modules all around, then the corners: seven dark ones, a light one.
        assert!(rows[..4].iter().flatten().all(|dark| !dark), "{picture}");
        for (row, column) in [(4, 4), (4, width - 11), (width - 11, 4)] {
            assert!(rows[row][column..column + 7].iter().all(|dark| *dark), "{picture}");
        }
    }
}
