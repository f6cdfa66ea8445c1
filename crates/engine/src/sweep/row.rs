//! The result of a run, in some 200 bytes.

use std::collections::BTreeMap;

use isocat_recorders::parquet::{Cell, Kind};
use isocat_segment::Scenario;
use isocat_sim::Tap;

use super::{Axis, Case};

/// The outcome of a run.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Outcome {
    /// `in-sync`, `not-in-sync`, `not-up` (the way up failed), `refused` (the file or the plan) or
    /// `panicked`.
    pub verdict: &'static str,
    /// Whether it was as expected: by the file's expectations, or else by being in sync.
    pub as_expected: bool,
    /// Kind of the first finding.
    pub finding: Option<String>,
    /// The SubDevice that it names.
    pub device: Option<usize>,
    /// Time from power-on until all SubDevices were in OP, ns.
    pub in_operation_ns: Option<i64>,
    /// The largest SYNC0 error, ps.
    pub worst_sync0_ps: Option<i64>,
    /// The least margin of outputs before their pulse, ns.
    pub least_margin_ns: Option<i64>,
    /// The largest age of outputs at their effect, ns.
    pub outputs_age_ns: Option<i64>,
    /// Number of times that SubDevices were out of sync.
    pub stretches: usize,
    /// Sum of these times, ns.
    pub out_of_sync_ns: i64,
    /// SubDevices that were out of sync at the end.
    pub lost_at_end: usize,
    /// Why it was refused.
    pub why: String,
}

impl Outcome {
    fn bare(verdict: &'static str, why: String) -> Self {
        Self {
            verdict,
            as_expected: false,
            finding: None,
            device: None,
            in_operation_ns: None,
            worst_sync0_ps: None,
            least_margin_ns: None,
            outputs_age_ns: None,
            stretches: 0,
            out_of_sync_ns: 0,
            lost_at_end: 0,
            why,
        }
    }

    pub(super) fn refused(why: String) -> Self {
        Self::bare("refused", why)
    }

    pub(super) fn panicked() -> Self {
        Self::bare("panicked", String::new())
    }

    pub(super) fn of<T: Tap>(_scenario: &Scenario, outcome: &isocat_sim::Outcome<T>) -> Self {
        let verdict = match (&outcome.failure, outcome.began) {
            (Some(error), _) if error.cause.fault() == isocat_maindevice::Fault::Configuration => {
                "refused"
            }
            (Some(_), _) | (None, None) => "not-up",
            (None, Some(_)) if outcome.findings.is_empty() => "in-sync",
            (None, Some(_)) => "not-in-sync",
        };
        let failure = outcome.failure.as_ref();
        let first = outcome.findings.first();
        let finding = match (failure, first) {
            (Some(error), _) => Some(error.cause.name().to_owned()),
            (None, first) => first.map(|finding| finding.kind.name().to_owned()),
        };
        let device = match failure {
            Some(error) => error.cause.place().map(|place| place.position),
            None => outcome.findings.iter().find_map(|finding| finding.place.device),
        };
        let benches = outcome.bench.devices();
        let course = outcome.world.course();
        let worst =
            course.map(|course| (0..course.devices()).map(|d| course.worst_sync0(d).0).max());
        let margins = benches.iter().map(|bench| bench.margin.margin());
        let margins =
            margins.filter(|margin| margin.count() > 0).map(|margin| margin.least() / 1_000);
        let ages = benches.iter().map(|bench| bench.outputs_cycle.age());
        let ages = ages.filter(|age| age.count() > 0).map(|age| age.largest() / 1_000);
        let stretches = course.map_or(&[][..], |course| course.stretches());
        let lasted = stretches.iter().map(|stretch| (stretch.to - stretch.from).0 / 1_000);
        Self {
            verdict,
            as_expected: outcome.as_expected(),
            finding,
            device,
            in_operation_ns: outcome.began.map(|began| began.as_nanos() as i64),
            worst_sync0_ps: worst.flatten(),
            least_margin_ns: margins.min(),
            outputs_age_ns: ages.max(),
            stretches: stretches.len(),
            out_of_sync_ns: lasted.sum(),
            lost_at_end: stretches.iter().filter(|stretch| stretch.open).count(),
            why: failure.map_or(String::new(), ToString::to_string),
        }
    }

    /// The reason against the run, in a word: its first finding; `expectation` if it was in sync
    /// but not as expected; otherwise its verdict.
    pub fn name(&self) -> &str {
        match (&self.finding, self.verdict) {
            (Some(finding), _) => finding,
            (None, "in-sync") if !self.as_expected => "expectation",
            (None, verdict) => verdict,
        }
    }

    /// Whether two runs ended in the same way.
    pub fn is_like(&self, other: &Self) -> bool {
        (self.verdict, self.as_expected, &self.finding)
            == (other.verdict, other.as_expected, &other.finding)
    }
}

/// A run of a sweep and its outcome.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Row {
    /// Its number in the sweep, from 0.
    pub number: u64,
    /// Its seed.
    pub seed: u64,
    /// The value of each axis.
    pub values: Vec<String>,
    /// Its outcome.
    pub outcome: Outcome,
}

impl Row {
    pub(super) fn new(number: u64, case: &Case, outcome: Outcome) -> Self {
        Self { number, seed: case.seed, values: case.values.clone(), outcome }
    }

    /// The columns after those of the axes: name, kind, and whether a cell may be empty.
    pub const COLUMNS: [(&'static str, Kind, bool); 12] = [
        ("verdict", Kind::Text, false),
        ("as_expected", Kind::Flag, false),
        ("finding", Kind::Text, true),
        ("device", Kind::Integer, true),
        ("in_operation_ns", Kind::Integer, true),
        ("worst_sync0_ps", Kind::Integer, true),
        ("least_margin_ns", Kind::Integer, true),
        ("outputs_age_ns", Kind::Integer, true),
        ("stretches", Kind::Integer, false),
        ("out_of_sync_ns", Kind::Integer, false),
        ("lost_at_end", Kind::Integer, false),
        ("why", Kind::Text, true),
    ];

    /// The cells of those columns.
    pub fn cells(&self) -> [Cell<'_>; 12] {
        let number = |value: Option<i64>| value.map_or(Cell::Null, Cell::Integer);
        let of = &self.outcome;
        [
            Cell::Text(of.verdict),
            Cell::Flag(of.as_expected),
            of.finding.as_deref().map_or(Cell::Null, Cell::Text),
            number(of.device.map(|device| device as i64)),
            number(of.in_operation_ns),
            number(of.worst_sync0_ps),
            number(of.least_margin_ns),
            number(of.outputs_age_ns),
            Cell::Integer(of.stretches as i64),
            Cell::Integer(of.out_of_sync_ns),
            Cell::Integer(of.lost_at_end as i64),
            if of.why.is_empty() { Cell::Null } else { Cell::Text(&of.why) },
        ]
    }
}

/// Totals of many runs.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Totals {
    /// Number of runs.
    pub runs: u64,
    /// Number of runs that were as expected.
    pub as_expected: u64,
    /// Number of runs by verdict.
    pub verdicts: BTreeMap<&'static str, u64>,
    /// Number of runs that were not as expected, by the kind of their first finding.
    pub findings: BTreeMap<String, u64>,
    /// By axis and value: number of runs, and of those that were as expected.
    pub values: BTreeMap<(usize, String), (u64, u64)>,
    /// The first runs that were not as expected: number and seed.
    pub failed: Vec<(u64, u64)>,
}

/// Largest number of failed runs in totals.
const MOST_FAILED: usize = 10;
/// Largest number of values of an axis in totals.
const MOST_VALUES: usize = 1_000;

impl Totals {
    /// The values of an axis of the grid in their order, with the number of runs and of those as
    /// expected.
    pub fn of_axis<'a>(
        &'a self,
        number: usize,
        axis: &'a Axis,
    ) -> impl Iterator<Item = (&'a str, &'a (u64, u64))> {
        let counts = move |value: &'a String| {
            Some((value.as_str(), self.values.get(&(number, value.clone()))?))
        };
        axis.list().unwrap_or_default().iter().filter_map(counts)
    }

    /// Adds a row.
    pub fn add(&mut self, row: &Row) {
        let good = row.outcome.as_expected;
        self.runs += 1;
        self.as_expected += u64::from(good);
        *self.verdicts.entry(row.outcome.verdict).or_default() += 1;
        if !good {
            *self.findings.entry(row.outcome.name().to_owned()).or_default() += 1;
            if self.failed.len() < MOST_FAILED {
                self.failed.push((row.number, row.seed));
            }
        }
        for (axis, value) in row.values.iter().enumerate() {
            let key = (axis, value.clone());
            if self.values.len() < MOST_VALUES || self.values.contains_key(&key) {
                let count = self.values.entry(key).or_default();
                count.0 += 1;
                count.1 += u64::from(good);
            }
        }
    }
}
