//! The frame of a drawing along time: an axis, lanes, marks, bars, and labels that do not overlap.

use std::fmt::Write;

use isocat_descriptions::quantity::time;

use super::{Picture, escape, number};

/// Width of all drawings along time.
pub const WIDTH: f64 = 1000.0;
/// Width of the lanes' names.
const LEFT: f64 = 128.0;
const RIGHT: f64 = 12.0;
/// Height of the axis.
const AXIS: f64 = 26.0;
/// Largest width of a character of a label.
const CHARACTER: f64 = 6.1;

/// A drawing along time.
#[derive(Clone, Debug)]
pub struct Frame {
    /// First and last time, ns.
    from: f64,
    to: f64,
    top: f64,
    /// Lower edge of the last lane.
    bottom: f64,
    left: f64,
    title: String,
    id: String,
    shapes: String,
    texts: String,
    under: String,
    /// Areas of the labels, by row.
    taken: Vec<(f64, f64, f64)>,
}

/// Position of a label.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Align {
    /// After the point.
    Start,
    /// Centred on the point.
    Middle,
    /// Before the point.
    End,
}

impl Frame {
    /// A drawing from `from` to `to`, ns. `id` is unique on the page.
    pub fn new(id: &str, title: &str, from: f64, to: f64) -> Self {
        Self {
            from,
            to: if to > from { to } else { from + 1.0 },
            top: 4.0,
            bottom: 4.0,
            left: LEFT,
            title: title.to_owned(),
            id: id.to_owned(),
            shapes: String::new(),
            texts: String::new(),
            under: String::new(),
            taken: Vec::new(),
        }
    }

    /// Sets the width of the lanes' names.
    pub(crate) fn with_left(mut self, left: f64) -> Self {
        self.left = left;
        self
    }

    /// The coordinate of a time, in units of the drawing.
    pub fn x(&self, ns: f64) -> f64 {
        self.left + (ns - self.from) / (self.to - self.from) * (WIDTH - RIGHT - self.left)
    }

    /// The last time, ns.
    pub(super) fn last(&self) -> f64 {
        self.to
    }
    /// Opens a lane of this height below the others; returns its upper edge.
    pub fn lane(&mut self, name: &str, height: f64) -> f64 {
        let top = self.bottom;
        self.bottom += height;
        let (middle, name) = (top + height / 2.0 + 4.0, escape(name));
        let (right, bottom) = (WIDTH - RIGHT, self.bottom);
        let _ = writeln!(
            self.under,
            "<line class=\"lane\" x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\"/>\
             <text class=\"name\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{name}</text>",
            number(self.left),
            number(bottom),
            number(right),
            number(bottom),
            number(self.left - 8.0),
            number(middle),
        );
        top
    }

    /// A bar from `from` to `to` ns.
    pub fn bar(&mut self, class: &str, (from, to): (f64, f64), y: f64, height: f64, tip: &str) {
        let (a, b) = (self.x(from), self.x(to));
        let _ = writeln!(
            self.shapes,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\">{}</rect>",
            exact(a.min(b)),
            number(y),
            exact((b - a).abs()),
            number(height),
            title(tip),
        );
    }

    /// A stroke at `at` ns.
    pub fn mark(&mut self, class: &str, at: f64, y: f64, height: f64, tip: &str) {
        let x = exact(self.x(at));
        let (y1, y2) = (number(y), number(y + height));
        let line = format!("x1=\"{x}\" y1=\"{y1}\" x2=\"{x}\" y2=\"{y2}\"");
        // A stroke is too thin to point at, so an invisible one around it receives the pointer.
        let _ = writeln!(
            self.shapes,
            "<g class=\"mark\"><line class=\"{class}\" {line}/><line class=\"grip\" {line}/>{}</g>",
            title(tip)
        );
    }

    /// A line through points: ns, and units of the drawing.
    pub fn line(&mut self, class: &str, points: &[(f64, f64)], closed: bool) {
        if points.is_empty() {
            return;
        }
        let mut path = String::new();
        for (i, (at, y)) in points.iter().enumerate() {
            let _ = write!(
                path,
                "{}{} {}",
                if i == 0 { "M" } else { "L" },
                tenths(self.x(*at)),
                tenths(*y)
            );
        }
        if closed {
            path.push('Z');
        }
        let _ = writeln!(self.shapes, "<path class=\"{class}\" d=\"{path}\"/>");
    }

    /// A distance with its label above it.
    pub fn distance(
        &mut self,
        class: &str,
        (from, to): (f64, f64),
        y: f64,
        words: &str,
        tip: &str,
    ) {
        let (a, b) = (exact(self.x(from)), exact(self.x(to)));
        let (y0, up, down) = (number(y), number(y - 4.0), number(y + 4.0));
        let _ = writeln!(
            self.shapes,
            "<g class=\"mark\"><path class=\"distance {class}\" d=\"M{a} {up}V{down}M{a} {y0}H{b}M{b} {up}V{down}\"/>\
             <path class=\"grip\" d=\"M{a} {y0}H{b}\"/>{}</g>",
            title(tip)
        );
        self.label_of(class, (from, to), y - 6.0, Align::Middle, words);
    }

    /// Words in the middle of what goes from one instant to another.
    pub fn between(&mut self, class: &str, ends: (f64, f64), y: f64, words: &str) -> bool {
        self.label_of(class, ends, y, Align::Middle, words)
    }
    /// Puts a label at `at` ns with `y` as its base line, unless it would overlap another one:
    /// every element has its figures also as a title. Returns whether it was put.
    pub fn label(&mut self, class: &str, at: f64, y: f64, align: Align, words: &str) -> bool {
        self.label_of(class, (at, at), y, align, words)
    }

    /// The same for a span: the label stays as long as a part of the span is visible.
    fn label_of(
        &mut self,
        class: &str,
        ends: (f64, f64),
        y: f64,
        align: Align,
        words: &str,
    ) -> bool {
        if ends.1 < self.from || ends.0 > self.to {
            return false;
        }
        let width = words.chars().count() as f64 * CHARACTER;
        let (first, last) = (self.x(ends.0), self.x(ends.1));
        // Where the place is taken: behind it or before it.
        let [middle, behind, before] =
            [(first + last - width) / 2.0, last + 3.0, first - width - 6.0];
        let places = match align {
            Align::Start => [first, before, behind],
            Align::Middle => [middle, behind, before],
            Align::End => [before, first - width, behind],
        };
        let within =
            |begin: f64| begin.clamp(self.left + 2.0, (WIDTH - RIGHT - width).max(self.left + 2.0));
        let free = |begin: &f64| {
            let end = begin + width;
            let meets = |(row, from, to): &(f64, f64, f64)| {
                (row - y).abs() < 11.0 && *begin < to + 5.0 && from - 5.0 < end
            };
            !self.taken.iter().any(meets)
        };
        let Some(begin) = places.map(within).into_iter().find(free) else { return false };
        let end = begin + width;
        self.taken.push((y, begin, end));
        let _ = writeln!(
            self.texts,
            "<text class=\"moves {class}\" x=\"{}\" y=\"{}\"{}>{}</text>",
            number(begin),
            number(y),
            if ends.0 == ends.1 {
                String::new()
            } else {
                format!(" data-ends=\"{} {}\"", exact(self.x(ends.0)), exact(self.x(ends.1)))
            },
            escape(words)
        );
        true
    }

    /// Puts words at a fixed place.
    pub fn words(&mut self, class: &str, x: f64, y: f64, align: Align, words: &str) {
        let anchor = match align {
            Align::Start => "start",
            Align::Middle => "middle",
            Align::End => "end",
        };
        let _ = writeln!(
            self.under,
            "<text class=\"{class}\" x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
            number(x),
            number(y),
            escape(words)
        );
    }

    /// A line across all times.
    pub fn level(&mut self, class: &str, y: f64) {
        let (x1, x2, y) = (number(self.left), number(WIDTH - RIGHT), number(y));
        let _ = writeln!(
            self.under,
            "<line class=\"{class}\" x1=\"{x1}\" y1=\"{y}\" x2=\"{x2}\" y2=\"{y}\"/>"
        );
    }

    /// Adds empty space.
    pub fn skip(&mut self, height: f64) {
        self.bottom += height;
    }

    /// Finishes the drawing, with its axis at the bottom.
    pub fn finish(self) -> Picture {
        let Self { from, to, top, bottom, left, id, .. } = &self;
        let (right, axis) = (WIDTH - RIGHT, self.axis());
        let height = bottom + AXIS;
        let area = format!(
            "x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"",
            number(*left),
            number(*top),
            number(right - left),
            number(bottom - top)
        );
        let body = format!(
            "<clipPath id=\"{id}-area\"><rect {area}/></clipPath>\n<g class=\"axis\">\n{axis}</g>\n{}\
             <rect class=\"surface\" {area}/>\n\
             <g clip-path=\"url(#{id}-area)\"><g class=\"stretch\">\n{}</g></g>\n{}",
            self.under, self.shapes, self.texts
        );
        let attributes = format!(
            " data-from=\"{from}\" data-to=\"{to}\" data-left=\"{}\" data-right=\"{}\" data-bottom=\"{}\"",
            number(*left),
            number(right),
            number(*bottom)
        );
        Picture {
            width: WIDTH as u32,
            height: height.ceil() as u32,
            title: self.title,
            attributes,
            body,
        }
    }

    fn axis(&self) -> String {
        let mut axis = String::new();
        let step = step((self.to - self.from) / 9.0);
        let mut at = (self.from / step).ceil() * step;
        while at <= self.to {
            let place = self.x(at);
            let x = number(place);
            let words = time(if at.abs() < step / 1e6 { 0.0 } else { at });
            // Half of the words stand to the right of their tick.
            let room = words.chars().count() as f64 * CHARACTER / 2.0;
            let (text, anchor) = match place + room > WIDTH {
                true => (number(WIDTH), "end"),
                false => (x.clone(), "middle"),
            };
            let _ = writeln!(
                axis,
                "<line class=\"grid\" x1=\"{x}\" y1=\"{}\" x2=\"{x}\" y2=\"{}\"/>\
                 <text class=\"tick\" x=\"{text}\" y=\"{}\" text-anchor=\"{anchor}\">{words}</text>",
                number(self.top),
                number(self.bottom),
                number(self.bottom + 16.0),
            );
            at += step;
        }
        axis
    }
}

/// A coordinate that stays exact when it is stretched by a factor of a hundred thousand.
fn exact(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A coordinate on a curve.
fn tenths(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

fn title(tip: &str) -> String {
    if tip.is_empty() { String::new() } else { format!("<title>{}</title>", escape(tip)) }
}

/// The next of 1, 2, 5, 10 … that is not smaller.
pub(crate) fn step(least: f64) -> f64 {
    if !(least.is_finite() && least > 0.0) {
        return 1.0;
    }
    let ten = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * ten)
        .find(|step| *step >= least * 0.999_999)
        .unwrap_or(10.0 * ten)
}
