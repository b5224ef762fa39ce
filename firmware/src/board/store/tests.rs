use std::vec;
use std::vec::Vec;

use super::model::{Flash, Protection, Rise, SECTOR, SECTORS};
use super::*;

mod sequences;

const OLD: &[u8] = b"the old key, which somebody knows";
const NEW: &[u8] = b"the new key, which nobody knows";
const SETTINGS: Key = 0;
const PROVISIONING: Key = 1;

/// Shares of an operation that are done when power goes; at last all cells read well.
const SHARES: [f64; 8] = [0.01, 0.1, 0.3, 0.5, 0.9, 0.99, 0.999, 1.0];
/// How a sector rises.
const RISES: [Rise; 3] = [Rise::Even, Rise::FromStart, Rise::FromEnd];
/// Chances with which a cell fades whose last change was cut: a few, half, all of them.
const FADINGS: [f64; 3] = [0.01, 0.5, 1.0];

fn store(flash: Flash) -> FlashStore<Flash> {
    FlashStore::new(flash, 0..(SECTOR * SECTORS) as u32)
}

fn loaded(store: &mut FlashStore<Flash>, key: Key) -> Option<Vec<u8>> {
    let mut buffer = [0; 512];
    let length = store.load(key, &mut buffer).unwrap()?;
    Some(buffer[..length].to_vec())
}

/// Starts the chip: cells fade, entries are read, and the erasure of former keys goes on.
fn started(mut flash: Flash, fading: f64) -> FlashStore<Flash> {
    flash.start(fading);
    let mut store = store(flash);
    store.sweep().unwrap();
    store
}

/// Settings saved so often, then the old key between two of them.
fn used(saves: usize) -> FlashStore<Flash> {
    let mut store = store(Flash::new());
    for _ in 0..saves {
        store.save(SETTINGS, &[0xAA; 400]).unwrap();
    }
    store.save(PROVISIONING, OLD).unwrap();
    store.save(SETTINGS, &[0xBB; 400]).unwrap();
    store
}

#[test]
fn empty_flash_holds_nothing() {
    assert_eq!(loaded(&mut store(Flash::new()), 0), None);
}

#[test]
fn the_newest_bytes_come_back_after_many_rounds_of_the_region() {
    let mut store = store(Flash::new());
    store.save(1, b"name and key").unwrap();
    for round in 0..200_u16 {
        store.save(0, &round.to_le_bytes().repeat(150)).unwrap();
    }
    assert_eq!(loaded(&mut store, 0), Some(199_u16.to_le_bytes().repeat(150)));
    assert_eq!(loaded(&mut store, 1), Some(b"name and key".to_vec()));
}

#[test]
fn power_may_go_at_any_word_and_old_or_new_remains() {
    let mut before = store(Flash::new());
    for _ in 0..57 {
        before.save(0, &[0xAA; 400]).unwrap();
    }
    let mut power = 0;
    loop {
        let mut flash = before.flash.clone();
        flash.power = power;
        let mut interrupted = store(flash);
        let finished = (0..4).all(|_| interrupted.save(0, &[0x55; 400]).is_ok());
        let mut flash = interrupted.flash;
        flash.power = usize::MAX;
        let found = loaded(&mut store(flash), 0).unwrap();
        assert!(found == [0xAA; 400] || found == [0x55; 400], "power for {power} words");
        if finished {
            assert_eq!(found, [0x55; 400]);
            break;
        }
        power += 1;
    }
    assert!(power > 400, "the test never wrote");
}

#[test]
fn one_damaged_word_costs_nothing_that_is_kept() {
    for saves in 0..SECTORS {
        let mut saved = used(saves);
        saved.save_and_sweep(PROVISIONING, NEW).unwrap();
        let newest = saved.newest().unwrap().unwrap().sector as usize * SECTOR;
        for at in (newest..newest + SECTOR).step_by(4) {
            for damage in [0x00, 0x7F, 0xFF] {
                let mut flash = saved.flash.clone();
                flash.cells[at..at + 4].fill(damage);
                let mut store = store(flash);
                assert_eq!(loaded(&mut store, PROVISIONING).as_deref(), Some(NEW), "{at}");
                assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]), "{at}");
            }
        }
        // After the next start there are two again.
        saved.flash.cells[newest] = 0;
        let mut store = started(saved.flash, 0.0);
        let newest = store.newest().unwrap().unwrap().sector as usize * SECTOR;
        store.flash.cells[newest] = 0;
        assert_eq!(loaded(&mut store, PROVISIONING).as_deref(), Some(NEW));
    }
}

#[test]
fn a_replaced_key_is_nowhere_in_flash_wherever_it_was() {
    for saves in 0..70 {
        let mut store = used(saves);
        assert!(store.flash.holds(OLD));
        store.save_and_sweep(PROVISIONING, NEW).unwrap();
        assert!(!store.flash.holds(OLD), "after {saves} saves");
        assert_eq!(loaded(&mut store, PROVISIONING).as_deref(), Some(NEW));
        assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]));
    }
}

/// Cuts `work` in each erasure, and in the writes before, after and in every `stride`-th, then hands on what is left in
/// flash, whether the work was acknowledged, and the operation.
fn cut(
    before: &Flash,
    (share, seed, stride): (f64, u64, usize),
    work: impl Fn(&mut Flash) -> bool,
    mut check: impl FnMut(Flash, bool, usize),
) {
    let mut whole = before.clone();
    whole.operations.clear();
    assert!(work(&mut whole), "not done without a cut");
    let operations = core::mem::take(&mut whole.operations);
    assert!(operations.contains(&true), "nothing was erased");
    let is_erasure = |at: usize| operations.get(at).is_some_and(|is_erasure| *is_erasure);
    for at in 0..operations.len() {
        let is_near = (at.saturating_sub(1)..at + 8).any(is_erasure);
        if !is_near && at % stride != 0 && at + 8 < operations.len() {
            continue;
        }
        let rises = if is_erasure(at) { &RISES[..] } else { &RISES[..1] };
        for rise in rises {
            let mut flash = before.with_seed(seed.wrapping_add(at as u64));
            (flash.power, flash.share, flash.rise) = (at + 1, share, *rise);
            let acknowledged = work(&mut flash);
            check(flash, acknowledged, at);
        }
    }
    check(whole, true, operations.len());
}

/// Two starts after a cut, a save, and two more: old or new, then what was saved, and no former key from the first
/// start on.
fn check_two_starts(flash: Flash, acknowledged: bool, fading: f64, what: &str) {
    let mut flash = flash;
    for start in 1..=2 {
        let mut store = started(flash, fading);
        let key = loaded(&mut store, PROVISIONING).unwrap_or_default();
        assert!(
            key == NEW || key == OLD && !acknowledged,
            "start {start} after {what}: {key:?} {acknowledged}"
        );
        assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]), "start {start} {what}");
        assert_eq!(store.flash.holds(OLD), key == OLD, "start {start} after {what}");
        flash = store.flash;
    }
    let mut store = store(flash);
    store.save(SETTINGS, &[0xCC; 400]).unwrap();
    flash = store.flash;
    for start in 3..=4 {
        let mut store = started(flash, fading);
        let key = loaded(&mut store, PROVISIONING).unwrap_or_default();
        assert!(
            key == NEW || key == OLD && !acknowledged,
            "start {start} after {what}: {key:?} {acknowledged}"
        );
        assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xCC; 400]), "start {start} {what}");
        flash = store.flash;
    }
}

#[test]
fn a_key_that_is_replaced_is_old_or_new_after_any_torn_erasure_or_write_and_two_starts() {
    let before = used(40).flash;
    for (seed, share) in (1..).zip(SHARES) {
        for fading in FADINGS {
            cut(
                &before,
                (share, seed, 23),
                |flash| {
                    let mut store = store(flash.clone());
                    let finished = store.save_and_sweep(PROVISIONING, NEW).is_ok();
                    *flash = store.flash;
                    finished
                },
                |flash, acknowledged, power| {
                    let what = std::format!("{share} of operation {power}, fading {fading}");
                    check_two_starts(flash, acknowledged, fading, &what);
                },
            );
        }
    }
}

#[test]
fn settings_that_are_saved_are_old_or_new_after_any_torn_erasure_or_write_and_two_starts() {
    let key_of = |store: &mut FlashStore<Flash>| loaded(store, PROVISIONING);
    for (seed, share) in (1..).zip(SHARES) {
        for fading in FADINGS {
            let before = used(8 + seed as usize).flash;
            cut(
                &before,
                (share, seed, 401),
                |flash| {
                    let mut store = store(flash.clone());
                    let finished = (0..12).all(|_| store.save(SETTINGS, &[0xCC; 400]).is_ok());
                    *flash = store.flash;
                    finished
                },
                |flash, acknowledged, power| {
                    let what = std::format!("{share} of operation {power}, fading {fading}");
                    // Cells may begin to fade only once they were written again.
                    for early in [0.0, fading] {
                        let mut flash = flash.clone();
                        for _ in 0..2 {
                            let mut store = started(flash, early);
                            let found = loaded(&mut store, SETTINGS).unwrap_or_default();
                            let is_right = found == [0xCC; 400] || found == [0xBB; 400];
                            assert!(is_right && (!acknowledged || found[0] == 0xCC), "{what}");
                            assert_eq!(key_of(&mut store).as_deref(), Some(OLD), "{what}");
                            flash = store.flash;
                        }
                        let mut store = store(flash);
                        store.save(SETTINGS, &[0xDD; 400]).unwrap();
                        for _ in 0..2 {
                            store = started(store.flash, fading);
                            assert_eq!(
                                loaded(&mut store, SETTINGS),
                                Some(vec![0xDD; 400]),
                                "{what}"
                            );
                            assert_eq!(key_of(&mut store).as_deref(), Some(OLD), "{what}");
                        }
                    }
                },
            );
        }
    }
}

#[test]
fn a_swept_store_is_not_swept_again() {
    let mut store = used(3);
    store.save_and_sweep(PROVISIONING, NEW).unwrap();
    store.flash.power = 0;
    assert_eq!(store.sweep(), Ok(()));
}

#[test]
fn an_entry_that_does_not_fit_is_refused_and_the_old_one_stays() {
    let mut store = store(Flash::new());
    store.save(0, b"old").unwrap();
    assert_eq!(store.save(0, &[0; 2 * LONGEST]), Err(StoreError::TooLong));
    assert_eq!(store.load(0, &mut [0; 2]), Err(StoreError::TooLong));
    assert_eq!(loaded(&mut store, 0), Some(b"old".to_vec()));
}

#[test]
fn rubbish_in_flash_can_be_written_over() {
    let mut flash = Flash::new();
    flash.fill_with_noise();
    let mut store = store(flash);
    store.save(0, b"new").unwrap();
    assert_eq!(loaded(&mut store, 0), Some(b"new".to_vec()));
}

#[test]
fn a_region_of_one_sector_is_refused() {
    let mut store = FlashStore::new(Flash::new(), 0..SECTOR as u32);
    assert_eq!(store.save(0, b"x"), Err(StoreError::Full));
}

/// What a save and a sweep report, and what is there after the next start.
fn changed(flash: Flash) -> (Result<(), StoreError>, FlashStore<Flash>) {
    let mut store = store(flash);
    let outcome = store.save_and_sweep(PROVISIONING, NEW);
    let mut flash = store.flash;
    flash.failing_read = None;
    (outcome, self::store(flash))
}

#[test]
fn flash_that_takes_nothing_is_an_error_and_the_old_stays() {
    for protection in [Protection::Silent, Protection::Reported] {
        for before in [Flash::new(), used(3).flash] {
            let mut flash = before.clone();
            flash.protection = [protection; SECTORS];
            let had = loaded(&mut store(before), PROVISIONING);
            let (outcome, mut store) = changed(flash);
            assert!(outcome.is_err(), "{protection:?}");
            assert_eq!(loaded(&mut store, PROVISIONING), had, "{protection:?}");
            assert!(store.save(SETTINGS, b"new").is_err(), "{protection:?}");
            if had.is_some() {
                assert!(store.sweep().is_err(), "{protection:?}: the old key is there");
            }
        }
    }
}

#[test]
fn a_protected_sector_costs_nothing_but_an_old_key_in_it_is_reported() {
    for protection in [Protection::Silent, Protection::Reported] {
        for sector in 0..SECTORS {
            for before in [used(3).flash, used(4).flash, used(7).flash] {
                let mut flash = before;
                flash.protection[sector] = protection;
                let from = sector * SECTOR;
                let is_blank = flash.cells[from..][..SECTOR].iter().all(|cell| *cell == 0xFF);
                let (outcome, mut store) = changed(flash);
                assert_eq!(loaded(&mut store, PROVISIONING).as_deref(), Some(NEW), "{sector}");
                assert_eq!(outcome.is_ok(), is_blank, "{protection:?} {sector}");
                assert_eq!(outcome.is_ok(), !store.flash.holds(OLD) && store.sweep().is_ok());
                store.save(SETTINGS, b"more").unwrap();
                assert_eq!(loaded(&mut store, SETTINGS).as_deref(), Some(&b"more"[..]));
            }
        }
    }
}

#[test]
fn flash_that_takes_some_bits_keeps_the_old_or_the_new_and_reports_no_success_without_the_new() {
    for seed in 0..200 {
        for stuck in [0, 1, 4, 7, 31, 255] {
            let mut flash = used(seed % 9).flash.with_seed(seed as u64);
            for _ in 0..=stuck * stuck {
                flash.stick();
            }
            let (outcome, mut store) = changed(flash);
            let key = loaded(&mut store, PROVISIONING).unwrap_or_default();
            assert!(
                key == NEW || key == OLD && outcome.is_err(),
                "seed {seed}, {stuck} stuck: {key:?} {outcome:?}"
            );
            assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]), "seed {seed}");
            let holds = store.flash.holds(OLD);
            assert!(!holds || outcome.is_err(), "seed {seed}, {stuck} stuck");
        }
    }
}

#[test]
fn reading_that_fails_once_is_tried_again() {
    for read in 0..400 {
        let mut flash = used(5).flash;
        flash.failing_read = Some(read);
        let (outcome, mut store) = changed(flash);
        assert_eq!(outcome, Ok(()), "read {read}");
        assert_eq!(loaded(&mut store, PROVISIONING).as_deref(), Some(NEW), "read {read}");
        store.flash.failing_read = Some(read % 40);
        assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]), "read {read}");
    }
}

#[test]
fn reading_that_fails_for_ever_is_an_error_and_nothing_is_lost() {
    for read in 0.. {
        let mut flash = used(5).flash;
        (flash.failing_read, flash.fails_for_ever) = (Some(read), true);
        let (outcome, mut store) = changed(flash);
        if outcome.is_ok() {
            assert!(read > 200, "nothing was read");
            break;
        }
        assert_eq!(outcome, Err(StoreError::Flash), "read {read}");
        let key = loaded(&mut store, PROVISIONING).unwrap_or_default();
        assert!(key == OLD || key == NEW, "read {read}");
        assert_eq!(loaded(&mut store, SETTINGS), Some(vec![0xBB; 400]), "read {read}");
    }
}

#[test]
fn all_entries_of_a_sector_fit_and_one_more_is_refused() {
    let mut store = store(Flash::new());
    for key in 0..3 {
        store.save(key, &[key; 1_000]).unwrap();
    }
    store.save(3, &[3; 1_000]).unwrap();
    assert_eq!(store.save(4, &[4; 60]), Err(StoreError::Full));
    let mut buffer = [0; 1_000];
    for key in 0..4 {
        assert_eq!(store.load(key, &mut buffer), Ok(Some(1_000)));
        assert_eq!(buffer, [key; 1_000]);
    }
}
