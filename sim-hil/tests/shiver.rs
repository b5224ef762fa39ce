//! No settings that the robot arms with let a rotor shiver at rest, unless a fault says so; by the plant. All drawn sets:
//! `flix-sim shiver`.

use flix_sim::reliability::shiver::{Set, Verdict, margin, run, shivers};
use flix_sim::study::{Study as _, compute};

fn set(values: &[(&str, f64)]) -> Set {
    values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
}

#[test]
fn settings_that_cooked_motors_are_refused_with_their_partners() {
    for values in [
        [("tracker_bandwidth", 40.0), ("position_bandwidth", 20.0)],
        [("tracker_bandwidth", 125.0), ("position_bandwidth", 45.0)],
        [("tracker_bandwidth", 125.0), ("position_bandwidth", 50.0)],
    ] {
        let Verdict::Refused(said) = run(&set(&values), 1).unwrap() else { panic!("{values:?}") };
        for (name, value) in values {
            assert!(said.contains(&format!("{name} {value}")), "{said}");
        }
    }
}

#[test]
fn settings_that_are_stable_rest_quietly() {
    for (tracker, position) in [(80.0, 20.0), (300.0, 20.0), (125.0, 35.0)] {
        let set = set(&[("tracker_bandwidth", tracker), ("position_bandwidth", position)]);
        for seed in [1, 2] {
            let verdict = run(&set, seed).unwrap();
            let Verdict::Rested(heat) = verdict else { panic!("{set:?}: {verdict:?}") };
            assert!(heat < 0.1, "{set:?}, margin {:?}: {heat} W", margin(&set));
        }
    }
}

#[test]
fn of_drawn_settings_those_nearest_the_border_rest_quietly_or_say_why_not() {
    let shivers = shivers(2_000, 12, 1).unwrap();
    let table = compute(&shivers);
    assert!(table.rows.len() == 12 && table.pass(), "{:#?}", table.objects());
    let accepted = shivers.facts()["accepted"].as_u64().unwrap();
    assert!(accepted > 500 && accepted < 1_900, "{accepted}");
}
