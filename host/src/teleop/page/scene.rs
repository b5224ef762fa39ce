//! Scene with which pages draw the robot: `page.js` of the cockpit, and those of `flix-sim`.

/// Draws boxes, lines and arrows on a canvas, seen by a camera that the pointer moves: plain JavaScript that is put
/// into a page, where it defines `createScene`. It asks for nothing from elsewhere.
pub const SCENE: &str = include_str!("scene.js");
