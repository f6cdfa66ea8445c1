//! The cycle of one SubDevice: planned events as bars over the cycle, with measured values.

use isocat_engine::status::{Device, Kind, Moment, SUBS, Status, place};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

use super::screen::Look;
use super::view::View;
use super::words;

/// Columns before the bar: name, planned, seen.
const NAME: usize = 21;
const FIGURES: usize = 19;
/// Least useful width of a bar.
const LEAST_BAR: usize = 12;

pub(super) fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    view: &View,
    status: &Status,
    device: &Device,
) {
    let look = Look(view.colour);
    let width = usize::from(area.width);
    let mut lines = vec![
        Line::styled(words::cut(&title(status, device), width), look.head()),
        Line::raw(words::cut(&figures(status, device), width)),
    ];
    let bar = width.saturating_sub(NAME + 2 * FIGURES + 2);
    let end = end_of(status.cycle_ns, &device.moments);
    if device.moments.is_empty() {
        lines.push(Line::raw(""));
        lines.push(Line::raw(words::cut(why_not(status), width)));
    } else {
        let mut head =
            format!("{:<NAME$}{:<FIGURES$}{:<FIGURES$}", "event", "planned, us", "seen [t], us");
        if bar >= LEAST_BAR {
            let last = format!("{:.0}", end as f64 / 1e3);
            head += &format!("0{last:>room$}", room = bar - 1);
        }
        lines.push(Line::styled(words::cut(&head, width), look.quiet()));
        let rows = device.moments.iter().map(|moment| row(moment, end, bar, &look));
        lines.extend(rows);
        if bar >= LEAST_BAR {
            let legend = "░ planned  █ seen";
            lines.push(Line::styled(words::cut(legend, width), look.quiet()));
        }
    }
    lines.push(Line::raw(words::cut(&counters(device), width)));
    frame.render_widget(Paragraph::new(lines), area);
}

fn title(status: &Status, device: &Device) -> String {
    let cycle = words::cycle(status.cycle_ns);
    let reference = if device.is_reference { ", reference clock" } else { "" };
    format!("{}: {}, {}, cycle {cycle}{reference}", place(device), device.state(), device.mode)
}

fn figures(status: &Status, device: &Device) -> String {
    let (t, m) = (status.kind.source(), status.kind.margin_source());
    let error = device.error.map(|error| {
        let (now, worst) = (words::time(error.now_ns), words::time(error.worst_ns));
        format!("SYNC error {now}, worst {worst} of {} [{t}]", error.count)
    });
    let margin = device.margin.map(|margin| {
        let (now, least) = (words::time(margin.now_ns), words::time(margin.least_ns));
        format!("margin {now}, least {least} [{m}]")
    });
    let ppm = device.clock_ppm.map(|ppm| format!("clock {ppm:+.2} ppm [r]"));
    let all: Vec<String> = [error, margin, ppm].into_iter().flatten().collect();
    if all.is_empty() { "nothing measured".to_owned() } else { all.join("  ") }
}

fn counters(device: &Device) -> String {
    let of = |index: &str, all: &[isocat_engine::status::Counter; 4]| {
        let one = |(counter, sub): (&isocat_engine::status::Counter, &str)| {
            let value = counter.value.map_or("-".to_owned(), |value| value.to_string());
            let risen =
                if counter.risen > 0 { format!(" (+{})", counter.risen) } else { String::new() };
            format!("{sub} {value}{risen}")
        };
        format!("{index}: {}", all.iter().zip(SUBS).map(one).collect::<Vec<_>>().join("  "))
    };
    let alarms = match device.alarms.is_empty() {
        true => String::new(),
        false => format!("  alarms: {}", device.alarms.join(", ")),
    };
    format!("{}   {} [r]{alarms}", of("0x1C32", &device.outputs), of("0x1C33", &device.inputs))
}

fn why_not(status: &Status) -> &'static str {
    match status.kind {
        Kind::Served => "no plan is known: an external MainDevice operates the segment",
        _ if status.operation_ns.is_none() => "the cycle is planned on the way up",
        _ => "nothing in its cycle has a planned time",
    }
}

/// Time that the whole bar represents.
fn end_of(cycle_ns: i64, moments: &[Moment]) -> i64 {
    let last = moments.iter().map(|moment| moment.latest_ns).max().unwrap_or(0);
    cycle_ns.max(last).max(1)
}

fn row(moment: &Moment, end: i64, bar: usize, look: &Look) -> Line<'static> {
    let us = |ns: f64| format!("{:.2}", ns / 1e3);
    let range = |from: f64, to: f64| format!("{} .. {}", us(from), us(to));
    let planned = range(moment.earliest_ns as f64, moment.latest_ns as f64);
    let seen = moment.seen_ns.map_or("-".to_owned(), |(from, to)| range(from, to));
    let outside = moment
        .seen_ns
        .is_some_and(|(from, to)| from < moment.earliest_ns as f64 || to > moment.latest_ns as f64);
    let style = if outside { look.bad() } else { Style::new() };
    let name = words::cut(moment.event.name(), NAME - 1);
    let mut spans = vec![
        Span::raw(format!("{name:<NAME$}{planned:<FIGURES$}")),
        Span::styled(format!("{seen:<FIGURES$}"), style),
    ];
    if bar >= LEAST_BAR {
        spans.push(Span::styled(drawn(moment, end, bar), style));
    }
    Line::from(spans)
}

/// The bar: planned time light, observed time full.
fn drawn(moment: &Moment, end: i64, bar: usize) -> String {
    let column = |ns: f64| {
        let at = (ns / end as f64 * bar as f64).floor();
        at.clamp(0.0, bar as f64 - 1.0) as usize
    };
    let mut cells = vec!['·'; bar];
    let mut fill = |from: f64, to: f64, with: char| {
        for cell in &mut cells[column(from)..=column(to).max(column(from))] {
            *cell = with;
        }
    };
    fill(moment.earliest_ns as f64, moment.latest_ns as f64, '░');
    if let Some((from, to)) = moment.seen_ns {
        fill(from, to, '█');
    }
    cells.into_iter().collect()
}
