//! Converts values of Python to those of files, and documents to values of Python.

use std::collections::HashSet;

use isocat_descriptions::document::section::Kind;
use isocat_segment::keys;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PyString};
use toml::{Table, Value};

use crate::error::Failure;
use crate::time::timedelta;

/// Keys of segment files whose values are times: there a bare number means nanoseconds.
pub struct Times(HashSet<String>);

impl Times {
    pub fn new() -> Self {
        let is_time = |place: &keys::Place| {
            place.file.name == "segment-file" && matches!(place.key.kind, Kind::Duration { .. })
        };
        Self(keys::all().filter(is_time).map(|place| place.path()).collect())
    }

    /// Whether the value at a path, for example `subdevice[0].cycle` or `host.jitter`, is a time.
    pub fn has(&self, path: &str) -> bool {
        let bare: Vec<&str> =
            path.split('.').map(|part| part.split('[').next().unwrap_or(part)).collect();
        self.0.contains(&bare.join("."))
    }
}

/// Reads a whole number from 0 on from an argument.
pub fn unsigned(name: &str, from: &Bound<'_, PyAny>) -> PyResult<u64> {
    from.extract().map_err(|_| {
        let found = from.repr().map_or_else(|_| "?".to_owned(), |text| text.to_string());
        let expected = format!("a whole number from 0 to {}", u64::MAX);
        Failure::argument(name, found, expected).raise(from.py())
    })
}

/// Largest depth of nested tables.
const DEEPEST: usize = 16;

/// Converts a mapping to a table. `path` is its place; a key may end in `_` if it is a keyword of
/// Python (`for_`).
pub fn table(times: &Times, path: &str, from: &Bound<'_, PyAny>) -> PyResult<Table> {
    let Ok(mapping) = from.cast::<PyMapping>() else {
        let found = format!("{} ({})", from.repr()?, from.get_type().name()?);
        let place = if path.is_empty() { "segment" } else { path };
        return Err(Failure::argument(place, found, "a mapping of keys to values").raise(from.py()));
    };
    let mut table = Table::new();
    for item in mapping.items()?.iter() {
        let (key, given): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
        let Ok(key) = key.extract::<String>() else {
            let found = key.repr()?.to_string();
            return Err(Failure::argument(path, found, "keys that are texts").raise(from.py()));
        };
        let key = key.strip_suffix('_').unwrap_or(&key).to_owned();
        let inner = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        if !given.is_none() {
            table.insert(key, value(times, &inner, &given)?);
        }
    }
    Ok(table)
}

/// Converts a value to that of a file.
pub fn value(times: &Times, path: &str, from: &Bound<'_, PyAny>) -> PyResult<Value> {
    if path.split('.').count() > DEEPEST {
        let expected = format!("{DEEPEST} levels at most");
        return Err(Failure::argument(path, "deeper tables", expected).raise(from.py()));
    }
    if let Ok(flag) = from.cast::<PyBool>() {
        return Ok(Value::Boolean(flag.is_true()));
    }
    if let Ok(text) = from.cast::<PyString>() {
        return Ok(Value::String(text.to_string()));
    }
    if let Some(span) = timedelta(from)? {
        return Ok(Value::String(format!("{}ns", span.0)));
    }
    if from.is_instance_of::<PyInt>() || from.hasattr("__index__")? {
        let number = from.call_method0("__index__")?;
        let Ok(number) = number.extract::<i64>() else {
            let expected = "a whole number of 64 bits with its sign";
            return Err(Failure::argument(path, from.to_string(), expected).raise(from.py()));
        };
        return Ok(match times.has(path) {
            true => Value::String(format!("{number}ns")),
            false => Value::Integer(number),
        });
    }
    if let Ok(number) = from.cast::<PyFloat>() {
        return Ok(Value::Float(number.extract()?));
    }
    if from.cast::<PyMapping>().is_ok() {
        return Ok(Value::Table(table(times, path, from)?));
    }
    if from.hasattr("__fspath__")? {
        let text = from.call_method0("__fspath__")?;
        return Ok(Value::String(text.extract()?));
    }
    if let Ok(items) = from.try_iter() {
        let items = items.map(|item| value(times, path, &item?));
        return Ok(Value::Array(items.collect::<PyResult<_>>()?));
    }
    let found = format!("{} ({})", from.repr()?, from.get_type().name()?);
    let expected = "a text, a number, a flag, a time, a list or a mapping";
    Err(Failure::argument(path, found, expected).raise(from.py()))
}

/// Converts a value of a grid to a text, as `isocat sweep --vary` takes it.
pub fn text(times: &Times, key: &str, from: &Bound<'_, PyAny>) -> PyResult<String> {
    match value(times, key, from)? {
        Value::String(text) => Ok(text),
        Value::Integer(number) => Ok(number.to_string()),
        Value::Float(number) => Ok(number.to_string()),
        Value::Boolean(flag) => Ok(flag.to_string()),
        _ => {
            let found = from.repr()?.to_string();
            Err(Failure::argument(key, found, "texts, numbers, flags or times").raise(from.py()))
        }
    }
}

/// Converts a table of a file to a `dict`.
pub fn dict<'py>(py: Python<'py>, table: &Table) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (key, value) in table {
        dict.set_item(key, of_toml(py, value)?)?;
    }
    Ok(dict)
}

fn of_toml<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        Value::Float(number) => number.into_pyobject(py)?.into_any(),
        Value::Boolean(flag) => flag.into_pyobject(py)?.to_owned().into_any(),
        Value::Datetime(time) => time.to_string().into_pyobject(py)?.into_any(),
        Value::Array(values) => {
            let list = PyList::empty(py);
            for value in values {
                list.append(of_toml(py, value)?)?;
            }
            list.into_any()
        }
        Value::Table(table) => dict(py, table)?.into_any(),
    })
}

/// Converts a document to values of Python: those that `json.loads` would return.
pub fn document<'py>(
    py: Python<'py>,
    document: &impl serde::Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    let value = serde_json::to_value(document).map_err(|error| {
        Failure::new(crate::error::Class::Internal, error.to_string()).raise(py)
    })?;
    of_json(py, &value)
}

fn of_json<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    use serde_json::Value as Json;
    Ok(match value {
        Json::Null => py.None().into_bound(py),
        Json::Bool(flag) => flag.into_pyobject(py)?.to_owned().into_any(),
        Json::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (None, Some(number)) => number.into_pyobject(py)?.into_any(),
            (None, None) => number.as_f64().unwrap_or(f64::NAN).into_pyobject(py)?.into_any(),
        },
        Json::String(text) => text.into_pyobject(py)?.into_any(),
        Json::Array(values) => {
            let list = PyList::empty(py);
            for value in values {
                list.append(of_json(py, value)?)?;
            }
            list.into_any()
        }
        Json::Object(values) => {
            let dict = PyDict::new(py);
            for (key, value) in values {
                dict.set_item(key, of_json(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Converts a document to JSON.
pub fn json(document: &impl serde::Serialize) -> String {
    let text = serde_json::to_string_pretty(document);
    text.expect("documents have no map keys that JSON lacks") + "\n"
}
