//! The module behind `import isocat`.
//!
//! `segment` describes a segment; `plan` and `report` are its results; `sweep` runs it many times;
//! `bus` and `behaviour` are its wire for programs in Python; `conform`, `diagnosis`, `explain` and
//! `esi` are the other functions. Results with rows are a `table`, which is exported by the Arrow C
//! data interface. `work` runs long work on its own thread with the interpreter's lock released, so
//! that Ctrl-C is handled. `value` and `time` convert between Python's values and those of files;
//! `error` is what is raised.
//!
//! Nothing here is global: each object has its own state, so threads of Python are independent of
//! each other.
#![forbid(unsafe_code)]

use std::ffi::OsString;

use pyo3::prelude::*;

mod behaviour;
mod bus;
mod conform;
mod diagnosis;
mod error;
mod esi;
mod explain;
mod output;
mod plan;
mod report;
mod segment;
mod sweep;
mod table;
mod time;
mod value;
mod work;

/// Runs the command `isocat` with these arguments; returns its exit code.
///
/// `itself` is the command line that starts the command again, for runs in their own processes.
#[pyfunction]
fn command(py: Python<'_>, itself: Vec<OsString>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| isocat::cli::main_as(itself, arguments))
}

#[pymodule]
fn _isocat(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<segment::Segment>()?;
    module.add_class::<plan::Plan>()?;
    module.add_class::<report::Report>()?;
    module.add_class::<report::Finding>()?;
    module.add_class::<table::Table>()?;
    module.add_class::<table::Column>()?;
    module.add_class::<explain::Explanation>()?;
    module.add_class::<esi::Esi>()?;
    module.add_class::<conform::Conformance>()?;
    module.add_class::<diagnosis::Diagnosis>()?;
    module.add_class::<bus::Bus>()?;
    module.add_class::<bus::Device>()?;
    module.add_class::<bus::Verdict>()?;
    module.add_class::<sweep::Sweep>()?;
    module.add_function(wrap_pyfunction!(explain::explain, module)?)?;
    module.add_function(wrap_pyfunction!(esi::esi, module)?)?;
    module.add_function(wrap_pyfunction!(conform::conform, module)?)?;
    module.add_function(wrap_pyfunction!(diagnosis::diagnose, module)?)?;
    module.add_function(wrap_pyfunction!(segment::devices, module)?)?;
    module.add_function(wrap_pyfunction!(time::nanoseconds, module)?)?;
    module.add_function(wrap_pyfunction!(command, module)?)?;
    Ok(())
}
