//! Experiments: what is asked of one robot, and how the answer is measured.

pub mod course;
pub mod metrics;
pub mod probe;
pub mod random_sequences;
pub mod validation;
pub mod walk;
pub mod walks;
