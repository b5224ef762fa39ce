//! Soak test: hours of random commands, faults and link trouble in virtual time.
//!
//! Several robots run side by side, each with two operators who hold its key and one who does not. A scenario goes
//! in episodes: for some seconds chance commands, breaks the hardware, spoils network and clocks; then all is mended,
//! and the first operator has to get the robot shaking again. In every tick, [`Rule`]s are checked against the plant's truth.

mod memory;
mod scenario;
mod watch;

use std::time::Duration;

use serde_json::json;

use crate::rig::bench::BenchError;
use crate::study::{Column, Limit, Measurement};
use scenario::Scenario;
pub use watch::{RULES, Rule};

/// Largest growth of the resident memory between the first and the last quarter of a scenario, bytes: a few pages of each arena
/// of the allocator.
pub const GROWTH_LIMIT: u64 = 2 << 20;
/// Longest scenario of a robot: more than the 71.6 minutes after which 32 bits of microseconds begin at 0 again.
const LONGEST_SCENARIO: Duration = Duration::from_secs(7_200);

/// Returns the scenarios of at least two robots that share `total` virtual time, a row each: what happened, the longest time from
/// mended to shaking as commanded, the largest current of sound hardware, how often each rule was broken, and the first examples.
#[must_use]
pub fn soak(seed: u64, total: Duration) -> Measurement<u64> {
    let robots = total.as_secs().div_ceil(LONGEST_SCENARIO.as_secs()).max(2);
    let length = total / robots as u32;
    let counts = ["commands", "link_troubles", "hardware_faults", "restarts"].map(Column::whole);
    let rules = RULES.map(|(_, name)| Column::whole(name).limited(Limit::Exactly(0.0)));
    let grown = Column::number("growth_bytes").limited(Limit::AtMost(GROWTH_LIMIT as f64));
    let columns = [Column::whole("robot"), Column::whole("episodes").limited(Limit::AtLeast(1.0))]
        .into_iter()
        .chain(counts)
        .chain(["longest_recovery_s", "largest_current_a"].map(Column::number))
        .chain(rules)
        .chain([grown.or_missing(), Column::text("examples")]);
    let parameters = json!({ "seed": seed, "robots": robots, "length_s": length.as_secs_f64() });
    let facts =
        json!({ "seed": seed, "virtual_hours": (length * robots as u32).as_secs_f64() / 3_600.0 });
    Measurement::new(
        "soak",
        parameters,
        columns.collect(),
        |robot: &u64, _| vec![(*robot).into()],
        move |robot| {
            let seed = seed.wrapping_mul(1_000_003).wrapping_add(*robot);
            let account = Scenario::new(seed, length)?.run()?;
            Ok::<_, BenchError>(vec![account.row()])
        },
    )
    .runs(0..robots, 1)
    .listed("robots", &[])
    .with_facts(facts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::compute;

    #[test]
    fn two_robots_come_through_a_minute_of_trouble() {
        let table = compute(&soak(1, Duration::from_secs(60)));
        // Other tests of this process allocate as well.
        let figures = table.figures().into_iter().filter(|it| it.name != "growth_bytes");
        let broken: Vec<_> = figures.filter(|it| !it.pass).collect();
        assert_eq!(broken, [], "{:#?}", table.objects());
        let faults = table.index("hardware_faults").unwrap();
        let all: f64 = table.rows.values().filter_map(|row| row[faults].number()).sum();
        assert!(table.rows.len() == 2 && all > 10.0, "{all}");
    }
}
