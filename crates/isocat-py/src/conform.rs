//! The conformance suite of a device's synchronization.

use std::path::PathBuf;

use isocat::conform::report::ConformanceReport;
use isocat::conform::rules::{self, Rule};
use isocat::conform::subject::Hints;
use isocat::conform::wire::VirtualWire;
use isocat::conform::{examine, segment_of};
use isocat::html;
use isocat::scenario::Scenario;
use isocat_segment::{SegmentFile, profile};
use pyo3::prelude::*;

use crate::error::{Class, Failure, OrRaise};
use crate::plan::plain;
use crate::report::frame;
use crate::segment::Segment;
use crate::table::{Cell, Kind, Rows, Table};
use crate::work::interruptible;
use crate::{output, value};

/// The result of the conformance suite.
#[pyclass(module = "isocat", frozen)]
pub struct Conformance {
    report: ConformanceReport,
}

#[pymethods]
impl Conformance {
    /// Whether no rule failed and every chosen rule was judged.
    #[getter]
    fn passed(&self) -> bool {
        self.report.passed
    }

    /// Each rule at each device: ``device``, ``rule``, ``verdict`` (``passed``, ``failed``,
    /// ``known_deviation``, ``not_judged``, ``not_applicable``), ``what``, ``source``, ``why``.
    #[getter]
    fn rules(&self) -> Table {
        let mut rows = Rows::new([
            ("position", Kind::Integer, false),
            ("device", Kind::Text, false),
            ("rule", Kind::Text, false),
            ("verdict", Kind::Text, false),
            ("what", Kind::Text, false),
            ("source", Kind::Text, false),
            ("why", Kind::Text, false),
        ]);
        for device in &self.report.devices {
            for rule in &device.rules {
                let verdict = serde_json::to_value(rule.verdict).unwrap_or_default();
                rows.push([
                    Cell::Integer(device.position.into()),
                    Cell::Text(&device.name),
                    Cell::Text(rule.id),
                    Cell::Text(verdict.as_str().unwrap_or_default()),
                    Cell::Text(rule.what),
                    Cell::Text(rule.source),
                    Cell::Text(&rule.why.join("; ")),
                ]);
            }
        }
        rows.take()
    }

    /// The whole document as a ``dict`` (docs/conformance-report.schema.json).
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.report)
    }

    /// Writes the result: a page if the name ends in ``.html``, JSON if in ``.json``, JUnit if in
    /// ``.xml``, else text.
    #[pyo3(signature = (path, /))]
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let content = match output::ending(&path).as_str() {
            "html" | "htm" => self.page(),
            "json" => value::json(&self.report),
            "xml" => self.report.junit(),
            _ => plain(&self.report.text()),
        };
        output::bytes(&path, content.as_bytes()).map_err(|error| output::raise(&error, &path))
    }

    fn __str__(&self) -> String {
        plain(&self.report.text())
    }

    fn __repr__(&self) -> String {
        let sum = |pick: fn(&isocat::conform::report::DeviceReport) -> usize| {
            self.report.devices.iter().map(pick).sum::<usize>()
        };
        let (passed, failed) = (sum(|device| device.passed), sum(|device| device.failed));
        format!("<isocat.Conformance {}: {passed} rules hold, {failed} fail>", self.report.source)
    }

    fn _repr_html_(&self) -> String {
        frame(&self.page())
    }
}

impl Conformance {
    fn page(&self) -> String {
        let command = format!("isocat conform {}", self.report.source);
        html::conform::page(&self.report, &command).render()
    }
}

fn is_named(rule: &Rule, name: &str) -> bool {
    let group = rule.id.split('-').next().unwrap_or(rule.id);
    rule.id.eq_ignore_ascii_case(name) || group.eq_ignore_ascii_case(name)
}

/// Tests whether a device synchronizes as it states, rule by rule, in virtual time.
///
/// Parameters
/// ----------
/// subject : Segment or str or os.PathLike
///     A segment or a segment file, of which each device is tested; a built-in profile, or a
///     profile file.
/// rules : list of str, optional
///     Names of rules or groups (``"CNT"``, ``"CNT-03"``); all by default.
///
/// Returns
/// -------
/// Conformance
///
/// Raises
/// ------
/// InputError
///     There is no such rule or device, or a file is invalid.
#[pyfunction]
#[pyo3(signature = (subject, /, *, rules=vec![]))]
pub fn conform(
    py: Python<'_>,
    subject: &Bound<'_, PyAny>,
    rules: Vec<String>,
) -> PyResult<Conformance> {
    for name in &rules {
        if !rules::all().any(|rule| is_named(rule, name)) {
            let hint = profile::name_hint(name, rules::all().map(|rule| rule.id));
            let failure = Failure::argument("rules", name, "names of rules or groups");
            return Err(failure.with_hint(hint).raise(py));
        }
    }
    let scenario = match subject.cast::<Segment>() {
        Ok(segment) => segment.get().described().scenario(),
        Err(_) => of_name(&subject.extract::<PathBuf>()?.display().to_string()),
    };
    let scenario = scenario.or_raise(py)?;
    let report = interruptible(py, move |stop| {
        let (source, devices) = (scenario.source.clone(), scenario.devices.clone());
        let mut wire = VirtualWire::new(scenario);
        let mut reports = Vec::new();
        for (position, device) in devices.iter().enumerate() {
            let hints = Hints::of(device).map_err(Failure::from)?;
            let position = u16::try_from(position).unwrap_or(u16::MAX);
            let wants =
                |rule: &Rule| rules.is_empty() || rules.iter().any(|name| is_named(rule, name));
            let told = |_: isocat::conform::Progress<'_>| stop.leave_if_set();
            let report = examine(&mut wire, position, &device.name, &hints, wants, told);
            reports.push(report.map_err(|why| Failure::new(Class::Input, why))?);
        }
        Ok(ConformanceReport::new(&source, reports))
    })?;
    report.map(|report| Conformance { report }).map_err(|failure: Failure| failure.raise(py))
}

/// A built-in device, a profile file or a segment file.
fn of_name(name: &str) -> Result<Scenario, Failure> {
    let is_file = name.ends_with(".toml") || name.contains(['/', '\\']);
    if !is_file {
        if profile::built_in(name).is_none() {
            let hint = profile::name_hint(name, profile::built_in_ids());
            return Err(
                Failure::argument("subject", name, "a built-in device or a file").with_hint(hint)
            );
        }
        return Ok(SegmentFile::parse(name, &segment_of(name))?.into());
    }
    let text = isocat_descriptions::limits::read_text(name, isocat_descriptions::limits::TOML)?;
    if !text.lines().any(|line| line.trim() == "[identity]") {
        return Ok(SegmentFile::read(name)?.into());
    }
    let path = std::path::absolute(name)
        .map_err(|error| Failure::new(Class::Input, format!("{name}: {error}")))?;
    Ok(SegmentFile::parse(name, &segment_of(&path.display().to_string()))?.into())
}
