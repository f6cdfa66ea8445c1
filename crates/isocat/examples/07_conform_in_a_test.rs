//! The conformance of a SubDevice as a test: the rules of `isocat conform`, on a device in virtual
//! time.
//!
//! On a real interface the wire is `isocat::conform::wire::RawWire` instead; the rest stays.
//!
//! `cargo test -p isocat --example 07_conform_in_a_test`, or `cargo run` for the table.

use isocat::columns::plain;
use isocat::conform::report::ConformanceReport;
#[cfg(test)]
use isocat::conform::report::Verdict;
use isocat::conform::subject::Hints;
use isocat::conform::wire::VirtualWire;
use isocat::conform::{examine, segment_of};
use isocat::{Scenario, SegmentFile};

/// Tries the rules whose name begins with `group` on a device.
fn conformance(device: &str, group: &str) -> ConformanceReport {
    let file = SegmentFile::parse("one device", &segment_of(device)).expect("a device");
    let hints = Hints::of(&file.subdevices[0]).expect("deviations of known rules");
    let mut wire = VirtualWire::new(Scenario::from(file));
    let wanted = |rule: &isocat::conform::rules::Rule| rule.id.starts_with(group);
    let report = examine(&mut wire, 0, device, &hints, wanted, |_| {}).expect("this machine works");
    ConformanceReport::new(device, vec![report])
}

fn main() {
    println!("{}", plain(&conformance("simple_io16", "AL").text()));
}

#[test]
fn its_states_are_right() {
    let report = conformance("simple_io16", "AL");
    let rules = &report.devices[0].rules;
    assert!(rules.iter().any(|rule| rule.verdict == Verdict::Pass), "some rule applies");
    assert!(rules.iter().all(|rule| rule.verdict != Verdict::Fail), "{}", report.text());
}
