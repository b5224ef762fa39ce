//! Thirty paths as people draw them, of each kind as many to a test: tests share the cores.

use crate::drawn_paths::assert_walked;

#[test]
fn stars_are_walked_once_round() {
    (1..=6).for_each(|n| assert_walked(5 * n));
}

#[test]
fn rectangles_with_spurs_are_walked_once_round() {
    (0..6).for_each(|n| assert_walked(5 * n + 1));
}

#[test]
fn hypocycloids_with_cusps_are_walked_once_round() {
    (0..6).for_each(|n| assert_walked(5 * n + 2));
}

#[test]
fn lanes_to_and_fro_are_walked_once_round() {
    (0..6).for_each(|n| assert_walked(5 * n + 3));
}

#[test]
fn polygons_that_cross_themselves_are_walked_once_round() {
    (0..6).for_each(|n| assert_walked(5 * n + 4));
}
