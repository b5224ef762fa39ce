//! Serial frames: found after any noise, refused when damaged in any way.

use flix_protocol::provision::{FrameReader, Provisioning, Request, write_frame};
use flix_protocol::session::{Key, Operator};
use proptest::prelude::*;

fn request() -> impl Strategy<Value = Request> {
    let operator = ("[a-zA-Z0-9]{1,16}", prop::array::uniform32(1_u8..))
        .prop_map(|(name, key)| Operator::new(name.parse().unwrap(), &Key::new(key)));
    let provisioning =
        ("[a-zA-Z0-9]{1,31}", prop::collection::vec(1_u8.., 1..=32), "[ -~]{8,63}|[0-9a-f]{64}")
            .prop_map(|(name, network, password)| {
                Provisioning::new(&name, &network, &password, None).unwrap()
            });
    prop_oneof![
        Just(Request::Identify),
        Just(Request::Forget),
        Just(Request::Operators),
        Just(Request::Network),
        any::<(u8, u8)>().prop_map(|(number, from)| Request::Scan { number, from }),
        any::<([u8; 16], [u8; 8])>().prop_map(|(challenge, id)| Request::Prove(challenge, id)),
        (provisioning.clone(), operator.clone(), any::<[u8; 8]>())
            .prop_map(|(it, operator, id)| Request::Keep(it, operator.name(), id)),
        (provisioning, operator.clone())
            .prop_map(|(it, operator)| Request::Provision(it, operator)),
        operator.clone().prop_map(Request::Add),
        operator.prop_map(|operator| Request::Revoke(operator.name())),
    ]
}

fn read(bytes: &[u8]) -> Vec<Request> {
    let mut reader = FrameReader::new();
    bytes.iter().filter_map(|&byte| reader.push(byte)).collect()
}

#[test]
fn a_proof_is_good_for_its_key_and_its_challenge_alone() {
    let key = |number| Key::new([number; 32]);
    let proof = key(1).prove(&[2; 16]);
    let good = [(1, 2), (3, 2), (1, 3)].map(|(of, to)| key(of).is_proved(&[to; 16], &proof));
    assert_eq!(good, [true, false, false]);
}

proptest! {
    #[test]
    fn noise_never_becomes_a_request(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        prop_assert_eq!(read(&bytes), []);
    }

    #[test]
    fn a_request_is_found_after_any_noise(
        noise in prop::collection::vec(any::<u8>(), 0..600),
        request in request(),
    ) {
        let stream = [noise.as_slice(), &write_frame(&request).unwrap()].concat();
        prop_assert_eq!(read(&stream), [request]);
    }

    #[test]
    fn a_frame_cut_short_or_with_bytes_changed_is_no_request(
        request in request(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), 1_u8..), 1..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let frame = write_frame(&request).unwrap();
        let mut changed = frame.to_vec();
        // The delimiters stay: without them there is no frame to damage.
        let inner = 1..frame.len() - 1;
        for (place, flip) in changes {
            changed[inner.start + place.index(inner.len())] ^= flip;
        }
        prop_assume!(changed != frame.as_slice());
        prop_assert_eq!(read(&changed), []);
        let short = &frame[..1 + cut.index(inner.len())];
        prop_assert_eq!(read(&[short, &[0]].concat()), []);
    }
}
