//! The constants of motors, battery and sensors, from the robot as data.

use super::ElectronicsParameters;
use super::battery::BatteryParameters;
use super::motor::MotorParameters;
use super::sensor::{AmplifierParameters, EncoderParameters};
use crate::model::Electrical;

/// Coulombs in a milliampere hour.
const COULOMBS_PER_MAH: f64 = 3.6;

impl From<&Electrical> for ElectronicsParameters {
    /// Converts to SI units.
    fn from(electrical: &Electrical) -> Self {
        let (motor, encoder, pack, sense) =
            (&electrical.motor, &electrical.encoder, &electrical.pack, &electrical.sense);
        Self {
            hardware: electrical.board(),
            motor: MotorParameters {
                pole_pairs: motor.pole_pairs,
                resistance: motor.phase_resistance_ohm,
                inductance: motor.phase_inductance_mh / 1e3,
                flux_linkage: motor.flux_linkage_mwb / 1e3,
                cogging_torque: motor.cogging_torque_mn_m / 1e3,
                cogging_periods: motor.cogging_periods,
                viscous_friction: motor.viscous_friction_un_m_s_rad / 1e6,
                coulomb_friction: motor.coulomb_friction_mn_m / 1e3,
                presliding_stiffness: motor.presliding_stiffness_n_m_rad,
                presliding_damping: motor.presliding_damping_mn_m_s_rad / 1e3,
            },
            motor_difference: motor.difference,
            battery: BatteryParameters {
                cells: pack.cells,
                capacity: pack.capacity_mah * COULOMBS_PER_MAH,
                resistance: f64::from(pack.cells) * (pack.cell_resistance_mohm / 1e3)
                    + pack.lead_resistance_mohm / 1e3,
                bus_capacitance: pack.bus_capacitance_uf / 1e6,
                takes_charge: pack.takes_charge,
            },
            charge: (pack.charge_at_least, pack.charge_at_most),
            encoder: EncoderParameters {
                bits: encoder.bits,
                noise: encoder.noise_deg.to_radians(),
                period: u64::from(encoder.period_ticks),
                age_us: encoder.age_us,
                late_us: encoder.late_us,
                age_error_us: encoder.age_error_us,
                eccentricity: encoder.eccentricity_deg.map(f64::to_radians),
                zero_error: encoder.zero_error_deg.to_radians(),
            },
            amplifier: AmplifierParameters {
                noise: sense.current_noise_counts,
                offset: sense.current_offset_counts,
                gain_error: sense.current_gain_error,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SIMULATED_BOARD;

    #[test]
    fn the_defaults_are_the_assumed_robot_to_the_bit() {
        let assumed = ElectronicsParameters::on(SIMULATED_BOARD);
        assert_eq!(ElectronicsParameters::from(&Electrical::default()), assumed);
    }
}
