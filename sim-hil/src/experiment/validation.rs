//! What the simulator computes, beside what it must agree with.
//!
//! The reference values belong to reference model A and were computed with MuJoCo on a model written from
//! the paper alone; `validation/validate.py` computes the same rows with MuJoCo from the exported model, for
//! this or any other model, load, frequency and leg.

use serde_json::json;

use crate::experiment::probe::{Clamp, ProbeError, ShakeBase, eigenmodes, shake};
use crate::model::{Base, FootAxis, GRAVITY, LEGS, RobotModel};
use crate::plant::{Diverged, Drive, Mechanics, Plant, Wrench};
use crate::rig::bench::setpoint;
use crate::study::{Column, Measurement, Row, Study};

/// What to compute.
#[derive(Clone, Debug)]
pub struct Options {
    /// Frequencies of the shaker on a stand, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Direction of the shaker, degrees.
    pub direction_deg: f64,
    /// The leg that is loaded, in the order of [`LEGS`].
    pub leg: usize,
    /// Force on its tip, N.
    pub force: [f64; 3],
    /// Torque on its tip, N m.
    pub torque: [f64; 3],
    /// Step, s.
    pub step: f64,
}

impl Default for Options {
    /// The rows of the reference table.
    fn default() -> Self {
        Options {
            frequencies_hz: vec![10.0, 20.0, 30.0, 35.0],
            direction_deg: 30.0,
            leg: 0,
            force: [0.2, 0.0, 0.0],
            torque: [0.0; 3],
            step: 1e-4,
        }
    }
}

/// What is computed together, and how many quantities that gives.
#[derive(Clone, Copy, Debug)]
enum Probe {
    Shaker(f64),
    Floating(f64),
    Standing,
    Leg,
    FirstMode,
    FirstModeAlong,
    Rest,
    Mirror,
    Stick,
}

impl Probe {
    const fn quantities(self) -> usize {
        match self {
            Self::Shaker(_) | Self::Standing => 5,
            Self::Floating(_) => 4,
            Self::Leg | Self::Mirror => 3,
            Self::FirstMode | Self::FirstModeAlong | Self::Rest => 2,
            Self::Stick => 1,
        }
    }
}

/// Returns all quantities of a model.
///
/// # Errors
/// If the model has no legs.
pub fn validation(model: &RobotModel, options: Options) -> Result<impl Study + use<>, ProbeError> {
    if model.legs.is_none() {
        return Err(ProbeError::NoLegs { name: model.name.clone() });
    }
    let shaken =
        options.frequencies_hz.iter().flat_map(|f| [Probe::Shaker(*f), Probe::Floating(*f)]);
    let mirror = is_symmetric(model).then_some(Probe::Mirror);
    let standing =
        [Probe::Standing, Probe::Leg, Probe::FirstMode, Probe::FirstModeAlong, Probe::Rest];
    let probes: Vec<Probe> = shaken.chain(standing).chain(mirror).chain([Probe::Stick]).collect();
    let (robot, facts) = (model.clone(), json!({ "model": model.name }));
    let study = Measurement::new(
        "validate",
        json!({ "model": model, "options": format!("{options:?}") }),
        vec![
            Column::text("probe"),
            Column::text("name"),
            Column::text("unit"),
            Column::number("value"),
            // To agree with, if the table has it for this model and these options, and how far the value may be off.
            Column::number("reference"),
            Column::number("tolerance"),
            Column::promise("pass"),
        ],
        |probe, _| vec![format!("{probe:?}").into()],
        move |probe| rows(*probe, &robot, &options),
    );
    let add = |study: Measurement<Probe>, probe: Probe| study.runs([probe], probe.quantities());
    Ok(probes.into_iter().fold(study, add).listed("rows", &[]).with_facts(facts))
}

/// Computes the quantities of a probe.
fn rows(probe: Probe, model: &RobotModel, options: &Options) -> Result<Vec<Row>, ProbeError> {
    let mut rows = Rows { rows: Vec::new(), known: model.name == "A" };
    match probe {
        Probe::Shaker(f) => shaker(&mut rows, model, f, options),
        Probe::Floating(f) => floating(&mut rows, model, f, options),
        Probe::Standing => standing(&mut rows, model),
        Probe::Leg => leg(&mut rows, model, options),
        Probe::FirstMode => eigenmode(&mut rows, model, options.leg, "with its foot", None),
        Probe::FirstModeAlong => {
            let mut rig = model.clone();
            if let Some(legs) = &mut rig.legs {
                legs.foot.axis = FootAxis::Along;
            }
            eigenmode(&mut rows, &rig, options.leg, "with its foot along x", Some((43.0, 0.305)))
        }
        Probe::Rest => rest(&mut rows, model, options.step),
        Probe::Mirror => mirror(&mut rows, model, options.step),
        Probe::Stick => stick(&mut rows, model, options.step),
    }?;
    Ok(rows.rows)
}

struct Rows {
    rows: Vec<Row>,
    /// Is this the model that the table is about?
    known: bool,
}

impl Rows {
    /// A quantity with a reference and its absolute tolerance, if this is the table's model.
    fn table(&mut self, name: &str, unit: &'static str, value: f64, agree: Option<(f64, f64)>) {
        let agree = agree.filter(|_| self.known);
        self.add(name, unit, value, agree);
    }

    /// A quantity with a reference that holds for every model.
    fn add(&mut self, name: &str, unit: &'static str, value: f64, agree: Option<(f64, f64)>) {
        let pass =
            agree.is_none_or(|(reference, tolerance)| (value - reference).abs() <= tolerance);
        let (reference, tolerance) = (agree.map(|it| it.0), agree.map(|it| it.1));
        self.rows.push(vec![
            name.into(),
            unit.into(),
            value.into(),
            reference.into(),
            tolerance.into(),
            pass.into(),
        ]);
    }
}

fn shaker(
    rows: &mut Rows,
    model: &RobotModel,
    f: f64,
    options: &Options,
) -> Result<(), ProbeError> {
    let mut stand = model.clone();
    stand.base = Base::Fixed {};
    stand.legs = None;
    // Without legs the core would take their mass; it does not move here.
    let mut plant = Plant::new(&stand)?;
    let theta = options.direction_deg.to_radians();
    plant.set_drive(Drive::Ideal { frequency_hz: f, theta_rad: theta });
    let turn = 1.0 / f.abs().max(0.1);
    let count = 4000;
    let step = turn / f64::from(count);
    let (mut along, mut across, mut vertical) = (0.0f64, 0.0f64, 0.0f64);
    // Fourier sums of the torque about the force's axis (its sine) and across it (its cosine).
    let (mut sine, mut cosine) = (0.0, 0.0);
    for i in 0..count {
        plant.step([0.0; 2], step)?;
        let wrench = plant.shaker_wrench();
        let ([fx, fy, _], [tx, ty, tz]) = (wrench.force, wrench.torque);
        // Theta to the right is towards -y.
        let (s, c) = theta.sin_cos();
        along = along.max((fx * c - fy * s).abs());
        across = across.max((fx * s + fy * c).abs());
        vertical = vertical.max(tz.abs());
        let phase = core::f64::consts::TAU * (f64::from(i) + 0.5) / f64::from(count);
        sine += (tx * c - ty * s) * phase.sin();
        cosine += (tx * s + ty * c) * phase.cos();
    }
    let k = &model.shaker;
    let (m, l, h) = (1e-3 * k.mass_g, 1e-3 * k.arm_mm, 1e-3 * k.spacing_mm);
    let w = core::f64::consts::TAU * f;
    let force = 2.0 * m * w * w * l;
    let torque = h * m * w * w * l;
    let weight = 2.0 * m * GRAVITY * l;
    let name = |what: &str| format!("shaker on a stand at {f} Hz: {what}");
    rows.add(&name("force along theta"), "N", along, Some((force, 1e-3 * force)));
    rows.add(&name("force across theta"), "N", across, Some((0.0, 1e-3 * force)));
    rows.add(&name("torque about z"), "N m", vertical, Some((0.0, 1e-3 * torque.max(1e-9))));
    let share = 2.0 / f64::from(count);
    // The top rotor turns clockwise where f is positive, so that its force across theta points to the right first.
    let sign = f.signum();
    rows.add(&name("torque h m w^2 l"), "N m", share * sine, Some((sign * torque, 1e-3 * torque)));
    rows.add(
        &name("cosine torque of gravity"),
        "N m",
        share * cosine,
        Some((weight, 1e-3 * weight)),
    );
    Ok(())
}

fn floating(
    rows: &mut Rows,
    model: &RobotModel,
    f: f64,
    options: &Options,
) -> Result<(), ProbeError> {
    let setpoint = setpoint(f, options.direction_deg)?;
    let shaken = shake(model, setpoint, ShakeBase::Air, options.step)?;
    let ([x, y, _], [roll, pitch, _]) = (shaken.displacement_mm, shaken.rotation_deg);
    for (what, unit, value) in [
        ("along x", "mm", x),
        ("along y", "mm", y),
        ("in roll", "deg", roll),
        ("in pitch", "deg", pitch),
    ] {
        rows.add(&format!("in the air at {f} Hz: body {what}"), unit, value, None);
    }
    Ok(())
}

fn standing(rows: &mut Rows, model: &RobotModel) -> Result<(), ProbeError> {
    let plant = Plant::new(model)?;
    let (_, center, inertia) = plant.mass_properties();
    rows.table("centre of mass above the soles", "mm", 1e3 * center[2], Some((55.63, 0.1)));
    rows.table("centre of mass forward of the centre", "mm", 1e3 * center[0], Some((1.92, 0.1)));
    for (axis, value, reference) in
        [("x", inertia[0], 2.74e-4), ("y", inertia[3], 9.17e-4), ("z", inertia[5], 9.34e-4)]
    {
        let name = format!("moment of inertia about {axis}");
        rows.table(&name, "kg m^2", value, Some((reference, 0.01 * reference)));
    }
    Ok(())
}

fn leg(rows: &mut Rows, model: &RobotModel, options: &Options) -> Result<(), ProbeError> {
    let mut bare = model.clone();
    if let Some(legs) = &mut bare.legs {
        // No foot: one that weighs nothing that anybody would notice.
        legs.foot.mass_g = 0.1;
    }
    let index = options.leg;
    let load = Wrench { force: options.force, torque: options.torque };
    let bent = |load: Wrench| -> Result<[f64; 3], ProbeError> {
        let mut plant = Plant::new(&bare)?;
        plant.load_clamped_leg(index, load, options.step)?;
        Ok(plant.legs().map_or([f64::NAN; 3], |l| l[index].joints[3]))
    };
    let (from, to) = (bent(Wrench::default())?, bent(load)?);
    let usual = index == 0 && options.force == [0.2, 0.0, 0.0] && options.torque == [0.0; 3];
    for (axis, i, reference) in [("x", 0, Some(0.157)), ("y", 1, Some(0.104)), ("z", 2, None)] {
        let name = format!("leg {} clamped, loaded: tip along {axis}", LEGS[index]);
        let agree = reference.filter(|_| usual).map(|r: f64| (r, 0.01 * r));
        rows.table(&name, "mm", 1e3 * (to[i] - from[i]), agree);
    }
    Ok(())
}

/// Adds the slowest eigenmode of a clamped leg. The table's is that of a leg alone whose foot lies along its first
/// hinge; under the robot the foot lies across.
fn eigenmode(
    rows: &mut Rows,
    model: &RobotModel,
    leg: usize,
    how: &str,
    table: Option<(f64, f64)>,
) -> Result<(), ProbeError> {
    let found = eigenmodes(model, Clamp::Leg(leg))?;
    if let Some(first) = found.eigenmodes.first() {
        let name = format!("leg {} clamped, {how}: first mode", LEGS[leg]);
        let table = table.filter(|_| leg == 0);
        let frequency = table.map(|(f, _)| (f, 0.01 * f));
        let damping = table.map(|(_, d)| (d, 0.03 * d));
        rows.table(&name, "Hz", first.frequency_hz, frequency);
        rows.table(&format!("{name}, damping"), "ratio", first.damping_ratio, damping);
    }
    Ok(())
}

fn rest(rows: &mut Rows, model: &RobotModel, step: f64) -> Result<(), ProbeError> {
    let mut plant = Plant::new(model)?;
    plant.displace([0.0, 0.0, 0.02], 0.0);
    for _ in 0..(2.0 / step) as usize {
        plant.step([0.0; 2], step)?;
    }
    let height = 1e3 * plant.body().position[2];
    rows.table("dropped from 20 mm, at rest: plate's height", "mm", height, Some((56.65, 0.2)));
    let load: f64 = plant.legs().iter().flatten().map(|l| l.floor_force[2]).sum();
    let weight = plant.mass_properties().0 * GRAVITY;
    rows.add("floor's force at rest", "N", load, Some((weight, 1e-3 * weight)));
    Ok(())
}

/// A symmetric robot under (f, theta) walks the mirror image of (-f, -theta).
fn mirror(rows: &mut Rows, model: &RobotModel, step: f64) -> Result<(), ProbeError> {
    let walk = |f: f64, theta: f64, mirrored: bool| -> Result<[f64; 3], ProbeError> {
        let mut plant = Plant::new(model)?;
        plant.disturb(1, mirrored);
        plant.set_drive(Drive::Ideal { frequency_hz: f, theta_rad: theta });
        for _ in 0..(2.0 / step) as usize {
            plant.step([0.0; 2], step)?;
        }
        let body = plant.body();
        Ok([1e3 * body.position[0], 1e3 * body.position[1], body.yaw().to_degrees()])
    };
    let right = walk(30.0, 0.5, false)?;
    let left = walk(-30.0, -0.5, true)?;
    for (i, (name, unit, sign)) in
        [("forward", "mm", 1.0), ("sideways", "mm", -1.0), ("turn", "deg", -1.0)]
            .into_iter()
            .enumerate()
    {
        let name = format!("mirrored walk of 2 s: {name}");
        rows.add(&name, unit, left[i], Some((sign * right[i], 1e-3 * right[i].abs())));
    }
    Ok(())
}

/// Returns whether the right half of the model is the mirror image of the left.
pub(crate) fn is_symmetric(model: &RobotModel) -> bool {
    let Some(legs) = &model.legs else { return true };
    let same = |l: &crate::model::Leg, r: &crate::model::Leg| {
        let mut mirrored = *r;
        mirrored.twist_hand = -r.twist_hand;
        *l == mirrored
    };
    let blocks = [model.battery.y_mm, model.electronics.y_mm, model.body.offset_y_mm];
    same(&legs.fl, &legs.fr)
        && same(&legs.rl, &legs.rr)
        && blocks.iter().all(|y| *y == 0.0)
        && model.load.iter().all(|l| l.y_mm == 0.0)
}

/// The robot pushed forward with half of what its friction can hold stays where it is.
fn stick(rows: &mut Rows, model: &RobotModel, step: f64) -> Result<(), ProbeError> {
    let Some(legs) = &model.legs else { return Ok(()) };
    let mut plant = Plant::new(model)?;
    let run = |plant: &mut Plant, seconds: f64| -> Result<(), Diverged> {
        (0..(seconds / step) as usize).try_for_each(|_| plant.step([0.0; 2], step))
    };
    run(&mut plant, 0.5)?;
    let least = legs.each().iter().map(|l| l.friction).fold(f64::INFINITY, f64::min);
    let force = 0.5 * least * plant.mass_properties().0 * GRAVITY;
    let height = plant.body().position[2];
    // At the height of the soles, so that it does not tip.
    plant.set_push(Wrench { force: [force, 0.0, 0.0], torque: [0.0, -height * force, 0.0] });
    run(&mut plant, 1.0)?;
    let from = plant.body().position[0];
    run(&mut plant, 1.0)?;
    let creep = 1e3 * (plant.body().position[0] - from);
    rows.add("creep under half the limit of friction", "mm/s", creep, Some((0.0, 0.1)));
    Ok(())
}
