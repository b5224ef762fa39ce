//! Sets `FLIX_VERSION`: the version of the package, and the newest commit of its sources.

fn main() {
    flix_version::emit(&["protocol", "host", "host/plot", "host/shell", "host/cli"]);
}
