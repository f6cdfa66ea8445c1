//! The mutants by what they did and by what each door said of them.

use std::collections::BTreeMap;
use std::fmt::Write;

use isocat_diagnose::DiagnoseReport;
use isocat_diagnose::report::WeightKind;
use serde::Serialize;
use serde_json::{Value, json};

use super::code;
use super::effect::Effect;
use super::mutant::Mutant;
use crate::cli::virtual_time::outcome::PROGRAM_FAILED;
use crate::cli::{IN_SYNC, NOT_IN_SYNC};

/// What a door said.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Door {
    /// Exit code 0.
    Green,
    /// Exit code 1.
    Red,
    /// Not known.
    Open,
    /// The program itself gave up, or ended with another code than 0.
    Program,
}

/// Kind and SubDevice of a finding.
type First = (String, Option<usize>);
/// What a door said of a mutant, and its first finding.
type Said = fn(&Row) -> (Door, Option<&First>);

/// One mutant.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Row {
    pub number: usize,
    /// The mutant in words.
    pub mutant: String,
    /// The SubDevices that it concerns: the one that the datagram was for, and the one that it came
    /// to; empty: the segment.
    pub positions: Vec<usize>,
    /// What it did: a word, and the position of the SubDevice.
    pub effects: Vec<Effect>,
    /// Whether a distance of SYNC0 is so near to its limit that the mutant counts for no door.
    pub at_the_edge: bool,
    #[serde(rename = "virtual")]
    pub virtual_door: Door,
    pub diagnose: Door,
    /// Whether the program itself ended with an error.
    pub program: bool,
    /// Kind and SubDevice of the first finding of each door.
    pub virtual_first: Option<First>,
    pub diagnose_first: Option<First>,
}

impl Row {
    pub fn new(
        number: usize,
        mutant: &Mutant,
        position: Option<usize>,
        (effects, at_the_edge): (Vec<Effect>, bool),
        exit: u8,
        report: &Value,
        diagnosis: Option<&DiagnoseReport>,
    ) -> Self {
        Self {
            number,
            mutant: mutant.to_string(),
            positions: mutant.positions(position),
            effects,
            at_the_edge,
            virtual_door: door(exit),
            diagnose: diagnosis.map_or(Door::Open, |report| door(code(report.verdict.kind))),
            program: report["program"]["code"].as_i64() != Some(0),
            virtual_first: first_finding(report),
            diagnose_first: diagnosis.and_then(first_fault),
        }
    }

    pub fn has_effect(&self) -> bool {
        !self.effects.is_empty() && !self.at_the_edge
    }

    fn has_none(&self) -> bool {
        self.effects.is_empty() && !self.at_the_edge
    }

    /// Whether a finding names the SubDevice that the mutant concerns, or one that it harmed, or
    /// the segment.
    fn is_right_place(&self, first: Option<&First>) -> Option<bool> {
        let (_, found) = first?;
        let harmed = |found: usize| self.effects.iter().any(|(_, harmed)| *harmed == Some(found));
        let meant = |found| self.positions.is_empty() || self.positions.contains(&found);
        Some(found.is_none_or(|found| meant(found) || harmed(found)))
    }
}

fn door(exit: u8) -> Door {
    match exit {
        IN_SYNC => Door::Green,
        NOT_IN_SYNC => Door::Red,
        PROGRAM_FAILED => Door::Program,
        _ => Door::Open,
    }
}

fn first_finding(report: &Value) -> Option<First> {
    let sessions = report["sessions"].as_array()?;
    let judged =
        sessions.iter().rev().map(|session| &session["judged"]).find(|one| !one.is_null())?;
    let kind = |of: &Value| of["kinds"][0]["kind"].as_str().map(str::to_owned);
    let devices = judged["devices"].as_array()?.iter().enumerate();
    let of_device = |(at, device): (usize, &Value)| Some((kind(device)?, Some(at)));
    kind(judged).map(|kind| (kind, None)).or_else(|| devices.filter_map(of_device).next())
}

fn first_fault(report: &DiagnoseReport) -> Option<First> {
    let first = report.findings.iter().find(|finding| finding.weight == WeightKind::Fault)?;
    let device = first.device.and_then(|at| report.devices.get(at)?.position);
    Some((first.kind.to_owned(), device.map(usize::from)))
}

/// Numbers of mutants at a door: with an effect and without one, by what it said.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
struct Counts {
    effect_green: usize,
    effect_red: usize,
    effect_open: usize,
    effect_program: usize,
    none_green: usize,
    none_red: usize,
    none_open: usize,
    none_program: usize,
    right_place: usize,
    wrong_place: usize,
}

impl Counts {
    fn of(rows: &[Row], said: Said) -> Self {
        let mut counts = Self::default();
        for row in rows.iter().filter(|row| !row.at_the_edge) {
            let (door, first) = said(row);
            *match (row.has_effect(), door) {
                (true, Door::Green) => &mut counts.effect_green,
                (true, Door::Red) => &mut counts.effect_red,
                (true, Door::Open) => &mut counts.effect_open,
                (true, Door::Program) => &mut counts.effect_program,
                (false, Door::Green) => &mut counts.none_green,
                (false, Door::Red) => &mut counts.none_red,
                (false, Door::Open) => &mut counts.none_open,
                (false, Door::Program) => &mut counts.none_program,
            } += 1;
            if door == Door::Red && row.has_effect() {
                match row.is_right_place(first) {
                    Some(true) => counts.right_place += 1,
                    Some(false) => counts.wrong_place += 1,
                    None => {}
                }
            }
        }
        counts
    }
}

const DOORS: [(&str, Said); 2] = [
    ("virtual", |row| (row.virtual_door, row.virtual_first.as_ref())),
    ("diagnose", |row| (row.diagnose, row.diagnose_first.as_ref())),
];

/// All of it as one JSON document.
pub fn document(rows: &[Row], classes: usize, seed: u64) -> Value {
    let doors: BTreeMap<&str, Counts> =
        DOORS.iter().map(|(name, said)| (*name, Counts::of(rows, *said))).collect();
    json!({ "mutants": rows.len(), "classes": classes, "seed": seed, "doors": doors, "rows": rows })
}

/// The results in words.
pub fn table(rows: &[Row], classes: usize, seed: u64) -> String {
    let harmful = || rows.iter().filter(|row| row.has_effect());
    let noticed = |by: fn(&&Row) -> bool| harmful().filter(by).count();
    let mut out = format!(
        "{} mutants of {classes} classes of datagrams, seed {seed}: {} do harm in true time, {} lie at a limit\n\
         noticed: by virtual {}, by diagnose of the capture {}, by the program itself {}\n\n",
        rows.len(),
        harmful().count(),
        rows.iter().filter(|row| row.at_the_edge).count(),
        noticed(|row| row.virtual_door != Door::Green),
        noticed(|row| row.diagnose != Door::Green),
        noticed(|row| row.program),
    );
    out += "             with an effect                      without one\n";
    out += "door         green    red  not known  program   green    red  not known  program   place right\n";
    // Writing to a String cannot fail, here and below.
    for (name, said) in DOORS {
        let counts = Counts::of(rows, said);
        let placed = counts.right_place + counts.wrong_place;
        let _ = writeln!(
            out,
            "{name:<10} {:>7} {:>6} {:>10} {:>8} {:>7} {:>6} {:>10} {:>8}   {} of {placed}",
            counts.effect_green,
            counts.effect_red,
            counts.effect_open,
            counts.effect_program,
            counts.none_green,
            counts.none_red,
            counts.none_open,
            counts.none_program,
            counts.right_place,
        );
    }
    for (name, said) in DOORS {
        let missed = |row: &&Row| row.has_effect() && said(row).0 == Door::Green;
        list(&mut out, &format!("Harmful, and green at {name}"), rows.iter().filter(missed));
        let false_alarm = |row: &&Row| row.has_none() && said(row).0 == Door::Red;
        list(&mut out, &format!("Harmless, and red at {name}"), rows.iter().filter(false_alarm));
    }
    out
}

fn list<'a>(out: &mut String, head: &str, rows: impl Iterator<Item = &'a Row>) {
    let rows: Vec<&Row> = rows.collect();
    if rows.is_empty() {
        return;
    }
    let _ = writeln!(out, "\n{head}: {}", rows.len());
    for row in rows.iter().take(MOST_SHOWN) {
        let effects: Vec<String> = row.effects.iter().map(|(word, at)| place(word, *at)).collect();
        let first = row.virtual_first.as_ref().or(row.diagnose_first.as_ref());
        let why = match (effects.is_empty(), first) {
            (false, _) => effects.join(", "),
            (true, Some((kind, at))) => place(kind, *at),
            (true, None) => String::new(),
        };
        let _ = writeln!(out, "  {}: {why}", row.mutant);
    }
    if rows.len() > MOST_SHOWN {
        let _ = writeln!(out, "  and {} more; --json has them", rows.len() - MOST_SHOWN);
    }
}

fn place(what: &str, at: Option<usize>) -> String {
    match at {
        Some(at) => format!("{what} of SubDevice {at}"),
        None => what.to_owned(),
    }
}

/// Mutants of a kind with a line of their own.
const MOST_SHOWN: usize = 40;
