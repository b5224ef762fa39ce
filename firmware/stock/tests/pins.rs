//! What this package fits, and what the repository uses.

use std::path::Path;

use flix_xtensa::RUSTC;
use flix_xtensa::patches::PATCHES;

fn read(file: &str) -> toml::Table {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap();
    std::fs::read_to_string(root.join(file)).unwrap().parse().unwrap()
}

#[test]
fn the_compiler_of_this_repository_is_the_one_that_the_driver_fits() {
    let channel = read("rust-toolchain.toml")["toolchain"]["channel"].clone();
    assert_eq!(channel.as_str(), Some(RUSTC), "try the stock build, then renew `RUSTC`");
}

#[test]
fn each_patch_is_for_the_version_in_the_lock_file() {
    let lock = read("Cargo.lock");
    for patch in PATCHES {
        let is_meant = |package: &&toml::Value| package["name"].as_str() == Some(patch.package);
        let versions: Vec<_> =
            lock["package"].as_array().unwrap().iter().filter(is_meant).collect();
        let versions: Vec<_> = versions.iter().map(|package| package["version"].as_str()).collect();
        assert_eq!(versions, [Some(patch.version)], "{}", patch.package);
    }
}
