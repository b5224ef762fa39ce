//! Provisioning over the serial port of the robot: name, network and key.
//!
//! [`flix_protocol::provision`] defines the frames. The port also carries the robot's log, which
//! is shown where no answer comes. Opening the port may restart the robot, so questions are repeated.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flix_protocol::frame::NONCE_LENGTH;
use flix_protocol::message::{Identity, OperatorName};
use flix_protocol::provision::{
    Answer, BAUD_RATE, FrameReader, HeardNetwork, NetworkAddress, NetworkState, ProvisionRefusal,
    Request, write_frame,
};
use flix_protocol::session::Key;
use serial2::SerialPort;
use zeroize::Zeroize;

use super::joining::{JoinError, Wait};
pub use super::port_log::PortLog;
use crate::system::interrupt::Interrupt;
use crate::system::text::printable;

/// Longest time to an answer: the robot may be starting.
pub const PATIENCE: Duration = Duration::from_secs(8);
/// Interval at which a question is repeated; longer than writing to flash takes.
const RETRY: Duration = Duration::from_millis(700);
/// Interval of the checks for interruption.
const SLICE: Duration = Duration::from_millis(50);
/// Longest wait for the networks that a robot hears: it listens for 1.6 s once a try to connect has ended, after 15 s at most.
const SCAN_PATIENCE: Duration = Duration::from_secs(30);
/// Interval at which a robot is asked how far it is: on its way onto its network, or with a scan.
const PROGRESS: Duration = Duration::from_millis(250);

/// Why the robot could not be provisioned over its serial port.
#[derive(Debug, thiserror::Error)]
pub enum SerialError {
    /// The port could not be opened.
    #[error(
        "the serial port {} cannot be opened: {source}; {}",
        port.display(), advice(source.kind(), cfg!(windows), &SerialPort::available_ports().unwrap_or_default())
    )]
    Open {
        /// The port.
        port: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The port failed.
    #[error("the serial port failed: {0}; check the cable")]
    Port(#[from] io::Error),
    /// The operating system gave no randomness for the challenge.
    #[error("the operating system gave no random numbers: {0}")]
    Random(#[from] getrandom::Error),
    /// No answer arrived.
    #[error("no robot answers at this port: {0}")]
    NoAnswer(PortLog),
    /// The robot refused the request.
    #[error("the robot refused: {0}")]
    Refused(ProvisionRefusal),
    /// The answer does not belong to the request.
    #[error(
        "the robot's answer does not fit the request: update its firmware and this program to one release"
    )]
    Confused,
    /// A signal arrived.
    #[error("interrupted")]
    Interrupted,
}

/// Returns the remedy for a serial port that cannot be opened. `ports`: those of this computer.
fn advice(kind: io::ErrorKind, is_windows: bool, ports: &[PathBuf]) -> String {
    let group = if is_windows { "" } else { "; a port belongs to the group `dialout`" };
    match kind {
        // Windows grants a port to one program, and denies it to others.
        io::ErrorKind::PermissionDenied if !is_windows => {
            "you may not use it: join its group, `sudo usermod -aG dialout $USER`, and log in again"
                .to_owned()
        }
        io::ErrorKind::ResourceBusy | io::ErrorKind::PermissionDenied => {
            "another program has it open: close it (a serial monitor, an editor, ModemManager)"
                .to_owned()
        }
        _ if ports.is_empty() => {
            let taken =
                if is_windows { "" } else { "; `brltty` of Ubuntu takes those with a CH340" };
            format!(
                "this computer has no serial port: plug in a cable that carries data{taken}{group}"
            )
        }
        _ => {
            let named: Vec<_> = ports.iter().map(|port| port.display().to_string()).collect();
            format!("the ports of this computer are {}{group}", named.join(", "))
        }
    }
}

/// A robot at the other end of a serial cable.
pub struct SerialRobot {
    port: SerialPort,
    interrupt: Interrupt,
}

impl SerialRobot {
    /// Opens the port.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn open(port: &Path, interrupt: Interrupt) -> Result<Self, SerialError> {
        let opened = SerialPort::open(port, BAUD_RATE).and_then(|mut opened| {
            opened.set_read_timeout(SLICE)?;
            Ok(opened)
        });
        opened
            .map(|opened| Self { port: opened, interrupt })
            .map_err(|source| SerialError::Open { port: port.to_owned(), source })
    }

    /// Requests the identity, and whether the robot has a key.
    ///
    /// # Errors
    /// When it does not answer.
    pub fn identify(&self) -> Result<(Identity, bool), SerialError> {
        match self.ask(&Request::Identify)? {
            Answer::Identity { identity: Identity { name, board, version, reset }, has_key } => {
                let (name, board) = (shown(&name), shown(&board));
                Ok((Identity { name, board, version: shown(&version), reset }, has_key))
            }
            Answer::Refused(refusal) => Err(SerialError::Refused(refusal)),
            _ => Err(SerialError::Confused),
        }
    }

    /// Returns whether the robot proves that it has this key.
    ///
    /// # Errors
    /// When it does not answer, or there are no random numbers for the challenge.
    pub fn proves(&self, key: &Key) -> Result<bool, SerialError> {
        let mut challenge = [0; NONCE_LENGTH];
        getrandom::fill(&mut challenge)?;
        match self.ask(&Request::Prove(challenge, key.id()))? {
            Answer::Proof(proof) => Ok(proof.is_some_and(|it| key.is_proved(&challenge, &it))),
            Answer::Refused(refusal) => Err(SerialError::Refused(refusal)),
            _ => Err(SerialError::Confused),
        }
    }

    /// Requests the names of the operators.
    ///
    /// # Errors
    /// When it does not answer.
    pub fn operators(&self) -> Result<Vec<OperatorName>, SerialError> {
        match self.ask(&Request::Operators)? {
            Answer::Operators(names) => Ok(names.to_vec()),
            Answer::Refused(refusal) => Err(SerialError::Refused(refusal)),
            _ => Err(SerialError::Confused),
        }
    }

    /// Waits until the robot has an address on its network, or will not get one; `progress` is handed each state.
    ///
    /// # Errors
    /// When the robot does not answer, or has no network.
    pub fn joined(
        &self,
        mut progress: impl FnMut(NetworkState),
    ) -> Result<Result<NetworkAddress, JoinError>, SerialError> {
        let (mut wait, start) = (Wait::default(), Instant::now());
        loop {
            let state = match self.ask(&Request::Network)? {
                Answer::Network(state) => state,
                Answer::Refused(refusal) => return Err(SerialError::Refused(refusal)),
                _ => return Err(SerialError::Confused),
            };
            progress(state);
            if let Some(result) = wait.hear(state, start.elapsed()) {
                return Ok(result);
            }
            std::thread::sleep(PROGRESS);
        }
    }

    /// Requests the access points that the robot hears, the strongest first.
    ///
    /// # Errors
    /// When the robot does not answer, drives its motors, or cannot listen.
    pub fn networks(&self) -> Result<Vec<HeardNetwork>, SerialError> {
        let (mut scan, mut heard, start) = ([0], Vec::new(), Instant::now());
        getrandom::fill(&mut scan)?;
        let [number] = scan;
        loop {
            let from = u8::try_from(heard.len()).unwrap_or(u8::MAX);
            match self.ask(&Request::Scan { number, from })? {
                Answer::Networks(None) if start.elapsed() < SCAN_PATIENCE => {
                    std::thread::sleep(PROGRESS);
                }
                Answer::Networks(None) => {
                    return Err(SerialError::Refused(ProvisionRefusal::Radio));
                }
                // One that answers an earlier question once more is passed over.
                Answer::Networks(Some(part)) if part.from == from => {
                    let is_over = part.networks.is_empty();
                    heard.extend(part.networks);
                    if is_over || heard.len() >= part.total.into() {
                        return Ok(heard);
                    }
                }
                Answer::Networks(Some(_)) => {}
                Answer::Refused(refusal) => return Err(SerialError::Refused(refusal)),
                _ => return Err(SerialError::Confused),
            }
        }
    }

    /// Sends a request that changes the robot's storage.
    ///
    /// # Errors
    /// When the robot does not answer, or refuses; then nothing has changed.
    pub fn order(&self, request: &Request) -> Result<(), SerialError> {
        match self.ask(request)? {
            Answer::Done => Ok(()),
            Answer::Refused(refusal) => Err(SerialError::Refused(refusal)),
            _ => Err(SerialError::Confused),
        }
    }

    fn ask(&self, request: &Request) -> Result<Answer, SerialError> {
        let mut frame = write_frame(request).ok_or(SerialError::Confused)?;
        let answer = self.repeat(&frame, |answer| is_answer(request, answer));
        frame.as_mut_slice().zeroize();
        answer
    }

    /// Sends a frame until an answer of its kind comes. A late answer to an earlier question is
    /// passed over.
    fn repeat(
        &self,
        frame: &[u8],
        is_answer: impl Fn(&Answer) -> bool,
    ) -> Result<Answer, SerialError> {
        self.port.discard_input_buffer()?;
        let (mut reader, mut log) = (FrameReader::new(), PortLog::default());
        let (start, mut sent) = (Instant::now(), None::<Instant>);
        let mut bytes = [0; 256];
        while start.elapsed() < PATIENCE {
            if self.interrupt.is_raised() {
                return Err(SerialError::Interrupted);
            }
            if sent.is_none_or(|at| at.elapsed() >= RETRY) {
                self.port.write_all(frame)?;
                sent = Some(Instant::now());
            }
            let length = match self.port.read(&mut bytes) {
                Ok(length) => length,
                Err(error) if is_transient(&error) => 0,
                Err(error) => return Err(error.into()),
            };
            log.extend(&bytes[..length]);
            let mut answers = bytes[..length].iter().filter_map(|byte| reader.push(*byte));
            if let Some(answer) = answers.find(&is_answer) {
                return Ok(answer);
            }
        }
        Err(SerialError::NoAnswer(log))
    }
}

/// Returns a text of whatever is at the cable as it may be shown: [`printable`] makes it no longer.
fn shown<T: for<'a> TryFrom<&'a str> + Default>(text: &str) -> T {
    T::try_from(&printable(text)).unwrap_or_default()
}

/// Returns whether an answer is of the kind that the request asks for.
const fn is_answer(request: &Request, answer: &Answer) -> bool {
    match answer {
        Answer::Identity { .. } => matches!(request, Request::Identify),
        Answer::Proof(_) => matches!(request, Request::Prove(..)),
        Answer::Operators(_) => matches!(request, Request::Operators),
        Answer::Network(_) => matches!(request, Request::Network),
        Answer::Networks(_) => matches!(request, Request::Scan { .. }),
        Answer::Done => !matches!(
            request,
            Request::Identify
                | Request::Prove(..)
                | Request::Operators
                | Request::Network
                | Request::Scan { .. }
        ),
        Answer::Refused(_) => true,
    }
}

fn is_transient(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_cannot_be_opened_is_answered_with_its_cause() {
        use io::ErrorKind::{NotFound, PermissionDenied, ResourceBusy};
        let ports = [PathBuf::from("/dev/ttyACM0")];
        for (kind, is_windows, ports, word) in [
            (ResourceBusy, false, &ports[..], "another program"),
            (PermissionDenied, true, &ports, "another program"),
            (PermissionDenied, false, &ports, "usermod -aG dialout"),
            (NotFound, false, &ports, "/dev/ttyACM0"),
            (NotFound, true, &ports, "/dev/ttyACM0"),
            (NotFound, false, &[], "brltty"),
        ] {
            let said = advice(kind, is_windows, ports);
            assert!(said.contains(word), "{kind:?}: {said}");
            assert!(!(is_windows && said.contains("dialout")), "{said}");
        }
    }
}
