//! Keys of robots: made here, stored in files that only their owner can read, never shown.
//!
//! A key file holds the 256-bit pre-shared key of one robot as 64 hexadecimal digits on one line.
//! The keys of the user are in the *keyring*, one file per robot:
//! `$XDG_CONFIG_HOME/flix/robots/NAME.key` (`~/.config/flix/robots/NAME.key`). Beside a
//! key, `NAME.address` holds the address of a robot with a fixed one, and `NAME.new` a key that was
//! offered to the robot, while its answer is missing: both keys are kept until then. `NAME.forgotten` holds the key that a
//! robot has erased at its owner's request.
//!
//! A file that other users can read is refused, as ssh does.

use std::fs::{self, File};
use std::io::{self, IsTerminal as _, Read as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flix_protocol::session::{self, Key};
use flix_protocol::{HOST_PREFIX, SERVICE_TYPE, provision};
use zeroize::Zeroizing;

use crate::system::file;
use crate::system::{create_private_folder, exposed_mode};

/// Name of the simulated robot, under which `flix-sim serve` stores its key. It is also the key for
/// every address of this machine.
pub const SIMULATED_ROBOT: &str = "simulated";

/// Environment variable that names the key file; it comes before the keyring.
pub const KEY_FILE_VARIABLE: &str = "FLIX_KEY_FILE";

/// Longest part of a file with a secret that is read, bytes: a wrong path (a film, a device) must not be read whole.
const LONGEST_SECRET: u64 = 4096;

/// Longest wait for another program that changes keys; it takes some milliseconds.
const LOCK_PATIENCE: Duration = Duration::from_secs(1);
/// Interval of the attempts.
const LOCK_RETRY: Duration = Duration::from_millis(5);

/// Why a key could not be made, read or stored.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The operating system gave no randomness.
    #[error("the operating system gave no random numbers for a key: {0}")]
    Random(getrandom::Error),
    /// Other users can read the file.
    #[error(
        "{} can be read by others (mode {mode:03o}): run `chmod 600 {}`, and replace the secret in it if it may have been read; where its mode cannot be changed, as of a secret that is mounted, give `{option} - < {}`",
        path.display(), path.display(), path.display()
    )]
    Exposed {
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
        /// The option that names the file.
        option: &'static str,
    },
    /// Not a key.
    #[error(
        "{} is not a key file: {source}; `flix keygen {}.new` makes one",
        path.display(), path.display()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The error in its text.
        source: session::KeyError,
    },
    /// The file exists: a key must not be overwritten by accident.
    #[error(
        "{} exists already: a key that a robot knows would be lost; move the file away first",
        path.display()
    )]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// There is no key for this robot.
    #[error(
        "there is no key for {robot}: give one with --key FILE or {KEY_FILE_VARIABLE}, or provision the robot with `flix provision`{}{}",
        known(names),
        simulated(robot)
    )]
    Unknown {
        /// The robot, as the operator wrote it.
        robot: String,
        /// Robots whose keys are in the keyring.
        names: Vec<String>,
    },
    /// The name cannot be a robot's name, which is also the name of a file.
    #[error(
        "`{0}` cannot be a robot's name: use 1 to 31 letters, digits and hyphens, beginning and ending with a letter or digit"
    )]
    Name(String),
    /// No environment variable leads to the directory of the user.
    #[error(
        "there is no home directory to keep keys in: set HOME or XDG_CONFIG_HOME, or give a key with --key FILE"
    )]
    NoHome,
    /// A file or directory could not be used.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

fn known(names: &[String]) -> String {
    match names {
        [] => String::new(),
        names => format!(" (known robots: {})", names.join(", ")),
    }
}

fn simulated(robot: &str) -> &'static str {
    if robot == SIMULATED_ROBOT { "; `flix-sim serve` makes its own when it starts" } else { "" }
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> KeyError + '_ {
    |source| KeyError::Io { path: path.to_owned(), source }
}

/// Makes a key from random numbers of the operating system.
///
/// # Errors
/// When the operating system has no random numbers.
pub fn generate() -> Result<Key, KeyError> {
    let mut bytes = Zeroizing::new([0; 32]);
    getrandom::fill(bytes.as_mut_slice()).map_err(KeyError::Random)?;
    Ok(Key::new(*bytes))
}

/// Reads a key file, as [`read_secret`] does.
///
/// # Errors
/// As for [`read_secret`], and when it is not a key file.
pub fn read(path: &Path) -> Result<Key, KeyError> {
    let text = read_secret(path, "--key")?;
    text.parse().map_err(|source| KeyError::Malformed { path: path.to_owned(), source })
}

/// Reads a file with a secret, which this option names; `-` is standard input. A pipe, [which can be read
/// once](file::is_read_once), is waited for. A byte order mark at the beginning, which some editors write, is left out.
///
/// # Errors
/// When it cannot be read, or other users can read it; when standard input is a terminal, which would show it.
pub fn read_secret(path: &Path, option: &'static str) -> Result<Zeroizing<String>, KeyError> {
    let mut text = Zeroizing::new(String::new());
    if path == Path::new(file::STANDARD_STREAM) {
        let input = file::standard_input().map_err(at(path))?;
        if input.is_terminal() {
            let shown = format!("a terminal would show it: write `{option} - < FILE`");
            return Err(at(path)(io::Error::other(shown)));
        }
        input.lock().take(LONGEST_SECRET).read_to_string(&mut text).map_err(at(path))?;
    } else {
        let file = match file::is_read_once(path) {
            true => File::open(path),
            false => file::open(path),
        };
        let file = file.map_err(at(path))?;
        refuse_exposed(path, &file, option)?;
        file.take(LONGEST_SECRET).read_to_string(&mut text).map_err(at(path))?;
    }
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => Zeroizing::new(rest.to_owned()),
        None => text,
    })
}

/// Writes a new key file that only its owner can read, whole or not at all.
///
/// # Errors
/// When the file exists already or cannot be written.
pub fn write_new(path: &Path, key: &Key) -> Result<(), KeyError> {
    let text = Zeroizing::new([key.to_text().as_slice(), b"\n"].concat());
    file::write_private(path, &text).map_err(|error| {
        if error.kind() == io::ErrorKind::AlreadyExists {
            match file::kind(path) {
                Ok(Some(what)) => at(path)(io::Error::other(format!("it exists, and is {what}"))),
                _ => KeyError::Exists { path: path.to_owned() },
            }
        } else {
            at(path)(error)
        }
    })
}

fn refuse_exposed(path: &Path, file: &File, option: &'static str) -> Result<(), KeyError> {
    match exposed_mode(file).map_err(at(path))? {
        None => Ok(()),
        Some(mode) => Err(KeyError::Exposed { path: path.to_owned(), mode, option }),
    }
}

/// The keys of the user, one file per robot.
#[derive(Debug, Clone)]
pub struct Keyring {
    directory: PathBuf,
}

impl Keyring {
    /// Returns the keyring of the present user. Creates nothing.
    ///
    /// # Errors
    /// When neither `XDG_CONFIG_HOME` nor the home directory is known.
    pub fn of_user() -> Result<Self, KeyError> {
        let configuration = std::env::var_os("XDG_CONFIG_HOME")
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
            .or_else(|| std::env::home_dir().map(|home| home.join(".config")))
            .ok_or(KeyError::NoHome)?;
        Ok(Self::in_directory(configuration.join("flix").join("robots")))
    }

    /// Returns the keyring in this directory.
    #[must_use]
    pub fn in_directory(directory: PathBuf) -> Self {
        Self { directory }
    }

    /// Returns the names of the robots with a key, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let Ok(entries) = fs::read_dir(&self.directory) else { return Vec::new() };
        let mut names: Vec<String> = entries
            .filter_map(|entry| {
                let path = entry.ok()?.path();
                let is_key = path.extension()? == "key";
                is_key.then(|| path.file_stem()?.to_str().map(str::to_owned))?
            })
            .collect();
        names.sort();
        names
    }

    /// Returns whether there is a key of this robot.
    #[must_use]
    pub fn contains(&self, name: &str) -> bool {
        check_name(name).is_ok() && self.key_file(name).exists()
    }

    /// Returns the name under which the key of a robot is kept: the name as typed, else the only one that differs from the typed name
    /// in case or in the forms that other programs show (`walker-1.local`, `walker-1._flix._udp.local`, `flix-walker-1`).
    #[must_use]
    pub fn spelled(&self, typed: &str) -> Option<String> {
        if self.contains(typed) {
            return Some(typed.to_owned());
        }
        let mut alike = self.names().into_iter().filter(|name| plain(name) == plain(typed));
        alike.next().filter(|_| alike.next().is_none())
    }

    /// Returns the path of the key of this robot, whether it exists or not.
    #[must_use]
    pub fn key_file(&self, name: &str) -> PathBuf {
        self.directory.join(format!("{name}.key"))
    }

    fn address_file(&self, name: &str) -> PathBuf {
        self.directory.join(format!("{name}.address"))
    }

    /// Returns the key of this robot.
    ///
    /// # Errors
    /// When there is none, or it cannot be used.
    pub fn key(&self, name: &str) -> Result<Key, KeyError> {
        if self.contains(name) {
            read(&self.key_file(name))
        } else {
            Err(KeyError::Unknown { robot: name.to_owned(), names: self.names() })
        }
    }

    /// Stores the key of a new robot, and returns its file.
    ///
    /// # Errors
    /// When the name cannot be a robot's, the robot has a key already, or the file cannot be
    /// written.
    pub fn store(&self, name: &str, key: &Key) -> Result<PathBuf, KeyError> {
        check_name(name)?;
        self.create_directory()?;
        let path = self.key_file(name);
        write_new(&path, key)?;
        Ok(path)
    }

    /// Returns the key of this robot; makes and stores it when there is none.
    ///
    /// # Errors
    /// As for [`Keyring::key`] and [`Keyring::store`].
    pub fn key_or_new(&self, name: &str) -> Result<Key, KeyError> {
        if self.contains(name) {
            return self.key(name);
        }
        let key = generate()?;
        match self.store(name, &key) {
            Ok(_) => Ok(key),
            // Another program was faster.
            Err(KeyError::Exists { .. }) => self.key(name),
            Err(error) => Err(error),
        }
    }

    /// Stores a key that is about to be offered to a robot which has another one. Both are kept until it is
    /// [settled](Keyring::settle) which of them the robot has.
    ///
    /// # Errors
    /// As for [`Keyring::store`]; when an earlier offer is not settled, of which the robot may have the key.
    pub fn offer(&self, name: &str, key: &Key) -> Result<(), KeyError> {
        check_name(name)?;
        let _alone = self.lock(LOCK_PATIENCE)?;
        write_new(&self.offered_file(name), key)
    }

    /// Returns the key that was offered to this robot and never acknowledged.
    ///
    /// # Errors
    /// When its file cannot be read.
    pub fn offered(&self, name: &str) -> Result<Option<Key>, KeyError> {
        let path = self.offered_file(name);
        if check_name(name).is_err() || !path.exists() {
            return Ok(None);
        }
        read(&path).map(Some)
    }

    /// Puts this offered key in the place of the former one: the robot has answered by it. Does nothing where another program
    /// has settled it already, or has offered another one since.
    ///
    /// # Errors
    /// When the file cannot be renamed.
    pub fn settle(&self, name: &str, offered: &Key) -> Result<(), KeyError> {
        let path = self.offered_file(name);
        if !path.exists() {
            return Ok(());
        }
        let _alone = self.lock(LOCK_PATIENCE)?;
        match read(&path) {
            Ok(key) if key == *offered => fs::rename(&path, self.key_file(name)).map_err(at(&path)),
            _ => Ok(()),
        }
    }

    /// Erases the offered key, if it is this one or unreadable: the robot did not take it.
    ///
    /// # Errors
    /// When the file cannot be erased.
    pub fn withdraw(&self, name: &str, offered: Option<&Key>) -> Result<(), KeyError> {
        let path = self.offered_file(name);
        if !path.exists() {
            return Ok(());
        }
        let _alone = self.lock(LOCK_PATIENCE)?;
        if read(&path).is_ok_and(|key| offered != Some(&key)) {
            return Ok(());
        }
        erase(&path)
    }

    /// Keeps other programs from changing keys, until the file is closed. A file system without locks keeps
    /// none, and a lock that another program holds for long, for example a suspended one, is waited for no longer.
    fn lock(&self, patience: Duration) -> Result<File, KeyError> {
        self.create_directory()?;
        let path = self.directory.join(".lock");
        let file = File::options().create(true).append(true).open(&path).map_err(at(&path))?;
        let begun = Instant::now();
        while file::is_held_elsewhere(&file) && begun.elapsed() < patience {
            std::thread::sleep(LOCK_RETRY);
        }
        Ok(file)
    }

    /// Returns the path of the key that was offered to this robot, whether it exists or not.
    #[must_use]
    pub fn offered_file(&self, name: &str) -> PathBuf {
        self.directory.join(format!("{name}.new"))
    }

    /// Sets the key of a robot aside, which has erased it; its name is free for the next robot. Returns the file that holds it now.
    ///
    /// # Errors
    /// When a file cannot be renamed or erased.
    pub fn set_aside(&self, name: &str) -> Result<PathBuf, KeyError> {
        check_name(name)?;
        let _alone = self.lock(LOCK_PATIENCE)?;
        let (path, aside) = (self.key_file(name), self.directory.join(format!("{name}.forgotten")));
        fs::rename(&path, &aside).map_err(at(&path))?;
        self.erase_address(name)?;
        Ok(aside)
    }

    /// Erases the fixed address of a robot, if one is stored.
    ///
    /// # Errors
    /// When its file cannot be erased.
    pub fn erase_address(&self, name: &str) -> Result<(), KeyError> {
        erase(&self.address_file(name))
    }

    /// Stores the fixed address (`host` or `host:port`) of a robot.
    ///
    /// # Errors
    /// When the name cannot be a robot's or the file cannot be written.
    pub fn store_address(&self, name: &str, address: &str) -> Result<(), KeyError> {
        check_name(name)?;
        self.create_directory()?;
        let path = self.address_file(name);
        file::overwrite(&path, format!("{address}\n").as_bytes(), || ()).map_err(at(&path))
    }

    /// Returns the fixed address of this robot, if one is stored.
    #[must_use]
    pub fn address(&self, name: &str) -> Option<String> {
        check_name(name).ok()?;
        let text = file::read_text(&self.address_file(name)).ok()?;
        Some(text.trim().to_owned()).filter(|address| !address.is_empty())
    }

    /// Returns the robot with this fixed address.
    #[must_use]
    pub fn name_at(&self, address: &str) -> Option<String> {
        self.names().into_iter().find(|name| self.address(name).as_deref() == Some(address))
    }

    fn create_directory(&self) -> Result<(), KeyError> {
        create_private_folder(&self.directory).map_err(at(&self.directory))
    }
}

/// Erases a file, if there is one.
fn erase(path: &Path) -> Result<(), KeyError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(at(path)(error)),
        _ => Ok(()),
    }
}

/// Returns the label of a robot's name: without the domain, the type of the service and the prefix of the host name, in lower case.
fn plain(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let name = name.strip_suffix('.').unwrap_or(&name);
    let domains = [SERVICE_TYPE.trim_end_matches('.'), "local"];
    let label = domains.iter().find_map(|domain| name.strip_suffix(domain)?.strip_suffix('.'));
    let name = label.unwrap_or(name);
    name.strip_prefix(HOST_PREFIX).unwrap_or(name).to_owned()
}

/// Checks the name of a robot: a label of a host name, as mDNS and file names need it.
///
/// # Errors
/// When it is not.
pub fn check_name(name: &str) -> Result<(), KeyError> {
    if provision::is_name(name) { Ok(()) } else { Err(KeyError::Name(name.to_owned())) }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn keyring() -> (tempfile::TempDir, Keyring) {
        let directory = tempfile::tempdir().unwrap();
        let keyring = Keyring::in_directory(directory.path().join("flix/robots"));
        (directory, keyring)
    }

    #[test]
    fn a_kept_key_comes_back() {
        let (_directory, keyring) = keyring();
        let key = generate().unwrap();
        keyring.store("walker-1", &key).unwrap();
        assert_eq!(keyring.key("walker-1").unwrap(), key);
    }

    #[test]
    fn a_robot_is_found_by_each_spelling_of_its_name() {
        let (_directory, keyring) = keyring();
        for name in ["walker-1", "Big", "big", "flix-2", "2"] {
            keyring.store(name, &generate().unwrap()).unwrap();
        }
        for typed in [
            "walker-1",
            "Walker-1",
            "walker-1.",
            "walker-1.local",
            "WALKER-1.local.",
            "walker-1._flix._udp.local",
            "walker-1._flix._udp.local.",
            "flix-walker-1",
            "flix-walker-1.local",
        ] {
            assert_eq!(keyring.spelled(typed).as_deref(), Some("walker-1"), "{typed}");
        }
        // As typed first; two that differ in case alone, or by the prefix, are not told apart otherwise.
        for (typed, name) in
            [("Big", Some("Big")), ("BIG", None), ("2", Some("2")), ("2.local", None)]
        {
            assert_eq!(keyring.spelled(typed).as_deref(), name, "{typed}");
        }
        for typed in ["walker-2", "walker-1.lab", "local", ".local", "", "flix-", "walker-1local"] {
            assert_eq!(keyring.spelled(typed), None, "{typed}");
        }
    }

    #[test]
    fn a_key_that_was_offered_meanwhile_is_neither_settled_nor_withdrawn() {
        let (_directory, keyring) = keyring();
        let [former, proved, newer] = [(); 3].map(|()| generate().unwrap());
        keyring.store("walker", &former).unwrap();
        keyring.offer("walker", &newer).unwrap();
        keyring.settle("walker", &proved).unwrap();
        keyring.withdraw("walker", Some(&proved)).unwrap();
        keyring.withdraw("walker", None).unwrap();
        assert_eq!(keyring.key("walker").unwrap(), former);
        assert_eq!(keyring.offered("walker").unwrap(), Some(newer.clone()));
        keyring.settle("walker", &newer).unwrap();
        assert_eq!(keyring.key("walker").unwrap(), newer);
        assert_eq!(keyring.offered("walker").unwrap(), None);
        keyring.settle("walker", &newer).unwrap();
        keyring.offer("walker", &former).unwrap();
        keyring.withdraw("walker", Some(&former)).unwrap();
        assert_eq!(keyring.offered("walker").unwrap(), None);
    }

    #[test]
    fn an_offer_that_cannot_be_erased_is_an_error_and_none_is_none() {
        let (_directory, keyring) = keyring();
        assert!(keyring.withdraw("walker", None).is_ok());
        fs::create_dir_all(keyring.offered_file("walker")).unwrap();
        assert!(keyring.withdraw("walker", None).is_err());
    }

    #[test]
    fn a_change_waits_for_that_of_another_program_and_not_for_ever() {
        let (_directory, keyring) = keyring();
        let held = keyring.lock(LOCK_PATIENCE).unwrap();
        keyring.lock(Duration::ZERO).unwrap();
        let (report, reported) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                keyring.lock(Duration::MAX).unwrap();
                report.send(()).unwrap();
            });
            assert!(reported.recv_timeout(4 * LOCK_RETRY).is_err(), "locked twice");
            drop(held);
        });
        reported.recv().unwrap();
    }

    #[test]
    fn two_generated_keys_differ() {
        assert_ne!(generate().unwrap(), generate().unwrap());
    }

    #[test]
    fn key_files_are_for_their_owner_alone() {
        let (_directory, keyring) = keyring();
        let path = keyring.store("walker", &generate().unwrap()).unwrap();
        assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_key_that_others_can_read_is_refused_with_what_to_do() {
        let (_directory, keyring) = keyring();
        let path = keyring.store("walker", &generate().unwrap()).unwrap();
        for mode in [0o644, 0o640, 0o604, 0o660] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let sentence = keyring.key("walker").unwrap_err().to_string();
            assert!(sentence.contains("chmod 600"), "{mode:o}: {sentence}");
        }
    }

    #[test]
    fn a_key_is_never_overwritten() {
        let (_directory, keyring) = keyring();
        let first = generate().unwrap();
        keyring.store("walker", &first).unwrap();
        let again = keyring.store("walker", &generate().unwrap());
        assert!(matches!(again, Err(KeyError::Exists { .. })));
        assert_eq!(keyring.key("walker").unwrap(), first);
    }

    #[test]
    fn files_that_hold_no_key_are_refused() {
        let (_directory, keyring) = keyring();
        let path = keyring.store("walker", &generate().unwrap()).unwrap();
        let long = "0".repeat(66);
        let sign = format!("+{}", "0".repeat(63));
        for content in
            ["", "0123", "not a key at all", &long, &sign, "\u{fffd}".repeat(22).as_str()]
        {
            fs::write(&path, content).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
            assert!(
                matches!(keyring.key("walker"), Err(KeyError::Malformed { .. })),
                "{content:?}"
            );
        }
    }

    #[test]
    fn an_unknown_robot_is_answered_with_what_to_do_and_the_known_ones() {
        let (_directory, keyring) = keyring();
        keyring.store("walker", &generate().unwrap()).unwrap();
        let sentence = keyring.key("wanderer").unwrap_err().to_string();
        assert!(sentence.contains("--key") && sentence.contains("walker"), "{sentence}");
    }

    #[test]
    fn names_that_would_leave_the_directory_are_refused() {
        let (_directory, keyring) = keyring();
        for name in ["", "../walker", "a/b", "a.b", "-a", "a-", "ä", &"a".repeat(32)] {
            let key = Key::new([1; 32]);
            assert!(matches!(keyring.store(name, &key), Err(KeyError::Name(_))), "{name:?}");
        }
    }

    #[test]
    fn the_first_use_makes_a_key_and_the_second_finds_it() {
        let (_directory, keyring) = keyring();
        let key = keyring.key_or_new(SIMULATED_ROBOT).unwrap();
        assert_eq!(keyring.key_or_new(SIMULATED_ROBOT).unwrap(), key);
    }

    #[test]
    fn an_offered_key_is_kept_beside_the_former_one_until_it_is_settled() {
        let (_directory, keyring) = keyring();
        let former = generate().unwrap();
        let path = keyring.store("walker", &former).unwrap();
        assert_eq!(keyring.offered("walker").unwrap(), None);
        let key = generate().unwrap();
        keyring.offer("walker", &key).unwrap();
        let again = keyring.offer("walker", &generate().unwrap());
        assert!(matches!(again, Err(KeyError::Exists { .. })), "the robot may have the first");
        assert_eq!(keyring.key("walker").unwrap(), former);
        assert_eq!(keyring.offered("walker").unwrap().as_ref(), Some(&key));
        keyring.settle("walker", &key).unwrap();
        assert_eq!(keyring.key("walker").unwrap(), key);
        assert_eq!(keyring.offered("walker").unwrap(), None);
        assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(keyring.names(), ["walker"]);
        keyring.offer("walker", &former).unwrap();
        keyring.withdraw("walker", Some(&former)).unwrap();
        assert_eq!(keyring.offered("walker").unwrap(), None);
    }

    #[test]
    fn a_fixed_address_leads_to_its_robot() {
        let (_directory, keyring) = keyring();
        keyring.store("walker", &generate().unwrap()).unwrap();
        keyring.store_address("walker", "10.0.0.7").unwrap();
        assert_eq!(keyring.name_at("10.0.0.7").as_deref(), Some("walker"));
        assert_eq!(keyring.name_at("10.0.0.8"), None);
    }
}
