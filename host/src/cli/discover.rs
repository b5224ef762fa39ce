//! `flix discover`: which robots are on the local network.

use std::process::ExitCode;
use std::time::Duration;

use super::output::{print, print_json};
use super::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::keys::Keyring;
use crate::link::discovery::{self, Found};

/// List the robots that announce themselves on the local network (mDNS, `_flix._udp`).
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix discover
  flix discover --for 10s --json | jq -r '.[].name'")]
pub struct Args {
    /// How long to listen.
    #[arg(long = "for", value_name = "TIME", default_value = "3s", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Listens and lists.
///
/// # Errors
/// When multicast does not work here (usage), or no robot was heard (no answer).
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let robots = discovery::browse(args.duration, &interrupt).map_err(Error::usage)?;
    if args.json {
        print_json(&robots)?;
    } else if robots.is_empty() {
        return Err(Error::new(
            Exit::NoAnswer,
            "no robot was heard: check that it is on and in this network, and that the network lets multicast through; an address works without it",
        ));
    } else {
        let keyring = Keyring::of_user()?;
        print(&robots.iter().map(|robot| line(robot, &keyring)).collect::<String>())?;
    }
    Ok(if robots.is_empty() { Exit::NoAnswer } else { Exit::Done }.into())
}

fn line(robot: &Found, keyring: &Keyring) -> String {
    let address =
        robot.socket_address().map_or_else(|| "no address".to_owned(), |it| it.to_string());
    let key = if keyring.contains(&robot.name) { "key known" } else { "no key" };
    let board = robot.properties.get("board").map_or("", String::as_str);
    format!("{:<24} {address:<22} {key:<10} {board}\n", robot.name)
}
