//! Field-oriented control: phase currents in, duties out. On the paper's robot this was SimpleFOC's part (section II-A).
//!
//! Terms: phases A, B, C; the stator frame alpha, beta (amplitude-invariant Clarke); the rotor
//! frame d (along the magnet's field, makes no torque) and q (a quarter electrical turn ahead,
//! makes torque `1.5 p lambda i_q`). Electrical angle = pole pairs times rotor angle, plus the
//! offset found by alignment.
//!
//! Stator voltages in the rotor frame, with electrical speed `w`:
//!
//! ```text
//! v_d = R i_d + L di_d/dt - w L i_q
//! v_q = R i_q + L di_q/dt + w L i_d + w lambda
//! ```
//!
//! Currents are in 2^-16 A, voltages in 2^-16 V, sines and cosines in 2^-31.

pub(crate) mod burning;
pub mod current;
pub mod modulation;
pub mod transform;
