//! Age of process data, in a table for people.

use std::fmt::{self, Write};

use super::Span;
use super::text::MOST_DEVICES;
use crate::fold::label;

/// The ages of one SubDevice's process data in true time; `None` if it has none, or if they were
/// not observed.
pub struct DataAge<'a> {
    /// Place in processing order and name: of one SubDevice, or of several that are told as one.
    pub devices: Vec<(usize, &'a str)>,
    /// From the first bit of the frame at the MainDevice to the outputs' first effect.
    pub outputs: Option<Span>,
    /// Time from Input Latch to the last bit of the frame at the MainDevice.
    pub inputs: Option<Span>,
}

/// Writes the table, unless no SubDevice has known ages. `mark` names the origin of the figures.
pub fn write(out: &mut String, ages: &[DataAge<'_>], mark: &str) -> fmt::Result {
    let known = |age: &&DataAge| age.outputs.is_some() || age.inputs.is_some();
    if ages.iter().filter(known).count() == 0 {
        return Ok(());
    }
    let head = |what: &str| format!("{what}{mark}, us");
    writeln!(out, "\n{:24}{:>36}  {:>36}", "", head("age of outputs"), head("age of inputs"))?;
    writeln!(
        out,
        " {:<2} {:<19} {:>11} {:>11} {:>12}  {:>11} {:>11} {:>12}",
        "#", "device", "least", "mean", "largest", "least", "mean", "largest"
    )?;
    for age in ages.iter().filter(known).take(MOST_DEVICES) {
        let [outputs, inputs] = [age.outputs, age.inputs].map(figures);
        writeln!(out, " {} {outputs}  {inputs}", label(&age.devices, 2, 19))?;
    }
    let hidden = ages.iter().filter(known).skip(MOST_DEVICES);
    let more = hidden.map(|age| age.devices.len()).sum::<usize>();
    if more > 0 {
        writeln!(out, " …  and {more} more; --json lists them all")?;
    }
    writeln!(
        out,
        "  outputs: from the first bit of their frame at the MainDevice to Outputs Valid; inputs: from\n  Input Latch to \
         the last bit of the first frame with them at the MainDevice"
    )
}

fn figures(age: Option<Span>) -> String {
    let us = |ns: f64| format!("{:.3}", ns / 1e3);
    let [least, mean, largest] = match age {
        Some(age) => [age.min_ns, age.mean_ns, age.max_ns].map(us),
        None => ["-"; 3].map(str::to_owned),
    };
    format!("{least:>11} {mean:>11} {largest:>12}")
}
