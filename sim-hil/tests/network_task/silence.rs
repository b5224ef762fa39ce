//! A network that is connected and carries no frame.
use flix_firmware::joining::SILENCE;
use flix_sim::rig::network_task::ROUTER;

use super::conflict::request;
use super::*;

#[test]
fn a_robot_hears_a_gateway_that_answers_and_silence_where_nobody_does_until_the_link_comes_up_anew()
{
    play(Some(key()), |world| async move {
        let (wire, answers) = (world.wire.clone(), Rc::new(Cell::new(true)));
        let is_there = answers.clone();
        world.wire.watch(move |frame| {
            if request(frame) == Some([ROBOT, ROUTER]) && is_there.get() {
                wire.inject(arp(Arp::Reply, 66, ROUTER, ROBOT));
            }
        });
        let silence = || world.network.guard.silence().unwrap();
        Timer::after(Duration::from_secs(66)).await;
        assert!(silence() < Duration::from_secs(5).into(), "{:?}", silence());
        answers.set(false);
        Timer::after(Duration::from_secs(124)).await;
        assert!(silence() > SILENCE, "{:?}", silence());
        world.network.plug(false);
        Timer::after(Duration::from_secs(1)).await;
        world.network.plug(true);
        Timer::after(Duration::from_secs(1)).await;
        assert!(silence() < Duration::from_secs(2).into(), "{:?}", silence());
    });
}
