//! Segments: the devices on the wire, and their set-up.

use std::path::PathBuf;
use std::sync::Mutex;

use isocat::scenario::Scenario;
use isocat_descriptions::{FileError, limits};
use isocat_engine::sweep;
use isocat_segment::{SegmentFile, profile};
use isocat_wire::Nanos;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyTuple};
use toml::{Table, Value};

use crate::bus::Bus;
use crate::error::{Class, Failure, OrRaise};
use crate::plan::Plan;
use crate::report::Report;
use crate::time::time_within;
use crate::value::{self, Times};
use crate::work::interruptible;

/// The longest time of a run.
pub const LONGEST: Nanos = Nanos::millis(24 * 3_600_000);

/// A segment: the devices on the wire, how they are synchronized, and for how long it runs.
///
/// Parameters
/// ----------
/// source : str, os.PathLike, dict or Segment, optional
///     A segment file to read, or its content as a mapping; without it, the segment is built by
///     calls.
/// **keys
///     Keys of a segment file (``cycle="1ms"``, ``host={"jitter": "5us"}``), which override those
///     of ``source``. ``for_`` stands for ``for``. The value of a time is whole nanoseconds, a text
///     with a unit, or a ``timedelta``.
///
/// Raises
/// ------
/// InputError
///     A key is unknown or a value is invalid: the message has the place, what was found and what
///     was expected.
/// OSError
///     The file can't be read.
///
/// Examples
/// --------
/// >>> seg = isocat.Segment(cycle="1ms")
/// >>> seg.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
/// 0
/// >>> seg.run("2s").in_sync
/// True
#[pyclass(module = "isocat", frozen)]
pub struct Segment {
    inside: Mutex<Described>,
}

/// The description of a segment: the file's table, and its origin.
#[derive(Clone, PartialEq, Debug)]
pub struct Described {
    pub table: Table,
    /// The file, or a name in angle brackets.
    pub path: String,
    /// The text as it was read, so that line numbers in messages are those of the user's file.
    pub text: Option<String>,
}

/// A device for checking keys while the segment has no devices.
const STAND_IN: &str = "\n[[subdevice]]\ndevice = \"simple_io16\"\n";
/// The name of a segment without a file.
const UNNAMED: &str = "<segment>";

impl Described {
    /// The file's text.
    pub fn text(&self) -> String {
        self.text.clone().unwrap_or_else(|| self.table.to_string())
    }

    /// Whether the user has the text: then a line number is enough as place.
    fn is_file(&self) -> bool {
        self.text.is_some()
    }

    fn parse(&self) -> Result<SegmentFile, Failure> {
        let text = self.text();
        SegmentFile::parse(&self.path, &text).map_err(|error| self.failure(&text, error))
    }

    /// Makes an error. For a text that the user does not have, it includes the line.
    fn failure(&self, text: &str, error: FileError) -> Failure {
        let line = text.lines().nth(error.line.wrapping_sub(1)).filter(|_| !self.is_file());
        let mut failure = Failure::from(error);
        if let Some(line) = line {
            failure.message = format!("{}\n  in: {}", failure.message, line.trim());
        }
        failure
    }

    pub fn scenario(&self) -> Result<Scenario, Failure> {
        self.parse().map(Scenario::from)
    }

    /// Refuses a description that can't become a segment, whether or not it has devices yet.
    fn check(&self) -> Result<(), Failure> {
        if self.is_file() || !self.devices().is_empty() {
            return self.parse().map(drop);
        }
        let mut table = self.table.clone();
        table.remove("subdevice");
        table.entry("cycle").or_insert_with(|| Value::String("1ms".to_owned()));
        let text = table.to_string();
        let own = text.lines().count();
        match SegmentFile::parse(&self.path, &(text.clone() + STAND_IN)) {
            Err(error) if error.line <= own => Err(self.failure(&text, error)),
            _ => Ok(()),
        }
    }

    fn devices(&self) -> &[Value] {
        self.table.get("subdevice").and_then(Value::as_array).map_or(&[], Vec::as_slice)
    }

    /// The names of its devices, which were given or numbered by the reader.
    fn names(&self) -> Result<Vec<String>, Failure> {
        if self.devices().is_empty() && !self.is_file() {
            return Ok(Vec::new());
        }
        Ok(self.parse()?.subdevices.iter().map(|device| device.name.clone()).collect())
    }
}

impl Segment {
    pub fn described(&self) -> Described {
        self.inside.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone()
    }

    fn new_of(described: Described) -> Self {
        Self { inside: Mutex::new(described) }
    }

    /// Replaces the description, if the new one is valid.
    fn change(&self, described: Described) -> Result<(), Failure> {
        described.check()?;
        *self.inside.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = described;
        Ok(())
    }

    /// The scenario of a run.
    fn scenario(
        &self,
        duration: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
        py: Python<'_>,
    ) -> PyResult<Scenario> {
        let seed = seed.map(|seed| value::unsigned("seed", seed)).transpose()?;
        let duration =
            duration.map(|for_| time_within("for_", for_, Nanos(1), LONGEST)).transpose()?;
        let described = self.described();
        let mut scenario = py.detach(|| described.scenario()).or_raise(py)?;
        scenario.duration = duration.unwrap_or(scenario.duration);
        scenario.seed = seed.unwrap_or(scenario.seed);
        if scenario.duration < scenario.cycle {
            let expected = format!("{} at least, which is one cycle", scenario.cycle);
            let found = scenario.duration.to_string();
            return Err(Failure::argument("for_", found, expected).raise(py));
        }
        Ok(scenario)
    }
}

fn of_text(path: &str, text: &str) -> Result<Described, Failure> {
    SegmentFile::parse(path, text)?;
    let table = text.parse::<Table>();
    // A text that the reader of segment files accepted is TOML.
    let table = table.map_err(|error| Failure::new(Class::Internal, error.to_string()))?;
    Ok(Described { table, path: path.to_owned(), text: Some(text.to_owned()) })
}

fn of_file(py: Python<'_>, path: &str) -> PyResult<Described> {
    // `open` raises the usual Python exception if the file can't be read.
    if let Err(error) = std::fs::File::open(path) {
        return Err(crate::output::raise(&error, path.as_ref()));
    }
    let read = || limits::read_text(path, limits::TOML).map_err(Failure::from);
    py.detach(|| of_text(path, &read()?)).or_raise(py)
}

#[pymethods]
impl Segment {
    #[new]
    #[pyo3(signature = (source=None, /, **keys))]
    fn new(
        py: Python<'_>,
        source: Option<&Bound<'_, PyAny>>,
        keys: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let times = Times::new();
        let mut described = match source {
            None => Described { table: Table::new(), path: UNNAMED.to_owned(), text: None },
            Some(other) if other.is_instance_of::<Self>() => {
                other.cast::<Self>()?.get().described()
            }
            Some(path) if path.is_instance_of::<PyString>() || path.hasattr("__fspath__")? => {
                let path: PathBuf = path.extract()?;
                let path = path.display().to_string();
                if path.contains('\n') {
                    let expected = "the path of a file; Segment.from_toml takes a text";
                    return Err(Failure::argument("source", "several lines", expected).raise(py));
                }
                of_file(py, &path)?
            }
            Some(mapping) => Described {
                table: value::table(&times, "", mapping)?,
                path: UNNAMED.to_owned(),
                text: None,
            },
        };
        if let Some(keys) = keys.filter(|keys| !keys.is_empty()) {
            described.table.extend(value::table(&times, "", keys.as_any())?);
            described.text = None;
        }
        described.check().or_raise(py)?;
        Ok(Self::new_of(described))
    }

    /// Reads a segment file.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     Relative paths in the file begin at its folder.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The content is invalid; the message has line and column.
    /// OSError
    ///     The file can't be read.
    #[staticmethod]
    #[pyo3(signature = (path, /))]
    fn from_file(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        of_file(py, &path.display().to_string()).map(Self::new_of)
    }

    /// Reads the text of a segment file.
    ///
    /// Parameters
    /// ----------
    /// text : str
    /// path : str, optional
    ///     The name in messages; relative paths in the text begin at its folder.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The text is invalid; the message has line and column.
    #[staticmethod]
    #[pyo3(signature = (text, path=None))]
    fn from_toml(py: Python<'_>, text: &str, path: Option<&str>) -> PyResult<Self> {
        of_text(path.unwrap_or("<text>"), text).or_raise(py).map(Self::new_of)
    }

    /// The built-in segment: two drives, a coupler with a terminal, and a third drive, at 1 ms.
    #[staticmethod]
    fn built_in(py: Python<'_>) -> PyResult<Self> {
        of_text("built-in segment", SegmentFile::built_in_text()).or_raise(py).map(Self::new_of)
    }

    /// Adds a device after the others.
    ///
    /// Parameters
    /// ----------
    /// device : str, optional
    ///     A built-in profile (``isocat.devices()`` lists them) or a profile file; not with
    ///     ``esi=``.
    /// **keys
    ///     Keys of a ``[[subdevice]]`` table: ``name``, ``mode``, ``cable``, ``clock``, ``esi`` and
    ///     ``type``, ...
    ///
    /// Returns
    /// -------
    /// int
    ///     Its position, from 0.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     A key or value is invalid. The segment is unchanged.
    #[pyo3(signature = (device=None, /, **keys))]
    fn add(
        &self,
        py: Python<'_>,
        device: Option<&str>,
        keys: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<usize> {
        let mut described = self.described();
        let mut one = match keys {
            Some(keys) => value::table(&Times::new(), "subdevice", keys.as_any())?,
            None => Table::new(),
        };
        if let Some(device) = device {
            one.insert("device".to_owned(), Value::String(device.to_owned()));
        }
        let devices =
            described.table.entry("subdevice").or_insert_with(|| Value::Array(Vec::new()));
        let Some(devices) = devices.as_array_mut() else {
            return Err(
                Failure::argument("subdevice", "another value", "a list of tables").raise(py)
            );
        };
        devices.push(Value::Table(one));
        described.text = None;
        if !described.table.contains_key("cycle") {
            let expected = "the bus cycle first, such as isocat.Segment(cycle=\"1ms\")";
            return Err(Failure::argument("cycle", "nothing", expected).raise(py));
        }
        let before = self.described().names().or_raise(py)?.len();
        self.change(described).or_raise(py)?;
        Ok(before)
    }

    /// Sets a key anywhere in the segment.
    ///
    /// Parameters
    /// ----------
    /// key : str
    ///     The key as in a sweep: ``"cycle"``, ``"host.jitter"``, ``"subdevice[0].mode"``,
    ///     ``"subdevice[*].cable"``.
    /// value
    ///     A text, a number, a flag or a time.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such key, or the value is invalid. The segment is unchanged.
    fn set(&self, py: Python<'_>, key: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut described = self.described();
        let text = value::text(&Times::new(), key, value)?;
        let set = sweep::set(&mut described.table, key, &text);
        set.map_err(|why| {
            Failure { place: Some(key.to_owned()), ..Failure::new(Class::Input, why) }.raise(py)
        })?;
        described.text = None;
        self.change(described).or_raise(py)
    }

    /// Names of the devices, by position.
    #[getter]
    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.described().names().or_raise(py)
    }

    /// The path that it was read from; ``"<segment>"`` if it was built by calls.
    #[getter]
    fn path(&self) -> String {
        self.described().path
    }

    /// Bus cycle, ns.
    #[getter]
    fn cycle_ns(&self, py: Python<'_>) -> PyResult<i64> {
        Ok(self.described().parse().or_raise(py)?.cycle.0)
    }

    /// The segment as the text of a segment file.
    fn to_toml(&self) -> String {
        self.described().text()
    }

    /// The segment as a ``dict``, from which ``isocat.Segment`` makes an equal one.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        value::dict(py, &self.described().table)
    }

    /// Writes the segment as a segment file, for ``isocat run`` and other uses.
    #[pyo3(signature = (path, /))]
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let text = self.to_toml();
        crate::output::bytes(&path, text.as_bytes())
            .map_err(|error| crate::output::raise(&error, &path))
    }

    /// An independent segment with the same content.
    pub fn copy(&self) -> Self {
        Self::new_of(self.described())
    }

    /// Plans the cycle: frames, phases, and the slack of every demand. Sends nothing.
    ///
    /// Parameters
    /// ----------
    /// suggest : bool
    ///     Also search the phase with the most even slack and the smallest cycle that fits.
    ///
    /// Returns
    /// -------
    /// Plan
    ///     Lines that do not fit are no error: see ``plan.fits``.
    ///
    /// Raises
    /// ------
    /// PlanError
    ///     The segment can't be planned at all.
    #[pyo3(signature = (*, suggest=false))]
    fn plan(&self, py: Python<'_>, suggest: bool) -> PyResult<Plan> {
        let scenario = self.scenario(None, None, py)?;
        Plan::make(py, scenario, suggest, false)
    }

    /// Plans the segment, runs it with the worst jitter of the plan, and compares each line of the
    /// plan with the run.
    ///
    /// Parameters
    /// ----------
    /// for_ : int, str or timedelta, optional
    ///     How long it runs after all devices are in OP; by default as the segment says.
    /// seed : int, optional
    ///
    /// Returns
    /// -------
    /// Plan
    ///     The plan with ``plan.proven``.
    #[pyo3(signature = (for_=None, *, seed=None))]
    fn prove(
        &self,
        py: Python<'_>,
        for_: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Plan> {
        let scenario = self.scenario(for_, seed, py)?;
        Plan::make(py, scenario, false, true)
    }

    /// Brings the segment up, runs it and judges it, in virtual time.
    ///
    /// Meanwhile other threads of Python run, and Ctrl-C ends the run.
    ///
    /// Parameters
    /// ----------
    /// for_ : int, str or timedelta, optional
    ///     How long it is judged after all devices are in OP: nanoseconds, ``"10s"``, or a
    ///     ``timedelta``; by default as the segment says, or ``"10s"``.
    /// seed : int, optional
    ///     Seed of all random values; the same seed gives the same run.
    /// force : bool
    ///     Run even if the plan does not fit.
    /// tolerate : bool
    ///     Continue without devices that fail on the way up.
    ///
    /// Returns
    /// -------
    /// Report
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The segment or an argument is invalid. A plan that does not fit raises nothing: the
    ///     report says so.
    #[pyo3(signature = (for_=None, *, seed=None, force=false, tolerate=false))]
    fn run(
        &self,
        py: Python<'_>,
        for_: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
        force: bool,
        tolerate: bool,
    ) -> PyResult<Report> {
        let mut scenario = self.scenario(for_, seed, py)?;
        (scenario.force, scenario.tolerate) = (force, tolerate);
        interruptible(py, move |stop| Report::of(scenario, stop))
    }

    /// The segment as a wire in virtual time: frames in and out, process data, faults, a verdict.
    ///
    /// Parameters
    /// ----------
    /// seed : int, optional
    /// now : int, str or timedelta
    ///     The present of the caller's clock when the devices are switched on.
    /// behaviours : dict, optional
    ///     For devices by name or position, the object that is the application. See
    ///     docs/python.md.
    ///
    /// Returns
    /// -------
    /// Bus
    #[pyo3(signature = (*, seed=None, now=None, behaviours=None))]
    fn bus(
        &self,
        py: Python<'_>,
        seed: Option<&Bound<'_, PyAny>>,
        now: Option<&Bound<'_, PyAny>>,
        behaviours: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Bus> {
        let seed = seed.map(|seed| value::unsigned("seed", seed)).transpose()?;
        let mut scenario = py.detach(|| self.described().scenario()).or_raise(py)?;
        scenario.seed = seed.unwrap_or(scenario.seed);
        Bus::make(py, &scenario, now, behaviours)
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.names(py)?.len())
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| {
            let (one, other) = (self.described(), other.get().described());
            one.table == other.table && one.path == other.path
        })
    }

    fn __hash__(&self) -> PyResult<isize> {
        Err(pyo3::exceptions::PyTypeError::new_err(
            "segments can be changed, so they can't be hashed",
        ))
    }

    fn __repr__(&self) -> String {
        let described = self.described();
        let cycle = described.table.get("cycle").and_then(Value::as_str).unwrap_or("no cycle");
        let devices = match described.names() {
            Ok(names) if names.is_empty() => ", no devices".to_owned(),
            Ok(names) => format!(", {}", names.join(", ")),
            Err(_) => String::new(),
        };
        format!("<isocat.Segment {}: {cycle}{devices}>", described.path)
    }

    fn __reduce__<'py>(
        slf: Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let described = slf.get().described();
        let arguments = (described.text(), described.path);
        Ok((slf.get_type().getattr("_unpickle")?, arguments.into_pyobject(slf.py())?))
    }

    /// Restores a segment from what `__reduce__` returned.
    #[staticmethod]
    fn _unpickle(py: Python<'_>, text: &str, path: &str) -> PyResult<Self> {
        let table = text.parse::<Table>().map_err(|error| {
            Failure::argument("text", error.to_string(), "that of a pickled segment").raise(py)
        })?;
        let text = (!path.starts_with('<')).then(|| text.to_owned());
        Ok(Self::new_of(Described { table, path: path.to_owned(), text }))
    }
}

/// The built-in device profiles.
///
/// Returns
/// -------
/// list of str
///     Names for ``Segment.add``.
#[pyfunction]
pub fn devices() -> Vec<&'static str> {
    profile::built_in_ids().collect()
}
