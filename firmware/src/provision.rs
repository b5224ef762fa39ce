//! The serial port's side of [`flix_protocol::provision`]: whose robot this is.
//!
//! Bytes of the serial port come in one at a time, frames go out; log text around them does no
//! harm. Keys go into the store and to the link, and never out again.
//!
//! Name, network and operators have a store of their own, beside that of the settings: damaged settings
//! leave the robot in the hands of its owner, who then sees the fault.

use core::fmt::{self, Write};

use flix_protocol::message::{Identity, Name, ResetReason, State};
use flix_protocol::provision::{
    Answer, FrameReader, MAXIMUM_FRAME, NetworkState, ProvisionRefusal, Provisioning, Request,
    write_frame,
};
use flix_protocol::session::{Operator, Operators};
use heapless::Vec;
use zeroize::Zeroizing;

use crate::hardware::{Hardware, SettingsStore};
use crate::link::identity;
use crate::stored::{self, LoadError, SaveError};

/// Most bytes that the stored form takes in a [`SettingsStore`].
pub const STORED_LENGTH: usize = 640;

/// Version of the stored form: an [`Owned`] robot, or none.
const FORMAT_VERSION: u16 = 2;

/// Name and network of a robot, and who may command it.
type Owned = (Provisioning, Operators);

/// Returns the name of a robot that was given none: `walker-` and the last four digits of its hardware address.
fn factory_name([.., fifth, sixth]: [u8; 6]) -> Name {
    let mut name = Name::new();
    // 11 letters.
    let _ = write!(name, "walker-{fifth:02x}{sixth:02x}");
    name
}

/// The robot's radio, as the serial cable sees it.
pub trait Radio {
    /// Returns how far the robot is on its way onto its network.
    fn network(&self) -> NetworkState;

    /// Answers [`Request::Scan`].
    fn scan(&self, number: u8, from: u8) -> Answer;
}

/// What to do after a request.
#[derive(Debug)]
pub struct Response {
    /// Send it over the serial port, in one piece.
    pub frame: Vec<u8, MAXIMUM_FRAME>,
    /// Whether [`Provisioner::provisioning`] or [`Provisioner::operators`] changed: take them over.
    pub changed: bool,
}

/// Keeps whose robot this is.
pub struct Provisioner<S> {
    store: S,
    hardware: Hardware,
    factory_name: Name,
    reset: ResetReason,
    owned: Option<Owned>,
    loaded: Result<(), LoadError>,
    reader: FrameReader,
}

impl<S: SettingsStore> Provisioner<S> {
    /// Reads what is stored. When that cannot be trusted the robot is not provisioned, and
    /// [`Provisioner::loaded`] says why. `address` is the chip's hardware address, which names a robot without a name.
    pub fn new(mut store: S, hardware: Hardware, address: [u8; 6]) -> Self {
        let (owned, loaded) = match load(&mut store) {
            Ok(owned) => (owned, Ok(())),
            Err(error) => (None, Err(error)),
        };
        let (reset, reader) = (ResetReason::PowerOn, FrameReader::new());
        let factory_name = factory_name(address);
        Self { store, hardware, factory_name, reset, owned, loaded, reader }
    }

    /// Notes why the robot last started, for [`Request::Identify`].
    pub fn set_reset(&mut self, reset: ResetReason) {
        self.reset = reset;
    }

    /// Returns whether what was stored could be read at power-up.
    ///
    /// # Errors
    /// When it could not, and the robot must be provisioned again.
    pub const fn loaded(&self) -> Result<(), LoadError> {
        self.loaded
    }

    /// Returns name and network; `None` while the robot is not provisioned.
    #[must_use]
    pub fn provisioning(&self) -> Option<&Provisioning> {
        self.owned.as_ref().map(|(provisioning, _)| provisioning)
    }

    /// Returns who may command the robot.
    #[must_use]
    pub fn operators(&self) -> Operators {
        self.owned.as_ref().map_or_else(Operators::default, |(_, operators)| operators.clone())
    }

    /// Returns the robot's name: as it was provisioned, else `walker-` and the last four digits of the hardware address.
    #[must_use]
    pub fn name(&self) -> &str {
        self.provisioning().map_or(&self.factory_name, Provisioning::name)
    }

    /// Takes the next byte of the serial port; responds when a request ends with it. `state` is
    /// where the supervisor stands: nothing changes, and the radio does not listen, while the motors turn. Never panics.
    pub fn receive(&mut self, byte: u8, state: State, radio: &impl Radio) -> Option<Response> {
        match self.reader.push(byte)? {
            Request::Identify => respond(&Answer::Identity {
                identity: Identity {
                    reset: self.reset.clone(),
                    ..identity(self.name(), &self.hardware)
                },
                has_key: self.owned.is_some(),
            }),
            // The robot has changed hands: whoever had a key before has none now.
            Request::Provision(provisioning, operator) => {
                self.add(provisioning, Operators::default(), operator, state)
            }
            Request::Keep(provisioning, name, key_id) => {
                let operators = self.operators();
                match operators.find(&key_id).map(Operator::key) {
                    Some(key) => {
                        self.add(provisioning, operators, Operator::new(name, &key), state)
                    }
                    None => refuse(ProvisionRefusal::Unknown),
                }
            }
            Request::Forget => self.change(None, state),
            Request::Prove(challenge, key_id) => {
                let operators = self.operators();
                let prover = operators.find(&key_id);
                respond(&Answer::Proof(prover.map(|operator| operator.key().prove(&challenge))))
            }
            Request::Operators => respond(&Answer::Operators(self.operators().names())),
            Request::Network if self.owned.is_some() => respond(&Answer::Network(radio.network())),
            Request::Network => refuse(ProvisionRefusal::Unprovisioned),
            Request::Scan { .. } if !state.is_idle() => refuse(ProvisionRefusal::Driving),
            Request::Scan { number, from } => respond(&radio.scan(number, from)),
            Request::Add(operator) => match self.owned.clone() {
                Some((provisioning, operators)) => {
                    self.add(provisioning, operators, operator, state)
                }
                None => refuse(ProvisionRefusal::Unprovisioned),
            },
            Request::Revoke(name) => match self.owned.clone() {
                Some((provisioning, mut operators)) => {
                    operators.revoke(name);
                    if operators.iter().len() == 0 {
                        return refuse(ProvisionRefusal::Last);
                    }
                    self.change(Some((provisioning, operators)), state)
                }
                None => refuse(ProvisionRefusal::Unprovisioned),
            },
        }
    }

    /// Adds an operator to these, and stores all.
    fn add(
        &mut self,
        provisioning: Provisioning,
        mut operators: Operators,
        operator: Operator,
        state: State,
    ) -> Option<Response> {
        if let Err(error) = operators.add(operator) {
            return refuse(error.into());
        }
        let owned = Some((provisioning, operators));
        if state.is_idle() && self.loaded.is_ok() && self.owned == owned {
            // A repeated request: the answer to the first was lost, or power went before it.
            let erased = self.finish_erasure();
            return respond(&done_or_storage(erased));
        }
        self.change(owned, state)
    }

    /// Erases a former key that is still stored because power went while it was replaced. Takes
    /// seconds when there is one; call it while the motors coast.
    ///
    /// # Errors
    /// When the former key may still be stored.
    pub fn finish_erasure(&mut self) -> Result<(), SaveError> {
        self.store.sweep().map_err(|_| SaveError)
    }

    /// Stores first, and changes only when that worked. What is there already is stored anew: a key that is to go may lie
    /// in flash though the robot does not know it, because power went while it was given.
    fn change(&mut self, owned: Option<Owned>, state: State) -> Option<Response> {
        if !state.is_idle() {
            return refuse(ProvisionRefusal::Driving);
        }
        if owned.as_ref().is_some_and(|owned| !is_usable(owned)) {
            return refuse(ProvisionRefusal::Malformed);
        }
        let changes = self.loaded.is_err() || self.owned != owned;
        let saved = save(&mut self.store, &owned);
        // A store that could write but not erase keeps the new one.
        if saved.is_err() && load(&mut self.store).as_ref() != Ok(&owned) {
            return respond(&done_or_storage(saved));
        }
        self.owned = owned;
        self.loaded = Ok(());
        respond(&done_or_storage(saved)).map(|response| Response { changed: changes, ..response })
    }
}

impl<S> fmt::Debug for Provisioner<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Provisioner").field("owned", &self.owned).finish_non_exhaustive()
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

fn refuse(refusal: ProvisionRefusal) -> Option<Response> {
    respond(&Answer::Refused(refusal))
}

fn is_usable((provisioning, operators): &Owned) -> bool {
    let has_keys = operators.iter().all(Operator::has_key);
    provisioning.check().is_ok() && operators.iter().len() > 0 && has_keys
}

fn load<S: SettingsStore>(store: &mut S) -> Result<Option<Owned>, LoadError> {
    let mut buffer = Zeroizing::new([0; STORED_LENGTH]);
    // Stored while the robot has an owner: who; else that there is none.
    let owned = stored::load::<Option<Owned>>(store, FORMAT_VERSION, &mut *buffer)?.flatten();
    if owned.as_ref().is_none_or(is_usable) { Ok(owned) } else { Err(LoadError::Damaged) }
}

fn save<S: SettingsStore>(store: &mut S, owned: &Option<Owned>) -> Result<(), SaveError> {
    let mut buffer = Zeroizing::new([0; STORED_LENGTH]);
    let bytes = stored::encode(FORMAT_VERSION, owned, &mut *buffer)?;
    store.save_and_sweep(bytes).map_err(|_| SaveError)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;
    use flix_protocol::session::Key;
    use std::format;

    const ADDRESS: [u8; 6] = [0xf4, 0x12, 0xfa, 0x00, 0x0a, 0xb3];

    #[derive(Default)]
    struct Memory {
        bytes: Option<std::vec::Vec<u8>>,
        is_worn: bool,
        writes: usize,
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
            self.writes += 1;
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
    const OTHER_KEY: [u8; 32] = *b"ONE KEY MORE, GIVEN TO AN OTHER.";
    const NETWORK: NetworkState = NetworkState::NoAddress { seconds: 7 };

    struct Listening;

    impl Radio for Listening {
        fn network(&self) -> NetworkState {
            NETWORK
        }

        fn scan(&self, _number: u8, _from: u8) -> Answer {
            Answer::Networks(None)
        }
    }

    fn mine() -> Provisioning {
        Provisioning::new("daisy", "workshop", "correct horse", None).unwrap()
    }

    fn operator(name: &str, key: [u8; 32]) -> Operator {
        Operator::new(name.parse().unwrap(), &Key::new(key))
    }

    fn owner() -> Operator {
        operator("owner", KEY)
    }

    fn robot(memory: &mut Memory) -> Provisioner<&mut Memory> {
        Provisioner::new(memory, DENGFOC_V3_01.hardware, ADDRESS)
    }

    /// Sends bytes to the robot and reads its answers as the computer would.
    fn exchange<S: SettingsStore>(
        robot: &mut Provisioner<S>,
        bytes: &[u8],
        state: State,
    ) -> std::vec::Vec<Answer> {
        let mut reader = FrameReader::new();
        let responses: std::vec::Vec<_> =
            bytes.iter().filter_map(|byte| robot.receive(*byte, state, &Listening)).collect();
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
        let answer = ask(&mut robot(memory), &Request::Provision(mine(), owner()), State::Disarmed);
        assert_eq!(answer, Answer::Done);
    }

    fn holds(bytes: &[u8], key: [u8; 32]) -> bool {
        bytes.windows(8).any(|window| key.windows(8).any(|part| part == window))
    }

    fn holds_key(bytes: &[u8]) -> bool {
        holds(bytes, KEY)
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
    fn a_robot_with_a_network_states_how_far_it_is() {
        let mut memory = Memory::default();
        let before = ask(&mut robot(&mut memory), &Request::Network, State::Running);
        provision(&mut memory);
        let after = ask(&mut robot(&mut memory), &Request::Network, State::Running);
        assert_eq!(before, Answer::Refused(ProvisionRefusal::Unprovisioned));
        assert_eq!(after, Answer::Network(NETWORK));
    }

    #[test]
    fn a_robot_listens_with_or_without_an_owner_while_no_motor_is_driven() {
        let mut memory = Memory::default();
        let scan = Request::Scan { number: 1, from: 0 };
        for _ in 0..2 {
            let idle = ask(&mut robot(&mut memory), &scan, State::Disarmed);
            assert_eq!(idle, Answer::Networks(None));
            let driven = ask(&mut robot(&mut memory), &scan, State::Running);
            assert_eq!(driven, Answer::Refused(ProvisionRefusal::Driving));
            provision(&mut memory);
        }
    }

    #[test]
    fn a_robot_proves_the_key_that_it_has_in_every_state() {
        let mut memory = Memory::default();
        let request = Request::Prove([3; 16], Key::new(KEY).id());
        let before = ask(&mut robot(&mut memory), &request, State::Running);
        provision(&mut memory);
        let after = ask(&mut robot(&mut memory), &request, State::Running);
        assert_eq!(before, Answer::Proof(None));
        assert_eq!(after, Answer::Proof(Some(Key::new(KEY).prove(&[3; 16]))));
    }

    #[test]
    fn a_robot_that_was_given_no_name_is_called_by_its_hardware_address() {
        let mut memory = Memory::default();
        assert_eq!(robot(&mut memory).name(), "walker-0ab3");
        provision(&mut memory);
        let mut robot = robot(&mut memory);
        assert_eq!(robot.name(), mine().name());
        ask(&mut robot, &Request::Forget, State::Disarmed);
        assert_eq!(robot.name(), "walker-0ab3");
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
        for request in [
            Request::Provision(mine(), owner()),
            Request::Identify,
            Request::Prove([3; 16], Key::new(KEY).id()),
            Request::Operators,
            Request::Add(operator("bob", OTHER_KEY)),
        ] {
            for byte in write_frame(&request).unwrap().iter() {
                if let Some(response) = robot.receive(*byte, State::Disarmed, &Listening) {
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
        let answer = ask(&mut robot, &Request::Provision(mine(), owner()), State::Running);
        let refused = Answer::Refused(ProvisionRefusal::Driving);
        assert_eq!((answer, robot.provisioning()), (refused, None));
    }

    #[test]
    fn a_memory_that_fails_leaves_the_robot_as_it_was() {
        let mut memory = Memory { is_worn: true, ..Memory::default() };
        let mut robot = robot(&mut memory);
        let answer = ask(&mut robot, &Request::Provision(mine(), owner()), State::Disarmed);
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
    fn what_is_to_go_is_erased_though_the_robot_does_not_know_it() {
        let bob = Request::Revoke("bob".parse().unwrap());
        for (request, has_owner) in [(Request::Forget, false), (bob, true)] {
            let mut memory = Memory::default();
            if has_owner {
                provision(&mut memory);
            }
            memory.writes = 0;
            let mut robot = robot(&mut memory);
            let frame = write_frame(&request).unwrap();
            let responses =
                frame.iter().filter_map(|it| robot.receive(*it, State::Disarmed, &Listening));
            let changed: std::vec::Vec<_> = responses.map(|response| response.changed).collect();
            // It is the same robot as before, and does not start anew.
            assert_eq!((changed, memory.writes), (std::vec![false], 1), "{request:?}");
        }
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
        let answer =
            ask(&mut robot(&mut memory), &Request::Provision(mine(), owner()), State::Disarmed);
        assert_eq!(answer, Answer::Done);
    }

    /// A provisioned robot after these requests, which it takes; and its memory.
    fn after(requests: &[Request]) -> Memory {
        let mut memory = Memory::default();
        provision(&mut memory);
        for request in requests {
            let answer = ask(&mut robot(&mut memory), request, State::Disarmed);
            assert_eq!(answer, Answer::Done);
        }
        memory
    }

    fn names(memory: &mut Memory) -> std::vec::Vec<std::string::String> {
        let answer = ask(&mut robot(memory), &Request::Operators, State::Running);
        let Answer::Operators(names) = answer else { panic!("{answer:?}") };
        names.iter().map(|name| name.as_str().into()).collect()
    }

    #[test]
    fn operators_are_added_and_revoked_and_a_revoked_key_is_erased() {
        let add = Request::Add(operator("bob", OTHER_KEY));
        let revoke = Request::Revoke("bob".parse().unwrap());
        let mut memory = after(&[add.clone(), add.clone()]);
        assert!(holds(memory.bytes.as_ref().unwrap(), OTHER_KEY));
        assert_eq!(names(&mut memory), ["owner", "bob"]);
        let mut memory = after(&[add, revoke.clone(), revoke]);
        assert!(!holds(memory.bytes.as_ref().unwrap(), OTHER_KEY));
        assert_eq!(names(&mut memory), ["owner"]);
    }

    #[test]
    fn the_first_operator_can_be_revoked_but_not_the_last() {
        let add = Request::Add(operator("bob", OTHER_KEY));
        let mut memory = after(&[add, Request::Revoke("owner".parse().unwrap())]);
        assert!(!holds_key(memory.bytes.as_ref().unwrap()));
        let last = Request::Revoke("bob".parse().unwrap());
        let answer = ask(&mut robot(&mut memory), &last, State::Disarmed);
        assert_eq!(answer, Answer::Refused(ProvisionRefusal::Last));
        assert_eq!(names(&mut memory), ["bob"]);
    }

    #[test]
    fn what_cannot_be_added_is_refused_with_the_reason() {
        let refusal = |memory: &mut Memory, operator, state| {
            let answer = ask(&mut robot(memory), &Request::Add(operator), state);
            let Answer::Refused(refusal) = answer else { panic!("{answer:?}") };
            refusal
        };
        let bob = || operator("bob", OTHER_KEY);
        let mut empty = Memory::default();
        let found = refusal(&mut empty, bob(), State::Disarmed);
        assert_eq!(found, ProvisionRefusal::Unprovisioned);
        let others = (1..8).map(|n| Request::Add(operator(&format!("o{n}"), [n; 32])));
        let mut memory = after(&others.collect::<std::vec::Vec<_>>());
        for (operator, state, wanted) in [
            (bob(), State::Disarmed, ProvisionRefusal::Full),
            (operator("o1", OTHER_KEY), State::Disarmed, ProvisionRefusal::Taken),
            (operator("o9", [1; 32]), State::Running, ProvisionRefusal::Driving),
        ] {
            assert_eq!(refusal(&mut memory, operator, state), wanted);
        }
        let mut memory = after(&[]);
        let zeros = operator("bob", [0; 32]);
        assert_eq!(refusal(&mut memory, zeros, State::Disarmed), ProvisionRefusal::Malformed);
    }

    #[test]
    fn another_network_keeps_the_operators_and_another_key_erases_them() {
        let add = Request::Add(operator("bob", OTHER_KEY));
        let elsewhere = Provisioning::new("daisy", "elsewhere", "correct horse", None).unwrap();
        let keep =
            |key| Request::Keep(elsewhere.clone(), "anna".parse().unwrap(), Key::new(key).id());
        assert_eq!(names(&mut after(&[add.clone(), keep(KEY)])), ["anna", "bob"]);
        assert_eq!(names(&mut after(&[add.clone(), keep(OTHER_KEY)])), ["owner", "anna"]);
        let mut memory = after(core::slice::from_ref(&add));
        let answer = ask(&mut robot(&mut memory), &keep([5; 32]), State::Disarmed);
        assert_eq!(answer, Answer::Refused(ProvisionRefusal::Unknown));
        assert_eq!(robot(&mut memory).provisioning(), Some(&mine()));
        let sold = Request::Provision(elsewhere, operator("carla", [5; 32]));
        let mut memory = after(&[add, sold]);
        let bytes = memory.bytes.as_ref().unwrap();
        assert!(!holds_key(bytes) && !holds(bytes, OTHER_KEY));
        assert_eq!(names(&mut memory), ["carla"]);
    }

    #[test]
    fn each_operators_key_is_proved_and_no_other() {
        let mut memory = after(&[Request::Add(operator("bob", OTHER_KEY))]);
        for (key, is_known) in [(KEY, true), (OTHER_KEY, true), ([9; 32], false)] {
            let key = Key::new(key);
            let request = Request::Prove([3; 16], key.id());
            let answer = ask(&mut robot(&mut memory), &request, State::Running);
            assert_eq!(answer, Answer::Proof(is_known.then(|| key.prove(&[3; 16]))));
        }
    }

    #[test]
    fn the_most_operators_are_stored() {
        let others = (1..8).map(|n| Request::Add(operator(&format!("operator-{n:07}"), [n; 32])));
        let mut memory = after(&others.collect::<std::vec::Vec<_>>());
        assert_eq!(names(&mut memory).len(), 8);
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
