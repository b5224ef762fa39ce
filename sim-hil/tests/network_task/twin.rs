//! Two robots of one name in one network.
use flix_firmware::mdns::{ANSWER_LENGTH, Responder};

use super::*;

const EVERYBODY: IpEndpoint = IpEndpoint::new(IpAddress::Ipv4(mdns::GROUP), mdns::PORT);

/// Answers as another robot called `name` at the operator's address, until `end`.
async fn live_beside(world: &World, name: &str, end: u64) {
    world.network.stack.join_multicast_group(mdns::GROUP).unwrap();
    let socket = world.network.socket(mdns::PORT);
    let responder = Responder::new(name, "bench", DEFAULT_PORT);
    let (mut buffer, mut answer) = ([0; 1536], [0; ANSWER_LENGTH]);
    let robot = SocketAddr::from((ROBOT, mdns::PORT));
    loop {
        let over = Timer::at(embassy_time::Instant::from_millis(end));
        let Either::Second(received) = select(over, socket.recv_from(&mut buffer)).await else {
            return;
        };
        let query = &buffer[..received.unwrap().0];
        if let Some((_, length)) = responder.answer(OPERATOR, robot, query, &mut answer) {
            socket.send_to(&answer[..length], EVERYBODY).await.unwrap();
        }
    }
}

#[test]
fn a_robot_that_starts_beside_another_one_of_its_name_says_so() {
    for (name, said) in [("daisy", vec![OPERATOR]), ("DAISY", vec![OPERATOR]), ("rose", vec![])] {
        play(Some(key()), |world| async move {
            live_beside(&world, name, 3_000).await;
            assert_eq!(*world.brain.twins.borrow(), said, "{name}");
        });
    }
}

#[test]
fn a_robot_beside_which_another_one_of_its_name_starts_says_so_once_a_minute() {
    play(Some(key()), |world| async move {
        let socket = world.network.socket(mdns::PORT);
        let responder = Responder::new("daisy", "bench", DEFAULT_PORT);
        let mut said = Vec::new();
        for seconds in 3..70 {
            Timer::at(embassy_time::Instant::from_secs(seconds)).await;
            said.push(world.brain.twins.borrow().len());
            let mut datagram = [0; ANSWER_LENGTH];
            let length = match seconds % 2 {
                0 => responder.announcement(OPERATOR, &mut datagram),
                _ => responder.probe(OPERATOR, &mut datagram),
            };
            socket.send_to(&datagram[..length.unwrap()], EVERYBODY).await.unwrap();
        }
        assert_eq!((said[0], said[1], said[60], said[62]), (0, 1, 1, 2), "{said:?}");
    });
}

#[test]
fn what_a_robot_says_of_itself_and_comes_back_is_no_other_robot() {
    play(Some(key()), |world| async move {
        let wire = world.wire.clone();
        world.wire.watch(move |frame| wire.inject(frame.to_vec()));
        Timer::after(Duration::from_secs(5)).await;
        assert_eq!(*world.brain.twins.borrow(), Vec::<Ipv4Addr>::new());
    });
}
