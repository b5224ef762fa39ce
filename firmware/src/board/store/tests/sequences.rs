//! Sequences that are drawn: saves, keys that are given, changed and forgotten, by a store that begins empty or
//! full of noise; power goes in any of them and in the starts after them, sectors take nothing for a while,
//! cells fade or flicker.

use super::*;

/// A small generator of numbers.
struct Draw(u64);

impl Draw {
    fn below(&mut self, end: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % end
    }

    /// True once in so many.
    fn once_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    /// A share of an operation: evenly drawn from 0.1 % to 99.9 %, or one of [`SHARES`].
    fn share(&mut self) -> f64 {
        if self.once_in(2) {
            SHARES[self.below(SHARES.len())]
        } else {
            (1 + self.below(999)) as f64 / 1_000.0
        }
    }
}

/// A key that no other sequence of bytes in flash is like.
fn key_number(number: usize) -> Vec<u8> {
    (number as u32).to_le_bytes().iter().flat_map(|byte| [0x3C ^ byte; 6]).collect()
}

const ROUNDS: usize = 30;
/// Chances with which cells fade before a start.
const FADES: [f64; 4] = [0.0, 0.01, 0.5, 1.0];

/// A robot's flash, and what may be in it.
struct Robot {
    draw: Draw,
    flash: Flash,
    region: Range<u32>,
    /// Since the last success, anything that was tried.
    keys: Vec<Option<Vec<u8>>>,
    settings: Vec<Option<Vec<u8>>>,
    tried: Vec<Vec<u8>>,
    were_in_force: Vec<Vec<u8>>,
}

impl Robot {
    fn new(seed: u64, sectors: usize) -> Self {
        let mut draw = Draw(seed.wrapping_mul(977) + sectors as u64);
        let mut robot = Self {
            flash: Flash::seeded(seed),
            region: 0..(SECTOR * sectors) as u32,
            keys: vec![None],
            settings: vec![None],
            tried: Vec::new(),
            were_in_force: Vec::new(),
            draw: Draw(0),
        };
        if draw.once_in(4) {
            robot.flash.fill_with_noise();
        }
        robot.flash.flickers = draw.once_in(3);
        Self { draw, ..robot }
    }

    fn store(&mut self) -> FlashStore<Flash> {
        FlashStore::new(self.flash.clone(), self.region.clone())
    }

    /// Draws when power goes in `work`, how, and which sectors take nothing.
    fn draw_faults(&mut self, work: impl FnOnce(&mut FlashStore<Flash>) -> Result<(), StoreError>) {
        let mut whole = self.store();
        whole.flash.operations.clear();
        let _ = work(&mut whole);
        let operations = whole.flash.operations;
        let Self { draw, flash, .. } = self;
        flash.share = draw.share();
        flash.rise = RISES[draw.below(RISES.len())];
        // Everything is decided in an erasure, in the mark before one, and in the last mark.
        let is_erased = |at: usize| operations.get(at).is_none_or(|is_erasure| *is_erasure);
        let decisive: Vec<usize> =
            (0..operations.len()).filter(|at| is_erased(*at) || is_erased(at + 1)).collect();
        flash.power = match (draw.below(3), operations.len()) {
            (0, _) | (_, 0) => usize::MAX,
            (1, all) => 1 + draw.below(all),
            _ => 1 + decisive[draw.below(decisive.len())],
        };
        flash.protection = [Protection::None; SECTORS];
        if draw.once_in(8) {
            let kind = [Protection::Silent, Protection::Reported][draw.below(2)];
            match draw.below(SECTORS + 1) {
                SECTORS => flash.protection = [kind; SECTORS],
                sector => flash.protection[sector] = kind,
            }
        }
    }

    /// Saves settings, or gives, changes or forgets the key.
    fn change(&mut self, round: usize, what: &str) {
        let is_key = self.draw.once_in(2);
        let bytes = match (is_key, self.draw.once_in(4)) {
            (true, true) => Vec::new(),
            (true, false) => key_number(round),
            (false, _) => vec![round as u8; 1 + self.draw.below(500)],
        };
        let save = |store: &mut FlashStore<Flash>| match is_key {
            true => store.save_and_sweep(PROVISIONING, &bytes),
            false => store.save(SETTINGS, &bytes),
        };
        self.draw_faults(save);
        let mut store = self.store();
        let outcome = save(&mut store);
        let key = if is_key { PROVISIONING } else { SETTINGS };
        let admitted = if is_key { &mut self.keys } else { &mut self.settings };
        if outcome.is_ok() {
            assert_eq!(loaded(&mut store, key).as_ref(), Some(&bytes), "{what}");
            admitted.clear();
        }
        admitted.push(Some(bytes.clone()));
        if is_key && !bytes.is_empty() {
            self.tried.push(bytes);
        }
        self.flash = store.flash;
    }

    /// Starts the robot, and has a look.
    fn start(&mut self, what: &str) {
        self.flash.start(FADES[self.draw.below(FADES.len())]);
        self.draw_faults(FlashStore::sweep);
        let mut store = self.store();
        let swept = store.sweep();
        let found = loaded(&mut store, PROVISIONING);
        assert!(self.keys.contains(&found), "{what}: {found:?} of {:?}", self.keys);
        assert!(self.settings.contains(&loaded(&mut store, SETTINGS)), "{what}");
        let is_other = |key: &&Vec<u8>| Some(*key) != found.as_ref();
        let takes_all = store.flash.protection == [Protection::None; SECTORS];
        if swept.is_ok() && takes_all {
            for former in self.were_in_force.iter().filter(is_other) {
                assert!(!store.flash.may_hold(former), "{what}: {former:?} is in flash");
            }
            for other in self.tried.iter().filter(is_other) {
                assert!(!store.flash.holds(other), "{what}: {other:?}, which was never in force");
            }
            if !store.flash.flickers {
                self.keys = vec![found.clone()];
            }
        }
        self.were_in_force.extend(found.filter(|key| !key.is_empty()));
        self.flash = store.flash;
    }
}

#[test]
fn cuts_upon_cuts_lose_nothing_and_leave_no_former_key_in_regions_of_two_sectors_and_more() {
    for seed in 0..SEEDS {
        for sectors in [2, 3, SECTORS] {
            let mut robot = Robot::new(seed, sectors);
            for round in 1..=ROUNDS {
                let what = std::format!("{sectors} sectors, seed {seed}, round {round}");
                robot.change(round, &what);
                for _ in 0..=robot.draw.below(3) {
                    robot.start(&what);
                }
            }
        }
    }
}

/// Sequences that are drawn for each number of sectors.
const SEEDS: u64 = 24;
