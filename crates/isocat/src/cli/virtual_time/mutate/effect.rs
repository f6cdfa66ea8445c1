//! What a mutation did to the segment in true time, against the run without it. No rule is asked:
//! this is what they are held against.

use std::ops::Range;

use isocat_sim::Judged;
use serde_json::Value;

/// A word for an effect, and the position of the SubDevice; `None`: the segment.
pub type Effect = (&'static str, Option<usize>);

/// The figures of a run, of its last session with a judgement.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Figures {
    /// How long it was judged in operation, ns; 0: never.
    judged_ns: f64,
    /// From the least to the largest phase of frames by the reference clock, ns.
    wander_ns: f64,
    /// The longest time without a drift datagram, ns.
    drift_gap_ns: f64,
    devices: Vec<DeviceFigures>,
}

#[derive(Clone, PartialEq, Debug, Default)]
struct DeviceFigures {
    state: String,
    mode: String,
    guarded: bool,
    sync0_cycle_ns: Option<f64>,
    sync0_error_ns: Option<f64>,
    /// Least and mean time from copied outputs to SYNC0.
    margin_ns: Option<[f64; 2]>,
    /// Mean and largest age of outputs, and of inputs.
    ages_ns: [Option<[f64; 2]>; 2],
    /// Logical bits of outputs, and of inputs.
    bits: [Vec<Range<u64>>; 2],
    missed: f64,
    /// Kinds of what the judges of true time found.
    found: Vec<String>,
}

impl Figures {
    /// The figures of a report.
    pub fn of(report: &Value) -> Self {
        let sessions = report["sessions"].as_array().map_or(&[][..], Vec::as_slice);
        let Some(session) = sessions.iter().rev().find(|session| !session["judged"].is_null())
        else {
            return Self::default();
        };
        let devices = session["judged"]["devices"].as_array().map_or(&[][..], Vec::as_slice);
        let phase = &session["cycle"]["phase"];
        Self {
            judged_ns: number(&session["judged"]["judged_ns"]),
            wander_ns: number(&phase["max_ns"]) - number(&phase["min_ns"]),
            drift_gap_ns: number(&session["cycle"]["longest_drift_gap_ns"]),
            devices: devices.iter().map(DeviceFigures::of).collect(),
        }
    }

    /// What is otherwise than in `good`, whose bus cycle and limit of SYNC0 are given, ns.
    pub fn against(&self, good: &Self, cycle: f64, limit: f64) -> Vec<Effect> {
        if self.devices.is_empty() {
            return vec![("never in operation", None)];
        }
        let mut all = Vec::new();
        if self.judged_ns < good.judged_ns / 2.0 {
            all.push(("shorter operation", None));
        }
        if self.wander_ns > 2.0 * good.wander_ns + cycle / 50.0 {
            all.push(("frames wander", None));
        }
        if self.drift_gap_ns > LONG_NS.max(10.0 * good.drift_gap_ns) {
            all.push(("no reference time", None));
        }
        let pairs = self.devices.iter().zip(&good.devices).enumerate();
        all.extend(pairs.flat_map(|(at, (one, good))| {
            let words = one.against(good, cycle, limit);
            words.into_iter().map(move |word| (word, Some(at)))
        }));
        let apart =
            (0..self.devices.len()).filter(|at| self.apart(good, *at).is_some_and(|by| by > limit));
        all.extend(apart.map(|at| ("SYNC0 apart", Some(at))));
        let overlapping =
            (0..self.devices.len()).filter(|at| self.overlaps(*at) && !good.overlaps(*at));
        all.extend(overlapping.map(|at| ("logical bits of another one", Some(at))));
        all
    }

    /// Whether a distance of SYNC0 is so near to its limit that what a door knows of it may fall on
    /// either side.
    pub fn is_at_the_edge(&self, good: &Self, limit: f64) -> bool {
        let errors = self.devices.iter().filter_map(|device| device.sync0_error_ns);
        let moved = (0..self.devices.len()).filter_map(|at| self.apart(good, at));
        errors.chain(moved).any(|by| (limit * 0.8..limit * 1.25).contains(&by))
    }

    /// By how much SYNC0 of a SubDevice comes at another time against the first one with SYNC0.
    fn apart(&self, good: &Self, at: usize) -> Option<f64> {
        let margin = |figures: &Self, at: usize| Some(figures.devices.get(at)?.margin_ns?[1]);
        let first = |figures: &Self| figures.devices.iter().position(|one| one.margin_ns.is_some());
        let distance =
            |figures: &Self| Some(margin(figures, at)? - margin(figures, first(figures)?)?);
        distance(self).zip(distance(good)).map(|(now, usual)| (now - usual).abs())
    }

    /// Whether a SubDevice and another one take the same logical bits in one direction.
    fn overlaps(&self, at: usize) -> bool {
        let others = self.devices.iter().enumerate().filter(|(other, _)| *other != at);
        let meets = |one: &Range<u64>, two: &Range<u64>| one.start < two.end && two.start < one.end;
        others.map(|(_, other)| other).any(|other| {
            let pairs = self.devices[at].bits.iter().zip(&other.bits);
            pairs.into_iter().any(|(own, other)| {
                own.iter().any(|own| other.iter().any(|other| meets(own, other)))
            })
        })
    }
}

impl DeviceFigures {
    fn of(device: &Value) -> Self {
        let text = |key: &str| device[key].as_str().unwrap_or_default().to_owned();
        let pair = |span: &Value, first: &str, second: &str| {
            (!span.is_null()).then(|| [number(&span[first]), number(&span[second])])
        };
        let age = |key: &str| pair(&device[key], "mean_ns", "max_ns");
        let bits = |key: &str| {
            let ranges = device[key].as_array().map_or(&[][..], Vec::as_slice);
            let bit = |value: &Value| value.as_u64().unwrap_or_default();
            ranges.iter().map(|range| bit(&range[0])..bit(&range[1])).collect()
        };
        let kinds = device["kinds"].as_array().map_or(&[][..], Vec::as_slice);
        let kinds = kinds.iter().filter_map(|kind| kind["kind"].as_str());
        let of_true_time = |kind: &&str| Judged::DESCRIPTIONS.iter().any(|one| one.name == *kind);
        let counters = ["sm_event_missed", "cycle_time_too_small", "shift_time_too_short"];
        Self {
            state: text("state"),
            mode: text("mode"),
            guarded: device["guarded"].as_bool().unwrap_or_default(),
            sync0_cycle_ns: device["sync0_cycle_ns"].as_f64(),
            sync0_error_ns: device["sync0_error"]["worst_ns"].as_f64(),
            margin_ns: pair(&device["sync0_margin"], "min_ns", "mean_ns"),
            ages_ns: ["outputs_age", "inputs_age"].map(age),
            bits: ["output_bits", "input_bits"].map(bits),
            missed: counters.iter().map(|key| number(&device[key])).sum(),
            found: kinds.filter(of_true_time).map(str::to_owned).collect(),
        }
    }

    fn against(&self, good: &Self, cycle: f64, limit: f64) -> Vec<&'static str> {
        let mut all = Vec::new();
        let mut note = |is_so: bool, word| {
            if is_so {
                all.push(word);
            }
        };
        note(self.state != good.state, "state");
        note(self.mode != good.mode, "mode");
        note(!self.guarded && good.guarded, "not guarded");
        let far = |error: Option<f64>| error.is_some_and(|error| error > limit);
        // SYNC0 at a SubDevice that does not use it does no harm.
        note(self.sync0_error_ns.is_none() && good.sync0_error_ns.is_some(), "no SYNC0");
        let other_cycle = self.sync0_cycle_ns != good.sync0_cycle_ns;
        note(other_cycle && good.sync0_cycle_ns.is_some(), "cycle of SYNC0");
        note(far(self.sync0_error_ns) && !far(good.sync0_error_ns), "SYNC0 off");
        if let (Some([least, mean]), Some([_, usual])) = (self.margin_ns, good.margin_ns) {
            note(least <= 0.0, "SYNC0 before outputs");
            note((mean - usual).abs() > cycle / 4.0, "phase");
        }
        for (direction, (now, usual)) in
            ["outputs", "inputs"].into_iter().zip(self.ages_ns.into_iter().zip(good.ages_ns))
        {
            let older = now.zip(usual).is_some_and(|(now, usual)| {
                (now[0] - usual[0]).abs() > cycle / 4.0 || now[1] > usual[1] + cycle / 2.0
            });
            note(older || now.is_some() != usual.is_some(), direction);
        }
        note(self.missed > good.missed, "missed events");
        note(self.found.iter().any(|kind| !good.found.contains(kind)), "found by the judges");
        all
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_default()
}

/// A time without drift datagrams that is no accident of one frame.
const LONG_NS: f64 = 100_000_000.0;
