//! Counts by size.

use std::fmt::Write;

use isocat_descriptions::quantity::time;

use super::frame::step;
use super::{Picture, escape, number};

/// The data of the drawing.
#[derive(Clone, Copy, Debug)]
pub struct Histogram<'a> {
    /// Its title.
    pub title: &'a str,
    /// Begin and end of each bin, ns, and the number of values in it; in the order of size.
    pub bins: &'a [(f64, f64, u64)],
}

const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 142.0;
const LEFT: f64 = 46.0;
const BOTTOM: f64 = 26.0;
const TOP: f64 = 6.0;

impl Histogram<'_> {
    /// The drawing; `None` without counts.
    pub fn draw(&self) -> Option<Picture> {
        let most = self.bins.iter().map(|(_, _, count)| *count).max()?.max(1);
        let (mut from, mut to) = (self.bins.first()?.0, self.bins.last()?.1);
        let room = ((to - from) * 0.06).max(0.5);
        (from, to) = (from - room, to + room);
        let (right, floor) = (WIDTH - 8.0, HEIGHT - BOTTOM);
        let x = |ns: f64| LEFT + (ns - from) / (to - from) * (right - LEFT);
        let y = |count: f64| floor - count / most as f64 * (floor - TOP);
        let mut body = String::new();
        let unit = step((to - from) / 4.0);
        let mut at = (from / unit).ceil() * unit;
        while at <= to {
            let class = if at.abs() < unit / 1e3 { "zero" } else { "grid" };
            let place = number(x(at));
            let _ = writeln!(
                body,
                "<line class=\"{class}\" x1=\"{place}\" y1=\"{TOP}\" x2=\"{place}\" y2=\"{floor}\"/>\
                 <text class=\"tick\" x=\"{place}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                floor + 16.0,
                time(at)
            );
            at += unit;
        }
        let _ = writeln!(
            body,
            "<text class=\"tick\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{most}</text>\
             <text class=\"tick\" x=\"{}\" y=\"{}\" text-anchor=\"end\">0</text>",
            LEFT - 6.0,
            TOP + 9.0,
            LEFT - 6.0,
            floor
        );
        for (begin, end, count) in self.bins {
            let (left, top) = (x(*begin), y(*count as f64));
            let _ = writeln!(
                body,
                "<rect class=\"column\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
                number(left),
                number(top),
                number((x(*end) - left - 0.5).max(0.5)),
                number(floor - top),
                escape(&format!("from {} to {}: {count} times", time(*begin), time(*end)))
            );
        }
        Some(Picture {
            width: WIDTH as u32,
            height: HEIGHT as u32,
            title: self.title.to_owned(),
            attributes: String::new(),
            body,
        })
    }
}
