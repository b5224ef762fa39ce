//! Table of a robot's settings with unit, range, default and purpose. The robot makes its settings from this table, and the
//! operator's programs their explanations.

/// Passes the lines of all settings to the macro `$with`, as
/// `name: unit, kind, minimum..=maximum, default, description;` where kind is `real` or `whole`. Settings in
/// `each motor` exist twice, `top_...` and `bottom_...`. Units are symbols, `1` for plain numbers and switches.
#[macro_export]
macro_rules! settings_table {
    ($with:ident) => {
        $with! {
            each motor {
                phase_resistance: "ohm", real, 0.02 ..= 30.0, 2.5, "Resistance of one phase, terminal to star point: half of what an ohmmeter shows between two terminals. Assumed: the paper names no motor.";
                phase_inductance: "mH", real, 0.005 ..= 20.0, 1.0, "Inductance of one phase, terminal to star point: half of what is measured between two terminals. Assumed.";
                flux_linkage: "mWb", real, 0.2 ..= 30.0, 3.0, "Flux linkage of the magnets: peak phase back-EMF per electrical rad/s. Assumed.";
                current_gain_a: "1", real, 0.5 ..= 2.0, 1.0, "True current of phase A over what its amplifier shows.";
                current_gain_b: "1", real, 0.5 ..= 2.0, 1.0, "True current of phase B over what its amplifier shows.";
                encoder_zero: "deg", real, -180.0 ..= 360.0, 0.0, "Clockwise angle of the eccentric mass from forward where the encoder reads zero.";
                encoder_clockwise: "1", whole, 0.0 ..= 1.0, 0.0, "1 when the encoder counts clockwise seen from above.";
                aligned: "1", whole, 0.0 ..= 1.0, 0.0, "1 when alignment has found the values below; 0 makes the next arming align.";
                electrical_offset: "deg", real, -180.0 ..= 360.0, 0.0, "Electrical angle at rotor angle zero. Found by alignment.";
                phases_reversed: "1", whole, 0.0 ..= 1.0, 0.0, "1 when the electrical angle falls as the rotor turns clockwise. Found by alignment.";
                current_inverted: "1", whole, 0.0 ..= 1.0, 0.0, "1 when the current sense counts down for current into the motor. Found by alignment.";
                encoder_cosine_1: "deg", real, -10.0 ..= 10.0, 0.0, "Encoder error, cosine once a turn. Found by alignment.";
                encoder_sine_1: "deg", real, -10.0 ..= 10.0, 0.0, "Encoder error, sine once a turn. Found by alignment.";
                encoder_cosine_2: "deg", real, -10.0 ..= 10.0, 0.0, "Encoder error, cosine twice a turn. Found by alignment.";
                encoder_sine_2: "deg", real, -10.0 ..= 10.0, 0.0, "Encoder error, sine twice a turn. Found by alignment.";
            }
            robot {
                pole_pairs: "1", whole, 1.0 ..= 32.0, 7.0, "Pole pairs of both motors. Assumed.";
                rotor_inertia: "g cm2", real, 1.0 ..= 10000.0, 105.0, "Inertia of one rotor about its shaft: 12 g at 28 mm (paper, Table II) and the bell.";
                current_scale: "1", real, 0.1 ..= 10.0, 1.0, "True phase current over what the board's description reads: 0.4 where amplifiers taken for x20 are x50.";
                battery_scale: "1", real, 0.2 ..= 5.0, 1.0, "True battery voltage over what a divider of 100 over 22 kiloohms gives: by a voltmeter at the battery, or for other resistors.";
                current_limit: "A", real, 0.1 ..= 20.0, 2.0, "Phase current that is never asked for more of.";
                over_current: "A", real, 0.2 ..= 30.0, 2.6, "Phase current that trips the over-current fault; so does the end of what the board can show: 2.8 A of 0.01 ohm with a gain of 50 on an ESP32, 2.5 A on an ESP32-S3.";
                alignment_current: "A", real, 0.05 ..= 5.0, 0.8, "Phase current that turns the rotors while aligning.";
                current_bandwidth: "Hz", real, 50.0 ..= 1500.0, 700.0, "Bandwidth of the current loops.";
                position_bandwidth: "Hz", real, 1.0 ..= 60.0, 20.0, "Natural frequency of the loops that hold f and theta.";
                tracker_bandwidth: "Hz", real, 10.0 ..= 500.0, 125.0, "Natural frequency of the encoder trackers.";
                frequency_ramp: "Hz/s", real, 1.0 ..= 1000.0, 200.0, "Steepest change of f.";
                direction_ramp: "deg/s", real, 10.0 ..= 10000.0, 900.0, "Fastest change of theta.";
                encoder_latency: "us", real, 0.0 ..= 3000.0, 0.0, "How much older a fresh encoder reading is than it says.";
                actuation_delay: "us", real, 0.0 ..= 500.0, 0.0, "From the current sample of a tick to the middle of the interval in which its duties act; 0 takes the board's own, which is 125.";
                nominal_voltage: "V", real, 5.0 ..= 30.0, 11.1, "Bus voltage taken where the board cannot measure it: 3.7 V a cell.";
                battery_low: "V", real, 4.0 ..= 30.0, $crate::failsafe::BATTERY_LOW_VOLTS, "Bus voltage below which the battery is reported low: 3.3 V a cell.";
                under_voltage: "V", real, 4.0 ..= 30.0, 9.0, "Bus voltage that trips the under-voltage fault: 3.0 V a cell.";
                over_voltage: "V", real, 6.0 ..= 40.0, 14.0, "Bus voltage that trips the over-voltage fault: more than a full pack can have.";
                over_speed: "Hz", real, 10.0 ..= 200.0, 45.0, "Rotor speed that trips the over-speed fault: no command asks for more than 35 Hz.";
                command_age: "s", real, 0.1 ..= 1.0, $crate::failsafe::COMMAND_AGE_SECONDS, "Age above which a command does not count and the rotors ramp down: the time since the robot sent what the operator had last received.";
                telemetry_rate: "Hz", real, 1.0 ..= 100.0, 50.0, "Telemetry datagrams a second; at least 50 while an operator gives orders.";
            }

        }
    };
}

macro_rules! descriptions {
    (
        each motor { $($each:ident: $each_unit:literal, $each_kind:ident, $each_minimum:literal ..= $each_maximum:literal, $each_default:expr, $each_description:literal;)* }
        robot { $($name:ident: $unit:literal, $kind:ident, $minimum:literal ..= $maximum:literal, $default:expr, $description:literal;)* }
    ) => {
        const OF_EACH_MOTOR: &[(&str, &str)] = &[$((stringify!($each), $each_description)),*];
        const OF_ROBOT: &[(&str, &str)] = &[$((stringify!($name), $description)),*];
    };
}
settings_table!(descriptions);

/// Returns the purpose of this setting; `None` for a name that is not in the table.
#[must_use]
pub fn description(name: &str) -> Option<&'static str> {
    let motor = name.strip_prefix("top_").or_else(|| name.strip_prefix("bottom_"));
    let of = |table: &[(&str, &'static str)], name: &str| {
        table.iter().find(|entry| entry.0 == name).map(|entry| entry.1)
    };
    motor.and_then(|name| of(OF_EACH_MOTOR, name)).or_else(|| of(OF_ROBOT, name))
}
