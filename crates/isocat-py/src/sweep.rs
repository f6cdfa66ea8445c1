//! Sweeps: one segment, many runs, one row for each.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

use isocat_engine::sweep::{self, Row, shrink};
use isocat_recorders::parquet;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyString, PyTuple};

use crate::error::{Class, Failure, OrRaise};
use crate::segment::{Described, Segment};
use crate::table::{Cell, Kind, Rows, Table};
use crate::value::{self, Times};
use crate::work::{Stop, broken, interruptible, next, spawn};

/// One segment and what is varied in it: the engine of ``isocat sweep``. Programs use
/// ``isocat.sweep``.
///
/// Runs are numbered from 0; the seed changes faster than the point of the grid. Each run has its
/// own segment file.
#[pyclass(module = "isocat._isocat", frozen)]
pub struct Sweep {
    sweep: Arc<sweep::Sweep>,
    described: Described,
    axes: Vec<Given>,
    first_seed: u64,
    seeds: u64,
    swarm: bool,
}

/// A key and its values: a list, or a range in one text.
type Given = (String, Values);

#[derive(Clone, Debug)]
enum Values {
    List(Vec<String>),
    Range(String),
}

/// Largest number of runs of a sweep.
const MOST_RUNS: u64 = 999_999_999;
/// Largest number of values of a key. Each is held against the segment file's reader before
/// anything runs, which takes 40 us.
const MOST_VALUES: usize = 100_000;
/// Time between two reports of progress.
const TICK: Duration = Duration::from_millis(100);

fn made(
    described: &Described,
    axes: &[Given],
    (first, seeds): (u64, u64),
    swarm: bool,
) -> Result<sweep::Sweep, Failure> {
    let mut sweep = sweep::Sweep::new(&described.path, &described.text())?;
    for (key, values) in axes {
        let varied = match values {
            Values::List(list) => sweep.vary_over(key, list.clone()),
            Values::Range(range) => sweep.vary(&format!("{key}={range}")),
        };
        varied.map_err(|why| Failure {
            place: Some(key.clone()),
            ..Failure::new(Class::Input, format!("grid: {why}"))
        })?;
    }
    sweep.seeds(first, seeds);
    if swarm {
        sweep.swarm();
    }
    let runs = sweep.runs();
    if runs > MOST_RUNS {
        let expected =
            format!("{MOST_RUNS} at most: fewer values, ranges (\"1m..100m\"), or fewer seeds");
        let found = match runs {
            u64::MAX => "more runs than can be counted".to_owned(),
            runs => format!("{runs} runs"),
        };
        let name = if axes.is_empty() { "seeds" } else { "grid" };
        return Err(Failure::argument(name, found, expected));
    }
    Ok(sweep)
}

/// Checks each value of the grid.
fn check(sweep: &sweep::Sweep) -> Result<(), Failure> {
    sweep.check().map_err(|(value, error)| {
        let failure = Failure::from(error);
        Failure {
            message: format!("grid, {value}: {}", failure.message),
            place: Some(value),
            ..failure
        }
    })
}

/// The values of the grid, as texts.
fn given(grid: &Bound<'_, PyDict>) -> PyResult<Vec<Given>> {
    let times = Times::new();
    let mut axes = Vec::new();
    for (key, values) in grid.iter() {
        let py = grid.py();
        let key: String = key.extract().map_err(|_| {
            let found = key.repr().map_or_else(|_| "?".to_owned(), |text| text.to_string());
            Failure::argument("grid", found, "keys of a segment file, such as \"host.jitter\"")
                .raise(py)
        })?;
        let text = |one: &Bound<'_, PyAny>| value::text(&times, &key, one);
        let values = match values.cast::<PyString>() {
            Ok(range) if range.to_string().contains("..") => Values::Range(range.to_string()),
            Ok(one) => Values::List(vec![one.to_string()]),
            Err(_) if values.cast::<PyDict>().is_err() && values.try_iter().is_ok() => {
                let too_many = || {
                    let found = format!("more than {MOST_VALUES} values");
                    let expected =
                        "fewer, or a range (\"1m..100m\"), from which each run draws a value";
                    Failure::argument(&key, found, expected).raise(py)
                };
                // Something endless has no length.
                if values.len().is_ok_and(|count| count > MOST_VALUES) {
                    return Err(too_many());
                }
                let mut list = Vec::new();
                for one in values.try_iter()? {
                    if list.len() == MOST_VALUES {
                        return Err(too_many());
                    }
                    list.push(text(&one?)?);
                }
                Values::List(list)
            }
            Err(_) => Values::List(vec![text(&values)?]),
        };
        axes.push((key, values));
    }
    Ok(axes)
}

#[pymethods]
impl Sweep {
    #[new]
    #[pyo3(signature = (segment, grid, first_seed, seeds, swarm))]
    fn new(
        py: Python<'_>,
        segment: &Bound<'_, Segment>,
        grid: &Bound<'_, PyDict>,
        first_seed: u64,
        seeds: u64,
        swarm: bool,
    ) -> PyResult<Self> {
        let made = Self::_unpickle(py, segment, grid, first_seed, seeds, swarm)?;
        py.detach(|| check(&made.sweep)).or_raise(py)?;
        Ok(made)
    }

    /// Restores a sweep from what `__reduce__` returned: its values have been checked, and a worker
    /// need not do so again for each batch.
    #[staticmethod]
    fn _unpickle(
        py: Python<'_>,
        segment: &Bound<'_, Segment>,
        grid: &Bound<'_, PyDict>,
        first_seed: u64,
        seeds: u64,
        swarm: bool,
    ) -> PyResult<Self> {
        let (described, axes) = (segment.get().described(), given(grid)?);
        let sweep =
            py.detach(|| made(&described, &axes, (first_seed, seeds), swarm)).or_raise(py)?;
        Ok(Self { sweep: Arc::new(sweep), described, axes, first_seed, seeds, swarm })
    }

    /// The number of runs.
    #[getter]
    fn runs(&self) -> u64 {
        self.sweep.runs()
    }

    /// The number of seeds for each point of the grid.
    #[getter]
    fn seeds(&self) -> u64 {
        self.seeds
    }

    /// The keys that are varied, with their values; ``None``: the values are drawn.
    #[getter]
    fn axes(&self) -> Vec<(String, Option<Vec<String>>)> {
        let axes = self.sweep.axes().iter();
        axes.map(|axis| (axis.key.clone(), axis.list().map(<[String]>::to_vec))).collect()
    }

    /// The sizes of an axis's values, by which they can be sorted; ``None``: they are neither times
    /// nor numbers with the same unit.
    fn sizes(&self, key: &str) -> Option<Vec<f64>> {
        self.sweep.axes().iter().find(|axis| axis.key == key).and_then(sweep::Axis::sizes)
    }

    /// The seed of a run.
    fn seed(&self, number: u64) -> u64 {
        self.first_seed + number % self.seeds
    }

    /// The values of a run, by key.
    fn values<'py>(
        &self,
        py: Python<'py>,
        number: &Bound<'_, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (case, dict) = (self.case(py, number)?, PyDict::new(py));
        for (axis, value) in self.sweep.axes().iter().zip(&case.values) {
            dict.set_item(&axis.key, value)?;
        }
        Ok(dict)
    }

    /// A run as an independent segment.
    fn segment(&self, py: Python<'_>, number: &Bound<'_, PyAny>) -> PyResult<Segment> {
        let text = self.case(py, number)?.text;
        let path = self.described.path.clone();
        let segment = py.get_type::<Segment>().call_method1("from_toml", (text, path))?;
        Ok(segment.cast::<Segment>()?.get().copy())
    }

    /// The text of a run, shrunk as far as the verdict and the kind of the first finding stay the
    /// same.
    fn shrink(&self, py: Python<'_>, number: &Bound<'_, PyAny>) -> PyResult<String> {
        let (sweep, text) = (self.sweep.clone(), self.case(py, number)?.text);
        interruptible(py, move |stop| {
            let whole = sweep.outcome(&text);
            shrink::shrink(&text, |text| {
                stop.leave_if_set();
                sweep.outcome(text).is_like(&whole)
            })
        })
    }

    /// Runs the cases from ``start`` up to ``stop`` in order, on this number of threads.
    ///
    /// ``each`` gets a table of every ``batch`` rows. ``tick`` gets, from time to time, the number
    /// of finished runs and how many of them were not as expected. An exception from either ends
    /// the sweep.
    fn run(
        &self,
        py: Python<'_>,
        start: u64,
        stop: u64,
        threads: usize,
        batch: usize,
        each: &Bound<'_, PyAny>,
        tick: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (flag, (sender, mut receiver)) = (Stop::default(), sync_channel(4_096));
        let (theirs, sweep) = (flag.clone(), self.sweep.clone());
        let thread = spawn(py, move || {
            let send = |row: Row| SyncSender::send(&sender, row);
            // The receiver is gone if the caller was interrupted.
            let _ = sweep.run_range(start..stop, threads, theirs.flag(), send);
        })?;
        let mut rows = self.rows();
        let (mut told, mut over, mut bad) = (Instant::now(), 0_u64, 0_u64);
        let mut take = |row: &Row, rows: &mut Rows| -> PyResult<()> {
            push(&self.sweep, rows, row);
            over += 1;
            bad += u64::from(!row.outcome.as_expected);
            if rows.len() >= batch {
                each.call1((rows.take(),))?;
            }
            if told.elapsed() >= TICK || row.number + 1 == stop {
                told = Instant::now();
                tick.call1((over, bad))?;
            }
            Ok(())
        };
        let mut work = || -> PyResult<()> {
            while let Some(row) = next(py, &flag, &mut receiver)? {
                take(&row, &mut rows)?;
                while let Ok(row) = receiver.try_recv() {
                    take(&row, &mut rows)?;
                }
            }
            Ok(())
        };
        let worked = work();
        let wanted = stop.min(self.sweep.runs()).saturating_sub(start);
        // In any case, threads stop at their next run.
        flag.set();
        worked?;
        if rows.len() > 0 {
            each.call1((rows.take(),))?;
        }
        if over < wanted {
            return Err(broken(py, thread));
        }
        Ok(())
    }

    /// The part of a worker: the rows of the cases from ``start`` up to ``stop``, on this number of
    /// threads.
    fn table(&self, py: Python<'_>, start: u64, stop: u64, threads: usize) -> PyResult<Table> {
        let sweep = self.sweep.clone();
        let mut rows = self.rows();
        let found = interruptible(py, move |flag| {
            let mut found = Vec::new();
            let _: Result<(), ()> = sweep.run_range(start..stop, threads, flag.flag(), |row| {
                found.push(row);
                Ok(())
            });
            found
        })?;
        found.iter().for_each(|row| push(&self.sweep, &mut rows, row));
        Ok(rows.take())
    }

    /// A table without rows.
    fn empty(&self) -> Table {
        self.rows().take()
    }

    /// What distinguishes this sweep from others: version, segment, axes, seeds, faults.
    fn identity(&self) -> String {
        let axes: Vec<(&str, String)> =
            self.axes.iter().map(|(key, values)| (key.as_str(), format!("{values:?}"))).collect();
        value::json(&serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"),
            "path": self.described.path,
            "segment": self.described.text(),
            "axes": axes,
            "first_seed": self.first_seed,
            "seeds": self.seeds,
            "swarm": self.swarm,
        }))
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Sweep of {}: {} runs>", self.described.path, self.sweep.runs())
    }

    fn __reduce__<'py>(
        slf: Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, this) = (slf.py(), slf.get());
        let grid = PyDict::new(py);
        for (key, values) in &this.axes {
            match values {
                Values::List(list) => grid.set_item(key, PyList::new(py, list)?)?,
                Values::Range(range) => grid.set_item(key, range)?,
            }
        }
        let unpickle = py.get_type::<Segment>().getattr("_unpickle")?;
        let segment = unpickle.call1((this.described.text(), &this.described.path))?;
        let arguments = (segment, grid, this.first_seed, this.seeds, this.swarm);
        Ok((slf.get_type().getattr("_unpickle")?, arguments.into_pyobject(py)?))
    }
}

impl Sweep {
    fn case(&self, py: Python<'_>, number: &Bound<'_, PyAny>) -> PyResult<sweep::Case> {
        let number = value::unsigned("number", number)?;
        if number >= self.sweep.runs() {
            let expected = format!("a run from 0 to {}", self.sweep.runs() - 1);
            return Err(Failure::argument("number", number.to_string(), expected).raise(py));
        }
        let case = self.sweep.case(number);
        case.map_err(|why| Failure::new(Class::Input, why).raise(py))
    }

    /// Empty rows with the columns of ``isocat sweep --rows``.
    fn rows(&self) -> Rows {
        let head = [("number", Kind::Integer, false), ("seed", Kind::Integer, false)];
        let head = head.map(|(name, kind, optional)| (name.to_owned(), kind, optional));
        let axes = self.sweep.axes().iter().map(|axis| {
            let kind = if axis.is_whole() { Kind::Integer } else { Kind::Text };
            (axis.key.clone(), kind, true)
        });
        let rest = Row::COLUMNS.map(|(name, kind, optional)| {
            let kind = match kind {
                parquet::Kind::Integer => Kind::Integer,
                parquet::Kind::Float => Kind::Float,
                parquet::Kind::Flag => Kind::Flag,
                parquet::Kind::Text => Kind::Text,
            };
            (name.to_owned(), kind, optional)
        });
        Rows::new(head.into_iter().chain(axes).chain(rest))
    }
}

fn push(sweep: &sweep::Sweep, rows: &mut Rows, row: &Row) {
    let head = [row.number, row.seed].map(|number| Cell::Integer(number as i64));
    let axes = sweep.axes().iter().enumerate().map(|(number, axis)| match row.values.get(number) {
        // A run that was refused early has no value.
        None => Cell::Null,
        Some(text) if axis.is_whole() => text.parse().map_or(Cell::Null, Cell::Integer),
        Some(text) => Cell::Text(text),
    });
    let rest = row.cells();
    let rest = rest.iter().map(|cell| match *cell {
        parquet::Cell::Null => Cell::Null,
        parquet::Cell::Integer(value) => Cell::Integer(value),
        parquet::Cell::Float(value) => Cell::Float(value),
        parquet::Cell::Flag(value) => Cell::Flag(value),
        parquet::Cell::Text(value) => Cell::Text(value),
    });
    rows.push(head.into_iter().chain(axes).chain(rest));
}
