//! What was found, for people: a page with figures that needs no network, and the model with its intervals.

use flix_host::system::text::fixed;
use flix_plot::{Chart, Figure, Panel, Series, Stroke, colour};
use flix_shell::output::table;

use super::fit::Fitted;
use super::unknowns::Kind;
use super::{EXPERIMENTS, Estimate, Identified, Left, Proposal};

/// The page, with one place for the title and one for what it shows.
const PAGE: &str = include_str!("report.html");
/// Proposals that are worth a line.
const WORTH: f64 = 0.005;

/// Rows of cells; the first is the head.
pub type Rows = Vec<Vec<String>>;

macro_rules! row {
    ($($cell:expr),* $(,)?) => { vec![$($cell.to_string()),*] };
}

/// Returns every value with its interval.
#[must_use]
pub fn values(found: &Identified) -> Rows {
    let mut rows = vec![row!["", "plan", "identified", "from", "to (95 %)"]];
    rows.extend(found.estimates.iter().chain(&found.centre_mm).map(|it| {
        let [plan, value, low, high] = [it.plan, it.value, it.low, it.high].map(digits);
        row![it.name, plan, value, low, high]
    }));
    rows
}

/// Returns what each experiment left of the plan's uncertainty.
#[must_use]
pub fn stages(found: &Identified) -> Rows {
    let mut rows = vec![head("left after")];
    rows.extend(found.stages.iter().map(|stage| {
        let last = stage.distance.map_or_else(String::new, |distance| format!("{distance:.1}"));
        cells(stage.experiment.to_owned(), &stage.left, last)
    }));
    rows[0].push("off (deviations)".to_owned());
    rows
}

/// Returns what further experiments would bring, those that bring nothing left out.
#[must_use]
pub fn proposals(found: &Identified) -> Rows {
    let mut rows = vec![head("one more")];
    let worth = found.proposals.iter().filter(|proposal| proposal.gain > WORTH);
    rows.extend(worth.map(|it| {
        let again = if it.again { " again" } else { "" };
        cells(format!("{}{again}", it.experiment), &it.left, percent(it.gain))
    }));
    rows[0].push("variance less".to_owned());
    rows
}

fn head(first: &str) -> Vec<String> {
    let kinds = Kind::ALL.map(|kind| format!("{kind:?}").to_lowercase());
    [first.to_owned()].into_iter().chain(kinds).collect()
}

fn cells(first: String, left: &Left, last: String) -> Vec<String> {
    [first].into_iter().chain(left.map(percent)).chain([last]).collect()
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// Five significant digits.
fn digits(value: f64) -> String {
    let places = 4 - value.abs().max(1e-9).log10().floor() as i32;
    fixed(value, places.clamp(0, 6) as usize)
}

/// Walks, measured and simulated.
#[must_use]
pub fn walks(found: &Identified) -> Rows {
    let head = "f (Hz)|theta (deg)|forward (m/s)|found|held out|lateral (m/s)|found|held out|yaw (rad/s)|found|held out";
    let mut rows = vec![head.split('|').map(str::to_owned).collect::<Vec<_>>()];
    rows.extend(found.walks.iter().flat_map(|walks| &walks.pairs).map(|pair| {
        let speeds = (0..3).flat_map(|i| {
            [pair.measured, pair.simulated, pair.held_out].map(|speeds| fixed(speeds[i], 3))
        });
        row![pair.f_hz, pair.theta_deg].into_iter().chain(speeds).collect()
    }));
    rows
}

/// Sentences: what is missing, what to do next, what does not fit.
#[must_use]
pub fn remarks(found: &Identified) -> Vec<String> {
    let brings = |name: &str| {
        EXPERIMENTS.iter().find(|(other, _)| *other == name).map_or("", |(_, brings)| brings)
    };
    let slips = found.slips.iter().map(|it| {
        let [value, expected, deviation] = [it.value, it.expected, 2.0 * it.deviation].map(digits);
        format!(
            "{}.csv, line {}: {} is {value}, and the other lines expect {expected} within {deviation}. The line is left out: check its \
             comma, sign, unit and leg.",
            it.experiment, it.line, it.column
        )
    });
    let missing = found
        .missing
        .iter()
        .map(|name| format!("{name}.csv is missing; it would bring: {}.", brings(name)));
    let mut all: Vec<String> = slips.chain(missing).collect();
    if let Some(Proposal { experiment, again, gain, .. }) =
        found.proposals.first().filter(|best| best.gain > WORTH)
    {
        let word = if *again { " once more" } else { "" };
        all.push(format!(
            "Most informative next: {experiment}{word} ({}); it lowers the variance of a value by {} on average.",
            brings(experiment),
            percent(*gain)
        ));
    }
    for stage in found.stages.iter().filter(|stage| stage.distance.is_some_and(|d| d > SURPRISING))
    {
        all.push(format!(
            "{}.csv is {:.1} standard deviations from what any robot of the plan would show: check its units and the plan.",
            stage.experiment,
            stage.distance.unwrap_or_default()
        ));
    }
    for it in &found.fitted {
        let worst = it.noise.iter().zip(&it.guess).map(|(n, g)| n / g).fold(0.0, f64::max);
        if worst > NOISY {
            all.push(format!(
                "{}.csv scatters {worst:.0} times as much as good sensors do: it shows little. Check units, axes and the plan.",
                it.name
            ));
        }
    }
    for it in found.estimates.iter().filter(|it| it.is_far_from_plan()) {
        all.push(format!("{} is far from the plan's {}: check both.", it.name, digits(it.plan)));
    }
    if let Some(scores) = &found.scores {
        all.push(format!(
            "Walks: RMSE (equation 3) {:.4} m/s by the robot that all of them identify, {:.4} m/s by the one identified without the pair.",
            scores.fitted_rmse_m_s, scores.held_out_rmse_m_s
        ));
    }
    all
}

/// Readings as far as this from the ensemble are no chance.
const SURPRISING: f64 = 3.0;
/// Noise beyond so many times the usual one is a mistake more often than a sensor.
const NOISY: f64 = 5.0;
/// A value of a leg, a foot or the floor that is as far off its plan is a mistake more often than a part.
const FAR: f64 = 0.5;

impl Estimate {
    fn is_far_from_plan(&self) -> bool {
        self.kind != Kind::Mass && (self.value / self.plan - 1.0).abs() > FAR
    }
}

/// Returns the head of the model's file: every value with its interval.
#[must_use]
pub fn origin(found: &Identified, plan: &str, folder: &str) -> String {
    format!(
        "Identified by `flix-sim study sysid` from {folder}, with model {plan} as the plan.\n{}\n\n{}",
        remarks(found).join("\n"),
        table(&values(found))
    )
}

/// Draws the page.
#[must_use]
pub fn html(found: &Identified, folder: &str) -> String {
    let escaped = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;");
    let title = format!("Identification from {}", escaped(folder));
    let mut body = format!("<h1>{title}</h1>\n");
    for remark in remarks(found) {
        body += &format!("<p>{}</p>\n", escaped(&remark));
    }
    let mut section = |head: &str, text: &str, inside: String| {
        body += &format!("<h2>{head}</h2>\n<p>{text}</p>\n<div class=\"wide\">{inside}</div>\n");
    };
    section(
        "Legs and feet",
        "Dot: identified; line: 95 % interval; cross line: plan.",
        intervals(found).svg(),
    );
    section(
        "What each experiment showed",
        "Standard deviation of a value of each kind, as a share of what the plan leaves open.",
        html_table(&stages(found)),
    );
    if found.proposals.iter().any(|proposal| proposal.gain > WORTH) {
        section(
            "What one more experiment would bring",
            "Expected, before it is made; the most informative first.",
            html_table(&proposals(found)),
        );
    }
    if !found.fitted.is_empty() {
        section(
            "Readings against the fit",
            "Residuals in standard deviations of the estimated noise, in the order of the files. They should scatter \
             between -2 and 2 without a pattern.",
            residuals(&found.fitted).svg(),
        );
    }
    if let Some(courses) = &found.drops {
        section(
            "Drops",
            "Height of the body since the release, mean of all drops.",
            drops(courses).svg(),
        );
    }
    if found.walks.is_some() {
        section(
            "Walks",
            "Measured; found: the identified robot; held out: the robot identified without this third of the pairs.",
            html_table(&walks(found)),
        );
    }
    section("All values", "Centre of mass from the plate's middle.", html_table(&values(found)));
    PAGE.replace("{{title}}", &title).replace("{{body}}", &body)
}

fn html_table(rows: &Rows) -> String {
    let line = |row: &Vec<String>, tag: &str| {
        let cells = row.iter().map(|cell| format!("<{tag}>{}</{tag}>", cell.replace('<', "&lt;")));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    let mut lines = rows.iter();
    let head = lines.next().map(|row| line(row, "th")).unwrap_or_default();
    format!("<table>\n{head}{}</table>", lines.map(|row| line(row, "td")).collect::<String>())
}

/// Width of the figures, logical pixels: readable when scaled to a phone's screen.
const WIDTH: f64 = 520.0;

/// Each leg's values beside each other.
fn intervals(found: &Identified) -> Chart {
    let of = |name: &str| -> Vec<&Estimate> {
        found.estimates.iter().filter(|it| it.name.ends_with(name)).collect()
    };
    let panels = [
        ("bend stiffness (N m/rad)", "bend_stiffness_n_m_rad"),
        ("twist stiffness (N m/rad)", "twist_stiffness_n_m_rad"),
        ("bend damping (N m s/rad)", "bend_damping_n_m_s_rad"),
        ("twist damping (N m s/rad)", "twist_damping_n_m_s_rad"),
        ("friction", "friction"),
    ];
    let chart = Chart::new("Legs and feet", "leg: front or rear, left or right")
        .x_names(&["fl", "fr", "rl", "rr"])
        .width(WIDTH);
    panels.into_iter().fold(chart, |chart, (label, name)| {
        let each = of(name);
        let at = |index: usize| index as f64 + 1.0;
        let dots = each.iter().enumerate().map(|(index, it)| (at(index), it.value));
        let mut panel = Panel::new(label).height(110.0).series(
            Series::line("identified", dots).stroke(Stroke::Dots).colour(colour::BLUE).width(2.4),
        );
        for (index, it) in each.iter().enumerate() {
            let bar = [(at(index), it.low), (at(index), it.high)];
            let plan = [(at(index) - 0.2, it.plan), (at(index) + 0.2, it.plan)];
            panel = panel
                .series(Series::line("", bar).colour(colour::BLUE))
                .series(Series::line("", plan).colour(colour::MUTED));
        }
        chart.panel(panel)
    })
}

fn residuals(fitted: &[Fitted]) -> Chart {
    let chart = Chart::new("Residuals", "reading")
        .subtitle("in standard deviations")
        .x_whole()
        .width(WIDTH);
    fitted.iter().fold(chart, |chart, it| {
        let each = it.readings.iter().zip(&it.kinds).enumerate();
        let dots = each.map(|(index, ((measured, fitted), kind))| {
            (index as f64, (measured - fitted) / it.noise[*kind])
        });
        chart.panel(
            Panel::new(it.name).height(100.0).series(
                Series::line("", dots).stroke(Stroke::Dots).colour(colour::BLUE).width(1.2),
            ),
        )
    })
}

fn drops([measured, simulated]: &[Vec<(f64, f64)>; 2]) -> Chart {
    let ms = |course: &[(f64, f64)]| course.iter().map(|(t, z)| (1e3 * t, *z)).collect::<Vec<_>>();
    Chart::new("Drops", "time since the soles touch (ms)").width(WIDTH).panel(
        Panel::new("height since the release (mm)")
            .series(
                Series::line("measured", ms(measured)).stroke(Stroke::Dots).colour(colour::ORANGE),
            )
            .series(Series::line("identified", ms(simulated)).colour(colour::BLUE)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_has_five_digits_and_no_negative_zero() {
        assert_eq!(
            [-0.0, -1e-9, -0.012_345_6, 1234.56].map(digits),
            ["0.000000", "0.000000", "-0.012346", "1234.6"]
        );
    }
}
