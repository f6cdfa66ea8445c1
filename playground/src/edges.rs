//! Draws the SYNC0 edges of all devices against the ideal grid, cycle by cycle; before there are
//! edges, the differences of their clocks from the reference clock.

use isocat::picture::{Align, Frame, Picture};
use isocat::quantity::time;
use isocat_wire::time::Picos;

use crate::run::Ran;

/// Largest number of samples of the way up that can be shown.
const MOST_WAY: usize = 120;
/// Number of earlier values that are also shown.
const TRAIL: usize = 24;
/// Least length of the axis on each side, ns: three ticks of an ESC.
const LEAST: f64 = 30.0;

/// Number of samples of the way up that can be shown.
pub fn way_up(ran: &Ran) -> usize {
    ran.way_up.len().min(MOST_WAY)
}

/// Draws the edges of cycle `at`. The way up has negative numbers; its last sample is -1.
pub fn draw(ran: &Ran, at: i64) -> Picture {
    let before = at < 0;
    let devices = ran.report.devices.len();
    let trails: Vec<Vec<f64>> = (0..devices)
        .map(|position| if before { clocks(ran, position, at) } else { edges(ran, position, at) })
        .collect();
    let far = trails.iter().flatten().fold(LEAST, |far, value| far.max(value.abs()));
    // Round ends of the axis change less often from cycle to cycle.
    let ten = 10f64.powf(far.log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0];
    let end =
        steps.iter().map(|step| step * ten).find(|end| *end >= far * 1.1).unwrap_or(far * 1.1);
    let title = if before {
        "Clocks beside the reference clock, on the way up".to_owned()
    } else {
        format!("SYNC0 edges beside the ideal grid, cycle {at}")
    };
    let mut frame = Frame::new("edges", &title, -end, end);
    let what = if before { "clock" } else { "SYNC0" };
    let top = frame.lane("", 18.0);
    let words = if before { "reference clock" } else { "ideal grid" };
    frame.label("quiet", 0.0, top + 13.0, Align::Middle, words);
    for (position, trail) in trails.iter().enumerate() {
        let name = &ran.report.devices[position].name;
        let y = frame.lane(name, 34.0);
        frame.mark("zero", 0.0, y, 34.0, words);
        let Some((now, earlier)) = trail.split_last() else {
            let why = if before { "no clock" } else { "no SYNC0 in this cycle" };
            frame.label("quiet", -end, y + 22.0, Align::Start, why);
            continue;
        };
        for value in earlier {
            frame.mark(
                "m pulse band",
                *value,
                y + 10.0,
                14.0,
                &format!("earlier: {}", time(*value)),
            );
        }
        let tip = format!("{name}: {what} {} off", time(*now));
        frame.mark("m pulse", *now, y + 5.0, 24.0, &tip);
        frame.label("", *now + end * 0.008, y + 15.0, Align::Start, &time(*now));
    }
    frame.finish()
}

/// Errors of the edges up to the end of a cycle, ns; empty if the cycle has no edge.
fn edges(ran: &Ran, position: usize, at: i64) -> Vec<f64> {
    let Some(device) = ran.recorded.devices.get(position) else { return Vec::new() };
    let cycle = Picos::from(ran.cycle).0;
    let (begin, end) = (Picos(at * cycle), Picos((at + 1) * cycle));
    let spans = device.sync0.spans();
    let until = spans.partition_point(|span| span.begin < end);
    if until == 0 || spans[until - 1].end < begin {
        return Vec::new();
    }
    spans[until.saturating_sub(TRAIL)..until].iter().map(|span| span.mean() / 1e3).collect()
}

fn clocks(ran: &Ran, position: usize, at: i64) -> Vec<f64> {
    let samples = way_up(ran) as i64;
    let number = |at: i64| {
        // Samples are taken evenly from the whole way up, with its first and last one.
        let (of, last) = ((at + samples).max(0) as usize, ran.way_up.len() - 1);
        if samples > 1 { of * last / (samples as usize - 1) } else { 0 }
    };
    let sample = |at: i64| ran.way_up.get(number(at))?.1.get(position).copied().flatten();
    let from = (at - TRAIL as i64 + 1).max(-samples);
    (from..=at).filter_map(sample).map(|ps| ps as f64 / 1e3).collect()
}
