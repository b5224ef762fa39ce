//! The body, its base joint and the two rotors.

use super::lane::sin_cos;
use super::spatial::{Articulated, Mat3, RigidInertia, Spatial, Sym3, Vec3, solve6};
use super::{Diverged, Mechanics, Part};
use crate::model::{Base, GRAVITY, ModelError, RobotModel};

type Vector = Vec3<f64>;
type Motion = Spatial<f64>;

/// Speeds beyond this are no motion of this robot: m/s for the body, 100 rad/s of it for turning parts.
const SPEED_LIMIT: f64 = 100.0;
/// A rotor faster than this, rad/s (1600 Hz), has left every sensible bound.
const ROTOR_SPEED_LIMIT: f64 = 1e4;

/// What turns the rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// The torques given to [`Mechanics::step`].
    Torque,
    /// Kinematically ideal: frequency in Hz and direction in rad in the paper's sense (positive: top rotor
    /// clockwise from above; to the right). The reaction on the body is exact, torques given are ignored.
    Ideal {
        /// Shaking frequency, Hz.
        frequency_hz: f64,
        /// Direction of the line of force, rad, positive to the right.
        theta_rad: f64,
    },
}

/// Force and couple.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// N.
    pub force: [f64; 3],
    /// N m.
    pub torque: [f64; 3],
}

/// Pose and velocity of the body's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// World position, m.
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z from body to world.
    pub orientation: [f64; 4],
    /// World velocity, m/s.
    pub velocity: [f64; 3],
    /// World angular velocity, rad/s.
    pub angular_velocity: [f64; 3],
}

impl BodyState {
    /// Heading about world z, rad, positive to the left, -pi to pi.
    pub fn yaw(&self) -> f64 {
        let [w, x, y, z] = self.orientation;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }
}

/// Where the energy is and where it went, J since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Kinetic, of everything that moves.
    pub kinetic: f64,
    /// Of height and of bent hinges.
    pub potential: f64,
    /// Brought in by the motors' torques on the rotors, relative to the body.
    pub motor_work: f64,
    /// Brought in by pushes.
    pub push_work: f64,
    /// Lost in the planar base's damping.
    pub base_loss: f64,
    /// Lost in the legs' hinges.
    pub leg_loss: f64,
    /// Given to the floor: lost in impact and friction, or stored in the compressed contact.
    pub contact_loss: f64,
}

#[derive(Clone, Copy, Debug)]
struct Rotor {
    /// Height above the origin, m.
    height: f64,
    /// Angle within a turn, rad.
    angle: f64,
    turns: f64,
    speed: f64,
    acceleration: f64,
}

impl Rotor {
    fn advance(&mut self, angle: f64) {
        use core::f64::consts::{PI, TAU};
        self.angle += angle;
        if self.angle > PI {
            self.angle -= TAU;
            self.turns += 1.0;
        } else if self.angle < -PI {
            self.angle += TAU;
            self.turns -= 1.0;
        }
    }
}

/// A rotor inside one step: what is left to do once the body's acceleration is known.
#[derive(Clone, Copy, Debug)]
struct RotorStep {
    axis: Motion,
    inertia: RigidInertia<f64>,
    bias: Motion,
    /// `I S`, and `S' I S`.
    reach: Motion,
    pivot: f64,
    drive: f64,
}

/// One robot, or a shaker on a stand.
#[derive(Clone, Debug)]
pub struct Plant {
    base: Base,
    /// Everything fixed to the body, about the origin in body axes.
    inertia: RigidInertia<f64>,
    rotor_mass: f64,
    rotor_arm: f64,
    bell_inertia: f64,
    shaker_height: f64,

    time: f64,
    drive: Drive,
    position: Vector,
    orientation: [f64; 4],
    velocity: Motion,
    acceleration: Motion,
    rotors: [Rotor; 2],
    push: Wrench,
    shaker: Wrench,
    motor_torque: [f64; 2],
    energy: Energy,
}

impl Plant {
    /// A plant at rest at the origin (legs straight, soles on the floor), rotors forward.
    ///
    /// # Errors
    /// If the model is refused ([`RobotModel::check`]).
    pub fn new(model: &RobotModel) -> Result<Self, ModelError> {
        model.check()?;
        let shaker = &model.shaker;
        let rotor = |sign: f64| Rotor {
            height: 1e-3 * (shaker.z_mm + sign * 0.5 * shaker.spacing_mm),
            angle: 0.0,
            turns: 0.0,
            speed: 0.0,
            acceleration: 0.0,
        };
        Ok(Plant {
            base: model.base,
            inertia: body_inertia(model),
            rotor_mass: 1e-3 * shaker.mass_g,
            rotor_arm: 1e-3 * shaker.arm_mm,
            bell_inertia: 1e-7 * shaker.bell_inertia_g_cm2,
            shaker_height: 1e-3 * shaker.z_mm,
            time: 0.0,
            drive: Drive::Torque,
            position: Vector::zero(),
            orientation: [1.0, 0.0, 0.0, 0.0],
            velocity: Motion::zero(),
            acceleration: Motion::zero(),
            rotors: [rotor(1.0), rotor(-1.0)],
            push: Wrench::default(),
            shaker: Wrench::default(),
            motor_torque: [0.0; 2],
            energy: Energy::default(),
        })
    }

    /// Chooses what turns the rotors. An ideal drive puts them at once where `theta` says, at speed; phase
    /// runs on if it was ideal before.
    pub fn set_drive(&mut self, drive: Drive) {
        if let Drive::Ideal { frequency_hz, theta_rad } = drive {
            let mean = -theta_rad;
            let phase = match self.drive {
                Drive::Ideal { .. } => {
                    let [top, bottom] = self.rotor_angle();
                    0.5 * (top - bottom)
                }
                Drive::Torque => 0.0,
            };
            let speed = -core::f64::consts::TAU * frequency_hz;
            for (rotor, sign) in self.rotors.iter_mut().zip([1.0, -1.0]) {
                rotor.angle = 0.0;
                rotor.turns = 0.0;
                let turns = ((mean + sign * phase) / core::f64::consts::TAU).round();
                rotor.turns = turns;
                rotor.angle = mean + sign * phase - turns * core::f64::consts::TAU;
                rotor.speed = sign * speed;
                rotor.acceleration = 0.0;
            }
        }
        self.drive = drive;
    }

    /// Simulated time, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Pose and velocity of the body.
    pub fn body(&self) -> BodyState {
        BodyState {
            position: self.position.0,
            orientation: self.orientation,
            velocity: self.velocity.linear.0,
            angular_velocity: self.velocity.angular.0,
        }
    }

    /// A force and a couple on the body at its origin, world axes, until changed.
    pub fn set_push(&mut self, push: Wrench) {
        self.push = push;
    }

    /// Puts the body elsewhere: an offset in world x and y (m) and a turn to the left (rad) about the
    /// vertical through its origin. Velocities turn with it.
    pub fn displace(&mut self, x: f64, y: f64, turn: f64) {
        self.position += Vec3([x, y, 0.0]);
        let (s, c) = sin_cos(0.5 * turn);
        self.orientation = multiply([c, 0.0, 0.0, s], self.orientation);
        let r = rotation([c, 0.0, 0.0, s]);
        self.velocity = Spatial::new(r.apply(self.velocity.angular), r.apply(self.velocity.linear));
    }

    /// Force (without weight) and torque (with the masses' weight, about the shaker's middle) of the
    /// rotors on the body, body axes, in the middle of the last step: the paper's Eq. 3 and 4 when the base
    /// stands still.
    pub fn shaker_wrench(&self) -> Wrench {
        self.shaker
    }

    /// Motor torques of the last step, N m: those given, or those that the ideal drive needed.
    pub fn motor_torque(&self) -> [f64; 2] {
        self.motor_torque
    }

    /// Where the energy is and went.
    pub fn energy(&self) -> Energy {
        self.energy
    }

    /// Body inertia, rotor contributions and pushes, reduced to the body's six equations.
    fn rotor_step(
        &self,
        index: usize,
        r: &Mat3<f64>,
        velocity: Motion,
        bias: Motion,
        torque: f64,
        h: f64,
    ) -> RotorStep {
        let rotor = &self.rotors[index];
        let speed = rotor.speed + 0.5 * h * rotor.acceleration;
        let (s, c) = sin_cos(rotor.angle + 0.5 * h * rotor.speed);
        let up = r.column(2);
        let position = r.apply(Vec3([self.rotor_arm * c, self.rotor_arm * s, rotor.height]));
        let axis = Spatial::rotation_about(up, Vec3::zero());
        let inertia =
            RigidInertia::new(self.rotor_mass, position, Sym3::outer(up, self.bell_inertia));
        let spin = axis.scale(speed);
        let moving = velocity + spin;
        let bias = inertia.apply(bias + velocity.cross_motion(spin))
            + moving.cross_force(inertia.apply(moving));
        let reach = inertia.apply(axis);
        let pivot = axis.dot(reach);
        RotorStep { axis, inertia, bias, reach, pivot, drive: torque - axis.dot(bias) }
    }

    fn advance(&mut self, torque: [f64; 2], h: f64) {
        let half = 0.5 * h;
        let old = self.velocity;
        let middle = turned(self.orientation, old.angular, half);
        let r = rotation(middle);
        let velocity = old + self.acceleration.scale(half);
        // Acceleration of every part for x = 0: weight, and the origin's own convective part.
        let bias = Spatial::new(
            Vector::zero(),
            Vec3([0.0, 0.0, GRAVITY]) - velocity.angular.cross(velocity.linear),
        );
        let own = RigidInertia {
            mass: self.inertia.mass,
            moment: r.apply(self.inertia.moment),
            inertia: self.inertia.inertia.rotated(&r),
        };
        let mut matrix = own.articulated();
        let mut rest = own.apply(bias) + velocity.cross_force(own.apply(velocity));

        let steps = [
            self.rotor_step(0, &r, velocity, bias, torque[0], h),
            self.rotor_step(1, &r, velocity, bias, torque[1], h),
        ];
        let ideal = matches!(self.drive, Drive::Ideal { .. });
        for s in &steps {
            matrix = matrix + s.inertia.articulated();
            rest += s.bias;
            if !ideal {
                let w = s.reach.scale(1.0 / s.pivot);
                matrix = matrix.without(s.reach, w);
                rest += w.scale(s.drive);
            }
        }
        let force = Spatial::new(Vec3(self.push.torque), Vec3(self.push.force)) - rest;
        let x = self.solve_base(&matrix, force, h);

        let new = old + x.scale(h);
        let mut shaker = Motion::zero();
        for (i, s) in steps.iter().enumerate() {
            let (acceleration, used) = if ideal {
                (0.0, s.axis.dot(s.inertia.apply(x) + s.bias))
            } else {
                ((s.drive - s.reach.dot(x)) / s.pivot, torque[i])
            };
            let total = x + s.axis.scale(acceleration);
            shaker = shaker - (s.inertia.apply(total) + s.bias);
            let rotor = &mut self.rotors[i];
            let mean = rotor.speed + half * acceleration;
            rotor.speed += h * acceleration;
            rotor.acceleration = acceleration;
            rotor.advance(h * mean);
            self.motor_torque[i] = used;
            self.energy.motor_work += h * used * mean;
        }
        self.record_shaker(&r, shaker);
        self.acceleration = x;
        self.velocity = new;
        self.position += (old.linear + new.linear).scale(half);
        self.orientation = turned(middle, new.angular, half);
        self.time += h;
        let mean = old + x.scale(half);
        self.energy.push_work +=
            h * (Vec3(self.push.force).dot(mean.linear) + Vec3(self.push.torque).dot(mean.angular));
        if let Base::Planar { damping_n_s_m, yaw_damping_n_m_s } = self.base {
            self.energy.base_loss += h
                * (damping_n_s_m * mean.linear.dot(mean.linear)
                    + yaw_damping_n_m_s * mean.angular.dot(mean.angular));
        }
    }

    /// The body's acceleration under `force`, as its base joint allows.
    fn solve_base(&self, matrix: &Articulated<f64>, force: Motion, h: f64) -> Motion {
        let mut a = matrix.matrix();
        let mut b: [f64; 6] = core::array::from_fn(|i| force.component(i));
        let free = match self.base {
            Base::Fixed => return Motion::zero(),
            Base::Free => [true; 6],
            Base::Planar { damping_n_s_m, yaw_damping_n_m_s } => {
                for (i, c) in [(2, yaw_damping_n_m_s), (3, damping_n_s_m), (4, damping_n_s_m)] {
                    a[i][i] += 0.5 * h * c;
                    b[i] -= c * self.velocity.component(i);
                }
                [false, false, true, true, true, false]
            }
        };
        for i in 0..6 {
            if !free[i] {
                for j in 0..6 {
                    a[i][j] = 0.0;
                    a[j][i] = 0.0;
                }
                a[i][i] = 1.0;
                b[i] = 0.0;
            }
        }
        let x = solve6(&a, b);
        Spatial::new(Vec3([x[0], x[1], x[2]]), Vec3([x[3], x[4], x[5]]))
    }

    fn record_shaker(&mut self, r: &Mat3<f64>, wrench: Motion) {
        let weight = Vec3([0.0, 0.0, 2.0 * self.rotor_mass * GRAVITY]);
        let center = r.column(2).scale(self.shaker_height);
        self.shaker = Wrench {
            force: r.apply_transposed(wrench.linear + weight).0,
            torque: r.apply_transposed(wrench.angular - center.cross(wrench.linear)).0,
        };
    }

    fn diverged(&self) -> Option<Part> {
        let bad = |v: f64, limit: f64| !(v.abs() <= limit);
        if self.velocity.linear.0.iter().any(|v| bad(*v, SPEED_LIMIT))
            || self.velocity.angular.0.iter().any(|v| bad(*v, 100.0 * SPEED_LIMIT))
        {
            return Some(Part::Body);
        }
        (0..2).find(|i| bad(self.rotors[*i].speed, ROTOR_SPEED_LIMIT)).map(Part::Rotor)
    }
}

impl Mechanics for Plant {
    fn step(&mut self, motor_torque: [f64; 2], dt: f64) -> Result<(), Diverged> {
        self.advance(motor_torque, dt);
        match self.diverged() {
            None => Ok(()),
            Some(part) => Err(Diverged { time: self.time, part }),
        }
    }
    fn rotor_angle(&self) -> [f64; 2] {
        self.rotors.map(|r| r.angle + core::f64::consts::TAU * r.turns)
    }
    fn rotor_speed(&self) -> [f64; 2] {
        self.rotors.map(|r| r.speed)
    }
    fn shaker_force(&self) -> [f64; 3] {
        self.shaker.force
    }
}

/// Plate, battery, electronics, core and loads about the origin.
fn body_inertia(model: &RobotModel) -> RigidInertia<f64> {
    let block = |mass_g: f64, at_mm: [f64; 3], size_mm: [f64; 3]| {
        let mass = 1e-3 * mass_g;
        let [a, b, c] = size_mm.map(|s| 1e-6 * s * s);
        let k = mass / 12.0;
        RigidInertia::new(
            mass,
            Vec3(at_mm.map(|v| 1e-3 * v)),
            Sym3([k * (b + c), 0.0, 0.0, k * (a + c), 0.0, k * (a + b)]),
        )
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

/// Hamilton product.
#[inline(always)]
pub(super) fn multiply(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        (a[0] * b[0] - a[1] * b[1]) - (a[2] * b[2] + a[3] * b[3]),
        (a[0] * b[1] + a[1] * b[0]) + (a[2] * b[3] - a[3] * b[2]),
        (a[0] * b[2] + a[2] * b[0]) + (a[3] * b[1] - a[1] * b[3]),
        (a[0] * b[3] + a[3] * b[0]) + (a[1] * b[2] - a[2] * b[1]),
    ]
}

/// `q` turned by the world rotation `w t` (Cayley's form, exact to third order in `w t`), of unit length.
#[inline(always)]
pub(super) fn turned(q: [f64; 4], w: Vector, t: f64) -> [f64; 4] {
    let v = w.scale(0.5 * t);
    let q = multiply([1.0, v.0[0], v.0[1], v.0[2]], q);
    let n = 1.0 / ((q[0] * q[0] + q[3] * q[3]) + (q[1] * q[1] + q[2] * q[2])).sqrt();
    q.map(|c| c * n)
}

/// Rotation matrix of a unit quaternion.
#[inline(always)]
pub(super) fn rotation(q: [f64; 4]) -> Mat3<f64> {
    let [w, x, y, z] = q;
    Mat3([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(name: &str) -> Plant {
        Plant::new(&RobotModel::named(name).unwrap()).unwrap()
    }

    fn amplitude(f: f64, theta_deg: f64) -> (f64, f64, f64) {
        let mut p = plant("bench-fixed");
        let theta = theta_deg.to_radians();
        p.set_drive(Drive::Ideal { frequency_hz: f, theta_rad: theta });
        let (mut along, mut across, mut yaw) = (0.0f64, 0.0f64, 0.0f64);
        for _ in 0..10_000 {
            p.step([0.0; 2], 1e-5).unwrap();
            let [x, y, _] = p.shaker_force();
            // To the right is -y.
            along = along.max((x * theta.cos() - y * theta.sin()).abs());
            across = across.max((x * theta.sin() + y * theta.cos()).abs());
            yaw = yaw.max(p.shaker_wrench().torque[2].abs());
        }
        (along, across, yaw)
    }

    #[test]
    fn the_shaker_on_a_stand_gives_the_papers_force_along_theta_and_none_across() {
        for (f, force) in [(10.0, 2.653), (-20.0, 10.612), (30.0, 23.877), (-35.0, 32.499)] {
            for theta in [-60.0, 0.0, 30.0, 90.0] {
                let (along, across, yaw) = amplitude(f, theta);
                assert!((along / force - 1.0).abs() < 1e-3, "{f} {theta}: {along}");
                assert!(across < 1e-3 * force && yaw < 1e-3 * force * 0.028);
            }
        }
    }

    #[test]
    fn torque_on_a_rotor_turns_a_floating_body_the_other_way_and_conserves_angular_momentum() {
        let mut model = RobotModel::named("bench-planar").unwrap();
        model.base = Base::Planar { damping_n_s_m: 0.0, yaw_damping_n_m_s: 0.0 };
        let mut p = Plant::new(&model).unwrap();
        for _ in 0..20_000 {
            p.step([1e-3, 0.0], 1e-5).unwrap();
        }
        assert!(p.rotor_speed()[0] > 1.0 && p.body().angular_velocity[2] < 0.0);
        // Momentum of the whole in the plane stays nil: the body moves against the rotors.
        let (e, w) = (p.energy(), p.rotor_speed());
        assert!(e.motor_work > 0.0, "{e:?} {w:?}");
    }
}
