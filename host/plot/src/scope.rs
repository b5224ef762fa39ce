//! Figures of a capture of the scope.

use flix_host::scope::{Capture, panels};
use flix_protocol::message::{Quantity, Trigger};

use crate::{Chart, Panel, Series, colour};

/// Draws a capture: one panel for each quantity, over the milliseconds since the trigger.
#[must_use]
pub fn chart(capture: &Capture, title: &str) -> Chart {
    let end = 1e3 * capture.time(capture.rows().saturating_sub(1));
    let begin = 1e3 * capture.time(0);
    let mut chart =
        Chart::new(title, "Time since the trigger (ms)").x_range(begin, end).width(900.0);
    for (quantity, columns) in panels(capture) {
        let label = match quantity {
            Quantity::Current => "Current (A)",
            Quantity::Voltage => "Voltage (V)",
            Quantity::Speed => "Frequency (Hz)",
            Quantity::Angle => "Angle (deg)",
        };
        let mut panel = Panel::new(label);
        if begin < 0.0 {
            let name = if capture.status().plan.trigger == Trigger::Fault {
                "after the fault"
            } else {
                ""
            };
            panel = panel.span(0.0, end, name, colour::GREY);
        }
        for column in columns {
            let name = capture.channels()[column].to_string();
            let points = capture.column(column).map(|(time, value)| (1e3 * time, value));
            panel = panel.series(Series::line(name, points).width(1.0));
        }
        chart = chart.panel(panel);
    }
    chart
}
