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
///
/// Two robots may have one name. The column `key` states which robot has the key of your keyring: `proved`; `not proved` by
/// another robot of this name, or by one that did not answer; `none`, where your keyring has no key of this name.
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
    let with_key = |robot: Found| {
        let key =
            keyring.as_ref().and_then(|keyring| keyring.key(&keyring.spelled(&robot.name)?).ok());
        (robot, key)
    };
    let robots: Vec<_> = robots.into_iter().map(with_key).collect();
    let proved = discovery::prove_all(&robots);
    let robots = robots
        .into_iter()
        .zip(proved)
        .map(|((found, _), proved)| Row { found, key: state_of_key(proved) });
    let robots: Vec<Row> = robots.collect();
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
        rows.extend(robots.iter().map(Row::line));
        print(&table(&rows))?;
    }
    Ok(if robots.is_empty() { Exit::NoAnswer } else { Exit::Done }.into())
}

/// A robot of the list.
#[derive(serde::Serialize)]
struct Row {
    #[serde(flatten)]
    found: Found,
    /// See [`state_of_key`].
    key: &'static str,
}

/// States whether a robot has proved to have the key of its name in the keyring; `None` where the keyring has no such key.
const fn state_of_key(proved: Option<bool>) -> &'static str {
    match proved {
        Some(true) => "proved",
        Some(false) => "not_proved",
        None => "none",
    }
}

impl Row {
    fn line(&self) -> Vec<String> {
        let Self { found, key } = self;
        let address =
            found.socket_address().map_or_else(|| "no address".to_owned(), |it| it.to_string());
        let board = found.properties.get("board").cloned().unwrap_or_default();
        vec![found.name.clone(), address, key.replace('_', " "), board]
    }
}
