//! Many runs of one segment: parameters over a grid, seeds, and faults that are drawn.
//!
//! A [`Sweep`] is a segment file and what is to be varied in it. [`case`](Sweep::case) is one of its runs as a segment file of
//! its own, which `isocat run` repeats; [`run`](Sweep::run) runs it and gives a [`Row`], [`run_all`](Sweep::run_all) does so for
//! all, on several threads and in order. [`summary`] is what many rows come to, in bounded memory; [`bisect`](Sweep::bisect) looks for
//! the edge of a value; [`shrink`](mod@shrink) makes a run that fails small.

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

/// A segment file and what is varied in it.
#[derive(Clone)]
pub struct Sweep {
    path: String,
    base: Table,
    axes: Vec<Axis>,
    first_seed: u64,
    seeds: u64,
    swarm: bool,
}

/// Sets a key of a segment file as one value of an axis would, for those who change files by hand.
pub fn set(table: &mut Table, key: &str, value: &str) -> Result<(), String> {
    Axis::over(key, vec![value.to_owned()])?.apply(table, 0, 0).map(drop)
}

/// One run of a sweep.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Case {
    /// Its seed.
    pub seed: u64,
    /// The value of each axis, in their order.
    pub values: Vec<String>,
    /// The segment file.
    pub text: String,
}

impl Sweep {
    /// A sweep over a segment file; `path` names it in errors, and files that it names are relative to its folder. One
    /// run with seed 1 until more is asked for.
    pub fn new(path: &str, text: &str) -> Result<Self, FileError> {
        SegmentFile::parse(path, text)?;
        // What the segment file's own reader took is TOML.
        let base = text.parse::<Table>().unwrap_or_default();
        let path = path.to_owned();
        Ok(Self { path, base, axes: Vec::new(), first_seed: 1, seeds: 1, swarm: false })
    }

    /// Varies a key: `host.jitter=5us,50us`, `subdevice[*].cable=1m..100m`. Values in a list make a grid with those of
    /// the other axes; a range is drawn in each run.
    pub fn vary(&mut self, text: &str) -> Result<(), String> {
        let axis = Axis::parse(text)?;
        // An axis that goes nowhere would give a grid of equal runs.
        axis.apply(&mut self.base.clone(), 0, 0)?;
        self.axes.push(axis);
        Ok(())
    }

    /// Varies a key over values that are given one by one, so that they may hold commas. One value sets the key.
    pub fn vary_over(&mut self, key: &str, values: Vec<String>) -> Result<(), String> {
        let axis = Axis::over(key, values)?;
        axis.apply(&mut self.base.clone(), 0, 0)?;
        self.axes.push(axis);
        Ok(())
    }

    /// Tries whether the segment file's reader takes each value, one axis at a time; of a range, what the first seed draws.
    /// Gives the first one that it does not take.
    pub fn check(&self) -> Result<(), (String, FileError)> {
        for axis in &self.axes {
            for choice in 0..axis.values() {
                let mut table = self.base.clone();
                // It went somewhere when it was added.
                let value = axis.apply(&mut table, choice, self.first_seed).unwrap_or_default();
                SegmentFile::parse(&self.path, &table.to_string())
                    .map_err(|error| (format!("{} = {value}", axis.key), error))?;
            }
        }
        Ok(())
    }

    /// So many seeds, from the first on.
    pub fn seeds(&mut self, first: u64, count: u64) {
        (self.first_seed, self.seeds) = (first, count.max(1));
    }

    /// Each run draws faults of its own, beside those of the file.
    pub fn swarm(&mut self) {
        self.swarm = true;
    }

    /// What is varied.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// How many runs there are.
    pub fn runs(&self) -> u64 {
        self.points().saturating_mul(self.seeds)
    }

    fn points(&self) -> u64 {
        self.axes.iter().map(Axis::values).fold(1, u64::saturating_mul)
    }

    /// The run with this number, from 0: seeds go faster than points of the grid.
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

    /// What becomes of a segment file.
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

    /// Runs all cases from the number `from` on, on so many threads, until `stop` is set. `each` is told of every row, in the
    /// order of their numbers; where it is not content, that is the end.
    pub fn run_all<E: Send>(
        &self,
        from: u64,
        threads: usize,
        stop: &AtomicBool,
        each: impl FnMut(Row) -> Result<(), E>,
    ) -> Result<(), E> {
        self.run_range(from..self.runs(), threads, stop, each)
    }

    /// The same of the cases with these numbers, as far as there are any.
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
            // Rows that came before those in front of them: about as many as there are threads.
            let mut early = BTreeMap::new();
            let mut wanted = from;
            for row in &receiver {
                early.insert(row.number, row);
                while let Some(row) = early.remove(&wanted) {
                    wanted += 1;
                    if let Err(error) = each(row) {
                        stop.store(true, Ordering::Relaxed);
                        // Senders that wait see that nobody receives.
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
