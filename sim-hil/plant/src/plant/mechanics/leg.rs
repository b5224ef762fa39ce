//! Soft legs as pseudo-rigid bodies, and their feet on the floor.
//!
//! A leg is three rigid segments; each hangs on a bending hinge (local x) and a twisting hinge (local y,
//! the beam's axis, from root to foot). The foot is fixed to the last segment. The contact law is in
//! [`Foot`].

use super::lane::{Lane, sin_cos};
use super::spatial::{Articulated, Mat3, RigidInertia, Spatial, Sym3, Vec3};

/// Friction directions of a contact point: two tangents, torsion, two rolling axes.
pub const FRICTIONS: usize = 5;
/// A corner slower than this, m/s,
pub const REST_SPEED: f64 = 0.02;
/// for this long, s (longer than a shaking period from 20 Hz on), comes to stand;
pub const REST_TIME: f64 = 0.05;
/// one faster than this, m/s, slides.
pub const SLIDE_SPEED: f64 = 0.3;
/// Contact points of a foot: its four lowest corners.
pub const CORNERS: usize = 4;
/// A change of a sliding corner's direction, squared, below which the direction is taken as found: what a step that
/// is linear about it leaves out is half of this, as a share of its friction.
const TURN: f64 = 1e-4;
/// The same for a relative change of its friction.
const CHANGE: f64 = 1e-2;
/// Keeps quotients by a friction of zero finite.
const TINY: f64 = 1e-30;

/// What a leg is made of; constant during a run. One lane may be one leg or one robot.
#[derive(Clone, Copy, Debug)]
pub struct LegModel<F> {
    /// Root in body axes, m.
    pub root: Vec3<F>,
    /// Axes of the first hinge in body axes.
    pub frame: Mat3<F>,
    /// Cosine and sine of the twist offset above each segment.
    pub twist: [[F; 2]; 3],
    /// Stiffness of each hinge, N m/rad: bend, twist, bend, twist, bend, twist from the root.
    pub stiffness: [F; 6],
    /// Damping of each hinge, N m s/rad.
    pub damping: [F; 6],
    /// Length of a segment, m.
    pub segment: F,
    /// Mass of a segment, kg.
    pub mass: F,
    /// Principal inertia of a segment about its centre, kg m^2.
    pub inertia: Vec3<F>,
    /// Mass of the last segment with its foot, kg.
    pub end_mass: F,
    /// Their centre of mass from the last hinge, segment axes, m.
    pub end_center: Vec3<F>,
    /// Their inertia about it, segment axes, kg m^2.
    pub end_inertia: Sym3<F>,
    /// Centre of the foot from the last hinge, segment axes, m.
    pub foot_center: Vec3<F>,
    /// Half extents of the foot: one column an axis, segment axes, m.
    pub foot_half: Mat3<F>,
    /// How the foot meets the floor.
    pub foot: Foot<F>,
}

/// The contact law of one foot.
///
/// Each of its four lowest corners that is below the floor is a contact of six directions: the normal and the five
/// friction directions, each with its coefficient `m_i`. Along each, `j = a + b v` is what the floor has to resist
/// (acceleration and damped velocity of the corner), along the normal `j_n = a_n + b v_n + k d(r) r` with the
/// penetration `r` (negative) and the impedance `d(r)`. With `T = |m_i j_i|` over the friction directions and
/// `m` the tangential coefficient, the corner
///
/// ```text
/// is free    if j_n >= T:         no force
/// sticks     if T <= -m^2 j_n:    N = -j_n / R,              F_i = -(m_i/m)^2 j_i / R
/// slides     otherwise:           N = (T - j_n)/(R (1+m^2)),  F_i = -N m_i (m_i j_i)/T
/// ```
///
/// with `R = (1 - d)/d` of the foot's inverse apparent mass. That is MuJoCo's elliptic cone: the force is always
/// within `|F_i/m_i| <= N`, has no preferred direction in the plane, and the normal's compliance does not depend on
/// friction. The law is regularised, so that under a steady push a foot creeps for ever.
///
/// A corner that has crept slower than [`REST_SPEED`] for [`REST_TIME`] therefore comes to **stand**: to its two
/// tangents a spring `k d s` of its tangential strain `s` is added, no longer than the cone can hold. So it holds
/// without creep what friction can hold, gives way beyond that, and slides again above [`SLIDE_SPEED`]. (Friction
/// that grows while surfaces rest is the usual finding: Dieterich 1979.)
#[derive(Clone, Copy, Debug)]
pub struct Foot<F> {
    /// Coefficients: two tangents (1), torsion, two rolling (m).
    pub friction: [F; FRICTIONS],
    /// Damping rate b, 1/s.
    pub damping: F,
    /// Stiffness rate k, 1/s^2.
    pub stiffness: F,
    /// Inverse apparent mass of the foot: R at (1 - d)/d = 1, 1/kg.
    pub mobility: F,
    /// Impedance at touch, at full width, and the width in m.
    pub impedance: [F; 3],
}

/// Where a leg is.
#[derive(Clone, Copy, Debug)]
pub struct LegState<F> {
    /// Hinge angles, rad: bend, twist, bend, twist, bend, twist from the root.
    pub angle: [F; 6],
    /// Hinge speeds, rad/s.
    pub speed: [F; 6],
    /// Hinge accelerations of the last step, rad/s^2.
    pub acceleration: [F; 6],
    /// How each corner met the floor in the last step.
    pub law: [ContactLaw<F>; CORNERS],
    /// How long each corner has been slow on the floor, s; it stands from [`REST_TIME`] on.
    pub rest: [F; CORNERS],
    /// Tangential strain of a standing corner along world x and y, m.
    pub tangential_strain: [[F; 2]; CORNERS],
    /// Force of the floor on the foot in the last step, N, world axes.
    pub force: Vec3<F>,
}

/// The contact law of a corner, linear about where it was last: the force is `-H j / R` with
/// `H = push (1, -e)(1, -e)^T + hold (diag m_i^2 - e e^T)`, `e_i = m_i slip_i`. (The law's potential is of second degree, so
/// that this is exact there.)
#[derive(Clone, Copy, Debug)]
pub struct ContactLaw<F> {
    /// Share of the normal's stiffness: 0 in the air, 1 while it sticks, 1/(1 + m^2) while it slides.
    pub push: F,
    /// Share of friction's stiffness across the slip: 1/m^2 while it sticks.
    pub hold: F,
    /// Direction of the slip: `m_i j_i / T`; zero unless it slides.
    pub slip: [F; FRICTIONS],
}

impl<F: Lane> ContactLaw<F> {
    /// Creates the law of a corner in the air.
    #[inline(always)]
    fn none() -> Self {
        let o = F::splat(0.0);
        ContactLaw { push: o, hold: o, slip: [o; FRICTIONS] }
    }
}

impl<F: Lane> LegState<F> {
    /// Creates a leg straight and at rest.
    pub fn straight() -> Self {
        let o = F::splat(0.0);
        LegState {
            angle: [o; 6],
            speed: [o; 6],
            acceleration: [o; 6],
            law: [ContactLaw::none(); CORNERS],
            rest: [o; CORNERS],
            tangential_strain: [[o; 2]; CORNERS],
            force: Vec3::zero(),
        }
    }

    /// Returns the sum of the hinge angles' magnitudes, rad.
    #[inline(always)]
    pub fn bent(&self) -> F {
        let mut bent = F::splat(0.0);
        for angle in &self.angle {
            bent += angle.abs();
        }
        bent
    }
}

/// A corner inside one step.
#[derive(Clone, Copy, Debug)]
struct Corner<F> {
    /// Where it touches, from the body's origin, world axes.
    at: Vec3<F>,
    /// 1/R; zero in the air.
    weight: F,
    /// `1 + b h/2 + k d h^2/4`.
    lead: F,
    /// `k d`.
    stiffness: F,
    /// `b v_n + k d r`.
    normal: F,
    /// `m (b v + k d s)` for each friction direction.
    tangent: [F; FRICTIONS],
    /// Velocity along world x and y at the start of the step.
    slide: [F; 2],
    /// Normal force over `weight`.
    load: F,
}

/// A leg inside one step: everything that does not depend on the acceleration sought.
#[derive(Clone, Copy, Debug)]
pub struct LegStep<F> {
    /// Hinge axes as motions.
    pub axis: [Spatial<F>; 6],
    /// Inertia of each segment.
    inertia: [RigidInertia<F>; 3],
    /// Force that each segment needs when no unknown accelerates.
    bias: [Spatial<F>; 3],
    /// Velocity of the foot.
    pub velocity: Spatial<F>,
    /// Orientation of each segment.
    pub frame: [Mat3<F>; 3],
    /// The three hinges and the tip, from the body's origin, world axes.
    pub point: [Vec3<F>; 4],
    /// Torque on each hinge.
    torque: [F; 6],
    /// Joint-space inertia that stiffness and damping of each hinge add in an implicit step, kg m^2.
    implicit_inertia: [F; 6],
    corner: [Corner<F>; CORNERS],
    /// The laws that the equations hold now.
    law: [ContactLaw<F>; CORNERS],
    /// Height of the lowest corner over the floor, m; at most 0.
    pub lowest: F,
    /// Half the step.
    half: F,
    contact: Articulated<F>,
    contact_bias: Spatial<F>,
    /// Elimination: `I S / D`, `u / D` of each hinge.
    share: [Spatial<F>; 6],
    drive: [F; 6],
}

#[inline(always)]
fn turn_x<F: Lane>(m: &Mat3<F>, c: F, s: F) -> Mat3<F> {
    let (y, z) = (m.column(1), m.column(2));
    Mat3::from_columns(m.column(0), y.scale(c) + z.scale(s), z.scale(c) - y.scale(s))
}

#[inline(always)]
fn turn_y<F: Lane>(m: &Mat3<F>, c: F, s: F) -> Mat3<F> {
    let (x, z) = (m.column(0), m.column(2));
    Mat3::from_columns(x.scale(c) - z.scale(s), m.column(1), z.scale(c) + x.scale(s))
}

/// The body inside a step, as the legs see it.
#[derive(Clone, Copy, Debug)]
pub struct BodyStep<F> {
    /// Orientation.
    pub frame: Mat3<F>,
    /// Velocity in the middle of the step, extrapolated.
    pub velocity: Spatial<F>,
    /// Velocity at its start.
    pub start: Spatial<F>,
    /// Acceleration without unknowns, weight included.
    pub bias: Spatial<F>,
    /// Height of the origin over the floor.
    pub height: F,
    /// Step length.
    pub step: F,
    /// Is there a floor at all?
    pub floor: bool,
}

/// Multiplies one by one.
#[inline(always)]
fn products<F: Lane>(a: &[F; FRICTIONS], b: &[F; FRICTIONS]) -> [F; FRICTIONS] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3], a[4] * b[4]]
}

/// A force at `r` and a couple, as one wrench about the origin.
#[inline(always)]
fn wrench<F: Lane>(r: Vec3<F>, force: Vec3<F>, couple: Vec3<F>) -> Spatial<F> {
    Spatial::new(couple + r.cross(force), force)
}

/// Adds up mirror images alike.
#[inline(always)]
fn sum_of_products<F: Lane>(a: &[F; FRICTIONS], b: &[F; FRICTIONS]) -> F {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + (a[3] * b[3] + a[4] * b[4]))
}

impl<F: Lane> LegStep<F> {
    /// Creates room for a step.
    pub fn blank() -> Self {
        let o = F::splat(0.0);
        LegStep {
            axis: [Spatial::zero(); 6],
            inertia: [RigidInertia::zero(); 3],
            bias: [Spatial::zero(); 3],
            velocity: Spatial::zero(),
            frame: [Mat3::zero(); 3],
            point: [Vec3::zero(); 4],
            torque: [o; 6],
            implicit_inertia: [o; 6],
            corner: [Corner {
                at: Vec3::zero(),
                weight: o,
                lead: o,
                stiffness: o,
                normal: o,
                tangent: [o; FRICTIONS],
                slide: [o; 2],
                load: o,
            }; CORNERS],
            law: [ContactLaw::none(); CORNERS],
            lowest: o,
            half: o,
            contact: Articulated::zero(),
            contact_bias: Spatial::zero(),
            share: [Spatial::zero(); 6],
            drive: [o; 6],
        }
    }

    /// Kinematics and known forces of a leg in the middle of a step.
    ///
    /// `push` is a wrench at the tip (couple, force), world axes.
    #[inline(always)]
    pub fn prepare(
        &mut self,
        m: &LegModel<F>,
        s: &LegState<F>,
        body: &BodyStep<F>,
        push: Spatial<F>,
    ) {
        let c = F::splat;
        let half = body.step * c(0.5);
        let quarter = half * half;
        let mut frame = body.frame.product(&m.frame);
        let mut point = body.frame.apply(m.root);
        let mut velocity = body.velocity;
        let mut acceleration = body.bias;
        // The foot's velocity at the start of the step, for the contact law.
        let mut start = body.start;
        for k in 0..3 {
            let (b, t) = (2 * k, 2 * k + 1);
            self.point[k] = point;
            let [ct, st] = m.twist[k];
            frame = turn_y(&frame, ct, st);
            self.axis[b] = Spatial::rotation_about(frame.column(0), point);
            let (sb, cb) = sin_cos(s.angle[b] + half * s.speed[b]);
            frame = turn_x(&frame, cb, sb);
            self.axis[t] = Spatial::rotation_about(frame.column(1), point);
            let (st, ct) = sin_cos(s.angle[t] + half * s.speed[t]);
            frame = turn_y(&frame, ct, st);
            for j in [b, t] {
                let spin = self.axis[j].scale(s.speed[j] + half * s.acceleration[j]);
                acceleration += velocity.cross_motion(spin);
                velocity += spin;
                start += self.axis[j].scale(s.speed[j]);
                self.torque[j] = -(m.stiffness[j] * (s.angle[j] + half * s.speed[j]))
                    - m.damping[j] * s.speed[j];
                self.implicit_inertia[j] = half * m.damping[j] + quarter * m.stiffness[j];
            }
            let inertia = if k < 2 {
                let center = point + frame.column(1).scale(m.segment * c(0.5));
                RigidInertia::new(m.mass, center, Sym3::turned(&frame, m.inertia))
            } else {
                let center = point + frame.apply(m.end_center);
                RigidInertia::new(m.end_mass, center, m.end_inertia.rotated(&frame))
            };
            self.bias[k] =
                inertia.apply(acceleration) + velocity.cross_force(inertia.apply(velocity));
            self.inertia[k] = inertia;
            self.frame[k] = frame;
            point += frame.column(1).scale(m.segment);
        }
        self.point[3] = point;
        self.bias[2] =
            self.bias[2] - Spatial::new(push.angular + point.cross(push.linear), push.linear);
        self.velocity = start;
        self.half = half;
        self.lowest = c(0.0);
        self.contact = Articulated::zero();
        self.contact_bias = Spatial::zero();
        self.law = s.law;
        if body.floor {
            self.touch(m, s, body.height);
        } else {
            for corner in &mut self.corner {
                corner.load = c(0.0);
            }
        }
    }

    /// Finds the corners below the floor and their known terms.
    #[inline(always)]
    fn touch(&mut self, m: &LegModel<F>, s: &LegState<F>, height: F) {
        let c = F::splat;
        let o = c(0.0);
        let frame = self.frame[2];
        let center = self.point[2] + frame.apply(m.foot_center);
        let x = frame.apply(m.foot_half.column(0));
        let y = frame.apply(m.foot_half.column(1));
        let z = frame.apply(m.foot_half.column(2));
        let offsets = [x + y - z, x - y - z, y - x - z, -(x + y + z)];
        let mut lowest = o;
        for j in 0..CORNERS {
            // Of each pair of opposite corners the lower one.
            let sign = (-offsets[j].0[2]).negative_then(c(-1.0), c(1.0));
            let mut at = center + offsets[j].scale(sign);
            let gap = at.0[2] + height;
            lowest = lowest.min(gap);
            at.0[2] -= gap * c(0.5);
            let v = self.velocity.linear + self.velocity.angular.cross(at);
            let w = self.velocity.angular;
            let [d0, d1, width] = m.foot.impedance;
            let ratio = (gap.abs() / width).min(c(1.0));
            // MuJoCo's default sigmoid: two parabolas that meet half-way.
            let rise = (ratio - c(0.5)).negative_then(
                c(2.0) * ratio * ratio,
                c(1.0) - c(2.0) * (c(1.0) - ratio) * (c(1.0) - ratio),
            );
            let d = d0 + (d1 - d0) * rise;
            let weight = gap.negative_then(d / ((c(1.0) - d) * m.foot.mobility), o);
            let b = m.foot.damping;
            let mu = &m.foot.friction;
            let k = m.foot.stiffness * d;
            // Only what stands is strained, at the middle of the step as the gap is.
            let spring = (s.rest[j] - c(REST_TIME)).negative_then(o, k);
            let [x, y] = s.tangential_strain[j];
            self.corner[j] = Corner {
                at,
                weight,
                lead: c(1.0) + self.half * (b + self.half * k),
                stiffness: k,
                normal: b * v.0[2] + k * gap,
                tangent: [
                    mu[0] * (b * v.0[0] + spring * (x + self.half * v.0[0])),
                    mu[1] * (b * v.0[1] + spring * (y + self.half * v.0[1])),
                    mu[2] * (b * w.0[2]),
                    mu[3] * (b * w.0[0]),
                    mu[4] * (b * w.0[1]),
                ],
                slide: [v.0[0], v.0[1]],
                load: o,
            };
        }
        self.lowest = lowest;
    }

    /// Assembles the contact's share of the equations for the present laws.
    #[inline(always)]
    pub fn assemble_contact(&mut self, m: &LegModel<F>) {
        // Opposite corners in pairs, so that a mirrored robot adds the same numbers.
        let (c0, b0) = self.held(0, m);
        let (c1, b1) = self.held(1, m);
        let (c2, b2) = self.held(2, m);
        let (c3, b3) = self.held(3, m);
        self.contact = (c0 + c1) + (c2 + c3);
        self.contact_bias = (b0 + b1) + (b2 + b3);
    }

    /// One corner's share.
    #[inline(always)]
    fn held(&self, j: usize, m: &LegModel<F>) -> (Articulated<F>, Spatial<F>) {
        let o = F::splat(0.0);
        let mu = &m.foot.friction;
        let p = &self.corner[j];
        let law = &self.law[j];
        let r = p.at;
        let (push, hold) = (p.weight * law.push, p.weight * law.hold);
        let e = products(mu, &law.slip);
        let along = wrench(r, Vec3([e[0], e[1], o]), Vec3([e[3], e[4], e[2]]));
        let up = wrench(r, Vec3([o, o, F::splat(1.0)]), Vec3::zero());
        let cone = up - along;

        // The springs of all five friction directions, without what the slip takes away.
        let [x, y, z] = r.0;
        let g = p.lead * hold;
        let (plane, turn, roll) = (g * mu[0] * mu[0], g * mu[2] * mu[2], g * mu[3] * mu[3]);
        let (px, py, pz) = (plane * x, plane * y, plane * z);
        let springs = Articulated {
            angular: Sym3([
                roll + pz * z,
                o,
                -(px * z),
                roll + pz * z,
                -(py * z),
                turn + (px * x + py * y),
            ]),
            coupling: Mat3([[o, -pz, o], [pz, o, o], [-py, px, o]]),
            linear: Sym3([plane, o, o, plane, o, o]),
        };
        let contact =
            springs.without(along, along.scale(g)).without(cone, cone.scale(-(p.lead * push)));

        let t = &p.tangent;
        let slip = sum_of_products(&law.slip, t);
        let bias = wrench(
            r,
            Vec3([hold * mu[0] * t[0], hold * mu[1] * t[1], o]),
            Vec3([hold * mu[3] * t[3], hold * mu[4] * t[4], hold * mu[2] * t[2]]),
        ) + cone.scale(push * (p.normal - slip))
            - along.scale(hold * slip);
        (contact, bias)
    }

    /// Eliminates the hinges from foot to root: what the body feels of this leg.
    #[inline(always)]
    pub fn eliminate(&mut self) -> (Articulated<F>, Spatial<F>) {
        let mut inertia = self.inertia[2].articulated() + self.contact;
        let mut bias = self.bias[2] + self.contact_bias;
        for j in (0..6).rev() {
            let axis = self.axis[j];
            let reach = inertia.apply(axis);
            let inverse = F::splat(1.0) / (axis.dot(reach) + self.implicit_inertia[j]);
            let share = reach.scale(inverse);
            let drive = self.torque[j] - axis.dot(bias);
            inertia = inertia.without(reach, share);
            bias += share.scale(drive);
            self.share[j] = share;
            self.drive[j] = drive * inverse;
            if j == 4 || j == 2 {
                let link = j / 2 - 1;
                inertia = inertia + self.inertia[link].articulated();
                bias += self.bias[link];
            }
        }
        (inertia, bias)
    }

    /// Solves the hinge accelerations under the body's; returns the foot's.
    #[inline(always)]
    pub fn solve(&self, s: &mut LegState<F>, body: Spatial<F>) -> Spatial<F> {
        let mut x = body;
        for j in 0..6 {
            let a = self.drive[j] - self.share[j].dot(x);
            s.acceleration[j] = a;
            x += self.axis[j].scale(a);
        }
        x
    }

    /// Finds how the corners of a robot that touches the floor (`touching` below zero) meet it under the foot's
    /// acceleration `x`; below zero if that differs from the laws in the equations, which stay as they are.
    #[inline(always)]
    pub fn choose(
        &mut self,
        m: &LegModel<F>,
        s: &mut LegState<F>,
        x: Spatial<F>,
        touching: F,
    ) -> F {
        let c = F::splat;
        let (o, one) = (c(0.0), c(1.0));
        let mu = &m.foot.friction;
        let square = mu[0] * mu[0];
        let sticking = one / (square + c(TINY));
        let sliding = one / (one + square);
        let mut changed = o;
        for j in 0..CORNERS {
            let p = self.corner[j];
            let a = x.linear + x.angular.cross(p.at);
            let w = x.angular.0;
            let along = [a.0[0], a.0[1], w[2], w[0], w[1]];
            let normal = p.lead * a.0[2] + p.normal;
            let (lead, t) = (p.lead, &p.tangent);
            let pull = [
                mu[0] * (lead * along[0]) + t[0],
                mu[1] * (lead * along[1]) + t[1],
                mu[2] * (lead * along[2]) + t[2],
                mu[3] * (lead * along[3]) + t[3],
                mu[4] * (lead * along[4]) + t[4],
            ];
            let length = sum_of_products(&pull, &pull).sqrt();
            let inverse = one / (length + c(TINY));
            // Negative where it touches and pushes; where it also slides.
            let touches = (-p.weight).negative_then(normal - length, o);
            let slides = -(length + square * normal);
            // A slip that turns over has passed the point where the corner sticks: take that first.
            let old = self.law[j];
            let over = sum_of_products(&pull, &old.slip);
            let slides = over.negative_then(o, slides);
            let push = touches.negative_then(slides.negative_then(sliding, one), o);
            let hold = slides.negative_then(push * (one - normal * inverse), sticking);
            let hold = touches.negative_then(hold, o);
            let slip = inverse * touches.negative_then(slides.negative_then(one, o), o);
            let slip = products(&pull, &[slip; FRICTIONS]);
            let (a, b) = (&slip, &old.slip);
            let turned = [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4]];
            let turned = c(TURN) - sum_of_products(&turned, &turned);
            let more = c(CHANGE) * hold - (hold - old.hold).abs();
            changed = changed.min(turned).min(more).min(-(push - old.push).abs());
            let last = &mut s.law[j];
            last.push = touching.negative_then(push, last.push);
            last.hold = touching.negative_then(hold, last.hold);
            for i in 0..FRICTIONS {
                last.slip[i] = touching.negative_then(slip[i], last.slip[i]);
            }
            self.corner[j].load = slides.negative_then(length - normal, -normal) * push;
        }
        touching.negative_then(changed, o)
    }

    /// Takes the laws found into the equations, of robots for which `changed` is below zero: what the others have
    /// solved stays theirs, bit for bit, however often their neighbours solve again.
    #[inline(always)]
    pub fn adopt(&mut self, s: &LegState<F>, changed: F) {
        for j in 0..CORNERS {
            let (law, found) = (&mut self.law[j], &s.law[j]);
            law.push = changed.negative_then(found.push, law.push);
            law.hold = changed.negative_then(found.hold, law.hold);
            for i in 0..FRICTIONS {
                law.slip[i] = changed.negative_then(found.slip[i], law.slip[i]);
            }
        }
    }

    /// Ends the step: hinges and tangential strain move on. Returns energy lost in the hinges and given to the floor, J.
    #[inline(always)]
    pub fn finish(
        &self,
        m: &LegModel<F>,
        s: &mut LegState<F>,
        x: Spatial<F>,
        h: F,
        touching: F,
    ) -> (F, F) {
        let half = h * F::splat(0.5);
        let mut lost = F::splat(0.0);
        for j in 0..6 {
            let old = s.speed[j];
            let mean = old + half * s.acceleration[j];
            s.speed[j] = old + h * s.acceleration[j];
            s.angle[j] += h * mean;
            lost += m.damping[j] * mean * mean;
        }
        let mut given = F::splat(0.0);
        s.force = Vec3::zero();
        if touching.any_negative() {
            let wrench = self.contact.apply(x) + self.contact_bias;
            given = wrench.dot(self.velocity + x.scale(half));
            s.force = -wrench.linear;
        }
        self.strain(m, s, x, h);
        (lost * h, given * h)
    }

    /// Moments about world axes and forces needed to ask where the tip and foot are: the foot's centre and
    /// axes (columns, half extents) from the body's origin.
    #[inline(always)]
    pub fn foot(&self, m: &LegModel<F>) -> (Vec3<F>, Mat3<F>) {
        let frame = &self.frame[2];
        (self.point[2] + frame.apply(m.foot_center), frame.product(&m.foot_half))
    }

    /// Updates each corner's time of rest and tangential strain.
    #[inline(always)]
    fn strain(&self, m: &LegModel<F>, s: &mut LegState<F>, x: Spatial<F>, h: F) {
        let c = F::splat;
        let (o, one) = (c(0.0), c(1.0));
        let c4 = &self.corner;
        let carried = (c4[0].load + c4[1].load) + (c4[2].load + c4[3].load);
        for j in 0..CORNERS {
            let p = &self.corner[j];
            let a = x.linear + x.angular.cross(p.at);
            let v = [p.slide[0] + self.half * a.0[0], p.slide[1] + self.half * a.0[1]];
            let square = v[0] * v[0] + v[1] * v[1];
            let standing = c(REST_TIME) - s.rest[j];
            let limit = standing.negative_then(c(SLIDE_SPEED), c(REST_SPEED));
            let slow = square - limit * limit;
            // A corner that lifts while the foot stands keeps its rest.
            let rest = (-carried).negative_then(slow.negative_then(s.rest[j] + h, o), o);
            s.rest[j] = rest;
            let strain =
                [s.tangential_strain[j][0] + h * v[0], s.tangential_strain[j][1] + h * v[1]];
            let length = (strain[0] * strain[0] + strain[1] * strain[1]).sqrt();
            let most = m.foot.friction[0] * p.load / (p.stiffness + c(TINY));
            let keep = one.min(most / (length + c(TINY)));
            let keep = (c(REST_TIME) - rest).negative_then(keep, o);
            s.tangential_strain[j] = [strain[0] * keep, strain[1] * keep];
        }
    }

    /// Returns the inertia and velocity of each segment, given the body's velocity.
    pub fn parts(&self, s: &LegState<F>, body: Spatial<F>) -> [(RigidInertia<F>, Spatial<F>); 3] {
        let mut v = body;
        core::array::from_fn(|k| {
            v += self.axis[2 * k].scale(s.speed[2 * k]);
            v += self.axis[2 * k + 1].scale(s.speed[2 * k + 1]);
            (self.inertia[k], v)
        })
    }
}
