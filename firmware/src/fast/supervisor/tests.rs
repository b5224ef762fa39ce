//! Who may move, when, and what stops it: each deadline to the microsecond, each duration to the tick.

use core::time::Duration;

use flix_protocol::message::Pattern;

use super::*;

const TEN_HERTZ: Speed = Speed::from_centihertz(1_000);
const REST: Drive = Drive::Shake(Speed::ZERO, false);
const MICROSECOND: Duration = Duration::from_micros(1);
/// Longer than any state lasts by itself.
const LONG: usize = 70_000;

const TRIAL: Trial =
    Trial { motors: [true; 2], current_ma: 500, angle: 0, pattern: Pattern::Halve(10), ticks: 100 };

/// A supervisor that is shown what the test says.
#[derive(Clone)]
struct Desk {
    supervisor: Supervisor,
    asked: Asked,
    present: Faults,
    at_rest: bool,
    finished: bool,
    outdated: bool,
}

impl Desk {
    fn disarmed() -> Self {
        let mut asked = Asked { begins: true, trial: Some(TRIAL), ..Asked::default() };
        asked.hear(Instant::START, Instant::from_micros(u64::MAX));
        let (supervisor, present) = (Supervisor::new(), Faults::NONE);
        Self { supervisor, asked, present, at_rest: false, finished: false, outdated: false }
    }

    fn aligning() -> Self {
        let mut desk = Self::disarmed();
        desk.want(Wanted::Arm);
        desk.tick();
        desk
    }

    /// A robot in a trial.
    fn trying() -> Self {
        let mut desk = Self::disarmed();
        desk.want(Wanted::Try);
        assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Aligning));
        desk
    }

    /// Gives an order with the present permit.
    fn want(&mut self, wanted: Wanted) {
        self.asked.want(wanted, self.supervisor.permit);
    }

    /// Returns how often the permit has counted, and the last reason.
    fn halts(&self) -> (u32, Halt) {
        (self.supervisor.permit.number(), self.supervisor.halt)
    }

    fn armed() -> Self {
        let mut desk = Self::aligning();
        desk.finished = true;
        assert_eq!((desk.tick(), desk.state()), (REST, State::Armed));
        desk.finished = false;
        desk
    }

    fn running() -> Self {
        let mut desk = Self::armed();
        desk.want(Wanted::Shake);
        desk.asked.frequency = TEN_HERTZ;
        assert_eq!((desk.tick(), desk.state()), (Drive::Shake(TEN_HERTZ, true), State::Running));
        desk
    }

    fn faulted(mut self, fault: Fault) -> Self {
        self.present = Faults::NONE.with(fault);
        self
    }

    fn state(&self) -> State {
        self.supervisor.state
    }

    fn tick(&mut self) -> Drive {
        self.after(Duration::ZERO)
    }

    /// One tick, this long after the newest command.
    fn after(&mut self, silence: Duration) -> Drive {
        let Self { present, at_rest, finished, outdated, .. } = *self;
        let conditions = Conditions { present, at_rest, finished, outdated };
        self.supervisor.update(self.asked.heard + silence, &self.asked, &conditions)
    }

    /// What it does from here on: each drive, and for how many ticks.
    fn course(&mut self) -> std::vec::Vec<(Drive, usize)> {
        let mut course: std::vec::Vec<(Drive, usize)> = std::vec::Vec::new();
        for _ in 0..LONG {
            let drive = self.tick();
            match course.last_mut() {
                Some((last, ticks)) if *last == drive => *ticks += 1,
                _ => course.push((drive, 1)),
            }
        }
        course
    }
}

/// Gives an order with the present permit, and does one tick.
fn ask(desk: &mut Desk, wanted: Wanted) -> Drive {
    desk.want(wanted);
    desk.tick()
}

/// Latches a stop. `from_outside`: a second operator asks for it.
fn stop(desk: &mut Desk, from_outside: bool) -> Drive {
    desk.asked.stops += 1;
    desk.asked.halts += u8::from(from_outside);
    desk.tick()
}

#[test]
fn aligning_begins_once_the_newest_settings_are_in_force_and_not_before() {
    let mut desk = Desk::disarmed();
    desk.outdated = true;
    assert_eq!(ask(&mut desk, Wanted::Arm), Drive::Brake);
    for _ in 0..1_000 {
        assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Aligning));
    }
    desk.outdated = false;
    assert_eq!((desk.tick(), desk.state()), (Drive::Align, State::Aligning));
}

#[test]
fn an_operator_who_disarms_or_stops_while_arming_waits_for_settings_has_a_disarmed_robot() {
    for stops in [false, true] {
        let mut desk = Desk::disarmed();
        desk.outdated = true;
        ask(&mut desk, Wanted::Arm);
        if stops {
            stop(&mut desk, false);
        } else {
            ask(&mut desk, Wanted::Off);
        }
        desk.outdated = false;
        desk.tick();
        assert_eq!(desk.state(), State::Disarmed);
    }
}

#[test]
fn arming_fails_where_settings_are_not_taken_over_within_two_seconds() {
    let mut desk = Desk::disarmed();
    desk.outdated = true;
    ask(&mut desk, Wanted::Arm);
    for _ in 0..LONGEST_WAIT_TICKS {
        assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Aligning));
    }
    assert_eq!(desk.tick(), Drive::Brake);
    let alignment = Faults::NONE.with(Fault::Alignment);
    assert_eq!((desk.state(), desk.supervisor.faults), (State::Faulted, alignment));
}

#[test]
fn each_step_of_the_ladder_comes_at_its_deadline_and_not_a_microsecond_before() {
    let events = EventCounters::default();
    let late = EventCounters { link_late: 1, ..events };
    let silent = EventCounters { command_deadline: 1, ..late };
    for (from, deadline, [before, at], [early, due]) in [
        (Desk::running(), LINK_LATE, [State::Running; 2], [events, late]),
        (Desk::running(), COMMAND_DEADLINE, [State::Running, State::Stopping], [late, silent]),
        (
            Desk::armed(),
            LINK_LOST,
            [State::Armed, State::Stopping],
            [late, EventCounters { link_lost: 1, ..late }],
        ),
        (Desk::aligning(), COMMAND_DEADLINE, [State::Aligning, State::Disarmed], [late, silent]),
    ] {
        let mut desk = from.clone();
        desk.after(deadline - MICROSECOND);
        desk.after(deadline - MICROSECOND);
        assert_eq!((desk.state(), desk.supervisor.events), (before, early), "{deadline:?}");
        assert_eq!(desk.supervisor.link_late, deadline > LINK_LATE);
        let mut desk = from;
        desk.after(deadline);
        let is_late = desk.supervisor.link_late;
        desk.after(deadline);
        assert_eq!((desk.state(), desk.supervisor.events), (at, due), "{deadline:?}");
        assert!(is_late);
    }
}

#[test]
fn a_command_counts_up_to_the_moment_at_which_it_expires() {
    let life = LINK_LATE / 2;
    for (age, state, late) in
        [(life, State::Running, false), (life + MICROSECOND, State::Stopping, true)]
    {
        let mut desk = Desk::running();
        desk.asked.expires = desk.asked.heard + life;
        desk.after(age);
        let events = &desk.supervisor.events;
        assert_eq!((events.command_age, events.command_deadline), (u8::from(late), 0));
        assert_eq!((desk.state(), desk.supervisor.link_late), (state, late));
        desk.asked.frequency = Speed::ZERO;
        let mut desk = Desk { asked: desk.asked, ..Desk::armed() };
        desk.after(age);
        assert_eq!((desk.state(), desk.supervisor.link_late), (State::Armed, late));
    }
}

#[test]
fn a_run_goes_on_when_commands_come_back_unless_the_robot_disarms_already() {
    for (silence, then) in [(COMMAND_DEADLINE, State::Running), (LINK_LOST, State::Stopping)] {
        let mut desk = Desk::running();
        desk.after(silence);
        assert_eq!(desk.after(LINK_LATE), REST, "as long as they are late");
        assert_eq!(desk.state(), State::Stopping);
        desk.tick();
        assert_eq!((desk.state(), desk.supervisor.link_late), (then, false), "{silence:?}");
    }
    let mut desk = Desk::running();
    desk.after(COMMAND_DEADLINE);
    ask(&mut desk, Wanted::Off);
    assert_eq!(desk.state(), State::Stopping);
}

#[test]
fn commands_that_come_back_while_the_rotors_brake_wait_until_they_stand() {
    let mut desk = Desk::running();
    desk.after(COMMAND_DEADLINE);
    for _ in 0..LONGEST_RAMP_TICKS {
        assert_eq!(desk.after(COMMAND_DEADLINE), REST);
    }
    for _ in 0..10 {
        assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Stopping));
    }
    desk.at_rest = true;
    desk.tick();
    assert_eq!(desk.state(), State::Armed);
}

#[test]
fn a_link_that_comes_back_and_is_lost_again_disarms_again() {
    let mut desk = Desk::armed();
    desk.after(LINK_LOST);
    desk.at_rest = true;
    desk.tick();
    ask(&mut desk, Wanted::Arm);
    assert_eq!(desk.state(), State::Aligning);
    desk.after(LINK_LOST);
    assert_eq!((desk.state(), desk.supervisor.events.link_lost), (State::Disarmed, 2));
    assert!(desk.supervisor.link_late);
    desk.after(LINK_LOST);
    assert!(!desk.supervisor.link_late, "nothing is driven");
}

#[test]
fn arming_wants_a_fresh_command_and_neither_a_stop_nor_a_fault() {
    let arm = |change: fn(&mut Desk), silence: Duration| {
        let mut desk = Desk::disarmed();
        change(&mut desk);
        desk.want(Wanted::Arm);
        desk.after(silence);
        desk.state()
    };
    let expires = |desk: &mut Desk| desk.asked.expires = desk.asked.heard + MICROSECOND;
    let stop = |desk: &mut Desk| {
        stop(desk, false);
    };
    let raise = |desk: &mut Desk| desk.supervisor.raise(Faults::NONE.with(Fault::Settings));
    assert_eq!(arm(|_| {}, LINK_LATE - MICROSECOND), State::Aligning);
    assert_eq!(arm(|_| {}, LINK_LATE), State::Disarmed);
    assert_eq!(arm(expires, MICROSECOND), State::Aligning);
    assert_eq!(arm(expires, 2 * MICROSECOND), State::Disarmed);
    assert_eq!(arm(stop, Duration::ZERO), State::Disarmed);
    assert_eq!(arm(raise, Duration::ZERO), State::Faulted);
}

#[test]
fn a_stop_and_a_halt_outweigh_the_order_of_the_same_tick() {
    for from in [Desk::disarmed, Desk::aligning, Desk::trying, Desk::armed] {
        for wanted in [Wanted::Off, Wanted::Arm, Wanted::Shake, Wanted::Try, Wanted::Clear] {
            // An own stop, one from outside, another session.
            for (stops, halts, reason) in
                [(1, 0, None), (1, 1, Some(Halt::StoppedFromOutside)), (0, 1, Some(Halt::Operator))]
            {
                let mut desk = from();
                let before = desk.halts();
                desk.at_rest = true;
                desk.want(wanted);
                desk.asked.frequency = TEN_HERTZ;
                (desk.asked.stops, desk.asked.halts) = (stops, halts);
                let cleared = stops == 1 && halts == 0 && wanted == Wanted::Clear;
                desk.tick();
                desk.tick();
                let after = reason.map_or(before, |reason| (before.0 + 1, reason));
                let stopped = stops == 1 && !cleared;
                // The order of a person who knew of everything but a stop that came with it.
                let begins = !stopped && halts == 0 && matches!(wanted, Wanted::Arm | Wanted::Try);
                let state = if begins { State::Aligning } else { State::Disarmed };
                assert_eq!(
                    (desk.state(), desk.supervisor.stopped, desk.halts()),
                    (state, stopped, after),
                    "{wanted:?} {stops} {halts}"
                );
                assert_eq!(desk.supervisor.events.stopped, stops);
            }
        }
    }
}

#[test]
fn an_earlier_permit_begins_nothing_and_clears_nothing() {
    for wanted in [Wanted::Arm, Wanted::Try] {
        let mut desk = Desk::disarmed();
        desk.want(wanted);
        desk.asked.halts += 1;
        for _ in 0..10 {
            assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Disarmed));
        }
    }
    let mut desk = Desk::disarmed();
    desk.want(Wanted::Clear);
    stop(&mut desk, true);
    desk.tick();
    assert!(desk.supervisor.stopped);
    ask(&mut desk, Wanted::Clear);
    assert!(!desk.supervisor.stopped);
    // A walk that was asked for while the motors were aligned.
    let mut desk = Desk::aligning();
    desk.want(Wanted::Shake);
    desk.asked.frequency = TEN_HERTZ;
    desk.finished = true;
    desk.tick();
    desk.finished = false;
    assert_eq!((desk.tick(), desk.state()), (REST, State::Armed));
    desk.want(Wanted::Shake);
    assert_eq!((desk.tick(), desk.state()), (Drive::Shake(TEN_HERTZ, true), State::Running));
}

#[test]
fn an_order_to_clear_that_is_late_or_has_expired_clears_nothing() {
    let stopped = || {
        let mut desk = Desk::disarmed();
        stop(&mut desk, false);
        desk
    };
    let faulted = || {
        let mut desk = Desk::running().faulted(Fault::Stall);
        for _ in 0..=BRAKE_TICKS {
            desk.tick();
        }
        desk.present = Faults::NONE;
        desk
    };
    for from in [stopped as fn() -> Desk, faulted] {
        let latched = |desk: &Desk| desk.supervisor.stopped || desk.state() == State::Faulted;
        for (silence, life, stays) in [
            (LINK_LATE - MICROSECOND, LINK_LATE, false),
            (LINK_LATE, LINK_LOST, true),
            (2 * MICROSECOND, MICROSECOND, true),
        ] {
            let mut desk = from();
            desk.want(Wanted::Clear);
            desk.asked.expires = desk.asked.heard + life;
            desk.after(silence);
            assert_eq!(latched(&desk), stays, "{silence:?} {life:?}");
        }
    }
}

#[test]
fn another_trial_ends_the_one_under_way_and_is_no_halt() {
    let mut desk = Desk::trying();
    let before = desk.halts();
    desk.asked.trial = Some(Trial { ticks: 200, ..TRIAL });
    desk.asked.number += 1;
    assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Disarmed));
    assert_eq!(desk.halts(), before);
    assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Aligning), "by the same permit");
    assert_eq!(desk.tick(), Drive::Try);
}

#[test]
fn what_calms_needs_no_permit() {
    let mut old = Desk::running();
    old.asked.permit = Permit::new(u32::MAX);
    assert_eq!((old.tick(), old.state()), (REST, State::Running), "to rest");
    old.at_rest = true;
    assert_eq!((old.tick(), old.state()), (REST, State::Armed));
    for wanted in [Wanted::Arm, Wanted::Clear] {
        let mut desk = Desk::running();
        desk.asked.want(wanted, Permit::new(u32::MAX));
        assert_eq!((desk.tick(), desk.state()), (REST, State::Running), "{wanted:?}");
    }
    for wanted in [Wanted::Off, Wanted::Try] {
        for from in [Desk::running, Desk::armed] {
            let mut desk = from();
            desk.asked.want(wanted, Permit::new(u32::MAX));
            assert_eq!((desk.tick(), desk.state()), (REST, State::Stopping), "{wanted:?}");
        }
    }
}

#[test]
fn the_permit_counts_each_halt_once_and_no_calm_that_the_operator_asked_for() {
    let until = |desk: &mut Desk, state| {
        let arrived = (0..LONG).any(|_| {
            desk.tick();
            desk.state() == state
        });
        assert!(arrived, "{state}");
    };
    type Act<'a> = &'a dyn Fn(&mut Desk);
    let silent = |desk: &mut Desk, silence: Duration| {
        desk.after(silence);
        desk.after(silence);
    };
    let finish = |desk: &mut Desk| {
        desk.finished = true;
        desk.tick();
    };
    let rests: Act = &|desk| desk.at_rest = true;
    let fail: Act = &|desk| {
        desk.present = Faults::NONE.with(Fault::Stall);
        desk.tick();
        desk.tick();
        desk.present = desk.present.with(Fault::OverSpeed);
        desk.tick();
        desk.present = Faults::NONE;
        desk.tick();
    };
    type Row<'a> = (fn() -> Desk, Act<'a>, u32, Halt);
    let halts: [Row; 13] = [
        (Desk::aligning, &finish, 1, Halt::Aligned),
        (Desk::trying, &finish, 1, Halt::Tried),
        (Desk::aligning, &|desk| silent(desk, COMMAND_DEADLINE), 1, Halt::LetGo),
        (Desk::trying, &|desk| silent(desk, COMMAND_DEADLINE), 1, Halt::LetGo),
        (Desk::trying, fail, 2, Halt::Fault),
        (Desk::running, fail, 2, Halt::Fault),
        (Desk::running, &|desk| silent(desk, COMMAND_DEADLINE), 0, Halt::Aligned),
        (Desk::running, &|desk| silent(desk, LINK_LOST), 1, Halt::LinkLost),
        (Desk::armed, &|desk| silent(desk, LINK_LOST), 1, Halt::LinkLost),
        (Desk::disarmed, &|desk| silent(desk, LINK_LOST), 0, Halt::Started),
        (
            Desk::running,
            &|desk| {
                silent(desk, COMMAND_DEADLINE);
                rests(desk);
                desk.after(COMMAND_DEADLINE);
            },
            1,
            Halt::Rested,
        ),
        (
            Desk::running,
            &|desk| {
                ask(desk, Wanted::Off);
                rests(desk);
                until(desk, State::Disarmed);
            },
            0,
            Halt::Aligned,
        ),
        (
            Desk::running,
            &|desk| {
                ask(desk, Wanted::Off);
                until(desk, State::Disarmed);
            },
            1,
            Halt::Rested,
        ),
    ];
    for (place, (from, act, count, reason)) in halts.into_iter().enumerate() {
        let mut desk = from();
        let (before, _) = desk.halts();
        act(&mut desk);
        let (after, halt) = desk.halts();
        assert_eq!((after - before, halt), (count, reason), "{place}");
    }
}

#[test]
fn a_stop_is_cleared_only_at_rest() {
    let mut desk = Desk::running();
    stop(&mut desk, false);
    ask(&mut desk, Wanted::Clear);
    assert_eq!((desk.state(), desk.supervisor.stopped), (State::Stopping, true));
}

#[test]
fn rotors_turn_only_for_a_setpoint_that_came_after_arming_and_in_time() {
    for (new, frequency, silence, state) in [
        (false, TEN_HERTZ, Duration::ZERO, State::Armed),
        (true, Speed::ZERO, Duration::ZERO, State::Armed),
        (true, TEN_HERTZ, LINK_LATE, State::Armed),
        (true, TEN_HERTZ, LINK_LATE - MICROSECOND, State::Running),
    ] {
        let mut desk = Desk::armed();
        if new {
            desk.want(Wanted::Shake);
        }
        desk.asked.frequency = frequency;
        desk.after(silence);
        assert_eq!(desk.state(), state, "{new} {frequency:?} {silence:?}");
    }
    for (frequency, at_rest, state) in [
        (Speed::ZERO, true, State::Armed),
        (Speed::ZERO, false, State::Running),
        (TEN_HERTZ, true, State::Running),
    ] {
        let mut desk = Desk::running();
        (desk.asked.frequency, desk.at_rest) = (frequency, at_rest);
        assert_eq!(desk.tick(), Drive::Shake(frequency, true));
        assert_eq!(desk.state(), state);
    }
    assert_eq!(Desk::aligning().tick(), Drive::Align);
}

#[test]
fn rotors_that_stand_because_commands_stayed_away_turn_again_only_when_a_person_wants_it() {
    let mut desk = Desk::running();
    desk.after(COMMAND_DEADLINE);
    assert_eq!(desk.state(), State::Stopping);
    // While they ramp down, commands that come back are obeyed.
    let mut ramping = Desk::running();
    ramping.after(COMMAND_DEADLINE);
    ramping.after(Duration::ZERO);
    assert_eq!(ramping.state(), State::Running);
    desk.at_rest = true;
    desk.after(COMMAND_DEADLINE);
    assert_eq!(desk.state(), State::Armed);
    desk.after(Duration::ZERO);
    assert_eq!(desk.state(), State::Armed, "the same commands are back");
    desk.want(Wanted::Shake);
    desk.after(Duration::ZERO);
    assert_eq!(desk.state(), State::Running);
}

#[test]
fn rotors_that_come_to_rest_end_a_stop_where_it_leads() {
    let mut desk = Desk::running();
    desk.after(COMMAND_DEADLINE);
    desk.at_rest = true;
    desk.after(COMMAND_DEADLINE);
    assert_eq!(desk.state(), State::Armed);
    let mut desk = Desk::running();
    ask(&mut desk, Wanted::Off);
    desk.at_rest = true;
    desk.tick();
    assert_eq!(desk.state(), State::Disarmed);
}

#[test]
fn a_ramp_down_at_whose_end_no_rest_is_seen_disarms_after_ramp_and_brake() {
    let mut desk = Desk::running();
    ask(&mut desk, Wanted::Off);
    for _ in 0..LONGEST_RAMP_TICKS + BRAKE_TICKS {
        desk.tick();
    }
    assert_eq!(desk.state(), State::Stopping);
    assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Disarmed));
}

#[test]
fn motors_that_brake_are_driven_by_no_under_voltage() {
    let mut desk = Desk::running();
    desk.want(Wanted::Off);
    for _ in 0..=LONGEST_RAMP_TICKS {
        desk.tick();
    }
    assert_eq!(desk.tick(), Drive::Brake);
    let mut desk = desk.faulted(Fault::UnderVoltage);
    for _ in 1..BRAKE_TICKS {
        assert_eq!((desk.tick(), desk.state()), (Drive::Brake, State::Faulted));
    }
}

#[test]
fn every_way_to_rest_takes_its_time() {
    let ramp = usize::from(LONGEST_RAMP_TICKS);
    let brake = usize::from(BRAKE_TICKS);
    let disarming = |at_rest| {
        let mut desk = Desk::running();
        desk.want(Wanted::Off);
        desk.at_rest = at_rest;
        desk
    };
    let start = |at_rest| Desk { at_rest, ..Desk::disarmed() };
    let under = |from: Desk| Desk { at_rest: true, ..from.faulted(Fault::UnderVoltage) };
    let over = Desk { at_rest: true, ..Desk::running().faulted(Fault::OverCurrent) };
    let mut both = Desk::running().faulted(Fault::UnderVoltage);
    both.present = both.present.with(Fault::OverVoltage);
    let speed = Desk::running().faulted(Fault::OverSpeed);
    for (name, mut desk, beginning) in [
        ("start at rest", start(true), &[(Drive::Brake, brake - 1), (Drive::Off, 0)][..]),
        ("start", start(false), &[(Drive::Brake, usize::from(u16::MAX) - 1), (Drive::Off, 0)]),
        ("disarm at rest", disarming(true), &[(REST, 1), (Drive::Brake, brake - 1)]),
        ("disarm", disarming(false), &[(REST, ramp + 1), (Drive::Brake, 0)]),
        (
            "under-voltage",
            under(Desk::running()),
            &[(REST, ramp), (Drive::Brake, brake - ramp), (Drive::Off, 0)],
        ),
        ("the same, armed", under(Desk::armed()), &[(REST, ramp), (Drive::Brake, brake - ramp)]),
        ("the same, aligning", under(Desk::aligning()), &[(Drive::Brake, brake), (Drive::Off, 0)]),
        (
            "over-current on either rail",
            over,
            &[
                (Drive::Off, COAST_TICKS.into()),
                (Drive::BrakeHigh, usize::from(RAIL_TICKS) + 1),
                (Drive::Brake, brake - usize::from(COAST_TICKS + RAIL_TICKS) - 1),
            ],
        ),
        ("both voltages", both, &[(Drive::Brake, usize::from(u16::MAX))]),
        ("over-speed", speed, &[(Drive::Brake, usize::from(u16::MAX))]),
    ] {
        let course = desk.course();
        for (have, (drive, ticks)) in course.iter().zip(beginning) {
            // Zero: for ever.
            let ticks = if *ticks == 0 { have.1 } else { *ticks };
            assert_eq!(*have, (*drive, ticks), "{name}: {course:?}");
        }
    }
}

#[test]
fn what_is_over_current_while_the_low_sides_brake_is_braked_by_the_high_sides_until_the_robot_is_armed_anew()
 {
    for first in [Fault::OverCurrent, Fault::CurrentSense] {
        let mut desk = Desk::running().faulted(first);
        desk.tick();
        desk.present = Faults::NONE;
        for _ in 0..COAST_TICKS {
            desk.tick();
        }
        assert_eq!(desk.tick(), Drive::Brake);
        desk.present = Faults::NONE.with(Fault::OverCurrent);
        for _ in 0..RAIL_TICKS {
            assert_eq!(desk.tick(), Drive::BrakeHigh);
        }
        desk.present = Faults::NONE;
        desk.at_rest = true;
        for _ in 0..=BRAKE_TICKS {
            assert_eq!(desk.tick(), Drive::BrakeHigh);
        }
        ask(&mut desk, Wanted::Clear);
        assert_eq!((desk.state(), desk.tick()), (State::Disarmed, Drive::BrakeHigh));
        ask(&mut desk, Wanted::Arm);
        ask(&mut desk, Wanted::Off);
        assert_eq!((desk.state(), desk.tick()), (State::Disarmed, Drive::Brake));
    }
}

#[test]
fn the_first_fault_is_reported_as_the_cause_until_it_is_cleared() {
    let mut desk = Desk::running();
    desk.present = Faults::NONE.with(Fault::Stall).with(Fault::EncoderLost);
    desk.tick();
    desk.present = desk.present.with(Fault::OverCurrent);
    desk.tick();
    assert_eq!(desk.supervisor.first_fault, Some(Fault::EncoderLost));
    assert_eq!(desk.supervisor.faults, desk.present);
    assert_eq!(desk.state(), State::Faulted);
}

#[test]
fn a_fault_is_cleared_when_its_cause_is_gone_and_the_rotors_had_time_to_stop() {
    let faulted = |present: Faults, ticks: u16| {
        let mut desk = Desk::running();
        desk.present = Faults::NONE.with(Fault::UnderVoltage).with(Fault::Stall);
        for _ in 0..ticks {
            desk.tick();
        }
        desk.present = present;
        ask(&mut desk, Wanted::Clear);
        (desk.state(), desk.supervisor.faults, desk.supervisor.first_fault)
    };
    let [first, second] = [Fault::UnderVoltage, Fault::Stall];
    let only = |fault| Faults::NONE.with(fault);
    let all = only(first).with(second);
    assert_eq!(faulted(Faults::NONE, BRAKE_TICKS - 1), (State::Faulted, all, Some(first)));
    assert_eq!(faulted(Faults::NONE, BRAKE_TICKS), (State::Disarmed, Faults::NONE, None));
    for (left, fault) in [(only(first), first), (only(second), second), (all, first)] {
        assert_eq!(faulted(left, BRAKE_TICKS), (State::Faulted, left, Some(fault)));
    }
}

#[test]
fn a_clear_before_the_rotors_had_time_to_stop_forgets_a_stop_and_keeps_the_fault() {
    let mut desk = Desk::running().faulted(Fault::Stall);
    stop(&mut desk, false);
    let kept = desk.present;
    desk.present = Faults::NONE;
    ask(&mut desk, Wanted::Clear);
    let Supervisor { stopped, faults, .. } = desk.supervisor;
    assert_eq!((desk.state(), stopped, faults), (State::Faulted, false, kept));
}

#[test]
fn a_clear_is_reported_where_a_stop_or_a_fault_was_forgotten_and_nowhere_else() {
    let mut desk = Desk::running().faulted(Fault::Stall);
    for _ in 0..BRAKE_TICKS {
        desk.tick();
    }
    let mut reported = |present| {
        desk.present = present;
        ask(&mut desk, Wanted::Clear);
        desk.supervisor.events.cleared
    };
    assert_eq!(
        [Faults::NONE.with(Fault::Stall), Faults::NONE, Faults::NONE].map(&mut reported),
        [0, 1, 1]
    );
    stop(&mut desk, false);
    ask(&mut desk, Wanted::Clear);
    assert_eq!(desk.supervisor.events.cleared, 2);
}

#[test]
fn faults_of_a_disarmed_robot_wait_until_it_is_armed() {
    let mut desk = Desk::disarmed().faulted(Fault::UnderVoltage);
    desk.tick();
    assert_eq!((desk.state(), desk.supervisor.faults), (State::Disarmed, Faults::NONE));
    ask(&mut desk, Wanted::Arm);
    desk.tick();
    assert_eq!(desk.state(), State::Faulted);
}
