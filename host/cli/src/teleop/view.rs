//! Draws the [`Cockpit`].
//!
//! ```text
//! name, board, firmware                                       link
//! +- state, faults, gauges ----------+ +- shaker from above -----+
//! |                                  | |                         |
//! +----------------------------------+ +-------------------------+
//! histories of f, theta, currents, battery
//! log
//! keys
//! ```
//!
//! The smallest size is 80 by 24 characters; a larger terminal shows more of histories and log.
//!
//! Text has the terminal's own colours, or black on a ground of ours: themes give the sixteen named colours any value, and their
//! bright black may be that of the ground. Bars, curves and drawings have colours of the 256 that no theme changes, with a contrast
//! of at least 3 (WCAG 2.2, 1.4.11) on white, black and both grounds of Solarized, and pairs that the colour-blind tell apart.

use std::f32::consts::PI;
use std::time::Duration;

use flix_protocol::message::{MAXIMUM_DIRECTION, MAXIMUM_FREQUENCY, State, Telemetry};
use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line as Stroke, Points, Rectangle};
use ratatui::widgets::{Block, BorderType, Paragraph, Sparkline, Wrap};

use flix_host::link::explain;
use flix_host::nav::Area;
use flix_host::teleop::cockpit::{Cockpit, Link, SLOW_MOTION, Sample, Weight};
use flix_host::teleop::floor::Floor;

/// Smallest size of the whole picture, characters.
pub const SMALLEST: (u16, u16) = (80, 24);

const BLACK: Color = Color::Indexed(16);
const GREY: Color = Color::Indexed(245);
const GREEN: Color = Color::Indexed(64);
const AMBER: Color = Color::Indexed(136);
const RED: Color = Color::Indexed(196);
const BLUE: Color = Color::Indexed(69);
/// Of top and bottom motor.
pub const ROTORS: [Color; 2] = [BLUE, Color::Indexed(133)];
/// f and theta as they are measured: near the colour of the plots and the page.
pub const FORCE: Color = Color::Indexed(166);
/// Of the curves of a capture.
pub const SERIES: [Color; 8] = {
    use Color::Indexed;
    [
        Indexed(105),
        Indexed(130),
        Indexed(29),
        Indexed(96),
        Indexed(172),
        Indexed(62),
        Indexed(36),
        Indexed(139),
    ]
};
/// Style of less important text.
pub(crate) const FAINT: Style = Style::new().add_modifier(Modifier::DIM);
const STRONG: Style = Style::new().add_modifier(Modifier::BOLD);

/// Smallest width of state, faults and gauges, characters.
const ROBOT_WIDTH: u16 = 44;
/// Smallest width of the map or the shaker, characters.
const SMALLEST_PICTURE: u16 = 36;
/// Room around the way of the robot on the map, m.
const MAP_MARGIN: f64 = 0.3;
/// Length of the robot on the map, m (paper, Table I).
const ROBOT_LENGTH: f64 = 0.22;

/// Voltages of a cell: empty, low and full, V.
const CELL: [f32; 3] = [3.0, 3.3, 4.2];
/// Cells that are taken until the robot has stated the voltage of its low battery.
const ASSUMED_CELLS: f32 = 3.0;
/// Width of the time before a line of the log, characters.
const LOG_INDENT: usize = 9;
/// Loss above which it is shown in red.
const POOR_LOSS: f64 = 0.1;
/// Time before a robot without an operator rests from which on it is shown.
const COUNTED: Duration = Duration::from_secs(15);

/// Draws everything.
pub fn draw(frame: &mut Frame<'_>, cockpit: &Cockpit) {
    let area = frame.area();
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        draw_small(frame, area, cockpit);
        return;
    }
    // Of what is more than needed, half goes to the shaker until it is large enough.
    let spare = (area.height - SMALLEST.1) / 2;
    let middle_height = 13 + spare.min(10);
    let [head, middle, histories, log, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(middle_height),
        Constraint::Length(5),
        Constraint::Min(3),
        Constraint::Length(2),
    ])
    .areas(area);
    let picture = 10 + 2 * middle_height;
    // A narrow terminal has room for one picture: the map, where there is one.
    let room = area.width - ROBOT_WIDTH;
    let (map_width, shaker_width) = match &cockpit.floor {
        None => (0, picture),
        Some(_) if room >= 2 * SMALLEST_PICTURE => (picture.min(room / 2), picture.min(room / 2)),
        Some(_) => (picture, 0),
    };
    let [left, map, right] = Layout::horizontal([
        Constraint::Min(ROBOT_WIDTH),
        Constraint::Length(map_width),
        Constraint::Length(shaker_width),
    ])
    .areas(middle);
    draw_head(frame, head, cockpit);
    draw_robot(frame, left, cockpit);
    if let Some(floor) = &cockpit.floor {
        draw_map(frame, map, floor);
    }
    if shaker_width > 0 {
        draw_shaker(frame, right, cockpit);
    }
    draw_histories(frame, histories, cockpit);
    draw_log(frame, log, cockpit);
    draw_keys(frame, keys);
}

/// Draws in a small terminal whether the robot walks, what is wrong, and how to stop it.
fn draw_small(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let mut lines = vec![state_line(cockpit), "space = stop".bold().into()];
    if let Some(telemetry) = &cockpit.telemetry {
        let Sample { frequency, direction, .. } = Sample::of(telemetry);
        let [frequency, direction] = [signed(frequency, 2), signed(direction, 1)];
        lines.push(format!("f {frequency} Hz, theta {direction} deg").into());
    }
    lines.extend(trouble_lines(cockpit));
    lines.push(link_line(cockpit));
    lines.push(Line::styled(
        format!("enlarge the terminal to {} by {}", SMALLEST.0, SMALLEST.1),
        FAINT,
    ));
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: true }), area);
}

fn draw_head(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let mut spans = vec![" flix ".reversed(), format!(" {}", cockpit.robot).bold()];
    if let Some(identity) = &cockpit.identity {
        spans.push(Span::styled(format!("  {}, {}", identity.board, identity.version), FAINT));
    }
    frame.render_widget(Line::from(spans), area);
    frame.render_widget(link_line(cockpit).alignment(Alignment::Right), area);
}

fn link_line(cockpit: &Cockpit) -> Line<'static> {
    let dot = |color| Span::styled(" ● ", Style::new().fg(color));
    match cockpit.link {
        Link::Connected => {
            let round_trip = cockpit
                .round_trip
                .map_or_else(String::new, |it| format!("{:.1} ms ", it.as_secs_f64() * 1e3));
            let loss = format!("loss {:.1} % ", 100.0 * cockpit.loss);
            let loss =
                Span::styled(loss, if cockpit.loss > POOR_LOSS { on(RED) } else { Style::new() });
            Line::from(vec![dot(GREEN), Span::raw(round_trip), loss])
        }
        Link::Silent(silence) => Line::from(vec![
            dot(AMBER),
            format!("silent for {:.1} s ", silence.as_secs_f32()).bold(),
        ]),
        Link::Connecting => Line::from(vec![dot(RED), "connecting again ".bold()]),
        Link::Failed(_) => Line::from(vec![dot(RED), "no link, still trying ".bold()]),
    }
}

fn state_color(state: State) -> Color {
    match state {
        State::Disarmed => GREY,
        State::Aligning | State::Stopping => AMBER,
        State::Armed => BLUE,
        State::Running => GREEN,
        State::Faulted => RED,
    }
}

/// Returns the style of text on a ground of this colour.
pub(crate) const fn on(color: Color) -> Style {
    Style::new().fg(BLACK).bg(color)
}

fn state_line(cockpit: &Cockpit) -> Line<'static> {
    let badge = |text: String, color| {
        Span::styled(format!(" {} ", text.to_uppercase()), on(color).add_modifier(Modifier::BOLD))
    };
    let Some(telemetry) = &cockpit.telemetry else {
        return Line::from(badge("unknown".to_owned(), GREY));
    };
    let state = telemetry.state;
    let color = if cockpit.is_stale() { GREY } else { state_color(state) };
    let mut spans = vec![badge(state.to_string(), color)];
    if cockpit.is_stale() {
        spans.push(" when last received".into());
        return Line::from(spans);
    }
    if cockpit.is_stopping {
        spans.extend([" ".into(), badge("stop is sent".to_owned(), RED)]);
    } else if telemetry.stopped {
        spans.extend([" ".into(), badge("stopped".to_owned(), RED)]);
        let by = telemetry.stopped_by.map_or_else(String::new, |by| format!("by {by}, "));
        spans.push(format!(" {by}c clears it").into());
    } else {
        let words = explain::state(state);
        let meaning = words.split_once(": ").map_or("", |(_, meaning)| meaning);
        spans.push(Span::raw(format!(" {meaning}")));
    }
    Line::from(spans)
}

/// State, faults and gauges.
fn draw_robot(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let block = Block::bordered().border_type(BorderType::Rounded).border_style(FAINT);
    let inside = block.inner(area);
    frame.render_widget(block, area);
    let [state, trouble, gauges] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(3), Constraint::Min(7)])
            .areas(inside);
    frame.render_widget(state_line(cockpit), state);
    frame.render_widget(Paragraph::new(trouble_lines(cockpit)).wrap(Wrap { trim: true }), trouble);
    if let Some(telemetry) = &cockpit.telemetry {
        let width = usize::from(gauges.width);
        frame.render_widget(Paragraph::new(gauge_lines(cockpit, telemetry, width)), gauges);
    }
}

fn trouble_lines(cockpit: &Cockpit) -> Vec<Line<'static>> {
    let Some(telemetry) = &cockpit.telemetry else { return Vec::new() };
    let mut lines = Vec::new();
    if let Some(first) = telemetry.first_fault.or_else(|| telemetry.faults.iter().next()) {
        let others = telemetry.faults.without(first);
        lines.push(Line::from(vec![
            Span::styled(format!("{first}:"), on(RED).add_modifier(Modifier::BOLD)),
            format!(" {}", explain::fault(first)).into(),
        ]));
        if !others.is_empty() {
            lines.push(Line::styled(format!("then {others}"), STRONG));
        }
    } else {
        lines.push(Line::styled("no faults", FAINT));
    }
    if let Some(left) = cockpit.walks_for().filter(|left| *left <= COUNTED) {
        let text = format!("rests in {} s unless a key is pressed", left.as_secs() + 1);
        lines.push(Line::styled(text, on(AMBER)));
    }
    if telemetry.link_late {
        lines.push(Line::styled("commands reach the robot late", on(AMBER)));
    }
    if telemetry.frequency_limited {
        lines.push(Line::styled("voltage or current limits f", on(AMBER)));
    }
    lines
}

fn gauge_lines(cockpit: &Cockpit, telemetry: &Telemetry, width: usize) -> Vec<Line<'static>> {
    let Sample { frequency, direction, currents, battery } = Sample::of(telemetry);
    let bar = width.saturating_sub(20);
    let row = |name: &str, bar: Vec<Span<'static>>, value: String| {
        let mut spans = vec![Span::raw(format!("{name:<8}"))];
        spans.extend(bar);
        spans.push(Span::styled(format!("{value:>12}"), Style::new().bold()));
        Line::from(spans)
    };
    let (most_f, most_theta) = (MAXIMUM_FREQUENCY.get(), MAXIMUM_DIRECTION.get());
    let setpoint = cockpit.setpoint;
    let current = |name: &str, current: f32, color: Color| {
        let share = current / cockpit.current_limit;
        let color = if share > 0.9 { RED } else { color };
        row(name, filled(share, bar, color), format!("{current:.2} A"))
    };
    let (empty, full) = battery_range(cockpit);
    let is_low = battery.zip(cockpit.battery_low).is_some_and(|(voltage, low)| voltage < low);
    let battery_color = if is_low { RED } else { GREEN };
    vec![
        row(
            "f",
            centred(frequency / most_f, setpoint.frequency().get() / most_f, bar, FORCE),
            format!("{} Hz", signed(frequency, 2)),
        ),
        row(
            "theta",
            centred(direction / most_theta, setpoint.direction().get() / most_theta, bar, FORCE),
            format!("{} deg", signed(direction, 1)),
        ),
        current("top", currents[0], ROTORS[0]),
        current("bottom", currents[1], ROTORS[1]),
        row(
            "duty",
            filled(telemetry.modulation.get(), bar, GREY),
            format!("{:.0} %", 100.0 * telemetry.modulation.get()),
        ),
        row(
            "battery",
            filled(battery.map_or(0.0, |it| (it - empty) / (full - empty)), bar, battery_color),
            battery.map_or_else(|| "not measured".to_owned(), |it| format!("{it:.2} V")),
        ),
        Line::styled(
            format!(
                "loop up to {} us, {} overruns",
                telemetry.timing.longest_interval_us, telemetry.timing.overruns
            ),
            FAINT,
        ),
    ]
}

/// A bar from the left; `share` from 0 to 1.
fn filled(share: f32, width: usize, color: Color) -> Vec<Span<'static>> {
    let full = (share.clamp(0.0, 1.0) * width as f32).round() as usize;
    vec![
        Span::styled("█".repeat(full), Style::new().fg(color)),
        Span::styled("·".repeat(width - full), FAINT),
    ]
}

/// A bar from the middle, with a mark at what is commanded; shares from -1 to 1.
fn centred(share: f32, commanded: f32, width: usize, color: Color) -> Vec<Span<'static>> {
    let last = width.saturating_sub(1);
    let place = |share: f32| ((share.clamp(-1.0, 1.0) + 1.0) / 2.0 * last as f32).round() as usize;
    let (middle, end, mark) = (place(0.0), place(share), place(commanded));
    (0..width)
        .map(|cell| {
            let is_filled = (middle.min(end)..=middle.max(end)).contains(&cell) && end != middle;
            match cell {
                _ if cell == mark => Span::styled("◆", Style::new().bold()),
                _ if is_filled => Span::styled("█", Style::new().fg(color)),
                _ if cell == middle => Span::styled("│", FAINT),
                _ => Span::styled("·", FAINT),
            }
        })
        .collect()
}

/// The floor from above, north up: the way of the robot, its place, its heading and the heading that is held.
fn draw_map(frame: &mut Frame<'_>, area: Rect, floor: &Floor) {
    let block = Block::bordered().border_type(BorderType::Rounded).border_style(FAINT);
    let inside = block.inner(area);
    let bounds = Area::around(floor.way.iter().copied()).widened(MAP_MARGIN);
    let (low, high) = (bounds.low, bounds.high);
    // Two by four dots a character: metres a dot, alike in both directions.
    let [across, up] = [2.0 * f64::from(inside.width), 4.0 * f64::from(inside.height)];
    let scale = ((high.x - low.x) / across).max((high.y - low.y) / up);
    let (x, y) = (0.5 * (low.x + high.x), 0.5 * (low.y + high.y));
    let [half_width, half_height] = [0.5 * scale * across, 0.5 * scale * up];
    let pose = floor.pose;
    let title = format!(" map, {:.1} m wide ", 2.0 * half_width);
    let place = format!(" {:+.2},{:+.2} m {:+.0}° ", pose.x, pose.y, pose.heading.to_degrees());
    let arrow = |context: &mut Context<'_>, heading: f64, length: f64, color| {
        let (sine, cosine) = heading.sin_cos();
        let (x2, y2) = (pose.x + length * cosine, pose.y + length * sine);
        context.draw(&Stroke { x1: pose.x, y1: pose.y, x2, y2, color });
    };
    let canvas = Canvas::default()
        .block(block.title(title).title_bottom(Line::from(place).right_aligned()))
        .marker(Marker::Braille)
        .x_bounds([x - half_width, x + half_width])
        .y_bounds([y - half_height, y + half_height])
        .paint(|context| {
            let way: Vec<_> = floor.way.iter().map(|place| (place.x, place.y)).collect();
            context.draw(&Points { coords: &way, color: GREY });
            if let Some(held) = floor.held() {
                arrow(context, held, 2.0 * ROBOT_LENGTH, GREEN);
            }
            arrow(context, pose.heading, ROBOT_LENGTH, FORCE);
            context.draw(&Circle {
                x: pose.x,
                y: pose.y,
                radius: 0.3 * ROBOT_LENGTH,
                color: FORCE,
            });
        });
    frame.render_widget(canvas, area);
}

/// The robot from above, forward up: plate, rotors and the line of force.
fn draw_shaker(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let mut block = Block::bordered()
        .border_type(BorderType::Rounded)
        .border_style(FAINT)
        .title(" from above ");
    if cockpit.is_slow_motion() {
        block = block
            .title_bottom(Line::from(format!(" slow motion 1:{SLOW_MOTION:.0} ")).right_aligned());
    }
    let inside = block.inner(area);
    // Two by four dots a character; a unit is a dot, so that circles are round.
    let (half_width, half_height) = (f64::from(inside.width), 2.0 * f64::from(inside.height));
    let canvas = Canvas::default()
        .block(block)
        .marker(Marker::Braille)
        .x_bounds([-half_width, half_width])
        .y_bounds([-half_height, half_height])
        .paint(|context| paint_shaker(context, cockpit, half_height));
    frame.render_widget(canvas, area);
}

fn paint_shaker(context: &mut Context<'_>, cockpit: &Cockpit, half_height: f64) {
    // The plate, 120 by 220 mm, and a rotor circle that fills it: not to one scale.
    let (plate, arm) = (half_height - 1.0, 0.62 * half_height);
    context.draw(&Rectangle {
        x: -0.75 * plate,
        y: -plate,
        width: 1.5 * plate,
        height: 2.0 * plate,
        color: GREY,
    });
    context.print(-2.0, plate - 3.0, "▲ front".fg(Color::Reset));
    context.draw(&Circle { x: 0.0, y: 0.0, radius: arm, color: GREY });
    let (Some(telemetry), Some([top, bottom])) = (&cockpit.telemetry, cockpit.shown_rotors())
    else {
        return;
    };
    let fade = |color| if cockpit.is_stale() { GREY } else { color };
    let theta = telemetry.direction.get();
    if telemetry.frequency.get().abs() > 0.1 {
        draw_force(context, theta, top - theta, arm, fade(FORCE));
    }
    for (angle, color) in [(bottom, ROTORS[1]), (top, ROTORS[0])] {
        let (x, y) = on_compass(angle, arm);
        context.draw(&Stroke { x1: 0.0, y1: 0.0, x2: x, y2: y, color: fade(color) });
        context.draw(&Circle { x, y, radius: 2.0, color: fade(color) });
    }
    context.print(-1.2 * half_height, -plate + 4.0, Span::styled("top", on(fade(ROTORS[0]))));
    context.print(-1.2 * half_height, -plate + 0.5, Span::styled("bottom", on(fade(ROTORS[1]))));
}

/// The line of force, faint and whole, and on it the force of this moment.
fn draw_force(context: &mut Context<'_>, theta: f32, phase: f32, arm: f64, color: Color) {
    let reach = 1.25 * arm;
    for step in (-10..=10).filter(|step| step % 2 == 0) {
        let (x, y) = on_compass(theta, reach * f64::from(step) / 10.0);
        context.draw(&Stroke { x1: x, y1: y, x2: x, y2: y, color });
    }
    // Both masses pull along their arms: across the line they cancel.
    let force = f64::from((phase / 180.0 * PI).cos());
    let (x, y) = on_compass(theta, reach * force);
    context.draw(&Stroke { x1: 0.0, y1: 0.0, x2: x, y2: y, color });
}

/// The point at this compass angle and distance: forward is up, right is right.
fn on_compass(degrees: f32, distance: f64) -> (f64, f64) {
    let (sine, cosine) = f64::from(degrees).to_radians().sin_cos();
    (distance * sine, distance * cosine)
}

/// One quantity over time.
struct Curve {
    name: &'static str,
    quantity: fn(&Sample) -> Option<f32>,
    range: (f32, f32),
    value: String,
    color: Color,
}

/// Returns the voltages of the empty and the full battery, V.
fn battery_range(cockpit: &Cockpit) -> (f32, f32) {
    let [empty, low, full] = CELL;
    let cells = cockpit.battery_low.map_or(ASSUMED_CELLS, |stated| stated / low);
    (cells * empty, cells * full)
}

/// Returns a number with its sign; what is shown as nothing has a plus.
fn signed(value: f32, digits: usize) -> String {
    let text = format!("{value:+.digits$}");
    if text.contains(|digit| matches!(digit, '1'..='9')) { text } else { text.replace('-', "+") }
}

/// One row a quantity: name, curve, newest value.
fn draw_histories(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let Some(newest) = cockpit.history.back().copied() else {
        frame.render_widget(Paragraph::new("no telemetry yet").style(FAINT), area);
        return;
    };
    let (f, theta, limit) =
        (MAXIMUM_FREQUENCY.get(), MAXIMUM_DIRECTION.get(), cockpit.current_limit);
    let (empty, full) = battery_range(cockpit);
    let curve = |name, quantity, range, value, color| Curve { name, quantity, range, value, color };
    let rows = [
        curve(
            "f",
            |it| Some(it.frequency),
            (-f, f),
            format!("{} Hz", signed(newest.frequency, 1)),
            FORCE,
        ),
        curve(
            "theta",
            |it| Some(it.direction),
            (-theta, theta),
            format!("{} deg", signed(newest.direction, 0)),
            FORCE,
        ),
        curve(
            "top",
            |it| Some(it.currents[0]),
            (0.0, limit),
            format!("{:.2} A", newest.currents[0]),
            ROTORS[0],
        ),
        curve(
            "bottom",
            |it| Some(it.currents[1]),
            (0.0, limit),
            format!("{:.2} A", newest.currents[1]),
            ROTORS[1],
        ),
        curve(
            "battery",
            |it| it.battery,
            (empty, full),
            newest.battery.map_or_else(String::new, |it| format!("{it:.1} V")),
            GREEN,
        ),
    ];
    let areas = Layout::vertical([Constraint::Length(1); 5]).split(area);
    for (row, area) in rows.into_iter().zip(areas.iter()) {
        let Curve { name, quantity, range, value, color } = row;
        let [label, curve, number] = Layout::horizontal([
            Constraint::Length(9),
            Constraint::Min(10),
            Constraint::Length(10),
        ])
        .areas(*area);
        frame.render_widget(Span::styled(format!(" {name}"), FAINT), label);
        let points = points(cockpit, quantity, range, usize::from(curve.width));
        let style = Style::new().fg(if cockpit.is_stale() { GREY } else { color });
        frame.render_widget(Sparkline::default().data(points).max(STEPS).style(style), curve);
        frame.render_widget(Line::from(value).right_aligned(), number);
    }
}

/// Eight heights a character, and none for nothing.
const STEPS: u64 = 8;

/// The newest points, as many as fit, from 1 at the range's lower end to [`STEPS`] at its upper.
fn points(
    cockpit: &Cockpit,
    quantity: fn(&Sample) -> Option<f32>,
    (least, most): (f32, f32),
    width: usize,
) -> Vec<u64> {
    let skipped = cockpit.history.len().saturating_sub(width);
    cockpit
        .history
        .iter()
        .skip(skipped)
        .map(|sample| {
            quantity(sample).map_or(0, |value| {
                let share = ((value - least) / (most - least)).clamp(0.0, 1.0);
                1 + (share * (STEPS - 1) as f32).round() as u64
            })
        })
        .collect()
}

fn draw_log(frame: &mut Frame<'_>, area: Rect, cockpit: &Cockpit) {
    let width = usize::from(area.width).saturating_sub(LOG_INDENT);
    let mut lines: Vec<Line<'_>> = Vec::new();
    // From the newest upwards, as many as fit.
    for line in cockpit.log.iter().rev().take(usize::from(area.height)) {
        let (mark, style) = match line.weight {
            Weight::Note => (FAINT, Style::new()),
            Weight::Warning => (on(AMBER), Style::new()),
            Weight::Alarm => (on(RED), STRONG),
        };
        let time = format!(" {:>7.1} ", line.at.as_secs_f32());
        let rows = broken(&line.text, width);
        for (index, row) in rows.into_iter().enumerate().rev() {
            let head = match index {
                0 => Span::styled(time.clone(), mark),
                _ => Span::raw(" ".repeat(LOG_INDENT)),
            };
            lines.push(Line::from(vec![head, Span::styled(row, style)]));
        }
    }
    lines.truncate(usize::from(area.height));
    lines.reverse();
    frame.render_widget(Paragraph::new(lines), area);
}

/// Breaks a text at spaces into rows of at most `width` characters; a longer word has a row of its own.
fn broken(text: &str, width: usize) -> Vec<String> {
    let mut rows = vec![String::new()];
    for word in text.split(' ') {
        match rows.last_mut() {
            Some(row) if row.is_empty() => row.push_str(word),
            Some(row) if row.chars().count() + 1 + word.chars().count() <= width => {
                row.push(' ');
                row.push_str(word);
            }
            _ => rows.push(word.to_owned()),
        }
    }
    rows
}

fn draw_keys(frame: &mut Frame<'_>, area: Rect) {
    let rows: [&[(&str, &str)]; 2] = [
        &[
            ("space", "STOP"),
            ("Enter", "arm"),
            ("Bksp", "disarm"),
            ("c", "clear"),
            ("s", "rest"),
            ("Esc", "leave"),
        ],
        &[
            ("w", "forward"),
            ("a d", "turn"),
            ("q e", "strafe"),
            ("↑ ↓", "f"),
            ("← →", "theta"),
            ("shift", "fine"),
            ("h", "hold"),
        ],
    ];
    let lines: Vec<Line<'_>> = rows
        .into_iter()
        .map(|row| {
            let mut spans = Vec::new();
            for (key, meaning) in row {
                let is_stop = *key == "space";
                let key_style = if is_stop {
                    on(RED).add_modifier(Modifier::BOLD)
                } else {
                    Style::new().reversed()
                };
                spans.push(Span::raw(" "));
                spans.push(Span::styled(format!(" {key} "), key_style));
                spans.push(Span::raw(format!(" {meaning}")));
            }
            Line::from(spans)
        })
        .collect();
    frame.render_widget(Paragraph::new(lines), area);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_has_one_sign() {
        let shown = [-0.04, 0.04, -0.06, -10.0].map(|value| signed(value, 1));
        assert_eq!(shown, ["+0.0", "+0.0", "-0.1", "-10.0"]);
    }
}
