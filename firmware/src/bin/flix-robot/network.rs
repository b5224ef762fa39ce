//! Wi-Fi: connects, stays connected, and carries the library's network task.
