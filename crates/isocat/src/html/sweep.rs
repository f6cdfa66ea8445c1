//! The results of many runs of a segment, as a page.

use isocat_descriptions::quantity::time;
use isocat_engine::sweep::summary::{Counts, Frontier, Holds, MEASURES, Measure, Summary};
use isocat_engine::sweep::{self, Totals};
use maud::{Markup, html};

use super::Page;
use super::parts::{bad_tile, figure, table, tile};
use crate::picture::bars::Histogram;

/// The data of the page.
pub struct Sweep<'a> {
    /// The segment file.
    pub source: &'a str,
    /// The sweep.
    pub sweep: &'a sweep::Sweep,
    /// The totals of the runs.
    pub totals: &'a Totals,
    /// Sizes of figures, and the limits in the grid.
    pub summary: &'a Summary,
    /// Number of the run before which it was stopped; `None` if it was not.
    pub stopped: Option<u64>,
    /// The command that repeats it.
    pub command: String,
    /// The totals for programs.
    pub json: String,
}

/// Verdicts in the order of importance, with the class of their bar.
const VERDICTS: [(&str, &str); 5] = [
    ("in-sync", "held"),
    ("not-in-sync", "lost"),
    ("not-up", "down"),
    ("refused", "refused"),
    ("panicked", "panicked"),
];

impl Sweep<'_> {
    /// The page.
    pub fn page(self) -> Page {
        let (runs, good) = (self.totals.runs, self.totals.as_expected);
        let verdict = match runs - good {
            0 => format!("All {runs} runs were as expected."),
            bad => format!("{bad} of {runs} runs were not as expected."),
        };
        Page {
            title: format!("{} - isocat sweep", self.source),
            kind: "Many runs of one segment",
            good: runs == good && self.stopped.is_none(),
            verdict,
            body: self.body(),
            command: self.command,
            json: self.json,
        }
    }

    fn body(&self) -> Markup {
        let (runs, good) = (self.totals.runs, self.totals.as_expected);
        html! {
            p.quiet { (self.source) }
            @if let Some(next) = self.stopped {
                p.bad { "Stopped before run " (next) " of " (self.sweep.runs()) "." }
            }
            div.tiles {
                (tile("runs", &runs.to_string(), ""))
                (tile("as expected", &share(good, runs), ""))
                (bad_tile(good < runs, "not as expected", &(runs - good).to_string(), ""))
                @let panicked = self.totals.verdicts.get("panicked").copied().unwrap_or(0);
                @if panicked > 0 { (bad_tile(true, "panicked: a fault of isocat", &panicked.to_string(), "")) }
            }
            (self.verdicts())
            @if let Some(frontier) = &self.summary.frontier { (grid(frontier)) }
            (self.values())
            (self.findings())
            section {
                h2 { "How large figures were" }
                p.quiet { "In true time. Each drawing has its own scale." }
                @for (measure, counts) in MEASURES.iter().zip(&self.summary.measures) {
                    (histograms(measure, counts))
                }
            }
        }
    }

    fn verdicts(&self) -> Markup {
        let verdicts = &self.totals.verdicts;
        let found =
            || VERDICTS.iter().filter_map(|(name, class)| Some((name, class, verdicts.get(name)?)));
        html! {
            section {
                h2 { "Verdicts" }
                div.verdicts aria-hidden="true" {
                    @for (_, class, count) in found() {
                        div class=(class) style={ "flex-grow:" (count) } {}
                    }
                }
                (table(&["", "verdict", "runs", "share"], html! {
                    @for (name, class, count) in found() {
                        tr {
                            td { span class={ "key " (class) } {} } td { (name) }
                            td.number { (count) } td.number { (share(*count, self.totals.runs)) }
                        }
                    }
                }))
            }
        }
    }

    /// The values of each axis of the grid separately.
    fn values(&self) -> Markup {
        let axes = self.sweep.axes().iter().enumerate().filter(|(_, axis)| axis.values() > 1);
        html! {
            @for (number, axis) in axes {
                section {
                    h2 { "Values of " code { (axis.key) } }
                    (table(&["value", "runs", "as expected"], html! {
                        @for (value, (runs, good)) in self.totals.of_axis(number, axis) {
                            tr {
                                td { (value) } td.number { (runs) } td.number.bad[good < runs] { (share(*good, *runs)) }
                            }
                        }
                    }))
                }
            }
        }
    }

    fn findings(&self) -> Markup {
        let totals = self.totals;
        let mut findings: Vec<_> = totals.findings.iter().collect();
        findings.sort_by_key(|(name, count)| (std::cmp::Reverse(**count), name.as_str()));
        let bad = totals.runs - totals.as_expected;
        html! {
            @if !findings.is_empty() {
                section {
                    h2 { "First findings of runs that were not as expected" }
                    (table(&["finding", "runs", "share"], html! {
                        @for (name, count) in findings {
                            tr { td { (name) } td.number { (count) } td.number { (share(*count, bad)) } }
                        }
                    }))
                    p {
                        "The first of them: "
                        @for (at, (number, seed)) in totals.failed.iter().enumerate() {
                            @if at > 0 { ", " } "run " (number) " (seed " (seed) ")"
                        }
                        "."
                    }
                }
            }
        }
    }
}

/// The share of runs as expected at each point, and the frontier in words.
fn grid(frontier: &Frontier) -> Markup {
    let (sought, given) = (&frontier.sought, &frontier.given);
    html! {
        section {
            h2 { "Where it holds: " code { (sought.key) } " by " code { (given.key) } }
            p.quiet { "Share of runs as expected at each point." }
            div.wide {
                table.heat {
                    thead { tr { th scope="col" { (given.key) } @for value in &sought.values { th scope="col" { (value) } } } }
                    tbody {
                        @for (row, value) in given.values.iter().enumerate() {
                            tr {
                                th scope="row" { (value) }
                                @for column in 0..sought.values.len() { (point(frontier.at(column, row))) }
                            }
                        }
                    }
                }
            }
            (table(&[&given.key, &format!("{} at which every run was as expected", sought.key)], html! {
                @for (row, value) in given.values.iter().enumerate() {
                    tr { td { (value) } td.bad[frontier.holds(row) == Holds::Nowhere] { (holds(frontier, row)) } }
                }
            }))
        }
    }
}

fn point((runs, good): (u64, u64)) -> Markup {
    html! {
        @if runs == 0 { td.number { "-" } }
        @else {
            td.number.whole[good == runs] style={ "--share:" (100 * good / runs) "%" } title={ (good) " of " (runs) " runs" } {
                (share(good, runs))
            }
        }
    }
}

/// The sought values at which all runs were as expected, in words.
pub(crate) fn holds(frontier: &Frontier, given: usize) -> String {
    let values = &frontier.sought.values;
    match frontier.holds(given) {
        Holds::NotRun => "not run".to_owned(),
        Holds::Everywhere => "each".to_owned(),
        Holds::Nowhere => "none".to_owned(),
        Holds::From(place) => format!("{} and above", values[place]),
        Holds::UpTo(place) => format!("{} and below", values[place]),
        Holds::ExceptAt(places) => {
            let places: Vec<_> = places.into_iter().map(|place| values[place].as_str()).collect();
            format!("each but {}", places.join(", "))
        }
    }
}

/// Runs as expected next to the others.
fn histograms(measure: &Measure, (good, bad): &(Counts, Counts)) -> Markup {
    if good.count() + bad.count() == 0 {
        return html! {};
    }
    html! {
        h3 { (measure.title) }
        div.pair.even {
            (histogram(measure, good, "as expected"))
            (histogram(measure, bad, "not as expected"))
        }
    }
}

fn histogram(measure: &Measure, counts: &Counts, which: &str) -> Markup {
    let Some((least, most)) = counts.ends() else { return html! {} };
    let ns = |value: i64| value as f64 / measure.in_ns;
    let bins: Vec<_> = counts.bins().map(|(from, to, count)| (ns(from), ns(to), count)).collect();
    let title = format!("{}, runs {which}", measure.title);
    let picture = Histogram { title: &title, bins: &bins }.draw();
    let words =
        format!("{} runs {which}: {} to {}", counts.count(), time(ns(least)), time(ns(most)));
    figure(picture.as_ref(), &words)
}

/// A fraction in percent; 0 % and 100 % are shown only if exact.
fn share(part: u64, whole: u64) -> String {
    match part {
        0 => "0 %".to_owned(),
        part if part == whole => "100 %".to_owned(),
        part => format!("{:.2} %", (100.0 * part as f64 / whole.max(1) as f64).clamp(0.01, 99.99)),
    }
}
