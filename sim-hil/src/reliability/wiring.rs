//! Robots that are wired, mounted or made wrongly, and whether commissioning names what is wrong.

use flix_host::commission::{CommissionError, Finding, Phase};
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use super::unknown_motors::{Watched, known, unknown_motors};
use crate::model::RobotModel;
use crate::model::SIMULATED_BOARD;
use crate::rig::bench::BenchError;
use crate::rig::wiring_fault::{Miswired, WiringFault};
use crate::study::Row;

/// Returns the kinds of wiring faults, in the order of [`search`].
pub(super) fn kinds() -> Vec<&'static str> {
    faults(&unknown_motors(0), 0).into_iter().map(|(kind, _)| kind).collect()
}

/// Gives the robot of this seed each wiring fault in turn, at a motor, phase and strength that chance picks. Returns for each fault the
/// words of commissioning, whether they name the fault with its motor and its phase, and the largest phase current from power-up
/// on, A.
///
/// # Errors
/// When the robot cannot be built.
pub(super) fn search(seed: u64) -> Result<Vec<Row>, BenchError> {
    let model = unknown_motors(seed);
    faults(&model, seed)
        .into_par_iter()
        .map(|(kind, fault)| {
            let mut model = model.clone();
            if kind == "divider" {
                // Only a board that has one.
                model.electrical.sense.bus_uv_per_count =
                    SIMULATED_BOARD.bus_microvolts_per_count.map_or(0, std::num::NonZeroU16::get);
            }
            search_one(model, seed, fault)
        })
        .collect()
}

fn search_one(model: RobotModel, seed: u64, fault: WiringFault) -> Result<Row, BenchError> {
    let sense = SIMULATED_BOARD.current_sense;
    let shaker = model.shaker;
    let mut watched = Watched::power_up_with(model, seed, Some(Miswired::new(fault, sense, seed)))?;
    let known = known(&shaker, seed, &watched);
    let found = watched.commission(&known);
    let named = matches!(&found, Err(CommissionError::Found(finding)) if is_named(fault, *finding));
    let said = found.err().map_or_else(|| "nothing".to_owned(), |error| error.to_string());
    Ok(vec![said.into(), named.into(), watched.largest_current.get().into()])
}

/// Draws one fault of each kind.
fn faults(model: &RobotModel, seed: u64) -> Vec<(&'static str, WiringFault)> {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0x5157);
    let motor = source.random_range(0..2);
    let phase = source.random_range(0..3);
    let amplifier = source.random_range(0..2);
    let mut within = |low: f64, high: f64| low + (high - low) * source.random::<f64>();
    let pairs = model.electrical.motor.pole_pairs;
    let other_pairs = if pairs > 7 {
        pairs - 1 - (3.0 * within(0.0, 1.0)) as u32
    } else {
        pairs + 1 + (3.0 * within(0.0, 1.0)) as u32
    };
    let offset = if within(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 } * within(200.0, 1_000.0);
    let divider = if within(-1.0, 1.0) < 0.0 { within(0.4, 0.75) } else { within(1.35, 2.5) };
    let gain = if within(-1.0, 1.0) < 0.0 { within(0.3, 0.4) } else { within(2.5, 3.3) };
    // A twentieth to a half, evenly in its logarithm.
    let share = 0.05 * 10.0_f64.powf(within(0.0, 1.0));
    vec![
        ("motor not connected", WiringFault::NotConnected(motor)),
        ("open phase", WiringFault::OpenPhase(motor, phase)),
        ("bad joint", WiringFault::BadJoint(motor, phase, within(2.0, 10.0))),
        ("shorted phases", WiringFault::ShortedBut(motor, phase)),
        ("shorted turns", WiringFault::ShortedTurns(motor, phase, within(0.3, 0.6))),
        ("amplifier dead", WiringFault::AmplifierDead(motor, amplifier)),
        ("amplifier inverted", WiringFault::AmplifierInverted(motor, amplifier)),
        ("amplifier offset", WiringFault::AmplifierOffset(motor, amplifier, offset as i16)),
        ("amplifier of another gain", WiringFault::AmplifierGain(motor, amplifier, gain)),
        ("amplifier on phase C", WiringFault::AmplifierOnC(motor, amplifier)),
        ("amplifiers swapped", WiringFault::AmplifiersSwapped(motor)),
        ("amplifier of the other motor", WiringFault::AmplifierCrossed(amplifier)),
        ("amplifiers of the other motor", WiringFault::AmplifiersCrossed),
        ("other board", WiringFault::OtherBoard(within(1.9, 2.6))),
        ("shunts too small", WiringFault::OtherBoard(share)),
        ("shunts of one motor too small", WiringFault::AmplifiersGain(motor, share)),
        ("divider", WiringFault::Divider(divider)),
        ("encoders swapped", WiringFault::EncodersSwapped),
        ("encoder lost", WiringFault::EncoderLost(motor)),
        ("encoder noisy", WiringFault::EncoderNoisy(motor, within(3.0, 20.0))),
        ("magnet does not turn", WiringFault::EncoderStill(motor)),
        (
            "magnet slips",
            WiringFault::MagnetSlips(motor, f64::from(pairs) / (f64::from(pairs) + 0.5)),
        ),
        ("rotor blocked", WiringFault::Blocked(motor)),
        ("other pole pairs", WiringFault::BottomPolePairs(other_pairs)),
        ("mass missing", WiringFault::NoMass(motor, within(0.1, 0.4))),
    ]
}

/// Returns whether a finding names a fault.
fn is_named(fault: WiringFault, finding: Finding) -> bool {
    let third = |first: usize, second: usize| 3 - first - second;
    match (fault, finding) {
        (WiringFault::NotConnected(it), Finding::NotConnected(motor))
        | (WiringFault::AmplifiersSwapped(it), Finding::AmplifiersSwapped(motor))
        | (WiringFault::AmplifiersGain(it, _), Finding::AmplifiersScale { motor, .. })
        | (WiringFault::AmplifiersGain(it, _), Finding::NotConnected(motor))
        | (WiringFault::AmplifierInverted(it, _), Finding::AmplifiersOpposed(motor))
        | (WiringFault::AmplifierGain(it, ..), Finding::AmplifiersDiffer { motor, .. })
        | (WiringFault::EncoderNoisy(it, _), Finding::EncoderNoisy { motor, .. })
        | (WiringFault::EncoderStill(it), Finding::EncoderBlind(motor))
        | (WiringFault::MagnetSlips(it, _), Finding::PolePairs { motor, .. })
        | (WiringFault::Blocked(it), Finding::Blocked(motor))
        | (WiringFault::NoMass(it, _), Finding::NoMass { motor, .. }) => it == motor,
        (WiringFault::OpenPhase(it, at), Finding::OpenPhase { motor, phase })
        | (WiringFault::BadJoint(it, at, _), Finding::BadJoint { motor, phase, .. })
        | (WiringFault::ShortedTurns(it, at, _), Finding::ShortedTurns { motor, phase, .. })
        | (WiringFault::AmplifierDead(it, at), Finding::AmplifierDead { motor, phase })
        | (
            WiringFault::AmplifierOffset(it, at, _),
            Finding::AmplifierOffset { motor, phase, .. },
        ) => (it, Phase(at)) == (motor, phase),
        (WiringFault::ShortedBut(it, at), Finding::ShortedPhases { motor, phases: [one, two] }) => {
            it == motor && at == third(one.0, two.0)
        }
        (
            WiringFault::AmplifierOnC(it, at),
            Finding::AmplifierElsewhere { motor, amplifier, phase },
        ) => (it, Phase(at), Phase(2)) == (motor, amplifier, phase),
        (WiringFault::AmplifierCrossed(at), Finding::AmplifierOfOther { phase, .. }) => {
            phase == Phase(at)
        }
        (WiringFault::BottomPolePairs(pairs), Finding::OtherPolePairs { bottom, .. }) => {
            bottom == pairs
        }
        (WiringFault::AmplifiersCrossed, Finding::AmplifiersOfOther(_))
        | (WiringFault::OtherBoard(_), Finding::CurrentScale { .. } | Finding::FaintCurrents)
        | (WiringFault::Divider(_), Finding::Battery { .. })
        | (WiringFault::EncodersSwapped, Finding::EncodersSwapped(_))
        | (WiringFault::EncoderLost(_), Finding::EncoderLost) => true,
        _ => false,
    }
}
