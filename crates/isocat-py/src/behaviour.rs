//! The behaviour of a device, written in Python: an object whose methods are called at the steps of
//! a cycle.

use std::sync::{Arc, Mutex, PoisonError};

use isocat_subdevice::Application;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

use crate::error::Failure;

/// The methods that are called, if the object has them.
const METHODS: [&str; 9] = [
    "map_outputs",
    "work",
    "outputs_valid",
    "latch_inputs",
    "map_inputs",
    "safe_outputs",
    "power_off",
    "read_object",
    "write_object",
];

/// The first exception of any behaviour of a bus, which the present call on the bus raises.
#[derive(Clone, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    pub fn take(&self) -> Option<PyErr> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn is_there(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    fn put(&self, error: PyErr) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// A Python object as the application of a device.
pub struct Behaviour {
    object: Py<PyAny>,
    /// Which of [`METHODS`] the object has.
    has: [bool; METHODS.len()],
    raised: Raised,
}

impl Behaviour {
    /// Takes an object with at least one of the methods.
    pub fn of(object: &Bound<'_, PyAny>, raised: Raised) -> PyResult<Self> {
        let mut has = [false; METHODS.len()];
        for (has, name) in has.iter_mut().zip(METHODS) {
            *has = match object.getattr_opt(name)? {
                Some(method) => method.is_callable(),
                None => false,
            };
        }
        if !has.contains(&true) {
            let names = object.dir()?;
            let names: Vec<String> = names.iter().filter_map(|name| name.extract().ok()).collect();
            let own = names.iter().filter(|name| !name.starts_with('_'));
            let near = own
                .filter_map(|name| {
                    isocat::document::nearest(name, &METHODS).map(|near| (name, near))
                })
                .map(|(name, near)| format!("did you mean \"{near}\" by \"{name}\"?"))
                .next();
            let found = object.repr()?.to_string();
            let expected = format!("an object with one of: {}", METHODS.join(", "));
            let failure = Failure::argument("behaviours", found, expected);
            let failure = match near {
                Some(near) => failure.with_hint(near),
                None => failure,
            };
            return Err(failure.raise(object.py()));
        }
        Ok(Self { object: object.clone().unbind(), has, raised })
    }

    /// Calls a method, if the object has it and no behaviour has raised.
    fn call<T>(
        &self,
        method: usize,
        arguments: impl for<'py> FnOnce(Python<'py>) -> PyResult<Bound<'py, PyTuple>>,
        result: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>,
    ) -> Option<T> {
        if !self.has[method] || self.raised.is_there() {
            return None;
        }
        Python::attach(|py| {
            let called = || {
                let arguments = arguments(py)?;
                let method = self.object.bind(py).getattr(METHODS[method])?;
                result(&method.call1(arguments)?)
            };
            called().map_err(|error| self.raised.put(error)).ok()
        })
    }

    fn step(&self, method: usize) {
        self.call(method, |py| Ok(PyTuple::empty(py)), |_| Ok(()));
    }

    /// Calls a method like [`call`](Self::call); an `isocat.Abort` that it raises becomes an abort
    /// code.
    fn transfer<T>(
        &self,
        method: usize,
        arguments: impl for<'py> FnOnce(Python<'py>) -> PyResult<Bound<'py, PyTuple>>,
        result: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>,
    ) -> Option<Result<T, AbortCode>> {
        if !self.has[method] || self.raised.is_there() {
            return None;
        }
        Python::attach(|py| {
            let called = || {
                let arguments = arguments(py)?;
                let method = self.object.bind(py).getattr(METHODS[method])?;
                result(&method.call1(arguments)?)
            };
            match called() {
                Ok(value) => Some(Ok(value)),
                Err(error) => match abort(py, &error) {
                    Some(code) => Some(Err(code)),
                    None => {
                        self.raised.put(error);
                        Some(Err(AbortCode::GENERAL))
                    }
                },
            }
        })
    }
}

/// The bytes that a method returned.
fn bytes_of(method: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    given.extract().map_err(|_| {
        let found =
            given.get_type().name().map_or_else(|_| "?".to_owned(), |name| name.to_string());
        Failure::argument(method, found, "bytes, or None").raise(given.py())
    })
}

fn abort(py: Python<'_>, error: &PyErr) -> Option<AbortCode> {
    let class = py.import("isocat._errors").ok()?.getattr("Abort").ok()?;
    error.matches(py, class).ok()?.then_some(())?;
    let code = error.value(py).getattr("code").ok()?.extract::<u32>().ok()?;
    Some(AbortCode(code))
}

impl Application for Behaviour {
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.call(0, |py| (PyBytes::new(py, outputs),).into_pyobject(py), |_| Ok(()));
    }

    fn application(&mut self, cycle: Nanos) {
        self.call(1, |py| (cycle.0,).into_pyobject(py), |_| Ok(()));
    }

    fn outputs_valid(&mut self) {
        self.step(2);
    }

    fn latch_inputs(&mut self) {
        self.step(3);
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        let before = inputs.to_vec();
        let given = self.call(
            4,
            |py| (PyBytes::new(py, &before),).into_pyobject(py),
            |given| {
                if given.is_none() {
                    return Ok(None);
                }
                let bytes = bytes_of("map_inputs", given)?;
                if bytes.len() > before.len() {
                    let found = format!("{} bytes", bytes.len());
                    let expected = format!("{} bytes at most, or None", before.len());
                    return Err(Failure::argument("map_inputs", found, expected).raise(given.py()));
                }
                Ok(Some(bytes))
            },
        );
        if let Some(Some(bytes)) = given {
            inputs[..bytes.len()].copy_from_slice(&bytes);
        }
    }

    fn safe_outputs(&mut self) {
        self.step(5);
    }

    fn power_off(&mut self) {
        self.step(6);
    }

    fn read_object(
        &mut self,
        object: ObjectAddress,
        value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        let capacity = value.len();
        let read = self.transfer(
            7,
            |py| (object.index, object.sub).into_pyobject(py),
            |given| {
                if given.is_none() {
                    return Ok(None);
                }
                let bytes = bytes_of("read_object", given)?;
                if bytes.len() > capacity {
                    let found = format!("{} bytes", bytes.len());
                    let expected = format!("{capacity} bytes at most, or None");
                    return Err(Failure::argument("read_object", found, expected).raise(given.py()));
                }
                Ok(Some(bytes))
            },
        )?;
        match read {
            Ok(None) => None,
            Ok(Some(bytes)) => {
                value[..bytes.len()].copy_from_slice(&bytes);
                Some(Ok(bytes.len()))
            }
            Err(code) => Some(Err(code)),
        }
    }

    fn write_object(&mut self, object: ObjectAddress, value: &[u8]) -> Result<(), AbortCode> {
        let written = self.transfer(
            8,
            |py| (object.index, object.sub, PyBytes::new(py, value)).into_pyobject(py),
            |_| Ok(()),
        );
        written.unwrap_or(Ok(()))
    }
}
