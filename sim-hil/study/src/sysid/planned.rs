//! Experiments that nobody has made yet, for what they would bring.

use super::{drag, legs, scales};

/// Returns weighings that nobody has made yet.
#[must_use]
pub(super) fn planned_scales() -> scales::Scales {
    let rows = scales::USUAL.map(|[roll, pitch]| [roll, pitch, 0.0, 0.0, 0.0, 0.0]);
    scales::Scales::new(&rows)
}

/// Returns tests of all legs that nobody has made yet.
#[must_use]
pub(super) fn planned_legs() -> legs::Legs {
    legs::Legs::new(&leg_rows())
}

pub(super) fn leg_rows() -> Vec<Vec<f64>> {
    let row = |leg: usize, load: &[f64; 6]| [&[leg as f64], load.as_slice(), &[0.0; 6]].concat();
    (0..4).flat_map(|leg| legs::USUAL.iter().map(move |load| row(leg, load))).collect()
}

/// Returns drags of all feet that nobody has made yet.
#[must_use]
pub(super) fn planned_drag() -> drag::Drag {
    drag::Drag::new(&drag_rows())
}

pub(super) fn drag_rows() -> Vec<[f64; 4]> {
    let (directions, loads) = drag::USUAL;
    let rows = (0..4).flat_map(|leg| {
        let each = loads.into_iter().flat_map(move |load| directions.map(|d| (d, load)));
        each.map(move |(direction, load)| [leg as f64, direction, load, 0.0])
    });
    rows.collect()
}
