//! Packs the page: one document that runs from any static server or as a file.

use std::io::{self, Write as _};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use flix_host::teleop::page::html::Page;

const CONNECTION: &str = include_str!("../page/connection.js");
const WORKER: &str = include_str!("../page/worker.js");
const PANEL: &str = include_str!("../page/panel.html");
const WORLD: &str = include_str!("../page/world.html");
const STYLE: &str = include_str!("../page/panel.css");

/// Returns the document with this WebAssembly module of the package inside.
///
/// # Errors
/// Never in practice: memory takes what is packed.
pub fn document(module: &[u8]) -> io::Result<String> {
    let connection = CONNECTION
        .replace("{{worker}}", &serde_json::to_string(WORKER)?.replace('<', "\\u003c"))
        .replace("{{module}}", &STANDARD.encode(pack(module)?));
    Ok(Page {
        style: STYLE,
        panel: PANEL,
        world: WORLD,
        connection: &connection,
        holds_to_run: false,
    }
    .to_html("robot"))
}

/// Packs bytes with gzip, as small as it can.
///
/// # Errors
/// Never in practice: memory takes what is packed.
pub fn pack(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::best());
    packed.write_all(bytes)?;
    packed.finish()
}
