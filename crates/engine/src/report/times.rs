//! Times that a device measured itself on the way up, in reports.

use isocat_maindevice::OwnTimes;
use isocat_wire::time::Nanos;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// Times that a SubDevice measured on command of 0x1C32:08 and 0x1C33:08; null if it did not.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct MeasuredTimes {
    /// The longer one of 0x1C32:05 and 0x1C33:05.
    pub minimum_cycle_ns: Option<i64>,
    /// 0x1C32:06.
    pub outputs_calc_and_copy_ns: Option<i64>,
    /// 0x1C32:09.
    pub outputs_delay_ns: Option<i64>,
    /// 0x1C33:06.
    pub inputs_calc_and_copy_ns: Option<i64>,
    /// 0x1C33:09.
    pub inputs_delay_ns: Option<i64>,
    /// Whether they were stable at the end; if not, they are the last values.
    pub settled: bool,
    /// Host time from the command to the last reading.
    pub after_ns: i64,
}

impl From<OwnTimes> for MeasuredTimes {
    fn from(own: OwnTimes) -> Self {
        let ns = |time: Option<Nanos>| time.map(|time| time.0);
        Self {
            minimum_cycle_ns: ns(own.times.minimum_cycle),
            outputs_calc_and_copy_ns: ns(own.times.outputs_calc_and_copy),
            outputs_delay_ns: ns(own.times.outputs_delay),
            inputs_calc_and_copy_ns: ns(own.times.inputs_calc_and_copy),
            inputs_delay_ns: ns(own.times.inputs_delay),
            settled: own.settled,
            after_ns: own.after.0,
        }
    }
}

impl MeasuredTimes {
    /// The note on them, with the key of a segment file that stores them.
    pub(super) fn note(&self, position: usize) -> String {
        let known = [
            ("minimum_cycle", self.minimum_cycle_ns),
            ("outputs_calc_and_copy", self.outputs_calc_and_copy_ns),
            ("outputs_delay", self.outputs_delay_ns),
            ("inputs_calc_and_copy", self.inputs_calc_and_copy_ns),
            ("inputs_delay", self.inputs_delay_ns),
        ];
        let keys = known.iter().filter_map(|(key, ns)| Some(format!("{key} = \"{}ns\"", (*ns)?)));
        let keys = keys.collect::<Vec<_>>().join(", ");
        if keys.is_empty() {
            return format!(
                "SubDevice {position}: it announces dynamic times and measured none (0x1C32:08)"
            );
        }
        let how = match self.settled {
            true => "stable",
            false => "not stable yet",
        };
        format!(
            "SubDevice {position} measured its times (0x1C32:08), {how} after {} ms; to keep them: \
             measured_times = {{ {keys} }}",
            self.after_ns / 1_000_000
        )
    }
}
