//! A series over time: a band from least to largest, and the mean in it.

use isocat_descriptions::quantity::time;
use isocat_engine::recording::series::Series;

use super::Picture;
use super::frame::{Align, Frame, step};

/// The data of the drawing.
#[derive(Clone, Copy, Debug)]
pub struct Chart<'a> {
    /// An id that is unique on the page.
    pub id: &'a str,
    /// Its title.
    pub title: &'a str,
    /// The series, values in ps.
    pub series: &'a Series,
    /// Limit on both sides, ps; drawn if it is near.
    pub limit: Option<i64>,
    /// Instants to mark, ns, with their description.
    pub marks: &'a [(f64, String)],
    /// First and last instant of the axis of time, ns.
    pub span: (f64, f64),
}

const HEIGHT: f64 = 110.0;
/// Largest number of marks; more would hide the curve.
const MOST_MARKS: usize = 60;

impl Chart<'_> {
    /// The drawing; `None` without values.
    pub fn draw(&self) -> Option<Picture> {
        let (least, largest) = self.series.range()?;
        let (mut low, mut high) = (least.min(0) as f64 / 1e3, largest.max(0) as f64 / 1e3);
        let limit = self.limit.map(|limit| limit as f64 / 1e3);
        let near = |limit: &f64| *limit < 4.0 * low.abs().max(high);
        let limit = limit.filter(near);
        if let Some(limit) = limit {
            (low, high) = (low.min(-limit), high.max(limit));
        }
        let room = ((high - low) * 0.08).max(0.5);
        (low, high) = (low - room, high + room);
        let (from, to) = self.span;
        let mut frame = Frame::new(self.id, self.title, from, to.max(from + 1.0));
        frame.skip(6.0);
        let top = frame.lane("", HEIGHT);
        let y = |value: f64| top + (high - value) / (high - low) * HEIGHT;
        let unit = step((high - low) / 4.0);
        let mut level = (low / unit).ceil() * unit;
        while level <= high {
            let at = y(level);
            frame.level(if level.abs() < unit / 1e3 { "zero" } else { "grid" }, at);
            frame.words("tick", 120.0, at + 4.0, Align::End, &time(level));
            level += unit;
        }
        for limit in limit.into_iter().flat_map(|limit| [limit, -limit]) {
            frame.level("limit", y(limit));
        }
        let spans = self.series.spans();
        let begin_and_end = |span: &isocat_engine::recording::series::SpanOfTime| {
            [span.begin.0 as f64 / 1e3, span.end.0 as f64 / 1e3]
        };
        let mut around: Vec<(f64, f64)> = Vec::with_capacity(spans.len() * 4);
        for span in spans {
            around.extend(begin_and_end(span).map(|at| (at, y(span.largest as f64 / 1e3))));
        }
        for span in spans.iter().rev() {
            let [begin, end] = begin_and_end(span);
            around.extend([end, begin].map(|at| (at, y(span.least as f64 / 1e3))));
        }
        frame.line("area", &around, true);
        let mean = |span: &isocat_engine::recording::series::SpanOfTime| {
            let [begin, end] = begin_and_end(span);
            ((begin + end) / 2.0, y(span.mean() / 1e3))
        };
        frame.line("curve", &spans.iter().map(mean).collect::<Vec<_>>(), false);
        for (at, words) in self.marks.iter().take(MOST_MARKS) {
            frame.mark("m late", *at, top, HEIGHT, words);
        }
        let mut picture = frame.finish();
        // Data that the page shows for the pointed place: begin and end, least, mean and largest,
        // all ns.
        let values: Vec<String> = spans.iter().map(values).collect();
        picture.attributes += &format!(" data-series=\"{}\"", values.join(" "));
        Some(picture)
    }
}

fn values(span: &isocat_engine::recording::series::SpanOfTime) -> String {
    let ns = |ps: i64| number_of_ps(ps as f64);
    format!(
        "{},{},{},{},{}",
        span.begin.0 / 1_000,
        span.end.0 / 1_000,
        ns(span.least),
        number_of_ps(span.mean()),
        ns(span.largest)
    )
}

/// A value in ps as ns, to the picosecond.
fn number_of_ps(ps: f64) -> String {
    let text = format!("{:.3}", ps / 1e3);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
