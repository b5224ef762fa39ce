//! What an attacker does.

use serde::Serialize;

/// What the attacker sends, and what a network in its hands does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    /// Any bytes.
    Noise,
    /// Any bytes behind a good head of any kind, in the length of that kind as often as not.
    Headed,
    /// The head of the present session with a counter to come, before any body.
    Forged,
    /// A genuine datagram with one to three bits flipped.
    Flipped,
    /// A genuine datagram cut short.
    Truncated,
    /// A genuine datagram with bytes more.
    Extended,
    /// The beginning of one genuine datagram and the end of another.
    Spliced,
    /// A genuine datagram of the present session again.
    Replayed,
    /// A genuine datagram under another counter.
    Recounted,
    /// What the robot itself sent.
    Reflected,
    /// What was sent in an earlier session with this robot.
    EarlierSession,
    /// What was sent to another robot with the same key.
    OtherRobot,
    /// A handshake, or what follows it, under another key.
    OtherKey,
    /// Hellos from made-up addresses.
    HelloFlood,
    /// A second operator, with the right key.
    SecondOperator,
    /// A stop from outside a session, altered or made of a handshake.
    ForgedStop,
    /// A stop from outside a session that was obeyed earlier, from the address that sent it.
    ReplayedStop,
    /// A renewal of keys, made of a genuine datagram of the present session.
    ForgedRenewal,
    /// A renewal of the keys of another session under the same key.
    ForeignRenewal,
    /// Genuine datagrams that arrive late, both ways.
    Delayed,
    /// Genuine datagrams that arrive late at the robot alone.
    DelayedToRobot,
    /// Genuine datagrams that arrive late at the operator alone.
    DelayedToOperator,
    /// Genuine datagrams of which some or all never arrive.
    Dropped,
    /// Genuine datagrams that overtake each other.
    Reordered,
    /// Genuine datagrams that arrive twice, the second time later.
    Duplicated,
    /// Genuine datagrams that are kept, and released all at once.
    ReleasedAtOnce,
    /// Genuine datagrams that are released one by one, often enough to keep every deadline of silence.
    ReleasedOneByOne,
    /// Genuine datagrams that are released one by one, just before a session is forgotten.
    ReleasedSlowly,
    /// Genuine datagrams that are kept over a restart of the robot, and all that was recorded, after it.
    KeptOverRestart,
    /// Genuine datagrams that are kept while the robot is given another key, and all that was recorded, after that.
    KeptOverKeyChange,
    /// Orders of an operator who wants nothing, which arrive behind his first order to arm.
    IdleReleased,
    /// Telemetry that never arrives, while replies and events do, and the robot halts.
    TelemetryStarved,
    /// A fault, a silence or a stop of somebody else within 50 ms of an order that begins something.
    HaltAtPress,
    /// A second operator who stops the robot between an order to clear and its arrival.
    StopsBetween,
    /// Orders that are kept while another operator takes the session, and then played to him and his robot.
    KeptOverTakeover,
    /// Renewals of keys that are kept for minutes, or for good.
    RenewalHeldBack,
    /// Renewals of keys, of either end, that are played again in their own session.
    RenewalReplayed,
    /// Sealed datagrams of sessions that were recorded, and the key that is learnt later.
    RecordedSession,
    /// Poses in the name of the motion capture, beside the true ones.
    ForgedPoses,
    /// ARP packets that claim the operator's address and those of more neighbours than the robot knows.
    ForgedArp,
    /// ARP packets in which somebody claims the robot's own address.
    GratuitousArp,
    /// Questions of mDNS that come from other networks.
    ForeignQuestions,
    /// Questions of mDNS in the name of a neighbour.
    NeighbourQuestions,
    /// Copies of the operator's frames, from another card, at once.
    CopiedFrames,
    /// Many stops within a second, and all of them again.
    StopsReplayed,
    /// A device between the operator's cable and the robot, which passes on all that is said.
    RelayedAtCable,
    /// Sockets at the cockpit's port that say nothing, from other addresses.
    SocketsOfStrangers,
    /// The same from the address of the page.
    SocketsBesideThePage,
    /// A network that is silent until the rotors stand, and then carries what the operator's program repeats.
    SilencedThenHeard,
    /// Refusals in the robot's name, and that another holds it.
    ForgedRefusal,
    /// Challenges in the robot's name.
    ForgedChallenge,
    /// Acceptances in the robot's name.
    ForgedAccept,
    /// What the robot sends, with a bit flipped.
    FlippedToOperator,
    /// What the robot has sent, again.
    ReplayedToOperator,
}

/// What the attacker makes up, each as often as the others.
pub(super) const FORGERIES: [Kind; 19] = [
    Kind::Noise,
    Kind::Headed,
    Kind::Forged,
    Kind::Flipped,
    Kind::Truncated,
    Kind::Extended,
    Kind::Spliced,
    Kind::Replayed,
    Kind::Recounted,
    Kind::Reflected,
    Kind::EarlierSession,
    Kind::OtherRobot,
    Kind::OtherKey,
    Kind::HelloFlood,
    Kind::SecondOperator,
    Kind::ForgedStop,
    Kind::ReplayedStop,
    Kind::ForgedRenewal,
    Kind::ForeignRenewal,
];

/// What a network in the attacker's hands does to genuine datagrams, each in as many sessions as the others.
pub(super) const HOLD_UPS: [Kind; 16] = [
    Kind::Delayed,
    Kind::DelayedToRobot,
    Kind::DelayedToOperator,
    Kind::Dropped,
    Kind::Reordered,
    Kind::Duplicated,
    Kind::ReleasedAtOnce,
    Kind::ReleasedOneByOne,
    Kind::ReleasedSlowly,
    Kind::KeptOverRestart,
    Kind::KeptOverKeyChange,
    Kind::IdleReleased,
    Kind::TelemetryStarved,
    Kind::HaltAtPress,
    Kind::StopsBetween,
    Kind::KeptOverTakeover,
];

/// What is done to the renewals of a session's keys, each to as many sessions as the others.
pub(super) const RENEWALS: [Kind; 2] = [Kind::RenewalHeldBack, Kind::RenewalReplayed];

/// What is put on the wire beside genuine frames, each in as many sessions as the others.
pub(super) const INTRUSIONS: [Kind; 5] = [
    Kind::ForgedArp,
    Kind::GratuitousArp,
    Kind::ForeignQuestions,
    Kind::NeighbourQuestions,
    Kind::CopiedFrames,
];

/// What is attacked beside a session that stands.
pub(super) const SIEGES: [Kind; 10] = [
    Kind::StopsReplayed,
    Kind::RelayedAtCable,
    Kind::SocketsOfStrangers,
    Kind::SocketsBesideThePage,
    Kind::SilencedThenHeard,
    Kind::ForgedRefusal,
    Kind::ForgedChallenge,
    Kind::ForgedAccept,
    Kind::FlippedToOperator,
    Kind::ReplayedToOperator,
];
