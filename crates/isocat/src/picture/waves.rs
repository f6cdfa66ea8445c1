//! Digital signals over time, as an oscilloscope shows them.

use isocat_descriptions::quantity::time;

use super::Picture;
use super::frame::{Align, Frame};

/// A signal.
#[derive(Clone, PartialEq, Debug)]
pub struct Signal {
    /// Its name.
    pub name: String,
    /// Whether it is high before the first change.
    pub high: bool,
    /// Times of its changes, ns, in the order of time.
    pub changes: Vec<f64>,
    /// Instants to mark below it, ns, with their labels.
    pub events: Vec<(f64, String)>,
    /// Distances to show above it, ns, with their labels.
    pub distances: Vec<((f64, f64), String)>,
}

/// Draws signals one below the other.
pub fn draw(id: &str, title: &str, (from, to): (f64, f64), signals: &[Signal]) -> Picture {
    let mut frame = Frame::new(id, title, from, to).with_left(150.0);
    for signal in signals {
        let above = if signal.distances.is_empty() { 8.0 } else { 26.0 };
        let below = if signal.events.is_empty() { 8.0 } else { 22.0 };
        let top = frame.lane(&signal.name, above + HIGH + below) + above;
        let (high, low) = (top, top + HIGH);
        let mut level = signal.high;
        let place = |level: bool| if level { high } else { low };
        let mut points = vec![(from, place(level))];
        for (i, at) in signal.changes.iter().enumerate() {
            points.push((*at, place(level)));
            level = !level;
            points.push((*at, place(level)));
            let edge = if level { "rises" } else { "falls" };
            let before = i.checked_sub(1).map(|before| at - signal.changes[before]);
            let since = before.map_or(String::new(), |since| {
                format!("\n{} after the change before", time(since))
            });
            let tip = format!("{} {edge} at {at} ns{since}", signal.name);
            frame.mark("m hidden", *at, high, HIGH, &tip);
        }
        points.push((to, place(level)));
        frame.line("signal", &points, false);
        for (at, words) in &signal.events {
            frame.mark("m wire", *at, low, 8.0, &format!("{words} at {at} ns"));
            frame.label("quiet", *at, low + 17.0, Align::Start, words);
        }
        for (ends, words) in &signal.distances {
            frame.distance("", *ends, high - 8.0, words, words);
        }
    }
    frame.finish()
}

/// Height of a signal.
const HIGH: f64 = 26.0;
