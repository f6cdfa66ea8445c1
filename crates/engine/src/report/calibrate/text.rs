//! A calibration for people.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, wrap};

use super::{
    CalibrationReport, ClockKind, Device, Figure, Fit, Law, LawVerdict, Spread, StateChange,
};
use crate::report::{BAD, GOOD, QUIET};

impl CalibrationReport {
    /// The report as text, with ANSI styles.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let style = if self.complete { GOOD } else { BAD };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        writeln!(
            out,
            "{QUIET}{}: reference is position {}, {} drift frames in {} courses, {} lost{QUIET:#}",
            self.place, self.reference, self.drift_frames, self.courses, self.drift_frames_lost
        )?;
        writeln!(
            out,
            "{QUIET}drift frames that were to come each 1 ms came after {} to {} ms{QUIET:#}",
            millis(self.paced[0]),
            millis(self.paced[1])
        )?;
        if self.left_changed.is_empty() {
            writeln!(out, "Offsets, delays, filters and states are as they were found.")?;
        }
        for left in &self.left_changed {
            writeln!(out, "{BAD}Not put back:{BAD:#} {left}")?;
        }
        self.devices.iter().try_for_each(|device| write_device(out, device))?;
        writeln!(
            out,
            "\n{QUIET}Errors are standard errors. --json says of each figure what it was measured from.{QUIET:#}"
        )
    }
}

fn write_device(out: &mut String, device: &Device) -> fmt::Result {
    let kind = match device.clock {
        ClockKind::Reference => "reference clock: the others are measured against it",
        ClockKind::Follower => "clock",
        ClockKind::ReceiveTimes => "receive times without a system clock: no law to be measured",
        ClockKind::None => "no distributed clocks: left out",
    };
    writeln!(out, "\nPosition {}, ESC type 0x{:02X}, {kind}", device.position, device.esc_type)?;
    if let Some(crystal) = &device.crystal_ppb {
        line(out, "crystal", &format!("{} ppb faster than the reference", figure(crystal)))?;
    }
    if let Some(change) = &device.crystal_change_ppb {
        line(out, "", &format!("{} ppb change until the end", figure(change)))?;
    }
    if device.clock == ClockKind::Follower {
        let sign = device.difference_polarity.unwrap_or("not told: no answer of the right size");
        line(out, "sign of 0x092C", sign)?;
    }
    if let Some(law) = &device.law {
        write_law(out, law)?;
    }
    if let Some(deviation) = device.latch_deviation {
        let text = format!("{deviation:.1} ns standard deviation (ticks alone: 4.1 ns at most)");
        line(out, "latch of 0x0918", &text)?;
    }
    if let Some(jitter) = &device.jitter {
        let text = match &jitter.deviation {
            Some(deviation) => {
                let port = jitter.port;
                format!(
                    "sd {} ns behind a port of kind {port}, {} latches",
                    figure(deviation),
                    jitter.latches
                )
            }
            None => "not told: the crystals are too much alike to show it".to_owned(),
        };
        line(out, &format!("jitter from {}", jitter.above), &text)?;
    }
    if let Some(hop) = &device.hop {
        line(out, "round trip", &spread(&hop.round_trip, "ns", 1.0))?;
        if let (Some(above), Some(one_way)) = (hop.above, &hop.one_way) {
            line(out, &format!("hop from {above}"), &spread(one_way, "ns", 1.0))?;
        }
        let text = hop.t_diff.as_ref().map_or_else(
            || "not told: nothing behind it, or no receive times above".to_owned(),
            |t_diff| format!("{} ns", figure(t_diff)),
        );
        line(out, "tDiff", &text)?;
    }
    let eeprom = device.eeprom_read.as_ref();
    let text = eeprom.map_or("failed".to_owned(), |read| spread(read, "us", 1e3));
    line(out, "EEPROM read", &text)?;
    for (name, change) in [("INIT to PREOP", &device.to_preop), ("PREOP to INIT", &device.to_init)]
    {
        line(out, name, &state(change.as_ref()))?;
    }
    Ok(())
}

fn write_law(out: &mut String, law: &Law) -> fmt::Result {
    let named = |fit: &Fit| format!("{} {}", fit.name, fit.parameter);
    let text = match law.verdict {
        LawVerdict::Told => law.fits.first().map_or_else(String::new, named),
        LawVerdict::NotToldApart => {
            let names: Vec<String> =
                law.fits.iter().filter(|fit| fit.admissible).map(named).collect();
            format!("not told apart: {}", names.join(", "))
        }
        LawVerdict::NoneFits => "none of the known laws fits".to_owned(),
    };
    line(out, "drift law", &text)?;
    for fit in &law.fits {
        let mut text = format!("{:<16} misfit {:.2} sd", named(fit), fit.misfit);
        if let Some(measured) = fit.measured.as_ref().filter(|_| fit.admissible) {
            let name = if fit.name == "proportional" { "gain" } else { "phase" };
            write!(text, ", {name} {}", figure(measured))?;
        }
        line(out, "", &text)?;
    }
    Ok(())
}

fn line(out: &mut String, name: &str, text: &str) -> fmt::Result {
    writeln!(out, "  {name:<16} {text}")
}

fn figure(figure: &Figure) -> String {
    format!("{:.3} +-{:.3}", figure.value, figure.error)
}

fn spread(spread: &Spread, unit: &str, one: f64) -> String {
    format!(
        "{:.1} +-{:.1} {unit}, sd {:.1}, {:.1} to {:.1}, {} readings",
        spread.mean / one,
        spread.error / one,
        spread.deviation / one,
        spread.least / one,
        spread.most / one,
        spread.count
    )
}

fn state(change: Option<&StateChange>) -> String {
    match change {
        None => "not tried".to_owned(),
        Some(StateChange { took: Some(took), .. }) => {
            format!("{:.0} us, up to {:.0} us less", took.mean / 1e3, took.error / 1e3)
        }
        Some(StateChange { refused: Some(code), .. }) => {
            format!("refused, AL status code 0x{code:04X}")
        }
        Some(_) => "did not come within 3 s".to_owned(),
    }
}

fn millis(ns: i64) -> String {
    format!("{:.3}", ns as f64 / 1e6)
}
