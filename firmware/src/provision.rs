//! The serial port's side of [`flix_protocol::provision`]: whose robot this is.
//!
//! Bytes of the serial port come in one at a time, frames go out; log text around them does no
//! harm. The key goes into the store and to the link, and never out again.
//!
//! Name, network and key have a store of their own, beside that of the settings: damaged settings
//! leave the robot in the hands of its owner, who then sees the fault.

use core::fmt;

use flix_protocol::message::State;
use flix_protocol::provision::{
    Answer, FrameReader, MAXIMUM_FRAME, ProvisionRefusal, Provisioning, Request, write_frame,
};
use heapless::Vec;
use zeroize::Zeroizing;

use crate::hardware::{Hardware, SettingsStore};
use crate::link::{identity, is_idle};
use crate::robot::UNNAMED;
use crate::stored::{self, LoadError, SaveError};

/// Most bytes that the stored form takes in a [`SettingsStore`].
pub const STORED_LENGTH: usize = 256;

/// What to do after a request.
#[derive(Debug)]
pub struct Response {
    /// Send it over the serial port, in one piece.
    pub frame: Vec<u8, MAXIMUM_FRAME>,
    /// Whether [`Provisioner::provisioning`] changed: take over network, name and key.
    pub changed: bool,
}

/// Keeps whose robot this is.
pub struct Provisioner<S> {
    store: S,
    hardware: Hardware,
    provisioning: Option<Provisioning>,
    loaded: Result<(), LoadError>,
    reader: FrameReader,
}

impl<S: SettingsStore> Provisioner<S> {
    /// Reads what is stored. When that cannot be trusted the robot is not provisioned, and
    /// [`Provisioner::loaded`] says why.
    pub fn new(mut store: S, hardware: Hardware) -> Self {
        let (provisioning, loaded) = match load(&mut store) {
            Ok(provisioning) => (provisioning, Ok(())),
            Err(error) => (None, Err(error)),
        };
        Self { store, hardware, provisioning, loaded, reader: FrameReader::new() }
    }

    /// Returns whether what was stored could be read at power-up.
    ///
    /// # Errors
    /// When it could not, and the robot must be provisioned again.
    pub const fn loaded(&self) -> Result<(), LoadError> {
        self.loaded
    }

    /// Returns network, name and key; `None` while the robot is not provisioned.
    #[must_use]
    pub const fn provisioning(&self) -> Option<&Provisioning> {
        self.provisioning.as_ref()
    }

    /// Returns the robot's name, or a default while it has none.
    #[must_use]
    pub fn name(&self) -> &str {
        self.provisioning.as_ref().map_or(UNNAMED, Provisioning::name)
    }

    /// Takes the next byte of the serial port; responds when a request ends with it. `state` is
    /// where the supervisor stands: nothing changes while the motors turn. Never panics.
    pub fn receive(&mut self, byte: u8, state: State) -> Option<Response> {
        match self.reader.push(byte)? {
            Request::Identify => respond(&Answer::Identity {
                identity: identity(self.name(), &self.hardware),
                has_key: self.provisioning.is_some(),
            }),
            Request::Provision(provisioning) => self.change(Some(provisioning), state),
            Request::Forget => self.change(None, state),
            Request::Prove(challenge) => respond(&Answer::Proof(
                self.provisioning.as_ref().map(|owner| owner.key().prove(&challenge)),
            )),
        }
    }

    /// Erases a former key that is still stored because power went while it was replaced. Takes
    /// seconds when there is one; call it while the motors coast.
    ///
    /// # Errors
    /// When the former key may still be stored.
    pub fn finish_erasure(&mut self) -> Result<(), SaveError> {
        self.store.sweep().map_err(|_| SaveError)
    }

    /// Stores first, and changes only when that worked.
    fn change(&mut self, provisioning: Option<Provisioning>, state: State) -> Option<Response> {
        if !is_idle(state) {
            return respond(&Answer::Refused(ProvisionRefusal::Driving));
        }
        if provisioning.as_ref().is_some_and(|provisioning| provisioning.check().is_err()) {
            return respond(&Answer::Refused(ProvisionRefusal::Malformed));
        }
        if self.loaded.is_ok() && self.provisioning == provisioning {
            // A repeated request: the answer to the first was lost, or power went before it.
            let erased = self.finish_erasure();
            return respond(&done_or_storage(erased));
        }
        let saved = save(&mut self.store, &provisioning);
        // A store that could write but not erase keeps the new one.
        if saved.is_err() && load(&mut self.store).as_ref() != Ok(&provisioning) {
            return respond(&done_or_storage(saved));
        }
        self.provisioning = provisioning;
        self.loaded = Ok(());
        respond(&done_or_storage(saved)).map(|response| Response { changed: true, ..response })
    }
}

impl<S> fmt::Debug for Provisioner<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Provisioner")
            .field("provisioning", &self.provisioning)
            .finish_non_exhaustive()
    }
}

fn done_or_storage(outcome: Result<(), SaveError>) -> Answer {
    match outcome {
        Ok(()) => Answer::Done,
        Err(SaveError) => Answer::Refused(ProvisionRefusal::Storage),
    }
}

fn respond(answer: &Answer) -> Option<Response> {
    let frame = Vec::from_slice(&write_frame(answer)?).ok()?;
    Some(Response { frame, changed: false })
}

fn load<S: SettingsStore>(store: &mut S) -> Result<Option<Provisioning>, LoadError> {
    let stored = stored::load(store, &mut *Zeroizing::new([0; STORED_LENGTH]))?;
    // Stored while the robot has an owner: the provisioning; else that there is none.
    match stored.flatten() {
        Some(provisioning) if Provisioning::check(&provisioning).is_err() => {
            Err(LoadError::Damaged)
        }
        provisioning => Ok(provisioning),
    }
}

fn save<S: SettingsStore>(
    store: &mut S,
    provisioning: &Option<Provisioning>,
) -> Result<(), SaveError> {
    let mut buffer = Zeroizing::new([0; STORED_LENGTH]);
    store.save_and_sweep(stored::encode(provisioning, &mut *buffer)?).map_err(|_| SaveError)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;
    use crate::stored::CRC;
    use flix_protocol::session::Key;
    use std::format;

    #[derive(Default)]
    struct Memory {
        bytes: Option<std::vec::Vec<u8>>,
        is_worn: bool,
        /// Writes, but cannot erase.
        cannot_erase: bool,
    }

    impl SettingsStore for &mut Memory {
        type Error = ();

        fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, ()> {
            let Some(bytes) = &self.bytes else { return Ok(None) };
            buffer.get_mut(..bytes.len()).ok_or(())?.copy_from_slice(bytes);
            Ok(Some(bytes.len()))
        }

        fn save(&mut self, bytes: &[u8]) -> Result<(), ()> {
            if self.is_worn {
                return Err(());
            }
            self.bytes = Some(bytes.to_vec());
            Ok(())
        }

        fn save_and_sweep(&mut self, bytes: &[u8]) -> Result<(), ()> {
            self.save(bytes)?;
            self.sweep()
        }

        fn sweep(&mut self) -> Result<(), ()> {
            if self.cannot_erase { Err(()) } else { Ok(()) }
        }
    }

    const KEY: [u8; 32] = *b"a key which nobody else may know";

    fn mine() -> Provisioning {
        Provisioning::new("daisy", "workshop", "correct horse", None, &Key::new(KEY)).unwrap()
    }

    fn robot(memory: &mut Memory) -> Provisioner<&mut Memory> {
        Provisioner::new(memory, DENGFOC_V3_01.hardware)
    }

    /// Sends bytes to the robot and reads its answers as the computer would.
    fn exchange<S: SettingsStore>(
        robot: &mut Provisioner<S>,
        bytes: &[u8],
        state: State,
    ) -> std::vec::Vec<Answer> {
        let mut reader = FrameReader::new();
        let responses: std::vec::Vec<_> =
            bytes.iter().filter_map(|byte| robot.receive(*byte, state)).collect();
        let out = responses.iter().flat_map(|response| response.frame.iter());
        out.filter_map(|byte| reader.push(*byte)).collect()
    }

    fn ask<S: SettingsStore>(
        robot: &mut Provisioner<S>,
        request: &Request,
        state: State,
    ) -> Answer {
        let mut answers = exchange(robot, &write_frame(request).unwrap(), state);
        assert_eq!(answers.len(), 1);
        answers.remove(0)
    }

    fn provision(memory: &mut Memory) {
        let answer = ask(&mut robot(memory), &Request::Provision(mine()), State::Disarmed);
        assert_eq!(answer, Answer::Done);
    }

    fn holds_key(bytes: &[u8]) -> bool {
        bytes.windows(8).any(|window| KEY.windows(8).any(|part| part == window))
    }

    #[test]
    fn a_provisioned_robot_is_its_owners_after_power_off_too() {
        let mut memory = Memory::default();
        provision(&mut memory);
        assert_eq!(robot(&mut memory).provisioning(), Some(&mine()));
    }

    #[test]
    fn a_robot_says_whether_it_has_an_owner() {
        let mut memory = Memory::default();
        let has_key = |memory: &mut Memory| {
            let answer = ask(&mut robot(memory), &Request::Identify, State::Running);
            matches!(answer, Answer::Identity { has_key: true, .. })
        };
        let before = has_key(&mut memory);
        provision(&mut memory);
        assert_eq!([before, has_key(&mut memory)], [false, true]);
    }

    #[test]
    fn a_robot_proves_the_key_that_it_has_in_every_state() {
        let mut memory = Memory::default();
        let request = Request::Prove([3; 16]);
        let before = ask(&mut robot(&mut memory), &request, State::Running);
        provision(&mut memory);
        let after = ask(&mut robot(&mut memory), &request, State::Running);
        assert_eq!(before, Answer::Proof(None));
        assert_eq!(after, Answer::Proof(Some(Key::new(KEY).prove(&[3; 16]))));
    }

    #[test]
    fn a_request_is_found_among_log_text() {
        let mut memory = Memory::default();
        let mut bytes = b"boot: 3 sectors\r\n".to_vec();
        bytes.extend_from_slice(&write_frame(&Request::Identify).unwrap());
        bytes.extend_from_slice(b"\r\nmore text");
        let answers = exchange(&mut robot(&mut memory), &bytes, State::Disarmed);
        assert!(matches!(answers.as_slice(), [Answer::Identity { .. }]), "{answers:?}");
    }

    #[test]
    fn the_key_never_comes_out() {
        let mut memory = Memory::default();
        let mut robot = robot(&mut memory);
        let mut out = std::vec::Vec::new();
        for request in [Request::Provision(mine()), Request::Identify, Request::Prove([3; 16])] {
            for byte in write_frame(&request).unwrap().iter() {
                if let Some(response) = robot.receive(*byte, State::Disarmed) {
                    out.extend_from_slice(&response.frame);
                }
            }
        }
        out.extend_from_slice(format!("{robot:?}").as_bytes());
        assert!(!out.is_empty() && !holds_key(&out));
    }

    #[test]
    fn nothing_changes_while_the_motors_turn() {
        let mut memory = Memory::default();
        let mut robot = robot(&mut memory);
        let answer = ask(&mut robot, &Request::Provision(mine()), State::Running);
        let refused = Answer::Refused(ProvisionRefusal::Driving);
        assert_eq!((answer, robot.provisioning()), (refused, None));
    }

    #[test]
    fn a_memory_that_fails_leaves_the_robot_as_it_was() {
        let mut memory = Memory { is_worn: true, ..Memory::default() };
        let mut robot = robot(&mut memory);
        let answer = ask(&mut robot, &Request::Provision(mine()), State::Disarmed);
        let refused = Answer::Refused(ProvisionRefusal::Storage);
        assert_eq!((answer, robot.provisioning()), (refused, None));
    }

    #[test]
    fn a_robot_that_is_given_away_forgets() {
        let mut memory = Memory::default();
        provision(&mut memory);
        let held = holds_key(memory.bytes.as_ref().unwrap());
        ask(&mut robot(&mut memory), &Request::Forget, State::Disarmed);
        let holds = holds_key(memory.bytes.as_ref().unwrap());
        assert_eq!((held, holds, robot(&mut memory).provisioning()), (true, false, None));
    }

    #[test]
    fn a_robot_that_cannot_erase_says_so_and_says_so_again() {
        let mut memory = Memory::default();
        provision(&mut memory);
        memory.cannot_erase = true;
        let mut robot = robot(&mut memory);
        for _ in 0..2 {
            let answer = ask(&mut robot, &Request::Forget, State::Disarmed);
            assert_eq!(answer, Answer::Refused(ProvisionRefusal::Storage));
        }
        assert_eq!(robot.provisioning(), None);
    }

    #[test]
    fn a_repeated_request_is_done_without_another_write() {
        let mut memory = Memory::default();
        provision(&mut memory);
        memory.is_worn = true;
        let answer = ask(&mut robot(&mut memory), &Request::Provision(mine()), State::Disarmed);
        assert_eq!(answer, Answer::Done);
    }

    #[test]
    fn what_the_first_release_stored_is_read() {
        // Version, some, name, network, password, no address, key; the check sum follows.
        let mut bytes = std::vec![1, 1, 5];
        bytes.extend_from_slice(b"daisy\x08workshop\x0dcorrect horse\x00");
        bytes.extend_from_slice(&KEY);
        let sum = CRC.checksum(&bytes).to_le_bytes();
        bytes.extend_from_slice(&sum);
        let mut memory = Memory { bytes: Some(bytes), ..Memory::default() };
        assert_eq!(robot(&mut memory).provisioning(), Some(&mine()));
    }

    #[test]
    fn any_damaged_bit_makes_the_robot_nobodys_and_says_so() {
        let mut memory = Memory::default();
        provision(&mut memory);
        let intact = memory.bytes.unwrap();
        for bit in 0..intact.len() * 8 {
            let mut bytes = intact.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let mut memory = Memory { bytes: Some(bytes), ..Memory::default() };
            let robot = robot(&mut memory);
            let found = (robot.provisioning(), robot.loaded());
            assert_eq!(found, (None, Err(LoadError::Damaged)), "bit {bit}");
        }
    }
}
