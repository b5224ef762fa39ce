//! Single robots into lanes and out again.

use super::lane::{Double, Lane, Quad, ShortQuad, Single};
use super::leg::{ContactLaw, Foot, LegModel, LegState};
use super::spatial::{Mat3, RigidInertia, Spatial, Sym3, Vec3};
use super::system::{Rotor, Several};

/// Something made of lanes, each of which can be read and set alone.
pub trait Pack {
    /// The same thing made of single numbers.
    type Single;
    /// Every lane alike.
    fn all(single: &Self::Single) -> Self;
    /// Sets one lane.
    fn set(&mut self, lane: usize, single: &Self::Single);
    /// Reads one lane.
    fn get(&self, lane: usize) -> Self::Single;
}

/// Something made of numbers.
pub(super) trait Numbers {
    /// Visits each of them, always in the same order.
    fn each(&mut self, visit: &mut impl FnMut(&mut f64));
}

impl Numbers for f64 {
    fn each(&mut self, visit: &mut impl FnMut(&mut f64)) {
        visit(self);
    }
}

impl<T: Numbers, const N: usize> Numbers for [T; N] {
    fn each(&mut self, visit: &mut impl FnMut(&mut f64)) {
        self.iter_mut().for_each(|part| part.each(visit));
    }
}

macro_rules! pack_number {
    ($($lane:ty),+) => {$(
        impl Pack for $lane {
            type Single = f64;
            fn all(single: &f64) -> Self {
                Self::splat(*single)
            }
            fn set(&mut self, lane: usize, single: &f64) {
                *self = self.with_lane(lane, *single);
            }
            fn get(&self, lane: usize) -> f64 {
                self.lane(lane)
            }
        }
    )+};
}
pack_number!(f64, Quad, ShortQuad, Double, Single);

impl<P: Pack, const N: usize> Pack for [P; N] {
    type Single = [P::Single; N];
    fn all(single: &Self::Single) -> Self {
        core::array::from_fn(|i| P::all(&single[i]))
    }
    fn set(&mut self, lane: usize, single: &Self::Single) {
        for (p, s) in self.iter_mut().zip(single) {
            p.set(lane, s);
        }
    }
    fn get(&self, lane: usize) -> Self::Single {
        core::array::from_fn(|i| self[i].get(lane))
    }
}

macro_rules! pack_struct {
    ($($name:ident { $($field:tt),+ })+) => {$(
        impl<F: Pack<Single = f64>> Pack for $name<F> {
            type Single = $name<f64>;
            fn all(single: &Self::Single) -> Self {
                $name { $($field: Pack::all(&single.$field)),+ }
            }
            fn set(&mut self, lane: usize, single: &Self::Single) {
                $(self.$field.set(lane, &single.$field);)+
            }
            fn get(&self, lane: usize) -> Self::Single {
                $name { $($field: self.$field.get(lane)),+ }
            }
        }

        impl Numbers for $name<f64> {
            fn each(&mut self, visit: &mut impl FnMut(&mut f64)) {
                $(self.$field.each(visit);)+
            }
        }
    )+};
}

pack_struct! {
    Vec3 { 0 }
    Mat3 { 0 }
    Sym3 { 0 }
    Spatial { angular, linear }
    RigidInertia { mass, moment, inertia }
    Rotor { angle, turns, speed, acceleration }
    Foot { friction, damping, stiffness, mobility, impedance }
    ContactLaw { push, hold, slip }
    LegState { angle, speed, acceleration, law, rest, tangential_strain, force }
    LegModel {
        root, frame, twist, stiffness, damping, segment, mass, inertia, end_mass, end_center,
        end_inertia, foot_center, foot_half, foot
    }
    Several {
        position, orientation, velocity, acceleration, rotors, legs, push, tip_push, shaker, middle,
        motor_torque, work
    }
}
