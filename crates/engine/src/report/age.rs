//! Age of process data, in a table for people.

use std::fmt::{self, Write};

use isocat_descriptions::columns::cut;

use super::Span;
use super::text::MOST_DEVICES;

/// The ages of one SubDevice's process data in true time; `None` if it has none, or if they were
/// not observed.
pub struct DataAge<'a> {
    /// Place in processing order.
    pub position: usize,
    /// Name.
    pub name: &'a str,
    /// Time from the first bit of the frame at the MainDevice to the outputs' first effect.
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
        let name = cut(age.name, 19);
        writeln!(out, " {:<2} {name:<19} {outputs}  {inputs}", age.position)?;
    }
    let more = ages.iter().filter(known).count().saturating_sub(MOST_DEVICES);
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
