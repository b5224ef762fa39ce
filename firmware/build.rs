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

/// Writes a script of the linker into a folder that is searched.
fn write_script(name: &str, text: &str) {
    let Some(out) = env::var_os("OUT_DIR") else { return };
    let path = std::path::Path::new(&out).join(name);
    if let Err(error) = std::fs::write(&path, text) {
        println!("cargo::error={} cannot be written: {error}", path.display());
    }
    println!("cargo::rustc-link-search={}", std::path::Path::new(&out).display());
}

/// esp-hal brings the scripts, and includes two of ours. The Xtensa linker is a C compiler that would add its own start.
fn link(chip: &str) {
    let code = include_str!("src/bin/flix-robot/in_memory.x");
    // An ESP32 has no room for more beside the radio's code, and its stack.
    let more = match chip {
        "esp32c6" => include_str!("src/bin/flix-robot/more_in_memory.x"),
        _ => "",
    };
    write_script("rwtext_hook.x", &format!("{code}{more}"));
    write_script("rwdata_hook.x", include_str!("src/bin/flix-robot/constants_in_memory.x"));
    println!("cargo::rustc-link-arg-bin=flix-robot=-Tlinkall.x");
    if chip != "esp32c6" {
        println!("cargo::rustc-link-arg-bin=flix-robot=-nostartfiles");
    }
}

/// riscv-rt brings `link.x` and wants the memory map of QEMU's `virt` machine; xtensa-lx-rt brings the vectors of a script
/// for its machine `sim`.
fn link_processor_in_the_loop(target: &str) {
    let (script, text) = match target.starts_with("xtensa") {
        true => ("sim.x", include_str!("src/bin/pil/xtensa.x")),
        false => ("memory.x", include_str!("src/bin/pil/riscv.x")),
    };
    write_script(script, text);
    println!("cargo::rustc-link-arg-bin=pil=-T{script}");
    if script == "memory.x" {
        println!("cargo::rustc-link-arg-bin=pil=-Tlink.x");
    }
    println!("cargo::rustc-link-arg-bin=fast-tick=-efast_tick");
    println!("cargo::rustc-link-arg-bin=fast-tick=--gc-sections");
}
