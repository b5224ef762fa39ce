//! From a command's leaving the operator's program to the first duty that it changes: two UDP sockets on
//! loopback, the real client, and the served robot. Prints the quantiles; the target is a 99th percentile below 5 ms.

mod latency;

use std::time::Duration;

use flix_host::link::RobotLink;
use flix_host::link::udp::Connection;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::Setpoint;
use flix_sim::rig::bench::setpoint;

fn main() {
    latency::measure(|address, key| {
        let mut operator = Connection::open(address, key, Interrupt::never()).expect("loopback");
        operator.wait_until_connected().expect("a session");
        operator.arm().expect("the robot arms");
        operator
    });
}

impl latency::Operator for Connection {
    fn hold(&mut self, walks: bool, duration: Duration) {
        let walking = setpoint(-30.0, 30.0).expect("within the robot's range");
        let (client, now) = self.operate();
        client.hold(now, if walks { walking } else { Setpoint::REST });
        let end = now + duration;
        while self.now() < end {
            self.step(Duration::from_millis(2)).expect("loopback");
            while self.operate().0.update().is_some() {}
        }
    }

    fn leave(mut self) {
        self.disarm().expect("the robot disarms");
    }
}
