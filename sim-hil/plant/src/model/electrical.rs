//! The electrical part of a robot as data: the section `[electrical]` of a model file.
//!
//! Every key may be left out; its default stands beside it with its source: the paper, a data sheet, or *assumed*, as the paper
//! names neither motor nor encoder. `sim-hil/examples/own-robot.toml` has all of them.
//!
//! What the software on a real robot would know (board, amplifiers, dead time) it knows of this robot too. What an
//! operator would set with `flix parameters set` stands under `[electrical.settings]`.

use std::collections::BTreeMap;
use std::num::NonZeroU16;

use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::hardware::{CurrentSense, Hardware};
use flix_firmware::settings::Settings;
use serde::{Deserialize, Serialize};

use super::error::{ModelError, exactly};

/// The board of the simulated robot: DengFOC V3.01 (bridges that coast, current sense both ways) with a
/// battery divider of 100 and 22 kiloohms added.
pub const SIMULATED_BOARD: Hardware = Hardware {
    name: "simulated DengFOC V3.01",
    bus_microvolts_per_count: NonZeroU16::new(4_464),
    bus_largest_count: DENGFOC_V3_01.with_battery_divider().hardware.bus_largest_count,
    ..DENGFOC_V3_01.hardware
};

/// Name of a board whose description a model file changes.
const OWN_BOARD: &str = "simulated board of the model file";

/// Motors, battery, sensors and inverter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Electrical {
    /// Both motors.
    pub motor: Motor,
    /// Both encoders.
    pub encoder: Encoder,
    /// The bridges.
    pub inverter: Inverter,
    /// Sensors of phase currents and of the bus.
    pub sense: Sense,
    /// The battery.
    pub pack: Pack,
    /// Settings of the robot's software that differ from their defaults, by name; see `flix parameters list`.
    pub settings: BTreeMap<String, f64>,
}

/// A three-phase motor; top and bottom one are of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Motor {
    /// Pairs of magnet poles, 1 to 32. Assumed (7).
    pub pole_pairs: u32,
    /// Resistance of one phase with its share of the bridge, ohm, 0.02 to 30. Assumed (2.5).
    pub phase_resistance_ohm: f64,
    /// Inductance of one phase, mH, 0.005 to 20. Assumed (1).
    pub phase_inductance_mh: f64,
    /// Peak flux linkage of one phase, mWb, 0.2 to 30. Assumed (3).
    pub flux_linkage_mwb: f64,
    /// Amplitude of the cogging torque, mN m, 0 to 100. Assumed (0.8).
    pub cogging_torque_mn_m: f64,
    /// Cogging periods per turn: least common multiple of slots and poles, 1 to 1000. Assumed (84).
    pub cogging_periods: u32,
    /// Viscous friction and windage, uN m s/rad, 0 to 1000. Assumed (4).
    pub viscous_friction_un_m_s_rad: f64,
    /// Coulomb friction, mN m, 0 to 100. Assumed (1).
    pub coulomb_friction_mn_m: f64,
    /// Stiffness of the stuck bearing, N m/rad, 0.1 to 100. Assumed (10).
    pub presliding_stiffness_n_m_rad: f64,
    /// Damping of the stuck bearing, mN m s/rad, 0 to 100. Assumed (2).
    pub presliding_damping_mn_m_s_rad: f64,
    /// Difference between the two motors in resistance, flux linkage and friction, as a share, 0 to 0.5.
    /// Assumed (0.1).
    pub difference: f64,
}

impl Default for Motor {
    fn default() -> Self {
        Self {
            pole_pairs: 7,
            phase_resistance_ohm: 2.5,
            phase_inductance_mh: 1.0,
            flux_linkage_mwb: 3.0,
            cogging_torque_mn_m: 0.8,
            cogging_periods: 84,
            viscous_friction_un_m_s_rad: 4.0,
            coulomb_friction_mn_m: 1.0,
            presliding_stiffness_n_m_rad: 10.0,
            presliding_damping_mn_m_s_rad: 2.0,
            difference: 0.1,
        }
    }
}

/// A magnetic angle encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Encoder {
    /// Steps per turn are 2 to this power, 8 to 24. Source: AS5600 data sheet (12).
    pub bits: u32,
    /// Standard deviation of a reading, degrees, 0 to 5. Source: AS5600 data sheet, fastest filter (0.043).
    pub noise_deg: f64,
    /// Ticks of 0.1 ms from one reading to the next, 1 to 100. I2C at 1 MHz (2).
    pub period_ticks: u32,
    /// Time from the sampled angle to the tick, as the driver states it, us, 0 to 2000. AS5600 filter and bus (200).
    pub age_us: u16,
    /// By how much every reading is older than that, us, 0 to 3000: an AS5600 that keeps the filter it is sold with is
    /// 957 late (0).
    pub late_us: f64,
    /// Largest error of that time, us, 0 to 1000. Assumed (15).
    pub age_error_us: f64,
    /// Largest error with one and with two periods a turn, degrees, each 0 to 10. Source: AS5600 data sheet,
    /// at most 1 together (0.6, 0.3).
    #[serde(deserialize_with = "exactly")]
    pub eccentricity_deg: [f64; 2],
    /// Largest error of the zero as set on the bench, degrees, 0 to 10. Assumed (0.2).
    pub zero_error_deg: f64,
}

impl Default for Encoder {
    fn default() -> Self {
        Self {
            bits: 12,
            noise_deg: 0.043,
            period_ticks: 2,
            age_us: 200,
            late_us: 0.0,
            age_error_us: 15.0,
            eccentricity_deg: [0.6, 0.3],
            zero_error_deg: 0.2,
        }
    }
}

/// Both three-phase bridges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Inverter {
    /// Time in each PWM period in which neither switch of a phase conducts, ns, 0 to 5000. Source: L6234,
    /// AN1088 (300).
    pub dead_time_ns: u16,
    /// PWM frequency, Hz, 10000 to 100000. Choice of the firmware (20000).
    pub pwm_frequency_hz: u32,
    /// Whether an unpowered bridge lets the motor coast; else it brakes. The L6234 with its enable pin (true).
    pub can_coast: bool,
}

impl Default for Inverter {
    fn default() -> Self {
        Self {
            dead_time_ns: SIMULATED_BOARD.dead_time_ns,
            pwm_frequency_hz: SIMULATED_BOARD.pwm_frequency_hz,
            can_coast: SIMULATED_BOARD.can_coast,
        }
    }
}

/// Sensors of phase currents and of the bus voltage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sense {
    /// Whether phase currents are measured; else the motors run in voltage mode. DengFOC V3.01 (true).
    pub current: bool,
    /// Current for one count, uA, 1 to 65535. 0.01 ohm, gain 50, 12 bits of 3.3 V (1611).
    pub current_ua_per_count: u16,
    /// Noise of a sample, counts, 0 to 100. Assumed, one-shot conversion (5).
    pub current_noise_counts: f64,
    /// Largest offset from the designed zero, counts, 0 to 500. Assumed (15).
    pub current_offset_counts: f64,
    /// Largest relative error of the gain, 0 to 0.5. Shunt 1 %, amplifier 0.2 %, reference the rest (0.02).
    pub current_gain_error: f64,
    /// Voltage for one count of the bus divider, uV, 0 to 65535; 0 is no divider. 100 and 22 kiloohms (4464).
    pub bus_uv_per_count: u16,
}

impl Default for Sense {
    fn default() -> Self {
        Self {
            current: true,
            current_ua_per_count: SIMULATED_BOARD
                .current_sense
                .map_or(1611, |sense| sense.microamperes_per_count),
            current_noise_counts: 5.0,
            current_offset_counts: 15.0,
            current_gain_error: 0.02,
            bus_uv_per_count: SIMULATED_BOARD.bus_microvolts_per_count.map_or(0, NonZeroU16::get),
        }
    }
}

/// A pack of lithium-polymer cells and the bus that it feeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pack {
    /// Cells in series, 1 to 8. Source: paper, section II-A (3).
    pub cells: u32,
    /// Charge when full, mAh, 10 to 100000. Source: paper, section II-A (300).
    pub capacity_mah: f64,
    /// Resistance of one cell, mohm, 0.1 to 1000. Assumed, typical of this size (50).
    pub cell_resistance_mohm: f64,
    /// Resistance of plug and leads, mohm, 0.1 to 1000. Assumed (30).
    pub lead_resistance_mohm: f64,
    /// Capacitor across the bridges, uF, 20 to 10000. What driver boards of this class carry (220).
    pub bus_capacitance_uf: f64,
    /// Lowest charge at the start that the seed may give, as a share, 0.02 to 1. Assumed (0.5).
    pub charge_at_least: f64,
    /// Highest charge at the start that the seed may give, as a share, 0.02 to 1. Full (1).
    pub charge_at_most: f64,
    /// Whether current may flow back: into a battery, not into a bench supply. A battery (true).
    pub takes_charge: bool,
}

impl Default for Pack {
    fn default() -> Self {
        Self {
            cells: 3,
            capacity_mah: 300.0,
            cell_resistance_mohm: 50.0,
            lead_resistance_mohm: 30.0,
            bus_capacitance_uf: 220.0,
            charge_at_least: 0.5,
            charge_at_most: 1.0,
            takes_charge: true,
        }
    }
}

impl Electrical {
    /// Returns whether every value is the assumed one.
    #[must_use]
    pub fn is_assumed(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the board that the robot's software is built for.
    #[must_use]
    pub fn board(&self) -> Hardware {
        let (inverter, sense) = (&self.inverter, &self.sense);
        let amplifiers = SIMULATED_BOARD.current_sense.filter(|_| sense.current);
        let board = Hardware {
            name: SIMULATED_BOARD.name,
            current_sense: amplifiers.map(|amplifiers| CurrentSense {
                microamperes_per_count: sense.current_ua_per_count,
                ..amplifiers
            }),
            bus_microvolts_per_count: NonZeroU16::new(sense.bus_uv_per_count),
            bus_largest_count: SIMULATED_BOARD.bus_largest_count,
            dead_time_ns: inverter.dead_time_ns,
            pwm_frequency_hz: inverter.pwm_frequency_hz,
            actuation_delay_us: Hardware::actuation_delay(inverter.pwm_frequency_hz),
            can_coast: inverter.can_coast,
        };
        if board == SIMULATED_BOARD { board } else { Hardware { name: OWN_BOARD, ..board } }
    }

    /// Returns the settings in the robot's memory; none when a new robot's are in force.
    ///
    /// # Errors
    /// [`ModelError::Setting`] when there is no such setting, or its value is refused.
    pub fn stored_settings(&self) -> Result<Option<Settings>, ModelError> {
        if self.settings.is_empty() {
            return Ok(None);
        }
        let mut settings = Settings::DEFAULT.entered();
        let mut rest: Vec<(&String, &f64)> = self.settings.iter().collect();
        // A setting may bound another: what is refused now may be accepted after the others.
        while !rest.is_empty() {
            let before = rest.len();
            let mut refused = None;
            rest.retain(|(name, value)| match settings.set(name, **value as f32) {
                Ok(()) => false,
                Err(error) => {
                    refused.get_or_insert_with(|| ((*name).clone(), **value, error));
                    true
                }
            });
            if let Some((name, value, error)) = refused
                && rest.len() == before
            {
                let key = format!("electrical.settings.{name}");
                return Err(ModelError::Setting { key, value, reason: error.to_string() });
            }
        }
        Ok(Some(settings))
    }

    pub(super) fn check(&self) -> Result<(), ModelError> {
        let pack = &self.pack;
        if pack.charge_at_least > pack.charge_at_most {
            return Err(ModelError::Impossible {
                key: "electrical.pack.charge_at_least".to_owned(),
                value: pack.charge_at_least,
                reason: format!("it is more than charge_at_most = {}", pack.charge_at_most),
            });
        }
        self.stored_settings().map(|_| ())
    }

    pub(super) fn bounds(&self, add: &mut impl FnMut(&str, f64, f64, f64)) {
        let mut add = |key: &str, value: f64, low: f64, high: f64| {
            add(&format!("electrical.{key}"), value, low, high);
        };
        let m = &self.motor;
        add("motor.pole_pairs", f64::from(m.pole_pairs), 1.0, 32.0);
        add("motor.phase_resistance_ohm", m.phase_resistance_ohm, 0.02, 30.0);
        add("motor.phase_inductance_mh", m.phase_inductance_mh, 0.005, 20.0);
        add("motor.flux_linkage_mwb", m.flux_linkage_mwb, 0.2, 30.0);
        add("motor.cogging_torque_mn_m", m.cogging_torque_mn_m, 0.0, 100.0);
        add("motor.cogging_periods", f64::from(m.cogging_periods), 1.0, 1000.0);
        add("motor.viscous_friction_un_m_s_rad", m.viscous_friction_un_m_s_rad, 0.0, 1000.0);
        add("motor.coulomb_friction_mn_m", m.coulomb_friction_mn_m, 0.0, 100.0);
        add("motor.presliding_stiffness_n_m_rad", m.presliding_stiffness_n_m_rad, 0.1, 100.0);
        add("motor.presliding_damping_mn_m_s_rad", m.presliding_damping_mn_m_s_rad, 0.0, 100.0);
        add("motor.difference", m.difference, 0.0, 0.5);
        let e = &self.encoder;
        add("encoder.bits", f64::from(e.bits), 8.0, 24.0);
        add("encoder.noise_deg", e.noise_deg, 0.0, 5.0);
        add("encoder.period_ticks", f64::from(e.period_ticks), 1.0, 100.0);
        add("encoder.age_us", f64::from(e.age_us), 0.0, 2000.0);
        add("encoder.late_us", e.late_us, 0.0, 3000.0);
        add("encoder.age_error_us", e.age_error_us, 0.0, 1000.0);
        for (harmonic, value) in e.eccentricity_deg.into_iter().enumerate() {
            add(&format!("encoder.eccentricity_deg[{harmonic}]"), value, 0.0, 10.0);
        }
        add("encoder.zero_error_deg", e.zero_error_deg, 0.0, 10.0);
        let i = &self.inverter;
        add("inverter.dead_time_ns", f64::from(i.dead_time_ns), 0.0, 5000.0);
        add("inverter.pwm_frequency_hz", f64::from(i.pwm_frequency_hz), 10_000.0, 100_000.0);
        let s = &self.sense;
        add("sense.current_ua_per_count", f64::from(s.current_ua_per_count), 1.0, 65_535.0);
        add("sense.current_noise_counts", s.current_noise_counts, 0.0, 100.0);
        add("sense.current_offset_counts", s.current_offset_counts, 0.0, 500.0);
        add("sense.current_gain_error", s.current_gain_error, 0.0, 0.5);
        let p = &self.pack;
        add("pack.cells", f64::from(p.cells), 1.0, 8.0);
        add("pack.capacity_mah", p.capacity_mah, 10.0, 100_000.0);
        add("pack.cell_resistance_mohm", p.cell_resistance_mohm, 0.1, 1000.0);
        add("pack.lead_resistance_mohm", p.lead_resistance_mohm, 0.1, 1000.0);
        add("pack.bus_capacitance_uf", p.bus_capacitance_uf, 20.0, 10_000.0);
        add("pack.charge_at_least", p.charge_at_least, 0.02, 1.0);
        add("pack.charge_at_most", p.charge_at_most, 0.02, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::RobotModel;

    fn model(electrical: &str) -> Result<RobotModel, ModelError> {
        let shipped = include_str!("../../../models/A.toml");
        RobotModel::from_toml(&format!("{shipped}\n{electrical}"))
    }

    #[test]
    fn the_example_names_every_key_at_its_default() {
        let text = include_str!("../../../examples/own-robot.toml");
        let own = RobotModel::from_toml(text).unwrap().electrical;
        assert_eq!(Electrical { settings: BTreeMap::new(), ..own }, Electrical::default());
        let every = toml::to_string(&Electrical::default()).unwrap();
        for key in every.lines().filter_map(|line| line.split_once(" = ")).map(|(key, _)| key) {
            assert!(text.contains(&format!("\n{key} = ")), "{key} is missing");
        }
    }

    #[test]
    fn a_setting_that_the_robot_would_refuse_is_refused_with_its_range() {
        let error = model("[electrical.settings]\npole_pairs = 99").unwrap_err().to_string();
        assert!(error.contains("electrical.settings.pole_pairs = 99"), "{error}");
        assert!(error.contains("from 1 to 32"), "{error}");
    }

    #[test]
    fn settings_that_bound_each_other_are_taken_together() {
        let text = "[electrical.settings]\ncurrent_limit = 5.0\nover_current = 6.0";
        let settings = model(text).unwrap().electrical.stored_settings().unwrap().unwrap();
        assert_eq!((settings.current_limit, settings.over_current), (5.0, 6.0));
    }

    #[test]
    fn an_unknown_key_of_a_motor_is_refused() {
        let error = model("[electrical.motor]\nphase_resistance = 2.0").unwrap_err().to_string();
        assert!(error.contains("phase_resistance"), "{error}");
    }
}
