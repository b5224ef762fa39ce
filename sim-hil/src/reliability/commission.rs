//! Commissioning of robots whose motors nobody knows: how well it finds them, and what it costs them.
//!
//! Unknown motors are of one size and wound differently, as gimbal motors are: turns of the winding change R and L with
//! their square and the flux linkage in proportion, about the assumed motor's. The two motors of a robot differ from the drawn
//! values by up to 5 % either way; an error is the larger of both motors'.

use flix_host::commission::voltage_mode::find_latency;
use flix_host::commission::{CommissionError, Known};
use serde_json::json;

use super::unknown_motors::{Watched, known, measured_by_hand, unknown_motors};
use super::wiring;
use crate::study::{Column, Limit, Measurement, Row};

/// Largest relative error of resistance, inductance and flux linkage.
const VALUE_LIMIT: Limit = Limit::AtMost(0.03);
/// Largest error of the encoder's latency, us.
const LATENCY_LIMIT_US: Limit = Limit::AtMost(50.0);
/// Largest phase current, A.
pub const CURRENT_LIMIT_A: f64 = 2.0;

/// The robot could not be built, or commissioning ended with an error.
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Returns the column of the largest phase current from power-up on.
fn largest_current() -> Column {
    Column::number("largest_current_a").limited(Limit::AtMost(CURRENT_LIMIT_A))
}

/// Returns how well robots of these seeds measure their motors on a board with current sense, over a network that loses this share
/// of the datagrams in either direction.
#[must_use]
pub fn motors(seeds: &[u64], loss: f64) -> Measurement<u64> {
    let found = vec![
        Column::number("resistance_error").limited(VALUE_LIMIT),
        Column::number("inductance_error").limited(VALUE_LIMIT),
        Column::number("flux_error").limited(VALUE_LIMIT),
        Column::number("latency_error_us").limited(LATENCY_LIMIT_US),
        // Whether the number of pole pairs is right.
        Column::promise("exact"),
        largest_current(),
        // How often motors that were driven came to rest because no order counted.
        Column::whole("lapses"),
        Column::number("seconds"),
    ];
    robots("commission", seeds, loss, found, commission).listed("each", &[])
}

/// Returns how well robots of these seeds find the latency of their encoders on a board without current sense, their motors
/// measured by hand, over the same network.
#[must_use]
pub fn voltage_mode(seeds: &[u64], loss: f64) -> Measurement<u64> {
    let found = vec![
        Column::number("latency_error_us").limited(LATENCY_LIMIT_US),
        // Whether the robot refused while values were assumed, and no current flowed.
        Column::promise("refused_assumed"),
        largest_current(),
        Column::number("seconds"),
    ];
    robots("commission-voltage-mode", seeds, loss, found, find_late).listed("voltage_mode", &[])
}

/// Returns whether robots of these seeds name each wiring fault, at a motor, phase and strength that chance picks.
#[must_use]
pub fn wiring_faults(seeds: &[u64]) -> Measurement<u64> {
    let columns = vec![
        Column::whole("seed"),
        Column::text("kind"),
        Column::text("said"),
        // Whether that names the fault, with its motor and its phase.
        Column::promise("named"),
        largest_current(),
    ];
    let kinds = wiring::kinds();
    let rows = kinds.len();
    let asked = move |seed: &u64, row: usize| vec![(*seed).into(), kinds[row].into()];
    let (name, parameters) = ("commission-wiring", json!({ "seeds": seeds }));
    Measurement::new(name, parameters, columns, asked, |seed| wiring::search(*seed))
        .runs(seeds.iter().copied(), rows)
        .listed("wiring_faults", &["kind"])
}

/// Returns a measurement with a row for each robot: its seed, the drawn values, and the values of `find`.
fn robots(
    name: &'static str,
    seeds: &[u64],
    loss: f64,
    found: Vec<Column>,
    find: fn(u64, f64) -> Result<Row, Failure>,
) -> Measurement<u64> {
    let drawn = ["resistance_ohm", "inductance_mh", "flux_mwb", "pole_pairs", "latency_us"];
    // Zero microvolts a count: the board does not measure its battery.
    let numbers = drawn.into_iter().chain(["bus_uv_per_count"]).map(Column::number);
    let columns = [Column::whole("seed")].into_iter().chain(numbers).chain(found).collect();
    let asked = |seed: &u64, _| {
        let electrical = unknown_motors(*seed).electrical;
        let motor = electrical.motor;
        vec![
            (*seed).into(),
            motor.phase_resistance_ohm.into(),
            motor.phase_inductance_mh.into(),
            motor.flux_linkage_mwb.into(),
            f64::from(motor.pole_pairs).into(),
            electrical.encoder.late_us.into(),
            f64::from(electrical.sense.bus_uv_per_count).into(),
        ]
    };
    let find = move |seed: &u64| find(*seed, loss).map(|row| vec![row]);
    Measurement::new(name, json!({ "seeds": seeds, "loss": loss }), columns, asked, find)
        .runs(seeds.iter().copied(), 1)
}

/// Commissions the robot of one seed.
fn commission(seed: u64, loss: f64) -> Result<Row, Failure> {
    let model = unknown_motors(seed);
    let mut watched = Watched::power_up(model.clone(), seed)?;
    let known = known(&model.shaker, seed, &watched);
    watched.lose(loss);
    let start = watched.operation.now();
    let found = watched.commission(&known)?;
    let electronics = watched.operation.robot.electronics();
    let truth = [0, 1].map(|motor| *electronics.motor(motor).parameters());
    let worst = |of: &dyn Fn(usize) -> f64| of(0).abs().max(of(1).abs());
    let motors = &found.motors;
    Ok(vec![
        worst(&|it| motors[it].resistance / truth[it].resistance - 1.0).into(),
        worst(&|it| motors[it].inductance / truth[it].inductance - 1.0).into(),
        worst(&|it| motors[it].flux_linkage / truth[it].flux_linkage - 1.0).into(),
        (1e6 * found.encoder_latency - model.electrical.encoder.late_us).abs().into(),
        truth.iter().all(|it| it.pole_pairs == found.pole_pairs).into(),
        watched.largest_current.get().into(),
        u64::from(watched.lapses()).into(),
        watched.operation.now().since(start).as_secs_f64().into(),
    ])
}

/// Finds the latency of the same robot on a board without current sense, its motors measured by hand.
fn find_late(seed: u64, loss: f64) -> Result<Row, Failure> {
    let mut model = unknown_motors(seed);
    model.electrical.sense.current = false;
    let mut watched = Watched::power_up(model.clone(), seed)?;
    let refused = find_latency(&mut watched, &Known::default(), |_| {});
    let refused_assumed = matches!(refused, Err(CommissionError::Assumed { .. }))
        && watched.largest_current.get() == 0.0;
    let mut entered = measured_by_hand(&watched, &model, seed);
    entered.remove("encoder_latency");
    watched.enter(entered)?;
    let known = known(&model.shaker, seed, &watched);
    watched.lose(loss);
    let start = watched.operation.now();
    let found = find_latency(&mut watched, &known, |_| {})?;
    Ok(vec![
        (1e6 * found.encoder_latency - model.electrical.encoder.late_us).abs().into(),
        refused_assumed.into(),
        watched.largest_current.get().into(),
        watched.operation.now().since(start).as_secs_f64().into(),
    ])
}
