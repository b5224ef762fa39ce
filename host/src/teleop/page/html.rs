//! The page itself: one document that asks for nothing from elsewhere.

use super::message::LONGEST;
use super::scene;
use super::snapshot;

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Differences between the page of a robot on the network and that of a robot inside the page.
#[derive(Debug, Clone, Copy, Default)]
pub struct Page<'a> {
    /// Style besides that of the cockpit, as CSS.
    pub style: &'a str,
    /// HTML after the banner.
    pub panel: &'a str,
    /// HTML after the gauges.
    pub world: &'a str,
    /// How the page reaches its robot: JavaScript that defines `openConnection`, which returns an object such as a
    /// WebSocket; `SILENT_MS` and `GIVE_UP_MS`, how long it may bring nothing until the page shows nothing, and opens another;
    /// `DEAF_MS`, how long it may leave a STOP unanswered until another is tried; `NO_CONNECTION` and `STOP_UNHEARD`, the
    /// sentences without a connection, the second after a press of STOP; `drawWorld`, which returns whether it has drawn the
    /// robot; and `ownPicture`, which returns drawings beyond those of a snapshot.
    pub connection: &'a str,
    /// Whether a walk ends when its key or button is released.
    pub holds_to_run: bool,
}

impl Page<'_> {
    /// Returns the document; `nonce` marks its scripts and styles for a content security policy.
    #[must_use]
    pub fn to_html(&self, nonce: &str) -> String {
        PAGE.replace("{{nonce}}", nonce)
            .replace("{{style}}", &format!("{STYLE}{}", self.style))
            .replace("{{panel}}", self.panel)
            .replace("{{world}}", self.world)
            .replace("{{modes}}", &snapshot::modes().to_string())
            .replace("{{scene}}", scene::SCENE)
            .replace(
                "{{script}}",
                &format!("const HOLDS = {}, LONGEST = {LONGEST};\n{SCRIPT}", self.holds_to_run),
            )
            .replace("{{connection}}", self.connection)
    }
}
