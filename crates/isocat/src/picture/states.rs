//! The states of devices over time: a lane for each, a bar for each state.

use isocat_descriptions::columns::cut;

use super::Picture;
use super::frame::{Align, Frame};

/// The states of one device.
#[derive(Clone, PartialEq, Debug)]
pub struct Lane {
    /// Its name.
    pub name: String,
    /// First time of each state, ns, in the order of time.
    pub states: Vec<State>,
}

/// A state and the instant when it began.
#[derive(Clone, PartialEq, Debug)]
pub struct State {
    /// First time, ns.
    pub at: f64,
    /// Its name.
    pub name: String,
    /// Whether it has an error.
    pub error: bool,
    /// Text that the page shows for it.
    pub tip: String,
}

/// Draws lanes from `from` to `to` ns, with marks across all of them; `None` without lanes.
pub fn draw(
    id: &str,
    title: &str,
    (from, to): (f64, f64),
    lanes: &[Lane],
    marks: &[(f64, String)],
) -> Option<Picture> {
    if lanes.is_empty() {
        return None;
    }
    let mut frame = Frame::new(id, title, from, to).with_left(LEFT);
    let first = frame.lane(&cut(&lanes[0].name, CHARACTERS), HEIGHT);
    for (number, lane) in lanes.iter().enumerate() {
        let top = match number {
            0 => first,
            _ => frame.lane(&cut(&lane.name, CHARACTERS), HEIGHT),
        };
        for (place, state) in lane.states.iter().enumerate() {
            let end = lane.states.get(place + 1).map_or(to, |next| next.at);
            let ends = (state.at.max(from), end.min(to));
            let class = class(state);
            frame.bar(class, ends, top + 4.0, HEIGHT - 8.0, &state.tip);
            if frame.x(ends.1) - frame.x(ends.0) > 8.0 * state.name.len() as f64 {
                let middle = (ends.0 + ends.1) / 2.0;
                frame.label("", middle, top + HEIGHT / 2.0 + 4.0, Align::Middle, &state.name);
            }
        }
    }
    for (at, words) in marks.iter().take(MOST_MARKS) {
        frame.mark("m late", *at, first, HEIGHT * lanes.len() as f64, words);
    }
    Some(frame.finish())
}

/// Bars are pale, so that their labels are legible.
fn class(state: &State) -> &'static str {
    match &*state.name {
        _ if state.error => "late band",
        "OP" => "inputs band",
        "SAFEOP" => "pulse band",
        "PREOP" => "outputs band",
        _ => "wire band",
    }
}

const LEFT: f64 = 160.0;
/// Height of a lane.
const HEIGHT: f64 = 26.0;
/// Characters of a name that fit in front of the lanes.
const CHARACTERS: usize = 20;
/// Largest number of marks; more would hide the bars.
const MOST_MARKS: usize = 60;
