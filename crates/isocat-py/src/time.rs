//! Times in Python: whole nanoseconds, texts such as `"250us"`, `datetime.timedelta`.

use isocat_descriptions::quantity::parse_duration;
use isocat_wire::Nanos;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyInt, PyString};

use crate::error::Failure;

/// The accepted types of a time.
pub const EXPECTED: &str = "whole nanoseconds, a text such as \"250us\", or a timedelta";

/// Reads a time from an argument.
pub fn time(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Nanos> {
    let py = value.py();
    let wrong = |found: String| Failure::argument(name, found, EXPECTED).raise(py);
    if let Ok(text) = value.cast::<PyString>() {
        let text = text.to_string();
        return parse_duration(&text).map_err(|error| {
            Failure {
                message: format!("{name}: {error}"),
                ..Failure::argument(name, &text, EXPECTED)
            }
            .raise(py)
        });
    }
    if let Some(span) = timedelta(value)? {
        return Ok(span);
    }
    if value.is_instance_of::<PyBool>() {
        return Err(wrong(value.repr()?.to_string()));
    }
    if value.is_instance_of::<PyInt>() || value.hasattr("__index__")? {
        let number = value.call_method0("__index__")?.extract::<i64>();
        return number.map(Nanos).map_err(|_| wrong(value.to_string()));
    }
    Err(wrong(format!("{} ({})", value.repr()?, value.get_type().name()?)))
}

/// Reads a time from an argument, within limits.
pub fn time_within(
    name: &str,
    value: &Bound<'_, PyAny>,
    least: Nanos,
    most: Nanos,
) -> PyResult<Nanos> {
    let found = time(name, value)?;
    if (least..=most).contains(&found) {
        return Ok(found);
    }
    let expected = format!("{least} to {most}");
    Err(Failure::argument(name, found.to_string(), expected).raise(value.py()))
}

/// Reads a `timedelta`, or an object like it; exact, without floating point.
pub fn timedelta(value: &Bound<'_, PyAny>) -> PyResult<Option<Nanos>> {
    let parts = ["days", "seconds", "microseconds"].map(|part| value.getattr_opt(part));
    let [Ok(Some(days)), Ok(Some(seconds)), Ok(Some(micros))] = parts else { return Ok(None) };
    let (days, seconds) = (days.extract::<i64>()?, seconds.extract::<i64>()?);
    let micros = micros.extract::<i64>()?;
    // The type of pandas also has nanoseconds.
    let nanos = match value.getattr_opt("nanoseconds")? {
        Some(nanos) => nanos.extract::<i64>()?,
        None => 0,
    };
    let whole = days.checked_mul(86_400).and_then(|days| days.checked_add(seconds));
    let whole = whole.and_then(|seconds| seconds.checked_mul(1_000_000_000));
    let total = whole.and_then(|whole| whole.checked_add(micros * 1_000 + nanos));
    match total {
        Some(total) => Ok(Some(Nanos(total))),
        None => {
            let found = value.repr()?.to_string();
            Err(Failure::argument("time", found, "less than 292 years").raise(value.py()))
        }
    }
}

/// Converts a time to whole nanoseconds.
///
/// Parameters
/// ----------
/// time : int, str or timedelta
///     Nanoseconds, a text with a unit (``"250us"``, ``"1.5ms"``, ``"2min"``), or a ``timedelta``.
///
/// Returns
/// -------
/// int
///
/// Raises
/// ------
/// InputError
///     The value is no time.
///
/// Examples
/// --------
/// >>> isocat.nanoseconds("250us")
/// 250000
#[pyfunction]
#[pyo3(signature = (time, /))]
pub fn nanoseconds(time: &Bound<'_, PyAny>) -> PyResult<i64> {
    Ok(self::time("time", time)?.0)
}
