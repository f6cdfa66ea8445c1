//! `isocat sweep`: many runs of one segment, each a row.

use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, IsTerminal, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::columns::cut;
use isocat_descriptions::limits;
use isocat_engine::sweep::{Row, Sweep, Totals, shrink};
use isocat_segment::SegmentFile;

use super::run::unwritable;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

/// Shown below the help of `sweep`.
pub(crate) const EXAMPLES: &str = "\
Examples:
  isocat sweep my.toml --seeds 1000                   a thousand runs with other crystals and other jitter
  isocat sweep my.toml --vary host.jitter=5us,20us,50us --vary cycle=500us,1ms --seeds 20
  isocat sweep my.toml --vary 'subdevice[*].cable=1m..100m' --seeds 200 --rows out.csv
  isocat sweep my.toml --faults swarm --seeds 10000 --rows out.csv --failed failed --shrink
  isocat sweep my.toml --faults swarm --seeds 10000 --rows out.csv --resume

Exit code: 0 every run was as expected (in sync, where the file expects nothing else), 1 one was not, 2 bad input.
docs/sweep.md says what is in a row.";

/// Arguments of `sweep`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment runs
    segment: Option<String>,
    /// Values of a key: each makes a point of a grid (host.jitter=5us,50us); a range is drawn in each run
    /// (subdevice[*].cable=1m..100m); may stand several times
    #[arg(long, value_name = "KEY=VALUES")]
    vary: Vec<String>,
    /// How many seeds each point of the grid is run with
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=1_000_000_000_000))]
    first_seed: u64,
    /// swarm: each run draws 1 to 4 faults of its own beside those of the file
    #[arg(long, value_name = "HOW", value_parser = ["swarm"])]
    faults: Option<String>,
    /// Threads; default one for each processor
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Write a row for each run to this CSV file
    #[arg(long, value_name = "FILE")]
    rows: Option<PathBuf>,
    /// Go on with the file of --rows behind its last row
    #[arg(long, requires = "rows")]
    resume: bool,
    /// Write the segment file of each run that was not as expected into this folder, 100 at most
    #[arg(long, value_name = "FOLDER")]
    failed: Option<PathBuf>,
    /// Make them small first: as few faults and devices and as little time as still fail the same way
    #[arg(long, requires = "failed")]
    shrink: bool,
    /// Print the totals as one JSON document
    #[arg(long)]
    json: bool,
}

/// Segment files of failed runs that are written.
const MOST_FAILED: usize = 100;

/// Runs all; gives the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    match arguments.sweep() {
        Ok(code) => code,
        Err(message) => fail(&message),
    }
}

impl Arguments {
    fn sweep(&self) -> Result<u8, String> {
        let (path, text) = match self.segment.as_deref() {
            Some(path) => {
                let text = limits::read_text(path, limits::TOML).map_err(|e| e.to_string())?;
                (path, text)
            }
            None => ("built-in segment", SegmentFile::built_in_text().to_owned()),
        };
        let mut sweep = Sweep::new(path, &text).map_err(|error| error.to_string())?;
        for axis in &self.vary {
            sweep.vary(axis).map_err(|error| format!("--vary {error}"))?;
        }
        sweep.seeds(self.first_seed, self.seeds);
        if self.faults.is_some() {
            sweep.swarm();
        }
        if let Some(folder) = &self.failed {
            std::fs::create_dir_all(folder)
                .map_err(|error| unwritable("folder", Some(folder), &error))?;
        }
        let mut rows = self.rows.as_deref().map(|path| Rows::open(path, &sweep, self.resume));
        let mut rows = rows.take().transpose()?;
        let from = rows.as_ref().map_or(0, |rows| rows.next);
        let stop = stop_on_signals()?;
        let threads = self.jobs.map_or_else(
            || std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            usize::from,
        );
        let bar = progress(sweep.runs(), from);
        let mut totals = Totals::default();
        let mut kept = 0;
        let done = sweep.run_all(from, threads, &stop, |row| {
            totals.add(&row);
            bar.inc(1);
            bar.set_message(format!("{} not as expected", totals.runs - totals.as_expected));
            if let Some(rows) = &mut rows {
                rows.write(&row)?;
            }
            match &self.failed {
                Some(folder) if !row.outcome.as_expected && kept < MOST_FAILED => {
                    kept += 1;
                    self.keep(folder, &sweep, &row)
                }
                _ => Ok(()),
            }
        });
        bar.finish_and_clear();
        done?;
        let stopped = stop.load(Ordering::Relaxed).then_some(from + totals.runs);
        let text = match self.json {
            true => super::run::json(&document(&sweep, &totals)),
            false => table(&sweep, &totals, stopped),
        };
        Ok(match print(&text) {
            IN_SYNC if totals.as_expected == totals.runs && stopped.is_none() => IN_SYNC,
            BAD_INPUT => BAD_INPUT,
            _ => NOT_IN_SYNC,
        })
    }

    /// Writes the segment file of a failed run.
    fn keep(&self, folder: &Path, sweep: &Sweep, row: &Row) -> Result<(), String> {
        let case = sweep.case(row.number)?;
        let text = match self.shrink {
            false => case.text,
            true => shrink::shrink(&case.text, |text| sweep.outcome(text).is_like(&row.outcome)),
        };
        let finding = row.outcome.finding.as_deref().unwrap_or(row.outcome.verdict);
        let path = folder.join(format!("run-{}.toml", row.number));
        let head = format!("# Run {} of a sweep, seed {}: {finding}.\n\n", row.number, row.seed);
        super::output::write(&path, head + &text)
            .map_err(|error| unwritable("segment", Some(&path), &error))
    }
}

/// The file with a row for each run.
struct Rows {
    file: std::fs::File,
    path: PathBuf,
    /// The run whose row comes next.
    next: u64,
}

impl Rows {
    /// Begins a file, or goes on with one.
    fn open(path: &Path, sweep: &Sweep, resume: bool) -> Result<Self, String> {
        let wrong = |error: &std::io::Error| unwritable("rows", Some(path), error);
        if !resume && path.exists() {
            return Err(format!(
                "{} is there already; expected another name, or --resume to go on with it",
                path.display()
            ));
        }
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create(true).truncate(false).open(path);
        let mut file = file.map_err(|error| wrong(&error))?;
        let head = head(sweep);
        let (next, whole) = last_row(&mut file, &head, path)?;
        // A row that was cut off is written again.
        file.set_len(whole)
            .and_then(|()| file.seek(std::io::SeekFrom::End(0)))
            .map_err(|e| wrong(&e))?;
        if whole == 0 {
            file.write_all(head.as_bytes()).map_err(|error| wrong(&error))?;
        }
        Ok(Self { file, path: path.to_owned(), next })
    }

    fn write(&mut self, row: &Row) -> Result<(), String> {
        let mut line = format!("{},{}", row.number, row.seed);
        for value in row.values.iter().chain(&row.cells()) {
            line.push(',');
            line += &cell(value);
        }
        line.push('\n');
        let written = self.file.write_all(line.as_bytes());
        written.map_err(|error| unwritable("rows", Some(&self.path), &error))
    }
}

fn head(sweep: &Sweep) -> String {
    let mut head = "number,seed".to_owned();
    let keys = sweep.axes().iter().map(|axis| axis.key.as_str());
    for name in keys.chain(Row::COLUMNS) {
        head.push(',');
        head += &cell(name);
    }
    head + "\n"
}

/// The number of the next row of a file, and how many of its bytes are whole rows.
fn last_row(file: &mut std::fs::File, head: &str, path: &Path) -> Result<(u64, u64), String> {
    let unreadable = |error: std::io::Error| format!("{} can't be read: {error}", path.display());
    let mut reader = BufReader::new(file);
    let (mut line, mut whole, mut next) = (String::new(), 0, 0);
    loop {
        line.clear();
        let read = reader.by_ref().take(LONGEST_ROW).read_line(&mut line).map_err(unreadable)?;
        if read == 0 || !line.ends_with('\n') {
            return Ok((next, whole));
        }
        if whole == 0 {
            if line != head {
                return Err(format!(
                    "{} is of another sweep: its columns are {}; expected {}",
                    path.display(),
                    cut(line.trim_end(), 60),
                    cut(head.trim_end(), 60)
                ));
            }
        } else {
            let number = line.split(',').next().and_then(|number| number.parse::<u64>().ok());
            if number != Some(next) {
                return Err(format!(
                    "{}: its row {next} has the number {number:?}; expected {next}",
                    path.display()
                ));
            }
            next += 1;
        }
        whole += read as u64;
    }
}

/// A row is some 200 bytes.
const LONGEST_ROW: u64 = 1 << 20;

/// A cell of a CSV file, in one line.
fn cell(text: &str) -> String {
    let text = text.replace(['\n', '\r'], " ");
    match text.contains([',', '"']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text,
    }
}

fn progress(runs: u64, from: u64) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(runs);
    bar.set_position(from);
    let template = "{pos} of {len} {wide_bar} {per_sec}, {eta} left; {msg}";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

#[cfg(target_os = "linux")]
fn stop_on_signals() -> Result<Arc<AtomicBool>, String> {
    super::interface::stop_on_signals().map_err(|error| format!("signals can't be caught: {error}"))
}

#[cfg(not(target_os = "linux"))]
fn stop_on_signals() -> Result<Arc<AtomicBool>, String> {
    Ok(Arc::default())
}

/// The totals for people.
fn table(sweep: &Sweep, totals: &Totals, stopped: Option<u64>) -> String {
    let mut out = String::new();
    let share = |good: u64, all: u64| 100.0 * good as f64 / all.max(1) as f64;
    let (runs, good) = (totals.runs, totals.as_expected);
    let _ = writeln!(out, "As expected: {good} of {runs} runs ({:.2} %).", share(good, runs));
    if let Some(next) = stopped {
        let _ =
            writeln!(out, "Stopped before run {next} of {}; --resume goes on there.", sweep.runs());
    }
    let verdicts: Vec<_> =
        totals.verdicts.iter().map(|(name, count)| format!("{count} {name}")).collect();
    let _ = writeln!(out, "{}\n", verdicts.join(", "));
    for (number, axis) in sweep.axes().iter().enumerate() {
        let values: Vec<_> =
            totals.values.iter().filter(|((axis, _), _)| *axis == number).collect();
        if axis.values() == 1 {
            continue;
        }
        let _ = writeln!(out, " {:<40} {:>10} {:>12}", cut(&axis.key, 40), "runs", "as expected");
        for ((_, value), (runs, good)) in values {
            let _ = writeln!(
                out,
                "   {:<38} {runs:>10} {:>10.2} %",
                cut(value, 38),
                share(*good, *runs)
            );
        }
        out.push('\n');
    }
    if !totals.findings.is_empty() {
        let _ = writeln!(out, " {:<40} {:>10}", "first finding, where not as expected", "runs");
        let mut findings: Vec<_> = totals.findings.iter().collect();
        findings.sort_by_key(|(name, count)| (std::cmp::Reverse(**count), name.as_str()));
        for (name, count) in findings {
            let _ = writeln!(out, "   {name:<38} {count:>10}");
        }
        let first: Vec<_> =
            totals.failed.iter().map(|(number, seed)| format!("{number} (seed {seed})")).collect();
        let _ = writeln!(out, "\n runs that were not as expected: {}", first.join(", "));
    }
    out
}

/// The totals for programs.
fn document(sweep: &Sweep, totals: &Totals) -> serde_json::Value {
    let value = |((axis, value), (runs, good)): (&(usize, String), &(u64, u64))| {
        serde_json::json!({
            "key": sweep.axes()[*axis].key,
            "value": value,
            "runs": runs,
            "as_expected": good,
        })
    };
    let grid = |entry: &(&(usize, String), &(u64, u64))| sweep.axes()[entry.0.0].values() > 1;
    serde_json::json!({
        "format": "isocat-sweep/1",
        "runs": totals.runs,
        "planned": sweep.runs(),
        "as_expected": totals.as_expected,
        "verdicts": totals.verdicts,
        "findings": totals.findings,
        "values": totals.values.iter().filter(grid).map(value).collect::<Vec<_>>(),
        "failed": totals.failed.iter().map(|(number, seed)| serde_json::json!({ "number": number, "seed": seed })).collect::<Vec<_>>(),
    })
}
