//! What a capture does not show. It is stated, because otherwise its absence would read as if all
//! were well.

use super::{DiagnoseReport, SeenKind};

/// What leaves nothing else unknown.
pub(super) const CABLES: &str = "errors on cables: no error counter (0x0300 to 0x0313) was read";

/// What is no doubt where the way up of all devices is in the capture.
pub(super) const SYNC: &str = "whether SYNC0 runs: no SYNC unit was switched in this capture";

/// One sentence for each thing that the capture does not show and a verdict needs.
pub(super) fn unknown(report: &DiagnoseReport, answers: bool) -> Vec<String> {
    let mut all: Vec<&str> = Vec::new();
    let Some(tap) = &report.tap else { return Vec::new() };
    match tap.seen {
        SeenKind::Both => {}
        SeenKind::Out => all.push(
            "what devices answered: frames are on their way out alone, so no device is there, or answers do not pass the place of the capture",
        ),
        SeenKind::Back => {
            all.push("when frames left: the capture has frames on their way back alone");
        }
    }
    let devices = &report.devices;
    if answers && devices.iter().all(|device| device.states.is_empty()) && !devices.is_empty() {
        all.push("in which states the devices were: AL status (0x0130) was not read");
    }
    if answers && !devices.is_empty() && devices.iter().all(|device| device.position.is_none()) {
        all.push("in which order the devices lie: none was addressed by its position");
    }
    let cyclic = report.cycle.as_ref();
    if cyclic.is_none() {
        all.push("how process data were exchanged: no logical datagram is in the capture");
    }
    let sync = devices.iter().any(|device| !device.sync.is_empty());
    if cyclic.is_some() && !sync {
        all.push(SYNC);
    }
    if cyclic.is_some() && report.clock.is_none() {
        all.push("what time the reference clock had: no FRMW or ARMW of 0x0910 is in the capture");
    }
    let measured = |device: &super::DeviceReport| device.distance.is_some();
    let any_measured = devices.iter().any(measured);
    let by_clock = cyclic.is_some_and(|cycle| cycle.by_clock.is_some());
    if cyclic.is_some() && sync && report.clock.is_some() && !by_clock && !any_measured {
        all.push(
            "where cyclic frames lie against SYNC0: the reference's time goes in other frames than process data",
        );
    }
    let on = |device: &super::DeviceReport| {
        device.sync.last().is_some_and(|sync| sync.assign_activate & 0x0300 == 0x0300)
    };
    let some = by_clock || any_measured;
    if some && devices.iter().any(|device| on(device) && !measured(device)) {
        all.push("where frames lie against SYNC0 of some devices: their start time, cycle or delay is not in the capture, or no frame has their process data in a rhythm with it");
    }
    if answers && !devices.is_empty() && devices.iter().all(|device| device.error_readings == 0) {
        all.push(CABLES);
    }
    if sync && devices.iter().all(|device| device.differences == 0) {
        all.push("how far clocks were apart: 0x092C was not read");
    }
    all.into_iter().map(str::to_owned).collect()
}
