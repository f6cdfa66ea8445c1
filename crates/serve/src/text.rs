//! The summary for users, within a hundred columns.

use std::fmt::{self, Write};

use anstyle::{AnsiColor, Style};
use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_engine::report::age::{self, DataAge};
use isocat_engine::report::words::time;
use isocat_engine::report::write_expected;
use isocat_wire::time::{Nanos, Picos};

use super::summary::{ClaimsSummary, Cycle, JudgedSummary, SessionSummary, Summary};

const GOOD: Style = AnsiColor::Green.on_default().bold();
const BAD: Style = AnsiColor::Red.on_default().bold();
const QUIET: Style = Style::new().dimmed();

/// Number of list entries that are printed before the rest is only counted.
const MOST: usize = 40;

impl Summary {
    /// The summary as text with ANSI styles. Print it through a stream that strips them where they
    /// are not wanted.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let sessions = match self.sessions.len() as u64 + self.sessions_left_out {
            0 => "no frame was received".to_owned(),
            1 => "1 session".to_owned(),
            count => format!("{count} sessions"),
        };
        writeln!(
            out,
            "Served {} on {} for {}: {sessions}.",
            self.segment_file,
            self.interface,
            ns(self.served_ns)
        )?;
        let (frames, answered, lost) = (self.frames, self.answered, self.lost);
        write!(out, "{QUIET}{frames} frames, {answered} answered, {lost} lost")?;
        match self.held {
            0 => {}
            held => write!(out, ", {held} held back since they came faster than 100 Mbit/s")?,
        }
        writeln!(out, "{QUIET:#}")?;
        let expected = self.expected.iter().map(|one| (one.met, &*one.what, &*one.found));
        write_expected(out, &expected.collect::<Vec<_>>())?;
        if !self.faults.is_empty() {
            writeln!(out, "\n faults that were asked for")?;
            for fault in self.faults.iter().take(MOST) {
                writeln!(out, "  {:>12}  {}", ns(fault.at_ns), fault.what)?;
            }
        }
        if self.sessions_left_out > 0 {
            writeln!(
                out,
                "\n {} sessions before session {} are only counted",
                self.sessions_left_out,
                self.sessions_left_out + 1
            )?;
        }
        for (number, session) in (self.sessions_left_out + 1..).zip(&self.sessions) {
            session.write(out, number)?;
        }
        if self.sessions.iter().any(|session| session.judged.is_some()) {
            writeln!(
                out,
                "\n{QUIET} 0x1C32: 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error\n \
                 SYNC0 error: against the grid that the MainDevice wrote, in true time of the segment{QUIET:#}"
            )?;
        }
        Ok(())
    }
}

impl SessionSummary {
    fn write(&self, out: &mut String, number: u64) -> fmt::Result {
        let from = self.sources.first().map_or("?", String::as_str);
        write!(
            out,
            "\nSession {number}: MainDevice {from}, {} to {}, {} frames",
            ns(self.began_ns),
            ns(self.ended_ns),
            self.frames
        )?;
        match self.second_port_frames {
            0 => writeln!(out)?,
            more => writeln!(out, ", {more} more at its second port")?,
        }
        match &self.judged {
            None => {
                let mut reasons = self.not_judged.iter();
                let head = reasons.next().map_or("", String::as_str);
                for line in wrap(&format!("Not known: {head}"), WIDTH - 2) {
                    writeln!(out, " {BAD}{line}{BAD:#}")?;
                }
                for what in reasons.take(MOST) {
                    for (i, line) in wrap(what, WIDTH - 4).iter().enumerate() {
                        writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
                    }
                }
            }
            Some(judged) => judged.write_verdict(out)?,
        }
        writeln!(out, "\n what it did, in order, and how often")?;
        for step in &self.steps {
            writeln!(out, "  {:>12}  {} ({})", ns(step.after_ns), step.what, step.count)?;
        }
        if !self.refused.is_empty() {
            writeln!(out, "\n SubDevices that refused or fell")?;
            for refused in self.refused.iter().take(MOST) {
                writeln!(
                    out,
                    "  {:>12}  SubDevice {} ({}): {}, {}",
                    ns(refused.after_ns),
                    refused.position,
                    refused.device,
                    refused.state,
                    refused.meaning
                )?;
            }
        }
        if let Some(cycle) = &self.cycle {
            cycle.write(out)?;
        }
        if let Some(judged) = &self.judged {
            judged.write_devices(out)?;
        }
        writeln!(out, "\n what it left out, or did badly")?;
        if self.remarks.is_empty() {
            writeln!(out, "  nothing that this segment could see")?;
        }
        for remark in &self.remarks {
            for (i, line) in wrap(remark, WIDTH - 4).iter().enumerate() {
                writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
            }
        }
        Ok(())
    }
}

impl Cycle {
    fn write(&self, out: &mut String) -> fmt::Result {
        let i = &self.interval;
        writeln!(
            out,
            "\n its cycle, by the kernel's stamps: {} cycles, mean {}, {} to {}, sd {}",
            i.count,
            us(i.mean_ns),
            us(i.min_ns),
            us(i.max_ns),
            us(i.standard_deviation_ns)
        )?;
        if let Some(phase) = &self.phase {
            writeln!(
                out,
                " its phase at the reference clock, against its first: mean {}, {} to {}, sd {}",
                us(phase.mean_ns),
                us(phase.min_ns),
                us(phase.max_ns),
                us(phase.standard_deviation_ns)
            )?;
        }
        writeln!(
            out,
            " drift datagrams in operation: {}, at most {} apart",
            self.drift_datagrams,
            ns(self.longest_drift_gap_ns)
        )
    }
}

impl JudgedSummary {
    fn write_verdict(&self, out: &mut String) -> fmt::Result {
        let (all, judged) = (self.devices.len(), ns(self.judged_ns));
        let in_op = self.in_op;
        if self.in_sync {
            writeln!(
                out,
                " {GOOD}In sync: {in_op} of {all} SubDevices in OP, judged for {judged}.{GOOD:#}"
            )?;
            return self.write_claims(out);
        }
        let devices = self.devices.iter().flat_map(|device| {
            let name = format!("SubDevice {} ({}): ", device.position, device.name);
            device.findings.iter().map(move |what| format!("{name}{what}"))
        });
        let findings: Vec<_> = self.findings.iter().cloned().chain(devices).collect();
        let Some((first, others)) = findings.split_first() else {
            writeln!(
                out,
                " {BAD}Not in sync throughout: operation was interrupted; the last {judged} were in sync.{BAD:#}"
            )?;
            return self.write_earlier(out);
        };
        let head = format!("Not in sync: {first}");
        for line in wrap(&head, WIDTH - 2) {
            writeln!(out, " {BAD}{line}{BAD:#}")?;
        }
        for what in others.iter().take(MOST) {
            for (i, line) in wrap(what, WIDTH - 4).iter().enumerate() {
                writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
            }
        }
        if others.len() > MOST {
            writeln!(out, "  - and {} more; --json lists them all", others.len() - MOST)?;
        }
        writeln!(out, " {in_op} of {all} SubDevices in OP, judged for {judged}")?;
        self.write_claims(out)?;
        self.write_earlier(out)
    }

    /// What the verdict is made of, beside what the judges measure in true time.
    fn write_claims(&self, out: &mut String) -> fmt::Result {
        let ClaimsSummary { checked, not_checked } = &self.claims;
        write!(out, " {QUIET}{checked} claims about the segment were checked")?;
        match not_checked.len() {
            0 => writeln!(out, "{QUIET:#}"),
            more => writeln!(out, ", {more} could not be (--json lists them){QUIET:#}"),
        }
    }

    fn write_earlier(&self, out: &mut String) -> fmt::Result {
        let bad: Vec<_> =
            self.earlier.iter().filter(|stretch| !stretch.findings.is_empty()).collect();
        if self.earlier.is_empty() {
            return Ok(());
        }
        writeln!(
            out,
            " before that, {} stretches of operation, {} of them not in sync",
            self.earlier.len(),
            bad.len()
        )?;
        for stretch in bad.iter().take(MOST / 8) {
            let what = format!("{}: {}", ns(stretch.judged_ns), stretch.findings.join("; "));
            for (i, line) in wrap(&what, WIDTH - 4).iter().enumerate() {
                writeln!(out, "{} {line}", if i == 0 { "  -" } else { "   " })?;
            }
        }
        Ok(())
    }

    fn write_devices(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n {:<3} {:<20} {:<9} {:<7} {:^26} {:>12}  0x1C32",
            "#", "device", "mode", "state", "SYNC0 error, ns", "margin"
        )?;
        writeln!(
            out,
            " {:<3} {:<20} {:<9} {:<7} {:>8} {:>8} {:>8} {:>12}  0B 0C 0D 20",
            "", "", "", "", "mean", "sd", "worst", "worst"
        )?;
        for device in self.devices.iter().take(MOST) {
            let error = device.sync0_error;
            let figure =
                |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.1}"));
            let margin = device.sync0_margin.map_or("-".to_owned(), |margin| us(margin.min_ns));
            writeln!(
                out,
                " {:<3} {:<20.20} {:<9} {:<7} {:>8} {:>8} {:>8} {:>12}  {:>2} {:>2} {:>2} {:>2}",
                device.position,
                device.name,
                device.mode,
                device.state,
                figure(error.map(|error| error.mean_ns)),
                figure(error.map(|error| error.standard_deviation_ns)),
                figure(error.map(|error| error.worst_ns)),
                margin,
                device.sm_event_missed,
                device.cycle_time_too_small,
                device.shift_time_too_short,
                device.sync_error
            )?;
        }
        if self.devices.len() > MOST {
            writeln!(out, " and {} more; --json lists them all", self.devices.len() - MOST)?;
        }
        let ages = self.devices.iter().map(|device| DataAge {
            devices: vec![(device.position, device.name.as_str())],
            outputs: device.outputs_age,
            inputs: device.inputs_age,
        });
        age::write(out, &ages.collect::<Vec<_>>(), "")
    }
}

/// A figure in ns, in the most readable unit.
fn us(ns: f64) -> String {
    time(Picos((ns * 1000.0) as i64))
}

fn ns(ns: i64) -> String {
    time(Nanos(ns).into())
}
