//! A robot that `flix-sim serve` simulates.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

/// A robot in a process of its own, ended with this value.
pub struct Robot {
    process: Child,
    /// Where it listens.
    pub address: SocketAddr,
}

impl Robot {
    /// Starts it with the key in this file.
    pub fn start(key_file: &std::path::Path) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_flix-sim"))
            .args(["serve", "--listen", "127.0.0.1:0", "--key"])
            .arg(key_file)
            .stdout(Stdio::piped())
            .spawn()
            .expect("flix-sim was built");
        let output = process.stdout.take().expect("it was piped");
        let address = BufReader::new(output)
            .lines()
            .map_while(Result::ok)
            .find_map(|line| line.trim_end_matches('.').rsplit_once(" listens on ")?.1.parse().ok())
            .expect("it says where it listens");
        Self { process, address }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
