//! Diagnoses of captures.

use std::fs::File;
use std::io::{self, Read};
use std::path::PathBuf;

use isocat::diagnose::{Around, Claims, DiagnoseReport, Diagnosis as Reader, Names};
use isocat::html::diagnose::Diagnosed;
use isocat::html::diagnose::figures::Figures;
use isocat_descriptions::esi::EsiFile;
use pyo3::prelude::*;

use crate::error::{Class, Failure, OrRaise};
use crate::plan::plain;
use crate::report::frame;
use crate::segment::Segment;
use crate::table::{Cell, Kind, Rows, Table};
use crate::work::{Stop, interruptible};
use crate::{output, value};

/// The content of captures, and what went wrong in the segment.
#[pyclass(module = "isocat", frozen)]
pub struct Diagnosis {
    report: DiagnoseReport,
    figures: Figures,
    command: String,
}

#[pymethods]
impl Diagnosis {
    /// Whether a fault was found.
    #[getter]
    fn found(&self) -> bool {
        self.report.found()
    }

    /// The conclusion in one sentence: what went wrong first, and where.
    #[getter]
    fn verdict(&self) -> &str {
        &self.report.verdict.sentence
    }

    /// The findings, faults first and each weight in the order of time: ``kind``, ``weight``,
    /// ``device``, ``capture`` (place in the list), ``frame`` (as Wireshark numbers it), ``at_ns``,
    /// ``what``.
    #[getter]
    fn findings(&self) -> Table {
        let mut rows = Rows::new([
            ("kind", Kind::Text, false),
            ("weight", Kind::Text, false),
            ("device", Kind::Integer, true),
            ("capture", Kind::Integer, false),
            ("frame", Kind::Integer, false),
            ("at_ns", Kind::Integer, true),
            ("what", Kind::Text, false),
        ]);
        for found in &self.report.findings {
            let weight = serde_json::to_value(found.weight).unwrap_or_default();
            rows.push([
                Cell::Text(found.kind),
                Cell::Text(weight.as_str().unwrap_or_default()),
                found.device.map(|device| device as i64).into(),
                Cell::Integer(found.frame.capture as i64),
                Cell::Integer(found.frame.frame as i64),
                found.at_ns.and_then(|at| i64::try_from(at).ok()).into(),
                Cell::Text(&found.what),
            ]);
        }
        rows.take()
    }

    /// What the captures do not show, as sentences.
    #[getter]
    fn unknown(&self) -> Vec<String> {
        self.report.unknown.clone()
    }

    /// The whole document as a ``dict`` (docs/diagnose.schema.json).
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.report)
    }

    /// Writes the diagnosis: a page with pictures if the name ends in ``.html``, JSON if in
    /// ``.json``, else text.
    #[pyo3(signature = (path, /))]
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let content = match output::ending(&path).as_str() {
            "html" | "htm" => self.page(),
            "json" => value::json(&self.report),
            _ => plain(&self.report.text()),
        };
        output::bytes(&path, content.as_bytes()).map_err(|error| output::raise(&error, &path))
    }

    fn __str__(&self) -> String {
        plain(&self.report.text())
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Diagnosis: {}>", self.verdict())
    }

    fn _repr_html_(&self) -> String {
        frame(&self.page())
    }
}

impl Diagnosis {
    fn page(&self) -> String {
        let Self { report, figures, command } = self;
        Diagnosed { report, figures, command }.page().render()
    }
}

/// Why a diagnosis failed.
enum Wrong {
    File(io::Error, PathBuf),
    Other(Failure),
}

/// Reads captures of any MainDevice's segment: devices, set-up, states, and what went wrong first.
///
/// Parameters
/// ----------
/// *captures : str or os.PathLike
///     pcapng or pcap; several captures are read as one, in their order.
/// segment : Segment or str or os.PathLike, optional
///     Source of the devices' names and of what they are meant to do, by position.
/// esi : list of str or os.PathLike
///     Makers' descriptions, as source of the names of types.
///
/// Returns
/// -------
/// Diagnosis
///
/// Raises
/// ------
/// InputError
///     A file is no capture, or has no EtherCAT frames.
/// OSError
///     A file can't be read.
#[pyfunction]
#[pyo3(signature = (*captures, segment=None, esi=vec![]))]
pub fn diagnose(
    py: Python<'_>,
    captures: Vec<PathBuf>,
    segment: Option<&Bound<'_, PyAny>>,
    esi: Vec<PathBuf>,
) -> PyResult<Diagnosis> {
    if captures.is_empty() {
        return Err(Failure::argument("captures", "none", "one file or more").raise(py));
    }
    let (mut names, claims) = match segment {
        None => (Names::default(), None),
        Some(segment) => {
            let class = py.get_type::<Segment>();
            let segment = match segment.is_instance_of::<Segment>() {
                true => segment.clone(),
                false => class.call1((segment,))?,
            };
            let described = segment.cast::<Segment>()?.get().described();
            let scenario = described.scenario().or_raise(py)?;
            let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
            (Names { positions: names, ..Names::default() }, Some(scenario.claims()))
        }
    };
    let made = interruptible(py, move |stop| {
        for path in &esi {
            let file = EsiFile::read(&path.display().to_string())
                .map_err(|error| Wrong::Other(error.into()))?;
            for device in &file.devices {
                let Some(product) = device.product_code else { continue };
                names.identities.insert((file.vendor_id, product), device.type_name.clone());
            }
        }
        let mut figures = Figures::default();
        let report = read(&captures, (&names, claims), &mut figures, stop)?;
        let paths: Vec<String> = captures.iter().map(|path| path.display().to_string()).collect();
        Ok(Diagnosis { report, figures, command: format!("isocat diagnose {}", paths.join(" ")) })
    })?;
    made.map_err(|wrong| match wrong {
        Wrong::File(error, path) => output::raise(&error, &path),
        Wrong::Other(failure) => failure.raise(py),
    })
}

fn read(
    captures: &[PathBuf],
    (names, claims): (&Names, Option<Claims>),
    figures: &mut Figures,
    stop: &Stop,
) -> Result<DiagnoseReport, Wrong> {
    let open = |path: &PathBuf| {
        let file = File::open(path).map_err(|error| Wrong::File(error, path.clone()))?;
        Ok(Interruptible(file, stop.clone()))
    };
    let mut reader = Reader::new().against(claims);
    for path in captures {
        let name = path.display().to_string();
        let read = reader.read_with(&name, open(path)?, &mut |one| figures.push(one));
        read.map_err(|why| {
            let failure = Failure::new(Class::Input, format!("{name}: {why}"));
            Wrong::Other(Failure { place: Some(name), ..failure })
        })?;
    }
    let report = reader.report_with(names, &mut |one| figures.push(one));
    let mut report = report.map_err(|nothing| {
        let names: Vec<String> = captures.iter().map(|path| path.display().to_string()).collect();
        Wrong::Other(Failure::new(Class::Input, format!("{}: {nothing}", names.join(", "))))
    })?;
    // Reads the captures a second time, for the frames around the first fault. Captures that can't
    // be read twice, such as pipes, have no such part.
    let again = Around::new(&report).filter(|_| captures.iter().all(|path| path.is_file()));
    if let Some(mut around) = again {
        for path in captures {
            if around.read(&path.display().to_string(), open(path)?).is_err() {
                around.pass_over();
            }
        }
        around.end(&mut report);
    }
    Ok(report)
}

/// A file whose reading ends the thread when the user stops the work.
struct Interruptible(File, Stop);

impl Read for Interruptible {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.1.leave_if_set();
        self.0.read(to)
    }
}
