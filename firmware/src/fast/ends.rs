//! The ends of all settings, and the fixed point of the fast half beside double precision there: shifts, `wrapping_` and
//! saturating `as` are seen by no overflow check.

use core::f64::consts::TAU;
use std::vec::Vec;

use crate::fast::configuration::Configuration;
use crate::fast::foc::burning;
use crate::fast::foc::current::{DELAY_BITS, PROPORTIONAL_BITS, REACTANCE_BITS};
use crate::fast::shaker::INTEGRAL_BITS;
use crate::fast::tracker::ANGLE_GAIN_BITS;
use crate::hardware::Hardware;
use crate::settings::{Settings, TABLE};

/// Settings that the gains of the loops are made of.
const NAMES: [&str; 11] = [
    "phase_resistance",
    "phase_inductance",
    "flux_linkage",
    "pole_pairs",
    "rotor_inertia",
    "current_limit",
    "current_bandwidth",
    "position_bandwidth",
    "tracker_bandwidth",
    "encoder_latency",
    "actuation_delay",
];

/// Returns the defaults, and every choice of least and largest values of [`NAMES`], both motors alike.
pub(crate) fn settings() -> impl Iterator<Item = Settings> {
    let chosen = (0..1_u32 << NAMES.len()).map(|ends| {
        let mut settings = Settings::DEFAULT;
        (settings.over_current, settings.alignment_current) = (30.0, 0.05);
        for (bit, name) in NAMES.into_iter().enumerate() {
            let of_name = |it: &&crate::settings::Setting| {
                it.name == name || it.name.strip_prefix("top_") == Some(name)
            };
            let setting = TABLE.iter().find(of_name).unwrap();
            let value = if ends >> bit & 1 == 0 { setting.minimum } else { setting.maximum };
            for name in [setting.name.into(), setting.name.replace("top_", "bottom_")] {
                let name: std::string::String = name;
                settings.set(&name, value).unwrap();
            }
        }
        settings
    });
    core::iter::once(Settings::DEFAULT).chain(chosen)
}

/// A gain in fixed point, its bits, and what it should be.
type Gain = (&'static str, i32, i32, f64);

fn gains(settings: &Settings, hardware: &Hardware) -> Vec<Gain> {
    let configuration = Configuration::new(settings, hardware);
    let (motor, encoder, shaker) =
        (&configuration.motors[1], &configuration.encoders[1], &configuration.shaker);
    let rate = 1e4;
    let resistance = f64::from(settings.phase_resistance[1]);
    let inductance = 1e-3 * f64::from(settings.phase_inductance[1]);
    let flux = 1e-3 * f64::from(settings.flux_linkage[1]);
    let current = TAU * f64::from(settings.current_bandwidth);
    let natural = TAU * f64::from(settings.position_bandwidth) / rate;
    let tracker = TAU * f64::from(settings.tracker_bandwidth) / rate;
    let late = f64::from(settings.encoder_latency) * 1e-6 * rate;
    let inertia = 1e-7 * f64::from(settings.rotor_inertia);
    let torque = 1.5 * f64::from(settings.pole_pairs) * flux;
    // A per (turn per tick^2).
    let accelerating = inertia * TAU * rate * rate / torque;
    let shift = shaker.acceleration_shift as i32;
    std::vec![
        ("proportional", motor.proportional, PROPORTIONAL_BITS as i32, inductance * current),
        ("integral", motor.integral, 24, resistance * current / rate),
        ("resistance", motor.resistance, 24, resistance),
        ("conductance", motor.conductance, 24, 1.0 / resistance),
        (
            "admittance",
            motor.admittance,
            24,
            (1.0 - (-resistance / rate / inductance).exp()) / resistance
        ),
        ("reactance", motor.reactance, REACTANCE_BITS as i32, TAU * rate * inductance),
        ("back_emf", motor.back_emf, 16, TAU * rate * flux),
        (
            "delay",
            motor.delay,
            DELAY_BITS as i32,
            f64::from(settings.on(hardware).actuation_delay) * 1e-6 * rate
        ),
        (
            "angle_gain",
            encoder.angle_gain,
            ANGLE_GAIN_BITS as i32,
            1.8 * tracker + tracker * tracker * late
        ),
        ("speed_gain", encoder.speed_gain, 32, tracker * tracker),
        ("kp", shaker.proportional, 40, natural * natural),
        ("kd", shaker.derivative, 32, 2.0 * natural),
        ("ki", shaker.integral, INTEGRAL_BITS as i32, 0.12 * natural.powi(3)),
        (
            "current_per_acceleration",
            shaker.current_per_acceleration[1],
            8 - shift,
            accelerating / 2.0
        ),
        (
            "burning_per_speed",
            configuration.burning_per_speed[1],
            burning::PER_SPEED_BITS as i32,
            1.25 * 0.5 * TAU * rate * flux / resistance,
        ),
        ("speed_per_current", configuration.speed_per_current[1], 32, 16.0 / accelerating),
    ]
}

#[test]
fn every_gain_is_what_it_should_be_at_the_ends_of_all_settings() {
    let hardware =
        Hardware { bus_microvolts_per_count: None, ..crate::fast::control::bench::HARDWARE };
    for settings in settings() {
        for (name, have, bits, want) in gains(&settings, &hardware) {
            let unit = 2.0_f64.powi(-bits);
            let off = (f64::from(have) * unit - want).abs();
            assert!(off <= unit + 1e-3 * want, "{name}: {} for {want}", f64::from(have) * unit);
        }
    }
}

#[test]
fn the_largest_acceleration_is_what_the_current_limit_gives_and_its_current_fits() {
    let hardware = crate::fast::control::bench::HARDWARE;
    for settings in settings() {
        let shaker = Configuration::new(&settings, &hardware).shaker;
        let largest = shaker.largest_acceleration;
        let scaled = i64::from(largest) << shaker.acceleration_shift;
        assert!(i32::try_from(scaled).is_ok(), "{largest} << {}", shaker.acceleration_shift);
        let current = (scaled * i64::from(shaker.current_per_acceleration[0])) >> 32;
        let limit = f64::from(shaker.current_limit.raw());
        // A rotor as light as none is not given all of it.
        let share = current as f64 / limit;
        assert!(share < 1.01, "{share} of the limit");
        assert!(share > 0.98 || largest == crate::fast::shaker::LARGEST_ACCELERATION, "{share}");
    }
}
