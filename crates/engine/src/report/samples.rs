//! When devices that oversample take and give their samples.

use std::fmt::{self, Write};

use isocat_descriptions::columns::cut;
use isocat_sim::judge;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::build::span;
use super::text::MOST_DEVICES;
use super::{Device, Span};

/// The samples of one SubDevice in one direction, in true time.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Samples {
    /// Samples of a whole set, as its description has them: one at each SYNC0 of a cycle.
    pub in_set: u16,
    /// Sets of inputs that were handed over, or of outputs that were given.
    pub sets: u64,
    /// Sets with more or fewer samples than that.
    pub incomplete: u64,
    /// From one sample to the next, across sets; null with fewer than two.
    pub distance: Option<Span>,
}

impl Samples {
    pub(super) fn new(judge: &judge::Samples, in_set: u16) -> Self {
        let (sets, incomplete) = (judge.sets(), judge.incomplete());
        Self { in_set, sets, incomplete, distance: span(judge.distance()) }
    }
}

/// Writes the table, unless no device oversamples.
pub(super) fn write(out: &mut String, devices: &[Device]) -> fmt::Result {
    let of = |device: &Device| (device.true_time.input_samples, device.true_time.output_samples);
    let oversample = || devices.iter().filter(|device| of(device) != (None, None));
    if oversample().next().is_none() {
        return Ok(());
    }
    writeln!(out, "\n{:>92}", "from sample to sample [t], us")?;
    writeln!(
        out,
        " {:<2} {:<19} {:<7} {:>6} {:>8} {:>10}  {:>10} {:>10} {:>10}",
        "#", "samples of", "", "in set", "sets", "not whole", "least", "mean", "largest"
    )?;
    for device in oversample().take(MOST_DEVICES) {
        let (inputs, outputs) = of(device);
        for (direction, samples) in [("inputs", inputs), ("outputs", outputs)] {
            let Some(samples) = samples else { continue };
            let figure = |pick: fn(&Span) -> f64| {
                samples
                    .distance
                    .as_ref()
                    .map_or("-".into(), |all| format!("{:.3}", pick(all) / 1e3))
            };
            writeln!(
                out,
                " {:<2} {:<19} {direction:<7} {:>6} {:>8} {:>10}  {:>10} {:>10} {:>10}",
                device.position,
                cut(&device.name, 19),
                samples.in_set,
                samples.sets,
                samples.incomplete,
                figure(|all| all.min_ns),
                figure(|all| all.mean_ns),
                figure(|all| all.max_ns),
            )?;
        }
    }
    let more = oversample().count().saturating_sub(MOST_DEVICES);
    if more > 0 {
        writeln!(out, " …  and {more} more; --json lists them all")?;
    }
    Ok(())
}
