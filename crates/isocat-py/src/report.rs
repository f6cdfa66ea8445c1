//! Reports: the results of runs.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use isocat::html;
use isocat::recording::Recording;
use isocat::report::{Finding as Found, Span};
use isocat::scenario::Scenario;
use isocat::series::{self, Series, Value};
use isocat_recorders::capture::Capture;
use isocat_recorders::trace::Trace;
use isocat_recorders::waves::Waves;
use isocat_sim::{Outcome, Tap};
use pyo3::prelude::*;

use crate::error::Failure;
use crate::plan::plain;
use crate::table::{Cell, Kind, Rows, Table};
use crate::work::{Stop, interruptible};
use crate::{output, value};

/// The result of a run.
///
/// Times are nanoseconds. The seed repeats a run exactly, so recordings can be made afterwards:
/// ``series()``, ``captures()``, ``waves()``, ``trace()`` and the page run it again with a
/// recorder.
#[pyclass(module = "isocat", frozen)]
pub struct Report {
    scenario: Scenario,
    report: isocat::Report,
}

/// Runs a scenario with a tap; ends the thread if `stop` is set.
fn execute<'tap>(
    scenario: &Scenario,
    tap: &'tap mut dyn Tap,
    stop: &Stop,
) -> Outcome<&'tap mut dyn Tap> {
    isocat_engine::watched(scenario.run(), tap, &mut |_| stop.leave_if_set())
}

impl Report {
    pub fn of(scenario: Scenario, stop: &Stop) -> Self {
        let outcome = isocat_engine::unwatched(scenario.run(), &mut |_| stop.leave_if_set());
        let report = isocat::Report::new(&scenario, &outcome);
        Self { scenario, report }
    }

    /// Runs it again with a tap, and passes the tap to `end`.
    fn again<T: Tap + Send + 'static, R: Send + 'static>(
        &self,
        py: Python<'_>,
        tap: impl FnOnce(&Scenario) -> io::Result<T> + Send + 'static,
        end: impl FnOnce(T) -> io::Result<R> + Send + 'static,
    ) -> PyResult<io::Result<R>> {
        let scenario = self.scenario.clone();
        interruptible(py, move |stop| {
            let mut tap = tap(&scenario)?;
            execute(&scenario, &mut tap, stop);
            end(tap)
        })
    }

    /// Runs it again with a tap that writes a file.
    fn to_file<T: Tap + Send + 'static>(
        &self,
        py: Python<'_>,
        path: &Path,
        tap: impl FnOnce(&Scenario, BufWriter<File>) -> io::Result<T> + Send + 'static,
        end: impl FnOnce(T) -> io::Result<()> + Send + 'static,
    ) -> PyResult<()> {
        let (scenario, to) = (self.scenario.clone(), path.to_owned());
        let written = interruptible(py, move |stop| {
            output::whole(&to, |file| {
                let mut tap = tap(&scenario, BufWriter::new(file))?;
                execute(&scenario, &mut tap, stop);
                end(tap)
            })
        })?;
        written.map_err(|error| output::raise(&error, path))
    }

    fn page(&self, py: Python<'_>) -> PyResult<String> {
        let scenario = self.scenario.clone();
        interruptible(py, move |stop| {
            let spans = html::run::spans(scenario.devices.len());
            let mut recording = Recording::new(scenario.duration, scenario.sync0_limit, spans);
            let outcome = execute(&scenario, &mut recording, stop);
            let report = isocat::Report::new(&scenario, &outcome);
            let segment = outcome.world.main().segment().clone();
            drop(outcome);
            let recorded = recording.finish();
            let (limit, command) = (scenario.sync0_limit, command(&scenario));
            html::run::Run {
                report: &report,
                recorded: &recorded,
                segment: &segment,
                limit,
                command: &command,
            }
            .page()
            .render()
        })
    }
}

/// The command that repeats the run.
fn command(scenario: &Scenario) -> String {
    let duration = scenario.duration.to_string().replace(' ', "");
    format!("isocat run {} --for {duration} --seed {}", scenario.source, scenario.seed)
}

/// A page inside another page, which keeps its own styles and its script.
pub fn frame(page: &str) -> String {
    let page = page.replace('&', "&amp;").replace('"', "&quot;");
    format!(
        "<iframe srcdoc=\"{page}\" sandbox=\"allow-scripts\" \
         style=\"width:100%;height:640px;border:1px solid #ccc\"></iframe>"
    )
}

#[pymethods]
impl Report {
    /// Whether every device ran as requested.
    #[getter]
    fn in_sync(&self) -> bool {
        self.report.in_sync
    }

    /// Whether everything that the segment's ``[[expect]]`` tables expect came true; without such
    /// tables, whether the run was in sync.
    #[getter]
    fn as_expected(&self) -> bool {
        self.report.as_expected()
    }

    /// The conclusion in one sentence.
    #[getter]
    fn verdict(&self) -> &str {
        &self.report.verdict
    }

    /// The seed of all random values.
    #[getter]
    fn seed(&self) -> u64 {
        self.report.seed
    }

    /// Virtual time that was judged, ns.
    #[getter]
    fn judged_ns(&self) -> i64 {
        self.report.judged_ns
    }

    /// Time from power-on until all devices were in OP with SYNC0 on its grid, ns; ``None`` if that
    /// was not reached.
    #[getter]
    fn time_to_sync_ns(&self) -> Option<i64> {
        self.report.segment.true_time.time_to_synchronization_ns
    }

    /// The findings against the run, in the order of time.
    #[getter]
    fn findings(&self) -> Vec<Finding> {
        self.report.findings.iter().map(Finding::of).collect()
    }

    /// Figures of each device in true time: ``position``, ``name``, ``mode``, ``state``,
    /// ``sync0_worst_ns``, ``sync0_mean_ns``, ``margin_least_ns``, ``outputs_age_most_ns``,
    /// ``inputs_age_most_ns``, ``delay_ns``, ``missed_events``.
    #[getter]
    fn devices(&self) -> Table {
        let mut rows = Rows::new([
            ("position", Kind::Integer, false),
            ("name", Kind::Text, false),
            ("profile", Kind::Text, false),
            ("mode", Kind::Text, false),
            ("state", Kind::Text, false),
            ("sync0_worst_ns", Kind::Float, true),
            ("sync0_mean_ns", Kind::Float, true),
            ("margin_least_ns", Kind::Float, true),
            ("outputs_age_most_ns", Kind::Float, true),
            ("inputs_age_most_ns", Kind::Float, true),
            ("delay_ns", Kind::Integer, true),
            ("missed_events", Kind::Integer, false),
        ]);
        for device in &self.report.devices {
            let seen = &device.true_time;
            let least = |span: Option<Span>| span.filter(|span| span.count > 0).map(|s| s.min_ns);
            let most = |span: Option<Span>| span.filter(|span| span.count > 0).map(|s| s.max_ns);
            let error = seen.sync0_error.filter(|error| error.count > 0);
            rows.push([
                Cell::Integer(device.position as i64),
                Cell::Text(&device.name),
                Cell::Text(&device.profile),
                Cell::Text(device.mode.name()),
                Cell::Text(seen.state.name()),
                error.map(|error| error.worst_ns).into(),
                error.map(|error| error.mean_ns).into(),
                least(seen.sync0_margin).into(),
                most(seen.outputs_age).into(),
                most(seen.inputs_age).into(),
                device.registers.delay_ns.into(),
                Cell::Integer(seen.missed_events as i64),
            ]);
        }
        rows.take()
    }

    /// A row for each device and cycle: errors of SYNC0, margins, states, counters
    /// (docs/exports.md).
    ///
    /// The run is repeated for this.
    ///
    /// Returns
    /// -------
    /// Table
    fn series(&self, py: Python<'_>) -> PyResult<Table> {
        let columns = series::COLUMNS.iter().map(|column| {
            let kind = match column.kind {
                series::Kind::Text => Kind::Text,
                series::Kind::Integer | series::Kind::Optional => Kind::Integer,
            };
            (column.name, kind, column.kind == series::Kind::Optional)
        });
        let rows = Shared(Arc::new(Mutex::new(Rows::new(columns))));
        let theirs = rows.0.clone();
        let tap =
            move |scenario: &Scenario| Ok(Series::new(Box::new(Shared(theirs)), names(scenario)));
        let written = self.again(py, tap, Series::finish)?;
        written.map_err(|error| output::raise(&error, Path::new("series")))?;
        Ok(rows.0.lock().unwrap_or_else(PoisonError::into_inner).take())
    }

    /// Writes every frame to a pcapng file for Wireshark; the run is repeated for this.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    /// taps : list of int
    ///     Positions of devices where frames are also recorded as they enter and leave.
    /// cables : list of int
    ///     Positions of devices with recorded frames on the cable in front of them.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file can't be written; no part of it remains.
    #[pyo3(signature = (path, /, *, taps=vec![], cables=vec![]))]
    fn captures(
        &self,
        py: Python<'_>,
        path: PathBuf,
        taps: Vec<usize>,
        cables: Vec<usize>,
    ) -> PyResult<()> {
        let devices = self.scenario.devices.len();
        if let Some(position) = taps.iter().chain(&cables).find(|position| **position >= devices) {
            let expected = format!("positions from 0 to {}", devices.saturating_sub(1));
            return Err(Failure::argument("taps", position.to_string(), expected).raise(py));
        }
        let tap = move |scenario: &Scenario, file| {
            Capture::new(file)?.with_names(names(scenario)).with_probes(&taps)?.with_cables(&cables)
        };
        self.to_file(py, &path, tap, |capture| capture.finish().map(drop))
    }

    /// Writes pulses, steps and states as waveforms (VCD), for GTKWave; the run is repeated for
    /// this.
    #[pyo3(signature = (path, /))]
    fn waves(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let tap = |scenario: &Scenario, file| Ok(Waves::new(file, names(scenario)));
        self.to_file(py, &path, tap, Waves::finish)
    }

    /// Writes frames, pulses, steps and clock errors as a trace for Perfetto; the run is repeated
    /// for this.
    #[pyo3(signature = (path, /))]
    fn trace(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let tap = |scenario: &Scenario, file| Trace::new(file, &names(scenario));
        self.to_file(py, &path, tap, Trace::finish)
    }

    /// The whole document as a ``dict`` (docs/run-report.schema.json).
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.report)
    }

    /// The page with timing diagrams, as HTML; the run is repeated for this.
    fn to_html(&self, py: Python<'_>) -> PyResult<String> {
        self.page(py)
    }

    /// Writes the report: a page with timing diagrams if the name ends in ``.html``, JSON if in
    /// ``.json``, else text.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file can't be written; an earlier file remains.
    #[pyo3(signature = (path, /))]
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let content = match output::ending(&path).as_str() {
            "html" | "htm" => self.page(py)?,
            "json" => value::json(&self.report),
            _ => plain(&self.report.text()),
        };
        output::bytes(&path, content.as_bytes()).map_err(|error| output::raise(&error, &path))
    }

    fn __str__(&self) -> String {
        plain(&self.report.text())
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Report seed {}: {}>", self.report.seed, self.report.verdict)
    }

    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        Ok(frame(&self.page(py)?))
    }
}

fn names(scenario: &Scenario) -> Vec<String> {
    scenario.devices.iter().map(|device| device.name.clone()).collect()
}

/// A finding against a run.
#[pyclass(module = "isocat", frozen, get_all)]
pub struct Finding {
    /// Its kind, for programs (docs/findings.md).
    pub kind: String,
    /// Name of the device; ``None``: the finding is about the segment.
    pub device: Option<String>,
    /// Its position.
    pub position: Option<usize>,
    /// Stage of the way up at which it happened; ``None``: it happened in operation.
    pub stage: Option<String>,
    /// When it began, ns from the beginning of the judged time; ``None``: it has no instant.
    pub since_ns: Option<i64>,
    /// Description with the figures, for people; the text may change.
    pub what: String,
}

impl Finding {
    pub fn of(found: &Found) -> Self {
        Self {
            kind: found.kind.name().to_owned(),
            device: found.device.clone(),
            position: found.position,
            stage: found.stage.map(|stage| stage.name().to_owned()),
            since_ns: found.since_ns,
            what: found.what.clone(),
        }
    }
}

#[pymethods]
impl Finding {
    fn __str__(&self) -> String {
        match &self.device {
            Some(device) => format!("{device}: {}", self.what),
            None => self.what.clone(),
        }
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Finding {}: {}>", self.kind, self.__str__())
    }
}

/// Rows that a run writes, shared with the caller.
struct Shared(Arc<Mutex<Rows>>);

impl series::Table for Shared {
    fn row(&mut self, values: &[Value<'_>; series::COLUMNS.len()]) -> io::Result<()> {
        let mut rows = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        rows.push(values.iter().map(|value| match *value {
            Value::Null => Cell::Null,
            Value::Integer(number) => Cell::Integer(number),
            Value::Text(text) => Cell::Text(text),
        }));
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}
