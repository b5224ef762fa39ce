//! Breadth-first search over all histories, with the shortest trace to a state that breaks an invariant. Liveness (I3) is: from
//! every state of a run without further halts there is a way to its goal.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hash, Hasher};

use crate::goal::Goal;
use crate::invariant::Invariant;
use crate::model::Model;
use crate::step::Step;
use crate::successors::steps;
use crate::world::World;

/// Number of states after which a search gives up, because it would need more than 6 GB.
pub const MOST_STATES: usize = 20_000_000;

/// How a search ended.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// States explored.
    pub states: usize,
    /// States of runs without further halts, among them.
    pub calm_states: usize,
    /// How many states reached each goal.
    pub goals: [usize; Goal::ALL.len()],
    /// The end.
    pub end: End,
}

/// The end of a search.
#[derive(Clone, Debug)]
pub enum End {
    /// All invariants hold.
    Holds,
    /// An invariant breaks, by the shortest history that breaks it.
    Breaks(Invariant, Vec<(Step, World)>),
    /// There are more states than [`MOST_STATES`].
    TooManyStates,
}

/// Explores every state that can be reached.
pub fn search(model: &Model) -> Verdict {
    let mut explored = Explored::new();
    let mut found = Vec::new();
    let mut place = 0;
    while place < explored.worlds.len() {
        let world = explored.worlds[place];
        if let Some(invariant) = world.broken {
            return explored.verdict(End::Breaks(invariant, explored.trace(model, place)));
        }
        if explored.worlds.len() > MOST_STATES {
            return explored.verdict(End::TooManyStates);
        }
        found.clear();
        if !is_at_goal(&world) {
            steps(model, &world, &mut |_, next| found.push(next));
        }
        for next in &found {
            explored.add(next, place, world.goal.is_some());
        }
        place += 1;
    }
    explored.known = HashMap::default();
    match explored.stuck() {
        Some(place) => explored.verdict(End::Breaks(Invariant::I3, explored.trace(model, place))),
        None => explored.verdict(End::Holds),
    }
}

fn is_at_goal(world: &World) -> bool {
    world.goal.is_some_and(|goal| goal.is_reached(world))
}

/// The states explored so far.
struct Explored {
    known: HashMap<u128, u32, BuildHasherDefault<Identity>>,
    worlds: Vec<World>,
    /// For each state, the state from which it was found first.
    parents: Vec<u32>,
    /// Steps of runs without further halts: (after, before).
    calm: Vec<(u32, u32)>,
}

impl Explored {
    fn new() -> Self {
        let first = World::default();
        let mut known = HashMap::default();
        known.insert(fingerprint(&first), 0);
        Self { known, worlds: vec![first], parents: vec![0], calm: Vec::new() }
    }

    fn add(&mut self, next: &World, before: usize, is_calm: bool) {
        let Self { known, worlds, parents, calm } = self;
        let id = *known.entry(fingerprint(next)).or_insert_with(|| {
            worlds.push(*next);
            parents.push(before as u32);
            (worlds.len() - 1) as u32
        });
        if is_calm {
            calm.push((id, before as u32));
        }
    }

    /// Returns a state of a calm run from which no way leads to its goal.
    fn stuck(&mut self) -> Option<usize> {
        self.calm.sort_unstable();
        let mut reaches: Vec<bool> = self.worlds.iter().map(is_at_goal).collect();
        let mut todo: Vec<u32> =
            (0..reaches.len() as u32).filter(|it| reaches[*it as usize]).collect();
        while let Some(goal) = todo.pop() {
            let from = self.calm.partition_point(|(after, _)| *after < goal);
            for (_, before) in self.calm[from..].iter().take_while(|(after, _)| *after == goal) {
                if !std::mem::replace(&mut reaches[*before as usize], true) {
                    todo.push(*before);
                }
            }
        }
        (0..reaches.len()).find(|it| self.worlds[*it].goal.is_some() && !reaches[*it])
    }

    /// Returns the shortest history that leads to a state.
    fn trace(&self, model: &Model, mut place: usize) -> Vec<(Step, World)> {
        let mut trace = Vec::new();
        while place != 0 {
            let parent = self.parents[place] as usize;
            let after = self.worlds[place];
            let mut label = None;
            steps(model, &self.worlds[parent], &mut |step, next| {
                if next == after && label.is_none() {
                    label = Some(step);
                }
            });
            trace.extend(label.map(|step| (step, after)));
            place = parent;
        }
        trace.reverse();
        trace
    }

    fn verdict(&self, end: End) -> Verdict {
        let mut goals = [0; Goal::ALL.len()];
        for goal in self.worlds.iter().filter(|it| is_at_goal(it)).filter_map(|it| it.goal) {
            goals[goal as usize] += 1;
        }
        let calm_states = self.worlds.iter().filter(|it| it.goal.is_some()).count();
        Verdict { states: self.worlds.len(), calm_states, goals, end }
    }
}

/// Returns 128 bits of a state. Among 20 million states two collide with a probability of about 1e-24.
fn fingerprint(world: &World) -> u128 {
    let mut mix = Mix::default();
    world.hash(&mut mix);
    mix.fingerprint()
}

/// Collects a state byte by byte, so that enums and flags take one byte each, and mixes eight bytes at a time.
#[derive(Default)]
struct Mix {
    word: u64,
    bytes: u32,
    a: u64,
    b: u64,
}

impl Mix {
    fn push(&mut self, byte: u8) {
        self.word = self.word << 8 | u64::from(byte);
        self.bytes += 1;
        if self.bytes.is_multiple_of(8) {
            self.mix();
        }
    }

    fn mix(&mut self) {
        self.a = fold(self.a ^ self.word ^ 0x9E37_79B9_7F4A_7C15, 0xD6E8_FEB8_6659_FD93)
            .wrapping_add(self.word);
        self.b = fold(self.b ^ self.word ^ 0xC2B2_AE3D_27D4_EB4F, 0xA076_1D64_78BD_642F)
            ^ self.a.rotate_left(23);
        self.word = 0;
    }

    fn fingerprint(mut self) -> u128 {
        self.mix();
        self.mix();
        u128::from(self.a) << 64 | u128::from(self.b)
    }
}

fn fold(a: u64, b: u64) -> u64 {
    let product = u128::from(a) * u128::from(b);
    product as u64 ^ (product >> 64) as u64
}

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.a ^ self.b
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|it| self.push(*it));
    }

    fn write_isize(&mut self, value: isize) {
        self.push(value as u8);
    }

    fn write_usize(&mut self, value: usize) {
        self.push(value as u8);
    }
}

/// Hashes fingerprints by themselves.
#[derive(Default)]
struct Identity(u64);

impl Hasher for Identity {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|it| self.0 = self.0 << 8 | u64::from(*it));
    }

    fn write_u128(&mut self, value: u128) {
        self.0 = value as u64 ^ (value >> 64) as u64;
    }
}
