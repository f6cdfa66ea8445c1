//! The cases in words; SubDevices with the same outcome are grouped.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut, wrap};
use isocat_descriptions::quantity::time;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatusCode};

use super::report::{Case, Clocks, Fate, Gone, NotBack, Outcome, WhatIf};
use crate::report::{BAD, GOOD};

/// The outcome for some SubDevices of a case.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Row {
    /// Their positions, such as `0..3, 5`.
    pub devices: String,
    /// The outcome.
    pub what: String,
    /// When they are in sync again.
    pub again: String,
    /// Whether they are not in sync again by themselves.
    pub stay_out: bool,
}

const GOES: usize = 24;
const DEVICES: usize = 9;
const WHAT: usize = 44;

impl WhatIf {
    /// The fault as text, such as `cable to 1 (axis 1)`.
    pub fn goes(&self, case: &Case) -> String {
        let what = match case.what {
            Gone::Cable => "cable to",
            Gone::Power => "power of",
        };
        let name = self.names.get(case.device).map_or("", String::as_str);
        format!("{what} {} ({name})", case.device)
    }

    /// The settings in one line.
    pub fn head(&self) -> String {
        let (gone, before, seed) = (Nanos(self.gone_ns), Nanos(self.before_ns), self.seed);
        format!(
            "gone for {gone}, {before} in operation; one run each, seed {seed}; times are measured in true time"
        )
    }

    /// The outcomes for the SubDevices of a case: one row for those with the same outcome.
    pub fn rows(&self, case: &Case) -> Vec<Row> {
        let mut alike: Vec<Vec<&Fate>> = Vec::new();
        for fate in &case.devices {
            match alike.iter_mut().find(|group| is_like(group[0], fate)) {
                Some(group) => group.push(fate),
                None => alike.push(vec![fate]),
            }
        }
        alike.iter().map(|group| row(group)).collect()
    }

    /// The effect on the clock that leads, if there is one.
    pub fn clocks(&self, case: &Case) -> Option<String> {
        let reference = self.reference?;
        match case.clocks {
            Clocks::None | Clocks::Lead => None,
            Clocks::TakenOver => {
                let leads = case.leads.map_or_else(String::new, |at| at.to_string());
                Some(format!("the reference clock is {reference}: {leads} leads in its place"))
            }
            Clocks::Lost => {
                Some(format!("the reference clock is {reference}: no clock leads in its place"))
            }
        }
    }

    /// Notes that explain the table.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![
            "in sync again: from when the cable or the power is back until they are in OP and without a sign of \
             the contrary"
                .to_owned(),
        ];
        let fates = || self.cases.iter().flat_map(|case| &case.devices);
        let mut codes: Vec<AlStatusCode> =
            fates().filter_map(|fate| fate.code.map(AlStatusCode)).collect();
        codes.sort_by_key(|code| code.0);
        codes.dedup();
        notes.extend(codes.iter().map(|code| format!("AL status code {code}")));
        if fates().any(|fate| fate.not_back == Some(NotBack::RecoveryOff)) {
            notes.push(
                "recovery is off: those that answer and have left OP stay where they are; the key recovery = \
                 { first = \"1s\", longest = \"30s\" } of the segment file brings them back"
                    .to_owned(),
            );
        }
        notes
    }

    /// The table as text, with ANSI styles.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    pub(in crate::plan) fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "\nWhat if")?;
        for line in wrap(&self.head(), WIDTH - 2) {
            writeln!(out, "  {line}")?;
        }
        if let Some(failure) = &self.failure {
            for line in wrap(failure, WIDTH - 2) {
                writeln!(out, "  {BAD}{line}{BAD:#}")?;
            }
            return Ok(());
        }
        writeln!(
            out,
            "\n {:<GOES$} {:<DEVICES$} {:<WHAT$} in sync again",
            "goes", "devices", "what becomes of them"
        )?;
        for case in &self.cases {
            self.write_case(out, case)?;
        }
        writeln!(out)?;
        for note in self.notes() {
            for (at, line) in wrap(&note, WIDTH - 4).iter().enumerate() {
                writeln!(out, "{} {line}", if at == 0 { "  -" } else { "   " })?;
            }
        }
        Ok(())
    }

    fn write_case(&self, out: &mut String, case: &Case) -> fmt::Result {
        let mut goes = cut(&self.goes(case), GOES);
        for row in self.rows(case) {
            let style = if row.stay_out { BAD } else { GOOD };
            let again = wrap(&row.again, WIDTH - GOES - DEVICES - WHAT - 4);
            let (devices, what) = (wrap(&row.devices, DEVICES), wrap(&row.what, WHAT));
            for line in 0..devices.len().max(what.len()).max(again.len()) {
                let of = |lines: &[String]| lines.get(line).cloned().unwrap_or_default();
                let (devices, what, again) = (of(&devices), of(&what), of(&again));
                let text = format!(" {goes:<GOES$} {devices:<DEVICES$} {what:<WHAT$} ");
                match again.is_empty() {
                    true => writeln!(out, "{}", text.trim_end())?,
                    false => writeln!(out, "{text}{style}{again}{style:#}")?,
                }
                goes.clear();
            }
        }
        for line in self.clocks(case).iter().flat_map(|text| wrap(text, WIDTH - GOES - 2)) {
            writeln!(out, " {:<GOES$} {line}", "")?;
        }
        Ok(())
    }
}

/// Whether both have the same outcome, whatever their figures.
fn is_like(one: &Fate, other: &Fate) -> bool {
    let has_sync0 = |fate: &Fate| fate.outcome == Outcome::InSync && fate.sync0_worst_ns.is_some();
    let key = |fate: &Fate| {
        (fate.outcome, fate.state, fate.code, fate.outputs, fate.made_safe, has_sync0(fate))
    };
    key(one) == key(other) && (one.not_back, &one.why) == (other.not_back, &other.why)
}

fn row(group: &[&Fate]) -> Row {
    let first = group[0];
    let sync0 = group.iter().filter_map(|fate| fate.sync0_worst_ns).reduce(f64::max);
    let held = group.iter().filter_map(|fate| fate.held_ns).max();
    let after = round(group.iter().filter_map(|fate| fate.after_ns).max().unwrap_or(0));
    let sync0 = sync0.map(|worst| format!(", SYNC0 within {}", round(worst as i64)));
    let held = held.map_or(String::new(), round);
    let outputs = first.outputs;
    let what = match first.outcome {
        Outcome::InSync => format!("in sync{}", sync0.unwrap_or_default()),
        Outcome::Idle => "in OP, has no process data".to_owned(),
        Outcome::OutOfSync => {
            format!("in OP, not in sync from {after} on{}", sync0.unwrap_or_default())
        }
        Outcome::CutOff if outputs => {
            let safe = if first.made_safe { ", then safe" } else { "" };
            format!("stays in OP without frames; outputs held for {held}{safe}")
        }
        Outcome::CutOff => "stays in OP without frames".to_owned(),
        Outcome::LeftOp => {
            let (state, code) = (first.state.unwrap_or(AlState::SafeOp), first.code.unwrap_or(0));
            let safe = if outputs {
                format!("; outputs held for {held}, then safe")
            } else {
                String::new()
            };
            format!("{state}, 0x{code:04X}, after {after}{safe}")
        }
        Outcome::WithoutPower => "without power".to_owned(),
        Outcome::NotBefore => "was not in sync before".to_owned(),
        Outcome::Absent => "was not there".to_owned(),
    };
    let slowest = group.iter().filter_map(|fate| fate.in_sync_ns).max().unwrap_or(0);
    let again = match first.not_back {
        None if first.outcome.is_calm() => String::new(),
        None => format!("after {}", round(slowest)),
        Some(NotBack::RecoveryOff) => "no: recovery is off".to_owned(),
        Some(NotBack::Refused) => format!("no: {}", first.why.as_deref().unwrap_or_default()),
        Some(NotBack::NotFound) => "no: not taken up again".to_owned(),
        Some(NotBack::StillOut) => "no: signs up to the end".to_owned(),
    };
    let stay_out = first.not_back.is_some();
    Row { devices: positions(group), what, again, stay_out }
}

/// Positions as text, such as `0..3, 5`.
fn positions(group: &[&Fate]) -> String {
    let mut spans: Vec<(usize, usize)> = Vec::new();
    for fate in group {
        match spans.last_mut() {
            Some((_, last)) if *last + 1 == fate.position => *last = fate.position,
            _ => spans.push((fate.position, fate.position)),
        }
    }
    let words = spans.iter().map(|(first, last)| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first}..{last}"),
    });
    words.collect::<Vec<_>>().join(", ")
}

/// A time rounded to three digits: more would depend on the seed.
fn round(ns: i64) -> String {
    let mut step = 1;
    while ns / step >= 1_000 {
        step *= 10;
    }
    time(((ns + step / 2) / step * step) as f64)
}
