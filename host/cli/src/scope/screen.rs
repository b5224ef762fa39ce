//! A capture in the terminal: one chart for each quantity.

use crate::teleop::view::{FAINT, SERIES, on};
use flix_host::scope::Capture;
use flix_protocol::message::Quantity;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph};

/// Draws a capture under a line of words; without one, the words alone.
pub fn draw(frame: &mut Frame<'_>, capture: Option<&Capture>, words: &str) {
    let [head, body] =
        Layout::vertical([Constraint::Length(1), Constraint::Min(0)]).areas(frame.area());
    let keys = Span::styled("  Esc ends, the space bar stops the robot", FAINT);
    frame.render_widget(Paragraph::new(Line::from(vec![Span::raw(words).bold(), keys])), head);
    let Some(capture) = capture else { return };
    let panels: Vec<(Quantity, Vec<usize>)> = flix_host::scope::panels(capture);
    let heights = panels.iter().map(|_| Constraint::Fill(1));
    for ((quantity, columns), area) in
        panels.iter().zip(Layout::vertical(heights).split(body).iter())
    {
        panel(frame, *area, capture, *quantity, columns);
    }
}

fn panel(
    frame: &mut Frame<'_>,
    area: Rect,
    capture: &Capture,
    quantity: Quantity,
    columns: &[usize],
) {
    // More points than a terminal has dots are not seen.
    let stride = (capture.rows() / (4 * usize::from(area.width).max(1))).max(1);
    let points: Vec<Vec<(f64, f64)>> = columns
        .iter()
        .map(|column| {
            capture
                .column(*column)
                .step_by(stride)
                .map(|(time, value)| (1e3 * time, value))
                .collect()
        })
        .collect();
    let extents = columns.iter().filter_map(|column| capture.extent(*column));
    let (low, high) = extents.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), extent| {
        (low.min(extent.minimum), high.max(extent.maximum))
    });
    // A line along the frame would not be seen.
    let margin = 0.05 * (high - low).max(100.0 * quantity.count());
    let (low, high) = (low - margin, high + margin);
    let colour = |column: usize| SERIES[column % SERIES.len()];
    let names = columns.iter().flat_map(|column| {
        let name = format!(" {} ", capture.channels()[*column]);
        [Span::styled(name, on(colour(*column))), Span::raw("─")]
    });
    let datasets = points
        .iter()
        .zip(columns)
        .map(|(points, column)| {
            Dataset::default()
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(colour(*column)))
                .data(points)
        })
        .collect();
    let begin = 1e3 * capture.time(0);
    let end = 1e3 * capture.time(capture.rows().saturating_sub(1));
    let chart = Chart::new(datasets)
        .block(
            Block::bordered()
                .title(quantity.unit())
                .title(Line::from_iter(names).right_aligned())
                .border_style(FAINT),
        )
        .legend_position(None)
        .x_axis(
            Axis::default()
                .style(FAINT)
                .bounds([begin, end])
                .labels([format!("{begin:.0} ms"), format!("{end:.0} ms")]),
        )
        .y_axis(
            Axis::default()
                .style(FAINT)
                .bounds([low, high])
                .labels([format!("{low:.2}"), format!("{high:.2}")]),
        );
    frame.render_widget(chart, area);
}
