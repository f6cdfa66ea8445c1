//! SYNC0 pulses that make no edge are found, whichever MainDevice asked for them.

use crate::line::Line;
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::time::Nanos;

fn kinds(acknowledge: &str) -> Vec<&'static str> {
    let text = format!(
        "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"{acknowledge}\"\n"
    );
    let file = SegmentFile::parse("a test", &text).expect("a segment");
    let scenario = Scenario { force: true, ..Scenario::from(file) };
    let mut line = Line::with(&scenario, scenario.run().setup.config);
    line.bring_up();
    line.run(Nanos::millis(200), |_| false);
    let judged = line.server.judged().expect("judged");
    judged.devices[0].findings.iter().map(|finding| finding.kind.name()).collect()
}

#[test]
fn a_program_that_acknowledges_too_late_is_found() {
    assert_eq!(kinds("990us"), [""; 0]);
    assert_eq!(kinds("1.01ms"), ["sync-still-active"]);
}
