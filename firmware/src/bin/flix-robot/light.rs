//! The status LED: one blink pattern a state, readable from across a room.
