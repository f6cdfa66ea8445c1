//! The diagnosis of a capture, as a page: first the verdict, then the events around the first
//! fault, then all other facts.

use isocat_descriptions::quantity::time;
use isocat_diagnose::DiagnoseReport;
use isocat_diagnose::report::{
    DeviceReport, FindingReport, FrameRef, MomentReport, RhythmReport, VerdictKind, WeightKind,
};
use isocat_engine::recording::series::Series;
use maud::{Markup, html};

use super::Page;
use super::parts::{bad_tile, figure, notes, table, tile};
use crate::json::compact;
use crate::picture::series::Chart;
use crate::picture::states::{self, Lane, State};

pub mod figures;

use figures::Figures;

/// A diagnosis, and the data of its drawings.
#[derive(Clone, Copy, Debug)]
pub struct Diagnosed<'a> {
    /// The report.
    pub report: &'a DiagnoseReport,
    /// Data that were kept while the captures were read.
    pub figures: &'a Figures,
    /// The command that repeats it.
    pub command: &'a str,
}

impl Diagnosed<'_> {
    /// The page.
    pub fn page(&self) -> Page {
        let Self { report, .. } = self;
        let names: Vec<&str> = report.captures.iter().map(|one| one.name.as_str()).collect();
        let names = match names[..] {
            [one] => one.to_owned(),
            _ => format!("{} captures", names.len()),
        };
        let body = html! {
            (self.first())
            (self.tiles())
            (self.around())
            (self.states())
            (self.more())
            (self.distances())
            (self.intervals())
            (self.devices())
            (self.transmissions())
            (notes("What the capture does not show", &report.unknown))
            (self.captures())
        };
        Page {
            title: format!("{names} - isocat diagnose"),
            kind: "Diagnosis of a capture",
            good: matches!(report.verdict.kind, VerdictKind::InSync | VerdictKind::InOperation),
            verdict: self.verdict(),
            body,
            command: self.command.to_owned(),
            json: compact(report),
        }
    }

    fn faults(&self) -> impl Iterator<Item = &FindingReport> {
        self.report.findings.iter().filter(|one| one.weight == WeightKind::Fault)
    }

    /// The verdict of the page.
    fn verdict(&self) -> String {
        match self.faults().next() {
            Some(first) => capital(&format!("{}.", first.what)),
            None => self.report.verdict.sentence.clone(),
        }
    }

    /// The first fault: place, cause, remedies, and the frames that show it.
    fn first(&self) -> Markup {
        let Some(first) = self.faults().next() else { return html! {} };
        let device = first.device.and_then(|place| self.report.devices.get(place));
        let more = self.faults().count() - 1;
        html! {
            section.why {
                h2 { "What went wrong first" }
                table.facts {
                    tr { th { "where" } td { @match device {
                        Some(device) => { a href={ "#device-" (first.device.unwrap_or(0)) } { (device.title()) } }
                        None => { "the segment as a whole, or the MainDevice" }
                    } } }
                    tr { th { "what" } td { code { (first.kind) } @if first.sure == isocat_diagnose::report::SureKind::Likely {
                        " likely: something else would show the same" } } }
                    tr { th { "when" } td {
                        (self.frame(first.frame))
                        @if let Some(at) = first.at_ns { ", " (seconds(at)) " from the first frame of EtherCAT" }
                    } }
                    @if !first.evidence.is_empty() {
                        tr { th { "see also" } td { (self.frames(&first.evidence)) } }
                    }
                }
                h3 { "What to do, likeliest first" }
                ol { @for remedy in &first.remedies { li { (remedy) } } }
                @if more > 0 {
                    p.quiet { "What followed, or was found beside it: " a href="#findings" { (more) @if more == 1 { " more fault" } @else { " more faults" } } "." }
                }
            }
        }
    }

    fn tiles(&self) -> Markup {
        let report = self.report;
        let frames = &report.frames;
        let cycle = report.cycle.as_ref();
        let rhythm = cycle.and_then(|cycle| cycle.by_clock.as_ref().or(cycle.by_stamps.as_ref()));
        let lost: u64 =
            cycle.map_or(0, |cycle| cycle.transmissions.iter().map(|one| one.lost).sum());
        let low: u64 = cycle.map_or(0, |cycle| cycle.transmissions.iter().map(|one| one.low).sum());
        let least = report.devices.iter().filter_map(|one| one.distance.as_ref());
        let least = least.map(|distance| distance.shortest_ns.value).min();
        html! {
            div.tiles {
                (tile("SubDevices", &report.devices.len().to_string(), ""))
                (tile("captured", &seconds(frames.span_ns), ""))
                @if let Some(rhythm) = rhythm { (tile("cycle, half of them are not longer", &time(rhythm.median_ns as f64), "")) }
                @if let Some(least) = least {
                    (bad_tile(least < 0, "least time from a frame to SYNC0", &time(least as f64), ""))
                }
                @if cycle.is_some() {
                    (bad_tile(low > 0, "cyclic datagrams with a low working counter", &low.to_string(), ""))
                    (bad_tile(lost > 0, "cyclic datagrams without an answer", &lost.to_string(), ""))
                }
            }
        }
    }

    fn around(&self) -> Markup {
        let Some(around) = &self.report.around else { return html! {} };
        html! {
            section #around {
                h2 { "The frames around it" }
                p.quiet {
                    "Time in ms by the stamps, from the frame that shows the fault. Frames that say the same one after the other are one line. "
                    "Numbers are those that Wireshark shows."
                }
                (table(&["frames", "ms", "times", "what", "finding"], html! {
                    @for moment in &around.moments { (self.moment(moment)) }
                }))
            }
        }
    }

    fn moment(&self, moment: &MomentReport) -> Markup {
        let first = moment.request.or(moment.answer).unwrap_or(moment.last);
        // The last correct state is evidence, too, but not what went wrong.
        let bad = self.faults().any(|fault| {
            let at = fault.frame;
            at.capture == first.capture && (first.frame..=moment.last.frame).contains(&at.frame)
        });
        html! {
            tr {
                td.number { (first.frame) @if first != moment.last { "\u{2013}" (moment.last.frame) } }
                td.number { (format!("{:.3}", moment.at_ns as f64 / 1e6)) }
                td.number { (moment.times) }
                td.bad[bad] { (moment.what) }
                td.word { @for kind in &moment.findings { div.bad[bad] { (kind) } } }
            }
        }
    }

    /// The states of the devices over time, with marks for the faults.
    fn states(&self) -> Markup {
        let report = self.report;
        let lanes: Vec<Lane> =
            report.devices.iter().filter(|one| !one.states.is_empty()).map(lane).collect();
        let left_out = lanes.len().saturating_sub(MOST_LANES);
        let marks = self.marks();
        let to = (report.frames.span_ns as f64).max(1.0);
        let shown = &lanes[..lanes.len().min(MOST_LANES)];
        let picture = states::draw("states", "States of the devices", (0.0, to), shown, &marks);
        if picture.is_none() {
            return html! {};
        }
        html! {
            section #states {
                h2 { "States of the devices" }
                (figure(picture.as_ref(), "As they were read; a state lasts from the frame that first shows it to the next one that was read, or until the device does not answer. Red marks: faults."))
                @if left_out > 0 { p.quiet { (left_out) " more devices are in the report for programs." } }
            }
        }
    }

    /// Instants of faults, ns, with their description.
    fn marks(&self) -> Vec<(f64, String)> {
        let at = |one: &FindingReport| {
            Some((one.at_ns? as f64, format!("{}: {}", self.frame(one.frame), one.what)))
        };
        self.faults().filter_map(at).collect()
    }

    /// All findings but the first fault.
    fn more(&self) -> Markup {
        let first = self.faults().next();
        let rest: Vec<&FindingReport> =
            self.report.findings.iter().filter(|one| first != Some(*one)).collect();
        if rest.is_empty() {
            return html! {};
        }
        html! {
            section #findings {
                h2 { @if first.is_some() { "What else was found" } @else { "What was found" } }
                (table(&["", "kind", "frame", "what, and what to do"], html! {
                    @for one in rest {
                        @let fault = one.weight == WeightKind::Fault;
                        tr {
                            td.word.bad[fault] { (weight(one.weight)) }
                            td.word { (one.kind) }
                            td { (self.frame(one.frame)) }
                            td {
                                (one.what)
                                @if !one.evidence.is_empty() { div.quiet { "see also " (self.frames(&one.evidence)) } }
                                @for remedy in one.remedies.iter().take(2) { div { "\u{2192} " (remedy) } }
                            }
                        }
                    }
                }))
            }
        }
    }

    fn distances(&self) -> Markup {
        let measured: Vec<(usize, &DeviceReport)> = self
            .report
            .devices
            .iter()
            .enumerate()
            .filter(|(_, one)| one.distance.is_some())
            .collect();
        if measured.is_empty() {
            return html! {};
        }
        html! {
            section #distances {
                h2 { "From cyclic frames to SYNC0" }
                p {
                    "From the last bit of each cyclic frame at the device to its next SYNC0, by the reference's clock; 0 is SYNC0, and below it a "
                    "frame came behind the SYNC0 that it belongs to. The line is the mean, pale from the least to the largest of each span of time. "
                    span.script { "Draw a part to zoom into it; point at something for its figures." }
                }
                @for (place, device) in measured.iter().take(MOST_CHARTS) { (self.distance(*place, device)) }
                @if measured.len() > MOST_CHARTS {
                    p.quiet { (measured.len() - MOST_CHARTS) " more devices are in the report for programs." }
                }
            }
        }
    }

    fn distance(&self, place: usize, device: &DeviceReport) -> Markup {
        let Some(distance) = &device.distance else { return html! {} };
        let series = self.figures.distance(distance);
        let title = format!("From cyclic frames to SYNC0 of {}", device.title());
        let id = format!("distance-{place}");
        let marks = self.marks();
        let picture = series.as_ref().and_then(|series| {
            let span = self.span(series);
            Chart { id: &id, title: &title, series, limit: None, marks: &marks, span }.draw()
        });
        html! {
            article {
                h3.bad[distance.shortest_ns.value < 0] { (device.title()) }
                p.quiet {
                    (distance.frames) " frames: " (time(distance.shortest_ns.value as f64)) " (" (self.frame(distance.shortest_ns.frame)) ") to "
                    (time(distance.longest_ns.value as f64)) " (" (self.frame(distance.longest_ns.frame)) "), mean " (time(distance.mean_ns as f64))
                    ", SYNC0 each " (time(distance.cycle_ns as f64))
                    @if distance.slides { "; frames slide through the cycle" }
                }
                (figure(picture.as_ref(), ""))
            }
        }
    }

    /// Time span from the first value to the end of the capture, ns: the way up has no values and
    /// may be long.
    fn span(&self, series: &Series) -> (f64, f64) {
        let begin = series.spans().first().map_or(0.0, |span| span.begin.0 as f64 / 1e3);
        (begin, self.figures.length_ns as f64)
    }

    fn intervals(&self) -> Markup {
        let Some(cycle) = &self.report.cycle else { return html! {} };
        let both = [(true, cycle.by_clock.as_ref()), (false, cycle.by_stamps.as_ref())];
        if both.iter().all(|(_, rhythm)| rhythm.is_none()) {
            return html! {};
        }
        html! {
            section #intervals {
                h2 { "From one cycle to the next" }
                @for (by_clock, rhythm) in both {
                    @if let Some(rhythm) = rhythm { (self.rhythm(by_clock, rhythm)) }
                }
            }
        }
    }

    fn rhythm(&self, by_clock: bool, rhythm: &RhythmReport) -> Markup {
        let title = match by_clock {
            true => "By the reference's clock",
            false => "By the stamps of the capture",
        };
        let series = self.figures.intervals(by_clock, rhythm.median_ns);
        let id = if by_clock { "by-clock" } else { "by-stamps" };
        let marks = self.marks();
        let picture = series.as_ref().and_then(|series| {
            let span = self.span(series);
            Chart { id, title, series, limit: None, marks: &marks, span }.draw()
        });
        html! {
            article {
                h3 { (title) }
                p.quiet {
                    (rhythm.count) " intervals: " (time(rhythm.shortest_ns.value as f64)) " (" (self.frame(rhythm.shortest_ns.frame)) ") to "
                    (time(rhythm.longest_ns.value as f64)) " (" (self.frame(rhythm.longest_ns.frame)) "), 99 % not above "
                    (time(rhythm.most_99_ns as f64)) ". Drawn less their median of " (time(rhythm.median_ns as f64)) "."
                }
                (figure(picture.as_ref(), ""))
            }
        }
    }

    fn devices(&self) -> Markup {
        let heads = [
            "#",
            "station",
            "name",
            "product",
            "ESC",
            "state",
            "SYNC",
            "delay",
            "0x092C, worst in OP",
            "SDO aborts",
            "error counters",
        ];
        html! {
            section #devices {
                h2 { "SubDevices" }
                @if self.report.devices.is_empty() { p { "No SubDevice answered." } }
                @else { (table(&heads, html! { @for (place, device) in self.report.devices.iter().enumerate() { (row(place, device)) } })) }
            }
        }
    }

    fn transmissions(&self) -> Markup {
        let Some(cycle) = &self.report.cycle else { return html! {} };
        let count = |count: Option<u16>| count.map_or("?".to_owned(), |count| count.to_string());
        html! {
            section #cycle {
                h2 { "Process data" }
                (table(&["command", "address", "bytes", "frames", "first", "working counter", "by FMMUs", "lower", "no answer"], html! {
                    @for one in cycle.transmissions.iter().take(MOST_ROWS) {
                        tr {
                            td.word { (one.command) } td.number { (format!("{:#010x}", one.address)) } td.number { (one.bytes) }
                            td.number { (one.frames) } td { (self.frame(one.first)) }
                            td.number { (count(one.usual_working_counter)) } td.number { (count(one.computed_working_counter)) }
                            td.number.bad[one.low > 0] { (one.low) } td.number.bad[one.lost > 0] { (one.lost) }
                        }
                    }
                }))
            }
        }
    }

    fn captures(&self) -> Markup {
        html! {
            section #captures {
                h2 { "What was read" }
                (table(&["capture", "packets", "cut off or other links", "read to"], html! {
                    @for one in &self.report.captures {
                        tr {
                            td { (one.name) } td.number { (one.packets) } td.number { (one.cut + one.other_links) }
                            td.bad[one.ended.is_some()] { (one.ended.as_deref().unwrap_or("its end")) }
                        }
                    }
                }))
            }
        }
    }

    /// A frame as text: `frame 17`; with several captures `frame 17 of b.pcapng`.
    fn frame(&self, at: FrameRef) -> String {
        self.report.frame(at)
    }

    fn frames(&self, all: &[FrameRef]) -> String {
        all.iter().map(|at| self.frame(*at)).collect::<Vec<_>>().join(", ")
    }
}

fn row(place: usize, device: &DeviceReport) -> Markup {
    let unknown = || "?".to_owned();
    let product = device.identity.product.as_ref();
    let aborts: usize =
        device.mailbox.iter().flat_map(|one| &one.aborts).map(|one| one.count).sum();
    let sync = device.sync.last();
    let cycle = sync.and_then(|sync| sync.sync0_cycle_ns.as_ref());
    let error = device.states.last().is_some_and(|state| state.error);
    html! {
        tr #{ "device-" (place) } {
            td.number { (device.position.map_or_else(unknown, |at| at.to_string())) }
            td.number { (device.station.as_ref().map_or_else(unknown, |at| format!("{:#06x}", at.value))) }
            td { (device.name.as_deref().unwrap_or("?")) }
            td.number { (product.map_or_else(unknown, |product| format!("{:#010x}", product.value))) }
            td.word { (device.esc.name.unwrap_or("?")) }
            td.word.bad[error] { (device.state.as_deref().unwrap_or("?")) }
            td.word {
                (sync.map_or_else(unknown, |sync| format!("{:#06x}", sync.assign_activate)))
                @if let Some(cycle) = cycle { ", " (time(f64::from(cycle.value))) }
            }
            td.number { (device.delay_ns.as_ref().map_or_else(unknown, |delay| time(f64::from(delay.value)))) }
            td.number { (device.worst_difference_ns.as_ref().map_or_else(unknown, |worst| time(f64::from(worst.value)))) }
            td.number { (aborts) }
            td { @for error in &device.errors { div { (error.name.unwrap_or("?")) @if let Some(port) = error.port { ", port " (port) } ": " (error.value) } } }
        }
    }
}

/// The states of a device in sequence, with the times in which it did not answer.
fn lane(device: &DeviceReport) -> Lane {
    let read = device.states.iter().map(|state| {
        let code = state.code.filter(|code| *code != 0);
        let code = code.map_or(String::new(), |code| format!(", AL status code {code:#06x}"));
        State {
            at: state.at_ns as f64,
            name: state.status.clone(),
            error: state.error,
            tip: format!(
                "{}{code}\nframe {}, {}",
                state.status,
                state.frame.frame,
                seconds(state.at_ns)
            ),
        }
    });
    let mut states: Vec<State> = read.collect();
    for silence in &device.silences {
        let (begin, end) = (silence.at_ns as f64, silence.until_ns.map(|until| until as f64));
        let within = |at: f64| at >= begin && end.is_none_or(|end| at < end);
        states.retain(|state| !within(state.at));
        let place = states.partition_point(|state| state.at < begin);
        // Its first answer may be the state that it had before.
        let before = place.checked_sub(1).map(|before| states[before].clone());
        let again = end.filter(|end| states.get(place).is_none_or(|next| next.at > *end));
        let again = again.zip(before).map(|(at, before)| State { at, ..before });
        let silent = State {
            at: begin,
            name: "no answer".to_owned(),
            error: true,
            tip: format!("no answer\nframe {}, {}", silence.frame.frame, seconds(silence.at_ns)),
        };
        states.splice(place..place, std::iter::once(silent).chain(again));
    }
    Lane { name: device.title(), states }
}

fn weight(weight: WeightKind) -> &'static str {
    match weight {
        WeightKind::Fault => "fault",
        WeightKind::Warning => "warning",
        WeightKind::Note => "note",
    }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

fn seconds(ns: u64) -> String {
    format!("{:.6} s", ns as f64 / 1e9)
}

/// Largest number of devices with a lane.
const MOST_LANES: usize = 40;
/// Largest number of devices with a chart, so that a page stays below 2 MB.
const MOST_CHARTS: usize = 24;
/// Largest number of logical datagrams in the table.
const MOST_ROWS: usize = 64;
