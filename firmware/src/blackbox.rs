//! The black box: what a run leaves behind for the next, in memory that survives a restart.
//!
//! The bytes have two parts, each with a version and a CRC-32. The slow half writes the first, [`RUN`], whenever a fault
//! is latched and once a second; whoever handles a panic writes the second, [`PANIC`]. At the next start [`Kept::decode`]
//! reads both. A chip copies the bytes to memory that a restart leaves alone, the simulator to an array.
//!
//! After power-up such memory holds noise, and a restart may come in the middle of a copy: what does not fit its check sum
//! is nothing.

use core::fmt::{self, Write};
use core::ops::Range;
use core::panic::Location;
use core::time::Duration;

use flix_protocol::message::{
    BuildId, CrashReport, FaultSummary, Faults, MotorCurrents, Name, PanicMessage, ProgramCounters,
    ResetReason,
};
use flix_protocol::units::{Instant, Volts};
use heapless::String;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::fast::exchange::{MotorReport, Report};
use crate::settings::text;
use crate::stored;

/// Bytes of the black box.
pub const BYTES: usize = PANIC.end;
/// What a run leaves while it goes on.
pub const RUN: Range<usize> = 0..RUN_BYTES;
/// What a panic leaves.
pub const PANIC: Range<usize> = RUN_BYTES..RUN_BYTES + PANIC_BYTES;
/// Bytes of [`RUN`].
pub const RUN_BYTES: usize = 96;
/// Bytes of [`PANIC`].
pub const PANIC_BYTES: usize = 224;

/// How often a run notes how long it has lasted.
const INTERVAL: Duration = Duration::from_secs(1);
/// Form of both parts.
const VERSION: u16 = 1;

/// What a run leaves while it goes on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Run {
    version: String<16>,
    build: Option<BuildId>,
    uptime: Instant,
    fault: Option<FaultSummary>,
}

/// Returns the bytes for [`RUN`] of a run of this firmware, in this build, that has just begun: what the first accident after
/// it finds, should the run not come as far as to leave anything by itself.
#[must_use]
pub fn beginning(build: Option<BuildId>) -> [u8; RUN_BYTES] {
    encode(&Run { version: text(env!("CARGO_PKG_VERSION")), build, ..Run::default() })
}

/// What a panic leaves behind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Panic {
    /// [`ResetReason::Panic`] with its place; without a name where the place is unknown.
    reset: ResetReason,
    message: PanicMessage,
    counters: ProgramCounters,
    uptime: Instant,
}

impl Panic {
    /// Notes a panic at this time, with as much of its message as there is room for.
    #[must_use]
    pub fn new(
        time: Instant,
        place: Option<&Location<'_>>,
        message: impl fmt::Display,
        counters: ProgramCounters,
    ) -> Self {
        let unknown = ResetReason::Panic(Name::new());
        let reset = place.map_or(unknown, |place| ResetReason::panic(place.file(), place.line()));
        let mut beginning = Beginning(PanicMessage::new());
        // What does not fit is left out.
        let _ = write!(beginning, "{message}");
        Self { reset, message: beginning.0, counters, uptime: time }
    }

    /// Returns the bytes for [`PANIC`].
    #[must_use]
    pub fn encode(&self) -> [u8; PANIC_BYTES] {
        encode(self)
    }
}

/// Keeps the beginning of what is written, cut between characters.
struct Beginning(PanicMessage);

impl Write for Beginning {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|character| self.0.push(character).map_err(|_| fmt::Error))
    }
}

/// What was found at a start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Kept {
    run: Option<Run>,
    panic: Option<Panic>,
}

impl Kept {
    /// Reads what an earlier run left. Never panics; noise is read as nothing.
    #[must_use]
    pub fn decode(bytes: &[u8; BYTES]) -> Self {
        let (run, panic) = bytes.split_at(RUN_BYTES);
        Self { run: decode(run), panic: decode(panic) }
    }

    /// Returns why a program that asked for a restart did: for a panic, or on request.
    #[must_use]
    pub fn reset_by_software(&self) -> ResetReason {
        self.panic.as_ref().map_or(ResetReason::Requested, |panic| panic.reset.clone())
    }

    /// Returns what there is to report when the robot started for this reason. `None` when power came, for nothing is older
    /// than that, and when the run before met no fault and ended as it should.
    #[must_use]
    pub fn report(self, reset: ResetReason) -> Option<CrashReport> {
        let panic = self.panic.filter(|_| matches!(reset, ResetReason::Panic(_)));
        let fault = self.run.as_ref().and_then(|run| run.fault);
        if reset == ResetReason::PowerOn || !(reset.is_accident() || fault.is_some()) {
            return None;
        }
        let mut report = CrashReport {
            reset,
            message: PanicMessage::new(),
            counters: ProgramCounters::new(),
            version: String::new(),
            build: None,
            uptime: None,
            fault,
        };
        if let Some(Run { version, build, uptime, .. }) = self.run {
            report = CrashReport { version, build, uptime: Some(uptime), ..report };
        }
        if let Some(Panic { message, counters, uptime, .. }) = panic {
            report = CrashReport { message, counters, uptime: Some(uptime), ..report };
        }
        Some(report)
    }
}

/// The black box of a run, and what was found of the run before.
#[derive(Debug, Clone)]
pub(crate) struct BlackBox {
    run: Run,
    crash: Option<CrashReport>,
    /// Whether there is something that [`BlackBox::keep`] has not returned yet.
    is_new: bool,
}

impl BlackBox {
    /// Starts the black box of this version of the firmware.
    pub(crate) fn new(version: &String<16>) -> Self {
        let run = Run { version: version.clone(), ..Run::default() };
        Self { run, crash: None, is_new: true }
    }

    /// Notes which build of the firmware runs.
    pub(crate) fn set_build(&mut self, build: Option<BuildId>) {
        self.run.build = build;
        self.is_new = true;
    }

    /// Notes what was found of the run before.
    pub(crate) fn set_crash(&mut self, crash: Option<CrashReport>) {
        self.crash = crash;
    }

    /// Returns what was found of the run before.
    pub(crate) const fn crash(&self) -> Option<&CrashReport> {
        self.crash.as_ref()
    }

    /// Notes faults that were latched since the last report, and the time.
    pub(crate) fn observe(&mut self, last: &Report, new: &Report) {
        match &mut self.run.fault {
            _ if new.faults == last.faults || new.faults.is_empty() => {}
            Some(fault) if !last.faults.is_empty() => {
                fault.faults = new.faults.iter().fold(fault.faults, Faults::with);
            }
            fault => *fault = Some(summary(last, new)),
        }
        let is_due = new.time.since(self.run.uptime) >= INTERVAL;
        if new.faults != last.faults || is_due {
            self.run.uptime = new.time;
            self.is_new = true;
        }
    }

    /// Returns the bytes for [`RUN`] when they have changed since the last call.
    pub(crate) fn keep(&mut self) -> Option<[u8; RUN_BYTES]> {
        core::mem::take(&mut self.is_new).then(|| encode(&self.run))
    }
}

/// Faults of this report, and how the robot was in the last: what drives no motor any more shows little.
fn summary(last: &Report, new: &Report) -> FaultSummary {
    FaultSummary {
        time: new.time,
        faults: new.faults,
        first_fault: new.first_fault,
        state: last.state,
        frequency: last.frequency.into(),
        direction: last.direction.into(),
        currents: last.motors.map(currents),
        bus_voltage: last.bus_voltage.map(Volts::from),
    }
}

fn currents(motor: MotorReport) -> MotorCurrents {
    MotorCurrents { direct: motor.current_d.into(), quadrature: motor.current_q.into() }
}

fn encode<const LENGTH: usize>(value: &impl Serialize) -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    // The longest values fit, as a test looks; what did not would be read as nothing.
    let _ = stored::encode(VERSION, value, &mut bytes);
    bytes
}

fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    stored::decode(VERSION, bytes).ok()
}

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::ToString;

    use bolero::check;
    use flix_protocol::message::{Fault, PANIC_MESSAGE_LENGTH, PROGRAM_COUNTERS, State};

    use super::*;
    use crate::board::DENGFOC_V3_01;
    use crate::fast::configuration::Configuration;
    use crate::fast::control::Control;
    use crate::settings::Settings;
    use crate::units::{Current, Speed, Voltage};

    const BUILD: BuildId = BuildId([1, 2, 3, 4, 5, 6, 7, 8]);

    fn resting() -> Report {
        Control::new(Configuration::new(&Settings::DEFAULT, &DENGFOC_V3_01.hardware)).report()
    }

    fn running() -> Report {
        let mut report = Report {
            time: Instant::from_micros(2_500_000),
            state: State::Running,
            frequency: Speed::from_hertz(-30.0),
            bus_voltage: Some(Voltage::from_volts(11.5)),
            ..resting()
        };
        report.motors[1].current_q = Current::from_amperes(1.5);
        report
    }

    fn faulted(report: &Report, fault: Fault) -> Report {
        Report {
            time: report.time + Duration::from_millis(1),
            state: State::Faulted,
            faults: report.faults.with(fault),
            first_fault: report.first_fault.or(Some(fault)),
            frequency: Speed::ZERO,
            bus_voltage: None,
            motors: resting().motors,
            ..*report
        }
    }

    fn black_box() -> BlackBox {
        BlackBox::new(&"1.2.3".try_into().unwrap())
    }

    fn bytes(run: &[u8], panic: &[u8]) -> [u8; BYTES] {
        let mut bytes = [0; BYTES];
        bytes[RUN][..run.len()].copy_from_slice(run);
        bytes[PANIC][..panic.len()].copy_from_slice(panic);
        bytes
    }

    #[test]
    fn a_run_that_ends_at_once_is_reported_with_its_firmware() {
        let kept = Kept::decode(&bytes(&beginning(Some(BUILD)), &[]));
        let report = kept.report(ResetReason::Tasks).unwrap();
        assert_eq!(
            (report.version.as_str(), report.build),
            (env!("CARGO_PKG_VERSION"), Some(BUILD))
        );
        assert_eq!((report.uptime, report.fault), (Some(Instant::START), None));
    }

    #[test]
    fn a_fault_is_kept_with_how_the_robot_was_just_before() {
        let mut black_box = black_box();
        black_box.set_build(Some(BUILD));
        let (before, after) = (running(), faulted(&running(), Fault::Stall));
        black_box.observe(&before, &after);
        let both = faulted(&after, Fault::OverCurrent);
        black_box.observe(&after, &both);
        black_box.observe(&both, &Report { faults: both.faults.without(Fault::Stall), ..both });
        let run = black_box.keep().unwrap();
        let report = Kept::decode(&bytes(&run, &[])).report(ResetReason::Other).unwrap();
        assert_eq!((report.version.as_str(), report.build), ("1.2.3", Some(BUILD)));
        assert_eq!(report.uptime, Some(Instant::from_micros(2_502_000)));
        let fault = report.fault.unwrap();
        assert_eq!(fault.time, Instant::from_micros(2_501_000));
        assert_eq!(fault.faults, Faults::NONE.with(Fault::Stall).with(Fault::OverCurrent));
        assert_eq!((fault.first_fault, fault.state), (Some(Fault::Stall), State::Running));
        assert!((fault.frequency.get() + 30.0).abs() < 0.01, "{fault:?}");
        assert!((fault.currents[1].quadrature.get() - 1.5).abs() < 0.01, "{fault:?}");
        assert!((fault.bus_voltage.unwrap().get() - 11.5).abs() < 0.01, "{fault:?}");
    }

    #[test]
    fn a_later_fault_takes_the_place_of_one_that_was_cleared() {
        let mut black_box = black_box();
        let first = faulted(&running(), Fault::Stall);
        black_box.observe(&running(), &first);
        let cleared = Report { faults: Faults::NONE, first_fault: None, ..running() };
        black_box.observe(&first, &cleared);
        assert_eq!(black_box.run.fault.unwrap().first_fault, Some(Fault::Stall), "still the last");
        black_box.observe(&cleared, &faulted(&cleared, Fault::EncoderLost));
        let fault = black_box.run.fault.unwrap();
        assert_eq!(fault.faults, Faults::NONE.with(Fault::EncoderLost));
        assert_eq!(fault.first_fault, Some(Fault::EncoderLost));
    }

    #[test]
    fn bytes_come_at_the_start_at_a_fault_and_once_a_second() {
        let mut black_box = black_box();
        assert!(black_box.keep().is_some(), "they take the place of those of the run before");
        let mut last = resting();
        let mut kept = 0;
        for milliseconds in 1..=10_000 {
            let new = Report { time: Instant::from_micros(milliseconds * 1_000), ..last };
            black_box.observe(&last, &new);
            kept += u32::from(black_box.keep().is_some());
            last = new;
        }
        assert_eq!(kept, 10);
        black_box.observe(&last, &faulted(&last, Fault::Stall));
        assert!(black_box.keep().is_some());
        assert!(black_box.keep().is_none());
    }

    #[test]
    fn a_panic_is_kept_with_its_message_and_the_run_that_it_ended() {
        let line = line!() + 1;
        let place = Location::caller();
        let counters: ProgramCounters = [0x4200_1234, 0x4080_0010].into_iter().collect();
        let time = Instant::from_micros(9_000_000);
        let long = "\u{e4}".repeat(PANIC_MESSAGE_LENGTH);
        let panic = Panic::new(time, Some(place), &long, counters.clone()).encode();
        let run = black_box().keep().unwrap();
        let kept = Kept::decode(&bytes(&run, &panic));
        let reset = kept.reset_by_software();
        assert!(reset.to_string().ends_with(&format!("blackbox.rs:{line}")), "{reset}");
        let report = kept.report(reset.clone()).unwrap();
        assert_eq!((report.reset, report.counters), (reset, counters));
        assert_eq!(report.message.as_str(), &long[..PANIC_MESSAGE_LENGTH]);
        assert_eq!((report.version.as_str(), report.uptime), ("1.2.3", Some(time)));
        assert_eq!(report.fault, None);
    }

    #[test]
    fn a_panic_before_anything_else_was_kept_is_reported_alone() {
        let panic = Panic::new(Instant::START, None, "early", ProgramCounters::new()).encode();
        let kept = Kept::decode(&bytes(&[], &panic));
        let report = kept.clone().report(kept.reset_by_software()).unwrap();
        assert_eq!((report.message.as_str(), report.version.as_str()), ("early", ""));
    }

    #[test]
    fn only_accidents_and_faults_are_reported_and_none_that_power_ended() {
        let quiet = || Kept { run: Some(Run::default()), panic: None };
        for reset in [ResetReason::PowerOn, ResetReason::Requested, ResetReason::Other] {
            assert_eq!(quiet().report(reset), None);
        }
        for reset in [ResetReason::BrownOut, ResetReason::FastLoop, ResetReason::Tasks] {
            assert_eq!(quiet().report(reset.clone()).map(|it| it.reset), Some(reset));
        }
        let fault = Some(summary(&running(), &faulted(&running(), Fault::Stall)));
        let faulted = || Kept { run: Some(Run { fault, ..Run::default() }), panic: None };
        assert_eq!(faulted().report(ResetReason::Requested).unwrap().fault, fault);
        assert_eq!(faulted().report(ResetReason::PowerOn), None);
    }

    #[test]
    fn a_panic_of_long_ago_is_not_reported_of_another_restart() {
        let panic = Panic::new(Instant::START, None, "old", ProgramCounters::new());
        let kept = Kept { run: None, panic: Some(panic) };
        assert_eq!(kept.report(ResetReason::Tasks).unwrap().message, "");
    }

    #[test]
    fn the_longest_values_fit() {
        let last = Report { time: Instant::from_micros(u64::MAX - 1_000), ..running() };
        let all = Fault::ALL
            .into_iter()
            .fold(last, |report, fault| Report { time: last.time, ..faulted(&report, fault) });
        let run = Run {
            version: "v".repeat(16).as_str().try_into().unwrap(),
            build: Some(BUILD),
            uptime: Instant::from_micros(u64::MAX),
            fault: Some(FaultSummary {
                time: Instant::from_micros(u64::MAX),
                ..summary(&last, &all)
            }),
        };
        assert_eq!(decode(&encode::<RUN_BYTES>(&run)), Some(run));
        let panic = Panic {
            reset: ResetReason::panic(&"n".repeat(99), u32::MAX),
            message: "m".repeat(PANIC_MESSAGE_LENGTH).as_str().try_into().unwrap(),
            counters: [u32::MAX; PROGRAM_COUNTERS].into_iter().collect(),
            uptime: Instant::from_micros(u64::MAX),
        };
        assert_eq!(decode(&panic.encode()), Some(panic));
    }

    #[test]
    fn noise_is_nothing() {
        assert_eq!(Kept::decode(&[0; BYTES]), Kept::default());
        assert_eq!(Kept::decode(&[0xFF; BYTES]), Kept::default());
        check!().with_type::<[u8; BYTES]>().for_each(|noise| {
            assert_eq!(Kept::decode(noise), Kept::default());
        });
    }

    #[test]
    fn a_damaged_byte_makes_its_part_nothing() {
        let panic = Panic::new(Instant::START, None, "whole", ProgramCounters::new()).encode();
        let run = black_box().keep().unwrap();
        let whole = Kept::decode(&bytes(&run, &panic));
        let stored = |part: &[u8]| part.iter().rposition(|byte| *byte != 0).unwrap() + 1;
        for index in (0..stored(&run)).chain(PANIC.start..PANIC.start + stored(&panic)) {
            let mut damaged = bytes(&run, &panic);
            damaged[index] ^= 0x10;
            let mut expected = whole.clone();
            if RUN.contains(&index) {
                expected.run = None;
            } else {
                expected.panic = None;
            }
            assert_eq!(Kept::decode(&damaged), expected, "byte {index}");
        }
    }
}
