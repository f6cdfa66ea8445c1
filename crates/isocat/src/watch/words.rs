//! Figures as people read them.

use isocat_engine::status::{Event, Status};
use isocat_wire::Nanos;

/// Whom an event concerns, `2 axis 3: `; empty if it is the segment.
pub fn of(status: &Status, event: &Event) -> String {
    let Some(position) = event.position else { return String::new() };
    match status.devices.get(position).map(|device| &device.name).filter(|name| !name.is_empty()) {
        Some(name) => format!("{position} {name}: "),
        None => format!("SubDevice {position}: "),
    }
}

/// `-12 ns`, `438.2 us`, `-438 us`, `1.49 ms`: eight characters at most up to hours.
pub fn time(ns: f64) -> String {
    // Nothing is no less than nothing.
    let ns = if ns.abs() < 0.5 { 0.0 } else { ns };
    let size = ns.abs();
    match size {
        _ if size < 9_999.5 => format!("{ns:.0} ns"),
        _ if size < 99_950.0 || (0.0..999_950.0).contains(&ns) => format!("{:.1} us", ns / 1e3),
        _ if size < 999_500.0 => format!("{:.0} us", ns / 1e3),
        _ if size < 9_995_000.0 => format!("{:.2} ms", ns / 1e6),
        _ if size < 999_500_000.0 => format!("{:.0} ms", ns / 1e6),
        _ => format!("{:.0} s", ns / 1e9),
    }
}

/// As [`time`], a dash for none.
pub(crate) fn maybe(ns: Option<f64>) -> String {
    ns.map_or_else(|| "-".to_owned(), time)
}

/// `+50.03`, a dash for none.
pub fn ppm(ppm: Option<f64>) -> String {
    ppm.map_or_else(|| "-".to_owned(), |ppm| format!("{ppm:+.2}"))
}

/// `12.345 s`
pub fn seconds(ns: i64) -> String {
    format!("{:.3} s", ns as f64 / 1e9)
}

/// `1 ms`, a dash before it is known.
pub fn cycle(ns: i64) -> String {
    if ns > 0 { Nanos(ns).to_string() } else { "-".to_owned() }
}

/// A rate a second, without needless digits.
pub fn rate(rate: f64) -> String {
    match rate {
        0.0 => "0".to_owned(),
        _ if rate < 0.095 => "<0.1".to_owned(),
        _ if rate < 9.95 => format!("{rate:.1}"),
        _ => format!("{rate:.0}"),
    }
}

/// As many characters at most, the last one a sign that there were more.
pub fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut cut: String = text.chars().take(width.saturating_sub(1)).collect();
    cut.push('…');
    cut
}
