//! Many runs of the same program, each with a different seed: processes of this command, as many at
//! once as there are processors.

mod folder;
mod row;

use std::fs;
use std::io::{self, IsTerminal, Read};
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::limits;
use isocat_engine::sweep::Sweep;
use isocat_segment::SegmentFile;
use isocat_wire::Nanos;

use super::Arguments;
use crate::cli::run::{command, unwritable};
use crate::cli::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, interface, print};
use folder::Folder;
use row::Row;

/// Arguments for many runs.
#[derive(Args, Debug)]
#[group(skip)]
#[command(next_help_heading = "Many runs")]
pub struct Options {
    /// Run the program with this many seeds, from --seed or 1 on, and print a table
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000),
        conflicts_with_all = ["report", "junit", "capture", "waves", "trace", "series"])]
    pub seeds: Option<u64>,
    /// swarm: each run draws 1 to 4 faults of its own in addition to those of the file
    #[arg(long, value_name = "HOW", value_parser = ["swarm"], requires = "seeds")]
    faults: Option<String>,
    /// Values of a key of the segment file, as in isocat sweep: each makes a point of a grid
    #[arg(long, value_name = "KEY=VALUES", requires = "seeds")]
    vary: Vec<String>,
    /// Number of parallel runs; default one per processor
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256), requires = "seeds")]
    jobs: Option<u16>,
    /// Write a row for each run to this file: CSV
    #[arg(long, value_name = "FILE.csv", requires = "seeds")]
    rows: Option<PathBuf>,
    /// Write segment file, report and output of each run that was not in sync, at most 100, and of
    /// the one with the least margin into this folder
    #[arg(long, value_name = "FOLDER", requires = "seeds")]
    failed: Option<PathBuf>,
}

/// Largest number of bytes of a program's output that are kept.
const MOST_OUTPUT: u64 = 1 << 20;

/// Runs all; returns the exit code.
pub fn run(arguments: &Arguments, seeds: u64) -> Result<u8, String> {
    let options = &arguments.many;
    arguments.find_program()?;
    let sweep = sweep(arguments, seeds)?;
    let folder = Folder::create(options.failed.as_deref())?;
    let stop = interface::stop_on_signals().map_err(|error| error.to_string())?;
    let (runs, next) = (sweep.runs(), AtomicU64::new(0));
    let bar = progress(runs);
    let (rows, failure) = (Mutex::new(Vec::new()), Mutex::new(None));
    let work = || {
        while !stop.load(Ordering::SeqCst) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= runs {
                return;
            }
            match one(arguments, &sweep, &folder, number) {
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
        for _ in 0..options.jobs() {
            scope.spawn(work);
        }
    });
    bar.finish_and_clear();
    if let Some(message) = locked(&failure).take() {
        return Err(message);
    }
    let mut rows: Vec<Row> = std::mem::take(&mut locked(&rows));
    rows.sort_by_key(|row| row.number);
    if let Some(path) = &options.rows {
        crate::cli::output::write(path, row::csv(&sweep, &rows))
            .map_err(|error| unwritable("rows", Some(path), &error))?;
    }
    let text = match arguments.json {
        true => format!("{}\n", row::document(&sweep, &rows)),
        false => row::table(&sweep, &rows),
    };
    let whole = rows.len() as u64 == runs && rows.iter().all(|row| row.code == i32::from(IN_SYNC));
    Ok(match print(&text) {
        IN_SYNC if whole => IN_SYNC,
        IN_SYNC => NOT_IN_SYNC,
        _ => BAD_INPUT,
    })
}

/// The segment file and the values that vary between runs.
fn sweep(arguments: &Arguments, seeds: u64) -> Result<Sweep, String> {
    let (path, text) = match arguments.segment.as_deref() {
        Some(path) => {
            (path, limits::read_text(path, limits::TOML).map_err(|error| error.to_string())?)
        }
        None => ("built-in segment", SegmentFile::built_in_text().to_owned()),
    };
    let mut sweep = Sweep::new(path, &text).map_err(|error| error.to_string())?;
    for axis in &arguments.many.vary {
        sweep.vary(axis).map_err(|error| format!("--vary {error}"))?;
    }
    sweep.seeds(arguments.seed.unwrap_or(1), seeds);
    if arguments.many.faults.is_some() {
        sweep.swarm();
    }
    Ok(sweep)
}

/// One run, as a separate process.
fn one(arguments: &Arguments, sweep: &Sweep, folder: &Folder, number: u64) -> Result<Row, String> {
    let case = sweep.case(number)?;
    let failed = |error: io::Error| format!("run {number}: {error}");
    let [segment, report, output] = folder.files(number);
    // At the end, so that places in it are those of the text that it was made of.
    let text = format!(
        "{}\n\n# {}\n",
        case.text.trim_end(),
        arguments.repeats(Some(&segment.display().to_string()), case.seed)
    );
    fs::write(&segment, text).map_err(failed)?;
    let (said, to) = io::pipe().map_err(failed)?;
    let mut command = crate::cli::once_more().map_err(failed)?;
    command.arg("virtual").args(&arguments.segment).arg("--text").arg(&segment);
    command.arg("--report").arg(&report).args(["--seed", &case.seed.to_string()]);
    command.args(arguments.of_one_run()).arg("--").args(&arguments.program);
    command.stdin(Stdio::null()).stdout(to.try_clone().map_err(failed)?).stderr(to);
    let mut child = command.spawn().map_err(failed)?;
    // Its ends of the pipe are the command's, which would keep it open.
    drop(command);
    let said = first_of(said).map_err(failed)?;
    let code = child.wait().map_err(failed)?.code().unwrap_or(-1);
    if code == i32::from(BAD_INPUT) {
        let said = String::from_utf8_lossy(&said);
        return Err(format!("run {number}, seed {}: {}", case.seed, said.trim()));
    }
    fs::write(&output, said).map_err(failed)?;
    let report = fs::read_to_string(&report).map_err(failed)?;
    let row = Row::new(number, case, code, &report)?;
    folder.consider(&row).map_err(failed)?;
    Ok(row)
}

/// The beginning of a program's output; the rest is read and dropped.
fn first_of(mut from: impl Read) -> io::Result<Vec<u8>> {
    let mut said = Vec::new();
    from.by_ref().take(MOST_OUTPUT).read_to_end(&mut said)?;
    io::copy(&mut from, &mut io::sink())?;
    Ok(said)
}

/// A duration as the command reads it, in the largest unit that has it whole: `3600s`, `1500ns`.
fn duration(span: Nanos) -> String {
    let units = [(1_000_000_000, "s"), (1_000_000, "ms"), (1_000, "us")];
    let unit = units.into_iter().find(|(unit, _)| span.0 % unit == 0);
    let (unit, name) = unit.unwrap_or((1, "ns"));
    format!("{}{name}", span.0 / unit)
}

impl Arguments {
    /// The arguments of each run besides its segment and its seed.
    pub(super) fn of_one_run(&self) -> Vec<String> {
        let mut words = vec!["--interface".to_owned(), self.interface.clone()];
        let mut add = |flag: &str, value: Option<String>| {
            if let Some(value) = value {
                words.extend([flag.to_owned(), value]);
            }
        };
        add("--secondary", self.secondary.clone());
        add("--lateness", self.lateness.map(duration));
        add("--lateness-from", self.lateness_from.as_ref().map(|path| path.display().to_string()));
        add(
            "--preemption",
            self.preemption.map(|(one_of, time)| format!("{one_of}:{}", duration(time))),
        );
        add("--for", Some(duration(self.limit)));
        if self.as_is {
            words.push("--as-is".to_owned());
        }
        words
    }

    /// The command that repeats a run, in one line.
    pub(super) fn repeats(&self, segment: Option<&str>, seed: u64) -> String {
        let mut words = vec!["isocat".to_owned(), "virtual".to_owned()];
        words.extend(segment.map(str::to_owned));
        words.extend(["--seed".to_owned(), seed.to_string()]);
        words.extend(self.of_one_run());
        words.push("--".to_owned());
        words.extend(self.program.iter().map(|word| word.to_string_lossy().into_owned()));
        command(&words.iter().map(String::as_str).collect::<Vec<_>>()).replace('\n', " ")
    }
}

impl Options {
    pub fn jobs(&self) -> usize {
        let processors = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        self.jobs.map_or_else(processors, usize::from)
    }
}

pub fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub fn progress(runs: u64) -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(runs);
    let template = "{pos} of {len} {wide_bar} {per_sec}, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
