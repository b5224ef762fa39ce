//! What robots keep once they are commissioned.

use flix_sim::reliability::commission::CURRENT_LIMIT_A;
use flix_sim::reliability::commissioned_accuracy::{Kept, found, robots};
use flix_sim::study::compute;

#[test]
fn commissioned_robots_keep_every_promise_or_say_why_not() {
    let boards = found(&compute(&robots(3, 1)));
    for robots in &boards {
        assert_eq!(robots.len(), 3, "{robots:?}");
        for robot in robots {
            assert!(!matches!(robot.kept, Kept::Misnamed | Kept::Silent), "{robot:?}");
            assert!(robot.largest_current_a <= CURRENT_LIMIT_A, "{robot:?}");
        }
    }
    assert!(boards[0].iter().any(|robot| robot.kept == Kept::Held), "{boards:?}");
}
