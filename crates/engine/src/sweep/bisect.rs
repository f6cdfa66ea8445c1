//! Finds the limit of a value, where runs stop being as expected.

use std::sync::atomic::{AtomicBool, Ordering};

use isocat_segment::SegmentFile;

use super::{Axis, Outcome, Sweep};

/// A value, and the result of its runs.
#[derive(Clone, Debug)]
pub struct Tried {
    /// The value, as `--vary` takes it.
    pub value: String,
    /// The value in thousandths of its unit.
    size: i64,
    /// The first run that was not as expected: its seed and outcome. `None` if all were as
    /// expected.
    pub failed: Option<(u64, Outcome)>,
}

/// The result for a range of values.
#[derive(Clone, Debug)]
pub struct Bisection {
    /// The key.
    pub key: String,
    /// Runs at each value; fewer if one was not as expected.
    pub runs: u64,
    /// All tried values, from the smallest.
    pub tried: Vec<Tried>,
}

/// Number of equal parts of the range whose ends are tried first, so that further limits are
/// noticed.
const PARTS: i64 = 8;
/// A limit is found to this fraction of the range.
const FINEST: i64 = 1_000;

impl Bisection {
    /// Indices in `tried` of neighbours with different results. With one limit, the runs are as
    /// expected on one side of it, as far as was tried. With more, the key is not monotonic.
    pub fn edges(&self) -> Vec<(usize, usize)> {
        let places = 1..self.tried.len();
        let is_edge = |place: &usize| {
            self.tried[place - 1].failed.is_some() != self.tried[*place].failed.is_some()
        };
        places.filter(is_edge).map(|place| (place - 1, place)).collect()
    }
}

impl Sweep {
    /// Looks for the value of a key (`host.jitter=5us..500us`) at which runs stop being as
    /// expected. It tries the ends and seven values between them, then bisects between the first
    /// two neighbours that differ, down to a thousandth of the range or the smallest step of the
    /// unit. At each value all seeds and points of the grid are run, on several threads, until one
    /// is not as expected. `each` gets each value.
    pub fn bisect(
        &self,
        text: &str,
        threads: usize,
        stop: &AtomicBool,
        mut each: impl FnMut(&Tried),
    ) -> Result<Bisection, String> {
        let axis = Axis::parse(text)?;
        let (least, most) = axis.ends().ok_or_else(|| {
            format!(
                "\"{text}\" is no range; expected KEY=LEAST..MOST, such as host.jitter=5us..50us"
            )
        })?;
        let step = axis.step();
        let mut sizes: Vec<i64> =
            (0..=PARTS).map(|part| nearest(least + (most - least) * part / PARTS, step)).collect();
        sizes[PARTS as usize] = most;
        sizes.dedup();
        let mut found = Bisection { key: axis.key.clone(), runs: self.runs(), tried: Vec::new() };
        for size in sizes {
            let tried = self.try_value(&axis, size, threads, stop)?;
            each(&tried);
            found.tried.push(tried);
        }
        let finest = ((most - least) / FINEST).max(step);
        while let Some((low, high)) = found.edges().first().copied() {
            let (from, to) = (found.tried[low].size, found.tried[high].size);
            let middle = nearest(from + (to - from) / 2, step);
            if to - from <= finest || middle <= from || middle >= to {
                break;
            }
            let tried = self.try_value(&axis, middle, threads, stop)?;
            each(&tried);
            found.tried.insert(high, tried);
        }
        Ok(found)
    }

    /// Runs all seeds with one value until one is not as expected.
    fn try_value(
        &self,
        axis: &Axis,
        size: i64,
        threads: usize,
        stop: &AtomicBool,
    ) -> Result<Tried, String> {
        let mut sweep = self.clone();
        let axis = axis.at(size);
        let value = axis.list().and_then(<[String]>::first).cloned().unwrap_or_default();
        sweep.axes.push(axis);
        // A value that the file's reader refuses is an error, not a failed run.
        let case = sweep.case(0)?;
        SegmentFile::parse(&sweep.path, &case.text)
            .map_err(|error| format!("{value} is no value of the key: {error}"))?;
        let mut failed = None;
        let done = sweep.run_all(0, threads, &AtomicBool::new(false), |row| {
            if !row.outcome.as_expected {
                failed = Some((row.seed, row.outcome));
            }
            if failed.is_some() || stop.load(Ordering::Relaxed) { Err(()) } else { Ok(()) }
        });
        match (done, &failed) {
            (Err(()), None) => Err("stopped before the edge was found".to_owned()),
            _ => Ok(Tried { value, size, failed }),
        }
    }
}

/// The largest whole step that is not larger than `size`.
fn nearest(size: i64, step: i64) -> i64 {
    size.div_euclid(step) * step
}
