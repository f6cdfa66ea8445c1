//! Where a remedy is written in the segment file.

use crate::report::{Device, Report};

/// The head of the segment file, for keys of the whole segment: `in the head of my.toml: shift =
/// "177us"`.
pub(super) fn head(report: &Report, line: &str) -> String {
    format!("in the head of {}: {line}", file(report))
}

/// The table of the host: `in [host] of my.toml: jitter = "20us"`.
pub(super) fn host(report: &Report, line: &str) -> String {
    format!("in [host] of {}: {line}", file(report))
}

/// The table of one SubDevice: `in [[subdevice]] "axis 1" (line 7 of my.toml): calc_copy = "…"`.
/// With `count` several have one table.
pub(super) fn device(report: &Report, device: &Device, line: &str) -> String {
    let Device { name, line: at, .. } = device;
    format!("in [[subdevice]] \"{name}\" (line {at} of {}): {line}", file(report))
}

/// The segment file as an argument of a command; without one the built-in segment is meant.
pub(super) fn argument(report: &Report) -> String {
    match is_built_in(report) {
        true => String::new(),
        false => format!(" {}", report.segment_file),
    }
}

fn file(report: &Report) -> &str {
    if is_built_in(report) { "the segment file" } else { &report.segment_file }
}

fn is_built_in(report: &Report) -> bool {
    report.segment_file == isocat_segment::SegmentFile::BUILT_IN_NAME
}
