//! A robot that has its address by DHCP, from servers that are late, silent, wrong or hostile.
use flix_sim::rig::dhcp_server::{DhcpServer, Kind, message};

use super::*;

/// Runs a scenario with a robot that asks for its address.
fn play_dhcp<Scenario: Future<Output = ()>>(scenario: impl FnOnce(World) -> Scenario) {
    play_with(Config::dhcpv4(net::dhcp("daisy")), Some(key()), scenario);
}

/// Lets a server answer the robot's frames, each of which `seen` gets.
fn serve(world: &World, server: DhcpServer, mut seen: impl FnMut(&[u8]) + 'static) {
    let wire = world.wire.clone();
    world.wire.watch(move |frame| {
        seen(frame);
        if let Some(answer) = server.answer(frame) {
            wire.inject(answer);
        }
    });
}

fn address(world: &World) -> Option<Ipv4Addr> {
    world.network.robot.config_v4().map(|config| config.address.address())
}

fn router(world: &World) -> Option<Ipv4Addr> {
    world.network.robot.config_v4().and_then(|config| config.gateway)
}

async fn seconds(seconds: u64) {
    Timer::after(Duration::from_secs(seconds)).await;
}

/// Returns the destination of a frame's IPv4 packet.
fn destination(frame: &[u8]) -> Ipv4Addr {
    <[u8; 4]>::try_from(&frame[30..34]).unwrap().into()
}

/// Returns whether a message names no server: a renewal.
fn is_renewal(message: &[u8]) -> bool {
    message[242] == Kind::Request as u8 && message[12..16] != [0; 4]
}

#[test]
fn a_robot_without_a_dhcp_server_asks_less_and_less_often_and_at_once_when_the_link_is_back() {
    play_dhcp(|world| async move {
        let asked = Rc::new(RefCell::new(Vec::new()));
        let seen = asked.clone();
        world.wire.watch(move |frame| {
            if message(frame).is_some() {
                seen.borrow_mut().push(now().as_micros() / 1_000);
            }
        });
        Timer::after(Duration::from_millis(10_000)).await;
        world.network.plug(false);
        Timer::after(Duration::from_millis(100)).await;
        world.network.plug(true);
        Timer::after(Duration::from_millis(3_300)).await;
        let near = |ms: u64| ms / 50 * 50;
        let asked: Vec<u64> = asked.borrow().iter().map(|ms| near(*ms)).collect();
        assert_eq!(asked, [0, 3_000, 9_000, 10_100, 13_100]);
    });
}

#[test]
fn a_dhcp_server_that_offers_late_gives_an_address_all_the_same() {
    for late_ms in [20, 2_990, 3_010, 3_500, 8_000] {
        play_dhcp(|world| async move {
            let answers = Rc::new(RefCell::new(Vec::new()));
            let (due, server) = (answers.clone(), DhcpServer::new());
            world.wire.watch(move |frame| {
                if let Some(answer) = server.answer(frame) {
                    let is_offer = message(frame).is_some_and(|it| it[242] == Kind::Discover as u8);
                    let wait = if is_offer { late_ms } else { 5 };
                    due.borrow_mut().push((now().as_micros() / 1_000 + wait, answer));
                }
            });
            for _ in 0..late_ms + 1_000 {
                Timer::after(Duration::from_millis(1)).await;
                let ms = now().as_micros() / 1_000;
                answers.borrow_mut().retain(|(at, answer)| {
                    if *at <= ms {
                        world.wire.inject(answer.clone());
                    }
                    *at > ms
                });
            }
            let given = DhcpServer::new().given;
            assert_eq!(address(&world), Some(given), "offered after {late_ms} ms");
        });
    }
}

/// Addresses that no router of 10.0.0.77/24 can have.
const NO_ROUTERS: [[u8; 4]; 9] = [
    [0; 4],
    [255; 4],
    [224, 0, 0, 1],
    [240, 0, 0, 1],
    [127, 0, 0, 1],
    [10, 0, 0, 0],
    [10, 0, 0, 255],
    [10, 0, 0, 77],
    [10, 0, 1, 254],
];

#[test]
fn a_router_that_no_host_can_be_stops_neither_robot_nor_operator() {
    for router_of in NO_ROUTERS.map(Ipv4Addr::from) {
        play_dhcp(|world| async move {
            let server = DhcpServer { routers: vec![router_of], ..DhcpServer::new() };
            let given = server.given;
            serve(&world, server, |_| {});
            seconds(1).await;
            assert_eq!(address(&world), Some(given), "{router_of}");
            // A greeting from another network is answered by way of the router.
            let stranger = OperatorSession::new(Key::new([4; 32]), [4; 32], now()).poll(now());
            let from = SocketAddrV4::new(Ipv4Addr::new(192, 168, 7, 7), 1);
            let to = SocketAddrV4::new(given, DEFAULT_PORT);
            world.wire.inject(network::datagram(66, from, to, &stranger.unwrap()));
            let mut operator = Operator::to(&world, given);
            let took = operator.connect().await;
            assert!(took < 100_000, "{took} us with router {router_of}");
            assert_eq!(router(&world), None, "{router_of}");
        });
    }
}

#[test]
fn the_first_router_that_can_be_one_is_the_way_to_other_networks() {
    play_dhcp(|world| async move {
        let routers = vec![Ipv4Addr::UNSPECIFIED, network::ROUTER, Ipv4Addr::new(10, 0, 0, 9)];
        serve(&world, DhcpServer { routers, ..DhcpServer::new() }, |_| {});
        seconds(1).await;
        assert_eq!(router(&world), Some(network::ROUTER));
    });
}

#[test]
fn an_address_that_no_host_can_have_is_not_taken() {
    let server = DhcpServer::new();
    let no_hosts = [
        [0; 4],
        [0, 0, 0, 7],
        [255; 4],
        [224, 0, 0, 251],
        [240, 0, 0, 1],
        [10, 0, 0, 0],
        [10, 0, 0, 255],
        server.source.octets(),
    ];
    for given in no_hosts.map(Ipv4Addr::from) {
        let server = DhcpServer { given, ..server.clone() };
        play_dhcp(|world| async move {
            serve(&world, server, |_| {});
            seconds(1).await;
            assert_eq!(address(&world), None);
            serve(&world, DhcpServer::new(), |_| {});
            seconds(10).await;
            assert_eq!(address(&world), Some(DhcpServer::new().given), "after {given}");
        });
    }
}

#[test]
fn an_operator_connects_whatever_a_dhcp_server_leaves_out() {
    let whole = DhcpServer::new;
    let servers = [
        DhcpServer { identifier: None, ..whole() },
        DhcpServer { identifier: Some(Ipv4Addr::UNSPECIFIED), ..whole() },
        DhcpServer { identifier: Some(Ipv4Addr::BROADCAST), ..whole() },
        DhcpServer { source: Ipv4Addr::UNSPECIFIED, ..whole() },
        DhcpServer { mask: None, ..whole() },
        DhcpServer { mask: None, lease: None, routers: Vec::new(), ..whole() },
        DhcpServer { mask: Some(Ipv4Addr::new(255, 0, 255, 0)), ..whole() },
        DhcpServer { mask: Some(Ipv4Addr::new(0, 255, 255, 0)), ..whole() },
        DhcpServer { mask: Some(Ipv4Addr::BROADCAST), ..whole() },
        DhcpServer { mask: Some(Ipv4Addr::UNSPECIFIED), ..whole() },
    ];
    for server in servers {
        let (said, given) = (format!("{server:?}"), server.given);
        play_dhcp(|world| async move {
            serve(&world, server, |_| {});
            seconds(1).await;
            assert_eq!(address(&world), Some(given), "{said}");
            let patience = Timer::after(Duration::from_millis(500));
            let mut operator = Operator::to(&world, given);
            let connected = select(operator.connect(), patience).await;
            assert!(matches!(connected, Either::First(_)), "{said}");
        });
    }
}

#[test]
fn a_message_without_any_server_gives_no_address() {
    play_dhcp(|world| async move {
        let nobody = Ipv4Addr::UNSPECIFIED;
        serve(&world, DhcpServer { source: nobody, identifier: None, ..DhcpServer::new() }, |_| {});
        seconds(1).await;
        assert_eq!(address(&world), None);
    });
}

#[test]
fn a_lease_without_a_mask_has_that_of_its_class() {
    for (given, prefix) in [([10, 0, 0, 77], 8), ([172, 16, 4, 77], 16), ([192, 168, 4, 77], 24)] {
        let given = Ipv4Addr::from(given);
        play_dhcp(|world| async move {
            let mask = None;
            serve(&world, DhcpServer { given, mask, ..DhcpServer::new() }, |_| {});
            seconds(1).await;
            let network = world.network.robot.config_v4().unwrap().address;
            assert_eq!((network.address(), network.prefix_len()), (given, prefix));
        });
    }
}

#[test]
fn an_acknowledgement_without_mask_and_router_keeps_those_of_the_offer() {
    play_dhcp(|world| async move {
        let whole = DhcpServer { renewal: Some(2), ..DhcpServer::new() };
        let short = DhcpServer { mask: None, routers: Vec::new(), ..whole.clone() };
        let (wire, given) = (world.wire.clone(), whole.given);
        world.wire.watch(move |frame| {
            let is_request = message(frame).is_some_and(|it| it[242] == Kind::Request as u8);
            let server = if is_request { &short } else { &whole };
            server.answer(frame).into_iter().for_each(|it| wire.inject(it));
        });
        for _ in 0..5 {
            seconds(1).await;
            let network = world.network.robot.config_v4().unwrap();
            let address = (network.address.address(), network.address.prefix_len());
            assert_eq!((address, network.gateway), ((given, 24), Some(network::ROUTER)));
        }
    });
}

#[test]
fn a_lease_is_renewed_at_the_server_that_it_names() {
    let whole = || DhcpServer { renewal: Some(2), ..DhcpServer::new() };
    let elsewhere = Ipv4Addr::new(192, 168, 50, 2);
    let servers = [
        // A relay, which is the router, too.
        DhcpServer { source: network::ROUTER, identifier: Some(elsewhere), ..whole() },
        DhcpServer { source: Ipv4Addr::UNSPECIFIED, ..whole() },
        DhcpServer { source: Ipv4Addr::LOCALHOST, ..whole() },
        DhcpServer { identifier: None, ..whole() },
        whole(),
    ];
    for server in servers {
        let (said, given) = (format!("{server:?}"), server.given);
        let named = server.identifier.unwrap_or(server.source);
        play_dhcp(|world| async move {
            let asked = Rc::new(RefCell::new(Vec::new()));
            let seen = asked.clone();
            let source = named;
            // The network carries to a server wherever it is.
            let server = DhcpServer { routers: vec![network::ROUTER, named], ..server };
            serve(&world, server, move |frame| {
                if message(frame).is_some_and(is_renewal) {
                    seen.borrow_mut().push(destination(frame));
                }
            });
            seconds(7).await;
            assert!(asked.borrow().len() >= 2, "{said}: {asked:?}");
            assert!(asked.borrow().iter().all(|it| *it == source), "{said}: {asked:?}");
            assert_eq!(address(&world), Some(given), "{said}");
        });
    }
}

/// Keeps the robot's last message in `last`.
fn keep(last: &Rc<RefCell<Vec<u8>>>) -> impl FnMut(&[u8]) + 'static {
    let last = last.clone();
    move |frame| {
        if let Some(message) = message(frame) {
            *last.borrow_mut() = message.to_vec();
        }
    }
}

/// Returns another server, which gives another address.
fn another() -> DhcpServer {
    let own = Ipv4Addr::new(10, 0, 0, 252);
    let given = Ipv4Addr::new(10, 0, 0, 88);
    DhcpServer { given, source: own, identifier: Some(own), ..DhcpServer::new() }
}

#[test]
fn an_acknowledgement_that_nobody_asked_for_changes_nothing() {
    let server = DhcpServer::new();
    let moved = DhcpServer { given: another().given, ..server.clone() };
    let short = DhcpServer { lease: Some(2), ..server.clone() };
    for liar in [another(), moved, short] {
        let server = server.clone();
        play_dhcp(|world| async move {
            let last = Rc::default();
            serve(&world, server.clone(), keep(&last));
            seconds(1).await;
            let asked = last.borrow().clone();
            for kind in [Kind::Acknowledgement, Kind::Refusal] {
                world.wire.inject(liar.say(kind, &asked));
            }
            seconds(12).await;
            assert_eq!(address(&world), Some(server.given));
            assert_eq!(*last.borrow(), asked, "asked again");
        });
    }
}

#[test]
fn another_server_changes_nothing_at_a_renewal() {
    let server = DhcpServer { renewal: Some(2), ..DhcpServer::new() };
    let same_address = DhcpServer { given: server.given, lease: Some(8), ..another() };
    let moved = DhcpServer { given: another().given, ..server.clone() };
    for liar in [another(), same_address, moved] {
        let server = server.clone();
        play_dhcp(|world| async move {
            serve(&world, server.clone(), |_| {});
            seconds(1).await;
            // The server is silent at the renewal.
            let (wire, arp) = (world.wire.clone(), server.clone());
            let last = Rc::default();
            let mut seen = keep(&last);
            world.wire.watch(move |frame| {
                seen(frame);
                if message(frame).is_none() {
                    arp.answer(frame).into_iter().for_each(|it| wire.inject(it));
                }
            });
            seconds(2).await;
            let asked = last.borrow().clone();
            assert!(is_renewal(&asked), "{asked:?}");
            world.wire.inject(liar.say(Kind::Acknowledgement, &asked));
            if liar.identifier != server.identifier {
                world.wire.inject(liar.say(Kind::Refusal, &asked));
            }
            seconds(12).await;
            assert_eq!(address(&world), Some(server.given));
            assert_eq!(*last.borrow(), asked, "asked again");
        });
    }
}

#[test]
fn a_lease_of_any_length_is_kept_and_renewed_in_peace() {
    for lease in [None, Some(0), Some(1), Some(2), Some(u32::MAX - 1), Some(u32::MAX)] {
        for renewal in [None, Some(0), Some(1), Some(u32::MAX)] {
            play_dhcp(|world| async move {
                let server = DhcpServer { lease, renewal, ..DhcpServer::new() };
                let given = server.given;
                let messages = Rc::new(Cell::new(0));
                let seen = messages.clone();
                serve(&world, server, move |frame| {
                    seen.set(seen.get() + u32::from(message(frame).is_some()));
                });
                seconds(1).await;
                for _ in 0..12 {
                    seconds(1).await;
                    assert_eq!(address(&world), Some(given), "{lease:?} {renewal:?}");
                }
                let messages = messages.get();
                assert!(messages <= 16, "{messages} messages, {lease:?} {renewal:?}");
            });
        }
    }
}
