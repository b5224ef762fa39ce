//! What alignment finds and what it refuses, with rotors that stand wherever the field draws them.

use std::f64::consts::TAU;

use super::*;
use crate::fast::control::bench::HARDWARE;
use crate::fast::standstill_and_zero::{STILL, STILL_TICKS};
use crate::hardware::{Encoder, EncoderReading};
use crate::settings::Settings;
use crate::units::Speed;
use crate::units::{EncoderAngle, Voltage};

const TURN: f64 = 4_294_967_296.0;
const POLE_PAIRS: f64 = 7.0;
/// Fastest that a rotor follows the field, turns a tick.
const FASTEST: f64 = 2e-4;
/// Ticks in which nothing is decided any more.
const LONG: usize = 60_000;

/// A motor whose rotor stands where the field is; angles in turns.
#[derive(Clone, Copy)]
struct Needle {
    /// Electrical angle at rotor angle zero.
    offset: f64,
    reversed: bool,
    /// Cosine and sine of the first and second harmonic of the encoder's error.
    eccentricity: [f64; 4],
    /// What amplifiers A and B show of the current, and of none.
    gains: [f64; 2],
    zeros: [i32; 2],
    /// Friction: the rotor trails the field by so much, electrical.
    trails: f64,
    /// How far it goes of what the field goes.
    follows: f64,
    /// Turns a tick that somebody else turns it, while no field does.
    pushed: f64,
    angle: f64,
}

impl Needle {
    fn at(angle: f64) -> Self {
        Self {
            offset: 0.0,
            reversed: false,
            eccentricity: [0.0; 4],
            gains: [1.0; 2],
            zeros: [0; 2],
            trails: 0.0,
            follows: 1.0,
            pushed: 0.0,
            angle,
        }
    }

    fn sign(&self) -> f64 {
        if self.reversed { -1.0 } else { 1.0 }
    }

    fn reading(&self) -> EncoderAngle {
        let [c1, s1, c2, s2] = self.eccentricity;
        let angle = self.angle * TAU;
        let wrong = c1 * angle.cos()
            + s1 * angle.sin()
            + c2 * (2.0 * angle).cos()
            + s2 * (2.0 * angle).sin();
        EncoderAngle::from_raw(((self.angle + wrong).rem_euclid(1.0) * TURN) as u32)
    }

    /// Follows a field at this electrical angle.
    fn follow(&mut self, field: f64) {
        let electrical = self.sign() * POLE_PAIRS * self.angle + self.offset;
        let ahead = field - electrical;
        let ahead = ahead - ahead.round();
        let pulled = ahead.signum() * (ahead.abs() - self.trails).max(0.0);
        let step = pulled / POLE_PAIRS * self.sign() * self.follows;
        self.angle += step.clamp(-FASTEST, FASTEST);
    }
}

/// Voltage and electrical angle of a field, turns.
fn field_of(duties: [crate::units::Duty; 3], bus: f64) -> (f64, f64) {
    let [a, b, c] = duties.map(|duty| bus * f64::from(duty.raw()) / 65_536.0);
    let (alpha, beta) = ((2.0 * a - b - c) / 3.0, (b - c) / 3_f64.sqrt());
    (alpha.hypot(beta), beta.atan2(alpha) / TAU)
}

/// Two motors at an aligner.
#[derive(Clone)]
struct Stand {
    configuration: Configuration,
    aligner: Aligner,
    needles: [Needle; 2],
    trackers: [Tracker; 2],
    bus: Bus,
    sensed: bool,
    bridges: [Bridge; 2],
    ticks: usize,
}

fn settings() -> Settings {
    Settings {
        encoder_clockwise: [1.0; 2],
        encoder_zero: [0.0; 2],
        encoder_latency: 0.0,
        pole_pairs: POLE_PAIRS as f32,
        // A needle gives no voltage: the least that there is.
        flux_linkage: [0.2; 2],
        ..Settings::DEFAULT
    }
}

impl Stand {
    fn with(full: bool, settings: &Settings) -> Self {
        let configuration = Configuration::new(settings, &HARDWARE);
        let mut needles = [Needle::at(0.3), Needle::at(0.8)];
        (needles[0].offset, needles[1].offset) = (0.2, -0.3);
        for needle in &mut needles {
            needle.zeros = [configuration.zero_design.raw(); 2];
        }
        Self {
            aligner: Aligner::new(full, &configuration),
            configuration,
            needles,
            trackers: [Tracker::new(); 2],
            bus: Bus::new(Voltage::from_volts(12.0), 0),
            sensed: true,
            bridges: [Bridge::Off; 2],
            ticks: 0,
        }
    }

    fn full() -> Self {
        Self::with(true, &settings())
    }

    /// Remembers each motor as it is.
    fn remembering() -> Self {
        let mut stand = Self::with(false, &settings());
        stand.remember();
        stand
    }

    fn remember(&mut self) {
        self.configuration.apply(self.needles.map(|needle| Alignment {
            electrical_offset: ElectricalAngle::from_raw(
                (needle.offset.rem_euclid(1.0) * TURN) as u32,
            ),
            reversed: needle.reversed,
            current_inverted: needle.gains[0] < 0.0,
            ..Alignment::default()
        }));
        self.aligner = Aligner::new(false, &self.configuration);
    }

    /// What the amplifiers show.
    fn counts(&self) -> [[Counts; 2]; 2] {
        [0, 1].map(|index| {
            let needle = &self.needles[index];
            let (voltage, angle) = match self.bridges[index] {
                Bridge::Duty(duties) => field_of(duties, 12.0),
                Bridge::Off => (0.0, 0.0),
            };
            // Counts of the alignment current belong to the alignment voltage.
            let full = f64::from(self.configuration.alignment_counts.raw());
            let volts = f64::from(self.configuration.alignment_voltage[index].raw()) / 65_536.0;
            let phase = |lag: f64| voltage / volts * full * ((angle - lag) * TAU).cos();
            [0, 1].map(|phase_index| {
                let current = phase(phase_index as f64 / 3.0) * needle.gains[phase_index];
                Counts::from_raw(needle.zeros[phase_index] + current.round() as i32)
            })
        })
    }

    fn tick(&mut self) -> Progress {
        let counts = self.sensed.then(|| self.counts());
        for (index, tracker) in self.trackers.iter_mut().enumerate() {
            let reading = EncoderReading { angle: self.needles[index].reading(), age_us: 0 };
            tracker.update(&self.configuration.encoders[index], Encoder::Reading(reading));
        }
        let observation = Observation { trackers: &self.trackers, counts, bus: &self.bus };
        let (bridges, progress) = self.aligner.update(&self.configuration, &observation);
        self.bridges = bridges;
        self.ticks += 1;
        for (needle, bridge) in self.needles.iter_mut().zip(bridges) {
            match bridge {
                Bridge::Duty(duties) if bridge != Bridge::BRAKE => {
                    let (voltage, angle) = field_of(duties, 12.0);
                    if voltage > 0.05 {
                        needle.follow(angle);
                    }
                }
                _ => needle.angle += needle.pushed,
            }
        }
        progress
    }

    fn end(&mut self) -> Progress {
        let mut progress = Progress::Busy;
        while progress == Progress::Busy && self.ticks < LONG {
            progress = self.tick();
        }
        progress
    }

    /// Ticks until the stage changes.
    fn stage(&mut self) -> (Stage, usize) {
        let (stage, begun) = (self.aligner.stage, self.ticks);
        while self.aligner.stage == stage && self.tick() == Progress::Busy {}
        (stage, self.ticks - begun)
    }
}

fn turns(raw: u32) -> f64 {
    f64::from(raw as i32) / TURN
}

#[test]
fn finds_offset_phase_order_polarity_and_both_harmonics_of_the_encoder() {
    let mut stand = Stand::full();
    let wrong = [[0.002, -0.001, 0.0007, 0.0004], [-0.0015, 0.002, -0.0005, 0.0009]];
    for (needle, wrong) in stand.needles.iter_mut().zip(wrong) {
        needle.eccentricity = wrong;
    }
    (stand.needles[1].reversed, stand.needles[1].gains) = (true, [-1.0; 2]);
    assert_eq!(stand.end(), Progress::Done);
    for (needle, found) in stand.needles.iter().zip(stand.aligner.results()) {
        assert_eq!(found.reversed, needle.reversed);
        assert_eq!(found.current_inverted, needle.gains[0] < 0.0);
        let offset = turns(found.electrical_offset.raw()) - needle.offset;
        assert!((offset - offset.round()).abs() < 2e-3, "electrical offset is off by {offset}");
        for (have, want) in found.eccentricity.iter().zip(needle.eccentricity) {
            let have = f64::from(*have) / TURN;
            assert!((have - want).abs() < 6e-5, "{have} for {want}");
        }
    }
}

#[test]
fn friction_and_gain_of_the_sense_do_not_shift_what_is_found() {
    let mut stand = Stand::full();
    for (needle, gain) in stand.needles.iter_mut().zip([0.6, 1.8]) {
        (needle.trails, needle.gains) = (0.05, [gain; 2]);
    }
    assert_eq!(stand.end(), Progress::Done);
    for (needle, found) in stand.needles.iter().zip(stand.aligner.results()) {
        let offset = turns(found.electrical_offset.raw()) - needle.offset;
        assert!((offset - offset.round()).abs() < 6e-3, "electrical offset is off by {offset}");
    }
}

#[test]
fn the_field_goes_a_turn_and_a_quarter_and_back_at_the_times_that_are_promised() {
    let mut stand = Stand::full();
    while stand.aligner.stage == Stage::Rest {
        stand.tick();
    }
    assert_eq!(stand.stage(), (Stage::Zero, 1_024));
    assert_eq!(stand.stage(), (Stage::Ramp, 4_501));
    let start = stand.needles.map(|needle| needle.angle);
    assert_eq!(stand.stage(), (Stage::Forward, 11_265));
    for (needle, start) in stand.needles.iter().zip(start) {
        let travel = needle.angle - start;
        assert!((travel - 1.25).abs() < 1e-3, "{travel} turns");
    }
    assert_eq!(stand.stage(), (Stage::Back, 11_265));
    for (needle, start) in stand.needles.iter().zip(start) {
        let travel = needle.angle - start;
        assert!(travel.abs() < 1e-3, "{travel} turns");
    }
}

#[test]
fn the_field_grows_for_150_ms_a_quarter_turn_behind_and_then_turns_to_where_it_begins() {
    let mut stand = Stand::full();
    while stand.aligner.stage != Stage::Ramp {
        stand.tick();
    }
    let volts = stand.configuration.alignment_voltage.map(|it| f64::from(it.raw()) / 65_536.0);
    for tick in 1..=4_500 {
        stand.tick();
        let share = f64::from(tick.min(1_500)) / 1_500.0;
        let angle = -0.25 * (1.0 - f64::from((tick - 1_500).clamp(0, 1_500)) / 1_500.0);
        for (bridge, volts) in stand.bridges.iter().zip(volts) {
            let Bridge::Duty(duties) = *bridge else { unreachable!("a field") };
            let (voltage, direction) = field_of(duties, 12.0);
            assert!((voltage - share * volts).abs() < 0.01 * volts, "{voltage} V in {tick}");
            assert!(share < 0.1 || (direction - angle).abs() < 3e-3, "{direction} in {tick}");
        }
    }
}

#[test]
fn a_current_beyond_the_supply_becomes_what_the_supply_gives() {
    let strong = Settings { phase_resistance: [30.0, 10.0], ..settings() };
    for full in [true, false] {
        let mut stand = Stand::with(full, &strong);
        stand.remember();
        stand.aligner = Aligner::new(full, &stand.configuration);
        let mut largest = [0.0_f64; 2];
        let mut progress = Progress::Busy;
        while progress == Progress::Busy && stand.ticks < LONG {
            progress = stand.tick();
            for (largest, bridge) in largest.iter_mut().zip(stand.bridges) {
                if let Bridge::Duty(duties) = bridge {
                    *largest = largest.max(field_of(duties, 12.0).0);
                }
            }
        }
        assert_eq!(progress, Progress::Done);
        // 0.9 of 12 V / sqrt(3), and a hundredth for what the magnets give.
        assert!((largest[0] - 6.235).abs() < 0.07, "{} V", largest[0]);
        for (gain, is_found) in [(0.45, false), (0.55, true), (1.9, true), (2.1, false)] {
            let mut stand = stand.clone();
            stand.aligner = Aligner::new(full, &stand.configuration);
            stand.ticks = 0;
            stand.needles[0].gains = [gain; 2];
            assert_eq!(stand.end() == Progress::Done, is_found, "{gain}");
        }
    }
}

#[test]
fn the_voltage_that_dead_time_takes_is_added() {
    let mut stand = Stand::full();
    // 1.25 % of 12 V.
    stand.bus = Bus::new(Voltage::from_volts(12.0), (0.0125 * 2_147_483_648.0) as i32);
    while stand.aligner.stage != Stage::Forward {
        stand.tick();
    }
    for (bridge, volts) in stand.bridges.iter().zip(stand.configuration.alignment_voltage) {
        // Along phase A: current into A, and half of it out of B and C each.
        let Bridge::Duty([a, b, _]) = *bridge else { unreachable!("a field") };
        let between = 12.0 * (f64::from(a.raw()) - f64::from(b.raw())) / 65_536.0;
        let expected = 1.5 * f64::from(volts.raw()) / 65_536.0 + 2.0 * 0.15;
        assert!((between - expected).abs() < 0.02, "{between} V for {expected} V");
    }
}

#[test]
fn what_the_magnets_give_while_they_turn_is_added_a_quarter_turn_ahead() {
    let turning = |flux: f32| {
        let mut stand = Stand::with(true, &Settings { flux_linkage: [flux; 2], ..settings() });
        while stand.aligner.stage != Stage::Forward {
            stand.tick();
        }
        for _ in 0..4_000 {
            stand.tick();
        }
        let fields = stand.bridges.map(|bridge| {
            let Bridge::Duty(duties) = bridge else { unreachable!("a field") };
            field_of(duties, 12.0)
        });
        (fields, f64::from(stand.aligner.rate) / TURN * 1e4)
    };
    let ((weak, rate), (strong, _)) = (turning(0.2), turning(10.2));
    let back_emf = TAU * POLE_PAIRS * rate * 10e-3;
    assert!(back_emf > 0.2, "{back_emf} V");
    for ((weak, ahead), (strong, direction)) in weak.into_iter().zip(strong) {
        let turn = (direction - ahead) * TAU;
        // Beside the field, and across it.
        let (beside, across) = (strong * turn.cos() - weak, strong * turn.sin());
        assert!(beside.abs() < 0.02, "{beside} V");
        assert!((across - back_emf).abs() < 0.02, "{across} V for {back_emf} V");
    }
}

#[test]
fn nothing_is_driven_before_both_rotors_stood_still_for_50_ms() {
    // The trackers are settled 200 ticks after their first reading.
    let mut stand = Stand::full();
    assert_eq!(stand.stage(), (Stage::Rest, 700));
    for motor in [0, 1] {
        let mut stand = Stand::full();
        // 0.4 Hz is standing still; 0.6 Hz is not.
        stand.needles[motor].pushed = 0.4 / 10_000.0;
        assert_eq!(stand.stage().0, Stage::Rest);
        assert_eq!(stand.aligner.stage, Stage::Zero);
        let mut stand = Stand::full();
        stand.needles[motor].pushed = 0.6 / 10_000.0;
        for _ in 0..600 {
            assert_eq!((stand.tick(), stand.bridges), (Progress::Busy, [Bridge::BRAKE; 2]));
        }
        assert_eq!(stand.end(), Progress::Failed(Fault::Alignment));
        // 2 s, and the tick in which it is found.
        assert_eq!(stand.ticks, 20_001);
    }
    let mut stand = Stand::full();
    for _ in 0..600 {
        stand.tick();
    }
    stand.needles[1].pushed = 2.0 / 10_000.0;
    for _ in 0..200 {
        stand.tick();
    }
    stand.needles[1].pushed = 0.0;
    let (_, ticks) = stand.stage();
    assert!(ticks > 500, "{ticks}");
}

#[test]
fn a_rotor_stands_still_below_half_a_hertz_and_not_at_it() {
    for (speed, stage) in [(STILL - Speed::from_raw(1), Stage::Zero), (STILL, Stage::Rest)] {
        for motor in [0, 1] {
            let mut stand = Stand::full();
            while !stand.trackers[motor].settled() {
                stand.tick();
            }
            let change = speed - stand.trackers[motor].speed();
            stand.trackers[motor].feed_forward(change);
            stand.aligner = Aligner::new(true, &stand.configuration);
            let Stand { trackers, bus, configuration, aligner, .. } = &mut stand;
            let observation = Observation { trackers, counts: None, bus };
            for _ in 0..STILL_TICKS {
                aligner.update(configuration, &observation);
            }
            assert_eq!(aligner.stage, stage, "{speed:?}");
        }
    }
}

#[test]
fn the_bridges_are_off_while_the_current_zero_is_averaged() {
    let mut stand = Stand::full();
    stand.stage();
    let zeros = [[37, -12], [5, 80]];
    for tick in 0..1_024 {
        for (needle, zeros) in stand.needles.iter_mut().zip(zeros) {
            let design = stand.configuration.zero_design.raw();
            // Noise of which the mean is zero.
            needle.zeros = zeros.map(|zero| design + zero + if tick % 2 == 0 { 9 } else { -9 });
        }
        if tick > 0 {
            assert_eq!(stand.bridges, [Bridge::Off; 2]);
        }
        stand.tick();
    }
    assert_eq!(stand.aligner.stage, Stage::Ramp);
    let design = stand.configuration.zero_design;
    let found = stand.aligner.zeros.map(|zeros| zeros.map(|zero| (zero - design).raw()));
    assert_eq!(found, zeros);
}

#[test]
fn a_current_zero_beyond_its_tolerance_is_a_fault_of_the_current_sense() {
    for (motor, phase, sign) in [(0, 0, 1), (0, 1, -1), (1, 0, -1), (1, 1, 1)] {
        for (beyond, expected) in [(0, Progress::Busy), (1, Progress::Failed(Fault::CurrentSense))]
        {
            let mut stand = Stand::full();
            let Configuration { zero_design, zero_tolerance, .. } = stand.configuration;
            stand.needles[motor].zeros[phase] =
                zero_design.raw() + sign * (zero_tolerance.raw() + beyond);
            stand.stage();
            let mut progress = Progress::Busy;
            for _ in 0..1_024 {
                progress = stand.tick();
            }
            assert_eq!(progress, expected, "{motor} {phase} {sign}");
        }
    }
}

#[test]
fn without_a_current_sense_all_else_is_found() {
    let mut stand = Stand::full();
    stand.sensed = false;
    stand.needles[0].reversed = true;
    stand.stage();
    assert_eq!(stand.stage(), (Stage::Zero, 1));
    assert_eq!(stand.end(), Progress::Done);
    assert_eq!(stand.aligner.results().map(|found| found.reversed), [true, false]);
}

/// Returns how an alignment ends after this change of a motor, be it the one or the other.
#[track_caller]
fn ends(stand: &Stand, change: impl Fn(&mut Needle), expected: Progress) {
    for motor in [0, 1] {
        let mut stand = stand.clone();
        change(&mut stand.needles[motor]);
        assert_eq!(stand.end(), expected, "motor {motor}");
    }
}

#[test]
fn current_that_is_not_what_the_voltage_drives_is_a_fault_of_the_current_sense() {
    let sense = Progress::Failed(Fault::CurrentSense);
    for stand in [Stand::full(), Stand::remembering()] {
        for (gain, expected) in
            [(0.45, sense), (0.55, Progress::Done), (1.95, Progress::Done), (2.05, sense)]
        {
            ends(&stand, |needle| needle.gains = [gain; 2], expected);
        }
    }
    for gains in [[1.0, -1.0], [-1.0, 1.0], [0.0, 1.0], [1.0, 0.0]] {
        ends(&Stand::full(), |needle| needle.gains = gains, sense);
    }
    let inverted = |needle: &mut Needle| needle.gains = [-1.0; 2];
    ends(&Stand::full(), inverted, Progress::Done);
    ends(&Stand::remembering(), inverted, sense);
    ends(&Stand::full(), |needle| needle.gains = [-2.05; 2], sense);
    ends(&Stand::full(), |needle| needle.gains = [-0.45; 2], sense);
}

#[test]
fn a_rotor_that_loses_the_field_is_a_fault_of_alignment() {
    let failed = Progress::Failed(Fault::Alignment);
    let full = Stand::full();
    ends(&full, |needle| needle.follows = 0.0, failed);
    ends(&full, |needle| needle.trails = 0.12, Progress::Done);
    ends(&full, |needle| needle.trails = 0.13, failed);
}

#[test]
fn the_field_may_be_lost_outside_the_turn_that_counts() {
    let failed = Progress::Failed(Fault::Alignment);
    let mut stand = Stand::full();
    while stand.aligner.stage != Stage::Forward {
        stand.tick();
    }
    let [standing, elsewhere] = [stand.trackers, [Tracker::new(); 2]];
    for (tick, trackers, expected) in [
        (WINDOW_BEGIN - 1, &elsewhere, Progress::Busy),
        (WINDOW_BEGIN, &standing, failed),
        (WINDOW_END - 1, &elsewhere, failed),
        (WINDOW_END, &elsewhere, Progress::Busy),
    ] {
        while stand.aligner.tick < tick {
            stand.tick();
        }
        let Stand { aligner, configuration, bus, .. } = &stand;
        let observation = Observation { trackers, counts: None, bus };
        assert_eq!(aligner.clone().update(configuration, &observation).1, expected, "{tick}");
    }
}

#[test]
fn a_remembered_alignment_is_checked_within_an_eighth_of_an_electrical_turn() {
    let failed = Progress::Failed(Fault::Alignment);
    for reversed in [false, true] {
        let mut stand = Stand::remembering();
        for needle in &mut stand.needles {
            needle.reversed = reversed;
        }
        stand.remember();
        for (moved, expected) in [
            (0.0, Progress::Done),
            (0.12, Progress::Done),
            (-0.12, Progress::Done),
            (0.13, failed),
            (-0.13, failed),
        ] {
            ends(&stand, |needle| needle.offset += moved, expected);
        }
        ends(&stand, |needle| needle.reversed = !reversed, failed);
        ends(&stand, |needle| needle.follows = 0.0, failed);
    }
}

#[test]
fn a_remembered_polarity_of_the_current_sense_is_checked() {
    let mut stand = Stand::remembering();
    for needle in &mut stand.needles {
        needle.gains = [-1.0; 2];
    }
    stand.remember();
    ends(&stand, |_| {}, Progress::Done);
    let other = |needle: &mut Needle| needle.gains = [1.0; 2];
    ends(&stand, other, Progress::Failed(Fault::CurrentSense));
}

#[test]
fn a_check_takes_the_rotors_a_quarter_electrical_turn_and_changes_nothing() {
    let mut stand = Stand::remembering();
    let remembered = stand.aligner.results();
    stand.stage();
    stand.stage();
    let begun = stand.needles.map(|needle| needle.angle);
    assert_eq!(stand.stage(), (Stage::Ramp, 1_501));
    for (needle, begun) in stand.needles.iter().zip(begun) {
        assert!((needle.angle - begun).abs() < 1e-4, "they are there already");
    }
    assert_eq!(stand.stage(), (Stage::Check, 2_001));
    for (needle, begun) in stand.needles.iter().zip(begun) {
        let travel = (needle.angle - begun) * POLE_PAIRS;
        assert!((travel - 0.25).abs() < 1e-3, "{travel} electrical turns");
    }
    assert_eq!(stand.aligner.results(), remembered);
}
