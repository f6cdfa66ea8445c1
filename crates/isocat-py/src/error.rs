//! Errors that are raised. The exceptions are written in Python (`isocat/_errors.py`), so that they
//! have attributes.

use isocat_descriptions::FileError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// An error, with what was expected.
#[derive(Clone, Default, Debug)]
pub struct Failure {
    /// Its exception.
    pub class: Class,
    /// The description.
    pub message: String,
    /// The place: a file with line and column, an argument, or a device.
    pub place: Option<String>,
    /// The expected value.
    pub expected: Option<String>,
    /// The value that was found.
    pub found: Option<String>,
    /// What the user may have meant.
    pub hint: Option<String>,
}

/// The exceptions.
#[derive(Clone, Copy, Default, PartialEq, Eq, Debug)]
pub enum Class {
    /// A file, a text or an argument is invalid.
    #[default]
    Input,
    /// A segment can't be planned.
    Plan,
    /// A bus refuses a call.
    Bus,
    /// A name or a code is not known.
    Unknown,
    /// A bug of the library itself.
    Internal,
}

impl Class {
    const fn name(self) -> &'static str {
        match self {
            Self::Input => "InputError",
            Self::Plan => "PlanError",
            Self::Bus => "BusError",
            Self::Unknown => "UnknownError",
            Self::Internal => "InternalError",
        }
    }
}

impl Failure {
    pub fn new(class: Class, message: impl Into<String>) -> Self {
        Self { class, message: message.into(), ..Self::default() }
    }

    /// An argument that is invalid.
    pub fn argument(name: &str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        let (found, expected) = (found.into(), expected.into());
        Self {
            message: format!("{name}: found {found}; expected {expected}"),
            place: Some(name.to_owned()),
            expected: Some(expected),
            found: Some(found),
            ..Self::default()
        }
    }

    /// Adds what the user may have meant.
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Makes a Python exception.
    pub fn raise(self, py: Python<'_>) -> PyErr {
        let make = || {
            let class = py.import("isocat._errors")?.getattr(self.class.name())?;
            let keys = PyDict::new(py);
            keys.set_item("place", &self.place)?;
            keys.set_item("expected", &self.expected)?;
            keys.set_item("found", &self.found)?;
            keys.set_item("hint", &self.hint)?;
            class.call((&self.message,), Some(&keys))
        };
        match make() {
            Ok(exception) => PyErr::from_value(exception),
            Err(error) => error,
        }
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        let place = match error.line {
            0 => error.path.clone(),
            line => format!("{}:{line}:{}", error.path, error.column),
        };
        Self {
            message: format!("{place}: {}", error.message),
            place: Some(place),
            hint: error.hint.clone(),
            ..Self::default()
        }
    }
}

/// Raises failures as Python exceptions.
pub trait OrRaise<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T, E: Into<Failure>> OrRaise<T> for Result<T, E> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| error.into().raise(py))
    }
}
