//! Plans: whether a segment fits its cycle, and with how much slack.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use isocat::html;
use isocat::plan::{PlanReport, proof, report as document, suggest};
use isocat::scenario::Scenario;
use isocat::tool::Tool;
use isocat_engine::plan;
use pyo3::prelude::*;

use crate::error::{Class, Failure};
use crate::report::frame;
use crate::table::{Cell, Kind, Rows, Table};
use crate::work::interruptible;
use crate::{output, value};

/// A plan of a segment's cycle: every demand on the cycle, with its slack.
///
/// All times are nanoseconds; phases count from the frame at the reference clock.
#[pyclass(module = "isocat", frozen)]
pub struct Plan {
    plan: Arc<plan::Plan>,
    scenario: Scenario,
    report: PlanReport,
}

impl Plan {
    pub fn make(
        py: Python<'_>,
        scenario: Scenario,
        suggests: bool,
        proves: bool,
    ) -> PyResult<Self> {
        let made = interruptible(py, move |_| {
            let plan = plan::Plan::of(&scenario).map_err(|error| {
                let at = error.cause.place().map(|place| place.position);
                let device = at.and_then(|at| scenario.devices.get(at));
                let source = &scenario.source;
                let place = device.map(|device| format!("{source}, device \"{}\"", device.name));
                let place = place.unwrap_or_else(|| source.clone());
                let failure = Failure::new(Class::Plan, format!("{place}: {error}"));
                Failure { place: Some(place), ..failure }
            })?;
            let mut report = plan.report(&scenario);
            if suggests {
                report.suggestion = Some(suggest::suggest(&plan, &scenario));
            }
            if proves {
                proof::prove(&plan, &scenario).fill(&mut report);
            }
            Ok(Self { plan: Arc::new(plan), scenario, report })
        })?;
        made.map_err(|failure: Failure| failure.raise(py))
    }

    fn page(&self) -> String {
        let words = ["isocat", "plan", &self.scenario.source];
        html::plan::page(&self.plan, &self.report, &words.join(" ")).render()
    }
}

#[pymethods]
impl Plan {
    /// Whether every line has slack of 0 or more.
    #[getter]
    fn fits(&self) -> bool {
        self.report.fits
    }

    /// The conclusion in one sentence.
    #[getter]
    fn verdict(&self) -> &str {
        &self.report.verdict
    }

    /// Least slack of all lines, ns; negative if the plan does not fit.
    #[getter]
    fn slack_ns(&self) -> i64 {
        self.report.segment.least_slack_ns
    }

    /// Bus cycle, ns.
    #[getter]
    fn cycle_ns(&self) -> i64 {
        self.report.segment.cycle_ns
    }

    /// Phase of the pulse at which outputs act, ns; ``None`` without SYNC.
    #[getter]
    fn acting_phase_ns(&self) -> Option<i64> {
        self.report.segment.acting_phase_ns
    }

    /// Whether the proof holds; ``None`` without a proof (``Segment.prove``).
    #[getter]
    fn proven(&self) -> Option<bool> {
        self.report.proof.as_ref().map(|proof| proof.holds)
    }

    /// The smallest cycle that fits, ns; ``None`` unless ``suggest=True`` found one.
    #[getter]
    fn suggested_cycle_ns(&self) -> Option<i64> {
        self.report.suggestion.as_ref().and_then(|suggestion| suggestion.smallest_cycle_ns)
    }

    /// Every demand on the cycle: ``position`` and ``device`` (empty: the frames), ``check``,
    /// ``demand``, ``needed_ns``, ``available_ns``, ``slack_ns``, and with a proof ``measured_ns``.
    #[getter]
    fn lines(&self) -> Table {
        let mut rows = Rows::new([
            ("position", Kind::Integer, true),
            ("device", Kind::Text, true),
            ("check", Kind::Text, false),
            ("object", Kind::Text, true),
            ("demand", Kind::Text, false),
            ("needed_ns", Kind::Integer, false),
            ("available_ns", Kind::Integer, false),
            ("slack_ns", Kind::Integer, false),
        ]);
        let mut push = |position: Option<i64>, device: Option<&str>, line: &document::Line| {
            rows.push([
                position.into(),
                device.into(),
                Cell::Text(line.check.name()),
                line.object.as_deref().into(),
                Cell::Text(line.demand),
                Cell::Integer(line.needed_ns),
                Cell::Integer(line.available_ns),
                Cell::Integer(line.slack_ns),
            ]);
        };
        push(None, None, &self.report.frames_line);
        for device in &self.report.devices {
            for line in &device.lines {
                push(Some(device.position as i64), Some(&device.name), line);
            }
        }
        rows.take()
    }

    /// The plan for each device: ``position``, ``name``, ``mode``, ``delay_ns``,
    /// ``sync0_cycle_ns``, ``sync0_phase_ns``, ``sync1_ns``, and ``least_slack_ns`` of its lines.
    #[getter]
    fn devices(&self) -> Table {
        let mut rows = Rows::new([
            ("position", Kind::Integer, false),
            ("name", Kind::Text, false),
            ("profile", Kind::Text, false),
            ("mode", Kind::Text, false),
            ("delay_ns", Kind::Integer, false),
            ("sync0_cycle_ns", Kind::Integer, true),
            ("sync0_phase_ns", Kind::Integer, true),
            ("sync1_ns", Kind::Integer, true),
            ("least_slack_ns", Kind::Integer, true),
        ]);
        for device in &self.report.devices {
            rows.push([
                Cell::Integer(device.position as i64),
                Cell::Text(&device.name),
                Cell::Text(&device.profile),
                Cell::Text(device.mode.name()),
                Cell::Integer(device.delay_ns),
                device.sync0_cycle_ns.into(),
                device.sync0_phase_ns.into(),
                device.sync1_ns.into(),
                device.lines.iter().map(|line| line.slack_ns).min().into(),
            ]);
        }
        rows.take()
    }

    /// Known problems in the field with such a segment, as sentences.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.report.warnings.iter().map(|note| note.what.clone()).collect()
    }

    /// The plan for another tool: ``"twincat"``, ``"igh"``, ``"lcec"``, ``"ros2"``, ``"soem"``,
    /// ``"pysoem"``, ``"ethercrab"``, ``"kickcat"``.
    ///
    /// Returns
    /// -------
    /// dict of str to str
    ///     File names with their contents.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such tool.
    fn for_tool(&self, py: Python<'_>, name: &str) -> PyResult<BTreeMap<String, String>> {
        let Some(tool) = Tool::named(name) else {
            let names: Vec<&str> = Tool::ALL.into_iter().map(Tool::name).collect();
            let hint = isocat::document::name_hint(name, names.iter().copied());
            let failure = Failure::argument("name", name, names.join(", ")).with_hint(hint);
            return Err(failure.raise(py));
        };
        let files = tool.files(&self.plan, &self.scenario);
        Ok(files.into_iter().map(|file| (file.name, file.text)).collect())
    }

    /// The whole document as a ``dict`` (docs/plan.schema.json).
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.report)
    }

    /// Writes the plan: with timing diagrams if the name ends in ``.html``, JSON if in ``.json``,
    /// else text.
    #[pyo3(signature = (path, /))]
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let content = py.detach(|| match output::ending(&path).as_str() {
            "html" | "htm" => self.page(),
            "json" => value::json(&self.report),
            _ => plain(&self.report.text()),
        });
        output::bytes(&path, content.as_bytes()).map_err(|error| output::raise(&error, &path))
    }

    fn __str__(&self) -> String {
        plain(&self.report.text())
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Plan: {}>", self.report.verdict)
    }

    fn _repr_html_(&self, py: Python<'_>) -> String {
        frame(&py.detach(|| self.page()))
    }
}

/// Removes the terminal colours from a text.
pub fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('\u{1b}') {
        out += &rest[..at];
        rest = match rest[at..].find('m') {
            Some(end) => &rest[at + end + 1..],
            None => "",
        };
    }
    out + rest
}
