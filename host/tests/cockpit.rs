//! The cockpit's pages in virtual time: who drives, who may stop, and what a page's silence does.
use std::net::SocketAddr;
use std::time::Duration;

use crate::support::{FakeRobot, key};
use flix_host::link::{Client, Update};
use flix_host::teleop::Cockpit;
use flix_host::teleop::action::Action;
use flix_host::teleop::page::message::{Message, Request};
use flix_host::teleop::page::pages::{Misuse, PageId, Pages, SIGN_OF_LIFE};
use flix_host::teleop::page::snapshot::snapshot;
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::{
    Command, Event, EventReport, Fault, Halt, Order, Request as Asked, Setpoint, State, ToRobot,
};
use flix_protocol::units::{Instant, Volts};
use serde_json::json;

/// Interval of a page's signs of life.
const FRAME: Duration = Duration::from_millis(33);
/// A page, and another.
const ANNA: PageId = 1;
const BOB: PageId = 2;
/// Time in which a robot that is left alone must rest.
const REST: Duration = Duration::from_secs(1);

/// Pages and their robot, which answers at once.
struct Room {
    now: Instant,
    client: Client,
    robot: FakeRobot,
    cockpit: Cockpit,
    pages: Pages,
    /// Pages that show each snapshot and answer it, this much late.
    lively: Vec<(PageId, Duration)>,
    answered: Instant,
}

impl Room {
    fn new() -> Self {
        let now = Instant::from_micros(5_000_000);
        let mut room = Self {
            now,
            client: Client::new(key(), [9; 32], now),
            robot: FakeRobot::new(Some(key())),
            cockpit: Cockpit::new("walker-3f2c", now),
            pages: Pages::default(),
            lively: Vec::new(),
            answered: now,
        };
        room.open(ANNA);
        room.run(Duration::from_millis(700));
        room
    }

    fn walking() -> Self {
        let mut room = Self::new();
        room.act(ANNA, Action::Arm);
        room.act(ANNA, Action::Walk(PaperMode::Forward));
        assert_eq!(room.robot.setpoint, PaperMode::Forward.setpoint());
        room
    }

    fn open(&mut self, page: PageId) {
        self.pages.open(page, self.now);
        self.lively.push((page, Duration::ZERO));
    }

    /// Says something that was decided this long ago.
    fn say(&mut self, page: PageId, request: Option<Request>, age: Duration) -> Result<(), Misuse> {
        let seen = Pages::stamp(self.now) - age.as_millis() as u64;
        let message = Message { seen, request, press: None };
        self.pages.receive(page, message, &mut self.cockpit, &mut self.client, self.now)
    }

    fn act(&mut self, page: PageId, action: Action) {
        self.ask(page, Request::Act(action));
    }

    fn ask(&mut self, page: PageId, request: Request) {
        self.say(page, Some(request), Duration::ZERO).unwrap();
        self.run(Duration::from_millis(100));
    }

    fn run(&mut self, duration: Duration) {
        let operator: SocketAddr = "10.0.0.1:5000".parse().unwrap();
        let end = self.now + duration;
        while self.now < end {
            if self.now.since(self.answered) >= FRAME {
                self.answered = self.now;
                for (page, age) in self.lively.clone() {
                    self.say(page, None, age).unwrap();
                }
            }
            self.pages.watch(&mut self.cockpit, &mut self.client, self.now);
            self.cockpit.watch(&mut self.client, self.now);
            let mut answers = self.robot.tick(self.now);
            while let Some(frame) = self.client.transmit(self.now) {
                answers.extend(self.robot.receive(self.now, operator, &frame));
            }
            for (_, datagram) in answers {
                self.client.receive(self.now, &datagram);
            }
            while let Some(update) = self.client.update() {
                self.cockpit.observe(&update, &mut self.client, self.now);
            }
            self.cockpit.tick(&self.client, self.now);
            self.now = self.now + Duration::from_millis(1);
        }
    }

    /// Counts how often the robot was ordered to arm.
    fn armings(&self) -> usize {
        let is_arm = |it: &&ToRobot| matches!(it, ToRobot::Order(Order::Arm(_)));
        self.robot.messages.iter().filter(is_arm).count()
    }

    fn log(&self) -> String {
        self.cockpit.log.iter().map(|line| format!("{}\n", line.text)).collect()
    }
}

#[test]
fn every_mode_of_a_page_drives_its_pair() {
    for mode in PaperMode::ALL {
        let mut room = Room::walking();
        room.act(ANNA, Action::Walk(mode));
        assert_eq!(room.robot.setpoint, mode.setpoint(), "{mode:?}");
    }
}

#[test]
fn a_page_that_goes_on_to_look_goes_on_to_walk() {
    let mut room = Room::walking();
    room.run(Duration::from_secs(30));
    assert_eq!(
        (room.robot.state, room.robot.setpoint),
        (State::Running, PaperMode::Forward.setpoint())
    );
}

#[test]
fn a_page_that_freezes_is_a_silent_operator() {
    let mut room = Room::walking();
    room.lively.clear();
    room.run(SIGN_OF_LIFE + 2 * FRAME);
    assert_eq!(room.robot.setpoint, Setpoint::REST);
    room.run(REST);
    assert_eq!(room.robot.state, State::Disarmed);
}

#[test]
fn a_page_that_thaws_does_not_walk_on() {
    let mut room = Room::walking();
    room.lively.clear();
    room.run(Duration::from_millis(500));
    room.lively.push((ANNA, Duration::ZERO));
    room.run(Duration::from_secs(2));
    assert_eq!((room.robot.state, room.robot.setpoint), (State::Armed, Setpoint::REST));
    room.act(ANNA, Action::Walk(PaperMode::LeftTurn));
    assert_eq!(room.robot.setpoint, PaperMode::LeftTurn.setpoint());
}

#[test]
fn signs_of_life_that_were_held_back_are_none() {
    let mut room = Room::walking();
    room.lively = vec![(ANNA, SIGN_OF_LIFE + Duration::from_millis(10))];
    room.run(SIGN_OF_LIFE + 2 * FRAME);
    assert_eq!(room.robot.setpoint, Setpoint::REST);
}

#[test]
fn a_command_that_was_held_back_moves_nothing() {
    let mut room = Room::walking();
    room.act(ANNA, Action::Rest);
    let late = SIGN_OF_LIFE + Duration::from_millis(1);
    room.say(ANNA, Some(Request::Act(Action::Walk(PaperMode::Forward))), late).unwrap();
    room.run(Duration::from_millis(100));
    assert_eq!(room.robot.setpoint, Setpoint::REST);
    assert!(room.log().contains("too slow"), "{}", room.log());
}

#[test]
fn stop_rest_and_disarm_are_done_however_late() {
    let late = Duration::from_secs(3);
    for (action, state) in [
        (Action::Stop, State::Disarmed),
        (Action::Rest, State::Armed),
        (Action::Disarm, State::Disarmed),
    ] {
        let mut room = Room::walking();
        room.say(ANNA, Some(Request::Act(action)), late).unwrap();
        room.run(REST);
        assert_eq!((room.robot.state, room.robot.stopped), (state, action == Action::Stop));
    }
}

#[test]
fn a_page_that_is_closed_disarms_the_robot() {
    let mut room = Room::walking();
    room.lively.clear();
    room.pages.close(ANNA, &mut room.cockpit, &mut room.client, room.now);
    room.run(REST);
    assert_eq!((room.robot.state, room.robot.stopped), (State::Disarmed, false));
}

#[test]
fn a_robot_that_is_armed_with_nothing_held_is_disarmed_too_and_once() {
    for is_closed in [true, false] {
        let mut room = Room::walking();
        // Commands came late: it ramped down, and is still armed.
        room.robot.reports_of_late_commands = 1;
        room.run(Duration::from_millis(200));
        assert_eq!(room.client.held(), Some(Setpoint::REST));
        assert_eq!(room.robot.state, State::Armed);
        room.lively.clear();
        if is_closed {
            room.pages.close(ANNA, &mut room.cockpit, &mut room.client, room.now);
        }
        room.run(2 * REST);
        assert_eq!(room.robot.state, State::Disarmed, "{is_closed}");
        assert_eq!(room.log().matches("the robot is disarmed").count(), 1, "{}", room.log());
    }
}

#[test]
fn a_robot_is_asked_to_disarm_until_it_is_disarmed_or_armed_anew() {
    let is_off: fn(&ToRobot) -> bool = |it| *it == ToRobot::Order(Order::Off);
    let lost = Duration::from_millis(200);
    let mut room = Room::walking();
    room.robot.loses = is_off;
    room.lively.clear();
    room.pages.close(ANNA, &mut room.cockpit, &mut room.client, room.now);
    room.run(lost);
    assert_eq!(room.robot.state, State::Running, "nothing asked it");
    room.robot.loses = |_| false;
    room.run(Duration::from_millis(50));
    assert_eq!(room.robot.state, State::Disarmed);
    // Whoever arms it means that.
    let mut room = Room::walking();
    room.robot.loses = is_off;
    room.act(ANNA, Action::Disarm);
    room.robot.loses = |_| false;
    room.robot.ramps_down_for = 10;
    room.run(Duration::from_millis(50));
    room.act(ANNA, Action::Arm);
    room.run(REST);
    assert_eq!(room.robot.state, State::Armed);
}

#[test]
fn a_robot_that_halted_meanwhile_is_not_armed_by_enter_however_often_it_was_pressed_before() {
    let mut room = Room::new();
    room.robot.ramps_down_for = 1000;
    for _ in 0..2 {
        room.act(ANNA, Action::Arm);
        room.run(Duration::from_millis(50));
    }
    room.robot.halt();
    room.run(Duration::from_millis(50));
    room.robot.ramps_down_for = 0;
    room.run(Duration::from_secs(4));
    assert_eq!(room.robot.state, State::Disarmed);
}

#[test]
fn a_second_page_watches_and_may_only_stop() {
    let mut room = Room::walking();
    room.open(BOB);
    for action in
        [Action::Rest, Action::Disarm, Action::Walk(PaperMode::LeftTurn), Action::Frequency(1.0)]
    {
        room.act(BOB, action);
        assert_eq!(room.robot.setpoint, PaperMode::Forward.setpoint(), "{action:?}");
    }
    room.act(BOB, Action::Stop);
    assert!(room.robot.stopped);
}

#[test]
fn a_press_that_is_said_again_stops_once_and_is_stated_as_heard() {
    let mut room = Room::walking();
    room.open(BOB);
    let press = |room: &mut Room, page, press| {
        let request = Some(Request::Act(Action::Stop));
        let message = Message { seen: Pages::stamp(room.now), request, press: Some(press) };
        room.pages.receive(page, message, &mut room.cockpit, &mut room.client, room.now).unwrap();
        room.run(REST);
        let heard = snapshot(&room.cockpit, &room.pages, room.now)["presses"].clone();
        (room.robot.stopped, heard)
    };
    assert_eq!(press(&mut room, BOB, 7), (true, json!([7])));
    room.act(ANNA, Action::Clear);
    // By another connection, as if nobody had reported it.
    room.pages.close(BOB, &mut room.cockpit, &mut room.client, room.now);
    room.open(BOB + 1);
    assert_eq!(press(&mut room, BOB + 1, 7), (false, json!([7])));
    assert_eq!(press(&mut room, BOB + 1, 8), (true, json!([7, 8])));
}

#[test]
fn a_robot_rests_whose_operator_has_touched_nothing_for_long() {
    let mut room = Room::walking();
    room.cockpit.be_attended(Duration::from_secs(3), room.now);
    room.run(Duration::from_secs(2));
    room.ask(ANNA, Request::Attend);
    room.open(BOB);
    room.run(Duration::from_secs(2));
    assert_eq!(room.robot.setpoint, PaperMode::Forward.setpoint());
    let rests_in = &snapshot(&room.cockpit, &room.pages, room.now)["rests_in_s"];
    assert_eq!(*rests_in, json!(1));
    // Who watches drives nothing, and keeps nothing from resting.
    room.ask(BOB, Request::Attend);
    room.run(Duration::from_secs(1));
    assert_eq!(room.robot.setpoint, Setpoint::REST);
    assert!(room.log().contains("for 3 s: the robot rests"), "{}", room.log());
}

#[test]
fn a_watching_page_is_no_sign_of_life_of_the_one_that_drives() {
    let mut room = Room::walking();
    room.open(BOB);
    room.lively.retain(|(page, _)| *page == BOB);
    room.run(REST);
    assert_eq!(room.robot.setpoint, Setpoint::REST);
}

#[test]
fn taking_over_is_explicit_and_begins_at_rest() {
    let mut room = Room::walking();
    room.open(BOB);
    assert_eq!(room.pages.driver(), Some(ANNA));
    room.say(BOB, Some(Request::Drive), Duration::ZERO).unwrap();
    room.run(Duration::from_millis(100));
    assert_eq!((room.pages.driver(), room.robot.setpoint), (Some(BOB), Setpoint::REST));
    room.act(ANNA, Action::Walk(PaperMode::Forward));
    assert_eq!(room.robot.setpoint, Setpoint::REST);
    room.act(BOB, Action::Walk(PaperMode::RightTurn));
    assert_eq!(room.robot.setpoint, PaperMode::RightTurn.setpoint());
}

#[test]
fn a_page_that_watches_does_not_begin_to_drive_when_the_other_is_closed() {
    let mut room = Room::walking();
    room.open(BOB);
    room.pages.close(ANNA, &mut room.cockpit, &mut room.client, room.now);
    assert_eq!((room.pages.driver(), room.pages.count()), (None, 1));
}

#[test]
fn a_page_that_has_seen_the_future_is_not_believed() {
    let mut room = Room::walking();
    let message = Message { seen: Pages::stamp(room.now) + 1, request: None, press: None };
    let received = room.pages.receive(ANNA, message, &mut room.cockpit, &mut room.client, room.now);
    assert_eq!(received, Err(Misuse));
}

#[test]
fn a_page_that_is_expelled_stops_the_robot() {
    let mut room = Room::walking();
    room.pages.expel(ANNA, &mut room.cockpit, &mut room.client, room.now);
    room.lively.clear();
    room.run(REST);
    assert!(room.robot.stopped);
    assert_eq!(room.pages.driver(), None);
}

#[test]
fn a_page_that_is_expelled_is_heard_no_more_and_stops_no_robot_again() {
    let mut room = Room::walking();
    room.open(BOB);
    room.pages.expel(ANNA, &mut room.cockpit, &mut room.client, room.now);
    room.lively.retain(|page| page.0 == BOB);
    room.ask(ANNA, Request::Drive);
    assert_eq!(room.pages.driver(), None);
    room.ask(BOB, Request::Drive);
    room.act(BOB, Action::Clear);
    assert!(!room.robot.stopped);
    // What it had still to say, and the end of its socket.
    room.act(ANNA, Action::Stop);
    room.pages.expel(ANNA, &mut room.cockpit, &mut room.client, room.now);
    room.run(REST);
    assert!(!room.robot.stopped && room.pages.driver() == Some(BOB));
}

#[test]
fn a_snapshot_explains_a_fault_and_states_who_drives() {
    let mut room = Room::new();
    room.act(ANNA, Action::Arm);
    room.robot.fault_when_running = Some(Fault::Stall);
    room.act(ANNA, Action::Walk(PaperMode::Forward));
    let seen = snapshot(&room.cockpit, &room.pages, room.now);
    assert_eq!((&seen["driver"], &seen["telemetry"]["state"]), (&1.into(), &"faulted".into()));
    let help = seen["telemetry"]["faults"][0]["help"].as_str().unwrap();
    assert!(help.contains("free the rotor"), "{help}");
}

#[test]
fn a_page_that_watches_is_told_whether_another_one_drives() {
    let mut room = Room::new();
    room.open(BOB);
    room.act(BOB, Action::Arm);
    assert!(room.log().contains("another page drives"), "{}", room.log());
    let now = room.now;
    room.pages.close(ANNA, &mut room.cockpit, &mut room.client, now);
    room.act(BOB, Action::Arm);
    assert!(room.log().contains("no page drives: take over first"), "{}", room.log());
}

#[test]
fn every_page_sees_the_settings_and_the_driver_changes_them() {
    let mut room = Room::new();
    room.open(BOB);
    assert!(room.cockpit.settings.entries().is_empty());
    room.ask(BOB, Request::Settings);
    let name = room.robot.parameters[0].name.clone();
    let (before, other) = (room.robot.parameters[0].value, room.robot.parameters[0].minimum);
    assert_ne!(before, other);
    assert_eq!(room.cockpit.settings.entries(), room.robot.parameters);

    room.ask(BOB, Request::Set(name.clone(), other.to_string()));
    assert_eq!(room.robot.parameters[0].value, before);
    assert!(room.log().contains("another page drives"), "{}", room.log());

    let revision = room.cockpit.settings.revision();
    room.ask(ANNA, Request::Set(name.clone(), other.to_string()));
    assert_eq!(room.robot.parameters[0].value, other);
    assert_eq!(room.cockpit.settings.value(&name), Some(other));
    assert!(room.cockpit.settings.revision() > revision);

    room.ask(ANNA, Request::Save);
    assert!(room.log().contains("the settings are saved"), "{}", room.log());
}

#[test]
fn a_refused_change_is_said_and_the_settings_are_read_again() {
    let mut room = Room::new();
    room.ask(ANNA, Request::Settings);
    let revision = room.cockpit.settings.revision();
    room.ask(ANNA, Request::Set("no_such_setting".try_into().unwrap(), "1".into()));
    assert!(room.log().contains("not done"), "{}", room.log());
    assert!(room.cockpit.settings.revision() > revision);
}

#[test]
fn a_low_battery_that_comes_and_goes_is_noted_once() {
    let mut room = Room::new();
    for number in 0..15 {
        let event = Event::BatteryLow(Volts::new(9.5).unwrap());
        let report = Update::Event(EventReport { number, time: room.now, event });
        room.cockpit.observe(&report, &mut room.client, room.now);
        room.run(Duration::from_millis(200));
    }
    assert_eq!(room.log().matches("battery low").count(), 1, "{}", room.log());
}

#[test]
fn a_value_is_what_its_operator_wrote_or_is_refused_at_its_field() {
    let mut room = Room::new();
    room.ask(ANNA, Request::Settings);
    let name = room.robot.parameters[0].name.clone();
    let mut write = |text: &str| {
        room.ask(ANNA, Request::Set(name.clone(), text.into()));
        let refusal = room.cockpit.settings.refusal(&name).map(ToOwned::to_owned);
        (room.robot.parameters[0].value, refusal)
    };
    assert_eq!(write("500 mA"), (0.5, None));
    for text in [
        "",
        "2,6",
        "1,500",
        "\u{2212}1",
        "26",
        "1e39",
        "NaN",
        "1.2.3",
        "2 V",
        "on",
        "0x1",
        "\u{ff11}",
    ] {
        let (value, refusal) = write(text);
        assert!(value == 0.5 && refusal.is_some(), "{text}: {value}, {refusal:?}");
    }
    assert_eq!(write("1.5"), (1.5, None));
}

#[test]
fn only_the_driver_begins_a_capture_and_wrong_channels_are_said() {
    let mut room = Room::new();
    room.open(BOB);
    let scope = |channels: &str, when: &str| Request::Scope(channels.into(), when.into());
    let asked = |room: &Room| {
        room.robot
            .messages
            .iter()
            .filter(|it| matches!(it, ToRobot::Request(Asked { command: Command::Scope(_), .. })))
            .count()
    };
    room.ask(BOB, scope("iq", "now"));
    assert_eq!(asked(&room), 0);
    room.ask(ANNA, scope("amps", "now"));
    assert_eq!(asked(&room), 0);
    assert!(room.log().contains("there is no channel `amps`"), "{}", room.log());
    room.ask(ANNA, scope("iq", "now"));
    assert_eq!(asked(&room), 1);
    // The robot of this test has no scope.
    assert!(room.log().contains("no complete capture"), "{}", room.log());
}

#[test]
fn a_change_that_is_too_old_is_not_done() {
    let mut room = Room::new();
    let (name, value) = (room.robot.parameters[0].name.clone(), room.robot.parameters[0].value);
    let change = Request::Set(name, room.robot.parameters[0].minimum.to_string());
    room.say(ANNA, Some(change), SIGN_OF_LIFE + FRAME).unwrap();
    room.run(Duration::from_millis(300));
    assert_eq!(room.robot.parameters[0].value, value);
}

#[test]
fn settings_are_read_again_from_a_robot_that_restarts() {
    let mut room = Room::new();
    room.ask(ANNA, Request::Settings);
    let revision = room.cockpit.settings.revision();
    room.robot.restart();
    room.robot.parameters[0].value = room.robot.parameters[0].minimum;
    room.run(Duration::from_secs(4));
    assert!(room.cockpit.settings.revision() > revision, "{}", room.log());
    assert_eq!(room.cockpit.settings.entries(), room.robot.parameters);
}

#[test]
fn who_drives_already_and_asks_to_drives_on() {
    let mut room = Room::walking();
    room.ask(ANNA, Request::Drive);
    assert_eq!(room.robot.setpoint, PaperMode::Forward.setpoint());
}

#[test]
fn a_snapshot_counts_the_open_pages() {
    let mut room = Room::new();
    let count = |room: &Room| snapshot(&room.cockpit, &room.pages, room.now)["pages"].clone();
    assert_eq!(count(&room), 1);
    room.open(BOB);
    assert_eq!(count(&room), 2);
    room.pages.close(BOB, &mut room.cockpit, &mut room.client, room.now);
    assert_eq!(count(&room), 1);
}

#[test]
fn a_robot_that_disarmed_by_itself_is_not_armed_again_by_the_same_enter() {
    for states_nothing in [true, false] {
        let mut room = Room::new();
        // The robot is not heard again before it disarms.
        room.robot.is_mute = states_nothing;
        room.act(ANNA, Action::Arm);
        assert_eq!(room.robot.state, State::Armed);
        room.robot.lose_link();
        room.run(Duration::from_millis(300));
        room.robot.is_mute = false;
        room.run(Duration::from_secs(3));
        assert_eq!(room.robot.state, State::Disarmed);
        assert_eq!(room.client.order(), Order::Off);
    }
}

#[test]
fn a_robot_that_disarmed_by_itself_is_not_armed_again_by_a_second_enter_from_before() {
    let mut room = Room::new();
    room.act(ANNA, Action::Arm);
    assert_eq!(room.robot.state, State::Armed);
    room.robot.is_deaf = true;
    room.act(ANNA, Action::Arm);
    room.run(Duration::from_millis(1_200));
    assert_eq!(room.cockpit.telemetry.unwrap().state, State::Disarmed);
    room.robot.is_deaf = false;
    room.run(Duration::from_secs(3));
    assert_eq!(room.robot.state, State::Disarmed);
}

#[test]
fn enter_is_dead_when_its_patience_is_over() {
    let mut room = Room::new();
    room.robot.is_unproven = true;
    room.act(ANNA, Action::Arm);
    room.run(Duration::from_millis(2_850));
    assert!(!room.log().contains("not done"), "{}", room.log());
    room.run(Duration::from_millis(100));
    assert!(room.log().contains("not done: the link has not been"), "{}", room.log());
    room.robot.is_unproven = false;
    room.run(Duration::from_secs(1));
    assert_eq!(room.robot.state, State::Disarmed, "armed after 3 s: {}", room.log());
}

#[test]
fn enter_that_ended_without_an_answer_is_said() {
    let mut room = Room::new();
    room.robot.loses = |it| matches!(it, ToRobot::Order(Order::Arm(_)));
    room.act(ANNA, Action::Arm);
    room.run(Duration::from_secs(6));
    assert!(room.log().contains("the robot did not answer"), "{}", room.log());
}

#[test]
fn enter_that_is_given_up_for_a_halt_is_said() {
    let mut room = Room::new();
    room.robot.ramps_down_for = 100;
    room.act(ANNA, Action::Arm);
    room.robot.halt();
    room.run(Duration::from_millis(100));
    assert!(room.log().contains("not done: the robot halted by itself"), "{}", room.log());
}

#[test]
fn who_takes_over_takes_no_arming_over() {
    let waits: [fn(&mut FakeRobot); 2] =
        [|robot| robot.ramps_down_for = 20, |robot| robot.is_unproven = true];
    for (place, waits) in waits.into_iter().enumerate() {
        let mut room = Room::new();
        room.open(BOB);
        waits(&mut room.robot);
        room.act(ANNA, Action::Arm);
        room.ask(BOB, Request::Drive);
        assert_eq!(room.pages.driver(), Some(BOB));
        room.robot.is_unproven = false;
        room.run(Duration::from_secs(3));
        assert_eq!(room.robot.state, State::Disarmed, "{place}");
    }
}

#[test]
fn a_page_whose_picture_is_older_than_the_last_halt_begins_nothing() {
    let stale = Duration::from_millis(200);
    type Row = (fn(&mut FakeRobot), Action, fn(&FakeRobot) -> bool);
    let halts: [Row; 3] = [
        (FakeRobot::halt, Action::Arm, |robot| robot.state == State::Disarmed),
        (FakeRobot::halt, Action::Walk(PaperMode::LeftTurn), |robot| {
            robot.setpoint == Setpoint::REST
        }),
        (FakeRobot::stop_from_outside, Action::Clear, |robot| robot.stopped),
    ];
    for (halts, action, rests) in halts {
        let mut room = if action == Action::Arm { Room::new() } else { Room::walking() };
        halts(&mut room.robot);
        room.run(Duration::from_millis(100));
        room.say(ANNA, Some(Request::Act(action)), stale).unwrap();
        room.run(Duration::from_secs(1));
        assert!(rests(&room.robot), "{action:?}");
        assert!(room.log().contains("the robot has halted meanwhile"), "{}", room.log());
        room.act(ANNA, action);
        room.run(Duration::from_secs(1));
        assert!(!rests(&room.robot), "{action:?} of a page that shows the halt");
    }
}

#[test]
fn who_takes_over_takes_no_clearing_over() {
    let mut room = Room::walking();
    room.open(BOB);
    room.act(ANNA, Action::Stop);
    room.robot.ramps_down_for = 20;
    room.act(ANNA, Action::Clear);
    room.ask(BOB, Request::Drive);
    room.run(Duration::from_secs(3));
    assert!(room.robot.stopped);
}

#[test]
fn a_page_that_is_closed_clears_nothing_any_more() {
    for closes in [true, false] {
        let mut room = Room::walking();
        room.act(ANNA, Action::Stop);
        room.robot.ramps_down_for = 100;
        room.act(ANNA, Action::Clear);
        room.lively.clear();
        if closes {
            room.pages.close(ANNA, &mut room.cockpit, &mut room.client, room.now);
        }
        room.run(Duration::from_secs(3));
        assert!(room.robot.stopped, "{closes}");
    }
}

#[test]
fn arm_clear_arm_then_disarm_or_stop_leaves_it_disarmed() {
    for last in [Action::Disarm, Action::Stop, Action::Quit] {
        for ramps in [0, 1, 3, 10, 40] {
            let mut room = Room::new();
            room.robot.ramps_down_for = ramps;
            for action in [Action::Arm, Action::Clear, Action::Arm, last] {
                room.say(ANNA, Some(Request::Act(action)), Duration::ZERO).unwrap();
                room.run(Duration::from_millis(20));
            }
            room.run(Duration::from_millis(50));
            let armings = room.armings();
            room.robot.ramps_down_for = 0;
            room.act(ANNA, Action::Clear);
            room.run(Duration::from_secs(6));
            assert_eq!(room.robot.state, State::Disarmed, "{last:?} {ramps}");
            assert_eq!(room.armings(), armings, "{last:?} {ramps}");
        }
    }
}

#[test]
fn a_robot_is_ordered_to_arm_until_it_is_armed_and_not_once_it_refused() {
    let mut room = Room::new();
    room.robot.is_unproven = true;
    room.act(ANNA, Action::Arm);
    room.run(Duration::from_secs(2));
    assert!(matches!(room.client.order(), Order::Arm(_)));
    room.run(Duration::from_secs(2));
    assert_eq!(room.client.order(), Order::Off);
    // Nothing of the kind for a robot that is cleared.
    room.robot.fail(Fault::Stall);
    room.run(Duration::from_millis(100));
    room.act(ANNA, Action::Clear);
    assert_eq!(room.client.order(), Order::Off);
    assert!(room.robot.faults.is_empty());
}

#[test]
fn a_key_without_telemetry_does_nothing_and_that_is_said() {
    let mut room = Room::new();
    room.robot.is_mute = true;
    room.robot.restart();
    room.robot.is_mute = true;
    room.run(Duration::from_secs(3));
    room.act(ANNA, Action::Arm);
    assert!(room.log().contains("has not stated yet"), "{}", room.log());
    room.robot.is_mute = false;
    room.run(Duration::from_secs(2));
    assert_eq!(room.robot.state, State::Disarmed);
    room.act(ANNA, Action::Arm);
    assert_eq!(room.robot.state, State::Armed, "{}", room.log());
}

#[test]
fn a_walk_that_a_halt_ended_is_said_and_goes_on_only_by_a_key() {
    let mut room = Room::walking();
    room.robot.is_deaf = true;
    room.run(Duration::from_millis(300));
    assert_eq!(room.robot.halted_by, Halt::Rested);
    room.robot.is_deaf = false;
    room.run(REST);
    assert_eq!((room.robot.state, room.robot.setpoint), (State::Armed, Setpoint::REST));
    assert_eq!(room.cockpit.setpoint, Setpoint::REST);
    assert!(room.log().contains("not done: the robot halted by itself"), "{}", room.log());
    room.act(ANNA, Action::Walk(PaperMode::LeftTurn));
    assert_eq!(room.robot.setpoint, PaperMode::LeftTurn.setpoint());
}

#[test]
fn to_clear_where_nothing_is_latched_is_said_and_lets_a_walk_go_on() {
    let mut room = Room::walking();
    room.act(ANNA, Action::Clear);
    assert!(room.log().contains("nothing to clear"), "{}", room.log());
    assert_eq!(room.robot.setpoint, PaperMode::Forward.setpoint());
}

#[test]
fn a_walk_ends_with_its_session() {
    let mut room = Room::walking();
    room.robot.restart();
    room.run(Duration::from_secs(2));
    assert_eq!((room.cockpit.setpoint, room.robot.setpoint), (Setpoint::REST, Setpoint::REST));
    assert!(room.log().contains("fell silent"), "{}", room.log());
}
