//! One robot, its four legs computed side by side.

use core::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::SplitMix64;

use super::body::{BodyState, Wrench};
use super::build::{self, PlainState};
use super::cords::{Cords, Support};
use super::course::{Course, rotor_speeds};
use super::lane::{Lane, Quad, sin_cos};
use super::leg::{LegModel, LegStep};
use super::pack::Pack;
use super::spatial::{Mat3, RigidInertia, Spatial, Sym3, Vec3};
use super::system::{
    Constants, HINGE_LIMIT, ROTOR_SPEED_LIMIT, Rotor, SPEED_LIMIT, State, TURN_LIMIT, advance,
    multiply, rotation,
};
use crate::model::{ModelError, RobotModel};
use crate::plant::{Diverged, Mechanics, Part};

/// What turns the rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// The torques given to [`Mechanics::step`].
    Torque,
    /// Kinematically ideal: the angles are prescribed, the reaction on the body is exact, torques given
    /// are ignored. From one pair to the next the rotors follow the references of the robot's software.
    Ideal {
        /// Shaking frequency, Hz, positive when the top rotor turns clockwise seen from above.
        frequency_hz: f64,
        /// Direction of the line of force, rad, positive to the right.
        theta_rad: f64,
    },
}

/// Where the energy is and where it went, J since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Kinetic, of everything that moves.
    pub kinetic: f64,
    /// Of height (over the floor) and of bent hinges.
    pub potential: f64,
    /// Brought in by the motors' torques.
    pub motor_work: f64,
    /// Brought in by pushes on the body.
    pub push_work: f64,
    /// Lost in the planar base's damping.
    pub base_loss: f64,
    /// Lost in the legs' hinges.
    pub leg_loss: f64,
    /// Given to the floor: lost in impact and friction, or stored in the compressed contact.
    pub contact_loss: f64,
}

impl Energy {
    /// Returns what came in and is neither here nor accounted for, J: zero but for the error of the integration.
    pub fn balance(&self, start: &Energy) -> f64 {
        let now = self.kinetic + self.potential - start.kinetic - start.potential;
        let came = self.motor_work + self.push_work - start.motor_work - start.push_work;
        let went = self.base_loss + self.leg_loss + self.contact_loss
            - start.base_loss
            - start.leg_loss
            - start.contact_loss;
        came - went - now
    }
}

/// A leg to look at: world positions in m, forces in N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegView {
    /// The three hinges from the root, then the tip.
    pub joints: [[f64; 3]; 4],
    /// Axes of the three segments from the root: columns x, y (along the beam), z.
    pub axes: [[[f64; 3]; 3]; 3],
    /// Centre of the foot.
    pub foot_center: [f64; 3],
    /// Half extents of the foot as vectors: along its own x, y, z.
    pub foot_half: [[f64; 3]; 3],
    /// Hinge angles, rad: bend, twist, bend, twist, bend, twist from the root.
    pub angles: [f64; 6],
    /// Hinge speeds, rad/s.
    pub speeds: [f64; 6],
    /// Force of the floor on the foot in the last step.
    pub floor_force: [f64; 3],
    /// Velocity of the foot's centre, m/s.
    pub foot_velocity: [f64; 3],
}

/// One robot, or a shaker on a stand.
#[derive(Clone, Debug)]
pub struct Plant {
    constants: Constants<f64, Quad, 1>,
    state: State<f64, Quad, 1>,
    /// Working memory of a step.
    scratch: [LegStep<Quad>; 1],
    arch: pulp::Arch,
    drive: Drive,
    /// What an ideal drive follows.
    course: Option<Course>,
    time: f64,
    longest_step: f64,
    support: Support,
}

/// A step, compiled once for every vector unit that the machine may have.
struct Step<'a> {
    plant: &'a mut Plant,
    torque: [f64; 2],
    step: f64,
}

impl pulp::NullaryFnOnce for Step<'_> {
    type Output = ();
    #[inline(always)]
    fn call(self) {
        let p = self.plant;
        advance(&p.constants, &mut p.state, &mut p.scratch, self.torque, self.step);
    }
}

impl Plant {
    /// Builds a plant at rest at the origin, legs straight, soles on the floor, rotors forward.
    ///
    /// # Errors
    /// If the model is refused ([`RobotModel::check`]).
    pub fn new(model: &RobotModel) -> Result<Self, ModelError> {
        model.check()?;
        let plain = build::constants(model);
        let longest_step = build::longest_step(&plain);
        let constants = Constants {
            base: plain.base,
            inertia: plain.inertia,
            rotor_mass: plain.rotor_mass,
            rotor_arm: plain.rotor_arm,
            bell_inertia: plain.bell_inertia,
            rotor_height: plain.rotor_height,
            shaker_height: plain.shaker_height,
            gravity: plain.gravity,
            legs: plain.legs.map(|each| {
                let mut lanes: LegModel<Quad> = Pack::all(&each[0]);
                for (lane, leg) in each.iter().enumerate() {
                    lanes.set(lane, leg);
                }
                [lanes]
            }),
            floor: plain.floor,
            ideal: false,
        };
        Ok(Plant {
            constants,
            state: build::state(model),
            scratch: [LegStep::blank()],
            arch: pulp::Arch::new(),
            drive: Drive::Torque,
            course: None,
            time: 0.0,
            longest_step,
            support: Support::Floor,
        })
    }

    /// Takes longer steps in equal parts from now on, s; steps that are too long for the feet's contact are taken in parts anyway.
    pub fn set_longest_step(&mut self, step: f64) {
        self.longest_step = self.longest_step.min(step);
    }

    /// Chooses what turns the rotors. The first ideal drive puts them at once where `theta` says, at speed; another one is
    /// approached as the robot's software does.
    pub fn set_drive(&mut self, drive: Drive) {
        self.constants.ideal = matches!(drive, Drive::Ideal { .. });
        self.course = match (drive, self.course) {
            (Drive::Torque, _) => None,
            (Drive::Ideal { frequency_hz, theta_rad }, Some(mut course)) => {
                course.ask(frequency_hz, theta_rad);
                Some(course)
            }
            (Drive::Ideal { frequency_hz, theta_rad }, None) => {
                let phase = match self.drive {
                    Drive::Ideal { .. } => phase(&self.state.rotors),
                    Drive::Torque => 0.0,
                };
                self.state.rotors = aimed(phase, [frequency_hz, 0.0], theta_rad);
                Some(Course::new(frequency_hz, theta_rad))
            }
        };
        self.drive = drive;
    }

    pub(super) fn course(&self) -> Option<Course> {
        self.course
    }

    /// Lets ideal rotors follow their course through the next step, s.
    fn follow_course(&mut self, step: f64) {
        if let Some(course) = &mut self.course {
            self.state.rotors = course.followed(self.state.rotors, step);
        }
    }

    /// Returns what turns the rotors.
    pub fn drive(&self) -> Drive {
        self.drive
    }

    /// Turns both rotors on, against each other, by an angle of the phase: rad, positive like f.
    pub fn advance_phase(&mut self, phase: f64) {
        for (rotor, sign) in self.state.rotors.iter_mut().zip([1.0, -1.0]) {
            rotor.angle -= sign * phase;
        }
    }

    /// Hangs the robot on soft cords, this high over where it is, m, and takes the floor away; see [`Cords`].
    pub fn hang(&mut self, height: f64) {
        self.displace([0.0, 0.0, height], 0.0);
        self.set_floor(false);
        self.support = Support::Cords(Cords::holding(
            self.mass_properties(),
            &self.body(),
            self.constants.gravity.0,
        ));
    }

    /// Returns whether the robot hangs on cords.
    pub fn hangs(&self) -> bool {
        matches!(self.support, Support::Cords(_))
    }

    /// Holds the robot still, level and with straight legs, this high over where a new one stands, m, for so many
    /// seconds. Then it falls.
    pub fn hold(&mut self, stands: [f64; 3], height: f64, seconds: f64) {
        let [x, y, z] = stands;
        let s = &mut self.state;
        s.position = Vec3([x, y, z + height]);
        s.orientation = [1.0, 0.0, 0.0, 0.0];
        s.velocity = Spatial::zero();
        s.acceleration = Spatial::zero();
        if self.constants.legs.is_some() {
            (0..4).for_each(|leg| self.set_hinges(leg, [0.0; 6]));
        }
        self.support = Support::Hands { until: self.time + seconds };
    }

    /// Takes the floor away, or puts it back.
    pub fn set_floor(&mut self, floor: bool) {
        self.constants.floor = floor && self.constants.legs.is_some();
    }

    /// Returns the simulated time, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Returns the pose and velocity of the body.
    pub fn body(&self) -> BodyState {
        let s = &self.state;
        BodyState {
            position: s.position.0,
            orientation: s.orientation,
            velocity: s.velocity.linear.0,
            angular_velocity: s.velocity.angular.0,
        }
    }

    /// Applies a force and a couple to the body at its origin, world axes, until changed.
    pub fn set_push(&mut self, push: Wrench) {
        self.state.push = push.spatial();
    }

    /// Applies a force and a couple to a leg's tip (the end of its last segment), world axes, until changed.
    pub fn set_tip_push(&mut self, leg: usize, push: Wrench) {
        self.state.tip_push[0].set(leg, &push.spatial());
    }

    /// Bends a leg: its hinge angles, rad, from the root (bend, twist, bend, twist, bend, twist), at rest.
    pub fn set_hinges(&mut self, leg: usize, angles: [f64; 6]) {
        let state = &mut self.state.legs[0];
        for (j, angle) in angles.iter().enumerate() {
            state.angle[j].set(leg, angle);
            state.speed[j].set(leg, &0.0);
            state.acceleration[j].set(leg, &0.0);
        }
    }

    /// Puts the body elsewhere: an offset in the world (m), and a turn to the left (rad) about the vertical
    /// through its origin. Velocities turn with it.
    pub fn displace(&mut self, offset: [f64; 3], turn: f64) {
        let s = &mut self.state;
        s.position += Vec3(offset);
        let (sin, cos) = sin_cos(0.5 * turn);
        let q = [cos, 0.0, 0.0, sin];
        s.orientation = multiply(q, s.orientation);
        let r = rotation(q);
        s.velocity = Spatial::new(r.apply(s.velocity.angular), r.apply(s.velocity.linear));
        s.acceleration = Spatial::zero();
    }

    /// Pitches the body about its origin, rad, positive nose down; what moves keeps its velocity.
    pub fn pitch(&mut self, angle: f64) {
        let (sin, cos) = sin_cos(0.5 * angle);
        self.state.orientation = multiply([cos, 0.0, sin, 0.0], self.state.orientation);
        self.state.acceleration = Spatial::zero();
    }

    /// Disturbs the start: up to 1 mm sideways, forward and up, 5 mrad of tilt and heading, 5 mrad in every
    /// hinge, the same for the same seed. `mirrored` gives the mirror image of the same disturbance, for
    /// comparing a robot with its mirrored run.
    pub fn disturb(&mut self, seed: u64, mirrored: bool) {
        let mixed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5DEE_CE66_D1CE_4E5B;
        let mut source = SplitMix64::seed_from_u64(mixed);
        let mut random = || 2.0 * source.random::<f64>() - 1.0;
        let flip = if mirrored { -1.0 } else { 1.0 };
        let offset = [1e-3 * random(), 1e-3 * flip * random(), 0.5e-3 * (1.0 + random())];
        let (roll, pitch, yaw) = (5e-3 * flip * random(), 5e-3 * random(), 5e-3 * flip * random());
        let s = &mut self.state;
        s.position += Vec3(offset);
        let tilt = Vec3([roll, pitch, yaw]);
        s.orientation = super::system::turned(s.orientation, tilt, 1.0);
        if self.constants.legs.is_some() {
            for leg in 0..4 {
                let target = if mirrored { leg ^ 1 } else { leg };
                for j in 0..6 {
                    s.legs[0].angle[j].set(target, &(5e-3 * flip * random()));
                }
            }
        }
    }

    /// Returns the force (without weight) and torque (with the rotors' weight, about the shaker's middle) of the
    /// rotors on the body, body axes, in the middle of the last step: the paper's equations 6 and 7 when
    /// the base stands still.
    pub fn shaker_wrench(&self) -> Wrench {
        let (s, r) = (&self.state, &self.state.middle);
        let weight = self.constants.gravity.scale(-2.0 * self.constants.rotor_mass);
        let center = r.column(2).scale(self.constants.shaker_height);
        Wrench {
            force: r.apply_transposed(s.shaker.linear + weight).0,
            torque: r.apply_transposed(s.shaker.angular - center.cross(s.shaker.linear)).0,
        }
    }

    /// Returns the motor torques of the last step, N m: those given, or those that the ideal drive needed.
    pub fn motor_torque(&self) -> [f64; 2] {
        self.state.motor_torque
    }

    /// Returns the legs to look at, in the order of [`crate::model::LEGS`]; none on a bench.
    pub fn legs(&self) -> Option<[LegView; 4]> {
        let models = self.constants.legs.as_ref()?;
        Some(core::array::from_fn(|i| {
            let model = models[0].get(i);
            let state = self.state.legs[0].get(i);
            let step = self.state.still(&model, &state);
            let (center, half) = step.foot(&model);
            let world = |v: Vec3<f64>| (v + self.state.position).0;
            LegView {
                joints: step.point.map(world),
                axes: step.frame.each_ref().map(columns),
                foot_center: world(center),
                foot_half: columns(&half),
                angles: state.angle,
                speeds: state.speed,
                floor_force: state.force.0,
                foot_velocity: (step.velocity.linear + step.velocity.angular.cross(center)).0,
            }
        }))
    }

    pub(super) fn has_legs(&self) -> bool {
        self.constants.legs.is_some()
    }

    /// Constants of one leg of a robot that has legs.
    pub(super) fn leg_model(&self, leg: usize) -> LegModel<f64> {
        let legs = self.constants.legs.as_ref();
        legs.expect("only asked of a robot with legs")[0].get(leg)
    }

    /// Returns what changes, legs one after the other.
    pub(super) fn plain_state(&self) -> PlainState {
        let s = &self.state;
        State {
            position: s.position,
            orientation: s.orientation,
            velocity: s.velocity,
            acceleration: s.acceleration,
            rotors: s.rotors,
            legs: core::array::from_fn(|i| s.legs[0].get(i)),
            push: s.push,
            tip_push: core::array::from_fn(|i| s.tip_push[0].get(i)),
            shaker: s.shaker,
            middle: s.middle,
            motor_torque: s.motor_torque,
            work: s.work,
        }
    }

    /// Puts everything that changes where `plain` says, at `time` in s, under this drive.
    pub(super) fn set_plain_state(
        &mut self,
        plain: &PlainState,
        time: f64,
        drive: Drive,
        course: Option<Course>,
    ) {
        let s = &mut self.state;
        for (i, (leg, push)) in plain.legs.iter().zip(&plain.tip_push).enumerate() {
            s.legs[0].set(i, leg);
            s.tip_push[0].set(i, push);
        }
        s.position = plain.position;
        s.orientation = plain.orientation;
        s.velocity = plain.velocity;
        s.acceleration = plain.acceleration;
        s.rotors = plain.rotors;
        s.push = plain.push;
        s.shaker = plain.shaker;
        s.middle = plain.middle;
        s.motor_torque = plain.motor_torque;
        s.work = plain.work;
        self.constants.ideal = matches!(drive, Drive::Ideal { .. });
        self.drive = drive;
        self.course = course;
        self.time = time;
    }

    pub(super) fn state_mut(&mut self) -> &mut State<f64, Quad, 1> {
        &mut self.state
    }

    /// Holds the body where it is and takes the floor away.
    pub fn clamp(&mut self) {
        self.constants.base = super::system::BaseJoint::Fixed;
        self.constants.floor = false;
        self.state.velocity = Spatial::zero();
        self.state.acceleration = Spatial::zero();
    }

    /// Returns everything that moves, about the body's origin in world axes, with the velocity of each part.
    pub(super) fn parts(&self) -> Vec<(RigidInertia<f64>, Spatial<f64>)> {
        let (c, s) = (&self.constants, &self.state);
        let r = rotation(s.orientation);
        let mut parts = vec![(
            RigidInertia {
                mass: c.inertia.mass,
                moment: r.apply(c.inertia.moment),
                inertia: c.inertia.inertia.rotated(&r),
            },
            s.velocity,
        )];
        let up = r.column(2);
        for (rotor, height) in s.rotors.iter().zip(c.rotor_height) {
            let (sin, cos) = sin_cos(rotor.angle);
            let at = r.apply(Vec3([c.rotor_arm * cos, c.rotor_arm * sin, height]));
            let spin = Spatial::rotation_about(up, Vec3::zero()).scale(rotor.speed);
            let inertia = RigidInertia::new(c.rotor_mass, at, Sym3::disc(up, c.bell_inertia));
            parts.push((inertia, s.velocity + spin));
        }
        if let Some(models) = &c.legs {
            for i in 0..4 {
                let (model, state) = (models[0].get(i), s.legs[0].get(i));
                parts.extend(s.still(&model, &state).parts(&state, s.velocity));
            }
        }
        parts
    }

    /// Mass (kg), centre of mass (world, m) and inertia about it (kg m^2, world axes: xx, xy, xz, yy, yz,
    /// zz) of the whole robot as it stands.
    pub fn mass_properties(&self) -> (f64, [f64; 3], [f64; 6]) {
        let sum = self.parts().iter().fold(RigidInertia::zero(), |sum, part| sum + part.0);
        let center = sum.moment.scale(1.0 / sum.mass);
        let about = sum.inertia - Sym3::point_mass(sum.mass, center);
        (sum.mass, (center + self.state.position).0, about.0)
    }

    /// Returns where the energy is and went.
    pub fn energy(&self) -> Energy {
        let s = &self.state;
        let (mut kinetic, mut potential) = (0.0, 0.0);
        for (inertia, velocity) in self.parts() {
            kinetic += 0.5 * velocity.dot(inertia.apply(velocity));
            let moment = inertia.moment + s.position.scale(inertia.mass);
            potential -= self.constants.gravity.dot(moment);
        }
        if let Some(models) = &self.constants.legs {
            for i in 0..4 {
                let (model, state) = (models[0].get(i), s.legs[0].get(i));
                for j in 0..6 {
                    potential += 0.5 * model.stiffness[j] * state.angle[j] * state.angle[j];
                }
            }
        }
        let [motor_work, push_work, base_loss, leg_loss, contact_loss] = s.work;
        Energy { kinetic, potential, motor_work, push_work, base_loss, leg_loss, contact_loss }
    }

    fn diverged(&self) -> Option<Part> {
        let s = &self.state;
        if !s.sane().any_negative() {
            return None;
        }
        let bent = s.legs[0].bent();
        stray(&s.velocity, self.rotor_speed(), core::array::from_fn(|i| bent.lane(i)))
    }
}

/// Returns the angle of an ideal drive's rotors about their mean, rad.
pub(super) fn phase(rotors: &[Rotor<f64>; 2]) -> f64 {
    let [top, bottom] = rotors.map(|r| r.angle + TAU * r.turns);
    0.5 * (top - bottom)
}

/// Returns ideal rotors at this phase (rad), f and speed of the line of force (turns per second), and theta (rad).
pub(super) fn aimed(phase: f64, speeds: [f64; 2], theta_rad: f64) -> [Rotor<f64>; 2] {
    let speeds = rotor_speeds(speeds);
    core::array::from_fn(|i| {
        let angle = [phase, -phase][i] - theta_rad;
        let turns = (angle / TAU).round();
        Rotor { angle: angle - turns * TAU, turns, speed: speeds[i], acceleration: 0.0 }
    })
}

/// Returns what moves as no robot does, given the body's velocity, the rotors' speeds and each leg's angles in all.
pub(super) fn stray(velocity: &Spatial<f64>, rotors: [f64; 2], bent: [f64; 4]) -> Option<Part> {
    let bad = |v: f64, limit: f64| v.is_nan() || v.abs() > limit;
    let body = velocity.linear.0.iter().any(|v| bad(*v, SPEED_LIMIT))
        || velocity.angular.0.iter().any(|v| bad(*v, TURN_LIMIT));
    if body {
        return Some(Part::Body);
    }
    let rotor = (0..2).find(|i| bad(rotors[*i], ROTOR_SPEED_LIMIT)).map(Part::Rotor);
    rotor.or_else(|| (0..4).find(|i| bad(bent[*i], HINGE_LIMIT)).map(Part::Leg))
}

fn columns(m: &Mat3<f64>) -> [[f64; 3]; 3] {
    [m.column(0).0, m.column(1).0, m.column(2).0]
}

impl Mechanics for Plant {
    fn step(&mut self, motor_torque: [f64; 2], dt: f64) -> Result<(), Diverged> {
        match self.support {
            Support::Floor => {}
            Support::Hands { until } if self.time < until => {
                self.time += dt;
                return Ok(());
            }
            Support::Hands { .. } => self.support = Support::Floor,
            Support::Cords(cords) => {
                self.set_push(cords.pull(self.mass_properties(), &self.body()))
            }
        }
        let arch = self.arch;
        // A hair of rounding is no step more.
        let parts = (dt / self.longest_step - 1e-9).ceil().max(1.0);
        for _ in 0..parts as u32 {
            self.follow_course(dt / parts);
            arch.dispatch(Step { plant: self, torque: motor_torque, step: dt / parts });
        }
        self.time += dt;
        match self.diverged() {
            None => Ok(()),
            Some(part) => Err(Diverged { time: self.time, part }),
        }
    }
    fn rotor_angle(&self) -> [f64; 2] {
        self.state.rotors.map(|r| r.angle + TAU * r.turns)
    }
    fn rotor_speed(&self) -> [f64; 2] {
        self.state.rotors.map(|r| r.speed)
    }
    fn shaker_force(&self) -> [f64; 3] {
        self.shaker_wrench().force
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Base, GRAVITY};

    fn plant(name: &str) -> Plant {
        Plant::new(&RobotModel::named(name).unwrap()).unwrap()
    }

    fn run(p: &mut Plant, seconds: f64, step: f64) {
        for _ in 0..(seconds / step).round() as usize {
            p.step([0.0; 2], step).unwrap();
        }
    }

    /// Largest force along theta and across it, and torque about z, over one turn at least.
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
    fn on_the_stiffest_floor_no_step_moves_a_robot_farther_than_it_walks() {
        for (stiffness, full) in [(1e6, 0.95), (3.8e5, 0.5)] {
            let mut model = RobotModel::named("W").unwrap();
            model.contact.stiffness_n_per_m = stiffness;
            (model.contact.impedance_touch, model.contact.impedance_full) = (full, full);
            for theta_rad in [0.0, 0.5, 1.5] {
                let mut p = Plant::new(&model).unwrap();
                p.set_drive(Drive::Ideal { frequency_hz: 35.0, theta_rad });
                for _ in 0..1000 {
                    let before = p.body().position;
                    p.step([0.0; 2], 1e-3).unwrap();
                    let [x, y, z] = core::array::from_fn(|i| p.body().position[i] - before[i]);
                    // 1.5 m/s.
                    let moved = x.hypot(y).hypot(z);
                    assert!(moved < 1.5e-3, "{stiffness} N/m: {:.1} mm", 1e3 * moved);
                }
            }
        }
    }

    #[test]
    fn energy_of_a_driven_bench_balances_within_a_thousandth() {
        let mut p = plant("bench-planar");
        let start = p.energy();
        for i in 0..40_000 {
            let t = f64::from(i) * 1e-5;
            p.step([4e-3 - 1e-3 * (9.0 * t).sin(), -3e-3], 1e-5).unwrap();
        }
        let e = p.energy();
        assert!(e.motor_work > 0.1, "{e:?}");
        assert!(e.balance(&start).abs() < 1e-3 * e.motor_work, "{e:?}");
    }

    #[test]
    fn energy_of_a_walk_balances_within_a_hundredth() {
        let mut p = plant("W");
        p.set_drive(Drive::Ideal { frequency_hz: -30.0, theta_rad: 0.5 });
        let start = p.energy();
        run(&mut p, 2.0, 1e-4);
        let e = p.energy();
        assert!(e.leg_loss > 0.0 && e.contact_loss > 0.0);
        assert!(e.balance(&start).abs() < 0.01 * e.motor_work, "{e:?}");
    }

    /// Momentum (N s) and angular momentum about the world's origin (N m s) of everything.
    fn momenta(p: &Plant) -> [Vec3<f64>; 2] {
        let at = p.state.position;
        p.parts().iter().fold([Vec3::zero(); 2], |[linear, angular], (inertia, velocity)| {
            let own = inertia.apply(*velocity);
            [linear + own.linear, angular + own.angular + at.cross(own.linear)]
        })
    }

    /// Largest change of both momenta of a robot that floats without weight, while f and theta change.
    fn drift(step: f64) -> [f64; 2] {
        let mut p = plant("W");
        p.set_floor(false);
        p.constants.gravity = Vec3::zero();
        p.disturb(1, false);
        let drive = |f: f64, degrees: f64| Drive::Ideal {
            frequency_hz: f,
            theta_rad: degrees.to_radians(),
        };
        p.set_drive(drive(30.0, 0.0));
        let start = momenta(&p);
        let mut largest = [0.0f64; 2];
        for (f, degrees) in [(33.0, 60.0), (-33.0, 30.0), (0.0, -80.0), (31.0, 90.0), (31.0, -90.0)]
        {
            p.set_drive(drive(f, degrees));
            for _ in 0..30 {
                run(&mut p, 0.02, step);
                for ((largest, now), start) in largest.iter_mut().zip(momenta(&p)).zip(start) {
                    let by = now - start;
                    *largest = largest.max(by.dot(by).sqrt());
                }
            }
        }
        largest
    }

    #[test]
    fn momentum_is_kept_while_f_and_theta_change_to_second_order_of_the_step() {
        let (coarse, fine) = (drift(1e-4), drift(5e-5));
        println!("momentum {:.2e} N s, angular {:.2e} N m s at 0.1 ms", coarse[0], coarse[1]);
        for (coarse, fine) in coarse.into_iter().zip(fine) {
            assert!((3.0..5.5).contains(&(coarse / fine)), "{coarse:e} {fine:e}");
        }
        assert!(coarse[0] < 1e-3 && coarse[1] < 1e-4, "{coarse:?}");
    }

    #[test]
    fn reversing_takes_the_time_of_a_ramp_and_is_paid_both_ways() {
        let mut p = plant("W");
        p.set_drive(Drive::Ideal { frequency_hz: 30.0, theta_rad: 0.0 });
        run(&mut p, 1.0, 1e-4);
        let start = p.energy();
        p.set_drive(Drive::Ideal { frequency_hz: -30.0, theta_rad: 0.0 });
        let (mut taken, mut given, mut before) = (0.0, 0.0, start.motor_work);
        let mut slowest = f64::INFINITY;
        for _ in 0..10_000 {
            run(&mut p, 1e-4, 1e-4);
            slowest = slowest.min(p.rotor_speed()[0].abs());
            let work = p.energy().motor_work - before;
            (taken, given) = (taken + work.max(0.0), given - work.min(0.0));
            before += work;
        }
        assert!(slowest < 1.0, "it passes through rest: {slowest} rad/s");
        // What both rotors hold at 30 Hz is given back, and taken again.
        assert!(taken > 0.1 && given > 0.1, "{taken} {given}");
        assert!(p.energy().balance(&start).abs() < 0.02 * (taken + given));
    }

    #[test]
    fn a_mirrored_robot_walks_the_mirror_image_bit_for_bit() {
        let walk = |f: f64, theta: f64, mirrored: bool| {
            let mut p = plant("A");
            p.disturb(3, mirrored);
            p.set_drive(Drive::Ideal { frequency_hz: f, theta_rad: theta });
            run(&mut p, 0.5, 1e-4);
            p.body().position
        };
        let [x, y, z] = walk(30.0, 0.5, false);
        assert_eq!(walk(-30.0, -0.5, true), [x, -y, z]);
    }

    #[test]
    fn the_same_start_turned_by_any_heading_walks_the_same_in_its_own_axes() {
        let walk = |turn: f64| {
            let mut p = plant("W");
            p.disturb(3, false);
            let [x, y, _] = p.body().position;
            p.displace([0.0; 3], turn);
            p.set_drive(Drive::Ideal { frequency_hz: -30.0, theta_rad: 0.5 });
            run(&mut p, 0.2, 1e-4);
            let to = p.body();
            let (sin, cos) = turn.sin_cos();
            let [dx, dy] = [to.position[0] - x, to.position[1] - y];
            [cos * dx + sin * dy, cos * dy - sin * dx, to.position[2]]
        };
        let straight = walk(0.0);
        for turn in [0.3, core::f64::consts::FRAC_PI_4, 2.0, -1.2] {
            for (turned, straight) in walk(turn).iter().zip(straight) {
                assert!((turned - straight).abs() < 1e-9, "{turn}: {turned} not {straight}");
            }
        }
    }

    #[test]
    fn a_sliding_robot_is_braked_by_coulombs_friction_whichever_way_it_slides() {
        let mut model = RobotModel::named("A").unwrap();
        let mut legs = model.legs.unwrap();
        let friction = legs.fl.friction;
        // Legs that hardly swing, feet that only slide.
        (legs.bend_stiffness_n_m_rad, legs.twist_stiffness_n_m_rad) = (100.0, 100.0);
        (legs.bend_damping_n_m_s_rad, legs.twist_damping_n_m_s_rad) = (0.5, 0.5);
        model.legs = Some(legs);
        (model.contact.torsional_friction_mm, model.contact.rolling_friction_mm) = (0.0, 0.0);
        let braking = |angle: f64| {
            let mut p = Plant::new(&model).unwrap();
            p.displace([0.0; 3], angle);
            run(&mut p, 0.5, 1e-4);
            let height = p.body().position[2];
            let force = 1.5 * friction * 0.35 * GRAVITY;
            let push = [force * angle.cos(), force * angle.sin()];
            // At the height of the soles, so that it does not tip.
            p.set_push(Wrench {
                force: [push[0], push[1], 0.0],
                torque: [height * push[1], -height * push[0], 0.0],
            });
            run(&mut p, 0.3, 1e-4);
            let mut sum = [0.0; 3];
            for _ in 0..1000 {
                run(&mut p, 1e-4, 1e-4);
                for leg in p.legs().unwrap() {
                    for (sum, force) in sum.iter_mut().zip(leg.floor_force) {
                        *sum += force;
                    }
                }
            }
            let [vx, vy, _] = p.body().velocity;
            assert!(vx * angle.cos() + vy * angle.sin() > 0.3, "{angle}: it slides");
            sum[0].hypot(sum[1]) / sum[2]
        };
        let straight = braking(0.0);
        assert!((straight / friction - 1.0).abs() < 0.02, "{straight}");
        for angle in [0.2, core::f64::consts::FRAC_PI_4, 1.1, 2.5, 4.0] {
            assert!((braking(angle) / straight - 1.0).abs() < 0.01, "{angle}");
        }
    }

    #[test]
    fn on_a_slope_the_robot_stands_up_to_the_angle_of_friction_and_slides_downhill_beyond() {
        // 0.3 is the tangent of 16.7 degrees.
        let (mut model, downhill_deg) = (RobotModel::named("W").unwrap(), 110.0);
        for leg in model.legs.iter_mut().flat_map(|legs| legs.each_mut()) {
            leg.friction = 0.3;
        }
        let velocity = |slope_deg: f64| {
            let mut model = model.clone();
            model.contact = crate::model::Contact { slope_deg, downhill_deg, ..model.contact };
            let mut p = Plant::new(&model).unwrap();
            run(&mut p, 3.0, 1e-4);
            let before = p.body().position;
            run(&mut p, 0.2, 1e-4);
            let now = p.body().position;
            [0, 1].map(|axis| (now[axis] - before[axis]) / 0.2)
        };
        let [x, y] = velocity(14.0);
        assert!(x.hypot(y) < 1e-3, "{x} {y}");
        let [x, y] = velocity(18.5);
        assert!(
            (y.atan2(x).to_degrees() - downhill_deg).abs() < 15.0 && x.hypot(y) > 0.1,
            "{x} {y}"
        );
    }

    #[test]
    fn friction_does_not_change_how_soft_the_floor_is() {
        let height = |factor: f64| {
            let mut model = RobotModel::named("W").unwrap();
            for leg in model.legs.iter_mut().flat_map(|legs| legs.each_mut()) {
                leg.friction *= factor;
            }
            let mut p = Plant::new(&model).unwrap();
            run(&mut p, 2.0, 1e-4);
            p.body().position[2]
        };
        let usual = height(1.0);
        for factor in [0.42, 1.58] {
            assert!((height(factor) - usual).abs() < 2e-6, "{factor}");
        }
    }

    #[test]
    fn a_clamped_leg_bends_as_far_as_its_hinges_say() {
        let mut model = RobotModel::named("A").unwrap();
        model.base = Base::Fixed {};
        let mut p = Plant::new(&model).unwrap();
        p.set_floor(false);
        run(&mut p, 1.0, 1e-4);
        let tip = |p: &Plant| p.legs().unwrap()[0].joints[3];
        let from = tip(&p);
        p.set_tip_push(0, Wrench { force: [0.2, 0.0, 0.0], torque: [0.0; 3] });
        run(&mut p, 1.0, 1e-4);
        let to = tip(&p);
        assert!((1e3 * (to[0] - from[0]) - 0.157).abs() < 0.00157);
        assert!((1e3 * (to[1] - from[1]) - 0.104).abs() < 0.00104);
    }

    #[test]
    fn dropped_from_20_mm_the_robot_comes_to_rest_at_its_height_under_its_weight() {
        let mut p = plant("A");
        p.displace([0.0, 0.0, 0.02], 0.0);
        run(&mut p, 2.0, 1e-4);
        assert!((1e3 * p.body().position[2] - 56.65).abs() < 0.2);
        let load: f64 = p.legs().unwrap().iter().map(|l| l.floor_force[2]).sum();
        assert!((load / (0.35 * GRAVITY) - 1.0).abs() < 1e-6, "{load}");
    }

    #[test]
    fn an_exploding_step_is_reported_with_time_and_part() {
        let mut p = plant("A");
        p.set_push(Wrench { force: [1e9, 0.0, 0.0], torque: [0.0; 3] });
        let error = p.step([0.0; 2], 1e-3).unwrap_err();
        assert_eq!((error.time, error.part), (1e-3, Part::Body));
    }
}
