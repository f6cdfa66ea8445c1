//! Summaries of many runs beyond their totals: sizes of figures, and the limits in a grid. Their
//! memory is bounded, however many runs there are.

use std::collections::BTreeMap;

use super::{Axis, Outcome, Row, Sweep};

/// Counts by size, in at most 64 bins of one width. The width is the smallest power of two that
/// suffices for all values, so the bins do not depend on the order of the values.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// The width is 2 to this power.
    power: u32,
    bins: BTreeMap<i64, u64>,
    count: u64,
    ends: Option<(i64, i64)>,
}

/// Largest number of bins between the least and the largest value.
const MOST_BINS: i64 = 64;

impl Counts {
    /// Counts a value.
    pub fn add(&mut self, value: i64) {
        self.count += 1;
        let (least, most) = self.ends.unwrap_or((value, value));
        let (least, most) = (least.min(value), most.max(value));
        self.ends = Some((least, most));
        while (most >> self.power).saturating_sub(least >> self.power) >= MOST_BINS {
            self.power += 1;
            for (bin, count) in std::mem::take(&mut self.bins) {
                *self.bins.entry(bin >> 1).or_default() += count;
            }
        }
        *self.bins.entry(value >> self.power).or_default() += 1;
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The least and the largest value.
    pub fn ends(&self) -> Option<(i64, i64)> {
        self.ends
    }

    /// Bins that are not empty: from, to (exclusive), and number of values; in the order of size.
    pub fn bins(&self) -> impl Iterator<Item = (i64, i64, u64)> {
        let edge = |bin: i64| bin.saturating_mul(1 << self.power);
        self.bins.iter().map(move |(bin, count)| (edge(*bin), edge(bin + 1), *count))
    }
}

/// A figure of a run.
#[derive(Clone, Copy)]
pub struct Measure {
    /// Its column in rows.
    pub name: &'static str,
    /// Its description.
    pub title: &'static str,
    /// Number of its units in a nanosecond.
    pub in_ns: f64,
    of: fn(&Outcome) -> Option<i64>,
}

/// The figures whose sizes are counted.
pub const MEASURES: [Measure; 5] = [
    Measure {
        name: "in_operation_ns",
        title: "From power-on until all SubDevices were in OP",
        in_ns: 1.0,
        of: |run| run.in_operation_ns,
    },
    Measure {
        name: "worst_sync0_ps",
        title: "Largest error of a SYNC0 edge",
        in_ns: 1_000.0,
        of: |run| run.worst_sync0_ps,
    },
    Measure {
        name: "least_margin_ns",
        title: "Least margin of outputs before their pulse",
        in_ns: 1.0,
        of: |run| run.least_margin_ns,
    },
    Measure {
        name: "outputs_age_ns",
        title: "Largest age of outputs when they acted",
        in_ns: 1.0,
        of: |run| run.outputs_age_ns,
    },
    Measure {
        name: "out_of_sync_ns",
        title: "Time out of sync, of runs that ever were",
        in_ns: 1.0,
        of: |run| (run.stretches > 0).then_some(run.out_of_sync_ns),
    },
];

/// The summary of a sweep beyond its totals.
#[derive(Clone, Debug)]
pub struct Summary {
    /// For each of [`MEASURES`]: runs that were as expected, and those that were not.
    pub measures: [(Counts, Counts); MEASURES.len()],
    /// The limits in the grid, if it has two axes.
    pub frontier: Option<Frontier>,
}

impl Summary {
    /// The empty summary of a sweep.
    pub fn new(sweep: &Sweep) -> Self {
        Self { measures: Default::default(), frontier: Frontier::new(sweep.axes()) }
    }

    /// Adds a row.
    pub fn add(&mut self, row: &Row) {
        for (measure, (good, bad)) in MEASURES.iter().zip(&mut self.measures) {
            if let Some(value) = (measure.of)(&row.outcome) {
                if row.outcome.as_expected { good.add(value) } else { bad.add(value) }
            }
        }
        if let Some(frontier) = &mut self.frontier {
            frontier.add(row);
        }
    }
}

/// The share of runs as expected at each point of two axes of a grid. Further axes are not
/// distinguished.
#[derive(Clone, Debug)]
pub struct Frontier {
    /// The first axis of the grid, whose limit is sought.
    pub sought: Line,
    /// The second axis: the limit is found for each of its values.
    pub given: Line,
    /// Number of runs, and of those as expected, for each sought value of the first given one, then
    /// of the next.
    counts: Vec<(u64, u64)>,
}

/// An axis of a frontier.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its key.
    pub key: String,
    /// Its values, sorted by size if they are numbers of one unit or durations.
    pub values: Vec<String>,
    /// Whether they are sorted.
    pub is_ordered: bool,
    axis: usize,
}

/// The sought values at which every run was as expected, as indices of [`Line::values`].
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Holds {
    /// No run.
    NotRun,
    /// All values.
    Everywhere,
    /// No value.
    Nowhere,
    /// This value and all above.
    From(usize),
    /// This value and all below.
    UpTo(usize),
    /// Some values without a single limit: all except these.
    ExceptAt(Vec<usize>),
}

/// Largest number of points of a frontier.
const MOST_POINTS: usize = 10_000;

impl Frontier {
    fn new(axes: &[Axis]) -> Option<Self> {
        let mut lines = axes.iter().enumerate().filter_map(|(axis, of)| Line::new(axis, of));
        let (sought, given) = (lines.next()?, lines.next()?);
        let points = sought.values.len() * given.values.len();
        (points <= MOST_POINTS).then(|| Self { sought, given, counts: vec![(0, 0); points] })
    }

    fn add(&mut self, row: &Row) {
        let place =
            |line: &Line| line.values.iter().position(|value| *value == row.values[line.axis]);
        // A run that was refused before it had values has no place.
        let (Some(sought), Some(given)) = (place(&self.sought), place(&self.given)) else { return };
        let (runs, good) = &mut self.counts[given * self.sought.values.len() + sought];
        *runs += 1;
        *good += u64::from(row.outcome.as_expected);
    }

    /// Number of runs, and of those as expected, at these indices of the sought and the given
    /// value.
    pub fn at(&self, sought: usize, given: usize) -> (u64, u64) {
        self.counts[given * self.sought.values.len() + sought]
    }

    /// The sought values at which all runs were as expected, for a given one.
    pub fn holds(&self, given: usize) -> Holds {
        let run = |sought: &usize| self.at(*sought, given).0 > 0;
        let tried: Vec<usize> = (0..self.sought.values.len()).filter(run).collect();
        let holds = |sought: usize| {
            let (runs, good) = self.at(sought, given);
            runs == good
        };
        let pattern: Vec<bool> = tried.iter().map(|sought| holds(*sought)).collect();
        let edges = pattern.windows(2).filter(|pair| pair[0] != pair[1]).count();
        match (pattern.first(), pattern.last(), edges) {
            (None, ..) | (_, None, _) => Holds::NotRun,
            (Some(true), _, 0) => Holds::Everywhere,
            (Some(false), _, 0) => Holds::Nowhere,
            (Some(false), Some(true), 1) if self.sought.is_ordered => {
                Holds::From(tried[pattern.iter().position(|good| *good).unwrap_or(0)])
            }
            (Some(true), Some(false), 1) if self.sought.is_ordered => {
                Holds::UpTo(tried[pattern.iter().rposition(|good| *good).unwrap_or(0)])
            }
            _ => Holds::ExceptAt(tried.into_iter().filter(|sought| !holds(*sought)).collect()),
        }
    }
}

impl Line {
    /// An axis with several values.
    fn new(axis: usize, of: &Axis) -> Option<Self> {
        let mut values = of.list().filter(|values| values.len() > 1)?.to_vec();
        let sizes = of.sizes();
        if let Some(sizes) = &sizes {
            let mut order: Vec<usize> = (0..values.len()).collect();
            order.sort_by(|a, b| sizes[*a].total_cmp(&sizes[*b]));
            values = order.into_iter().map(|place| values[place].clone()).collect();
        }
        values.dedup();
        Some(Self { key: of.key.clone(), values, is_ordered: sizes.is_some(), axis })
    }
}
