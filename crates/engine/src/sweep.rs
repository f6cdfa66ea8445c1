//! Many runs of one segment: parameters over a grid, seeds, and faults that are drawn.
//!
//! A [`Sweep`] is a segment file and the parameters to vary. [`case`](Sweep::case) is one of its
//! runs as a separate segment file, which `isocat run` repeats. [`run`](Sweep::run) runs it and
//! returns a [`Row`], and [`run_all`](Sweep::run_all) does so for all, on several threads and in
//! order. [`summary`] summarizes many rows in bounded memory; [`bisect`](Sweep::bisect) looks for
//! the limit of a value; [`shrink`](mod@shrink) reduces a run that fails.

use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;

use isocat_descriptions::FileError;
use isocat_segment::{Scenario, SegmentFile};
use toml::{Table, Value};

mod axis;
mod bisect;
mod row;
pub mod shrink;
pub mod summary;
mod swarm;

pub use axis::Axis;
pub use bisect::{Bisection, Tried};
pub use row::{Outcome, Row, Totals};

use crate::unwatched;

/// A segment file and the parameters to vary.
#[derive(Clone)]
pub struct Sweep {
    path: String,
    base: Table,
    axes: Vec<Axis>,
    first_seed: u64,
    seeds: u64,
    swarm: bool,
}

/// Sets a key of a segment file as one value of an axis would.
pub fn set(table: &mut Table, key: &str, value: &str) -> Result<(), String> {
    Axis::over(key, vec![value.to_owned()])?.apply(table, 0, 0).map(drop)
}

/// One run of a sweep.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Case {
    /// Its seed.
    pub seed: u64,
    /// The value of each axis, in the order of the axes.
    pub values: Vec<String>,
    /// The segment file.
    pub text: String,
}

impl Sweep {
    /// A sweep over a segment file. `path` names it in errors, and paths in the file are relative
    /// to its folder. Without further settings it has one run with seed 1.
    pub fn new(path: &str, text: &str) -> Result<Self, FileError> {
        SegmentFile::parse(path, text)?;
        // A file that the segment file's own reader accepted is TOML.
        let base = text.parse::<Table>().unwrap_or_default();
        let path = path.to_owned();
        Ok(Self { path, base, axes: Vec::new(), first_seed: 1, seeds: 1, swarm: false })
    }

    /// Varies a key: `host.jitter=5us,50us`, `subdevice[*].cable=1m..100m`. Values in a list form a
    /// grid with those of the other axes; a value of a range is drawn in each run.
    pub fn vary(&mut self, text: &str) -> Result<(), String> {
        let axis = Axis::parse(text)?;
        // An axis without a matching key would give a grid of equal runs.
        axis.apply(&mut self.base.clone(), 0, 0)?;
        self.axes.push(axis);
        Ok(())
    }

    /// Varies a key over separate values, which may contain commas. One value sets the key.
    pub fn vary_over(&mut self, key: &str, values: Vec<String>) -> Result<(), String> {
        let axis = Axis::over(key, values)?;
        axis.apply(&mut self.base.clone(), 0, 0)?;
        self.axes.push(axis);
        Ok(())
    }

    /// Checks whether the segment file's reader accepts each value, one axis at a time; for a
    /// range, the value that the first seed draws. Returns the first value that is refused.
    pub fn check(&self) -> Result<(), (String, FileError)> {
        for axis in &self.axes {
            for choice in 0..axis.values() {
                let mut table = self.base.clone();
                // The axis had a matching key when it was added.
                let value = axis.apply(&mut table, choice, self.first_seed).unwrap_or_default();
                SegmentFile::parse(&self.path, &table.to_string())
                    .map_err(|error| (format!("{} = {value}", axis.key), error))?;
            }
        }
        Ok(())
    }

    /// Sets the number of seeds, and the first one.
    pub fn seeds(&mut self, first: u64, count: u64) {
        (self.first_seed, self.seeds) = (first, count.max(1));
    }

    /// Makes each run draw faults of its own, in addition to those of the file.
    pub fn swarm(&mut self) {
        self.swarm = true;
    }

    /// The parameters to vary.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Number of runs.
    pub fn runs(&self) -> u64 {
        self.points().saturating_mul(self.seeds)
    }

    fn points(&self) -> u64 {
        self.axes.iter().map(Axis::values).fold(1, u64::saturating_mul)
    }

    /// The run with this number, from 0: seeds vary faster than points of the grid.
    pub fn case(&self, number: u64) -> Result<Case, String> {
        let seed = self.first_seed + number % self.seeds;
        let mut point = number / self.seeds;
        let mut table = self.base.clone();
        let mut values = Vec::with_capacity(self.axes.len());
        for axis in &self.axes {
            let choice = point % axis.values();
            point /= axis.values();
            values.push(axis.apply(&mut table, choice, seed)?);
        }
        table.insert("seed".into(), Value::Integer(i64::try_from(seed).unwrap_or(i64::MAX)));
        if self.swarm {
            swarm::draw(&mut table, seed);
        }
        Ok(Case { seed, values, text: table.to_string() })
    }

    /// Runs the case with this number.
    pub fn run(&self, number: u64) -> Row {
        match self.case(number) {
            Ok(case) => Row::new(number, &case, self.outcome(&case.text)),
            Err(why) => {
                let case = Case { seed: 0, values: Vec::new(), text: String::new() };
                Row::new(number, &case, Outcome::refused(why))
            }
        }
    }

    /// The outcome of a segment file.
    pub fn outcome(&self, text: &str) -> Outcome {
        let run = || match SegmentFile::parse(&self.path, text) {
            Err(error) => Outcome::refused(error.to_string()),
            Ok(file) => {
                let scenario = Scenario::from(file);
                let mut run = scenario.run();
                run.follow_course = true;
                let outcome = unwatched(run, &mut |_| {});
                Outcome::of(&scenario, &outcome)
            }
        };
        // A run that panics is a result, and the worst one.
        catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Outcome::panicked())
    }

    /// Runs all cases from the number `from` on, on several threads, until `stop` is set. `each`
    /// gets every row, in the order of their numbers; an error from it ends the runs.
    pub fn run_all<E: Send>(
        &self,
        from: u64,
        threads: usize,
        stop: &AtomicBool,
        each: impl FnMut(Row) -> Result<(), E>,
    ) -> Result<(), E> {
        self.run_range(from..self.runs(), threads, stop, each)
    }

    /// Runs the cases with these numbers, as far as they exist.
    pub fn run_range<E: Send>(
        &self,
        numbers: Range<u64>,
        threads: usize,
        stop: &AtomicBool,
        mut each: impl FnMut(Row) -> Result<(), E>,
    ) -> Result<(), E> {
        let threads = threads.max(1);
        let (from, to) = (numbers.start, numbers.end.min(self.runs()));
        let next = AtomicU64::new(from);
        let (sender, receiver) = sync_channel(4 * threads);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                let (sender, next) = (sender.clone(), &next);
                scope.spawn(move || {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        let over = number >= to || stop.load(Ordering::Relaxed);
                        if over || sender.send(self.run(number)).is_err() {
                            break;
                        }
                    }
                });
            }
            drop(sender);
            // Rows that finished before those with lower numbers: about as many as there are
            // threads.
            let mut early = BTreeMap::new();
            let mut wanted = from;
            for row in &receiver {
                early.insert(row.number, row);
                while let Some(row) = early.remove(&wanted) {
                    wanted += 1;
                    if let Err(error) = each(row) {
                        stop.store(true, Ordering::Relaxed);
                        // Waiting senders then see that the receiver is gone.
                        drop(receiver);
                        return Err(error);
                    }
                }
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests;
