//! Makers' descriptions (ESI).

use std::path::PathBuf;

use isocat_descriptions::esi::EsiFile;
use pyo3::prelude::*;

use crate::error::OrRaise;
use crate::output;
use crate::table::{Cell, Kind, Rows, Table};

/// A maker's description of devices (ESI).
#[pyclass(module = "isocat", frozen)]
pub struct Esi {
    file: EsiFile,
}

#[pymethods]
impl Esi {
    /// The path of the file.
    #[getter]
    fn path(&self) -> &str {
        &self.file.path
    }

    /// The maker.
    #[getter]
    fn vendor(&self) -> String {
        plain(&self.file.vendor)
    }

    /// The maker's vendor id; 0 for a file of modules, which may have none.
    #[getter]
    fn vendor_id(&self) -> u32 {
        self.file.vendor_id
    }

    /// The devices in the order of the file: ``type`` (for ``Segment.add(esi=..., type=...)``),
    /// ``name``, ``product_code``, ``revision``, ``opmodes`` and ``assign_activate`` (joined by
    /// commas), ``hidden``, ``usable``, ``warnings``.
    #[getter]
    fn devices(&self) -> Table {
        let mut rows = Rows::new([
            ("type", Kind::Text, false),
            ("name", Kind::Text, false),
            ("product_code", Kind::Integer, true),
            ("revision", Kind::Integer, true),
            ("opmodes", Kind::Text, false),
            ("assign_activate", Kind::Text, false),
            ("hidden", Kind::Flag, false),
            ("usable", Kind::Flag, false),
            ("warnings", Kind::Integer, false),
        ]);
        for device in &self.file.devices {
            let modes = device.op_modes();
            let names: Vec<String> = modes.iter().map(|mode| plain(&mode.name)).collect();
            let words: Vec<String> =
                modes.iter().map(|mode| format!("{:#06x}", mode.assign_activate)).collect();
            let usable = self.file.usable().any(|usable| usable.at == device.at);
            rows.push([
                Cell::Text(&plain(&device.type_name)),
                Cell::Text(&plain(&device.name)),
                device.product_code.map(i64::from).into(),
                device.revision.map(i64::from).into(),
                Cell::Text(&names.join(",")),
                Cell::Text(&words.join(",")),
                Cell::Flag(device.hidden),
                Cell::Flag(usable),
                Cell::Integer(device.warnings.len() as i64),
            ]);
        }
        rows.take()
    }

    /// Doubtful places in the file: ``device`` (empty: the file), ``line``, ``kind``, ``what``.
    #[getter]
    fn warnings(&self) -> Table {
        let mut rows = Rows::new([
            ("device", Kind::Text, true),
            ("line", Kind::Integer, false),
            ("kind", Kind::Text, false),
            ("what", Kind::Text, false),
        ]);
        for (device, warning) in self.file.warnings() {
            rows.push([
                device.map(|device| device.type_name.as_str()).into(),
                Cell::Integer(self.file.place(warning.at).line as i64),
                Cell::Text(&warning.kind.to_string()),
                Cell::Text(&plain(&warning.message)),
            ]);
        }
        rows.take()
    }

    /// Devices and modules that could not be read, each with its place.
    #[getter]
    fn refused(&self) -> Vec<String> {
        self.file.refused.iter().map(ToString::to_string).collect()
    }

    fn __len__(&self) -> usize {
        self.file.devices.len()
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Esi {}: {}, {} devices>", self.path(), self.vendor(), self.__len__())
    }
}

/// A text of the file, in one line without control characters.
fn plain(text: &str) -> String {
    let words: Vec<_> = text.split_whitespace().collect();
    words.join(" ").chars().filter(|character| !character.is_control()).collect()
}

/// Reads a maker's description.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///
/// Returns
/// -------
/// Esi
///
/// Raises
/// ------
/// InputError
///     The file is no description; the message has line and column.
/// OSError
///     The file can't be read.
#[pyfunction]
#[pyo3(signature = (path, /))]
pub fn esi(py: Python<'_>, path: PathBuf) -> PyResult<Esi> {
    if let Err(error) = std::fs::File::open(&path) {
        return Err(output::raise(&error, &path));
    }
    let name = path.display().to_string();
    let file = py.detach(|| EsiFile::read(&name)).or_raise(py)?;
    Ok(Esi { file })
}
