//! For the chips: checks the choice of board and hands the linker its scripts. On the host: nothing.

#[path = "board_choice.rs"]
mod board_choice;

use std::env;

fn has_feature(feature: &str) -> bool {
    let name = feature.to_uppercase().replace('-', "_");
    env::var_os(format!("CARGO_FEATURE_{name}")).is_some()
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=board_choice.rs");
    let target = env::var("TARGET").unwrap_or_default();
    match board_choice::choose(&has_feature, &target) {
        Ok(None) => {}
        Ok(Some(choice)) => {
            println!("cargo::rustc-env=FLIX_BOARD={}", choice.board);
            println!("cargo::rustc-env=FLIX_ENCODER={}", choice.encoder.unwrap_or_default());
            link(choice.chip);
        }
        Err(sentence) => println!("cargo::error={sentence}"),
    }
    if has_feature("pil") {
        link_processor_in_the_loop(&target);
    }
}

/// esp-hal brings the scripts. The Xtensa linker is a C compiler that would add its own start.
fn link(chip: &str) {
    println!("cargo::rustc-link-arg-bin=flix-robot=-Tlinkall.x");
    if chip != "esp32c6" {
        println!("cargo::rustc-link-arg-bin=flix-robot=-nostartfiles");
    }
}

/// riscv-rt brings `link.x` and wants the memory map of QEMU's `virt` machine; xtensa-lx-rt brings the vectors of a script
/// for its machine `sim`.
fn link_processor_in_the_loop(target: &str) {
    let Some(out) = env::var_os("OUT_DIR") else { return };
    let (script, text) = match target.starts_with("xtensa") {
        true => ("sim.x", include_str!("src/bin/pil/xtensa.x")),
        false => ("memory.x", include_str!("src/bin/pil/riscv.x")),
    };
    let path = std::path::Path::new(&out).join(script);
    if let Err(error) = std::fs::write(&path, text) {
        println!("cargo::error={} cannot be written: {error}", path.display());
    }
    println!("cargo::rustc-link-search={}", std::path::Path::new(&out).display());
    println!("cargo::rustc-link-arg-bin=pil=-T{script}");
    if script == "memory.x" {
        println!("cargo::rustc-link-arg-bin=pil=-Tlink.x");
    }
    println!("cargo::rustc-link-arg-bin=fast-tick=-efast_tick");
    println!("cargo::rustc-link-arg-bin=fast-tick=--gc-sections");
}
