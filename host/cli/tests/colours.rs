//! Colours of plots, pages and terminals, as people with and without colour vision deficiencies see them.

use std::time::Duration;

use flix_cli::teleop::view;
use flix_host::teleop::action::Action;
use flix_host::teleop::paper_modes::PaperMode;
use flix_plot::Colour;
use flix_plot::colour::{CYCLE, WHITE};
use flix_protocol::message::Fault;
use ratatui::buffer::Cell;
use ratatui::style::{Color, Modifier};

use crate::teleop::Desk;

/// Least difference of two curves of a plot, by CIEDE2000.
const DIFFERENT: f64 = 10.0;
/// Least contrast of text and of what is drawn (WCAG 2.2, 1.4.3 and 1.4.11).
const TEXT: f64 = 4.5;
const DRAWN: f64 = 3.0;

/// Share of red, green and blue light, from 0 to 1 (IEC 61966-2-1).
type Light = [f64; 3];

fn light(Colour(red, green, blue): Colour) -> Light {
    [red, green, blue].map(|value| {
        let value = f64::from(value) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    })
}

fn times(matrix: [[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

/// What is seen by everybody, and without one of three kinds of cones (Machado, Oliveira and Fernandes 2009, table 1, severity 1.0).
fn seen(light: Light) -> [Light; 4] {
    let protan = [
        [0.152_286, 1.052_583, -0.204_868],
        [0.114_503, 0.786_281, 0.099_216],
        [-0.003_882, -0.048_116, 1.051_998],
    ];
    let deutan = [
        [0.367_322, 0.860_646, -0.227_968],
        [0.280_085, 0.672_501, 0.047_413],
        [-0.011_820, 0.042_940, 0.968_881],
    ];
    let tritan = [
        [1.255_528, -0.076_749, -0.178_779],
        [-0.078_411, 0.930_809, 0.147_602],
        [0.004_733, 0.691_367, 0.303_900],
    ];
    let by = |cones| times(cones, light).map(|value| value.clamp(0.0, 1.0));
    [light, by(protan), by(deutan), by(tritan)]
}

/// CIELAB under D65.
fn lab(light: Light) -> [f64; 3] {
    let xyz = [
        [0.412_456, 0.357_576, 0.180_437],
        [0.212_673, 0.715_152, 0.072_175],
        [0.019_334, 0.119_192, 0.950_304],
    ];
    let [x, y, z] = times(xyz, light);
    let [x, y, z] = [x / 0.950_47, y, z / 1.088_83].map(|it| {
        if it > 216.0 / 24_389.0 { it.cbrt() } else { (24_389.0 / 27.0 * it + 16.0) / 116.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Difference of two colours by CIEDE2000 (Sharma, Wu and Dalal 2005).
fn ciede2000([l1, a1, b1]: [f64; 3], [l2, a2, b2]: [f64; 3]) -> f64 {
    let steep = |chroma: f64| (chroma.powi(7) / (chroma.powi(7) + 25_f64.powi(7))).sqrt();
    let stretch = 1.5 - 0.5 * steep(a1.hypot(b1).midpoint(a2.hypot(b2)));
    let polar = |a: f64, b: f64| {
        ((stretch * a).hypot(b), b.atan2(stretch * a).to_degrees().rem_euclid(360.0))
    };
    let ((c1, h1), (c2, h2)) = (polar(a1, b1), polar(a2, b2));
    let is_grey = c1 * c2 == 0.0;
    let turn = if is_grey { 0.0 } else { (h2 - h1 + 180.0).rem_euclid(360.0) - 180.0 };
    let (l, c) = (l1.midpoint(l2), c1.midpoint(c2));
    let h = if is_grey { h1 + h2 } else { (h1 + turn / 2.0).rem_euclid(360.0) };
    let cos = |degrees: f64| degrees.to_radians().cos();
    let t = 1.0 - 0.17 * cos(h - 30.0) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + 6.0)
        - 0.2 * cos(4.0 * h - 63.0);
    let weight = 1.0 + 0.015 * (l - 50.0).powi(2) / (20.0 + (l - 50.0).powi(2)).sqrt();
    let lightness = (l2 - l1) / weight;
    let chroma = (c2 - c1) / (1.0 + 0.045 * c);
    let hue = 2.0 * (c1 * c2).sqrt() * (turn / 2.0).to_radians().sin() / (1.0 + 0.015 * c * t);
    let blue = 60.0 * (-((h - 275.0) / 25.0).powi(2)).exp();
    let rotation = -blue.to_radians().sin() * 2.0 * steep(c);
    (lightness.powi(2) + chroma.powi(2) + hue.powi(2) + rotation * chroma * hue).sqrt()
}

fn contrast(a: Colour, b: Colour) -> f64 {
    let [a, b] = [a, b].map(|it| {
        let [red, green, blue] = light(it);
        0.2126 * red + 0.7152 * green + 0.0722 * blue + 0.05
    });
    a.max(b) / a.min(b)
}

/// Checks that all of these are told apart, whatever cones an eye lacks.
fn differ(colours: &[Colour]) {
    for (index, a) in colours.iter().enumerate() {
        for b in &colours[..index] {
            for (a_seen, b_seen) in seen(light(*a)).into_iter().zip(seen(light(*b))) {
                let difference = ciede2000(lab(a_seen), lab(b_seen));
                assert!(difference >= DIFFERENT, "{a} and {b}: {difference:.1}");
            }
        }
    }
}

/// The sixteen named colours of a terminal, and its own of text and ground.
struct Theme {
    name: &'static str,
    named: [u32; 16],
    text: u32,
    ground: u32,
}

const XTERM: [u32; 16] = [
    0x00_0000, 0xcd_0000, 0x00_cd00, 0xcd_cd00, 0x00_00ee, 0xcd_00cd, 0x00_cdcd, 0xe5_e5e5,
    0x7f_7f7f, 0xff_0000, 0x00_ff00, 0xff_ff00, 0x5c_5cff, 0xff_00ff, 0x00_ffff, 0xff_ffff,
];
const SOLARIZED: [u32; 16] = [
    0x07_3642, 0xdc_322f, 0x85_9900, 0xb5_8900, 0x26_8bd2, 0xd3_3682, 0x2a_a198, 0xee_e8d5,
    0x00_2b36, 0xcb_4b16, 0x58_6e75, 0x65_7b83, 0x83_9496, 0x6c_71c4, 0x93_a1a1, 0xfd_f6e3,
];
const THEMES: [Theme; 4] = [
    Theme { name: "xterm, white", named: XTERM, text: 0, ground: 0xff_ffff },
    Theme { name: "xterm, black", named: XTERM, text: 0xe5_e5e5, ground: 0 },
    Theme { name: "Solarized dark", named: SOLARIZED, text: 0x83_9496, ground: 0x00_2b36 },
    Theme { name: "Solarized light", named: SOLARIZED, text: 0x65_7b83, ground: 0xfd_f6e3 },
];

fn rgb(value: u32) -> Colour {
    let [_, red, green, blue] = value.to_be_bytes();
    Colour(red, green, blue)
}

impl Theme {
    /// Returns a colour as this terminal shows it; `reset` is the colour that is no colour.
    fn shows(&self, colour: Color, reset: u32) -> Colour {
        let named = |index: usize| rgb(self.named[index]);
        match colour {
            Color::Reset => rgb(reset),
            Color::Indexed(index @ 0..=15) => named(index.into()),
            // xterm's cube and greys.
            Color::Indexed(index @ 16..=231) => {
                let level = |part: u8| if part == 0 { 0 } else { 55 + 40 * part };
                let cell = index - 16;
                Colour(level(cell / 36), level(cell / 6 % 6), level(cell % 6))
            }
            Color::Indexed(index) => {
                let grey = 8 + 10 * (index - 232);
                Colour(grey, grey, grey)
            }
            Color::Black => named(0),
            Color::Red => named(1),
            Color::Green => named(2),
            Color::Yellow => named(3),
            Color::Blue => named(4),
            Color::Magenta => named(5),
            Color::Cyan => named(6),
            Color::Gray => named(7),
            Color::DarkGray => named(8),
            Color::White => named(15),
            other => panic!("{other}"),
        }
    }

    /// Checks that a character is seen, as well as the terminal shows its own text.
    fn shows_cell(&self, cell: &Cell) {
        let symbol = cell.symbol().chars().next().unwrap_or(' ');
        if symbol == ' ' {
            return;
        }
        let mut colours = [self.shows(cell.fg, self.text), self.shows(cell.bg, self.ground)];
        if cell.modifier.contains(Modifier::REVERSED) {
            colours.reverse();
        }
        let own = contrast(rgb(self.text), rgb(self.ground));
        let least = if symbol.is_ascii() { TEXT } else { DRAWN };
        let contrast = contrast(colours[0], colours[1]);
        assert!(
            contrast >= least.min(own) - 0.01,
            "{}: {symbol} {cell:?}: {contrast:.1}",
            self.name
        );
    }
}

#[test]
fn curves_of_plots_and_the_page_are_told_apart_without_colour_vision() {
    differ(&CYCLE);
    for colour in CYCLE {
        assert!(contrast(colour, WHITE) >= DRAWN - 0.01, "{colour} on white");
    }
    let listed: Vec<String> = CYCLE.iter().take(8).map(|it| format!("\"{it}\"")).collect();
    let page = include_str!("../../src/teleop/page/page.js");
    assert!(page.contains(&listed.join(", ")), "the page's scope has the colours of the plots");
}

#[test]
fn whatever_a_terminal_s_theme_text_and_drawings_are_seen() {
    let mut desk = Desk::armed();
    let mut pictures = vec![desk.shown(120, 40)];
    desk.press(Action::Walk(PaperMode::LeftTurn));
    desk.cockpit
        .be_attended(Duration::from_secs(12), flix_protocol::units::Instant::from_micros(1));
    desk.run(Duration::from_secs(2));
    pictures.push(desk.shown(120, 40));
    desk.robot.fault_when_running = Some(Fault::Stall);
    desk.press(Action::Walk(PaperMode::RightTurn));
    pictures.extend([desk.shown(120, 40), desk.shown(60, 10)]);
    desk.press(Action::Stop);
    pictures.push(desk.shown(80, 24));
    for theme in &THEMES {
        for cell in pictures.iter().flat_map(|it| &it.buffer().content) {
            theme.shows_cell(cell);
        }
        let shown = |colour: &Color| theme.shows(*colour, theme.text);
        differ(&[view::FORCE, view::ROTORS[0], view::ROTORS[1]].each_ref().map(shown));
        differ(&view::SERIES.each_ref().map(shown));
    }
}
