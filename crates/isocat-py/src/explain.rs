//! The meaning of a code, an object, a register, a mode or a key.

use isocat_engine::explain::{Meaning, explain as look_up, text};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyInt};

use crate::error::{Class, Failure};
use crate::value;

/// The meaning of something: all its meanings, the likeliest first. Its text is what ``isocat
/// explain`` prints.
#[pyclass(module = "isocat", frozen)]
pub struct Explanation {
    meanings: Vec<Meaning>,
}

#[pymethods]
impl Explanation {
    /// Each meaning as a ``dict``: ``kind``, ``what``, ``name``, ``means``, ``value``, ``causes``,
    /// ``read``, ``change``, and ``found``: "asked", or "line", "number", "word" of a log's line.
    #[getter]
    fn meanings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::document(py, &self.meanings)
    }

    /// The name by the likeliest meaning.
    #[getter]
    fn name(&self) -> &str {
        self.meanings.first().map_or("", |meaning| &meaning.name)
    }

    fn __len__(&self) -> usize {
        self.meanings.len()
    }

    fn __str__(&self) -> String {
        text(&self.meanings)
    }

    fn __repr__(&self) -> String {
        text(&self.meanings)
    }
}

/// Explains a code, an object, a register, a synchronization mode, a key of a file or a line of a
/// log, and what to do about it.
///
/// Parameters
/// ----------
/// what : int or str
///     ``0x001A``, ``"0x1C32:0B"``, ``"AL 0x0030"``, ``"dc-sync0"``, ``"No slaves found!"``.
///
/// Returns
/// -------
/// Explanation
///
/// Raises
/// ------
/// UnknownError
///     It is not known; the message names what is near.
#[pyfunction]
#[pyo3(signature = (what, /))]
pub fn explain(what: &Bound<'_, PyAny>) -> PyResult<Explanation> {
    let py = what.py();
    let expected = "a number up to 0xFFFFFFFF, or a text";
    let asked = if what.is_instance_of::<PyBool>() {
        return Err(Failure::argument("what", what.repr()?.to_string(), expected).raise(py));
    } else if what.is_instance_of::<PyInt>() {
        let number = what.extract::<u32>();
        let number =
            number.map_err(|_| Failure::argument("what", what.to_string(), expected).raise(py))?;
        if number > 0xFFFF { format!("0x{number:08X}") } else { format!("0x{number:04X}") }
    } else {
        let found = format!("{} ({})", what.repr()?, what.get_type().name()?);
        what.extract::<String>()
            .map_err(|_| Failure::argument("what", found, expected).raise(py))?
    };
    let meanings = look_up(&asked).map_err(|unknown| {
        let message = format!("\"{}\": {}", unknown.what, unknown.reason);
        let failure = Failure::new(Class::Unknown, message).with_hint(unknown.hint);
        Failure { found: Some(asked.clone()), ..failure }.raise(py)
    })?;
    Ok(Explanation { meanings })
}
