//! SubDevices of a report that are told as one: neighbours of the same kind that do the same, with
//! the worst of their figures.

use super::{Device, Report, Span, Spread};
use crate::fold::fold;

impl Report {
    /// The SubDevices in stretches: neighbours with the same profile, mode, cycle, state and
    /// counters stand together, from [`crate::fold::LEAST`] on. The reference clock, and any that a
    /// finding names, stand alone.
    pub fn alike(&self) -> Vec<&[Device]> {
        fold(&self.devices, |a, b| self.alike_with(a, b))
    }

    /// Whether two neighbours are told as one.
    pub fn alike_with(&self, a: &Device, b: &Device) -> bool {
        self.is_plain(a) && self.is_plain(b) && same(a, b)
    }

    fn is_plain(&self, device: &Device) -> bool {
        let at = Some(device.position);
        self.segment.main_device.reference != at
            && self.findings.iter().chain(&self.visits).all(|finding| finding.position != at)
            && self.diagnoses.iter().all(|diagnosis| diagnosis.position != at)
            && device.true_time.missed_events == 0
    }
}

fn same(a: &Device, b: &Device) -> bool {
    // Where one has figures and the other has none they do not do the same.
    let has = |device: &Device| {
        let seen = &device.true_time;
        let figures = [seen.sync0_margin, seen.outputs_age, seen.inputs_age];
        (seen.sync0_error.is_some(), figures.map(|figure| figure.is_some()))
    };
    let kind = |device: &Device| (device.mode, device.cycle_ns, device.registers.al_status);
    let counters = |device: &Device| {
        let registers = &device.registers;
        (registers.output_counters, registers.input_counters, registers.al_status_code)
    };
    a.profile == b.profile
        && a.op_mode == b.op_mode
        && kind(a) == kind(b)
        && counters(a) == counters(b)
        && has(a) == has(b)
        && (a.true_time.outputs_late, a.true_time.inputs_late)
            == (b.true_time.outputs_late, b.true_time.inputs_late)
}

/// The worst of several errors: the mean that is furthest from zero, the largest deviation, the
/// widest range.
pub fn worst_spread(all: impl Iterator<Item = Option<Spread>>) -> Option<Spread> {
    all.flatten().reduce(|a, b| Spread {
        count: a.count + b.count,
        mean_ns: if b.mean_ns.abs() > a.mean_ns.abs() { b.mean_ns } else { a.mean_ns },
        standard_deviation_ns: a.standard_deviation_ns.max(b.standard_deviation_ns),
        min_ns: a.min_ns.min(b.min_ns),
        max_ns: a.max_ns.max(b.max_ns),
        worst_ns: a.worst_ns.max(b.worst_ns),
    })
}

/// The worst of several ages: the largest mean and deviation, the widest range.
pub fn widest_span(all: impl Iterator<Item = Option<Span>>) -> Option<Span> {
    all.flatten().reduce(|a, b| Span {
        count: a.count + b.count,
        mean_ns: a.mean_ns.max(b.mean_ns),
        standard_deviation_ns: a.standard_deviation_ns.max(b.standard_deviation_ns),
        min_ns: a.min_ns.min(b.min_ns),
        max_ns: a.max_ns.max(b.max_ns),
    })
}
