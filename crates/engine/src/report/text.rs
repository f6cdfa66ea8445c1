//! The report for people: a hundred columns, verdict first.

use std::collections::{BTreeMap, HashMap};
use std::fmt::{self, Write};

use anstyle::{AnsiColor, Style};
use isocat_descriptions::columns::{WIDTH, cut_front, wrap};
use isocat_descriptions::quantity::{Length, Ppb};
use isocat_sync::SyncMode;
use isocat_wire::AlStatusCode;
use isocat_wire::time::Nanos;

use super::age::{self, DataAge};
use super::alike::{widest_span, worst_spread};
use super::expected;
use super::{Counters, Device, DeviceRegisters, Finding, Report, Ring, Span, Spread};
use super::{op_mode, samples};
use crate::fold::{self, label};

/// Largest numbers of findings and of SubDevices that are shown.
const MOST_FINDINGS: usize = 12;
pub(super) const MOST_DEVICES: usize = 40;
/// Largest number of drawn clocks that a note names individually.
const MOST_CLOCKS: usize = 6;

/// Heads of the columns with the counters.
pub(super) const SOURCE: &str = "0x1C32 [r]";
pub(super) const SUBS: &str = "0B 0C 0D 20";

pub(crate) const GOOD: Style = AnsiColor::Green.on_default().bold();
pub(crate) const BAD: Style = AnsiColor::Red.on_default().bold();
pub(crate) const UNKNOWN: Style = AnsiColor::Yellow.on_default().bold();
pub(crate) const QUIET: Style = Style::new().dimmed();

impl Report {
    /// The report as text, with ANSI styles; print it through a stream that strips them if needed.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let style = if self.in_sync { GOOD } else { BAD };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        let judged = Nanos(self.judged_ns);
        let (cycle, seed) = (Nanos(self.cycle_ns), self.seed);
        let judged = match self.judged_ns {
            0 => "not judged, since operation was not reached".to_owned(),
            _ => format!("judged for {judged} of virtual time"),
        };
        let run = format!(": cycle {cycle}, {judged}, seed {seed}");
        let file = cut_front(&self.segment_file, WIDTH - run.chars().count());
        writeln!(out, "{QUIET}{file}{run}{QUIET:#}")?;
        self.write_why(out)?;
        expected::write(out, &self.expected, &self.faults)?;
        write_findings(out, &self.findings)?;
        if self.diagnoses.is_empty() {
            write_where_to_read(out, &self.findings)?;
        }
        if self.segment.plan.is_some() {
            self.write_devices(out)?;
            self.write_ages(out)?;
            samples::write(out, &self.devices)?;
        }
        if let Some(plants) = &self.plants {
            plants.write(out)?;
        }
        self.write_segment(out)?;
        self.write_budget(out)?;
        if let Some(quality) = &self.quality {
            quality.write(out)?;
        }
        self.write_notes(out)
    }

    fn write_devices(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "\n{:54}{:^22} {:>10}  {}", "", "SYNC0 error [t], ns", "margin [t]", SOURCE)?;
        writeln!(
            out,
            " {:<2} {:<19} {:<8} {:>7}  {:<10} {:>6} {:>6} {:>6} {:>12}  {}",
            "#", "device", "mode", "cycle", "state [r]", "mean", "sd", "worst", "worst", SUBS
        )?;
        let rows = self.alike();
        for row in rows.iter().take(MOST_DEVICES) {
            let device = &row[0];
            let sync0 = worst_spread(row.iter().map(|device| device.true_time.sync0_error));
            let figure = |pick: fn(&Spread) -> f64| sync0.as_ref().map(pick);
            let margins = row.iter().filter_map(|device| device.true_time.sync0_margin);
            let margin = margins.map(|margin| margin.min_ns).reduce(f64::min);
            writeln!(
                out,
                " {} {:<8} {:>7}  {:<10} {:>6} {:>6} {:>6} {:>12}  {}",
                label(&names(row), 2, 19),
                device.mode,
                device.cycle_ns.map_or("-".into(), |ns| Nanos(ns).to_string()),
                device.registers.al_status,
                fits(figure(|s| s.mean_ns)),
                fits(figure(|s| s.standard_deviation_ns)),
                fits(figure(|s| s.worst_ns)),
                margin.map_or("-".into(), micros),
                counters(&device.registers.output_counters, &device.registers.input_counters),
            )?;
        }
        let more = rows.iter().skip(MOST_DEVICES).map(|row| row.len()).sum::<usize>();
        if more > 0 {
            writeln!(out, " …  and {more} more; --json lists them all")?;
        }
        if rows.len() < self.devices.len() {
            writeln!(
                out,
                "  {QUIET}equal devices side by side are one row, with the worst of their figures; --json has each{QUIET:#}"
            )?;
        }
        op_mode::write(out, self.devices.iter().filter_map(Device::placed_op_mode))
    }

    fn write_ages(&self, out: &mut String) -> fmt::Result {
        let ages = self.alike().into_iter().map(|row| DataAge {
            devices: names(row),
            outputs: widest_span(row.iter().map(|device| device.true_time.outputs_age)),
            inputs: widest_span(row.iter().map(|device| device.true_time.inputs_age)),
        });
        age::write(out, &ages.collect::<Vec<_>>(), " [t]")
    }

    fn write_segment(&self, out: &mut String) -> fmt::Result {
        writeln!(out)?;
        let (seen, counted) = (&self.segment.true_time, &self.segment.main_device);
        let mut line = |what: &str, figure: String, from: &str| {
            writeln!(out, " {what:<36} {figure} {QUIET}[{from}]{QUIET:#}")
        };
        if let Some(time) = seen.time_to_synchronization_ns {
            line("time to synchronization", micros_or_ms(time), "t")?;
        }
        line(
            "frames for bring-up",
            format!(
                "{}, of these {} for the clocks",
                counted.bring_up_frames, counted.drift_frames
            ),
            "m",
        )?;
        if let Some(difference) = counted.difference_at_lock {
            line("0x092C when clocks locked", difference.words(), "r")?;
        }
        for (what, figure) in seen.settling.iter().flat_map(|settling| settling.lines("edges")) {
            line(what, figure, "t")?;
        }
        line(
            "frames sent, lost",
            format!("{}, {}", counted.frames_sent, counted.frames_lost),
            "m",
        )?;
        if let Some(Ring { position, port, cable_mm }) = self.segment.ring {
            let cable = Length(cable_mm);
            let figure =
                format!("closed by {cable} of cable from port {port} of SubDevice {position}");
            line("ring", figure, "p")?;
            line("copies of frames lost in the ring", self.segment.copies_lost.to_string(), "m")?;
        }
        if let Some(spread) = seen.outputs_valid_spread {
            line("outputs valid, first to last device", range(&spread), "t")?;
        }
        if let Some(spread) = seen.host_phase_error {
            line("frames against their phase", range(&spread.span()), "t")?;
        }
        if let Some(spread) = counted.host_phase_error {
            line("frames against their phase", range(&spread.span()), "m")?;
        }
        if let Some(ppb) = counted.reference_rate_ppb {
            let error = counted.reference_rate_error_ppb.map_or_else(String::new, |error| {
                format!(", standard error {:.3}", error as f64 / 1000.0)
            });
            let ppm = format!("{:+.2} ppm{error}", ppb as f64 / 1000.0);
            line("reference clock against the host's", ppm, "m")?;
        }
        Ok(())
    }

    fn write_budget(&self, out: &mut String) -> fmt::Result {
        let Some(plan) = &self.segment.plan else { return Ok(()) };
        let tightest = self
            .devices
            .iter()
            .filter(|device| device.mode != SyncMode::FreeRun)
            .flat_map(|device| device.plan.iter().map(move |line| (device, line)))
            .min_by_key(|(_, line)| line.slack_ns);
        if let Some(phase) = plan.sync0_phase_ns {
            let (phase, send) = (Nanos(phase), Nanos(plan.send_phase_ns));
            let text = format!("SYNC0 at {phase} of the cycle, frame at {send}");
            writeln!(out, " {:<36} {text} {QUIET}[p]{QUIET:#}", "plan")?;
        }
        if let Some((device, line)) = tightest {
            let slack = Nanos(line.slack_ns);
            let text = format!("{slack}: {} of SubDevice {}", line.object, device.position);
            writeln!(out, " {:<36} {text} {QUIET}[p]{QUIET:#}", "tightest line of the budget")?;
        }
        Ok(())
    }

    fn write_notes(&self, out: &mut String) -> fmt::Result {
        let mut notes = Vec::new();
        let short = |device: &&Device| device.plan.iter().any(|line| line.slack_ns < 0);
        let lacking = self.devices.iter().filter(short).map(|device| {
            let line = device.plan.iter().min_by_key(|line| line.slack_ns).expect("one is short");
            let what = format!(
                "the plan does not fit, and was run all the same: {}: {}: slack {}",
                line.object,
                line.demand,
                Nanos(line.slack_ns)
            );
            (device.position, what)
        });
        notes.extend(said_of_several(lacking).into_iter().take(MOST_DEVICES));
        notes.extend(self.visits.iter().take(MOST_FINDINGS).map(Finding::sentence));
        notes.extend(self.services.iter().take(MOST_FINDINGS).map(|note| note.what.clone()));
        if let Some(reference) = self.segment.main_device.reference {
            notes.push(format!(
                "SubDevice {reference} is the reference clock: its own SYNC0 edges do not spread, they lie \
                 where its 10 ns ticks do"
            ));
        }
        notes.extend(self.notes_of_devices());
        notes.extend(self.drawn_clocks());
        let assumed = self.devices.iter().flat_map(|device| &device.assumptions);
        let assumed = assumed.filter(|assumed| assumed.doubt.is_none()).count();
        if assumed > 0 {
            notes.push(format!(
                "{assumed} values are assumed because the makers do not publish them; \
                 --json lists them with the reasons"
            ));
        }
        writeln!(out)?;
        write_notes(out, &notes)?;
        writeln!(
            out,
            "\n {QUIET}0x1C32: 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error\n \
             [t] measured in true time  [r] read from the device  [m] MainDevice's clock and counts  [p] plan{QUIET:#}"
        )
    }
}

impl Report {
    /// What is to be said of single SubDevices; what is the same of several is said once.
    fn notes_of_devices(&self) -> Vec<String> {
        let of = |device: &Device| {
            let mut said = Vec::new();
            if !device.mode_reason.is_empty() {
                said.push((device.position, device.mode_reason.clone()));
            }
            // Devices that did not come into operation did nothing with their process data.
            if !device.application.is_empty() && self.judged_ns > 0 {
                said.push((device.position, device.application.clone()));
            }
            said
        };
        let mut notes = said_of_several(self.devices.iter().flat_map(of));
        notes.truncate(MOST_DEVICES);
        for device in self.devices.iter().take(MOST_DEVICES) {
            notes.extend(device.registers.unknown_delay(device.position));
            let measured = device.registers.measured_times;
            notes.extend(measured.map(|times| times.note(device.position)));
        }
        let doubts = self.devices.iter().filter_map(|device| {
            let doubts = device.assumptions.iter().filter_map(|assumed| assumed.doubt);
            let doubts = doubts.collect::<Vec<_>>().join(", ");
            let what = format!("to know about its description: {doubts}; --json has the words");
            (!doubts.is_empty()).then_some((device.position, what))
        });
        notes.extend(said_of_several(doubts).into_iter().take(MOST_DEVICES));
        notes
    }
    /// The notes on clocks without a value in the segment file, one for each tolerance.
    pub fn drawn_clocks(&self) -> Vec<String> {
        let drawn = self.devices.iter().filter_map(|device| {
            let clock = &device.true_time.clock;
            clock.drawn_within_ppb.map(|within| (within, device.position, clock.deviation_ppb))
        });
        let mut by_tolerance: BTreeMap<i64, Vec<(usize, i64)>> = BTreeMap::new();
        for (within, position, ppb) in drawn {
            by_tolerance.entry(within).or_default().push((position, ppb));
        }
        let note = |(within, clocks): (&i64, &Vec<(usize, i64)>)| {
            let figures = clocks.iter().take(MOST_CLOCKS).map(|(position, ppb)| {
                format!("SubDevice {position} {:+.2} ppm", *ppb as f64 / 1e3)
            });
            let mut figures = figures.collect::<Vec<_>>().join(", ");
            if clocks.len() > MOST_CLOCKS {
                figures +=
                    &format!(", and {} more; --json lists them all", clocks.len() - MOST_CLOCKS);
            }
            let within = Ppb(*within).to_string().replace('+', "");
            format!("clocks drawn from seed {} within \u{b1}{within}: {figures}", self.seed)
        };
        by_tolerance.iter().map(note).collect()
    }
}

/// Positions and names of SubDevices that are told as one.
fn names(row: &[Device]) -> Vec<(usize, &str)> {
    row.iter().map(|device| (device.position, device.name.as_str())).collect()
}

/// `SubDevice 2: …`, and `SubDevices 3 to 14: …` where the same is said of several, in the order in
/// which each is said first.
fn said_of_several(all: impl Iterator<Item = (usize, String)>) -> Vec<String> {
    let mut said: Vec<(Vec<usize>, String)> = Vec::new();
    let mut known: HashMap<String, usize> = HashMap::new();
    for (position, what) in all {
        match known.get(&what) {
            Some(at) => said[*at].0.push(position),
            None => {
                known.insert(what.clone(), said.len());
                said.push((vec![position], what));
            }
        }
    }
    let sentence = |(positions, what): &(Vec<usize>, String)| {
        let several = if positions.len() > 1 { "s" } else { "" };
        format!("SubDevice{several} {}: {what}", fold::positions(positions))
    };
    said.iter().map(sentence).collect()
}
/// Writes the findings, if the verdict does not state them all.
pub(super) fn write_findings(out: &mut String, findings: &[Finding]) -> fmt::Result {
    if findings.len() > 1 {
        writeln!(out)?;
        for finding in findings.iter().take(MOST_FINDINGS) {
            for (i, line) in wrap(&finding.sentence(), WIDTH - 4).iter().enumerate() {
                writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
            }
        }
    }
    if findings.len() > MOST_FINDINGS {
        let more = findings.len() - MOST_FINDINGS;
        writeln!(out, "  - and {more} more; --json lists them all")?;
    }
    Ok(())
}

/// Where to read what the AL status codes among the findings mean, where no diagnosis has told it.
pub(super) fn write_where_to_read(out: &mut String, findings: &[Finding]) -> fmt::Result {
    let mut codes: Vec<AlStatusCode> = Vec::new();
    for code in findings.iter().filter_map(|finding| finding.kind.al_status_code()) {
        if code != AlStatusCode::NO_ERROR && !codes.contains(&code) {
            codes.push(code);
        }
    }
    for code in codes.iter().take(3) {
        writeln!(
            out,
            "  isocat explain 0x{:04X} tells the usual causes and what to change",
            code.0
        )?;
    }
    Ok(())
}

/// Writes one item for each note.
pub(super) fn write_notes(out: &mut String, notes: &[String]) -> fmt::Result {
    for note in notes {
        for (i, line) in wrap(note, WIDTH - 4).iter().enumerate() {
            writeln!(out, " {} {line}", if i == 0 { "-" } else { " " })?;
        }
    }
    Ok(())
}

impl DeviceRegisters {
    /// The note on a clock whose delay was not measured.
    pub(super) fn unknown_delay(&self, position: usize) -> Option<String> {
        let (why, used) = (self.delay_unknown.as_ref()?, Nanos(self.delay_ns?));
        Some(format!("SubDevice {position}: its delay can't be known, {used} was written: {why}"))
    }
}

/// Counters as text: `0  0  0  0`, and both objects if they differ.
pub(super) fn counters(outputs: &Counters, inputs: &Counters) -> String {
    let show = |c: &Counters| {
        [c.sm_event_missed, c.cycle_time_too_small, c.shift_time_too_short, c.sync_error]
            .map(|value| value.map_or("-".to_owned(), |value| value.to_string()))
            .map(|value| format!("{value:>2}"))
            .join(" ")
    };
    let (outputs, inputs) = (show(outputs), show(inputs));
    if outputs == inputs { outputs } else { format!("{outputs} /{inputs}") }
}

/// A figure in ns with one decimal, or in us or ms if that is too long for its column.
fn fits(ns: Option<f64>) -> String {
    let Some(ns) = ns else { return "-".into() };
    match ns.abs() {
        size if size < 1_000.0 => format!("{ns:.1}"),
        size if size < 100_000.0 => format!("{:.1}us", ns / 1e3),
        size if size < 1_000_000.0 => format!("{:.0}us", ns / 1e3),
        _ => format!("{:.2}ms", ns / 1e6),
    }
}

/// A time to the nanosecond: `412.345 us`.
fn micros(ns: f64) -> String {
    format!("{:.3} us", ns.floor() / 1000.0)
}

fn micros_or_ms(ns: i64) -> String {
    format!("{:.1} ms", ns as f64 / 1e6)
}

pub(super) fn range(span: &Span) -> String {
    let us = |ns: f64| format!("{:.3}", ns / 1000.0);
    format!(
        "mean {} us, {} to {} us, sd {} us",
        us(span.mean_ns),
        us(span.min_ns),
        us(span.max_ns),
        us(span.standard_deviation_ns)
    )
}
