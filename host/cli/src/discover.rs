//! `flix discover`: lists the robots on the local network.

use std::process::ExitCode;
use std::time::Duration;

use flix_host::link::LinkError;
use flix_host::link::discovery::{self, Found};
use flix_host::link::keys::{Keyring, SIMULATED_ROBOT};
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::{headings, print, print_json, table, waiting};
use flix_shell::time::positive_duration;
use flix_shell::{Error, Exit};

/// List the robots that announce themselves on the local network (mDNS, `_flix._udp`), and the simulated robot of this
/// computer.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix discover
  flix discover --for 10s --json | jq -r '.[].name'")]
pub struct Args {
    /// Duration of listening.
    #[arg(long = "for", value_name = "TIME", default_value = "3s", value_parser = positive_duration)]
    duration: Duration,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    // Without a home directory no key is known.
    let keyring = Keyring::of_user().ok();
    let simulated = keyring
        .as_ref()
        .and_then(|keyring| keyring.key(SIMULATED_ROBOT).ok())
        .and_then(|key| discovery::on_this_computer(SIMULATED_ROBOT, &key));
    let announced =
        waiting("robots to announce themselves", || discovery::browse(args.duration, &interrupt));
    let robots: Vec<Found> = match (announced, simulated) {
        (Err(error), None) => return Err(Error::usage(error)),
        (announced, simulated) => {
            simulated.into_iter().chain(announced.unwrap_or_default()).collect()
        }
    };
    if interrupt.is_raised() {
        return Err(LinkError::Interrupted.into());
    }
    if args.json {
        print_json(&robots)?;
    } else if robots.is_empty() {
        return Err(Error::new(
            Exit::NoAnswer,
            "no robot was found: check that it is on and in this network, and that the network forwards multicast; guest networks and \
             hotspots of phones often isolate devices from each other. Where they do not, an address works without multicast. On \
             macOS, allow your terminal in System Settings, Privacy & Security, Local Network",
        ));
    } else {
        let mut rows = vec![headings("robot|address|key|board")];
        rows.extend(robots.iter().map(|robot| row(robot, keyring.as_ref())));
        print(&table(&rows))?;
    }
    Ok(if robots.is_empty() { Exit::NoAnswer } else { Exit::Done }.into())
}

fn row(robot: &Found, keyring: Option<&Keyring>) -> Vec<String> {
    let address =
        robot.socket_address().map_or_else(|| "no address".to_owned(), |it| it.to_string());
    let key = if keyring.is_some_and(|it| it.contains(&robot.name)) { "known" } else { "none" };
    let board = robot.properties.get("board").cloned().unwrap_or_default();
    vec![robot.name.clone(), address, key.to_owned(), board]
}
