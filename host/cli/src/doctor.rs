//! `flix doctor`: finds what is wrong with a set-up, and reports it in sentences.

use std::f64::consts::TAU;
use std::process::ExitCode;
use std::time::{Duration, Instant as Clock};

use flix_protocol::failsafe::{LONGEST_MOVEMENT, SLOWEST_RAMP, longest_command_age, ramp_down};
use flix_protocol::message::{
    Command, MAXIMUM_FREQUENCY, Magnet, Outcome, ResetReason, State, Telemetry,
};
use flix_protocol::units::Instant;

use super::address::RobotArgs;
use super::run::{PoseArgs, battery_low};
use flix_host::commission::motor_name;
use flix_host::link::explain;
use flix_host::link::udp::Connection;
use flix_host::link::{LinkError, RobotLink};
use flix_host::nav::EndReason;
use flix_host::pose::any::Poses;
use flix_host::pose::natnet::NatNetStatistics;
use flix_host::pose::udp::UdpStatistics;
use flix_host::pose::{LATE, PoseError, PoseSample, PoseSource, rate};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::printable;
use flix_shell::output::{print, print_json, waiting};
use flix_shell::{Error, Exit};

/// Time for which poses and telemetry are observed.
const WATCH: Duration = Duration::from_secs(2);
/// Largest difference of the two clocks, as a share.
const CLOCK_DRIFT: f64 = 0.02;
/// Jitter of the telemetry, s.
const TELEMETRY_JITTER: f64 = 0.1;
/// Largest share of an encoder's readings that may be dropped or corrected: one in 30 that is 5.6 degrees off costs 0.4 W.
const BAD_READINGS: f64 = 1e-3;
/// Longest good round trip.
const LONG_ROUND_TRIP: Duration = Duration::from_millis(100);

/// Check a set-up: robot, link, battery, clock, and poses.
///
/// Nothing moves. The exit code is 0 without a problem, and that of the first problem otherwise.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix doctor walker-3f2c --natnet-server 192.168.1.5
  flix doctor --json                         (against flix-sim serve --natnet)")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    poses: PoseArgs,
    /// Do not check the poses.
    #[arg(long, conflicts_with_all = ["pose", "natnet_server"])]
    no_poses: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Result of one check.
#[derive(Debug, Clone, serde::Serialize)]
struct Finding {
    what: &'static str,
    ok: bool,
    sentence: String,
    #[serde(skip)]
    exit: Option<Exit>,
}

impl Finding {
    fn good(what: &'static str, sentence: impl std::fmt::Display) -> Self {
        Self { what, ok: true, sentence: sentence.to_string(), exit: None }
    }

    fn bad(what: &'static str, exit: Exit, sentence: impl std::fmt::Display) -> Self {
        Self { what, ok: false, sentence: sentence.to_string(), exit: Some(exit) }
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut findings = look_at_robot(&args.robot, &interrupt);
    if !args.no_poses {
        findings.extend(look_at_poses(&args.poses, &interrupt));
    }
    // What was seen of half a check is no diagnosis.
    if interrupt.is_raised() {
        return Err(LinkError::Interrupted.into());
    }
    if args.json {
        print_json(&findings)?;
    } else {
        let mut text = String::new();
        for finding in &findings {
            let mark = if finding.ok { "ok" } else { "!!" };
            text.push_str(&format!("{mark}  {:<9} {}\n", finding.what, finding.sentence));
        }
        print(&text)?;
    }
    let trouble = findings.iter().filter_map(|f| f.exit).collect::<Vec<_>>();
    match trouble.first() {
        None => Ok(Exit::Done.into()),
        Some(exit) => Err(Error::new(*exit, format_args!("{} found", count(trouble.len())))),
    }
}

fn count(things: usize) -> String {
    if things == 1 { "1 problem".to_owned() } else { format!("{things} problems") }
}

fn look_at_robot(robot: &RobotArgs, interrupt: &Interrupt) -> Vec<Finding> {
    let mut connection = match robot.connect(interrupt) {
        Ok(connection) => connection,
        // The sentence names key, version, second operator or silence.
        Err(error) => return vec![Finding::bad("robot", error.exit, error.sentence)],
    };
    let mut findings = identity(&mut connection);
    findings.extend(movement(&mut connection));
    findings.extend(brakes(&mut connection));
    // A robot that does not answer now is silent below, too.
    let low = battery_low(&mut connection).ok().flatten();
    let begin = Clock::now();
    let first = connection.client().telemetry().copied();
    let watched = waiting("two seconds of telemetry", || watch(&mut connection, interrupt));
    if let Err(error) = watched {
        findings.push(Finding::bad("link", Exit::NoAnswer, error));
        return findings;
    }
    findings.push(link(&connection));
    findings.extend(supply(&mut connection));
    findings.extend(telemetry(&connection, first, begin.elapsed(), low));
    connection.leave();
    findings
}

fn watch(connection: &mut Connection, interrupt: &Interrupt) -> Result<(), LinkError> {
    let begin = Clock::now();
    while begin.elapsed() < WATCH && !interrupt.is_raised() {
        connection.step(Duration::from_millis(20))?;
        while connection.operate().0.update().is_some() {}
    }
    Ok(())
}

fn identity(connection: &mut Connection) -> Vec<Finding> {
    let answer = connection.ask(Command::Identify);
    let operator = connection
        .client()
        .telemetry()
        .map_or_else(String::new, |it| format!(" of {}", it.operator));
    let identity = match answer {
        Ok(Outcome::Identity(identity)) => identity,
        Ok(_) => {
            let sentence = "its answer does not fit the request";
            return vec![Finding::bad("robot", Exit::Refused, sentence)];
        }
        Err(error) => return vec![Finding::bad("robot", Exit::NoAnswer, error)],
    };
    let [name, board, version] =
        [identity.name.as_str(), &identity.board, &identity.version].map(printable);
    let sentence = format!("{name} on {board}, firmware {version}; key{operator} and version fit");
    vec![Finding::good("robot", sentence), judge_reset(&identity.reset)]
}

/// Asks for a setting; a robot of another kind has no such one.
fn setting(connection: &mut Connection, name: &str) -> Option<f32> {
    Some(connection.parameter(name).ok()?.value)
}

/// Asks for the settings by which the rotors come to rest.
fn movement(connection: &mut Connection) -> Option<Finding> {
    let mut value = |name: &str| setting(connection, name);
    Some(judge_movement(value("command_age")?, value("frequency_ramp")?))
}

/// Asks for the motors' settings, and states what a fault drives through them.
fn brakes(connection: &mut Connection) -> Option<Finding> {
    let mut value = |name: &str| setting(connection, name);
    let pole_pairs = value("pole_pairs")?;
    let mut most = 0.0_f64;
    for motor in [0, 1].map(motor_name) {
        let mut value = |name: &str| value(&format!("{motor}_{name}"));
        let (resistance, inductance) = (value("phase_resistance")?, value("phase_inductance")?);
        let flux = value("flux_linkage")?;
        most = most.max(braking_current(resistance, inductance, flux, pole_pairs));
    }
    let sentence = format_args!(
        "a fault at {MAXIMUM_FREQUENCY} shorts the motors: {most:.1} A for a moment; choose bridges that bear it"
    );
    Some(Finding::good("brakes", sentence))
}

/// Returns the current of a phase that is shorted at the fastest f, A: of ohm, mH and mWb.
fn braking_current(resistance: f32, inductance: f32, flux: f32, pole_pairs: f32) -> f64 {
    let [resistance, inductance, flux] = [resistance, inductance, flux].map(f64::from);
    let speed = TAU * f64::from(MAXIMUM_FREQUENCY.get()) * f64::from(pole_pairs);
    1e-3 * speed * flux / resistance.hypot(1e-3 * speed * inductance)
}

/// States whether the windings burn what the rotors give while f falls, where the robot does not measure its battery: elsewhere
/// over-voltage is a fault.
fn supply(connection: &mut Connection) -> Option<Finding> {
    if connection.client().telemetry()?.bus_voltage.is_some() {
        return None;
    }
    let mut value = |name: &str| setting(connection, name);
    let (inertia, limit) = (value("rotor_inertia")?, value("current_limit")?);
    let ramp = value("frequency_ramp")?.max(SLOWEST_RAMP);
    let mut resistance = |motor: usize| value(&format!("{}_phase_resistance", motor_name(motor)));
    let smallest = resistance(0)?.min(resistance(1)?);
    let least = burning_resistance(inertia, ramp, limit);
    let sentence = if f64::from(smallest) >= least {
        "the windings burn what the rotors give while f falls: a battery or a bench supply feeds it"
            .to_owned()
    } else {
        format!(
            "{smallest} ohm burn too little of what the rotors give while f falls by {ramp:.0} Hz/s ({least:.2} ohm do): feed it from a \
             battery, as it lifts a bench supply"
        )
    };
    Some(Finding::good("supply", sentence))
}

/// Returns the phase resistance, ohm, from which on a motor at its limits burns what its rotor gives at the fastest f,
/// `3/2 R (7/8 limit)^2 = J w dw/dt`: of g cm^2, Hz/s and A.
fn burning_resistance(inertia: f32, ramp: f32, limit: f32) -> f64 {
    let [inertia, ramp, limit] = [inertia, ramp, limit].map(f64::from);
    let power = 1e-7 * inertia * TAU * f64::from(MAXIMUM_FREQUENCY.get()) * TAU * ramp;
    power / (1.5 * (0.875 * limit).powi(2))
}

/// Half of the unit in which an age of commands counts, s.
const HALF_MILLISECOND: f64 = 5e-4;

/// States for how long the rotors turn at most after the last intent to move.
fn judge_movement(command_age: f32, frequency_ramp: f32) -> Finding {
    let most = f64::from(command_age) + ramp_down(frequency_ramp).as_secs_f64();
    // Up, so that what is too long reads so; an age counts to the nearest millisecond.
    let shown = ((most - HALF_MILLISECOND) * 100.0).ceil() / 100.0;
    let sentence = format!(
        "the rotors rest at most {shown:.2} s after your last command, whatever the network does \
         (command_age {command_age} s, frequency_ramp {frequency_ramp} Hz/s)"
    );
    let limit = LONGEST_MOVEMENT.as_secs_f64();
    if most <= limit + HALF_MILLISECOND {
        return Finding::good("movement", sentence);
    }
    let longest = longest_command_age(frequency_ramp).as_secs_f64();
    let sentence = format_args!(
        "{sentence}, more than {limit} s: the robot does not arm: `flix parameters set command_age {longest}`"
    );
    Finding::bad("movement", Exit::NotNow, sentence)
}

fn judge_reset(reset: &ResetReason) -> Finding {
    match explain::reset(reset) {
        Some(advice) => Finding::bad(
            "reset",
            Exit::RobotFault,
            format_args!("started after {reset}: {advice}; `flix crash` shows more"),
        ),
        None => Finding::good("reset", format_args!("started after {reset}")),
    }
}

fn link(connection: &Connection) -> Finding {
    let statistics = connection.client().statistics();
    let (Some(middle), Some(late)) =
        (statistics.round_trip_quantile(0.5), statistics.round_trip_quantile(0.99))
    else {
        return Finding::bad("link", Exit::NoAnswer, "no round trip came back");
    };
    let sentence = format!(
        "round trip {:.1} ms, 99 % within {:.1} ms, {:.1} % of the commands unanswered",
        middle.as_secs_f64() * 1e3,
        late.as_secs_f64() * 1e3,
        statistics.loss() * 1e2
    );
    if late > LONG_ROUND_TRIP || statistics.loss() > 0.2 {
        let advice = "move nearer to the access point, or use a channel with less traffic";
        return Finding::bad("link", Exit::NoAnswer, format_args!("{sentence}: {advice}"));
    }
    Finding::good("link", sentence)
}

fn telemetry(
    connection: &Connection,
    first: Option<Telemetry>,
    watched: Duration,
    low: Option<f32>,
) -> Vec<Finding> {
    let Some(telemetry) = connection.client().telemetry() else {
        return vec![Finding::bad("state", Exit::NoAnswer, "the robot sends no telemetry")];
    };
    let since_first = first.map(|first| {
        let clock = judge_clock(telemetry, telemetry.time.since(first.time), watched);
        judge_encoders(&first, telemetry).into_iter().chain([clock])
    });
    let now = [judge_state(telemetry), judge_battery(telemetry, low)];
    now.into_iter().chain(since_first.into_iter().flatten()).collect()
}

/// Looks at what the encoders say of their magnets, and at their readings between two moments.
fn judge_encoders(first: &Telemetry, last: &Telemetry) -> [Finding; 2] {
    let ticks = last.timing.ticks.wrapping_sub(first.timing.ticks).max(1);
    [("top encoder", 0), ("bottom encoder", 1)].map(|(name, motor)| {
        let (before, now) = (first.encoders[motor], last.encoders[motor]);
        let [dropped, corrected] = [
            now.dropped.wrapping_sub(before.dropped),
            now.corrected.wrapping_sub(before.corrected),
        ];
        let counts = format!(
            "{dropped} readings dropped and {corrected} corrected in {ticks} ticks, {} and {} since power-on",
            now.dropped, now.corrected
        );
        let bad = |sentence: String| Finding::bad(name, Exit::RobotFault, sentence);
        if now.magnet != Magnet::Good {
            return bad(format!("{}; {counts}", explain::magnet(now.magnet)));
        }
        let share = |count: u32| f64::from(count) / ticks as f64;
        if share(dropped) > BAD_READINGS || share(corrected) > BAD_READINGS {
            return bad(format!(
                "{counts}: keep its wires short and away from the motor's, and check plugs and supply"
            ));
        }
        Finding::good(name, counts)
    })
}

fn judge_state(telemetry: &Telemetry) -> Finding {
    let bad = |sentence: String| Finding::bad("state", Exit::RobotFault, sentence);
    if telemetry.state == State::Faulted || !telemetry.faults.is_empty() {
        bad(format!("faulted: {}; remove the cause, then `flix clear`", telemetry.faults))
    } else if let Some(by) = telemetry.stopped_by {
        Finding::bad("state", Exit::Stopped, LinkError::StoppedBy(by))
    } else if telemetry.stopped {
        Finding::bad("state", Exit::Stopped, "a stop is latched: `flix clear` clears it")
    } else {
        Finding::good("state", format_args!("{}, no faults", telemetry.state))
    }
}

/// `low`: the voltage below which the robot calls its battery low, V.
fn judge_battery(telemetry: &Telemetry, low: Option<f32>) -> Finding {
    match telemetry.bus_voltage.map(|volts| volts.get()) {
        Some(volts) if low.is_some_and(|low| volts < low) => {
            let sentence = format_args!("{volts:.1} V: charge it");
            Finding::bad("battery", Exit::RobotFault, sentence)
        }
        Some(volts) => Finding::good("battery", format_args!("{volts:.1} V")),
        None => Finding::good("battery", "not measured on this board"),
    }
}

/// Compares the time on the robot's clock with the observed time.
fn judge_clock(telemetry: &Telemetry, reported: Duration, watched: Duration) -> Finding {
    let ratio = reported.as_secs_f64() / watched.as_secs_f64();
    if (ratio - 1.0).abs() > CLOCK_DRIFT + TELEMETRY_JITTER / watched.as_secs_f64() {
        let advice = "its processor is too slow, or the link delays telemetry";
        let sentence = format_args!(
            "the robot's clock runs at {ratio:.2} of the speed of this computer's: {advice}"
        );
        return Finding::bad("clock", Exit::RobotFault, sentence);
    }
    Finding::good(
        "clock",
        format_args!("runs as this computer's ({} overruns)", telemetry.timing.overruns),
    )
}

/// Returns the newest pose of a while.
fn watch_poses(source: &mut Poses, interrupt: &Interrupt) -> Result<Option<PoseSample>, PoseError> {
    let begin = Clock::now();
    let mut newest = None;
    while begin.elapsed() < WATCH && !interrupt.is_raised() {
        match source.poll(Instant::START + begin.elapsed())? {
            Some(sample) => newest = Some(sample),
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    Ok(newest)
}

fn look_at_poses(args: &PoseArgs, interrupt: &Interrupt) -> Vec<Finding> {
    let mut source = match args.open() {
        Ok(source) => source,
        Err(error) => return vec![Finding::bad("poses", error.exit, error.sentence)],
    };
    let name = match &source {
        Poses::NatNet(natnet) => {
            let info = natnet.server();
            let stream = if info.connection.multicast {
                format!("multicast {}:{}", info.multicast_group(), info.connection.data_port)
            } else {
                "unicast".to_owned()
            };
            let name = printable(&info.application_name);
            format!("{name}, NatNet {}, {stream}", natnet.version())
        }
        Poses::Udp(_) => source.name(),
    };
    let mut findings = vec![Finding::good("server", name)];
    let begin = Clock::now();
    let newest = match waiting("two seconds of poses", || watch_poses(&mut source, interrupt)) {
        Ok(newest) => newest,
        Err(error) => return vec![Finding::bad("poses", Exit::NoAnswer, error)],
    };
    let watched = begin.elapsed().as_secs_f64();
    findings.push(match &source {
        Poses::NatNet(source) => judge_stream(source.statistics(), watched, source.bodies()),
        Poses::Udp(source) => judge_datagrams(source.statistics(), watched),
    });
    let late = newest.and_then(|sample| sample.picture).map(|picture| picture.late);
    if let Some(late) = late.filter(|late| *late > LATE) {
        findings.push(Finding::bad("pose", Exit::NoAnswer, EndReason::PosesLate { late }));
    } else if newest.is_some_and(|sample| !sample.valid) && findings.iter().all(|it| it.ok) {
        let text =
            "not trusted: poses have to come without pauses, 100 a second, and not in bursts";
        findings.push(Finding::bad("pose", Exit::NoAnswer, text));
    }
    if let Some(sample) = newest.filter(|s| s.valid) {
        let floor = sample.pose.on_the_floor();
        // Rounded to what is shown; nothing has no sign.
        let [x, y, height] = [floor.x, floor.y, sample.pose.position.z]
            .map(|metres| (metres * 1e3).round() / 1e3 + 0.0);
        let heading = floor.heading.to_degrees().round() + 0.0;
        let place = format!("at {x:.3},{y:.3} m, {height:.3} m high, heading {heading:.0} degrees");
        findings.push(match sample.pose.floating(source.is_planar()) {
            None => Finding::good("pose", place),
            Some(trouble) => Finding::bad("pose", Exit::Usage, format_args!("{place}: {trouble}")),
        });
    }
    findings
}

/// What every source of poses counts alike.
fn judge_poses(
    untracked: u64,
    jumps: u64,
    spread: Duration,
    count: u64,
    watched: f64,
) -> Result<String, String> {
    if untracked > 0 {
        return Err(format!(
            "the cameras lost the robot in {untracked} of {count} frames: clean or add markers, check occlusion"
        ));
    }
    if jumps > 0 {
        return Err(format!(
            "{jumps} poses jump farther than a robot can move: let nobody carry the robot, check for swapped markers, \
             and for a second sender of poses on this network"
        ));
    }
    let rate = count as f64 / watched;
    if rate::is_too_low(rate) {
        return Err(EndReason::TooFewPoses { rate }.to_string());
    }
    let cost = rate::cost(rate).map_or_else(String::new, |cost| format!("; {cost}"));
    let delays = match spread.as_millis() {
        0 => String::new(),
        spread => format!(", delays differ by up to {spread} ms"),
    };
    Ok(format!("{rate:.0} per second, all tracked{delays}{cost}"))
}

fn judge_datagrams(seen: UdpStatistics, watched: f64) -> Finding {
    let bad = |sentence: String| Finding::bad("poses", Exit::NoAnswer, sentence);
    if seen.poses + seen.unreadable == 0 {
        return bad("no datagram arrives: let the tracker send to this computer and port; for a tracker on another \
                    computer, name the network card here that reaches it with --interface"
            .to_owned());
    }
    if let Some(stranger) = seen.stranger {
        return bad(format!(
            "a second sender, {stranger}, sends poses too ({} datagrams, all dropped): stop it",
            seen.strangers
        ));
    }
    if let Some(unit) = seen.unit {
        return bad(unit.to_string());
    }
    if seen.unreadable > 0 {
        return bad(format!(
            "{} datagrams are no pose: write six numbers, x y z roll pitch yaw in metres and radians, or \
             {{\"x\": 0.5, \"y\": 0.2, \"yaw\": 1.57}} with at least these three, and no others than z, roll, pitch, valid and time",
            seen.unreadable
        ));
    }
    match judge_poses(seen.untracked, seen.jumps, seen.spread, seen.poses, watched) {
        Ok(praise) => Finding::good("poses", praise),
        Err(_) if seen.out_of_order > seen.poses => bad(format!(
            "{} of {} datagrams state a time that is not after the one before, or far ahead: state each picture's own, in seconds with their \
             fraction, or none",
            seen.out_of_order,
            seen.out_of_order + seen.poses
        )),
        Err(sentence) => bad(sentence),
    }
}

fn judge_stream(seen: NatNetStatistics, watched: f64, bodies: &[(String, i32)]) -> Finding {
    let bad = |sentence: String| Finding::bad("poses", Exit::NoAnswer, sentence);
    let names: Vec<_> = bodies.iter().map(|(name, id)| format!("\"{name}\" ({id})")).collect();
    // The server's other answers are no frames.
    let is_silent = seen.frames + seen.unreadable == 0;
    if let Some(stranger) = seen.stranger.filter(|_| is_silent) {
        return bad(format!(
            "the server answers, but the frames come from {stranger}: if that is Motive's computer, give it as \
             --natnet-server; if not, somebody forges poses: use a network of its own for the cameras"
        ));
    }
    if is_silent {
        return bad("the server answers, but no frame arrives: check that Motive is live and not paused, that its \
                    streaming interface is the card that reaches this computer (not loopback), and that \
                    no firewall blocks UDP port 1511; with several network cards here, name one with --interface"
            .to_owned());
    }
    if let Some(stranger) = seen.stranger {
        return bad(format!(
            "{stranger} sends poses beside the server ({} datagrams, all dropped): stop it, or use a network of \
             its own for the cameras",
            seen.strangers
        ));
    }
    if seen.unreadable > seen.frames {
        return bad(format!(
            "{} datagrams could not be read: the stream has another NatNet version than the server announces",
            seen.unreadable
        ));
    }
    if seen.without_body == seen.frames {
        return bad(format!(
            "{} frames, none with the robot's rigid body; {}",
            seen.frames,
            if names.is_empty() {
                "none is streamed: make one from the robot's markers in Motive and switch on its streaming"
                    .to_owned()
            } else {
                format!("streamed are {}: choose with --body", names.join(", "))
            }
        ));
    }
    match judge_poses(seen.untracked, seen.jumps, seen.spread, seen.frames, watched) {
        Ok(praise) => Finding::good("poses", format_args!("{praise}, {} lost", seen.lost)),
        Err(sentence) => bad(sentence),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen() -> NatNetStatistics {
        NatNetStatistics { datagrams: 240, frames: 240, ..NatNetStatistics::default() }
    }

    #[test]
    fn a_good_stream_is_found_good() {
        assert!(judge_stream(seen(), 2.0, &[]).ok);
    }

    #[test]
    fn delays_that_differ_are_shown() {
        let seen = NatNetStatistics { spread: Duration::from_micros(12_700), ..seen() };
        let sentence = judge_stream(seen, 2.0, &[]).sentence;
        assert_eq!(sentence, "120 per second, all tracked, delays differ by up to 12 ms, 0 lost");
    }

    #[test]
    fn every_trouble_of_a_stream_has_its_own_advice() {
        let bodies = [("drone".to_owned(), 4)];
        let stranger = Some([10, 0, 0, 7].into());
        for (statistics, advice) in [
            (NatNetStatistics::default(), "loopback"),
            (NatNetStatistics { without_body: 240, ..seen() }, "\"drone\" (4)"),
            (NatNetStatistics { untracked: 3, ..seen() }, "markers"),
            (NatNetStatistics { frames: 16, ..seen() }, "the fewest"),
            (NatNetStatistics { jumps: 2, ..seen() }, "second sender"),
            (NatNetStatistics { strangers: 9, stranger, ..seen() }, "10.0.0.7 sends poses"),
            (
                NatNetStatistics { strangers: 9, stranger, ..NatNetStatistics::default() },
                "come from 10.0.0.7",
            ),
            (NatNetStatistics { frames: 0, unreadable: 240, ..seen() }, "version"),
        ] {
            let finding = judge_stream(statistics, 2.0, &bodies);
            assert!(!finding.ok && finding.sentence.contains(advice), "{finding:?}");
        }
        // Its list of bodies alone arrives; frames without any body.
        let paused = NatNetStatistics { datagrams: 7, ..NatNetStatistics::default() };
        for (statistics, advice) in
            [(paused, "paused"), (NatNetStatistics { without_body: 240, ..seen() }, "make one")]
        {
            let sentence = judge_stream(statistics, 2.0, &[]).sentence;
            assert!(sentence.contains(advice) && !sentence.contains("--body"), "{sentence}");
        }
    }

    #[test]
    fn every_trouble_of_datagrams_has_its_own_advice() {
        let seen = UdpStatistics { poses: 240, ..UdpStatistics::default() };
        assert!(judge_datagrams(seen, 2.0).ok);
        let slow = judge_datagrams(UdpStatistics { poses: 60, ..seen }, 2.0);
        assert!(slow.ok && slow.sentence.contains("later"), "{slow:?}");
        let stranger = Some([10, 0, 0, 7].into());
        for (statistics, advice) in [
            (UdpStatistics::default(), "--interface"),
            (UdpStatistics { unreadable: 3, ..seen }, "roll pitch yaw"),
            (UdpStatistics { untracked: 3, ..seen }, "markers"),
            (UdpStatistics { jumps: 2, ..seen }, "second sender"),
            (UdpStatistics { poses: 16, ..seen }, "the fewest"),
            (UdpStatistics { strangers: 9, stranger, ..seen }, "10.0.0.7"),
        ] {
            let finding = judge_datagrams(statistics, 2.0);
            assert!(!finding.ok && finding.sentence.contains(advice), "{finding:?}");
        }
    }

    #[test]
    fn every_trouble_of_a_robot_has_its_own_advice() {
        use crate::walked::telemetry;
        use flix_protocol::message::{Fault, Faults};
        use flix_protocol::units::Volts;
        let well = Telemetry { faults: Faults::NONE, first_fault: None, ..telemetry(1.0) };
        let faults = Faults::NONE.with(Fault::Stall);
        let empty = Volts::new(9.7).ok();
        let two = Duration::from_secs(2);
        for (finding, advice) in [
            (judge_state(&Telemetry { state: State::Faulted, faults, ..well }), "flix clear"),
            (judge_state(&Telemetry { stopped: true, ..well }), "latched"),
            (judge_battery(&Telemetry { bus_voltage: empty, ..well }, Some(9.9)), "9.7 V: charge"),
            (judge_clock(&well, two / 2, two), "0.50 of the speed"),
        ] {
            assert!(!finding.ok && finding.sentence.contains(advice), "{finding:?}");
        }
        // Two full cells are none of three that are empty.
        let two_cells = Telemetry { bus_voltage: Volts::new(8.2).ok(), ..well };
        assert!(judge_battery(&two_cells, Some(6.6)).ok && judge_battery(&two_cells, None).ok);
        assert!(judge_state(&well).ok && judge_battery(&well, Some(9.9)).ok);
        assert!(judge_clock(&well, two, two).ok);
    }

    #[test]
    fn an_encoder_with_a_bad_magnet_or_bad_readings_is_a_finding() {
        use crate::walked::telemetry;
        use flix_protocol::message::{EncoderHealth, LoopTiming};
        let well = Telemetry { encoders: Default::default(), ..telemetry(1.0) };
        let after = |dropped, corrected, magnet| {
            let encoder = EncoderHealth { dropped, corrected, magnet };
            let timing = LoopTiming { ticks: well.timing.ticks + 20_000, ..well.timing };
            Telemetry { timing, encoders: [EncoderHealth::default(), encoder], ..well }
        };
        for (last, advice) in [
            (after(0, 0, Magnet::Weak), "nearer"),
            (after(0, 0, Magnet::Strong), "weaker"),
            (after(0, 0, Magnet::Missing), "no magnet"),
            (after(21, 0, Magnet::Good), "21 readings dropped"),
            (after(0, 670, Magnet::Good), "670 corrected"),
        ] {
            let [top, bottom] = judge_encoders(&well, &last);
            assert!(top.ok && !bottom.ok && bottom.sentence.contains(advice), "{bottom:?}");
        }
        assert!(judge_encoders(&well, &after(20, 20, Magnet::Good)).iter().all(|it| it.ok));
        // What happened before the watch is shown, and is no trouble now.
        let old = after(5_000, 5_000, Magnet::Good);
        assert!(judge_encoders(&old, &old).iter().all(|it| it.ok));
    }

    #[test]
    fn a_robot_whose_rotors_may_turn_for_long_is_a_finding() {
        for (age, ramp, word) in [
            (1.0, 200.0, "1.25 s after"),
            (1.0, 200.0, "command_age 0.6"),
            (0.61, 200.0, "does not arm"),
            (0.601, 200.0, "0.86 s after"),
            (0.46, 20.0, "command_age 0.45"),
        ] {
            let Finding { ok, sentence, .. } = judge_movement(age, ramp);
            assert!(!ok && sentence.contains(word), "{sentence}");
        }
        for (age, ramp, word) in [
            (0.4, 200.0, "0.65 s"),
            (0.6, 200.0, "0.85 s"),
            (0.1, 1e3, "0.21 s"),
            (0.4, 5.0, "0.80 s"),
        ] {
            let Finding { ok, sentence, .. } = judge_movement(age, ramp);
            assert!(ok && sentence.contains(word), "{sentence}");
        }
    }

    #[test]
    fn shorted_motors_carry_their_back_emf_over_their_impedance() {
        assert!((braking_current(2.5, 1.0, 3.0, 7.0) - 1.573).abs() < 1e-3);
        assert!((braking_current(0.15, 0.04, 1.0, 12.0) - 14.388).abs() < 1e-3);
    }

    #[test]
    fn windings_of_a_new_robot_burn_from_0_63_ohm_on() {
        assert!((burning_resistance(105.0, 200.0, 2.0) - 0.632).abs() < 1e-3);
        assert!((burning_resistance(105.0, 100.0, 1.0) - 1.263).abs() < 1e-3);
    }

    #[test]
    fn a_robot_that_should_not_have_started_is_a_finding() {
        let panic = ResetReason::panic("src/link.rs", 12);
        for reset in [ResetReason::BrownOut, ResetReason::FastLoop, ResetReason::Tasks, panic] {
            let Finding { ok, sentence, .. } = judge_reset(&reset);
            assert!(!ok && sentence.contains(&reset.to_string()), "{sentence}");
        }
        for reset in [ResetReason::PowerOn, ResetReason::Requested, ResetReason::Other] {
            assert!(judge_reset(&reset).ok, "{reset}");
        }
    }
}
