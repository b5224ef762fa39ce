//! Driving by hand in a browser, from this computer or a phone.
//!
//! Pure parts: [`message`] checks a page's messages, [`pages`] decides which page drives and when its operator is silent,
//! [`snapshot`] is the picture of all pages, [`connection_limits`] limits waiting connections. `flix-cli` owns the sockets and the
//! loop, and decides which client may ask at all. The robot's side is that of the terminal:
//! [`teleop::Cockpit`](crate::teleop::Cockpit).
//!
//! # Freshness
//!
//! Each snapshot carries a stamp, the milliseconds since the program started. Each message of a page states the stamp
//! of the newest snapshot that the page has shown. So the age of a message is known without a common clock, also when
//! browser or proxy held it back: its operator has seen nothing newer. A message that is older than
//! [`SIGN_OF_LIFE`](pages::SIGN_OF_LIFE) is no sign of life and moves nothing; stop, rest and disarm are always done.
//!
//! A page answers each snapshot with a message of its own that asks for nothing, and is sent no more while some are unanswered: a
//! slow connection shows fewer pictures, and none that is old. A picture that is old all the same says so. A stop has arrived when
//! a snapshot states its press; until then the page says that it may not have, and asks again by another connection.

pub mod connection_limits;
pub mod html;
pub mod message;
pub mod pages;
pub mod scene;
pub mod snapshot;
