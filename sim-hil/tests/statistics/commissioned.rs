//! What robots keep once they are commissioned.

use flix_sim::reliability::commission::CURRENT_LIMIT_A;
use flix_sim::reliability::commissioned_accuracy;

#[test]
fn commissioned_robots_keep_every_promise_or_say_why_not() {
    let promises = commissioned_accuracy::measure(3, 1, || {}).unwrap();
    for kind in [&promises.current_sense, &promises.voltage_mode] {
        assert_eq!(kind.held + kind.limited + kind.named, 3, "{kind:?}");
        assert_eq!((kind.misnamed, kind.silent, kind.beyond_current), (0, 0, 0), "{kind:?}");
        assert!(kind.largest_current_a <= CURRENT_LIMIT_A, "{kind:?}");
    }
    assert!(promises.current_sense.held > 0);
}
