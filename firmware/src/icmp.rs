//! Limits number and length of the robot's answers by ICMP.
//!
//! The stack (smoltcp) answers each ping, and each datagram that no socket takes by an error of up to 576 bytes. Both go to the
//! stated sender, which may be forged. [`Icmp`] checks its packets, both ways:
//!
//! - A ping is answered up to [`ECHOES`] times in [`ECHO_WINDOW`], 1,000 a second, and only where it was sent to the robot
//!   alone (RFC 1122, 3.2.2.6). The stack ignores all other ICMP.
//! - An error leaves at most once in [`ERROR_WINDOW`]. It quotes the header and 8 bytes of its cause, the least that RFC 792
//!   asks for. An error that is longer than its cause is dropped, so that no forged sender gets more bytes than were sent.

use embassy_time::{Duration, Instant as Moment};
use smoltcp::wire::{
    EthernetFrame, EthernetProtocol, Icmpv4Message, Icmpv4Packet, IpProtocol, Ipv4Packet,
};

/// Pings that are answered in a window. The radio keeps 8 frames to send.
const ECHOES: u8 = 8;
/// See [`ECHOES`].
const ECHO_WINDOW: Duration = Duration::from_millis(8);
/// Least time between two errors.
const ERROR_WINDOW: Duration = Duration::from_millis(100);

const ETHERNET_HEADER: usize = 14;
/// In the first byte of a destination: several cards.
const TO_MANY: u8 = 1;
/// Bytes of an IPv4 packet with an error: IPv4, ICMP, and the cause's IPv4 with 8 bytes of its payload.
const ERROR: u16 = 20 + 8 + 20 + 8;
/// Longest frame with an error of the stack (RFC 1812, 4.3.2.3).
pub(crate) const LONGEST_ERROR: usize = ETHERNET_HEADER + 576;

/// Limits packets to a count in each window of time. A window begins with its first packet.
#[derive(Debug, Default)]
struct Allowance {
    ends: Option<Moment>,
    left: u8,
}

impl Allowance {
    fn take(&mut self, now: Moment, count: u8, window: Duration) -> bool {
        if self.ends.is_none_or(|ends| now >= ends) {
            (self.ends, self.left) = (Some(now + window), count);
        }
        let is_left = self.left > 0;
        self.left = self.left.saturating_sub(1);
        is_left
    }
}

/// Counts the answers that may still leave.
#[derive(Debug, Default)]
pub(crate) struct Icmp {
    echoes: Allowance,
    errors: Allowance,
}

impl Icmp {
    /// Returns whether the stack may see this frame.
    pub(crate) fn admits(&mut self, frame: &[u8], now: Moment) -> bool {
        icmp(frame).is_none()
            || (frame[0] & TO_MANY == 0 && self.echoes.take(now, ECHOES, ECHO_WINDOW))
    }

    /// Returns how many bytes of the stack's frame may leave; an error is shortened.
    pub(crate) fn releases(&mut self, frame: &mut [u8], now: Moment) -> usize {
        match cause_length(frame) {
            None => frame.len(),
            Some(cause) if cause >= ERROR && self.errors.take(now, 1, ERROR_WINDOW) => {
                shorten(frame)
            }
            Some(_) => 0,
        }
    }
}

/// Returns the ICMP packet in a frame.
fn icmp(frame: &[u8]) -> Option<Icmpv4Packet<&[u8]>> {
    let frame = EthernetFrame::new_checked(frame).ok()?;
    let packet = Ipv4Packet::new_checked(frame.payload()).ok()?;
    let is_icmp =
        frame.ethertype() == EthernetProtocol::Ipv4 && packet.next_header() == IpProtocol::Icmp;
    Icmpv4Packet::new_checked(packet.payload()).ok().filter(|_| is_icmp)
}

/// Returns the length of the packet that an error in this frame is about, if it is an error.
fn cause_length(frame: &[u8]) -> Option<u16> {
    let error = icmp(frame).filter(|it| it.msg_type() == Icmpv4Message::DstUnreachable)?;
    Some(Ipv4Packet::new_unchecked(error.data()).total_len())
}

/// Shortens an error to its least, and returns the frame's length.
fn shorten(frame: &mut [u8]) -> usize {
    let mut frame = EthernetFrame::new_unchecked(frame);
    let mut packet = Ipv4Packet::new_unchecked(frame.payload_mut());
    packet.set_total_len(ERROR);
    packet.fill_checksum();
    Icmpv4Packet::new_unchecked(packet.payload_mut()).fill_checksum();
    ETHERNET_HEADER + usize::from(ERROR)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_allowance_is_used_up_and_comes_again() {
        let mut allowance = Allowance::default();
        let mut taken = |ms| allowance.take(Moment::from_millis(ms), 2, Duration::from_millis(8));
        let [first, last] = [[0, 3, 7], [8, 15, 15]].map(|at| at.map(&mut taken));
        assert_eq!([first, last], [[true, true, false]; 2]);
    }
}
