//! Sets `FLIX_VERSION`: the version of the package, and the newest commit of its sources.

fn main() {
    flix_version::emit(&[
        "protocol",
        "firmware",
        "host",
        "sim-hil",
        "sim-hil/plant",
        "sim-hil/batch",
        "sim-hil/python",
    ]);
}
