//! The results of the conformance suite, as a page.

use isocat_conform::report::{ConformanceReport, DeviceReport, RuleResult, Verdict};
use maud::{Markup, html};

use super::Page;
use super::parts::{table, tile};
use crate::json::compact;

/// The page of a suite.
pub fn page(report: &ConformanceReport, command: &str) -> Page {
    let sum = |pick: fn(&DeviceReport) -> usize| report.devices.iter().map(pick).sum::<usize>();
    let (passed, failed, open) = (sum(|d| d.passed), sum(|d| d.failed), sum(|d| d.not_judged));
    let verdict = match (failed, open) {
        (0, 0) => format!("Every rule that applies holds: {passed} of them."),
        (0, open) => format!("No rule fails, {passed} hold, {open} were not judged."),
        (1, _) => format!("1 rule does not hold; {passed} do."),
        (n, _) => format!("{n} rules do not hold; {passed} do."),
    };
    let body = html! {
        p.quiet { (report.source) }
        div.tiles {
            (tile("rules that hold", &passed.to_string(), ""))
            (tile("rules that do not", &failed.to_string(), ""))
            (tile("known deviations", &sum(|d| d.known_deviations).to_string(), ""))
            (tile("not judged", &open.to_string(), ""))
            (tile("not applicable", &sum(|d| d.not_applicable).to_string(), ""))
        }
        @for device in &report.devices { (one(device)) }
    };
    Page {
        title: format!("{} - isocat conform", report.source),
        kind: "Conformance of synchronization",
        good: report.passed,
        verdict,
        body,
        command: command.to_owned(),
        json: compact(report),
    }
}

fn one(device: &DeviceReport) -> Markup {
    let of = |verdict: Verdict| -> Vec<&RuleResult> {
        device.rules.iter().filter(|rule| rule.verdict == verdict).collect()
    };
    html! {
        section {
            h2 { (device.position) " " (device.name) }
            @if let Some(note) = device.examined.note() { p { (note) } }
            @if let Some(why) = &device.broken_off { p.bad { "Broken off: " (why) "." } }
            p {
                "Modes that it announces: "
                @for (at, mode) in device.modes.iter().enumerate() {
                    @if at > 0 { ", " }
                    (mode.name)
                    @if let Some(why) = mode.untried { " (not tried: " (why) ")" }
                }
            }
            (rules("Rules that do not hold", &of(Verdict::Fail), true))
            (rules("Not judged", &of(Verdict::NotJudged), true))
            (rules("Known deviations", &of(Verdict::KnownDeviation), true))
            (rules("Rules that hold", &of(Verdict::Pass), false))
            (rules("Not applicable", &of(Verdict::NotApplicable), false))
        }
    }
}

fn rules(title: &str, rules: &[&RuleResult], open: bool) -> Markup {
    if rules.is_empty() {
        return html! {};
    }
    html! {
        details open[open] {
            summary { (title) ": " (rules.len()) }
            (table(&["rule", "what it asks for", "source", "what was found"], html! {
                @for rule in rules {
                    tr {
                        td.bad[rule.verdict == Verdict::Fail] { (rule.id) } td { (rule.what) } td { (rule.source) }
                        td {
                            @for why in &rule.why { div { (why) } }
                            @for note in &rule.notes { div.quiet { (note) } }
                            @for seen in rule.evidence.iter().filter(|seen| !seen.right) {
                                div.bad { (seen.place) ": expected " (seen.expected) ", found " (seen.found) }
                            }
                            @if rule.evidence.iter().any(|seen| seen.right) {
                                details {
                                    summary { (rule.evidence.iter().filter(|seen| seen.right).count()) " right" }
                                    @for seen in rule.evidence.iter().filter(|seen| seen.right) {
                                        div.quiet { (seen.place) ": " (seen.found) }
                                    }
                                }
                            }
                        }
                    }
                }
            }))
        }
    }
}
