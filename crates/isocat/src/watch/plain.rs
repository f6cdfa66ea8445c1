//! The live view as lines, in the style of `ptp4l` and `chronyd`: for logs, pipes, and users
//! without a terminal.
//!
//! Once per second of the segment's time it prints a line for the segment, and one for each of the
//! few SubDevices in the worst state. Events in between are printed at once.

use isocat_engine::status::{Device, Event, Status, servo_name};

use super::{Trend, words};

/// Number of SubDevices with a line per second.
pub const MOST: usize = 4;

/// Largest number of events with a line per second; others are only counted.
pub const MOST_EVENTS: usize = 20;

/// A line: `isocat[12.000]: …`
fn line(at_ns: i64, what: &str) -> String {
    format!("isocat[{:.3}]: {what}\n", at_ns as f64 / 1e9)
}

/// The lines of a second; none before a status is known.
pub fn lines(trend: &Trend) -> String {
    let Some(status) = trend.status() else { return String::new() };
    let mut text = String::new();
    if status.in_operation() {
        for device in worst(status) {
            text += &line(status.at_ns, &device_words(device));
        }
    } else if !status.has_ended() {
        for behind in trend.all_behind().iter().take(MOST) {
            text += &line(status.at_ns, &format!("! {}", words::behind(status, behind)));
        }
    }
    text + &line(status.at_ns, &summary(status))
}

/// The first events as lines, and the number of the others.
pub fn events(status: &Status, events: &[Event]) -> String {
    let mut text = String::new();
    for event in events.iter().take(MOST_EVENTS) {
        let place = words::of(status, event);
        let sign = if event.bad { "! " } else { "" };
        text += &line(event.at_ns, &format!("{sign}{place}{}", event.what));
    }
    if events.len() > MOST_EVENTS {
        let more = events.len() - MOST_EVENTS;
        text += &line(status.at_ns, &format!("and {more} more events"));
    }
    text
}

/// The SubDevices in the worst state, worst first: not in OP, with alarms, then by the size of
/// their error.
fn worst(status: &Status) -> Vec<&Device> {
    let mut all: Vec<&Device> = status.devices.iter().filter(|device| device.asked).collect();
    let rank = |device: &Device| (device.is_in_op(), device.alarms.is_empty(), !device.has_sync);
    let error = |device: &Device| device.error.map_or(-1.0, |error| error.now_ns.abs());
    all.sort_by(|one, other| {
        rank(one).cmp(&rank(other)).then_with(|| error(other).total_cmp(&error(one)))
    });
    all.truncate(MOST);
    all
}

/// A line such as `2 axis 3  error  -12 ns worst 34 ns  margin 438.2 us  freq -45.01 ppm  OP`.
fn device_words(device: &Device) -> String {
    let mut text = format!("{} {}", device.position, device.name);
    if let Some(error) = device.error {
        let (now, worst) = (words::time(error.now_ns), words::time(error.worst_ns));
        text += &format!("  error {now:>7} worst {worst}");
    }
    if let Some(margin) = device.margin {
        text += &format!("  margin {}", words::time(margin.now_ns));
    }
    if let Some(ppm) = device.clock_ppm {
        text += &format!("  freq {ppm:+.2} ppm");
    }
    text += &format!("  {}", device.state());
    if device.al_error {
        text += &format!(" 0x{:04X}", device.al_code);
    }
    if device.risen() > 0 {
        text += &format!("  counters +{}", device.risen());
    }
    for alarm in &device.alarms {
        text += &format!("  ! {alarm}");
    }
    text
}

/// A line such as `in sync: 4 of 4 in OP  worst 13 ns  phase 3.9 us  servo locked -47.00 ppm  lost
/// 0`.
fn summary(status: &Status) -> String {
    let verdict = status.verdict();
    if !status.in_operation() {
        return verdict.words;
    }
    let asked = status.devices.iter().filter(|device| device.asked).count();
    let in_op = status.devices.iter().filter(|d| d.asked && d.is_in_op()).count();
    let mut text = format!("{in_op} of {asked} in OP");
    let now = |device: &Device| Some(device.error.filter(|_| device.has_sync)?.now_ns.abs());
    let worst = status.devices.iter().filter_map(now).max_by(f64::total_cmp);
    if let Some(worst) = worst {
        text += &format!("  error at most {} [{}]", words::time(worst), status.kind.source());
    }
    let host = &status.host;
    if let Some(phase) = host.phase_error_ns {
        text += &format!("  phase {}", words::time(phase));
    }
    if let Some(servo) = host.servo {
        text += &format!("  servo {}", servo_name(servo));
    }
    if let Some(ppm) = host.rate_ppm {
        text += &format!(" {ppm:+.2} ppm");
    }
    text += &format!("  lost {}  skipped {}", host.frames_lost, host.cycles_skipped);
    let alarms: usize = status.devices.iter().map(|device| device.alarms.len()).sum();
    if alarms > 0 {
        text += &format!("  alarms {alarms}");
    }
    match verdict.good {
        true => format!("in sync  {text}"),
        false => format!("{}  {text}", verdict.words),
    }
}
