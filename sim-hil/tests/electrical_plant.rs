//! The electrical plant obeys the circuit and friction laws that its modules state.

use std::f64::consts::TAU;
use std::num::NonZeroU16;

use flix_firmware::hardware::{
    Actuation, Bridge, CurrentSense, Duty, Encoder, Hardware, TICK_RATE_HZ,
};
use flix_sim::plant::electronics::motor::MotorParameters;
use flix_sim::plant::electronics::sensor::{
    AS5600, AmplifierParameters, EncoderParameters, MT6701, as5600,
};
use flix_sim::plant::electronics::{Electronics, ElectronicsParameters, TICK};
use flix_sim::plant::{Diverged, Mechanics};

/// Two wheels on a fixed axis, turned by the motors alone.
struct Wheels {
    inertia: f64,
    angle: [f64; 2],
    speed: [f64; 2],
}

impl Wheels {
    const ROTOR: f64 = 1.0e-5;

    fn at_rest(inertia: f64) -> Self {
        Self { inertia, angle: [0.3, -0.2], speed: [0.0; 2] }
    }

    fn spinning(speed: f64) -> Self {
        Self { speed: [speed, -speed], ..Self::at_rest(Self::ROTOR) }
    }

    /// Too heavy to be moved by any torque.
    fn driven_at(speed: f64) -> Self {
        Self { inertia: 1e9, ..Self::spinning(speed) }
    }

    fn kinetic_energy(&self) -> f64 {
        self.speed.iter().map(|speed| 0.5 * self.inertia * speed * speed).sum()
    }
}

impl Mechanics for Wheels {
    fn step(&mut self, motor_torque: [f64; 2], dt: f64) -> Result<(), Diverged> {
        for (index, torque) in motor_torque.into_iter().enumerate() {
            let before = self.speed[index];
            self.speed[index] += torque / self.inertia * dt;
            self.angle[index] += 0.5 * (before + self.speed[index]) * dt;
        }
        Ok(())
    }
    fn rotor_angle(&self) -> [f64; 2] {
        self.angle
    }
    fn rotor_speed(&self) -> [f64; 2] {
        self.speed
    }
    fn shaker_force(&self) -> [f64; 3] {
        [0.0; 3]
    }
}

/// A board without dead time, so that a duty is a voltage.
const IDEAL_BOARD: Hardware = Hardware {
    name: "test",
    current_sense: Some(CurrentSense {
        microamperes_per_count: 1600,
        zero_count: 2048,
        valid_counts: (0, 4095),
    }),
    bus_microvolts_per_count: NonZeroU16::new(4000),
    bus_largest_count: 4095,
    dead_time_ns: 0,
    pwm_frequency_hz: 20_000,
    actuation_delay_us: Hardware::actuation_delay(20_000),
    can_coast: true,
};

fn without_friction(mut parameters: ElectronicsParameters) -> ElectronicsParameters {
    parameters.motor = MotorParameters {
        cogging_torque: 0.0,
        viscous_friction: 0.0,
        coulomb_friction: 1e-12,
        ..parameters.motor
    };
    parameters
}

fn ideal() -> ElectronicsParameters {
    ElectronicsParameters { motor_difference: 0.0, ..ElectronicsParameters::on(IDEAL_BOARD) }
}

fn duties(shares: [f64; 3]) -> Actuation {
    let duties = shares.map(|share| Duty::from_raw((share * f64::from(u16::MAX)).round() as u16));
    Actuation { bridges: [Bridge::Duty(duties); 2] }
}

fn run(
    electronics: &mut Electronics,
    mechanics: &mut impl Mechanics,
    actuation: &Actuation,
    seconds: f64,
) {
    for _ in 0..(seconds / TICK).round() as usize {
        electronics.advance(actuation, mechanics).expect("wheels cannot diverge");
    }
}

fn amplitude([a, b, c]: [f64; 3]) -> f64 {
    (2.0 / 3.0 * (a * a + b * b + c * c)).sqrt()
}

#[test]
fn current_of_a_locked_motor_rises_with_inductance_over_resistance_to_voltage_over_resistance() {
    // The duties of a tick act from the second peak of the carrier on, which of a slow one comes in the next tick.
    for (pwm_frequency_hz, late) in [(20_000, 0.75), (10_000, 1.5), (30_000, 0.5)] {
        current_of_a_locked_motor(pwm_frequency_hz, late);
    }
}

/// Looks at the current of a locked motor, whose duties act so many ticks late.
fn current_of_a_locked_motor(pwm_frequency_hz: u32, late: f64) {
    let mut parameters = ideal();
    parameters.hardware = Hardware {
        pwm_frequency_hz,
        actuation_delay_us: Hardware::actuation_delay(pwm_frequency_hz),
        ..parameters.hardware
    };
    let mut electronics = Electronics::new(&parameters, 1);
    let mut locked = Wheels::driven_at(0.0);
    let drive = duties([0.6, 0.4, 0.4]);
    let time_constant = parameters.motor.inductance / parameters.motor.resistance;
    let ticks = 4;
    run(&mut electronics, &mut locked, &drive, f64::from(ticks) * TICK);
    let early = electronics.phase_currents()[0][0];
    run(&mut electronics, &mut locked, &drive, 0.1);
    let voltage = 2.0 / 3.0 * 0.2 * electronics.battery().bus_voltage();
    let settled = voltage / parameters.motor.resistance;
    assert!((electronics.phase_currents()[0][0] / settled - 1.0).abs() < 2e-3);
    let expected = settled * (1.0 - (-(f64::from(ticks) - late) * TICK / time_constant).exp());
    assert!((early / expected - 1.0).abs() < 1e-2, "{early} A, expected {expected} A");
}

#[test]
fn a_coasting_motor_shows_no_back_emf_current_below_the_bus_and_rectifies_above() {
    let mut slow = Electronics::new(&ideal(), 1);
    run(&mut slow, &mut Wheels::driven_at(TAU * 40.0), &Actuation::OFF, 0.05);
    let mut fast = Electronics::new(&ideal(), 1);
    run(&mut fast, &mut Wheels::driven_at(TAU * 70.0), &Actuation::OFF, 0.05);
    let charging = fast.battery().delivered() < 0.0;
    assert_eq!((amplitude(slow.phase_currents()[0]), charging), (0.0, true));
}

#[test]
fn letting_go_ends_the_current_within_half_a_millisecond() {
    let mut electronics = Electronics::new(&ideal(), 1);
    let mut locked = Wheels::driven_at(0.0);
    run(&mut electronics, &mut locked, &duties([0.6, 0.4, 0.4]), 0.01);
    assert!(amplitude(electronics.phase_currents()[0]) > 0.3);
    run(&mut electronics, &mut locked, &Actuation::OFF, 0.5e-3);
    assert_eq!(electronics.phase_currents(), [[0.0; 3]; 2]);
}

#[test]
fn a_board_that_cannot_coast_brakes_with_the_short_circuit_current() {
    let mut parameters = ideal();
    parameters.hardware.can_coast = false;
    let mut electronics = Electronics::new(&parameters, 1);
    let speed = TAU * 20.0;
    run(&mut electronics, &mut Wheels::driven_at(speed), &Actuation::OFF, 0.05);
    let motor = parameters.motor;
    let electrical = 7.0 * speed;
    let impedance = motor.resistance.hypot(electrical * motor.inductance);
    let expected = electrical * motor.flux_linkage / impedance;
    let measured = amplitude(electronics.phase_currents()[0]);
    assert!((measured / expected - 1.0).abs() < 1e-3, "{measured} A, expected {expected} A");
}

#[test]
fn dead_time_takes_its_share_of_the_bus_from_the_driving_side() {
    let mut parameters = ideal();
    parameters.hardware.dead_time_ns = 500;
    let mut with_dead_time = |dead_time_ns| {
        parameters.hardware.dead_time_ns = dead_time_ns;
        let mut electronics = Electronics::new(&parameters, 1);
        run(&mut electronics, &mut Wheels::driven_at(0.0), &duties([0.6, 0.4, 0.4]), 0.05);
        electronics.phase_currents()[0][0] / electronics.battery().bus_voltage()
    };
    let lost = with_dead_time(0) - with_dead_time(500);
    // Phase A loses 1 % of the bus, B and C gain as much: 4/3 of it along A.
    let expected = 4.0 / 3.0 * 0.01 / ideal().motor.resistance;
    assert!((lost / expected - 1.0).abs() < 1e-2, "{lost}, expected {expected}");
}

#[test]
fn an_open_phase_carries_nothing_and_the_others_are_in_series() {
    let parameters = ideal();
    let mut electronics = Electronics::new(&parameters, 1);
    electronics.motor_mut(0).break_wire(2, true);
    run(&mut electronics, &mut Wheels::driven_at(0.0), &duties([0.6, 0.4, 0.9]), 0.05);
    let [a, b, c] = electronics.phase_currents()[0];
    let expected = 0.2 * electronics.battery().bus_voltage() / (2.0 * parameters.motor.resistance);
    assert!(c == 0.0 && (a + b).abs() < 1e-12 && (a / expected - 1.0).abs() < 1e-2);
}

#[test]
fn a_freely_turning_rotating_field_takes_the_rotor_to_its_speed() {
    let mut electronics = Electronics::new(&without_friction(ideal()), 3);
    let mut wheels = Wheels::at_rest(Wheels::ROTOR);
    let mut phase: f64 = 0.0;
    for tick in 0..30_000 {
        let frequency = 7.0 * 10.0 * (f64::from(tick) / 20_000.0).min(1.0);
        phase += TAU * frequency * TICK;
        let wave = [0.0, 1.0, 2.0].map(|k: f64| 0.5 + 0.2 * (phase - k * TAU / 3.0).cos());
        electronics.advance(&duties(wave), &mut wheels).unwrap();
    }
    let turns_per_second = wheels.speed.map(|speed| (speed / TAU).abs());
    assert!(turns_per_second.iter().all(|f| (f - 10.0).abs() < 1.0), "{turns_per_second:?}");
}

#[test]
fn energy_from_the_battery_is_all_accounted_for() {
    let mut parameters = ElectronicsParameters::on(IDEAL_BOARD);
    parameters.hardware.dead_time_ns = 500;
    let mut electronics = Electronics::new(&parameters, 5);
    let mut wheels = Wheels::at_rest(Wheels::ROTOR);
    let mut phase: f64 = 0.0;
    for tick in 0..20_000 {
        phase += TAU * 7.0 * 15.0 * (f64::from(tick) / 10_000.0).min(1.0) * TICK;
        let wave = [0.0, 1.0, 2.0].map(|k: f64| 0.5 + 0.25 * (phase - k * TAU / 3.0).cos());
        electronics.advance(&duties(wave), &mut wheels).unwrap();
    }
    run(&mut electronics, &mut wheels, &Actuation::OFF, 0.3);
    let ledger = electronics.ledger(wheels.angle);
    assert!(ledger.battery > 1.0 && ledger.copper > 0.1 && ledger.friction > 0.01);
    assert!((ledger.mechanical - wheels.kinetic_energy()).abs() < 1e-9);
    assert!(ledger.imbalance().abs() < 0.005 * ledger.battery, "{ledger:?}");
}

#[test]
fn the_bus_sags_by_what_the_battery_resistance_takes() {
    let parameters = ideal();
    let mut electronics = Electronics::new(&parameters, 1);
    run(&mut electronics, &mut Wheels::driven_at(0.0), &duties([0.7, 0.3, 0.3]), 0.1);
    let battery = electronics.battery();
    let [a, b, c] = electronics.phase_currents()[0];
    let drawn = 2.0 * (0.7 * a + 0.3 * b + 0.3 * c);
    let sag = battery.open_circuit_voltage() - battery.bus_voltage();
    assert!((sag / (parameters.battery.resistance * drawn) - 1.0).abs() < 1e-3);
}

#[test]
fn charge_falls_by_what_was_drawn_and_voltage_falls_with_charge() {
    let parameters = ideal();
    let mut electronics = Electronics::new(&parameters, 1);
    let (charge, voltage) =
        (electronics.battery().charge(), electronics.battery().open_circuit_voltage());
    run(&mut electronics, &mut Wheels::driven_at(0.0), &duties([0.7, 0.3, 0.3]), 1.0);
    let [a, b, c] = electronics.phase_currents()[0];
    let drawn = 2.0 * (0.7 * a + 0.3 * b + 0.3 * c) * 1.0 / parameters.battery.capacity;
    let fell = charge - electronics.battery().charge();
    assert!((fell / drawn - 1.0).abs() < 0.01, "{fell}, drawn {drawn}");
    assert!(electronics.battery().open_circuit_voltage() < voltage);
}

/// Holds both wheels under a torque of the field alone and returns how far they crept.
fn creep_under(torque: f64, seconds: f64) -> f64 {
    let mut parameters = ideal();
    parameters.motor.cogging_torque = 0.0;
    let mut electronics = Electronics::new(&parameters, 1);
    let pull = Pulled { wheels: Wheels::at_rest(Wheels::ROTOR), torque };
    let mut pulled = pull;
    run(&mut electronics, &mut pulled, &Actuation::OFF, 0.2);
    let before = pulled.wheels.angle;
    run(&mut electronics, &mut pulled, &Actuation::OFF, seconds);
    (pulled.wheels.angle[0] - before[0]).abs()
}

/// Wheels with a string wound round them.
struct Pulled {
    wheels: Wheels,
    torque: f64,
}

impl Mechanics for Pulled {
    fn step(&mut self, motor_torque: [f64; 2], dt: f64) -> Result<(), Diverged> {
        self.wheels.step(motor_torque.map(|motor| motor + self.torque), dt)
    }
    fn rotor_angle(&self) -> [f64; 2] {
        self.wheels.angle
    }
    fn rotor_speed(&self) -> [f64; 2] {
        self.wheels.speed
    }
    fn shaker_force(&self) -> [f64; 3] {
        [0.0; 3]
    }
}

#[test]
fn a_rotor_sticks_below_its_coulomb_torque_and_slides_above() {
    let coulomb = ideal().motor.coulomb_friction;
    let (below, above) = (creep_under(0.95 * coulomb, 1.0), creep_under(1.05 * coulomb, 1.0));
    assert!(below < 1e-9 && above > 0.5, "crept {below} rad below, {above} rad above");
}

#[test]
fn a_coasting_rotor_loses_speed_as_coulomb_and_viscous_friction_say() {
    let mut parameters = ideal();
    parameters.motor.cogging_torque = 0.0;
    let mut electronics = Electronics::new(&parameters, 1);
    let mut wheels = Wheels::spinning(200.0);
    run(&mut electronics, &mut wheels, &Actuation::OFF, 0.5);
    let MotorParameters { viscous_friction: b, coulomb_friction: c, .. } = parameters.motor;
    let decay = (-b / Wheels::ROTOR * 0.5).exp();
    let expected = (200.0 + c / b) * decay - c / b;
    assert!((wheels.speed[0] / expected - 1.0).abs() < 1e-3 && wheels.speed[1] == -wheels.speed[0]);
}

#[test]
fn the_two_motors_differ_by_ten_percent_in_resistance_flux_and_friction() {
    for seed in 0..20 {
        let electronics = Electronics::new(&ElectronicsParameters::on(IDEAL_BOARD), seed);
        let of = |value: fn(&MotorParameters) -> f64| {
            let [top, bottom] = [0, 1].map(|index| value(electronics.motor(index).parameters()));
            (top - bottom).abs() / (0.5 * (top + bottom))
        };
        for difference in [of(|m| m.resistance), of(|m| m.flux_linkage), of(|m| m.coulomb_friction)]
        {
            assert!((difference - 0.10).abs() < 1e-9);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_others() {
    let run_of = |seed| {
        let mut electronics = Electronics::new(&ElectronicsParameters::on(IDEAL_BOARD), seed);
        let mut wheels = Wheels::spinning(100.0);
        let mut seen = Vec::new();
        for _ in 0..500 {
            seen.push(electronics.sense(&wheels));
            electronics.advance(&duties([0.55, 0.5, 0.45]), &mut wheels).unwrap();
        }
        (seen, wheels.angle.map(f64::to_bits))
    };
    assert!(run_of(7) == run_of(7) && run_of(7) != run_of(8));
}

#[test]
fn phase_currents_are_counted_within_gain_offset_and_noise_and_clip_where_the_board_does() {
    let mut parameters = ideal();
    parameters.hardware.current_sense = Some(CurrentSense {
        microamperes_per_count: 1600,
        zero_count: 2048,
        valid_counts: (2000, 4095),
    });
    parameters.amplifier = AmplifierParameters { noise: 3.0, offset: 10.0, gain_error: 0.01 };
    for seed in 0..10 {
        let mut electronics = Electronics::new(&parameters, seed);
        let mut locked = Wheels::driven_at(0.0);
        run(&mut electronics, &mut locked, &duties([0.6, 0.4, 0.4]), 0.02);
        let [a, b] = electronics.sense(&locked).phase_current.unwrap()[0].map(f64::from);
        let [amperes_a, amperes_b, _] = electronics.phase_currents()[0];
        let ideal_count = |amperes: f64| [1.0, -1.0].map(|sign| 2048.0 + sign * amperes / 1.6e-3);
        let near = |count: f64, amperes: f64| {
            ideal_count(amperes).iter().any(|ideal| {
                (count - ideal.max(2000.0)).abs() < 10.0 + 5.0 * 3.0 + 0.01 * (ideal - 2048.0).abs()
            })
        };
        assert!(near(a, amperes_a) && near(b, amperes_b), "{a} {b} {amperes_a} {amperes_b}");
        assert!(a >= 2000.0 && b >= 2000.0);
    }
}

/// RMS of how far the mean of two ticks' counts of a perfect amplifier is off from the current, A, over 20 starts.
fn sense_error(pwm_frequency_hz: u32) -> f64 {
    const STARTS: u64 = 20;
    let mut parameters = ideal();
    parameters.hardware.pwm_frequency_hz = pwm_frequency_hz;
    parameters.amplifier = AmplifierParameters { noise: 0.0, offset: 0.0, gain_error: 0.0 };
    let square = |seed| {
        let mut electronics = Electronics::new(&parameters, seed);
        let mut locked = Wheels::driven_at(0.0);
        let actuation = duties([0.8, 0.3, 0.3]);
        run(&mut electronics, &mut locked, &actuation, 0.02);
        let mut counts = 0.0;
        for _ in 0..2 {
            let sensed = electronics.sense(&locked).phase_current.expect("it has amplifiers");
            counts += f64::from(sensed[0][0]) - 2048.0;
            run(&mut electronics, &mut locked, &actuation, TICK);
        }
        let read = counts / 2.0 * 1.6e-3;
        (read.abs() - electronics.phase_currents()[0][0].abs()).powi(2)
    };
    ((0..STARTS).map(square).sum::<f64>() / STARTS as f64).sqrt()
}

#[test]
fn the_ripple_is_in_the_phase_currents_that_are_read_unless_ticks_are_tied_to_the_pwm() {
    let [tied, untied] = [20_000, 25_000].map(sense_error);
    assert!(tied < 0.002 && untied > 0.005, "{tied} {untied}");
}

fn readings(encoder: EncoderParameters, speed: f64) -> Vec<(f64, Encoder)> {
    let parameters = ElectronicsParameters { encoder, ..ideal() };
    let mut electronics = Electronics::new(&parameters, 11);
    let mut wheels = Wheels::driven_at(speed);
    let ticks = TICK_RATE_HZ / 5;
    (0..ticks)
        .map(|_| {
            let reading = electronics.sense(&wheels).encoders[0];
            let angle = wheels.angle[0];
            electronics.advance(&Actuation::OFF, &mut wheels).expect("wheels cannot diverge");
            (angle, reading)
        })
        .collect()
}

#[test]
fn a_slow_encoder_bus_delivers_every_other_tick() {
    let delivered =
        readings(AS5600, 50.0).iter().filter(|(_, r)| matches!(r, Encoder::Reading(_))).count();
    assert_eq!(delivered, TICK_RATE_HZ as usize / 10);
}

#[test]
fn the_age_that_the_firmware_states_is_that_of_the_filter_it_sets() {
    assert!(AS5600.late_us.abs() < 1.0, "{AS5600:?}");
    assert!(as5600([0, 0]).late_us > 900.0, "the filter it is sold with settles in 2.2 ms");
}

#[test]
fn readings_put_back_by_their_age_are_within_the_data_sheets_error() {
    for encoder in [AS5600, MT6701] {
        let speed = TAU * 30.0;
        for (angle, reading) in readings(encoder, speed) {
            let Encoder::Reading(reading) = reading else { continue };
            assert_eq!(
                reading.angle.raw().trailing_zeros().min(32 - encoder.bits),
                32 - encoder.bits
            );
            let seen = f64::from(reading.angle.raw()) / 4_294_967_296.0 * TAU
                + speed * f64::from(reading.age_us) * 1e-6;
            let error = (seen - angle + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            let age_error = speed * encoder.age_error_us * 1e-6;
            assert!(
                error.abs() < 1.5f64.to_radians() + age_error,
                "{} degrees",
                error.to_degrees()
            );
        }
    }
}

#[test]
fn the_bus_divider_counts_the_bus_voltage() {
    let mut electronics = Electronics::new(&ideal(), 2);
    let counts = electronics.sense(&Wheels::at_rest(1.0)).bus_voltage.unwrap();
    let seen = f64::from(counts) * 4e-3;
    assert!((seen / electronics.battery().bus_voltage() - 1.0).abs() < 0.012);
}
