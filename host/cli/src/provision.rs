//! `flix provision`: gives a robot its name, network and key over its serial port.

use std::borrow::Cow;
use std::fs;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

use flix_protocol::HOST_PREFIX;
use flix_protocol::message::{OPERATOR_NAME_LENGTH, OperatorName};
use flix_protocol::network_name::NetworkName;
use flix_protocol::provision::{
    FixedAddress, HeardNetwork, NetworkState, ProvisionRefusal, Provisioning, ProvisioningError,
    Request,
};
use flix_protocol::session::{Key, Operator};
use zeroize::Zeroizing;

use super::address::offered;
use flix_host::link::keys::{self, Keyring};
use flix_host::link::serial::{SerialError, SerialRobot};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::printable;
use flix_shell::output::{complain, headings, print, print_json, table, waiting};
use flix_shell::{Error, Exit};

/// Environment variable with the network's password.
const PASSWORD_VARIABLE: &str = "FLIX_NETWORK_PASSWORD";

/// One of them is done at a time; the first takes [`SETTINGS`].
const TASKS: [&str; 7] =
    ["ssid", "wait", "networks", "operators", "add_operator", "revoke_operator", "forget"];
/// What may be said besides the network.
const SETTINGS: [&str; 8] =
    ["name", "operator", "password_file", "open", "address", "gateway", "new_key", "no_wait"];

/// Give a robot its name, network and key, over its serial port.
///
/// The key is made here, stored in your keyring for this robot only, and never shown. A robot keeps its
/// key when it proves to have it; a key of your keyring crosses no cable again. The network's
/// password comes from --password-file, from the variable FLIX_NETWORK_PASSWORD, or from a prompt
/// that does not show it. Then the robot starts anew, and its address on the network is awaited for 30 s, or
/// the reason why it has none. Name and key stay in robot and keyring either way.
///
/// A robot has up to eight operators, each with a name and a key of its own. It reports by name who
/// drives it, and any of them can stop it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix provision --port /dev/ttyUSB0 --networks            list what it hears
  flix provision --port /dev/ttyUSB0 --ssid lab
  flix provision --port /dev/ttyUSB0 --ssid lab --password-file lab.password
  flix provision --port /dev/ttyUSB0 --ssid lab --address 10.0.0.7/24
  flix provision --port /dev/ttyUSB0 --ssid lab --new-key  the old one is known
  flix provision --port /dev/ttyUSB0 --wait                ask for its address
  flix provision --port /dev/ttyUSB0 --operators           list who may drive
  flix provision --port /dev/ttyUSB0 --add-operator bob    make a key for bob
  flix provision --port /dev/ttyUSB0 --revoke-operator bob bob may drive no more
  flix provision --port /dev/ttyUSB0 --forget              before giving it away")]
#[command(group = clap::ArgGroup::new("task").required(true).args(TASKS))]
#[command(group = clap::ArgGroup::new("setting").multiple(true).args(SETTINGS).conflicts_with_all(&TASKS[1..]))]
pub struct Args {
    /// Serial port of the robot.
    #[arg(long, value_name = "PORT")]
    port: PathBuf,
    /// Network to join; `\xNN` is a byte of a name that is not UTF-8, `\\` a backslash.
    #[arg(long, value_name = "NETWORK")]
    ssid: Option<NetworkName>,
    /// Name of the robot [default: its present name; a new robot's is `walker-` and the last four digits of its MAC address].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Your name, under which the robot reports that you drive [default: your user name].
    #[arg(long, value_name = "NAME")]
    operator: Option<OperatorName>,
    /// File with the network's password on its first line, which others cannot read; `-` is standard input.
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
    /// Make a new key for a robot that has one; all its former keys are erased.
    #[arg(long)]
    new_key: bool,
    /// Do not wait until the robot has an address.
    #[arg(long)]
    no_wait: bool,
    /// Wait until the robot has an address on the network that it knows, and change nothing.
    #[arg(long)]
    wait: bool,
    /// List the access points that the robot hears, the strongest first; names are written as --ssid takes them.
    #[arg(long)]
    networks: bool,
    /// Print the list of --networks as JSON.
    #[arg(long, conflicts_with_all = TASKS.into_iter().filter(|task| *task != "networks"))]
    json: bool,
    /// List the operators, one name a line.
    #[arg(long)]
    operators: bool,
    /// Add an operator: make a key, hand it to the robot, and write it to a file for the operator.
    #[arg(long, value_name = "NAME")]
    add_operator: Option<OperatorName>,
    /// File for the key of --add-operator; it must not exist [default: ROBOT-NAME.key].
    #[arg(long, value_name = "FILE", requires = "add_operator")]
    key_file: Option<PathBuf>,
    /// Erase the key of an operator from the robot.
    #[arg(long, value_name = "NAME")]
    revoke_operator: Option<OperatorName>,
    /// Erase name, network and all keys from the robot.
    #[arg(long)]
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

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let robot = SerialRobot::open(&args.port, interrupt)?;
    let keyring = Keyring::of_user()?;
    let said = if let Some(network) = &args.ssid {
        provision(args, network, &robot, &keyring)?
    } else if let Some(name) = args.add_operator {
        add_operator(args, name, &robot, &keyring)?
    } else if let Some(name) = args.revoke_operator {
        revoke_operator(name, &robot, &keyring)?
    } else if args.wait {
        let (identity, has_key) = robot.identify()?;
        if !has_key {
            return Err(SerialError::Refused(ProvisionRefusal::Unprovisioned).into());
        }
        join(&identity.name, "its network", &args.port, &robot)?
    } else if args.networks {
        return networks(args.json, &robot);
    } else if args.operators {
        robot_in_hand(&robot, &keyring)?;
        robot.operators()?.iter().map(|name| format!("{name}\n")).collect()
    } else {
        forget(&robot, &keyring)?
    };
    print(&said)?;
    Ok(Exit::Done.into())
}

/// An access point of the list.
#[derive(serde::Serialize)]
struct Row {
    /// Name of its network as --ssid takes it; empty where it is hidden.
    name: String,
    channel: u8,
    dbm: i8,
    security: String,
}

/// Prints the access points that the robot hears.
fn networks(is_json: bool, robot: &SerialRobot) -> Result<ExitCode, Error> {
    let heard = waiting("the robot to listen", || robot.networks())?;
    let rows: Vec<Row> = heard
        .into_iter()
        .map(|HeardNetwork { name, channel, dbm, security }| {
            let (name, security) = (name.to_string(), security.to_string());
            Row { name, channel, dbm, security }
        })
        .collect();
    if is_json {
        print_json(&rows)?;
    } else if rows.is_empty() {
        return Err(Error::new(
            Exit::NotNow,
            "the robot hears no network at 2.4 GHz: check its antenna, and that the access point is on and not at 5 GHz alone",
        ));
    } else {
        let mut table_rows = vec![headings("dBm|channel|security|network")];
        table_rows.extend(rows.into_iter().map(|Row { name, channel, dbm, security }| {
            let name = if name.is_empty() { "(hidden)".to_owned() } else { name };
            vec![dbm.to_string(), channel.to_string(), security, name]
        }));
        print(&table(&table_rows))?;
    }
    Ok(Exit::Done.into())
}

/// Returns the name of a robot that has an owner, and proves it where the keyring has a key of that name.
fn robot_in_hand(robot: &SerialRobot, keyring: &Keyring) -> Result<String, Error> {
    let (identity, has_key) = robot.identify()?;
    let name = identity.name.as_str();
    if !has_key {
        return Err(SerialError::Refused(ProvisionRefusal::Unprovisioned).into());
    }
    keys::check_name(name)?;
    if keyring.contains(name) && proved(name, robot, keyring)?.is_none() {
        return Err(unproved(name));
    }
    Ok(name.to_owned())
}

/// Erases all from the robot. The key that it has had is of no use then, and its name is free.
fn forget(robot: &SerialRobot, keyring: &Keyring) -> Result<String, Error> {
    let (identity, has_key) = robot.identify()?;
    let name = identity.name.as_str();
    let is_ours = has_key && keyring.contains(name) && proved(name, robot, keyring)?.is_some();
    robot.order(&Request::Forget)?;
    let aside = match is_ours {
        true => format!("; its key is now in {}", keyring.set_aside(name)?.display()),
        false => String::new(),
    };
    Ok(format!("name, network and keys are erased from the robot{aside}\n"))
}

fn add_operator(
    args: &Args,
    name: OperatorName,
    robot: &SerialRobot,
    keyring: &Keyring,
) -> Result<String, Error> {
    let robot_name = robot_in_hand(robot, keyring)?;
    let default = || PathBuf::from(format!("{robot_name}-{name}.key"));
    let path = args.key_file.clone().unwrap_or_else(default);
    let key = keys::generate()?;
    // Stored before the robot has it: a key that is lost must be revoked again.
    keys::write_new(&path, &key)?;
    let added = robot.order(&Request::Add(Operator::new(name, &key)));
    if let Err(SerialError::Refused(_)) = added {
        // Nobody needs this key. One that stays is good for nothing.
        let _ = fs::remove_file(&path);
    }
    added?;
    let file = path.display();
    Ok(format!(
        "{robot_name} obeys {name}, too; the key is in {file}\nbring this file to {name} by a way that you trust, and delete it here; then: flix teleop {robot_name} --key {file}\n"
    ))
}

fn revoke_operator(
    name: OperatorName,
    robot: &SerialRobot,
    keyring: &Keyring,
) -> Result<String, Error> {
    let robot_name = robot_in_hand(robot, keyring)?;
    let known = robot.operators()?;
    if !known.contains(&name) {
        return Err(Error::usage(format_args!(
            "{robot_name} has no operator called {name}; it has: {}",
            list(&known)
        )));
    }
    robot.order(&Request::Revoke(name))?;
    Ok(format!("the key of {name} is erased from {robot_name}\n"))
}

fn list(names: &[OperatorName]) -> String {
    names.iter().map(OperatorName::as_str).collect::<Vec<_>>().join(", ")
}

/// Variables with the name of the user, of Unix and of Windows.
const USER_VARIABLES: [&str; 3] = ["USER", "LOGNAME", "USERNAME"];

/// Returns the name of the user, as far as it can be an operator's.
fn user_name() -> OperatorName {
    let label = |user: String| {
        let letter = |it: char| if it.is_ascii_alphanumeric() { it } else { '-' };
        let label: String = user.chars().map(letter).take(OPERATOR_NAME_LENGTH).collect();
        label.trim_matches('-').parse().ok()
    };
    let mut users = USER_VARIABLES.iter().filter_map(|name| std::env::var(name).ok());
    users.find_map(label).unwrap_or(OperatorName::OWNER)
}

fn provision(
    args: &Args,
    network: &NetworkName,
    robot: &SerialRobot,
    keyring: &Keyring,
) -> Result<String, Error> {
    // Check everything else before the password is typed.
    let check = |name: &str| Provisioning::new(name, network.as_bytes(), "", None);
    check(args.name.as_deref().unwrap_or("walker")).map_err(Error::usage)?;

    let (identity, has_key) = robot.identify()?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => identity.name.to_string(),
    };
    let former = if has_key { robot.operators()? } else { Vec::new() };
    // Before a key is made: one that no robot has would take the name.
    let password = password(args)?;
    if password.is_empty() && !args.open {
        return Err(Error::usage("the password is empty: give --open for a network without one"));
    }
    let address = args.address.map(|Network { address, prefix_length }| FixedAddress {
        address: address.octets(),
        prefix_length,
        gateway: args.gateway.map(|gateway| gateway.octets()),
    });
    let provisioning = Provisioning::new(&name, network.as_bytes(), &password, address)
        .map_err(|error| explain(error, &password))?;
    let key = KeyInHand::find_or_make(args, &name, robot, keyring)?;
    let operator = args.operator.unwrap_or_else(user_name);
    key.give(provisioning, operator, robot, keyring)?;
    let path = keyring.key_file(&name);
    match args.address {
        Some(Network { address, .. }) => keyring.store_address(&name, &address.to_string())?,
        None => keyring.erase_address(&name)?,
    }
    let erased = match former.as_slice() {
        [] => String::new(),
        _ if key.is_proved => String::new(),
        names => format!("its former keys are erased: {}\n", list(names)),
    };
    let path = path.display();
    if args.no_wait {
        return Ok(format!(
            "{name} has its key and joins the network `{network}`; the key is in {path}\n{erased}try: flix teleop {name}\n"
        ));
    }
    print(&format!("{name} has its key, which is in {path}\n{erased}"))?;
    join(&name, &format!("the network `{network}`"), &args.port, robot)
}

/// Waits until the robot has an address. Name, key and network stay in the robot if the wait fails.
fn join(name: &str, network: &str, port: &Path, robot: &SerialRobot) -> Result<String, Error> {
    let mut shown = String::new();
    let progress = |state| {
        let sentence = match state {
            NetworkState::Joining => format!("{name} joins {network}"),
            NetworkState::Failed { reason, .. } => format!("{reason}; {name} tries again"),
            NetworkState::NoAddress { .. } => {
                format!("{name} is connected and waits for an address")
            }
            NetworkState::Joined(_) => return,
        };
        if shown != sentence {
            complain(&sentence);
            shown = sentence;
        }
    };
    let again = format!("ask again: flix provision --port {} --wait", port.display());
    let joined = robot.joined(progress).map_err(|error| {
        let Error { exit, sentence } = error.into();
        Error::new(exit, format_args!("{sentence}\n{name} has what it was given; {again}"))
    })?;
    let address = joined.map_err(|error| {
        let tries = "what it was given stays, and it goes on trying";
        Error::new(
            Exit::NotNow,
            format_args!("{name} is not on {network}: {error}; {tries}; {again}"),
        )
    })?;
    let host = name.to_ascii_lowercase();
    Ok(format!(
        "{name} is on {network}: {address}, host name {HOST_PREFIX}{host}\ntry: flix teleop {name}\n"
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

fn unproved(name: &str) -> Error {
    Error::new(
        Exit::Refused,
        format_args!(
            "your keyring has a key for a robot called `{name}`, and this device does not have it: choose another --name for another robot, or --new-key if it is the same robot and its key was changed, forgotten or erased"
        ),
    )
}

fn unsettled_yet(name: &str, offered: &Path) -> Error {
    Error::new(
        Exit::Refused,
        format_args!(
            "`{name}` may have the key of an earlier --new-key, and this device has neither that one nor the former: connect \
             {name} itself; if it has forgotten both, move {} away, and try again",
            offered.display()
        ),
    )
}

/// Returns the stored key of this name that the robot proves to have: the one that was offered takes the place of the former
/// one then, or is erased.
fn proved(name: &str, robot: &SerialRobot, keyring: &Keyring) -> Result<Option<Key>, Error> {
    let offered = offered(keyring, name);
    if let Some(offered) = &offered
        && robot.proves(offered)?
    {
        keyring.settle(name, offered)?;
        return Ok(Some(offered.clone()));
    }
    let key = keyring.key(name)?;
    if !robot.proves(&key)? {
        return Ok(None);
    }
    keyring.withdraw(name, offered.as_ref())?;
    Ok(Some(key))
}

/// A key, whether the robot has it already, and whether it replaces one in the keyring.
struct KeyInHand {
    name: String,
    key: Key,
    is_proved: bool,
    replaces: bool,
}

impl KeyInHand {
    /// Returns the key of the robot, which stays when the network changes, or a new one. Two robots
    /// never share a key, and a stored key goes to no device.
    fn find_or_make(
        args: &Args,
        name: &str,
        robot: &SerialRobot,
        keyring: &Keyring,
    ) -> Result<Self, Error> {
        let made =
            |key, replaces| Ok(Self { name: name.to_owned(), key, is_proved: false, replaces });
        if !keyring.contains(name) {
            let key = keys::generate()?;
            // Stored before the robot has it: a robot whose key is lost must be provisioned again.
            keyring.store(name, &key)?;
            return made(key, false);
        }
        if args.new_key {
            // The robot may have the key of an earlier offer: none is lost before another has been proved.
            if keyring.offered_file(name).exists() && proved(name, robot, keyring)?.is_none() {
                return Err(unsettled_yet(name, &keyring.offered_file(name)));
            }
            return made(keys::generate()?, true);
        }
        match proved(name, robot, keyring)? {
            Some(key) => Ok(Self { is_proved: true, ..made(key, false)? }),
            None => Err(unproved(name)),
        }
    }

    /// Gives the robot its name, its network and this key; of one that it has, the identifier alone. While it is not known
    /// which of two keys the robot has, both are kept.
    fn give(
        &self,
        provisioning: Provisioning,
        operator: OperatorName,
        robot: &SerialRobot,
        keyring: &Keyring,
    ) -> Result<(), Error> {
        let Self { name, key, .. } = self;
        if self.is_proved {
            return Ok(robot.order(&Request::Keep(provisioning, operator, key.id()))?);
        }
        let request = Request::Provision(provisioning, Operator::new(operator, key));
        if !self.replaces {
            return Ok(robot.order(&request)?);
        }
        keyring.offer(name, key)?;
        let ordered = robot.order(&request);
        // A robot that could store the key and not erase the former one refuses, and has it.
        match (ordered, robot.proves(key)) {
            (ordered, Ok(true)) => {
                keyring.settle(name, key)?;
                Ok(ordered?)
            }
            (Err(error @ SerialError::Refused(_)), Ok(false)) => {
                keyring.withdraw(name, Some(key))?;
                Err(error.into())
            }
            (Ok(()), Ok(false)) => Err(unsettled(name, SerialError::Confused)),
            (Err(error), _) | (Ok(()), Err(error)) => Err(unsettled(name, error)),
        }
    }
}

fn unsettled(name: &str, error: SerialError) -> Error {
    let Error { exit, sentence } = error.into();
    Error::new(
        exit,
        format_args!(
            "{sentence}; whether {name} has its new key is not known: both keys are kept, and `flix` uses the one that it answers by"
        ),
    )
}

fn password(args: &Args) -> Result<Zeroizing<String>, Error> {
    let password = given_password(args)?;
    let is_hidden = matches!(printable(&password), Cow::Owned(_));
    let is_blank = password.trim().len() < password.len();
    if is_hidden || is_blank || password.contains(|it: char| it != ' ' && it.is_whitespace()) {
        complain(
            "the password begins or ends with a blank, or has a character that is not seen: it is taken as it is",
        );
    }
    Ok(password)
}

fn given_password(args: &Args) -> Result<Zeroizing<String>, Error> {
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
    let text = keys::read_secret(path, "--password-file")?;
    Ok(Zeroizing::new(text.lines().next().unwrap_or_default().to_owned()))
}
