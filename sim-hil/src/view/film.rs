//! A film of a run: a frame now and then, to be made into a [`Recording`].

use flix_host::nav::PlanarPose;

use super::{Caption, Frame, Recording, RobotView};
use crate::model::RobotModel;
use crate::plant::Plant;

/// Frames at most, some 16 MB of page: what a browser loads at once.
const FRAMES: usize = 16_000;

/// What was seen of a plant so far.
///
/// A film that grows too long is thinned: every second frame goes, and from then on half as many
/// are taken. So no run is too long to be looked at.
#[derive(Debug, Clone)]
pub struct Film {
    view: RobotView,
    interval: f64,
    limit: usize,
    start: Option<f64>,
    frames: Vec<Frame>,
    captions: Vec<Caption>,
}

impl Film {
    /// Creates an empty film of plants of this model, with a frame every `interval` seconds.
    #[must_use]
    pub fn new(model: &RobotModel, interval: f64) -> Self {
        Self {
            view: RobotView::new(model),
            interval,
            limit: FRAMES,
            start: None,
            frames: Vec::new(),
            captions: Vec::new(),
        }
    }

    /// Looks at the plant, and keeps a frame when one is due.
    pub fn shoot(&mut self, plant: &Plant) {
        let time = self.time(plant);
        // Half a microsecond: times are sums of steps.
        if time + 5e-7 < self.interval * self.frames.len() as f64 {
            return;
        }
        self.frames.push(self.view.frame(plant, time));
        if self.frames.len() >= self.limit {
            let mut index = 0;
            self.frames.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.interval *= 2.0;
        }
    }

    /// Says what is seen from now on; saying the same again changes nothing.
    pub fn caption(&mut self, plant: &Plant, text: &str) {
        if self.captions.last().is_none_or(|last| last.text != text) {
            let time = self.time(plant);
            self.captions.push(Caption { time, text: text.to_owned() });
        }
    }

    /// Returns the body's pose on the floor in every frame.
    pub fn track(&self) -> impl ExactSizeIterator<Item = PlanarPose> + '_ {
        self.frames.iter().map(|frame| frame.poses[0].on_the_floor())
    }

    /// Returns all of it, with a title.
    #[must_use]
    pub fn into_recording(self, title: String) -> Recording {
        Recording {
            title,
            parts: self.view.parts(),
            arrows: self.view.arrows(),
            captions: self.captions,
            frames: self.frames,
            ..Recording::default()
        }
    }

    /// Seconds since the plant was first looked at.
    fn time(&mut self, plant: &Plant) -> f64 {
        let now = plant.time();
        now - *self.start.get_or_insert(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Mechanics as _;

    #[test]
    fn a_long_run_is_thinned_and_keeps_its_beginning_and_even_intervals() {
        let model = RobotModel::named("bench-planar").unwrap();
        let mut plant = Plant::new(&model).unwrap();
        let mut film = Film { limit: 8, ..Film::new(&model, 1e-3) };
        for _ in 0..400 {
            film.shoot(&plant);
            plant.step([0.0; 2], 1e-4).unwrap();
        }
        let milliseconds: Vec<_> =
            film.frames.iter().map(|frame| (frame.time * 1e3).round() as u32).collect();
        assert_eq!(milliseconds, [0, 8, 16, 24, 32]);
    }
}
