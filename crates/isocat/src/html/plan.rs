//! A plan as a page: whether it fits, the slacks, and the events in the cycle.

use isocat_descriptions::quantity::time;
use isocat_engine::plan::Plan;
use isocat_engine::plan::report::{Device, Line, PlanReport, Term};
use isocat_wire::time::Nanos;
use maud::{Markup, html};

use super::Page;
use super::parts::{figure, note, notes, origin, settling, slack, table, tile};
use crate::json::compact;
use crate::picture::cycle::Cycle;

/// The page of a plan.
pub fn page(plan: &Plan, report: &PlanReport, command: &str) -> Page {
    let segment = &report.segment;
    let proven = report.proof.as_ref().is_none_or(|proof| proof.holds);
    let warnings: Vec<String> = report.warnings.iter().map(note).collect();
    let body = html! {
        p.quiet {
            (report.segment_file) ": cycle " (Nanos(segment.cycle_ns)) ", frames up to " (Nanos(segment.send_jitter_ns))
            " late, clocks within " (Nanos(segment.clock_error_ns))
        }
        div.tiles {
            (tile("least slack of all lines", &time(segment.least_slack_ns as f64), "p"))
            @if let Some(phase) = segment.acting_phase_ns {
                (tile("phase of the acting pulse", &time(phase as f64), "p"))
            }
            @if let Some(earliest) = segment.output_reference_ns {
                (tile("not before: outputs of all are ready", &time(earliest as f64), "p"))
            }
            @if let Some(latest) = segment.input_reference_ns {
                (tile("not after: inputs of all are in time", &time(latest as f64), "p"))
            }
        }
        (notes("What the field falls into with such a segment", &warnings))
        (proof(report))
        (suggestion(report))
        (what_if(report))
        section #frames {
            h2 { "Frames of the fullest cycle" }
            (table(&["frame", "bytes", "from", "to", "datagrams"], html! {
                @for (at, frame) in report.frames.iter().enumerate() {
                    tr {
                        td.number { (at) } td.number { (frame.bytes) }
                        td.number { (time(frame.begin_ns as f64)) } td.number { (time(frame.end_ns as f64)) }
                        td {
                            @for datagram in &frame.datagrams {
                                div { (datagram.command) " " (datagram.address) " " (datagram.bytes) " bytes" }
                            }
                        }
                    }
                }
            }))
            (lines(std::slice::from_ref(&report.frames_line)))
        }
        section #cycles {
            h2 { "The cycle of each SubDevice" }
            p { "Times count from the begin of the bus cycle by the reference clock. Dashed: earliest and latest instants." }
            @for device in &report.devices { (one(plan, device)) }
        }
        (notes("What was assumed", &report.assumptions))
    };
    Page {
        title: format!("{} - isocat plan", report.segment_file),
        kind: "Plan of a segment",
        good: report.fits && proven,
        verdict: report.verdict.clone(),
        body,
        command: command.to_owned(),
        json: compact(report),
    }
}

fn one(plan: &Plan, device: &Device) -> Markup {
    let id = format!("cycle-{}", device.position);
    let cycle = Cycle {
        id: &id,
        name: &device.name,
        timing: plan.timing(),
        position: device.position,
        seen: None,
    };
    let short = device.lines.iter().any(|line| line.slack_ns < 0);
    html! {
        article #{ "device-" (device.position) } {
            h3.bad[short] { (device.position) " " (device.name) " " span.quiet { (device.mode) @if let Some(op_mode) = &device.op_mode { " by " (op_mode) } } }
            @if !device.mode_reason.is_empty() { p.quiet { (device.mode_reason) } }
            (figure(cycle.draw().as_ref(), ""))
            @if device.moments.iter().any(|moment| moment.measured.is_some()) {
                (table(&["event", "planned from", "to", "seen from [t]", "to", "times"], html! {
                    @for moment in &device.moments {
                        tr {
                            td { (moment.event) }
                            td.number { (time(moment.earliest_ns as f64)) }
                            td.number { (time(moment.latest_ns as f64)) }
                            @match moment.measured {
                                Some(seen) => {
                                    td.number { (time(seen.earliest_ns)) } td.number { (time(seen.latest_ns)) }
                                    td.number { (seen.count) }
                                }
                                None => { td {} td {} td {} }
                            }
                        }
                    }
                }))
            }
            (lines(&device.lines))
        }
    }
}

/// Lines of the budget; their figures open below each line.
fn lines(lines: &[Line]) -> Markup {
    let proven = lines.iter().any(|line| line.measured.is_some());
    let mut heads = vec!["demand", "object", "needed", "there is", "slack"];
    if proven {
        heads.push("slack seen [t]");
    }
    heads.push("what shows if it does not fit");
    table(
        &heads,
        html! {
            @for line in lines {
                tr {
                    td {
                        details { summary { (line.demand) }
                            (sum("needed", &line.needed)) (sum("there is", &line.available)) }
                    }
                    td { (line.object.as_deref().unwrap_or("")) }
                    td.number { (time(line.needed_ns as f64)) }
                    td.number { (time(line.available_ns as f64)) }
                    (slack(line.slack_ns))
                    @if proven {
                        td.number { (line.measured.map_or("-".into(), |seen| time(seen.slack_ns))) }
                    }
                    td { (line.sign) }
                }
            }
        },
    )
}

fn sum(what: &str, terms: &[Term]) -> Markup {
    html! {
        p.quiet {
            (what) ": "
            @for (at, term) in terms.iter().enumerate() {
                @if at > 0 { " + " }
                (term.what) " " (time(term.value_ns as f64)) " [" (term.origin) "]"
            }
        }
    }
}

fn proof(report: &PlanReport) -> Markup {
    let Some(proof) = &report.proof else { return html! {} };
    html! {
        section #proof {
            h2 { "The proof" }
            p.good[proof.holds].bad[!proof.holds] {
                @if proof.holds { "It holds: " } @else { "It does not hold: " }
                "run for " (Nanos(proof.judged_ns)) " of virtual time, seed " (proof.seed)
                ", with a host that is either in time or as late as it may be; " (proof.loose)
                " lines are not tight within a factor of " (proof.factor) "."
            }
            table.facts { (settling(proof.settling.as_ref(), "edges", "t")) }
            ul { @for finding in &proof.findings { li { (finding) } } }
        }
    }
}

/// The cases, with one row for SubDevices with the same outcome.
fn what_if(report: &PlanReport) -> Markup {
    let Some(found) = &report.what_if else { return html! {} };
    html! {
        section #what-if {
            h2 { "What if a cable or a SubDevice goes" }
            p { "Each is " (found.head()) " " (origin("t")) "." }
            @if let Some(failure) = &found.failure { p.bad { (failure) } }
            (table(&["goes", "SubDevices", "what becomes of them", "in sync again"], html! {
                @for case in &found.cases {
                    @let rows = found.rows(case);
                    @for (at, row) in rows.iter().enumerate() {
                        tr {
                            @if at == 0 {
                                td rowspan=(rows.len()) {
                                    (found.goes(case))
                                    @if let Some(clocks) = found.clocks(case) { div.quiet { (clocks) } }
                                }
                            }
                            td { (row.devices) } td { (row.what) } td.bad[row.stay_out] { (row.again) }
                        }
                    }
                }
            }))
            ul { @for note in found.notes() { li { (note) } } }
        }
    }
}

fn suggestion(report: &PlanReport) -> Markup {
    let Some(better) = &report.suggestion else { return html! {} };
    let ns = |time: Option<i64>| time.map_or("-".to_owned(), |ns| Nanos(ns).to_string());
    html! {
        section #suggestion {
            h2 { "What would fit better" }
            @if better.no_shift_helps { p.bad { "A line fails at any phase: it is not the phase's fault." } }
            table.facts {
                tr { th { "phase with the most even slack" } td { (ns(better.shift_ns)) ", slack " (ns(better.slack_ns)) } }
                tr { th { "the same as the phase of the frame" } td { (ns(better.send_phase_ns)) } }
                tr { th { "smallest cycle that fits" } td { (better.smallest_cycle()) } }
            }
        }
    }
}
