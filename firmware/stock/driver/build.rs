//! Refuses other compilers than the one that this fits, and lets the program find the compiler's library when it runs.

use std::process::Command;

#[path = "../src/release.rs"]
#[expect(dead_code, reason = "for who calls the linker, too")]
mod release;

fn ask(rustc: &std::ffi::OsStr, arguments: &[&str]) -> String {
    let output = Command::new(rustc).args(arguments).output();
    output
        .map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned())
        .unwrap_or_default()
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=../src/release.rs");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = ask(&rustc, &["-vV"]);
    let found = version.lines().find_map(|line| line.strip_prefix("release: ")).unwrap_or_default();
    if found != release::RUSTC {
        println!(
            "cargo::error=this is built around rustc {} alone, and {found:?} was found",
            release::RUSTC
        );
    }
    let library = ask(&rustc, &["--print", "sysroot"]);
    println!("cargo::rustc-link-arg=-Wl,-rpath,{library}/lib");
}
