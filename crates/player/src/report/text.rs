//! The document as text.

use std::fmt::Write as _;

use isocat_wire::time::Nanos;

use super::{Report, RunReport};
use crate::differences::Difference;

impl Report {
    /// The document as text for a terminal.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let (count, cycle) = (self.devices.len(), Nanos(self.cycle_ns));
        let devices = if count == 1 { "SubDevice" } else { "SubDevices" };
        if let Some(run) = &self.run {
            writeln!(out, "{}", run.headline())?;
        }
        writeln!(out, "{}: {count} {devices}, cycle {cycle}", self.eni)?;
        let on_wire = self.run.as_ref().is_some_and(|run| run.verdict().is_some());
        let title = match on_wire {
            true => "where the plan has the times of the devices from",
            false => "what the virtual devices are made of",
        };
        writeln!(out, "\n {title}")?;
        for device in &self.devices {
            writeln!(out, "  {:>3} {}: {}", device.position, device.name, device.origin)?;
        }
        if !self.doubts.is_empty() {
            writeln!(out, "\n doubts about the file")?;
        }
        for doubt in &self.doubts {
            writeln!(out, "  - line {}: {}: {}", doubt.line, doubt.kind, doubt.message)?;
        }
        self.write_differences(out)?;
        match &self.run {
            Some(run) => run.write(out),
            None => Ok(()),
        }
    }

    fn write_differences(&self, out: &mut String) -> std::fmt::Result {
        if let Some(why) = &self.not_planned {
            return writeln!(out, "\n no plan to compare with: {why}");
        }
        if self.differences.is_empty() {
            return writeln!(out, "\n no differences from what our plan would write");
        }
        writeln!(
            out,
            "\n differences from what our plan would write ({})",
            self.differences.len()
        )?;
        let of = |position: Option<usize>| {
            self.differences.iter().filter(move |one| one.position == position)
        };
        write_all(out, "segment", of(None))?;
        for device in &self.devices {
            let title = format!("SubDevice {} ({})", device.position, device.name);
            write_all(out, &title, of(Some(device.position)))?;
        }
        Ok(())
    }
}

fn write_all<'a>(
    out: &mut String,
    title: &str,
    differences: impl Iterator<Item = &'a Difference>,
) -> std::fmt::Result {
    let mut differences = differences.peekable();
    if differences.peek().is_some() {
        writeln!(out, "  {title}")?;
    }
    for difference in differences {
        writeln!(out, "   - {difference}")?;
    }
    Ok(())
}

impl RunReport {
    /// The sentence of the verdict engine; `None` on a virtual segment.
    fn verdict(&self) -> Option<&str> {
        #[cfg(target_os = "linux")]
        return self.interface.as_ref().map(|interface| interface.verdict.as_str());
        #[cfg(not(target_os = "linux"))]
        None
    }

    fn headline(&self) -> String {
        match &self.failure {
            _ if self.in_sync => "In sync: the ENI was executed to the letter.".into(),
            Some(failure) if failure.refused => format!("Not run: {}", failure.message),
            Some(failure) => format!("Not in sync: {}", failure.message),
            None if self.verdict().is_some() => self.verdict().unwrap_or_default().to_owned(),
            None if self.wrong_counters > 0 => format!(
                "Not in sync: {} of the datagrams in {} cycles did not count as the ENI expects",
                self.wrong_counters, self.cycles
            ),
            None => "Not in sync: see what the judges say below.".into(),
        }
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "\n {} commands of the ENI done; {} cycles in OP, {} frames lost, {} wrong working counters",
            self.commands, self.cycles, self.lost_frames, self.wrong_counters
        )?;
        for one in &self.unknown_objects {
            writeln!(
                out,
                "  - {} of SubDevice {} was not written: its description does not have the object",
                one.object, one.position
            )?;
        }
        if self.clocks.iter().any(Option::is_some) {
            writeln!(out, "\n what the run filled in")?;
        }
        for (position, clock) in self.clocks.iter().enumerate() {
            let Some(clock) = clock else { continue };
            let delay = match clock.is_delay_known {
                true => Nanos(clock.delay_ns).to_string(),
                false => "not known".into(),
            };
            write!(out, "  {position:>3} delay {delay}")?;
            if let Some(start) = clock.start_ns {
                write!(out, ", first pulse at {start} ns")?;
            }
            if !clock.has_converged {
                write!(out, ", not converged: 0x092C shows {}", Nanos(clock.difference_ns))?;
            }
            writeln!(out)?;
        }
        if let Some(summary) = &self.summary {
            write!(out, "\n{}", summary.text())?;
        }
        #[cfg(target_os = "linux")]
        if let Some(interface) = &self.interface {
            write!(out, "\n{}", interface.text())?;
        }
        Ok(())
    }
}
