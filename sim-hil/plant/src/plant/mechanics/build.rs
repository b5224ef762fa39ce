//! From the model's data to the constants of the equations.

use super::leg::{Foot, LegModel, LegState, LegStep};
use super::pack::Pack;
use super::spatial::{Mat3, RigidInertia, Spatial, Sym3, Vec3};
use super::system::{BaseJoint, Constants, Rotor, Several, State, advance};
use crate::model::{Base, FootAxis, LEG_SIDE, Legs, RobotModel};

/// One robot with its legs one after the other, for set-up and analysis.
pub type PlainConstants = Constants<f64, f64, 4>;
/// Its state.
pub type PlainState = Several<f64>;

/// Creates a state with everything at rest, legs straight, soles on the floor, rotors forward.
pub fn state<B, L, const G: usize>(model: &RobotModel) -> State<B, L, G>
where
    B: super::lane::Lane + Pack<Single = f64>,
    L: super::lane::Lane,
{
    let c = B::splat;
    let rotor = Rotor { angle: c(0.0), turns: c(0.0), speed: c(0.0), acceleration: c(0.0) };
    State {
        position: Vec3([c(0.0), c(0.0), c(model.standing_height())]),
        orientation: [c(1.0), c(0.0), c(0.0), c(0.0)],
        velocity: Spatial::zero(),
        acceleration: Spatial::zero(),
        rotors: [rotor; 2],
        legs: [LegState::straight(); G],
        push: Spatial::zero(),
        tip_push: [Spatial::zero(); G],
        shaker: Spatial::zero(),
        middle: Mat3::splat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        motor_torque: [c(0.0); 2],
        work: [c(0.0); 5],
    }
}

/// Derives the constants of a checked model, legs one after the other.
pub fn constants(model: &RobotModel) -> PlainConstants {
    let shaker = &model.shaker;
    let height = |sign: f64| 1e-3 * (shaker.z_mm + sign * 0.5 * shaker.spacing_mm);
    let mut c = Constants {
        base: match model.base {
            Base::Fixed {} => BaseJoint::Fixed,
            Base::Planar { damping_n_s_m, yaw_damping_n_m_s } => {
                BaseJoint::Planar(damping_n_s_m, yaw_damping_n_m_s)
            }
            Base::Free {} => BaseJoint::Free,
        },
        inertia: body_inertia(model),
        rotor_mass: 1e-3 * shaker.mass_g,
        rotor_arm: 1e-3 * shaker.arm_mm,
        bell_inertia: 1e-7 * shaker.bell_inertia_g_cm2,
        rotor_height: [height(1.0), height(-1.0)],
        shaker_height: 1e-3 * shaker.z_mm,
        gravity: Vec3(model.gravity()),
        legs: model.legs.as_ref().map(|legs| core::array::from_fn(|i| leg(model, legs, i))),
        floor: false,
        ideal: false,
    };
    if let Some(legs) = c.legs {
        let mobility: [f64; 4] = core::array::from_fn(|i| foot_mobility(&c, model, i));
        let legs = core::array::from_fn(|i| {
            let mut leg = legs[i];
            leg.foot.mobility = mobility[i];
            leg.foot.damping *= mobility[i];
            leg.foot.stiffness *= mobility[i];
            leg
        });
        c.legs = Some(legs);
        c.floor = true;
    }
    c
}

/// Inverse apparent mass of a foot's centre, 1/kg: the mean over three directions of its acceleration
/// under a unit force, robot floating straight and at rest, rotors free.
fn foot_mobility(c: &PlainConstants, model: &RobotModel, leg: usize) -> f64 {
    let Some(legs) = &c.legs else { return 0.0 };
    let mut floating = c.clone();
    floating.base = BaseJoint::Free;
    let step = 1e-9;
    let lever = {
        let m = &legs[leg];
        let tip = Vec3([0.0, m.segment, 0.0]);
        end_frame(m).apply(m.foot_center - tip)
    };
    let speed = |force: Vec3<f64>| {
        let mut s: PlainState = state(model);
        s.tip_push[leg] = Spatial::new(lever.cross(force), force);
        let mut steps = [LegStep::blank(); 4];
        advance(&floating, &mut s, &mut steps, [0.0; 2], step);
        let view = s.still(&legs[leg], &s.legs[leg]);
        let at = view.foot(&legs[leg]).0;
        view.velocity.linear + view.velocity.angular.cross(at)
    };
    let mut sum = 0.0;
    for i in 0..3 {
        let mut force = [0.0; 3];
        force[i] = 1.0;
        // Both ways, so that mirror images get the same bits.
        sum += (speed(Vec3(force)) - speed(-Vec3(force))).0[i] / (2.0 * step);
    }
    sum / 3.0
}

/// Axes of the last segment in body axes when the leg is straight.
fn end_frame(m: &LegModel<f64>) -> Mat3<f64> {
    let mut frame = m.frame;
    for [c, s] in m.twist {
        let (x, z) = (frame.column(0), frame.column(2));
        frame =
            Mat3::from_columns(x.scale(c) - z.scale(s), frame.column(1), z.scale(c) + x.scale(s));
    }
    frame
}

/// Principal inertia of a solid box, kg m^2.
fn box_inertia(mass: f64, size: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = size.map(|s| s * s);
    let k = mass / 12.0;
    [k * (b + c), k * (a + c), k * (a + b)]
}

/// Sums plate, battery, electronics, core and loads about the origin.
pub fn body_inertia(model: &RobotModel) -> RigidInertia<f64> {
    let block = |mass_g: f64, at_mm: [f64; 3], size_mm: [f64; 3]| {
        let mass = 1e-3 * mass_g;
        let [x, y, z] = box_inertia(mass, size_mm.map(|s| 1e-3 * s));
        RigidInertia::new(mass, Vec3(at_mm.map(|v| 1e-3 * v)), Sym3([x, 0.0, 0.0, y, 0.0, z]))
    };
    let (p, b, e, c) = (&model.plate, &model.battery, &model.electronics, &model.core);
    let mut sum = block(p.mass_g, [0.0; 3], [p.length_mm, p.width_mm, p.thickness_mm])
        + block(b.mass_g, [b.x_mm, b.y_mm, b.z_mm], b.size_mm)
        + block(e.mass_g, [e.x_mm, e.y_mm, e.z_mm], e.size_mm)
        + block(
            model.core_mass_g(),
            [c.x_mm + model.body.offset_x_mm, model.body.offset_y_mm, c.z_mm],
            c.size_mm,
        );
    for load in &model.load {
        sum = sum + block(load.mass_g, [load.x_mm, load.y_mm, load.z_mm], [0.0; 3]);
    }
    sum
}

fn leg(model: &RobotModel, legs: &Legs, index: usize) -> LegModel<f64> {
    let own = legs.each()[index];
    let [sx, sy] = LEG_SIDE[index];
    let (sin, cos) = libm::sincos(legs.hinge_deg.to_radians());
    // The right leg's hinge is the left one's mirror image.
    let x = Vec3([cos, sy * sin, 0.0]);
    let y = Vec3([0.0, 0.0, -1.0]);
    let frame = Mat3::from_columns(x, y, x.cross(y));
    let twist = legs.twist_deg.map(|t| {
        let (s, c) = libm::sincos((own.twist_hand * t).to_radians());
        [c, s]
    });
    let segment = 1e-3 * legs.length_mm / 3.0;
    let mass = 1e-3 * legs.mass_g / 3.0;
    let inertia =
        Vec3(box_inertia(mass, [1e-3 * legs.width_mm, segment, 1e-3 * legs.thickness_mm]));
    let mut m = LegModel {
        root: Vec3([
            1e-3 * sx * legs.root_x_mm,
            1e-3 * sy * legs.root_y_mm,
            -0.5e-3 * model.plate.thickness_mm,
        ]),
        frame,
        twist,
        stiffness: core::array::from_fn(|j| {
            if j % 2 == 0 {
                legs.bend_stiffness_n_m_rad * own.bend_stiffness_factor
            } else {
                legs.twist_stiffness_n_m_rad * own.twist_stiffness_factor
            }
        }),
        damping: core::array::from_fn(|j| {
            if j % 2 == 0 {
                legs.bend_damping_n_m_s_rad * own.bend_damping_factor
            } else {
                legs.twist_damping_n_m_s_rad * own.twist_damping_factor
            }
        }),
        segment,
        mass,
        inertia,
        end_mass: mass,
        end_center: Vec3([0.0, 0.5 * segment, 0.0]),
        end_inertia: Sym3([inertia.0[0], 0.0, 0.0, inertia.0[1], 0.0, inertia.0[2]]),
        foot_center: Vec3::zero(),
        foot_half: Mat3::zero(),
        foot: contact(model, own.friction),
    };
    add_foot(&mut m, legs, own.foot_shift_mm, [sx, sy]);
    m
}

/// Fixes the foot to the last segment, level and along its axis when the leg is straight.
fn add_foot(m: &mut LegModel<f64>, legs: &Legs, shift_mm: f64, [sx, sy]: [f64; 2]) {
    let foot = &legs.foot;
    let turn = end_frame(m);
    let (long, wide) = foot.size_xy_mm();
    let size = [1e-3 * long, 1e-3 * wide, 1e-3 * foot.height_mm];
    let shift = match foot.axis {
        FootAxis::Across => Vec3([0.0, 1e-3 * shift_mm * sy, 0.0]),
        FootAxis::Along => Vec3([1e-3 * shift_mm * sx, 0.0, 0.0]),
    };
    let below = shift - Vec3([0.0, 0.0, 0.5 * size[2]]);
    m.foot_center = Vec3([0.0, m.segment, 0.0]) + turn.apply_transposed(below);
    let column = |i: usize| {
        let mut v = [0.0; 3];
        v[i] = 0.5 * size[i];
        turn.apply_transposed(Vec3(v))
    };
    m.foot_half = Mat3::from_columns(column(0), column(1), column(2));
    let mass = 1e-3 * foot.mass_g;
    let [ix, iy, iz] = box_inertia(mass, size);
    let upright = Sym3([ix, 0.0, 0.0, iy, 0.0, iz]);
    let back = Mat3([turn.column(0).0, turn.column(1).0, turn.column(2).0]);
    let total = m.end_mass + mass;
    let center = (m.end_center.scale(m.end_mass) + m.foot_center.scale(mass)).scale(1.0 / total);
    let about = |inertia: Sym3<f64>, mass: f64, at: Vec3<f64>| {
        inertia + Sym3::point_mass(mass, at - center)
    };
    m.end_inertia = about(m.end_inertia, m.end_mass, m.end_center)
        + about(upright.rotated(&back), mass, m.foot_center);
    m.end_mass = total;
    m.end_center = center;
}

/// Returns the longest step, s, in which no foot gains speed from the floor: the time in which the stiffest one swings by a radian on its
/// corner. A foot that meets the floor within a longer step is thrown back faster than it came.
pub fn longest_step(constants: &PlainConstants) -> f64 {
    let of = |leg: &LegModel<f64>| {
        let Foot { stiffness, impedance: [touch, full, _], .. } = leg.foot;
        1.0 / (touch.max(full) * stiffness.sqrt())
    };
    let legs = constants.legs.as_ref();
    legs.map_or(f64::INFINITY, |legs| legs.iter().map(of).fold(f64::INFINITY, f64::min))
}

/// Returns the time constant in s and the damping ratio by which MuJoCo gives each foot the model's stiffness and
/// damping (`solref`); zeros without legs.
#[must_use]
pub fn reference_contact(model: &RobotModel) -> [[f64; 2]; 4] {
    constants(model).legs.map_or([[0.0; 2]; 4], |legs| {
        legs.map(|leg| {
            let Foot { damping, stiffness, impedance: [_, full, _], .. } = leg.foot;
            [2.0 / (full * damping), 0.5 * damping / stiffness.sqrt()]
        })
    })
}

/// For mobility 1: a foot's own is known once the whole robot is.
fn contact(model: &RobotModel, friction: f64) -> Foot<f64> {
    let c = &model.contact;
    let full = c.impedance_full;
    let (torsion, rolling) = (1e-3 * c.torsional_friction_mm, 1e-3 * c.rolling_friction_mm);
    Foot {
        friction: [friction, friction, torsion, rolling, rolling],
        damping: c.damping_n_s_per_m * (1.0 - full) / full,
        stiffness: c.stiffness_n_per_m * (1.0 - full) / (full * full),
        mobility: 1.0,
        impedance: [c.impedance_touch, full, 1e-3 * c.impedance_width_mm],
    }
}
