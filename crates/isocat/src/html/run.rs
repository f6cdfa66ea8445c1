//! A run of the simulation as a page.

use isocat_descriptions::quantity::time;
use isocat_engine::Report;
use isocat_engine::diagnosis::{Diagnosis, diagnose};
use isocat_engine::fold::{fold, range};
use isocat_engine::recording::cycle::CycleSeen;
pub use isocat_engine::recording::spans;
use isocat_engine::recording::{Recorded, RecordedDevice};
use isocat_engine::report::alike::{widest_span, worst_spread};
use isocat_engine::report::{Device, Span};
use isocat_maindevice::Segment;
use isocat_maindevice::segment::Timing;
use isocat_sync::SyncMode;
use isocat_sync::budget::Check;
use isocat_sync::phase;
use isocat_wire::time::Nanos;
use maud::{Markup, html};

use super::Page;
use super::expected;
use super::parts::{
    age_cell, bad_tile, counter_cells, error_cells, figure, findings, legend, notes, origin,
    origins, range as range_of, settling, slack, table, tile,
};
use super::plant;
use crate::json::compact;
use crate::picture::Picture;
use crate::picture::bars::Histogram;
use crate::picture::cycle::{Cycle, events, ns};
use crate::picture::margin;
use crate::picture::segment::{Devices, Row, tightest};
use crate::picture::series::Chart;
use crate::picture::topology::{self, Node};

/// A run, and data besides its report.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// The report.
    pub report: &'a Report,
    /// The recording of the run.
    pub recorded: &'a Recorded,
    /// The segment as the MainDevice found and planned it.
    pub segment: &'a Segment,
    /// The largest SYNC0 error that counts as synchronized.
    pub limit: Nanos,
    /// The command that repeats it.
    pub command: &'a str,
}

/// What the page says first.
fn verdict(report: &Report) -> String {
    let met = report.expected.iter().filter(|one| one.met).count();
    match report.expected.len() {
        0 => report.verdict.clone(),
        all => format!("Expected: {met} of {all} came so. {}", report.verdict),
    }
}

impl Run<'_> {
    /// The page.
    pub fn page(&self) -> Page {
        let Self { report, recorded, .. } = self;
        let diagnoses = diagnose(report, recorded, self.segment, self.limit);
        let body = html! {
            p.quiet {
                (report.segment_file) ": cycle " (Nanos(report.cycle_ns)) ", judged for " (Nanos(report.judged_ns))
                " of virtual time, seed " (report.seed) ". Times count from "
                @if self.recorded.operating { "the instant at which all SubDevices were in operation." }
                @else { "the first cycle on the way up." }
            }
            (why(&diagnoses))
            (self.tiles())
            (self.all_devices(&diagnoses))
            @if diagnoses.is_empty() { (findings("What speaks against it", &report.findings)) }
            (expected::sections(report))
            (plant::section(report.plants.as_ref()))
            (findings("SubDevices that came and went", &report.visits))
            (self.incidents())
            (self.topology(&diagnoses))
            (self.devices())
            (self.cycles(&diagnoses))
            (self.errors())
            (self.host())
            (self.budget())
            (self.quality())
            (notes("Clocks that the segment file does not give", &report.drawn_clocks()))
            (self.assumed())
            (origins())
        };
        Page {
            title: format!("{} - isocat run", report.segment_file),
            kind: "Run of a virtual segment",
            good: report.as_expected(),
            verdict: verdict(report),
            body,
            command: self.command.to_owned(),
            json: compact(report),
        }
    }

    fn tiles(&self) -> Markup {
        let report = self.report;
        let worst = |pick: fn(&Device) -> Option<f64>, worse: fn(f64, f64) -> bool| {
            let all = report.devices.iter().filter_map(|d| Some((pick(d)?, d)));
            all.reduce(|a, b| if worse(b.0, a.0) { b } else { a })
        };
        let error = worst(|d| Some(d.true_time.sync0_error?.worst_ns), |a, b| a > b);
        let margin = worst(|d| Some(d.true_time.sync0_margin?.min_ns), |a, b| a < b);
        let seen = &report.segment.true_time;
        let counted = &report.segment.main_device;
        html! {
            div.tiles {
                @if let Some((error, device)) = error {
                    (tile(&format!("largest SYNC0 error: SubDevice {}", device.position), &time(error), "t"))
                }
                @if let Some((margin, device)) = margin {
                    (bad_tile(margin < 0.0, &format!("least margin of outputs: SubDevice {}", device.position), &ns(margin), "t"))
                }
                @if let Some(spread) = seen.outputs_valid_spread {
                    (tile("outputs valid, first to last SubDevice", &time(spread.max_ns), "t"))
                }
                @if let Some(taken) = seen.time_to_synchronization_ns {
                    (tile("from power-on to synchronization", &format!("{:.1} ms", taken as f64 / 1e6), "t"))
                }
                (bad_tile(counted.frames_lost > 0, "frames lost", &format!("{} of {}", counted.frames_lost, counted.frames_sent), "m"))
            }
        }
    }

    fn topology(&self, diagnoses: &[Diagnosis]) -> Markup {
        let found = &self.segment.devices;
        if found.is_empty() {
            return html! {};
        }
        let node = |device: &Device| {
            let registers = &device.registers;
            let there = found.get(device.position);
            let parent = there.and_then(|found| found.parent);
            Node {
                name: device.name.clone(),
                parent: parent.map(|(parent, _)| parent),
                port: parent.map(|(_, port)| port as u8),
                leads: self.segment.reference == Some(device.position),
                bad: diagnoses.iter().any(|d| d.position == Some(device.position)),
                delay: registers.delay_ns.map(|ns| ns as f64),
                delay_error: registers.delay_error_ns.map(|ns| ns as f64),
                tip: format!(
                    "SubDevice {}: {} ({}), {}, {}{}",
                    device.position,
                    device.name,
                    device.profile,
                    device.mode,
                    registers.al_status,
                    registers
                        .delay_unknown
                        .as_ref()
                        .map_or(String::new(), |why| format!("\nits delay can't be known: {why}"))
                ),
            }
        };
        let nodes: Vec<Node> = self.report.devices.iter().map(node).collect();
        let picture = topology::draw("The tree of the segment", &nodes);
        let many = nodes.len() > 16;
        html! {
            section #topology {
                h2 { "The segment" }
                details open[!many] {
                    summary { (nodes.len()) " SubDevices, with their propagation delays " (origin("r")) }
                    (figure(Some(&picture), ""))
                }
            }
        }
    }

    /// The samples of devices that oversample; nothing without.
    fn samples(&self) -> Markup {
        let devices = self.report.devices.iter();
        let all: Vec<_> = devices
            .flat_map(|device| {
                let seen = &device.true_time;
                let both = [("inputs", seen.input_samples), ("outputs", seen.output_samples)];
                both.into_iter().filter_map(move |(of, samples)| Some((device, of, samples?)))
            })
            .collect();
        let figures: [fn(&Span) -> f64; 3] =
            [|all| all.min_ns, |all| all.mean_ns, |all| all.max_ns];
        let heads = [
            "#",
            "samples of",
            "",
            "in set",
            "sets",
            "not whole",
            "sample to sample [t]: least",
            "mean",
            "largest",
        ];
        let rows = html! {
            @for (device, of, samples) in &all {
                tr {
                    td.number { (device.position) }
                    td { (device.name) }
                    td.word { (of) }
                    td.number { (samples.in_set) }
                    td.number { (samples.sets) }
                    td.number.bad[samples.incomplete > 0] { (samples.incomplete) }
                    @for figure in figures {
                        td.number { (samples.distance.as_ref().map_or("-".into(), |all| ns(figure(all)))) }
                    }
                }
            }
        };
        html! {
            @if !all.is_empty() {
                (table(&heads, rows))
            }
        }
    }

    fn devices(&self) -> Markup {
        let heads = [
            "show",
            "#",
            "device",
            "mode",
            "cycle",
            "state [r]",
            "SYNC0 error [t]: mean",
            "deviation",
            "worst",
            "least margin [t]",
            "age of outputs [t]",
            "of inputs",
            "0x092C [r]",
            "0x1C32 [r]: 0B",
            "0C",
            "0D",
            "20",
            "missed [t]",
        ];
        let rows = html! {
            @for row in self.report.alike() {
                @let device = &row[0];
                @let seen = |pick: fn(&Device) -> Option<f64>, worse: fn(f64, f64) -> f64| row.iter().filter_map(pick).reduce(worse);
                @let margin = seen(|d| Some(d.true_time.sync0_margin?.min_ns), f64::min);
                @let difference = seen(|d| Some(d.registers.system_time_difference_ns? as f64), |a, b| if b.abs() > a.abs() { b } else { a });
                tr data-device=(device.position) {
                    td { input type="checkbox" checked aria-label={ "show SubDevice " (device.position) } data-hides=(device.position); }
                    td.number { (range(device.position, row[row.len() - 1].position)) }
                    td { a href={ "#device-" (device.position) } { (names(row)) } }
                    td.word { (device.mode) }
                    td.number { (device.cycle_ns.map_or("-".into(), |ns| Nanos(ns).to_string())) }
                    td.bad[device.registers.al_status.is_error()] { (device.registers.al_status) }
                    (error_cells(worst_spread(row.iter().map(|d| d.true_time.sync0_error)).as_ref()))
                    td.number.bad[margin.is_some_and(|margin| margin < 0.0)] { (margin.map_or("-".into(), ns)) }
                    (age_cell(widest_span(row.iter().map(|d| d.true_time.outputs_age)), device.true_time.outputs_late))
                    (age_cell(widest_span(row.iter().map(|d| d.true_time.inputs_age)), device.true_time.inputs_late))
                    td.number { (difference.map_or("-".into(), time)) }
                    (counter_cells(&device.registers.output_counters))
                    td.number.bad[device.true_time.missed_events > 0] { (device.true_time.missed_events) }
                }
            }
        };
        html! {
            section #devices {
                h2 { "SubDevices" }
                p.quiet {
                    "0x1C32: 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error. "
                    "0x092C as it was read when the clocks had converged. Ages are means: of outputs from their frame at the "
                    "MainDevice to Outputs Valid, of inputs from Input Latch to the MainDevice. A box hides a SubDevice below."
                    @if self.report.alike().len() < self.report.devices.len() {
                        " Equal SubDevices side by side are one row, with the worst of their figures; the report for programs has each."
                    }
                }
                (table(&heads, rows))
                (self.samples())
            }
        }
    }

    /// Equal SubDevices side by side are one row of a drawing: all rows, the tightest margin first,
    /// those without a deadline last.
    fn rows(&self, timing: &Timing, diagnoses: &[Diagnosis]) -> Vec<(&[Device], Row<'_>)> {
        let row = |devices: &'_ [Device]| Row {
            name: title(devices),
            members: devices
                .iter()
                .map(|device| (device.position, self.seen(device.position)))
                .collect(),
        };
        let alike = fold(&self.report.devices, |a, b| {
            let plain = |one: &Device| diagnoses.iter().all(|d| d.position != Some(one.position));
            plain(a) && plain(b) && self.report.alike_with(a, b)
        });
        let mut rows: Vec<_> = alike.into_iter().map(|devices| (devices, row(devices))).collect();
        rows.sort_by(|(_, a), (_, b)| {
            let left = |row: &Row<'_>| {
                let of = |(at, seen)| margin::least(&margin::margins(timing, at, seen));
                tightest(timing, row).and_then(of)
            };
            // What has no deadline comes behind all that has one.
            let left = [a, b].map(|row| left(row).unwrap_or(f64::INFINITY));
            let wrong = |row: &Row<'_>| {
                let at = row.members[0].0;
                diagnoses.iter().any(|diagnosis| diagnosis.position == Some(at))
            };
            wrong(b).cmp(&wrong(a)).then(left[0].total_cmp(&left[1]))
        });
        rows
    }

    fn seen(&self, position: usize) -> Option<&CycleSeen> {
        self.recorded.devices.get(position)?.cycle.as_ref()
    }

    /// All SubDevices on one axis.
    fn all_devices(&self, diagnoses: &[Diagnosis]) -> Markup {
        let Some(timing) = &self.segment.timing else { return html! {} };
        let rows: Vec<Row<'_>> =
            self.rows(timing, diagnoses).into_iter().map(|(_, row)| row).collect();
        let Some(picture) = (Devices { id: "all", timing, rows: &rows }).draw() else {
            return html! {};
        };
        let jitter = timing.cycle.jitter;
        html! {
            section #all {
                h2 { "All SubDevices in the bus cycle" }
                p.quiet {
                    "The tightest first. What is left at worst until outputs act, and until the next frame takes inputs: green more than the "
                    (jitter) " that a frame may be late, orange less, red too late."
                }
                (figure(Some(&picture), ""))
                (legend(&[
                    ("outputs", "outputs: copied and calculated"), ("m pulse", "acting pulse"),
                    ("m inputs", "Input Latch"), ("inputs", "inputs: until they stand in the buffer"),
                    ("wire", "frame"), ("jitter", "how late it may be"),
                ]))
            }
        }
    }

    fn cycles(&self, diagnoses: &[Diagnosis]) -> Markup {
        let Some(timing) = &self.segment.timing else { return html! {} };
        let when = match self.recorded.operating {
            true => "of the judged time",
            false => "of the way up, up to where it failed",
        };
        let wrong = |at: usize| diagnoses.iter().any(|d| d.position == Some(at));
        let rows = self.rows(timing, diagnoses);
        let folded = rows.iter().any(|(devices, _)| devices.len() > 1);
        html! {
            section #cycles {
                h2 { "The cycle of each SubDevice" }
                p {
                    "Times count from the begin of the bus cycle by the reference clock. Dashed: earliest and latest instants of the "
                    "plan. Filled: what was seen in true time in the cycles " (when) ", the mean; pale: from the least to the largest. "
                    @if folded { "Of equal SubDevices side by side the one with the least margin is drawn. " }
                    span.script { "Draw a part to zoom into it; point at something for its figures; + - 0 and arrow keys work, too." }
                }
                @for (devices, row) in &rows {
                    @let at = tightest(timing, row).map_or(devices[0].position, |(at, _)| at);
                    (self.cycle(timing, devices, at, wrong(at)))
                }
            }
        }
    }

    /// The drawing of one SubDevice, which may stand for several.
    fn cycle(&self, timing: &Timing, devices: &[Device], at: usize, wrong: bool) -> Markup {
        let device = &self.report.devices[at];
        let none = RecordedDevice::default();
        let seen = self.recorded.devices.get(at).unwrap_or(&none);
        let id = format!("cycle-{at}");
        let cycle =
            Cycle { id: &id, name: &device.name, timing, position: at, seen: seen.cycle.as_ref() };
        let missed = seen.around_miss.as_ref().and_then(|around| {
            events(
                &format!("miss-{at}"),
                "What happened around the first pulse that found no outputs ready",
                around,
            )
        });
        html! {
            article #{ "device-" (devices[0].position) } data-device=(devices[0].position) {
                h3.bad[wrong] {
                    (title(devices)) " "
                    span.quiet { (device.mode) @if let Some(op_mode) = &device.op_mode { " by " (op_mode) } }
                }
                @if devices.len() > 1 {
                    p.quiet { (devices.len()) " equal SubDevices; drawn is " (at) " (" (device.name) "), which has the least margin." }
                }
                @if !device.mode_reason.is_empty() { p.quiet { (device.mode_reason) } }
                @if let (Some(cycle), true) = (&seen.cycle, device.mode == SyncMode::FreeRun) {
                    p.quiet {
                        "In Free Run nothing of it has a place in the bus cycle: times count from the first step of its own cycle ("
                        (cycle.outputs_took.count().max(cycle.inputs_took.count())) " of them)."
                    }
                }
                (figure(cycle.draw().as_ref(), ""))
                @if missed.is_some() {
                    (figure(missed.as_ref(), "The cycle of the first pulse that found no outputs ready, as it was: the pulse is at 0."))
                }
                @if !device.application.is_empty() { p.quiet { (device.application) " " (origin("m")) } }
            }
        }
    }

    fn errors(&self) -> Markup {
        let length = (self.recorded.length.0 as f64 / 1e3).max(1.0);
        let worst = |device: &&Device| device.true_time.sync0_error.map_or(0.0, |e| e.worst_ns);
        let none = RecordedDevice::default();
        let recorded = |at: usize| self.recorded.devices.get(at).unwrap_or(&none);
        let with_sync0: Vec<_> = self
            .report
            .alike()
            .into_iter()
            .filter_map(|row| {
                // Of equal ones the one that is furthest off.
                let device = row.iter().max_by(|a, b| worst(a).total_cmp(&worst(b)))?;
                Some((&row[0], device, row.len()))
            })
            .filter(|(_, device, _)| recorded(device.position).sync0.count() > 0)
            .collect();
        if with_sync0.is_empty() {
            return html! {};
        }
        html! {
            section #errors {
                h2 { "SYNC0 error over time" }
                p {
                    "Each SYNC0 edge in true time against the grid of the reference clock: mean and, pale, least to largest of each "
                    "span of time. Dashed red: the limit of " (self.limit) ", where that is near. Red marks: missed SM events."
                }
                @for (first, device, count) in with_sync0 {
                    div data-device=(first.position) {
                        @if count > 1 { p.quiet { "Of " (count) " equal SubDevices from " (first.position) " on, the one that was furthest off:" } }
                        (self.error(device, recorded(device.position), length))
                    }
                }
            }
        }
    }

    fn error(&self, device: &Device, seen: &RecordedDevice, length: f64) -> Markup {
        let at = device.position;
        if let (Some((least, largest)), 0) = (seen.sync0.range(), seen.missed_count)
            && least == largest
        {
            let why = match self.segment.reference == Some(at) {
                true => {
                    ": it is the reference clock, and its edges lie where its ticks of 10 ns do"
                }
                false => "",
            };
            return html! {
                article data-device=(at) {
                    h3 { (at) " " (device.name) }
                    p { (time(least as f64 / 1e3)) " at each of " (seen.sync0.count()) " edges" (why) ". " (origin("t")) }
                }
            };
        }
        let marks: Vec<(f64, String)> = seen
            .missed
            .iter()
            .map(|(since, counter)| {
                let at = since.0 as f64 / 1e3;
                (at, format!("SM event missed at {}, 0x1C32:0B now {counter}", time(at)))
            })
            .collect();
        let limit = isocat_wire::time::Picos::from(self.limit).0;
        let chart = |id: &str, title: &str, series| {
            let span = (0.0, length);
            Chart { id, title, series, limit: Some(limit), marks: &marks, span }.draw()
        };
        let error = chart(
            &format!("error-{at}"),
            &format!("SYNC0 error of SubDevice {at} ({})", device.name),
            &seen.sync0,
        );
        let difference = chart(
            &format!("difference-{at}"),
            &format!("Register 0x092C of SubDevice {at} ({})", device.name),
            &seen.difference,
        );
        let bins: Vec<(f64, f64, u64)> = seen
            .histogram
            .bins()
            .map(|(begin, count)| {
                (begin as f64 / 1e3, (begin + seen.histogram.width()) as f64 / 1e3, count)
            })
            .collect();
        let histogram = Histogram { title: "SYNC0 error by size", bins: &bins }.draw();
        html! {
            article data-device=(at) {
                h3 { (at) " " (device.name) }
                (figure(error.as_ref(), "SYNC0 error [t]"))
                div.pair {
                    (figure(histogram.as_ref(), "The same by size: how many edges"))
                    (figure(difference.as_ref(), "Register 0x092C as it stood in the ESC in each cycle, local less received time"))
                }
            }
        }
    }

    fn host(&self) -> Markup {
        let length = (self.recorded.length.0 as f64 / 1e3).max(1.0);
        let (seen, counted) = (&self.report.segment.true_time, &self.report.segment.main_device);
        let states: Vec<(f64, String)> = self.recorded.servo[1.min(self.recorded.servo.len())..]
            .iter()
            .map(|(at, state)| (at.0 as f64 / 1e3, format!("servo: {}", servo(*state))))
            .collect();
        let jitter = self.report.segment.plan.as_ref().map(|plan| plan.jitter_ns * 1_000);
        let picture: Option<Picture> = Chart {
            id: "host-phase",
            title: "Lateness of the frames at the reference clock",
            series: &self.recorded.host_phase,
            limit: jitter,
            marks: &states,
            span: (0.0, length),
        }
        .draw();
        html! {
            section #host {
                h2 { "The host" }
                @if picture.is_some() {
                    (figure(picture.as_ref(), "When cyclic frames reached the reference clock, less when they should have [t]. Dashed: the lateness that the plan keeps free."))
                }
                table.facts {
                    @if let Some(spread) = seen.host_phase_error {
                        tr { th { "frames against their phase " (origin("t")) } td { (range_of(&spread.span())) } }
                    }
                    @if let Some(spread) = counted.host_phase_error {
                        tr { th { "the same as the host measured it " (origin("m")) } td { (range_of(&spread.span())) } }
                    }
                    @if let Some(ppb) = counted.reference_rate_ppb {
                        tr {
                            th { "reference clock against the host's " (origin("m")) }
                            td {
                                (format!("{:+.3} ppm", ppb as f64 / 1e3))
                                @if let Some(error) = counted.reference_rate_error_ppb {
                                    (format!(", standard error {:.3}", error as f64 / 1e3))
                                }
                            }
                        }
                    }
                    tr {
                        th { "servo " (origin("m")) }
                        td {
                            @for (at, state) in &self.recorded.servo {
                                div { (servo(*state)) " since " (time(at.0 as f64 / 1e3)) }
                            }
                        }
                    }
                    tr { th { "frames for bring-up, of these for the clocks " (origin("m")) }
                        td { (counted.bring_up_frames) ", " (counted.drift_frames) } }
                    @if let Some(difference) = counted.difference_at_lock {
                        tr { th { "0x092C when clocks locked " (origin("r")) } td { (difference.words()) } }
                    }
                    (settling(seen.settling.as_ref(), "edges", "t"))
                    tr { th { "cycles, wrong working counters " (origin("m")) }
                        td { (counted.cycles) ", " (counted.working_counter_errors) } }
                }
            }
        }
    }

    fn incidents(&self) -> Markup {
        let recorded = self.recorded;
        if recorded.incidents.is_empty() {
            return html! {};
        }
        let of = |at: usize| recorded.devices.get(at).map_or(0, |seen| seen.missed.len() as u64);
        let more: u64 = (0..recorded.devices.len())
            .map(|at| recorded.devices[at].missed_count.saturating_sub(of(at)))
            .sum::<u64>()
            + recorded.unsaid;
        html! {
            section #incidents {
                h2 { "What happened" }
                p.quiet { "0x1C32:0B goes down again between two missed events, by the rule of the device: what is read at the end may be 0." }
                ul {
                    @for incident in &recorded.incidents {
                        li {
                            (time(incident.at.0 as f64 / 1e3)) ": "
                            @if let Some(device) = incident.device { "SubDevice " (device) ": " }
                            (incident.what)
                        }
                    }
                    @if more > 0 { li { "and " (more) " more" } }
                }
            }
        }
    }

    fn budget(&self) -> Markup {
        let Some(timing) = &self.segment.timing else { return html! {} };
        let rows = html! {
            @let frames = timing.frames_in_cycle().line();
            tr {
                td { "frames" } td { (frames.check.words()) } td { "" }
                td.number { (time(frames.needed.0 as f64)) } td.number { (time(frames.available.0 as f64)) }
                (slack(frames.slack().0)) td.number { "-" }
            }
            @for row in self.report.alike() {
                @for check in Check::OF_DEVICE {
                    @let of = |device: &Device| Some((device.position, timing.demand(device.position, check)?));
                    @if let Some((position, demand)) = row.iter().filter_map(of).min_by_key(|(_, demand)| demand.line().slack()) {
                        @let device = &self.report.devices[position];
                        @let line = demand.line();
                        tr data-device=(row[0].position) {
                            td {
                                (title(row))
                                @if row.len() > 1 { span.quiet { ", least at " (position) } }
                            }
                            td { (check.words()) }
                            td { (check.source().map_or(String::new(), |source| source.to_string())) }
                            td.number { (time(line.needed.0 as f64)) }
                            td.number { (time(line.available.0 as f64)) }
                            (slack(line.slack().0))
                            @let left = self.measured(device.position, check);
                            td.number.bad[left.is_some_and(|left| left < 0.0)] { (left.map_or("-".into(), time)) }
                        }
                    }
                }
            }
        };
        html! {
            section #budget {
                h2 { "The plan's budget" }
                p.quiet {
                    "Phase of the frame " (timing.cycle.send) ", of the acting pulse "
                    (timing.sync0.map_or("-".into(), |phase| phase.to_string())) ", lateness of frames that is kept free "
                    (timing.cycle.jitter) ", clocks within " (timing.cycle.clock_error)
                    ". isocat plan tells each line with all its figures, --prove measures each."
                }
                (table(&["device", "demand", "object", "needed [p]", "there is [p]", "slack [p]", "left at worst [t]"], rows))
            }
        }
    }

    /// The least slack in true time, for the lines for which it is recorded.
    fn measured(&self, position: usize, check: Check) -> Option<f64> {
        let seen = self.recorded.devices.get(position).and_then(|seen| seen.cycle.as_ref());
        let left = seen.map(|cycle| cycle.outputs_left).filter(|left| left.count() > 0);
        match (check, left) {
            (Check::OutputsBeforeSync0 | Check::Sync1CoversCopy, Some(left)) => {
                Some(left.least() as f64 / 1e3)
            }
            _ => None,
        }
    }

    fn quality(&self) -> Markup {
        let Some(quality) = &self.report.quality else { return html! {} };
        html! {
            section #quality {
                h2 { "Read in the background" }
                pre { (quality.plain()) }
            }
        }
    }

    fn assumed(&self) -> Markup {
        let count: usize = self.report.devices.iter().map(|device| device.assumptions.len()).sum();
        if count == 0 {
            return html! {};
        }
        // Devices of one profile assume the same.
        let mut profiles: Vec<(&str, Vec<usize>, &Device)> = Vec::new();
        for device in &self.report.devices {
            let same = |(profile, _, first): &&mut (&str, Vec<usize>, &Device)| {
                *profile == device.profile && first.assumptions == device.assumptions
            };
            match profiles.iter_mut().find(same) {
                Some((_, positions, _)) => positions.push(device.position),
                None => profiles.push((&device.profile, vec![device.position], device)),
            }
        }
        html! {
            section #assumed {
                h2 { "What was assumed" }
                p { "Values that makers do not publish, and doubts about descriptions: " (count) " in all." }
                @for (profile, positions, device) in profiles.iter().filter(|(_, _, d)| !d.assumptions.is_empty()) {
                    details {
                        summary {
                            (profile) ": " (device.assumptions.len()) " of SubDevice"
                            @if positions.len() > 1 { "s" }
                            @for position in positions.iter().take(12) { " " (position) }
                            @if positions.len() > 12 { " and " (positions.len() - 12) " more" }
                        }
                        (table(&["item", "value", "why"], html! {
                            @for assumption in &device.assumptions {
                                tr { td { (assumption.item) } td { (assumption.value) } td { (assumption.why) } }
                            }
                        }))
                    }
                }
            }
        }
    }
}

/// Place and name of one SubDevice, or of several that are told as one.
fn title(devices: &[Device]) -> String {
    format!(
        "{} {}",
        range(devices[0].position, devices[devices.len() - 1].position),
        names(devices)
    )
}

fn names(devices: &[Device]) -> String {
    isocat_engine::fold::name(
        &devices.iter().map(|device| device.name.as_str()).collect::<Vec<_>>(),
    )
}
/// The diagnoses: place, cause and remedies.
fn why(diagnoses: &[Diagnosis]) -> Markup {
    html! {
        @if !diagnoses.is_empty() {
            section.why #why {
                h2 { "Why, and what to do" }
                @for diagnosis in diagnoses {
                    article {
                        h3 {
                            @match diagnosis.position {
                                Some(at) => { a href={ "#device-" (at) } { (diagnosis.who) } }
                                None => { (diagnosis.who) }
                            }
                        }
                        p { (diagnosis.what) }
                        @if !diagnosis.causes.is_empty() {
                            h4 { "Cause" }
                            ul.cause { @for cause in &diagnosis.causes { li { (cause) } } }
                        }
                        @if !diagnosis.remedies.is_empty() {
                            h4 { "Remedy" }
                            ol.remedy { @for remedy in &diagnosis.remedies { li { (remedy) } } }
                        }
                    }
                }
            }
        }
    }
}

const fn servo(state: phase::State) -> &'static str {
    match state {
        phase::State::Free => "no sample yet",
        phase::State::Acquiring => "acquiring",
        phase::State::Locked => "locked",
        phase::State::Holdover => "holdover",
    }
}
