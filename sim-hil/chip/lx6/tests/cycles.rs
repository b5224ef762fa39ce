//! Cycles: what waits for what.

use super::{Code, DATA, add, after, movi, nop, rri8, rrr};
use flix_lx6::cost;

/// Cycles of a program less those of issuing its instructions.
fn lost(program: &[Code]) -> u64 {
    let core = after(&[(4, DATA)], program);
    core.cycles - core.instructions * cost::ISSUE
}

#[test]
fn a_load_is_waited_for_by_what_needs_it_alone() {
    let load = || rri8(2, 2, 4, 5, 0);
    for (program, cycles) in [
        (vec![load(), add(6, 5, 5)], cost::LOAD_USE),
        (vec![load(), add(6, 5, 7)], cost::LOAD_USE),
        (vec![load(), add(6, 7, 5)], cost::LOAD_USE),
        (vec![load(), nop(), add(6, 5, 5)], cost::LOAD_USE - 1),
        (vec![load(), nop(), nop(), add(6, 5, 5)], 0),
        (vec![load(), add(6, 7, 7)], 0),
        // `movi` has no source, though its field says register 0.
        (vec![rri8(2, 2, 4, 0, 0), movi(6, 1)], 0),
    ] {
        assert_eq!(lost(&program), cycles, "{program:?}");
    }
}

#[test]
fn products_taken_branches_divisions_and_barriers_take_what_is_stated() {
    let never = || rri8(7, 9, 4, 4, 2);
    let always = || rri8(7, 1, 4, 4, -1);
    for (program, cycles) in [
        (vec![rrr(2, 11, 5, 4, 4), add(6, 5, 5)], cost::MULTIPLY_USE),
        (vec![never(), nop()], 0),
        (vec![always(), nop()], cost::TAKEN),
        (vec![rrr(2, 12, 5, 4, 4)], cost::DIVIDE - cost::ISSUE),
        (vec![rrr(0, 0, 2, 0, 1)], cost::SYNCHRONIZE - cost::ISSUE),
    ] {
        assert_eq!(lost(&program), cycles, "{program:?}");
    }
}
