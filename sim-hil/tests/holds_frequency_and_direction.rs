//! f within 0.05 Hz and theta within 1 degree (root mean square), the line of force within 1 degree and 2 %
//! across: at every commanded pair, on a fixed and on a yielding base, by the plant's truth.

use flix_sim::reliability::accuracy::hold_all_directions;
use flix_sim::rig::bench::{BASES, Base, FREQUENCIES, Subject};
use rayon::prelude::*;

fn failures(seed: u64, bases: &[Base], frequencies: &[f64]) -> Vec<String> {
    let runs: Vec<_> =
        bases.iter().flat_map(|base| frequencies.iter().map(move |f| (*base, *f))).collect();
    runs.par_iter()
        .flat_map(|&(base, frequency)| {
            match hold_all_directions(&Subject::of_seed(seed), base, frequency) {
                Ok(held) => held
                    .into_iter()
                    .filter(|figures| !figures.passes())
                    .map(|figures| format!("{figures:?}"))
                    .collect::<Vec<_>>(),
                Err(error) => vec![format!("{base} base, {frequency} Hz: {error}")],
            }
        })
        .collect()
}

#[test]
fn holds_every_pair_on_both_bases() {
    assert_eq!(failures(1, &BASES, &FREQUENCIES), Vec::<String>::new());
}

#[test]
fn holds_the_fastest_and_slowest_pairs_of_other_robots_too() {
    for seed in [7, 42] {
        assert_eq!(failures(seed, &[Base::Free], &[-35.0, 10.0]), Vec::<String>::new());
    }
}
