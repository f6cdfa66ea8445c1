//! The summary of a served segment, as a page.

use isocat_descriptions::quantity::time;
use isocat_serve::summary::{JudgedSummary, SessionSummary, Summary};
use isocat_wire::time::Nanos;
use maud::{Markup, html};

use super::Page;
use super::expected;
use super::parts::{error_cells, notes, origins, range, table};
use crate::json::compact;
use crate::picture::cycle::ns;

/// The page of a program in virtual time: the same, and the results of the program, line by line.
pub fn virtual_page(summary: &Summary, program: &[String]) -> Page {
    let page = page(summary);
    let body = html! { (notes("The program", program)) (page.body) };
    let title = format!("{} - isocat virtual", summary.segment_file);
    Page { title, kind: "A MainDevice in virtual time", body, ..page }
}

/// The page of a service that has ended.
pub fn page(summary: &Summary) -> Page {
    let judged = || summary.sessions.iter().filter_map(|session| session.judged.as_ref());
    let bad = judged().any(|judged| !judged.in_sync)
        || summary.sessions.iter().any(|s| !s.refused.is_empty());
    let met = summary.expected.iter().filter(|one| one.met == Some(true)).count();
    let expects = !summary.expected.is_empty();
    let verdict = match (judged().count(), bad) {
        _ if expects => format!("{met} of {} expectations came true.", summary.expected.len()),
        (_, true) => "Something speaks against a session: see below.".to_owned(),
        (0, false) => "No MainDevice brought a SubDevice to OP.".to_owned(),
        (1, false) => "In sync: nothing speaks against the session that came to OP.".to_owned(),
        (n, false) => format!("In sync: nothing speaks against the {n} sessions that came to OP."),
    };
    let faults: Vec<String> = summary
        .faults
        .iter()
        .map(|fault| format!("{}: {}", time(fault.at_ns as f64), fault.what))
        .collect();
    let rows: Vec<_> =
        summary.expected.iter().map(|one| (one.met, &*one.what, &*one.found)).collect();
    let body = html! {
        p.quiet {
            (summary.segment_file) " on " (summary.interface) ", served for " (Nanos(summary.served_ns)) ": " (summary.frames)
            " frames, " (summary.answered) " answered, " (summary.lost) " lost, " (summary.held) " held back"
        }
        (expected::table(&rows))
        (notes("Faults that were asked for", &faults))
        @for (at, session) in summary.sessions.iter().enumerate() { (one(at + 1, session)) }
        (origins())
    };
    Page {
        title: format!("{} - isocat serve", summary.segment_file),
        kind: "A served segment",
        good: if expects { met == summary.expected.len() } else { !bad && judged().count() > 0 },
        verdict,
        body,
        command: String::new(),
        json: compact(summary),
    }
}

fn one(number: usize, session: &SessionSummary) -> Markup {
    html! {
        section {
            h2 { "MainDevice " (number) }
            p {
                "From " (time(session.began_ns as f64)) " to " (time(session.ended_ns as f64)) ", " (session.frames) " frames from "
                (session.sources.join(", "))
                @if session.abrupt { ". " span.bad { "Its frames stopped while SubDevices were to be in SAFEOP or OP." } }
            }
            @if !session.refused.is_empty() {
                h3.bad { "SubDevices that refused or fell" }
                (table(&["after", "#", "device", "state", "AL status code"], html! {
                    @for refused in &session.refused {
                        tr {
                            td.number { (time(refused.after_ns as f64)) } td.number { (refused.position) } td { (refused.device) }
                            td { (refused.state) } td { (refused.meaning) }
                        }
                    }
                }))
            }
            (notes("What it left out or did badly", &session.remarks))
            @if let Some(judged) = &session.judged { (judges(judged)) }
            @if let Some(cycle) = &session.cycle {
                h3 { "Its cycle" }
                table.facts {
                    tr { th { "from one cycle to the next" } td { (range(&cycle.interval)) } }
                    @if let Some(phase) = &cycle.phase {
                        tr { th { "phase at the reference clock, from the first" } td { (range(phase)) } }
                    }
                    tr { th { "drift datagrams, longest time between two" }
                        td { (cycle.drift_datagrams) ", " (time(cycle.longest_drift_gap_ns as f64)) } }
                }
            }
            details {
                summary { "What it did, step by step" }
                (table(&["after", "what", "times"], html! {
                    @for step in &session.steps {
                        tr { td.number { (time(step.after_ns as f64)) } td { (step.what) } td.number { (step.count) } }
                    }
                }))
            }
        }
    }
}

fn judges(judged: &JudgedSummary) -> Markup {
    let heads = [
        "#",
        "device",
        "mode",
        "state",
        "SYNC0 error [t]: mean",
        "deviation",
        "worst",
        "least margin [t]",
        "SYNC0 in a frame",
        "0x1C32 [r]: 0B",
        "0C",
        "0D",
        "20",
        "what speaks against it",
    ];
    html! {
        h3 { "The judges" }
        p {
            "Judged for " (Nanos(judged.judged_ns)) " of true time with " (judged.in_op) " SubDevices in OP"
            @if !judged.earlier.is_empty() { ", after " (judged.earlier.len()) " earlier stretches" }
            "."
        }
        p {
            (judged.claims.checked) " claims about the segment were checked, " (judged.claims.not_checked.len()) " could not be."
        }
        (notes("About the segment", &judged.findings))
        @for (at, stretch) in judged.earlier.iter().enumerate() {
            (notes(&format!("Stretch {}, {}", at + 1, Nanos(stretch.judged_ns)), &stretch.findings))
        }
        (table(&heads, html! {
            @for device in &judged.devices {
                tr {
                    td.number { (device.position) } td { (device.name) } td.word { (device.mode) } td { (device.state) }
                    (error_cells(device.sync0_error.as_ref()))
                    td.number.bad[device.sync0_margin.is_some_and(|m| m.min_ns < 0.0)] {
                        (device.sync0_margin.map_or("-".into(), |margin| ns(margin.min_ns)))
                    }
                    td.number { (device.sync0_in_frame) }
                    @for count in [device.sm_event_missed, device.cycle_time_too_small, device.shift_time_too_short, device.sync_error] {
                        td.number.bad[count > 0] { (count) }
                    }
                    td { @for finding in &device.findings { div { (finding) } } }
                }
            }
        }))
    }
}
