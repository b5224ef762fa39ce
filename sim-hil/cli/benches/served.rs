//! A robot that `flix-sim serve` simulates.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use flix_host::link::keys;
use flix_protocol::session::Key;

/// A robot in a process of its own, ended with this value.
pub struct Robot {
    process: Child,
    /// Where it listens.
    pub address: SocketAddr,
    /// Its operator's key.
    pub key: Key,
}

impl Robot {
    /// Starts it with a new key.
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("a directory");
        let key_file = folder.path().join("robot.key");
        let key = keys::generate().expect("randomness");
        keys::write_new(&key_file, &key).expect("a key file");
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
        Self { process, address, key }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
