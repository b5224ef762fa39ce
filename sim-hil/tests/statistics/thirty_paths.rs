//! Thirty paths as people draw them, six of each kind to a test: tests share the cores.

use crate::drawn_paths::assert_walked;

/// Asserts that the first six paths of a kind are walked: every fifth from this number on.
fn assert_six_walked(first: u64) {
    (0..6).for_each(|n| assert_walked(5 * n + first));
}

#[test]
fn stars_are_walked_once_round() {
    assert_six_walked(5);
}

#[test]
fn rectangles_with_spurs_are_walked_once_round() {
    assert_six_walked(1);
}

#[test]
fn hypocycloids_with_cusps_are_walked_once_round() {
    assert_six_walked(2);
}

#[test]
fn lanes_to_and_fro_are_walked_once_round() {
    assert_six_walked(3);
}

#[test]
fn polygons_that_cross_themselves_are_walked_once_round() {
    assert_six_walked(4);
}
