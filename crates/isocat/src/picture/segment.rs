//! All SubDevices on one axis: what each does in the bus cycle, and what is left before its
//! deadlines.
//!
//! A row for each SubDevice, or for several that are equal. Frames stand behind all rows, since
//! they are the same for all. A margin is coloured by what is left of it against the lateness of
//! the host: green more than a frame may be late, orange less, red nothing.

use isocat_descriptions::columns::cut;
use isocat_descriptions::quantity::time;
use isocat_engine::recording::cycle::{CycleSeen, acting};
use isocat_maindevice::segment::Timing;
use isocat_sync::Moment;
use isocat_wire::time::Nanos;

use super::Picture;
use super::cycle::ns;
use super::frame::Frame;
use super::margin::{self, Margin, margins};

/// A row.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// Place and name.
    pub name: String,
    /// The SubDevices that it stands for, with what was seen of each; `None`: the plan alone.
    pub members: Vec<(usize, Option<&'a CycleSeen>)>,
}

/// What is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Devices<'a> {
    /// A name that no other picture on the page has.
    pub id: &'a str,
    /// The plan.
    pub timing: &'a Timing,
    /// The rows, from top to bottom.
    pub rows: &'a [Row<'a>],
}

/// Height of a row; where bars begin in it, and how high they are.
const ROW: f64 = 40.0;
const BARS: f64 = 20.0;
const BAR: f64 = 12.0;
/// Room for names, and their characters.
const NAMES: f64 = 190.0;
const CHARACTERS: usize = 27;
/// Frames that are drawn at most: a slow SubDevice on a fast bus sees many.
const MOST_FRAMES: i64 = 64;

/// An event of a row, ns: on average at the SubDevice with the least margin, and between which
/// instants at all of them.
#[derive(Clone, Copy)]
struct Event {
    at: f64,
    from: f64,
    to: f64,
}

impl Devices<'_> {
    /// The drawing; `None` if none of them has a place in the bus cycle.
    pub fn draw(&self) -> Option<Picture> {
        let rows: Vec<&Row<'_>> = self.rows.iter().filter(|row| self.has_place(row)).collect();
        if rows.is_empty() {
            return None;
        }
        let (from, to) = self.range(&rows);
        let title = "All SubDevices in the bus cycle";
        let mut frame = Frame::new(self.id, title, from, to).with_left(NAMES);
        let height = 24.0 + rows.len() as f64 * ROW;
        let top = frame.lane("frames", 24.0);
        self.frames(&mut frame, (top, height), to);
        for row in rows {
            self.row(&mut frame, row);
        }
        Some(frame.finish())
    }

    fn has_place(&self, row: &Row<'_>) -> bool {
        let of = |moment| self.event(row, moment).is_some();
        of(Moment::OutputsReady) || of(Moment::InputLatch)
    }

    fn range(&self, rows: &[&Row<'_>]) -> (f64, f64) {
        let cycle = &self.timing.cycle;
        let frames = self.timing.frames.last().map_or(Nanos::ZERO, |frame| frame.end);
        let positions = rows.iter().flat_map(|row| &row.members).map(|(position, _)| *position);
        let exchange = positions
            .filter_map(|at| Some(self.timing.devices.get(at)?.0.exchange(cycle)))
            .max()
            .unwrap_or(cycle.cycle);
        let (mut from, mut to) =
            (cycle.send.0.min(0) as f64, (cycle.send + exchange + frames + cycle.jitter).0 as f64);
        for row in rows {
            let drawn = [Moment::OutputsReady, Moment::InputLatch, Moment::InputsAvailable];
            for event in drawn.into_iter().filter_map(|moment| self.event(row, moment)) {
                (from, to) = (from.min(event.from), to.max(event.to));
            }
        }
        let margin = (to - from) * 0.015;
        (from - margin, to + margin)
    }

    /// Frames and their lateness, behind everything.
    fn frames(&self, drawing: &mut Frame, (top, height): (f64, f64), to: f64) {
        let cycle = &self.timing.cycle;
        for turn in 0..MOST_FRAMES {
            let begin = cycle.send + Nanos(cycle.cycle.0 * turn);
            if begin.0 as f64 > to {
                break;
            }
            let in_cycle = |every: u32| turn % i64::from(every.max(1)) == 0;
            for frame in self.timing.frames.iter().filter(|frame| in_cycle(frame.every)) {
                let (from, to) = ((begin + frame.begin).0 as f64, (begin + frame.end).0 as f64);
                let late = to + cycle.jitter.0 as f64;
                let tip = format!(
                    "frame with {} bytes\nplanned from {} to {} at the reference clock, up to {} later",
                    frame.length,
                    time(from),
                    time(to),
                    cycle.jitter
                );
                drawing.bar("jitter column", (from, late), top + 2.0, height - 4.0, &tip);
                drawing.bar("wire", (from, to), top + 7.0, 11.0, &tip);
            }
        }
    }

    fn row(&self, drawing: &mut Frame, row: &Row<'_>) {
        let y = drawing.lane(&cut(&row.name, CHARACTERS), ROW) + BARS;
        let worst = self.worst(row);
        // Margins below everything else, and their words first: they are what is looked for.
        for margin in &worst {
            let class = margin.class(self.timing.cycle.jitter);
            let ends = (margin.done.min(margin.deadline), margin.done.max(margin.deadline));
            let words = match margin.left < 0.0 {
                true => format!("{} too late by {}", margin.what, time(-margin.left)),
                false => format!("{} {}", margin.what, ns(margin.left)),
            };
            let tip = format!("{}: {words}\nleft at worst until {}", row.name, margin.until);
            drawing.bar(&format!("left {class}"), ends, y, BAR, &tip);
            drawing.between(class, ends, y - 6.0, &words);
        }
        let event = |moment| self.event(row, moment);
        let (ready, latch) = (event(Moment::OutputsReady), event(Moment::InputLatch));
        let begin = event(Moment::OutputsFetched).or_else(|| event(Moment::Sm2));
        self.work(drawing, ("outputs", y), (begin, ready), "outputs are ready", row);
        let available = event(Moment::InputsAvailable);
        self.work(drawing, ("inputs", y), (latch, available), "inputs stand in the buffer", row);
        if let Some(latch) = latch {
            let tip = tip(row, "Input Latch", latch);
            drawing.mark("m inputs", latch.at, y - 3.0, BAR + 6.0, &tip);
        }
        let pulse = self.first(row).and_then(|position| acting(&self.timing.devices[position].0));
        if let Some((moment, pulse)) = pulse.and_then(|moment| Some((moment, event(moment)?))) {
            let name = if moment == Moment::Sync1 { "SYNC1" } else { "SYNC0" };
            let tip = tip(row, &format!("{name}: outputs act"), pulse);
            drawing.mark("m pulse", pulse.at, y - 5.0, BAR + 10.0, &tip);
        }
    }

    /// Work that ends with an event; its begin may not be known.
    fn work(
        &self,
        drawing: &mut Frame,
        (class, y): (&str, f64),
        (begin, end): (Option<Event>, Option<Event>),
        words: &str,
        row: &Row<'_>,
    ) {
        let Some(end) = end else { return };
        let tip = tip(row, words, end);
        if let Some(begin) = begin.filter(|begin| begin.at < end.at) {
            drawing.bar(class, (begin.at, end.at), y, BAR, &tip);
        }
        drawing.bar(&format!("{class} band"), (end.from, end.to), y, BAR, &tip);
    }

    /// The margins of a row: of each kind the least one.
    fn worst(&self, row: &Row<'_>) -> Vec<Margin> {
        let mut worst: Vec<Margin> = Vec::new();
        for (position, seen) in &row.members {
            for margin in margins(self.timing, *position, *seen) {
                match worst.iter_mut().find(|known| known.what == margin.what) {
                    Some(known) if margin.left < known.left => *known = margin,
                    Some(_) => {}
                    None => worst.push(margin),
                }
            }
        }
        worst
    }

    /// The SubDevice of a row with the least margin.
    fn first(&self, row: &Row<'_>) -> Option<usize> {
        Some(tightest(self.timing, row)?.0)
    }

    fn event(&self, row: &Row<'_>, moment: Moment) -> Option<Event> {
        let all = row.members.iter().filter_map(|(position, seen)| {
            event(self.timing, *position, *seen, moment).map(|event| (*position, event))
        });
        let all: Vec<(usize, Event)> = all.collect();
        let first = self.first(row)?;
        let at = all.iter().find(|(position, _)| *position == first).or(all.first())?.1.at;
        let from = all.iter().map(|(_, event)| event.from).reduce(f64::min)?;
        let to = all.iter().map(|(_, event)| event.to).reduce(f64::max)?;
        Some(Event { at, from, to })
    }
}

/// The member of a row with the least margin, and what was seen of it.
pub fn tightest<'a>(timing: &Timing, row: &Row<'a>) -> Option<(usize, Option<&'a CycleSeen>)> {
    let left = |(position, seen): &(usize, Option<&CycleSeen>)| {
        margin::least(&margins(timing, *position, *seen)).unwrap_or(f64::INFINITY)
    };
    row.members.iter().copied().min_by(|a, b| left(a).total_cmp(&left(b)))
}

/// An event of one SubDevice in the bus cycle: seen, else planned.
fn event(
    timing: &Timing,
    position: usize,
    seen: Option<&CycleSeen>,
    moment: Moment,
) -> Option<Event> {
    use isocat_engine::recording::cycle::Origin;
    if seen.is_some_and(|seen| seen.origin == Origin::OwnCycle) {
        return None;
    }
    if let Some(seen) = seen.and_then(|seen| seen.of(moment)) {
        let [from, to] = [seen.least(), seen.largest()].map(|ps| ps as f64 / 1e3);
        return Some(Event { at: seen.mean() / 1e3, from, to });
    }
    let span = timing.moments(position)?.of(moment)?;
    let [from, to] = [span.earliest, span.latest].map(|phase| phase.0 as f64);
    Some(Event { at: (from + to) / 2.0, from, to })
}

fn tip(row: &Row<'_>, words: &str, event: Event) -> String {
    let Event { at, from, to } = event;
    let several = match row.members.len() {
        1 => "",
        _ => " (the least margin of them; from and to are of all)",
    };
    format!("{}: {words}\nat {}, from {} to {}{several}", row.name, time(at), time(from), time(to))
}
