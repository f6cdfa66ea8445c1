//! The plan for people: a hundred columns, verdict first.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut_front, wrap};
use isocat_sync::budget::Check;
use isocat_wire::time::Nanos;

use super::report::{Device, Frame, Line, PlanReport, Suggestion, Term};
use crate::fold::{fold, label};
use crate::report::{BAD, GOOD, Note, QUIET, op_mode};

/// Above this number of SubDevices, a table and the tightest lines replace the figures of each.
const MOST_IN_FULL: usize = 6;
const MOST_DEVICES: usize = 40;
/// Largest number of frames, datagrams, assumptions, warnings and findings in the text.
const MOST_NOTES: usize = 12;
/// Longest cycle that a suggestion tries, ns.
const LONGEST_TRIED: i64 = super::suggest::LONGEST.0;

impl PlanReport {
    /// The plan as text, with ANSI styles; print it through a stream that strips them if needed.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let style = if self.fits { GOOD } else { BAD };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        self.write_proof_verdict(out)?;
        let segment = &self.segment;
        let (cycle, jitter) = (Nanos(segment.cycle_ns), Nanos(segment.send_jitter_ns));
        let clocks = Nanos(segment.clock_error_ns);
        let ring = if segment.ring.is_some() { ", in a ring" } else { "" };
        let settings =
            format!(": cycle {cycle}, send jitter {jitter}, clocks within {clocks}{ring}");
        let file = cut_front(&self.segment_file, WIDTH - settings.chars().count());
        writeln!(out, "{QUIET}{file}{settings}{QUIET:#}")?;
        self.write_frames(out)?;
        self.write_phases(out)?;
        self.write_table(out)?;
        if self.devices.len() <= MOST_IN_FULL {
            for device in &self.devices {
                write_device(out, device, self.proof.is_some())?;
            }
        } else {
            self.write_tightest(out)?;
        }
        self.write_suggestion(out)?;
        if let Some(what_if) = &self.what_if {
            what_if.write(out)?;
        }
        self.write_descriptions(out)?;
        let warnings = Note::sentences(self.warnings.iter());
        write_list(out, "Warnings", &warnings)?;
        write_list(out, "Assumed", &self.assumptions)
    }

    fn write_proof_verdict(&self, out: &mut String) -> fmt::Result {
        let Some(proof) = &self.proof else { return Ok(()) };
        let (style, word) = if proof.holds { (GOOD, "Proven") } else { (BAD, "Not proven") };
        let time = Nanos(proof.judged_ns);
        let mut text = format!(
            "{word}: {time} of virtual time with the worst jitter, seed {}, {}",
            proof.seed,
            counted(proof.findings.len(), "finding")
        );
        if !self.fits {
            text += ", of a plan that does not fit";
        }
        if proof.loose > 0 {
            let (loose, factor) = (counted(proof.loose, "bound"), proof.factor);
            text += &format!("; {loose} more than a factor of {factor} above what was needed");
        }
        for line in wrap(&(text + "."), WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        for (what, figure) in proof.settling.iter().flat_map(|settling| settling.lines("edges")) {
            writeln!(out, " {what:<36} {figure} {QUIET}[t]{QUIET:#}")?;
        }
        write_list(out, "Findings", &proof.findings)
    }

    fn write_frames(&self, out: &mut String) -> fmt::Result {
        let grouped = self.frames.iter().any(|frame| frame.every > 1);
        writeln!(out, "\nFrames of the {}cycle", if grouped { "fullest " } else { "" })?;
        for (number, frame) in self.frames.iter().take(MOST_NOTES).enumerate() {
            write_frame(out, number, frame)?;
        }
        if self.frames.len() > MOST_NOTES {
            writeln!(out, " … and {} more; --json lists them all", self.frames.len() - MOST_NOTES)?;
        }
        write_line(out, &self.frames_line)
    }

    fn write_phases(&self, out: &mut String) -> fmt::Result {
        let segment = &self.segment;
        let Some(acting) = segment.acting_phase_ns else { return Ok(()) };
        writeln!(out, "\nPhases behind the frame at the reference clock")?;
        let rows = [
            ("outputs of all devices ready", segment.output_reference_ns),
            ("acting pulse, the same for all", Some(acting)),
            ("latest for the inputs of all devices", segment.input_reference_ns),
        ];
        for (what, phase) in rows {
            let phase = phase.map_or("-".to_owned(), |ns| Nanos(ns).to_string());
            writeln!(out, "  {what:<38} {phase:>12}")?;
        }
        Ok(())
    }

    fn write_table(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n {:<3} {:<22} {:<15} {:>10} {:>11} {:>11} {:>13}  line",
            "#", "device", "mode", "delay", "not before", "not after", "least slack"
        )?;
        let rows = fold(&self.devices, |a, b| self.same(a, b));
        for row in rows.iter().take(MOST_DEVICES) {
            let phase = |ns: Option<i64>| ns.map_or("-".to_owned(), |ns| Nanos(ns).to_string());
            let tightest =
                row.iter().filter_map(|device| device.tightest()).min_by_key(|line| line.slack_ns);
            let names: Vec<_> = row.iter().map(|d| (d.position, d.name.as_str())).collect();
            writeln!(
                out,
                " {} {:<15} {:>9} {:>10} {:>10} {:>12}  {}",
                label(&names, 3, 20),
                row[0].mode,
                Nanos(row.iter().map(|device| device.delay_ns).max().unwrap_or(0)).to_string(),
                phase(row.iter().filter_map(|device| device.earliest_phase_ns).max()),
                phase(row.iter().filter_map(|device| device.latest_phase_ns).min()),
                phase(tightest.map(|line| line.slack_ns)),
                tightest.and_then(|line| line.object.as_deref()).unwrap_or("-"),
            )?;
        }
        let more = rows.iter().skip(MOST_DEVICES).map(|row| row.len()).sum::<usize>();
        if more > 0 {
            writeln!(out, " …  and {more} more; --json lists them all")?;
        }
        if rows.len() < self.devices.len() {
            writeln!(
                out,
                "  {QUIET}equal devices side by side are one row: the largest delay, the strictest phases, the least slack{QUIET:#}"
            )?;
        }
        // Figures in full have it in their head.
        match self.devices.len() <= MOST_IN_FULL {
            true => Ok(()),
            false => op_mode::write(out, self.devices.iter().filter_map(Device::placed_op_mode)),
        }
    }

    /// Whether two neighbours are one row: the same kind that does the same, and every demand of
    /// both fits or none does.
    fn same(&self, a: &Device, b: &Device) -> bool {
        let kind = |device: &Device| {
            let phases = (device.earliest_phase_ns.is_some(), device.latest_phase_ns.is_some());
            let pulses = (device.sync0_cycle_ns, device.sync0_phase_ns, device.sync1_ns);
            (device.mode, device.every, pulses, phases)
        };
        let lacking = |device: &Device| {
            let short = device.lines.iter().filter(|line| line.slack_ns < 0);
            short.map(|line| line.check).collect::<Vec<_>>()
        };
        let leads = |device: &Device| self.segment.reference == Some(device.position);
        a.profile == b.profile
            && a.op_mode == b.op_mode
            && kind(a) == kind(b)
            && lacking(a) == lacking(b)
            && !leads(a)
            && !leads(b)
    }
    /// Writes the tightest line of each kind; with a proof also the one that used up most of its
    /// bound.
    fn write_tightest(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "\nThe tightest line of each kind; --json has all of them")?;
        let mut kinds: Vec<Check> = Vec::new();
        for line in self.devices.iter().flat_map(|device| &device.lines) {
            if !kinds.contains(&line.check) {
                kinds.push(line.check);
            }
        }
        for kind in kinds {
            let all = || {
                let lines = |device: &'_ Device| {
                    let of = device.lines.iter().filter(|line| line.check == kind);
                    of.cloned().map(|line| (device.position, line)).collect::<Vec<_>>()
                };
                self.devices.iter().flat_map(lines)
            };
            if let Some((position, line)) = all().min_by_key(|(_, line)| line.slack_ns) {
                writeln!(out, " SubDevice {position}")?;
                write_line(out, &line)?;
            }
            let used = |line: &Line| line.measured.map_or(0.0, |measured| measured.of_bound);
            let most = all().max_by(|(_, a), (_, b)| used(a).total_cmp(&used(b)));
            if let Some((position, Line { measured: Some(measured), .. })) = most {
                let share = measured.of_bound;
                writeln!(out, "    most used: {share:.4} of the bound, SubDevice {position}")?;
            }
        }
        Ok(())
    }

    /// Writes how ESI files were read; devices that were read alike are grouped.
    fn write_descriptions(&self, out: &mut String) -> fmt::Result {
        let mut alike: Vec<Vec<&Device>> = Vec::new();
        for device in self.devices.iter().filter(|device| !device.description.is_empty()) {
            match alike.iter_mut().find(|group| group[0].description == device.description) {
                Some(group) => group.push(device),
                None => alike.push(vec![device]),
            }
        }
        for group in alike.iter().take(MOST_NOTES) {
            let Device { position, name, description, .. } = group[0];
            let others = match group.len() {
                1 => String::new(),
                count => format!(" and {} more like it", count - 1),
            };
            let title =
                format!("Description of SubDevice {position} ({name}){others}, as it was read");
            let doubts: Vec<_> =
                description.iter().map(|d| format!("{}: {}", d.kind, d.what)).collect();
            write_list(out, &title, &doubts)?;
        }
        if alike.len() > MOST_NOTES {
            writeln!(
                out,
                "\n… and {} more descriptions; --json has them all",
                alike.len() - MOST_NOTES
            )?;
        }
        Ok(())
    }

    fn write_suggestion(&self, out: &mut String) -> fmt::Result {
        let Some(found) = &self.suggestion else { return Ok(()) };
        writeln!(out, "\nSuggestion")?;
        if found.no_shift_helps {
            writeln!(out, "  no shift makes this cycle fit: other lines fail, see above")?;
        } else if let (Some(shift), Some(send), Some(slack)) =
            (found.shift_ns, found.send_phase_ns, found.slack_ns)
        {
            let (shift, send, slack) = (Nanos(shift), Nanos(send), Nanos(slack));
            writeln!(
                out,
                "  shift = \"{}\" has the most even slack, {slack}; or SYNC at 0 and the frame at {send}",
                shift.to_string().replace(' ', "")
            )?;
        }
        if let Some(shift) = found.outputs_shift_ns {
            let shift = Nanos(shift);
            let able = found.outputs_shiftable.iter();
            let mut who: Vec<_> = able.take(MOST_NOTES).map(ToString::to_string).collect();
            if found.outputs_shiftable.len() > MOST_NOTES {
                who.push("…".to_owned());
            }
            let text = format!(
                "outputs act together {shift} behind the pulse with shift = \"{}\" at the devices {}",
                shift.to_string().replace(' ', ""),
                who.join(", ")
            );
            for line in wrap(&text, WIDTH - 2) {
                writeln!(out, "  {line}")?;
            }
        }
        let text = match found.smallest_cycle_ns {
            Some(_) => format!("the smallest cycle that fits is {}", found.smallest_cycle()),
            None => found.smallest_cycle(),
        };
        for line in wrap(&text, WIDTH - 2) {
            writeln!(out, "  {line}")?;
        }
        Ok(())
    }
}

impl Suggestion {
    /// The smallest cycle in words: how it was looked for, and what changes with it; or why there
    /// is none.
    pub fn smallest_cycle(&self) -> String {
        let Some(tried) = &self.cycles else {
            return "no cycle up to 1 s suits all devices".to_owned();
        };
        let (step, least, most) = (tried.step_ns, tried.least_ns, tried.most_ns);
        let range = format!("{} to {}", Nanos(least), Nanos(most));
        let narrowed = least > step || most / step < LONGEST_TRIED / step;
        let only = least == most;
        let Some(cycle) = self.smallest_cycle_ns else {
            return match (only, narrowed) {
                (true, _) => {
                    format!("the devices take a cycle of {} only, which does not fit", Nanos(least))
                }
                (_, true) => format!("no cycle of {range} fits, and the devices take no others"),
                _ => "no cycle up to 1 s fits".to_owned(),
            };
        };
        let (cycle, step) = (Nanos(cycle), Nanos(step));
        let mut text = match (only, narrowed) {
            (true, _) => format!("{cycle}, the only one that the devices take"),
            (_, true) => format!("{cycle}, in steps of {step}; the devices take {range}"),
            _ => format!("{cycle}, in steps of {step}"),
        };
        if self.drops_shift {
            text += "; without the shift of the file";
        }
        for own in self.own_cycles.iter().take(MOST_NOTES) {
            text += &format!("; cycle {} for SubDevice {}", Nanos(own.cycle_ns), own.position);
        }
        if self.own_cycles.len() > MOST_NOTES {
            text += "; and more, which --json lists";
        }
        text
    }
}

fn write_frame(out: &mut String, number: usize, frame: &Frame) -> fmt::Result {
    let (begin, end) = (Nanos(frame.begin_ns), Nanos(frame.end_ns));
    let parts: Vec<String> = frame
        .datagrams
        .iter()
        .map(|part| {
            let whose =
                part.devices.map_or(String::new(), |[first, last]| format!(" of {first}..{last}"));
            format!("{} {} {} bytes{whose}", part.command, part.address, part.bytes)
        })
        .collect();
    let often = match frame.every {
        1 => String::new(),
        every => format!("every {every} cycles, "),
    };
    let text = format!("{often}{} bytes, {begin} to {end}: {}", frame.bytes, parts.join(", "));
    for (i, line) in wrap(&text, WIDTH - 5).iter().enumerate() {
        match i {
            0 => writeln!(out, " {number:<3} {line}")?,
            _ => writeln!(out, "     {line}")?,
        }
    }
    Ok(())
}

fn write_device(out: &mut String, device: &Device, proven: bool) -> fmt::Result {
    let Device { position, name, mode, .. } = device;
    write!(out, "\nSubDevice {position} ({name}), {mode}")?;
    if let Some(op_mode) = &device.op_mode {
        write!(out, " by {op_mode}")?;
    }
    if let (Some(cycle), Some(phase)) = (device.sync0_cycle_ns, device.sync0_phase_ns) {
        write!(out, ": SYNC0 every {} at {}", Nanos(cycle), Nanos(phase))?;
    }
    if let Some(sync1) = device.sync1_ns {
        write!(out, ", 0x09A4 {}", Nanos(sync1))?;
    }
    if let Some(after) = device.acknowledge_ns {
        write!(out, ", acknowledged after {}", Nanos(after))?;
    }
    if device.every > 1 {
        write!(out, ", exchanged every {} cycles", device.every)?;
    }
    writeln!(out)?;
    if !device.moments.is_empty() {
        let head = if proven { "seen from" } else { "" };
        let to = if proven { "to" } else { "" };
        let head = format!("  {:<22} {:>14} {:>14} {head:>16} {to:>14}", "event, us", "from", "to");
        writeln!(out, "{}", head.trim_end())?;
    }
    for moment in &device.moments {
        let us = |ns: f64| format!("{:.3}", ns / 1e3);
        let planned = [moment.earliest_ns, moment.latest_ns].map(|ns| us(ns as f64));
        let seen = moment.measured.map_or([String::new(), String::new()], |seen| {
            [us(seen.earliest_ns), us(seen.latest_ns)]
        });
        let [from, to] = planned;
        let [first, last] = seen;
        let line = format!("  {:<22} {from:>14} {to:>14} {first:>16} {last:>14}", moment.event);
        writeln!(out, "{}", line.trim_end())?;
    }
    device.lines.iter().try_for_each(|line| write_line(out, line))
}

fn write_line(out: &mut String, line: &Line) -> fmt::Result {
    let style = if line.slack_ns < 0 { BAD } else { QUIET };
    let object = line.object.as_ref().map_or(String::new(), |object| format!("{object}: "));
    let words = format!("{object}{}", line.demand);
    let slack = format!("slack {}", Nanos(line.slack_ns));
    // The slack stands at the right edge, behind the last line of the words.
    let lines = wrap(&words, WIDTH - 26);
    for (i, text) in lines.iter().enumerate() {
        match i + 1 == lines.len() {
            true => writeln!(out, "  {text:<74}{style}{slack:>24}{style:#}")?,
            false => writeln!(out, "  {text}")?,
        }
    }
    let (needed, has) =
        (sum(&line.needed, line.needed_ns), sum(&line.available, line.available_ns));
    for text in [format!("{needed} <="), has] {
        for line in wrap(&text, WIDTH - 6) {
            writeln!(out, "      {line}")?;
        }
    }
    if line.slack_ns < 0 {
        writeln!(out, "      {style}shows as: {}{style:#}", line.sign)?;
        for text in wrap(&format!("what helps: {}", line.check.remedy()), WIDTH - 6) {
            writeln!(out, "      {text}")?;
        }
    }
    match line.measured {
        Some(measured) => writeln!(
            out,
            "      seen {} times: needs at most {:.3} us, {:.4} of the bound, slack {:.3} us",
            measured.count,
            measured.needed_ns / 1e3,
            measured.of_bound,
            measured.slack_ns / 1e3
        ),
        None => Ok(()),
    }
}

/// A sum as text: `frame to its last bit 9.2 us [wire] + send jitter 20 us [asked for] = 29.2 us`.
fn sum(terms: &[Term], total: i64) -> String {
    let mut text = String::new();
    for (i, term) in terms.iter().enumerate() {
        let value = Nanos(term.value_ns.abs());
        let sign = match (i, term.value_ns < 0) {
            (0, false) => "",
            (0, true) => "- ",
            (_, false) => " + ",
            (_, true) => " - ",
        };
        text += &format!("{sign}{} {value} [{}]", term.what, term.origin);
    }
    match terms.len() {
        1 => text,
        _ => format!("{text} = {}", Nanos(total)),
    }
}

/// A count as text: `1 finding`, `2 findings`.
fn counted(count: usize, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") }
}

fn write_list(out: &mut String, title: &str, items: &[String]) -> fmt::Result {
    if items.is_empty() {
        return Ok(());
    }
    writeln!(out, "\n{title}")?;
    for item in items.iter().take(MOST_NOTES) {
        for (i, line) in wrap(item, WIDTH - 4).iter().enumerate() {
            writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
        }
    }
    if items.len() > MOST_NOTES {
        writeln!(out, "  - and {} more; --json lists them all", items.len() - MOST_NOTES)?;
    }
    Ok(())
}
