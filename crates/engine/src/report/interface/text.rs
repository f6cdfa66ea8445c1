//! The report of a run on an interface, for people: a hundred columns, verdict first.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut, cut_front, wrap};
use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

use super::{Harm, InterfaceReport, Machine, Series};
use crate::report::text::{
    BAD, GOOD, MOST_DEVICES, QUIET, SOURCE, SUBS, UNKNOWN, counters, range, write_findings,
    write_notes, write_where_to_read,
};
use crate::report::words::seconds;
use crate::verdict::Answer;

impl InterfaceReport {
    /// The report as text, with ANSI styles; print it through a stream that strips them if needed.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let style = match self.answer {
            Answer::InSync => GOOD,
            Answer::Except => BAD,
            Answer::NotKnown => UNKNOWN,
        };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        let segment = self.segment_file.as_deref().unwrap_or("whatever is there");
        let (cycle, judged) = (Nanos(self.cycle_ns), seconds(Nanos(self.judged_ns)));
        let interface = &self.interface;
        let run = format!(" on {interface}: cycle {cycle}, judged for {judged} of host time");
        let segment = cut_front(segment, WIDTH - run.chars().count());
        writeln!(out, "{QUIET}{segment}{run}{QUIET:#}")?;
        write_findings(out, &self.findings)?;
        write_where_to_read(out, &self.findings)?;
        self.write_unknown(out)?;
        if self.plan.is_some() {
            self.write_devices(out)?;
        }
        self.write_figures(out)?;
        if let Some(quality) = &self.quality {
            quality.write(out)?;
        }
        self.write_notes(out)
    }

    /// Writes what is not known: first what leaves the answer open, then in one line what no wire
    /// shows.
    fn write_unknown(&self, out: &mut String) -> fmt::Result {
        for unknown in self.unknown.iter().filter(|unknown| unknown.decides).take(MOST_DEVICES) {
            for line in wrap(&format!("not known: {}", unknown.sentence()), WIDTH) {
                writeln!(out, "{UNKNOWN}{line}{UNKNOWN:#}")?;
            }
        }
        let mut hidden = self.unknown.iter().filter(|unknown| !unknown.decides);
        let Some(first) = hidden.next() else { return Ok(()) };
        let more = match hidden.count() {
            0 => String::new(),
            more => format!("; {more} more in --json"),
        };
        for line in wrap(&format!("no wire shows: {}{more}", first.sentence()), WIDTH) {
            writeln!(out, "{QUIET}{line}{QUIET:#}")?;
        }
        Ok(())
    }

    fn write_devices(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "\n{:54}{:>12} {:>12}  {}", "", "0x092C [r]", "delay [r]", SOURCE)?;
        writeln!(
            out,
            " {:<2} {:<28} {:<8}  {:<10} {:>12} {:>12}  {}",
            "#", "device", "mode", "state [r]", "", "", SUBS
        )?;
        for device in self.devices.iter().take(MOST_DEVICES) {
            let registers = &device.registers;
            let ns = |time: Option<i64>| time.map_or("-".to_owned(), |ns| format!("{ns} ns"));
            writeln!(
                out,
                " {:<2} {:<28} {:<8}  {:<10} {:>12} {:>12}  {}",
                device.position,
                cut(&device.name, 28),
                device.mode,
                registers.al_status,
                ns(registers.system_time_difference_ns),
                ns(registers.delay_ns),
                counters(&registers.output_counters, &registers.input_counters),
            )?;
        }
        if self.devices.len() > MOST_DEVICES {
            let more = self.devices.len() - MOST_DEVICES;
            writeln!(out, " …  and {more} more; --json lists them all")?;
        }
        Ok(())
    }

    fn write_figures(&self, out: &mut String) -> fmt::Result {
        writeln!(out)?;
        let (counted, punctual) = (&self.main_device, &self.punctuality);
        let mut line = |what: &str, figure: String, from: &str| {
            writeln!(out, " {what:<36} {figure} {QUIET}[{from}]{QUIET:#}")
        };
        let frames = counted.bring_up_frames;
        line(
            "frames for bring-up",
            format!("{frames}, of these {} for the clocks", counted.drift_frames),
            "m",
        )?;
        if let Some(difference) = counted.difference_at_lock {
            line("0x092C when clocks locked", difference.words(), "r")?;
        }
        line(
            "frames sent, lost",
            format!("{}, {}", counted.frames_sent, counted.frames_lost),
            "m",
        )?;
        if let Some(late) = &self.machine.wake_up_lateness {
            line("wake-ups late, before the run", quantiles(late), "m")?;
        }
        if let Some(late) = &punctual.send_lateness {
            line("frames late, in operation", distribution(late), "m")?;
            let (beyond, all) = (punctual.beyond_jitter, late.span.count);
            let jitter = Nanos(punctual.jitter_ns);
            line("later than the plan keeps free", format!("{beyond} of {all}: {jitter}"), "m")?;
        }
        if let Some(trip) = &punctual.round_trip {
            line("round trip", distribution(trip), "m")?;
        }
        if self.judged_ns > 0 {
            let (skipped, lost) = (punctual.cycles_skipped, punctual.frames_lost);
            line("cycles skipped, frames lost", format!("{skipped}, {lost}"), "m")?;
            line("working counters wrong", punctual.working_counter_errors.to_string(), "m")?;
            line("frames foreign or too late", punctual.frames_foreign.to_string(), "m")?;
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
        let Some(plan) = &self.plan else { return Ok(()) };
        if let Some(phase) = plan.sync0_phase_ns {
            let (phase, send) = (Nanos(phase), Nanos(plan.send_phase_ns));
            line("plan", format!("SYNC0 at {phase} of the cycle, frame at {send}"), "p")?;
        }
        let tightest = self
            .devices
            .iter()
            .filter(|device| device.mode != SyncMode::FreeRun)
            .flat_map(|device| device.plan.iter().map(move |line| (device, line)))
            .min_by_key(|(_, line)| line.slack_ns);
        if let Some((device, tight)) = tightest {
            let slack = Nanos(tight.slack_ns);
            let text = format!("{slack}: {} of SubDevice {}", tight.object, device.position);
            line("tightest line of the budget", text, "p")?;
        }
        Ok(())
    }

    fn write_notes(&self, out: &mut String) -> fmt::Result {
        let mut notes = self.notes.clone();
        notes.extend(self.services.iter().take(MOST_DEVICES).map(|note| note.what.clone()));
        notes.extend(self.machine.refused.iter().cloned());
        if self.machine.harms.len() == 1 {
            notes.push("1 setting of this machine harms punctuality; --preflight tells it".into());
        } else if !self.machine.harms.is_empty() {
            let count = self.machine.harms.len();
            notes.push(format!(
                "{count} settings of this machine harm punctuality; --preflight tells them"
            ));
        }
        for device in self.devices.iter().take(MOST_DEVICES) {
            let position = device.position;
            for text in [&device.mode_reason, &device.application] {
                if !text.is_empty() {
                    notes.push(format!("SubDevice {position}: {text}"));
                }
            }
            notes.extend(device.registers.unknown_delay(position));
            let measured = device.registers.measured_times;
            notes.extend(measured.map(|times| times.note(position)));
        }
        writeln!(out)?;
        write_notes(out, &notes)?;
        writeln!(
            out,
            "\n {QUIET}0x1C32: 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error\n \
             0x092C: distance of the clock from the reference at the end\n \
             [r] read from the device  [m] MainDevice's clock and counts  [p] plan{QUIET:#}"
        )
    }
}

impl Machine {
    /// The check of the machine as text, with ANSI styles; `cycle` is that of the wake-ups.
    pub fn text(&self, cycle: Nanos) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text, cycle);
        text
    }

    fn write(&self, out: &mut String, cycle: Nanos) -> fmt::Result {
        match self.harms.len() + self.refused.len() {
            0 => writeln!(out, "{GOOD}Nothing that harms a real-time loop was found.{GOOD:#}")?,
            1 => writeln!(out, "{BAD}1 thing harms a real-time loop on this machine:{BAD:#}")?,
            n => writeln!(out, "{BAD}{n} things harm a real-time loop on this machine:{BAD:#}")?,
        }
        writeln!(out)?;
        for Harm { what, source, advice } in &self.harms {
            write_notes(out, std::slice::from_ref(what))?;
            writeln!(out, "     {QUIET}read from{QUIET:#} {source}")?;
            writeln!(out, "     {QUIET}to do{QUIET:#}     {advice}")?;
        }
        write_notes(out, &self.refused)?;
        if self.harms_punctuality() {
            writeln!(out)?;
        }
        if !self.granted.is_empty() {
            let granted = format!("granted: {}", self.granted.join(", "));
            write_notes(out, &[granted])?;
        }
        if let Some(lateness) = &self.wake_up_lateness {
            let (count, figures) = (lateness.span.count, quantiles(lateness));
            let text =
                format!("measured: {count} wake-ups in a cycle of {cycle}, late by {figures}");
            write_notes(out, &[text])?;
        }
        Ok(())
    }
}

/// A span to three or four digits.
fn show(ns: f64) -> String {
    match ns.abs() {
        size if size < 1e3 => format!("{ns:.0} ns"),
        size if size < 1e6 => format!("{:.1} us", ns / 1e3),
        _ => format!("{:.2} ms", ns / 1e6),
    }
}

/// Median, 99 % quantile and maximum of a series.
fn quantiles(series: &Series) -> String {
    let Series { span, p50_ns, p99_ns, .. } = series;
    let (half, most) = (show(*p50_ns as f64), show(*p99_ns as f64));
    format!("p50 {half}, p99 {most}, max {}", show(span.max_ns))
}

/// Mean, deviation and worst value of a series.
fn distribution(series: &Series) -> String {
    let Series { span, p99_ns, .. } = series;
    format!(
        "mean {}, sd {}, p99 {}, max {}",
        show(span.mean_ns),
        show(span.standard_deviation_ns),
        show(*p99_ns as f64),
        show(span.max_ns)
    )
}
