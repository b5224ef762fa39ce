//! Sources as they are compiled: those of two packages are changed on the way.

use std::env::var;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustc_span::source_map::{FileLoader, RealFileLoader};

/// Reads files, with what the patches change.
pub(crate) struct Patched;

impl FileLoader for Patched {
    fn file_exists(&self, path: &Path) -> bool {
        RealFileLoader.file_exists(path)
    }

    fn read_file(&self, path: &Path) -> io::Result<String> {
        let text = RealFileLoader.read_file(path)?;
        // Cargo names the package that is compiled.
        let (Ok(package), Ok(version)) = (var("CARGO_PKG_NAME"), var("CARGO_PKG_VERSION")) else {
            return Ok(text);
        };
        flix_xtensa::patches::patched(&package, &version, path, text).map_err(io::Error::other)
    }

    fn read_binary_file(&self, path: &Path) -> io::Result<Arc<[u8]>> {
        RealFileLoader.read_binary_file(path)
    }

    fn current_directory(&self) -> io::Result<PathBuf> {
        RealFileLoader.current_directory()
    }
}
