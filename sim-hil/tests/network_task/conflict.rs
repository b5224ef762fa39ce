//! A robot whose address another machine has, or claims to have.
use flix_sim::rig::dhcp_server::{DhcpServer, message};

use super::*;

/// Number of the message that declines an address (RFC 2132, 9.6).
const DECLINE: u8 = 4;
/// The card of the other machine.
const RIVAL: u8 = 66;

/// Returns sender and target of an ARP request.
pub(super) fn request(frame: &[u8]) -> Option<[Ipv4Addr; 2]> {
    let address = |at: usize| frame.get(at..at + 4)?.first_chunk::<4>().copied();
    let is_request = frame.get(12..14)? == [0x08, 0x06] && frame.get(20..22)? == [0, 1];
    is_request.then_some([address(28)?.into(), address(38)?.into()])
}

/// Answers the robot's frames as a server that gives the next address once one was declined, and as a machine that has the
/// addresses for which `has` holds; `seen` gets each frame.
fn serve(
    world: &World,
    has: impl Fn(Ipv4Addr) -> bool + 'static,
    mut seen: impl FnMut(&[u8]) + 'static,
) {
    let (wire, mut server) = (world.wire.clone(), DhcpServer::new());
    world.wire.watch(move |frame| {
        seen(frame);
        if message(frame).is_some_and(|it| it[242] == DECLINE) {
            server.given = Ipv4Addr::from(u32::from(server.given) + 1);
        }
        server.answer(frame).into_iter().for_each(|it| wire.inject(it));
        if let Some([_, asked]) = request(frame).filter(|[_, asked]| has(*asked)) {
            wire.inject(arp(Arp::Reply, RIVAL, asked, asked));
        }
    });
}

fn play_dhcp<Scenario: Future<Output = ()>>(scenario: impl FnOnce(World) -> Scenario) {
    play_with(Config::dhcpv4(net::dhcp("daisy")), Some(key()), scenario);
}

async fn until(ms: u64) {
    Timer::at(embassy_time::Instant::from_millis(ms)).await;
}

fn address(world: &World) -> Option<Ipv4Addr> {
    world.network.robot.config_v4().map(|config| config.address.address())
}

#[test]
fn an_address_that_another_machine_has_is_declined_and_never_used() {
    play_dhcp(|world| async move {
        let taken = DhcpServer::new().given;
        let (declined, used) = (Rc::new(RefCell::new(Vec::new())), Rc::new(Cell::new(0)));
        let (seen, uses) = (declined.clone(), used.clone());
        serve(
            &world,
            move |it| it == taken,
            move |frame| {
                if let Some(it) = message(frame).filter(|it| it[242] == DECLINE) {
                    seen.borrow_mut().push(it.to_vec());
                }
                let is_sender = request(frame).is_some_and(|[sender, _]| sender == taken);
                let is_source = frame[12..14] == [0x08, 0x00] && frame[26..30] == taken.octets();
                uses.set(uses.get() + u32::from(is_sender || is_source));
            },
        );
        until(6_000).await;
        assert_eq!(address(&world), Some(Ipv4Addr::new(10, 0, 0, 78)));
        let declined = declined.borrow();
        let names = |it: &[u8]| declined[0].windows(it.len()).any(|part| part == it);
        assert!(names(&[50, 4, 10, 0, 0, 77]) && names(&[54, 4, 10, 0, 0, 253]), "{declined:?}");
        assert_eq!((declined.len(), used.get()), (1, 0));
    });
}

#[test]
fn a_free_address_is_probed_within_half_a_second_and_announced_every_minute() {
    play_dhcp(|world| async move {
        let asked = Rc::new(RefCell::new(Vec::new()));
        let seen = asked.clone();
        let given = DhcpServer::new().given;
        serve(
            &world,
            |_| false,
            move |frame| {
                if let Some([sender, _]) = request(frame).filter(|[_, target]| *target == given) {
                    seen.borrow_mut().push((now().as_micros() / 1_000_000, sender));
                }
            },
        );
        until(600).await;
        assert_eq!(address(&world), Some(given));
        until(130_000).await;
        let [probe, own] = [Ipv4Addr::UNSPECIFIED, given];
        let announced = [0, 2, 62, 122].map(|s| (s, own));
        let all: Vec<_> = [(0, probe); 2].into_iter().chain(announced).collect();
        assert_eq!(*asked.borrow(), all);
    });
}

#[test]
fn a_machine_that_claims_every_address_keeps_no_robot_off_the_network() {
    play_dhcp(|world| async move {
        serve(&world, |_| true, |_| {});
        until(40_000).await;
        assert_eq!(address(&world), Some(Ipv4Addr::new(10, 0, 0, 80)));
    });
}

#[test]
fn a_session_goes_on_while_another_machine_claims_the_robots_address() {
    play(Some(key()), |world| async move {
        let announced = Rc::new(Cell::new(0));
        let seen = announced.clone();
        world.wire.watch(move |frame| {
            let is_own = request(frame) == Some([ROBOT; 2]);
            seen.set(seen.get() + u32::from(is_own));
        });
        let mut operator = Operator::new(&world);
        operator.connect().await;
        until(5_000).await;
        operator.connect().await;
        let before = announced.get();
        for _ in 0..200 {
            world.wire.inject(arp(Arp::Request, RIVAL, ROBOT, ROBOT));
            until(now().as_micros() / 1_000 + 100).await;
        }
        assert_eq!(announced.get() - before, 2, "in 20 s");
        operator.connect().await;
    });
}
