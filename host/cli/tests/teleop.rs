//! The teleoperation screen: what it shows, as pictures kept in files, and what its keys do.
use std::net::SocketAddr;
use std::time::Duration;

use crate::support::{FakeRobot, key};
use flix_cli::teleop::keyboard::Typing;
use flix_cli::teleop::sequences::Sequences;
use flix_cli::teleop::view;
use flix_host::link::Client;
use flix_host::nav::PlanarPose;
use flix_host::pose::{Picture, Pose, PoseSample};
use flix_host::teleop::Cockpit;
use flix_host::teleop::action::Action;
use flix_host::teleop::cockpit::Sample;
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::{Fault, Setpoint, State};
use flix_protocol::units::Instant;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

/// An operator at the screen of a robot that answers at once.
pub struct Desk {
    now: Instant,
    client: Client,
    pub robot: FakeRobot,
    pub cockpit: Cockpit,
    is_cut: bool,
}

impl Desk {
    fn new() -> Self {
        let now = Instant::from_micros(5_000_000);
        let mut desk = Self {
            now,
            client: Client::new(key(), [9; 32], now),
            robot: FakeRobot::new(Some(key())),
            cockpit: Cockpit::new("walker-1", now),
            is_cut: false,
        };
        desk.run(Duration::from_millis(700));
        desk
    }

    pub fn armed() -> Self {
        let mut desk = Self::new();
        desk.press(Action::Arm);
        assert_eq!(desk.robot.state, State::Armed);
        desk
    }

    pub fn press(&mut self, action: Action) {
        self.cockpit.act(action, self.now, &mut self.client, self.now);
        self.run(Duration::from_millis(100));
    }

    pub fn run(&mut self, duration: Duration) {
        let operator: SocketAddr = "10.0.0.1:5000".parse().unwrap();
        let end = self.now + duration;
        while self.now < end {
            let mut answers = self.robot.tick(self.now);
            while let Some(frame) = self.client.transmit(self.now) {
                if !self.is_cut {
                    answers.extend(self.robot.receive(self.now, operator, &frame));
                }
            }
            for (_, datagram) in answers {
                if !self.is_cut {
                    self.client.receive(self.now, &datagram);
                }
            }
            while let Some(update) = self.client.update() {
                self.cockpit.observe(&update, &mut self.client, self.now);
            }
            self.cockpit.tick(&self.client, self.now);
            self.now = self.now + Duration::from_millis(1);
        }
    }

    fn picture(&self, width: u16, height: u16) -> String {
        self.shown(width, height).to_string()
    }

    pub fn shown(&self, width: u16, height: u16) -> TestBackend {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| view::draw(frame, &self.cockpit)).unwrap();
        terminal.backend().clone()
    }
}

#[test]
fn a_new_session_fits_80_by_24() {
    insta::assert_snapshot!(Desk::new().picture(80, 24));
}

#[test]
fn a_walk_shows_setpoint_rotors_and_force() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::LeftTurn));
    desk.run(Duration::from_secs(6));
    desk.press(Action::Walk(PaperMode::Forward));
    desk.run(Duration::from_secs(6));
    insta::assert_snapshot!(desk.picture(80, 24));
}

#[test]
fn a_small_terminal_shows_how_fast_it_shakes_and_how_it_stops() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    desk.run(Duration::from_secs(6));
    let picture = desk.picture(60, 10);
    for shown in ["RUNNING", "f -30.", "no faults", "space = stop"] {
        assert!(picture.contains(shown), "{shown}\n{picture}");
    }
}

#[test]
fn a_fault_is_shown_in_plain_words_with_its_first_cause() {
    let mut desk = Desk::armed();
    desk.robot.fault_when_running = Some(Fault::Stall);
    desk.press(Action::Walk(PaperMode::RightTurn));
    insta::assert_snapshot!(desk.picture(80, 24));
}

#[test]
fn a_silent_robot_is_shown_as_such() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    desk.is_cut = true;
    desk.run(Duration::from_millis(600));
    insta::assert_snapshot!(desk.picture(80, 24));
}

#[test]
fn a_larger_terminal_gives_room_to_histories_and_log() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::StrafeRight));
    desk.run(Duration::from_secs(20));
    insta::assert_snapshot!(desk.picture(120, 40));
}

#[test]
fn a_tiny_terminal_still_shows_state_and_stop() {
    let desk = Desk::armed();
    for (width, height) in [(1, 1), (10, 2), (79, 24), (80, 23), (40, 6), (300, 3)] {
        let picture = desk.picture(width, height);
        if width >= 40 {
            assert!(picture.contains("ARMED") && picture.contains("space = stop"), "{picture}");
        }
    }
}

#[test]
fn every_mode_key_drives_its_pair_of_table_iv() {
    for mode in PaperMode::ALL {
        let mut desk = Desk::armed();
        desk.press(Action::Walk(mode));
        assert_eq!(desk.robot.setpoint, mode.setpoint(), "{mode:?}");
        assert_eq!(desk.robot.state, State::Running);
    }
}

#[test]
fn f_and_theta_move_in_steps_and_stay_in_range() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    for _ in 0..20 {
        desk.press(Action::Frequency(-1.0));
        desk.press(Action::Direction(5.0));
    }
    assert_eq!(desk.robot.setpoint.frequency().get(), -35.0);
    assert_eq!(desk.robot.setpoint.direction().get(), 90.0);
    desk.press(Action::Frequency(0.1));
    assert_eq!(desk.robot.setpoint.frequency().get(), -34.9);
}

#[test]
fn a_key_that_is_held_changes_a_walk_and_is_no_new_wish() {
    let mut desk = Desk::armed();
    let up = Action::Frequency(1.0);
    let step = |desk: &mut Desk| {
        desk.cockpit.step(up, &mut desk.client, desk.now);
        desk.run(Duration::from_millis(100));
        desk.robot.setpoint.frequency().get()
    };
    assert_eq!(step(&mut desk), 0.0, "at rest");
    desk.press(Action::Walk(PaperMode::Forward));
    let wish = desk.client.order().permit();
    assert_eq!(step(&mut desk), -29.0);
    assert_eq!(desk.client.order().permit(), wish);
    // It comes to rest by itself: a key that is held moves it no more.
    desk.robot.halt();
    assert_eq!(step(&mut desk), 0.0, "rested");
    assert_eq!(step(&mut desk), 0.0, "rested");
    desk.press(Action::Walk(PaperMode::Forward));
    assert_eq!(step(&mut desk), -29.0);
    desk.press(Action::Stop);
    assert_eq!(step(&mut desk), 0.0, "stopped");
}

#[test]
fn a_step_of_f_begins_no_walk_and_one_to_zero_ends_it() {
    let mut desk = Desk::armed();
    for step in [1.0, -1.0, 30.0] {
        desk.press(Action::Frequency(step));
        assert_eq!(desk.robot.setpoint, Setpoint::REST);
    }
    desk.press(Action::Walk(PaperMode::RightTurn));
    for _ in 0..40 {
        desk.press(Action::Frequency(-1.0));
    }
    assert_eq!(desk.robot.setpoint.frequency().get(), 0.0);
}

#[test]
fn a_robot_without_an_operator_rests_and_the_time_left_is_shown() {
    let mut desk = Desk::armed();
    desk.cockpit.be_attended(Duration::from_secs(30), desk.now);
    desk.run(Duration::from_secs(60));
    assert_eq!(desk.cockpit.walks_for(), None, "it does not walk");
    desk.press(Action::Walk(PaperMode::Forward));
    desk.run(Duration::from_secs(20));
    insta::assert_snapshot!(desk.picture(80, 24));
    desk.cockpit.attend(desk.now);
    desk.run(Duration::from_secs(29));
    assert_eq!(desk.robot.setpoint, PaperMode::Forward.setpoint());
    for _ in 0..101 {
        desk.run(Duration::from_millis(10));
        desk.cockpit.watch(&mut desk.client, desk.now);
    }
    desk.run(Duration::from_millis(100));
    assert_eq!((desk.robot.setpoint, desk.robot.state), (Setpoint::REST, State::Armed));
    assert!(desk.cockpit.log.back().unwrap().text.contains("for 30 s: the robot rests"));
}

#[test]
fn a_line_of_force_at_90_degrees_does_not_seem_to_jump() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::LeftTurn));
    let mut telemetry = desk.robot.telemetry(desk.now);
    for (measured, shown) in [(89.5, 89.5), (-89.5, 90.5), (90.0, 90.0), (-90.0, 90.0)] {
        telemetry.direction = flix_protocol::units::Degrees::saturating(measured);
        assert_eq!(Sample::of(&telemetry).direction, shown);
    }
}

#[test]
fn nothing_moves_before_arming() {
    let mut desk = Desk::new();
    for action in [Action::Walk(PaperMode::Forward), Action::Frequency(1.0), Action::Direction(5.0)]
    {
        desk.press(action);
    }
    assert_eq!((desk.robot.state, desk.robot.setpoint), (State::Disarmed, Setpoint::REST));
    assert!(desk.cockpit.log.back().unwrap().text.contains("Enter"));
}

#[test]
fn stop_is_latched_until_cleared_and_then_armed_again() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    desk.press(Action::Stop);
    assert!(desk.robot.stopped);
    desk.press(Action::Arm);
    desk.press(Action::Walk(PaperMode::Forward));
    assert_eq!(desk.robot.setpoint, Setpoint::REST);
    desk.press(Action::Clear);
    desk.press(Action::Arm);
    assert_eq!((desk.robot.state, desk.robot.setpoint), (State::Armed, Setpoint::REST));
}

#[test]
fn arming_at_once_waits_until_the_link_is_proven() {
    let now = Instant::from_micros(5_000_000);
    let mut desk = Desk {
        now,
        client: Client::new(key(), [9; 32], now),
        robot: FakeRobot::new(Some(key())),
        cockpit: Cockpit::new("walker-1", now),
        is_cut: false,
    };
    desk.run(Duration::from_millis(50));
    desk.press(Action::Arm);
    assert_eq!(desk.robot.state, State::Disarmed);
    desk.run(Duration::from_secs(1));
    assert_eq!(desk.robot.state, State::Armed);
}

#[test]
fn a_robot_that_was_lost_comes_back_at_rest() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    desk.is_cut = true;
    desk.run(Duration::from_secs(6));
    desk.is_cut = false;
    desk.run(Duration::from_secs(2));
    assert!(!desk.cockpit.is_stale());
    assert_eq!((desk.robot.state, desk.robot.setpoint), (State::Disarmed, Setpoint::REST));
    desk.press(Action::Arm);
    assert_eq!((desk.robot.state, desk.robot.setpoint), (State::Armed, Setpoint::REST));
}

impl Desk {
    /// Walks forward on a curve to the left with a heading that is held, so that the robot is turned back.
    fn turned_back() -> Self {
        let mut desk = Self::armed();
        desk.see(1);
        desk.press(Action::HoldHeading);
        desk.press(Action::Walk(PaperMode::Forward));
        desk.see(50);
        assert_eq!(desk.robot.telemetry(desk.now).setpoint, PaperMode::RightTurn.setpoint());
        desk
    }

    /// Shows the robot to the cameras on a curve to the left, for so many poses at 100 Hz.
    fn see(&mut self, poses: u32) {
        for index in 0..poses {
            let heading = 0.01 * f64::from(index);
            let pose = PlanarPose { x: heading.sin(), y: 1.0 - heading.cos(), heading };
            self.see_as(pose, None);
        }
    }

    /// Sees a pose, which the source does not trust where it comes late.
    fn see_as(&mut self, pose: PlanarPose, late: Option<Duration>) {
        let (exposed, sent) = (self.now, self.now);
        let sample = PoseSample {
            time: self.now,
            pose: Pose::planar(pose, 0.06),
            valid: late.is_none(),
            picture: late.map(|late| Picture { exposed, sent, late }),
        };
        self.cockpit.see(&sample, &mut self.client, self.now);
        self.run(Duration::from_millis(10));
    }
}

#[test]
fn a_map_shows_way_and_heading_where_poses_are_known() {
    let mut desk = Desk::armed();
    desk.press(Action::Walk(PaperMode::Forward));
    desk.see(100);
    insta::assert_snapshot!(desk.picture(80, 24));
}

#[test]
fn a_wide_terminal_shows_the_map_beside_the_shaker() {
    let mut desk = Desk::armed();
    desk.see(100);
    let picture = desk.picture(120, 40);
    assert!(picture.contains(" map, ") && picture.contains(" from above "), "{picture}");
}

#[test]
fn a_forward_walk_that_curves_is_reported_and_a_held_heading_turns_it_back() {
    let mut desk = Desk::armed();
    desk.see(1);
    desk.press(Action::Walk(PaperMode::Forward));
    desk.see(50);
    let curves = |desk: &Desk| {
        desk.cockpit.log.iter().any(|line| line.text.contains("forward curves to the left"))
    };
    assert!(curves(&desk));
    assert!(!curves(&Desk::turned_back()));
}

#[test]
fn poses_that_come_late_are_called_late_and_not_missing() {
    let mut desk = Desk::armed();
    desk.see(10);
    let (pose, late) =
        (PlanarPose { x: 0.0, y: 0.0, heading: 0.0 }, Some(Duration::from_millis(1_900)));
    for _ in 0..60 {
        desk.see_as(pose, late);
    }
    let log = |desk: &Desk| desk.cockpit.log.back().unwrap().text.clone();
    assert!(log(&desk).contains("poses come 1.9 s late"), "{}", log(&desk));
    desk.see_as(pose, None);
    assert_eq!(log(&desk), "poses are back");
}

#[test]
fn a_heading_is_held_by_no_old_pose_and_ends_with_a_turn() {
    let mut desk = Desk::turned_back();
    // Poses stay away while it turns back.
    for _ in 0..60 {
        desk.cockpit.watch(&mut desk.client, desk.now);
        desk.run(Duration::from_millis(10));
    }
    assert_eq!(desk.robot.telemetry(desk.now).setpoint, PaperMode::Forward.setpoint());
    assert!(desk.cockpit.log.back().unwrap().text.contains("no pose for 0.5 s"));
    desk.press(Action::Walk(PaperMode::LeftTurn));
    desk.see(50);
    assert_eq!(desk.robot.telemetry(desk.now).setpoint, PaperMode::LeftTurn.setpoint());
    assert_eq!(desk.cockpit.floor.as_ref().unwrap().held(), None);
}

#[test]
fn a_robot_that_walks_on_its_back_or_in_a_hand_is_stopped() {
    for (height, roll) in [(0.06, 3.0_f64), (0.3, 0.0)] {
        let mut desk = Desk::armed();
        desk.see(1);
        desk.press(Action::Walk(PaperMode::Forward));
        desk.see(20);
        assert!(!desk.robot.stopped);
        let mut pose = Pose::planar(PlanarPose::default(), height);
        let (sin, cos) = (roll / 2.0).sin_cos();
        (pose.orientation.x, pose.orientation.w) = (sin, cos);
        for _ in 0..20 {
            let sample = PoseSample { time: desk.now, pose, valid: true, picture: None };
            desk.cockpit.see(&sample, &mut desk.client, desk.now);
            desk.run(Duration::from_millis(10));
        }
        assert!(desk.robot.stopped, "{height} m, {roll} rad");
    }
}

#[test]
fn without_poses_there_is_no_heading_to_hold() {
    let mut desk = Desk::armed();
    desk.press(Action::HoldHeading);
    assert!(desk.cockpit.log.back().unwrap().text.contains("--pose natnet"));
}

/// Keyboard and terminal; what their keys send that stop, disarm and rest; and those that walk.
type Keyboard = (&'static str, [&'static [u8]; 3], Option<&'static [u8]>);

/// What the keys of a keyboard send that stop, disarm, rest and walk, at a terminal. Where a keyboard has no key for a walk, it begins
/// none: digits and letters of other scripts are known by their place alone, which kitty's protocol states.
const KEYBOARDS: &[Keyboard] = &[
    ("xterm", [b" ", b"\x7f", b"s"], Some(b"w")),
    ("xterm, caps lock", [b" ", b"\x7f", b"S"], Some(b"W")),
    ("uxterm and PuTTY with stty erase ^H", [b" ", b"\x08", b"0"], Some(b"1")),
    ("st", [b" ", b"\x1b[P", b"s"], Some(b"w")),
    ("Linux' console", [b" ", b"\x1b[3~", b"s"], Some(b"w")),
    ("xterm's other keys, behind tmux", [b"\x1b[27;2;32~", b"\x7f", b"s"], Some(b"w")),
    ("kitty", [b"\x1b[32u", b"\x1b[127u", b"\x1b[115u"], Some(b"\x1b[119u")),
    ("kitty, keypad", [b"\x1b[32;129u", b"\x1b[57426u", b"\x1b[57399u"], Some(b"\x1b[57400u")),
    (
        "kitty, num lock",
        [b"\x1b[32;129u", b"\x1b[127;129u", b"\x1b[115;129u"],
        Some(b"\x1b[119;129u"),
    ),
    (
        "ghostty, caps lock and num lock",
        [b"\x1b[32;193u", b"\x1b[3;193~", b"\x1b[115;193u"],
        Some(b"\x1b[119;193u"),
    ),
    ("kitty, Russian", [b"\x1b[32u", b"\x1b[127u", b"\x1b[1099::115u"], Some(b"\x1b[1094::119u")),
    ("kitty, Japanese input", [b"\x1b[12288u", b"\x1b[127u", b"\x1b[65363u"], Some(b"\x1b[65367u")),
    (
        "Japanese input",
        ["\u{3000}".as_bytes(), b"\x7f", "\u{ff53}".as_bytes()],
        Some("\u{ff57}".as_bytes()),
    ),
    (
        "Mac with Option, bepo with shift",
        ["\u{a0}".as_bytes(), b"\x1b[3~", "\u{202f}s".as_bytes()],
        Some(b"w"),
    ),
    ("AZERTY", ["\u{202f}".as_bytes(), b"\x7f", "\u{e0}".as_bytes()], Some(b"1")),
    ("German, dead keys", ["\u{b4}".as_bytes(), b"\x7f", "\u{e4}".as_bytes()], Some(b"w")),
    ("US international", [b"'", b"\x7f", "\u{df}".as_bytes()], Some(b"w")),
    ("Persian", ["\u{200c}".as_bytes(), b"\x7f", "\u{633}".as_bytes()], None),
    ("Russian", [b" ", b"\x7f", "\u{44b}".as_bytes()], None),
    ("Latin-1, AltGr", [b"\xa0", b"\x7f", b"\xe4"], Some(b"w")),
    ("EUC-JP and GBK", [b"\xa1\xa1", b"\x7f", b"\xa4\xb9"], Some(b"w")),
];

impl Desk {
    /// Types this at a terminal, and goes on for 0.3 s.
    fn type_in(&mut self, bytes: &[u8]) {
        let (mut sequences, mut typing) = (Sequences::default(), Typing::default());
        let begun = self.now;
        for round in 0..30 {
            let at = self.now.since(begun);
            typing.look(at);
            let typed = if round == 1 { bytes } else { b"" };
            for report in sequences.take(at, typed) {
                typing.report(at, report);
            }
            let typed = typing.take(at);
            for action in typed.actions {
                self.cockpit.act(action, self.now, &mut self.client, self.now);
            }
            if let Some(doubt) = typed.doubt {
                self.cockpit.abandon(doubt, &mut self.client, self.now);
            }
            self.run(Duration::from_millis(10));
        }
    }
}

#[test]
fn every_keyboard_stops_disarms_rests_and_walks_within_0_3_s() {
    for (keyboard, [stop, disarm, rest], walk) in KEYBOARDS {
        let walking = || {
            let mut desk = Desk::armed();
            desk.press(Action::Walk(PaperMode::LeftTurn));
            desk
        };
        let after = |mut desk: Desk, bytes: &[u8]| {
            desk.type_in(bytes);
            (desk.robot.setpoint == Setpoint::REST, desk.robot.state, desk.robot.stopped)
        };
        assert!(after(walking(), stop).2, "{keyboard} stops");
        assert_eq!(after(walking(), disarm), (true, State::Disarmed, false), "{keyboard} disarms");
        assert!(after(walking(), rest).0, "{keyboard} rests");
        let mut desk = Desk::armed();
        desk.type_in(walk.unwrap_or(rest));
        assert_eq!(desk.robot.setpoint != Setpoint::REST, walk.is_some(), "{keyboard} walks");
    }
}
