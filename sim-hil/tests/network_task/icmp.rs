//! The robot's answers by ICMP: pings, and errors.
use super::*;

/// Counts and bytes of the ICMP packets that the robot sends, by their type.
#[derive(Default)]
struct Answers {
    echoes: Vec<Vec<u8>>,
    errors: Vec<Vec<u8>>,
}

const ECHO_REPLY: u8 = 0;
const UNREACHABLE: u8 = 3;

/// Collects the IPv4 packets with ICMP that the robot sends.
fn collect(world: &World) -> Rc<RefCell<Answers>> {
    let answers = Rc::new(RefCell::new(Answers::default()));
    let seen = answers.clone();
    world.wire.watch(move |frame| {
        if frame[12..14] != [0x08, 0x00] || frame[23] != 1 {
            return;
        }
        let mut answers = seen.borrow_mut();
        match frame[34] {
            ECHO_REPLY => answers.echoes.push(frame[14..].to_vec()),
            UNREACHABLE => answers.errors.push(frame[14..].to_vec()),
            other => panic!("ICMP of type {other}"),
        }
    });
    answers
}

/// Somebody whose address is known to the robot.
const PEER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 7);
const CARD: u8 = 7;

fn introduce(world: &World) {
    world.wire.inject(arp(Arp::Request, CARD, PEER, ROBOT));
}

async fn milliseconds(milliseconds: u64) {
    Timer::after(Duration::from_millis(milliseconds)).await;
}

#[test]
fn pings_of_all_lengths_are_answered_with_their_own_bytes() {
    play(Some(key()), |world| async move {
        let answers = collect(&world);
        introduce(&world);
        for length in [0, 1, 8, 56, 500, 1_472] {
            let payload = vec![length as u8; length];
            world.wire.inject(network::ping(CARD, PEER, ROBOT, length as u16, &payload));
            milliseconds(20).await;
            let answer = answers.borrow_mut().echoes.pop().unwrap_or_default();
            assert_eq!(answer.get(28..), Some(&payload[..]), "{length} bytes");
            assert_eq!(answer[26..28], (length as u16).to_be_bytes());
        }
    });
}

#[test]
fn a_ping_to_everybody_is_not_answered() {
    play(Some(key()), |world| async move {
        let answers = collect(&world);
        introduce(&world);
        for to in [Ipv4Addr::BROADCAST, Ipv4Addr::new(10, 0, 0, 255), mdns::GROUP, ROBOT] {
            let mut frame = network::ping(CARD, PEER, to, 1, &[1; 56]);
            frame[..6].fill(0xff);
            world.wire.inject(frame);
        }
        milliseconds(100).await;
        assert_eq!(answers.borrow().echoes.len(), 0);
    });
}

#[test]
fn floods_of_pings_keep_nothing_from_an_operator() {
    const FLOOD_A_TICK: u16 = 2;
    // From a peer, and in the name of addresses that nobody has.
    for is_forged in [false, true] {
        play(Some(key()), |world| async move {
            let answers = collect(&world);
            introduce(&world);
            let mut operator = Operator::new(&world);
            operator.connect().await;
            let wire = world.wire.clone();
            let flood = async {
                for number in 0.. {
                    for _ in 0..FLOOD_A_TICK {
                        let forged = Ipv4Addr::new(10, 0, 0, 100 + (number % 100) as u8);
                        let from = if is_forged { forged } else { PEER };
                        wire.inject(network::ping(CARD, from, ROBOT, number, &[1; 56]));
                    }
                    Timer::after(TICK).await;
                }
            };
            select(operator.ping_for(2_000), flood).await;
            let (heard, telemetry) = (operator.outcomes.len(), operator.telemetry);
            assert!(heard >= 97 && telemetry >= 95, "{heard} answers, {telemetry} telemetry");
            let echoes = answers.borrow().echoes.len();
            assert!(echoes <= 2_010, "{echoes} pings answered in 2 s");
            assert!(is_forged || echoes >= 1_900, "{echoes} pings answered in 2 s");
        });
    }
}

#[test]
fn a_thousand_pings_a_second_are_answered() {
    play(Some(key()), |world| async move {
        let answers = collect(&world);
        introduce(&world);
        for number in 0..1_000 {
            world.wire.inject(network::ping(CARD, PEER, ROBOT, number, &[1; 56]));
            milliseconds(1).await;
        }
        let echoes = answers.borrow().echoes.len();
        assert!(echoes >= 990, "{echoes}");
    });
}

/// Returns packets that no socket and no protocol of the robot takes, short and long.
fn unwanted() -> Vec<Vec<u8>> {
    let (from, to) = (SocketAddrV4::new(PEER, 1), SocketAddrV4::new(ROBOT, 9));
    let datagrams = [0, 7, 8, 28, 100, 600, 1_400].map(|it| vec![0; it]);
    let others = [6, 41, 47, 50, 132].map(|it| network::packet(CARD, it, PEER, ROBOT, &[0; 40]));
    let datagrams = datagrams.iter().map(|it| network::datagram(CARD, from, to, it));
    datagrams.chain(others).collect()
}

#[test]
fn errors_of_icmp_are_no_longer_than_their_cause() {
    play(Some(key()), |world| async move {
        let answers = collect(&world);
        introduce(&world);
        for cause in unwanted() {
            world.wire.inject(cause.clone());
            milliseconds(200).await;
            let errors = core::mem::take(&mut answers.borrow_mut().errors);
            let cause = &cause[14..];
            let bytes: usize = errors.iter().map(Vec::len).sum();
            assert!(bytes <= cause.len(), "{bytes} bytes for {}", cause.len());
            assert_eq!(errors.len(), usize::from(cause.len() >= 56), "{}", cause.len());
            for error in errors {
                // The cause's header and the eight bytes behind it (RFC 792), but for what the stack fills in anew.
                assert_eq!((&error[28..32], &error[37..38]), (&cause[..4], &cause[9..10]));
                assert_eq!(error[40..56], cause[12..28]);
            }
        }
    });
}

#[test]
fn errors_of_icmp_are_at_most_ten_a_second() {
    play(Some(key()), |world| async move {
        let answers = collect(&world);
        introduce(&world);
        let unwanted = unwanted();
        for number in 0..3_000 {
            world.wire.inject(unwanted[number % unwanted.len()].clone());
            milliseconds(1).await;
        }
        let errors = answers.borrow().errors.len();
        assert!((25..=31).contains(&errors), "{errors} errors in 3 s");
    });
}
