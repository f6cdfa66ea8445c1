//! Common parts of the pages.

use isocat_descriptions::quantity::time;
use isocat_engine::report::settling::Settling;
use isocat_engine::report::{Counters, Finding, Note, Span, Spread};
use maud::{Markup, PreEscaped, html};

use crate::picture::Picture;

/// A drawing with its caption; the script adds its buttons.
pub fn figure(picture: Option<&Picture>, words: &str) -> Markup {
    let Some(picture) = picture else { return html! {} };
    html! {
        figure {
            div.wide { (PreEscaped(picture.svg())) }
            @if !words.is_empty() { figcaption { (words) } }
        }
    }
}

/// What colours of a drawing mean: a class of the drawing, and words. Strokes begin with `m`.
pub(crate) fn legend(signs: &[(&str, &str)]) -> Markup {
    html! {
        p.legend {
            @for (class, words) in signs {
                span {
                    svg.picture viewBox="0 0 18 14" aria-hidden="true" {
                        @if class.starts_with("m ") { line class=(class) x1="9" y1="0" x2="9" y2="14" {} }
                        @else { rect class=(class) x="1" y="3" width="16" height="9" {} }
                    }
                    (words)
                }
            }
        }
    }
}
/// A key figure of a page.
pub(crate) fn tile(what: &str, value: &str, from: &str) -> Markup {
    html! {
        div.tile { div.value { (value) } div.what { (what) " " (origin(from)) } }
    }
}

/// A key figure that may be marked as bad.
pub(crate) fn bad_tile(bad: bool, what: &str, value: &str, from: &str) -> Markup {
    html! {
        div.tile.bad[bad] { div.value { (value) } div.what { (what) " " (origin(from)) } }
    }
}

/// Source of a figure, as a letter with its explanation.
pub fn origin(from: &str) -> Markup {
    let words = match from {
        "t" => "measured in true time",
        "r" => "read from the device",
        "m" => "MainDevice's clock and counts",
        "p" => "plan",
        _ => return html! {},
    };
    html! { abbr title=(words) { "[" (from) "]" } }
}

/// Rows of a table of facts: what was left of the clocks' phase, by these means.
pub(crate) fn settling(settling: Option<&Settling>, what: &str, from: &str) -> Markup {
    html! {
        @for (name, figure) in settling.iter().flat_map(|settling| settling.lines(what)) {
            tr { th { (name) " " (origin(from)) } td { (figure) } }
        }
    }
}

/// The explanation of the letters.
pub fn origins() -> Markup {
    html! {
        p.quiet {
            "[t] measured in true time  [r] read from the device  [m] MainDevice's clock and counts  [p] plan"
        }
    }
}

/// Findings in a list; empty without findings.
pub fn findings(title: &str, findings: &[Finding]) -> Markup {
    html! {
        @if !findings.is_empty() {
            section {
                h2 { (title) }
                ul { @for finding in findings { li { (finding.sentence()) } } }
            }
        }
    }
}

/// Notes in a list.
pub fn notes(title: &str, notes: &[String]) -> Markup {
    html! {
        @if !notes.is_empty() {
            section {
                h2 { (title) }
                ul { @for note in notes { li { (note) } } }
            }
        }
    }
}

/// A note of a plan or a scan as a sentence.
pub fn note(note: &Note) -> String {
    match (&note.position, &note.device) {
        (Some(position), Some(device)) => format!("SubDevice {position} ({device}): {}", note.what),
        _ => note.what.clone(),
    }
}

/// A span as text: `mean 29.189 us, 28.739 us to 29.508 us`.
pub fn range(span: &Span) -> String {
    format!(
        "mean {}, {} to {}, deviation {}, {} values",
        time(span.mean_ns),
        time(span.min_ns),
        time(span.max_ns),
        time(span.standard_deviation_ns),
        span.count
    )
}

/// Mean, deviation and worst of an error, in three cells.
pub(crate) fn error_cells(spread: Option<&Spread>) -> Markup {
    html! {
        @match spread {
            Some(spread) => {
                td.number { (time(spread.mean_ns)) }
                td.number { (time(spread.standard_deviation_ns)) }
                td.number { (time(spread.worst_ns)) }
            }
            None => { td.number { "-" } td.number { "-" } td.number { "-" } }
        }
    }
}

/// The mean age of process data; it is highlighted if some were late.
pub(crate) fn age_cell(age: Option<Span>, late: u64) -> Markup {
    html! { td.number.bad[late > 0] { (age.map_or("-".into(), |age| time(age.mean_ns))) } }
}

/// 0B, 0C, 0D, 20 in four cells; counts above 0 are highlighted.
pub(crate) fn counter_cells(counters: &Counters) -> Markup {
    let all = [
        counters.sm_event_missed,
        counters.cycle_time_too_small,
        counters.shift_time_too_short,
        counters.sync_error,
    ];
    html! {
        @for counter in all {
            td.number.bad[counter.is_some_and(|count| count > 0)] {
                (counter.map_or("-".to_owned(), |count| count.to_string()))
            }
        }
    }
}

/// A table with its heads, in a box that scrolls if it is too wide.
pub fn table(heads: &[&str], rows: Markup) -> Markup {
    html! {
        div.wide {
            table {
                thead { tr { @for head in heads { th { (head) } } } }
                tbody { (rows) }
            }
        }
    }
}

/// A slack; a negative one is highlighted.
pub fn slack(ns: i64) -> Markup {
    html! { td.number.bad[ns < 0] { (time(ns as f64)) } }
}
