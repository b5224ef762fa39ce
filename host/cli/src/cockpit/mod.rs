//! `flix cockpit`: drives in the browser.

pub mod desk;
pub mod guard;
pub mod server;

use std::net::SocketAddr;
use std::process::ExitCode;

use super::Error;
use super::by_hand::ByHandArgs;
use crate::cockpit::server::{ServeError, Server};
use flix_shell::output::{complain, print};
use flix_shell::stream::address;

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
  flix cockpit walker-1 --record
  flix cockpit walker-1 --pose natnet
  flix cockpit --bind 0.0.0.0         also for the phones in this network

The keys are those of `flix teleop`. Gamepad: stick or arrows walk and turn,
shoulder buttons strafe, B stops, Start arms, Back disarms, Y clears.")]
pub struct Args {
    #[command(flatten)]
    by_hand: ByHandArgs,
    /// Address of this computer where the page is served, with or without a port; 0.0.0.0 is every one, port 0 any
    /// free one.
    #[arg(long, value_name = "ADDRESS[:PORT]", default_value = "127.0.0.1", value_parser = |text: &str| address(text, PORT))]
    bind: SocketAddr,
}

/// Serves the page until the program is interrupted.
///
/// # Errors
/// When the robot cannot be reached, the page cannot be served, or the program is interrupted while it drives.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    args.by_hand.drive("cockpit", |drive, interrupt| {
        let server = Server::start(args.bind)?;
        if server.is_public() {
            complain(
                "the page is not encrypted: whoever can read this network can take its address, and drive; \
                 use a network of your own",
            );
        }
        print(&format!("open {}\n", server.urls().join("\n  or ")))?;
        Ok(desk::run(drive, &server, interrupt)?)
    })
}

impl From<ServeError> for Error {
    fn from(error: ServeError) -> Self {
        Self::usage(error)
    }
}
