//! One step of the whole tree, over one robot or several.

use super::lane::{Lane, sin_cos};
use super::leg::{BodyStep, LegModel, LegState, LegStep};
use super::spatial::{Articulated, Mat3, RigidInertia, Spatial, Spread, Sym3, Vec3, solve6};

/// Newton steps after which the grips are taken as they are.
const NEWTON_LIMIT: usize = 12;

/// Bodies faster than this, m/s,
pub const SPEED_LIMIT: f64 = 100.0;
/// or turning faster than this, rad/s, are no motion of this robot.
pub const TURN_LIMIT: f64 = 1e4;
/// A rotor faster than this, rad/s (1600 Hz), is none either.
pub const ROTOR_SPEED_LIMIT: f64 = 1e4;
/// A leg whose hinges are bent by more than this in all, rad, has wound itself up.
pub const HINGE_LIMIT: f64 = 6.0;

/// How the base may move, with its damping.
#[derive(Clone, Copy, Debug)]
pub enum BaseJoint<B> {
    /// Not.
    Fixed,
    /// In the plane and about the vertical: damping in N s/m and N m s/rad.
    Planar(B, B),
    /// Freely.
    Free,
}

/// What does not change during a run.
#[derive(Clone, Debug)]
pub struct Constants<B, L, const G: usize> {
    /// Base joint.
    pub base: BaseJoint<B>,
    /// Everything fixed to the body, about the origin in body axes.
    pub inertia: RigidInertia<B>,
    /// Mass of each rotor, kg.
    pub rotor_mass: B,
    /// Its arm, m.
    pub rotor_arm: B,
    /// Inertia of each motor's bell, kg m^2.
    pub bell_inertia: B,
    /// Heights of the rotors over the origin, m: top, bottom.
    pub rotor_height: [B; 2],
    /// Height of the shaker's middle, m.
    pub shaker_height: B,
    /// Acceleration of free fall, world, m/s^2.
    pub gravity: Vec3<B>,
    /// The legs, if there are any.
    pub legs: Option<[LegModel<L>; G]>,
    /// Is there a floor?
    pub floor: bool,
    /// Do rotors turn as prescribed, with the acceleration that their state holds?
    pub ideal: bool,
}

/// A rotor.
#[derive(Clone, Copy, Debug)]
pub struct Rotor<B> {
    /// Angle within a turn, rad.
    pub angle: B,
    /// Whole turns beside it.
    pub turns: B,
    /// Speed relative to the body, rad/s.
    pub speed: B,
    /// Acceleration of the last step, rad/s^2.
    pub acceleration: B,
}

/// What changes.
#[derive(Clone, Debug)]
pub struct State<B, L, const G: usize> {
    /// Of the body's origin, world, m.
    pub position: Vec3<B>,
    /// Unit quaternion from body to world.
    pub orientation: [B; 4],
    /// World velocity of the body, at its origin.
    pub velocity: Spatial<B>,
    /// Its change per second in the last step.
    pub acceleration: Spatial<B>,
    /// Top, bottom.
    pub rotors: [Rotor<B>; 2],
    /// The legs.
    pub legs: [LegState<L>; G],
    /// Wrench on the body at its origin, world axes.
    pub push: Spatial<B>,
    /// Wrench on each leg's tip, world axes.
    pub tip_push: [Spatial<L>; G],
    /// Wrench of the rotors on the body at the origin, world axes, weight included, in the last step.
    pub shaker: Spatial<B>,
    /// Orientation in the middle of the last step.
    pub middle: Mat3<B>,
    /// Torques on the rotors in the last step.
    pub motor_torque: [B; 2],
    /// Energies so far, J: motors, pushes, base damping, hinges, floor.
    pub work: [B; 5],
}

impl<B: Spread<L>, L: Lane, const G: usize> State<B, L, G> {
    /// Returns -1 for robots that move as none does, else 1.
    #[inline(always)]
    pub fn sane(&self) -> B {
        let bad = B::splat(-1.0);
        let mut sane = B::splat(1.0);
        for i in 0..3 {
            sane = within(sane, self.velocity.linear.0[i], SPEED_LIMIT);
            sane = within(sane, self.velocity.angular.0[i], TURN_LIMIT);
        }
        for rotor in &self.rotors {
            sane = within(sane, rotor.speed, ROTOR_SPEED_LIMIT);
        }
        let mut legs = [L::splat(0.0); G];
        for g in 0..G {
            let more = self.legs[g].bent() - L::splat(HINGE_LIMIT);
            legs[g] = more.negative_then(L::splat(1.0), L::splat(-1.0));
        }
        B::least(legs).negative_then(bad, sane)
    }
}

/// Returns `sane` where the value is within the limit, else -1.
#[inline(always)]
fn within<F: Lane>(sane: F, value: F, limit: f64) -> F {
    (value.abs() - F::splat(limit)).negative_then(sane, F::splat(-1.0))
}

/// Several robots, each with its legs one after the other.
pub type Several<F> = State<F, F, 4>;

impl<L, const G: usize> State<f64, L, G> {
    /// Returns a leg of this body as it stands now.
    pub fn still(&self, model: &LegModel<f64>, state: &LegState<f64>) -> LegStep<f64> {
        let body = BodyStep {
            frame: rotation(self.orientation),
            velocity: self.velocity,
            start: self.velocity,
            bias: Spatial::zero(),
            height: self.position.0[2],
            step: 0.0,
            floor: false,
        };
        let mut step = LegStep::blank();
        step.prepare(model, state, &body, Spatial::zero());
        step
    }
}

/// A rotor inside one step.
#[derive(Clone, Copy, Debug)]
struct RotorStep<B> {
    axis: Spatial<B>,
    inertia: RigidInertia<B>,
    bias: Spatial<B>,
    reach: Spatial<B>,
    /// Joint-space inertia, kg m^2.
    joint_inertia: B,
    drive: B,
}

impl<B: Lane> RotorStep<B> {
    #[inline(always)]
    fn blank() -> Self {
        RotorStep {
            axis: Spatial::zero(),
            inertia: RigidInertia::zero(),
            bias: Spatial::zero(),
            reach: Spatial::zero(),
            joint_inertia: B::splat(1.0),
            drive: B::splat(0.0),
        }
    }

    #[inline(always)]
    fn new<L, const G: usize>(
        c: &Constants<B, L, G>,
        rotor: &Rotor<B>,
        height: B,
        body: &BodyStep<B>,
        torque: B,
    ) -> Self {
        let half = body.step * B::splat(0.5);
        let speed = rotor.speed + half * rotor.acceleration;
        let (sin, cos) = sin_cos(rotor.angle + half * rotor.speed);
        let up = body.frame.column(2);
        let at = body.frame.apply(Vec3([c.rotor_arm * cos, c.rotor_arm * sin, height]));
        let axis = Spatial::rotation_about(up, Vec3::zero());
        let inertia = RigidInertia::new(c.rotor_mass, at, Sym3::disc(up, c.bell_inertia));
        let spin = axis.scale(speed);
        let moving = body.velocity + spin;
        let bias = inertia.apply(body.bias + body.velocity.cross_motion(spin))
            + moving.cross_force(inertia.apply(moving));
        let reach = inertia.apply(axis);
        RotorStep {
            axis,
            inertia,
            bias,
            reach,
            joint_inertia: axis.dot(reach),
            drive: torque - axis.dot(bias),
        }
    }
}

impl<B: Lane> Rotor<B> {
    #[inline(always)]
    fn advance(&mut self, angle: B) {
        let turn = B::splat(core::f64::consts::TAU);
        let raw = self.angle + angle;
        let turns = (raw / turn).round();
        self.angle = raw - turns * turn;
        self.turns += turns;
    }
}

/// Advances by one step of `h` seconds under the motors' torques.
#[inline(always)]
pub fn advance<B, L, const G: usize>(
    c: &Constants<B, L, G>,
    s: &mut State<B, L, G>,
    steps: &mut [LegStep<L>; G],
    torque: [B; 2],
    h: B,
) where
    B: Spread<L>,
    L: Lane,
{
    let half = h * B::splat(0.5);
    let old = s.velocity;
    let middle = turned(s.orientation, old.angular, half);
    let frame = rotation(middle);
    let velocity = old + s.acceleration.scale(half);
    // Acceleration of every part when nothing unknown accelerates: weight, and the origin's convective part.
    let body = BodyStep {
        frame,
        velocity,
        start: old,
        bias: Spatial::new(Vec3::zero(), -c.gravity - velocity.angular.cross(velocity.linear)),
        height: s.position.0[2] + half * old.linear.0[2],
        step: h,
        floor: c.floor,
    };
    let own = RigidInertia {
        mass: c.inertia.mass,
        moment: frame.apply(c.inertia.moment),
        inertia: c.inertia.inertia.rotated(&frame),
    };
    let mut matrix = own.articulated();
    let mut rest = own.apply(body.bias) + velocity.cross_force(own.apply(velocity)) - s.push;
    let mut rotors = [RotorStep::blank(); 2];
    for i in 0..2 {
        rotors[i] = RotorStep::new(c, &s.rotors[i], c.rotor_height[i], &body, torque[i]);
        let r = &rotors[i];
        matrix = matrix + r.inertia.articulated();
        rest += r.bias;
        if c.ideal {
            rest += r.reach.scale(s.rotors[i].acceleration);
        } else {
            let share = r.reach.scale(B::splat(1.0) / r.joint_inertia);
            matrix = matrix.without(r.reach, share);
            rest += share.scale(r.drive);
        }
    }

    let x = match &c.legs {
        None => base_acceleration(&c.base, &matrix, rest, old, h),
        Some(legs) => advance_legs(c, s, steps, legs, &body, &matrix, rest, h),
    };

    let mut shaker = Spatial::zero();
    for i in 0..2 {
        let r = &rotors[i];
        let (acceleration, used) = if c.ideal {
            let own = s.rotors[i].acceleration;
            (own, r.axis.dot(r.inertia.apply(x + r.axis.scale(own)) + r.bias))
        } else {
            ((r.drive - r.reach.dot(x)) / r.joint_inertia, torque[i])
        };
        shaker = shaker - (r.inertia.apply(x + r.axis.scale(acceleration)) + r.bias);
        let rotor = &mut s.rotors[i];
        let mean = rotor.speed + half * acceleration;
        rotor.speed += h * acceleration;
        rotor.acceleration = acceleration;
        rotor.advance(h * mean);
        s.motor_torque[i] = used;
        s.work[0] += h * used * mean;
    }
    s.shaker = shaker;
    s.middle = frame;
    let new = old + x.scale(h);
    let mean = old + x.scale(half);
    s.acceleration = x;
    s.velocity = new;
    s.position += mean.linear.scale(h);
    s.orientation = turned(middle, new.angular, half);
    s.work[1] += h * s.push.dot(mean);
    if let BaseJoint::Planar(linear, angular) = c.base {
        s.work[2] +=
            h * (linear * mean.linear.dot(mean.linear) + angular * mean.angular.dot(mean.angular));
    }
}

/// The legs' part of a step: finds the body's acceleration with the feet on the floor.
#[inline(always)]
fn advance_legs<B, L, const G: usize>(
    c: &Constants<B, L, G>,
    s: &mut State<B, L, G>,
    steps: &mut [LegStep<L>; G],
    legs: &[LegModel<L>; G],
    body: &BodyStep<B>,
    matrix: &Articulated<B>,
    rest: Spatial<B>,
    h: B,
) -> Spatial<B>
where
    B: Spread<L>,
    L: Lane,
{
    let old = s.velocity;
    let seen = BodyStep {
        frame: body.frame.spread(),
        velocity: body.velocity.spread(),
        start: old.spread(),
        bias: body.bias.spread(),
        height: body.height.spread(),
        step: h.spread(),
        floor: body.floor,
    };
    for g in 0..G {
        steps[g].prepare(&legs[g], &s.legs[g], &seen, s.tip_push[g]);
    }
    let mut lowest = [L::splat(0.0); G];
    for g in 0..G {
        lowest[g] = steps[g].lowest;
    }
    // Below zero for robots that touch the floor.
    let touching: L = B::least(lowest).spread();
    let near = touching.any_negative();
    let mut round = 0;
    let mut inertia = [Articulated::zero(); G];
    let mut bias = [Spatial::zero(); G];
    // Legs whose grips are not yet those in the equations.
    let mut stale = [true; G];
    loop {
        for g in 0..G {
            if stale[g] {
                if near {
                    steps[g].assemble_contact(&legs[g]);
                }
                (inertia[g], bias[g]) = steps[g].eliminate();
            }
        }
        let a = *matrix + Articulated::gather(&inertia);
        let b = rest + Spatial::gather(&bias);
        let x = base_acceleration(&c.base, &a, b, old, h);
        round += 1;
        let mut changed = [L::splat(0.0); G];
        let mut feet = [Spatial::zero(); G];
        for g in 0..G {
            feet[g] = steps[g].solve(&mut s.legs[g], x.spread());
            if near && round < NEWTON_LIMIT {
                changed[g] = steps[g].choose(&legs[g], &mut s.legs[g], feet[g], touching);
            }
        }
        // Below zero for robots of which a corner changed.
        let robot: L = B::least(changed).spread();
        if robot.any_negative() {
            for g in 0..G {
                // Short numbers leave a leg alone whose own corners are found: most are, and they cost the most.
                let changed = if L::SHORT { changed[g] } else { robot };
                stale[g] = changed.any_negative();
                if stale[g] {
                    steps[g].adopt(&s.legs[g], changed);
                }
            }
        } else {
            let (mut lost, mut given) = ([L::splat(0.0); G], [L::splat(0.0); G]);
            for g in 0..G {
                (lost[g], given[g]) =
                    steps[g].finish(&legs[g], &mut s.legs[g], feet[g], h.spread(), touching);
            }
            s.work[3] += B::gather(lost);
            s.work[4] += B::gather(given);
            return x;
        }
    }
}

/// The body's acceleration, as its base joint allows: `matrix x + rest = 0` in the free directions.
#[inline(always)]
fn base_acceleration<B: Lane>(
    base: &BaseJoint<B>,
    matrix: &Articulated<B>,
    rest: Spatial<B>,
    velocity: Spatial<B>,
    h: B,
) -> Spatial<B> {
    let mut a = matrix.matrix();
    let mut b = [B::splat(0.0); 6];
    for (i, b) in b.iter_mut().enumerate() {
        *b = -rest.component(i);
    }
    match base {
        BaseJoint::Fixed => return Spatial::zero(),
        BaseJoint::Free => {}
        BaseJoint::Planar(linear, angular) => {
            for (i, damping) in [(2, *angular), (3, *linear), (4, *linear)] {
                a[i][i] += B::splat(0.5) * h * damping;
                b[i] -= damping * velocity.component(i);
            }
            for i in [0, 1, 5] {
                for j in 0..6 {
                    a[i][j] = B::splat(0.0);
                    a[j][i] = B::splat(0.0);
                }
                a[i][i] = B::splat(1.0);
                b[i] = B::splat(0.0);
            }
        }
    }
    let x = solve6(&a, b);
    Spatial::new(Vec3([x[0], x[1], x[2]]), Vec3([x[3], x[4], x[5]]))
}

/// Returns the Hamilton product.
#[inline(always)]
pub fn multiply<F: Lane>(a: [F; 4], b: [F; 4]) -> [F; 4] {
    [
        (a[0] * b[0] - a[1] * b[1]) - (a[2] * b[2] + a[3] * b[3]),
        (a[0] * b[1] + a[1] * b[0]) + (a[2] * b[3] - a[3] * b[2]),
        (a[0] * b[2] + a[2] * b[0]) + (a[3] * b[1] - a[1] * b[3]),
        (a[0] * b[3] + a[3] * b[0]) + (a[1] * b[2] - a[2] * b[1]),
    ]
}

/// Returns `q` turned by the world rotation `w t` (Cayley's form, exact to third order in `w t`), of unit length.
#[inline(always)]
pub fn turned<F: Lane>(q: [F; 4], w: Vec3<F>, t: F) -> [F; 4] {
    let v = w.scale(F::splat(0.5) * t);
    let q = multiply([F::splat(1.0), v.0[0], v.0[1], v.0[2]], q);
    let n = F::splat(1.0) / ((q[0] * q[0] + q[3] * q[3]) + (q[1] * q[1] + q[2] * q[2])).sqrt();
    [q[0] * n, q[1] * n, q[2] * n, q[3] * n]
}

/// Returns the rotation matrix of a unit quaternion.
#[inline(always)]
pub fn rotation<F: Lane>(q: [F; 4]) -> Mat3<F> {
    let [w, x, y, z] = q;
    let (one, two) = (F::splat(1.0), F::splat(2.0));
    Mat3([
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ])
}
