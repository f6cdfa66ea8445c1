//! A run on a real interface as a page. True time is not known there: figures were measured by the
//! MainDevice, or read.

use isocat_descriptions::quantity::time;
use isocat_engine::report::interface::{InterfaceReport, Series, Unknown};
use isocat_maindevice::Segment;
use isocat_sync::budget::Check;
use isocat_wire::time::Nanos;
use maud::{Markup, html};

use super::Page;
use super::parts::{
    counter_cells, figure, findings, notes, origin, origins, range, slack, table, tile,
};
use crate::json::compact;
use crate::picture::bars::Histogram;
use crate::picture::cycle::Cycle;

/// The page of a run; `segment` is the one that the MainDevice found and planned.
pub fn page(report: &InterfaceReport, segment: &Segment, command: &str) -> Page {
    let body = html! {
        p.quiet {
            (report.segment_file.as_deref().unwrap_or("whatever is there")) " on " (report.interface) ": cycle "
            (Nanos(report.cycle_ns)) ", judged for " (Nanos(report.judged_ns)) " of host time, ended by " (report.ended_by)
        }
        div.tiles {
            @if let Some(late) = &report.punctuality.send_lateness {
                (tile("99 % of the frames no later than", &time(late.p99_ns as f64), "m"))
            }
            (tile("cycles later than planned with", &report.punctuality.beyond_jitter.to_string(), "m"))
            (tile("frames lost", &report.punctuality.frames_lost.to_string(), "m"))
            (tile("cycles skipped", &report.punctuality.cycles_skipped.to_string(), "m"))
        }
        (findings("What speaks against it", &report.findings))
        (notes("Not known", &unknown(report)))
        (notes("To know", &report.notes))
        (devices(report))
        (punctuality(report))
        (cycles(report, segment))
        (machine(report))
        @if let Some(quality) = &report.quality {
            section #quality {
                h2 { "Read in the background" }
                @if let Some(difference) = report.main_device.difference_at_lock {
                    p { "0x092C when clocks locked: " (difference.words()) " " (origin("r")) }
                }
                pre { (quality.plain()) }
            }
        }
        (origins())
    };
    Page {
        title: format!("{} - isocat run", report.interface),
        kind: "Run on a network interface",
        good: report.in_sync,
        verdict: report.verdict.clone(),
        body,
        command: command.to_owned(),
        json: compact(report),
    }
}

/// Facts that leave the answer open, and facts that no wire shows.
fn unknown(report: &InterfaceReport) -> Vec<String> {
    let line = |unknown: &Unknown| match unknown.decides {
        true => unknown.sentence(),
        false => format!("No wire shows: {}", unknown.sentence()),
    };
    report.unknown.iter().map(line).collect()
}

fn devices(report: &InterfaceReport) -> Markup {
    let heads = [
        "#",
        "device",
        "mode",
        "state [r]",
        "0x092C [r]",
        "delay [r]",
        "0x1C32 [r]: 0B",
        "0C",
        "0D",
        "20",
    ];
    html! {
        section #devices {
            h2 { "SubDevices" }
            p.quiet { "0x1C32: 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error, as they stood at the end." }
            (table(&heads, html! {
                @for device in &report.devices {
                    tr {
                        td.number { (device.position) }
                        td { a href={ "#device-" (device.position) } { (device.name) } }
                        td.word { (device.mode) }
                        td.bad[device.registers.al_status_code != 0] { (device.registers.al_status) }
                        td.number { (ns(device.registers.system_time_difference_ns)) }
                        td.number { (ns(device.registers.delay_ns)) }
                        (counter_cells(&device.registers.output_counters))
                    }
                }
            }))
        }
    }
}

fn punctuality(report: &InterfaceReport) -> Markup {
    let of = |title: &'static str, series: &Option<Series>| match series {
        None => html! {},
        Some(series) => html! {
            div {
                (figure(histogram(title, series).as_ref(), title))
                p.quiet { (range(&series.span)) }
            }
        },
    };
    html! {
        section #punctuality {
            h2 { "How punctual the machine was" }
            div.pair.even {
                (of("Lateness of the first frame of a cycle as it was handed to the kernel [m]", &report.punctuality.send_lateness))
                (of("Round trip of a frame [m]", &report.punctuality.round_trip))
            }
            p { "The plan keeps " (Nanos(report.punctuality.jitter_ns)) " of lateness free." }
        }
    }
}

/// Buckets of a series grow with the size: they are drawn with equal width, each labelled with its
/// limit.
fn histogram(title: &str, series: &Series) -> Option<crate::picture::Picture> {
    let mut begin = 0.0;
    let mut bins = Vec::new();
    for bucket in &series.buckets {
        let end = bucket.up_to_ns.map_or(series.span.max_ns.max(begin + 1.0), |ns| ns as f64);
        bins.push((begin, end, bucket.count));
        begin = end;
    }
    Histogram { title, bins: &bins }.draw()
}

fn cycles(report: &InterfaceReport, segment: &Segment) -> Markup {
    let Some(timing) = &segment.timing else { return html! {} };
    html! {
        section #cycles {
            h2 { "The cycle of each SubDevice, as planned" }
            p { "What happens inside a real device is not seen from here: dashed are the earliest and latest instants of the plan." }
            @for device in &report.devices {
                @let id = format!("cycle-{}", device.position);
                @let cycle = Cycle { id: &id, name: &device.name, timing, position: device.position, seen: None };
                article #{ "device-" (device.position) } {
                    h3 { (device.position) " " (device.name) " " span.quiet { (device.mode) } }
                    (figure(cycle.draw().as_ref(), ""))
                    (table(&["demand", "object", "needed [p]", "there is [p]", "slack [p]"], html! {
                        @for check in Check::OF_DEVICE {
                            @if let Some(demand) = timing.demand(device.position, check) {
                                @let line = demand.line();
                                tr {
                                    td { (check.words()) }
                                    td { (check.source().map_or(String::new(), |source| source.to_string())) }
                                    td.number { (time(line.needed.0 as f64)) }
                                    td.number { (time(line.available.0 as f64)) }
                                    (slack(line.slack().0))
                                }
                            }
                        }
                    }))
                }
            }
        }
    }
}

fn machine(report: &InterfaceReport) -> Markup {
    let machine = &report.machine;
    html! {
        section #machine {
            h2 { "The machine" }
            @if !machine.harms.is_empty() {
                (table(&["what harms punctuality", "seen in", "what to do"], html! {
                    @for harm in &machine.harms { tr { td { (harm.what) } td { (harm.source) } td { (harm.advice) } } }
                }))
            }
            ul {
                @for granted in &machine.granted { li { "granted: " (granted) } }
                @for refused in &machine.refused { li { "refused: " (refused) } }
            }
        }
    }
}

fn ns(value: Option<i64>) -> String {
    value.map_or("-".to_owned(), |ns| time(ns as f64))
}
