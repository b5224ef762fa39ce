//! What commissioning finds to be wrong, in sentences that say what to look at.

use std::fmt;

/// Returns the name of a motor, 0 or 1.
#[must_use]
pub const fn motor_name(motor: usize) -> &'static str {
    if motor == 0 { "top" } else { "bottom" }
}

/// A phase: 0, 1 or 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Phase(pub usize);

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(["A", "B", "C"].get(self.0).copied().unwrap_or("?"))
    }
}

/// What is wrong with a robot. Motors are 0 (top) and 1 (bottom).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// What the divider shows is far from what a voltmeter does.
    #[error(
        "the board shows {shown:.1} V for a battery of {entered:.1} V: look at its divider, and whether this is the image of \
         this board"
    )]
    Battery {
        /// By the board, V.
        shown: f64,
        /// By the voltmeter, V.
        entered: f64,
    },
    /// An encoder gives no reading.
    #[error("an encoder does not answer: look at the wires and the supply of both")]
    EncoderLost,
    /// A standing rotor seems to move.
    #[error(
        "the {} encoder's angle jumps by {degrees:.1} degrees while nothing turns: is its magnet near and above its middle, and \
         does the rotor stand?", motor_name(*motor)
    )]
    EncoderNoisy {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Root mean square.
        degrees: f64,
    },
    /// The other motor's encoder sees a motor turn.
    #[error("the {} motor turns under the other one's encoder: swap the two encoders", motor_name(*.0))]
    EncodersSwapped(usize),
    /// The rotor turned, and its encoder did not see it.
    #[error(
        "the {} motor turns and its encoder does not see it: is the magnet fixed to the shaft?",
        motor_name(*.0)
    )]
    EncoderBlind(usize),
    /// An amplifier shows a current where none flows.
    #[error(
        "the current amplifier of phase {phase} of the {} motor shows {shown:+.2} A where none flows: look at its supply and \
         reference", motor_name(*motor)
    )]
    AmplifierOffset {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
        /// What it shows, A.
        shown: f64,
    },
    /// No current shows, in no phase.
    #[error(
        "no current shows in the {} motor: look at its three wires, the supply of its driver, its shunts, and whether this is \
         the image of this board",
        motor_name(*.0)
    )]
    NotConnected(usize),
    /// Hardly any current shows, in no motor.
    #[error(
        "hardly any current shows in either motor: is this the image of this board, and are their drivers supplied?"
    )]
    FaintCurrents,
    /// A phase carries nothing.
    #[error("phase {phase} of the {} motor is open: look at its wire", motor_name(*motor))]
    OpenPhase {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
    },
    /// A phase has more resistance than the others.
    #[error(
        "phase {phase} of the {} motor has {ratio:.1} times the resistance of the others: look at its joints",
        motor_name(*motor)
    )]
    BadJoint {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
        /// Its resistance over that of the others.
        ratio: f64,
    },
    /// Two windings touch.
    #[error(
        "phases {} and {} of the {} motor touch within their windings: replace the motor",
        phases[0], phases[1], motor_name(*motor)
    )]
    ShortedPhases {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names both phases.
        phases: [Phase; 2],
    },
    /// A winding has fewer turns than the others.
    #[error(
        "phase {phase} of the {} motor has {ratio:.1} times the resistance of the others: turns of it are shorted, replace \
         the motor", motor_name(*motor)
    )]
    ShortedTurns {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
        /// Its resistance over that of the others.
        ratio: f64,
    },
    /// A phase carries current, and its amplifier shows none.
    #[error(
        "the current amplifier of phase {phase} of the {} motor shows nothing: look at its shunt and its wire",
        motor_name(*motor)
    )]
    AmplifierDead {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
    },
    /// The amplifiers of phases A and B are swapped.
    #[error("the current amplifiers of phases A and B of the {} motor are swapped", motor_name(*.0))]
    AmplifiersSwapped(usize),
    /// An amplifier shows another phase.
    #[error(
        "the current amplifier of phase {amplifier} of the {} motor shows phase {phase}",
        motor_name(*motor)
    )]
    AmplifierElsewhere {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// The amplifier.
        amplifier: Phase,
        /// What it shows.
        phase: Phase,
    },
    /// The amplifiers of a motor count in opposite directions.
    #[error(
        "the current amplifiers of phases A and B of the {} motor have opposite signs: swap the two inputs of one of them",
        motor_name(*.0)
    )]
    AmplifiersOpposed(usize),
    /// The amplifiers of a motor show one current as different ones.
    #[error(
        "the current amplifiers of phases A and B of the {} motor differ by a factor of {:.1}: is one shunt another?",
        motor_name(*motor), ratio.max(1.0 / ratio)
    )]
    AmplifiersDiffer {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// What B shows over what A does.
        ratio: f64,
    },
    /// The amplifiers of a motor show the other's currents.
    #[error("the current amplifiers of the {} motor are connected to the other motor", motor_name(*.0))]
    AmplifiersOfOther(usize),
    /// An amplifier of a motor shows the other's current.
    #[error(
        "the current amplifier of phase {phase} of the {} motor is connected to the other motor",
        motor_name(*motor)
    )]
    AmplifierOfOther {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Names the phase.
        phase: Phase,
    },
    /// No resistance and inductance explain the currents of a motor.
    #[error("the {} motor carries no current as a winding does: look at its three wires", motor_name(*.0))]
    NoWinding(usize),
    /// A motor does not turn with its field.
    #[error(
        "the {} motor does not turn with its field: does something block it, or do its amplifiers show more current than flows?",
        motor_name(*.0)
    )]
    Blocked(usize),
    /// A motor turns as if its pole pairs were no whole number.
    #[error(
        "the {} motor follows its field as one of {ratio:.2} pole pairs would: does its magnet slip on the shaft?",
        motor_name(*motor)
    )]
    PolePairs {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Turns of the field over turns of the rotor.
        ratio: f64,
    },
    /// The motors have different numbers of pole pairs.
    #[error(
        "the bottom motor has {bottom} pole pairs, the top one {top}: both must be of one kind"
    )]
    OtherPolePairs {
        /// Of the top motor.
        top: u32,
        /// Of the bottom motor.
        bottom: u32,
    },
    /// A motor speeds up too easily.
    #[error(
        "the {} motor speeds up as if it had {:.0} % of the inertia that is stated: is its eccentric mass in place?",
        motor_name(*motor), 100.0 * share
    )]
    NoMass {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Share of the stated inertia that it shows.
        share: f64,
    },
    /// A motor does not run steadily.
    #[error(
        "the {} rotor swings by {:.1} Hz about {:.0} Hz with either position loop, which spoils what is measured: hold the body, \
         and look whether something rubs or the magnet is loose",
        motor_name(*motor), swing, frequency.abs()
    )]
    Swings {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// Standard deviation of its speed, Hz.
        swing: f64,
        /// The frequency that was held, Hz.
        frequency: f64,
    },
    /// The angle between magnets and encoder changed.
    #[error(
        "the encoder of the {} motor turned against its rotor by {degrees:.1} degrees meanwhile: fix its magnet and the \
         encoder, and start again", motor_name(*motor)
    )]
    MagnetSlips {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// By how much, degrees of the rotor.
        degrees: f64,
    },
    /// The current that a motor takes changed from ramp to ramp.
    #[error(
        "the current that the {} rotor takes changed meanwhile, by {:.0} % of what speeds it up: does something rub on it now and \
         then, or does the body slide? Mend it, hold the body, and start again",
        motor_name(*motor), 100.0 * change
    )]
    Uneven {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// By how much, as a share of the current that speeds it up.
        change: f64,
    },
    /// Those of one motor show another current than flows.
    #[error(
        "both current amplifiers of the {} motor show {scale:.2} times the current that flows: are its shunts others than the \
         other motor's?", motor_name(*motor)
    )]
    AmplifiersScale {
        /// Names the motor: 0 is the top one.
        motor: usize,
        /// What they show over what flows.
        scale: f64,
    },
    /// What was entered does not make the voltage that it takes.
    #[error(
        "the voltage of the {} motor is none that its entered resistance, inductance, flux linkage and pole pairs take: measure \
         them again",
        motor_name(*.0)
    )]
    OtherMotor(usize),
    /// Both encoders are of one kind.
    #[error(
        "the top encoder seems to be {top_us:.0} us late and the bottom one {bottom_us:.0} us: measure resistance and inductance of \
         both motors again, or are the encoders of two kinds?"
    )]
    EncodersDiffer {
        /// Of the top encoder, us.
        top_us: f64,
        /// Of the bottom one, us.
        bottom_us: f64,
    },
    /// Both motors take another current than they should to speed up.
    #[error(
        "both motors seem to carry {scale:.2} times the current that their inertia takes: is this the image of this board, and \
         are rotor_inertia and both eccentric masses right?"
    )]
    CurrentScale {
        /// What is shown over what it should be.
        scale: f64,
    },
}
