//! Buses: a segment in virtual time as the wire of MainDevices and machines that are written in
//! Python.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError, TryLockError};

use isocat::fault::Order;
use isocat::html;
use isocat::scenario::Scenario;
use isocat::serve::bus::{Arrival, LONGEST, Refused};
use isocat::serve::summary::{DeviceSummary, Outcome};
use isocat::serve::{self, Answer, Setup, Summary};
use isocat_engine::verdict;
use isocat_sim::MainPort;
use isocat_wire::Nanos;
use isocat_wire::time::{Host, Time};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyString};

use crate::behaviour::{Behaviour, Raised};
use crate::error::{Class, Failure, OrRaise};
use crate::plan::plain;
use crate::report::frame;
use crate::table::{Cell, Kind, Rows, Table};
use crate::time::time_within;
use crate::{output, value};

/// A segment in virtual time: frames are sent at instants, and answers come back when their last
/// bit has arrived.
///
/// Instants are nanoseconds of the caller's clock. Only the caller advances time, and never back;
/// the same calls always return the same answers, bit for bit. A bus is for one thread at a time.
///
/// Examples
/// --------
/// >>> with isocat.Segment.built_in().bus() as bus:
/// ...     back, answer = bus.exchange(frame, at="1ms")
/// ...     bus.verdict().answer
/// 'not-known'
#[pyclass(module = "isocat", frozen)]
pub struct Bus {
    inside: Mutex<Option<Inside>>,
    raised: Raised,
    names: Vec<String>,
    source: String,
}

struct Inside {
    bus: serve::Bus,
    /// Answers that came back while ``exchange`` waited for another one.
    kept: VecDeque<Arrival>,
    /// Inputs that were set by the caller, by position.
    inputs: BTreeMap<usize, Vec<u8>>,
}

impl From<Refused> for Failure {
    fn from(refused: Refused) -> Self {
        Self::new(Class::Bus, refused.to_string())
    }
}

/// Time advances in steps of this size, so that Ctrl-C is handled in between; the size does not
/// change the result.
const STEP: Nanos = Nanos::millis(100);

impl Bus {
    pub fn make(
        py: Python<'_>,
        scenario: &Scenario,
        now: Option<&Bound<'_, PyAny>>,
        behaviours: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let latest = Nanos(i64::MAX - LONGEST.0);
        let now = now.map(|now| time_within("now", now, Nanos(0), latest)).transpose()?;
        let names: Vec<String> = scenario.devices.iter().map(|d| d.name.clone()).collect();
        let (raised, mut setup) = (Raised::default(), Setup::from(scenario));
        for (which, object) in behaviours.into_iter().flat_map(|given| given.iter()) {
            let position = position(&names, &which)?;
            setup = setup.with_application(position, Behaviour::of(&object, raised.clone())?);
        }
        let now = Time::new(now.map_or(0, |now| now.0 as u64));
        let bus = py.detach(|| serve::Bus::new(setup, now));
        let inside = Inside { bus, kept: VecDeque::new(), inputs: BTreeMap::new() };
        let made = Self {
            inside: Mutex::new(Some(inside)),
            raised,
            names,
            source: scenario.source.clone(),
        };
        made.check(py)?;
        Ok(made)
    }

    /// Calls `work` with the bus, without the interpreter's lock; then raises what a behaviour
    /// raised.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Inside) -> Result<T, Failure> + Send,
    ) -> PyResult<T> {
        let worked = py.detach(|| match self.inside.try_lock() {
            Ok(mut inside) => match inside.as_mut() {
                Some(inside) => work(inside),
                None => Err(Failure::new(Class::Bus, "the bus is closed; expected one that is open")),
            },
            Err(TryLockError::WouldBlock) => Err(Failure::new(
                Class::Bus,
                "the bus is in use: by another thread, or by the call that this one comes from; expected one call \
                 at a time",
            )),
            Err(TryLockError::Poisoned(_)) => Err(Failure::new(
                Class::Internal,
                "a fault in isocat itself happened on this bus, please report it; it can't be used any more",
            )),
        });
        self.check(py)?;
        worked.or_raise(py)
    }

    fn check(&self, _: Python<'_>) -> PyResult<()> {
        self.raised.take().map_or(Ok(()), Err)
    }

    /// Advances time, and handles signals in between.
    fn advance_to(&self, py: Python<'_>, to: Time<Host>) -> PyResult<()> {
        // An instant that is refused must be refused before anything happens.
        self.with(py, |inside| Ok(inside.bus.check_plan(to)?))?;
        loop {
            let at = self.with(py, |inside| {
                let step = inside.bus.now().count().saturating_add(STEP.0 as u64);
                inside.bus.advance(Time::new(step).min(to))?;
                Ok(inside.bus.now())
            })?;
            if at >= to {
                return Ok(());
            }
            py.check_signals()?;
        }
    }

    fn instant(
        &self,
        py: Python<'_>,
        name: &str,
        at: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Time<Host>> {
        match at {
            None => self.with(py, |inside| Ok(inside.bus.now())),
            Some(at) => {
                let at = time_within(name, at, Nanos(0), Nanos(i64::MAX))?;
                Ok(Time::new(at.0 as u64))
            }
        }
    }

    fn send_at(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        at: Option<&Bound<'_, PyAny>>,
        port: u8,
    ) -> PyResult<Answer> {
        let bytes: Vec<u8> = match frame.cast::<PyBytes>() {
            Ok(bytes) => bytes.as_bytes().to_vec(),
            Err(_) => frame.extract().map_err(|_| {
                let found = frame
                    .get_type()
                    .name()
                    .map_or_else(|_| "?".to_owned(), |name| name.to_string());
                Failure::argument("frame", found, "bytes").raise(py)
            })?,
        };
        let port = self::port(port).or_raise(py)?;
        let at = self.instant(py, "at", at)?;
        self.with(py, |inside| Ok(inside.bus.send(port, at, &bytes)?))
    }
}

fn port(number: u8) -> Result<MainPort, Failure> {
    match number {
        0 => Ok(MainPort::Primary),
        1 => Ok(MainPort::Secondary),
        _ => Err(Failure::argument("port", number.to_string(), "0, or 1 in a ring")),
    }
}

/// The position of a device that is given by name or position.
fn position(names: &[String], which: &Bound<'_, PyAny>) -> PyResult<usize> {
    let py = which.py();
    if let Ok(name) = which.cast::<PyString>() {
        let name = name.to_string();
        return names.iter().position(|other| *other == name).ok_or_else(|| {
            let hint = isocat::document::name_hint(&name, names.iter().map(String::as_str));
            Failure::argument("device", name, "the name of a device").with_hint(hint).raise(py)
        });
    }
    let found = || which.repr().map_or_else(|_| "?".to_owned(), |text| text.to_string());
    let last = names.len().saturating_sub(1);
    let expected = || format!("a name, or a position from 0 to {last}");
    let number = which.extract::<usize>().ok().filter(|number| *number < names.len());
    number.ok_or_else(|| Failure::argument("device", found(), expected()).raise(py))
}

#[pymethods]
impl Bus {
    /// The present, ns.
    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |inside| Ok(inside.bus.now().count()))
    }

    /// Names of the devices, by position.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    /// Sends a frame; time advances to its instant.
    ///
    /// Parameters
    /// ----------
    /// frame : bytes
    ///     14 to 1514 bytes, from the destination address on, without check sequence.
    /// at : int, str or timedelta, optional
    ///     When its first bit leaves; now by default. It leaves after the previous frame has left.
    /// port : int
    ///     0, or 1 for the other end of a ring.
    ///
    /// Returns
    /// -------
    /// int or None
    ///     When the last bit of its answer is back, ns; ``None`` if the answer is lost.
    ///
    /// Raises
    /// ------
    /// BusError
    ///     The instant has passed or is too far ahead, the frame has a wrong length, or there is no
    ///     such port.
    #[pyo3(signature = (frame, at=None, *, port=0))]
    fn send(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        at: Option<&Bound<'_, PyAny>>,
        port: u8,
    ) -> PyResult<Option<u64>> {
        Ok(match self.send_at(py, frame, at, port)? {
            Answer::Back { last_bit, .. } => Some(last_bit.count()),
            Answer::Lost => None,
        })
    }

    /// Sends a frame, advances time to its answer and returns that.
    ///
    /// Returns
    /// -------
    /// tuple of (int, bytes), or None
    ///     When the last bit of the answer came back, and the answer; ``None`` if it is lost. Other
    ///     answers remain for ``receive``.
    #[pyo3(signature = (frame, at=None, *, port=0))]
    fn exchange<'py>(
        &self,
        py: Python<'py>,
        frame: &Bound<'py, PyAny>,
        at: Option<&Bound<'py, PyAny>>,
        port: u8,
    ) -> PyResult<Option<(u64, Bound<'py, PyBytes>)>> {
        let Answer::Back { port, last_bit, .. } = self.send_at(py, frame, at, port)? else {
            return Ok(None);
        };
        self.advance_to(py, last_bit)?;
        let found = self.with(py, |inside| {
            while let Some(arrival) = inside.bus.receive() {
                if arrival.at == last_bit && arrival.port == port {
                    return Ok(Some(arrival));
                }
                inside.kept.push_back(arrival);
            }
            Ok(None)
        })?;
        Ok(found.map(|arrival| (arrival.at.count(), PyBytes::new(py, &arrival.frame))))
    }

    /// Takes the next answer that has come back.
    ///
    /// Returns
    /// -------
    /// tuple of (int, bytes, int), or None
    ///     When its last bit came back, ns; the frame; the port. ``None`` if no answer has come
    ///     back.
    fn receive<'py>(&self, py: Python<'py>) -> PyResult<Option<(u64, Bound<'py, PyBytes>, u8)>> {
        let next =
            self.with(py, |inside| Ok(inside.kept.pop_front().or_else(|| inside.bus.receive())))?;
        Ok(next.map(|arrival| {
            let port = u8::from(arrival.port == MainPort::Secondary);
            (arrival.at.count(), PyBytes::new(py, &arrival.frame), port)
        }))
    }

    /// When the next answer is back, ns; ``None`` if no answer is in flight.
    #[getter]
    fn next_arrival(&self, py: Python<'_>) -> PyResult<Option<u64>> {
        self.with(py, |inside| {
            let kept = inside.kept.front().map(|arrival| arrival.at);
            Ok(kept.or_else(|| inside.bus.next_arrival()).map(Time::count))
        })
    }

    /// Advances time by this span: nanoseconds, ``"1ms"``, or a ``timedelta``.
    ///
    /// Raises
    /// ------
    /// BusError
    ///     The span goes beyond the lifetime of a bus (30 days in total).
    #[pyo3(signature = (by, /))]
    fn advance(&self, py: Python<'_>, by: &Bound<'_, PyAny>) -> PyResult<()> {
        let by = time_within("by", by, Nanos(0), LONGEST)?;
        let now = self.with(py, |inside| Ok(inside.bus.now()))?;
        self.advance_to(py, Time::new(now.count().saturating_add(by.0 as u64)))
    }

    /// Advances time to this instant.
    ///
    /// Raises
    /// ------
    /// BusError
    ///     The instant has passed, or is too far ahead.
    #[pyo3(name = "advance_to", signature = (at, /))]
    fn advance_to_instant(&self, py: Python<'_>, at: &Bound<'_, PyAny>) -> PyResult<()> {
        let at = self.instant(py, "at", Some(at))?;
        self.advance_to(py, at)
    }

    /// A device, by its name or position.
    fn device(slf: Bound<'_, Self>, which: &Bound<'_, PyAny>) -> PyResult<Device> {
        let position = position(&slf.get().names, which)?;
        Ok(Device { bus: slf.unbind(), position })
    }

    /// All devices, by position.
    #[getter]
    fn devices(slf: Bound<'_, Self>) -> Vec<Device> {
        let all = 0..slf.get().names.len();
        all.map(|position| Device { bus: slf.clone().unbind(), position }).collect()
    }

    /// Causes a fault, now or at a later instant.
    ///
    /// Parameters
    /// ----------
    /// what : str
    ///     A line as in ``[[fault]]`` tables (docs/faults.md): ``"drop 3"``, ``"pull axis 2 for
    ///     500ms"``, ``"heal"``.
    /// at : int, str or timedelta, optional
    ///
    /// Raises
    /// ------
    /// BusError
    ///     The line is no fault, or the instant has passed.
    #[pyo3(signature = (what, /, at=None))]
    fn fault(&self, py: Python<'_>, what: &str, at: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let at = at.map(|at| self.instant(py, "at", Some(at))).transpose()?;
        self.with(py, |inside| {
            let wrong = |why: String| Failure {
                place: Some("fault".to_owned()),
                found: Some(what.to_owned()),
                ..Failure::new(Class::Bus, format!("fault \"{what}\": {why}"))
            };
            let order = Order::parse(what, &self.names).map_err(wrong)?;
            match at {
                None => inside.bus.inject(order).map_err(wrong),
                Some(at) => inside.bus.inject_at(at, order).map_err(wrong),
            }
        })
    }

    /// Removes or restores the link at a port of the MainDevice.
    #[pyo3(signature = (up, *, port=0))]
    fn link(&self, py: Python<'_>, up: bool, port: u8) -> PyResult<()> {
        let port = self::port(port).or_raise(py)?;
        self.with(py, |inside| Ok(inside.bus.link(port, up)?))
    }

    /// Ends the session of the MainDevice at its last frame.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |inside| {
            inside.bus.finish();
            Ok(())
        })
    }

    /// The present verdict: what the MainDevice did, and the result of the judges in true time.
    fn verdict(&self, py: Python<'_>) -> PyResult<Verdict> {
        let source = &self.source;
        let summary = self.with(py, |inside| {
            Ok(inside.bus.summary(source, "isocat for Python, in virtual time"))
        })?;
        Ok(Verdict { summary })
    }

    /// Frees the segment; later calls are refused. A ``with`` block calls this at its end.
    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            self.inside.lock().unwrap_or_else(PoisonError::into_inner).take();
        });
    }

    fn __enter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) {
        self.close(py);
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Bus of {}: {}>", self.source, self.names.join(", "))
    }
}

/// A device of a bus.
#[pyclass(module = "isocat", frozen)]
pub struct Device {
    bus: Py<Bus>,
    position: usize,
}

#[pymethods]
impl Device {
    /// Its position in processing order, from 0.
    #[getter]
    fn position(&self) -> usize {
        self.position
    }

    /// Its name in the segment.
    #[getter]
    fn name(&self) -> String {
        self.bus.get().names[self.position].clone()
    }

    /// Its state: ``"INIT"``, ``"PREOP"``, ``"BOOT"``, ``"SAFEOP"`` or ``"OP"``.
    #[getter]
    fn state(&self, py: Python<'_>) -> PyResult<&'static str> {
        Ok(self.both(py)?.0)
    }

    /// AL status code (0x0134): the reason of a state that was not requested; else 0.
    #[getter]
    fn al_status_code(&self, py: Python<'_>) -> PyResult<u16> {
        Ok(self.both(py)?.1)
    }

    /// Its outputs as it took them last; ``None`` while they are in their safe state.
    #[getter]
    fn outputs<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let position = self.position;
        let outputs = self.bus.get().with(py, |inside| Ok(inside.bus.outputs(position)))?;
        Ok(outputs.map(|outputs| PyBytes::new(py, &outputs)))
    }

    /// The inputs that the caller set; ``None`` if they are those of its application.
    ///
    /// Inputs that are set are on the wire after it maps its inputs the next time, and remain;
    /// setting ``None`` returns control to the application. Further bytes of the process image
    /// remain those of its application.
    #[getter]
    fn inputs<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let position = self.position;
        let set = self.bus.get().with(py, |inside| Ok(inside.inputs.get(&position).cloned()))?;
        Ok(set.map(|set| PyBytes::new(py, &set)))
    }

    #[setter]
    fn set_inputs(&self, py: Python<'_>, inputs: Option<Vec<u8>>) -> PyResult<()> {
        let position = self.position;
        self.bus.get().with(py, |inside| {
            let devices = inside.bus.server().served().segment().devices();
            let most = usize::from(devices[position].stack.description().inputs.max_length);
            let length = inputs.as_ref().map_or(0, Vec::len);
            if length > most {
                let expected = format!("{most} at most, which the device can have");
                return Err(Failure::argument("inputs", format!("{length} bytes"), expected));
            }
            inside.bus.set_inputs(position, inputs.as_deref());
            match inputs {
                Some(inputs) => inside.inputs.insert(position, inputs),
                None => inside.inputs.remove(&position),
            };
            Ok(())
        })
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<isocat.Device {} \"{}\": {}>", self.position, self.name(), self.state(py)?))
    }
}

impl Device {
    fn both(&self, py: Python<'_>) -> PyResult<(&'static str, u16)> {
        let position = self.position;
        self.bus.get().with(py, |inside| {
            let state = inside.bus.state(position);
            // The position comes from the names of this bus, so the device exists.
            Ok(state.map_or(("", 0), |(state, code)| (state.name(), code.0)))
        })
    }
}

/// The result of a MainDevice on a bus: what it did, and the verdict of the judges in true time.
#[pyclass(module = "isocat", frozen)]
pub struct Verdict {
    summary: Summary,
}

#[pymethods]
impl Verdict {
    /// ``"in-sync"``, ``"not-in-sync"``, or ``"not-known"`` if no device reached operation.
    #[getter]
    fn answer(&self) -> &'static str {
        match self.summary.answer() {
            verdict::Answer::InSync => "in-sync",
            verdict::Answer::Except => "not-in-sync",
            verdict::Answer::NotKnown => "not-known",
        }
    }

    /// Whether devices reached operation and there is no finding against any of them.
    #[getter]
    fn in_sync(&self) -> bool {
        self.answer() == "in-sync"
    }

    /// The result of the segment's ``[[expect]]`` tables; ``None`` if something could not be
    /// judged.
    #[getter]
    fn as_expected(&self) -> Option<bool> {
        match self.summary.outcome() {
            Outcome::AsExpected => Some(true),
            Outcome::NotAsExpected => Some(false),
            Outcome::NotJudged => None,
        }
    }

    /// Frames that were sent.
    #[getter]
    fn frames(&self) -> u64 {
        self.summary.frames
    }

    /// Frames that were lost, in the segment or by a fault.
    #[getter]
    fn lost(&self) -> u64 {
        self.summary.lost
    }

    /// The findings against devices in the last session, as sentences.
    #[getter]
    fn findings(&self) -> Vec<String> {
        let of = |device: &DeviceSummary| {
            let name = device.name.clone();
            device.findings.iter().map(move |words| format!("{name}: {words}")).collect::<Vec<_>>()
        };
        self.judged().iter().flat_map(of).collect()
    }

    /// The result of each device in the last session: ``name``, ``state``, ``mode``, ``findings``.
    #[getter]
    fn devices(&self) -> Table {
        let mut rows = Rows::new([
            ("name", Kind::Text, false),
            ("state", Kind::Text, false),
            ("mode", Kind::Text, false),
            ("findings", Kind::Integer, false),
        ]);
        for device in self.judged() {
            rows.push([
                Cell::Text(&device.name),
                Cell::Text(&device.state),
                Cell::Text(&device.mode),
                Cell::Integer(device.findings.len() as i64),
            ]);
        }
        rows.take()
    }

    /// The whole document as a ``dict`` (docs/serve-summary.schema.json).
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.summary)
    }

    /// Writes the verdict: a page if the name ends in ``.html``, JSON if in ``.json``, else text.
    #[pyo3(signature = (path, /))]
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let content = match output::ending(&path).as_str() {
            "html" | "htm" => html::serve::page(&self.summary).render(),
            "json" => value::json(&self.summary),
            _ => plain(&self.summary.text()),
        };
        output::bytes(&path, content.as_bytes()).map_err(|error| output::raise(&error, &path))
    }

    fn __str__(&self) -> String {
        plain(&self.summary.text())
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Verdict {}, {} frames>", self.answer(), self.frames())
    }

    fn _repr_html_(&self) -> String {
        frame(&html::serve::page(&self.summary).render())
    }
}

impl Verdict {
    /// The devices of the last session, if it was judged.
    fn judged(&self) -> &[DeviceSummary] {
        let session = self.summary.sessions.last();
        session.and_then(|session| session.judged.as_ref()).map_or(&[], |judged| &judged.devices)
    }
}
