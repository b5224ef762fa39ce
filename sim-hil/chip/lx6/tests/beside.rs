//! The comparison with another emulator's log.

use std::fmt::Write as _;

use super::{add, machine, movi, nop, rrr, simcall};
use flix_lx6::beside::{Difference, compare};
use flix_lx6::processor::special;
use flix_lx6::simulator::Simulator;

const PROGRAM: fn() -> Vec<super::Code> =
    || vec![movi(3, 5), add(4, 3, 3), rrr(3, 0, 14, 10, 5), add(6, 5, 5), nop(), simcall()];

fn simulator() -> Simulator<std::io::Sink> {
    let (core, memory) = machine(&PROGRAM());
    Simulator::new(core, memory, ".".into(), std::io::sink())
}

/// What another emulator, whose counter reads 1,234, would log, each block written twice where `twice` says so.
fn log(twice: bool) -> String {
    let mut log = String::from("a line before\n");
    let mut simulator = simulator();
    for step in 0..5 {
        let core = &simulator.core;
        let mut block = format!("PC={:08x}\n\n", core.pc);
        for (name, number) in [("PS", special::PS), ("SAR", special::SAR)] {
            let _ = write!(block, "{name:>12}={:08x} ", core.special(number).unwrap_or_default());
        }
        let _ = writeln!(block, "\n A03={:08x}", core.get(3));
        for register in 0..64 {
            let _ = write!(block, "AR{register:02}={:08x} ", core.physical(register));
        }
        block.push('\n');
        (0..=usize::from(twice)).for_each(|_| log.push_str(&block));
        simulator.step().expect("the program does what is emulated");
        if step == 2 {
            simulator.core.set(5, 1_234);
        }
    }
    log
}

#[test]
fn the_same_registers_after_each_instruction_pass_whatever_the_time_and_however_often_one_is_logged()
 {
    for twice in [false, true] {
        let compared = compare(&mut simulator(), log(twice).as_bytes(), 4, &[]).unwrap();
        assert_eq!(compared.instructions, 4);
    }
}

#[test]
fn the_first_register_that_differs_is_named_with_its_instruction() {
    for (from, to, named, after) in [
        ("AR03=00000005", "AR03=00000006", "AR3", 1),
        ("AR04=0000000a", "AR04=0000000b", "AR4", 2),
        ("SAR=00000000", "SAR=00000001", "SAR", 0),
        ("PC=00001006", "PC=00001007", "PC", 2),
        ("AR06=000009a4", "AR06=000009a5", "AR6", 4),
    ] {
        let changed = log(false).replacen(from, to, 1);
        match compare(&mut simulator(), changed.as_bytes(), 4, &[]) {
            Err(Difference::Register { name, instructions, .. }) => {
                assert_eq!((name.as_str(), instructions), (named, after));
            }
            other => panic!("{named}: {other:?}"),
        }
    }
}

#[test]
fn a_log_that_ends_early_is_an_error() {
    let outcome = compare(&mut simulator(), log(false).as_bytes(), 50, &[]);
    assert!(matches!(outcome, Err(Difference::Log(5))), "{outcome:?}");
}

#[test]
fn what_the_log_leaves_out_is_executed_and_has_to_come_out_alike() {
    // Without the second instruction, or without the third one, which reads the time.
    let without = |pc: &str, log: &str| {
        log.split("PC=").filter(|block| !block.starts_with(pc)).collect::<Vec<_>>().join("PC=")
    };
    let within = [0x1000..=0x1002, 0x1006..=0x1010];
    let shorter = without("00001003", &log(false));
    let compared = compare(&mut simulator(), shorter.as_bytes(), 3, &within).expect("all is alike");
    assert_eq!((compared.instructions, compared.compared), (4, 3));
    let changed = shorter.replacen("AR04=0000000a", "AR04=0000000b", 1);
    assert!(compare(&mut simulator(), changed.as_bytes(), 4, &within).is_err());
    let outcome = compare(
        &mut simulator(),
        without("00001006", &log(false)).as_bytes(),
        4,
        &[0x1000..=0x1005, 0x1009..=0x1010],
    );
    assert!(matches!(outcome, Err(Difference::Register { ref name, .. }) if name == "AR5"));
}
