use super::*;
use flix_host::nav::Position;

fn chart() -> Chart {
    let wave = |amplitude: f64| {
        (0..500).map(move |i| (f64::from(i) * 0.02, amplitude * (f64::from(i) * 0.05).sin()))
    };
    Chart::new("Held frequency and direction", "Time (s)")
        .subtitle("five modes and a reversal, seed 1")
        .panel(
            Panel::new("Frequency f (Hz)")
                .series(
                    Series::line("commanded", [(0.0, -30.0), (4.0, 30.0), (10.0, 30.0)])
                        .stroke(Stroke::Step)
                        .colour(colour::GREY),
                )
                .series(Series::line("held", wave(30.0)))
                .span(4.0, 5.0, "reversal", colour::PURPLE)
                .rule(35.0, "limit 35 Hz"),
        )
        .panel(
            Panel::new("Currents (A)")
                .series(Series::line("top", wave(1.2)))
                .series(Series::line("bottom", wave(-0.8)).stroke(Stroke::Dashed)),
        )
}

fn track() -> Track {
    let eight = (0..=200)
        .map(|i| f64::from(i) / 200.0 * std::f64::consts::TAU)
        .map(|t| Position::new(0.8 * t.sin(), 0.4 * (2.0 * t).sin()));
    Track::new("Figure eight", "m")
        .subtitle("error 23 mm RMS over two laps")
        .series(Series::line("path", eight.clone()).stroke(Stroke::Dashed).colour(colour::GREY))
        .series(Series::line("robot", eight.map(|p| Position::new(p.x + 0.02, p.y - 0.02))))
        .outline(Outline {
            corners: [(-0.11, -0.06), (0.11, -0.06), (0.11, 0.06), (-0.11, 0.06)]
                .map(|(x, y)| Position::new(x, y))
                .to_vec(),
            colour: colour::ORANGE,
            filling: 0.3,
        })
        .mark(Position::ORIGIN, "start", colour::GREEN)
}

fn maps() -> HeatMaps {
    let x: Vec<f64> = (-3..=3).map(|i| f64::from(i) * 30.0).collect();
    let y: Vec<f64> = vec![-35.0, -30.0, -20.0, -10.0, 10.0, 20.0, 30.0, 35.0];
    let value = |x: f64, y: f64| 0.09 * (x / 60.0).sin() * (y / 35.0);
    let rows: Vec<Vec<f64>> = y.iter().map(|y| x.iter().map(|x| value(*x, *y)).collect()).collect();
    let map = |name: &str| {
        HeatMap::new(name, x.clone(), y.clone(), rows.clone())
            .labels("theta (deg)", "f (Hz)")
            .decimals(3)
    };
    HeatMaps::new("Speeds over frequency and direction", 2)
        .subtitle("model W, means of 8 seeds")
        .map(map("Forward speed (m/s)").mark(4, 1, "A′"))
        .map(map("Spread (m/s)").palette(Palette::Sequential))
}

/// Writes the pictures for a look: `FLIX_PLOT_OUT=out cargo test -p flix-plot`.
fn keep(figure: &impl Figure, name: &str) {
    if let Ok(folder) = std::env::var("FLIX_PLOT_OUT") {
        figure.write(Path::new(&folder), name).unwrap();
    }
}

#[test]
fn every_label_of_a_chart_stands_in_its_svg() {
    let svg = chart().svg();
    keep(&chart(), "chart");
    for text in [
        "Held frequency and direction",
        "Frequency f (Hz)",
        "Time (s)",
        "commanded",
        "limit 35 Hz",
        "reversal",
    ] {
        assert!(svg.contains(text), "{text} is missing");
    }
}

#[test]
fn a_track_has_one_scale_on_both_axes() {
    let figure = Track::new("", "m").series(Series::line("", [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0)]));
    keep(&track(), "track");
    let Size { width, height } = figure.size();
    assert!((0.6..0.95).contains(&(height / width)), "{width} x {height}");
}

#[test]
fn a_heat_map_writes_every_cell() {
    let svg = maps().svg();
    keep(&maps(), "maps");
    let cells = svg.matches("0.").count();
    assert!(cells >= 2 * 7 * 8, "{cells} numbers");
}

#[test]
fn the_png_shows_text_without_any_font_of_the_machine() {
    let blank = Chart::new("", "").panel(Panel::new(""));
    let titled = Chart::new("", "").panel(Panel::new("MMMMMMMM"));
    let dark = |chart: &Chart| {
        let map = tiny_skia::Pixmap::decode_png(&chart.png().unwrap()).unwrap();
        map.pixels().iter().filter(|p| p.red() < 100).count()
    };
    assert!(dark(&titled) > dark(&blank) + 300, "{} {}", dark(&titled), dark(&blank));
}

#[test]
fn a_text_is_as_wide_as_it_is_measured() {
    let look =
        canvas::Text { size: 20.0, colour: colour::INK, bold: true, align: canvas::Align::Left };
    let mut page = Canvas::new(Size { width: 400.0, height: 40.0 });
    page.text(canvas::Pixel::new(0.0, 20.0), "MWMWMWMWM", look);
    let map = tiny_skia::Pixmap::decode_png(&raster::png(&page).unwrap()).unwrap();
    let last = (0..map.width()).rev().find(|x| map.pixel(*x, 40).is_some_and(|p| p.red() < 128));
    let (drawn, measured) = (
        f64::from(last.unwrap()) / PNG_DENSITY,
        canvas::text_width("MWMWMWMWM", look.size, look.bold),
    );
    assert!((drawn - measured).abs() < 3.0, "{drawn} px drawn, {measured} px measured");
}

#[test]
fn points_that_are_not_finite_break_the_line_and_nothing_else() {
    let gap = [
        (0.0, 1.0),
        (1.0, 2.0),
        (2.0, f64::NAN),
        (3.0, 2.0),
        (f64::INFINITY, 1.0),
        (4.0, 1.0),
        (5.0, 2.0),
    ];
    let svg = Chart::new("", "x").panel(Panel::new("y").series(Series::line("s", gap))).svg();
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn a_chart_without_data_is_still_a_picture() {
    assert!(Chart::new("nothing", "x").panel(Panel::new("y")).png().is_ok());
}

#[test]
fn letters_that_mean_something_to_xml_are_escaped() {
    let svg = Chart::new("a < b & \"c\"", "x").panel(Panel::new("y")).svg();
    assert!(svg.contains("a &lt; b &amp;"));
}

#[test]
fn both_files_are_written_into_a_new_folder() {
    let folder = std::env::temp_dir().join(format!("flix-plot-{}", std::process::id()));
    let written = chart().write(&folder.join("new"), "figure").unwrap();
    let found = (written.svg.exists(), written.png.exists());
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(found, (true, true));
}

#[test]
fn figures_name_the_program_that_drew_them() {
    let program = flix_host::system::program::get();
    let svg = track().svg();
    assert!(svg.contains(&format!("<metadata>{program}</metadata>")), "{svg}");
    let png = track().png().unwrap();
    let text = format!("tEXtSoftware\0{program}");
    assert!(png.windows(text.len()).any(|part| part == text.as_bytes()));
    // The check sum of the text is right.
    assert!(tiny_skia::Pixmap::decode_png(&png).is_ok());
}
