//! Reads files that a person names: only what is a file, and only up to a size. Writes files whole or not at all.
//!
//! A pipe waits for its writer and a device may never end: neither is opened.

use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

#[cfg(not(target_family = "wasm"))]
use crate::system::create_private;
use crate::system::{is_pipe, take_after};

/// Largest text that is read as settings, waypoints, a model or a table, bytes.
pub const LARGEST_TEXT: u64 = 16 << 20;

/// Opens a file.
///
/// # Errors
/// When it is missing, cannot be read, or is something else: a directory, a pipe, a device.
pub fn open(path: &Path) -> io::Result<File> {
    match kind(path)? {
        None => File::open(path),
        Some(what) => Err(io::Error::other(format!("it is {what}, not a file"))),
    }
}

/// Returns what a path leads to, where that is no file.
///
/// # Errors
/// When it leads to nothing.
pub fn kind(path: &Path) -> io::Result<Option<&'static str>> {
    Ok(match fs::metadata(path)?.file_type() {
        kind if kind.is_file() => None,
        kind if kind.is_dir() => Some("a directory"),
        kind if is_pipe(kind) => Some("a pipe"),
        _ => Some("a device"),
    })
}

/// Checks that a file can be written, and makes its folder: a long run must not end with that.
///
/// # Errors
/// When it cannot, or is something else than a file.
pub fn check_writable(path: &Path) -> io::Result<()> {
    if let Ok(Some(what)) = kind(path) {
        return Err(io::Error::other(format!("it is {what}, not a file")));
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder)?;
    }
    let is_new = !path.exists();
    File::options().append(true).create(true).open(path)?;
    if is_new { fs::remove_file(path) } else { Ok(()) }
}

/// Writes a file in the place of what has its name: under a name of its own at first, so that whoever reads, and a cut of power,
/// find the old one or the new one whole. A link is replaced; what it leads to stays as it is.
///
/// # Errors
/// When it cannot be written, or `write` fails; then the old one stays.
pub fn replace<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    write_beside(path, |new| File::create_new(new), write, |new| fs::rename(new, path))
}

/// Errors that say that no file can be written beside this one, or take its place: a folder that cannot be written, a file that is
/// mounted by itself, a name that is as long as names may be.
const NOT_BESIDE: [io::ErrorKind; 5] = [
    io::ErrorKind::PermissionDenied,
    io::ErrorKind::ReadOnlyFilesystem,
    io::ErrorKind::ResourceBusy,
    io::ErrorKind::CrossesDevices,
    io::ErrorKind::InvalidFilename,
];

/// Writes a file that a person names. A file that is there already stays whole until the new one is, whatever fails: a full disk, a
/// kill. Links are followed, its mode and owner stay; devices and pipes are written as they are.
///
/// `show` shows the bytes to the person: after an error, or before a file is overwritten in its place, where nothing can be written
/// beside it.
///
/// # Errors
/// When it cannot be written.
pub fn overwrite(path: &Path, bytes: &[u8], show: impl FnOnce()) -> io::Result<()> {
    let write = |mut file: &File| file.write_all(bytes);
    let in_place = || File::create(path).and_then(|file| write(&file));
    let placed = match fs::metadata(path) {
        Ok(old) if old.is_file() && !is_descriptor(path) => {
            // What may not be written is not replaced.
            let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
            let create = |new: &Path| File::create_new(new).and_then(|new| take_after(new, &old));
            let put = |new: &Path| fs::rename(new, &target);
            let may = File::options().append(true).open(path);
            may.and_then(|_| write_beside(&target, create, write, put))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound && !path.is_symlink() => {
            replace(path, write)
        }
        _ => return in_place().inspect_err(|_| show()),
    };
    placed.or_else(|error| {
        show();
        if NOT_BESIDE.contains(&error.kind()) { in_place() } else { Err(error) }
    })
}

/// Writes a new file that only its owner can read; a cut of power leaves it whole or not at all.
///
/// # Errors
/// When there is anything of this name already, a link to nothing included, or it cannot be written.
#[cfg(not(target_family = "wasm"))]
pub(crate) fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let is_new = || match fs::symlink_metadata(path) {
        Ok(_) => Err(io::ErrorKind::AlreadyExists.into()),
        Err(_) => Ok(()),
    };
    is_new()?;
    let write = |mut file: &File| io::Write::write_all(&mut file, bytes);
    write_beside(path, create_private, write, |new| match fs::hard_link(new, path) {
        Ok(()) => fs::remove_file(new),
        // As on a memory card, which knows no second names.
        Err(_) => is_new().and_then(|()| fs::rename(new, path)),
    })
}

/// Writes a file under a name of its own, stores it, and gives it its place.
fn write_beside<T, E: From<io::Error>>(
    path: &Path,
    create: impl Fn(&Path) -> io::Result<File>,
    write: impl FnOnce(&File) -> Result<T, E>,
    put: impl FnOnce(&Path) -> io::Result<()>,
) -> Result<T, E> {
    let mut new = path.as_os_str().to_owned();
    new.push(".part");
    let new = PathBuf::from(new);
    let file = match create(&new) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            // The rest of an attempt that was killed, or a link.
            fs::remove_file(&new)?;
            create(&new)?
        }
        created => created?,
    };
    let written = write(&file).and_then(|written| {
        file.sync_all()?;
        put(&new)?;
        Ok(written)
    });
    if written.is_err() {
        // Part of a file, as a full disk leaves it.
        let _ = fs::remove_file(&new);
    }
    // Its name, too, is stored before others rely on it, where folders can be.
    if let Some(Ok(folder)) = path.parent().map(File::open) {
        let _ = folder.sync_all();
    }
    written
}

/// Reads a whole file of at most `most` bytes.
///
/// # Errors
/// As for [`open`], and when it is larger.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    // Before what may take minutes.
    if file.metadata()?.len() > most {
        return Err(too_large(most));
    }
    read_whole(file, most)
}

/// Reads a whole text file of at most [`LARGEST_TEXT`].
///
/// # Errors
/// As for [`read`], and when it is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    text(open(path)?)
}

/// Name of standard input or output where a file is asked for.
pub const STANDARD_STREAM: &str = "-";

/// Returns standard input, which `-` names.
///
/// # Errors
/// When it was taken before: it gives one file.
pub fn standard_input() -> io::Result<io::Stdin> {
    static IS_TAKEN: AtomicBool = AtomicBool::new(false);
    match IS_TAKEN.swap(true, Ordering::Relaxed) {
        false => Ok(io::stdin()),
        true => Err(io::Error::other("standard input is one file alone, and read already")),
    }
}

/// Returns whether this is a descriptor of this program by its name, as `<(...)` of a shell gives one.
fn is_descriptor(path: &Path) -> bool {
    ["/dev", "/proc"].iter().any(|folder| path.starts_with(folder))
}

/// Returns whether this can be read once alone: standard input, or a pipe by the name of its descriptor.
#[must_use]
pub fn is_read_once(path: &Path) -> bool {
    let is_pipe = || matches!(kind(path), Ok(Some("a pipe")));
    path == Path::new(STANDARD_STREAM) || (is_descriptor(path) && is_pipe())
}

/// Reads a source to its end, as [`read_text`] reads a file.
///
/// # Errors
/// When it cannot be read, is larger, or is not UTF-8.
pub fn text(source: impl Read) -> io::Result<String> {
    String::from_utf8(read_whole(source, LARGEST_TEXT)?)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not text (UTF-8)"))
}

fn read_whole(source: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let length = source.take(most + 1).read_to_end(&mut bytes)?;
    if length as u64 > most {
        return Err(too_large(most));
    }
    Ok(bytes)
}

fn too_large(most: u64) -> io::Error {
    io::Error::other(format!("it is larger than {} MB", most / 1_000_000))
}

/// Locks this file until it is closed; returns whether another program holds the lock. A file system without locks (a network's may
/// answer ENOLCK, ENOSYS or EOPNOTSUPP) keeps nobody away.
#[must_use]
pub fn is_held_elsewhere(file: &File) -> bool {
    is_held(&file.try_lock())
}

const fn is_held(tried: &Result<(), TryLockError>) -> bool {
    matches!(tried, Err(TryLockError::WouldBlock))
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn a_file_is_held_by_one_program_and_by_none_where_there_are_no_locks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let open = || File::options().create(true).append(true).open(&path).unwrap();
        let first = open();
        assert!(!is_held_elsewhere(&first) && is_held_elsewhere(&open()));
        drop(first);
        assert!(!is_held_elsewhere(&open()));
        for code in [37, 38, 95] {
            let error = io::Error::from_raw_os_error(code);
            assert!(!is_held(&Err(TryLockError::Error(error))), "{code}");
        }
    }

    #[test]
    fn a_file_is_checked_before_it_is_written_and_left_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let (new, old) = (folder.path().join("a/b"), folder.path().join("old"));
        fs::write(&old, "kept").unwrap();
        check_writable(&new).unwrap();
        check_writable(&old).unwrap();
        assert!(!new.exists() && fs::read_to_string(&old).unwrap() == "kept");
        assert!(check_writable(folder.path()).is_err() && check_writable(&old.join("c")).is_err());
    }

    #[test]
    fn a_file_is_replaced_whole_and_a_link_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("other"), "precious").unwrap();
        for name in ["new", "new.part"] {
            std::os::unix::fs::symlink(at("other"), at(name)).unwrap();
        }
        let write = |text: &'static str| move |mut file: &File| file.write_all(text.as_bytes());
        replace(&at("new"), write("first")).unwrap();
        assert_eq!(fs::read_to_string(at("other")).unwrap(), "precious");
        assert!(fs::symlink_metadata(at("new")).unwrap().is_file());
        let failed: io::Result<()> =
            replace(&at("new"), |file| write("sec")(file).and(Err(io::Error::other("full"))));
        assert!(failed.is_err() && !at("new.part").exists());
        assert_eq!(fs::read_to_string(at("new")).unwrap(), "first");
    }

    #[test]
    fn a_file_that_a_person_names_keeps_its_links_mode_and_old_content_until_it_is_whole() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o7777;
        fs::write(at("old"), "old").unwrap();
        fs::set_permissions(at("old"), fs::Permissions::from_mode(0o640)).unwrap();
        std::os::unix::fs::symlink("old", at("link")).unwrap();
        std::os::unix::fs::symlink("later", at("ahead")).unwrap();
        for name in ["link", "ahead", "new"] {
            overwrite(&at(name), b"first", || panic!("{name}")).unwrap();
            assert_eq!(fs::read_to_string(at(name)).unwrap(), "first");
        }
        assert!(at("link").is_symlink() && at("ahead").is_symlink() && mode(&at("old")) == 0o640);
        // Nothing fits beside the longest name.
        let long = at(&"n".repeat(255));
        fs::write(&long, "old").unwrap();
        let shown = std::cell::Cell::new(0);
        let show = || shown.set(shown.get() + 1);
        overwrite(&long, b"new", show).unwrap();
        assert_eq!((fs::read_to_string(&long).unwrap().as_str(), shown.get()), ("new", 1));
        // A device stays one, and one that is full is said.
        overwrite(Path::new("/dev/null"), b"new", show).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        overwrite(Path::new("/dev/full"), b"new", show).unwrap_err();
        overwrite(folder.path(), b"new", show).unwrap_err();
        assert_eq!(shown.get(), 3);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 6);
    }

    #[test]
    fn a_private_file_takes_the_place_of_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("key.part"), "the rest of an attempt").unwrap();
        std::os::unix::fs::symlink(at("nothing"), at("link")).unwrap();
        write_private(&at("key"), b"first").unwrap();
        for name in ["key", "link"] {
            let error = write_private(&at(name), b"second").unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::AlreadyExists, "{name}");
        }
        assert_eq!(fs::read_to_string(at("key")).unwrap(), "first");
        assert!(!at("nothing").exists() && !at("key.part").exists());
    }

    #[test]
    fn only_files_of_bounded_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("text"), "0,0\n").unwrap();
        fs::write(at("binary"), [0xff]).unwrap();
        File::create(at("large")).unwrap().set_len(LARGEST_TEXT + 1).unwrap();
        std::os::unix::fs::symlink(at("nothing"), at("link")).unwrap();
        let owner = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mkfifoat(rustix::fs::CWD, at("pipe"), owner).unwrap();
        assert_eq!(read_text(&at("text")).unwrap(), "0,0\n");
        for (path, word) in [
            (at("pipe"), "a pipe"),
            (folder.path().to_owned(), "a directory"),
            (Path::new("/dev/zero").to_owned(), "a device"),
            (at("large"), "larger than 16 MB"),
            (at("binary"), "not text"),
            (at("link"), "No such file"),
        ] {
            let sentence = read_text(&path).unwrap_err().to_string();
            assert!(sentence.contains(word), "{}: {sentence}", path.display());
        }
    }
}
