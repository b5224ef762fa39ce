//! 10 to 35 Hz, +30 to -30 Hz, and theta 0 to 90 degrees at 30 Hz: within 0.2 Hz and 3 degrees in 0.5 s, no phase
//! current ever above its limit.

use flix_sim::reliability::accuracy::{STEPS, measure_step};
use flix_sim::rig::bench::{BASES, Subject};

#[test]
fn every_step_settles_in_time_and_within_the_current_limit() {
    for seed in [1, 7, 19, 439] {
        for base in BASES {
            for step in STEPS {
                let figures = measure_step(&Subject::of_seed(seed), base, step).unwrap();
                assert!(figures.passes(), "seed {seed}: {figures:?}");
            }
        }
    }
}
