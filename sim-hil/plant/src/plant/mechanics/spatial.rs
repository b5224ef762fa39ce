//! Small vectors, matrices and spatial (six-dimensional) algebra over [`Lane`].
//!
//! Spatial vectors follow Featherstone, *Rigid Body Dynamics Algorithms* (2008): angular part first, all
//! expressed in world axes about one common point, the body's origin, so that no transform between links
//! is ever needed.

use core::ops::{Add, AddAssign, Neg, Sub, SubAssign};

use super::lane::Lane;

/// A vector of three.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec3<F>(pub [F; 3]);

impl<F: Lane> Vec3<F> {
    /// Builds from components.
    #[inline(always)]
    pub fn new(x: F, y: F, z: F) -> Self {
        Vec3([x, y, z])
    }
    /// Creates the same vector in every lane.
    #[inline(always)]
    pub fn splat(v: [f64; 3]) -> Self {
        Vec3([F::splat(v[0]), F::splat(v[1]), F::splat(v[2])])
    }
    /// Creates zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::splat([0.0; 3])
    }
    /// Returns the scalar product.
    #[inline(always)]
    pub fn dot(self, o: Self) -> F {
        let (a, b) = (self.0, o.0);
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }
    /// Returns the vector product.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        let (a, b) = (self.0, o.0);
        Vec3([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    }
    /// Times a number.
    #[inline(always)]
    pub fn scale(self, s: F) -> Self {
        Vec3([self.0[0] * s, self.0[1] * s, self.0[2] * s])
    }
    /// Returns one lane as plain numbers.
    #[inline(always)]
    pub fn lane(self, lane: usize) -> [f64; 3] {
        [self.0[0].lane(lane), self.0[1].lane(lane), self.0[2].lane(lane)]
    }
}

macro_rules! vec3_elementwise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl<F: Lane> $trait for Vec3<F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                let (a, b) = (self.0, o.0);
                Vec3([a[0] $op b[0], a[1] $op b[1], a[2] $op b[2]])
            }
        }
    };
}
vec3_elementwise!(Add, add, +);
vec3_elementwise!(Sub, sub, -);

impl<F: Lane> Neg for Vec3<F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Vec3([-self.0[0], -self.0[1], -self.0[2]])
    }
}
impl<F: Lane> AddAssign for Vec3<F> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<F: Lane> SubAssign for Vec3<F> {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

/// Numbers of the body as numbers of legs, and back.
///
/// A single robot has its body in one number and its four legs in four lanes; several robots have theirs in the lanes
/// of both.
pub trait Spread<L: Lane>: Lane {
    /// The same for every leg.
    fn spread(self) -> L;
    /// The sum over the legs: front pair plus rear pair, so that a mirrored robot adds the same numbers.
    fn gather<const GROUPS: usize>(legs: [L; GROUPS]) -> Self;
    /// The least of the legs.
    fn least<const GROUPS: usize>(legs: [L; GROUPS]) -> Self;
}

impl<B: Lane> Spread<B> for B {
    #[inline(always)]
    fn spread(self) -> B {
        self
    }
    #[inline(always)]
    fn gather<const GROUPS: usize>(legs: [B; GROUPS]) -> B {
        (legs[0] + legs[1]) + (legs[2] + legs[3])
    }
    #[inline(always)]
    fn least<const GROUPS: usize>(legs: [B; GROUPS]) -> B {
        legs[0].min(legs[1]).min(legs[2].min(legs[3]))
    }
}

impl Spread<super::lane::Quad> for f64 {
    #[inline(always)]
    fn spread(self) -> super::lane::Quad {
        super::lane::Quad([self; 4])
    }
    #[inline(always)]
    fn gather<const GROUPS: usize>(legs: [super::lane::Quad; GROUPS]) -> Self {
        let [fl, fr, rl, rr] = legs[0].0;
        (fl + fr) + (rl + rr)
    }
    #[inline(always)]
    fn least<const GROUPS: usize>(legs: [super::lane::Quad; GROUPS]) -> Self {
        let [fl, fr, rl, rr] = legs[0].0;
        fl.min(fr).min(rl.min(rr))
    }
}

impl<F: Lane> Vec3<F> {
    /// Copies the vector to every leg.
    #[inline(always)]
    pub fn spread<L: Lane>(self) -> Vec3<L>
    where
        F: Spread<L>,
    {
        Vec3([self.0[0].spread(), self.0[1].spread(), self.0[2].spread()])
    }
}

impl<F: Lane> Spatial<F> {
    /// Copies the vector to every leg.
    #[inline(always)]
    pub fn spread<L: Lane>(self) -> Spatial<L>
    where
        F: Spread<L>,
    {
        Spatial::new(self.angular.spread(), self.linear.spread())
    }
    /// Sums over the legs.
    #[inline(always)]
    pub fn gather<L: Lane, const G: usize>(legs: &[Spatial<L>; G]) -> Self
    where
        F: Spread<L>,
    {
        let mut sum = Self::zero();
        for i in 0..3 {
            let mut angular = [L::splat(0.0); G];
            let mut linear = [L::splat(0.0); G];
            for g in 0..G {
                angular[g] = legs[g].angular.0[i];
                linear[g] = legs[g].linear.0[i];
            }
            sum.angular.0[i] = F::gather(angular);
            sum.linear.0[i] = F::gather(linear);
        }
        sum
    }
}

impl<F: Lane> Mat3<F> {
    /// Copies the matrix to every leg.
    #[inline(always)]
    pub fn spread<L: Lane>(&self) -> Mat3<L>
    where
        F: Spread<L>,
    {
        Mat3([Vec3(self.0[0]).spread().0, Vec3(self.0[1]).spread().0, Vec3(self.0[2]).spread().0])
    }
}

impl<F: Lane> Articulated<F> {
    /// Sums over the legs.
    #[inline(always)]
    pub fn gather<L: Lane, const G: usize>(legs: &[Articulated<L>; G]) -> Self
    where
        F: Spread<L>,
    {
        let mut sum = Self::zero();
        for i in 0..6 {
            let mut angular = [L::splat(0.0); G];
            let mut linear = [L::splat(0.0); G];
            for g in 0..G {
                angular[g] = legs[g].angular.0[i];
                linear[g] = legs[g].linear.0[i];
            }
            sum.angular.0[i] = F::gather(angular);
            sum.linear.0[i] = F::gather(linear);
        }
        for i in 0..3 {
            for j in 0..3 {
                let mut coupling = [L::splat(0.0); G];
                for g in 0..G {
                    coupling[g] = legs[g].coupling.0[i][j];
                }
                sum.coupling.0[i][j] = F::gather(coupling);
            }
        }
        sum
    }
}

/// A 3 x 3 matrix, `self.0[row][column]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat3<F>(pub [[F; 3]; 3]);

impl<F: Lane> Mat3<F> {
    /// Creates zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Mat3([[F::splat(0.0); 3]; 3])
    }
    /// Creates the same matrix in every lane.
    #[inline(always)]
    pub fn splat(m: [[f64; 3]; 3]) -> Self {
        Mat3([Vec3::splat(m[0]).0, Vec3::splat(m[1]).0, Vec3::splat(m[2]).0])
    }
    /// Builds from the three columns.
    #[inline(always)]
    pub fn from_columns(x: Vec3<F>, y: Vec3<F>, z: Vec3<F>) -> Self {
        Mat3([[x.0[0], y.0[0], z.0[0]], [x.0[1], y.0[1], z.0[1]], [x.0[2], y.0[2], z.0[2]]])
    }
    /// Returns a column.
    #[inline(always)]
    pub fn column(&self, j: usize) -> Vec3<F> {
        Vec3([self.0[0][j], self.0[1][j], self.0[2][j]])
    }
    /// Multiplies by a vector.
    #[inline(always)]
    pub fn apply(&self, v: Vec3<F>) -> Vec3<F> {
        Vec3([Vec3(self.0[0]).dot(v), Vec3(self.0[1]).dot(v), Vec3(self.0[2]).dot(v)])
    }
    /// Multiplies the transposed matrix by a vector.
    #[inline(always)]
    pub fn apply_transposed(&self, v: Vec3<F>) -> Vec3<F> {
        Vec3([self.column(0).dot(v), self.column(1).dot(v), self.column(2).dot(v)])
    }
    /// Multiplies by a matrix.
    #[inline(always)]
    pub fn product(&self, o: &Self) -> Self {
        Self::from_columns(
            self.apply(o.column(0)),
            self.apply(o.column(1)),
            self.apply(o.column(2)),
        )
    }
}

impl<F: Lane> Add for Mat3<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        let (a, b) = (self.0, o.0);
        Mat3([
            (Vec3(a[0]) + Vec3(b[0])).0,
            (Vec3(a[1]) + Vec3(b[1])).0,
            (Vec3(a[2]) + Vec3(b[2])).0,
        ])
    }
}

/// A symmetric 3 x 3 matrix: xx, xy, xz, yy, yz, zz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sym3<F>(pub [F; 6]);

impl<F: Lane> Sym3<F> {
    /// Creates zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Sym3([F::splat(0.0); 6])
    }
    /// Creates `d` times the unit matrix.
    #[inline(always)]
    pub fn diagonal(d: F) -> Self {
        let o = F::splat(0.0);
        Sym3([d, o, o, d, o, d])
    }
    /// Creates `s * a a^T`.
    #[inline(always)]
    pub fn outer(a: Vec3<F>, s: F) -> Self {
        let t = a.scale(s);
        Sym3([
            a.0[0] * t.0[0],
            a.0[0] * t.0[1],
            a.0[0] * t.0[2],
            a.0[1] * t.0[1],
            a.0[1] * t.0[2],
            a.0[2] * t.0[2],
        ])
    }
    /// Creates the inertia of a thin disc or ring with `axial` about the unit vector `axis`: half of it about any other.
    #[inline(always)]
    pub fn disc(axis: Vec3<F>, axial: F) -> Self {
        let half = axial * F::splat(0.5);
        Self::diagonal(half) + Self::outer(axis, half)
    }
    /// Creates the inertia of a point mass `m` at `r` about the origin: `m (r.r 1 - r r^T)`.
    #[inline(always)]
    pub fn point_mass(m: F, r: Vec3<F>) -> Self {
        let s = r.scale(m);
        let (xx, yy, zz) = (r.0[0] * s.0[0], r.0[1] * s.0[1], r.0[2] * s.0[2]);
        Sym3([
            yy + zz,
            -(r.0[0] * s.0[1]),
            -(r.0[0] * s.0[2]),
            xx + zz,
            -(r.0[1] * s.0[2]),
            xx + yy,
        ])
    }
    /// Creates `R diag(d) R^T`: a principal inertia turned by `R`.
    #[inline(always)]
    pub fn turned(r: &Mat3<F>, d: Vec3<F>) -> Self {
        Self::outer(r.column(0), d.0[0])
            + Self::outer(r.column(1), d.0[1])
            + Self::outer(r.column(2), d.0[2])
    }
    /// Returns `R S R^T`.
    #[inline(always)]
    pub fn rotated(&self, r: &Mat3<F>) -> Self {
        let rs = Mat3::from_columns(
            self.apply(Vec3(r.0[0])),
            self.apply(Vec3(r.0[1])),
            self.apply(Vec3(r.0[2])),
        );
        // Columns of rs are S R^T.
        let ([x, y, z], [a, b, c]) = (r.0, [rs.column(0), rs.column(1), rs.column(2)]);
        let (x, y, z) = (Vec3(x), Vec3(y), Vec3(z));
        Sym3([x.dot(a), x.dot(b), x.dot(c), y.dot(b), y.dot(c), z.dot(c)])
    }
    /// Returns `self - p q^T`, of which only the upper triangle is kept.
    #[inline(always)]
    #[must_use]
    fn less_product(&self, p: Vec3<F>, q: Vec3<F>) -> Self {
        let (s, p, q) = (self.0, p.0, q.0);
        Sym3([
            s[0] - p[0] * q[0],
            s[1] - p[0] * q[1],
            s[2] - p[0] * q[2],
            s[3] - p[1] * q[1],
            s[4] - p[1] * q[2],
            s[5] - p[2] * q[2],
        ])
    }
    /// Multiplies by a vector.
    #[inline(always)]
    pub fn apply(&self, v: Vec3<F>) -> Vec3<F> {
        let (s, v) = (self.0, v.0);
        Vec3([
            s[0] * v[0] + s[1] * v[1] + s[2] * v[2],
            s[1] * v[0] + s[3] * v[1] + s[4] * v[2],
            s[2] * v[0] + s[4] * v[1] + s[5] * v[2],
        ])
    }
}

impl<F: Lane> Add for Sym3<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        let (a, b) = (self.0, o.0);
        Sym3([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]])
    }
}
impl<F: Lane> Sub for Sym3<F> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        let (a, b) = (self.0, o.0);
        Sym3([a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5]])
    }
}

/// A spatial vector: motion (angular velocity, velocity of the point at the origin) or force (couple
/// about the origin, force).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spatial<F> {
    /// Angular part.
    pub angular: Vec3<F>,
    /// Linear part.
    pub linear: Vec3<F>,
}

impl<F: Lane> Spatial<F> {
    /// Builds from both parts.
    #[inline(always)]
    pub fn new(angular: Vec3<F>, linear: Vec3<F>) -> Self {
        Spatial { angular, linear }
    }
    /// Creates zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::new(Vec3::zero(), Vec3::zero())
    }
    /// Creates the motion of a rotation about `axis` through `point`.
    #[inline(always)]
    pub fn rotation_about(axis: Vec3<F>, point: Vec3<F>) -> Self {
        Self::new(axis, point.cross(axis))
    }
    /// Times a number.
    #[inline(always)]
    pub fn scale(self, s: F) -> Self {
        Self::new(self.angular.scale(s), self.linear.scale(s))
    }
    /// Returns the power of a force along a motion.
    #[inline(always)]
    pub fn dot(self, o: Self) -> F {
        self.angular.dot(o.angular) + self.linear.dot(o.linear)
    }
    /// Returns motion cross motion.
    #[inline(always)]
    pub fn cross_motion(self, m: Self) -> Self {
        Self::new(
            self.angular.cross(m.angular),
            self.angular.cross(m.linear) + self.linear.cross(m.angular),
        )
    }
    /// Returns motion cross force.
    #[inline(always)]
    pub fn cross_force(self, f: Self) -> Self {
        Self::new(
            self.angular.cross(f.angular) + self.linear.cross(f.linear),
            self.angular.cross(f.linear),
        )
    }
    /// Returns the component `i`, angular first.
    #[inline(always)]
    pub fn component(&self, i: usize) -> F {
        if i < 3 { self.angular.0[i] } else { self.linear.0[i - 3] }
    }
}

impl<F: Lane> Add for Spatial<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::new(self.angular + o.angular, self.linear + o.linear)
    }
}
impl<F: Lane> Sub for Spatial<F> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::new(self.angular - o.angular, self.linear - o.linear)
    }
}
impl<F: Lane> AddAssign for Spatial<F> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

/// Inertia of one rigid body about the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidInertia<F> {
    /// Mass, kg.
    pub mass: F,
    /// Mass times the position of the centre of mass, kg m.
    pub moment: Vec3<F>,
    /// Rotational inertia about the origin, kg m^2.
    pub inertia: Sym3<F>,
}

impl<F: Lane> RigidInertia<F> {
    /// Creates no inertia.
    #[inline(always)]
    pub fn zero() -> Self {
        RigidInertia { mass: F::splat(0.0), moment: Vec3::zero(), inertia: Sym3::zero() }
    }
    /// Creates the inertia of a body of `mass` at `center` with `inertia` about its centre of mass.
    #[inline(always)]
    pub fn new(mass: F, center: Vec3<F>, inertia: Sym3<F>) -> Self {
        RigidInertia {
            mass,
            moment: center.scale(mass),
            inertia: inertia + Sym3::point_mass(mass, center),
        }
    }
    /// Returns the momentum of a motion.
    #[inline(always)]
    pub fn apply(&self, v: Spatial<F>) -> Spatial<F> {
        Spatial::new(
            self.inertia.apply(v.angular) + self.moment.cross(v.linear),
            v.linear.scale(self.mass) - self.moment.cross(v.angular),
        )
    }
    /// Returns it as a full symmetric matrix.
    #[inline(always)]
    pub fn articulated(&self) -> Articulated<F> {
        let o = F::splat(0.0);
        let [x, y, z] = self.moment.0;
        Articulated {
            angular: self.inertia,
            coupling: Mat3([[o, -z, y], [z, o, -x], [-y, x, o]]),
            linear: Sym3::diagonal(self.mass),
        }
    }
}

impl<F: Lane> Add for RigidInertia<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        RigidInertia {
            mass: self.mass + o.mass,
            moment: self.moment + o.moment,
            inertia: self.inertia + o.inertia,
        }
    }
}

/// A symmetric 6 x 6 matrix that turns a motion into a force: `[[angular, coupling], [coupling^T, linear]]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Articulated<F> {
    /// Couple by angular motion.
    pub angular: Sym3<F>,
    /// Couple by linear motion.
    pub coupling: Mat3<F>,
    /// Force by linear motion.
    pub linear: Sym3<F>,
}

impl<F: Lane> Articulated<F> {
    /// Creates zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Articulated { angular: Sym3::zero(), coupling: Mat3::zero(), linear: Sym3::zero() }
    }
    /// Returns the force of a motion.
    #[inline(always)]
    pub fn apply(&self, v: Spatial<F>) -> Spatial<F> {
        Spatial::new(
            self.angular.apply(v.angular) + self.coupling.apply(v.linear),
            self.coupling.apply_transposed(v.angular) + self.linear.apply(v.linear),
        )
    }
    /// Returns `self - u u^T / d`, given `w = u / d`.
    #[inline(always)]
    #[must_use]
    pub fn without(&self, u: Spatial<F>, w: Spatial<F>) -> Self {
        let (p, q, c) = (u.angular.0, w.linear.0, self.coupling.0);
        Articulated {
            angular: self.angular.less_product(u.angular, w.angular),
            coupling: Mat3([
                [c[0][0] - p[0] * q[0], c[0][1] - p[0] * q[1], c[0][2] - p[0] * q[2]],
                [c[1][0] - p[1] * q[0], c[1][1] - p[1] * q[1], c[1][2] - p[1] * q[2]],
                [c[2][0] - p[2] * q[0], c[2][1] - p[2] * q[1], c[2][2] - p[2] * q[2]],
            ]),
            linear: self.linear.less_product(u.linear, w.linear),
        }
    }
    /// Returns the upper triangle as a full matrix, angular first.
    #[inline(always)]
    pub fn matrix(&self) -> [[F; 6]; 6] {
        let (a, c, l) = (self.angular.0, self.coupling.0, self.linear.0);
        [
            [a[0], a[1], a[2], c[0][0], c[0][1], c[0][2]],
            [a[1], a[3], a[4], c[1][0], c[1][1], c[1][2]],
            [a[2], a[4], a[5], c[2][0], c[2][1], c[2][2]],
            [c[0][0], c[1][0], c[2][0], l[0], l[1], l[2]],
            [c[0][1], c[1][1], c[2][1], l[1], l[3], l[4]],
            [c[0][2], c[1][2], c[2][2], l[2], l[4], l[5]],
        ]
    }
}

impl<F: Lane> Add for Articulated<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Articulated {
            angular: self.angular + o.angular,
            coupling: self.coupling + o.coupling,
            linear: self.linear + o.linear,
        }
    }
}

/// Solves `a x = b` for a symmetric positive definite 6 x 6 matrix, by L D L^T.
#[inline(always)]
pub fn solve6<F: Lane>(a: &[[F; 6]; 6], b: [F; 6]) -> [F; 6] {
    let mut l = *a;
    let mut inverse = [F::splat(0.0); 6];
    for j in 0..6 {
        let mut d = l[j][j];
        let mut scaled = [F::splat(0.0); 6];
        for k in 0..j {
            scaled[k] = l[j][k] * inverse[k];
            d -= l[j][k] * scaled[k];
        }
        inverse[j] = F::splat(1.0) / d;
        for i in (j + 1)..6 {
            let mut s = l[i][j];
            for k in 0..j {
                s -= l[i][k] * scaled[k];
            }
            l[i][j] = s;
        }
    }
    // l[i][j] (i > j) holds L D; column scale by 1/D gives L.
    let mut x = b;
    for i in 0..6 {
        for k in 0..i {
            x[i] -= l[i][k] * inverse[k] * x[k];
        }
    }
    for i in 0..6 {
        x[i] = x[i] * inverse[i];
    }
    for i in (0..6).rev() {
        for k in (i + 1)..6 {
            x[i] -= l[k][i] * inverse[i] * x[k];
        }
    }
    x
}
