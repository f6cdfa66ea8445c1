//! Many runs of a program that works, each with one mistake between it and the segment. What a
//! mistake did is measured in true time; what each door says is held against that.

pub mod class;
mod effect;
pub mod mutant;
mod table;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::Args;
use isocat_diagnose::report::VerdictKind;
use isocat_diagnose::{Claims, DiagnoseReport, Diagnosis, Names};
use isocat_segment::Scenario;
use isocat_sim::random::Stream;
use serde_json::Value;

use super::Arguments;
use super::seeds::{locked, progress};
use crate::cli::run::unwritable;
use crate::cli::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, NOT_KNOWN, interface, print};
use class::{Class, Classes, Shown, Whom};
use effect::Figures;
use mutant::{Mutant, Mutation};
use table::{Door, Row};

/// Arguments for mutated runs.
#[derive(Args, Debug)]
#[group(skip)]
#[command(next_help_heading = "Mistakes on purpose")]
pub struct Options {
    /// Run the program this many times, each with one mistake between it and the segment: a
    /// datagram that is left out, doubled, late, or says something else. Print which of those that
    /// do harm were noticed
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000),
        conflicts_with_all = ["seeds", "report", "junit", "capture", "waves", "trace", "series"])]
    pub mutate: Option<u64>,
    /// Do this mutation
    #[arg(long, value_name = "JSON", hide = true)]
    pub mutant: Option<String>,
    /// Write the classes of datagrams of this run to this file
    #[arg(long, value_name = "FILE", hide = true)]
    pub classes: Option<PathBuf>,
}

impl Options {
    /// What is done to the frames of this run.
    pub fn mutation(&self) -> Result<Option<Mutation>, String> {
        let parse = |text: &String| {
            let mutant = serde_json::from_str(text);
            mutant.map(Mutation::new).map_err(|error| format!("--mutant: {error}"))
        };
        self.mutant.as_ref().map(parse).transpose()
    }

    /// Writes the classes of a run, if they are wanted.
    pub fn write(&self, classes: Option<&Classes>) -> Result<(), String> {
        let (Some(path), Some(classes)) = (&self.classes, classes) else { return Ok(()) };
        let text = serde_json::to_string(&classes.list()).map_err(|error| error.to_string())?;
        fs::write(path, text).map_err(|error| unwritable("classes", Some(path), &error))
    }
}

/// What all runs have in common.
struct Bench<'a> {
    arguments: &'a Arguments,
    names: Names,
    claims: Claims,
    folder: PathBuf,
    seed: u64,
    /// Bus cycle and limit of SYNC0, ns.
    cycle: f64,
    limit: f64,
}

/// A run that has ended.
struct Ran {
    code: u8,
    report: Value,
    diagnosis: Option<DiagnoseReport>,
}

/// Runs all; returns the exit code.
pub fn run(arguments: &Arguments, count: u64) -> Result<u8, String> {
    arguments.find_program()?;
    let mut scenario = Scenario::from(arguments.segment_file()?);
    scenario.as_is |= arguments.as_is;
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let folder = std::env::temp_dir().join(format!("isocat-mutate-{}", std::process::id()));
    fs::create_dir_all(&folder).map_err(|error| unwritable("folder", Some(&folder), &error))?;
    let bench = Bench {
        arguments,
        names: Names { positions: names, ..Names::default() },
        claims: scenario.claims(),
        seed: arguments.seed.unwrap_or(scenario.seed),
        cycle: scenario.cycle.0 as f64,
        limit: scenario.sync0_limit.0 as f64,
        folder,
    };
    let result = bench.all(count);
    // Nothing of it is needed any more.
    let _ = fs::remove_dir_all(&bench.folder);
    result
}

impl Bench<'_> {
    fn all(&self, count: u64) -> Result<u8, String> {
        let classes = self.folder.join("classes.json");
        let good = self.one("good", &["--classes".into(), classes.display().to_string()])?;
        if good.code != IN_SYNC {
            return Err(format!(
                "the program as it is ends with exit code {}; expected 0, so that mistakes show",
                good.code
            ));
        }
        let text = fs::read_to_string(&classes).map_err(|error| format!("classes: {error}"))?;
        let classes: Vec<(Class, Shown)> =
            serde_json::from_str(&text).map_err(|error| format!("classes: {error}"))?;
        let mutants = drawn(&classes, count, self.seed);
        let figures = Figures::of(&good.report);
        let positions = |class: &Class| position(class, good.diagnosis.as_ref());
        let rows = self.run_all(&mutants, &figures, &positions)?;
        let text = match self.arguments.json {
            true => format!("{}\n", table::document(&rows, classes.len(), self.seed)),
            false => table::table(&rows, classes.len(), self.seed),
        };
        let green = rows.iter().any(|row| row.has_effect() && row.virtual_door == Door::Green);
        let whole = rows.len() == mutants.len();
        Ok(match print(&text) {
            IN_SYNC if whole && !green => IN_SYNC,
            IN_SYNC => NOT_IN_SYNC,
            _ => BAD_INPUT,
        })
    }

    fn run_all(
        &self,
        mutants: &[Mutant],
        good: &Figures,
        position: &(dyn Fn(&Class) -> Option<usize> + Sync),
    ) -> Result<Vec<Row>, String> {
        let stop = interface::stop_on_signals().map_err(|error| error.to_string())?;
        let (next, bar) = (AtomicUsize::new(0), progress(mutants.len() as u64));
        let (rows, failure) = (Mutex::new(Vec::new()), Mutex::new(None));
        let work = || {
            while !stop.load(Ordering::SeqCst) {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(mutant) = mutants.get(number) else { return };
                match self.mutated(number, mutant, good, position(&mutant.class)) {
                    Ok(row) => locked(&rows).push(row),
                    Err(message) => {
                        locked(&failure).get_or_insert(message);
                        stop.store(true, Ordering::SeqCst);
                    }
                }
                bar.inc(1);
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..self.arguments.many.jobs() {
                scope.spawn(work);
            }
        });
        bar.finish_and_clear();
        if let Some(message) = locked(&failure).take() {
            return Err(message);
        }
        let mut rows: Vec<Row> = std::mem::take(&mut locked(&rows));
        rows.sort_by_key(|row| row.number);
        Ok(rows)
    }

    fn mutated(
        &self,
        number: usize,
        mutant: &Mutant,
        good: &Figures,
        position: Option<usize>,
    ) -> Result<Row, String> {
        let text = serde_json::to_string(mutant).map_err(|error| error.to_string())?;
        let name = format!("run-{number}");
        let ran = self.one(&name, &["--mutant".into(), text])?;
        for ending in ENDINGS {
            let _ = fs::remove_file(self.folder.join(&name).with_extension(ending));
        }
        let figures = Figures::of(&ran.report);
        let effects = figures.against(good, self.cycle, self.limit);
        let at_the_edge = figures.is_at_the_edge(good, self.limit);
        Ok(Row::new(
            number,
            mutant,
            position,
            (effects, at_the_edge),
            ran.code,
            &ran.report,
            ran.diagnosis.as_ref(),
        ))
    }

    /// One run, as a separate process, with its capture and its report.
    fn one(&self, name: &str, more: &[String]) -> Result<Ran, String> {
        let [report, capture] = ENDINGS.map(|ending| self.folder.join(name).with_extension(ending));
        let failed = |error: std::io::Error| format!("{name}: {error}");
        let mut command = crate::cli::once_more().map_err(failed)?;
        command.arg("virtual").args(&self.arguments.segment);
        command.arg("--report").arg(&report).arg("--capture").arg(&capture).args(more);
        command.args(["--seed", &self.seed.to_string()]).args(self.arguments.of_one_run());
        command.arg("--").args(&self.arguments.program);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let code =
            command.status().map_err(failed)?.code().and_then(|code| u8::try_from(code).ok());
        let code = code.unwrap_or(u8::MAX);
        if code == BAD_INPUT {
            return Err(format!(
                "{name}: the program can't be run; `isocat virtual` without --mutate says why"
            ));
        }
        let report = fs::read_to_string(&report).map_err(failed)?;
        let report = serde_json::from_str(&report).map_err(|error| format!("{name}: {error}"))?;
        Ok(Ran { code, report, diagnosis: self.diagnosed(&capture) })
    }

    /// `None`: there was no frame of EtherCAT.
    fn diagnosed(&self, capture: &Path) -> Option<DiagnoseReport> {
        let mut diagnosis = Diagnosis::new().against(Some(self.claims.clone()));
        diagnosis.read("capture", File::open(capture).ok()?).ok()?;
        diagnosis.report(&self.names).ok()
    }
}

/// Mutants of all classes, drawn if they are more than `count`.
fn drawn(classes: &[(Class, Shown)], count: u64, seed: u64) -> Vec<Mutant> {
    let of = |(class, shown): &(Class, Shown)| Mutant::all_of(*class, *shown);
    let mut all: Vec<Mutant> = classes.iter().flat_map(of).collect();
    let mut chance = Stream::new(seed, "mutants", 0);
    let wanted = usize::try_from(count).unwrap_or(usize::MAX).min(all.len());
    for place in 0..wanted {
        let rest = (all.len() - place - 1) as u64;
        all.swap(place, place + chance.up_to(rest) as usize);
    }
    all.truncate(wanted);
    all.sort_unstable();
    all
}

/// The position of the SubDevice that a class addresses.
fn position(class: &Class, good: Option<&DiagnoseReport>) -> Option<usize> {
    match class.whom()? {
        Whom::Position(position) => Some(position.into()),
        Whom::Station(station) => {
            let mut devices = good?.devices.iter();
            let has = |shown: &isocat_diagnose::report::Shown<u16>| shown.value == station;
            let device = devices.find(|device| device.station.as_ref().is_some_and(has))?;
            device.position.map(usize::from)
        }
    }
}

/// What a verdict of `diagnose` is as an exit code.
fn code(verdict: VerdictKind) -> u8 {
    match verdict {
        VerdictKind::InSync | VerdictKind::InOperation => IN_SYNC,
        VerdictKind::Found => NOT_IN_SYNC,
        VerdictKind::NothingFound => NOT_KNOWN,
    }
}

const ENDINGS: [&str; 2] = ["json", "pcapng"];
