//! Figures as text for people.

use isocat_engine::status::{Event, Status, place};
use isocat_wire::Nanos;

use super::trend::Behind;

/// The SubDevice that an event concerns, such as `2 axis 3: `; empty for the segment.
pub fn of(status: &Status, event: &Event) -> String {
    let Some(position) = event.position else { return String::new() };
    match status.devices.get(position).map(|device| &device.name).filter(|name| !name.is_empty()) {
        Some(name) => format!("{position} {name}: "),
        None => format!("SubDevice {position}: "),
    }
}

/// A SubDevice that is behind, such as `SubDevice 2 (axis 2) in SAFEOP for 8 s, others in OP`.
pub fn behind(status: &Status, behind: &Behind) -> String {
    let device = status.devices.iter().find(|device| device.position == behind.position);
    let (which, state) = device.map_or_else(
        || (format!("SubDevice {}", behind.position), String::new()),
        |device| (place(device), device.state()),
    );
    let code = device.map(|device| device.al_code).filter(|code| *code > 0);
    let code = code.map_or(String::new(), |code| format!(" (0x{code:04X})"));
    let (span, others) = (span(behind.for_ns), behind.others.name());
    format!("{which} in {state}{code} for {span}, others in {others}")
}

/// A span of at least a second, such as `8 s`, `12 m` or `3 h`: at most four characters, up to
/// 99 hours.
pub fn span(ns: i64) -> String {
    let seconds = ns / 1_000_000_000;
    match seconds {
        0..100 => format!("{seconds} s"),
        100..6_000 => format!("{} m", seconds / 60),
        _ => format!("{} h", seconds / 3_600),
    }
}

/// A time such as `-12 ns`, `438.2 us`, `-438 us`, `1.49 ms`: at most eight characters, up to
/// hours.
pub fn time(ns: f64) -> String {
    // A rounded zero has no sign.
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

/// Like [`time`], with a dash for `None`.
pub(crate) fn maybe(ns: Option<f64>) -> String {
    ns.map_or_else(|| "-".to_owned(), time)
}

/// A deviation such as `+50.03`, or a dash for `None`.
pub fn ppm(ppm: Option<f64>) -> String {
    ppm.map_or_else(|| "-".to_owned(), |ppm| format!("{ppm:+.2}"))
}

/// A time such as `12.345 s`.
pub fn seconds(ns: i64) -> String {
    format!("{:.3} s", ns as f64 / 1e9)
}

/// A cycle such as `1 ms`, or a dash before it is known.
pub fn cycle(ns: i64) -> String {
    if ns > 0 { Nanos(ns).to_string() } else { "-".to_owned() }
}

/// A rate per second, without unnecessary digits.
pub fn rate(rate: f64) -> String {
    match rate {
        0.0 => "0".to_owned(),
        _ if rate < 0.095 => "<0.1".to_owned(),
        _ if rate < 9.95 => format!("{rate:.1}"),
        _ => format!("{rate:.0}"),
    }
}

/// A text cut to at most `width` characters, with a mark at the end if it was longer.
pub fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut cut: String = text.chars().take(width.saturating_sub(1)).collect();
    cut.push('…');
    cut
}
