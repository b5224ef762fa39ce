//! Datagrams under way. The network loses, repeats, delays and reorders them.

use crate::model::Model;
use crate::order::{Age, Order};
use crate::robot::{Halt, Session};

/// A datagram to the robot.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
pub struct Datagram {
    /// Session of the sender.
    pub session: Session,
    /// Operator that sent it: 0 or 1.
    pub sender: u8,
    /// Counter of the session; 0 outside a session.
    pub counter: u8,
    /// The order.
    pub order: Order,
}

/// Telemetry of the present session, on its way to the holder.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
pub struct Telemetry {
    /// Operator that reads it: 0 or 1.
    pub reader: u8,
    /// Moment at which the robot sent it.
    pub moment: u8,
    /// Age of the permit that it states.
    pub age: Age,
    /// Ghost: the robot has halted since.
    pub is_unseen: bool,
    /// Whether the robot was idle.
    pub is_idle: bool,
    /// Whether a stop or a fault was latched.
    pub is_ill: bool,
    /// Whether the stop was latched.
    pub is_stopped: bool,
    /// Reason of the permit.
    pub halt: Halt,
    /// Counter of the newest order that the robot had obeyed.
    pub heard: u8,
}

/// Datagrams under way in one direction.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
pub struct UnderWay<T> {
    places: [T; Model::MOST],
    length: u8,
}

impl<T: Copy + Default + Ord> UnderWay<T> {
    /// Returns the datagrams.
    pub fn all(&self) -> &[T] {
        &self.places[..usize::from(self.length)]
    }

    /// Returns the datagrams, to be changed.
    pub(crate) fn all_mut(&mut self) -> &mut [T] {
        &mut self.places[..usize::from(self.length)]
    }

    /// Adds a datagram. Panics where [`Model::MOST`] are under way.
    pub(crate) fn push(&mut self, datagram: T) {
        self.places[usize::from(self.length)] = datagram;
        self.length += 1;
    }

    /// Takes out a datagram by its place.
    pub(crate) fn remove(&mut self, place: usize) {
        self.all_mut()[place..].rotate_left(1);
        self.length -= 1;
        self.places[usize::from(self.length)] = T::default();
    }

    /// Keeps the datagrams for which `keeps` returns true.
    pub(crate) fn retain(&mut self, mut keeps: impl FnMut(&T) -> bool) {
        let mut place = 0;
        while place < usize::from(self.length) {
            if keeps(&self.places[place]) {
                place += 1;
            } else {
                self.remove(place);
            }
        }
    }

    /// Sorts the datagrams, because their places mean nothing.
    pub(crate) fn sort(&mut self) {
        self.all_mut().sort_unstable();
    }
}
