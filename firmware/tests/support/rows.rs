//! Inputs of the current loop over its whole operating range, from a fixed seed.

use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::configuration::Configuration;
use flix_firmware::fast::foc::current::{Input, Model};
use flix_firmware::fast::foc::modulation::Bus;
use flix_firmware::fast::foc::transform::Rotor;
use flix_firmware::settings::Settings;
use flix_firmware::units::{Current, ElectricalAngle, ElectricalSpeed, Voltage};

/// How many there are.
pub(crate) const COUNT: usize = 10_000;
/// Bus voltage, V.
pub(crate) const BUS: f64 = 11.1;
/// Share of a PWM period that dead time takes.
pub(crate) const DEAD_SHARE: f64 = 0.0125;

/// The default motor.
pub(crate) fn model() -> Model {
    Configuration::current_loop(&Settings::DEFAULT, &DENGFOC_V3_01.hardware, 0)
}

/// A battery at its nominal voltage.
pub(crate) fn bus() -> Bus {
    Bus::new(Voltage::from_volts(BUS), (DEAD_SHARE * 2_147_483_648.0) as i32)
}

/// Random numbers: any angle; speeds to 40 Hz either way; reference and flowing currents to 2 A. At
/// the highest speeds and currents the voltage limit holds.
pub(crate) fn rows() -> impl Iterator<Item = Input> {
    let mut seed = 0x5eed_u64;
    (0..COUNT).map(move |_| {
        let mut next = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (seed >> 32) as u32
        };
        let angle = next();
        // 40 Hz with 7 pole pairs.
        let speed = symmetric(next(), 40.0 * 7.0 / 10_000.0 * 4_294_967_296.0);
        let mut current = || symmetric(next(), 2.0 * 65_536.0);
        let [current_d, current_q] = [current() / 2, current()];
        // What flows is near its reference, as in a loop that works.
        let flowing = f64::from(current_q) / 65_536.0;
        let radians = f64::from(angle) / 4_294_967_296.0 * core::f64::consts::TAU;
        let third = core::f64::consts::TAU / 3.0;
        let mut phase =
            |lag: f64| (-flowing * (radians - lag).sin() * 65_536.0) as i32 + current() / 10;
        let phases = Some([phase(0.0), phase(third)].map(Current::from_raw));
        Input {
            phases,
            angle: ElectricalAngle::from_raw(angle),
            speed: ElectricalSpeed::from_raw(speed),
            reference: Rotor { d: Current::from_raw(current_d), q: Current::from_raw(current_q) },
        }
    })
}

fn symmetric(random: u32, bound: f64) -> i32 {
    ((f64::from(random) / 2_147_483_648.0 - 1.0) * bound) as i32
}
