//! Options that name a robot, and the search for its address and key.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::{OnceLock, mpsc};
use std::time::Duration;

use clap::builder::{OsStringValueParser, TypedValueParser};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::session::Key;

use flix_host::link::keys::{self, KEY_FILE_VARIABLE, KeyError, Keyring, SIMULATED_ROBOT};
use flix_host::link::udp::{self, Connection};
use flix_host::link::{LinkError, RobotLink, discovery};
use flix_host::system::file;
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::{complain, waiting};
use flix_shell::{Error, Exit};

/// Options that name a robot and its key.
#[derive(Debug, Clone, clap::Args)]
pub struct RobotArgs {
    /// Address (HOST or HOST:PORT), or the name of a provisioned robot. `simulated` is the simulator on
    /// this computer.
    #[arg(value_name = "ROBOT", env = ROBOT_VARIABLE, default_value = SIMULATED_ROBOT)]
    pub robot: String,
    /// Key file; `-` is standard input [default: the robot's key in your keyring].
    #[arg(long, value_name = "FILE", env = KEY_FILE_VARIABLE, value_parser = key_file())]
    pub key: Option<PathBuf>,
}

/// Takes the name of a key file.
pub fn key_file() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().try_map(|file| match file.is_empty() {
        true => Err(format!("name a file; is {KEY_FILE_VARIABLE} set, and empty?")),
        false => Ok(PathBuf::from(file)),
    })
}

/// Environment variable that names the robot.
const ROBOT_VARIABLE: &str = "FLIX_ROBOT";

/// Longest wait for an answer by a key of which it is not known whether the robot has it.
const ANSWER_PATIENCE: Duration = Duration::from_millis(500);

/// What follows when a robot is reached by the key that was to be replaced.
const FORMER: &str =
    ": it may be whoever knows the former one; `flix provision` at its cable settles which it has";

/// The keys that a robot may have.
struct Known {
    /// The name of the robot in the keyring.
    name: Option<String>,
    key: Key,
    /// The key that was offered to it, while it is not known whether it has it.
    offered: Option<Key>,
}

impl Known {
    fn keys(&self) -> impl Iterator<Item = &Key> {
        self.offered.iter().chain([&self.key])
    }
}

impl RobotArgs {
    /// Names a robot; without a name it is that of the environment, or the simulated one.
    pub fn new(robot: Option<String>, key: Option<PathBuf>) -> Self {
        let robot = robot.or_else(|| std::env::var(ROBOT_VARIABLE).ok());
        Self { robot: robot.unwrap_or_else(|| SIMULATED_ROBOT.to_owned()), key }
    }

    /// Finds the robot and its key, and connects.
    pub fn connect(&self, interrupt: &Interrupt) -> Result<Connection, Error> {
        let mut connection = self.begin(interrupt)?;
        waiting(format_args!("{} to answer", self.robot), || connection.wait_until_connected())?;
        Ok(connection)
    }

    /// Finds the robot and its key, and begins to connect.
    pub fn begin(&self, interrupt: &Interrupt) -> Result<Connection, Error> {
        let (address, key) = self.find(interrupt)?;
        Ok(Connection::open(address, key, interrupt.clone())?)
    }

    /// Finds the robot and its key.
    pub fn find(&self, interrupt: &Interrupt) -> Result<(SocketAddr, Key), Error> {
        let keyring = self.keyring()?;
        let (address, known) = self.spelled(&keyring)?.locate(&keyring, interrupt)?;
        let (Some(keyring), Known { name: Some(name), offered: Some(offered), key }) =
            (keyring, &known)
        else {
            return Ok((address, known.key));
        };
        if discovery::proves(address, offered, ANSWER_PATIENCE) {
            settle(&keyring, name, offered);
            return Ok((address, offered.clone()));
        }
        complain(format_args!("{name} has not answered by its new key{FORMER}"));
        Ok((address, key.clone()))
    }

    /// Returns the keyring. Without a home directory there is none, and a key that is named needs none.
    fn keyring(&self) -> Result<Option<Keyring>, KeyError> {
        match (Keyring::of_user(), &self.key) {
            (Err(KeyError::NoHome), Some(_)) => Ok(None),
            (keyring, _) => keyring.map(Some),
        }
    }

    /// Finds the robot and stops it, by both of its keys at once where it is not known which it has.
    pub fn stop(&self, interrupt: &Interrupt) -> Result<(), Error> {
        let keyring = self.keyring()?;
        let spelled = self.spelled(&keyring)?;
        let known = spelled.find_key(&keyring, interrupt)?;
        let keys: Vec<_> = known.keys().collect();
        let (proved, others) = mpsc::channel();
        let address = match spelled.own_address(&keyring)? {
            Some(address) => address,
            None => spelled.search(&keyring, interrupt, |name| {
                let (name, interrupt) = (name.to_owned(), interrupt.clone());
                let keys: Vec<Key> = known.keys().cloned().collect();
                // It searches on while the first that it has found is asked to stop.
                std::thread::spawn(move || {
                    let each = |found: Option<_>| found.is_some_and(|it| proved.send(it).is_err());
                    let keys: Vec<_> = keys.iter().collect();
                    let first = discovery::find_each(&name, &keys, &interrupt, each);
                    // Where nobody proves a key, this one says what is wrong.
                    let _ = first.map(|first| first.map(|it| proved.send(it)));
                });
                others.recv().ok()
            })?,
        };
        let at_rest = format_args!("{address} to acknowledge the stop and to come to rest");
        let more = || others.try_recv().ok();
        let by = waiting(at_rest, || udp::stop(address, &keys, interrupt, more))?;
        match (&keyring, &known.name, &known.offered) {
            (Some(keyring), Some(name), Some(offered)) if by == 0 => settle(keyring, name, offered),
            (_, Some(name), Some(_)) => {
                complain(format_args!("{name} was stopped by its former key{FORMER}"));
            }
            _ => {}
        }
        Ok(())
    }

    /// Names the robot as the keyring does, with the port that was typed.
    fn spelled(&self, keyring: &Option<Keyring>) -> Result<Self, Error> {
        let (host, port) = split_port(&self.robot).map_err(Error::usage)?;
        let name = keyring.as_ref().and_then(|keyring| keyring.spelled(host));
        let Some(name) = name else { return Ok(self.clone()) };
        let port = port.map_or_else(String::new, |port| format!(":{port}"));
        Ok(Self { robot: name + &port, key: self.key.clone() })
    }

    fn locate(
        &self,
        keyring: &Option<Keyring>,
        interrupt: &Interrupt,
    ) -> Result<(SocketAddr, Known), Error> {
        let known = self.find_key(keyring, interrupt)?;
        let address = match self.own_address(keyring)? {
            Some(address) => address,
            None => self.search(keyring, interrupt, |name| {
                discovery::find(name, known.keys(), interrupt).ok().flatten()
            })?,
        };
        Ok((address, known))
    }

    /// Returns the key: the named file, else that of the robot's name or address in the keyring.
    /// Every address of this machine belongs to the simulated robot.
    fn find_key(&self, keyring: &Option<Keyring>, interrupt: &Interrupt) -> Result<Known, Error> {
        if let Some(path) = &self.key {
            return Ok(Known { name: None, key: read_key(path, interrupt)?, offered: None });
        }
        let keyring = keyring.as_ref().ok_or(KeyError::NoHome)?;
        let (host, _) = split_port(&self.robot).unwrap_or((&self.robot, None));
        let name = if keyring.contains(host) {
            Some(host.to_owned())
        } else if let Some(name) = keyring.name_at(&self.robot).or_else(|| keyring.name_at(host)) {
            Some(name)
        } else {
            is_this_machine(host)
                .then(|| SIMULATED_ROBOT.to_owned())
                .filter(|name| keyring.contains(name))
        };
        match name {
            Some(name) => {
                // In this order: one that is settled meanwhile is the key then.
                let offered = offered(keyring, &name);
                Ok(Known { key: keyring.key(&name)?, offered, name: Some(name) })
            }
            None => {
                Err(KeyError::Unknown { robot: self.robot.clone(), names: keyring.names() }.into())
            }
        }
    }

    /// Returns the address that is given, or known for the name.
    fn own_address(&self, keyring: &Option<Keyring>) -> Result<Option<SocketAddr>, Error> {
        let (host, port) = split_port(&self.robot).map_err(Error::usage)?;
        let port = port.unwrap_or(DEFAULT_PORT);
        if let Ok(address) = host.parse::<IpAddr>() {
            return Ok(Some(SocketAddr::new(address, port)));
        }
        if let Some(address) = keyring.as_ref().and_then(|it| it.address(host)) {
            let (host, own_port) = split_port(&address).map_err(Error::usage)?;
            let address = resolve(host, own_port.unwrap_or(port));
            return address.map(Some).ok_or_else(|| not_found(&self.robot));
        }
        Ok((host == SIMULATED_ROBOT).then(|| SocketAddr::from(([127, 0, 0, 1], port))))
    }

    /// Finds an address by name: by `discover`, and where multicast does not work, as that of a machine.
    fn search(
        &self,
        keyring: &Option<Keyring>,
        interrupt: &Interrupt,
        discover: impl FnOnce(&str) -> Option<SocketAddr>,
    ) -> Result<SocketAddr, Error> {
        let (host, port) = split_port(&self.robot).map_err(Error::usage)?;
        let port = port.unwrap_or(DEFAULT_PORT);
        // A provisioned robot announces itself.
        if keyring.as_ref().is_some_and(|it| it.contains(host))
            && let Some(address) =
                waiting(format_args!("{host} to be found in the network"), || discover(host))
        {
            return Ok(address);
        }
        if interrupt.is_raised() {
            return Err(LinkError::Interrupted.into());
        }
        resolve(host, port)
            .or_else(|| resolve(&format!("{host}.local"), port))
            .ok_or_else(|| not_found(&self.robot))
    }
}

/// Pause between two looks at whether the person has given up.
const LOOK: Duration = Duration::from_millis(20);

/// Reads the key file that the person names. A pipe is read once and kept, because some commands connect several times.
fn read_key(path: &Path, interrupt: &Interrupt) -> Result<Key, Error> {
    static READ: OnceLock<Key> = OnceLock::new();
    if !file::is_read_once(path) {
        return Ok(keys::read(path)?);
    }
    if let Some(key) = READ.get() {
        return Ok(key.clone());
    }
    let (send, read) = mpsc::channel();
    let path = path.to_owned();
    // A pipe may stay silent for ever.
    std::thread::spawn(move || send.send(keys::read(&path)));
    loop {
        match read.recv_timeout(LOOK) {
            Ok(key) => {
                let key = key?;
                return Ok(READ.get_or_init(|| key).clone());
            }
            Err(mpsc::RecvTimeoutError::Timeout) if !interrupt.is_raised() => {}
            Err(_) => return Err(LinkError::Interrupted.into()),
        }
    }
}

/// Returns the key that was offered to a robot; complains of one that cannot be used, which is in nobody's way.
pub fn offered(keyring: &Keyring, name: &str) -> Option<Key> {
    keyring.offered(name).unwrap_or_else(|error| {
        complain(format_args!("the new key of {name} is ignored: {error}"));
        None
    })
}

/// Puts the offered key of a robot in the place of the former one; both stay where that fails.
fn settle(keyring: &Keyring, name: &str, offered: &Key) {
    if let Err(error) = keyring.settle(name, offered) {
        complain(format_args!("both keys of {name} are kept: {error}"));
    }
}

fn not_found(robot: &str) -> Error {
    Error::new(
        Exit::NoAnswer,
        format_args!(
            "no robot or machine called `{robot}` was found: check the name, that it is on and in this network, or give its address; `flix discover` lists the robots in the network"
        ),
    )
}

/// Resolves a host name. IPv4 comes first: robots have no IPv6.
fn resolve(host: &str, port: u16) -> Option<SocketAddr> {
    let addresses: Vec<SocketAddr> = (host, port).to_socket_addrs().ok()?.collect();
    addresses.iter().find(|address| address.is_ipv4()).or(addresses.first()).copied()
}

fn is_this_machine(host: &str) -> bool {
    host.eq_ignore_ascii_case("localhost")
        || host.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// Splits `host`, `host:port`, `[v6]:port` or a bare IPv6 address into host and port.
fn split_port(text: &str) -> Result<(&str, Option<u16>), String> {
    let wrong = |what: &str| {
        Err(format!("`{text}` is not a robot: {what}; write HOST, HOST:PORT, or a robot's name"))
    };
    if text.parse::<std::net::Ipv6Addr>().is_ok() {
        return Ok((text, None));
    }
    let (host, port) = match text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((host, "")) => (host, None),
        Some((host, rest)) => (host, Some(rest.strip_prefix(':').unwrap_or_default())),
        None => match text.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (text, None),
        },
    };
    if host.is_empty() {
        return wrong("there is no host");
    }
    match port.map(str::parse) {
        None => Ok((host, None)),
        Some(Ok(port)) if port > 0 => Ok((host, Some(port))),
        Some(_) => wrong("the port is not a number from 1 to 65535"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_taken_apart() {
        for (text, host, port) in [
            ("walker-3f2c", "walker-3f2c", None),
            ("10.0.0.7", "10.0.0.7", None),
            ("10.0.0.7:4000", "10.0.0.7", Some(4000)),
            ("robot.lab:1", "robot.lab", Some(1)),
            ("::1", "::1", None),
            ("[::1]", "::1", None),
            ("[::1]:4000", "::1", Some(4000)),
        ] {
            assert_eq!(split_port(text), Ok((host, port)), "{text}");
        }
    }

    #[test]
    fn what_is_no_address_is_refused_with_what_would_be() {
        for text in ["", ":4000", "host:", "host:0", "host:65536", "host:x", "[::1]4000", "a:1:2"] {
            let sentence = split_port(text).unwrap_err();
            assert!(sentence.contains("HOST:PORT"), "{text}: {sentence}");
        }
    }

    #[test]
    fn this_machine_is_the_simulated_robot_unless_it_has_a_name() {
        let directory = tempfile::tempdir().unwrap();
        let keyring = Keyring::in_directory(directory.path().to_owned());
        let simulated = keyring.key_or_new(SIMULATED_ROBOT).unwrap();
        let keyring = Some(keyring);
        let find = |robot: &str| {
            let args = RobotArgs { robot: robot.to_owned(), key: None };
            args.find_key(&keyring, &Interrupt::never())
        };
        for robot in ["127.0.0.1", "localhost:4000", "::1", "[::1]:9", "simulated"] {
            assert_eq!(find(robot).unwrap().key, simulated, "{robot}");
        }
        let unknown = find("10.0.0.7").err().unwrap().to_string();
        assert!(unknown.contains("there is no key for 10.0.0.7"), "{unknown}");
    }

    #[test]
    fn a_key_that_is_named_needs_no_home() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("robot.key");
        let key = keys::generate().unwrap();
        keys::write_new(&file, &key).unwrap();
        let (robot, interrupt) = ("10.0.0.7:4000".to_owned(), Interrupt::never());
        let args = RobotArgs { robot: robot.clone(), key: Some(file) };
        let (address, known) = args.locate(&None, &interrupt).unwrap();
        assert!(address == "10.0.0.7:4000".parse().unwrap() && known.key == key);
        let args = RobotArgs { robot, key: None };
        let refused = args.locate(&None, &interrupt).err().unwrap().to_string();
        assert!(refused.contains("HOME") && refused.contains("--key"), "{refused}");
    }

    #[test]
    fn a_fixed_address_leads_to_its_key() {
        let directory = tempfile::tempdir().unwrap();
        let keyring = Keyring::in_directory(directory.path().to_owned());
        let key = keyring.key_or_new("walker").unwrap();
        keyring.store_address("walker", "10.0.0.7").unwrap();
        let keyring = Some(keyring);
        for robot in ["walker", "walker:99", "10.0.0.7", "10.0.0.7:4000"] {
            let args = RobotArgs { robot: robot.to_owned(), key: None };
            let known = args.find_key(&keyring, &Interrupt::never()).unwrap();
            assert_eq!(known.key, key, "{robot}");
        }
    }
}
