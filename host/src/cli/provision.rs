//! `flix provision`: gives a robot its name, network and key over its serial port.

use std::fs;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

use flix_protocol::message::Identity;
use flix_protocol::provision::{FixedAddress, Provisioning, ProvisioningError, Request};
use flix_protocol::session::Key;
use zeroize::Zeroizing;

use super::output::print;
use super::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::keys::{self, Keyring};
use crate::link::serial::{SerialError, SerialRobot};

/// Environment variable with the network's password.
const PASSWORD_VARIABLE: &str = "FLIX_NETWORK_PASSWORD";

/// Give a robot its name, network and key, over its serial port.
///
/// The key is made here, stored in your keyring for this robot only, and never shown. A robot keeps its
/// key when it proves to have it; no other device is handed a key of your keyring. The network's
/// password comes from --password-file, from the variable FLIX_NETWORK_PASSWORD, or from a prompt
/// that does not show it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix provision --port /dev/ttyUSB0 --ssid lab
  flix provision --port /dev/ttyUSB0 --ssid lab --password-file lab.password
  flix provision --port /dev/ttyUSB0 --ssid lab --address 10.0.0.7/24
  flix provision --port /dev/ttyUSB0 --new-key   the old key may be known
  flix provision --port /dev/ttyUSB0 --forget    before giving the robot away")]
pub struct Args {
    /// Serial port of the robot.
    #[arg(long, value_name = "PORT")]
    port: PathBuf,
    /// Network to join.
    #[arg(long, value_name = "NETWORK", required_unless_present = "forget")]
    ssid: Option<String>,
    /// Name of the robot [default: its present name, or the next free `walker-N`].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// File with the network's password on its first line.
    #[arg(long, value_name = "FILE", conflicts_with = "open")]
    password_file: Option<PathBuf>,
    /// Join a network without a password.
    #[arg(long)]
    open: bool,
    /// Fixed address, for a network without DHCP.
    #[arg(long, value_name = "IPV4/PREFIX")]
    address: Option<Network>,
    /// Gateway of that network.
    #[arg(long, value_name = "IPV4", requires = "address")]
    gateway: Option<Ipv4Addr>,
    /// Make a new key for a robot that has one; the old key becomes invalid.
    #[arg(long)]
    new_key: bool,
    /// Erase name, network and key from the robot.
    #[arg(long, conflicts_with_all = ["ssid", "name", "address", "new_key", "open"])]
    forget: bool,
}

/// An address with the length of its network part, such as `10.0.0.7/24`.
#[derive(Debug, Clone, Copy)]
struct Network {
    address: Ipv4Addr,
    prefix_length: u8,
}

impl FromStr for Network {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(address, prefix_length)| {
            let prefix_length = prefix_length.parse().ok().filter(|length| *length <= 32)?;
            Some(Self { address: address.parse().ok()?, prefix_length })
        });
        parts.ok_or_else(|| {
            "write an IPv4 address and the length of its network part, for example 10.0.0.7/24"
                .to_owned()
        })
    }
}

/// Runs the command.
///
/// # Errors
/// When a value cannot be used, the port cannot be opened, or the robot does not answer or refuses.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let robot = SerialRobot::open(&args.port, interrupt)?;
    match &args.ssid {
        Some(network) => {
            let said = provision(args, network, &robot, &Keyring::of_user()?)?;
            print(&said)?;
        }
        None => {
            robot.order(&Request::Forget)?;
            print("name, network and key are erased from the robot\n")?;
        }
    }
    Ok(Exit::Done.into())
}

fn provision(
    args: &Args,
    network: &str,
    robot: &SerialRobot,
    keyring: &Keyring,
) -> Result<String, Error> {
    // Check everything else before the password is typed.
    let placeholder = Key::new([1; 32]);
    let check = |name: &str| Provisioning::new(name, network, "", None, &placeholder);
    check(args.name.as_deref().unwrap_or("walker")).map_err(Error::usage)?;

    let (identity, has_key) = robot.identify()?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => known_or_next_name(&identity, has_key, keyring),
    };
    let key = KeyInHand::find_or_make(args, &name, robot, keyring)?;
    let password = password(args)?;
    if password.is_empty() && !args.open {
        return Err(Error::usage("the password is empty: give --open for a network without one"));
    }
    let address = args.address.map(|Network { address, prefix_length }| FixedAddress {
        address: address.octets(),
        prefix_length,
        gateway: args.gateway.map(|gateway| gateway.octets()),
    });
    let provisioning = Provisioning::new(&name, network, &password, address, &key.key)
        .map_err(|error| explain(error, &password))?;
    robot.order(&Request::Provision(provisioning))?;
    let path = key.keep(keyring)?;
    if let Some(Network { address, .. }) = args.address {
        keyring.store_address(&name, &address.to_string())?;
    }
    Ok(format!(
        "{name} has its key and joins the network `{network}`; the key is in {}\ntry: flix teleop {name}\n",
        path.display()
    ))
}

fn explain(error: ProvisioningError, password: &str) -> Error {
    match error {
        // The message shows the length, not the password.
        ProvisioningError::Password => {
            Error::usage(format_args!("{error}; this one has {}", password.len()))
        }
        error => Error::usage(error),
    }
}

/// Returns the name on which robot and keyring agree, else the first free one.
fn known_or_next_name(identity: &Identity, has_key: bool, keyring: &Keyring) -> String {
    if has_key && keyring.contains(&identity.name) {
        return identity.name.to_string();
    }
    (1u32..)
        .map(|number| format!("walker-{number}"))
        .find(|name| !keyring.contains(name))
        .unwrap_or_else(|| "walker".to_owned())
}

/// A key, and whether it replaces one in the keyring.
struct KeyInHand {
    name: String,
    key: Key,
    replaces: bool,
}

impl KeyInHand {
    /// Returns the key of the robot, which stays when the network changes, or a new one. Two robots
    /// never share a key, and a stored key goes to a device that proves to have it already alone.
    fn find_or_make(
        args: &Args,
        name: &str,
        robot: &SerialRobot,
        keyring: &Keyring,
    ) -> Result<Self, Error> {
        let owned = |key, replaces| Ok(Self { name: name.to_owned(), key, replaces });
        if !keyring.contains(name) {
            let key = keys::generate()?;
            // Stored before the robot has it: a robot whose key is lost must be provisioned again.
            keyring.store(name, &key)?;
            return owned(key, false);
        }
        if args.new_key {
            return owned(keys::generate()?, true);
        }
        let key = keyring.key(name)?;
        if robot.proves(&key)? {
            return owned(key, false);
        }
        Err(Error::new(
            Exit::Refused,
            format_args!(
                "your keyring has a key for a robot called `{name}`, and this device does not have it: choose another --name for another robot, or --new-key if it is the same robot and its key was changed or forgotten"
            ),
        ))
    }

    /// Stores the key after the robot has accepted it.
    fn keep(&self, keyring: &Keyring) -> Result<PathBuf, Error> {
        if self.replaces {
            keyring.replace(&self.name, &self.key)?;
        }
        Ok(keyring.key_file(&self.name))
    }
}

fn password(args: &Args) -> Result<Zeroizing<String>, Error> {
    if args.open {
        return Ok(Zeroizing::default());
    }
    if let Some(path) = &args.password_file {
        return read_password(path);
    }
    if let Ok(password) = std::env::var(PASSWORD_VARIABLE) {
        return Ok(Zeroizing::new(password));
    }
    let prompt = "password of the network (not shown): ";
    rpassword::prompt_password(prompt).map(Zeroizing::new).map_err(|error| {
        Error::usage(format_args!(
            "there is no terminal to ask for the network's password ({error}): give --password-file FILE, {PASSWORD_VARIABLE}, or --open"
        ))
    })
}

fn read_password(path: &Path) -> Result<Zeroizing<String>, Error> {
    let text = fs::read_to_string(path)
        .map(Zeroizing::new)
        .map_err(|error| Error::usage(format_args!("{}: {error}", path.display())))?;
    Ok(Zeroizing::new(text.lines().next().unwrap_or_default().to_owned()))
}

impl From<SerialError> for Error {
    fn from(error: SerialError) -> Self {
        let exit = match error {
            SerialError::Open { .. } => Exit::Usage,
            SerialError::Port(_) | SerialError::Random(_) | SerialError::NoAnswer => Exit::NoAnswer,
            SerialError::Confused => Exit::Refused,
            SerialError::Refused(_) => Exit::RobotFault,
            SerialError::Interrupted => Exit::Interrupted,
        };
        Self::new(exit, error)
    }
}
