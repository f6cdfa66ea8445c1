//! `isocat sweep`: many runs of one segment, with a row for each.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::limits;
use isocat_engine::sweep::summary::Summary;
use isocat_engine::sweep::{Row, Sweep, Totals, shrink};
use isocat_segment::SegmentFile;

use super::run::unwritable;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};
use crate::html;

mod bisect;
mod rows;
mod text;

use rows::Rows;

/// Shown below the help of `sweep`.
pub(crate) const EXAMPLES: &str = "\
Examples:
  isocat sweep my.toml --seeds 1000                   a thousand runs with other crystals and other jitter
  isocat sweep my.toml --vary host.jitter=5us,20us,50us --vary cycle=500us,1ms --seeds 20
  isocat sweep my.toml --vary 'subdevice[*].cable=1m..100m' --seeds 200 --rows out.csv
  isocat sweep my.toml --faults swarm --seeds 10000 --rows out.csv --failed failed --shrink
  isocat sweep my.toml --faults swarm --seeds 10000 --rows out.csv --resume
  isocat sweep my.toml --vary cycle=250us,500us,1ms --vary host.jitter=5us,50us --seeds 50 --page out.html
  isocat sweep my.toml --bisect 'subdevice[*].copy_time=10us..900us' --seeds 20

Exit code: 0 every run was as expected (in sync, where the file expects nothing else), 1 one was not, 2 bad input.
docs/sweep.md says what is in a row.";

/// Arguments of `sweep`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment runs
    segment: Option<String>,
    /// Values of a key: each makes a point of a grid (host.jitter=5us,50us); a value of a range is
    /// drawn in each run (subdevice[*].cable=1m..100m); may be given several times
    #[arg(long, value_name = "KEY=VALUES")]
    vary: Vec<String>,
    /// Number of seeds for each point of the grid
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=1_000_000_000_000))]
    first_seed: u64,
    /// swarm: each run draws 1 to 4 faults of its own in addition to those of the file
    #[arg(long, value_name = "HOW", value_parser = ["swarm"])]
    faults: Option<String>,
    /// Threads; default one per processor
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Write a row for each run to this file: Parquet if it ends in .parquet, otherwise CSV
    #[arg(long, value_name = "FILE")]
    rows: Option<PathBuf>,
    /// Continue the CSV file of --rows after its last row
    #[arg(long, requires = "rows")]
    resume: bool,
    /// Write a page with totals, histograms and the frontier of the grid's first two axes
    #[arg(long, value_name = "FILE.html", conflicts_with = "resume")]
    page: Option<PathBuf>,
    /// Look for the value of a key at which runs stop being as expected, over all seeds
    /// (host.jitter=5us..500us)
    #[arg(long, value_name = "KEY=LEAST..MOST", conflicts_with_all = ["rows", "failed", "page"])]
    bisect: Option<String>,
    /// Write the segment file of each run that was not as expected into this folder, at most 100
    #[arg(long, value_name = "FOLDER")]
    failed: Option<PathBuf>,
    /// Reduce them first: as few faults and devices and as little time as still fail the same way
    #[arg(long, requires = "failed")]
    shrink: bool,
    /// Print the totals as one JSON document
    #[arg(long)]
    json: bool,
}

/// Largest number of segment files of failed runs that are written.
const MOST_FAILED: usize = 100;

/// Runs all; returns the exit code.
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
            None => (path_of(None), SegmentFile::built_in_text().to_owned()),
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
        if let Some(page) = &self.page {
            super::output::probe(page).map_err(|error| unwritable("page", Some(page), &error))?;
        }
        let stop = stop_on_signals()?;
        let threads = self.threads();
        if let Some(range) = &self.bisect {
            return bisect::run(&sweep, range, threads, &stop, self.json);
        }
        let rows = self.rows.as_deref().map(|path| Rows::open(path, &sweep, self.resume));
        let mut rows = rows.transpose()?;
        let from = rows.as_ref().map_or(0, Rows::next);
        let bar = progress(sweep.runs(), from);
        let mut totals = Totals::default();
        let mut summary = Summary::new(&sweep);
        let mut kept = 0;
        let done = sweep.run_all(from, threads, &stop, |row| {
            totals.add(&row);
            summary.add(&row);
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
        rows.as_mut().map_or(Ok(()), Rows::finish)?;
        let stopped = stop.load(Ordering::Relaxed).then_some(from + totals.runs);
        let text = match self.json {
            true => super::run::json(&text::document(&sweep, &totals, &summary)),
            false => text::table(&sweep, &totals, &summary, stopped),
        };
        if let Some(path) = &self.page {
            let json = text::document(&sweep, &totals, &summary).to_string();
            let page = html::sweep::Sweep {
                source: path_of(self.segment.as_deref()),
                sweep: &sweep,
                totals: &totals,
                summary: &summary,
                stopped,
                command: self.command(),
                json,
            };
            super::output::write(path, page.page().render())
                .map_err(|error| unwritable("page", Some(path), &error))?;
        }
        Ok(match print(&text) {
            IN_SYNC if totals.as_expected == totals.runs && stopped.is_none() => IN_SYNC,
            BAD_INPUT => BAD_INPUT,
            _ => NOT_IN_SYNC,
        })
    }

    fn threads(&self) -> usize {
        self.jobs.map_or_else(
            || std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            usize::from,
        )
    }

    /// The command that gives the same totals again.
    fn command(&self) -> String {
        let mut words = vec!["isocat".to_owned(), "sweep".to_owned()];
        words.extend(self.segment.clone());
        words.extend(self.vary.iter().flat_map(|vary| ["--vary".to_owned(), vary.clone()]));
        words.extend(["--seeds".to_owned(), self.seeds.to_string()]);
        words.extend(["--first-seed".to_owned(), self.first_seed.to_string()]);
        words.extend(self.faults.iter().flat_map(|how| ["--faults".to_owned(), how.clone()]));
        super::run::command(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Writes the segment file of a failed run.
    fn keep(&self, folder: &Path, sweep: &Sweep, row: &Row) -> Result<(), String> {
        let case = sweep.case(row.number)?;
        let text = match self.shrink {
            false => case.text,
            true => shrink::shrink(&case.text, |text| sweep.outcome(text).is_like(&row.outcome)),
        };
        let finding = row.outcome.name();
        let path = folder.join(format!("run-{}.toml", row.number));
        let head = format!("# Run {} of a sweep, seed {}: {finding}.\n\n", row.number, row.seed);
        super::output::write(&path, head + &text)
            .map_err(|error| unwritable("segment", Some(&path), &error))
    }
}

/// Name of a segment in messages.
fn path_of(segment: Option<&str>) -> &str {
    segment.unwrap_or("built-in segment")
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
