//! The pictures of a run, with the same drawings as in reports.

use isocat::picture::{Picture, cycle, series, waves};
use isocat::recording::series::Series;
use isocat_sim::observation::Observed;
use isocat_sync::Step;
use isocat_wire::time::{Nanos, Picos};

use crate::run::Ran;

/// Number of cycles that the waveforms show.
const SHOWN: i64 = 3;
/// Largest number of changes of one signal that are drawn.
const MOST_CHANGES: usize = 400;

/// The planned and the seen cycle of a device; `None`: the plan does not have it.
pub fn cycle(ran: &Ran, position: usize) -> Option<Picture> {
    let seen = ran.recorded.devices.get(position).and_then(|device| device.cycle.as_ref());
    let id = format!("cycle{position}");
    let name = &ran.report.devices.get(position)?.name;
    cycle::Cycle { id: &id, name, timing: ran.timing.as_ref()?, position, seen }.draw()
}

/// What happened around the first missed event of a device.
pub fn first_miss(ran: &Ran, position: usize) -> Option<Picture> {
    let around = ran.recorded.devices.get(position)?.around_miss.as_ref()?;
    let title =
        format!("Around the first missed SM event of {}", ran.report.devices[position].name);
    cycle::events(&format!("miss{position}"), &title, around)
}

/// Draws how a clock approaches the reference clock and follows it.
pub fn clock(ran: &Ran, position: usize) -> Option<Picture> {
    let mut series = Series::new(ran.way_up.len());
    for (at, differences) in &ran.way_up {
        if let Some(difference) = differences.get(position).copied().flatten() {
            series.push(*at, difference);
        }
    }
    let length = ran.way_up.last()?.0.0 as f64 / 1e3;
    let title = format!(
        "Clock of {} beside the reference clock, on the way up",
        ran.report.devices[position].name
    );
    let id = format!("clock{position}");
    let chart = series::Chart {
        id: &id,
        title: &title,
        series: &series,
        limit: None,
        marks: &[],
        span: (0.0, length),
    };
    chart.draw().filter(|_| series.range() != Some((0, 0)))
}

/// Draws SYNC0 of a device against the ideal grid, over all cycles.
pub fn sync0(ran: &Ran, position: usize, limit: Nanos) -> Option<Picture> {
    let device = ran.recorded.devices.get(position)?;
    let marks: Vec<(f64, String)> = device
        .missed
        .iter()
        .map(|(at, counter)| (at.0 as f64 / 1e3, format!("SM event missed, 0x1C32:0B = {counter}")))
        .collect();
    let title = format!("SYNC0 of {} beside the ideal grid", ran.report.devices[position].name);
    let id = format!("sync0-{position}");
    let length = ran.recorded.length.0 as f64 / 1e3;
    let limit = Some(Picos::from(limit).0);
    series::Chart {
        id: &id,
        title: &title,
        series: &device.sync0,
        limit,
        marks: &marks,
        span: (0.0, length),
    }
    .draw()
}

/// Draws signals of one device over some cycles, and SYNC0 of the others. `at` counts cycles from
/// the beginning of the recording.
pub fn waves(ran: &Ran, position: usize, at: i64) -> Picture {
    let cycle = ran.cycle.0;
    // The window also shows signals that began before it.
    let window = (at.max(0) * cycle, (at.max(0) + SHOWN) * cycle);
    let mut signals = vec![
        events(ran, position, window),
        pulses(ran, position, window, Observed::Sync0, "SYNC0"),
        pulses(ran, position, window, Observed::Sync1, "SYNC1"),
        work(ran, position, window, Step::MapOutputs, "outputs copied"),
        work(ran, position, window, Step::Application, "application"),
        work(ran, position, window, Step::MapInputs, "inputs copied"),
    ];
    let name = |at: usize| ran.report.devices[at].name.as_str();
    for other in (0..ran.report.devices.len()).filter(|other| *other != position) {
        let named = format!("SYNC0 {}", name(other));
        signals.push(pulses(ran, other, window, Observed::Sync0, &named));
    }
    signals.retain(|signal| signal.high || !signal.changes.is_empty() || !signal.events.is_empty());
    let title =
        format!("Signals of {}, cycles {} to {}", name(position), at.max(0), at.max(0) + SHOWN - 1);
    let (from, to) = (window.0 as f64, window.1 as f64);
    waves::draw("waves", &title, (from, to), &signals)
}

fn of(ran: &Ran, position: usize) -> impl Iterator<Item = (f64, Observed)> + '_ {
    let of = ran.events.iter().filter(move |(_, device, _)| *device == position);
    of.map(|(at, _, event)| (at.0 as f64 / 1e3, *event))
}

fn signal(name: &str) -> waves::Signal {
    let (changes, events) = (Vec::new(), Vec::new());
    waves::Signal { name: name.to_owned(), high: false, changes, events, distances: Vec::new() }
}

fn events(ran: &Ran, position: usize, (from, to): (i64, i64)) -> waves::Signal {
    let mut signal = signal("SM events");
    for (at, event) in of(ran, position).filter(|(at, _)| (from as f64..to as f64).contains(at)) {
        let words = match event {
            Observed::Sm2 => "SM2",
            Observed::Sm3 => "SM3",
            Observed::SmEventMissed(_) => "missed",
            _ => continue,
        };
        signal.events.push((at, words.to_owned()));
    }
    signal
}

/// Pulses of the length in register 0x0982. A pulse without a length, which the CPU acknowledges,
/// is drawn 1 ns long.
fn pulses(
    ran: &Ran,
    position: usize,
    window: (i64, i64),
    which: Observed,
    name: &str,
) -> waves::Signal {
    let length = ran.pulses.get(position).map_or(0, |length| length.0).max(1) as f64;
    let edges = of(ran, position).filter(|(_, event)| *event == which);
    levels(edges.map(|(at, _)| (at, at + length)), window, name)
}

fn work(ran: &Ran, position: usize, window: (i64, i64), step: Step, name: &str) -> waves::Signal {
    let mut begun = None;
    let pairs = of(ran, position).filter_map(|(at, event)| match event {
        Observed::Began(began) if began == step => {
            begun = Some(at);
            None
        }
        Observed::Finished(ended) if ended == step => begun.take().map(|begin| (begin, at)),
        _ => None,
    });
    levels(pairs, window, name)
}

/// A signal that is high between pairs of instants, as far as they are in the window.
fn levels(
    pairs: impl Iterator<Item = (f64, f64)>,
    (from, to): (i64, i64),
    name: &str,
) -> waves::Signal {
    let (from, to) = (from as f64, to as f64);
    let mut signal = signal(name);
    for (rises, falls) in pairs {
        if falls <= from || rises >= to || signal.changes.len() >= MOST_CHANGES {
            continue;
        }
        match rises <= from {
            true => signal.high = true,
            false => signal.changes.push(rises),
        }
        if falls < to {
            signal.changes.push(falls);
        }
    }
    signal
}
