//! Soak test: hours of random commands, faults and link trouble in virtual time.
//!
//! Several robots run side by side, each with two operators who hold its key and one who does not. A scenario goes
//! in episodes: for some seconds chance commands, breaks the hardware, spoils network and clocks; then all is mended,
//! and the first operator has to get the robot shaking again. In every tick, [`Rule`]s are checked against the plant's truth.

mod memory;
mod scenario;
mod watch;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use rayon::prelude::*;
use serde::Serialize;

use crate::rig::bench::BenchError;
use memory::Memory;
use scenario::Scenario;
use watch::Account;
pub use watch::{RULES, Rule};

/// The process may grow by this between the first and the last quarter, bytes: a few pages of each allocator arena.
pub const GROWTH_LIMIT: u64 = 2 << 20;
/// Longest scenario of one robot: more than the 71.6 minutes in which 32 bits of microseconds come round. There are
/// at least two at a time.
const LONGEST_SCENARIO: Duration = Duration::from_secs(7_200);

/// Verdict of a soak test.
#[derive(Debug, Clone, Serialize)]
pub struct Verdict {
    /// The robots.
    pub seed: u64,
    /// Virtual time of all robots together.
    pub virtual_hours: f64,
    /// How many.
    pub robots: u64,
    /// Times that all was mended and the robot had to shake again.
    pub episodes: u64,
    /// Commands given.
    pub commands: u64,
    /// Times that networks or clocks changed.
    pub link_troubles: u64,
    /// Times that hardware broke.
    pub hardware_faults: u64,
    /// Restarts of the robot's software.
    pub restarts: u64,
    /// Longest time from when all was mended until the robot shook as commanded.
    pub longest_recovery_s: f64,
    /// Largest phase current while the hardware was sound.
    pub largest_current_a: f64,
    /// Times that each rule was broken.
    pub violations: BTreeMap<Rule, u64>,
    /// The first few, in words.
    pub examples: Vec<String>,
    /// Scenarios that ended in a panic.
    pub panics: u64,
    /// By how much the process grew from the first to the last quarter; none where the system does not report it.
    pub growth_bytes: Option<i64>,
    /// Whether no rule was broken, nothing panicked, and memory stayed flat.
    pub pass: bool,
}

/// Runs several robots for this virtual time in all. `done` is called after each virtual second.
///
/// # Errors
/// When a robot cannot be armed while all is well, or diverges.
pub fn measure(
    seed: u64,
    total: Duration,
    done: impl Fn(u64) + Sync,
) -> Result<Verdict, BenchError> {
    let robots = total.as_secs().div_ceil(LONGEST_SCENARIO.as_secs()).max(2);
    let length = total / robots as u32;
    let memory = Memory::new(total);
    let accounts: Vec<Option<Account>> = (0..robots)
        .into_par_iter()
        .map(|robot| {
            let scenario = || {
                Scenario::new(seed.wrapping_mul(1_000_003).wrapping_add(robot))?.run(
                    length,
                    &|| {
                        memory.look();
                        done(1);
                    },
                )
            };
            match catch_unwind(AssertUnwindSafe(scenario)) {
                Ok(account) => account.map(Some),
                Err(_) => Ok(None),
            }
        })
        .collect::<Result<_, BenchError>>()?;
    let panics = accounts.iter().filter(|account| account.is_none()).count() as u64;
    let mut sum = Account::default();
    for account in accounts.into_iter().flatten() {
        sum.add(account);
    }
    let growth_bytes = memory.growth();
    let is_flat = growth_bytes.is_none_or(|growth| growth <= GROWTH_LIMIT as i64);
    let pass = sum.violations == [0; RULES.len()] && panics == 0 && is_flat && sum.episodes > 0;
    Ok(Verdict {
        seed,
        virtual_hours: (length * robots as u32).as_secs_f64() / 3_600.0,
        robots,
        episodes: sum.episodes,
        commands: sum.commands,
        link_troubles: sum.link_troubles,
        hardware_faults: sum.hardware_faults,
        restarts: sum.restarts,
        longest_recovery_s: sum.longest_recovery.as_secs_f64(),
        largest_current_a: sum.largest_current,
        violations: RULES.into_iter().zip(sum.violations).collect(),
        examples: sum.examples,
        panics,
        growth_bytes,
        pass,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_robots_come_through_a_minute_of_trouble() {
        let verdict = measure(1, Duration::from_secs(60), |_| ()).unwrap();
        let broken: u64 = verdict.violations.values().sum();
        assert_eq!((broken, verdict.panics), (0, 0), "{:#?}", verdict.examples);
        assert!(verdict.hardware_faults > 10 && verdict.episodes > 1, "{verdict:?}");
    }
}
