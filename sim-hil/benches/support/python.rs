//! A program of Python beside a bench.

use std::path::Path;
use std::process::Command;

/// Runs a program that prints one number, with a file as its first argument; `None` where there is no MuJoCo.
///
/// # Panics
/// With what Python said, where `CI` is set: nothing is skipped there.
pub fn number(program: &str, file: &Path, arguments: &[String]) -> Option<f64> {
    let mut python = Command::new("python3");
    let done = python.args(["-c", program]).arg(file).args(arguments).output();
    let printed = done.as_ref().ok().and_then(|done| str::from_utf8(&done.stdout).ok());
    let number = printed.and_then(|text| text.trim().parse().ok());
    if number.is_none() {
        let said = match &done {
            Ok(done) => String::from_utf8_lossy(&done.stderr).into_owned(),
            Err(error) => error.to_string(),
        };
        assert!(std::env::var_os("CI").is_none(), "{said}");
        println!("MuJoCo is left out (`pip install mujoco`): {said}");
    }
    number
}
